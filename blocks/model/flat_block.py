"""What a flat diagram consists of: its blocks, and the subdiagrams that were enabled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..contract.interface import Interface
from ..contract.resolution import Resolved
from .wires import Source


@dataclass(frozen=True, slots=True)
class FlatBlock:
    """A block by its path, with its numbers, and the source of each element of each input."""

    path: str
    resolved: Resolved
    sources: Mapping[str, tuple[Source, ...]]  # by variable
    condition: int | None = None  # the block that says whether this one is on, where it lies in an enabled subdiagram
    time: int | None = None  # the block that gives the time here, where that may stand still
    hidden: bool = False  # put in at the edge of a subdiagram
    told_as: str = ""  # of a hidden block: the name under which its events are reported; "" for none

    @property
    def interface(self) -> Interface:
        return self.resolved.interface


@dataclass(frozen=True, slots=True)
class FlatEnabled:
    """An enabled subdiagram: the blocks that say whether it is on and keep its time, and what lies directly in it.

    resets: the blocks anywhere in it, where their states and discretes begin anew when it is turned on.
    """

    path: str
    enabled: int
    time: int
    members: tuple[int, ...]
    resets: tuple[int, ...]
