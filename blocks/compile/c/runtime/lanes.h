/* Numbers of several runs side by side, one in each lane of a vector, and the arithmetic of programs on them.

   Every operation works on each lane by itself, so that what becomes of a run depends neither on its lane nor on its
   neighbours. A truth is a lane of ones or zeros. Included by what lane_code.py prints. */
#ifndef BLOCKS_LANES_H
#define BLOCKS_LANES_H

#include "lane_machine.h" /* BLOCKS_LANES, and the functions that the machine has for so many numbers */
#include "batch.h"

#include <immintrin.h>

typedef double V __attribute__((vector_size(8 * BLOCKS_LANES)));
typedef int64_t M __attribute__((vector_size(8 * BLOCKS_LANES)));

/* The rows of as many runs: as BlocksMemory has them. Tables are the same in all. */
typedef struct {
    V *x, *d, *s, *p, *u, *h, *k, *q, *v, *n, *w;
    const double *c;
} LanesMemory;

#define EACH_LANE for (int l = 0; l < BLOCKS_LANES; l++)

static inline V lanes_of(double a) { return a - (V){0.0}; }
static inline V lanes_choose(M which, V a, V b) { return (V)((which & (M)a) | (~which & (M)b)); }
static inline M lanes_choose_truth(M which, M a, M b) { return (which & a) | (~which & b); }
static inline V lanes_real(M truth) { return (V)(truth & (M)lanes_of(1.0)); }
static inline V lanes_fabs(V a) { return (V)((M)a & INT64_MAX); }
static inline V lanes_copysign(V a, V b) { return (V)(((M)a & INT64_MAX) | ((M)b & INT64_MIN)); }
static inline V lanes_sign(V a) { return lanes_choose(a > 0.0, lanes_of(1.0), lanes_choose(a < 0.0, lanes_of(-1.0), a)); }
static inline V lanes_min(V a, V b) { return lanes_choose(a != a, a, lanes_choose(a < b, a, b)); }
static inline V lanes_max(V a, V b) { return lanes_choose(a != a, a, lanes_choose(a > b, a, b)); }
static inline V lanes_at_most(V a, V bound) { return lanes_choose(bound < a, bound, a); }
static inline V lanes_at_least(V a, V bound) { return lanes_choose(bound > a, bound, a); }
static inline V lanes_smaller(V a, V b) { return lanes_choose(a < b, a, b); }
static inline V lanes_larger(V a, V b) { return lanes_choose(a > b, a, b); }
static inline M lanes_are_finite(V a) { return a * 0.0 == 0.0; }

/* Whether it holds in any lane. */
static inline int lanes_any(M truth)
{
#if BLOCKS_LANES == 8
    return _mm512_test_epi64_mask((__m512i)truth, (__m512i)truth) != 0;
#elif BLOCKS_LANES == 4
    return !_mm256_testz_si256((__m256i)truth, (__m256i)truth);
#else
    return (truth[0] | truth[1]) != 0;
#endif
}

/* The distance to the next larger double. */
static inline V lanes_ulp(V a)
{
    V size = lanes_fabs(a);
    return (V)((M)size + 1) - size;
}

#define LANE_BY_LANE(name, function)                                                                                  \
    static inline V name(V a)                                                                                         \
    {                                                                                                                 \
        V made;                                                                                                       \
        EACH_LANE made[l] = function(a[l]);                                                                           \
        return made;                                                                                                  \
    }
#define LANE_BY_LANE_OF_TWO(name, function)                                                                           \
    static inline V name(V a, V b)                                                                                    \
    {                                                                                                                 \
        V made;                                                                                                       \
        EACH_LANE made[l] = function(a[l], b[l]);                                                                     \
        return made;                                                                                                  \
    }
#define LANE_BY_LANE_OF_A_TABLE(name, function)                                                                       \
    static inline V name(V a, const double *table, int n)                                                             \
    {                                                                                                                 \
        V made;                                                                                                       \
        EACH_LANE made[l] = function(a[l], table, n);                                                                 \
        return made;                                                                                                  \
    }
LANE_BY_LANE(lanes_floor, floor)
LANE_BY_LANE(lanes_ceil, ceil)
LANE_BY_LANE(lanes_sqrt, sqrt)
LANE_BY_LANE_OF_A_TABLE(lanes_search, blocks_search)
LANE_BY_LANE_OF_A_TABLE(lanes_pick, blocks_pick)
LANES_FUNCTIONS

#endif
