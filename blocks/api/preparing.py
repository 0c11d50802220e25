"""What is said before a run or an export: what takes long, and which FMUs are loaded for the first time."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ..compile.toolchain import compiler
from ..compile.toolchain.cache import of_user
from ..compile.toolchain.platforms import PLATFORMS, this_platform
from ..model import trust
from ..model.diagram_value import DiagramValue


def longest_compilation() -> float:
    """Return the time in s after which a hanging compiler is stopped."""
    return compiler.LIMIT


def new_folders(value: DiagramValue) -> dict[Path, list[str]]:
    """Return the folders from which no FMU was used before, with the names of the FMUs, and remember them."""
    return trust.new_folders(value, of_user)


def other_platforms(names: Iterable[str]) -> list[str]:
    """Return those of the names that are platforms, and not this machine's."""
    return [name for name in names if name in PLATFORMS and name != this_platform()]
