/* A model with everything that Model Exchange knows, for FMI 2 (FMI == 2) and FMI 3. Its states are in mm.

       x' = -a x + 1000 (u + k)                    k: a whole number, taken over at events
       s' = on                                     on: a bool, taken over at events
       y = x + 1000 u,  n = 2 k,  lamp = on,  count: its events,  feed = u alone

   An indicator x - mark with hysteresis; a time event every `period`; a step event where s passes whole multiples of
   `level`, at which x jumps by `jump`. It ends the run at `end`, discards where x > `limit`, fails from `failing` on.
   With -DLAZY what is got in continuous time is as it was when derivatives were asked for last. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if FMI == 2
typedef void *I;
typedef int Bool;
typedef void (*Log)(void *, const char *, int, const char *, const char *, ...);
typedef struct { Log logger; void *(*a)(size_t, size_t); void (*f)(void *); void *s; void *environment; } Callbacks;
#define F(name) fmi2##name
#else
#include <stdbool.h>
typedef void *I;
typedef bool Bool;
typedef void (*Log)(void *, int, const char *, const char *);
#define F(name) fmi3##name
#endif
enum { TIME, X, S, U, K, ON, A, Y, N, LAMP, COUNT, DX, DS, MARK, PERIOD, LEVEL, JUMP, END, LIMIT, FAILING, WRONG, Z, FEED,
       X_START, REFERENCES };
typedef struct {
    double v[REFERENCES];
    double next, passed;
    int upper, asks, events, mode; /* 0 initialization, 1 event, 2 continuous */
    int is_new;
    Log log;
    void *environment;
    const char *name;
    const void *callbacks;
} M;
static int live;

__attribute__((visibility("default"))) int zoo_live(void) { return live; }

static void say(M *m, const char *text)
{
#if FMI == 2
    m->log(m->environment, m->name, 3, "logStatusError", text);
#else
    m->log(m->environment, 3, "logStatusError", text);
#endif
}

static void evaluate(M *m)
{
    double *v = m->v;
    v[DX] = -v[A] * v[X] + 1000 * (v[U] + v[K]);
    v[DS] = v[ON];
    v[Y] = v[X] + 1000 * v[U];
    v[FEED] = v[U];
    v[N] = 2 * v[K];
    v[LAMP] = v[ON];
    v[COUNT] = m->events;
    v[Z] = v[X] - v[MARK] + (m->upper ? 1e-3 : -1e-3);
}

static int checked(M *m)
{
    if (m->v[TIME] >= m->v[FAILING]) {
        say(m, "the zoo is closed");
        return 3;
    }
    if (m->mode == 2 && m->v[X] > m->v[LIMIT]) return 2;
    evaluate(m);
    return 0;
}

static M *made(const char *name)
{
    M *m = calloc(1, sizeof *m);
    m->name = strdup(name);
    double *v = m->v;
    v[A] = 1, v[MARK] = 1e9, v[PERIOD] = 0, v[LEVEL] = 1e9, v[JUMP] = 100, v[END] = v[LIMIT] = v[FAILING] = 1e30;
    v[X_START] = 500;
    live++;
    return m;
}

void F(FreeInstance)(I c)
{
    if (!c) return;
    free((char *)((M *)c)->name);
    free(c);
    live--;
}

static int enter_initialization(M *m, double start)
{
    m->v[TIME] = start;
    m->v[X] = m->v[X_START];
    m->mode = 0;
    return 0;
}

int F(ExitInitializationMode)(I c)
{
    M *m = c;
    m->mode = 1;
    m->upper = m->v[X] > m->v[MARK];
    m->next = m->v[PERIOD] > 0 ? m->v[TIME] + m->v[PERIOD] : INFINITY;
    m->passed = m->v[LEVEL];
    return 0;
}

int F(EnterEventMode)(I c)
{
    M *m = c;
    m->mode = 1;
    m->is_new = 1;
    return 0;
}
int F(EnterContinuousTimeMode)(I c) { ((M *)c)->mode = 2; return 0; }
int F(SetTime)(I c, double t) { ((M *)c)->v[TIME] = t; return 0; }
int F(Terminate)(I c) { (void)c; return 0; }
int F(Reset)(I c) { (void)c; return 0; }

int F(SetContinuousStates)(I c, const double x[], size_t n)
{
    M *m = c;
    if (n != 2 || m->mode != 2) return 3;
    m->v[X] = x[0], m->v[S] = x[1];
    return 0;
}

int F(GetContinuousStates)(I c, double x[], size_t n)
{
    M *m = c;
    x[0] = m->v[X], x[1] = m->v[S];
    return n != 2;
}

static int derivatives(M *m, double d[])
{
    int status = checked(m);
    d[0] = m->v[DX], d[1] = m->v[DS];
    return status;
}

int F(GetEventIndicators)(I c, double z[], size_t n)
{
    M *m = c;
    int status = checked(m);
    z[0] = m->v[Z];
    return status ? status : n != 1;
}

static void update(M *m, Bool *again, Bool *ends, Bool *states)
{
    m->events += m->is_new;
    *again = m->is_new; /* one iteration more than it needs */
    m->is_new = 0;
    m->upper = m->v[X] > m->v[MARK];
    if (m->asks) m->v[X] += m->v[JUMP], *states = 1, m->asks = 0;
    if (m->v[TIME] >= m->next) m->next += m->v[PERIOD];
    *ends = m->v[TIME] >= m->v[END];
}

static void completed(M *m, Bool *enter, Bool *ends)
{
    if (m->v[S] >= m->passed) m->passed += m->v[LEVEL], m->asks = 1;
    *enter = m->asks;
    *ends = m->v[TIME] >= m->v[END];
}

static int directional(M *m, const unsigned out[], size_t n, const unsigned in[], size_t k, const double seed[], double made[])
{
    for (size_t i = 0; i < n; i++) {
        made[i] = 0;
        for (size_t j = 0; j < k; j++) {
            double d = 0;
            if (out[i] == DX) d = in[j] == X ? -m->v[A] : in[j] == U ? 1000 : 0;
            if (out[i] == Y) d = in[j] == X ? 1 : in[j] == U ? 1000 : 0;
            if (out[i] == FEED) d = in[j] == U;
            if (out[i] == Z) d = in[j] == X;
            made[i] += (m->v[WRONG] != 0 ? -2 : 1) * d * seed[j];
        }
    }
    return 0;
}

static int put(M *m, unsigned reference, double value)
{
    int held = reference == K || reference == ON || reference == A;
    if (reference == Y || (held && m->mode == 2)) {
        say(m, "that cannot be set now");
        return 3;
    }
    m->v[reference] = value;
    return 0;
}

#ifdef LAZY
#define EVALUATED(m) 0
#else
#define EVALUATED(m) checked(m)
#endif
#define GET(name, type)                                                          \
    int F(name)(I c, const unsigned r[], size_t n, type values[] MORE)           \
    {                                                                            \
        int status = ((M *)c)->mode == 2 ? EVALUATED(c) : (evaluate(c), 0);        \
        for (size_t i = 0; i < n; i++) values[i] = (type)((M *)c)->v[r[i]];      \
        return status;                                                           \
    }
#define SET(name, type)                                                          \
    int F(name)(I c, const unsigned r[], size_t n, const type values[] MORE)     \
    {                                                                            \
        for (size_t i = 0; i < n; i++)                                           \
            if (put(c, r[i], values[i])) return 3;                               \
        return 0;                                                                \
    }

#if FMI == 2
#define MORE
I fmi2Instantiate(const char *name, int kind, const char *token, const char *place, const Callbacks *f, int v, int logs)
{
    (void)kind, (void)token, (void)place, (void)v, (void)logs;
    M *m = made(name);
    m->log = f->logger, m->environment = f->environment;
    return m;
}
int fmi2SetupExperiment(I c, int has, double tolerance, double start, int stops, double stop)
{
    (void)has, (void)tolerance, (void)stops, (void)stop;
    return enter_initialization(c, start);
}
int fmi2EnterInitializationMode(I c) { return enter_initialization(c, ((M *)c)->v[TIME]); }
int fmi2GetDerivatives(I c, double d[], size_t n) { (void)n; return derivatives(c, d); }
GET(GetReal, double) GET(GetInteger, int) GET(GetBoolean, int) SET(SetReal, double) SET(SetInteger, int) SET(SetBoolean, int)
typedef struct { int again, ends, nominals, states, has; double next; } Info;
int fmi2NewDiscreteStates(I c, Info *info)
{
    memset(info, 0, sizeof *info);
    update(c, &info->again, &info->ends, &info->states);
    info->next = ((M *)c)->next, info->has = isfinite(info->next);
    return 0;
}
int fmi2CompletedIntegratorStep(I c, int no, int *enter, int *ends) { (void)no; completed(c, enter, ends); return 0; }
int fmi2GetDirectionalDerivative(I c, const unsigned o[], size_t n, const unsigned i[], size_t k, const double s[], double d[])
{
    return directional(c, o, n, i, k, s, d);
}
int fmi2GetFMUstate(I c, void **state) { if (!*state) *state = malloc(sizeof(M)); memcpy(*state, c, sizeof(M)); return 0; }
int fmi2SetFMUstate(I c, void *state) { const char *name = ((M *)c)->name; memcpy(c, state, sizeof(M)); ((M *)c)->name = name; return 0; }
int fmi2FreeFMUstate(I c, void **state) { (void)c; free(*state); *state = NULL; return 0; }
#else
#define MORE , size_t nv
I fmi3InstantiateModelExchange(const char *name, const char *token, const char *place, bool v, bool logs, void *e, Log log)
{
    (void)token, (void)place, (void)v, (void)logs;
    M *m = made(name);
    m->log = log, m->environment = e;
    return m;
}
int fmi3EnterInitializationMode(I c, bool has, double tolerance, double start, bool stops, double stop)
{
    (void)has, (void)tolerance, (void)stops, (void)stop;
    return enter_initialization(c, start);
}
int fmi3GetContinuousStateDerivatives(I c, double d[], size_t n) { (void)n; return derivatives(c, d); }
#pragma GCC diagnostic ignored "-Wunused-parameter"
GET(GetFloat64, double) GET(GetInt16, int16_t) GET(GetBoolean, bool) SET(SetFloat64, double) SET(SetInt16, int16_t) SET(SetBoolean, bool)
GET(GetUInt64, uint64_t)
int fmi3UpdateDiscreteStates(I c, bool *again, bool *ends, bool *nominals, bool *states, bool *has, double *next)
{
    *again = *ends = *nominals = *states = 0;
    update(c, again, ends, states);
    *next = ((M *)c)->next, *has = isfinite(*next);
    return 0;
}
int fmi3CompletedIntegratorStep(I c, bool no, bool *enter, bool *ends) { completed(c, enter, ends); return 0; }
int fmi3GetDirectionalDerivative(I c, const unsigned o[], size_t n, const unsigned i[], size_t k, const double s[], size_t ns,
                                 double d[], size_t nd)
{
    return directional(c, o, n, i, k, s, d);
}
#endif
