/* The importer's side of an FMU that runs in a process of its own, apart from the version of FMI: it starts the
   process, hands calls on, takes callbacks, and says how it ended. proxy2.c and proxy3.c are the functions of the
   standard, most of them by proxy_calls.h. */
#ifndef BLOCKS_PROXY_H
#define BLOCKS_PROXY_H

#include "channel.h"

#include <sys/types.h>

typedef struct Proxy Proxy;

struct Proxy {
    /* To the importer: a message; FMI 3's intermediate update, which may set early and early_time. May be null. */
    void (*tell)(Proxy *p, int status, const char *category, const char *message);
    void (*update)(Proxy *p, const Frame *asked, int *early, double *early_time);
    Head *head;
    size_t bytes;   /* mapped */
    size_t top;     /* where the next frame begins */
    int file;
    pid_t process;  /* 0: there is none any more */
    pid_t owner;    /* the process that made it */
    int is_lost;    /* the process ended, or was ended: every call is fatal */
    int is_fatal;   /* the FMU said so: it must not be called any more */
    uint32_t calls;
    Patience patience;
    uint64_t timeout; /* ns; 0: none */
    char *text;     /* what string values point into */
    char why[512];  /* how it ended */
};

/* What a call hands over besides its arrays. */
typedef struct {
    int function;
    const char *name;
    uint64_t n[NUMBERS];
    double x[REALS];
} Request;

/* An array of a call: copied there from `in`, and back to `out` (null: not). in = null: a null pointer. */
typedef struct {
    const void *in;
    void *out;
    size_t bytes;
} Array;

/* SIZE_MAX where there is no such number of bytes. */
static inline size_t proxy_bytes(size_t n, size_t each)
{
    return n > (size_t)1 << 40 ? SIZE_MAX : n * each;
}

/* Starts the process and has the FMU loaded; -1: it failed, `why` says how, and the importer was told. */
int proxy_start(Proxy *p, const char *fmi);
/* The status of a call; STATUS_FATAL where the process ended in it, or before. p may be null: an error. */
int proxy_call(Proxy *p, const Request *request, const Array *arrays, int count);
/* Ends the process and gives its memory back, but not p itself. */
void proxy_end(Proxy *p, const Request *free_instance);
/* Without FMI's end: for an instance that was not made. */
void proxy_abandon(Proxy *p);
/* A message from here, of status STATUS_ERROR, which it returns. */
int proxy_refuse(Proxy *p, const char *name, const char *what);
/* After a call: what the FMU's side left in span k, checked; null where there is nothing. */
const char *proxy_reply(Proxy *p, int k, size_t *bytes);
/* After a call that was answered with n strings in span k: pointers to copies, valid until the next call. -1: none. */
int proxy_take_strings(Proxy *p, int k, const char *values[], size_t n);
/* n strings one after the other, with their zeros, in memory to be freed; null where one is null or there is no room.*/
char *proxy_join(const char *const strings[], size_t n, size_t *bytes);
size_t proxy_length(const char *string); /* with its zero; 0 for null */

#endif
