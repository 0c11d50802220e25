"""Linear models of one diagram at many points at once, each with its own parameters: stacks of matrices.

    points = np.stack([read_at(linearizer.graph, point) for point in ...], axis=1)
    stack = stacked(linearizer, points, ["control.u"], ["control.u", "plant.y"])
    stack.A[k]                                              # at the k-th point
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..compile.fmu_tape import FmuTape
from ..text.arrays import Array
from .elimination import Entries
from .equation_matrix import wiring
from .linearization import Linearization
from .reduction import Wired, contributing, matrices_of, variables
from .signals import Names
from .slopes import partials_of, with_locals

_NUMBERS = 2**22
"""Numbers of the matrices that are eliminated at once."""


@dataclass(frozen=True)
class Stack:
    """dx/dt = A x + B e, y = C x + D e of each: (count, n, n), (count, n, inputs), ...; with dt, x at ticks."""

    A: Array
    B: Array
    C: Array
    D: Array
    dt: float = 0.0


def stacked(linearizer: Linearization, points: Array, inputs: Names, outputs: Names, *, pade: int = 0) -> Stack | None:
    """The models of `linearizer.transfer(inputs, outputs, pade=pade)` at many points, the columns of `read_at`.

    None where models cannot be stacked: sampled blocks or FMUs contribute, delays are to stay exact, describing
    functions differ, or subdiagrams are on at some points alone. Raises UsageError (E501), AnalysisError (E701, E703).
    """
    graph = linearizer.graph
    if any(isinstance(group.type.tape, FmuTape) for group in graph.groups):
        return None
    ins, outs = linearizer.ends(inputs, outputs)
    whole = wiring(linearizer, ins, outs, (), (), ())
    sides = points[graph.begin["s"] :][[side for _, side in graph.enabled]]
    if (sides != sides[:, :1]).any():
        return None
    everything = with_locals(graph, points)
    partials = partials_of(graph, everything)
    for node, slot in linearizer.described:
        i, key, element = graph.nodes[node]
        group, member = graph.group_of[i]
        read = everything[group.gather[list(group.type.tape.read_by[key][element]), member]]
        if (read != read[:, :1]).any():
            return None
        if (at := graph.entry_of.get((node, slot))) is not None:
            partials[at] = linearizer.data[at]
    _, slots, values = linearizer.entries_of(partials)
    values = values[whole.selects[slots] >= 0]
    constant = whole.entries.values[len(values) :, None]
    values = np.concatenate([values, np.broadcast_to(constant, (len(constant), points.shape[1]))])
    # What contributes at one of the points is kept at all.
    largest = replace(whole, entries=replace(whole.entries, values=np.abs(values).max(axis=1)))
    kept = contributing(linearizer, largest)
    x, d, h, z, e = variables(linearizer, largest, kept)
    if d or (h and not pade):
        return None
    cells = [*x, *h, *z], [*x, *h, *e, *z]
    place, n, r = _selection(whole.entries, *cells), len(x) + len(h), len(x) + len(h) + len(e)
    shape = len(cells[0]), len(cells[1])
    position = {c: k for k, c in enumerate(cells[1])}
    measured = [position.get(m, -1) for m in whole.measured]
    parts: list[tuple[Array, ...]] = []
    chunk = max(1, _NUMBERS // max(1, shape[0] * shape[1]))
    for begin in range(0, points.shape[1], chunk):
        dense = np.moveaxis((place @ values[:, begin : begin + chunk]).reshape(*shape, -1), 2, 0)
        if not np.isfinite(dense).all():
            return None
        try:
            T = np.linalg.solve(np.eye(len(z)) - dense[:, n:, r:], dense[:, n:, :r])
        except np.linalg.LinAlgError:
            return None
        dynamic = dense[:, :n, :r] + dense[:, :n, r:] @ T
        full = np.concatenate([np.broadcast_to(np.eye(r), (len(dense), r, r)), T], axis=1)
        seen = np.stack([full[:, m] if m >= 0 else np.zeros((len(dense), r)) for m in measured], axis=1)
        both = np.concatenate([dynamic, seen], axis=1)
        parts.append(_without_delays(linearizer, both, (len(x), len(h)), h, pade) if h else _split(both, len(x)))
    A, B, C, D = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Stack(A, B, C, D)


def _split(both: Array, n: int) -> tuple[Array, ...]:
    return both[:, :n, :n], both[:, :n, n:], both[:, n:, :n], both[:, n:, n:]


def _without_delays(
    linearizer: Linearization, both: Array, sizes: tuple[int, int], histories: list[int], pade: int
) -> tuple[Array, ...]:
    """The matrices with Padé models in the place of delays."""
    plan, (n, m) = linearizer.plan, sizes
    first = linearizer.graph.first["h"]
    made: list[tuple[Array, ...]] = []
    cuts = {"x": slice(0, n), "h": slice(n, n + m), "e": slice(n + m, None), "y": slice(n + m, None)}
    for one in both:
        wired = Wired(
            {(row, column): one[cuts[row], cuts[column]] for row in "xhy" for column in "xhe"}
            | {(row, "d"): np.zeros((one[cuts[row]].shape[0], 0)) for row in "xhy"}
            | {("d", column): np.zeros((0, one[:, cuts[column]].shape[1])) for column in "xhe"}
            | {("d", "d"): np.zeros((0, 0))},
            tuple(plan.states[:n]), (), tuple(c - first for c in histories),
        )  # fmt: skip
        matrices, _ = matrices_of(wired, plan, pade)
        made.append(tuple(matrices[key] for key in ("xx", "xe", "yx", "ye")))
    return tuple(np.stack(part) for part in zip(*made, strict=True))


def _selection(entries: Entries, rows: list[int], columns: list[int]) -> Any:
    """The matrix from the values of entries to those of the cells of some rows and columns."""
    from scipy import sparse

    keep, r, c = entries.within(rows, columns)
    cells = r * len(columns) + c
    shape = len(rows) * len(columns), len(entries.rows)
    return sparse.csr_array((np.ones(len(keep)), (cells, keep)), shape=shape)
