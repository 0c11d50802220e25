"""Parameters of a diagram from measured data: least squares, with what the data say about each of them.

    fit = diagram.fit("step.csv", over={"motor.Ra": (0.05, 0.5), "Jeq": (0.1, 1)}, compare={"motor.omega": "omega"})
    fit.write("motor.json")

References:
    G. A. F. Seber, C. J. Wild, Nonlinear Regression, Wiley, 1989, chapters 2 and 5.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..api.case import Case, sources
from ..model.block_signals import element_of
from ..model.flatten import Flat
from ..model.variants import taken
from ..model.varied import columns_of, raw_values
from ..results import plots
from ..results.results import Results
from ..text import units
from ..text.arrays import Array
from ..text.csv_text import read_columns
from ..text.errors import Fault, ModelError, SimulationError, UsageError, did_you_mean
from ..text.json_number import is_number
from ..text.printable import legible
from ..text.rich_output import Table
from .outcome import Outcome, panel_of, short, unit_of
from .search_space import DIGITS, Space, units_of_parameters

if TYPE_CHECKING:
    from ..api.diagram import Diagram

STEP = 1e-3
"""Of central differences, in parts of the range of a value: far above the errors of steps at usual tolerances."""
FAILED = 1e3
"""The residual of a run that fails, in deviations of the data: worse than any that does not."""
MOST_ROUNDS, RESTING = 50, 1e-3
"""The weights of several signals follow from a fit with the last ones, until they change by less than this part."""
EXACT = 1e-9
"""The least deviation of residuals, in parts of that of the data: those of data without noise would have no end."""
NEAR = 1e-3
"""How far the row of a datum may be from its time, in parts of the spacing of the data."""
LARGEST = 1e100
"""The largest number in data: sums of squares of larger ones overflow."""
LONG = 1000.0
"""Before the data a run may take so many times the duration of the data, unless its start is given."""
ALIKE, NEARLY = 0.99, 0.05
"""From this correlation of two estimates on, or below this least singular value of the Jacobian with columns of length
1, they are told not to be told apart."""


@dataclass(frozen=True, repr=False, kw_only=True)
class Fit(Outcome):
    """The outcome of `Diagram.fit`, for k parameters and n samples; its values are the estimates.

    errors: standard errors.
    intervals: the ends of the confidence intervals (`level`). correlation: (k, k), of the estimates. deviations: by
    signal, that of the residuals, which the intervals take for white noise. measured: by signal (n,), at t (n,).
    before, after: the runs with the diagram's own values and with the estimates.
    """

    errors: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    level: float
    correlation: Array
    deviations: Mapping[str, float]
    t: Array
    measured: Mapping[str, Array]
    before: Results
    after: Results

    def tables(self) -> dict[str, Table]:
        head = ("parameter", "before", "estimate", "unit", f"{100 * self.level:g} % interval", "correlation")
        names, rows = list(self.values), list[tuple[str, ...]]()
        for i, (name, value) in enumerate(self.values.items()):
            others = [(abs(c), names[j], c) for j, c in enumerate(self.correlation[i].tolist()) if j != i]
            most = max((other for other in others if not math.isnan(other[0])), default=None)
            [digits] = _digits(np.array([value]), np.array([self.errors[name]]), least=5, more=2)
            estimate, *ends = (f"{x:.{digits}g}" for x in (value, *self.intervals[name]))
            rows.append(self.row(name, estimate, ends, f"{most[2]:+.3f} with {most[1]}" if most else "-"))
        signals = [("signal", "deviation of residuals"), *((name, short(x)) for name, x in self.deviations.items())]
        return {"Values": Table([head, *rows]), "Residuals": Table(signals)}

    def plot(self) -> Any:
        """A matplotlib figure: data, the diagram before and after, and the residuals."""
        parts = []
        for name, data in self.measured.items():
            parts.append(panel_of(name, self.before, self.after, "fit", plots.Line(self.t, data, "data", 4, "points")))
            label = f"data - fit{unit_of(self.after[name])}"
            rest = plots.Line(self.t, data - at_times(self.after, name, self.t), label, 4, "points")
            parts.append(plots.Panel((rest,), label))
        return plots.panels(parts, xlabel="time [s]")


def fit(
    diagram: Diagram,
    data: str | Path | Mapping[str, object],
    case: Case,
    *,
    over: Mapping[str, tuple[float, float]],
    compare: Mapping[str, str],
    level: float,
) -> Fit:
    """Return what `Diagram.fit` gives."""
    from scipy import stats

    chosen = case.only("parameters", "variants")
    space = Space.of(over, units_of_parameters(diagram, chosen))
    if not isinstance(compare, Mapping):
        raise UsageError(
            Fault("E501", "compare", "must be a mapping from signals to columns.", 'Example: {"motor.omega": "omega"}.')
        )
    if not is_number(level) or not 0 < level < 1:
        raise UsageError(
            Fault("E501", "level", f"must be a number between 0 and 1, such as 0.95, not {legible(repr(level))}.")
        )
    columns, given = _columns(data, diagram, compare)
    value, flat = taken(diagram.value, case.variants), diagram.flatten(chosen)
    varied = columns_of(list(over), flat)
    t = columns["time"]
    measured = {name: _in_si(columns[column], given.get(column, ""), flat, name) for name, column in compare.items()}
    tracks: dict[str, object] = {}
    for name in value.inputs:
        if name in columns:
            u = {"value": columns[name], "unit": given[name]} if given.get(name) else columns[name]
            tracks[name] = (t, u, case.interpolation)
    grid, early = _grid(diagram, t, case.settings), _early(diagram, t, [*tracks], case.settings)
    for name in tracks:
        if any(isinstance(source, Mapping) and name in source for source in sources(case.inputs)):
            message = f"{name} is given, and the data have a column of it, too."
            raise UsageError(Fault("E501", "inputs", message, "Leave it out, or take the column out of the data."))
    inputs = [*sources(case.inputs), tracks]
    model = diagram.prepare(case.without("inputs"), inputs=inputs, log=list(compare), **grid)

    def run(values: Array | None) -> Results:
        return model.run(parameters={} if values is None else raw_values(varied, values.tolist()))

    before, residuals = run(None), _Residuals(run, space, t, measured)
    for name, column in compare.items():
        _check_compared(name, column, before, residuals, len(over))
    start = np.clip(space.cube(np.array([column.value for column in varied])), STEP, 1 - STEP)
    found, spare, deviations, is_at_rest = residuals.least(start)
    names = list(over)
    free = len(found.fun) - len(names)
    # Slopes in the units of the values; the residuals have the deviation s.
    slopes = residuals.jacobian(found.x) / space.slopes(found.x)
    s = math.sqrt(float(found.fun @ found.fun) / free) if free > 0 else math.inf
    errors, correlation, alike = _judged(slopes, s)
    values = space.values(found.x, digits=_digits(space.values(found.x), errors))
    after, degrees = run(values), _degrees(slopes, residuals.ends, [*spare.values()])
    reach = np.where(degrees > 0, stats.t.ppf(0.5 + level / 2, np.where(degrees > 0, degrees, 1.0)), math.inf)
    warnings = [*early, *alike_faults(names, alike)]
    if not is_at_rest:
        message = f"the weights of the signals did not converge in {MOST_ROUNDS} fits: the intervals may be too narrow."
        cure = "Compare fewer signals, or start nearer to the solution."
        warnings.append(Fault("W502", "compare", message, cure))
    ends_of = zip(names, values, space.low, space.high, found.active_mask.tolist(), strict=True)
    for name, value, low, high, bound in ends_of:
        if bound or value in (low, high):
            end = "lower" if bound < 0 or value == low else "upper"
            message = f"the best value lies at the {end} bound, so that the interval is meaningless."
            warnings.append(Fault("W502", name, message, "Widen the bounds, or fix the parameter."))
    given = raw_values(varied, values.tolist())
    return Fit(
        diagram=diagram, values=dict(zip(names, values.tolist(), strict=True)),
        nominal={c.name: c.value for c in varied}, units={c.name: c.unit for c in varied},
        errors=dict(zip(names, errors.tolist(), strict=True)),
        intervals={
            name: (float(x - r * e), float(x + r * e))
            for name, x, r, e in zip(names, values, reach, errors, strict=True)
        },
        level=level, correlation=correlation, deviations=deviations, t=t, measured=measured, before=before, after=after,
        parameters=given, targets={c.name: tuple(target.path for target in c.targets) for c in varied},
        variants=dict(case.variants), warnings=tuple(warnings),
    )  # fmt: skip


class _Residuals:
    """Weighed residuals of the compared signals, at points of the cube of values; FAILED where a run fails.

    run: gives the results of values (k,). measured: by signal (n,), in SI, at t (n,) in s; nan: no value.
    """

    def __init__(
        self, run: Callable[[Array], Results], space: Space, t: Array, measured: Mapping[str, Array]
    ) -> None:
        self.run, self.space, self.t, self.measured = run, space, t, measured
        self.known = {name: np.isfinite(data) for name, data in measured.items()}
        self.counts = [int(np.count_nonzero(each)) for each in self.known.values()]
        self.ends = np.cumsum(self.counts)[:-1]
        self.weights = dict.fromkeys(measured, 1.0)
        for name, known in self.known.items():
            if known.any():
                self.weights[name] = 1.0 / (float(np.std(measured[name][known])) or 1.0)

    def __call__(self, cube: Array) -> Array:
        try:
            results = self.run(self.space.values(np.clip(cube, 0.0, 1.0), digits=17))
        except SimulationError:
            return np.full(sum(self.counts), FAILED)
        rest = [
            (at_times(results, name, self.t) - data)[self.known[name]] * self.weights[name]
            for name, data in self.measured.items()
        ]
        return np.nan_to_num(np.concatenate(rest), nan=FAILED)

    def jacobian(self, cube: Array) -> Array:
        """Return central differences (n, k)."""
        low, high = np.clip(cube - STEP, 0.0, 1.0), np.clip(cube + STEP, 0.0, 1.0)
        columns = []
        for k in range(len(cube)):
            a, b = cube.copy(), cube.copy()
            a[k], b[k] = low[k], high[k]
            columns.append((self(b) - self(a)) / (high[k] - low[k]))
        return np.array(columns).T

    def least(self, start: Array) -> tuple[Any, dict[str, float], dict[str, float], bool]:
        """Find the least squares, with weights that follow from the fit before until they rest.

        Return SciPy's result, by signal the spare degrees of freedom and the deviation, and whether the weights rest.
        """
        from scipy import optimize

        smallest = {name: EXACT / weight for name, weight in self.weights.items()}
        for _ in range(MOST_ROUNDS):
            found = optimize.least_squares(self, start, self.jacobian, bounds=(0.0, 1.0), x_scale="jac")
            leverage = [float(np.sum(part)) for part in np.split(_leverages(found.jac), self.ends)]
            spare = {name: each.sum() - used for (name, each), used in zip(self.known.items(), leverage, strict=True)}
            parts = zip(spare.items(), np.split(found.fun, self.ends), strict=True)
            deviations = {name: _deviation(part, free) / self.weights[name] for (name, free), part in parts}
            if len(self.measured) == 1:
                return found, spare, deviations, True
            old, start = self.weights, np.clip(found.x, STEP, 1 - STEP)
            new = {name: 1.0 / max(x, smallest[name]) if x >= 0 else old[name] for name, x in deviations.items()}
            if all(abs(new[name] / old[name] - 1.0) < RESTING for name in new):
                return found, spare, deviations, True  # the weights stay those of the residuals that were found
            self.weights = new
        return found, spare, deviations, False


def _check_compared(name: str, column: str, before: Results, residuals: _Residuals, count: int) -> None:
    """Raise UsageError (E501) for a signal or a column that cannot be compared. count: of parameters."""
    if before[name].ndim != 1:
        message = "is a vector, but only single numbers can be compared."
        raise UsageError(Fault("E501", legible(str(name)), message, f'Compare its elements: "{name}[0]".'))
    known = sum(residuals.counts) if residuals.known[name].any() else 0
    if known < count:
        message = f"has {known} values, too few for {count} parameters."
        raise UsageError(Fault("E501", legible(str(column)), message, "Give data with more rows."))


def at_times(results: Results, name: str, t: Array) -> Array:
    """A recorded signal at times that the run has hit; nan after its end.

    The nearest row counts, by NEAR of the spacing of the times: of late clocks the spacing is far below a part of t.
    """
    after = np.clip(np.searchsorted(results.t, t), 0, len(results.t) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(results.t[before] - t) < np.abs(results.t[after] - t), before, after)
    nearest = np.searchsorted(results.t, results.t[nearest])  # the first row of an instant, before its jump
    step = np.diff(t)
    spacing = np.minimum(np.r_[step, step[-1]], np.r_[step[0], step])
    near = np.abs(results.t[nearest] - t) <= NEAR * spacing
    return np.where(near, np.asarray(results[name])[nearest], np.nan)


def _deviation(rest: Array, spare: float) -> float:
    """Return the deviation of residuals, by their spare degrees of freedom; nan where there are none."""
    return math.sqrt(float(rest @ rest) / spare) if spare > 1e-6 else math.nan


def _leverages(slopes: Array) -> Array:
    """Return how many degrees of freedom each residual (n,) gives to the estimates: the diagonal of the hat matrix."""
    left, singular, _ = np.linalg.svd(slopes, full_matrices=False)
    return np.asarray(np.sum(left[:, singular > 1e-12 * max(singular, default=0.0)] ** 2, axis=1))


def _degrees(slopes: Array, ends: Array, spare: Sequence[float]) -> Array:
    """Return the degrees of freedom (k,) of the errors, of which each signal gives its part (Satterthwaite).

    A quiet signal of few samples may determine a parameter by itself: its degrees count then, and not those of all.
    """
    sizes = np.linalg.norm(slopes, axis=0)
    shares = np.linalg.pinv(slopes / np.where(sizes > 0, sizes, 1.0)) ** 2
    parts = np.array([part.sum(axis=1) for part in np.split(shares, ends, axis=1)])
    with np.errstate(all="ignore"):
        degrees = parts.sum(axis=0) ** 2 / np.sum(parts**2 / np.maximum(spare, 0.0)[:, None], axis=0)
    return np.where(np.isfinite(degrees), degrees, float(np.sum(spare)))


def _digits(values: Array, errors: Array, *, least: int = DIGITS, more: int = 3) -> list[int]:
    """Return how many significant digits estimates have: rounding must be far below their errors."""
    with np.errstate(all="ignore"):
        needed = np.ceil(np.log10(np.abs(values) / errors)) + more
    return [int(min(max(each, least), 17)) if np.isfinite(each) else least for each in needed]


def _judged(slopes: Array, s: float) -> tuple[Array, Array, list[list[int]]]:
    """Standard errors (k,), correlations (k, k) and the groups of estimates that cannot be told apart."""
    sizes = np.linalg.norm(slopes, axis=0)
    k = len(sizes)
    errors, correlation = np.full(k, math.inf), np.full((k, k), math.nan)
    np.fill_diagonal(correlation, 1.0)
    groups: list[set[int]] = []
    seen = np.flatnonzero(sizes > 0)
    blind = [[i] for i in np.flatnonzero(sizes == 0).tolist()]
    if not len(seen):
        return errors, correlation, blind
    _, singular, directions = np.linalg.svd(slopes[:, seen] / sizes[seen], full_matrices=False)
    singular = np.maximum(singular, 1e-12)
    covariance = (directions.T / singular**2) @ directions
    own = np.sqrt(np.diag(covariance))
    errors[seen] = s * own / sizes[seen]
    correlation[np.ix_(seen, seen)] = covariance / np.outer(own, own)
    for value, direction in zip(singular, directions, strict=True):
        if value < NEARLY:
            groups.append({*seen[np.abs(direction) > 0.3].tolist()})
    groups += [{int(i), int(j)} for i, j in zip(*np.where(np.triu(np.abs(correlation), 1) > ALIKE), strict=True)]
    joined: list[set[int]] = []
    for group in groups:
        touched = [other for other in joined if other & group]
        joined = [*(other for other in joined if not other & group), group.union(*touched)]
    return errors, correlation, blind + [sorted(group) for group in joined]


def alike_faults(names: Sequence[str], groups: Sequence[Sequence[int]]) -> list[Fault]:
    """W502 for each group of estimates that the data do not determine."""
    faults = []
    for group in groups:
        told = [names[i] for i in group]
        if len(told) == 1:
            message = "has no effect on the compared signals."
            faults.append(Fault("W502", told[0], message, "Leave the parameter out, or compare another signal."))
            continue
        message = (
            f"cannot be determined separately from {', '.join(told[1:])}: different values give nearly the same data."
        )
        cure = "Fix one of them, compare another signal too, or excite the diagram in another way."
        faults.append(Fault("W502", told[0], message, cure))
    return faults


def _early(diagram: Diagram, t: Array, recorded: Sequence[str], settings: Mapping[str, object]) -> list[Fault]:
    """W505 where the run holds the first recorded inputs for a while before the data begin, and nobody asked for it.

    Raises UsageError (E501) where it would do so for far longer than the data last.
    """
    if "start" in settings or "start" in diagram.value.run:
        return []
    start, first = float(diagram.flatten().settings.start), float(t[0])
    wait, length = first - start, float(t[-1] - t[0])
    cure = f"Give start={first!r}, subtract the first time from all times, or give start={start:g} to confirm."
    if wait > LONG * length:
        message = (
            f"the data begin at {first:.12g} s and last {length:g} s, but the run begins at {start:g} s, long before."
        )
        raise UsageError(Fault("E501", "time", message, cure))
    if not recorded or wait <= 1.5 * float(np.max(np.diff(t))):
        return []
    message = (
        f"the data begin at {first:.12g} s and the run at {start:g} s: until then the run holds the first value of "
        f"{legible(', '.join(recorded[:3]))} for {wait:g} s."
    )
    return [Fault("W505", "time", message, cure)]


def _grid(diagram: Diagram, t: Array, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings by which a run hits the times of the data. Raises UsageError (E501)."""
    for key in ("stop", "every", "stops", "log"):
        if key in settings:
            raise UsageError(Fault("E501", key, "cannot be given: the data determine it.", f"Leave {key} out."))
    given = {"start": settings["start"]} if "start" in settings else {}
    start = float(diagram.flatten(**given).settings.start)
    step = np.diff(t)
    if t[0] < start or not np.all(step > 0):
        message = f"times must increase, and the first must not lie before the start of the run at {start:g} s."
        raise UsageError(Fault("E501", "time", message, "Sort the rows, or give an earlier start=..."))
    stop = float(t[-1])
    every = _period(t)
    first = (float(t[0]) - start) / (every or 1.0)
    is_even = every is not None and abs(first - round(first)) < 1e-6 and first < len(t)
    return {"stop": stop, "every": every, "stops": []} if is_even else {"stop": stop, "stops": t.tolist()}


def _period(t: Array) -> float | None:
    """Return the period of even times, the shortest decimal within their rounding; None where they are uneven."""
    k, last = np.arange(len(t)), float(t[-1])
    mean = (last - float(t[0])) / (len(t) - 1)
    close = 1e-6 * mean + 2 * float(np.spacing(max(abs(last), abs(float(t[0])))))
    for digits in range(1, 17) if close < 0.5 * NEAR * mean else ():
        every = float(f"{mean:.{digits}g}")
        if every > 0 and np.all(np.abs(t - t[0] - every * k) < close):
            return every
    return None


def _in_si(column: Array, unit: str, flat: Flat, name: str) -> Array:
    """Return measured values of a signal in SI. unit: the unit of the column; "": the declared unit of the signal.

    Raises UsageError (E501).
    """
    signal = element_of(name, flat.signals)
    declared = "" if signal is None else signal.declared_unit
    return _converted(column, unit or declared, units.si_text(declared or unit), name)


def _converted(column: Array, unit: str, to: str, name: str) -> Array:
    """Raises UsageError (E501) for a unit of another quantity."""
    try:
        factor, offset = units.affine(unit, to)
        return column * factor + offset if offset else column * factor
    except ModelError as error:
        raise UsageError(*(Fault("E501", legible(name), fault.message, fault.cure) for fault in error.faults)) from None


def _columns(data: Any, diagram: Diagram, compare: Mapping[str, str]) -> tuple[dict[str, Array], dict[str, str]]:
    """The columns of the data that count, as floats, and the units that the data give. Raises UsageError (E501)."""
    place = str(data) if isinstance(data, (str, Path)) else "data"
    given: dict[str, str] = {}
    needed = ["time", *compare.values()]
    if isinstance(data, (str, Path)):
        try:
            with open(data, encoding="utf-8", newline="") as stream:
                names, rows = read_columns(stream, ["time"], units=given)
        except (OSError, ValueError) as error:
            what = error.strerror if isinstance(error, OSError) else str(error)
            raise UsageError(Fault("E501", place, f"cannot be read: {what}")) from None
        table: Mapping[str, object] = dict(zip(names, rows.T, strict=True))
    else:
        quantities = {str(name): raw for name, raw in data.items() if isinstance(raw, Mapping) and "value" in raw}
        given = {name: str(raw.get("unit", "")) for name, raw in quantities.items()}
        table = {**data, **{name: raw["value"] for name, raw in quantities.items()}} if quantities else data
    known = [str(name) for name in table]
    faults = []
    for name in needed:
        if name not in known:
            cure = did_you_mean(name, known) or f"Columns: {', '.join(known[:20])}."
            faults.append(Fault("E501", place, f"has no column {legible(name)}.", cure))
    if not compare:
        faults.append(Fault("E501", "compare", "contains no signal.", 'Example: compare={"motor.omega": "omega"}.'))
    if faults:
        raise UsageError(*faults)
    wanted = {*needed, *(name for name in diagram.value.inputs if name in known)}
    try:
        columns = {name: np.asarray(table[name], dtype=float) for name in known if name in wanted}
    except (TypeError, ValueError) as error:
        raise UsageError(
            Fault("E501", place, f"contains a value that is not a number: {legible(str(error))}.")
        ) from None
    for name, column in columns.items():
        if column.shape != columns["time"].shape or column.ndim != 1:
            message = f"has {column.shape} values in its column {legible(name)}, but {columns['time'].shape} times."
            raise UsageError(Fault("E501", place, message, "Give one value for each time."))
    for name, column in columns.items():
        wrong = np.flatnonzero(np.isinf(column) | (np.abs(column) > LARGEST))
        if len(wrong) and name != "time":
            message = f"has {column[wrong[0]]:g} in its column {legible(name)}, row {wrong[0] + 1}."
            cure = f"Values must not exceed {LARGEST:g}. Write nan for missing values, or leave out these rows."
            raise UsageError(Fault("E501", place, message, cure))
    if len(columns["time"]) < 2 or not np.isfinite(columns["time"]).all():
        raise UsageError(Fault("E501", place, "has fewer than two rows, or a time that is not a number."))
    if unit := given.pop("time", ""):
        columns["time"] = _converted(columns["time"], unit, "s", "time")
    return columns, given
