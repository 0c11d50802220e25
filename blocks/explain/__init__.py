"""Every code of the tree of errors explained: cause, cure, and an example that gives it.

The texts stand in a module for each group of codes. `blocks explain`, the documentation and the tests read them
from here; the tests run every example. The one-line titles stand in `blocks.errors.CODES`.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import (
    CODES,
    AnalysisError,
    BlocksError,
    CompilerError,
    DeclarationError,
    Fault,
    FMUError,
    ModelError,
    SimulationError,
    UsageError,
    did_you_mean,
)
from . import analyses, calls, classes, compiled, fmus, model, reading, runs
from .explanation import Example, Explanation

__all__ = ["EXPLAINED", "GROUPS", "Example", "Explanation", "Group", "explained", "group_of"]

EXPLAINED: dict[str, Explanation] = {
    code: explanation
    for module in (reading, model, fmus, runs, classes, calls, compiled, analyses)
    for code, explanation in module.EXPLAINED.items()
}


@dataclass(frozen=True, slots=True)
class Group:
    """The codes that begin alike: what they are about, and how they reach whoever called.

    `error` is the exception in Python, None for warnings, which raise nothing; `exit_status` that of `blocks`.
    """

    prefix: str
    title: str
    error: type[BlocksError] | None

    @property
    def codes(self) -> tuple[str, ...]:
        return tuple(sorted(code for code in CODES if code.startswith(self.prefix)))

    @property
    def exit_status(self) -> int:
        return self.error.exit_status if self.error is not None else 0


GROUPS = (
    Group("E0", "Reading a file", ModelError),
    Group("E1", "The model", ModelError),
    Group("E2", "FMUs", FMUError),
    Group("E3", "A run", SimulationError),
    Group("E4", "A block class", DeclarationError),
    Group("E5", "A call or a command line", UsageError),
    Group("E6", "Compiled code", CompilerError),
    Group("E7", "Linear models and frequency responses", AnalysisError),
    Group("W1", "The model: warnings", None),
    Group("W2", "FMUs: warnings", None),
)


def explained(code: str) -> tuple[str, Explanation]:
    """The code as it is written, and its explanation; capitals do not matter. Raises UsageError (E501)."""
    written = code.strip().upper()
    if written not in EXPLAINED:
        cure = did_you_mean(written, EXPLAINED) or "`blocks explain` lists them all."
        raise UsageError(Fault("E501", repr(code), "is not a code of blocks.", cure))
    return written, EXPLAINED[written]


def group_of(code: str) -> Group:
    """The group of a code that is one of CODES."""
    return next(group for group in GROUPS if code.startswith(group.prefix))
