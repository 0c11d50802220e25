/* What the exporter writes beside the model: tables of one diagram, which do not change. */
#ifndef BLOCKS_FMU_MODEL_H
#define BLOCKS_FMU_MODEL_H

#include "jacobian.h"

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

/* Equations, and what they begin with. */
typedef struct {
    const BlocksSetup *setup; /* what an instance makes its own of */
    int32_t nstates, is_whole;
    const double *parameters, *guesses, *atol;
    const double *sides;         /* (ns) at the start, where they are given */
    const uint8_t *sides_given;  /* (ns) */
    const double *numbers, *tables;
    const char *const *state_names, *const *discrete_names, *const *cause_names;
    double rtol, plain_atol, start, length; /* length: of the run that is exported, s */
} FmuRun;

typedef struct {
    FmuRun run;
    const char *token;
    int32_t kinds, nvariables, nsettings, ninputs, noutputs, nlocals;
    const FmuVariable *variables;
    const double *settings, *inputs, *nominal, *members;
    const int32_t *places;       /* (nstates) of each state, its place in the model */
    const int32_t *rows_of, *columns_of; /* by reference: the row and the column of its derivatives; -1: none */
    const int32_t *first_dependency, *dependencies; /* by reference: from [r] to [r + 1] */
    void (*bind)(double *settings, double *parameters);
    BlocksProgram locals;
    const char *const *texts, *const *names;
    BlocksJacobian jacobian; /* of rates and outputs by states and real inputs */
} FmuModel;

extern const FmuModel fmu_model;

enum { INPUTS_SET = 1, SETTINGS_SET = 2 };

/* What is saved as it stands. */
typedef struct {
    double start, stop, tolerance, slopes_at;
    int64_t steps; /* communication steps since the start */
    int32_t mode, kind, has_stop, has_tolerance, has_event_mode, known, set, has_slopes;
} Live;

#endif
