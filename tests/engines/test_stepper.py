"""Steppers: programs in plain Python that own their state, at their ticks."""

import math
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    CompareToConstant,
    Constant,
    DeclarationError,
    Diagram,
    Gain,
    Input,
    Integrator,
    ModelError,
    Parameter,
    Pulse,
    Ramp,
    SimulationError,
    Sine,
    Stepped,
    Sum,
    UnitDelay,
    UsageError,
    ZeroOrderHold,
    output,
    stepper,
)
from blocks.compile.toolchain.compiler import find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")


class Averager:
    """The mean of all that it was given: what a controller in C, a network or a driver could be."""

    def __init__(self, weight: float) -> None:
        self.weight, self.total, self.count = weight, 0.0, 0

    def step(self, t: float, u: float) -> float:
        if u > 1e3:
            raise RuntimeError("out of range")
        self.total += u
        self.count += 1
        return self.weight * self.total / self.count

    def save(self) -> list[float]:
        return [self.total, self.count]

    def restore(self, saved: list[float]) -> None:
        self.total, self.count = saved[0], int(saved[1])


class Mean(Block):
    """The mean of u at all ticks up to now."""

    period = Parameter(0.1, unit="s")
    weight = Parameter(1.0)
    u = Input()
    y = Stepped(-1.0, doc="mean")

    @stepper(every=period)
    def program(weight):  # type: ignore[no-untyped-def]
        return Averager(weight)

    @output
    def twice(y):  # type: ignore[no-untyped-def]
        return 2.0 * y


def mean_of(source: Any, **parameters: Any) -> Diagram:
    d = Diagram("mean")
    made, driver = d.add("mean", Mean(**parameters)), d.add("driver", source)
    d.wire(made.u, driver.y)
    return d


def value(results: Any, name: str, t: float) -> float:
    return float(results[name][np.nonzero(results.t == t)[0][-1]])


def test_a_program_is_called_once_at_each_tick() -> None:
    results = mean_of(Ramp(), weight=2.0).run(stop=1.0, every=0.05)
    for k in range(11):
        assert value(results, "mean.y", k / 10) == pytest.approx(2.0 * np.mean(np.arange(k + 1) / 10.0), rel=1e-14)
    assert value(results, "mean.y", 0.15) == value(results, "mean.y", 0.1)
    assert value(results, "mean.twice", 0.5) == 2.0 * value(results, "mean.y", 0.5)


def test_each_run_has_a_program_of_its_own() -> None:
    d = mean_of(Sine())
    assert d.run(stop=1.0)["mean.y"].tolist() == d.run(stop=1.0)["mean.y"].tolist()


def test_before_the_first_tick_the_outputs_are_at_their_start() -> None:
    class Late(Block):
        """Begins at 0.5 s."""

        u = Input()
        y = Stepped(-1.0)

        @stepper(every=1.0, offset=0.5)
        def program():  # type: ignore[no-untyped-def]
            return Averager(1.0)

    d = Diagram("late")
    late, one = d.add("late", Late()), d.add("one", Constant(value=3.0))
    d.wire(late.u, one.y)
    results = d.run(stop=1.0, every=0.25)
    assert [value(results, "late.y", t) for t in (0.0, 0.25, 0.5, 0.75)] == [-1.0, -1.0, 3.0, 3.0]


def test_it_stands_in_the_order_of_the_tick() -> None:
    """hold -> mean -> hold, all at one tick: nothing is late by a tick."""
    d = Diagram("order")
    ramp, first, second = (
        d.add("ramp", Ramp()),
        d.add("z", ZeroOrderHold(period=0.1)),
        d.add("a", ZeroOrderHold(period=0.1)),
    )
    mean, gain = d.add("mean", Mean()), d.add("gain", Gain(k=3.0))
    d.wire(first.u, ramp.y)
    d.wire(mean.u, first.y)
    d.wire(gain.u, mean.y)
    d.wire(second.u, gain.y)
    results = d.run(stop=0.5, every=0.1)
    for k in range(6):
        assert value(results, "a.y", k / 10) == pytest.approx(3.0 * np.mean(np.arange(k + 1) / 10.0), rel=1e-14)


def test_a_loop_through_it_is_an_error_and_a_delay_breaks_it() -> None:
    def loop(*blocks: Block) -> Diagram:
        d = Diagram("loop")
        total, one, mean = d.add("total", Sum(signs="+-")), d.add("one", Constant()), d.add("mean", Mean())
        d.wire(total.u1, one.y)
        d.wire(mean.u, total.y)
        last = mean.y
        for k, block in enumerate(blocks):
            made = d.add(f"b{k}", block)
            d.wire(made.u, last)
            last = made.y
        d.wire(total.u2, last)
        return d

    for blocks in ((), (ZeroOrderHold(period=0.1),), (Gain(k=0.5),)):
        with pytest.raises(ModelError, match="E102 mean: its outputs reach its inputs at the same tick"):
            loop(*blocks).run(stop=1.0, loops="solve")
    results = loop(UnitDelay(period=0.1)).run(stop=0.5, every=0.1)
    y, held, total = 0.0, 0.0, 0.0
    for k in range(6):
        delayed, held_next = held, 0.0
        total += 1.0 - delayed
        y = total / (k + 1)
        held_next = y
        assert value(results, "mean.y", k / 10) == pytest.approx(y, rel=1e-14)
        held = held_next


def test_vectors_and_several_outputs() -> None:
    class Program:
        def step(self, t: float, u: Any, v: float) -> dict[str, Any]:
            return {"y": u[::-1] * v, "n": int(t * 10)}

    class Both(Block):
        """y = v u backwards, n = the number of the tick."""

        period = Parameter(0.1, unit="s")
        u = Input(shape=3)
        v = Input()
        y = Stepped(shape=3, ports="y{}")
        n = Stepped(0, type="int")

        @stepper(every=period)
        def program():  # type: ignore[no-untyped-def]
            return Program()

    d = Diagram("both")
    both, ramp = d.add("both", Both()), d.add("ramp", Ramp())
    for k in range(3):
        constant = d.add(f"c{k}", Constant(value=float(k)))
        d.wire(f"both.u[{k}]", constant.y)
    d.wire(both.v, ramp.y)
    results = d.run(stop=0.5, every=0.25)
    assert [value(results, f"both.y{k}", 0.5) for k in (1, 2, 3)] == [1.0, 0.5, 0.0]
    assert value(results, "both.n", 0.5) == 5.0


def test_a_run_with_a_stepper_is_saved_and_goes_on(tmp_path: Path) -> None:
    d = mean_of(Sine(omega=3.0))
    whole = d.run(stop=2.0, stops=[0.55, 1.3])
    run = d.start(stop=2.0, stops=[0.55, 1.3])
    for stop in (0.55, 1.3):
        run.advance_to(stop)
        run.save(tmp_path / "state")
        run = d.start(stop=2.0, stops=[0.55, 1.3], resume=tmp_path / "state")
    assert run.finish()["mean.y"][-1] == whole["mean.y"][-1]


def with_program(make: Any) -> Diagram:
    class Odd(Block):
        """A program that is not as it should be."""

        u = Input(1.0)
        y = Stepped()

        @stepper(every=0.1)
        def program():  # type: ignore[no-untyped-def]
            return make()

    d = Diagram("odd")
    d.add("odd", Odd())
    return d


def stepping(function: Any) -> Any:
    return type("Program", (), {"step": staticmethod(function)})


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: 1 / 0, "E310 odd: its stepper could not be created: ZeroDivisionError (test_stepper.py:"),
        (lambda: 3.0, "its stepper is 3.0, which has no step(t, **inputs)."),
        (stepping(lambda t, u: {}), "its stepper returned nothing, but its outputs are y."),
        (stepping(lambda t, u: {"x": 1.0}), "its stepper returned x, but its outputs are y."),
        (stepping(lambda t, u: math.nan), "its stepper returned nan for 'y' at t = 0.0 s."),
        (stepping(lambda t, u: [1.0, 2.0]), "its stepper returned [1.0, 2.0] for 'y' at t = 0.0 s."),
        (stepping(lambda t: 1.0), "its stepper raised TypeError at t = 0.0 s: "),
        (
            stepping(lambda t, u: 1.0 if t < 0.25 else 1 / 0),
            "its stepper raised ZeroDivisionError at t = 0.3 s (test_stepper.py:",
        ),
    ],
)
def test_a_program_that_fails_stops_the_run_and_keeps_the_results(make: Any, sentence: str) -> None:
    d = with_program(make)
    d.add("x", Integrator())
    d.wire("x.u", "odd.y")
    with pytest.raises(SimulationError) as caught:
        d.run(stop=1.0)
    assert sentence in str(caught.value)
    if "0.3" in sentence:
        assert 0.2 <= caught.value.results.t[-1] <= 0.3


def test_a_program_that_cannot_be_saved_says_so() -> None:
    run = with_program(stepping(lambda t, u: u)).start(stop=1.0)
    run.advance_to(0.5)
    with pytest.raises(UsageError, match=r"E506 odd: its stepper cannot be saved\. Give its program save\(\)"):
        run.snapshot()


def test_a_stepper_in_a_subdiagram_that_is_off_waits() -> None:
    part = Diagram("part")
    u = part.input("u")
    mean = part.add("mean", Mean())
    part.wire(mean.u, u)
    part.output("y", mean.y)
    d = Diagram("enabled")
    pulse, is_on = d.add("pulse", Pulse(on=0.45, off=0.75)), d.add("is_on", CompareToConstant(constant=0.5))
    ramp, box = d.add("ramp", Ramp()), d.add("box", part, enable={})
    d.wire(is_on.u, pulse.y)
    d.wire(box.enable, is_on.y)
    d.wire(box.u, ramp.y)
    results = d.run(stop=1.0, every=0.1)
    assert value(results, "box.y", 0.4) == -1.0
    assert value(results, "box.y", 1.0) == pytest.approx((0.5 + 0.6 + 0.7) / 3)


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ({"y": Stepped()}, "has no stepper that computes it. Add @stepper."),
        ({"f": stepper(every=1.0)(lambda: None), "g": stepper(every=1.0)(lambda: None)}, "is a second stepper."),
        ({"u": Input(), "f": stepper(every=1.0)(lambda u: None)}, "reads 'u', which is not a parameter."),
    ],
)
def test_what_cannot_be_declared_is_refused(body: dict[str, Any], sentence: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        type(Block)("Bad", (Block,), {"__doc__": "Bad.", "__module__": __name__, **body})
    assert sentence in str(caught.value)


def test_a_program_begins_anew_where_its_subdiagram_is_reset() -> None:
    def box(**how: str) -> Any:
        part = Diagram("part")
        mean = part.add("mean", Mean())
        part.wire(mean.u, part.input("u"))
        part.output("y", mean.y)
        d = Diagram("enabled")
        pulse, is_on = (
            d.add("pulse", Pulse(height=-1.0, on=0.55, off=0.75)),
            d.add("is_on", CompareToConstant(constant=-0.5)),
        )
        ramp, made = d.add("ramp", Ramp()), d.add("box", part, enable=how)
        d.wire(is_on.u, pulse.y)
        d.wire(made.enable, is_on.y)
        d.wire(made.u, ramp.y)
        return d.run(stop=1.0, every=0.1)

    assert value(box(), "box.y", 1.0) == pytest.approx((0.1 + 0.2 + 0.3 + 0.4 + 0.5 + 0.8 + 0.9 + 1.0) / 9)
    assert value(box(states="reset"), "box.y", 1.0) == pytest.approx((0.8 + 0.9 + 1.0) / 3)


def test_a_program_that_keeps_what_it_is_given_spoils_no_snapshot() -> None:
    class Keeper:
        def __init__(self) -> None:
            self.seen: list[float] = []

        def step(self, t: float, u: float) -> float:
            self.seen.append(t)
            return float(len(self.seen))

        def save(self) -> list[float]:
            return self.seen

        def restore(self, saved: list[float]) -> None:
            self.seen = saved

    d = with_program(Keeper)
    run = d.start(stop=1.0)
    run.advance_to(0.5)
    state = run.snapshot()
    assert [d.run(stop=1.0, resume=state)["odd.y"][-1] for _ in range(3)] == [11.0, 11.0, 11.0]


@pytest.mark.parametrize("engine", ["reference", pytest.param("native", marks=needs_compiler)])
def test_a_run_that_cannot_begin_says_what_the_program_raised(engine: str) -> None:
    class Broken:
        def step(self, t: float, u: float) -> float:
            return u

        def save(self) -> float:
            return 0.0

        def restore(self, saved: float) -> None:
            raise ZeroDivisionError("mine")

    d = with_program(Broken)
    run = d.start(stop=1.0, engine=engine)
    run.advance_to(0.5)
    state = run.snapshot()
    with pytest.raises(UsageError, match=r"E506 .*mine") as caught:
        d.run(stop=1.0, resume=state, engine=engine)
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


def test_what_a_program_gives_has_its_type() -> None:
    class Typed(Block):
        """An int and a bool."""

        n = Stepped(0, type="int")
        b = Stepped(False, type="bool")

        @stepper(every=0.1)
        def program():  # type: ignore[no-untyped-def]
            return stepping(lambda t: {"n": 2.0 if t < 0.45 else 2.5, "b": True})()

    d = Diagram("typed")
    d.add("typed", Typed())
    with pytest.raises(SimulationError, match=r"E310 typed: its stepper returned 2\.5 for 'n', which is int"):
        d.run(stop=1.0)


@pytest.mark.parametrize("engine", ["reference", pytest.param("native", marks=needs_compiler)])
@pytest.mark.parametrize("master", [{}, {"couple": "each", "step": 0.1}])
def test_an_interrupt_while_progress_is_told_is_not_lost(engine: str, master: dict[str, Any]) -> None:
    """Also where it comes with the last moment of the run, as a short one has only one."""
    told = []

    def progress(t: float, _: float) -> None:
        if not told:
            told.append(t)
            os.kill(os.getpid(), signal.SIGINT)

    run = mean_of(Sine()).start(stop=0.25, method="euler", step=0.25, engine=engine, progress=progress, master=master)
    with pytest.raises(KeyboardInterrupt):
        run.advance_to(0.25)
    run.advance_to(0.25)
    assert float(run.results["mean.y"][-1]) == pytest.approx(np.mean(np.sin([0.0, 0.1, 0.2])), rel=1e-12)
