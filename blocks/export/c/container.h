/* What the exporter writes of a diagram with FMUs for Co-Simulation, beside fmu_model: tables that do not change. */
#ifndef BLOCKS_CONTAINER_H
#define BLOCKS_CONTAINER_H

#include "fmu.h"
#include "fmu_bridge.h"
#include "fmu_model.h"
#include "master.h"
#include "trace.h"

/* Values that a setting, a row of numbers, or a text gives a parameter or a start value of an FMU. */
typedef struct {
    uint32_t reference;
    int32_t type;                 /* of fmu_types.h; -1: a text */
    int32_t is_size;              /* a structural parameter, which is set first */
    int32_t first, count;         /* of the settings; of a text 0 and 1 */
    double scale, offset;         /* what 1 and 0 of the FMU are in SI */
    const double *told;           /* (count) what the FMU has by its description; null: it is always set */
    const double *given;          /* (count) numbers of the FMU; null: those of the settings */
    const char *text;
} ContainerParameter;

/* An FMU, by its place among the units, -1 of one for Model Exchange, whose settings are the parameters of its island. folder: in resources. heard: categories of its messages that are asked for. */
typedef struct {
    const char *name, *folder, *identifier, *token;
    int32_t fmi, unit, event_mode, early_return, follows_updates, has_tolerance, serializes;
    double tolerance; /* where the importer gives none */
    int32_t nmoving, nparameters, nheard;
    const uint32_t *moving; /* inputs that are set within steps */
    const ContainerParameter *parameters;
    const char *const *heard;
    int32_t nnames;
    const BlocksTraceName *names; /* of its variables, for traces */
} ContainerFmu;

/* Some parameters of all blocks, from `from` on, are those of an island from `to` on. */
typedef struct {
    int32_t from, to, count;
} ContainerPiece;

/* An FMU for Model Exchange in an island. table: what does not change of its table there; room: of its scratch. */
typedef struct {
    ContainerFmu fmu;
    BlocksForeign table;
    int32_t room;
} ContainerForeign;

/* Blocks with equations, by their place among the units. ntaken: inputs of its FMUs. */
typedef struct {
    FmuRun run;
    int32_t unit, npieces, nforeigns, ntaken;
    const ContainerPiece *pieces;
    const ContainerForeign *foreigns;
} ContainerIsland;

typedef struct {
    const Master *master;
    int32_t nislands, nfmus, nparameters, saves, serializes;
    const ContainerIsland *islands;
    const ContainerFmu *fmus;
    const MasterLink *outputs, *locals;
    const char *const *moves, *const *moved; /* by the number of a call: its function, and its variables */
    const char *const *units, *const *elements, *const *output_names;
    double length; /* of the run that is exported, s */
} Container;

extern const Container container;
/* By the version of FMI (2, 3) less 2: the functions of master.h, and what sets or gets a type of fmu_types.h. */
extern const char *const container_calls[2][CALLS_OF_FMI], *const container_types[2][BLOCKS_TYPES];
extern const char *const container_foreign_calls[2][BLOCKS_CALLS]; /* those of fmu_bridge.h */

/* --- one FMU inside; inner_fmu.c ---- */
typedef struct InnerFmu InnerFmu;

/* Loaded and instantiated; null where that fails, and it was told why. resources: the folder of the container's. trace: of
   its calls; null: they are not traced. */
InnerFmu *inner_new(Fmu *owner, const ContainerFmu *what, const char *resources, BlocksTrace *trace);
void inner_trace(InnerFmu *in, BlocksTrace *trace); /* from now on, once it is connected again */
/* Fill the functions of its unit, and of calls that move values. */
int inner_connect(InnerFmu *in, MasterUnit *u);
void inner_connect_foreign(InnerFmu *in, BlocksForeign *table);
int inner_connect_groups(InnerFmu *in, MasterGroup *groups, int n, const char *way);
/* Up to initialization mode, with its parameters by the settings. */
int inner_begin(InnerFmu *in, const double *settings, int has_tolerance, double tolerance, double start, int has_stop, double stop);
void inner_started(InnerFmu *in); /* it has left initialization mode: it is terminated some time */
void inner_terminate(InnerFmu *in);
void inner_fail(InnerFmu *in, int is_fatal); /* it is not terminated, and after a fatal error not called at all any more */
void inner_free(InnerFmu *in);
int inner_get_state(InnerFmu *in, void **state);
int inner_set_state(InnerFmu *in, void *state);
void inner_free_state(InnerFmu *in, void **state);
/* The bytes of a state, from malloc; null where it gives none. */
unsigned char *inner_serialize(InnerFmu *in, void *state, size_t *size);
int inner_deserialize(InnerFmu *in, const unsigned char *bytes, size_t size, void **state);

#endif
