/* Frames become calls of the FMU's functions, alike for both versions: for host2.c and host3.c, behind the list of the
   functions. They define `instantiate`, for those that begin an instance. */
#ifndef BLOCKS_HOST_CALLS_H
#define BLOCKS_HOST_CALLS_H

#include "host.h"

#include <stdlib.h>
#include <string.h>

#define MEMBER(name, ...) __typeof__(FMI(name)) *name;
typedef struct {
    OTHERS(MEMBER) CALLS(MEMBER)
    void *instance;
    unsigned char has[CALLS_END];
} Fmu;

static int instantiate(Host *h, Fmu *fmu, const Frame *f);

static void find(Host *h)
{
    Fmu *fmu = calloc(1, sizeof *fmu);
    if (!fmu)
        abort();
    /* ISO C has no way from a pointer to an object to one to a function; POSIX has them alike. */
#define FIND(name, ...)                                \
    {                                                  \
        void *found = host_symbol(h, FULL_NAME(name)); \
        memcpy(&fmu->name, &found, sizeof found);      \
        fmu->has[CALL_##name] = found != NULL;         \
    }
    OTHERS(FIND) CALLS(FIND)
    h->fmu = fmu;
}

static const char *name_of(int function)
{
#define NAME(name, ...) #name,
    static const char *const NAMES[] = {OTHERS(NAME) CALLS(NAME)};
    return function > CALLS_BEFORE && function < CALLS_END ? NAMES[function - FIRST_FUNCTION] : NULL;
}

/* The arguments, by their names. */
#define TAKE_NUMBER(k, type, name) const type name = (type)f->n[k];
#define TAKE_REAL(k, name) const double name = f->x[k];
#define TAKE_IN(k, type, name, count) const type *name = host_array(host, f, (k));
#define TAKE_OUT(k, type, name, count) type *name = host_array(host, f, (k));
#define TAKE_TEXTS_IN(k, what, name, count)                      \
    const char **name = host_strings(host, f, (k), f->n[TEXTS]); \
    if (!name)                                                   \
        return STATUS_ERROR;
#define TAKE_TEXTS_OUT(k, what, name, count)                   \
    const char **name = calloc(f->n[TEXTS] + 1, sizeof *name); \
    if (!name)                                                 \
        return STATUS_ERROR;
#define TAKE_STATE(k, name)               \
    void *name = NULL;                    \
    if (host_state(host, f->n[k], &name)) \
        return host_without_state(host);
#define TAKE_STATE_INOUT(k, name)                   \
    uint64_t *number = host_array(host, f, (k));    \
    void *kept = NULL, **name = &kept;              \
    if (!number || host_state(host, *number, name)) \
        return host_without_state(host);
#define TAKE_NONE

#define GIVE_NUMBER(k, type, name) , name
#define GIVE_REAL(k, name) , name
#define GIVE_IN(k, type, name, count) , name
#define GIVE_OUT(k, type, name, count) , name
#define GIVE_TEXTS_IN(k, what, name, count) , name
#define GIVE_TEXTS_OUT(k, what, name, count) , name
#define GIVE_STATE(k, name) , name
#define GIVE_STATE_INOUT(k, name) , name
#define GIVE_NONE

#define LEAVE_NUMBER(k, type, name)
#define LEAVE_REAL(k, name)
#define LEAVE_IN(k, type, name, count)
#define LEAVE_OUT(k, type, name, count)
#define LEAVE_TEXTS_IN(k, what, name, count) free(name);
#define LEAVE_TEXTS_OUT(k, what, name, count)                                                                     \
    if ((status == STATUS_OK || status == STATUS_WARNING) && host_leave_strings(host, f, (k), name, f->n[TEXTS])) \
        status = STATUS_ERROR;                                                                                    \
    free(name);
#define LEAVE_STATE(k, name)
#define LEAVE_STATE_INOUT(k, name) *number = host_keep(host, *number, kept);
#define LEAVE_NONE

static int serve(Host *host, Frame *f)
{
    Fmu *fmu = host->fmu;
    const char *called = name_of(f->function);
    if (!called || !fmu->has[f->function])
        return host_missing(host, called ? called : "?");
    switch (f->function) {
    case CALL_FreeInstance: fmu->FreeInstance(fmu->instance); host->is_over = 1; return STATUS_OK;
#define SERVE(name, ...)                                                     \
    case CALL_##name: {                                                      \
        EACH(TAKE_, __VA_ARGS__)                                             \
        int status = (int)fmu->name(fmu->instance EACH(GIVE_, __VA_ARGS__)); \
        EACH(LEAVE_, __VA_ARGS__)                                            \
        return status;                                                       \
    }
    CALLS(SERVE)
    default: return instantiate(host, fmu, f);
    }
}

#endif
