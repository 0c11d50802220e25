"""Where diagrams rest, found or taken from a run, and how they oscillate about it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from ..api.case import Case, ModelWords, PointWords, case_of, takes
from ..api.diagram import Diagram
from ..api.given_values import at_rest
from ..compile.coupling import Coupling, couple
from ..linear.limit_cycles import LimitCycles
from ..linear.limit_cycles import limit_cycles as of_linearizer
from ..linear.operating_point import Free, OperatingPoint, Quantity, declared_unit, search, standing
from ..model.flatten import Flat
from ..model.values import in_si
from ..text import units
from ..text.errors import AnalysisError, Fault, UsageError, check_mappings

if TYPE_CHECKING:
    from ..api.run import Run

SETTLED = 1e-6
"""How much an output may still change, relative to its size, where FMUs of Co-Simulation are left to settle."""
_MOST = 8  # times that a settling run goes on, twice as far each time


@takes(ModelWords)
def find_operating_point(
    diagram: Diagram,
    case: Case | None = None,
    *,
    inputs: Mapping[str, object] | None = None,
    states: Mapping[str, object] | None = None,
    outputs: Mapping[str, object] | None = None,
    steady: bool | Mapping[str, float | None] = True,
    at: float | None = None,
    check: Callable[[], None] | None = None,
    **words: Unpack[ModelWords],
) -> OperatingPoint:
    """Where a diagram rests.

    inputs: by name, in the unit that the diagram declares, a number: known; None, (low, high) or Free(guess, min, max):
    to be found. Those that are not named have their default, or 0. states, outputs: the same, in their declared units;
    states that are not named are free. An output that is given as (low, high) is to lie between. steady: True: every
    state rests and no tick changes anything; {name: rate}: these have that rate, in the declared unit per second (None:
    any), all others rest; False: nothing is asked. Quantities such as "2 rpm" are in their own units.
    at: the time in s of a run from which the search begins (the start, unless given). case, words: as of `Diagram.run`.
    check: called again and again
    during the search, which ends with whatever it raises.

    FMUs for Model Exchange take part as other blocks do. With FMUs for Co-Simulation the diagram is run until its
    outputs settle; only inputs can then be given, as numbers.

    Raises AnalysisError (E702), which reports what remains by block, UsageError (E501).
    """
    chosen = case_of(case, words, ModelWords)
    check_mappings(inputs=inputs)
    inputs = {**chosen.named_inputs(), **(inputs or {})}
    for name, raw in inputs.items():
        if isinstance(raw, tuple) and any(np.ndim(item) > 0 for item in raw):
            cure = "Give a number, or bounds (low, high) between which it is searched."
            raise UsageError(Fault("E501", f"inputs.{name}", "is a table over time, which has no value at rest.", cure))
    chosen = chosen.only(*ModelWords.__annotations__)
    flat = diagram.flatten(chosen)
    if _is_coupled(flat):
        return _settled(diagram, flat, inputs, bool(states or outputs), chosen, check)
    declared = {name: str(entry.get("unit", "")) for name, entry in diagram.value.inputs.items()}
    point = diagram.point(chosen, at=at)
    given = {name: _in_si(name, raw, declared.get(name.partition("[")[0], "")) for name, raw in inputs.items()}

    def by_signal(table: object, of_time: str = "") -> Any:
        """The numbers of states or outputs in SI; what is no mapping is refused by the search."""
        if not isinstance(table, Mapping):
            return table
        unit_of = {name: declared_unit(point.plan, str(name)) for name in table}
        if of_time:
            unit_of = {name: units.quotient(units.difference(unit), of_time) for name, unit in unit_of.items()}
        return {name: _in_si(str(name), raw, unit_of[name]) for name, raw in table.items()}

    return search(
        point, inputs=given, states=by_signal(states), outputs=by_signal(outputs), steady=by_signal(steady, "s"),
        told=flat.log, check=check,
    )  # fmt: skip


@takes(PointWords)
def operating_points(
    diagram: Diagram,
    times: Iterable[float],
    case: Case | None = None,
    **words: Unpack[PointWords],
) -> tuple[OperatingPoint, ...]:
    """Where a run of a diagram stands at times in s. Arguments as of `Diagram.point`.

    With FMUs for Co-Simulation, which hide their states, the points hold inputs and outputs.
    """
    wanted = [float(time) for time in times]
    case = case_of(case, words, PointWords)
    flat = diagram.flatten(case)
    if not _is_coupled(flat):
        return tuple(standing(diagram.point(case, at=time), flat.log) for time in wanted)
    inputs = Case(inputs=at_rest(diagram.value, flat)).updated(inputs=case.inputs).inputs
    first = Case(stop=max(wanted, default=0.0), stop_when="")
    run = diagram.start(first.updated(**case.without("inputs").words), inputs=inputs)
    points: dict[float, OperatingPoint] = {}
    for time in sorted(wanted):
        run.advance_to(time)
        points[time] = _as_told(diagram, run, list(run.plan.log))
    return tuple(points[time] for time in wanted)


@takes(PointWords)
def limit_cycles(
    diagram: Diagram,
    case: Case | None = None,
    *,
    at: OperatingPoint | Run | float | None = None,
    omega: tuple[float, float] | None = None,
    amplitude: tuple[object, object] | None = None,
    check: Callable[[], None] | None = None,
    **words: Unpack[PointWords],
) -> LimitCycles:
    """The limit cycles of a diagram around an operating point, by harmonic balance, with their stability.

    omega: where to look, in rad/s (from the poles, unless given). amplitude: of the signal of the first law, in its
    declared unit, or quantities such as "2 rpm" (1e-9 to 1e3 in SI, unless given).
    check: called again and again during the search, which ends with whatever it raises.
    case, at, words: as of `Diagram.linearizer`. Of a sampled diagram also the cycle of two
    periods, which is exact. Raises AnalysisError: E704 (a law that moves the mean), E705 (no law in a loop, or a point
    at which what stands between the laws is not at rest).
    """
    return of_linearizer(diagram.linearizer(case, at=at, **words), omega=omega, amplitude=amplitude, check=check)


def _is_coupled(flat: Flat) -> bool:
    """Whether a master steps it. Raises ModelError with all static faults."""
    return isinstance(couple(flat), Coupling)


def _in_si(name: str, value: object, declared: str) -> object:
    """Return what was given for a quantity in SI: a number, bounds, or a list with one for each element."""
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, Free):
        guess = None if value.guess is None else in_si(value.guess, declared, name)
        low, high = in_si((value.min, value.max), declared, name)
        return replace(value, guess=guess, min=low, max=high)
    if isinstance(value, (list, np.ndarray)):
        return [_in_si(name, item, declared) for item in value]
    si = in_si(value, declared, name)
    return tuple(si) if isinstance(value, tuple) else si


def _settled(
    diagram: Diagram,
    flat: Flat,
    inputs: Mapping[str, object],
    is_more: bool,
    case: Case,
    check: Callable[[], None] | None,
) -> OperatingPoint:
    """Return the operating point at the end of a run, once nothing changes any more.

    is_more: whether states or outputs were asked for.
    """
    free = [name for name, value in inputs.items() if value is None or isinstance(value, (tuple, Free))]
    if free or is_more:
        message = "a diagram with Co-Simulation FMUs takes only numbers for its inputs: a run lets it settle."
        raise AnalysisError(Fault("E702", (free or [diagram.name])[0], message, 'Import the FMUs as "kind": "ME".'))
    held = {**at_rest(diagram.value, flat), **inputs}
    span = float(flat.settings.stop or 1.0)
    # Communication steps follow from the length of a run, and this one may become longer than intended.
    short = couple(diagram.flatten(case, stop=span))
    assert isinstance(short, Coupling)
    steps = {unit.path: float(unit.step) for unit in short.units}
    rest = steps.pop("", min(steps.values(), default=span))  # of what is no FMU
    master = {**case.settings.get("master", {}), "step": rest, "steps": steps}
    progress = None if check is None else lambda *_: check()
    run = diagram.start(case, inputs=held, stop=span * 2**_MOST, stop_when="", master=master, progress=progress)
    names = list(run.plan.log)
    moved: dict[str, float] = {}
    for k in range(_MOST + 1):
        run.advance_to(span * 2**k)
        results = run.results
        half = results.t >= 0.5 * run.t  # all of it: what comes back to where it was does not rest
        moved = {name: _change(np.asarray(results[name], dtype=float)[half]) for name in names}
        if k > 0 and max(moved.values(), default=0.0) <= SETTLED:
            return _as_told(diagram, run, names)
    worst = max(moved, key=lambda name: moved[name])
    message = f"does not settle within {run.t:g} s: it still changes by {moved[worst]:.2g}."
    cure = "Give a longer stop=, inputs at which the diagram can rest, or a shorter step of the master."
    raise AnalysisError(Fault("E702", worst, message, cure))


def _change(values: Any) -> float:
    """How far values move, relative to the last ones, or to 1 where these are smaller: (rows, ...)."""
    return float(np.max(np.ptp(values, axis=0) / np.fmax(1.0, np.abs(values[-1])), initial=0.0))


def _as_told(diagram: Diagram, run: Any, names: Sequence[str]) -> OperatingPoint:
    def told(name: str, role: str) -> list[Quantity]:
        values = np.ravel(run[name])
        unit = run.plan.signals[name].unit
        labels = [name] if len(values) == 1 else [f"{name}[{k}]" for k in range(len(values))]
        return [Quantity(label, float(x), unit, role) for label, x in zip(labels, values, strict=True)]

    given = tuple(quantity for name in diagram.value.inputs for quantity in told(name, "known"))
    return OperatingPoint(diagram.name, run.t, given, (), tuple(q for name in names for q in told(name, "computed")))
