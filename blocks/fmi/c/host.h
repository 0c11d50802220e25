/* The process that an FMU runs in, apart from the version of FMI. host2.c and host3.c call the FMU's functions, as
   host_calls.h says. */
#ifndef BLOCKS_HOST_H
#define BLOCKS_HOST_H

#include "channel.h"

#include <pthread.h>

typedef struct Note Note;
typedef struct Host Host;

/* What differs between the versions. */
typedef struct {
    /* The functions that `symbol` finds; the numbers of the frames are those of `calls.h`. */
    void (*find)(Host *h);
    /* One call; FreeInstance is the last one. */
    int (*serve)(Host *h, Frame *frame);
    const char *prefix;
} Standard;

struct Host {
    const Standard *standard;
    void *library, *fmu;   /* fmu: the functions and the instance, as host_calls.h has them */
    char *base;            /* the file, as it is mapped now */
    size_t bytes;
    /* Earlier mappings of the file stay: the FMU has pointers into them while it works. */
    size_t at, end;        /* the present frame */
    int is_working, is_over;
    Patience patience;
    pthread_t worker;
    pthread_mutex_t lock;  /* of the notes */
    Note *first, *last;    /* messages from other threads of the FMU, which wait for the next answer */
    void **states;         /* the FMU's states by number - 1; null: free */
    size_t nstates;
};

/* The array k of a frame; null for a null pointer. */
void *host_array(const Host *h, const Frame *frame, int k);
/* Its strings: n pointers, to be freed. Null where there is no memory, or they are not there. */
const char **host_strings(const Host *h, const Frame *frame, int k, size_t n);
/* Leaves strings behind as array k. */
int host_leave_strings(Host *h, Frame *frame, int k, const char *const strings[], size_t n);
void *host_symbol(const Host *h, const char *name);
int host_missing(Host *h, const char *name);
void host_log(Host *h, int status, const char *category, const char *message);
/* The intermediate update of FMI 3. flags: 4. */
void host_update(Host *h, double t, const uint64_t *flags, int *early, double *early_time);
/* The FMU's state of a number; 0 is none. -1: there is no such one. */
int host_state(const Host *h, uint64_t number, void **state);
int host_without_state(Host *h); /* says so; STATUS_ERROR */
/* The number of a state from now on: of `number`, or a new one where that is 0. 0: there is no memory. */
uint64_t host_keep(Host *h, uint64_t number, void *state);

extern const Standard host_fmi2, host_fmi3;

#endif
