"""Laws of a diagram: equations that are not linear in what they read, as functions that can be studied alone.

    law = StaticLaw(slopes, node, slots)
    law(values)                      # of the equation, with each of `slots` in turn replaced by an array
    law.described(amplitude)         # what stands for it in a quasi-linear model

A law of one signal has a describing function: in closed form where there is one, by quadrature else. Its sides are
those of its crossings at each value; a law with memory (a relay with hysteresis, the level of a quantizer, the position
of a backlash) is known by what its class declares.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from itertools import product
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ..compile.fmu_tape import FmuTape
from ..compile.jacobian import on_arrays
from ..contract.scalars import BENDS
from ..frequency import quadrature
from ..frequency.law_corners import PLACE, breaks_of
from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault
from .interconnection import Interconnection
from .slopes import Slopes
from .thresholds import evident

_BENT: WeakKeyDictionary[Interconnection, dict[int, dict[int, frozenset[int]]]] = WeakKeyDictionary()
_GAINS: WeakKeyDictionary[Interconnection, dict[object, complex]] = WeakKeyDictionary()
_MANY = 4096
"""Gains that are kept of one graph."""
_EPS = float(np.finfo(float).eps)
_STEEP = frozenset({"pow", "sqrt", "asin", "acos", "atanh"})
"""Operations that may have an infinite slope where they do not jump."""
_STEP, _CLOSEST, _GROWS = 1e-3, 1e-6, 1.02
"""Of the distance from a singular point: the step of differences, and how near to it a slope is looked at, which has to
be larger by _GROWS than a thousand times as far."""
_NEXT, _FEW = 1e-9, 4
"""How far from a value both its sides are evaluated, and for how many signals at once."""


class StaticLaw:
    """A node as a function of some of its slots, where all else stays as it is at the point.

    node: its number. slots: those of its signals that change. inputs: what they are at the point.
    """

    def __init__(self, slopes: Slopes, node: int, slots: Sequence[int]) -> None:
        graph: Interconnection = slopes.graph
        self.graph, self.slopes, self.node, self.slots = graph, slopes, node, tuple(slots)
        instance, key, element = graph.nodes[node]
        self.instance, self.row = instance, (key, element)
        self.group, self.member = graph.group_of[instance]
        self.type = self.group.type
        self.name = graph.node_name(node)
        first = int(graph.slot_first[instance])
        self.arguments = [self.type.slots[slot - first] for slot in self.slots]
        self.base = list(slopes.everything[self.group.gather[:, self.member]])
        self.inputs = tuple(float(self.base[k]) for k in self.arguments)
        self._scanned: tuple[float, float, Sequence[float]] | None = None

    @property
    def path(self) -> str:
        return self.graph.plan.instances[self.instance].path

    def _values(
        self, wanted: Sequence[int], inputs: Sequence[object], sides: dict[int, Any] | None = None
    ) -> list[Any]:
        arguments = list(self.base)
        for k, value in zip(self.arguments, inputs, strict=True):
            arguments[k] = value
        for k, node in self._static:
            arguments[k] = on_arrays(self.type.tape, [node], arguments, self.group.tables)[0]
        for k, value in (sides or {}).items():
            arguments[k] = value
        return on_arrays(self.type.tape, wanted, arguments, self.group.tables)

    @cached_property
    def _static(self) -> list[tuple[int, int]]:
        """The discretes that change on the way, with the nodes that they follow."""
        tape, own = self.type.tape, set(self.arguments)
        return [(k, node) for k, node in self.type.static.items() if own & set(tape.arguments_of(node))]

    @cached_property
    def _crossings(self) -> list[tuple[int, int]]:
        """The sides that change on the way: the argument, and the node of the crossing."""
        tape, crossings = self.type.tape, []
        for side in self.type.sides_of[self.row]:
            reads = self.type.crossing_reads(side)
            if set(reads) & set(self.arguments):
                crossings.append((side, tape.results[f"crossing:{tape.arguments[side].name}"].nodes[0]))
        return crossings

    def __call__(self, *inputs: Any) -> Array:
        """Values of the equation, one for each of the arrays' elements."""
        sides = {}
        if self._crossings:
            values = self._values([node for _, node in self._crossings], inputs)
            sides = {side: (value >= 0) * 1.0 for (side, _), value in zip(self._crossings, values, strict=True)}
        outputs = self._values([self.type.tape.results[self.row[0]].nodes[self.row[1]]], inputs, sides)[0]
        return np.broadcast_to(outputs, np.broadcast_shapes(*(np.shape(value) for value in inputs))).astype(float)

    @cached_property
    def _switches(self) -> list[tuple[str, tuple[int, ...]]]:
        """What may bend the law: the operation, and its operands."""
        tape, switches = self.type.tape, list[tuple[str, tuple[int, ...]]]()
        own = set(self.arguments)
        for n in tape.needed([tape.results[self.row[0]].nodes[self.row[1]]]):
            node = tape.nodes[n]
            operands = node.operands[1:] if node.op == "div" else node.operands
            if node.op == "search" and own & set(tape.arguments_of(n)):
                switches.append(("search", (n,)))
            elif node.op in BENDS and any(own & set(tape.arguments_of(o)) for o in operands):
                switches.append((node.op, node.operands))
        switches += [("crossing", (node,)) for _, node in self._crossings]
        switches += [("search", (node,)) for _, node in self._static]
        return switches

    def switches(self, *inputs: Any) -> Array:
        """What changes its sign where the law bends or jumps: (elements, switches)."""
        shape = np.broadcast_shapes(*(np.shape(value) for value in inputs))
        columns = []
        for op, operands in self._switches:
            values = self._values(operands, inputs)
            if op in ("lt", "le", "eq", "ne", "fmin", "fmax"):
                values = [values[0] - values[1]]
            elif op == "search":  # a number of points that have passed
                values = [np.cos(np.pi * values[0])]
            elif op in ("floor", "ceil"):
                values = [np.sin(np.pi * values[0])]
            elif op == "fmod":
                values = [np.sin(np.pi * values[0] / values[1])]
            elif op == "div":
                values = values[1:]
            elif op in ("asin", "acos", "atanh"):
                values = [values[0] - 1.0, values[0] + 1.0]
            elif op == "pow":
                values = values[:1]
            columns += [np.broadcast_to(value, shape) for value in values]
        if not columns:
            return np.empty((*shape, 0))
        return np.stack(columns, axis=-1)

    # --- describing functions --------------------------------------------------------------------------------------

    @property
    def remembers(self) -> str:
        """The describing function of a block with memory: "relay", "quantizer", "backlash"; "" for others."""
        return remembers(self.graph, self.node)[0]

    def _parameter(self, name: str) -> float:
        for k, argument in enumerate(self.type.tape.arguments):
            if argument.kind == "parameter" and argument.name == name:
                return float(self.base[k])
        raise KeyError(name)

    def breaks(self, bias: float, reach: float) -> Sequence[float]:
        """Inputs up to `reach` from a bias at which a law of one signal bends or jumps; maybe others farther away."""
        if self._evident is not None:
            return self._evident
        known = self._scanned
        if known is None or bias != known[0] or not 1e-4 * known[1] <= reach <= known[1]:
            far = 30.0 * reach  # they do not depend on the amplitude, and serve for others too
            breaks = breaks_of(self, bias - far, bias + far, self.switches)
            known = self._scanned = (bias, far, breaks)
        return known[2]

    @cached_property
    def _evident(self) -> tuple[float, ...] | None:
        """All inputs at which a law of one signal bends or jumps, where its operations show them; None: search."""
        if not self._switches:
            return ()
        if len(self.arguments) != 1:
            return None
        return evident(self.type.tape, self._switches, self.arguments[0], self._constant)

    def _constant(self, node: int) -> float:
        """The value of a node of the tape at the point."""
        return float(self._values([node], self.inputs)[0])

    def least(self) -> float:
        """The amplitude above which a law with memory responds at all, at the point; 0 for others."""
        if self.remembers == "backlash":
            return self._parameter("width") / 2.0
        if self.remembers == "relay":
            on_at, off_at = self._parameter("on_at"), self._parameter("off_at")
            return max(on_at - self.inputs[0], self.inputs[0] - off_at, 0.0) if off_at < on_at else 0.0
        return 0.0

    def singular(self) -> tuple[float, float] | None:
        """Find the nearest input at which a law of one signal has an infinite slope, and by how much its slope changes.

        The change: how the slope ten times as far from there differs from that where the law stands, relative to the
        latter. None: there is no such input among those near 0 and near the law's own.
        """
        u = self.inputs[0]
        if self.remembers or not any(op in _STEEP for op, _ in self._switches):
            return None
        for point in sorted(self.breaks(u, max(abs(u), _NEXT)), key=lambda at: abs(u - at)):
            away = u - point
            if not abs(away) * _CLOSEST * _STEP > 4 * _EPS * abs(point):
                continue
            places = point + away * np.array([1.0, 10.0, _CLOSEST**0.5, _CLOSEST])
            ahead = _STEP * (places - point)
            with np.errstate(all="ignore"):
                slopes = (self(places + ahead) - self(places - ahead)) / (2.0 * ahead)
            if np.isfinite(slopes).all() and slopes[0] and abs(slopes[3]) > _GROWS * abs(slopes[2]):
                return float(point), float(slopes[1] / slopes[0] - 1.0)
        return None

    def range_at(self) -> tuple[float, float]:
        """The least and largest value that the law may have where it stands: two of them at a jump."""
        near = [(u - _NEXT * (1.0 + abs(u)), u, u + _NEXT * (1.0 + abs(u))) for u in self.inputs]
        if self.remembers == "relay":
            on_at, off_at, on, off = (self._parameter(name) for name in ("on_at", "off_at", "on", "off"))
            if near[0][0] <= on_at and off_at <= near[0][2]:
                return min(on, off), max(on, off)
        if self.remembers == "backlash":  # it may have been pushed to anywhere within its gap
            half = self._parameter("width") / 2.0
            return self.inputs[0] - half, self.inputs[0] + half
        # Where many signals are at a jump, the extremes are taken to be reached with one of them alone.
        tried = [*product(*near)] if len(near) <= _FEW else []
        tried += [(*self.inputs[:k], u, *self.inputs[k + 1 :]) for k, both in enumerate(near) for u in both]
        values = self(*np.array(tried).T)
        return float(np.min(values)), float(np.max(values))

    def described(self, amplitude: float, bias: float | None = None) -> quadrature.Described:
        """What a law of one signal does to bias + amplitude sin(angle). Raises AnalysisError (E704)."""
        from ..frequency import describing

        bias = self.inputs[0] if bias is None else bias
        with self.named():
            if self.remembers == "relay":
                on_at, off_at, on, off = (self._parameter(name) for name in ("on_at", "off_at", "on", "off"))
                return describing.relay(on_at, off_at, on, off, amplitude, bias)
            if self.remembers == "quantizer":
                return describing.quantizer(self._parameter("interval"), amplitude, bias)
            if self.remembers == "backlash":
                return describing.backlash(self._parameter("width"), amplitude, bias)
            breaks = self.breaks(bias, amplitude)
            return quadrature.sinusoidal(self, amplitude, bias, breaks=breaks)

    def gain(self, size: float, *, is_random: bool = False) -> complex:
        """What `described` or `described_random` give as gain; equal laws at equal values are integrated once."""
        known = _GAINS.setdefault(self.graph, {})
        # Laws of one group differ only in the numbers that they read.
        key = (id(self.group), self.row, *self.arguments, size, is_random, *(self.base[k] for k in self._read))
        if key not in known:
            if len(known) >= _MANY:
                known.clear()
            known[key] = complex((self.described_random(size) if is_random else self.described(size)).gain)
        return known[key]

    @cached_property
    def _read(self) -> list[int]:
        """The arguments that the law can depend on."""
        tape = self.type.tape
        if self.remembers:
            return [k for k, argument in enumerate(tape.arguments) if argument.kind != "table"]
        rows = [self.row, *((f"crossing:{tape.arguments[side].name}", 0) for side in self.type.sides_of[self.row])]
        arguments = {k for key, element in rows if key in tape.results for k in tape.read_by[key][element]}
        return sorted(k for k in arguments if tape.arguments[k].kind != "table")

    def described_random(self, sigma: float) -> quadrature.Described:
        """What a law of one signal does to a Gaussian signal of a deviation. Raises AnalysisError (E704)."""
        from ..frequency import describing

        bias = self.inputs[0]
        with self.named():
            level = self._parameter("on_at") if self.remembers == "relay" else 0.0
            has_hysteresis = self.remembers == "relay" and level != self._parameter("off_at")
            if has_hysteresis or self.remembers == "backlash":
                what = "relay with hysteresis" if has_hysteresis else "backlash"
                message = f"is a {what}, which has no describing function for a random signal."
                cure = "Give an amplitude instead of a sigma, or estimate the response."
                raise AnalysisError(Fault("E704", self.path, message, cure))
            if self.remembers == "relay":
                return describing.gaussian_relay(level, self._parameter("on"), self._parameter("off"), sigma, bias)
            if self.remembers == "quantizer":
                return describing.gaussian_quantizer(self._parameter("interval"), sigma, bias)
            breaks = self.breaks(bias, 40 * sigma)
            return quadrature.gaussian(self, sigma, bias, breaks=breaks)

    @contextmanager
    def named(self) -> Iterator[None]:
        """Report the errors of functions that know only numbers with the name of the law."""
        try:
            yield
        except AnalysisError as error:
            faults = (replace(f, place=self.name) if f.place == PLACE else f for f in error.faults)
            raise AnalysisError(*faults) from None


def remembers(graph: Interconnection, node: int) -> tuple[str, int]:
    """The describing function that a block declares for its output, and the slot of its input; ("", -1) for others."""
    instance, key, _ = graph.nodes[node]
    kind = graph.type_of[instance]
    if not kind.tape.describing or key != "output:y":
        return "", -1
    place = kind.by_fine["input", "u", 0]
    return kind.tape.describing, int(graph.slot_first[instance]) + kind.slot_of[place]


def nonlinear(graph: Interconnection, node: int) -> dict[int, frozenset[int]]:
    """The slots in which a node is not linear, and for each the slots on which its slope by that one depends."""
    known = _BENT.setdefault(graph, {})
    if node not in known:
        known[node] = _bent(graph, node)
    return known[node]


def _bent(graph: Interconnection, node: int) -> dict[int, frozenset[int]]:
    name, slot = remembers(graph, node)
    if name:
        return {slot: frozenset({slot})}
    instance, key, element = graph.nodes[node]
    kind, first = graph.type_of[instance], int(graph.slot_first[instance])
    coupled_slots = {}
    # Where a class says which describing function y has, what it remembers is a part of that.
    if isinstance(kind.tape, FmuTape) or key.startswith("crossing") or kind.tape.describing:
        return {}
    for k in kind.signals((key, element)):
        coupled = kind.coupled((key, element), k)
        if coupled is not None:
            coupled_slots[first + kind.slot_of[k]] = frozenset(first + kind.slot_of[other] for other in coupled)
    return coupled_slots
