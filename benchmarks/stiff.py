"""A chain of 2,000 stiff states: radau with the sparse Jacobian against SciPy's BDF with a dense one.

A rod that conducts and radiates: dx_k/dt = c (x_{k-1} - 2 x_k + x_{k+1}) - r x_k^4, its ends held at 1 and 0.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from blocks import Block, Diagram, Input, Parameter, State
from blocks.library import Constant
from blocks.text.errors import BlocksError

from .measure import on_one_core

__all__ = ["Cell", "by_scipy", "chain", "main"]

Array = np.ndarray[Any, Any]
CONDUCTION, RADIATION, STOP, RTOL, ATOL = 1e5, 1.0, 1.0, 1e-6, 1e-9
COUNT = 2000


class Cell(Block):
    """A slice of a rod: dx/dt = c (left - 2 x + right) - r x^4."""

    c = Parameter(CONDUCTION, unit="1/s", doc="conduction to each side")
    r = Parameter(RADIATION, unit="1/s", doc="radiation")
    left = Input(doc="temperature of the slice before it")
    right = Input(doc="temperature of the slice behind it")
    x = State(output=True, doc="temperature")

    @x.derivative  # type: ignore[untyped-decorator]
    def dx(x: Any, left: Any, right: Any, c: Any, r: Any) -> Any:
        return c * (left - 2.0 * x + right) - r * x**4


def chain(count: int = COUNT) -> Diagram:
    diagram = Diagram("rod", library=Cell)
    hot, cold = diagram.add("hot", Constant(value=1.0)), diagram.add("cold", Constant(value=0.0))
    cells = [diagram.add(f"cell{k}", Cell()) for k in range(count)]
    for k, cell in enumerate(cells):
        diagram.wire(cell.left, cells[k - 1].x if k else hot.y)
        diagram.wire(cell.right, cells[k + 1].x if k + 1 < count else cold.y)
    log = [f"cell{k}.x" for k in _picked(count)]
    diagram.settings(stop=STOP, method="radau", rtol=RTOL, atol=ATOL, every=STOP / 20, log=log)
    return diagram


def _picked(count: int) -> list[int]:
    """The cells that are recorded."""
    return [0, count // 100, count // 20, count // 4, count - 1]


def by_scipy(count: int, method: str, rtol: float, atol: float, *, sparse: bool) -> tuple[float, Array]:
    """Seconds, and states (times, count) on the recording grid. The Jacobian is exact where it is sparse."""
    import scipy.sparse as sp
    from scipy.integrate import solve_ivp

    def rates(t: float, x: Array) -> Array:
        made: Array = -2.0 * x
        made[1:] += x[:-1]
        made[:-1] += x[1:]
        made[0] += 1.0
        return np.asarray(CONDUCTION * made - RADIATION * x**4)

    def jacobian(t: float, x: Array) -> Any:
        side = np.full(count - 1, CONDUCTION)
        return sp.diags([side, -2.0 * CONDUCTION - 4.0 * RADIATION * x**3, side], [-1, 0, 1], format="csc")

    begun = time.perf_counter()
    times = np.linspace(0.0, STOP, 21)
    made = solve_ivp(
        rates, (0.0, STOP), np.zeros(count), method, times, rtol=rtol, atol=atol, jac=jacobian if sparse else None
    )
    if not made.success:
        raise RuntimeError(made.message)
    return time.perf_counter() - begun, made.y.T


def main() -> None:
    with on_one_core():
        _compare()


def _compare() -> None:
    _, exact = by_scipy(COUNT, "Radau", 1e-10, 1e-13, sparse=True)
    dense_s, dense = by_scipy(COUNT, "BDF", RTOL, ATOL, sparse=False)
    sparse_s, sparse = by_scipy(COUNT, "BDF", RTOL, ATOL, sparse=True)
    for label, seconds, states in (
        ("SciPy BDF, dense Jacobian by differences", dense_s, dense),
        ("SciPy BDF, sparse exact Jacobian, by hand", sparse_s, sparse),
    ):
        print(f"{label:44}{seconds:9.3f} s   error {np.max(np.abs(states - exact)):.1e}", flush=True)
    diagram = chain()
    for engine in ("native", "reference"):
        try:
            results = min((diagram.run(engine=engine) for _ in range(3)), key=lambda made: made.statistics.seconds)
        except BlocksError as refused:
            print(f"blocks, radau, {engine}: {refused}")
            continue
        states = np.column_stack([results[name] for name in results.names])
        worst = np.max(np.abs(states - exact[:, _picked(COUNT)]))
        seconds = results.statistics.seconds
        verdict = "met" if dense_s / seconds >= 20 else "MISSED"
        print(
            f"{f'blocks, radau, {engine}':44}{seconds:9.3f} s   error {worst:.1e}   {dense_s / seconds:.1f} times as "
            f"fast as the dense one, goal 20 {verdict}",
            flush=True,
        )
