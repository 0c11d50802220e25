/* The runtime: from instant to instant by a method, recording on the way. What it does is written in docs/semantics.md;
   the reference engine is its twin in Python and says more about the why.

   A run is never left half changed: what fails or pauses leaves it at the last accepted step or before the instant. */
#if defined(__OPTIMIZE__) && defined(__GNUC__) && !defined(__clang__)
/* It is compiled with every first model, and is not where the time goes. */
#pragma GCC optimize("O1", "fp-contract=off", "no-math-errno", "no-trapping-math")
#define HOT __attribute__((optimize("O2", "fp-contract=off", "no-math-errno", "no-trapping-math")))
#else
#define HOT
#endif
#define _POSIX_C_SOURCE 199309L /* clock_gettime */
#include "stiff.h"

#include <stdlib.h>
#include <time.h>


enum { CROWD = 1000, QUICK = 4096, MOST_PASSES = 100, SMOOTH = 4 };
static const double CROWD_PART = 1e-6;
/* As in the reference engine: _MANY, _HALVINGS, TO_AND_FRO. */
static const double MANY = 1e7;
enum { HALVINGS = 20, TO_AND_FRO = 16 };
static const double ON_THE_WAY[] = {
    1.0 / 1024, 1.0 / 256, 1.0 / 64, 1.0 / 16, 0.25, 0.5, 0.75, 15.0 / 16, 63.0 / 64, 255.0 / 256, 1023.0 / 1024, 1.0,
};
static const double QUARTERS[] = {0.0, 0.25, 0.5, 0.75, 1.0};
BLOCKS_QUARTICS(HOT static, double)

/* --- times -------------------------------------------------------------------------------------------------- */

/* The same where one of both is beyond 2^53. */
double blocks_long_ratio(__int128 numerator, int64_t denominator)
{
    if (!numerator) return 0.0;
    int negative = numerator < 0, shift = 0;
    unsigned __int128 n = negative ? -(unsigned __int128)numerator : (unsigned __int128)numerator;
    unsigned __int128 d = (unsigned __int128)denominator;
    /* A quotient of 60 bits or more, whose last bit also stands for all that follows. */
    while (n / d < ((unsigned __int128)1 << 60) && n < ((unsigned __int128)1 << 126)) n <<= 1, shift++;
    while (n / d >= ((unsigned __int128)1 << 62)) d <<= 1, shift--;
    uint64_t quotient = (uint64_t)(n / d);
    if (n % d) quotient |= 1;
    double value = ldexp((double)quotient, -shift);
    return negative ? -value : value;
}

double blocks_divided(const BlocksGrid *g, int64_t k)
{
    return blocks_ratio((__int128)g->start + (__int128)k * g->step, g->unit);
}

static double seconds(void)
{
    struct timespec now;
#if defined(_WIN32)
    timespec_get(&now, TIME_UTC);
#else
    clock_gettime(CLOCK_MONOTONIC, &now);
#endif
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int blocks_clock(BlocksSim *s)
{
    double now = seconds();
    if (now >= s->deadline || s->fired_events.used > 1 << 20) {
        s->budget = 0;
        return 1;
    }
    /* About a thousandth of the slice until the next look. */
    double spent = now - (s->deadline - s->slice), done = (double)(s->budget_start > 0 ? s->budget_start : 1);
    s->budget_start = spent > 1e-3 * s->slice || done > 1e6 ? (int64_t)done : (int64_t)done * 2;
    s->budget = s->budget_start;
    return 0;
}

/* --- memory ------------------------------------------------------------------------------------------------- */

static void *address_of(const BlocksEntry *e)
{
    void *address = e->place;
    if (!(e->flags & BLOCKS_HERE)) memcpy(&address, e->place, sizeof address);
    return address;
}

static size_t bytes_of(const BlocksEntry *e) { return (size_t)((e->count ? *e->count : 1) * e->n) * (size_t)e->size; }

void *blocks_allocate(const BlocksEntry *entries, int n)
{
    for (char *arena = NULL;;) {
        size_t total = 0;
        for (const BlocksEntry *e = entries; e < entries + n; e++) {
            if (address_of(e)) continue;
            char *row = arena + total;
            if (arena) memcpy(e->place, &row, sizeof row);
            total += (bytes_of(e) + 7) / 8 * 8 + 64;
        }
        if (arena) return arena;
        if (!(arena = calloc(total + 64, 1))) return NULL;
    }
}

void blocks_walk(BlocksWalk *w, void *place, size_t size)
{
    w->count += size;
    if (!w->at || !size) return;
    w->failed |= (size_t)(w->end - w->at) < size;
    if (w->failed) return;
    if (w->writes) memcpy(place, w->at, size);
    else memcpy(w->at, place, size);
    w->at += size;
}

void blocks_walk_entries(BlocksWalk *w, const BlocksEntry *entries, int n)
{
    for (const BlocksEntry *e = entries; e < entries + n; e++)
        if (e->flags & BLOCKS_SAVED) blocks_walk(w, address_of(e), bytes_of(e));
}

void blocks_walk_run(BlocksWalk *w, BlocksSim *s)
{
    BlocksPast *past = &s->past;
    blocks_walk_entries(w, s->entries, s->nsteady);
    if (s->keeps_past) return;
    const int64_t left = w->end - w->at, known = past->known, broken = past->broken;
    if (w->writes && (known < 0 || known > left || broken < 0 || broken > left || blocks_past_room(s, 0, 0))) {
        past->known = past->broken = 0;
        w->failed = 1;
    }
    blocks_walk_entries(w, s->entries + s->nsteady, s->nentries - s->nsteady);
}

int blocks_fail(BlocksSim *s, int failure, int culprit, double value)
{
    s->failure = failure;
    s->culprit = culprit;
    s->value = value;
    return BLOCKS_FAILED;
}

static int no_memory(BlocksSim *s)
{
    s->failure = -1;
    return BLOCKS_FAILED;
}

int blocks_list_room(BlocksList *list, int64_t more)
{
    if (list->used + more <= list->capacity) return 0;
    int64_t capacity = 2 * list->capacity > list->used + more ? 2 * list->capacity : list->used + more + 64;
    double *data = realloc(list->data, (size_t)capacity * sizeof(double));
    if (!data) return 1;
    list->data = data;
    list->capacity = capacity;
    return 0;
}

double *blocks_new_row(BlocksSim *s)
{
    BlocksRows *rows = &s->rows;
    int64_t width = 1 + rows->columns, capacity = rows->capacity;
    if (rows->nchunks) {
        int64_t most = ((int64_t)1 << 26) / (8 * width) + 1; /* a chunk has 64 MiB at most */
        capacity = 2 * capacity > 4096 ? 2 * capacity : 4096;
        if (capacity > most) capacity = most;
    }
    double bytes = (double)capacity * (double)width * 8;
    if (rows->bytes + bytes > s->setup->most_bytes) return NULL;
    if (rows->nchunks == rows->most_chunks) {
        int64_t count = 2 * rows->most_chunks + 16;
        double **chunks = realloc(rows->chunks, (size_t)count * sizeof(double *));
        if (!chunks) return NULL;
        rows->chunks = chunks;
        int64_t *counts = realloc(rows->counts, (size_t)count * sizeof(int64_t));
        if (!counts) return NULL;
        rows->counts = counts;
        rows->most_chunks = count;
    }
    double *chunk = malloc((size_t)capacity * (size_t)width * sizeof(double));
    if (!chunk) return NULL;
    rows->chunks[rows->nchunks] = chunk;
    rows->counts[rows->nchunks++] = capacity;
    rows->capacity = capacity;
    rows->bytes += bytes;
    rows->next = chunk;
    rows->end = chunk + capacity * width;
    return chunk;
}

/* Move all rows to `to`: `count` of them from `first`, then those of the chunks, which are freed one by one, so that
   hardly any stands twice. The last one, which may change yet, stays too, in front of the room for so many rows at `next`. */
void blocks_take_rows(BlocksSim *s, const double *first, int64_t count, double *to, double *next, int64_t room)
{
    BlocksRows *rows = &s->rows;
    int64_t width = 1 + rows->columns;
    memcpy(to, first, (size_t)(count * width) * sizeof(double));
    to += count * width;
    for (int64_t i = 0; i < rows->nchunks; i++) {
        double *chunk = rows->chunks[i];
        int64_t used = i + 1 < rows->nchunks ? rows->counts[i] * width : rows->next - chunk;
        memcpy(to, chunk, (size_t)used * sizeof(double));
        to += used;
        free(chunk);
    }
    memcpy(next, to - width, (size_t)width * sizeof(double));
    s->last_row = next;
    rows->nchunks = 0;
    rows->capacity = 1024;
    rows->next = next + width;
    rows->end = next + room * width;
}

HOT static int add_row(BlocksSim *s, double t, const double *values)
{
    double *row = blocks_row(s);
    if (!row) return no_memory(s);
    row[0] = t;
    memcpy(row + 1, values, (size_t)s->model->nlogged * sizeof(double));
    blocks_keep_row(s, row);
    return 0;
}

BLOCKS_INLINE int all_finite(const double *values, int n)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++) sum += values[i] * 0.0;
    return sum == 0.0;
}

/* --- inputs ------------------------------------------------------------------------------------------------- */

/* The number of times that are at most t, less 1. */
HOT static int64_t last_at(const double *t, int64_t n, double then)
{
    int64_t low = 0, high = n;
    while (low < high) {
        int64_t middle = (low + high) / 2;
        if (then < t[middle]) high = middle;
        else low = middle + 1;
    }
    return low - 1;
}

void blocks_inputs(BlocksSim *s, double t)
{
    int place = 0;
    s->is_constant = 1;
    for (int j = 0; j < s->setup->ntracks; j++) {
        const BlocksTrack *track = &s->setup->tracks[j];
        int64_t k = track->n > 1 ? last_at(track->t, track->n, t) : 0, row = k > 0 ? k : 0;
        int64_t following = track->linear && k >= 0 && k < track->n - 1 ? k + 1 : row;
        for (int i = 0; i < track->size; i++, place++) {
            s->base[place] = track->u[row * track->size + i];
            s->aim[place] = track->u[following * track->size + i];
            s->begin[place] = track->t[row];
            s->finish[place] = track->t[following];
            if (s->base[place] != s->aim[place]) s->is_constant = 0;
        }
    }
    if (place) memcpy(s->memory.u, s->base, (size_t)place * sizeof(double));
    s->moving = !s->is_constant || s->model->nh > 0 || s->polynomials;
}

HOT static double next_input_break(const BlocksSim *s, double t)
{
    double best = INFINITY;
    for (int j = 0; j < s->setup->ntracks; j++) {
        const BlocksTrack *track = &s->setup->tracks[j];
        if (track->n < 2) continue;
        int64_t k = last_at(track->t, track->n, t) + 1;
        if (k < track->n && track->t[k] < best) best = track->t[k];
    }
    return best;
}

/* --- histories; see docs/contract.md, "Delays" ------------------------------------------------------------------- */

static const double JUMP = 1e-9; /* relative size below which a jump or a bend is one of rounding and interpolation */

static double delayed(const BlocksSim *s, int i, double t)
{
    const BlocksPast *past = &s->past;
    const BlocksHistory *history = &s->setup->histories[i];
    int64_t passed = past->passed[i], n = s->model->nh;
    if (passed == 0) return history->before_at < 0 ? history->before : s->memory.p[history->before_at];
    double begin = past->breaks[passed - 1], scale = s->scale, delay = blocks_delay(s, i);
    int at_begin = blocks_is_due_at(t, begin + delay, scale);
    double then = at_begin ? begin : fmax(t - delay, begin);
    int64_t k = last_at(past->starts, past->known, then);
    if (passed < past->broken && blocks_is_due_at(past->breaks[passed] + delay, t, scale)) {
        then = past->breaks[passed];
        int64_t low = 0, high = past->known; /* the part that ends there */
        while (low < high) {
            int64_t middle = (low + high) / 2;
            if (past->starts[middle] < then) low = middle + 1;
            else high = middle;
        }
        k = low - 1;
    } else if (at_begin && k > 0 && past->starts[k] == begin) {
        /* What does not jump has one value there, and two polynomials that differ in its last bits. */
        double before = past->parts[((k - 1) * 6 + 5) * n + i], after = past->parts[k * 6 * n + i];
        if (fabs(after - before) <= JUMP * fmax(fabs(before), fabs(after))) return before;
    }
    if (k < 0) k = 0;
    const double *part = past->parts + k * 6 * n + i;
    if (then >= past->ends[k]) return part[5 * n];
    double theta = (then - past->starts[k]) / (past->ends[k] - past->starts[k]);
    return part[0] + theta * (part[n] + theta * (part[2 * n] + theta * (part[3 * n] + theta * part[4 * n])));
}

void blocks_outside(BlocksSim *s, double t)
{
    if (!s->is_constant) {
        for (int i = 0; i < s->model->nu; i++) {
            if (s->base[i] == s->aim[i]) continue;
            double share = (t - s->begin[i]) / (s->finish[i] - s->begin[i]);
            s->memory.u[i] = (1.0 - share) * s->base[i] + share * s->aim[i];
        }
    }
    if (s->polynomials) {
        int n = s->model->nu;
        const double *c = s->polynomials->terms, since = t - s->polynomials->t0;
        for (int i = 0; i < n; i++)
            s->memory.u[i] = c[i] + since * (c[n + i] + since * (c[2 * n + i] / 2 + since * (c[3 * n + i] / 6)));
    }
    for (int i = 0; i < s->model->nh; i++) s->memory.h[i] = delayed(s, i, t);
}

/* A program at (t, x), where inputs and histories are as they are then. */
BLOCKS_INLINE void evaluate(BlocksSim *s, BlocksProgram program, double t, const double *x, double *out)
{
    if (s->moving) blocks_outside(s, t);
    program(&s->memory, t, x, out);
}

void blocks_evaluate(BlocksSim *s, BlocksProgram program, double t, const double *x, double *out)
{
    evaluate(s, program, t, x, out);
}

void blocks_rates(BlocksSim *s, double t, const double *x, double *out)
{
    evaluate(s, s->model->rates, t, x, out);
    s->evaluations++;
}

HOT static double next_delayed(const BlocksSim *s)
{
    double best = INFINITY;
    for (int i = 0; i < s->model->nh; i++)
        if (s->past.passed[i] < s->past.broken)
            best = fmin(best, s->past.breaks[s->past.passed[i]] + blocks_delay(s, i));
    return best;
}

/* Whether a history breaks at t, from where on it is then seen after its break. */
static int pass_breaks(BlocksSim *s, double t)
{
    int moved = 0;
    BlocksPast *past = &s->past;
    for (int i = 0; i < s->model->nh; i++) {
        while (past->passed[i] < past->broken) {
            double due = past->breaks[past->passed[i]] + blocks_delay(s, i);
            if (!blocks_is_due_at(due, t, s->scale)) break;
            int order = past->orders[past->passed[i]] + 1;
            if (s->setup->histories[i].echoes && order < past->seen) past->seen = order;
            past->passed[i]++;
            moved = 1;
        }
    }
    return moved;
}

int blocks_past_room(BlocksSim *s, int64_t parts, int64_t breaks)
{
    for (BlocksEntry *e = s->entries + s->nsteady; e < s->entries + s->nentries; e++) {
        int64_t needed = *e->count + (e->count == &s->past.known ? parts : breaks);
        if (needed <= e->room) continue;
        int64_t room = (2 * e->room > needed ? 2 * e->room : needed) + 64;
        void *row = realloc(address_of(e), (size_t)(room * e->n) * (size_t)e->size);
        if (!row) return 1;
        memcpy(e->place, &row, sizeof row);
        e->room = room;
    }
    return 0;
}

/* A break at t, whose order is known once the signals after it are. */
static int add_break(BlocksSim *s, double t, int changed)
{
    BlocksPast *past = &s->past;
    if (changed && past->seen > 2) past->seen = 2;
    if (past->seen > SMOOTH || past->breaks[past->broken - 1] == t) return 0;
    if (blocks_past_room(s, 0, 1)) return no_memory(s);
    past->breaks[past->broken] = t;
    past->orders[past->broken++] = 0;
    past->open = 1;
    return 0;
}

/* A break at t of order 2, where inputs only take the next piece of an extrapolation; see run/history.py. */
static int add_course(BlocksSim *s, double t)
{
    BlocksPast *past = &s->past;
    if (past->breaks[past->broken - 1] == t) return 0;
    if (blocks_past_room(s, 0, 1)) return no_memory(s);
    if (past->seen > BLOCKS_COURSE) past->seen = BLOCKS_COURSE;
    past->breaks[past->broken] = t;
    past->orders[past->broken++] = BLOCKS_COURSE;
    return 0;
}

static void powers(const double *v, int64_t stride, double *a)
{
    double v0 = v[0], v1 = v[stride], v2 = v[2 * stride], v3 = v[3 * stride], v4 = v[4 * stride];
    /* By differences from the first value, so that what is constant stays so to the last bit. */
    v1 -= v0, v2 -= v0, v3 -= v0, v4 -= v0;
    a[0] = v0;
    a[1] = (48 * v1 - 36 * v2 + 16 * v3 - 3 * v4) / 3;
    a[2] = (-208 * v1 + 228 * v2 - 112 * v3 + 22 * v4) / 3;
    a[3] = (288 * v1 - 384 * v2 + 224 * v3 - 48 * v4) / 3;
    a[4] = (-128 * v1 + 192 * v2 - 128 * v3 + 32 * v4) / 3;
}

/* The weights of the dense output: x(theta) = x0 + sum_j weights[j] theta^(j+1), of some states. */
HOT static void weigh(BlocksSim *s, double h, const int *states, int n)
{
    const BlocksModel *model = s->model;
    int degree = model->degree, stages = model->stages;
    if (s->weighed) return;
    for (int a = 0; a < n; a++) {
        int i = states ? states[a] : a;
        double sums[BLOCKS_MOST_DEGREE] = {0.0, 0.0, 0.0, 0.0};
        for (int stage = 0; stage < stages; stage++) {
            double rate = s->k[stage][i];
            const double *share = model->dense + stage * degree;
            for (int j = 0; j < degree; j++) sums[j] += share[j] * rate;
        }
        for (int j = 0; j < degree; j++) s->weights[(size_t)i * BLOCKS_MOST_DEGREE + (size_t)j] = h * sums[j];
    }
}

HOT static void dense(const BlocksSim *s, double theta, const int *states, int n, double *out)
{
    const double *x = s->memory.x;
    int degree = s->model->degree;
    for (int a = 0; a < n; a++) {
        int i = states ? states[a] : a;
        const double *w = s->weights + (size_t)i * BLOCKS_MOST_DEGREE;
        double sum = 0.0;
        for (int j = degree - 1; j >= 0; j--) sum = theta * (w[j] + sum);
        out[i] = x[i] + sum;
    }
}

/* --- looking inside a step; see docs/semantics.md, "Inside a step" -------------------------------------------------- */

/* A step, or a piece of it, in parts from left to right. Each is so short that nothing periodic makes more than `most` of
   a turn in it, and that the polynomial through five values tells each signal. Twin: run/step_parts.py. */
typedef struct {
    BlocksSim *s;
    const BlocksLook *look;
    double t0, h, t1;     /* the piece */
    double from, h_dense; /* the begin of the step, and the length of its dense output */
    const double *x1;     /* the states at t1; null: as the dense output has them */
    const double *nodes;  /* null: only phases count */
    double most;
    const double *checks; /* (count) where the polynomial is compared */
    int count, ignores_far;
    double spans, sizes;  /* it may be off by spans * what a value moves + sizes * (atol + rtol |value|) */
    /* the part: from k to k + 1, in units of 2^-level of the piece */
    int64_t k;
    int level, has_begun, knows_begin, knows_phase;
    int64_t tried, split;
    double begin, end;    /* from 0 to 1 */
    double *values;       /* (6, n): at the nodes, and one more */
} Parts;

enum { DEEPEST = 24, MOST_TRIED = 1 << 20, MOST_TOLD = 1 << 10, MOST_SPLIT = 4096, MOST_BETWEEN = 100000 };
/* Irrational, so that no signal whose values repeat from node to node repeats there too. */
static const double CHECKS[] = {0.118034, 0.763932, 0.367879, 0.118034, 0.763932};

static Parts parts_of(BlocksSim *s, int look, double t0, double t1, double h_dense)
{
    const BlocksModel *model = s->model;
    Parts made = {.s = s, .look = &model->looks[look], .t0 = t0, .h = t1 - t0, .t1 = t1, .from = s->t,
                  .h_dense = h_dense, .most = 0.25, .values = s->part_values};
    weigh(s, h_dense, made.look->states, made.look->nstates);
    return made;
}

static double part_time(const Parts *p, double theta)
{
    return theta == 0.0 ? p->t0 : theta == 1.0 ? p->t1 : p->t0 + theta * p->h;
}

static void take_slack(const BlocksSim *s, double *crossings);

static double part_at(Parts *p, double theta, BlocksProgram program, double *out)
{
    BlocksSim *s = p->s;
    double t = part_time(p, theta);
    const double *x = s->xs;
    if (theta == 0.0 && t == s->t) x = s->memory.x;
    else if (theta == 1.0 && p->x1) x = p->x1;
    else dense(s, ((p->t0 - p->from) + theta * p->h) / p->h_dense, p->look->states, p->look->nstates, s->xs);
    evaluate(s, program, t, x, out);
    return t;
}

static int values_at(Parts *p, double theta, double *out)
{
    double t = part_at(p, theta, p->look->values, out);
    if (p->look != &p->s->model->looks[BLOCKS_CROSSINGS])
        return all_finite(out, p->look->n) ? 0 : blocks_fail(p->s, BLOCKS_NOT_FINITE, 0, NAN);
    for (int j = 0; j < p->look->n; j++)
        if (isnan(out[j])) return blocks_fail(p->s, BLOCKS_NOT_A_NUMBER, j, t);
    take_slack(p->s, out);
    return 0;
}

/* The phases, and for each delay that is read how many parts of the past have gone by, eight to a turn. */
static void phases_at(Parts *p, double theta, double *out)
{
    const BlocksLook *look = p->look;
    const BlocksPast *past = &p->s->past;
    double t = part_time(p, theta);
    if (look->nphases) part_at(p, theta, look->phases, out);
    for (int i = 0; i < look->nhistories; i++) {
        double then = t - blocks_delay(p->s, look->histories[i]);
        int64_t k = last_at(past->starts, past->known, then);
        double in = k < 0 ? 0.0 : fmin((then - past->starts[k]) / (past->ends[k] - past->starts[k]), 1.0);
        out[look->nphases + i] = (k < 0 ? 0.0 : ((double)k + in) / 8);
    }
}

static void not_seen(Parts *p, int what)
{
    BlocksUnseen *unseen = &p->s->unseen[p->look - p->s->model->looks];
    if (!isnan(unseen->t)) return;
    unseen->t = part_time(p, p->begin);
    unseen->what = what;
}

/* A value that the polynomial through values (5, n) at nodes misses by more than it may, of those given at theta; or -1. */
static int worst_off(const BlocksSim *s, const BlocksLook *look, const double *nodes, double theta, const double *values,
                     const double *given, double spans, double sizes, int ignores_far)
{
    int n = look->n;
    double w[5];
    for (int k = 0; k < 5; k++) {
        w[k] = 1.0;
        for (int j = 0; j < 5; j++)
            if (j != k) w[k] *= (theta - nodes[j]) / (nodes[k] - nodes[j]);
    }
    for (int i = 0; i < n; i++) {
        if (look->bent && !look->bent[i]) continue;
        const double *v = values + i;
        double low = v[0], high = v[0], made = w[0] * v[0];
        for (int k = 1; k < 5; k++) {
            double y = v[k * n];
            low = blocks_smaller(low, y), high = blocks_larger(high, y), made += w[k] * y;
        }
        double span = high - low, size = blocks_larger(fabs(low), fabs(high));
        double allowed = spans * span + sizes * (s->setup->plain_atol + s->setup->rtol * size);
        if (!(fabs(made - given[i]) > allowed)) continue; /* what is not finite is for others to see */
        if (ignores_far) {
            double d = given[i], least = (low > 0.0) == (high > 0.0) ? blocks_smaller(fabs(low), fabs(high)) : 0.0;
            if ((d > 0.0) == (low > 0.0) && blocks_smaller(least, fabs(d)) > 3.0 * span) continue;
        }
        return i;
    }
    return -1;
}

/* The value that a part misses; or -1; where it failed: -2. */
static int worst_missed(Parts *p)
{
    double *given = p->values + 5 * p->look->n;
    for (int c = 0; c < p->count; c++) {
        double theta = p->checks[c];
        if (values_at(p, p->begin + theta * (p->end - p->begin), given)) return -2;
        int missed = worst_off(p->s, p->look, p->nodes, theta, p->values, given, p->spans, p->sizes, p->ignores_far);
        if (missed >= 0) return missed;
    }
    return -1;
}

/* The next part: 1; none is left: 0; it failed: -1. */
static int next_part(Parts *p)
{
    const BlocksLook *look = p->look;
    BlocksSim *s = p->s;
    int n = look->n, m = look->nphases + look->nhistories;
    double *phases = s->part_phases;
    if (p->has_begun) {
        if (p->end == 1.0) return 0;
        if (p->nodes) memcpy(p->values, p->values + 4 * n, (size_t)n * sizeof(double));
        memcpy(phases, phases + 2 * m, (size_t)m * sizeof(double));
        p->knows_begin = p->knows_phase = 1;
        p->k++;
        while (p->level && !(p->k & 1)) p->k >>= 1, p->level--;
    }
    p->has_begun = 1;
    double least = 64 * blocks_ulp(fmax(fabs(p->t0), fabs(p->t1)));
    int64_t most = isnan(s->unseen[look - s->model->looks].t) ? MOST_TRIED : MOST_TOLD; /* once it is told, no more of that */
    for (;; p->tried++) {
        double width = ldexp(1.0, -p->level);
        int is_last = p->level >= DEEPEST || p->h * width <= least || p->tried >= most;
        p->begin = (double)p->k * width;
        p->end = (double)(p->k + 1) * width;
        if (m) {
            if (!p->knows_phase) phases_at(p, p->begin, phases);
            p->knows_phase = 1;
            phases_at(p, p->begin + 0.5 * width, phases + m);
            phases_at(p, p->end, phases + 2 * m);
            double turns = 0.0;
            int fastest = 0;
            for (int i = 0; i < m; i++) {
                double made = fabs(phases[m + i] - phases[i]) + fabs(phases[2 * m + i] - phases[m + i]);
                if (made > turns) turns = made, fastest = i;
            }
            /* The past has short parts where it bends or where instants are close: those are seen, as they are resolved. */
            if (turns > p->most && is_last && (fastest < look->nphases || p->tried >= most)) not_seen(p, fastest);
            if (turns > p->most && !is_last) {
                do p->level++, p->k <<= 1, turns /= 2;
                while (turns > p->most && p->level < DEEPEST);
                continue;
            }
        }
        if (!p->nodes) return 1;
        if (!p->knows_begin && values_at(p, p->begin, p->values)) return -1;
        p->knows_begin = 1;
        for (int k = 1; k < 5; k++)
            if (values_at(p, k == 4 ? p->end : p->begin + p->nodes[k] * width, p->values + k * n)) return -1;
        if (is_last || !p->count || p->split > MOST_SPLIT) return 1;
        int missed = worst_missed(p);
        if (missed == -2) return -1;
        if (missed == -1) { /* what can be resolved goes on; noise, of which no part ever is, comes to its end */
            p->split = p->split > 2 ? p->split - 2 : 0;
            return 1;
        }
        if (++p->split > MOST_SPLIT) not_seen(p, -1 - missed);
        p->level++;
        p->k <<= 1;
    }
}

static int order_of_break(const BlocksSim *s, int64_t first)
{
    const BlocksPast *past = &s->past;
    int n = s->model->nh, bends = 0;
    if (first == 0) return 0;
    const double *before = past->parts + (first - 1) * 6 * n, *after = past->parts + first * 6 * n;
    double h0 = past->ends[first - 1] - past->starts[first - 1], h1 = past->ends[first] - past->starts[first];
    for (int i = 0; i < n; i++) {
        double size = 0.0;
        for (int j = 0; j < 6; j++) size = fmax(size, fmax(fabs(before[j * n + i]), fabs(after[j * n + i])));
        if (fabs(before[5 * n + i] - after[i]) > JUMP * size) return 0;
        double slope0 = (before[n + i] + 2 * before[2 * n + i] + 3 * before[3 * n + i] + 4 * before[4 * n + i]) / h0;
        double slope1 = after[n + i] / h1, steep = fmax(fabs(slope0), fabs(slope1));
        if (fabs(slope0 - slope1) > 1e-3 * steep + JUMP * size / fmin(h0, h1)) bends = 1;
    }
    return bends ? 1 : past->seen;
}

/* The past with a step to t1, in parts so short that their polynomials give the signals. */
static int remember(BlocksSim *s, double t1, double h_dense)
{
    BlocksPast *past = &s->past;
    int n = s->model->nh, got;
    int64_t first = past->known, known = past->known;
    if (t1 <= s->t) return 0;
    Parts p = parts_of(s, BLOCKS_REMEMBERED, s->t, t1, h_dense);
    p.x1 = s->x1, p.nodes = QUARTERS, p.sizes = 0.1;
    p.checks = CHECKS, p.count = p.look->checks;
    while ((got = next_part(&p)) > 0) {
        past->known = known; /* the part is written behind what is known */
        if (blocks_past_room(s, 1, 0)) return no_memory(s);
        past->known = first;
        double *part = past->parts + known * 6 * n;
        for (int i = 0; i < n; i++) {
            double a[5];
            powers(p.values + i, n, a);
            for (int j = 0; j < 5; j++) part[j * n + i] = a[j];
            part[5 * n + i] = p.values[4 * n + i];
        }
        past->starts[known] = part_time(&p, p.begin);
        past->ends[known] = part_time(&p, p.end);
        known++;
    }
    if (got < 0) return BLOCKS_FAILED;
    past->known = known;
    return 0;
}

/* After a remembered step is taken: the order of the last break is known, and what no history sees is forgotten. */
static void settle_past(BlocksSim *s, int64_t first, double t)
{
    BlocksPast *past = &s->past;
    if (past->open) past->orders[past->broken - 1] = order_of_break(s, first);
    past->open = 0;
    past->seen = SMOOTH + 1;
    if (!s->keeps_past) blocks_forget(s, t);
}

void blocks_forget(BlocksSim *s, double t)
{
    BlocksPast *past = &s->past;
    int n = s->model->nh;
    if (!n) return;
    double longest = 0.0;
    int64_t done = past->passed[0];
    for (int i = 0; i < n; i++) {
        longest = fmax(longest, blocks_delay(s, i));
        if (past->passed[i] < done) done = past->passed[i];
    }
    int64_t old = last_at(past->ends, past->known, t - longest);
    if (old < 0) old = 0;
    done = done > 1 ? done - 1 : 0;
    if (old < (past->known / 2 > 1024 ? past->known / 2 : 1024) && done < (past->broken / 2 > 1024 ? past->broken / 2 : 1024))
        return;
    for (const BlocksEntry *e = s->entries + s->nsteady; e < s->entries + s->nentries; e++) {
        size_t size = (size_t)e->n * (size_t)e->size, gone = (size_t)(e->count == &past->known ? old : done) * size;
        char *row = address_of(e);
        memmove(row, row + gone, (size_t)*e->count * size - gone);
    }
    past->known -= old;
    past->broken -= done;
    for (int i = 0; i < n; i++) past->passed[i] -= done;
}

/* --- recording ---------------------------------------------------------------------------------------------- */

HOT int blocks_logged(BlocksSim *s, double *out)
{
    evaluate(s, s->model->logged, s->t, s->memory.x, out);
    return all_finite(out, s->model->nlogged) ? 0 : blocks_fail(s, BLOCKS_NOT_FINITE, 0, NAN);
}

/* A row where the grid asks for it, and at the stop; another instant at the time of the last one changes it. What is
   recorded is computed for these alone. */
HOT int blocks_record_on_grid(BlocksSim *s)
{
    const double point = blocks_next_row(s), t = s->t;
    const int is_on_grid = blocks_joins(s, point, t), is_again = !is_on_grid && s->last_row && blocks_joins(s, s->last_row[0], t);
    if (!is_on_grid && !is_again && t != s->setup->end && s->last_row) return 0;
    if (blocks_logged(s, s->row_values)) return BLOCKS_FAILED;
    if (is_again) memcpy(s->last_row + 1, s->row_values, (size_t)s->model->nlogged * sizeof(double));
    else if (add_row(s, is_on_grid && t != s->setup->end ? point : t, s->row_values)) return BLOCKS_FAILED;
    s->row += is_on_grid;
    return 0;
}

/* A row where the grid or a jump asks for it, but none twice; in a jump, after that of the left values. */
static int record(BlocksSim *s, const double *left)
{
    const BlocksSetup *setup = s->setup;
    int n = s->model->nlogged;
    double t = s->t, *right = s->row_values;
    if (setup->is_silent) return 0;
    if (!setup->has_jumps) return blocks_record_on_grid(s);
    if (blocks_logged(s, right)) return BLOCKS_FAILED;
    double last = s->last_row ? s->last_row[0] : NAN;
    int on_grid = setup->every.is_given ? t == blocks_next_row(s) : t != last;
    int jumps = 0, differs = 0;
    for (int i = 0; i < n; i++) {
        if (left && left[i] != right[i]) jumps = 1;
        if (!s->last_row || s->last_row[1 + i] != right[i]) differs = 1;
    }
    if (jumps) {
        int is_new = t != last;
        if (is_new && add_row(s, t, left)) return BLOCKS_FAILED;
        if ((is_new || differs) && add_row(s, t, right)) return BLOCKS_FAILED;
    } else if (on_grid || !s->last_row || (t == setup->end && t != last)) {
        if (add_row(s, t, right)) return BLOCKS_FAILED;
    }
    if (setup->every.is_given && on_grid) s->row++;
    return 0;
}

int blocks_record_step(BlocksSim *s) { return record(s, NULL); }

int blocks_record(BlocksSim *s)
{
    if (blocks_logged(s, s->row_values)) return BLOCKS_FAILED;
    return add_row(s, s->t, s->row_values);
}

/* Without a grid, rows inside the step to t1 where what is recorded turns faster than the steps follow each other. */
static int rows_between(BlocksSim *s, double t1, double h)
{
    const BlocksLook *look = &s->model->looks[BLOCKS_LOGGED];
    if (!look->nphases || s->setup->is_silent || t1 <= s->t) return 0;
    Parts p = parts_of(s, BLOCKS_LOGGED, s->t, t1, h);
    p.most = 0.125;
    while (next_part(&p) > 0 && p.end < 1.0) {
        double t = part_time(&p, p.end);
        if (s->last_row && !(t > s->last_row[0])) continue;
        if (s->between == MOST_BETWEEN) {
            not_seen(&p, 0);
            s->unseen[BLOCKS_LOGGED].rows = BLOCKS_LEFT_OUT;
            return 0;
        }
        if (values_at(&p, p.end, s->row_values)) return BLOCKS_FAILED;
        if (add_row(s, t, s->row_values)) return BLOCKS_FAILED;
        s->between++;
    }
    return 0;
}

/* Note where what is recorded turns more than half a turn from row to row of the grid. */
void blocks_look_at_rows(BlocksSim *s, double t1, double h)
{
    const BlocksGrid *grid = &s->setup->every;
    BlocksUnseen *unseen = &s->unseen[BLOCKS_LOGGED];
    if (!isnan(unseen->t) || t1 <= s->t) return;
    if ((double)grid->step / (double)grid->unit >= s->setup->end - s->setup->start) return; /* the ends alone are asked for */
    Parts p = parts_of(s, BLOCKS_LOGGED, s->t, t1, h);
    double *phases = s->part_phases, most = 0.5 * (t1 - s->t) * (double)grid->unit / (double)grid->step;
    phases_at(&p, 0.0, phases);
    phases_at(&p, 1.0, phases + p.look->nphases + p.look->nhistories);
    for (int i = 0; i < p.look->nphases; i++) {
        double turns = fabs(phases[p.look->nphases + p.look->nhistories + i] - phases[i]);
        if (turns > most) *unseen = (BlocksUnseen){s->t, i, BLOCKS_BETWEEN_ROWS}, most = turns;
    }
}

/* Rows of the recording grid strictly inside the step to t1; h: of its dense output; outstanding: an instant follows. */
int blocks_rows_inside(BlocksSim *s, double t1, double h, int outstanding)
{
    const BlocksSetup *setup = s->setup;
    const BlocksModel *model = s->model;
    if (!setup->every.is_given) return rows_between(s, t1, h);
    if (s->model->looks[BLOCKS_LOGGED].nphases && !(s->steps % 64)) blocks_look_at_rows(s, t1, h);
    double t = blocks_next_row(s);
    if (!(t < t1)) return 0;
    const BlocksLook *look = &model->looks[BLOCKS_LOGGED];
    weigh(s, h, look->states, look->nstates);
    int n = model->nlogged;
    double *row = NULL;
    for (; t < t1; t = blocks_next_row(s)) {
        if (outstanding && blocks_joins(s, t, t1)) break;
        row = blocks_row(s);
        if (!row) return no_memory(s);
        dense(s, (t - s->t) / h, look->states, look->nstates, s->xs);
        if (s->moving) blocks_outside(s, t);
        model->logged(&s->memory, t, s->xs, row + 1);
        if (!all_finite(row + 1, n)) return blocks_fail(s, BLOCKS_NOT_FINITE, 0, NAN);
        row[0] = t;
        blocks_keep_row(s, row);
        s->row++;
    }
    return 0;
}

/* --- measures; see docs/diagram_file.md, "measures"; twins: run/measures.py, run/step_polynomial.py --------------- */

enum { FINE = 128 };
/* Functions of other optimization are not inlined. */
#define LEAST(a, b) ((a) < (b) ? (a) : (b))
#define MOST(a, b) ((a) > (b) ? (a) : (b))

/* The values at the ends of 128 equal pieces; both ends exactly. */
HOT static void finely(const double *y, double *fine)
{
    double a[5];
    quartic(y, a);
    for (int k = 1; k < FINE; k++) fine[k] = at_share(a, k * (1.0 / FINE));
    fine[0] = y[0], fine[FINE] = y[4];
}

HOT static inline void bounds(const double *y, double *low, double *high)
{
    *low = *high = y[0];
    for (int k = 1; k < 5; k++) *low = LEAST(*low, y[k]), *high = MOST(*high, y[k]);
}

/* The values at the turns of the quartic, in order (at most FINE - 1); how many. */
HOT static int turns_of(const double *y, double *turns)
{
    double fine[FINE + 1], a[5];
    int rises = 0, falls = 0, count = 0;
    for (int k = 0; k < 4; k++) rises |= y[k + 1] > y[k], falls |= y[k + 1] < y[k];
    if (!(rises && falls)) { /* a turn between the first two or the last two hides from the nodes */
        quartic(y, a);
        double second = at_share(a, 1.0 / FINE), last = at_share(a, 1.0 - 1.0 / FINE);
        if (!((second - y[0]) * (y[1] - y[0]) < 0.0) && !((y[4] - last) * (y[4] - y[3]) < 0.0)) return 0;
    }
    finely(y, fine);
    for (int k = 1; k < FINE; k++) {
        double before = fine[k] - fine[k - 1], after = fine[k + 1] - fine[k];
        if (before * after <= 0.0 && before != after)
            turns[count++] = fine[k] - (before + after) * (before + after) / (8 * (after - before));
    }
    return count;
}

/* The least and the largest of low, high and what the quartic reaches. */
HOT static void reached(const double *y, double *low, double *high)
{
    double bottom, top, turns[FINE];
    bounds(y, &bottom, &top);
    double beyond = REACH * (top - bottom);
    *low = LEAST(*low, bottom), *high = MOST(*high, top);
    if (!(bottom - beyond < *low || top + beyond > *high)) return;
    for (int i = turns_of(y, turns) - 1; i >= 0; i--)
        *low = LEAST(*low, turns[i]), *high = MOST(*high, turns[i]);
}

HOT static double variation(const double *y)
{
    double turns[FINE], sum = 0.0, from = y[0];
    int count = turns_of(y, turns);
    for (int i = 0; i < count; i++) sum += fabs(turns[i] - from), from = turns[i];
    return sum + fabs(y[4] - from);
}

/* The integral of |e|, or of t |e|. */
HOT static double absolute(const double *e, double t, double h, int is_timed)
{
    double low, high, fine[FINE + 1], a[5], values[5], sum = 0.0, from = 0.0;
    bounds(e, &low, &high);
    if (!(low < 0.0 && high > 0.0)) {
        for (int k = 0; k < 5; k++) values[k] = fabs(e[k]) * (is_timed ? t + LOBATTO[k] * h : 1.0);
        return h * weighted(values);
    }
    finely(e, fine);
    quartic(e, a);
    for (int k = 0; k <= FINE; k++) { /* piece by piece between its zeros */
        if (k < FINE && !(fine[k] * fine[k + 1] < 0.0)) continue;
        double to = k == FINE ? 1.0 : (k + fine[k] / (fine[k] - fine[k + 1])) / FINE;
        for (int i = 0; i < 5; i++) {
            double theta = from + (to - from) * LOBATTO[i];
            values[i] = fabs(at_share(a, theta)) * (is_timed ? t + theta * h : 1.0);
        }
        sum += (to - from) * weighted(values);
        from = to;
    }
    return h * sum;
}

/* Only a part that goes further than all that follow, upwards or downwards, can be the last outside of a band. */
static void thin_out(BlocksList *path)
{
    double least = INFINITY, most = -INFINITY;
    int64_t kept = path->used;
    if (!kept) return;
    for (int64_t at = path->used - 7; at >= 0; at -= 7) {
        double *row = path->data + at, low, high;
        bounds(row + 2, &low, &high);
        double beyond = REACH * (high - low);
        int counts = low - beyond < least || high + beyond > most;
        least = LEAST(least, LEAST(row[2], row[6]));
        most = MOST(most, MOST(row[2], row[6]));
        if (counts) memmove(path->data + (kept -= 7), row, 7 * sizeof(double));
    }
    memmove(path->data, path->data + kept, (size_t)(path->used - kept) * sizeof(double));
    path->used -= kept;
}

/* Integrals of e, e^2, and e by the cosine and the sine of the fundamental, `since` after the phase 0. */
static void harmonic(const double *e, double since, double h, double omega, BlocksMeasured *made)
{
    double a[5], sums[4] = {0.0, 0.0, 0.0, 0.0};
    int64_t pieces = (int64_t)ceil(h * omega / 0.78539816339744831); /* of an eighth of a turn */
    quartic(e, a);
    for (int64_t k = 0; k < pieces; k++)
        for (int i = 0; i < 5; i++) {
            double theta = ((double)k + LOBATTO[i]) / (double)pieces, at = omega * (since + theta * h), y = at_share(a, theta);
            double w = NODE_WEIGHTS[i] * y;
            sums[0] += w, sums[1] += w * y, sums[2] += w * cos(at), sums[3] += w * sin(at);
        }
    double width = h / (double)pieces;
    made->target += width * sums[0], made->total += width * sums[1], made->low += width * sums[2], made->high += width * sums[3];
}

/* Count changes of sign: `high` is the sign before, or neither 1 nor -1. What is no further than atol from 0 has none. */
static void count_signs(const double *e, double atol, BlocksMeasured *made)
{
    double low, high, fine[FINE + 1];
    bounds(e, &low, &high);
    double beyond = REACH * (high - low);
    int is_plain = low - beyond > atol || high + beyond < -atol || (low - beyond >= -atol && high + beyond <= atol);
    if (is_plain) fine[0] = e[0];
    else finely(e, fine);
    for (int k = 0; k <= (is_plain ? 0 : FINE); k++) {
        if (fabs(fine[k]) <= atol) continue;
        double sign = fine[k] > 0.0 ? 1.0 : -1.0;
        made->total += sign == -made->high;
        made->high = sign;
    }
}

/* Room for so many parts in each path. */
HOT static int path_room(BlocksSim *s, int64_t parts)
{
    for (int i = 0; s->setup->has_paths && i < s->setup->nmeasures; i++) {
        BlocksList *path = &s->measured[i].path;
        int kind = s->setup->measures[i].kind;
        if ((kind != BLOCKS_SETTLING && kind != BLOCKS_RISE) || path->used + 7 * parts <= path->capacity) continue;
        if (kind == BLOCKS_SETTLING) thin_out(path);
        if (2 * path->used + 7 * parts > path->capacity && blocks_list_room(path, path->used + 7 * parts)) return no_memory(s);
    }
    return 0;
}

/* Take in the values (5, 2 nmeasures) of a part from t on, for one measure. h 0: after an instant. */
HOT static void take(BlocksSim *s, int i, double t, double h, const double *values)
{
    const int kind = s->setup->measures[i].kind, n = s->model->nmeasured;
    BlocksMeasured *made = &s->measured[i];
    double e[5];
    values += 2 * i;
    _Pragma("GCC unroll 5") for (int k = 0; k < 5; k++) e[k] = values[k * n] - values[k * n + 1];
    if (isnan(made->first)) {
        made->first = t, made->begin = values[0];
        if (isnan(made->last)) made->last = e[0];
        if (kind == BLOCKS_HARMONIC) made->target = made->low = made->high = 0.0;
    }
    made->span += h;
    if (kind == BLOCKS_SQUARE) {
        double squares[5] = {e[0] * e[0], e[1] * e[1], e[2] * e[2], e[3] * e[3], e[4] * e[4]};
        made->total += h * weighted(squares);
        return;
    }
    if (kind == BLOCKS_HARMONIC) {
        if (h > 0.0) harmonic(e, t - made->first, h, s->setup->measures[i].omega, made);
        return;
    }
    double of[5], least = made->low, most = made->high;
    for (int k = 0; k < 5; k++) of[k] = values[k * n];
    made->target = values[4 * n + 1];
    if (kind == BLOCKS_ABSOLUTE || kind == BLOCKS_TIMED) {
        made->total += absolute(e, t, h, kind == BLOCKS_TIMED);
    } else if (kind == BLOCKS_PEAK) {
        double low = -made->total, high = made->total;
        reached(e, &low, &high);
        made->total = MOST(-low, high);
    } else if (kind == BLOCKS_VARIATION) {
        made->total += fabs(e[0] - made->last) + variation(e);
    } else if (kind == BLOCKS_SIGNS) {
        count_signs(e, s->setup->plain_atol, made);
    } else if (kind == BLOCKS_OVERSHOOT || (kind == BLOCKS_RISE && h > 0.0)) {
        reached(of, &made->low, &made->high);
    }
    /* Only a part that goes further than all before can be the first to rise so far. */
    if (h > 0.0 && (kind == BLOCKS_SETTLING || (kind == BLOCKS_RISE && (made->low < least || made->high > most)))) {
        double *row = made->path.data + made->path.used;
        row[0] = t, row[1] = h;
        memcpy(row + 2, of, sizeof of);
        made->path.used += 7;
    }
    made->last = e[4];
}

/* Whether a measure is taken of low to high in the step from t0 to t1: of what its window leaves of the step. */
HOT static inline int is_of_range(const BlocksSim *s, int i, double low, double high, double t0, double t1)
{
    const BlocksMeasure *what = &s->setup->measures[i];
    return !s->setup->has_windows || (MOST(what->low, t0) == low && LEAST(what->high, t1) == high);
}

/* Take in the parts of an accepted step. */
static void take_parts(BlocksSim *s, double t0, double t1)
{
    int width = 4 + 5 * s->model->nmeasured;
    const double *row = s->parts.data, *end = row + s->parts.used;
    for (; row < end; row += width)
        for (int i = 0; i < s->setup->nmeasures; i++)
            if (is_of_range(s, i, row[0], row[1], t0, t1)) take(s, i, row[2], row[3], row + 4);
    s->parts.used = 0;
}

static int measure(BlocksSim *s, double low, double high, double t1, double h_dense)
{
    int m = s->model->nmeasured, width = 4 + 5 * m, got;
    Parts p = parts_of(s, BLOCKS_MEASURED, low, high, h_dense);
    p.x1 = high == t1 ? s->x1 : NULL, p.nodes = LOBATTO, p.spans = 10 * s->setup->rtol, p.sizes = 1.0;
    p.checks = CHECKS + 2, p.count = p.look->bent ? p.look->checks : 0;
    if (s->known[0] == low) memcpy(p.values, s->known + 1, (size_t)m * sizeof(double)), p.knows_begin = 1;
    while ((got = next_part(&p)) > 0) {
        if (blocks_list_room(&s->parts, width)) return no_memory(s);
        double *row = s->parts.data + s->parts.used, begin = part_time(&p, p.begin);
        row[0] = low, row[1] = high, row[2] = begin, row[3] = part_time(&p, p.end) - begin;
        memcpy(row + 4, p.values, (size_t)(5 * m) * sizeof(double));
        s->parts.used += width;
    }
    if (got < 0) return BLOCKS_FAILED;
    s->known[0] = high;
    memcpy(s->known + 1, p.values + 4 * m, (size_t)m * sizeof(double));
    return 0;
}

/* Whether a window begins at t. */
HOT int blocks_window_begins(const BlocksSim *s, double t)
{
    int any = 0;
    for (int i = 0; i < s->setup->nmeasures; i++) any |= s->setup->measures[i].low == t;
    return any;
}

static int measure_step(BlocksSim *s, double t1, double h_dense)
{
    const BlocksSetup *setup = s->setup;
    if (!setup->nmeasures || t1 <= s->t) return 0;
    int count = setup->has_windows ? setup->nmeasures : 1;
    for (int i = 0; i < count; i++) {
        double low = s->t, high = t1;
        if (setup->has_windows) low = fmax(setup->measures[i].low, low), high = fmin(setup->measures[i].high, high);
        int is_new = low < high;
        for (int j = 0; j < i && is_new; j++)
            if (is_of_range(s, j, low, high, s->t, t1)) is_new = 0;
        if (is_new && measure(s, low, high, t1, h_dense)) return BLOCKS_FAILED;
    }
    if (setup->has_windows && s->known[0] != t1 && blocks_window_begins(s, t1)) {
        if (s->moving) blocks_outside(s, t1);
        evaluate(s, s->model->measured, t1, s->x1, s->nodes);
        s->known[0] = all_finite(s->nodes, s->model->nmeasured) ? t1 : NAN;
    }
    return path_room(s, s->parts.used / (4 + 5 * s->model->nmeasured));
}

/* The values before an instant, where the step before has them, and those after it; they are taken in when nothing can
   fail any more. */
int blocks_measure_instant(BlocksSim *s)
{
    int m = s->model->nmeasured;
    if (!m) return 0;
    for (int k = 0; k < m; k++) s->nodes[5 * m + k] = s->known[0] == s->t ? s->nodes[k] : NAN;
    evaluate(s, s->model->measured, s->t, s->memory.x, s->nodes);
    if (!all_finite(s->nodes, m)) return blocks_fail(s, BLOCKS_NOT_FINITE, 0, NAN);
    for (int k = 1; k < 5; k++) memcpy(s->nodes + k * m, s->nodes, (size_t)m * sizeof(double));
    s->known[0] = s->t;
    return 0;
}

/* A window begins at an instant: what changes there is in it, and is counted from `e` on, the value before. */
static void begin_before(BlocksSim *s, int i, double e)
{
    const int kind = s->setup->measures[i].kind;
    if (kind == BLOCKS_VARIATION) s->measured[i].last = e;
    if (kind == BLOCKS_SIGNS && fabs(e) > s->setup->plain_atol) s->measured[i].high = e > 0.0 ? 1.0 : -1.0;
}

void blocks_take_instant(BlocksSim *s)
{
    for (int i = 0; i < s->setup->nmeasures; i++) {
        const double *before = s->nodes + 5 * s->model->nmeasured + 2 * i;
        if (!(s->setup->measures[i].low <= s->t && s->t < s->setup->measures[i].high)) continue;
        if (isnan(s->measured[i].first)) begin_before(s, i, before[0] - before[1]);
        take(s, i, s->t, 0.0, s->nodes);
    }
}

/* A run ends: what happens there is in the windows that end there, as in those without an end. */
void blocks_measure_end(BlocksSim *s)
{
    const int m = s->model->nmeasured;
    if (s->known[0] != s->t) return;
    for (int k = 1; k < 5; k++) memcpy(s->nodes + k * m, s->nodes, (size_t)m * sizeof(double));
    for (int i = 0; i < s->setup->nmeasures; i++)
        if (s->setup->measures[i].high == s->t) take(s, i, s->t, 0.0, s->nodes);
}

/* Whether the polynomials through `nodes`, of a step as one part, miss what was given at the first check. */
int blocks_misses(BlocksSim *s, double *given)
{
    return worst_off(s, &s->model->looks[BLOCKS_MEASURED], LOBATTO, CHECKS[2], s->nodes, given, 10 * s->setup->rtol, 1.0, 0) >= 0;
}

/* What windows leave of a step: 0 all of it, to some measure; 1 nothing to any; -1 a part of it, to some. */
HOT int blocks_measures_in(const BlocksSim *s, double t0, double t1)
{
    int any = 0;
    for (int i = 0; i < s->setup->nmeasures; i++) {
        const BlocksMeasure *what = &s->setup->measures[i];
        if (what->low >= t1 || what->high <= t0) continue;
        if (what->low > t0 || what->high < t1) return -1;
        any = 1;
    }
    return !any;
}

/* Take in a step as one part, for one measure: its values stand in `nodes`. */
HOT int blocks_measure_one(BlocksSim *s, int i, double t0, double t1)
{
    if (path_room(s, 1)) return 1;
    take(s, i, t0, t1 - t0, s->nodes);
    return 0;
}

/* The same for all measures. */
HOT int blocks_measure_whole(BlocksSim *s, double t0, double t1)
{
    const int m = s->model->nmeasured;
    if (path_room(s, 1)) return 1;
    for (int i = 0; i < s->setup->nmeasures; i++)
        if (is_of_range(s, i, t0, t1, t0, t1)) take(s, i, t0, t1 - t0, s->nodes);
    s->known[0] = t1;
    memcpy(s->nodes, s->nodes + 4 * m, (size_t)m * sizeof(double));
    return 0;
}

/* --- crossings; see docs/semantics.md, "Instants and steps" ------------------------------------------------------ */

HOT static int crossing_values(BlocksSim *s, double t, const double *x, double *out)
{
    evaluate(s, s->model->crossings, t, x, out);
    for (int j = 0; j < s->model->ns; j++)
        if (isnan(out[j])) return blocks_fail(s, BLOCKS_NOT_A_NUMBER, j, NAN);
    take_slack(s, out);
    return 0;
}

/* --- corners of loops; corners.py of the reference engine says what they are ------------------------------------- */

enum { MOST_CORNERS = 1000 };
static const double SLACK = 8.0, WIDE = 1048576.0;

/* Crossings less the slack by which they leave their side. */
HOT static void take_slack(const BlocksSim *s, double *crossings)
{
    if (!s->is_loose) return;
    for (int j = 0; j < s->model->ns; j++) crossings[j] += s->looseness * (s->memory.s[j] > 0.0 ? s->slack[j] : -s->slack[j]);
}

void blocks_beyond(const BlocksSim *s, double *crossings) { take_slack(s, crossings); }

static int has_corners(const BlocksSim *s) { return s->model->corners && s->model->corners->n; }

/* The slack of corners where z holds the solutions at (t, x), and what the slack was at least if it only grows. */
static void loosen(BlocksSim *s, double t, const double *x, const double *z, int only_grows)
{
    const BlocksCorners *c = s->model->corners;
    int ns = s->model->ns, nz = s->model->nz;
    double *values = s->corner, *others = values + ns, *sums = others + ns, *moved = sums + ns, *kept = moved + nz,
           *base = kept + nz, *at = s->memory.z;
    for (int j = 0; j < ns; j++) sums[j] = 0.0;
    if (all_finite(z, nz)) {
        memcpy(base, z, (size_t)nz * sizeof(double)); /* z may be memory's own */
        memcpy(kept, at, (size_t)nz * sizeof(double));
        memcpy(at, base, (size_t)nz * sizeof(double));
        evaluate(s, c->crossings, t, x, values);
        evaluate(s, c->rounding, t, x, moved);
        for (int k = 0; k < nz; k++) {
            if (moved[k] == 0.0) continue;
            at[k] = base[k] + WIDE * moved[k];
            evaluate(s, c->crossings, t, x, others);
            at[k] = base[k];
            for (int i = 0; i < c->n; i++) {
                int j = c->numbers[i];
                double off = fabs(others[j] - values[j]);
                if (isfinite(off)) sums[j] += SLACK * off / WIDE;
            }
        }
        memcpy(at, kept, (size_t)nz * sizeof(double));
    }
    s->is_loose = 0;
    for (int j = 0; j < ns; j++) {
        if (!only_grows || sums[j] > s->slack[j]) s->slack[j] = sums[j];
        if (s->slack[j] != 0.0) s->is_loose = 1;
    }
}

void blocks_loosen(BlocksSim *s)
{
    if (!has_corners(s)) return;
    evaluate(s, s->model->solutions, s->t, s->memory.x, s->stage_values);
    loosen(s, s->t, s->memory.x, s->stage_values, 0);
    s->looseness = 2.0;
}

/* The first point on the line from z0, which memory's z becomes, to z1 that has changed, to the last bit; z1 has.
   `changed` looks at memory's z. */
static void first_corner(BlocksSim *s, int (*changed)(BlocksSim *s), const double *z0, const double *z1)
{
    int nz = s->model->nz;
    double low = 0.0, high = 1.0, *z = s->memory.z;
    for (int k = 0; k < nz; k++) z[k] = 1.0 * z0[k] + 0.0 * z1[k];
    if (changed(s)) return;
    for (;;) {
        double middle = (low + high) / 2;
        if (!(low < middle && middle < high) || high - low < ldexp(1.0, -60)) break;
        for (int k = 0; k < nz; k++) z[k] = (1.0 - middle) * z0[k] + middle * z1[k];
        if (changed(s)) high = middle;
        else low = middle;
    }
    for (int k = 0; k < nz; k++) z[k] = high == 1.0 ? z1[k] : (1.0 - high) * z0[k] + high * z1[k];
}

/* The states after a step of any size from here. The stages of the step before are lost: weigh first. */
static const double *flow(BlocksSim *s, double h)
{
    s->flowed = 1;
    s->model->trial(s, s->t, s->memory.x, h, s->x2, 0);
    return s->x2;
}

/* Take a part of an accepted step once more, up to t1, as a step whose error counts: 0, or REFUSED where it is too large. */
static int retake(BlocksSim *s, double t1)
{
    const double h = t1 - s->t, error = s->model->trial(s, s->t, s->memory.x, h, s->x2, 1);
    s->flowed = 1;
    if (error <= 1.0) {
        memcpy(s->x1, s->x2, (size_t)s->model->nx * sizeof(double));
        return 0;
    }
    s->refused = h;
    s->refused_error = isnan(error) ? INFINITY : error;
    s->rejected++;
    return BLOCKS_REFUSED;
}

/* One crossing near a place: of a step, which goes from 0 to 1, or some time from here along the rates. unit: the distance of
   places that can be told apart. begin, end: of where it is looked at. widest: of rows of values. */
typedef struct {
    BlocksSim *s;
    Parts *p; /* null: along the rates */
    const double *rates;
    int j;
    double unit, begin, end, widest;
} Course;

static double value_at(const Course *c, double place)
{
    BlocksSim *s = c->s;
    double *out = c->p ? c->p->values + 5 * s->model->ns : s->crossing_values;
    if (c->p) {
        part_at(c->p, place, s->model->crossings, out);
    } else {
        for (int i = 0; i < s->model->nx; i++) s->x2[i] = s->memory.x[i] + place * c->rates[i];
        evaluate(s, s->model->crossings, s->t + place, s->x2, out);
    }
    take_slack(s, out);
    return out[c->j];
}

typedef struct {
    BlocksSim *s;
    double h, h_dense; /* of the step, and of its dense output */
    int on_steps, failed;
    const Course *course; /* where one crossing alone is searched for, at its places */
} Search;

BLOCKS_INLINE double distance(const BlocksSim *s, int j, double v) { return s->memory.s[j] > 0.0 ? (v == 0.0 ? -5e-324 : -v) : v; }

/* How far crossings are beyond their latched sides: negative before the first change. */
HOT static double beyond(Search *search, double size)
{
    BlocksSim *s = search->s;
    double t = s->t + size, most = -INFINITY;
    if (search->failed) return 0.0;
    if (search->course) return distance(s, search->course->j, value_at(search->course, size));
    if (search->on_steps) {
        if (!(t > s->t)) return -1.0;
        if (crossing_values(s, t, flow(s, t - s->t), s->distances)) search->failed = 1;
    } else {
        const BlocksLook *look = &s->model->looks[BLOCKS_CROSSINGS];
        dense(s, size / search->h_dense, look->states, look->nstates, s->xs);
        if (crossing_values(s, t, s->xs, s->distances)) search->failed = 1;
    }
    for (int j = 0; j < s->model->ns; j++) {
        double d = distance(s, j, s->distances[j]);
        if (d > most && !(size / search->h <= s->until[j])) most = d;
    }
    return most;
}

/* The right end of the smallest interval that holds the first change; f_low, f_high: how far the ends are beyond. Oliveira and
   Takahashi 2020 (ITP). */
static double narrowed(Search *search, double low, double high, double f_low, double f_high, double resolution)
{
    if (f_low >= 0 || search->failed) return low;
    double width = high - low, radius = resolution * pow(2.0, ceil(log2(fmax(width / resolution, 1.0))));
    while (high - low > resolution && !search->failed) {
        double middle = (low + high) / 2, size = high - low, x = middle;
        if (isfinite(f_low) && isfinite(f_high) && f_high > f_low) {
            x = low - f_low * size / (f_high - f_low);
            double towards = copysign(1.0, middle - x);
            double shift = fmax(0.02 / width * size * size, resolution / 4);
            x = shift <= fabs(middle - x) ? x + towards * shift : middle;
            double slack = fmax(radius - size / 2, 0.0);
            if (fabs(x - middle) > slack) x = middle - towards * slack;
        }
        radius /= 2;
        if (!(low < x && x < high)) {
            x = middle;
            if (!(low < middle && middle < high)) break;
        }
        double value = beyond(search, x);
        if (value >= 0) high = x, f_high = value;
        else low = x, f_low = value;
    }
    return high;
}

static double located(BlocksSim *s, double low_theta, double high_theta, double h, double h_dense, int *failed)
{
    Search search = {.s = s, .h = h, .h_dense = h_dense};
    double resolution = 4 * blocks_ulp(fmax(fabs(s->t), fabs(s->t + h))), first = low_theta * h;
    double last = high_theta * h, f_low = beyond(&search, first), f_high = beyond(&search, last);
    double low = narrowed(&search, first, last, f_low, f_high, resolution), high = low;
    double reach = fmax(1e-9 * h, resolution);
    search.on_steps = 1;
    f_low = f_high = beyond(&search, low);
    if (f_low >= 0) {
        while (low > 0 && f_low >= 0 && !search.failed) {
            high = low, f_high = f_low;
            low = fmax(0.0, low - reach);
            f_low = beyond(&search, low);
            reach *= 100;
        }
    } else {
        while (high < last && f_high < 0 && !search.failed) {
            low = high, f_low = f_high;
            high = fmin(last, high + reach);
            f_high = beyond(&search, high);
            reach *= 100;
        }
    }
    double size = narrowed(&search, low, high, f_low, f_high, resolution);
    *failed = search.failed;
    return size;
}

/* The real roots of a cubic or less, c[0] + ... + c[degree] th^degree, in (0, 1): between its turns, by bisection. */
static int roots_inside(const double *c, int degree, double *out)
{
    double cuts[5], turns[3];
    int n = 0, count = 0, nturns = 0;
    if (degree == 3) {
        double slope[3] = {c[1], 2 * c[2], 3 * c[3]};
        double root = slope[1] * slope[1] - 4 * slope[2] * slope[0];
        if (root >= 0 && slope[2] != 0) {
            double q = -0.5 * (slope[1] + copysign(sqrt(root), slope[1]));
            double a = q / slope[2], b = q != 0 ? slope[0] / q : a;
            turns[nturns++] = fmin(a, b);
            turns[nturns++] = fmax(a, b);
        }
    } else if (degree == 2 && c[2] != 0) {
        turns[nturns++] = -c[1] / (2 * c[2]);
    }
    cuts[n++] = 0.0;
    for (int i = 0; i < nturns; i++)
        if (turns[i] > cuts[n - 1] && turns[i] < 1.0) cuts[n++] = turns[i];
    cuts[n++] = 1.0;
    for (int i = 0; i + 1 < n; i++) {
        double a = cuts[i], b = cuts[i + 1];
        double fa = c[0] + a * (c[1] + a * (c[2] + a * (degree > 2 ? c[3] : 0.0)));
        double fb = c[0] + b * (c[1] + b * (c[2] + b * (degree > 2 ? c[3] : 0.0)));
        if (fa == 0.0 && a > 0.0) {
            out[count++] = a; /* a double root stands at a turn */
            continue;
        }
        if ((fa < 0) == (fb < 0)) continue;
        for (int k = 0; k < 60 && b - a > 1e-16; k++) {
            double middle = (a + b) / 2;
            double f = c[0] + middle * (c[1] + middle * (c[2] + middle * (degree > 2 ? c[3] : 0.0)));
            if ((f < 0) == (fa < 0)) a = middle;
            else b = middle;
        }
        if (b > 0.0 && b < 1.0) out[count++] = b;
    }
    return count;
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

HOT static int any_changed(const BlocksSim *s, const double *values)
{
    for (int j = 0; j < s->model->ns; j++)
        if (blocks_latched_side(s, j, values[j]) != s->memory.s[j]) return 1;
    return 0;
}

/* Whether a side has changed at a place of the step: one that is touched there has not. */
BLOCKS_INLINE int has_changed(const BlocksSim *s, int j, double value, double theta)
{
    return (value >= 0) != (s->memory.s[j] > 0.0) && !(theta <= s->until[j]);
}

/* Whether a longer step, which saw more of what lies behind t1, found a crossing there. */
BLOCKS_INLINE int is_sure(const BlocksSim *s, int j, double t1) { return s->sure_t == t1 && s->sure[j] >= 0.0; }

HOT static int any_changed_at(const BlocksSim *s, const double *values, double theta)
{
    for (int j = 0; j < s->model->ns; j++)
        if (has_changed(s, j, values[j], theta)) return 1;
    return 0;
}

/* An interval (low, high] of a step, from 0 to 1, in which the first change of a side in a part lies: 1 where there is
   one; the crossings at its end are then in `distances`. */
HOT static int first_change(Parts *p, double *low, double *high)
{
    BlocksSim *s = p->s;
    int n = s->model->ns, any = 0;
    const double *values = p->values, width = p->end - p->begin;
    double *thetas = NULL;
    int64_t count = 0;
    for (int j = 0; j < n; j++) {
        double a[5];
        powers(values + j, n, a);
        double b1 = a[0] + a[1] / 4, b2 = a[0] + a[1] / 2 + a[2] / 6, b3 = a[0] + 3 * a[1] / 4 + a[2] / 2 + a[3] / 4;
        double b0 = a[0], b4 = values[4 * n + j];
        int safe = s->memory.s[j] > 0.0 ? b0 >= 0 && b1 >= 0 && b2 >= 0 && b3 >= 0 && b4 >= 0
                                        : b0 < 0 && b1 < 0 && b2 < 0 && b3 < 0 && b4 < 0;
        if (safe) continue;
        if (!any) {
            any = 1;
            thetas = malloc((size_t)(5 + 3 * n) * sizeof(double));
            if (!thetas) return -1;
            for (int k = 0; k < 5; k++) thetas[count++] = QUARTERS[k];
        }
        if (!isfinite(a[1]) || !isfinite(a[2]) || !isfinite(a[3]) || !isfinite(a[4])) continue;
        double slope[4] = {a[1], 2 * a[2], 3 * a[3], 4 * a[4]}, most = 0.0, roots[4];
        int degree = 3;
        for (int k = 0; k < 4; k++) most = fmax(most, fabs(slope[k]));
        while (degree > 0 && fabs(slope[degree]) <= 1e-14 * most) degree--;
        if (degree < 3) slope[3] = 0.0;
        if (degree < 2) slope[2] = 0.0;
        if (degree == 0) continue;
        int found = roots_inside(slope, degree, roots);
        for (int k = 0; k < found; k++) thetas[count++] = roots[k];
    }
    if (!any) return 0;
    qsort(thetas, (size_t)count, sizeof(double), compare_doubles);
    int found = 0;
    *low = p->begin;
    for (int64_t k = 0; k < count && !found; k++) {
        double theta = thetas[k];
        const double *at = NULL;
        for (int q = 0; q < 5; q++)
            if (theta == QUARTERS[q]) at = values + q * n;
        if (!at) {
            if (values_at(p, p->begin + theta * width, p->values + 5 * n)) {
                found = -2;
                break;
            }
            at = p->values + 5 * n;
        }
        if (theta > 0.0 && any_changed_at(s, at, p->begin + theta * width)) {
            *high = p->begin + theta * width;
            memcpy(s->distances, at, (size_t)n * sizeof(double));
            found = 1;
        } else {
            *low = p->begin + theta * width;
        }
    }
    free(thetas);
    return found;
}

/* --- signals that touch a threshold; twin, which says more about the why: engines/reference/touches.py -------------- */

static const double SMALL_REACH = 1e-6, UNSMOOTH = 0.25, LEVELS = 1024, SHORT = 1e-3, SPREAD = 37.0, BAND = 4.0, MOST_BAND = 64.0;

static double largest_of(const Parts *p, int j)
{
    double most = 0.0;
    for (int k = 0; k < 5; k++) most = fmax(most, fabs(p->values[k * p->look->n + j]));
    return most;
}

/* The rounding error of a crossing near a place: the largest third difference of values in a row, which stand before it or behind
   it, as it may jump there. */
static double rounding_of(const Course *c, double at)
{
    double most = 0.0, spacing = c->unit;
    for (int window = 0; window == 0 || 8 * spacing <= c->widest; spacing *= SPREAD) {
        for (int side = 0; side < 2; side++) {
            double first = side ? at + spacing : at - 9 * spacing, v[9];
            if (first < c->begin || first + 8 * spacing > c->end) continue;
            for (int k = 0; k < 9; k++) v[k] = value_at(c, first + k * spacing);
            for (int k = 0; k < 6; k++) most = fmax(most, fabs((v[k + 3] - v[k]) - 3 * (v[k + 2] - v[k + 1])));
        }
        if (++window >= 3 && most > 0.0) break;
    }
    return most;
}

/* Whether a crossing comes back on its way to `end`, or stays in the band of its rounding errors there, but for one that rests on
   0 exactly. most: how wide the band may be. until: where it is back. */
static int comes_back(const Course *c, double at, double end, double most, double *until)
{
    double band = fmin(BAND * rounding_of(c, at), most);
    int rests = 1;
    *until = end;
    for (double reach = c->unit, place; (place = at + reach) <= end; reach *= 2) {
        double d = distance(c->s, c->j, value_at(c, place));
        if (!(d <= band)) return 0; /* what is not a number too */
        rests &= d == 0.0;
        if (d < -band) {
            *until = place;
            break;
        }
    }
    return !rests;
}

/* The length of a usual step. */
static double usual_step(const BlocksSim *s)
{
    const BlocksGrid *fixed = &s->setup->fixed;
    return fixed->is_given ? (double)fixed->step / (double)fixed->unit : s->h;
}

/* Whether a crossing, whose side changes within (low, high] of a step, only touches 0: up to where it has come back, its side is
   as before. */
static int is_touch(Parts *p, int j, double low, double high)
{
    BlocksSim *s = p->s;
    const double usual = usual_step(s) / p->h, unit = 4 * blocks_ulp(fmax(fabs(p->t0), fabs(p->t1))) / p->h;
    const double end = s->model->hooks ? 1.0 : 1.0 + SHORT * fmax(1.0, usual);
    const Course course = {s, p, NULL, j, unit, 0.0, end, SHORT * (1.0 < SHORT * usual ? usual : p->end - p->begin)};
    Search search = {.s = s, .h = p->h, .course = &course};
    double at = high, most = largest_of(p, j), until;
    low = fmax(low, s->until[j]);
    if (low < high) at = narrowed(&search, low, high, beyond(&search, low), beyond(&search, high), course.unit);
    if (!comes_back(&course, at, fmin(end, 2.0), most > 0.0 ? MOST_BAND * most : INFINITY, &until)) return 0;
    s->until[j] = fmax(until, high);
    return 1;
}

static Course course_of(BlocksSim *s, int j, const double *rates, double length)
{
    return (Course){s, NULL, rates, j, 4 * fmax(blocks_ulp(s->t), 1e-16 * length), -length, length, SHORT * length};
}

double blocks_rounding(BlocksSim *s, int j, const double *rates, double length)
{
    const Course course = course_of(s, j, rates, length);
    double made = BAND * rounding_of(&course, 0.0);
    if (s->moving) blocks_outside(s, s->t);
    return made;
}

int blocks_touches(BlocksSim *s, int j, const double *rates, double length)
{
    const Course course = course_of(s, j, rates, length);
    double until;
    int made = comes_back(&course, 0.0, SHORT * length, INFINITY, &until);
    if (s->moving) blocks_outside(s, s->t);
    return made;
}

/* Whether the values of a crossing in a part may be rounding alone: they are not smooth, or whole multiples of one difference. */
static int is_rough(const double *v, int n, double most)
{
    double d[4], least = INFINITY, third = 0.0;
    for (int k = 0; k < 4; k++) {
        d[k] = v[(k + 1) * n] - v[k * n];
        if (d[k] != 0.0) least = fmin(least, fabs(d[k]));
    }
    for (int k = 0; k < 2; k++) third = fmax(third, fabs((d[k + 2] - d[k + 1]) - (d[k + 1] - d[k])));
    if (fmax(third, fabs((d[3] - d[0]) - 3 * (d[2] - d[1]))) >= UNSMOOTH * most) return 1;
    if (isinf(least)) return 1;
    for (int k = 0; k < 5; k++)
        if (fmod(v[k * n], least) != 0.0) return 0;
    return most <= LEVELS * least;
}

/* Whether a change that was found in a part is a touch of some crossing, whose values at `high` are in `distances`. */
static int finds_touch(Parts *p, double low, double high)
{
    BlocksSim *s = p->s;
    int n = s->model->ns, any = 0, is_short = (p->end - p->begin) * p->h < SHORT * usual_step(s);
    for (int j = 0; j < n; j++) {
        if (is_sure(s, j, p->t1)) continue;
        if (!has_changed(s, j, s->distances[j], high)) {
            /* It begins beyond its side, where a step before has left it as a touch. */
            if (low == 0.0 && (p->values[j] >= 0) != (s->memory.s[j] > 0.0) && s->until[j] < 4 * blocks_ulp(p->t0) / p->h)
                any |= is_touch(p, j, 0.0, 0.0);
            continue;
        }
        double most = largest_of(p, j);
        if (isinf(most)) continue; /* a pole */
        if (is_short || fabs(s->distances[j]) <= SMALL_REACH * most || is_rough(p->values + j, n, most))
            any |= is_touch(p, j, low, high);
    }
    return any;
}

/* How a crossing begins to move from here, by the length h: along the rates, not along a polynomial of a step. */
static double slope_by_rates(BlocksSim *s, int j, double h)
{
    const Course course = course_of(s, j, s->k[0], h);
    return 512 * (4 * value_at(&course, h / 1024) - value_at(&course, h / 512) - 3 * value_at(&course, 0.0));
}

/* A flight too short to be seen: a located crossing that must be passed again at once, and is not. values: those of the first
   part of the step, which is h long. */
static int missed(BlocksSim *s, const double *values, double h)
{
    int n = s->model->ns;
    for (int j = 0; j < n; j++) {
        if (!s->setup->causes[j].nresets && !s->setup->causes[j].foreign) continue;
        double a[5], most = 0.0;
        powers(values + j, n, a);
        for (int k = 0; k < 5; k++) most = fmax(most, fabs(values[k * n + j]));
        double size = 1e-12 * most + fabs(a[4]), slope = s->memory.s[j] > 0.0 ? -a[1] : a[1];
        double error = fmin(2 * s->located[j], 1e3 * size);
        if (!(slope > size && fabs(values[j]) <= error)) continue;
        /* Polynomials of a method may begin with a slope that is not that of the rates: both must lead back. */
        slope = slope_by_rates(s, j, h);
        if ((s->memory.s[j] > 0.0 ? -slope : slope) > size) return blocks_fail(s, BLOCKS_ZENO, j, s->t);
    }
    return 0;
}

/* Whether a change of a side counts as a firing. Passing a crossing back at once is no Zeno where it resets nothing, as
   where a corner just touches it, but passing it downwards again is. An FMU's has no direction. */
static int counts(const BlocksSim *s, int j, int up)
{
    const BlocksCause *cause = &s->setup->causes[j];
    int both = cause->foreign || (cause->direction == 3 && !cause->nresets);
    return (both ? 2 : cause->direction) & (up ? 1 : 2);
}

/* Crossings that come ever faster. */
static int crowded(BlocksSim *s, double t, int j, int up)
{
    const BlocksSetup *setup = s->setup;
    if (counts(s, j, up)) {
        double since = t - s->fired[j];
        if (since > 0 && since <= QUICK * blocks_ulp(t)) return blocks_fail(s, BLOCKS_ZENO, j, t);
    }
    if (s->crossed_count == CROWD) {
        double stop = isnan(setup->end) ? t : setup->end, span = fmax(fmax(stop - setup->start, 1e-3 * fabs(t)), 1e-12);
        if (t - s->crossed[s->crossed_first] < CROWD_PART * span) return blocks_fail(s, BLOCKS_ZENO, j, t);
    }
    return 0;
}

static void note_crossing(BlocksSim *s, double t, int j, int up)
{
    if (counts(s, j, up)) s->fired[j] = t;
    if (s->crossed_count == CROWD) {
        s->crossed[s->crossed_first] = t;
        s->crossed_first = (s->crossed_first + 1) % CROWD;
    } else {
        s->crossed[(s->crossed_first + s->crossed_count) % CROWD] = t;
        s->crossed_count++;
    }
}

/* Whether a crossing comes within 4 ulp after an instant at t1, to which it then belongs: the states and the crossings
   there are taken at once. p: the last part of the step. Crossings that have changed their side up to t1 do not count. */
static int joins(Parts *p, double t1, double *after)
{
    BlocksSim *s = p->s;
    int n = s->model->ns, is_near = 0, any = 0;
    double since = 8 * blocks_ulp(t1), length = (p->end - p->begin) * p->h;
    const double *values = p->values;
    for (int j = 0; j < n && !is_near; j++) {
        double a[5];
        if (has_changed(s, j, after[j], 1.0)) continue;
        powers(values + j, n, a);
        double slope = (a[1] + 2 * a[2] + 3 * a[3] + 4 * a[4]) / length;
        is_near = s->memory.s[j] > 0.0 ? after[j] <= -slope * since : -after[j] <= slope * since;
    }
    if (!is_near || s->model->hooks) return 0;
    double *near = s->crossing_values;
    blocks_rates(s, t1, s->x1, s->x2);
    s->flowed = 1;
    for (int i = 0; i < s->model->nx; i++) s->x2[i] = s->x1[i] + 0.5 * since * s->x2[i];
    if (crossing_values(s, t1 + 0.5 * since, s->x2, near)) return -1;
    for (int j = 0; j < n; j++)
        if (has_changed(s, j, near[j], 1.0) && !has_changed(s, j, after[j], 1.0)) any |= !is_touch(p, j, 1.0, 1.0);
    if (!any) return 0;
    memcpy(s->x1, s->x2, (size_t)s->model->nx * sizeof(double));
    memcpy(after, near, (size_t)n * sizeof(double));
    return 1;
}

/* The end of the step, or the first time in it at which a side has changed. REFUSED: the step to there is too inaccurate. */
static int up_to_crossing(BlocksSim *s, double *t1, double h_dense, double target, int *changed, int *shortened)
{
    int n = s->model->ns, found = 0, is_first = 1, was_first = 0, got;
    double h = *t1 - s->t, low = 0.0, high = 0.0, was = s->located_t, first_length = h, place = 1.0;
    if (has_corners(s)) loosen(s, s->t, s->memory.x, s->memory.z, 0), s->looseness = 2.0;
    Parts p = parts_of(s, BLOCKS_CROSSINGS, s->t, *t1, h_dense);
    p.x1 = s->x1, p.nodes = QUARTERS, p.spans = 1e-3, p.sizes = 1.0, p.ignores_far = 1;
    p.checks = CHECKS, p.count = p.look->bent ? p.look->checks : 0;
    if (s->sides_t == s->t) memcpy(p.values, s->sides, (size_t)n * sizeof(double)), p.knows_begin = 1;
    for (int j = 0; j < n; j++) s->until[j] = -INFINITY;
    while (!found && (got = next_part(&p)) > 0) {
        /* Sides that have changed just before their values do, as they joined an instant, stay. */
        for (int j = 0; j < n && is_first; j++)
            if ((p.values[j] >= 0) != (s->memory.s[j] > 0.0) && !is_sure(s, j, p.t1)) s->until[j] = 3.5 * blocks_ulp(s->t) / h;
        do found = first_change(&p, &low, &high);
        while (found == 1 && finds_touch(&p, low, high));
        if (found == -1) return no_memory(s);
        if (found == -2) return BLOCKS_FAILED;
        if (is_first) memcpy(s->first_values, p.values, (size_t)(5 * n) * sizeof(double)), was_first = found, first_length = (p.end - p.begin) * h;
        is_first = 0;
    }
    if (!found && got < 0) return BLOCKS_FAILED;
    double *after = s->distances + n;
    if (p.end == 1.0) memcpy(after, p.values + 4 * n, (size_t)n * sizeof(double));
    else if (crossing_values(s, *t1, s->x1, after)) return BLOCKS_FAILED;
    if (found) {
        for (int j = 0; j < n; j++) s->changed_sides[j] = has_changed(s, j, s->distances[j], high) || is_sure(s, j, p.t1);
        if (!s->weighed) {
            /* The stages of this step are lost with the next one. */
            for (int k = BLOCKS_CROSSINGS + 1; k < BLOCKS_LOOKS; k++)
                weigh(s, h_dense, s->model->looks[k].states, s->model->looks[k].nstates);
            s->weighed = 1;
        }
        int failed, touches;
        do {
            const double t = s->t + located(s, low, high, h, h_dense, &failed);
            if (failed) return BLOCKS_FAILED;
            *shortened = t < *t1 && !blocks_within_ulps(t, target, 0.0);
            /* A time of its own after t, or the run would stand still. */
            double end = *shortened ? fmax(t, nextafter(s->t, INFINITY)) : *t1;
            if (*shortened && retake(s, end)) return BLOCKS_REFUSED;
            if (!*shortened && !p.x1) memcpy(s->x1, flow(s, end - s->t), (size_t)s->model->nx * sizeof(double));
            place = *shortened ? (end - s->t) / h : 1.0;
            p.x1 = *shortened ? NULL : s->x1;
            if (crossing_values(s, end, s->x1, after)) return BLOCKS_FAILED;
            /* A side that has changed here, and not where the search began, has not been judged yet. Judge each side once: if
               the polynomials of a bad step contradict the step to here, judging would never end. */
            touches = 0;
            for (int j = 0; j < n; j++)
                if (!s->changed_sides[j] && has_changed(s, j, after[j], place)) {
                    touches |= is_touch(&p, j, place, place);
                    s->changed_sides[j] = 1;
                }
            if (touches && *shortened && !any_changed_at(s, after, place)) continue;
            *t1 = end;
            touches = 0;
        } while (touches);
    }
    *changed = any_changed_at(s, after, place);
    s->later = 0.0;
    if (!(*changed && (was_first || p.level == 0)) && was == s->t && missed(s, s->first_values, first_length)) return BLOCKS_FAILED;
    if (*t1 == target && (p.end >= 1.0 || !*changed)) {
        int joined = joins(&p, *t1, after);
        if (joined < 0) return BLOCKS_FAILED;
        if (joined) *changed = 1, s->later = 4 * blocks_ulp(*t1);
    }
    /* What has joined an instant fires there only if that does not turn it back: it counts when it passes again. */
    for (int j = 0; j < n && s->later == 0.0; j++)
        if (has_changed(s, j, after[j], place) && crowded(s, *t1, j, after[j] >= 0)) return BLOCKS_FAILED;
    /* What tells Zeno from a run is as before where this step fails. */
    for (int j = 0; j < n && s->later == 0.0; j++)
        if (has_changed(s, j, after[j], place)) note_crossing(s, *t1, j, after[j] >= 0);
    if (*shortened) {
        s->located_t = *t1;
        for (int j = 0; j < n; j++)
            s->located[j] = has_changed(s, j, after[j], place) ? fabs(after[j]) : -1.0;
    }
    memcpy(s->sides, after, (size_t)n * sizeof(double));
    s->sides_t = s->touched_t = *t1;
    for (int j = 0; j < n; j++) s->touched[j] = place <= s->until[j] ? after[j] : NAN;
    return 0;
}

/* --- what is replaced after each step -------------------------------------------------------------------------- */

BLOCKS_INLINE int is_off(const BlocksSim *s, int condition) { return condition >= 0 && s->memory.s[condition] == 0.0; }

/* Whether a value may stand in a place of d: ints up to 2^53, of enumerations their members. */
HOT int blocks_is_whole(const BlocksSim *s, int slot, double value)
{
    const BlocksSetup *setup = s->setup;
    int kind = setup->nintegers ? setup->integers[slot] : 0;
    if (kind == 0) return 1;
    if (kind == 1) return fabs(value) <= 9007199254740992.0;
    for (int i = 0; i < setup->member_counts[slot]; i++)
        if (setup->members[kind - 2 + i] == value) return 1;
    return 0;
}

/* What projections make of (x, d) at t: x and d are replaced; 1 where anything became another value. */
static int project(BlocksSim *s, double t, double *x, double *d, int *moved)
{
    const BlocksSetup *setup = s->setup;
    int n = s->model->nprojections;
    double *old = s->memory.d;
    s->memory.d = d; /* the programs read what earlier projections left */
    evaluate(s, s->model->projections, t, x, s->stage_values);
    s->memory.d = old;
    for (int i = 0; i < n; i++) {
        const BlocksProjection *p = &setup->projections[i];
        double value = s->stage_values[i];
        if (is_off(s, p->condition)) continue;
        if (!isfinite(value)) return blocks_fail(s, BLOCKS_NOT_FINITE, 0, value);
        double *place = p->row == 0 ? &x[p->place] : &d[p->place];
        if (p->row == 1 && !blocks_is_whole(s, p->place, value)) return blocks_fail(s, BLOCKS_NOT_WHOLE, p->place, value);
        if (*place != value) *moved = 1;
        *place = value;
    }
    return 0;
}

/* Keep the end of a step, before projections, for crossings that have changed their side in it. */
static void keep_unprojected(BlocksSim *s, const double *x)
{
    const size_t nx = (size_t)s->model->nx;
    memcpy(s->unprojected, x, nx * sizeof(double));
    memcpy(s->unprojected + nx, s->memory.d, (size_t)s->model->nd * sizeof(double));
}

/* The end of a step, or an earlier time up to which projections follow it as closely as the tolerance asks. */
static int followed(BlocksSim *s, double *t1, double h_dense)
{
    const BlocksSetup *setup = s->setup;
    int nx = s->model->nx, nd = s->model->nd, ignored = 0;
    double whole = *t1 - s->t, first = INFINITY;
    double *once = s->projected_once, *often = s->projected_often;
    if (s->model->looks[BLOCKS_PROJECTIONS].nphases && *t1 > s->t) {
        Parts p = parts_of(s, BLOCKS_PROJECTIONS, s->t, *t1, h_dense);
        next_part(&p);
        *t1 = part_time(&p, p.end);
    }
    while (*t1 - s->t > 64 * blocks_ulp(fmax(fabs(s->t), fabs(*t1)))) {
        memcpy(once + nx, s->memory.d, (size_t)nd * sizeof(double));
        memcpy(often + nx, s->memory.d, (size_t)nd * sizeof(double));
        dense(s, (*t1 - s->t) / h_dense, NULL, nx, once);
        if (project(s, *t1, once, once + nx, &ignored)) return BLOCKS_FAILED;
        for (size_t k = 0; k < sizeof ON_THE_WAY / sizeof *ON_THE_WAY; k++) {
            double t = s->t + ON_THE_WAY[k] * (*t1 - s->t);
            dense(s, (t - s->t) / h_dense, NULL, nx, often);
            if (project(s, t, often, often + nx, &ignored)) return BLOCKS_FAILED;
        }
        double error = 0.0;
        int worst = 0;
        for (int i = 0; i < nx + nd; i++) {
            if (i >= nx && setup->nintegers && setup->integers[i - nx]) continue;
            double allowed = setup->plain_atol + setup->rtol * fmax(fabs(once[i]), fabs(often[i]));
            double e = fabs(once[i] - often[i]) / allowed;
            if (e > error) error = e, worst = i;
        }
        if (error <= 1.0) return 0;
        first = fmin(first, error);
        if (*t1 - s->t < 1e-7 * whole && error > 0.5 * first) return blocks_fail(s, BLOCKS_CHANGES_ALWAYS, worst, error);
        *t1 = s->t + (*t1 - s->t) * fmax(0.1, 0.9 / sqrt(error)); /* it falls with the square of the step */
    }
    return 0;
}

HOT static int solve(BlocksSim *s, double t, const double *x, double *z)
{
    if (!s->model->nz) return 0;
    evaluate(s, s->model->solutions, t, x, z);
    for (int i = 0; i < s->model->nz; i++)
        if (!isfinite(z[i])) return blocks_fail(s, BLOCKS_UNSOLVED, i, z[i]);
    return 0;
}

/* Take an accepted step to (t1, x1), or the part of it before the first change of a side. -1: and go on. BLOCKS_REFUSED: such
   a part was retaken, and its error is too large: the run stands where it stood, with the rates there alone. */
int blocks_accept(BlocksSim *s, double t1, double h, double proposed, double error, double target)
{
    const BlocksModel *model = s->model;
    const BlocksSetup *setup = s->setup;
    int changed = 0, moved = 0, failed = BLOCKS_FAILED;
    int64_t remembered = s->past.known;
    double known = s->known[0];
    s->weighed = s->flowed = 0;
    if (model->nprojections) {
        weigh(s, h, NULL, model->nx);
        s->weighed = 1;
        if (!setup->fixed.is_given) {
            double shorter = t1;
            if (followed(s, &shorter, h)) goto end;
            if (shorter < t1) {
                t1 = shorter;
                if ((failed = retake(s, t1))) goto end;
                failed = BLOCKS_FAILED;
            }
        }
    }
    if (model->ns && model->moving_sides) {
        int cut = 0;
        if ((failed = up_to_crossing(s, &t1, h, target, &changed, &cut))) goto end;
        failed = BLOCKS_FAILED;
    }
    if (blocks_rows_inside(s, t1, h, changed || t1 == target)) goto end;
    if (model->nh && remember(s, t1, h)) goto end;
    if (solve(s, t1, s->x1, s->z1)) goto end;
    s->parts.used = 0;
    if (measure_step(s, t1, h)) goto end;
    if (model->nprojections) {
        memcpy(s->d1, s->memory.d, (size_t)model->nd * sizeof(double));
        if (changed) keep_unprojected(s, s->x1);
        if (project(s, t1, s->x1, s->d1, &moved)) goto end;
        if (moved && model->ns && !changed) { /* what has changed in the step fires by the values that were seen there */
            double *d = s->memory.d;
            s->memory.d = s->d1;
            s->model->refresh(&s->memory);
            int failed = crossing_values(s, t1, s->x1, s->sides);
            s->memory.d = d;
            if (failed) {
                s->model->refresh(&s->memory);
                goto end;
            }
            s->sides_t = t1;
        }
    }
    /* From here on nothing fails: the step is taken. */
    if (model->nh) settle_past(s, remembered, t1);
    take_parts(s, s->t, t1);
    double *x = s->memory.x, *first = s->k[0];
    s->memory.x = s->x1;
    s->x1 = x;
    s->has_first = !s->flowed && !moved; /* other steps have overwritten the stages of this one */
    if (s->has_first) {
        s->k[0] = s->k[model->stages - 1];
        s->k[model->stages - 1] = first;
    }
    memcpy(s->memory.z, s->z1, (size_t)model->nz * sizeof(double));
    if (moved) {
        memcpy(s->memory.d, s->d1, (size_t)model->nd * sizeof(double));
        s->model->refresh(&s->memory);
    }
    s->t = t1;
    s->h = proposed;
    s->error = error;
    s->exact = 0;
    s->steps++;
    s->crossing = changed ? 1 + moved : 0;
    s->outstanding = changed || t1 == target || (moved && model->ns && any_changed(s, s->sides));
    if (t1 == target) {
        s->exact = s->target_exact;
        s->count = s->target_count;
    }
    s->weighed = 0;
    if (model->hooks) {
        int asks = model->hooks->completed(s);
        if (asks < 0) return BLOCKS_FAILED;
        s->outstanding |= asks;
    }
    if (s->outstanding) return BLOCKS_DONE;
    if (!setup->every.is_given && record(s, NULL)) return BLOCKS_FAILED;
    return -1;
end:
    s->past.known = remembered;
    if (s->known[0] != known) s->known[0] = NAN;
    s->weighed = 0;
    return failed;
}

/* A first step by Hairer's rule, with the largest error over the states as the norm. */
double blocks_first_step(BlocksSim *s, double most)
{
    int n = s->model->nx;
    if (n == 0) return most;
    const double *x = s->memory.x, *first = s->k[0], *atol = s->setup->atol;
    double rtol = s->setup->rtol, d0 = 0.0, d1 = 0.0, d2 = 0.0;
    for (int i = 0; i < n; i++) {
        double scale = atol[i] + rtol * fabs(x[i]);
        d0 = fmax(d0, fabs(x[i]) / scale);
        d1 = fmax(d1, fabs(first[i]) / scale);
    }
    double h0 = d0 < 1e-5 || d1 < 1e-5 ? 1e-6 : 0.01 * d0 / d1;
    h0 = fmin(h0, most);
    for (int i = 0; i < n; i++) s->x1[i] = x[i] + h0 * first[i];
    blocks_rates(s, s->t + h0, s->x1, s->x2);
    int bad = 0;
    for (int i = 0; i < n; i++) {
        double e = fabs(s->x2[i] - first[i]) / (atol[i] + rtol * fabs(x[i]));
        if (!isfinite(e)) bad = 1;
        d2 = fmax(d2, e);
    }
    d2 /= h0;
    if (bad || !isfinite(d2)) return h0 * 1e-3;
    double larger = fmax(d1, d2);
    double h1 = larger <= 1e-15 ? fmax(1e-6, h0 * 1e-3) : pow(0.01 / larger, 1.0 / (s->model->order + 1));
    return fmin(fmin(100 * h0, h1), most);
}

/* Whether a rate jumps on the way along the rates from here, and jumps back on the way that follows: the state, or -1.
   Written for one who reads it beside `_to_and_fro` of the reference engine. */
static int to_and_fro(BlocksSim *s, double h)
{
    int n = s->model->nx, worst = 0;
    const double *x = s->memory.x, *first = s->k[0], *atol = s->setup->atol;
    double *at = s->xs, *made = s->x2, most = -1.0, rate = 0.0, low = 0.0, high = h;
    if (n == 0) return -1;
    for (int i = 0; i < n; i++) at[i] = x[i] + h * first[i];
    blocks_rates(s, s->t + h, at, made);
    for (int i = 0; i < n; i++) {
        double size = fabs(made[i] - first[i]) / (atol[i] + s->setup->rtol * fabs(x[i]));
        if (!isfinite(made[i])) return -1;
        if (size > most) most = size, worst = i;
    }
    double before = first[worst], after = made[worst], jump = fabs(after - before);
    for (int k = 0; k < HALVINGS; k++) {
        double middle = low + (high - low) / 2;
        for (int i = 0; i < n; i++) at[i] = x[i] + middle * first[i];
        blocks_rates(s, s->t + middle, at, made);
        rate = made[worst];
        if (fabs(rate - before) > fabs(after - rate)) {
            high = middle, after = rate;
        } else {
            low = middle, before = rate;
        }
    }
    if (!(fabs(after - before) > 0.5 * jump && jump > 0.0)) return -1;
    for (int i = 0; i < n; i++) at[i] = x[i] + high * first[i];
    blocks_rates(s, s->t + high, at, made);
    double on = h / 256; /* much more than the way by which the jump was passed */
    for (int i = 0; i < n; i++) {
        if (!isfinite(made[i])) return -1;
        at[i] += on * made[i];
    }
    blocks_rates(s, s->t + high + on, at, made);
    return fabs(made[worst] - before) < fabs(made[worst] - after) ? worst : -1;
}

/* Whether the run chatters over a jump of a rate; see docs/semantics.md, "Numbers". A look that changes nothing. */
int blocks_chatters(BlocksSim *s, double step)
{
    const BlocksModel *m = s->model;
    const BlocksSetup *setup = s->setup;
    double t1 = s->t + step, stop = isnan(setup->end) ? t1 : setup->end;
    double span = fmax(fmax(stop - setup->start, 1e-3 * fabs(t1)), 1e-12);
    int is_slow = (t1 - s->paced) * MANY < BLOCKS_PACE * span, culprit = -1;
    s->paced_before = s->paced, s->chattered_before = s->chatters;
    s->paced = t1;
    if (!is_slow || m->hooks) {
        s->chatters = 0;
        return 0;
    }
    double *z0 = s->backup + 2 * (m->nx + m->nd + m->ns) + 2 * m->nevents; /* as in `instant` */
    if (m->nz) memcpy(z0, s->memory.z, (size_t)m->nz * sizeof(double));
    culprit = to_and_fro(s, step);
    if (m->nz) memcpy(s->memory.z, z0, (size_t)m->nz * sizeof(double));
    if (culprit >= 0) s->chatters++;
    return culprit >= 0 && s->chatters >= TO_AND_FRO ? blocks_fail(s, BLOCKS_TOO_SMALL, culprit, step) : 0;
}

/* --- instants; see docs/semantics.md, "Order inside an instant" -------------------------------------------------- */

/* How many may wait: causes, and what stands behind them. */
static size_t late_places(const BlocksSetup *setup)
{
    int most = setup->ncauses;
    for (int i = 0; i < setup->nwaits; i++)
        if (setup->waits[i].cause >= most) most = setup->waits[i].cause + 1;
    return (size_t)most;
}

int blocks_tell(BlocksSim *s, int cause)
{
    if (!s->setup->causes[cause].told) return 0;
    if (blocks_list_room(&s->fired_events, 2)) return no_memory(s);
    s->fired_events.data[s->fired_events.used++] = s->t;
    s->fired_events.data[s->fired_events.used++] = cause;
    return 0;
}

/* All resets of what fires at once, from the values before; `sides` are latched then. is_given: the solutions of loops are
   those in memory. */
HOT static int reset(BlocksSim *s, const double *sides, int asked, int is_given)
{
    const BlocksSetup *setup = s->setup;
    BlocksMemory *m = &s->memory;
    int any = 0;
    for (int a = 0; a < setup->ncauses; a++) {
        if (!s->firing[a] || !setup->causes[a].nresets) continue;
        double *values = s->reset_values + setup->causes[a].first_reset;
        double then = s->firing_time[a];
        int is_outside = s->moving && s->later != 0.0 && a < s->model->ns;
        any = 1;
        /* What joined an instant some ulp away sees its own time: an event, and a crossing where it was seen. */
        for (int i = 0; i < s->model->nh; i++) m->h[i] = delayed(s, i, then);
        if (is_outside) blocks_outside(s, then);
        (is_given ? s->model->corners->resets : s->model->resets)(m, then, m->x, a, values);
        if (is_outside) blocks_outside(s, s->t);
        for (int i = 0; i < setup->causes[a].nresets; i++)
            if (!isfinite(values[i])) return blocks_fail(s, BLOCKS_NOT_FINITE, a, values[i]);
    }
    if (any) {
        for (int i = 0; i < setup->nresets; i++) {
            const BlocksReset *r = &setup->resets[i];
            if (!s->firing[r->cause]) continue;
            double value = s->reset_values[setup->causes[r->cause].first_reset + r->number];
            if (r->row == 0) {
                m->x[r->place] = value;
            } else {
                if (!blocks_is_whole(s, r->place, value)) return blocks_fail(s, BLOCKS_NOT_WHOLE, r->place, value);
                m->d[r->place] = value;
            }
        }
    }
    if (sides) memcpy(m->s, sides, (size_t)s->model->ns * sizeof(double));
    if (asked && s->model->hooks->events(s)) return BLOCKS_FAILED;
    s->model->refresh(m);
    return 0;
}

/* A subdiagram begins to go on: anew, or through the event times that passed since it was turned off. */
static int turn_on(BlocksSim *s, const BlocksEnabled *part, double since)
{
    const BlocksSetup *setup = s->setup;
    BlocksMemory *m = &s->memory;
    if (part->is_anew) {
        for (int i = 0; i < part->nsteppers; i++) {
            int number = setup->anew_steppers[part->first_stepper + i];
            if (setup->callback(number, 1, s->t, NULL, NULL)) return blocks_fail(s, BLOCKS_STEPPER, number, s->t);
        }
        if (!part->nresets) return 0;
        if (s->moving) blocks_outside(s, s->t);
        s->model->anew(m, s->t, m->x, (int)(part - setup->enabled), s->stage_values);
        for (int i = 0; i < part->nresets; i++) {
            const int32_t *place = setup->anew_places + 2 * (part->first_reset + i);
            if (!isfinite(s->stage_values[i])) return blocks_fail(s, BLOCKS_NOT_FINITE, 0, s->stage_values[i]);
            (place[0] == 0 ? m->x : m->d)[place[1]] = s->stage_values[i];
        }
        s->model->refresh(m);
        return 0;
    }
    int first = setup->ncauses - s->model->nevents;
    while (part->nevents) {
        for (int i = 0; i < s->model->nh; i++) m->h[i] = delayed(s, i, since);
        s->model->event_times(m, since, m->x, s->stage_values);
        double next = INFINITY;
        for (int i = 0; i < part->nevents; i++) {
            int e = setup->inside_events[part->first_event + i];
            if (!(s->stage_values[e] > since)) return blocks_fail(s, BLOCKS_NOT_AHEAD, e, s->stage_values[e]);
            next = fmin(next, s->stage_values[e]);
        }
        if (next > s->t) break;
        since = next;
        memset(s->firing, 0, (size_t)setup->ncauses);
        for (int i = 0; i < part->nevents; i++) {
            int e = setup->inside_events[part->first_event + i];
            if (s->stage_values[e] == since) {
                s->firing[first + e] = 1;
                s->firing_time[first + e] = since;
            }
        }
        if (reset(s, NULL, 0, 0)) return BLOCKS_FAILED;
        for (int i = 0; i < part->nevents; i++) {
            int e = first + setup->inside_events[part->first_event + i];
            if (!s->firing[e]) continue;
            if (blocks_list_room(&s->fired_events, 2)) return no_memory(s);
            s->fired_events.data[s->fired_events.used++] = s->t;
            s->fired_events.data[s->fired_events.used++] = e;
        }
    }
    return 0;
}

/* The crossings at an instant; where the step before was taken a little further, as they are there. */
HOT static void sides_now(BlocksSim *s, double *out)
{
    evaluate(s, s->model->crossings, s->t + s->later, s->memory.x, out);
    if (s->moving && s->later != 0.0) blocks_outside(s, s->t);
    take_slack(s, out);
}

/* A crossing that need not wait has to be a number. */
HOT static int check_numbers(BlocksSim *s, const double *values, const uint8_t *late)
{
    for (int j = 0; j < s->model->ns; j++)
        if (isnan(values[j]) && !(late && late[j])) return blocks_fail(s, BLOCKS_NOT_A_NUMBER, j, NAN);
    return 0;
}

/* The same by the end of the step before its projections. */
static void sides_seen(BlocksSim *s, double *out)
{
    BlocksMemory *m = &s->memory;
    double *x = m->x, *d = m->d;
    m->x = s->unprojected, m->d = s->unprojected + s->model->nx;
    s->model->refresh(m);
    sides_now(s, out);
    m->x = x, m->d = d;
    s->model->refresh(m);
}

/* All that fires, in s->firing, at once; then `sides` are latched. */
HOT static int fire(BlocksSim *s, const double *sides, int asked, int is_given)
{
    const BlocksSetup *setup = s->setup;
    /* Of what fires the order is told; what turns on comes before. */
    uint8_t *told = s->firing + setup->ncauses;
    memcpy(told, s->firing, (size_t)setup->ncauses);
    double *since = s->reset_values + setup->nresets;
    for (int i = 0; i < setup->nenabled; i++) {
        const BlocksEnabled *part = &setup->enabled[i];
        since[i] = sides[part->side] > s->memory.s[part->side] ? s->memory.d[part->time] : NAN;
    }
    double *latched = s->backup + s->model->nx + s->model->nd;
    memcpy(latched, sides, (size_t)s->model->ns * sizeof(double));
    if (reset(s, latched, asked, is_given)) return BLOCKS_FAILED;
    for (int i = 0; i < setup->nenabled; i++)
        if (!isnan(since[i]) && turn_on(s, &setup->enabled[i], since[i])) return BLOCKS_FAILED;
    for (int i = 0; i < setup->ncauses; i++)
        if (told[setup->order[i]] && blocks_tell(s, setup->order[i])) return BLOCKS_FAILED;
    return 0;
}

/* A program at an instant, where crossings are looked at. */
static void evaluate_now(BlocksSim *s, BlocksProgram program, double *out)
{
    evaluate(s, program, s->t + s->later, s->memory.x, out);
    if (s->moving && s->later != 0.0) blocks_outside(s, s->t);
}

/* The sides of corners that fired, as they are after their resets, before loops are solved again: with the solutions z. A
   table that has passed a point looks at the next one from before it, also where the solution moves beyond it. */
static void latch_at(BlocksSim *s, const double *z, const uint8_t *fired)
{
    const BlocksCorners *c = s->model->corners;
    const BlocksSetup *setup = s->setup;
    int nz = s->model->nz;
    double *values = s->corner, *kept = values + 3 * s->model->ns, *at = s->memory.z;
    memcpy(kept, at, (size_t)nz * sizeof(double));
    memmove(at, z, (size_t)nz * sizeof(double));
    evaluate_now(s, c->crossings, values);
    memcpy(at, kept, (size_t)nz * sizeof(double));
    for (int i = 0; i < c->n; i++) {
        int j = c->numbers[i], up = values[j] >= 0;
        if (!fired[j] || !setup->causes[j].nresets || up == (s->memory.s[j] > 0.0)) continue;
        if (setup->causes[j].direction == (up ? 2 : 1)) s->memory.s[j] = up;
    }
    s->model->refresh(&s->memory);
}

/* Behind the scratch of corners: what an instant may go back to, what it was some passes ago, and solutions to go back to. */
static double *corner_backup(const BlocksSim *s) { return s->corner + 3 * s->model->ns + 7 * s->model->nz; }

static double *some_passes_ago(const BlocksSim *s)
{
    return corner_backup(s) + s->model->nx + s->model->nd + 2 * s->model->ns + s->model->nevents;
}

static double *solutions_backup(const BlocksSim *s)
{
    return some_passes_ago(s) + s->model->nx + s->model->nd + 2 * s->model->ns;
}

/* States, discretes, sides and slack of crossings into a row, or out of it. */
static void copy_memory(const BlocksSim *s, double *row, int is_back)
{
    const BlocksModel *model = s->model;
    const BlocksMemory *m = &s->memory;
    struct { double *place; int n; } parts[] = {{m->x, model->nx}, {m->d, model->nd}, {m->s, model->ns}, {s->slack, model->ns}};
    for (int i = 0; i < 4; i++) {
        size_t size = (size_t)parts[i].n * sizeof(double);
        memcpy(is_back ? parts[i].place : row, is_back ? row : parts[i].place, size);
        row += parts[i].n;
    }
}

/* The event times that are due and have not fired, and those of a restart. */
static int32_t *still_due(const BlocksSim *s)
{
    return (int32_t *)(void *)(s->ticks_backup + s->model->nrates + s->model->nh + s->model->nevents);
}

/* Where the search for quiet may begin again: at its start, or after the last events of FMUs. Its memory is in the backup. */
typedef struct {
    int64_t told, fmu_events;
    int touched, is_loose, ndue;
} Restart;

static Restart keep_restart(const BlocksSim *s, const double *z, int ndue, int touched)
{
    copy_memory(s, corner_backup(s), 0);
    memcpy(some_passes_ago(s) - s->model->nevents, s->own, (size_t)s->model->nevents * sizeof(double));
    memcpy(solutions_backup(s), z, (size_t)s->model->nz * sizeof(double));
    memcpy(still_due(s) + s->model->nevents, still_due(s), (size_t)ndue * sizeof(int32_t));
    return (Restart){s->fired_events.used, s->model->hooks ? s->model->hooks->epoch(s) : 0, touched, s->is_loose, ndue};
}

static void go_to_restart(BlocksSim *s, const Restart *restart)
{
    copy_memory(s, corner_backup(s), 1);
    memcpy(s->own, some_passes_ago(s) - s->model->nevents, (size_t)s->model->nevents * sizeof(double));
    memcpy(s->memory.z, solutions_backup(s), (size_t)s->model->nz * sizeof(double));
    memcpy(still_due(s), still_due(s) + s->model->nevents, (size_t)restart->ndue * sizeof(int32_t));
    s->is_loose = restart->is_loose;
    s->fired_events.used = restart->told;
    s->model->refresh(&s->memory);
    s->failure = BLOCKS_FINE;
}

static int is_as_before(const BlocksSim *s)
{
    const BlocksMemory *m = &s->memory;
    size_t nx = (size_t)s->model->nx, nd = (size_t)s->model->nd, ns = (size_t)s->model->ns;
    const double *x = some_passes_ago(s), *d = x + nx, *sides = d + nd, *slack = sides + ns;
    return !memcmp(x, m->x, nx * sizeof(double)) && !memcmp(d, m->d, nd * sizeof(double)) &&
           !memcmp(sides, m->s, ns * sizeof(double)) && !memcmp(slack, s->slack, ns * sizeof(double));
}

/* Mark in s->late, but for what is marked already, what waits for what is late or changes its side; whether anything does. */
static int find_late(BlocksSim *s)
{
    const BlocksSetup *setup = s->setup;
    int any = s->model->hooks && s->model->hooks->hold(s);
    for (int i = 0; i < setup->nwaits; i++) {
        const BlocksWait *w = &setup->waits[i];
        for (int k = w->first; k < w->first + w->n && !s->late[w->cause]; k++) {
            int other = setup->waits_for[k];
            s->late[w->cause] = (other < s->model->ns && s->changed_sides[other]) || s->late[other];
        }
        any |= s->late[w->cause];
    }
    return any;
}

static int any_of(const uint8_t *flags, int n)
{
    for (int i = 0; i < n; i++)
        if (flags[i]) return 1;
    return 0;
}

/* With a late cause that would fire, let wait what resets memory that it reads, unless nothing went on then. */
static void find_beside(BlocksSim *s)
{
    const BlocksSetup *setup = s->setup;
    int more = 1, goes_on = 0;
    while (more) {
        more = 0;
        for (const BlocksBeside *pair = setup->beside; pair < setup->beside + setup->nbeside; pair++)
            if (s->late[pair->reader] && s->firing[pair->reader] && s->firing[pair->writer] && !s->late[pair->writer])
                more = s->late[pair->writer] = 1;
        if (more) find_late(s);
    }
    for (int a = 0; a < setup->ncauses && !goes_on; a++)
        goes_on = !s->late[a] && (s->firing[a] || (a < s->model->ns && s->changed_sides[a]));
    if (goes_on) return;
    memset(s->late, 0, s->nlate);
    find_late(s);
}

/* Let causes wait, in s->late, as crossings change whose sides they see: what they do is taken out of s->firing,
   s->changed_sides and `sides`. FMUs wait for all corners of loops too: they do not go back. Returns how many of the n event
   times that are due stay so; those come first. */
static int let_wait(BlocksSim *s, double *sides, int first, int32_t *due, int n)
{
    const BlocksSetup *setup = s->setup;
    const BlocksCorners *c = s->model->corners;
    int between = 0, left = 0;
    memset(s->late, 0, s->nlate);
    int any = find_late(s);
    if (any && setup->nbeside) find_beside(s);
    for (int i = 0; c && i < c->ninner; i++) between |= s->changed_sides[c->numbers[i]] && !s->late[c->numbers[i]];
    for (int a = 0; between && s->model->hooks && a < setup->ncauses; a++)
        if (setup->causes[a].foreign) any = s->late[a] = 1;
    if (!any) return 0;
    for (int a = 0; a < setup->ncauses; a++) {
        if (!s->late[a]) continue;
        s->firing[a] = 0;
        if (a < s->model->ns) s->changed_sides[a] = 0, sides[a] = s->memory.s[a];
    }
    for (int i = 0; i < n; i++)
        if (s->late[first + due[i]]) due[left++] = due[i];
    return left;
}

/* Fire events and crossings until no side changes any more, all that changes at once. ndue: how many event times are still
   due; seen: whether crossings fire by what the step has seen at first; restart: null where there are no corners. */
HOT static int quiet_at_once(BlocksSim *s, int ndue, int seen, int *touched, Restart *restart)
{
    const BlocksSetup *setup = s->setup;
    const BlocksModel *model = s->model;
    int ns = model->ns, first = setup->ncauses - model->nevents;
    const BlocksCorners *corners = has_corners(s) ? model->corners : NULL;
    double *values = s->crossing_values, *sides = s->distances;
    int32_t *due = still_due(s);
    const int can_wait = setup->nwaits || model->hooks;
    if (can_wait && seen) memset(s->late, 0, s->nlate); /* no pass but such a first one leaves it as it was */
    for (int i = 0; i < ndue; i++) {
        s->own[due[i]] = s->events[due[i]];
        *touched = 1;
    }
    for (int pass = 0; pass < MOST_PASSES + setup->nwaits; pass++) { /* what waits fires a pass later */
        int any = ndue, changed = 0;
        memset(s->firing, 0, (size_t)setup->ncauses);
        for (int i = 0; i < ndue; i++) {
            s->firing[first + due[i]] = 1;
            s->firing_time[first + due[i]] = s->events[due[i]];
        }
        if (ns) {
            if (seen && pass == 0) sides_seen(s, values);
            else sides_now(s, values);
            for (int j = 0; j < ns; j++) {
                sides[j] = isnan(values[j]) ? s->memory.s[j] : blocks_latched_side(s, j, values[j]);
                s->changed_sides[j] = sides[j] != s->memory.s[j];
                if (!s->changed_sides[j]) continue;
                changed = 1;
                if (setup->causes[j].direction & (sides[j] > 0 ? 1 : 2)) {
                    s->firing[j] = 1;
                    s->firing_time[j] = s->t + s->later;
                    any = 1;
                }
            }
        }
        int is_first = seen && pass == 0;
        ndue = can_wait && !is_first ? let_wait(s, sides, first, due, ndue) : 0;
        if (can_wait && !is_first) any = any_of(s->firing, setup->ncauses), changed = any_of(s->changed_sides, ns);
        if (ns && check_numbers(s, values, can_wait && !is_first ? s->late : NULL)) return BLOCKS_FAILED;
        int asked = model->hooks ? model->hooks->asked(s, s->firing, s->changed_sides, first) : 0;
        if (!any && !changed && !asked) {
            if (is_first) continue;
            return 0;
        }
        *touched = 1;
        if (!corners) {
            if (fire(s, sides, asked, 0)) return BLOCKS_FAILED;
            continue;
        }
        int is_reset = 0;
        double *z = s->corner + 3 * ns + 3 * model->nz;
        for (int i = 0; i < corners->n; i++) is_reset |= s->firing[corners->numbers[i]] && setup->causes[corners->numbers[i]].nresets;
        if (is_reset || asked) evaluate_now(s, model->solutions, z);
        if (fire(s, sides, asked, 0)) return BLOCKS_FAILED;
        if (is_reset) latch_at(s, z, s->firing + setup->ncauses);
        if (asked) *restart = keep_restart(s, z, ndue, 1); /* FMUs do not go back: a way along corners begins after their events */
        if (solve(s, s->t, s->memory.x, z)) return BLOCKS_FAILED;
        loosen(s, s->t, s->memory.x, z, 1);
        /* Where all is as it was before, it goes on without end (Brent's search for a cycle). */
        if (pass && !model->hooks && is_as_before(s)) break; /* an FMU hides what it has come to */
        if (!(pass & (pass + 1))) copy_memory(s, some_passes_ago(s), 0);
    }
    return blocks_fail(s, BLOCKS_ENDLESS, 0, s->t);
}

/* Whether a corner shows its other side, the solutions of loops being those in memory; those go to s->firing. */
static int turned(BlocksSim *s)
{
    const BlocksCorners *c = s->model->corners;
    double *values = s->corner;
    int any = 0;
    evaluate_now(s, c->crossings, values);
    take_slack(s, values);
    memset(s->firing, 0, (size_t)s->setup->ncauses);
    for (int i = 0; i < c->ninner; i++) {
        int j = c->numbers[i];
        s->firing[j] = !s->late[j] && (values[j] >= 0) != (s->memory.s[j] > 0.0);
        any |= s->firing[j];
    }
    return any;
}

/* Fire the corners in s->firing, which change their side here: those for which it counts. */
static int fire_corners(BlocksSim *s)
{
    const BlocksCorners *c = s->model->corners;
    double *sides = s->distances;
    memcpy(sides, s->memory.s, (size_t)s->model->ns * sizeof(double));
    for (int i = 0; i < c->ninner; i++) {
        int j = c->numbers[i];
        if (!s->firing[j]) continue;
        sides[j] = 1.0 - sides[j];
        s->firing[j] = (s->setup->causes[j].direction & (sides[j] > 0 ? 1 : 2)) != 0;
        s->firing_time[j] = s->t + s->later;
    }
    return fire(s, sides, 0, 1);
}

/* The same, where corners fire one after the other, on the way from the last solution of the loops to the next. */
static int quiet_along(BlocksSim *s, int ndue, int *touched)
{
    const BlocksSetup *setup = s->setup;
    const BlocksModel *model = s->model;
    const BlocksCorners *c = model->corners;
    BlocksMemory *m = &s->memory;
    int ns = model->ns, nz = model->nz, first = setup->ncauses - model->nevents;
    double *values = s->crossing_values, *sides = s->distances, *end = s->corner + 3 * ns + 3 * nz, *begin = end + nz;
    uint8_t *fired = s->firing + setup->ncauses;
    int32_t *due = still_due(s);
    for (int i = 0; i < ndue; i++) s->own[due[i]] = s->events[due[i]];
    for (int step = 0; step < MOST_CORNERS; step++) {
        evaluate_now(s, model->solutions, end);
        if (!all_finite(end, nz)) {
            /* The first corner with whose other side the loops have a solution. */
            int found = 0;
            for (int i = 0; i < c->ninner && !found; i++) {
                int j = c->numbers[i], off = setup->causes[j].condition;
                if (off >= 0 && m->s[off] == 0.0) continue;
                double side = m->s[j];
                m->s[j] = 1.0 - side;
                model->refresh(m);
                evaluate_now(s, model->solutions, end);
                found = all_finite(end, nz);
                m->s[j] = side;
                model->refresh(m);
                if (!found) continue;
                memset(s->firing, 0, (size_t)setup->ncauses);
                s->firing[j] = 1;
                if (fire_corners(s)) return BLOCKS_FAILED;
            }
            if (!found) return BLOCKS_FAILED;
            *touched = 1;
            continue;
        }
        loosen(s, s->t + s->later, m->x, end, 1);
        if (s->moving && s->later != 0.0) blocks_outside(s, s->t);
        memcpy(begin, m->z, (size_t)nz * sizeof(double));
        memcpy(m->z, end, (size_t)nz * sizeof(double));
        sides_now(s, values);
        memcpy(m->z, begin, (size_t)nz * sizeof(double));
        int own = 0, any = ndue > 0;
        memset(s->firing, 0, (size_t)setup->ncauses);
        for (int j = 0; j < ns; j++) {
            sides[j] = isnan(values[j]) ? m->s[j] : blocks_latched_side(s, j, values[j]);
            s->changed_sides[j] = sides[j] != m->s[j];
            any |= s->changed_sides[j];
            s->firing[j] = s->changed_sides[j] && setup->causes[j].direction & (sides[j] > 0 ? 1 : 2);
            s->firing_time[j] = s->t + s->later;
        }
        if (!any && !model->hooks) return check_numbers(s, values, NULL);
        *touched |= any;
        for (int i = 0; i < ndue; i++) {
            s->firing[first + due[i]] = 1;
            s->firing_time[first + due[i]] = s->events[due[i]];
        }
        int left = let_wait(s, sides, first, due, ndue), has_fired = left < ndue;
        if (check_numbers(s, values, s->late)) return BLOCKS_FAILED;
        ndue = left;
        any = any_of(s->firing, setup->ncauses) || any_of(s->changed_sides, ns);
        for (int i = 0; i < c->ninner; i++) own |= s->changed_sides[c->numbers[i]];
        if (has_fired || !own) {
            /* Corners wait until the loop is solved with what else has changed. */
            for (int i = 0; i < c->ninner; i++) {
                int j = c->numbers[i];
                sides[j] = m->s[j];
                s->firing[j] = s->changed_sides[j] = 0;
            }
            int asked = model->hooks && !own ? model->hooks->asked(s, s->firing, s->changed_sides, first) : 0;
            if (!any && !asked) return 0;
            *touched = 1;
            if (!own) memcpy(m->z, end, (size_t)nz * sizeof(double));
            if (fire(s, sides, asked, 0)) return BLOCKS_FAILED;
            continue;
        }
        uint8_t *at_end = s->changed_sides;
        first_corner(s, turned, begin, end);
        if (!turned(s))
            for (int i = 0; i < c->ninner; i++) s->firing[c->numbers[i]] = at_end[c->numbers[i]];
        if (fire_corners(s)) return BLOCKS_FAILED;
        latch_at(s, m->z, fired);
    }
    return BLOCKS_FAILED;
}

/* Fire events and crossings until no side changes any more. seen: whether crossings fire by what the step has seen at first;
   touched: whether anything was. */
HOT static int quiet(BlocksSim *s, const int32_t *due, int ndue, int seen, int *touched)
{
    if (ndue) memcpy(still_due(s), due, (size_t)ndue * sizeof(int32_t));
    if (!has_corners(s)) return quiet_at_once(s, ndue, seen, touched, NULL);
    const BlocksHooks *hooks = s->model->hooks;
    Restart restart = keep_restart(s, s->memory.z, ndue, *touched);
    if (!quiet_at_once(s, ndue, seen, touched, &restart)) return 0;
    int failure = s->failure, culprit = s->culprit;
    double value = s->value;
    /* FMUs do not go back. */
    if (failure == -1 || failure == BLOCKS_FOREIGN || (hooks && hooks->epoch(s) != restart.fmu_events)) return BLOCKS_FAILED;
    /* The sides that are shown are those of no solution: the way to it goes from corner to corner. */
    go_to_restart(s, &restart);
    *touched = restart.touched;
    if (!quiet_along(s, restart.ndue, touched)) return 0;
    return blocks_fail(s, failure, culprit, value);
}

/* Rows are short, and most of them empty. */
BLOCKS_INLINE void copy(double *to, const double *from, size_t n)
{
    if (n > 8) memcpy(to, from, n * sizeof(double));
    else
        for (size_t i = 0; i < n; i++) to[i] = from[i];
}

BLOCKS_INLINE int is_same(const double *a, const double *b, size_t n) { return !n || !memcmp(a, b, n * sizeof(double)); }

/* Whether a state or a held value differs by more than rounding, by which projections move it where a past breaks. */
static int has_jumped(const double *a, const double *b, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (fabs(a[i] - b[i]) > JUMP * fmax(fabs(a[i]), fabs(b[i]))) return 1;
    return 0;
}

/* Whether anything can fire: else an instant of events is over before it begins. */
BLOCKS_INLINE int is_calm(const BlocksSim *s) { return !s->model->ns && !s->model->hooks; }

HOT int blocks_check_slots(BlocksSim *s, const BlocksSlot *slots, int n)
{
    const int has_whole = s->setup->nintegers;
    for (int i = 0; i < n; i++) {
        int condition = slots[i].condition;
        if (!s->due[slots[i].rate] || (condition >= 0 && s->memory.s[condition] == 0.0)) continue;
        double value = s->d1[slots[i].slot];
        if (!isfinite(value)) return blocks_fail(s, BLOCKS_NOT_FINITE, slots[i].slot, value);
        if (has_whole && s->setup->integers[slots[i].slot] && !blocks_is_whole(s, slots[i].slot, value)) return blocks_fail(s, BLOCKS_NOT_WHOLE, slots[i].slot, value);
    }
    return 0;
}

/* The ticks of all due rates: held outputs in dependency order, then the discrete updates at once. */
HOT static int tick(BlocksSim *s, int *touched)
{
    const BlocksSetup *setup = s->setup;
    const BlocksModel *model = s->model;
    BlocksMemory *m = &s->memory;
    const size_t nd = (size_t)model->nd;
    const int clique = blocks_clique(s, model->nrates);
    const BlocksClique *c = &setup->cliques[clique];
    int begun = 0;
    for (int stage = 0; stage < c->nstages; stage++) {
        const BlocksStage *part = &setup->stages[c->first_stage + stage];
        if (part->unit >= 0) {
            if (!model->hooks->waits(s, part->unit)) continue;
            if (begun && quiet(s, NULL, 0, 0, touched)) return BLOCKS_FAILED;
            int32_t event = model->hooks->turn(s, part->unit, setup->stage_steppers + part->first_stepper, part->nsteppers);
            if (quiet(s, &event, event >= 0, 0, touched)) return BLOCKS_FAILED;
            begun = 0;
            continue;
        }
        const BlocksSlot *slots = setup->slots + part->first_slot;
        const int has_slots = blocks_any_due(s, slots, part->nslots);
        int has = has_slots;
        for (int i = 0; i < part->nsteppers; i++)
            has = has || s->due[setup->steppers[setup->stage_steppers[part->first_stepper + i]].rate];
        if (!has) continue;
        if (begun && !is_calm(s) && quiet(s, NULL, 0, 0, touched)) return BLOCKS_FAILED;
        begun = 1;
        copy(s->d1, m->d, nd);
        if (has_slots) {
            if (s->moving) blocks_outside(s, s->t);
            model->outputs(m, s->t, m->x, clique, stage, s->due, s->d1);
            if (blocks_check_slots(s, slots, part->nslots)) return BLOCKS_FAILED;
        }
        for (int i = 0; i < part->nsteppers; i++) {
            int number = setup->stage_steppers[part->first_stepper + i];
            const BlocksStepper *stepper = &setup->steppers[number];
            if (!s->due[stepper->rate] || is_off(s, stepper->condition)) continue;
            double *in = s->stage_values, *out = in + stepper->ninputs;
            if (s->moving) blocks_outside(s, s->t);
            model->stepper_inputs(m, s->t, m->x, number, in);
            if (setup->callback(number, 0, s->t, in, out)) return blocks_fail(s, BLOCKS_STEPPER, number, s->t);
            for (int k = 0; k < stepper->noutputs; k++)
                s->d1[setup->stepper_slots[stepper->first_output + k]] = out[k];
        }
        copy(m->d, s->d1, nd);
        model->refresh(m);
    }
    if (blocks_any_due(s, setup->nexts, setup->nnexts)) {
        if (begun && !is_calm(s) && quiet(s, NULL, 0, 0, touched)) return BLOCKS_FAILED;
        copy(s->d1, m->d, nd);
        if (s->moving) blocks_outside(s, s->t);
        model->nexts(m, s->t, m->x, s->due, s->d1);
        if (blocks_check_slots(s, setup->nexts, setup->nnexts)) return BLOCKS_FAILED;
        copy(m->d, s->d1, nd);
    }
    for (int r = 0; r < model->nrates; r++) {
        if (!s->due[r]) continue;
        s->ticks[r]++;
        m->k[r] = (double)s->ticks[r];
    }
    model->refresh(m);
    *touched = 1;
    return 0;
}

HOT static int event_times(BlocksSim *s)
{
    const BlocksSetup *setup = s->setup;
    int n = s->model->nevents, first = setup->ncauses - n;
    if (!n) return 0;
    evaluate(s, s->model->event_times, s->t, s->memory.x, s->stage_values);
    for (int i = 0; i < n; i++) {
        if (is_off(s, setup->causes[first + i].condition)) {
            s->stage_values[i] = INFINITY;
            continue;
        }
        double then = s->own[i] > s->t ? s->own[i] : s->t;
        if (then > s->t) { /* it fired at its own time, some ulp after this instant's */
            double *all = s->stage_values + n;
            evaluate(s, s->model->event_times, then, s->memory.x, all);
            s->stage_values[i] = all[i];
            if (s->moving) blocks_outside(s, s->t);
        }
        if (!(s->stage_values[i] > then)) return blocks_fail(s, BLOCKS_NOT_AHEAD, i, s->stage_values[i]);
    }
    memcpy(s->events, s->stage_values, (size_t)n * sizeof(double));
    return 0;
}

static int projected(BlocksSim *s, int *moved)
{
    if (!s->model->nprojections) return 0;
    size_t size = (size_t)s->model->nd * sizeof(double);
    memcpy(s->d1, s->memory.d, size);
    if (project(s, s->t, s->memory.x, s->d1, moved)) return BLOCKS_FAILED;
    if (*moved) {
        memcpy(s->memory.d, s->d1, size);
        s->model->refresh(&s->memory);
    }
    return 0;
}

/* Forget the firing times of crossings that the step found at its end if inputs have jumped there and moved them. If a master
   extrapolates an input, the run finds the crossing again after each jump back to the true input, closer and closer to the last
   time. That is the error of the extrapolation, not Zeno behavior of the model. */
static int withdraw(BlocksSim *s, int by_seen)
{
    int n = s->model->ns;
    if (by_seen) sides_seen(s, s->crossing_values);
    else sides_now(s, s->crossing_values);
    if (check_numbers(s, s->crossing_values, NULL)) return BLOCKS_FAILED;
    for (int j = 0; j < n; j++)
        if (s->fired[j] == s->t && s->crossing_values[j] != s->sides[j]) s->fired[j] = -INFINITY;
    return 0;
}

/* What a step does at its end that others have made: projections are taken over, crossings fire by the values before. */
int blocks_end_step(BlocksSim *s)
{
    int moved = 0;
    if (s->model->nprojections) {
        keep_unprojected(s, s->memory.x);
        if (projected(s, &moved)) return BLOCKS_FAILED;
    }
    s->crossing = 1 + moved;
    return 0;
}

/* The instant at the current time, where everything that stands within 4 ulp happens. */
HOT static int instant(BlocksSim *s, int is_start)
{
    const BlocksSetup *setup = s->setup;
    const BlocksModel *model = s->model;
    BlocksMemory *m = &s->memory;
    if (!is_start && model->plain_instant(s)) return 0;
    const size_t nx = (size_t)model->nx, nd = (size_t)model->nd, ns = (size_t)model->ns, ne = (size_t)model->nevents;
    double *x0 = s->backup + nx + nd + ns, *d0 = x0 + nx, *s0 = d0 + nd, *events0 = s0 + ns, *own0 = events0 + ne,
           *z0 = own0 + ne;
    int64_t told = s->fired_events.used, broken_count = s->past.broken;
    int32_t seen = s->past.seen, open = s->past.open;
    double broken0 = s->broken, known0 = s->known[0];
    int touched = 0, changed = s->changed, broke = 0, failed = BLOCKS_FAILED, measured = 0;
    const int by_seen = s->crossing == 2; /* projections have moved the end of a step in which a side has changed */
    int64_t hidden = model->hooks ? model->hooks->epoch(s) : 0;
    const double *left = NULL;
    if (has_corners(s) && !s->crossing) loosen(s, s->t, m->x, m->z, 0);
    s->looseness = 1.0;
    if (!is_start && !setup->is_silent && setup->has_jumps) {
        if (!s->has_left) {
            if (blocks_logged(s, s->left)) return BLOCKS_FAILED;
        }
        left = s->left;
    }
    copy(x0, m->x, nx);
    copy(d0, m->d, nd);
    copy(s0, m->s, ns);
    copy(events0, s->events, ne);
    copy(own0, s->own, ne);
    copy(z0, m->z, (size_t)model->nz);
    for (int r = 0; r < model->nrates; r++) s->ticks_backup[r] = s->ticks[r];
    int64_t *passed0 = s->ticks_backup + model->nrates;
    if (model->nh) memcpy(passed0, s->past.passed, (size_t)model->nh * sizeof(int64_t));

    int32_t *due_events = (int32_t *)(void *)(s->ticks_backup + model->nrates + model->nh);
    int ndue = 0;
    for (int i = 0; i < model->nevents; i++)
        if (blocks_within_ulps(s->events[i], s->t, s->scale)) due_events[ndue++] = i;
    int waiting = 0;
    if (model->hooks) ndue = model->hooks->postponed(s, due_events, ndue, &waiting);
    if (model->nh) broke = pass_breaks(s, s->t);
    double edge, broken = s->broken;
    while (setup->ntracks && ((edge = next_input_break(s, broken)) <= s->t || blocks_within_ulps(edge, s->t, s->scale))) broken = edge;
    if (broken != s->broken) {
        s->broken = broken;
        blocks_inputs(s, fmax(s->t, broken));
        changed = 1;
    }
    if (s->moving) blocks_outside(s, s->t);
    int any_tick = 0;
    for (int r = 0; r < model->nrates; r++) {
        s->due[r] = s->exact == 1 && blocks_tick_count(s, r) == s->count;
        any_tick |= s->due[r];
    }
    if (changed && s->crossing && withdraw(s, by_seen)) goto restore;
    if ((ndue || !is_calm(s)) && quiet(s, due_events, ndue, by_seen, &touched)) goto restore;
    if ((any_tick || waiting) && (tick(s, &touched) || (!is_calm(s) && quiet(s, NULL, 0, 0, &touched)))) goto restore;
    int moved = 0;
    if (model->nprojections && projected(s, &moved)) goto restore;
    if (moved) {
        touched = 1;
        if (!is_calm(s) && quiet(s, NULL, 0, 0, &touched)) goto restore;
    }
    if (changed || broke || touched) {
        if (model->nz && solve(s, s->t, m->x, s->stage_values)) goto restore;
        copy(m->z, s->stage_values, (size_t)model->nz);
        if (model->nevents && event_times(s)) goto restore;
    }
    int happened = any_tick || !is_same(s0, m->s, ns) || by_seen || s->fired_events.used > told || ndue;
    if (model->hooks && model->hooks->epoch(s) != hidden) happened = 1;
    int fresh = changed || happened || !is_same(x0, m->x, nx) || !is_same(d0, m->d, nd);
    int jumps = happened || (changed && !s->recourses) || (model->nh && (has_jumped(x0, m->x, nx) || has_jumped(d0, m->d, nd)));
    if (model->nh && s->recourses == 2 && !jumps && add_course(s, s->t)) goto restore;
    if (model->nh && add_break(s, s->t, jumps)) goto restore;
    if (fresh || broke) {
        /* The rates at the start of the next step are other ones now; the proposed step may still serve. */
        s->has_first = 0;
        s->sides_t = NAN;
        if (setup->nmeasures && blocks_measure_instant(s)) goto restore;
        measured = s->setup->nmeasures;
    }
    if (!setup->is_silent && (setup->has_jumps ? record(s, left) : blocks_record_on_grid(s))) goto restore;
    if (measured) blocks_take_instant(s);
    s->outstanding = s->changed = s->has_left = s->crossing = 0;
    if (!setup->is_silent) s->later = 0.0; /* an island may have the rest of the instant still before it */
    s->instants++;
    return 0;
restore:
    copy(m->x, x0, nx);
    copy(m->d, d0, nd);
    copy(m->s, s0, ns);
    copy(s->events, events0, ne);
    copy(s->own, own0, ne);
    copy(m->z, z0, (size_t)model->nz);
    for (int r = 0; r < model->nrates; r++) {
        s->ticks[r] = s->ticks_backup[r];
        m->k[r] = (double)s->ticks[r];
    }
    if (model->nh) memcpy(s->past.passed, passed0, (size_t)model->nh * sizeof(int64_t));
    s->past.broken = broken_count;
    s->past.seen = seen;
    s->past.open = open;
    s->fired_events.used = told;
    if (s->known[0] != known0) s->known[0] = NAN;
    if (s->broken != broken0) {
        s->broken = broken0;
        blocks_inputs(s, fmax(s->t, broken0));
    }
    s->model->refresh(m);
    s->sides_t = NAN;
    return failed;
}

int blocks_foresee(BlocksSim *s, const double *stays, int (*read)(void *owner), void *owner)
{
    const BlocksModel *model = s->model;
    const size_t ns = (size_t)model->ns, ne = (size_t)model->nevents, nz = (size_t)model->nz;
    double *touched0 = s->foreseen + (size_t)model->nx + (size_t)model->nd + 2 * ns, *own0 = touched0 + ns, *z0 = own0 + ne;
    const double touched_t = s->touched_t, looseness = s->looseness;
    const int64_t told = s->fired_events.used;
    const int is_loose = s->is_loose;
    int touched = 0, moved = 0, status = BLOCKS_FAILED;
    copy_memory(s, s->foreseen, 0);
    copy(touched0, s->touched, ns);
    copy(own0, s->own, ne);
    copy(z0, s->memory.z, nz);
    for (size_t j = 0; j < ns; j++)
        if (stays[j] != 0.0) s->touched[j] = INFINITY;
        else if (touched_t != s->t) s->touched[j] = NAN;
    s->touched_t = s->t;
    if (has_corners(s) && !s->crossing) loosen(s, s->t, s->memory.x, s->memory.z, 0);
    s->looseness = 1.0;
    if (quiet(s, NULL, 0, 0, &touched) || projected(s, &moved) || (moved && quiet(s, NULL, 0, 0, &touched))) goto restore;
    if (solve(s, s->t, s->memory.x, s->stage_values)) goto restore;
    copy(s->memory.z, s->stage_values, nz);
    status = read(owner);
restore:
    copy_memory(s, s->foreseen, 1);
    copy(s->touched, touched0, ns);
    copy(s->own, own0, ne);
    copy(s->memory.z, z0, nz);
    s->touched_t = touched_t;
    s->looseness = looseness;
    s->is_loose = is_loose;
    s->fired_events.used = told;
    s->failure = BLOCKS_FINE;
    model->refresh(&s->memory);
    return status;
}

/* --- the run ---------------------------------------------------------------------------------------------------- */

/* The model of the setup, which may be replaced in a run by one that computes the same bits faster. */
void blocks_take_model(BlocksSim *s)
{
    s->model = s->setup->model;
    if (s->model->stiff && !isnan(s->stiff_from)) s->model = s->model->stiff;
}

void blocks_rows(BlocksSim *s)
{
    blocks_take_model(s);
    for (int r = 0; r < s->model->nrates; r++) s->memory.k[r] = (double)s->ticks[r];
    s->model->prepare(&s->memory);
    s->model->refresh(&s->memory);
}

/* What follows from the delays of this run. A step that is shorter than every delay, also when it is stretched a little,
   needs no future. */
static void take_delays(BlocksSim *s)
{
    double shortest = INFINITY;
    s->longest = s->setup->longest;
    s->scale = fabs(s->setup->start);
    for (int i = 0; i < s->model->nh; i++) {
        double delay = blocks_delay(s, i);
        s->scale = fmax(s->scale, delay);
        shortest = fmin(shortest, delay);
    }
    shortest /= 1.02;
    if (s->model->nh && (s->setup->fixed.is_given || shortest < s->longest)) s->longest = shortest;
}

void blocks_reload(BlocksSim *s)
{
    take_delays(s);
    blocks_rows(s);
    blocks_inputs(s, fmax(s->t, s->broken));
    s->sides_t = NAN;
    if (s->moving) blocks_outside(s, s->t);
    /* A state that was saved has the rates there, but not the crossings that stand behind them. */
    if (s->has_first && s->model->stages) evaluate(s, s->model->crossings, s->t, s->memory.x, s->k[0] + s->model->nx);
}

int blocks_keep_left(BlocksSim *s)
{
    if (s->has_left || s->setup->is_silent || !s->setup->has_jumps) return 0;
    if (blocks_logged(s, s->left)) return BLOCKS_FAILED;
    s->has_left = 1;
    return 0;
}

static int all_numbers(const double *values, int n)
{
    for (int i = 0; i < n; i++)
        if (isnan(values[i])) return 0;
    return 1;
}

/* Whether values at the start show other sides, or others of what else is guessed; these are taken over if so asked. */
static int shows_others(BlocksSim *s, const double *values, int is_taken)
{
    const BlocksCorners *c = s->model->corners;
    int nx = s->model->nx, nd = s->model->nd, others = 0;
    for (int j = 0; j < s->model->ns; j++) {
        double side = s->located[j] ? values[nx + nd + j] : values[nx + nd + j] >= 0; /* located: given at the start */
        if (side != s->memory.s[j]) others = 1;
        if (is_taken) s->memory.s[j] = side;
    }
    for (int i = 0; c && i < c->nguessed; i++) {
        double *place = s->memory.d + c->guessed[i], shown = values[nx + c->guessed[i]];
        if (shown != *place) others = 1;
        if (is_taken) *place = shown;
    }
    return others;
}

/* Whether the start shows other sides where the solutions of loops are those in memory. */
static int starts_otherwise(BlocksSim *s)
{
    s->model->corners->start_given(&s->memory, s->t, s->memory.x, s->stage_values);
    return shows_others(s, s->stage_values, 0);
}

/* The values at the start, found from corner to corner, from where searches begin and the sides that are shown there. */
static int start_along(BlocksSim *s, double *out)
{
    const BlocksModel *model = s->model;
    const BlocksCorners *c = model->corners;
    BlocksMemory *m = &s->memory;
    int nx = model->nx, nd = model->nd, ns = model->ns, nz = model->nz, behind = nx + nd + ns + model->ntaken;
    double *moved = s->corner, *begin = moved + 3 * ns + 4 * nz, *end = out + behind;
    for (int j = 0; j < ns; j++) m->s[j] = s->located[j] ? m->s[j] : 0.0;
    for (int i = 0; i < c->nguessed; i++) m->d[c->guessed[i]] = 0.0;
    for (int pass = 0; pass < MOST_PASSES; pass++) {
        c->start_given(m, s->t, m->x, out);
        if (!shows_others(s, out, 1)) break;
    }
    for (int step = 0; step < MOST_CORNERS; step++) {
        c->start_solved(m, s->t, m->x, out);
        if (!all_numbers(out, behind + nz)) {
            int found = 0;
            for (int i = 0; i < c->n && !found; i++) {
                m->s[c->numbers[i]] = 1.0 - m->s[c->numbers[i]];
                c->start_solved(m, s->t, m->x, out);
                found = all_numbers(out, behind + nz);
                if (!found) m->s[c->numbers[i]] = 1.0 - m->s[c->numbers[i]];
            }
            if (!found) return 1;
            continue;
        }
        if (!shows_others(s, out, 0)) return 0;
        for (int i = 0; i < nd; i++) {
            int is_guessed = 0;
            for (int k = 0; k < c->nguessed; k++) is_guessed |= c->guessed[k] == i;
            if (!is_guessed) m->d[i] = out[nx + i];
        }
        model->refresh(m);
        memcpy(begin, m->z, (size_t)nz * sizeof(double));
        memcpy(begin + nz, end, (size_t)nz * sizeof(double));
        memcpy(m->z, end, (size_t)nz * sizeof(double));
        evaluate(s, c->rounding, s->t, out, moved);
        memcpy(m->z, begin, (size_t)nz * sizeof(double));
        int is_near = 1;
        for (int k = 0; k < nz; k++) is_near = is_near && fabs(begin[k] - end[k]) <= SLACK * moved[k];
        if (is_near) { /* it is the solution but for rounding */
            memcpy(out + nx, m->d, (size_t)nd * sizeof(double));
            return 0;
        }
        first_corner(s, starts_otherwise, begin, begin + nz);
        c->start_given(m, s->t, m->x, out);
        shows_others(s, out, 1);
    }
    return 1;
}

/* Values at the start. Nothing fires. The caller has set t, p, s and z (guesses), located (sides that are given), ticks. */
int blocks_begin(BlocksSim *s)
{
    const BlocksModel *model = s->model = s->setup->model;
    int nx = model->nx, nd = model->nd, ns = model->ns;
    double *out = s->stage_values;
    take_delays(s);
    for (int r = 0; r < model->nrates; r++) s->memory.k[r] = (double)s->ticks[r];
    model->prepare(&s->memory);
    blocks_inputs(s, s->t);
    if (model->nh) { /* the start is a break */
        if (blocks_past_room(s, 1, 1)) return no_memory(s);
        s->past.breaks[0] = s->t;
        s->past.orders[0] = 0;
        s->past.broken = s->past.open = 1;
    }
    if (s->moving) blocks_outside(s, s->t);
    const BlocksCorners *c = model->corners;
    int settled = 0, pass = 0;
    for (int i = 0; c && i < c->nguessed; i++) s->memory.d[c->guessed[i]] = 0.0;
    for (;; pass++) {
        model->start(&s->memory, s->t, s->memory.x, out);
        int same = !shows_others(s, out, 1);
        int moved = 0;
        if (model->hooks) {
            /* What they begin with may depend on inputs that were not known when it was read. */
            int n = nx + nd + ns + model->ntaken;
            double *last = out + n;
            if (model->hooks->initialized(s, out + nx + nd + ns)) return BLOCKS_FAILED;
            for (int i = 0; i < n; i++) {
                if (pass == 0 || !(fabs(out[i] - last[i]) <= 1e-13 * fabs(last[i]))) moved = 1;
                last[i] = out[i];
            }
        }
        settled = !moved && (same || s->crossing); /* crossing: nothing was guessed */
        if (settled || pass == MOST_PASSES - 1) break;
    }
    if (has_corners(s) && !model->hooks && !s->crossing && (!settled || !all_numbers(out, nx + nd + ns)))
        settled |= !start_along(s, out);
    if (!settled) return blocks_fail(s, BLOCKS_ENDLESS, 0, s->t);
    s->crossing = 0;
    for (int j = 0; j < ns; j++) s->located[j] = -1.0;
    memcpy(s->memory.x, out, (size_t)nx * sizeof(double));
    memcpy(s->memory.d, out + nx, (size_t)nd * sizeof(double));
    for (int i = 0; i < nx; i++) if (!isfinite(s->memory.x[i])) return blocks_fail(s, BLOCKS_NOT_FINITE, i, s->memory.x[i]);
    for (int i = 0; i < nd; i++) if (!isfinite(s->memory.d[i])) return blocks_fail(s, BLOCKS_NOT_FINITE, i, s->memory.d[i]);
    model->refresh(&s->memory);
    if (model->hooks) {
        if (model->hooks->started(s)) return BLOCKS_FAILED;
        if (crossing_values(s, s->t, s->memory.x, out)) return BLOCKS_FAILED;
        for (int j = 0; j < ns; j++)
            if (s->setup->causes[j].foreign) s->memory.s[j] = out[j] >= 0;
        model->refresh(&s->memory);
    }
    if (solve(s, s->t, s->memory.x, out)) return BLOCKS_FAILED;
    memcpy(s->memory.z, out, (size_t)model->nz * sizeof(double));
    if (event_times(s)) return BLOCKS_FAILED;
    s->outstanding = s->changed = 1;
    return 0;
}

int blocks_start(BlocksSim *s) { return blocks_begin(s) ? BLOCKS_FAILED : instant(s, 1); }

int blocks_settle(BlocksSim *s) { return s->outstanding ? instant(s, 0) : 0; }

HOT static double next_instant(BlocksSim *s)
{
    double edge = s->setup->ntracks ? next_input_break(s, s->broken) : INFINITY;
    if (s->model->nh) edge = blocks_smaller(edge, next_delayed(s));
    return blocks_next_of(s, s->model->nrates, s->model->nevents, edge);
}

double blocks_next(BlocksSim *s)
{
    s->end = INFINITY;
    s->end_count = s->end_exact = 0;
    return next_instant(s);
}

int blocks_is_due(const BlocksSim *s)
{
    if (s->crossing || s->changed || (s->model->nprojections && s->model->ns)) return 1;
    if (s->exact == 1)
        for (int r = 0; r < s->model->nrates; r++)
            if (blocks_tick_count(s, r) == s->count) return 1;
    for (int i = 0; i < s->model->nevents; i++)
        if (blocks_within_ulps(s->events[i], s->t, s->scale)) return 1;
    return s->model->nh > 0;
}

static void look_at_clock(BlocksSim *s)
{
    s->budget = s->budget_start = s->slice > 0 ? 1 : 2;
    s->deadline = s->slice > 0 ? INFINITY : -INFINITY;
    if (isinf(s->slice)) s->budget = s->budget_start = INT64_MAX;
    else if (s->slice > 0) s->deadline = seconds() + s->slice;
}

/* Run up to the next instant, which is then outstanding, and at most to `end`. */
int blocks_proceed(BlocksSim *s, double end, int64_t count, int32_t exact)
{
    s->failure = BLOCKS_FINE;
    look_at_clock(s);
    if (s->outstanding || !(s->t < end)) return BLOCKS_DONE;
    s->end = end, s->end_count = count, s->end_exact = exact, s->goes_on = 0;
    int stopped = s->model->run(s, next_instant(s));
    return stopped == BLOCKS_FAILED && s->failure == -1 ? BLOCKS_NO_MEMORY : stopped;
}

/* Run up to and including the instant at `end`, or at which the condition of the run holds. */
HOT int blocks_advance(BlocksSim *s, double end, int64_t count, int32_t exact)
{
    s->failure = BLOCKS_FINE;
    look_at_clock(s);
    s->end = end, s->end_count = count, s->end_exact = exact, s->goes_on = 1;
    while (s->outstanding || (s->t < end && !blocks_has_ended(s))) {
        if (s->outstanding) {
            if (instant(s, 0)) return s->failure == -1 ? BLOCKS_NO_MEMORY : BLOCKS_FAILED;
            if (s->t < end && !blocks_has_ended(s) && (s->t >= s->soft || (--s->budget <= 0 && blocks_clock(s)))) return BLOCKS_PAUSED;
            continue;
        }
        int stopped = s->model->run(s, next_instant(s));
        if (stopped == BLOCKS_PAUSED) return BLOCKS_PAUSED;
        if (stopped != BLOCKS_DONE) return s->failure == -1 ? BLOCKS_NO_MEMORY : BLOCKS_FAILED;
    }
    return BLOCKS_DONE;
}

static void forget_rows(BlocksRows *rows)
{
    for (int64_t i = 0; i < rows->nchunks; i++) free(rows->chunks[i]);
    rows->nchunks = 0;
    rows->next = rows->end = NULL;
    rows->bytes = 0.0;
}

static int64_t most(int64_t a, int64_t b) { return a > b ? a : b; }

/* List all that a run remembers and computes with. By this table alone it is allocated, reset, saved and freed. */
static void list_memory(BlocksSim *s)
{
#define ENTRY(kind, name, field, n, flags, begin) {name, &s->field, NULL, n, begin, sizeof *s->field, kind, flags, 0}
#define NUMBER(kind, name, field, flags) {name, &s->field, NULL, 1, 0.0, sizeof s->field, kind, (flags) | BLOCKS_HERE, 0}
#define NUMBERS(first, bytes) {NULL, &s->first, NULL, (int64_t)(bytes), 0.0, 1, 'B', BLOCKS_SAVED | BLOCKS_RESET | BLOCKS_HERE, 0}
#define GROWS(kind, name, field, count, n) {name, &s->past.field, &s->past.count, n, 0.0, sizeof *s->past.field, kind, both, 0}
#define ROW(name, field, n, flags) ENTRY('d', name, field, n, flags, 0.0)
#define SCRATCH(field, n) ROW(NULL, field, n, 0)
    const BlocksSetup *setup = s->setup;
    const BlocksModel *model = s->model;
    const int64_t nx = model->nx, nd = model->nd, ns = model->ns, nu = model->nu, nh = model->nh, nz = model->nz,
                  nr = model->nrates, ne = model->nevents, nl = model->nlogged, nc = setup->ncauses, nm = model->nmeasured;
    int64_t anew = 0, stepper = 0, looked = 0, turning = 0;
    for (int i = 0; i < setup->nenabled; i++) anew = most(anew, setup->enabled[i].nresets);
    for (const BlocksStepper *one = setup->steppers; one < setup->steppers + setup->nsteppers; one++)
        stepper = most(stepper, one->ninputs + one->noutputs);
    for (const BlocksLook *look = model->looks; look < model->looks + BLOCKS_LOOKS; look++)
        looked = most(looked, look->n), turning = most(turning, look->nphases + look->nhistories);
    const int64_t values = nx + nd + ns + 2 * ne + 2 * nz + 2 * model->nprojections + anew + stepper
                           + (model->hooks ? nx + nd + ns + 2 * model->ntaken : 0);
    s->nlate = late_places(setup);
    const int32_t saved = BLOCKS_SAVED, filed = BLOCKS_FILED, both = saved | filed, reset = BLOCKS_RESET;
    const BlocksEntry steady[] = {
        NUMBERS(t, offsetof(BlocksSim, row) - offsetof(BlocksSim, t)),
        NUMBERS(past.known, sizeof s->past - offsetof(BlocksPast, known)), NUMBER('d', "t", t, filed),
        NUMBER('d', "step", h, filed), NUMBER('d', "error", error, filed), NUMBER('q', "fixed", fixed, filed),
        NUMBER('d', "broken", broken, filed), NUMBER('d', "located_t", located_t, filed),
        NUMBER('i', "past.open", past.open, nh ? filed : 0), NUMBER('i', "past.seen", past.seen, nh ? filed : 0),
        ROW("x", memory.x, nx, saved), ROW("d", memory.d, nd, both), ROW("s", memory.s, ns, both),
        ROW("p", memory.p, model->np, saved), ROW(NULL, memory.u, nu, saved), ROW(NULL, memory.h, nh, saved),
        ROW("z", memory.z, nz, both), SCRATCH(memory.k, nr), SCRATCH(memory.q, model->nq), SCRATCH(memory.v, model->nv),
        SCRATCH(memory.w, model->nw), ROW("events", events, ne, both), ENTRY('d', "own", own, ne, both | reset, NAN),
        ROW("located", located, ns, both), ROW(NULL, sides, ns, saved), ROW(NULL, touched, ns, saved), SCRATCH(until, ns), SCRATCH(sure, ns),
        ENTRY('d', "fired", fired, ns, both | reset, -INFINITY), ROW("crossed", crossed, ns ? CROWD : 0, saved),
        SCRATCH(left, nl), ROW("before", before, nx + ns + nm, saved), SCRATCH(latched, ns), SCRATCH(x1, nx),
        ROW("known", known, 1 + 6 * nm, 0), ROW(NULL, base, nu, saved), ROW(NULL, aim, nu, saved), ROW(NULL, begin, nu, saved),
        ROW(NULL, finish, nu, saved), SCRATCH(xs, nx), SCRATCH(x2, nx + ns), SCRATCH(weights, nx * BLOCKS_MOST_DEGREE),
        SCRATCH(crossing_values, ns), SCRATCH(first_values, 5 * ns), SCRATCH(part_values, 6 * looked),
        SCRATCH(part_phases, 3 * turning), SCRATCH(reset_values, setup->nresets + setup->nenabled), SCRATCH(d1, nd),
        SCRATCH(backup, 2 * (nx + nd + ns + ne) + nz), SCRATCH(row_values, nl), SCRATCH(stage_values, values),
        SCRATCH(foreseen, nx + nd + 3 * ns + ne + nz),
        SCRATCH(z1, nz), SCRATCH(distances, 2 * ns), SCRATCH(projected_once, nx + nd), SCRATCH(projected_often, nx + nd),
        ROW("unprojected", unprojected, model->nprojections ? nx + nd : 0, saved), SCRATCH(firing_time, nc),
        ROW(NULL, slack, ns, reset),
        SCRATCH(corner, model->corners ? 3 * ns + 8 * nz + 2 * (nx + nd + 2 * ns) + ne : 0),
        ENTRY('q', "ticks", ticks, nr, both, 0.0), ENTRY('q', "blamed", blamed, nx, reset, 0.0),
        ENTRY('q', NULL, ticks_backup, nr + nh + 2 * ne, 0, 0.0),
        ENTRY('q', "past.passed", past.passed, nh, (nh ? both : 0) | reset, 0.0), ENTRY('B', NULL, due, nr, 0, 0.0),
        ENTRY('B', NULL, firing, 2 * nc, 0, 0.0), ENTRY('B', NULL, changed_sides, ns, 0, 0.0),
        ENTRY('B', NULL, late, (int64_t)s->nlate, 0, 0.0),
        ENTRY('B', NULL, measured, setup->nmeasures, 0, 0.0), ROW("carried", carried, s->ncarried, saved | reset),
    }, growing[] = {
        GROWS('d', "past.starts", starts, known, 1), GROWS('d', "past.ends", ends, known, 1),
        GROWS('d', "past.parts", parts, known, 6 * nh), GROWS('d', "past.breaks", breaks, broken, 1),
        GROWS('i', "past.orders", orders, broken, 1),
    };
    _Static_assert(sizeof steady + sizeof growing + BLOCKS_MOST_STAGES * sizeof *steady <= sizeof s->entries, "too many entries");
    memcpy(s->entries, steady, sizeof steady);
    s->nsteady = sizeof steady / sizeof *steady;
    for (int i = 0; i < model->stages; i++)
        s->entries[s->nsteady++] = (BlocksEntry)ROW(i ? NULL : "first", k[i], nx + ns + nm, i ? 0 : saved);
    memcpy(s->entries + s->nsteady, growing, sizeof growing);
    s->nentries = s->nsteady + (nh ? (int32_t)(sizeof growing / sizeof *growing) : 0);
}

void blocks_reset(BlocksSim *s)
{
    const BlocksModel *model = s->model = s->setup->model;
    forget_rows(&s->rows);
    s->rows.columns = model->nlogged;
    s->rows.capacity = 1024;
    for (const BlocksEntry *e = s->entries; e < s->entries + s->nentries; e++) {
        if (!(e->flags & BLOCKS_RESET)) continue;
        if (e->begin == 0.0) memset(address_of(e), 0, bytes_of(e));
        else for (int64_t i = 0; i < e->n; i++) ((double *)address_of(e))[i] = e->begin;
    }
    s->last_row = NULL;
    s->t = s->located_t = s->sure_t = s->sides_t = s->touched_t = s->stiff_from = s->known[0] = NAN;
    s->error = 1e-4;
    s->fixed = 1;
    s->paced = -INFINITY;
    s->row = s->between = 0;
    s->timed = -1;
    s->slice = 0.05;
    s->soft = INFINITY;
    s->has_left = s->is_factored = s->is_loose = 0;
    s->looseness = 1.0;
    s->failure = BLOCKS_FINE;
    s->fired_events.used = 0;
    for (int i = 0; i < s->setup->nmeasures; i++) {
        BlocksList path = {s->measured[i].path.data, 0, s->measured[i].path.capacity};
        s->measured[i] = (BlocksMeasured){0.0, 0.0, NAN, NAN, NAN, NAN, INFINITY, -INFINITY, path};
    }
    for (int i = 0; i < BLOCKS_LOOKS; i++) s->unseen[i] = (BlocksUnseen){NAN, 0, 0};
}

BlocksSim *blocks_new(const BlocksSetup *setup)
{
    BlocksSim *s = calloc(1, sizeof(BlocksSim));
    if (!s) return NULL;
    s->setup = setup;
    s->model = setup->model;
    if (!s->model->implicit || !s->model->implicit->open(s)) {
        list_memory(s);
        s->arena = blocks_allocate(s->entries, s->nsteady);
    }
    if (!s->arena) {
        blocks_free(s);
        return NULL;
    }
    s->nodes = s->known + 1;
    blocks_reset(s);
    return s;
}

void blocks_free(BlocksSim *s)
{
    if (!s) return;
    if (s->implicit) s->model->implicit->close(s);
    forget_rows(&s->rows);
    free(s->rows.chunks);
    free(s->rows.counts);
    free(s->fired_events.data);
    for (int i = 0; s->measured && i < s->setup->nmeasures; i++) free(s->measured[i].path.data);
    free(s->parts.data);
    for (int i = s->nsteady; i < s->nentries; i++) free(address_of(&s->entries[i]));
    free(s->arena);
    free(s);
}

const int64_t blocks_sizes[3] = {sizeof(BlocksSim), sizeof(BlocksSetup), sizeof(BlocksMemory)};
