/* The derivatives of a model; see jacobian.h and, for how they are laid out, compile/jacobian.py. */
#include "jacobian.h"

/* Solves matrix x = right for all columns of `right`, in place; 1 where the matrix is singular. */
static int solved(int n, int columns, double *matrix, double *right)
{
    for (int k = 0; k < n; k++) {
        int pivot = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(matrix[i * n + k]) > fabs(matrix[pivot * n + k])) pivot = i;
        if (!(fabs(matrix[pivot * n + k]) > 0.0)) return 1;
        for (int j = 0; j < n; j++) {
            double a = matrix[k * n + j];
            matrix[k * n + j] = matrix[pivot * n + j], matrix[pivot * n + j] = a;
        }
        for (int j = 0; j < columns; j++) {
            double a = right[k * columns + j];
            right[k * columns + j] = right[pivot * columns + j], right[pivot * columns + j] = a;
        }
        for (int i = k + 1; i < n; i++) {
            double share = matrix[i * n + k] / matrix[k * n + k];
            if (share == 0.0) continue;
            for (int j = k; j < n; j++) matrix[i * n + j] -= share * matrix[k * n + j];
            for (int j = 0; j < columns; j++) right[i * columns + j] -= share * right[k * columns + j];
        }
    }
    for (int k = n - 1; k >= 0; k--)
        for (int j = 0; j < columns; j++) {
            double sum = right[k * columns + j];
            for (int i = k + 1; i < n; i++) sum -= matrix[k * n + i] * right[i * columns + j];
            right[k * columns + j] = sum / matrix[k * n + k];
        }
    return 0;
}

/* The implicit derivatives of a loop. work: (n, n). */
static void solve_loop(const BlocksSum *sum, const double *partials, double *entries, double *work)
{
    int n = sum->n, columns = n ? (sum->hi - sum->lo) / n : 0;
    double *matrix = work, *right = entries + sum->lo;
    memset(matrix, 0, (size_t)(n * n) * sizeof(double));
    for (int k = 0; k < sum->hi - sum->lo; k++) right[k] = 0.0;
    for (int k = 0; k < sum->ninner; k++) matrix[sum->inner_places[k]] += partials[sum->inner_partials[k]];
    for (int i = 0; i < n; i++) matrix[i * n + i] -= sum->own[i];
    for (int k = 0; k < sum->nterms; k++)
        right[sum->places[k]] -= partials[sum->partials[k]] * (sum->sources ? entries[sum->sources[k]] : 1.0);
    int wrong = 0;
    for (int i = 0; i < n; i++) {
        double scale = 0.0;
        for (int j = 0; j < n; j++) scale = fmax(scale, fabs(matrix[i * n + j]));
        if (!(scale > 0.0) || !isfinite(scale)) wrong = 1;
        for (int j = 0; j < n; j++) matrix[i * n + j] /= scale;
        for (int j = 0; j < columns; j++) right[i * columns + j] /= scale;
    }
    if (wrong || solved(n, columns, matrix, right))
        for (int k = 0; k < sum->hi - sum->lo; k++) right[k] = NAN;
}

size_t blocks_jacobian_room(const BlocksJacobian *j)
{
    size_t most = (size_t)j->nmost;
    return (size_t)j->npartials + (size_t)j->nentries + (size_t)j->narguments + (size_t)j->nprobed + most * most + 1;
}

void blocks_jacobian(const BlocksJacobian *j, const BlocksSim *s, double t, const double *x, double *room, double *data)
{
    const BlocksModel *model = s->model;
    const BlocksMemory *m = &s->memory;
    double *partials = room, *entries = partials + j->npartials, *arguments = entries + j->nentries,
           *outputs = arguments + j->narguments, *work = outputs + j->nprobed, *a = arguments;
    j->outputs(m, t, x, outputs);
    const struct { const double *row; int n; } rows[] = {
        {x, model->nx}, {m->d, model->nd}, {m->s, model->ns}, {m->p, model->np}, {m->u, model->nu}, {m->k, model->nrates},
        {m->h, model->nh}, {outputs, j->nprobed}, {&t, 1}, {j->numbers, j->nnumbers}};
    for (size_t r = 0; r < sizeof rows / sizeof *rows; r++)
        for (int i = 0; i < rows[r].n; i++) *a++ = rows[r].row[i];
    j->partials(arguments, m->c, partials);
    for (int i = 0; i < j->npartials; i++) {
        if (j->is_unused[i]) partials[i] = 0.0;
        else if (!isfinite(partials[i])) partials[i] = NAN;
    }
    for (int k = 0; k < j->noff_partials; k++)
        if (m->s[j->off_partials[k].side] == 0.0)
            for (int i = 0; i < j->off_partials[k].n; i++) partials[j->off_partials[k].entries[i]] = 0.0;
    entries[0] = 1.0;
    for (int k = 0; k < j->nsums; k++) {
        const BlocksSum *sum = &j->sums[k];
        if (sum->is_loop) {
            solve_loop(sum, partials, entries, work);
            continue;
        }
        for (int i = 0; i < sum->hi - sum->lo; i++) {
            int first = sum->starts ? sum->starts[i] : i;
            int last = !sum->starts ? i + 1 : i + 1 < sum->hi - sum->lo ? sum->starts[i + 1] : sum->nterms;
            double total = 0.0;
            for (int p = first; p < last; p++)
                total += partials[sum->partials[p]] * (sum->sources ? entries[sum->sources[p]] : 1.0);
            entries[sum->lo + i] = total;
        }
    }
    for (int k = 0; k < j->first[j->ncolumns]; k++) data[k] = entries[j->entries[k]];
    for (int k = 0; k < j->noff; k++)
        if (m->s[j->off[k].side] == 0.0)
            for (int i = 0; i < j->off[k].n; i++) data[j->off[k].entries[i]] = 0.0;
}
