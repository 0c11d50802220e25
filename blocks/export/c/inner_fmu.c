/* One FMU inside of another: its library is loaded from the resources, and its instance is brought to initialization mode.
   From there on master.c calls it. What it says is told by the container, with its name.

   References: FMI 2.0.4, 2.1 and 4.2; FMI 3.0.2, 2.1 to 2.5. */
#define _POSIX_C_SOURCE 200809L
#include "container.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
#else
#include <dlfcn.h>
#include <sys/stat.h>
#endif

enum { OK = 0, WARNING, DISCARD, ERROR_, FATAL };

#if defined(_WIN32)
#define SUFFIX ".dll"
#define SYSTEM "windows"
#elif defined(__APPLE__)
#define SUFFIX ".dylib"
#define SYSTEM "darwin"
#else
#define SUFFIX ".so"
#define SYSTEM "linux"
#endif
#if defined(__aarch64__) || defined(_M_ARM64)
#define MACHINE "aarch64"
#elif defined(__x86_64__) || defined(_M_X64)
#define MACHINE "x86_64"
#else
#define MACHINE "x86"
#endif
#if defined(_WIN32)
#define OLD (sizeof(void *) == 8 ? "win64" : "win32")
#elif defined(__APPLE__)
#define OLD "darwin64"
#else
#define OLD (sizeof(void *) == 8 ? "linux64" : "linux32")
#endif

typedef struct {
    void (*logger)(void *environment, const char *name, int status, const char *category, const char *message, ...);
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *memory);
    void (*finished)(void *environment, int status);
    void *environment;
} Callbacks2;
typedef void (*Log3)(void *environment, int status, const char *category, const char *message);

typedef void *(*Instantiate2)(const char *name, int kind, const char *token, const char *resources, const Callbacks2 *, int, int);
typedef void *(*Instantiate3)(const char *name, const char *token, const char *resources, bool visible, bool logging,
                              bool event_mode, bool early_return, const uint32_t *moving, size_t nmoving, void *environment,
                              Log3, void *update);
typedef void *(*InstantiateModel3)(const char *name, const char *token, const char *resources, bool visible, bool logging,
                                   void *environment, Log3);
typedef void (*Free)(void *);
typedef int (*Plain)(void *);
typedef int (*Logging2)(void *, int on, size_t n, const char *const *categories);
typedef int (*Logging3)(void *, bool on, size_t n, const char *const *categories);
typedef int (*Setup2)(void *, int, double, double, int, double);
typedef int (*Enter3)(void *, bool, double, double, bool, double);
typedef int (*Set2)(void *, const uint32_t *, size_t, const void *);
typedef int (*Set3)(void *, const uint32_t *, size_t, const void *, size_t);
typedef int (*State)(void *, void **);
typedef int (*Restore)(void *, void *);
typedef int (*Size)(void *, void *, size_t *);
typedef int (*Serialize)(void *, void *, unsigned char *, size_t);
typedef int (*Deserialize)(void *, const unsigned char *, size_t, void **);

struct InnerFmu {
    Fmu *owner;
    const ContainerFmu *what;
    void *library, *component;
    char *resources;
    int is_lost, must_terminate, is_silent, is_traced;
    BlocksTraced *traced; /* made with its first trace, and kept */
    Callbacks2 callbacks;
};

static char *text_of(const char *format, ...)
{
    va_list arguments, again;
    va_start(arguments, format);
    va_copy(again, arguments);
    int n = vsnprintf(NULL, 0, format, arguments);
    char *made = n < 0 ? NULL : malloc((size_t)n + 1);
    if (made) vsnprintf(made, (size_t)n + 1, format, again);
    va_end(again);
    va_end(arguments);
    return made;
}

static int complain(InnerFmu *in, const char *what)
{
    return fmu_say(in->owner, FMU_ERROR, FMU_LOG_ERROR, "%s: %s", in->what->name, what);
}

/* --- what it says ----------------------------------------------------------------------------------------------------- */

/* A message of FMI 2 with names in the place of #r12#, which would be another variable of the container; ## is #. */
static void name_variables(const InnerFmu *in, const char *text, char *to, size_t size)
{
    const ContainerFmu *what = in->what;
    for (char *end = to + size - 1; *text && to < end;) {
        uint32_t reference = 0;
        int length = 0;
        char letter = 0;
        if (text[0] == '#' && text[1] == '#') {
            *to++ = '#', text += 2;
        } else if (sscanf(text, "#%c%" SCNu32 "#%n", &letter, &reference, &length) == 2 && length && strchr("ribsRIBS", letter)) {
            const char *name = NULL;
            for (int k = 0; k < what->nnames && !name; k++)
                if (what->names[k].reference == reference && what->names[k].call == (letter & ~32)) name = what->names[k].name;
            int n = name ? snprintf(to, (size_t)(end - to) + 1, "%s", name)
                         : snprintf(to, (size_t)(end - to) + 1, "variable %" PRIu32, reference);
            to += n < end - to ? n : end - to, text += length;
        } else {
            *to++ = *text++;
        }
    }
    *to = 0;
}

static void hear(InnerFmu *in, int status, const char *category, const char *text)
{
    char named[1000];
    if (in->what->fmi == 2 && text && strchr(text, '#')) name_variables(in, text, named, sizeof named), text = named;
    int of = status >= ERROR_ && status <= FATAL ? FMU_LOG_ERROR : status == OK ? FMU_LOG_EVENTS : FMU_LOG_WARNING;
    int own = status == OK ? FMU_OK : status == WARNING ? FMU_WARNING : status == DISCARD ? FMU_DISCARD : FMU_ERROR;
    if (in->is_silent) return;
    if (in->is_traced) blocks_trace_message(in->traced, status, category ? category : "", text ? text : "");
    fmu_say(in->owner, own, of, "%s: %s%s%s%s", in->what->name, category && category[0] ? "[" : "", category ? category : "",
            category && category[0] ? "] " : "", text ? text : "");
}

static void hear_3(void *environment, int status, const char *category, const char *text) { hear(environment, status, category, text); }

static void hear_2(void *environment, const char *name, int status, const char *category, const char *format, ...)
{
    char text[1000];
    va_list arguments;
    (void)name;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format ? format : "", arguments);
    va_end(arguments);
    hear(environment, status, category, text);
}

/* --- files and libraries ------------------------------------------------------------------------------------------------ */

#if defined(_WIN32)
static wchar_t *wide(const char *path)
{
    int n = MultiByteToWideChar(CP_UTF8, 0, path, -1, NULL, 0);
    wchar_t *made = n > 0 ? malloc((size_t)n * sizeof *made) : NULL;
    if (made) MultiByteToWideChar(CP_UTF8, 0, path, -1, made, n);
    for (wchar_t *c = made; c && *c; c++)
        if (*c == L'/') *c = L'\\';
    return made;
}

static int exists(const char *path)
{
    wchar_t *name = wide(path);
    int there = name && GetFileAttributesW(name) != INVALID_FILE_ATTRIBUTES;
    free(name);
    return there;
}

static void *load(const char *path)
{
    wchar_t *name = wide(path);
    void *library = name ? (void *)LoadLibraryExW(name, NULL, LOAD_WITH_ALTERED_SEARCH_PATH) : NULL;
    free(name);
    return library;
}

static const char *why_not_loaded(char *text, size_t size)
{
    snprintf(text, size, "error %lu of Windows", (unsigned long)GetLastError());
    return text;
}

static void *symbol(void *library, const char *name)
{
    FARPROC found = GetProcAddress(library, name);
    void *address;
    memcpy(&address, &found, sizeof address);
    return address;
}

static void unload(void *library) { FreeLibrary(library); }
#else
static int exists(const char *path)
{
    struct stat found;
    return stat(path, &found) == 0;
}

static void *load(const char *path) { return dlopen(path, RTLD_NOW | RTLD_LOCAL); }

static const char *why_not_loaded(char *text, size_t size)
{
    const char *why = dlerror();
    snprintf(text, size, "%s", why ? why : "no reason is given");
    return text;
}

static void *symbol(void *library, const char *name) { return dlsym(library, name); }
static void unload(void *library) { dlclose(library); }
#endif

/* A folder as a URI, as FMI 2 wants it. */
static char *uri_of(const char *path)
{
    char *made = malloc(3 * strlen(path) + 16), *to = made;
    if (!made) return NULL;
    to += sprintf(to, path[0] == '/' ? "file://" : "file:///");
    for (const unsigned char *c = (const unsigned char *)path; *c; c++) {
        int is_plain = (*c >= 'a' && *c <= 'z') || (*c >= 'A' && *c <= 'Z') || (*c >= '0' && *c <= '9') || strchr("/-._~:", *c);
        to += *c == '\\' ? sprintf(to, "/") : is_plain ? sprintf(to, "%c", *c) : sprintf(to, "%%%02X", *c);
    }
    return made;
}

static int digit(char c)
{
    return c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

/* The path of a folder that is given as a path or as a URI, without a separator at its end. */
static char *path_of(const char *given)
{
    int is_uri = !strncmp(given, "file:", 5);
    const char *from = is_uri ? given + 5 : given;
    if (is_uri && from[0] == '/' && from[1] == '/') {
        from += 2;
        if (!strncmp(from, "localhost/", 10)) from += 9;
        if (from[0] && from[0] != '/') from -= 2; /* a server's name */
    }
#if defined(_WIN32)
    if (is_uri && from[0] == '/' && from[1] && (from[2] == ':' || from[2] == '|')) from++;
#endif
    char *made = malloc(strlen(from) + 1), *to = made;
    if (!made) return NULL;
    for (; *from; from++) {
        int high = is_uri && *from == '%' ? digit(from[1]) : -1, low = high >= 0 ? digit(from[2]) : -1;
        if (low >= 0) *to++ = (char)(16 * high + low), from += 2;
        else *to++ = *from;
    }
    while (to > made + 1 && (to[-1] == '/' || to[-1] == '\\')) to--;
    *to = 0;
    return made;
}

/* A function of the library by its full name, or the shim before it; null where there is none. */
static void *function(const InnerFmu *in, const char *full)
{
    void *own = symbol(in->library, full), *shim = own && in->is_traced ? blocks_trace_shim(in->traced, full, own) : NULL;
    return shim ? shim : own;
}

/* What functions take as the instance. */
static void *caller(const InnerFmu *in) { return in->is_traced ? (void *)in->traced : in->component; }

static void *found(const InnerFmu *in, const char *name)
{
    char full[100];
    snprintf(full, sizeof full, "fmi%d%s", in->what->fmi, name);
    return function(in, full);
}

#define FOUND(type, name) (*(type *)&(void *){found(in, name)})

static int lacks(InnerFmu *in, const char *name)
{
    return fmu_say(in->owner, FMU_ERROR, FMU_LOG_ERROR, "%s: its binary has no function fmi%d%s", in->what->name,
                   in->what->fmi, name);
}

/* OK where a status is ok or a warning. */
static int judged(InnerFmu *in, const char *name, int status)
{
    static const char *const words[] = {"ok", "a warning", "discard", "an error", "a fatal error"};
    if (status == FATAL) inner_fail(in, 1);
    if (status == OK || status == WARNING) return FMU_OK;
    return fmu_say(in->owner, FMU_ERROR, FMU_LOG_ERROR, "%s: fmi%d%s returned %s", in->what->name, in->what->fmi, name,
                   status > OK && status <= FATAL ? words[status] : "a status that does not exist");
}

static int called(InnerFmu *in, const char *name)
{
    if (!found(in, name)) return lacks(in, name);
    return judged(in, name, FOUND(Plain, name)(caller(in)));
}

/* --- life --------------------------------------------------------------------------------------------------------------- */

static int load_library(InnerFmu *in)
{
    const ContainerFmu *what = in->what;
    const char *const folders[] = {what->fmi == 3 ? MACHINE "-" SYSTEM : OLD, what->fmi == 3 ? OLD : MACHINE "-" SYSTEM};
    char text[500];
    for (int k = 0; k < 2; k++) {
        char *path = text_of("%s/binaries/%s/%s" SUFFIX, in->resources, folders[k], what->identifier);
        int there = path && exists(path);
        if (there && !(in->library = load(path)))
            fmu_say(in->owner, FMU_ERROR, FMU_LOG_ERROR, "%s: %s cannot be loaded: %s", what->name, path,
                    why_not_loaded(text, sizeof text));
        free(path);
        if (there) return in->library ? FMU_OK : FMU_ERROR;
    }
    return fmu_say(in->owner, FMU_ERROR, FMU_LOG_ERROR, "%s: there is no binary for " MACHINE "-" SYSTEM " in %s", what->name,
                   in->resources);
}

static int instantiate(InnerFmu *in)
{
    const ContainerFmu *what = in->what;
    char *folder = text_of("%s/resources", in->resources), *place = NULL;
    const int is_model = what->unit < 0;
    const char *name = what->fmi == 2 ? "Instantiate" : is_model ? "InstantiateModelExchange" : "InstantiateCoSimulation";
    const char *const given[] = {"instanceName", what->name, what->fmi == 2 ? "fmuGUID" : "instantiationToken", what->token};
    int there = folder && exists(folder);
    if (folder) place = what->fmi == 2 ? uri_of(folder) : text_of("%s/", folder);
    if (!found(in, name)) {
        lacks(in, name);
    } else if (what->fmi == 2) {
        in->callbacks = (Callbacks2){hear_2, calloc, free, NULL, in};
        if (in->is_traced) blocks_trace_making(in->traced, "fmi2Instantiate", given, 2);
        in->component = FOUND(Instantiate2, name)(what->name, !is_model, what->token, place, &in->callbacks, 0, 1);
    } else if (is_model) {
        if (in->is_traced) blocks_trace_making(in->traced, "fmi3InstantiateModelExchange", given, 2);
        in->component = FOUND(InstantiateModel3, name)(what->name, what->token, there ? place : NULL, false, true, in, hear_3);
    } else {
        if (in->is_traced) blocks_trace_making(in->traced, "fmi3InstantiateCoSimulation", given, 2);
        void (*update)(void *, double, int, int, int, int, void *, double *) = what->follows_updates ? master_intermediate : NULL;
        in->component = FOUND(Instantiate3, name)(what->name, what->token, there ? place : NULL, false, true, what->event_mode,
                                                  what->early_return, what->moving, (size_t)what->nmoving, in, hear_3,
                                                  *(void **)&update);
    }
    free(folder);
    free(place);
    if (in->is_traced) blocks_trace_made(in->traced, in->component);
    if (!in->component) return complain(in, "it gives no instance");
    if (what->nheard && found(in, "SetDebugLogging")) { /* messages about failures only: all others take time */
        int status = what->fmi == 2 ? FOUND(Logging2, "SetDebugLogging")(caller(in), 1, (size_t)what->nheard, what->heard)
                                    : FOUND(Logging3, "SetDebugLogging")(caller(in), true, (size_t)what->nheard, what->heard);
        if (status == FATAL) return judged(in, "SetDebugLogging", status);
    }
    return FMU_OK;
}

void inner_trace(InnerFmu *in, BlocksTrace *trace)
{
    if (trace && !in->traced) {
        in->traced = blocks_trace_instance(trace, in->what->name, in->what->names, in->what->nnames, NULL, 0);
        if (in->traced) in->traced->component = in->component;
    }
    in->is_traced = trace && in->traced;
}

InnerFmu *inner_new(Fmu *owner, const ContainerFmu *what, const char *resources, BlocksTrace *trace)
{
    InnerFmu *in = calloc(1, sizeof *in);
    char *folder = in && resources ? path_of(resources) : NULL;
    if (!in) return NULL;
    in->owner = owner;
    in->what = what;
    in->resources = folder ? text_of("%s/%s", folder, what->folder) : NULL;
    free(folder);
    if (trace) inner_trace(in, trace);
    if (!in->resources) complain(in, "the importer names no folder of resources, where it is");
    if (!in->resources || load_library(in) || instantiate(in)) {
        inner_free(in);
        return NULL;
    }
    return in;
}

void inner_fail(InnerFmu *in, int is_fatal)
{
    in->must_terminate = 0;
    in->is_lost |= is_fatal;
}

void inner_terminate(InnerFmu *in)
{
    int must = in->must_terminate;
    in->must_terminate = 0;
    if (must && !in->is_lost && found(in, "Terminate") && FOUND(Plain, "Terminate")(caller(in)) == FATAL) inner_fail(in, 1);
}

void inner_free(InnerFmu *in)
{
    if (!in) return;
    in->is_silent = 1; /* nobody may listen any more */
    if (in->component && !in->is_lost && found(in, "FreeInstance")) FOUND(Free, "FreeInstance")(caller(in));
    if (in->library && !in->is_lost) unload(in->library);
    free(in->resources);
    free(in);
}

/* --- what the master calls -------------------------------------------------------------------------------------------------- */

int inner_connect(InnerFmu *in, MasterUnit *u)
{
    u->component = caller(in);
    for (int k = 0; k < CALLS_OF_FMI; k++) u->calls[k] = function(in, container_calls[in->what->fmi - 2][k]);
    const int needed[] = {CALL_DoStep, CALL_ExitInitializationMode, CALL_GetFMUState, CALL_SetFMUState, CALL_EnterEventMode,
                          CALL_UpdateDiscreteStates, CALL_EnterStepMode};
    for (int i = 0; i < (u->has_instants ? 7 : u->can_save ? 4 : 2); i++) {
        int is_of_state = needed[i] == CALL_GetFMUState || needed[i] == CALL_SetFMUState;
        if (u->calls[needed[i]] || (is_of_state && !u->can_save)) continue;
        return lacks(in, container_calls[in->what->fmi - 2][needed[i]] + 4);
    }
    if (u->way == MASTER_DERIVATIVES && !u->calls[CALL_SetRealInputDerivatives]) u->way = MASTER_MEAN, u->takes = 0;
    return FMU_OK;
}

void inner_connect_foreign(InnerFmu *in, BlocksForeign *table)
{
    const int fmi = in->what->fmi;
    char name[40];
    table->component = caller(in);
    for (int k = 0; k < BLOCKS_CALLS; k++)
        if ((k != BLOCKS_COMPLETED || table->completes) && (k != BLOCKS_GET_INDICATORS || table->nz))
            table->calls[k] = function(in, container_foreign_calls[fmi - 2][k]);
    for (int type = 0; type < BLOCKS_TYPES; type++) {
        if (!container_types[fmi - 2][type][0]) continue;
        snprintf(name, sizeof name, "Get%s", container_types[fmi - 2][type]);
        table->get[type] = found(in, name);
        name[0] = 'S';
        table->set[type] = found(in, name);
    }
}

int inner_connect_groups(InnerFmu *in, MasterGroup *groups, int n, const char *way)
{
    char name[40];
    for (int i = 0; i < n; i++) {
        snprintf(name, sizeof name, "%s%s", way, container_types[in->what->fmi - 2][groups[i].type]);
        if (!(groups[i].move = found(in, name))) return lacks(in, name);
    }
    return FMU_OK;
}

/* --- parameters ------------------------------------------------------------------------------------------------------------- */

static int same(double a, double b) { return a == b || fabs(a - b) <= 4e-16 * fmax(fabs(a), fabs(b)); }

/* Whether the FMU has these values already. */
static int is_told(const ContainerFmu *what, const ContainerParameter *p, const double *values)
{
    if (!p->told || p->given) return 0;
    for (int k = 0; k < p->count && what->unit < 0; k++)
        if ((p->offset != 0.0 ? p->told[k] * p->scale + p->offset : p->told[k] * p->scale) != values[k]) return 0;
    if (what->unit < 0) return 1;
    for (int k = 0; k < p->count; k++) {
        double own = (values[k] - p->offset) / p->scale;
        if (p->offset != 0.0 ? !same(values[k], p->told[k] * p->scale + p->offset) : !same(own, p->told[k])) return 0;
    }
    return 1;
}

static void put_number(int type, void *row, size_t at, double value)
{
#define PUT(name, kind)                                                                                                \
    case BLOCKS_##name: ((kind *)row)[at] = (kind)value; break;
    switch (type) {
        PUT(FLOAT64, double)
        BLOCKS_CONVERTED(PUT)
    default: break;
    }
#undef PUT
}

/* One call for all that are to be set of a type, in their order; type -1: texts. */
static int set_type(InnerFmu *in, int type, int is_size, const double *settings, const int *wanted)
{
    const ContainerFmu *what = in->what;
    char name[40];
    size_t n = 0, references = 0;
    for (int i = 0; i < what->nparameters; i++)
        if (wanted[i] && what->parameters[i].type == type && what->parameters[i].is_size == is_size) n += (size_t)what->parameters[i].count;
    if (!n) return FMU_OK;
    uint32_t *refs = malloc(n * sizeof *refs);
    void *row = malloc(n * 8 + sizeof(char *) * n);
    int status = ERROR_;
    size_t at = 0;
    snprintf(name, sizeof name, "Set%s", type < 0 ? "String" : container_types[what->fmi - 2][type]);
    for (int i = 0; refs && row && i < what->nparameters; i++) {
        const ContainerParameter *p = &what->parameters[i];
        if (!wanted[i] || p->type != type || p->is_size != is_size) continue;
        refs[references++] = p->reference;
        for (int k = 0; k < p->count; k++, at++) {
            if (type < 0) ((const char **)row)[at] = p->text;
            else put_number(type, row, at, p->given ? p->given[k] : (settings[p->first + k] - p->offset) / p->scale);
        }
    }
    if (!refs || !row) complain(in, "there is no memory");
    else if (!found(in, name)) lacks(in, name);
    else if (what->fmi == 2) status = judged(in, name, FOUND(Set2, name)(caller(in), refs, references, row));
    else status = judged(in, name, FOUND(Set3, name)(caller(in), refs, references, row, n));
    free(refs);
    free(row);
    return status == FMU_OK ? FMU_OK : FMU_ERROR;
}

static int set_all(InnerFmu *in, int is_size, const double *settings, const int *wanted)
{
    const ContainerFmu *what = in->what;
    for (int i = 0; i < what->nparameters; i++) { /* types in the order in which they occur */
        int is_first = wanted[i] && what->parameters[i].is_size == is_size;
        for (int k = 0; k < i && is_first; k++)
            if (wanted[k] && what->parameters[k].is_size == is_size && what->parameters[k].type == what->parameters[i].type) is_first = 0;
        if (is_first && set_type(in, what->parameters[i].type, is_size, settings, wanted)) return FMU_ERROR;
    }
    return FMU_OK;
}

static int set_parameters(InnerFmu *in, const double *settings)
{
    const ContainerFmu *what = in->what;
    int *wanted = calloc((size_t)what->nparameters + 1, sizeof *wanted), sizes = 0;
    if (!wanted) return complain(in, "there is no memory");
    for (int i = 0; i < what->nparameters; i++) {
        const ContainerParameter *p = &what->parameters[i];
        wanted[i] = p->type < 0 || !is_told(what, p, settings + p->first);
        sizes |= wanted[i] && p->is_size;
    }
    int status = FMU_OK;
    if (sizes) status = called(in, "EnterConfigurationMode") || set_all(in, 1, settings, wanted) || called(in, "ExitConfigurationMode");
    status = status || set_all(in, 0, settings, wanted);
    free(wanted);
    return status ? FMU_ERROR : FMU_OK;
}

int inner_begin(InnerFmu *in, const double *settings, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    const ContainerFmu *what = in->what;
    if (!has_tolerance) has_tolerance = what->has_tolerance, tolerance = what->tolerance;
    if (!has_tolerance) tolerance = 0.0;
    if (!has_stop) stop = 0.0;
    if (what->fmi == 2) {
        if (!found(in, "SetupExperiment")) return lacks(in, "SetupExperiment");
        int status = FOUND(Setup2, "SetupExperiment")(caller(in), has_tolerance, tolerance, start, has_stop, stop);
        if (judged(in, "SetupExperiment", status) || set_parameters(in, settings)) return FMU_ERROR;
        if (called(in, "EnterInitializationMode")) return FMU_ERROR;
    } else {
        if (set_parameters(in, settings)) return FMU_ERROR;
        if (!found(in, "EnterInitializationMode")) return lacks(in, "EnterInitializationMode");
        int status = FOUND(Enter3, "EnterInitializationMode")(caller(in), has_tolerance, tolerance, start, has_stop, stop);
        if (judged(in, "EnterInitializationMode", status)) return FMU_ERROR;
    }
    return FMU_OK;
}

void inner_started(InnerFmu *in) { in->must_terminate = 1; }

/* --- states ------------------------------------------------------------------------------------------------------------------ */

/* FMI 2 and 3 name these functions differently. */
#define OF_STATE(verb, rest) (in->what->fmi == 2 ? verb "FMUstate" rest : verb "FMUState" rest)

/* Whether it was told why there is no function of this name to be called. */
static int has_not(InnerFmu *in, const char *name)
{
    if (in->is_lost) return complain(in, "after a fatal error it can only be reset");
    return found(in, name) ? FMU_OK : lacks(in, name);
}

int inner_get_state(InnerFmu *in, void **state)
{
    const char *name = OF_STATE("Get", "");
    if (has_not(in, name)) return FMU_ERROR;
    return judged(in, name, FOUND(State, name)(caller(in), state));
}

int inner_set_state(InnerFmu *in, void *state)
{
    const char *name = OF_STATE("Set", "");
    if (has_not(in, name)) return FMU_ERROR;
    in->must_terminate = 1;
    return judged(in, name, FOUND(Restore, name)(caller(in), state));
}

void inner_free_state(InnerFmu *in, void **state)
{
    const char *name = OF_STATE("Free", "");
    if (*state && !in->is_lost && found(in, name)) FOUND(State, name)(caller(in), state);
    *state = NULL;
}

unsigned char *inner_serialize(InnerFmu *in, void *state, size_t *size)
{
    const char *sizes = OF_STATE("Serialized", "Size"), *name = OF_STATE("Serialize", "");
    if (has_not(in, sizes) || has_not(in, name)) return NULL;
    if (judged(in, sizes, FOUND(Size, sizes)(caller(in), state, size))) return NULL;
    unsigned char *bytes = malloc(*size + 1);
    if (bytes && !judged(in, name, FOUND(Serialize, name)(caller(in), state, bytes, *size))) return bytes;
    free(bytes);
    return NULL;
}

int inner_deserialize(InnerFmu *in, const unsigned char *bytes, size_t size, void **state)
{
    const char *name = in->what->fmi == 2 ? "DeSerializeFMUstate" : "DeserializeFMUState";
    if (has_not(in, name)) return FMU_ERROR;
    return judged(in, name, FOUND(Deserialize, name)(caller(in), bytes, size, state));
}
