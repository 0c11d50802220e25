/* Calls every function of FMI 2.0 in every mode, allowed or not, with right and with wrong arguments; see driver.h. */
#include "driver.h"
#include "fmi2.h"

#define FMI(name) fmi2##name
#define MOVE(call, c, vr, values) call(c, vr, 1, values)
#define fmi2FMUState fmi2FMUstate
#define fmi2GetFMUState fmi2GetFMUstate
#define fmi2SetFMUState fmi2SetFMUstate
#define fmi2FreeFMUState fmi2FreeFMUstate
#define fmi2SerializedFMUStateSize fmi2SerializedFMUstateSize
#define fmi2SerializeFMUState fmi2SerializeFMUstate
#define fmi2DeserializeFMUState fmi2DeSerializeFMUstate
#define fmi2Float64 fmi2Real
#define fmi2GetFloat64 fmi2GetReal
#define fmi2SetFloat64 fmi2SetReal
#define fmi2GetContinuousStateDerivatives fmi2GetDerivatives
typedef fmi2Component Instance;
#include "driver_calls.h"

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...)
{
    char text[1000];
    va_list arguments;
    (void)environment, (void)status;
    va_start(arguments, message);
    vsnprintf(text, sizeof text, message, arguments);
    va_end(arguments);
    if (name && category && text[0])
        at.messages++;
}

static const fmi2CallbackFunctions CALLBACKS = {logger, calloc, free, NULL, NULL};

/* --- both kinds ---- */
static void try_versions(fmi2Component c)
{
    (void)c;
    at.function = "fmi2GetVersion";
    TRY("valid", strcmp(fmi2GetVersion(), "2.0") != 0);
    at.function = "fmi2GetTypesPlatform";
    TRY("valid", strcmp(fmi2GetTypesPlatform(), "default") != 0);
}

static void try_experiment(fmi2Component c)
{
    at.function = "fmi2SetupExperiment";
    TRY("nobody", fmi2SetupExperiment(NULL, fmi2False, 0, 0, fmi2False, 0));
    TRY("wrong", fmi2SetupExperiment(c, fmi2True, 0, 0, fmi2False, 0));
    TRY("wrong", fmi2SetupExperiment(c, fmi2True, NAN, 0, fmi2False, 0));
    TRY("wrong", fmi2SetupExperiment(c, fmi2False, 0, NAN, fmi2False, 0));
    TRY("wrong", fmi2SetupExperiment(c, fmi2False, 0, 0, fmi2True, -1));
    TRY("wrong", fmi2SetupExperiment(c, fmi2False, 0, 0, fmi2True, INFINITY));
    TRY("valid", fmi2SetupExperiment(c, fmi2True, 1e-6, 0, fmi2True, DRIVER_STOP));
    TRY("valid", fmi2SetupExperiment(c, fmi2False, NAN, 0, fmi2False, NAN));
}

TRY_PLAIN(enter_initialization, fmi2EnterInitializationMode)
TRY_PLAIN(cancel, fmi2CancelStep)

#define TRY_TYPE(type, own, get_variant, other)                               \
    static void try_get_##type(fmi2Component c)                               \
    {                                                                         \
        const int found = first_of(own), no = first_of(other);                \
        const fmi2ValueReference vr[1] = {(fmi2ValueReference)found};         \
        const fmi2ValueReference wrong[1] = {(fmi2ValueReference)no};         \
        fmi2##type value[1];                                                  \
        at.function = "fmi2Get" #type;                                        \
        TRY("nobody", fmi2Get##type(NULL, vr, 1, value));                     \
        TRY("none", fmi2Get##type(c, NULL, 0, NULL));                         \
        TRY("null", fmi2Get##type(c, NULL, 1, value));                        \
        TRY("null", fmi2Get##type(c, vr, 1, NULL));                           \
        TRY("wrong", fmi2Get##type(c, NOWHERE, 1, value));                    \
        if (no >= 0)                                                          \
            TRY("wrong", fmi2Get##type(c, wrong, 1, value));                  \
        if (found >= 0)                                                       \
            TRY(get_variant, fmi2Get##type(c, vr, 1, value));                 \
    }                                                                         \
    static void try_set_##type(fmi2Component c)                               \
    {                                                                         \
        const int found = first_of(own), no = first_of(other);                \
        const fmi2ValueReference vr[1] = {(fmi2ValueReference)found};         \
        const fmi2ValueReference wrong[1] = {(fmi2ValueReference)no};         \
        const fmi2##type value[1] = {0};                                      \
        at.function = "fmi2Set" #type;                                        \
        TRY("nobody", fmi2Set##type(NULL, vr, 1, value));                     \
        TRY("none", fmi2Set##type(c, NULL, 0, NULL));                         \
        TRY("null", fmi2Set##type(c, NULL, 1, value));                        \
        TRY("null", fmi2Set##type(c, vr, 1, NULL));                           \
        TRY("wrong", fmi2Set##type(c, NOWHERE, 1, value));                    \
        if (no >= 0)                                                          \
            TRY("wrong", fmi2Set##type(c, wrong, 1, value));                  \
        if (found >= 0)                                                       \
            TRY("found", fmi2Set##type(c, vr, 1, value));                     \
    }

TRY_TYPE(Real, FMU_REAL, "valid", FMU_BOOLEAN)
TRY_TYPE(Integer, FMU_INTEGER, "valid", FMU_REAL)
TRY_TYPE(Boolean, FMU_BOOLEAN, "valid", FMU_REAL)
TRY_TYPE(String, FMU_STRING, "valid", FMU_REAL)

/* Every element, by what reads it. */
static void try_all(fmi2Component c)
{
    for (size_t r = 0; r < fmu_references(); r++) {
        const fmi2ValueReference vr[1] = {(fmi2ValueReference)r};
        fmi2Real real;
        fmi2Integer integer;
        fmi2Boolean boolean;
        fmi2String text;
        switch (fmu_type((uint32_t)r)) {
        case FMU_REAL:
            at.function = "fmi2GetReal";
            TRY("valid", fmi2GetReal(c, vr, 1, &real));
            break;
        case FMU_BOOLEAN:
            at.function = "fmi2GetBoolean";
            TRY("valid", fmi2GetBoolean(c, vr, 1, &boolean));
            break;
        case FMU_STRING:
            at.function = "fmi2GetString";
            TRY("valid", fmi2GetString(c, vr, 1, &text));
            break;
        default:
            at.function = "fmi2GetInteger";
            TRY("found", fmi2GetInteger(c, vr, 1, &integer)); /* it may be beyond 32 bits */
        }
    }
}

static void try_derivative(fmi2Component c)
{
    const fmi2ValueReference unknown[1] = {(fmi2ValueReference)DRIVER_OUTPUT};
    const fmi2ValueReference known[1] = {(fmi2ValueReference)DRIVER_STATE};
    const fmi2Real seed[1] = {1}, not_a_number[1] = {NAN};
    fmi2Real out[1];
    at.function = "fmi2GetDirectionalDerivative";
    TRY("nobody", fmi2GetDirectionalDerivative(NULL, unknown, 1, known, 1, seed, out));
    TRY("none", fmi2GetDirectionalDerivative(c, NULL, 0, NULL, 0, NULL, NULL));
    TRY("null", fmi2GetDirectionalDerivative(c, NULL, 1, known, 1, seed, out));
    TRY("null", fmi2GetDirectionalDerivative(c, unknown, 1, NULL, 1, seed, out));
    TRY("null", fmi2GetDirectionalDerivative(c, unknown, 1, known, 1, NULL, out));
    TRY("null", fmi2GetDirectionalDerivative(c, unknown, 1, known, 1, seed, NULL));
    TRY("wrong", fmi2GetDirectionalDerivative(c, NOWHERE, 1, NOWHERE, 1, seed, out));
    if (DRIVER_OUTPUT >= 0 && DRIVER_STATE >= 0) {
        TRY("wrong", fmi2GetDirectionalDerivative(c, unknown, 1, known, 1, not_a_number, out));
        TRY("valid", fmi2GetDirectionalDerivative(c, unknown, 1, known, 1, seed, out));
    }
}

/* --- Model Exchange ---- */
static void try_new_discrete_states(fmi2Component c)
{
    fmi2EventInfo events;
    at.function = "fmi2NewDiscreteStates";
    TRY("nobody", fmi2NewDiscreteStates(NULL, &events));
    TRY("null", fmi2NewDiscreteStates(c, NULL));
    TRY("valid", fmi2NewDiscreteStates(c, &events));
}

/* --- Co-Simulation ---- */
static void try_input_derivatives(fmi2Component c)
{
    const fmi2ValueReference vr[1] = {(fmi2ValueReference)DRIVER_INPUT};
    const fmi2Integer order[1] = {1}, zero[1] = {0};
    const fmi2Real value[1] = {0.5}, not_a_number[1] = {NAN};
    at.function = "fmi2SetRealInputDerivatives";
    TRY("nobody", fmi2SetRealInputDerivatives(NULL, vr, 1, order, value));
    TRY("none", fmi2SetRealInputDerivatives(c, NULL, 0, NULL, NULL));
    TRY("null", fmi2SetRealInputDerivatives(c, NULL, 1, order, value));
    TRY("null", fmi2SetRealInputDerivatives(c, vr, 1, NULL, value));
    TRY("null", fmi2SetRealInputDerivatives(c, vr, 1, order, NULL));
    TRY("wrong", fmi2SetRealInputDerivatives(c, NOWHERE, 1, order, value));
    if (DRIVER_INPUT >= 0) {
        TRY("wrong", fmi2SetRealInputDerivatives(c, vr, 1, zero, value));
        TRY("wrong", fmi2SetRealInputDerivatives(c, vr, 1, order, not_a_number));
        TRY("valid", fmi2SetRealInputDerivatives(c, vr, 1, order, value));
    }
}

static void try_output_derivatives(fmi2Component c)
{
    const fmi2ValueReference vr[1] = {(fmi2ValueReference)DRIVER_OUTPUT};
    const fmi2Integer order[1] = {1};
    fmi2Real value[1];
    at.function = "fmi2GetRealOutputDerivatives";
    TRY("nobody", fmi2GetRealOutputDerivatives(NULL, vr, 1, order, value));
    TRY("none", fmi2GetRealOutputDerivatives(c, NULL, 0, NULL, NULL));
    TRY("null", fmi2GetRealOutputDerivatives(c, NULL, 1, order, value));
    TRY("wrong", fmi2GetRealOutputDerivatives(c, vr, 1, order, value));
}

static void try_step(fmi2Component c)
{
    const double t = fmu_time(at.fmu), h = DRIVER_STEP;
    at.function = "fmi2DoStep";
    TRY("nobody", fmi2DoStep(NULL, t, h, fmi2True));
    TRY("wrong", fmi2DoStep(c, t, 0, fmi2True));
    TRY("wrong", fmi2DoStep(c, t, -h, fmi2True));
    TRY("wrong", fmi2DoStep(c, t, NAN, fmi2True));
    TRY("wrong", fmi2DoStep(c, NAN, h, fmi2True));
    TRY("wrong", fmi2DoStep(c, t, INFINITY, fmi2True));
    TRY("wrong", fmi2DoStep(c, t + 0.5 * (double)DRIVER_STOP, h, fmi2True));
    TRY("wrong", fmi2DoStep(c, t, 2 * (double)DRIVER_STOP, fmi2True));
    TRY("valid", fmi2DoStep(c, t, h, fmi2True));
    TRY("valid", fmi2DoStep(c, t + h, h, fmi2False));
}

static void try_statuses(fmi2Component c)
{
    fmi2Status status;
    fmi2Real real;
    fmi2Integer integer;
    fmi2Boolean boolean;
    fmi2String text;
    at.function = "fmi2GetStatus";
    TRY("nobody", fmi2GetStatus(NULL, fmi2DoStepStatus, &status));
    TRY("null", fmi2GetStatus(c, fmi2DoStepStatus, NULL));
    TRY("valid", fmi2GetStatus(c, fmi2DoStepStatus, &status));
    at.function = "fmi2GetRealStatus";
    TRY("nobody", fmi2GetRealStatus(NULL, fmi2LastSuccessfulTime, &real));
    TRY("null", fmi2GetRealStatus(c, fmi2LastSuccessfulTime, NULL));
    TRY("found", fmi2GetRealStatus(c, fmi2Terminated, &real));
    TRY("valid", fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &real));
    at.function = "fmi2GetIntegerStatus";
    TRY("nobody", fmi2GetIntegerStatus(NULL, fmi2DoStepStatus, &integer));
    TRY("null", fmi2GetIntegerStatus(c, fmi2DoStepStatus, NULL));
    TRY("valid", fmi2GetIntegerStatus(c, fmi2DoStepStatus, &integer));
    at.function = "fmi2GetBooleanStatus";
    TRY("nobody", fmi2GetBooleanStatus(NULL, fmi2Terminated, &boolean));
    TRY("null", fmi2GetBooleanStatus(c, fmi2Terminated, NULL));
    TRY("found", fmi2GetBooleanStatus(c, fmi2PendingStatus, &boolean));
    TRY("valid", fmi2GetBooleanStatus(c, fmi2Terminated, &boolean));
    at.function = "fmi2GetStringStatus";
    TRY("nobody", fmi2GetStringStatus(NULL, fmi2PendingStatus, &text));
    TRY("null", fmi2GetStringStatus(c, fmi2PendingStatus, NULL));
    TRY("valid", fmi2GetStringStatus(c, fmi2PendingStatus, &text));
}

static void (*const TRIES[])(fmi2Component) = {
    try_nothing, try_versions, try_logging, try_experiment, try_enter_initialization, try_exit_initialization,
    try_terminate, try_reset, try_get_Real, try_set_Real, try_get_Integer, try_set_Integer, try_get_Boolean,
    try_set_Boolean, try_get_String, try_set_String, try_given, try_all, try_states_of_fmu, try_derivative,
    try_enter_event, try_new_discrete_states, try_enter_continuous, try_completed_step, try_time, try_get_rates,
    try_get_indicators, try_get_states, try_get_nominals, try_set_states, try_input_derivatives, try_output_derivatives,
    try_step, try_cancel, try_statuses
};

/* --- instances ---- */
static fmi2Component made(fmi2Type kind)
{
    fmi2Component c = fmi2Instantiate("driven", kind, DRIVER_TOKEN, NULL, &CALLBACKS, fmi2False, fmi2True);
    at.fmu = core_of(c);
    at.messages = 0;
    return c;
}

/* Takes a new instance to a mode by the calls that lead there; 0 where the kind has no such mode. */
static int put(fmi2Component c, fmi2Type kind, int mode)
{
    fmi2EventInfo events;
    int status = fmi2OK;
    if (mode == FMU_INSTANTIATED)
        return 1;
    status |= fmi2SetupExperiment(c, fmi2False, 0, 0, fmi2True, DRIVER_STOP);
    status |= fmi2EnterInitializationMode(c);
    if (mode != FMU_INITIALIZATION)
        status |= fmi2ExitInitializationMode(c);
    if (kind == fmi2ModelExchange && (mode == FMU_CONTINUOUS || mode == FMU_TERMINATED)) {
        status |= fmi2NewDiscreteStates(c, &events);
        status |= fmi2EnterContinuousTimeMode(c);
    }
    if (mode == FMU_TERMINATED)
        status |= fmi2Terminate(c);
    if (mode == FMU_FAILED)
        fmu_set_mode(at.fmu, FMU_FAILED);
    return status == fmi2OK && fmu_mode(at.fmu) == mode;
}

static void drive(fmi2Type kind, int mode)
{
    for (size_t k = 0; k < sizeof TRIES / sizeof TRIES[0]; k++) {
        fmi2Component c = made(kind);
        at.kind = kind == fmi2ModelExchange ? "ME" : "CS";
        if (!c)
            return; /* it was not exported for this kind */
        if (put(c, kind, mode)) {
            at.mode = mode_of(at.fmu);
            at.messages = 0;
            TRIES[k](c);
        } else if (!k) {
            printf("%s cannot be in mode %d\n", at.kind, mode);
        }
        fmi2FreeInstance(c);
    }
}

/* To the end of the run, and a step beyond it. */
static void drive_to_the_end(void)
{
    fmi2Component c = made(fmi2CoSimulation);
    at.kind = "CS";
    at.mode = "end";
    if (!c || !put(c, fmi2CoSimulation, FMU_STEP)) {
        fmi2FreeInstance(c);
        return;
    }
    at.function = "fmi2DoStep";
    TRY("valid", fmi2DoStep(c, 0, DRIVER_STOP, fmi2True));
    TRY("wrong", fmi2DoStep(c, DRIVER_STOP, DRIVER_STEP, fmi2True));
    at.function = "fmi2Terminate";
    TRY("valid", fmi2Terminate(c));
    at.function = "fmi2Reset";
    TRY("valid", fmi2Reset(c));
    at.function = "fmi2EnterInitializationMode"; /* without an experiment */
    TRY("valid", fmi2EnterInitializationMode(c));
    fmi2FreeInstance(c);
}

static void try_instantiation(void)
{
    const fmi2CallbackFunctions silent = {NULL, NULL, NULL, NULL, NULL};
    const struct {
        const char *variant, *name, *token;
        int kind;
        const fmi2CallbackFunctions *functions;
    } cases[] = {
        {"wrong", "a", "another one", fmi2CoSimulation, &CALLBACKS},
        {"wrong", "", DRIVER_TOKEN, fmi2CoSimulation, &CALLBACKS},
        {"wrong", " \t", DRIVER_TOKEN, fmi2CoSimulation, &CALLBACKS},
        {"wrong", "a", DRIVER_TOKEN, 7, &CALLBACKS},
        {"null", NULL, DRIVER_TOKEN, fmi2CoSimulation, &CALLBACKS},
        {"null", "a", NULL, fmi2CoSimulation, &CALLBACKS},
        {"silent", "a", DRIVER_TOKEN, fmi2CoSimulation, NULL},
        {"silent", "a", "another one", fmi2CoSimulation, &silent},
        {"found", "a", DRIVER_TOKEN, fmi2CoSimulation, &CALLBACKS},
        {"found", "a", DRIVER_TOKEN, fmi2ModelExchange, &silent}
    };
    at.kind = at.mode = "-";
    at.fmu = NULL;
    at.function = "fmi2Instantiate";
    for (size_t k = 0; k < sizeof cases / sizeof cases[0]; k++) {
        fmi2Component c = fmi2Instantiate(cases[k].name, (fmi2Type)cases[k].kind, cases[k].token, NULL,
                                          cases[k].functions, fmi2False, fmi2False);
        TRY(cases[k].variant, c != NULL);
        fmi2FreeInstance(c);
    }
    at.function = "fmi2FreeInstance";
    fmi2FreeInstance(NULL);
    TRY("nobody", 0);
}

int main(void)
{
    const int modes[] = {FMU_INSTANTIATED, FMU_INITIALIZATION, FMU_EVENT, FMU_CONTINUOUS, FMU_TERMINATED, FMU_FAILED};
    const int steps[] = {FMU_INSTANTIATED, FMU_INITIALIZATION, FMU_STEP, FMU_TERMINATED, FMU_FAILED};
    for (size_t k = 0; k < sizeof modes / sizeof modes[0]; k++)
        drive(fmi2ModelExchange, modes[k]);
    for (size_t k = 0; k < sizeof steps / sizeof steps[0]; k++)
        drive(fmi2CoSimulation, steps[k]);
    drive_to_the_end();
    try_instantiation();
    return 0;
}
