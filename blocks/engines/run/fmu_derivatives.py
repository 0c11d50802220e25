"""Partial derivatives of what an FMU for Model Exchange gives.

They are the FMU's own directional derivatives where these can be relied on, else quotients of differences.

References: FMI 2.0.4, 2.1.9; FMI 3.0.2, 2.2.11.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ...compile.fmu_tape import OpaqueItem
from ...compile.jacobian import apart
from ...compile.plan import ForeignPart, Plan
from ...fmi.model_description import ModelVariable
from .fmu_values import FmuValues

_ROOT = math.sqrt(float(np.finfo(float).eps))
_AGREES = 1e-3
"""How far a directional derivative may be from a quotient of differences, of the larger of the two."""


class FmuDerivatives(FmuValues):
    """An FMU between instants that can be derived, too."""

    def __init__(self, plan: Plan, part: ForeignPart) -> None:
        super().__init__(plan, part)
        self.is_reliable: bool | None = None  # whether directional derivatives are what differences are

    def partials(self, pairs: Sequence[tuple[tuple[str, int], int]], point: Sequence[float]) -> list[float]:
        """Partial derivatives of results by arguments, where the values of all arguments are known."""
        return self.derived([(self.item(*result), argument) for result, argument in pairs], point)

    def derived(self, pairs: Sequence[tuple[OpaqueItem, int]], point: Sequence[float]) -> list[float]:
        """Partial derivatives of what the FMU gives by arguments."""
        t = point[0]
        states = [(k, point[a]) for k, (a, _) in enumerate(self.opaque.states)]
        inputs = [(k, point[a]) for k, (a, *_) in enumerate(self.opaque.inputs)]
        columns: dict[int, list[int]] = {}
        for number, (_, argument) in enumerate(pairs):
            columns.setdefault(argument, []).append(number)
        partials = [math.nan] * len(pairs)
        items = [item for item, _ in pairs]
        if not self.set_point(t, states, inputs):
            return partials
        exact = self.interface.directional and self.is_reliable is not False
        if exact:
            self._directional(columns, items, partials)
        missing = {a: [k for k in numbers if math.isnan(partials[k])] for a, numbers in columns.items()}
        if exact and self.is_reliable is None:
            check = list(partials)
            self._differences(columns, items, check, point, states, inputs)
            sizes = [max(abs(a), abs(b)) for a, b in zip(partials, check, strict=True) if a == a and b == b]
            largest = max(sizes, default=0.0)
            apart = (
                abs(a - b) > _AGREES * max(abs(a), abs(b)) + 1e-5 * largest
                for a, b in zip(partials, check, strict=True)
                if a == a and b == b
            )
            self.is_reliable = not any(apart)
            if not self.is_reliable:
                message = "its directional derivatives differ from finite differences; blocks uses the latter."
                self.one.warn(message)
                return check
        if any(missing.values()):
            self._differences({a: k for a, k in missing.items() if k}, items, partials, point, states, inputs)
        return partials

    def has_directional(self, item: OpaqueItem) -> bool:
        """Whether the FMU may be asked for directional derivatives of it: outputs and derivatives, not other locals."""
        if item.kind != "value" or item.variable is None or item.variable.causality == "output":
            return True
        rates = (unknown.variable.reference for unknown in self.foreign.description.structure.derivatives)
        return item.variable.reference in rates

    def exact(self, pairs: Sequence[tuple[tuple[str, int], int]], point: Sequence[float]) -> list[float]:
        """As `partials`, by directional derivatives alone; NaN where the FMU gives none."""
        columns: dict[int, list[int]] = {}
        for number, (_, argument) in enumerate(pairs):
            columns.setdefault(argument, []).append(number)
        partials = [math.nan] * len(pairs)
        states = [(k, point[a]) for k, (a, _) in enumerate(self.opaque.states)]
        inputs = [(k, point[a]) for k, (a, *_) in enumerate(self.opaque.inputs)]
        if self.set_point(point[0], states, inputs):
            self._directional(columns, [self.item(*result) for result, _ in pairs], partials)
        return partials

    def item(self, key: str, element: int) -> OpaqueItem:
        node = self.tape.nodes[self.tape.results[key].nodes[element]]
        if node.op == "argument":
            return OpaqueItem("given", int(node.value))
        return self.opaque.items[int(node.value)]

    def _directional(
        self, columns: Mapping[int, list[int]], items: Sequence[OpaqueItem], partials: list[float]
    ) -> None:
        """By the FMU's own directional derivatives; what it has none of stays NaN."""
        for argument, numbers in columns.items():
            known = self._seed(argument)
            wanted: dict[int, tuple[ModelVariable, int]] = {}
            for k in numbers:
                if items[k].kind == "given":
                    partials[k] = float(items[k].index == argument)
                variable, element = self._variable(items[k])
                if variable is not None and variable.type == "Float64" and self.has_directional(items[k]):
                    wanted[k] = variable, element
            if not wanted or known is None:
                continue
            variable_in, element_in, scale_in = known
            distinct = {id(variable): variable for variable, _ in wanted.values()}
            sizes = [math.prod(variable.shape) for variable in distinct.values()]
            seed = [0.0] * math.prod(variable_in.shape)
            seed[element_in] = 1.0
            out = self.one.directional(list(distinct.values()), [variable_in], seed)
            if out is None:
                continue
            begins = dict(zip(distinct, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))
            for k, (variable, element) in wanted.items():
                partials[k] = out[begins[id(variable)] + element] * items[k].scale / scale_in

    def _variable(self, item: OpaqueItem) -> tuple[ModelVariable | None, int]:
        """Return the variable of an item, and which of its elements it is."""
        structure, first = self.foreign.description.structure, 0
        unknowns: list[tuple[ModelVariable, tuple[int, ...]]] = []
        if item.kind == "derivative":
            pairs = zip(structure.derivatives, structure.states, strict=True)
            unknowns = [(unknown.variable, state.shape) for unknown, state in pairs]
        elif item.kind == "indicator":  # of FMI 2 only their number is known
            unknowns = [(unknown.variable, unknown.variable.shape) for unknown in structure.indicators]
        for variable, shape in unknowns:
            if item.index < first + math.prod(shape):
                return variable, item.index - first
            first += math.prod(shape)
        return item.variable, item.index

    def _seed(self, argument: int) -> tuple[ModelVariable, int, float] | None:
        """The variable behind an argument that is derived by, its element, and its scale."""
        for place, variable, element, scale in self.opaque.inputs:
            if place == argument:
                return (variable, element, scale) if variable.type == "Float64" else None
        first = 0
        for variable in self.foreign.description.structure.states:
            for element in range(math.prod(variable.shape)):
                place, scale = self.opaque.states[first]
                if place == argument:
                    return variable, element, scale
                first += 1
        return None

    def _differences(
        self,
        columns: Mapping[int, list[int]],
        items: Sequence[OpaqueItem],
        partials: list[float],
        point: Sequence[float],
        states: list[tuple[int, float]],
        inputs: list[tuple[int, float]],
    ) -> None:
        """Quotients of differences, of several columns at once where no result needs two of them."""
        t = point[0]
        wanted = sorted({k for numbers in columns.values() for k in numbers})
        distinct = list(dict.fromkeys(items[k] for k in wanted))
        place = {item: n for n, item in enumerate(distinct)}
        self.set_point(t, states, inputs)
        base = self.read(distinct, point[1:])
        nominal = {a: size for (a, _), size in zip(self.opaque.states, self.part.nominal, strict=True)}
        for arguments in apart({a: {place[items[k]] for k in numbers} for a, numbers in columns.items()}):
            for sign in (1.0, -1.0):
                moved = list(point)
                for a in arguments:
                    moved[a] += sign * _ROOT * max(abs(point[a]), nominal.get(a, 1.0))
                near = [(k, moved[a]) for k, (a, _) in enumerate(self.opaque.states)]
                fine = self.set_point(t, near, [(k, moved[a]) for k, (a, *_) in enumerate(self.opaque.inputs)])
                there = self.read(distinct, moved[1:]) if fine else (math.nan,) * len(distinct)
                is_whole = True
                for a in arguments:
                    for k in columns[a]:
                        n = place[items[k]]
                        partials[k] = (there[n] - base[n]) / (moved[a] - point[a])
                        is_whole = is_whole and math.isfinite(partials[k])
                if is_whole:
                    break
        self.set_point(t, states, inputs)
