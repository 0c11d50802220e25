/* The paper's robot under the improved ADRC (diagrams/paper/iadrc.json) with the signals that its file records.

   Equations as the blocks INTD, INLSEF, SMESO, PMDCMotor, WheelMixing and Kinematics have them. ALGEBRA 1 changes what
   another author might: 1/(1 + exp) in place of tanh, and one logarithm in place of two powers of the same error.
   ROBOTS: so many of them, one after the other; the signals are those of the first. */
#ifndef ALGEBRA
#define ALGEBRA 0
#endif
#ifndef ROBOTS
#define ROBOTS 1
#endif
#define NX (22 * ROBOTS)
#define NY 16
#define SIDES 0

#include <math.h>

typedef struct {
    double tau;
} Mode;

/* States of one wheel: r1, r2, I, z1, z2, z3, omega, i; then x, y, theta of the robot and of the wanted path. */
static const double Ra = 0.1557, La = 0.82, kb = 1.185, kt = 1.1882, n = 3.0, Jeq = 0.2752, Beq = 0.3922;
static const double rw = 0.075, D = 0.40, delta = 3.8831, R = 16.8199;
#define B0 (1.1882 / (0.82 * 0.2752 * 3.0))

static inline double power(double e, double a) { return copysign(pow(fabs(e), a), e); }

#if ALGEBRA
static inline double bell(double m, double e) { return 1.0 / (1.0 + exp(m * e * e)); }
#else
static inline double bell(double m, double e) { return 0.5 * (1.0 - tanh(0.5 * m * e * e)); }
#endif

static inline double g_of(double e)
{
#if ALGEBRA
    double l = log(fabs(e));
    return copysign(0.6265 * exp(0.8433 * l) + 0.5878 * exp(1.04078 * l), e);
#else
    return 0.6265 * power(e, 0.8433) + 0.5878 * power(e, 1.04078);
#endif
}

static inline double control(const double *x)
{
    double e1 = x[0] - x[3], e2 = x[1] - x[4];
    double v = (144.6642 + 8.0475 * bell(44.3160, e1)) * power(e1, 0.9675)
               + (25.5574 + 4.8814 * bell(48.8179, e2)) * power(e2, 1.4487)
               + 0.5308 * bell(26.1493, x[2]) * power(x[2], 3.5032);
    return delta * tanh(v * (1.0 / delta)) - x[5] * (1.0 / B0);
}

static inline void wheel(const double *x, double tau, double *dx)
{
    double u = control(x), g = g_of(x[6] - x[3]);
    dx[0] = x[1];
    dx[1] = -(R * R) * tanh((2.1555 / 11.9554) * (x[0] - 1.0)) - R * x[1];
    dx[2] = x[0] - x[3];
    dx[3] = x[4] + 30.4 * g;
    dx[4] = x[5] + B0 * u + 513.4 * g;
    dx[5] = 1570.8 * g;
    dx[6] = (-Beq / Jeq) * x[6] + (kt / (Jeq * n)) * x[7] - tau * (1.0 / (Jeq * n * n));
    dx[7] = (-kb * n / La) * x[6] - (Ra / La) * x[7] + u * (1.0 / La);
}

static inline void robot(const Mode *m, const double *x, double *dx)
{
    wheel(x, m->tau, dx);
    wheel(x + 8, 0.0, dx + 8);
    double v = 0.5 * rw * (x[6] + x[14]);
    dx[16] = v * cos(x[18]);
    dx[17] = v * sin(x[18]);
    dx[18] = (rw / D) * (x[6] - x[14]);
    dx[19] = rw * cos(x[21]);
    dx[20] = rw * sin(x[21]);
    dx[21] = 0.0;
}

static inline void rhs(const Mode *m, double t, const double *x, double *dx)
{
    (void)t;
    for (int i = 0; i < ROBOTS; i++) robot(m, x + 22 * i, dx + 22 * i);
}

static inline void outputs(const Mode *m, const double *x, double *y)
{
    double f1 = (-Beq / Jeq) * x[6] + (kt / (Jeq * n)) * x[7], f2 = (-kb * n / La) * x[6] - (Ra / La) * x[7];
    double fh = (-Beq / Jeq) * f1 + (kt / (Jeq * n)) * f2;
    y[0] = 1.0;
    y[1] = x[6];
    y[2] = x[14];
    y[3] = control(x);
    y[4] = control(x + 8);
    y[5] = x[5];
    y[6] = x[13];
    y[7] = x[5] * (1.0 / B0);
    y[8] = fh * (1.0 / B0) + m->tau * (Beq / Jeq / (Jeq * n * n) / B0);
    y[9] = m->tau;
    y[10] = x[21] - x[18];
    y[11] = x[16];
    y[12] = x[17];
    y[13] = x[18];
    y[14] = x[19];
    y[15] = x[20];
}

#include "solver.h"

/* As in p1.c. At the torque's edges two rows stand: before and after. */
double run(double stop, double rtol, double atol, long step_n, long step_d, long every, long unit, double *rows,
           long *counts)
{
    double begun = now_s();
    static const double edges[] = {25.0, 50.0, INFINITY}, torque[] = {0.0, 3.0, 0.0};
    double *next = rows;
    Run r = {.error = 1e-4, .every = every, .unit = unit};
    Mode m = {0};
    for (int i = 0; i < ROBOTS; i++) r.x[22 * i + 18] = r.x[22 * i + 21] = 0.78539816339744830962;
    for (int part = 0; r.t < stop && next; part++) {
        double target = edges[part] < stop ? edges[part] : stop;
        if (part) record(&m, r.t, r.x, &next);
        m.tau = torque[part];
        next = step_n ? fixed_to(&r, &m, target, step_n, step_d, next)
                      : adaptive_to(&r, &m, target, rtol, atol, stop / 50.0, next);
    }
    if (!next) return -1.0;
    record(&m, r.t, r.x, &next);
    counts[0] = r.steps, counts[1] = r.rejected, counts[2] = (next - rows) / (1 + NY);
    return now_s() - begun;
}
