"""Every code of the tree of errors explained: cause, cure, and an example that gives it.

The texts stand in a module for each group of codes. `blocks explain`, the documentation and the tests read them
from here; the tests run every example. The one-line titles stand in `blocks.text.errors.CODES`.
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

    `error` is the exception in Python, if there is one of blocks; `exit_status` that of the command.
    """

    prefix: str
    title: str
    error: type[BlocksError] | None = None
    exit_status: int = 2

    @property
    def codes(self) -> tuple[str, ...]:
        return tuple(sorted(code for code in CODES if code.startswith(self.prefix)))

    @property
    def ends(self) -> str:
        """How a command and a script end that meet one of the codes, in a sentence."""
        if self.prefix.startswith("W"):
            return "A warning ends nothing, and changes no exit code."
        if self.error is None:
            return f"Exit code {self.exit_status}; in Python the exception itself."
        builtin = self.error.__bases__[-1].__name__
        article = "an" if builtin[0] in "AEIO" else "a"
        return f"Exit code {self.exit_status}; in Python {self.error.__name__}, {article} {builtin}."


def _group(prefix: str, title: str, error: type[BlocksError]) -> Group:
    return Group(prefix, title, error, error.exit_status)


GROUPS = (
    _group("E0", "Reading a file", ModelError),
    _group("E1", "The model", ModelError),
    _group("E2", "FMUs", FMUError),
    _group("E3", "A run", SimulationError),
    _group("E4", "A block class", DeclarationError),
    _group("E5", "A call or a command line", UsageError),
    _group("E6", "Compiled code", CompilerError),
    _group("E7", "Linear models and frequency responses", AnalysisError),
    Group("E9", "blocks itself", None, 70),
    Group("W1", "The model: warnings", None, 0),
    Group("W2", "FMUs: warnings", None, 0),
    Group("W3", "A run: warnings", None, 0),
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
