/* rk4 and dopri5 for one problem. A program includes this file after it has defined

       NX, NY               the number of states and of recorded signals
       Mode                 what is constant between two instants
       rhs(m, t, x, dx)     the derivatives
       outputs(m, x, y)     the recorded signals
       SIDES, crossings(m, x, v)    how many signs are located, and their values; SIDES 0: none

   All sizes are constants, so that short loops disappear. Same method, error norm, step control and first step as
   blocks/engines/reference/methods.py and blocks/engines/reference/reference_engine.py. */
#include <math.h>
#include <string.h>
#include <time.h>

#define EPSILON 2.220446049250313e-16
#if NX <= 32
#define EACH(i, n) _Pragma("GCC unroll 32") for (int i = 0; i < (n); i++)
#else
#define EACH(i, n) for (int i = 0; i < (n); i++)
#endif

typedef struct {
    double t, h, error;
    double x[NX];
    long steps, rejected, row;
    long every, unit; /* row times: row * every / unit */
} Run;

static inline double row_time(const Run *r, long row) { return (double)(row * r->every) / (double)r->unit; }

static inline void record(const Mode *m, double t, const double *x, double **next)
{
    double *row = *next;
    row[0] = t;
    outputs(m, x, row + 1);
    *next = row + 1 + NY;
}

static double now_s(void)
{
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    return (double)at.tv_sec + 1e-9 * (double)at.tv_nsec;
}

/* --- dopri5: Dormand and Prince 1980; dense output by Shampine 1986 */

static inline void dopri5_trial(const Mode *m, double t, double h, const double *x, double (*k)[NX], double *x1)
{
    double s[NX];
    EACH(i, NX) s[i] = x[i] + h * (1.0 / 5 * k[0][i]);
    rhs(m, t + 1.0 / 5 * h, s, k[1]);
    EACH(i, NX) s[i] = x[i] + h * (3.0 / 40 * k[0][i] + 9.0 / 40 * k[1][i]);
    rhs(m, t + 3.0 / 10 * h, s, k[2]);
    EACH(i, NX) s[i] = x[i] + h * (44.0 / 45 * k[0][i] - 56.0 / 15 * k[1][i] + 32.0 / 9 * k[2][i]);
    rhs(m, t + 4.0 / 5 * h, s, k[3]);
    EACH(i, NX) s[i] = x[i] + h * (19372.0 / 6561 * k[0][i] - 25360.0 / 2187 * k[1][i] + 64448.0 / 6561 * k[2][i]
                                   - 212.0 / 729 * k[3][i]);
    rhs(m, t + 8.0 / 9 * h, s, k[4]);
    EACH(i, NX) s[i] = x[i] + h * (9017.0 / 3168 * k[0][i] - 355.0 / 33 * k[1][i] + 46732.0 / 5247 * k[2][i]
                                   + 49.0 / 176 * k[3][i] - 5103.0 / 18656 * k[4][i]);
    rhs(m, t + h, s, k[5]);
    EACH(i, NX) x1[i] = x[i] + h * (35.0 / 384 * k[0][i] + 500.0 / 1113 * k[2][i] + 125.0 / 192 * k[3][i]
                                    - 2187.0 / 6784 * k[4][i] + 11.0 / 84 * k[5][i]);
    rhs(m, t + h, x1, k[6]);
}

/* The largest error over the states, each by its own tolerance; inf where a state is not finite. */
static inline double dopri5_error(double h, double (*k)[NX], const double *x, const double *x1, double rtol, double atol)
{
    double most = 0.0, sum = 0.0;
    EACH(i, NX) {
        double e = h * (71.0 / 57600 * k[0][i] - 71.0 / 16695 * k[2][i] + 71.0 / 1920 * k[3][i]
                        - 17253.0 / 339200 * k[4][i] + 22.0 / 525 * k[5][i] - 1.0 / 40 * k[6][i]);
        double a = fabs(x[i]), b = fabs(x1[i]);
        double part = fabs(e) / (atol + rtol * (a > b ? a : b));
        most = part > most ? part : most;
        sum += x1[i];
    }
    return sum - sum == 0.0 ? most : INFINITY;
}

/* Weights of theta, ..., theta^4. */
static inline void dopri5_dense(double h, double (*k)[NX], double q[4][NX])
{
    EACH(i, NX) {
        q[0][i] = h * k[0][i];
        q[1][i] = h * (-8048581381.0 / 2820520608 * k[0][i] + 131558114200.0 / 32700410799 * k[2][i]
                       - 1754552775.0 / 470086768 * k[3][i] + 127303824393.0 / 49829197408 * k[4][i]
                       - 282668133.0 / 205662961 * k[5][i] + 40617522.0 / 29380423 * k[6][i]);
        q[2][i] = h * (8663915743.0 / 2820520608 * k[0][i] - 68118460800.0 / 10900136933 * k[2][i]
                       + 14199869525.0 / 1410260304 * k[3][i] - 318862633887.0 / 49829197408 * k[4][i]
                       + 2019193451.0 / 616988883 * k[5][i] - 110615467.0 / 29380423 * k[6][i]);
        q[3][i] = h * (-12715105075.0 / 11282082432 * k[0][i] + 87487479700.0 / 32700410799 * k[2][i]
                       - 10690763975.0 / 1880347072 * k[3][i] + 701980252875.0 / 199316789632 * k[4][i]
                       - 1453857185.0 / 822651844 * k[5][i] + 69997945.0 / 29380423 * k[6][i]);
    }
}

static inline void dense_at(const double *x, double q[4][NX], double theta, double *made)
{
    EACH(i, NX) made[i] = x[i] + theta * (q[0][i] + theta * (q[1][i] + theta * (q[2][i] + theta * q[3][i])));
}

/* Hairer's rule for a first step. */
static double dopri5_first(const Mode *m, double t, const double *x, const double *k0, double rtol, double atol, double most)
{
    double d0 = 0.0, d1 = 0.0, d2 = 0.0, s[NX], k1[NX];
    for (int i = 0; i < NX; i++) {
        double scale = atol + rtol * fabs(x[i]);
        d0 = fmax(d0, fabs(x[i]) / scale);
        d1 = fmax(d1, fabs(k0[i]) / scale);
    }
    double h0 = fmin(d0 < 1e-5 || d1 < 1e-5 ? 1e-6 : 0.01 * d0 / d1, most);
    for (int i = 0; i < NX; i++) s[i] = x[i] + h0 * k0[i];
    rhs(m, t + h0, s, k1);
    for (int i = 0; i < NX; i++) d2 = fmax(d2, fabs(k1[i] - k0[i]) / (atol + rtol * fabs(x[i])) / h0);
    double h1 = fmax(d1, d2) <= 1e-15 ? fmax(1e-6, h0 * 1e-3) : pow(0.01 / fmax(d1, d2), 1.0 / 6);
    return fmin(fmin(100.0 * h0, h1), most);
}

/* --- rk4 */

static inline void rk4_trial(const Mode *m, double t, double h, const double *x, double (*k)[NX], double *x1)
{
    const double h2 = 0.5 * h, h3 = h / 3.0, h6 = h / 6.0;
    double s[NX];
    EACH(i, NX) s[i] = x[i] + h2 * k[0][i];
    rhs(m, t + h2, s, k[1]);
    EACH(i, NX) s[i] = x[i] + h2 * k[1][i];
    rhs(m, t + h2, s, k[2]);
    EACH(i, NX) s[i] = x[i] + h * k[2][i];
    rhs(m, t + h, s, k[3]);
    EACH(i, NX) x1[i] = (x[i] + h6 * k[0][i] + h3 * k[1][i] + h3 * k[2][i]) + h6 * k[3][i];
}

/* --- located crossings */

#if SIDES > 0
typedef void Trial(const Mode *, double, double, const double *, double (*)[NX], double *);

/* How far the farthest side is beyond its crossing; negative where none has changed. */
static double beyond(const Mode *m, const double *x)
{
    double v[SIDES], most = -INFINITY;
    crossings(m, x, v);
    for (int j = 0; j < SIDES; j++) {
        double d = m->side[j] ? -v[j] : v[j];
        most = d > most ? d : most;
    }
    return most;
}

static inline int is_changed(const Mode *m, const double *x)
{
    double v[SIDES];
    crossings(m, x, v);
    int changed = 0;
    for (int j = 0; j < SIDES; j++) changed |= (v[j] >= 0.0) != m->side[j];
    return changed;
}

/* What changes may change the value of another crossing: until quiet. */
static void latch(Mode *m, const double *x)
{
    double v[SIDES];
    for (int changed = 1; changed;) {
        changed = 0;
        crossings(m, x, v);
        for (int j = 0; j < SIDES; j++) {
            int side = v[j] >= 0.0;
            changed |= side != m->side[j];
            m->side[j] = side;
        }
    }
}

/* The step of size at most h after which a side has first changed, to 4 ulp of t, and the states after it. Regula falsi
   by the Illinois rule on real steps from x, where the derivatives are k0. */
static __attribute__((noinline)) double locate(const Mode *m, double t, double h, const double *x, const double *k0,
                                               const double *x_end, Trial *trial, double *x1)
{
    double k[7][NX], s[NX], low = 0.0, high = h, fine = 4.0 * EPSILON * (t + h);
    double f_low = beyond(m, x), f_high = beyond(m, x_end);
    memcpy(k[0], k0, sizeof k[0]);
    memcpy(x1, x_end, NX * sizeof *x1);
    for (int round = 0, last = 0; high - low > fine; round++) {
        double size = round % 8 == 7 ? 0.5 * (low + high) : low - f_low * (high - low) / (f_high - f_low);
        size = fmax(low + 0.5 * fine, fmin(size, high - 0.5 * fine));
        if (!(low < size && size < high)) break;
        trial(m, t, size, x, k, s);
        double f = beyond(m, s);
        if (f >= 0.0) {
            high = size, f_high = f;
            memcpy(x1, s, sizeof s);
            if (last > 0) f_low *= 0.5;
            last = 1;
        } else {
            low = size, f_low = f;
            if (last < 0) f_high *= 0.5;
            last = -1;
        }
    }
    return high;
}
#endif

/* --- runs up to an instant; rows strictly before it are written. Both return where the next row is to stand.

   States and derivatives are kept in arrays whose addresses go nowhere, so that they can live in registers. */

/* most: the longest step. NULL: the step became too small. */
static inline double *adaptive_to(Run *r, Mode *m, double target, double rtol, double atol, double most, double *next)
{
    double x[NX], x1[NX], k[7][NX], t = r->t, at = row_time(r, r->row);
    EACH(i, NX) x[i] = r->x[i];
    rhs(m, t, x, k[0]);
    while (t < target) {
        double left = target - t, least = 16.0 * EPSILON * t, grow = 10.0, t1, step, error, h = r->h;
        if (h <= 0.0) {
            double x0[NX], k0[NX];
            EACH(i, NX) x0[i] = x[i], k0[i] = k[0][i];
            h = dopri5_first(m, t, x0, k0, rtol, atol, left);
        }
        h = fmax(fmin(h, most), least);
        for (;;) {
            t1 = h >= left / 1.01 ? target : t + h;
            step = t1 - t;
            dopri5_trial(m, t, step, x, k, x1);
            error = dopri5_error(step, k, x, x1, rtol, atol);
            if (error <= 1.0) break;
            if (h <= least) return NULL;
            r->rejected++;
            grow = 1.0;
            h = fmax(step * (error < INFINITY ? fmax(0.2, 0.9 * pow(error, -0.2)) : 0.1), least);
        }
        double factor = 0.9 * pow(r->error, 0.04) * pow(fmax(error, 1e-10), -(0.2 - 0.75 * 0.04));
        double proposed = step * fmin(grow, fmax(0.2, factor));
        r->h = step < h ? fmax(proposed, h) : proposed;
        r->error = fmax(error, 1e-4);
        const double whole = step;
        int cut = 0;
#if SIDES > 0
        if (is_changed(m, x1)) {
            double x0[NX], k0[NX], end[NX], made[NX];
            EACH(i, NX) x0[i] = x[i], k0[i] = k[0][i], end[i] = x1[i];
            step = locate(m, t, step, x0, k0, end, dopri5_trial, made);
            EACH(i, NX) x1[i] = made[i];
            if (t + step < t1) t1 = t + step;
            cut = 1;
        }
#endif
        if (at < t1) {
            double q[4][NX];
            dopri5_dense(whole, k, q);
            do {
                double s[NX];
                dense_at(x, q, (at - t) / whole, s);
                record(m, at, s, &next);
                at = row_time(r, ++r->row);
            } while (at < t1);
        }
        EACH(i, NX) x[i] = x1[i];
        t = t1;
        r->steps++;
        if (cut) {
#if SIDES > 0
            latch(m, x1);
#endif
            rhs(m, t, x, k[0]);
        } else {
            EACH(i, NX) k[0][i] = k[6][i];
        }
    }
    EACH(i, NX) r->x[i] = x[i];
    r->t = t;
    return next;
}

/* Steps of n/d s up to a target on that grid. Rows stand on the grid too. */
static inline double *fixed_to(Run *r, Mode *m, double target, long n, long d, double *next)
{
    double x[NX], x1[NX], k[4][NX], t = r->t, at = row_time(r, r->row);
    const double h = (double)n / (double)d;
    long count = lround(t / h);
    EACH(i, NX) x[i] = r->x[i];
    while (t < target) {
        if (at == t) {
            double s[NX];
            EACH(i, NX) s[i] = x[i];
            record(m, at, s, &next);
            at = row_time(r, ++r->row);
        }
        double t1 = (double)(++count * n) / (double)d;
        rhs(m, t, x, k[0]);
        rk4_trial(m, t, h, x, k, x1);
#if SIDES > 0
        if (is_changed(m, x1)) {
            /* To the crossing, and on to the grid; there may be another one on the way. */
            double x0[NX], k0[NX], end[NX], made[NX], step = h;
            EACH(i, NX) x0[i] = x[i], k0[i] = k[0][i], end[i] = x1[i];
            do {
                t += locate(m, t, step, x0, k0, end, rk4_trial, made);
                latch(m, made);
                memcpy(x0, made, sizeof x0);
                step = t1 - t;
                if (!(step > 0.0)) break;
                r->steps++;
                rhs(m, t, x0, k0);
                double again[4][NX];
                memcpy(again[0], k0, sizeof k0);
                rk4_trial(m, t, step, x0, again, end);
            } while (is_changed(m, end));
            if (step > 0.0) memcpy(x0, end, sizeof x0);
            EACH(i, NX) x1[i] = x0[i];
        }
#endif
        EACH(i, NX) x[i] = x1[i];
        t = t1;
        r->steps++;
    }
    EACH(i, NX) r->x[i] = x[i];
    r->t = t;
    return next;
}
