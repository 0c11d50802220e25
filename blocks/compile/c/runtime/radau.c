/* Radau IIA of order 5: steps of stiff models. Its twin in Python, which says more about the why: engines/reference/stiff.py.

   The three stages x + z_i are solved together by a simplified Newton iteration, in the variables w = T^-1 z, where their
   matrix falls into a real and a complex one. What is kept from step to step stands in one row, `carried`, which is a part
   of snapshots; it counts while the rates at t do (has_first).

   Reference: Hairer and Wanner, Solving Ordinary Differential Equations II, IV.8 (the method, its iteration, control of
   the step by Gustafsson), and their program RADAU5. All of a step stands here, from its iteration to its acceptance, which
   makes the file long. */
#include "stiff.h"

#include <stdlib.h>

#define S6 2.449489742783178098
static const double C[] = {(4 - S6) / 10, (4 + S6) / 10, 1.0};
static const double EMBEDDED[] = {(-13 - 7 * S6) / 3, (-13 + 7 * S6) / 3, -1.0 / 3};
static const double REAL = 3.6378342527444957, RE = 2.6810828736277523, IM = -3.0504301992474105;
static const double T[3][2] = {{0.09443876248897524, -0.14125529502095421}, {0.25021312296533332, 0.20412935229379994}, {1, 1}};
static const double T2[] = {0.03002919410514742, -0.38294211275726192};
static const double TI[3][3] = {{4.17871859155190428, 0.32768282076106237, 0.52337644549944951},
                                {-4.17871859155190428, -0.32768282076106237, 0.47662355450055044},
                                {0.50287263494578682, -2.57192694985560522, 0.59603920482822492}};
/* Stages -> coefficients of the collocation polynomial, by powers of theta. */
static const double P[3][3] = {{13.0 / 3 + 7 * S6 / 3, -23.0 / 3 - 22 * S6 / 3, 10.0 / 3 + 5 * S6},
                               {13.0 / 3 - 7 * S6 / 3, -23.0 / 3 + 22 * S6 / 3, 10.0 / 3 - 5 * S6},
                               {1.0 / 3, -8.0 / 3, 10.0 / 3}};
/* The run holds the rates at t, these coefficients over h, and the rates at the end. */
const double blocks_stiff_dense[] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0};

enum { ITERATIONS = 7, TRIALS = 64 };
static const double SLOW = 1e-3, EPS = 2.220446049250313e-16;
static const double LEAST = 0.2, MOST = 8.0, SAFETY = 0.9, HELD = 1.2;

/* The places in `carried`: of the last step its length and error; how the iteration converged; for which step there are
   factors (0: none); whether the slopes are to be used. */
enum { LENGTH, ERROR, RATE, FACTORED, HAS_SLOPES, NUMBERS };

typedef struct {
    BlocksFactors *factors;
    double *polynomial; /* (3, nx) of the last step, in `carried`; as are slopes and, of sparse matrices, pivots */
    double *slopes, *pivots;
    double *z[3], *w[3], *f[3], *at, *weights, *moved, *groups, *from, *to, *room, *arena;
    double theta; /* how the last iteration converged */
    int32_t iterations, is_fresh; /* whether the slopes are those of the begin of this step */
} Radau;

static int32_t nvalues(const BlocksSim *s)
{
    const BlocksJacobian *slopes = s->model->implicit->slopes;
    return slopes->first[slopes->ncolumns];
}

int blocks_stiff_open(BlocksSim *s)
{
    const BlocksImplicit *implicit = s->model->implicit;
    const BlocksJacobian *slopes = implicit->slopes;
    size_t n = (size_t)s->model->nx + 1, wide = n + (size_t)s->model->ns + (size_t)s->model->nmeasured, values = (size_t)nvalues(s);
    Radau *r = s->implicit = calloc(1, sizeof *r);
    if (!r) return 1;
    s->ncarried = (int64_t)(NUMBERS + 3 * (n - 1) + values + (implicit->order ? n - 1 : 0));
    r->factors = blocks_factors_new((int32_t)n - 1, slopes->first, slopes->rows, implicit->order);
    r->arena = calloc((size_t)s->ncarried + 9 * n + 6 * wide + blocks_jacobian_room(slopes) + 8, sizeof(double));
    if (!r->arena || !r->factors) {
        blocks_stiff_close(s);
        return 1;
    }
    double *place = s->carried = r->arena;
    r->polynomial = place + NUMBERS, r->slopes = r->polynomial + 3 * (n - 1), r->pivots = r->slopes + values;
    place += s->ncarried;
    for (int i = 0; i < 3; i++) r->z[i] = place, r->w[i] = place + n, place += 2 * n;
    r->weights = place, r->from = place + n, r->to = place + 2 * n, place += 3 * n;
    for (int i = 0; i < 3; i++) r->f[i] = place, place += wide;
    r->at = place, r->moved = place + wide, r->groups = place + 2 * wide, r->room = place + 3 * wide;
    return 0;
}

void blocks_stiff_close(BlocksSim *s)
{
    Radau *r = s->implicit;
    if (!r) return;
    blocks_factors_free(r->factors);
    free(r->arena);
    free(r);
    s->implicit = NULL;
}

/* Nothing is known of steps before. */
static void forget(BlocksSim *s)
{
    const Radau *r = s->implicit;
    s->carried[LENGTH] = s->carried[FACTORED] = s->carried[HAS_SLOPES] = 0.0;
    s->carried[ERROR] = s->carried[RATE] = 1.0;
    if (s->model->implicit->order)
        for (int i = 0; i < s->model->nx; i++) r->pivots[i] = i;
}

/* Difference quotients for slopes that are not finite, to one side: 1 where some of these are not finite either. Columns
   that have no row in common are moved at once: of many equal blocks, no more than one of them takes. */
static int take_quotients(BlocksSim *s, double t, const double *x, const double *base, int side)
{
    Radau *r = s->implicit;
    const BlocksJacobian *j = s->model->implicit->slopes;
    const BlocksSetup *setup = s->setup;
    const int n = s->model->nx;
    double *slopes = r->slopes, *rates = r->f[1], *by_column = r->groups, *by_row = r->at; /* the last group of each; 0: none */
    int wrong = 0;
    memset(by_column, 0, (size_t)n * sizeof(double));
    memset(by_row, 0, (size_t)n * sizeof(double));
    for (double group = 1.0;; group += 1.0) {
        int is_empty = 1;
        memcpy(r->moved, x, (size_t)n * sizeof(double));
        for (int column = 0; column < n; column++) {
            int end = j->first[column + 1], is_asked = 0, is_free = by_column[column] == 0.0;
            for (int p = j->first[column]; p < end && is_free; p++) {
                is_asked |= !isfinite(slopes[p]);
                is_free = by_row[j->rows[p]] != group;
            }
            if (!is_asked || !is_free) continue;
            for (int p = j->first[column]; p < end; p++) by_row[j->rows[p]] = group;
            double nominal = setup->plain_atol > 0.0 ? setup->atol[column] / setup->plain_atol : 1.0;
            r->moved[column] += side * sqrt(EPS) * fmax(fabs(x[column]), nominal);
            by_column[column] = group;
            is_empty = 0;
        }
        if (is_empty) return wrong;
        blocks_rates(s, t, r->moved, rates);
        for (int column = 0; column < n; column++) {
            if (by_column[column] != group) continue;
            double step = r->moved[column] - x[column];
            for (int p = j->first[column]; p < j->first[column + 1]; p++) {
                if (!isfinite(slopes[p])) slopes[p] = (rates[j->rows[p]] - base[j->rows[p]]) / step;
                wrong |= !isfinite(slopes[p]);
            }
        }
    }
}

/* The slopes at (t, x); difference quotients where they are not finite: 0, or 1 where these are not either. */
static int take_slopes(BlocksSim *s, double t, const double *x)
{
    Radau *r = s->implicit;
    int missing = 0;
    if (s->moving) blocks_outside(s, t);
    blocks_jacobian(s->model->implicit->slopes, s, t, x, r->room, r->slopes);
    for (int p = 0; p < nvalues(s); p++) missing |= !isfinite(r->slopes[p]);
    if (missing) blocks_rates(s, t, x, r->f[0]);
    for (int side = 1; side >= -1 && missing; side -= 2) missing = take_quotients(s, t, x, r->f[0], side);
    if (missing) return 1;
    s->carried[FACTORED] = 0.0;
    s->carried[HAS_SLOPES] = r->is_fresh = 1;
    return 0;
}

/* Factors for steps of this length: 0; 1 where there are none; 2 where there is no memory. */
static int take_factors(BlocksSim *s, double h)
{
    Radau *r = s->implicit;
    int is_sparse = s->model->implicit->order != NULL, n = s->model->nx;
    s->carried[FACTORED] = 0.0;
    for (int i = 0; is_sparse && i < n; i++) r->factors->pivots[i] = (int32_t)r->pivots[i];
    int status = blocks_factor(r->factors, r->slopes, (BlocksPair){REAL / h, RE / h, IM / h});
    if (status) return status;
    for (int i = 0; is_sparse && i < n; i++) r->pivots[i] = r->factors->pivots[i];
    s->carried[FACTORED] = h;
    return 0;
}

/* Where the stages of a step of this length are looked for first: on the polynomial of the step before, where there is
   one. */
static void begin_stages(BlocksSim *s, double h)
{
    Radau *r = s->implicit;
    const int n = s->model->nx;
    const double *q0 = r->polynomial, *q1 = q0 + n, *q2 = q1 + n;
    if (s->carried[LENGTH] == 0.0) {
        for (int k = 0; k < 3; k++)
            memset(r->z[k], 0, (size_t)n * sizeof(double)), memset(r->w[k], 0, (size_t)n * sizeof(double));
        return;
    }
    for (int k = 0; k < 3; k++) {
        double theta = 1.0 + C[k] * h / s->carried[LENGTH], a = theta - 1.0, b = theta * theta - 1.0, c = theta * theta * theta - 1.0;
        for (int i = 0; i < n; i++) r->z[k][i] = a * q0[i] + b * q1[i] + c * q2[i];
    }
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < n; i++) r->w[k][i] = TI[k][0] * r->z[0][i] + TI[k][1] * r->z[1][i] + TI[k][2] * r->z[2][i];
}

/* One iteration: the largest change of w over its weights; NaN where a number is not finite. */
static double iterate(BlocksSim *s, double t, const double *x, double h)
{
    Radau *r = s->implicit;
    const int n = s->model->nx;
    double *restrict f0 = r->f[0], *restrict f1 = r->f[1], *restrict f2 = r->f[2];
    double *restrict w0 = r->w[0], *restrict w1 = r->w[1], *restrict w2 = r->w[2];
    double *restrict z0 = r->z[0], *restrict z1 = r->z[1], *restrict z2 = r->z[2];
    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < n; i++) r->at[i] = x[i] + r->z[k][i];
        blocks_rates(s, t + C[k] * h, r->at, r->f[k]);
    }
    const double real = REAL / h, re = RE / h, im = IM / h;
    for (int i = 0; i < n; i++) {
        double a = f0[i], b = f1[i], c = f2[i];
        f0[i] = TI[0][0] * a + TI[0][1] * b + TI[0][2] * c - real * w0[i];
        f1[i] = TI[1][0] * a + TI[1][1] * b + TI[1][2] * c - (re * w1[i] - im * w2[i]);
        f2[i] = TI[2][0] * a + TI[2][1] * b + TI[2][2] * c - (re * w2[i] + im * w1[i]);
    }
    blocks_solve(r->factors, f0, f1, f2);
    double most = 0.0, bad = 0.0;
    for (int i = 0; i < n; i++) {
        double a = fabs(f0[i]), b = fabs(f1[i]), c = fabs(f2[i]), larger = a > b ? a : b;
        larger = (c > larger ? c : larger) * r->weights[i];
        most = larger > most ? larger : most;
        bad += (a + b + c) * 0.0;
        w0[i] += f0[i], w1[i] += f1[i], w2[i] += f2[i];
        z0[i] = T[0][0] * w0[i] + T[0][1] * w1[i] + T2[0] * w2[i];
        z1[i] = T[1][0] * w0[i] + T[1][1] * w1[i] + T2[1] * w2[i];
        z2[i] = w0[i] + w1[i];
    }
    return bad == 0.0 ? most : NAN;
}

static void weigh(BlocksSim *s, const double *x)
{
    const BlocksSetup *setup = s->setup;
    Radau *r = s->implicit;
    for (int i = 0; i < s->model->nx; i++) r->weights[i] = 1.0 / (setup->atol[i] + setup->rtol * fabs(x[i]));
}

/* Newton's iteration from z and w on: 0 where it has converged, to what changes a step by no more than its error may be;
   1 where it has not, or will not. */
static int converges(BlocksSim *s, double t, const double *x, double h)
{
    Radau *r = s->implicit;
    const double rtol = s->setup->rtol, needed = fmax(10.0 * EPS / rtol, fmin(0.03, sqrt(rtol)));
    double rate = pow(fmax(s->carried[RATE], EPS), 0.8), before = 0.0, ratio = 0.0;
    r->theta = SLOW;
    for (int k = 0; k < ITERATIONS; k++) {
        double change = iterate(s, t, x, h);
        r->iterations = k + 1;
        if (isnan(change)) return 1;
        if (k > 0) {
            double now = change / before;
            r->theta = k == 1 ? now : sqrt(now * ratio);
            ratio = now;
            if (!(r->theta < 0.99)) return 1;
            rate = r->theta / (1.0 - r->theta);
            if (rate * change * pow(r->theta, ITERATIONS - 1 - k) >= needed && rate * change > needed) return 1;
        }
        before = fmax(change, EPS);
        if (rate * change <= needed) {
            s->carried[RATE] = fmax(rate, EPS); /* 0: none is known */
            return 0;
        }
    }
    return 1;
}

/* The largest error over the states of a step from x, where the rates are `first`, to x1, each by its own tolerance; infinite
   where one is not finite. again: whether it is filtered once more, as the error of a first step in a transient is far too
   large. */
static double error_of(BlocksSim *s, double t, const double *x, const double *first, const double *x1, double h, int again,
                       int32_t *worst)
{
    Radau *r = s->implicit;
    const BlocksSetup *setup = s->setup;
    const int n = s->model->nx;
    double *error = r->f[0], *embedded = r->f[1], most = 0.0;
    for (int i = 0; i < n; i++) {
        embedded[i] = (EMBEDDED[0] * r->z[0][i] + EMBEDDED[1] * r->z[1][i] + EMBEDDED[2] * r->z[2][i]) / h;
        error[i] = first[i] + embedded[i];
    }
    for (int pass = 0; pass < 2; pass++) {
        blocks_solve_real(r->factors, error);
        most = 0.0;
        *worst = 0;
        for (int i = 0; i < n; i++) {
            double a = fabs(x[i]), b = fabs(x1[i]), part = fabs(error[i]) / (setup->atol[i] + setup->rtol * (a > b ? a : b));
            if (!isfinite(part + b)) {
                *worst = i;
                return INFINITY;
            }
            if (part > most) most = part, *worst = i;
        }
        if (most < 1.0 || !again || pass == 1) break;
        for (int i = 0; i < n; i++) r->at[i] = x[i] + error[i];
        blocks_rates(s, t, r->at, r->f[2]);
        for (int i = 0; i < n; i++) error[i] = r->f[2][i] + embedded[i];
    }
    return most;
}

static int fails(BlocksSim *s, double h) { return blocks_fail(s, BLOCKS_NOT_CONVERGED, 0, h); }

static int no_memory(BlocksSim *s) { return blocks_fail(s, -1, 0, 0.0); }

/* How many times as long the next step may be as one of length h with this error. */
static double factor_of(const BlocksSim *s, double h, double error)
{
    const Radau *r = s->implicit;
    double safety = SAFETY * (1.0 + 2.0 * ITERATIONS) / (r->iterations + 2.0 * ITERATIONS);
    double factor = safety * pow(fmax(error, 1e-10), -0.25);
    if (error <= 1.0 && s->carried[LENGTH] > 0.0) {
        double foreseen = h / s->carried[LENGTH] * pow(s->carried[ERROR] / fmax(error * error, 1e-20), 0.25) * SAFETY;
        factor = fmin(factor, foreseen);
    }
    return fmax(LEAST, fmin(MOST, factor));
}

/* The error of a step of length h to t1, where the states and rates at its end are then known: infinite where a number is not
   finite, NaN where the iteration does not converge, -1 where there is no memory. */
static double tried(BlocksSim *s, double t1, double h, int again, int32_t *worst)
{
    const Radau *r = s->implicit;
    const int n = s->model->nx;
    const double t = s->t, *x = s->memory.x;
    int status = s->carried[FACTORED] == h ? 0 : take_factors(s, h);
    if (status) return status == 2 ? -1.0 : NAN;
    begin_stages(s, h);
    if (converges(s, t, x, h)) return NAN;
    for (int i = 0; i < n; i++) s->x1[i] = x[i] + r->z[2][i];
    double error = error_of(s, t, x, s->k[0], s->x1, h, again, worst), bad = 0.0;
    if (error > 1.0) return error;
    blocks_rates(s, t1, s->x1, s->k[4]);
    for (int i = 0; i < n; i++) bad += s->k[4][i] * 0.0;
    return bad == 0.0 ? error : INFINITY;
}

/* Take an accepted step to t1. most: how long the next one may be at most; proposed: as long as this one should have been. -1:
   and go on. */
static int take_step(BlocksSim *s, double t1, double h, double error, double most, double proposed, double target)
{
    Radau *r = s->implicit;
    const int n = s->model->nx, keeps = r->theta <= SLOW;
    double factor = fmin(factor_of(s, h, error), most);
    if (keeps && factor >= 1.0 && factor <= HELD) factor = 1.0; /* the factors serve once more */
    /* Of a step that the target cut short, the proposal before it still counts. */
    proposed = h < proposed ? fmax(h * factor, proposed) : h * factor;
    for (int j = 0; j < 3; j++)
        for (int i = 0; i < n; i++)
            s->k[1 + j][i] = (P[0][j] * r->z[0][i] + P[1][j] * r->z[1][i] + P[2][j] * r->z[2][i]) / h;
    int stopped = blocks_accept(s, t1, h, proposed, fmax(error, 1e-4), target);
    if (stopped == BLOCKS_FAILED || stopped == BLOCKS_REFUSED || !s->has_first) return stopped;
    for (int j = 0; j < 3; j++)
        for (int i = 0; i < n; i++) r->polynomial[j * n + i] = s->k[1 + j][i] * h;
    s->carried[LENGTH] = h;
    s->carried[ERROR] = fmax(error, 1e-2);
    if (!keeps) s->carried[HAS_SLOPES] = 0.0;
    return stopped;
}

/* One accepted step towards the target. -1: and go on. */
static int step_to(BlocksSim *s, double target)
{
    Radau *r = s->implicit;
    const double t = s->t, *x = s->memory.x, left = target - t, least = 16 * blocks_ulp(t);
    double h = s->h > 0.0 ? s->h : blocks_first_step(s, left), t1, step, error;
    const int is_first = s->carried[LENGTH] == 0.0;
    int rejected = 0;
    int32_t worst = 0;
    h = fmax(fmin(h, s->longest), least);
    r->is_fresh = 0;
again:
    weigh(s, x);
    for (;;) {
        /* The last step before the target is stretched a little rather than followed by a tiny one. */
        t1 = h >= left / 1.01 ? target : t + h;
        step = t1 - t;
        if (s->carried[HAS_SLOPES] == 0.0 && take_slopes(s, t, x)) return fails(s, step);
        error = tried(s, t1, step, is_first || rejected, &worst);
        if (error < 0.0) return no_memory(s);
        if (error <= 1.0) break;
        if (isnan(error) && !r->is_fresh) { /* with the slopes here, it may converge */
            s->carried[HAS_SLOPES] = 0.0;
            continue;
        }
        if (!isnan(error)) s->blamed[worst]++;
        if (h <= least || step <= least) return fails(s, step);
        double factor = isfinite(error) ? factor_of(s, step, error) : 0.5;
        if (is_first && !rejected && isfinite(error)) factor = fmin(factor, 0.1);
        h = fmax(step * factor, least);
        s->rejected++;
        rejected = 1;
    }
    int stopped = take_step(s, t1, step, error, rejected ? 1.0 : MOST, h, target);
    if (stopped != BLOCKS_REFUSED) return stopped;
    if (s->refused <= least) return fails(s, s->refused);
    h = fmax(s->refused * (isfinite(s->refused_error) ? fmax(LEAST, SAFETY * pow(s->refused_error, -0.25)) : 0.5), least);
    rejected = 1;
    if (!r->is_fresh) s->carried[HAS_SLOPES] = 0.0; /* those of a part of the step that was retaken */
    goto again;
}

/* The rates here; what is kept from steps before counts as long as they are known. */
static int first_rates(BlocksSim *s)
{
    if (s->has_first) return BLOCKS_FINE;
    forget(s);
    blocks_rates(s, s->t, s->memory.x, s->k[0]);
    for (int i = 0; i < s->model->nx; i++)
        if (!isfinite(s->k[0][i])) return blocks_fail(s, BLOCKS_NOT_FINITE, i, s->k[0][i]);
    s->has_first = 1;
    return BLOCKS_FINE;
}

int blocks_stiff_run(BlocksSim *s, double target)
{
    /* Of a run that goes on from a snapshot, factors are made anew, bit for bit as they were. */
    if (first_rates(s)) return BLOCKS_FAILED;
    if (s->carried[RATE] == 0.0) forget(s); /* another method or an older state has kept nothing */
    if (s->carried[FACTORED] > 0.0 && !s->is_factored && take_factors(s, s->carried[FACTORED])) s->carried[FACTORED] = 0.0;
    s->is_factored = 1;
    for (;;) {
        if (s->t >= s->soft || (--s->budget <= 0 && blocks_clock(s))) return BLOCKS_PAUSED;
        if (first_rates(s)) return BLOCKS_FAILED;
        int stopped = step_to(s, target);
        if (stopped >= 0) return stopped;
    }
}

/* The states after h from (t, x), to rounding: for those who look for a crossing on steps. In parts where that does not
   converge as a whole. The slopes are those of the begin. is_judged: and the largest error of a part. */
double blocks_stiff_trial(BlocksSim *s, double t, const double *x, double h, double *x1, int is_judged)
{
    Radau *r = s->implicit;
    const int n = s->model->nx;
    int32_t worst = 0;
    const double needed = 10.0 * EPS / s->setup->rtol;
    weigh(s, x);
    for (int parts = 1, part; parts <= TRIALS; parts *= 2) {
        double step = h / parts, most = 0.0;
        memcpy(r->from, x, (size_t)n * sizeof(double));
        for (part = 0; part < parts; part++) {
            double change = INFINITY, before;
            double then = t + part * step;
            if ((!r->is_fresh || part) && take_slopes(s, then, r->from)) break;
            r->is_fresh = part == 0;
            if (take_factors(s, step)) break;
            for (int k = 0; k < 3; k++)
                memset(r->z[k], 0, (size_t)n * sizeof(double)), memset(r->w[k], 0, (size_t)n * sizeof(double));
            for (int k = 0; k < 4 * ITERATIONS; k++) {
                before = change;
                change = iterate(s, then, r->from, step);
                if (!(change > needed) || (k > 2 && change >= before)) break;
            }
            if (!(change <= 1e-3)) break;
            if (is_judged) {
                const double *first = s->k[0];
                int32_t culprit = 0;
                if (part) blocks_rates(s, then, r->from, r->moved), first = r->moved;
                for (int i = 0; i < n; i++) r->to[i] = r->from[i] + r->z[2][i];
                double error = error_of(s, then, r->from, first, r->to, step, 1, &culprit);
                if (error > most) most = error, worst = culprit;
            }
            for (int i = 0; i < n; i++) r->from[i] += r->z[2][i];
        }
        if (part == parts) {
            memcpy(x1, r->from, (size_t)n * sizeof(double));
            if (most > 1.0) s->blamed[worst]++;
            return most;
        }
        r->is_fresh = 0;
    }
    for (int i = 0; i < n; i++) x1[i] = NAN;
    return INFINITY;
}
