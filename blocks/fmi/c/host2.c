/* FMI 2.0.4 in the process of the FMU: frames become calls. */
#define _GNU_SOURCE
#include "calls2.h"
#include "fmi2.h"
#include "host.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MEMBER(name) __typeof__(fmi2##name) *name;
typedef struct {
    FMI2_CALLS(MEMBER)
    fmi2Component instance;
    fmi2CallbackFunctions callbacks; /* the FMU may keep a pointer to them */
    unsigned char has[FMI2_END];
} Fmu;

static void find(Host *h)
{
    Fmu *fmu = calloc(1, sizeof *fmu);
    if (!fmu)
        abort();
    /* ISO C has no way from a pointer to an object to one to a function; POSIX has them alike. */
#define FIND(name)                                           \
    {                                                        \
        void *found = host_symbol(h, "fmi2" #name);          \
        memcpy(&fmu->name, &found, sizeof found);            \
        fmu->has[FMI2_##name] = found != NULL;               \
    }
    FMI2_CALLS(FIND)
    h->fmu = fmu;
}

static const char *name_of(int function)
{
#define NAME(name) #name,
    static const char *const NAMES[] = {FMI2_CALLS(NAME)};
    return function > FMI2_BEFORE && function < FMI2_END ? NAMES[function - FIRST_FUNCTION] : NULL;
}

/* The arguments are put into the message here: they do not go to another process. */
static void logger(fmi2ComponentEnvironment environment, fmi2String instanceName, fmi2Status status,
                   fmi2String category, fmi2String message, ...)
{
    char small[1024], *text = small;
    va_list rest;
    (void)instanceName;
    va_start(rest, message);
    const int length = vsnprintf(small, sizeof small, message ? message : "", rest);
    va_end(rest);
    if (length >= (int)sizeof small && (text = malloc((size_t)length + 1)) != NULL) {
        va_start(rest, message);
        vsnprintf(text, (size_t)length + 1, message, rest);
        va_end(rest);
    }
    host_log(environment, status, category, length < 0 ? message : text ? text : small);
    if (text != small)
        free(text);
}

static void *allocate(size_t n, size_t size)
{
    return calloc(n, size);
}

static void instantiate(Host *h, Fmu *fmu, Frame *f)
{
    fmu->callbacks = (fmi2CallbackFunctions){logger, allocate, free, NULL, h};
    fmu->instance = fmu->Instantiate(host_array(h, f, 0), (fmi2Type)f->n[0], host_array(h, f, 1), host_array(h, f, 2),
                                     &fmu->callbacks, (fmi2Boolean)f->n[1], (fmi2Boolean)f->n[2]);
    *(int *)host_array(h, f, 3) = fmu->instance != NULL;
}

/* Functions whose arguments hold strings. */
static fmi2Status with_strings(Host *h, Fmu *fmu, Frame *f)
{
    const size_t n = f->function == FMI2_SetDebugLogging ? f->n[1] : f->function == FMI2_GetStringStatus ? 1 : f->n[0];
    const int is_set = f->function == FMI2_SetDebugLogging || f->function == FMI2_SetString;
    const char **strings =
        is_set ? host_strings(h, f, f->function == FMI2_SetString, n) : calloc(n + 1, sizeof *strings);
    fmi2Status status = fmi2Error;
    if (!strings)
        return status;
    switch (f->function) {
    case FMI2_SetDebugLogging: status = fmu->SetDebugLogging(fmu->instance, (fmi2Boolean)f->n[0], n, strings); break;
    case FMI2_SetString: status = fmu->SetString(fmu->instance, host_array(h, f, 0), n, strings); break;
    case FMI2_GetString: status = fmu->GetString(fmu->instance, host_array(h, f, 0), n, strings); break;
    default: status = fmu->GetStringStatus(fmu->instance, (fmi2StatusKind)f->n[0], strings);
    }
    if (!is_set && (status == fmi2OK || status == fmi2Warning) &&
        host_leave_strings(h, f, f->function == FMI2_GetString, strings, n))
        status = fmi2Error;
    free(strings);
    return status;
}

/* Functions with a state of the FMU, which is a number in the frame. */
static fmi2Status with_state(Host *h, Fmu *fmu, Frame *f)
{
    fmi2Component c = fmu->instance;
    const int k = f->function == FMI2_DeSerializeFMUstate;
    const int is_inout = k || f->function == FMI2_GetFMUstate || f->function == FMI2_FreeFMUstate;
    uint64_t *inout = is_inout ? host_array(h, f, k) : NULL, number = inout ? *inout : f->n[0];
    fmi2FMUstate state = NULL;
    fmi2Status status = fmi2Error;
    if ((is_inout && !inout) || host_state(h, number, &state)) {
        host_log(h, fmi2Error, "logStatusError", "there is no such state of the FMU");
        return fmi2Error;
    }
    switch (f->function) {
    case FMI2_GetFMUstate: status = fmu->GetFMUstate(c, &state); break;
    case FMI2_SetFMUstate: return fmu->SetFMUstate(c, state);
    case FMI2_FreeFMUstate: status = fmu->FreeFMUstate(c, &state); break;
    case FMI2_SerializedFMUstateSize: return fmu->SerializedFMUstateSize(c, state, host_array(h, f, 0));
    case FMI2_SerializeFMUstate: return fmu->SerializeFMUstate(c, state, host_array(h, f, 0), f->n[1]);
    default: status = fmu->DeSerializeFMUstate(c, host_array(h, f, 0), f->n[0], &state);
    }
    *inout = host_keep(h, number, state);
    return status;
}

#define A(k) host_array(h, f, (k))
#define N(k) f->n[k]
#define B(k) ((fmi2Boolean)f->n[k])

static int serve(Host *h, Frame *f)
{
    Fmu *fmu = h->fmu;
    fmi2Component c = fmu->instance;
    const char *name = name_of(f->function);
    if (!name || !fmu->has[f->function])
        return host_missing(h, name ? name : "?");
    switch (f->function) {
    case FMI2_Instantiate: instantiate(h, fmu, f); return fmi2OK;
    case FMI2_FreeInstance: fmu->FreeInstance(c); h->is_over = 1; return fmi2OK;
    case FMI2_SetupExperiment: return fmu->SetupExperiment(c, B(0), f->x[0], f->x[1], B(1), f->x[2]);
    case FMI2_EnterInitializationMode: return fmu->EnterInitializationMode(c);
    case FMI2_ExitInitializationMode: return fmu->ExitInitializationMode(c);
    case FMI2_Terminate: return fmu->Terminate(c);
    case FMI2_Reset: return fmu->Reset(c);
    case FMI2_GetReal: return fmu->GetReal(c, A(0), N(0), A(1));
    case FMI2_GetInteger: return fmu->GetInteger(c, A(0), N(0), A(1));
    case FMI2_GetBoolean: return fmu->GetBoolean(c, A(0), N(0), A(1));
    case FMI2_SetReal: return fmu->SetReal(c, A(0), N(0), A(1));
    case FMI2_SetInteger: return fmu->SetInteger(c, A(0), N(0), A(1));
    case FMI2_SetBoolean: return fmu->SetBoolean(c, A(0), N(0), A(1));
    case FMI2_SetDebugLogging:
    case FMI2_SetString:
    case FMI2_GetString:
    case FMI2_GetStringStatus: return with_strings(h, fmu, f);
    case FMI2_GetFMUstate:
    case FMI2_SetFMUstate:
    case FMI2_FreeFMUstate:
    case FMI2_SerializedFMUstateSize:
    case FMI2_SerializeFMUstate:
    case FMI2_DeSerializeFMUstate: return with_state(h, fmu, f);
    case FMI2_GetDirectionalDerivative: return fmu->GetDirectionalDerivative(c, A(0), N(0), A(1), N(1), A(2), A(3));
    case FMI2_EnterEventMode: return fmu->EnterEventMode(c);
    case FMI2_NewDiscreteStates: return fmu->NewDiscreteStates(c, A(0));
    case FMI2_EnterContinuousTimeMode: return fmu->EnterContinuousTimeMode(c);
    case FMI2_CompletedIntegratorStep: return fmu->CompletedIntegratorStep(c, B(0), A(0), A(1));
    case FMI2_SetTime: return fmu->SetTime(c, f->x[0]);
    case FMI2_SetContinuousStates: return fmu->SetContinuousStates(c, A(0), N(0));
    case FMI2_GetDerivatives: return fmu->GetDerivatives(c, A(0), N(0));
    case FMI2_GetEventIndicators: return fmu->GetEventIndicators(c, A(0), N(0));
    case FMI2_GetContinuousStates: return fmu->GetContinuousStates(c, A(0), N(0));
    case FMI2_GetNominalsOfContinuousStates: return fmu->GetNominalsOfContinuousStates(c, A(0), N(0));
    case FMI2_SetRealInputDerivatives: return fmu->SetRealInputDerivatives(c, A(0), N(0), A(1), A(2));
    case FMI2_GetRealOutputDerivatives: return fmu->GetRealOutputDerivatives(c, A(0), N(0), A(1), A(2));
    case FMI2_DoStep: return fmu->DoStep(c, f->x[0], f->x[1], B(0));
    case FMI2_CancelStep: return fmu->CancelStep(c);
    case FMI2_GetStatus: return fmu->GetStatus(c, (fmi2StatusKind)N(0), A(0));
    case FMI2_GetRealStatus: return fmu->GetRealStatus(c, (fmi2StatusKind)N(0), A(0));
    case FMI2_GetIntegerStatus: return fmu->GetIntegerStatus(c, (fmi2StatusKind)N(0), A(0));
    case FMI2_GetBooleanStatus: return fmu->GetBooleanStatus(c, (fmi2StatusKind)N(0), A(0));
    default: return host_missing(h, name);
    }
}

const Standard host_fmi2 = {find, serve, "fmi2"};
