/* An FMU that works, and fails on demand: an integrator x' = k u, y = x + d u, exact where u is constant over a step.

   FMI is 2 or 3, TOKEN the token it takes. From t_fault on, or in the step that reaches it, `fault` happens. With
   -DNO_ROLLBACK its state can be neither saved nor set, with -DNO_ROLLBACK_LATER it cannot be saved from t_fault on;
   with -DFIXED_STEP all steps must be like the first. With
   -DBEGINS_WITH=SEGFAULTS it has that fault from the start, unless it is given another; with -DABORTS_AT_LOAD it ends
   the process that loads it. With -DSTEP_MS=20 each step, and each look at the rates, takes 20 ms; with -DTALKS it says
   something then; with -DFAILS_TO_BEGIN it cannot be initialized; with -DTELLS_TOLERANCE x begins with the tolerance that
   it is told, -1 for none; with -DENDS_AT_EVENTS it ends the run at an event at t_fault, where it has events; with
   -DSTARTS_ANEW fmi2SetupExperiment puts all values back to those of the description; with
   -DTAKES_ORDER=1 it refuses derivatives of higher order; with -DNOISE=1e-3 x is off by that much after every other step,
   also one that is done again. With -DCALLS calls are written down (calls.h). A function is left out by
   -DfmiNName=another_name. With -DLAGS y follows x only when a step is completed (Model Exchange). */
#define _POSIX_C_SOURCE 199309L /* nanosleep */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#if FMI == 2
#include "fmi2.h"
#else
#include "fmi3.h"
#endif

enum { TIME, U, Y, X, DX, K, D, FAULT, T_FAULT, LABEL, ON, COUNT, MODE, F32, I8, U8, I16, U16, U32, I64, U64, N, V, W };
enum {
    NONE, WARNS, DISCARDS, ERRORS, FATALS, PENDS, PENDS_FOREVER, SEGFAULTS, ABORTS, EXITS, HANGS, EARLY, ILLEGAL,
    DISCARDS_MUTELY, EVENT, TERMINATES, IN_RATES, IN_GET, DISCARDS_LONG, /* steps of more than 0.03 s: it stays where it is */
    NEGATIVE
};
enum { OK, WARNING, DISCARD, ERROR_, FATAL, PENDING };
#ifndef EXITS_WITH
#define EXITS_WITH 3
#endif
#ifdef ENDS_AT_EVENTS
enum { AT_EVENTS = 1 };
#else
enum { AT_EVENTS = 0 };
#endif
#define LARGEST 16

typedef struct {
    double t, x, u, k, d, t_fault, h, last, shown; /* shown: x when a step was completed */
    float f32;
    int fault, on, mode, polls, done;
    long long count, i[8]; /* I8 to U64 */
    size_t n;
    double v[LARGEST];
    char label[64];
} Values;

typedef struct {
    Values now;
    int is_quiet;
    char *name;
    void *environment;
#if FMI == 2
    fmi2CallbackLogger logger;
    void (*give_back)(void *);
#else
    fmi3LogMessageCallback logger;
    fmi3IntermediateUpdateCallback update;
    int early, event_mode;
#endif
} Instance;

static void start(Values *now) {
    memset(now, 0, sizeof *now);
    now->k = 1.0;
    now->t_fault = 1.0;
    now->n = 3;
    strcpy(now->label, "none");
#ifdef BEGINS_WITH
    now->fault = BEGINS_WITH;
#endif
}

#ifdef ABORTS_AT_LOAD
__attribute__((constructor)) static void at_load(void) { abort(); }
#endif

/* What happens; most of it does not come back. */
static int happens(int fault) {
    switch (fault) {
    case SEGFAULTS:
        *(volatile int *)8 = 1;
        return ERROR_;
    case ABORTS:
        abort();
    case EXITS:
        exit(EXITS_WITH);
    case HANGS:
        for (volatile int always = 1; always;) {
        }
        return ERROR_;
    case WARNS:
        return WARNING;
    case DISCARDS:
    case DISCARDS_MUTELY:
        return DISCARD;
    case ERRORS:
        return ERROR_;
    case FATALS:
        return FATAL;
    case PENDS:
    case PENDS_FOREVER:
        return PENDING;
    case NEGATIVE:
        return -1;
    case ILLEGAL:
        return 9;
    default:
        return OK;
    }
}

static void tell(Instance *one, int status, const char *what, double t) {
    static const char *const categories[] = {"logAll", "logStatusWarning", "logStatusDiscard", "logStatusError",
                                             "logStatusFatal", "logStatusPending"};
    if (one->logger == NULL || (status == OK && one->is_quiet)) return;
    const char *category = categories[status >= OK && status <= PENDING ? status : ERROR_];
#if FMI == 2
    one->logger(one->environment, one->name, status, category, "%s at %g of 100%%, #r%d# = %g", what, t, U, one->now.u);
#else
    char text[200];
    snprintf(text, sizeof text, "%s at %g of 100%%, u = %g", what, t, one->now.u);
    one->logger(one->environment, status, category, text);
#endif
}

static void hears(Values *now, int has_tolerance, double tolerance) {
#ifdef TELLS_TOLERANCE
    now->x = has_tolerance ? tolerance : -1.0;
#else
    (void)now, (void)has_tolerance, (void)tolerance;
#endif
}

static int begun(Instance *one) {
#ifdef FAILS_TO_BEGIN
    tell(one, ERROR_, "no start values", one->now.t);
    return ERROR_;
#else
    (void)one;
    return OK;
#endif
}

/* What it takes to compute something. */
static void work(Instance *one) {
#ifdef STEP_MS
    struct timespec rest = {(STEP_MS) / 1000, (STEP_MS) % 1000 * 1000000L};
    while (nanosleep(&rest, &rest)) { /* signals do not shorten it */
    }
#endif
#ifdef TALKS
    tell(one, WARNING, "still here", one->now.t);
#else
    (void)one;
#endif
}

static void advance(Values *now, double t) {
    now->x += now->k * now->u * (t - now->t);
#ifdef NOISE
    static int is_odd;
    now->x += (is_odd = !is_odd) ? NOISE : -(NOISE);
#endif
    now->t = t;
}

/* The step to `end`, as far as it goes; `last` says how far. */
static int go(Instance *one, double end) {
    Values *now = &one->now;
    work(one);
    int fault = end >= now->t_fault - 1e-9 && !now->done ? now->fault : NONE;
#ifdef FIXED_STEP
    if (now->h != 0.0 && fabs(end - now->t - now->h) > 1e-9) {
        tell(one, ERROR_, "another step", end);
        return ERROR_;
    }
    now->h = end - now->t;
#endif
    tell(one, OK, "a step", now->t);
    if (now->fault == DISCARDS_LONG && end >= now->t_fault - 1e-9 && end - now->t > 0.03) {
        now->last = now->t;
        tell(one, DISCARD, "too long", now->t);
        return DISCARD;
    }
    int status = happens(fault);
    if (status == DISCARD || fault == EARLY || fault == EVENT) end = fmax(now->t, now->t_fault);
    if (status <= DISCARD || status == PENDING) advance(now, end);
    now->last = now->t;
    now->count++;
    if (status != OK) tell(one, status, "a fault", now->t);
    return status;
}

static double real(const Values *now, unsigned vr, size_t i) {
    switch (vr) {
    case TIME: return now->t;
    case U: return now->u;
#ifdef LAGS
    case Y: return now->shown + now->d * now->u;
#else
    case Y: return now->x + now->d * now->u;
#endif
    case X: return now->x;
    case DX: return now->k * now->u;
    case K: return now->k;
    case D: return now->d;
    case T_FAULT: return now->t_fault;
    case V: return now->v[i];
    case W: return 2.0 * now->v[i];
    default: return 0.0;
    }
}

static double *place(Values *now, unsigned vr, size_t i) {
    switch (vr) {
    case U: return &now->u;
    case X: return &now->x;
    case K: return &now->k;
    case D: return &now->d;
    case T_FAULT: return &now->t_fault;
    case V: return &now->v[i];
    default: return NULL;
    }
}

static int get_fault(Instance *one) {
    return one->now.fault == IN_GET && one->now.t >= one->now.t_fault - 1e-9 ? ERROR_ : OK;
}

static Instance *made(const char *name, const char *token) {
    if (token == NULL || strcmp(token, TOKEN) != 0) return NULL;
    Instance *one = calloc(1, sizeof *one);
    one->name = calloc(1, strlen(name) + 1);
    strcpy(one->name, name);
    start(&one->now);
    return one;
}

static int quiet(size_t n, const char *const categories[]) {
    for (size_t i = 0; i < n; i++)
        if (strcmp(categories[i], "logAll") == 0) return 0;
    return n > 0;
}

static int rates_fault(Instance *one) {
    work(one);
    if (one->now.t < one->now.t_fault - 1e-9) return OK;
    if (one->now.fault == FATALS || (one->now.fault >= SEGFAULTS && one->now.fault <= HANGS)) return happens(one->now.fault);
    if (one->now.fault != IN_RATES) return OK;
    tell(one, ERROR_, "no rates", one->now.t);
    return ERROR_;
}

#ifdef NO_ROLLBACK
#define SAVES(body) return ERROR_;
#else
#define SAVES(body) body
#endif

static int saved(Instance *one, void **state) {
    (void)one, (void)state;
#ifdef NO_ROLLBACK_LATER
    if (one->now.t >= one->now.t_fault - 1e-9) return ERROR_;
#endif
    SAVES({
        if (*state == NULL) *state = malloc(sizeof(Values));
        memcpy(*state, &one->now, sizeof(Values));
        return OK;
    })
}

static int restored(Instance *one, void *state) {
    (void)one, (void)state;
    SAVES({
        memcpy(&one->now, state, sizeof(Values));
        return OK;
    })
}

static int forgotten(void **state) {
    free(*state);
    *state = NULL;
    return OK;
}

#ifdef CALLS
#include "calls.h"
#endif

#if FMI == 2
/* --- FMI 2 ---- */
#define F fmi2Status
#define C fmi2Component c
#define NOW (&((Instance *)c)->now)

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
F fmi2SetDebugLogging(C, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    ((Instance *)c)->is_quiet = !on || quiet(n, categories);
    return fmi2OK;
}
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)type, (void)resources, (void)visible;
    Instance *one = made(name, token);
    if (one == NULL) {
        functions->logger(functions->componentEnvironment, name, fmi2Error, "logStatusError", "the token is not %s", TOKEN);
        return NULL;
    }
    void *memory = functions->allocateMemory(3, 7);
    functions->freeMemory(memory);
    one->logger = functions->logger, one->environment = functions->componentEnvironment, one->is_quiet = !logging;
#ifdef FORGETS_ENVIRONMENT
    one->environment = NULL;
#endif
    return one;
}
void fmi2FreeInstance(C) {
    Instance *one = c;
    tell(one, OK, "freed", one->now.t);
    free(one->name);
    free(one);
}
F fmi2SetupExperiment(C, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real begin, fmi2Boolean has_stop, fmi2Real stop) {
    (void)has_stop, (void)stop;
#ifdef STARTS_ANEW
    start(NOW);
#endif
    hears(NOW, has_tolerance, tolerance);
    NOW->t = begin;
    return fmi2OK;
}
F fmi2EnterInitializationMode(C) { (void)c; return fmi2OK; }
F fmi2ExitInitializationMode(C) { return begun(c); }
F fmi2Terminate(C) { tell(c, OK, "terminated", NOW->t); return fmi2OK; }
F fmi2Reset(C) { start(NOW); return fmi2OK; }

F fmi2GetReal(C, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    for (size_t i = 0; i < n; i++) value[i] = real(NOW, vr[i], 0);
    return get_fault(c);
}
F fmi2SetReal(C, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    for (size_t i = 0; i < n; i++) {
        double *at = place(NOW, vr[i], 0);
        if (at == NULL) return fmi2Error;
        *at = value[i];
    }
    return fmi2OK;
}
F fmi2GetInteger(C, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
    for (size_t i = 0; i < n; i++)
        value[i] = vr[i] == FAULT ? NOW->fault : vr[i] == COUNT ? (int)NOW->count : vr[i] == MODE ? NOW->mode : -1;
    return fmi2OK;
}
F fmi2SetInteger(C, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) {
    for (size_t i = 0; i < n; i++) *(vr[i] == FAULT ? &NOW->fault : &NOW->mode) = value[i];
    return fmi2OK;
}
F fmi2GetBoolean(C, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
    (void)vr;
    for (size_t i = 0; i < n; i++) value[i] = NOW->on;
    return fmi2OK;
}
F fmi2SetBoolean(C, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
    (void)vr;
    for (size_t i = 0; i < n; i++) NOW->on = value[i];
    return fmi2OK;
}
F fmi2GetString(C, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    (void)vr;
    for (size_t i = 0; i < n; i++) value[i] = NOW->label;
    return fmi2OK;
}
F fmi2SetString(C, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    (void)vr;
    for (size_t i = 0; i < n; i++) snprintf(NOW->label, sizeof NOW->label, "%s", value[i]);
    return fmi2OK;
}
F fmi2GetFMUstate(C, fmi2FMUstate *state) { return saved(c, state); }
F fmi2SetFMUstate(C, fmi2FMUstate state) { return restored(c, state); }
F fmi2FreeFMUstate(C, fmi2FMUstate *state) { (void)c; return forgotten(state); }
F fmi2GetDirectionalDerivative(C, const fmi2ValueReference z[], size_t nz, const fmi2ValueReference v[], size_t nv,
                               const fmi2Real dv[], fmi2Real dz[]) {
    for (size_t i = 0; i < nz; i++) {
        dz[i] = 0.0;
        for (size_t j = 0; j < nv; j++)
            dz[i] += dv[j] * (z[i] == Y && v[j] == U ? NOW->d : z[i] == Y && v[j] == X ? 1.0 : z[i] == DX && v[j] == U ? NOW->k : 0.0);
    }
    return fmi2OK;
}
F fmi2EnterEventMode(C) { (void)c; return fmi2OK; }
F fmi2NewDiscreteStates(C, fmi2EventInfo *told) {
    memset(told, 0, sizeof *told);
    told->nextEventTimeDefined = NOW->fault == EVENT || (AT_EVENTS && NOW->fault == TERMINATES);
    told->nextEventTime = NOW->t_fault;
    told->terminateSimulation = AT_EVENTS && NOW->fault == TERMINATES && NOW->t >= NOW->t_fault;
    return fmi2OK;
}
F fmi2EnterContinuousTimeMode(C) { NOW->shown = NOW->x; return fmi2OK; }
F fmi2CompletedIntegratorStep(C, fmi2Boolean forgets, fmi2Boolean *event, fmi2Boolean *terminate) {
    (void)forgets;
    NOW->shown = NOW->x;
    *event = 0, *terminate = !AT_EVENTS && NOW->fault == TERMINATES && NOW->t >= NOW->t_fault;
    return fmi2OK;
}
F fmi2SetTime(C, fmi2Real t) { NOW->t = t; return fmi2OK; }
F fmi2SetContinuousStates(C, const fmi2Real x[], size_t n) { (void)n; NOW->x = x[0]; return fmi2OK; }
F fmi2GetDerivatives(C, fmi2Real rates[], size_t n) { (void)n; rates[0] = NOW->k * NOW->u; return rates_fault(c); }
F fmi2GetEventIndicators(C, fmi2Real z[], size_t n) { (void)n; z[0] = NOW->x - 1.0; return fmi2OK; }
F fmi2GetContinuousStates(C, fmi2Real x[], size_t n) { (void)n; x[0] = NOW->x; return fmi2OK; }
F fmi2GetNominalsOfContinuousStates(C, fmi2Real x[], size_t n) { (void)c, (void)n; x[0] = 1.0; return fmi2OK; }
F fmi2SetRealInputDerivatives(C, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], const fmi2Real value[]) {
#ifdef TAKES_ORDER
    for (size_t i = 0; i < n; i++)
        if (order[i] > TAKES_ORDER) {
            tell(c, ERROR_, order[i] == 1 ? "derivative order 1 is not supported" : "derivative order 2 is not supported", NOW->t);
            return fmi2Error;
        }
#endif
    /* u + s u' over the step: x gains k u' h^2 / 2, which is put into x when h is known; here for h = 1. */
    for (size_t i = 0; i < n; i++)
        if (vr[i] == U && order[i] == 1) NOW->x += NOW->k * value[i] / 2.0;
    return fmi2OK;
}
F fmi2GetRealOutputDerivatives(C, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real value[]) {
    (void)vr;
    for (size_t i = 0; i < n; i++) value[i] = order[i] == 1 ? NOW->k * NOW->u : 0.0;
    return fmi2OK;
}
F fmi2DoStep(C, fmi2Real t, fmi2Real h, fmi2Boolean forgets) {
    (void)forgets;
    NOW->polls = 0;
    if (NOW->fault == TERMINATES && t + h >= NOW->t_fault - 1e-9) {
        advance(NOW, fmax(NOW->t, NOW->t_fault));
        NOW->last = NOW->t;
        tell(c, DISCARD, "the end", NOW->t);
        return fmi2Discard;
    }
    return go(c, t + h);
}
F fmi2CancelStep(C) { tell(c, OK, "cancelled", NOW->t); return fmi2OK; }
F fmi2GetStatus(C, const fmi2StatusKind s, fmi2Status *value) {
    (void)s;
#ifdef REFUSES_STATUS
    *value = fmi2Pending;
    return fmi2Error;
#endif
    *value = NOW->fault == PENDS && ++NOW->polls > 3 ? fmi2OK : fmi2Pending;
    return fmi2OK;
}
F fmi2GetRealStatus(C, const fmi2StatusKind s, fmi2Real *value) {
    (void)s;
    *value = NOW->last;
    return NOW->fault == DISCARDS_MUTELY ? fmi2Discard : fmi2OK;
}
F fmi2GetBooleanStatus(C, const fmi2StatusKind s, fmi2Boolean *value) {
    *value = s == fmi2Terminated && NOW->fault == TERMINATES && NOW->t >= NOW->t_fault;
    return fmi2OK;
}
#else
/* --- FMI 3 ---- */
#define F fmi3Status
#define C fmi3Instance c
#define NOW (&((Instance *)c)->now)

const char *fmi3GetVersion(void) { return "3.0"; }
F fmi3SetDebugLogging(C, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    ((Instance *)c)->is_quiet = !on || quiet(n, categories);
    return fmi3OK;
}
static Instance *made3(fmi3String name, fmi3String token, bool logging, void *environment, fmi3LogMessageCallback logger) {
    Instance *one = made(name, token);
    if (one == NULL) {
        logger(environment, fmi3Error, "logStatusError", "the token is not " TOKEN);
        return NULL;
    }
    one->logger = logger, one->environment = environment, one->is_quiet = !logging;
    return one;
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback logger) {
    (void)resources, (void)visible;
    return made3(name, token, logging, environment, logger);
}
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early,
                                         const fmi3ValueReference variables[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                         fmi3IntermediateUpdateCallback update) {
    (void)resources, (void)visible, (void)variables, (void)n;
    Instance *one = made3(name, token, logging, environment, logger);
    if (one != NULL) one->update = update, one->early = early, one->event_mode = event_mode;
    return one;
}
void fmi3FreeInstance(C) {
    Instance *one = c;
    tell(one, OK, "freed", one->now.t);
    free(one->name);
    free(one);
}
F fmi3EnterInitializationMode(C, fmi3Boolean has_tolerance, fmi3Float64 tolerance, fmi3Float64 begin, fmi3Boolean has_stop,
                              fmi3Float64 stop) {
    (void)has_stop, (void)stop;
    hears(NOW, has_tolerance, tolerance);
    NOW->t = begin;
    return fmi3OK;
}
F fmi3ExitInitializationMode(C) { return begun(c); }
#ifdef REFUSES_EVENT_MODE
F fmi3EnterEventMode(C) { (void)c; return fmi3Error; }
#else
F fmi3EnterEventMode(C) { (void)c; return fmi3OK; }
#endif
F fmi3Terminate(C) { tell(c, OK, "terminated", NOW->t); return fmi3OK; }
F fmi3Reset(C) { start(NOW); return fmi3OK; }
F fmi3EnterConfigurationMode(C) { (void)c; return fmi3OK; }
F fmi3ExitConfigurationMode(C) { (void)c; return fmi3OK; }

F fmi3GetFloat64(C, const fmi3ValueReference vr[], size_t n, fmi3Float64 values[], size_t all) {
    size_t at = 0;
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < (vr[i] == V || vr[i] == W ? NOW->n : 1); j++)
            if (at < all) values[at++] = real(NOW, vr[i], j);
    return at == all ? get_fault(c) : fmi3Error;
}
F fmi3SetFloat64(C, const fmi3ValueReference vr[], size_t n, const fmi3Float64 values[], size_t all) {
    size_t at = 0;
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < (vr[i] == V ? NOW->n : 1); j++) {
            double *to = place(NOW, vr[i], j);
            if (to == NULL || at >= all) return fmi3Error;
            *to = values[at++];
        }
    return at == all ? fmi3OK : fmi3Error;
}
#define PLAIN(Name, Type, at, vr1) \
    F fmi3Get##Name(C, const fmi3ValueReference vr[], size_t n, Type values[], size_t all) { \
        (void)vr, (void)n; \
        for (size_t i = 0; i < all; i++) values[i] = (Type)(at); \
        return vr[0] == (vr1) ? fmi3OK : fmi3Error; \
    } \
    F fmi3Set##Name(C, const fmi3ValueReference vr[], size_t n, const Type values[], size_t all) { \
        (void)vr, (void)n; \
        for (size_t i = 0; i < all; i++) at = values[i]; \
        return vr[0] == (vr1) ? fmi3OK : fmi3Error; \
    }
PLAIN(Float32, fmi3Float32, NOW->f32, F32)
PLAIN(Int8, fmi3Int8, NOW->i[0], I8)
PLAIN(UInt8, fmi3UInt8, NOW->i[1], U8)
PLAIN(Int16, fmi3Int16, NOW->i[2], I16)
PLAIN(UInt16, fmi3UInt16, NOW->i[3], U16)
PLAIN(UInt32, fmi3UInt32, NOW->i[4], U32)
PLAIN(Boolean, fmi3Boolean, NOW->on, ON)
F fmi3GetInt32(C, const fmi3ValueReference vr[], size_t n, fmi3Int32 values[], size_t all) {
    (void)all;
    for (size_t i = 0; i < n; i++) values[i] = vr[i] == FAULT ? NOW->fault : (int)NOW->count;
    return fmi3OK;
}
F fmi3SetInt32(C, const fmi3ValueReference vr[], size_t n, const fmi3Int32 values[], size_t all) {
    (void)vr, (void)all;
    for (size_t i = 0; i < n; i++) NOW->fault = values[i];
    return fmi3OK;
}
F fmi3GetInt64(C, const fmi3ValueReference vr[], size_t n, fmi3Int64 values[], size_t all) {
    (void)all;
    for (size_t i = 0; i < n; i++) values[i] = vr[i] == MODE ? NOW->mode : NOW->i[5];
    return fmi3OK;
}
F fmi3SetInt64(C, const fmi3ValueReference vr[], size_t n, const fmi3Int64 values[], size_t all) {
    (void)all;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] == MODE) NOW->mode = (int)values[i];
        else NOW->i[5] = values[i];
    }
    return fmi3OK;
}
F fmi3GetUInt64(C, const fmi3ValueReference vr[], size_t n, fmi3UInt64 values[], size_t all) {
    (void)all;
    for (size_t i = 0; i < n; i++) values[i] = vr[i] == N ? NOW->n : (fmi3UInt64)NOW->i[6];
    return fmi3OK;
}
F fmi3SetUInt64(C, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 values[], size_t all) {
    (void)all;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] == N && values[i] > LARGEST) return fmi3Error;
        if (vr[i] == N) NOW->n = values[i];
        else NOW->i[6] = (long long)values[i];
    }
    return fmi3OK;
}
F fmi3GetString(C, const fmi3ValueReference vr[], size_t n, fmi3String values[], size_t all) {
    (void)vr, (void)n;
    for (size_t i = 0; i < all; i++) values[i] = NOW->label;
    return fmi3OK;
}
F fmi3SetString(C, const fmi3ValueReference vr[], size_t n, const fmi3String values[], size_t all) {
    (void)vr, (void)n;
    for (size_t i = 0; i < all; i++) snprintf(NOW->label, sizeof NOW->label, "%s", values[i]);
    return fmi3OK;
}
F fmi3GetFMUState(C, fmi3FMUState *state) { return saved(c, state); }
F fmi3SetFMUState(C, fmi3FMUState state) { return restored(c, state); }
F fmi3FreeFMUState(C, fmi3FMUState *state) { (void)c; return forgotten(state); }
F fmi3GetDirectionalDerivative(C, const fmi3ValueReference z[], size_t nz, const fmi3ValueReference v[], size_t nv,
                               const fmi3Float64 dv[], size_t ndv, fmi3Float64 dz[], size_t ndz) {
    if (ndv != nv || ndz != nz) return fmi3Error;
    for (size_t i = 0; i < nz; i++) {
        dz[i] = 0.0;
        for (size_t j = 0; j < nv; j++)
            dz[i] += dv[j] * (z[i] == Y && v[j] == U ? NOW->d : z[i] == Y && v[j] == X ? 1.0 : z[i] == DX && v[j] == U ? NOW->k : 0.0);
    }
    return fmi3OK;
}
F fmi3UpdateDiscreteStates(C, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals, fmi3Boolean *states,
                           fmi3Boolean *has_next, fmi3Float64 *next) {
    *again = *terminate = *nominals = *states = false;
    if (NOW->fault == EVENT && NOW->t >= NOW->t_fault - 1e-9) NOW->done = 1;
    *has_next = (NOW->fault == EVENT && !NOW->done) || (AT_EVENTS && NOW->fault == TERMINATES);
    *next = NOW->t_fault;
    *terminate = AT_EVENTS && NOW->fault == TERMINATES && NOW->t >= NOW->t_fault;
    return fmi3OK;
}
F fmi3EnterContinuousTimeMode(C) { NOW->shown = NOW->x; return fmi3OK; }
F fmi3CompletedIntegratorStep(C, fmi3Boolean forgets, fmi3Boolean *event, fmi3Boolean *terminate) {
    (void)forgets;
    NOW->shown = NOW->x;
    *event = false, *terminate = !AT_EVENTS && NOW->fault == TERMINATES && NOW->t >= NOW->t_fault;
    return fmi3OK;
}
F fmi3SetTime(C, fmi3Float64 t) { NOW->t = t; return fmi3OK; }
F fmi3SetContinuousStates(C, const fmi3Float64 x[], size_t n) { (void)n; NOW->x = x[0]; return fmi3OK; }
F fmi3GetContinuousStateDerivatives(C, fmi3Float64 rates[], size_t n) {
    (void)n;
    rates[0] = NOW->k * NOW->u;
    return rates_fault(c);
}
F fmi3GetEventIndicators(C, fmi3Float64 z[], size_t n) { (void)n; z[0] = NOW->x - 1.0; return fmi3OK; }
F fmi3GetContinuousStates(C, fmi3Float64 x[], size_t n) { (void)n; x[0] = NOW->x; return fmi3OK; }
F fmi3GetNominalsOfContinuousStates(C, fmi3Float64 x[], size_t n) { (void)c, (void)n; x[0] = 1.0; return fmi3OK; }
F fmi3GetNumberOfEventIndicators(C, size_t *n) { (void)c; *n = 1; return fmi3OK; }
F fmi3GetNumberOfContinuousStates(C, size_t *n) { (void)c; *n = 1; return fmi3OK; }
F fmi3EnterStepMode(C) { (void)c; return fmi3OK; }
F fmi3GetOutputDerivatives(C, const fmi3ValueReference vr[], size_t n, const fmi3Int32 orders[], fmi3Float64 values[],
                           size_t all) {
    (void)vr, (void)all;
    for (size_t i = 0; i < n; i++) values[i] = orders[i] == 1 ? NOW->k * NOW->u : 0.0;
    return fmi3OK;
}
F fmi3DoStep(C, fmi3Float64 t, fmi3Float64 h, fmi3Boolean forgets, fmi3Boolean *event, fmi3Boolean *terminate,
             fmi3Boolean *early, fmi3Float64 *last) {
    (void)forgets;
    Instance *one = c;
    double end = t + h;
    *event = *terminate = *early = false;
    if (one->update != NULL && !(NOW->fault == DISCARDS_LONG && end >= NOW->t_fault - 1e-9 && h > 0.03)) {
        /* Half of the step, and u is set there for the other half. */
        double to = end;
        bool asked = false;
        advance(NOW, t + h / 2.0);
        one->update(one->environment, NOW->t, true, true, true, one->early, &asked, &to);
        if (asked) {
            *early = true, *last = NOW->t;
            return fmi3OK;
        }
    }
    int is_event = NOW->fault == EVENT && !NOW->done && end >= NOW->t_fault - 1e-9;
    int is_end = NOW->fault == TERMINATES && end >= NOW->t_fault - 1e-9;
    *terminate = is_end && !AT_EVENTS;
    is_event |= is_end && AT_EVENTS;
    int status = go(one, is_end ? fmax(NOW->t, NOW->t_fault) : end);
    *event = is_event;
    *early = NOW->last < end - 1e-9 && status == OK;
    *last = NOW->last;
    return status;
}
#endif
