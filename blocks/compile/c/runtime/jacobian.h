/* Exact derivatives of a model, as jacobian_code.py prints them: what a PlanJacobian computes (compile/jacobian.py). */
#ifndef BLOCKS_JACOBIAN_H
#define BLOCKS_JACOBIAN_H

#include "runtime.h"

/* A step of the sparse accumulation of derivatives: sums of partials times earlier entries; or an algebraic loop,
   F_w dw = -F_a da, with `n` unknowns. */
typedef struct {
    int32_t is_loop, lo, hi, n;
    int32_t nterms;                    /* of all sums; of F_a */
    const int32_t *starts;             /* (hi - lo): where the terms of each entry begin; null: one each */
    const int32_t *partials, *sources; /* (nterms); sources null: all are 1 */
    const int32_t *places;             /* (nterms) of F_a: flat, by rows */
    int32_t ninner;
    const int32_t *inner_places, *inner_partials;
    const double *own;                 /* (n) */
} BlocksSum;

typedef struct {
    int32_t side, n;
    const int32_t *entries;
} BlocksOff;

/* `nrows` by `ncolumns`, sparse by columns. All that is read is one row of arguments: x d s p u tick h, outputs, t,
   numbers. */
struct BlocksJacobian {
    int32_t nrows, ncolumns, npartials, nentries, narguments, nprobed, nnumbers, nsums, noff_partials, noff, nmost;
    const double *numbers;
    const BlocksSum *sums;
    const BlocksOff *off_partials, *off; /* what is 0 where a subdiagram is off */
    const uint8_t *is_unused;            /* (npartials) */
    const int32_t *first, *rows, *entries; /* (ncolumns + 1), of each value its row and its entry */
    void (*partials)(const double *arguments, const double *tables, double *out);
    BlocksProgram outputs; /* that partials need: (nprobed) */
};

/* How many doubles the work on a Jacobian takes. */
size_t blocks_jacobian_room(const BlocksJacobian *j);

/* The values of the pattern at (t, x), with all else as the memory of the run has it; NaN: not finite. */
void blocks_jacobian(const BlocksJacobian *j, const BlocksSim *s, double t, const double *x, double *room, double *data);

#endif
