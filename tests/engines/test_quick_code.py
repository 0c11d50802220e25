"""A first run begins by code that is compiled without optimisation; it and the optimised code compute the same bits."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, fmu
from blocks.compile.toolchain import apart
from blocks.compile.toolchain import cache as caches
from blocks.compile.toolchain.compiler import find_compiler, is_gcc
from blocks.engines.native import code
from blocks.engines.native import model as models
from blocks.library import FirstOrder, Sine
from blocks.text.errors import CompilerError, Fault
from tests.support.places import ROOT

COMPILER = find_compiler()
pytestmark = pytest.mark.skipif(COMPILER is None or not is_gcc(COMPILER), reason="gcc is not there")

LOOP: dict[str, Any] = {
    "format": "blocks-diagram",
    "version": 3,
    "name": "loop",
    "blocks": {
        "wave": {"type": "Sine", "parameters": {"omega": 2.0, "amplitude": 3.0}},
        "error": {"type": "Sum", "parameters": {"signs": "+-"}},
        "relay": {"type": "Relay", "parameters": {"on_at": 0.1, "off_at": -0.1, "on": 4.0, "off": -4.0}},
        "late": {"type": "TransportDelay", "parameters": {"delay": 0.03}},
        "lag": {"type": "FirstOrder", "parameters": {"T": 0.2}},
        "bend": {"type": "Trigonometry", "parameters": {"function": "tanh"}},
        "integral": {"type": "Integrator"},
        "hold": {"type": "ZeroOrderHold", "parameters": {"period": 0.05}},
    },
    "wires": {
        "error.u1": "wave.y", "error.u2": "integral.y", "relay.u": "error.y", "late.u": "relay.y", "lag.u": "late.y",
        "bend.u": "lag.y", "integral.u": "bend.y", "hold.u": "integral.y",
    },
    "measures": {"square": {"type": "ISE", "of": "error.y"}},
    "run": {"stop": 3.0, "every": 0.01, "log": ["*"]},
}  # fmt: skip
"""It has all that a step is judged by: events, a delay, ticks, functions of libm, a measure."""
METHODS = {"euler": 1e-3, "rk4": 2e-3, "dopri5": None, "radau": None, "auto": None}


@pytest.fixture
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache without code, and nothing remembered from before."""
    monkeypatch.setenv(caches.VARIABLE, str(tmp_path / "cache"))
    monkeypatch.setattr(models, "_MODELS", {})
    monkeypatch.setattr(code, "QUICKLY", True)
    return tmp_path / "cache"


def bits(results: Any) -> list[Any]:
    columns = [results.t, *(results[name] for name in results.names)]
    return [*(np.asarray(column).tobytes() for column in columns), results.measures, [*results.events]]


def only_model() -> models.Model:
    (model,) = models._MODELS.values()
    return model


def compile_meanwhile(kept: code.Code, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the compiler make the optimised code of a run that has gone on without it."""
    assert not kept.is_optimised
    monkeypatch.setattr(code, "PATIENCE", 0.0)
    kept.hurry(0.0)
    assert kept._optimising is not None
    kept._optimising._thread.join()
    assert kept._optimising.path is not None


def one_run(diagram: Diagram, monkeypatch: pytest.MonkeyPatch, *, quickly: bool, **words: Any) -> list[Any]:
    monkeypatch.setattr(code, "QUICKLY", quickly)
    models._MODELS.clear()
    results = diagram.run(engine="native", **words)
    assert only_model().code.is_optimised is not quickly
    return bits(results)


@pytest.mark.parametrize("method", METHODS)
def test_both_codes_compute_the_same_bits(method: str, fresh: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code, "PATIENCE", 1e9)
    words = {"method": method, "step": METHODS[method]}
    quick = one_run(Diagram.from_json(LOOP), monkeypatch, quickly=True, **words)
    assert quick == one_run(Diagram.from_json(LOOP), monkeypatch, quickly=False, **words)


@pytest.mark.parametrize("name", ["adrc.json", "iadrc.json", "control_iadrc_sampled.json"])
def test_the_robot_of_the_paper_has_the_same_bits(name: str, fresh: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code, "PATIENCE", 1e9)
    diagram = Diagram.load(ROOT / "diagrams" / "paper" / name)
    names = diagram.check().inputs
    words: dict[str, Any] = {"stop": 10.0, "inputs": {name: 0.3 for name, *_ in names}}
    quick = one_run(diagram, monkeypatch, quickly=True, **words)
    assert quick == one_run(Diagram.load(ROOT / "diagrams" / "paper" / name), monkeypatch, quickly=False, **words)


@pytest.mark.parametrize("method", METHODS)
def test_the_optimised_code_takes_over_in_the_midst_of_a_run(
    method: str, fresh: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(code, "PATIENCE", 1e9)
    words = {"method": method, "step": METHODS[method]}
    run = Diagram.from_json(LOOP).start(engine="native", **words)
    run.advance_to(0.7)
    model = only_model()
    compile_meanwhile(model.code, monkeypatch)
    first = model.address
    run.advance_to(1.1)
    assert model.code.is_optimised
    assert model.address != first
    run.advance_to(3.0)
    assert bits(run.finish()) == one_run(Diagram.from_json(LOOP), monkeypatch, quickly=False, **words)


def test_a_run_that_is_found_to_be_stiff_goes_on_as_such(fresh: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code, "PATIENCE", 1e9)
    diagram = Diagram("stiff")
    slow = diagram.add("slow", FirstOrder(T=1e-4))
    wave = diagram.add("wave", Sine(omega=3.0))
    diagram.wire(slow.u, wave.y)
    diagram.settings(stop=4.0, method="auto", log=["*"])

    def parts() -> Any:
        run = diagram.start(engine="native")
        run.advance_to(1.0)
        model = only_model()
        if not model.code.is_optimised:
            compile_meanwhile(model.code, monkeypatch)
        run.advance_to(4.0)
        assert model.code.is_optimised
        return run.finish()

    results = parts()
    assert results.statistics.method.startswith("auto: radau from")
    models._MODELS.clear()
    monkeypatch.setattr(code, "QUICKLY", False)
    assert bits(results) == bits(parts())


def test_a_prepared_model_runs_by_optimised_code(fresh: Path) -> None:
    diagram = Diagram.from_json(LOOP)
    diagram.run(engine="native", stop=0.1)
    model = only_model()
    assert not model.code.is_optimised
    before = model.setup.model  # type: ignore[attr-defined]
    diagram.prepare(engine="native")
    assert model.code.is_optimised
    assert model.setup.model == model.address != before  # type: ignore[attr-defined]


def test_a_compiler_that_fails_later_leaves_the_run_as_it_is(fresh: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> Path:
        raise CompilerError(Fault("E602", "", "no.", "None."))

    expected = one_run(Diagram.from_json(LOOP), monkeypatch, quickly=False)
    monkeypatch.setenv(caches.VARIABLE, str(fresh / "other"))
    monkeypatch.setattr(code, "PATIENCE", 0.0)
    monkeypatch.setattr(code, "build", fails)
    monkeypatch.setattr(code, "QUICKLY", True)
    models._MODELS.clear()
    run = Diagram.from_json(LOOP).start(engine="native")
    for stop in (0.5, 1.0, 3.0):
        run.advance_to(stop)
    assert not only_model().code.is_optimised
    assert bits(run.finish()) == expected


def test_a_cache_that_is_emptied_before_the_code_is_taken_leaves_the_run_as_it_is(
    fresh: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(code, "PATIENCE", 1e9)
    diagram = Diagram.from_json(LOOP)
    run = diagram.start(engine="native")
    run.advance_to(0.7)
    model = only_model()
    compile_meanwhile(model.code, monkeypatch)
    caches.clear()
    monkeypatch.setattr(code, "PATIENCE", 1e9)
    run.advance_to(1.1)
    assert not model.code.is_optimised
    run.advance_to(3.0)
    results = bits(run.finish())
    assert results == one_run(diagram, monkeypatch, quickly=False)


def test_a_fork_compiles_for_itself(fresh: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code, "PATIENCE", 1e9)
    run = Diagram.from_json(LOOP).start(engine="native")
    run.advance_to(0.1)
    kept = only_model().code
    compile_meanwhile(kept, monkeypatch)
    first = kept._optimising
    assert first is not None
    first.process, first.path = -1, None  # as in a child, where the thread of its parent does not exist
    run.advance_to(0.2)
    assert kept._optimising is not first


def test_a_compiler_with_arguments_of_its_own_optimises_at_once(fresh: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With -ffast-math, for example, both codes would differ in their bits."""
    monkeypatch.setenv("CC", "cc -DUNUSED=1")
    Diagram.from_json(LOOP).run(engine="native")
    assert only_model().code.is_optimised


def test_a_cache_that_does_not_last_is_filled_by_this_process(fresh: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code, "PATIENCE", 0.0)
    monkeypatch.setattr(apart, "is_possible", lambda: False)
    run = Diagram.from_json(LOOP).start(engine="native")
    run.advance_to(0.1)
    kept = only_model().code
    assert kept._optimising is not None
    kept._optimising._thread.join()
    run.advance_to(0.2)
    assert kept.is_optimised


def test_a_process_that_ends_leaves_the_compiler_at_work(fresh: Path, tmp_path: Path) -> None:
    """It does not wait, and the next process finds the optimised code."""
    file, log = tmp_path / "loop.json", tmp_path / "log"
    Diagram.from_json(LOOP).save(file)
    slow = tmp_path / "gcc"
    asks = 'case "$*" in *--version*) ;; *-O2*) sleep 3; echo done >> ' + str(log) + ";; esac"
    slow.write_text(f'#!/bin/sh\n{asks}\nexec cc "$@"\n', encoding="utf-8")
    slow.chmod(0o755)
    program = "import os, sys, time, blocks.engines.native.code as m; m.PATIENCE = 0.0\n"
    program += f"os.environ['CC'] = {str(slow)!r}\n"
    program += "from blocks import Diagram; Diagram.load(sys.argv[1]).run(engine='native'); time.sleep(1.0)"
    subprocess.run([sys.executable, "-c", program, str(file)], check=True, cwd=ROOT)
    assert not log.exists()
    program = program.replace("time.sleep(1.0)", "print(*[each.code.is_optimised for each in models.values()])")
    program = program.replace("import os", "from blocks.engines.native.model import _MODELS as models\nimport os", 1)
    until = time.monotonic() + 60
    said = ""
    while said != "True" and time.monotonic() < until:
        time.sleep(0.5)
        command = [sys.executable, "-c", program, str(file)]
        said = subprocess.run(command, check=True, cwd=ROOT, capture_output=True, text=True).stdout.strip()
    assert said == "True"
    assert not [path.name for path in fresh.iterdir() if path.name.startswith("failed-")]


def test_blocks_beside_an_fmu_go_on_by_optimised_code(fresh: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The FMU calls back into the master, whose code must stay what it was."""
    monkeypatch.setattr(code, "PATIENCE", 1e9)

    def whole(*, quickly: bool) -> list[Any]:
        monkeypatch.setattr(code, "QUICKLY", quickly)
        models._MODELS.clear()
        diagram = Diagram.load(ROOT / "diagrams" / "motor_pid.json")
        diagram.swap("motor", fmu(ROOT / "fmus" / "PMDCMotor.fmu"))
        run = diagram.start(engine="native")
        for part, stop in enumerate((0.4, 0.8, 2.0)):
            run.advance_to(stop)
            engine: Any = run._simulation.engine
            own = [running.engine.model for running in engine.units if hasattr(running, "engine")]
            assert own
            assert all(each.code.is_optimised for each in own) is (not quickly or part > 0)
            if quickly and part == 0:
                for each in (engine.code, *(model.code for model in own)):
                    compile_meanwhile(each, monkeypatch)
        return bits(run.finish())

    assert whole(quickly=True) == whole(quickly=False)
