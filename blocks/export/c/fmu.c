/* One instance of an exported diagram; see fmu.h. The numbers are those of the runtime: what a run of the diagram
   computes between and at its stops, an instance computes between and at its communication points.

   Something that is set is written down, and taken in when it is next needed: by a value that is asked for, a step, an
   event. Nothing is allocated between instantiation and the end, but for what histories grow by. */
#include "fmu.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmu_model.h"

enum { OUTPUTS_KNOWN = 1, LOCALS_KNOWN = 2, RATES_KNOWN = 4, INDICATORS_KNOWN = 8, JACOBIAN_KNOWN = 16, STATES_KNOWN = 32, BEGUN = 64 };

struct Fmu {
    Live live;
    BlocksEntry entries[24]; /* its own memory, beside that of the run */
    int nentries;
    void *arena;
    BlocksSim *sim;
    BlocksSetup setup;
    BlocksTrack track;
    BlocksPolynomials polynomials;
    double *atol, *input, *terms, *settings, *outputs, *locals, *states, *rates, *indicators, *largest, *stays;
    /* largest: (ns) how far each indicator was away from 0 */
    /* stays: (ns) whether a crossing is due since before inputs were set, so that it waits for its event; see `foresees` */
    /* terms: (5, nu) values and derivatives of inputs, and when derivatives were set last */
    BlocksPolynomials curves; /* of inputs within a communication step with intermediate updates; see `ask` */
    double *bends, *samples, *slack, until;
    /* (4, nu) of the curves, (4, nu) what was set for their times, the last of which is `until`; (nu) how far a value that
       counts as the same may be from a curve */
    int has_reals, is_other;  /* whether there are real inputs; whether an input was set to what is not the same */
    double *room, *data; /* of derivatives */
    double *moved, *above, *below;
    double always;
    FmuLog log;
    void *owner;
    int categories;
};

#include "fmu_values.h"

/* --- life ------------------------------------------------------------------------------------------------------- */

Fmu *fmu_new(int kind, const char *name, const char *token, const char *resources, FmuLog log, void *owner)
{
    (void)resources;
    const FmuModel *model = &fmu_model;
    const char *why = why_no_instance(kind, name, token);
    Fmu *f = NULL;
    if (why) {
        if (log) log(owner, FMU_ERROR, FMU_LOG_ERROR, why);
        return NULL;
    }
    f = calloc(1, sizeof *f);
    if (f) {
#define ROW(field, n, flags) {NULL, &f->field, NULL, n, 0.0, sizeof(double), 'd', flags, 0}
        const BlocksModel *m = model->run.setup->model;
        const int64_t nx = model->run.nstates, nu = m->nu, ns = m->ns, nboth = nx + ns + model->noutputs;
        /* nboth: rates may come with crossings behind them */
        const BlocksEntry entries[] = {
            {NULL, &f->live, NULL, 1, 0.0, sizeof f->live, 'B', BLOCKS_SAVED | BLOCKS_HERE, 0},
            ROW(atol, nx, 0), ROW(input, nu, BLOCKS_SAVED), ROW(terms, 5 * nu, BLOCKS_SAVED), ROW(bends, 4 * nu, 0),
            ROW(samples, 4 * nu, 0), ROW(slack, nu, 0), ROW(settings, model->nsettings, BLOCKS_SAVED),
            ROW(outputs, model->noutputs, 0), ROW(locals, model->nlocals, 0), ROW(states, nx, 0), ROW(rates, nx + ns, 0),
            ROW(indicators, ns, 0), ROW(largest, ns, BLOCKS_SAVED), ROW(stays, ns, BLOCKS_SAVED),
            ROW(room, (int64_t)blocks_jacobian_room(&model->jacobian), 0),
            ROW(data, model->jacobian.first[model->jacobian.ncolumns], 0), ROW(moved, nx + m->nd + ns, 0), ROW(above, nboth, 0),
            ROW(below, nboth, 0),
        };
        _Static_assert(sizeof entries <= sizeof f->entries, "too many entries");
        f->nentries = sizeof entries / sizeof *entries;
        memcpy(f->entries, entries, sizeof entries);
        f->arena = blocks_allocate(entries, f->nentries);
        f->setup = *model->run.setup;
        f->setup.atol = f->atol;
        f->sim = f->arena ? blocks_new(&f->setup) : NULL;
    }
    if (!f || !f->sim) {
        fmu_free(f);
        if (log) log(owner, FMU_ERROR, FMU_LOG_ERROR, "there is no memory for an instance");
        return NULL;
    }
    f->sim->memory.n = model->run.numbers;
    f->sim->memory.c = model->run.tables;
    f->log = log;
    f->owner = owner;
    f->track = (BlocksTrack){&f->always, f->input, 1, f->setup.model->nu, 0};
    f->setup.tracks = &f->track;
    f->setup.ntracks = f->setup.model->nu > 0;
    f->polynomials.terms = f->terms;
    f->curves.terms = f->bends;
    for (int i = 0; i < model->nvariables; i++)
        f->has_reals |= model->variables[i].row == FMU_ROW_INPUT && model->variables[i].type == FMU_REAL;
    f->live.kind = kind;
    fmu_reset(f);
    return f;
}

void fmu_free(Fmu *f)
{
    if (!f) return;
    blocks_free(f->sim);
    free(f->arena);
    free(f);
}

int fmu_reset(Fmu *f)
{
    const FmuModel *model = &fmu_model;
    int kind = f->live.kind;
    memset(&f->live, 0, sizeof f->live);
    f->live.kind = kind;
    f->live.mode = FMU_INSTANTIATED;
    f->live.start = model->run.start;
    f->always = -INFINITY;
    memcpy(f->settings, model->settings, (size_t)model->nsettings * sizeof(double));
    memcpy(f->input, model->inputs, (size_t)f->setup.model->nu * sizeof(double));
    for (int i = 0; i < 5 * f->setup.model->nu; i++) f->terms[i] = i < 4 * f->setup.model->nu ? 0.0 : NAN;
    memcpy(f->sim->memory.p, model->run.parameters, (size_t)f->setup.model->np * sizeof(double));
    for (int j = 0; j < f->setup.model->ns; j++) f->largest[j] = 0.0;
    f->sim->polynomials = NULL;
    configure_run(&f->setup, f->atol, &fmu_model.run, &f->live);
    blocks_reset(f->sim);
    return FMU_OK;
}

void fmu_set_mode(Fmu *f, int mode) { f->live.mode = mode; }
/* Errors are told always: who does not ask for messages needs these most. */
void fmu_log_categories(Fmu *f, int categories) { f->categories = categories | FMU_LOG_ERROR; }
int fmu_has_traces(void) { return 0; }
double fmu_time(const Fmu *f) { return f->live.mode <= FMU_INITIALIZATION ? f->live.start : f->sim->t; }
size_t fmu_number_of_states(void) { return (size_t)fmu_model.run.nstates; }
size_t fmu_number_of_indicators(void) { return (size_t)fmu_model.run.setup->model->ns; }

/* --- failures --------------------------------------------------------------------------------------------------- */

/* Tells what stopped the numbers, and stands in FMU_FAILED. The instance is at its last good moment. */
static int failed(Fmu *f)
{
    f->live.mode = FMU_FAILED;
    f->live.known = 0;
    return tell_failure(f, f->sim, &fmu_model.run, f->rates);
}

/* Tells the events that fired, and forgets them. */
static void tell_events(Fmu *f)
{
    BlocksList *fired = &f->sim->fired_events;
    if (f->log && (f->categories & FMU_LOG_EVENTS))
        for (int64_t i = 0; i + 1 < fired->used; i += 2)
            fmu_say(f, FMU_OK, FMU_LOG_EVENTS, "t = %.17g s: %s", fired->data[i],
                    name_in(fmu_model.run.cause_names, f->setup.ncauses, (int)fired->data[i + 1]));
    fired->used = 0;
}

/* --- times ------------------------------------------------------------------------------------------------------ */

/* The tick or the point of the grid of steps that the end t of a communication step of h s means, or t. */
static double snapped(const Fmu *f, double t, double h)
{
    int64_t count;
    double miss = drift(&f->live, t, h);
    const BlocksGrid *grid = &f->setup.fixed;
    if (f->setup.model->nrates && tick_at(f->sim, t, miss, &count)) return blocks_tick_time(f->sim, count);
    if (grid->is_given) {
        /* Mostly it is the next one; where a step ended at a point, `fixed` is still the number of that. */
        double next = blocks_grid(grid, f->sim->fixed);
        if (next <= f->sim->t) next = blocks_grid(grid, f->sim->fixed + 1);
        if (means(f->sim, next, t, miss)) return next;
        double k = nearbyint((t * (double)grid->unit - (double)grid->start) / (double)grid->step);
        double point = fabs(k) < 9e15 ? blocks_grid(grid, (int64_t)k) : t;
        if (means(f->sim, point, t, miss)) return point;
    }
    return t;
}

/* --- what is set ------------------------------------------------------------------------------------------------- */

static void forget(Fmu *f) { f->live.known &= BEGUN; }

/* Whether inputs are polynomials by what was set in intermediate updates. */
static int is_curved(const Fmu *f) { return f->sim->polynomials == &f->curves; }

/* Whether what was set replaces what the polynomials say. A crossing that is outstanding fires by what the step has seen:
   an input that was then set a little lower would cross again at once, so that it waits for the end of the next step. */
static int replaces(Fmu *f)
{
    const BlocksSim *s = f->sim;
    int any = 0;
    for (int i = 0; i < f->setup.model->nu; i++) {
        if (fabs(f->input[i] - s->memory.u[i]) <= f->slack[i]) f->input[i] = s->memory.u[i];
        else any = 1;
    }
    if (any) f->is_other = 1;
    if (any && s->crossing) memcpy(f->input, s->memory.u, (size_t)f->setup.model->nu * sizeof(double));
    return any && !s->crossing;
}

/* Note which crossings are due before an input is set. */
static void note_due(Fmu *f)
{
    BlocksSim *s = f->sim;
    const int ns = f->setup.model->ns;
    if (s->outstanding && ns) {
        blocks_evaluate(s, f->setup.model->crossings, s->t + s->later, s->memory.x, f->indicators);
        blocks_beyond(s, f->indicators);
    }
    for (int j = 0; j < ns; j++) f->stays[j] = s->outstanding && (f->indicators[j] >= 0) != (s->memory.s[j] > 0.0);
}

/* Takes in what was set, as a change that an instant sees. */
static int take_in(Fmu *f)
{
    BlocksSim *s = f->sim;
    if (f->live.set & INPUTS_SET && is_curved(f) && !replaces(f)) f->live.set &= ~INPUTS_SET;
    if (!f->live.set) return FMU_OK;
    if (f->live.set & INPUTS_SET) f->is_other = 1;
    /* Between events inputs change without one. */
    const int is_instant = !(f->live.mode & (FMU_CONTINUOUS | FMU_INTERMEDIATE)) || f->live.set & SETTINGS_SET;
    if (is_instant && !s->changed) note_due(f);
    if (f->live.set & SETTINGS_SET) {
        if (bound(f, f->sim->memory.p)) return FMU_ERROR;
        blocks_rows(s);
    }
    s->polynomials = f->live.has_slopes ? &f->polynomials : NULL;
    f->polynomials.t0 = f->live.slopes_at;
    blocks_inputs(s, s->t);
    if (s->moving) blocks_outside(s, s->t);
    s->sides_t = NAN;
    s->has_first = s->has_before = 0;
    if (is_instant) s->outstanding = s->changed = 1;
    f->live.set = 0;
    forget(f);
    return FMU_OK;
}

/* Values at the start, with all that was set; no instant yet. */
static int begin(Fmu *f)
{
    BlocksSim *s = f->sim;
    if (f->live.known & BEGUN) return FMU_OK;
    configure_run(&f->setup, f->atol, &fmu_model.run, &f->live);
    blocks_reset(s);
    s->slice = INFINITY;
    if (f->live.set & SETTINGS_SET && bound(f, s->memory.p)) return FMU_ERROR;
    f->live.set = 0;
    s->polynomials = f->live.has_slopes ? &f->polynomials : NULL;
    f->polynomials.t0 = f->live.slopes_at;
    if (stand_at_start(f, s, &fmu_model.run)) return FMU_ERROR;
    forget(f);
    if (blocks_begin(s)) {
        failed(f);
        return FMU_ERROR;
    }
    f->live.known |= BEGUN;
    return FMU_OK;
}

/* The instance as it is to be read: begun where it has not been, with all that was set. The mode stays. */
static int ready(Fmu *f)
{
    if (f->live.mode <= FMU_INITIALIZATION) {
        int mode = f->live.mode, status = FMU_OK;
        if (f->live.set) f->live.known &= ~BEGUN;
        status = begin(f);
        f->live.mode = mode; /* other values may be set yet */
        return status;
    }
    return f->live.mode == FMU_FAILED ? FMU_OK : take_in(f);
}

/* The name of the variable that shows an element of a row. */
static const char *shown_by(int row, int index)
{
    for (int i = 0; i < fmu_model.nvariables; i++)
        if (fmu_model.variables[i].row == row && fmu_model.variables[i].index == index) return fmu_model.names[i];
    return "a value";
}

/* Whether what is replaced after each step would change now. */
static int would_project(Fmu *f)
{
    BlocksSim *s = f->sim;
    const int n = f->setup.model->nprojections;
    int any = 0;
    if (n) blocks_evaluate(s, f->setup.model->projections, s->t, s->memory.x, s->stage_values);
    for (int i = 0; i < n; i++) {
        const BlocksProjection *p = &f->setup.projections[i];
        if (p->condition >= 0 && s->memory.s[p->condition] == 0.0) continue;
        any |= s->stage_values[i] != (p->row == 0 ? s->memory.x : s->memory.d)[p->place];
    }
    return any;
}

/* Whether inputs that were set at this communication point cause events. What is read then comes after these, as in a run: a
   limit holds at once. They fire later, with the inputs of then: as the next step begins, or in event mode. */
static int foresees(Fmu *f)
{
    BlocksSim *s = f->sim;
    const int ns = f->setup.model->ns;
    if (f->live.kind != FMU_CS || f->live.mode <= FMU_INITIALIZATION || f->live.mode == FMU_FAILED || !s->changed) return 0;
    if (ns) {
        blocks_evaluate(s, f->setup.model->crossings, s->t + s->later, s->memory.x, s->crossing_values);
        blocks_beyond(s, s->crossing_values);
    }
    for (int j = 0; j < ns; j++)
        if (f->stays[j] == 0.0 && (s->crossing_values[j] >= 0) != (s->memory.s[j] > 0.0)) return 1;
    return would_project(f);
}

/* Read by `read` what holds now. */
static int look(Fmu *f, int (*read)(void *reading), void *reading)
{
    if (!foresees(f)) return read(reading);
    if (!blocks_foresee(f->sim, f->stays, read, reading)) return FMU_OK;
    return fmu_say(f, FMU_DISCARD, FMU_LOG_WARNING, "at t = %.17g s the events that inputs cause cannot be computed", f->sim->t);
}

typedef struct {
    Fmu *f;
    BlocksProgram program; /* null: states are read */
    double later, *out;
} Reading;

static int read_program(void *reading)
{
    const Reading *r = reading;
    BlocksSim *s = r->f->sim;
    if (r->program) blocks_evaluate(s, r->program, s->t + r->later, s->memory.x, r->out);
    else memcpy(r->out, s->memory.x, (size_t)fmu_model.run.nstates * sizeof(double));
    return 0;
}

static int evaluated(Fmu *f, int which, BlocksProgram program, double *out, int n, int row)
{
    BlocksSim *s = f->sim;
    if (f->live.known & which) return FMU_OK;
    Reading reading = {f, program, which == INDICATORS_KNOWN ? s->later : 0.0, out};
    const int status = look(f, read_program, &reading);
    if (status) return status;
    int bad = all_finite(out, n);
    if (bad >= 0)
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s is %g at t = %.17g s", shown_by(row, bad), out[bad], s->t);
    f->live.known |= which;
    return FMU_OK;
}

static int states(Fmu *f)
{
    Reading reading = {f, NULL, 0.0, f->states};
    if (f->live.known & STATES_KNOWN) return FMU_OK;
    const int status = look(f, read_program, &reading);
    if (!status) f->live.known |= STATES_KNOWN;
    return status;
}

static int outputs(Fmu *f)
{
    return evaluated(f, OUTPUTS_KNOWN, f->setup.model->logged, f->outputs, fmu_model.noutputs, FMU_ROW_OUTPUT);
}

static int rates(Fmu *f)
{
    BlocksSim *s = f->sim;
    if (f->live.known & RATES_KNOWN) return FMU_OK;
    Reading reading = {f, f->setup.model->rates, 0.0, f->rates};
    const int status = look(f, read_program, &reading);
    if (status) return status;
    int bad = all_finite(f->rates, fmu_model.run.nstates);
    if (bad >= 0)
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the derivative of %s is %g at t = %.17g s",
                       fmu_model.run.state_names[bad], f->rates[bad], s->t);
    f->live.known |= RATES_KNOWN;
    return FMU_OK;
}

/* Whether a crossing is so near to 0 that its sign may be one of rounding; `rates` are then known. */
static int is_near(Fmu *f, int j, double value)
{
    BlocksSim *s = f->sim;
    if (f->live.kind != FMU_ME || f->setup.model->hooks || !(fabs(value) < 1e-9 * f->largest[j])) return 0;
    if (!(f->live.known & RATES_KNOWN)) blocks_evaluate(s, f->setup.model->rates, s->t, s->memory.x, f->rates);
    return all_finite(f->rates, fmu_model.run.nstates) < 0;
}

/* The length, in s, of the way on which the rounding of a crossing is measured: the longest step, which is infinite without a
   stop time. */
static double reach_of(const Fmu *f) { return isfinite(f->setup.longest) ? f->setup.longest : 1.0; }

/* How far an indicator may be off by rounding, where 0 is in reach: by that of its own, and by an ulp of each input. */
static double band_of(Fmu *f, int j)
{
    BlocksSim *s = f->sim;
    const BlocksModel *model = f->setup.model;
    double band = blocks_rounding(s, j, f->rates, reach_of(f)), *out = s->crossing_values;
    for (int i = 0; i < model->nu; i++) {
        double was = s->memory.u[i];
        s->memory.u[i] = nextafter(was, INFINITY);
        model->crossings(&s->memory, s->t + s->later, s->memory.x, out);
        blocks_beyond(s, out);
        s->memory.u[i] = was;
        band = fmax(band, 4 * fabs(out[j] - f->indicators[j]));
    }
    return fmin(band, 1e-9 * f->largest[j]);
}

/* The indicators. One that comes so near to 0 that its sign may be one of rounding keeps the sign of its side within a band:
   an importer would else find an event at each change of it. */
static int indicators(Fmu *f)
{
    const int ns = f->setup.model->ns;
    BlocksSim *s = f->sim;
    if (f->live.known & INDICATORS_KNOWN) return FMU_OK;
    blocks_loosen(s);
    int status = evaluated(f, INDICATORS_KNOWN, f->setup.model->crossings, f->indicators, ns, FMU_ROW_INDICATOR);
    if (status) return status;
    blocks_beyond(s, f->indicators);
    for (int j = 0; j < ns; j++) {
        f->largest[j] = fmax(fabs(f->indicators[j]), f->largest[j]);
        if (is_near(f, j, f->indicators[j]))
            f->indicators[j] += s->memory.s[j] > 0.0 ? band_of(f, j) : -band_of(f, j);
    }
    return FMU_OK;
}

/* Let crossings that only touch 0 now keep their sides at the instant that follows. Those that change their side within 4 ulp
   after a tick or an event time belong to it, as in a run (`joins` of the runtime): states are then taken there. */
static void note_crossings(Fmu *f, int is_due)
{
    BlocksSim *s = f->sim;
    const BlocksModel *model = f->setup.model;
    const double later = 4 * blocks_ulp(s->t), since = later - s->later;
    double *now = s->touched, *near = f->indicators;
    int joined = 0;
    s->touched_t = s->t;
    if (!model->ns) return;
    blocks_evaluate(s, model->rates, s->t, s->memory.x, f->rates);
    blocks_evaluate(s, model->crossings, s->t + s->later, s->memory.x, now);
    blocks_beyond(s, now);
    if (is_due && since > 0.0 && all_finite(f->rates, model->nx) < 0) {
        for (int i = 0; i < model->nx; i++) s->x1[i] = s->memory.x[i] + since * f->rates[i];
        blocks_evaluate(s, model->crossings, s->t + later, s->x1, near);
        blocks_beyond(s, near);
        for (int j = 0; j < model->ns; j++) {
            int side = s->memory.s[j] > 0.0;
            joined |= (now[j] >= 0) == side && (near[j] >= 0) != side && !blocks_touches(s, j, f->rates, reach_of(f));
        }
    }
    for (int j = 0; j < model->ns; j++)
        if (!is_near(f, j, now[j]) || !blocks_touches(s, j, f->rates, reach_of(f))) now[j] = NAN;
        else if (joined) now[j] = near[j];
    if (!joined) return;
    memcpy(s->memory.x, s->x1, (size_t)model->nx * sizeof(double));
    s->later = later;
}

/* --- variables ---------------------------------------------------------------------------------------------------- */

int fmu_get(Fmu *f, uint32_t reference, int type, double *values, size_t count)
{
    const FmuModel *model = &fmu_model;
    if (!is_known(f, reference, type, count)) return FMU_ERROR;
    for (size_t k = 0; k < count; k++) {
        const FmuVariable *v = &model->variables[reference + k];
        int status = FMU_OK;
        switch (v->row) {
        case FMU_ROW_TIME: values[k] = fmu_time(f); break;
        case FMU_ROW_INPUT:
            values[k] = f->input[v->index];
            if (f->live.has_slopes && f->live.mode > FMU_INITIALIZATION) {
                status = ready(f);
                values[k] = f->sim->memory.u[v->index];
            }
            break;
        case FMU_ROW_SETTING:
            if (f->live.set & SETTINGS_SET && v->variability == FMU_CALCULATED) fmu_model.bind(f->settings, f->sim->memory.p);
            values[k] = f->settings[v->index];
            break;
        case FMU_ROW_STATE:
            if (!(status = ready(f))) status = states(f);
            values[k] = f->states[model->places[v->index]];
            break;
        case FMU_ROW_RATE:
            if (!(status = ready(f))) status = rates(f);
            values[k] = f->rates[model->places[v->index]];
            break;
        case FMU_ROW_OUTPUT:
            if (!(status = ready(f))) status = outputs(f);
            values[k] = f->outputs[v->index];
            break;
        case FMU_ROW_LOCAL:
            if (!(status = ready(f)))
                status = evaluated(f, LOCALS_KNOWN, model->locals, f->locals, model->nlocals, FMU_ROW_LOCAL);
            values[k] = f->locals[v->index];
            break;
        case FMU_ROW_INDICATOR:
            if (!(status = ready(f))) status = indicators(f);
            values[k] = f->indicators[v->index] == 0.0 ? DBL_MIN : f->indicators[v->index];
            break;
        default: return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s is no number", model->names[reference + k]);
        }
        if (status) return status;
    }
    return FMU_OK;
}

/* The polynomials of inputs go on from now: what one input is set to leaves the others as they were. */
static void anchor(Fmu *f)
{
    int n = f->setup.model->nu;
    double since = fmu_time(f) - f->live.slopes_at, *c = f->terms;
    if (!f->live.has_slopes) memcpy(c, f->input, (size_t)n * sizeof(double));
    else if (since != 0.0)
        for (int i = 0; i < n; i++) {
            c[i] += since * (c[n + i] + since * (c[2 * n + i] / 2 + since * (c[3 * n + i] / 6)));
            c[n + i] += since * (c[2 * n + i] + since * (c[3 * n + i] / 2));
            c[2 * n + i] += since * c[3 * n + i];
            f->input[i] = c[i];
        }
    f->live.slopes_at = fmu_time(f);
}

int fmu_set(Fmu *f, uint32_t reference, int type, const double *values, size_t count)
{
    if (fmu_check(f, reference, type, values, count)) return FMU_ERROR;
    for (size_t k = 0; k < count; k++) {
        const FmuVariable *v = &fmu_model.variables[reference + k];
        if (v->row == FMU_ROW_INPUT && f->live.has_slopes) {
            int n = f->setup.model->nu, any = 0;
            anchor(f);
            f->terms[v->index] = values[k];
            if (f->terms[4 * n + v->index] != fmu_time(f)) /* derivatives set at this very point hold from it on */
                for (int order = 1; order < 4; order++) f->terms[order * n + v->index] = 0.0;
            for (int i = n; i < 4 * n; i++) any |= f->terms[i] != 0.0;
            f->input[v->index] = values[k];
            f->live.has_slopes = any;
            f->live.set |= INPUTS_SET;
            continue;
        }
        double *place = (v->row == FMU_ROW_INPUT ? f->input : f->settings) + v->index;
        if (*place == values[k]) continue;
        *place = values[k];
        f->live.set |= v->row == FMU_ROW_INPUT ? INPUTS_SET : SETTINGS_SET;
    }
    return FMU_OK;
}

int fmu_set_input_derivative(Fmu *f, uint32_t reference, int order, double value)
{
    int n = f->setup.model->nu;
    if (!is_known(f, reference, FMU_REAL, 1)) return FMU_ERROR;
    const FmuVariable *v = &fmu_model.variables[reference];
    const char *name = fmu_model.names[reference];
    if (v->row != FMU_ROW_INPUT) return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s is no input", name);
    if (order < 1 || order > 3)
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s: derivatives of order 1 to 3 can be set, not %d", name, order);
    if (!isfinite(value)) return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "a derivative of %s cannot be set to %g", name, value);
    if (!f->live.has_slopes && value == 0.0) return FMU_OK;
    anchor(f);
    f->terms[order * n + v->index] = value;
    f->terms[4 * n + v->index] = fmu_time(f);
    f->live.has_slopes = 1;
    f->live.set |= INPUTS_SET;
    return FMU_OK;
}

/* --- initialization ------------------------------------------------------------------------------------------------ */

int fmu_enter_initialization(Fmu *f, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    /* Who integrates with fixed steps, or not at all, has no use for it. */
    if (f->live.kind == FMU_ME || fmu_model.run.setup->fixed.is_given) has_tolerance = 0;
    if (wrong_times(f, has_tolerance, tolerance, start, has_stop, stop)) return FMU_ERROR;
    begin_experiment(&f->live, has_tolerance, tolerance, start, has_stop, stop);
    return FMU_OK;
}

/* The instant that is outstanding. */
static int settled(Fmu *f)
{
    forget(f);
    int wrong = blocks_settle(f->sim);
    tell_events(f);
    return wrong ? failed(f) : FMU_OK;
}

int fmu_exit_initialization(Fmu *f, int has_event_mode)
{
    if (f->live.set) f->live.known &= ~BEGUN;
    if (begin(f)) return FMU_ERROR;
    f->live.has_event_mode = has_event_mode;
    if (f->live.kind == FMU_ME || has_event_mode) {
        f->live.mode = FMU_EVENT;
        return FMU_OK;
    }
    f->live.mode = FMU_STEP;
    int status = settled(f);
    if (status) return status;
    return outputs(f) ? (f->live.mode = FMU_FAILED, FMU_ERROR) : FMU_OK;
}

/* --- events -------------------------------------------------------------------------------------------------------- */

/* What an importer has stepped over happens now: 1 where there is such a tick or event time. */
static int overdue(Fmu *f)
{
    BlocksSim *s = f->sim;
    const BlocksSetup *setup = &f->setup;
    int any = 0;
    for (int i = 0; i < setup->model->nevents; i++)
        if (s->events[i] < s->t) s->events[i] = s->t, any = 1;
    for (int r = 0; r < setup->model->nrates; r++) {
        int64_t count = setup->rates[r].offset + s->ticks[r] * setup->rates[r].period;
        if (blocks_tick_time(s, count) > s->t || (any > 1 && count >= s->count)) continue;
        s->exact = 1;
        s->count = count;
        any = 2;
    }
    if (any) s->outstanding = 1;
    return any;
}

int fmu_enter_event_mode(Fmu *f)
{
    if (take_in(f)) return FMU_ERROR;
    f->live.mode = FMU_EVENT;
    if (f->live.kind == FMU_ME) {
        BlocksSim *s = f->sim;
        const double t = s->t;
        stand_at(f->sim, t);
        s->later = fmax(t - s->t, 0.0);
        int is_due = overdue(f) || blocks_is_due(s);
        blocks_loosen(s);
        note_crossings(f, is_due);
        if (blocks_end_step(s)) return failed(f); /* now, by the inputs from before the event */
    }
    f->sim->outstanding = 1;
    forget(f);
    return FMU_OK;
}

int fmu_update_discrete_states(Fmu *f, FmuEvents *events)
{
    BlocksSim *s = f->sim;
    size_t n = (size_t)fmu_model.run.nstates, nd = (size_t)s->model->nd, ns = (size_t)s->model->ns;
    double *x = f->moved, *d = x + n, *sides = d + nd;
    int has_moved = s->crossing == 2; /* as event mode was entered */
    memset(events, 0, sizeof *events);
    if (take_in(f)) return FMU_ERROR;
    memcpy(x, s->memory.x, n * sizeof(double));
    memcpy(d, s->memory.d, nd * sizeof(double));
    memcpy(sides, s->memory.s, ns * sizeof(double));
    do {
        if (s->outstanding && settled(f)) return FMU_ERROR;
    } while (f->live.kind == FMU_ME && overdue(f));
    events->states_changed = memcmp(x, s->memory.x, n * sizeof(double)) != 0;
    /* Importers begin their integration anew where this is said and nowhere else, and rates jump with discretes and
       sides as well: their right-hand side is another one from here on. */
    if (f->live.kind == FMU_ME && n && (has_moved || memcmp(d, s->memory.d, nd * sizeof(double))
                                        || memcmp(sides, s->memory.s, ns * sizeof(double))))
        events->states_changed = 1;
    events->next = blocks_next(s);
    events->has_next = isfinite(events->next);
    events->terminate = blocks_has_ended(s);
    return FMU_OK;
}

int fmu_enter_continuous_mode(Fmu *f)
{
    if (take_in(f)) return FMU_ERROR;
    if (f->sim->outstanding && settled(f)) return FMU_ERROR; /* what was set after the last update */
    f->live.mode = f->live.kind == FMU_ME ? FMU_CONTINUOUS : FMU_STEP;
    return FMU_OK;
}

/* --- Model Exchange ------------------------------------------------------------------------------------------------- */

int fmu_set_time(Fmu *f, double t)
{
    if (!isfinite(t)) return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the time cannot be %g", t);
    if (t == f->sim->t) return FMU_OK; /* in event mode it may stand exactly at a tick, which is not forgotten */
    forget(f);
    f->sim->t = t;
    f->sim->exact = 0;
    f->sim->later = 0.0;
    return FMU_OK;
}

int fmu_set_states(Fmu *f, const double *x, size_t n)
{
    if (!has_size(f, n, fmu_number_of_states(), "continuous states")) return FMU_ERROR;
    for (size_t i = 0; i < n; i++)
        if (!isfinite(x[i]))
            return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the state %s cannot be set to %g",
                           fmu_model.run.state_names[fmu_model.places[i]], x[i]);
    for (size_t i = 0; i < n; i++) f->sim->memory.x[fmu_model.places[i]] = x[i];
    forget(f);
    return FMU_OK;
}

int fmu_get_states(Fmu *f, double *x, size_t n)
{
    if (!has_size(f, n, fmu_number_of_states(), "continuous states")) return FMU_ERROR;
    int status = ready(f);
    if (status) return status;
    for (size_t i = 0; i < n; i++) x[i] = f->sim->memory.x[fmu_model.places[i]];
    return FMU_OK;
}

int fmu_get_rates(Fmu *f, double *values, size_t n)
{
    if (!has_size(f, n, fmu_number_of_states(), "continuous states")) return FMU_ERROR;
    int status = ready(f);
    if (!status) status = rates(f);
    if (status) return status;
    for (size_t i = 0; i < n; i++) values[i] = f->rates[fmu_model.places[i]];
    return FMU_OK;
}

int fmu_get_nominals(Fmu *f, double *x, size_t n)
{
    if (!has_size(f, n, fmu_number_of_states(), "continuous states")) return FMU_ERROR;
    if (n) memcpy(x, fmu_model.nominal, n * sizeof(double));
    return FMU_OK;
}

/* What is 0 counts as above: a crossing at exactly 0 has changed its side for those who look for a change of sign. */
int fmu_get_indicators(Fmu *f, double *z, size_t n)
{
    if (!has_size(f, n, fmu_number_of_indicators(), "event indicators")) return FMU_ERROR;
    int status = ready(f);
    if (!status) status = indicators(f);
    if (status) return status;
    for (size_t i = 0; i < n; i++) z[i] = f->indicators[i] == 0.0 ? DBL_MIN : f->indicators[i];
    return FMU_OK;
}

int fmu_completed_step(Fmu *f, int *enter_event_mode, int *terminate)
{
    BlocksSim *s = f->sim;
    const BlocksModel *model = f->setup.model;
    *enter_event_mode = *terminate = 0;
    int status = ready(f);
    if (status) return status;
    if (model->nz) { /* where the next searches begin */
        blocks_evaluate(s, model->solutions, s->t, s->memory.x, s->z1);
        if (all_finite(s->z1, model->nz) < 0) memcpy(s->memory.z, s->z1, (size_t)model->nz * sizeof(double));
    }
    *enter_event_mode = would_project(f);
    return FMU_OK;
}

/* --- Co-Simulation --------------------------------------------------------------------------------------------------- */

/* The polynomial of an input through its samples, exact for cubic ones; 0 where it is a constant. The terms come from
   differences to the first sample, so that constants stay what they are. Samples that lie on a line but for rounding make a
   line: beyond a step of some ulp a cubic through their rounding turns back, as if a crossing were only touched. */
static int bend(Fmu *f, int i, const double *t)
{
    const int n = f->setup.model->nu;
    const double *u = f->samples + i, first = u[0], last = u[3 * n];
    const double s1 = t[1] - t[0], s2 = t[2] - t[0], s3 = t[3] - t[0];
    const double v1 = u[n] - first, v2 = u[2 * n] - first, v3 = last - first;
    const double size = fmax(fmax(fabs(first), fabs(u[n])), fmax(fabs(u[2 * n]), fabs(last)));
    const double range = fmax(fmax(fabs(v1), fabs(v2)), fabs(v3));
    const double rounding = 4 * DBL_EPSILON * size + blocks_ulp(t[3]) * range / s3;
    const double off = fmax(fabs(v1 - v3 * (s1 / s3)), fabs(v2 - v3 * (s2 / s3)));
    double slope = 0.0, square = 0.0, cube = 0.0;
    if (0 < s1 && s1 < s2 && s2 < s3 && off > rounding) { /* Newton's divided differences of (u - first) / s */
        double q1 = v1 / s1, q12 = (v2 / s2 - q1) / (s2 - s1), q13 = (v3 / s3 - q1) / (s3 - s1);
        cube = (q13 - q12) / (s3 - s2);
        square = q12 - cube * (s1 + s2);
        slope = q1 - s1 * (q12 - s2 * cube);
    } else {
        slope = v3 / s3;
    }
    int is_bent = range > 0.0 && isfinite(slope) && isfinite(square) && isfinite(cube);
    /* Some ulp of its size, and what it moves by in some ulp of the time. */
    f->slack[i] = is_bent ? 4 * rounding : 16 * DBL_EPSILON * size;
    f->bends[i] = first;
    f->bends[n + i] = is_bent ? slope : 0.0;
    f->bends[2 * n + i] = is_bent ? 2 * square : 0.0;
    f->bends[3 * n + i] = is_bent ? 6 * cube : 0.0;
    return is_bent;
}

/* Asks what the inputs will be from now to `end`: now (at the begin of a communication step), then, and at two times
   between. Of what is set they are polynomials; what is not set stays as it was set last. 1 where an input jumps now. */
static int ask(Fmu *f, double end, int is_begin, FmuIntermediate intermediate, void *owner)
{
    BlocksSim *s = f->sim;
    const int n = f->setup.model->nu, mode = f->live.mode;
    const double third = (end - s->t) / 3, times[4] = {s->t, s->t + third, end - third, end};
    int ignored = 0, moves = 0, any = 0;
    double never = end;
    f->live.mode = FMU_ASKING;
    for (int k = 0; k < 4; k++) {
        if (k > 0 || is_begin) intermediate(owner, times[k], 0, &ignored, &never);
        memcpy(f->samples + k * n, f->input, (size_t)n * sizeof(double));
    }
    f->live.mode = mode;
    f->live.set = 0;
    memcpy(f->input, f->samples, (size_t)n * sizeof(double));
    for (int i = 0; i < n; i++) {
        moves |= bend(f, i, times);
        any |= !(fabs(f->input[i] - s->memory.u[i]) <= f->slack[i]);
    }
    int same = !memcmp(f->input, s->memory.u, (size_t)n * sizeof(double));
    if (same && !moves && !is_curved(f)) return 0; /* nothing was set */
    f->curves.t0 = s->t;
    f->until = end;
    s->polynomials = moves ? &f->curves : NULL;
    blocks_inputs(s, s->t);
    if (s->moving) blocks_outside(s, s->t);
    s->has_before = 0;
    if (!same) {
        s->has_first = 0;
        s->sides_t = NAN;
    }
    forget(f);
    return any;
}

/* The inputs as they were set are those of the polynomials now. */
static void follow(Fmu *f)
{
    BlocksSim *s = f->sim;
    const int n = f->setup.model->nu;
    if (!is_curved(f)) return;
    blocks_outside(s, s->t);
    memcpy(f->input, s->t == f->until ? f->samples + 3 * n : s->memory.u, (size_t)n * sizeof(double));
}

/* The polynomials end: the inputs stay what they are. */
static void hold(Fmu *f)
{
    BlocksSim *s = f->sim;
    if (!is_curved(f)) return;
    s->polynomials = NULL;
    blocks_inputs(s, s->t);
    if (s->moving) blocks_outside(s, s->t);
    forget(f);
}

/* Steps of the method from `begin` to `goal`, with what happens in between. */
static int step_to(Fmu *f, double begin, double goal, int early, FmuIntermediate intermediate, void *owner, FmuStep *step)
{
    BlocksSim *s = f->sim;
    double end = goal;
    /* Derivatives that were set are what the inputs follow. */
    int asks = intermediate && f->has_reals && !f->live.has_slopes;
    if (asks && ask(f, end, 1, intermediate, owner)) s->outstanding = s->changed = 1;
    if (is_curved(f) && f->setup.model->nh) s->outstanding = s->changed = 1; /* what is delayed has an edge there */
    for (;;) {
        if (s->outstanding) {
            int is_due = blocks_is_due(s);
            if (is_due && f->live.has_event_mode && s->t > begin && (early || s->t >= end)) {
                step->event_needed = 1;
                return FMU_OK;
            }
            if (is_due && settled(f)) return FMU_ERROR;
            s->outstanding = 0;
        }
        step->terminate = blocks_has_ended(s);
        if (step->terminate || !(s->t < end)) return FMU_OK;
        int came = blocks_proceed(s, end, 0, 0);
        follow(f);
        if (came == BLOCKS_FAILED || came == BLOCKS_NO_MEMORY) {
            tell_events(f);
            step->last_time = s->t;
            return failed(f);
        }
        if (intermediate && s->t > begin) {
            int is_early = 0, finished = !(s->t < end), mode = f->live.mode;
            double early_time = end;
            forget(f);
            if (finished) hold(f);
            f->is_other = 0;
            f->live.mode = FMU_INTERMEDIATE;
            intermediate(owner, s->t, finished, &is_early, &early_time);
            if (f->live.mode == FMU_FAILED || take_in(f)) return FMU_ERROR;
            f->live.mode = mode;
            if (is_early && early && early_time <= s->t && !finished) {
                if (s->outstanding && blocks_is_due(s)) step->event_needed = f->live.has_event_mode;
                return FMU_OK;
            }
            if (is_early && early && early_time < end) end = snapped(f, early_time, early_time - begin);
            if (asks && f->is_other && s->t < end) ask(f, end, 0, intermediate, owner);
        }
    }
}

int fmu_step(Fmu *f, double t, double h, int early, FmuIntermediate intermediate, void *owner, FmuStep *step)
{
    BlocksSim *s = f->sim;
    *step = (FmuStep){0, 0, 0, s->t};
    if (wrong_step_from(f, s->t, t, h)) return FMU_ERROR;
    f->live.steps++;
    double begin = s->t, goal = snapped(f, t + h, h);
    if (!(goal > begin)) {
        step->last_time = begin;
        return fmu_say(f, FMU_WARNING, FMU_LOG_WARNING, "the step of %g s is too short to be seen at t = %.17g s", h, begin);
    }
    if (take_in(f)) return FMU_ERROR;
    forget(f);
    s->slice = intermediate ? 0.0 : INFINITY;
    int status = step_to(f, begin, goal, early, intermediate, owner, step);
    hold(f);
    if (status) return status;
    step->last_time = s->t < goal ? s->t : t + h; /* as it was asked for, where it was taken to the tick beside it */
    step->returned_early = s->t < goal;
    forget(f);
    return outputs(f) ? (f->live.mode = FMU_FAILED, FMU_ERROR) : FMU_OK;
}

/* --- states of the FMU ------------------------------------------------------------------------------------------------ */

struct FmuSaved {
    size_t size;
    unsigned char bytes[];
};

/* Copy all that is saved, behind the token of the FMU. */
static void walk_all(Fmu *f, BlocksWalk *w)
{
    char token[64] = {0}, found[64];
    strncpy(token, fmu_model.token, sizeof token - 1);
    memcpy(found, token, sizeof found);
    blocks_walk(w, found, sizeof found);
    w->failed |= memcmp(found, token, sizeof found) != 0;
    blocks_walk_entries(w, f->entries, f->nentries);
    blocks_walk_run(w, f->sim);
}

static BlocksWalk over(const FmuSaved *saved, int writes)
{
    unsigned char *bytes = (unsigned char *)saved->bytes;
    return (BlocksWalk){bytes, bytes + saved->size, writes, 0, 0};
}

/* Make a state of some bytes in the place of *saved. Returns null, with a message, if there is no memory. */
static FmuSaved *sized(Fmu *f, FmuSaved **saved, size_t size)
{
    FmuSaved *made = realloc(*saved, sizeof *made + size);
    if (!made) fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "there is no memory for a state");
    else made->size = size, *saved = made;
    return made;
}

int fmu_save(Fmu *f, FmuSaved **saved)
{
    BlocksWalk w = {0};
    walk_all(f, &w);
    if (!sized(f, saved, w.count)) return FMU_ERROR;
    w = over(*saved, 0);
    int known = f->live.known;
    f->live.known = 0; /* all that is known is computed again, and equal states have equal bytes */
    walk_all(f, &w);
    f->live.known = known;
    return FMU_OK;
}

int fmu_restore(Fmu *f, const FmuSaved *saved)
{
    BlocksSim *s = f->sim;
    FmuSaved *undo = NULL;
    if (fmu_save(f, &undo)) return FMU_ERROR;
    int kind = f->live.kind;
    BlocksWalk w = over(saved, 1), back = over(undo, 1);
    walk_all(f, &w);
    int wrong = w.failed || w.at != w.end || f->live.kind != kind;
    if (wrong) walk_all(f, &back);
    fmu_forget(undo);
    configure_run(&f->setup, f->atol, &fmu_model.run, &f->live);
    s->slice = INFINITY;
    s->is_factored = 0;
    s->polynomials = f->live.has_slopes ? &f->polynomials : NULL;
    f->polynomials.t0 = f->live.slopes_at;
    f->live.known = 0;
    s->fired_events.used = 0;
    if (f->live.mode > FMU_INITIALIZATION) blocks_rows(s);
    return wrong ? fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the state is not one of such an instance of this FMU") : FMU_OK;
}

void fmu_forget(FmuSaved *saved) { free(saved); }

size_t fmu_saved_bytes(const FmuSaved *saved) { return saved->size + sizeof(uint64_t); }

int fmu_serialize(Fmu *f, const FmuSaved *saved, unsigned char *bytes, size_t size)
{
    uint64_t digest = digest_of(saved->bytes, saved->size);
    if (size < fmu_saved_bytes(saved))
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "a state takes %lu bytes", (unsigned long)fmu_saved_bytes(saved));
    memcpy(bytes, saved->bytes, saved->size);
    memcpy(bytes + saved->size, &digest, sizeof digest);
    return FMU_OK;
}

int fmu_deserialize(Fmu *f, const unsigned char *bytes, size_t size, FmuSaved **saved)
{
    uint64_t digest = 0;
    size_t taken = size < sizeof digest ? 0 : size - sizeof digest;
    if (taken) memcpy(&digest, bytes + taken, sizeof digest);
    if (!taken || digest != digest_of(bytes, taken))
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "these bytes are not those of a state, or they were changed");
    FmuSaved *made = sized(f, saved, taken);
    if (!made) return FMU_ERROR;
    memcpy(made->bytes, bytes, taken);
    return FMU_OK;
}

/* --- derivatives ------------------------------------------------------------------------------------------------------ */

/* Rates and outputs at the states and inputs of the memory. */
static void both(Fmu *f, double *out)
{
    BlocksSim *s = f->sim;
    const BlocksModel *m = f->setup.model;
    m->rates(&s->memory, s->t, s->memory.x, out);
    for (int i = 0; i < m->nx; i++) f->moved[i] = out[i];
    for (int i = 0; i < m->nx; i++) out[i] = f->moved[fmu_model.places[i]];
    m->logged(&s->memory, s->t, s->memory.x, out + m->nx);
}

/* Difference quotients in the place of derivatives that are not finite, over twice the step. */
static int completed(Fmu *f, int column)
{
    const BlocksJacobian *j = &fmu_model.jacobian;
    BlocksSim *s = f->sim;
    int nx = f->setup.model->nx, missing = 0;
    for (int k = j->first[column]; k < j->first[column + 1]; k++) missing |= !isfinite(f->data[k]);
    if (!missing) return 0;
    double *place = column < nx ? &s->memory.x[fmu_model.places[column]] : NULL, nominal = 1.0;
    if (place) {
        nominal = fmu_model.nominal[column];
    } else {
        for (int i = 0; i < fmu_model.nvariables; i++)
            if (fmu_model.variables[i].row == FMU_ROW_INPUT && fmu_model.columns_of[i] == column)
                place = &s->memory.u[fmu_model.variables[i].index];
    }
    if (!place) return 1;
    double was = *place, h = 6e-6 * fmax(fabs(was), 1e-3 * nominal);
    *place = was + h;
    double up = *place - was;
    both(f, f->above);
    *place = was - h;
    double down = was - *place;
    both(f, f->below);
    *place = was;
    for (int k = j->first[column]; k < j->first[column + 1]; k++)
        if (!isfinite(f->data[k])) f->data[k] = (f->above[j->rows[k]] - f->below[j->rows[k]]) / (up + down);
    return 1;
}

static int read_jacobian(void *reading)
{
    Fmu *f = reading;
    const BlocksJacobian *j = &fmu_model.jacobian;
    BlocksSim *s = f->sim;
    if (s->moving) blocks_outside(s, s->t);
    blocks_jacobian(j, s, s->t, s->memory.x, f->room, f->data);
    int quotients = 0;
    for (int column = 0; column < j->ncolumns; column++) quotients += completed(f, column);
    if (quotients) {
        f->live.known &= ~(OUTPUTS_KNOWN | RATES_KNOWN);
        fmu_say(f, FMU_WARNING, FMU_LOG_WARNING,
                "at t = %.17g s some derivatives are not finite: difference quotients stand there", s->t);
    }
    f->live.known |= JACOBIAN_KNOWN;
    return 0;
}

static int jacobian(Fmu *f) { return f->live.known & JACOBIAN_KNOWN ? FMU_OK : look(f, read_jacobian, f); }

int fmu_directional(Fmu *f, const uint32_t *unknowns, size_t nunknowns, const uint32_t *knowns, size_t nknowns,
                    const double *seed, double *sensitivity, int adjoint)
{
    const BlocksJacobian *j = &fmu_model.jacobian;
    int status = ready(f);
    if (status) return status;
    for (size_t k = 0; k < nunknowns; k++)
        if (unknowns[k] >= fmu_references() || fmu_model.rows_of[unknowns[k]] < 0)
            return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the value reference %u is that of no real output or derivative",
                           (unsigned)unknowns[k]);
    for (size_t k = 0; k < nknowns; k++)
        if (knowns[k] >= fmu_references() || fmu_model.columns_of[knowns[k]] < 0)
            return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the value reference %u is that of no real input or continuous state",
                           (unsigned)knowns[k]);
    if ((status = jacobian(f))) return status;
    for (size_t k = 0; k < (adjoint ? nknowns : nunknowns); k++) sensitivity[k] = 0.0;
    for (size_t k = 0; k < nknowns; k++) {
        int column = fmu_model.columns_of[knowns[k]];
        if (!adjoint && seed[k] == 0.0) continue;
        for (size_t i = 0; i < nunknowns; i++) {
            int row = fmu_model.rows_of[unknowns[i]];
            for (int at = j->first[column]; at < j->first[column + 1]; at++) {
                if (j->rows[at] != row) continue;
                if (adjoint) sensitivity[k] += f->data[at] * seed[i];
                else sensitivity[i] += f->data[at] * seed[k];
            }
        }
    }
    int bad = all_finite(sensitivity, (int)(adjoint ? nknowns : nunknowns));
    if (bad < 0) return FMU_OK;
    uint32_t culprit = adjoint ? knowns[bad] : unknowns[bad];
    return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "a derivative of or by %s is not finite at t = %.17g s", fmu_model.names[culprit],
                   f->sim->t);
}
