"""How long the FMUs of a run took: by instance, and by function."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from ..text.printable import counted, legible

MOST_SHOWN = 20
"""FMUs of a table."""
MOST_FUNCTIONS = 3
"""Functions of an FMU in a table: those that took longest."""


class Calls(NamedTuple):
    """Calls of one function: how many, and their wall time in s, without calls from within them."""

    number: int
    seconds: float


@dataclass(frozen=True, slots=True)
class FmuProfile:
    """The calls of one FMU in a run, by function."""

    fmu: str
    functions: Mapping[str, Calls]

    @property
    def calls(self) -> int:
        """How many calls there were."""
        return sum(calls.number for calls in self.functions.values())

    @property
    def seconds(self) -> float:
        """The wall time of all calls in s."""
        return sum(calls.seconds for calls in self.functions.values())


@dataclass(frozen=True, slots=True)
class Profile:
    """The FMUs of a run, the slowest first. seconds: the wall time of the run, with its start."""

    fmus: tuple[FmuProfile, ...]
    seconds: float

    def share(self, fmu: FmuProfile) -> float:
        """The share of an FMU in the time of the run, from 0 to 1."""
        return fmu.seconds / self.seconds if self.seconds > 0 else 0.0

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        shown = self.fmus[:MOST_SHOWN]
        width = max([3, *(len(legible(fmu.fmu)) for fmu in shown)])
        yield f"  {'FMU'.ljust(width)}     calls       time  share  slowest functions"
        for fmu in shown:
            slowest = sorted(fmu.functions.items(), key=lambda item: -item[1].seconds)[:MOST_FUNCTIONS]
            functions = ", ".join(f"{name} {_time(calls.seconds)}" for name, calls in slowest)
            share = f"{100 * self.share(fmu):4.0f} %"
            yield (
                f"  {legible(fmu.fmu).ljust(width)}  {fmu.calls:8d}  {_time(fmu.seconds):>9s} {share}  {functions}"
            )
        if len(self.fmus) > len(shown):
            rest = self.fmus[len(shown) :]
            seconds = sum(fmu.seconds for fmu in rest)
            calls = sum(fmu.calls for fmu in rest)
            yield f"  and {counted(len(rest), 'more FMU')}: {calls} calls, {_time(seconds)}"

    def entries(self) -> list[dict[str, object]]:
        """The same for JSON."""
        return [
            {
                "fmu": fmu.fmu,
                "calls": fmu.calls,
                "seconds": fmu.seconds,
                "share": self.share(fmu),
                "functions": {name: list(calls) for name, calls in fmu.functions.items()},
            }
            for fmu in self.fmus
        ]


def _time(seconds: float) -> str:
    """A time with a unit that fits."""
    size, unit = (1.0, "s") if seconds >= 1 else (1e3, "ms") if seconds >= 1e-3 else (1e6, "us")
    return f"{size * seconds:.3g} {unit}"
