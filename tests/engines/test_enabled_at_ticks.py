"""Subdiagrams that a tick switches on or off: all of them does at that instant as if an event time switched it."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    CompareToConstant,
    Counter,
    Diagram,
    Discrete,
    Gain,
    Input,
    Integrator,
    ModelError,
    Noise,
    Pulse,
    Ramp,
    Relay,
    Results,
    SquareWave,
    Stepped,
    Sum,
    UnitDelay,
    ZeroOrderHold,
    output,
    stepper,
)
from blocks.compile.c.lane_code import Machine
from blocks.compile.toolchain.compiler import find_compiler
from blocks.library import LIBRARY
from tests.support.fmus import exported
from tests.support.library_variants import VARIANTS, resolved

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")

ENGINES = ("native", "reference")
FIXED: dict[str, Any] = {"method": "rk4", "step": 0.05, "every": 0.05}
HOW = [{"states": how, "outputs": how} for how in ("held", "reset")]


class Tally(Block):
    """A program that counts its ticks and adds up what it sees at them."""

    u = Input()
    y = Stepped()

    @stepper(every=0.1)
    def program():  # type: ignore[no-untyped-def]
        return _Tally()


class _Tally:
    def __init__(self) -> None:
        self.total = 0.0

    def step(self, t: float, u: float) -> float:
        self.total += 1.0 + u
        return self.total

    def save(self) -> float:
        return self.total

    def restore(self, value: float) -> None:
        self.total = value


class Count(Block):
    """How many ticks it has had, known after each."""

    n = Discrete(output=True, visible="after")

    @n.next(every=0.1)
    def counted(n):  # type: ignore[no-untyped-def]
        return n + 1.0


class Kept(Block):
    """The input at the last tick, known after it; no sampled output ticks with it."""

    u = Input()
    x = Discrete(output=True, visible="after")

    @x.next(every=0.1)
    def kept(u):  # type: ignore[no-untyped-def]
        return u


class TimeAtTick(Block):
    """The time at the last tick."""

    @output(every=0.1)
    def y(t):  # type: ignore[no-untyped-def]
        return t


def switched(part: Diagram, by: str, how: dict[str, str], seen: list[str]) -> Diagram:
    """A part that is on for 0.2 <= t < 0.6, 1.0 <= t < 1.4, ...

    by: what switches it, "event" (an event time) or "tick". seen: outputs that holds outside see at the same ticks.
    """
    d = Diagram("switched")
    wave, is_on = d.add("wave", SquareWave(period=0.8, at=0.2)), d.add("is_on", CompareToConstant(constant=0.5))
    hold = d.add("hold", ZeroOrderHold(period=0.2))
    d.wire(hold.u, wave.y)
    d.wire(is_on.u, hold.y if by == "tick" else wave.y)
    box = d.add("box", part, enable=how)
    d.wire(box.enable, is_on.y)
    for name, shape, _, kind, _ in part.plan().inputs:
        d.wire(f"box.{name}", d.input(name, type=kind, size=shape[0] if shape else None))
    for name in seen:
        d.wire(d.add(f"{name}_seen", ZeroOrderHold(period=0.1)).u, f"box.{name}")
    return d


def series(part: Diagram, stop: float) -> dict[str, Any]:
    """Inputs over time: real ones on lines, others held, all of them other values at each tick."""
    rng, t = np.random.default_rng(1), np.arange(0.0, stop + 0.05, 0.1)
    made: dict[str, Any] = {}
    for name, shape, _, kind, _ in part.plan().inputs:
        values = rng.uniform(0.1, 0.9, (len(t), *shape)) if kind == "real" else rng.integers(0, 2, (len(t), *shape))
        made[name] = (t, values.astype(bool) if kind == "bool" else values, "linear" if kind == "real" else "hold")
    return made


def assert_as_by_an_event_time(part: Diagram, how: dict[str, str], seen: list[str], stop: float = 1.7) -> Results:
    """All in a part, and all that holds outside see of it, to the last bit and with the same events, by each engine."""
    names = [f"box.{name}" for name in part.value.outputs] + [f"{name}_seen.y" for name in seen]
    inputs = series(part, stop)
    for engine in ENGINES:
        results, expected = (
            switched(part, by, how, seen).run(engine=engine, log=names, inputs=inputs, stop=stop, **FIXED)
            for by in ("tick", "event")
        )
        for name in names:
            assert np.array_equal(results[name], expected[name]), (name, engine)
        events, others = (
            [(e.t, e.block, e.what) for e in found.events if e.block.startswith("box")] for found in (results, expected)
        )
        assert events == others
        assert len([event for event in events if event[1] == "box"]) == 4
    return results


def library() -> tuple[Diagram, list[str]]:
    """All sampled blocks of the library in all their forms, and the outputs that a hold can see."""
    part, seen = Diagram("sampled"), []
    for number, (name, given) in enumerate(VARIANTS):
        made = resolved(name, given)
        if not made.clocks:
            continue
        block = f"{name}_{number}"
        part.add(block, LIBRARY[name](**given))
        for port, what in made.interface.inputs.items():
            entering = part.input(f"{block}_{port}", type=what.type, size=what.size if what.shape else None)
            part.wire(f"{block}.{port}", entering)
        for port, what in made.interface.outputs.items():
            part.output(f"{block}_{port}_out", f"{block}.{port}")
            if what.type == "real" and not what.shape:
                seen.append(f"{block}_{port}_out")
    return part, seen


@pytest.mark.parametrize("how", HOW, ids=str)
def test_every_sampled_block_is_switched_by_a_tick_as_by_an_event_time(how: dict[str, str]) -> None:
    part, seen = library()
    assert len(part.value.blocks) > 40
    assert_as_by_an_event_time(part, how, seen)


def inner(few: bool = False) -> Diagram:
    """Of each kind that waits: discretes, time, noise, states, and, unless these are few, a program and sides."""
    d = Diagram("inner")
    u = d.input("u")
    fed: dict[str, Block] = {"x": Integrator(), "d": UnitDelay(period=0.1)}
    if not few:
        fed |= {"tally": Tally(), "relay": Relay(on_at=0.6, off_at=0.4)}
    for name, block in fed.items():
        d.wire(d.add(name, block).u, u)
        d.output(name, f"{name}.y")
    d.wire(d.add("x_held", ZeroOrderHold(period=0.1)).u, "x.y")
    d.wire(d.add("side_held", ZeroOrderHold(period=0.1)).u, "d.y" if few else "relay.y")
    for name, block in {"count": Count(), "clock": TimeAtTick(), "noise": Noise(period=0.1)}.items():
        d.add(name, block)
    for name in ("x_held", "side_held", "clock", "noise"):
        d.output(name, f"{name}.y")
    d.output("count", "count.n")
    return d


def nested() -> Diagram:
    """A part, another one in it that a tick inside switches, and parts that ticks and a rising signal trigger."""
    d = inner()
    u = "u"
    d.wire(d.add("level", ZeroOrderHold(period=0.1)).u, u)
    d.wire(d.add("is_high", CompareToConstant(constant=0.45)).u, "level.y")
    d.wire(d.add("deep", inner(), enable={"states": "reset"}).u, u)
    d.wire("deep.enable", "is_high.y")
    triggered = Diagram("triggered")
    entering = triggered.input("u")
    triggered.wire(triggered.add("gain", Gain(k=2.0)).u, entering)
    triggered.wire(triggered.add("counter", Counter(threshold=0.5)).u, entering)
    triggered.output("y", "gain.y")
    triggered.output("n", "counter.y")
    d.wire(d.add("each_tick", triggered, trigger={"every": 0.1}).u, u)
    d.wire(d.add("rising", triggered, trigger={"direction": "up"}).u, u)
    d.wire(d.add("shifted", Sum(signs="+-")).u1, "level.y")
    d.wire("shifted.u2", u)
    d.wire("rising.trigger", "shifted.y")
    for name in ("each_tick", "rising"):
        d.output(f"{name}_y", f"{name}.y")
        d.output(f"{name}_n", f"{name}.n")
    for name in inner().value.outputs:
        d.output(f"deep_{name}", f"deep.{name}")
    return d


@pytest.mark.parametrize("how", HOW, ids=str)
def test_all_that_waits_in_parts_within_parts_is_switched_by_a_tick_as_by_an_event_time(how: dict[str, str]) -> None:
    part = nested()
    results = assert_as_by_an_event_time(part, how, [*part.value.outputs])
    assert len({event.block for event in results.events}) > 3


# --- closed forms ------------------------------------------------------------------------------------------------


def seen_at(results: Results, name: str, t: float) -> float:
    """The right value."""
    return float(results[name][np.nonzero(np.abs(results.t - t) < 1e-9)[0][-1]])


@pytest.mark.parametrize("engine", ENGINES)
def test_a_part_that_a_tick_switches_off_does_not_tick_then_and_one_that_it_switches_on_does(engine: str) -> None:
    """Its states, discretes and programs are as old as the time when it went off."""
    part = inner()
    results = switched(part, "tick", {}, []).run(
        engine=engine, stop=1.1, log=[f"box.{name}" for name in part.value.outputs], inputs={"u": 1.0}, **FIXED
    )
    # It is on from 0.2 to 0.6: four ticks, of which the first is at 0.2; then from 1.0 on.
    assert [seen_at(results, "box.count", t) for t in (0.15, 0.25, 0.55, 0.65, 0.95, 1.05)] == [0, 1, 4, 4, 4, 5]
    assert [seen_at(results, "box.tally", t) for t in (0.15, 0.25, 0.55, 0.65, 0.95, 1.05)] == [0, 2, 8, 8, 8, 10]
    held = [seen_at(results, "box.x_held", t) for t in (0.25, 0.55, 0.65, 0.95, 1.05)]
    assert held == pytest.approx([0.0, 0.3, 0.3, 0.3, 0.4])
    clock = [seen_at(results, "box.clock", t) for t in (0.25, 0.55, 0.65, 0.95, 1.05)]
    assert clock == pytest.approx([0.2, 0.5, 0.5, 0.5, 1.0])
    noise = [seen_at(results, "box.noise", t) for t in (0.15, 0.25, 0.55, 0.65, 0.95, 1.05)]
    assert len(set(noise)) == 4
    assert noise[2:5] == [noise[2]] * 3


@pytest.mark.parametrize("engine", ENGINES)
def test_a_sampled_output_outside_sees_what_a_part_that_is_off_holds(engine: str) -> None:
    """Not what its equation would give by the input that was kept: 0.25."""
    part = Diagram("part")
    part.wire(part.add("hold", ZeroOrderHold(period=0.1)).u, part.input("u"))
    part.output("y", "hold.y")
    d = Diagram("outside")
    d.wire(d.add("is_on", CompareToConstant(constant=0.5)).u, d.add("pulse", Pulse(on=0.0, off=0.25)).y)
    d.wire(d.add("box", part, enable={}).u, d.add("ramp", Ramp()).y)
    d.wire("box.enable", "is_on.y")
    d.wire(d.add("seen", ZeroOrderHold(period=0.1)).u, "box.y")
    results = d.run(engine=engine, stop=0.5, log=["box.y", "seen.y"], **FIXED)
    for name in ("box.y", "seen.y"):
        assert [seen_at(results, name, t) for t in (0.2, 0.3, 0.45)] == [0.2, 0.2, 0.2]


def in_a_circle(period: float) -> Diagram:
    """A part whose enable depends on its own sampled output, by a hold outside: on while that has not seen 0.45."""
    part = inner()
    part.wire(part.add("hold", ZeroOrderHold(period=0.1)).u, "u")
    part.output("y", "hold.y")
    d = Diagram("circle")
    d.wire(d.add("box", part, enable={}).u, d.add("ramp", Ramp()).y)
    d.wire(d.add("seen", ZeroOrderHold(period=period)).u, "box.y")
    d.wire(d.add("is_low", CompareToConstant(constant=0.45, operator="<")).u, "seen.y")
    d.wire("box.enable", "is_low.y")
    return d


@pytest.mark.parametrize("engine", ENGINES)
def test_in_a_circle_what_the_switch_sees_ticks_before_it_and_all_else_in_the_part_after_it(engine: str) -> None:
    names = ["seen.y", "box.y", "box.tally", "box.count"]
    results = in_a_circle(0.1).run(engine=engine, stop=0.9, log=names, **FIXED)
    # At 0.5 the part gives 0.5, the hold outside sees it, and the part goes off before the rest in it would tick.
    assert [seen_at(results, "box.y", t) for t in (0.45, 0.5, 0.85)] == [0.4, 0.5, 0.5]
    assert [seen_at(results, "seen.y", t) for t in (0.45, 0.5, 0.85)] == [0.4, 0.5, 0.5]
    assert seen_at(results, "box.tally", 0.85) == pytest.approx(5.0 + 0.1 + 0.2 + 0.3 + 0.4)
    assert seen_at(results, "box.count", 0.85) == 5


@pytest.mark.parametrize("engine", ENGINES)
def test_a_circle_is_one_only_at_ticks_at_which_all_of_it_is_due(engine: str) -> None:
    """What switches the part sees it by a hold of 0.3 s: at 0.4 there is no circle, at 0.6 there is."""
    for off, last in ((0.35, 0.3), (0.55, 0.6)):
        part = Diagram("part")
        part.wire(part.add("hold", ZeroOrderHold(period=0.1)).u, part.input("u"))
        part.output("y", "hold.y")
        d = Diagram("circle")
        d.wire(d.add("box", part, enable={}).u, d.add("ramp", Ramp()).y)
        d.wire(d.add("back", ZeroOrderHold(period=0.3)).u, "box.y")
        d.wire(d.add("less", Sum(signs="+-")).u1, d.add("pulse", Pulse(on=0.15, off=off, height=2.0)).y)
        d.wire("less.u2", "back.y")
        d.wire(d.add("switch", ZeroOrderHold(period=0.2)).u, "less.y")
        d.wire(d.add("is_on", CompareToConstant(constant=0.5)).u, "switch.y")
        d.wire("box.enable", "is_on.y")
        results = d.run(engine=engine, stop=0.75, log=["box.y"], **FIXED)
        assert seen_at(results, "box.y", 0.2) == pytest.approx(0.2)  # it goes on, without a circle
        assert seen_at(results, "box.y", 0.7) == pytest.approx(last)


@pytest.mark.parametrize("engine", ENGINES)
def test_discretes_see_what_the_output_of_a_program_moves(engine: str) -> None:
    """As where a sampled output moves it, and whether or not one ticks beside it."""
    d = Diagram("program")
    d.wire(d.add("tally", Tally()).u, d.add("ramp", Ramp()).y)
    d.wire(d.add("relay", Relay(on_at=3.05, off_at=0.0, off=0.0)).u, "tally.y")
    d.wire(d.add("kept", Kept()).u, "relay.y")
    results = d.run(engine=engine, stop=0.35, log=["tally.y", "kept.x"], **FIXED)
    assert [seen_at(results, "tally.y", t) for t in (0.1, 0.2)] == pytest.approx([2.1, 3.3])
    assert [seen_at(results, "kept.x", t) for t in (0.1, 0.2)] == [0.0, 1.0]


def test_a_loop_at_a_tick_that_passes_the_edge_of_a_part_is_refused() -> None:
    """It is a loop only while the part is on."""

    class Half(Block):
        """y = 0.5 u + 1."""

        u = Input()

        @output(every=0.1)
        def y(u):  # type: ignore[no-untyped-def]
            return 0.5 * u + 1.0

    part = Diagram("part")
    part.wire(part.add("half", Half()).u, part.input("u"))
    part.output("y", "half.y")
    d = Diagram("loop")
    d.wire(d.add("is_on", CompareToConstant(constant=0.5)).u, d.add("pulse", Pulse(on=0.25, off=0.45)).y)
    box, half = d.add("box", part, enable={}), d.add("half", Half())
    d.wire("box.enable", "is_on.y")
    d.wire(box.u, half.y)
    d.wire(half.u, box.y)
    with pytest.raises(
        ModelError, match=r"E102 (box\.)?half: is in an algebraic loop at one tick that crosses the border"
    ):
        d.plan(loops="solve")


# --- all kinds of runs -------------------------------------------------------------------------------------------


NAMES = ["box.x", "box.x_held", "box.d", "box.clock", "box.count", "box.noise", "x_held_seen.y", "noise_seen.y"]


def by_a_tick(*, few: bool = False) -> Diagram:
    d = switched(inner(few), "tick", {"states": "reset"}, ["x_held", "noise"])
    d.settings(inputs={"u": 0.5}, log=NAMES, stop=1.65, **FIXED)
    return d


def last(results: Results) -> list[float]:
    return [float(results[name][-1]) for name in NAMES]


@pytest.mark.parametrize("engine", ENGINES)
def test_prepared_and_resumed_runs_are_switched_alike(engine: str) -> None:
    d, stops = by_a_tick(), [0.2, 0.6, 1.3]
    expected = last(d.run(stops=stops, engine=engine))
    prepared = d.prepare(engine=engine)
    assert last(prepared.run(parameters={"wave.period": 0.4}, stops=stops)) != expected
    assert last(prepared.run(stops=stops)) == expected
    run = d.start(stops=stops, engine=engine)
    for stop in stops:
        run.advance_to(stop)
        run = d.start(stops=stops, resume=run.snapshot(), engine=engine)
    assert last(run.finish()) == expected


@pytest.mark.parametrize("lanes", ["exact", "fast"])
def test_rows_of_a_batch_are_switched_as_single_runs(lanes: str) -> None:
    d = by_a_tick(few=True)
    batch = d.batch(["wave.at"], lanes=lanes, log=NAMES, measures=[], engine="native")
    assert lanes == "exact" or batch.lanes or Machine.own() is None
    table = [[0.2], [0.1], [0.4], [0.3], [0.2]]
    rows = batch(table)
    for k, (at,) in enumerate(table):
        single = d.run(parameters={"wave.at": at}, engine="native")
        for name in NAMES:
            assert np.allclose(rows.signals[name][k], single[name], rtol=0, atol=1e-13), (name, at)


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_exported_part_is_switched_as_in_a_run(fmi: int) -> None:
    d = by_a_tick(few=True)
    for name in NAMES:
        d.output(name.replace(".", "_"), name)
    settings = {"method": "rk4", "step": 0.05}
    run = d.start(stop=1.65, inputs={"u": 0.5}, log=[], engine="native", **settings)
    with exported(d, fmi, log=[], **settings).instance() as one:
        one.begin({"u": 0.5}, stop=1.65)
        for k in range(33):
            one.step(k / 20, 0.05)
            run.advance_to(Fraction(k + 1, 20))
            for name in NAMES:
                name = name.replace(".", "_")
                assert one[name] == run[name], (name, run.t)
