/* Calls of a feigned FMU through the shims of blocks/fmi/c/trace.h: odd texts, long arrays, calls within a call, many
   messages. driver FILE TEXT|JSON: lines to FILE; then the same to stdout, through a function. */
#include "fmi3.h"
#include "trace.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static BlocksTraced *one;
static fmi3Status (*set)(fmi3Instance, const fmi3ValueReference[], size_t, const double[], size_t);
static fmi3Status (*get)(fmi3Instance, const fmi3ValueReference[], size_t, fmi3String[], size_t);
static fmi3Status (*advance)(fmi3Instance, double, double, fmi3Boolean, fmi3Boolean *, fmi3Boolean *, fmi3Boolean *, double *);

static fmi3Status own_set(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const double v[], size_t all)
{
    (void)vr, (void)n, (void)v, (void)all;
    return c == (void *)1 ? fmi3OK : fmi3Fatal;
}

static fmi3Status own_get(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3String v[], size_t all)
{
    static const char *const texts[] = {"a\xff\xc0\x80\xed\xa0\x80\xf4\x90\x80\x80\n\x1b[31m\"\\", NULL, "\xe2\x80\xae \xcf\x89"};
    (void)c, (void)vr, (void)n;
    for (size_t i = 0; i < all; i++) v[i] = texts[i % 3];
    return fmi3OK;
}

static fmi3Status own_step(fmi3Instance c, double t, double h, fmi3Boolean keeps, fmi3Boolean *event, fmi3Boolean *ends,
                           fmi3Boolean *early, double *last)
{
    const uint32_t references[] = {1, 2, 99};
    double values[400] = {INFINITY, NAN, 0.1};
    (void)c, (void)t, (void)h, (void)keeps;
    *event = *ends = *early = 0, *last = NAN;
    set((void *)one, references, 3, values, 400);
    set((void *)one, references, 3, values, 2);
    set((void *)one, references, 1, values, 400);
    set((void *)one, references, 0, values, 0);
    set((void *)one, references, 3, values, 3);
    for (int i = 0; i < 1500; i++) blocks_trace_message(one, i % 9, "odd\n", "text \xff \t \xc2\x9b ...");
    return (fmi3Status)7;
}

static void print(void *where, const char *lines) { fputs(lines, where); }

static void drive(BlocksTrace *trace)
{
    static char name[2000] = "long\n\"";
    static const char *const states[] = {"s"}, *const given[] = {"instanceName", "x\xff"};
    memset(name + 6, 'y', sizeof name - 7);
    const BlocksTraceName names[] = {{1, 0, 5, "u"}, {2, 0, 7, name}};
    one = blocks_trace_instance(trace, "a\"b\n[0]", names, 2, states, 1);
    blocks_trace_making(one, "fmi3InstantiateCoSimulation", given, 1);
    blocks_trace_made(one, (void *)1);
    *(void **)&set = blocks_trace_shim(one, "fmi3SetFloat64", (void *)own_set);
    *(void **)&get = blocks_trace_shim(one, "fmi3GetString", (void *)own_get);
    *(void **)&advance = blocks_trace_shim(one, "fmi3DoStep", (void *)own_step);
    if (blocks_trace_shim(one, "fmi3Nothing", NULL)) abort();
    fmi3Boolean flags[3];
    double last;
    fmi3String texts[300];
    uint32_t references[300];
    for (uint32_t i = 0; i < 300; i++) references[i] = i;
    for (int k = 0; k < 20; k++) {
        advance((void *)one, k * 0.1, 0.1, 1, flags, flags + 1, flags + 2, &last);
        get((void *)one, references, 300, texts, 300);
        blocks_trace_message(one, 1, NULL, NULL);
    }
    for (int k = 0; k < 2000; k++) {
        double value = k;
        set((void *)one, references + 1, 1, &value, 1);
    }
    int64_t calls = 0, ns;
    const char *function;
    for (int k = 0; k < 2 * TRACE_FUNCTIONS; k++) calls += blocks_trace_profile(one, k, &function, &ns);
    if (calls != 1 + 20 * (2 + 5) + 2000 || blocks_trace_close(trace)) abort();
    blocks_trace_free(trace);
}

int main(int argc, char **argv)
{
    if (argc != 3) return 2;
    int is_json = !strcmp(argv[2], "JSON");
    drive(blocks_trace_new(argv[1], is_json, 200000, 9000, NULL, NULL));
    drive(blocks_trace_new(NULL, is_json, 0, 0, print, stdout));
    drive(blocks_trace_new(NULL, 0, 0, 0, NULL, NULL));
    return 0;
}
