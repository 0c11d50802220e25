/* The least FMU for Co-Simulation: y' = K (u - y), INNER explicit Euler steps for each doStep. FMI 2 or 3: the version.

   With one inner step it does next to nothing, so that what a master costs shows. The functions that it has no use for stand in another
   file, which benchmarks/master.py prints from the header. VARIANT tells files apart that are else the same. */
#include <stdlib.h>
#include <string.h>

enum { U, Y, Y0, VALUES }; /* the value references; Y0: the start of y */

#define K 5.0

typedef struct {
    double v[VALUES];
} Tiny;

/* It sits in the binary, so that the binaries of two variants differ. */
extern const char tiny_variant[];
__attribute__((visibility("default"))) const char tiny_variant[] = VARIANT;

static void *made(const char *token)
{
    Tiny *c = strcmp(token, TOKEN) ? NULL : calloc(1, sizeof *c);
    if (c) c->v[U] = 1.0;
    return c;
}

static inline int got(const Tiny *c, const unsigned *r, size_t n, double *values)
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= VALUES) return 3;
        values[i] = c->v[r[i]];
    }
    return 0;
}

static inline int put(Tiny *c, const unsigned *r, size_t n, const double *values)
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] == Y || r[i] >= VALUES) return 3;
        c->v[r[i]] = values[i];
    }
    return 0;
}

static inline void stepped(Tiny *c, double h)
{
    for (int i = 0; i < INNER; i++) c->v[Y] += h / INNER * K * (c->v[U] - c->v[Y]);
}

/* The start of y is known when initialization begins, so that y can be read within it. */
static int started(Tiny *c)
{
    c->v[Y] = c->v[Y0];
    return 0;
}

#if FMI == 2
#include "fmi2.h"

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type kind, fmi2String guid, fmi2String place,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)name, (void)place, (void)functions, (void)visible, (void)logging;
    return kind == fmi2CoSimulation ? made(guid) : NULL;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }
const char *fmi2GetVersion(void) { return "2.0"; }
const char *fmi2GetTypesPlatform(void) { return "default"; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop)
{
    (void)c, (void)has_tolerance, (void)tolerance, (void)start, (void)has_stop, (void)stop;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return started(c) ? fmi2Error : fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return started(c) ? fmi2Error : fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return c ? fmi2OK : fmi2Error; }

fmi2Status fmi2Reset(fmi2Component c)
{
    memset(c, 0, sizeof(Tiny));
    ((Tiny *)c)->v[U] = 1.0;
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real values[])
{
    return (fmi2Status)got(c, r, n, values);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real values[])
{
    return (fmi2Status)put(c, r, n, values);
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean stays)
{
    (void)t, (void)stays;
    stepped(c, h);
    return fmi2OK;
}
#else
#include "fmi3.h"

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String place, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)place, (void)visible, (void)logging, (void)events, (void)early, (void)required, (void)n;
    (void)environment, (void)log, (void)update;
    return made(token);
}

void fmi3FreeInstance(fmi3Instance c) { free(c); }
const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi3OK;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop)
{
    (void)has_tolerance, (void)tolerance, (void)start, (void)has_stop, (void)stop;
    return started(c) ? fmi3Error : fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return started(c) ? fmi3Error : fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return c ? fmi3OK : fmi3Error; }

fmi3Status fmi3Reset(fmi3Instance c)
{
    memset(c, 0, sizeof(Tiny));
    ((Tiny *)c)->v[U] = 1.0;
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 values[], size_t many)
{
    return many == n ? (fmi3Status)got(c, r, n, values) : fmi3Error;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 values[],
                          size_t many)
{
    return many == n ? (fmi3Status)put(c, r, n, values) : fmi3Error;
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean stays, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last)
{
    (void)stays;
    stepped(c, h);
    *event = *end = *early = false;
    *last = t + h;
    return fmi3OK;
}
#endif
