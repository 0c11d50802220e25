/* Each call of a run is written down, a line each, in the file that the environment names in FAULTY_CALLS: the instance,
   the function, and what went in or out. Included by faulty.c with -DCALLS: what it defines from there on is called by
   the functions of this file. */
#include <stdarg.h>
#include <stdio.h>

static void note(const Instance *one, const char *format, ...) {
    const char *name = getenv("FAULTY_CALLS");
    FILE *file = name == NULL ? NULL : fopen(name, "a");
    if (file == NULL) return;
    va_list rest;
    va_start(rest, format);
    fprintf(file, "%s ", one->name);
    vfprintf(file, format, rest);
    fprintf(file, "\n");
    va_end(rest);
    fclose(file);
}

/* The values of at most four variables. */
static void moved(const Instance *one, const char *what, size_t n, const unsigned vr[], const double value[]) {
    char text[400] = "";
    size_t used = 0;
    for (size_t i = 0; i < n && i < 4; i++)
        used += (size_t)snprintf(text + used, sizeof text - used, " %u %.17g", vr[i], value == NULL ? 0.0 : value[i]);
    note(one, "%s%s", what, text);
}

#define VR const unsigned vr[], size_t n
#define NAMED(name) #name
#if FMI == 2
#define G(name) fmi2##name
#define OWN(name) own_fmi2##name
#define S fmi2Status
#define VALUES(type) fmi2##type value[]
#define GIVEN value
#else
#define G(name) fmi3##name
#define OWN(name) own_fmi3##name
#define S fmi3Status
#define VALUES(type) fmi3##type value[], size_t all
#define GIVEN value, all
#endif
#define GET(name, type, reals)                                                                                         \
    S OWN(Get##name)(void *c, VR, VALUES(type));                                                                       \
    S G(Get##name)(void *c, VR, VALUES(type)) {                                                                        \
        S status = OWN(Get##name)(c, vr, n, GIVEN);                                                                    \
        moved(c, NAMED(Get##name), n, vr, reals);                                                                      \
        return status;                                                                                                 \
    }
#define SET(name, type, reals)                                                                                         \
    S OWN(Set##name)(void *c, VR, const VALUES(type));                                                                 \
    S G(Set##name)(void *c, VR, const VALUES(type)) {                                                                  \
        moved(c, NAMED(Set##name), n, vr, reals);                                                                      \
        return OWN(Set##name)(c, vr, n, GIVEN);                                                                        \
    }
#define PLAINLY(name)                                                                                                  \
    S OWN(name)(void *c);                                                                                              \
    S G(name)(void *c) {                                                                                               \
        note(c, #name);                                                                                                \
        return OWN(name)(c);                                                                                           \
    }
PLAINLY(ExitInitializationMode)
GET(Boolean, Boolean, NULL) SET(Boolean, Boolean, NULL)
#if FMI == 2
GET(Real, Real, value) SET(Real, Real, value)
GET(Integer, Integer, NULL) SET(Integer, Integer, NULL)
S own_fmi2DoStep(void *c, double t, double h, int forgets);
S fmi2DoStep(void *c, double t, double h, int forgets) {
    note(c, "DoStep %.17g %.17g %d", t, h, forgets);
    return own_fmi2DoStep(c, t, h, forgets);
}
S fmi2SetRealInputDerivatives(void *c, VR, const int order[], const double value[]) {
    note(c, "Derivatives %d", order[0]);
    moved(c, "of", n, vr, value);
    return fmi2OK; /* without the effect that they have in faulty.c, where steps are 1 s long */
}
S own_fmi2GetFMUstate(void *c, void **state);
S fmi2GetFMUstate(void *c, void **state) {
    note(c, "save");
    return own_fmi2GetFMUstate(c, state);
}
S own_fmi2SetFMUstate(void *c, void *state);
S fmi2SetFMUstate(void *c, void *state) {
    note(c, "restore");
    return own_fmi2SetFMUstate(c, state);
}
#define fmi2ExitInitializationMode own_fmi2ExitInitializationMode
#define fmi2GetReal own_fmi2GetReal
#define fmi2SetReal own_fmi2SetReal
#define fmi2GetInteger own_fmi2GetInteger
#define fmi2SetInteger own_fmi2SetInteger
#define fmi2GetBoolean own_fmi2GetBoolean
#define fmi2SetBoolean own_fmi2SetBoolean
#define fmi2DoStep own_fmi2DoStep
#define fmi2SetRealInputDerivatives own_fmi2SetRealInputDerivatives
#define fmi2GetFMUstate own_fmi2GetFMUstate
#define fmi2SetFMUstate own_fmi2SetFMUstate
#else
GET(Float64, Float64, value) SET(Float64, Float64, value)
GET(Int32, Int32, NULL) SET(Int32, Int32, NULL)
SET(Int64, Int64, NULL)
PLAINLY(EnterEventMode) PLAINLY(EnterStepMode)
S own_fmi3DoStep(void *c, double t, double h, bool forgets, bool *event, bool *terminate, bool *early, double *last);
S fmi3DoStep(void *c, double t, double h, bool forgets, bool *event, bool *terminate, bool *early, double *last) {
    note(c, "DoStep %.17g %.17g %d", t, h, forgets);
    return own_fmi3DoStep(c, t, h, forgets, event, terminate, early, last);
}
S own_fmi3UpdateDiscreteStates(void *c, bool *again, bool *terminate, bool *nominals, bool *states, bool *has_next, double *next);
S fmi3UpdateDiscreteStates(void *c, bool *again, bool *terminate, bool *nominals, bool *states, bool *has_next, double *next) {
    note(c, "UpdateDiscreteStates");
    return own_fmi3UpdateDiscreteStates(c, again, terminate, nominals, states, has_next, next);
}
S own_fmi3GetFMUState(void *c, void **state);
S fmi3GetFMUState(void *c, void **state) {
    note(c, "save");
    return own_fmi3GetFMUState(c, state);
}
S own_fmi3SetFMUState(void *c, void *state);
S fmi3SetFMUState(void *c, void *state) {
    note(c, "restore");
    return own_fmi3SetFMUState(c, state);
}
#define fmi3ExitInitializationMode own_fmi3ExitInitializationMode
#define fmi3GetFloat64 own_fmi3GetFloat64
#define fmi3SetFloat64 own_fmi3SetFloat64
#define fmi3GetInt32 own_fmi3GetInt32
#define fmi3SetInt32 own_fmi3SetInt32
#define fmi3SetInt64 own_fmi3SetInt64
#define fmi3GetBoolean own_fmi3GetBoolean
#define fmi3SetBoolean own_fmi3SetBoolean
#define fmi3EnterEventMode own_fmi3EnterEventMode
#define fmi3EnterStepMode own_fmi3EnterStepMode
#define fmi3DoStep own_fmi3DoStep
#define fmi3UpdateDiscreteStates own_fmi3UpdateDiscreteStates
#define fmi3GetFMUState own_fmi3GetFMUState
#define fmi3SetFMUState own_fmi3SetFMUState
#endif
#undef GET
#undef SET
#undef VR
#undef S
#undef G
