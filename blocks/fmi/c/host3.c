/* FMI 3.0.2 in the process of the FMU: frames become calls. */
#define _GNU_SOURCE
#include "calls3.h"
#include "host_calls.h"

static void log_message(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                        fmi3String message)
{
    host_log(environment, (int)status, category, message);
}

static void update(fmi3InstanceEnvironment environment, fmi3Float64 t, fmi3Boolean set, fmi3Boolean get,
                   fmi3Boolean finished, fmi3Boolean can_return, fmi3Boolean *early, fmi3Float64 *early_time)
{
    const uint64_t flags[] = {set, get, finished, can_return};
    unsigned char begun = 0; /* a bool that was never set may be neither */
    double time = t;
    if (early)
        memcpy(&begun, early, sizeof begun);
    if (early_time)
        time = *early_time;
    int wants = begun == 1;
    host_update(environment, t, flags, &wants, &time);
    if (early)
        *early = wants != 0;
    if (early_time)
        *early_time = time;
}

#define A(k) host_array(h, f, (k))
#define B(k) (f->n[k] != 0)

static int instantiate(Host *h, Fmu *fmu, const Frame *f)
{
    fmi3LogMessageCallback log = f->n[2] & 1 ? log_message : NULL;
    if (f->function == CALL_InstantiateModelExchange) {
        fmu->instance = fmu->InstantiateModelExchange(A(0), A(1), A(2), B(0), B(1), h, log);
        *(int *)A(3) = fmu->instance != NULL;
    } else {
        fmu->instance = fmu->InstantiateCoSimulation(A(0), A(1), A(2), B(0), B(1), B(3), B(4), A(3), f->n[5], h, log,
                                                     f->n[2] & 2 ? update : NULL);
        *(int *)A(4) = fmu->instance != NULL;
    }
    return STATUS_OK;
}

const Standard host_fmi3 = {find, serve, "fmi3"};
