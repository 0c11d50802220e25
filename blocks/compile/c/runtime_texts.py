"""The C texts of the runtime, as they are compiled here and packed into FMUs."""

from __future__ import annotations

import functools
from pathlib import Path

from ..tableaus import STIFF, c_header

RUNTIME = ("runtime.h", "model.h", "methods.h", "steps.h", "instants.h", "jacobian.h", "stiff.h")


def packaged(*names: str) -> dict[str, str]:
    """C texts that belong to this package, by their names."""
    return {name: _packaged(name) for name in names}


def stiff_units(method: str) -> tuple[str, ...]:
    """The files, beside the Jacobian's, that runs by this method need."""
    return ("factors.c", "radau.c") if method in STIFF else ()


def loop_units(source: str) -> tuple[str, ...]:
    """The files that a model needs by its own text: those of algebraic loops."""
    return ("newton.c",) if "blocks_newton(" in source else ()


@functools.cache
def _packaged(name: str) -> str:
    if name == "methods.h":
        return c_header()
    return (Path(__file__).parent / "runtime" / name).read_text(encoding="utf-8")
