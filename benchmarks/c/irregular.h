/* What surrounds the equations that benchmarks/irregular.py writes: included before them, and with RUN after them. */
#ifndef RUN
typedef struct {
    double held[NH], on[5]; /* held values; 1 from the edge of each group of set points on */
    int side[SIDES];
} Mode;

static void rhs(const Mode *m, double t, const double *restrict x, double *restrict dx);
static void crossings(const Mode *m, const double *restrict x, double *restrict v);
static void outputs(const Mode *m, const double *x, double *y);
#else
static void outputs(const Mode *m, const double *x, double *y)
{
    (void)m;
    for (int j = 0; j < NY; j++) y[j] = x[recorded[j]];
}

#include "solver.h"

/* As in p1.c, for rk4 on a grid of which the ticks are points. */
double run(double stop, double rtol, double atol, long step_n, long step_d, long every, long unit, double *rows,
           long *counts)
{
    double begun = now_s(), *next = rows;
    static Run r;
    static Mode m;
    (void)rtol, (void)atol, (void)adaptive_to;
    memset(&r, 0, sizeof r);
    memset(&m, 0, sizeof m);
    r.every = every, r.unit = unit;
    for (long tick = 0;; tick++) { /* one each 5 ms */
        if (tick % 20 == 0 && tick <= 80) m.on[tick / 20] = 1.0;
        sample_fast(&m, r.x);
        if (tick % 2 == 0) sample_slow(&m, r.x);
        latch(&m, r.x);
        double target = (double)((tick + 1) * 5) / 1000.0;
        if (r.t >= stop) break;
        next = fixed_to(&r, &m, target < stop ? target : stop, step_n, step_d, next);
    }
    record(&m, r.t, r.x, &next);
    counts[0] = r.steps, counts[1] = r.rejected, counts[2] = (next - rows) / (1 + NY);
    return now_s() - begun;
}
#endif
