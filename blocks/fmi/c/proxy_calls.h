/* Calls become frames, alike for both versions: the functions of a list, for proxy2.c and proxy3.c. */
#ifndef BLOCKS_PROXY_CALLS_H
#define BLOCKS_PROXY_CALLS_H

#include "proxy.h"

#include <stdlib.h>
#include <string.h>

typedef FMI(Status) Status;

#define COUNT(array) ((int)(sizeof(array) / sizeof *(array)))
/* A call of a function with arrays, and with the numbers that follow. */
#define FORWARD(p, called, arrays, ...)                                                                      \
    proxy_call((p), &(Request){.function = CALL_##called, .name = FULL_NAME(called), __VA_ARGS__}, (arrays), \
               COUNT(arrays))

#define PUT_NUMBER(k, type, name) request.n[k] = (uint64_t)(int64_t)name;
#define PUT_REAL(k, name) request.x[k] = name;
#define PUT_ARRAY(k, from, to, size) arrays[(count = (k) + 1) - 1] = (Array){(from), (to), (size)};
#define PUT_IN(k, type, name, n) PUT_ARRAY(k, name, NULL, proxy_bytes((n), sizeof *name))
#define PUT_OUT(k, type, name, n) PUT_ARRAY(k, name, name, proxy_bytes((n), sizeof *name))
#define PUT_TEXTS_IN(k, what, texts, number)                                     \
    char *joined = texts ? proxy_join(texts, (number), &bytes) : NULL;           \
    if (number && !joined)                                                       \
        return (Status)proxy_refuse(c, request.name, what " is a null pointer"); \
    request.n[TEXTS] = number;                                                   \
    PUT_ARRAY(k, joined, NULL, bytes)
#define PUT_TEXTS_OUT(k, what, texts, number) \
    request.n[TEXTS] = number;                \
    PUT_ARRAY(k, "", NULL, 1)
#define PUT_STATE(k, name) request.n[k] = (uintptr_t)name;
#define PUT_STATE_INOUT(k, name) PUT_ARRAY(k, name, name, sizeof *name)
#define PUT_NONE

#define TAKE_NUMBER(k, type, name)
#define TAKE_REAL(k, name)
#define TAKE_IN(k, type, name, n)
#define TAKE_OUT(k, type, name, n)
#define TAKE_TEXTS_IN(k, what, texts, number) free(joined);
#define TAKE_TEXTS_OUT(k, what, texts, number)                                                            \
    if ((status == STATUS_OK || status == STATUS_WARNING) && proxy_take_strings(c, (k), texts, (number))) \
        return (Status)proxy_refuse(c, request.name, "no " what " came back");
#define TAKE_STATE(k, name)
#define TAKE_STATE_INOUT(k, name)
#define TAKE_NONE

#define DEFINE(called, ...)                                                       \
    Status FMI(called)(void *c EACH(PARAMETER_, __VA_ARGS__))                     \
    {                                                                             \
        Request request = {.function = CALL_##called, .name = FULL_NAME(called)}; \
        Array arrays[SPANS] = {0};                                                \
        size_t bytes = 0;                                                         \
        int count = 0;                                                            \
        EACH(PUT_, __VA_ARGS__)                                                   \
        const int status = proxy_call(c, &request, arrays, count);                \
        EACH(TAKE_, __VA_ARGS__)                                                  \
        (void)bytes;                                                              \
        return (Status)status;                                                    \
    }
CALLS(DEFINE)

#endif
