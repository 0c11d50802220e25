/* FMI 2.0.4: each call of the standard is checked here - whether this kind of instance has it, whether it is allowed in
   the present mode, its pointers, its sizes - and handed to the core. A call that does not pass tells why in the
   category logStatusError, returns fmi2Error and changes nothing. A call without an instance returns fmi2Error. The
   functions that FMI 3.0 has alike are in standard.h. */
#include "fmi2.h"
#include "fmu.h"

typedef struct {
    Fmu *fmu;
    char *name;
    const char *call; /* the present one, for messages */
    fmi2CallbackFunctions callbacks;
    int has_tolerance, has_stop, terminated;
    double tolerance, start, stop;
} Instance;

#define FMI(name) FMI_2(name)
#define FMI_2(name) fmi2##name
#define STATE(verb, rest) STATE_2(verb, rest)
#define STATE_2(verb, rest) verb##FMUstate##rest
#define DESERIALIZE DeSerialize
#define DERIVATIVES GetDerivatives
#define ELEMENTS(reference) ((void)(reference), (size_t)1)
#define STEP_MODE "between communication steps"
#define ANY SETABLE

/* The tables "allowed function calls" of sections 3.2.3 and 4.2.4 of the standard. It does not say whether the nominal
   values and, in initialization mode, the derivatives can be asked for; its mathematical description has both, and
   nothing is harmed. */
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
    C(CancelStep, CS, NEVER)                              \
    C(GetStatus, CS, STEP | FMU_TERMINATED)               \
    C(GetRealStatus, CS, STEP | FMU_TERMINATED)           \
    C(GetIntegerStatus, CS, STEP | FMU_TERMINATED)        \
    C(GetBooleanStatus, CS, STEP | FMU_TERMINATED)        \
    C(GetStringStatus, CS, STEP | FMU_TERMINATED)

#include "standard.h"

static void log_message(const Instance *in, Status status, const char *category, const char *message)
{
    if (in->callbacks.logger)
        in->callbacks.logger(in->callbacks.componentEnvironment, in->name, status, category, "%s", message);
}

static const char *why_never(int call)
{
    (void)call;
    return "steps are never asynchronous; there is none to cancel";
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

/* --- both kinds ---- */
const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
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
    in->fmu = fmu_new(fmuType == fmi2ModelExchange ? FMU_ME : FMU_CS, in->name, fmuGUID,
                      fmuResourceLocation, tell, in);
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
    if (!in || wrong_experiment(in, toleranceDefined, tolerance, startTime, stopTimeDefined, stopTime))
        return fmi2Error;
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
static int lacks_arrays(Instance *in, const fmi2ValueReference vr[], size_t nvr, const void *value)
{
    return missing(in, vr, nvr, "vr") || missing(in, value, nvr, "value");
}

static int put_integer(Instance *in, fmi2ValueReference variable, void *values, size_t at, double number)
{
    if (!(number >= INT32_MIN && number <= INT32_MAX)) {
        refuse(in, "value reference %u has %.17g, which is beyond an fmi2Integer.", variable, number);
        return 0;
    }
    ((fmi2Integer *)values)[at] = (fmi2Integer)number;
    return 1;
}

static double integer_at(const void *values, size_t at)
{
    return ((const fmi2Integer *)values)[at];
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    Instance *in = enter(c, CALL_GetReal);
    return !in || lacks_arrays(in, vr, nvr, value) ? fmi2Error : get_reals(in, vr, nvr, value);
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[])
{
    Instance *in = enter(c, CALL_GetInteger);
    if (!in || lacks_arrays(in, vr, nvr, value) || !all_of(in, vr, nvr, FMU_INTEGER, "Integer or an Enumeration"))
        return fmi2Error;
    return get_numbers(in, vr, nvr, FMU_INTEGER, value, put_integer);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[])
{
    Instance *in = enter(c, CALL_GetBoolean);
    if (!in || lacks_arrays(in, vr, nvr, value))
        return fmi2Error;
    return get_numbers(in, vr, nvr, FMU_BOOLEAN, value, put_boolean);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    Instance *in = enter(c, CALL_GetString);
    return !in || lacks_arrays(in, vr, nvr, value) ? fmi2Error : get_strings(in, vr, nvr, value);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    Instance *in = enter(c, CALL_SetReal);
    if (!in || lacks_arrays(in, vr, nvr, value) || !all_of(in, vr, nvr, FMU_REAL, "Real") ||
        !all_finite(in, value, nvr))
        return fmi2Error;
    return set_reals(in, vr, nvr, value);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer value[])
{
    Instance *in = enter(c, CALL_SetInteger);
    if (!in || lacks_arrays(in, vr, nvr, value) || !all_of(in, vr, nvr, FMU_INTEGER, "Integer or an Enumeration"))
        return fmi2Error;
    return set_numbers(in, vr, nvr, FMU_INTEGER, value, integer_at);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Boolean value[])
{
    Instance *in = enter(c, CALL_SetBoolean);
    if (!in || lacks_arrays(in, vr, nvr, value) || !all_of(in, vr, nvr, FMU_BOOLEAN, "Boolean"))
        return fmi2Error;
    return set_numbers(in, vr, nvr, FMU_BOOLEAN, value, boolean_at);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[])
{
    Instance *in = enter(c, CALL_SetString);
    if (!in || lacks_arrays(in, vr, nvr, value))
        return fmi2Error;
    return nvr ? refuse(in, "no String of this FMU can be set.") : fmi2OK;
}

/* --- states of the FMU ---- */

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    Instance *in = enter(c, CALL_SetFMUstate);
    if (!in || missing(in, FMUstate, 1, "FMUstate"))
        return fmi2Error;
    in->terminated = 0;
    return (fmi2Status)fmu_restore(in->fmu, FMUstate);
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
    if (!in || wrong_step(in, currentCommunicationPoint, communicationStepSize))
        return fmi2Error;
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
