/* See master.h. A failure is written down once, where it is found; all that called it comes back. */
#define _POSIX_C_SOURCE 200809L
#include "master.h"
#include "master_limits.h" /* the constants of master_limits.py */

#include <stdbool.h>
#include <stdlib.h>
#include <time.h>

enum { OK = 0, WARNING, DISCARD, ERROR_, FATAL, PENDING }; /* what functions of FMUs return */

#if defined(_MSC_VER)
#define OF_THREAD static __declspec(thread)
#else
#define OF_THREAD static _Thread_local
#endif
OF_THREAD MasterUnit *stepped; /* whose step is under way: FMUs call back in the thread that called them */
OF_THREAD int inner_status, inner_call; /* the first status within the step that was not ok, and whose */

/* --- functions of FMUs ------------------------------------------------------------------------------------------ */

typedef int (*Move2)(void *, const uint32_t *, size_t, void *);
typedef int (*Move3)(void *, const uint32_t *, size_t, void *, size_t);
typedef int (*Step2)(void *, double, double, int);
typedef int (*Step3)(void *, double, double, bool, bool *, bool *, bool *, double *);
typedef int (*State)(void *, void **);
typedef int (*Restore)(void *, void *);
typedef int (*Derivatives)(void *, const uint32_t *, size_t, const int *, const double *);
typedef int (*RealStatus)(void *, int, double *);
typedef int (*BooleanStatus)(void *, int, int *);
typedef int (*Plain)(void *);
typedef int (*Update)(void *, bool *, bool *, bool *, bool *, bool *, double *);
typedef int (*Proceed)(BlocksSim *, double, int64_t, int32_t);
typedef int (*OfSim)(BlocksSim *);
typedef int (*IsDue)(const BlocksSim *);
typedef int (*Logged)(BlocksSim *, double *);
typedef void (*Reload)(BlocksSim *);
typedef double (*Next)(BlocksSim *);

/* A pointer to a function out of one to an object: POSIX and Windows allow it, C does not know of it. */
#define CALL(type, unit, which) (*(type *)&(unit)->calls[which])
#define MOVE(type, group) (*(type *)&(group)->move)

static int fail(Master *m, int failure, int unit, int function, int status, double value)
{
    if (m->failure) return 1;
    m->failure = failure;
    m->unit = unit;
    m->function = function;
    m->status = status;
    m->value = value;
    m->failed_t = m->t;
    return 1;
}

static int number_of(const Master *m, const MasterUnit *u) { return (int)(u - m->units); }

/* 0 where a status is ok or a warning. */
static int judged(Master *m, MasterUnit *u, int function, int status)
{
    if (status == WARNING && !u->warnings++) u->warned = function, u->warned_t = m->t;
    return status == OK || status == WARNING ? 0 : fail(m, MASTER_STATUS, number_of(m, u), function, status, 0.0);
}

/* An FMU ended the run at t, in a step to t1: nothing is set in it from then on. */
static int ends_run(MasterUnit *u, double t, double t1)
{
    u->is_over = 1;
    u->over_t = u->reached = t < t1 ? t : t1;
    return 0;
}

static int is_over(const Master *m)
{
    for (int k = 0; k < m->nunits; k++)
        if (m->units[k].is_over) return 1;
    return 0;
}

/* Whether a unit ended the run, or its condition: behind a unit that lags, that is one of its extrapolated outputs. */
int master_has_ended(const Master *m)
{
    if (is_over(m)) return 1;
    if (m->ending < 0 || m->y[m->ending] == 0.0) return 0;
    for (int k = 0; k < m->nunits; k++)
        if (m->units[k].t != m->t) return 0;
    return 1;
}

static void pack(const MasterGroup *g, const double *from)
{
#define EACH(made)                                                                                                     \
    for (int64_t i = 0; i < g->nvalues; i++) own[i] = made
#define PACK(name, type)                                                                                               \
    case BLOCKS_##name: {                                                                                              \
        type *own = g->buffer;                                                                                         \
        if (g->offsets)                                                                                                \
            EACH((type)((from[g->places[i]] - g->offsets[i]) / (g->scales ? g->scales[i] : 1.0)));                     \
        else if (g->scales)                                                                                            \
            EACH((type)(from[g->places[i]] / g->scales[i]));                                                           \
        else                                                                                                           \
            EACH((type)from[g->places[i]]);                                                                            \
        break;                                                                                                         \
    }
    switch (g->type) {
        PACK(FLOAT64, double)
        BLOCKS_CONVERTED(PACK)
    default: break;
    }
#undef EACH
}

static void unpack(const MasterGroup *g, double *to)
{
#define UNPACK(name, type)                                                                                             \
    case BLOCKS_##name:                                                                                                \
        for (int64_t i = 0; i < g->nvalues; i++) {                                                                     \
            double v = (double)((const type *)g->buffer)[i];                                                           \
            if (g->places[i] < 0) continue;                                                                            \
            if (g->scales) v *= g->scales[i];                                                                          \
            to[g->places[i]] = g->offsets && g->offsets[i] != 0.0 ? v + g->offsets[i] : v;                             \
        }                                                                                                              \
        break;
    switch (g->type) {
        UNPACK(FLOAT64, double)
        BLOCKS_CONVERTED(UNPACK)
    default: break;
    }
}

static int moved(Master *m, MasterUnit *u, MasterGroup *g)
{
    int status = u->kind == MASTER_FMI2
                     ? MOVE(Move2, g)(u->component, g->references, (size_t)g->nreferences, g->buffer)
                     : MOVE(Move3, g)(u->component, g->references, (size_t)g->nreferences, g->buffer, (size_t)g->nvalues);
    return status ? judged(m, u, -1 - g->number, status) : 0;
}

/* --- values ------------------------------------------------------------------------------------------------------ */

static void course_of(const MasterPast *p, int order, double t, double *course)
{
    course[1] = course[2] = 0.0;
    if (p->n == 1 || order == 0) {
        course[0] = p->y[0];
        return;
    }
    double t0 = p->t[0], t1 = p->t[1], y0 = p->y[0], y1 = p->y[1], slope = (y0 - y1) / (t0 - t1);
    if (p->n == 2 || order == 1) {
        course[0] = y0 + (t - t0) * slope;
        course[1] = slope;
        return;
    }
    double t2 = p->t[2], curve = (slope - (y1 - p->y[2]) / (t1 - t2)) / (t0 - t2);
    course[0] = y0 + (t - t0) * (slope + (t - t1) * curve);
    course[1] = slope + (2 * t - t0 - t1) * curve;
    course[2] = 2 * curve;
}

static void remember(MasterPast *p, double t, double y)
{
    p->t[2] = p->t[1], p->y[2] = p->y[1];
    p->t[1] = p->t[0], p->y[1] = p->y[0];
    p->t[0] = t, p->y[0] = y;
    if (p->n < 3) p->n++;
}

/* Adds a point; 1 where it replaces the last one, which is closer than `apart`: a course through both would be one of their
   errors. */
static int add_point(MasterPast *p, double t, double y, double apart)
{
    int is_close = p->n && t - p->t[0] < apart;
    if (is_close && (!p->has_aside || t - p->aside_t < apart)) {
        if (!p->has_aside && p->t[0] < t) p->aside_t = p->t[0], p->aside_y = p->y[0], p->has_aside = 1;
        p->t[0] = t, p->y[0] = y;
        return 1;
    }
    if (is_close) p->t[0] = p->aside_t, p->y[0] = p->aside_y;
    p->has_aside = 0;
    remember(p, t, y);
    return 0;
}

static void begin_anew(MasterPast *p, double t, double y)
{
    p->n = 1, p->has_aside = 0;
    p->t[0] = t, p->y[0] = y;
}

static double input_at(const Master *m, int place, double t)
{
    double a = m->base[place], b = m->aim[place];
    if (a == b) return a;
    double share = (t - m->begin[place]) / (m->finish[place] - m->begin[place]);
    return (1.0 - share) * a + share * b;
}

static double element_at(const Master *m, int g, double t)
{
    if (m->elements[g].is_held || !m->needs_past || m->past[g].n == 0 || m->units[m->elements[g].unit].t == t) return m->y[g];
    double course[3];
    course_of(&m->past[g], m->order, t, course);
    return course[0];
}

static double value_at(const Master *m, const MasterLink *link, double t)
{
    if (link->row == MASTER_ELEMENT) return element_at(m, link->place, t);
    return link->row == MASTER_INPUT ? input_at(m, link->place, t) : link->constant;
}

/* The segment of the diagram's inputs from t on. */
static void take_segment(Master *m, double t)
{
    int place = 0;
    for (int j = 0; j < m->ntracks; j++) {
        const BlocksTrack *track = &m->tracks[j];
        int64_t k = -1;
        while (k + 1 < track->n && track->t[k + 1] <= t) k++;
        int64_t row = k > 0 ? k : 0, following = track->linear && k >= 0 && k < track->n - 1 ? k + 1 : row;
        for (int i = 0; i < track->size; i++, place++) {
            m->base[place] = track->u[row * track->size + i];
            m->aim[place] = track->u[following * track->size + i];
            m->begin[place] = track->t[row];
            m->finish[place] = track->t[following];
        }
    }
}

static double next_break(const Master *m, double t)
{
    double best = INFINITY;
    for (int j = 0; j < m->ntracks; j++) {
        const BlocksTrack *track = &m->tracks[j];
        if (track->n < 2) continue;
        for (int64_t k = 0; k < track->n; k++)
            if (track->t[k] > t) {
                if (track->t[k] < best) best = track->t[k];
                break;
            }
    }
    return best;
}

/* --- units -------------------------------------------------------------------------------------------------------- */

static int set_groups(Master *m, MasterUnit *u, MasterGroup *sets, int n, int moving_only)
{
    for (int i = 0; i < n; i++) {
        MasterGroup *g = &sets[i];
        if (moving_only && !g->is_moving) continue;
        pack(g, u->inputs);
        if (moved(m, u, g)) return 1;
    }
    return 0;
}

/* All inputs as they are at t. */
static void take_inputs(Master *m, MasterUnit *u, double t)
{
    for (int i = 0; i < u->ninputs; i++) u->inputs[i] = value_at(m, &u->links[i], t);
}

static void native_inputs(MasterUnit *u, int has_slopes)
{
    BlocksSim *s = u->component;
    if (u->ninputs) memcpy(u->track, u->inputs, (size_t)u->ninputs * sizeof(double));
    s->polynomials = has_slopes ? &u->polynomials : NULL;
    CALL(Reload, u, CALL_reload)(s);
    s->has_first = s->has_before = 0;
}

/* Start a native unit with its present inputs. */
static int begin_native(Master *m, MasterUnit *u)
{
    if (u->ninputs) memcpy(u->track, u->inputs, (size_t)u->ninputs * sizeof(double));
    return u->stand(u->component) ? fail(m, MASTER_NOT_BEGUN, number_of(m, u), 0, 0, 0.0) : 0;
}

/* Gives a unit its inputs as they stand in u->inputs, an FMU these of them, for its outputs now. What is discrete can be
   set in initialization and event mode only, where there is one. */
static int put(Master *m, MasterUnit *u, MasterGroup *sets, int n)
{
    if (u->kind == MASTER_NATIVE) {
        if (m->is_starting) return begin_native(m, u);
        native_inputs(u, 0);
        return 0;
    }
    return u->is_over ? 0 : set_groups(m, u, sets, n, u->has_instants && !m->is_starting);
}

/* What a unit gives, into `to` by elements. */
static int get(Master *m, MasterUnit *u, double *to)
{
    if (u->kind == MASTER_NATIVE) {
        if (!u->noutputs) return 0;
        if (CALL(Logged, u, CALL_logged)(u->component, u->given)) return fail(m, MASTER_SIMULATION, number_of(m, u), 0, 0, 0.0);
        for (int i = 0; i < u->noutputs; i++) to[u->outputs[i]] = u->given[i];
        return 0;
    }
    for (int i = 0; i < u->ngets; i++) {
        if (moved(m, u, &u->gets[i])) return 1;
        unpack(&u->gets[i], to);
    }
    return 0;
}

/* Save a native unit, or restore it (writes). Returns the number of bytes. Its past only grows meanwhile, and is kept. */
static int64_t native_copy(MasterUnit *u, unsigned char *bytes, int writes)
{
    BlocksSim *s = u->component;
    BlocksWalk w = {bytes, bytes ? bytes + u->saved_bytes : NULL, writes, 0, 0};
    size_t row = (size_t)u->ninputs * sizeof(double);
#define WALK(number) blocks_walk(&w, &(number), sizeof(number))
    blocks_walk_run(&w, s);
    WALK(s->polynomials), WALK(s->fired_events.used), WALK(s->flowed), WALK(u->polynomials.t0);
    blocks_walk(&w, u->inputs, row), blocks_walk(&w, u->terms, 4 * row), blocks_walk(&w, u->track, row);
#undef WALK
    return (int64_t)w.count;
}

static int save(Master *m, MasterUnit *u, int whose)
{
    u->has_saved = 1;
    u->begin = u->t;
    if (u->kind == MASTER_NATIVE) {
        if (whose == MASTER_OF_CONTROL) blocks_forget(u->component, u->t);
        native_copy(u, u->saved[whose], 0);
        return 0;
    }
    return judged(m, u, CALL_GetFMUState, CALL(State, u, CALL_GetFMUState)(u->component, &u->saved[whose]));
}

static int restore(Master *m, MasterUnit *u, int whose)
{
    if (u->kind == MASTER_NATIVE) {
        native_copy(u, u->saved[whose], 1);
        BlocksSim *s = u->component;
        int had = s->has_first;
        double sides_t = s->sides_t;
        CALL(Reload, u, CALL_reload)(s);
        s->has_first = had;
        s->is_factored = 0;
        s->sides_t = sides_t;
        return 0;
    }
    u->is_over = 0;
    return judged(m, u, CALL_SetFMUState, CALL(Restore, u, CALL_SetFMUState)(u->component, u->saved[whose]));
}

/* Inputs as they are `since` seconds after the begin of the step; or on the mean over so many. */
static void along(MasterUnit *u, double since, int is_mean)
{
    for (int i = 0; i < u->ninputs; i++) {
        const double *c = u->courses + 3 * i;
        u->inputs[i] = is_mean ? c[0] + since * (c[1] / 2 + since * c[2] / 6) : c[0] + since * (c[1] + since * c[2] / 2);
    }
}

void master_intermediate(void *environment, double t, int set_requested, int get_allowed, int finished, int can_return,
                         void *early, double *early_time)
{
    MasterUnit *u = stepped;
    (void)environment, (void)get_allowed, (void)finished, (void)can_return, (void)early_time;
    if (early) *(bool *)early = false;
    if (!u || !set_requested) return;
    along(u, t - u->begin, 0);
    for (int i = 0; i < u->nsets; i++) {
        MasterGroup *g = &u->sets[i];
        if (!g->is_moving) continue;
        pack(g, u->inputs);
        int status = MOVE(Move3, g)(u->component, g->references, (size_t)g->nreferences, g->buffer, (size_t)g->nvalues);
        if (status && !inner_status) inner_status = status, inner_call = -1 - g->number;
    }
}

/* Whether an element has another value since the instant now. */
static int moved_now(const Master *m, int g) { return m->units[m->elements[g].unit].t == m->t && m->y[g] != m->left_y[g]; }

/* Whether an element, which had another value before, differs by more than rounding. */
static int has_jumped(const Master *m, int g, double before)
{
    const MasterPast *p = &m->past[g];
    double now = m->y[g], size = fmax(fabs(now), fabs(before));
    for (int i = 0; i < p->n; i++) size = fmax(size, fabs(p->y[i]));
    if (p->has_aside) size = fmax(size, fabs(p->aside_y));
    return m->elements[g].is_held || !(fabs(now - before) <= JUMPED * size);
}

static int jumped_now(const Master *m, int g) { return moved_now(m, g) && has_jumped(m, g, m->left_y[g]); }

/* Whether what happens now in a native unit can be seen outside; see Coupling.seen. */
static int is_seen(const MasterUnit *u)
{
    const BlocksSim *s = u->component;
    const BlocksModel *model = s->model;
    const uint8_t *rates = u->seen;
    if (!rates) return 1;
    const uint8_t *crossings = rates + model->nrates, *events = crossings + model->ns, *histories = events + model->nevents;
    for (int r = 0; r < model->nrates && s->exact == 1; r++)
        if (rates[r] && s->setup->rates[r].offset + s->ticks[r] * s->setup->rates[r].period == s->count) return 1;
    for (int i = 0; i < model->nevents; i++)
        if (events[i] && blocks_within_ulps(s->events[i], s->t, s->scale)) return 1;
    int any = !s->crossing, is_known = s->sides_t == s->t;
    for (int j = 0; j < model->ns && s->crossing && is_known; j++) {
        if ((s->sides[j] >= 0) == (s->memory.s[j] > 0)) continue;
        any = 1;
        if (crossings[j]) return 1;
    }
    for (int j = 0; j < model->ns && !any; j++)
        if (crossings[j]) return 1; /* which side changes is not known */
    for (int i = 0; i < model->nh; i++) {
        const BlocksPast *past = &s->past;
        if (!histories[i] || past->passed[i] >= past->broken || past->orders[past->passed[i]] >= BLOCKS_COURSE) continue;
        double due = past->breaks[past->passed[i]] + blocks_delay(s, i);
        if (blocks_is_due_at(due, s->t, s->scale)) return 1;
    }
    return 0;
}

/* A native unit stands at a communication point, before anything happens there. */
static void arrive(Master *m, MasterUnit *u)
{
    if (u->kind != MASTER_NATIVE) return;
    const BlocksSim *s = u->component;
    const BlocksModel *model = s->model;
    double *to = u->stood;
    if (!m->is_controlled) blocks_forget(u->component, m->t);
    take_inputs(m, u, m->t);
    if (u->ninputs) memcpy(u->given + u->noutputs, u->inputs, (size_t)u->ninputs * sizeof(double));
    if (!u->follows) return;
    memcpy(to, s->memory.x, (size_t)model->nx * sizeof(double));
    memcpy(to += model->nx, s->memory.d, (size_t)model->nd * sizeof(double));
    memcpy(to += model->nd, s->memory.s, (size_t)model->ns * sizeof(double));
    if (model->nh) memcpy(u->passed, s->past.passed, (size_t)model->nh * sizeof(int64_t));
}

/* The elements of a unit that take a new course, as something that they follow has changed since it arrived. */
static void renew(Master *m, MasterUnit *u, int at_break)
{
    int any = 0;
    if (!u->follows) {
        any = u->is_bent;
        for (int i = 0; i < u->ninputs && !any; i++)
            any = u->links[i].row == MASTER_ELEMENT ? jumped_now(m, u->links[i].place) : at_break && u->links[i].row == MASTER_INPUT;
        for (int i = 0; i < u->noutputs && any; i++) m->renewed[u->outputs[i]] = 1;
        return;
    }
    const BlocksSim *s = u->component;
    const BlocksModel *model = s->model;
    const double *rows[] = {s->memory.x, s->memory.d, s->memory.s}, *before = u->stood;
    const int sizes[] = {model->nx, model->nd, model->ns};
    uint8_t *moved_ = u->moved;
    for (int r = 0; r < 3; before += sizes[r], moved_ += sizes[r], r++)
        for (int i = 0; i < sizes[r]; i++) any |= moved_[i] = rows[r][i] != before[i];
    for (int i = 0; i < u->ninputs; i++)
        any |= moved_[i] = u->links[i].row == MASTER_ELEMENT ? jumped_now(m, u->links[i].place) : at_break && u->links[i].row == MASTER_INPUT;
    moved_ += u->ninputs;
    for (int i = 0; i < model->nh; i++) {
        moved_[i] = 0;
        for (int64_t k = u->passed[i]; k < s->past.passed[i]; k++) moved_[i] |= s->past.orders[k] < BLOCKS_COURSE;
        any |= moved_[i];
    }
    for (int i = 0; i < u->noutputs && any; i++)
        for (int k = u->follow_first[i]; k < u->follow_first[i + 1]; k++)
            if (u->moved[u->follows[k]]) {
                m->renewed[u->outputs[i]] = 1;
                break;
            }
}

static int step_native(Master *m, MasterUnit *u, double t1)
{
    BlocksSim *s = u->component;
    int n = u->ninputs, has_slopes = 0;
    for (int i = 0; i < n; i++) {
        const double *c = u->courses + 3 * i;
        u->inputs[i] = u->terms[i] = c[0];
        u->terms[n + i] = c[1];
        u->terms[2 * n + i] = c[2];
        u->terms[3 * n + i] = 0.0;
        if (c[1] != 0.0 || c[2] != 0.0) has_slopes = 1;
    }
    u->polynomials.t0 = s->t;
    memcpy(u->counted, s->fired, (size_t)s->model->ns * sizeof(double));
    u->crossed_first = s->crossed_first;
    u->crossed_count = s->crossed_count;
    native_inputs(u, has_slopes);
    double next = CALL(Next, u, CALL_next)(s), goal = t1;
    /* A tick happens at its own time only; the edge of a delay happens at a point beside it. */
    if (s->target_exact && blocks_within_ulps(next, t1, s->scale)) goal = next;
    u->reached = t1;
    u->is_due = 0;
    while (s->t < goal) {
        int came = CALL(Proceed, u, CALL_proceed)(s, goal, 0, 0);
        if (came == BLOCKS_FAILED || came == BLOCKS_NO_MEMORY) return fail(m, MASTER_SIMULATION, number_of(m, u), 0, came, 0.0);
        if (!s->outstanding) continue;
        if (!(s->t < goal)) break;
        if (!CALL(IsDue, u, CALL_is_due)(s)) {
            s->outstanding = 0;
        } else if (is_seen(u)) {
            u->reached = s->t;
            u->is_due = 1;
            /* Where it goes back and comes here again, a short step may not see that a signal goes on behind a crossing. */
            s->sure_t = s->located_t;
            memcpy(s->sure, s->located, (size_t)s->model->ns * sizeof(double));
            return 0;
        } else if (CALL(OfSim, u, CALL_settle)(s)) {
            return fail(m, MASTER_SIMULATION, number_of(m, u), 0, 0, 0.0);
        }
    }
    u->is_due = 1;
    return 0;
}

static int derivatives(Master *m, MasterUnit *u)
{
    for (int k = 0; k < u->nsets; k++) {
        MasterGroup *g = &u->sets[k];
        if (!g->is_moving) continue;
        int *orders = (int *)((char *)g->buffer + (size_t)g->nvalues * sizeof(double));
        for (int order = 1; order <= u->takes; order++) {
            int any = 0;
            for (int64_t i = 0; i < g->nvalues; i++) {
                double v = u->courses[3 * g->places[i] + order];
                if (v != 0.0) any = 1;
                ((double *)g->buffer)[i] = g->scales ? v / g->scales[i] : v;
                orders[i] = order;
            }
            if (order == 2 && !any) break;
            int status = CALL(Derivatives, u, CALL_SetRealInputDerivatives)(u->component, g->references, (size_t)g->nvalues, orders,
                                                                (const double *)g->buffer);
            if (status == DISCARD || status == ERROR_) { /* the next lower order, or the mean, from now on */
                u->takes = order - 1;
                u->refused = status;
                u->refused_t = u->t;
                if (!u->takes) u->way = MASTER_MEAN;
                return 0;
            }
            if (judged(m, u, CALL_SetRealInputDerivatives, status)) return 1;
        }
    }
    return 0;
}

/* The clock is looked at after each step, as one step of an FMU may take a minute: by the coarse one where there is one,
   which is right to some ms and costs a fifth. */
static double seconds(void)
{
    struct timespec now;
#if defined(_WIN32)
    timespec_get(&now, TIME_UTC);
#elif defined(CLOCK_MONOTONIC_COARSE)
    clock_gettime(CLOCK_MONOTONIC_COARSE, &now);
#else
    clock_gettime(CLOCK_MONOTONIC, &now);
#endif
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* The status of a step of FMI 2 that was pending, when it is done; pending where it takes too long. call: that which gave
   the status. */
static int settled(Master *m, MasterUnit *u, int *call)
{
    double until = seconds() + m->patience;
    for (long nap = 0;; nap = nap < 10000000 ? nap + 100000 : nap) {
        int found = PENDING, status = CALL(BooleanStatus, u, CALL_GetStatus)(u->component, 0, &found);
        if (status == ERROR_ || status == FATAL) {
            *call = CALL_GetStatus;
            return status;
        }
        if (status > WARNING || found != PENDING) return found;
        if (seconds() >= until) return PENDING;
#if !defined(_WIN32)
        struct timespec rest = {0, nap};
        nanosleep(&rest, NULL);
#endif
    }
}

/* From u->t to t1 along u->courses; where it came to is u->reached. */
static int step_unit(Master *m, MasterUnit *u, double t1)
{
    m->steps++;
    if (u->kind == MASTER_NATIVE) return step_native(m, u, t1);
    double t = u->t, end = t1, least = (t1 - u->t) / SMALLEST;
    u->is_due = 0;
    if (u->is_over) return ends_run(u, u->over_t, t1);
    for (;;) {
        double h = end - t, last = end;
        int has_slopes = 0, status, is_early = 0, has_ended = 0, call = CALL_DoStep;
        if (m->order && u->has_moving)
            for (int i = 0; i < u->ninputs; i++)
                if (u->courses[3 * i + 1] != 0.0 || u->courses[3 * i + 2] != 0.0) has_slopes = 1;
        if (has_slopes && u->way == MASTER_MEAN) along(u, h, 1);
        else
            for (int i = 0; i < u->ninputs; i++) u->inputs[i] = u->courses[3 * i];
        if (put(m, u, u->sets, u->nsets)) return 1;
        if (has_slopes && u->way == MASTER_DERIVATIVES) {
            if (derivatives(m, u)) return 1;
            if (u->way == MASTER_MEAN) {
                along(u, h, 1);
                if (put(m, u, u->sets, u->nsets)) return 1;
            }
        }
        u->begin = t;
        stepped = u;
        inner_status = OK;
        if (u->kind == MASTER_FMI2) {
            status = CALL(Step2, u, CALL_DoStep)(u->component, t, h, !u->has_saved);
            if (status == PENDING && u->calls[CALL_GetStatus] && (status = settled(m, u, &call)) == PENDING)
                return fail(m, MASTER_PENDING, number_of(m, u), CALL_DoStep, status, 0.0);
        } else {
            bool event = false, over = false, early = false;
            status = CALL(Step3, u, CALL_DoStep)(u->component, t, h, !u->has_saved, &event, &over, &early, &last);
            has_ended = over;
            is_early = early;
            if (event && u->has_instants) u->is_due = 1;
            const bool is_named = has_ended && last >= t && last <= end; /* where it ended the run */
            if (!is_early && status != DISCARD && !is_named) last = end;
        }
        stepped = NULL;
        if (inner_status && judged(m, u, inner_call, inner_status)) return 1;
        if (status && status != DISCARD && judged(m, u, call, status)) return 1;
        if (status == DISCARD) {
            if (u->kind == MASTER_FMI2) {
                int over = 0;
                last = NAN;
                if (!u->calls[CALL_GetRealStatus] || CALL(RealStatus, u, CALL_GetRealStatus)(u->component, 2, &last) > 1) last = NAN;
                if (u->calls[CALL_GetBooleanStatus] && CALL(BooleanStatus, u, CALL_GetBooleanStatus)(u->component, 3, &over) > 1) over = 0;
                has_ended = over;
            }
            if (!has_ended && (!(last > t) || !(last <= end))) { /* it stands where it stood: a shorter one may do */
                if (!(h > least)) return fail(m, MASTER_STUCK, number_of(m, u), CALL_DoStep, status, t);
                end = t + h / 2;
                continue;
            }
            is_early = 0;
        }
        if (has_ended) return ends_run(u, last > t ? fmin(last, end) : t, t1);
        if (is_early && !u->has_instants) return fail(m, MASTER_TOO_EARLY, number_of(m, u), CALL_DoStep, status, last);
        if (!is_early && last < t1) { /* a part of it is done */
            double since = last - t;
            for (int i = 0; i < u->ninputs; i++) {
                double *c = u->courses + 3 * i;
                c[0] += since * (c[1] + since * c[2] / 2);
                c[1] += since * c[2];
            }
            t = last;
            end = t1;
            continue;
        }
        u->reached = is_early && last < t1 ? last : t1;
        return 0;
    }
}

/* What happens in a unit at its time, with its inputs as they are then. at_break: those of the diagram jump or bend. */
static int instant_unit(Master *m, MasterUnit *u, int is_first, int at_break)
{
    take_inputs(m, u, m->t);
    if (u->kind == MASTER_NATIVE) {
        BlocksSim *s = u->component;
        if (CALL(IsDue, u, CALL_is_due)(s)) u->is_bent = 1;
        int has_crossed = s->crossing;
        int64_t told = s->fired_events.used;
        size_t ns = (size_t)s->model->ns;
        if (has_crossed) memcpy(u->counted + s->setup->ncauses, s->memory.s, ns * sizeof(double));
        native_inputs(u, 0);
        s->outstanding = s->changed = 1;
        int is_driven = at_break && u->reads_inputs;
        s->recourses = !is_driven && (!u->ninputs || !memcmp(u->inputs, u->given + u->noutputs, (size_t)u->ninputs * sizeof(double)));
        if (u->remembers_inputs) s->recourses *= 2;
        int is_lost = CALL(OfSim, u, CALL_settle)(s);
        s->recourses = 0;
        if (is_lost) return fail(m, MASTER_SIMULATION, number_of(m, u), 0, 0, 0.0);
        int is_ahead = s->t - u->uncounted > NEAR * blocks_ulp(s->t); /* else it comes back again and again */
        if (has_crossed && is_ahead && s->fired_events.used == told && !memcmp(u->counted + s->setup->ncauses, s->memory.s, ns * sizeof(double))) {
            /* By the inputs as they are it is not crossed yet: soon it will be, and that is no chattering. */
            memcpy(s->fired, u->counted, ns * sizeof(double));
            s->crossed_first = u->crossed_first;
            s->crossed_count = u->crossed_count;
            s->located_t = NAN;
            u->uncounted = s->t;
        }
        return 0;
    }
    if (!u->has_instants || u->is_over) return 0;
    int is_asked = u->is_due || !is_first || u->begins; /* by the FMU, or by a jump that it hears of */
    for (int i = 0; i < u->ninputs; i++)
        if (!u->moves[i] && u->inputs[i] != u->known[i]) is_asked = 1, u->known[i] = u->inputs[i];
    if (!is_asked) return 0;
    u->is_due = 0;
    u->is_bent = 1;
    if (!u->begins && judged(m, u, CALL_EnterEventMode, CALL(Plain, u, CALL_EnterEventMode)(u->component))) return 1;
    u->begins = 0;
    if (set_groups(m, u, u->sets, u->nsets, 0)) return 1;
    for (int pass = 0;; pass++) {
        bool needs = false, over = false, nominals = false, states = false, has_next = false;
        double next = 0.0;
        int status = CALL(Update, u, CALL_UpdateDiscreteStates)(u->component, &needs, &over, &nominals, &states, &has_next, &next);
        if (judged(m, u, CALL_UpdateDiscreteStates, status)) return 1;
        if (over) return ends_run(u, m->t, m->t);
        if (!needs) break;
        if (pass == MOST_PASSES) return fail(m, MASTER_ENDLESS_UPDATES, number_of(m, u), CALL_UpdateDiscreteStates, 0, m->t);
    }
    return judged(m, u, CALL_EnterStepMode, CALL(Plain, u, CALL_EnterStepMode)(u->component));
}

/* --- outputs at a communication point ------------------------------------------------------------------------------ */

static int residual(Master *m, const MasterLoop *loop, double t, const double *guess, double *out)
{
    for (int i = 0; i < loop->n; i++) m->y[loop->elements[i]] = guess[i];
    for (int i = 0; i < loop->nstages; i++) {
        const MasterStage *stage = &m->stages[loop->first_stage + i];
        MasterUnit *u = &m->units[stage->unit];
        take_inputs(m, u, t);
        if (put(m, u, stage->sets, stage->nsets)) return 1;
    }
    for (int i = 0; i < loop->nstages; i++)
        if (get(m, &m->units[m->stages[loop->first_stage + i].unit], m->kept_y)) return 1;
    for (int i = 0; i < loop->n; i++) out[i] = m->kept_y[loop->elements[i]] - guess[i];
    return 0;
}

/* x of a x = b, by elimination with pivots; 1 where there is none. Both are written over. */
static int linear(int n, double *a, double *b)
{
    for (int k = 0; k < n; k++) {
        int p = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(a[i * n + k]) > fabs(a[p * n + k])) p = i;
        if (!(fabs(a[p * n + k]) > 0.0)) return 1;
        if (p != k) {
            for (int j = 0; j < n; j++) { double v = a[k * n + j]; a[k * n + j] = a[p * n + j]; a[p * n + j] = v; }
            double v = b[k]; b[k] = b[p]; b[p] = v;
        }
        for (int i = k + 1; i < n; i++) {
            double q = a[i * n + k] / a[k * n + k];
            if (q == 0.0) continue;
            for (int j = k; j < n; j++) a[i * n + j] -= q * a[k * n + j];
            b[i] -= q * b[k];
        }
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int j = i + 1; j < n; j++) b[i] -= a[i * n + j] * b[j];
        b[i] /= a[i * n + i];
        if (!isfinite(b[i])) return 1;
    }
    return 0;
}

static int solve(Master *m, const MasterLoop *loop, double t)
{
    int n = loop->n, number = (int)(loop - m->loops);
    double *a = loop->work, *r = a + n * n, *guess = r + n, *moved_ = guess + n, *other = moved_ + n, *step = other + n;
    for (int i = 0; i < n; i++) guess[i] = m->y[loop->elements[i]];
    double best = INFINITY;
    for (int pass = 0;; pass++) {
        if (pass == MOST_GUESSES) return fail(m, MASTER_UNSOLVED, number, 0, 0, t);
        /* Values near 0 may be differences of large ones: what counts is the largest of the loop. */
        double size = 1e-300, off = 0.0;
        if (residual(m, loop, t, guess, r)) return 1;
        for (int i = 0; i < n; i++) {
            if (!isfinite(r[i])) return fail(m, MASTER_UNSOLVED, number, 0, 0, t);
            size = fmax(size, fabs(guess[i]) + fabs(r[i]));
            off = fmax(off, fabs(r[i]));
        }
        off /= size;
        if (off <= 1e-15 || (off <= 1e-10 && off > best / 2)) break; /* rounding decides from here on */
        best = fmin(best, off);
        for (int j = 0; j < n; j++) {
            double delta = 1e-7 * fmax(fabs(guess[j]), 1e-3);
            memcpy(moved_, guess, (size_t)n * sizeof(double));
            moved_[j] += delta;
            if (residual(m, loop, t, moved_, other)) return 1;
            for (int i = 0; i < n; i++) a[i * n + j] = (other[i] - r[i]) / delta;
        }
        for (int i = 0; i < n; i++) step[i] = -r[i];
        if (linear(n, a, step)) return fail(m, MASTER_UNSOLVED, number, 0, 0, t);
        for (int i = 0; i < n; i++) guess[i] += step[i];
    }
    for (int i = 0; i < n; i++) m->y[loop->elements[i]] = guess[i];
    return 0;
}

static int stage_at(Master *m, const MasterStage *stage, double t)
{
    MasterUnit *u = &m->units[stage->unit];
    if (!stage->is_plain) {
        take_inputs(m, u, t);
        if (put(m, u, stage->sets, stage->nsets)) return 1;
    }
    /* Others of its outputs may not be known yet: they come in a later stage. */
    if (stage->nelements == u->noutputs) return get(m, u, m->y);
    if (get(m, u, m->kept_y)) return 1;
    for (int i = 0; i < stage->nelements; i++) m->y[stage->elements[i]] = m->kept_y[stage->elements[i]];
    return 0;
}

/* All outputs of the units that stand at t. */
static int evaluate(Master *m, double t)
{
    for (int i = 0; i < m->nstages;) {
        const MasterStage *stage = &m->stages[i];
        if (stage->loop >= 0) {
            const MasterLoop *loop = &m->loops[stage->loop];
            int here = 0;
            for (int k = 0; k < loop->nstages; k++) here += m->units[stage[k].unit].t == t;
            if (here == loop->nstages) {
                if (solve(m, loop, t)) return 1;
            } else { /* the others lag behind: what they give is known */
                for (int k = 0; k < loop->nstages; k++)
                    if (m->units[stage[k].unit].t == t && stage_at(m, &stage[k], t)) return 1;
            }
            i = loop->first_stage + loop->nstages;
            continue;
        }
        i++;
        if (m->units[stage->unit].t == t && stage_at(m, stage, t)) return 1;
    }
    if (m->has_unsure)
        for (int k = 0; k < m->nunits; k++) {
            MasterUnit *u = &m->units[k];
            if (!u->is_unsure || u->t != t) continue; /* its outputs follow inputs that were not known yet */
            take_inputs(m, u, t);
            if (put(m, u, u->sets, u->nsets) || get(m, u, m->y)) return 1;
        }
    return 0;
}

/* --- recording ------------------------------------------------------------------------------------------------------ */

static double *more(Master *m, BlocksList *list, int64_t n)
{
    if (list->used + n > list->capacity) {
        int64_t capacity = list->capacity ? 2 * list->capacity : 4096;
        while (capacity < list->used + n) capacity *= 2;
        if ((double)capacity * sizeof(double) > m->most_bytes) capacity = (int64_t)(m->most_bytes / sizeof(double));
        double *data = capacity < list->used + n ? NULL : realloc(list->data, (size_t)capacity * sizeof(double));
        if (!data) {
            fail(m, MASTER_MEMORY, 0, 0, 0, 0.0);
            return NULL;
        }
        list->data = data;
        list->capacity = capacity;
    }
    double *place = list->data + list->used;
    list->used += n;
    return place;
}

void master_free(double *data) { free(data); }

/* Each link as it is now. */
int master_values(Master *m, const MasterLink *links, int n, double *out)
{
    double check = 0.0;
    int is_even = m->is_uniform && !m->has_instants && !m->has_rigid; /* all stand at one time */
    for (int i = 0; i < n; i++) {
        out[i] = is_even && links[i].row == MASTER_ELEMENT ? m->y[links[i].place] : value_at(m, &links[i], m->t);
        check += out[i] * 0.0;
    }
    if (check == 0.0) return 0;
    for (int i = 0; i < n; i++)
        if (!isfinite(out[i])) return fail(m, MASTER_NOT_FINITE, i, links == m->measured, 0, out[i]);
    return 0;
}

static int recorded(Master *m, double *out) { return master_values(m, m->columns, m->ncolumns, out); }

static int add_row(Master *m, const double *values)
{
    double *row = more(m, &m->rows, 1 + m->ncolumns);
    if (!row) return 1;
    row[0] = m->t;
    memcpy(row + 1, values, (size_t)m->ncolumns * sizeof(double));
    return 0;
}

static int measure(Master *m, double kind)
{
    if (!m->nmeasured) return 0;
    double *row = more(m, &m->points, 2 + m->nmeasured);
    if (!row) return 1;
    row[0] = m->t;
    row[1] = kind;
    return master_values(m, m->measured, m->nmeasured, row + 2);
}

static int on_grid(const Master *m)
{
    if (!m->every.is_given) return 1;
    return m->t == blocks_grid(&m->every, m->row);
}

/* left: the values before what happened now; null: nothing did. */
static int record(Master *m, const double *left)
{
    if (m->is_silent) return 0;
    double last = m->rows.used ? m->rows.data[m->rows.used - 1 - m->ncolumns] : NAN;
    int is_row = on_grid(m);
    const double end = master_has_ended(m) ? m->t : m->end;
    while (m->every.is_given && blocks_grid(&m->every, m->row) <= m->t) m->row++;
    if (!m->has_jumps) {
        double *values = m->left_row + m->ncolumns;
        int is_first = m->t == m->start && !m->rows.used;
        if (m->t != last && !is_row && m->t != end && !is_first) return 0;
        if (recorded(m, values)) return 1;
        if (m->t != last) return add_row(m, values);
        memcpy(m->rows.data + m->rows.used - m->ncolumns, values, (size_t)m->ncolumns * sizeof(double));
        return 0;
    }
    if (!left) {
        if (!(is_row || m->t == end) || m->t == last) return 0;
        double *row = more(m, &m->rows, 1 + m->ncolumns);
        if (!row) return 1;
        row[0] = m->t;
        return recorded(m, row + 1);
    }
    double *right = m->left_row + m->ncolumns;
    if (recorded(m, right)) return 1;
    if (memcmp(left, right, (size_t)m->ncolumns * sizeof(double))) {
        if (m->t != last && add_row(m, left)) return 1;
        return add_row(m, right);
    }
    return (is_row || m->t == end) && m->t != last ? add_row(m, right) : 0;
}

/* --- a communication point ------------------------------------------------------------------------------------------- */

static void courses(Master *m, MasterUnit *u, const MasterPast *past)
{
    double t = u->t;
    for (int i = 0; i < u->ninputs; i++) {
        double *c = u->courses + 3 * i;
        int place = u->links[i].place;
        switch (u->links[i].row) {
        case MASTER_ELEMENT:
            if (m->needs_past && u->moves[i] && !m->elements[place].is_held) course_of(&past[place], m->order, t, c);
            else c[0] = m->y[place], c[1] = c[2] = 0.0;
            break;
        case MASTER_INPUT:
            c[0] = input_at(m, place, t);
            c[1] = c[2] = 0.0;
            if (u->moves[i] && m->base[place] != m->aim[place])
                c[1] = (m->aim[place] - m->base[place]) / (m->finish[place] - m->begin[place]);
            break;
        default: c[0] = u->links[i].constant, c[1] = c[2] = 0.0;
        }
    }
}

/* Whether a unit can step to t. */
static int can_stop(const MasterUnit *u, double t) { return !u->is_rigid || u->next_t == t; }

/* The units that cannot stop at m->t keep their courses as they are before what happens here: waits is 2 until `keep_waiting`. */
static void stay_behind(Master *m)
{
    for (int k = 0; k < m->nunits && m->has_rigid; k++) {
        MasterUnit *u = &m->units[k];
        if (!u->is_rigid || u->waits || !(u->t < m->t)) continue;
        courses(m, u, m->past);
        u->waits = 2;
    }
}

/* Whether a unit reads an element that does this. */
static int reads(const Master *m, const MasterUnit *u, int (*does)(const Master *, int))
{
    for (int i = 0; i < u->ninputs; i++)
        if (u->links[i].row == MASTER_ELEMENT && does(m, u->links[i].place)) return 1;
    return 0;
}

static int renewed_now(const Master *m, int g) { return m->renewed[g]; }

/* The length of a usual step of a unit. */
static double length_of(const Master *m, const MasterUnit *u) { return m->is_controlled ? m->h : u->step; }

/* Units that lag behind keep their courses where an input takes a new one; else they go on by later points. */
static void keep_waiting(Master *m, int at_break)
{
    for (int k = 0; k < m->nunits && m->has_rigid; k++) {
        MasterUnit *u = &m->units[k];
        if (u->waits != 2) continue;
        int is_driven = at_break && u->reads_inputs;
        u->waits = is_driven || reads(m, u, renewed_now);
        if (isnan(u->late_t) && (is_driven || reads(m, u, jumped_now))) u->late_t = m->t;
    }
}

/* Steps one unit that lags behind up to t1. */
static int catch_up(Master *m, MasterUnit *u, double t1)
{
    courses(m, u, m->past);
    if (step_unit(m, u, t1)) return 1;
    u->t = t1;
    return 0;
}

static int instants(Master *m, const double *left_y, int at_break)
{
    double t = m->t;
    int n = m->nunits, any = 0;
    double edge;
    while ((edge = next_break(m, m->broken)) <= t || blocks_within_ulps(edge, t, 0.0)) {
        m->broken = edge;
        take_segment(m, fmax(t, edge));
        if (evaluate(m, t)) return 1;
    }
    for (int k = 0; k < n; k++) {
        MasterUnit *u = &m->units[k];
        u->is_bent = 0;
        m->acting[k] = u->t == t && u->acts;
        if (m->acting[k]) arrive(m, u);
        any |= m->acting[k];
    }
    for (int pass = 0; any; pass++) {
        if (pass == MOST_PASSES) return fail(m, MASTER_ENDLESS, -1, 0, 0, t);
        memcpy(m->guess, m->y, (size_t)m->nelements * sizeof(double));
        /* One after the other: what ticks at t sees what others that tick at t have come to, in the order of wires. */
        int several = 0;
        for (int k = 0; k < n; k++) several += m->acting[k] && m->units[k].has_instants;
        for (int o = 0; o < n; o++) {
            MasterUnit *u = &m->units[m->at_instants[o]];
            if (!m->acting[m->at_instants[o]]) continue;
            if (instant_unit(m, u, pass == 0, at_break)) return 1;
            if (several > 1 && u->is_bent && evaluate(m, t)) return 1;
        }
        m->instants++;
        if (evaluate(m, t)) return 1;
        memset(m->acting, 0, (size_t)n);
        any = 0;
        int late = 0;
        for (int g = 0; g < m->nelements; g++) {
            if (m->guess[g] == m->y[g]) continue;
            int jumped = has_jumped(m, g, m->guess[g]);
            for (int i = m->elements[g].first_reader; i < m->elements[g + 1].first_reader; i++) {
                int k = m->readers[i];
                /* An FMU would take a change by rounding for an event. Blocks go on from the values that they have here. */
                if (!jumped && m->units[k].kind != MASTER_NATIVE) continue;
                if (m->units[k].t < t) late = m->acting[k] = !m->units[k].is_rigid || late;
                else if (m->units[k].t == t && m->units[k].has_instants) any = m->acting[k] = 1;
            }
        }
        if (late) {
            /* What hears of a jump and lags behind comes here with its old inputs. */
            memcpy(m->kept_y, m->y, (size_t)m->nelements * sizeof(double));
            memcpy(m->y, left_y, (size_t)m->nelements * sizeof(double));
            for (int k = 0; k < n; k++) {
                if (!m->acting[k] || !(m->units[k].t < t)) continue;
                if (catch_up(m, &m->units[k], t)) return 1;
                arrive(m, &m->units[k]);
            }
            memcpy(m->y, m->kept_y, (size_t)m->nelements * sizeof(double));
            if (evaluate(m, t)) return 1;
            any = 0;
            for (int k = 0; k < n; k++) {
                m->acting[k] = m->acting[k] && m->units[k].has_instants;
                any |= m->acting[k];
            }
        }
    }
    return 0;
}

/* Whether what is exchanged grows without bound, as growth.py says it. all: all units stand at m->t. Where no past is kept
   m->left_y is what was guessed. */
static void watch(Master *m, int all)
{
    for (int i = 0; i < m->nwatched; i++) {
        MasterGrowth *w = &m->watched[i];
        int g = w->element;
        const MasterPast *p = &m->past[g];
        if (!all && (m->units[m->elements[g].unit].t != m->t || (m->needs_past && (!p->n || !(p->t[0] < m->t))))) continue;
        w->points++;
        double y = m->y[g], now = fabs(y), size = w->size, course[3] = {m->left_y[g]};
        if (!(now > size)) continue;
        w->size = now;
        if (m->needs_past) course_of(p, m->order, m->t, course);
        if (size == 0.0 || !(fabs(course[0] - y) > size / 2)) continue;
        if (!w->misses || w->points - w->last > NEAR_MISSES) w->begin = size, w->most = 1.0, w->misses = 0;
        w->misses++;
        w->last = w->points;
        w->most = fmax(w->most, now / size);
        if (w->misses >= MISSES && now / w->begin / w->most >= GROWTH && m->grown[w->circle] < 0)
            m->grown[w->circle] = g, m->grown_t[w->circle] = m->t;
    }
}

/* At a communication point: outputs, instants, rows. *calm: whether nothing jumped. */
static int arrived(Master *m, int *calm)
{
    double t = m->t;
    *calm = 1;
    if (m->nwatched && !m->needs_past) memcpy(m->left_y, m->y, (size_t)m->nelements * sizeof(double));
    if (evaluate(m, t)) return 1;
    if (m->nwatched) watch(m, 0);
    if (m->is_controlled) memcpy(m->ends, m->y, (size_t)m->nelements * sizeof(double));
    if (m->nmeasured && measure(m, 0.0)) return 1;
    double edge = m->ntracks ? next_break(m, m->broken) : INFINITY;
    int at_break = edge <= t || blocks_within_ulps(edge, t, 0.0);
    int has = at_break;
    if (m->has_instants)
        for (int k = 0; k < m->nunits && !has; k++) has = m->units[k].t == t && m->units[k].acts;
    if (!has) {
        if (m->needs_past)
            for (int g = 0; g < m->nelements; g++)
                if (m->units[m->elements[g].unit].t == t && m->past[g].t[0] < t) {
                    double length = length_of(m, &m->units[m->elements[g].unit]);
                    add_point(&m->past[g], t, m->y[g], ROUGH * length);
                }
        m->fresh++;
        return record(m, NULL);
    }
    if (recorded(m, m->left_row)) return 1;
    memcpy(m->left_y, m->y, (size_t)m->nelements * sizeof(double));
    stay_behind(m);
    if (instants(m, m->left_y, at_break)) return 1;
    /* What jumps, and what comes out of units where something happened or that hear of a jump, goes on otherwise. */
    int any_moved = 0, is_new = 0, is_again = 0, is_late = 0;
    for (int g = 0; g < m->nelements; g++) any_moved |= moved_now(m, g), m->renewed[g] = (uint8_t)jumped_now(m, g);
    for (int k = 0; k < m->nunits; k++)
        if (m->units[k].t == t) renew(m, &m->units[k], at_break);
    keep_waiting(m, at_break);
    for (int g = 0; g < m->nelements; g++) {
        MasterPast *p = &m->past[g];
        const MasterUnit *u = &m->units[m->elements[g].unit];
        if (u->t != t) continue;
        if (m->renewed[g]) {
            begin_anew(p, t, m->y[g]);
            if (m->elements[g].first_reader == m->elements[g + 1].first_reader) continue;
            is_again = 1;
            if (!m->elements[g].is_held) is_new = 1;
        } else if (add_point(p, t, m->y[g], (u->is_bent ? CLOSE : ROUGH) * length_of(m, u)) && u->is_bent) {
            if (m->elements[g].first_reader < m->elements[g + 1].first_reader && !m->elements[g].is_held) is_late = 1;
        }
    }
    m->fresh = is_new ? 0 : m->fresh + !is_late;
    if ((any_moved || at_break) && measure(m, 1.0)) return 1;
    *calm = !is_again;
    return record(m, m->left_row);
}

/* --- a step of the master --------------------------------------------------------------------------------------------- */

/* The value of an element at the end of the step under way, over one that stands there already. */
static void foresee(MasterPast *p, double t1, double y)
{
    if (p->n && p->t[0] == t1) p->y[0] = y;
    else remember(p, t1, y);
}

/* Each due unit once, on courses through `m->old`. *early: the unit that came to an instant before the end; -1: none. */
static int sweep(Master *m, double t1, int is_sequential, int is_again, int *early)
{
    *early = -1;
    if (!is_sequential)
        for (int k = 0; k < m->nunits; k++)
            if (m->due[k] && !m->units[k].waits) courses(m, &m->units[k], m->past);
    for (int o = 0; o < m->nunits; o++) {
        int k = m->ordered[o];
        MasterUnit *u = &m->units[k];
        if (!m->due[k] || (is_again && !u->can_save)) continue;
        if (is_sequential && !u->waits) courses(m, u, m->old);
        if (step_unit(m, u, t1)) return 1;
        if (u->reached < t1) {
            *early = k;
            return 0;
        }
        if (!is_sequential) continue;
        if (u->has_feed) {
            along(u, t1 - u->t, 0);
            if (put(m, u, u->fed, u->nfed)) return 1;
        }
        if (get(m, u, m->kept_y)) return 1;
        for (int i = 0; i < u->noutputs; i++) foresee(&m->old[u->outputs[i]], t1, m->kept_y[u->outputs[i]]);
    }
    return 0;
}

/* What is exchanged at t1, by the states that the due units have come to. */
static int ends(Master *m, double t1, double *z)
{
    size_t bytes = (size_t)m->nelements * sizeof(double);
    double *y = m->left_y;
    memcpy(y, m->y, bytes);
    for (int k = 0; k < m->nunits; k++)
        if (m->due[k]) m->units[k].begin = m->units[k].t, m->units[k].t = t1;
    int wrong = evaluate(m, t1);
    for (int i = 0; i < m->nexchanged; i++) z[i] = m->y[m->exchanged[i]];
    for (int k = 0; k < m->nunits; k++)
        if (m->due[k]) m->units[k].t = m->units[k].begin;
    memcpy(m->y, y, bytes);
    return wrong;
}

static int iterate(Master *m, double t1, double from, int *early)
{
    int n = m->nexchanged, learns = m->inverse != NULL;
    if (ends(m, t1, m->z)) return 1;
    if (learns && (!m->has_inverse || m->inverse_h != t1 - from)) {
        memset(m->inverse, 0, (size_t)n * (size_t)n * sizeof(double));
        for (int i = 0; i < n; i++) m->inverse[i * n + i] = 1.0;
        m->has_inverse = 1;
        m->inverse_h = t1 - from;
    }
    for (int pass = 0; pass < m->iterations; pass++) {
        m->iterated++;
        for (int k = 0; k < m->nunits; k++)
            if (m->due[k] && m->units[k].can_save && restore(m, &m->units[k], MASTER_OF_STEP)) return 1;
        memcpy(m->old, m->past, (size_t)m->nelements * sizeof(MasterPast));
        for (int i = 0; i < n; i++)
            if (m->due[m->elements[m->exchanged[i]].unit]) foresee(&m->old[m->exchanged[i]], t1, m->z[i]);
        if (sweep(m, t1, 1, 1, early) || *early >= 0) return m->failure != 0;
        double *g = m->work, largest = 0.0;
        if (ends(m, t1, g)) return 1;
        int finite = 1;
        for (int i = 0; i < n; i++) {
            double f = g[i] - m->z[i], size = fmax(fabs(m->z[i]), fmax(fabs(m->y[m->exchanged[i]]), 1e-3));
            if (!isfinite(f)) finite = 0;
            if (fabs(f) / size > largest) largest = fabs(f) / size;
            g[i] = f;
        }
        if (!finite) break;
        if (largest <= CONVERGED || (pass >= 6 && largest <= m->noise)) return 0;
        if (pass && learns) {
            /* Broyden's update: what the inverse makes of the change of the residual is the change of the guess. */
            double scale = 0.0, *made = m->df;
            for (int i = 0; i < n; i++) m->dz[i] = m->z[i] - m->dz[i];
            for (int i = 0; i < n; i++) {
                made[i] = 0.0;
                for (int j = 0; j < n; j++) made[i] += m->inverse[i * n + j] * (g[j] - m->f[j]);
            }
            for (int i = 0; i < n; i++) scale += m->dz[i] * made[i];
            if (fabs(scale) > 1e-30 && isfinite(scale)) {
                double *row = m->work + n;
                for (int j = 0; j < n; j++) {
                    row[j] = 0.0;
                    for (int i = 0; i < n; i++) row[j] += m->dz[i] * m->inverse[i * n + j];
                }
                for (int i = 0; i < n; i++) {
                    double q = (-m->dz[i] - made[i]) / scale;
                    for (int j = 0; j < n; j++) m->inverse[i * n + j] += q * row[j];
                }
            }
        }
        memcpy(m->dz, m->z, (size_t)n * sizeof(double));
        memcpy(m->f, g, (size_t)n * sizeof(double));
        for (int i = 0; i < n; i++) {
            double step = g[i];
            if (learns) {
                step = 0.0;
                for (int j = 0; j < n; j++) step += m->inverse[i * n + j] * g[j];
            }
            m->work[2 * n + i] = step;
        }
        for (int i = 0; i < n; i++) m->z[i] += m->work[2 * n + i];
    }
    m->has_inverse = 0;
    return fail(m, MASTER_NO_CONVERGENCE, -1, 0, 0, t1);
}

static int to(Master *m, double t1, int *calm);

/* A unit came to an instant before the end of the step: it, what hears of it, and what may stop sooner go there only. An
   FMU that stands there stays, where another try would be the same: some lose the instant when they go back. */
static int at_early(Master *m, int first, int iterates, int *calm)
{
    MasterUnit *one = &m->units[first];
    double te = one->reached;
    int any = 0, was_over = one->is_over, stays = one->kind != MASTER_NATIVE && !iterates && !was_over;
    for (int k = 0; k < m->nunits; k++) stays &= k == first || !m->units[k].has_instants;
    for (int i = 0; i < one->ninputs && m->is_sequential; i++) stays &= one->links[i].row != MASTER_ELEMENT;
    *calm = 1;
    if (was_over && !(te > m->t)) return 0; /* nothing more is known of it than at the last point */
    m->crowd = te - m->t <= NEAR * blocks_ulp(te) ? m->crowd + 1 : 0;
    if (m->crowd > MOST_PASSES) return fail(m, MASTER_ENDLESS_STOPS, first, 0, 0, te);
    for (int k = 0; k < m->nunits; k++) {
        MasterUnit *u = &m->units[k];
        if (!m->due[k]) continue;
        if (k == first && stays) {
            u->t = te;
            u->waits = 0;
        } else if (u->can_save && m->keeps) {
            if (restore(m, u, MASTER_OF_STEP)) return 1;
        } else if (u->reached > u->t) {
            u->t = u->reached; /* it cannot go back, and waits where it is */
        }
    }
    if (was_over) memcpy(m->changed, m->due, (size_t)m->nunits); /* all go there */
    else memset(m->changed, 0, (size_t)m->nunits);
    m->changed[first] = 1;
    for (int i = 0; i < one->noutputs; i++) {
        int g = one->outputs[i];
        if (!m->elements[g].jumps) continue;
        for (int j = m->elements[g].first_reader; j < m->elements[g + 1].first_reader; j++) m->changed[m->readers[j]] = 1;
    }
    for (int k = 0; k < m->nunits; k++) {
        m->due[k] = (m->changed[k] || m->units[k].has_instants) && m->units[k].t < te && can_stop(&m->units[k], te);
        any |= m->due[k];
    }
    if (any) {
        m->depth++;
        int wrong = to(m, te, calm);
        m->depth--;
        return wrong;
    }
    m->t = te;
    return arrived(m, calm);
}

/* Steps what is due (m->due) to t1, or to the first instant inside. */
static int to(Master *m, double t1, int *calm)
{
    int early = -1;
    int iterates = m->fresh < m->iterated_steps && m->depth < DEEPEST; /* deeper, what is crossed moves with each iteration */
    if (!m->depth && !m->is_doubled) /* what was saved for the last step is not needed any more */
        for (int k = 0; k < m->nunits; k++) m->units[k].has_saved = 0;
    m->keeps = 0;
    if (m->has_instants || iterates) {
        int any = iterates;
        for (int k = 0; k < m->nunits && !any; k++) any = m->due[k] && m->units[k].has_instants;
        if (any) {
            m->keeps = 1;
            for (int k = 0; k < m->nunits; k++) {
                m->units[k].reached = m->units[k].t;
                if (m->due[k] && m->units[k].can_save && save(m, &m->units[k], MASTER_OF_STEP)) return 1;
            }
        }
    }
    double from = m->t;
    if (m->is_sequential) memcpy(m->old, m->past, (size_t)m->nelements * sizeof(MasterPast));
    if (sweep(m, t1, m->is_sequential, 0, &early)) return 1;
    if (early < 0 && iterates) {
        int can = 0;
        for (int k = 0; k < m->nunits; k++) can |= m->due[k] && m->units[k].can_save;
        if (can && iterate(m, t1, from, &early)) return 1;
    }
    if (early >= 0) return at_early(m, early, iterates, calm);
    for (int k = 0; k < m->nunits; k++)
        if (m->due[k]) m->units[k].t = t1, m->units[k].waits = 0;
    m->t = t1;
    return arrived(m, calm);
}

/* --- control of the error ----------------------------------------------------------------------------------------------- */

static int controlled(Master *m, double limit)
{
    int n = m->nelements, k = m->order, calm = 1;
    if (m->every.is_given) {
        int64_t row = m->row;
        while (blocks_grid(&m->every, row) <= m->t) row++;
        limit = fmin(limit, blocks_grid(&m->every, row));
    }
    double left = limit - m->t;
    if (m->h <= 0) m->h = fmin(m->first_step, left);
    int order = m->fresh < k ? m->fresh : k; /* after a jump inputs are held at first */
    int whole = m->h >= left / 1.01;
    double from = m->t, t1 = whole ? limit : from + m->h, h = t1 - from, error = 0.0;
    if (h >= m->least_step) m->small = 0;
    else if (!whole) m->small++;
    if (h <= 16 * blocks_ulp(from) || m->small > MOST_SMALL)
        return fail(m, MASTER_TOO_SMALL, -1, (int)m->worst, 0, h);
    if (m->is_doubled) {
        struct { double t, broken; int64_t row, rows, points, fresh; } kept = {m->t, m->broken, m->row, m->rows.used, m->points.used, m->fresh};
        double *y = m->kept_y + n, *big = y + n;
        memcpy(y, m->y, (size_t)n * sizeof(double));
        memcpy(m->kept_past, m->past, (size_t)n * sizeof(MasterPast));
        for (int i = 0; i < m->nunits; i++) {
            m->units[i].kept_t = m->units[i].t;
            if (save(m, &m->units[i], MASTER_OF_CONTROL)) return 1;
        }
#define BACK()                                                                                                         \
    do {                                                                                                               \
        m->t = kept.t, m->broken = kept.broken, m->row = kept.row, m->fresh = kept.fresh;                              \
        m->rows.used = kept.rows, m->points.used = kept.points;                                                        \
        take_segment(m, m->t);                                                                                         \
        memcpy(m->y, y, (size_t)n * sizeof(double));                                                                   \
        memcpy(m->past, m->kept_past, (size_t)n * sizeof(MasterPast));                                                 \
        for (int i = 0; i < m->nunits; i++) {                                                                          \
            if (restore(m, &m->units[i], MASTER_OF_CONTROL)) return 1;                                                 \
            m->units[i].t = m->units[i].kept_t;                                                                        \
        }                                                                                                              \
    } while (0)
#define TO(time)                                                                                                       \
    do {                                                                                                               \
        for (int i = 0; i < m->nunits; i++) m->due[i] = m->units[i].t < (time);                                        \
        if (to(m, (time), &calm)) return 1;                                                                            \
    } while (0)
        TO(t1);
        if (m->t < t1) { /* something happens before: up to there, all units */
            whole = 0;
            t1 = m->t;
            if (is_over(m) && !(t1 > from)) return 0;
            BACK();
            TO(t1);
        }
        memcpy(big, m->ends, (size_t)n * sizeof(double));
        h = t1 - from;
        double middle = from + h / 2;
        if (from < middle && middle < t1) {
            BACK();
            TO(middle);
            if (m->t == middle && !master_has_ended(m)) {
                TO(t1);
                for (int g = 0; g < n; g++) {
                    if (m->elements[g].is_held) continue;
                    double e = fmax(fabs(big[g] - m->ends[g]) - ROUNDING * fabs(big[g]), 0.0) / (m->tolerance * (m->ratio + fabs(m->ends[g])));
                    if (!(e <= error)) error = e, m->worst = g;
                }
                error *= m->span / h / ((1 << (order + 1)) - 1);
            }
            if (!(error <= 1.0)) {
                BACK();
                m->rejected++;
                m->h = h * fmax(LEAST, isfinite(error) ? SAFETY * pow(error, -1.0 / (order + 1)) : LEAST);
                return 0; /* to be tried again, when the caller has looked at the clock */
            }
        }
    } else {
        double *foreseen = m->kept_y + n;
        for (int g = 0; g < n; g++) {
            double c[3];
            course_of(&m->past[g], k, t1, c);
            foreseen[g] = c[0];
        }
        TO(t1);
        for (int g = 0; g < n; g++) {
            double y = m->ends[g], e = fabs(foreseen[g] - y) / (m->tolerance * (m->ratio + fabs(y)));
            if (!m->elements[g].is_held && !(e <= error)) error = e, m->worst = g;
        }
        if (order < k || m->t < t1) error = fmax(error, 1.0);
    }
    double factor = fmin(MOST, fmax(LEAST, SAFETY * pow(fmax(error, 1e-10), -1.0 / (order + 1)))), proposed = h * factor;
    m->h = whole && factor >= 1.0 ? fmax(proposed, m->h) : proposed;
    if (!m->fresh) m->h = fmin(m->h, m->first_step); /* begun anew */
    return 0;
}

/* --- the loop ------------------------------------------------------------------------------------------------------------ */

/* The step of a unit that did not simply succeed: 0 where it went on. */
static int odd(Master *m, int k, int status, double t, double t1)
{
    MasterUnit *u = &m->units[k];
    int call = CALL_DoStep;
    if (status == PENDING && u->kind == MASTER_FMI2 && u->calls[CALL_GetStatus] &&
        (status = settled(m, u, &call)) == PENDING)
        return fail(m, MASTER_PENDING, k, CALL_DoStep, status, 0.0);
    if (status != DISCARD) return judged(m, u, call, status);
    /* Discarded: asked again, by the way that goes on from where it came to. */
    u->t = t;
    for (int i = 0; i < u->ninputs; i++) {
        u->courses[3 * i] = value_at(m, &u->links[i], t);
        u->courses[3 * i + 1] = u->courses[3 * i + 2] = 0.0;
    }
    return step_unit(m, u, t1);
}

static inline int quick_move(const MasterQuick *q, void *const *call, const uint32_t *references, size_t n, double *values)
{
    return q->kind == MASTER_FMI2 ? (*(Move2 *)call)(q->component, references, n, values)
                                  : (*(Move3 *)call)(q->component, references, n, values, n);
}

/* Whether rows are elements on a grid, and no instant adds to them. */
static int has_plain_rows(const Master *m)
{
    int is_plain = m->every.is_given && !m->has_jumps && m->is_uniform && !m->has_instants;
    for (int i = 0; i < m->ncolumns; i++) is_plain &= m->columns[i].row == MASTER_ELEMENT;
    return is_plain;
}

/* A row at the next time of the grid, which is here. */
static inline int plain_row(Master *m)
{
    double *row = m->rows.used + 1 + m->ncolumns <= m->rows.capacity ? m->rows.data + m->rows.used : NULL, check = 0.0;
    if (!row) return record(m, NULL);
    for (int i = 0; i < m->ncolumns; i++) check += (row[1 + i] = m->y[m->columns[i].place]) * 0.0;
    if (check != 0.0) return record(m, NULL); /* which says what it is */
    row[0] = m->t;
    m->rows.used += 1 + m->ncolumns;
    m->row++;
    return 0;
}

/* On with quick units, until it is time to look up; each step is what a master by hand would do. */
static int quick(Master *m, double stop, double deadline)
{
    MasterUnit *one = &m->units[0];
    const int is_plain = has_plain_rows(m), nunits = m->nunits, nstages = m->nstages, nwatched = m->nwatched;
    const int32_t *const ordered = m->ordered;
    const MasterStage *const stages = m->stages;
    const MasterQuick *const units = m->quick;
    const double end = m->end, soft = m->soft;
    int over = is_over(m);
    double due = is_plain ? blocks_grid(&m->every, m->row) : 0.0, now = 0.0;
    int64_t pace = 1, left = 1; /* steps from look to look at the clock, while it stands, and until the next one */
    do {
        double t = m->t;
        while (one->next_t <= t) one->next_t = blocks_grid(&one->grid, ++one->next);
        double t1 = one->next_t < stop ? one->next_t : stop, h = t1 - t;
        /* The times that come next are divided while units step. */
        const double following = blocks_grid(&one->grid, one->next + 1), due_next = is_plain ? blocks_grid(&m->every, m->row + 1) : 0.0;
        int ended = -1; /* the unit that ended the run inside the step: only its outputs are of the time that is come to */
        for (int o = 0; o < nunits; o++) {
            int k = ordered[o], status;
            const MasterQuick *q = &units[k];
            status = q->set ? quick_move(q, &q->set, q->set_references, q->nset, q->set_values) : OK;
            if (status && judged(m, &m->units[k], -1 - m->units[k].sets->number, status)) return 1;
            if (q->kind == MASTER_FMI2) {
                status = (*(Step2 *)&q->step)(q->component, t, h, 1);
            } else {
                bool event = false, ends = false, early = false;
                double last = t1;
                status = (*(Step3 *)&q->step)(q->component, t, h, true, &event, &ends, &early, &last);
                if (ends && status <= DISCARD) {
                    double at = early || status == DISCARD ? last : t1;
                    if (status == WARNING) judged(m, &m->units[k], CALL_DoStep, status);
                    status = ends_run(&m->units[k], at > t ? at : t, t1);
                    early = false, over = 1;
                }
                if (early && status < DISCARD && last < t1) return fail(m, MASTER_TOO_EARLY, k, CALL_DoStep, status, last);
            }
            if (status && odd(m, k, status, t, t1)) return 1;
            over |= status && m->units[k].is_over;
            if (over && m->units[k].is_over && m->units[k].reached < t1) {
                if (!(m->units[k].reached > t)) return 0;
                t1 = m->units[k].reached;
                ended = k;
                break;
            }
        }
        m->t = t1;
        if (t1 == one->next_t) one->next++, one->next_t = following;
        m->steps += nunits;
        if (nwatched) memcpy(m->left_y, m->y, (size_t)m->nelements * sizeof(double));
        for (int i = 0; i < nstages; i++) {
            int k = stages[i].unit;
            if (ended >= 0 && k != ended) continue;
            const MasterQuick *q = &units[k];
            int status = quick_move(q, &q->get, q->get_references, q->nget, q->get_values);
            if (status && judged(m, &m->units[k], -1 - m->units[k].gets->number, status)) return 1;
        }
        if (nwatched) watch(m, 1);
        if (m->nmeasured && measure(m, 0.0)) return 1;
        if (!is_plain || t1 > due || t1 == end || over) {
            if (record(m, NULL)) return 1;
            due = is_plain ? blocks_grid(&m->every, m->row) : 0.0;
        } else if (t1 == due) {
            if (plain_row(m)) return 1;
            due = due_next;
        }
        if (--left == 0) {
            double before = now;
            now = seconds();
            if (now >= deadline) return 0;
            left = pace = now == before && pace < 64 ? 2 * pace : now == before ? pace : 1;
        }
    } while (m->t < stop && m->t < soft && !over);
    return 0;
}

/* Whether all units can step from here to the stop together. */
static int has_even_points(const Master *m, double stop)
{
    for (int k = 0; k < m->nunits && m->has_rigid; k++) {
        const MasterUnit *u = &m->units[k];
        const BlocksGrid *g = &u->grid;
        double number = nearbyint((stop * (double)g->unit - (double)g->start) / (double)g->step);
        if (u->is_rigid && (u->t != m->t || (fabs(number) < 9e15 && blocks_grid(g, (int64_t)number) != stop))) return 0;
    }
    return 1;
}

int master_run(Master *m, double stop)
{
    double deadline = seconds() + m->slice;
    m->failure = MASTER_FINE;
    m->depth = 0;
    if (m->quick && has_even_points(m, stop)) {
        int wrong = m->t < stop && quick(m, stop, deadline);
        for (int k = 0; k < m->nunits; k++) m->units[k].t = m->t;
        return wrong ? MASTER_FAILED : m->t < stop ? MASTER_PAUSED : MASTER_DONE;
    }
    while (m->t < stop && !master_has_ended(m)) {
        double limit = stop, edge = m->ntracks ? next_break(m, m->broken) : INFINITY;
        int calm;
        if (edge < limit && !blocks_within_ulps(edge, limit, 0.0)) limit = edge;
        if (m->is_controlled) {
            if (controlled(m, limit)) return MASTER_FAILED;
        } else {
            double target = limit;
            int is_even = m->is_uniform && !m->has_instants && !m->has_rigid, n = is_even ? 1 : m->nunits; /* all stand at one time */
            for (int k = 0; k < n; k++) {
                MasterUnit *u = &m->units[k];
                while (u->next_t <= u->t) u->next_t = blocks_grid(&u->grid, ++u->next);
                if (u->next_t < target) target = u->next_t;
            }
            for (int k = 0; k < m->nunits; k++) {
                MasterUnit *u = &m->units[k];
                /* What may stop on the way goes along, so that nobody who hears of it is ahead. */
                m->due[k] = u->t < target && (is_even || u->next_t == target || (!u->is_rigid && (u->has_instants || target >= limit)));
            }
            if (to(m, target, &calm)) return MASTER_FAILED;
        }
        if (m->t >= m->soft || seconds() > deadline) return m->t < stop ? MASTER_PAUSED : MASTER_DONE;
    }
    return MASTER_DONE;
}

static void forget_foreseen(Master *m);

int master_changed(Master *m, int is_input)
{
    forget_foreseen(m);
    memcpy(m->left_y, m->y, (size_t)m->nelements * sizeof(double));
    m->failure = MASTER_FINE;
    if (recorded(m, m->left_row)) return MASTER_FAILED;
    stay_behind(m);
    take_segment(m, m->t);
    if (evaluate(m, m->t) || instants(m, m->left_y, is_input)) return MASTER_FAILED;
    memset(m->renewed, 1, (size_t)m->nelements);
    keep_waiting(m, is_input);
    for (int g = 0; g < m->nelements; g++)
        if (m->units[m->elements[g].unit].t == m->t) begin_anew(&m->past[g], m->t, m->y[g]);
    m->fresh = 0;
    return measure(m, 1.0) || record(m, m->left_row) ? MASTER_FAILED : MASTER_DONE;
}

/* --- the begin and the end ------------------------------------------------------------------------------------------------ */

/* Memory that goes with the master, as zeros; null, and from then on, where there is none. */
static void *room(Master *m, int64_t count, size_t size)
{
    void **piece = m->failure ? NULL : calloc(1, 16 + (size_t)count * size);
    if (!piece) {
        fail(m, MASTER_MEMORY, 0, 0, 0, 0.0);
        return NULL;
    }
    *piece = m->owned;
    m->owned = piece;
    return (char *)piece + 16;
}

static void *copy(Master *m, const void *from, int64_t count, size_t size)
{
    void *to = room(m, count, size);
    if (to && count) memcpy(to, from, (size_t)count * size);
    return to;
}

#define REALS(count) room(m, (count), sizeof(double))

static MasterGroup *copy_groups(Master *m, const MasterGroup *from, int n)
{
    MasterGroup *to = copy(m, from, n, sizeof *to);
    /* The orders of derivatives follow the values of reals. */
    for (int i = 0; to && i < n; i++) to[i].buffer = REALS(2 * to[i].nvalues + 2);
    return to;
}

static void open_unit(Master *m, MasterUnit *u)
{
    const int64_t n = u->ninputs;
    u->inputs = REALS(n), u->courses = REALS(3 * n), u->known = REALS(n);
    u->t = u->next_t = m->t;
    u->late_t = NAN;
    u->next = 0;
    if (u->kind != MASTER_NATIVE) {
        u->sets = copy_groups(m, u->sets, u->nsets);
        u->fed = copy_groups(m, u->fed, u->nfed);
        u->gets = copy_groups(m, u->gets, u->ngets);
        return;
    }
    const BlocksSim *s = u->component;
    const BlocksModel *model = s->model;
    const int64_t stood = model->nx + model->nd + model->ns;
    u->terms = REALS(4 * n), u->given = REALS(u->noutputs + n);
    u->polynomials.terms = u->terms;
    u->counted = REALS(s->setup->ncauses + model->ns);
    u->uncounted = -INFINITY;
    u->stood = REALS(stood), u->passed = room(m, model->nh, sizeof(int64_t)), u->moved = room(m, stood + n + model->nh, 1);
    u->saved_bytes = m->failure ? 0 : native_copy(u, NULL, 0);
    for (int whose = 0; whose < 2; whose++) u->saved[whose] = room(m, u->saved_bytes, 1);
}

/* The calls of a unit whose inputs and outputs are reals that lie side by side: 0 where they do not. */
static int make_quick(const Master *m, const MasterUnit *u, MasterQuick *q)
{
    *q = (MasterQuick){.component = u->component, .step = u->calls[CALL_DoStep], .kind = u->kind};
    if (u->kind == MASTER_NATIVE || u->nsets > 1 || u->ngets > 1) return 0;
    for (int is_get = 0; is_get < 2; is_get++) {
        if (!(is_get ? u->ngets : u->nsets)) continue;
        const MasterGroup *g = is_get ? u->gets : u->sets;
        const int32_t *places = g->places;
        int is_constant = !is_get, is_together = !(g->scales || g->offsets);
        if (g->type != BLOCKS_FLOAT64 || g->nvalues != g->nreferences) return 0;
        int64_t first = is_get ? places[0] : u->links[places[0]].place;
        for (int64_t i = 0; i < g->nvalues; i++) {
            const MasterLink *link = is_get ? NULL : &u->links[places[i]];
            is_constant &= link && link->row == MASTER_CONSTANT;
            is_together &= (!link || link->row == MASTER_ELEMENT) && first >= 0 && (link ? link->place : places[i]) == first + i;
        }
        if (!is_constant && !is_together) return 0;
        double *values = is_constant ? g->buffer : m->y + first;
        if (is_constant) { /* set once: they stay */
            for (int64_t i = 0; i < g->nvalues; i++)
                values[i] = (u->links[places[i]].constant - (g->offsets ? g->offsets[i] : 0.0)) / (g->scales ? g->scales[i] : 1.0);
        }
        if (is_get) q->get = g->move, q->get_references = g->references, q->nget = (size_t)g->nreferences, q->get_values = values;
        else q->set = g->move, q->set_references = g->references, q->nset = (size_t)g->nreferences, q->set_values = values;
    }
    return 1;
}

/* Inputs held, one grid, no instants, and nothing to be converted or put in order. */
void master_connect(Master *m)
{
    int is_plain = m->is_uniform && !(m->needs_past || m->has_instants);
    for (int i = 0; i < m->nstages; i++) is_plain &= m->stages[i].loop < 0 && m->stages[i].is_plain;
    MasterQuick *quick_units = is_plain ? room(m, m->nunits, sizeof *quick_units) : NULL;
    for (int k = 0; quick_units && k < m->nunits; k++)
        if (!make_quick(m, &m->units[k], &quick_units[k])) quick_units = NULL;
    m->quick = quick_units;
}

int master_open(Master *m)
{
    const int64_t n = m->nelements, e = m->nexchanged;
    int64_t nu = 0;
    m->failure = MASTER_FINE;
    m->owned = NULL;
    m->y = REALS(n), m->left_y = REALS(n), m->kept_y = REALS(3 * n), m->guess = REALS(n), m->ends = REALS(n);
    m->past = room(m, n, sizeof *m->past), m->old = room(m, n, sizeof *m->past), m->kept_past = room(m, n, sizeof *m->past);
    m->units = copy(m, m->units, m->nunits, sizeof *m->units);
    for (int k = 0; m->units && k < m->nunits; k++) open_unit(m, &m->units[k]);
    m->stages = copy(m, m->stages, m->nstages, sizeof *m->stages);
    for (int i = 0; m->stages && i < m->nstages; i++)
        if (m->stages[i].nsets) m->stages[i].sets = copy_groups(m, m->stages[i].sets, m->stages[i].nsets);
    m->loops = copy(m, m->loops, m->nloops, sizeof *m->loops);
    for (int i = 0; m->loops && i < m->nloops; i++) m->loops[i].work = REALS((int64_t)m->loops[i].n * (m->loops[i].n + 5));
    for (int j = 0; j < m->ntracks; j++) nu += m->tracks[j].size;
    m->base = REALS(nu), m->aim = REALS(nu), m->begin = REALS(nu), m->finish = REALS(nu);
    m->inverse = 0 < e && e <= MOST_LEARNT ? REALS(e * e) : NULL;
    m->z = REALS(e), m->f = REALS(e), m->dz = REALS(e), m->df = REALS(e), m->work = REALS(3 * e);
    m->left_row = REALS(2 * m->ncolumns + 2);
    m->due = room(m, m->nunits, 1), m->acting = room(m, m->nunits, 1), m->changed = room(m, m->nunits, 1);
    m->renewed = room(m, n, 1);
    m->start = m->broken = m->t;
    m->fresh = m->row = 0;
    if (!m->failure) {
        master_connect(m);
    }
    return m->failure != MASTER_FINE;
}

void master_close(Master *m)
{
    for (void **piece = m->owned, **next; piece; piece = next) {
        next = *piece;
        free(piece);
    }
    m->owned = NULL;
}

/* Whether an FMU can go back: some say that they can, and cannot. */
static int try_to_save(Master *m, MasterUnit *u)
{
    void *state = NULL;
    int status = CALL(State, u, CALL_GetFMUState)(u->component, &state), call = CALL_GetFMUState;
    if (status <= WARNING && state) {
        status = CALL(Restore, u, CALL_SetFMUState)(u->component, state), call = CALL_SetFMUState;
        if (status != FATAL && u->calls[CALL_FreeFMUState]) {
            int freed = CALL(State, u, CALL_FreeFMUState)(u->component, &state);
            if (freed > status) status = freed, call = CALL_FreeFMUState;
        }
    } else {
        status = status > WARNING ? status : ERROR_;
    }
    if (status > WARNING) u->can_save = 0;
    return status == FATAL ? judged(m, u, call, status) : 0;
}

static int finish_start(Master *m, MasterUnit *u)
{
    if (u->kind == MASTER_NATIVE) return begin_native(m, u);
    if (judged(m, u, CALL_ExitInitializationMode, CALL(Plain, u, CALL_ExitInitializationMode)(u->component))) return 1;
    memcpy(u->known, u->inputs, (size_t)u->ninputs * sizeof(double));
    u->begins = u->has_instants;
    return u->can_save ? try_to_save(m, u) : 0;
}

/* Outputs in initialization mode. */
static int exchange(Master *m)
{
    m->failure = MASTER_FINE;
    m->depth = 0;
    m->is_starting = 1;
    take_segment(m, m->t);
    for (int k = 0; k < m->nunits; k++) /* before anything is known of their inputs */
        if (m->units[k].kind == MASTER_NATIVE && begin_native(m, &m->units[k])) return 1;
    return evaluate(m, m->t);
}

int master_foresee(Master *m)
{
    int wrong;
    if (m->has_started) {
        if (!m->is_foreseen) memcpy(m->left_y, m->y, (size_t)m->nelements * sizeof(double));
        m->is_foreseen = 1;
        m->failure = MASTER_FINE;
        take_segment(m, m->t);
        wrong = evaluate(m, m->t);
    } else {
        wrong = exchange(m);
        m->is_starting = 0;
    }
    return wrong ? MASTER_FAILED : MASTER_DONE;
}

/* Outputs are those from before inputs were set. */
static void forget_foreseen(Master *m)
{
    if (m->is_foreseen) memcpy(m->y, m->left_y, (size_t)m->nelements * sizeof(double));
    m->is_foreseen = 0;
}

int master_start(Master *m)
{
    int is_new = 0, wrong = exchange(m);
    for (int k = 0; k < m->nunits && !wrong; k++) {
        take_inputs(m, &m->units[k], m->t);
        wrong = put(m, &m->units[k], m->units[k].sets, m->units[k].nsets);
    }
    for (int k = 0; k < m->nunits && !wrong; k++) wrong = finish_start(m, &m->units[k]);
    m->is_starting = 0;
    if (wrong) return MASTER_FAILED;
    for (int k = 0; k < m->nunits; k++)
        if (m->is_doubled && !m->units[k].can_save) m->is_doubled = 0, m->first_step = m->first_step * sqrt(m->tolerance) / 10;
    if (evaluate(m, m->t)) return MASTER_FAILED; /* some FMUs compute their outputs only when they leave initialization */
    memcpy(m->left_y, m->y, (size_t)m->nelements * sizeof(double));
    double edge = next_break(m, m->broken);
    int at_break = edge <= m->t || blocks_within_ulps(edge, m->t, 0.0);
    for (int k = 0; k < m->nunits; k++) /* its start alone makes nothing due */
        if (m->units[k].kind == MASTER_NATIVE) ((BlocksSim *)m->units[k].component)->changed = 0;
    if (instants(m, m->left_y, at_break)) return MASTER_FAILED;
    for (int g = 0; g < m->nelements; g++) {
        begin_anew(&m->past[g], m->t, m->y[g]);
        is_new |= m->elements[g].first_reader < m->elements[g + 1].first_reader && !m->elements[g].is_held;
    }
    m->fresh = !is_new;
    m->has_started = 1;
    return measure(m, 1.0) || record(m, NULL) ? MASTER_FAILED : MASTER_DONE;
}

/* --- going back from outside ---------------------------------------------------------------------------------------------- */

#define WALK(number) blocks_walk(w, &(number), sizeof(number))
#define WALK_ROW(row, count) blocks_walk(w, row, (size_t)(count) * sizeof *(row))

static void walk_unit(BlocksWalk *w, MasterUnit *u)
{
    const int32_t n = u->ninputs;
    WALK(u->way), WALK(u->can_save), WALK(u->next), WALK(u->t), WALK(u->next_t), WALK(u->begin), WALK(u->reached), WALK(u->kept_t);
    WALK(u->uncounted), WALK(u->over_t), WALK(u->is_over), WALK(u->takes), WALK(u->is_bent), WALK(u->waits), WALK(u->late_t);
    WALK(u->begins), WALK(u->has_saved), WALK(u->is_due);
    WALK_ROW(u->inputs, n), WALK_ROW(u->courses, 3 * n), WALK_ROW(u->known, n);
    if (u->kind != MASTER_NATIVE) return;
    BlocksSim *s = u->component;
    int32_t has_polynomials = s->polynomials != NULL, had;
    WALK_ROW(u->terms, 4 * n), WALK_ROW(u->track, n), WALK(u->polynomials.t0);
    s->keeps_past = 0; /* who comes back from outside needs all of it */
    blocks_walk_run(w, s);
    s->keeps_past = 1;
    WALK(s->flowed), WALK(has_polynomials);
    if (!w->writes || !w->at || w->failed) return;
    s->polynomials = has_polynomials ? &u->polynomials : NULL;
    s->fired_events.used = 0;
    had = s->has_first;
    const double sides_t = s->sides_t;
    CALL(Reload, u, CALL_reload)(s);
    s->has_first = had;
    s->is_factored = 0;
    s->sides_t = sides_t;
}

void master_walk(BlocksWalk *w, Master *m)
{
    const int64_t n = m->nelements, e = m->nexchanged;
    int64_t nu = 0;
    for (int j = 0; j < m->ntracks; j++) nu += m->tracks[j].size;
    forget_foreseen(m);
    WALK(m->has_started), WALK(m->is_doubled), WALK(m->first_step), WALK(m->t), WALK(m->broken), WALK(m->h), WALK(m->row), WALK(m->fresh);
    WALK(m->has_inverse), WALK(m->inverse_h), WALK(m->small), WALK(m->worst), WALK(m->crowd);
    WALK(m->steps), WALK(m->rejected), WALK(m->instants), WALK(m->iterated);
    WALK_ROW(m->y, n), WALK_ROW(m->past, n), WALK_ROW(m->base, nu), WALK_ROW(m->aim, nu), WALK_ROW(m->begin, nu), WALK_ROW(m->finish, nu);
    if (m->inverse) WALK_ROW(m->inverse, e * e);
    for (int k = 0; k < m->nunits; k++) walk_unit(w, &m->units[k]);
}

const int64_t master_sizes[] = {
    sizeof(MasterLink), sizeof(MasterGroup), sizeof(MasterUnit), sizeof(MasterQuick), sizeof(MasterStage), sizeof(MasterLoop),
    sizeof(MasterPast), sizeof(MasterGrowth), sizeof(MasterElement), sizeof(Master),
};
