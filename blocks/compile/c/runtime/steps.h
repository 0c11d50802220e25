/* The stepping loops of a model. Included at the end of an emitted file, whose sizes are constants here.

   One step of a Runge-Kutta method goes from (t, x) with the rates in stage 0. The last stage stands at the end of the
   step, so that its rates are those of the next step's start.

   Reference: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, II.4 to II.6 (error control). */
#include "methods.h" /* the tableau, as tableaus.py prints it */
#include "runtime.h"
#include "instants.h"

#define STAGED (BLOCKS_METHOD_RK4 || BLOCKS_METHOD_DOPRI5 || BLOCKS_METHOD_EULER)
#if BLOCKS_METHOD_RADAU || BLOCKS_METHOD_AUTO
#include "stiff.h"
#endif
#if BLOCKS_METHOD_RADAU
enum { STAGES = BLOCKS_STIFF_STAGES, DEGREE = BLOCKS_STIFF_DEGREE, ORDER = 3 };
#define DENSE blocks_stiff_dense
#elif !STAGED
enum { STAGES = 0, DEGREE = 0, ORDER = 0 };
static const double DENSE[] = {0};
#endif

#define SMALL (BLOCKS_NX <= 8 && BLOCKS_NS <= 8)
#define IS_WATCHED (BLOCKS_MOVING_SIDES && STAGED)
#if IS_WATCHED
#define RATES_AND_SIDES rates_and_sides /* crossings behind the rates */
#else
#define RATES_AND_SIDES rates
#endif
#if BLOCKS_METHOD_DOPRI5
#define WATCHES(n) ((n) == 2 || (n) == 3 || (n) == LAST)
#else
#define WATCHES(n) ((n) == LAST)
#endif

#if BLOCKS_SHARES_MEASURED /* what is measured stands behind the rates at the end of a step */
#define LAST_RATES rates_and_measured
#else
#define LAST_RATES RATES_AND_SIDES
#endif

/* Of a model that stays in memory, rates are a function of their own. */
static __attribute__((noinline)) void rates_program(const BlocksMemory *m, double t, const double *x, double *out)
{
    RATES_AND_SIDES(m, t, x, out);
}

#if STAGED && !SMALL && BLOCKS_SHARES_MEASURED
static __attribute__((noinline)) void last_rates(const BlocksMemory *m, double t, const double *x, double *out)
{
    rates_and_measured(m, t, x, out);
}
#else
#define last_rates rates_program
#endif

#if STAGED && IS_WATCHED && !SMALL
static __attribute__((noinline)) void bare_rates(const BlocksMemory *m, double t, const double *x, double *out)
{
    rates(m, t, x, out);
}
#else
#define bare_rates rates_program
#endif

#if STAGED

/* States and stages of a small model live in arrays whose addresses go nowhere, so that they can stand in registers;
   those of a large one stay in memory, and its rates are a function of their own. */
#define LAST (STAGES - 1)
enum { WIDTH = BLOCKS_NX + BLOCKS_NS, SPAN = WIDTH + BLOCKS_SHARES_MEASURED * BLOCKS_NMEASURED };
#if SMALL
#define EACH(what) _Pragma("GCC unroll 32") for (int i = 0; i < BLOCKS_NX; i++) what
#define QUARTER _Pragma("GCC unroll 8") for (int i = 0; i + 3 < BLOCKS_NX; i += 4)
#define REST _Pragma("GCC unroll 4") for (int i = BLOCKS_NX / 4 * 4; i < BLOCKS_NX; i++)
#define STAGE(n, then, y)                                                                                             \
    do {                                                                                                              \
        if (!is_whole && (n) == LAST) break;                                                                          \
        if (moving) blocks_outside(s, then);                                                                          \
        if ((n) == LAST) LAST_RATES(m, then, y, k[n]);                                                                \
        else if (is_whole && WATCHES(n)) RATES_AND_SIDES(m, then, y, k[n]);                                           \
        else rates(m, then, y, k[n]);                                                                                 \
    } while (0)
typedef double Stages[STAGES][SPAN > 0 ? SPAN : 1];
#define SCRATCH double xs[BLOCKS_NX > 0 ? BLOCKS_NX : 1]
#else
/* At -O2 gcc does several at once only of an even count: the odd one comes last. */
#define EACH(what)                                                                                                    \
    do {                                                                                                              \
        for (int i = 0; i < BLOCKS_NX / 2 * 2; i++) what;                                                             \
        for (int i = BLOCKS_NX / 2 * 2; i < BLOCKS_NX; i++) what;                                                     \
    } while (0)
#define QUARTER for (int i = 0; i + 3 < BLOCKS_NX; i += 4)
#define REST for (int i = BLOCKS_NX / 4 * 4; i < BLOCKS_NX; i++)
#define STAGE(n, then, y)                                                                                             \
    do {                                                                                                              \
        if (!is_whole && (n) == LAST) break;                                                                          \
        if (moving) blocks_outside(s, then);                                                                          \
        if ((n) == LAST) last_rates(m, then, y, k[n]);                                                                \
        else if (is_whole && WATCHES(n)) rates_program(m, then, y, k[n]);                                             \
        else bare_rates(m, then, y, k[n]);                                                                            \
    } while (0)
typedef double *Stages[STAGES];
#define SCRATCH double *const xs = s->xs
#endif

/* x1 and the stages from 1 on, of a step of size h from (t, x). xs: scratch; a parameter, as compilers heed `restrict` there
   alone. is_whole: whether the last stage is wanted, which x1 does not need, and what crossings are on the way. */
static inline __attribute__((always_inline)) void stages_of(BlocksSim *s, const BlocksMemory *m, const int moving,
                                                            const int is_whole, double t, const double *restrict x,
                                                            double h, Stages k, double *restrict x1, double *restrict xs)
{
    (void)xs;
    MAKE_STEP
}

static inline __attribute__((always_inline)) void step_of(BlocksSim *s, const BlocksMemory *m, const int moving, double t,
                                                          const double *restrict x, double h, Stages k,
                                                          double *restrict x1)
{
    SCRATCH;
    stages_of(s, m, moving, 1, t, x, h, k, x1, xs);
}

static int first_rates(BlocksSim *s)
{
    if (s->has_first) return BLOCKS_FINE;
    s->has_before = 0;
    if (s->moving) blocks_outside(s, s->t);
    rates_program(&s->memory, s->t, s->memory.x, s->k[0]);
    s->evaluations++;
    for (int i = 0; i < BLOCKS_NX; i++)
        if (!isfinite(s->k[0][i])) return blocks_fail(s, BLOCKS_NOT_FINITE, i, s->k[0][i]);
    s->has_first = 1;
    return BLOCKS_FINE;
}

/* The largest error over the states, each by its own tolerance; inf or NaN where a state is not finite. */
static inline __attribute__((always_inline)) double error_norm(const BlocksSetup *setup, double h, Stages k,
                                                               const double *restrict x, const double *restrict x1)
{
    /* Four of each, so that one sum does not wait for the other. */
    double most[4] = {0.0, 0.0, 0.0, 0.0}, bad[4] = {0.0, 0.0, 0.0, 0.0};
#if BLOCKS_METHOD_DOPRI5
    const double *restrict atol = setup->atol, rtol = setup->rtol;
    const double *restrict k0 = k[0], *restrict k2 = k[2], *restrict k3 = k[3], *restrict k4 = k[4],
                 *restrict k5 = k[5], *restrict k6 = k[6];
#define PART(i, n)                                                                                                    \
    do {                                                                                                              \
        double error = h * ERROR(i);                                                                                  \
        double a = fabs(x[i]), b = fabs(x1[i]), part = fabs(error) / (atol[i] + rtol * (a > b ? a : b));              \
        bad[n] += (x1[i] + error) * 0.0;                                                                              \
        most[n] = part > most[n] ? part : most[n];                                                                    \
    } while (0)
#else
    (void)setup, (void)h, (void)k, (void)x;
#define PART(i, n) bad[n] += x1[i] * 0.0 /* 0, or NaN where x1 is not finite */
#endif
    QUARTER
    {
        PART(i, 0);
        PART(i + 1, 1);
        PART(i + 2, 2);
        PART(i + 3, 3);
    }
    REST PART(i, i % 4);
    double least = most[0] > most[1] ? most[0] : most[1], other = most[2] > most[3] ? most[2] : most[3];
    return (bad[0] + bad[1]) + (bad[2] + bad[3]) == 0.0 ? least > other ? least : other : NAN;
}

#if BLOCKS_METHOD_DOPRI5
/* Note the state with the largest error of a step that is rejected, or one that is not finite. */
static __attribute__((noinline)) void blame(BlocksSim *s, double h)
{
    const double *x = s->memory.x, *x1 = s->x1, *k0 = s->k[0], *k2 = s->k[2], *k3 = s->k[3], *k4 = s->k[4], *k5 = s->k[5],
                 *k6 = s->k[6];
    double most = -1.0;
    int worst = 0;
    for (int i = 0; i < BLOCKS_NX; i++) {
        double error = h * ERROR(i), size = blocks_larger(fabs(x[i]), fabs(x1[i]));
        double part = isfinite(x1[i] + error) ? fabs(error) / (s->setup->atol[i] + s->setup->rtol * size) : INFINITY;
        if (part > most) most = part, worst = i;
    }
    s->blamed[worst]++;
}
#endif

/* The states after a step from where the run stands, for those who look for a crossing in it; is_judged: and its error, by
   which it may be accepted. */
static double trial(BlocksSim *s, double t, const double *x, double h, double *x1, int is_judged)
{
    SCRATCH;
#if SMALL
    Stages k;
    for (int i = 0; i < BLOCKS_NX; i++) k[0][i] = s->k[0][i];
    stages_of(s, &s->memory, s->moving, 0, t, x, h, k, x1, xs);
#else
    double **const k = s->k;
    stages_of(s, &s->memory, s->moving, 0, t, x, h, k, x1, xs);
#endif
    s->evaluations += LAST - 1;
#if BLOCKS_METHOD_DOPRI5
    if (is_judged) {
        blocks_rates(s, t + h, x1, k[LAST]);
        double error = error_norm(s->setup, h, k, x, x1);
        if (!(error <= 1.0)) {
            for (int i = 0; i < BLOCKS_NX; i++) {
                s->x1[i] = x1[i];
                for (int n = 1; n < STAGES; n++) s->k[n][i] = k[n][i];
            }
            blame(s, h);
        }
        return error;
    }
#endif
    (void)is_judged;
    return 0.0;
}

#if BLOCKS_METHOD_AUTO
/* Whether an accepted step says that stability limits it: h |df/dx|, as the last two stages have it, which both stand at
   its end, is near the edge. Hairer and Wanner, Solving Ordinary Differential Equations II, IV.2. */
static int says_stiff(const BlocksSetup *setup, Stages k, const double *restrict x1)
{
    static const double apart[] = END_APART;
    double rates = 0.0, states = 0.0;
    for (int i = 0; i < BLOCKS_NX; i++) {
        double weight = 1.0 / (setup->atol[i] + setup->rtol * fabs(x1[i])), sum = 0.0;
        _Pragma("GCC unroll 8") for (int n = 0; n < LAST; n++) sum += apart[n] * k[n][i];
        double rate = weight * (k[LAST][i] - k[LAST - 1][i]);
        rates += rate * rate, states += weight * weight * sum * sum;
    }
    return rates > 3.25 * 3.25 * states;
}

static void count_stiffness(BlocksSim *s, Stages k, const double *restrict x1)
{
    if (says_stiff(s->setup, k, x1)) s->hits++, s->calm = 0;
    else if (++s->calm == BLOCKS_CALM) s->hits = 0;
}
#endif

#if IS_WATCHED

/* Whether a side may have changed in a step. Between instants most crossings are affine in the states, so that inside a
   step they are the polynomial of its dense output. Such a one is safe where it keeps away from 0 by more than 3 times
   what it moves: by dopri5 between stages at 0, 0.3, 0.8 and 1, by methods of fixed steps from end to end of the last two
   steps (of the first step after an instant, half a step along its first slope stands for the one before). It does not
   go that far in between: what rk4 can follow at all has more than two ends in a period. All others are looked at
   closely; and where any crossing is bent, or depends on time itself, all are, in every step. */
static inline __attribute__((always_inline)) double is_near(double side, double low, double high, double last)
{
    double margin = 3.0 * (high - low) + last * 0.0; /* NaN is near */
    return (side > 0.0 ? low : -high) > margin ? 0.0 : 1.0;
}

#if BLOCKS_METHOD_DOPRI5
#define REACH_OF(j)                                                                                                   \
    double low = blocks_smaller(blocks_smaller(first[j], last[j]), blocks_smaller(second[j], third[j]));              \
    double high = blocks_larger(blocks_larger(first[j], last[j]), blocks_larger(second[j], third[j]))
#else
#define REACH_OF(j)                                                                                                   \
    double low = blocks_smaller(before[j], blocks_smaller(first[j], last[j]));                                        \
    double high = blocks_larger(before[j], blocks_larger(first[j], last[j]))
#endif

#if SMALL
static inline __attribute__((always_inline)) int is_loud(const double *restrict side, const double *restrict before,
                                                         Stages k, double *restrict near)
#else
static __attribute__((noinline)) int is_loud(const double *restrict side, const double *restrict before, Stages k,
                                             double *restrict near)
#endif
{
    const double *restrict first = k[0] + BLOCKS_NX, *restrict last = k[LAST] + BLOCKS_NX;
    if (BLOCKS_BENT_SIDES) return 1;
    (void)before, (void)near;
#if BLOCKS_METHOD_DOPRI5
    const double *restrict second = k[2] + BLOCKS_NX, *restrict third = k[3] + BLOCKS_NX;
#endif
#if SMALL
    int loud = 0;
    _Pragma("GCC unroll 16") for (int j = 0; j < BLOCKS_NS; j++) {
        REACH_OF(j);
        loud |= is_near(side[j], low, high, last[j]) != 0.0;
    }
    return loud;
#else
    const int even = BLOCKS_NS / 2 * 2;
    for (int j = 0; j < even; j++) {
        REACH_OF(j);
        near[j] = is_near(side[j], low, high, last[j]);
    }
    for (int j = even; j < BLOCKS_NS; j++) {
        REACH_OF(j);
        near[j] = is_near(side[j], low, high, last[j]);
    }
    int64_t loud = 0, bits; /* in this form, compilers do several at once */
    for (int j = 0; j < BLOCKS_NS; j++) {
        memcpy(&bits, near + j, sizeof bits);
        loud |= bits;
    }
    return loud != 0;
#endif
}
#else
#define is_loud(side, before, k, near) 0
#endif

#define FORETELLS (IS_WATCHED && !BLOCKS_BENT_SIDES && (BLOCKS_METHOD_RK4 || BLOCKS_METHOD_DOPRI5))
#if FORETELLS
/* Whether one of the crossings that are near may change its side in a step after all. Inside it each is the polynomial of its
   ends and slopes, and by dopri5 of its middle, which does not leave the hull of its Bezier points. Crossings are affine: what
   a slope adds to one is seen by adding it to the states. */
#if SMALL
static inline __attribute__((always_inline)) int comes_near(BlocksSim *s, const BlocksMemory *m, double t, double t1,
                                                            const double *restrict x, const double *restrict x1, double h,
                                                            Stages k, const double *restrict side)
{
    double at[BLOCKS_NX > 0 ? BLOCKS_NX : 1], begin[BLOCKS_NS], middle[BLOCKS_NS], end[BLOCKS_NS];
#else
static __attribute__((noinline)) int comes_near(BlocksSim *s, const BlocksMemory *m, double t, double t1,
                                                const double *restrict x, const double *restrict x1, double h, Stages k,
                                                const double *restrict side)
{
    const double *restrict near = s->distances;
    double *at = s->xs, *begin = s->x2, *middle = s->distances + BLOCKS_NS, *end = s->crossing_values;
#endif
    const double *restrict first = k[0], *restrict last = k[LAST];
    const int was_located = s->located_t == t;
    if (!(h > 1e6 * blocks_ulp(t1))) return 1; /* what comes within some ulp of the end is for others to see */
    EACH(at[i] = x[i] + h * first[i]);
    crossings(m, t, at, begin);
    EACH(at[i] = x1[i] + h * last[i]);
    crossings(m, t1, at, end);
#if BLOCKS_METHOD_DOPRI5
    for (int i = 0; i < BLOCKS_NX; i++) {
        double sum = 0.0;
        _Pragma("GCC unroll 8") for (int n = 0; n < STAGES; n++)
            if (SHARES[1][n] != 0.0) sum += SHARES[1][n] * k[n][i];
        at[i] = x[i] + h * sum;
    }
    crossings(m, t + 0.5 * h, at, middle);
#else
    (void)middle;
#endif
    for (int j = 0; j < BLOCKS_NS; j++) {
        const int of = sides_at[j];
        double way = side[j] > 0.0 ? 1.0 : -1.0, b0 = way * first[BLOCKS_NX + j], b3 = way * last[BLOCKS_NX + j];
        double b1 = b0 + (way * begin[of] - b0) / (DEGREE), b2 = b3 - (way * end[of] - b3) / (DEGREE);
        double least = blocks_smaller(blocks_smaller(b0, b3), blocks_smaller(b1, b2));
        double most = blocks_larger(blocks_larger(b0, b3), blocks_larger(b1, b2)), bad = 0.0 * ((b0 + b3) + (b1 + b2));
#if !SMALL
        if (near[j] == 0.0) continue;
#endif
        if (was_located && fabs(b0) <= 2.0 * s->located[of]) return 1; /* it may have to be passed again at once */
#if BLOCKS_METHOD_DOPRI5
        double inner = (16.0 * way * middle[of] - (b0 + b3) - 4.0 * (b1 + b2)) / 6.0;
        least = blocks_smaller(least, inner), most = blocks_larger(most, inner), bad += 0.0 * inner;
#endif
        if (!(least > 1e-6 * most + bad)) return 1; /* what is not finite too */
    }
    return 0;
}
#endif

#if BLOCKS_NF
#define IS_PLAIN 0
#else
#define IS_PLAIN (!BLOCKS_NPROJECTIONS && (!BLOCKS_NMEASURED || BLOCKS_QUICK_MEASURES) && !BLOCKS_NREMEMBERED && !BLOCKS_NZ)
#endif

/* As measured with gcc 12: where crossings stand behind the rates, copies in loops are faster. */
#if IS_WATCHED
#define UNROLL
#else
#define UNROLL _Pragma("GCC unroll 32")
#endif

/* What the loop holds, and its places in the run. */
#if SMALL
#define GIVE_BACK                                                                                                     \
    do {                                                                                                              \
        UNROLL for (int i = 0; i < BLOCKS_NX; i++) s->memory.x[i] = x[i];                                             \
        UNROLL for (int i = 0; i < WIDTH; i++) s->k[0][i] = k[0][i];                                                  \
        UNROLL for (int i = BLOCKS_NX; i < WIDTH; i++) s->before[i] = before[i];                                      \
        if (s->t != t) s->exact = 0;                                                                                  \
        s->t = t, s->steps = steps, s->evaluations = evaluations, s->budget = budget;                                 \
    } while (0)
#define GIVE_STEP                                                                                                     \
    do {                                                                                                              \
        UNROLL for (int i = 0; i < BLOCKS_NX; i++) s->x1[i] = x1[i];                                                  \
        UNROLL for (int n = 1; n < STAGES; n++)                                                                       \
            UNROLL for (int i = 0; i < WIDTH; i++) s->k[n][i] = k[n][i];                                              \
    } while (0)
#define TAKE                                                                                                          \
    do {                                                                                                              \
        UNROLL for (int i = 0; i < BLOCKS_NX; i++) x[i] = s->memory.x[i];                                             \
        UNROLL for (int i = 0; i < WIDTH; i++) k[0][i] = s->k[0][i];                                                  \
        UNROLL for (int i = BLOCKS_NX; i < WIDTH; i++) before[i] = s->before[i];                                      \
        t = s->t, steps = s->steps, evaluations = s->evaluations, budget = s->budget;                                 \
    } while (0)
#define TURN_OVER                                                                                                     \
    do {                                                                                                              \
        EACH(x[i] = x1[i]);                                                                                           \
        UNROLL for (int i = BLOCKS_NX; i < WIDTH; i++) before[i] = k[0][i];                                           \
        UNROLL for (int i = 0; i < WIDTH; i++) k[0][i] = k[LAST][i];                                                  \
    } while (0)
#else
#define GIVE_BACK                                                                                                     \
    do {                                                                                                              \
        s->memory.x = x, s->x1 = x1;                                                                                  \
        for (int n = 0; n < STAGES; n++) s->k[n] = k[n];                                                              \
        s->before = before;                                                                                           \
        if (s->t != t) s->exact = 0;                                                                                  \
        s->t = t, s->steps = steps, s->evaluations = evaluations, s->budget = budget;                                 \
    } while (0)
#define GIVE_STEP (void)0
#define TAKE                                                                                                          \
    do {                                                                                                              \
        x = s->memory.x, x1 = s->x1;                                                                                  \
        for (int n = 0; n < STAGES; n++) k[n] = s->k[n];                                                              \
        before = s->before;                                                                                           \
        t = s->t, steps = s->steps, evaluations = s->evaluations, budget = s->budget;                                 \
    } while (0)
#define TURN_OVER                                                                                                     \
    do {                                                                                                              \
        double *old = x, *oldest = before;                                                                            \
        x = x1, x1 = old, before = k[0], k[0] = k[LAST], k[LAST] = oldest;                                            \
    } while (0)
#endif

/* Rows of the recording grid strictly inside a step. outstanding: whether an instant follows at its end. */
static inline __attribute__((always_inline)) int rows_inside(BlocksSim *s, const BlocksMemory *m, const int moving,
                                                             double t, double t1, double h, int outstanding,
                                                             const double *restrict x, Stages k)
{
#if SMALL
    enum { EVEN = (BLOCKS_NLOGGED_STATES + 1) / 2 * 2 }; /* so that compilers compute two at once */
    double weights[DEGREE * (EVEN > 0 ? EVEN : 1)], sums[EVEN > 0 ? EVEN : 1];
    double made[BLOCKS_NX > 0 ? BLOCKS_NX : 1];
#else
    enum { EVEN = BLOCKS_NLOGGED_STATES };
    double *restrict weights = s->weights, *restrict made = s->xs, *restrict sums = s->x2;
#endif
    const BlocksGrid grid = s->setup->every;
    int64_t number = s->row;
    double at = s->next_row;
    int known = 0;
    for (; at < t1; at = blocks_grid(&grid, ++number)) {
        if (outstanding && blocks_joins(s, at, t1)) break;
        double *row = blocks_row(s);
        if (!row) return 1;
        if (at == t) {
            _Pragma("GCC unroll 16") for (int a = 0; a < BLOCKS_NLOGGED_STATES; a++)
                made[logged_states[a]] = x[logged_states[a]];
        } else {
            if (!known) {
                known = 1;
                if (EVEN > BLOCKS_NLOGGED_STATES)
                    for (int j = 0; j < DEGREE; j++) weights[j * EVEN + EVEN - 1] = 0.0;
                _Pragma("GCC unroll 16") for (int a = 0; a < BLOCKS_NLOGGED_STATES; a++)
                    _Pragma("GCC unroll 8") for (int j = 0; j < DEGREE; j++) {
                        double sum = 0.0;
                        _Pragma("GCC unroll 8") for (int n = 0; n < STAGES; n++)
                            if (DENSE[n * DEGREE + j] != 0.0) sum += DENSE[n * DEGREE + j] * k[n][logged_states[a]];
                        weights[j * EVEN + a] = h * sum;
                    }
            }
            double theta = (at - t) / h;
            for (int a = 0; a < EVEN; a++) sums[a] = 0.0;
            _Pragma("GCC unroll 8") for (int j = DEGREE - 1; j >= 0; j--)
                for (int a = 0; a < EVEN; a++) sums[a] = theta * (weights[j * EVEN + a] + sums[a]);
            _Pragma("GCC unroll 16") for (int a = 0; a < BLOCKS_NLOGGED_STATES; a++)
                made[logged_states[a]] = x[logged_states[a]] + sums[a];
        }
        if (moving) blocks_outside(s, at);
        logged(m, at, made, row + 1);
        double bad = 0.0;
        for (int i = 1; i <= BLOCKS_NLOGGED; i++) bad += row[i] * 0.0;
        if (bad != 0.0) return blocks_fail(s, BLOCKS_NOT_FINITE, 0, NAN);
        row[0] = at;
        blocks_keep_row(s, row);
        s->row = number + 1;
    }
    s->next_row = at, s->timed = number;
    return 0;
}

/* What lives across a call lives in memory. Few steps of fixed size have rows inside: for these alone values are stored. */
#define ROWS_APART (SMALL && (BLOCKS_METHOD_RK4 || BLOCKS_METHOD_EULER) && !BLOCKS_SHARES_MEASURED)
#if ROWS_APART
static __attribute__((noinline)) int rows_apart(BlocksSim *s, double t1, double h, int outstanding)
{
    double x[BLOCKS_NX > 0 ? BLOCKS_NX : 1];
    Stages k;
    EACH(x[i] = s->memory.x[i]);
    for (int n = 0; n < STAGES; n++) EACH(k[n][i] = s->k[n][i]);
    return rows_inside(s, &s->memory, (BLOCKS_NU || BLOCKS_NH) && s->moving, s->t, t1, h, outstanding, x, k);
}
#endif

#if BLOCKS_QUICK_MEASURES

/* The states at one of SHARES of a step, as its dense output has them. */
static inline __attribute__((always_inline)) void inside(const int share, const int *restrict states, const int n, double h,
                                                         const double *restrict x, const double *restrict x1, Stages k,
                                                         double *restrict made)
{
#if BLOCKS_METHOD_RK4 /* by both ends and their slopes */
    const double at = SHARES_AT[share], there = at * at * (3.0 - 2.0 * at), first = at * (1.0 - at) * (1.0 - at) * h,
                 last = at * at * (at - 1.0) * h;
    const double *restrict k0 = k[0], *restrict k4 = k[4];
    _Pragma("GCC unroll 16") for (int a = 0; a < n; a++) {
        const int i = states[a];
        made[i] = x[i] + (there * (x1[i] - x[i]) + (first * k0[i] + last * k4[i]));
    }
#else
    (void)x1;
    _Pragma("GCC unroll 16") for (int a = 0; a < n; a++) {
        const int i = states[a];
        double sum = 0.0;
        _Pragma("GCC unroll 8") for (int j = 0; j < STAGES; j++)
            if (SHARES[share][j] != 0.0) sum += SHARES[share][j] * k[j][i];
        made[i] = x[i] + h * sum;
    }
#endif
}

/* What is measured at the nodes of Lobatto's rule, into `nodes`: 0; where the step is not to be measured: 1; where it has to
   be looked at in parts: -1. Five values tell what is not bent. What is bent, and depends on states alone, is computed at
   one point or two inside, where a straight line through the ends, or the parabola through these and the first point,
   foretells it to a hundredth of what is allowed; at all nodes else, and at one point more, as in any part. */
static inline __attribute__((always_inline)) int measured_inside(BlocksSim *s, const BlocksMemory *m, const int moving,
                                                                 double t, double t1, double h, const double *restrict x,
                                                                 const double *restrict x1, Stages k)
{
    enum { N = BLOCKS_NMEASURED, END = 4 * N };
    const BlocksSetup *setup = s->setup;
    double *restrict v = s->nodes;
#if BLOCKS_NPLAIN
    static const int plain_states[] = BLOCKS_PLAIN_STATES;
#endif
#if BLOCKS_NBENT
    static const int bent_states[] = BLOCKS_BENT_STATES, bent_columns[] = BLOCKS_BENT_COLUMNS;
    double *restrict once = s->part_values, *restrict twice = s->part_values + N;
#endif
#if SMALL
    double made[BLOCKS_NX > 0 ? BLOCKS_NX : 1];
#else
    double *restrict made = s->xs;
#endif
#define ASKED(program, share, out)                                                                                    \
    do {                                                                                                              \
        if (moving) blocks_outside(s, t + SHARES_AT[share] * h);                                                      \
        program(m, t + SHARES_AT[share] * h, made, out);                                                              \
    } while (0)
    if (!(t < t1)) return 1;
    if (setup->has_windows) {
        int in = blocks_measures_in(s, t, t1);
        if (in > 0 && blocks_window_begins(s, t1)) return -1; /* which takes what jumps there from here on */
        if (in) return in;
    }
    if (s->known[0] != t) {
        if (moving) blocks_outside(s, t);
        measured(m, t, x, v);
        for (int j = 0; j < N; j++)
            if (!isfinite(v[j])) return -1;
        s->known[0] = t;
    }
#if BLOCKS_NPLAIN
    _Pragma("GCC unroll 3") for (int i = 1; i < 4; i++) {
        inside(i - 1, plain_states, BLOCKS_NPLAIN_STATES, h, x, x1, k, made);
        ASKED(plain_measured, i - 1, v + i * N);
    }
#endif
#if BLOCKS_NBENT
    inside(3, bent_states, BLOCKS_NBENT_STATES, h, x, x1, k, made);
    ASKED(bent_measured, 3, once);
#endif
#if BLOCKS_SHARES_MEASURED /* copied late: what was just written in parts is slowly read as a whole */
    for (int j = 0; j < N; j++) v[END + j] = k[LAST][WIDTH + j];
#else
    if (moving) blocks_outside(s, t1);
    measured(m, t1, x1, v + END);
#endif
    double bad = 0.0, worse = 0.0; /* what five values tell is finite where its ends are */
    for (int j = 0; j < N; j += 2) bad += v[END + j] * 0.0, worse += v[END + j + 1] * 0.0;
    if (bad + worse != 0.0) return -1;
#if BLOCKS_NBENT
    const double first = SHARES_AT[3], second = SHARES_AT[4], rtol = setup->rtol;
    int missed = BLOCKS_DRIVEN_MEASURES;
    _Pragma("GCC unroll 2") for (int pass = 0; pass < 2 && !BLOCKS_DRIVEN_MEASURES; pass++) {
        if (pass == 1) {
            if (!missed) break;
            missed = 0;
            inside(4, bent_states, BLOCKS_NBENT_STATES, h, x, x1, k, made);
            ASKED(bent_measured, 4, twice);
        }
        _Pragma("GCC unroll 16") for (int a = 0; a < BLOCKS_NBENT; a++) {
            const int j = bent_columns[a], other = j ^ 1;
            double y0 = v[j], rise = v[END + j] - y0, e0 = fabs(y0 - v[other]), e4 = fabs(v[END + j] - v[END + other]);
            double miss = once[j] - (y0 + first * rise), bend = miss * (1.0 / (first * (1.0 - first))), twist = 0.0;
            if (pass == 1) {
                miss = twice[j] - (y0 + second * rise + bend * second * (1.0 - second));
                twist = miss * (1.0 / (second * (1.0 - second) * (second - first)));
            }
            double size = fabs(rise);
            if (setup->measures[j / 2].kind <= BLOCKS_HARMONIC) size += e0 < e4 ? e0 : e4;
            missed |= !(fabs(miss) <= 0.1 * rtol * size);
            for (int i = 1; i < 4; i++) {
                double at = SHARES_AT[i - 1];
                v[i * N + j] = y0 + at * rise + at * (1.0 - at) * (bend + twist * (at - first));
            }
        }
    }
    if (missed) {
        double *restrict values = twice;
        _Pragma("GCC unroll 3") for (int i = 1; i < 4; i++) {
            inside(i - 1, bent_states, BLOCKS_NBENT_STATES, h, x, x1, k, made);
            ASKED(bent_measured, i - 1, values);
            for (int a = 0; a < BLOCKS_NBENT; a++) {
                v[i * N + bent_columns[a]] = values[bent_columns[a]];
                bad += values[bent_columns[a]] * 0.0;
            }
        }
        if (bad != 0.0) return -1;
        if (blocks_misses(s, once)) return -1;
    }
#endif
#undef ASKED
    return 0;
}
#endif

/* Without optimisation all loops over states are slow, but those of the step are what a run is made of. Where a compiler has
   much more to do with other things, or unrolls these loops, they are not worth its time. */
#if !defined(__OPTIMIZE__) && !SMALL && BLOCKS_NX <= 64 && defined(__GNUC__) && !defined(__clang__)
__attribute__((optimize("O1", "fp-contract=off", "no-math-errno", "no-trapping-math")))
#endif
static int run(BlocksSim *s, double target)
{
    const BlocksSetup *setup = s->setup;
    const BlocksMemory memory = s->memory, *const m = &memory;
    const int moving = (BLOCKS_NU || BLOCKS_NH) && s->moving;
    const int has_grid = setup->every.is_given, is_on_grid = has_grid || setup->is_silent;
    const double soft = s->soft;
    double t;
    int64_t steps, evaluations, budget;
#if SMALL
    double x[BLOCKS_NX > 0 ? BLOCKS_NX : 1], x1[BLOCKS_NX > 0 ? BLOCKS_NX : 1], before[WIDTH > 0 ? WIDTH : 1];
#else
    double *x, *x1, *before;
#endif
    Stages k;
#if IS_WATCHED
#if SMALL
    double side[BLOCKS_NS];
#else
    double *restrict side = s->latched;
#endif
    for (int j = 0; j < BLOCKS_NS; j++) side[j] = s->memory.s[sides_at[j]]; /* they do not change between instants */
#endif
#if BLOCKS_METHOD_AUTO
    if (!isnan(s->stiff_from)) return blocks_stiff_run(s, target);
#endif
#if !BLOCKS_METHOD_DOPRI5
    const BlocksGrid grid = setup->fixed;
    double near, point;
#endif
begin:
    if (first_rates(s)) return BLOCKS_FAILED;
    if (has_grid) blocks_next_row(s);
    else s->next_row = INFINITY;
    TAKE;
#if !BLOCKS_METHOD_DOPRI5
    near = 1e-12 * fabs(target);
    int64_t fixed = s->fixed;
    while ((point = blocks_grid(&grid, fixed)) <= t) fixed++;
#endif
    for (;;) {
#if BLOCKS_METHOD_AUTO
        if (s->hits == BLOCKS_HITS) {
            GIVE_BACK;
            s->stiff_from = t;
            s->model = s->model->stiff;
            return blocks_stiff_run(s, target);
        }
#endif
        if (--budget <= 0 || t >= soft) {
            GIVE_BACK;
            if (t >= soft || blocks_clock(s)) {
#if !BLOCKS_METHOD_DOPRI5
                s->fixed = fixed;
#endif
                return BLOCKS_PAUSED;
            }
            TAKE;
        }
        double t1, step, proposed = 0.0, error = 1e-4;
#if BLOCKS_METHOD_DOPRI5
        double left = target - t, least = 16 * blocks_ulp(t), h = s->h, grow = 10.0;
        if (h <= 0) {
            GIVE_BACK;
            h = blocks_first_step(s, left);
            evaluations = s->evaluations;
        }
        h = h < s->longest ? h : s->longest;
        h = h > least ? h : least;
#if BLOCKS_METHOD_AUTO
        const int32_t hits = s->hits, calm = s->calm;
#endif
    again: /* a retaken step was refused, and a shorter one is tried from the same place */
        for (;;) {
            /* The last step before the target is stretched a little rather than followed by a tiny one. */
            t1 = h >= left / 1.01 ? target : t + h;
            step = t1 - t;
            step_of(s, m, moving, t, x, step, k, x1);
            evaluations += LAST;
            error = error_norm(setup, step, k, x, x1);
            if (error <= 1.0) break;
            if (h <= least || step <= least) {
                GIVE_BACK;
                return blocks_fail(s, BLOCKS_TOO_SMALL, 0, step);
            }
            s->rejected++;
            GIVE_BACK;
            GIVE_STEP;
            blame(s, step);
            grow = 1.0;
            h = blocks_larger(step * blocks_reduction(error), least);
        }
        double factor = 0.9 * pow(s->error, 0.04) * pow(blocks_larger(error, 1e-10), -(1.0 / 5 - 0.75 * 0.04));
        proposed = step * blocks_smaller(grow, blocks_larger(0.2, factor));
        if (step < h) proposed = blocks_larger(proposed, h); /* cut short by the target: the proposal before it still counts */
        error = blocks_larger(error, 1e-4);
#if BLOCKS_METHOD_AUTO
        count_stiffness(s, k, x1);
#endif
        if (BLOCKS_NX && !((steps + 1) % BLOCKS_PACE)) {
            GIVE_BACK;
            GIVE_STEP;
            if (blocks_chatters(s, step)) return BLOCKS_FAILED;
            evaluations = s->evaluations;
        }
#else
        t1 = point;
        if (!(target - point > near)) t1 = point >= target || blocks_within_ulps(point, target, 0.0) ? target : point;
        if (BLOCKS_NREMEMBERED && t1 - t > s->longest) /* in equal parts that no delay is shorter than */
            t1 = t + (t1 - t) / ceil((t1 - t) / s->longest);
        step = t1 - t;
        step_of(s, m, moving, t, x, step, k, x1);
        evaluations += LAST;
        if (!(error_norm(setup, step, k, x, x1) == 0.0)) {
            GIVE_BACK;
            s->fixed = fixed;
            return blocks_fail(s, BLOCKS_BLOWN_UP, 0, step);
        }
#endif
#if IS_WATCHED && !BLOCKS_METHOD_DOPRI5
        if (!s->has_before) { /* half a step along the first slope */
            EACH(s->x2[i] = x[i] + 0.5 * step * k[0][i]);
            if (moving) blocks_outside(s, t + 0.5 * step);
            crossings(m, t + 0.5 * step, s->x2, s->crossing_values);
            UNROLL for (int j = 0; j < BLOCKS_NS; j++) before[BLOCKS_NX + j] = s->crossing_values[sides_at[j]];
            s->has_before = 1;
        }
#endif
        int is_quick = IS_PLAIN && !(BLOCKS_TURNING_ROWS && !is_on_grid);
        if (is_quick && is_loud(side, before + BLOCKS_NX, k, s->distances)) {
#if FORETELLS
            is_quick = !moving && !comes_near(s, m, t, t1, x, x1, step, k, side);
#else
            is_quick = 0;
#endif
        }
#if BLOCKS_QUICK_MEASURES
        int unmeasured = is_quick ? measured_inside(s, m, moving, t, t1, step, x, x1, k) : -1;
        is_quick = unmeasured >= 0;
#endif
        if (!is_quick) {
            GIVE_BACK;
            GIVE_STEP;
#if !BLOCKS_METHOD_DOPRI5
            s->fixed = fixed;
#endif
            int stopped = blocks_accept(s, t1, step, proposed, error, target);
            if (stopped >= 0) return stopped;
#if BLOCKS_METHOD_DOPRI5
            if (stopped == BLOCKS_REFUSED) {
                if (s->refused <= least) return blocks_fail(s, BLOCKS_TOO_SMALL, 0, s->refused);
#if BLOCKS_METHOD_AUTO
                s->hits = hits, s->calm = calm;
#endif
                if (!((steps + 1) % BLOCKS_PACE)) s->paced = s->paced_before, s->chatters = s->chattered_before;
                h = blocks_larger(s->refused * blocks_reduction(s->refused_error), least);
                grow = 1.0;
                TAKE;
                goto again;
            }
#endif
            s->has_before = 0;
            if (first_rates(s)) return BLOCKS_FAILED;
            if (has_grid) blocks_next_row(s);
            TAKE;
        } else {
            if (BLOCKS_TURNING_ROWS && has_grid && !(steps % 64)) {
                GIVE_BACK;
                GIVE_STEP;
                s->weighed = 0;
                blocks_look_at_rows(s, t1, step);
            }
#if ROWS_APART
            if (s->next_row < t1) {
                GIVE_BACK;
                GIVE_STEP;
                s->fixed = fixed;
                if (rows_apart(s, t1, step, t1 == target)) return BLOCKS_FAILED;
                TAKE;
                UNROLL for (int i = 0; i < BLOCKS_NX; i++) x1[i] = s->x1[i];
                UNROLL for (int i = 0; i < WIDTH; i++) k[LAST][i] = s->k[LAST][i];
            }
#else
            if (s->next_row < t1 && rows_inside(s, m, moving, t, t1, step, t1 == target, x, k)) {
                GIVE_BACK;
#if !BLOCKS_METHOD_DOPRI5
                s->fixed = fixed;
#endif
                return BLOCKS_FAILED;
            }
#endif
#if BLOCKS_QUICK_MEASURES
            if (!unmeasured && blocks_measure_whole(s, t, t1)) {
                GIVE_BACK;
                return BLOCKS_FAILED;
            }
#endif
            TURN_OVER;
            t = t1;
            steps++;
#if BLOCKS_METHOD_DOPRI5
            s->h = proposed;
            s->error = error;
#endif
            if (t1 == target || !is_on_grid) {
                GIVE_BACK;
#if !BLOCKS_METHOD_DOPRI5
                s->fixed = fixed + (point <= t);
#endif
                if (t1 == target) {
                    s->exact = s->target_exact;
                    s->count = s->target_count;
                    s->outstanding = 1;
                    if (HAS_PLAIN_INSTANTS && s->goes_on && plain_instant(s)) {
                        if (!(t < s->end) || blocks_has_ended(s)) return BLOCKS_DONE;
                        if (t >= soft || (--s->budget <= 0 && blocks_clock(s))) return BLOCKS_PAUSED;
                        target = blocks_next_of(s, BLOCKS_NRATES, BLOCKS_NEVENTS, INFINITY);
                        goto begin;
                    }
                    return BLOCKS_DONE;
                }
                if (blocks_record_step(s)) return BLOCKS_FAILED;
                TAKE;
            }
        }
#if !BLOCKS_METHOD_DOPRI5
        while (point <= t) {
            fixed++;
            if (grid.is_plain) {
                point = blocks_grid(&grid, fixed);
            } else {
                GIVE_BACK;
                point = blocks_divided(&grid, fixed);
                TAKE;
            }
        }
#endif
    }
}

#elif !BLOCKS_METHOD_RADAU
static double trial(BlocksSim *s, double t, const double *x, double h, double *x1, int is_judged)
{
    (void)s, (void)t, (void)x, (void)h, (void)x1, (void)is_judged;
    return 0.0;
}
static int run(BlocksSim *s, double target)
{
    (void)target;
    return blocks_fail(s, BLOCKS_TOO_SMALL, 0, 0.0);
}
#endif

#if BLOCKS_METHOD_RADAU || BLOCKS_METHOD_AUTO
static const BlocksImplicit implicit = {&slopes, ELIMINATION, blocks_stiff_open, blocks_stiff_close};
#endif

static void prepare_all(BlocksMemory *m)
{
    prepare(m);
    m->same = lanes_are_same(m);
}

/* What is the same by every method. */
#if BLOCKS_NF
#define FOREIGN .hooks = &blocks_hooks, .foreign_inputs = foreign_inputs, .ntaken = BLOCKS_NTAKEN,
#else
#define FOREIGN
#endif
#if BLOCKS_HAS_CORNERS
#define CORNERS .corners = &corners,
#else
#define CORNERS
#endif
#define PROGRAMS                                                                                                     \
    .nx = BLOCKS_NX, .nd = BLOCKS_ND, .ns = BLOCKS_NS, .np = BLOCKS_NP, .nu = BLOCKS_NU, .nh = BLOCKS_NH,            \
    .nz = BLOCKS_NZ, .nrates = BLOCKS_NRATES, .nq = BLOCKS_NQ, .nv = BLOCKS_NV, .nw = BLOCKS_NW,                     \
    .nevents = BLOCKS_NEVENTS, .nlogged = BLOCKS_NLOGGED, .nmeasured = BLOCKS_NMEASURED,                             \
    .nprojections = BLOCKS_NPROJECTIONS, .moving_sides = BLOCKS_MOVING_SIDES,                                        \
    .looks = looks, .prepare = prepare_all, .refresh = refresh,                                                      \
    .rates = rates_program, .crossings = crossings, .event_times = event_times, .projections = projections,          \
    .solutions = solutions, .logged = logged, .measured = measured, .start = start,                                  \
    .plain_instant = plain_instant, .resets = resets, .anew = anew, .stepper_inputs = stepper_inputs, .outputs = outputs, .nexts = nexts,            \
    FOREIGN CORNERS

#if BLOCKS_METHOD_AUTO
static const BlocksModel stiff_model = {
    PROGRAMS .stages = BLOCKS_STIFF_STAGES, .degree = BLOCKS_STIFF_DEGREE, .order = 3, .dense = blocks_stiff_dense,
    .trial = blocks_stiff_trial, .run = blocks_stiff_run, .implicit = &implicit,
};
#endif

BLOCKS_API const BlocksModel blocks_model = {
    PROGRAMS .stages = STAGES, .degree = DEGREE, .order = ORDER, .dense = DENSE,
#if BLOCKS_METHOD_RADAU
    .trial = blocks_stiff_trial, .run = blocks_stiff_run, .implicit = &implicit,
#else
    .trial = trial, .run = run,
#endif
#if BLOCKS_METHOD_AUTO
    .implicit = &implicit, .stiff = &stiff_model,
#endif
};
