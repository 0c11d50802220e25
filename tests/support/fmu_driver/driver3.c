/* Calls every function of FMI 3.0 in every mode, allowed or not, with right and with wrong arguments; see driver.h. */
#include "driver.h"
#include "fmi3.h"

#define FMI(name) fmi3##name
#define MOVE(call, c, vr, values) call(c, vr, 1, values, 1)
typedef fmi3Instance Instance;
#include "driver_calls.h"

static void log_message(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message)
{
    (void)environment, (void)status;
    if (category && message && message[0])
        at.messages++;
}

/* --- all kinds ---- */
static void try_version(fmi3Instance c)
{
    (void)c;
    at.function = "fmi3GetVersion";
    TRY("valid", strcmp(fmi3GetVersion(), "3.0") != 0);
}

static void try_enter_initialization(fmi3Instance c)
{
    at.function = "fmi3EnterInitializationMode";
    TRY("nobody", fmi3EnterInitializationMode(NULL, fmi3False, 0, 0, fmi3False, 0));
    TRY("wrong", fmi3EnterInitializationMode(c, fmi3True, 0, 0, fmi3False, 0));
    TRY("wrong", fmi3EnterInitializationMode(c, fmi3True, NAN, 0, fmi3False, 0));
    TRY("wrong", fmi3EnterInitializationMode(c, fmi3False, 0, NAN, fmi3False, 0));
    TRY("wrong", fmi3EnterInitializationMode(c, fmi3False, 0, 0, fmi3True, -1));
    TRY("wrong", fmi3EnterInitializationMode(c, fmi3False, 0, 0, fmi3True, INFINITY));
    TRY("valid", fmi3EnterInitializationMode(c, fmi3True, 1e-6, 0, fmi3True, DRIVER_STOP));
}

TRY_PLAIN(enter_configuration, fmi3EnterConfigurationMode)
TRY_PLAIN(exit_configuration, fmi3ExitConfigurationMode)
TRY_PLAIN(evaluate, fmi3EvaluateDiscreteStates)
TRY_PLAIN(enter_step, fmi3EnterStepMode)

/* own: the type of the core that this one shows, -1: none; other: another one. */
#define TRY_TYPE(type, own, other)                                                    \
    static void try_get_##type(fmi3Instance c)                                        \
    {                                                                                 \
        const int found = own < 0 ? -1 : first_of(own), no = first_of(other);         \
        const fmi3ValueReference vr[1] = {(fmi3ValueReference)found};                 \
        const fmi3ValueReference wrong[1] = {(fmi3ValueReference)no};                 \
        const size_t n = found < 0 ? 0 : fmu_elements(vr[0]);                         \
        fmi3##type *values = calloc(n + 1, sizeof *values);                           \
        at.function = "fmi3Get" #type;                                                \
        TRY("nobody", fmi3Get##type(NULL, vr, 1, values, 1));                         \
        TRY("none", fmi3Get##type(c, NULL, 0, NULL, 0));                              \
        TRY("null", fmi3Get##type(c, NULL, 1, values, 1));                            \
        TRY("wrong", fmi3Get##type(c, NOWHERE, 1, values, 1));                        \
        TRY("wrong", fmi3Get##type(c, NULL, 0, values, 1));                           \
        if (no >= 0)                                                                  \
            TRY("wrong", fmi3Get##type(c, wrong, 1, values, 1));                      \
        if (found >= 0) {                                                             \
            TRY("null", fmi3Get##type(c, vr, 1, NULL, n));                            \
            TRY("wrong", fmi3Get##type(c, vr, 1, values, n + 1));                     \
            TRY("wrong", fmi3Get##type(c, vr, 1, values, n - 1));                     \
            TRY("valid", fmi3Get##type(c, vr, 1, values, n));                         \
        }                                                                             \
        free(values);                                                                 \
    }                                                                                 \
    static void try_set_##type(fmi3Instance c)                                        \
    {                                                                                 \
        const int found = own < 0 ? -1 : first_of(own), no = first_of(other);         \
        const fmi3ValueReference vr[1] = {(fmi3ValueReference)found};                 \
        const fmi3ValueReference wrong[1] = {(fmi3ValueReference)no};                 \
        const size_t n = found < 0 ? 0 : fmu_elements(vr[0]);                         \
        fmi3##type *values = calloc(n + 1, sizeof *values);                           \
        at.function = "fmi3Set" #type;                                                \
        TRY("nobody", fmi3Set##type(NULL, vr, 1, values, 1));                         \
        TRY("none", fmi3Set##type(c, NULL, 0, NULL, 0));                              \
        TRY("null", fmi3Set##type(c, NULL, 1, values, 1));                            \
        TRY("wrong", fmi3Set##type(c, NOWHERE, 1, values, 1));                        \
        TRY("wrong", fmi3Set##type(c, NULL, 0, values, 1));                           \
        if (no >= 0)                                                                  \
            TRY("wrong", fmi3Set##type(c, wrong, 1, values, 1));                      \
        if (found >= 0) {                                                             \
            TRY("null", fmi3Set##type(c, vr, 1, NULL, n));                            \
            TRY("wrong", fmi3Set##type(c, vr, 1, values, n + 1));                     \
            TRY("wrong", fmi3Set##type(c, vr, 1, values, n - 1));                     \
            TRY("found", fmi3Set##type(c, vr, 1, values, n));                         \
        }                                                                             \
        free(values);                                                                 \
    }

TRY_TYPE(Float32, -1, FMU_REAL)
TRY_TYPE(Float64, FMU_REAL, FMU_BOOLEAN)
TRY_TYPE(Int8, -1, FMU_INTEGER)
TRY_TYPE(UInt8, -1, FMU_INTEGER)
TRY_TYPE(Int16, -1, FMU_INTEGER)
TRY_TYPE(UInt16, -1, FMU_INTEGER)
TRY_TYPE(Int32, -1, FMU_INTEGER)
TRY_TYPE(UInt32, -1, FMU_INTEGER)
TRY_TYPE(Int64, FMU_INTEGER, FMU_REAL)
TRY_TYPE(UInt64, -1, FMU_INTEGER)
TRY_TYPE(Boolean, FMU_BOOLEAN, FMU_REAL)
TRY_TYPE(String, FMU_STRING, FMU_REAL)

static void try_binary(fmi3Instance c)
{
    const fmi3ValueReference vr[1] = {0};
    const fmi3Byte byte = 0;
    fmi3Binary values[1] = {&byte};
    size_t sizes[1] = {1};
    at.function = "fmi3GetBinary";
    TRY("nobody", fmi3GetBinary(NULL, vr, 1, sizes, values, 1));
    TRY("none", fmi3GetBinary(c, NULL, 0, NULL, NULL, 0));
    TRY("null", fmi3GetBinary(c, NULL, 1, NULL, NULL, 1));
    TRY("wrong", fmi3GetBinary(c, vr, 1, sizes, values, 1));
    at.function = "fmi3SetBinary";
    TRY("nobody", fmi3SetBinary(NULL, vr, 1, sizes, values, 1));
    TRY("none", fmi3SetBinary(c, NULL, 0, NULL, NULL, 0));
    TRY("null", fmi3SetBinary(c, NULL, 1, NULL, NULL, 1));
    TRY("wrong", fmi3SetBinary(c, vr, 1, sizes, values, 1));
}

#define TRY_CLOCKS(call, ...)                          \
    do {                                               \
        at.function = #call;                           \
        TRY("nobody", call(NULL, vr, 1, __VA_ARGS__)); \
        TRY("none", call(c, NULL, 0, __VA_ARGS__));    \
        TRY("null", call(c, NULL, 1, __VA_ARGS__));    \
        TRY("wrong", call(c, vr, 1, __VA_ARGS__));     \
    } while (0)

static void try_clocks(fmi3Instance c)
{
    const fmi3ValueReference vr[1] = {0};
    fmi3Clock clock[1] = {fmi3ClockInactive};
    fmi3Float64 time[1] = {1};
    fmi3UInt64 counter[1] = {1}, resolution[1] = {1};
    fmi3IntervalQualifier qualifier[1] = {fmi3IntervalChanged};
    TRY_CLOCKS(fmi3GetClock, clock);
    TRY_CLOCKS(fmi3SetClock, clock);
    TRY_CLOCKS(fmi3GetIntervalDecimal, time, qualifier);
    TRY_CLOCKS(fmi3GetIntervalFraction, counter, resolution, qualifier);
    TRY_CLOCKS(fmi3GetShiftDecimal, time);
    TRY_CLOCKS(fmi3GetShiftFraction, counter, resolution);
    TRY_CLOCKS(fmi3SetIntervalDecimal, time);
    TRY_CLOCKS(fmi3SetIntervalFraction, counter, resolution);
    TRY_CLOCKS(fmi3SetShiftDecimal, time);
    TRY_CLOCKS(fmi3SetShiftFraction, counter, resolution);
    at.function = "fmi3ActivateModelPartition";
    TRY("nobody", fmi3ActivateModelPartition(NULL, 0, 0));
    TRY("wrong", fmi3ActivateModelPartition(c, 0, 0));
}

/* Every variable as a whole, by what reads it; and what it depends on. */
static void try_all(fmi3Instance c)
{
    for (size_t r = 0; r < fmu_references(); r++) {
        const fmi3ValueReference vr[1] = {(fmi3ValueReference)r};
        const size_t n = fmu_elements(vr[0]);
        double *real = zeros(n);
        fmi3Int64 *integer = (fmi3Int64 *)zeros(n);
        fmi3Boolean *boolean = (fmi3Boolean *)zeros(n);
        fmi3String *text = (fmi3String *)zeros(n);
        size_t count = 0;
        at.function = "fmi3GetFloat64";
        if (!n)
            TRY("wrong", fmi3GetFloat64(c, vr, 1, real, 1)); /* in the midst of an array */
        else if (fmu_type(vr[0]) == FMU_REAL)
            TRY("valid", fmi3GetFloat64(c, vr, 1, real, n));
        else
            TRY("wrong", fmi3GetFloat64(c, vr, 1, real, n));
        at.function = "fmi3GetBoolean";
        if (n && fmu_type(vr[0]) == FMU_BOOLEAN)
            TRY("valid", fmi3GetBoolean(c, vr, 1, boolean, n));
        at.function = "fmi3GetString";
        if (n && fmu_type(vr[0]) == FMU_STRING)
            TRY("valid", fmi3GetString(c, vr, 1, text, n));
        at.function = "fmi3GetInt64";
        if (n && (fmu_type(vr[0]) == FMU_INTEGER || fmu_type(vr[0]) == FMU_ENUMERATION))
            TRY("valid", fmi3GetInt64(c, vr, 1, integer, n));
        at.function = "fmi3GetNumberOfVariableDependencies";
        TRY("found", fmi3GetNumberOfVariableDependencies(c, vr[0], &count));
        size_t *own = (size_t *)zeros(count), *others = (size_t *)zeros(count);
        fmi3ValueReference *on = (fmi3ValueReference *)zeros(count);
        fmi3DependencyKind *kinds = (fmi3DependencyKind *)zeros(count);
        at.function = "fmi3GetVariableDependencies";
        TRY("found", fmi3GetVariableDependencies(c, vr[0], own, on, others, kinds, count));
        for (size_t k = 0; k < count; k++)
            if (own[k] > n || (fmu_elements(on[k]) && others[k] > fmu_elements(on[k])))
                TRY("beyond-its-array", -1);
        free(own), free(others), free(on), free(kinds);
        free(real), free(integer), free(boolean), free(text);
    }
}

static void try_dependencies(fmi3Instance c)
{
    size_t count = 0, own[1], others[1];
    fmi3ValueReference on[1];
    fmi3DependencyKind kinds[1];
    at.function = "fmi3GetNumberOfVariableDependencies";
    TRY("nobody", fmi3GetNumberOfVariableDependencies(NULL, 0, &count));
    TRY("null", fmi3GetNumberOfVariableDependencies(c, (fmi3ValueReference)DRIVER_OUTPUT, NULL));
    TRY("wrong", fmi3GetNumberOfVariableDependencies(c, NOWHERE[0], &count));
    at.function = "fmi3GetVariableDependencies";
    TRY("nobody", fmi3GetVariableDependencies(NULL, 0, own, on, others, kinds, 1));
    TRY("wrong", fmi3GetVariableDependencies(c, NOWHERE[0], own, on, others, kinds, 1));
    if (DRIVER_OUTPUT >= 0) {
        const fmi3ValueReference y = (fmi3ValueReference)DRIVER_OUTPUT;
        const uint32_t *known = NULL;
        count = fmu_dependencies(y, &known);
        at.function = "fmi3GetNumberOfVariableDependencies";
        TRY("valid", fmi3GetNumberOfVariableDependencies(c, y, &count));
        at.function = "fmi3GetVariableDependencies";
        TRY("wrong", fmi3GetVariableDependencies(c, y, own, on, others, kinds, count + 1));
        if (count == 1) {
            TRY("null", fmi3GetVariableDependencies(c, y, NULL, on, others, kinds, 1));
            TRY("null", fmi3GetVariableDependencies(c, y, own, NULL, others, kinds, 1));
            TRY("null", fmi3GetVariableDependencies(c, y, own, on, NULL, kinds, 1));
            TRY("null", fmi3GetVariableDependencies(c, y, own, on, others, NULL, 1));
        }
        if (count <= 1)
            TRY("valid", fmi3GetVariableDependencies(c, y, own, on, others, kinds, count));
    }
}

typedef fmi3Status Derivative(fmi3Instance, const fmi3ValueReference[], size_t, const fmi3ValueReference[], size_t,
                              const fmi3Float64[], size_t, fmi3Float64[], size_t);

static void try_derivative(fmi3Instance c, const char *name, Derivative *call)
{
    const fmi3ValueReference unknown[1] = {(fmi3ValueReference)DRIVER_OUTPUT};
    const fmi3ValueReference known[1] = {(fmi3ValueReference)DRIVER_STATE};
    const fmi3Float64 seed[2] = {1, 1}, not_a_number[1] = {NAN};
    fmi3Float64 out[2];
    at.function = name;
    TRY("nobody", call(NULL, unknown, 1, known, 1, seed, 1, out, 1));
    TRY("none", call(c, NULL, 0, NULL, 0, NULL, 0, NULL, 0));
    TRY("null", call(c, NULL, 1, known, 1, seed, 1, out, 1));
    TRY("null", call(c, unknown, 1, NULL, 1, seed, 1, out, 1));
    TRY("wrong", call(c, NOWHERE, 1, NOWHERE, 1, seed, 1, out, 1));
    if (DRIVER_OUTPUT >= 0 && DRIVER_STATE >= 0) {
        TRY("null", call(c, unknown, 1, known, 1, NULL, 1, out, 1));
        TRY("null", call(c, unknown, 1, known, 1, seed, 1, NULL, 1));
        TRY("wrong", call(c, unknown, 1, known, 1, seed, 2, out, 1));
        TRY("wrong", call(c, unknown, 1, known, 1, seed, 1, out, 2));
        TRY("wrong", call(c, unknown, 1, known, 1, seed, 0, out, 1));
        TRY("wrong", call(c, unknown, 1, known, 1, not_a_number, 1, out, 1));
        TRY("valid", call(c, unknown, 1, known, 1, seed, 1, out, 1));
        /* More references than the wrapper keeps on its stack. */
        fmi3ValueReference many[200];
        fmi3Float64 *seeds = zeros(200), *sums = zeros(200);
        for (int k = 0; k < 200; k++)
            many[k] = known[0];
        if (call == fmi3GetDirectionalDerivative)
            TRY("valid", call(c, unknown, 1, many, 200, seeds, 200, sums, 1));
        else
            TRY("valid", call(c, unknown, 1, many, 200, seeds, 1, sums, 200));
        free(seeds), free(sums);
    }
}

static void try_derivatives(fmi3Instance c)
{
    try_derivative(c, "fmi3GetDirectionalDerivative", fmi3GetDirectionalDerivative);
    try_derivative(c, "fmi3GetAdjointDerivative", fmi3GetAdjointDerivative);
}

static void try_update(fmi3Instance c)
{
    fmi3Boolean need, end, nominals, values, has_next;
    fmi3Float64 next;
    at.function = "fmi3UpdateDiscreteStates";
    TRY("nobody", fmi3UpdateDiscreteStates(NULL, &need, &end, &nominals, &values, &has_next, &next));
    TRY("null", fmi3UpdateDiscreteStates(c, NULL, &end, &nominals, &values, &has_next, &next));
    TRY("null", fmi3UpdateDiscreteStates(c, &need, NULL, &nominals, &values, &has_next, &next));
    TRY("null", fmi3UpdateDiscreteStates(c, &need, &end, NULL, &values, &has_next, &next));
    TRY("null", fmi3UpdateDiscreteStates(c, &need, &end, &nominals, NULL, &has_next, &next));
    TRY("null", fmi3UpdateDiscreteStates(c, &need, &end, &nominals, &values, NULL, &next));
    TRY("null", fmi3UpdateDiscreteStates(c, &need, &end, &nominals, &values, &has_next, NULL));
    TRY("valid", fmi3UpdateDiscreteStates(c, &need, &end, &nominals, &values, &has_next, &next));
}

static void try_numbers(fmi3Instance c)
{
    size_t count;
    at.function = "fmi3GetNumberOfEventIndicators";
    TRY("nobody", fmi3GetNumberOfEventIndicators(NULL, &count));
    TRY("null", fmi3GetNumberOfEventIndicators(c, NULL));
    TRY("valid", fmi3GetNumberOfEventIndicators(c, &count));
    at.function = "fmi3GetNumberOfContinuousStates";
    TRY("nobody", fmi3GetNumberOfContinuousStates(NULL, &count));
    TRY("null", fmi3GetNumberOfContinuousStates(c, NULL));
    TRY("valid", fmi3GetNumberOfContinuousStates(c, &count));
}

/* --- Co-Simulation ---- */
static void try_output_derivatives(fmi3Instance c)
{
    const fmi3ValueReference vr[1] = {(fmi3ValueReference)DRIVER_OUTPUT};
    const fmi3Int32 order[1] = {1};
    fmi3Float64 value[1];
    at.function = "fmi3GetOutputDerivatives";
    TRY("nobody", fmi3GetOutputDerivatives(NULL, vr, 1, order, value, 1));
    TRY("none", fmi3GetOutputDerivatives(c, NULL, 0, NULL, NULL, 0));
    TRY("null", fmi3GetOutputDerivatives(c, NULL, 1, order, value, 1));
    TRY("wrong", fmi3GetOutputDerivatives(c, vr, 1, order, value, 1));
}

static void try_step(fmi3Instance c)
{
    const double t = fmu_time(at.fmu), h = DRIVER_STEP;
    fmi3Boolean event, end, early;
    fmi3Float64 last = t;
    at.function = "fmi3DoStep";
    TRY("nobody", fmi3DoStep(NULL, t, h, fmi3True, &event, &end, &early, &last));
    TRY("null", fmi3DoStep(c, t, h, fmi3True, NULL, &end, &early, &last));
    TRY("null", fmi3DoStep(c, t, h, fmi3True, &event, NULL, &early, &last));
    TRY("null", fmi3DoStep(c, t, h, fmi3True, &event, &end, NULL, &last));
    TRY("null", fmi3DoStep(c, t, h, fmi3True, &event, &end, &early, NULL));
    TRY("wrong", fmi3DoStep(c, t, 0, fmi3True, &event, &end, &early, &last));
    TRY("wrong", fmi3DoStep(c, t, -h, fmi3True, &event, &end, &early, &last));
    TRY("wrong", fmi3DoStep(c, t, NAN, fmi3True, &event, &end, &early, &last));
    TRY("wrong", fmi3DoStep(c, NAN, h, fmi3True, &event, &end, &early, &last));
    TRY("wrong", fmi3DoStep(c, t, INFINITY, fmi3True, &event, &end, &early, &last));
    TRY("wrong", fmi3DoStep(c, t + 0.5 * (double)DRIVER_STOP, h, fmi3True, &event, &end, &early, &last));
    TRY("wrong", fmi3DoStep(c, t, 2 * (double)DRIVER_STOP, fmi3True, &event, &end, &early, &last));
    TRY("valid", fmi3DoStep(c, t, h, fmi3True, &event, &end, &early, &last));
}

static void (*const TRIES[])(fmi3Instance) = {
    try_nothing, try_version, try_logging, try_enter_initialization, try_exit_initialization, try_enter_event,
    try_terminate, try_reset, try_get_Float32, try_set_Float32, try_get_Float64, try_set_Float64, try_get_Int8,
    try_set_Int8, try_get_UInt8, try_set_UInt8, try_get_Int16, try_set_Int16, try_get_UInt16, try_set_UInt16,
    try_get_Int32, try_set_Int32, try_get_UInt32, try_set_UInt32, try_get_Int64, try_set_Int64, try_get_UInt64,
    try_set_UInt64, try_get_Boolean, try_set_Boolean, try_get_String, try_set_String, try_binary, try_clocks, try_given,
    try_all, try_dependencies, try_states_of_fmu, try_derivatives, try_enter_configuration, try_exit_configuration,
    try_evaluate, try_update, try_enter_continuous, try_completed_step, try_time, try_get_rates, try_get_indicators,
    try_get_states, try_get_nominals, try_set_states, try_numbers, try_enter_step, try_output_derivatives, try_step
};
enum { NTRIES = sizeof TRIES / sizeof TRIES[0] };

/* --- instances ---- */
enum { WITHOUT_EVENTS, WITH_EVENTS };

static void inside(fmi3InstanceEnvironment environment, fmi3Float64 t, fmi3Boolean set_requested,
                   fmi3Boolean get_allowed, fmi3Boolean finished, fmi3Boolean can_return, fmi3Boolean *asked,
                   fmi3Float64 *until);

/* kind: FMU_ME or FMU_CS. environment: a place for the instance itself, which the intermediate update speaks to. */
static fmi3Instance made(int kind, int events, fmi3Instance *environment)
{
    const fmi3ValueReference known[1] = {(fmi3ValueReference)DRIVER_OUTPUT};
    fmi3Instance c;
    if (kind == FMU_ME)
        c = fmi3InstantiateModelExchange("driven", DRIVER_TOKEN, NULL, fmi3False, fmi3True, environment, log_message);
    else
        c = fmi3InstantiateCoSimulation("driven", DRIVER_TOKEN, NULL, fmi3False, fmi3True, events == WITH_EVENTS,
                                        events == WITH_EVENTS || environment, known, DRIVER_OUTPUT >= 0, environment,
                                        log_message, environment ? inside : NULL);
    at.kind = kind == FMU_ME ? "ME" : events == WITH_EVENTS ? "CS+events" : "CS";
    at.fmu = core_of(c);
    at.messages = 0;
    return c;
}

static int updated(fmi3Instance c)
{
    fmi3Boolean need, end, nominals, values, has_next;
    fmi3Float64 next;
    return fmi3UpdateDiscreteStates(c, &need, &end, &nominals, &values, &has_next, &next);
}

/* Takes a new instance to a mode by the calls that lead there; 0 where the kind has no such mode. */
static int put(fmi3Instance c, int kind, int events, int mode)
{
    int status = fmi3OK;
    if (mode == FMU_INSTANTIATED)
        return 1;
    status |= fmi3EnterInitializationMode(c, fmi3False, 0, 0, fmi3True, DRIVER_STOP);
    if (mode != FMU_INITIALIZATION)
        status |= fmi3ExitInitializationMode(c);
    if (mode == FMU_CONTINUOUS || (mode == FMU_TERMINATED && kind == FMU_ME)) {
        status |= updated(c);
        status |= fmi3EnterContinuousTimeMode(c);
    } else if ((mode == FMU_STEP || mode == FMU_TERMINATED) && events == WITH_EVENTS) {
        status |= updated(c);
        status |= fmi3EnterStepMode(c);
    }
    if (mode == FMU_TERMINATED)
        status |= fmi3Terminate(c);
    if (mode == FMU_FAILED)
        fmu_set_mode(at.fmu, FMU_FAILED);
    return status == fmi3OK && fmu_mode(at.fmu) == mode;
}

static void drive(int kind, int events, int mode)
{
    for (size_t k = 0; k < NTRIES; k++) {
        fmi3Instance c = made(kind, events, NULL);
        if (!c)
            return; /* it was not exported for this kind */
        if (put(c, kind, events, mode)) {
            at.mode = mode_of(at.fmu);
            at.messages = 0;
            TRIES[k](c);
        } else if (!k) {
            printf("%s cannot be in mode %d\n", at.kind, mode);
        }
        fmi3FreeInstance(c);
    }
}

/* In the first intermediate update all is tried, and in the first that asks for inputs, none of which may end the step; then
   an early return is asked for. */
static int rounds, questions;

static void inside(fmi3InstanceEnvironment environment, fmi3Float64 t, fmi3Boolean set_requested,
                   fmi3Boolean get_allowed, fmi3Boolean finished, fmi3Boolean can_return, fmi3Boolean *asked,
                   fmi3Float64 *until)
{
    fmi3Instance c = *(fmi3Instance *)environment;
    const int is_step = fmu_mode(at.fmu) == FMU_INTERMEDIATE;
    at.mode = mode_of(at.fmu);
    at.messages = 0;
    if ((is_step ? rounds++ : questions++) == 0) {
        for (size_t k = 0; k < NTRIES; k++)
            TRIES[k](c);
        at.function = "fmi3FreeInstance";
        fmi3FreeInstance(c);
        TRY("wrong", 3);
    }
    at.function = "intermediateUpdate";
    TRY("flags", is_step ? !get_allowed || !finished || !can_return
                         : !set_requested || get_allowed || finished || can_return);
    *asked = fmi3True;
    *until = rounds == 2 || !is_step ? NAN : t;
}

static void drive_inside(int events)
{
    fmi3Instance c = NULL;
    fmi3Boolean event, end, early;
    fmi3Float64 last = 0;
    const double h = DRIVER_STEP;
    c = made(FMU_CS, events, &c);
    if (c && put(c, FMU_CS, events, FMU_STEP)) {
        rounds = questions = 0;
        for (int k = 0; k < 3; k++) {
            const double t = fmu_time(at.fmu);
            const int status = fmi3DoStep(c, t, h, fmi3True, &event, &end, &early, &last);
            at.mode = "step";
            at.function = "fmi3DoStep";
            TRY("valid", status);
            TRY(last > t && last <= t + h + 1e-12 && early == (last < t + h - 1e-12) ? "last-time-is-right"
                                                                                     : "last-time-is-wrong", 0);
        }
    }
    fmi3FreeInstance(c);
}

/* To the end of the run, with events where they come, and a step beyond it. */
static void drive_to_the_end(int events)
{
    fmi3Instance c = made(FMU_CS, events, NULL);
    fmi3Boolean event, end, early;
    fmi3Float64 last = 0;
    at.mode = "end";
    if (!c || !put(c, FMU_CS, events, FMU_STEP)) {
        fmi3FreeInstance(c);
        return;
    }
    for (int k = 0; k < 100000 && last < (double)DRIVER_STOP; k++) {
        at.function = "fmi3DoStep";
        TRY("valid", fmi3DoStep(c, last, (double)DRIVER_STOP - last, fmi3True, &event, &end, &early, &last));
        if (event && events == WITHOUT_EVENTS)
            TRY("an-event-that-nobody-wants", -1);
        if (event) {
            at.function = "fmi3EnterEventMode";
            TRY("valid", fmi3EnterEventMode(c));
            at.function = "fmi3UpdateDiscreteStates";
            TRY("valid", updated(c));
            at.function = "fmi3EnterStepMode";
            TRY("valid", fmi3EnterStepMode(c));
        }
    }
    at.function = "fmi3DoStep";
    TRY("wrong", fmi3DoStep(c, last, DRIVER_STEP, fmi3True, &event, &end, &early, &last));
    at.function = "fmi3Terminate";
    TRY("valid", fmi3Terminate(c));
    at.function = "fmi3Reset";
    TRY("valid", fmi3Reset(c));
    fmi3FreeInstance(c);
}

static void try_instantiation(void)
{
    const struct {
        const char *variant, *name, *token;
        fmi3LogMessageCallback log;
    } cases[] = {
        {"wrong", "a", "another one", log_message},
        {"wrong", "", DRIVER_TOKEN, log_message},
        {"wrong", " \t", DRIVER_TOKEN, log_message},
        {"null", NULL, DRIVER_TOKEN, log_message},
        {"null", "a", NULL, log_message},
        {"silent", "a", "another one", NULL},
        {"found", "a", DRIVER_TOKEN, log_message},
        {"found", "a", DRIVER_TOKEN, NULL}
    };
    fmi3Instance c;
    at.kind = at.mode = "-";
    at.fmu = NULL;
    for (size_t k = 0; k < sizeof cases / sizeof cases[0]; k++) {
        at.function = "fmi3InstantiateModelExchange";
        c = fmi3InstantiateModelExchange(cases[k].name, cases[k].token, NULL, fmi3False, fmi3False, NULL, cases[k].log);
        TRY(cases[k].variant, c != NULL);
        fmi3FreeInstance(c);
        at.function = "fmi3InstantiateCoSimulation";
        c = fmi3InstantiateCoSimulation(cases[k].name, cases[k].token, NULL, fmi3False, fmi3False, fmi3False, fmi3False,
                                        NULL, 0, NULL, cases[k].log, NULL);
        TRY(cases[k].variant, c != NULL);
        fmi3FreeInstance(c);
    }
    c = fmi3InstantiateCoSimulation("a", DRIVER_TOKEN, NULL, fmi3False, fmi3False, fmi3False, fmi3False, NOWHERE, 1,
                                    NULL, log_message, NULL);
    TRY("wrong", c != NULL);
    c = fmi3InstantiateCoSimulation("a", DRIVER_TOKEN, NULL, fmi3False, fmi3False, fmi3False, fmi3False, NULL, 1, NULL,
                                    log_message, NULL);
    TRY("null", c != NULL);
    at.function = "fmi3InstantiateScheduledExecution";
    c = fmi3InstantiateScheduledExecution("a", DRIVER_TOKEN, NULL, fmi3False, fmi3False, NULL, log_message, NULL, NULL,
                                          NULL);
    TRY("wrong", c != NULL);
    at.function = "fmi3FreeInstance";
    fmi3FreeInstance(NULL);
    TRY("nobody", 0);
}

int main(void)
{
    const int modes[] = {FMU_INSTANTIATED, FMU_INITIALIZATION, FMU_EVENT, FMU_CONTINUOUS, FMU_TERMINATED, FMU_FAILED};
    const int steps[] = {FMU_INSTANTIATED, FMU_INITIALIZATION, FMU_STEP, FMU_TERMINATED, FMU_FAILED};
    for (size_t k = 0; k < sizeof modes / sizeof modes[0]; k++)
        drive(FMU_ME, WITHOUT_EVENTS, modes[k]);
    for (size_t k = 0; k < sizeof steps / sizeof steps[0]; k++) {
        drive(FMU_CS, WITHOUT_EVENTS, steps[k]);
        drive(FMU_CS, WITH_EVENTS, steps[k]);
    }
    drive(FMU_CS, WITH_EVENTS, FMU_EVENT);
    drive_inside(WITHOUT_EVENTS);
    drive_inside(WITH_EVENTS);
    drive_to_the_end(WITHOUT_EVENTS);
    drive_to_the_end(WITH_EVENTS);
    try_instantiation();
    return 0;
}
