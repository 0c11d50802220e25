/* An FMU of FMI 3 whose arrays have n elements: y = a u, x' = y, element by element. It refuses what the standard does:
   n outside of configuration mode, and values that are not as many as the elements. x is exact where u is held. */

#include <math.h>
#include <stdlib.h>

#include "fmi3.h"

#define MOST 4
#define C fmi3Instance c
#define F __attribute__((visibility("default"))) fmi3Status

enum { TIME, N, A, U, Y, X, RATE };

typedef struct {
    int configuring;
    size_t n;
    double t, a[MOST], u[MOST], x[MOST];
} Model;

static Model *begun(void) {
    Model *m = calloc(1, sizeof *m);
    m->n = 2;
    for (int i = 0; i < MOST; i++) m->a[i] = 100.0, m->u[i] = 100.0; /* seen where nobody sets them */
    m->a[0] = 1.0, m->a[1] = 2.0, m->u[0] = 3.0, m->u[1] = 4.0;
    return m;
}

__attribute__((visibility("default"))) fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events,
    fmi3Boolean early, const fmi3ValueReference *required, size_t nrequired, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    (void)name, (void)token, (void)path, (void)visible, (void)logging, (void)events, (void)early, (void)required;
    (void)nrequired, (void)environment, (void)log, (void)update;
    return begun();
}

__attribute__((visibility("default"))) fmi3Instance fmi3InstantiateModelExchange(
    fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    (void)name, (void)token, (void)path, (void)visible, (void)logging, (void)environment, (void)log;
    return begun();
}

__attribute__((visibility("default"))) const char *fmi3GetVersion(void) { return "3.0"; }
__attribute__((visibility("default"))) void fmi3FreeInstance(C) { free(c); }

F fmi3SetDebugLogging(C, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    return (void)c, (void)on, (void)n, (void)categories, fmi3OK;
}
F fmi3EnterConfigurationMode(C) { ((Model *)c)->configuring = 1; return fmi3OK; }
F fmi3ExitConfigurationMode(C) { ((Model *)c)->configuring = 0; return fmi3OK; }
F fmi3EnterInitializationMode(C, fmi3Boolean has, double tolerance, double start, fmi3Boolean ends, double stop) {
    (void)has, (void)tolerance, (void)ends, (void)stop;
    ((Model *)c)->t = start;
    return fmi3OK;
}
F fmi3ExitInitializationMode(C) { return (void)c, fmi3OK; }
F fmi3EnterEventMode(C) { return (void)c, fmi3OK; }
F fmi3EnterStepMode(C) { return (void)c, fmi3OK; }
F fmi3EnterContinuousTimeMode(C) { return (void)c, fmi3OK; }
F fmi3Terminate(C) { return (void)c, fmi3OK; }
F fmi3Reset(C) { return (void)c, fmi3Error; }

static double value(const Model *m, unsigned reference, size_t i) {
    const double y = m->a[i] * m->u[i];
    return reference == A ? m->a[i] : reference == U ? m->u[i] : reference == X ? m->x[i] : y;
}

F fmi3GetFloat64(C, const fmi3ValueReference vr[], size_t n, fmi3Float64 values[], size_t total) {
    const Model *m = c;
    size_t k = 0;
    for (size_t j = 0; j < n; j++) {
        const size_t size = vr[j] == TIME ? 1 : m->n;
        if (k + size > total) return fmi3Error;
        for (size_t i = 0; i < size; i++) values[k++] = vr[j] == TIME ? m->t : value(m, vr[j], i);
    }
    return k == total ? fmi3OK : fmi3Error;
}

F fmi3SetFloat64(C, const fmi3ValueReference vr[], size_t n, const fmi3Float64 values[], size_t total) {
    Model *m = c;
    size_t k = 0;
    for (size_t j = 0; j < n; j++) {
        double *place = vr[j] == A ? m->a : vr[j] == U ? m->u : NULL;
        if (place == NULL || k + m->n > total) return fmi3Error;
        for (size_t i = 0; i < m->n; i++) place[i] = values[k++];
    }
    return k == total ? fmi3OK : fmi3Error;
}

F fmi3GetUInt64(C, const fmi3ValueReference vr[], size_t n, fmi3UInt64 values[], size_t total) {
    (void)vr, (void)total;
    for (size_t j = 0; j < n; j++) values[j] = ((Model *)c)->n;
    return fmi3OK;
}
F fmi3SetUInt64(C, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 values[], size_t total) {
    Model *m = c;
    if (!m->configuring || n != 1 || total != 1 || vr[0] != N || values[0] > MOST) return fmi3Error;
    m->n = values[0];
    return fmi3OK;
}

F fmi3DoStep(C, double t, double h, fmi3Boolean keeps, fmi3Boolean *event, fmi3Boolean *ends, fmi3Boolean *early,
             double *last) {
    Model *m = c;
    (void)keeps;
    for (size_t i = 0; i < m->n; i++) m->x[i] += h * m->a[i] * m->u[i];
    *event = *ends = *early = 0;
    *last = m->t = t + h;
    return fmi3OK;
}

F fmi3SetTime(C, double t) { ((Model *)c)->t = t; return fmi3OK; }
F fmi3SetContinuousStates(C, const double x[], size_t n) {
    Model *m = c;
    if (n != m->n) return fmi3Error;
    for (size_t i = 0; i < n; i++) m->x[i] = x[i];
    return fmi3OK;
}
static fmi3Status given(C, unsigned reference, double values[], size_t n) {
    if (n != ((Model *)c)->n) return fmi3Error;
    for (size_t i = 0; i < n; i++) values[i] = value(c, reference, i);
    return fmi3OK;
}
F fmi3GetContinuousStates(C, double x[], size_t n) { return given(c, X, x, n); }
F fmi3GetContinuousStateDerivatives(C, double rates[], size_t n) { return given(c, RATE, rates, n); }
F fmi3GetNominalsOfContinuousStates(C, double x[], size_t n) {
    (void)c;
    for (size_t i = 0; i < n; i++) x[i] = 1.0;
    return fmi3OK;
}
F fmi3GetNumberOfContinuousStates(C, size_t *n) { *n = ((Model *)c)->n; return fmi3OK; }
F fmi3GetNumberOfEventIndicators(C, size_t *n) { (void)c; *n = 0; return fmi3OK; }
F fmi3GetEventIndicators(C, double z[], size_t n) { return (void)c, (void)z, n ? fmi3Error : fmi3OK; }
F fmi3CompletedIntegratorStep(C, fmi3Boolean keeps, fmi3Boolean *enter, fmi3Boolean *ends) {
    (void)c, (void)keeps;
    *enter = *ends = 0;
    return fmi3OK;
}
F fmi3UpdateDiscreteStates(C, fmi3Boolean *again, fmi3Boolean *ends, fmi3Boolean *nominals, fmi3Boolean *values,
                           fmi3Boolean *has_time, double *time) {
    (void)c;
    *again = *ends = *nominals = *values = *has_time = 0;
    *time = 0.0;
    return fmi3OK;
}
