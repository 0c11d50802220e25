/* The shims of FMI 3: see trace.h. */
#include "trace.h"
#include "calls3.h"

enum {
    CALL_START = CALL_EnterInitializationMode, CALL_SAVE = CALL_GetFMUState, CALL_LOAD = CALL_DeserializeFMUState,
    CALL_RESTORE = CALL_SetFMUState, CALL_FREE = CALL_FreeFMUState
};
#include "trace_calls.h"

const BlocksTraceShim *blocks_trace_shims3(void) { return shims; }
