"""Algebraic loops with one solution, from circuits, kinematics and textbooks, beside closed forms and SciPy."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from blocks import Algebraic, Block, Diagram, Expression, Gain, Input, Integrator, Ramp, SimulationError, Sum
from blocks.compile.coupling import Coupling
from tests.support.algebraic_loops import LOOPS, Loop, as_blocks, as_expressions
from tests.support.marks import long

ROUNDED = 1e-11  # relative; losses of digits by the loops' own conditions
LOOSE = {
    "nearly_singular": 1e-9,  # its condition is 1e6
    "far_from_zero": 1e-9,  # from 3e-4 on, a difference of numbers of 1e3, which are rounded to 1e-13
    "root_of_small_times": 1e-9,  # 2 - 2 cos(0.001) is 1e-6, rounded to 4e-16
}
NAMES = [loop.name for loop in LOOPS]
FORMS = {"expressions": as_expressions, "blocks": as_blocks}


def off(loop: Loop, results: Any) -> float:
    """The largest relative error of a loop's variable."""
    values = np.asarray(results[f"{loop.name}_{loop.variable}.y"])
    solution = np.array([loop.solution(t) for t in results.t])
    return float(np.max(np.abs(values - solution) / (np.abs(solution) + 1e-12)))


@cache
def of_all(form: str) -> Any:
    """All loops in one diagram, at times that are far from each other."""
    recorded = [f"{loop.name}_{loop.variable}.y" for loop in LOOPS]
    return FORMS[form](*LOOPS).run(loops="solve", stop=1.0, every=0.125, method="rk4", step=0.125, log=recorded)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("loop", LOOPS, ids=NAMES)
def test_a_loop_has_its_solution(loop: Loop, form: str) -> None:
    assert off(loop, of_all(form)) <= LOOSE.get(loop.name, ROUNDED)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("loop", [long(loop) for loop in LOOPS], ids=NAMES)
def test_a_loop_is_followed_along_a_run(loop: Loop, form: str) -> None:
    results = FORMS[form](loop).run(loops="solve", stop=1.0)
    assert off(loop, results) <= LOOSE.get(loop.name, ROUNDED)


# --- where a loop is torn ------------------------------------------------------------------------------------------


def torn(d: Diagram) -> list[int]:
    """The number of torn unknowns of each loop."""
    d.settings(loops="solve")
    plan = d.start(engine="reference", stop=1.0).plan
    assert not isinstance(plan, Coupling)
    return [len(step.torn) for step in plan.continuous.steps if hasattr(step, "torn")]


def test_a_loop_of_many_blocks_in_one_circle_has_one_unknown() -> None:
    ring = "; ".join(f"x{k} = 0.5*x{(k + 1) % 30} + t" for k in range(30))
    assert torn(as_expressions(Loop("ring", ring, "x0", lambda t: 2 * t))) == [1]


@pytest.mark.parametrize("name", ["solar_cell", "root_of_small_times", "colebrook_of_f", "transistor"])
def test_loops_of_circuits_have_one_unknown_also_block_by_block(name: str) -> None:
    assert torn(as_blocks(LOOPS[NAMES.index(name)])) == [1]


def test_a_chain_is_torn_at_every_other_point() -> None:
    assert torn(as_expressions(LOOPS[NAMES.index("poisson")])) == [20]


# --- rounding ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_an_unknown_that_is_0_by_cancellation_settles(scale: float) -> None:
    """e = r - q - d, q = 3 e: e is (r - d)/4, which is 0 up to the rounding of r and d, whatever their unit."""
    d = Diagram("cancels")
    d.add("r", Ramp(slope=scale / 3, before=scale))
    d.add("d", Ramp(slope=scale / 7 * 7 / 3, before=scale))
    d.add("e", Sum(signs="+--"))
    d.add("q", Gain(k=3.0))
    for sink, source in (("e.u1", "r.y"), ("e.u2", "q.y"), ("e.u3", "d.y"), ("q.u", "e.y")):
        d.wire(sink, source)
    assert np.max(np.abs(d.run(loops="solve", stop=1.0)["e.y"])) <= 1e-15 * scale


def test_a_loop_whose_terms_nearly_cancel_is_solved_to_their_rounding() -> None:
    """y' = r = sqrt((1/y - t^2 r - 2 cos t)/t): y falls to 1/(2 cos t) within 2e-5 s; slopes are up to 1e6 there."""
    d = Diagram("root")
    d.add("r", Expression(expression="sqrt((1/u1 - t**2*u2 - 2*cos(t))/t)"))
    d.add("y", Integrator(y_start=0.5))
    d.wire("r.u1", "y.y")
    d.wire("r.u2", "r.y")
    d.wire("y.u", "r.y")
    results = d.run(loops="solve", start=1e-3, stop=2e-3, rtol=1e-9, atol=1e-12)
    # t r^2 + t^2 r = 2 - 2 cos t
    assert results["r.y"][0] == pytest.approx((np.sqrt(1e-12 + 16e-3 * np.sin(5e-4) ** 2) - 1e-6) / 2e-3, rel=1e-9)
    assert results["y.y"][-1] == pytest.approx(0.5 / np.cos(2e-3), abs=2e-9)


# --- several searches ----------------------------------------------------------------------------------------------


class Sigmoid(Block):
    """z + 1000 tanh(50 z) = u: the step from anywhere but near 0 goes far beyond the solution."""

    u = Input()
    z = Algebraic(3.0, output=True)

    @z.residual
    def is_solved(z, u):  # type: ignore[no-untyped-def]
        return z + 1000.0 * np.tanh(50.0 * z) - u


def test_an_algebraic_variable_is_found_from_a_flat_place() -> None:
    d = Diagram("flat")
    d.add("s", Sigmoid())
    d.add("u", Ramp(slope=500.0, before=-250.0))
    d.wire("s.u", "u.y")
    results = d.run(stop=1.0, every=0.1)
    z = np.asarray(results["s.z"])
    assert z + 1000.0 * np.tanh(50.0 * z) == pytest.approx(500.0 * np.asarray(results.t) - 250.0, abs=1e-9)


# --- what is said where none is found ------------------------------------------------------------------------------


def refused(equations: str) -> str:
    with pytest.raises(SimulationError) as caught:
        as_expressions(Loop("a", equations, "y", lambda t: t)).run(loops="solve", stop=1.0)
    return str(caught.value)


def test_a_loop_without_solution_is_refused_with_how_near_the_search_came() -> None:
    message = refused("y = x**2 + 1 + t; x = y")
    assert "E307 a_y.y: at t = 0.0 s no solution was found for its algebraic loop." in message
    assert "The search came nearest at a_y.y = 0.5, with the residual 0.75." in message
    assert "let the search start near it: a block with an Algebraic variable in the loop has a start value" in message


def test_a_loop_that_begins_where_it_has_no_value_is_refused_with_that_value() -> None:
    assert "The residual is not finite where the search begins, at a_y.y = 0.0." in refused("y = sqrt(-1 - y**2)")


def test_a_loop_without_a_single_solution_is_refused_as_singular() -> None:
    assert "The residual is 0 at a_y.y = 0.0, but its derivative is singular there." in refused("y = x; x = y")


# --- resumed runs --------------------------------------------------------------------------------------------------


def test_a_resumed_run_begins_its_searches_where_the_first_one_left() -> None:
    d = as_blocks(LOOPS[NAMES.index("diode_ladder")])
    d.add("i", Integrator())
    d.wire("i.u", "diode_ladder_v3.y")
    d.settings(loops="solve", stop=1.0, every=0.25)
    run = d.start()
    run.advance_to(0.5)
    rest, whole = d.run(resume=run.snapshot()), run.finish()
    for name in ("diode_ladder_v3.y", "i.y"):
        assert rest[name][-1] == whole[name][-1]
