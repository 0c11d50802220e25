/* A master written by hand, for any number of instances of an FMU with one real input and one real output: Jacobi, hold.

   FMI 2 or 3: the version. At each communication point all outputs are read, all inputs set, and all instances stepped;
   every status is looked at, as a master must. */
#define _GNU_SOURCE /* clock_gettime, dlopen */
#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define SHOWN __attribute__((visibility("default")))

#if FMI == 2
#include "fmi2.h"
#define EACH(F) F(Instantiate) F(FreeInstance) F(SetupExperiment) F(EnterInitializationMode) F(ExitInitializationMode) \
    F(SetReal) F(GetReal) F(DoStep) F(Terminate)
#define NAME(name) fmi2##name
#else
#include "fmi3.h"
#define EACH(F) F(InstantiateCoSimulation) F(FreeInstance) F(EnterInitializationMode) F(ExitInitializationMode) \
    F(SetFloat64) F(GetFloat64) F(DoStep) F(Terminate)
#define NAME(name) fmi3##name
#endif

#define POINTER(name) __typeof__(&NAME(name)) name;
typedef struct {
    void *library;
    const char *token;
    EACH(POINTER)
} Fmu;

SHOWN void *master_open(const char *path, const char *token);
SHOWN void master_close(Fmu *f);
SHOWN double master_run(const Fmu *f, long count, const int32_t *source, const double *start, long steps,
                        long per_second, double *y, int record);
SHOWN double master_load(const Fmu *f, long count);

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Null where the library or one of the functions is not there. `token` outlives what is opened. */
void *master_open(const char *path, const char *token)
{
    Fmu *f = calloc(1, sizeof *f);
    int missing = 0;
    f->token = token;
    f->library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!f->library) {
        fprintf(stderr, "%s\n", dlerror());
        free(f);
        return NULL;
    }
#define TEXT_(x) #x
#define TEXT(x) TEXT_(x)
#define FIND(name) *(void **)(void *)&f->name = dlsym(f->library, TEXT(NAME(name))), missing |= !f->name;
    EACH(FIND)
    return missing ? NULL : f;
}

void master_close(Fmu *f)
{
    dlclose(f->library);
    free(f);
}

static const uint32_t U = 0, Y = 1, Y0 = 2;

#if FMI == 2
static void tell(fmi2ComponentEnvironment c, fmi2String name, fmi2Status s, fmi2String category, fmi2String message,
                 ...)
{
    (void)c, (void)name, (void)s, (void)category;
    fprintf(stderr, "%s\n", message);
}

static void *make(const Fmu *f)
{
    static const fmi2CallbackFunctions functions = {tell, calloc, free, NULL, NULL};
    return f->Instantiate("one", fmi2CoSimulation, f->token, "", &functions, fmi2False, fmi2False);
}

static int begin(const Fmu *f, void *c, double stop, const double *start)
{
    return f->SetReal(c, &Y0, 1, start) || f->SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2True, stop)
           || f->EnterInitializationMode(c) || f->ExitInitializationMode(c);
}

#define SET(c, value) f->SetReal(c, &U, 1, value)
#define GET(c, value) f->GetReal(c, &Y, 1, value)
#define STEP(c, t, h) f->DoStep(c, t, h, fmi2True)
#else
static void tell(fmi3InstanceEnvironment c, fmi3Status s, fmi3String category, fmi3String message)
{
    (void)c, (void)s, (void)category;
    fprintf(stderr, "%s\n", message);
}

static void *make(const Fmu *f)
{
    return f->InstantiateCoSimulation("one", f->token, "", false, false, false, false, NULL, 0, NULL, tell, NULL);
}

static int begin(const Fmu *f, void *c, double stop, const double *start)
{
    return f->SetFloat64(c, &Y0, 1, start, 1) || f->EnterInitializationMode(c, false, 0.0, 0.0, true, stop)
           || f->ExitInitializationMode(c);
}

#define SET(c, value) f->SetFloat64(c, &U, 1, value, 1)
#define GET(c, value) f->GetFloat64(c, &Y, 1, value, 1)
#define STEP(c, t, h) f->DoStep(c, t, h, true, &is_event, &is_end, &is_early, &last)
#endif

static void end(const Fmu *f, void **c, long count)
{
    for (long i = 0; i < count; i++)
        if (c[i]) f->FreeInstance(c[i]);
    free(c);
}

/* Seconds of the steps from t = 0 on, without what comes before and after; below 0: a call failed.

   source (count): whose output an input takes; -1: the input stays as it is. start (count): of each y.
   y (steps + 1, count) where all are recorded, else (1, count): the outputs at the end. */
double master_run(const Fmu *f, long count, const int32_t *source, const double *start, long steps, long per_second,
                  double *y, int record)
{
    void **c = calloc((size_t)count, sizeof *c);
    double stop = (double)steps / (double)per_second, h = 1.0 / (double)per_second;
    int wrong = 0;
#if FMI == 3
    bool is_event = false, is_end = false, is_early = false;
    double last;
#endif
    for (long i = 0; i < count; i++) wrong |= !(c[i] = make(f)) || begin(f, c[i], stop, &start[i]);
    double begun = seconds();
    for (long k = 0; k < steps && !wrong; k++) {
        double t = (double)k / (double)per_second;
        for (long i = 0; i < count; i++) wrong |= (int)GET(c[i], &y[i]);
        for (long i = 0; i < count; i++)
            if (source[i] >= 0) wrong |= (int)SET(c[i], &y[source[i]]);
        for (long i = 0; i < count; i++) {
            wrong |= (int)STEP(c[i], t, h);
#if FMI == 3
            wrong |= is_event | is_end | is_early;
#endif
        }
        if (record) y += count;
    }
    for (long i = 0; i < count && !wrong; i++) wrong |= (int)GET(c[i], &y[i]);
    double taken = seconds() - begun;
    for (long i = 0; i < count && !wrong; i++) wrong |= (int)f->Terminate(c[i]);
    end(f, c, count);
    return wrong ? -1.0 : taken;
}

/* Seconds to make and initialize so many instances, which live at the same time; below 0: a call failed. */
double master_load(const Fmu *f, long count)
{
    void **c = calloc((size_t)count, sizeof *c);
    double start = 0.0, begun = seconds();
    int wrong = 0;
    for (long i = 0; i < count; i++) wrong |= !(c[i] = make(f)) || begin(f, c[i], 1.0, &start);
    double taken = seconds() - begun;
    end(f, c, count);
    return wrong ? -1.0 : taken;
}
