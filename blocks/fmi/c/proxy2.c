/* FMI 2.0.4, of an FMU that runs in a process of its own: each function hands its arguments on. Checks are left to the
   FMU, so that it answers as it would without this. One difference: calls are never answered later, as the importer's
   stepFinished is not handed on; an FMU that has no other way to tell may return fmi2Pending, and is asked by
   fmi2GetStatus. */
#define _GNU_SOURCE
#include "calls2.h"
#include "fmi2.h"
#include "proxy.h"

#include <stdlib.h>
#include <string.h>

typedef struct {
    Proxy proxy; /* first */
    fmi2CallbackFunctions callbacks;
    char *name;
} Instance;

#define COUNT(array) ((int)(sizeof(array) / sizeof *(array)))
/* A call of a function with arrays, and with the numbers that follow. */
#define FORWARD(c, called, arrays, ...)                                                                        \
    (fmi2Status) proxy_call((c), &(Request){.function = FMI2_##called, .name = "fmi2" #called, __VA_ARGS__}, \
                            (arrays), COUNT(arrays))
#define PLAIN(c, called, ...) \
    (fmi2Status) proxy_call((c), &(Request){.function = FMI2_##called, .name = "fmi2" #called, __VA_ARGS__}, NULL, 0)

static uint64_t number(int value)
{
    return (uint64_t)(int64_t)value;
}

static void tell(Proxy *p, int status, const char *category, const char *message)
{
    const Instance *in = (const Instance *)p;
    if (!in->callbacks.logger)
        return;
    /* Loggers that are not written in C may not see the arguments behind the message. */
    if (strchr(message, '%'))
        in->callbacks.logger(in->callbacks.componentEnvironment, in->name, (fmi2Status)status, category, "%s", message);
    else
        in->callbacks.logger(in->callbacks.componentEnvironment, in->name, (fmi2Status)status, category, message);
}

const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    Instance *in = calloc(1, sizeof *in);
    if (!in)
        return NULL;
    in->name = strdup(instanceName ? instanceName : "");
    if (functions)
        in->callbacks = *functions;
    in->proxy.tell = tell;
    int is_made = 0;
    if (in->name && proxy_start(&in->proxy, "2") == 0) {
        const Array arrays[] = {
            {instanceName, NULL, proxy_length(instanceName)},
            {fmuGUID, NULL, proxy_length(fmuGUID)},
            {fmuResourceLocation, NULL, proxy_length(fmuResourceLocation)},
            OUT(&is_made, 1),
        };
        FORWARD(&in->proxy, Instantiate, arrays, .n = {(uint64_t)fmuType, number(visible), number(loggingOn)});
    }
    if (is_made)
        return in;
    if (in->proxy.head)
        proxy_abandon(&in->proxy);
    free(in->name);
    free(in);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c)
{
    Instance *in = c;
    if (!in)
        return;
    proxy_end(&in->proxy, &(Request){.function = FMI2_FreeInstance, .name = "fmi2FreeInstance"});
    free(in->name);
    free(in);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    size_t bytes = 0;
    char *joined = categories ? proxy_join(categories, nCategories, &bytes) : NULL;
    if (nCategories && !joined)
        return (fmi2Status)proxy_refuse(c, "fmi2SetDebugLogging", "a category is a null pointer");
    const Array arrays[] = {{joined, NULL, bytes}};
    const fmi2Status status = FORWARD(c, SetDebugLogging, arrays, .n = {number(loggingOn), nCategories});
    free(joined);
    return status;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    return PLAIN(c, SetupExperiment, .n = {number(toleranceDefined), number(stopTimeDefined)},
                 .x = {tolerance, startTime, stopTime});
}

#define WITHOUT_ARGUMENTS(called)            \
    fmi2Status fmi2##called(fmi2Component c) \
    {                                        \
        return PLAIN(c, called, .n = {0});   \
    }
WITHOUT_ARGUMENTS(EnterInitializationMode)
WITHOUT_ARGUMENTS(ExitInitializationMode)
WITHOUT_ARGUMENTS(Terminate)
WITHOUT_ARGUMENTS(Reset)
WITHOUT_ARGUMENTS(EnterEventMode)
WITHOUT_ARGUMENTS(EnterContinuousTimeMode)
WITHOUT_ARGUMENTS(CancelStep)

/* --- variables ---- */

#define OF_TYPE(type)                                                                                             \
    fmi2Status fmi2Get##type(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2##type value[])       \
    {                                                                                                             \
        const Array arrays[] = {IN(vr, nvr), OUT(value, nvr)};                                                    \
        return FORWARD(c, Get##type, arrays, .n = {nvr});                                                         \
    }                                                                                                             \
    fmi2Status fmi2Set##type(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2##type value[]) \
    {                                                                                                             \
        const Array arrays[] = {IN(vr, nvr), IN(value, nvr)};                                                     \
        return FORWARD(c, Set##type, arrays, .n = {nvr});                                                         \
    }
OF_TYPE(Real)
OF_TYPE(Integer)
OF_TYPE(Boolean)

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    const Array arrays[] = {IN(vr, nvr), {"", NULL, 1}};
    const fmi2Status status = FORWARD(c, GetString, arrays, .n = {nvr});
    if ((status == fmi2OK || status == fmi2Warning) && proxy_take_strings(c, 1, value, nvr))
        return (fmi2Status)proxy_refuse(c, "fmi2GetString", "no strings came back");
    return status;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[])
{
    size_t bytes = 0;
    char *joined = value ? proxy_join(value, nvr, &bytes) : NULL;
    if (nvr && !joined)
        return (fmi2Status)proxy_refuse(c, "fmi2SetString", "a value is a null pointer");
    const Array arrays[] = {IN(vr, nvr), {joined, NULL, bytes}};
    const fmi2Status status = FORWARD(c, SetString, arrays, .n = {nvr});
    free(joined);
    return status;
}

/* --- states of the FMU: numbers that the other side gives them, from 1 ---- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    const Array arrays[] = {OUT(FMUstate, 1)};
    return FORWARD(c, GetFMUstate, arrays, .n = {0});
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    return PLAIN(c, SetFMUstate, .n = {(uintptr_t)FMUstate});
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    const Array arrays[] = {OUT(FMUstate, 1)};
    return FORWARD(c, FreeFMUstate, arrays, .n = {0});
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    const Array arrays[] = {OUT(size, 1)};
    return FORWARD(c, SerializedFMUstateSize, arrays, .n = {(uintptr_t)FMUstate});
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    const Array arrays[] = {OUT(serializedState, size)};
    return FORWARD(c, SerializeFMUstate, arrays, .n = {(uintptr_t)FMUstate, size});
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    const Array arrays[] = {IN(serializedState, size), OUT(FMUstate, 1)};
    return FORWARD(c, DeSerializeFMUstate, arrays, .n = {size});
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[])
{
    const Array arrays[] = {IN(vUnknown_ref, nUnknown), IN(vKnown_ref, nKnown), IN(dvKnown, nKnown),
                            OUT(dvUnknown, nUnknown)};
    return FORWARD(c, GetDirectionalDerivative, arrays, .n = {nUnknown, nKnown});
}

/* --- Model Exchange ---- */

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo)
{
    const Array arrays[] = {OUT(eventInfo, 1)};
    return FORWARD(c, NewDiscreteStates, arrays, .n = {0});
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation)
{
    const Array arrays[] = {OUT(enterEventMode, 1), OUT(terminateSimulation, 1)};
    return FORWARD(c, CompletedIntegratorStep, arrays, .n = {number(noSetFMUStatePriorToCurrentPoint)});
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    return PLAIN(c, SetTime, .x = {time});
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx)
{
    const Array arrays[] = {IN(x, nx)};
    return FORWARD(c, SetContinuousStates, arrays, .n = {nx});
}

#define REALS(called)                                                    \
    fmi2Status fmi2##called(fmi2Component c, fmi2Real values[], size_t n) \
    {                                                                    \
        const Array arrays[] = {OUT(values, n)};                         \
        return FORWARD(c, called, arrays, .n = {n});                     \
    }
REALS(GetDerivatives)
REALS(GetEventIndicators)
REALS(GetContinuousStates)
REALS(GetNominalsOfContinuousStates)

/* --- Co-Simulation ---- */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    const Array arrays[] = {IN(vr, nvr), IN(order, nvr), IN(value, nvr)};
    return FORWARD(c, SetRealInputDerivatives, arrays, .n = {nvr});
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[])
{
    const Array arrays[] = {IN(vr, nvr), IN(order, nvr), OUT(value, nvr)};
    return FORWARD(c, GetRealOutputDerivatives, arrays, .n = {nvr});
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    return PLAIN(c, DoStep, .n = {number(noSetFMUStatePriorToCurrentPoint)},
                 .x = {currentCommunicationPoint, communicationStepSize});
}

#define STATUS(called, type)                                                            \
    fmi2Status fmi2##called(fmi2Component c, const fmi2StatusKind s, fmi2##type *value) \
    {                                                                                   \
        const Array arrays[] = {OUT(value, 1)};                                         \
        return FORWARD(c, called, arrays, .n = {(uint64_t)s});                          \
    }
STATUS(GetStatus, Status)
STATUS(GetRealStatus, Real)
STATUS(GetIntegerStatus, Integer)
STATUS(GetBooleanStatus, Boolean)

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    const Array arrays[] = {{"", NULL, 1}};
    const fmi2Status status = FORWARD(c, GetStringStatus, arrays, .n = {(uint64_t)s});
    if ((status == fmi2OK || status == fmi2Warning) && proxy_take_strings(c, 0, value, 1))
        return (fmi2Status)proxy_refuse(c, "fmi2GetStringStatus", "no string came back");
    return status;
}
