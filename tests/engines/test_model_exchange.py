"""FMUs for Model Exchange in a diagram: the run's own solver integrates them, in both engines.

The witnesses: the block that the FMU was exported from, closed forms, FMPy's own simulation.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import re
import signal
import subprocess
import threading
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from blocks import (
    PID,
    Block,
    BouncingBall,
    Constant,
    Diagram,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    LookupTable,
    Parameter,
    PMDCMotor,
    Pulse,
    Ramp,
    Results,
    Saturation,
    Sine,
    State,
    StateSpace,
    Step,
    Sum,
    UnitDelay,
    ZeroOrderHold,
    crossing,
    fmu,
    output,
)
from blocks.cli import main
from blocks.fmi.library import folders, suffix
from blocks.model.fmu_block import fmu_type
from blocks.text.errors import FMUError, ModelError, SimulationError, UsageError
from tests.support.fmus import DIAGRAMS
from tests.support.marks import long
from tests.support.model_exchange import live
from tests.support.zoo import zoo

ENGINES = ("reference", "native")
MOTORS = tuple(DIAGRAMS.parent / "fmus" / name for name in ("PMDCMotor.fmu", "PMDCMotor_fmi2.fmu"))
METHODS: dict[str, dict[str, Any]] = {
    "rk4": {"method": "rk4", "step": 0.01},
    "dopri5": {"method": "dopri5", "rtol": 1e-9, "atol": 1e-11},
    "radau": {"method": "radau", "rtol": 1e-9, "atol": 1e-11},
}


class Stiff(Block):
    """x' = -lam (x - cos t) with an unhurried neighbour, and a nonlinear output."""

    lam = Parameter(1e4)  # 1/s
    u = Input(0.0)
    x = State(output=True)
    v = State(1.0, output=True)

    @x.derivative
    def dx(x, u, v, lam):  # type: ignore[no-untyped-def]
        return (u * v - x) * lam

    @v.derivative
    def dv(u, v):  # type: ignore[no-untyped-def]
        return -0.5 * v


class Counting(Block):
    """The number of the tick."""

    @output(every=0.1, type="int")
    def y(tick):  # type: ignore[no-untyped-def]
        return tick


class Whole(Block):
    """What it is given, sampled."""

    u = Input(type="int")

    @output(every=0.1, type="int")
    def y(u):  # type: ignore[no-untyped-def]
        return u


def worst(ours: Results, theirs: Results, names: dict[str, str]) -> float:
    """The largest difference of signals, by their names in both."""
    assert np.array_equal(ours.t, theirs.t)
    return max(float(np.max(np.abs(np.asarray(ours[a]) - np.asarray(theirs[b])))) for a, b in names.items())


def loop(motor: Block) -> Diagram:
    """A motor under control: the FMU is in a loop, and its inputs come from a block that its outputs go to."""
    made = Diagram("loop")
    r = made.input("r", unit="rad/s")
    control = made.add("control", PID(kp=2, ki=5))
    plant = made.add("motor", motor)
    made.wire(control.r, r)
    made.wire(control.y, plant.omega)
    made.wire(plant.v, control.u)
    return made


def ball() -> Diagram:
    made = Diagram("ball")
    b = made.add("b", BouncingBall(h_start=1.0))
    made.output("h", b.h)
    made.output("v", b.v)
    return made


def pulse() -> Diagram:
    made = Diagram("pulse")
    p, lag = made.add("p", Pulse(on=0.3, off=0.7)), made.add("lag", FirstOrder())
    made.wire(lag.u, p.y)
    made.output("y", lag.y)
    return made


def sampled() -> Diagram:
    made = Diagram("sampled")
    s, held, lag = made.add("s", Sine()), made.add("held", ZeroOrderHold(period=0.1)), made.add("lag", FirstOrder())
    made.wire(held.u, s.y)
    made.wire(lag.u, held.y)
    made.output("y", lag.y)
    made.output("held", held.y)
    return made


def stiff() -> Diagram:
    made = Diagram("stiff")
    u = made.input("u")
    b = made.add("b", Stiff())
    made.wire(b.u, u)
    made.output("x", b.x)
    made.output("v", b.v)
    return made


MODELS: dict[str, Callable[[], Diagram]] = {"ball": ball, "pulse": pulse, "sampled": sampled, "stiff": stiff}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Path]:
    """The FMU of a model, exported once."""
    folder, known = tmp_path_factory.mktemp("me"), dict[tuple[str, int], Path]()

    def of(name: str, fmi: int) -> Path:
        if (name, fmi) not in known:
            known[name, fmi] = folder / f"{name}{fmi}.fmu"
            MODELS[name]().export(known[name, fmi], fmi=fmi)
        return known[name, fmi]

    return of


class Falling(Block):
    """u, but -u between 0 and 1, and u - 2 above."""

    u = Input()

    @crossing
    def one(u: Any) -> Any:
        return u - 1.0

    @crossing
    def zero(u: Any) -> Any:
        return u

    @output
    def y(u: Any, one: Any, zero: Any) -> Any:
        return np.where(one, u - 2.0, np.where(zero, -u, u))


def alone(block: Block) -> Diagram:
    made = Diagram("alone")
    made.add("b", block)
    return made


def zoo_of(fmi: int, inputs: Mapping[str, Any] | None = None, **parameters: Any) -> Diagram:
    made = Diagram("zoo")
    z = made.add("z", fmu(zoo(fmi), kind="ME", **parameters))
    for name, block in (inputs or {}).items():
        source = made.add(f"{name}_source", block)
        made.wire(getattr(z, name), source.y)
    return made


@pytest.fixture
def nothing_stays() -> Iterator[None]:
    """Every instance is freed when nobody refers to the run any more."""
    before = live()
    yield
    gc.collect()
    assert live() == before


# --- against the block that the FMU was made of -----------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("path", MOTORS, ids=["fmi3", "fmi2"])
def test_a_motor_in_a_loop_is_the_native_one(path: Path, method: str, engine: str) -> None:
    settings = {"stop": 2.0, "inputs": {"r": 1.0}, "every": 0.01, "engine": engine, **METHODS[method]}
    ours, theirs = loop(PMDCMotor()).run(**settings), loop(fmu(path, kind="ME")).run(**settings)
    names = ("motor.omega", "motor.i", "control.u")
    assert worst(ours, theirs, {name: name for name in names}) < 1e-8
    # One rate in its last place decides on a rejection, or on how often a Jacobian serves.
    allowed = 0.0 if "step" in METHODS[method] else 0.05
    assert ours.statistics.evaluations == pytest.approx(theirs.statistics.evaluations, rel=allowed)
    assert theirs.statistics.engine == engine


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("fmi", [long(2), 3])
@pytest.mark.parametrize("name", ["ball", "pulse", "sampled"])
def test_events_are_those_of_the_native_block(
    made: Callable[[str, int], Path], name: str, fmi: int, method: str, engine: str
) -> None:
    settings = {"stop": 2.0, "every": 0.05, "engine": engine, **METHODS[method]}
    names = {"ball": ("h", "v"), "pulse": ("y",), "sampled": ("y", "held")}[name]
    outputs = {key: f"b.{key}" for key in names}
    ours = MODELS[name]().run(log=[*outputs], **settings)
    theirs = alone(fmu(made(name, fmi), kind="ME")).run(log=[*outputs.values()], **settings)
    assert worst(ours, theirs, outputs) < 1e-9
    assert {event.t for event in ours.events} <= {event.t for event in theirs.events}
    if name == "ball":
        assert len(ours.events) == 4
    if name == "sampled":
        ticks = sorted({event.t for event in theirs.events if event.what == "time_event"})
        assert ticks == [k / 10 for k in range(1, 21)]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("master", [False, True])
def test_an_indicator_that_its_event_turns_back_is_one_event(master: bool, engine: str, tmp_path: Path) -> None:
    """u = 3 - t leaves the points of a table at 1, 2 and 3 s, and each time the next point takes the indicator over."""
    table = Diagram("table")
    table.wire(table.add("src", LookupTable(points=[0.0, 1.0, 2.0], values=[2.0, 1.0, 0.0])).u, table.input("u"))
    table.output("y", "src.y")
    table.export(tmp_path / "table.fmu", kinds=["ME"])
    d = Diagram("d")
    d.wire(d.add("falling", Integrator(y_start=3.0)).u, d.add("down", Constant(value=-1.0)).y)
    d.wire(d.add("m", fmu(tmp_path / "table.fmu", kind="ME")).u, "falling.y")
    if master:
        d.wire(d.add("cs", fmu(MOTORS[0], kind="CS")).v, "m.y")
    events = d.run(stop=4.0, engine=engine, trust=tmp_path).events
    assert [(event.block, event.what) for event in events] == 3 * [("m", "leaves")]
    assert [event.t for event in events] == pytest.approx([1.0, 2.0, 3.0], abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_stiff_fmu_with_its_directional_derivatives(made: Callable[[str, int], Path], fmi: int, engine: str) -> None:
    table = (np.linspace(0, 2, 41), np.cos(np.linspace(0, 2, 41)), "linear")
    settings: dict[str, Any] = {
        "stop": 2.0,
        "every": 0.05,
        "method": "radau",
        "rtol": 1e-8,
        "engine": engine,
        "inputs": {"u": table},
    }
    theirs = Diagram("d")
    u = theirs.input("u")
    b = theirs.add("b", fmu(made("stiff", fmi), kind="ME"))
    theirs.wire(b.u, u)
    one, other = stiff().run(**settings), theirs.run(**settings)
    assert worst(one, other, {"x": "b.x", "v": "b.v"}) < 1e-9
    assert other.statistics.evaluations < 1.1 * one.statistics.evaluations


def test_both_engines_are_close() -> None:
    settings: dict[str, Any] = {"stop": 1.0, "method": "rk4", "step": 0.01}
    inputs = {"u": Sine(omega=5.0)}
    one, other = (zoo_of(3, inputs, mark=500, period=0.3).run(engine=engine, **settings) for engine in ENGINES)
    assert len(one.events) > 4
    for name in one:
        assert np.array_equal(np.asarray(one[name]), np.asarray(other[name])), name
    assert list(one.events) == list(other.events)


def test_fmpy_agrees(made: Callable[[str, int], Path]) -> None:
    import fmpy

    path = made("ball", 2)
    theirs = fmpy.simulate_fmu(str(path), fmi_type="ModelExchange", stop_time=0.9, relative_tolerance=1e-9,
                               output=["h", "v"], output_interval=0.1)  # fmt: skip
    ours = alone(fmu(path, kind="ME")).run(stop=0.9, every=0.1, rtol=1e-10, atol=1e-12)
    last = theirs[-1]
    assert last["time"] == pytest.approx(0.9)
    assert np.asarray(ours["b.h"])[-1] == pytest.approx(last["h"], abs=1e-5)
    assert np.asarray(ours["b.v"])[-1] == pytest.approx(last["v"], abs=1e-5)


def test_the_paper_with_fmus_for_motors() -> None:
    path = DIAGRAMS / "paper" / "iadrc.json"
    native, swapped = Diagram.load(path), Diagram.load(path)
    blocks = dict(native.value.blocks)
    for name in ("motor_left", "motor_right"):
        blocks[name] = replace(blocks[name], type="", fmu="PMDCMotor.fmu", cls=fmu_type(MOTORS[0], "ME"))
    swapped._draft.value = replace(native.value, blocks=blocks)
    ours, theirs = native.run(engine="native"), swapped.run(engine="native")
    names = {name: name for name in ours if name in theirs}
    assert len(names) > 15
    assert worst(ours, theirs, names) < 1e-6
    for name, value in ours.measures.items():
        assert theirs.measures[name] == pytest.approx(value, rel=1e-6)


# --- closed forms -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("fmi", [2, 3])
class TestTheZoo:
    """x' = -a x + u + k in m, though the FMU counts in mm; s' = on."""

    def test_units_and_a_jump_of_an_input(self, fmi: int, engine: str) -> None:
        d = zoo_of(fmi, {"u": Step(at=0.3)})
        r = d.run(stop=1.0, engine=engine, rtol=1e-10, atol=1e-12, log=["z.x", "z.y", "z.count", "z.der(x)", "z.feed"])
        before = 0.5 * np.exp(-r.t)
        after = 1 + (0.5 * np.exp(-0.3) - 1) * np.exp(-(r.t - 0.3))
        edge = int(np.argmax(np.asarray(r["z.feed"]) > 0))
        exact = np.where(np.arange(len(r.t)) < edge, before, after)
        assert np.max(np.abs(np.asarray(r["z.x"]) - exact)) < 1e-9
        assert np.max(np.abs(np.asarray(r["z.y"]) - exact - np.asarray(r["z.feed"]))) < 1e-9
        # What the FMU gives no unit stays in its own: mm/s.
        assert np.max(np.abs(np.asarray(r["z.der(x)"]) / 1000 + exact - np.asarray(r["z.feed"]))) < 1e-8
        assert r.t[edge] == r.t[edge - 1] == 0.3
        assert np.asarray(r["z.count"])[[0, edge - 1, edge, -1]].tolist() == [0, 0, 1, 1]  # the jump was an event

    def test_inputs_that_are_taken_over_at_events(self, fmi: int, engine: str) -> None:
        d = Diagram("d")
        z = d.add("z", fmu(zoo(fmi), kind="ME", x_0=0.0))
        k, on = d.input("k", type="int"), d.input("on", type="bool")
        d.wire(z.k, k)
        d.wire(z.on, on)
        held = {"k": ([0.0, 0.5], [0, 2], "hold"), "on": ([0.0, 0.25], [0, 1], "hold")}
        r = d.run(stop=1.0, inputs=held, engine=engine, rtol=1e-10, atol=1e-12, log=["z.x", "z.s", "z.n", "z.lamp"])
        assert np.asarray(r["z.x"])[-1] == pytest.approx(2 * (1 - np.exp(-0.5)), abs=1e-9)
        assert np.asarray(r["z.s"])[-1] == pytest.approx(0.75, abs=1e-12)
        assert sorted(set(np.asarray(r["z.n"]))) == [0, 4]
        assert sorted(set(np.asarray(r["z.lamp"]))) == [0, 1]

    def test_events_of_time(self, fmi: int, engine: str) -> None:
        r = zoo_of(fmi, period=0.3).run(stop=1.0, engine=engine)
        times = [event.t for event in r.events]
        assert times == pytest.approx([0.3, 0.6, 0.9], abs=1e-15)
        assert {(event.block, event.what) for event in r.events} == {("z", "time_event")}
        assert np.asarray(r["z.count"])[-1] == 3

    def test_events_of_steps_and_states_that_jump(self, fmi: int, engine: str) -> None:
        d = Diagram("d")
        z = d.add("z", fmu(zoo(fmi), kind="ME", x_0=0.0, a=0.0, level=0.25))
        d.wire(z.on, d.input("on", type="bool"))
        r = d.run(stop=1.0, inputs={"on": True}, method="rk4", step=0.01, engine=engine, log=["z.x", "z.count"])
        # Steps at which s passed 0.25, 0.5, 0.75, 1: rounding decides which.
        x = np.asarray(r["z.x"])
        assert x[-1] in (pytest.approx(0.3), pytest.approx(0.4))
        assert set(np.round(np.diff(x), 12)) == {0.0, 0.1}
        assert np.asarray(r["z.count"])[-1] in (3, 4)

    def test_an_indicator_with_hysteresis(self, fmi: int, engine: str) -> None:
        d = zoo_of(fmi, {"u": Sine()}, x_0=0.0, a=0.0, mark=500)
        r = d.run(stop=13.0, engine=engine, rtol=1e-9, atol=1e-12)  # x = 1 - cos t passes 0.5 four times and so on
        times = [event.t for event in r.events]
        up = np.arccos(0.5 - 1e-6)
        assert times[0] == pytest.approx(up, abs=1e-8)
        assert times[1] == pytest.approx(2 * np.pi - np.arccos(0.5 + 1e-6), abs=1e-8)
        assert len(times) == 4
        assert {event.what for event in r.events} == {"event[0]" if fmi == 2 else "z"}

    def test_a_parameter_that_is_tuned_while_it_runs(self, fmi: int, engine: str) -> None:
        d = Diagram("d")
        d.parameter("a", 1.0)
        d.add("z", fmu(zoo(fmi), kind="ME", a="=a"))
        run = d.start(stop=2.0, rtol=1e-10, atol=1e-12, engine=engine)
        run.advance(1.0)
        run.set("a", 2.0)
        run.advance(1.0)
        assert run["z.y"] == pytest.approx(0.5 * np.exp(-3.0), abs=1e-9)
        assert run["z.count"] == 1

    def test_an_fmu_that_ends_the_run(self, fmi: int, engine: str) -> None:
        for settings in ({}, {"every": 0.4}):
            run = zoo_of(fmi, end=0.5).start(stop=1.0, method="rk4", step=0.1, engine=engine, **settings)
            results = run.finish()
            assert results.t[-1] == run.t == 0.5
            (told,) = results.warnings
            assert told == run.ended
            assert re.match(r"W206 z: zoo\d\.fmu ended the run at t = 0\.5 s\.", str(told))
            assert results.interrupted is False
            with pytest.raises(UsageError, match=r"E501 .*the run is over: an FMU ended it at t = 0\.5 s"):
                run.advance(0.1)
            assert np.array_equal(run.finish().t, results.t)

    def test_an_fmu_that_fails(self, fmi: int, engine: str) -> None:
        with pytest.raises(
            FMUError, match=r'E213 z: .*at t = 0\.\d+ s.* The FMU reported: "the zoo is closed"'
        ) as caught:
            zoo_of(fmi, failing=0.5).run(stop=1.0, engine=engine)
        assert 0.0 < caught.value.results.t[-1] < 0.5

    def test_a_trial_that_is_discarded_is_a_step_too_long(self, fmi: int, engine: str) -> None:
        # x' = 1 - x from 0 goes to 1 and no further; a long first step would try what lies beyond 1.0005.
        settings: dict[str, Any] = {"rtol": 1e-3, "atol": 1e-3, "engine": engine}
        d = zoo_of(fmi, {"u": Constant(value=1.0)}, x_0=0.0, a=1.0, limit=1000.5)
        r = d.run(stop=20.0, **settings)
        assert np.asarray(r["z.y"])[-1] == pytest.approx(2.0, abs=2e-3)
        d = zoo_of(fmi, {"u": Constant(value=1.0)}, x_0=0.0, a=0.0, limit=500)
        with pytest.raises((SimulationError, FMUError)) as caught:
            d.run(stop=1.0, **settings)
        assert caught.value.results.t[-1] == pytest.approx(0.5, abs=1e-3)  # type: ignore[attr-defined]

    def test_wrong_directional_derivatives_are_found_out(self, fmi: int, engine: str) -> None:
        settings: dict[str, Any] = {"stop": 1.0, "method": "radau", "rtol": 1e-8, "engine": engine, "every": 0.1}
        right, wrong = (zoo_of(fmi, {"u": Sine()}, a=200.0, wrong=w).run(**settings) for w in (0.0, 1.0))
        assert worst(right, wrong, {"z.y": "z.y"}) < 1e-8
        assert wrong.statistics.evaluations < 1.5 * right.statistics.evaluations

    def test_runs_again_and_at_once(self, fmi: int, engine: str, nothing_stays: None) -> None:
        d = zoo_of(fmi, {"u": Sine()}, level=0.25)
        expected = d.run(stop=1.0, engine=engine)
        runs = [d.start(stop=1.0, engine=engine) for _ in range(3)]
        for _ in range(10):
            for run in runs:
                run.advance(0.1)
        found: list[Results] = []
        threads = [threading.Thread(target=lambda: found.append(d.run(stop=1.0, engine=engine))) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(found) == 3
        for other in found:
            assert np.array_equal(np.asarray(other["z.y"]), np.asarray(expected["z.y"]))
        for run in runs:
            assert run["z.y"] == pytest.approx(np.asarray(expected["z.y"])[-1], abs=1e-5)
        del runs, run

    def test_an_instance_is_freed_after_a_failure(self, fmi: int, engine: str, nothing_stays: None) -> None:
        for failing in (0.5, 0.0):
            with pytest.raises((FMUError, SimulationError)):
                zoo_of(fmi, failing=failing).run(stop=1.0, engine=engine)

    def test_an_instance_is_freed_after_it_ended_the_run(self, fmi: int, engine: str, nothing_stays: None) -> None:
        for end in (0.5, -1.0):
            assert zoo_of(fmi, end=end).run(stop=1.0, engine=engine).warnings

    def test_its_state_cannot_be_saved_says_the_fmu(self, fmi: int, engine: str, tmp_path: Path) -> None:
        run = zoo_of(fmi).start(stop=1.0, engine=engine)
        run.advance(0.5)
        with pytest.raises(UsageError, match="E506 z: the state of zoo"):
            run.save(tmp_path / "state")
        run.advance(0.5)
        assert run["z.y"] == pytest.approx(0.5 * np.exp(-1), abs=1e-5)


@pytest.mark.parametrize("method", ["rk4", "dopri5", "radau"])
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("fmi", [2, 3])
def test_values_that_are_computed_with_the_derivatives_are_never_stale(fmi: int, engine: str, method: str) -> None:
    """x' = u - x from 0.5, u = sin t, and z = x + u is integrated by another block."""
    d = Diagram("d")
    wave, z, sum_ = d.add("wave", Sine()), d.add("z", fmu(zoo(fmi, lazy=True), kind="ME")), d.add("sum", Integrator())
    d.wire(z.u, wave.y)
    d.wire(sum_.u, z.y)
    log = ["z.x", "z.y", "z.feed", "z.der(x)", "sum.y"]
    settings: dict[str, Any] = {"step": 0.01} if method == "rk4" else {"rtol": 1e-9, "atol": 1e-11}
    r = d.run(stop=2.0, engine=engine, method=method, log=log, every=0.1, **settings)
    sine, cosine = np.sin(r.t), np.cos(r.t)
    x = np.exp(-r.t) + (sine - cosine) / 2
    exact = {
        "z.x": x, "z.y": x + sine, "z.feed": sine, "z.der(x)": 1000 * (sine - x),
        "sum.y": 1 - np.exp(-r.t) + (1 - cosine - sine) / 2 + 1 - cosine,
    }  # fmt: skip
    for name, values in exact.items():
        assert np.max(np.abs(np.asarray(r[name]) - values)) < 1e-7 * np.max(np.abs(values)), name


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("fmi", [2, 3])
def test_ticks_before_and_after_an_fmu(fmi: int, engine: str) -> None:
    """What a tick gives an FMU is taken over by an event before another block samples what the FMU makes of it."""
    d = Diagram("d")
    z = d.add("z", fmu(zoo(fmi), kind="ME"))
    count, held = d.add("count", Counting()), d.add("held", Whole())
    d.wire(z.k, count.y)
    d.wire(held.u, z.n)
    r = d.run(stop=0.5, engine=engine, log=["count.y", "z.n", "held.y"], every=0.1)
    after = np.arange(6.0)
    for name, values in {"count.y": after, "z.n": 2 * after, "held.y": 2 * after}.items():
        found = [np.asarray(r[name])[np.nonzero(r.t == t)[0][-1]] for t in sorted(set(r.t))]
        assert found == values.tolist(), name


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("fmi", [2, 3])
def test_in_a_process_of_its_own(fmi: int, engine: str) -> None:
    settings: dict[str, Any] = {"stop": 1.0, "method": "rk4", "step": 0.01, "engine": engine}
    one, other = (alone(fmu(zoo(fmi), kind="ME", isolate=own, period=0.3)).run(**settings) for own in (False, True))
    for name in one:
        assert np.array_equal(np.asarray(one[name]), np.asarray(other[name])), name
    with pytest.raises(FMUError, match=r'E213 b: .* The FMU reported: "the zoo is closed"'):
        alone(fmu(zoo(fmi), kind="ME", isolate=True, failing=0.5)).run(**settings)


# --- saving -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", ["ball", "sampled"])
def test_a_run_that_was_saved_goes_on_as_it_would_have(
    made: Callable[[str, int], Path], name: str, fmi: int, engine: str, tmp_path: Path
) -> None:
    d = alone(fmu(made(name, fmi), kind="ME"))
    whole = d.start(stop=2.0, engine=engine)
    whole.advance(0.77)
    whole.save(tmp_path / "state")
    whole.advance(1.23)
    other = d.start(stop=2.0, engine=engine, resume=tmp_path / "state")
    other.advance(1.23)
    ours, theirs = whole.results, other.results
    for key in ours:
        assert np.array_equal(np.asarray(ours[key])[-len(theirs.t) :], np.asarray(theirs[key])), key
    assert [e for e in ours.events if e.t > 0.77] == list(theirs.events)


# --- what is refused ------------------------------------------------------------------------------------------------


def looped(fmi: int, **parameters: Any) -> Diagram:
    """u = 1 - y/2, and y = x + u: so u = (2 - x)/3, and x' = -x + u."""
    d = Diagram("d")
    z, gain, total = (
        d.add("z", fmu(zoo(fmi, **parameters), kind="ME")),
        d.add("gain", Gain(k=-0.5)),
        d.add("sum", Sum()),
    )
    one = d.add("one", Constant(value=1.0))
    d.wire(gain.u, z.y)
    d.wire(total.u1, gain.y)
    d.wire(total.u2, one.y)
    d.wire(z.u, total.y)
    return d


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("fmi", [long(2), 3])
def test_a_loop_through_an_fmu_is_solved(fmi: int, method: str, engine: str) -> None:
    r = looped(fmi).run(stop=1.0, loops="solve", engine=engine, log=["z.x", "sum.y"], **METHODS[method])
    exact = 0.5 + (0.5 - 0.5) * np.exp(-4 / 3 * r.t)
    assert np.max(np.abs(np.asarray(r["z.x"]) - exact)) < 1e-8
    assert np.max(np.abs(np.asarray(r["sum.y"]) - (2 - exact) / 3)) < 1e-8


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("kind", ["before", "beside"])
@pytest.mark.parametrize("fmi", [long(2), 3])
def test_corners_of_a_loop_at_the_events_of_an_fmu(fmi: int, kind: str, engine: str, tmp_path: Path) -> None:
    """x = h - 1.9 sat(x), where h jumps over both corners: an FMU holds h, or has an event as its input x jumps."""

    def diagram(hold: Any, lag: Any) -> Diagram:
        d = Diagram("corners")
        wave = d.add("wave", Sine(omega=5.164696, amplitude=1.14854, phase=4.630309))
        h, x, f = d.add("h", hold), d.add("x", Sum(signs="+-")), d.add("f", lag)
        law, back = d.add("law", Saturation(lower=-0.134957, upper=0.177378)), d.add("back", Gain(k=1.926791))
        for target, source in ((h.u, wave.y), (x.u1, h.y), (x.u2, back.y), (law.u, x.y), (back.u, law.y), (f.u, x.y)):
            d.wire(target, source)
        return d

    hold, lag = UnitDelay(period=0.1), FirstOrder(T=0.3)
    settings = {"stop": 2.0, "every": 0.05, "method": "euler", "step": 0.01, "loops": "solve", "engine": engine}
    ours = diagram(hold, lag).run(**settings)
    Diagram.alone(hold if kind == "before" else lag).export(tmp_path / "part.fmu", fmi=fmi)
    part = fmu(tmp_path / "part.fmu", kind="ME")
    theirs = diagram(*((part, lag) if kind == "before" else (hold, part))).run(**settings)
    h, x = np.asarray(theirs["h.y"]), np.asarray(theirs["x.y"])
    assert np.max(np.abs(x + 1.926791 * np.clip(x, -0.134957, 0.177378) - h)) < 1e-12
    assert x.max() > 0.3
    assert x.min() < -0.3
    assert worst(ours, theirs, {name: name for name in ("h.y", "x.y", "f.y")}) < 1e-9
    passed = [[(event.t, event.what) for event in run.events if event.block == "law"] for run in (ours, theirs)]
    assert passed[0] == passed[1]
    assert len(passed[0]) > 6


@pytest.mark.parametrize("engine", ENGINES)
def test_a_jump_that_an_fmu_makes_passes_the_corners_on_its_way_only(engine: str, tmp_path: Path) -> None:
    """x = h - 2 - 5 sat(x), sat within 0.2, where h jumps from 0 to 1.4 or 3.6: from x = -1 to 0.133 or 0.6."""
    Diagram.alone(ZeroOrderHold(period=0.1)).export(tmp_path / "held.fmu")
    for after, x_after, passed in ((1.4, -0.1, ["below"]), (3.6, 0.6, ["above", "below"])):  # both at once, as declared
        for part in (ZeroOrderHold(period=0.1), fmu(tmp_path / "held.fmu", kind="ME")):
            d = Diagram("jump")
            w, h, c = d.add("w", Step(at=0.45, after=after)), d.add("h", part), d.add("c", Constant(value=-2.0))
            law = d.add("law", Saturation(lower=-0.2, upper=0.2))
            x, g = d.add("x", Sum(signs="+-+")), d.add("g", Gain(k=5.0))
            for a, b in ((h.u, w.y), (x.u1, h.y), (law.u, x.y), (g.u, law.y), (x.u2, g.y), (x.u3, c.y)):
                d.wire(a, b)
            r = d.run(stop=1.0, method="rk4", step=0.01, loops="solve", engine=engine)
            assert r["x.y"][-1] == pytest.approx(x_after, abs=1e-12)
            assert [event.what for event in r.events if event.block == "law"] == passed


@pytest.mark.parametrize("engine", ENGINES)
def test_an_idle_fmu_hinders_no_way_along_corners(engine: str, tmp_path: Path) -> None:
    """x = h - f(x) of a law that falls in the middle: no solution there, but one behind it."""
    Diagram.alone(FirstOrder(T=0.3)).export(tmp_path / "idle.fmu")
    for idle in (FirstOrder(T=0.3), fmu(tmp_path / "idle.fmu", kind="ME")):
        d = Diagram("d")
        h, x, f = d.add("h", Step(at=0.5, before=-0.8, after=0.4)), d.add("x", Sum(signs="+-")), d.add("f", Falling())
        lag, c = d.add("lag", idle), d.add("c", Constant(value=1.0))
        for a, b in ((x.u1, h.y), (x.u2, f.y), (f.u, x.y), (lag.u, c.y)):
            d.wire(a, b)
        r = d.run(stop=1.0, method="rk4", step=0.01, loops="solve", engine=engine)
        assert [event.what for event in r.events if event.block == "f"] == ["zero", "one"]
        assert r["x.y"][-1] + r["f.y"][-1] == pytest.approx(0.4, abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("fmi", [long(2), 3])
def test_an_fmu_with_corners_is_solved_in_a_loop_and_behind_one(fmi: int, engine: str, tmp_path: Path) -> None:
    """y = sat(r - y) of an FMU that saturates at 12, with r = 20 t: y = min(10 t, 12). Behind it another one at 3."""
    for limit in (12.0, 3.0):
        Diagram.alone(Saturation(lower=-limit, upper=limit)).export(tmp_path / f"{limit:g}.fmu", fmi=fmi)
    d = Diagram("d")
    r, e = d.add("r", Ramp(slope=20.0)), d.add("e", Sum(signs="+-"))
    law, behind = (d.add(name, fmu(tmp_path / f"{name[1:]}.fmu", kind="ME")) for name in ("x12", "x3"))
    for target, source in ((e.u1, r.y), (e.u2, law.y), (law.u, e.y), (behind.u, e.y)):
        d.wire(target, source)
    settings = {"stop": 3.0, "every": 0.05, "loops": "solve", "engine": engine}
    for method in ({"method": "dopri5"}, {"method": "rk4", "step": 0.01}):
        results = d.run(**settings, **method)
        exact = np.minimum(10 * results.t, 12.0)
        assert np.max(np.abs(np.asarray(results["x12.y"]) - exact)) < 1e-9
        assert np.max(np.abs(np.asarray(results["x3.y"]) - np.minimum(20 * results.t - exact, 3.0))) < 1e-9


def test_a_loop_through_an_fmu_is_told() -> None:
    with pytest.raises(ModelError, match=r'E102 .*z\.y -> .* set "loops": "solve"'):
        looped(3).run(stop=1.0)
    # Where the FMU does not say on what its outputs depend, they depend on all inputs.
    d = Diagram("d")
    z = d.add("z", fmu(zoo(2, dependencies=False), kind="ME"))
    d.wire(z.k, z.count)
    with pytest.raises(ModelError, match=r"E102 z: .*'z\.count', which is not a real number"):
        d.run(stop=1.0)


def test_an_fmu_does_not_stand_still() -> None:
    inner = Diagram("inner")
    inner.add("z", fmu(zoo(3), kind="ME"))
    d = Diagram("d")
    on = d.input("on", type="bool")
    sub = d.add("sub", inner, enable={})
    d.wire(sub.enable, on)
    with pytest.raises(ModelError, match=r"E121 sub\.z"):
        d.run(stop=1.0, inputs={"on": True})


def test_a_diagram_with_an_fmu_is_not_exported(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="E606 z: is an FMU"):
        zoo_of(3).export(tmp_path / "x.fmu")


# --- Zeno, and the master ---------------------------------------------------------------------------------------------


class Restless(Block):
    """A ball that never rests."""

    h = State(1.0, output=True)
    v = State(output=True)

    @h.derivative
    def dh(v):  # type: ignore[no-untyped-def]
        return v

    @v.derivative
    def dv(h):  # type: ignore[no-untyped-def]
        return -9.81

    @crossing(direction="down")
    def impact(h):  # type: ignore[no-untyped-def]
        return h

    @impact.reset(v)
    def rebound(h, v):  # type: ignore[no-untyped-def]
        return -0.7 * v


@pytest.mark.parametrize("engine", ENGINES)
def test_zeno_is_told_of_an_fmu_too(engine: str, tmp_path: Path) -> None:
    ball = Diagram("restless")
    ball.add("b", Restless())
    ball.output("h", "b.h")
    ball.export(tmp_path / "x.fmu")
    # It bounces back through its indicator at once, some ulp after each impact: that alone is no Zeno.
    end = (1 + 2 * 0.7 / 0.3) * np.sqrt(2 / 9.81)
    for diagram in (ball, alone(fmu(tmp_path / "x.fmu", kind="ME"))):
        with pytest.raises(SimulationError, match=r"E304 b\.impact") as caught:
            diagram.run(stop=4.0, engine=engine)
        assert caught.value.results.t[-1] == pytest.approx(end, abs=1e-6)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("algorithm", ["jacobi", "iterated"])
def test_one_stands_in_the_island_beside_an_fmu_for_co_simulation(algorithm: str, engine: str) -> None:
    def both(one: Block, other: Block) -> Diagram:
        d = Diagram("both")
        v = d.input("v", unit="V")
        a, b = d.add("a", one), d.add("b", other)
        d.wire(a.v, v)
        d.wire(b.v, v)
        return d

    settings: dict[str, Any] = {"stop": 1.0, "inputs": {"v": 12.0}, "every": 0.01, "engine": engine, "rtol": 1e-9}
    ours = both(PMDCMotor(), PMDCMotor()).run(**settings)
    fmus = (fmu(MOTORS[0], kind=kind) for kind in ("ME", "CS"))
    theirs = both(*fmus).run(master={"step": 0.01, "algorithm": algorithm}, **settings)
    assert worst(ours, theirs, {"a.omega": "a.omega", "b.omega": "b.omega"}) < 1e-6


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_interrupt_comes_between_steps(fmi: int, engine: str) -> None:
    """The FMU stands where the run does: going on gives what the whole run gives."""
    d = zoo_of(fmi, {"u": Sine(omega=3.0)}, period=0.01, mark=500)
    settings: dict[str, Any] = {"stop": 1.0, "method": "rk4", "step": 0.001, "engine": engine}
    whole = d.start(**settings)
    for k in range(1, 21):
        whole.advance_to(k / 20)
    interrupts = 0

    def interrupt(t: float, _: float) -> None:
        if t < 0.02:
            os.kill(os.getpid(), signal.SIGINT)

    run = d.start(progress=interrupt, **settings)
    for k in range(1, 21):
        while run.t < k / 20:
            try:
                run.advance_to(k / 20)
            except KeyboardInterrupt:
                interrupts += 1
    assert interrupts >= (10 if engine == "reference" else 0)
    for name in ("z.y", "z.count"):
        assert np.array_equal(np.asarray(run.results[name]), np.asarray(whole.results[name]))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("fmi", [long(2), 3])
def test_arrays(fmi: int, method: str, engine: str, tmp_path: Path) -> None:
    """FMI 3 has vectors of states, inputs and outputs, FMI 2 their elements; dependencies go element by element."""
    matrices: dict[str, Any] = {
        "A": [[-1, 2, 0], [-2, -1, 0.5], [0, -0.5, -3]], "B": [[1, 0], [0, 1], [1, 1]], "C": [[1, 0, 0], [0, 1, 1]],
        "D": [[0, 0], [0, 0.5]],
    }  # fmt: skip
    path, options = tmp_path / "x.fmu", [f"{name}={json.dumps(value)}" for name, value in matrices.items()]
    settings = [part for option in options for part in ("--set", option)]
    assert main(["export", "StateSpace", "-o", str(path), "--fmi", str(fmi), *settings]) == 0

    def fed(block: Block) -> Diagram:
        made = Diagram("fed")
        made.add("s", block)
        for k, name in enumerate("ab"):
            made.input(name)
            made.wire(f"s.u[{k}]", name)
        return made

    t = np.linspace(0, 2, 21)
    run: dict[str, Any] = {"stop": 2.0, "every": 0.1, "engine": engine, **METHODS[method]}
    run["inputs"] = {"a": (t, np.sin(t)), "b": (t, np.cos(2 * t))}
    ours, theirs = fed(StateSpace(**matrices)).run(**run), fed(fmu(path, kind="ME")).run(**run)
    columns = [np.asarray(theirs[f"s.y[{k}]"]) for k in range(2)] if fmi == 2 else list(np.asarray(theirs["s.y"]).T)
    assert np.max(np.abs(np.asarray(ours["s.y"]) - np.column_stack(columns))) < 1e-9


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", ["dopri5", "radau"])
def test_an_fmu_of_another_exporter(method: str, engine: str, casadis: Path) -> None:
    d = Diagram("d")
    b, s = d.add("b", fmu(casadis, kind="ME")), d.add("s", Sine())
    d.wire(b.u, s.y)
    r = d.run(stop=10.0, method=method, rtol=1e-9, atol=1e-11, every=0.1, engine=engine)
    exact = solve_ivp(
        lambda t, x: [(1 - x[1] ** 2) * x[0] - x[1] + np.sin(t), x[0]], (0, 10), [0, 1], rtol=1e-11, atol=1e-12,
        t_eval=r.t,
    )  # fmt: skip
    assert np.max(np.abs(np.asarray(r["b.x1"]) - exact.y[0])) < 1e-7
    assert np.max(np.abs(np.asarray(r["b.x2"]) - exact.y[1])) < 1e-7


@pytest.fixture(scope="module")
def casadis(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The van der Pol oscillator as CasADi exports it, for FMI 3."""
    import casadi
    import fmpy

    folder = tmp_path_factory.mktemp("casadi")
    dae = casadi.DaeBuilder("vdp")
    dae.add("t", "independent")
    u = dae.add("u", "input", {"start": 0.0})
    x1, x2 = dae.add("x1", "output", {"start": 0.0}), dae.add("x2", "output", {"start": 1.0})
    dae.eq(dae.der(x1), (1 - x2**2) * x1 - x2 + u)
    dae.eq(dae.der(x2), x1)
    with contextlib.chdir(folder):
        try:
            dae.export_fmu()
        except (RuntimeError, AttributeError) as error:  # it calls that experimental
            pytest.skip(f"this CasADi does not export it: {error}")
    headers = Path(fmpy.__file__).parent / "c-code"
    command = [
        "cc",
        "-shared",
        "-fPIC",
        "-O1",
        "-I",
        str(headers),
        "vdp.c",
        "vdp_wrap.c",
        "-o",
        f"vdp{suffix()}",
        "-lm",
    ]
    subprocess.run(command, check=True, cwd=folder)
    path = folder / "vdp.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(folder / "modelDescription.xml", "modelDescription.xml")
        archive.write(folder / f"vdp{suffix()}", f"binaries/{folders(3)[0]}/vdp{suffix()}")
    return path
