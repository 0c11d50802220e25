"""What a sparse coupling costs per edge: dx/dt = -L x on random graphs of 10^2 to 10^5 edges, against rows of C."""

from __future__ import annotations

import time
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from blocks import Diagram, graph
from blocks.library import Integrator, MatrixGain, Mux

from .measure import FOLDER, HEAD, Made, Program, difference, in_turn, line, native, on_one_core

__all__ = ["coupled", "main", "random"]

STEP, PER_VERTEX, SUMS = Fraction(1, 100), 4, 4e7


def random(edges: int) -> Any:
    """-L of a directed graph with as many vertices that each edge in four ends at one, on the average."""
    rng, n = np.random.default_rng(1), edges // PER_VERTEX
    places = np.unique(rng.integers(0, n, size=(2 * edges, 2)), axis=0)
    places = rng.permutation(places[places[:, 0] != places[:, 1]])[:edges]
    return -graph.laplacian(sp.csr_array((rng.uniform(0.1, 1.0, len(places)), places.T), shape=(n, n)))


def coupled(matrix: Any) -> Diagram:
    n = matrix.shape[0]
    diagram = Diagram("coupled")
    x, gain = diagram.add("x", Mux(size=n)), diagram.add("gain", MatrixGain(K=matrix))
    diagram.wire(gain.u, x.y)
    for k in range(n):
        agent = diagram.add(f"x{k}", Integrator(y_start=1.0 + k % 7))
        diagram.wire(agent.u, gain.y[k])
        diagram.wire(f"x.u{k + 1}", agent.y)
    return diagram


def _program(matrix: Any) -> Program:
    def array(kind: str, name: str, values: Any) -> str:
        return f"static const {kind} {name}[] = {{{', '.join(map(repr, values.tolist()))}}};"

    n = matrix.shape[0]
    parts = (("int", "first", matrix.indptr), ("int", "column", matrix.indices), ("double", "value", matrix.data))
    lines = [f"#define NX {n}", *(array(*part) for part in parts)]
    start = array("double", "start", 1.0 + np.arange(n) % 7)
    text = (FOLDER / "c" / "sparse.c").read_text(encoding="utf-8")
    return Program("\n".join([*lines, start, text]), 1)


def _seconds(name: str, run: Any, kept: dict[str, Made]) -> float:
    kept[name] = run()
    return kept[name].seconds


def main(counts: tuple[int, ...] = (100, 1_000, 10_000, 100_000)) -> None:
    print(f"rk4, four sums over all edges a step\n{HEAD}")
    with on_one_core():
        for edges in counts:
            matrix = random(edges)
            steps = max(int(SUMS / edges / 4), 10)
            stop, row = float(steps * STEP), steps // 10 * STEP
            begun = time.process_time()
            diagram = coupled(matrix)
            drawn = time.process_time() - begun
            begun, wall = time.process_time(), time.perf_counter()
            settings = {"method": "rk4", "step": float(STEP), "stop": stop, "every": float(row), "log": ["x0.y"]}
            native(diagram, **{**settings, "stop": float(10 * STEP), "every": float(STEP)})
            prepared, waited = time.process_time() - begun, time.perf_counter() - wall
            program, kept = _program(matrix), dict[str, Made]()
            runs = {
                "C": partial(program.run, stop, step=STEP, every=row),
                "native": partial(native, diagram, **settings),
            }
            made = in_turn({name: partial(_seconds, name, run, kept) for name, run in runs.items()}, 5)
            note = f"{min(made['native']) / steps / 4 / matrix.nnz * 1e9:.2f} ns an edge"
            print(line(f"  {edges:,} edges", made["native"], made["C"], None, note))
            apart = difference(kept["C"], kept["native"], row).max()
            print(
                f"    drawn in {drawn:.2f} s, then {1e6 * prepared / edges:.0f} us of CPU an edge until it runs "
                f"({waited:.2f} s with the compiler); largest difference {apart:.0e}",
                flush=True,
            )
