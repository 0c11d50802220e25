/* The shims of FMI 2: see trace.h. */
#include "trace.h"
#include "calls2.h"

enum {
    CALL_START = CALL_SetupExperiment, CALL_SAVE = CALL_GetFMUstate, CALL_LOAD = CALL_DeSerializeFMUstate,
    CALL_RESTORE = CALL_SetFMUstate, CALL_FREE = CALL_FreeFMUstate
};
#include "trace_calls.h"

const BlocksTraceShim *blocks_trace_shims2(void) { return shims; }
