/* What an emitted model gives to the runtime, and the arithmetic that both share.

   A model is one C file: inline functions, one for each block type and group of results; programs, which call them in
   the order of the Plan; and the table `blocks_model`. Programs read the memory of one run and write what they compute;
   they keep nothing of their own, so that many runs may use one model at once. */
#ifndef BLOCKS_MODEL_H
#define BLOCKS_MODEL_H

#include <math.h>
#include <stdint.h>
#include <string.h>

/* Programs that run at instants: they are compiled quickly, as large diagrams have many of them. */
#if defined(__OPTIMIZE__) && defined(__GNUC__) && !defined(__clang__)
#define BLOCKS_COLD __attribute__((noinline, optimize("O1", "fp-contract=off", "no-math-errno", "no-trapping-math")))
#else
#define BLOCKS_COLD __attribute__((noinline))
#endif

/* The rows of one run. States stand in the order of the model, all else in that of the Plan. Sides are 0 or 1; tick
   numbers are whole. */
typedef struct {
    double *x;       /* states */
    double *d;       /* discretes and held outputs */
    double *s;       /* sides */
    double *p;       /* parameters */
    double *u;       /* inputs */
    double *h;       /* histories */
    double *z;       /* last solutions of algebraic loops */
    double *k;       /* tick numbers by rate */
    double *q;       /* what depends on parameters alone: made by `prepare` */
    double *v;       /* what depends on q, d, s and k alone: made by `refresh` */
    double *w;       /* scratch of programs whose loops have many lanes */
    int64_t same;    /* whether all lanes of loops have the same parameters: made after `prepare` */
    const double *n; /* numbers that stand in the diagram */
    const double *c; /* tables, one after the other */
    void *f;         /* FMUs, which fmu_bridge.h knows */
} BlocksMemory;

/* A program at time t and states x, with all else from memory. */
typedef void (*BlocksProgram)(const BlocksMemory *m, double t, const double *x, double *out);

/* What is looked at inside a step: `n` values, and the phases that say how far what is periodic on their way has turned.
   states: those that both need. histories: the delays that they read. bent: which values five of a part do not tell;
   null: none. checks: at how many further points a part is compared with the polynomial through them. */
typedef struct {
    BlocksProgram values, phases;
    int32_t n, nphases, nstates, nhistories;
    const int *states, *histories;
    const uint8_t *bent;
    int32_t checks;
} BlocksLook;

/* The equations of an algebraic loop by its n torn unknowns: residuals (n), then the other unknowns; and the residuals'
   partial derivatives (n, n) row by row. `known` holds what the loop takes from outside. */
typedef void (*BlocksSystem)(const BlocksMemory *m, const double *known, const double *unknowns, double *residuals,
                             double *matrix);

/* Bounds on the rounding of the residuals (n), in units of 2^-52. */
typedef void (*BlocksRounding)(const BlocksMemory *m, const double *known, const double *unknowns, double *bounds);

/* Newton's method from the guess in the first n `unknowns`. All become the solution, or NaN where none is found. */
void blocks_newton(BlocksSystem system, BlocksRounding rounding, const BlocksMemory *m, const double *known, int n,
                   int others, double *unknowns);

/* How far rounding may move all unknowns from a solution, whose torn ones stand in `unknowns`; 0 where that is not known. bounds:
   those of the residuals, and behind them of the other unknowns where the torn ones are exact. */
void blocks_spread(BlocksSystem system, BlocksRounding bounds, const BlocksMemory *m, const double *known, int n, int others,
                   double *unknowns);

/* How many of the n increasing points are at most x; NaN counts as above all. */
static inline double blocks_search(double x, const double *points, int n)
{
    int low = 0, high = n;
    while (low < high) {
        int middle = (low + high) / 2;
        if (x < points[middle]) high = middle;
        else low = middle + 1;
    }
    return low;
}

/* The element of a table at a whole number; beyond the ends the first or the last. NaN gives NaN. */
static inline double blocks_pick(double index, const double *values, int n)
{
    if (isnan(index)) return index;
    return values[index <= 0.0 ? 0 : index >= n - 1.0 ? n - 1 : (int)index];
}

/* NaN goes through, as in numpy: a < b ? a : b alone would turn it into a bound. In two steps and without "||", whose
   bytes would make gcc's vectors of doubles ones of 16 lanes. */
static inline double blocks_min(double a, double b)
{
    double least = a < b ? a : b;
    return a != a ? a : least;
}
static inline double blocks_max(double a, double b)
{
    double most = a > b ? a : b;
    return a != a ? a : most;
}

/* The same where the bound is never NaN: one instruction in a loop over many instances. Of a few, a step waits for each
   value in turn, and a branch, which is foreseen nearly always, makes none wait. */
#if defined(BLOCKS_NX) && BLOCKS_NX <= 32 && defined(__GNUC__)
static inline double blocks_at_most(double a, double bound)
{
    if (__builtin_expect(bound < a, 0)) return bound;
    return a;
}
static inline double blocks_at_least(double a, double bound)
{
    if (__builtin_expect(bound > a, 0)) return bound;
    return a;
}
#else
static inline double blocks_at_most(double a, double bound) { return bound < a ? bound : a; }
static inline double blocks_at_least(double a, double bound) { return bound > a ? bound : a; }
#endif
static inline double blocks_sign(double a) { return a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : a; }

#endif
