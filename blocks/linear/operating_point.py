"""Operating points: where a diagram rests, found by exact derivatives, or as it stands in a run.

The unknowns are the states, the discretes and held outputs, and those inputs that are not given; wanted are rates of 0
(or given rates), updates at ticks that change nothing, and the outputs that are given. A least-squares search with
bounds [1] goes from a first guess to where all residuals are 0; what remains is reported block by block.

References: [1] M. A. Branch, T. F. Coleman, Y. Li, A Subspace, Interior, and Conjugate Gradient Method for Large-Scale
Bound-Constrained Minimization Problems, SIAM Journal on Scientific Computing 21(1), 1999 (scipy's "trf").
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..compile.jacobian import PlanJacobian
from ..compile.plan import Plan, Reference
from ..host.ipython_errors import UnknownName
from ..text import units
from ..text.arrays import Array
from ..text.element_names import indexed
from ..text.errors import AnalysisError, Fault, UsageError, did_you_mean
from ..text.printable import quoted
from ..text.rich_output import Part, Shown, Table
from .point import Point

RESIDUAL = 1e-8
"""How large a residual may be, of its nominal size, at an operating point."""


@dataclass(frozen=True, slots=True)
class Free:
    """A quantity to be found: where to begin (None: where it starts), and its bounds."""

    guess: float | None = None
    min: float = -math.inf
    max: float = math.inf


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number at an operating point, in SI. role: "known", "free", "at its bound", "computed".

    rate: of a state, its derivative; of a discrete, the change at its next tick. wanted: what that was to be, None
    where it may be anything.
    """

    name: str
    value: float
    unit: str
    role: str
    rate: float | None = None
    wanted: float | None = None


@dataclass(frozen=True, repr=False)
class OperatingPoint(Shown):
    """Where a diagram stands: inputs, states and outputs by name, in SI, with what remains of the search.

    point: the memory of the plan there, for `linearize(at=...)`; None where FMUs of Co-Simulation hide theirs.
    """

    name: str
    t: float
    inputs: tuple[Quantity, ...]
    states: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    point: Point | None = field(default=None, repr=False)

    def __getitem__(self, name: str) -> float:
        for quantity in (*self.inputs, *self.states, *self.outputs):
            if quantity.name == name:
                return quantity.value
        known = list(dict.fromkeys(quantity.name for quantity in (*self.inputs, *self.states, *self.outputs)))
        more = ", ..." if len(known) > 20 else ""
        cure = f"Known: {', '.join(known[:20])}{more}." if known else "The operating point has no quantities."
        near = did_you_mean(name[:200], known)
        raise UnknownName(f"there is no quantity {quoted(name)}. {near}{' ' if near else ''}{cure}")

    @property
    def residuals(self) -> dict[str, float]:
        """By block, the largest difference between a rate and what it was to be."""
        residuals: dict[str, float] = {}
        for quantity in self.states:
            if quantity.rate is not None and quantity.wanted is not None:
                block = quantity.name.rpartition(".")[0]
                residuals[block] = max(residuals.get(block, 0.0), abs(quantity.rate - quantity.wanted))
        return residuals

    def parts(self) -> Iterator[Part]:
        yield f"operating point of {self.name} at t = {self.t:g} s"
        rows = [("", "name", "value", "unit", "", "rate")]
        for title, quantities in (("input", self.inputs), ("state", self.states), ("output", self.outputs)):
            for q in quantities:
                rate = "" if q.rate is None else f"{q.rate:.3g}" + (" (any)" if q.wanted is None else "")
                rows.append((title, q.name, f"{q.value:.8g}", q.unit or "-", q.role, rate))
        yield Table(rows)

    def __str__(self) -> str:
        rows = [f"operating point of {self.name} at t = {self.t:g} s"]
        for title, quantities in (("inputs", self.inputs), ("states", self.states), ("outputs", self.outputs)):
            if quantities:
                rows.append(f"  {title}")
            width = max((len(q.name) for q in quantities), default=0)
            for q in quantities:
                rate = "" if q.rate is None else f"   rate {q.rate:.3g}"
                free = "" if q.rate is None or q.wanted is not None else " (any)"
                rows.append(f"    {q.name:<{width}}  {q.value:>14.8g} {q.unit:<8} {q.role}{rate}{free}")
        return "\n".join(rows)


def standing(point: Point, outputs: Sequence[str] = ()) -> OperatingPoint:
    """A point as it is, with the rates there."""
    return _told(point, _Equations(point, (), ()).rates(point), {}, {}, outputs)


def rates_at(point: Point) -> tuple[Array, list[int]]:
    """The derivatives of the states, then the changes of discretes at their next tick; the places of the latter."""
    equations = _Equations(point, (), ())
    return equations.rates(point), equations.slots


def search(
    point: Point,
    *,
    inputs: Mapping[str, object] | None = None,
    states: Mapping[str, object] | None = None,
    outputs: Mapping[str, object] | None = None,
    steady: bool | Mapping[str, float | None] = True,
    told: Sequence[str] = (),
    check: Callable[[], None] | None = None,
) -> OperatingPoint:
    """The operating point near a first one.

    inputs, states, outputs: by name (also by element, "z[0]") a number in SI: known; None, (low, high) or a `Free`: to
    be found. Inputs that are not named stay as they are, states are free. steady: which states rest: True: all; or by
    name the wanted rate, or None for any, all others 0; False: none. Unless it is False, delayed values are those that
    are there now, as after a long rest. Raises AnalysisError (E702) with what remains, or where something keeps a past
    that no search finds. told: further outputs of the point. check: called for each guess; what it raises ends the
    search.
    """
    rates = {} if isinstance(steady, bool) else steady
    for word, table in (("inputs", inputs), ("states", states), ("outputs", outputs), ("steady", rates)):
        if table is not None and not isinstance(table, Mapping):
            cure = f"Write {word}={{name: value}}."
            raise UsageError(Fault("E501", word, f"must be a mapping, not {quoted(repr(table)[:80])}.", cure))
    return _Search(point, inputs or {}, states or {}, outputs or {}, steady, told, check).found()


class _Equations:
    """Rates, updates and outputs of a plan, with their exact derivatives."""

    def __init__(self, point: Point, wanted: Sequence[Reference], by: Sequence[Reference]) -> None:
        plan, self.by = point.plan, tuple(by)
        self.plan = plan
        sampled = {slot: node for rate in plan.rates for node, slot in (*rate.outputs, *rate.nexts)}
        self.slots = sorted(sampled)
        self.wanted = list(wanted)
        of: list[Any] = [*plan.derivatives, *(sampled[slot] for slot in self.slots)]
        # What is asked for may itself be one of the unknowns.
        self.direct = [reference in self.by or reference.row in "xdukh" for reference in self.wanted]
        of += [r for r, is_direct in zip(self.wanted, self.direct, strict=True) if not is_direct]
        self.jacobian = PlanJacobian(plan, of, self.by) if by else None
        self.program = point.engine.compiled.program("operating", [*of])

    def rates(self, point: Point) -> Array:
        """dx/dt, then the changes of discretes at their next tick."""
        values = np.array(self.program(*point.memory), dtype=float)
        n = len(self.plan.states)
        rates = values[: n + len(self.slots)].copy()
        rates[n:] -= np.array([point.memory[2][slot] for slot in self.slots])
        for i, node in enumerate(self.plan.derivatives):
            side = self.plan.instances[node.instance].condition
            if side is not None and not point.memory[3][side]:
                rates[i] = 0.0
        return rates

    def slopes(self, point: Point) -> Array:
        """The derivatives of the rates, the changes and the outputs by the unknowns; NaN where there is none."""
        assert self.jacobian is not None
        slopes = self.jacobian.at(point.memory, point.values(self.jacobian.outputs)).dense()
        n = len(self.plan.states)
        for k, slot in enumerate(self.slots):
            if Reference("d", slot) in self.by:
                slopes[n + k, self.by.index(Reference("d", slot))] -= 1.0
        rows, k = [slopes[: n + len(self.slots)]], n + len(self.slots)
        for reference, is_direct in zip(self.wanted, self.direct, strict=True):
            if is_direct:
                rows.append(np.array([[float(reference == other) for other in self.by]]))
            else:
                rows.append(slopes[k : k + 1])
                k += 1
        return np.vstack(rows)


class _Search:
    def __init__(
        self,
        point: Point,
        inputs: Mapping[str, object],
        states: Mapping[str, object],
        outputs: Mapping[str, object],
        steady: bool | Mapping[str, float | None],
        told: Sequence[str],
        check: Callable[[], None] | None,
    ) -> None:
        self.check = check
        plan = self.plan = point.plan
        self.told = list(dict.fromkeys([*outputs, *told]))
        self.point = point
        _refuse(plan)
        places = _input_names(plan)
        given = _spread(inputs, places, "input")
        known_states = {name: Reference("x", i) for i, name in enumerate(plan.states)}
        known_states |= {name: Reference("d", i) for i, name in enumerate(plan.discretes)}
        given_states = _spread(states, known_states, "state")
        self.known: dict[Reference, float] = {}
        self.free: dict[Reference, Free] = {}
        for table, names in ((given, places), (given_states, known_states)):
            for name, value in table.items():
                number_or_free = _as_free(name, value)
                if isinstance(number_or_free, Free):
                    self.free[names[name]] = number_or_free
                else:
                    self.known[names[name]] = number_or_free
        self.moving = _moving(plan)
        for reference in self.moving:
            if reference not in self.known:
                self.free.setdefault(reference, Free())
        self.outputs: dict[str, Reference] = {}
        self.targets: list[tuple[float, float]] = []
        self._ask(outputs)
        self.wanted = self._wanted(steady, known_states)
        self.delayed = range(len(plan.histories)) if steady is not False else range(0)
        self.free |= {Reference("h", k): Free() for k in self.delayed}
        self.unknown = list(self.free)
        sources = [plan.histories[k].source for k in self.delayed]
        self.equations = _Equations(point, [*self.outputs.values(), *sources], self.unknown)
        self.scale = self._scales()
        # States of tiny nominal size make rows and columns that Newton's method takes for 0 beside the others.
        others = len(self.equations.slots) + len(self.targets) + len(self.delayed)
        self.rows = np.array([*plan.nominal, *[1.0] * others])
        self.columns = np.array([plan.nominal[index] if row == "x" else 1.0 for row, index in self.unknown])
        self.periods = {
            slot: min(1.0, float(rate.period * plan.base))
            for rate in plan.rates
            for _, slot in (*rate.outputs, *rate.nexts)
        }

    def _ask(self, outputs: Mapping[str, object]) -> None:
        """Read what is wanted of outputs: where each element is, and its limits."""
        for name, value in outputs.items():
            elements = _signal(self.plan, name)
            for (label, reference), each in zip(elements, _each(name, value, len(elements)), strict=True):
                target = _as_free(label, each)
                low, high = (target.min, target.max) if isinstance(target, Free) else (target, target)
                if reference.row == "k":
                    raise UsageError(Fault("E501", label, "is a constant, so that no other value can be required."))
                self.outputs[label] = reference
                self.targets.append((low, high))

    def _wanted(
        self, steady: bool | Mapping[str, float | None], names: Mapping[str, Reference]
    ) -> dict[Reference, float | None]:
        """The wanted rate of each state and discrete; None: any."""
        if isinstance(steady, bool):
            return dict.fromkeys(self.moving, 0.0 if steady else None)
        rates: dict[Reference, float | None] = dict.fromkeys(self.moving, 0.0)
        for name, value in _spread(steady, names, "state").items():
            rates[names[name]] = None if value is None else _rate(name, value)
        return rates

    def _scales(self) -> Array:
        scales = []
        for reference in self.unknown:
            nominal = self.plan.nominal[reference.index] if reference.row == "x" else 1.0
            scales.append(max(nominal, 1e-3 * abs(self.point.values([reference])[0])))
        return np.array(scales)

    def at(self, values: Array) -> Point:
        """The point with the unknowns at these values."""
        _, x, d, _, _, u, _, h, *_ = self.point.memory
        rows = {"x": list(x), "d": list(d), "u": list(u), "h": list(h)}
        for (row, index), value in (*self.known.items(), *zip(self.unknown, values.tolist(), strict=True)):
            rows[row][index] = value
        return self.point.moved(**rows)

    def residual(self, values: Array) -> Array:
        if self.check is not None:
            self.check()
        point = self.at(values)
        rates = self.equations.rates(point)
        terms = []
        for rate, reference in zip(rates, self.moving, strict=True):
            wanted = self.wanted.get(reference)
            terms.append(0.0 if wanted is None else rate - wanted)
        for value, (low, high) in zip(point.values(list(self.outputs.values())), self.targets, strict=True):
            terms.append(min(0.0, value - low) + max(0.0, value - high))
        sources = point.values([self.plan.histories[k].source for k in self.delayed])
        terms += [value - point.memory[7][k] for k, value in zip(self.delayed, sources, strict=True)]
        residuals = np.array(terms)
        return np.where(np.isfinite(residuals), residuals, 1e150)

    def _scaled(self, values: Array) -> Array:
        return np.asarray(np.clip(self.residual(values) / self.rows, -1e150, 1e150))

    def slopes(self, values: Array) -> Array:
        point = self.at(values)
        slopes = self.equations.slopes(point)
        for k, reference in enumerate(self.moving):
            if self.wanted.get(reference) is None:
                slopes[k] = 0.0
        for n, k in enumerate(self.delayed, len(slopes) - len(self.delayed)):
            slopes[n, self.unknown.index(Reference("h", k))] -= 1.0
        count = len(slopes) - len(self.targets) - len(self.delayed)
        for k, (value, (low, high)) in enumerate(
            zip(point.values(list(self.outputs.values())), self.targets, strict=True)
        ):
            if low < value < high:
                slopes[count + k] = 0.0
        bad = ~np.isfinite(slopes)
        if bad.any():  # an infinite slope: a difference over a step that matters
            base = self.residual(values)
            for j in np.nonzero(bad.any(axis=0))[0].tolist():
                moved = values.copy()
                moved[j] += 1e-7 * self.scale[j]
                quotient = (self.residual(moved) - base) / (moved[j] - values[j])
                slopes[bad[:, j], j] = quotient[bad[:, j]]
        return np.where(np.isfinite(slopes), slopes, 0.0)

    def found(self) -> OperatingPoint:
        from scipy.optimize import least_squares

        low = np.array([self.free[r].min for r in self.unknown])
        high = np.array([self.free[r].max for r in self.unknown])
        begin = []
        for reference in self.unknown:
            guess = self.free[reference].guess
            begin.append(self.point.values([reference])[0] if guess is None else guess)
        begin = np.clip(np.array(begin, dtype=float), low, high)
        values = begin
        if len(self.unknown) and len(self.residual(begin)):
            inside = begin.copy()
            bounded = np.isfinite(low) & np.isfinite(high)
            inside[bounded] = 0.5 * low[bounded] + 0.5 * high[bounded]
            starts = [begin, begin + 0.1 * self.scale, inside]
            best = math.inf
            for start in starts:
                solution = self._solved(least_squares, np.clip(start, low, high), low, high)
                size = float(np.max(np.abs(self._relative(solution)), initial=0.0))
                if size < best:
                    best, values = size, solution
                if best <= RESIDUAL:
                    break
        remains = self._relative(values)
        if np.max(np.abs(remains), initial=0.0) > RESIDUAL:
            self._fail(values, remains)
        self._check_events(self.at(values))
        return self._result(values, low, high)

    def _check_events(self, point: Point) -> None:
        """Raise AnalysisError (E702) where an FMU would have an event on the way, which only a run can handle."""
        for part in self.plan.foreign:
            for j in part.crossings:
                if point.memory[3][j] != self.point.memory[3][j]:
                    message = (
                        "the FMU has an event between the start and the end of the search, which a search "
                        "cannot handle."
                    )
                    cure = "Start from the state of a run with these inputs: at=TIME."
                    raise AnalysisError(Fault("E702", part.path, message, cure))

    def _solved(self, least_squares: Any, start: Array, low: Array, high: Array) -> Array:
        """A search with bounds, then Newton's method."""
        from scipy.optimize import lsq_linear

        with np.errstate(all="ignore"):
            width = high - low
            tight = width <= 0
            room = np.where(tight, 1e-12 * (1 + np.abs(low)), 0.0)
            fit = least_squares(
                self._scaled, start, jac=lambda x: self.slopes(x) / self.rows[:, None],
                bounds=(low - room, high + room), x_scale=self.scale, xtol=1e-15, ftol=1e-15, gtol=1e-15,
                max_nfev=400,
            )  # fmt: skip
            values = np.clip(fit.x, low, high)
            size = float(np.max(np.abs(self._relative(values)), initial=0.0))
            for _ in range(60):
                slopes, residual = self.slopes(values) / self.rows[:, None] * self.columns, self._scaled(values)
                step = self.columns * np.linalg.lstsq(slopes, -residual, rcond=None)[0]
                moved = np.clip(values + step, low, high)
                if np.any(moved != values + step):  # the best step within the bounds
                    away = (low - room - values) / self.columns, (high + room - values) / self.columns
                    best = lsq_linear(slopes, -residual, away, "bvls").x
                    moved = np.clip(values + self.columns * best, low, high)
                now = float(np.max(np.abs(self._relative(moved)), initial=0.0))
                if not now < size:
                    break
                values, size = moved, now
        return np.asarray(values, dtype=float)

    def _relative(self, values: Array) -> Array:
        """Residuals relative to their nominal size."""
        residuals = self.residual(values)
        sizes = list(self.plan.nominal)
        if sizes and self.unknown:  # the terms of a rate leave a rounding error
            parts = np.abs(self.slopes(values)[: len(sizes)]) @ np.maximum(np.abs(values), self.columns)
            sizes = np.maximum(sizes, 1e-6 * parts).tolist()
        held = dict(zip(self.unknown, np.abs(values).tolist(), strict=True))
        # A change from tick to tick counts as a rate, down to the rounding error of one.
        sizes += [max(self.periods[slot], 1e-6 * held.get(Reference("d", slot), 0.0)) for slot in self.equations.slots]
        sizes += [max(1.0, *(abs(x) for x in target if math.isfinite(x))) if any(map(math.isfinite, target)) else 1.0
                  for target in self.targets]  # fmt: skip
        sizes += [1.0] * len(self.delayed)
        return np.asarray(residuals / np.array(sizes))

    def _fail(self, values: Array, remains: Array) -> None:
        names = [*self.plan.states, *(self.plan.discretes[slot] for slot in self.equations.slots), *self.outputs]
        missed = len(names) - len(self.outputs)
        names += [self.plan.histories[k].name for k in self.delayed]
        worst = np.argsort(-np.abs(remains))[:5]
        residual = self.residual(values)
        faults = []
        for k in worst.tolist():
            if abs(remains[k]) <= RESIDUAL:
                continue
            is_output = k >= missed
            what = (
                "its value differs from the required value by"
                if is_output
                else "its rate differs from the required rate by"
            )
            unit = self._unit(names[k], is_rate=not is_output and k < len(self.plan.states))
            faults.append(Fault("E702", names[k], f"no operating point was found: {what} {residual[k]:.3g}{unit}."))
        cure = "Leave an input free (inputs={name: None}), let a state move (steady={name: None}), or start elsewhere: "
        cure += "Free(guess=...), at=."
        faults[-1] = Fault("E702", faults[-1].place, faults[-1].message, cure)
        raise AnalysisError(*faults)

    def _unit(self, name: str, *, is_rate: bool) -> str:
        unit = self.plan.signals[name].unit if name in self.plan.signals else ""
        return f" ({units.quotient(unit, 's') if is_rate else unit})" if unit else ""

    def _result(self, values: Array, low: Array, high: Array) -> OperatingPoint:
        point = self.at(values)
        at_bound = {
            reference
            for reference, value, a, b in zip(self.unknown, values.tolist(), low.tolist(), high.tolist(), strict=True)
            if value in (a, b)
        }
        roles = {reference: "at its bound" if reference in at_bound else "free" for reference in self.unknown}
        roles.update(dict.fromkeys(self.known, "known"))
        return _told(point, self.equations.rates(point), roles, self.wanted, self.told)


def _moving(plan: Plan) -> list[Reference]:
    """The states, then the discretes that ticks change, in the order of their places."""
    slots = sorted({slot for rate in plan.rates for _, slot in (*rate.outputs, *rate.nexts)})
    return [*(Reference("x", i) for i in range(len(plan.states))), *(Reference("d", slot) for slot in slots)]


def _refuse(plan: Plan) -> None:
    """Raise AnalysisError (E702) for programs and for what each step replaces over time, which depend on the past."""
    for part in plan.steppers:
        cure = "Use the state of a run: operating_points, or at=."
        raise AnalysisError(
            Fault("E702", part.path, "is a program, and a search cannot find the values in its memory.", cure)
        )
    for node, (_, place) in plan.projections:
        instance = plan.instances[node.instance]
        reads = {instance.tape.arguments[k].kind for k in instance.tape.read_by[node.key][node.element]}
        if "time" in reads:
            message = (
                f"changes with each step ({plan.discretes[place]}), so that a search cannot find its point of rest."
            )
            cure = "Use the state of a run: operating_points, or at=."
            raise AnalysisError(Fault("E702", instance.path, message, cure))


def _told(
    point: Point,
    rates: Array,
    roles: Mapping[Reference, str],
    wanted: Mapping[Reference, float | None],
    outputs: Sequence[str],
) -> OperatingPoint:
    plan = point.plan
    units = _units_of(plan)

    def quantity(name: str, at: Reference, role: str, *rate: float | None) -> Quantity:
        return Quantity(name, point.values([at])[0], units.get(at, ""), role, *rate)

    inputs = [quantity(name, at, roles.get(at, "known")) for name, at in _input_names(plan).items()]
    states = []
    for at, rate in zip(_moving(plan), rates.tolist(), strict=True):
        name = (plan.states if at.row == "x" else plan.discretes)[at.index]
        states.append(quantity(name, at, roles.get(at, "computed"), rate, wanted.get(at)))
    shown = [quantity(label, at, "computed") for name in outputs for label, at in _signal(plan, name)]
    return OperatingPoint(plan.name, point.t, tuple(inputs), tuple(states), tuple(shown), point)


def _units_of(plan: Plan) -> dict[Reference, str]:
    unit_of: dict[Reference, str] = {}
    for name in plan.signals:
        signal = plan.signals[name]
        for reference, unit in zip(signal.references, signal.units, strict=True):
            unit_of.setdefault(reference, unit)
    return unit_of


def declared_unit(plan: Plan, name: str) -> str:
    """Return the unit in which plain numbers about a signal or a state are meant; "" if it is not known."""
    base, index = indexed(name)
    if name in plan.signals:
        return plan.signals[name].declared_unit
    if base in plan.signals:
        declared = plan.signals[base].declared
        return declared[index] if index is not None and index < len(declared) else ""
    path, _, variable = base.rpartition(".")  # a state that is no output
    for instance in plan.instances:
        if instance.path == path and (units := instance.tape.interface.memory_units(variable)):
            return units[index or 0]
    return ""


def _input_names(plan: Plan) -> dict[str, Reference]:
    references: dict[str, Reference] = {}
    first = 0
    for name, shape, *_ in plan.inputs:
        size = math.prod(shape)
        for e in range(size):
            references[name if shape == () else f"{name}[{e}]"] = Reference("u", first + e)
        first += size
    return references


def _spread(given: Mapping[str, object], known: Mapping[str, Reference], what: str) -> dict[str, object]:
    """By element; a vector may be given as a whole. Raises UsageError (E501)."""
    values: dict[str, object] = {}
    for name, value in given.items():
        if name in known:
            values[name] = value
            continue
        elements = [label for label in known if label.startswith(f"{name}[")]
        if not elements:
            cure = did_you_mean(name[:200], known) or f"Known: {', '.join(list(known)[:20]) or 'none'}."
            raise UsageError(Fault("E501", quoted(name[:200]), f"there is no {what} of this name.", cure))
        values.update(zip(elements, _each(name, value, len(elements)), strict=True))
    return values


def _each(name: str, value: object, count: int) -> list[object]:
    """A value for each element of a signal. Raises UsageError (E501)."""
    if not isinstance(value, (list, np.ndarray)):
        return [value] * count
    if len(value) != count:
        raise UsageError(Fault("E501", name, f"has {count} elements, but {len(value)} values were given."))
    return list(value)


def _rate(name: str, value: object) -> float:
    """A rate that was given. Raises UsageError (E501)."""
    if isinstance(value, (int, float, np.integer, np.floating)) and math.isfinite(value):
        return float(value)
    message = f"{quoted(str(value)[:80])} is not a rate."
    raise UsageError(Fault("E501", name, message, "Give a number per second, or None for any."))


def _as_free(name: str, value: object) -> float | Free:
    """What was given for a quantity. Raises UsageError (E501)."""
    if value is None:
        return Free()
    if isinstance(value, Free):
        free = value
    elif isinstance(value, tuple) and len(value) == 2:
        free = Free(None, *(float(bound) for bound in value))
    elif isinstance(value, (int, float, np.integer, np.floating)) and math.isfinite(value):
        return float(value)
    else:
        cure = "Give a number, None, (low, high) or Free(guess, min, max)."
        raise UsageError(Fault("E501", name, f"{quoted(str(value)[:80])} is not a value for this quantity.", cure))
    if not free.min <= free.max:
        raise UsageError(Fault("E501", name, f"the lower bound {free.min} lies above the upper bound {free.max}."))
    return free


def _signal(plan: Plan, name: str) -> list[tuple[str, Reference]]:
    if name in plan.signals:
        references = plan.signals[name].references
        if len(references) == 1:
            return [(name, references[0])]
        return [(f"{name}[{k}]", reference) for k, reference in enumerate(references)]
    base, _, index = name.rpartition("[")
    if base in plan.signals and index[:-1].isdigit() and int(index[:-1]) < len(plan.signals[base].references):
        return [(name, plan.signals[base].references[int(index[:-1])])]
    cure = did_you_mean(name[:200], plan.signals)
    raise UsageError(Fault("E501", quoted(name[:200]), "there is no such signal.", cure))
