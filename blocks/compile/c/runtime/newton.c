/* Newton's method for algebraic loops: the twin of engines/reference/newton.py, which says what is searched for and how. */
#include "model.h"

#include <stdlib.h>
#include <string.h>

enum { MOST_STEPS = 60, MOST_HALVINGS = 30, FEW_STEPS = 10, FEW_HALVINGS = 4, ROOM = 128 };
static const double CLOSE = 1e-13, NEAR = 1e-9, SINGULAR = 1e13, ROUNDING = 4 * 2.220446049250313e-16;
static const double FIRST_PART = 0.125, LEAST_PART = 1e-6, FIRST_DISTANCE = 1e-6, LAST_DISTANCE = 1e20;

/* A system, and room for a step, for what residuals are to become, and for a matrix that is solved. */
typedef struct {
    BlocksSystem system;
    BlocksRounding rounding;
    const BlocksMemory *m;
    const double *known;
    int n, others;
    double *step, *wanted, *again, *work;
} Loop;

/* A system at some unknowns. */
typedef struct {
    double *x, *residuals, *matrix;
} Point;

static size_t point_size(const Loop *l)
{
    size_t n = (size_t)l->n;
    return n + (n + (size_t)l->others) + n * n;
}

static size_t work_size(const Loop *l)
{
    size_t n = (size_t)l->n;
    return 3 * n + n * n + n * (n + 1);
}

static double *with_work(Loop *l, double *room)
{
    l->step = room, l->wanted = room + l->n, l->again = room + 2 * l->n, l->work = room + 3 * l->n;
    return room + work_size(l);
}

static Point point_in(const Loop *l, double *room)
{
    return (Point){room, room + l->n, room + 2 * l->n + l->others};
}

static void copy(const Loop *l, Point *to, const Point *from) { memcpy(to->x, from->x, point_size(l) * sizeof(double)); }

static void swap(Point *a, Point *b)
{
    Point c = *a;
    *a = *b, *b = c;
}

static void evaluate(const Loop *l, Point *p) { l->system(l->m, l->known, p->x, p->residuals, p->matrix); }

static double largest(const double *v, int n)
{
    double most = 0.0;
    for (int i = 0; i < n; i++) most = fabs(v[i]) > most || isnan(v[i]) ? fabs(v[i]) : most;
    return most;
}

static int is_finite(const Loop *l, const Point *p)
{
    double sum = 0.0;
    for (int i = 0; i < l->n; i++) sum += p->residuals[i] * 0.0;
    for (int i = 0; i < l->n * l->n; i++) sum += p->matrix[i] * 0.0;
    return sum == 0.0;
}

/* Whether the residuals are no more than what rounding leaves of 0. */
static int is_rounding(const Loop *l, const Point *p)
{
    l->rounding(l->m, l->known, p->x, l->again);
    for (int i = 0; i < l->n; i++)
        if (!(fabs(p->residuals[i]) <= ROUNDING * l->again[i])) return 0;
    return 1;
}

static int is_small(const Loop *l, const double *x, double share, double more)
{
    for (int i = 0; i < l->n; i++)
        if (!(fabs(l->step[i]) <= share * (fabs(x[i]) + more))) return 0;
    return 1;
}

/* The step that takes residuals to 0 in a straight line; 1 where the matrix is singular to working precision. */
static int solved(int n, const double *matrix, const double *residuals, double *step, double *work)
{
    if (n == 1) {
        if (matrix[0] == 0.0) return 1;
        step[0] = -residuals[0] / matrix[0];
        return 0;
    }
    double *lu = work, *inverse = work + n * n, norm = 0.0, inverse_norm = 0.0;
    for (int i = 0; i < n; i++) {
        double scale = largest(matrix + i * n, n), sum = 0.0;
        if (scale == 0.0) return 1;
        for (int j = 0; j < n; j++) {
            lu[i * n + j] = matrix[i * n + j] / scale;
            inverse[i * (n + 1) + j] = i == j;
            sum += fabs(lu[i * n + j]);
        }
        inverse[i * (n + 1) + n] = -residuals[i] / scale;
        norm = fmax(norm, sum);
    }
    /* Gauss and Jordan, the right side and the unit matrix at once. */
    for (int k = 0; k < n; k++) {
        int pivot = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(lu[i * n + k]) > fabs(lu[pivot * n + k])) pivot = i;
        if (lu[pivot * n + k] == 0.0) return 1;
        for (int j = 0; j < n; j++) {
            double a = lu[k * n + j];
            lu[k * n + j] = lu[pivot * n + j];
            lu[pivot * n + j] = a;
        }
        for (int j = 0; j <= n; j++) {
            double a = inverse[k * (n + 1) + j];
            inverse[k * (n + 1) + j] = inverse[pivot * (n + 1) + j];
            inverse[pivot * (n + 1) + j] = a;
        }
        double by = lu[k * n + k];
        for (int j = 0; j < n; j++) lu[k * n + j] /= by;
        for (int j = 0; j <= n; j++) inverse[k * (n + 1) + j] /= by;
        for (int i = 0; i < n; i++) {
            double share = lu[i * n + k];
            if (i == k || share == 0.0) continue;
            for (int j = 0; j < n; j++) lu[i * n + j] -= share * lu[k * n + j];
            for (int j = 0; j <= n; j++) inverse[i * (n + 1) + j] -= share * inverse[k * (n + 1) + j];
        }
    }
    for (int i = 0; i < n; i++) {
        double sum = 0.0;
        for (int j = 0; j < n; j++) sum += fabs(inverse[i * (n + 1) + j]);
        inverse_norm = fmax(inverse_norm, sum);
        step[i] = inverse[i * (n + 1) + n];
    }
    return norm * inverse_norm > SINGULAR;
}

/* From p to the solution, by steps that lower the largest residual. */
static int descended(const Loop *l, Point *p, Point *tried)
{
    int n = l->n;
    double size = largest(p->residuals, n);
    for (int k = 0; k < MOST_STEPS; k++) {
        if (k >= FEW_STEPS && is_rounding(l, p)) return 1; /* an unknown that is 0 but for rounding goes on to fall */
        if (!is_finite(l, p) || solved(n, p->matrix, p->residuals, l->step, l->work)) return 0;
        /* A solution stays as it is: at one instant all see the same bits. */
        if (!k && is_small(l, p->x, CLOSE, 0.0) && is_rounding(l, p)) return 1;
        double share = 1.0, then = NAN;
        int halvings = 0;
        for (; halvings < MOST_HALVINGS; halvings++) {
            for (int i = 0; i < n; i++) tried->x[i] = p->x[i] + share * l->step[i];
            evaluate(l, tried);
            then = largest(tried->residuals, n);
            if (then < size || then == 0.0) break;
            /* Rounding decides from here on. */
            if (!halvings && (is_small(l, p->x, CLOSE, 1e-3) || is_rounding(l, p))) return 1;
            if (halvings == FEW_HALVINGS && is_small(l, p->x, NEAR, 0.0)) return 1;
            share /= 2;
        }
        if (halvings == MOST_HALVINGS) return 0;
        int is_last = share == 1.0 && is_small(l, p->x, CLOSE, 0.0);
        swap(p, tried);
        size = then;
        if (size == 0.0 || is_last) return 1;
    }
    return is_rounding(l, p);
}

static double scaled(const Loop *l, const Point *p, const double *step)
{
    double most = 0.0;
    for (int i = 0; i < l->n; i++) {
        double part = fabs(step[i] / (fabs(p->x[i]) + fabs(l->step[i]) + 5e-324));
        most = part > most || isnan(part) ? part : most;
    }
    return most;
}

static double less(const Loop *l, const Point *p, const double *left)
{
    for (int i = 0; i < l->n; i++) l->wanted[i] = left ? p->residuals[i] - left[i] : p->residuals[i];
    return largest(l->wanted, l->n);
}

/* From p to a point near that where the residuals are `left` (null: 0): each step lowers them, or the step they ask for. */
static int moved(const Loop *l, Point *p, Point *tried, const double *left, int most)
{
    int n = l->n;
    for (int k = 0; k < most; k++) {
        double size = less(l, p, left), share = 1.0;
        if (solved(n, p->matrix, l->wanted, l->step, l->work)) return 0;
        double asked = scaled(l, p, l->step);
        int halvings = 0;
        for (; halvings < MOST_HALVINGS; halvings++) {
            for (int i = 0; i < n; i++) tried->x[i] = p->x[i] + share * l->step[i];
            evaluate(l, tried);
            if (is_finite(l, tried)) {
                if (less(l, tried, left) < size) break;
                if (!solved(n, p->matrix, l->wanted, l->again, l->work) &&
                    scaled(l, p, l->again) < (1.0 - share / 4) * asked)
                    break;
            }
            if (is_small(l, p->x, NEAR, 0.0)) return 1;
            share /= 2;
        }
        if (halvings == MOST_HALVINGS) return 0;
        swap(p, tried);
        if (share == 1.0 && is_small(l, p->x, 1e-6, 0.0)) return 1;
    }
    return 0;
}

/* From p to the solution at the end of the way on which the residuals are a part of those at p that falls to 0. */
static int followed(const Loop *l, Point *p, Point *tried, Point *kept, double *begin, double *left)
{
    double rest = 1.0, part = FIRST_PART;
    memcpy(begin, p->residuals, (size_t)l->n * sizeof(double));
    while (rest > 0.0 && part > LEAST_PART) {
        double then = fmax(rest - part, 0.0);
        for (int i = 0; i < l->n; i++) left[i] = then * begin[i];
        copy(l, kept, p);
        if (moved(l, p, tried, left, FEW_STEPS)) {
            rest = then, part *= 2;
        } else {
            copy(l, p, kept);
            part /= 4;
        }
    }
    return rest == 0.0 && descended(l, p, tried);
}

/* The solution, in p, between two points whose residuals have opposite signs. */
static int halved(const Loop *l, Point *p, Point *tried, Point *a, Point *b)
{
    for (;;) {
        p->x[0] = a->x[0] + (b->x[0] - a->x[0]) / 2;
        if (p->x[0] == a->x[0] || p->x[0] == b->x[0]) break;
        evaluate(l, p);
        if (isnan(p->residuals[0])) return 0;
        copy(l, (p->residuals[0] > 0.0) == (a->residuals[0] > 0.0) ? a : b, p);
    }
    copy(l, p, a);
    if (descended(l, p, tried)) return 1;
    copy(l, p, b);
    return descended(l, p, tried);
}

/* The solution, in p, between two values of a single unknown, the nearest to p where residuals have opposite signs.
   room: four points. */
static int enclosed(const Loop *l, Point *p, Point *tried, Point *room)
{
    double begin = p->x[0];
    copy(l, &room[0], p);
    copy(l, &room[1], p);
    for (double away = FIRST_DISTANCE * fmax(fabs(begin), 1e-3); away < LAST_DISTANCE; away *= 4)
        for (int k = 0; k < 2; k++) {
            Point *last = &room[k], *here = &room[2];
            here->x[0] = k ? begin - away : begin + away;
            evaluate(l, here);
            double r = here->residuals[0], r_last = last->residuals[0];
            swap(last, here);
            if (!(r_last * r < 0.0 || (r == 0.0 && r_last != 0.0))) continue;
            copy(l, &room[3], last);
            if (halved(l, p, tried, here, &room[3])) return 1;
        }
    return 0;
}

/* Further searches, from the guess, from what the blocks give there, and from 1. The solution is in p. */
static int searched(Loop l, const double *guess, double *unknowns)
{
    enum { POINTS = 9 };
    size_t n = (size_t)l.n, size = point_size(&l), whole = n + (size_t)l.others;
    double *memory = calloc(POINTS * size + work_size(&l) + 2 * n, sizeof(double));
    if (!memory) return 0;
    double *room = with_work(&l, memory), *begin = room, *left = room + n;
    Point points[POINTS], *p = &points[0], *tried = &points[1], *begins = &points[2], *more = &points[5];
    for (int k = 0; k < POINTS; k++) points[k] = point_in(&l, room + 2 * n + (size_t)k * size);
    int found = 0, is_good[3];
    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < l.n; i++) begins[k].x[i] = k == 0 ? guess[i] : k == 1 ? guess[i] + begins[0].residuals[i] : 1.0;
        evaluate(&l, &begins[k]);
        is_good[k] = is_finite(&l, &begins[k]);
        if (k == 0 || !is_good[k] || found) continue;
        copy(&l, p, &begins[k]);
        found = moved(&l, p, tried, NULL, MOST_STEPS) && descended(&l, p, tried);
    }
    for (int k = 0; k < 3 && !found; k++) {
        copy(&l, p, &begins[k]);
        if (l.n == 1) found = (k == 0 || is_good[k]) && enclosed(&l, p, tried, more);
        else found = is_good[k] && followed(&l, p, tried, more, begin, left);
    }
    if (found) {
        memcpy(unknowns, p->x, n * sizeof(double));
        memcpy(unknowns + n, p->residuals + n, (whole - n) * sizeof(double));
    }
    free(memory);
    return found;
}

void blocks_newton(BlocksSystem system, BlocksRounding rounding, const BlocksMemory *m, const double *known, int n,
                   int others, double *unknowns)
{
    Loop l = {system, rounding, m, known, n, others, NULL, NULL, NULL, NULL};
    size_t size = point_size(&l), doubles = 2 * size + work_size(&l);
    double few[ROOM], *memory = doubles <= ROOM ? few : malloc(doubles * sizeof(double));
    int found = 0;
    if (memory) {
        double *room = with_work(&l, memory);
        Point p = point_in(&l, room), tried = point_in(&l, room + size);
        memcpy(p.x, unknowns, (size_t)n * sizeof(double));
        evaluate(&l, &p);
        found = descended(&l, &p, &tried);
        if (found) {
            memcpy(unknowns, p.x, (size_t)n * sizeof(double));
            memcpy(unknowns + n, p.residuals + n, (size_t)others * sizeof(double));
        }
        if (memory != few) free(memory);
    }
    if (!found && !searched(l, unknowns, unknowns))
        for (int i = 0; i < n + others; i++) unknowns[i] = NAN;
}

void blocks_spread(BlocksSystem system, BlocksRounding bounds, const BlocksMemory *m, const double *known, int n, int others,
                   double *unknowns)
{
    const double wide = 1048576.0, ulp = 2.220446049250313e-16;
    size_t size = (size_t)n, all = size + (size_t)others;
    double *work = malloc((2 * size * size + 4 * all + size) * sizeof(double));
    for (size_t i = 0; !work && i < all; i++) unknowns[i] = 0.0;
    if (work) {
        double *matrix = work, *inverse = matrix + n * n, *base = inverse + n * n, *moved = base + all, *sizes = moved + all,
               *made = sizes + all, *x = made + all;
        memcpy(x, unknowns, size * sizeof(double));
        system(m, known, x, base, matrix);
        bounds(m, known, x, sizes);
        int found = 1;
        for (int i = 0; i < n * n; i++) {
            inverse[i] = i % (n + 1) == 0;
            found = found && isfinite(matrix[i]);
        }
        for (int k = 0; k < n && found; k++) { /* Gauss and Jordan */
            int pivot = k;
            for (int i = k + 1; i < n; i++)
                if (fabs(matrix[i * n + k]) > fabs(matrix[pivot * n + k])) pivot = i;
            double by = matrix[pivot * n + k];
            found = by != 0.0;
            for (int j = 0; j < n && found; j++) {
                double a = matrix[k * n + j], b = inverse[k * n + j];
                matrix[k * n + j] = matrix[pivot * n + j] / by, inverse[k * n + j] = inverse[pivot * n + j] / by;
                if (pivot != k) matrix[pivot * n + j] = a, inverse[pivot * n + j] = b;
            }
            for (int i = 0; i < n && found; i++) {
                double share = matrix[i * n + k];
                if (i == k || share == 0.0) continue;
                for (int j = 0; j < n; j++) {
                    matrix[i * n + j] -= share * matrix[k * n + j];
                    inverse[i * n + j] -= share * inverse[k * n + j];
                }
            }
        }
        for (int i = 0; i < n; i++) {
            made[i] = 0.0;
            for (int j = 0; j < n && found; j++) made[i] += fabs(inverse[i * n + j]) * (ulp * sizes[j]);
        }
        for (int i = n; i < n + others; i++) made[i] = ulp * sizes[i];
        for (int k = 0; k < n; k++) {
            x[k] = unknowns[k] + wide * made[k];
            system(m, known, x, moved, matrix);
            x[k] = unknowns[k];
            for (int i = n; i < n + others; i++) made[i] += fabs(moved[i] - base[i]) / wide;
        }
        for (size_t i = 0; i < all; i++) unknowns[i] = isfinite(made[i]) ? made[i] : 0.0;
    }
    free(work);
}
