/* What both versions are tried with alike. Before it stand the header of the version, and

       FMI(name)                    what FMI 3 calls so; driver2.c gives the words of FMI 2 these names
       MOVE(call, c, vr, values)    a call that gets or sets one value
       Instance */
#define TEXT(name) TEXT_(name)
#define TEXT_(name) #name

static void try_logging(Instance c)
{
    const FMI(String) all[] = {"logEvents", "logStatusWarning", "logStatusError", "logNonlinearSystems", "logAll"};
    const FMI(String) unknown[] = {"logEvents", "logNothing"}, null[] = {NULL};
    at.function = TEXT(FMI(SetDebugLogging));
    TRY("nobody", FMI(SetDebugLogging)(NULL, FMI(True), 0, NULL));
    TRY("null", FMI(SetDebugLogging)(c, FMI(True), 1, NULL));
    TRY("null", FMI(SetDebugLogging)(c, FMI(True), 1, null));
    TRY("wrong", FMI(SetDebugLogging)(c, FMI(True), 2, unknown));
    TRY("valid", FMI(SetDebugLogging)(c, FMI(True), 5, all));
    TRY("valid", FMI(SetDebugLogging)(c, FMI(False), 0, NULL));
    TRY("none", FMI(SetDebugLogging)(c, FMI(True), 0, NULL));
}

#define TRY_PLAIN(name, call)                       \
    static void try_##name(Instance c)              \
    {                                               \
        at.function = TEXT(call);                   \
        TRY("nobody", call(NULL));                  \
        TRY("valid", call(c));                      \
    }

TRY_PLAIN(exit_initialization, FMI(ExitInitializationMode))
TRY_PLAIN(terminate, FMI(Terminate))
TRY_PLAIN(reset, FMI(Reset))
TRY_PLAIN(enter_event, FMI(EnterEventMode))
TRY_PLAIN(enter_continuous, FMI(EnterContinuousTimeMode))

/* The references that the driver was given. */
static void try_given(Instance c)
{
    const int given[] = {DRIVER_INPUT, DRIVER_PARAMETER, DRIVER_STATE, DRIVER_OUTPUT};
    for (int k = 0; k < 4; k++) {
        const FMI(ValueReference) vr[1] = {(FMI(ValueReference))given[k]};
        FMI(Float64) value[1] = {0};
        if (given[k] < 0)
            continue;
        at.function = TEXT(FMI(GetFloat64));
        TRY("valid", MOVE(FMI(GetFloat64), c, vr, value));
        at.function = TEXT(FMI(SetFloat64));
        if (!isfinite(value[0]))
            value[0] = 0;
        /* A parameter cannot be set between events, an output never. */
        TRY(k == 0 ? "valid" : "found", MOVE(FMI(SetFloat64), c, vr, value));
        value[0] = NAN;
        TRY("wrong", MOVE(FMI(SetFloat64), c, vr, value));
        value[0] = -INFINITY;
        TRY("wrong", MOVE(FMI(SetFloat64), c, vr, value));
    }
}

static void try_states_of_fmu(Instance c)
{
    FMI(FMUState) state = NULL, copy = NULL;
    size_t size = 0;
    at.function = TEXT(FMI(GetFMUState));
    TRY("nobody", FMI(GetFMUState)(NULL, &state));
    TRY("null", FMI(GetFMUState)(c, NULL));
    TRY("valid", FMI(GetFMUState)(c, &state));
    TRY("valid", FMI(GetFMUState)(c, &state));
    at.function = TEXT(FMI(SetFMUState));
    TRY("nobody", FMI(SetFMUState)(NULL, state));
    TRY("null", FMI(SetFMUState)(c, NULL));
    if (state)
        TRY("valid", FMI(SetFMUState)(c, state));
    at.function = TEXT(FMI(SerializedFMUStateSize));
    TRY("nobody", FMI(SerializedFMUStateSize)(NULL, state, &size));
    TRY("null", FMI(SerializedFMUStateSize)(c, NULL, &size));
    TRY("null", FMI(SerializedFMUStateSize)(c, state, NULL));
    if (state)
        TRY("valid", FMI(SerializedFMUStateSize)(c, state, &size));
    FMI(Byte) *bytes = malloc(size + 1);
    if (!bytes)
        abort();
    memset(bytes, 0, size + 1);
    at.function = TEXT(FMI(SerializeFMUState));
    TRY("nobody", FMI(SerializeFMUState)(NULL, state, bytes, size));
    TRY("null", FMI(SerializeFMUState)(c, NULL, bytes, size));
    TRY("null", FMI(SerializeFMUState)(c, state, NULL, size));
    if (state) {
        TRY("wrong", FMI(SerializeFMUState)(c, state, bytes, size - 1));
        TRY("wrong", FMI(SerializeFMUState)(c, state, bytes, size + 1));
        TRY("wrong", FMI(SerializeFMUState)(c, state, bytes, 0));
        TRY("valid", FMI(SerializeFMUState)(c, state, bytes, size));
    }
    at.function = TEXT(FMI(DeserializeFMUState));
    TRY("nobody", FMI(DeserializeFMUState)(NULL, bytes, size, &copy));
    TRY("null", FMI(DeserializeFMUState)(c, NULL, size, &copy));
    TRY("null", FMI(DeserializeFMUState)(c, bytes, size, NULL));
    if (state)
        TRY("valid", FMI(DeserializeFMUState)(c, bytes, size, &copy));
    at.function = TEXT(FMI(SetFMUState));
    if (copy)
        TRY("valid", FMI(SetFMUState)(c, copy));
    at.function = TEXT(FMI(FreeFMUState));
    TRY("valid", FMI(FreeFMUState)(c, &copy));
    /* Bytes that are none of this FMU's: either call may find out. */
    const size_t sizes[] = {0, 1, size / 2, size - 1, size};
    for (size_t k = 0; state && k < sizeof sizes / sizeof sizes[0]; k++) {
        if (k == 4)
            memset(bytes, 0xA5, size);
        copy = NULL;
        at.function = TEXT(FMI(DeserializeFMUState));
        TRY("found", FMI(DeserializeFMUState)(c, bytes, sizes[k], &copy));
        at.function = TEXT(FMI(SetFMUState));
        TRY("wrong", FMI(SetFMUState)(c, copy));
        at.function = TEXT(FMI(FreeFMUState));
        TRY("valid", FMI(FreeFMUState)(c, &copy));
    }
    free(bytes);
    TRY("nobody", FMI(FreeFMUState)(NULL, &state));
    TRY("valid", FMI(FreeFMUState)(c, &state));
    TRY("valid", FMI(FreeFMUState)(c, &state));
    TRY("valid", FMI(FreeFMUState)(c, NULL));
}

static void try_completed_step(Instance c)
{
    FMI(Boolean) event, end;
    at.function = TEXT(FMI(CompletedIntegratorStep));
    TRY("nobody", FMI(CompletedIntegratorStep)(NULL, FMI(True), &event, &end));
    TRY("null", FMI(CompletedIntegratorStep)(c, FMI(True), NULL, &end));
    TRY("null", FMI(CompletedIntegratorStep)(c, FMI(True), &event, NULL));
    TRY("valid", FMI(CompletedIntegratorStep)(c, FMI(True), &event, &end));
}

static void try_time(Instance c)
{
    at.function = TEXT(FMI(SetTime));
    TRY("nobody", FMI(SetTime)(NULL, 0));
    TRY("wrong", FMI(SetTime)(c, NAN));
    TRY("wrong", FMI(SetTime)(c, INFINITY));
    TRY("valid", FMI(SetTime)(c, DRIVER_STEP));
}

#define TRY_VECTOR(name, call, count)               \
    static void try_##name(Instance c)              \
    {                                               \
        const size_t n = count();                   \
        double *values = zeros(n);                  \
        at.function = TEXT(call);                   \
        TRY("nobody", call(NULL, values, n));       \
        TRY("wrong", call(c, values, n + 1));       \
        if (n) {                                    \
            TRY("null", call(c, NULL, n));          \
            TRY("wrong", call(c, values, n - 1));   \
        }                                           \
        TRY("valid", call(c, n ? values : NULL, n));\
        free(values);                               \
    }

TRY_VECTOR(get_rates, FMI(GetContinuousStateDerivatives), fmu_number_of_states)
TRY_VECTOR(get_indicators, FMI(GetEventIndicators), fmu_number_of_indicators)
TRY_VECTOR(get_states, FMI(GetContinuousStates), fmu_number_of_states)
TRY_VECTOR(get_nominals, FMI(GetNominalsOfContinuousStates), fmu_number_of_states)

static void try_set_states(Instance c)
{
    const size_t n = fmu_number_of_states();
    double *values = zeros(n);
    fmu_get_states(at.fmu, values, n);
    at.messages = 0;
    at.function = TEXT(FMI(SetContinuousStates));
    TRY("nobody", FMI(SetContinuousStates)(NULL, values, n));
    TRY("wrong", FMI(SetContinuousStates)(c, values, n + 1));
    TRY("valid", FMI(SetContinuousStates)(c, n ? values : NULL, n));
    if (n) {
        TRY("null", FMI(SetContinuousStates)(c, NULL, n));
        values[n - 1] = NAN;
        TRY("wrong", FMI(SetContinuousStates)(c, values, n));
    }
    free(values);
}

static void try_nothing(Instance c)
{
    (void)c;
}
