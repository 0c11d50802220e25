/* One instance of an exported diagram, apart from the version of FMI that it is spoken to in: fmi2.c and fmi3.c turn the
   calls of the standard into these. All values of an instance are in one struct; nothing is global. */
#ifndef BLOCKS_FMU_H
#define BLOCKS_FMU_H

#include <stddef.h>
#include <stdint.h>

/* What a call comes to. */
enum { FMU_OK = 0, FMU_WARNING, FMU_DISCARD, FMU_ERROR };

/* The kind of an instance. */
enum { FMU_ME = 1, FMU_CS = 2 };

/* Where an instance stands. */
enum {
    FMU_INSTANTIATED = 1 << 0,
    FMU_INITIALIZATION = 1 << 1,
    FMU_EVENT = 1 << 2,
    FMU_CONTINUOUS = 1 << 3,
    FMU_STEP = 1 << 4,         /* Co-Simulation: between communication steps */
    FMU_INTERMEDIATE = 1 << 5, /* inside the callback of FMI 3 */
    FMU_TERMINATED = 1 << 6,
    FMU_FAILED = 1 << 7,       /* after an error in the numbers: it can be read, reset, restored and freed */
    FMU_ASKING = 1 << 8        /* inside the callback of FMI 3 before steps: inputs can be set, nothing can be read */
};

/* Categories of messages. */
enum { FMU_LOG_EVENTS = 1 << 0, FMU_LOG_WARNING = 1 << 1, FMU_LOG_ERROR = 1 << 2, FMU_LOG_NONLINEAR = 1 << 3, FMU_LOG_TRACE = 1 << 4 };

/* Types of variables. Integers and enumerations are whole numbers in doubles; a bool is 0 or 1. */
enum { FMU_REAL = 0, FMU_INTEGER, FMU_BOOLEAN, FMU_ENUMERATION, FMU_STRING };

typedef struct Fmu Fmu;

/* Called with a message where its category is on: `status` is one of FMU_OK ... FMU_ERROR. */
typedef void (*FmuLog)(void *owner, int status, int category, const char *message);

/* What an update of discrete states comes to. */
typedef struct {
    int needs_update, terminate, nominals_changed, states_changed, has_next;
    double next;
} FmuEvents;

/* What a communication step comes to. */
typedef struct {
    int event_needed, terminate, returned_early;
    double last_time;
} FmuStep;

/* Called within a communication step. After an internal step, at its end, the mode is FMU_INTERMEDIATE; finished: the
   communication step ends here anyway; it sets *early where it asks for an early return, at *early_time. Before internal
   steps the mode is FMU_ASKING: it may set what inputs will be at t, which lies ahead; it cannot end the step. */
typedef void (*FmuIntermediate)(void *owner, double t, int finished, int *early, double *early_time);

/* --- life ---- */
/* Null where `token` is not that of this FMU, or there is no memory; `log` was told why. `log` may be null. resources: the
   folder of resources, as the importer names it; null where it does not. */
Fmu *fmu_new(int kind, const char *name, const char *token, const char *resources, FmuLog log, void *owner);
void fmu_free(Fmu *f);
int fmu_reset(Fmu *f);                          /* as it was when it was new */
void *fmu_owner(const Fmu *f);
int fmu_kind(const Fmu *f);
int fmu_mode(const Fmu *f);
void fmu_set_mode(Fmu *f, int mode);            /* for those who have checked that it is allowed */
void fmu_log_categories(Fmu *f, int categories); /* a sum of FMU_LOG_...: which are on, besides errors */
int fmu_logs(const Fmu *f);
int fmu_has_traces(void);                        /* whether there are messages of FMU_LOG_TRACE: calls of FMUs inside */
/* Tells a message of a category, formatted as by printf, and gives back `status`. */
int fmu_say(Fmu *f, int status, int category, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 4, 5)))
#endif
    ;

/* --- variables ----
   A value reference is that of a variable's first element, and the ones of its other elements follow: FMI 2 has a
   scalar variable for each, FMI 3 one array. */
/* How many elements the variable of a reference has as an array; 0: there is none that begins there. */
size_t fmu_elements(uint32_t reference);
int fmu_type(uint32_t reference);               /* of one element; -1: there is none */
size_t fmu_references(void);                    /* references are below this */
/* `count` elements from a reference on. An error, with a message, where it may not be read or set now, is of another
   type, or (set) where a value is not finite or out of its range; then nothing is changed. */
int fmu_get(Fmu *f, uint32_t reference, int type, double *values, size_t count);
int fmu_check(Fmu *f, uint32_t reference, int type, const double *values, size_t count); /* whether it may be set */
int fmu_set(Fmu *f, uint32_t reference, int type, const double *values, size_t count);
const char *fmu_get_string(Fmu *f, uint32_t reference); /* null, with a message, where there is none */
/* The derivative of this order (1 to 3) of an input by time, from now on: FMI 2. */
int fmu_set_input_derivative(Fmu *f, uint32_t reference, int order, double value);

/* --- initialization ---- */
int fmu_enter_initialization(Fmu *f, int has_tolerance, double tolerance, double start, int has_stop, double stop);
/* To FMU_EVENT for Model Exchange, and for Co-Simulation where `has_event_mode`; else to FMU_STEP. */
int fmu_exit_initialization(Fmu *f, int has_event_mode);

/* --- events ---- */
int fmu_enter_event_mode(Fmu *f);
int fmu_update_discrete_states(Fmu *f, FmuEvents *events);
int fmu_enter_continuous_mode(Fmu *f); /* or FMU_STEP */

/* --- Model Exchange ---- */
int fmu_set_time(Fmu *f, double t);
int fmu_set_states(Fmu *f, const double *x, size_t n);
int fmu_get_states(Fmu *f, double *x, size_t n);
int fmu_get_rates(Fmu *f, double *rates, size_t n);
int fmu_get_nominals(Fmu *f, double *x, size_t n);
int fmu_get_indicators(Fmu *f, double *z, size_t n);
size_t fmu_number_of_states(void);
size_t fmu_number_of_indicators(void);
int fmu_completed_step(Fmu *f, int *enter_event_mode, int *terminate);

/* --- Co-Simulation ---- */
/* From t to t + h. `early`: whether it may return before, at an event (which is then processed in event mode).
   intermediate: may be null; inputs are then held, or follow the derivatives that were set. */
int fmu_step(Fmu *f, double t, double h, int early, FmuIntermediate intermediate, void *owner, FmuStep *step);
double fmu_time(const Fmu *f);

/* --- states of the FMU ---- */
typedef struct FmuSaved FmuSaved;
int fmu_save(Fmu *f, FmuSaved **saved);         /* *saved may be null, or one to write over */
int fmu_restore(Fmu *f, const FmuSaved *saved);
void fmu_forget(FmuSaved *saved);
size_t fmu_saved_bytes(const FmuSaved *saved);
int fmu_serialize(Fmu *f, const FmuSaved *saved, unsigned char *bytes, size_t size);
int fmu_deserialize(Fmu *f, const unsigned char *bytes, size_t size, FmuSaved **saved);

/* --- derivatives ----
   d(unknowns) for d(knowns) = seed; adjoint: d(knowns) for d(unknowns) = seed. References of elements, all real. */
int fmu_directional(Fmu *f, const uint32_t *unknowns, size_t nunknowns, const uint32_t *knowns, size_t nknowns,
                    const double *seed, double *sensitivity, int adjoint);

/* What depends on what: the references of the elements that an unknown depends on (null: not known). */
size_t fmu_dependencies(uint32_t unknown, const uint32_t **references);

#endif
