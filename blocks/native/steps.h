/* The stepping loops of a model. Included at the end of an emitted file, whose sizes are constants here.

   One step of a Runge-Kutta method goes from (t, x) with the rates in stage 0. The last stage stands at the end of the
   step, so that its rates are those of the next step's start.

   References: Dormand and Prince 1980; Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, II.4 to II.6
   (error control, continuous extension by Shampine 1986). */
#include "runtime.h"

#if BLOCKS_METHOD_RK4
enum { STAGES = 5, DEGREE = 3, ORDER = 4 };
static const double NODES[] = {0.0, 0.5, 0.5, 1.0, 1.0};
static const double DENSE[] = {1, -2 + 3.0 / 6, 1 - 2.0 / 6, 0, 1, -2.0 / 3, 0, 1, -2.0 / 3,
                               0, 3.0 / 6, -2.0 / 6, 0, -1, 1};
#elif BLOCKS_METHOD_DOPRI5
enum { STAGES = 7, DEGREE = 4, ORDER = 5 };
static const double NODES[] = {0.0, 1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1.0, 1.0};
static const double DENSE[] = {
    1, -8048581381.0 / 2820520608, 8663915743.0 / 2820520608, -12715105075.0 / 11282082432,
    0, 0, 0, 0,
    0, 131558114200.0 / 32700410799, -68118460800.0 / 10900136933, 87487479700.0 / 32700410799,
    0, -1754552775.0 / 470086768, 14199869525.0 / 1410260304, -10690763975.0 / 1880347072,
    0, 127303824393.0 / 49829197408, -318862633887.0 / 49829197408, 701980252875.0 / 199316789632,
    0, -282668133.0 / 205662961, 2019193451.0 / 616988883, -1453857185.0 / 822651844,
    0, 40617522.0 / 29380423, -110615467.0 / 29380423, 69997945.0 / 29380423};
#elif BLOCKS_METHOD_EULER
enum { STAGES = 2, DEGREE = 2, ORDER = 1 };
static const double NODES[] = {0.0, 1.0};
static const double DENSE[] = {1, 0, 0, 0};
#else
enum { STAGES = 0, DEGREE = 0, ORDER = 0 };
static const double DENSE[] = {0};
#endif

#define EACH for (int i = 0; i < BLOCKS_NX; i++)
#define IS_PLAIN (!BLOCKS_MOVING_SIDES && !BLOCKS_NPROJECTIONS && !BLOCKS_NMEASURED && !BLOCKS_NREMEMBERED && !BLOCKS_NZ)

static __attribute__((noinline)) void rates_program(const BlocksMemory *m, double t, const double *x, double *out)
{
    rates(m, t, x, out);
}

#if BLOCKS_METHOD_RK4 || BLOCKS_METHOD_DOPRI5 || BLOCKS_METHOD_EULER

/* x1 and the stages from 1 on, of a step of size h from (t, x). */
#if BLOCKS_NX > 64
__attribute__((noinline))
#endif
static void trial(BlocksSim *s, double t, const double *restrict x, double h, double *restrict x1)
{
    const BlocksMemory *m = &s->memory;
    const double *restrict k0 = s->k[0];
#if BLOCKS_METHOD_EULER
    EACH x1[i] = x[i] + h * k0[i];
    if (s->moving) blocks_outside(s, t + h);
    rates(m, t + h, x1, s->k[1]);
#else
#if BLOCKS_NX > 64
    double *restrict xs = s->xs;
#else
    double xs[BLOCKS_NX > 0 ? BLOCKS_NX : 1];
#endif
    for (int stage = 1; stage < STAGES; stage++) {
        double *y = stage == STAGES - 1 ? x1 : xs;
        const double *restrict k1 = s->k[1], *restrict k2 = s->k[2], *restrict k3 = s->k[3];
#if BLOCKS_METHOD_RK4
        switch (stage) {
        case 1: EACH xs[i] = x[i] + h * (0.5 * k0[i]); break;
        case 2: EACH xs[i] = x[i] + h * (0.5 * k1[i]); break;
        case 3: EACH xs[i] = x[i] + h * k2[i]; break;
        default: EACH x1[i] = x[i] + h * (1.0 / 6 * k0[i] + 1.0 / 3 * k1[i] + 1.0 / 3 * k2[i] + 1.0 / 6 * k3[i]);
        }
#else
        const double *restrict k4 = s->k[4], *restrict k5 = s->k[5];
        switch (stage) {
        case 1: EACH xs[i] = x[i] + h * (1.0 / 5 * k0[i]); break;
        case 2: EACH xs[i] = x[i] + h * (3.0 / 40 * k0[i] + 9.0 / 40 * k1[i]); break;
        case 3: EACH xs[i] = x[i] + h * (44.0 / 45 * k0[i] - 56.0 / 15 * k1[i] + 32.0 / 9 * k2[i]); break;
        case 4:
            EACH xs[i] = x[i] + h * (19372.0 / 6561 * k0[i] - 25360.0 / 2187 * k1[i] + 64448.0 / 6561 * k2[i]
                                     - 212.0 / 729 * k3[i]);
            break;
        case 5:
            EACH xs[i] = x[i] + h * (9017.0 / 3168 * k0[i] - 355.0 / 33 * k1[i] + 46732.0 / 5247 * k2[i]
                                     + 49.0 / 176 * k3[i] - 5103.0 / 18656 * k4[i]);
            break;
        default:
            EACH x1[i] = x[i] + h * (35.0 / 384 * k0[i] + 500.0 / 1113 * k2[i] + 125.0 / 192 * k3[i]
                                     - 2187.0 / 6784 * k4[i] + 11.0 / 84 * k5[i]);
        }
#endif
        double then = t + NODES[stage] * h;
        if (s->moving) blocks_outside(s, then);
        rates(m, then, y, s->k[stage]);
    }
#endif
    s->evaluations += STAGES - 1;
}

static void trial_program(BlocksSim *s, double t, const double *x, double h, double *x1) { trial(s, t, x, h, x1); }

static inline int is_finite(const double *restrict x)
{
    double sum = 0.0;
    EACH sum += x[i] * 0.0; /* 0, or NaN where x is not finite */
    return sum == 0.0;
}

/* The states after a step become those of the run; its last rates are the first ones of the next. */
static inline void turn_over(BlocksSim *s, double t1)
{
    double *x = s->memory.x, *first = s->k[0];
    s->memory.x = s->x1;
    s->x1 = x;
    s->k[0] = s->k[STAGES - 1];
    s->k[STAGES - 1] = first;
    s->has_first = 1;
    s->t = t1;
    s->exact = 0;
    s->steps++;
}

static inline void arrive(BlocksSim *s)
{
    s->exact = s->target_exact;
    s->count = s->target_count;
    s->outstanding = 1;
}

static int first_rates(BlocksSim *s)
{
    if (s->has_first) return BLOCKS_FINE;
    if (s->moving) blocks_outside(s, s->t);
    rates_program(&s->memory, s->t, s->memory.x, s->k[0]);
    s->evaluations++;
    EACH if (!isfinite(s->k[0][i])) return blocks_fail(s, BLOCKS_NOT_FINITE, i, s->k[0][i]);
    s->has_first = 1;
    return BLOCKS_FINE;
}

#if BLOCKS_METHOD_DOPRI5

/* The largest error over the states, each by its own tolerance; inf or NaN where states are not finite. */
static inline double error_norm(const BlocksSim *s, double h, const double *restrict x0, const double *restrict x1)
{
    const double *restrict k0 = s->k[0], *restrict k2 = s->k[2], *restrict k3 = s->k[3], *restrict k4 = s->k[4],
                 *restrict k5 = s->k[5], *restrict k6 = s->k[6], *restrict atol = s->setup->atol;
    double rtol = s->setup->rtol, most = 0.0, bad = 0.0;
    EACH {
        double error = h * (71.0 / 57600 * k0[i] - 71.0 / 16695 * k2[i] + 71.0 / 1920 * k3[i] - 17253.0 / 339200 * k4[i]
                            + 22.0 / 525 * k5[i] - 1.0 / 40 * k6[i]);
        double a = fabs(x0[i]), b = fabs(x1[i]), size = a > b ? a : b;
        double part = fabs(error) / (atol[i] + rtol * size);
        bad += x1[i] * 0.0 + error * 0.0;
        most = part > most ? part : most;
    }
    return bad == 0.0 ? most : NAN;
}

static int run(BlocksSim *s, double target)
{
    const BlocksSetup *setup = s->setup;
    for (;;) {
        if (blocks_clock(s)) return BLOCKS_PAUSED;
        if (first_rates(s)) return BLOCKS_FAILED;
        double left = target - s->t, least = 16 * blocks_ulp(s->t), h = s->h;
        if (h <= 0) h = blocks_first_step(s, left);
        h = h < setup->longest ? h : setup->longest;
        h = h > least ? h : least;
        double grow = 10.0, t1, step, error;
        for (;;) {
            /* The last step before the target is stretched a little rather than followed by a tiny one. */
            t1 = h >= left / 1.01 ? target : s->t + h;
            step = t1 - s->t;
            trial(s, s->t, s->memory.x, step, s->x1);
            error = error_norm(s, step, s->memory.x, s->x1);
            if (error <= 1.0) break;
            if (h <= least || step <= least) {
                s->value = step;
                return blocks_fail(s, BLOCKS_TOO_SMALL, 0, step);
            }
            s->rejected++;
            grow = 1.0;
            double factor = isfinite(error) ? fmax(0.2, 0.9 * pow(error, -1.0 / 5)) : 0.1;
            h = fmax(step * factor, least);
        }
        double factor = 0.9 * pow(s->error, 0.04) * pow(fmax(error, 1e-10), -(1.0 / 5 - 0.75 * 0.04));
        double proposed = step * fmin(grow, fmax(0.2, factor));
        if (step < h) proposed = fmax(proposed, h); /* cut short by the target: the proposal before it still counts */
        error = fmax(error, 1e-4);
        if (!IS_PLAIN) {
            int stopped = blocks_accept(s, t1, step, proposed, error, target);
            if (stopped >= 0) return stopped;
            continue;
        }
        if (blocks_rows_inside(s, t1, step)) return BLOCKS_FAILED;
        turn_over(s, t1);
        s->h = proposed;
        s->error = error;
        if (t1 == target) {
            arrive(s);
            return BLOCKS_DONE;
        }
        if (!setup->every.is_given && blocks_record_step(s)) return BLOCKS_FAILED;
    }
}

#else

static int run(BlocksSim *s, double target)
{
    const BlocksSetup *setup = s->setup;
    const BlocksGrid grid = setup->fixed;
    for (;;) {
        if (blocks_clock(s)) return BLOCKS_PAUSED;
        if (first_rates(s)) return BLOCKS_FAILED;
        double point, t1;
        while ((point = blocks_grid(&grid, s->fixed)) <= s->t) s->fixed++;
        t1 = point >= target || blocks_within_ulps(point, target, 0.0) ? target : point;
        if (BLOCKS_NREMEMBERED && t1 - s->t > setup->longest) /* in equal parts that no delay is shorter than */
            t1 = s->t + (t1 - s->t) / ceil((t1 - s->t) / setup->longest);
        double step = t1 - s->t;
        trial(s, s->t, s->memory.x, step, s->x1);
        if (!is_finite(s->x1)) return blocks_fail(s, BLOCKS_BLOWN_UP, 0, step);
        if (!IS_PLAIN) {
            int stopped = blocks_accept(s, t1, step, 0.0, 1e-4, target);
            if (stopped >= 0) return stopped;
            continue;
        }
        if (blocks_rows_inside(s, t1, step)) return BLOCKS_FAILED;
        turn_over(s, t1);
        if (t1 == target) {
            arrive(s);
            return BLOCKS_DONE;
        }
        if (!setup->every.is_given && blocks_record_step(s)) return BLOCKS_FAILED;
    }
}

#endif
#else
static void trial_program(BlocksSim *s, double t, const double *x, double h, double *x1)
{
    (void)s, (void)t, (void)x, (void)h, (void)x1;
}
static int run(BlocksSim *s, double target)
{
    (void)target;
    return blocks_fail(s, BLOCKS_TOO_SMALL, 0, 0.0);
}
#endif

__attribute__((visibility("default"))) const BlocksModel blocks_model = {
    .nx = BLOCKS_NX, .nd = BLOCKS_ND, .ns = BLOCKS_NS, .np = BLOCKS_NP, .nu = BLOCKS_NU, .nh = BLOCKS_NH,
    .nz = BLOCKS_NZ, .nrates = BLOCKS_NRATES, .nq = BLOCKS_NQ, .nv = BLOCKS_NV, .nw = BLOCKS_NW, .nn = BLOCKS_NN,
    .nevents = BLOCKS_NEVENTS, .nlogged = BLOCKS_NLOGGED, .nmeasured = BLOCKS_NMEASURED,
    .nremembered = BLOCKS_NREMEMBERED, .nprojections = BLOCKS_NPROJECTIONS, .moving_sides = BLOCKS_MOVING_SIDES,
    .stages = STAGES, .degree = DEGREE, .order = ORDER,
    .nlogged_states = BLOCKS_NLOGGED_STATES, .nmeasured_states = BLOCKS_NMEASURED_STATES,
    .nremembered_states = BLOCKS_NREMEMBERED_STATES, .ncrossings_states = BLOCKS_NCROSSINGS_STATES,
    .logged_states = logged_states, .measured_states = measured_states, .remembered_states = remembered_states,
    .crossings_states = crossings_states, .dense = DENSE, .prepare = prepare, .refresh = refresh,
    .rates = rates_program, .crossings = crossings, .event_times = event_times, .projections = projections,
    .solutions = solutions, .logged = logged, .measured = measured, .remembered = remembered, .start = start,
    .resets = resets, .anew = anew, .stepper_inputs = stepper_inputs, .outputs = outputs, .nexts = nexts,
    .trial = trial_program, .run = run,
};
