/* What instants cost: KIND 0, a filter behind a pulse train, whose edges are known; 1, a plant under a sampled controller;
   2, a plant in a loop with a relay, whose switching instants are located.

       y' = v      v' = w^2 (u - y) - 2 d w v

   0: w = 1000, d = 0.6; u is 12 for the first 0.4 of each 50 us, else 0; rk4 10 us, which every edge meets
   1: w = 5, d = 0.6; u = 0.5 e + I, sampled each 1 ms, e = 1 - y, I the sum of 1e-3 2 e so far; rk4 1 ms
   2: w = 5, d = 0.6; u = 8 where -y reaches 0.125, -8 where it falls below -0.125; dopri5, or rk4 1 ms */
#define NX 2
#define NY 2
#define SIDES (KIND == 2)

typedef struct {
    double u;
    double sum; /* of the controller */
    int side[1];
} Mode;

#define W (KIND == 0 ? 1000.0 : 5.0)

static inline double input(const Mode *m) { return KIND == 2 ? (m->side[0] ? 8.0 : -8.0) : m->u; }

static inline void rhs(const Mode *m, double t, const double *x, double *dx)
{
    (void)t;
    dx[0] = x[1];
    dx[1] = W * W * (input(m) - x[0]) - 2.0 * 0.6 * W * x[1];
}

static inline void outputs(const Mode *m, const double *x, double *y)
{
    y[0] = x[0];
    y[1] = input(m);
}

#if SIDES
static inline void crossings(const Mode *m, const double *x, double *v)
{
    v[0] = -x[0] - (m->side[0] ? -0.125 : 0.125);
}
#endif

#include "solver.h"

/* As in p1.c. KIND 0 and 1: `step_n` is not 0. */
double run(double stop, double rtol, double atol, long step_n, long step_d, long every, long unit, double *rows,
           long *counts)
{
    double begun = now_s(), *next = rows;
    Run r = {.error = 1e-4, .every = every, .unit = unit};
    Mode m = {0};
#if KIND == 2
    latch(&m, r.x);
    next = step_n ? fixed_to(&r, &m, stop, step_n, step_d, next)
                  : adaptive_to(&r, &m, stop, rtol, atol, stop / 50.0, next);
    if (!next) return -1.0;
#else
    (void)rtol, (void)atol, (void)adaptive_to;
    for (long k = 0;; k++) {
#if KIND == 0
        double target = (double)(k / 2 * 5 + (k % 2 ? 5 : 2)) / 1e5;
        m.u = k % 2 ? 0.0 : 12.0;
#else
        double target = (double)(k + 1) / 1000.0, e = 1.0 - r.x[0];
        m.u = 0.5 * e + m.sum;
        m.sum += 1e-3 * 2.0 * e;
#endif
        if (r.t >= stop) break;
        next = fixed_to(&r, &m, target < stop ? target : stop, step_n, step_d, next);
    }
#endif
    record(&m, r.t, r.x, &next);
    counts[0] = r.steps, counts[1] = r.rejected, counts[2] = (next - rows) / (1 + NY);
    return now_s() - begun;
}
