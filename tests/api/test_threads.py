"""Threads: one run is used by one of them at a time, and runs of one diagram side by side are exact."""

import math
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import BouncingBall, Constant, Diagram, FirstOrder, Gain, Run, SimulationError, UsageError
from blocks.compile.toolchain.compiler import find_compiler

COUPLED = {"couple": "each", "step": 0.01}
ENGINES: dict[str, dict[str, Any]] = {
    "reference": {"engine": "reference"},
    "native": {"engine": "native"},
    "master in Python": {"engine": "reference", "master": COUPLED},
    "master in C": {"engine": "native", "master": COUPLED},
}
if find_compiler() is None:
    del ENGINES["native"], ENGINES["master in C"]
FIXED = {"method": "rk4", "step": 0.01}


@pytest.fixture(autouse=True)
def often() -> Iterator[None]:
    """Threads take turns as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(before)


def lag() -> Diagram:
    """1 through a lag of 1 s."""
    made = Diagram("lag")
    made.add("one", Constant())
    made.add("gain", Gain())
    made.add("lag", FirstOrder())
    made.wire("gain.u", "one.y")
    made.wire("lag.u", "gain.y")
    return made


def in_threads(work: Callable[[int], None], count: int) -> None:
    """Call `work` in threads at once; raise what one of them raised."""
    raised: list[BaseException] = []
    begin = threading.Barrier(count)

    def guarded(number: int) -> None:
        begin.wait()
        try:
            work(number)
        except BaseException as error:
            raised.append(error)

    threads = [threading.Thread(target=guarded, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if raised:
        raise raised[0]


CALLS: dict[str, Callable[[Run], Any]] = {
    "advance": lambda run: run.advance(0.5),
    "advance_to": lambda run: run.advance_to(0.5),
    "finish": lambda run: run.finish(),
    "set": lambda run: run.set("gain.k", 3.0),
    "restore": lambda run: run.restore("nowhere.state"),
    "snapshot": lambda run: run.snapshot(),
    "save": lambda run: run.save("here.state"),
    "given": lambda run: run.given,
    "value": lambda run: run["lag.y"],
    "results": lambda run: run.results,
}


@pytest.mark.parametrize("kind", ENGINES)
def test_a_second_thread_is_refused_while_one_is_inside_of_a_run_and_changes_nothing(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    settings = {"stop": 1.0, **FIXED, **ENGINES[kind]}
    faults: dict[str, str] = {}
    seen: list[float] = []
    runs: list[Run] = []
    others: list[threading.Thread] = []

    def other() -> None:
        (run,) = runs
        seen.append(run.t)  # the time may be read at any time
        for name, call in CALLS.items():
            try:
                call(run)
            except UsageError as error:
                faults[name] = str(error)

    def progress(t: float, _: float) -> None:
        seen.append(runs[0]["lag.y"])  # the thread that is inside may go on using it
        if not others:
            others.append(threading.Thread(target=other))
            others[0].start()
            others[0].join(10)  # it does not wait for this thread

    run = lag().start(progress=progress, **settings)
    runs.append(run)
    run.advance_to(0.3)
    assert faults.keys() == CALLS.keys()
    assert not [*tmp_path.iterdir()]
    assert {text.partition(".")[0] for text in faults.values()} == {"E507 lag: the run is in use by another thread"}
    results = run.finish()
    alone = lag().start(**settings)
    alone.advance_to(0.3)
    assert np.array_equal(results.values, alone.finish().values)
    assert results.origin is not None, "nothing was set"
    assert len(seen) > 2


@pytest.mark.parametrize("kind", ENGINES)
def test_a_run_that_threads_share_gives_errors_or_exact_numbers(kind: str) -> None:
    settings = {"stop": 10.0, **FIXED, **ENGINES[kind]}
    alone = lag().start(**settings)
    for _ in range(60):
        alone.advance(0.02)
    for _ in range(3):
        run = lag().start(**settings)

        def work(_: int, run: Run = run) -> None:
            left = 20
            while left:
                try:
                    run.advance(0.02)
                    left -= 1
                except UsageError as error:
                    if error.code != "E507":
                        raise

        in_threads(work, 3)
        assert run.t == alone.t == 1.2
        assert np.array_equal(run.results.values, alone.results.values)
    if "master" not in kind:
        assert alone["lag.y"] == pytest.approx(1.0 - math.exp(-1.2), rel=1e-9)


def test_a_run_may_be_used_by_one_thread_after_another_and_after_an_error() -> None:
    diagram = Diagram("ball")
    diagram.add("ball", BouncingBall())
    run = diagram.start(engine="reference", stop=2.0)
    in_threads(lambda _: run.advance(0.5), 1)
    run.advance(0.5)
    with pytest.raises(UsageError, match="E501"):
        run.advance(-1.0)
    state = run.snapshot()
    in_threads(lambda _: run.restore(state), 1)
    in_threads(lambda _: run.advance(0.5), 1)
    assert run.t == 1.5


def test_a_run_whose_numbers_failed_is_free_for_other_threads() -> None:
    made = Diagram("grows")
    made.add("lag", FirstOrder(T=1e-3))
    made.add("gain", Gain(k=1e6))
    made.wire("lag.u", "gain.y")
    made.wire("gain.u", "lag.y")
    made.settings(stop=10.0, method="euler", step=0.01)
    run = made.start(engine="reference", parameters={"lag.y_start": 1.0})
    with pytest.raises(SimulationError):
        run.advance_to(10)
    lengths: list[int] = []
    in_threads(lambda _: lengths.append(len(run.results.t)), 1)
    assert lengths


@pytest.mark.parametrize("kind", ENGINES)
def test_runs_of_one_diagram_in_several_threads_are_those_of_one_thread(kind: str) -> None:
    settings = {**FIXED, **ENGINES[kind]}
    diagram, alone = lag(), lag()
    expected = {stop: alone.run(stop=stop, **settings).values for stop in (0.1, 0.2)}

    def work(number: int) -> None:
        for k in range(6):
            stop = (0.1, 0.2)[(number + k) // 2 % 2]  # what was kept of the last run fits, or does not
            assert np.array_equal(diagram.run(stop=stop, **settings).values, expected[stop])

    in_threads(work, 4)


def test_a_point_is_the_one_that_was_asked_for_though_another_thread_asks_at_the_same_time() -> None:
    diagram = lag()

    class Meddling(float):
        """A time that is compared while another thread asks for the point at 2 s."""

        def __eq__(self, other: object) -> bool:
            thread = threading.Thread(target=lambda: diagram.point(at=2.0))
            thread.start()
            thread.join()
            return float(self) == other

        __hash__ = float.__hash__

    first = diagram.point(at=1.0)
    assert diagram.point(at=Meddling(1.0)).t == first.t
