"""The warning that a run by dopri5 is stiff (W306): its text, when it is silent, and that looking changes no bit."""

import math
import re
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from blocks import (
    Diagram,
    FirstOrder,
    Integrator,
    Relay,
    SecondOrder,
    Sine,
    Sum,
    TransportDelay,
    Trigonometry,
    ZeroOrderHold,
)
from blocks.cli import main
from blocks.compile.toolchain.compiler import find_compiler
from blocks.engines.run import stiffness

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")
ENGINES = ("reference", pytest.param("native", marks=needs_compiler))


def lag(fast: float) -> Diagram:
    """A slow lag before a fast one, behind a sine."""
    diagram = Diagram("lag")
    diagram.add("wave", Sine())
    diagram.add("slow", FirstOrder(T=1.0))
    diagram.add("fast", FirstOrder(T=fast))
    diagram.wire("slow.u", "wave.y")
    diagram.wire("fast.u", "slow.y")
    return diagram


def found(diagram: Diagram, engine: str, *, piece: float, pieces: int = 6, **settings: Any) -> list[str]:
    """The warnings of the first part of a run, in pieces, between which it is looked at."""
    run = diagram.start(engine=engine, **settings)
    for _ in range(pieces):
        run.advance(piece)
    return [str(fault) for fault in run.results.warnings]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_stiff_run_is_found_with_its_state_its_time_constant_and_the_cure(engine: str) -> None:
    (said,) = found(lag(1e-5), engine, piece=0.03, stop=100)
    match = re.fullmatch(
        r"W306 fast\.y: is stiff: at t = (.+) s its time constant of (.+) s keeps the steps of dopri5 at (.+) s, and "
        r"the run needs (.+) more of them up to 100 s\. Use a method for stiff models: --method radau, or auto .*",
        said,
    )  # fmt: skip
    assert match is not None, said
    t, constant, step, left = map(float, match.groups())
    assert constant == pytest.approx(1e-5, rel=0.01)  # by construction
    assert step == pytest.approx(3.3e-5, rel=0.05)  # the edge of stability of dopri5
    assert left == pytest.approx((100 - t) / step, rel=0.2)  # one digit is printed


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_that_is_not_stiff_or_does_not_take_long_is_not_warned_about(
    engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not found(lag(1e-5), engine, piece=0.03, stop=1)  # 30,000 steps
    assert not found(lag(1e-5), engine, piece=0.03, stop=100, method="auto")
    monkeypatch.setattr(stiffness, "_FIRST", 20)
    monkeypatch.setattr(stiffness, "_MANY", 0)
    assert not found(lag(0.1), engine, piece=10.0, stop=100)
    sampled = lag(1e-3)  # at most two steps between ticks, and no method needs fewer than one
    sampled.add("held", ZeroOrderHold(period=2e-3))
    sampled.wire("held.u", "fast.y")
    assert not found(sampled, engine, piece=0.1, stop=10)
    assert found(lag(1e-3), engine, piece=0.1, stop=10)  # without the ticks it is
    assert not found(lag(1e-3), engine, piece=0.01, stop=0.5)  # no step may be longer than 0.01 s


class Ran:
    """Run a lag of 2e-6 s by dopri5; the watch looks at it once, after a number of steps of a mean length."""

    def __init__(self, step: float) -> None:
        self.plan = SimpleNamespace(settings=SimpleNamespace(method="dopri5", stop=5.0))
        self.step, self.steps = step, 0

    @property
    def t(self) -> float:
        return self.step * self.steps

    def state_rates(self) -> stiffness.StateRates:
        x = np.array([1.0])
        return stiffness.StateRates(("lag.y",), x, 1e-6 * x, lambda x: (1.0 - x) / 2e-6, 0, math.inf)


@pytest.mark.parametrize(
    ("looks", "step", "is_found"),
    [
        ([311_294], 6.6137e-6, True),  # what a second of C made of it before the first look
        ([2_500, 3_200], 6.6137e-6, False),
        ([2_500, 3_200, 4_100], 6.6137e-6, True),
        ([60_000, 90_000, 120_000, 160_000], 3e-6, False),  # steps that the error keeps short
    ],
)
def test_one_look_suffices_after_many_steps(looks: list[int], step: float, is_found: bool) -> None:
    ran = Ran(step)
    watch, said = stiffness.StiffWatch(ran), []
    for ran.steps in looks:
        said.append(watch.look(ran))
    assert (said[-1] is not None) == is_found
    assert said[:-1] == [None] * (len(looks) - 1)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_stiff_pair_of_complex_eigenvalues_is_found(engine: str) -> None:
    diagram = Diagram("pair")
    diagram.add("wave", Sine())
    diagram.add("servo", SecondOrder(d=0.8, w=1e5))
    diagram.wire("servo.u", "wave.y")
    (said,) = found(diagram, engine, piece=0.03, stop=100)
    assert said.startswith("W306 servo.")
    assert "time constant of 1.3e-05 s" in said  # 1/(d w) is 1.25e-5


def lively() -> Diagram:
    """A delay, crossings, ticks, and an algebraic loop, whose solution begins at the last one."""
    diagram = lag(2e-3)
    diagram.add("late", TransportDelay(delay=0.3))
    diagram.add("relay", Relay(on=0.2, off=-0.2))
    diagram.add("held", ZeroOrderHold(period=0.25))
    diagram.add("sum", Sum(signs="++"))
    diagram.add("area", Integrator())
    diagram.add("around", Sum(signs="+-"))
    diagram.add("bend", Trigonometry())
    diagram.wire("around.u1", "fast.y")
    diagram.wire("around.u2", "bend.y")
    diagram.wire("bend.u", "around.y")
    diagram.wire("late.u", "around.y")
    diagram.wire("relay.u", "late.y")
    diagram.wire("held.u", "relay.y")
    diagram.wire("sum.u1", "held.y")
    diagram.wire("sum.u2", "late.y")
    diagram.wire("area.u", "sum.y")
    return diagram


@pytest.mark.parametrize("engine", ENGINES)
def test_a_look_changes_no_bit_and_counts_nowhere(engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def rest(looks: bool) -> tuple[bytes, Any]:
        with monkeypatch.context() as patch:
            patch.setattr(stiffness, "_FIRST", 1 if looks else 10**9)
            patch.setattr(stiffness, "_PART", 0.0)
            patch.setattr(stiffness, "_MANY", 0)
            patch.setattr(stiffness, "_GAIN", 0)
            patch.setattr(stiffness, "_LOOKS", 10**9)
            run = lively().start(stop=4, engine=engine, loops="solve")
            run._simulation.engine.pause(0.0, math.inf)  # a moment is a step
            run.advance_to(4)
        statistics = run.results.statistics
        return run.results.values.tobytes(), (statistics.steps, statistics.rejected, statistics.evaluations)

    asked = []
    largest = stiffness._largest
    monkeypatch.setattr(stiffness, "_largest", lambda now: asked.append(now) or largest(now))
    assert rest(looks=True) == rest(looks=False)
    assert len(asked) > 100


def test_a_run_to_its_end_warns_while_it_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stiffness, "_FIRST", 20)
    monkeypatch.setattr(stiffness, "_MANY", 200)
    seen: list[tuple[str, float]] = []
    times: list[float] = []
    monkeypatch.setattr(warnings, "warn", lambda text, *_, **__: seen.append((text, times[-1])))
    results = lag(1e-3).run(stop=4, progress=lambda t, stop: times.append(t), engine="reference")
    ((said, t),) = seen
    assert said == str(results.warnings[0])
    assert t < 2.0


def test_the_command_prints_the_warning_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(stiffness, "_FIRST", 20)
    monkeypatch.setattr(stiffness, "_MANY", 200)
    path = tmp_path / "lag.json"
    lag(1e-3).save(path)
    assert main(["run", str(path), "--stop", "4", "--engine", "reference"]) == 0
    assert capsys.readouterr().err.count("W306 fast.y: is stiff: ") == 1
