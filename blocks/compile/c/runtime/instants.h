/* Instants at which nothing but event times and ticks happens, and at which all crossings keep their sides: most of those of
   pulse trains and of sampled controllers. Included in steps.h, where sizes are constants. They do what `instant` of
   runtime.c does, to the last bit, and look for nothing that the model does not have. Whatever else comes up, failures too,
   they undo and leave to `instant`. */

#define HAS_PLAIN_INSTANTS                                                                                            \
    ((BLOCKS_NRATES || BLOCKS_NEVENTS) &&                                                                             \
     !(BLOCKS_NF || BLOCKS_NH || BLOCKS_NZ || BLOCKS_NPROJECTIONS || BLOCKS_HAS_CORNERS))
#if HAS_PLAIN_INSTANTS

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

#if BLOCKS_NEVENTS
/* What the due events reset, from the values before; then these are told. */
static inline int fire_events(BlocksSim *s, const int32_t *due, int ndue)
{
    enum { FIRST = BLOCKS_NS };
    const BlocksSetup *setup = s->setup;
    BlocksMemory *m = &s->memory;
    double *values = s->reset_values;
    for (int k = 0; k < ndue; k++) {
        const BlocksCause *cause = &setup->causes[FIRST + due[k]];
        if (!cause->nresets) continue;
        resets(m, s->events[due[k]], m->x, FIRST + due[k], values + cause->first_reset);
        for (int i = 0; i < cause->nresets; i++)
            if (!isfinite(values[cause->first_reset + i])) return 1;
    }
    for (const BlocksReset *r = setup->resets; r < setup->resets + setup->nresets; r++) {
        int fires = 0;
        for (int k = 0; k < ndue; k++) fires |= r->cause == FIRST + due[k];
        if (!fires) continue;
        double value = values[setup->causes[r->cause].first_reset + r->number];
        if (r->row == 1 && !blocks_is_whole(s, r->place, value)) return 1;
        (r->row == 0 ? m->x : m->d)[r->place] = value;
    }
    refresh(m);
    if (ndue == 1) return blocks_tell(s, FIRST + due[0]);
    for (int i = 0; i < setup->ncauses; i++)
        for (int k = 0; k < ndue; k++)
            if (setup->order[i] == FIRST + due[k] && blocks_tell(s, setup->order[i])) return 1;
    return 0;
}
#endif

#if BLOCKS_NRATES
/* Whether what ticks have computed may be held. */
static inline int may_hold(BlocksSim *s, const BlocksSlot *slots, int n)
{
    if (s->setup->nintegers || s->setup->nenabled) return !blocks_check_slots(s, slots, n);
    double bad = 0.0;
    _Pragma("GCC unroll 8") for (int i = 0; i < BLOCKS_ND; i++) bad += s->d1[i] * 0.0;
    return bad == 0.0;
}

static inline int any_is_due(const BlocksSim *s, const BlocksSlot *slots, int n)
{
    for (int i = 0; i < n; i++)
        if (s->due[slots[i].rate]) return 1;
    return 0;
}

/* The ticks of the rates that are due. */
static inline int tick_all(BlocksSim *s)
{
    const BlocksSetup *setup = s->setup;
    BlocksMemory *m = &s->memory;
    int clique = 0, begun = 0;
    COPY(s->d1, m->d, BLOCKS_ND);
    for (; clique < setup->ncliques - 1; clique++) {
        int fits = 1;
        for (int r = 0; r < BLOCKS_NRATES && fits; r++) fits = !s->due[r] || setup->cliques[clique].rates[r];
        if (fits) break;
    }
    const BlocksClique *c = &setup->cliques[clique];
    for (int stage = 0; stage < c->nstages; stage++) {
        const BlocksStage *part = &setup->stages[c->first_stage + stage];
        if (!any_is_due(s, setup->slots + part->first_slot, part->nslots)) continue;
        if (begun && !keeps_sides(s)) return 1;
        begun = 1;
        outputs(m, s->t, m->x, clique, stage, s->due, s->d1);
        if (!may_hold(s, setup->slots + part->first_slot, part->nslots)) return 1;
        COPY(m->d, s->d1, BLOCKS_ND);
        refresh(m);
    }
    if (any_is_due(s, setup->nexts, setup->nnexts)) {
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
#endif

/* Such an instant: 1; or 0, and nothing has happened yet. */
static __attribute__((noinline)) int plain_instant(BlocksSim *s)
{
    const BlocksSetup *setup = s->setup;
    BlocksMemory *m = &s->memory;
    double *x0 = s->backup, *d0 = x0 + BLOCKS_NX;
    const double known = s->known[0];
    const int64_t told = s->fired_events.used;
    int ndue = 0, ticks = 0;
    if (s->changed || s->crossing || s->moving || s->later != 0.0 || setup->nsteppers) return 0;
    if (setup->has_jumps && !setup->is_silent) return 0;
    for (int j = 0; BLOCKS_NU && j < setup->ntracks; j++)
        if (setup->tracks[j].n > 1) return 0;
#if BLOCKS_NEVENTS
    int32_t *due = (int32_t *)(void *)(s->ticks_backup + BLOCKS_NRATES);
    for (int i = 0; i < BLOCKS_NEVENTS; i++) {
        if (s->own[i] > s->t) return 0;
        if (!blocks_within_ulps(s->events[i], s->t, s->scale)) continue;
        if (s->events[i] > s->t) return 0; /* at its own time */
        due[ndue++] = i;
    }
    if (ndue && setup->nwaits) return 0;
#endif
    for (int r = 0; r < BLOCKS_NRATES; r++) {
        s->due[r] = s->exact == 1 && blocks_tick_count(s, r) == s->count;
        s->ticks_backup[r] = s->ticks[r];
        ticks |= s->due[r];
    }
    if (!keeps_sides(s)) return 0;
    if (ndue || ticks) {
        if (ndue) COPY(x0, m->x, BLOCKS_NX);
        COPY(d0, m->d, BLOCKS_ND);
#if BLOCKS_NEVENTS
        if (ndue && (fire_events(s, due, ndue) || !keeps_sides(s))) goto undo;
#endif
#if BLOCKS_NRATES
        if (ticks && tick_all(s)) goto undo;
#endif
#if BLOCKS_NEVENTS
        event_times(m, s->t, m->x, s->stage_values);
        for (int i = 0; i < BLOCKS_NEVENTS; i++) {
            int off = setup->causes[BLOCKS_NS + i].condition;
            if (off >= 0 && m->s[off] == 0.0) s->stage_values[i] = INFINITY;
            if (!(s->stage_values[i] > s->t)) goto undo;
        }
#endif
        if (setup->nmeasures && blocks_measure_instant(s)) goto undo;
    }
    if (!setup->is_silent && blocks_is_row_due(s) && blocks_record_on_grid(s)) goto undo;
#if BLOCKS_NEVENTS
    for (int k = 0; k < ndue; k++) s->own[due[k]] = s->events[due[k]];
    for (int i = 0; (ndue || ticks) && i < BLOCKS_NEVENTS; i++) s->events[i] = s->stage_values[i];
#endif
    if (ndue || ticks) {
        s->has_first = 0;
        s->sides_t = NAN;
        if (setup->nmeasures) blocks_take_instant(s);
    }
    s->outstanding = s->has_left = 0;
    s->instants++;
    return 1;
undo:
    if (!ndue && !ticks) return 0;
    if (ndue) COPY(m->x, x0, BLOCKS_NX);
    COPY(m->d, d0, BLOCKS_ND);
    for (int r = 0; r < BLOCKS_NRATES; r++) m->k[r] = (double)(s->ticks[r] = s->ticks_backup[r]);
    s->fired_events.used = told;
    if (s->known[0] != known) s->known[0] = NAN;
    refresh(m);
    return 0;
}
#endif
