"""The order inside an instant: who sees what of whom, for everything that can come together at one time."""

# mypy: allow-untyped-defs, allow-untyped-decorators, no-check-untyped-defs
# Equations have no self and no annotations; tests have theirs.

import itertools
import math
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    Diagram,
    Discrete,
    DiscreteIntegrator,
    Gain,
    Input,
    Integrator,
    Parameter,
    Ramp,
    Relay,
    Results,
    Saturation,
    Sine,
    State,
    Step,
    TransportDelay,
    UnitDelay,
    ZeroOrderHold,
    crossing,
    event_time,
    output,
)

AT = 0.5
"""The time at which things come together: exact in binary, and so are all times here."""

METHODS: list[dict[str, Any]] = [
    {"method": "dopri5"},
    {"method": "rk4", "step": 0.125},
    {"method": "euler", "step": 0.125},
    {"method": "radau"},
    {"method": "dopri5", "every": 0.25, "jumps": True},
]


def name(settings: Any) -> str:
    return "-".join(map(str, settings.values())) if isinstance(settings, dict) else "+".join(settings)


# --- the table -------------------------------------------------------------------------------------------------


class Crosses(Block):
    """n is 1 from the crossing at `at` on; the crossing keeps what it saw of the others."""

    at = Parameter(AT)
    of_event = Input()
    of_input = Input()
    of_tick = Input()
    n = Discrete(output=True)
    saw_event = Discrete(-1.0, output=True)
    saw_input = Discrete(-1.0, output=True)
    saw_tick = Discrete(-1.0, output=True)

    @crossing(direction="up")
    def passes(t, at):
        return t - at

    @passes.reset(n)
    def counted(n):
        return n + 1.0

    @passes.reset(saw_event)
    def see_event(of_event):
        return of_event

    @passes.reset(saw_input)
    def see_input(of_input):
        return of_input

    @passes.reset(saw_tick)
    def see_tick(of_tick):
        return of_tick


class Edges(Block):
    """n is 1 from the event time `at` on; the event keeps what it saw of the others."""

    at = Parameter(AT)
    of_crossing = Input()
    of_input = Input()
    of_tick = Input()
    n = Discrete(output=True)
    saw_crossing = Discrete(-1.0, output=True)
    saw_input = Discrete(-1.0, output=True)
    saw_tick = Discrete(-1.0, output=True)

    @event_time
    def edge(t, at):
        return np.where(t < at, at, np.inf)

    @edge.reset(n)
    def counted(n):
        return n + 1.0

    @edge.reset(saw_crossing)
    def see_crossing(of_crossing):
        return of_crossing

    @edge.reset(saw_input)
    def see_input(of_input):
        return of_input

    @edge.reset(saw_tick)
    def see_tick(of_tick):
        return of_tick


class Ticks(Block):
    """n is 1 from the tick at `at` on; the tick keeps what it saw of the others, by outputs and by updates."""

    at = Parameter(AT)
    of_crossing = Input()
    of_event = Input()
    of_input = Input()
    updated_crossing = Discrete(-1.0, visible="after", output=True)
    updated_event = Discrete(-1.0, visible="after", output=True)
    updated_input = Discrete(-1.0, visible="after", output=True)

    @output(every=16.0, offset=at)
    def n():
        return 1.0

    @output(every=16.0, offset=at, start=-1.0)
    def saw_crossing(of_crossing):
        return of_crossing

    @output(every=16.0, offset=at, start=-1.0)
    def saw_event(of_event):
        return of_event

    @output(every=16.0, offset=at, start=-1.0)
    def saw_input(of_input):
        return of_input

    @updated_crossing.next(every=16.0, offset=at)
    def update_crossing(of_crossing):
        return of_crossing

    @updated_event.next(every=16.0, offset=at)
    def update_event(of_event):
        return of_event

    @updated_input.next(every=16.0, offset=at)
    def update_input(of_input):
        return of_input


THINGS = ("tick", "crossing", "event", "input", "stop")
OTHERWISE = {"crossing": 0.75, "event": 0.8125, "tick": 0.875, "input": 0.9375, "stop": 2.0}
"""When each comes where it does not come at AT: one by one, so that each sees those before it and none after."""

SEES = {
    "crossing": {"event": False, "input": True, "tick": False},
    "event": {"crossing": False, "input": True, "tick": False},
    "tick": {"crossing": True, "event": True, "input": True},
}
"""Whether a thing sees another one that comes at its own time: an input's new value is there when the instant begins;
crossings and events fire together, from the values before; then comes the tick."""


def together(things: tuple[str, ...], **settings: Any) -> tuple[Results, dict[str, float]]:
    """A run in which some things come at AT and the others later, and the time of each."""
    at = {thing: AT if thing in things else OTHERWISE[thing] for thing in THINGS}
    d = Diagram("together")
    u = d.input("u")
    tick = d.add("tick", Ticks(at=at["tick"]))
    event, crosses = d.add("event", Edges(at=at["event"])), d.add("crossing", Crosses(at=at["crossing"]))
    d.add("rest", Integrator())  # a state, so that the methods have something to do
    d.wire("rest.u", u)
    for handle, block in ((tick, "tick"), (event, "event"), (crosses, "crossing")):
        for other in SEES[block]:
            d.wire(getattr(handle, f"of_{other}"), u if other == "input" else f"{other}.n")
    inputs = {"u": ([0.0, at["input"]], [0.0, 1.0], "hold")}
    return d.run(stop=at["stop"], inputs=inputs, **settings), at


@pytest.mark.parametrize("settings", METHODS, ids=name)
@pytest.mark.parametrize(
    "things", [chosen for n in range(1, 6) for chosen in itertools.combinations(THINGS, n)], ids=name
)
def test_what_comes_together_sees_each_other_as_the_table_says(
    things: tuple[str, ...], settings: dict[str, Any]
) -> None:
    results, at = together(things, **settings)
    stop = at["stop"]
    for who, others in SEES.items():
        for other, sees in others.items():
            expected = float(at[other] < at[who] or (at[other] == at[who] and sees)) if at[who] <= stop else -1.0
            assert results[f"{who}.saw_{other}"][-1] == expected, (who, other)
            if who == "tick":
                assert results[f"tick.updated_{other}"][-1] == expected, other
    # Each came once, at its time; rows at AT are one before and one after, with all that came in the second.
    signals = {"crossing": "crossing.n", "event": "event.n", "tick": "tick.n", "input": "u"}
    for thing, signal in signals.items():
        assert results[signal][-1] == float(at[thing] <= stop)
        if at[thing] > AT:
            continue
        if thing == "crossing" and things == ("crossing",):  # alone it is located, to 4 ulp
            (t,) = [event.t for event in results.events if event.block == "crossing"]
            assert AT <= t <= AT + 4 * math.ulp(AT)
            continue
        assert results[signal][results.t == AT].tolist() == [0.0, 1.0], thing
    if things != ("crossing",):  # all in one pass, in the order of the blocks in the diagram
        fired = [event.block for event in results.events if event.t == AT]
        assert fired == [block for block in ("event", "crossing") if block in things]
    assert len([event for event in results.events if event.block == "event"]) == (at["event"] <= stop)
    assert len([event for event in results.events if event.block == "crossing"]) == (at["crossing"] <= stop)
    assert results.t[-1] == stop


@pytest.mark.parametrize("settings", METHODS, ids=name)
def test_all_of_it_at_a_stop_in_between_is_done_once(settings: dict[str, Any]) -> None:
    """A run that is stopped at AT and goes on equals the one with that stop; nothing comes again."""
    d = Diagram("stopped")
    u = d.input("u")
    tick, event, crosses = d.add("tick", Ticks()), d.add("event", Edges()), d.add("crossing", Crosses())
    for handle, block in ((tick, "tick"), (event, "event"), (crosses, "crossing")):
        for other in SEES[block]:
            d.wire(getattr(handle, f"of_{other}"), u if other == "input" else f"{other}.n")
    inputs = {"u": ([0.0, AT], [0.0, 1.0], "hold")}
    whole = d.run(stop=1.0, stops=[AT], inputs=inputs, **settings)
    run = d.start(stop=1.0, inputs=inputs, **settings)
    run.advance_to(AT)
    assert [run[f"{block}.n"] for block in SEES] == [1.0, 1.0, 1.0]
    results = run.finish()
    assert results.values.tobytes() == whole.values.tobytes()
    assert results.events == whole.events
    assert [event.t for event in results.events] == [AT, AT]
    assert [results[f"{block}.n"][-1] for block in SEES] == [1.0, 1.0, 1.0]


# --- what makes something else come ----------------------------------------------------------------------------


class Watch(Block):
    """n is how often u rose to 1."""

    u = Input()
    n = Discrete(output=True)

    @crossing(direction="up")
    def over(u):
        return u - 1.0

    @over.reset(n)
    def counted(n):
        return n + 1.0


class Answers(Block):
    """y is u at the ticks k/4, and `before` what it was at the one before, by a discrete."""

    u = Input()
    last = Discrete(-1.0)

    @output(every=0.25, start=-1.0)
    def y(u):
        return u

    @last.next(every=0.25)
    def kept(u):
        return u

    @output(every=0.25, start=-1.0)
    def before(last):
        return last


def test_an_input_that_jumps_over_a_level_fires_it_and_the_tick_comes_after() -> None:
    """Input, crossing, tick: an input that jumps at AT makes the crossing at AT."""
    d = Diagram("input")
    u = d.input("u")
    watch, tick = d.add("watch", Watch()), d.add("tick", Answers())
    d.wire(watch.u, u)
    d.wire(tick.u, watch.n)
    results = d.run(stop=1.0, inputs={"u": ([0.0, AT], [0.0, 2.0], "hold")})
    assert [(event.t, event.block) for event in results.events] == [(AT, "watch")]
    assert results["watch.n"][results.t == AT].tolist() == [0.0, 1.0]
    assert results["tick.y"][results.t == AT].tolist() == [0.0, 1.0]
    assert results["tick.before"][results.t == 0.75].tolist() == [0.0, 1.0]


def test_an_event_that_moves_a_signal_over_a_level_makes_a_crossing_in_a_pass_of_its_own() -> None:
    """Event, crossing, crossing, tick: each pass sees what the one before has left, and the tick sees them all."""
    d = Diagram("passes")
    # In the reverse order of what follows what, so that the list of events can only be in order by the passes.
    tick, second, gain, first = (
        d.add("tick", Answers()),
        d.add("second", Watch()),
        d.add("gain", Gain(k=3.0)),
        d.add("first", Watch()),
    )
    step = d.add("step", Step(at=AT, after=2.0))
    d.wire(first.u, step.y)
    d.wire(gain.u, first.n)
    d.wire(second.u, gain.y)
    d.wire(tick.u, second.n)
    results = d.run(stop=1.0)
    assert [(event.t, event.block) for event in results.events] == [(AT, "step"), (AT, "first"), (AT, "second")]
    assert results["tick.y"][results.t == AT].tolist() == [0.0, 1.0]
    assert results.t.tolist().count(AT) == 2, "one instant: one row before it, and one after"


def test_a_tick_that_makes_a_crossing_shows_it_to_the_sampled_outputs_that_follow() -> None:
    """Tick, crossing, tick: hold and relay and hold again, all at AT."""
    d = Diagram("stages")
    step, last, relay = d.add("step", Step(at=0.375, after=2.0)), d.add("last", ZeroOrderHold(period=0.25)), Relay()
    switch, hold = d.add("switch", relay), d.add("hold", ZeroOrderHold(period=0.25))
    d.wire(hold.u, step.y)
    d.wire(switch.u, hold.y)
    d.wire(last.u, switch.y)
    results = d.run(stop=1.0)
    for signal, values in (("hold.y", [0.0, 2.0]), ("switch.y", [-1.0, 1.0]), ("last.y", [-1.0, 1.0])):
        assert results[signal][results.t == AT].tolist() == values
    assert [(event.t, event.what) for event in results.events] == [(0.375, "edge"), (AT, "switch")]


class Beats(Block):
    """y is 1 and -1 in turns at the ticks k/4; n counts them."""

    n = Discrete(visible="after", output=True)

    @n.next(every=0.25)
    def counted(n):
        return n + 1.0

    @output(every=0.25)
    def y(tick):
        return np.cos(np.pi * tick)


def test_a_tick_comes_once_however_many_events_it_makes() -> None:
    d = Diagram("once")
    beats, relay = d.add("beats", Beats()), d.add("relay", Relay(on_at=0.5, off_at=-0.5))
    watch, again = d.add("watch", Watch()), d.add("again", ZeroOrderHold(period=0.25))
    d.wire(relay.u, beats.y)
    d.wire(watch.u, relay.y)
    d.wire(again.u, watch.n)
    results = d.run(stop=2.0)
    assert results["beats.n"][-1] == 9.0
    rises = [k / 2 for k in range(5)]
    assert [event.t for event in results.events if event.block == "relay"] == [k / 4 for k in range(9)]
    assert [event.t for event in results.events if event.block == "watch"] == rises
    for n, t in enumerate(rises, start=1):
        assert results["again.y"][results.t == t][-1] == n


def updated() -> tuple[Results, Results]:
    """hold -> saturation -> unit delay, alone, and with a hold of the saturation beside."""
    d = Diagram("update")
    step, hold = d.add("step", Step(at=0.375, after=2.0)), d.add("hold", ZeroOrderHold(period=0.25))
    limit, delay = d.add("limit", Saturation()), d.add("delay", UnitDelay(period=0.25))
    d.wire(hold.u, step.y)
    d.wire(limit.u, hold.y)
    d.wire(delay.u, limit.y)
    alone = d.run(stop=1.0)
    d.add("beside", ZeroOrderHold(period=0.25))
    d.wire("beside.u", limit.y)
    return alone, d.run(stop=1.0)


def test_what_an_update_keeps_at_a_tick_is_a_value_that_its_input_has_had() -> None:
    """A saturation within -1 ... 1 gives 2 to nobody."""
    alone, _ = updated()
    assert alone["limit.y"].max() == 1.0
    assert alone["delay.y"].max() == 1.0


def test_what_an_update_keeps_does_not_depend_on_who_else_listens() -> None:
    alone, beside = updated()
    assert alone["delay.y"].tolist() == beside["delay.y"].tolist()


def test_an_update_sees_what_a_sampled_output_beside_it_sees() -> None:
    """hold -> relay: a hold of the relay at AT has its new value, so a sum over the ticks counts it from AT on too."""
    d = Diagram("sums")
    step, hold, relay = (
        d.add("step", Step(at=0.375, after=2.0)),
        d.add("hold", ZeroOrderHold(period=0.25)),
        Relay(off=0.0),
    )
    switch, total = d.add("switch", relay), d.add("total", DiscreteIntegrator(period=0.25))
    d.wire(hold.u, step.y)
    d.wire(switch.u, hold.y)
    d.wire(total.u, switch.y)
    results = d.run(stop=1.0)
    assert results["switch.y"][results.t == AT].tolist() == [0.0, 1.0]
    assert results["total.y"][-1] == 0.5  # the ticks 0.5 and 0.75, each for a quarter


# --- together, to some ulp -------------------------------------------------------------------------------------


def moved(t: float, ulps: int) -> float:
    for _ in range(abs(ulps)):
        t = math.nextafter(t, math.inf if ulps > 0 else -math.inf)
    return t


class Timed(Block):
    """An event at `at` that keeps the time that it sees."""

    at = Parameter(AT)
    seen = Discrete(-1.0, output=True)

    @event_time
    def edge(t, at):
        return np.where(t < at, at, np.inf)

    @edge.reset(seen)
    def see(t):
        return t


TICK = 0.3
"""A tick that no binary fraction is, between 0.25 and 0.5, where all doubles have one spacing."""


@pytest.mark.parametrize("ulps", range(-6, 7))
@pytest.mark.parametrize("host", ["tick", "stop", "input"])
def test_an_event_within_4_ulp_joins_and_its_own_equations_see_its_own_time(host: str, ulps: int) -> None:
    """Beside a tick or the stop the event's time becomes theirs; an event and an input have that of the first."""
    at = moved(TICK, ulps)
    d = Diagram("ulps")
    d.input("u", default=0.0)
    timed = d.add("timed", Timed(at=at))
    if host == "tick":
        sampler = d.add("sampler", ZeroOrderHold(period=0.1, y_start=-1.0))
        d.wire(sampler.u, timed.seen)
    inputs = {"u": ([0.0, TICK], [0.0, 1.0], "hold")} if host == "input" else {}
    results = d.run(stop=TICK if host == "stop" else 0.35, inputs=inputs)
    joins = abs(ulps) <= 4
    if host == "stop" and ulps > 4:
        assert results.events == ()
        return
    together_at = min(at, TICK) if host == "input" else TICK
    assert [event.t for event in results.events] == [together_at if joins else at]
    assert results["timed.seen"][-1] == at
    if host == "tick":
        assert results["sampler.y"][-1] == (at if joins or ulps < 0 else -1.0)
        assert results.statistics.instants == (5 if joins else 6)  # 0, 0.1, 0.2, 0.3 and the stop, and its own
    if host == "input":
        assert results["u"][results.t == together_at].tolist() == ([0.0, 1.0] if joins or ulps > 0 else [0.0, 0.0])
        assert results["u"][-1] == 1.0
    if host == "stop":
        assert results.t[-1] == TICK


@pytest.mark.parametrize("ulps", range(-6, 7))
def test_an_input_that_jumps_within_4_ulp_of_a_tick_is_seen_by_it(ulps: int) -> None:
    at = moved(TICK, ulps)
    d = Diagram("ulps")
    u, sampler = d.input("u"), d.add("sampler", ZeroOrderHold(period=0.1))
    d.wire(sampler.u, u)
    results = d.run(stop=0.35, inputs={"u": ([0.0, at], [0.0, 1.0], "hold")})
    assert results["sampler.y"][-1] == float(ulps <= 4)
    if abs(ulps) <= 4:
        assert results["u"][results.t == TICK].tolist() == [0.0, 1.0]
        assert results.statistics.instants == 5
    else:
        assert results["u"][results.t == at].tolist() == [0.0, 1.0]


@pytest.mark.parametrize("ulps", range(-6, 1))
def test_a_crossing_that_is_located_within_4_ulp_before_a_tick_joins_it(ulps: int) -> None:
    d = Diagram("ulps")
    crosses, sampler = d.add("crossing", Crosses(at=moved(TICK, ulps))), d.add("sampler", ZeroOrderHold(period=0.1))
    for other in ("event", "input", "tick"):
        d.wire(getattr(crosses, f"of_{other}"), "sampler.y")
    d.wire(sampler.u, crosses.n)
    results = d.run(stop=0.35)
    (event,) = results.events
    if ulps >= -4:
        assert event.t == TICK
        assert results.statistics.instants == 5
    else:  # it is located to 4 ulp, and may still fall into the tick's reach
        assert moved(TICK, ulps) <= event.t <= TICK
    assert results["sampler.y"][results.t == TICK].tolist()[-1] == 1.0, "it comes before the tick in any case"


@pytest.mark.parametrize("rises", [True, False], ids=["rises", "falls"])
@pytest.mark.parametrize("of", ["time", "input", "delay"])
def test_a_relay_of_what_is_time_alone_switches_with_the_tick_or_the_stop_that_its_crossing_joins(
    of: str, rises: bool
) -> None:
    """u = t or -t comes to the edge some ulp before, at or after TICK: what the crossing saw, its reset sees too."""
    slope, past = 1.0 if rises else -1.0, 0.05 if of == "delay" else 0.0
    d = Diagram("switched")
    relay, hold = d.add("relay", Relay(on=1.0, off=0.0)), d.add("hold", ZeroOrderHold(period=0.1))
    u = d.input("u") if of == "input" else d.add("ramp", Ramp(slope=slope)).y
    if past:
        delay = d.add("delay", TransportDelay(delay=past))
        d.wire(delay.u, u)
        u = delay.y
    d.wire(relay.u, u)
    d.wire(hold.u, relay.y)
    inputs = {"u": ([0.0, 1.0], [0.0, slope], "linear")} if of == "input" else {}
    for ulps, width in itertools.product((-3, 0, 3, 7), (0.1, 0.0)):
        edge = slope * (moved(TICK, ulps) - past)
        edges = {"relay.on_at": edge, "relay.off_at": edge - width} if rises else {
            "relay.on_at": edge + width, "relay.off_at": edge
        }  # fmt: skip
        before, after = (0.0, 1.0) if rises else (1.0, 0.0)
        for stop in (TICK, 0.35):
            results = d.run(start=0.15, stop=stop, method="rk4", step=0.05, inputs=inputs, parameters=edges)
            switched = after if ulps <= 3 else before
            assert results["relay.y"][results.t == TICK].tolist()[-1] == switched, (ulps, width, stop)
            assert results["hold.y"][-1] == switched, (ulps, width, stop)
            assert results["relay.y"][-1] == (switched if stop == TICK else after), (ulps, width, stop)
            assert len(results.events) == (1 if stop > TICK or ulps <= 3 else 0), (ulps, width, stop)


@pytest.mark.parametrize("rises", [True, False], ids=["rises", "falls"])
def test_a_relay_of_a_sine_is_right_at_every_tick_and_stop_beside_which_the_sine_is_zero(rises: bool) -> None:
    """sin(10 pi t) comes to 0 at every k/10, to within some ulp: there the relay has just switched, or has not yet."""
    d, on_at, off_at = Diagram("sine"), 0.0 if rises else 0.001, -0.001 if rises else 0.0
    relay, expected = d.add("relay", Relay(on_at=on_at, off_at=off_at)), 1.0 if rises else -1.0
    d.wire(relay.u, d.add("sine", Sine(omega=10 * math.pi)).y)
    run = d.start(stop=6.0)
    for k in range(1, 60):
        run.advance_to(k / 10)
        assert run["relay.y"] == expected, k
    d.wire(d.add("hold", ZeroOrderHold(period=0.1)).u, relay.y)
    assert set(d.run(stop=2.05)["hold.y"].tolist()) == {expected}


def test_two_events_some_ulp_apart_are_one_instant_and_each_has_its_own_time() -> None:
    d = Diagram("ulps")
    first, second, third = (moved(TICK, n) for n in (0, 3, 6))
    for key, at in (("c", third), ("b", second), ("a", first)):
        d.add(key, Timed(at=at))
    results = d.run(stop=0.35)
    # The third is 6 ulp after the first, whose instant it is; it comes by itself.
    assert [(event.t, event.block) for event in results.events] == [(first, "b"), (first, "a"), (third, "c")]
    assert [results[f"{key}.seen"][-1] for key in "abc"] == [first, second, third]


# --- many resets at once ---------------------------------------------------------------------------------------


class Two(Block):
    """Two crossings and an event at AT, which all read and write x, y and z."""

    x = State(1.0, output=True)
    y = State(2.0, output=True)
    z = Discrete(3.0, output=True)

    @x.derivative
    @y.derivative
    def rests():
        return 0.0

    @crossing(direction="up")
    def one(t):
        return t - AT

    @event_time
    def edge(t):
        return np.where(t < AT, AT, np.inf)

    @crossing(direction="down")
    def two(t):
        return AT - t - 1e-300

    @edge.reset(x)
    def x_by_edge(x, y, z):
        return 100.0 * x + 10.0 * y + z

    @two.reset(y)
    def y_by_two(x, y, z):
        return 1000.0 + 100.0 * x + 10.0 * y + z

    @one.reset(y)
    def y_by_one(x, y, z):
        return 2000.0 + 100.0 * x + 10.0 * y + z

    @one.reset(z)
    def z_by_one(x, y, z):
        return 3000.0 + 100.0 * x + 10.0 * y + z


@pytest.mark.parametrize("settings", METHODS, ids=name)
def test_resets_of_one_pass_all_see_the_values_before_and_the_one_declared_later_wins(
    settings: dict[str, Any],
) -> None:
    d = Diagram("two")
    d.add("two", Two())
    d.add("tick", ZeroOrderHold(period=AT))
    d.wire("tick.u", "two.y")
    results = d.run(stop=1.0, **settings)
    assert [event.what for event in results.events] == ["one", "edge", "two"]
    assert {event.t for event in results.events} == {AT}
    assert results["two.x"][-1] == 123.0
    assert results["two.y"][-1] == 2123.0, "of the two resets of y, that of `one` stands later in the class"
    assert results["two.z"][-1] == 3123.0
    assert results["tick.y"][results.t == AT].tolist() == [2.0, 2123.0]
