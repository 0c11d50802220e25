/* FMUs for Model Exchange in a run: what a model asks them, and what the runtime tells them; see docs/fmu.md, "FMUs in
   diagrams". Python makes the instances, fills these tables with their addresses, and takes them to initialization mode;
   from then on nothing of Python is called. */
#ifndef BLOCKS_FMU_BRIDGE_H
#define BLOCKS_FMU_BRIDGE_H

#include "fmu_types.h"
#include "runtime.h"

enum { BLOCKS_INITIALIZES = 0, BLOCKS_CONTINUOUS, BLOCKS_AT_EVENT };
enum { BLOCKS_STATE = 0, BLOCKS_DERIVATIVE, BLOCKS_INDICATOR, BLOCKS_VALUE, BLOCKS_EVENT_TIME, BLOCKS_GIVEN, BLOCKS_NUMBER,
       BLOCKS_PARTIAL };

/* The function that failed, by its place in the list of Python. */
enum {
    BLOCKS_SET_TIME = 0, BLOCKS_SET_STATES, BLOCKS_GET_STATES, BLOCKS_GET_DERIVATIVES, BLOCKS_GET_INDICATORS,
    BLOCKS_COMPLETED, BLOCKS_ENTER_EVENT, BLOCKS_UPDATE, BLOCKS_ENTER_CONTINUOUS, BLOCKS_EXIT_INITIALIZATION,
    BLOCKS_CALLS, BLOCKS_GET = 100, BLOCKS_SET = 200
};

/* What of it is no failure of a call. */
enum { BLOCKS_ENDS = 1000, BLOCKS_NO_END_OF_UPDATES, BLOCKS_BAD_STATE, BLOCKS_REFUSES };

typedef struct {
    uint32_t reference;
    int32_t type, first, size, held;
} BlocksVariable;

typedef struct {
    int32_t kind, index, by; /* by: of a partial derivative of item `index`, the input */
    double scale, offset;    /* in SI it is scale * number of the FMU + offset */
} BlocksItem;

/* Some results. states, inputs: pairs of a place among the values that are given and one of the FMU. variables: those
   that are read, whose elements stand one after the other. */
typedef struct {
    int32_t nstates, ninputs, nvariables, nitems, kinds; /* kinds: bits */
    const int *states, *inputs;
    const BlocksVariable *variables;
    const BlocksItem *items;
} BlocksRequest;

typedef struct {
    void *component;
    int32_t fmi, nx, nz, nu, nvariables, ntunables;
    int32_t ncrossings, event, completes;
    int32_t waits, late; /* for the turn of its time event; it came before something that its inputs depend on */
    int32_t mode, asks, due, stale; /* stale: the FMU has not the states that x says */
    int32_t has_rates;              /* its derivatives were asked for since something was set */
    int32_t over;                   /* it ended the run, at t */
    int32_t nwatched, looks;        /* outputs that should be functions of the states, and how often that was looked at */
    int32_t status, call, reference; /* of what failed first */
    int64_t epoch;
    double t, next_event, due_time;
    double *x, *factors, *origins;                /* (nx) states in SI: factor * number of the FMU + origin */
    double *u, *had, *seen, *given;               /* (nu) inputs, then tunable parameters */
    double *raw, *values;                         /* scratch */
    const double *scales, *offsets;               /* (nu) */
    const BlocksVariable *variables;
    const int32_t *tunables, *crossings, *states; /* places in p, crossings, places in the model's x */
    const BlocksVariable *watched;
    double *followed;                             /* (nwatched) as they were when the last step was completed */
    int32_t *lags;                                /* (nwatched) how often one changed only by that */
    void *calls[BLOCKS_CALLS];
    void *get[BLOCKS_TYPES], *set[BLOCKS_TYPES];
} BlocksForeign;

typedef struct {
    int32_t n;
    BlocksForeign *units;
    double *taken; /* by all of them, as the program `foreign_inputs` gives it */
} BlocksForeigns;

/* Results in SI; NaN where the FMU discards what was set, or has failed before. */
void blocks_foreign_values(BlocksForeign *f, const BlocksRequest *request, double t, const double *given, double *made);

extern const BlocksHooks blocks_hooks;

#endif
