"""Diagrams with FMUs as one FMU: the bits of `run`, in FMPy, and all that may go wrong inside."""

from __future__ import annotations

import functools
import importlib.util
import re
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from blocks import PID, Block, Diagram, Gain, Input, Parameter, Relay, Sine, State, Step, Sum, fmu, output
from blocks.compile.toolchain.platforms import PLATFORMS, folder_of
from blocks.fmi.summary import tell
from blocks.text.errors import BlocksError, FMUError, ModelError
from tests.support.coupled_systems import Displaced, First, Forced, Lag, Second, Switching
from tests.support.faulty import NEEDS_COMPILER, make
from tests.support.fmus import Fmu
from tests.support.marks import long
from tests.support.places import ROOT

Array = np.ndarray[Any, Any]
MOTORS = {2: ROOT / "fmus" / "PMDCMotor_fmi2.fmu", 3: ROOT / "fmus" / "PMDCMotor.fmu"}

pytestmark = [NEEDS_COMPILER, pytest.mark.skipif(sys.platform != "linux", reason="the FMUs in fmus/ are for Linux")]
each_fmi = pytest.mark.parametrize("fmi", [2, 3])


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="blocks-test-containers-")


@functools.cache
def inner(cls: type[Block], fmi: int, **parameters: float) -> Path:
    """The FMU of a block, made once."""
    diagram = Diagram.alone(cls(**parameters))
    diagram.settings(rtol=1e-10, atol=1e-12)
    path = Path(tempfile.mkdtemp(dir=_folder().name)) / f"{cls.__name__}.fmu"
    diagram.export(path, fmi=fmi)
    return path


def exported(diagram: Diagram, fmi: int, **words: Any) -> Path:
    path = Path(tempfile.mkdtemp(dir=_folder().name)) / "container.fmu"
    diagram.export(path, fmi=fmi, **words)
    return path


def simulated(path: Path, stop: float, step: float, **words: Any) -> Any:
    return fmpy.simulate_fmu(str(path), stop_time=stop, output_interval=step, step_size=step, **words)


def assert_same(diagram: Diagram, path: Path, stop: float, step: float, **words: Any) -> None:
    """All outputs in FMPy are those of a run, to the last bit."""
    run = diagram.run(stop=stop, every=step, engine="native", **words)
    rows = simulated(path, stop, step, start_values=words.get("parameters", {}))
    assert len(rows) == len(run.t)
    for name, source in diagram.to_json()["outputs"].items():
        assert np.array_equal(rows[name], run[source]), (name, np.abs(rows[name] - run[source]).max())


def loop(motor: Path, **master: Any) -> Diagram:
    """A motor under a controller that reaches its limits, beside a tick and a delay of its own."""
    d = Diagram("loop")
    wanted, control = d.add("wanted", Step(at=0.015)), d.add("control", PID(kp=2.0, ki=5.0, lower=-1.5, upper=1.5))
    plant = d.add("motor", fmu(motor, kind="CS", Ra=0.2))
    d.wire(control.r, wanted.y)
    d.wire(control.y, plant.omega)
    d.wire(plant.v, control.u)
    d.output("omega", "motor.omega")
    d.output("u", "control.u")
    d.settings(stop=0.5, every=0.01, log=["motor.omega", "control.u"], master={"step": 0.002, **master})
    return d


def masses(inside: int, **master: Any) -> Diagram:
    """Two masses on springs, each an FMU."""
    d = Diagram("masses")
    a = d.add("a", fmu(inner(Displaced, inside), kind="CS"))
    b = d.add("b", fmu(inner(Forced, inside), kind="CS"))
    d.wire(a.F, b.F)
    d.wire(b.x1, a.x)
    d.wire(b.v1, a.v)
    d.output("x1", "a.x")
    d.output("x2", "b.x")
    d.settings(stop=2.0, every=0.1, log=["a.x", "b.x"], master={"step": 0.02, **master})
    return d


MASTERS: list[dict[str, Any]] = [
    {"algorithm": "jacobi", "order": 0}, {"algorithm": "jacobi", "order": 1},
    {"algorithm": "gauss-seidel", "order": 2}, {"algorithm": "iterated", "order": 1},
]  # fmt: skip


@each_fmi
@pytest.mark.parametrize("master", MASTERS, ids=lambda master: f"{master['algorithm']}-{master['order']}")
def test_a_loop_in_fmpy_has_the_bits_of_a_run(fmi: int, master: dict[str, Any]) -> None:
    for inside in (fmi, 5 - fmi):  # FMI 2 inside of FMI 3, and back
        d = loop(MOTORS[inside], **master)
        path = exported(d, fmi)
        assert validate_fmu(str(path)) == []
        assert_same(d, path, 0.5, 0.01)


@each_fmi
@pytest.mark.parametrize("master", [*MASTERS, {"order": 1, "tolerance": 1e-4}], ids=str)
def test_two_masses_have_the_bits_of_a_run(fmi: int, master: dict[str, Any]) -> None:
    d = masses(fmi, **master)
    assert_same(d, exported(d, fmi), 2.0, 0.1)


def test_units_with_steps_of_their_own_do_not_stop_with_the_importer() -> None:
    d = masses(3, order=1, steps={"b": 0.04})
    d.settings(every=0.02)
    assert_same(d, exported(d, 3), 2.0, 0.02)


def ring(count: int, inside: int) -> Diagram:
    """FMUs one behind the other, the last back to the first through a block."""
    d = Diagram("ring")
    lags = [d.add(f"lag_{k}", fmu(inner(Lag, inside), kind="CS")) for k in range(count)]
    back, total, wave = d.add("back", Gain(k=-0.5)), d.add("total", Sum()), d.add("wave", Sine(omega=1.26))
    for one, other in zip(lags[1:], lags, strict=False):
        d.wire(one.u, other.x)
    d.wire(back.u, lags[-1].x)
    d.wire(total.u1, wave.y)
    d.wire(total.u2, back.y)
    d.wire(lags[0].u, total.y)
    d.output("y", f"lag_{count - 1}.x")
    d.output("u", "total.y")
    d.settings(stop=1.0, every=0.05, log=[f"lag_{count - 1}.x", "total.y"], master={"step": 0.01})
    return d


@pytest.mark.parametrize(("count", "fmi"), [(5, 2), long(20, 3)])
def test_many_fmus_in_a_ring(count: int, fmi: int) -> None:
    d = ring(count, fmi)
    path = exported(d, fmi)
    assert_same(d, path, 1.0, 0.05)
    with zipfile.ZipFile(path) as archive:
        inside = [name for name in archive.namelist() if name.endswith("/modelDescription.xml")]
    assert inside == ["resources/Lag/modelDescription.xml"]  # once for all of them


def test_a_loop_of_direct_dependencies_is_solved_inside() -> None:
    d = Diagram("algebraic")
    a, b = d.add("a", fmu(inner(First, 3), kind="CS")), d.add("b", fmu(inner(Second, 2), kind="CS"))
    d.wire(a.u, b.y)
    d.wire(b.u, a.y)
    d.output("x", "a.x")
    d.settings(stop=1.0, every=0.05, loops="solve", log=["a.x"], master={"step": 0.01, "order": 1})
    assert_same(d, exported(d, 3), 1.0, 0.05)


def test_events_inside_happen_where_a_run_has_them() -> None:
    d = Diagram("switches")
    wave = d.add("wave", Sine(omega=2.51))
    switch = d.add("switch", fmu(inner(Switching, 3), kind="CS"))
    relay, lag = d.add("relay", Relay(on_at=0.5, off_at=-0.5)), d.add("lag", fmu(inner(Lag, 3), kind="CS"))
    d.wire(switch.u, wave.y)
    d.wire(relay.u, lag.x)
    d.wire(lag.u, switch.on)
    d.output("on", "switch.on")
    d.output("x", "lag.x")
    d.output("r", "relay.y")
    d.settings(stop=4.0, every=0.05, log=["switch.on", "lag.x", "relay.y"], master={"step": 0.05})
    assert_same(d, exported(d, 3), 4.0, 0.05)


@each_fmi
@pytest.mark.parametrize("inside", [2, 3])
def test_an_fmu_for_model_exchange_stays_among_the_blocks(fmi: int, inside: int) -> None:
    """With crossings and parameters, beside an FMU that has a solver of its own."""
    d = Diagram("both")
    d.parameter("gain", 2.0)
    wave, relay = d.add("wave", Sine(omega=2.5)), d.add("relay", Relay(on_at=0.2, off_at=-0.2))
    switch = d.add("switch", fmu(inner(Switching, inside), kind="ME"))
    one = d.add("one", fmu(inner(Scaled, inside), kind="ME", k="=gain", x_start=0.5))
    lag = d.add("lag", fmu(inner(Lag, inside), kind="CS"))
    d.wire(switch.u, wave.y)
    d.wire(one.u, switch.on)
    d.wire(relay.u, lag.x)
    d.wire(lag.u, one.twice)
    for name, source in (("on", "switch.on"), ("x", "one.x"), ("y", "lag.x"), ("r", "relay.y")):
        d.output(name, source)
    d.settings(
        stop=4.0, every=0.05, log=["switch.on", "one.x", "lag.x", "relay.y"], master={"step": 0.05, "order": 1}
    )
    path = exported(d, fmi)
    assert_same(d, path, 4.0, 0.05)
    assert_same(d, path, 4.0, 0.05, parameters={"gain": -0.7})
    assert validate_fmu(str(path)) == []


# --- in each other -----------------------------------------------------------------------------------------------


def test_a_container_in_a_container() -> None:
    d = masses(3, order=1)
    d.run()
    pair = exported(d, 2)
    outer = Diagram("outer")
    system = outer.add("system", fmu(pair, kind="CS"))
    lag = outer.add("lag", fmu(inner(Lag, 3), kind="CS"))
    outer.wire(lag.u, system.x1)
    outer.output("x1", "system.x1")
    outer.output("y", "lag.x")
    outer.settings(stop=1.0, every=0.1, log=["system.x1", "lag.x"], master={"step": 0.02, "order": 1})
    path = exported(outer, 3)
    assert_same(outer, path, 1.0, 0.1)
    told = tell(path).info()
    assert told.index("resources/container: masses, FMI 2.0") < told.index("resources/Displaced: Displaced, FMI 3.0")
    alone = d.run(stop=1.0, every=0.1, engine="native")
    assert np.array_equal(outer.run(engine="native")["system.x1"], alone["a.x"])


@each_fmi
def test_an_outer_master_takes_a_container_back_as_often_as_it_wants(fmi: int) -> None:
    """By iteration, which saves and restores its state, the two masses come to what they are side by side."""
    d = Diagram("half")
    d.input("F", unit="")
    a = d.add("a", fmu(inner(Displaced, fmi), kind="CS"))
    d.wire(a.F, "F")
    d.output("x", "a.x")
    d.output("v", "a.v")
    d.settings(stop=1.0, every=0.1, inputs={"F": 0.0}, log=["a.x"], master={"step": 0.01})
    outer, direct = Diagram("outer"), Diagram("direct")
    for diagram, path in ((outer, exported(d, fmi)), (direct, inner(Displaced, fmi))):
        one, other = diagram.add("a", fmu(path, kind="CS")), diagram.add("b", fmu(inner(Forced, 3), kind="CS"))
        diagram.wire(one.F, other.F)
        diagram.wire(other.x1, one.x)
        diagram.wire(other.v1, one.v)
        diagram.settings(
            stop=2.0, every=0.1, log=["a.x", "b.x"], master={"step": 0.01, "algorithm": "iterated", "order": 0}
        )
    ours, theirs = outer.run(engine="native"), direct.run(engine="native")
    assert np.array_equal(ours["a.x"], theirs["a.x"])
    assert np.array_equal(ours["a.x"], outer.run(engine="reference")["a.x"])


# --- parameters and inputs ---------------------------------------------------------------------------------------


class Scaled(Block):
    """x' = k u - x"""

    k = Parameter(1.0)
    u = Input()
    x = State(output=True)

    @x.derivative
    def dx(x, u, k):
        return k * u - x

    @output
    def twice(x):
        return 2 * x


def scaled() -> Diagram:
    d = Diagram("scaled")
    d.parameter("gain", 2.0)
    d.input("u", unit="")
    a, g = d.add("a", fmu(inner(Scaled, 3), kind="CS", k="=2*gain")), d.add("g", Gain(k="=gain + 1"))
    b = d.add("b", fmu(inner(Scaled, 2), kind="CS"))
    d.wire(a.u, "u")
    d.wire(g.u, a.twice)
    d.wire(b.u, g.y)
    d.output("x", "b.x")
    d.settings(stop=1.0, every=0.05, log=["b.x"], inputs={"u": 1.0}, master={"step": 0.01})
    return d


@each_fmi
def test_parameters_that_are_set_from_outside_act_as_in_a_run(fmi: int) -> None:
    d = scaled()
    path = exported(d, fmi)
    for parameters in ({}, {"gain": -1.5}, {"gain": 0.5, "b.k": 3.0}, {"gain": 1.0, "a.x_start": 0.25}):
        assert_same(d, path, 1.0, 0.05, parameters=parameters)
    variables = Fmu(path).variables
    assert variables["a.k"].causality == "calculatedParameter"
    assert variables["gain"].variability == "fixed"


@each_fmi
def test_inputs_that_change_at_communication_points_act_as_those_that_are_set_in_a_run(fmi: int) -> None:
    d, step = scaled(), 0.05
    path = Fmu(exported(d, fmi))
    given = [1.0, 1.0, -2.0, 0.5, 0.5, 3.0]
    run = d.start(engine="native")
    found, wanted = [], []
    with path.instance() as one:
        one.begin({"u": 1.0}, stop=1.0)
        for k, value in enumerate(given):
            one.set("u", value)
            one.step(k * step, step)
            found.append(one["x"])
            if run["u"] != value:
                run.set("u", value)
            run.advance_to(Fraction(5 * (k + 1), 100))
            wanted.append(float(run["b.x"]))
    assert found == wanted


# --- states and instances ----------------------------------------------------------------------------------------


@each_fmi
def test_a_state_goes_to_another_instance_as_bytes(fmi: int) -> None:
    d = loop(MOTORS[fmi], order=1, algorithm="iterated")
    container = Fmu(exported(d, fmi))
    run = d.run(engine="native")
    with container.instance() as one, container.instance(name="other") as other:
        one.begin(stop=0.5)
        for k in range(20):
            one.step(0.01 * k, 0.01)
        data = one.serialized()
        other.begin(stop=0.5)
        other.step(0.0, 0.01)
        other.restore(data)
        for k in range(20, 50):  # side by side
            one.step(0.01 * k, 0.01)
            other.step(0.01 * k, 0.01)
            assert one["omega"] == other["omega"] == run["motor.omega"][k + 1]
            assert one["u"] == other["u"] == run["control.u"][k + 1]
        with pytest.raises(Exception, match="fmi"):
            other.restore(data[:-1] + bytes([data[-1] ^ 1]))


def test_instances_are_made_and_freed_two_hundred_times() -> None:
    container = Fmu(exported(masses(3, order=1), 3))
    grown: list[float] = []
    for k in range(200):
        with container.instance() as one:
            one.begin(stop=2.0)
            one.step(0.0, 0.02)
        if k in (50, 199):
            grown.append(float(Path("/proc/self/statm").read_text().split()[1]) * 4096)
            handles = len([*Path("/proc/self/fd").iterdir()])
    assert grown[1] - grown[0] < 4e6
    assert handles < 500


def test_a_reset_begins_anew() -> None:
    container = Fmu(exported(masses(2), 2))
    with container.instance() as one:
        found = []
        for _ in range(3):
            one.begin(stop=2.0)
            one.step(0.0, 0.1)
            found.append(one["x1"])
            one.raw.reset()
        assert len({*found}) == 1


# --- files -------------------------------------------------------------------------------------------------------


def test_the_files_of_fmus_inside_are_kept_byte_for_byte(tmp_path: Path) -> None:
    for name, k in (("left", 1.0), ("right", 2.0)):
        (tmp_path / name).mkdir()
        shutil.copy(inner(Scaled, 3, k=k), tmp_path / name / "one.fmu")
    d = Diagram("two")
    a, b = (d.add(name, fmu(tmp_path / name / "one.fmu", kind="CS")) for name in ("left", "right"))
    wave = d.add("wave", Sine(omega=1.88))
    d.wire(a.u, wave.y)
    d.wire(b.u, a.x)
    d.output("y", "right.x")
    d.settings(stop=1.0, every=0.1, log=["right.x"], master={"step": 0.01})
    path = exported(d, 3)
    assert_same(d, path, 1.0, 0.1)
    with zipfile.ZipFile(path) as whole:
        for folder, name in (("one", "left"), ("one_2", "right")):
            with zipfile.ZipFile(tmp_path / name / "one.fmu") as archive:
                for entry in archive.namelist():
                    assert whole.read(f"resources/{folder}/{entry}") == archive.read(entry)
        page = whole.read("documentation/index.html").decode()
    assert 0 < page.index("FMUs inside") < page.index("<h2>Outputs")
    assert "resources/one_2" in page


@each_fmi
def test_it_runs_from_folders_with_blanks_and_umlauts(fmi: int, tmp_path: Path) -> None:
    d = masses(5 - fmi)
    folder = tmp_path / "Übung 100 % # ü"
    folder.mkdir()
    path = folder / "größe 1.fmu"
    shutil.copy(exported(d, fmi), path)
    fmpy.extract(str(path), unzipdir=str(folder / "aus gepackt"))
    rows = fmpy.simulate_fmu(str(folder / "aus gepackt"), stop_time=1.0, output_interval=0.1, step_size=0.1)
    assert np.array_equal(rows["x1"], d.run(stop=1.0, engine="native")["a.x"])


def test_info_and_the_export_tell_what_is_inside(tmp_path: Path) -> None:
    d = loop(MOTORS[2])
    told = str(d.export(tmp_path / "x.fmu"))
    assert "inside: motor (resources/PMDCMotor_fmi2: PMDCMotor, FMI 2.0" in told
    assert "license: documentation/licenses/license.txt" in told
    info = tell(tmp_path / "x.fmu")
    assert "inside: resources/PMDCMotor_fmi2: PMDCMotor, FMI 2.0, Model Exchange and Co-Simulation" in info.info()
    assert "license documentation/licenses/license.txt" in info.info()
    assert info.entry()["inside"] == [{"folder": "resources/PMDCMotor_fmi2", "name": "PMDCMotor", "fmi": "2.0"}]


@pytest.mark.long
@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="ziglang is not installed")
@each_fmi
def test_it_is_built_for_every_platform_of_the_fmus_inside(fmi: int, tmp_path: Path) -> None:
    Diagram.alone(Lag()).export(tmp_path / "lag.fmu", platforms=list(PLATFORMS))
    d = Diagram("one")
    d.wire(d.add("lag", fmu(tmp_path / "lag.fmu", kind="CS")).u, d.add("wave", Sine()).y)
    d.output("y", "lag.x")
    d.settings(stop=1.0, every=0.1, log=["lag.x"], master={"step": 0.1})
    path = exported(d, fmi, platforms=list(PLATFORMS))
    assert set(tell(path).platforms) >= {folder_of(platform, fmi) for platform in PLATFORMS}
    assert_same(d, path, 1.0, 0.1)


# --- what goes wrong ---------------------------------------------------------------------------------------------


def faulty(tmp_path: Path, fmi: int, fault: int, **words: Any) -> Diagram:
    d = Diagram("broken")
    wave = d.add("wave", Sine(omega=1.88))
    one = d.add("one", fmu(make(tmp_path, fmi=fmi, **words), kind="CS", fault=fault, t_fault=0.5))
    d.wire(one.u, wave.y)
    d.output("y", "one.y")
    d.settings(stop=1.0, every=0.1, log=["one.y"], master={"step": 0.1})
    return d


def stepped(path: Path) -> tuple[list[float], list[tuple[int, str, str]]]:
    """The outputs up to the step that fails, and all that was told."""
    found = []
    with Fmu(path).instance() as one:
        one.begin(stop=1.0)
        try:
            for k in range(10):
                one.step(0.1 * k, 0.1)
                found.append(one["y"])
        except Exception:
            return found, one.messages
        return found, one.messages


@each_fmi
@pytest.mark.parametrize(("fault", "words"), [(3, "an error"), (4, "a fatal error")])
def test_a_failure_inside_names_the_fmu(fmi: int, fault: int, words: str, tmp_path: Path) -> None:
    d = faulty(tmp_path, fmi, fault)
    with pytest.raises(FMUError) as caught:
        d.run(engine="native")
    results = caught.value.results
    assert results is not None
    found, messages = stepped(exported(d, fmi))
    assert found == results["one.y"][1 : len(found) + 1].tolist()
    own = [text for status, _, text in messages if status >= 3 and text.startswith(f"one: fmi{fmi}DoStep returned")]
    assert len(own) == 1
    assert words in own[0]


@each_fmi
def test_a_discarded_step_is_tried_again_inside(fmi: int, tmp_path: Path) -> None:
    d = faulty(tmp_path, fmi, 18)
    assert_same(d, exported(d, fmi), 1.0, 0.1)


@each_fmi
def test_a_run_that_an_fmu_inside_ends_is_ended(fmi: int, tmp_path: Path) -> None:
    d = faulty(tmp_path, fmi, 15)
    run = d.run(engine="native")
    rows = simulated(exported(d, fmi), 1.0, 0.1)
    assert rows["time"][-1] == pytest.approx(run.t[-1])
    assert rows["y"][-1] == run["one.y"][-1]


def test_texts_sizes_and_types_of_parameters_reach_the_fmu_inside(tmp_path: Path) -> None:
    path = make(tmp_path, fmi=3)
    d = Diagram("typed")
    wave = d.add("wave", Sine(omega=1.88))
    one = d.add("one", fmu(path, kind="CS", label="a text", n=2, k=3.0))
    d.wire(one.u, wave.y)
    d.input("row", size=2)
    d.wire(one.v, "row")
    d.output("w", "one.w")
    d.settings(stop=1.0, every=0.1, log=["one.w"], inputs={"row": [0.5, 1.5]}, master={"step": 0.1})
    assert_same(d, exported(d, 3), 1.0, 0.1)


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_instance_without_its_resources_says_so(fmi: int, tmp_path: Path) -> None:
    container = Fmu(exported(masses(fmi), fmi))
    shutil.rmtree(container.folder / "resources")
    messages: list[Any] = []
    with pytest.raises(Exception, match="instantiate"), container.instance(messages=messages):
        pass
    assert any("a: there is no binary for" in text for _, _, text in messages)


def refused(make_it: Callable[[], Any]) -> str:
    with pytest.raises(ModelError) as caught:
        make_it()
    return str(caught.value)


def test_what_a_container_cannot_be_is_refused(tmp_path: Path) -> None:
    d = masses(3)
    told = refused(lambda: d.export(tmp_path / "x.fmu", kinds=["ME"]))
    assert "E606 masses: has FMUs for Co-Simulation inside" in told
    once = Diagram("once")
    path = make(tmp_path, once=True)
    one, other = (once.add(name, fmu(path, kind="CS")) for name in ("first", "second"))
    wave = once.add("wave", Sine())
    once.wire(one.u, wave.y)
    once.wire(other.u, wave.y)
    once.output("y", "second.y")
    assert "E606 second: can be instantiated only once in a process" in refused(lambda: once.export(tmp_path / "x.fmu"))
    told = refused(lambda: d.export(tmp_path / "x.fmu", platforms=["aarch64-linux"]))
    assert "E606 a: Displaced.fmu has no binary for aarch64-linux" in told


def test_a_damaged_binary_is_found_before_it_is_packed(tmp_path: Path) -> None:
    d = Diagram("damaged")
    d.wire(d.add("one", fmu(make(tmp_path, binary="truncated"), kind="CS")).u, d.add("wave", Sine()).y)
    d.output("y", "one.y")
    with pytest.raises(FMUError, match="E207 one: "):
        d.export(tmp_path / "x.fmu")


def test_a_step_that_follows_from_the_length_of_the_run_is_told(tmp_path: Path) -> None:
    d = masses(3)
    d.settings(master={"order": 1})
    assert "W211 run.master.step" in str(d.export(tmp_path / "x.fmu"))


def test_an_error_of_the_export_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(BlocksError):
        masses(3).export(tmp_path / "x.fmu", kinds=["ME"])
    assert not (tmp_path / "x.fmu").exists()


def test_variables_in_messages_of_fmi_2_have_their_names(tmp_path: Path) -> None:
    """A reference would be one of the container."""
    _, messages = stepped(exported(faulty(tmp_path, 2, 3), 2))
    told = [text for _, _, text in messages if text.startswith("one: [")]
    assert any("u = " in text for text in told)
    assert not any("#" in text for text in told)


# --- the trace ---------------------------------------------------------------------------------------------------


@each_fmi
def test_calls_of_fmus_inside_are_messages_of_a_category(fmi: int, tmp_path: Path) -> None:
    """They are those of a traced run, without the times that they took."""
    d = masses(fmi, algorithm="iterated", order=1)
    d.run(stop=0.04, every=0.02, engine="native", trace="*", trace_file=tmp_path / "calls.log")
    container = Fmu(exported(d, fmi))
    with container.instance() as one:
        one.raw.setDebugLogging(True, ["logTrace"])
        one.begin(stop=0.04)
        one.step(0.0, 0.02)
        one.raw.setDebugLogging(True, ["logStatusError"])
        silent = len(one.messages)
        one.raw.setDebugLogging(True, ["logTrace"])
        one.step(0.02, 0.02)
        assert len(one.messages) > silent
    told = [line for _, category, text in one.messages if category == "logTrace" for line in text.splitlines()]
    ours, theirs = (
        [re.sub(r"^.*? ok ", "", line).strip() for line in lines if "DoStep" in line or "SetFMU" in line]
        for lines in (told, (tmp_path / "calls.log").read_text().splitlines())
    )
    assert len(ours) > 10
    assert ours == theirs[-len(ours) :]
    assert any("F = " in line for line in told)


@each_fmi
def test_a_plain_fmu_has_no_such_category(fmi: int) -> None:
    with Fmu(inner(Lag, fmi)).instance() as one, pytest.raises(Exception, match="SetDebugLogging"):
        one.raw.setDebugLogging(True, ["logTrace"])
