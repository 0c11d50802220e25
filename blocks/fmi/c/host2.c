/* FMI 2.0.4 in the process of the FMU: frames become calls. */
#define _GNU_SOURCE
#include "calls2.h"
#include "host_calls.h"

#include <stdarg.h>
#include <stdio.h>

/* The arguments are put into the message here: they do not go to another process. */
static void logger(fmi2ComponentEnvironment environment, fmi2String instanceName, fmi2Status status,
                   fmi2String category, fmi2String message, ...)
{
    char small[1024], *text = small;
    va_list rest;
    (void)instanceName;
    va_start(rest, message);
    const int length = vsnprintf(small, sizeof small, message ? message : "", rest);
    va_end(rest);
    if (length >= (int)sizeof small && (text = malloc((size_t)length + 1)) != NULL) {
        va_start(rest, message);
        vsnprintf(text, (size_t)length + 1, message, rest);
        va_end(rest);
    }
    host_log(environment, status, category, length < 0 ? message : text ? text : small);
    if (text != small)
        free(text);
}

static void *allocate(size_t n, size_t size)
{
    return calloc(n, size);
}

static int instantiate(Host *h, Fmu *fmu, const Frame *f)
{
    static fmi2CallbackFunctions callbacks; /* the FMU may keep a pointer to them; a process has one instance */
    callbacks = (fmi2CallbackFunctions){logger, allocate, free, NULL, h};
    fmu->instance = fmu->Instantiate(host_array(h, f, 0), (fmi2Type)f->n[0], host_array(h, f, 1), host_array(h, f, 2),
                                     &callbacks, (fmi2Boolean)f->n[1], (fmi2Boolean)f->n[2]);
    *(int *)host_array(h, f, 3) = fmu->instance != NULL;
    return STATUS_OK;
}

const Standard host_fmi2 = {find, serve, "fmi2"};
