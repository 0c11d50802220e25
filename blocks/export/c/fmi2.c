/* FMI 2.0.4: each call of the standard is checked here - whether this kind of instance has it, whether it is allowed in
   the present mode, its pointers, its sizes - and handed to the core. A call that does not pass tells why in the
   category logStatusError, returns fmi2Error and changes nothing. A call without an instance returns fmi2Error.
   The file is long because the standard is: it has 44 functions, and each one is here. */
#include "fmi2.h"
#include "fmu.h"

#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Statuses pass from the core to the caller as they are. */
_Static_assert((int)FMU_OK == (int)fmi2OK && (int)FMU_WARNING == (int)fmi2Warning &&
               (int)FMU_DISCARD == (int)fmi2Discard && (int)FMU_ERROR == (int)fmi2Error, "statuses differ");
_Static_assert(sizeof(fmi2ValueReference) == sizeof(uint32_t), "value references differ");

typedef struct {
    Fmu *fmu;
    char *name;
    const char *call; /* the present one, for messages */
    fmi2CallbackFunctions callbacks;
    int has_tolerance, has_stop, terminated;
    double tolerance, start, stop;
} Instance;

/* --- which calls are allowed: the tables "allowed function calls" of sections 3.2.3 and 4.2.4 of the standard ---- */
enum { ME = FMU_ME, CS = FMU_CS, BOTH = FMU_ME | FMU_CS };
enum {
    NEW = FMU_INSTANTIATED,
    INIT = FMU_INITIALIZATION,
    EVENT = FMU_EVENT,
    CONTINUOUS = FMU_CONTINUOUS,
    STEP = FMU_STEP,
    ENDED = FMU_TERMINATED | FMU_FAILED, /* after an error, what is read is for debugging only */
    RUNNING = EVENT | CONTINUOUS | STEP,
    ANY = NEW | INIT | RUNNING | ENDED
};

/* The standard does not say whether the nominal values and, in initialization mode, the derivatives can be asked for;
   its mathematical description has both, and nothing is harmed. */
#define CALLS(C)                                          \
    C(SetDebugLogging, BOTH, ANY)                         \
    C(SetupExperiment, BOTH, NEW)                         \
    C(EnterInitializationMode, BOTH, NEW)                 \
    C(ExitInitializationMode, BOTH, INIT)                 \
    C(Terminate, BOTH, RUNNING)                           \
    C(Reset, BOTH, ANY)                                   \
    C(GetReal, BOTH, INIT | RUNNING | ENDED)              \
    C(GetInteger, BOTH, INIT | RUNNING | ENDED)           \
    C(GetBoolean, BOTH, INIT | RUNNING | ENDED)           \
    C(GetString, BOTH, INIT | RUNNING | ENDED)            \
    C(SetReal, BOTH, NEW | INIT | RUNNING)                \
    C(SetInteger, BOTH, NEW | INIT | EVENT | STEP)        \
    C(SetBoolean, BOTH, NEW | INIT | EVENT | STEP)        \
    C(SetString, BOTH, NEW | INIT | EVENT | STEP)         \
    C(GetFMUstate, BOTH, ANY)                             \
    C(SetFMUstate, BOTH, ANY)                             \
    C(FreeFMUstate, BOTH, ANY)                            \
    C(SerializedFMUstateSize, BOTH, ANY)                  \
    C(SerializeFMUstate, BOTH, ANY)                       \
    C(DeSerializeFMUstate, BOTH, ANY)                     \
    C(GetDirectionalDerivative, BOTH, INIT | RUNNING | ENDED) \
    C(EnterEventMode, ME, EVENT | CONTINUOUS)             \
    C(NewDiscreteStates, ME, EVENT)                       \
    C(EnterContinuousTimeMode, ME, EVENT)                 \
    C(CompletedIntegratorStep, ME, CONTINUOUS)            \
    C(SetTime, ME, EVENT | CONTINUOUS)                    \
    C(SetContinuousStates, ME, CONTINUOUS)                \
    C(GetDerivatives, ME, INIT | RUNNING | ENDED)         \
    C(GetEventIndicators, ME, INIT | RUNNING | ENDED)     \
    C(GetContinuousStates, ME, INIT | RUNNING | ENDED)    \
    C(GetNominalsOfContinuousStates, ME, ANY)             \
    C(SetRealInputDerivatives, CS, NEW | INIT | STEP)     \
    C(GetRealOutputDerivatives, CS, STEP | ENDED)         \
    C(DoStep, CS, STEP)                                   \
    C(CancelStep, CS, 0)                                  \
    C(GetStatus, CS, STEP | FMU_TERMINATED)               \
    C(GetRealStatus, CS, STEP | FMU_TERMINATED)           \
    C(GetIntegerStatus, CS, STEP | FMU_TERMINATED)        \
    C(GetBooleanStatus, CS, STEP | FMU_TERMINATED)        \
    C(GetStringStatus, CS, STEP | FMU_TERMINATED)

#define NUMBER_OF(name, kinds, modes) CALL_##name,
enum { CALLS(NUMBER_OF) NCALLS };

#define RULE_OF(name, kinds, modes) {"fmi2" #name, kinds, modes},
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
    {"logAll", FMU_LOG_EVENTS | FMU_LOG_WARNING | FMU_LOG_ERROR | FMU_LOG_NONLINEAR}
};
enum { NCATEGORIES = sizeof CATEGORIES / sizeof CATEGORIES[0], ALL_CATEGORIES = NCATEGORIES - 1 };

static const char *mode_name(int mode)
{
    switch (mode) {
    case FMU_INSTANTIATED: return "instantiated";
    case FMU_INITIALIZATION: return "initialization mode";
    case FMU_EVENT: return "event mode";
    case FMU_CONTINUOUS: return "continuous-time mode";
    case FMU_STEP: return "between communication steps";
    case FMU_TERMINATED: return "terminated";
    case FMU_FAILED: return "failed";
    default: return "unknown";
    }
}

/* The core's messages, and those from here, on their way to the caller's logger. A message of several categories goes
   out under the first one that is on. */
static void tell(void *owner, int status, int category, const char *message)
{
    Instance *in = owner;
    const int shown = in->fmu ? category & fmu_logs(in->fmu) : category;
    int k = 0;
    while (k < ALL_CATEGORIES && !(shown & CATEGORIES[k].categories))
        k++;
    if (in->callbacks.logger)
        in->callbacks.logger(in->callbacks.componentEnvironment, in->name, (fmi2Status)status, CATEGORIES[k].name, "%s",
                             message);
}

#if defined(__GNUC__)
__attribute__((format(printf, 2, 3)))
#endif
static fmi2Status refuse(Instance *in, const char *format, ...)
{
    char why[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(why, sizeof why, format, arguments);
    va_end(arguments);
    fmu_say(in->fmu, FMU_ERROR, FMU_LOG_ERROR, "%s: %s", in->call, why);
    return fmi2Error;
}

/* The instance, where the call is allowed; else null, and it was told why. */
static Instance *enter(fmi2Component c, int call)
{
    Instance *in = c;
    if (!in)
        return NULL;
    in->call = RULES[call].name;
    if (!(RULES[call].kinds & fmu_kind(in->fmu))) {
        refuse(in, "only an instance for %s has this.", RULES[call].kinds == ME ? "Model Exchange" : "Co-Simulation");
        return NULL;
    }
    if (call == CALL_CancelStep) {
        refuse(in, "steps are never asynchronous; there is none to cancel.");
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

static int is_of(fmi2ValueReference reference, int type)
{
    const int has = fmu_type(reference);
    return has == type || (type == FMU_INTEGER && has == FMU_ENUMERATION);
}

/* Whether all references are those of elements of a type: looked at before the first one is set. */
static int all_of(Instance *in, const fmi2ValueReference vr[], size_t nvr, int type, const char *name)
{
    for (size_t i = 0; i < nvr; i++)
        if (!is_of(vr[i], type)) {
            refuse(in, "value reference %u is not that of a %s.", vr[i], name);
            return 0;
        }
    return 1;
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

/* --- both kinds ---- */
const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    Instance *in = enter(c, CALL_SetDebugLogging);
    int on = nCategories ? 0 : CATEGORIES[ALL_CATEGORIES].categories;
    if (!in || missing(in, categories, nCategories, "categories"))
        return fmi2Error;
    for (size_t i = 0; i < nCategories; i++) {
        int k = 0;
        if (missing(in, categories[i], 1, "a category"))
            return fmi2Error;
        while (k < NCATEGORIES && strcmp(categories[i], CATEGORIES[k].name) != 0)
            k++;
        if (k == NCATEGORIES)
            return refuse(in, "there is no category '%.100s'.", categories[i]);
        on |= CATEGORIES[k].categories;
    }
    fmu_log_categories(in->fmu, loggingOn ? on : 0);
    return fmi2OK;
}

static fmi2Component not_made(Instance *in, const char *why)
{
    if (why)
        tell(in, FMU_ERROR, FMU_LOG_ERROR, why);
    free(in->name);
    free(in);
    return NULL;
}

/* Why there is no instance is told whether logging is on or not: nobody could ask for it afterwards. */
fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    const char *given = instanceName ? instanceName : "";
    Instance *in = functions ? calloc(1, sizeof *in) : NULL;
    (void)fmuResourceLocation;
    (void)visible;
    if (!in)
        return NULL;
    in->callbacks = *functions;
    in->name = malloc(strlen(given) + 1);
    if (!in->name)
        return not_made(in, NULL);
    strcpy(in->name, given);
    if (!given[strspn(given, " \t\r\n")])
        return not_made(in, "fmi2Instantiate: the instance has no name.");
    if (!fmuGUID)
        return not_made(in, "fmi2Instantiate: fmuGUID is a null pointer.");
    if (fmuType != fmi2ModelExchange && fmuType != fmi2CoSimulation)
        return not_made(in, "fmi2Instantiate: fmuType is neither fmi2ModelExchange nor fmi2CoSimulation.");
    in->fmu = fmu_new(fmuType == fmi2ModelExchange ? FMU_ME : FMU_CS, in->name, fmuGUID, tell, in);
    if (!in->fmu)
        return not_made(in, NULL);
    fmu_log_categories(in->fmu, loggingOn ? CATEGORIES[ALL_CATEGORIES].categories : 0);
    return in;
}

void fmi2FreeInstance(fmi2Component c)
{
    Instance *in = c;
    if (!in)
        return;
    fmu_free(in->fmu);
    free(in->name);
    free(in);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    Instance *in = enter(c, CALL_SetupExperiment);
    if (!in)
        return fmi2Error;
    if (toleranceDefined && !(isfinite(tolerance) && tolerance > 0))
        return refuse(in, "the tolerance is %g; it must be positive.", tolerance);
    if (!isfinite(startTime))
        return refuse(in, "the start time is %g.", startTime);
    if (stopTimeDefined && !(isfinite(stopTime) && stopTime >= startTime))
        return refuse(in, "the stop time is %.17g, the start time %.17g.", stopTime, startTime);
    in->has_tolerance = toleranceDefined;
    in->tolerance = tolerance;
    in->start = startTime;
    in->has_stop = stopTimeDefined;
    in->stop = stopTime;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *in = enter(c, CALL_EnterInitializationMode);
    return in ? (fmi2Status)fmu_enter_initialization(in->fmu, in->has_tolerance, in->tolerance, in->start,
                                                     in->has_stop, in->stop)
              : fmi2Error;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Instance *in = enter(c, CALL_ExitInitializationMode);
    return in ? (fmi2Status)fmu_exit_initialization(in->fmu, 0) : fmi2Error;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    Instance *in = enter(c, CALL_Terminate);
    if (!in)
        return fmi2Error;
    fmu_set_mode(in->fmu, FMU_TERMINATED);
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    Instance *in = enter(c, CALL_Reset);
    if (!in)
        return fmi2Error;
    in->has_tolerance = in->has_stop = in->terminated = 0;
    in->tolerance = in->start = in->stop = 0;
    return (fmi2Status)fmu_reset(in->fmu);
}

/* --- variables: one element for each reference ---- */
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    Instance *in = enter(c, CALL_GetReal);
    int status = FMU_OK;
    if (!in || missing(in, vr, nvr, "vr") || missing(in, value, nvr, "value"))
        return fmi2Error;
    for (size_t i = 0; i < nvr && status < FMU_DISCARD; i++) {
        const int got = fmu_get(in->fmu, vr[i], FMU_REAL, &value[i], 1);
        status = got > status ? got : status;
    }
    return (fmi2Status)status;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[])
{
    Instance *in = enter(c, CALL_GetInteger);
    int status = FMU_OK;
    if (!in || missing(in, vr, nvr, "vr") || missing(in, value, nvr, "value") ||
        !all_of(in, vr, nvr, FMU_INTEGER, "Integer or an Enumeration"))
        return fmi2Error;
    for (size_t i = 0; i < nvr && status < FMU_DISCARD; i++) {
        double number = 0;
        const int got = fmu_get(in->fmu, vr[i], fmu_type(vr[i]), &number, 1);
        status = got > status ? got : status;
        if (status >= FMU_DISCARD)
            break;
        if (!(number >= INT32_MIN && number <= INT32_MAX))
            return refuse(in, "value reference %u has %.17g, which is beyond an fmi2Integer.", vr[i], number);
        value[i] = (fmi2Integer)number;
    }
    return (fmi2Status)status;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[])
{
    Instance *in = enter(c, CALL_GetBoolean);
    int status = FMU_OK;
    if (!in || missing(in, vr, nvr, "vr") || missing(in, value, nvr, "value"))
        return fmi2Error;
    for (size_t i = 0; i < nvr && status < FMU_DISCARD; i++) {
        double number = 0;
        const int got = fmu_get(in->fmu, vr[i], FMU_BOOLEAN, &number, 1);
        status = got > status ? got : status;
        if (status < FMU_DISCARD)
            value[i] = number != 0 ? fmi2True : fmi2False;
    }
    return (fmi2Status)status;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    Instance *in = enter(c, CALL_GetString);
    if (!in || missing(in, vr, nvr, "vr") || missing(in, value, nvr, "value"))
        return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        const char *text = fmu_get_string(in->fmu, vr[i]);
        if (!text)
            return fmi2Error;
        value[i] = text;
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    Instance *in = enter(c, CALL_SetReal);
    int status = FMU_OK;
    if (!in || missing(in, vr, nvr, "vr") || missing(in, value, nvr, "value") ||
        !all_of(in, vr, nvr, FMU_REAL, "Real") || !all_finite(in, value, nvr))
        return fmi2Error;
    for (int checked = 0; checked < 2; checked++) /* all of them, or none */
        for (size_t i = 0; i < nvr && status < FMU_DISCARD; i++) {
            const int set = (checked ? fmu_set : fmu_check)(in->fmu, vr[i], FMU_REAL, &value[i], 1);
            status = set > status ? set : status;
        }
    return (fmi2Status)status;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer value[])
{
    Instance *in = enter(c, CALL_SetInteger);
    int status = FMU_OK;
    if (!in || missing(in, vr, nvr, "vr") || missing(in, value, nvr, "value") ||
        !all_of(in, vr, nvr, FMU_INTEGER, "Integer or an Enumeration"))
        return fmi2Error;
    for (int checked = 0; checked < 2; checked++) /* all of them, or none */
        for (size_t i = 0; i < nvr && status < FMU_DISCARD; i++) {
            const double number = value[i];
            const int set = (checked ? fmu_set : fmu_check)(in->fmu, vr[i], fmu_type(vr[i]), &number, 1);
            status = set > status ? set : status;
        }
    return (fmi2Status)status;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Boolean value[])
{
    Instance *in = enter(c, CALL_SetBoolean);
    int status = FMU_OK;
    if (!in || missing(in, vr, nvr, "vr") || missing(in, value, nvr, "value") ||
        !all_of(in, vr, nvr, FMU_BOOLEAN, "Boolean"))
        return fmi2Error;
    for (int checked = 0; checked < 2; checked++) /* all of them, or none */
        for (size_t i = 0; i < nvr && status < FMU_DISCARD; i++) {
            const double number = value[i] ? 1 : 0;
            const int set = (checked ? fmu_set : fmu_check)(in->fmu, vr[i], FMU_BOOLEAN, &number, 1);
            status = set > status ? set : status;
        }
    return (fmi2Status)status;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[])
{
    Instance *in = enter(c, CALL_SetString);
    if (!in || missing(in, vr, nvr, "vr") || missing(in, value, nvr, "value"))
        return fmi2Error;
    return nvr ? refuse(in, "no String of this FMU can be set.") : fmi2OK;
}

/* --- states of the FMU ---- */
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    Instance *in = enter(c, CALL_GetFMUstate);
    if (!in || missing(in, FMUstate, 1, "FMUstate"))
        return fmi2Error;
    FmuSaved *saved = *FMUstate;
    const int status = fmu_save(in->fmu, &saved);
    *FMUstate = saved;
    return (fmi2Status)status;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    Instance *in = enter(c, CALL_SetFMUstate);
    if (!in || missing(in, FMUstate, 1, "FMUstate"))
        return fmi2Error;
    in->terminated = 0;
    return (fmi2Status)fmu_restore(in->fmu, FMUstate);
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    Instance *in = enter(c, CALL_FreeFMUstate);
    if (!in)
        return fmi2Error;
    if (FMUstate && *FMUstate) {
        fmu_forget(*FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    Instance *in = enter(c, CALL_SerializedFMUstateSize);
    if (!in || missing(in, FMUstate, 1, "FMUstate") || missing(in, size, 1, "size"))
        return fmi2Error;
    *size = fmu_saved_bytes(FMUstate);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    Instance *in = enter(c, CALL_SerializeFMUstate);
    if (!in || missing(in, FMUstate, 1, "FMUstate") || missing(in, serializedState, 1, "serializedState"))
        return fmi2Error;
    if (size != fmu_saved_bytes(FMUstate))
        return refuse(in, "the state has %zu bytes, not %zu.", fmu_saved_bytes(FMUstate), size);
    return (fmi2Status)fmu_serialize(in->fmu, FMUstate, (unsigned char *)serializedState, size);
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    Instance *in = enter(c, CALL_DeSerializeFMUstate);
    FmuSaved *saved = NULL;
    if (!in || missing(in, serializedState, 1, "serializedState") || missing(in, FMUstate, 1, "FMUstate"))
        return fmi2Error;
    const int status = fmu_deserialize(in->fmu, (const unsigned char *)serializedState, size, &saved);
    if (status < FMU_DISCARD)
        *FMUstate = saved;
    return (fmi2Status)status;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown,
                                        const fmi2Real dvKnown[], fmi2Real dvUnknown[])
{
    Instance *in = enter(c, CALL_GetDirectionalDerivative);
    if (!in || missing(in, vUnknown_ref, nUnknown, "vUnknown_ref") || missing(in, vKnown_ref, nKnown, "vKnown_ref") ||
        missing(in, dvKnown, nKnown, "dvKnown") || missing(in, dvUnknown, nUnknown, "dvUnknown") ||
        !all_of(in, vUnknown_ref, nUnknown, FMU_REAL, "Real") || !all_of(in, vKnown_ref, nKnown, FMU_REAL, "Real") ||
        !all_finite(in, dvKnown, nKnown))
        return fmi2Error;
    return (fmi2Status)fmu_directional(in->fmu, vUnknown_ref, nUnknown, vKnown_ref, nKnown, dvKnown, dvUnknown, 0);
}

/* --- Model Exchange ---- */
fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    Instance *in = enter(c, CALL_EnterEventMode);
    if (!in)
        return fmi2Error;
    /* The standard allows it in event mode too, where there is nothing to enter. */
    return fmu_mode(in->fmu) == FMU_EVENT ? fmi2OK : (fmi2Status)fmu_enter_event_mode(in->fmu);
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo)
{
    Instance *in = enter(c, CALL_NewDiscreteStates);
    FmuEvents events = {0};
    if (!in || missing(in, eventInfo, 1, "eventInfo"))
        return fmi2Error;
    const int status = fmu_update_discrete_states(in->fmu, &events);
    if (status < FMU_DISCARD) {
        eventInfo->newDiscreteStatesNeeded = events.needs_update;
        eventInfo->terminateSimulation = events.terminate;
        eventInfo->nominalsOfContinuousStatesChanged = events.nominals_changed;
        eventInfo->valuesOfContinuousStatesChanged = events.states_changed;
        eventInfo->nextEventTimeDefined = events.has_next;
        eventInfo->nextEventTime = events.has_next ? events.next : 0;
    }
    return (fmi2Status)status;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    Instance *in = enter(c, CALL_EnterContinuousTimeMode);
    return in ? (fmi2Status)fmu_enter_continuous_mode(in->fmu) : fmi2Error;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation)
{
    Instance *in = enter(c, CALL_CompletedIntegratorStep);
    int event = 0, terminate = 0;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!in || missing(in, enterEventMode, 1, "enterEventMode") ||
        missing(in, terminateSimulation, 1, "terminateSimulation"))
        return fmi2Error;
    const int status = fmu_completed_step(in->fmu, &event, &terminate);
    *enterEventMode = event ? fmi2True : fmi2False;
    *terminateSimulation = terminate ? fmi2True : fmi2False;
    return (fmi2Status)status;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    Instance *in = enter(c, CALL_SetTime);
    if (!in || !all_finite(in, &time, 1))
        return fmi2Error;
    return (fmi2Status)fmu_set_time(in->fmu, time);
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx)
{
    Instance *in = enter(c, CALL_SetContinuousStates);
    if (!in || wrong_size(in, x, nx, fmu_number_of_states()) || !all_finite(in, x, nx))
        return fmi2Error;
    return (fmi2Status)fmu_set_states(in->fmu, x, nx);
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx)
{
    Instance *in = enter(c, CALL_GetDerivatives);
    if (!in || wrong_size(in, derivatives, nx, fmu_number_of_states()))
        return fmi2Error;
    return (fmi2Status)fmu_get_rates(in->fmu, derivatives, nx);
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni)
{
    Instance *in = enter(c, CALL_GetEventIndicators);
    if (!in || wrong_size(in, eventIndicators, ni, fmu_number_of_indicators()))
        return fmi2Error;
    return (fmi2Status)fmu_get_indicators(in->fmu, eventIndicators, ni);
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx)
{
    Instance *in = enter(c, CALL_GetContinuousStates);
    if (!in || wrong_size(in, x, nx, fmu_number_of_states()))
        return fmi2Error;
    return (fmi2Status)fmu_get_states(in->fmu, x, nx);
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx)
{
    Instance *in = enter(c, CALL_GetNominalsOfContinuousStates);
    if (!in || wrong_size(in, x_nominal, nx, fmu_number_of_states()))
        return fmi2Error;
    return (fmi2Status)fmu_get_nominals(in->fmu, x_nominal, nx);
}

/* --- Co-Simulation ---- */
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    Instance *in = enter(c, CALL_SetRealInputDerivatives);
    int status = FMU_OK;
    if (!in || missing(in, vr, nvr, "vr") || missing(in, order, nvr, "order") || missing(in, value, nvr, "value") ||
        !all_of(in, vr, nvr, FMU_REAL, "Real") || !all_finite(in, value, nvr))
        return fmi2Error;
    for (size_t i = 0; i < nvr && status < FMU_DISCARD; i++) {
        const int set = fmu_set_input_derivative(in->fmu, vr[i], order[i], value[i]);
        status = set > status ? set : status;
    }
    return (fmi2Status)status;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[])
{
    Instance *in = enter(c, CALL_GetRealOutputDerivatives);
    if (!in || missing(in, vr, nvr, "vr") || missing(in, order, nvr, "order") || missing(in, value, nvr, "value"))
        return fmi2Error;
    return nvr ? refuse(in, "derivatives of outputs are not given (maxOutputDerivativeOrder is 0).") : fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    Instance *in = enter(c, CALL_DoStep);
    FmuStep step = {0};
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!in)
        return fmi2Error;
    if (!isfinite(currentCommunicationPoint) || !isfinite(communicationStepSize) || !(communicationStepSize > 0))
        return refuse(in, "a step from %.17g s by %.17g s; its size must be positive.", currentCommunicationPoint,
                      communicationStepSize);
    const int status = fmu_step(in->fmu, currentCommunicationPoint, communicationStepSize, 0, NULL, NULL, &step);
    /* The end of a run that the model asks for is a discarded step here, and fmi2GetBooleanStatus gives the reason. */
    in->terminated = status < FMU_ERROR && step.terminate;
    return in->terminated ? fmi2Discard : (fmi2Status)status;
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    enter(c, CALL_CancelStep);
    return fmi2Error;
}

static fmi2Status no_status(Instance *in)
{
    fmu_say(in->fmu, FMU_DISCARD, FMU_LOG_WARNING, "%s: there is no such status; steps are never asynchronous.",
            in->call);
    return fmi2Discard;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    Instance *in = enter(c, CALL_GetStatus);
    (void)s;
    return in && !missing(in, value, 1, "value") ? no_status(in) : fmi2Error;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    Instance *in = enter(c, CALL_GetRealStatus);
    if (!in || missing(in, value, 1, "value"))
        return fmi2Error;
    if (s != fmi2LastSuccessfulTime)
        return no_status(in);
    *value = fmu_time(in->fmu);
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    Instance *in = enter(c, CALL_GetIntegerStatus);
    (void)s;
    return in && !missing(in, value, 1, "value") ? no_status(in) : fmi2Error;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    Instance *in = enter(c, CALL_GetBooleanStatus);
    if (!in || missing(in, value, 1, "value"))
        return fmi2Error;
    if (s != fmi2Terminated)
        return no_status(in);
    *value = in->terminated ? fmi2True : fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    Instance *in = enter(c, CALL_GetStringStatus);
    (void)s;
    return in && !missing(in, value, 1, "value") ? no_status(in) : fmi2Error;
}
