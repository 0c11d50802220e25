"""A wiring reduced to its states and signals: all that lies between them is eliminated.

Delays stay as they are, or Padé models stand in their place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..compile.plan import Node, Plan
from ..frequency.delayed import DelayedModel
from ..text.arrays import Array
from ..text.element_names import indexed
from ..text.errors import AnalysisError, Fault, UsageError
from .elimination import Entries, eliminated, reach, without_noise
from .equation_matrix import Wiring
from .interconnection import Interconnection
from .model_report import BlockReport
from .nonlinearities import remembers
from .replaced_slopes import ReplacedSlopes, or_a_gain
from .signals import SignalElement
from .slopes import Law


@dataclass(frozen=True)
class Wired:
    """A linear model before discretes and delays are dealt with; sparse matrices over what contributes.

    Rows: the derivatives of x, the sampled nodes of d, the sources of h, the outputs y. Columns: x, d, h and e, the
    perturbations.
    x, d, h: numbers of states, places in d, histories that are kept.
    """

    matrix: Mapping[tuple[str, str], Any]
    x: tuple[str, ...]
    d: tuple[int, ...]
    h: tuple[int, ...]

    def dense(self, row: str, column: str) -> Array:
        submatrix = self.matrix[row, column]
        return np.asarray(submatrix if isinstance(submatrix, np.ndarray) else submatrix.toarray(), dtype=float)


def contributing(replaced: ReplacedSlopes, wiring: Wiring) -> Array:
    """Which variables pass a change on from the inputs to what is measured.

    Raises AnalysisError: E701 (a law without a slope contributes), E703 (what is not linearized contributes).
    """
    graph, selects = replaced.graph, wiring.selects
    hidden = _hidden(replaced, selects)
    laws = [law for law in replaced.slopes.laws if (law.node, law.slot) not in replaced.described]
    laws = [law for law in laws if graph.nodes[law.node][0] not in replaced.overridden]
    owner = graph.variable
    seen = [(int(owner[law.node]), int(selects[law.slot])) for law in laws if owner[law.node] >= 0]
    links = [(row, column) for row, column, _ in hidden] + [pair for pair in seen if pair[1] >= 0]
    forward, backward = wiring.reached(links)
    kept = forward & backward
    for row, column, instance in hidden:
        if kept[row] and kept[column]:
            path = graph.plan.instances[instance].path
            message = "acts at each step, or is a program, so that it has no linear model."
            if instance in graph.plan.foreign_of:
                message = "is an FMU whose discrete outputs change at its events only, so that it has no linear model."
            cure = "Estimate the response by simulation, or exclude the block by openings or overrides."
            if any(node.instance == instance and remembers(graph, n)[0] for n, node in enumerate(graph.nodes)):
                cure = "Compute its response at an amplitude with harmonic_response."
                cure += or_a_gain(graph, instance)
            raise AnalysisError(Fault("E703", path, message, cure))
    _refuse(replaced, laws, selects, kept)
    jumps = [law for law in laws if law.kind == "jump"]
    if jumps and graph.stepped:  # they pass where whole numbers do, which have no slope
        links += [(int(owner[n]), int(selects[k])) for n, k in graph.stepped if owner[n] >= 0 and selects[k] >= 0]
        forward, backward = wiring.reached(links)
        _refuse(replaced, jumps, selects, forward & backward)
    return kept


def variables(replaced: ReplacedSlopes, wiring: Wiring, kept: Array) -> tuple[list[int], ...]:
    """Return the variables that contribute: states, places in d, histories, those between, and perturbations."""
    first, sizes = replaced.graph.first, replaced.graph.sizes
    x = [*range(first["x"], first["x"] + sizes["x"]), *range(wiring.states, wiring.size)]
    given = {column for columns in replaced.given.values() for column in columns}
    x = [c for c in x if kept[c] and c not in given]
    d = [c for c in range(first["d"], first["d"] + sizes["d"]) if kept[c] and c not in given]
    h = [c for c in range(first["h"], first["h"] + sizes["h"]) if kept[c]]
    points = range(wiring.points, wiring.inputs)
    z = [c for c in (*range(first["v"], first["v"] + sizes["v"]), *points) if kept[c]]
    z += sorted(c for c in given if kept[c] and c not in z)
    return x, d, h, z, list(range(wiring.inputs, wiring.states))


def reduced(replaced: ReplacedSlopes, wiring: Wiring, kept: Array) -> Wired:
    """The model of what contributes. Raises AnalysisError (E701) where an algebraic loop has no unique solution."""
    graph, first = replaced.graph, replaced.graph.first
    x, d, h, z, e = variables(replaced, wiring, kept)
    rest = [*x, *d, *h, *e]
    whole = wiring.entries.block([*x, *d, *h, *z], [*rest, *z])
    if not np.isfinite(whole if isinstance(whole, np.ndarray) else whole.data).all():
        raise AssertionError("a slope that is not finite was not told as a law")
    n, r = len(rest) - len(e), len(rest)
    T = eliminated(whole[n:, r:], whole[n:, :r], lambda k: _called(graph, z[k], wiring.points))
    bound = reach(whole[n:, r:], whole[n:, :r], T)
    dynamic = without_noise(whole[:n, :r] + whole[:n, r:] @ T, abs(whole[:n, :r]) + abs(whole[:n, r:]) @ bound)
    cuts = np.cumsum([0, len(x), len(d), len(h), len(e)]).tolist()
    spans = {name: slice(cuts[k], cuts[k + 1]) for k, name in enumerate("xdhe")}
    position = {c: k for k, c in enumerate([*rest, *z])}
    is_sparse = not isinstance(whole, np.ndarray)
    lines = _picking([position.get(m, -1) for m in wiring.measured], r + len(z), is_sparse=is_sparse)
    seen_y = without_noise(lines[:, :r] + lines[:, r:] @ T, lines[:, :r] + lines[:, r:] @ bound)
    parts = {
        (row, column): (seen_y if row == "y" else dynamic[spans[row]])[:, spans[column]]
        for row in "xdhy"
        for column in "xdhe"
    }
    states, begin = graph.plan.states, wiring.states
    names = [states[c - first["x"]] if c < begin else _override_state(replaced, c - begin) for c in x]
    return Wired(parts, tuple(names), tuple(c - first["d"] for c in d), tuple(c - first["h"] for c in h))


def _hidden(replaced: ReplacedSlopes, selects: Array) -> list[tuple[int, int, int]]:
    """Changes of memory that are no equations of the model: (variable, what it reads, the instance).

    A describing function accounts for the memory of what it replaces. An FMU's discrete outputs change at its events.
    """
    graph, plan, links = replaced.graph, replaced.graph.plan, []
    described = {graph.nodes[node][0] for node, _ in replaced.described if remembers(graph, node)[0]}
    gives: dict[int, set[int]] = {}  # by instance, what of it changes
    for part in plan.steppers:
        gives.setdefault(part.instance, set()).update(
            graph.first["d"] + place for _, places, _ in part.outputs for place in places
        )
    for (i, *_), reference in plan.projections:
        gives.setdefault(i, set()).add(graph.column(reference))
    for fmu in plan.foreign:
        if any(variable.variability == "discrete" for variable in fmu.foreign.variables.values()):
            gives[fmu.instance] = set()
    for n, node in enumerate(plan.outputs if gives else ()):
        if node.instance in gives and _is_held(plan, node):
            gives[node.instance].add(graph.first["v"] + n)
    for i in gives.keys() - replaced.overridden.keys() - described:
        columns = gives[i]
        first, kind = int(graph.slot_first[i]), graph.type_of[i]
        read = [int(selects[first + n]) for n in range(len(kind.slots)) if kind.is_wired[n]]
        links += [(given, column, i) for given in columns for column in read if column >= 0]
    return links


def _is_held(plan: Plan, node: Node) -> bool:
    """Whether an output is not computed between events: of a program, or a discrete real one of an FMU."""
    if node.instance not in plan.foreign_of:
        return True
    variables = plan.foreign[plan.foreign_of[node.instance]].foreign.variables
    variable = variables.get(node.key.removeprefix("output:"))
    return variable is not None and variable.variability == "discrete"


def _refuse(replaced: ReplacedSlopes, laws: Sequence[Law], selects: Array, kept: Array) -> None:
    faults: dict[tuple[str, str], Fault] = {}
    for law in laws:
        column = int(selects[law.slot])
        row = int(replaced.graph.variable[law.node])
        if column < 0 or row < 0 or not (kept[column] and kept[row]):
            continue
        name = replaced.graph.slot_name(law.slot)
        value = replaced.slopes.everything_of(law.slot)
        what = {"jump": "jumps", "corner": "has a corner"}.get(law.kind, "has an infinite slope")
        message = f"{what} at {law.by} = {value:g}, its operating point, so that it has no linear model."
        name = indexed(name)[0]  # other elements of a vector work at an amplitude too
        cure = f'Give the amplitude at which it works: amplitude={{"{name}": A}}, or --amplitude {name}=A.'
        cure += or_a_gain(replaced.graph, replaced.graph.nodes[law.node][0])
        faults.setdefault((law.block, law.equation), Fault("E701", f"{law.block}.{law.equation}", message, cure))
    if faults:
        raise AnalysisError(*faults.values())


def _override_state(replaced: ReplacedSlopes, number: int) -> str:
    for i, (A, *_) in replaced.overridden.items():
        if number < len(A):
            return f"{replaced.graph.plan.instances[i].path}.override[{number}]"
        number -= len(A)
    raise AssertionError("no such state")


def _called(graph: Interconnection, variable: int, points: int) -> str:
    node = variable - graph.first["v"]
    if 0 <= node < graph.values:
        return graph.node_name(node)
    return "an override" if variable < points else "an analysis point"


def _picking(columns: Sequence[int], size: int, *, is_sparse: bool) -> Any:
    """Rows that pick a column each; those of -1 are 0."""
    rows = [k for k, c in enumerate(columns) if c >= 0]
    entries = Entries(
        np.array(rows, dtype=np.intp), np.array([columns[k] for k in rows], dtype=np.intp), np.ones(len(rows)), size
    )
    return entries.matrix((len(columns), size), is_sparse=is_sparse)


def with_pade_models(
    report: tuple[BlockReport, ...], wired: Wired, plan: Plan, pade: int
) -> tuple[BlockReport, ...]:  # fmt: skip
    """Return the report, in which each delay that is a Padé model says so, and up to which frequency it is near."""
    if not (wired.h and pade):
        return report
    delays = {plan.histories[k].name.rpartition(".")[0]: plan.delays[k].delay for k in wired.h}

    def noted(block: BlockReport) -> BlockReport:
        if block.path not in delays:
            return block
        method = f"a Padé model of order {pade}, near up to about {2 * pade / delays[block.path]:.3g} rad/s"
        return replace(block, method=method)

    return tuple(map(noted, report))


def matrices_of(wired: Wired, plan: Plan, pade: int) -> tuple[dict[str, Array], list[str]]:
    """Dense matrices by row and column ("xx", "xe", ...), with Padé models in the place of delays, and state names.

    Without `pade` the delays of a sampled model keep the row and the column "h". Raises AnalysisError (E707) for a
    continuous model with exact delays.
    """
    if isinstance(pade, bool) or not isinstance(pade, (int, np.integer)) or pade < 0:
        raise UsageError(Fault("E501", "pade", f"must be an order, 1 or more, not {pade!r}."))
    matrices = {row + column: wired.dense(row, column) for row in "xdy" for column in "xde"}
    names = list(wired.x)
    if not wired.h:
        return matrices, names
    if pade < 1 and wired.d:
        return {row + column: wired.dense(row, column) for row in "xdhy" for column in "xdhe"}, names
    if pade < 1:
        delays = ", ".join(f"{plan.histories[k].name} ({plan.delays[k].delay:g} s)" for k in wired.h)
        message = f"the transfer has exact delays, which a state space cannot hold: {delays}."
        cure = (
            "They stay exact in linearizer.response(...), delayed(inputs, outputs) and delayed_loop(signal), "
            "which margins() accepts. For a state space, replace them by Padé models: pade=3 (--pade 3)."
        )
        raise AnalysisError(Fault("E707", plan.name, message, cure))
    import control

    A, B, C, D = [], [], [], []  # type: ignore[var-annotated]
    for k in wired.h:
        num, den = control.pade(plan.delays[k].delay, pade)
        system = control.ss(control.tf(num, den))
        for parts, matrix in zip((A, B, C, D), (system.A, system.B, system.C, system.D), strict=True):
            parts.append(matrix)
        names += [f"{plan.histories[k].name}.pade[{j}]" for j in range(pade)]
    from scipy.linalg import block_diag

    Ap, Bp, Cp, Dp = (block_diag(*parts) for parts in (A, B, C, D))
    to_h = {column: wired.dense("h", column) for column in "xdhe"}
    # h = Cp xp + Dp (to_h of everything), solved for h
    K = np.linalg.inv(np.eye(len(wired.h)) - Dp @ to_h["h"])
    h = {"p": K @ Cp, **{column: K @ Dp @ to_h[column] for column in "xde"}}
    source = {"p": to_h["h"] @ h["p"], **{column: to_h[column] + to_h["h"] @ h[column] for column in "xde"}}
    from_h = {row: wired.dense(row, "h") for row in "xdy"}
    own = {row + column: matrices[row + column] + from_h[row] @ h[column] for row in "xdy" for column in "xde"}
    result = {
        "xx": np.block([[own["xx"], from_h["x"] @ h["p"]], [Bp @ source["x"], Ap + Bp @ source["p"]]]),
        "xd": np.vstack([own["xd"], Bp @ source["d"]]),
        "xe": np.vstack([own["xe"], Bp @ source["e"]]),
        "dx": np.hstack([own["dx"], from_h["d"] @ h["p"]]),
        "yx": np.hstack([own["yx"], from_h["y"] @ h["p"]]),
        "dd": own["dd"], "de": own["de"], "yd": own["yd"], "ye": own["ye"],
    }  # fmt: skip
    return result, names


def delayed_model(
    wired: Wired, plan: Plan, ins: Sequence[SignalElement], outs: Sequence[SignalElement]
) -> DelayedModel:
    """The model with its delays as they are. Raises UsageError (E501) if sampled blocks contribute too."""
    if wired.d:
        message = "sampled blocks contribute to this transfer: its delays are exact in a model from tick to tick."
        raise UsageError(Fault("E501", plan.name, message, "Use model(), or loop()."))
    matrices = {(row, column): wired.dense(row, column) for row in "xhy" for column in "xhe"}
    delays = tuple(plan.delays[k].delay for k in wired.h)
    signals = tuple(spot.name for spot in ins), tuple(spot.name for spot in outs)
    return DelayedModel(matrices, delays, signals, (tuple(s.unit for s in ins), tuple(s.unit for s in outs)))
