/* FMI 3.0.2, of an FMU that runs in a process of its own: each function hands its arguments on. Checks are left to the
   FMU, so that it answers as it would without this. Scheduled Execution, clocks and binary values are refused. */
#define _GNU_SOURCE
#include "calls3.h"
#include "proxy_calls.h"

typedef struct {
    Proxy proxy; /* first */
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    fmi3IntermediateUpdateCallback update;
} Instance;

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
        {&is_made, &is_made, sizeof is_made},
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
        {requiredIntermediateVariables, NULL,
         proxy_bytes(nRequiredIntermediateVariables, sizeof *requiredIntermediateVariables)},
        {&is_made, &is_made, sizeof is_made},
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
    proxy_end(&in->proxy, &(Request){.function = CALL_FreeInstance, .name = "fmi3FreeInstance"});
    free(in);
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
