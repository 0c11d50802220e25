/* P2: N loops of P1 in one diagram, rk4. A struct of arrays with the constant N, so that the compiler vectorises.
   No pass goes on to the next stage before all loops have done this one, as if the loops were coupled. DIVIDED as in
   p1.c. */
#ifndef N
#define N 10
#endif
#ifndef DIVIDED
#define DIVIDED 0
#endif
#define NR (N < 10 ? N : 10) /* recorded: the speeds of so many loops, evenly spread */

#include <math.h>
#include <string.h>
#include <time.h>

typedef struct {
    double w[N], i[N], z1[N], z2[N], z3[N];
} __attribute__((aligned(64))) States;

static inline __attribute__((always_inline)) void derivatives(double d, double w, double i, double z1, double z2,
                                                              double z3, double *dw, double *di, double *d1, double *d2,
                                                              double *d3)
{
    double e = w - z1;
#if DIVIDED
    double u = (144.0 * (1.0 - z1) + 25.0 * (0.0 - z2) - z3) / 1.755;
    u = u > 12.0 ? 12.0 : u < -12.0 ? -12.0 : u;
    *dw = (-0.3922 * 3.0 * w + 1.1882 * i - d) / (0.2752 * 3.0);
    *di = (-1.185 * 3.0 * w - 0.1557 * i + u) / 0.82;
#else
    double u = (144.0 * (1.0 - z1) - 25.0 * z2 - z3) * (1.0 / 1.755);
    u = u > 12.0 ? 12.0 : u < -12.0 ? -12.0 : u;
    *dw = (-0.3922 / 0.2752) * w + (1.1882 / (0.2752 * 3.0)) * i - d * (1.0 / (0.2752 * 3.0));
    *di = (-1.185 * 3.0 / 0.82) * w - (0.1557 / 0.82) * i + u * (1.0 / 0.82);
#endif
    *d1 = z2 + 30.4 * e;
    *d2 = z3 + 1.755 * u + 513.4 * e;
    *d3 = 1570.8 * e;
}

static States x, a, k[4];

/* The padding between the arrays is stepped along with them. */
#define COUNT (int)(sizeof(States) / sizeof(double))

static inline void rhs(double d, const States *restrict at, States *restrict dx)
{
    for (int j = 0; j < N; j++)
        derivatives(d, at->w[j], at->i[j], at->z1[j], at->z2[j], at->z3[j], &dx->w[j], &dx->i[j], &dx->z1[j], &dx->z2[j],
                    &dx->z3[j]);
}

static inline void step(double d, double h)
{
    const double h2 = 0.5 * h, h3 = h / 3.0, h6 = h / 6.0;
    double *p = (double *)&x, *s = (double *)&a;
    const double *k0 = (double *)&k[0], *k1 = (double *)&k[1], *k2 = (double *)&k[2], *k3 = (double *)&k[3];
    rhs(d, &x, &k[0]);
    for (int j = 0; j < COUNT; j++) s[j] = p[j] + h2 * k0[j];
    rhs(d, &a, &k[1]);
    for (int j = 0; j < COUNT; j++) s[j] = p[j] + h2 * k1[j];
    rhs(d, &a, &k[2]);
    for (int j = 0; j < COUNT; j++) s[j] = p[j] + h * k2[j];
    rhs(d, &a, &k[3]);
    for (int j = 0; j < COUNT; j++) p[j] += h6 * (k0[j] + k3[j]) + h3 * (k1[j] + k2[j]);
}
/* As in p1.c; rows hold the time and NR speeds. */
double run(double stop, double rtol, double atol, long step_n, long step_d, long every, long unit, double *rows,
           long *counts)
{
    struct timespec begin, end;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    (void)rtol, (void)atol;
    double h = (double)step_n / (double)step_d, t = 0.0, *next = rows;
    long row = 0, count = 0;
    memset(&x, 0, sizeof x);
    for (;;) {
        if (t == (double)(row * every) / (double)unit || t >= stop) {
            *next++ = t;
            for (int j = 0; j < NR; j++) *next++ = x.w[(long)j * N / NR];
            row++;
        }
        if (t >= stop) break;
        step(t >= 30.0 && t < 50.0 ? 2.0 : 0.0, h);
        t = (double)(++count * step_n) / (double)step_d;
    }
    counts[0] = count, counts[1] = 0, counts[2] = (next - rows) / (1 + NR);
    clock_gettime(CLOCK_MONOTONIC, &end);
    return (double)(end.tv_sec - begin.tv_sec) + 1e-9 * (double)(end.tv_nsec - begin.tv_nsec);
}
