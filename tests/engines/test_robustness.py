"""Runs that meet the ends of a machine: no memory, no room on a disk, a signal, a kill at any moment."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from blocks import (
    BlocksError,
    Diagram,
    Integrator,
    Results,
    SimulationError,
    Sine,
    TransportDelay,
    UsageError,
    ZeroOrderHold,
    fmu,
)
from blocks.cli import main
from blocks.engines.run import memory_estimate
from blocks.engines.run.recording import Recording
from blocks.host import available_memory
from tests.support.faulty import FAULTS, NEEDS_COMPILER, make
from tests.support.marks import long
from tests.support.places import ROOT
from tests.support.processes import lives, maps

ENGINES = ("reference", "native")
BOTH = pytest.mark.parametrize("engine", ENGINES)
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="limits and signals as of Linux")
MASTER = {"couple": "each", "step": 0.001}


def wave(omega: float = 1.0) -> Diagram:
    """A sine into an integrator; both are recorded."""
    diagram = Diagram("wave")
    sine, x = diagram.add("sine", Sine(omega=omega)), diagram.add("x", Integrator())
    diagram.wire(x.u, sine.y)
    return diagram


def script(text: str, *arguments: str, **more: Any) -> subprocess.CompletedProcess[str]:
    """A Python script in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)])}
    command = [sys.executable, "-c", textwrap.dedent(text), *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, **more)


# --- memory: what there is ---------------------------------------------------------------------------------------


@LINUX
def test_the_memory_that_is_there_is_what_the_system_says() -> None:
    with open("/proc/meminfo", encoding="ascii") as stream:
        left = next(int(line.split()[1]) for line in stream if line.startswith("MemAvailable")) * 1024
    assert 0 < available_memory.available() <= 1.05 * left


@LINUX
@pytest.mark.parametrize("limit", ["RLIMIT_AS", "RLIMIT_DATA"])
def test_limits_of_a_process_are_taken_from_what_there_is(limit: str) -> None:
    text = """
        import mmap, resource, sys
        from blocks.host import available_memory
        kind = getattr(resource, sys.argv[1])
        with open("/proc/self/statm") as stream:
            pages = stream.read().split()
        resource.setrlimit(kind, (4096 * int(pages[0 if kind == resource.RLIMIT_AS else 5]) + 2**28,) * 2)
        left = available_memory.available()
        assert 0.9 * 2**28 < left <= 2**28, left
        try:
            mmap.mmap(-1, int(left) + 2**23, mmap.MAP_PRIVATE)
        except (OSError, MemoryError):
            kept = mmap.mmap(-1, int(left) - 2**23, mmap.MAP_PRIVATE)
            assert available_memory.available() < 2**24
            print("fine")
    """
    done = script(text, limit)
    assert done.stdout == "fine\n", done.stderr


GROUPS = {
    "v2": ("0::/user/run\n", "", "user/run", ("memory.max", "memory.current", "inactive_file")),
    "v2, the group above": ("0::/user/run\n", "", "user", ("memory.max", "memory.current", "inactive_file")),
    "v2, a path of the host": ("0::/docker/abc\n", "", "", ("memory.max", "memory.current", "inactive_file")),
    "v1": (
        "5:cpu:/x\n4:memory:/user/run\n0::/\n", "memory", "user/run",
        ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", GROUPS)
def test_control_groups_limit_what_is_there(name: str, tmp_path: Path) -> None:
    listed, mount, group, (limit, used, cached) = GROUPS[name]
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/self/cgroup").write_text(listed)
    top = tmp_path / "sys/fs/cgroup" / mount
    for folder, most in ((top / "user/run", "max"), (top / group, "1000000")):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / limit).write_text(f"{most}\n")
        (folder / used).write_text("700000\n")
        (folder / "memory.stat").write_text(f"anon 5\n{cached} 100000\n")
    assert [found.left() for found in available_memory._found(tmp_path)] == [400000.0]


def test_where_nothing_is_known_of_memory_nothing_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(available_memory, "_system", lambda: math.inf)
    monkeypatch.setattr(available_memory, "_limits", lambda: ())
    assert available_memory.available() == math.inf
    memory_estimate.check("d", 10**12, 10)
    assert len(wave().run(stop=1.0, every=0.1).t) == 11


# --- memory: what a run will take --------------------------------------------------------------------------------

KNOWN: dict[str, tuple[Any, dict[str, Any], int]] = {
    "grid": (wave, {"stop": 1e9, "every": 1}, 10**9 + 1),
    "fixed steps": (wave, {"stop": 1e8, "method": "rk4", "step": 0.1}, 10**9 + 1),
    "ticks": (lambda: held(1e-7), {"stop": 100.0}, 10**9 + 1),
    "delays": (lambda: delayed(1e-7), {"stop": 100.0}, 10**9 + 1),
    "master": (wave, {"stop": 1e6, "master": MASTER}, 10**9 + 1),
    "master, grid": (wave, {"stop": 1e6, "every": 0.002, "master": MASTER}, 10**9 // 2 + 1),
    "master, controlled": (
        wave, {"stop": 1e6, "every": 0.001, "master": {"couple": "each", "tolerance": 1e-4}}, 10**9 + 1
    ),
}  # fmt: skip


def held(period: float) -> Diagram:
    diagram = Diagram("held")
    sine, hold = diagram.add("sine", Sine()), diagram.add("hold", ZeroOrderHold(period=period))
    diagram.wire(hold.u, sine.y)
    return diagram


def delayed(delay: float) -> Diagram:
    diagram = Diagram("delayed")
    sine, past = diagram.add("sine", Sine()), diagram.add("past", TransportDelay(delay=delay))
    diagram.wire(past.u, sine.y)
    return diagram


@BOTH
@pytest.mark.parametrize("name", KNOWN)
def test_a_recording_that_cannot_fit_is_refused_before_the_run(
    name: str, engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    make, settings, rows = KNOWN[name]
    monkeypatch.setattr(available_memory, "available", lambda: 8e9)
    with pytest.raises(UsageError) as caught:
        make().run(engine=engine, **settings)
    (fault,) = caught.value.faults
    assert fault.code == "E311"
    needed = available_memory.told(8.0 * rows * 3 * (2 if "master" in settings else 1.1))
    assert fault.message == f"{rows:,} rows of 2 signals need {needed} of memory, and 5.33 GB are available."
    assert fault.cure == "Record fewer signals (--log), or on a coarser grid (--every)."


@BOTH
@pytest.mark.parametrize("name", KNOWN)
def test_the_rows_that_are_foreseen_are_recorded(name: str, engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same runs, ten million times shorter: a refusal can only be right if there would be so many rows."""
    make, settings, rows = KNOWN[name]
    told: list[int] = []

    def look(place: str, rows: int, elements: int, more: float = 0.0, *, copies: float = 0.0) -> None:
        told.append(rows)

    monkeypatch.setattr(memory_estimate, "check", look)
    monkeypatch.setattr("blocks.engines.selection.check", look)
    results = make().run(engine=engine, **{**settings, "stop": settings["stop"] * 1e-7})
    (foretold,) = told
    assert foretold == pytest.approx(rows * 1e-7, abs=1)
    # A jump stands as two rows, and without states no step is longer than a thousandth of the run.
    assert foretold <= len(results.t) <= 2.1 * foretold + 1001


def test_a_run_that_goes_on_records_from_there(monkeypatch: pytest.MonkeyPatch) -> None:
    run = wave().start(stop=100.0, every=0.01)
    run.advance_to(99)
    state = run.snapshot()
    monkeypatch.setattr(available_memory, "for_recording", lambda: 8.0 * 3 * 2 * 30_000)
    with pytest.raises(UsageError, match="E311 wave: 100,001 rows"):
        wave().run(stop=100.0, every=0.001)
    assert len(wave().run(stop=100.0, every=0.001, resume=state, engine="reference").t) == 1001


@pytest.mark.parametrize(("engine", "size"), [("reference", 2 * 1e8 * 298), ("native", 2 * 1e8 * 64)])
def test_what_a_delay_remembers_is_foreseen(engine: str, size: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(available_memory, "available", lambda: 8e9)
    with pytest.raises(UsageError) as caught:
        delayed(1e6).run(stop=1e7, method="rk4", step=0.01, every=1e5, engine=engine)
    assert f"the history of the run's steps needs {available_memory.told(size)} of memory" in str(caught.value)


def test_check_tells_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    diagram = wave()
    diagram.settings(stop=1e12, every=1000)
    diagram.save(tmp_path / "wave.json")
    assert main(["run", str(tmp_path / "wave.json")]) == 2
    assert "E311 wave: 1,000,000,001 rows of 2 signals need 26.4 GB" in capsys.readouterr().err
    assert main(["check", str(tmp_path / "wave.json")]) == 2
    assert "E311 wave: 1,000,000,001 rows of 2 signals need 26.4 GB" in capsys.readouterr().out


GROWTH = """
    import sys, threading, time
    from blocks import Diagram, Sine, Integrator
    from blocks.engines.run import memory_estimate

    def resident():
        with open("/proc/self/statm") as stream:
            return 4096 * int(stream.read().split()[1])

    told = []
    check = memory_estimate.check
    def look(place, rows, elements, more=0.0):
        told.append(8 * rows * (1 + elements) * memory_estimate.COPIES)
    memory_estimate.check = look
    diagram = Diagram("wide")
    for k in range(20):
        sine, x = diagram.add(f"s{k}", Sine()), diagram.add(f"x{k}", Integrator())
        diagram.wire(x.u, sine.y)
    engine, rows = sys.argv[1], int(sys.argv[2])
    diagram.run(engine=engine, stop=1.0, every=0.01, method="rk4", step=0.5)
    before, most, done = resident(), 0, False
    def watch():
        global most
        while not done:
            most = max(most, resident())
            time.sleep(0.002)
    thread = threading.Thread(target=watch)
    thread.start()
    diagram.settings(doc="another")
    results = diagram.run(engine=engine, stop=float(rows), every=1, method="rk4", step=rows / 4)
    done = True
    thread.join()
    print(told[-1], max(most, resident()) - before, len(results.t))
"""


@LINUX
@pytest.mark.parametrize(("engine", "rows"), [("reference", 60_000), ("native", 600_000)])
def test_what_is_foreseen_is_what_a_run_takes(engine: str, rows: int) -> None:
    done = script(GROWTH, engine, str(rows))
    foretold, taken, recorded = map(float, done.stdout.split())
    assert recorded == rows + 1
    assert 0.8 * foretold < taken < 1.2 * foretold + 2e7, done.stdout


# --- memory: what no one can foresee -----------------------------------------------------------------------------


class Shrinking:
    """What there is, less at each look."""

    def __init__(self, looks: int) -> None:
        self.looks = looks

    def __call__(self) -> float:
        self.looks -= 1
        return 8e9 if self.looks > 0 else 1e6


@BOTH
@pytest.mark.parametrize("settings", [{}, {"master": {"couple": "each", "tolerance": 1e-3}}], ids=["plan", "master"])
def test_a_run_that_grows_beyond_memory_ends_with_its_results(
    engine: str, settings: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(available_memory, "INTERVAL", 0.0)
    monkeypatch.setattr(available_memory, "available", Shrinking(5))
    with pytest.raises(SimulationError) as caught:
        wave(1e3).run(engine=engine, stop=1e4, **settings)
    error = caught.value
    assert error.code == "E311"
    assert "no memory is left: the recorded rows take" in str(error)
    assert "are kept." in str(error)
    assert error.results is not None
    assert len(error.results.t) > 1
    assert error.results.t[-1] < 1e4


LIMITED = """
    import resource, sys
    import numpy as np
    from blocks import Diagram, Sine, Integrator, SimulationError
    engine, settings = sys.argv[1], eval(sys.argv[2])
    diagram = Diagram("grows")
    sine, x = diagram.add("sine", Sine(omega=1e3)), diagram.add("x", Integrator())
    diagram.wire(x.u, sine.y)
    diagram.run(engine=engine, **{**settings, "stop": 1e-3})
    with open("/proc/self/statm") as stream:
        size = 4096 * int(stream.read().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (size + 2**26,) * 2)
    try:
        diagram.run(engine=engine, **settings)
    except SimulationError as error:
        t, values = error.results.t, error.results.values
        assert np.all(np.diff(t) >= 0)
        assert np.all(np.isfinite(values))
        print(error.code, values.nbytes + t.nbytes)
"""


@LINUX
@pytest.mark.parametrize(
    "settings",
    # Steps that follow an error over 1e9 s would be too short to end (E301).
    [{"stop": 1e9}, {"stop": 1e4, "master": {"couple": "each", "tolerance": 1e-1}}],
    ids=["plan", "master"],
)
def test_a_process_with_little_memory_ends_its_run_and_not_itself(settings: dict[str, Any]) -> None:
    done = script(LIMITED, "native", repr(settings))
    code, size = done.stdout.split()
    assert code == "E311", done.stderr
    assert 2**20 < float(size) < 2**25


@BOTH
def test_no_memory_in_the_middle_of_a_step_is_an_error_with_results(
    engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def progress(t: float, _: float) -> None:
        if t > 0.5:
            raise MemoryError

    with pytest.raises(SimulationError) as caught:
        wave(100.0).run(engine=engine, stop=1e4, method="rk4", step=0.01, every=0.1, progress=progress)
    assert caught.value.code == "E311"
    assert caught.value.results is not None
    assert caught.value.results.t[-1] >= 0.5


def test_no_memory_before_a_run_begins_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*arguments: Any) -> Any:
        raise MemoryError

    monkeypatch.setattr("blocks.engines.reference.rows.Recording", none)
    with pytest.raises(BlocksError, match=r"E311 wave: at t = 0\.0 s no memory is left"):
        wave().run(stop=1.0, engine="reference")


def test_a_recording_is_the_same_in_chunks_of_any_size() -> None:
    made = []
    for chunk in (1, 3, 7, 100):
        recording = Recording(2)
        recording.chunk = chunk
        for k in range(23):
            recording.add(float(k), (2.0 * k, -1.0 * k))
            assert recording.last == (float(k), (2.0 * k, -1.0 * k))
        made.append(recording.arrays())
        assert recording.bytes == 23 * 3 * 8
    for t, values in made:
        assert np.array_equal(t, np.arange(23.0))
        assert np.array_equal(values, np.stack([2 * t, -t], axis=1))
    empty = Recording(2)
    assert (empty.arrays()[0].shape, empty.arrays()[1].shape) == ((0,), (0, 2))


@BOTH
@pytest.mark.parametrize("settings", [{"method": "rk4", "step": 0.01}, {"every": 0.004}], ids=str)
def test_results_that_were_taken_stay_as_they_are_while_the_run_goes_on(engine: str, settings: dict[str, Any]) -> None:
    settings = {**settings, "stop": 100.0, "stops": [60.0, 61.0]}
    whole = wave().run(engine=engine, **settings)
    run = wave().start(engine=engine, **settings)
    taken = []
    for stop in (60.0, 60.0, 61.0, 100.0, 100.0):
        run.advance_to(stop)
        taken.append((run.results, run.results.values.tobytes()))
    for results, before in taken:
        rows = len(results.t)
        assert results.values.tobytes() == before == whole.values[:rows].tobytes()
        assert results.t.tobytes() == whole.t[:rows].tobytes()
    assert len(taken[-1][0].t) == len(whole.t)


def test_measures_of_a_master_are_the_same_in_pieces_of_any_size(monkeypatch: pytest.MonkeyPatch) -> None:
    diagram = wave(30.0)
    hold = diagram.add("hold", ZeroOrderHold(period=0.05))
    diagram.wire(hold.u, "sine.y")
    for name, kind in (("a", "IAE"), ("b", "settling_time"), ("c", "total_variation"), ("d", "overshoot")):
        diagram.measure(name, kind, "hold.y", 0.5)
    diagram.measure("e", "ISE", "x.y", start=0.123, stop=0.777)
    made = []
    for size in (65536, 50, 7, 1):
        monkeypatch.setattr("blocks.engines.master.master_measures.MOST_AT_ONCE", size)
        made.append(dict(diagram.run(stop=1.0, master=MASTER, engine="native").measures))
    assert all(str(one) == str(made[0]) for one in made), made
    run = diagram.start(stop=1.0, master=MASTER, engine="native")
    assert math.isnan(run.results.measures["c"])  # nothing but the start was seen


# --- signals -----------------------------------------------------------------------------------------------------

COMMAND = "import sys; from blocks.cli import main; sys.exit(main(sys.argv[1:]))"
SIGNALS = {"SIGINT": 130, "SIGTERM": 143, "SIGHUP": 129}
LONG = {"reference": ("3000", "0.03"), "native": ("3000", "0.00003")}
"""The stop and the step of a run of some seconds, which tells of each tenth."""


class Command:
    """A command in a process and a folder of its own, whose temporary files are seen."""

    begun: ClassVar[list[subprocess.Popen[str]]] = []

    def __init__(self, folder: Path, *arguments: str, **more: Any) -> None:
        self.temporary = folder / "temporary"
        self.temporary.mkdir(exist_ok=True)
        paths = os.pathsep.join(filter(None, sys.path))
        environment = {**os.environ, "PYTHONPATH": paths, "TMPDIR": str(self.temporary), "PYTHONUNBUFFERED": ""}
        self.process = subprocess.Popen(
            [sys.executable, "-c", COMMAND, *arguments], cwd=folder, env=environment, text=True,
            **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **more},
        )  # fmt: skip
        self.begun.append(self.process)
        self.said = ""

    def until(self, text: str) -> None:
        """Read what it says up to a text, a regular expression."""
        assert self.process.stderr is not None
        while not re.search(text, self.said):
            line = self.process.stderr.readline()
            assert line, self.said
            self.said += line

    def send(self, name: str) -> None:
        self.process.send_signal(getattr(signal, name))

    def ended(self) -> tuple[int, str, str]:
        """Exit code, what it printed, and what it said."""
        out, said = self.process.communicate(timeout=60)
        assert [*self.temporary.iterdir()] == []
        return self.process.returncode, out, self.said + (said or "")

    def children(self) -> list[int]:
        """The processes that it has begun."""
        listed = Path(f"/proc/{self.process.pid}/task").glob("*/children")
        return [int(word) for path in listed for word in path.read_text().split()]


def of_run(engine: str, *more: str) -> tuple[str, ...]:
    stop, step = LONG[engine]
    return (
        "run",
        "wave.json",
        "--stop",
        stop,
        "--every",
        "1",
        "--method",
        "euler",
        "--step",
        step,
        "--engine",
        engine,
        *more,
    )


@pytest.fixture(autouse=True)
def no_command_goes_on() -> Iterator[None]:
    """Also where a test fails before the end of its command."""
    yield
    while Command.begun:
        with Command.begun.pop() as process:
            process.kill()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    wave().save(tmp_path / "wave.json")
    return tmp_path


@LINUX
@pytest.mark.parametrize(
    ("engine", "name"),
    [
        ("native", "SIGTERM"),
        long("native", "SIGINT"),
        long("native", "SIGHUP"),
        long("reference", "SIGTERM"),
    ],
)
def test_a_signal_keeps_what_was_computed(engine: str, name: str, folder: Path) -> None:
    command = Command(folder, *of_run(engine, "--out", "out.csv", "--save", "state", "--plot", "plot.svg"))
    command.until(" %  t = ")
    command.send(name)
    status, out, said = command.ended()
    assert status == SIGNALS[name], said
    results = Results.load(folder / "out.csv")
    assert results.interrupted
    assert 1.0 < results.t[-1] < 3000.0
    assert np.all(np.diff(results.t) > 0)
    for text in ("x.y", f"{len(results.t)} rows in out.csv", "figure in plot.svg", "in state"):
        assert text in out
    assert "the results up to this time are kept; --resume state goes on from there" in said
    assert {path.name for path in folder.iterdir()} == {"out.csv", "plot.svg", "state", "temporary", "wave.json"}
    reached = Diagram.load(folder / "wave.json").start(stop=3000.0, resume=folder / "state").t
    assert 0.0 <= reached - results.t[-1] <= 1.0


@LINUX
@pytest.mark.long
def test_a_signal_that_is_ignored_stays_ignored(folder: Path) -> None:
    """As under nohup."""
    command = Command(folder, *of_run("native"), preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    command.until(" %  t = ")
    command.send("SIGHUP")
    command.until("[2-9]. %  t = ")
    command.send("SIGTERM")
    assert command.ended()[0] == 143


@LINUX
def test_a_run_in_the_background_hears_that_it_shall_end(folder: Path) -> None:
    """A shell without job control lets what it begins in the background ignore Ctrl-C."""
    ignore = lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)  # noqa: E731
    command = Command(folder, *of_run("native", "--out", "out.csv"), preexec_fn=ignore)
    command.until(" %  t = ")
    command.send("SIGINT")
    command.until("[2-9]. %  t = ")
    command.send("SIGTERM")
    status, _, said = command.ended()
    assert status == 143, said
    assert Results.load(folder / "out.csv").interrupted


@LINUX
def test_a_signal_while_files_are_written_ends_the_command_at_once(folder: Path) -> None:
    (folder / "x.csv").write_text("old")
    text = """
        import os, signal, sys
        from blocks.results import files
        from blocks.cli import main
        write = files.write_csv
        def slow(stream, table, *, metadata):
            write(stream, table, metadata=metadata)
            stream.flush()
            os.kill(os.getpid(), signal.SIGTERM)
            write(stream, table, metadata=metadata)
        files.write_csv = slow
        sys.exit(main(sys.argv[1:]))
    """
    done = script(text, "run", "wave.json", "--stop", "1", "--every", "0.1", "--out", "x.csv", cwd=folder)
    assert (done.returncode, done.stdout) == (143, ""), done.stderr
    assert done.stderr == "interrupted\n"
    assert (folder / "x.csv").read_text() == "old"
    assert [path.name for path in folder.iterdir() if path.name.endswith(".part")] == []


@LINUX
def test_two_signals_write_nothing(folder: Path) -> None:
    command = Command(folder, *of_run("native", "--out", "x.csv"))
    command.until(" %  t = ")
    command.process.send_signal(signal.SIGSTOP)
    command.send("SIGTERM")
    command.send("SIGINT")
    command.process.send_signal(signal.SIGCONT)
    status, out, said = command.ended()
    assert status in (130, 143)
    assert (out, said.endswith("interrupted\n")) == ("", True)
    assert not (folder / "x.csv").exists()


def plant(folder: Path, fault: str, *, isolate: bool) -> list[str]:
    """A diagram with an FMU that fails at t = 5 s, and what runs it with steps that take long enough to be seen."""
    path = make(folder, fmi=3, kind="CS", name="plant")
    diagram = Diagram("plant", folder=folder)
    parameters = {"fault": FAULTS.index(fault), "t_fault": 5.0}
    diagram.add("plant", fmu(path, "CS", isolate=isolate, parameters=parameters))
    diagram.settings(inputs={})
    diagram.wire("plant.u", diagram.input("u", default=1.0))
    diagram.save(folder / "plant.json")
    return ["run", "plant.json", "--stop", "1e5", "--every", "0.01", "--master", "step=0.01", "--log", "plant.y"]


@LINUX
@NEEDS_COMPILER
@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize(("engine", "name"), [("native", "SIGTERM"), long("reference", "SIGINT")])
def test_a_signal_ends_fmus_and_keeps_what_they_gave(engine: str, name: str, isolate: bool, folder: Path) -> None:
    arguments = plant(folder, "none", isolate=isolate)
    for seconds in (1.0, 4.0, 16.0):  # until it is in its run, which takes longer where others use the machine
        command = Command(folder, *arguments, "--engine", engine, "--out", "out.csv")
        wait_for(lambda: len(command.children()) == 1 if isolate else maps(command.process.pid, "plant"))  # noqa: B023
        time.sleep(seconds)
        children = command.children()
        command.send(name)
        status, out, said = command.ended()
        assert status == SIGNALS[name], said
        if out:
            break
    assert "plant.y" in out
    assert len(children) == isolate
    results = Results.load(folder / "out.csv")
    assert results.interrupted
    assert np.allclose(results["plant.y"], results.t, rtol=1e-9)
    wait_for(lambda: not any(map(lives, children)))


def wait_for(condition: Any) -> None:
    end = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@LINUX
@NEEDS_COMPILER
@pytest.mark.long
@pytest.mark.parametrize("engine", ["reference", "native"])
def test_an_fmu_that_hangs_is_ended_by_a_second_signal(engine: str, folder: Path) -> None:
    command = Command(folder, *plant(folder, "hang", isolate=False), "--engine", engine, "--out", "out.csv")
    wait_for(lambda: [*command.temporary.iterdir()])
    time.sleep(2.0)
    command.send("SIGTERM")
    command.until("interrupted: the run ends after this step; a second Ctrl-C ends it at once\n")
    begin = time.monotonic()
    command.send("SIGINT")
    status, out, _ = command.ended()
    assert (status, out) == (143, "")
    assert time.monotonic() - begin < 10.0
    assert not (folder / "out.csv").exists()


def pair(folder: Path, kind: str, *defines: str) -> None:
    """A diagram of two FMUs one after the other."""
    path = make(folder, fmi=3, kind=kind, name="pair", defines=defines)
    diagram = Diagram("pair", folder=folder)
    diagram.add("sine", Sine(omega=50.0))
    diagram.add("a", fmu(path, kind))
    diagram.add("b", fmu(path, kind))
    diagram.wire("a.u", "sine.y")
    diagram.wire("b.u", "a.y")
    diagram.save(folder / "pair.json")


def interrupted_pair(folder: Path, engine: str, name: str, *more: str, **options: Any) -> tuple[int, str, float]:
    """A run of it that gets a signal after a while: exit code, what it said, and the s until it ended."""
    arguments = ("run", "pair.json", "--stop", "1e6", "--every", "1", "--log", "a.y", "--out", "out.csv")
    command = Command(folder, *arguments, "--engine", engine, *more, **options)
    wait_for(lambda: maps(command.process.pid, "pair"))
    time.sleep(1.0)  # it is in its run
    begin = time.monotonic()
    command.send(name)
    status, _, said = command.ended()
    return status, said, time.monotonic() - begin


@LINUX
@NEEDS_COMPILER
@pytest.mark.parametrize(
    ("kind", "engine"), [("CS", "native"), ("ME", "reference"), long("CS", "reference"), long("ME", "native")]
)
def test_a_signal_while_an_fmu_says_something_is_heard(kind: str, engine: str, folder: Path) -> None:
    """Python looks for signals where a function begins: in what hears the FMU, through which nothing can be raised."""
    pair(folder, kind, "TALKS", "STEP_MS=5")
    more = ("--master", "step=0.001") if kind == "CS" else ("--method", "rk4", "--step", "0.001")
    status, said, _ = interrupted_pair(folder, engine, "SIGTERM", *more)
    assert status == 143, said
    assert "the results up to this time are kept" in said
    assert "Traceback" not in said
    assert "ignored" not in said
    assert Results.load(folder / "out.csv").interrupted


@LINUX
@NEEDS_COMPILER
def test_a_signal_in_the_background_is_heard_while_an_fmu_says_something(folder: Path) -> None:
    pair(folder, "CS", "TALKS", "STEP_MS=5")
    ignore = lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)  # noqa: E731
    status, said, _ = interrupted_pair(folder, "native", "SIGTERM", "--master", "step=0.001", preexec_fn=ignore)
    assert status == 143, said
    assert "the results up to this time are kept" in said
    assert "Traceback" not in said
    assert Results.load(folder / "out.csv").interrupted


@LINUX
@NEEDS_COMPILER
@pytest.mark.parametrize("gap", [long(0.005), 0.05])
def test_a_second_signal_does_not_disturb_the_end_of_fmus(gap: float, folder: Path) -> None:
    """Much of it is done where objects go, where what is raised is lost, with a trace and with folders left over."""
    pair(folder, "CS", "TALKS", "STEP_MS=5")
    arguments = ("run", "pair.json", "--stop", "1e6", "--every", "1", "--log", "a.y", "--master", "step=0.001")
    command = Command(folder, *arguments, "--engine", "reference")
    wait_for(lambda: maps(command.process.pid, "pair"))
    time.sleep(1.0)  # it is in its run
    command.send("SIGTERM")
    time.sleep(gap)
    with contextlib.suppress(ProcessLookupError):
        command.send("SIGTERM")
    status, _, said = command.ended()
    assert status in (143, -signal.SIGTERM), said
    assert "Traceback" not in said


@LINUX
@NEEDS_COMPILER
@pytest.mark.parametrize(
    ("master", "engine"),
    [
        (("step=0.01",), "native"),
        (("tolerance=1e-4",), "reference"),
        long(("step=0.01",), "reference"),
        long(("tolerance=1e-4",), "native"),
        long(("algorithm=gauss-seidel", "step=0.01"), "native"),
        long(("algorithm=gauss-seidel", "step=0.01"), "reference"),
    ],
    ids=lambda one: one if isinstance(one, str) else one[0],
)
def test_a_signal_is_heard_after_one_step_of_slow_fmus(master: tuple[str, ...], engine: str, folder: Path) -> None:
    """Each step takes 0.2 s, and what two steps give differs from what one gives, so that many steps are refused."""
    pair(folder, "CS", "STEP_MS=200", "NOISE=1e-3")
    more = [word for one in master for word in ("--master", one)]
    status, said, seconds = interrupted_pair(folder, engine, "SIGTERM", *more)
    assert status == 143, said
    assert "the results up to this time are kept" in said
    assert seconds < 10.0  # six steps of FMUs at most, and what is written


def study_of(folder: Path, stop: str) -> None:
    settings = {"method": "euler", "step": 0.00003, "every": 1}
    document = {
        "format": "blocks-study", "version": 1, "name": "study",
        "runs": {
            "short": {"diagram": "wave.json", "settings": {"stop": 10, **settings}},
            "long": {"diagram": "wave.json", "settings": {"stop": float(stop), **settings}},
            "last": {"diagram": "wave.json", "settings": {"stop": 10, **settings}},
        },
        "claims": [{"run": name, "measure": "m"} for name in ("short", "long")],
    }  # fmt: skip
    diagram = wave()
    diagram.measure("m", "peak", "x.y")
    diagram.save(folder / "wave.json")
    (folder / "study.json").write_text(json.dumps(document), encoding="utf-8")


@LINUX
@NEEDS_COMPILER
def test_a_study_that_is_interrupted_keeps_the_runs_that_are_done(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study_of(folder, "1e6")
    (folder / "out").mkdir()
    (folder / "out" / "report.html").write_text("the last one")
    monkeypatch.setenv("BLOCKS_ENGINE", "native")
    command = Command(folder, "study", "study.json", "--out", "out")
    command.until("running long\n")
    time.sleep(1.5)
    command.send("SIGTERM")
    status, out, said = command.ended()
    assert status == 143, said
    assert "interrupted: long, last not run; no report was written" in said
    assert f"short is in {Path('out', 'short.csv')}" in said
    assert "short" in out
    assert "long" not in out
    assert sorted(os.listdir(folder / "out")) == ["report.html", "short.csv"]
    assert (folder / "out" / "report.html").read_text() == "the last one"
    kept = Results.load(folder / "out" / "short.csv")
    assert (len(kept.t), kept.interrupted) == (11, False)


# --- no room for what is written ---------------------------------------------------------------------------------


def small(folder: Path, most: int, *arguments: str) -> tuple[int, str, str]:
    """A run that may write files of so many bytes at most."""
    import resource

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    run = ("run", "wave.json", "--stop", "50", "--every", "0.01", "--engine", "reference")
    return Command(folder, *run, *arguments, preexec_fn=limit).ended()


@LINUX
@pytest.mark.parametrize("ending", ["csv", long("parquet"), long("mat")])
def test_without_room_for_one_file_the_others_and_the_table_are_kept(ending: str, folder: Path) -> None:
    if ending == "parquet":
        pytest.importorskip("pyarrow")
    (folder / f"out.{ending}").write_text("old")
    status, out, said = small(folder, 60_000, "--out", f"out.{ending}", "--save", "state", "--plot", "plot.svg")
    assert status == 2
    told = [line for line in said.splitlines() if line.startswith("E501")]
    assert told == [
        f"E501 out.{ending}: cannot be written: File too large. Nothing was changed. "
        "Write less, or name a file where larger ones may be."
    ]
    assert "kept: state at t = 50 s in state, figure in plot.svg" in said
    assert "x.y" in out
    assert "figure in plot.svg" in out
    assert "rows in" not in out
    assert (folder / f"out.{ending}").read_text() == "old"
    assert sorted(os.listdir(folder)) == [f"out.{ending}", "plot.svg", "state", "temporary", "wave.json"]
    rest = Diagram.load(folder / "wave.json").run(stop=51, resume=folder / "state")
    assert rest.t[0] == 50.0


@LINUX
def test_without_room_for_anything_the_table_is_kept(folder: Path) -> None:
    status, out, said = small(folder, 100, "--out", "out.csv", "--save", "state", "--plot", "plot.svg")
    assert status == 2
    assert said.count("File too large") == 3
    assert "kept: only the table" in said
    assert "x.y" in out
    assert sorted(os.listdir(folder)) == ["temporary", "wave.json"]


@LINUX
@pytest.mark.parametrize(
    ("stdout", "arguments"),
    [
        ("full", ()),
        ("closed", ("--out", "-")),
        long("closed", ()),
        long("full", ("--json",)),
        long("closed", ("--json",)),
        long("full", ("--out", "-")),
    ],
)
def test_a_stdout_that_takes_nothing_is_told(stdout: str, arguments: tuple[str, ...], folder: Path) -> None:
    run = ("run", "wave.json", "--stop", "50", "--every", "0.01", "--engine", "reference", "--save", "state")
    with open("/dev/full", "w") as full:
        more = {"stdout": full} if stdout == "full" else {"preexec_fn": lambda: os.close(1)}
        status, _, said = Command(folder, *run, *arguments, **more).ended()
    assert status == 2
    why = "No space left on device" if stdout == "full" else "it is closed"
    assert f"E501 stdout: cannot be written: {why}." in said
    assert "Traceback" not in said
    assert "Exception ignored" not in said
    assert (folder / "state").stat().st_size > 500
    if "-" in arguments:
        assert "x.y" in said
        assert "kept: state at t = 50 s in state" in said


@LINUX
@pytest.mark.parametrize("arguments", [("check", "wave.json"), ("draw", "wave.json"), ("list",)])
def test_other_commands_tell_of_a_stdout_that_is_full(arguments: tuple[str, ...], folder: Path) -> None:
    with open("/dev/full", "w") as full:
        status, _, said = Command(folder, *arguments, stdout=full).ended()
    assert status == 2
    assert said.startswith("E501 stdout: cannot be written: No space left on device.")
    assert said.count("\n") == 1


@LINUX
def test_a_stderr_that_takes_nothing_does_not_end_a_run(folder: Path) -> None:
    for more in ({"stderr": open("/dev/full", "w")}, {"preexec_fn": lambda: os.close(2)}):  # noqa: SIM115
        command = Command(folder, *of_run("native", "--stop", "300"), **more)
        status, out, _ = command.ended()
        assert status == 0
        assert "x.y" in out
        if "stderr" in more:
            more["stderr"].close()


@LINUX
def test_a_reader_that_has_read_enough_ends_nothing_else(folder: Path) -> None:
    run = ("run", "wave.json", "--stop", "500", "--every", "0.01", "--engine", "reference")
    command = Command(folder, *run, "--out", "-", "--plot", "plot.svg")
    assert command.process.stdout is not None
    assert command.process.stdout.readline() == "time,sine.y,x.y\n"
    command.process.stdout.close()
    assert command.process.stderr is not None
    with command.process.stderr as stream:
        said = stream.read()
    assert command.process.wait() == 0
    assert "x.y" in said
    assert (folder / "plot.svg").exists()


@pytest.mark.parametrize("option", ["--out", "--save", "--plot"])
def test_what_cannot_be_written_is_told_before_the_run(
    option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    wave().save("wave.json")
    ending = {"--out": ".csv", "--save": "", "--plot": ".svg"}[option]
    cases = {
        "x" * 300 + ending: "cannot be written: File name too long",
        f"none/x{ending}": "the folder none does not exist",
        "folder": "is not an ordinary file",
        "wave.json": "is also an input of this command",
    }
    (tmp_path / "folder").mkdir()
    for path, why in cases.items():
        assert main(["run", "wave.json", "--stop", "1", option, path]) == 2
        assert f"E501 {option} {path}: {why}" in capsys.readouterr().err
    assert sorted(os.listdir(tmp_path)) == ["folder", "wave.json"]


def test_a_spectrum_of_rows_that_are_too_uneven_is_refused() -> None:
    from blocks.studies.report import amplitude_spectrum

    t = np.concatenate([np.arange(100) * 1e-9, [1.0]])
    with pytest.raises(UsageError, match="E501 spectrum: steps of 1e-09 s over 1 s make more than 16,777,216 points"):
        amplitude_spectrum(t, np.sin(t))
