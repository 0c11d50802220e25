/* What the exporter writes beside the model: tables of one diagram, which do not change. */
#ifndef BLOCKS_FMU_MODEL_H
#define BLOCKS_FMU_MODEL_H

#include "runtime.h"

/* Where the value of a variable stands. */
enum {
    FMU_ROW_TIME = 0,
    FMU_ROW_STATE,     /* index: in the order of the FMU */
    FMU_ROW_RATE,      /* the same */
    FMU_ROW_INPUT,     /* index: in u */
    FMU_ROW_SETTING,   /* index: in the settings */
    FMU_ROW_OUTPUT,    /* index: in what the program `logged` gives */
    FMU_ROW_LOCAL,     /* index: in what the program `locals` gives */
    FMU_ROW_INDICATOR, /* index: of a crossing */
    FMU_ROW_TEXT       /* index: of a text */
};

enum { FMU_CONSTANT = 0, FMU_FIXED, FMU_TUNABLE, FMU_CALCULATED, FMU_VARYING };

/* One element. size: how many elements the variable that begins here has; 0 in its midst. */
typedef struct {
    uint8_t row, type, variability, low_open, high_open;
    int32_t index, size;
    double low, high;
    int32_t first_member, nmembers; /* of an enumeration */
} FmuVariable;

/* A step of the sparse accumulation of derivatives: sums of partials times earlier entries; or an algebraic loop,
   F_w dw = -F_a da, with `n` unknowns. */
typedef struct {
    int32_t is_loop, lo, hi, n;
    int32_t nterms;                    /* of all sums; of F_a */
    const int32_t *starts;             /* (hi - lo): where the terms of each entry begin; null: one each */
    const int32_t *partials, *sources; /* (nterms); sources null: all are 1 */
    const int32_t *places;             /* (nterms) of F_a: flat, by rows */
    int32_t ninner;
    const int32_t *inner_places, *inner_partials;
    const double *own;                 /* (n) */
} FmuSum;

typedef struct {
    int32_t side, n;
    const int32_t *entries;
} FmuOff;

/* The derivatives of rates and outputs by states and real inputs: `nrows` by `ncolumns`, sparse by columns. */
typedef struct {
    int32_t nrows, ncolumns, npartials, nentries, narguments, nprobed, nnumbers, nsums, noff_partials, noff, nmost;
    const double *numbers;
    const FmuSum *sums;
    const FmuOff *off_partials, *off; /* what is 0 where a subdiagram is off */
    const uint8_t *is_unused;         /* (npartials) */
    const int32_t *first, *rows, *entries; /* (ncolumns + 1), of each value its row and its entry */
    void (*partials)(const double *arguments, const double *tables, double *out);
} FmuJacobian;

typedef struct {
    const BlocksSetup *setup; /* what an instance makes its own of */
    const char *token;
    int32_t kinds, nvariables, nsettings, noutputs, nlocals, nstates, is_whole;
    const FmuVariable *variables;
    const double *settings, *parameters, *inputs, *guesses, *nominal, *atol, *members;
    const double *sides;         /* (ns) at the start, where they are given */
    const uint8_t *sides_given;  /* (ns) */
    const int32_t *places;       /* (nstates) of each state, its place in the model */
    const int32_t *rows_of, *columns_of; /* by reference: the row and the column of its derivatives; -1: none */
    const int32_t *first_dependency, *dependencies; /* by reference: from [r] to [r + 1] */
    void (*bind)(double *settings, double *parameters);
    BlocksProgram locals, probed;
    const double *numbers, *tables;
    const char *const *texts, *const *state_names, *const *discrete_names, *const *cause_names, *const *names;
    double rtol, plain_atol, start, length; /* length: of the run that is exported, s */
    double delay, shortest;                 /* the longest and the shortest history, s; 0: there is none */
    FmuJacobian jacobian;
} FmuModel;

extern const FmuModel fmu_model;

#endif
