/* The stiff method: Radau IIA of order 5, and the linear algebra that it needs; see radau.c and factors.c. */
#ifndef BLOCKS_STIFF_H
#define BLOCKS_STIFF_H

#include "jacobian.h"

/* What a model gives to the stiff method. Rows and columns of its slopes, d(rates)/dx, stand in the order of its states. */
struct BlocksImplicit {
    const BlocksJacobian *slopes;
    const int32_t *order; /* (nx) the order of elimination; null: the matrix is dense */
    int (*open)(BlocksSim *); /* 1 where there is no memory */
    void (*close)(BlocksSim *);
};

enum { BLOCKS_STIFF_STAGES = 5, BLOCKS_STIFF_DEGREE = 3 };
extern const double blocks_stiff_dense[BLOCKS_STIFF_STAGES * BLOCKS_STIFF_DEGREE];

int blocks_stiff_open(BlocksSim *s);
void blocks_stiff_close(BlocksSim *s);
int blocks_stiff_run(BlocksSim *s, double target);
double blocks_stiff_trial(BlocksSim *s, double t, const double *x, double h, double *x1, int is_judged);

/* --- linear algebra ------------------------------------------------------------------------------------------------- */

/* A number of the real matrix, and one of the complex matrix. */
typedef struct {
    double real, re, im;
} BlocksPair;

/* Triangular factors of two matrices of one pattern, real - J and (re + i im) - J. */
typedef struct {
    int32_t n;
    const int32_t *first, *rows; /* the pattern of J, by columns */
    const int32_t *order;        /* null: dense */
    double *dense;               /* three (n, n), by rows: real, re, im; the diagonals inverted */
    int32_t *real_rows, *complex_rows; /* (n) dense: the row that stands at each place */
    int32_t *pivots;  /* (n) sparse: the row on which each column is eliminated; before that, the one that it prefers */
    int32_t *place;   /* (n) of each row, the place of its pivot; -1: none yet */
    int32_t *at;      /* of each value of J, the place of its row */
    int32_t *lower_first, *lower_rows, *upper_first, *upper_rows; /* rows of the upper factor: as they are to be taken */
    int32_t *stack, *path, *edge, *marked; /* (n) for the search */
    BlocksPair *lower, *upper, *inverse, *work;
    int64_t lower_room, upper_room;
    int32_t has_structure;
} BlocksFactors;

BlocksFactors *blocks_factors_new(int32_t n, const int32_t *first, const int32_t *rows, const int32_t *order);
void blocks_factors_free(BlocksFactors *f);

/* Factors of J with these values: 0; singular: 1; there is no memory: 2. */
int blocks_factor(BlocksFactors *f, const double *slopes, BlocksPair shift);

/* The solutions of both, in place. */
void blocks_solve(const BlocksFactors *f, double *real, double *re, double *im);
void blocks_solve_real(const BlocksFactors *f, double *real);

#endif
