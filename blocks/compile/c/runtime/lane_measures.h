/* What is measured inside the steps of lanes, where five values tell it. Part of lane_steps.h; twin: steps.h. */
#if BLOCKS_QUICK_MEASURES
BLOCKS_QUARTICS(static, V)

/* The states at one of SHARES of a step, as its dense output has them. */
static inline void inside(const Lanes *z, const int share, const int *states, const int n, V h, V *restrict made)
{
    const V *restrict x = z->m.x, *restrict x1 = z->x1;
    for (int a = 0; a < n; a++) {
        const int i = states[a];
#if BLOCKS_METHOD_RK4
        const double at = SHARES_AT[share], there = at * at * (3.0 - 2.0 * at);
        const V first = at * (1.0 - at) * (1.0 - at) * h, last = at * at * (at - 1.0) * h;
        made[i] = x[i] + (there * (x1[i] - x[i]) + (first * z->k[0][i] + last * z->k[4][i]));
#else
        (void)x1;
        V sum = lanes_of(0.0);
        _Pragma("GCC unroll 8") for (int j = 0; j < STAGES; j++)
            if (SHARES[share][j] != 0.0) sum += SHARES[share][j] * z->k[j][i];
        made[i] = x[i] + h * sum;
#endif
    }
}

#if BLOCKS_NBENT
static const int bent_states[] = BLOCKS_BENT_STATES, bent_columns[] = BLOCKS_BENT_COLUMNS;

/* What is bent, at one of SHARES. */
static __attribute__((noinline)) void bent_at(Lanes *z, int share, V step, V *out)
{
    V then = z->t + SHARES_AT[share] * step;
    inside(z, share, bent_states, BLOCKS_NBENT_STATES, step, z->xs);
    if (BLOCKS_NU && z->moves) outside(z, then);
    bent_measured(&z->m, then, z->xs, out);
}

/* The inner nodes of what is bent as a parabola or a cubic foretells them; where it misses what was computed. */
static M foretold(Lanes *z, int pass, M missed, const V *once, const V *twice)
{
    const BlocksSetup *setup = z->lanes[0].s->setup;
    const double first = SHARES_AT[3], second = SHARES_AT[4], rtol = setup->rtol;
    M misses = (M){0};
    for (int a = 0; a < BLOCKS_NBENT; a++) {
        const int j = bent_columns[a], other = j ^ 1;
        V y0 = z->nodes[0][j], rise = z->nodes[4][j] - y0, twist = lanes_of(0.0), size = lanes_fabs(rise);
        V miss = once[j] - (y0 + first * rise), bend = miss * (1.0 / (first * (1.0 - first)));
        if (pass == 1) {
            miss = twice[j] - (y0 + second * rise + bend * second * (1.0 - second));
            twist = miss * (1.0 / (second * (1.0 - second) * (second - first)));
        }
        if (setup->measures[j / 2].kind <= BLOCKS_HARMONIC)
            size += lanes_smaller(lanes_fabs(y0 - z->nodes[0][other]), lanes_fabs(z->nodes[4][j] - z->nodes[4][other]));
        misses |= ~(lanes_fabs(miss) <= 0.1 * rtol * size);
        for (int i = 1; i < 4; i++) {
            double at = SHARES_AT[i - 1];
            V value = y0 + at * rise + at * (1.0 - at) * (bend + twist * (at - first));
            z->nodes[i][j] = lanes_choose(missed, value, z->nodes[i][j]);
        }
    }
    return misses & missed;
}
#endif

/* What is measured at the nodes of Lobatto's rule, in lanes that want it; the lanes whose step has to be looked at in
   parts. See steps.h. */
static M measured_inside(Lanes *z, V t1, V step, M wanted)
{
#if BLOCKS_NPLAIN
    static const int plain_states[] = BLOCKS_PLAIN_STATES;
    _Pragma("GCC unroll 3") for (int i = 1; i < 4; i++) {
        V then = z->t + SHARES_AT[i - 1] * step;
        inside(z, i - 1, plain_states, BLOCKS_NPLAIN_STATES, step, z->xs);
        if (BLOCKS_NU && z->moves) outside(z, then);
        plain_measured(&z->m, then, z->xs, z->nodes[i]);
    }
#endif
#if BLOCKS_SHARES_MEASURED
    for (int j = 0; j < N; j++) z->nodes[4][j] = z->k[LAST][WIDTH + j];
    (void)t1;
#else
    if (BLOCKS_NU && z->moves) outside(z, t1);
    measured(&z->m, t1, z->x1, z->nodes[4]);
#endif
    V bad = lanes_of(0.0);
    for (int j = 0; j < N; j++) bad += z->nodes[4][j] * 0.0;
    M parts = ~(bad == 0.0);
#if BLOCKS_NBENT
    V once[N], twice[N] = {{0.0}};
    bent_at(z, 3, step, once);
    M missed = BLOCKS_DRIVEN_MEASURES ? wanted : foretold(z, 0, wanted, once, twice);
    if (!BLOCKS_DRIVEN_MEASURES && lanes_any(missed)) {
        bent_at(z, 4, step, twice);
        missed = foretold(z, 1, missed, once, twice);
    }
    if (lanes_any(missed)) {
        for (int i = 1; i < 4; i++) {
            bent_at(z, i - 1, step, twice);
            for (int a = 0; a < BLOCKS_NBENT; a++) {
                const int j = bent_columns[a];
                z->nodes[i][j] = lanes_choose(missed, twice[j], z->nodes[i][j]);
                parts |= missed & ~lanes_are_finite(twice[j]);
            }
        }
        EACH_LANE {
            if (!missed[l] || parts[l]) continue;
            double given[N];
            BlocksSim *s = z->lanes[l].s;
            for (int j = 0; j < N; j++) given[j] = once[j][l];
            for (int i = 0; i < 5; i++)
                for (int j = 0; j < N; j++) s->nodes[i * N + j] = z->nodes[i][j][l];
            if (blocks_misses(s, given)) parts[l] = -1;
        }
    }
#endif
    return parts & wanted;
}

/* Where quartics go beyond low or high, or may. */
static inline M go_beyond(const V *y, V low, V high)
{
    V bottom = y[0], top = y[0];
    for (int k = 1; k < 5; k++) bottom = lanes_smaller(bottom, y[k]), top = lanes_larger(top, y[k]);
    V beyond = REACH * (top - bottom);
    return (bottom - beyond < low) | (top + beyond > high);
}

/* Where quartics turn, or may. */
static inline M turn(const V *y)
{
    M rises = (M){0}, falls = (M){0};
    V a[5];
    for (int k = 0; k < 4; k++) rises |= y[k + 1] > y[k], falls |= y[k + 1] < y[k];
    quartic(y, a);
    V second = at_share(a, 1.0 / 128), last = at_share(a, 1.0 - 1.0 / 128);
    return (rises & falls) | ((second - y[0]) * (y[1] - y[0]) < 0.0) | ((y[4] - last) * (y[4] - y[3]) < 0.0);
}

/* Take a step of `wanted` lanes into a measure, as `take` of runtime.c does, to the same bits. What that looks at closely it
   does itself, for the run behind the lane. The lanes in which there is no memory for it. */
static M take_in(Lanes *z, int i, V t1, V h, M wanted)
{
    const BlocksMeasure *what = &z->lanes[0].s->setup->measures[i];
    const int kind = what->kind, is_timed = kind == BLOCKS_TIMED;
    Measured *made = &z->measured[i];
    V of[5], e[5], values[5], total = made->total, low = lanes_of(0.0), high = low;
    M close = made->first != made->first; /* it begins */
    wanted &= (what->low <= z->t) & (what->high >= t1);
    for (int k = 0; k < 5; k++) of[k] = z->nodes[k][2 * i], e[k] = of[k] - z->nodes[k][2 * i + 1];
    if (kind == BLOCKS_SQUARE) {
        for (int k = 0; k < 5; k++) values[k] = e[k] * e[k];
        total += h * weighted(values);
    } else if (kind == BLOCKS_ABSOLUTE || is_timed) {
        for (int k = 0; k < 5; k++) {
            values[k] = lanes_fabs(e[k]) * (is_timed ? z->t + LOBATTO[k] * h : lanes_of(1.0));
            low = lanes_smaller(low, e[k]), high = lanes_larger(high, e[k]);
        }
        close |= (low < 0.0) & (high > 0.0);
        total += h * weighted(values);
    } else if (kind == BLOCKS_PEAK) {
        close |= go_beyond(e, -made->total, made->total);
    } else if (kind == BLOCKS_VARIATION) {
        close |= turn(e);
        total += lanes_fabs(e[0] - made->last) + lanes_fabs(e[4] - e[0]);
    } else if (kind == BLOCKS_OVERSHOOT || kind == BLOCKS_RISE) {
        close |= go_beyond(of, made->low, made->high);
    } else if (kind != BLOCKS_END) {
        close = wanted;
    }
    close &= wanted;
    M here = wanted & ~close;
    made->total = lanes_choose(here, total, made->total);
    made->span = lanes_choose(here, made->span + h, made->span);
    if (kind != BLOCKS_SQUARE) {
        made->target = lanes_choose(here, z->nodes[4][2 * i + 1], made->target);
        made->last = lanes_choose(here, e[4], made->last);
    }
    M failed = (M){0};
    if (!lanes_any(close)) return failed;
    EACH_LANE {
        if (!close[l]) continue;
        BlocksSim *s = z->lanes[l].s;
        for (int k = 0; k < 5; k++)
            for (int j = 2 * i; j < 2 * i + 2; j++) s->nodes[k * N + j] = z->nodes[k][j][l];
        give_measure(z, l, i);
        failed[l] = -blocks_measure_one(s, i, z->t[l], t1[l]);
        take_measure(z, l, i);
    }
    return failed;
}

/* Take in a step as one part; the lanes in which that fails. */
static M take_measures(Lanes *z, V t1, V h, M wanted)
{
    M failed = (M){0};
    for (int i = 0; i < N / 2; i++) failed |= take_in(z, i, t1, h, wanted);
    z->known = lanes_choose(wanted, t1, z->known);
    for (int j = 0; j < N; j++) z->nodes[0][j] = lanes_choose(wanted, z->nodes[4][j], z->nodes[0][j]);
    return failed;
}

/* The lanes in which a step is to be measured; `quiet` loses those where that goes in parts. */
static M to_measure(const Lanes *z, const Step *step, M *quiet)
{
    M wanted = *quiet & (z->t < step->t1);
    const BlocksSetup *setup = z->lanes[0].s->setup;
    M any = (M){0}, in_part = any;
    for (int i = 0; i < N / 2 && setup->has_windows; i++) {
        const double low = setup->measures[i].low, high = setup->measures[i].high;
        M touched = (low < step->t1) & (high > z->t);
        in_part |= (touched & ((low > z->t) | (high < step->t1))) | (low == step->t1);
        any |= touched;
    }
    if (setup->has_windows) *quiet &= ~(wanted & in_part), wanted &= any & ~in_part;
    M stale = wanted & (z->known != z->t);
    *quiet &= ~stale;
    return wanted & ~stale;
}
#endif

