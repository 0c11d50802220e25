/* What is done with FMUs for Model Exchange; see fmu_bridge.h. */
#include "fmu_bridge.h"

enum { MOST_UPDATES = 100, OK = 0, WARNING = 1, DISCARD = 2 };

static const double LEAST = 5e-324;

/* Remembers the first failure; 1 where there is one. */
static int judged(BlocksForeign *f, int status, int call, uint32_t reference)
{
    if (status <= WARNING) return 0;
    if (!f->status) {
        f->status = status;
        f->call = call;
        f->reference = (int32_t)reference;
    }
    return 1;
}

/* --- values of a type --------------------------------------------------------------------------------------- */

typedef int (*Moved2)(void *, const uint32_t *, size_t, void *);
typedef int (*Moved3)(void *, const uint32_t *, size_t, void *, size_t);

static int moved(const BlocksForeign *f, void *function, uint32_t reference, void *values, int size)
{
    if (f->fmi == 2) return ((Moved2)function)(f->component, &reference, 1, values);
    return ((Moved3)function)(f->component, &reference, 1, values, (size_t)size);
}

/* The elements of a variable as doubles: in f->values, which has room for both. */
static int get_one(BlocksForeign *f, const BlocksVariable *v, double *values)
{
    int status = OK;
    switch (v->type) {
    case BLOCKS_FLOAT64: return moved(f, f->get[v->type], v->reference, values, v->size);
#define GET(name, type)                                                                                               \
    case BLOCKS_##name: {                                                                                             \
        type *own = (type *)(void *)f->raw;                                                                           \
        status = moved(f, f->get[BLOCKS_##name], v->reference, own, v->size);                                         \
        for (int i = 0; i < v->size; i++) values[i] = (double)own[i];                                                 \
        break;                                                                                                        \
    }
        BLOCKS_CONVERTED(GET)
    default: break;
    }
    return status;
}

static int set_one(BlocksForeign *f, const BlocksVariable *v, const double *values)
{
    switch (v->type) {
    case BLOCKS_FLOAT64:
        for (int i = 0; i < v->size; i++) f->raw[i] = values[i];
        return moved(f, f->set[v->type], v->reference, f->raw, v->size);
#define SET(name, type)                                                                                               \
    case BLOCKS_##name: {                                                                                             \
        type *own = (type *)(void *)f->raw;                                                                           \
        for (int i = 0; i < v->size; i++) own[i] = (type)values[i];                                                   \
        return moved(f, f->set[BLOCKS_##name], v->reference, own, v->size);                                           \
    }
        BLOCKS_CONVERTED(SET)
    default: return OK;
    }
}

/* --- between instants ---------------------------------------------------------------------------------------- */

typedef int (*Plain)(void *);
typedef int (*SetTime)(void *, double);
typedef int (*Vector)(void *, double *, size_t);

static int vector(BlocksForeign *f, int call, int n)
{
    if (!n) return OK;
    return ((Vector)f->calls[call])(f->component, f->raw, (size_t)n);
}

/* A number of the FMU in SI. Without an offset, -0.0 stays -0.0. */
static double in_si(double number, double scale, double offset)
{
    double value = number * scale;
    return offset != 0.0 ? value + offset : value;
}

/* Inputs that were given and that the FMU has not yet; held ones wait for its next event. */
static int put_inputs(BlocksForeign *f)
{
    for (int k = 0; k < f->nvariables; k++) {
        const BlocksVariable *v = &f->variables[k];
        if (v->held && f->mode == BLOCKS_CONTINUOUS) continue;
        int differs = 0, known = 1;
        for (int i = v->first; i < v->first + v->size; i++) {
            differs |= !(f->u[i] == f->had[i]);
            known &= f->u[i] == f->u[i];
        }
        if (!differs || !known) continue;
        double *own = f->values;
        for (int i = 0; i < v->size; i++) own[i] = (f->u[v->first + i] - f->offsets[v->first + i]) / f->scales[v->first + i];
        f->has_rates = 0;
        if (judged(f, set_one(f, v, own), BLOCKS_SET + v->type, v->reference)) return 1;
        for (int i = v->first; i < v->first + v->size; i++) f->had[i] = f->u[i];
    }
    return 0;
}

/* At a time with states, as far as they differ; given: of the FMU at places. 1: failed; -1: discarded. */
static int put(BlocksForeign *f, double t, int changed)
{
    int discarded = 0, status;
    if (f->mode == BLOCKS_CONTINUOUS) {
        if (!(t == f->t)) {
            f->t = t;
            f->has_rates = 0;
            status = ((SetTime)f->calls[BLOCKS_SET_TIME])(f->component, t);
            if (status == DISCARD) discarded = -1, f->t = NAN;
            else if (judged(f, status, BLOCKS_SET_TIME, 0)) return 1;
        }
        if (changed || f->stale) {
            f->stale = f->has_rates = 0;
            for (int i = 0; i < f->nx; i++) f->raw[i] = (f->x[i] - f->origins[i]) / f->factors[i];
            status = vector(f, BLOCKS_SET_STATES, f->nx);
            if (status == DISCARD) {
                discarded = -1;
                f->stale = 1;
            } else if (judged(f, status, BLOCKS_SET_STATES, 0)) {
                return 1;
            }
        }
    }
    if (put_inputs(f)) return 1;
    return discarded;
}

static int asked_for(BlocksForeign *f, int call, int n)
{
    int status = vector(f, call, n);
    return status == DISCARD ? -1 : judged(f, status, call, 0);
}

static int read(BlocksForeign *f, const BlocksRequest *q, const double *given, double *made)
{
    static const int kinds[] = {BLOCKS_STATE, BLOCKS_DERIVATIVE, BLOCKS_INDICATOR};
    static const int calls[] = {BLOCKS_GET_STATES, BLOCKS_GET_DERIVATIVES, BLOCKS_GET_INDICATORS};
    /* There are FMUs that compute their values only where they are asked for derivatives. */
    int before = q->nvariables && f->mode == BLOCKS_CONTINUOUS && !f->has_rates ? 1 << BLOCKS_DERIVATIVE : 0;
    for (int j = 0; j < 3; j++) {
        if (!((q->kinds | before) >> kinds[j] & 1)) continue;
        if (asked_for(f, calls[j], kinds[j] == BLOCKS_INDICATOR ? f->nz : f->nx)) return 1;
        if (kinds[j] == BLOCKS_DERIVATIVE) f->has_rates = 1;
        for (int k = 0; k < q->nitems; k++) {
            const BlocksItem *item = &q->items[k];
            if (item->kind != kinds[j]) continue;
            double value = f->raw[item->index];
            made[k] = kinds[j] == BLOCKS_INDICATOR ? value != 0.0 ? value : -LEAST : in_si(value, item->scale, item->offset);
        }
    }
    for (int k = 0; k < q->nvariables; k++) {
        const BlocksVariable *v = &q->variables[k];
        int status = get_one(f, v, f->values + v->first);
        if (status == DISCARD || judged(f, status, BLOCKS_GET + v->type, v->reference)) return 1;
    }
    for (int k = 0; k < q->nitems; k++) {
        const BlocksItem *item = &q->items[k];
        if (item->kind == BLOCKS_VALUE) made[k] = in_si(f->values[item->index], item->scale, item->offset);
        else if (item->kind == BLOCKS_EVENT_TIME) made[k] = f->next_event;
        else if (item->kind == BLOCKS_GIVEN) made[k] = given[item->index];
        else if (item->kind == BLOCKS_NUMBER) made[k] = item->scale;
    }
    return 0;
}

/* Partial derivatives by inputs, as quotients of differences; values: room for all items. */
static int derive(BlocksForeign *f, const BlocksRequest *q, const double *given, double *made)
{
    double values[q->nitems];
    for (int k = 0; k < q->nitems; k++) {
        int by = q->items[k].by, is_first = by >= 0;
        for (int j = 0; j < k; j++) is_first = is_first && q->items[j].by != by;
        if (!is_first) continue;
        double own = f->u[by], size = fabs(own) > 1.0 ? fabs(own) : 1.0;
        f->u[by] = own + 1.4901161193847656e-08 * size;
        double step = f->u[by] - own;
        if (put_inputs(f) || read(f, q, given, values)) return 1;
        for (int j = k; j < q->nitems; j++)
            if (q->items[j].by == by) made[j] = (values[q->items[j].index] - made[q->items[j].index]) / step;
        f->u[by] = own;
    }
    return put_inputs(f);
}

void blocks_foreign_values(BlocksForeign *f, const BlocksRequest *q, double t, const double *given, double *made)
{
    int failed = f->status != 0;
    if (!failed) {
        int changed = 0;
        if (f->mode == BLOCKS_CONTINUOUS)
            for (int k = 0; k < q->nstates; k++) {
                double value = given[q->states[2 * k]], *place = &f->x[q->states[2 * k + 1]];
                changed |= !(*place == value);
                *place = value;
            }
        for (int k = 0; k < q->ninputs; k++) {
            double value = given[q->inputs[2 * k]], *place = &f->u[q->inputs[2 * k + 1]];
            *place = value;
        }
        failed = put(f, t, changed) || read(f, q, given, made);
        if (!failed && q->kinds >> BLOCKS_PARTIAL & 1) failed = derive(f, q, given, made);
    }
    if (failed)
        for (int k = 0; k < q->nitems; k++) made[k] = NAN;
}

/* --- steps and events ---------------------------------------------------------------------------------------- */

static BlocksForeigns *units_of(const BlocksSim *s) { return s->memory.f; }

static int failed(BlocksSim *s, int unit) { return blocks_fail(s, BLOCKS_FOREIGN, unit, s->t); }

static int fault(BlocksForeign *f, int what)
{
    if (!f->status) f->status = what;
    return 1;
}

/* At a time for good. */
static int stand(BlocksForeign *f, double t, const double *x, const double *inputs)
{
    int changed = 0;
    if (f->status) return 1;
    for (int i = 0; i < f->nx; i++) {
        double value = x[f->states[i]];
        changed |= !(f->x[i] == value);
        f->x[i] = value;
    }
    for (int i = 0; i < f->nu; i++) f->u[i] = inputs[i];
    int stopped = put(f, t, changed);
    return stopped < 0 ? fault(f, BLOCKS_REFUSES) : stopped;
}

typedef struct {
    int needs_more, ends, nominals, states, has_next;
    double next_time;
} EventInfo2;
typedef int (*Update2)(void *, EventInfo2 *);
typedef int (*Update3)(void *, _Bool *, _Bool *, _Bool *, _Bool *, _Bool *, double *);
typedef int (*Completed2)(void *, int, int *, int *);
typedef int (*Completed3)(void *, _Bool, _Bool *, _Bool *);

/* The states as the FMU has them. */
static int states_of(BlocksForeign *f, double *x)
{
    if (judged(f, vector(f, BLOCKS_GET_STATES, f->nx), BLOCKS_GET_STATES, 0)) return 1;
    for (int i = 0; i < f->nx; i++) {
        f->x[i] = in_si(f->raw[i], f->factors[i], f->origins[i]);
        if (!isfinite(f->x[i])) return fault(f, BLOCKS_BAD_STATE);
        x[f->states[i]] = f->x[i];
    }
    return 0;
}

/* New discrete states until nothing is new; then continuous time, with the states as they are now. */
static int updated(BlocksForeign *f, double *x)
{
    int pass = 0, status;
    double following;
    for (; pass < MOST_UPDATES; pass++) {
        int again, ends;
        if (f->fmi == 2) {
            EventInfo2 told = {0, 0, 0, 0, 0, 0.0};
            status = ((Update2)f->calls[BLOCKS_UPDATE])(f->component, &told);
            again = told.needs_more, ends = told.ends, following = told.has_next ? told.next_time : INFINITY;
        } else {
            _Bool flags[5] = {0, 0, 0, 0, 0};
            double time = 0.0;
            status = ((Update3)f->calls[BLOCKS_UPDATE])(f->component, flags, flags + 1, flags + 2, flags + 3, flags + 4, &time);
            again = flags[0], ends = flags[1], following = flags[4] ? time : INFINITY;
        }
        if (status == DISCARD ? fault(f, BLOCKS_REFUSES) : judged(f, status, BLOCKS_UPDATE, 0)) return 1;
        if (ends) f->over = 1, following = INFINITY;
        if (f->over) break;
        if (!again && following > f->t) break;
    }
    if (pass == MOST_UPDATES) return fault(f, BLOCKS_NO_END_OF_UPDATES);
    f->next_event = following;
    if (!f->over) {
        status = ((Plain)f->calls[BLOCKS_ENTER_CONTINUOUS])(f->component);
        if (judged(f, status, BLOCKS_ENTER_CONTINUOUS, 0)) return 1;
        f->mode = BLOCKS_CONTINUOUS;
    }
    f->asks = f->has_rates = 0;
    f->epoch++;
    return states_of(f, x);
}

/* One ended the run: C comes back after this instant. Inside of another run that is not possible, and fails. */
static int comes_back(BlocksSim *s, BlocksForeign *f)
{
    if (s->setup->is_silent) return fault(f, BLOCKS_ENDS);
    s->deadline = -INFINITY;
    s->budget = 0;
    return 0;
}

/* The inputs of a unit, then its tunable parameters, into `given`. */
static void gather(BlocksSim *s, BlocksForeign *f, const double *taken)
{
    int n = f->nu - f->ntunables;
    for (int i = 0; i < n; i++) f->given[i] = taken[i];
    for (int i = 0; i < f->ntunables; i++) f->given[n + i] = s->memory.p[f->tunables[i]];
}

static int initialized(BlocksSim *s, const double *inputs)
{
    BlocksForeigns *all = units_of(s);
    for (int k = 0; k < all->n; k++) {
        BlocksForeign *f = &all->units[k];
        gather(s, f, inputs);
        inputs += f->nu - f->ntunables;
        for (int i = 0; i < f->nu; i++) f->u[i] = f->given[i];
        if (f->status || put_inputs(f)) return failed(s, k);
    }
    return 0;
}

static int started(BlocksSim *s)
{
    BlocksForeigns *all = units_of(s);
    for (int k = 0; k < all->n; k++) {
        BlocksForeign *f = &all->units[k];
        int status = ((Plain)f->calls[BLOCKS_EXIT_INITIALIZATION])(f->component);
        if (f->status || judged(f, status, BLOCKS_EXIT_INITIALIZATION, 0)) return failed(s, k);
        for (int i = 0; i < f->nu; i++) f->seen[i] = f->u[i];
        f->mode = BLOCKS_AT_EVENT; /* until its turn in the first instant */
        if (states_of(f, s->memory.x)) return failed(s, k);
    }
    return 0;
}

/* Which of them have an event now. due: of all causes; events begin at `first`. */
static int asked(BlocksSim *s, const uint8_t *due, const uint8_t *changed, int first)
{
    BlocksForeigns *all = units_of(s);
    int any = 0;
    blocks_evaluate(s, s->model->foreign_inputs, s->t, s->memory.x, all->taken);
    const double *inputs = all->taken;
    for (int k = 0; k < all->n; k++) {
        BlocksForeign *f = &all->units[k];
        gather(s, f, inputs);
        inputs += f->nu - f->ntunables;
        f->due = f->asks || due[first + f->event];
        f->due_time = due[first + f->event] && s->firing_time[first + f->event] > s->t ? s->firing_time[first + f->event] : s->t;
        for (int i = 0; i < f->ncrossings; i++) f->due |= changed[f->crossings[i]];
        for (int i = 0; i < f->nu; i++) f->due |= !(f->given[i] == f->seen[i]);
        if (f->over || f->waits || s->late[first + f->event]) f->due = 0;
        any |= f->due;
    }
    return any;
}

static int hold(BlocksSim *s)
{
    BlocksForeigns *all = units_of(s);
    int any = 0;
    for (int k = 0; k < all->n; k++)
        for (int i = 0; all->units[k].waits && i < all->units[k].ncrossings; i++)
            any |= s->late[all->units[k].crossings[i]] = s->changed_sides[all->units[k].crossings[i]];
    return any;
}

/* Event mode, and back, of those that have an event. */
static int events(BlocksSim *s)
{
    BlocksForeigns *all = units_of(s);
    for (int k = 0; k < all->n; k++) {
        BlocksForeign *f = &all->units[k];
        if (!f->due) continue;
        f->due = 0;
        int begins = f->mode == BLOCKS_AT_EVENT;
        if (!begins) {
            if (stand(f, f->due_time, s->memory.x, f->seen)) return failed(s, k);
            if (judged(f, ((Plain)f->calls[BLOCKS_ENTER_EVENT])(f->component), BLOCKS_ENTER_EVENT, 0)) return failed(s, k);
            f->mode = BLOCKS_AT_EVENT;
        }
        for (int i = 0; i < f->nu; i++) f->u[i] = f->seen[i] = f->given[i];
        if (put_inputs(f) || updated(f, s->memory.x)) return failed(s, k);
        if (f->over && comes_back(s, f)) return failed(s, k);
        if (begins && f->ncrossings) { /* the sides from which it starts; nothing has fired */
            s->model->refresh(&s->memory);
            blocks_evaluate(s, s->model->crossings, s->t, s->memory.x, s->stage_values);
            for (int i = 0; i < f->ncrossings; i++) s->memory.s[f->crossings[i]] = s->stage_values[f->crossings[i]] >= 0;
        }
    }
    return 0;
}

static int postponed(BlocksSim *s, int32_t *due, int n, int *waiting)
{
    BlocksForeigns *all = units_of(s);
    for (int k = 0; k < all->n; k++) {
        BlocksForeign *f = &all->units[k];
        f->waits = f->mode == BLOCKS_AT_EVENT;
        for (int i = 0; i < n; i++) {
            if (due[i] != f->event) continue;
            f->waits = 1;
            due[i--] = due[--n];
        }
        *waiting += f->waits;
    }
    return n;
}

static int waits(const BlocksSim *s, int unit) { return units_of(s)->units[unit].waits; }

static int turn(BlocksSim *s, int unit, const int32_t *late, int nlate)
{
    BlocksForeigns *all = units_of(s);
    BlocksForeign *f = &all->units[unit];
    f->waits = 0;
    if (f->mode == BLOCKS_AT_EVENT) {
        f->asks = 1;
        return -1;
    }
    for (int i = 0; i < nlate; i++) f->late |= late[i] >= 0 ? s->due[late[i]] : all->units[-1 - late[i]].waits;
    return f->event;
}

/* An accepted step: 1 where an event is asked for, -1 where one failed. */
/* Some FMUs compute outputs only when a step is completed: inside it they are those of the step before. */
enum { MOST_LOOKS = 1000, MOST_WATCHED = 8 };

/* Whether the outputs that are watched could be read. */
static int watched(BlocksForeign *f, double *values)
{
    for (int k = 0; k < f->nwatched; k++)
        if (get_one(f, &f->watched[k], &values[k]) > WARNING) return 0;
    return 1;
}

static int looks(BlocksForeign *f, double *values)
{
    if (!f->nwatched || f->looks >= MOST_LOOKS) return 0;
    f->looks++;
    if (!f->has_rates && vector(f, BLOCKS_GET_DERIVATIVES, f->nx) > WARNING) return 0;
    f->has_rates = 1;
    return watched(f, values);
}

static void compare(BlocksForeign *f, const double *before)
{
    double after[MOST_WATCHED];
    if (!watched(f, after)) return;
    for (int k = 0; k < f->nwatched; k++) {
        f->lags[k] += before[k] == f->followed[k] && before[k] != after[k];
        f->followed[k] = after[k];
    }
}

static int completed(BlocksSim *s)
{
    BlocksForeigns *all = units_of(s);
    int any = 0;
    blocks_evaluate(s, s->model->foreign_inputs, s->t, s->memory.x, all->taken);
    const double *inputs = all->taken;
    for (int k = 0; k < all->n; k++) {
        BlocksForeign *f = &all->units[k];
        int n = f->nu - f->ntunables, enter, ends, status;
        for (int i = 0; i < n; i++) f->given[i] = inputs[i];
        for (int i = n; i < f->nu; i++) f->given[i] = f->seen[i];
        inputs += n;
        if (stand(f, s->t, s->memory.x, f->given)) return -failed(s, k);
        for (int v = 0; v < f->nvariables; v++) { /* of held ones, what it was given at its last event */
            const BlocksVariable *one = &f->variables[v];
            for (int i = one->first; !one->held && i < one->first + one->size; i++) f->seen[i] = f->given[i];
        }
        if (!f->completes) continue;
        double before[MOST_WATCHED];
        int is_looked = looks(f, before);
        if (f->fmi == 2) {
            int flags[2] = {0, 0};
            status = ((Completed2)f->calls[BLOCKS_COMPLETED])(f->component, 1, flags, flags + 1);
            enter = flags[0], ends = flags[1];
        } else {
            _Bool flags[2] = {0, 0};
            status = ((Completed3)f->calls[BLOCKS_COMPLETED])(f->component, 1, flags, flags + 1);
            enter = flags[0], ends = flags[1];
        }
        if (status == DISCARD ? fault(f, BLOCKS_REFUSES) : judged(f, status, BLOCKS_COMPLETED, 0)) return -failed(s, k);
        if (is_looked) compare(f, before);
        f->over |= ends;
        if (f->over && comes_back(s, f)) return -failed(s, k);
        f->asks |= enter;
        any |= f->asks || f->over;
    }
    return any;
}

static int64_t epoch(const BlocksSim *s)
{
    BlocksForeigns *all = units_of(s);
    int64_t sum = 0;
    for (int k = 0; k < all->n; k++) sum += all->units[k].epoch;
    return sum;
}

const BlocksHooks blocks_hooks = {initialized, started, asked, hold, events, postponed, waits, turn, completed, epoch};
