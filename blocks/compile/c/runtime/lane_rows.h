/* What stands in lanes, between them and the runs behind them, and the rows of a batch that they take. Part of
   lane_steps.h. */

/* What a lane is about: it has no row; its run stands at an instant; the row has ended; its run flows; there are no rows
   left; and it stands where another lane stood. */
enum { EMPTY, DUE, ENDED, FLOWING, IDLE, PARKED };

typedef struct {
    BlocksSim *s;
    double *room;
    int64_t row, stop; /* of the batch */
    int state, status; /* how the row ended */
} Lane;

/* Measures so far: as BlocksMeasured begins. */
typedef struct {
    V total, span, first, begin, target, last, low, high;
} Measured;

struct BlocksLanes {
    V rows_x[2][SOME(NX)], rows_k[STAGES + 1][SOME(SPAN)], xs[SOME(NX)], sides[SOME(NS)];
    V d[SOME(BLOCKS_ND)], s[SOME(NS)], p[SOME(BLOCKS_NP)], u[SOME(BLOCKS_NU)], tick[SOME(BLOCKS_NRATES)], q[SOME(BLOCKS_NQ)],
        v[SOME(BLOCKS_NV)], n[SOME(BLOCKS_NN)], w[SOME(LANES_NW)];
    V nodes[5][SOME(N)];
    Measured measured[SOME(N / 2)];
    V t, h, error, target, grow, known;
    M flowing, fresh; /* lanes that flow; those whose first rates are not known */
    V *x1, *k[STAGES], *before;
    LanesMemory m;
    int moves;
    BlocksModel model; /* that of the runs behind the lanes: they do not flow themselves */
    void *place;
    Lane lanes[BLOCKS_LANES];
};
typedef struct BlocksLanes Lanes;

/* --- between a lane and its run ---------------------------------------------------------------------------------- */

static void give_back(Lanes *z, int l)
{
    BlocksSim *s = z->lanes[l].s;
    for (int i = 0; i < NX; i++) s->memory.x[i] = z->m.x[i][l];
    for (int i = 0; i < WIDTH; i++) s->k[0][i] = z->k[0][i][l];
    for (int i = NX; i < WIDTH; i++) s->before[i] = z->before[i][l];
    if (s->t != z->t[l]) s->exact = 0;
    s->t = z->t[l], s->h = z->h[l], s->error = z->error[l];
    s->has_first = 1;
}

static void give_step(Lanes *z, int l)
{
    BlocksSim *s = z->lanes[l].s;
    for (int i = 0; i < NX; i++) s->x1[i] = z->x1[i][l];
    for (int n = 1; n < STAGES; n++)
        for (int i = 0; i < WIDTH; i++) s->k[n][i] = z->k[n][i][l];
}

#if BLOCKS_QUICK_MEASURES
static void give_measure(const Lanes *z, int l, int i)
{
    const V *from = &z->measured[i].total;
    double *to = &z->lanes[l].s->measured[i].total;
    for (int k = 0; k < BLOCKS_KEPT; k++) to[k] = from[k][l];
}

static void take_measure(Lanes *z, int l, int i)
{
    V *to = &z->measured[i].total;
    const double *from = &z->lanes[l].s->measured[i].total;
    for (int k = 0; k < BLOCKS_KEPT; k++) to[k][l] = from[k];
}
#endif

static void give_measures(const Lanes *z, int l)
{
    (void)z, (void)l;
#if BLOCKS_QUICK_MEASURES
    BlocksSim *s = z->lanes[l].s;
    s->known[0] = z->known[l];
    for (int j = 0; j < N; j++) s->nodes[j] = z->nodes[0][j][l];
    for (int i = 0; i < N / 2; i++) give_measure(z, l, i);
#endif
}

static void take_back(Lanes *z, int l)
{
    BlocksSim *s = z->lanes[l].s;
    for (int i = 0; i < NX; i++) z->m.x[i][l] = s->memory.x[i];
    for (int i = 0; i < WIDTH && s->has_first; i++) z->k[0][i][l] = s->k[0][i];
    z->t[l] = s->t, z->h[l] = s->h, z->error[l] = s->error;
    z->fresh[l] = -!s->has_first;
    s->has_before = 0;
#if BLOCKS_QUICK_MEASURES
    z->known[l] = s->known[0];
    for (int j = 0; j < N; j++) z->nodes[0][j][l] = s->nodes[j];
    for (int i = 0; i < N / 2; i++) take_measure(z, l, i);
#endif
}

/* What instants change, beside states. */
static void take_memory(Lanes *z, int l)
{
    const BlocksMemory *m = &z->lanes[l].s->memory;
    for (int i = 0; i < BLOCKS_ND; i++) z->d[i][l] = m->d[i];
    for (int i = 0; i < NS; i++) z->s[i][l] = m->s[i];
    for (int i = 0; i < BLOCKS_NU; i++) z->u[i][l] = m->u[i];
    for (int i = 0; i < BLOCKS_NRATES; i++) z->tick[i][l] = m->k[i];
    for (int i = 0; i < BLOCKS_NV; i++) z->v[i][l] = m->v[i];
#if IS_WATCHED
    for (int j = 0; j < NS; j++) z->sides[j][l] = m->s[sides_at[j]];
#endif
    z->moves = 0;
    EACH_LANE z->moves |= z->lanes[l].state == FLOWING && z->lanes[l].s->moving;
}

static void take_parameters(Lanes *z, int l)
{
    const BlocksMemory *m = &z->lanes[l].s->memory;
    for (int i = 0; i < BLOCKS_NP; i++) z->p[i][l] = m->p[i];
    for (int i = 0; i < BLOCKS_NQ; i++) z->q[i][l] = m->q[i];
}

/* Inputs as they are at a time of each lane. */
static void outside(Lanes *z, V then)
{
    EACH_LANE {
        BlocksSim *s = z->lanes[l].s;
        if (z->lanes[l].state != FLOWING || !s->moving) continue;
        blocks_outside(s, then[l]);
        for (int i = 0; i < BLOCKS_NU; i++) z->u[i][l] = s->memory.u[i];
    }
}

/* --- rows of the batch ------------------------------------------------------------------------------------------- */

/* In place of a run's own loop: the way to the next instant is made in the lane. */
static int flow_in_lane(BlocksSim *s, double target)
{
    s->soft = target;
    return BLOCKS_PAUSED;
}

static void end_row(Lane *lane, int status)
{
    lane->status = status == BLOCKS_FAILED && lane->s->failure == -1 ? BLOCKS_NO_MEMORY : status;
    lane->state = ENDED;
}

/* Let happen what is due, up to where the run flows or ends. */
static void settle(Lanes *z, const BlocksBatch *b, int l)
{
    Lane *lane = &z->lanes[l];
    BlocksSim *s = lane->s;
    while (lane->state == DUE) {
        if (lane->stop == b->nstops) {
            end_row(lane, BLOCKS_DONE);
            return;
        }
        s->soft = INFINITY;
        int status = blocks_advance(s, b->stops[lane->stop], 0, 2);
        s->fired_events.used = 0; /* nobody reads them */
        if (status == BLOCKS_DONE) lane->stop++;
        else if (status == BLOCKS_PAUSED) lane->state = FLOWING;
        else end_row(lane, status);
    }
    if (lane->state != FLOWING) return;
    z->target[l] = s->soft;
    z->grow[l] = 10.0;
    s->soft = INFINITY;
    if (s->setup->every.is_given) blocks_next_row(s);
    else s->next_row = INFINITY;
    take_back(z, l);
    take_memory(z, l);
}

static void begin_row(Lanes *z, BlocksBatch *b, int l)
{
    Lane *lane = &z->lanes[l];
    BlocksSim *s = lane->s;
    lane->row = __atomic_fetch_add(&b->next, 1, __ATOMIC_RELAXED);
    lane->stop = 0;
    lane->state = IDLE;
    if (lane->row >= b->nrows) return;
    blocks_row_begin(b, s, lane->row, lane->room);
    s->slice = INFINITY; /* the clock is not looked at */
    lane->state = DUE;
    if (blocks_start(s)) end_row(lane, BLOCKS_FAILED);
    s->model = &z->model; /* not before: a run starts with the model of its setup */
    take_parameters(z, l);
    settle(z, b, l);
}

