/* Traces of the calls of FMUs: a shim stands in front of each function of an instance, calls it, and writes what was
   given, what came back, the status and the wall time as a line of text or of JSON; and it counts for a profile.

   The instance that callers get is a BlocksTraced: shims know by it whose call it is, and nothing is looked up. Lines go
   to a file of bounded size, of which the first and the last bytes are kept, or to a function. The file is in order and
   complete at any time: a call is written before it is made, with "..." for its outcome. */
#ifndef BLOCKS_TRACE_H
#define BLOCKS_TRACE_H

#include <stddef.h>
#include <stdint.h>

#if defined(BLOCKS_INSIDE)
#define TRACE_API
#elif defined(_WIN32)
#define TRACE_API __declspec(dllexport)
#else
#define TRACE_API __attribute__((visibility("default")))
#endif

enum { FIRST_FUNCTION = 1, TRACE_FUNCTIONS = 96, TRACE_STATES = 16, TRACE_GIVEN = 4 };

/* What an array holds, by the types of the standard; those of FMI 2 and of FMI 3. */
enum {
    KIND_fmi2Real, KIND_fmi3Float64 = KIND_fmi2Real, KIND_fmi3Float32, KIND_fmi3Int8, KIND_fmi3UInt8, KIND_fmi3Int16,
    KIND_fmi3UInt16, KIND_fmi3Int32, KIND_fmi2Integer = KIND_fmi3Int32, KIND_fmi2Status = KIND_fmi3Int32,
    KIND_fmi2StatusKind = KIND_fmi3Int32, KIND_fmi3DependencyKind = KIND_fmi3Int32, KIND_fmi3UInt32, KIND_fmi3Int64,
    KIND_fmi3UInt64, KIND_fmi3Boolean, KIND_fmi2Boolean, KIND_fmi2ValueReference,
    KIND_fmi3ValueReference = KIND_fmi2ValueReference, KIND_size_t, KIND_fmi2Byte, KIND_fmi3Byte = KIND_fmi2Byte,
    KIND_fmi2EventInfo, KIND_text
};

/* A variable. call: the first letter of the type in FMI 2, where references are of a type; else 0. */
typedef struct {
    uint32_t reference;
    int32_t call, size;
    const char *name;
} BlocksTraceName;

typedef struct BlocksTrace BlocksTrace;

typedef struct BlocksTraced BlocksTraced;

/* A call under way. */
typedef struct {
    BlocksTraced *one;
    int64_t n, entered, begun, ns;
    int32_t function, depth, is_out, is_json, nitems, is_early;
    double x[TRACE_GIVEN], last; /* its real arguments; the time that it came to, where it says so */
    void *state, **state_out;
    const uint32_t *references;
    size_t nreferences;
} BlocksTraceCall;

/* An instance. names: ordered by call and reference. states: names of the continuous states. */
struct BlocksTraced {
    BlocksTrace *trace;
    BlocksTraced *next;
    void *component;
    const char *path;
    const BlocksTraceName *names;
    const char *const *states;
    int64_t nnames, nstates;
    double t; /* where it stands, as far as its calls say */
    void *saved[TRACE_STATES]; /* states that it gave, and their times */
    double saved_t[TRACE_STATES];
    const char *functions[TRACE_FUNCTIONS]; /* what follows is by function */
    void *originals[TRACE_FUNCTIONS];
    int64_t calls[TRACE_FUNCTIONS], ns[TRACE_FUNCTIONS]; /* ns: without the calls within */
    BlocksTraceCall making;
};

/* path: of the file; null: lines go to `sink`, or there are only counts. head, tail: bytes that are kept at least, of the
   begin and of the end. Null where the file cannot be opened: errno. */
TRACE_API BlocksTrace *blocks_trace_new(const char *path, int is_json, int64_t head, int64_t tail,
                                        void (*sink)(void *, const char *), void *where);
TRACE_API int blocks_trace_close(BlocksTrace *trace); /* the file; the errno of what could not be written, else 0 */
TRACE_API void blocks_trace_free(BlocksTrace *trace);

/* An instance that is yet to be made. The arrays must stay as long as the trace. */
TRACE_API BlocksTraced *blocks_trace_instance(BlocksTrace *trace, const char *path, const BlocksTraceName *names, int64_t n,
                                              const char *const *states, int64_t nstates);

/* The shim of a function, to be called with `one` as the instance; null: there is none of that name. */
TRACE_API void *blocks_trace_shim(BlocksTraced *one, const char *function, void *original);

/* A message of the FMU, which belongs to the call under way. */
TRACE_API void blocks_trace_message(BlocksTraced *one, int status, const char *category, const char *text);

/* Called around the function that makes the instance. given: names and values of its arguments, n pairs. */
TRACE_API void blocks_trace_making(BlocksTraced *one, const char *function, const char *const *given, int n);
TRACE_API void blocks_trace_made(BlocksTraced *one, void *component);

/* How often function k was called, and for how long; its name is null where there is no such function. */
TRACE_API int64_t blocks_trace_profile(const BlocksTraced *one, int k, const char **name, int64_t *ns);

/* --- a call, as shims write it ---- */

void blocks_trace_begin(BlocksTraced *one, int function, BlocksTraceCall *call);
void blocks_trace_given(BlocksTraceCall *call);    /* all arguments are written: now it is called */
void blocks_trace_returned(BlocksTraceCall *call); /* it came back: what it gives follows */
void blocks_trace_end(BlocksTraceCall *call, int status);
void blocks_trace_value(BlocksTraceCall *call, const char *name, int kind, const void *values, size_t n);
void blocks_trace_state(BlocksTraceCall *call, const void *state);

/* Shims by name, of one version of the standard. */
typedef struct {
    const char *name;
    int number;
    void (*shim)(void);
} BlocksTraceShim;
const BlocksTraceShim *blocks_trace_shims2(void);
const BlocksTraceShim *blocks_trace_shims3(void);

#endif
