/* FMI 3.0.2: each call of the standard is checked here - whether this kind of instance has it, whether it is allowed in
   the present mode, its pointers, its sizes - and handed to the core. A call that does not pass tells why in the
   category logStatusError, returns fmi3Error and changes nothing. A call without an instance returns fmi3Error.

   There are variables of the types Float64, Int64 (enumerations too), Boolean and String. There are no clocks, no
   structural parameters, no scheduled execution: their functions say so. The file is long because the standard is: it
   has 75 functions, and each one is here. */
#include "fmi3.h"
#include "fmu.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Statuses pass from the core to the caller as they are. */
_Static_assert((int)FMU_OK == (int)fmi3OK && (int)FMU_WARNING == (int)fmi3Warning &&
               (int)FMU_DISCARD == (int)fmi3Discard && (int)FMU_ERROR == (int)fmi3Error, "statuses differ");

typedef struct {
    Fmu *fmu;
    const char *call; /* the present one, for messages */
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    fmi3IntermediateUpdateCallback intermediate;
    int has_event_mode, may_return_early;
} Instance;

/* --- which calls are allowed: "allowed function calls" of sections 2.3, 3.2.1 and 4.2.1 of the standard ---- */
enum { ME = FMU_ME, CS = FMU_CS, BOTH = FMU_ME | FMU_CS };
enum {
    NEW = FMU_INSTANTIATED,
    INIT = FMU_INITIALIZATION,
    EVENT = FMU_EVENT,
    CONTINUOUS = FMU_CONTINUOUS,
    STEP = FMU_STEP,
    INSIDE = FMU_INTERMEDIATE,
    ASKED = FMU_ASKING,
    ENDED = FMU_TERMINATED | FMU_FAILED, /* after an error, what is read is for debugging only */
    RUNNING = EVENT | CONTINUOUS | STEP,
    SETABLE = NEW | INIT | RUNNING | ENDED, /* the super state FMU State Setable */
    ANY = SETABLE | INSIDE | ASKED,
    GETS = SETABLE,
    SETS = NEW | INIT | EVENT | STEP,
    NEVER = 0
};

/* Within an intermediate update only continuous variables are at hand, which are all Float64. Where it asks for inputs
   that lie ahead, they can be set, and nothing can be read. */
#define CALLS(C)                                      \
    C(SetDebugLogging, BOTH, ANY)                     \
    C(EnterInitializationMode, BOTH, NEW)             \
    C(ExitInitializationMode, BOTH, INIT)             \
    C(EnterEventMode, BOTH, CONTINUOUS | STEP)        \
    C(Terminate, BOTH, RUNNING)                       \
    C(Reset, BOTH, SETABLE)                           \
    C(GetFloat32, BOTH, GETS | INSIDE)                \
    C(GetFloat64, BOTH, GETS | INSIDE)                \
    C(GetInt8, BOTH, GETS)                            \
    C(GetUInt8, BOTH, GETS)                           \
    C(GetInt16, BOTH, GETS)                           \
    C(GetUInt16, BOTH, GETS)                          \
    C(GetInt32, BOTH, GETS)                           \
    C(GetUInt32, BOTH, GETS)                          \
    C(GetInt64, BOTH, GETS)                           \
    C(GetUInt64, BOTH, GETS)                          \
    C(GetBoolean, BOTH, GETS)                         \
    C(GetString, BOTH, GETS)                          \
    C(GetBinary, BOTH, GETS)                          \
    C(GetClock, BOTH, EVENT)                          \
    C(SetFloat32, BOTH, SETS | CONTINUOUS | INSIDE | ASKED) \
    C(SetFloat64, BOTH, SETS | CONTINUOUS | INSIDE | ASKED) \
    C(SetInt8, BOTH, SETS)                            \
    C(SetUInt8, BOTH, SETS)                           \
    C(SetInt16, BOTH, SETS)                           \
    C(SetUInt16, BOTH, SETS)                          \
    C(SetInt32, BOTH, SETS)                           \
    C(SetUInt32, BOTH, SETS)                          \
    C(SetInt64, BOTH, SETS)                           \
    C(SetUInt64, BOTH, SETS)                          \
    C(SetBoolean, BOTH, SETS)                         \
    C(SetString, BOTH, SETS)                          \
    C(SetBinary, BOTH, SETS)                          \
    C(SetClock, BOTH, EVENT)                          \
    C(GetNumberOfVariableDependencies, BOTH, SETABLE) \
    C(GetVariableDependencies, BOTH, SETABLE)         \
    C(GetFMUState, BOTH, SETABLE)                     \
    C(SetFMUState, BOTH, SETABLE)                     \
    C(FreeFMUState, BOTH, SETABLE)                    \
    C(SerializedFMUStateSize, BOTH, SETABLE)          \
    C(SerializeFMUState, BOTH, SETABLE)               \
    C(DeserializeFMUState, BOTH, SETABLE)             \
    C(GetDirectionalDerivative, BOTH, INIT | RUNNING | ENDED) \
    C(GetAdjointDerivative, BOTH, INIT | RUNNING | ENDED)     \
    C(EnterConfigurationMode, BOTH, NEVER)            \
    C(ExitConfigurationMode, BOTH, NEVER)             \
    C(GetIntervalDecimal, BOTH, INIT | EVENT)         \
    C(GetIntervalFraction, BOTH, INIT | EVENT)        \
    C(GetShiftDecimal, BOTH, INIT | EVENT)            \
    C(GetShiftFraction, BOTH, INIT | EVENT)           \
    C(SetIntervalDecimal, BOTH, INIT | EVENT)         \
    C(SetIntervalFraction, BOTH, INIT | EVENT)        \
    C(SetShiftDecimal, BOTH, INIT | EVENT)            \
    C(SetShiftFraction, BOTH, INIT | EVENT)           \
    C(EvaluateDiscreteStates, BOTH, EVENT)            \
    C(UpdateDiscreteStates, BOTH, EVENT)              \
    C(EnterContinuousTimeMode, ME, EVENT)             \
    C(CompletedIntegratorStep, ME, CONTINUOUS)        \
    C(SetTime, ME, CONTINUOUS)                        \
    C(SetContinuousStates, ME, CONTINUOUS)            \
    C(GetContinuousStateDerivatives, ME, INIT | RUNNING | ENDED)    \
    C(GetEventIndicators, ME, INIT | RUNNING | ENDED)               \
    C(GetContinuousStates, ME, INIT | RUNNING | ENDED)              \
    C(GetNominalsOfContinuousStates, ME, INIT | RUNNING | ENDED)    \
    C(GetNumberOfEventIndicators, ME, ANY)            \
    C(GetNumberOfContinuousStates, ME, ANY)           \
    C(EnterStepMode, CS, EVENT)                       \
    C(GetOutputDerivatives, CS, STEP | INSIDE | ENDED) \
    C(DoStep, CS, STEP)                               \
    C(ActivateModelPartition, BOTH, NEVER)

#define NUMBER_OF(name, kinds, modes) CALL_##name,
enum { CALLS(NUMBER_OF) NCALLS };

#define RULE_OF(name, kinds, modes) {"fmi3" #name, kinds, modes},
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
    case FMU_STEP: return "step mode";
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
    Instance *in = owner;
    const int shown = in->fmu ? category & fmu_logs(in->fmu) : category;
    int k = 0;
    while (k < ALL_CATEGORIES && !(shown & CATEGORIES[k].categories))
        k++;
    if (in->log)
        in->log(in->environment, (fmi3Status)status, CATEGORIES[k].name, message);
}

#if defined(__GNUC__)
__attribute__((format(printf, 2, 3)))
#endif
static fmi3Status refuse(Instance *in, const char *format, ...)
{
    char why[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(why, sizeof why, format, arguments);
    va_end(arguments);
    fmu_say(in->fmu, FMU_ERROR, FMU_LOG_ERROR, "%s: %s", in->call, why);
    return fmi3Error;
}

/* The instance, where the call is allowed; else null, and it was told why. */
static Instance *enter(fmi3Instance instance, int call)
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
        refuse(in, "this FMU has no %s.", call == CALL_ActivateModelPartition ? "model partitions and no clocks"
                                                                              : "structural parameters to configure");
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

static int is_of(fmi3ValueReference reference, int type)
{
    const int has = fmu_type(reference);
    return has == type || (type == FMU_INTEGER && has == FMU_ENUMERATION);
}

static const char *type_name(int type)
{
    switch (type) {
    case FMU_REAL: return "Float64";
    case FMU_INTEGER: return "Int64 or an Enumeration";
    case FMU_BOOLEAN: return "Boolean";
    default: return "String";
    }
}

/* How many elements the variables of the references have together. 0 with *ok = 0, and it was told why, where a
   reference is not that of a variable of this type. */
static size_t elements(Instance *in, const fmi3ValueReference references[], size_t count, int type, int *ok)
{
    size_t total = 0;
    *ok = 0;
    for (size_t i = 0; i < count; i++) {
        const size_t size = fmu_elements(references[i]);
        if (!size || !is_of(references[i], type)) {
            refuse(in, "value reference %lu is not that of a %s.", (unsigned long)references[i], type_name(type));
            return 0;
        }
        if (size > SIZE_MAX / sizeof(double) - total) {
            refuse(in, "these are more elements than memory can hold.");
            return 0;
        }
        total += size;
    }
    *ok = 1;
    return total;
}

/* Whether references and values are there, are of a type and as many as the variables have elements. */
static int fits(Instance *in, const fmi3ValueReference references[], size_t count, int type, const void *values,
                size_t nvalues)
{
    int ok;
    size_t total;
    if (missing(in, references, count, "valueReferences"))
        return 0;
    total = elements(in, references, count, type, &ok);
    return ok && !wrong_size(in, values, nvalues, total);
}

/* --- all kinds ---- */
const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    Instance *in = enter(instance, CALL_SetDebugLogging);
    int on = nCategories ? 0 : CATEGORIES[ALL_CATEGORIES].categories;
    if (!in || missing(in, categories, nCategories, "categories"))
        return fmi3Error;
    for (size_t i = 0; i < nCategories; i++) {
        int k = 0;
        if (missing(in, categories[i], 1, "a category"))
            return fmi3Error;
        while (k < NCATEGORIES && strcmp(categories[i], CATEGORIES[k].name) != 0)
            k++;
        if (k == NCATEGORIES)
            return refuse(in, "there is no category '%.100s'.", categories[i]);
        on |= CATEGORIES[k].categories;
    }
    fmu_log_categories(in->fmu, loggingOn ? on : 0);
    return fmi3OK;
}

static fmi3Instance not_made(Instance *in, const char *why)
{
    if (why)
        tell(in, FMU_ERROR, FMU_LOG_ERROR, why);
    free(in);
    return NULL;
}

/* Why there is no instance is told whether logging is on or not: nobody could ask for it afterwards. `from` has the
   callbacks of the instance that is made. */
static fmi3Instance instantiate(int kind, const Instance *from, fmi3String name, fmi3String token,
                                fmi3Boolean loggingOn)
{
    Instance *in = malloc(sizeof *in);
    if (!in)
        return NULL;
    *in = *from;
    if (!name || !name[strspn(name, " \t\r\n")])
        return not_made(in, "the instance has no name.");
    if (!token)
        return not_made(in, "instantiationToken is a null pointer.");
    in->fmu = fmu_new(kind, name, token, tell, in);
    if (!in->fmu)
        return not_made(in, NULL);
    fmu_log_categories(in->fmu, loggingOn ? CATEGORIES[ALL_CATEGORIES].categories : 0);
    return in;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage)
{
    const Instance from = {.environment = instanceEnvironment, .log = logMessage};
    (void)resourcePath;
    (void)visible;
    return instantiate(FMU_ME, &from, instanceName, instantiationToken, loggingOn);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken,
                                         fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate)
{
    Instance from = {.environment = instanceEnvironment,
                     .log = logMessage,
                     .intermediate = intermediateUpdate,
                     .has_event_mode = eventModeUsed,
                     .may_return_early = earlyReturnAllowed};
    (void)resourcePath;
    (void)visible;
    if (nRequiredIntermediateVariables && !requiredIntermediateVariables) {
        tell(&from, FMU_ERROR, FMU_LOG_ERROR, "requiredIntermediateVariables is a null pointer.");
        return NULL;
    }
    for (size_t i = 0; i < nRequiredIntermediateVariables; i++)
        if (!fmu_elements(requiredIntermediateVariables[i]) || !is_of(requiredIntermediateVariables[i], FMU_REAL)) {
            tell(&from, FMU_ERROR, FMU_LOG_ERROR, "a required intermediate variable is none of this FMU.");
            return NULL;
        }
    return instantiate(FMU_CS, &from, instanceName, instantiationToken, loggingOn);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken,
                                               fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                               fmi3InstanceEnvironment instanceEnvironment,
                                               fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption)
{
    Instance from = {.environment = instanceEnvironment, .log = logMessage};
    (void)instanceName, (void)instantiationToken, (void)resourcePath, (void)visible, (void)loggingOn;
    (void)clockUpdate, (void)lockPreemption, (void)unlockPreemption;
    tell(&from, FMU_ERROR, FMU_LOG_ERROR, "this FMU is not made for scheduled execution.");
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance)
{
    Instance *in = instance;
    if (!in)
        return;
    if (fmu_mode(in->fmu) & (FMU_INTERMEDIATE | FMU_ASKING)) {
        /* The communication step that called back would go on in what is freed. */
        in->call = "fmi3FreeInstance";
        refuse(in, "not allowed now (%s).", mode_name(fmu_mode(in->fmu)));
        return;
    }
    fmu_free(in->fmu);
    free(in);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    Instance *in = enter(instance, CALL_EnterInitializationMode);
    if (!in)
        return fmi3Error;
    if (toleranceDefined && !(isfinite(tolerance) && tolerance > 0))
        return refuse(in, "the tolerance is %g; it must be positive.", tolerance);
    if (!isfinite(startTime))
        return refuse(in, "the start time is %g.", startTime);
    if (stopTimeDefined && !(isfinite(stopTime) && stopTime >= startTime))
        return refuse(in, "the stop time is %.17g, the start time %.17g.", stopTime, startTime);
    return (fmi3Status)fmu_enter_initialization(in->fmu, toleranceDefined, tolerance, startTime, stopTimeDefined,
                                                stopTime);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    Instance *in = enter(instance, CALL_ExitInitializationMode);
    return in ? (fmi3Status)fmu_exit_initialization(in->fmu, in->has_event_mode) : fmi3Error;
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    Instance *in = enter(instance, CALL_EnterEventMode);
    if (!in)
        return fmi3Error;
    if (fmu_kind(in->fmu) == FMU_CS && !in->has_event_mode)
        return refuse(in, "the instance was made with eventModeUsed = false.");
    return (fmi3Status)fmu_enter_event_mode(in->fmu);
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    Instance *in = enter(instance, CALL_Terminate);
    if (!in)
        return fmi3Error;
    fmu_set_mode(in->fmu, FMU_TERMINATED);
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    Instance *in = enter(instance, CALL_Reset);
    return in ? (fmi3Status)fmu_reset(in->fmu) : fmi3Error;
}

/* --- variables: whole arrays for each reference ---- */
fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Float64 values[], size_t nValues)
{
    Instance *in = enter(instance, CALL_GetFloat64);
    int status = FMU_OK;
    if (!in || !fits(in, valueReferences, nValueReferences, FMU_REAL, values, nValues))
        return fmi3Error;
    for (size_t i = 0, at = 0; i < nValueReferences && status < FMU_DISCARD; i++) {
        const size_t size = fmu_elements(valueReferences[i]);
        const int got = fmu_get(in->fmu, valueReferences[i], FMU_REAL, values + at, size);
        status = got > status ? got : status;
        at += size;
    }
    return (fmi3Status)status;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Float64 values[], size_t nValues)
{
    Instance *in = enter(instance, CALL_SetFloat64);
    int status = FMU_OK;
    if (!in || !fits(in, valueReferences, nValueReferences, FMU_REAL, values, nValues) ||
        !all_finite(in, values, nValues))
        return fmi3Error;
    for (int checked = 0; checked < 2; checked++) /* all of them, or none */
        for (size_t i = 0, at = 0; i < nValueReferences && status < FMU_DISCARD; i++) {
            const size_t size = fmu_elements(valueReferences[i]);
            const int set = (checked ? fmu_set : fmu_check)(in->fmu, valueReferences[i], FMU_REAL, values + at, size);
            status = set > status ? set : status;
            at += size;
        }
    return (fmi3Status)status;
}

/* 2^53: above it, not every whole number is a double. */
static const double LARGEST = 9007199254740992.0;

fmi3Status fmi3GetInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        fmi3Int64 values[], size_t nValues)
{
    Instance *in = enter(instance, CALL_GetInt64);
    int status = FMU_OK;
    if (!in || !fits(in, valueReferences, nValueReferences, FMU_INTEGER, values, nValues))
        return fmi3Error;
    for (size_t i = 0, at = 0; i < nValueReferences; i++)
        for (size_t k = 0, size = fmu_elements(valueReferences[i]); k < size; k++) {
            const fmi3ValueReference reference = valueReferences[i] + (fmi3ValueReference)k;
            double number = 0;
            const int got = fmu_get(in->fmu, reference, fmu_type(reference), &number, 1);
            status = got > status ? got : status;
            if (status >= FMU_DISCARD)
                return (fmi3Status)status;
            if (!(fabs(number) <= LARGEST))
                return refuse(in, "an element of value reference %lu has %.17g, which is not known to the last digit.",
                              (unsigned long)valueReferences[i], number);
            values[at++] = (fmi3Int64)number;
        }
    return (fmi3Status)status;
}

fmi3Status fmi3SetInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3Int64 values[], size_t nValues)
{
    Instance *in = enter(instance, CALL_SetInt64);
    int status = FMU_OK;
    if (!in || !fits(in, valueReferences, nValueReferences, FMU_INTEGER, values, nValues))
        return fmi3Error;
    for (size_t i = 0; i < nValues; i++)
        if (!(fabs((double)values[i]) <= LARGEST))
            return refuse(in, "value %zu is beyond 2^53.", i);
    for (int checked = 0; checked < 2; checked++) /* all of them, or none */
        for (size_t i = 0, at = 0; i < nValueReferences; i++)
            for (size_t k = 0, size = fmu_elements(valueReferences[i]); k < size; k++) {
                const fmi3ValueReference reference = valueReferences[i] + (fmi3ValueReference)k;
                const double number = (double)values[at++];
                const int set = (checked ? fmu_set : fmu_check)(in->fmu, reference, fmu_type(reference), &number, 1);
                status = set > status ? set : status;
                if (status >= FMU_DISCARD)
                    return (fmi3Status)status;
            }
    return (fmi3Status)status;
}

fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Boolean values[], size_t nValues)
{
    Instance *in = enter(instance, CALL_GetBoolean);
    int status = FMU_OK;
    if (!in || !fits(in, valueReferences, nValueReferences, FMU_BOOLEAN, values, nValues))
        return fmi3Error;
    for (size_t i = 0, at = 0; i < nValueReferences; i++)
        for (size_t k = 0, size = fmu_elements(valueReferences[i]); k < size; k++) {
            double number = 0;
            const int got = fmu_get(in->fmu, valueReferences[i] + (fmi3ValueReference)k, FMU_BOOLEAN, &number, 1);
            status = got > status ? got : status;
            if (status >= FMU_DISCARD)
                return (fmi3Status)status;
            values[at++] = number != 0;
        }
    return (fmi3Status)status;
}

fmi3Status fmi3SetBoolean(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Boolean values[], size_t nValues)
{
    Instance *in = enter(instance, CALL_SetBoolean);
    int status = FMU_OK;
    if (!in || !fits(in, valueReferences, nValueReferences, FMU_BOOLEAN, values, nValues))
        return fmi3Error;
    for (int checked = 0; checked < 2; checked++) /* all of them, or none */
        for (size_t i = 0, at = 0; i < nValueReferences; i++)
            for (size_t k = 0, size = fmu_elements(valueReferences[i]); k < size; k++) {
                const double number = values[at++] ? 1 : 0;
                const int set = (checked ? fmu_set : fmu_check)(in->fmu, valueReferences[i] + (fmi3ValueReference)k, FMU_BOOLEAN, &number, 1);
                status = set > status ? set : status;
                if (status >= FMU_DISCARD)
                    return (fmi3Status)status;
            }
    return (fmi3Status)status;
}

fmi3Status fmi3GetString(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         fmi3String values[], size_t nValues)
{
    Instance *in = enter(instance, CALL_GetString);
    if (!in || !fits(in, valueReferences, nValueReferences, FMU_STRING, values, nValues))
        return fmi3Error;
    for (size_t i = 0, at = 0; i < nValueReferences; i++)
        for (size_t k = 0, size = fmu_elements(valueReferences[i]); k < size; k++) {
            const char *text = fmu_get_string(in->fmu, valueReferences[i] + (fmi3ValueReference)k);
            if (!text)
                return fmi3Error;
            values[at++] = text;
        }
    return fmi3OK;
}

fmi3Status fmi3SetString(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const fmi3String values[], size_t nValues)
{
    Instance *in = enter(instance, CALL_SetString);
    if (!in || !fits(in, valueReferences, nValueReferences, FMU_STRING, values, nValues))
        return fmi3Error;
    return nValueReferences ? refuse(in, "no String of this FMU can be set.") : fmi3OK;
}

/* What there is none of: no references are fine. */
static fmi3Status none(fmi3Instance instance, int call, size_t count, const char *what)
{
    Instance *in = enter(instance, call);
    if (!in)
        return fmi3Error;
    return count ? refuse(in, "this FMU has no %s.", what) : fmi3OK;
}

#define NO_VARIABLES(type)                                                                             \
    fmi3Status fmi3Get##type(fmi3Instance instance, const fmi3ValueReference valueReferences[],        \
                             size_t nValueReferences, fmi3##type values[], size_t nValues)             \
    {                                                                                                  \
        (void)valueReferences, (void)values;                                                           \
        return none(instance, CALL_Get##type, nValueReferences | nValues, "variables of type " #type); \
    }                                                                                                  \
    fmi3Status fmi3Set##type(fmi3Instance instance, const fmi3ValueReference valueReferences[],        \
                             size_t nValueReferences, const fmi3##type values[], size_t nValues)       \
    {                                                                                                  \
        (void)valueReferences, (void)values;                                                           \
        return none(instance, CALL_Set##type, nValueReferences | nValues, "variables of type " #type); \
    }

NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(Int32)
NO_VARIABLES(UInt32)
NO_VARIABLES(UInt64)

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         size_t valueSizes[], fmi3Binary values[], size_t nValues)
{
    (void)valueReferences, (void)valueSizes, (void)values;
    return none(instance, CALL_GetBinary, nValueReferences | nValues, "variables of type Binary");
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const size_t valueSizes[], const fmi3Binary values[], size_t nValues)
{
    (void)valueReferences, (void)valueSizes, (void)values;
    return none(instance, CALL_SetBinary, nValueReferences | nValues, "variables of type Binary");
}

/* --- dependencies ---- */
/* How many dependencies the elements of a variable have together; with *ok = 0, and it was told why, where there is no
   such variable or they are not known. */
static size_t dependencies(Instance *in, fmi3ValueReference dependent, int *ok)
{
    const size_t size = fmu_elements(dependent);
    size_t total = 0;
    *ok = 0;
    if (!size) {
        refuse(in, "value reference %lu is not that of a variable.", (unsigned long)dependent);
        return 0;
    }
    for (size_t k = 0; k < size; k++) {
        const uint32_t *references = NULL;
        total += fmu_dependencies(dependent + (fmi3ValueReference)k, &references);
        if (!references) {
            refuse(in, "the dependencies of value reference %lu are not known.", (unsigned long)dependent);
            return 0;
        }
    }
    *ok = 1;
    return total;
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference valueReference,
                                               size_t *nDependencies)
{
    Instance *in = enter(instance, CALL_GetNumberOfVariableDependencies);
    int ok;
    if (!in || missing(in, nDependencies, 1, "nDependencies"))
        return fmi3Error;
    const size_t count = dependencies(in, valueReference, &ok);
    if (!ok)
        return fmi3Error;
    *nDependencies = count;
    return fmi3OK;
}

/* Indices of elements count from 1; 0 would be all of them. */
fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
                                       size_t elementIndicesOfDependent[], fmi3ValueReference independents[],
                                       size_t elementIndicesOfIndependents[], fmi3DependencyKind dependencyKinds[],
                                       size_t nDependencies)
{
    Instance *in = enter(instance, CALL_GetVariableDependencies);
    int ok;
    if (!in)
        return fmi3Error;
    const size_t count = dependencies(in, dependent, &ok);
    if (!ok || wrong_size(in, elementIndicesOfDependent, nDependencies, count) ||
        missing(in, independents, count, "independents") ||
        missing(in, elementIndicesOfIndependents, count, "elementIndicesOfIndependents") ||
        missing(in, dependencyKinds, count, "dependencyKinds"))
        return fmi3Error;
    for (size_t k = 0, at = 0, size = fmu_elements(dependent); k < size; k++) {
        const uint32_t *references = NULL;
        const size_t own = fmu_dependencies(dependent + (fmi3ValueReference)k, &references);
        for (size_t i = 0; i < own; i++, at++) {
            fmi3ValueReference first = references[i];
            while (first > 0 && !fmu_elements(first))
                first--;
            elementIndicesOfDependent[at] = k + 1;
            independents[at] = first;
            elementIndicesOfIndependents[at] = (size_t)(references[i] - first) + 1;
            dependencyKinds[at] = fmi3Dependent;
        }
    }
    return fmi3OK;
}

/* --- states of the FMU ---- */
fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    Instance *in = enter(instance, CALL_GetFMUState);
    if (!in || missing(in, FMUState, 1, "FMUState"))
        return fmi3Error;
    FmuSaved *saved = *FMUState;
    const int status = fmu_save(in->fmu, &saved);
    *FMUState = saved;
    return (fmi3Status)status;
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    Instance *in = enter(instance, CALL_SetFMUState);
    if (!in || missing(in, FMUState, 1, "FMUState"))
        return fmi3Error;
    return (fmi3Status)fmu_restore(in->fmu, FMUState);
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    Instance *in = enter(instance, CALL_FreeFMUState);
    if (!in)
        return fmi3Error;
    if (FMUState && *FMUState) {
        fmu_forget(*FMUState);
        *FMUState = NULL;
    }
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size)
{
    Instance *in = enter(instance, CALL_SerializedFMUStateSize);
    if (!in || missing(in, FMUState, 1, "FMUState") || missing(in, size, 1, "size"))
        return fmi3Error;
    *size = fmu_saved_bytes(FMUState);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[], size_t size)
{
    Instance *in = enter(instance, CALL_SerializeFMUState);
    if (!in || missing(in, FMUState, 1, "FMUState") || missing(in, serializedState, 1, "serializedState"))
        return fmi3Error;
    if (size != fmu_saved_bytes(FMUState))
        return refuse(in, "the state has %zu bytes, not %zu.", fmu_saved_bytes(FMUState), size);
    return (fmi3Status)fmu_serialize(in->fmu, FMUState, serializedState, size);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState)
{
    Instance *in = enter(instance, CALL_DeserializeFMUState);
    FmuSaved *saved = NULL;
    if (!in || missing(in, serializedState, 1, "serializedState") || missing(in, FMUState, 1, "FMUState"))
        return fmi3Error;
    const int status = fmu_deserialize(in->fmu, serializedState, size, &saved);
    if (status < FMU_DISCARD)
        *FMUState = saved;
    return (fmi3Status)status;
}

/* --- derivatives ---- */
static uint32_t *expanded(const fmi3ValueReference references[], size_t count, uint32_t *out)
{
    for (size_t i = 0; i < count; i++)
        for (size_t k = 0, size = fmu_elements(references[i]); k < size; k++)
            *out++ = references[i] + (uint32_t)k;
    return out;
}

static fmi3Status derivative(fmi3Instance instance, int call, const fmi3ValueReference unknowns[], size_t nUnknowns,
                             const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                             fmi3Float64 sensitivity[], size_t nSensitivity)
{
    Instance *in = enter(instance, call);
    const int adjoint = call == CALL_GetAdjointDerivative;
    uint32_t few[64], *references = few;
    int ok;
    if (!in || missing(in, unknowns, nUnknowns, "unknowns") || missing(in, knowns, nKnowns, "knowns"))
        return fmi3Error;
    const size_t rows = elements(in, unknowns, nUnknowns, FMU_REAL, &ok);
    const size_t columns = ok ? elements(in, knowns, nKnowns, FMU_REAL, &ok) : 0;
    if (!ok || wrong_size(in, seed, nSeed, adjoint ? rows : columns) ||
        wrong_size(in, sensitivity, nSensitivity, adjoint ? columns : rows) || !all_finite(in, seed, nSeed))
        return fmi3Error;
    if (rows + columns > sizeof few / sizeof few[0]) {
        references = malloc((rows + columns) * sizeof *references);
        if (!references)
            return refuse(in, "there is no memory for %zu references.", rows + columns);
    }
    expanded(knowns, nKnowns, expanded(unknowns, nUnknowns, references));
    const int status =
        fmu_directional(in->fmu, references, rows, references + rows, columns, seed, sensitivity, adjoint);
    if (references != few)
        free(references);
    return (fmi3Status)status;
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                        size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    return derivative(instance, CALL_GetDirectionalDerivative, unknowns, nUnknowns, knowns, nKnowns, seed, nSeed,
                      sensitivity, nSensitivity);
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                    size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    return derivative(instance, CALL_GetAdjointDerivative, unknowns, nUnknowns, knowns, nKnowns, seed, nSeed,
                      sensitivity, nSensitivity);
}

/* --- structural parameters and clocks, of which there are none ---- */
fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance)
{
    enter(instance, CALL_EnterConfigurationMode);
    return fmi3Error;
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance)
{
    enter(instance, CALL_ExitConfigurationMode);
    return fmi3Error;
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        fmi3Clock values[])
{
    (void)valueReferences, (void)values;
    return none(instance, CALL_GetClock, nValueReferences, "clocks");
}

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3Clock values[])
{
    (void)valueReferences, (void)values;
    return none(instance, CALL_SetClock, nValueReferences, "clocks");
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                  size_t nValueReferences, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    (void)valueReferences, (void)intervals, (void)qualifiers;
    return none(instance, CALL_GetIntervalDecimal, nValueReferences, "clocks");
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                   size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[])
{
    (void)valueReferences, (void)counters, (void)resolutions, (void)qualifiers;
    return none(instance, CALL_GetIntervalFraction, nValueReferences, "clocks");
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                               size_t nValueReferences, fmi3Float64 shifts[])
{
    (void)valueReferences, (void)shifts;
    return none(instance, CALL_GetShiftDecimal, nValueReferences, "clocks");
}

fmi3Status fmi3GetShiftFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
{
    (void)valueReferences, (void)counters, (void)resolutions;
    return none(instance, CALL_GetShiftFraction, nValueReferences, "clocks");
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                  size_t nValueReferences, const fmi3Float64 intervals[])
{
    (void)valueReferences, (void)intervals;
    return none(instance, CALL_SetIntervalDecimal, nValueReferences, "clocks");
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                   size_t nValueReferences, const fmi3UInt64 counters[],
                                   const fmi3UInt64 resolutions[])
{
    (void)valueReferences, (void)counters, (void)resolutions;
    return none(instance, CALL_SetIntervalFraction, nValueReferences, "clocks");
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                               size_t nValueReferences, const fmi3Float64 shifts[])
{
    (void)valueReferences, (void)shifts;
    return none(instance, CALL_SetShiftDecimal, nValueReferences, "clocks");
}

fmi3Status fmi3SetShiftFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                size_t nValueReferences, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)valueReferences, (void)counters, (void)resolutions;
    return none(instance, CALL_SetShiftFraction, nValueReferences, "clocks");
}

/* --- events ---- */
/* Discrete states are computed by fmi3UpdateDiscreteStates alone (providesEvaluateDiscreteStates is false). */
fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance)
{
    return enter(instance, CALL_EvaluateDiscreteStates) ? fmi3OK : fmi3Error;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
                                    fmi3Float64 *nextEventTime)
{
    Instance *in = enter(instance, CALL_UpdateDiscreteStates);
    FmuEvents events = {0};
    if (!in || missing(in, discreteStatesNeedUpdate, 1, "discreteStatesNeedUpdate") ||
        missing(in, terminateSimulation, 1, "terminateSimulation") ||
        missing(in, nominalsOfContinuousStatesChanged, 1, "nominalsOfContinuousStatesChanged") ||
        missing(in, valuesOfContinuousStatesChanged, 1, "valuesOfContinuousStatesChanged") ||
        missing(in, nextEventTimeDefined, 1, "nextEventTimeDefined") || missing(in, nextEventTime, 1, "nextEventTime"))
        return fmi3Error;
    const int status = fmu_update_discrete_states(in->fmu, &events);
    if (status < FMU_DISCARD) {
        *discreteStatesNeedUpdate = events.needs_update != 0;
        *terminateSimulation = events.terminate != 0;
        *nominalsOfContinuousStatesChanged = events.nominals_changed != 0;
        *valuesOfContinuousStatesChanged = events.states_changed != 0;
        *nextEventTimeDefined = events.has_next != 0;
        *nextEventTime = events.has_next ? events.next : 0;
    }
    return (fmi3Status)status;
}

/* --- Model Exchange ---- */
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance)
{
    Instance *in = enter(instance, CALL_EnterContinuousTimeMode);
    return in ? (fmi3Status)fmu_enter_continuous_mode(in->fmu) : fmi3Error;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation)
{
    Instance *in = enter(instance, CALL_CompletedIntegratorStep);
    int event = 0, terminate = 0;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!in || missing(in, enterEventMode, 1, "enterEventMode") ||
        missing(in, terminateSimulation, 1, "terminateSimulation"))
        return fmi3Error;
    const int status = fmu_completed_step(in->fmu, &event, &terminate);
    *enterEventMode = event != 0;
    *terminateSimulation = terminate != 0;
    return (fmi3Status)status;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    Instance *in = enter(instance, CALL_SetTime);
    if (!in || !all_finite(in, &time, 1))
        return fmi3Error;
    return (fmi3Status)fmu_set_time(in->fmu, time);
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[],
                                   size_t nContinuousStates)
{
    Instance *in = enter(instance, CALL_SetContinuousStates);
    if (!in || wrong_size(in, continuousStates, nContinuousStates, fmu_number_of_states()) ||
        !all_finite(in, continuousStates, nContinuousStates))
        return fmi3Error;
    return (fmi3Status)fmu_set_states(in->fmu, continuousStates, nContinuousStates);
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[],
                                             size_t nContinuousStates)
{
    Instance *in = enter(instance, CALL_GetContinuousStateDerivatives);
    if (!in || wrong_size(in, derivatives, nContinuousStates, fmu_number_of_states()))
        return fmi3Error;
    return (fmi3Status)fmu_get_rates(in->fmu, derivatives, nContinuousStates);
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 eventIndicators[], size_t nEventIndicators)
{
    Instance *in = enter(instance, CALL_GetEventIndicators);
    if (!in || wrong_size(in, eventIndicators, nEventIndicators, fmu_number_of_indicators()))
        return fmi3Error;
    return (fmi3Status)fmu_get_indicators(in->fmu, eventIndicators, nEventIndicators);
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 continuousStates[], size_t nContinuousStates)
{
    Instance *in = enter(instance, CALL_GetContinuousStates);
    if (!in || wrong_size(in, continuousStates, nContinuousStates, fmu_number_of_states()))
        return fmi3Error;
    return (fmi3Status)fmu_get_states(in->fmu, continuousStates, nContinuousStates);
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t nContinuousStates)
{
    Instance *in = enter(instance, CALL_GetNominalsOfContinuousStates);
    if (!in || wrong_size(in, nominals, nContinuousStates, fmu_number_of_states()))
        return fmi3Error;
    return (fmi3Status)fmu_get_nominals(in->fmu, nominals, nContinuousStates);
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *nEventIndicators)
{
    Instance *in = enter(instance, CALL_GetNumberOfEventIndicators);
    if (!in || missing(in, nEventIndicators, 1, "nEventIndicators"))
        return fmi3Error;
    *nEventIndicators = fmu_number_of_indicators();
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates)
{
    Instance *in = enter(instance, CALL_GetNumberOfContinuousStates);
    if (!in || missing(in, nContinuousStates, 1, "nContinuousStates"))
        return fmi3Error;
    *nContinuousStates = fmu_number_of_states();
    return fmi3OK;
}

/* --- Co-Simulation ---- */
fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    Instance *in = enter(instance, CALL_EnterStepMode);
    return in ? (fmi3Status)fmu_enter_continuous_mode(in->fmu) : fmi3Error;
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, const fmi3Int32 orders[], fmi3Float64 values[],
                                    size_t nValues)
{
    (void)valueReferences, (void)orders, (void)values;
    return none(instance, CALL_GetOutputDerivatives, nValueReferences | nValues,
                "derivatives of outputs (maxOutputDerivativeOrder is 0)");
}

/* Steps are accepted before anyone is told of them, so that each one is finished. What is asked for before them lies
   ahead: there is nothing to get, and nothing to return from. */
static void intermediate(void *owner, double t, int finished, int *early, double *early_time)
{
    Instance *in = owner;
    fmi3Boolean asked = fmi3False;
    fmi3Float64 at = t;
    const fmi3Boolean is_step = fmu_mode(in->fmu) == FMU_INTERMEDIATE;
    const fmi3Boolean can_return = is_step && in->may_return_early;
    in->intermediate(in->environment, t, !finished, is_step, is_step, can_return, &asked, &at);
    if (asked && can_return) {
        *early = 1;
        *early_time = at > t ? at : t;
    }
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    Instance *in = enter(instance, CALL_DoStep);
    FmuStep step = {0};
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!in || missing(in, eventHandlingNeeded, 1, "eventHandlingNeeded") ||
        missing(in, terminateSimulation, 1, "terminateSimulation") || missing(in, earlyReturn, 1, "earlyReturn") ||
        missing(in, lastSuccessfulTime, 1, "lastSuccessfulTime"))
        return fmi3Error;
    if (!isfinite(currentCommunicationPoint) || !isfinite(communicationStepSize) || !(communicationStepSize > 0))
        return refuse(in, "a step from %.17g s by %.17g s; its size must be positive.", currentCommunicationPoint,
                      communicationStepSize);
    step.last_time = fmu_time(in->fmu);
    const int status = fmu_step(in->fmu, currentCommunicationPoint, communicationStepSize, in->may_return_early,
                                in->intermediate ? intermediate : NULL, in, &step);
    *eventHandlingNeeded = step.event_needed != 0;
    *terminateSimulation = step.terminate != 0;
    *earlyReturn = step.returned_early != 0;
    *lastSuccessfulTime = step.last_time;
    return (fmi3Status)status;
}

/* --- Scheduled Execution ---- */
fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clockReference,
                                      fmi3Float64 activationTime)
{
    (void)clockReference, (void)activationTime;
    enter(instance, CALL_ActivateModelPartition);
    return fmi3Error;
}
