/* FMI 3.0.2, of an FMU that runs in a process of its own: each function hands its arguments on. Checks are left to the
   FMU, so that it answers as it would without this. Scheduled Execution, clocks and binary values are refused. */
#define _GNU_SOURCE
#include "calls3.h"
#include "fmi3.h"
#include "proxy.h"

#include <stdlib.h>
#include <string.h>

typedef struct {
    Proxy proxy; /* first */
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    fmi3IntermediateUpdateCallback update;
} Instance;

#define COUNT(array) ((int)(sizeof(array) / sizeof *(array)))
/* A call of a function with arrays, and with the numbers that follow. */
#define FORWARD(instance, called, arrays, ...)                                                                        \
    (fmi3Status) proxy_call((instance), &(Request){.function = FMI3_##called, .name = "fmi3" #called, __VA_ARGS__}, \
                            (arrays), COUNT(arrays))
#define PLAIN(instance, called, ...)                                                                                  \
    (fmi3Status) proxy_call((instance), &(Request){.function = FMI3_##called, .name = "fmi3" #called, __VA_ARGS__}, \
                            NULL, 0)

static void tell(Proxy *p, int status, const char *category, const char *message)
{
    const Instance *in = (const Instance *)p;
    if (in->log)
        in->log(in->environment, (fmi3Status)status, category, message);
}

static void update(Proxy *p, const Frame *asked, int *early, double *early_time)
{
    const Instance *in = (const Instance *)p;
    fmi3Boolean wants = *early != 0;
    if (!in->update)
        return;
    in->update(in->environment, asked->x[0], asked->n[0] != 0, asked->n[1] != 0, asked->n[2] != 0, asked->n[3] != 0,
               &wants, early_time);
    *early = wants;
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

/* --- life ---- */

static Instance *begun(fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    Instance *in = calloc(1, sizeof *in);
    if (!in)
        return NULL;
    in->environment = environment;
    in->log = log;
    in->proxy.tell = tell;
    in->proxy.update = update;
    if (proxy_start(&in->proxy, "3")) {
        free(in);
        return NULL;
    }
    return in;
}

static fmi3Instance kept(Instance *in, int is_made)
{
    if (is_made)
        return in;
    proxy_abandon(&in->proxy);
    free(in);
    return NULL;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage)
{
    Instance *in = begun(instanceEnvironment, logMessage);
    int is_made = 0;
    if (!in)
        return NULL;
    const Array arrays[] = {
        {instanceName, NULL, proxy_length(instanceName)},
        {instantiationToken, NULL, proxy_length(instantiationToken)},
        {resourcePath, NULL, proxy_length(resourcePath)},
        OUT(&is_made, 1),
    };
    FORWARD(&in->proxy, InstantiateModelExchange, arrays, .n = {visible, loggingOn, logMessage != NULL});
    return kept(in, is_made);
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
    Instance *in = begun(instanceEnvironment, logMessage);
    int is_made = 0;
    if (!in)
        return NULL;
    in->update = intermediateUpdate;
    const Array arrays[] = {
        {instanceName, NULL, proxy_length(instanceName)},
        {instantiationToken, NULL, proxy_length(instantiationToken)},
        {resourcePath, NULL, proxy_length(resourcePath)},
        IN(requiredIntermediateVariables, nRequiredIntermediateVariables),
        OUT(&is_made, 1),
    };
    const uint64_t callbacks = (logMessage != NULL ? 1u : 0u) | (intermediateUpdate != NULL ? 2u : 0u);
    FORWARD(&in->proxy, InstantiateCoSimulation, arrays,
            .n = {visible, loggingOn, callbacks, eventModeUsed, earlyReturnAllowed, nRequiredIntermediateVariables});
    return kept(in, is_made);
}

void fmi3FreeInstance(fmi3Instance instance)
{
    Instance *in = instance;
    if (!in)
        return;
    proxy_end(&in->proxy, &(Request){.function = FMI3_FreeInstance, .name = "fmi3FreeInstance"});
    free(in);
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    size_t bytes = 0;
    char *joined = categories ? proxy_join(categories, nCategories, &bytes) : NULL;
    if (nCategories && !joined)
        return (fmi3Status)proxy_refuse(instance, "fmi3SetDebugLogging", "a category is a null pointer");
    const Array arrays[] = {{joined, NULL, bytes}};
    const fmi3Status status = FORWARD(instance, SetDebugLogging, arrays, .n = {loggingOn, nCategories});
    free(joined);
    return status;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    return PLAIN(instance, EnterInitializationMode, .n = {toleranceDefined, stopTimeDefined},
                 .x = {tolerance, startTime, stopTime});
}

#define WITHOUT_ARGUMENTS(called)                   \
    fmi3Status fmi3##called(fmi3Instance instance)  \
    {                                               \
        return PLAIN(instance, called, .n = {0});   \
    }
WITHOUT_ARGUMENTS(ExitInitializationMode)
WITHOUT_ARGUMENTS(EnterEventMode)
WITHOUT_ARGUMENTS(Terminate)
WITHOUT_ARGUMENTS(Reset)
WITHOUT_ARGUMENTS(EnterConfigurationMode)
WITHOUT_ARGUMENTS(ExitConfigurationMode)
WITHOUT_ARGUMENTS(EvaluateDiscreteStates)
WITHOUT_ARGUMENTS(EnterContinuousTimeMode)
WITHOUT_ARGUMENTS(EnterStepMode)

/* --- variables ---- */

#define OF_TYPE(type)                                                                                             \
    fmi3Status fmi3Get##type(fmi3Instance instance, const fmi3ValueReference valueReferences[],                    \
                             size_t nValueReferences, fmi3##type values[], size_t nValues)                        \
    {                                                                                                             \
        const Array arrays[] = {IN(valueReferences, nValueReferences), OUT(values, nValues)};                     \
        return FORWARD(instance, Get##type, arrays, .n = {nValueReferences, nValues});                            \
    }                                                                                                             \
    fmi3Status fmi3Set##type(fmi3Instance instance, const fmi3ValueReference valueReferences[],                    \
                             size_t nValueReferences, const fmi3##type values[], size_t nValues)                  \
    {                                                                                                             \
        const Array arrays[] = {IN(valueReferences, nValueReferences), IN(values, nValues)};                      \
        return FORWARD(instance, Set##type, arrays, .n = {nValueReferences, nValues});                            \
    }
FMI3_TYPES(OF_TYPE)

fmi3Status fmi3GetString(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         fmi3String values[], size_t nValues)
{
    const Array arrays[] = {IN(valueReferences, nValueReferences), {"", NULL, 1}};
    const fmi3Status status = FORWARD(instance, GetString, arrays, .n = {nValueReferences, nValues});
    if ((status == fmi3OK || status == fmi3Warning) && proxy_take_strings(instance, 1, values, nValues))
        return (fmi3Status)proxy_refuse(instance, "fmi3GetString", "no strings came back");
    return status;
}

fmi3Status fmi3SetString(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const fmi3String values[], size_t nValues)
{
    size_t bytes = 0;
    char *joined = values ? proxy_join(values, nValues, &bytes) : NULL;
    if (nValues && !joined)
        return (fmi3Status)proxy_refuse(instance, "fmi3SetString", "a value is a null pointer");
    const Array arrays[] = {IN(valueReferences, nValueReferences), {joined, NULL, bytes}};
    const fmi3Status status = FORWARD(instance, SetString, arrays, .n = {nValueReferences, nValues});
    free(joined);
    return status;
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference valueReference,
                                               size_t *nDependencies)
{
    const Array arrays[] = {OUT(nDependencies, 1)};
    return FORWARD(instance, GetNumberOfVariableDependencies, arrays, .n = {valueReference});
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
                                       size_t elementIndicesOfDependent[], fmi3ValueReference independents[],
                                       size_t elementIndicesOfIndependents[], fmi3DependencyKind dependencyKinds[],
                                       size_t nDependencies)
{
    const Array arrays[] = {OUT(elementIndicesOfDependent, nDependencies), OUT(independents, nDependencies),
                            OUT(elementIndicesOfIndependents, nDependencies), OUT(dependencyKinds, nDependencies)};
    return FORWARD(instance, GetVariableDependencies, arrays, .n = {dependent, nDependencies});
}

/* --- states of the FMU: numbers that the other side gives them, from 1 ---- */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    const Array arrays[] = {OUT(FMUState, 1)};
    return FORWARD(instance, GetFMUState, arrays, .n = {0});
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    return PLAIN(instance, SetFMUState, .n = {(uintptr_t)FMUState});
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    const Array arrays[] = {OUT(FMUState, 1)};
    return FORWARD(instance, FreeFMUState, arrays, .n = {0});
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size)
{
    const Array arrays[] = {OUT(size, 1)};
    return FORWARD(instance, SerializedFMUStateSize, arrays, .n = {(uintptr_t)FMUState});
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[], size_t size)
{
    const Array arrays[] = {OUT(serializedState, size)};
    return FORWARD(instance, SerializeFMUState, arrays, .n = {(uintptr_t)FMUState, size});
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState)
{
    const Array arrays[] = {IN(serializedState, size), OUT(FMUState, 1)};
    return FORWARD(instance, DeserializeFMUState, arrays, .n = {size});
}

#define DERIVATIVE(called)                                                                                            \
    fmi3Status fmi3##called(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,              \
                            const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed, \
                            fmi3Float64 sensitivity[], size_t nSensitivity)                                           \
    {                                                                                                                 \
        const Array arrays[] = {IN(unknowns, nUnknowns), IN(knowns, nKnowns), IN(seed, nSeed),                        \
                                OUT(sensitivity, nSensitivity)};                                                      \
        return FORWARD(instance, called, arrays, .n = {nUnknowns, nKnowns, nSeed, nSensitivity});                     \
    }
DERIVATIVE(GetDirectionalDerivative)
DERIVATIVE(GetAdjointDerivative)

/* --- events, Model Exchange ---- */

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
                                    fmi3Float64 *nextEventTime)
{
    const Array arrays[] = {OUT(discreteStatesNeedUpdate, 1), OUT(terminateSimulation, 1),
                            OUT(nominalsOfContinuousStatesChanged, 1), OUT(valuesOfContinuousStatesChanged, 1),
                            OUT(nextEventTimeDefined, 1), OUT(nextEventTime, 1)};
    return FORWARD(instance, UpdateDiscreteStates, arrays, .n = {0});
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation)
{
    const Array arrays[] = {OUT(enterEventMode, 1), OUT(terminateSimulation, 1)};
    return FORWARD(instance, CompletedIntegratorStep, arrays, .n = {noSetFMUStatePriorToCurrentPoint});
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    return PLAIN(instance, SetTime, .x = {time});
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[],
                                   size_t nContinuousStates)
{
    const Array arrays[] = {IN(continuousStates, nContinuousStates)};
    return FORWARD(instance, SetContinuousStates, arrays, .n = {nContinuousStates});
}

#define REALS(called)                                                                 \
    fmi3Status fmi3##called(fmi3Instance instance, fmi3Float64 values[], size_t n)     \
    {                                                                                 \
        const Array arrays[] = {OUT(values, n)};                                      \
        return FORWARD(instance, called, arrays, .n = {n});                           \
    }
REALS(GetContinuousStateDerivatives)
REALS(GetEventIndicators)
REALS(GetContinuousStates)
REALS(GetNominalsOfContinuousStates)

#define SIZE(called)                                            \
    fmi3Status fmi3##called(fmi3Instance instance, size_t *n)   \
    {                                                           \
        const Array arrays[] = {OUT(n, 1)};                     \
        return FORWARD(instance, called, arrays, .n = {0});     \
    }
SIZE(GetNumberOfEventIndicators)
SIZE(GetNumberOfContinuousStates)

/* --- Co-Simulation ---- */

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, const fmi3Int32 orders[], fmi3Float64 values[],
                                    size_t nValues)
{
    const Array arrays[] = {IN(valueReferences, nValueReferences), IN(orders, nValueReferences), OUT(values, nValues)};
    return FORWARD(instance, GetOutputDerivatives, arrays, .n = {nValueReferences, nValues});
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    const Array arrays[] = {OUT(eventHandlingNeeded, 1), OUT(terminateSimulation, 1), OUT(earlyReturn, 1),
                            OUT(lastSuccessfulTime, 1)};
    return FORWARD(instance, DoStep, arrays, .n = {noSetFMUStatePriorToCurrentPoint},
                   .x = {currentCommunicationPoint, communicationStepSize});
}

/* --- what does not go to another process ---- */

#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken,
                                               fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                               fmi3InstanceEnvironment instanceEnvironment,
                                               fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption)
{
    if (logMessage)
        logMessage(instanceEnvironment, fmi3Error, "logStatusError",
                   "fmi3InstantiateScheduledExecution: not in a process of its own");
    return NULL;
}

#define REFUSED(called, ...)                                                                                         \
    fmi3Status fmi3##called(fmi3Instance instance, __VA_ARGS__)                                                       \
    {                                                                                                                \
        return (fmi3Status)proxy_refuse(instance, "fmi3" #called, "not for an FMU that runs in a process of its own"); \
    }
REFUSED(GetBinary, const fmi3ValueReference valueReferences[], size_t nValueReferences, size_t valueSizes[],
        fmi3Binary values[], size_t nValues)
REFUSED(SetBinary, const fmi3ValueReference valueReferences[], size_t nValueReferences, const size_t valueSizes[],
        const fmi3Binary values[], size_t nValues)
REFUSED(GetClock, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3Clock values[])
REFUSED(SetClock, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3Clock values[])
REFUSED(GetIntervalDecimal, const fmi3ValueReference valueReferences[], size_t nValueReferences,
        fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
REFUSED(GetIntervalFraction, const fmi3ValueReference valueReferences[], size_t nValueReferences,
        fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
REFUSED(GetShiftDecimal, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3Float64 shifts[])
REFUSED(GetShiftFraction, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3UInt64 counters[],
        fmi3UInt64 resolutions[])
REFUSED(SetIntervalDecimal, const fmi3ValueReference valueReferences[], size_t nValueReferences,
        const fmi3Float64 intervals[])
REFUSED(SetIntervalFraction, const fmi3ValueReference valueReferences[], size_t nValueReferences,
        const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
REFUSED(SetShiftDecimal, const fmi3ValueReference valueReferences[], size_t nValueReferences,
        const fmi3Float64 shifts[])
REFUSED(SetShiftFraction, const fmi3ValueReference valueReferences[], size_t nValueReferences,
        const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
REFUSED(ActivateModelPartition, fmi3ValueReference clockReference, fmi3Float64 activationTime)
