"""The slopes of a diagram at a point: of each equation by each of its arguments, and the laws that have none.

Derivatives are exact, by the tape of each type, for all blocks of a type at once; those of FMUs are their directional
derivatives, or central differences of two steps, which must agree. A node that has no unique slope at the point (an
infinite one, a jump, a corner) is found by looking at both sides of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from ..compile.fmu_tape import FmuTape, Request
from ..compile.jacobian import on_arrays, terms_on_arrays
from ..engines.reference.python_code import CompiledPrograms
from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault
from .interconnection import Interconnection
from .point import Point
from .probing import ROUNDING, Probe
from .type_partials import TypePartials

_GRAPHS: WeakKeyDictionary[CompiledPrograms, Interconnection] = WeakKeyDictionary()


@dataclass(frozen=True, slots=True)
class Law:
    """A node that has no unique slope at the point, or that a describing function stands for: its block and equation.

    kind: "infinite slope", "jump", "corner". by: the argument, as it is called.
    """

    node: int
    slot: int
    block: str
    equation: str
    by: str
    kind: str


def slopes_at(point: Point) -> Slopes:
    """The slopes at a point, which are computed once; points of one run, or of the same programs, share their graph."""
    if not point.slopes:
        compiled = point.engine.compiled
        if compiled not in _GRAPHS:
            _GRAPHS[compiled] = Interconnection(point.plan)
        point.slopes.append(_slopes(_GRAPHS[compiled], point))
    slopes: Slopes = point.slopes[0]
    return slopes


def _slopes(graph: Interconnection, point: Point) -> Slopes:
    """The partial derivatives at a point, with the laws that have none there."""
    everything, told = with_locals(graph, read_at(graph, point)), dict[int, str]()
    numbers = partials_of(graph, everything)
    first = 0
    for group in graph.groups:
        kind, size = group.type, len(group.members)
        if isinstance(kind.tape, FmuTape):
            partials = numbers[first : first + len(kind.pairs) * size].reshape(len(kind.pairs), size)
            for m, i in enumerate(group.members):
                partials[:, m], told[i] = partials_of_fmu(kind, point, i, everything[group.gather[:, m]])
        first += len(kind.pairs) * size
    slopes = Slopes(graph, point, everything, numbers, told)
    slopes.find_laws()
    return slopes


def partials_of(graph: Interconnection, everything: Array) -> Array:
    """The partial derivatives by the tapes of all types, from all that equations read; those of FMUs are not set.

    everything: of one point, or of many with a column for each.
    """
    numbers, first = np.empty((len(graph.partial_rows), *everything.shape[1:])), 0
    for group in graph.groups:
        kind, size = group.type, len(group.members)
        if isinstance(kind.tape, FmuTape):
            first += len(kind.pairs) * size
            continue
        arguments = list(everything[group.gather])
        for tape, nodes, sums in kind.tapes:
            begin = first
            for value in on_arrays(tape, nodes, arguments, group.tables):
                numbers[first : first + size] = value
                first += size
            if sums:  # kp - ki kp/ki is 0, and not what rounding makes of it
                for n, terms in enumerate(terms_on_arrays(tape, nodes, arguments, group.tables)):
                    part = numbers[begin + n * size : begin + (n + 1) * size]
                    part[np.abs(part) <= ROUNDING * terms] = 0.0
    return numbers


def read_at(graph: Interconnection, point: Point) -> Array:
    """All that equations read at a point, in one row, but for locals."""
    t, x, d, s, p, u, k, h, *_ = point.memory
    values = np.empty(graph.width + len(graph.numbers))
    parts = {"x": x, "d": d, "s": s, "p": p, "u": u, "h": h, "w": point.outputs}
    values[graph.begin["tick"] : graph.begin["h"]] = k
    for row, numbers in parts.items():
        values[graph.begin[row] : graph.begin[row] + len(numbers)] = numbers
    for slot, value in graph.begun:
        values[graph.begin["d"] + slot] = value
    values[graph.begin["t"]], values[graph.begin["c"]] = t, 0.0
    values[graph.width :] = graph.numbers
    return values


def with_locals(graph: Interconnection, values: Array) -> Array:
    """The same row, or a column for each of many points, with the locals, by the tapes that see through them."""
    for group in graph.groups:
        kind = group.type
        if not kind.locals:
            continue
        nodes = [kind.original.results[key].nodes[e] for key, e in kind.locals]
        arguments = [values[group.gather[k]] for k in kind.fine_at]
        local_values = on_arrays(kind.original, nodes, arguments, group.tables)
        for places, value in zip(group.locals, local_values, strict=True):
            values[places] = value
    return values


class Slopes:
    """Partial derivatives at a point: `data` over (partial_rows, partial_slots) of the graph.

    laws: the nodes that have no unique slope here. methods: by instance, how the derivatives of FMUs were obtained.
    """

    def __init__(
        self, graph: Interconnection, point: Point, everything: Array, data: Array, methods: Mapping[int, str]
    ) -> None:
        self.graph, self.point, self.everything, self.data, self.methods = graph, point, everything, data, methods
        self.laws: list[Law] = []
        self.sizes = self._sizes()
        sides = point.memory[3]
        self.off = np.zeros(len(graph.nodes), dtype=bool)  # nodes that do not move, in subdiagrams that are off
        for node, side in graph.enabled:
            self.off[node] = not sides[side]

    def everything_of(self, slot: int) -> float:
        """The value that a slot reads at the point."""
        graph = self.graph
        i = graph.owner(slot)
        group, member = graph.group_of[i]
        k = group.type.slots[slot - int(graph.slot_first[i])]
        return float(self.everything[group.gather[k, member]])

    def _sizes(self) -> Array:
        """By column, how large the terms of its sum are: rounding and tolerances are relative to them."""
        graph = self.graph
        sizes = np.zeros(graph.columns + 1)  # the last one: of constants
        for row in ("x", "d", "u", "h"):
            values = self.everything[graph.begin[row] : graph.begin[row] + graph.sizes[row]]
            sizes[graph.first[row] : graph.first[row] + graph.sizes[row]] = np.abs(values)
        begin = graph.begin["w"]
        own = np.abs(self.everything[begin : begin + graph.values])
        sizes[graph.first["v"] : graph.first["v"] + graph.values] = own
        keep = (graph.partial_rows < graph.values) & np.isfinite(self.data)
        terms = np.zeros(graph.values)
        read = sizes[graph.selects[graph.partial_slots[keep]]]
        np.add.at(terms, graph.partial_rows[keep], np.abs(self.data[keep]) * np.where(np.isfinite(read), read, 0.0))
        sizes[graph.first["v"] : graph.first["v"] + graph.values] = np.fmax(own, terms)
        return sizes

    def find_laws(self) -> None:
        """Look at both sides of every equation that may have no slope."""
        graph = self.graph
        first = 0
        for group in graph.groups:
            kind, size = group.type, len(group.members)
            places = {pair: first + n * size for n, pair in enumerate(kind.pairs)}
            first += len(kind.pairs) * size
            if kind.bends:
                for node, slot, what in Probe(graph, group, self.everything, self.sizes).laws(places, self.data):
                    self._add(node, slot, what)
        bad = ~np.isfinite(self.data)
        known = {(law.node, law.slot) for law in self.laws}
        for n in np.nonzero(bad)[0].tolist():
            node, slot = int(graph.partial_rows[n]), int(graph.partial_slots[n])
            if (node, slot) not in known:
                self._add(node, slot, "infinite slope")

    def _add(self, node: int, slot: int, kind: str) -> None:
        graph = self.graph
        path = graph.plan.instances[graph.nodes[node][0]].path
        by = graph.slot_name(slot).removeprefix(f"{path}.")
        self.laws.append(Law(node, slot, path, graph.node_name(node).removeprefix(f"{path}."), by, kind))


def partials_of_fmu(kind: TypePartials, point: Point, instance: int, values: Array) -> tuple[Array, str]:
    """The partials of an FMU, and how they were obtained. Raises AnalysisError (E701) where differences do not agree.

    Its local variables have no directional derivatives: theirs are differences, and NaN where these do not agree.
    """
    unit = point.foreign[point.plan.foreign_of[instance]]
    asked = [(kind.rows[r], kind.slots[s]) for r, s in kind.pairs]
    values = values.copy()
    partials = np.full(len(asked), math.nan)
    if unit.interface.directional:
        if unit.is_reliable is None:
            unit.partials(asked, values.tolist())  # which compares them with differences
        if unit.is_reliable:
            partials[:] = unit.exact(asked, values.tolist())
    rest = [n for n in range(len(asked)) if not math.isfinite(partials[n])]
    inner = {row for row, _ in asked if not unit.has_directional(unit.item(*row))}
    is_exact = all(asked[n][0] in inner for n in rest)
    method = "directional derivatives" if unit.is_reliable and is_exact else "central differences of two steps"
    if not rest:
        return partials, method
    rows = list(dict.fromkeys(asked[n][0] for n in rest))
    place = {row: n for n, row in enumerate(rows)}
    assert isinstance(kind.tape, FmuTape)
    request = Request.of(kind.tape, rows)

    def results(at: Array) -> Array:
        given = [at[k] for k in request.arguments]
        return np.array(unit.values(request, given[0], *given[1:]), dtype=float)

    nominal = {k: size for (k, _), size in zip(kind.tape.opaque.states, unit.part.nominal, strict=True)}
    for k in dict.fromkeys(asked[n][1] for n in rest):
        size = max(abs(values[k]), nominal.get(k, 1.0))
        quotients = []
        for step in (1e-4 * size, 1e-5 * size):
            up, down = values.copy(), values.copy()
            up[k] += step
            down[k] -= step
            quotients.append((results(up) - results(down)) / (up[k] - down[k]))
        for n in rest:
            row, slot = asked[n]
            if slot == k:
                coarse, fine = quotients[0][place[row]], quotients[1][place[row]]
                largest = max(float(np.nanmax(np.abs(quotients[1]))), abs(coarse), abs(fine))
                if not abs(coarse - fine) <= 1e-3 * max(abs(coarse), abs(fine)) + 1e-9 * largest:
                    path = point.plan.instances[instance].path
                    by = kind.tape.arguments[k].name
                    message = (
                        f"has no slope at this point: differences with two step sizes in {by} give {coarse:.6g} "
                        f"and {fine:.6g}."
                    )
                    cure = "Choose another operating point, or estimate the response by simulation."
                    if row not in inner:
                        raise AnalysisError(Fault("E701", f"{path}.{row[0].partition(':')[2]}", message, cure))
                    fine = math.nan
                partials[n] = fine
    results(values)
    return partials, method
