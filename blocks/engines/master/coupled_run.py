"""A run of a Coupling: its units, its records, and the answers to what is asked of it.

How it begins and goes on is left to two masters: `master` in plain Python, and `native_master` in compiled code.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from fractions import Fraction
from typing import Any

import numpy as np

from ...compile.coupling import CoupledUnit, Coupling
from ...compile.inputs import InputTable
from ...compile.plan import Reference
from ...fmi.exits import Ended
from ...fmi.loading import Loaded
from ...fmi.patience import patient, undisturbed
from ...fmi.trace import Tracer
from ...results.results import Event, Statistics
from ...text.arrays import Array
from ...text.errors import BlocksError, Fault, UsageError
from ..run.engine import Recorded, ended_by
from ..run.measures import Measures
from ..run.recording import Recording
from ..run.saved_state import State
from .exchange import Exchange
from .growth import warning
from .master_measures import measured
from .stepped_units import Running, not_finite

Row = tuple[float, ...]


class CoupledRun(Exchange, ABC):
    """One run of a Coupling under way, as `engines.run.engine.Engine` defines it.

    open_unit: gives the loaded FMU of a unit. tracer: of the calls of its FMUs.
    """

    name: str

    def __init__(
        self,
        coupling: Coupling,
        inputs: InputTable,
        open_unit: Callable[[Any], Loaded],
        tracer: Tracer | None = None,
    ) -> None:
        self.open_unit, self.tracer = open_unit, tracer
        super().__init__(coupling, inputs)

    def _clear(self) -> None:
        """Nothing has run yet."""
        super()._clear()
        settings, coupling = self.settings, self.plan
        self.recording = Recording(len(coupling.columns))
        self.measured = [*Measures(coupling).references]  # type: ignore[arg-type]
        self.points: list[Row] = []  # t, 1 where something jumped there, and what is measured
        self.has_failed = False
        self.told_over: Fault | None = None
        self.steps = self.rejected = self.instants = self.iterations = 0
        self.exact: Fraction | None = settings.start
        self.broken = self.t
        self.end = math.nan if settings.stop is None else float(settings.stop)
        self.late: dict[int, Fault] = {}  # the warnings about the first such jump, by unit
        self.grown: dict[int, Fault] = {}  # the warnings about them, by circle

    def start(self) -> None:
        self.close()
        self._clear()
        for unit in self.plan.units:
            self.units.append(self._unit(unit))
        with self._ending():
            self._initialize()

    def go_on_from(self, state: State) -> None:
        message = "a run with Co-Simulation FMUs, or with blocks that are coupled one by one, cannot be resumed."
        raise UsageError(Fault("E506", self.plan.name, message, "Start the run again from the beginning."))

    @abstractmethod
    def _unit(self, unit: CoupledUnit) -> Running:
        """Make a unit that has not started."""

    @abstractmethod
    def proceed(self, stop: Fraction) -> bool: ...

    @abstractmethod
    def pause(self, every: float, at: float) -> None: ...

    @abstractmethod
    def set_input(self, index: int, value: Array) -> None: ...

    @abstractmethod
    def set_parameters(self, coupling: Coupling) -> None: ...

    def close(self) -> None:
        """Free all FMUs."""
        with undisturbed():
            for unit in self.units:
                unit.close()
            self.units = []

    # --- start -------------------------------------------------------------------------------------------------

    def _initialize(self) -> None:
        """Initialization of all units."""
        stop = None if math.isnan(self.end) else self.end
        for unit in self.units:
            unit.start(self.t, stop)
        self._begin()

    @abstractmethod
    def _begin(self) -> None:
        """The exchange of outputs and inputs in initialization, its end, and the instant at the start."""

    # --- going on ----------------------------------------------------------------------------------------------

    def hearing(self) -> AbstractContextManager[Callable[[], None]]:
        return patient()

    @contextmanager
    def _ending(self) -> Iterator[None]:
        """An FMU inside a unit may end the run."""
        if self.has_failed:
            message = "the run has failed and cannot continue."
            raise UsageError(Fault("E501", self.plan.name, message, "Start a new run."))
        try:
            yield
        except Ended as error:
            self.told_over = error.faults[0]

    @property
    def tried(self) -> int:
        return self.steps + self.rejected

    @property
    def recorded_bytes(self) -> float:
        """Bytes of what is recorded, and of what is kept for the measures."""
        return self.recording.bytes + 8.0 * len(self.points) * (2 + len(self.measured))

    @property
    def over(self) -> Fault | None:
        told = self.told_over or next((unit.over for unit in self.units if unit.over is not None), None)
        ends = self.plan.ends
        if told is not None or ends is None or not self.y[ends] or any(at != self.t for at in self.at):
            return told  # behind a unit that lags, the condition is one of its extrapolated outputs
        return ended_by(self.settings.stop_when, self.t)

    def _tell_growth(self, element: int, circle: int, t: float) -> None:
        if circle not in self.grown:
            self.grown[circle] = warning(self.plan, self._saving, element, t)

    @property
    def _saving(self) -> list[bool]:
        return [unit.can_save for unit in self.units]

    def _measure(self, kind: float) -> None:
        if self.measured:
            self.points.append((self.t, kind, *self._row(self.measured)))

    def _row(self, links: Sequence[Any]) -> tuple[float, ...]:
        values = tuple(self.value_of(link, self.t) for link in links)
        for link, value in zip(links, values, strict=True):
            if not math.isfinite(value):
                raise not_finite(self.plan, link, value, self.t)
        return values

    # --- from outside ------------------------------------------------------------------------------------------

    def _put_parameters(self, coupling: Coupling) -> None:
        for running, new in zip(self.units, coupling.units, strict=True):
            running.take_parameters(new)
        self.plan = coupling

    def snapshot(self, overrides: Mapping[str, Any]) -> State:
        message = "a run with Co-Simulation FMUs, or with blocks that are coupled one by one, cannot be saved."
        raise UsageError(Fault("E506", self.plan.name, message, "Run it without saving its state."))

    def values(self, references: tuple[Reference, ...]) -> tuple[float, ...]:
        for row, place in references:
            if row == "source":
                name = f"{self.plan.flat.blocks[place[1]].path}.{place[2]}"
                raise UsageError(Fault("E502", name, "is neither recorded nor exchanged.", "Add it to log."))
        return tuple(self.value_of(reference, self.t) for reference in references)

    def _told(self) -> str:
        """The algorithm in words."""
        master = self.master
        steps = f"every {float(self.plan.shortest):g} s"
        control = steps if master.tolerance is None else f"tolerance {master.tolerance:g}"
        return f"{master.algorithm}, order {master.order}, {control}"

    def _rows(self) -> tuple[Array, Array]:
        return self.recording.arrays()

    def _points(self) -> Array:
        return np.array(self.points)

    def recorded(self) -> Recorded:
        t, values = self._rows()
        statistics = Statistics(self._told(), self.name, self.steps, self.rejected, 0, self.instants)
        events: list[Event] = sorted((e for unit in self.units for e in unit.events()), key=lambda event: event.t)
        measures, uncovered = measured(self.plan, self._points())
        warnings = (
            *(fault for fault in self.plan.warnings if fault.code in ("W209", "W211")),  # the run's end and steps
            *(told for unit in self.units for told in unit.warnings()), *self.late.values(), *self.grown.values(),
            *uncovered,
        )  # fmt: skip
        return Recorded(t, values, tuple(events), measures, statistics, warnings)

    def taken(self) -> Array:
        return self.recording.taken()[:-1]

    def abandon(self) -> None:
        self.has_failed = True
        self.close()

    def __del__(self) -> None:
        with suppress(BlocksError):
            self.close()
