/* Many runs of one model, which differ in their parameters: rows of p in, what measures and signals became out. */
#ifndef BLOCKS_BATCH_H
#define BLOCKS_BATCH_H

#include "runtime.h"

/* What is kept of a measure: total, span, first, begin, target, last, low, high, as BlocksMeasured begins. */
#define BLOCKS_KEPT 8

/* How a row ended; STOPPED: its condition did so. */
enum { BLOCKS_ROW_LEFT, BLOCKS_ROW_DONE, BLOCKS_ROW_FAILED, BLOCKS_ROW_BUDGET, BLOCKS_ROW_NO_MEMORY, BLOCKS_ROW_STOPPED };

/* How a row begins is the same for all but p. Every pointer belongs to the caller. Threads that work on one batch take
   row after row; nothing of a row depends on which of them did, nor on its neighbours. */
typedef struct {
    int64_t nrows, nstops, ngrid; /* ngrid: rows of signals; 0: none */
    int64_t budget;               /* the most steps, rejected ones included; 0: any number */
    double start;
    int64_t count;
    int32_t exact, crossing;
    const double *p;                /* (nrows, np) */
    const double *z, *s, *located;  /* (nz), (ns), (ns): at the start */
    const int64_t *ticks;           /* (nrates) */
    const double *stops;            /* (nstops) where the run stops on its way, and its end */
    int32_t is_by_one;              /* whether a call works on one row */
    int32_t is_cancelled;           /* set from outside */
    int64_t next, done;             /* the next row, and how many are done */
    double *signals;                /* (nrows, ngrid, nlogged) */
    double *measured;               /* (nrows, nmeasures, BLOCKS_KEPT) */
    double *ended;                  /* (nrows) the time that was reached */
    int32_t *status, *failure, *culprit; /* (nrows) */
    int64_t *steps;                 /* (nrows) accepted and rejected */
} BlocksBatch;

/* Work on rows until there are none left, or on one, whose number it returns; -1: there are none left, or it was
   cancelled. room: of ngrid + 1 rows of signals, for this thread. */
BLOCKS_API int64_t blocks_batch(BlocksBatch *b, BlocksSim *s, double *room);

/* The same in lanes, each with a run behind it (lane_steps.h); `which`: the lane of that row. sims: of each lane,
   null for one that gets no row. room: of each lane that has one, `each` doubles long. What becomes of a row depends neither on its lane nor on the rows beside it. */
typedef struct BlocksLanes BlocksLanes;
BLOCKS_API BlocksLanes *blocks_lanes_new(BlocksSim **sims, double *room, int64_t each); /* null where there is no memory */
BLOCKS_API int64_t blocks_lanes(BlocksBatch *b, BlocksLanes *lanes, int32_t *which);
BLOCKS_API void blocks_lanes_free(BlocksLanes *lanes);

/* For both. */
int blocks_is_cancelled(BlocksBatch *b);
void blocks_row_begin(const BlocksBatch *b, BlocksSim *s, int64_t row, double *room); /* as a run of its own begins */
void blocks_row_keep(BlocksBatch *b, BlocksSim *s, int64_t row, int status, const double *room);

#endif
