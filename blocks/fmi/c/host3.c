/* FMI 3.0.2 in the process of the FMU: frames become calls. */
#define _GNU_SOURCE
#include "calls3.h"
#include "fmi3.h"
#include "host.h"

#include <stdlib.h>
#include <string.h>

#define MEMBER(name) __typeof__(fmi3##name) *name;
typedef struct {
    FMI3_CALLS(MEMBER)
    fmi3Instance instance;
    unsigned char has[FMI3_END];
} Fmu;

static void find(Host *h)
{
    Fmu *fmu = calloc(1, sizeof *fmu);
    if (!fmu)
        abort();
    /* ISO C has no way from a pointer to an object to one to a function; POSIX has them alike. */
#define FIND(name)                                           \
    {                                                        \
        void *found = host_symbol(h, "fmi3" #name);          \
        memcpy(&fmu->name, &found, sizeof found);            \
        fmu->has[FMI3_##name] = found != NULL;               \
    }
    FMI3_CALLS(FIND)
    h->fmu = fmu;
}

static const char *name_of(int function)
{
#define NAME(name) #name,
    static const char *const NAMES[] = {FMI3_CALLS(NAME)};
    return function > FMI3_BEFORE && function < FMI3_END ? NAMES[function - FIRST_FUNCTION] : NULL;
}

static void log_message(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                        fmi3String message)
{
    host_log(environment, (int)status, category, message);
}

static void update(fmi3InstanceEnvironment environment, fmi3Float64 t, fmi3Boolean set, fmi3Boolean get,
                   fmi3Boolean finished, fmi3Boolean can_return, fmi3Boolean *early, fmi3Float64 *early_time)
{
    const uint64_t flags[] = {set, get, finished, can_return};
    unsigned char begun = 0; /* a bool that was never set may be neither */
    double time = t;
    if (early)
        memcpy(&begun, early, sizeof begun);
    if (early_time)
        time = *early_time;
    int wants = begun == 1;
    host_update(environment, t, flags, &wants, &time);
    if (early)
        *early = wants != 0;
    if (early_time)
        *early_time = time;
}

#define A(k) host_array(h, f, (k))
#define N(k) f->n[k]
#define B(k) (f->n[k] != 0)

static fmi3Status instantiate(Host *h, Fmu *fmu, Frame *f)
{
    fmi3LogMessageCallback log = N(2) & 1 ? log_message : NULL;
    if (f->function == FMI3_InstantiateModelExchange) {
        fmu->instance = fmu->InstantiateModelExchange(A(0), A(1), A(2), B(0), B(1), h, log);
        *(int *)A(3) = fmu->instance != NULL;
    } else {
        fmu->instance = fmu->InstantiateCoSimulation(A(0), A(1), A(2), B(0), B(1), B(3), B(4), A(3), N(5), h, log,
                                                     N(2) & 2 ? update : NULL);
        *(int *)A(4) = fmu->instance != NULL;
    }
    return fmi3OK;
}

/* Functions whose arguments hold strings. */
static fmi3Status with_strings(Host *h, Fmu *fmu, Frame *f)
{
    const size_t n = N(1);
    const int is_set = f->function != FMI3_GetString;
    const char **strings =
        is_set ? host_strings(h, f, f->function == FMI3_SetString, n) : calloc(n + 1, sizeof *strings);
    fmi3Status status = fmi3Error;
    if (!strings)
        return status;
    if (f->function == FMI3_SetDebugLogging)
        status = fmu->SetDebugLogging(fmu->instance, B(0), n, strings);
    else if (is_set)
        status = fmu->SetString(fmu->instance, A(0), N(0), strings, n);
    else
        status = fmu->GetString(fmu->instance, A(0), N(0), strings, n);
    if (!is_set && (status == fmi3OK || status == fmi3Warning) && host_leave_strings(h, f, 1, strings, n))
        status = fmi3Error;
    free(strings);
    return status;
}

/* Functions with a state of the FMU, which is a number in the frame. */
static fmi3Status with_state(Host *h, Fmu *fmu, Frame *f)
{
    fmi3Instance c = fmu->instance;
    const int k = f->function == FMI3_DeserializeFMUState;
    const int is_inout = k || f->function == FMI3_GetFMUState || f->function == FMI3_FreeFMUState;
    uint64_t *inout = is_inout ? A(k) : NULL, number = inout ? *inout : N(0);
    fmi3FMUState state = NULL;
    fmi3Status status = fmi3Error;
    if ((is_inout && !inout) || host_state(h, number, &state)) {
        host_log(h, (int)fmi3Error, "logStatusError", "there is no such state of the FMU");
        return fmi3Error;
    }
    switch (f->function) {
    case FMI3_GetFMUState: status = fmu->GetFMUState(c, &state); break;
    case FMI3_SetFMUState: return fmu->SetFMUState(c, state);
    case FMI3_FreeFMUState: status = fmu->FreeFMUState(c, &state); break;
    case FMI3_SerializedFMUStateSize: return fmu->SerializedFMUStateSize(c, state, A(0));
    case FMI3_SerializeFMUState: return fmu->SerializeFMUState(c, state, A(0), N(1));
    default: status = fmu->DeserializeFMUState(c, A(0), N(0), &state);
    }
    *inout = host_keep(h, number, state);
    return status;
}

static fmi3Status call(Host *h, Fmu *fmu, Frame *f)
{
    fmi3Instance c = fmu->instance;
    switch (f->function) {
    case FMI3_InstantiateModelExchange:
    case FMI3_InstantiateCoSimulation: return instantiate(h, fmu, f);
    case FMI3_FreeInstance: fmu->FreeInstance(c); h->is_over = 1; return fmi3OK;
    case FMI3_EnterInitializationMode:
        return fmu->EnterInitializationMode(c, B(0), f->x[0], f->x[1], B(1), f->x[2]);
    case FMI3_ExitInitializationMode: return fmu->ExitInitializationMode(c);
    case FMI3_EnterEventMode: return fmu->EnterEventMode(c);
    case FMI3_Terminate: return fmu->Terminate(c);
    case FMI3_Reset: return fmu->Reset(c);
#define OF_TYPE(type)                                                              \
    case FMI3_Get##type: return fmu->Get##type(c, A(0), N(0), A(1), N(1));         \
    case FMI3_Set##type: return fmu->Set##type(c, A(0), N(0), A(1), N(1));
    FMI3_TYPES(OF_TYPE)
    case FMI3_SetDebugLogging:
    case FMI3_SetString:
    case FMI3_GetString: return with_strings(h, fmu, f);
    case FMI3_GetNumberOfVariableDependencies:
        return fmu->GetNumberOfVariableDependencies(c, (fmi3ValueReference)N(0), A(0));
    case FMI3_GetVariableDependencies:
        return fmu->GetVariableDependencies(c, (fmi3ValueReference)N(0), A(0), A(1), A(2), A(3), N(1));
    case FMI3_GetFMUState:
    case FMI3_SetFMUState:
    case FMI3_FreeFMUState:
    case FMI3_SerializedFMUStateSize:
    case FMI3_SerializeFMUState:
    case FMI3_DeserializeFMUState: return with_state(h, fmu, f);
    case FMI3_GetDirectionalDerivative:
        return fmu->GetDirectionalDerivative(c, A(0), N(0), A(1), N(1), A(2), N(2), A(3), N(3));
    case FMI3_GetAdjointDerivative:
        return fmu->GetAdjointDerivative(c, A(0), N(0), A(1), N(1), A(2), N(2), A(3), N(3));
    case FMI3_EnterConfigurationMode: return fmu->EnterConfigurationMode(c);
    case FMI3_ExitConfigurationMode: return fmu->ExitConfigurationMode(c);
    case FMI3_EvaluateDiscreteStates: return fmu->EvaluateDiscreteStates(c);
    case FMI3_UpdateDiscreteStates: return fmu->UpdateDiscreteStates(c, A(0), A(1), A(2), A(3), A(4), A(5));
    case FMI3_EnterContinuousTimeMode: return fmu->EnterContinuousTimeMode(c);
    case FMI3_CompletedIntegratorStep: return fmu->CompletedIntegratorStep(c, B(0), A(0), A(1));
    case FMI3_SetTime: return fmu->SetTime(c, f->x[0]);
    case FMI3_SetContinuousStates: return fmu->SetContinuousStates(c, A(0), N(0));
    case FMI3_GetContinuousStateDerivatives: return fmu->GetContinuousStateDerivatives(c, A(0), N(0));
    case FMI3_GetEventIndicators: return fmu->GetEventIndicators(c, A(0), N(0));
    case FMI3_GetContinuousStates: return fmu->GetContinuousStates(c, A(0), N(0));
    case FMI3_GetNominalsOfContinuousStates: return fmu->GetNominalsOfContinuousStates(c, A(0), N(0));
    case FMI3_GetNumberOfEventIndicators: return fmu->GetNumberOfEventIndicators(c, A(0));
    case FMI3_GetNumberOfContinuousStates: return fmu->GetNumberOfContinuousStates(c, A(0));
    case FMI3_EnterStepMode: return fmu->EnterStepMode(c);
    case FMI3_GetOutputDerivatives: return fmu->GetOutputDerivatives(c, A(0), N(0), A(1), A(2), N(1));
    case FMI3_DoStep: return fmu->DoStep(c, f->x[0], f->x[1], B(0), A(0), A(1), A(2), A(3));
    default: return fmi3Error;
    }
}

static int serve(Host *h, Frame *f)
{
    Fmu *fmu = h->fmu;
    const char *name = name_of(f->function);
    if (!name || !fmu->has[f->function])
        return host_missing(h, name ? name : "?");
    return (int)call(h, fmu, f);
}

const Standard host_fmi3 = {find, serve, "fmi3"};
