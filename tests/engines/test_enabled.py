"""Subdiagrams that are enabled or triggered: what stands still while they are off, and what they do when they go on."""

import json
import math
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    BouncingBall,
    CompareToConstant,
    Constant,
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
    Results,
    SimulationError,
    Sine,
    SquareWave,
    Sum,
    TransportDelay,
    UnitDelay,
    ZeroOrderHold,
    event_time,
)

TIGHT = {"rtol": 1e-10, "atol": 1e-12}


def inner(**more: Any) -> Diagram:
    """An integrator, a gain, a pulse, a hold and a ball, all on one input."""
    d = Diagram("part")
    u = d.input("u")
    for name, block in {"x": Integrator(), "gain": Gain(k=2.0), "hold": ZeroOrderHold(period=0.1)}.items():
        d.wire(d.add(name, block).u, u)
    pulse = d.add("pulse", Pulse(on=1.5, off=2.3))
    d.add("ball", BouncingBall(h_start=1.0))
    d.output("x", d["x"].y)
    d.output("v", d["gain"].y)
    d.output("held", d["hold"].y)
    d.output("pulse", pulse.y)
    d.output("h", d["ball"].h)
    return d


def enabled(**how: str) -> Diagram:
    """On for 0 <= t < 1 and 2 <= t < 3."""
    d = Diagram("enabled")
    wave, is_on = d.add("wave", SquareWave(period=2.0)), d.add("is_on", CompareToConstant(constant=0.5))
    sine, part = d.add("sine", Sine(omega=3.0)), d.add("part", inner(), enable=how)
    d.wire(is_on.u, wave.y)
    d.wire(part.u, sine.y)
    d.wire(part.enable, is_on.y)
    return d


def value(results: Results, name: str, t: float) -> float:
    """The right value at a recorded time."""
    rows = np.nonzero(results.t == t)[0]
    return float(results[name][rows[-1]])


def integral(t: float) -> float:
    """Of sin 3 t."""
    return (1.0 - math.cos(3.0 * t)) / 3.0


@pytest.mark.parametrize("method", [TIGHT, {"method": "rk4", "step": 0.01}, {"method": "radau", **TIGHT}], ids=str)
def test_states_are_held_while_off(method: dict[str, Any]) -> None:
    results = enabled().run(stop=3.5, every=0.25, **method)
    for t, x in {
        0.5: integral(0.5),
        1.0: integral(1.0),
        1.75: integral(1.0),
        2.0: integral(1.0),
        2.5: integral(1.0) + integral(2.5) - integral(2.0),
        3.25: integral(1.0) + integral(3.0) - integral(2.0),
    }.items():
        assert value(results, "part.x", t) == pytest.approx(x, abs=1e-8)


def test_states_begin_anew_where_they_are_reset() -> None:
    results = enabled(states="reset").run(stop=3.5, every=0.25, **TIGHT)
    for t, x in {1.75: integral(1.0), 2.0: 0.0, 2.5: integral(2.5) - integral(2.0)}.items():
        assert value(results, "part.x", t) == pytest.approx(x, abs=1e-9)
    assert value(results, "part.ball.h", 2.0) == 1.0


def test_outputs_are_held_or_0_while_off() -> None:
    held, reset = enabled().run(stop=3.5, every=0.25), enabled(outputs="reset").run(stop=3.5, every=0.25)
    for t in (1.0, 1.5, 1.75):
        assert value(held, "part.v", t) == pytest.approx(2.0 * math.sin(3.0), abs=1e-12)
        assert [value(reset, f"part.{name}", t) for name in ("x", "v", "held", "h")] == [0.0] * 4
    for t in (0.5, 2.25):
        assert value(held, "part.v", t) == value(reset, "part.v", t) == pytest.approx(2.0 * math.sin(3.0 * t))


def test_ticks_and_crossings_inside_wait() -> None:
    results = enabled().run(stop=3.5, every=0.05)
    assert value(results, "part.held", 1.55) == pytest.approx(math.sin(3.0 * 0.9))  # the tick at 1.0 finds it off
    assert value(results, "part.held", 2.05) == pytest.approx(math.sin(3.0 * 2.0))
    impacts = [event.t for event in results.events if event.block == "part.ball"]
    fall = math.sqrt(2.0 / 9.81)
    assert impacts[0] == pytest.approx(fall, abs=1e-9)
    assert all(not 1.0 < t < 2.0 for t in impacts)
    free = Diagram("free")
    free.add("ball", BouncingBall(h_start=1.0))
    # A second later than a ball that nothing stops.
    others = [event.t for event in free.run(stop=2.0, every=0.05).events]
    late = [t - 1.0 for t in impacts if t > 2.0]
    assert late == pytest.approx([t for t in others if t > 1.0][: len(late)], abs=1e-6)


def test_event_times_that_passed_while_off_are_made_good_for() -> None:
    """The pulse goes on at 1.5, while it is off, and off at 2.3."""
    results = enabled().run(stop=3.5, every=0.1)
    assert [value(results, "part.pulse", t) for t in (0.5, 1.7, 2.0, 2.2, 2.4)] == [0.0, 0.0, 1.0, 1.0, 0.0]
    assert [(event.t, event.what) for event in results.events if event.block == "part.pulse"] == [
        (2.0, "edge"),
        (2.3, "edge"),
    ]


def test_turning_on_and_off_is_told_as_an_event() -> None:
    results = enabled().run(stop=3.5)
    assert [(event.t, event.what) for event in results.events if event.block == "part"] == [
        (1.0, "on"), (2.0, "on"), (3.0, "on"),
    ]  # fmt: skip


def test_what_is_off_at_the_start_waits_with_its_start_values() -> None:
    d = Diagram("late")
    pulse, is_on = d.add("pulse", Pulse(on=1.0, off=9.0)), d.add("is_on", CompareToConstant(constant=0.5))
    one, part = d.add("one", Constant(value=3.0)), d.add("part", inner(), enable={})
    d.wire(is_on.u, pulse.y)
    d.wire(part.u, one.y)
    d.wire(part.enable, is_on.y)
    results = d.run(stop=2.0, every=0.5)
    assert [value(results, "part.x", t) for t in (0.5, 1.0, 1.5)] == pytest.approx([0.0, 0.0, 1.5])


def test_a_subdiagram_within_another_is_on_only_where_both_are() -> None:
    middle = Diagram("middle")
    u, go = middle.input("u"), middle.input("go", type="bool")
    part = middle.add("part", inner(), enable={})
    middle.wire(part.u, u)
    middle.wire(part.enable, go)
    middle.output("x", part.x)
    d = Diagram("nested")
    outer, own = d.add("outer", Pulse(on=0.5, off=2.5)), d.add("own", SquareWave(period=1.0))
    outer_on, own_on = (
        d.add("outer_on", CompareToConstant(constant=0.5)),
        d.add("own_on", CompareToConstant(constant=0.5)),
    )
    one, box = d.add("one", Constant()), d.add("box", middle, enable={})
    d.wire(outer_on.u, outer.y)
    d.wire(own_on.u, own.y)
    d.wire(box.u, one.y)
    d.wire(box.go, own_on.y)
    d.wire(box.enable, outer_on.y)
    results = d.run(stop=4.0, every=0.25)
    # Own: the first half of each second. Both: 1 to 1.5 and 2 to 2.5. What the inner one sees of its own enable stands
    # still too while the outer one is off: it is on at the start.
    assert value(results, "box.x", 0.5) == 0.0
    assert value(results, "box.x", 1.5) == pytest.approx(0.5)
    assert value(results, "box.x", 4.0) == pytest.approx(1.0)


# --- triggers --------------------------------------------------------------------------------------------------


def law() -> Diagram:
    """y = u^2 + t, and how often u rose above 0.5."""
    d = Diagram("law")
    u = d.input("u")
    gain, ramp, total = d.add("gain", Gain(k=10.0)), d.add("ramp", Sine(omega=1.0)), d.add("total", Sum())
    counter = d.add("counter", Counter(threshold=0.5))
    d.wire(gain.u, u)
    d.wire(total.u1, gain.y)
    d.wire(total.u2, ramp.y)
    d.wire(counter.u, u)
    d.output("y", total.y)
    d.output("n", counter.y)
    return d


@pytest.mark.parametrize(("direction", "times"), [("up", [2, 4, 6]), ("down", [1, 3, 5]), ("both", [1, 2, 3, 4, 5, 6])])
def test_a_triggered_subdiagram_computes_at_its_triggers(direction: str, times: list[int]) -> None:
    d = Diagram("triggered")
    sine, ramp = d.add("sine", Sine(omega=math.pi)), d.add("ramp", Ramp())
    part = d.add("part", law(), trigger={"direction": direction})
    d.wire(part.trigger, sine.y)
    d.wire(part.u, ramp.y)
    results = d.run(stop=6.5, every=0.5, jumps=True)
    for t in np.arange(0.5, 6.5, 0.5):
        last = max((at for at in times if at < t), default=0)
        # A trigger that is located lies within some ulp of its time.
        assert value(results, "part.y", t) == pytest.approx(10.0 * last + math.sin(last), abs=1e-9)


def test_a_tick_triggers_too() -> None:
    d = Diagram("ticked")
    ramp, part = d.add("ramp", Ramp()), d.add("part", law(), trigger={"every": 0.3, "offset": 0.1})
    d.wire(part.u, ramp.y)
    results = d.run(stop=1.0, every=0.05)
    for t, last in {0.05: 0.0, 0.1: 0.1, 0.35: 0.1, 0.4: 0.4, 0.95: 0.7, 1.0: 1.0}.items():
        assert value(results, "part.y", t) == pytest.approx(10.0 * last + math.sin(last), abs=1e-12)
    assert value(results, "part.n", 1.0) == 1.0  # at 0.7


# --- files -----------------------------------------------------------------------------------------------------


def test_files_and_python_say_the_same() -> None:
    for d in (enabled(states="reset"), enabled(outputs="reset"), enabled()):
        again = Diagram.from_json(json.loads(json.dumps(d.to_json())))
        assert again.to_json() == d.to_json()
        assert np.array_equal(again.run(stop=3.0)["part.x"], d.run(stop=3.0)["part.x"])


def test_a_run_that_goes_on_from_a_snapshot_is_the_same() -> None:
    d = enabled(states="reset")
    whole = d.run(stop=3.5, stops=[1.5, 2.4])
    run = d.start(stop=3.5, stops=[1.5, 2.4])
    for stop in (1.5, 2.4):
        run.advance_to(stop)
        run = d.start(stop=3.5, stops=[1.5, 2.4], resume=run.snapshot())
    rest = run.finish()
    assert rest["part.x"][-1] == whole["part.x"][-1]
    assert rest["part.h"][-1] == whole["part.h"][-1]


def test_a_part_that_is_always_on_is_as_if_it_were_not_enabled() -> None:
    def made(**how: Any) -> Results:
        d = Diagram("on")
        sine, part, one = d.add("sine", Sine(omega=3.0)), d.add("part", inner(), **how), d.add("one", Constant())
        d.wire(part.u, sine.y)
        if how:
            is_on = d.add("is_on", CompareToConstant(constant=0.5))
            d.wire(is_on.u, one.y)
            d.wire(part.enable, is_on.y)
        return d.run(stop=3.0, method="rk4", step=0.01)

    plain, always = made(), made(enable={})
    for name in ("part.x", "part.v", "part.held", "part.pulse", "part.h"):
        assert np.array_equal(plain[name], always[name])


@pytest.mark.parametrize(
    ("entry", "sentence"),
    [
        ({"enable": {}, "trigger": {"direction": "up"}}, "a subdiagram can be enabled or triggered, but not both"),
        ({"enable": {"states": "kept"}}, 'must be "held" or "reset", not "kept"'),
        ({"enable": True}, "must be an object {...}, not true"),
        ({"enable": {"state": "held"}}, 'the key "state" is not known here'),
        ({"trigger": {}}, 'a trigger needs either "direction" (for a signal) or "every" (for ticks)'),
        ({"trigger": {"direction": "sideways"}}, 'must be "up", "down" or "both", not "sideways"'),
        ({"trigger": {"every": 0.0}}, "must be above 0"),
        ({"enable": {}}, "part.enable: input is not wired"),
    ],
)
def test_what_cannot_be_meant_is_refused(entry: dict[str, Any], sentence: str) -> None:
    document = enabled().to_json()
    del document["blocks"]["part"]["enable"]
    del document["wires"]["part.enable"]
    document["blocks"]["part"] |= entry
    document["run"] = {"stop": 1.0}
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(document).run()
    assert sentence in str(caught.value)


def test_only_subdiagrams_are_enabled() -> None:
    d = Diagram("gain")
    with pytest.raises(ModelError, match="only a subdiagram can be enabled or triggered"):
        d.add("gain", Gain(), enable={})


@pytest.mark.parametrize(
    ("block", "how", "sentence"),
    [
        (
            Integrator(),
            {"trigger": {"every": 0.1}},
            "E121 part.block: has states, but part runs at its triggers",
        ),
        (UnitDelay(period=0.1), {"trigger": {"every": 0.1}}, "has sampled equations, but part runs at"),
        (Pulse(), {"trigger": {"every": 0.1}}, "has event times, but part runs at its triggers only"),
        (TransportDelay(), {"enable": {}}, "is a delay, which would go on recording its input while part is off"),
        (Noise(), {"trigger": {"every": 0.1}}, "has sampled equations"),
    ],
)
def test_what_has_a_time_of_its_own_is_refused_inside(block: Any, how: dict[str, Any], sentence: str) -> None:
    part = Diagram("part")
    u = part.input("u", default=0.0)
    made = part.add("block", block)
    if any(isinstance(v, Input) for v in type(block).declaration.inputs.values()):
        part.wire(made.u, u)
    d = Diagram("outer")
    handle = d.add("part", part, **how)
    if "enable" in how:
        d.wire(handle.enable, d.input("on", type="bool", default=True))
    with pytest.raises(ModelError) as caught:
        d.run(stop=1.0)
    assert sentence in str(caught.value)


def test_the_drawing_shows_what_enables() -> None:
    assert ">enable<" in enabled().draw()


def test_an_inner_part_waits_while_the_outer_one_is_off() -> None:
    """The inner one is enabled throughout; the outer one is off for 1 <= t < 2."""
    middle = Diagram("middle")
    u, go = middle.input("u"), middle.input("go", type="bool")
    part = middle.add("part", inner(), enable={})
    middle.wire(part.u, u)
    middle.wire(part.enable, go)
    for name in ("x", "held", "pulse"):
        middle.output(name, part.__getattr__(name))
    own = middle.add("own", Integrator())
    middle.wire(own.u, u)
    middle.output("own_x", own.y)
    d = Diagram("outer")
    off, is_on, ramp = (
        d.add("off", Pulse(height=-1.0, on=1.0, off=2.0)),
        d.add("is_on", CompareToConstant(constant=-0.5)),
        d.add("ramp", Ramp()),
    )
    one, yes = d.add("one", Constant()), d.add("yes", CompareToConstant(constant=0.5))
    box = d.add("box", middle, enable={})
    d.wire(is_on.u, off.y)
    d.wire(yes.u, one.y)
    d.wire(box.enable, is_on.y)
    d.wire(box.go, yes.y)
    d.wire(box.u, ramp.y)
    results = d.run(stop=3.0, every=0.25, **TIGHT)
    for name in ("box.x", "box.own_x"):
        for t, x in {1.0: 0.5, 1.25: 0.5, 1.75: 0.5, 2.0: 0.5, 2.5: 0.5 + (2.5**2 - 4.0) / 2, 3.0: 3.0}.items():
            assert value(results, name, t) == pytest.approx(x, abs=1e-9), (name, t)
    assert value(results, "box.held", 1.5) == pytest.approx(0.9)
    assert [value(results, "box.pulse", t) for t in (1.75, 2.0, 2.25, 2.5)] == [0.0, 1.0, 1.0, 0.0]


@pytest.mark.parametrize(("direction", "count"), [("up", 3), ("down", 2), ("both", 5)])
def test_bools_and_pulses_from_0_to_1_trigger(direction: str, count: int) -> None:
    for through_bool in (False, True):
        d = Diagram("pulses")
        wave, ramp = d.add("wave", SquareWave(period=2.0, at=0.5)), d.add("ramp", Ramp())
        part = d.add("part", law(), trigger={"direction": direction})
        source = wave
        if through_bool:
            source = d.add("is_on", CompareToConstant(constant=0.5))
            d.wire(source.u, wave.y)
        d.wire(part.trigger, source.y)
        d.wire(part.u, ramp.y)
        results = d.run(stop=5.0)
        assert len([event for event in results.events if event.block == "part"]) == count


def test_an_event_time_that_does_not_advance_is_an_error_there_too() -> None:
    class Stuck(Block):
        """An event time that stays at 1."""

        n = Discrete(output=True)

        @event_time
        def edge(n):  # type: ignore[no-untyped-def]
            return 1.0 + 0.0 * n

        @edge.reset(n)
        def counted(n):  # type: ignore[no-untyped-def]
            return n + 1.0

    part = Diagram("part")
    part.add("stuck", Stuck())
    d = Diagram("outer")
    pulse, is_on = d.add("pulse", Pulse(on=2.0, off=9.0)), d.add("is_on", CompareToConstant(constant=0.5))
    box = d.add("box", part, enable={})
    d.wire(is_on.u, pulse.y)
    d.wire(box.enable, is_on.y)
    with pytest.raises(
        SimulationError, match=r"E306 box\.stuck\.edge: returned 1\.0 as the next instant after t = 1\.0 s"
    ):
        d.run(stop=3.0)
