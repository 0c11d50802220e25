/* A core of one state for the tests of the wrappers: x' = k (u - x), y = x, by Euler's method, with an event at
   t = 0.5 s. What a step comes to is chosen by the input: 2 warns, 3 is discarded, 4 asks for the end, 5 fails. */
#include "fmu.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { TIME, INPUT, OUTPUT, STATE, RATE, PARAMETER, VECTOR, WHOLE = VECTOR + 3, LARGE, FLAG, CHOICE, TEXT, COUNT };

/* size: of the variable that begins here. */
static const struct {
    int type, size;
} VARIABLES[COUNT] = {
    [TIME] = {FMU_REAL, 1},       [INPUT] = {FMU_REAL, 1},       [OUTPUT] = {FMU_REAL, 1},
    [STATE] = {FMU_REAL, 1},      [RATE] = {FMU_REAL, 1},        [PARAMETER] = {FMU_REAL, 1},
    [VECTOR] = {FMU_REAL, 3},     [VECTOR + 1] = {FMU_REAL, 0},  [VECTOR + 2] = {FMU_REAL, 0},
    [WHOLE] = {FMU_INTEGER, 1},   [LARGE] = {FMU_INTEGER, 1},    [FLAG] = {FMU_BOOLEAN, 1},
    [CHOICE] = {FMU_ENUMERATION, 1}, [TEXT] = {FMU_STRING, 1}
};

typedef struct {
    double start, stop, slope, values[COUNT];
    int kind, mode, has_stop, has_event_mode, is_past;
} Live;

struct Fmu {
    Live live;
    FmuLog log;
    void *owner;
    int categories;
};

struct FmuSaved {
    Live live;
    size_t size;
};

int fmu_say(Fmu *f, int status, int category, const char *format, ...)
{
    char text[600];
    va_list arguments;
    if (!f->log || !(f->categories & category))
        return status;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    f->log(f->owner, status, category, text);
    return status;
}

Fmu *fmu_new(int kind, const char *name, const char *token, const char *resources, FmuLog log, void *owner)
{
    (void)resources;
    Fmu *f = name[0] && !strcmp(token, "{one-state}") ? calloc(1, sizeof *f) : NULL;
    if (!f) {
        if (log)
            log(owner, FMU_ERROR, FMU_LOG_ERROR, "the token is not that of this FMU");
        return NULL;
    }
    f->log = log;
    f->owner = owner;
    f->live.kind = kind;
    fmu_reset(f);
    return f;
}

void fmu_free(Fmu *f)
{
    free(f);
}

int fmu_reset(Fmu *f)
{
    const int kind = f->live.kind;
    f->live = (Live){.kind = kind, .mode = FMU_INSTANTIATED};
    f->live.values[STATE] = f->live.values[PARAMETER] = 1;
    f->live.values[LARGE] = 4e9;
    return FMU_OK;
}

void *fmu_owner(const Fmu *f)
{
    return f->owner;
}

int fmu_kind(const Fmu *f)
{
    return f->live.kind;
}

int fmu_mode(const Fmu *f)
{
    return f->live.mode;
}

void fmu_set_mode(Fmu *f, int mode)
{
    f->live.mode = mode;
}

void fmu_log_categories(Fmu *f, int categories)
{
    f->categories = categories;
}

int fmu_has_traces(void) { return 0; }
int fmu_logs(const Fmu *f)
{
    return f->categories;
}

size_t fmu_elements(uint32_t reference)
{
    return reference < COUNT ? (size_t)VARIABLES[reference].size : 0;
}

int fmu_type(uint32_t reference)
{
    return reference < COUNT ? VARIABLES[reference].type : -1;
}

size_t fmu_references(void)
{
    return COUNT;
}

size_t fmu_number_of_states(void)
{
    return 1;
}

size_t fmu_number_of_indicators(void)
{
    return 1;
}

static double rate(const Fmu *f)
{
    return f->live.values[PARAMETER] * (f->live.values[INPUT] - f->live.values[STATE]);
}

static int are_of(Fmu *f, uint32_t reference, int type, size_t count)
{
    for (size_t k = 0; k < count; k++)
        if (fmu_type(reference + (uint32_t)k) != type) {
            fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "no such variable: %lu", (unsigned long)reference);
            return 0;
        }
    return 1;
}

int fmu_get(Fmu *f, uint32_t reference, int type, double *values, size_t count)
{
    if (!are_of(f, reference, type, count))
        return FMU_ERROR;
    f->live.values[OUTPUT] = f->live.values[STATE];
    f->live.values[RATE] = rate(f);
    memcpy(values, f->live.values + reference, count * sizeof *values);
    return FMU_OK;
}

int fmu_check(Fmu *f, uint32_t reference, int type, const double *values, size_t count)
{
    if (!are_of(f, reference, type, count))
        return FMU_ERROR;
    if (reference == TIME || reference == OUTPUT || reference == RATE)
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "it is computed");
    for (size_t k = 0; k < count; k++)
        if (!isfinite(values[k]) || (reference == CHOICE && (values[k] < 0 || values[k] > 2)))
            return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "out of its range");
    return FMU_OK;
}

int fmu_set(Fmu *f, uint32_t reference, int type, const double *values, size_t count)
{
    if (fmu_check(f, reference, type, values, count))
        return FMU_ERROR;
    memcpy(f->live.values + reference, values, count * sizeof *values);
    return FMU_OK;
}

const char *fmu_get_string(Fmu *f, uint32_t reference)
{
    return are_of(f, reference, FMU_STRING, 1) ? "text" : NULL;
}

int fmu_set_input_derivative(Fmu *f, uint32_t reference, int order, double value)
{
    if (reference != INPUT || order < 1 || order > 3)
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "no such derivative");
    f->live.slope = value;
    return FMU_OK;
}

int fmu_enter_initialization(Fmu *f, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    (void)has_tolerance, (void)tolerance;
    f->live.start = f->live.values[TIME] = start;
    f->live.has_stop = has_stop;
    f->live.stop = stop;
    f->live.mode = FMU_INITIALIZATION;
    return FMU_OK;
}

int fmu_exit_initialization(Fmu *f, int has_event_mode)
{
    f->live.has_event_mode = has_event_mode;
    f->live.mode = f->live.kind == FMU_ME || has_event_mode ? FMU_EVENT : FMU_STEP;
    return FMU_OK;
}

int fmu_enter_event_mode(Fmu *f)
{
    f->live.mode = FMU_EVENT;
    return FMU_OK;
}

int fmu_update_discrete_states(Fmu *f, FmuEvents *events)
{
    if (f->live.values[TIME] >= 0.5)
        f->live.is_past = 1;
    memset(events, 0, sizeof *events);
    events->has_next = !f->live.is_past;
    events->next = 0.5;
    return fmu_say(f, FMU_OK, FMU_LOG_EVENTS, "an update");
}

int fmu_enter_continuous_mode(Fmu *f)
{
    f->live.mode = f->live.kind == FMU_ME ? FMU_CONTINUOUS : FMU_STEP;
    return FMU_OK;
}

int fmu_set_time(Fmu *f, double t)
{
    f->live.values[TIME] = t;
    return FMU_OK;
}

int fmu_set_states(Fmu *f, const double *x, size_t n)
{
    memcpy(f->live.values + STATE, x, n * sizeof *x);
    return FMU_OK;
}

int fmu_get_states(Fmu *f, double *x, size_t n)
{
    memcpy(x, f->live.values + STATE, n * sizeof *x);
    return FMU_OK;
}

int fmu_get_rates(Fmu *f, double *rates, size_t n)
{
    for (size_t i = 0; i < n; i++)
        rates[i] = rate(f);
    return FMU_OK;
}

int fmu_get_nominals(Fmu *f, double *x, size_t n)
{
    (void)f;
    for (size_t i = 0; i < n; i++)
        x[i] = 1;
    return FMU_OK;
}

int fmu_get_indicators(Fmu *f, double *z, size_t n)
{
    for (size_t i = 0; i < n; i++)
        z[i] = f->live.values[STATE] - 0.5;
    return FMU_OK;
}

int fmu_completed_step(Fmu *f, int *enter_event_mode, int *terminate)
{
    (void)f;
    *enter_event_mode = *terminate = 0;
    return FMU_OK;
}

int fmu_step(Fmu *f, double t, double h, int early, FmuIntermediate intermediate, void *owner, FmuStep *step)
{
    const double end = t + h;
    double *now = &f->live.values[TIME];
    *step = (FmuStep){0, 0, 0, *now};
    if (fabs(t - *now) > 1e-9 || (f->live.has_stop && end > f->live.stop + 1e-9))
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "not from t = %g s to %g s", t, end);
    if (f->live.values[INPUT] == 3)
        return fmu_say(f, FMU_DISCARD, FMU_LOG_WARNING, "a step that cannot be made");
    if (f->live.values[INPUT] == 5) {
        f->live.mode = FMU_FAILED;
        return fmu_say(f, FMU_ERROR, FMU_LOG_NONLINEAR | FMU_LOG_ERROR, "no solution");
    }
    for (int piece = 1; piece <= 4; piece++) {
        const double before = *now, after = t + h * piece / 4;
        f->live.values[STATE] += (after - before) * rate(f);
        f->live.values[INPUT] += (after - before) * f->live.slope;
        *now = after;
        step->last_time = after;
        if (!f->live.is_past && after >= 0.5) {
            f->live.is_past = !f->live.has_event_mode;
            step->event_needed = f->live.has_event_mode && (early || piece == 4);
        }
        if (intermediate) {
            int asked = 0;
            double at = after;
            f->live.mode = FMU_INTERMEDIATE;
            intermediate(owner, after, piece == 4, &asked, &at);
            f->live.mode = FMU_STEP;
            if (asked && early && at <= after && piece < 4)
                step->returned_early = 1;
        }
        if (step->event_needed && piece < 4)
            step->returned_early = 1;
        if (step->returned_early)
            break;
    }
    step->terminate = f->live.values[INPUT] == 4;
    return f->live.values[INPUT] == 2 ? fmu_say(f, FMU_WARNING, FMU_LOG_WARNING, "two") : FMU_OK;
}

double fmu_time(const Fmu *f)
{
    return f->live.values[TIME];
}

int fmu_save(Fmu *f, FmuSaved **saved)
{
    FmuSaved *made = *saved ? *saved : calloc(1, sizeof *made);
    if (!made)
        return FMU_ERROR;
    made->live = f->live;
    made->size = sizeof made->live;
    *saved = made;
    return FMU_OK;
}

int fmu_restore(Fmu *f, const FmuSaved *saved)
{
    if (saved->size != sizeof saved->live || saved->live.kind != f->live.kind)
        return fmu_say(f, FMU_ERROR, FMU_LOG_ERROR, "not a state of such an instance");
    f->live = saved->live;
    return FMU_OK;
}

void fmu_forget(FmuSaved *saved)
{
    free(saved);
}

size_t fmu_saved_bytes(const FmuSaved *saved)
{
    return saved->size;
}

int fmu_serialize(Fmu *f, const FmuSaved *saved, unsigned char *bytes, size_t size)
{
    (void)f;
    memcpy(bytes, &saved->live, size);
    return FMU_OK;
}

int fmu_deserialize(Fmu *f, const unsigned char *bytes, size_t size, FmuSaved **saved)
{
    FmuSaved *made = calloc(1, sizeof *made);
    (void)f;
    if (!made)
        return FMU_ERROR;
    memcpy(&made->live, bytes, size < sizeof made->live ? size : sizeof made->live);
    made->size = size;
    *saved = made;
    return FMU_OK;
}

int fmu_directional(Fmu *f, const uint32_t *unknowns, size_t nunknowns, const uint32_t *knowns, size_t nknowns,
                    const double *seed, double *sensitivity, int adjoint)
{
    const double k = f->live.values[PARAMETER];
    for (size_t i = 0; i < (adjoint ? nknowns : nunknowns); i++)
        sensitivity[i] = 0;
    for (size_t i = 0; i < nunknowns; i++)
        for (size_t j = 0; j < nknowns; j++) {
            const int by_state = knowns[j] == STATE, by_input = knowns[j] == INPUT;
            const double d = unknowns[i] == OUTPUT ? by_state : unknowns[i] == RATE ? k * (by_input - by_state) : 0;
            if (adjoint)
                sensitivity[j] += d * seed[i];
            else
                sensitivity[i] += d * seed[j];
        }
    return FMU_OK;
}

size_t fmu_dependencies(uint32_t unknown, const uint32_t **references)
{
    static const uint32_t OF_OUTPUT[] = {STATE}, OF_RATE[] = {INPUT, STATE, VECTOR + 2};
    *references = unknown == OUTPUT ? OF_OUTPUT : unknown == RATE ? OF_RATE : NULL;
    return unknown == OUTPUT ? 1 : unknown == RATE ? 3 : 0;
}
