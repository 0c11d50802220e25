/* A run of a model: its memory, its clocks, what it records. Its meaning: docs/semantics.md. */
#ifndef BLOCKS_RUNTIME_H
#define BLOCKS_RUNTIME_H

#include <float.h>
#include <stddef.h>

#include "model.h"

/* Into functions of any optimization. */
#if defined(__GNUC__)
#define BLOCKS_INLINE static inline __attribute__((always_inline))
#else
#define BLOCKS_INLINE static inline
#endif

#define BLOCKS_MOST_STAGES 7
#define BLOCKS_MOST_DEGREE 4

/* Why a run stands. */
enum { BLOCKS_DONE = 0, BLOCKS_PAUSED = 1, BLOCKS_FAILED = 2, BLOCKS_NO_MEMORY = 3 };
#define BLOCKS_REFUSED (-2) /* a step: it is to be tried again, shorter */

/* What failed. `culprit` is an index: of a state, a cause, a place in d, a stepper. */
enum {
    BLOCKS_FINE = 0,
    BLOCKS_NOT_FINITE,    /* of a recorded, measured or remembered signal, a derivative, a discrete value */
    BLOCKS_BLOWN_UP,      /* a fixed step */
    BLOCKS_TOO_SMALL,     /* an adaptive step */
    BLOCKS_NOT_A_NUMBER,  /* a crossing */
    BLOCKS_ENDLESS,       /* events at one instant */
    BLOCKS_NOT_AHEAD,     /* an event time */
    BLOCKS_UNSOLVED,      /* an algebraic loop */
    BLOCKS_NOT_WHOLE,     /* an integer or an enumeration */
    BLOCKS_ZENO,
    BLOCKS_CHANGES_ALWAYS, /* a projection */
    BLOCKS_STEPPER,
    BLOCKS_FOREIGN,
    BLOCKS_NOT_CONVERGED /* an implicit step */
};

typedef struct BlocksSim BlocksSim;
typedef struct BlocksJacobian BlocksJacobian;
typedef struct BlocksImplicit BlocksImplicit;
typedef struct BlocksModel BlocksModel;

/* What the runtime tells units whose states it integrates and that hide others: see fmu_bridge.c. Each returns 0; what
   fails -BLOCKS_FAILED where others are counts or flags. */
typedef struct {
    int (*initialized)(BlocksSim *, const double *inputs);
    int (*started)(BlocksSim *);
    int (*asked)(BlocksSim *, const uint8_t *firing, const uint8_t *changed, int first_event); /* whether any has an event */
    /* Those that wait for their turn keep the sides of their crossings, in s->late; whether any changes. */
    int (*hold)(BlocksSim *);
    int (*events)(BlocksSim *);
    /* Those with a time event at this instant wait for their turn. due: what of n event times is left for others, whose
       number is returned; waiting: how many wait. */
    int (*postponed)(BlocksSim *, int32_t *due, int n, int *waiting);
    int (*waits)(const BlocksSim *, int unit);
    /* Ends the wait of a unit: its event time, or -1 where the run begins. late: rates, and -1 - units, which it comes
       before though its inputs depend on them. */
    int (*turn)(BlocksSim *, int unit, const int32_t *late, int nlate);
    int (*completed)(BlocksSim *); /* whether any asks for an event */
    int64_t (*epoch)(const BlocksSim *); /* how many events there were */
} BlocksHooks;

/* The looks of a model, and of each what was not seen: why, and since when. */
enum { BLOCKS_CROSSINGS, BLOCKS_MEASURED, BLOCKS_REMEMBERED, BLOCKS_LOGGED, BLOCKS_PROJECTIONS, BLOCKS_LOOKS };
enum { BLOCKS_LEFT_OUT = 1, BLOCKS_BETWEEN_ROWS }; /* as too many; a grid has less than two for a turn */
typedef struct {
    double t;     /* NAN: all was seen */
    int32_t what; /* a phase; -1 - a value */
    int32_t rows; /* of a recording: BLOCKS_LEFT_OUT or BLOCKS_BETWEEN_ROWS */
} BlocksUnseen;

/* Crossings of what a loop solves for: corners. Programs of given unknowns read these
   from z; rounding: how far it may move each of them there. start_solved gives the unknowns behind all else. guessed: places
   in d that are guessed at the start, as sides are. */
typedef struct {
    BlocksProgram crossings, rounding, start_given, start_solved;
    void (*resets)(const BlocksMemory *, double, const double *, int, double *);
    const int32_t *numbers, *guessed;
    int32_t n, ninner, nguessed; /* ninner: the first ones, which a loop finds with its solution */
} BlocksCorners;

struct BlocksModel {
    int32_t nx, nd, ns, np, nu, nh, nz, nrates, nq, nv, nw, nevents, nlogged, nmeasured, nprojections;
    int32_t moving_sides, stages, degree, order;
    const BlocksLook *looks; /* (BLOCKS_LOOKS) */
    const double *dense; /* (stages, degree): x(theta) = x0 + h sum_i k_i sum_j dense[i][j] theta^(j+1) */
    void (*prepare)(BlocksMemory *);
    void (*refresh)(BlocksMemory *);
    BlocksProgram rates, crossings, event_times, projections, solutions, logged, measured, start;
    void (*resets)(const BlocksMemory *, double, const double *, int, double *);
    void (*anew)(const BlocksMemory *, double, const double *, int, double *);
    void (*stepper_inputs)(const BlocksMemory *, double, const double *, int, double *);
    void (*outputs)(const BlocksMemory *, double, const double *, int, int, const uint8_t *, double *);
    void (*nexts)(const BlocksMemory *, double, const double *, const uint8_t *, double *);
    double (*trial)(BlocksSim *, double t, const double *x, double h, double *x1, int is_judged);
    int (*run)(BlocksSim *, double target);
    int (*plain_instant)(BlocksSim *); /* see instants.h */
    const BlocksHooks *hooks; /* null: there are no such units */
    BlocksProgram foreign_inputs;
    int32_t ntaken; /* how many values it gives */
    const BlocksCorners *corners; /* null: there are none */
    const BlocksImplicit *implicit; /* of a stiff method; null: none. See stiff.h */
    const BlocksModel *stiff;       /* the same by radau, for runs that are found to be stiff; null: they are not asked */
};

/* Equally spaced times (start + k step) / unit. */
typedef struct {
    int64_t start, step, unit;
    int32_t is_plain; /* whether all that is divided fits into a double */
    int32_t is_given;
} BlocksGrid;

typedef struct {
    const double *t, *u; /* (n), (n, size) */
    int64_t n;
    int32_t size, linear;
} BlocksTrack;

/* A crossing or an event time: what it resets, and how it fires. */
typedef struct {
    int32_t direction; /* 0: an event time; 1: up, 2: down, 3: both */
    int32_t nresets, first_reset;
    int32_t condition; /* the side that says whether it is on; -1: none */
    int32_t told;      /* whether it is listed among the events */
    int32_t foreign;   /* whether it is an FMU's */
} BlocksCause;

typedef struct {
    int32_t cause, number, row, place; /* row 0: x, 1: d */
} BlocksReset;

/* A cause that waits at an instant while others change or wait themselves: n places in waits_for, from `first` on. Numbers
   of causes; algebraic loops and what enters copies stand behind them. */
typedef struct {
    int32_t cause, first, n;
} BlocksWait;

/* A cause that resets memory that another one reads: it waits too if that one must wait and fires. */
typedef struct {
    int32_t writer, reader;
} BlocksBeside;

typedef struct {
    int32_t row, place, condition;
} BlocksProjection;

typedef struct {
    int64_t period, offset;
} BlocksRate;

typedef struct {
    int32_t slot, rate, condition;
} BlocksSlot;

/* One stage of a clique of rates: slots [first_slot, first_slot + nslots) and steppers likewise. Or the time event of a
   unit, if that is not -1: then in place of steppers stands what it comes before though its inputs depend on it. */
typedef struct {
    int32_t first_slot, nslots, first_stepper, nsteppers, unit;
} BlocksStage;

typedef struct {
    int32_t first_stage, nstages;
    const uint8_t *rates; /* (nrates) */
} BlocksClique;

typedef struct {
    int32_t rate, condition, ninputs, noutputs, first_output; /* outputs: places in stepper_slots */
} BlocksStepper;

typedef struct {
    int32_t side, time, nresets, first_reset; /* resets: places in anew_places */
    int32_t nevents, first_event;             /* events inside: places in inside_events */
    int32_t nsteppers, first_stepper;         /* steppers that begin anew: places in anew_steppers */
    int32_t is_anew;
} BlocksEnabled;

typedef struct {
    double delay, before;         /* where they are no parameters */
    int32_t delay_at, before_at, echoes; /* at: places in p; -1: none */
} BlocksHistory;

/* What is measured of e = of - against in a window: `of` and `against` are two values of `measured`. */
enum {
    BLOCKS_SQUARE, BLOCKS_ABSOLUTE, BLOCKS_TIMED, BLOCKS_HARMONIC, /* integrals */
    BLOCKS_PEAK, BLOCKS_VARIATION, BLOCKS_OVERSHOOT, BLOCKS_SETTLING, BLOCKS_RISE, BLOCKS_SIGNS, BLOCKS_END
};
typedef struct {
    double low, high, omega;
    int32_t kind;
} BlocksMeasure;

/* A program in Python: takes inputs, gives outputs; returns 0, or 1 where it failed. what: 0 a step, 1 begin anew. */
typedef int (*BlocksCallback)(int stepper, int what, double t, const double *inputs, double *outputs);

/* What describes a run and does not change. Every pointer belongs to the caller and outlives the run. */
typedef struct {
    const BlocksModel *model;
    int32_t ncauses, nresets, nwaits, nbeside, ncliques, nnexts, nsteppers, nenabled, nintegers, ntracks, nmeasures;
    int64_t base_numerator, base_denominator;
    const double *atol; /* (nx) model order */
    double rtol, plain_atol, longest, end, start; /* longest: step, without delays */
    BlocksGrid fixed, every;
    const BlocksCause *causes;
    const BlocksReset *resets; /* in the order in which they are applied */
    const BlocksWait *waits;   /* each after those of what it waits for */
    const int32_t *waits_for;
    const BlocksBeside *beside;
    const int32_t *order;      /* causes in the order in which they are listed */
    const BlocksRate *rates;
    const BlocksClique *cliques;
    const BlocksStage *stages;
    const BlocksSlot *slots, *nexts;
    const int32_t *stage_steppers;
    const BlocksStepper *steppers;
    const int32_t *stepper_slots;
    const BlocksEnabled *enabled;
    const int32_t *anew_places; /* (row, place) */
    const int32_t *inside_events, *anew_steppers;
    const BlocksProjection *projections;
    const BlocksHistory *histories;
    const int32_t *integers;      /* (nd): 0 a real, 1 an int, 2 + first member: an enumeration; or null */
    const int32_t *member_counts; /* (nd) */
    const double *members;
    const BlocksTrack *tracks;
    const BlocksMeasure *measures;
    int32_t has_windows, has_paths;
    BlocksCallback callback;
    double most_bytes; /* of what is recorded */
    int32_t is_silent; /* whether nothing is recorded */
    int32_t has_jumps; /* whether a jump of what is recorded stands as two rows, wherever it is */
    int32_t ends;      /* the crossing that ends the run after an instant at which it is on its side; -1: none */
} BlocksSetup;

/* Inputs that change as polynomials of t - t0: (nu) values, then derivatives of order 1, 2 and 3. */
typedef struct {
    double t0;
    const double *terms;
} BlocksPolynomials;

/* Rows of doubles in memory that grows by chunks, which keep their place. */
typedef struct {
    double **chunks;
    int64_t *counts; /* rows that each chunk has place for */
    int64_t nchunks, most_chunks, capacity, columns;
    double *next, *end; /* where the next row stands, and the end of the place there: first in memory of the caller */
    double bytes;
} BlocksRows;

/* Doubles in one piece, which may move when it grows. */
typedef struct {
    double *data;
    int64_t used, capacity;
} BlocksList;

/* A measure so far; see run/measures.py. */
typedef struct {
    double total, span, first, begin, target, last, low, high;
    BlocksList path; /* rows of 7: begin, length and `of` at the nodes of parts */
} BlocksMeasured;

enum { BLOCKS_COURSE = 2 }; /* the order of a break that is the end of an extrapolation by a master */

/* What histories remember; see docs/contract.md, "Delays". */
typedef struct {
    double *starts, *ends, *parts; /* parts: (known, 6, nh) */
    double *breaks;
    int32_t *orders;
    int64_t *passed; /* (nh) */
    int64_t known, broken;
    int32_t open, seen;
} BlocksPast;

/* An entry in the table of a memory: a row, or numbers. SAVED: a state of the run has it; FILED: files of states have it, under
   its name; RESET: it starts as `begin` in each run; HERE: `place` points to the numbers, else to the address of a row. */
enum { BLOCKS_SAVED = 1, BLOCKS_FILED = 2, BLOCKS_RESET = 4, BLOCKS_HERE = 8 };
typedef struct {
    const char *name; /* null: Python does not use it */
    void *place;
    const int64_t *count; /* of a row that grows: how many times n elements it has; else null */
    int64_t n;
    double begin;
    int32_t size, kind, flags; /* kind: the letter of the type in numpy */
    int64_t room;              /* of a row that grows: for which count there is memory */
} BlocksEntry;
#define BLOCKS_ENTRIES 88

/* Bytes that memory is copied to, or from (writes). If `at` is null, they are only counted. */
typedef struct {
    uint8_t *at, *end;
    int32_t writes, failed;
    size_t count;
} BlocksWalk;

/* The part of a run that Python reads and writes; x, d, s and the other rows are in `memory`. */
struct BlocksSim {
    const BlocksSetup *setup;
    const BlocksModel *model;
    BlocksMemory memory;
    BlocksEntry entries[BLOCKS_ENTRIES]; /* see `list_memory`; rows from nsteady on grow */
    int32_t nentries, nsteady;
    double t;          /* the first of the numbers that are saved */
    int64_t count;     /* t in base steps, where exact is 1 */
    int32_t has_before;
    int32_t exact;     /* 1: t is count base steps; 2: it is the stop; 0: neither */
    int32_t has_first; /* whether stage 0 holds the rates at t */
    double h, error;   /* proposed step (0: none), last error */
    int64_t fixed;     /* number of the next point of the fixed-step grid */
    double broken;     /* the last input breakpoint passed */
    double longest;    /* step */
    double scale;      /* of times: the largest that others are computed from, whose rounding they carry along near 0 */
    int32_t outstanding, changed;
    int32_t crossing; /* whether a side has changed in the last step; 2: and projections have moved its end since */
    int32_t moving;    /* whether inputs or histories change with time now */
    int32_t is_constant;
    double located_t, sides_t, touched_t;
    int64_t steps, rejected, evaluations, instants;
    int64_t crossed_first, crossed_count;
    double paced;        /* when the steps were looked at last, for chattering */
    int32_t chatters;    /* how many looks in a row have found it */
    int32_t hits, calm;  /* of runs that are asked whether they are stiff: steps that say so, and those since that do not */
    double stiff_from;   /* when it was found; NaN: not yet */
    double later;        /* by how much the states stand after an instant that crossings have joined. The last of what is saved */
    int64_t row;         /* number of the next row of the recording grid */
    int32_t keeps_past;  /* set by a master, which goes back in time, and calls blocks_forget itself */
    int32_t recourses;   /* set by a master: inputs go on by another extrapolation, without a jump; 2: delays remember them */
    double sure_t;       /* set by a master: where a longer step found crossings, those of `sure` >= 0; they are no touches */
    int32_t has_left, chattered_before;
    double paced_before; /* paced and chatters before the last look */
    int32_t failure, culprit;
    double value;
    int64_t budget, budget_start; /* steps until the clock is looked at */
    double slice, deadline;       /* s; inf: no pauses, and no look at the clock; 0: a pause after each step */
    double soft;                  /* a pause after the step that reaches this time, for which none is cut; inf: none */
    int64_t *ticks;               /* (nrates) number of the next tick */
    int64_t *blamed;              /* (nx) rejected steps in which the error of a state was the largest */
    double *events, *own;         /* (nevents) */
    double *located, *sides;      /* (ns) distances beyond, and values at sides_t */
    double *sure;                 /* (ns) `located` as it was at sure_t */
    double *unprojected;          /* (nx + nd) the end of a step in which a side has changed, before projections */
    double *touched, *until;      /* (ns) values at touched_t of what touches 0 there, else NaN; up to where it does, of a step */
    double *fired;                /* (ns) when each crossing fired last; -inf: never */
    double *crossed;              /* ring of the last crossings */
    double *left;                 /* (nlogged) */
    double *last_row;             /* time and values of the last row; null: there is none */
    double next_row;              /* the time of row number `timed` of the recording grid; inf: there is none */
    int64_t timed;
    double *k[BLOCKS_MOST_STAGES]; /* (nx + ns + nmeasured) stages: rates, crossings, in the last what is measured; 0: at t */
    double *latched;               /* (ns) sides, in the order of the stages */
    double *before;                /* (nx + ns + nmeasured) stage 0 of the step before, where it is known: crossings alone count */
    double *x1;                    /* the end of a step */
    BlocksRows rows;
    BlocksList fired_events;  /* pairs: t, cause */
    BlocksList parts;         /* of the step or instant at hand, for measures: rows of low, high, t, h and values */
    BlocksMeasured *measured; /* (nmeasures) */
    double *known;            /* (1 + nmeasured) time and values of the last node */
    double *nodes;            /* (6, nmeasured) those values, others of a step that is one part, and those before an instant */
    BlocksPast past;
    double end; /* up to where the run is called for, as `t`, `count` and `exact` */
    int64_t end_count, target_count;
    int32_t end_exact, target_exact;
    int32_t goes_on; /* whether plain instants on the way there are taken without coming back to the caller */
    double refused, refused_error; /* the size and the error of a retaken step that was not accepted */
    int32_t flowed;  /* whether other steps were tried from where the run stands */
    int32_t weighed; /* whether the weights of the step's dense output are all known */
    int64_t between; /* rows that were recorded inside steps */
    BlocksUnseen unseen[BLOCKS_LOOKS];
    /* scratch */
    double *base, *aim, *begin, *finish; /* (nu) the segment of inputs */
    double *xs, *x2, *weights, *part_values, *part_phases, *first_values, *crossing_values, *reset_values, *d1, *backup, *foreseen, *row_values, *stage_values;
    double *slack;  /* (ns) of corners: by how much they may be off by rounding */
    double *corner; /* scratch of them */
    double looseness; /* times the slack: 2 in steps, so that a corner that is located there is beyond its slack at the instant */
    int32_t is_loose; /* whether any has a slack */
    double *distances, *projected_once, *projected_often, *z1;
    uint8_t *due, *firing, *changed_sides;
    uint8_t *late; /* causes that wait in this pass of an instant */
    size_t nlate;
    double *firing_time;
    int64_t *ticks_backup;
    void *arena;
    const BlocksPolynomials *polynomials; /* of inputs; null: they follow their tracks */
    void *implicit;      /* of a stiff method: its scratch */
    double *carried;     /* (ncarried) what it keeps from step to step; it counts while the rates at t do */
    int64_t ncarried;
    int32_t is_factored; /* whether its factors are those that `carried` speaks of */
};

#if defined(BLOCKS_INSIDE) /* a part of a library that shows other functions */
#define BLOCKS_API
#elif defined(_WIN32)
#define BLOCKS_API __declspec(dllexport)
#else
#define BLOCKS_API __attribute__((visibility("default")))
#endif

BLOCKS_API BlocksSim *blocks_new(const BlocksSetup *setup); /* null where there is no memory */
BLOCKS_API void blocks_free(BlocksSim *s);
BLOCKS_API void blocks_reset(BlocksSim *s);              /* as it was when it was new */
BLOCKS_API int blocks_begin(BlocksSim *s);               /* start values; the instant at the start is outstanding */
BLOCKS_API int blocks_start(BlocksSim *s);               /* the same, and that instant */
BLOCKS_API void blocks_take_model(BlocksSim *s);         /* that of the setup, which may have been replaced meanwhile */
BLOCKS_API int blocks_advance(BlocksSim *s, double end, int64_t count, int32_t exact);
BLOCKS_INLINE int blocks_has_ended(const BlocksSim *s) { return s->setup->ends >= 0 && s->memory.s[s->setup->ends] != 0.0; }
BLOCKS_API int blocks_settle(BlocksSim *s);              /* the instant that is outstanding, if any */
BLOCKS_API int blocks_proceed(BlocksSim *s, double end, int64_t count, int32_t exact); /* up to the next instant */
BLOCKS_API int blocks_is_due(const BlocksSim *s);        /* whether anything happens at an instant now */
BLOCKS_API double blocks_next(BlocksSim *s);             /* the time of the next tick or edge; inf: there is none */
BLOCKS_API void blocks_inputs(BlocksSim *s, double t);   /* the inputs that hold from t on */
/* Of a crossing, from here along the rates: how far from 0 its sign may be one of rounding, and whether it only touches 0.
   length: of a usual step. */
BLOCKS_API double blocks_rounding(BlocksSim *s, int j, const double *rates, double length);
BLOCKS_API int blocks_touches(BlocksSim *s, int j, const double *rates, double length);
BLOCKS_API int blocks_keep_left(BlocksSim *s);           /* before something is set: what was to be seen */
BLOCKS_API void blocks_reload(BlocksSim *s);             /* after memory was written from outside */
BLOCKS_API void blocks_rows(BlocksSim *s);               /* the same, where inputs and histories are set by hand */
BLOCKS_API int blocks_logged(BlocksSim *s, double *out); /* recorded signals now */
BLOCKS_API int blocks_record(BlocksSim *s);              /* a row now */
BLOCKS_API void blocks_take_rows(BlocksSim *s, const double *first, int64_t count, double *to, double *next, int64_t room);
BLOCKS_API void blocks_evaluate(BlocksSim *s, BlocksProgram program, double t, const double *x, double *out);
BLOCKS_API void blocks_beyond(const BlocksSim *s, double *crossings); /* less the slack by which corners leave their side */
BLOCKS_API void blocks_loosen(BlocksSim *s); /* that slack as it is now */
/* Let `read` see the memory as the crossings that changed inputs cause would leave it, where nothing else happens; then all is as
   before. stays: (ns) not 0 for crossings that do not fire. */
BLOCKS_API int blocks_foresee(BlocksSim *s, const double *stays, int (*read)(void *owner), void *owner);
BLOCKS_API void blocks_rates(BlocksSim *s, double t, const double *x, double *out);
BLOCKS_API extern const int64_t blocks_sizes[3];         /* of the structures, for those who mirror them */
BLOCKS_API int blocks_past_room(BlocksSim *s, int64_t parts, int64_t breaks); /* for this many more */
BLOCKS_API int blocks_list_room(BlocksList *list, int64_t more);

/* Forgets what no history sees any more from t on. */
BLOCKS_API void blocks_forget(BlocksSim *s, double t);

/* Give memory to the rows of a table that have none and do not grow; returns what is to be freed, null if there is none. */
void *blocks_allocate(const BlocksEntry *entries, int n);
/* Copy some bytes, the saved entries of a table, or those of a run. Of a run that keeps its past, the past is left out. */
void blocks_walk(BlocksWalk *w, void *place, size_t size);
void blocks_walk_entries(BlocksWalk *w, const BlocksEntry *entries, int n);
void blocks_walk_run(BlocksWalk *w, BlocksSim *s);

/* For the stepping loops. */
void blocks_outside(BlocksSim *s, double t);
int blocks_end_step(BlocksSim *s);
int blocks_accept(BlocksSim *s, double t1, double h, double proposed, double error, double target);
int blocks_rows_inside(BlocksSim *s, double t1, double h, int outstanding);
void blocks_look_at_rows(BlocksSim *s, double t1, double h);
int blocks_record_step(BlocksSim *s);
double *blocks_new_row(BlocksSim *s);
int blocks_fail(BlocksSim *s, int failure, int culprit, double value);
int blocks_clock(BlocksSim *s); /* 1 where it is time to pause */
double blocks_divided(const BlocksGrid *g, int64_t k);
double blocks_long_ratio(__int128 numerator, int64_t denominator);
int blocks_record_on_grid(BlocksSim *s);
int blocks_measure_instant(BlocksSim *s);
void blocks_take_instant(BlocksSim *s);
int blocks_check_slots(BlocksSim *s, const BlocksSlot *slots, int n);
int blocks_is_whole(const BlocksSim *s, int slot, double value);
int blocks_tell(BlocksSim *s, int cause);
double blocks_first_step(BlocksSim *s, double most);
int blocks_chatters(BlocksSim *s, double step);
int blocks_misses(BlocksSim *s, double *given);
int blocks_measures_in(const BlocksSim *s, double t0, double t1);
int blocks_window_begins(const BlocksSim *s, double t);
void blocks_measure_end(BlocksSim *s);
int blocks_measure_one(BlocksSim *s, int i, double t0, double t1);
int blocks_measure_whole(BlocksSim *s, double t0, double t1);

/* Quartics through values at the nodes of Lobatto's rule, of numbers or of vectors of them: their integral; their coefficients, by
   powers of 2 theta - 1, that of the middle first; and their values. REACH: how far they go beyond these, in their spans. */
#define BLOCKS_QUARTICS(KIND, REAL)                                                                                   \
    static const double LOBATTO[] = {0.0, 0.17267316464601146, 0.5, 0.82732683535398854, 1.0};                        \
    static const double NODE_WEIGHTS[] = {1.0 / 20, 49.0 / 180, 16.0 / 45, 49.0 / 180, 1.0 / 20};                     \
    static const double REACH = 0.35876858129917541;                                                                  \
    KIND inline REAL weighted(const REAL *y)                                                                          \
    {                                                                                                                 \
        return NODE_WEIGHTS[0] * y[0] + NODE_WEIGHTS[1] * y[1] + NODE_WEIGHTS[2] * y[2] + NODE_WEIGHTS[3] * y[3] +    \
               NODE_WEIGHTS[4] * y[4];                                                                                \
    }                                                                                                                 \
    KIND void quartic(const REAL *y, REAL *a)                                                                         \
    {                                                                                                                 \
        const double b = 2.0 * LOBATTO[3] - 1.0, b2 = 3.0 / 7.0;                                                      \
        REAL even = (y[4] - y[2] + (y[0] - y[2])) / 2.0, odd = (y[4] - y[0]) / 2.0;                                   \
        REAL inner_even = (y[3] - y[2] + (y[1] - y[2])) / 2.0, inner_odd = (y[3] - y[1]) / 2.0;                       \
        a[0] = y[2];                                                                                                  \
        a[4] = (even - inner_even / b2) / (1.0 - b2);                                                                 \
        a[3] = (odd - inner_odd / b) / (1.0 - b2);                                                                    \
        a[2] = even - a[4];                                                                                           \
        a[1] = odd - a[3];                                                                                            \
    }                                                                                                                 \
    KIND REAL at_share(const REAL *a, double theta)                                                                   \
    {                                                                                                                 \
        double s = 2.0 * theta - 1.0;                                                                                 \
        return a[0] + s * (a[1] + s * (a[2] + s * (a[3] + s * a[4])));                                                \
    }

/* A run is stiff where so many steps say so, without so many between that do not; see docs/semantics.md, "Methods". */
enum { BLOCKS_HITS = 15, BLOCKS_CALM = 6 };

/* Whether a step is one of those that are looked at: after so many others. */
#define BLOCKS_PACE 512

/* Where the next row stands, its time first; null where there is no memory. */
BLOCKS_INLINE double *blocks_row(BlocksSim *s)
{
    return s->rows.next == s->rows.end ? blocks_new_row(s) : s->rows.next;
}

/* It is filled, and counts. */
BLOCKS_INLINE void blocks_keep_row(BlocksSim *s, double *row)
{
    s->last_row = row;
    s->rows.next += 1 + s->rows.columns;
}

BLOCKS_INLINE double blocks_grid(const BlocksGrid *g, int64_t k)
{
    if (g->is_plain) return (double)(g->start + k * g->step) / (double)g->unit;
    return blocks_divided(g, k);
}

/* The time of the next row of the recording grid, which is computed once. */
BLOCKS_INLINE double blocks_next_row(BlocksSim *s)
{
    if (s->timed != s->row) s->next_row = blocks_grid(&s->setup->every, s->row), s->timed = s->row;
    return s->next_row;
}

/* How much shorter a step of order 5 with this error, above 1, is tried again. */
BLOCKS_INLINE double blocks_reduction(double error)
{
    double factor = 0.9 * pow(error, -1.0 / 5);
    return !isfinite(error) ? 0.1 : factor > 0.2 ? factor : 0.2;
}

/* The distance to the next larger double; x is finite. */
BLOCKS_INLINE double blocks_ulp(double x)
{
    double size = fabs(x), next;
    int64_t bits;
    memcpy(&bits, &size, sizeof bits);
    bits++;
    memcpy(&next, &bits, sizeof next);
    return next - size;
}

BLOCKS_INLINE double blocks_delay(const BlocksSim *s, int i)
{
    const BlocksHistory *history = &s->setup->histories[i];
    return history->delay_at < 0 ? history->delay : s->memory.p[history->delay_at];
}

/* Without NaN, and without a call. */
BLOCKS_INLINE double blocks_larger(double a, double b) { return a > b ? a : b; }
BLOCKS_INLINE double blocks_smaller(double a, double b) { return a < b ? a : b; }

BLOCKS_INLINE int blocks_within_ulps(double a, double b, double scale)
{
    double most = blocks_larger(blocks_larger(fabs(a), fabs(b)), scale);
    if (fabs(a - b) > 1e-12 * most && most > 1e-290) return 0; /* not so where one is infinite */
    if (isinf(a) || isinf(b)) return a == b;
    return fabs(a - b) <= 4 * blocks_ulp(most);
}

/* Whether t has reached `due`, the time of a break and a delay, but for rounding: sums of many delays round off by more
   than 4 ulp. */
BLOCKS_INLINE int blocks_is_due_at(double due, double t, double scale)
{
    if (due <= t) return 1;
    double most = blocks_larger(blocks_larger(fabs(due), fabs(t)), scale);
    return due - t <= 1e-12 * most && due - t <= 64 * blocks_ulp(most);
}

/* Whether a row at `at` is that of an instant at t: where jumps have no rows of their own, a time has one value. */
BLOCKS_INLINE int blocks_joins(const BlocksSim *s, double at, double t)
{
    return !s->setup->has_jumps && blocks_within_ulps(at, t, s->scale);
}

/* The side that goes with a value. Where a signal touched 0 and has not jumped since, it stays. inf: whatever the value is. */
BLOCKS_INLINE double blocks_latched_side(const BlocksSim *s, int j, double value)
{
    return s->touched_t == s->t && (value == s->touched[j] || s->touched[j] == INFINITY) ? s->memory.s[j] : value >= 0;
}

BLOCKS_INLINE int64_t blocks_tick_count(const BlocksSim *s, int rate)
{
    return s->setup->rates[rate].offset + s->ticks[rate] * s->setup->rates[rate].period;
}

BLOCKS_INLINE int blocks_any_due(const BlocksSim *s, const BlocksSlot *slots, int n)
{
    for (int i = 0; i < n; i++)
        if (s->due[slots[i].rate]) return 1;
    return 0;
}

/* The first clique with all rates that are due. */
BLOCKS_INLINE int blocks_clique(const BlocksSim *s, int nrates)
{
    int clique = 0;
    for (int r = 0; r < nrates && clique < s->setup->ncliques - 1; r++)
        if (s->due[r] && !s->setup->cliques[clique].rates[r]) clique++, r = -1;
    return clique;
}

/* numerator / denominator, rounded once; both may be beyond 2^53. */
BLOCKS_INLINE double blocks_ratio(__int128 numerator, int64_t denominator)
{
    const int64_t plain = (int64_t)1 << 53;
    if (numerator > plain || numerator < -plain || denominator > plain) return blocks_long_ratio(numerator, denominator);
    return (double)(int64_t)numerator / (double)denominator;
}

BLOCKS_INLINE double blocks_tick_time(const BlocksSim *s, int64_t count)
{
    return blocks_ratio((__int128)count * s->setup->base_numerator, s->setup->base_denominator);
}

/* The time of the next tick, event or edge; at most the end of the run. edge: of inputs and delays. */
BLOCKS_INLINE double blocks_next_of(BlocksSim *s, int nrates, int nevents, double edge)
{
    double target = s->end;
    s->target_exact = s->end_exact;
    s->target_count = s->end_count;
    if (nrates) {
        int64_t count = INT64_MAX;
        for (int r = 0; r < nrates; r++) {
            int64_t next = blocks_tick_count(s, r);
            if (next < count) count = next;
        }
        double then = blocks_tick_time(s, count);
        if (then <= target) {
            target = then;
            s->target_exact = 1;
            s->target_count = count;
        }
    }
    for (int i = 0; i < nevents; i++) edge = blocks_smaller(edge, s->events[i]);
    if (edge < target && !blocks_within_ulps(edge, target, s->scale)) {
        s->target_exact = 0;
        return edge;
    }
    return target;
}

#endif
