"""Crossings that signals come near to, touch within one step or stay away from: which of them steps look at closely
changes nothing."""

import math
import random
from typing import Any

import pytest

from blocks import (
    CompareToConstant,
    Constant,
    Counter,
    Diagram,
    Expression,
    Integrator,
    Quantizer,
    Relay,
    Results,
    Saturation,
    SecondOrder,
    Sine,
    Sum,
    ZeroOrderHold,
)

STOP = 12.0
METHODS: list[dict[str, Any]] = [{"method": "rk4", "step": 0.02}, {"method": "dopri5", "rtol": 1e-8, "atol": 1e-10}]


def oscillators(count: int, seed: int) -> tuple[Diagram, list[tuple[str, int]]]:
    """Each y = cos(w t + phase) before a threshold that is near 1, above or below; how often each passes it upwards
    and downwards."""
    source = random.Random(seed)
    diagram, expected = Diagram("oscillators"), []
    diagram.add("zero", Constant(value=0.0))
    for k in range(count):
        w, phase = source.uniform(2.0, 4.0), source.uniform(0.5, 2.5)
        beyond = source.choice((-1.0, 1.0)) * 10.0 ** source.uniform(-4.0, -0.5)
        start = {"y_start": math.cos(phase), "v_start": -w * math.sin(phase)}
        diagram.add(f"plant{k}", SecondOrder(w=w, d=0.0, **start))
        diagram.add(f"limit{k}", Saturation(lower=-10.0, upper=1.0 - beyond))
        diagram.wire(f"plant{k}.u", "zero.y")
        diagram.wire(f"limit{k}.u", f"plant{k}.y")
        passes = 0
        if beyond > 0.0:
            width = math.acos(1.0 - beyond)
            turns = [2.0 * math.pi * n + side * width for n in range(1, 20) for side in (-1.0, 1.0)]
            passes = sum(phase < angle < w * STOP + phase for angle in turns)
        expected.append((f"limit{k}", passes))
    return diagram, expected


def fired(results: Results) -> list[tuple[float, str]]:
    return sorted((event.t, event.block) for event in results.events)


@pytest.mark.parametrize("settings", METHODS, ids=lambda settings: str(settings["method"]))
@pytest.mark.parametrize("count", [1, 3, 5, 60])
def test_each_threshold_is_passed_as_often_as_the_cosine_does(count: int, settings: dict[str, Any]) -> None:
    for seed in range(4):
        diagram, expected = oscillators(count, seed)
        results = diagram.run(stop=STOP, every=0.5, engine="native", **settings)
        blocks = [event.block for event in results.events]
        assert [(name, blocks.count(name)) for name, _ in expected] == expected


def loops(count: int, seed: int) -> Diagram:
    """Oscillators that push each other through relays, limits and steps, some of them sampled."""
    source = random.Random(seed)
    diagram = Diagram("loops")
    for k in range(count):
        before = f"plant{(5 * k + 1) % count}.y"
        shape: Any = source.choice(
            (
                Relay(on_at=0.3, off_at=-0.2, on=-0.5, off=0.5),
                Saturation(lower=-0.4, upper=0.7),
                Quantizer(interval=source.uniform(0.3, 0.6)),
            )
        )
        diagram.add(f"shape{k}", shape)
        diagram.wire(f"shape{k}.u", before)
        last = f"shape{k}.y"
        if source.random() < 0.3:
            diagram.add(f"hold{k}", ZeroOrderHold(period=0.05))
            diagram.wire(f"hold{k}.u", last)
            last = f"hold{k}.y"
        diagram.add(f"sum{k}", Sum(signs="+-"))
        diagram.add(f"slow{k}", Integrator(y_start=source.uniform(-0.1, 0.1)))
        diagram.add(f"plant{k}", SecondOrder(w=source.uniform(1.5, 3.0), d=0.05, y_start=source.uniform(-1.0, 1.0)))
        diagram.wire(f"sum{k}.u1", last)
        diagram.wire(f"sum{k}.u2", f"slow{k}.y")
        diagram.wire(f"slow{k}.u", f"plant{k}.y")
        diagram.wire(f"plant{k}.u", f"sum{k}.y")
    return diagram


@pytest.mark.parametrize("count", [2, 12])
def test_both_engines_see_the_same_crossings(count: int) -> None:
    for seed in range(4):
        diagram = loops(count, seed)
        settings: dict[str, Any] = {"stop": 4.0, "every": 0.5, "method": "rk4", "step": 0.01}
        native = fired(diagram.run(engine="native", **settings))
        reference = fired(diagram.run(engine="reference", **settings))
        assert len(native) > 3
        assert [block for _, block in native] == [block for _, block in reference]
        assert [t for t, _ in native] == pytest.approx([t for t, _ in reference], abs=1e-9)


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_two_sides_that_change_at_a_tick_and_just_behind_it_change_in_one_instant(engine: str) -> None:
    """At t = 1 one comparison turns, the other is 0 and turns as t goes on; the tick there sees both."""
    d = Diagram("two")
    d.wire(d.add("first", CompareToConstant(operator="<", constant=1.0)).u, d.add("t", Expression(expression="t")).y)
    hill = d.add("hill", Expression(expression="(t-0.6)*(1-t)"))
    d.wire(d.add("second", CompareToConstant(constant=0.0)).u, hill.y)
    d.wire(d.add("held", ZeroOrderHold(period=0.1)).u, "second.y")
    results = d.run(stop=1.5, every=0.05, method="rk4", step=0.01, engine=engine)
    assert [(event.t, event.block) for event in results.events if event.t > 0.9] == [(1.0, "first"), (1.0, "second")]
    assert results["held.y"][results.t == 1.0].tolist() == [0.0]


@pytest.mark.parametrize("engine", ["reference", "native"])
@pytest.mark.parametrize(
    "settings",
    [{"method": "rk4", "step": 0.01}, {"method": "euler", "step": 0.03}, {"method": "dopri5"}],
    ids=["rk4", "euler", "dopri5"],
)
def test_a_pause_some_ulp_from_a_crossing_fires_it_once(settings: dict[str, Any], engine: str) -> None:
    d = Diagram("paused")
    wave = d.add("wave", Sine(omega=math.pi))
    for name, block in (("relay", Relay(on_at=0.0, off_at=0.0)), ("counter", Counter(threshold=0.0))):
        d.wire(d.add(name, block).u, wave.y)
    d.wire(d.add("integral", Integrator()).u, wave.y)
    expected = d.run(stop=5.5, engine=engine, **settings).events
    assert len(expected) == 7
    for ulps in range(-6, 7):
        run = d.start(stop=5.5, engine=engine, **settings)
        for event in expected:
            pause = event.t + ulps * math.ulp(event.t)
            if pause > run.t:
                run.advance_to(pause)
        events = run.finish().events
        assert [event.block for event in events] == [event.block for event in expected], ulps
        assert [event.t for event in events] == pytest.approx([event.t for event in expected], rel=1e-14), ulps
