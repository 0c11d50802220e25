/* A master in C of one FMU for Co-Simulation: it opens the FMU's library and calls the functions of the standard.

   FMI 2 or 3: the version. The hand-written program beside it makes the same steps without an FMU. */
#define _GNU_SOURCE /* clock_gettime, dlopen */
#include <dlfcn.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#if defined(__GLIBC__)
#include <malloc.h>
#endif

#if FMI == 2
#include "fmi2.h"
#define EACH(F) F(Instantiate) F(FreeInstance) F(SetupExperiment) F(EnterInitializationMode) F(ExitInitializationMode) \
    F(SetReal) F(GetReal) F(DoStep)
#define NAME(name) fmi2##name
#else
#include "fmi3.h"
#define EACH(F) F(InstantiateCoSimulation) F(FreeInstance) F(EnterInitializationMode) F(ExitInitializationMode) \
    F(SetFloat64) F(GetFloat64) F(DoStep)
#define NAME(name) fmi3##name
#endif

#define POINTER(name) __typeof__(&NAME(name)) name;
typedef struct {
    void *library;
    const char *token;
    EACH(POINTER)
} Fmu;

void *fmu_open(const char *path, const char *token);
double fmu_drive(const Fmu *f, double stop, long steps, long per_second, int alone, int nin, const uint32_t *in,
                 const double *u, int nout, const uint32_t *out, double *y);
double fmu_lives(const Fmu *f, long count);
double fmu_crowd(const Fmu *f, long count, double stop);
double by_hand(double T, double k, long steps, long per_second, double *u, double *x);
double by_hand_with(double T, double k, long steps, long per_second, const double *u, double *y, double *x);

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Null where the library or one of the functions is not there. `token` outlives what is opened. */
void *fmu_open(const char *path, const char *token)
{
    Fmu *f = calloc(1, sizeof *f);
    int missing = 0;
    f->token = token;
    f->library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!f->library) {
        fprintf(stderr, "%s\n", dlerror());
        return NULL;
    }
#define TEXT_(x) #x
#define TEXT(x) TEXT_(x)
#define FIND(name) *(void **)(void *)&f->name = dlsym(f->library, TEXT(NAME(name))), missing |= !f->name;
    EACH(FIND)
    return missing ? NULL : f;
}

#if FMI == 2
static void tell(fmi2ComponentEnvironment c, fmi2String name, fmi2Status s, fmi2String category, fmi2String message,
                 ...)
{
    va_list arguments;
    (void)c, (void)name, (void)s, (void)category;
    va_start(arguments, message);
    vfprintf(stderr, message, arguments);
    va_end(arguments);
}

static void *make(const Fmu *f)
{
    static const fmi2CallbackFunctions functions = {tell, calloc, free, NULL, NULL};
    return f->Instantiate("one", fmi2CoSimulation, f->token, "", &functions, fmi2False, fmi2True);
}

static int begin(const Fmu *f, void *c, double stop, int nin, const uint32_t *in, const double *u)
{
    return f->SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2True, stop) || f->EnterInitializationMode(c)
           || (nin && f->SetReal(c, in, (size_t)nin, u)) || f->ExitInitializationMode(c);
}

#define SET(n, references, values) f->SetReal(c, references, (size_t)(n), values)
#define GET(n, references, values) f->GetReal(c, references, (size_t)(n), values)
#define STEP(t, h) f->DoStep(c, t, h, fmi2True)
#else
static void tell(fmi3InstanceEnvironment c, fmi3Status s, fmi3String category, fmi3String message)
{
    (void)c, (void)s, (void)category;
    fprintf(stderr, "%s\n", message);
}

static void *make(const Fmu *f)
{
    return f->InstantiateCoSimulation("one", f->token, "", false, true, false, false, NULL, 0, NULL, tell, NULL);
}

static int begin(const Fmu *f, void *c, double stop, int nin, const uint32_t *in, const double *u)
{
    return f->EnterInitializationMode(c, false, 0.0, 0.0, true, stop)
           || (nin && f->SetFloat64(c, in, (size_t)nin, u, (size_t)nin)) || f->ExitInitializationMode(c);
}

#define SET(n, references, values) f->SetFloat64(c, references, (size_t)(n), values, (size_t)(n))
#define GET(n, references, values) f->GetFloat64(c, references, (size_t)(n), values, (size_t)(n))
#define STEP(t, h) f->DoStep(c, t, h, true, &is_event, &is_end, &is_early, &last)
#endif

/* Seconds that the steps took, from t = 0 on; below 0: a call failed. u (steps, nin): its first row is set before the
   start, and each before its step; y (steps, nout): what is read after each step. alone: u has one row, which stays,
   and nothing is read. */
double fmu_drive(const Fmu *f, double stop, long steps, long per_second, int alone, int nin, const uint32_t *in,
                 const double *u, int nout, const uint32_t *out, double *y)
{
    void *c = make(f);
    double h = 1.0 / (double)per_second;
    int wrong = !c || begin(f, c, stop, nin, in, u);
#if FMI == 3
    bool is_event, is_end, is_early;
    double last;
#endif
    double begun = seconds();
    if (alone)
        for (long k = 0; k < steps && !wrong; k++) wrong = (int)STEP((double)k / (double)per_second, h);
    else
        for (long k = 0; k < steps && !wrong; k++) {
            wrong |= (int)SET(nin, in, u + k * nin);
            wrong |= (int)STEP((double)k / (double)per_second, h);
            wrong |= (int)GET(nout, out, y + k * nout);
        }
    double taken = seconds() - begun;
    if (c) f->FreeInstance(c);
    return wrong ? -1.0 : taken;
}

/* Seconds to make and free so many instances, one after the other. */
double fmu_lives(const Fmu *f, long count)
{
    double begun = seconds();
    for (long k = 0; k < count; k++) {
        void *c = make(f);
        if (!c) return -1.0;
        f->FreeInstance(c);
    }
    return seconds() - begun;
}

/* Bytes that malloc has given away; what the process occupies does not tell, as freed memory is used again. */
static double given(void)
{
#if defined(__GLIBC__) && __GLIBC_PREREQ(2, 33)
    struct mallinfo2 all = mallinfo2();
    return (double)all.uordblks + (double)all.hblkhd;
#else
    return NAN;
#endif
}

/* Bytes of memory that so many instances take at once, each initialized and one step on; below 0: a call failed. */
double fmu_crowd(const Fmu *f, long count, double stop)
{
    void **all = calloc((size_t)count, sizeof *all);
    double before = given(), taken = 0.0;
    int wrong = 0;
#if FMI == 3
    bool is_event, is_end, is_early;
    double last;
#endif
    for (long k = 0; k < count && !wrong; k++) {
        void *c = all[k] = make(f);
        wrong = !c || begin(f, c, stop, 0, NULL, NULL) || STEP(0.0, 1e-3);
    }
    taken = given() - before;
    for (long k = 0; k < count; k++)
        if (all[k]) f->FreeInstance(all[k]);
    free(all);
    return wrong ? -1.0 : taken;
}

/* The mathematics alone: T x' = k u - x by the classic Runge-Kutta method, in the order of the emitted code. The slope
   at a step's end is that of the next one's start, as long as u stays. */
static inline double slope(double x, double u, double k, double T) { return (k * u - x) / T; }

static inline double rk4(double x, double u, double k, double T, double h, double *first)
{
    const double h2 = 0.5 * h, h3 = h / 3.0, h6 = h / 6.0;
    double k0 = *first, k1 = slope(x + h2 * k0, u, k, T), k2 = slope(x + h2 * k1, u, k, T);
    double k3 = slope(x + h * k2, u, k, T);
    double made = x + (h6 * k0 + h3 * k1 + h3 * k2 + h6 * k3);
    *first = slope(made, u, k, T);
    return made;
}

/* Seconds of the steps; *x goes from the start to the end. What stands behind pointers is not known to the compiler. */
double by_hand(double T, double k, long steps, long per_second, double *u, double *x)
{
    double begun = seconds(), at = *x, first = slope(at, *u, k, T), input = *u;
    for (long n = 0; n < steps; n++) {
        double t = (double)n / (double)per_second, t1 = (double)(n + 1) / (double)per_second;
        at = rk4(at, input, k, T, t1 - t, &first);
    }
    *x = at;
    return seconds() - begun;
}

/* The same with an input (steps) that changes before each step, and an output (steps) that is kept after it. */
double by_hand_with(double T, double k, long steps, long per_second, const double *u, double *y, double *x)
{
    double begun = seconds(), at = *x;
    for (long n = 0; n < steps; n++) {
        double t = (double)n / (double)per_second, t1 = (double)(n + 1) / (double)per_second;
        double first = slope(at, u[n], k, T);
        at = rk4(at, u[n], k, T, t1 - t, &first);
        y[n] = at;
    }
    *x = at;
    return seconds() - begun;
}
