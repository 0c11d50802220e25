"""Two results side by side: how far each signal is from its counterpart, and where it is farthest.

    difference = max |a(t) - b(t)| over the interval that both have, left and right values of a jump separately
    relative   = difference / (max a - min a), over the same interval
    RMSE       = |a - b|, and fit = 100 (1 - |a - b| / |a - mean of a|) in %, where |x|^2 is the mean of x^2 over time

A signal that is constant in A is measured by its magnitude |a|; where it is 0 throughout, every difference is infinite.
Where the times differ, both are interpolated linearly and compared at the times of both, where the difference of two
such curves is largest. A value that is not finite is equal to nothing, itself included.
"""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..text import units
from ..text.arrays import Array
from ..text.errors import BlocksError, Fault, UsageError, did_you_mean
from ..text.printable import quoted
from ..text.rich_output import Part, Shown, Table, as_text
from .provenance import Origin
from .results import Results

TOLERANCE = 1e-6
# A signal that varies by less, as a part of its magnitude, is a constant with rounding errors.
FLAT = 1e-12


@dataclass(frozen=True, slots=True)
class Difference:
    """How far one signal of A is from that of B, in A's unit; `relative` to its range in A, and at which time.

    rmse: the root of the mean square over time of the difference, in A's unit. fit: in %, 100 for equal signals; of a
    constant A, -inf for others. All numbers are NaN where a value is not finite, and t is the first such time.
    """

    name: str
    unit: str
    absolute: float
    relative: float
    t: float
    is_within: bool
    rmse: float
    fit: float


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """All signals that A and B have in common, in the order of A.

    only_a, only_b: signals that the other one lacks; they do not count. start, stop: the interval in s that both have.
    rows: at how many times they were compared. is_interpolated: whether the times of A and B differ. notes: what else
    is different, in sentences.
    """

    differences: tuple[Difference, ...]
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
    start: float
    stop: float
    rows: int
    is_interpolated: bool
    tolerance: float
    notes: tuple[str, ...] = ()

    @property
    def is_within(self) -> bool:
        return all(difference.is_within for difference in self.differences)

    @property
    def beyond(self) -> tuple[Difference, ...]:
        """The differences beyond the tolerance."""
        return tuple(difference for difference in self.differences if not difference.is_within)

    @property
    def worst(self) -> Difference:
        """The largest relative difference, one of those beyond the tolerance if there are any."""

        def badness(difference: Difference) -> tuple[bool, float]:
            return not difference.is_within, math.inf if math.isnan(difference.relative) else difference.relative

        return max(self.differences, key=badness)

    def table(self) -> str:
        """A line for each signal, those beyond the tolerance marked."""
        return as_text([self._table()])

    def _table(self) -> Table:
        rows = [("signal", "unit", "difference", "of range", "at t", "RMSE", "fit", "")]
        for difference in self.differences:
            largest = (f"{difference.absolute:.5g}", f"{difference.relative:.5g}", f"{difference.t:.10g}")
            fit = f"{difference.fit:.4g} %" if math.isfinite(difference.fit) else "-"
            numbers = (*largest, f"{difference.rmse:.5g}", fit)
            rows.append((difference.name, difference.unit or "-", *numbers, "" if difference.is_within else "✗"))
        return Table(rows)

    def parts(self) -> Iterator[Part]:
        verdict = "within" if self.is_within else "beyond"
        yield f"<Comparison: {len(self.differences)} signals, {verdict} {self.tolerance:g}>"
        yield self._table()


def compare(
    a: Results | str | Path,
    b: Results | str | Path,
    *,
    tolerance: float = TOLERANCE,
    absolute: float = 0.0,
    names: Mapping[str, str] | None = None,
) -> Comparison:
    """The differences of b from a: results, or the paths of result files.

    tolerance: how far a signal may be off, as a part of its range in a. absolute: a difference up to this, in the
    signal's own unit, is within it as well. names: signals that have other names in b, by their names in a, such as
    {"motor.omega": "speed"}; the name of a vector or a block is that of all its elements or outputs. Values in another
    unit of the same quantity are converted; an unknown unit fits every other. Raises UsageError (E501, E503 for a file
    that cannot be read, and E505 where nothing can be compared) and ModelError (E114).
    """
    for name, value in (("tolerance", tolerance), ("absolute", absolute)):
        if not (math.isfinite(value) and value >= 0):
            raise UsageError(Fault("E501", name, f"must be a number of at least 0, not {value}."))
    for side, source in (("a", a), ("b", b)):
        if not isinstance(source, (Results, str, os.PathLike)):
            cure = "For some signals only, run with log=[...], or Results.load(path, signals=[...])."
            message = f"must be results or the path of a result file, not {type(source).__name__}."
            raise UsageError(Fault("E501", side, message, cure))
    a, b = (source if isinstance(source, Results) else Results.load(source) for source in (a, b))
    left, right = ({name: (column, unit) for name, column, unit in results.flat_columns()} for results in (a, b))
    partners = _partners(left, right, names or {})
    common = list(partners)
    start, stop = _span(a, b, common)
    factors = _factors({name: (left[name][1], right[partners[name]][1]) for name in common})
    pair = _Pair(a.t, b.t, start, stop)
    differences = []
    for name in common:
        column, unit = left[name]
        others, other_unit = right[partners[name]]
        far, relative, t, *means = pair.difference(a.values[:, column], _moved(b.values[:, others], *factors[name]))
        is_within = relative <= tolerance or far <= absolute
        differences.append(Difference(name, unit or other_unit, far, relative, t, is_within, *means))
    return Comparison(
        tuple(differences),
        tuple(name for name in left if name not in partners),
        tuple(name for name in right if name not in partners.values()),
        start,
        stop,
        len(pair.times),
        pair.is_interpolated,
        float(tolerance),
        tuple(_notes(a, b)),
    )


def _partners(left: Collection[str], right: Collection[str], names: Mapping[str, str]) -> dict[str, str]:
    """Return the elements that both have: the name of each in B, by its name in A.

    Raises UsageError (E501) for a pair of names of which one side lacks its own.
    """
    if not isinstance(names, Mapping) or not all(isinstance(text, str) for pair in names.items() for text in pair):
        cure = 'Example: names={"motor.omega": "speed"}.'
        raise UsageError(Fault("E501", "names", "must be a mapping from names in A to names in B.", cure))
    partners = {name: name for name in left if name in right}
    for ours, theirs in names.items():
        for name, known, side in ((ours, left, "A"), (theirs, right, "B")):
            if not any(_rest(each, name) is not None for each in known):
                cure = did_you_mean(name, known) or f"Signals: {', '.join([*known][:20])}."
                raise UsageError(Fault("E501", "names", f"there is no signal {quoted(name)} in {side}.", cure))
        renamed = {each: theirs + rest for each in left if (rest := _rest(each, ours)) is not None}
        pairs = {each: other for each, other in renamed.items() if other in right}
        if not pairs:
            what = f"{quoted(ours)} in A and {quoted(theirs)} in B have no elements in common."
            raise UsageError(Fault("E501", "names", what, "Name two signals of one size, or two elements."))
        taken = pairs.values()
        partners = {each: other for each, other in partners.items() if each not in renamed and other not in taken}
        partners |= pairs
    return {name: partners[name] for name in left if name in partners}


def _rest(element: str, name: str) -> str | None:
    """Return what follows a name in that of an element, port or block of it; None if it is none of these."""
    rest = element.removeprefix(name)
    return rest if element.startswith(name) and (not rest or rest[0] in ".[") else None


def _span(a: Results, b: Results, common: list[str]) -> tuple[float, float]:
    """The interval that both have. Raises UsageError (E505) where there is nothing to compare."""
    for side, results in (("A", a), ("B", b)):
        if not len(results.t):
            raise UsageError(Fault("E505", f"{side} ({results.diagram})", "holds no rows."))
    if not common:
        names = [", ".join([name for name, _, _ in results.flat_columns()][:5]) or "none" for results in (a, b)]
        cure = f"A has {names[0]}; B has {names[1]}."
        raise UsageError(Fault("E505", "compare", "A and B have no signal in common.", cure))
    start, stop = max(float(a.t[0]), float(b.t[0])), min(float(a.t[-1]), float(b.t[-1]))
    if start > stop:
        spans = [f"{results.t[0]:g} ... {results.t[-1]:g} s" for results in (a, b)]
        message = f"A and B have no time in common: A covers {spans[0]}, and B covers {spans[1]}."
        raise UsageError(Fault("E505", "compare", message))
    return start, stop


def _moved(values: Array, factor: float, offset: float) -> Array:
    values = values * factor if factor != 1.0 else values
    return values + offset if offset else values


def _factors(pairs: Mapping[str, tuple[str, str]]) -> dict[str, tuple[float, float]]:
    """What B's values are multiplied with, and what is added then.

    Raises UsageError (E505) for all signals that are different quantities.
    """
    factors: dict[str, tuple[float, float]] = {}
    faults = []
    for name, (ours, theirs) in pairs.items():
        if ours == theirs:
            factors[name] = (1.0, 0.0)
            continue
        try:
            if units.same_quantity(ours, theirs):
                factors[name] = units.affine(theirs, ours)
            else:
                message = f"is in {ours} in A and in {theirs} in B, which are different quantities."
                faults.append(Fault("E505", name, message))
        except BlocksError as error:
            faults.append(Fault("E505", name, f"cannot be converted: {error.faults[0].message}"))
    if faults:
        raise UsageError(*faults)
    return factors


class _SideRows:
    """The values of one side at given times: rows, and lines between rows."""

    def __init__(self, t: Array, times: Array) -> None:
        self.last = np.searchsorted(t, times, side="right") - 1  # of several rows at one time, the right value
        self.first = np.searchsorted(t, times, side="left")
        self.is_row = t[self.first] == times
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            self.share = (times - t[self.last]) / (t[self.first] - t[self.last])

    def sides(self, values: Array) -> tuple[Array, Array]:
        """The left and the right values."""
        before, after = values[self.last], values[self.first]
        between = (1.0 - self.share) * before + self.share * after
        return np.where(self.is_row, after, between), np.where(self.is_row, before, between)


class _Pair:
    """The times of A and B over the interval [start, stop], and the difference of two signals over them."""

    def __init__(self, a: Array, b: Array, start: float, stop: float) -> None:
        self.is_interpolated = not np.array_equal(a, b)
        self.times = a
        if not self.is_interpolated:
            return
        both = np.union1d(a, b)
        self.times = both[(both >= start) & (both <= stop)]
        self.a, self.b = _SideRows(a, self.times), _SideRows(b, self.times)
        # Where one begins or ends within the other, it has only the inner side of a jump there.
        self.skipped = (a[0] != b[0], a[-1] != b[-1])

    def difference(self, a: Array, b: Array) -> tuple[float, float, float, float, float]:
        """Return the largest difference, the same as a part of a's range, the time, the RMSE and the fit in %."""
        with np.errstate(invalid="ignore", over="ignore"):
            if self.is_interpolated:
                (a_left, a_right), (b_left, b_right) = self.a.sides(a), self.b.sides(b)
                if self.skipped[0]:
                    a_left[0], b_left[0] = a_right[0], b_right[0]
                if self.skipped[1]:
                    a_right[-1], b_right[-1] = a_left[-1], b_left[-1]
                times, a, b = (np.stack(sides, 1).ravel() for sides in
                               ((self.times, self.times), (a_left, a_right), (b_left, b_right)))  # fmt: skip
            else:
                times = self.times
            far = np.abs(a - b)
            odd = ~(np.isfinite(a) & np.isfinite(b))
            if odd.any():
                return math.nan, math.nan, float(times[odd].min()), math.nan, math.nan
            at = int(np.argmax(far))
            rmse, spread = _mean_square_root(times, far), _spread(times, a)
            fit = 100.0 * (1.0 - rmse / spread) if spread else 100.0 if rmse == 0.0 else -math.inf
            return float(far[at]), _relative(float(far[at]), a), float(times[at]), rmse, fit


def _mean_square_root(t: Array, y: Array) -> float:
    """Return the root of the mean square over time of lines between rows; of one time, of its rows."""
    scale = float(np.max(np.abs(y)))
    if not 0.0 < scale < math.inf:
        return scale
    y, span = y / scale, float(t[-1] - t[0])
    if not span:
        return scale * float(np.sqrt(np.mean(y * y)))
    whole = np.sum(np.diff(t) / span * (y[:-1] * y[:-1] + y[:-1] * y[1:] + y[1:] * y[1:]) / 3.0)
    return scale * math.sqrt(float(whole))


def _spread(t: Array, y: Array) -> float:
    """Return the root of the mean square over time of a signal around its mean; 0 for a constant with rounding."""
    span = float(t[-1] - t[0])
    mean = float(np.sum(np.diff(t) / span * (y[:-1] / 2.0 + y[1:] / 2.0))) if span else float(np.mean(y))
    spread = _mean_square_root(t, y - mean)
    return spread if spread > FLAT * float(np.max(np.abs(y))) else 0.0


def _relative(far: float, a: Array) -> float:
    if far == 0.0:
        return 0.0
    # In halves, as a range may be larger than the largest double.
    low, high = float(a.min()) / 2.0, float(a.max()) / 2.0
    magnitude = max(abs(low), abs(high))
    scale = high - low if high - low > FLAT * magnitude else magnitude
    return far / 2.0 / scale if scale else math.inf


def _notes(a: Results, b: Results) -> list[str]:
    """What is known to be different about the two runs."""
    notes = []
    if a.diagram != b.diagram:
        notes.append(f"diagrams: {a.diagram} | {b.diagram}")
    if a.statistics.engine != b.statistics.engine:
        notes.append(f"engines: {a.statistics.engine or 'unknown'} | {b.statistics.engine or 'unknown'}")
    for side, digest_a in (("A", a), ("B", b)):
        if digest_a.interrupted:
            notes.append(f"{side} was interrupted")
    if a.origin is None or b.origin is None:
        return notes
    texts = [name for name, kind in Origin.kinds().items() if kind is str]
    for name, what in zip(texts, ("diagrams", "equations", "values of all parameters"), strict=True):
        digest_a, digest_b = getattr(a.origin, name), getattr(b.origin, name)
        # Given parameters are reported one by one; results of older releases lack some.
        is_told = name == "values" and a.origin.parameters != b.origin.parameters
        if digest_a and digest_b and digest_a != digest_b and not is_told:
            notes.append(f"SHA-256 of the {what}: {digest_a[:12]} | {digest_b[:12]}")
    for section in (name for name, kind in Origin.kinds().items() if kind is dict):
        ours, theirs = getattr(a.origin, section), getattr(b.origin, section)
        for key in dict.fromkeys((*ours, *theirs)):
            if ours.get(key) != theirs.get(key):
                notes.append(f"{section}: {key} {_shown(ours.get(key))} | {_shown(theirs.get(key))}")
    return notes


def _shown(value: object) -> str:
    if isinstance(value, Mapping):
        if "sha256" in value:
            return f"SHA-256 {str(value['sha256'])[:12]}"
        return f"{value.get('value')} {value.get('unit', '')}".strip()
    return "-" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
