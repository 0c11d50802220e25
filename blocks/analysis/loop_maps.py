"""Maps of a loop: its margins, disturbance rejection and noise over two parameters, from matrices alone.

found = loop_map(loop, "control.u", "plant.y", over={"control.omega_c": (1, 30), "control.omega_o": (5, 300)})
found.best("disturbance", Ms=(None, 1.6), noise=(None, 200))
found.plot("Ms", "disturbance", "noise", limits={"Ms": (None, 1.6)})
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from ..api.case import Case, PointWords, takes
from ..api.diagram import Diagram
from ..compile.bindings import bindings
from ..compile.plan import Plan
from ..engines.prepared import Prepared
from ..frequency.many import Channel, Loops, between, grid_of, margins_of
from ..linear.harmonic_balance import Linearizer
from ..linear.point import Point
from ..linear.slopes import read_at
from ..linear.stacked import Stack, stacked
from ..linear.transfer import Transfer
from ..model.resolver import resolver_of
from ..model.values import in_si
from ..results.plots import Look
from ..text.arrays import Array
from ..text.atomic_write import write_atomically
from ..text.errors import AnalysisError, Fault, UsageError, did_you_mean
from ..text.printable import legible
from ..text.rich_output import Shown, Table
from ..text.units import from_si
from .model_text import check_loop

if TYPE_CHECKING:
    from ..results.figure import Figure

MEASURES = {
    "gain": "gain margin", "gain_low": "gain margin below 1", "phase_deg": "phase margin, deg",
    "delay": "delay margin, s", "crossover": "crossover, rad/s", "Ms": "Ms, largest |S|", "Mt": "Mt, largest |T|",
    "disk": "disk margin", "disturbance": "largest |disturbance → output|",
    "noise": "largest |noise → control|", "at_frequency": "|disturbance → output| at the frequency",
}  # fmt: skip
"""The measures of a map by name, with their titles in figures."""
LARGER = frozenset({"gain", "phase_deg", "delay", "disk", "crossover"})
"""Measures of which more is better; of all others less is."""
_MOST = 250_000
_EDGE = 1e-9
_CHECKED = 1e-8
_ROUNDING = 1e-12
"""Of the largest response: what is small beside it, as |S| at low frequencies, is a difference of larger numbers."""
_SHOWN = ("Ms", "phase_deg", "disturbance", "noise")
Limits = Mapping[str, tuple[float | None, float | None]]
Stacks = list[tuple[Array, Stack]]
"""Models of points: their numbers, and the models."""


@dataclass(frozen=True, repr=False)
class LoopMap(Shown):
    """A loop over one or two parameters.

    parameters: their names; values: those of each, in their declared units; units: these. measures: by name, (values of
    the first) or (values of the second, values of the first), nan where there is no stable closed loop. present: what
    the diagram has. frequency: of `at_frequency`, rad/s.
    """

    diagram: str
    control: str
    output: str
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    values: tuple[Array, ...]
    measures: Mapping[str, Array]
    present: tuple[float, ...]
    frequency: float | None

    def feasible(self, **limits: tuple[float | None, float | None]) -> Array:
        """Where the closed loop is stable and each measure lies within (least, most); None is no limit."""
        return self.slack(limits) >= 0

    def slack(self, limits: Limits) -> Array:
        """Return how far each point is within the nearest limit, relative to it; below 0 outside and if unstable."""
        slack = np.where(np.isfinite(self.measures["Ms"]), np.inf, -1.0)
        for name, ends in limits.items():
            values = self._measure(name)
            try:
                low, high = (None if end is None else float(end) for end in ends)
                if math.isnan(low or 0.0) or math.isnan(high or 0.0):
                    raise ValueError
            except (TypeError, ValueError):
                message = f"must be (least, most), not {str(ends)[:80]}."
                raise UsageError(Fault("E501", f"limit of {name}", message, f"Example: {name}=(None, 2).")) from None
            for end, sign in ((low, 1.0), (high, -1.0)):
                if end is not None:
                    # What there is none of, as a crossover, lies within nothing.
                    within = np.nan_to_num(sign * (values - end) / (abs(end) or 1.0), nan=-1.0, posinf=np.inf)
                    slack = np.minimum(slack, within)
        return slack

    def best(self, measure: str, **limits: tuple[float | None, float | None]) -> dict[str, float]:
        """The parameters with the best value of a measure where all others lie within (least, most).

        The best is the largest margin or crossover, and the least of all other measures. Raises AnalysisError (E705)
        where nothing lies within.
        """
        values = np.where(self.feasible(**limits), self._measure(measure), np.nan)
        if np.isnan(values).all():
            message = "no point of the map is stable and within the limits."
            raise AnalysisError(Fault("E705", self.diagram, message, "Widen the ranges or the limits."))
        place = np.nanargmax(values) if measure in LARGER else np.nanargmin(values)
        return self._place(np.unravel_index(int(place), values.shape))

    def at(self, point: Mapping[str, float]) -> dict[str, float]:
        """Return the measures at the point of the map nearest to a point: `found.at(found.best("noise"))`.

        point: every parameter of the map, in its declared unit. Raises UsageError (E501) for others, and outside.
        """
        if {*point} != {*self.parameters}:
            message = f"names {legible(', '.join(map(str, point))[:80]) or 'nothing'}."
            raise UsageError(Fault("E501", "point", message, f"Parameters of the map: {', '.join(self.parameters)}."))
        place = []
        for name, values, unit in zip(self.parameters, self.values, self.units, strict=True):
            edge = _EDGE * float(np.abs(values).max())
            if not values[0] - edge <= point[name] <= values[-1] + edge:
                ends = f"{values[0]:g} to {values[-1]:g}{f' {unit}' if unit else ''}"
                raise UsageError(Fault("E501", name, f"{point[name]:g} lies outside of the map: {ends}."))
            place.append(int(np.abs(values - point[name]).argmin()))
        return {name: float(values[tuple(place[::-1])]) for name, values in self.measures.items()}

    def plot(
        self, *measures: str, limits: Limits | None = None, best: str | None = None, **look: Unpack[Look]
    ) -> Figure:
        """Draw measures as contours over both parameters, or as curves over one.

        limits: the region where all lie within (least, most) stays clear, the rest is shaded. The present point is a
        cross. best: a measure; a star marks the point that `best` gives within the limits, if there is one. Raises
        UsageError (E501).
        """
        from .map_figure import drawn

        names = measures or tuple(name for name in _SHOWN if name in self.measures)
        for name in names:
            self._measure(name)
        least: dict[str, list[float]] = {}
        if best is not None:
            with suppress(AnalysisError):
                where = f"{extreme(best)} {best}" + " within the limits" * bool(limits)
                least[where] = [*self.best(best, **(limits or {})).values()]
        return drawn(self, names, None if limits is None else self.slack(limits), MEASURES, least, look)

    def as_json(self) -> dict[str, Any]:
        """The map as JSON data: the values of the parameters, and tables of measures with null for no number."""
        tables = {name: _finite(values.tolist()) for name, values in self.measures.items()}
        given = dict(zip(self.parameters, (values.tolist() for values in self.values), strict=True))
        return {"diagram": self.diagram, "parameters": given, "measures": tables}

    def to_csv(self, path: str | Path) -> None:
        """Write every point as a row: the parameters, then the measures (nan where the loop is not stable).

        Raises UsageError (E501) where it cannot be written.
        """
        lines = [",".join([*self.parameters, *self.measures])]
        for place in np.ndindex(*self.measures["Ms"].shape):
            numbers = [*self._place(place).values(), *(float(values[place]) for values in self.measures.values())]
            lines.append(",".join(map(repr, numbers)))
        with write_atomically(path) as stream:
            stream.write("\n".join(lines) + "\n")

    def parts(self) -> Iterator[Any]:
        shape = " x ".join(str(len(values)) for values in self.values)
        stable = f"{int(np.isfinite(self.measures['Ms']).sum())} of {self.measures['Ms'].size} closed and stable"
        yield f"{self.diagram}: loop at {self.control}, {shape} points, {stable}"
        known = {MEASURES[name]: values[np.isfinite(values)] for name, values in self.measures.items()}
        rows = [(name, f"{values.min():.4g}", f"{values.max():.4g}") for name, values in known.items() if len(values)]
        yield Table([("measure", "least", "largest"), *rows])

    def _measure(self, name: str) -> Array:
        if name not in self.measures:
            cure = did_you_mean(name, self.measures) or f"Measures: {', '.join(self.measures)}."
            raise UsageError(Fault("E501", name, "is not a measure of the map.", cure))
        return self.measures[name]

    def _place(self, place: Sequence[Any]) -> dict[str, float]:
        order = reversed(place) if len(self.parameters) == 2 else iter(place)
        return {name: float(values[k]) for name, values, k in zip(self.parameters, self.values, order, strict=True)}


def extreme(measure: str) -> str:
    """Return what the best value of a measure is: the "largest" or the "least"."""
    return "largest" if measure in LARGER else "least"


@takes(PointWords)
def loop_map(
    diagram: Diagram,
    control: str,
    output: str,
    case: Case | None = None,
    *,
    over: Mapping[str, object],
    points: int = 60,
    measurement: str = "",
    disturbance: str = "",
    frequency: float | None = None,
    pade: int = 0,
    amplitude: Mapping[str, object] | None = None,
    sigma: Mapping[str, object] | None = None,
    overrides: Mapping[str, object] | None = None,
    at: float | None = None,
    check: Callable[[], None] | None = None,
    **words: Unpack[PointWords],
) -> LoopMap:
    """The margins and peaks of `loop_report` over one or two parameters: bandwidths, b0, a gain of the plant.

    over: by parameter, (lowest, highest), between which `points` values lie by equal factors (by equal steps from 0 or
    below on), or a list of more values, in the declared unit, or quantities such as "10 rad/s". control: the signal at
    which the loop is opened; output: what is controlled. measurement: where noise enters; without it, `output` as all
    see it. disturbance: an input of the diagram or a signal; without it, what is added to the control. frequency: in
    rad/s, for the measure `at_frequency`. pade: the order of models of exact delays. at: a time in s, for the operating
    point of each point of the map. check: called at each point; the map ends with whatever it raises. The others are as
    of `Diagram.linearizer`.

    The matrices of continuous loops are computed all at once, those of sampled loops one by one. Margins are nan where
    the closed loop is not stable, and where there is none, as behind a saturation at its limit.

    Raises UsageError (E501), AnalysisError (E701 to E707).
    """
    if at is not None and not isinstance(at, (int, float)):
        raise UsageError(Fault("E501", "at", "must be a time in s: each point of a map has its own operating point."))
    _check(over, frequency, control=control, output=output, measurement=measurement, disturbance=disturbance)
    names = tuple(over)
    if not 1 <= len(names) <= 2:
        raise UsageError(Fault("E501", "over", f"names {len(names)} parameters.", "Give one or two."))
    case = Case() if case is None else case
    case = case.updated(**words) if words else case
    present, units = _present(diagram, case, names)
    values = tuple(_axis(name, over[name], points, unit) for name, unit in zip(names, units, strict=True))
    count = math.prod(map(len, values))
    if count > _MOST:
        raise UsageError(Fault("E501", "over", f"asks for {count} points.", f"Give {_MOST} at most."))
    measured, enters = measurement or output, disturbance or control
    ends = list(dict.fromkeys((control, enters, measured))), list(dict.fromkeys((control, output)))
    point: dict[str, Any] = {"at": at, "amplitude": amplitude, "sigma": sigma, "overrides": overrides}
    each = [dict(zip(names, row, strict=True)) for row in _rows(values)]
    check = check or (lambda: None)
    given = diagram, case, each, ends, pade, point, check
    stacks = _at_once(*given) or _one_by_one(*given)
    found = _measures(stacks, len(each), ends, (control, output, measured, enters), frequency)
    if not np.isfinite(found["Ms"]).any():  # it may be in no loop, or behind a law that passes nothing on
        check_loop(_at(diagram, case, each[0], point).exact_loop([control], pade=pade), control)
    shape = tuple(len(each) for each in reversed(values))
    return LoopMap(
        diagram.name, control, output, names, units, values,
        {name: numbers.reshape(shape) for name, numbers in found.items()}, present, frequency,
    )  # fmt: skip


def _check(over: object, frequency: object, **signals: object) -> None:
    """Raise UsageError (E501) for what is of another kind."""
    if not isinstance(over, Mapping):
        cure = 'Example: over={"control.omega_c": (1, 30)}.'
        raise UsageError(Fault("E501", "over", f"must be a mapping, not {legible(repr(over)[:80])}.", cure))
    for word, name in signals.items():
        if not isinstance(name, str):
            message = f"must be the name of one signal, not {legible(repr(name)[:80])}."
            raise UsageError(Fault("E501", word, message, "Write names as texts."))
    is_number = isinstance(frequency, (int, float, np.number)) and not isinstance(frequency, bool)
    if frequency is not None and not (is_number and 0 <= frequency < math.inf):  # type: ignore[operator]
        message = f"must be a number of rad/s from 0 on, not {legible(repr(frequency)[:80])}."
        raise UsageError(Fault("E501", "frequency", message))


def _rows(values: tuple[Array, ...]) -> Iterator[tuple[float, ...]]:
    """Every combination, the first parameter changing fastest."""
    for row in itertools.product(*(each.tolist() for each in reversed(values))):
        yield row[::-1]


def _axis(name: str, given: Any, points: int, unit: str) -> Array:
    if isinstance(points, bool) or not isinstance(points, int) or points < 2:
        raise UsageError(Fault("E501", "points", f"must be a whole number from 2 on, not {points!r}."))
    try:
        if isinstance(given, (list, tuple)) and any(isinstance(item, (str, Mapping)) for item in given):
            given = [from_si(in_si(item, unit, f"over {name}"), unit) for item in given]
        values = np.asarray(given, dtype=float)
    except UsageError:  # a unit of another quantity
        raise
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.ndim != 1 or len(values) < 2 or not np.isfinite(values).all() or (np.diff(values) <= 0).any():
        message = f"must be (lowest, highest), or rising numbers, not {str(given)[:80]}."
        raise UsageError(Fault("E501", f"over {name}", message, f'Example: over={{"{name}": (1, 100)}}.'))
    if len(values) > 2:
        return values
    low, high = values.tolist()
    return np.geomspace(low, high, points) if low > 0 else np.linspace(low, high, points)


def _at(diagram: Diagram, case: Case, given: Mapping[str, float], point: Mapping[str, Any]) -> Linearizer:
    return diagram.linearizer(case.updated(parameters={**case.parameters, **given}), **point)


def _at_once(
    diagram: Diagram,
    case: Case,
    each: Sequence[Mapping[str, float]],
    ends: tuple[list[str], list[str]],
    pade: int,
    point: Mapping[str, Any],
    check: Callable[[], None],
) -> Stacks:
    """The models of all points from one Plan; none where that is not what single points give."""
    linearizer = _at(diagram, case, each[0], point)
    plan, columns = linearizer.plan, []
    for at in _points(diagram, case, each, linearizer.slopes.point, point["at"]):
        check()
        if at.plan.instances is not plan.instances or at.plan.delays != plan.delays:
            return []
        columns.append(read_at(linearizer.graph, at))
    stack = stacked(linearizer, np.stack(columns, axis=1), *ends, pade=pade)
    if stack is None:
        return []
    for k in {0, len(each) // 3, (2 * len(each)) // 3, len(each) - 1}:
        if not _is_seen_in(stack, k, _at(diagram, case, each[k], point).transfer(*ends, pade=pade)):
            return []
    return [(np.arange(len(each)), stack)]


def _points(
    diagram: Diagram, case: Case, each: Sequence[Mapping[str, float]], first: Point, at: float | None
) -> Iterator[Point]:
    """Where the diagram is at each point of the map; at the start by the rows p of one Plan, where it has them."""
    given = [{**case.parameters, **one} for one in each]
    rows: list[tuple[float, ...] | None] = [None]
    if at is None and not first.plan.foreign:
        resolver = resolver_of({**diagram.types})
        prepared = Prepared.of(case.of(diagram.value), resolver, given[0], case.settings, trust=case.trust)
        if isinstance(prepared.plan, Plan) and (rebinding := prepared.rebinding()).is_possible:
            rows = [rebinding.row(one, first.plan.settings.seed) for one in given]
    if rows[0] == tuple(first.plan.parameters) and None not in rows:
        yield from (first.at_start(row) for row in rows if row is not None)
    else:
        yield from (diagram.point(case.updated(parameters=one), at=at) for one in given)


def _is_seen_in(stack: Stack, k: int, single: Transfer) -> bool:
    """Whether the k-th model responds as a single one, which leaves out the states that have no part at its point."""
    whole = Stack(*(getattr(stack, key)[k : k + 1] for key in "ABCD"))
    alone = Stack(*(getattr(single, key)[None] for key in "ABCD"))
    scale = float(np.abs(np.linalg.eigvals(single.A)).max(initial=1.0))
    omega = scale * np.array([[1e-6, 1e-4, 1e-2, 1.0, 1e2]])
    for i in range(whole.B.shape[2]):
        for o in range(whole.C.shape[1]):
            own, other = (
                Loops(each.A).response(each.B[:, :, i], each.C[:, o], each.D[:, o, i])(np.zeros(1, dtype=int), omega)
                for each in (whole, alone)
            )
            size = np.abs(other)
            if not (np.abs(own - other) <= _CHECKED * size + _ROUNDING * size.max()).all():
                return False
    return True


def _one_by_one(
    diagram: Diagram,
    case: Case,
    each: Sequence[Mapping[str, float]],
    ends: tuple[list[str], list[str]],
    pade: int,
    point: Mapping[str, Any],
    check: Callable[[], None],
) -> Stacks:
    """The same from one model at a time, those of equal size and period together."""
    models = []
    for one in each:
        check()
        models.append(_at(diagram, case, one, point).transfer(*ends, pade=pade))
    kinds: dict[object, list[int]] = {}
    for k, model in enumerate(models):
        kinds.setdefault((model.A.shape, model.dt), []).append(k)
    stacks = []
    for rows in kinds.values():
        A, B, C, D = (np.stack([getattr(models[k], key) for k in rows]) for key in "ABCD")
        stacks.append((np.array(rows), Stack(A, B, C, D, models[rows[0]].dt)))
    return stacks


def _measures(
    stacks: Stacks, count: int, ends: tuple[list[str], list[str]], signals: tuple[str, ...], frequency: float | None
) -> dict[str, Array]:
    control, output, measured, enters = signals
    found: dict[str, Array] = {}

    def note(name: str, rows: Array, values: Array) -> None:
        found.setdefault(name, np.full(count, np.nan))[rows] = values

    for rows, stack in stacks:
        known = _Loops(stack, ends)
        stable = np.zeros(len(rows), dtype=bool)
        for own, is_stable, channel in known.channels(control, control):
            # Where nothing comes back, as behind a saturation at its limit, there is no loop and no margin.
            stable[own] = is_stable & (channel.values != 1).any(axis=1)
            for name, values in margins_of(channel, stable[own]).items():
                note(name, rows[own], values)
        for name, source, sink in (("disturbance", enters, output), ("noise", measured, control)):
            for own, _, channel in known.channels(source, sink):
                note(name, rows[own], np.where(stable[own], channel.peaks()[0], np.nan))
                if name == "disturbance" and frequency is not None:
                    at = np.full((len(own), 1), float(frequency))
                    values = np.abs(channel.at(np.arange(len(own)), at))[:, 0]
                    note("at_frequency", rows[own], np.where(stable[own], values, np.nan))
    return found


class _Loops:
    """The closed loops of a stack, each with the states alone that lie between an input and an output."""

    def __init__(self, stack: Stack, ends: tuple[list[str], list[str]]) -> None:
        self.stack, self.ends = stack, ends
        self.known: dict[bytes, tuple[Loops, Array, Array]] = {}

    def channels(self, source: str, sink: str) -> Iterator[tuple[Array, Array, Channel]]:
        """Rows with the same states between the two; which of them are stable; the channel."""
        stack, i, o = self.stack, self.ends[0].index(source), self.ends[1].index(sink)
        B, C, D = stack.B[:, :, i], stack.C[:, o], stack.D[:, o, i]
        kept = between(stack.A, B, C)
        for mask in np.unique(kept, axis=0):
            rows = np.flatnonzero((kept == mask).all(axis=1))
            key = mask.tobytes() + rows.tobytes()
            if key not in self.known:
                self.known[key] = _closed(stack.A[np.ix_(rows, mask, mask)], stack.dt)
            loops, stable, omega = self.known[key]
            yield rows, stable, Channel(loops.response(B[np.ix_(rows, mask)], C[np.ix_(rows, mask)], D[rows]), omega)


def _closed(A: Array, dt: float) -> tuple[Loops, Array, Array]:
    """Closed loops with the same states: which of them are stable, and at which frequencies to look."""
    poles = np.linalg.eigvals(A).astype(complex) if A.shape[1] else np.zeros((len(A), 0), dtype=complex)
    if dt:
        stable = (np.abs(poles) < 1).all(axis=1)
        with np.errstate(all="ignore"):
            poles = np.log(poles) / dt
    else:
        stable = (poles.real < 0).all(axis=1)
    return Loops(A, dt), np.asarray(stable), grid_of(poles, dt)


def _present(diagram: Diagram, case: Case, names: tuple[str, ...]) -> tuple[tuple[float, ...], tuple[str, ...]]:
    """Return the present values of the parameters in their declared units, nan for no single number, and the units."""
    now = case.only("parameters", "variants", "trust")
    settings = {setting.path: setting for setting in bindings(diagram.flatten(now), None)}
    found: list[float] = []
    units: list[str] = []
    for name in names:
        setting = settings.get(name)
        unit = "" if setting is None else setting.display or setting.unit
        is_number = setting is not None and len(setting.values) == 1 and not isinstance(setting.values[0], str)
        found.append(from_si(float(setting.values[0]), unit) if setting is not None and is_number else math.nan)
        units.append(unit)
    return tuple(found), tuple(units)


def _finite(values: Any) -> Any:
    if isinstance(values, list):
        return [_finite(value) for value in values]
    return values if math.isfinite(values) else None
