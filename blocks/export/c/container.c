/* One instance of an exported diagram with FMUs in it; see fmu.h. The numbers are those of the master: what a run of the
   diagram computes, an instance computes between and at its communication points. FMUs inside are code of this one: nothing
   of them runs before an instance is made, and one that crashes ends the importer's process. */
#include "container.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* BEGUN: FMUs inside are in initialization mode, or further. SHOWN: outputs are those of the present inputs. */
enum { BEGUN = 1, SHOWN = 2 };

typedef struct {
    BlocksSetup setup; /* first: a run knows its island by it */
    BlocksSim *sim;
    Fmu *owner;
    const ContainerIsland *what;
    BlocksTrack track;
    double always, *row, *atol, *rates;
    BlocksForeigns foreigns; /* its FMUs for Model Exchange */
    InnerFmu **inner;
    double *numbers; /* what C computes with for these */
} Island;

struct Fmu {
    Live live;
    int64_t generation; /* how often the FMUs inside were made */
    int has_begun;      /* whether they have left the mode in which they were made */
    double *settings, *input, *parameters, *outputs, *locals, always;
    BlocksTrack track;
    Island *islands;
    InnerFmu **fmus;
    Master master;
    char *resources;
    FmuSaved *saved;    /* all states that are not forgotten */
    BlocksTrace *trace; /* of all FMUs inside, from when it was first asked for */
    FmuLog log;
    void *owner;
    int categories;
};

#include "fmu_values.h"

/* --- life --------------------------------------------------------------------------------------------------------------- */

static BlocksTrace *tracing(const Fmu *f) { return f->categories & FMU_LOG_TRACE ? f->trace : NULL; }

/* Those that have left initialization mode, and have not failed. */
static void terminate_foreigns(Island *island)
{
    for (int i = 0; island->inner && i < island->foreigns.n; i++) {
        const BlocksForeign *unit = &island->foreigns.units[i];
        if (!island->inner[i] || island->owner->live.mode == FMU_TERMINATED) continue;
        if (unit->status == 4) inner_fail(island->inner[i], 1);
        if (unit->mode == BLOCKS_INITIALIZES || unit->status) continue;
        inner_started(island->inner[i]);
        inner_terminate(island->inner[i]);
    }
}

static void unload_foreigns(Island *island)
{
    terminate_foreigns(island);
    for (int i = 0; island->inner && i < island->foreigns.n; i++) {
        inner_free(island->inner[i]);
        island->inner[i] = NULL;
        island->foreigns.units[i].mode = BLOCKS_INITIALIZES;
    }
}

/* New instances of the FMUs for Model Exchange of an island, in initialization mode. Returns 1, after a message, where one fails. */
static int begin_foreigns(Island *island)
{
    Fmu *f = island->owner;
    const ContainerIsland *what = island->what;
    const Live *live = &f->live;
    const double *p = island->sim->memory.p;
    double *at = island->numbers;
    unload_foreigns(island);
    for (int i = 0; i < what->nforeigns; i++) {
        const ContainerForeign *from = &what->foreigns[i];
        BlocksForeign *to = &island->foreigns.units[i];
        if (!(island->inner[i] = inner_new(f, &from->fmu, f->resources, tracing(f)))) return 1;
        if (inner_begin(island->inner[i], p, live->has_tolerance, live->tolerance, live->start, live->has_stop, live->stop)) return 1;
        *to = from->table;
        const int nx = to->nx, nu = to->nu;
        double **const rows[] = {&to->x, &to->u, &to->had, &to->seen, &to->given, &to->followed, &to->raw, &to->values};
        const int sizes[] = {nx, nu, nu, nu, nu, to->nwatched, from->room, from->room};
        for (int k = 0; k < 8; at += sizes[k], k++) {
            *rows[k] = at;
            for (int j = 0; j < sizes[k]; j++) at[j] = k < 6 ? NAN : 0.0;
        }
        to->lags = (int32_t *)(void *)at;
        memset(at, 0, (size_t)to->nwatched * sizeof(double));
        at += to->nwatched;
        inner_connect_foreign(island->inner[i], to);
        to->mode = BLOCKS_INITIALIZES;
        to->t = live->start;
        to->next_event = INFINITY;
        for (int k = 0; k < to->ntunables; k++) to->u[nu - to->ntunables + k] = to->had[nu - to->ntunables + k] = p[to->tunables[k]];
    }
    return 0;
}

/* Start a run of equations with the inputs in its row; the master calls it. */
static int stand(void *component)
{
    BlocksSim *s = component;
    Island *island = (Island *)(void *)s->setup;
    blocks_reset(s);
    if (island->what->nforeigns && begin_foreigns(island)) return 1;
    s->slice = INFINITY;
    s->polynomials = NULL;
    return stand_at_start(island->owner, s, &island->what->run) || blocks_begin(s);
}

static void close_master(Fmu *f)
{
    Master *m = &f->master;
    for (int i = 0; f->fmus && m->owned && i < container.nfmus; i++)
        for (int whose = 0; f->fmus[i] && whose < 2; whose++) inner_free_state(f->fmus[i], &m->units[container.fmus[i].unit].saved[whose]);
    master_close(m);
}

static void forget_inner_states(Fmu *f);

static void unload_fmus(Fmu *f)
{
    forget_inner_states(f);
    close_master(f);
    for (int i = 0; f->fmus && i < container.nfmus; i++) {
        if (f->fmus[i]) inner_terminate(f->fmus[i]);
        inner_free(f->fmus[i]);
        f->fmus[i] = NULL;
    }
    f->generation++;
    f->has_begun = 0;
}

static int load_fmus(Fmu *f)
{
    unload_fmus(f);
    for (int i = 0; i < container.nfmus; i++)
        if (!(f->fmus[i] = inner_new(f, &container.fmus[i], f->resources, tracing(f)))) return FMU_ERROR;
    return FMU_OK;
}

static int open_foreigns(Island *island)
{
    const ContainerIsland *what = island->what;
    size_t n = (size_t)what->ntaken + 1;
    for (int i = 0; i < what->nforeigns; i++) {
        const ContainerForeign *one = &what->foreigns[i];
        n += (size_t)(one->table.nx + 4 * one->table.nu + 2 * one->table.nwatched + 2 * one->room);
    }
    if (!what->nforeigns) return 0;
    island->inner = calloc((size_t)what->nforeigns, sizeof *island->inner);
    island->foreigns.units = calloc((size_t)what->nforeigns, sizeof *island->foreigns.units);
    island->foreigns.taken = calloc(n, sizeof(double));
    if (!island->inner || !island->foreigns.units || !island->foreigns.taken) return 1;
    island->foreigns.n = what->nforeigns;
    island->numbers = island->foreigns.taken + what->ntaken;
    island->sim->memory.f = &island->foreigns;
    return 0;
}

static int open_islands(Fmu *f)
{
    for (int i = 0; i < container.nislands; i++) {
        Island *island = &f->islands[i];
        const ContainerIsland *what = island->what = &container.islands[i];
        const BlocksModel *model = what->run.setup->model;
        island->owner = f;
        island->setup = *what->run.setup;
        island->row = calloc((size_t)(model->nu + what->run.nstates + model->nx + model->ns) + 1, sizeof(double));
        if (!island->row) return 1;
        island->atol = island->row + model->nu;
        island->rates = island->atol + what->run.nstates;
        island->always = -INFINITY;
        island->track = (BlocksTrack){&island->always, island->row, 1, model->nu, 0};
        island->setup.tracks = &island->track;
        island->setup.ntracks = model->nu > 0;
        island->setup.atol = island->atol;
        if (!(island->sim = blocks_new(&island->setup))) return 1;
        if (open_foreigns(island)) return 1;
        island->sim->keeps_past = 1;
        island->sim->memory.n = what->run.numbers;
        island->sim->memory.c = what->run.tables;
        if (model->np) memcpy(island->sim->memory.p, what->run.parameters, (size_t)model->np * sizeof(double));
    }
    return 0;
}

static char *copied(const char *text)
{
    char *made = text ? malloc(strlen(text) + 1) : NULL;
    return made ? strcpy(made, text) : NULL;
}

Fmu *fmu_new(int kind, const char *name, const char *token, const char *resources, FmuLog log, void *owner)
{
    const FmuModel *model = &fmu_model;
    const char *why = why_no_instance(kind, name, token);
    Fmu *f = why ? NULL : calloc(1, sizeof *f);
    if (f) {
        const size_t nu = model->ninputs;
        f->log = log;
        f->owner = owner;
        f->categories = FMU_LOG_ERROR;
        f->live.kind = kind;
        f->resources = copied(resources);
        f->settings = calloc((size_t)model->nsettings + (size_t)container.nparameters + nu + (size_t)model->noutputs + (size_t)model->nlocals + 1, sizeof(double));
        f->islands = calloc((size_t)container.nislands + 1, sizeof *f->islands);
        f->fmus = calloc((size_t)container.nfmus + 1, sizeof *f->fmus);
        why = "there is no memory for an instance";
        if (f->settings && f->islands && f->fmus) {
            f->parameters = f->settings + model->nsettings;
            f->input = f->parameters + container.nparameters;
            f->outputs = f->input + nu;
            f->locals = f->outputs + model->noutputs;
            f->always = -INFINITY;
            f->track = (BlocksTrack){&f->always, f->input, 1, (int32_t)nu, 0};
            if (!open_islands(f)) {
                why = NULL;
                if (fmu_reset(f)) { /* after a message that says why */
                    fmu_free(f);
                    return NULL;
                }
            }
        }
    }
    if (!why) return f;
    fmu_free(f);
    if (log) log(owner, FMU_ERROR, FMU_LOG_ERROR, why);
    return NULL;
}

void fmu_free(Fmu *f)
{
    if (!f) return;
    unload_fmus(f);
    for (int i = 0; f->islands && i < container.nislands; i++) {
        unload_foreigns(&f->islands[i]);
        free(f->islands[i].inner);
        free(f->islands[i].foreigns.units);
        free(f->islands[i].foreigns.taken);
        blocks_free(f->islands[i].sim);
        free(f->islands[i].row);
    }
    if (f->trace) blocks_trace_free(f->trace);
    free(f->islands);
    free(f->fmus);
    free(f->settings);
    free(f->resources);
    free(f);
}

int fmu_reset(Fmu *f)
{
    const FmuModel *model = &fmu_model;
    const int kind = f->live.kind;
    int status = load_fmus(f);
    memset(&f->live, 0, sizeof f->live);
    f->live.kind = kind;
    f->live.mode = FMU_INSTANTIATED;
    f->live.start = model->run.start;
    memcpy(f->settings, model->settings, (size_t)model->nsettings * sizeof(double));
    memcpy(f->input, model->inputs, (size_t)model->ninputs * sizeof(double));
    return status;
}

void fmu_set_mode(Fmu *f, int mode)
{
    for (int i = 0; mode == FMU_TERMINATED && i < container.nfmus; i++) inner_terminate(f->fmus[i]);
    for (int i = 0; mode == FMU_TERMINATED && i < container.nislands; i++) terminate_foreigns(&f->islands[i]);
    f->live.mode = mode;
}

double fmu_time(const Fmu *f) { return f->live.mode <= FMU_INITIALIZATION ? f->live.start : f->master.t; }

/* --- failures --------------------------------------------------------------------------------------------------------------- */

static const ContainerFmu *fmu_of(int unit)
{
    for (int i = 0; i < container.nfmus; i++)
        if (container.fmus[i].unit == unit) return &container.fmus[i];
    return NULL;
}

/* A call of the master as words: "motor: fmi3SetFloat64 (v, load)". */
static const char *call_text(char *text, size_t size, int unit, int function)
{
    const ContainerFmu *what = fmu_of(unit);
    if (!what) snprintf(text, size, "%s", container.units[unit]);
    else if (function >= 0) snprintf(text, size, "%s: %s", what->name, container_calls[what->fmi - 2][function]);
    else snprintf(text, size, "%s: %s (%s)", what->name, container.moves[-1 - function], container.moved[-1 - function]);
    return text;
}

/* The FMU for Model Exchange that stopped an island; null: none did. */
static BlocksForeign *stopped_by(Fmu *f, const char **name)
{
    const Master *m = &f->master;
    for (int i = 0; i < container.nislands && m->failure; i++) {
        Island *island = &f->islands[i];
        for (int k = 0; container.islands[i].unit == m->unit && k < island->foreigns.n; k++) {
            *name = container.islands[i].foreigns[k].fmu.name;
            if (island->foreigns.units[k].status) return &island->foreigns.units[k];
        }
    }
    return NULL;
}

/* Whether an FMU for Model Exchange inside has ended the run: at the last communication point, and that is no failure. */
static int is_ended_inside(Fmu *f)
{
    const char *name;
    const BlocksForeign *one = f->master.failure == MASTER_SIMULATION ? stopped_by(f, &name) : NULL;
    return one && one->status == BLOCKS_ENDS;
}

static int foreign_failed(Fmu *f, const BlocksForeign *one, const char *name)
{
    static const char *const what[] = {"ended the run", "does not end its event iteration", "has a state that is not finite after an event",
                                       "discards the end of an accepted step"};
    static const char *const words[] = {"ok", "a warning", "discard", "an error", "a fatal error"};
    if (one->status >= BLOCKS_ENDS)
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s: %s at t = %.17g s", name, what[one->status - BLOCKS_ENDS], one->t);
    const int is_set = one->call >= BLOCKS_SET, is_get = one->call >= BLOCKS_GET && !is_set;
    return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s: fmi%d%s%s returned %s at t = %.10g s", name, one->fmi, is_set ? "Set" : is_get ? "Get" : "",
                   is_set || is_get ? container_types[one->fmi - 2][one->call % 100] : container_foreign_calls[one->fmi - 2][one->call] + 4,
                   one->status >= 0 && one->status <= 4 ? words[one->status] : "a status that does not exist", one->t);
}

/* Tells what stopped the master, and stands in FMU_FAILED. */
static int failed(Fmu *f)
{
    static const char *const words[] = {"ok", "a warning", "discard", "an error", "a fatal error", "pending"};
    const Master *m = &f->master;
    char call[400] = "";
    const double t = m->failed_t, value = m->value;
    const int unit = m->unit, what = m->failure;
    f->live.mode = FMU_FAILED;
    f->live.known = 0;
    if (what == MASTER_SIMULATION || what == MASTER_NOT_BEGUN) {
        const char *name = "";
        const BlocksForeign *one = stopped_by(f, &name);
        if (one) return foreign_failed(f, one, name);
        for (int i = 0; i < container.nislands; i++)
            if (container.islands[i].unit == unit && f->islands[i].sim->failure)
                return tell_failure(f, f->islands[i].sim, &container.islands[i].run, f->islands[i].rates);
        return FMU_ERROR; /* it was told */
    }
    if (what == MASTER_STATUS || what == MASTER_STUCK || what == MASTER_TOO_EARLY || what == MASTER_PENDING || what == MASTER_ENDLESS_UPDATES)
        call_text(call, sizeof call, unit, m->function);
    switch (what) {
    case MASTER_STATUS:
        for (int i = 0; i < container.nfmus; i++)
            if (container.fmus[i].unit == unit) inner_fail(f->fmus[i], m->status == 4);
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s returned %s at t = %.10g s", call,
                       m->status >= 0 && m->status <= 5 ? words[m->status] : "a status that does not exist", t);
    case MASTER_STUCK:
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s discarded the step from t = %.10g s, and each shorter one that was tried", call, value);
    case MASTER_TOO_EARLY:
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s ended early, at %.10g s, although early return was not allowed", call, value);
    case MASTER_PENDING: return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s stayed pending for %g s at t = %.10g s", call, m->patience, t);
    case MASTER_ENDLESS_UPDATES:
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s: the event iteration at t = %.17g s does not end", call, t);
    case MASTER_NOT_FINITE: return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s is %g at t = %.17g s", container.output_names[unit], value, t);
    case MASTER_NO_CONVERGENCE:
        return fmu_say(f, FMU_ERROR, FMU_LOG_NONLINEAR | FMU_LOG_ERROR,
                       "the step from t = %.17g s to %.17g s did not converge in %d iterations", t, value, m->iterations);
    case MASTER_UNSOLVED:
        return fmu_say(f, FMU_ERROR, FMU_LOG_NONLINEAR | FMU_LOG_ERROR,
                       "at t = %.17g s no values were found that solve the algebraic loop through %s", value,
                       container.elements[m->loops[unit].elements[0]]);
    case MASTER_ENDLESS: return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "at t = %.17g s events inside cause each other without end", t);
    case MASTER_ENDLESS_STOPS:
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s stops again and again at t = %.17g s, because its inputs change with each step",
                       container.units[unit], value);
    case MASTER_TOO_SMALL:
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "at t = %.17g s the communication step fell to %.3g s, and the error of %s still exceeds the tolerance",
                       t, value, container.elements[m->function]);
    default: return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "at t = %.17g s there is no memory left", t);
    }
}

/* Return FMU_WARNING, after a message, where FMUs inside gave a warning since the last look. */
static int warned(Fmu *f)
{
    int any = FMU_OK;
    char call[400];
    for (int k = 0; k < f->master.nunits; k++) {
        MasterUnit *u = &f->master.units[k];
        if (u->refused)
            fmu_say(f, FMU_WARNING, FMU_LOG_WARNING, "%s refuses input derivatives of order %d at t = %.10g s: its inputs go in %s",
                    container.units[k], u->takes + 1, u->refused_t, u->takes ? "as straight lines" : "by their mean over each step");
        u->refused = 0;
        if (!u->warnings) continue;
        u->warnings = 0;
        any = fmu_say(f, FMU_WARNING, FMU_LOG_WARNING, "%s returned a warning at t = %.10g s",
                      call_text(call, sizeof call, k, u->warned), u->warned_t);
    }
    return any;
}

/* --- the begin ---------------------------------------------------------------------------------------------------------------- */

/* The functions of the FMUs inside, for the master that is open. */
static int connect(Fmu *f)
{
    Master *m = &f->master;
    int wrong = FMU_OK;
    for (int i = 0; i < container.nfmus && !wrong; i++) {
        InnerFmu *in = f->fmus[i];
        const int unit = container.fmus[i].unit;
        MasterUnit *u = &m->units[unit];
        wrong = inner_connect(in, u) || inner_connect_groups(in, u->sets, u->nsets, "Set")
                || inner_connect_groups(in, u->fed, u->nfed, "Set") || inner_connect_groups(in, u->gets, u->ngets, "Get");
        for (int k = 0; k < m->nstages && !wrong; k++)
            if (m->stages[k].unit == unit) wrong = inner_connect_groups(in, m->stages[k].sets, m->stages[k].nsets, "Set");
    }
    if (!wrong) master_connect(m);
    return wrong ? FMU_ERROR : FMU_OK;
}

/* A call, and those within it: a message for each line. */
static void tell_calls(void *owner, const char *lines)
{
    Fmu *f = owner;
    for (const char *end; (end = strchr(lines, '\n')); lines = end + 1)
        fmu_say(f, FMU_OK, FMU_LOG_TRACE, "%.*s", (int)(end - lines), lines);
}

/* Errors are told always: who does not ask for messages needs these most. */
void fmu_log_categories(Fmu *f, int categories)
{
    const int was_traced = f->categories & FMU_LOG_TRACE, is_traced = categories & FMU_LOG_TRACE;
    f->categories = categories | FMU_LOG_ERROR;
    if (is_traced && !f->trace) f->trace = blocks_trace_new(NULL, 0, 0, 0, tell_calls, f);
    if (was_traced == is_traced) return;
    for (int i = 0; i < container.nfmus; i++)
        if (f->fmus[i]) inner_trace(f->fmus[i], tracing(f));
    for (int i = 0; i < container.nislands; i++)
        for (int k = 0; k < f->islands[i].foreigns.n; k++) {
            InnerFmu *in = f->islands[i].inner[k];
            if (in) inner_trace(in, tracing(f));
            if (in) inner_connect_foreign(in, &f->islands[i].foreigns.units[k]);
        }
    if (f->master.owned) connect(f);
}

int fmu_has_traces(void) { return 1; }

/* The master by the experiment, with the instances that there are. */
static int open_master(Fmu *f)
{
    Master *m = &f->master;
    const Live *live = &f->live;
    double shortest = INFINITY;
    close_master(f);
    *m = *container.master;
    MasterUnit *units = malloc((size_t)m->nunits * sizeof *units);
    int wrong = !units;
    if (units) memcpy(units, m->units, (size_t)m->nunits * sizeof *units);
    for (int k = 0; units && k < m->nunits; k++) {
        if (live->start != fmu_model.run.start) begin_grid_at(&units[k].grid, live->start);
        shortest = fmin(shortest, units[k].step);
    }
    for (int i = 0; units && i < container.nislands; i++) {
        Island *island = &f->islands[i];
        MasterUnit *u = &units[container.islands[i].unit];
        configure_run(&island->setup, island->atol, &container.islands[i].run, live);
        u->component = island->sim;
        u->track = island->row;
        u->stand = stand;
#define CALL_OF(name)                                                                                                  \
    do {                                                                                                               \
        void (*function)(void) = (void (*)(void))blocks_##name;                                                        \
        memcpy(&u->calls[CALL_##name], &function, sizeof function);                                                    \
    } while (0)
        CALL_OF(proceed);
        CALL_OF(settle);
        CALL_OF(is_due);
        CALL_OF(logged);
        CALL_OF(reload);
        CALL_OF(next);
    }
    if (wrong) return FMU_ERROR;
    m->units = units;
    m->tracks = &f->track;
    m->ntracks = fmu_model.ninputs > 0;
    m->t = live->start;
    m->end = live->has_stop ? live->stop : NAN;
    if (live->start != fmu_model.run.start) begin_grid_at(&m->every, live->start);
    if (live->has_stop && live->stop > live->start) {
        m->span = live->stop - live->start;
        m->least_step = fmin(1e-12 * m->span, 1e-6 * shortest);
    }
    if (live->has_tolerance) m->noise = 10 * live->tolerance;
    m->is_silent = 1;
    m->slice = m->soft = INFINITY;
    m->patience = 10.0;
    m->most_bytes = 0.0;
    wrong = master_open(m);
    free(units);
    if (wrong) return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "there is no memory for the master");
    return connect(f);
}

/* Up to initialization mode of all FMUs inside, with all that was set. */
static int begin(Fmu *f)
{
    const Live *live = &f->live;
    if (live->known & BEGUN) return FMU_OK;
    if (f->has_begun && load_fmus(f)) return FMU_ERROR;
    if (bound(f, f->parameters)) return FMU_ERROR;
    f->has_begun = 1;
    for (int i = 0; i < container.nislands; i++)
        for (int k = 0; k < container.islands[i].npieces; k++) {
            const ContainerPiece *piece = &container.islands[i].pieces[k];
            memcpy(f->islands[i].sim->memory.p + piece->to, f->parameters + piece->from, (size_t)piece->count * sizeof(double));
        }
    if (open_master(f)) return FMU_ERROR;
    for (int i = 0; i < container.nfmus; i++)
        if (inner_begin(f->fmus[i], f->settings, live->has_tolerance, live->tolerance, live->start, live->has_stop, live->stop))
            return FMU_ERROR;
    f->live.known = BEGUN;
    f->live.set = 0;
    return FMU_OK;
}

/* The instance as it is to be read: begun where it has not been, with outputs by all that was set. What inputs cause
   happens later, as the next step begins, or in event mode. */
static int ready(Fmu *f)
{
    Live *live = &f->live;
    if (live->mode == FMU_FAILED || live->mode == FMU_TERMINATED) return FMU_OK;
    if (live->set) live->known &= ~SHOWN;
    if (live->mode <= FMU_INITIALIZATION) {
        if (live->set & SETTINGS_SET) live->known = 0;
        if (begin(f)) return FMU_ERROR;
        live->set = 0;
    }
    if (live->known & SHOWN) return FMU_OK;
    if ((live->set || live->mode <= FMU_INITIALIZATION) && master_foresee(&f->master) == MASTER_FAILED) return failed(f);
    live->known |= SHOWN;
    return FMU_OK;
}

/* What was set acts now. */
static int act(Fmu *f)
{
    if (f->live.mode == FMU_FAILED) return FMU_ERROR;
    f->live.known &= ~SHOWN;
    if (f->live.set & INPUTS_SET && master_changed(&f->master, 1) == MASTER_FAILED) return failed(f);
    f->live.set = 0;
    return FMU_OK;
}

/* --- variables ------------------------------------------------------------------------------------------------------------------ */

static int shown(Fmu *f, const MasterLink *links, int n, double *out)
{
    int status = ready(f);
    if (status || f->live.mode == FMU_FAILED) return status;
    f->master.failure = MASTER_FINE;
    return master_values(&f->master, links, n, out) ? failed(f) : FMU_OK;
}

int fmu_get(Fmu *f, uint32_t reference, int type, double *values, size_t count)
{
    const FmuModel *model = &fmu_model;
    if (!is_known(f, reference, type, count)) return FMU_ERROR;
    for (size_t k = 0; k < count; k++) {
        const FmuVariable *v = &model->variables[reference + k];
        int status = FMU_OK;
        switch (v->row) {
        case FMU_ROW_TIME: values[k] = fmu_time(f); break;
        case FMU_ROW_INPUT: values[k] = f->input[v->index]; break;
        case FMU_ROW_SETTING:
            if (f->live.set & SETTINGS_SET && v->variability == FMU_CALCULATED) model->bind(f->settings, f->parameters);
            values[k] = f->settings[v->index];
            break;
        case FMU_ROW_OUTPUT:
            if (k == 0 || model->variables[reference + k - 1].row != v->row) status = shown(f, container.outputs, model->noutputs, f->outputs);
            values[k] = f->outputs[v->index];
            break;
        case FMU_ROW_LOCAL:
            if (k == 0 || model->variables[reference + k - 1].row != v->row) status = shown(f, container.locals, model->nlocals, f->locals);
            values[k] = f->locals[v->index];
            break;
        default: return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "%s is no number", model->names[reference + k]);
        }
        if (status) return status;
    }
    return FMU_OK;
}

int fmu_set(Fmu *f, uint32_t reference, int type, const double *values, size_t count)
{
    if (fmu_check(f, reference, type, values, count)) return FMU_ERROR;
    for (size_t k = 0; k < count; k++) {
        const FmuVariable *v = &fmu_model.variables[reference + k];
        double *place = (v->row == FMU_ROW_INPUT ? f->input : f->settings) + v->index;
        if (*place == values[k]) continue;
        *place = values[k];
        f->live.known &= ~SHOWN;
        f->live.set |= v->row == FMU_ROW_INPUT ? INPUTS_SET : SETTINGS_SET;
    }
    return FMU_OK;
}

/* --- initialization, events ------------------------------------------------------------------------------------------------------ */

int fmu_enter_initialization(Fmu *f, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    if (wrong_times(f, has_tolerance, tolerance, start, has_stop, stop)) return FMU_ERROR;
    begin_experiment(&f->live, has_tolerance, tolerance, start, has_stop, stop);
    return FMU_OK;
}

int fmu_exit_initialization(Fmu *f, int has_event_mode)
{
    if (f->live.set & SETTINGS_SET) f->live.known = 0;
    if (begin(f)) return FMU_ERROR;
    f->live.set = 0;
    if (master_start(&f->master) == MASTER_FAILED) return failed(f);
    for (int i = 0; i < container.nfmus; i++) inner_started(f->fmus[i]);
    f->live.mode = has_event_mode ? FMU_EVENT : FMU_STEP;
    int status = warned(f), wrong = shown(f, container.outputs, fmu_model.noutputs, f->outputs);
    return wrong ? wrong : status;
}

int fmu_enter_event_mode(Fmu *f)
{
    f->live.mode = FMU_EVENT;
    return FMU_OK;
}

/* Events inside happen inside of steps; here are those that inputs cause. */
int fmu_update_discrete_states(Fmu *f, FmuEvents *events)
{
    memset(events, 0, sizeof *events);
    if (act(f)) return FMU_ERROR;
    events->terminate = master_has_ended(&f->master);
    return FMU_OK;
}

int fmu_enter_continuous_mode(Fmu *f)
{
    if (act(f)) return FMU_ERROR;
    f->live.mode = FMU_STEP;
    return FMU_OK;
}

/* --- steps ------------------------------------------------------------------------------------------------------------------------ */

/* The number of the point of a grid that is nearest to t. */
static double nearest(const BlocksGrid *grid, double t) { return nearbyint((t * (double)grid->unit - (double)grid->start) / (double)grid->step); }

/* The point of a grid inside that the end t of a communication step of h s means, or t. */
static double snapped(const Fmu *f, double t, double h)
{
    const Master *m = &f->master;
    const double miss = drift(&f->live, t, h);
    for (int k = -1; k < m->nunits; k++) {
        const BlocksGrid *grid = k < 0 ? &m->every : &m->units[k].grid;
        double number = grid->is_given ? nearest(grid, t) : INFINITY;
        if (!(fabs(number) < 9e15)) continue;
        double point = blocks_grid(grid, (int64_t)number);
        if (fabs(point - t) <= miss || blocks_within_ulps(point, t, 0.0)) return point;
    }
    return t;
}

/* Whether the units with the shortest step stand at t of themselves: a run of the diagram does not stop there either. */
static int is_own_point(const Master *m, double t)
{
    const MasterUnit *u = &m->units[0];
    for (int k = 1; k < m->nunits; k++)
        if (m->units[k].step < u->step) u = &m->units[k];
    double number = nearest(&u->grid, t);
    return !m->is_controlled && fabs(number) < 9e15 && blocks_grid(&u->grid, (int64_t)number) == t;
}

int fmu_step(Fmu *f, double t, double h, int early, FmuIntermediate intermediate, void *owner, FmuStep *step)
{
    Master *m = &f->master;
    (void)early, (void)intermediate, (void)owner;
    *step = (FmuStep){0, 0, 0, m->t};
    if (wrong_step_from(f, m->t, t, h)) return FMU_ERROR;
    f->live.steps++;
    const double begin_t = m->t, goal = snapped(f, t + h, h);
    int is_ended = 0;
    if (!(goal > begin_t))
        return fmu_say(f, FMU_WARNING, FMU_LOG_WARNING, "the step of %g s is too short to be seen at t = %.17g s", h, begin_t);
    if (act(f)) return FMU_ERROR;
    const int is_own = is_own_point(m, goal);
    m->soft = is_own ? goal : INFINITY;
    while (m->t < goal && !master_has_ended(m))
        if (master_run(m, is_own ? (isnan(m->end) ? INFINITY : m->end) : goal) == MASTER_FAILED) {
            if ((is_ended = is_ended_inside(f))) break;
            step->last_time = m->t;
            return failed(f);
        }
    step->terminate = is_ended || master_has_ended(m);
    step->returned_early = m->t < goal;
    step->last_time = m->t < goal ? m->t : t + h; /* as it was asked for, where it was taken to the point beside it */
    int status = warned(f), wrong = shown(f, container.outputs, fmu_model.noutputs, f->outputs);
    return wrong ? wrong : status;
}

/* --- states of the FMU -------------------------------------------------------------------------------------------------------------- */

/* inner: a state of each FMU inside; null before the initialization has ended. whole: it as bytes, once they were asked for.
   bytes: null where the last attempt to save failed. */
struct FmuSaved {
    Fmu *owner;
    FmuSaved *next, **link; /* of all of the owner; what points to this one */
    int64_t generation;
    void **inner;
    unsigned char *whole;
    size_t whole_size, size;
    unsigned char *bytes;
};

static void walk_all(Fmu *f, BlocksWalk *w)
{
    blocks_walk(w, &f->live, sizeof f->live);
    blocks_walk(w, f->settings, (size_t)fmu_model.nsettings * sizeof(double));
    blocks_walk(w, f->input, (size_t)fmu_model.ninputs * sizeof(double));
    if (f->live.mode > FMU_INITIALIZATION && f->master.owned) master_walk(w, &f->master);
}

static void empty_inner(FmuSaved *saved)
{
    for (int i = 0; saved->inner && i < container.nfmus; i++)
        if (saved->owner->fmus[i]) inner_free_state(saved->owner->fmus[i], &saved->inner[i]);
    free(saved->inner);
    saved->inner = NULL;
}

static void forget_inner_states(Fmu *f)
{
    for (FmuSaved *saved = f->saved; saved; saved = saved->next) empty_inner(saved);
}

static void empty(FmuSaved *saved)
{
    empty_inner(saved);
    free(saved->whole);
    free(saved->bytes);
    saved->whole = saved->bytes = NULL;
}

/* Whether it was saved as a whole, by the FMUs that are inside now; without states of theirs it fits any. */
static int is_usable(const FmuSaved *saved)
{
    Live live;
    if (!saved->bytes || saved->size < sizeof live) return 0;
    memcpy(&live, saved->bytes, sizeof live);
    if (live.mode <= FMU_INITIALIZATION) return 1;
    return saved->inner && saved->generation == saved->owner->generation;
}

static FmuSaved *emptied(Fmu *f, FmuSaved *saved)
{
    if (saved && saved->owner != f) return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the state is one of another instance"), NULL;
    if (saved) empty(saved);
    else saved = calloc(1, sizeof *saved);
    if (!saved) fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "there is no memory for a state");
    else if (saved->generation = f->generation, !saved->owner) {
        saved->owner = f, saved->next = f->saved, saved->link = &f->saved;
        if (f->saved) f->saved->link = &saved->next;
        f->saved = saved;
    }
    return saved;
}

void fmu_forget(FmuSaved *saved)
{
    if (!saved) return;
    empty(saved);
    *saved->link = saved->next;
    if (saved->next) saved->next->link = saved->link;
    free(saved);
}

int fmu_save(Fmu *f, FmuSaved **saved)
{
    if (!container.saves) return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "an FMU inside cannot save its state");
    FmuSaved *made = emptied(f, *saved);
    BlocksWalk w = {0};
    if (!made) return FMU_ERROR;
    walk_all(f, &w);
    made->size = w.count;
    made->bytes = malloc(w.count + 1);
    int is_running = f->live.mode > FMU_INITIALIZATION, status = made->bytes ? FMU_OK : FMU_ERROR;
    if (is_running && !status) {
        made->inner = calloc((size_t)container.nfmus + 1, sizeof(void *));
        status = made->inner ? FMU_OK : FMU_ERROR;
        for (int i = 0; i < container.nfmus && !status; i++) status = inner_get_state(f->fmus[i], &made->inner[i]);
    }
    if (status) {
        if (*saved) empty(made);
        else fmu_forget(made);
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the state cannot be saved");
    }
    w = (BlocksWalk){made->bytes, made->bytes + made->size, 0, 0, 0};
    walk_all(f, &w);
    *saved = made;
    return FMU_OK;
}

int fmu_restore(Fmu *f, const FmuSaved *saved)
{
    Live live;
    if (saved->owner == f && is_usable(saved)) memcpy(&live, saved->bytes, sizeof live);
    else live.kind = 0;
    if (live.kind != f->live.kind)
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the state is not one of this instance as it is since its last reset");
    const Live now = f->live;
    f->live = live;
    f->live.known = 0;
    if (live.mode > FMU_INITIALIZATION) {
        int is_same = f->master.owned && now.mode > FMU_INITIALIZATION && now.start == live.start && now.has_stop == live.has_stop
                      && now.stop == live.stop && now.has_tolerance == live.has_tolerance && now.tolerance == live.tolerance;
        f->has_begun = 1;
        if (!is_same && open_master(f)) return f->live.mode = FMU_FAILED, FMU_ERROR;
        for (int i = 0; i < container.nfmus; i++)
            if (inner_set_state(f->fmus[i], saved->inner[i])) return f->live.mode = FMU_FAILED, FMU_ERROR;
    }
    BlocksWalk w = {saved->bytes, saved->bytes + saved->size, 1, 0, 0};
    walk_all(f, &w);
    f->live.known = live.mode > FMU_INITIALIZATION ? BEGUN : 0;
    if (live.mode <= FMU_INITIALIZATION) f->live.set |= SETTINGS_SET;
    if (!w.failed && w.at == w.end) return FMU_OK;
    f->live.mode = FMU_FAILED;
    return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the state is not one of such an instance of this FMU");
}

/* Bytes with their number before them. */
static void put_bytes(unsigned char **to, const void *bytes, uint64_t n)
{
    memcpy(*to, &n, sizeof n);
    memcpy(*to + sizeof n, bytes, (size_t)n);
    *to += sizeof n + n;
}

/* The whole of a state as bytes: token, own part, those of the FMUs inside, digest. */
static void make_whole(FmuSaved *saved)
{
    Fmu *f = saved->owner;
    unsigned char **parts = calloc((size_t)container.nfmus + 1, sizeof *parts), *to;
    size_t *sizes = calloc((size_t)container.nfmus + 1, sizeof *sizes), total = 64 + sizeof(uint64_t) + saved->size + sizeof(uint64_t);
    int wrong = !parts || !sizes || !container.serializes || !is_usable(saved);
    for (int i = 0; i < container.nfmus && !wrong && saved->inner; i++) {
        parts[i] = inner_serialize(f->fmus[i], saved->inner[i], &sizes[i]);
        wrong = !parts[i];
        total += sizeof(uint64_t) + sizes[i];
    }
    to = saved->whole = wrong ? NULL : calloc(1, total);
    if (to) {
        strncpy((char *)to, fmu_model.token, 63);
        to += 64;
        put_bytes(&to, saved->bytes, saved->size);
        for (int i = 0; i < container.nfmus && saved->inner; i++) put_bytes(&to, parts[i], sizes[i]);
        uint64_t digest = digest_of(saved->whole, (size_t)(to - saved->whole));
        memcpy(to, &digest, sizeof digest);
        saved->whole_size = total;
    }
    for (int i = 0; parts && i < container.nfmus; i++) free(parts[i]);
    free(parts);
    free(sizes);
}

size_t fmu_saved_bytes(const FmuSaved *saved)
{
    if (!saved->whole) make_whole((FmuSaved *)saved);
    return saved->whole ? saved->whole_size : 0;
}

int fmu_serialize(Fmu *f, const FmuSaved *saved, unsigned char *bytes, size_t size)
{
    if (!fmu_saved_bytes(saved)) return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "an FMU inside does not give its state as bytes");
    if (size < saved->whole_size) return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "a state takes %lu bytes", (unsigned long)saved->whole_size);
    memcpy(bytes, saved->whole, saved->whole_size);
    return FMU_OK;
}

/* The next piece of bytes; null where there is none. */
static const unsigned char *next_bytes(const unsigned char **from, const unsigned char *end, size_t *size)
{
    uint64_t n = 0;
    if ((size_t)(end - *from) < sizeof n) return NULL;
    memcpy(&n, *from, sizeof n);
    const unsigned char *found = *from + sizeof n;
    if (n > (uint64_t)(end - found)) return NULL;
    *size = (size_t)n;
    *from = found + n;
    return found;
}

int fmu_deserialize(Fmu *f, const unsigned char *bytes, size_t size, FmuSaved **saved)
{
    char token[64] = {0};
    uint64_t digest = 0;
    const unsigned char *from = bytes + sizeof token, *end = bytes + size - sizeof digest, *part = NULL;
    size_t n = 0;
    strncpy(token, fmu_model.token, sizeof token - 1);
    if (size > sizeof token + sizeof digest) memcpy(&digest, end, sizeof digest);
    if (size <= sizeof token + sizeof digest || digest != digest_of(bytes, size - sizeof digest) || memcmp(bytes, token, sizeof token)
        || !(part = next_bytes(&from, end, &n)) || n < sizeof(Live))
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "these bytes are not those of a state of this FMU, or they were changed");
    FmuSaved *made = emptied(f, *saved);
    if (!made) return FMU_ERROR;
    made->size = n;
    made->bytes = malloc(n + 1);
    int wrong = !made->bytes;
    if (!wrong) memcpy(made->bytes, part, n);
    if (!wrong && from < end) {
        made->inner = calloc((size_t)container.nfmus + 1, sizeof(void *));
        wrong = !made->inner;
        for (int i = 0; i < container.nfmus && !wrong; i++)
            wrong = !(part = next_bytes(&from, end, &n)) || inner_deserialize(f->fmus[i], part, n, &made->inner[i]);
    }
    if (wrong) {
        if (*saved) empty(made);
        else fmu_forget(made);
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "the state of an FMU inside cannot be taken from these bytes");
    }
    *saved = made;
    return FMU_OK;
}

/* --- what an FMU for Co-Simulation with others inside has not ------------------------------------------------------------------------ */

static int not_here(Fmu *f, const char *what) { return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "this FMU, which has others inside, has no %s", what); }

int fmu_set_input_derivative(Fmu *f, uint32_t reference, int order, double value)
{
    (void)reference, (void)order;
    return value == 0.0 ? FMU_OK : not_here(f, "derivatives of inputs");
}

int fmu_directional(Fmu *f, const uint32_t *unknowns, size_t nunknowns, const uint32_t *knowns, size_t nknowns, const double *seed,
                    double *sensitivity, int adjoint)
{
    (void)unknowns, (void)nunknowns, (void)knowns, (void)nknowns, (void)seed, (void)sensitivity, (void)adjoint;
    return not_here(f, "derivatives of outputs");
}

int fmu_set_time(Fmu *f, double t) { return (void)t, not_here(f, "Model Exchange"); }
int fmu_set_states(Fmu *f, const double *x, size_t n) { return (void)x, (void)n, not_here(f, "Model Exchange"); }
int fmu_get_states(Fmu *f, double *x, size_t n) { return (void)x, (void)n, not_here(f, "Model Exchange"); }
int fmu_get_rates(Fmu *f, double *x, size_t n) { return (void)x, (void)n, not_here(f, "Model Exchange"); }
int fmu_get_nominals(Fmu *f, double *x, size_t n) { return (void)x, (void)n, not_here(f, "Model Exchange"); }
int fmu_get_indicators(Fmu *f, double *x, size_t n) { return (void)x, (void)n, not_here(f, "Model Exchange"); }
int fmu_completed_step(Fmu *f, int *enter, int *terminate) { return (void)enter, (void)terminate, not_here(f, "Model Exchange"); }
size_t fmu_number_of_states(void) { return 0; }
size_t fmu_number_of_indicators(void) { return 0; }
