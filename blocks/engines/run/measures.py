"""Measures: quadratures over accepted steps by dense output. They watch the run and never steer it.

In each step e = of - against is taken at the five nodes of Lobatto's rule (order 8). What happens between the nodes
(a change of sign of e, a peak, a turn, the entry into a band) is looked for on the quartic through them.

An engine hands over records in the order of time: rows of 5 + 10 m doubles for m measures,

    kind, t, h, low, high, values (5, 2 m): node by node, `of` and `against` of each measure in turn

Kind 0 is a part of a step: it begins at t and is h long. low ... high is what the window of some measure leaves of the
step; a step has parts for each such range. Kind 1 holds the values after an instant at t in the place of the first
node, and in that of the second those before it (NaN where nothing looked at them); its other values mean nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from copy import copy

import numpy as np

from ...compile.plan import Plan, Reference
from ...compile.time_grid import within_ulps
from ...model.settings import MeasureSpec
from ...text.arrays import Array
from ...text.errors import Fault
from .step_polynomial import (
    FINE,
    NODES,
    TO_FINE,
    WEIGHTS,
    absolute_integrals,
    entry,
    first_reach,
    fourier,
    reached,
    variations,
    weighted,
)

_SQUARES = ("ISE", "ISU", "mean_square", "RMS")
_ABSOLUTES = ("IAE", "ITAE")
_ROWS = 512  # parts that are looked through at once
_AT_ONCE = 8192  # signals in records that are taken in at once: their fine points need 8 MB
_PENDING = 256  # records of single steps that are put off until they are taken in together
_PATHS = ("settling_time", "rise_time")
_COVER = "Let the run cover the window, or move the window into the run."
_WHOLE = "Choose a window of whole periods of the fundamental, and give both exactly."
_FREQUENCY = "Set omega to the frequency of its fundamental."
_VALUES = 5  # the column of a record at which its values begin

Parts = Callable[[float, float, "Array | None"], Iterable[tuple[float, float, Array]]]
"""A piece of a step in parts that five values describe: begins, ends and the values (5, 2 m) at NODES of all `of` and
`against`, one after the other. The values at the begin of the piece may be known."""


class Measures:
    """The measures of one run up to some time. They are replaced step by step, never changed.

    A window holds what happens at its beginning, and what happens at its end if the run ends there: this is no part of
    the state, but of results. It costs little more to take in many records than one; those of single steps wait in
    `pending`.
    """

    def __init__(self, plan: Plan) -> None:
        self.specs = plan.measures
        self.count, self.atol = len(self.specs), plan.settings.atol
        self.references: list[Reference] = []
        for spec in self.specs:
            self.references.append(plan.signal(spec.of).references[0])
            against = spec.against
            self.references.append(
                plan.signal(against).references[0] if isinstance(against, str) else Reference("k", float(against))
            )
        self.low = np.array([spec.start for spec in self.specs])
        self.high = np.array([spec.stop for spec in self.specs])
        self.windowed = bool(np.any(np.isfinite(self.low)) or np.any(np.isfinite(self.high)))
        self.total = np.zeros(self.count)  # the integral, the peak or the variation so far
        self.span = np.zeros(self.count)  # how much of the window was seen
        self.first: list[float | None] = [None] * self.count  # t at which the window begins, as the run has it
        self.begin = [math.nan] * self.count  # `of` there
        self.target = [math.nan] * self.count  # `against` where it ends
        self.last = [math.nan] * self.count  # e at the end of the step before, for jumps
        self.extremes = [(math.inf, -math.inf)] * self.count  # least and largest `of`; of zero_crossings: the last sign
        types = [spec.type for spec in self.specs]
        # Blocks of rows: t, h and `of` at the nodes of each part of a step.
        self.paths: dict[int, tuple[Array, ...]] = {i: () for i, t in enumerate(types) if t in _PATHS}
        self.squares = np.array([i for i, t in enumerate(types) if t in _SQUARES], dtype=int)
        self.absolutes = np.array([i for i, t in enumerate(types) if t in _ABSOLUTES], dtype=int)
        self.timed = np.array([types[i] == "ITAE" for i in self.absolutes], dtype=bool)  # which of them weigh with t
        self.others = [i for i, t in enumerate(types) if t not in (*_SQUARES, *_ABSOLUTES)]
        self.known: tuple[float, Array] | None = None  # a time and the values there: the end of the last record
        self.pending: tuple[Array, ...] = ()

    def after_instant(self, t: float, row: tuple[float, ...]) -> Measures:
        """The measures with the values after an instant that changed something."""
        record = np.zeros(_VALUES + 10 * self.count)
        record[:2] = 1.0, t
        record[_VALUES : _VALUES + len(row)] = row
        before = self.known[1] if self.known is not None and self.known[0] == t else math.nan
        record[_VALUES + len(row) : _VALUES + 2 * len(row)] = before
        return self._later([record])

    def after_step(self, t0: float, t1: float, parts: Parts) -> Measures:
        """The measures with one accepted step, from t0 to t1."""
        if t1 <= t0 or not self.count:
            return self
        ranges = [(t0, t1)]
        if self.windowed:
            cut = {(max(lo, t0), min(hi, t1)) for lo, hi in zip(self.low.tolist(), self.high.tolist(), strict=True)}
            ranges = sorted((low, high) for low, high in cut if low < high)
        records: list[Array] = []
        known = self.known
        for low, high in ranges:
            first = known[1] if known is not None and known[0] == low else None
            for begin, end, table in parts(low, high, first):
                records.append(np.concatenate([(0.0, begin, end - begin, low, high), table.ravel()]))
            known = _known(records[-1])
        measures = self._later(records)
        if self.windowed and t1 in self.low and (measures.known is None or measures.known[0] != t1):
            *_, (_, _, table) = parts(t0, t1, None)
            measures = copy(measures)
            measures.known = t1, table[-1].copy()  # a jump there is the first thing in that window
        return measures

    def after_records(self, records: Array) -> Measures:
        """The measures with the instants and steps in records (n, 5 + 10 m): bit for bit as with one after the other.

        Where there are windows, all parts of a step come at once: the others show which windows a part is of.
        """
        if self.pending:
            records = np.concatenate([self.pending, records])
        if not len(records):
            return self
        measures = self._copy()
        picked = self._picked(records)
        size = max(1, _AT_ONCE // self.count)
        for k in range(0, len(records), size):
            measures._take(records[k : k + size], picked[:, k : k + size])
        measures.pending, measures.known = (), _known(records[-1])
        return measures

    def _later(self, records: list[Array]) -> Measures:
        """The measures with one step or instant, to be taken in with others."""
        if not self.count or not records:
            return self
        measures = copy(self)
        measures.pending, measures.known = (*self.pending, *records), _known(records[-1])
        return measures if len(measures.pending) < _PENDING else measures._settled()

    def _settled(self) -> Measures:
        """The measures with all that is pending taken in."""
        return self.after_records(np.empty((0, _VALUES + 10 * self.count)))

    def _picked(self, records: Array) -> Array:
        """Which measures (m, n) a record counts for: those whose window leaves its range of the step.

        The step itself is not in the records. Ranges that overlap are of one step; how far it goes beyond them makes
        no difference.
        """
        if not self.windowed:
            return np.ones((self.count, len(records)), dtype=bool)
        kind, t, _, low, high = records[:, :_VALUES].T
        own, window = self.low[:, None], self.high[:, None]
        picked: Array = (own <= t) & (t < window)
        parts = np.nonzero(kind == 0.0)[0]
        if len(parts):
            parts = parts[np.argsort(low[parts], kind="stable")]
            low, high = low[parts], high[parts]
            ends = np.maximum.accumulate(high)
            fresh = np.concatenate([[True], low[1:] >= ends[:-1]])  # where another step begins
            firsts, step = np.nonzero(fresh)[0], np.cumsum(fresh) - 1
            t0, t1 = low[firsts][step], np.maximum.reduceat(high, firsts)[step]
            picked[:, parts] = (np.maximum(own, t0) == low) & (np.minimum(window, t1) == high)
        return picked

    def _copy(self) -> Measures:
        """A copy to be filled."""
        measures = copy(self)
        measures.total, measures.span = self.total.copy(), self.span.copy()
        measures.first, measures.begin, measures.target = [*self.first], [*self.begin], [*self.target]
        measures.last, measures.extremes, measures.paths = [*self.last], [*self.extremes], {**self.paths}
        return measures

    def rows(self) -> dict[str, Array]:
        """Return all that the rest of a run needs, as rows of a saved state."""
        nan, measures = math.nan, self._settled()
        own = {
            "total": measures.total,
            "span": measures.span,
            "first": np.array([nan if t is None else t for t in measures.first]),
            "begin": np.array(measures.begin),
            "target": np.array(measures.target),
            "last": np.array(measures.last),
            "extremes": np.array(measures.extremes).reshape(self.count, 2),
            "known": np.empty(0) if measures.known is None else np.array([measures.known[0], *measures.known[1]]),
            **{f"path {i}": measures._path(i) for i in measures.paths},
        }
        return {f"measures.{name}": row for name, row in own.items()}

    def restored(self, rows: Mapping[str, Array]) -> Measures:
        """Return the measures of the same plan as `rows` gave them."""
        prefix = "measures."
        saved = {name.removeprefix(prefix): row for name, row in rows.items() if name.startswith(prefix)}
        measures = self._copy()
        measures.total, measures.span = saved["total"].copy(), saved["span"].copy()
        measures.first = [None if math.isnan(t) else t for t in saved["first"].tolist()]
        measures.begin, measures.target, measures.last = (saved[key].tolist() for key in ("begin", "target", "last"))
        measures.extremes = [(low, high) for low, high in saved["extremes"].tolist()]
        known = saved["known"]
        measures.known = (float(known[0]), known[1:].copy()) if len(known) else None
        measures.paths = {i: (np.concatenate([np.empty((0, 7)), saved[f"path {i}"]]),) for i in self.paths}
        measures.pending = ()
        return measures

    def kept(self, numbers: Array, paths: Mapping[int, Array], known: Array | None = None) -> Measures:
        """Return the measures of the same plan as compiled code has them.

        numbers: (m, 8) total, span, first, begin, target, last and the two extremes. paths: their rows (parts, 7).
        known: the time (NaN: unknown) and the values of the last node.
        """
        measures = copy(self)
        measures.known = None if known is None or math.isnan(known[0]) else (float(known[0]), known[1:].copy())
        measures.total, measures.span = numbers[:, 0], numbers[:, 1]
        first, *lists, low, high = numbers[:, 2:].T.tolist()
        measures.first = [None if math.isnan(t) else t for t in first]
        measures.begin, measures.target, measures.last = lists
        measures.extremes = list(zip(low, high, strict=True))
        measures.paths = {i: (path,) for i, path in paths.items()}
        return measures

    def _path(self, i: int) -> Array:
        """All rows of a path, shape (parts, 7)."""
        return np.concatenate([np.empty((0, 7)), *self.paths[i]])

    def _take(self, records: Array, picked: Array) -> None:
        """Take in records (n, 5 + 10 m), each for the measures that are picked (m, n).

        What stands after an instant is taken in as a step without length.
        """
        instant = records[:, 0] == 1.0
        t, h = records[:, 1], np.where(instant, 0.0, records[:, 2])
        table = records[:, _VALUES:].reshape(len(records), 5, 2 * self.count).transpose(2, 1, 0).copy()
        before = table[0::2, 1] - table[1::2, 1]
        table[:, 1:, instant] = table[:, :1, instant]
        of, against = table[0::2], table[1::2]  # (m, 5, n)
        self._integrals(of - against, t, h, picked)
        for i in (*self.squares.tolist(), *self.absolutes.tolist()):
            if self.first[i] is None and self.span[i] == 0.0 and picked[i].any():
                self.first[i] = float(t[picked[i]][0])
        self.span = _summed(self.span, np.where(picked, h, 0.0))
        for i in self.others:
            rows = picked[i]
            if rows.any():
                if self.first[i] is None and instant[k := int(rows.argmax())]:
                    self._begin_before(i, float(before[i, k]))
                self._other(i, t[rows], h[rows], of[i][:, rows], against[i][:, rows])
            if i in self.paths:
                rows = rows & ~instant
                self.paths[i] += (np.column_stack([t[rows], h[rows], of[i][:, rows].T]),)

    def _integrals(self, e: Array, t: Array, h: Array, picked: Array) -> None:
        gain = np.zeros_like(picked, dtype=float)
        if len(self.squares):
            gain[self.squares] = h * weighted(WEIGHTS, (e[self.squares] ** 2).transpose(1, 0, 2))
        if len(self.absolutes):
            rows = e[self.absolutes]
            size = np.abs(rows)
            size[self.timed] *= t + NODES[:, None] * h
            integrals = h * weighted(WEIGHTS, size.transpose(1, 0, 2))
            which, part = np.nonzero((rows.min(axis=1) < 0) & (rows.max(axis=1) > 0))
            if len(which):
                integrals[which, part] = absolute_integrals(rows[which, :, part].T, t[part], h[part], self.timed[which])
            gain[self.absolutes] = integrals
        self.total = _summed(self.total, np.where(picked, gain, 0.0))

    def _harmonic(self, i: int, t: Array, h: Array, e: Array) -> None:
        """Take in parts of a signal with a fundamental. total: integral of e^2; target: of e; extremes: of e by cosine
        and sine."""
        phase_0, omega = float(self.first[i] or 0.0), self.specs[i].omega
        for k in np.nonzero(h > 0)[0].tolist():
            mean, square, cosine, sine = fourier(e[:, k], float(t[k]) - phase_0, float(h[k]), omega).tolist()
            self.total[i], self.target[i] = self.total[i] + square, self.target[i] + mean
            self.extremes[i] = (self.extremes[i][0] + cosine, self.extremes[i][1] + sine)

    def _begin_before(self, i: int, e: float) -> None:
        """A window begins at an instant: what changes there is in it, and is counted from the value before."""
        if self.specs[i].type == "total_variation":
            self.last[i] = e
        elif self.specs[i].type == "zero_crossings" and abs(e) > self.atol:
            self.extremes[i] = (self.extremes[i][0], math.copysign(1.0, e))

    def _other(self, i: int, t: Array, h: Array, of: Array, against: Array) -> None:
        """Take in the values of one measure, shape (5, n)."""
        kind, e = self.specs[i].type, of - against
        if self.first[i] is None:
            self.first[i], self.begin[i] = float(t[0]), float(of[0, 0])
            self.last[i] = float(e[0, 0]) if math.isnan(self.last[i]) else self.last[i]
            if kind == "THD":
                self.target[i], self.extremes[i] = 0.0, (0.0, 0.0)
        if kind == "THD":
            self._harmonic(i, t, h, e)
            return
        self.target[i] = float(against[-1, -1])
        if kind == "peak":
            low, high = reached(e, -self.total[i], self.total[i])
            self.total[i] = max(-low, high)
        elif kind == "total_variation":
            jumps = np.abs(e[0] - np.concatenate([[self.last[i]], e[-1, :-1]]))
            self.total[i] = _summed(self.total[i], jumps + variations(e))
        elif kind == "overshoot":
            self.extremes[i] = reached(of, *self.extremes[i])
        elif kind == "zero_crossings":
            fine = weighted(TO_FINE[:, None, :], e[:, :, None]).ravel()
            signs = np.where(np.abs(fine) <= self.atol, 0.0, np.sign(fine))
            signs = np.concatenate([[self.extremes[i][1]] * (abs(self.extremes[i][1]) == 1), signs[signs != 0]])
            if len(signs):
                self.total[i] += np.count_nonzero(signs[1:] != signs[:-1])
                self.extremes[i] = (self.extremes[i][0], float(signs[-1]))
        self.last[i] = float(e[-1, -1])

    def results(self, t: float) -> tuple[dict[str, float], tuple[Fault, ...]]:
        """The values by name where the run stands at t, and why some are none (W301).

        A value is NaN where the run does not cover the window: a part would pass for the whole.
        """
        if self.pending:
            return self._settled().results(t)
        if self.known is not None and self.known[0] == t and t in self.high:
            return self._ended(t, self.known[1]).results(t)
        values, faults = {}, []
        for i, spec in enumerate(self.specs):
            value = float(self.total[i])
            why, cure = _uncovered(spec, self.first[i], float(self.span[i]), t), _COVER
            turns = float(self.span[i]) * spec.omega / (2 * math.pi)
            if not why and spec.omega and (round(turns) < 1 or abs(turns - round(turns)) > 1e-6):
                why, cure = f"its window has {turns:.10g} periods, not a whole number", _WHOLE
            if why:
                value = math.nan
            elif spec.type == "THD":
                value = self._distortion(i)
                why, cure = _without(value, "its signal has no component at the frequency omega"), _FREQUENCY
            elif spec.type == "rise_time":
                value = self._rise_time(i)
                why = _without(value, "its signal does not go from 10 to 90 % of the step")
            elif spec.type in _OF_NUMBERS:
                own = self.begin[i], self.target[i], self.last[i], *self.extremes[i]
                value = _OF_NUMBERS[spec.type](value, float(self.span[i]), self.first[i], *own, min(t, spec.stop))
            elif spec.type == "settling_time":
                value = self._settling_time(i)
            if why:
                faults.append(Fault("W301", f"measures.{spec.name}", f"has no value: {why}.", cure))
            values[spec.name] = value
        return values, tuple(faults)

    def results_each(self, numbers: Array, t: Array) -> tuple[dict[str, Array], Array]:
        """Return the values (n,) of n runs by name, bit for bit as `kept` and `results` give each, and which are known.

        numbers: (n, m, 8) as `kept` takes them. t: (n,) where each run ended. A run is not known if a measure looks
        back or has no value.
        """
        values, is_known = dict[str, Array](), np.full(len(t), not self.paths)
        for spec, own in zip(self.specs, numbers.transpose(1, 0, 2), strict=True):
            is_covered = (own[:, 1] > 0.0) & (spec.stop <= t if spec.stop < math.inf else spec.start < t)
            if spec.start > -math.inf:
                is_covered &= ~(own[:, 2] > spec.start)
            values[spec.name] = own[:, 0]
            if spec.type in _OF_NUMBERS:
                of_one, at = _OF_NUMBERS[spec.type], np.nonzero(is_known & is_covered)[0]
                rows = zip(own[at].tolist(), np.minimum(t[at], spec.stop).tolist(), strict=True)
                values[spec.name] = np.full(len(t), math.nan)
                values[spec.name][at] = [of_one(*kept, end) for kept, end in rows]
            is_known &= is_covered & ~np.isnan(values[spec.name]) & (not spec.omega)
        return values, is_known

    def _ended(self, t: float, row: Array) -> Measures:
        """The measures of a run that ends at t: what happens there is in the windows that end there."""
        record = np.full((1, _VALUES + 10 * self.count), math.nan)
        record[0, :2], record[0, _VALUES : _VALUES + len(row)] = (1.0, t), row
        measures = self._copy()
        measures._take(record, (self.high == t)[:, None])
        measures.known = None
        return measures

    def _distortion(self, i: int) -> float:
        """The RMS value of all but the mean and the fundamental, by that of the fundamental."""
        span = float(self.span[i])
        whole, mean = float(self.total[i]) / span, self.target[i] / span
        cosine, sine = (part / span for part in self.extremes[i])
        fundamental = 2 * (cosine * cosine + sine * sine)  # its mean square
        # What rounding and the quadrature leave of another wave is no fundamental; squares may overflow.
        if not 1e-12 * whole < fundamental < math.inf:
            return math.nan
        return math.sqrt(max(whole - mean * mean - fundamental, 0.0) / fundamental)

    def _rise_time(self, i: int) -> float:
        """From the first time at 10 % of the step from the first `of` to the last `against` to the first at 90 %."""
        size, rows, times = self.target[i] - self.begin[i], self._path(i), []
        if size == 0.0:
            return math.nan
        shares = (rows[:, 2:] - self.begin[i]) / size
        for level in (0.1, 0.9):
            for begin in range(0, len(rows), _ROWS):
                reaches = np.nonzero((shares[begin : begin + _ROWS] @ TO_FINE >= level).any(axis=1))[0]
                if len(reaches):
                    k = begin + int(reaches[0])
                    times.append(float(rows[k, 0] + first_reach(shares[k], level) * rows[k, 1]))
                    break
        return times[1] - times[0] if len(times) == 2 else math.nan

    def _settling_time(self, i: int) -> float:
        """From the window's beginning to the last entry of `of` into the band around the last `against`."""
        first, target = self.first[i], self.target[i]
        band = self.specs[i].band * abs(target - self.begin[i])
        if band == 0.0 or first is None:
            return math.nan
        rows = self._path(i)
        for end in range(len(rows), 0, -_ROWS):
            begin = max(0, end - _ROWS)
            outside = np.abs(rows[begin:end, 2:] @ TO_FINE - target) > band
            if np.any(outside):
                step = begin + int(np.nonzero(outside.any(axis=1))[0][-1])
                k = int(np.nonzero(outside[step - begin])[0][-1])
                if step == len(rows) - 1 and k == len(FINE) - 1:
                    return math.nan  # the run ends outside
                t, h = rows[step, :2]
                return float(t + entry(rows[step, 2:], k, target, band) * h - first)
        return 0.0


def _overshoot(*kept: float) -> float:
    """How far `of` goes beyond the last `against`, as a part of the step from the first `of` to there."""
    _, _, _, begin, target, _, low, high, _ = kept
    size = target - begin
    if size == 0.0:
        return math.nan
    return max(0.0, ((high if size > 0 else low) - begin) / size - 1.0)


_OF_NUMBERS: Mapping[str, Callable[..., float]] = {
    "mean_square": lambda total, span, *_: total / span,
    "RMS": lambda total, span, *_: math.sqrt(total / span),
    "steady_state_error": lambda *kept: abs(kept[5]),
    "end_time": lambda *kept: kept[-1],
    "overshoot": _overshoot,
}
"""Measures that follow from the eight numbers of `Measures.kept`, and where the window ends as far as the run goes."""


def _without(value: float, why: str) -> str:
    """Why a measure has no value, where it has none."""
    return why if math.isnan(value) else ""


def _uncovered(spec: MeasureSpec, first: float | None, span: float, t: float) -> str:
    """Why a run that stands at t does not cover a window of which it saw a length of `span`, from `first` on, or ""."""
    if first is not None and first > spec.start > -math.inf and not within_ulps(first, spec.start):
        return f"its window begins at t = {spec.start:.10g} s, and the run at {first:.10g} s"
    # Without an end of its own a window ends where the run does, but it must have begun.
    has_end = spec.stop < math.inf
    edge, verb = (spec.stop, "ends") if has_end else (spec.start, "begins")
    if (edge > t and not within_ulps(edge, t)) or (edge == t and not has_end):
        return f"its window {verb} at t = {edge:.10g} s, and the run ends at {t:.10g} s"
    return "" if span > 0.0 or spec.type == "end_time" else "no time of its window lies within the run"


def _known(record: Array) -> tuple[float, Array]:
    """When a record ends and the values there."""
    kind, t, h, _, high = record[:_VALUES].tolist()
    width = (len(record) - _VALUES) // 5
    if kind == 1.0:
        return t, record[_VALUES : _VALUES + width].copy()
    # The sum t + h may miss the end by its rounding. A part that is not the last is followed by one as long or longer.
    return high if high - (t + h) < h / 2 else t + h, record[-width:].copy()


def _summed(total: Array, gains: Array) -> Array:
    """total + gains[..., 0] + gains[..., 1] ... in this order: np.sum would add by pairs."""
    sums: Array = np.concatenate([np.asarray(total)[..., None], gains], axis=-1).cumsum(axis=-1)[..., -1]
    return sums
