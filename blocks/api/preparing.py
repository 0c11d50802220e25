"""What is said before a run or an export: what takes long, and which FMUs are loaded for the first time."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ..compile.toolchain import compiler
from ..compile.toolchain.cache import of_user
from ..compile.toolchain.platforms import check_compilers, this_platform
from ..model import trust
from ..model.diagram import DiagramValue

__all__ = ["longest_compilation", "new_folders", "other_platforms"]


def longest_compilation() -> float:
    """Return the time in s after which a hanging compiler is stopped."""
    return compiler.LIMIT


def new_folders(value: DiagramValue) -> dict[Path, list[str]]:
    """Return the folders from which no FMU was used before, with the names of the FMUs, and remember them."""
    return trust.new_folders(value, of_user)


def other_platforms(names: Iterable[str]) -> list[str]:
    """Return the platforms that are not this machine's. Raises as `compiler_for` if a compiler is missing."""
    return [name for name in check_compilers(names) if name != this_platform()]
