"""FMUs that fail in a diagram: each fault is told, what was computed is kept, nothing is left behind, and the next run
works; in both engines, for both versions of FMI, in this process and in processes of their own.

Witnesses: the same diagram with an FMU that does not fail, up to the fault, bit for bit; and the errors of one engine
for those of the other.
"""

from __future__ import annotations

import contextlib
import gc
import json
import operator
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, FirstOrder, Step, Sum, fmu
from blocks.cli import main
from blocks.compile.toolchain import cache, isolation_build
from blocks.fmi import archive
from blocks.fmi.instance import Instance
from blocks.results.results import Results
from blocks.text.errors import BlocksError, CompilerError, Fault, FMUError, UsageError
from tests.support.faulty import FAULTS, NEEDS_COMPILER, make
from tests.support.marks import long
from tests.support.processes import children, maps

ON_LINUX = sys.platform.startswith("linux")
pytestmark = [NEEDS_COMPILER, pytest.mark.skipif(not ON_LINUX, reason="descriptors and processes as Linux tells them")]

ENGINES = ("reference", "native")
EACH = pytest.mark.parametrize("engine", ENGINES)
BOTH = pytest.mark.parametrize("fmi", [2, 3])
MOSTLY_3 = pytest.mark.parametrize("fmi", [long(2), 3])  # what both versions share
H, STOP, T_FAULT = 0.1, 1.0, 0.5  # s
LAST = 0.4  # s; the last communication point before the step that fails


def loop(path: Path, kind: str = "CS", *, isolate: bool = False, timeout: float = 60.0, **given: Any) -> Diagram:
    """A step, a controller with a lag, and the FMU as the plant: x' = u."""
    made = Diagram("loop")
    r, error, lag = made.add("r", Step(at=0.0)), made.add("error", Sum(signs="+-")), made.add("lag", FirstOrder(T=0.1))
    parameters = {"t_fault": T_FAULT, **given}
    if isinstance(fault := parameters.get("fault"), str):
        parameters["fault"] = FAULTS.index(fault)
    plant = made.add("plant", fmu(path, kind, isolate=isolate, timeout=timeout, parameters=parameters))
    made.wire(error.u1, r.y)
    made.wire(error.u2, plant.y)
    made.wire(lag.u, error.y)
    made.wire(plant.u, lag.y)
    return made


def run(diagram: Diagram, engine: str, order: int = 0, **settings: Any) -> Results:
    settings = {"stop": STOP, "log": ["plant.y", "lag.y"], "master": {"step": H, "order": order}, **settings}
    return diagram.run(engine=engine, **settings)


def failed(diagram: Diagram, engine: str, **settings: Any) -> FMUError:
    with pytest.raises(FMUError) as caught:
        run(diagram, engine, **settings)
    (fault,) = caught.value.faults
    cure, results = fault.cure, caught.value.results
    if len(results.t):
        kept = f" Results up to {results.t[-1]:.10g} s are kept."
        assert cure.endswith(kept)
        cure = cure.removesuffix(kept)
    assert cure
    assert str(fault).isprintable()
    assert caught.value.exit_status == 4
    return caught.value


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> dict[Any, Path]:
    """FMUs, by version and kind; and all is compiled and loaded that stays in a process."""
    folder = tmp_path_factory.mktemp("faulty")
    made: dict[Any, Path] = {}
    for fmi in (2, 3):
        for kind in ("CS", "ME"):
            made[fmi, kind] = make(folder, fmi=fmi, kind=kind, name=f"{kind.lower()}{fmi}")
            for engine in ENGINES:
                for isolate in (False, True):
                    run(loop(made[fmi, kind], kind, isolate=isolate), engine)
    gc.collect()  # what tests of other files left is not counted here
    return made


@pytest.fixture(scope="module")
def good(paths: dict[Any, Path]) -> Callable[..., Results]:
    """The results of the FMU that does not fail."""
    known: dict[Any, Results] = {}

    def of(fmi: int, engine: str, order: int = 0) -> Results:
        key = (fmi, engine, order)
        if key not in known:
            known[key] = run(loop(paths[fmi, "CS"]), engine, order)
        return known[key]

    return of


@pytest.fixture(autouse=True)
def nothing_left(
    request: pytest.FixtureRequest, paths: dict[Any, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Path]:
    """No process, no thread, no descriptor, no library and no temporary file stays."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))

    def there() -> tuple[Any, ...]:
        # A library that told of a fatal error is not called any more, also not at its end.
        mapped = 0 if "fatal" in request.node.name else Path("/proc/self/maps").read_text().count("blocks-fmu")
        names = set(os.listdir(folder))
        return children(), threading.active_count(), len(os.listdir("/proc/self/fd")), mapped, names

    def is_clean() -> bool:
        """Nothing is new; what was there before may go meanwhile, as a process of another test."""
        return all(map(operator.le, there(), before))

    before = there()
    assert before[-1] == set()
    yield folder
    end = time.monotonic() + 5.0
    while not is_clean() and time.monotonic() < end:
        gc.collect()
        time.sleep(0.01)
    assert is_clean(), (before, there())


def is_prefix(some: Results, whole: Results, last: float = LAST) -> None:
    """Rows up to a time are those of the run that did not fail."""
    n = len(some.t)
    assert some.t[-1] == pytest.approx(last, abs=1e-12)
    assert np.array_equal(some.t, whole.t[:n])
    assert np.array_equal(some.values, whole.values[:n])


# --- what functions return ----


@EACH
@BOTH
@pytest.mark.parametrize("isolate", [False, True])
def test_a_good_fmu_warns_of_nothing(fmi: int, engine: str, isolate: bool, paths: Any, good: Any) -> None:
    results = run(loop(paths[fmi, "CS"], isolate=isolate), engine)
    assert results.warnings == ()
    is_prefix(results, good(fmi, engine), STOP)


@BOTH
@pytest.mark.parametrize("order", [0, 1])
def test_both_engines_agree_on_a_good_fmu(fmi: int, order: int, good: Any) -> None:
    if fmi == 2 and order:
        pytest.skip("the derivatives of its inputs are right for one step only")
    one, other = good(fmi, "reference", order), good(fmi, "native", order)
    assert np.allclose(one.values, other.values, rtol=1e-12, atol=1e-14)


@EACH
@BOTH
@pytest.mark.parametrize("isolate", [False, True])
def test_a_warning_is_told_and_the_run_goes_on(fmi: int, engine: str, isolate: bool, paths: Any, good: Any) -> None:
    results = run(loop(paths[fmi, "CS"], fault="warning", isolate=isolate), engine)
    is_prefix(results, good(fmi, engine), STOP)
    (told,) = results.warnings
    assert (told.code, told.place) == ("W203", "plant")
    assert f"fmi{fmi}DoStep of cs{fmi}.fmu returned a warning at t = 0.4 s. The FMU reported: " in told.message
    assert '"a fault at 0.5 of 100%' in told.message


@EACH
@BOTH
@pytest.mark.parametrize("order", [0, 1])
def test_where_a_step_is_discarded_shorter_ones_are_tried(
    fmi: int, order: int, engine: str, paths: Any, good: Any
) -> None:
    if fmi == 2 and order:
        pytest.skip("the derivatives of its inputs are right for one step only")
    results = run(loop(paths[fmi, "CS"], fault="discard long"), engine, order)
    whole = good(fmi, engine, order)
    assert np.array_equal(results.t, whole.t)
    assert np.allclose(results.values, whole.values, rtol=1e-12 if order == 0 else 0.02)


@BOTH
def test_shorter_steps_are_the_same_in_both_engines(fmi: int, paths: Any) -> None:
    one, other = (run(loop(paths[fmi, "CS"], fault="discard long"), engine, fmi - 2) for engine in ENGINES)
    assert np.allclose(one.values, other.values, rtol=1e-12, atol=1e-14)


@EACH
def test_a_pending_step_is_waited_for(engine: str, paths: Any, good: Any) -> None:
    results = run(loop(paths[2, "CS"], fault="pending"), engine)
    is_prefix(results, good(2, engine), STOP)


@EACH
def test_a_step_that_stays_pending_is_given_up(engine: str, paths: Any, monkeypatch: Any, good: Any) -> None:
    monkeypatch.setitem(Instance.__init__.__kwdefaults__, "timeout", 0.2)
    begun = time.monotonic()
    error = failed(loop(paths[2, "CS"], fault="pending forever"), engine)
    assert 0.2 <= time.monotonic() - begun < 20.0
    assert str(error).startswith("E214 plant: fmi2DoStep of cs2.fmu at t = 0.4 s stayed pending for 0.2 s.")
    is_prefix(error.results, good(2, engine))


FAILURES = {
    "discard": ("E213", "discarded the step from t = 0.5 s, and each shorter one that was tried", 0.5),
    "discard mutely": ("E213", "and each shorter one that was tried", 0.4),
    "error": ("E213", "DoStep of {name} returned an error at t = 0.4 s", 0.4),
    "fatal": ("E213", "DoStep of {name} returned a fatal error at t = 0.4 s", 0.4),
    "illegal": ("E214", "DoStep of {name} returned the undefined status 9 at t = 0.4 s", 0.4),
    "error in get": ("E213", "Get{real} (y) of {name} returned an error at t = 0.5 s", 0.4),
    "pending": ("E214", "DoStep of {name} returned pending at t = 0.4 s", 0.4),
}


@pytest.mark.parametrize("isolate", [False, True])
@BOTH
@pytest.mark.parametrize("fault", FAILURES)
def test_a_failure_names_the_fmu_the_function_and_the_time(
    fault: str, fmi: int, isolate: bool, paths: Any, good: Any
) -> None:
    if fmi == 2 and fault == "pending":
        pytest.skip("FMI 3 only")
    code, text, last = FAILURES[fault]
    if fmi == 3 and fault == "discard mutely":
        last = 0.5  # FMI 3 always says how far it went
    text = text.format(name=f"cs{fmi}.fmu", real="Real" if fmi == 2 else "Float64")
    told = []
    for engine in ENGINES:
        error = failed(loop(paths[fmi, "CS"], fault=fault, isolate=isolate), engine)
        (one,) = error.faults
        assert (one.code, one.place) == (code, "plant")
        assert text in one.message
        assert "The FMU reported" in one.message
        is_prefix(error.results, good(fmi, engine), last)
        # The next run works.
        is_prefix(run(loop(paths[fmi, "CS"], isolate=isolate), engine), good(fmi, engine), STOP)
        told.append(str(one))
    assert told[0] == told[1]


def chain(path: Path, **given: Any) -> Diagram:
    """FMUs only: the input of the first is a number, and the second fails."""
    made = Diagram("chain")
    first = made.add("first", fmu(path))
    second = made.add("second", fmu(path, parameters={"t_fault": T_FAULT, **given}))
    made.wire(second.u, first.y)
    return made


@BOTH
@pytest.mark.parametrize("fault", ["warning", *FAILURES, "negative", "discard long", "terminate"])
def test_a_loop_of_fmus_only_judges_alike(fault: str, fmi: int, tmp_path: Path) -> None:
    """The native engine calls such FMUs in a loop of its own."""
    pairs = {
        2: (('<Outputs><Unknown index="3" dependencies="2 4"/>', '<Outputs><Unknown index="3" dependencies="4"/>'),),
        3: (('hasEventMode="true"', 'hasEventMode="false"'),
            ('<Output valueReference="2" dependencies="1 3"/>', '<Output valueReference="2" dependencies="3"/>')),
    }  # fmt: skip
    path = edited(make(tmp_path, fmi=fmi), *pairs[fmi], only="u")
    settings: dict[str, Any] = {"stop": STOP, "log": ["second.y"], "master": {"step": H, "order": 0}}
    told = []
    for engine in ENGINES:
        under_way = chain(path, fault=FAULTS.index(fault)).start(engine=engine, **settings)
        if engine == "native":
            assert under_way._simulation.engine._c.quick
        try:
            results, text = under_way.finish(), ""
        except FMUError as error:
            results, text = error.results, str(error)
        told.append((text, tuple(map(str, results.warnings)), results.t.tolist(), results["second.y"].tolist()))
    assert told[0] == told[1]
    assert bool(told[0][1]) == (fault in ("warning", "terminate"))
    is_fine = fault in ("warning", "discard long", "terminate") or (fmi == 2 and fault == "pending")
    assert bool(told[0][0]) != is_fine


@pytest.mark.parametrize("algorithm", ["gauss-seidel", "iterated", "controlled"])
@MOSTLY_3
@pytest.mark.parametrize("fault", ["error", "fatal", "discard mutely", "segfault", "hang"])
def test_other_algorithms_tell_the_same(fault: str, fmi: int, algorithm: str, paths: Any) -> None:
    master: dict[str, Any] = {"step": H, "order": 0}
    master |= {"tolerance": 0.5} if algorithm == "controlled" else {"algorithm": algorithm}
    isolate = fault in ENDS
    for engine in ENGINES:
        diagram = loop(paths[fmi, "CS"], fault=fault, isolate=isolate, timeout=0.3 if fault == "hang" else 60.0)
        error = failed(diagram, engine, master=master)
        assert error.code == ("E216" if isolate else "E213")
        assert error.faults[0].place == "plant"
        assert 0.0 <= error.results.t[-1] < T_FAULT + H


@BOTH
@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize("kind", ["CS", "ME"])
def test_an_fmu_that_says_that_it_can_go_back_and_cannot_is_not_asked_to(
    kind: str, fmi: int, isolate: bool, tmp_path: Path
) -> None:
    path = make(tmp_path, fmi=fmi, kind=kind, rolls_back=False, says_that_it_rolls_back=True)
    master = {"step": H, "order": 0, "algorithm": "iterated", "couple": "each"}
    one, other = (run(loop(path, kind, isolate=isolate), engine, master=master) for engine in ENGINES)
    assert np.allclose(one.values, other.values, rtol=1e-9, atol=1e-12)


@EACH
@BOTH
@pytest.mark.parametrize("isolate", [False, True])
def test_an_fmu_that_can_go_back_at_the_start_only_is_told_with_what_needs_it(
    fmi: int, isolate: bool, engine: str, tmp_path: Path
) -> None:
    path = make(tmp_path, fmi=fmi, defines=("NO_ROLLBACK_LATER",))
    error = failed(loop(path, isolate=isolate), engine, master={"step": H, "order": 0, "algorithm": "iterated"})
    (fault,) = error.faults
    assert (fault.code, fault.place) == ("E215", "plant")
    assert "faulty.fmu cannot be rolled back: fmi" in fault.message
    assert "at t = 0.5 s" in fault.message
    assert fault.cure.startswith('Use the algorithm "jacobi" or "gauss-seidel", and no tolerance of the master')


@EACH
@BOTH
def test_a_failure_at_the_start_is_told(fmi: int, engine: str, paths: Any) -> None:
    (fault,) = failed(loop(paths[fmi, "CS"], fault="error in get", t_fault=0.0), engine).faults
    assert (fault.code, fault.place) == ("E213", "plant")
    assert "returned an error at t = 0 s" in fault.message


@EACH
@BOTH
def test_after_a_fatal_error_no_instance_of_that_library_is_called(
    fmi: int, engine: str, paths: Any, good: Any
) -> None:
    settings = {"stop": STOP, "log": ["plant.y", "lag.y"], "master": {"step": H, "order": 0}, "engine": engine}
    other = loop(paths[fmi, "CS"]).start(**settings)
    other.advance_to(0.3)
    failed(loop(paths[fmi, "CS"], fault="fatal"), engine)
    if engine == "reference":
        with pytest.raises(
            FMUError, match=r"E213 plant: .* cannot be called: an instance of the FMU has reported a fatal error"
        ):
            other.finish()
    is_prefix(run(loop(paths[fmi, "CS"]), engine), good(fmi, engine), STOP)


# --- processes of their own ----

ENDS = {
    "segfault": "ended by signal 11 (segmentation fault)",
    "abort": "ended by signal 6 (abort)",
    "exit": "ended itself with exit(3)",
    "hang": "no answer within 0.5 s",
}


@pytest.mark.parametrize("kind", ["CS", "ME"])
@MOSTLY_3
@pytest.mark.parametrize("fault", ENDS)
def test_an_fmu_that_ends_its_process_is_an_error(fault: str, fmi: int, kind: str, paths: Any, good: Any) -> None:
    path = paths[fmi, kind]
    told = []
    for engine in ENGINES:
        whole = good(fmi, engine) if kind == "CS" else run(loop(path, kind), engine)
        begun = time.monotonic()
        error = failed(loop(path, kind, fault=fault, isolate=True, timeout=0.5 if fault == "hang" else 60.0), engine)
        assert time.monotonic() - begun < 30.0  # a timeout of 60 s is not waited for
        (one,) = error.faults
        assert (one.code, one.place) == ("E216", "plant")
        assert ENDS[fault] in one.message
        found = re.match(rf"{path.name} at t = (\S+) s: ", one.message)
        assert found
        assert float(found[1]) == pytest.approx(LAST if kind == "CS" else T_FAULT, abs=0.02)
        assert error.results.t[-1] <= float(found[1])
        is_prefix(error.results, whole, error.results.t[-1])
        told.append(re.sub(r"\d\.\d{5,}", "t", str(one)))
        again = run(loop(path, kind, isolate=True), engine)
        assert np.array_equal(again.values, whole.values)
    assert told[0] == told[1]


@EACH
@BOTH
@pytest.mark.parametrize("kind", ["CS", "ME"])
def test_a_process_of_its_own_changes_no_bit(kind: str, fmi: int, engine: str, paths: Any) -> None:
    one, other = (run(loop(paths[fmi, kind], kind, isolate=isolate), engine) for isolate in (False, True))
    assert np.array_equal(one.t, other.t)
    assert np.array_equal(one.values, other.values)


@EACH
@BOTH
@pytest.mark.parametrize("fault", ["segfault", "fatal"])
def test_other_instances_of_an_isolated_fmu_go_on(fault: str, fmi: int, engine: str, paths: Any, good: Any) -> None:
    settings = {"stop": STOP, "log": ["plant.y", "lag.y"], "master": {"step": H, "order": 0}, "engine": engine}
    other = loop(paths[fmi, "CS"], isolate=True).start(**settings)
    other.advance_to(0.3)
    failed(loop(paths[fmi, "CS"], fault=fault, isolate=True), engine)
    is_prefix(other.finish(), good(fmi, engine), STOP)


@EACH
@BOTH
def test_an_fmu_that_can_be_there_once_is_there_twice_in_two_processes(fmi: int, engine: str, tmp_path: Path) -> None:
    path = make(tmp_path, fmi=fmi, once=True)

    def two(isolate: bool) -> Diagram:
        made = Diagram("two")
        for name in ("a", "b"):
            made.add(name, fmu(path, isolate=isolate))
        return made

    settings: dict[str, Any] = {"stop": STOP, "engine": engine, "master": {"step": H}, "log": ["a.y", "b.y"]}
    with pytest.raises(FMUError, match=r'E211 faulty\.fmu: .* "isolate": true'):
        two(False).run(**settings)
    assert len(two(True).run(**settings).t) == 11
    # One diagram after the other needs none.
    for _ in range(2):
        kept = loop(path)
        run(kept, engine)


def test_a_run_goes_on_where_the_process_of_an_fmu_was_ended_from_outside(paths: Any, good: Any) -> None:
    """The error of a process that was killed between two calls."""
    from blocks.fmi.isolation import process

    settings = {"stop": STOP, "log": ["plant.y", "lag.y"], "master": {"step": H, "order": 0}}
    for engine in ENGINES:
        under_way = loop(paths[3, "CS"], isolate=True).start(engine=engine, **settings)
        under_way.advance_to(0.3)
        (unit,) = (one for one in under_way._simulation.engine.units if hasattr(one, "one"))
        os.kill(process(unit.one._raw.binding.library, unit.one.component), signal.SIGKILL)
        with pytest.raises(FMUError, match=r"E216 plant: cs3\.fmu at t = 0\.3 s: .* by signal 9 \(killed") as caught:
            under_way.finish()
        is_prefix(caught.value.results, good(3, engine), 0.3)
        with pytest.raises(UsageError, match="the run has failed"):
            under_way.finish()


# --- files that cannot run ----


@EACH
@BOTH
@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize(("binary", "code"), [("truncated", "E207"), ("none", "E201"), ("elsewhere", "E201")])
def test_a_binary_that_does_not_load_is_told(
    binary: str, code: str, isolate: bool, fmi: int, engine: str, tmp_path: Path
) -> None:
    path = make(tmp_path, fmi=fmi, name="broken", binary=binary)
    (fault,) = failed(loop(path, isolate=isolate), engine).faults
    assert (fault.code, fault.place) == (code, "broken.fmu")


@EACH
@BOTH
@pytest.mark.parametrize("isolate", [False, True])
def test_the_wrong_token_is_told_in_its_own_words(isolate: bool, fmi: int, engine: str, tmp_path: Path) -> None:
    path = make(tmp_path, fmi=fmi, token="{another}")
    text = str(failed(loop(path, isolate=isolate), engine))
    assert text.startswith("E212 plant: ")
    assert '"the token is not {faulty}"' in text


@EACH
@BOTH
@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize("function", ["DoStep", "ExitInitializationMode"])
def test_a_missing_function_is_told(function: str, isolate: bool, fmi: int, engine: str, tmp_path: Path) -> None:
    path = make(tmp_path, fmi=fmi, without=(f"fmi{fmi}{function}",))
    text = str(failed(loop(path, isolate=isolate), engine))
    assert text.startswith(f"E208 faulty.fmu: its binary lacks the function fmi{fmi}{function}, which this run needs.")


def read(path: Path) -> Fault:
    """The error of a file that is no block."""
    with pytest.raises(BlocksError) as caught:
        loop(path)
    (fault, *_) = caught.value.faults
    assert fault.cure
    assert fault.place or fault.file
    return fault


def test_files_that_are_no_fmus_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.fmu"
    path.write_bytes(b"no archive at all" * 100)
    assert read(path).code == "E202"
    with zipfile.ZipFile(path, "w") as made:
        made.writestr("readme.txt", "nothing")
    assert read(path).code == "E202"
    for name in ("../out.so", "binaries/../../out.so", "/etc/out.so"):
        with zipfile.ZipFile(path, "w") as made:
            made.writestr(archive.DESCRIPTION, "<fmiModelDescription/>")
            made.writestr(name, "x")
        assert read(path).code == "E203"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as made:
        made.writestr(archive.DESCRIPTION, "<fmiModelDescription/>")
        made.writestr("resources/bomb", bytes(64 * 2**20))
    assert read(path).code == "E203"
    assert not list(tmp_path.parent.glob("out.so"))


def edited(path: Path, *pairs: tuple[str, str], only: str = "") -> Path:
    """The FMU with another description. only: the input that is to be the only one."""
    made = path.with_name(f"edited_{path.name}")
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(made, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == archive.DESCRIPTION:
                text = data.decode()
                for a, b in pairs:
                    assert a in text
                    text = text.replace(a, b)
                if only:
                    others = rf'(name="(?!{only}")\w+" valueReference="\d+" causality=)"input"'
                    text = re.sub(others, r'\1"local"', text)
                data = text.encode()
            new.writestr(name, data)
    return made


DESCRIPTIONS = {
    "no end": (2, "E204", ("</ModelVariables>", "")),
    "no XML": (3, "E204", ("<?xml", "xml")),
    "a name twice": (2, "E206", ('name="x"', 'name="y"')),
    "a reference twice": (3, "E206", ('name="x" valueReference="3"', 'name="x" valueReference="2"')),
    "no such index": (2, "E206", ('<Unknown index="3"', '<Unknown index="999"')),
    "index 0": (2, "E206", ('<Unknown index="3"', '<Unknown index="0"')),
    "no such reference": (3, "E206", ('<Output valueReference="2"', '<Output valueReference="999"')),
    "its own derivative": (2, "E206", ('derivative="4"', 'derivative="5"')),
    "derivatives form a circle": (3, "E206", ('variability="continuous" initial="exact"',
                                            'variability="continuous" initial="exact" derivative="4"')),
    "an alias of another": (3, "E206", ('</Float64><Float64 name="w"', '<Alias name="w"/></Float64><Float64 name="w"')),
}  # fmt: skip


@pytest.mark.parametrize("what", DESCRIPTIONS)
def test_descriptions_that_contradict_themselves_are_refused(what: str, tmp_path: Path) -> None:
    fmi, code, pair = DESCRIPTIONS[what]
    fault = read(edited(make(tmp_path, fmi=fmi), pair))
    assert fault.code == code
    assert "edited_faulty.fmu" in str(fault)


def test_integers_that_no_number_holds_are_refused_with_the_name_of_the_fmu(tmp_path: Path) -> None:
    pair = ('name="i64" valueReference="19" causality="input" variability="discrete" start="0"',
            f'name="i64" valueReference="19" causality="input" variability="discrete" start="{2**60}"')  # fmt: skip
    fault = read(edited(make(tmp_path, fmi=3), pair))
    assert str(fault).startswith("E205 edited_faulty.fmu: 'i64' starts at 1152921504606846976, but")


@EACH
def test_references_that_stand_twice_are_aliases_in_fmi_2(engine: str, tmp_path: Path, good: Any) -> None:
    path = edited(make(tmp_path, fmi=2), ('name="x" valueReference="3"', 'name="x" valueReference="2"'))
    results = run(loop(path), engine, log=["plant.y", "plant.x"])
    assert np.array_equal(results["plant.x"], results["plant.y"])
    assert np.array_equal(results["plant.y"], good(2, engine)["plant.y"])


@EACH
@BOTH
def test_ten_thousand_variables_are_no_trouble(fmi: int, engine: str, tmp_path: Path, good: Any) -> None:
    one = (
        '<ScalarVariable name="l{0}" valueReference="{1}" causality="local" variability="continuous"><Real/>'
        "</ScalarVariable>"
        if fmi == 2
        else '<Float64 name="l{0}" valueReference="{1}" causality="local" variability="continuous"/>'
    )
    more = "".join(one.format(k, 1000 + k) for k in range(10_000))
    path = edited(make(tmp_path, fmi=fmi), ("</ModelVariables>", f"{more}</ModelVariables>"))
    begun = time.process_time()
    results = run(loop(path), engine)
    assert time.process_time() - begun < 10.0
    is_prefix(results, good(fmi, engine), STOP)


# --- runs that are dropped, interrupted, or many ----


@EACH
@BOTH
@pytest.mark.parametrize("isolate", [False, True])
def test_a_run_that_is_dropped_frees_its_fmus(
    isolate: bool, fmi: int, engine: str, paths: Any, nothing_left: Path
) -> None:
    under_way = loop(paths[fmi, "CS"], isolate=isolate).start(stop=STOP, engine=engine, master={"step": H})
    under_way.advance_to(0.3)
    assert os.listdir(nothing_left)
    del under_way
    gc.collect()
    assert os.listdir(nothing_left) == []


@EACH
@BOTH
def test_a_diagram_that_has_run_holds_nothing(fmi: int, engine: str, paths: Any, nothing_left: Path) -> None:
    kept = loop(paths[fmi, "CS"])
    for _ in range(2):
        kept.run(stop=STOP, engine=engine)
        run(kept, engine)
        gc.collect()
        assert os.listdir(nothing_left) == []


@EACH
@BOTH
def test_runs_in_threads_do_not_disturb_each_other(fmi: int, engine: str, paths: Any, good: Any) -> None:
    def one(k: int) -> Results | FMUError:
        diagram = loop(paths[fmi, "CS"], isolate=bool(k % 2), fault="segfault" if k % 4 == 3 else "none")
        try:
            return run(diagram, engine)
        except FMUError as error:
            return error

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(one, range(12)))
    for k, made in enumerate(found):
        if k % 4 == 3:
            assert isinstance(made, FMUError)
            assert made.code == "E216"
            is_prefix(made.results, good(fmi, engine))
            made.__traceback__ = None
        else:
            assert isinstance(made, Results)
            is_prefix(made, good(fmi, engine), STOP)


def in_file(folder: Path, path: Path, **entry: Any) -> Path:
    """The diagram in a file, beside the FMU."""
    made = loop(path, **entry)
    made.settings(stop=STOP, log=["plant.y", "lag.y"], master={"step": H, "order": 0})
    target = folder / "loop.json"
    made.save(target)
    return target


@EACH
def test_the_command_line_keeps_what_there_is(
    engine: str, paths: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], good: Any
) -> None:
    path = make(tmp_path, name="cs3")
    out = tmp_path / "out.csv"
    file = in_file(tmp_path, path, fault="segfault", isolate=True)
    assert json.loads(file.read_text())["blocks"]["plant"]["isolate"] is True
    assert main(["run", str(file), "-o", str(out), "--engine", engine]) == 4
    told = capsys.readouterr()
    assert "E216 plant: cs3.fmu at t = 0.4 s: the process of the FMU ended by signal 11" in told.err
    lines = [line for line in out.read_text().splitlines() if not line.startswith("#")]
    rows = np.loadtxt(lines[1:], delimiter=",")
    assert np.array_equal(rows[:, 0], good(3, engine).t[: len(rows)])
    assert rows[-1, 0] == pytest.approx(LAST)
    assert main(["run", str(file), "--json", "--engine", engine]) == 4
    entries = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [entry["code"] for entry in entries if entry["event"] == "fault"] == ["E216"]
    assert entries[-1]["event"] == "done"
    assert entries[-1]["t"] == pytest.approx(LAST)
    assert main(["run", str(file), "--set", "plant.fault=0", "--engine", engine]) == 0
    assert capsys.readouterr().err == ""
    assert main(["run", str(file), "--set", "plant.fault=1", "--engine", engine]) == 0
    assert "W203 plant: fmi3DoStep of cs3.fmu returned a warning at t = 0.4 s." in capsys.readouterr().err


INTERRUPTED = """
import sys
from blocks.cli import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize("fault", ["none", "discard long"])
def test_ctrl_c_within_a_step_waits_for_its_end(fault: str, paths: Any, good: Any) -> None:
    """The run goes on as if nothing had been."""

    def press(k: int) -> Iterator[float]:
        under_way = loop(paths[3, "CS"], fault=fault).start(
            stop=STOP, log=["plant.y", "lag.y"], engine="reference", master={"step": H, "order": 0}
        )
        (unit,) = (one for one in under_way._simulation.engine.units if hasattr(one, "one"))
        step, count = unit.one.step, 0

        def stepped(t: float, h: float) -> Any:
            nonlocal count
            count += 1
            if count == k:
                os.kill(os.getpid(), signal.SIGINT)
            return step(t, h)

        unit.one.step = stepped
        results = under_way.finish()
        yield float(results.interrupted)
        is_prefix(results, whole, results.t[-1])
        is_prefix(under_way.finish(), whole, STOP)
        unit.one.step = step

    whole = run(loop(paths[3, "CS"], fault=fault), "reference")
    assert sum(sum(press(k)) for k in range(1, 11)) == 10


@pytest.mark.parametrize(
    ("engine", "isolate"), [("native", True), ("reference", False), long("native", False), long("reference", True)]
)
def test_ctrl_c_keeps_what_there_is_and_leaves_nothing(
    isolate: bool, engine: str, tmp_path: Path, nothing_left: Path
) -> None:
    file = in_file(tmp_path, make(tmp_path), isolate=isolate)
    out = tmp_path / "out.csv"
    command = ["run", str(file), "--stop", "1e6", "-o", str(out), "--engine", engine, "--every", "1"]
    environment = {**os.environ, "TMPDIR": str(nothing_left)}
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, *command], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=environment, start_new_session=True,
    )  # fmt: skip
    try:
        end = time.monotonic() + 30
        listed = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        while time.monotonic() < end and not (listed.read_text() if isolate else maps(process.pid, "blocks-fmu-")):
            time.sleep(0.02)
        time.sleep(1.0)  # it is in its run
        assert process.poll() is None
        own = set(listed.read_text().split())
        assert len(own) == int(isolate)
        os.kill(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=60)
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        process.wait()
    assert process.returncode == 130, said
    assert "interrupted at t = " in said
    assert len(out.read_text().splitlines()) > 2
    assert not any(Path(f"/proc/{one}").exists() for one in own)


def test_without_a_compiler_there_are_no_processes(paths: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(isolation_build, "find_compiler", lambda: None)
    for kind in ("CS", "ME"):
        path = paths[3, kind]
        with pytest.raises(CompilerError, match=rf"E605 {path.name}: .*needs a C compiler"):
            run(loop(path, kind, isolate=True), "reference")


def test_an_fmu_alone_runs_in_a_process_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = edited(make(tmp_path, name="cs3"), only="u")
    command = ["fmu", "run", str(path), "--input", "u=1", "--isolate", "--stop", "1", "--master", "step=0.1", "--set"]
    assert main([*command, "fault=0"]) == 0
    assert main([*command, f"fault={FAULTS.index('abort')}"]) == 4
    assert (
        "E216 cs3: edited_cs3.fmu at t = 0.9 s: the process of the FMU ended by signal 6 (abort)"
        in capsys.readouterr().err
    )


def test_clearing_the_cache_forgets_what_was_tried(
    paths: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "cache"))
    run(loop(make(tmp_path, name="fresh", without=("fmi3Terminate",))), "reference")
    assert cache.of_user().read_note("fmu-loaded")
    assert main(["doctor", "--clear-cache"]) == 0
    assert cache.of_user().read_note("fmu-loaded") == ""
