/* What fmi2.c and fmi3.c have in common: which calls are allowed, messages, and the functions that both versions have
   alike. They include it behind their standard's header, and define before it:

       FMI(name)           the name with its prefix
       STATE(verb, rest)   the name of a function of states, without its prefix
       Instance            with the members `fmu` and `call`
       CALLS(C)            C(name, kinds, modes) for each call that is allowed for some kinds of instances in some modes
       ELEMENTS(reference) how many values a value reference stands for
       STEP_MODE           what the mode between communication steps is called */
#ifndef BLOCKS_STANDARD_H
#define BLOCKS_STANDARD_H

#include "fmu.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef FMI(Status) Status;
typedef FMI(Boolean) Boolean;
typedef FMI(ValueReference) Reference;

/* Statuses pass from the core to the caller as they are. */
_Static_assert((int)FMU_OK == (int)FMI(OK) && (int)FMU_WARNING == (int)FMI(Warning) &&
               (int)FMU_DISCARD == (int)FMI(Discard) && (int)FMU_ERROR == (int)FMI(Error), "statuses differ");
_Static_assert(sizeof(Reference) == sizeof(uint32_t), "value references differ");

/* --- which calls are allowed ---- */
enum { ME = FMU_ME, CS = FMU_CS, BOTH = FMU_ME | FMU_CS };
enum {
    NEVER = 0,
    NEW = FMU_INSTANTIATED,
    INIT = FMU_INITIALIZATION,
    EVENT = FMU_EVENT,
    CONTINUOUS = FMU_CONTINUOUS,
    STEP = FMU_STEP,
    INSIDE = FMU_INTERMEDIATE,
    ASKED = FMU_ASKING,
    ENDED = FMU_TERMINATED | FMU_FAILED, /* after an error, what is read is for debugging only */
    RUNNING = EVENT | CONTINUOUS | STEP,
    SETABLE = NEW | INIT | RUNNING | ENDED /* the super state FMU State Setable of FMI 3; in FMI 2 all states */
};

#define NUMBER_OF(name, kinds, modes) CALL_##name,
enum { CALLS(NUMBER_OF) NCALLS };

#define TEXT_OF(token) #token
#define TEXT(token) TEXT_OF(token)
#define RULE_OF(name, kinds, modes) {TEXT(FMI(name)), kinds, modes},
static const struct {
    const char *name;
    int kinds, modes;
} RULES[NCALLS] = {CALLS(RULE_OF)};

static const struct {
    const char *name;
    int categories;
} CATEGORIES[] = {
    {"logEvents", FMU_LOG_EVENTS},
    {"logStatusWarning", FMU_LOG_WARNING},
    {"logStatusError", FMU_LOG_ERROR},
    {"logNonlinearSystems", FMU_LOG_NONLINEAR},
    {"logTrace", FMU_LOG_TRACE}, /* so many that they must be asked for by this name */
    {"logAll", FMU_LOG_EVENTS | FMU_LOG_WARNING | FMU_LOG_ERROR | FMU_LOG_NONLINEAR}
};
enum { NCATEGORIES = sizeof CATEGORIES / sizeof CATEGORIES[0], ALL_CATEGORIES = NCATEGORIES - 1 };

/* By the caller's logger, where there is one. */
static void log_message(const Instance *in, Status status, const char *category, const char *message);
/* Why a call is allowed in no mode. */
static const char *why_never(int call);

static const char *mode_name(int mode)
{
    switch (mode) {
    case FMU_INSTANTIATED: return "instantiated";
    case FMU_INITIALIZATION: return "initialization mode";
    case FMU_EVENT: return "event mode";
    case FMU_CONTINUOUS: return "continuous-time mode";
    case FMU_STEP: return STEP_MODE;
    case FMU_INTERMEDIATE: return "intermediate update mode";
    case FMU_ASKING: return "intermediate update mode, where inputs are asked for";
    case FMU_TERMINATED: return "terminated";
    case FMU_FAILED: return "failed";
    default: return "unknown";
    }
}

/* The core's messages, and those from here, on their way to the caller's logger. A message of several categories goes
   out under the first one that is on. */
static void tell(void *owner, int status, int category, const char *message)
{
    const Instance *in = owner;
    const int shown = in->fmu ? category & fmu_logs(in->fmu) : category;
    int k = 0;
    while (k < ALL_CATEGORIES && !(shown & CATEGORIES[k].categories))
        k++;
    log_message(in, (Status)status, CATEGORIES[k].name, message);
}

#if defined(__GNUC__)
__attribute__((format(printf, 2, 3)))
#endif
static Status refuse(Instance *in, const char *format, ...)
{
    char why[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(why, sizeof why, format, arguments);
    va_end(arguments);
    fmu_say(in->fmu, FMU_ERROR, FMU_LOG_ERROR, "%s: %s", in->call, why);
    return FMI(Error);
}

/* The instance, where the call is allowed; else null, and it was told why. */
static Instance *enter(void *instance, int call)
{
    Instance *in = instance;
    if (!in)
        return NULL;
    in->call = RULES[call].name;
    if (!(RULES[call].kinds & fmu_kind(in->fmu))) {
        refuse(in, "only an instance for %s has this.", RULES[call].kinds == ME ? "Model Exchange" : "Co-Simulation");
        return NULL;
    }
    if (RULES[call].modes == NEVER) {
        refuse(in, "%s.", why_never(call));
        return NULL;
    }
    if (!(RULES[call].modes & fmu_mode(in->fmu))) {
        refuse(in, "not allowed now (%s).", mode_name(fmu_mode(in->fmu)));
        return NULL;
    }
    return in;
}

static int missing(Instance *in, const void *pointer, size_t count, const char *what)
{
    if (count > 0 && !pointer) {
        refuse(in, "%s is a null pointer.", what);
        return 1;
    }
    return 0;
}

static int wrong_size(Instance *in, const void *values, size_t given, size_t wanted)
{
    if (given != wanted) {
        refuse(in, "there are %zu values, not %zu.", wanted, given);
        return 1;
    }
    return missing(in, values, wanted, "the array of values");
}

static int all_finite(Instance *in, const double values[], size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!isfinite(values[i])) {
            refuse(in, "value %zu is %g.", i, values[i]);
            return 0;
        }
    return 1;
}

static int is_of(Reference reference, int type)
{
    const int has = fmu_type(reference);
    return has == type || (type == FMU_INTEGER && has == FMU_ENUMERATION);
}

/* --- variables: each reference stands for ELEMENTS(reference) values ---- */
static int worse(int one, int other)
{
    return one > other ? one : other;
}

static Status get_reals(Instance *in, const Reference references[], size_t count, double values[])
{
    int status = FMU_OK;
    for (size_t i = 0, at = 0; i < count && status < FMU_DISCARD; i++) {
        const size_t size = ELEMENTS(references[i]);
        status = worse(status, fmu_get(in->fmu, references[i], FMU_REAL, values + at, size));
        at += size;
    }
    return (Status)status;
}

static Status set_reals(Instance *in, const Reference references[], size_t count, const double values[])
{
    int status = FMU_OK;
    for (int checked = 0; checked < 2; checked++) /* all of them, or none */
        for (size_t i = 0, at = 0; i < count && status < FMU_DISCARD; i++) {
            const size_t size = ELEMENTS(references[i]);
            const int set = (checked ? fmu_set : fmu_check)(in->fmu, references[i], FMU_REAL, values + at, size);
            status = worse(status, set);
            at += size;
        }
    return (Status)status;
}

/* Numbers in another type than double: value `at` as a number, or a number put there, where it fits. */
typedef double (*Taken)(const void *values, size_t at);
typedef int (*Put)(Instance *in, Reference variable, void *values, size_t at, double number);

static int own_type(Reference reference, int type)
{
    return type == FMU_INTEGER ? fmu_type(reference) : type;
}

static Status get_numbers(Instance *in, const Reference references[], size_t count, int type, void *values, Put put)
{
    int status = FMU_OK;
    for (size_t i = 0, at = 0; i < count; i++)
        for (size_t k = 0, size = ELEMENTS(references[i]); k < size; k++, at++) {
            const Reference reference = references[i] + (Reference)k;
            double number = 0;
            status = worse(status, fmu_get(in->fmu, reference, own_type(reference, type), &number, 1));
            if (status >= FMU_DISCARD)
                return (Status)status;
            if (!put(in, references[i], values, at, number))
                return FMI(Error);
        }
    return (Status)status;
}

static Status set_numbers(Instance *in, const Reference references[], size_t count, int type, const void *values,
                          Taken taken)
{
    int status = FMU_OK;
    for (int checked = 0; checked < 2; checked++) /* all of them, or none */
        for (size_t i = 0, at = 0; i < count; i++)
            for (size_t k = 0, size = ELEMENTS(references[i]); k < size; k++, at++) {
                const Reference reference = references[i] + (Reference)k;
                const double number = taken(values, at);
                status = worse(status, (checked ? fmu_set : fmu_check)(in->fmu, reference, own_type(reference, type),
                                                                       &number, 1));
                if (status >= FMU_DISCARD)
                    return (Status)status;
            }
    return (Status)status;
}

static int put_boolean(Instance *in, Reference variable, void *values, size_t at, double number)
{
    (void)in, (void)variable;
    ((Boolean *)values)[at] = number != 0;
    return 1;
}

static double boolean_at(const void *values, size_t at)
{
    return ((const Boolean *)values)[at] ? 1 : 0;
}

static Status get_strings(Instance *in, const Reference references[], size_t count, const char *values[])
{
    for (size_t i = 0, at = 0; i < count; i++)
        for (size_t k = 0, size = ELEMENTS(references[i]); k < size; k++) {
            const char *text = fmu_get_string(in->fmu, references[i] + (Reference)k);
            if (!text)
                return FMI(Error);
            values[at++] = text;
        }
    return FMI(OK);
}

/* --- life ---- */
const char *FMI(GetVersion)(void)
{
    return FMI(Version);
}

Status FMI(SetDebugLogging)(void *instance, Boolean loggingOn, size_t nCategories, const char *const categories[])
{
    Instance *in = enter(instance, CALL_SetDebugLogging);
    int on = nCategories ? 0 : CATEGORIES[ALL_CATEGORIES].categories;
    if (!in || missing(in, categories, nCategories, "categories"))
        return FMI(Error);
    for (size_t i = 0; i < nCategories; i++) {
        int k = 0;
        if (missing(in, categories[i], 1, "a category"))
            return FMI(Error);
        while (k < NCATEGORIES && strcmp(categories[i], CATEGORIES[k].name) != 0)
            k++;
        if (k == NCATEGORIES || (CATEGORIES[k].categories == FMU_LOG_TRACE && !fmu_has_traces()))
            return refuse(in, "there is no category '%.100s'.", categories[i]);
        on |= CATEGORIES[k].categories;
    }
    fmu_log_categories(in->fmu, loggingOn ? on : 0);
    return FMI(OK);
}

/* Whether it was told what is wrong with the times and the tolerance of an experiment. */
static int wrong_experiment(Instance *in, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    if (has_tolerance && !(isfinite(tolerance) && tolerance > 0))
        refuse(in, "the tolerance is %g; it must be positive.", tolerance);
    else if (!isfinite(start))
        refuse(in, "the start time is %g.", start);
    else if (has_stop && !(isfinite(stop) && stop >= start))
        refuse(in, "the stop time is %.17g, the start time %.17g.", stop, start);
    else
        return 0;
    return 1;
}

Status FMI(Terminate)(void *instance)
{
    Instance *in = enter(instance, CALL_Terminate);
    if (!in)
        return FMI(Error);
    fmu_set_mode(in->fmu, FMU_TERMINATED);
    return FMI(OK);
}

/* --- states of the FMU ---- */
#define STATE_CALL(verb, rest) CALL_OF(STATE(verb, rest))
#define CALL_OF(name) CALL_PASTED(name)
#define CALL_PASTED(name) CALL_##name

Status FMI(STATE(Get, ))(void *instance, void **state)
{
    Instance *in = enter(instance, STATE_CALL(Get, ));
    if (!in || missing(in, state, 1, TEXT(STATE(, ))))
        return FMI(Error);
    FmuSaved *saved = *state;
    const int status = fmu_save(in->fmu, &saved);
    *state = saved;
    return (Status)status;
}

Status FMI(STATE(Free, ))(void *instance, void **state)
{
    Instance *in = enter(instance, STATE_CALL(Free, ));
    if (!in)
        return FMI(Error);
    if (state && *state) {
        fmu_forget(*state);
        *state = NULL;
    }
    return FMI(OK);
}

Status FMI(STATE(Serialized, Size))(void *instance, void *state, size_t *size)
{
    Instance *in = enter(instance, STATE_CALL(Serialized, Size));
    if (!in || missing(in, state, 1, TEXT(STATE(, ))) || missing(in, size, 1, "size"))
        return FMI(Error);
    *size = fmu_saved_bytes(state);
    return FMI(OK);
}

Status FMI(STATE(Serialize, ))(void *instance, void *state, FMI(Byte) serializedState[], size_t size)
{
    Instance *in = enter(instance, STATE_CALL(Serialize, ));
    if (!in || missing(in, state, 1, TEXT(STATE(, ))) || missing(in, serializedState, 1, "serializedState"))
        return FMI(Error);
    if (size != fmu_saved_bytes(state))
        return refuse(in, "the state has %zu bytes, not %zu.", fmu_saved_bytes(state), size);
    return (Status)fmu_serialize(in->fmu, state, (unsigned char *)serializedState, size);
}

Status FMI(STATE(DESERIALIZE, ))(void *instance, const FMI(Byte) serializedState[], size_t size, void **state)
{
    Instance *in = enter(instance, STATE_CALL(DESERIALIZE, ));
    FmuSaved *saved = NULL;
    if (!in || missing(in, serializedState, 1, "serializedState") || missing(in, state, 1, TEXT(STATE(, ))))
        return FMI(Error);
    const int status = fmu_deserialize(in->fmu, (const unsigned char *)serializedState, size, &saved);
    if (status < FMU_DISCARD)
        *state = saved;
    return (Status)status;
}

/* --- Model Exchange ---- */
Status FMI(EnterContinuousTimeMode)(void *instance)
{
    Instance *in = enter(instance, CALL_EnterContinuousTimeMode);
    return in ? (Status)fmu_enter_continuous_mode(in->fmu) : FMI(Error);
}

Status FMI(CompletedIntegratorStep)(void *instance, Boolean noSetFMUStatePriorToCurrentPoint, Boolean *enterEventMode,
                                    Boolean *terminateSimulation)
{
    Instance *in = enter(instance, CALL_CompletedIntegratorStep);
    int event = 0, terminate = 0;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!in || missing(in, enterEventMode, 1, "enterEventMode") ||
        missing(in, terminateSimulation, 1, "terminateSimulation"))
        return FMI(Error);
    const int status = fmu_completed_step(in->fmu, &event, &terminate);
    *enterEventMode = event != 0;
    *terminateSimulation = terminate != 0;
    return (Status)status;
}

Status FMI(SetTime)(void *instance, double time)
{
    Instance *in = enter(instance, CALL_SetTime);
    if (!in || !all_finite(in, &time, 1))
        return FMI(Error);
    return (Status)fmu_set_time(in->fmu, time);
}

Status FMI(SetContinuousStates)(void *instance, const double states[], size_t count)
{
    Instance *in = enter(instance, CALL_SetContinuousStates);
    if (!in || wrong_size(in, states, count, fmu_number_of_states()) || !all_finite(in, states, count))
        return FMI(Error);
    return (Status)fmu_set_states(in->fmu, states, count);
}

#define VECTOR(called, size, get)                                       \
    Status FMI(called)(void *instance, double values[], size_t count)   \
    {                                                                   \
        Instance *in = enter(instance, CALL_OF(called));                \
        if (!in || wrong_size(in, values, count, size()))               \
            return FMI(Error);                                          \
        return (Status)get(in->fmu, values, count);                     \
    }
VECTOR(DERIVATIVES, fmu_number_of_states, fmu_get_rates)
VECTOR(GetEventIndicators, fmu_number_of_indicators, fmu_get_indicators)
VECTOR(GetContinuousStates, fmu_number_of_states, fmu_get_states)
VECTOR(GetNominalsOfContinuousStates, fmu_number_of_states, fmu_get_nominals)

/* --- Co-Simulation ---- */
/* Whether it was told what is wrong with a step. */
static int wrong_step(Instance *in, double point, double size)
{
    if (isfinite(point) && isfinite(size) && size > 0)
        return 0;
    refuse(in, "a step from %.17g s by %.17g s; its size must be positive.", point, size);
    return 1;
}

#endif
