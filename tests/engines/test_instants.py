"""Time: ticks, edges, stops and rows stand exactly where they belong, and instants go in one order."""

import math
import random
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    Constant,
    Counter,
    DeadZone,
    Diagram,
    Discrete,
    DiscreteIntegrator,
    Gain,
    Input,
    Integrator,
    LookupTable,
    ModelError,
    Parameter,
    Pulse,
    Quantizer,
    Ramp,
    Relay,
    Results,
    Saturation,
    SecondOrder,
    SquareWave,
    State,
    Step,
    Sum,
    TransferFunction,
    TransportDelay,
    UnitDelay,
    ZeroOrderHold,
    crossing,
    event_time,
    output,
)
from blocks.compile.tick_stages import stages_of
from blocks.compile.time_grid import Grid, within_ulps

TIGHT: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-12}
METHODS: list[dict[str, Any]] = [{"method": "rk4", "step": 0.001}, TIGHT, {"method": "radau", **TIGHT}]


def name(settings: dict[str, Any]) -> str:
    return str(settings.get("method", "dopri5"))


class Clock(Block):
    """y is the number of the tick, n that of the next."""

    period = Parameter(0.1)
    offset = Parameter(0.0, min=0.0)

    @output(every=period, offset=offset, start=-1.0)
    def y(tick):
        return tick

    @output(every=period, offset=offset, start=-1.0)
    def at(t):
        return t


def clocks(*settings: tuple[float, float], **run: Any) -> Results:
    diagram = Diagram("clocks")
    for k, (period, offset) in enumerate(settings):
        diagram.add(f"c{k}", Clock(period=period, offset=offset))
    return diagram.run(**run)


def ticks(results: Results, block: str) -> list[tuple[float, float]]:
    """(t, tick) of each tick of a clock: where its number rises."""
    y, t = results[f"{block}.y"], results.t
    return [(float(t[k]), float(y[k])) for k in range(len(t)) if y[k] >= 0 and (k == 0 or y[k] != y[k - 1])]


# --- ticks -----------------------------------------------------------------------------------------------------


def test_ticks_of_a_tenth_fall_on_the_correctly_rounded_tenths() -> None:
    diagram = Diagram("clock")
    diagram.add("c", Clock(period=0.1))
    plan = diagram.plan()
    assert plan.base == Fraction(1, 10)
    assert all(plan.tick_time(k) == k / 10 for k in range(1_000_001))


def test_a_run_of_thousands_of_ticks_hits_each_of_them() -> None:
    results = clocks((0.1, 0.0), stop=500.0)
    assert ticks(results, "c0") == [(k / 10, float(k)) for k in range(5001)]
    right = results["c0.at"][np.append(np.diff(results.t) > 0, True)]
    assert np.array_equal(right, [k / 10 for k in range(5001)])


@pytest.mark.parametrize("period", ["0.1", "1e-3", "1/3", "0.0371", "1e6", "2.5e-7"])
def test_ticks_are_rounded_once_wherever_they_lie(period: str) -> None:
    diagram = Diagram("clock")
    diagram.add("c", Clock(period=f"={period}"))
    plan = diagram.plan()
    (rate,) = plan.rates
    exact, rng = Fraction(period), random.Random(1)
    for _ in range(2000):
        k = rng.randrange(2**40)
        assert plan.tick_time(rate.offset + k * rate.period) == float(k * exact)


def test_a_third_written_as_a_float_is_a_third_and_other_floats_cannot_be_counted() -> None:
    assert [t for t, _ in ticks(clocks((1 / 3, 0.0), stop=1.0), "c0")] == [0.0, 1 / 3, 2 / 3, 1.0]
    with pytest.raises(ModelError, match=r"E119 c0: ticks of 0\.3141592653589793 s .* \"=1/3\""):
        clocks((0.3141592653589793, 0.0), stop=1.0)


def test_periods_of_1_and_3_tenths_coincide_each_third_time() -> None:
    results = clocks((0.1, 0.0), (0.3, 0.0), stop=30.0)
    fast, slow = dict(ticks(results, "c0")), dict(ticks(results, "c1"))
    assert list(slow) == [3 * k / 10 for k in range(101)]
    assert set(slow) <= set(fast)
    assert results.statistics.instants == 301  # one for both


def test_offsets_shift_ticks_and_count_from_them() -> None:
    results = clocks((0.5, 0.2), (0.25, 0.0), stop=2.0)
    assert ticks(results, "c0") == [(0.2, 0.0), (0.7, 1.0), (1.2, 2.0), (1.7, 3.0)]
    assert results["c0.y"][0] == -1.0  # what is held before the first tick


def test_ticks_are_counted_from_time_0_wherever_a_run_starts() -> None:
    assert ticks(clocks((0.1, 0.0), start=0.3, stop=0.5), "c0") == [(0.3, 3.0), (0.4, 4.0), (0.5, 5.0)]
    assert ticks(clocks((0.1, 0.0), start=0.35, stop=0.5), "c0") == [(0.4, 4.0), (0.5, 5.0)]
    assert ticks(clocks((0.1, 0.0), start=-0.25, stop=0.2), "c0") == [(0.0, 0.0), (0.1, 1.0), (0.2, 2.0)]
    assert ticks(clocks((0.1, 0.05), start=-1.0, stop=-0.5), "c0") == []
    late = clocks((0.1, 0.0), start=1e5, stop=100000.3)
    assert ticks(late, "c0") == [((10**6 + k) / 10, 1e6 + k) for k in range(4)]


def test_a_tick_at_the_stop_is_done_and_done_once() -> None:
    assert ticks(clocks((0.25, 0.0), stop=1.0), "c0")[-1] == (1.0, 4.0)
    diagram = Diagram("clock")
    diagram.add("c", Clock(period=0.25))
    run = diagram.start(stop=2.0)
    for _ in range(8):
        run.advance(0.25)
        assert run["c.y"] == run.t / 0.25
    assert ticks(run.results, "c") == [(k / 4, float(k)) for k in range(9)]


def test_a_run_of_no_length_has_the_instant_at_its_start() -> None:
    results = clocks((0.25, 0.0), start=1.0, stop=1.0)
    assert results.t.tolist() == [1.0]
    assert results["c0.y"].tolist() == [4.0]


def test_periods_without_a_countable_base_are_refused() -> None:
    with pytest.raises(ModelError, match=r"E119 c[01]: ticks of .* no common base"):
        clocks((1.4142135623730951, 0.0), (0.0012345678901234567, 0.0), stop=1.0)


def test_a_run_of_more_base_steps_than_can_be_counted_is_refused() -> None:
    with pytest.raises(ModelError, match=r"E119 clocks: .* is more than 2\^53 times 1e-06 s"):
        clocks((1e-6, 0.0), stop=1e11, every=1e10)
    diagram = Diagram("clocks")
    diagram.add("c", Clock(period=1e-6))
    run = diagram.start()
    with pytest.raises(ModelError, match="E119"):
        run.advance(1e11)


# --- edges -----------------------------------------------------------------------------------------------------


def step_response(at: float, **settings: Any) -> Results:
    """x' = step - x, y' = x."""
    diagram = Diagram("response")
    step, lag, sum_ = (
        diagram.add("step", Step(at=at)),
        diagram.add("x", Integrator()),
        diagram.add("sum", Sum(signs="+-")),
    )
    total = diagram.add("y", Integrator())
    diagram.wire(sum_.u1, step.y)
    diagram.wire(sum_.u2, lag.y)
    diagram.wire(lag.u, sum_.y)
    diagram.wire(total.u, lag.y)
    return diagram.run(**settings)


@pytest.mark.parametrize("settings", METHODS, ids=name)
@pytest.mark.parametrize("at", [30.0, 30.00037, 29.9999999])
def test_a_step_at_30_s_is_hit_exactly(settings: dict[str, Any], at: float) -> None:
    """What reads the source in the last stage before its edge is off by the step's size: 4e-4."""
    results = step_response(at, start=29.0, stop=32.0, **settings)
    later = np.maximum(results.t - at, 0.0)
    assert np.max(np.abs(results["x.y"] - (1 - np.exp(-later)))) < 1e-9
    assert np.max(np.abs(results["y.y"] - (later - 1 + np.exp(-later)))) < 1e-9
    assert results["step.y"][results.t == at].tolist() == [0.0, 1.0]
    assert [(event.t, event.block, event.what) for event in results.events] == [(at, "step", "edge")]


@pytest.mark.parametrize("start", [0.0, 5.0, -2.5])
def test_a_step_at_the_start_has_come(start: float) -> None:
    results = step_response(start, start=start, stop=start + 2.0, **TIGHT)
    later = results.t - start
    assert np.max(np.abs(results["x.y"] - (1 - np.exp(-later)))) < 1e-9
    assert results["step.y"].min() == 1.0
    assert results.events == ()


def test_a_step_before_the_start_has_come_and_one_after_the_stop_does_not() -> None:
    assert step_response(1.0, start=2.0, stop=3.0)["step.y"].min() == 1.0
    assert step_response(4.0, start=2.0, stop=3.0)["step.y"].max() == 0.0


def test_an_edge_at_the_stop_is_seen_as_a_jump_there() -> None:
    results = step_response(3.0, stop=3.0)
    assert results.t.tolist().count(3.0) == 2
    assert results["step.y"][-2:].tolist() == [0.0, 1.0]


def test_a_ramp_bends_and_a_pulse_ends_where_they_say() -> None:
    diagram = Diagram("sources")
    ramp, pulse = diagram.add("ramp", Ramp(at=0.7, slope=2.0)), diagram.add("pulse", Pulse(on=0.3, off=0.9, height=5.0))
    for key, source in (("a", ramp), ("b", pulse)):
        x = diagram.add(key, Integrator())
        diagram.wire(x.u, source.y)
    results = diagram.run(stop=2.0, method="rk4", step=0.25)
    assert results["a.y"][-1] == pytest.approx((2.0 - 0.7) ** 2, abs=1e-13)
    assert results["b.y"][-1] == pytest.approx(5.0 * 0.6, abs=1e-13)


# --- an instant ------------------------------------------------------------------------------------------------


class Sampler(Block):
    """y is u at the tick, and `left` what u was before anything fired."""

    period = Parameter(0.1)
    u = Input()

    @output(every=period, start=-1.0)
    def y(u):
        return u


def test_an_edge_at_3_tenths_joins_tick_3_which_sees_its_effect() -> None:
    """3 * 0.1 is 0.30000000000000004, one ulp beyond the tick at 0.3."""
    for at in (0.3, 3 * 0.1, math.nextafter(0.3, 0.0), 0.3 + 4 * math.ulp(0.3)):
        diagram = Diagram("join")
        step, sampler = diagram.add("step", Step(at=at)), diagram.add("sampler", Sampler())
        diagram.wire(sampler.u, step.y)
        results = diagram.run(stop=1.0)
        assert results.statistics.instants == 11
        assert [event.t for event in results.events] == [0.3]
        assert results["sampler.y"][results.t == 0.3].tolist() == [0.0, 1.0]
        assert results["step.y"][-1] == 1.0


def test_an_edge_further_from_a_tick_has_an_instant_of_its_own() -> None:
    diagram = Diagram("apart")
    at = 0.3 + 5 * math.ulp(0.3)
    step, sampler = diagram.add("step", Step(at=at)), diagram.add("sampler", Sampler())
    diagram.wire(sampler.u, step.y)
    results = diagram.run(stop=1.0)
    assert results.statistics.instants == 12
    assert [event.t for event in results.events] == [at]
    assert results["sampler.y"][results.t <= 0.35].max() == 0.0


def test_an_edge_within_4_ulp_of_the_stop_joins_it() -> None:
    results = step_response(3 * 0.1, stop=0.3)
    assert results.t[-1] == 0.3
    assert results["step.y"][-1] == 1.0


@pytest.mark.parametrize("seed", range(5))
def test_edges_some_ulp_around_ticks_are_never_lost(seed: int) -> None:
    """A clock of tenths and a counter whose edges miss its ticks by up to 8 ulp: each edge fires once, in order."""
    rng = random.Random(seed)
    edges = []
    for k in range(1, 31):
        edge = k / 10
        for _ in range(abs(miss := rng.randint(-8, 8))):
            edge = math.nextafter(edge, math.inf if miss > 0 else 0.0)
        edges.append(edge)

    class Counter(Block):
        n = Discrete(output=True)

        @event_time
        def edge(t):
            following = np.inf
            for time in reversed(edges):
                following = np.where(t < time, time, following)
            return following

        @edge.reset(n)
        def counted(n):
            return n + 1

    diagram = Diagram("edges")
    counter, sampler = diagram.add("counter", Counter()), diagram.add("sampler", Sampler())
    diagram.wire(sampler.u, counter.n)
    results = diagram.run(stop=3.5)
    fired = [event.t for event in results.events]
    expected = [k / 10 if within_ulps(edge, k / 10) else edge for k, edge in enumerate(edges, start=1)]
    assert fired == expected
    assert results["counter.n"][-1] == 30.0


class Ball(Block):
    """A crossing whose reset and a tick may fall on one instant: at = 0.5 exactly."""

    x = State(-0.5, output=True)
    hits = Discrete(output=True)
    seen = Discrete(-1.0)
    period = Parameter(0.5)

    @x.derivative
    def dx():
        return 1.0

    @crossing(direction="up")
    def arrive(x):
        return x

    @arrive.reset(hits)
    def hit(hits):
        return hits + 1

    @output(every=period, start=-1.0)
    def sampled(hits):
        return hits

    @seen.next(every=period)
    def see(hits):
        return hits

    @output(every=period, start=-1.0)
    def before(seen):
        return seen


def test_a_crossing_on_a_tick_fires_before_the_tick_sees_it() -> None:
    diagram = Diagram("ball")
    diagram.add("b", Ball())
    results = diagram.run(stop=1.0, method="euler", step=0.125)
    assert [event.t for event in results.events] == [0.5]
    assert results["b.sampled"][results.t == 0.5].tolist() == [0.0, 1.0]
    assert results["b.before"][results.t == 0.5].tolist() == [-1.0, 0.0]  # sampled equations see what was before


def test_a_tick_that_moves_a_signal_over_a_crossing_fires_it_after_the_tick() -> None:
    """Step 4 of an instant: the held output jumps at 0.4, and what crosses there fires at 0.4, once."""

    class Watch(Block):
        u = Input()
        n = Discrete(output=True)

        @crossing(direction="up")
        def over(u):
            return u - 0.35

        @over.reset(n)
        def counted(n):
            return n + 1

    diagram = Diagram("after")
    ramp, hold, watch = (
        diagram.add("ramp", Ramp()),
        diagram.add("hold", ZeroOrderHold(period=0.2)),
        diagram.add("watch", Watch()),
    )
    sampler = diagram.add("sampler", Sampler(period=0.2))
    diagram.wire(hold.u, ramp.y)
    diagram.wire(watch.u, hold.y)
    diagram.wire(sampler.u, watch.n)
    results = diagram.run(stop=1.0)
    assert [event.t for event in results.events] == [0.4]
    assert results["watch.n"][results.t == 0.4].tolist() == [0.0, 1.0]
    # What it counts depends on the held output, so the sampler comes after the event.
    assert results["sampler.y"][results.t == 0.4].tolist()[-1] == 1.0


def test_a_sampled_output_sees_another_one_of_its_tick_through_sides_and_resets() -> None:
    """A chain of holds with a block in between that acts by crossings: nothing is a tick late, or from a stale side."""
    for middle, value in (
        (Saturation(lower=-1.0, upper=1.0), 1.0),
        (Quantizer(interval=0.75), 2.25),
        (LookupTable(points=[0.0, 1.0, 3.0], values=[0.0, 5.0, 6.0]), 5.5),
        (Relay(on_at=1.5, off_at=-1.5, on=7.0, off=0.0), 7.0),
        (DeadZone(lower=-0.5, upper=0.5), 1.5),
    ):
        d = Diagram("chain")
        step, first = d.add("step", Step(at=0.25, after=2.0)), d.add("a", ZeroOrderHold(period=0.1))
        second = d.add("b", ZeroOrderHold(period=0.1))
        between, third = d.add("between", middle), d.add("c", ZeroOrderHold(period=0.1))
        again = d.add("again", type(middle)(**middle.parameters))
        d.wire(first.u, step.y)
        d.wire(between.u, first.y)
        d.wire(second.u, between.y)
        d.wire(again.u, second.y)
        d.wire(third.u, again.y)
        results = d.run(stop=0.5, every=0.1, jumps=True)
        at = results.t == 0.3
        assert results["b.y"][at].tolist() == [0.0, pytest.approx(value)], middle
        late = d.run(stop=0.31, every=0.1)
        assert results["c.y"][at][-1] == late["c.y"][-1] == results["again.y"][-1], middle


def test_outputs_that_see_each_other_through_memory_in_a_circle_see_what_was_before() -> None:
    """Two counters, each sampled by the other: a circle of memory has no first one."""

    class Flip(Block):
        period = Parameter(0.1)
        u = Input()
        n = Discrete(output=True)

        @crossing
        def over(u):
            return u - 0.5

        @over.reset(n)
        def turned(n):
            return 1.0 - n

        @output(every=period)
        def y(n):
            return n

    d = Diagram("circle")
    a, b = d.add("a", Flip()), d.add("b", Flip(n_start=1.0))
    d.wire(a.u, b.y)
    d.wire(b.u, a.y)
    plan = d.plan()
    assert len(stages_of(plan, frozenset({0}))) == 1
    d.run(stop=1.0)


# --- rows ------------------------------------------------------------------------------------------------------


def staircase(**settings: Any) -> Results:
    """y jumps at the ticks k/4 but for those at which the ramp has not moved."""
    diagram = Diagram("staircase")
    ramp, hold = diagram.add("ramp", Ramp(at=0.5)), diagram.add("hold", ZeroOrderHold(period=0.25))
    diagram.wire(hold.u, ramp.y)
    return diagram.run(**settings)


def test_rows_are_doubled_where_a_signal_jumps_and_nowhere_else() -> None:
    for settings in ({}, {"every": 0.125}, {"every": 0.1}, {"every": 0.25}, {"method": "rk4", "step": 0.05}):
        results = staircase(stop=2.0, jumps=True, **settings)
        values, count = np.unique(results.t, return_counts=True)
        assert values[count == 2].tolist() == [0.75, 1.0, 1.25, 1.5, 1.75, 2.0]
        assert count.max() == 2
        assert np.all(np.diff(results.t) >= 0)
        for t in (0.75, 1.0, 2.0):
            assert results["hold.y"][results.t == t].tolist() == pytest.approx([max(t - 0.75, 0.0), t - 0.5], abs=1e-15)


def test_the_recording_grid_is_exact_and_holds_right_values() -> None:
    results = staircase(stop=2.0, every=0.1, jumps=True)
    grid = [k / 10 for k in range(21)]
    jumps = [0.75, 0.75, 1.0, 1.25, 1.25, 1.5, 1.75, 1.75, 2.0]
    assert results.t.tolist() == sorted([*grid, *jumps])
    assert results["hold.y"][results.t == 0.8].tolist() == [0.25]
    assert results["ramp.y"] == pytest.approx(np.maximum(results.t - 0.5, 0.0), abs=1e-15)


def test_the_stop_is_recorded_where_the_grid_does_not_divide_the_span() -> None:
    results = step_response(30.0, stop=1.0, every=0.3)
    assert results.t.tolist() == [0.0, 0.3, 0.6, 0.9, 1.0]


@pytest.mark.parametrize("engine", ["reference", "native"])
@pytest.mark.parametrize("every", [1 / 3, 0.123456789012345678])
def test_a_grid_of_more_than_2_to_the_53_parts_of_a_second_begins_at_0(every: float, engine: str) -> None:
    results = step_response(30.0, stop=0.9, every=every, engine=engine)
    assert results.t.tolist() == [*(float(k * Fraction(repr(every))) for k in range(int(0.9 / every) + 1)), 0.9]


def test_a_grid_begins_at_the_start_of_the_run() -> None:
    results = step_response(30.0, start=-0.35, stop=0.35, every=0.1)
    assert results.t.tolist() == pytest.approx([-0.35, -0.25, -0.15, -0.05, 0.05, 0.15, 0.25, 0.35], abs=0)


def test_a_grid_finer_than_the_steps_is_filled_by_dense_output() -> None:
    diagram = Diagram("lag")
    one, lag = diagram.add("one", Constant()), diagram.add("lag", TransferFunction(num=[1], den=[1, 1]))
    diagram.wire(lag.u, one.y)
    results = diagram.run(stop=5.0, every=0.001, **TIGHT)
    assert len(results.t) == 5001
    assert np.max(np.abs(results["lag.y"] - (1 - np.exp(-results.t)))) < 1e-9


@pytest.mark.parametrize(("start", "step"), [("0", "0.1"), ("-1.7", "1/3"), ("1e6", "1e-6")])
def test_a_grid_gives_the_double_nearest_to_each_time(start: str, step: str) -> None:
    first, size = Fraction(start), Fraction(step)
    grid = Grid.of(first, size)
    assert all(grid.time(k) == float(first + k * size) for k in range(10000))


# --- runs in pieces --------------------------------------------------------------------------------------------


def mixed() -> Diagram:
    """Something of everything: states, ticks of two rates, an edge, crossings."""
    diagram = Diagram("mixed")
    r = diagram.input("r")
    ball = diagram.add("ball", Ball(x_start=-0.73))
    error, plant = (
        diagram.add("error", Sum(signs="+-")),
        diagram.add("plant", TransferFunction(num=[2], den=[1, 0.4, 1])),
    )
    hold, delay = diagram.add("hold", ZeroOrderHold(period=0.1)), diagram.add("delay", UnitDelay(period=0.3))
    gain, drift = diagram.add("gain", Gain(k=0.7)), diagram.add("drift", Step(at=0.777))
    total = diagram.add("total", Sum(signs="+++"))
    diagram.wire(error.u1, r)
    diagram.wire(error.u2, plant.y)
    diagram.wire(hold.u, error.y)
    diagram.wire(gain.u, hold.y)
    diagram.wire(delay.u, plant.y)
    diagram.wire(total.u1, gain.y)
    diagram.wire(total.u2, delay.y)
    diagram.wire(total.u3, drift.y)
    diagram.wire(plant.u, total.y)
    diagram.measure("ITAE", "ITAE", "error.y")
    diagram.measure("peak", "peak", plant.y)
    del ball
    return diagram


@pytest.mark.parametrize(
    "settings", [{}, {"every": 0.07}, {"method": "rk4", "step": 0.03}, {"method": "radau"}], ids=str
)
def test_a_run_in_pieces_equals_one_with_the_same_stops_bit_for_bit(settings: dict[str, Any]) -> None:
    inputs = {"r": ([0.0, 1.0, 2.0], [1.0, 0.5, 2.0], "linear")}
    pieces = [Fraction(k, 1) / 7 for k in range(1, 22)]
    whole = mixed().run(stop=3.0, stops=pieces, inputs=inputs, **settings)
    run = mixed().start(stop=3.0, inputs=inputs, **settings)
    for piece in pieces:
        run.advance_to(piece)
        _ = run["plant.y"]
    parts = run.results
    assert np.array_equal(parts.t, whole.t)
    assert np.array_equal(parts.values, whole.values)
    assert parts.events == whole.events
    assert parts.measures == whole.measures
    assert parts.statistics.steps == whole.statistics.steps
    assert parts.statistics.evaluations == whole.statistics.evaluations


def test_an_input_that_is_set_jumps_at_that_time() -> None:
    diagram = Diagram("set")
    r = diagram.input("r")
    x = diagram.add("x", Integrator())
    diagram.wire(x.u, r)
    run = diagram.start(inputs={"r": 1.0}, stop=2.0)
    run.advance(0.3)
    run.set("r", -2.0)
    assert run["x.y"] == pytest.approx(0.3, abs=1e-14)
    run.advance(0.7)
    assert run["x.y"] == pytest.approx(0.3 - 1.4, abs=1e-14)
    results = run.results
    assert results.t.tolist().count(0.3) == 2
    assert results["r"][results.t == 0.3].tolist() == [1.0, -2.0]


def test_setting_an_input_to_what_it_is_adds_no_row() -> None:
    diagram = Diagram("set")
    diagram.add("x", Integrator())
    r = diagram.input("r")
    diagram.wire("x.u", r)
    run = diagram.start(inputs={"r": 1.0}, stop=2.0)
    for _ in range(4):
        run.advance(0.25)
        run.set("r", 1.0)
        run.set("r", 1.0)
    run.advance(0.25)
    assert len(set(run.results.t.tolist())) == len(run.results.t)


def test_two_inputs_that_are_set_together_make_one_instant() -> None:
    diagram = Diagram("set")
    for key in "ab":
        diagram.input(key, default=0.0)
    total = diagram.add("total", Sum(signs="++"))
    diagram.wire(total.u1, "a")
    diagram.wire(total.u2, "b")
    run = diagram.start(stop=1.0)
    run.advance(0.5)
    run.set("a", 1.0)
    run.set("b", -1.0)
    run.advance(0.5)
    assert run.results["total.y"].tolist() == [0.0] * len(run.results.t)
    assert run.results["a"][run.results.t == 0.5].tolist() == [0.0, 1.0]


def test_a_tunable_parameter_that_is_set_counts_from_then_on() -> None:
    diagram = Diagram("tuned")
    one, gain, x = diagram.add("one", Constant()), diagram.add("gain", Gain(k=2.0)), diagram.add("x", Integrator())
    diagram.wire(gain.u, one.y)
    diagram.wire(x.u, gain.y)
    run = diagram.start(stop=2.0)
    run.advance(1.0)
    run.set("gain.k", 5.0)
    run.advance(1.0)
    assert run["x.y"] == pytest.approx(7.0, abs=1e-13)
    assert run.results["gain.y"][run.results.t == 1.0].tolist() == [2.0, 5.0]


def test_within_ulps_counts_spacings() -> None:
    assert within_ulps(0.3, 0.3 + 4 * math.ulp(0.3))
    assert not within_ulps(0.3, 0.3 + 5 * math.ulp(0.3))
    assert within_ulps(-1.0, -1.0)
    assert within_ulps(math.inf, math.inf)
    assert not within_ulps(math.inf, 1e308)
    assert not within_ulps(0.0, 1e-300)


# --- instants of ticks and edges alone ----------------------------------------------------------------------------


def pulsed(is_delayed: bool) -> Diagram:
    """A sampled loop with a saturated control and pulses, two of which rise together.

    is_delayed: beside a delay that is longer than the run, so that all instants are taken as those of any diagram.
    """
    diagram = Diagram("pulsed")
    first = diagram.add("first", SquareWave(period=0.05, duty=0.4))
    second = diagram.add("second", SquareWave(period=0.1, duty=0.3, high=0.5))
    third = diagram.add("third", SquareWave(period=0.037, duty=0.5, high=0.2))
    load = diagram.add("load", Sum(signs="+++"))
    plant = diagram.add("plant", SecondOrder(w=5.0, d=0.3))
    error = diagram.add("error", Sum(signs="+-"))
    sampler = diagram.add("sampler", ZeroOrderHold(period=0.02))
    integral = diagram.add("integral", DiscreteIntegrator(period=0.01))
    limit = diagram.add("limit", Saturation(lower=-0.1, upper=0.1))
    switch = diagram.add("switch", Relay(on_at=0.9, off_at=0.7, on=-0.2, off=0.2))
    sum_of = diagram.add("sum", Sum(signs="+++"))
    counter = diagram.add("counter", Counter())
    for sink, source in (
        (load.u1, first.y),
        (load.u2, second.y),
        (load.u3, third.y),
        (error.u1, load.y),
        (error.u2, plant.y),
        (sampler.u, error.y),
        (integral.u, sampler.y),
        (limit.u, integral.y),
        (switch.u, plant.y),
        (sum_of.u1, limit.y),
        (sum_of.u2, switch.y),
        (sum_of.u3, load.y),
        (plant.u, sum_of.y),
        (counter.u, first.y),
    ):
        diagram.wire(sink, source)
    if is_delayed:
        delay = diagram.add("delay", TransportDelay(delay=10.0))
        diagram.wire(delay.u, diagram.add("nothing", Constant(value=0.0)).y)
    diagram.measure("ISE", type="ISE", of=plant.y, against=1.0)
    return diagram


@pytest.mark.parametrize("more", [{}, {"every": 0.05}, {"every": 0.03, "jumps": True}], ids=["steps", "grid", "jumps"])
def test_instants_of_ticks_and_edges_alone_are_what_they_are_beside_a_delay(more: dict[str, Any]) -> None:
    log = ["plant.y", "limit.y", "switch.y", "counter.y", "integral.y"]
    settings: dict[str, Any] = {"method": "rk4", "step": 0.005, "stop": 3.0, "log": log, **more}
    plain, general = (pulsed(is_delayed).run(engine="native", **settings) for is_delayed in (False, True))
    assert np.array_equal(plain.t, general.t)
    assert np.array_equal(plain.values, general.values)
    assert plain.events == general.events
    assert plain.measures["ISE"] == pytest.approx(general.measures["ISE"], rel=1e-13)
    assert plain.statistics.instants == general.statistics.instants
    assert {event.block for event in plain.events} >= {"first", "second", "third", "limit", "switch", "counter"}
