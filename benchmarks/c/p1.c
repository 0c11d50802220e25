/* P1: a DC motor under linear ADRC with a saturated control.

       w' = -Beq/Jeq w + kt/(Jeq n) i - d/(Jeq n)      i' = -kb n/La w - Ra/La i + u/La
       z1' = z2 + 30.4 e      z2' = z3 + 1.755 u + 513.4 e      z3' = 1570.8 e      e = w - z1
       u = (144 (r - z1) - 25 z2 - z3)/1.755, limited to +-12
       r = 1; d = 2 for 30 <= t < 50, else 0

   LOCATED 0: the limits are part of the equations. LOCATED 1: the instants at which u reaches them are step ends.
   DIVIDED 0: all coefficients are computed beforehand. DIVIDED 1: the operations of the library's blocks, with their
   divisions, in the same order. */
#ifndef LOCATED
#define LOCATED 0
#endif
#ifndef DIVIDED
#define DIVIDED 0
#endif
#define NX 5
#define NY 3
#define SIDES (2 * LOCATED)

typedef struct {
    double d;
    int side[2]; /* u beyond the upper limit, below the lower one */
} Mode;

static inline double control(const double *x)
{
#if DIVIDED
    return (144.0 * (1.0 - x[2]) + 25.0 * (0.0 - x[3]) - x[4]) / 1.755;
#else
    return (144.0 * (1.0 - x[2]) - 25.0 * x[3] - x[4]) * (1.0 / 1.755);
#endif
}

static inline double limited(const Mode *m, double u)
{
#if LOCATED
    return m->side[0] ? 12.0 : m->side[1] ? -12.0 : u;
#else
    (void)m;
    return u > 12.0 ? 12.0 : u < -12.0 ? -12.0 : u;
#endif
}

static inline void rhs(const Mode *m, double t, const double *x, double *dx)
{
    (void)t;
    double u = limited(m, control(x)), e = x[0] - x[2];
#if DIVIDED
    dx[0] = (-0.3922 * 3.0 * x[0] + 1.1882 * x[1] - m->d) / (0.2752 * 3.0);
    dx[1] = (-1.185 * 3.0 * x[0] - 0.1557 * x[1] + u) / 0.82;
#else
    dx[0] = (-0.3922 / 0.2752) * x[0] + (1.1882 / (0.2752 * 3.0)) * x[1] - m->d * (1.0 / (0.2752 * 3.0));
    dx[1] = (-1.185 * 3.0 / 0.82) * x[0] - (0.1557 / 0.82) * x[1] + u * (1.0 / 0.82);
#endif
    dx[2] = x[3] + 30.4 * e;
    dx[3] = x[4] + 1.755 * u + 513.4 * e;
    dx[4] = 1570.8 * e;
}

static inline void outputs(const Mode *m, const double *x, double *y)
{
    y[0] = x[0];
    y[1] = limited(m, control(x));
    y[2] = x[4];
}

#if LOCATED
static inline void crossings(const Mode *m, const double *x, double *v)
{
    (void)m;
    double u = control(x);
    v[0] = u - 12.0;
    v[1] = -12.0 - u;
}
#endif

#include "solver.h"

/* From 0 to `stop` s; step_n 0: dopri5, else rk4 with steps of step_n/step_d s. counts: steps, rejected steps, rows.
   Returns the seconds that it took; below 0: it failed. */
double run(double stop, double rtol, double atol, long step_n, long step_d, long every, long unit, double *rows,
           long *counts)
{
    double begun = now_s();
    static const double edges[] = {30.0, 50.0, INFINITY}, torque[] = {0.0, 2.0, 0.0};
    double *next = rows;
    Run r = {.error = 1e-4, .every = every, .unit = unit};
    Mode m = {0};
#if LOCATED
    latch(&m, r.x);
#endif
    for (int part = 0; r.t < stop && next; part++) {
        double target = edges[part] < stop ? edges[part] : stop;
        m.d = torque[part];
        next = step_n ? fixed_to(&r, &m, target, step_n, step_d, next)
                      : adaptive_to(&r, &m, target, rtol, atol, stop / 50.0, next);
    }
    if (!next) return -1.0;
    record(&m, r.t, r.x, &next);
    counts[0] = r.steps, counts[1] = r.rejected, counts[2] = (next - rows) / (1 + NY);
    return now_s() - begun;
}
