"""FMUs under the master, in both engines: those of the exporter, of the repository, of C by hand, and of Python.

Witnesses: the published errors of the two masses (which blocks with equations have too), closed forms, the exponential
of a matrix, and the same diagram without FMUs.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import re
import shutil
import sys
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from blocks import (
    LESO,
    PID,
    Block,
    BouncingBall,
    Constant,
    Counter,
    DeadZone,
    Diagram,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    Parameter,
    PMDCMotor,
    Ramp,
    RateLimiter,
    Relay,
    Saturation,
    Sine,
    State,
    Step,
    Stepped,
    Sum,
    TransportDelay,
    ZeroOrderHold,
    fmu,
    output,
    stepper,
)
from blocks.engines.master import native_master
from blocks.engines.master.native_master import NativeMaster
from blocks.fmi.summary import tell
from blocks.results.results import Results
from blocks.text.errors import FMUError, ModelError
from tests.support.coupled_systems import (
    ALGORITHMS,
    AT_1,
    EXACT,
    HS,
    TABLE,
    TIGHT,
    Displaced,
    First,
    Forced,
    Lag,
    Second,
    Switching,
    error_of,
    rows_at,
    switched_at,
)
from tests.support.faulty import NEEDS_COMPILER, make
from tests.support.fmus import exported
from tests.support.marks import long
from tests.support.places import ROOT

Array = np.ndarray[Any, Any]

PAPER = ROOT / "diagrams" / "paper"
MOTORS = {2: ROOT / "fmus" / "PMDCMotor_fmi2.fmu", 3: ROOT / "fmus" / "PMDCMotor.fmu"}
IADRC = ROOT / "fmus" / "IADRC.fmu"
IS_HERE = sys.platform == "linux"

pytestmark = [NEEDS_COMPILER, pytest.mark.skipif(not IS_HERE, reason="the binaries in fmus/ are for Linux")]
each_engine = pytest.mark.parametrize("engine", ["reference", "native"])
each_fmi = pytest.mark.parametrize("fmi", [2, 3])
# Both engines speak to FMUs by the same functions: the slower one in one version, and by `make test-long` in both.
each_engine_and_fmi = pytest.mark.parametrize(
    ("engine", "fmi"),
    [("native", 2), ("native", 3), ("reference", 3), long("reference", 2)],
)
MUTE = {2: {"canInterpolateInputs": "false"}, 3: {"providesIntermediateUpdate": "false"}}
"""What an FMU says that takes inputs as they are at the begin of a step, and no course of them."""
FIXED = {2: {"canGetAndSetFMUstate": "false"}, 3: {"canGetAndSetFMUState": "false"}}
"""What one says that cannot go back."""

Export = Callable[..., Path]


def told_otherwise(path: Path, changes: Mapping[str, str]) -> Path:
    """A copy whose description has other attributes."""
    made = path.with_name(f"{path.stem}_{'_'.join(changes)}.fmu")
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(made, "w") as new:
        for entry in old.infolist():
            data = old.read(entry)
            if entry.filename == "modelDescription.xml":
                text = data.decode()
                for name, value in changes.items():
                    text, count = re.subn(rf' {name}="[^"]*"', f' {name}="{value}"', text)
                    assert count, name
                data = text.encode()
            new.writestr(entry, data)
    return made


@pytest.fixture(scope="module")
def export(tmp_path_factory: pytest.TempPathFactory) -> Export:
    """Exports a block once, by its class: export(Displaced, 3, providesIntermediateUpdate="false")."""
    folder = tmp_path_factory.mktemp("exported")
    known: dict[Any, Path] = {}

    def exported(cls: type[Block], fmi: int, **changes: str) -> Path:
        key = (cls, fmi)
        if key not in known:
            diagram = Diagram.alone(cls())
            diagram.settings(**TIGHT)
            known[key] = folder / f"{cls.__name__}{fmi}.fmu"
            diagram.export(known[key], fmi=fmi)
        if not changes:
            return known[key]
        other = (cls, fmi, *changes.items())
        if other not in known:
            known[other] = told_otherwise(known[key], changes)
        return known[other]

    return exported


def two_masses(a: Block, b: Block) -> Diagram:
    made = Diagram("two")
    one, other = made.add("a", a), made.add("b", b)
    made.wire(one.F, other.F)
    made.wire(other.x1, one.x)
    made.wire(other.v1, one.v)
    return made


def errors(a: Block, b: Block, engine: str, loops: str = "error", **master: Any) -> list[float]:
    made = []
    for H in HS:
        results = two_masses(a, b).run(stop=10, engine=engine, loops=loops, master={"step": H, **master}, **TIGHT)
        made.append(error_of(results))
    return made


# --- two masses ------------------------------------------------------------------------------------------------


@each_engine_and_fmi
@pytest.mark.parametrize(("algorithm", "order"), TABLE)
def test_two_masses_have_the_errors_of_the_table(
    export: Export, algorithm: str, order: int, fmi: int, engine: str
) -> None:
    """By input derivatives in FMI 2, and by intermediate update in FMI 3."""
    pair = (fmu(export(cls, fmi), "CS") for cls in (Displaced, Forced))
    assert errors(*pair, engine, algorithm=algorithm, order=order) == pytest.approx(TABLE[algorithm, order], rel=0.01)


@each_engine_and_fmi
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_parabolas_reach_fmus_too(export: Export, algorithm: str, fmi: int, engine: str) -> None:
    pair = [fmu(export(cls, fmi), "CS") for cls in (Displaced, Forced)]
    theirs = errors(*pair, engine, algorithm=algorithm, order=2)
    assert np.log2(np.divide(theirs[:-1], theirs[1:])) == pytest.approx([3, 3], abs=0.1)
    ours = errors(Displaced(), Forced(), engine, algorithm=algorithm, order=2, couple="each")
    assert theirs == pytest.approx(ours, rel=1e-3)


@each_engine
def test_an_fmu_beside_an_island_has_the_same_errors(export: Export, engine: str) -> None:
    """One mass as an FMU, the other with its equations: also where one has FMI 2 and the other FMI 3."""
    told = pytest.approx(TABLE["gauss-seidel", 1], rel=0.01)
    assert errors(fmu(export(Displaced, 2), "CS"), Forced(), engine, algorithm="gauss-seidel", order=1) == told
    assert errors(Displaced(), fmu(export(Forced, 3), "CS"), engine, algorithm="gauss-seidel", order=1) == told
    pair = fmu(export(Displaced, 3), "CS"), fmu(export(Forced, 2), "CS")
    assert errors(*pair, engine, algorithm="gauss-seidel", order=1) == told


MEAN = {
    ("jacobi", 0): TABLE["jacobi", 0],
    ("jacobi", 1): (5.865e-3, 1.481e-3, 3.711e-4),
    ("jacobi", 2): (1.467e-3, 3.911e-4, 9.849e-5),
    ("gauss-seidel", 1): (4.828e-3, 1.200e-3, 2.987e-4),
    ("iterated", 1): (3.058e-3, 7.630e-4, 1.907e-4),
}
"""Where FMUs take the mean over a step: of order 2. That of jacobi, 1 is published as 5.8e-3, 1.47e-3, 3.7e-4."""


@functools.cache
def two_masses_by_means(H: float, order: int) -> Array:
    """Jacobi, with each input held on the mean over the step of what is extrapolated, without any FMU."""
    a, b = np.array([[0.0, 1], [-1, -0.1]]), np.array([[0.0, 1], [-2, -0.2]])

    def step(matrix: Array, x: Array, push: float) -> Array:
        augmented = np.zeros((3, 3))
        augmented[:2, :2], augmented[1, 2] = matrix, push
        return (expm(H * augmented) @ [*x, 1.0])[:2]

    x, z = np.array([1.0, 0.0]), np.zeros(2)
    F = z[0] - x[0] + 0.1 * (z[1] - x[1])
    old: Any = None
    for _ in range(round(10 / H)):
        now = np.array([F, *x])
        mean = now if old is None or order == 0 else now + (now - old) / 2
        old = now
        x, z = step(a, x, mean[0]), step(b, z, mean[1] + 0.1 * mean[2])
        F = z[0] - x[0] + 0.1 * (z[1] - x[1])
    return np.array([*x, *z])


@each_engine_and_fmi
@pytest.mark.parametrize(("algorithm", "order"), MEAN)
def test_an_fmu_that_takes_no_course_gets_the_mean(
    export: Export, algorithm: str, order: int, fmi: int, engine: str
) -> None:
    pair = [fmu(export(cls, fmi, **MUTE[fmi]), "CS") for cls in (Displaced, Forced)]
    made = errors(*pair, engine, algorithm=algorithm, order=order)
    assert made == pytest.approx(MEAN[algorithm, order], rel=0.01)
    if order:
        assert np.log2(np.divide(made[:-1], made[1:])) == pytest.approx([2, 2], abs=0.1)
    if algorithm == "jacobi" and order < 2:
        theirs = [np.abs(two_masses_by_means(H, order) - EXACT).max() for H in HS]
        assert made == pytest.approx(theirs, rel=1e-4)


@pytest.mark.parametrize("printed", [(5.8e-3, 1.47e-3, 3.7e-4)])
def test_the_mean_of_a_line_has_the_published_errors(printed: tuple[float, ...]) -> None:
    assert MEAN["jacobi", 1] == pytest.approx(printed, rel=0.012)


@each_engine_and_fmi
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("tolerances", [(1e-2, 1e-3), (1e-4, 1e-5)])
def test_a_tolerance_is_held_where_fmus_cannot_go_back(
    export: Export, tolerances: tuple[float, ...], order: int, fmi: int, engine: str
) -> None:
    """By what was predicted: a tolerance of the inputs at all times, of which the error at the end is about a part."""
    pair = [fmu(export(cls, fmi, **FIXED[fmi]), "CS") for cls in (Displaced, Forced)]
    made, rows = [], []
    for tolerance in tolerances:
        master = {"step": 0.1, "order": order, "tolerance": tolerance}
        results = two_masses(*pair).run(stop=10, engine=engine, master=master, **TIGHT)
        made.append(error_of(results) / tolerance)
        rows.append(len(results.t))
        assert results.statistics.rejected == 0
    assert max(made) < 1.0
    assert max(made) < 20 * min(made)
    for one, other in itertools.pairwise(rows):
        assert other / one == pytest.approx(10 ** (1 / (order + 1)), rel=0.35)


@each_engine_and_fmi
@pytest.mark.parametrize("order", [1, 2])
def test_a_tolerance_is_held_where_fmus_go_back(export: Export, order: int, fmi: int, engine: str) -> None:
    pair = [fmu(export(cls, fmi), "CS") for cls in (Displaced, Forced)]
    for tolerance in (1e-2, 1e-4, 1e-6) if engine == "native" else (1e-2, 1e-3):
        master = {"step": 0.1, "order": order, "tolerance": tolerance}
        results = two_masses(*pair).run(stop=10, engine=engine, master=master, **TIGHT)
        assert 0.01 * tolerance < error_of(results) < tolerance


@each_engine_and_fmi
def test_what_cannot_go_back_is_not_iterated(export: Export, fmi: int, engine: str) -> None:
    """Both extrapolate then, as Gauss-Seidel does in the order of the units."""
    pair = [fmu(export(cls, fmi, **FIXED[fmi]), "CS") for cls in (Displaced, Forced)]
    made = errors(*pair, engine, algorithm="iterated", order=1)
    assert made == pytest.approx(TABLE["gauss-seidel", 1], rel=0.01)


# --- the linear loop -------------------------------------------------------------------------------------------


def linear_loop(a: Block, b: Block) -> Diagram:
    made = Diagram("loop")
    one, other = made.add("a", a), made.add("b", b)
    made.wire(one.u, other.y)
    made.wire(other.u, one.y)
    return made


@each_engine_and_fmi
def test_the_linear_loop_is_solved_across_fmus(export: Export, fmi: int, engine: str) -> None:
    pair = [fmu(export(cls, fmi), "CS") for cls in (First, Second)]
    found = []
    for H in (0.005, 0.0025):
        results = linear_loop(*pair).run(
            stop=1, loops="solve", engine=engine, master={"step": H, "algorithm": "iterated", "order": 2}, **TIGHT
        )
        assert results["a.y"][0] == pytest.approx(-14.736842105263158, abs=1e-9)
        assert results["b.y"][0] == pytest.approx(-17.736842105263158, abs=1e-9)
        found.append(max(abs(results["a.x"][-1] - AT_1[0]), abs(results["b.x"][-1] - AT_1[1])))
    assert found[1] < 1e-8 * 30
    assert math.log2(found[0] / found[1]) == pytest.approx(3, abs=0.6)
    with pytest.raises(ModelError, match=r"E102 [ab]\.y: algebraic loop: a\.y -> b\.y -> a\.y\."):
        linear_loop(*pair).run(stop=1, engine=engine)


# --- a motor in a loop -----------------------------------------------------------------------------------------


def motor_loop(motor: Block) -> Diagram:
    made = Diagram("motor")
    wanted, control, one = (
        made.add("wanted", Step(at=0.1)), made.add("control", PID(kp=2.0, ki=5.0)), made.add("motor", motor),
    )  # fmt: skip
    made.wire(control.r, wanted.y)
    made.wire(control.y, one.omega)
    made.wire(one.v, control.u)
    return made


@pytest.fixture(scope="module")
def alone() -> Results:
    return motor_loop(PMDCMotor()).run(stop=1, every=0.01, engine="native", **TIGHT)


# The reference engine takes long, and steps the two masses in all ways.
@pytest.mark.parametrize(
    ("engine", "fmi", "algorithm", "order", "error"),
    [
        (pytest.param if engine == "native" or case[1] == 2 else long)(engine, fmi, *case)
        for engine in ("native", "reference")
        for fmi in (2, 3)
        for case in (
            ("jacobi", 0, 1e-3), ("jacobi", 1, 1.5e-6), ("jacobi", 2, 3e-9), ("gauss-seidel", 0, 1e-3),
            ("gauss-seidel", 1, 1.5e-6), ("gauss-seidel", 2, 3e-9), ("iterated", 1, 5e-7), ("iterated", 2, 1e-9),
        )
    ],
)  # fmt: skip
def test_a_motor_from_a_file_turns_as_the_block_does(
    alone: Results, algorithm: str, order: int, error: float, fmi: int, engine: str
) -> None:
    master = {"step": 0.001, "algorithm": algorithm, "order": order}
    diagram = motor_loop(fmu(MOTORS[fmi], "CS"))
    results = diagram.run(stop=1, every=0.01, engine=engine, rtol=1e-9, atol=1e-11, master=master)
    times = np.arange(101) / 100
    for name in ("motor.omega", "control.u"):
        ours, theirs = alone[name][rows_at(alone, times)], results[name][rows_at(results, times)]
        assert np.abs(ours - theirs).max() < error * max(1.0, np.abs(ours).max()), name


def test_an_fmu_of_a_file_is_found_from_the_folder_of_the_file(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "fmus", tmp_path / "fmus")
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / "d").mkdir()
    diagram = motor_loop(fmu(tmp_path / "fmus" / "PMDCMotor.fmu", "CS"))
    diagram.save(tmp_path / "d" / "loop.json")
    again = Diagram.load(tmp_path / "d" / "loop.json")
    settings: dict[str, Any] = {"stop": 0.3, "master": {"step": 0.01}}
    assert np.array_equal(again.run(**settings).values, diagram.run(**settings).values)


@each_engine_and_fmi
def test_parameters_and_start_values_reach_the_fmu(fmi: int, engine: str) -> None:
    """A motor that turns already, with another resistance, against the block."""
    runs = []
    for motor in (PMDCMotor(Ra=0.2, omega_start=3.0), fmu(MOTORS[fmi], "CS", Ra=0.2, omega_start=3.0)):
        made = Diagram("m")
        v, one = made.add("v", Constant(value=6.0)), made.add("motor", motor)
        made.wire(one.v, v.y)
        runs.append(made.run(stop=0.5, every=0.05, engine=engine, master={"step": 0.05}, **TIGHT))
    assert runs[1]["motor.omega"][0] == 3.0
    assert np.allclose(runs[0]["motor.omega"], runs[1]["motor.omega"], rtol=1e-6)
    assert np.allclose(runs[0]["motor.i"], runs[1]["motor.i"], rtol=1e-6)
    other = Diagram("m")
    v, one = other.add("v", Constant(value=6.0)), other.add("motor", fmu(MOTORS[fmi], "CS"))
    other.wire(one.v, v.y)
    assert other.run(stop=0.5, engine=engine, master={"step": 0.05})["motor.omega"][-1] != pytest.approx(
        runs[1]["motor.omega"][-1], rel=1e-3
    )


class InMillimeters(Block):
    """x' = u, in mm, and what stands inside of it."""

    gain = Parameter(2.0, unit="mm/s")
    u = Input(unit="mm/s")
    x = State(5.0, unit="mm", output=True)

    @x.derivative
    def dx(u, gain):
        return u + gain

    @output(unit="km/h")
    def speed(u, gain):
        return u + gain


@each_engine_and_fmi
def test_units_that_are_not_si_are_scaled_and_locals_can_be_recorded(export: Export, fmi: int, engine: str) -> None:
    results = []
    for block in (InMillimeters(), fmu(export(InMillimeters, fmi), "CS")):
        made = Diagram("units")
        u, one = made.add("u", Constant(value={"value": 30, "unit": "cm/s"}, unit="cm/s")), made.add("one", block)
        made.wire(one.u, u.y)
        results.append(made.run(stop=1, engine=engine, master={"step": 0.1}))
    for name in ("one.x", "one.speed"):
        assert results[1][name][-1] == pytest.approx(results[0][name][-1], rel=1e-9)
        assert results[1][name].unit == results[0][name].unit
    foreign = fmu(export(InMillimeters, fmi), "CS")
    rate = next(name for name in type(foreign).declaration.readable if name.startswith("der("))
    made = Diagram("units")
    u, one = made.add("u", Constant(value=0.3, unit="m/s")), made.add("one", foreign)
    made.wire(one.u, u.y)
    told = made.run(stop=1, engine=engine, master={"step": 0.1}, log=[f"one.{rate}", "one.speed"])
    assert list(told) == [f"one.{rate}", "one.speed"]
    assert told[f"one.{rate}"] == pytest.approx(told["one.speed"], rel=1e-9)


# --- types, arrays ---------------------------------------------------------------------------------------------


class Kinds(Block):
    """What is whole, true or one of some, of x."""

    x = Input()

    @output(type="int")
    def rounded(x):
        return np.floor(x)

    @output(type="bool")
    def positive(x):
        return x > 0

    @output
    def times(x):
        return 10 * x


@each_engine_and_fmi
def test_whole_numbers_and_truth_go_through_the_master(export: Export, fmi: int, engine: str) -> None:
    made = Diagram("kinds")
    wave, one = made.add("wave", Sine(amplitude=3.0, omega=2.0)), made.add("one", fmu(export(Kinds, fmi), "CS"))
    made.wire(one.x, wave.y)
    results = made.run(stop=3, every=0.1, engine=engine, master={"step": 0.1, "order": 0})
    x = results["wave.y"]
    assert np.array_equal(results["one.rounded"], np.floor(x))
    assert np.array_equal(results["one.positive"], x > 0)


@each_engine_and_fmi
def test_inputs_and_parameters_of_all_types_reach_an_fmu(tmp_path: Path, fmi: int, engine: str) -> None:
    """x' = k u; what is no real number is told back by locals of the same values."""
    path = make(tmp_path, fmi=fmi)
    block = fmu(path, "CS", k=2.5, d=0.5, x_start=1.0, label="wheel")
    made = Diagram("types")
    one = made.add("one", block)
    made.wire(one.u, made.input("u", default=2.0))
    made.wire(one.on, made.input("on", type="bool", default=True))
    results = made.run(stop=1, engine=engine, master={"step": 0.1, "algorithm": "gauss-seidel", "order": 2})
    assert results["one.y"][-1] == pytest.approx(1 + 2.5 * 2 * 1 + 0.5 * 2, rel=1e-9)
    assert results["one.y"][0] == pytest.approx(1 + 0.5 * 2)
    assert results["one.count"].dtype.kind in "if"


@each_engine
def test_arrays_with_structural_parameters(tmp_path: Path, engine: str) -> None:
    """w = 2 v of n elements, which are inputs one by one."""
    path = make(tmp_path, fmi=3)
    made = Diagram("arrays")
    one = made.add("one", fmu(path, "CS"))
    made.wire(one.v, made.input("v", size=3))
    made.wire(one.u, made.input("u", default=0.0))
    inputs = {"v": [1.0, -2.0, 4.0]}
    results = made.run(stop=0.5, engine=engine, inputs=inputs, master={"step": 0.1})
    assert results["one.w"].shape[1:] == (3,)
    assert results["one.w"][-1].tolist() == pytest.approx([2.0, -4.0, 8.0])


# --- events ----------------------------------------------------------------------------------------------------


@each_engine
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_sampled_controller_from_a_file_acts_as_its_diagram(algorithm: str, engine: str) -> None:
    """The paper's robot under digital controllers, one of them an FMU in event mode, whose ticks are points of all."""
    stop = 0.3 if engine == "reference" else 2.0
    native = Diagram.load(PAPER / "iadrc_sampled.json")
    swapped = Diagram.load(PAPER / "iadrc_sampled.json")
    swapped.swap("control_right", fmu(IADRC, "CS"))
    settings: dict[str, Any] = {
        "stop": stop, "every": 0.01, "engine": engine, "rtol": 1e-9, "atol": 1e-11,
        "parameters": {"torque_on": 0.5 * stop, "torque_off": 0.8 * stop},
        "log": ["motor_right.omega", "motor_left.omega", "control_right.u", "control_right.z3", "robot.theta"],
    }  # fmt: skip
    ours = native.run(**settings)
    theirs = swapped.run(master={"step": 0.001, "algorithm": algorithm, "order": 2}, **settings)
    times = np.arange(round(stop / 0.01)) / 100
    for name in ours:
        one, other = ours[name][rows_at(ours, times)], theirs[name][rows_at(theirs, times)]
        assert np.abs(one - other).max() <= 1e-7 * np.ptp(one) + 1e-12, name


@each_engine_and_fmi
@pytest.mark.parametrize("H", [0.1, 0.03])
@pytest.mark.parametrize(
    ("algorithm", "order"),
    [("jacobi", 2), ("jacobi", 1), ("iterated", 1)],
)
def test_an_island_switches_what_an_fmu_drives(
    export: Export, algorithm: str, order: int, H: float, fmi: int, engine: str
) -> None:
    made = Diagram("thermostat")
    switch, lag = made.add("switch", Switching()), made.add("lag", fmu(export(Lag, fmi), "CS"))
    made.wire(lag.u, switch.on)
    made.wire(switch.u, lag.x)
    results = made.run(stop=3, engine=engine, master={"step": H, "algorithm": algorithm, "order": order}, **TIGHT)
    assert [event.what for event in results.events] == ["high", "low"] * 3
    assert [event.t for event in results.events] == pytest.approx(switched_at(6), abs=0.5 * H**order)


@each_engine_and_fmi
def test_an_fmu_switches_what_an_island_drives(export: Export, fmi: int, engine: str) -> None:
    """In FMI 3 the crossing inside of the FMU is an early return; in FMI 2 it is seen at the next point."""
    made = Diagram("thermostat")
    switch, lag = made.add("switch", fmu(export(Switching, fmi), "CS")), made.add("lag", Lag())
    made.wire(lag.u, switch.on)
    made.wire(switch.u, lag.x)
    results = made.run(stop=3, engine=engine, master={"step": 0.01, "order": 2}, **TIGHT)
    on = results["switch.on"]
    switches = results.t[1:][np.diff(on) != 0]
    told = switched_at(6)
    if fmi == 3:
        assert switches == pytest.approx(told, abs=1e-4)
    else:
        assert len(switches) in (5, 6)
        assert 0 <= switches[0] - told[0] <= 0.01 + 1e-12


@each_engine_and_fmi
def test_an_fmu_that_cannot_go_back_keeps_its_time_beside_events(export: Export, fmi: int, engine: str) -> None:
    """The island has a crossing in nearly each step; the FMU is stepped from point to point of its own."""
    made = Diagram("beside")
    wave, ball = made.add("wave", Sine(omega=5.0)), made.add("lag", fmu(export(Lag, fmi, **FIXED[fmi]), "CS"))
    fast, switch = made.add("fast", Sine(omega=40.0)), made.add("switch", Switching())
    made.wire(switch.u, fast.y)
    made.wire(ball.u, wave.y)
    results = made.run(stop=1, engine=engine, master={"step": 0.01, "order": 2}, **TIGHT)
    t = results.t[-1]
    exact = (math.sin(5 * t) - 5 * math.cos(5 * t) + 5 * math.exp(-t)) / 26
    assert results["lag.x"][-1] == pytest.approx(exact, abs=5e-4)  # a jump clears what is known of the wave, too
    assert len(results.events) > 10


# --- many ------------------------------------------------------------------------------------------------------


@each_engine
def test_a_hundred_instances_of_one_file_in_a_ring(export: Export, engine: str) -> None:
    """x_i' = x_(i-1) - x_i, against the exponential of the matrix of the ring."""
    n, H = 100, 0.02 if engine == "native" else 0.1
    made = Diagram("ring")
    ones = [made.add(f"m{i}", fmu(export(Lag, 2), "CS", x_start=math.sin(i))) for i in range(n)]
    for i, one in enumerate(ones):
        made.wire(one.u, ones[i - 1].x)
    results = made.run(stop=1, engine=engine, master={"step": H, "order": 2}, log=[f"m{i}.x" for i in range(n)])
    A = np.roll(np.eye(n), -1, axis=1) - np.eye(n)
    exact = expm(A) @ np.sin(np.arange(n))
    assert [results[f"m{i}.x"][-1] for i in range(n)] == pytest.approx(exact, abs=H**3)


# --- the paper -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [0, 2])
def test_the_paper_s_robot_with_motors_from_a_file(order: int) -> None:
    settings: dict[str, Any] = {
        "stop": 6.0, "rtol": 1e-9, "atol": 1e-11, "engine": "native",
        "parameters": {"torque_on": 3.0, "torque_off": 4.5},
    }  # fmt: skip
    native = Diagram.load(PAPER / "iadrc.json").run(**settings)
    master = {"step": 0.001, "order": order}
    theirs = Diagram.load(PAPER / "iadrc_fmu.json").run(master=master, **settings)
    times = np.arange(600) / 100
    for name in native:
        one, other = native[name][rows_at(native, times)], theirs[name][rows_at(theirs, times)]
        span = float(np.ptp(one)) or 1.0
        assert np.abs(one - other).max() < {0: 2e-2, 2: 5e-4}[order] * span, name
    for name, value in native.measures.items():
        assert theirs.measures[name] == pytest.approx(value, rel={0: 0.05, 2: 1e-3}[order], abs=1e-9), name


# --- FMUs that are Python programs -----------------------------------------------------------------------------

SLAVES = """
import math
{imports}


class {name}({bases}):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.x, self.v, self.F, self.x1, self.v1 = {start}, 0.0, 0.0, 0.0, 0.0
        {time}
        for name in {inputs}:
            self.register_variable({real}(name, causality={causality}.input, start=0.0{more}))
        for name in {outputs}:
            self.register_variable({real}(name, causality={causality}.output{more}))
        self.register_variable({real}("F", causality={causality}.{of_F}{more_F}))

    def force(self):
        return self.x - self.x1 + 0.1 * (self.v - self.v1)

    def do_step(self, t, h):
        # An oscillator with a constant push: exact.
        c, d, push = {system}
        w = math.sqrt(c - d * d / 4)
        z, v = self.x - push / c, self.v
        e, co, si = math.exp(-d * h / 2), math.cos(w * h), math.sin(w * h)
        self.x = push / c + e * (z * co + (v + d * z / 2) / w * si)
        self.v = e * (v * co - (c * z + d * v / 2) / w * si)
        return True
"""


def slave(folder: Path, fmi: int, first: bool) -> Path:
    """An FMU in Python of one of the masses, which holds its inputs over a step."""
    module = "pythonfmu" if fmi == 2 else "pythonfmu3"
    builder = pytest.importorskip(f"{module}.builder")
    name = f"Mass{1 if first else 2}Of{fmi}"
    imports = (
        "from pythonfmu import Fmi2Causality, Fmi2Slave, Real" if fmi == 2
        else "from pythonfmu3 import CoSimulation, Fmi3Causality, Fmi3SlaveBase, Fmi3Variability, Float64"
    )  # fmt: skip
    time = (
        "pass" if fmi == 2
        else "self.time = 0.0; self.register_variable(Float64('time', causality=Fmi3Causality.independent, "
        "variability=Fmi3Variability.continuous))"
    )  # fmt: skip
    text = SLAVES.format(
        name=name, imports=imports, bases="Fmi2Slave" if fmi == 2 else "Fmi3SlaveBase, CoSimulation",
        start=1.0 if first else 0.0, time=time, real="Real" if fmi == 2 else "Float64",
        causality=f"Fmi{fmi}Causality", more="" if fmi == 2 else ", variability=Fmi3Variability.continuous",
        inputs=() if first else ("x1", "v1"), outputs=("x", "v"), of_F="input" if first else "output",
        more_F=(", start=0.0" if first else ", getter=self.force")
        + ("" if fmi == 2 else ", variability=Fmi3Variability.continuous"),
        system="1.0, 0.1, self.F" if first else "2.0, 0.2, self.x1 + 0.1 * self.v1",
    )  # fmt: skip
    folder.mkdir(exist_ok=True)
    source = folder / f"{name.lower()}.py"
    source.write_text(text, encoding="utf-8")
    builder.FmuBuilder.build_FMU(str(source), dest=str(folder))
    return folder / f"{name}.fmu"


@each_engine_and_fmi
@pytest.mark.parametrize(
    ("algorithm", "order"), [("jacobi", 0), ("jacobi", 1), ("gauss-seidel", 0), ("gauss-seidel", 1)]
)
def test_masses_that_are_python_programs_have_the_errors_of_the_table(
    tmp_path: Path, algorithm: str, order: int, fmi: int, engine: str
) -> None:
    """They take no course of an input and cannot go back: order 1 is the mean over a step.

    They do not say what their outputs depend on at once, so that a loop is assumed, and solved where that is asked.
    """
    a, b = (fmu(slave(tmp_path / str(fmi), fmi, first), "CS") for first in (True, False))
    told = TABLE if order == 0 else MEAN
    made = errors(a, b, engine, algorithm=algorithm, order=order, loops="solve")
    assert made == pytest.approx(told[algorithm, order], rel=0.01)


@each_fmi
def test_an_fmu_that_needs_python_is_not_isolated(tmp_path: Path, fmi: int) -> None:
    path = slave(tmp_path, fmi, True)
    assert "not with isolate: its binary takes symbols of Python" in tell(path).check()
    assert "isolate" not in tell(MOTORS[fmi]).check()
    assert Diagram.alone(fmu(path)).run(stop=0.1)["x"][-1] < 1.0
    with pytest.raises(FMUError, match=r"E208 .* needs the symbol _?Py\w+ of Python.*Run the FMU without isolate"):
        Diagram.alone(fmu(path, isolate=True)).run(stop=0.1)


@each_fmi
def test_an_fmu_that_tells_no_dependencies_is_warned_of(tmp_path: Path, fmi: int) -> None:
    a, b = (fmu(slave(tmp_path / str(fmi), fmi, first), "CS") for first in (True, False))
    faults = two_masses(a, b).check().warnings
    assert [(fault.code, fault.place) for fault in faults if fault.code == "W204"] == [("W204", "a"), ("W204", "b")]


@each_fmi
def test_without_known_dependencies_both_engines_do_the_same(tmp_path: Path, fmi: int) -> None:
    a, b = (fmu(slave(tmp_path / str(fmi), fmi, first), "CS") for first in (True, False))
    made = [errors(a, b, engine, algorithm="jacobi", order=1) for engine in ("reference", "native")]
    assert made[0] == pytest.approx(made[1], rel=1e-6)


# --- FMUs whose communication steps must not differ: the integrator refuses any other step ----


def integrated(path: Path, signal: Block) -> Diagram:
    d = Diagram("integrated")
    d.wire(d.add("plant", fmu(path, "CS")).u, d.add("signal", signal).y)
    return d


@each_engine_and_fmi
@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "iterated"])
def test_a_jump_between_the_points_of_a_rigid_fmu_acts_at_its_next_one(
    tmp_path: Path, algorithm: str, order: int, fmi: int, engine: str
) -> None:
    d = integrated(make(tmp_path, fmi=fmi, any_step=False), Step(at=0.505, before=1.0, after=2.0))
    master = {"step": 0.01, "algorithm": algorithm, "order": order}
    results = d.run(stop=1.0, every=0.01, engine=engine, master=master)
    assert results["plant.y"] == pytest.approx(np.where(results.t < 0.51, results.t, 2 * results.t - 0.51), abs=1e-12)
    (warning,) = [w for w in results.warnings if w.code == "W209"]
    assert warning.place == "plant"
    assert "t = 0.505 s" in warning.message


@each_engine_and_fmi
def test_ticks_between_the_points_of_a_rigid_fmu_wait_for_them(tmp_path: Path, fmi: int, engine: str) -> None:
    """A ramp held every 3 ms reaches an FMU with steps of 10 ms by its value at the points."""
    d = Diagram("held")
    held, ramp = d.add("held", ZeroOrderHold(period=0.003)), d.add("ramp", Ramp())
    d.wire(held.u, ramp.y)
    d.wire(d.add("plant", fmu(make(tmp_path, fmi=fmi, any_step=False), "CS")).u, held.y)
    results = d.run(stop=0.3, every=0.01, engine=engine, log=["plant.y"], master={"step": 0.01})
    points = np.arange(31) * 10
    given = (points // 3) * 0.003
    assert results["plant.y"] == pytest.approx(np.concatenate([[0.0], np.cumsum(0.01 * given[:-1])]), abs=1e-12)


@each_engine_and_fmi
def test_a_jump_of_an_input_of_the_diagram_waits_for_a_rigid_fmu(tmp_path: Path, fmi: int, engine: str) -> None:
    d = Diagram("driven")
    d.wire(d.add("plant", fmu(make(tmp_path, fmi=fmi, any_step=False), "CS")).u, d.input("drive"))
    drive = {"drive": ([0.0, 0.505, 1.0], [1.0, 2.0, 2.0], "hold")}
    results = d.run(stop=1.0, every=0.5, engine=engine, inputs=drive, log=["plant.y"], master={"step": 0.01})
    assert results["plant.y"] == pytest.approx([0.0, 0.5, 0.51 + 2 * 0.49], abs=1e-12)
    assert [w.code for w in results.warnings] == ["W209"]


@each_engine_and_fmi
def test_what_is_set_between_the_points_of_a_rigid_fmu_waits(tmp_path: Path, fmi: int, engine: str) -> None:
    d = Diagram("driven")
    d.wire(d.add("plant", fmu(make(tmp_path, fmi=fmi, any_step=False), "CS")).u, d.input("drive"))
    run = d.start(stop=1.0, engine=engine, inputs={"drive": 1.0}, log=["plant.y"], master={"step": 0.01})
    run.advance_to(0.505)
    run.set("drive", 2.0)
    run.advance_to(0.507)
    run.set("drive", 3.0)
    assert run.finish()["plant.y"][-1] == pytest.approx(0.51 + 3 * 0.49, abs=1e-12)


@each_engine_and_fmi
def test_a_run_with_a_rigid_fmu_ends_at_its_last_point_before_the_stop(tmp_path: Path, fmi: int, engine: str) -> None:
    d = integrated(make(tmp_path, fmi=fmi, any_step=False), Constant(value=1.0))
    results = d.run(stop=1.005, engine=engine, log=["plant.y"], master={"step": 0.01})
    assert (results.t[-1], results["plant.y"][-1]) == pytest.approx((1.0, 1.0), abs=1e-12)
    (warning,) = results.warnings
    assert (warning.code, warning.place) == ("W209", "plant")
    assert "the run ends at 1 s" in warning.message
    with pytest.raises(ModelError, match=r"E115 plant: .* the run is shorter than one step"):
        d.run(stop=0.005, engine=engine, master={"step": 0.01})


# --- what nobody reads ----


@functools.cache
def lag_fmu(fmi: int) -> Path:
    """x' = (u - x) / 0.3, exported."""
    return exported(Diagram.alone(FirstOrder(T=0.3)), fmi=fmi, kinds=("CS",)).path


UNREAD: Mapping[str, Callable[[Diagram], Any]] = {
    "delay": lambda d: d.add("more", TransportDelay(delay=0.13)),
    "delay between points": lambda d: d.add("more", TransportDelay(delay=0.1234)),
    "hold": lambda d: d.add("more", ZeroOrderHold(period=0.01)),
    "hold between points": lambda d: d.add("more", ZeroOrderHold(period=0.003)),
    "relay": lambda d: d.add("more", Relay(on_at=0.5, off_at=-0.5)),
    "counter": lambda d: d.add("more", Counter()),
}


@each_engine
@pytest.mark.parametrize(("algorithm", "order"), [("jacobi", 1), ("gauss-seidel", 2), ("iterated", 2)])
@pytest.mark.parametrize("what", UNREAD)
def test_a_part_that_nobody_reads_changes_nothing(what: str, algorithm: str, order: int, engine: str) -> None:
    """The other parts of the run are the same to the last bit, and so are the communication points.

    Where steps are repeated, their number says nothing: blocks with a delay cannot go back.
    """

    def made(add: Callable[[Diagram], Any] | None) -> Results:
        d = Diagram("lagging")
        sine = d.add("sine", Sine(omega=4.0, amplitude=1.5))
        d.wire(d.add("lag", fmu(lag_fmu(2), "CS")).u, sine.y)
        if add is not None:
            d.wire(add(d).u, sine.y)
        master = {"step": 0.01, "algorithm": algorithm, "order": order}
        return d.run(stop=1.5, every=0.1, log=["lag.y"], engine=engine, master=master)

    alone, beside = made(None), made(UNREAD[what])
    assert np.array_equal(alone["lag.y"], beside["lag.y"])
    assert algorithm != "jacobi" or alone.statistics.steps == beside.statistics.steps


def test_courses_beside_equal_blocks_end_at_the_events_that_they_follow() -> None:
    """The native engine keeps the states of equal blocks together: those of the ball have other places in C."""
    d = Diagram("bounced")
    sine = d.add("sine", Sine(omega=4.0))
    many = d.add("many", FirstOrder(T=[0.2, 0.3]), copies=2)
    for block in (many, d.add("a", FirstOrder(T=0.2)), d.add("b", FirstOrder(T=0.3))):
        d.wire(block.u, sine.y)
    ball, observer = d.add("ball", BouncingBall(h_start=0.5, e=0.6)), d.add("observer", LESO(bandwidth=4.0))
    d.wire(observer.y, ball.h)
    d.wire(observer.u, sine.y)
    d.wire(d.add("lag", fmu(lag_fmu(2), "CS")).u, observer.z1)
    settings: dict[str, Any] = {"log": ["lag.y"], "rtol": 1e-10, "atol": 1e-12, "master": {"step": 0.01, "order": 1}}
    native, reference = (d.run(stop=1.0, every=0.1, engine=engine, **settings) for engine in ("native", "reference"))
    assert np.abs(native["lag.y"] - reference["lag.y"]).max() < 1e-9


@each_engine
def test_an_fmu_that_reads_a_hold_leaves_the_inputs_of_another_extrapolated(engine: str) -> None:
    d = Diagram("two")
    sine = d.add("sine", Sine(omega=4.0, amplitude=1.5))
    d.wire(d.add("lag", fmu(lag_fmu(2), "CS")).u, sine.y)
    d.wire(d.add("held", ZeroOrderHold(period=0.01)).u, sine.y)
    d.wire(d.add("other", fmu(lag_fmu(2), "CS")).u, "held.y")
    results = d.run(stop=1.5, every=0.1, log=["lag.y"], engine=engine, master={"step": 0.01, "order": 1})
    t, T, w = results.t, 0.3, 4.0
    exact = 1.5 / (1 + (w * T) ** 2) * (np.sin(w * t) - w * T * np.cos(w * t) + w * T * np.exp(-t / T))
    assert np.abs(results["lag.y"] - exact).max() < 1e-3  # held: 2e-2


@each_engine
def test_communication_points_do_not_come_back_out_of_a_delay(engine: str) -> None:
    """A delay between two FMUs: the points of 10 ms, the start of the delayed signal, and no others."""
    d = Diagram("chain")
    sine = d.add("sine", Sine(omega=4.0, amplitude=1.5))
    d.wire(d.add("lag", fmu(lag_fmu(2), "CS")).u, sine.y)
    d.wire(d.add("late", TransportDelay(delay=0.1234)).u, "lag.y")
    d.wire(d.add("other", fmu(lag_fmu(2), "CS")).u, "late.y")
    results = d.run(stop=1.5, every=0.1, log=["late.y", "other.y"], engine=engine, master={"step": 0.01, "order": 1})
    assert results.statistics.steps <= 3 * 152
    t = np.maximum(results.t - 0.1234, 0.0)
    T, w = 0.3, 4.0
    exact = 1.5 / (1 + (w * T) ** 2) * (np.sin(w * t) - w * T * np.cos(w * t) + w * T * np.exp(-t / T))
    assert np.abs(results["late.y"] - exact).max() < 3e-3  # in the first step the sine is held


@each_engine
@pytest.mark.parametrize("order", [1, 2])
def test_a_delayed_input_with_bends_is_extrapolated_to_the_full_order(order: int, engine: str) -> None:
    """The bends come out of the delay between communication points, and rounding at these makes no jumps."""
    d = Diagram("bends")
    late, lag = d.add("late", TransportDelay(delay=0.21)), d.add("lag", FirstOrder(k=1.5, T=0.3))
    d.wire(d.add("driven", Sum(signs="+")).u1, d.input("drive"))
    d.wire(late.u, "driven.y")
    d.wire(lag.u, late.y)
    d.wire(d.add("after", FirstOrder(T=0.25)).u, lag.y)
    settings: dict[str, Any] = {"stop": 2.0, "every": 0.1, "rtol": 1e-10, "atol": 1e-12, "engine": engine}
    settings["inputs"] = {"drive": ([0.113, 0.517, 0.9, 1.31], [0.5, -0.1, -0.9, 0.4], "linear")}
    exact = d.run(**settings)["after.y"]
    d.swap("lag", fmu(lag_fmu(2), "CS"))
    steps = [{"step": step, "algorithm": "jacobi", "order": order} for step in (0.01, 0.005)]
    long, short = (np.abs(d.run(**settings, master=master)["after.y"] - exact).max() for master in steps)
    assert math.log2(long / short) == pytest.approx(order + 1, abs=0.1)


@pytest.mark.parametrize(("algorithm", "order"), [("iterated", 0), ("jacobi", 2)])
def test_blocks_with_a_delay_go_back_as_others_do(algorithm: str, order: int) -> None:
    """Steps are repeated in both engines, and a delay that nobody reads leaves the FMU's output as it is."""

    def made(engine: str, *, delayed: bool) -> Results:
        d = Diagram("lagging")
        d.wire(d.add("lag", fmu(lag_fmu(2), "CS")).u, d.add("sine", Sine(omega=4.0, amplitude=1.5)).y)
        if delayed:
            d.wire(d.add("late", TransportDelay(delay=0.13)).u, "lag.y")
        log = ["lag.y", "late.y"] if delayed else ["lag.y"]
        master = {"step": 0.01, "algorithm": algorithm, "order": order}
        return d.run(stop=1.5, every=0.05, log=log, engine=engine, master=master)

    reference, native = made("reference", delayed=True), made("native", delayed=True)
    assert native.values == pytest.approx(reference.values, abs=1e-12)
    assert native.statistics.steps == reference.statistics.steps
    assert native["lag.y"] == pytest.approx(made("native", delayed=False)["lag.y"], abs=1e-12)


class Counts:
    """A program that counts its ticks."""

    n = 0

    def step(self, t: float, u: float) -> float:
        self.n += 1
        return float(self.n)


class Counting(Block):
    """The number of ticks, every 0.07 s."""

    u = Input()
    n = Stepped(0.0)

    @stepper(every=0.07)
    def program():  # type: ignore[no-untyped-def]
        return Counts()


@each_engine
def test_ticks_of_a_program_are_communication_points(engine: str) -> None:
    """Between its ticks the count is constant, and a lag follows it exactly."""
    d = Diagram("counted")
    d.wire(d.add("counts", Counting()).u, d.add("zero", Constant(value=0.0)).y)
    d.wire(d.add("lag", fmu(lag_fmu(2), "CS")).u, "counts.n")
    results = d.run(stop=0.7, every=0.35, log=["lag.y"], engine=engine, master={"step": 0.05, "order": 0})
    y = 0.0
    for count in range(1, 11):
        y = count - (count - y) * math.exp(-0.07 / 0.3)
    assert results["lag.y"][-1] == pytest.approx(y, rel=1e-5)


@each_engine
def test_a_rigid_fmu_with_event_mode_is_not_stopped_by_its_ticks(tmp_path: Path, engine: str) -> None:
    """Its steps of 7 ms pass its ticks of 10 ms; a Step beside it that nobody reads changes nothing."""
    path = exported(Diagram.alone(ZeroOrderHold(period=0.01)), fmi=3, kinds=("CS",)).path
    rigid = tmp_path / "rigid.fmu"
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(rigid, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                assert b'canHandleVariableCommunicationStepSize="true"' in data
                data = data.replace(b'StepSize="true"', b'StepSize="false"')
            new.writestr(name, data)
    d = Diagram("beside")
    d.wire(d.add("held", fmu(rigid, "CS")).u, d.add("one", Constant(value=1.0)).y)
    d.add("step", Step(at=0.0123))
    results = d.run(stop=0.07, every=0.007, engine=engine, log=["held.y"], master={"step": 0.007})
    assert results["held.y"].tolist() == [1.0] * 11


@each_engine
def test_an_fmu_with_event_mode_begins_with_what_ticks_at_the_start_give(engine: str) -> None:
    """A hold of a hold: at t = 0 the FMU ticks after the block that feeds it."""
    path = exported(Diagram.alone(ZeroOrderHold(period=0.5)), fmi=3, kinds=("CS",)).path
    d = Diagram("start")
    d.wire(d.add("first", ZeroOrderHold(period=0.5)).u, d.add("one", Constant(value=1.0)).y)
    d.wire(d.add("second", fmu(path, "CS")).u, "first.y")
    results = d.run(stop=1.0, every=0.5, engine=engine, log=["second.y"], master={"step": 0.1})
    assert results["second.y"].tolist() == [1.0, 1.0, 1.0]


# --- crossings that a master finds again after each jump from an extrapolated input to the true one ----


def driven(part: Block | Any) -> Diagram:
    d = Diagram("driven")
    wave, inner = d.add("wave", Sine(omega=5.550123, amplitude=1.025951, phase=1.558297)), d.add("part", part)
    d.wire(inner.u, wave.y)
    d.wire(d.add("lag", FirstOrder(T=0.25)).u, inner.y)
    return d


@each_engine
@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("part", [Relay(on_at=0.4, off_at=-0.2), RateLimiter(rising=2.0, falling=2.0)], ids=repr)
def test_an_fmu_that_switches_by_an_extrapolated_input_switches_as_a_block(
    part: Block, algorithm: str, engine: str, tmp_path: Path
) -> None:
    alone = Diagram("alone")
    inner = alone.add("part", part)
    alone.wire(inner.u, alone.input("u", default=0.0))
    alone.output("y", inner.y)
    alone.export(tmp_path / "part.fmu", fmi=3)
    settings: dict[str, Any] = {"stop": 3.0, "every": 0.01, "engine": engine, "method": "radau"}
    truth = driven(part).run(**settings)["part.y"]
    made = driven(fmu(tmp_path / "part.fmu", "CS")).run(
        **settings, master={"step": 0.01, "algorithm": algorithm, "order": 1}
    )["part.y"]
    # It switches at a time that is off by less than a step.
    assert np.mean(np.abs(made - truth)) < 1e-2


def behind_a_lag(part: Block, folder: Path) -> Diagram:
    """Give a part, as an FMU that may end its steps early, the output of a lag.

    The blocks have an instant too, so the FMU repeats each step that it ends early.
    """
    alone = Diagram("alone")
    inner = alone.add("part", part)
    alone.wire(inner.u, alone.input("u", default=0.0))
    alone.output("y", inner.y)
    alone.export(folder / "part.fmu", fmi=3)
    d = Diagram("lagged")
    lag = d.add("lag", FirstOrder())
    d.wire(lag.u, d.add("wave", Sine()).y)
    d.wire(d.add("part", fmu(folder / "part.fmu", "CS")).u, lag.y)
    d.add("step", Step(at=1.0))
    return d


@each_engine
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("method", ["dopri5", "rk4"])
def test_an_fmu_that_stops_some_ulp_before_a_limit_passes_it(
    method: str, order: int, engine: str, tmp_path: Path
) -> None:
    d = behind_a_lag(Saturation(lower=-0.3, upper=0.25), tmp_path)
    given = {"lag.k": 0.806614, "lag.T": 0.568871}
    given |= {"wave.omega": 5.315937, "wave.amplitude": 0.960992, "wave.phase": 2.373037}
    results = d.run(
        stop=2.0, every=0.01, engine=engine, method=method, step=0.01 if method == "rk4" else None, parameters=given,
        master={"step": 0.01, "algorithm": "jacobi", "order": order},
    )  # fmt: skip
    # It switches at a time that is off by the error of the extrapolation.
    assert results["part.y"] == pytest.approx(np.clip(results["lag.y"], -0.3, 0.25), abs=1e-3)


@each_engine
@pytest.mark.parametrize(
    "given",
    [
        {"omega": 3.4725551483117383, "amplitude": 1.046717518036683, "phase": 4.727785151772, "k": 0.7577488818366324,
         "T": 0.39993171039035114},
        {"omega": 5.438659954168475, "amplitude": 0.8969951411884483, "phase": 1.6776736593111383,
         "k": 1.0087279306471069, "T": 0.35491578690210035},
    ],
    ids=["up", "down"],
)  # fmt: skip
def test_nothing_is_extrapolated_through_points_that_lie_some_ulp_apart(
    given: dict[str, float], engine: str, tmp_path: Path
) -> None:
    """The FMU stops several times in front of a corner, at times that approach each other."""
    d = behind_a_lag(DeadZone(lower=-0.3, upper=0.25), tmp_path)
    parameters = {f"{'lag' if name in ('k', 'T') else 'wave'}.{name}": value for name, value in given.items()}
    results = d.run(
        stop=2.0, every=0.01, engine=engine, method="rk4", step=0.01, parameters=parameters,
        master={"step": 0.01, "algorithm": "jacobi", "order": 2},
    )  # fmt: skip
    u = results["lag.y"]
    assert results["part.y"] == pytest.approx(u - np.clip(u, -0.3, 0.25), abs=1e-3)


@each_engine
@pytest.mark.parametrize(("order", "error"), [(1, 0.01), (2, 0.001)])
def test_extrapolation_follows_points_that_ticks_set_close_together(
    order: int, error: float, engine: str, tmp_path: Path
) -> None:
    """A hold beside the lag ticks at a fiftieth of the step, and each tick is a communication point."""
    d = behind_a_lag(FirstOrder(T=0.05), tmp_path)
    d.add("reader", fmu(tmp_path / "part.fmu", "CS"))
    d.wire("reader.u", d.add("hold", ZeroOrderHold(period=0.002)).y)
    d.wire("hold.u", d.add("other", Sine(omega=3.0)).y)
    settings: dict[str, Any] = {"stop": 2.0, "every": 0.1, "rtol": 1e-9, "atol": 1e-11}
    settings["parameters"] = {"wave.omega": 5.3, "lag.T": 0.5}
    made = d.run(**settings, engine=engine, master={"step": 0.1, "algorithm": "jacobi", "order": order})["part.y"]
    for name, block in (("part", FirstOrder(T=0.05)), ("reader", FirstOrder(T=0.05))):
        d.swap(name, block)
    assert made == pytest.approx(d.run(**settings, engine=engine)["part.y"], abs=error)


def test_both_engines_let_a_delay_bend_at_the_communication_point_beside_it() -> None:
    """1.2 s + 0.14 s is a double beside 1.34 s, and a step from the one to the other would show no bend."""
    d = Diagram("late")
    off, hold = d.add("off", Sum(signs="+-")), d.add("hold", ZeroOrderHold(period=0.1))
    plant, late = d.add("plant", FirstOrder(k=1.470914, T=0.314546)), d.add("late", TransportDelay(delay=0.14))
    d.wire(off.u1, d.add("wave", Sine(omega=5.014174, amplitude=1.034268, phase=1.677322)).y)
    d.wire(off.u2, late.y)
    d.wire(hold.u, off.y)
    d.wire(plant.u, hold.y)
    d.wire(late.u, plant.y)
    bound = d.add("bound", FirstOrder(k=1.4, T=0.9))
    d.wire(bound.u, plant.y)
    d.wire(d.add("lag", fmu(lag_fmu(2), "CS")).u, bound.y)
    settings: dict[str, Any] = {"stop": 2.0, "every": 0.05, "method": "euler", "step": 0.01, "log": ["lag.y"]}
    settings["master"] = {"step": 0.01, "algorithm": "jacobi", "order": 1}
    native, reference = (d.run(**settings, engine=engine)["lag.y"] for engine in ("native", "reference"))
    assert native == pytest.approx(reference, rel=1e-9, abs=1e-12)


@each_engine
def test_an_fmu_whose_input_jumps_still_finds_what_fires_ever_faster(tmp_path: Path, engine: str) -> None:
    inner = Diagram("bounces")
    ball, total = inner.add("ball", BouncingBall(v_rest=0.0)), inner.add("total", Sum())
    inner.wire(total.u1, inner.input("u", default=0.0))
    inner.wire(total.u2, ball.h)
    inner.output("y", total.y)
    inner.export(tmp_path / "bounces.fmu", fmi=3)
    with pytest.raises(FMUError, match=r"ball\.impact fires ever faster") as caught:
        driven(fmu(tmp_path / "bounces.fmu", "CS")).run(stop=5.0, every=0.1, engine=engine, master={"step": 0.01})
    # It would rest at sqrt(2 h/g) (1 + e)/(1 - e).
    assert caught.value.results.t[-1] == pytest.approx(math.sqrt(2 / 9.81) * 1.7 / 0.3, abs=0.1)


PLANTS: dict[str, Callable[[Path], tuple[Path, str]]] = {
    "ME": lambda folder: (MOTORS[3], "ME"),
    "FMI 2": lambda folder: (MOTORS[2], "CS"),
    "FMI 3": lambda folder: (MOTORS[3], "CS"),
    "event mode": lambda folder: (motor_with_events(folder), "CS"),
}


def motor_with_events(folder: Path) -> Path:
    """Return the motor beside a relay, whose side changes in event mode."""
    d = Diagram("motor")
    motor = d.add("motor", PMDCMotor())
    d.wire(motor.v, d.input("v", unit="V"))
    d.wire(motor.tau, d.input("tau", unit="N.m", default=0.0))
    d.wire(d.add("relay", Relay(on_at=1.0, off_at=-1.0, unit="rad/s")).u, motor.omega)
    for name in ("omega", "i"):
        d.output(name, f"motor.{name}")
    d.output("is_fast", "relay.y")
    d.export(folder / "motor.fmu", fmi=3)
    return folder / "motor.fmu"


@each_engine
@pytest.mark.parametrize(("scale", "kick"), [(1.0, 0.0), (1e-12, 0.0), (1.0, 1e10)])
def test_a_small_jump_of_a_signal_is_no_rounding(tmp_path: Path, scale: float, kick: float, engine: str) -> None:
    """A signal of any size jumps, also one that was much larger before: nothing is extrapolated across the jump."""
    gain = Diagram("gain")
    gain.wire(gain.add("gain", Gain()).u, gain.input("u"))
    gain.output("y", "gain.y")
    gain.export(tmp_path / "gain.fmu")
    d = Diagram("d")
    total = d.add("total", Sum(signs="+++"))
    d.wire(total.u1, d.add("step", Step(at=0.5, after=scale)).y)
    d.wire(total.u2, d.add("wave", Sine(amplitude=0.01 * scale)).y)
    d.wire(total.u3, d.add("kick", Step(at=0.1, before=kick, after=0)).y)
    plant, area = d.add("plant", fmu(tmp_path / "gain.fmu", "CS")), d.add("area", Integrator())
    d.wire(plant.u, total.y)
    d.wire(area.u, plant.y)
    results = d.run(stop=1, engine=engine, trust=tmp_path)
    area_from = results["area.y"][np.searchsorted(results.t, 0.3)]
    exact = 0.5 + 0.01 * (np.cos(0.3) - np.cos(1.0))
    assert (results["area.y"][-1] - area_from) / scale == pytest.approx(exact, abs=2e-5)


@each_engine
@pytest.mark.parametrize("lower", [-12.0, 0.0])
@pytest.mark.parametrize("plant", PLANTS)
def test_a_controller_reaches_and_leaves_its_limits_beside_an_fmu(
    tmp_path: Path, plant: str, lower: float, engine: str
) -> None:
    """At a limit the signal changes by a rounding error only, so no extrapolation restarts, and nothing chatters."""
    value = Diagram.load(ROOT / "diagrams" / "motor_pid.json").to_json()
    value["blocks"]["control"]["parameters"]["lower"] = lower
    d = Diagram.from_json(json.dumps(value))
    exact = d.run(rtol=1e-9, atol=1e-11)
    path, kind = PLANTS[plant](tmp_path)
    d.swap("motor", fmu(path, kind))
    results = d.run(engine=engine, trust=tmp_path)
    error = np.abs(results["motor.omega"] - exact["motor.omega"]).max()
    assert error < {"ME": 1e-5, "CS": 3e-3}[kind]  # CS: 7e-4 with steps of 5 ms, 1.6e-4 of 2.5 ms


def test_rows_are_freed_by_the_library_that_allocated_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """A checker of memory that is linked into it would else see a foreign pointer."""
    monkeypatch.setattr(native_master, "LARGEST_SPARE", 0)
    motor = Diagram.alone(fmu(MOTORS[3]))
    run = motor.start(stop=0.1, inputs={"v": 6.0}, engine="native", master={"step": 0.01})
    run.advance_to(0.1)
    engine = run._simulation.engine
    assert isinstance(engine, NativeMaster)
    library, freed = engine.library, []

    def free(data: Any) -> None:
        freed.append(data)
        library.master_free(data)

    monkeypatch.setattr(engine, "library", SimpleNamespace(master_free=free, master_close=library.master_close))
    engine.close()
    engine._free()
    assert freed


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_an_fmu_alone_may_read_itself(engine: str, tmp_path: Path) -> None:
    """T dy/dt = u - y with u = y stays where it begins; nothing but the FMU itself asks for y."""
    Diagram.alone(FirstOrder(T=0.3, y_start=2.0)).export(tmp_path / "lag.fmu")
    d = Diagram("alone")
    lag = d.add("lag", fmu(tmp_path / "lag.fmu", kind="CS"))
    d.wire(lag.u, lag.y)
    for log in ([], ["lag.y"]):
        results = d.run(stop=1.0, master={"step": 0.1}, log=log, engine=engine, trust=tmp_path)
        assert results.t[-1] == 1.0
    assert results["lag.y"] == pytest.approx(2.0, rel=1e-12)
