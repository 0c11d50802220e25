"""Where algebraic loops are torn, and the slopes of their residuals by the torn unknowns.

A loop is torn at a few of its unknowns: where these are known, all others follow one after the other, each from the
equation of its node. Newton's method then searches for the torn ones alone. Reference: F. E. Cellier, E. Kofman,
Continuous System Simulation, Springer 2006, section 7.4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ..contract.tape import Tape
from ..contract.tracing import jacobian
from .fmu_tape import FmuTape
from .plan import AlgebraicLoop, LoopPart, Node, Plan


def stages(needs: Mapping[Node, Sequence[Node]], torn: frozenset[Node]) -> dict[Node, int]:
    """Return the stage at which each node of a loop is computed: after all that it needs. Torn nodes are the last.

    A loop is torn at `torn`, at the nodes that need themselves, and then, as long as nodes need each other, at the node
    through which most ways lead: to find the least number of such nodes takes too long (Karp 1972).
    """
    users: dict[Node, list[Node]] = {node: [] for node in needs}
    for node, before in needs.items():
        for other in before:
            users[other].append(node)
    cut = _cut(needs, users, torn)
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


def _cut(
    needs: Mapping[Node, Sequence[Node]], users: Mapping[Node, Sequence[Node]], torn: frozenset[Node]
) -> set[Node]:
    """Return the nodes at which a loop is torn."""
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
    return cut


class Slopes(NamedTuple):
    """Texts of slopes by the torn unknowns, in terms of `a{part}_{k}`: the values of a part, then its partials.

    made: for each part, names and texts of the slopes of its unknowns. matrix: of the residuals.
    """

    made: tuple[tuple[tuple[str, str], ...], ...]
    matrix: tuple[tuple[str, ...], ...]


def slopes(plan: Plan, loop: AlgebraicLoop) -> Slopes:
    """Return the slopes of a loop by the chain rule, from the torn unknowns to the residuals."""
    place = {row: k for k, row in enumerate(loop.torn)}
    factors: dict[int, dict[int, str]] = {row: {k: ""} for row, k in place.items()}
    matrix: dict[int, dict[int, str]] = {}
    made = []
    for number, part in enumerate(loop.parts):
        texts: list[tuple[str, str]] = []
        for i, row in enumerate(part.rows):
            terms: dict[int, list[str]] = {}
            for j, column in enumerate(part.columns, len(part.results) + i * len(part.columns)):
                for k, factor in factors[column].items():
                    terms.setdefault(k, []).append(f"a{number}_{j}*{factor}" if factor else f"a{number}_{j}")
            if row in place:
                if not loop.is_residual(plan, number, i):
                    terms.setdefault(place[row], []).append("-1.0")
                matrix[place[row]] = {k: " + ".join(summed) for k, summed in terms.items()}
                continue
            factors[row] = {k: f"d{row}_{k}" for k in terms}
            texts += [(factors[row][k], " + ".join(summed)) for k, summed in terms.items()]
        made.append(tuple(texts))
    order = range(len(loop.torn))
    return Slopes(tuple(made), tuple(tuple(matrix[k].get(j, "0.0") for j in order) for k in order))


class Sensitivities(NamedTuple):
    """The values of a part, and their partials by all real arguments that they read, known and unknown."""

    tape: Tape
    arguments: tuple[int, ...]


_REAL = frozenset(
    ("time", "parameter", "input", "state", "discrete", "algebraic", "history", "output", "held", "local")
)


def sensitivities(plan: Plan, loop: AlgebraicLoop, part: LoopPart) -> Sensitivities:
    """Return the tape by which the rounding of a part is bounded. Of an FMU only the unknowns count."""
    instance = plan.instances[part.instance]
    results = instance.tape.results
    read = {k for key, e in part.results for k in instance.tape.arguments_of(results[key].nodes[e])}
    if isinstance(part.tape, FmuTape):
        unknowns = frozenset(loop.unknowns)
        return Sensitivities(part.tape, tuple(k for k in sorted(read) if instance.arguments[k] in unknowns))
    arguments = tuple(k for k in sorted(read) if instance.tape.arguments[k].kind in _REAL)
    return Sensitivities(jacobian(instance.tape, part.results, arguments), arguments)


def bounds(
    plan: Plan, loop: AlgebraicLoop, given: Sequence[tuple[tuple[int, ...], Mapping[int, str]]], absolute: str
) -> Slopes:
    """Return texts of what the rounding of all values on the way adds up to, in units of 2^-52.

    They are in terms of `a{part}_{k}`, of the tapes of `sensitivities`. given: for each part the arguments of its
    partials, and the texts of all that it reads. absolute: the function of absolute values. made: for each part, names
    and texts of the bounds of its unknowns, each with its own rounding and that of an operation on it. matrix: a row of
    the bounds of the residuals.
    """
    row_of = {reference: row for row, reference in enumerate(loop.unknowns)}
    torn: dict[int, str] = {}
    made = []
    for number, (part, (arguments, texts)) in enumerate(zip(loop.parts, given, strict=True)):
        instance, count = plan.instances[part.instance], len(part.results)
        lines: list[tuple[str, str]] = []
        for i, row in enumerate(part.rows):
            terms = [f"{absolute}(a{number}_{i})"]
            for j, k in enumerate(arguments, count + i * len(arguments)):
                if k in texts:
                    unknown = row_of.get(instance.arguments[k])
                    is_bound = unknown is not None and unknown not in loop.torn
                    size = f"g{unknown}" if is_bound else f"{absolute}({texts[k]})"
                    terms.append(f"{absolute}(a{number}_{j})*{size}")
            if row in loop.torn:
                torn[row] = " + ".join(terms)
            else:
                lines.append((f"g{row}", " + ".join([terms[0], *terms])))
        made.append(tuple(lines))
    return Slopes(tuple(made), (tuple(torn[row] for row in loop.torn),))
