/* Instants at which nothing but event times and ticks happens, and at which all crossings keep their sides: most of those of
   pulse trains and of sampled controllers. Included in steps.h, where sizes are constants. They do what `instant` of
   runtime.c does, to the last bit, and look for nothing that the model does not have. Whatever else comes up, failures too,
   they undo and leave to `instant`. */

#if (BLOCKS_NRATES || BLOCKS_NEVENTS) && \
    !(BLOCKS_NF || BLOCKS_NH || BLOCKS_NZ || BLOCKS_NPROJECTIONS || BLOCKS_HAS_CORNERS)
#define HAS_PLAIN_INSTANTS 1

/* Element by element, as what is copied was just written so. */
#define COPY(to, from, n) _Pragma("GCC unroll 8") for (int i = 0; i < (n); i++) (to)[i] = (from)[i]

/* Whether all crossings keep their sides now. */
static inline int keeps_sides(const BlocksSim *s)
{
#if BLOCKS_NS
    double *values = s->crossing_values;
    crossings(&s->memory, s->t, s->memory.x, values);
    for (int j = 0; j < BLOCKS_NS; j++)
        if (isnan(values[j]) || blocks_latched_side(s, j, values[j]) != s->memory.s[j]) return 0;
#else
    (void)s;
#endif
    return 1;
}

/* What an event resets, from the values before; then it is told. */
static inline int fire_event(BlocksSim *s, int e)
{
    const BlocksSetup *setup = s->setup;
    BlocksMemory *m = &s->memory;
    const int cause = BLOCKS_NS + e;
    double *values = s->reset_values;
    if (setup->causes[cause].nresets) resets(m, s->events[e], m->x, cause, values);
    for (const BlocksReset *r = setup->resets; r < setup->resets + setup->nresets; r++) {
        const double value = values[r->number];
        if (r->cause != cause) continue;
        if (!isfinite(value) || (r->row && !blocks_is_whole(s, r->place, value))) return 1;
        (r->row ? m->d : m->x)[r->place] = value;
    }
    refresh(m);
    return blocks_tell(s, cause);
}

/* Whether what ticks have computed may be held. */
static inline int may_hold(BlocksSim *s, const BlocksSlot *slots, int n)
{
    if (s->setup->nintegers || s->setup->nenabled) return !blocks_check_slots(s, slots, n);
    double bad = 0.0;
    _Pragma("GCC unroll 8") for (int i = 0; i < BLOCKS_ND; i++) bad += s->d1[i] * 0.0;
    return bad == 0.0;
}

/* The ticks of the rates that are due. */
static inline int tick_all(BlocksSim *s)
{
    const BlocksSetup *setup = s->setup;
    BlocksMemory *m = &s->memory;
    const int clique = blocks_clique(s, BLOCKS_NRATES);
    const BlocksClique *c = &setup->cliques[clique];
    int begun = 0;
    COPY(s->d1, m->d, BLOCKS_ND);
    for (int stage = 0; stage < c->nstages; stage++) {
        const BlocksStage *part = &setup->stages[c->first_stage + stage];
        if (!blocks_any_due(s, setup->slots + part->first_slot, part->nslots)) continue;
        if (begun && !keeps_sides(s)) return 1;
        begun = 1;
        outputs(m, s->t, m->x, clique, stage, s->due, s->d1);
        if (!may_hold(s, setup->slots + part->first_slot, part->nslots)) return 1;
        COPY(m->d, s->d1, BLOCKS_ND);
        refresh(m);
    }
    if (blocks_any_due(s, setup->nexts, setup->nnexts)) {
        if (begun && !keeps_sides(s)) return 1;
        nexts(m, s->t, m->x, s->due, s->d1);
        if (!may_hold(s, setup->nexts, setup->nnexts)) return 1;
        COPY(m->d, s->d1, BLOCKS_ND);
    }
    for (int r = 0; r < BLOCKS_NRATES; r++)
        if (s->due[r]) m->k[r] = (double)++s->ticks[r];
    refresh(m);
    return !keeps_sides(s);
}

/* Such an instant: 1; or 0, and nothing has happened yet. */
static __attribute__((noinline)) int plain_instant(BlocksSim *s)
{
    const BlocksSetup *setup = s->setup;
    BlocksMemory *m = &s->memory;
    double *x0 = s->backup, *d0 = x0 + BLOCKS_NX, *next = s->stage_values;
    const double known = s->known[0];
    const int64_t told = s->fired_events.used;
    int event = -1, ticks = 0;
    if (s->changed || s->crossing || s->moving || s->later != 0.0 || setup->nsteppers) return 0;
    if (setup->has_jumps && !setup->is_silent) return 0;
    for (int j = 0; BLOCKS_NU && j < setup->ntracks; j++)
        if (setup->tracks[j].n > 1) return 0;
    for (int i = 0; i < BLOCKS_NEVENTS; i++) {
        const int is_due = blocks_within_ulps(s->events[i], s->t, s->scale);
        /* What fires at its own time, some ulp later, or at once with others, is for `instant`. */
        if (s->own[i] > s->t || (is_due && (event >= 0 || s->events[i] > s->t || setup->nwaits))) return 0;
        if (is_due) event = i;
    }
    for (int r = 0; r < BLOCKS_NRATES; r++) {
        s->due[r] = s->exact == 1 && blocks_tick_count(s, r) == s->count;
        s->ticks_backup[r] = s->ticks[r];
        ticks |= s->due[r];
    }
    const int fresh = ticks || event >= 0;
    if (!keeps_sides(s)) return 0;
    if (fresh) {
        COPY(x0, m->x, BLOCKS_NX);
        COPY(d0, m->d, BLOCKS_ND);
        if (event >= 0 && (fire_event(s, event) || !keeps_sides(s))) goto undo;
        if (ticks && tick_all(s)) goto undo;
        event_times(m, s->t, m->x, next);
        for (int i = 0; i < BLOCKS_NEVENTS; i++) {
            int off = setup->causes[BLOCKS_NS + i].condition;
            if (off >= 0 && m->s[off] == 0.0) next[i] = INFINITY;
            if (!(next[i] > s->t)) goto undo;
        }
        if (setup->nmeasures && blocks_measure_instant(s)) goto undo;
    }
    if (!setup->is_silent && blocks_record_on_grid(s)) goto undo;
    if (fresh) {
        if (event >= 0) s->own[event] = s->events[event];
        COPY(s->events, next, BLOCKS_NEVENTS);
        s->has_first = 0;
        s->sides_t = NAN;
        if (setup->nmeasures) blocks_take_instant(s);
    }
    s->outstanding = s->has_left = 0;
    s->instants++;
    return 1;
undo:
    if (!fresh) return 0;
    COPY(m->x, x0, BLOCKS_NX);
    COPY(m->d, d0, BLOCKS_ND);
    for (int r = 0; r < BLOCKS_NRATES; r++) m->k[r] = (double)(s->ticks[r] = s->ticks_backup[r]);
    s->fired_events.used = told;
    if (s->known[0] != known) s->known[0] = NAN;
    refresh(m);
    return 0;
}
#else
#define HAS_PLAIN_INSTANTS 0
static int plain_instant(BlocksSim *s) { return (void)s, 0; }
#endif
