/* FMI 2.0.4, of an FMU that runs in a process of its own: each function hands its arguments on. Checks are left to the
   FMU, so that it answers as it would without this. One difference: calls are never answered later, as the importer's
   stepFinished is not handed on; an FMU that has no other way to tell may return fmi2Pending, and is asked by
   fmi2GetStatus. */
#define _GNU_SOURCE
#include "calls2.h"
#include "proxy_calls.h"

typedef struct {
    Proxy proxy; /* first */
    fmi2CallbackFunctions callbacks;
    char *name;
} Instance;

static void tell(Proxy *p, int status, const char *category, const char *message)
{
    const Instance *in = (const Instance *)p;
    if (!in->callbacks.logger)
        return;
    /* Loggers that are not written in C may not see the arguments behind the message. */
    if (strchr(message, '%'))
        in->callbacks.logger(in->callbacks.componentEnvironment, in->name, (fmi2Status)status, category, "%s", message);
    else
        in->callbacks.logger(in->callbacks.componentEnvironment, in->name, (fmi2Status)status, category, message);
}

const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    Instance *in = calloc(1, sizeof *in);
    if (!in)
        return NULL;
    in->name = strdup(instanceName ? instanceName : "");
    if (functions)
        in->callbacks = *functions;
    in->proxy.tell = tell;
    int is_made = 0;
    if (in->name && proxy_start(&in->proxy, "2") == 0) {
        const Array arrays[] = {
            {instanceName, NULL, proxy_length(instanceName)},
            {fmuGUID, NULL, proxy_length(fmuGUID)},
            {fmuResourceLocation, NULL, proxy_length(fmuResourceLocation)},
            {&is_made, &is_made, sizeof is_made},
        };
        FORWARD(&in->proxy, Instantiate, arrays,
                .n = {(uint64_t)fmuType, (uint64_t)(int64_t)visible, (uint64_t)(int64_t)loggingOn});
    }
    if (is_made)
        return in;
    if (in->proxy.head)
        proxy_abandon(&in->proxy);
    free(in->name);
    free(in);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c)
{
    Instance *in = c;
    if (!in)
        return;
    proxy_end(&in->proxy, &(Request){.function = CALL_FreeInstance, .name = "fmi2FreeInstance"});
    free(in->name);
    free(in);
}
