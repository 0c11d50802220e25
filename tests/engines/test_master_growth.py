"""A coupling that grows without bound is told (W305), and nothing else that grows, or is large, or is guessed wrong.

Witnesses: the exact values of the linear loop, exponentials of matrices, radii of the steps by hand.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from blocks import Block, Diagram, Gain, Input, Integrator, Parameter, State, fmu, output
from blocks.results.results import Results
from blocks.text.errors import SimulationError
from tests.support.coupled_systems import AT_1, TIGHT, Displaced, First, Forced, Second
from tests.support.faulty import NEEDS_COMPILER

pytestmark = NEEDS_COMPILER
each_engine = pytest.mark.parametrize("engine", ["reference", "native"])


class Turned(Block):
    """x' = k u"""

    k = Parameter(1.0)
    u = Input()
    x = State(1.0, output=True)

    @x.derivative
    def dx(u, k):
        return k * u


class Growing(Block):
    """x' = a x + u"""

    a = Parameter(10.0)
    u = Input()
    x = State(1e-6, output=True)

    @x.derivative
    def dx(x, u, a):
        return a * x + u


class Wave(Block):
    """y = A sin(w t) + e u"""

    A = Parameter(1e9)
    w = Parameter(250.0)
    e = Parameter(1e-6)
    u = Input()

    @output
    def y(t, u, A, w, e):
        return A * np.sin(w * t) + e * u


Export = Callable[[type[Block], int], Path]


@pytest.fixture(scope="module")
def export(tmp_path_factory: pytest.TempPathFactory) -> Export:
    """Exports a block once, by its class."""
    folder = tmp_path_factory.mktemp("exported")

    def exported(cls: type[Block], fmi: int) -> Path:
        path = folder / f"{cls.__name__}{fmi}.fmu"
        if not path.exists():
            diagram = Diagram.alone(cls())
            diagram.settings(**TIGHT)
            diagram.export(path, fmi=fmi)
        return path

    return exported


def pair(a: Block, b: Block, out_a: str, out_b: str) -> Diagram:
    """Two in a circle, by their inputs u."""
    made = Diagram("pair")
    one, other = made.add("a", a), made.add("b", b)
    made.wire(one.u, getattr(other, out_b))
    made.wire(other.u, getattr(one, out_a))
    return made


def told(results: Results) -> list[str]:
    return [str(fault) for fault in results.warnings if fault.code == "W305"]


@each_engine
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_linear_loop_of_two_fmus_is_told_where_it_grows_and_nowhere_else(
    fmi: int, engine: str, export: Export
) -> None:
    diagram = pair(fmu(export(First, fmi), "CS"), fmu(export(Second, fmi), "CS"), "y", "y")

    def run(**master: Any) -> Results:
        return diagram.run(stop=1, every=0.01, engine=engine, loops="solve", master={"step": 0.01, **master}, **TIGHT)

    grown = run(order=1)
    assert abs(grown["b.y"]).max() > 1e20
    (warning,) = told(grown)
    assert warning.startswith("W305 b.y: the coupling grows without bound in the circle b.y -> a.y -> b.y: by t = 0.")
    assert warning.endswith(
        'Use the algorithm "iterated" (--master algorithm=iterated), order 0 (--master order=0), or a shorter '
        "communication step (--master step=H)."
    )
    # What it advises helps.
    for master in ({"order": 0}, {"algorithm": "iterated", "order": 1}, {"order": 1, "step": 0.001}):
        fine = run(**master)
        assert not told(fine), master
        assert [fine["a.x"][-1], fine["b.x"][-1]] == pytest.approx(AT_1, abs=0.02)


@each_engine
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_ring_of_fmus_that_hold_their_inputs_is_told(fmi: int, engine: str, export: Export) -> None:
    """Each step is one of Euler's for x'' = -k^2 x: its radius is sqrt(1 + (k H)^2)."""
    path = export(Turned, fmi)
    diagram = pair(fmu(path, "CS", k=10.0), fmu(path, "CS", k=-10.0), "x", "x")
    r = diagram.run(stop=20, every=0.2, engine=engine, master={"step": 0.2, "order": 0}, **TIGHT)
    assert math.hypot(r["a.x"][-1], r["b.x"][-1]) == pytest.approx(math.sqrt(2) * 5**50, rel=1e-9)
    (warning,) = told(r)
    assert "in the circle" in warning
    assert "order=0" not in warning
    r = diagram.run(stop=2, every=0.02, engine=engine, master={"step": 0.02, "order": 0}, **TIGHT)
    assert not told(r)


@each_engine
@pytest.mark.parametrize("order", [0, 1, 2])
def test_two_masses_are_told_beyond_the_limit_of_their_step(order: int, engine: str) -> None:
    made = Diagram("two")
    a, b = made.add("a", Displaced()), made.add("b", Forced())
    made.wire(a.F, b.F)
    made.wire(b.x1, a.x)
    made.wire(b.v1, a.v)
    master = {"couple": "each", "order": order}
    settings: dict[str, Any] = {"engine": engine, "method": "rk4", "step": 0.1}
    grown = made.run(stop=400, master={**master, "step": 1.2}, **settings)
    assert len(told(grown)) == 1
    assert not told(made.run(stop=100, master={**master, "step": 0.2}, **settings))


@each_engine
@pytest.mark.parametrize("order", [0, 1, 2])
def test_what_is_unstable_by_itself_is_not_told(order: int, engine: str) -> None:
    """x' = 10 x + y, y' = -y + x / 10 grows to 1e30; a step of 1 ms is short beside it."""
    diagram = pair(Growing(a=10.0), Growing(a=-1.0), "x", "x")
    settings: dict[str, Any] = {"method": "rk4", "step": 0.005, "every": 0.05, "engine": engine}
    r = diagram.run(stop=8, master={"couple": "each", "step": 0.005, "order": order}, **settings)
    exact = expm(8 * np.array([[10.0, 1.0], [1.0, -1.0]])) @ [1e-6, 1e-6]
    assert exact[0] > 1e28
    assert r["a.x"][-1] == pytest.approx(exact[0], rel=0.2)
    assert not told(r)


@each_engine
@pytest.mark.parametrize("order", [0, 1, 2])
def test_what_is_large_and_guessed_wrong_but_bounded_is_not_told(order: int, engine: str) -> None:
    """A wave of 1e9 with two and a half points in a turn, and its integral, in a circle."""
    diagram = pair(Wave(), Integrator(), "y", "y")
    settings: dict[str, Any] = {"method": "rk4", "step": 0.01, "every": 0.01, "engine": engine}
    r = diagram.run(stop=5, master={"couple": "each", "step": 0.01, "order": order}, **settings)
    assert abs(r["a.y"]).max() > 9e8
    assert not told(r)


@each_engine
def test_what_begins_at_0_and_rises_like_a_power_is_not_told(engine: str) -> None:
    """The sixth of six integrators behind 1 is t^6 / 720: ever larger, and held inputs miss it by much at first."""
    made = Diagram("chain")
    names = [made.add(f"x{k}", Integrator(y_start=1.0 if k == 0 else 0.0)) for k in range(7)]
    back = made.add("back", Gain(k=-1e-9))
    for one, other in itertools.pairwise(names):
        made.wire(other.u, one.y)
    made.wire(back.u, names[-1].y)
    made.wire(names[0].u, back.y)
    settings: dict[str, Any] = {"method": "rk4", "step": 0.01, "every": 0.1, "engine": engine}
    r = made.run(stop=2, master={"couple": "each", "step": 0.01, "order": 0}, **settings)
    assert r["x6.y"][-1] == pytest.approx(2**6 / 720, rel=0.1)
    assert not told(r)


@each_engine
@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
def test_what_has_overflowed_is_told_of_its_coupling_too(algorithm: str, engine: str) -> None:
    diagram = pair(First(), Second(), "y", "y")
    master = {"couple": "each", "step": 0.1, "order": 2, "algorithm": algorithm}
    with pytest.raises(SimulationError, match="E303") as caught:
        diagram.run(stop=40, every=0.1, engine=engine, loops="solve", master=master)
    assert len(told(caught.value.results)) == 1
