/* FMI 3.0.2: each call of the standard is checked here - whether this kind of instance has it, whether it is allowed in
   the present mode, its pointers, its sizes - and handed to the core. A call that does not pass tells why in the
   category logStatusError, returns fmi3Error and changes nothing. A call without an instance returns fmi3Error.

   There are variables of the types Float64, Int64 (enumerations too), Boolean and String. There are no clocks, no
   structural parameters, no scheduled execution: their functions say so. The functions that FMI 2.0 has alike are in
   standard.h. */
#include "fmi3.h"
#include "fmu.h"

typedef struct {
    Fmu *fmu;
    const char *call; /* the present one, for messages */
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    fmi3IntermediateUpdateCallback intermediate;
    int has_event_mode, may_return_early;
} Instance;

#define FMI(name) FMI_3(name)
#define FMI_3(name) fmi3##name
#define STATE(verb, rest) STATE_3(verb, rest)
#define STATE_3(verb, rest) verb##FMUState##rest
#define DESERIALIZE Deserialize
#define DERIVATIVES GetContinuousStateDerivatives
#define ELEMENTS(reference) fmu_elements(reference)
#define STEP_MODE "step mode"
#define ANY (SETABLE | INSIDE | ASKED)
#define GETS SETABLE
#define SETS (NEW | INIT | EVENT | STEP)

/* "Allowed function calls" of sections 2.3, 3.2.1 and 4.2.1 of the standard. Within an intermediate update only
   continuous variables are at hand, which are all Float64. Where it asks for inputs that lie ahead, they can be set, and
   nothing can be read. */
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

#include "standard.h"

static void log_message(const Instance *in, Status status, const char *category, const char *message)
{
    if (in->log)
        in->log(in->environment, status, category, message);
}

static const char *why_never(int call)
{
    return call == CALL_ActivateModelPartition ? "this FMU has no model partitions and no clocks"
                                               : "this FMU has no structural parameters to configure";
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
                                fmi3String resources, fmi3Boolean loggingOn)
{
    Instance *in = malloc(sizeof *in);
    if (!in)
        return NULL;
    *in = *from;
    if (!name || !name[strspn(name, " \t\r\n")])
        return not_made(in, "the instance has no name.");
    if (!token)
        return not_made(in, "instantiationToken is a null pointer.");
    in->fmu = fmu_new(kind, name, token, resources, tell, in);
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
    (void)visible;
    return instantiate(FMU_ME, &from, instanceName, instantiationToken, resourcePath, loggingOn);
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
    return instantiate(FMU_CS, &from, instanceName, instantiationToken, resourcePath, loggingOn);
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
    if (!in || wrong_experiment(in, toleranceDefined, tolerance, startTime, stopTimeDefined, stopTime))
        return fmi3Error;
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

fmi3Status fmi3Reset(fmi3Instance instance)
{
    Instance *in = enter(instance, CALL_Reset);
    return in ? (fmi3Status)fmu_reset(in->fmu) : fmi3Error;
}

/* --- variables: whole arrays for each reference ---- */
/* 2^53: above it, not every whole number is a double. */
static const double LARGEST = 9007199254740992.0;

static int put_integer(Instance *in, fmi3ValueReference variable, void *values, size_t at, double number)
{
    if (!(fabs(number) <= LARGEST)) {
        refuse(in, "an element of value reference %lu has %.17g, which is not known to the last digit.",
               (unsigned long)variable, number);
        return 0;
    }
    ((fmi3Int64 *)values)[at] = (fmi3Int64)number;
    return 1;
}

static double integer_at(const void *values, size_t at)
{
    return (double)((const fmi3Int64 *)values)[at];
}

static int all_exact(Instance *in, const fmi3Int64 values[], size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!(fabs((double)values[i]) <= LARGEST)) {
            refuse(in, "value %zu is beyond 2^53.", i);
            return 0;
        }
    return 1;
}

/* A function that moves the values of a type; `checked` is what else must hold. */
#define MOVES(called, type, values_of, checked, moved)                                                                \
    fmi3Status fmi3##called(fmi3Instance instance, const fmi3ValueReference valueReferences[],                        \
                            size_t nValueReferences, values_of values[], size_t nValues)                             \
    {                                                                                                                 \
        Instance *in = enter(instance, CALL_##called);                                                                \
        if (!in || !fits(in, valueReferences, nValueReferences, type, values, nValues) || !(checked))                 \
            return fmi3Error;                                                                                         \
        return moved;                                                                                                 \
    }
#define ROW in, valueReferences, nValueReferences
MOVES(GetFloat64, FMU_REAL, fmi3Float64, 1, get_reals(ROW, values))
MOVES(SetFloat64, FMU_REAL, const fmi3Float64, all_finite(in, values, nValues), set_reals(ROW, values))
MOVES(GetInt64, FMU_INTEGER, fmi3Int64, 1, get_numbers(ROW, FMU_INTEGER, values, put_integer))
MOVES(SetInt64, FMU_INTEGER, const fmi3Int64, all_exact(in, values, nValues),
      set_numbers(ROW, FMU_INTEGER, values, integer_at))
MOVES(GetBoolean, FMU_BOOLEAN, fmi3Boolean, 1, get_numbers(ROW, FMU_BOOLEAN, values, put_boolean))
MOVES(SetBoolean, FMU_BOOLEAN, const fmi3Boolean, 1, set_numbers(ROW, FMU_BOOLEAN, values, boolean_at))
MOVES(GetString, FMU_STRING, fmi3String, 1, get_strings(ROW, values))
MOVES(SetString, FMU_STRING, const fmi3String, 1,
      nValueReferences ? refuse(in, "no String of this FMU can be set.") : fmi3OK)

/* --- what there is none of: no references are fine ---- */
static fmi3Status none(fmi3Instance instance, int call, size_t count, const char *what)
{
    Instance *in = enter(instance, call);
    if (!in)
        return fmi3Error;
    return count ? refuse(in, "this FMU has no %s.", what) : fmi3OK;
}

#if defined __GNUC__
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

#define REFERENCES const fmi3ValueReference valueReferences[], size_t nValueReferences
#define NONE(called, what, count, ...)                          \
    fmi3Status fmi3##called(fmi3Instance instance, __VA_ARGS__) \
    {                                                           \
        return none(instance, CALL_##called, count, what);      \
    }
#define NO_VALUES(called, what, ...) \
    NONE(called, what, nValueReferences | nValues, REFERENCES, __VA_ARGS__, size_t nValues)
#define NO_VARIABLES(type)                                                      \
    NO_VALUES(Get##type, "variables of type " #type, fmi3##type values[])       \
    NO_VALUES(Set##type, "variables of type " #type, const fmi3##type values[])
#define NO_CLOCKS(called, ...) NONE(called, "clocks", nValueReferences, REFERENCES, __VA_ARGS__)

NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(Int32)
NO_VARIABLES(UInt32)
NO_VARIABLES(UInt64)
NO_VALUES(GetBinary, "variables of type Binary", size_t valueSizes[], fmi3Binary values[])
NO_VALUES(SetBinary, "variables of type Binary", const size_t valueSizes[], const fmi3Binary values[])
NO_VALUES(GetOutputDerivatives, "derivatives of outputs (maxOutputDerivativeOrder is 0)", const fmi3Int32 orders[],
          fmi3Float64 values[])
NO_CLOCKS(GetClock, fmi3Clock values[])
NO_CLOCKS(SetClock, const fmi3Clock values[])
NO_CLOCKS(GetIntervalDecimal, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
NO_CLOCKS(GetIntervalFraction, fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
NO_CLOCKS(GetShiftDecimal, fmi3Float64 shifts[])
NO_CLOCKS(GetShiftFraction, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
NO_CLOCKS(SetIntervalDecimal, const fmi3Float64 intervals[])
NO_CLOCKS(SetIntervalFraction, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
NO_CLOCKS(SetShiftDecimal, const fmi3Float64 shifts[])
NO_CLOCKS(SetShiftFraction, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])

#if defined __GNUC__
#pragma GCC diagnostic pop
#endif

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
fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    Instance *in = enter(instance, CALL_SetFMUState);
    if (!in || missing(in, FMUState, 1, "FMUState"))
        return fmi3Error;
    return (fmi3Status)fmu_restore(in->fmu, FMUState);
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

/* --- structural parameters, of which there are none ---- */
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
        missing(in, lastSuccessfulTime, 1, "lastSuccessfulTime") ||
        wrong_step(in, currentCommunicationPoint, communicationStepSize))
        return fmi3Error;
    step.last_time = fmu_time(in->fmu);
    const int status = fmu_step(in->fmu, currentCommunicationPoint, communicationStepSize, in->may_return_early,
                                in->intermediate ? intermediate : NULL, in, &step);
    *eventHandlingNeeded = step.event_needed != 0;
    *terminateSimulation = step.terminate != 0;
    /* Where the run ends by its condition, the step ends early too, and lastSuccessfulTime tells. */
    *earlyReturn = step.returned_early && (in->may_return_early || !step.terminate);
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
