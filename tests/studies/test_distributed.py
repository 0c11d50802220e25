"""Sweeps on workers of dask.distributed: the same bits as here, whatever becomes of the workers."""

from __future__ import annotations

import os
import pickle
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import distributed
import numpy as np
import pandas
import pytest

from blocks import (
    Block,
    Case,
    Constant,
    Diagram,
    FMUError,
    Input,
    Parameter,
    Sweep,
    UsageError,
    fmu,
    output,
)
from blocks.cli import main
from blocks.studies import distributed as module
from blocks.studies.distributed import Job
from tests.studies.test_sweep import VARY, asked, assert_same, noisy
from tests.support.fatal import Fatal
from tests.support.marks import long
from tests.support.places import ROOT

pytestmark = pytest.mark.usefixtures("native")

ASKED = {key: value for key, value in asked.items() if key != "threads"}
ROBOT = ROOT / "diagrams" / "paper" / "iadrc.json"  # with diagrams of other files


@contextmanager
def cluster_of(workers: int, **settings: Any) -> Iterator[distributed.Client]:
    places = {"dashboard_address": "127.0.0.1:0", "worker_dashboard_address": "127.0.0.1:0"}
    with (
        distributed.LocalCluster(n_workers=workers, threads_per_worker=1, **places, **settings) as made,  # type: ignore[no-untyped-call]
        distributed.Client(made) as client,  # type: ignore[no-untyped-call]
    ):
        yield client


@pytest.fixture(scope="module")
def client() -> Iterator[distributed.Client]:
    with cluster_of(2) as made:
        yield made


@pytest.fixture(scope="module")
def whole() -> Sweep:
    made: Sweep = noisy().sweep(VARY, **asked)
    return made


def in_chunks(of: int | None, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Let chunks have this size; the sizes that there were."""
    run, sizes = module.run_on, list[int]()

    def spied(on: Any, job: Any, table: Any, seeds: Any, made: Any, *how: Any) -> bool:
        keep = made.keep

        def watch(at: Any, rows: Any) -> None:
            sizes.append(len(at))
            keep(at, rows)

        made.keep = watch
        return run(on, job, table, seeds, made, *how, size=of)

    monkeypatch.setattr(module, "run_on", spied)
    return sizes


@pytest.mark.parametrize("size", [7, long(1), long(1000), long(None)])
def test_chunks_of_any_size_give_the_bits_of_a_sweep_here(
    size: int | None, client: distributed.Client, whole: Sweep, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes, told = in_chunks(size, monkeypatch), list[tuple[int, int]]()
    far = noisy().sweep(VARY, **ASKED, on=client, progress=lambda done, total: told.append((done, total)))
    assert_same(far, whole)
    assert sum(sizes) == 24
    assert max(sizes) == min(size or 12, 12)  # a chunk is of one scenario
    assert told[0] == (0, 24)
    assert told[-1] == (24, 24)


@pytest.mark.long
def test_a_worker_that_is_killed_in_the_middle_changes_nothing(whole: Sweep, monkeypatch: pytest.MonkeyPatch) -> None:
    killed: list[int] = []
    in_chunks(2, monkeypatch)
    with cluster_of(2) as client:

        def watch(done: int, _: int) -> None:
            if done >= 6 and not killed:
                killed.append(next(iter(client.run(os.getpid).values())))
                os.kill(killed[0], signal.SIGKILL)

        far = noisy().sweep(VARY, **ASKED, on=client, progress=watch)
    assert killed
    assert_same(far, whole)


@pytest.mark.long
def test_a_row_that_kills_each_worker_is_failed_and_all_others_are_what_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    d = Diagram("fatal", library=Fatal)
    value = d.parameter("u", 0.0)
    fatal = d.add("fatal", Fatal())
    d.wire(fatal.u, d.add("source", Constant(value=value)).y)
    d.measure("last", "peak", fatal.y)
    d.settings(stop=0.5)
    in_chunks(2, monkeypatch)
    with cluster_of(2) as client:
        far = d.sweep({"u": [0.1, 2.0, 0.3, 0.4]}, on=client)
    assert far.status.tolist() == ["ok", "failed", "ok", "ok"]
    assert "ended, with exit code 1" in far.messages[1]
    good = far.taken(far.status == "ok")
    assert good.measures["last"].tolist() == good.varied["u"].tolist()


@pytest.mark.long
def test_margins_and_rows_that_are_refused_come_back(
    client: distributed.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    d = Diagram.load(ROOT / "diagrams" / "motor_pid.json")
    vary = {"motor.Ra": [0.15, -0.2, 0.16], "kp": [0.5, 1.0]}
    given: dict[str, Any] = {"margins": {"phase": {"type": "phase_margin", "loop": "control.u"}}, "stop": 0.5}
    in_chunks(1, monkeypatch)
    far, here = d.sweep(vary, **given, on=client), d.sweep(vary, **given)
    assert here.counts() == {"ok": 4, "refused": 2}
    assert np.isfinite(here.measures["phase"]).any()
    assert_same(far, here)


@pytest.mark.long
def test_fmus_run_in_the_worker(client: distributed.Client) -> None:
    d = Diagram.load(ROOT / "diagrams" / "paper" / "iadrc_fmu.json")
    assert_same(d.sweep({"torque": [0.0, 2.0]}, stop=0.5, on=client), d.sweep({"torque": [0.0, 2.0]}, stop=0.5))


def test_what_no_worker_could_do_is_refused(client: distributed.Client, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="E501 threads: cannot be combined with on="):
        noisy().sweep(VARY, n=2, on=client, threads=2)
    with pytest.raises(UsageError, match="E501 on: 3 is not a client of dask"):
        noisy().sweep(VARY, n=2, on=3)

    class Local(Block):
        """Stands in a function."""

        k = Parameter(1.0)
        u = Input()

        @output
        def y(u, k):  # type: ignore[no-untyped-def]
            return k * u

    d = Diagram("local", library=Local)
    local = d.add("local", Local())
    d.wire(local.u, d.add("source", Constant()).y)
    d.measure("last", "peak", local.y)
    with pytest.raises(UsageError, match=r"E501 .*Local: is defined in tests\.studies\..*, from which workers cannot"):
        d.sweep({"local.k": [1.0, 2.0]}, stop=1.0, on=client)


def job_of(d: Diagram, column: str, **settings: Any) -> Job:
    case = Case(measures=list(d.value.measures), log=[], engine="reference", **settings)
    return Job.of(d, [column], [{}], case)


def test_the_text_of_a_job_holds_the_diagrams_of_other_files_and_computes_the_same() -> None:
    d = Diagram.load(ROBOT)
    job = job_of(d, "Jeq", stop=0.02)
    assert '"diagram": "' in d.dumps()
    assert '"diagram": "' not in job.text
    origin = d.start(log=[], engine="reference", stop=0.02).results.origin
    assert origin is not None
    assert job.computed[1:] == (origin.equations, origin.values)
    again = pickle.loads(pickle.dumps(job))
    row = again.made(0)[0]([[0.28]])
    assert row.measures == d.batch(["Jeq"], engine="reference", stop=0.02)([[0.28]]).measures


def test_a_worker_refuses_another_release_and_other_equations() -> None:
    job = replace(job_of(noisy(), "k"), key="other", computed=("0.0", "", ""))
    with pytest.raises(UsageError, match=r"E501 noisy: the worker .* has another release of blocks, or other"):
        job.made(0)


def test_an_fmu_is_what_it_was_or_is_refused(tmp_path: Path) -> None:
    place = tmp_path / "motor.fmu"
    shutil.copy(ROOT / "fmus" / "PMDCMotor.fmu", place)
    (tmp_path / "pyproject.toml").touch()
    d = Diagram("drive", folder=tmp_path)
    motor = d.add("motor", fmu(place))
    d.wire(motor.v, d.add("source", Constant(value=12.0)).y)
    d.wire(motor.tau, d.add("load", Constant(value=0.0)).y)
    d.measure("top", "peak", motor.omega)
    job = job_of(d, "source.value", stop=0.01)
    assert list(job.fmus) == [str(place)]
    job.diagram()
    shutil.copy(ROOT / "fmus" / "PMDCMotor_fmi2.fmu", place)
    with pytest.raises(FMUError, match=r"E202 .*motor\.fmu: is a different FMU on the worker"):
        job.diagram()
    place.unlink()
    with pytest.raises(FMUError, match=r"E202 .*motor\.fmu: is missing on the worker"):
        job.diagram()


def test_workers_write_the_rows_with_their_signals_and_a_sweep_goes_on_from_them(
    client: distributed.Client, whole: Sweep, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder of files, a chunk each; those that are missing run again, and a sweep that differs is refused."""
    sizes, place = in_chunks(5, monkeypatch), tmp_path / "rows"
    far = noisy().sweep(VARY, **ASKED, on=client, out=str(place))
    pandas.testing.assert_frame_equal(far.to_pandas(), whole.to_pandas(), check_exact=True)
    assert far.signals == {}
    files = sorted(place.glob("*.parquet"))
    assert files[1].name == "rows-0-000000005-000000009.parquet"
    pieces = [Sweep.load(file) for file in files]
    assert_same(replace(pieces[1], scenarios=(), again=None), replace(whole.taken(np.arange(5, 10)), scenarios=()))
    files[1].unlink()
    sizes.clear()
    again = noisy().sweep(VARY, **ASKED, on=client, out=str(place))
    assert sizes == [5]
    pandas.testing.assert_frame_equal(again.to_pandas(), whole.to_pandas(), check_exact=True)
    with pytest.raises(UsageError, match=r"E506 .*rows-0-.*belongs to a sweep that differs in its max_steps"):
        noisy().sweep(VARY, **ASKED, on=client, out=str(place), max_steps=1000)
    noisy().sweep(VARY, **ASKED, on=client, out=str(place), max_steps=1000, restart=True)
    assert len(list(place.glob("*.parquet"))) == 6


@pytest.mark.long
def test_the_command_gives_by_the_address_of_a_scheduler_what_it_gives_here(
    client: distributed.Client, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "noisy.json"
    noisy().save(path)
    words = ["sweep", str(path), "--vary", "k=normal:2,0.3", "--n", "5", "--out"]
    address = str(client.scheduler_info()["address"])
    assert main([*words, str(tmp_path / "here.parquet")]) == 0
    here = capsys.readouterr().out.replace("here", "far")
    assert main([*words, str(tmp_path / "far.parquet"), "--dask", address]) == 0
    assert capsys.readouterr().out == here
    assert_same(Sweep.load(tmp_path / "here.parquet"), Sweep.load(tmp_path / "far.parquet"))
