/* Gauss elimination of a real and a complex matrix at once: they differ in a multiple of the unit matrix.

   Dense ones by rows with partial pivoting. Sparse ones column by column, each after those that it needs (J. Gilbert and
   T. Peierls, Sparse partial pivoting in time proportional to arithmetic operations, 1988). A column keeps the pivot that
   it had before, at first its diagonal, while that is large enough; while all do, the pattern of the factors is known. */
#include "stiff.h"

#include <stdlib.h>

/* A pivot that is kept may be so much smaller than the largest number of its column. */
static const double KEPT = 1e-3;

static BlocksFactors *with_room(BlocksFactors *f, int32_t nvalues)
{
    size_t n = (size_t)f->n + 1;
    int32_t *ints = calloc(11 * n + (size_t)nvalues, sizeof(int32_t));
    f->real_rows = ints;
    if (!f->order) {
        f->dense = malloc(3 * n * n * sizeof(double));
        f->work = malloc(n * sizeof(BlocksPair));
        if (!ints || !f->dense || !f->work) {
            blocks_factors_free(f);
            return NULL;
        }
        f->complex_rows = ints + n, f->pivots = ints + 2 * n;
        return f;
    }
    int32_t **places[] = {&f->complex_rows, &f->pivots, &f->place, &f->lower_first, &f->upper_first,
                          &f->stack, &f->path, &f->edge, &f->marked, &f->at};
    f->inverse = malloc(2 * n * sizeof(BlocksPair));
    if (!ints || !f->inverse) {
        blocks_factors_free(f);
        return NULL;
    }
    for (size_t k = 0; k < sizeof places / sizeof *places; k++) *places[k] = ints + (k + 1) * n;
    f->work = f->inverse + n;
    return f;
}

BlocksFactors *blocks_factors_new(int32_t n, const int32_t *first, const int32_t *rows, const int32_t *order)
{
    BlocksFactors *f = calloc(1, sizeof *f);
    if (!f) return NULL;
    f->n = n, f->first = first, f->rows = rows, f->order = order;
    return with_room(f, first[n]);
}

void blocks_factors_free(BlocksFactors *f)
{
    if (!f) return;
    free(f->real_rows);
    free(f->dense);
    if (f->order) free(f->inverse), free(f->lower_rows), free(f->upper_rows), free(f->lower), free(f->upper);
    else free(f->work);
    free(f);
}

/* --- dense ------------------------------------------------------------------------------------------------------ */

static int dense_real(double *a, int n, int32_t *rows)
{
    for (int i = 0; i < n; i++) rows[i] = i;
    for (int k = 0; k < n; k++) {
        int pivot = k;
        double most = fabs(a[k * n + k]);
        for (int i = k + 1; i < n; i++) {
            double size = fabs(a[i * n + k]);
            if (size > most) most = size, pivot = i;
        }
        if (!(most > 0.0) || !isfinite(most)) return 1;
        if (pivot != k) {
            int32_t row = rows[k];
            rows[k] = rows[pivot], rows[pivot] = row;
            for (int j = 0; j < n; j++) {
                double value = a[k * n + j];
                a[k * n + j] = a[pivot * n + j], a[pivot * n + j] = value;
            }
        }
        const double *restrict upper = a + k * n;
        double inverse = a[k * n + k] = 1.0 / upper[k];
        for (int i = k + 1; i < n; i++) {
            double *restrict row = a + i * n, share = row[k] * inverse;
            row[k] = share;
            if (share == 0.0) continue;
            for (int j = k + 1; j < n; j++) row[j] -= share * upper[j];
        }
    }
    return 0;
}

static int dense_complex(double *a, double *b, int n, int32_t *rows)
{
    for (int i = 0; i < n; i++) rows[i] = i;
    for (int k = 0; k < n; k++) {
        int pivot = k;
        double most = fabs(a[k * n + k]) + fabs(b[k * n + k]);
        for (int i = k + 1; i < n; i++) {
            double size = fabs(a[i * n + k]) + fabs(b[i * n + k]);
            if (size > most) most = size, pivot = i;
        }
        if (!(most > 0.0) || !isfinite(most)) return 1;
        if (pivot != k) {
            int32_t row = rows[k];
            rows[k] = rows[pivot], rows[pivot] = row;
            for (int j = 0; j < n; j++) {
                double re = a[k * n + j], im = b[k * n + j];
                a[k * n + j] = a[pivot * n + j], a[pivot * n + j] = re;
                b[k * n + j] = b[pivot * n + j], b[pivot * n + j] = im;
            }
        }
        const double *restrict upper = a + k * n, *restrict other = b + k * n;
        double size = 1.0 / (upper[k] * upper[k] + other[k] * other[k]), re = upper[k] * size, im = -other[k] * size;
        a[k * n + k] = re, b[k * n + k] = im;
        for (int i = k + 1; i < n; i++) {
            double *restrict row = a + i * n, *restrict beside = b + i * n;
            double share = row[k] * re - beside[k] * im, turn = row[k] * im + beside[k] * re;
            row[k] = share, beside[k] = turn;
            if (share == 0.0 && turn == 0.0) continue;
            for (int j = k + 1; j < n; j++) {
                row[j] -= share * upper[j] - turn * other[j];
                beside[j] -= share * other[j] + turn * upper[j];
            }
        }
    }
    return 0;
}

static int dense_factor(BlocksFactors *f, const double *slopes, BlocksPair shift)
{
    const int n = f->n;
    const size_t square = (size_t)n * (size_t)n;
    double *real = f->dense, *re = real + square, *im = re + square;
    memset(real, 0, square * sizeof(double));
    for (int j = 0; j < n; j++)
        for (int p = f->first[j]; p < f->first[j + 1]; p++) real[(size_t)f->rows[p] * (size_t)n + (size_t)j] = -slopes[p];
    memcpy(re, real, square * sizeof(double));
    memset(im, 0, square * sizeof(double));
    for (int i = 0; i < n; i++) {
        size_t at = (size_t)i * (size_t)n + (size_t)i;
        real[at] += shift.real, re[at] += shift.re, im[at] += shift.im;
    }
    return dense_real(real, n, f->real_rows) || dense_complex(re, im, n, f->complex_rows);
}

static void dense_solve_real(const BlocksFactors *f, double *real)
{
    const int n = f->n;
    BlocksPair *y = f->work;
    for (int i = 0; i < n; i++) {
        const double *row = f->dense + (size_t)i * (size_t)n;
        double sum = real[f->real_rows[i]];
        for (int j = 0; j < i; j++) sum -= row[j] * y[j].real;
        y[i].real = sum;
    }
    for (int i = n - 1; i >= 0; i--) {
        const double *row = f->dense + (size_t)i * (size_t)n;
        double sum = y[i].real;
        for (int j = i + 1; j < n; j++) sum -= row[j] * real[j];
        real[i] = sum * row[i];
    }
}

static void dense_solve_complex(const BlocksFactors *f, double *re, double *im)
{
    const int n = f->n;
    const size_t square = (size_t)n * (size_t)n;
    const double *factor = f->dense + square;
    BlocksPair *y = f->work;
    for (int i = 0; i < n; i++) {
        const double *a = factor + (size_t)i * (size_t)n, *b = a + square;
        double sum = re[f->complex_rows[i]], turn = im[f->complex_rows[i]];
        for (int j = 0; j < i; j++) {
            sum -= a[j] * y[j].re - b[j] * y[j].im;
            turn -= a[j] * y[j].im + b[j] * y[j].re;
        }
        y[i].re = sum, y[i].im = turn;
    }
    for (int i = n - 1; i >= 0; i--) {
        const double *a = factor + (size_t)i * (size_t)n, *b = a + square;
        double sum = y[i].re, turn = y[i].im;
        for (int j = i + 1; j < n; j++) {
            sum -= a[j] * re[j] - b[j] * im[j];
            turn -= a[j] * im[j] + b[j] * re[j];
        }
        re[i] = sum * a[i] - turn * b[i];
        im[i] = sum * b[i] + turn * a[i];
    }
}

/* --- sparse ----------------------------------------------------------------------------------------------------- */

static inline double size_of(BlocksPair a) { return fabs(a.re) + fabs(a.im); }

static inline void subtract(BlocksPair *from, BlocksPair a, BlocksPair b)
{
    from->real -= a.real * b.real;
    from->re -= a.re * b.re - a.im * b.im;
    from->im -= a.re * b.im + a.im * b.re;
}

static inline BlocksPair times(BlocksPair a, BlocksPair b)
{
    return (BlocksPair){a.real * b.real, a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}

static inline BlocksPair inverted(BlocksPair a)
{
    double size = 1.0 / (a.re * a.re + a.im * a.im);
    return (BlocksPair){1.0 / a.real, a.re * size, -a.im * size};
}

static int grown(int32_t **rows, BlocksPair **values, int64_t *room, int64_t needed)
{
    if (needed <= *room) return 0;
    int64_t count = 2 * needed;
    int32_t *more_rows = realloc(*rows, (size_t)count * sizeof(int32_t));
    if (more_rows) *rows = more_rows;
    BlocksPair *more_values = realloc(*values, (size_t)count * sizeof(BlocksPair));
    if (more_values) *values = more_values;
    if (!more_rows || !more_values) return 1;
    *room = count;
    return 0;
}

/* The rows in which the solution of L x = column can differ from 0, on `stack` from the returned place on, each before
   those that it changes: by a search through the columns of L. */
static int reached(BlocksFactors *f, int column, int k)
{
    int top = f->n;
    for (int p = f->first[column] - 1; p < f->first[column + 1]; p++) {
        int row = p < f->first[column] ? column : f->rows[p], depth = 0;
        if (f->marked[row] == k + 1) continue;
        f->marked[row] = k + 1;
        f->path[0] = row;
        f->edge[0] = f->place[row] >= 0 ? f->lower_first[f->place[row]] : 0;
        while (depth >= 0) {
            int at = f->path[depth], pivot = f->place[at], is_done = 1;
            int end = pivot >= 0 ? f->lower_first[pivot + 1] : 0;
            while (pivot >= 0 && f->edge[depth] < end) {
                int next = f->lower_rows[f->edge[depth]++];
                if (f->marked[next] == k + 1) continue;
                f->marked[next] = k + 1;
                f->path[++depth] = next;
                f->edge[depth] = f->place[next] >= 0 ? f->lower_first[f->place[next]] : 0;
                is_done = 0;
                break;
            }
            if (is_done) f->stack[--top] = f->path[depth--];
        }
    }
    return top;
}

/* The row for the pivot of a column among those on `stack` that have none: the one that it prefers, where that is large
   enough in both matrices, else the one that is largest; -1: they are singular. */
static int pivot_of(const BlocksFactors *f, int column, int top)
{
    double most = 0.0, most_complex = 0.0, best = -1.0;
    int found = -1, preferred = f->pivots[column];
    for (int p = top; p < f->n; p++) {
        int row = f->stack[p];
        if (f->place[row] >= 0) continue;
        double size = fabs(f->work[row].real), other = size_of(f->work[row]);
        if (!isfinite(size + other)) return -1;
        if (size > most) most = size;
        if (other > most_complex) most_complex = other;
        if (size < other ? size > best : other > best) best = size < other ? size : other, found = row;
    }
    if (!(best > 0.0)) return -1;
    BlocksPair own = f->work[preferred];
    int is_free = f->place[preferred] < 0 && f->marked[preferred] == f->marked[column];
    if (is_free && fabs(own.real) >= KEPT * most && size_of(own) >= KEPT * most_complex) return preferred;
    return found;
}

static int factor_anew(BlocksFactors *f, const double *slopes, BlocksPair shift)
{
    const int n = f->n;
    int32_t lower = 0, upper = 0;
    f->has_structure = 0;
    for (int i = 0; i < n; i++) f->place[i] = -1, f->marked[i] = 0;
    for (int k = 0; k < n; k++) {
        int column = f->order[k];
        f->lower_first[k] = lower, f->upper_first[k] = upper;
        if (grown(&f->lower_rows, &f->lower, &f->lower_room, (int64_t)lower + n)) return 2;
        if (grown(&f->upper_rows, &f->upper, &f->upper_room, (int64_t)upper + n)) return 2;
        int top = reached(f, column, k);
        for (int p = top; p < n; p++) f->work[f->stack[p]] = (BlocksPair){0.0, 0.0, 0.0};
        f->work[column] = shift;
        for (int p = f->first[column]; p < f->first[column + 1]; p++)
            f->work[f->rows[p]].real -= slopes[p], f->work[f->rows[p]].re -= slopes[p];
        for (int p = top; p < n; p++) {
            int row = f->stack[p], pivot = f->place[row];
            if (pivot < 0) continue;
            BlocksPair value = f->work[row];
            f->upper_rows[upper] = pivot, f->upper[upper++] = value;
            for (int q = f->lower_first[pivot]; q < f->lower_first[pivot + 1]; q++)
                subtract(&f->work[f->lower_rows[q]], f->lower[q], value);
        }
        int row = pivot_of(f, column, top);
        if (row < 0) return 1;
        f->pivots[column] = row;
        f->place[row] = k;
        f->inverse[k] = inverted(f->work[row]);
        for (int p = top; p < n; p++)
            if (f->place[f->stack[p]] < 0) {
                f->lower_rows[lower] = f->stack[p];
                f->lower[lower++] = times(f->work[f->stack[p]], f->inverse[k]);
            }
        f->lower_first[k + 1] = lower, f->upper_first[k + 1] = upper;
    }
    for (int p = 0; p < lower; p++) f->lower_rows[p] = f->place[f->lower_rows[p]];
    for (int p = 0; p < f->first[n]; p++) f->at[p] = f->place[f->rows[p]];
    f->has_structure = 1;
    return 0;
}

/* The same with the pivots and the pattern that are known: 0; -1 where a pivot has become too small. */
static int factor_again(BlocksFactors *f, const double *slopes, BlocksPair shift)
{
    BlocksPair *restrict x = f->work, *restrict lower = f->lower, *restrict upper = f->upper;
    const int32_t *restrict lower_rows = f->lower_rows, *restrict upper_rows = f->upper_rows;
    const BlocksPair zero = {0.0, 0.0, 0.0};
    for (int k = 0; k < f->n; k++) {
        int column = f->order[k], low = f->lower_first[k], end = f->lower_first[k + 1];
        x[k] = zero;
        for (int p = f->upper_first[k]; p < f->upper_first[k + 1]; p++) x[upper_rows[p]] = zero;
        for (int p = low; p < end; p++) x[lower_rows[p]] = zero;
        x[f->place[column]] = shift;
        for (int p = f->first[column]; p < f->first[column + 1]; p++) x[f->at[p]].real -= slopes[p], x[f->at[p]].re -= slopes[p];
        for (int p = f->upper_first[k]; p < f->upper_first[k + 1]; p++) {
            int pivot = upper_rows[p];
            BlocksPair value = upper[p] = x[pivot];
            for (int q = f->lower_first[pivot]; q < f->lower_first[pivot + 1]; q++) subtract(&x[lower_rows[q]], lower[q], value);
        }
        double size = fabs(x[k].real), other = size_of(x[k]), most = size, most_complex = other;
        for (int p = low; p < end; p++) {
            double a = fabs(x[lower_rows[p]].real), b = size_of(x[lower_rows[p]]);
            most = a > most ? a : most, most_complex = b > most_complex ? b : most_complex;
        }
        if (!(size >= KEPT * most && other >= KEPT * most_complex && size > 0.0 && isfinite(most + most_complex))) return -1;
        BlocksPair inverse = f->inverse[k] = inverted(x[k]);
        for (int p = low; p < end; p++) lower[p] = times(x[lower_rows[p]], inverse);
    }
    return 0;
}

int blocks_factor(BlocksFactors *f, const double *slopes, BlocksPair shift)
{
    if (!f->order) return dense_factor(f, slopes, shift);
    int is_same = f->has_structure; /* the pivots may have been set since */
    for (int k = 0; k < f->n && is_same; k++) is_same = f->place[f->pivots[f->order[k]]] == k;
    if (is_same && !factor_again(f, slopes, shift)) return 0;
    return factor_anew(f, slopes, shift);
}

void blocks_solve_real(const BlocksFactors *f, double *real)
{
    if (!f->order) {
        dense_solve_real(f, real);
        return;
    }
    BlocksPair *restrict y = f->work;
    for (int i = 0; i < f->n; i++) y[f->place[i]].real = real[i];
    for (int k = 0; k < f->n; k++)
        for (int p = f->lower_first[k]; p < f->lower_first[k + 1]; p++)
            y[f->lower_rows[p]].real -= f->lower[p].real * y[k].real;
    for (int k = f->n - 1; k >= 0; k--) {
        double value = y[k].real * f->inverse[k].real;
        real[f->order[k]] = value;
        for (int p = f->upper_first[k]; p < f->upper_first[k + 1]; p++) y[f->upper_rows[p]].real -= f->upper[p].real * value;
    }
}

void blocks_solve(const BlocksFactors *f, double *real, double *re, double *im)
{
    if (!f->order) {
        dense_solve_real(f, real);
        dense_solve_complex(f, re, im);
        return;
    }
    BlocksPair *restrict y = f->work;
    for (int i = 0; i < f->n; i++) y[f->place[i]] = (BlocksPair){real[i], re[i], im[i]};
    for (int k = 0; k < f->n; k++) {
        BlocksPair value = y[k];
        for (int p = f->lower_first[k]; p < f->lower_first[k + 1]; p++) subtract(&y[f->lower_rows[p]], f->lower[p], value);
    }
    for (int k = f->n - 1; k >= 0; k--) {
        int column = f->order[k];
        BlocksPair value = times(y[k], f->inverse[k]);
        real[column] = value.real, re[column] = value.re, im[column] = value.im;
        for (int p = f->upper_first[k]; p < f->upper_first[k + 1]; p++) subtract(&y[f->upper_rows[p]], f->upper[p], value);
    }
}
