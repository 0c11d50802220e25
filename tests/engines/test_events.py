"""Crossings and event times: when they fire, what they change, and what is refused."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from blocks import (
    Abs,
    Block,
    BouncingBall,
    Constant,
    DeadZone,
    Diagram,
    Discrete,
    Gain,
    Input,
    Integrator,
    Parameter,
    Pulse,
    Results,
    Saturation,
    SimulationError,
    Sine,
    State,
    Step,
    Sum,
    UsageError,
    crossing,
    event_time,
    output,
)
from blocks.engines.reference import event_location
from tests.support.marks import long_but

TIGHT: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-12}
METHODS: list[dict[str, Any]] = [
    {"method": "dopri5"},
    {"method": "dopri5", **TIGHT},
    {"method": "rk4", "step": 0.01},
    {"method": "rk4", "step": 0.1},
    {"method": "radau", "rtol": 1e-8, "atol": 1e-10},
]
LOCATED = 1e-12
"""A located time is within 4 ulp of the crossing; near t = 10 that is 7e-15, and states carry some rounding in."""


def name(settings: dict[str, Any]) -> str:
    return "-".join(map(str, settings.values()))


def alone(block: Block, **settings: Any) -> Results:
    diagram = Diagram("one")
    diagram.add("b", block)
    return diagram.run(**settings)


def times(results: Results, block: str, what: str = "") -> list[float]:
    return [event.t for event in results.events if event.block == block and what in ("", event.what)]


# --- the bouncing ball -----------------------------------------------------------------------------------------


def impacts(e: float, v_rest: float, *, g: float = 9.81, h: float = 1.0) -> list[float]:
    """The times of all impacts up to the one after which the ball rests."""
    fall = math.sqrt(2 * h / g)
    made, speed = [fall], g * fall
    while e * speed >= v_rest:
        speed *= e
        made.append(made[-1] + 2 * speed / g)
    return made


@pytest.mark.parametrize("settings", METHODS, ids=name)
@pytest.mark.parametrize(("e", "v_rest"), [(0.7, 1e-3), (0.5, 1e-6), (0.9, 0.05)])
def test_the_ball_bounces_when_the_closed_form_says_and_then_rests(
    settings: dict[str, Any], e: float, v_rest: float
) -> None:
    """Also when a flight (1e-6 s at last) is far shorter than a step."""
    results = alone(BouncingBall(e=e, v_rest=v_rest), stop=10.0, **settings)
    expected = impacts(e, v_rest)
    assert expected[-1] < 10.0
    found = times(results, "b", "impact")
    assert len(found) == len(expected)
    assert np.max(np.abs(np.array(found) - expected)) < 1e-9
    assert results["b.h"][-1] == results["b.v"][-1] == 0.0
    assert results["b.resting"][-1] == 1.0
    assert np.min(results["b.h"]) > -1e-12


def test_the_ball_bounces_in_euler_where_euler_sees_the_floor() -> None:
    """Euler's flight is another one: a polygon. Its impacts lie on the floor all the same."""
    results = alone(BouncingBall(), stop=1.0, method="euler", step=0.001)
    assert times(results, "b")[0] == pytest.approx(math.sqrt(2 / 9.81), abs=1e-3)
    rows = np.isin(results.t, times(results, "b"))
    assert np.max(np.abs(results["b.h"][rows])) < 1e-12


@pytest.mark.parametrize("settings", METHODS, ids=name)
def test_a_ball_without_rest_is_refused_at_its_zeno_point_and_its_flight_is_kept(settings: dict[str, Any]) -> None:
    with pytest.raises(SimulationError, match=r"E304 b\.impact: fires ever faster, .* Zeno") as caught:
        alone(BouncingBall(v_rest=0.0), stop=10.0, **settings)
    end = math.sqrt(2 / 9.81) * (1 + 2 * 0.7 / 0.3)
    results = caught.value.results
    assert results.t[-1] == pytest.approx(end, abs=1e-6)
    assert np.all(np.isfinite(results.values))
    assert np.min(results["b.h"]) > -1e-12, "it never falls through the floor"
    expected = impacts(0.7, 1e-3)
    assert np.allclose(times(results, "b")[: len(expected)], expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("settings", "floor", "e"),
    long_but(
        itertools.product(
            ({}, {"rtol": 1e-10}, {"method": "rk4", "step": 0.01}, {"method": "radau"}),
            (0.0, 5.0),
            (0.05, 0.2, 0.7, 0.95),
        ),
        lambda settings, floor, e: not settings or "step" in settings or (floor, e) == (5.0, 0.7),
    ),
)
def test_a_ball_whose_impact_does_not_lift_it_does_not_fall_through_the_floor(
    settings: dict[str, Any], floor: float, e: float
) -> None:
    class Plain(Block):
        """Above a floor; an impact turns v into -e v, and leaves h a rounding error below the floor."""

        e = Parameter()
        floor = Parameter()
        h = State(6.0, output=True)
        v = State()

        @h.derivative
        def dh(v):
            return v

        @v.derivative
        def dv():
            return -9.81

        @crossing(direction="down")
        def impact(h, floor):
            return h - floor

        @impact.reset(v)
        def rebound(v, e):
            return -e * v

    with pytest.raises(SimulationError, match=r"E304 b\.impact: .* Zeno") as caught:
        alone(Plain(e=e, floor=floor, h_start=floor + 1.0), stop=40.0, **settings)
    end = math.sqrt(2 / 9.81) * (1 + 2 * e / (1 - e))
    assert caught.value.results.t[-1] == pytest.approx(end, abs=1e-5)
    assert np.min(caught.value.results["b.h"]) > floor - 1e-11


def test_chattering_is_refused_and_names_its_block() -> None:
    class Sign(Block):
        """dx/dt = -sign(x): it slides along x = 0."""

        x = State(0.5, output=True)

        @crossing
        def above(x):
            return x

        @x.derivative
        def dx(above):
            return np.where(above, -1.0, 1.0)

    for settings in ({}, {"method": "rk4", "step": 0.03}):
        with pytest.raises(SimulationError, match=r"E304 b\.above: .*chattering") as caught:
            alone(Sign(), stop=2.0, **settings)
        assert caught.value.results.t[-1] == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("settings", [*METHODS, {"engine": "reference"}], ids=str)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_zeno_by_resets_of_a_crossing_of_both_directions_is_refused(settings: dict[str, Any], sign: float) -> None:
    """x reaches the threshold after gaps of 1, 1/2, 1/4, ...: each time upwards only, or downwards only."""

    class Shorter(Block):
        sign = Parameter()
        x = State(0.0, output=True)
        gap = State(1.0)

        @x.derivative
        def dx(sign):
            return sign

        @gap.derivative
        def dgap(gap):
            return 0.0 * gap

        @crossing
        def reached(x, sign):
            return x - sign

        @reached.reset(x)
        def back(x, gap, sign):
            return x - sign * gap

        @reached.reset(gap)
        def halved(gap):
            return gap / 2

    with pytest.raises(SimulationError, match=r"E304 b\.reached: .* Zeno") as caught:
        alone(Shorter(sign=sign), stop=5.0, **settings)
    assert caught.value.results.t[-1] == pytest.approx(3.0, abs=1e-6)


@pytest.mark.parametrize("settings", [*METHODS, {"engine": "reference"}], ids=str)
@pytest.mark.parametrize("limit", [2.0, 2.3, 0.7 + 1e-16])
def test_corners_that_touch_a_limit_are_no_chattering(settings: dict[str, Any], limit: float) -> None:
    """A corner exactly at the limit passes it and comes back within an ulp, at each of its times."""
    diagram = Diagram("touches")
    zone = diagram.add("zone", DeadZone(lower=0.0, upper=limit))
    diagram.wire(zone.u, diagram.input("x"))
    t = np.array([0.0, 0.31, 0.62, 0.7, 0.95, 1.0])
    u = np.array([0.3, limit, 0.1, limit, 0.2, limit + 1.0])
    results = diagram.run(stop=1.0, inputs={"x": (t, u)}, interpolation="linear", **settings)
    expected = np.maximum(0.0, np.interp(results.t, t, u) - limit)
    assert np.max(np.abs(results["zone.y"] - expected)) < 1e-12
    assert results.events[-1].t == pytest.approx(0.95 + 0.05 * (limit - 0.2) / (limit + 0.8), abs=1e-9)
    assert {round(event.t, 9) for event in results.events[:-1]} <= {0.31, 0.7}


# --- where crossings are ---------------------------------------------------------------------------------------


class Watch(Block):
    """Counts the changes of the side of u - level, by direction."""

    level = Parameter(0.0)
    u = Input()
    ups = Discrete(output=True)
    downs = Discrete(output=True)
    changes = Discrete(output=True)

    @crossing(direction="up")
    def up(u, level):
        return u - level

    @crossing(direction="down")
    def down(u, level):
        return u - level

    @crossing
    def both(u, level):
        return u - level

    @up.reset(ups)
    def count_up(ups):
        return ups + 1

    @down.reset(downs)
    def count_down(downs):
        return downs + 1

    @both.reset(changes)
    def count(changes):
        return changes + 1

    @output(type="bool")
    def side(both):
        return both


def watched(source: Block, level: float, **settings: Any) -> Results:
    diagram = Diagram("watched")
    made, watch = diagram.add("source", source), diagram.add("watch", Watch(level=level))
    diagram.wire(watch.u, made.y)
    return diagram.run(**settings)


@pytest.mark.parametrize("settings", [*METHODS, {"method": "euler", "step": 0.07}], ids=name)
def test_crossings_of_a_pure_function_of_time_are_located_without_any_state(settings: dict[str, Any]) -> None:
    results = watched(Sine(omega=2.0), 0.5, stop=6.0, **settings)
    rising, falling = math.asin(0.5) / 2, (math.pi - math.asin(0.5)) / 2
    assert times(results, "watch", "up") == pytest.approx([rising, rising + math.pi], abs=LOCATED)
    assert times(results, "watch", "down") == pytest.approx([falling, falling + math.pi], abs=LOCATED)
    both = sorted([*times(results, "watch", "up"), *times(results, "watch", "down")])
    assert times(results, "watch", "both") == both
    assert [results[f"watch.{n}"][-1] for n in ("ups", "downs", "changes")] == [2, 2, 4]


def test_two_crossings_in_one_step_are_found() -> None:
    """A step of 0.5 s over the crest of a sine that is above the level for 0.05 s only."""
    level = math.cos(0.025)
    results = watched(Sine(), level, stop=3.0, method="rk4", step=0.5)
    expected = [math.pi / 2 - 0.025, math.pi / 2 + 0.025]
    assert [event.t for event in results.events if event.what == "both"] == pytest.approx(expected, abs=LOCATED)


@pytest.mark.parametrize("settings", METHODS, ids=name)
def test_two_crossings_of_one_flight_are_found(settings: dict[str, Any]) -> None:
    """x = t - t^2/2 is above 0.4999 for 0.028 s around t = 1."""

    class Flight(Block):
        x = State(output=True)
        v = State(1.0)

        @x.derivative
        def dx(v):
            return v

        @v.derivative
        def dv():
            return -1.0

        @crossing
        def high(x):
            return x - 0.4999

    found = times(alone(Flight(), stop=2.0, **settings), "b")
    assert found == pytest.approx([1 - math.sqrt(2e-4), 1 + math.sqrt(2e-4)], abs=1e-9)


def test_touching_without_crossing_changes_no_side() -> None:
    """u <= level: the side `u - level >= 0` would be reached at the crest only; just below it nothing happens."""
    results = watched(Sine(), 1.0 + 1e-9, stop=20.0)
    assert results.events == ()
    results = watched(Sine(), -1.0, stop=20.0)  # u >= level at all times: the side is never left
    assert results["watch.side"].min() == 1.0
    assert results.events == ()


def test_a_crossing_that_is_grazed_at_the_end_of_a_run_ends_it_well() -> None:
    results = watched(Sine(phase=math.pi / 2 - 1), 1.0, stop=1.0)
    assert results.t[-1] == 1.0
    assert len(results.events) in (0, 2)  # sin(1 + pi/2 - 1) may or may not be rounded to 1


@pytest.mark.parametrize("settings", [*METHODS, {"method": "euler", "step": 0.1}], ids=name)
def test_a_crossing_exactly_at_a_grid_point_fires_once(settings: dict[str, Any]) -> None:
    """x = t reaches 0.5 and 1.0, where fixed steps end."""
    diagram = Diagram("ramp")
    one, x = diagram.add("one", Constant()), diagram.add("x", Integrator())
    diagram.wire(x.u, one.y)
    for k, level in enumerate((0.5, 1.0)):
        watch = diagram.add(f"watch{k}", Watch(level=level))
        diagram.wire(watch.u, x.y)
    results = diagram.run(stop=2.0, **settings)
    for k, level in enumerate((0.5, 1.0)):
        assert times(results, f"watch{k}", "up") == pytest.approx([level], abs=1e-12)
        assert results[f"watch{k}.changes"][-1] == 1


def test_a_crossing_at_the_stop_fires_and_one_at_the_start_does_not() -> None:
    diagram = Diagram("ramp")
    one, x = diagram.add("one", Constant()), diagram.add("x", Integrator())
    diagram.wire(x.u, one.y)
    for k, level in enumerate((0.0, 1.0)):
        watch = diagram.add(f"watch{k}", Watch(level=level))
        diagram.wire(watch.u, x.y)
    results = diagram.run(stop=1.0, method="euler", step=0.125)  # exact in binary
    assert times(results, "watch0") == []
    assert results["watch0.side"][0] == 1.0
    assert times(results, "watch1", "up") == [1.0]
    assert results["watch1.ups"][-1] == 1
    assert results["watch1.side"].tolist()[-2:] == [0.0, 1.0]  # left and right


def test_sides_at_the_start_can_be_read_by_initial_equations() -> None:
    class Chooses(Block):
        u = Input()
        x = State(output=True)

        @crossing
        def positive(u):
            return u

        @x.initial
        def x_start(positive):
            return np.where(positive, 1.0, 2.0)

        @x.derivative
        def dx():
            return 0.0

    for value, expected in ((-3.0, 2.0), (0.0, 1.0), (3.0, 1.0)):
        diagram = Diagram("start")
        source, block = diagram.add("source", Constant(value=value)), diagram.add("b", Chooses())
        diagram.wire(block.u, source.y)
        assert diagram.run(stop=0.1)["b.x"][0] == expected


@pytest.mark.parametrize("settings", METHODS, ids=name)
def test_the_corners_of_a_saturation_are_located(settings: dict[str, Any]) -> None:
    """dx/dt = sat(2 sin t) between corners is smooth, so that the integral is exact to the method's error."""
    diagram = Diagram("corners")
    source, limit, x = (
        diagram.add("source", Sine(amplitude=2.0)),
        diagram.add("limit", Saturation()),
        diagram.add("x", Integrator()),
    )
    diagram.wire(limit.u, source.y)
    diagram.wire(x.u, limit.y)
    results = diagram.run(stop=3.0, **settings)
    corners = [math.pi / 6, 5 * math.pi / 6]
    assert [event.t for event in results.events] == pytest.approx(corners, abs=LOCATED)
    exact = 2 * (1 - math.cos(math.pi / 6)) + (corners[1] - corners[0]) + 2 * (math.cos(corners[1]) - math.cos(3.0))
    tolerance = 1e-5 if settings.get("rtol", 1) > 1e-9 else 1e-9
    assert results["x.y"][-1] == pytest.approx(exact, abs=tolerance)


# --- relays ----------------------------------------------------------------------------------------------------


class Relay(Block):
    """y = +1 or -1: up when u passes above `width`, down when it passes below -width; in between it keeps."""

    width = Parameter(0.2)
    u = Input()
    on = Discrete(False, type="bool")

    @crossing(direction="up")
    def high(u, width):
        return u - width

    @crossing(direction="down")
    def low(u, width):
        return u + width

    @high.reset(on)
    def rise():
        return np.array(True)

    @low.reset(on)
    def fall():
        return np.array(False)

    @output
    def y(on):
        return np.where(on, 1.0, -1.0)


@pytest.mark.parametrize("settings", METHODS, ids=name)
def test_a_relay_with_hysteresis_oscillates_as_the_closed_form_says(settings: dict[str, Any]) -> None:
    """dx/dt = -x - y with y = relay(x): half a period is ln((1 + w)/(1 - w)), and the amplitude is w."""
    width = 0.2
    diagram = Diagram("relay")
    relay, plant = diagram.add("relay", Relay(width=width)), diagram.add("plant", Integrator(y_start=0.0))
    total = diagram.add("total", Sum(signs="--"))
    diagram.wire(relay.u, plant.y)
    diagram.wire(total.u1, plant.y)
    diagram.wire(total.u2, relay.y)
    diagram.wire(plant.u, total.y)
    results = diagram.run(stop=10.0, **settings)
    half = math.log((1 + width) / (1 - width))
    first = math.log(1 / (1 - width))
    found = times(results, "relay")
    tolerance = 1e-4 if settings.get("rtol", 1e-6) == 1e-6 else 1e-7
    assert len(found) == 1 + int((10.0 - first) / half)
    assert found == pytest.approx([first + k * half for k in range(len(found))], abs=tolerance)
    assert np.max(np.abs(results["plant.y"])) == pytest.approx(width, abs=1e-9)
    between = results["relay.y"][np.abs(results["plant.y"]) < 0.9 * width]
    assert set(np.unique(between)) == {-1.0, 1.0}


# --- resets ----------------------------------------------------------------------------------------------------


def test_all_resets_of_an_instant_see_the_values_before_it() -> None:
    class Swap(Block):
        """At t = 1, a and b change places, and n becomes 10 a + b."""

        a = State(1.0, output=True)
        b = State(2.0, output=True)
        n = Discrete(output=True)

        @a.derivative
        def da():
            return 0.0

        @b.derivative
        def db():
            return 0.0

        @event_time
        def edge(t):
            return np.where(t < 1.0, 1.0, np.inf)

        @edge.reset(a)
        def a_after(b):
            return b

        @edge.reset(b)
        def b_after(a):
            return a

        @edge.reset(n)
        def n_after(a, b):
            return 10 * a + b

    results = alone(Swap(), stop=2.0)
    assert [results[f"b.{key}"][-1] for key in ("a", "b", "n")] == [2.0, 1.0, 12.0]
    assert results.t.tolist().count(1.0) == 2


class Both(Block):
    """Two causes at t = 1 that reset x; `first` is declared first, but its reset last."""

    x = Discrete(output=True)

    @event_time
    def first(t):
        return np.where(t < 1.0, 1.0, np.inf)

    @event_time
    def second(t):
        return np.where(t < 1.0, 1.0, np.inf)

    @second.reset(x)
    def by_second():
        return 2.0

    @first.reset(x)
    def by_first():
        return 1.0


def test_of_two_resets_of_one_variable_the_one_declared_later_wins_and_a_warning_says_so() -> None:
    diagram = Diagram("one")
    diagram.add("b", Both())
    warnings = [fault for fault in diagram.check().warnings if fault.code == "W102"]
    assert [fault.place for fault in warnings] == ["b.x"]
    assert "'second' and 'first'" in str(warnings[0])
    assert "'first' wins" in str(warnings[0])
    results = diagram.run(stop=2.0)
    assert results["b.x"][-1] == 1.0
    assert [event.what for event in results.events] == ["first", "second"]


def test_one_equation_that_serves_two_causes_is_no_reason_to_warn() -> None:
    diagram = Diagram("library")
    for number, block in enumerate((Pulse(), Step(), BouncingBall())):
        diagram.add(f"b{number}", block)
    assert [fault for fault in diagram.check().warnings if fault.code == "W102"] == []


def test_an_event_that_makes_another_at_the_same_instant_is_followed() -> None:
    """The step at 0.3 lifts u above two levels in turn: the sum of what was counted is seen by the second watch."""
    diagram = Diagram("chain")
    step = diagram.add("step", Step(at=0.3, after=1.0))
    first, second = diagram.add("first", Watch(level=0.5)), diagram.add("second", Watch(level=0.5))
    diagram.wire(first.u, step.y)
    diagram.wire(second.u, first.ups)
    results = diagram.run(stop=1.0)
    assert {event.t for event in results.events} == {0.3}
    assert [(e.block, e.what) for e in results.events] == [
        ("step", "edge"), ("first", "up"), ("first", "both"), ("second", "up"), ("second", "both"),
    ]  # fmt: skip
    assert results["second.ups"][-1] == 1.0
    assert results.t.tolist().count(0.3) == 2


def test_a_chain_reaction_without_end_is_refused_and_its_cycle_named() -> None:
    diagram = Diagram("ring")
    step = diagram.add("step", Step(at=0.3, before=-10.0, after=0.0))
    total = diagram.add("total", Sum(signs="+-"))
    relay = diagram.add("relay", Relay(width=0.1))
    scaled = diagram.add("scaled", Gain(k=2.0))
    diagram.wire(total.u1, step.y)
    diagram.wire(total.u2, scaled.y)
    diagram.wire(scaled.u, relay.y)
    diagram.wire(relay.u, total.y)
    with pytest.raises(SimulationError) as caught:
        diagram.run(stop=1.0)
    assert caught.value.code == "E305"
    text = str(caught.value)
    assert "at t = 0.3 s" in text
    cycle = text.partition("without end: ")[2].partition(".\n")[0]
    assert "relay.high" in cycle
    assert "relay.low" in cycle


def test_a_cycle_of_sides_alone_is_refused_too() -> None:
    class Liar(Block):
        """The side says: my value is on the other side."""

        u = Input()

        @crossing(direction="up", start=False)
        def side(side, u):
            return np.where(side, -1.0, 1.0) * u

    diagram = Diagram("liar")
    step, liar = diagram.add("step", Step(at=0.3, before=0.0)), diagram.add("liar", Liar())
    diagram.wire(liar.u, step.y)
    with pytest.raises(SimulationError, match=r"E305 liar\.side: at t = 0\.3 s .*liar\.side -> liar\.side"):
        diagram.run(stop=1.0)


# --- event times -----------------------------------------------------------------------------------------------


def test_an_event_time_that_is_not_in_the_future_is_refused() -> None:
    class Stuck(Block):
        @event_time
        def edge(t):
            return np.where(t <= 1.0, 1.0, np.inf)

        @output
        def y(t):
            return t

    with pytest.raises(
        SimulationError, match=r"E306 b\.edge: returned 1\.0 as the next instant after t = 1\.0 s"
    ) as caught:
        alone(Stuck(), stop=2.0)
    assert caught.value.results.t[-1] < 1.0


@pytest.mark.parametrize("value", [math.nan, -math.inf, -1.0])
def test_an_event_time_in_the_past_or_not_a_number_is_refused_at_the_start(value: float) -> None:
    class Past(Block):
        at = Parameter(-1.0)

        @event_time
        def edge(t, at):
            return np.where(t < 5.0, at if math.isfinite(value) else value, np.inf)

        @output
        def y(t):
            return t

    with pytest.raises(SimulationError, match=r"E306 b\.edge"):
        alone(Past(), stop=2.0)


def test_periodic_edges_are_hit_exactly_and_last() -> None:
    class Clock(Block):
        """An edge at each multiple of 0.1 s, by a count."""

        n = Discrete(output=True)

        @event_time
        def edge(n):
            return (n + 1) / 10

        @edge.reset(n)
        def counted(n):
            return n + 1

    results = alone(Clock(), stop=100.0)
    assert times(results, "b") == [k / 10 for k in range(1, 1001)]


def test_the_time_of_an_edge_cannot_be_set_during_a_run() -> None:
    """What an edge left behind (that a step has come) could not follow; the height of the step can."""
    diagram = Diagram("moved")
    diagram.add("step", Step(at=2.0))
    run = diagram.start(stop=3.0)
    run.advance(0.5)
    with pytest.raises(UsageError, match="E117"):
        run.set("step.at", 0.25)
    run.set("step.after", 5.0)
    run.advance(2.0)
    assert [event.t for event in run.results.events] == [2.0]
    assert run["step.y"] == 5.0


def test_the_steps_after_an_event_start_from_the_size_before() -> None:
    """A jump of a slow input is no reason to creep: as many steps as an integration begun anew on each side takes."""
    diagram = Diagram("jump")
    step, x = diagram.add("step", Step(at=5.0)), diagram.add("x", Integrator())
    total = diagram.add("total", Sum(signs="+-"))
    diagram.wire(total.u1, step.y)
    diagram.wire(total.u2, x.y)
    diagram.wire(x.u, total.y)
    results = diagram.run(stop=10.0, **TIGHT)
    one_side = solve_ivp(lambda t, x: 1 - x, (0, 5), [0.0], rtol=1e-10, atol=1e-12, max_step=0.2)
    assert results.statistics.steps < 25 + 1.5 * len(one_side.t)
    assert results["x.y"][-1] == pytest.approx(1 - math.exp(-5), abs=1e-9)


# --- search ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("root", [1e-12, 0.1, 0.5, 0.73, 1 - 1e-12])
@pytest.mark.parametrize("power", [1, 3, 9])
def test_the_bracket_closes_around_flat_and_steep_roots(root: float, power: int) -> None:
    calls = []

    def beyond(x: float) -> float:
        calls.append(x)
        return math.copysign(abs(x - root) ** power, x - root)

    found = event_location.narrowed(beyond, 0.0, 1.0, 1e-15)
    assert root <= found <= root + 1e-15
    assert len(calls) < (20 if power == 1 else 80)


def test_the_bracket_closes_around_a_jump() -> None:
    found = event_location.narrowed(lambda x: 1e6 if x >= 1 / 3 else -1e-9, 0.0, 1.0, 1e-15)
    assert 1 / 3 <= found <= 1 / 3 + 2e-15


def test_a_crossing_that_becomes_infinite_is_found_all_the_same() -> None:
    """u = 1/(t - 1) goes from minus to plus infinity at t = 1: a change of side like others."""

    class Pole(Block):
        n = Discrete(output=True)

        @crossing(direction="up")
        def over(t):
            return 1.0 / (t - 1.0)

        @over.reset(n)
        def counted(n):
            return n + 1

    for settings in ({}, {"method": "rk4", "step": 0.25}, {"method": "rk4", "step": 0.3}):
        results = alone(Pole(), stop=2.0, **settings)
        assert times(results, "b") == pytest.approx([1.0], abs=1e-12)
        assert results["b.n"][-1] == 1.0


@pytest.mark.parametrize("settings", [{}, {"method": "radau"}, {"method": "rk4", "step": 0.05}], ids=str)
@pytest.mark.parametrize("omega", [1.0, 3.0, 5.0])
def test_a_signal_that_touches_a_corner_is_no_zeno(settings: dict[str, Any], omega: float) -> None:
    d = Diagram("touch")
    sine, limit, x = d.add("sine", Sine(omega=omega)), d.add("limit", Saturation()), d.add("x", Integrator())
    d.wire(limit.u, sine.y)
    d.wire(x.u, limit.y)
    results = d.run(stop=20.0, **settings)
    assert results["x.y"][-1] == pytest.approx((1.0 - math.cos(20.0 * omega)) / omega, abs=1e-4)


@pytest.mark.parametrize("settings", [{}, {"method": "rk4", "step": 0.25}], ids=str)
def test_a_step_with_a_crossing_may_end_at_zero(settings: dict[str, Any]) -> None:
    d = Diagram("zero")
    sine, law, x = d.add("sine", Sine(omega=3.0)), d.add("law", Abs()), d.add("x", Integrator())
    d.wire(law.u, sine.y)
    d.wire(x.u, law.y)
    for stop in (0.0, 0.5):
        assert d.run(start=-6.0, stop=stop, **settings).t[-1] == stop
