/* The file and the lines of a trace: see trace.h. */
#define _POSIX_C_SOURCE 200809L
#include "trace.h"
#include "fmi2.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#if defined(_WIN32)
#include <io.h>
#define open_new(path) _open(path, _O_WRONLY | _O_CREAT | _O_TRUNC | _O_BINARY, 0600)
#define write_at(file, data, n, at) (_lseeki64(file, at, SEEK_SET) < 0 ? -1 : _write(file, data, (unsigned)(n)))
#define cut_at(file, at) _chsize_s(file, at)
#define close _close
#else
#include <unistd.h>
#define open_new(path) open(path, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666)
#define write_at(file, data, n, at) pwrite(file, data, n, (off_t)(at))
#define cut_at(file, at) ftruncate(file, (off_t)(at))
#endif

enum { MOST_VALUES = 100, MOST_CHARACTERS = 503, MOST_AFTER = 65536, CROWDED = 32768 };

typedef struct {
    char *data;
    size_t used, room;
} Text;

/* The file is its first bytes, then, once these are full, a note of what is left out and two pieces: the present one
   grows; when it is full, it takes the place of the one before. */
struct BlocksTrace {
    int file, is_json, failed, is_tail;
    void (*sink)(void *, const char *);
    void *where;
    int64_t head, piece, base, at;      /* base: the bytes of the head; at: where the next line goes */
    int64_t n, in_before, in_piece, out; /* calls: all, in the two pieces, left out */
    Text line, after, inner, kept;      /* of the outermost call; of what comes in it; of calls in it; the present piece */
    int64_t hidden;                     /* lines of `after` that are left out */
    int64_t inner_ns, own_ns;           /* of the calls within the outermost one: what they took, and their shims did */
    int64_t outer; /* the number of the outermost call */
    int depth;
    BlocksTraced *first;
    char lock;
};

static const char *const words[] = {"ok", "warning", "discard", "error", "fatal", "pending"};

/* An FMU may log in threads of its own. */
static void lock(BlocksTrace *t)
{
#if defined(__GNUC__)
    while (__atomic_test_and_set(&t->lock, __ATOMIC_ACQUIRE)) {}
#else
    (void)t;
#endif
}

static void unlock(BlocksTrace *t)
{
#if defined(__GNUC__)
    __atomic_clear(&t->lock, __ATOMIC_RELEASE);
#else
    (void)t;
#endif
}

static int64_t nanoseconds(void)
{
    struct timespec now;
#if defined(_WIN32)
    timespec_get(&now, TIME_UTC);
#else
    clock_gettime(CLOCK_MONOTONIC, &now);
#endif
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

/* --- texts ---- */

static void put_bytes(Text *to, const char *bytes, size_t n)
{
    if (to->used + n + 1 > to->room) {
        size_t room = 2 * (to->used + n + 512);
        char *data = realloc(to->data, room);
        if (!data) return; /* a trace with a gap is better than no run */
        to->data = data, to->room = room;
    }
    memcpy(to->data + to->used, bytes, n);
    to->data[to->used += n] = 0;
}

static void put(Text *to, const char *text) { put_bytes(to, text, strlen(text)); }

static void put_form(Text *to, const char *form, ...)
{
    char line[256];
    va_list more;
    va_start(more, form);
    int n = vsnprintf(line, sizeof line, form, more);
    va_end(more);
    if (n > 0) put_bytes(to, line, (size_t)n < sizeof line ? (size_t)n : sizeof line - 1);
}

/* The shortest of 15 to 17 digits that is the number; with a point, whatever the language is. */
static void put_number(Text *to, double v, int is_json)
{
    char digits[40];
    if (!isfinite(v)) {
        static const char *const named[2][3] = {{"nan", "inf", "-inf"}, {"\"NaN\"", "\"Infinity\"", "\"-Infinity\""}};
        put(to, named[is_json][isnan(v) ? 0 : v > 0 ? 1 : 2]);
        return;
    }
    for (int n = 15; n <= 17; n++) {
        snprintf(digits, sizeof digits, "%.*g", n, v);
        if (n == 17 || strtod(digits, NULL) == v) break;
    }
    for (char *c = digits; *c; c++)
        if (!strchr("0123456789+-e", *c)) *c = '.';
    put(to, digits);
}

/* A character of UTF-8 and its length; 0xFFFD for a byte that begins none. */
static unsigned long character(const unsigned char *s, int *length)
{
    static const unsigned long least[] = {0, 0, 0x80, 0x800, 0x10000};
    int n = s[0] < 0x80 ? 1 : s[0] >> 5 == 6 ? 2 : s[0] >> 4 == 14 ? 3 : s[0] >> 3 == 30 ? 4 : 0;
    unsigned long c = n == 1 ? s[0] : n ? s[0] & (0x7F >> n) : 0;
    for (int i = 1; i < n; i++) {
        if (s[i] >> 6 != 2) n = 0;
        else c = c << 6 | (s[i] & 0x3F);
    }
    *length = n ? n : 1;
    return !n || c < least[n] || c > 0x10FFFF || (c >= 0xD800 && c < 0xE000) ? 0xFFFD : c;
}

/* A text of an FMU: what controls a terminal, or turns lines around, is escaped as JSON does it. */
static void put_text(Text *to, const char *text)
{
    const unsigned char *s = (const unsigned char *)(text ? text : "");
    for (int n = 0, length; *s; s += length, n++) {
        unsigned long c = character(s, &length);
        if (n == MOST_CHARACTERS) {
            put(to, "...");
            return;
        }
        if (c == '"' || c == '\\') put_form(to, "\\%c", (int)c);
        else if (c < 0x20 || (c >= 0x7F && c < 0xA0) || c == 0xFFFD || c == 0xFEFF || c == 0x61C ||
                 (c >= 0x200B && c <= 0x200F) || (c >= 0x2028 && c <= 0x202E) || (c >= 0x2066 && c <= 0x2069))
            put_form(to, "\\u%04lx", c);
        else put_bytes(to, (const char *)s, (size_t)length);
    }
}

static void put_quoted(Text *to, const char *text)
{
    put(to, "\"");
    put_text(to, text);
    put(to, "\"");
}

/* --- the file ---- */

static void write_all(BlocksTrace *t, const char *data, size_t n, int64_t at)
{
    while (n && !t->failed) {
        long long done = write_at(t->file, data, n, at);
        if (done < 0 && errno == EINTR) continue;
        if (done <= 0) t->failed = done < 0 ? errno : ENOSPC;
        else data += done, n -= (size_t)done, at += done;
    }
}

/* The present piece is full: it takes the place of the one before. */
static void turn(BlocksTrace *t)
{
    Text note = {0};
    t->out += t->in_before;
    t->in_before = t->in_piece, t->in_piece = 0;
    if (t->out) put_form(&note, t->is_json ? "{\"left_out\": %lld}\n" : "... %lld calls are left out here\n", (long long)t->out);
    if (note.data) write_all(t, note.data, note.used, t->base);
    t->at = t->base + (int64_t)note.used;
    write_all(t, t->kept.data, t->kept.used, t->at);
    t->at += (int64_t)t->kept.used;
    if (!t->failed && cut_at(t->file, t->at)) t->failed = errno;
    t->kept.used = 0;
    free(note.data);
}

/* Lines at the end of the file. is_last: no more comes to them, else they are written over. */
static void emit(BlocksTrace *t, const Text *lines, int64_t calls, int is_last)
{
    if (t->file < 0 || t->failed || !lines->used) return;
    int64_t n = (int64_t)lines->used;
    if (!t->is_tail && t->at + n > t->head && is_last) t->is_tail = 1, t->base = t->at;
    if (t->is_tail && is_last) {
        if ((int64_t)t->kept.used + n > t->piece && t->kept.used) turn(t);
        put_bytes(&t->kept, lines->data, lines->used);
        t->in_piece += calls;
    }
    write_all(t, lines->data, lines->used, t->at);
    if (is_last) t->at += n;
}

/* --- lines ---- */

static int is_written(const BlocksTrace *t) { return (t->file >= 0 && !t->failed) || t->sink; }

/* The text that a call writes to: its own line, or that of a call within another. */
static Text *text_of(const BlocksTraceCall *call)
{
    BlocksTrace *t = call->one->trace;
    return call->depth == 1 ? &t->line : &t->inner;
}

enum { OUTCOME = 21 }; /* characters */

static void put_begin(BlocksTraceCall *call)
{
    BlocksTraced *one = call->one;
    Text *to = text_of(call);
    char t[32] = "-";
    to->used = 0;
    if (call->is_json) {
        put_form(to, "{\"n\": %lld, ", (long long)call->n);
        if (call->depth > 1) put_form(to, "\"within\": %lld, ", (long long)one->trace->outer);
        put(to, "\"t\": ");
        if (one->t == one->t) put_number(to, one->t, 1);
        else put(to, "null");
        put(to, ", \"fmu\": ");
        put_quoted(to, one->path);
        put_form(to, ", \"call\": \"%s\", \"given\": {", one->functions[call->function]);
        return;
    }
    if (one->t == one->t) {
        Text number = {0};
        put_number(&number, one->t, 0);
        if (number.data) snprintf(t, sizeof t, "%s", number.data);
        free(number.data);
    }
    put_form(to, "%8lld  %-12s  %*s", (long long)call->n, t, OUTCOME, "...");
    put(to, "  ");
    put_text(to, one->path);
    put_form(to, call->depth > 1 ? "    %s" : "  %s", one->functions[call->function]);
}

static void put_label(BlocksTraceCall *call, const char *name)
{
    Text *to = text_of(call);
    if (call->is_json) {
        if (call->nitems++) put(to, ", ");
        put_quoted(to, name);
        put(to, ": ");
        return;
    }
    put(to, call->nitems++ ? ", " : call->is_out ? "  ->  " : "  ");
    put_text(to, name);
    put(to, " = ");
}

static double number_at(int kind, const void *values, size_t i)
{
    switch (kind) {
    case KIND_fmi2Real: return ((const double *)values)[i];
    case KIND_fmi3Float32: return (double)((const float *)values)[i];
    case KIND_fmi3Int8: return ((const int8_t *)values)[i];
    case KIND_fmi3UInt8: return ((const uint8_t *)values)[i];
    case KIND_fmi3Int16: return ((const int16_t *)values)[i];
    case KIND_fmi3UInt16: return ((const uint16_t *)values)[i];
    case KIND_fmi3Int32: return ((const int32_t *)values)[i];
    case KIND_fmi3UInt32: return ((const uint32_t *)values)[i];
    default: return NAN;
    }
}

static void put_element(Text *to, int kind, const void *values, size_t i, int is_json)
{
    switch (kind) {
    case KIND_fmi3Int64: put_form(to, "%lld", (long long)((const int64_t *)values)[i]); break;
    case KIND_fmi3UInt64: put_form(to, "%llu", (unsigned long long)((const uint64_t *)values)[i]); break;
    case KIND_fmi3Boolean: put(to, ((const uint8_t *)values)[i] ? "true" : "false"); break;
    case KIND_fmi2Boolean: put(to, ((const int *)values)[i] ? "true" : "false"); break;
    case KIND_size_t: put_form(to, "%llu", (unsigned long long)((const size_t *)values)[i]); break;
    case KIND_text: put_quoted(to, ((const char *const *)values)[i]); break;
    default: put_number(to, number_at(kind, values, i), is_json);
    }
}

static void put_array(Text *to, int kind, const void *values, size_t first, size_t n, int is_json)
{
    put(to, "[");
    for (size_t i = 0; i < n && i < MOST_VALUES; i++) {
        if (i) put(to, ", ");
        put_element(to, kind, values, first + i, is_json);
    }
    if (n > MOST_VALUES) put_form(to, is_json ? ", \"%llu more\"" : ", %llu more", (unsigned long long)(n - MOST_VALUES));
    put(to, "]");
}

static const BlocksTraceName *variable(const BlocksTraced *one, int call, uint32_t reference)
{
    int64_t low = 0, high = one->nnames;
    while (low < high) {
        int64_t middle = (low + high) / 2;
        const BlocksTraceName *v = &one->names[middle];
        if (v->call < call || (v->call == call && v->reference < reference)) low = middle + 1;
        else high = middle;
    }
    const BlocksTraceName *v = &one->names[low];
    return low < one->nnames && v->call == call && v->reference == reference ? v : NULL;
}

static const char *name_of(const BlocksTraceCall *call, uint32_t reference, char *room, size_t n)
{
    const char *function = call->one->functions[call->function];
    int letter = function[3] == '2' ? function[7] : 0; /* fmi2SetReal */
    const BlocksTraceName *v = variable(call->one, strchr("RIBS", letter) ? letter : letter ? 'R' : 0, reference);
    if (v) return v->name;
    snprintf(room, n, "reference %u", (unsigned)reference);
    return room;
}

/* Values of the variables that `references` names. */
static void put_variables(BlocksTraceCall *call, int kind, const void *values, size_t n)
{
    const BlocksTraced *one = call->one;
    const char *function = one->functions[call->function];
    int letter = function[3] == '2' ? strchr("RIBS", function[7]) ? function[7] : 'R' : 0;
    char room[40];
    size_t first = 0, shown = 0, i = 0;
    for (; i < call->nreferences && shown < MOST_VALUES && text_of(call)->used < CROWDED; i++) {
        size_t size = 1;
        if (n != call->nreferences) {
            const BlocksTraceName *v = variable(one, letter, call->references[i]);
            size = call->nreferences == 1 ? n : v ? (size_t)v->size : 0;
            if (first + size > n) size = n - first;
        }
        put_label(call, name_of(call, call->references[i], room, sizeof room));
        if (n == call->nreferences || (size == 1 && call->nreferences > 1))
            put_element(text_of(call), kind, values, first, call->is_json);
        else put_array(text_of(call), kind, values, first, size, call->is_json);
        first += size, shown += size;
    }
    if (i < call->nreferences) {
        put_label(call, "more variables");
        put_form(text_of(call), "%llu", (unsigned long long)(call->nreferences - i));
    }
}

static int is_one_of(const char *name, const char *names)
{
    size_t n = strlen(name);
    for (const char *at = names; (at = strstr(at, name)); at++)
        if (at[-1] == ' ' && at[n] == ' ') return 1;
    return 0;
}

static void put_value(BlocksTraceCall *call, const char *name, int kind, const void *values, size_t n)
{
    const BlocksTraced *one = call->one;
    Text *to = text_of(call);
    if (kind == KIND_fmi2ValueReference) {
        if (!strcmp(name, "vr")) {
            call->references = values, call->nreferences = n;
            return;
        }
        char room[40];
        put_label(call, name);
        put(to, "[");
        for (size_t i = 0; i < n && i < MOST_VALUES; i++) {
            if (i) put(to, ", ");
            put_quoted(to, name_of(call, ((const uint32_t *)values)[i], room, sizeof room));
        }
        put(to, "]");
        return;
    }
    if (is_one_of(name, " value values ") && call->references) {
        put_variables(call, kind, values, n);
        return;
    }
    if (kind == KIND_fmi2EventInfo) {
        const fmi2EventInfo *e = values;
        put_value(call, "newDiscreteStatesNeeded", KIND_fmi2Boolean, &e->newDiscreteStatesNeeded, 1);
        put_value(call, "terminateSimulation", KIND_fmi2Boolean, &e->terminateSimulation, 1);
        put_value(call, "nominalsOfContinuousStatesChanged", KIND_fmi2Boolean, &e->nominalsOfContinuousStatesChanged, 1);
        put_value(call, "valuesOfContinuousStatesChanged", KIND_fmi2Boolean, &e->valuesOfContinuousStatesChanged, 1);
        put_value(call, "nextEventTimeDefined", KIND_fmi2Boolean, &e->nextEventTimeDefined, 1);
        if (e->nextEventTimeDefined) put_value(call, "nextEventTime", KIND_fmi2Real, &e->nextEventTime, 1);
        return;
    }
    if (kind == KIND_fmi2Byte) {
        put_label(call, name);
        put_form(to, "\"%llu bytes\"", (unsigned long long)n);
        return;
    }
    /* Text shows what is not as usual. */
    if (!call->is_json && is_one_of(name, " noSetFMUStatePriorToCurrentPoint ")) return;
    if (!call->is_json && is_one_of(name, " lastSuccessfulTime ") && call->last == call->x[0] + call->x[1]) return;
    int is_flag = kind == KIND_fmi3Boolean || kind == KIND_fmi2Boolean;
    if (kind == KIND_size_t && !call->is_out) return; /* counts: the arrays show them */
    int is_set = is_flag && (kind == KIND_fmi3Boolean ? *(const uint8_t *)values != 0 : *(const int *)values != 0);
    if (is_flag && n == 1 && !is_set && !call->is_json) return;
    int is_vector = is_one_of(name, " x ") || (is_one_of(name, " values ") && kind == KIND_fmi2Real);
    const char *function = one->functions[call->function];
    int of_states = (strstr(function, "State") || strstr(function, "GetDerivatives")) && !strstr(function, "Nominals");
    if (is_vector && of_states && (int64_t)n == one->nstates && n <= MOST_VALUES) {
        char own[256];
        for (size_t i = 0; i < n && to->used < CROWDED; i++) {
            snprintf(own, sizeof own, strstr(function, "Derivatives") ? "der(%s)" : "%s", one->states[i]);
            put_label(call, own);
            put_element(to, kind, values, i, call->is_json);
        }
        return;
    }
    put_label(call, name);
    if (n == 1 && !is_vector) put_element(to, kind, values, 0, call->is_json);
    else put_array(to, kind, values, 0, n, call->is_json);
}

void blocks_trace_value(BlocksTraceCall *call, const char *name, int kind, const void *values, size_t n)
{
    if (call->is_out && values && n == 1) {
        if (kind == KIND_fmi3Boolean && !strcmp(name, "earlyReturn")) call->is_early = *(const uint8_t *)values != 0;
        if (kind == KIND_fmi2Real && !strcmp(name, "lastSuccessfulTime")) call->last = *(const double *)values;
    }
    if (!call->n || !values || text_of(call)->used > CROWDED) return;
    lock(call->one->trace);
    put_value(call, name, kind, values, n);
    unlock(call->one->trace);
}

/* A state of the FMU by its number, which is the same in each run. */
void blocks_trace_state(BlocksTraceCall *call, const void *state)
{
    int at = 0;
    if (!call->n) return;
    while (at < TRACE_STATES - 1 && call->one->saved[at] != state) at++;
    put_label(call, "state");
    put_form(text_of(call), "%d", at + 1);
}

/* The line of the outermost call and what came within it, to the file. */
static void show(BlocksTrace *t, int64_t calls, int is_last)
{
    Text lines = {0};
    put_bytes(&lines, t->line.data, t->line.used);
    put(&lines, t->is_json ? is_last ? "}\n" : "}}\n" : "\n");
    if (t->after.used) put_bytes(&lines, t->after.data, t->after.used);
    if (is_last && t->hidden)
        put_form(&lines, t->is_json ? "{\"lines_left_out\": %lld}\n" : "          ... %lld lines are left out here\n",
                 (long long)t->hidden);
    if (t->sink && is_last && lines.data) t->sink(t->where, lines.data);
    emit(t, &lines, calls, is_last);
    free(lines.data);
}

void blocks_trace_begin(BlocksTraced *one, int function, BlocksTraceCall *call)
{
    BlocksTrace *t = one->trace;
    memset(call, 0, sizeof *call);
    call->entered = t->depth ? nanoseconds() : 0;
    call->one = one, call->function = function, call->last = NAN;
    lock(t);
    call->depth = ++t->depth;
    t->n++;
    if (is_written(t) && call->depth <= 2) {
        call->n = t->n, call->is_json = t->is_json;
        if (call->depth == 1) t->after.used = 0, t->hidden = 0, t->outer = t->n;
        put_begin(call);
    }
    unlock(t);
}

void blocks_trace_given(BlocksTraceCall *call)
{
    BlocksTrace *t = call->one->trace;
    if (call->n && call->depth == 1 && t->file >= 0) {
        lock(t);
        show(t, 0, 0);
        unlock(t);
    }
    if (call->depth == 1) t->inner_ns = t->own_ns = 0;
    call->begun = nanoseconds();
}

/* Calls within the call may have used its text. */
void blocks_trace_returned(BlocksTraceCall *call)
{
    call->ns = nanoseconds() - call->begun - (call->depth == 1 ? call->one->trace->own_ns : 0);
    call->is_out = 1;
    call->nitems = 0;
    if (call->n && call->is_json) put(text_of(call), "}, \"gives\": {");
}

void blocks_trace_end(BlocksTraceCall *call, int status)
{
    BlocksTraced *one = call->one;
    BlocksTrace *t = one->trace;
    char number[24], outcome[64];
    lock(t);
    one->calls[call->function]++;
    one->ns[call->function] += call->ns - (call->depth == 1 ? t->inner_ns : 0);
    t->depth--;
    if (call->n) {
        Text *to = text_of(call);
        const char *word = status >= 0 && status < 6 ? words[status] : number;
        snprintf(number, sizeof number, "status %d", status);
        double us = (double)call->ns / 1000.0;
        if (call->is_json) {
            put_form(to, "}, \"status\": \"%s\", \"us\": %.1f", word, us);
            for (char *c = to->data + to->used; *--c != ' ';) /* a point, whatever the language is */
                if (*c == ',') *c = '.';
        } else {
            int is_short = us < 1e6;
            snprintf(outcome, sizeof outcome, is_short ? "%8.1f us  %-8.8s" : "%8.3f s   %-8.8s", is_short ? us : us / 1e6, word);
            for (char *c = outcome; *c; c++)
                if (*c == ',') *c = '.';
            char *place = to->data ? strstr(to->data, "...") : NULL; /* before any text of the FMU */
            if (place) memcpy(place + 3 - OUTCOME, outcome, OUTCOME < strlen(outcome) ? OUTCOME : strlen(outcome));
        }
        if (call->depth == 1) {
            show(t, t->n - call->n + 1, 1);
        } else if (t->after.used < MOST_AFTER) {
            put_bytes(&t->after, to->data, to->used);
            put(&t->after, call->is_json ? "}\n" : "\n");
        } else {
            t->hidden++;
        }
    }
    if (call->depth > 1) t->inner_ns += call->ns, t->own_ns += nanoseconds() - call->entered - call->ns;
    unlock(t);
}

void blocks_trace_message(BlocksTraced *one, int status, const char *category, const char *text)
{
    BlocksTrace *t = one->trace;
    const char *word = status >= 0 && status < 6 ? words[status] : "status";
    lock(t);
    if (is_written(t)) {
        Text *to = &t->after;
        if (!t->depth) to->used = 0, t->line.used = 0;
        if (to->used >= MOST_AFTER) {
            t->hidden++;
        } else if (t->is_json) {
            put_form(to, "{\"n\": %lld, \"fmu\": ", (long long)t->n);
            put_quoted(to, one->path);
            put_form(to, ", \"log\": \"%s\", \"category\": ", word);
            put_quoted(to, category);
            put(to, ", \"text\": ");
            put_quoted(to, text);
            put(to, "}\n");
        } else {
            put_form(to, "%*s%s (", 47, "log ", word);
            put_text(to, category);
            put(to, "): ");
            put_text(to, text);
            put(to, "\n");
        }
        if (!t->depth) emit(t, to, 0, 1);
        else if (to->used < MOST_AFTER && t->file >= 0 && t->line.used && t->depth == 1) show(t, 0, 0);
    }
    unlock(t);
}

/* --- what there is ---- */

BlocksTrace *blocks_trace_new(const char *path, int is_json, int64_t head, int64_t tail,
                              void (*sink)(void *, const char *), void *where)
{
    BlocksTrace *t = calloc(1, sizeof *t);
    if (!t) return NULL;
    t->file = -1, t->is_json = is_json, t->head = head, t->piece = tail, t->sink = sink, t->where = where;
    if (path && (t->file = open_new(path)) < 0) {
        free(t);
        return NULL;
    }
    if (path && !is_json) {
        Text line = {0};
        put_form(&line, "%8s  %-12s  %*s  FMU  function  arguments  ->  results\n", "call", "t [s]", -OUTCOME,
                 "   wall time, status");
        emit(t, &line, 0, 1);
        free(line.data);
    }
    return t;
}

int blocks_trace_close(BlocksTrace *t)
{
    if (t->file >= 0 && close(t->file) && !t->failed) t->failed = errno;
    t->file = -1;
    return t->failed;
}

void blocks_trace_free(BlocksTrace *t)
{
    blocks_trace_close(t);
    while (t->first) {
        BlocksTraced *one = t->first;
        t->first = one->next;
        free(one);
    }
    free(t->line.data), free(t->after.data), free(t->inner.data), free(t->kept.data), free(t);
}

BlocksTraced *blocks_trace_instance(BlocksTrace *t, const char *path, const BlocksTraceName *names, int64_t n,
                                    const char *const *states, int64_t nstates)
{
    BlocksTraced *one = calloc(1, sizeof *one);
    if (!one) return NULL;
    one->trace = t, one->path = path, one->names = names, one->nnames = n, one->states = states, one->nstates = nstates;
    one->t = NAN, one->next = t->first, t->first = one;
    return one;
}

static const BlocksTraceShim *shim_of(const char *function)
{
    const BlocksTraceShim *shim = strncmp(function, "fmi2", 4) ? blocks_trace_shims3() : blocks_trace_shims2();
    while (shim->name && strcmp(shim->name, function)) shim++;
    return shim->name ? shim : NULL;
}

void *blocks_trace_shim(BlocksTraced *one, const char *function, void *original)
{
    const BlocksTraceShim *shim = shim_of(function);
    if (!shim) return NULL;
    one->functions[shim->number] = shim->name;
    one->originals[shim->number] = original;
    return *(void *const *)&shim->shim; /* POSIX and Windows allow it, C does not know of it */
}

void blocks_trace_making(BlocksTraced *one, const char *function, const char *const *given, int n)
{
    const BlocksTraceShim *shim = shim_of(function);
    if (!shim) return;
    one->functions[shim->number] = shim->name;
    blocks_trace_begin(one, shim->number, &one->making);
    for (int i = 0; i < n; i++) {
        const char *const *value = &given[2 * i + 1];
        uint8_t is_true = !strcmp(*value, "true");
        int is_boolean = (is_true || !strcmp(*value, "false")) && strcmp(given[2 * i], "instanceName");
        blocks_trace_value(&one->making, given[2 * i], is_boolean ? KIND_fmi3Boolean : KIND_text,
                           is_boolean ? (const void *)&is_true : value, 1);
    }
    blocks_trace_given(&one->making);
}

void blocks_trace_made(BlocksTraced *one, void *component)
{
    one->component = component;
    blocks_trace_returned(&one->making);
    blocks_trace_end(&one->making, component ? 0 : 3);
}

int64_t blocks_trace_profile(const BlocksTraced *one, int k, const char **name, int64_t *ns)
{
    *name = k < TRACE_FUNCTIONS ? one->functions[k] : NULL;
    *ns = *name ? one->ns[k] : 0;
    return *name ? one->calls[k] : 0;
}
