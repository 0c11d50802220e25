"""Corners inside loops: the sides of crossings and the solution of the loop that reads them are found together."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    Constant,
    DeadZone,
    Diagram,
    Gain,
    Input,
    LookupTable,
    Ramp,
    Relay,
    Saturation,
    SimulationError,
    Step,
    Sum,
    crossing,
    output,
)
from tests.support.corners import KINDS, Case, coupled_case, feedback, scalar_case

SETTINGS: dict[str, dict[str, Any]] = {
    "dopri5": {"method": "dopri5"},
    "rk4": {"method": "rk4", "step": 0.0037},
    "radau": {"method": "radau"},
    "auto": {"method": "auto"},
    "euler": {"method": "euler", "step": 0.01},
}


def loop_through(block: Any, k: float, source: Any) -> Diagram:
    """x = u - k f(x)."""
    d = Diagram("loop")
    total, function, gain = d.add("s", Sum(signs="+-")), d.add("f", block), d.add("g", Gain(k=k))
    d.wire(total.u1, d.add("u", source).y)
    d.wire(function.u, total.y)
    d.wire(gain.u, function.y)
    d.wire(total.u2, gain.y)
    return d


def check(cases: list[Case], kinds: tuple[str, ...], method: str, compared: int) -> None:
    """Each run has the solution of its loop in each row; some are compared: both engines have the same events."""
    d, events = feedback(kinds), {}
    for engine, count in (("native", len(cases)), ("reference", compared)):
        model = d.prepare(engine=engine, stop=1.0, loops="solve", **SETTINGS[method])
        for number, case in enumerate(cases[:count]):
            results = model.run(parameters=case.values)
            assert case.error(results) <= 1e-12, (engine, number)
            told = [(event.block, event.what) for event in results.events]
            assert told == events.setdefault(number, told), number


@pytest.mark.parametrize("engine", ["reference", "native"])
@pytest.mark.parametrize("method", SETTINGS)
def test_a_relay_behind_a_loop_sees_its_solutions_only(method: str, engine: str) -> None:
    """x = u - 1.9 sat(x) jumps from -0.62 to 0.34: with the old side it would be 1.4, where the relay switches on."""
    d = loop_through(Saturation(lower=-0.2, upper=0.38), 1.9, Step(at=0.5, before=-1.0, after=0.99))
    relay = d.add("relay", Relay(on_at=0.4, off_at=-0.2, on=1.0, off=-1.0))
    d.wire(relay.u, "s.y")
    r = d.run(stop=1.0, loops="solve", engine=engine, log=["s.y", "relay.y"], **SETTINGS[method])
    assert r["s.y"][-1] == pytest.approx(0.99 / 2.9, abs=1e-12)
    assert r["relay.y"][-1] == -1.0
    assert [event.block for event in r.events] == ["u", "f", "f", "f"]


@pytest.mark.parametrize("method", ["dopri5", "rk4"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_loop_that_passes_corners_has_its_one_solution(kind: str, method: str) -> None:
    check([scalar_case(kind, seed) for seed in range(40, 80)], (kind,), method, 5)


@pytest.mark.long
@pytest.mark.parametrize("method", SETTINGS)
@pytest.mark.parametrize("kind", KINDS)
def test_loops_that_pass_corners_have_their_one_solution_by_all_methods(kind: str, method: str) -> None:
    check([scalar_case(kind, seed) for seed in range(80, 180)], (kind,), method, 20)


@pytest.mark.parametrize("kinds", [("saturation", "table")])
def test_a_loop_through_several_corners_has_its_one_solution(kinds: tuple[str, ...]) -> None:
    check([coupled_case(kinds, seed) for seed in range(40)], kinds, "dopri5", 6)


@pytest.mark.long
@pytest.mark.parametrize("method", SETTINGS)
@pytest.mark.parametrize(
    "kinds", [("saturation", "saturation"), ("dead zone", "table"), ("saturation", "dead zone", "table")]
)
def test_loops_through_several_corners_have_their_one_solution_by_all_methods(
    kinds: tuple[str, ...], method: str
) -> None:
    check([coupled_case(kinds, seed) for seed in range(40)], kinds, method, 10)


@pytest.mark.parametrize("settings", [{}, {"method": "rk4", "step": 0.0037}, {"method": "rk4", "step": 0.01}])
def test_a_ramp_fires_each_corner_of_a_loop_once(settings: dict[str, Any]) -> None:
    """x = u - sat(x)/2: the corner is at u = 0.3."""
    results = loop_through(Saturation(lower=-0.2, upper=0.2), 0.5, Ramp()).run(stop=1.0, loops="solve", **settings)
    assert [(event.block, event.what) for event in results.events] == [("f", "above")]
    assert results.events[0].t == pytest.approx(0.3, abs=1e-14)
    u = np.asarray(results["u.y"])
    assert results["s.y"] == pytest.approx(np.where(u < 0.3, u / 1.5, u - 0.1), abs=1e-14)


def test_a_table_in_a_loop_starts_in_its_cell() -> None:
    """x = 0.5 - 1.5 (1.6 x - 0.02)."""
    table = LookupTable(points=[-1.0, -0.3, 0.2, 0.8], values=[-1.0, -0.5, 0.3, 1.2])
    results = loop_through(table, 1.5, Constant(value=0.5)).run(stop=1.0, loops="solve")
    assert results["s.y"] == pytest.approx(0.53 / 3.4, abs=1e-15)
    assert not results.events


@pytest.mark.parametrize("block", [Saturation(), DeadZone(), LookupTable(points=[-1.0, 1.0], values=[-1.0, 1.0])])
def test_a_loop_that_rests_at_a_corner_fires_nothing(block: Any) -> None:
    f = 0.0 if isinstance(block, DeadZone) else 1.0
    for k in (0.1, 0.7, 3.3, 1234.5):
        results = loop_through(block, k, Constant(value=1.0 + k * f)).run(
            stop=1.0, loops="solve", method="rk4", step=0.1
        )
        assert results["s.y"] == pytest.approx(1.0, abs=1e-12 * k)
        assert not results.events


def test_a_jump_over_a_whole_saturation_finds_its_side() -> None:
    """With k > 1 both outer sides show the other one: the solution lies between them."""
    results = loop_through(Saturation(), 5.0, Step(at=0.5, before=10.0)).run(stop=1.0, loops="solve")
    assert results["s.y"][-1] == 1.0 / 6.0
    assert [(event.block, event.what) for event in results.events] == [("u", "edge"), ("f", "above")]


def test_a_jump_over_cells_of_a_table_passes_each_point() -> None:
    points = np.linspace(-1.0, 1.0, 9)
    table = LookupTable(points=points.tolist(), values=np.sinh(3.0 * points).tolist())
    results = loop_through(table, 5.0, Step(at=0.5, before=-60.0, after=60.0)).run(stop=1.0, loops="solve")
    assert results["s.y"] == pytest.approx(
        np.where(np.asarray(results["u.y"]) > 0.0, 1.0, -1.0) * (60.0 - 5.0 * np.sinh(3.0))
    )
    assert [event.what for event in results.events][1:].count("passes") <= len(points)


class Against(Block):
    """y = -1 below 0, and 1 from 0 on."""

    u = Input()

    @crossing
    def side(u):  # type: ignore[no-untyped-def]
        return u

    @output
    def y(u, side):  # type: ignore[no-untyped-def]
        return np.where(side, 1.0, -1.0) + 0.0 * u


def test_a_loop_that_jumps_against_itself_is_still_an_error() -> None:
    """x = -sign(x) has no solution."""
    with pytest.raises(SimulationError, match=r"E305 f\.side"):
        loop_through(Against(), 1.0, Constant(value=0.0)).run(stop=1.0, loops="solve")


class SlopedAgainst(Block):
    """y = -1 + u/2 below 0, and 1 + u/2 from 0 on."""

    u = Input()

    @crossing
    def side(u):  # type: ignore[no-untyped-def]
        return u

    @output
    def y(u, side):  # type: ignore[no-untyped-def]
        return np.where(side, 1.0, -1.0) + 0.5 * u


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (Against(), r"Their effects act back on them at once\. Put a UnitDelay or a state between them"),
        (SlopedAgainst(), r"the algebraic loop has no solution.*Put a UnitDelay or a state into the loop"),
    ],
)
@pytest.mark.parametrize("engine", ["reference", "native"])
def test_a_loop_without_a_solution_advises_what_opens_it(law: Block, said: str, engine: str) -> None:
    diagram = loop_through(law, 1.0, Step(at=0.5, before=-5.0, after=0.0))
    with pytest.raises(SimulationError, match=rf"E305 f\.side: at t = 0\.5 s .*{said}"):
        diagram.run(stop=1.0, loops="solve", engine=engine)


@pytest.mark.parametrize("settings", [{}, {"method": "rk4", "step": 0.0037}])
def test_a_run_through_corners_goes_on_from_its_state(tmp_path: Path, settings: dict[str, Any]) -> None:
    """It stops at the corner of a loop, and between corners."""
    d = loop_through(Saturation(lower=-0.2, upper=0.2), 0.7, Ramp(slope=0.68))
    settings = {"stop": 1.0, "stops": [0.3, 0.5], "loops": "solve", **settings}
    whole, run = d.run(**settings), d.start(**settings)
    for stop in settings["stops"]:
        run.advance_to(stop)
        run.save(tmp_path / "state")
        run = d.start(resume=tmp_path / "state", **settings)
    rest = run.finish()
    count = len(rest.t)
    assert np.asarray(rest["s.y"]).tobytes() == np.asarray(whole["s.y"])[-count:].tobytes()
    assert list(rest.events) == [event for event in whole.events if event.t > 0.5]
