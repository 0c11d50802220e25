"""Rows that go to a file while the run goes on: the file is that of a run in memory, also after a kill."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import BlocksError, Diagram, Noise, Results, Sine, UsageError
from blocks.api import streaming
from blocks.engines.native.native_engine import NativeEngine
from blocks.results import arrow
from blocks.results.arrow import Part
from tests.engines.test_saved_state import SHIPPED, mixed
from tests.support.marks import long, long_but
from tests.support.places import ROOT

BOTH = pytest.mark.parametrize("engine", ["native", "reference"])
SETTINGS: list[dict[str, Any]] = [
    {},
    {"method": "rk4", "step": 0.01},
    {"every": 0.003},
    {"every": 0.003, "jumps": True, "seed": 3, "stops": [0.5, 1.0], "log": ["plant.y", "noise.y", "ball.h"]},
    {"method": "radau"},
]
MASTER = {"couple": "each", "step": 0.01}


class Killed(BaseException):
    """In the place of a signal that ends the process."""


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks of some dozen rows, and moments of one step."""
    monkeypatch.setattr(streaming, "CHUNK", 2000)
    proceed = NativeEngine.proceed

    def one_step(engine: NativeEngine, stop: Any) -> bool:
        engine.sim.slice = 0.0
        return proceed(engine, stop)

    monkeypatch.setattr(NativeEngine, "proceed", one_step)


def killed(d: Diagram, out: Path, after: float = 1.1, **settings: Any) -> Path:
    """What a run leaves that is killed after so many seconds."""

    def progress(t: float, _: float) -> None:
        if t > after:
            raise Killed

    with pytest.raises(Killed):
        d.run(out=out, progress=progress, **settings)
    assert not out.exists()
    return Path(f"{out}.part")


def rows_of(results: Results) -> bytes:
    return np.column_stack([results.t, results.values]).tobytes()


@pytest.mark.parametrize(
    ("settings", "engine"),
    long_but(
        itertools.product(SETTINGS, ("native", "reference")),
        # radau runs in Python by both engines, as the reference engine does all.
        lambda settings, engine: (
            settings.get("method") != "radau"
            and (engine == "native" or "step" in settings or "jumps" in settings)
        ),
    ),
    ids=str,
)
def test_a_streamed_run_and_one_that_goes_on_give_the_file_of_a_run_in_memory(
    settings: dict[str, Any], engine: str, tmp_path: Path
) -> None:
    d, out = mixed(), tmp_path / "x.parquet"
    whole = d.run(engine=engine, **settings)
    whole.save(tmp_path / "whole.parquet")
    file = (tmp_path / "whole.parquet").read_bytes()
    streamed = d.run(engine=engine, out=out, **settings)
    assert streamed.stored is not None
    assert os.listdir(tmp_path) == ["whole.parquet", "x.parquet"] or len(os.listdir(tmp_path)) == 2
    assert out.read_bytes() == file
    assert streamed.table() == whole.table()
    assert (streamed.rows, streamed.span, streamed.events) == (whole.rows, whole.span, whole.events)
    assert streamed.measures == whole.measures
    assert np.array_equal(streamed["plant.y"], whole["plant.y"])
    assert streamed.stored is not None  # one signal was read
    assert rows_of(streamed) == rows_of(whole)
    out.unlink()

    part = killed(d, out, engine=engine, **settings)
    left = Results.load(part)
    assert 0.5 < left.t[-1] < 1.2
    assert left.interrupted
    assert rows_of(left) == rows_of(whole)[: len(rows_of(left))]
    rest = d.run(engine=engine, resume=part)
    assert out.read_bytes() == file
    assert not part.exists()
    assert rest.measures == whole.measures
    assert rows_of(rest) == rows_of(whole)


@pytest.mark.parametrize(
    "path", long_but(SHIPPED, lambda path: path.parent.name not in ("paper", "gallery")), ids=lambda path: path.stem
)
def test_the_files_of_shipped_diagrams_are_those_of_runs_in_memory(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streaming, "CHUNK", 2**14)
    d, out = Diagram.load(path), tmp_path / "x.parquet"
    stop = min(float(d.plan().settings.stop or 1.0), 2.0)
    d.run(stop=stop).save(tmp_path / "whole.parquet")
    d.run(stop=stop, out=out)
    assert out.read_bytes() == (tmp_path / "whole.parquet").read_bytes()


def test_a_part_that_was_cut_anywhere_gives_its_whole_chunks_and_the_same_file(tmp_path: Path) -> None:
    d, out, settings = mixed(), tmp_path / "x.parquet", {"every": 0.002, "log": ["plant.y", "noise.y"]}
    whole = d.run(**settings)
    whole.save(tmp_path / "whole.parquet")
    part = killed(d, out, **settings)
    data, size = part.read_bytes(), 0
    begin = len(arrow.header_of(Part.found(part).schema))
    assert len(Results.load(part).t) >= 4 * 80
    rng = np.random.default_rng(1)
    for end in sorted(rng.integers(0, len(data), 12).tolist()):
        for bad in (data[:end], data[:end] + bytes(64), data[:end] + bytes([data[end] ^ 255]) + data[end + 1 :]):
            part.write_bytes(bad)
            if end < begin:
                with pytest.raises(UsageError, match=r"E503 .*is not a part of a result file"):
                    Results.load(part)
                continue
            left = Results.load(part)
            assert rows_of(left) == rows_of(whole)[: len(rows_of(left))]
            size = max(size, len(left.t))
            if not len(left.t):
                with pytest.raises(UsageError, match=r"E506 .*does not hold a complete chunk of rows"):
                    d.run(resume=part)
    assert size > 0
    d.run(resume=part)  # the last one
    assert out.read_bytes() == (tmp_path / "whole.parquet").read_bytes()


def noisy() -> Diagram:
    d = Diagram("noisy")
    d.add("noise", Noise(period=0.01))
    d.add("sine", Sine(omega=3.0))
    d.input("r", default=0.0)
    d.settings(stop=2.0, every=0.005)
    return d


CHANGES: dict[str, tuple[dict[str, Any], str]] = {
    "stop": ({"stop": 3.0}, r"differs in its stop \(2\.0, and now 3\.0\)"),
    "every": ({"every": 0.01}, "differs in its every"),
    "signals": ({"log": ["sine.y"]}, "E506 recorded signals: .*other recorded signals"),
    "seed": ({"seed": 4}, "E506 .*seed"),
    "engine": ({"engine": "reference"}, "differs in its engine"),
    "parameters": ({"parameters": {"sine.omega": 2.0}}, "stores the parameters of its run"),
    "inputs": ({"inputs": {"r": 1.0}}, "stores the inputs of its run"),
    "file": ({"out": "y.parquet"}, r"E501 .*writes .*x\.parquet"),
}


@pytest.mark.parametrize("what", CHANGES)
def test_a_run_that_is_another_one_does_not_go_on(what: str, tmp_path: Path) -> None:
    settings, said = CHANGES[what]
    part = killed(noisy(), tmp_path / "x.parquet", engine="native")
    before = part.read_bytes()
    with pytest.raises(BlocksError, match=said):
        noisy().run(resume=part, **{"engine": "native", **settings})
    assert part.read_bytes() == before
    noisy().run(resume=part, engine="native", stop=2.0)  # the same may be said again


def test_a_diagram_that_has_changed_does_not_go_on(tmp_path: Path) -> None:
    part = killed(noisy(), tmp_path / "x.parquet")
    d = noisy()
    d.add("more", Sine())
    with pytest.raises(UsageError, match="E506"):
        d.run(resume=part)
    d = Diagram("noisy")
    d.add("noise", Noise(period=0.01))
    d.add("sine", Sine(omega=3.5))
    d.input("r", default=0.0)
    d.settings(stop=2.0, every=0.005)
    with pytest.raises(UsageError, match=r"E506 .*values of parameters"):
        d.run(resume=part)


@pytest.mark.parametrize("engine", ["native", long("reference")])
def test_a_master_streams_and_does_not_resume(engine: str, tmp_path: Path) -> None:
    d, out = mixed(), tmp_path / "x.parquet"
    d.run(engine=engine, master=MASTER).save(tmp_path / "whole.parquet")
    d.run(engine=engine, master=MASTER, out=out, progress=lambda t, stop: None)
    assert out.read_bytes() == (tmp_path / "whole.parquet").read_bytes()
    out.unlink()
    if engine == "reference":  # a moment of the native one may be the whole run
        part = killed(d, out, engine=engine, master=MASTER)
        assert len(Results.load(part).t) > 50
        with pytest.raises(UsageError, match=r"E506 .*cannot be resumed: FMUs for Co-Simulation and coupled blocks"):
            d.run(engine=engine, resume=part)


@pytest.mark.parametrize("data", [b"", b"PAR1" * 100, b"ARROW1\0\0" * 9, b"\xff\xff\xff\xff\x10\0\0\0" + bytes(90)])
def test_what_is_no_part_is_refused(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.parquet.part"
    path.write_bytes(data)
    with pytest.raises(UsageError, match=r"E503 .*is not a part of a result file"):
        Results.load(path)
    with pytest.raises(UsageError, match=r"E506 .*is not a part of a result file"):
        noisy().run(resume=path)
    with pytest.raises(UsageError, match="E506"):
        noisy().run(resume=tmp_path / "gone.parquet.part")
    assert path.read_bytes() == data


def test_two_runs_do_not_write_one_file(tmp_path: Path) -> None:
    part = killed(noisy(), tmp_path / "x.parquet")
    held = Part.found(part)
    for arguments in ({"resume": part}, {"out": tmp_path / "x.parquet"}):
        with pytest.raises(UsageError, match=r"E501 .*is being written by another run"):
            noisy().run(**arguments)  # type: ignore[arg-type]
    held.close()
    noisy().run(resume=part)


def test_an_interrupted_run_has_its_file_and_can_go_on(tmp_path: Path) -> None:
    d, out, whole = noisy(), tmp_path / "x.parquet", tmp_path / "whole.parquet"
    d.run().save(whole)

    def progress(t: float, _: float) -> None:
        if t > 1.0:
            raise KeyboardInterrupt

    results = d.run(out=out, progress=progress)
    assert results.interrupted
    assert Results.load(out).interrupted
    assert rows_of(Results.load(out)) == rows_of(results)
    d.run(resume=tmp_path / "x.parquet.part")
    assert out.read_bytes() == whole.read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["whole.parquet", "x.parquet"]


def test_a_full_disk_ends_the_run_and_leaves_what_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    d, out, whole = noisy(), tmp_path / "x.parquet", tmp_path / "whole.parquet"
    d.run().save(whole)
    write, count = Part._write, [0]

    def full(part: Part, message: Any, at: int) -> None:
        count[0] += 1
        if count[0] == 5:
            write(part, message[: len(message) // 2], at)
            raise OSError(28, "No space left on device")
        write(part, message, at)

    monkeypatch.setattr(Part, "_write", full)
    with pytest.raises(UsageError, match=r"E501 .*x\.parquet\.part: cannot be written: No space left on device"):
        d.run(out=out)
    d.run(resume=tmp_path / "x.parquet.part")
    assert out.read_bytes() == whole.read_bytes()


def test_a_short_run_has_no_part_and_any_format_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streaming, "CHUNK", 2**24)
    monkeypatch.setattr(Part, "begun", None)
    for ending in ("parquet", "csv", "mat"):
        results = noisy().run(out=tmp_path / f"x.{ending}")
        assert results.stored is None
        results.save(tmp_path / f"y.{ending}")
        assert (tmp_path / f"x.{ending}").read_bytes() == (tmp_path / f"y.{ending}").read_bytes()
    with pytest.raises(UsageError, match=r"E501 .*not a format of result files"):
        noisy().run(out=tmp_path / "x.txt")


def test_a_long_run_with_few_rows_has_a_part_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streaming, "CHUNK", 2**24)
    monkeypatch.setattr(streaming, "SECONDS", 0.0)
    assert len(Results.load(killed(noisy(), tmp_path / "x.parquet", engine="reference")).t) > 100


# --- reading a part of a file --------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ["parquet", "csv", "mat", "parquet.part"])
def test_signals_and_times_are_read_from_any_file(ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrow, "GROUP", 100)  # numbers
    path = tmp_path / f"x.{ending}"
    t = np.repeat(np.arange(50.0), 2)
    values = np.stack([t, -t, 10 + t, t**2], axis=1)
    columns = {"a": (0, (), "V"), "v": (1, (2,), "m"), "w": (3, (), "")}
    results = Results("d", t, values, columns)
    if ending == "parquet.part":
        table = results._table()
        part = Part.begun(tmp_path / "x.parquet", table, {})
        for rows in np.split(np.column_stack([t, values]), 10):
            part.add(rows, None)
        part.close()
    else:
        results.save(path)
    read = Results.load(path, signals=["w", "v"], start=3.0, stop=40.0)
    inside = (t >= 3.0) & (t <= 40.0)
    assert read.names == ("v", "w")
    assert np.array_equal(read.t, t[inside])
    assert np.array_equal(read["v"], values[inside, 1:3])
    assert (read["v"].unit, read["w"].unit) == ("m", "")
    assert Results.load(path, signals=["v[1]"], start=60.0)["v[1]"].shape == (0,)
    assert np.array_equal(Results.load(path, signals=["v[1]"], stop=0.5)["v[1]"], [10.0, 10.0])
    assert np.array_equal(Results.load(path).values, values)
    with pytest.raises(UsageError, match=r"E501 .*holds no signal 'x'"):
        Results.load(path, signals=["x"])


def test_only_row_groups_of_a_window_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pyarrow.parquet as pq

    monkeypatch.setattr(arrow, "GROUP", 1000)
    t = np.arange(10_000.0)
    Results("d", t, np.stack([t, -t], axis=1), {"a": (0, (), ""), "b": (1, (), "")}).save(tmp_path / "x.parquet")
    read: list[tuple[int, Any]] = []
    plain = pq.ParquetFile.read_row_group

    def told(file: Any, group: int, columns: Any = None) -> Any:
        read.append((group, columns))
        return plain(file, group, columns=columns)

    monkeypatch.setattr(pq.ParquetFile, "read_row_group", told)
    made = Results.load(tmp_path / "x.parquet", signals=["b"], start=5000.0, stop=5400.0)
    assert np.array_equal(made["b"], -np.arange(5000.0, 5401.0))
    assert read == [(15, ["time", "b"]), (16, ["time", "b"])]


# --- a process that is killed ------------------------------------------------------------------------------------

COMMAND = """
import sys
from blocks.api import streaming
from blocks.cli import main
streaming.CHUNK = 2**14
sys.exit(main(sys.argv[1:]))
"""


def test_a_command_that_is_killed_is_read_and_gone_on_from(tmp_path: Path) -> None:
    d = mixed()
    d.save(tmp_path / "d.json")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)])}

    def command(*arguments: str) -> list[str]:
        return [sys.executable, "-c", COMMAND, "run", "d.json", "--engine", "reference", *arguments]

    def done(*arguments: str) -> str:
        made = subprocess.run(command(*arguments), cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert made.returncode == 0, made.stderr
        return made.stdout

    settings = ("--method", "euler", "--step", "1e-3", "--seed", "7", "--set", "pid.kp=2.5")
    done("--out", "whole.parquet", *settings)
    part = tmp_path / "x.parquet.part"
    with subprocess.Popen(
        command("--out", "x.parquet", *settings), cwd=tmp_path, env=environment,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    ) as run:  # fmt: skip
        while run.poll() is None and not (part.exists() and part.stat().st_size > 120_000):
            time.sleep(0.001)
        run.kill()
    assert run.returncode == -signal.SIGKILL
    left = Results.load(part, signals=["plant.y"])
    assert 0.0 < left.t[-1] < 2.0
    assert "rows in x.parquet" in done("--resume", "x.parquet.part")
    assert (tmp_path / "x.parquet").read_bytes() == (tmp_path / "whole.parquet").read_bytes()
    assert not part.exists()


def test_results_are_never_those_of_another_run_that_wrote_the_same_file(tmp_path: Path) -> None:
    out = tmp_path / "x.parquet"
    first = noisy().run(out=out)
    assert first.stored is not None
    assert first["sine.y"].any()
    noisy().run(out=out, seed=5)
    for read in (lambda: first["noise.y"], lambda: rows_of(first)):
        with pytest.raises(UsageError, match=r"E501 .*was removed or overwritten"):
            read()
    again = noisy().run(out=out)
    out.unlink()
    with pytest.raises(UsageError, match=r"E501 .*was removed or overwritten"):
        rows_of(again)


def test_a_file_of_another_kind_is_not_replaced_by_a_part(tmp_path: Path) -> None:
    precious = tmp_path / "precious.txt"
    precious.write_text("precious")
    part = tmp_path / "x.parquet.part"
    part.write_text("mine")
    with pytest.raises(BlocksError, match=r"E501 .*would be replaced"):
        noisy().run(out=tmp_path / "x.parquet")
    assert part.read_text() == "mine"
    part.unlink()
    part.symlink_to(precious)
    with pytest.raises(BlocksError):
        noisy().run(out=tmp_path / "x.parquet")
    assert precious.read_text() == "precious"


def test_a_run_does_not_go_back_to_a_part(tmp_path: Path) -> None:
    part = killed(noisy(), tmp_path / "x.parquet")
    before = part.read_bytes()
    run = noisy().start()
    with pytest.raises(UsageError, match=r"E506 .*is a partial result file"):
        run.restore(part)
    run.advance(0.5)
    assert part.read_bytes() == before


def test_a_window_that_ends_before_it_begins_is_refused(tmp_path: Path) -> None:
    noisy().run(out=tmp_path / "x.parquet")
    with pytest.raises(UsageError, match="before it begins"):
        Results.load(tmp_path / "x.parquet", start=1.0, stop=0.5)
    assert Results.load(tmp_path / "x.parquet", signals="sine.y").names == ("sine.y",)
