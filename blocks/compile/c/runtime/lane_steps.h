/* The stepping loop of several runs side by side, one in each lane. Included at the end of the programs of lanes, whose
   sizes are constants here. Twin: steps.h, the same of one run.

   Behind each lane stands a run of its own. A step is made in all lanes at once, each from its own time and of its own
   size. Where it is plain, the lane takes it here; whatever else there is (a change of a side, a row, an instant) happens
   to the lane's own run, by the code that every run has: the lane gives it what it holds, and takes it back. */
#define REAL V
#include "methods.h"

#include <stdlib.h>

#define LAST (STAGES - 1)
#define IS_WATCHED BLOCKS_MOVING_SIDES
#if IS_WATCHED
#define RATES_AND_SIDES rates_and_sides
#else
#define RATES_AND_SIDES rates
#endif
#if BLOCKS_METHOD_DOPRI5
#define WATCHES(n) ((n) == 2 || (n) == 3)
#define IS_PACED(s) (!(((s)->steps + 1) % BLOCKS_PACE))
#else
#define WATCHES(n) 0
#define IS_PACED(s) 0
#endif
#define IS_PLAIN (!BLOCKS_NMEASURED || BLOCKS_QUICK_MEASURES)
#define SOME(n) ((n) > 0 ? (n) : 1)
enum { NX = BLOCKS_NX, NS = BLOCKS_NS, N = BLOCKS_NMEASURED, WIDTH = NX + NS, SPAN = WIDTH + BLOCKS_SHARES_MEASURED * N };

#include "lane_rows.h"

static __attribute__((noinline)) void rates_program(const LanesMemory *m, V t, const V *x, V *out) { rates(m, t, x, out); }
#if IS_WATCHED
static __attribute__((noinline)) void watched_rates(const LanesMemory *m, V t, const V *x, V *out)
{
    rates_and_sides(m, t, x, out);
}
#else
#define watched_rates rates_program
#endif
#if BLOCKS_SHARES_MEASURED
static __attribute__((noinline)) void last_rates(const LanesMemory *m, V t, const V *x, V *out)
{
    rates_and_measured(m, t, x, out);
}
#else
#define last_rates watched_rates
#endif

/* --- a step ------------------------------------------------------------------------------------------------------ */

#define EACH(what) for (int i = 0; i < NX; i++) what
#define STAGE(n, then, y)                                                                                             \
    do {                                                                                                              \
        if (BLOCKS_NU && z->moves) outside(z, then);                                                                  \
        if ((n) == LAST) last_rates(m, then, y, k[n]);                                                                \
        else if (WATCHES(n)) watched_rates(m, then, y, k[n]);                                                         \
        else rates_program(m, then, y, k[n]);                                                                         \
    } while (0)

/* x1 and the stages from 1 on. */
static void make_step(Lanes *z, V h)
{
    const LanesMemory *m = &z->m;
    const V t = z->t, *restrict x = m->x;
    V *restrict x1 = z->x1, *restrict xs = z->xs, *const *k = z->k;
    (void)xs;
    MAKE_STEP
}

/* The rates from which a step begins, in lanes that do not know them. */
static void first_rates(Lanes *z)
{
    V *made = z->k[1];
    if (BLOCKS_NU && z->moves) outside(z, z->t);
    watched_rates(&z->m, z->t, z->m.x, made);
    M fine = ~z->fresh;
    for (int i = 0; i < WIDTH; i++) z->k[0][i] = lanes_choose(z->fresh, made[i], z->k[0][i]);
    V bad = lanes_of(0.0);
    for (int i = 0; i < NX; i++) bad += made[i] * 0.0;
    fine |= bad == 0.0;
    EACH_LANE {
        if (!z->fresh[l]) continue;
        give_back(z, l);
        if (fine[l]) continue;
        int i = 0;
        while (i < NX - 1 && isfinite(made[i][l])) i++;
        blocks_fail(z->lanes[l].s, BLOCKS_NOT_FINITE, i, made[i][l]);
        end_row(&z->lanes[l], BLOCKS_FAILED);
    }
    z->fresh = (M){0};
}

/* The largest error over the states, each by its own tolerance; NaN where a state is not finite. */
static V error_norm(const Lanes *z, V h)
{
    const BlocksSetup *setup = z->lanes[0].s->setup;
    const V *restrict x = z->m.x, *restrict x1 = z->x1;
    V most = lanes_of(0.0), bad = most;
#if BLOCKS_METHOD_DOPRI5
    const double *restrict atol = setup->atol, rtol = setup->rtol;
    const V *restrict k0 = z->k[0], *restrict k2 = z->k[2], *restrict k3 = z->k[3], *restrict k4 = z->k[4],
            *restrict k5 = z->k[5], *restrict k6 = z->k[6];
    for (int i = 0; i < NX; i++) {
        V error = h * ERROR(i), part = lanes_fabs(error) / (atol[i] + rtol * lanes_larger(lanes_fabs(x[i]), lanes_fabs(x1[i])));
        bad += (x1[i] + error) * 0.0;
        most = lanes_larger(part, most);
    }
#else
    (void)setup, (void)x, (void)h;
    EACH(bad += x1[i] * 0.0);
#endif
    return lanes_choose(bad == 0.0, most, lanes_of(NAN));
}

#if IS_WATCHED
/* Whether a side may have changed; see steps.h. */
static M are_loud(const Lanes *z)
{
    M loud = (M){0};
    if (BLOCKS_BENT_SIDES) return ~loud;
    const V *first = z->k[0] + NX, *last = z->k[LAST] + NX;
    for (int j = 0; j < NS; j++) {
        V low = lanes_smaller(first[j], last[j]), high = lanes_larger(first[j], last[j]);
#if BLOCKS_METHOD_DOPRI5
        V second = z->k[2][NX + j], third = z->k[3][NX + j];
        low = lanes_smaller(low, lanes_smaller(second, third));
        high = lanes_larger(high, lanes_larger(second, third));
#else
        low = lanes_smaller(z->before[NX + j], low);
        high = lanes_larger(z->before[NX + j], high);
#endif
        V margin = 3.0 * (high - low) + last[j] * 0.0;
        loud |= ~(lanes_choose(z->sides[j] > 0.0, low, -high) > margin);
    }
    return loud;
}
#else
#define are_loud(z) ((M){0})
#endif

typedef struct {
    V t1, size, error, proposed;
    M taken, handed; /* lanes that took the step here; those whose run did */
} Step;

#include "lane_measures.h"

/* --- what becomes of a step -------------------------------------------------------------------------------------- */

/* Rows of the recording grid inside the step, and looks at its pace; 0: nothing failed. */
static int look_at(Lanes *z, int l, const Step *step)
{
    BlocksSim *s = z->lanes[l].s;
    double t1 = step->t1[l], h = step->size[l];
    int paces = IS_PACED(s), turns = BLOCKS_TURNING_ROWS && !(s->steps % 64), records = s->next_row < t1;
    if (!(paces || turns || records)) return 0;
    give_back(z, l);
    give_step(z, l);
    s->weighed = 0;
    if (paces && blocks_chatters(s, h)) return 1;
    if (turns && s->setup->every.is_given) blocks_look_at_rows(s, t1, h);
    if (records && blocks_rows_inside(s, t1, h, t1 == z->target[l])) return 1;
    s->weighed = 0;
    if (records) blocks_next_row(s);
    return 0;
}

/* Let a lane's run take a step that is not plain. */
static void hand_over(Lanes *z, int l, Step *step)
{
    Lane *lane = &z->lanes[l];
    give_back(z, l);
    give_step(z, l);
    give_measures(z, l);
    int stopped = blocks_accept(lane->s, step->t1[l], step->size[l], step->proposed[l], step->error[l], z->target[l]);
    if (stopped == BLOCKS_DONE) lane->state = DUE;
    else if (stopped > 0) end_row(lane, stopped);
    step->handed[l] = stopped == BLOCKS_REFUSED || stopped >= 0 ? 0 : -1;
#if BLOCKS_METHOD_DOPRI5
    if (stopped != BLOCKS_REFUSED) return;
    const double least = 16.0 * blocks_ulp(z->t[l]);
    z->h[l] = blocks_larger(lane->s->refused * blocks_reduction(lane->s->refused_error), least);
    z->grow[l] = 1.0;
    if (!(lane->s->refused <= least)) return;
    blocks_fail(lane->s, BLOCKS_TOO_SMALL, 0, lane->s->refused);
    end_row(lane, BLOCKS_FAILED);
#endif
}

/* Each lane's part in an accepted step. */
static void accept(Lanes *z, const BlocksBatch *b, Step *step, M accepted)
{
    M quiet = accepted & ~are_loud(z), failed = (M){0};
    if (!IS_PLAIN) quiet = (M){0};
#if BLOCKS_QUICK_MEASURES
    M measured_here = to_measure(z, step, &quiet);
    if (lanes_any(measured_here)) quiet &= ~measured_inside(z, step->t1, step->size, measured_here);
    failed = take_measures(z, step->t1, step->size, measured_here & quiet);
#endif
    step->taken = quiet;
    step->handed = (M){0};
    EACH_LANE {
        Lane *lane = &z->lanes[l];
        BlocksSim *s = lane->s;
        if (!accepted[l]) continue;
        if (!quiet[l]) {
            hand_over(z, l, step);
        } else {
            if (look_at(z, l, step) || failed[l]) end_row(lane, BLOCKS_FAILED);
            s->steps++;
        }
        if (b->budget && lane->state == FLOWING && s->steps + s->rejected > b->budget) end_row(lane, BLOCKS_PAUSED);
    }
}

/* The lanes that took the step stand at its end; so do those whose run did. */
static void turn_over(Lanes *z, const Step *step)
{
    M taken = step->taken;
    if (!lanes_any(~taken & z->flowing)) {
        V *old = z->m.x, *oldest = z->before;
        z->m.x = z->x1, z->x1 = old, z->before = z->k[0], z->k[0] = z->k[LAST], z->k[LAST] = oldest;
    } else {
        for (int i = NX; i < WIDTH; i++) z->before[i] = lanes_choose(taken, z->k[0][i], z->before[i]);
        for (int i = 0; i < NX; i++) z->m.x[i] = lanes_choose(taken, z->x1[i], z->m.x[i]);
        for (int i = 0; i < WIDTH; i++) z->k[0][i] = lanes_choose(taken, z->k[LAST][i], z->k[0][i]);
    }
    z->t = lanes_choose(taken, step->t1, z->t);
    z->h = lanes_choose(taken, step->proposed, z->h);
    z->error = lanes_choose(taken, step->error, z->error);
    M there = taken & (step->t1 == z->target);
    if (!lanes_any(there | step->handed)) return;
    EACH_LANE {
        BlocksSim *s = z->lanes[l].s;
        if (step->handed[l] && z->lanes[l].state == FLOWING) {
            take_back(z, l);
            if (s->setup->every.is_given) blocks_next_row(s);
        }
        if (!there[l] || z->lanes[l].state != FLOWING) continue;
        give_back(z, l);
        give_measures(z, l);
        s->exact = s->target_exact;
        s->count = s->target_count;
        s->outstanding = 1;
        z->lanes[l].state = DUE;
    }
}

#if BLOCKS_METHOD_DOPRI5

static void first_steps(Lanes *z)
{
    EACH_LANE {
        if (z->lanes[l].state != FLOWING || z->h[l] > 0.0) continue;
        give_back(z, l);
        z->h[l] = blocks_first_step(z->lanes[l].s, z->target[l] - z->t[l]);
    }
}

static void step_once(Lanes *z, BlocksBatch *b)
{
    const double longest = z->lanes[0].s->longest;
    Step step;
    if (lanes_any(z->flowing & ~(z->h > 0.0))) first_steps(z);
    V left = z->target - z->t, least = 16.0 * lanes_ulp(z->t);
    V h = lanes_larger(lanes_smaller(z->h, lanes_of(longest)), least);
    step.t1 = lanes_choose(h >= left / 1.01, z->target, z->t + h);
    step.size = step.t1 - z->t;
    make_step(z, step.size);
    V error = error_norm(z, step.size);
    M accepted = z->flowing & (error <= 1.0), refused = z->flowing & ~accepted;
    V factor = 0.9 * lanes_pow(z->error, lanes_of(0.04)) *
               lanes_pow(lanes_larger(error, lanes_of(1e-10)), lanes_of(-(1.0 / 5 - 0.75 * 0.04)));
    step.proposed = step.size * lanes_smaller(z->grow, lanes_larger(lanes_of(0.2), factor));
    step.proposed = lanes_choose(step.size < h, lanes_larger(step.proposed, h), step.proposed);
    step.error = lanes_larger(error, lanes_of(1e-4));
    z->grow = lanes_choose(accepted, lanes_of(10.0), z->grow);
    accept(z, b, &step, accepted);
    turn_over(z, &step);
    if (!lanes_any(refused)) return;
    factor = lanes_larger(lanes_of(0.2), 0.9 * lanes_pow(error, lanes_of(-1.0 / 5)));
    factor = lanes_choose(lanes_are_finite(error), factor, lanes_of(0.1));
    z->h = lanes_choose(refused, lanes_larger(step.size * factor, least), z->h);
    z->grow = lanes_choose(refused, lanes_of(1.0), z->grow);
    M stuck = refused & ((h <= least) | (step.size <= least));
    EACH_LANE {
        if (!refused[l]) continue;
        BlocksSim *s = z->lanes[l].s;
        s->rejected++;
        if (stuck[l]) {
            give_back(z, l);
            blocks_fail(s, BLOCKS_TOO_SMALL, 0, step.size[l]);
            end_row(&z->lanes[l], BLOCKS_FAILED);
        } else if (b->budget && s->steps + s->rejected > b->budget) end_row(&z->lanes[l], BLOCKS_PAUSED);
    }
}

#else

#if IS_WATCHED
/* Half a step along the first slope, in place of the step before. */
static void take_before(Lanes *z, int l, double h)
{
    BlocksSim *s = z->lanes[l].s;
    give_back(z, l);
    EACH(s->x2[i] = s->memory.x[i] + 0.5 * h * s->k[0][i]);
    blocks_evaluate(s, s->model->crossings, s->t + 0.5 * h, s->x2, s->crossing_values);
    for (int j = 0; j < NS; j++) z->before[NX + j][l] = s->crossing_values[sides_at[j]];
    s->has_before = 1;
}
#endif

/* The end of a lane's next step: a point of the grid of steps, or the target. */
static double next_point(Lanes *z, int l)
{
    BlocksSim *s = z->lanes[l].s;
    const BlocksGrid *grid = &s->setup->fixed;
    double t = z->t[l], target = z->target[l], near = 1e-12 * fabs(target), point;
    while ((point = blocks_grid(grid, s->fixed)) <= t) s->fixed++;
    if (target - point > near) return point;
    return point >= target || blocks_within_ulps(point, target, 0.0) ? target : point;
}

static void step_once(Lanes *z, BlocksBatch *b)
{
    Step step;
    step.t1 = z->t;
    EACH_LANE if (z->lanes[l].state == FLOWING) step.t1[l] = next_point(z, l);
    step.size = step.t1 - z->t;
    step.proposed = lanes_of(0.0);
    step.error = lanes_of(1e-4);
#if IS_WATCHED
    EACH_LANE if (z->lanes[l].state == FLOWING && !z->lanes[l].s->has_before) take_before(z, l, step.size[l]);
#endif
    make_step(z, step.size);
    M accepted = z->flowing & (error_norm(z, step.size) == 0.0), blown = z->flowing & ~accepted;
    accept(z, b, &step, accepted);
    turn_over(z, &step);
    if (!lanes_any(blown)) return;
    EACH_LANE {
        if (!blown[l]) continue;
        give_back(z, l);
        blocks_fail(z->lanes[l].s, BLOCKS_BLOWN_UP, 0, step.size[l]);
        end_row(&z->lanes[l], BLOCKS_FAILED);
    }
}

#endif

/* --- all rows ---------------------------------------------------------------------------------------------------- */

/* Make steps while all lanes flow that did. */
static void flow(Lanes *z, BlocksBatch *b)
{
    M flowing = (M){0};
    EACH_LANE z->flowing[l] = -(z->lanes[l].state == FLOWING);
    do {
        z->fresh &= z->flowing;
        if (lanes_any(z->fresh)) first_rates(z);
        else step_once(z, b);
        EACH_LANE flowing[l] = -(z->lanes[l].state == FLOWING);
    } while (!lanes_any(z->flowing & ~flowing) && !blocks_is_cancelled(b));
}

/* Let lanes without a row stand where another lane stands: what they compute is as harmless as that. */
static void park(Lanes *z)
{
    int other = -1;
    EACH_LANE if (z->lanes[l].state == FLOWING) other = l;
    EACH_LANE {
        if (z->lanes[l].state != IDLE || other < 0) continue;
        z->lanes[l].state = PARKED;
        for (V *row = &z->rows_x[0][0]; row <= &z->known; row++) (*row)[l] = (*row)[other];
        z->target[l] = z->t[l];
    }
}

int64_t blocks_lanes(BlocksBatch *b, BlocksLanes *z, int32_t *which)
{
    for (int any = 1; any && !blocks_is_cancelled(b);) {
        any = 0;
        EACH_LANE {
            Lane *lane = &z->lanes[l];
            while (lane->state < FLOWING) {
                if (lane->state == EMPTY) {
                    begin_row(z, b, l);
                } else if (lane->state == DUE) {
                    settle(z, b, l);
                } else {
                    lane->state = EMPTY;
                    blocks_row_keep(b, lane->s, lane->row, lane->status, lane->room);
                    *which = l;
                    if (b->is_by_one) return lane->row;
                }
            }
            any |= lane->state == FLOWING;
        }
        park(z);
        if (any) flow(z, b);
    }
    return -1;
}

BlocksLanes *blocks_lanes_new(BlocksSim **sims, double *room, int64_t each)
{
    void *place = calloc(1, sizeof(Lanes) + 64);
    if (!place) return NULL;
    Lanes *z = (Lanes *)(((uintptr_t)place + 63) / 64 * 64);
    z->place = place;
    z->model = *sims[0]->model;
    z->model.run = flow_in_lane;
    z->m = (LanesMemory){z->rows_x[0], z->d, z->s, z->p, z->u, NULL, z->tick, z->q, z->v, z->n, z->w, sims[0]->memory.c};
    z->x1 = z->rows_x[1];
    for (int n = 0; n < STAGES; n++) z->k[n] = z->rows_k[n];
    z->before = z->rows_k[STAGES];
    for (int i = 0; i < BLOCKS_NN; i++) z->n[i] = lanes_of(sims[0]->memory.n[i]);
    EACH_LANE {
        z->lanes[l].s = sims[l];
        z->lanes[l].room = sims[l] ? room + l * each : NULL;
        z->lanes[l].state = sims[l] ? EMPTY : IDLE;
    }
    return z;
}

void blocks_lanes_free(BlocksLanes *z)
{
    if (z) free(z->place);
}
