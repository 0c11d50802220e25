/* The shims of one version of the standard, from its list of functions: see trace.h and calls.h. */
#ifndef BLOCKS_TRACE_CALLS_H
#define BLOCKS_TRACE_CALLS_H

#include <stdbool.h>

typedef FMI(Status) Status;

#define PASS_NUMBER(k, type, name) , name
#define PASS_REAL(k, name) , name
#define PASS_IN(k, type, name, count) , name
#define PASS_OUT(k, type, name, count) , name
#define PASS_TEXTS_IN(k, what, name, count) , name
#define PASS_TEXTS_OUT(k, what, name, count) , name
#define PASS_STATE(k, name) , name
#define PASS_STATE_INOUT(k, name) , name
#define PASS_NONE

#define GIVEN_NUMBER(k, type, name) blocks_trace_value(&call, #name, KIND_##type, &name, 1);
#define GIVEN_REAL(k, name) call.x[k] = name; blocks_trace_value(&call, #name, KIND_fmi2Real, &name, 1);
#define GIVEN_IN(k, type, name, count) blocks_trace_value(&call, #name, KIND_##type, name, count);
#define GIVEN_OUT(k, type, name, count)
#define GIVEN_TEXTS_IN(k, what, name, count) blocks_trace_value(&call, #name, KIND_text, name, count);
#define GIVEN_TEXTS_OUT(k, what, name, count)
#define GIVEN_STATE(k, name) call.state = name; blocks_trace_state(&call, name);
#define GIVEN_STATE_INOUT(k, name) call.state_out = name; if (call.function == CALL_FREE && name) blocks_trace_state(&call, *name);
#define GIVEN_NONE

#define GIVES_NUMBER(k, type, name)
#define GIVES_REAL(k, name)
#define GIVES_IN(k, type, name, count)
#define GIVES_OUT(k, type, name, count) blocks_trace_value(&call, #name, KIND_##type, name, count);
#define GIVES_TEXTS_IN(k, what, name, count)
#define GIVES_TEXTS_OUT(k, what, name, count) blocks_trace_value(&call, #name, KIND_text, name, count);
#define GIVES_STATE(k, name)
#define GIVES_STATE_INOUT(k, name) if (name && *name) blocks_trace_state(&call, *name);
#define GIVES_NONE

/* Where the instance stands after a call, and which states it has saved. */
static void follow(BlocksTraced *one, const BlocksTraceCall *call, int status)
{
    void *kept = call->state_out ? *call->state_out : NULL;
    int at = 0;
    if (status > 1 && !(status == 2 && call->function == CALL_DoStep)) return;
    switch (call->function) {
    case CALL_START: one->t = call->x[1]; break;
    case CALL_SetTime: one->t = call->x[0]; break;
    case CALL_DoStep:
        if (status != 2 && !call->is_early) one->t = call->x[0] + call->x[1];
        else if (call->last == call->last) one->t = call->last;
        break;
    case CALL_SAVE:
    case CALL_LOAD: /* whose time nobody says: that of the instance */
        while (at < TRACE_STATES - 1 && one->saved[at] && one->saved[at] != kept) at++;
        one->saved[at] = kept, one->saved_t[at] = one->t;
        break;
    case CALL_RESTORE:
        for (; at < TRACE_STATES; at++)
            if (one->saved[at] == call->state) one->t = one->saved_t[at];
        break;
    case CALL_FREE:
        for (; at < TRACE_STATES; at++)
            if (call->state && one->saved[at] == call->state) one->saved[at] = NULL;
        break;
    default: break;
    }
}

#define SHIM(called, ...)                                                                                  \
    static Status shim_##called(void *c EACH(PARAMETER_, __VA_ARGS__))                                     \
    {                                                                                                      \
        BlocksTraced *one = c;                                                                             \
        BlocksTraceCall call;                                                                              \
        blocks_trace_begin(one, CALL_##called, &call);                                                     \
        EACH(GIVEN_, __VA_ARGS__)                                                                          \
        if (call.function == CALL_FREE && call.state_out) call.state = *call.state_out;                    \
        blocks_trace_given(&call);                                                                         \
        Status (*original)(void * EACH(PARAMETER_, __VA_ARGS__)) =                                         \
            *(Status (**)(void * EACH(PARAMETER_, __VA_ARGS__)))&one->originals[CALL_##called];            \
        const Status status = original(one->component EACH(PASS_, __VA_ARGS__));                           \
        blocks_trace_returned(&call);                                                                      \
        if ((int)status <= 1 || CALL_##called == CALL_DoStep) { EACH(GIVES_, __VA_ARGS__) }                \
        follow(one, &call, (int)status);                                                                   \
        blocks_trace_end(&call, (int)status);                                                              \
        return status;                                                                                     \
    }
CALLS(SHIM)

static void shim_FreeInstance(void *c)
{
    BlocksTraced *one = c;
    BlocksTraceCall call;
    blocks_trace_begin(one, CALL_FreeInstance, &call);
    blocks_trace_given(&call);
    (*(void (**)(void *))&one->originals[CALL_FreeInstance])(one->component);
    blocks_trace_returned(&call);
    blocks_trace_end(&call, 0);
}

#define SHIM_ENTRY(called, ...) {FULL_NAME(called), CALL_##called, (void (*)(void))shim_##called},
#define OTHER_ENTRY(called, ...) {FULL_NAME(called), CALL_##called, (void (*)(void))shim_FreeInstance},
static const BlocksTraceShim shims[] = {OTHERS(OTHER_ENTRY) CALLS(SHIM_ENTRY){NULL, 0, NULL}};
_Static_assert((int)CALLS_END <= (int)TRACE_FUNCTIONS, "an instance has too little room for its functions");

#endif
