/* The master algorithm of co-simulation over addresses of functions: docs/cosimulation.md says what it means. */
#ifndef BLOCKS_MASTER_H
#define BLOCKS_MASTER_H

#include "fmu_types.h"
#include "runtime.h"

enum { MASTER_CONSTANT = 0, MASTER_INPUT, MASTER_ELEMENT };       /* where an input comes from */
enum { MASTER_NATIVE = 1, MASTER_FMI2 = 2, MASTER_FMI3 = 3 };     /* what a unit is */
enum { MASTER_HOLD = 0, MASTER_DERIVATIVES, MASTER_INTERMEDIATE, MASTER_MEAN, MASTER_EXACT }; /* how courses reach it */
enum { MASTER_OF_STEP = 0, MASTER_OF_CONTROL };                  /* whose saved state: that of iterations and instants */

/* Why the loop came back. */
enum { MASTER_DONE = 0, MASTER_PAUSED, MASTER_FAILED };

/* What failed. */
enum {
    MASTER_FINE = 0,
    MASTER_STATUS,      /* a function of an FMU gave `status`: `unit`, `function` */
    MASTER_STUCK,       /* a discarded step that did not go on */
    MASTER_SIMULATION,  /* a native unit: see its own failure */
    MASTER_NOT_FINITE,  /* of a recorded or measured column: `unit` is its number */
    MASTER_NO_CONVERGENCE,
    MASTER_UNSOLVED,    /* an algebraic loop: `unit` is its number */
    MASTER_ENDLESS,     /* instants of units: `acting` */
    MASTER_ENDLESS_STOPS,
    MASTER_ENDLESS_UPDATES,
    MASTER_TOO_SMALL,
    MASTER_MEMORY,
    MASTER_TOO_EARLY,   /* an FMU stopped before its step's end and was not allowed to */
    MASTER_PENDING,     /* a step of FMI 2 that did not get done for `patience` s */
    MASTER_NOT_BEGUN    /* a native unit could not be started */
};

/* Functions of a unit, by their names: those of FMI, then those of the runtime for native units. */
enum {
    CALL_DoStep = 0, CALL_GetFMUState, CALL_SetFMUState, CALL_FreeFMUState, CALL_SetRealInputDerivatives, CALL_GetRealStatus,
    CALL_GetBooleanStatus, CALL_EnterEventMode, CALL_UpdateDiscreteStates, CALL_EnterStepMode, CALL_GetStatus,
    CALL_ExitInitializationMode, CALLS_OF_FMI,
    CALL_proceed = CALLS_OF_FMI, CALL_settle, CALL_is_due, CALL_logged, CALL_reload, CALL_next, CALL_COUNT
};

/* Where an input, or what is recorded, comes from. */
typedef struct {
    int32_t row, place;
    double constant;
} MasterLink;

/* Variables that one call moves. */
typedef struct {
    int32_t type, is_moving, number; /* number: of the call, by which a failure names it */
    int64_t nreferences, nvalues;
    const uint32_t *references;
    void *buffer;
    const int32_t *places; /* of a set: among the unit's inputs; of a get: elements, -1: nobody asks */
    const double *scales;  /* what 1 of the FMU is in SI; null: all 1 */
    const double *offsets; /* what 0 of the FMU is in SI; null: all 0 */
    void *move;
} MasterGroup;

/* Who makes a unit sets what does not change; a native one has its `component`, `track` and `stand` before master_open. The
   memory for the rest is that of master_open. */
typedef struct {
    int32_t kind, way, ninputs, noutputs, nsets, ngets, nfed, has_feed, has_instants, acts, can_save, has_moving, is_unsure;
    /* acts: something may happen in it at an instant; has_instants: of itself, or because of a jump of what it takes */
    void *component;                  /* of an FMU, or a BlocksSim */
    int (*stand)(void *component);    /* native: start it with the inputs in `track` */
    void *calls[CALL_COUNT];
    const MasterLink *links;          /* (ninputs) */
    const uint8_t *moves;             /* (ninputs) whether it is extrapolated */
    const int32_t *outputs;           /* (noutputs) elements; of a native unit in the order of its logged signals */
    MasterGroup *sets, *gets, *fed;   /* of an FMU; fed: inputs that its outputs depend on at once */
    double *inputs, *courses;         /* (ninputs); (ninputs, 3) value and derivatives at the begin of the step */
    double *terms;                    /* native: (4, ninputs) for polynomials */
    double *track;                    /* native: the row of its inputs */
    double *given;                    /* native: (noutputs) */
    double *known;                    /* (ninputs) what an FMU knows in event mode of those that are held */
    BlocksPolynomials polynomials;
    BlocksGrid grid;
    int64_t next;
    /* where it stands; its next point; where the step under way began; where it came to; where a state was kept */
    double t, next_t, begin, reached, kept_t;
    void *saved[2];                   /* states: MASTER_OF_STEP, MASTER_OF_CONTROL; native: room for them */
    int64_t saved_bytes;              /* of that room */
    double *counted;                  /* native: when crossings fired last (ncauses), as the step began; sides (ns) */
    int64_t crossed_first, crossed_count;
    double uncounted; /* when a crossing was found last that was none by the inputs as they were */
    double over_t; /* when it ended the run, where is_over */
    double refused_t; /* when it refused derivatives of order `takes` + 1, where refused is their status */
    int32_t is_over, takes, refused; /* takes: the highest order of derivatives that it has not refused */
    int32_t is_bent, reads_inputs; /* is_bent: its outputs go on otherwise from now on */
    int32_t is_rigid, waits; /* is_rigid: it stops at the points of its grid alone; waits: its courses are kept until then */
    /* Native, without FMUs inside: which memory an instant must change to be seen outside, by rate, crossing, event and
       history; by output the places in (x, d, s, inputs, histories) that it follows, from follow_first on; these as they
       stood when it arrived at a communication point, and which have changed since. Null: all is seen, and all follow. */
    const uint8_t *seen;
    const int32_t *follow_first, *follows;
    double *stood;
    int64_t *passed; /* (nhistories) breaks that had been passed */
    uint8_t *moved;
    int32_t remembers_inputs;
    double step;
    double late_t; /* when a jump first reached it between its points; NaN: none has */
    int32_t begins;                   /* an FMU is in event mode since its initialization, until its first instant */
    int32_t has_saved, is_due, warnings, warned; /* calls that gave a warning; which the first was, and at which time */
    double warned_t;
} MasterUnit;

/* A unit whose inputs and outputs are reals that lie side by side: its functions read and write the elements themselves. */
typedef struct {
    void *component, *set, *step, *get;
    const uint32_t *set_references, *get_references;
    size_t nset, nget;
    double *set_values, *get_values;
    int32_t kind;
} MasterQuick;

/* Elements of a unit that are known once others are: its inputs are set, its outputs are got. */
typedef struct {
    int32_t unit, is_plain, loop, nelements; /* is_plain: nothing is to be set; loop: -1, or the loop that it belongs to */
    int32_t nsets;
    const int32_t *elements;                 /* their places among all */
    MasterGroup *sets;                       /* of an FMU: what they depend on at once */
} MasterStage;

typedef struct {
    int32_t n, first_stage, nstages;
    const int32_t *elements;
    double *work; /* (n (n + 5)) */
} MasterLoop;

/* aside: a point that a closer one has replaced; it comes back once a point lies far enough from it. */
typedef struct {
    int32_t n, has_aside;
    double t[3], y[3], aside_t, aside_y;
} MasterPast;

/* An element of a circle of units that is watched: see growth.py. */
typedef struct {
    double size, begin, most; /* the largest that it was; what it was as its growth began, and its largest step */
    int64_t points, last;     /* how many, and which was missed last */
    int32_t misses, element, circle;
} MasterGrowth;

typedef struct {
    int32_t unit, first_reader; /* the place of the first unit that reads it; those of the next element follow */
    int32_t is_held, jumps;     /* whether it changes at instants only, and whether they may change it */
} MasterElement;

/* The first fields, up to least_step, are those of master_policy.py; `is_doubled` as if all units could go back. */
typedef struct {
    int32_t order, iterations, is_sequential, is_controlled, is_doubled;
    int64_t iterated_steps;
    double noise, tolerance, ratio, span, first_step, least_step;
    int32_t nunits, nelements, nstages, nloops, ncolumns, nmeasured, is_uniform, ntracks, nexchanged, has_instants, needs_past, has_rigid;
    MasterUnit *units;
    MasterStage *stages;
    MasterLoop *loops;
    const int32_t *ordered, *at_instants;
    double *y, *left_y, *kept_y, *guess, *ends; /* ends: before what happened at the end of the last step */
    MasterPast *past, *old, *kept_past;
    const MasterElement *elements; /* one more than there are */
    const int32_t *readers;        /* units */
    const MasterLink *columns, *measured;
    const int32_t *exchanged;
    const BlocksTrack *tracks;
    double *base, *aim, *begin, *finish; /* (nu) the segment of the diagram's inputs */
    double t, broken, end, start, h;
    int32_t ending; /* the element that ends the run at a communication point where it is true; -1: none */
    BlocksGrid every;
    int64_t row, fresh; /* fresh: so many steps since something jumped */
    int32_t has_jumps; /* whether a jump of what is recorded stands as two rows, wherever it is */
    int32_t is_silent; /* nothing is recorded */
    int32_t is_starting, has_started;
    int32_t is_foreseen; /* outputs are by inputs that were set, and what these cause is yet to happen */
    int32_t has_inverse;
    double inverse_h;
    double *inverse, *z, *f, *dz, *df, *work; /* (nexchanged^2) and (nexchanged) */
    BlocksList rows, points;                  /* rows: (1 + ncolumns); points: t, kind, values (nmeasured) */
    double *left_row;
    int64_t has_unsure, depth, crowd; /* depth: how many instants have cut the step under way short */
    int64_t small, worst; /* short steps in a row where steps are controlled, and the element that asks for them */
    double slice, soft, most_bytes, patience; /* soft: a pause after the step that reaches it; patience: s; how long a step of FMI 2 may stay pending */
    int64_t steps, rejected, instants, iterated;
    int32_t failure, unit, function, status;
    double value, failed_t;
    uint8_t *due, *acting, *changed, *renewed; /* renewed: (nelements) those that take a new course from now on */
    MasterQuick *quick; /* (nunits); null: not all units are so */
    int32_t nwatched;
    int32_t keeps; /* keeps: the states of units were saved before the step under way */
    MasterGrowth *watched;
    int32_t *grown;  /* of each circle: the element that has grown without bound; -1: none */
    double *grown_t; /* and when */
    void *owned;     /* memory of master_open */
} Master;

/* Make its own copies of all tables, and the memory that it computes with: 1 where there is none. */
BLOCKS_API int master_open(Master *m);
BLOCKS_API void master_close(Master *m);
void master_connect(Master *m);                                   /* once the functions of all groups are known */
int master_foresee(Master *m);                                    /* outputs by the inputs as they are; nothing happens */
int master_has_ended(const Master *m);
int master_values(Master *m, const MasterLink *links, int n, double *out); /* 1: one is not finite */
void master_walk(BlocksWalk *w, Master *m);                       /* all that changes in a run, but for the states of FMUs */
/* The exchange of outputs and inputs, the end of the initialization and the instant at the start. FMUs are in initialization
   mode, with their parameters. */
BLOCKS_API int master_start(Master *m);
BLOCKS_API int master_run(Master *m, double stop);                /* on to `stop` */
BLOCKS_API int master_changed(Master *m, int is_input);           /* an input or a parameter was set from outside, at the time where it stands */
extern BLOCKS_API const int64_t master_sizes[]; /* of the structures above, in their order */
BLOCKS_API void master_free(double *data);                        /* of rows or points, which C has allocated */
BLOCKS_API void master_intermediate(void *environment, double t, int set_requested, int get_allowed, int finished,
                                    int can_return, void *early, double *early_time);

#endif
