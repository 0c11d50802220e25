"""Margins, poles and bandwidths of every row of a sweep: columns beside the measures of its runs.

    margins={"gm": {"type": "gain_margin", "loop": "control.u"},
             "pm": {"type": "phase_margin", "loop": "control.u", "amplitude": {"eso.e": 0.1}},
             "bandwidth": {"type": "bandwidth", "from": "r", "to": "motor.omega"}}

Each row is linearized with its own values. The diagram is prepared once (`Diagram.point`), so that a row costs some
milliseconds. A row whose margin is not known has nan, and its message says why.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..api.batch import Batch, BatchRows
from ..api.case import Case, PointWords
from ..frequency.disk import DiskMargins, disk_margins
from ..frequency.margins import Margins, margins
from ..frequency.response import bandwidth, poles
from ..linear.transfer import LoopOfRates, Transfer
from ..model.study_grammar import MARGIN
from ..text.arrays import Array
from ..text.errors import AnalysisError, BlocksError, Fault, ModelError, SimulationError, UsageError, did_you_mean
from ..text.grammar import Steps
from ..text.printable import legible

if TYPE_CHECKING:
    from ..api.diagram import Diagram
    from ..linear.harmonic_balance import Linearizer

_OF_POINT = ("at", "inputs", "amplitude", "sigma", "overrides")
_OF_LOOP = ("openings", "pade")
_BY_LOOP: Mapping[str, Callable[[Margins], float | None]] = {
    "gain_margin": lambda m: m.gain, "phase_margin": lambda m: m.phase_deg, "delay_margin": lambda m: m.delay,
    "modulus_margin": lambda m: m.modulus, "disk_margin": lambda m: m.disk, "Ms": lambda m: m.Ms,
    "Mt": lambda m: m.Mt, "crossover": lambda m: m.crossover, "bandwidth": lambda m: m.bandwidth,
}  # fmt: skip
_BY_CHANNELS: Mapping[str, Callable[[DiskMargins], float]] = {
    "disk_margin": lambda m: m.disk, "Ms": lambda m: m.Ms, "Mt": lambda m: m.Mt,
}  # fmt: skip
_UNITS = {
    "phase_margin": "deg", "delay_margin": "s", "crossover": "rad/s", "bandwidth": "rad/s", "slowest_pole": "1/s",
}  # fmt: skip
_ENDLESS = ("gain_margin", "phase_margin", "delay_margin")
"""Where a stable loop has none of these, it bears any more: inf."""


@dataclass(frozen=True, slots=True)
class Margin:
    """A column: its type (of MARGINS), and where it is taken: at a loop of some signals, or from one signal to another.

    point: of at, inputs, amplitude, sigma and overrides what is given; how: of openings and pade. As of
    `Diagram.linearizer` and `Linearizer.loop`.
    """

    name: str
    type: str
    loop: tuple[str, ...]
    ends: tuple[str, str]
    point: Mapping[str, Any] = field(default_factory=dict)
    how: Mapping[str, Any] = field(default_factory=dict)

    @property
    def unit(self) -> str:
        return _UNITS.get(self.type, "")

    def value(self, seen: _Row) -> float:
        """Its value. Raises AnalysisError where there is none."""
        if self.type in ("slowest_pole", "damping"):
            return _of_poles(self.type, seen.transfer(self))
        if not self.loop:
            width = bandwidth(seen.transfer(self))
            return np.inf if width is None else float(width)
        known, place = seen.margins(self), ", ".join(self.loop)
        if known.stable is None:
            message = "the stability of the closed loop is unknown, because delays lie on several of its paths."
            raise AnalysisError(Fault("E705", place, message, 'Replace the delays by Padé models: "pade": 3.'))
        if not known.stable:
            shown = ", ".join(f"{pole:.4g}" for pole in (known.unstable or known.border)[:3])
            words = "at the border of stability within rounding" if known.verdict == "border" else "not stable"
            message, cure = f"the closed loop is {words} (poles {shown}).", "Only stable loops have margins."
            raise AnalysisError(Fault("E705", place, message, cure))
        if isinstance(known, DiskMargins):
            if self.type not in _BY_CHANNELS:
                message, cure = f"has several channels, which have no {self.type}.", f"Use {', '.join(_BY_CHANNELS)}."
                raise UsageError(Fault("E501", place, message, cure))
            return float(_BY_CHANNELS[self.type](known))
        value = _BY_LOOP[self.type](known)
        if value is None and self.type in _ENDLESS and not (known.several_rates and self.type == "delay_margin"):
            return np.inf
        if value is None or np.isnan(value):
            what = (
                "a loop of several rates does not have this margin"
                if known.several_rates
                else "the loop does not have this margin"
            )
            raise AnalysisError(Fault("E705", place, f"{what} ({self.type}).", "Choose another margin."))
        return float(value)


def margins_of(given: Mapping[str, Mapping[str, object]]) -> tuple[Margin, ...]:
    """What `margins=` says, by the rules of study files. Raises UsageError (E501)."""
    made = []
    for name, entry in given.items():
        told = _Told()
        MARGIN.check(entry, (str(name),), told)
        if told.faults:  # a key that is not known tells more than that another one is missing
            raise UsageError(*(told.strays or told.faults))
        point = {key: entry[key] for key in _OF_POINT if key in entry}
        how = {key: entry[key] for key in _OF_LOOP if key in entry}
        ends = str(entry.get("from", "")), str(entry.get("to", ""))
        loop: Any = entry.get("loop", ())
        loop = (loop,) if isinstance(loop, str) else tuple(loop)
        made.append(Margin(str(name), str(entry["type"]), loop, ends, point, how))
    return tuple(made)


class _Told:
    """The faults of an entry, and those of them at its keys."""

    def __init__(self) -> None:
        self.faults: list[Fault] = []
        self.strays: list[Fault] = []

    def fault(self, code: str, path: Steps, message: str, cure: str = "", *, at_key: bool = False) -> None:
        self.faults.append(Fault("E501", legible(".".join(map(str, ("margins", *path)))), message, cure))
        self.strays += self.faults[-1:] if at_key else []

    def guess(self, word: str, known: Collection[str]) -> str:
        return did_you_mean(word[:200], known, quote='"')


class RowMargins:
    """The margins of rows: what a batch gives, with further columns beside its measures.

    diagram: what is linearized. case: of all rows. Raises UsageError at once for what the diagram does not have.
    """

    def __init__(self, diagram: Diagram, chosen: Sequence[Margin], case: Case) -> None:
        self._diagram, self._chosen, self._case = diagram, tuple(chosen), case.only(*PointWords.__annotations__)
        for margin in chosen:
            if margin.name in diagram.value.measures:
                raise UsageError(
                    Fault(
                        "E501",
                        f"margins.{margin.name}",
                        "the diagram has a measure of this name.",
                        "Choose another name.",
                    )
                )
            with suppress(AnalysisError, ModelError, SimulationError):  # other values may have one
                margin.value(_Row(diagram, self._case, {}, None))

    def beside(self, rows: BatchRows, batch: Batch, table: Array, seeds: Array) -> BatchRows:
        """What a batch gave for a table of rows, with their margins. Ctrl-C leaves the rest "left"."""
        columns = {margin.name: np.full(len(rows), np.nan) for margin in self._chosen}
        messages, status, interrupted = list(rows.messages), rows.status.copy(), rows.interrupted
        i = 0
        try:
            for i in np.flatnonzero(~np.isin(status, ("left", "refused"))).tolist():
                seen = _Row(self._diagram, self._case, batch.parameters(table[i]), int(seeds[i]))
                for margin in self._chosen:
                    try:
                        columns[margin.name][i] = margin.value(seen)
                    except BlocksError as error:
                        fault = error.faults[0]
                        why = f"{margin.name}: {fault.code} {fault.place}: {fault.message}"
                        if fault.code == "E707":  # its own cure is for linear models in Python and by commands
                            why += (
                                f" Give the margin Padé models of the delays: "
                                f'{{"type": "{margin.type}", "pade": 3, ...}}.'
                            )
                        messages[i] = f"{messages[i]} {why}".lstrip()
        except KeyboardInterrupt:
            status[i:], interrupted = "left", True
        measures = {**rows.measures, **columns}
        return replace(rows, status=status, messages=tuple(messages), measures=measures, interrupted=interrupted)


class _Row:
    """A row as it is linearized: points, linear models and margins that several columns share are computed once."""

    def __init__(self, diagram: Diagram, case: Case, row: Mapping[str, object], seed: int | None) -> None:
        self.diagram, self.seed, self.case = diagram, seed, case.updated(parameters=row)
        self.known: dict[str, Any] = {}

    def margins(self, margin: Margin) -> Margins | DiskMargins:
        def made() -> Margins | DiskMargins:
            loop = self._linearizer(margin).exact_loop(margin.loop, **margin.how)
            if self.seed is not None and isinstance(loop, Transfer):  # rows repeat no warning of the diagram itself
                loop = replace(loop, fragile=None)
            is_one = len(loop.signals[0]) == 1 or isinstance(loop, LoopOfRates)
            return margins(loop) if is_one else disk_margins(loop)

        known: Margins | DiskMargins = self._once(f"margins {margin.loop} {margin.how}", margin, made)
        return known

    def transfer(self, margin: Margin) -> Transfer:
        ends: tuple[Any, Any] = (margin.loop, margin.loop) if margin.loop else margin.ends

        def made() -> Transfer:
            return self._linearizer(margin).transfer(*ends, **margin.how)

        known: Transfer = self._once(f"transfer {ends} {margin.how}", margin, made)
        return known

    def _linearizer(self, margin: Margin) -> Linearizer:
        # At the start nothing depends on the seed, and other seeds make another model.
        seed: dict[str, Any] = {} if self.seed is None or margin.point.get("at") is None else {"seed": self.seed}
        made: Linearizer = self._once(
            "linearizer", margin, lambda: self.diagram.linearizer(self.case, **margin.point, **seed)
        )
        return made

    def _once(self, what: str, margin: Margin, make: Callable[[], object]) -> Any:
        key = f"{what} {sorted(margin.point.items())}"
        if key not in self.known:
            self.known[key] = make()
        return self.known[key]


def _of_poles(kind: str, model: Transfer) -> float:
    """Of all poles the largest real part in 1/s, or the least damping; of a sampled model those of ln z over dt."""
    roots = np.asarray(poles(model), dtype=complex)
    if model.dt:
        with np.errstate(divide="ignore", invalid="ignore"):
            roots = np.log(roots) / model.dt
    if not len(roots):
        cure = "Name an input and an output with a state between them."
        raise AnalysisError(Fault("E705", model.name, "there are no poles between these signals.", cure))
    if kind == "slowest_pole":
        return float(roots.real.max())
    sizes = np.abs(roots)
    with np.errstate(invalid="ignore"):  # z = 0: at once
        return float(np.min(np.where(np.isfinite(sizes) & (sizes > 0), -roots.real / sizes, 1.0)))
