#include "batch.h"

int blocks_is_cancelled(BlocksBatch *b) { return __atomic_load_n(&b->is_cancelled, __ATOMIC_RELAXED); }

void blocks_row_begin(const BlocksBatch *b, BlocksSim *s, int64_t row, double *room)
{
    const BlocksModel *model = s->model;
    blocks_reset(s);
    s->t = s->broken = b->start;
    s->count = b->count;
    s->exact = b->exact;
    s->crossing = b->crossing;
    memcpy(s->memory.p, b->p + row * model->np, (size_t)model->np * sizeof(double));
    memcpy(s->memory.z, b->z, (size_t)model->nz * sizeof(double));
    memcpy(s->memory.s, b->s, (size_t)model->ns * sizeof(double));
    memcpy(s->located, b->located, (size_t)model->ns * sizeof(double));
    memcpy(s->ticks, b->ticks, (size_t)model->nrates * sizeof(int64_t));
    if (b->ngrid) {
        s->rows.next = room;
        s->rows.end = room + (b->ngrid + 1) * (1 + s->rows.columns);
    }
}

/* Whether a run has taken more steps than it may. It is asked again where a row ends, so that what becomes of it does
   not depend on when the clock brought it back. */
static int is_over(const BlocksBatch *b, const BlocksSim *s) { return b->budget && s->steps + s->rejected > b->budget; }

static int run_row(BlocksBatch *b, BlocksSim *s)
{
    if (blocks_start(s)) return s->failure == -1 ? BLOCKS_NO_MEMORY : BLOCKS_FAILED;
    for (int64_t k = 0; k < b->nstops; k++) {
        int status = BLOCKS_PAUSED;
        while (status == BLOCKS_PAUSED) {
            status = blocks_advance(s, b->stops[k], 0, 2);
            s->fired_events.used = 0; /* nobody reads them */
            if (status == BLOCKS_PAUSED && (blocks_is_cancelled(b) || is_over(b, s))) return BLOCKS_PAUSED;
        }
        if (status != BLOCKS_DONE) return status;
    }
    return BLOCKS_DONE;
}

/* What became of the row. */
void blocks_row_keep(BlocksBatch *b, BlocksSim *s, int64_t row, int status, const double *room)
{
    int n = s->setup->nmeasures;
    int64_t width = 1 + s->rows.columns, made = 0;
    double *measured = b->measured + row * n * BLOCKS_KEPT;
    if (status == BLOCKS_DONE && s->setup->has_windows) blocks_measure_end(s);
    for (int i = 0; i < n; i++) memcpy(measured + i * BLOCKS_KEPT, &s->measured[i], BLOCKS_KEPT * sizeof(double));
    if (b->ngrid && !is_over(b, s)) {
        made = s->rows.nchunks ? b->ngrid : (s->rows.next - room) / width;
        if (made > b->ngrid) made = b->ngrid;
        double *to = b->signals + row * b->ngrid * s->rows.columns;
        for (int64_t k = 0; k < made; k++)
            memcpy(to + k * s->rows.columns, room + k * width + 1, (size_t)s->rows.columns * sizeof(double));
    }
    b->ended[row] = s->t;
    b->steps[row] = s->steps + s->rejected;
    b->failure[row] = s->failure;
    b->culprit[row] = s->culprit;
    b->status[row] = is_over(b, s) ? BLOCKS_ROW_BUDGET
                     : status == BLOCKS_DONE ? (blocks_has_ended(s) ? BLOCKS_ROW_STOPPED : BLOCKS_ROW_DONE)
                     : status == BLOCKS_NO_MEMORY ? BLOCKS_ROW_NO_MEMORY : BLOCKS_ROW_FAILED;
    __atomic_fetch_add(&b->done, 1, __ATOMIC_RELAXED);
}

int64_t blocks_batch(BlocksBatch *b, BlocksSim *s, double *room)
{
    while (!blocks_is_cancelled(b)) {
        int64_t row = __atomic_fetch_add(&b->next, 1, __ATOMIC_RELAXED);
        if (row >= b->nrows) return -1;
        blocks_row_begin(b, s, row, room);
        int status = run_row(b, s);
        if (status == BLOCKS_PAUSED && !is_over(b, s)) return -1; /* cancelled: it is left */
        blocks_row_keep(b, s, row, status, room);
        if (b->is_by_one) return row;
    }
    return -1;
}
