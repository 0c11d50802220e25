"""A live run is the run: the same bits at any pace, with any pauses and steps, and again by its script."""

import contextlib
import json
import random
import re
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, Results, SimulationError, UsageError
from blocks.host import available_memory
from blocks.server.live_run import PERIOD, LiveRun
from tests.support.places import DIAGRAMS, PAPER

pytestmark = pytest.mark.usefixtures("no_thread_left")
PATIENCE = 60.0  # s; for a machine that stands still
ENGINES = ("native", "reference")
MIXED = {
    "format": "blocks-diagram", "version": 3, "name": "mixed", "inputs": {"r": {"default": 1.0}},
    "blocks": {
        "error": {"type": "Sum", "parameters": {"signs": "+-"}},
        "relay": {"type": "Relay", "parameters": {"on_at": 0.1, "off_at": -0.1, "on": 0.5, "off": -0.5}},
        "hold": {"type": "ZeroOrderHold", "parameters": {"period": 0.07}},
        "gain": {"type": "Gain", "parameters": {"k": 2.0}},
        "late": {"type": "TransportDelay", "parameters": {"delay": 0.15}},
        "plant": {"type": "TransferFunction", "parameters": {"num": [1], "den": [1, 1, 4]}},
        "all": {"type": "Sum", "parameters": {"signs": "++"}},
    },
    "wires": {
        "error.u1": "r", "error.u2": "late.y", "relay.u": "error.y", "hold.u": "error.y", "gain.u": "hold.y",
        "all.u1": "gain.y", "all.u2": "relay.y", "plant.u": "all.y", "late.u": "plant.y",
    },
    "outputs": {"y": "plant.y"},
    "measures": {"most": {"type": "peak", "of": "plant.y"}},
    "run": {"stop": 4, "log": ["plant.y", "relay.y", "hold.y", "late.y"]},
}  # fmt: skip
"""Crossings, ticks and a delay in one loop."""
TURNED = [("r", -1.0, 2.0), ("gain.k", 0.5, 3.0)]
MOTOR = (DIAGRAMS / "motor_pid.json", [("kp", 0.05, 0.5), ("motor.Ra", 0.5, 2.0)])
ROBOT = (PAPER / "iadrc.json", [("motor_left.Ra", 1.0, 3.0)])
VARIANTS = {"motor_left": "me", "motor_right": "me"}
KINDS: dict[str, tuple[Any, Any, dict[str, Any]]] = {
    "mixed": (None, TURNED, {}),
    "grid": (None, TURNED, {"every": 0.05}),
    "fixed steps": (None, TURNED, {"method": "rk4", "step": 0.01}),
    "stiff": (None, TURNED, {"method": "radau", "stop": 2}),
    "master": (None, TURNED, {"master": {"couple": "each", "step": 0.02}, "stop": 1}),
    "motor": (*MOTOR, {}),
    "paper": (*ROBOT, {"stop": 2}),
    "co-simulation": (PAPER / "iadrc_fmu.json", ROBOT[1], {"stop": 0.5}),
    "model exchange": (PAPER / "iadrc_fmu.json", ROBOT[1], {"stop": 2, "variants": VARIANTS}),
}


class Watched(LiveRun):
    """A live run that is waited for."""

    def __init__(self, path: Path, **settings: Any) -> None:
        self.news = threading.Condition()
        super().__init__(Diagram.load(path).start(**settings), self.tell)

    def tell(self) -> None:
        with self.news:
            self.news.notify_all()

    def until(self, *states: str) -> None:
        """Wait until its state is one of these, or it is over."""
        with self.news:
            assert self.news.wait_for(lambda: self.state in states or self.is_over, PATIENCE)

    def finished(self) -> Results:
        self.go()
        assert self.wait(PATIENCE)
        return self.results()


@pytest.fixture
def no_thread_left() -> Any:
    before = threading.enumerate()
    yield
    assert [thread for thread in threading.enumerate() if thread not in before] == []


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    path = tmp_path / "mixed.json"
    path.write_text(json.dumps(MIXED), encoding="utf-8")
    return path


def bits(results: Results) -> tuple[Any, ...]:
    told = results.statistics
    rows = results.t.tobytes(), results.values.tobytes()
    return *rows, tuple(results.events), results.measures, told.steps, told.rejected, told.instants


def played(live: Watched, rng: random.Random, stop: float, turned: Any) -> Results:
    """Told what comes to mind, and then to go to the end."""
    for _ in range(25):
        what = rng.choice(["go", "pause", "step", "step", "set", "results"])
        if live.is_over:
            break
        if what == "go":
            live.go(rng.choice([0.5, 2.0]) * stop)
        elif what == "results":
            live.results()
        elif what == "set" and turned:
            name, low, high = rng.choice(turned)
            with contextlib.suppress(UsageError):  # it may have come to its end
                live.set(name, rng.uniform(low, high))
        else:
            (live.step if what == "step" else live.pause)()
            live.until("paused")
    return live.finished()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_live_run_has_the_bits_of_the_run_and_of_its_script(mixed: Path, kind: str, engine: str) -> None:
    path, turned, settings = KINDS[kind]
    path, rng = path or mixed, random.Random(kind + engine)
    given = {"engine": engine, **settings}
    plain = Diagram.load(path).run(**given)
    assert bits(played(Watched(path, **given), rng, float(plain.t[-1]), None)) == bits(plain)
    live = Watched(path, **given)
    first = live.set(turned[0][0], turned[0][1])
    assert (first.steps, first.t) == (0, 0.0)
    results, scope = played(live, rng, float(plain.t[-1]), turned), dict[str, Any]()
    exec(live.script(path, variants=settings.get("variants")), scope)
    assert bits(results) == bits(scope["results"])
    assert not np.array_equal(results.values, plain.values)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_step_is_one_step_of_the_engine(mixed: Path, engine: str) -> None:
    """Without a grid the run has a row after each step, and two where something jumps."""
    ends = np.unique(Diagram.load(mixed).run(engine=engine).t)
    live = Watched(mixed, engine=engine)
    for n in range(1, 30):
        live.step()
        live.until("paused")
        assert (live.steps, live.t, live.rows()[0][-1]) == (n, ends[n], ends[n])
    live.stop()
    assert live.wait(PATIENCE)
    assert live.state == "stopped"
    assert live.results().interrupted
    assert np.array_equal(np.unique(live.results().t), ends[: len(np.unique(live.results().t))])


@pytest.mark.parametrize("engine", ENGINES)
def test_a_paced_run_keeps_behind_the_clock(mixed: Path, engine: str) -> None:
    """It runs up to where the clock will be at the next look, and at most a step further."""
    pace, longest = 2.0, float(np.diff(Diagram.load(mixed).run(engine=engine).t).max())
    live, begun = Watched(mixed, engine=engine), time.perf_counter()
    live.go(pace)
    with live.news:
        assert live.news.wait_for(lambda: live.t > 0.2, PATIENCE)
    live.pause()
    live.until("paused")
    assert live.t <= pace * (time.perf_counter() - begun + PERIOD) + longest
    with pytest.raises(UsageError, match="above 0"):
        live.go(0.0)
    live.stop()
    assert live.wait(PATIENCE)


def test_a_run_without_end_goes_on_until_it_is_stopped_and_is_replayed(tmp_path: Path) -> None:
    path = tmp_path / "endless.json"
    path.write_text(json.dumps({**MIXED, "run": {"log": ["plant.y"]}}), encoding="utf-8")
    live = Watched(path)
    live.go()
    with live.news:
        assert live.news.wait_for(lambda: live.t > 5.0, PATIENCE)
    live.set("r", 0.5)
    live.stop()
    assert live.wait(PATIENCE)
    scope: dict[str, Any] = {}
    exec(live.script(path), scope)
    assert bits(live.results()) == bits(scope["results"])


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_that_fails_keeps_its_rows_and_names_the_block(tmp_path: Path, engine: str) -> None:
    parts = ["u1+1-t", "sqrt(u1)"]
    both = zip("ab", parts, strict=True)
    blocks = {name: {"type": "Expression", "parameters": {"expression": part}} for name, part in both}
    wires = {"b.u1": "a.y", "a.u1": "zero.y", "x.u": "b.y"}
    blocks |= {"x": {"type": "Integrator"}, "zero": {"type": "Constant", "parameters": {"value": 0}}}
    run = {"stop": 3, "every": 0.125, "log": ["x.y", "b.y", "a.y"]}
    path = tmp_path / "fails.json"
    path.write_text(
        json.dumps({"format": "blocks-diagram", "version": 3, "blocks": blocks, "wires": wires, "run": run}),
        encoding="utf-8",
    )
    with pytest.raises(SimulationError) as plain:
        Diagram.load(path).run(engine=engine)
    live = Watched(path, engine=engine)
    live.step()
    live.until("paused")
    live.go()
    assert live.wait(PATIENCE)
    assert live.state == "failed"
    assert str(live.error) == str(plain.value)
    assert bits(live.results()) == bits(plain.value.results)
    failing, t = live.failing(), plain.value.results.t
    assert failing is not None
    assert (failing["block"], failing["signals"], failing["t"]) == ("b", ["a.y", "b.y"], t.tolist())
    assert failing["rows"] == [[1 - each, float(np.sqrt(1 - each))] for each in t.tolist()]
    with pytest.raises(UsageError, match="is over"):
        live.set("zero.value", 1.0)


def test_what_cannot_be_set_is_refused_and_the_run_goes_on(mixed: Path) -> None:
    live = Watched(mixed)
    with pytest.raises(UsageError, match="E502"):
        live.set("relay.on_att", 1.0)
    with pytest.raises(UsageError, match="E502"):
        live.set("r", "two")
    assert bits(live.finished()) == bits(Diagram.load(mixed).run())
    assert live.turned == []
    assert live.events(1) == list(live.results().events[1:])


def test_the_slowest_pace_waits_until_it_is_told_otherwise(mixed: Path) -> None:
    live = Watched(mixed)
    live.go(1e-300)  # for longer than a clock can count
    with live.news:
        assert live.news.wait_for(lambda: live.t > 0.0, PATIENCE)
    live.pause()
    live.until("paused")
    assert bits(live.finished()) == bits(Diagram.load(mixed).run())


def test_what_blocks_itself_does_wrong_is_told_as_the_error_of_the_run(
    mixed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    live = Watched(mixed)
    live.step()
    live.until("paused")
    monkeypatch.setattr(live, "_look", {}.__getitem__)
    live.go()
    assert live.wait(PATIENCE)
    assert live.state == "failed"
    assert str(live.error).startswith("E901 blocks itself failed (KeyError")
    assert live.results().t[0] == 0.0


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_that_takes_too_much_memory_fails_and_says_how_much(
    mixed: Path, engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(available_memory, "INTERVAL", 1e-9)  # s from one look to the next
    live = Watched(mixed, engine=engine)
    while live.steps < 100:
        live.step()
        live.until("paused")
    monkeypatch.setattr(available_memory, "available", lambda: 0.0)
    live.go()
    assert live.wait(PATIENCE)
    assert live.error is not None
    assert live.error.faults[0].code == "E311"
    told = re.search(r"the recorded rows take ([\d.]+) kB", str(live.error))
    assert told is not None
    results = live.results()
    size = results.t.nbytes + results.values.nbytes
    assert size > 4000.0
    assert float(told[1]) * 1000 == pytest.approx(size, rel=0.05)  # rounded


def test_who_asks_a_run_that_hangs_in_a_step_does_not_wait_for_ever(
    mixed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("blocks.server.live_run.PATIENCE", 0.05)
    live, hangs, goes_on = Watched(mixed), threading.Event(), threading.Event()
    step = live._present._simulation.engine.proceed

    def proceed(stop: Any) -> bool:
        hangs.set()
        assert goes_on.wait(PATIENCE)
        return step(stop)

    monkeypatch.setattr(live._present._simulation.engine, "proceed", proceed)
    live.go()
    assert hangs.wait(PATIENCE)
    for ask in (lambda: live.set("gain.k", 1.0), live.results, live.rejected_by_block):
        with pytest.raises(UsageError, match=r"has been computing one step for more than"):
            ask()
    goes_on.set()
    assert bits(live.finished()) == bits(Diagram.load(mixed).run())  # what was refused does not come later
    assert live.turned == []
