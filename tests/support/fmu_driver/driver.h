/* What the drivers of both versions share: each call prints a line

       kind mode function variant status messages mode-afterwards

   kind: ME, CS or CS+events. status: that of the standard as a number (of functions that make an instance: 1 for one, 0
   for none). messages: how many the logger got during the call. Variants:

       valid      arguments as the standard wants them
       found      the same for a variable that may not be allowed to be set
       none       zero counts, with null pointers
       null       a null pointer where something is needed
       wrong      a reference, size, time or value that cannot be right
       nobody     no instance
       silent     an instance that cannot be made, and nobody to tell
       flags      0 where an intermediate update says what it should of itself

   The compiler's command line says which model it is: DRIVER_TOKEN, and value references of one-element variables (-1:
   there is none): DRIVER_INPUT, of a continuous input that can be 0; DRIVER_OUTPUT, of a continuous output;
   DRIVER_STATE, of a continuous state; DRIVER_PARAMETER, of a tunable parameter. All must be real. DRIVER_STEP and
   DRIVER_STOP: a communication step and the stop time, s; the run begins at 0. */
#ifndef DRIVER_H
#define DRIVER_H

#include "fmu.h"

#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifndef DRIVER_TOKEN
#error "DRIVER_TOKEN is the GUID or the instantiation token"
#endif
#ifndef DRIVER_INPUT
#define DRIVER_INPUT -1
#endif
#ifndef DRIVER_OUTPUT
#define DRIVER_OUTPUT -1
#endif
#ifndef DRIVER_STATE
#define DRIVER_STATE -1
#endif
#ifndef DRIVER_PARAMETER
#define DRIVER_PARAMETER -1
#endif
#ifndef DRIVER_STEP
#define DRIVER_STEP 1e-3
#endif
#ifndef DRIVER_STOP
#define DRIVER_STOP 1.0
#endif

static struct {
    const char *kind, *mode, *function;
    Fmu *fmu; /* of the instance that is spoken to; null: there is none */
    int messages;
} at;

/* The wrappers keep the core's instance as their first member. */
static Fmu *core_of(void *instance)
{
    return instance ? *(Fmu **)instance : NULL;
}

static const char *mode_of(const Fmu *f)
{
    switch (f ? fmu_mode(f) : 0) {
    case FMU_INSTANTIATED: return "instantiated";
    case FMU_INITIALIZATION: return "initialization";
    case FMU_EVENT: return "event";
    case FMU_CONTINUOUS: return "continuous";
    case FMU_STEP: return "step";
    case FMU_INTERMEDIATE: return "intermediate";
    case FMU_ASKING: return "asking";
    case FMU_TERMINATED: return "terminated";
    case FMU_FAILED: return "failed";
    default: return "-";
    }
}

static void report(const char *variant, int status)
{
    printf("%s %s %s %s %d %d %s\n", at.kind, at.mode, at.function, variant, status, at.messages, mode_of(at.fmu));
    at.messages = 0;
}

#define TRY(variant, call) report(variant, (int)(call))

/* The first reference where a variable of this type begins; -1: there is none. */
static int first_of(int type)
{
    for (size_t r = 0; r < fmu_references(); r++)
        if (fmu_elements((uint32_t)r) && fmu_type((uint32_t)r) == type)
            return (int)r;
    return -1;
}

/* Zeros, one more than n, to be freed. */
static double *zeros(size_t n)
{
    double *made = calloc(n + 1, sizeof(double));
    if (!made)
        abort();
    return made;
}

static const uint32_t NOWHERE[1] = {UINT32_MAX};

#endif
