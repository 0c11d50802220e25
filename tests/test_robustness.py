"""Runs that meet the ends of a machine: no memory, no room on a disk, a signal, a kill at any moment."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    BlocksError,
    Diagram,
    Integrator,
    SimulationError,
    Sine,
    TransportDelay,
    UsageError,
    ZeroOrderHold,
    room,
)
from blocks.run import foreseen
from blocks.run.recording import Recording

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
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])}
    command = [sys.executable, "-c", textwrap.dedent(text), *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, **more)


# --- memory: what there is ---------------------------------------------------------------------------------------


@LINUX
def test_the_memory_that_is_there_is_what_the_system_says() -> None:
    with open("/proc/meminfo", encoding="ascii") as stream:
        left = next(int(line.split()[1]) for line in stream if line.startswith("MemAvailable")) * 1024
    assert 0 < room.available() <= 1.05 * left


@LINUX
@pytest.mark.parametrize("limit", ["RLIMIT_AS", "RLIMIT_DATA"])
def test_limits_of_a_process_are_taken_from_what_there_is(limit: str) -> None:
    text = """
        import mmap, resource, sys
        from blocks import room
        kind = getattr(resource, sys.argv[1])
        with open("/proc/self/statm") as stream:
            pages = stream.read().split()
        resource.setrlimit(kind, (4096 * int(pages[0 if kind == resource.RLIMIT_AS else 5]) + 2**28,) * 2)
        left = room.available()
        assert 0.9 * 2**28 < left <= 2**28, left
        try:
            mmap.mmap(-1, int(left) + 2**23, mmap.MAP_PRIVATE)
        except (OSError, MemoryError):
            kept = mmap.mmap(-1, int(left) - 2**23, mmap.MAP_PRIVATE)
            assert room.available() < 2**24
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
    assert [found.left() for found in room._found(tmp_path)] == [400000.0]


def test_where_nothing_is_known_of_memory_nothing_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "_system", lambda: math.inf)
    monkeypatch.setattr(room, "_limits", lambda: ())
    assert room.available() == math.inf
    foreseen.check("d", 10**12, 10)
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
    monkeypatch.setattr(room, "available", lambda: 8e9)
    with pytest.raises(UsageError) as caught:
        make().run(engine=engine, **settings)
    (fault,) = caught.value.faults
    assert fault.code == "E311"
    needed = room.told(8.0 * rows * 3 * 2)
    assert fault.message == f"{rows:,} rows of 2 signals take {needed} of memory, and 5.33 GB are there for it."
    assert fault.cure == "Record fewer signals (--log), or on a coarser grid (--every)."


@BOTH
@pytest.mark.parametrize("name", KNOWN)
def test_the_rows_that_are_foreseen_are_recorded(name: str, engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same runs, ten million times shorter: a refusal can only be right if there would be so many rows."""
    make, settings, rows = KNOWN[name]
    told: list[int] = []

    def look(place: str, rows: int, elements: int, more: float = 0.0) -> None:
        told.append(rows)

    monkeypatch.setattr(foreseen, "check", look)
    monkeypatch.setattr("blocks.cosim.engine.check", look)
    results = make().run(engine=engine, **{**settings, "stop": settings["stop"] * 1e-7})
    (foretold,) = told
    assert foretold == pytest.approx(rows * 1e-7, abs=1)
    # A jump stands as two rows, and without states no step is longer than a thousandth of the run.
    assert foretold <= len(results.t) <= 2.1 * foretold + 1001


def test_a_run_that_goes_on_records_from_there(monkeypatch: pytest.MonkeyPatch) -> None:
    run = wave().start(stop=100.0, every=0.01)
    run.advance_to(99)
    state = run.snapshot()
    monkeypatch.setattr(room, "for_recording", lambda: 8.0 * 3 * 2 * 1000)
    with pytest.raises(UsageError, match="E311 wave: 10,001 rows"):
        wave().run(stop=100.0, every=0.01)
    assert len(wave().run(stop=100.0, every=0.01, resume=state, engine="reference").t) == 101


@pytest.mark.parametrize(("engine", "size"), [("reference", 2 * 1e8 * 298), ("native", 2 * 1e8 * 64)])
def test_what_a_delay_remembers_is_foreseen(engine: str, size: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "available", lambda: 8e9)
    with pytest.raises(UsageError) as caught:
        delayed(1e6).run(stop=1e7, method="rk4", step=0.01, every=1e5, engine=engine)
    assert f"remembers of its steps takes {room.told(size)} of memory" in str(caught.value)


def test_check_tells_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from blocks.cli import main

    diagram = wave()
    diagram.settings(stop=1e12, every=1000)
    diagram.save(tmp_path / "wave.json")
    assert main(["run", str(tmp_path / "wave.json")]) == 2
    assert "E311 wave: 1,000,000,001 rows of 2 signals take 48 GB" in capsys.readouterr().err
    assert main(["check", str(tmp_path / "wave.json")]) == 2
    assert "E311 wave: 1,000,000,001 rows of 2 signals take 48 GB" in capsys.readouterr().out


GROWTH = """
    import sys, threading, time
    from blocks import Diagram, Sine, Integrator
    from blocks.run import foreseen

    def resident():
        with open("/proc/self/statm") as stream:
            return 4096 * int(stream.read().split()[1])

    told = []
    check = foreseen.check
    def look(place, rows, elements, more=0.0):
        told.append(8 * rows * (1 + elements) * foreseen.COPIES)
    foreseen.check = look
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
    monkeypatch.setattr(room, "INTERVAL", 0.0)
    monkeypatch.setattr(room, "available", Shrinking(5))
    with pytest.raises(SimulationError) as caught:
        wave(1e3).run(engine=engine, stop=1e4, **settings)
    error = caught.value
    assert error.code == "E311"
    assert "there is no memory for more: the recorded rows take" in str(error)
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
    diagram.run(engine=engine, stop=1e-3, **settings)
    with open("/proc/self/statm") as stream:
        size = 4096 * int(stream.read().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (size + 2**26,) * 2)
    try:
        diagram.run(engine=engine, stop=1e9, **settings)
    except SimulationError as error:
        t, values = error.results.t, error.results.values
        assert np.all(np.diff(t) >= 0)
        assert np.all(np.isfinite(values))
        print(error.code, values.nbytes + t.nbytes)
"""


@LINUX
@pytest.mark.parametrize("settings", [{}, {"master": {"couple": "each", "tolerance": 1e-1}}], ids=["plan", "master"])
def test_a_process_with_little_memory_ends_its_run_and_not_itself(settings: dict[str, Any]) -> None:
    done = script(LIMITED, "native", repr(settings))
    code, size = done.stdout.split()
    assert code == "E311", done.stderr
    assert 2**20 < float(size) < 2**25


@BOTH
def test_no_memory_in_the_middle_of_a_step_is_an_error_with_results(
    engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def progress(t: float) -> None:
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

    monkeypatch.setattr("blocks.run.simulation.Recording", none)
    with pytest.raises(BlocksError, match=r"E311 wave: at t = 0\.0 s there is no memory for more"):
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


def test_measures_of_a_master_are_the_same_in_pieces_of_any_size(monkeypatch: pytest.MonkeyPatch) -> None:
    diagram = wave(30.0)
    hold = diagram.add("hold", ZeroOrderHold(period=0.05))
    diagram.wire(hold.u, "sine.y")
    for name, kind in (("a", "IAE"), ("b", "settling_time"), ("c", "total_variation"), ("d", "overshoot")):
        diagram.measure(name, kind, "hold.y", 0.5)
    diagram.measure("e", "ISE", "x.y", start=0.123, stop=0.777)
    made = []
    for size in (65536, 50, 7, 1):
        monkeypatch.setattr("blocks.cosim.master.MOST_AT_ONCE", size)
        made.append(dict(diagram.run(stop=1.0, master=MASTER, engine="native").measures))
    assert all(str(one) == str(made[0]) for one in made), made
    run = diagram.start(stop=1.0, master=MASTER, engine="native")
    assert math.isnan(run.results.measures["c"])  # nothing but the start was seen
