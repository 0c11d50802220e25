"""What every engine does: the protocol between a run (`engines.driver`) and what computes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Protocol

from ...results.results import Event, Events, Statistics
from ...text.arrays import Array
from ...text.errors import Fault
from .saved_state import State
from .stiffness import StateRates

ENGINES = ("auto", "native", "reference")
VARIABLE = "BLOCKS_ENGINE"
"""The environment variable that names the engine where a run does not."""


def _nothing() -> None:
    """In the place of a check for Ctrl-C, where Python checks itself."""


def heard_by_python() -> AbstractContextManager[Callable[[], None]]:
    """What `Engine.hearing` gives where Ctrl-C needs no care: Python raises it wherever it comes."""
    return nullcontext(_nothing)


@dataclass(frozen=True, slots=True)
class Recorded:
    """What an engine has recorded up to now.

    t: (rows,) in s. values: (rows, columns), the elements of the recorded signals in the order of the log, in SI.
    """

    t: Array
    values: Array
    events: tuple[Event, ...] | Events
    measures: dict[str, float]
    statistics: Statistics  # without the time that it took
    warnings: tuple[Fault, ...]


def ended_by(condition: str, t: float) -> Fault:
    """Return the warning that the condition of a run ended it (W307)."""
    return Fault("W307", "run.stop_when", f"the run ended at t = {t:.10g} s: {condition}.")


class Engine(Protocol):
    """One run of a Plan or of a Coupling under way.

    It begins by `start` or by `go_on_from`, each of which may be called again and begins anew: nothing is left of what
    ran before but the inputs and parameters as they are. Then `proceed` takes it from one moment to the next, and the
    other calls may come between any two of them. At each such moment it stands at one time `t` with all that happened
    before; an instant at `t` may still be outstanding: then `values` and `snapshot` let it happen first, and what
    `set_input` and `set_parameters` change is a part of it.

    Errors are SimulationError, FMUError and MemoryError, without results: what surrounds the run adds them. After one
    the engine stands where it stood before it, and `recorded` gives all up to there; `abandon` ends a run that will
    not go on. KeyboardInterrupt leaves it at a moment from which it can go on.
    """

    @property
    def plan(self) -> Any:
        """The Plan or Coupling, with the values of its parameters as they are now."""
        ...

    @property
    def t(self) -> float:
        """The time in s that is reached."""
        ...

    @property
    def exact(self) -> Fraction | None:
        """The same as a fraction, where it is known as one."""
        ...

    @property
    def over(self) -> Fault | None:
        """The warning that an FMU (W206) or the condition of the run (W307) ended it, which goes no further."""
        ...

    @property
    def steps(self) -> int:
        """How many steps it has taken."""
        ...

    @property
    def tried(self) -> int:
        """How many steps it has tried: those that were rejected count too."""
        ...

    @property
    def blamed(self) -> Array:
        """For each state, the rejected steps in which its error was the largest: (n,); of a master none, (0,)."""
        ...

    def state_rates(self) -> StateRates | None:
        """The states now, and their rates at other states, by which nothing changes and nothing counts.

        None of a master, and where an FMU for Model Exchange computes rates.
        """
        ...

    @property
    def recorded_bytes(self) -> float:
        """What the recorded rows take."""
        ...

    def start(self) -> None:
        """Begin at the start of the settings, up to and including the instant there."""
        ...

    def go_on_from(self, state: State) -> None:
        """Begin where a saved run stood. Raises UsageError (E506) where that is outside the run, or not possible."""
        ...

    def proceed(self, stop: Fraction) -> bool:
        """Go on for a moment (a step, an instant, or a slice of computing) towards `stop`, and not beyond.

        Returns whether it has come there, with all that happens at that time, or to where something ended the run.
        """
        ...

    def pause(self, every: float, at: float) -> None:
        """How long a moment is: at most so many seconds of computing (0.05 at first), and no longer than to the end of
        the first step that reaches the time `at`, which lies ahead (inf at first). No step is another one for it.
        """
        ...

    def hearing(self) -> AbstractContextManager[Callable[[], None]]:
        """How Ctrl-C is treated while it proceeds; gives what raises, after a moment, one that came in it."""
        ...

    def set_input(self, index: int, value: Array) -> None:
        """An input of the diagram, by its number, jumps now; values in SI."""
        ...

    def set_parameters(self, plan: Any) -> None:
        """Tunable parameters change now: to those of a Plan or Coupling that differs in nothing else."""
        ...

    def values(self, references: tuple[Any, ...]) -> tuple[float, ...]:
        """Values now, of places in memory (of a Coupling: of links). Raises UsageError (E502)."""
        ...

    def snapshot(self, overrides: Mapping[str, object]) -> State:
        """All that the rest of the run follows from. overrides: raw values of parameters that were given or set.

        Raises UsageError (E506) where the run cannot be saved.
        """
        ...

    def recorded(self) -> Recorded:
        """Rows, events and measures up to now."""
        ...

    def taken(self) -> Array:
        """The rows (rows, 1 + columns), times first, that cannot change any more; it keeps the last one alone."""
        ...

    def abandon(self) -> None:
        """The run has failed: what cannot go on is freed."""
        ...
