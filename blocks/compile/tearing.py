"""Where algebraic loops are torn, and the slopes of their residuals by the torn unknowns.

A loop is torn at a few of its unknowns: where these are known, all others follow one after the other, each from the
equation of its node. Newton's method then searches for the torn ones alone. Reference: F. E. Cellier, E. Kofman,
Continuous System Simulation, Springer 2006, section 7.4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from .plan import AlgebraicLoop, Node, Plan

__all__ = ["Slopes", "slopes", "stages"]


def stages(needs: Mapping[Node, Sequence[Node]], torn: frozenset[Node]) -> dict[Node, int]:
    """Return the stage at which each node of a loop is computed: after all that it needs. Torn nodes are the last.

    A loop is torn at `torn`, at the nodes that need themselves, and then, as long as nodes need each other, at the node
    through which most ways lead: to find the least number of such nodes takes too long (Karp 1972).
    """
    users: dict[Node, list[Node]] = {node: [] for node in needs}
    for node, before in needs.items():
        for other in before:
            users[other].append(node)
    cut = {node for node, before in needs.items() if node in torn or node in before}
    into = {node: sum(other not in cut for other in before) for node, before in needs.items() if node not in cut}
    out = {node: sum(other not in cut for other in users[node]) for node in into}
    ends = [node for node in into if not into[node] or not out[node]]
    while into:
        if not ends:
            ends.append(max(into, key=lambda node: into[node] * out[node]))
            cut.add(ends[0])
        node = ends.pop()
        if node not in into:
            continue
        del into[node], out[node]
        for others, counts in ((users[node], into), (needs[node], out)):
            for other in others:
                if other in counts:
                    counts[other] -= 1
                    if not counts[other]:
                        ends.append(other)
    stage = dict.fromkeys(needs, 0)
    waiting = {node: sum(other not in cut for other in before) for node, before in needs.items() if node not in cut}
    ready = [node for node, count in waiting.items() if not count]
    while ready:
        node = ready.pop()
        for user in users[node]:
            if user in waiting:
                stage[user] = max(stage[user], stage[node] + 1)
                waiting[user] -= 1
                if not waiting[user]:
                    ready.append(user)
    last = 1 + max(stage.values())
    return {node: last if node in cut else stage[node] for node in needs}


class Slopes(NamedTuple):
    """Texts of slopes by the torn unknowns, in terms of `a{part}_{k}`: the values of a part, then its partials.

    made: for each part, names and texts of what is computed of its unknowns. matrix: of the residuals. rounding: of the
    residuals, in units of 2^-52: a bound on what the rounding of all values on the way adds up to.
    """

    made: tuple[tuple[tuple[str, str], ...], ...]
    matrix: tuple[tuple[str, ...], ...]
    rounding: tuple[str, ...]


def slopes(plan: Plan, loop: AlgebraicLoop, names: Mapping[int, str], absolute: str) -> Slopes:
    """Return the slopes of a loop by the chain rule, from the torn unknowns to the residuals.

    names: of the unknowns. absolute: the function of absolute values.
    """
    place = {row: k for k, row in enumerate(loop.torn)}
    factors: dict[int, dict[int, str]] = {row: {k: ""} for row, k in place.items()}
    # What each unknown adds to the rounding of a value of slope 1: its own rounding, and that of an operation on it.
    sizes = {row: f"{absolute}({names[row]})" for row in place}
    matrix: dict[int, dict[int, str]] = {}
    rounding: dict[int, str] = {}
    made = []
    for number, part in enumerate(loop.parts):
        texts: list[tuple[str, str]] = []
        for i, row in enumerate(part.rows):
            terms: dict[int, list[str]] = {}
            read = [f"{absolute}(a{number}_{i})"]
            for j, column in enumerate(part.columns, len(part.results) + i * len(part.columns)):
                for k, factor in factors[column].items():
                    terms.setdefault(k, []).append(f"a{number}_{j}*{factor}" if factor else f"a{number}_{j}")
                read.append(f"{absolute}(a{number}_{j})*{sizes[column]}")
            if row in place:
                if not loop.is_residual(plan, number, i):
                    terms.setdefault(place[row], []).append("-1.0")
                    read.append(sizes[row])
                matrix[place[row]] = {k: " + ".join(sum_) for k, sum_ in terms.items()}
                rounding[place[row]] = " + ".join(read)
                continue
            factors[row] = {k: f"d{row}_{k}" for k in terms}
            texts += [(factors[row][k], " + ".join(sum_)) for k, sum_ in terms.items()]
            sizes[row] = f"g{row}"
            texts.append((sizes[row], " + ".join([f"{absolute}(a{number}_{i})", *read])))
        made.append(tuple(texts))
    order = range(len(loop.torn))
    rows = tuple(tuple(matrix[k].get(j, "0.0") for j in order) for k in order)
    return Slopes(tuple(made), rows, tuple(rounding[k] for k in order))
