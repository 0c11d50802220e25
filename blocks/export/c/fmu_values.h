/* What all FMUs have in common: variables, their ranges, messages, and how equations stand at a start. It is included behind
   the definition of `struct Fmu`, with the members live, settings, log, owner and categories. */
#ifndef BLOCKS_FMU_VALUES_H
#define BLOCKS_FMU_VALUES_H

int fmu_say(Fmu *f, int status, int category, const char *format, ...)
{
    char text[600];
    va_list arguments;
    if (!f->log || !(f->categories & category)) return status;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    f->log(f->owner, status, category, text);
    return status;
}

void *fmu_owner(const Fmu *f) { return f->owner; }
int fmu_kind(const Fmu *f) { return f->live.kind; }
int fmu_mode(const Fmu *f) { return f->live.mode; }
int fmu_logs(const Fmu *f) { return f->categories; }
size_t fmu_references(void) { return (size_t)fmu_model.nvariables; }

size_t fmu_elements(uint32_t reference)
{
    return reference < fmu_references() ? (size_t)fmu_model.variables[reference].size : 0;
}

int fmu_type(uint32_t reference) { return reference < fmu_references() ? fmu_model.variables[reference].type : -1; }

size_t fmu_dependencies(uint32_t unknown, const uint32_t **references)
{
    *references = NULL;
    if (unknown >= fmu_references()) return 0;
    int32_t first = fmu_model.first_dependency[unknown];
    *references = (const uint32_t *)(const void *)(fmu_model.dependencies + first);
    return (size_t)(fmu_model.first_dependency[unknown + 1] - first);
}

static int all_finite(const double *values, int n)
{
    for (int i = 0; i < n; i++)
        if (!isfinite(values[i])) return i;
    return -1;
}

static const char *name_in(const char *const *names, int n, int i) { return i >= 0 && i < n ? names[i] : "the diagram"; }

static int is_known(Fmu *f, uint32_t reference, int type, size_t count)
{
    if (reference >= fmu_references() || count > fmu_references() - reference) {
        fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "there is no variable with the value reference %u", (unsigned)reference);
        return 0;
    }
    for (size_t k = 0; k < count; k++) {
        int own = fmu_model.variables[reference + k].type;
        if (own == type) continue;
        fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s (value reference %u) is of another type",
                fmu_model.names[reference + k], (unsigned)(reference + k));
        return 0;
    }
    return 1;
}

const char *fmu_get_string(Fmu *f, uint32_t reference)
{
    if (!is_known(f, reference, FMU_STRING, 1)) return NULL;
    return fmu_model.texts[fmu_model.variables[reference].index];
}

static int is_out_of_range(const FmuVariable *v, double value)
{
    if (value < v->low || value > v->high) return 1;
    if ((v->low_open && value == v->low) || (v->high_open && value == v->high)) return 1;
    if (v->type == FMU_BOOLEAN) return value != 0.0 && value != 1.0;
    if (v->type == FMU_INTEGER) return value != nearbyint(value) || fabs(value) > 9007199254740992.0;
    if (v->type == FMU_ENUMERATION) {
        for (int i = 0; i < v->nmembers; i++)
            if (fmu_model.members[v->first_member + i] == value) return 0;
        return 1;
    }
    return 0;
}

static int out_of_range(Fmu *f, const FmuVariable *v, const char *name, double value)
{
    const char *how = v->variability == FMU_CALCULATED ? ", which follows from what was set," : "";
    if (v->type == FMU_BOOLEAN || v->type == FMU_ENUMERATION || (value >= v->low && value <= v->high && v->type != FMU_REAL))
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s = %.17g%s is none of its values", name, value, how);
    return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s = %.17g%s is out of its range, which is %c%g, %g%c", name, value, how,
                   v->low_open || isinf(v->low) ? '(' : '[', v->low, v->high, v->high_open || isinf(v->high) ? ')' : ']');
}

/* The parameters p by what was set. An error, with a message, where a bound one is then out of its range. */
static int bound(Fmu *f, double *p)
{
    fmu_model.bind(f->settings, p);
    for (int i = 0; i < fmu_model.nvariables; i++) {
        const FmuVariable *v = &fmu_model.variables[i];
        if (v->row != FMU_ROW_SETTING || v->variability != FMU_CALCULATED) continue;
        double value = f->settings[v->index];
        if (!isfinite(value) || is_out_of_range(v, value))
            return out_of_range(f, v, fmu_model.names[i], value);
    }
    return FMU_OK;
}

/* Why an element may not be set now; null where it may. */
static const char *forbidden(const Fmu *f, const FmuVariable *v)
{
    int mode = f->live.mode, before = FMU_INSTANTIATED | FMU_INITIALIZATION;
    if (v->row == FMU_ROW_INPUT) {
        int always = before | FMU_EVENT | FMU_STEP | FMU_INTERMEDIATE;
        if (v->type == FMU_REAL) always |= FMU_CONTINUOUS | FMU_ASKING;
        return mode & always ? NULL : "cannot be set now";
    }
    if (v->row != FMU_ROW_SETTING) return "is computed, and cannot be set";
    if (v->variability == FMU_CALCULATED) return "is bound to other parameters, and cannot be set itself";
    if (v->variability == FMU_CONSTANT) return "is a constant of the FMU";
    if (v->variability == FMU_FIXED) return mode & before ? NULL : "is fixed once the simulation has begun";
    return mode & (before | FMU_EVENT | FMU_STEP) ? NULL : "cannot be set now";
}

int fmu_check(Fmu *f, uint32_t reference, int type, const double *values, size_t count)
{
    if (!is_known(f, reference, type, count)) return FMU_ERROR;
    for (size_t k = 0; k < count; k++) {
        const FmuVariable *v = &fmu_model.variables[reference + k];
        const char *why = forbidden(f, v), *name = fmu_model.names[reference + k];
        if (why) return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s %s", name, why);
        if (!isfinite(values[k])) return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s cannot be set to %g", name, values[k]);
        if (is_out_of_range(v, values[k])) return out_of_range(f, v, name, values[k]);
    }
    return FMU_OK;
}

static int has_size(Fmu *f, size_t n, size_t needed, const char *what)
{
    if (n == needed) return 1;
    fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "there are %lu %s, not %lu", (unsigned long)needed, what, (unsigned long)n);
    return 0;
}

/* FNV-1a: as bytes, a state ends with it, so that one that was damaged on its way is not taken in. */
static uint64_t digest_of(const unsigned char *bytes, size_t size)
{
    uint64_t made = 14695981039346656037u;
    for (size_t i = 0; i < size; i++) made = (made ^ bytes[i]) * 1099511628211u;
    return made;
}

/* Why there is no instance; null where there can be one. */
static const char *why_no_instance(int kind, const char *name, const char *token)
{
    if (!name || !name[0]) return "an instance needs a name";
    if (!token || strcmp(token, fmu_model.token)) return "the token is not that of this FMU: the description is another one's";
    return fmu_model.kinds & kind ? NULL : "the FMU was not exported for this kind of simulation";
}

/* Whether it was told what is wrong with the times and the tolerance of an experiment. */
static int wrong_times(Fmu *f, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    int wrong = FMU_OK;
    if (!isfinite(start) || fabs(start) > 1e15)
        wrong = fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the start time cannot be %g", start);
    else if (has_stop && !(stop >= start))
        wrong = fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the stop time %g lies before the start", stop);
    else if (has_tolerance && !(tolerance >= 1e-13 && tolerance < 1))
        wrong = fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the tolerance %g is not in [1e-13, 1)", tolerance);
    return wrong != FMU_OK;
}

static void begin_experiment(Live *live, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    live->has_tolerance = has_tolerance;
    live->tolerance = tolerance;
    live->start = live->slopes_at = start;
    live->has_stop = has_stop;
    live->stop = stop;
    live->known = 0;
    live->mode = FMU_INITIALIZATION;
}

/* Whether it was told why there is no step from t to t + h, where the FMU stands at `now`. */
static int wrong_step_from(Fmu *f, double now, double t, double h)
{
    const Live *live = &f->live;
    int wrong = FMU_OK;
    double size = blocks_larger(fabs(t), fabs(now));
    if (!isfinite(t) || !isfinite(h))
        wrong = fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "a step from t = %g of %g s cannot be made", t, h);
    else if (!(h > 0))
        wrong = fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "a communication step must be longer than 0, not %g s", h);
    else if (fabs(t - now) > 1e-9 * size + 1e-12)
        wrong = fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the communication point is t = %.17g s, but the FMU stands at %.17g s", t, now);
    else if (live->has_stop && t + h > live->stop + 1e-9 * (fabs(live->stop) + h))
        wrong = fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the step to t = %.17g s goes beyond the stop time %.17g s", t + h, live->stop);
    return wrong != FMU_OK;
}

/* --- runs of equations -------------------------------------------------------------------------------------------- */

/* Let a grid begin at another start: as a decimal of few digits, which it is nearly always; else to 1e-9 of a step. */
static void begin_grid_at(BlocksGrid *grid, double start)
{
    int64_t power = 1;
    if (!grid->is_given) return;
    while (power < 1000000000 && (double)grid->unit * (double)power < 1e15 / fmax(1.0, fabs(start))
           && !blocks_within_ulps(start * (double)power, nearbyint(start * (double)power), 0.0))
        power *= 10;
    grid->start = (int64_t)nearbyint(start * (double)power) * grid->unit;
    grid->step *= power;
    grid->unit *= power;
    grid->is_plain = fabs((double)grid->start) < 1e15 && (double)grid->unit < 1e15 && (double)grid->step < 1e9;
}

/* What follows from the experiment: the tolerances, the longest step, the grid of steps. */
static void configure_run(BlocksSetup *setup, double *atol, const FmuRun *run, const Live *live)
{
    double share = live->has_tolerance ? live->tolerance / run->rtol : 1.0;
    double length = live->has_stop && live->stop > live->start ? live->stop - live->start : run->length;
    setup->rtol = live->has_tolerance ? live->tolerance : run->rtol;
    setup->plain_atol = run->plain_atol * share;
    for (int i = 0; i < run->nstates; i++) atol[i] = run->atol[i] * share;
    setup->longest = length / (run->nstates ? 50 : 1000);
    setup->start = live->start;
    setup->end = live->has_stop ? live->stop : NAN;
    setup->fixed = run->setup->fixed;
    if (live->start != run->start) begin_grid_at(&setup->fixed, live->start);
}

/* By how much the end of a communication step of h s may miss a tick: an importer that adds up n steps rounds n times,
   each time by half an ulp of t at most. A small part of the step, or another tick could be meant. */
static double drift(const Live *live, double t, double h)
{
    return fmin((4.0 + 0.5 * (double)live->steps) * blocks_ulp(t), 1e-3 * h);
}

/* Whether t means this point of time: it is some ulp away, or what an importer's sum of steps may miss it by. */
static int means(const BlocksSim *s, double point, double t, double miss)
{
    return fabs(point - t) <= miss || blocks_within_ulps(point, t, s->scale);
}

/* Find the tick of a rate that t means: its count in base steps. Return 0 if there is none. */
static int tick_at(const BlocksSim *s, double t, double miss, int64_t *count)
{
    const BlocksSetup *setup = s->setup;
    for (int r = 0; r < setup->model->nrates; r++) {
        const BlocksRate *rate = &setup->rates[r];
        int64_t next = rate->offset + s->ticks[r] * rate->period;
        if (means(s, blocks_tick_time(s, next), t, miss)) { /* mostly it is this one */
            *count = next;
            return 1;
        }
        double base = (double)setup->base_numerator / (double)setup->base_denominator;
        double number = nearbyint((t / base - (double)rate->offset) / (double)rate->period);
        if (!(number >= 0 && number < 9e15)) continue;
        int64_t at = rate->offset + (int64_t)number * rate->period;
        if (means(s, blocks_tick_time(s, at), t, miss)) {
            *count = at;
            return 1;
        }
    }
    return 0;
}

/* Check whether a rate that has a tick at this count of base steps has not done it yet. */
static int is_ahead(const BlocksSim *s, int64_t count)
{
    for (int r = 0; r < s->setup->model->nrates; r++) {
        const BlocksRate *rate = &s->setup->rates[r];
        int64_t since = count - rate->offset;
        if (since % rate->period == 0 && since / rate->period >= s->ticks[r]) return 1;
    }
    return 0;
}

/* The instance stands at t, exactly at a tick where one is near. A tick that has happened does not count: what has crossed
   since then has not crossed at its time. */
static void stand_at(BlocksSim *s, double t)
{
    int64_t count = 0;
    s->exact = tick_at(s, t, 0.0, &count) && is_ahead(s, count);
    s->count = count;
    s->t = s->exact ? blocks_tick_time(s, count) : t;
}

/* A run that was reset stands at the start, with what its equations begin with; `blocks_begin` follows. */
static int stand_at_start(Fmu *f, BlocksSim *s, const FmuRun *run)
{
    const BlocksSetup *setup = s->setup;
    stand_at(s, f->live.start);
    s->broken = s->t;
    for (int r = 0; r < setup->model->nrates; r++) {
        const BlocksRate *rate = &setup->rates[r];
        double base = (double)setup->base_numerator / (double)setup->base_denominator;
        double number = floor((s->t / base - (double)rate->offset) / (double)rate->period) - 1;
        if (number > 9e15 / (double)rate->period)
            return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "t = %g s is too late for ticks every %g s", s->t,
                           base * (double)rate->period);
        int64_t n = number > 0 ? (int64_t)number : 0;
        while (blocks_tick_time(s, rate->offset + n * rate->period) < s->t) n++;
        s->ticks[r] = n;
    }
    memcpy(s->memory.z, run->guesses, (size_t)setup->model->nz * sizeof(double));
    for (int j = 0; j < setup->model->ns; j++) {
        s->memory.s[j] = run->sides_given[j] ? run->sides[j] : 0.0;
        s->located[j] = run->sides_given[j];
    }
    s->crossing = run->is_whole;
    return FMU_OK;
}

/* A state that is not finite, or whose derivative is not, by its place in the model; -1: there is none. */
static int bad_state(BlocksSim *s, double *rates)
{
    int n = s->model->nx;
    blocks_evaluate(s, s->setup->model->rates, s->t, s->memory.x, rates);
    for (int i = 0; i < n; i++)
        if (!isfinite(s->memory.x[i]) || !isfinite(rates[i])) return i;
    return -1;
}

/* The state that a step of h failed at: the first that is not finite within it (1 in *is_bad), else the one that moves
   most by its tolerance. */
static int failed_state(BlocksSim *s, double h, double *rates, int *is_bad)
{
    const BlocksModel *m = s->setup->model;
    const double *x = s->memory.x;
    int worst = bad_state(s, rates);
    double most = -1.0;
    *is_bad = 1;
    if (worst >= 0) return worst;
    m->trial(s, s->t, x, h, s->x2, 0);
    for (int j = 1; j < m->stages; j++)
        for (int i = 0; i < m->nx; i++)
            if (!isfinite(s->k[j][i])) return i;
    for (int i = 0; i < m->nx; i++)
        if (!isfinite(s->x2[i])) return i;
    *is_bad = 0;
    for (int i = 0; i < m->nx; i++) {
        double moved = fabs(s->x2[i] - x[i]) / (s->setup->atol[i] + s->setup->rtol * fabs(x[i]));
        if (moved > most) most = moved, worst = i;
    }
    return worst;
}

/* Tells what stopped the numbers. rates: (nx + ns) scratch. */
static int tell_failure(Fmu *f, BlocksSim *s, const FmuRun *names, double *rates)
{
    const BlocksModel *model = s->setup->model;
    int what = s->failure, culprit = s->culprit, nevents = model->nevents, ncauses = s->setup->ncauses;
    double t = s->t, value = s->value;
    const char *state = NULL;
    int is_bad = 1;
    switch (what) {
    case -1: return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "at t = %.17g s there is no memory left", t);
    case BLOCKS_BLOWN_UP:
    case BLOCKS_TOO_SMALL:
        culprit = failed_state(s, value, rates, &is_bad);
        state = culprit < 0 ? "a state" : name_in(names->state_names, names->nstates, culprit);
        if (what == BLOCKS_BLOWN_UP)
            return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s is not finite after a step of %g s from t = %.17g s", state,
                           value, t);
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "at t = %.17g s the step became too small: %s %s", t, state,
                       is_bad ? "is not finite after it" : "moves too fast for the tolerance");
    case BLOCKS_NOT_CONVERGED:
        culprit = bad_state(s, rates);
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "at t = %.17g s the step of the stiff method became too small%s%s", t,
                       culprit < 0 ? "" : ": not finite is ",
                       culprit < 0 ? "" : name_in(names->state_names, names->nstates, culprit));
    case BLOCKS_NOT_A_NUMBER:
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the crossing %s is not a number after t = %.17g s",
                       name_in(names->cause_names, ncauses, culprit), t);
    case BLOCKS_ENDLESS:
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "at t = %.17g s events fire each other without end", t);
    case BLOCKS_NOT_AHEAD:
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "at t = %.17g s the next event time of %s is %.17g s, which is not ahead",
                       t, name_in(names->cause_names, ncauses, ncauses - nevents + culprit), value);
    case BLOCKS_UNSOLVED:
        return fmu_say(f, FMU_ERROR, FMU_LOG_NONLINEAR | FMU_LOG_ERROR,
                       "an algebraic loop has no solution that can be found after t = %.17g s", t);
    case BLOCKS_NOT_WHOLE:
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s would become %.17g at t = %.17g s, which it cannot hold",
                       name_in(names->discrete_names, model->nd, culprit), value, t);
    case BLOCKS_ZENO:
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s fires ever faster at t = %.17g s: Zeno or chattering",
                       name_in(names->cause_names, ncauses, culprit), t);
    case BLOCKS_CHANGES_ALWAYS:
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "at t = %.17g s what is replaced after each step changes with each step", t);
    default:
        culprit = bad_state(s, rates);
        state = culprit < 0 ? "a value" : name_in(names->state_names, names->nstates, culprit);
        for (int i = 0; culprit < 0 && i < model->nd; i++)
            if (!isfinite(s->d1[i])) culprit = i, state = name_in(names->discrete_names, model->nd, i);
        for (int a = 0; culprit < 0 && a < ncauses; a++)
            for (int i = 0; s->firing[a] && i < s->setup->causes[a].nresets; i++)
                if (!isfinite(s->reset_values[s->setup->causes[a].first_reset + i]))
                    culprit = i, state = name_in(names->cause_names, ncauses, a);
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s is not finite at or after t = %.17g s", state, t);
    }
}

#endif
