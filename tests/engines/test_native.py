"""The native engine gives what the reference engine gives: runs, events, errors, snapshots; and it keeps its manners.

Fixed steps agree within 1e-12 of each signal's range, or within 100 times what a change of one ulp at the start does.
"""

from __future__ import annotations

import copy
import gc
import math
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    Abs,
    Block,
    BouncingBall,
    CompareToConstant,
    CompilerError,
    Diagram,
    Fault,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    Parameter,
    Power,
    Results,
    Saturation,
    SimulationError,
    Sine,
    State,
    Step,
    Sum,
    TransportDelay,
    UsageError,
    ZeroOrderHold,
    fmu,
    output,
)
from blocks.compile.c.emit_cache import emitted, plan_key
from blocks.compile.c.model_code import Emitted, emit
from blocks.compile.c.runtime_grid import grid_of
from blocks.compile.plan import Plan, Reference
from blocks.compile.toolchain.compiler import find_compiler
from blocks.contract.interface import Value
from blocks.contract.resolution import resolve
from blocks.engines import selection as engines
from blocks.engines.native import native_engine
from blocks.library import LIBRARY
from tests.support.documents import SHIPPED, is_unlike, span
from tests.support.library_variants import VARIANTS
from tests.support.marks import long_but
from tests.support.places import ROOT

DIAGRAMS = SHIPPED
pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
CLOSE = 1e-12


def both(diagram: Diagram, **settings: Any) -> tuple[Results, Results]:
    return tuple(diagram.run(engine=engine, **settings) for engine in ("reference", "native"))  # type: ignore[return-value]


def effect_of_one_ulp(diagram: Diagram, **settings: Any) -> np.ndarray[Any, Any]:
    """How far each signal moves when all states are one ulp higher at some time: the start, or later on."""
    effect = np.zeros(0)
    for share in (0.0, 0.3, 0.6, 0.9):
        begun = diagram.start(engine="native", **settings)
        begun.advance_to(round(share * settings["stop"], 3))
        state = begun.snapshot()
        rows = {name: row for name, row in state.rows.items() if name != "first"}
        pushed = replace(state, rows={**rows, "x": np.nextafter(rows["x"], np.inf)})
        plain = diagram.run(engine="native", resume=state, **settings).values
        other = diagram.run(engine="native", resume=pushed, **settings).values
        if plain.shape == other.shape:
            moved = np.max(np.abs(plain - other), axis=0, initial=0.0)
            effect = np.maximum(effect, moved) if effect.size else moved
    return effect


def assert_close(diagram: Diagram, **settings: Any) -> None:
    reference, native = both(diagram, **settings)
    assert native.statistics.engine == "native"
    assert [(e.block, e.what) for e in native.events] == [(e.block, e.what) for e in reference.events]
    assert len(native.t) == len(reference.t)
    np.testing.assert_allclose(native.t, reference.t, rtol=1e-12, atol=1e-12)
    size = np.ptp(reference.values, axis=0) if len(reference.t) else np.zeros(reference.values.shape[1])
    size = np.where(size > 0, size, np.max(np.abs(reference.values), axis=0, initial=0.0))
    error = np.max(np.abs(native.values - reference.values), axis=0, initial=0.0)
    if np.any(error > CLOSE * size):
        allowed = np.maximum(CLOSE * size, 100 * effect_of_one_ulp(diagram, **settings))
        names = [name for name, (first, shape, _) in native.columns.items() for _ in range(math.prod(shape))]
        worst = int(np.argmax(error - allowed))
        assert np.all(error <= allowed), (names[worst], error[worst], allowed[worst], size[worst])
    for name, value in reference.measures.items():
        assert native.measures[name] == pytest.approx(value, rel=1e-9, abs=1e-12, nan_ok=True), name


RK4, EULER = {"method": "rk4", "step": 0.002}, {"method": "euler", "step": 0.0005}
FEW = ("bouncing_ball", "sampled_loop", "iadrc")
BY_RK4 = (*FEW, "iadrc_sampled", "robot", "consensus", "motor_pid")  # adaptive methods run all that are unlike


@pytest.mark.parametrize(
    ("path", "settings"),
    long_but(
        ((path, settings) for settings in (RK4, EULER) for path in DIAGRAMS),
        lambda path, settings: is_unlike(path) and path.stem in (BY_RK4 if settings is RK4 else FEW),
    ),
    ids=lambda one: one.stem if isinstance(one, Path) else one["method"],
)
def test_diagrams_with_fixed_steps_are_close(path: Path, settings: dict[str, Any]) -> None:
    diagram = Diagram.load(path)
    inputs = {name: ([0.0, 0.4, 1.0], [0.0, 1.0, -0.5], "linear") for name in diagram.value.inputs}
    stop = span(path, 1.0 if "paper" in str(path) else 2.0)
    assert_close(diagram, stop=stop, every=0.01, inputs=inputs, **settings)


@pytest.mark.parametrize("path", long_but(DIAGRAMS, is_unlike), ids=lambda path: path.stem)
def test_diagrams_with_adaptive_steps_agree_to_tolerance(path: Path) -> None:
    diagram = Diagram.load(path)
    inputs = {name: ([0.0, 0.4, 1.0], [0.0, 1.0, -0.5], "linear") for name in diagram.value.inputs}
    stop = span(path, 1.0 if "paper" in str(path) else 2.0)
    reference, native = both(diagram, stop=stop, every=0.01, rtol=1e-9, atol=1e-12, inputs=inputs)
    assert [(e.block, e.what) for e in native.events] == [(e.block, e.what) for e in reference.events]
    size = np.ptp(reference.values, axis=0)
    on_grid = np.isin(reference.t, native.t)
    same = np.isin(native.t, reference.t)
    for column in range(reference.values.shape[1]):
        ours, theirs = native.values[same, column], reference.values[on_grid, column]
        if len(ours) == len(theirs):
            # Of a mean that stays 0 only rounding errors of its terms are left, below the run's atol.
            assert np.max(np.abs(ours - theirs)) <= 1e-5 * size[column] + 1e-12, list(native.columns)


def variant_diagram(entries: list[tuple[str, dict[str, Any]]]) -> Diagram:
    """Blocks side by side; each input is a diagram input of its own."""
    diagram = Diagram("variants")
    for number, (name, parameters) in enumerate(entries):
        diagram.add(f"b{number}", LIBRARY[name](**parameters))
        interface = resolve(LIBRARY[name], {key: Value(value) for key, value in parameters.items()}).interface
        for port in interface.inputs.values():
            size = port.size if port.shape else None
            made = diagram.input(f"i{number}_{port.name}", type=port.type, size=size, unit=port.unit)
            diagram.wire(f"b{number}.{port.name}", made)
    return diagram


def variant_inputs(diagram: Diagram) -> dict[str, Any]:
    made: dict[str, Any] = {}
    for number, (name, entry) in enumerate(diagram.value.inputs.items()):
        t = np.array([0.0, 0.31, 0.62, 0.95])
        if isinstance(entry, dict) and entry.get("type") == "bool":
            made[name] = (t, np.array([0.0, 1.0, 0.0, 1.0]), "hold")
            continue
        u = np.array([0.3, 1.7 + 0.1 * (number % 7), -0.8, 0.9])
        size = int(entry["size"]) if isinstance(entry, dict) and "size" in entry else None
        made[name] = (t, np.column_stack([u + 0.2 * k for k in range(size)]) if size else u, "linear")
    return made


@pytest.mark.parametrize("first", range(0, len(VARIANTS), 12))
def test_library_blocks_are_close(first: int) -> None:
    # fhan of the TrackingDifferentiator has slopes of 1e6: at this step it chatters, and any last bit decides.
    chaotic = ("TrackingDifferentiator", {})
    entries = [entry for entry in VARIANTS[first : first + 12] if entry[0] != "InvertedPendulum" and entry != chaotic]
    diagram = variant_diagram(entries)
    inputs = variant_inputs(diagram)
    settings: dict[str, Any] = {"stop": 1.2, "every": 0.01, "method": "rk4", "step": 0.004, "inputs": inputs}
    told = []
    for engine in ("reference", "native"):
        try:
            diagram.run(engine=engine, **settings)
        except SimulationError as error:
            told.append(str(error))
    if told:  # the same, then, in the same words
        assert told[0:1] == told[1:]
    else:
        assert_close(diagram, **settings)


# --- manners --------------------------------------------------------------------------------------------------------


def ball() -> Diagram:
    diagram = Diagram("ball")
    diagram.add("ball", BouncingBall())
    diagram.add("speed", Gain())
    diagram.wire("speed.u", "ball.v")
    return diagram


def test_threads_do_not_disturb_each_other() -> None:
    diagram = ball()
    alone = [diagram.run(engine="native", stop=1.0 + k / 4, every=0.01).values for k in range(4)]
    found: dict[int, Any] = {}

    def work(k: int) -> None:
        for _ in range(20):
            found[k] = diagram.run(engine="native", stop=1.0 + k / 4, every=0.01).values

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k in range(4):
        assert np.array_equal(found[k], alone[k])


def test_the_same_run_again_is_the_same_and_leaves_the_first_results_alone() -> None:
    diagram = ball()
    first = diagram.run(engine="native", stop=2.0, every=0.01)
    kept = first.values.copy()
    again = diagram.run(engine="native", stop=2.0, every=0.01)
    shorter = diagram.run(engine="native", stop=1.0, every=0.01)
    diagram.add("more", Gain(k=2.0))
    diagram.wire("more.u", "ball.h")
    other = diagram.run(engine="native", stop=2.0, every=0.01)
    assert np.array_equal(first.values, kept)
    assert np.array_equal(first.values, again.values)
    assert list(first.events) == list(again.events)
    assert shorter.t[-1] == 1.0
    assert "more.y" in other.columns


def test_equal_blocks_may_read_blocks_of_several_types_by_turns() -> None:
    """Sixteen sums read a Gain or an Abs each: their common code finds the operands side by side."""
    d = Diagram("turns")
    wave = d.add("wave", Sine(omega=3.0))
    for k in range(16):
        lag, total = d.add(f"lag{k}", FirstOrder(T=0.1 + 0.01 * k)), d.add(f"total{k}", Sum())
        gain, size = d.add(f"gain{k}", Gain(k=1.0 + k)), d.add(f"size{k}", Abs())
        after = d.add(f"after{k}", FirstOrder(T=0.3 + 0.01 * k))
        d.wire(lag.u, wave.y)
        d.wire(gain.u, lag.y)
        d.wire(size.u, lag.y)
        d.wire(total.u1, gain.y if k % 2 else size.y)
        d.wire(total.u2, wave.y)
        d.wire(after.u, total.y)
    native, reference = (
        d.run(stop=2.0, every=0.1, method="rk4", step=0.01, engine=engine) for engine in ("native", "reference")
    )
    for name in native:
        assert native[name] == pytest.approx(reference[name], abs=1e-12)


@pytest.mark.parametrize(("begin", "end"), [("reference", "native"), ("native", "reference")])
@pytest.mark.parametrize("settings", [{}, {"method": "rk4", "step": 0.01}], ids=str)
def test_a_state_of_one_engine_goes_on_in_the_other(begin: str, end: str, settings: dict[str, Any]) -> None:
    diagram = Diagram("loop")
    diagram.add("error", Sum(signs="+-"))
    diagram.add("hold", ZeroOrderHold(period=0.05))
    diagram.add("plant", FirstOrder(T=0.3))
    diagram.add("late", TransportDelay(delay=0.08))
    diagram.add("limit", Saturation(lower=-0.5, upper=0.9))
    diagram.add("wave", Sine(omega=3.0))
    for sink, source in (
        ("error.u1", "wave.y"), ("error.u2", "late.y"), ("hold.u", "error.y"), ("limit.u", "hold.y"),
        ("plant.u", "limit.y"), ("late.u", "plant.y"),
    ):  # fmt: skip
        diagram.wire(sink, source)
    settings = {"stop": 2.0, "every": 0.01, **settings}
    whole = diagram.run(engine=end, stops=[0.73], **settings)
    run = diagram.start(engine=begin, **settings)
    run.advance_to(0.73)
    rest = diagram.run(engine=end, resume=run.snapshot(), **settings)
    same = whole.t >= 0.73
    assert len(rest.t) == np.count_nonzero(same)
    np.testing.assert_allclose(rest.values, whole.values[same], rtol=0, atol=1e-9)


def test_a_native_state_goes_on_bit_for_bit(tmp_path: Path) -> None:
    diagram = ball()
    whole = diagram.run(engine="native", stop=3.0, stops=[1.37])
    run = diagram.start(engine="native", stop=3.0)
    run.advance_to(1.37)
    run.save(tmp_path / "state.zip")
    rest = diagram.run(engine="native", stop=3.0, resume=tmp_path / "state.zip")
    first = int(np.nonzero(whole.t == 1.37)[0][-1])
    assert np.array_equal(rest.t, whole.t[first:])
    assert np.array_equal(rest.values, whole.values[first:])
    assert [e.t for e in rest.events] == [e.t for e in whole.events if e.t > 1.37]


def test_errors_are_told_in_the_same_words() -> None:
    class Escape(Block):
        u = Input(0.0)
        x = State(1.0, output=True)

        @x.derivative
        def dx(x: Any, u: Any) -> Any:
            return x * x + u

    diagram = Diagram("escape", library=Escape)
    diagram.add("escape", Escape())
    told = []
    for engine in ("reference", "native"):
        with pytest.raises(SimulationError) as error:
            diagram.run(engine=engine, stop=2.0, method="rk4", step=0.01)
        told.append((str(error.value), len(error.value.results.t)))
    assert told[0] == told[1]
    assert "escape.x" in told[0][0]


def test_where_the_reference_engine_meets_no_error_the_title_of_the_code_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(native_engine.NativeEngine, "_in_words", lambda *_: None)
    diagram = Diagram("growth")
    x, square = diagram.add("x", Integrator(y_start=1.0)), diagram.add("square", Power(exponent=2.0))
    diagram.wire(square.u, x.y)
    diagram.wire(x.u, square.y)
    told = r"E301 growth: a step became too small, at t = 1\.0\d+ s\. Run it with --engine reference"
    with pytest.raises(SimulationError, match=told):
        diagram.run(engine="native", stop=2.0)  # 1 / (1 - t)


def test_what_is_recorded_does_not_exhaust_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native_engine, "for_recording", lambda: 400_000.0)
    diagram = ball()
    with pytest.raises(SimulationError) as error:
        diagram.run(engine="native", stop=100.0, method="rk4", step=0.001)
    assert error.value.code == "E311"
    results = error.value.results
    assert results is not None
    assert 1000 < len(results.t) < 20_000
    assert results.t[-1] > 0.5


def test_engines_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match="native"):
        ball().run(stop=1.0, engine="nativ")
    monkeypatch.setenv("BLOCKS_ENGINE", "compiled")
    with pytest.raises(UsageError, match="BLOCKS_ENGINE"):
        ball().run(stop=1.0)
    monkeypatch.setenv("BLOCKS_ENGINE", "native")
    assert ball().run(stop=1.0).statistics.engine == "native"
    assert ball().run(stop=1.0, engine="reference").statistics.engine == "reference"


def test_without_a_compiler_the_reference_engine_runs_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "find_compiler", lambda: None)
    monkeypatch.setattr(engines, "_told", set())
    with pytest.warns(RuntimeWarning, match="no C compiler"):
        assert ball().run(stop=1.0, engine="auto").statistics.engine == "reference"
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # once is enough
        ball().run(stop=1.0, engine="auto")


def test_a_compiler_that_was_asked_for_must_work(monkeypatch: pytest.MonkeyPatch) -> None:
    diagram = ball()
    diagram.add("never_compiled", Gain())
    diagram.wire("never_compiled.u", "ball.h")
    monkeypatch.setenv("CC", "/nowhere/cc")
    with pytest.raises(CompilerError) as error:
        diagram.run(stop=1.0, engine="native")
    assert error.value.code == "E601"


@pytest.mark.skipif(os.name != "posix", reason="rights stand in lists there")
def test_a_cache_that_others_can_write_to_is_told_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    folder.mkdir()
    folder.chmod(0o777)
    monkeypatch.setenv("BLOCKS_CACHE_DIR", str(folder))
    monkeypatch.setattr(engines, "_told", set())
    said = f"other users can write to {folder}; remove it, .*; compiled code is kept in a temporary folder"
    with pytest.warns(RuntimeWarning, match=said):
        assert ball().run(stop=1.0, engine="native").statistics.engine == "native"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ball().run(stop=1.0, engine="auto")
    assert list(folder.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="the compiler is a script")
def test_a_library_without_our_functions_is_no_defect_of_blocks(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A linker that makes an empty library of all that it is given."""
    empty = tmp_path / "empty.c"
    empty.write_text("int nothing(void) { return 0; }\n")
    compiler = tmp_path / "cc"
    compiler.write_text(
        f"""#!/bin/sh
case "$*" in *-shared*library*) exec {shutil.which("cc")} -shared -fPIC {empty} -o library.so;; esac
exec {shutil.which("cc")} "$@"
"""
    )
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    monkeypatch.setenv("BLOCKS_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(engines, "_told", set())
    diagram = ball()
    diagram.add("never_compiled", Gain())
    diagram.wire("never_compiled.u", "ball.h")
    with pytest.raises(CompilerError) as caught:
        diagram.run(stop=1.0, engine="native")
    assert caught.value.code == "E603"
    assert "lacks the function blocks_new" in str(caught.value)
    with pytest.warns(RuntimeWarning, match=r"lacks the function blocks_new.* The reference engine runs"):
        assert diagram.run(stop=1.0, engine="auto").statistics.engine == "reference"


@pytest.mark.skipif(os.name != "posix", reason="the compiler is a script")
def test_equations_that_are_too_large_for_a_compiler_are_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A compiler that breaks down over models as gcc does over 100,000 operations in one equation."""

    class Long(Block):
        u = Input()

        @output
        def y(u):  # type: ignore[no-untyped-def]
            for k in range(10_001):
                u = 0.5 * u + k
            return u

    compiler = tmp_path / "cc"
    body = 'case "$*" in *model.c*) echo "internal compiler error: Segmentation fault"; exit 4;; esac'
    compiler.write_text(f'#!/bin/sh\n{body}\nexec {shutil.which("cc")} "$@"\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    monkeypatch.setenv("BLOCKS_CACHE_DIR", str(tmp_path / "cache"))
    diagram = Diagram("large")
    diagram.add("long", Long())
    diagram.wire("long.u", diagram.input("u", default=1.0))
    with pytest.raises(CompilerError) as caught:
        diagram.run(stop=1.0, engine="native", method="rk4", step=1.0)
    assert caught.value.code == "E602"
    assert re.search(r"The equations of long have [234]\d,\d{3} operations, maybe too many", str(caught.value))


def test_an_interrupt_returns_soon_with_what_is_there() -> None:
    program = """
import sys, threading, time
from blocks import *
d = Diagram("long")
d.add("wave", Sine(omega=3.0))
d.add("sum", Integrator())
d.wire("sum.u", "wave.y")
settings = {"engine": "native", "method": "rk4", "step": 0.001, "every": 10.0}
d.run(stop=10.0, **settings)  # what is to be compiled is there
threading.Timer(0.5, print, ("ready",), {"flush": True}).start()
r = d.run(stop=1e7, **settings)
print("interrupted", r.interrupted, len(r.t), r.t[-1] > 0, time.time(), flush=True)
"""
    child = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, cwd=ROOT, env={**os.environ}
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    sent = time.time()
    child.send_signal(signal.SIGINT)
    told = child.communicate(timeout=60)[0].split()
    assert told[:2] == ["interrupted", "True"]
    assert int(told[2]) > 1
    assert told[3] == "True"
    # It is 0.05 s and a little on a machine that does nothing else, and the run would take minutes.
    assert float(told[4]) - sent < 10.0


FINE = Fraction(2**58, 2**63 + 1)  # 1/32 s and a little less
GRIDS = [{"every": FINE}, {"method": "rk4", "step": FINE}, {"master": {"couple": "each", "step": FINE}}]


@pytest.mark.parametrize("settings", GRIDS, ids=str)
def test_times_that_compiled_code_cannot_count_are_those_of_the_reference_engine(
    settings: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Times whose numerators have more than 62 bits, in each grid of a run; it is said once in a process."""
    d = Diagram("fine")
    d.wire(d.add("gain", Gain()).u, d.add("wave", Sine()).y)
    monkeypatch.setattr(engines, "_told", set())
    with pytest.warns(RuntimeWarning, match="more than 62 bits: the reference engine runs"):
        results = d.run(stop=1, engine="auto", **settings)
    assert results.statistics.engine == "reference"
    assert (results.t[1:33] == [float(k * FINE) for k in range(1, 33)]).all()
    assert (d.run(stop=1, engine="auto", **settings).values == results.values).all()  # warnings are errors in tests
    with pytest.raises(UsageError, match="fractions of more than 62 bits"):
        d.run(stop=1, engine="native", **settings)


def test_a_grid_that_does_not_fit_is_not_made() -> None:
    with pytest.raises(OverflowError, match="62 bits"):
        grid_of(Fraction(0), FINE, Fraction(1))
    assert grid_of(Fraction(0), Fraction(2**58, 2**62 - 1), Fraction(1)).unit == 2**62 - 1


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_floats_of_fractions_are_grids_of_exact_times(engine: str) -> None:
    """1/7000 s as a double: steps of masters, of methods, rows and ticks are at k/7000, each rounded once."""
    d = Diagram("floats")
    d.wire(d.add("hold", ZeroOrderHold(period=1 / 3000)).u, d.add("wave", Sine()).y)
    times = [k / 7000 for k in range(701)]
    coupled = d.run(stop=0.1, engine=engine, master={"couple": "each", "step": 1 / 7000})
    assert [*dict.fromkeys(coupled.t.tolist())] == sorted({*times, *(k / 3000 for k in range(301))})
    assert d.run(stop=0.1, engine=engine, every=1 / 7000).t.tolist() == times
    stepped = d.run(stop=0.1, engine=engine, method="rk4", step=1 / 7000)
    assert {*times} <= {*stepped.t.tolist()}
    assert d.plan().base == Fraction(1, 3000)


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_a_step_that_an_fmu_asks_for_is_the_fraction_that_its_decimal_stands_for(tmp_path: Path, engine: str) -> None:
    """The closed loop of a lag with T = 0.05 s and a gain of 20, in steps of 1/7000 s: its end is known."""
    lag = Diagram.alone(FirstOrder(T=0.05))
    lag.export(tmp_path / "lag.fmu", kinds=("CS",), method="rk4", step=1 / 7000)
    d = Diagram("loop")
    p, e = d.add("p", fmu(tmp_path / "lag.fmu", kind="CS")), d.add("e", Sum(signs="+-"))
    s, g = d.add("s", Step()), d.add("g", Gain(k=20.0))
    d.wire(e.u1, s.y)
    d.wire(e.u2, p.y)
    d.wire(g.u, e.y)
    d.wire(p.u, g.y)
    results = d.run(stop=0.1, engine=engine, log=["p.y"])
    assert results.t.tolist() == [k / 7000 for k in range(701)]
    assert results["p.y"][-1] == pytest.approx(20 / 21, rel=1e-9)


@pytest.mark.parametrize("master", [{}, {"couple": "each", "step": 0.1}])
def test_a_warning_stands_where_the_run_is_begun(master: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    d = Diagram("plain")
    d.add("wave", Sine())
    monkeypatch.setattr(engines, "_told", set())
    monkeypatch.setattr(engines, "find_compiler", lambda: None)
    with pytest.warns(RuntimeWarning, match="no C compiler was found") as told:
        d.start(stop=0.1, engine="auto", master=master)
    assert [warning.filename for warning in told] == [__file__]


def test_a_unit_that_cannot_be_compiled_leaves_nothing_to_free(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is told where the engine that was begun is given up, but why the other one runs."""

    def refuse(*given: Any, **how: Any) -> None:
        raise CompilerError(Fault("E601", "cc", "It cannot be compiled."))

    ignored: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", ignored.append)
    monkeypatch.setattr(engines, "_told", set())
    monkeypatch.setattr("blocks.engines.native.model.model_of", refuse)
    d = Diagram("plain")
    d.add("wave", Sine())
    with pytest.warns(RuntimeWarning, match="It cannot be compiled"):
        results = d.run(stop=0.1, engine="auto", master={"couple": "each", "step": 0.1})
    gc.collect()
    assert (results.statistics.engine, ignored) == ("reference", [])


def test_two_crossings_inside_one_step_are_found() -> None:
    """h = 1 - 5 (t - 1/2)^2 ... a parabola that is above 0 for a part of one fixed step only."""
    diagram = Diagram("parabola")
    diagram.add("ball", BouncingBall(h_start=0.2, v_start=-1.0, e=0.9))
    for step in (0.5, 0.25):
        reference, native = both(diagram, stop=1.0, method="rk4", step=step)
        assert len(reference.events) > 0
        assert [e.t for e in native.events] == pytest.approx([e.t for e in reference.events], rel=1e-12)


SANITIZED = """
import ctypes, sys
from pathlib import Path
from blocks import Diagram
from blocks.engines.native import model
model.EXTRA_FLAGS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", "-g")
for path in sys.argv[2:]:
    for settings in ({}, {"method": "rk4", "step": 0.005}, {"method": "euler", "step": 0.001}, {"method": "radau"}):
        d = Diagram.load(path)
        inputs = {name: ([0.0, 0.4, 1.0], [0.0, 1.0, -0.5], "linear") for name in d.value.inputs}
        for every in (None, 0.01):
            given = {"every": every} if every else {}
            r = d.start(engine="native", stop=1.0, inputs=inputs, **given, **settings)
            r.advance_to(0.5)
            state = r.snapshot()
            r.finish()
            d.run(engine="native", stop=1.0, resume=state, **given, **settings)
for _ in range(int(sys.argv[1])):
    d.run(engine="native", stop=0.05, inputs=inputs, every=0.01)
if sys.argv[1] == "0":  # a leak, to see that it would be seen
    library = r._simulation.engine.model.library
    library.blocks_new(ctypes.addressof(r._simulation.engine._handle.setup))
print("done")
"""


def sanitized(count: int, paths: list[str], script: str = SANITIZED) -> subprocess.CompletedProcess[str]:
    preload = subprocess.run(["cc", "-print-file-name=libasan.so"], capture_output=True, text=True).stdout.strip()
    if not os.path.isabs(preload):
        pytest.skip("no address sanitizer")
    environment = {
        **os.environ,
        "LD_PRELOAD": preload,
        "PYTHONMALLOC": "malloc",
        "ASAN_OPTIONS": "detect_leaks=1:fast_unwind_on_malloc=1",
        "LSAN_OPTIONS": "exitcode=0:max_leaks=100000:report_objects=0",
        "PYTHONPATH": str(ROOT),
    }
    return subprocess.run(
        [sys.executable, "-c", script, str(count), *paths], env=environment, capture_output=True, text=True, cwd=ROOT
    )


@pytest.mark.long
@pytest.mark.skipif(shutil.which("cc") is None or sys.platform != "linux", reason="needs cc on Linux")
def test_sanitizers_find_nothing_in_a_thousand_runs() -> None:
    names = ("bouncing_ball", "motor_pid", "sampled_loop", "gallery/rod")
    done = sanitized(1000, [str(ROOT / "diagrams" / f"{name}.json") for name in names])
    assert "done" in done.stdout, done.stderr[-3000:]
    assert "runtime error" not in done.stderr, done.stderr[-3000:]
    assert "ERROR: AddressSanitizer" not in done.stderr, done.stderr[-3000:]
    assert "blocks_" not in done.stderr, done.stderr[-3000:]  # no leak has a frame of the runtime
    leaking = sanitized(0, [str(ROOT / "diagrams" / "bouncing_ball.json")])
    assert "blocks_new" in leaking.stderr


TIMED = """
import sys
from fractions import Fraction as F
from unittest import mock
from blocks import Diagram, FirstOrder, Sine, ZeroOrderHold
from blocks.compile.toolchain import compiler
from blocks.engines.master import native_master
from blocks.engines.native import model
FLAGS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", "-g")
model.EXTRA_FLAGS = FLAGS
native_master.build = lambda units: compiler.build(units, extra_flags=FLAGS)
for start in (F(0), F(-1, 3), F(10**6)):
    for step in (F(1, 70), F(2**57, 2**62 - 1), F(2**56 + 1, 2**61)):
        for period in (F(1, 7), F(2**49, 2**53 - 1)):
            d = Diagram("times")
            hold, lag = d.add("hold", ZeroOrderHold(period=period)), d.add("lag", FirstOrder())
            d.wire(hold.u, d.add("wave", Sine()).y)
            d.wire(lag.u, hold.y)
            coupled = {"master": {"couple": "each", "step": step}}
            for settings in ({"method": "rk4", "step": step}, {"every": step}, coupled):
                for stop in (start + 1, None):
                    try:
                        run = d.start(engine="native", start=start, stop=stop, **settings)
                    except Exception as error:
                        assert "62 bits" in str(error) or "E119" in str(error) or "E115" in str(error), error
                        continue
                    run.advance_to(start + 1)
print("done")
"""


@pytest.mark.long
@pytest.mark.skipif(shutil.which("cc") is None or sys.platform != "linux", reason="needs cc on Linux")
def test_no_integer_overflows_where_times_are_as_fine_as_they_can_be() -> None:
    done = sanitized(0, [], TIMED)
    assert "done" in done.stdout, done.stderr[-3000:]
    assert "runtime error" not in done.stderr, done.stderr[-3000:]
    assert "ERROR: AddressSanitizer" not in done.stderr, done.stderr[-3000:]


def test_equal_loops_run_as_they_do_alone_also_where_parameters_differ() -> None:
    """Loops over lanes read a parameter once where all have the same one, else one by one."""

    def loops(time_constants: list[float]) -> Diagram:
        diagram = Diagram("loops")
        diagram.add("wave", Sine(omega=2.0))
        for k, T in enumerate(time_constants):
            diagram.add(f"error{k}", Sum(signs="+-"))
            diagram.add(f"limit{k}", Saturation(lower=-0.3, upper=0.4))
            diagram.add(f"plant{k}", FirstOrder(T=T, k=3.0))
            for sink, source in (
                (f"error{k}.u1", "wave.y"), (f"error{k}.u2", f"plant{k}.y"), (f"limit{k}.u", f"error{k}.y"),
                (f"plant{k}.u", f"limit{k}.y"),
            ):  # fmt: skip
                diagram.wire(sink, source)
        log = [f"plant{k}.y" for k in range(len(time_constants))]
        diagram.settings(stop=3.0, method="rk4", step=0.005, every=0.05, log=log)
        return diagram

    equal = loops([0.2] * 7).run(engine="native").values
    assert np.array_equal(equal, np.repeat(equal[:, :1], 7, axis=1))
    diagram = loops([0.2] * 6 + [0.25])
    assert_close(diagram)
    mixed = diagram.run(engine="native")
    # All cross at times of their own, which are instants of all.
    np.testing.assert_allclose(mixed.values[-1, 0], equal[-1, 0], rtol=1e-7)
    run = loops([0.2] * 7).start(engine="native")
    run.advance_to(1.0)
    run.set("plant6.T", 0.25)
    assert run["plant6.y"] == run["plant0.y"]
    run.advance_to(2.0)
    assert run["plant6.y"] != run["plant0.y"]
    assert run["plant5.y"] == run["plant0.y"]


class Bell(Block):
    """y = exp(-((u - 2.55)/w)^2): above 1/2 only where u is near 2.55."""

    w = Parameter(0.02)
    u = Input()

    @output
    def y(u: Any, w: Any) -> Any:
        return np.exp(-(((u - 2.55) / w) ** 2))


@pytest.mark.parametrize(
    "settings", [{"method": "rk4", "step": 0.1}, {"method": "euler", "step": 0.1}, {"every": 0.1}], ids=str
)
def test_a_switch_that_is_passed_within_a_part_of_a_step_is_found(settings: dict[str, Any]) -> None:
    diagram = Diagram("carriage", library=Bell)
    diagram.add("x", Integrator())
    diagram.wire("x.u", diagram.input("v"))
    diagram.add("near", Bell())
    diagram.wire("near.u", "x.y")
    diagram.add("switch", CompareToConstant(constant=0.5))
    diagram.wire("switch.u", "near.y")
    reference, native = both(diagram, stop=4.0, inputs={"v": 1.0}, **settings)
    passes = [2.55 - 0.02 * math.sqrt(math.log(2.0)), 2.55 + 0.02 * math.sqrt(math.log(2.0))]
    assert [event.t for event in reference.events] == pytest.approx(passes, rel=1e-9)
    assert [event.t for event in native.events] == pytest.approx(passes, rel=1e-9)


def test_a_run_that_other_threads_try_to_read_is_the_run_alone() -> None:
    run = ball().start(engine="native", stop=1e9)
    counts: list[int] = []

    def tried(call: Callable[[], Any]) -> bool:
        try:
            call()
        except UsageError as error:
            if error.code != "E507":  # another one is inside
                raise
            return False
        return True

    def read() -> None:
        while run.t < 200.0:
            counts.append(tried(lambda: run.results) + tried(run.snapshot))
            time.sleep(1e-4)  # else the two may keep the run from going on for minutes

    readers = [threading.Thread(target=read) for _ in range(2)]
    for reader in readers:
        reader.start()
    for _ in range(200):
        while not tried(lambda: run.advance(1.0)):
            pass
    for reader in readers:
        reader.join()
    alone = ball().start(engine="native", stop=1e9)
    for _ in range(200):
        alone.advance(1.0)
    assert list(run.results.events) == list(alone.results.events)
    assert counts


def test_a_copy_of_a_diagram_runs_too() -> None:
    diagram = ball()
    first = diagram.run(engine="native", stop=1.0, every=0.1)
    for copied in (copy.deepcopy(diagram), pickle.loads(pickle.dumps(diagram))):
        assert np.array_equal(copied.run(engine="native", stop=1.0, every=0.1).values, first.values)


def many(k: float = 1.0, *, swapped: bool = False) -> Diagram:
    """Blocks enough for emission to be kept."""
    diagram = Diagram("many")
    diagram.add("wave", Sine(omega=2.0))
    for n in range(120):
        diagram.add(f"gain{n}", Gain(k=k))
        diagram.add(f"lag{n}", FirstOrder(T=0.5 + 0.01 * n))
        diagram.wire(f"gain{n}.u", "wave.y" if n == 0 or not swapped else f"lag{n - 1}.y")
        diagram.wire(f"lag{n}.u", f"gain{n}.y")
    diagram.settings(stop=1.0, method="rk4", step=0.01, log=["lag119.y"])
    return diagram


def test_what_is_emitted_is_kept_by_all_but_values(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BLOCKS_CACHE_DIR", str(tmp_path / "cache"))
    emissions: list[str] = []

    def counted(plan: Plan, **how: Any) -> Emitted:
        emissions.append(plan.name)
        return emit(plan, **how)

    monkeypatch.setattr("blocks.compile.c.model_code.emit", counted)

    def made_of(plan: Plan, *, method: str, logged: Any) -> Emitted:
        return emitted(plan, plan_key(plan, (), logged, method), measured=(), method=method, logged=logged)

    logged = (Reference("x", 119),)
    plan = many().plan()
    first = made_of(plan, method="rk4", logged=logged)
    again = made_of(many(k=3.0).plan(), method="rk4", logged=logged)
    assert len(emissions) == 1
    assert first == again == emit(plan, measured=(), method="rk4", logged=logged)
    for other, how in (
        (many(swapped=True).plan(), {"method": "rk4", "logged": logged}),
        (plan, {"method": "euler", "logged": logged}),
        (plan, {"method": "rk4", "logged": (Reference("x", 118),)}),
    ):
        made = made_of(other, **how)  # type: ignore[arg-type]
        assert made == emit(other, measured=(), **how)  # type: ignore[arg-type]
    assert len(emissions) == 4
    (next((tmp_path / "cache").glob("*/emitted.json"))).write_text("[]")  # a damaged one is made again
    assert made_of(plan, method="rk4", logged=logged) == first


def test_plans_that_differ_in_values_share_one_model() -> None:
    one, other = many().start(engine="native"), many(k=2.0).start(engine="native")
    assert one._simulation.engine.model is other._simulation.engine.model
    assert np.max(np.abs(one.finish().values * 2 - other.finish().values)) < 1e-12
