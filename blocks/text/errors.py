"""The tree of errors: what went wrong, where, why, and what to do about it.

    BlocksError                      everything this package raises on purpose; holds one fault or many
        DeclarationError (TypeError)     a block class says something it must not
        ModelError (ValueError)          faults of a diagram or of its file, all of them at once
        UsageError (ValueError)          a call or a command line that cannot be meant
        SimulationError (ArithmeticError)  the numbers failed during a run; what was computed is in `.results`
        FMUError (RuntimeError)          an FMU could not be loaded or failed
        CompilerError (RuntimeError)     compiled code could not be made or loaded
        AnalysisError (ValueError)       a question about frequencies that has no answer, or not this one

Codes: E0xx reading a file, E1xx the model, E2xx FMUs, E3xx a run, E4xx a block class, E5xx a call, E6xx compiled code,
E7xx linear models and frequency responses, E9xx blocks itself; W1xx, W2xx, W3xx, W5xx, W7xx warnings. Each one is
explained in a file of `blocks.text.explanations`.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..host.ipython_errors import Brief

NOT_FINITE = "Check its inputs at this time: look for a division by 0, or a root or logarithm of a negative number."
"""What to do about a value that is not finite (E303), whoever finds it."""

OVERFLOW = (
    "It overflowed beyond 1.8e308. Look for a signal that grows without bound: an unstable loop, or too long steps."
)
"""The same, where it was computed from finite numbers, and each operation was defined."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that is wrong: a code, the place, the cause in a sentence, and the cure.

    `path` is the place in the document of a file (keys and indices); `file`, `line` and `column` (from 1) are
    filled in where the text is known.
    """

    code: str
    place: str
    message: str
    cure: str = ""
    path: tuple[str | int, ...] = ()
    file: str = ""
    line: int = 0
    column: int = 0

    @property
    def is_warning(self) -> bool:
        return self.code.startswith("W")

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}:{self.column}" if self.line else self.file
        place = f"{where} {self.place}".strip()
        sentence = f"{self.code} {place}: {self.message}" if place else f"{self.code} {self.message}"
        gap = "" if sentence.endswith("\n") else " "
        return f"{sentence}{gap}{self.cure}".rstrip()

    def at(self, file: str, line: int, column: int) -> Fault:
        """The same fault with its place in a text."""
        return replace(self, file=file, line=line, column=column)


class BlocksError(Brief, Exception):
    """Something this package refuses or cannot do; `faults` says what, one entry each."""

    exit_status = 2

    def __init__(self, *faults: Fault) -> None:
        super().__init__(*faults)
        self.faults = faults

    @property
    def code(self) -> str:
        return self.faults[0].code if self.faults else ""

    def __str__(self) -> str:
        return "\n".join(str(fault) for fault in self.faults)


class DeclarationError(BlocksError, TypeError):
    """A block class is declared wrongly (E4xx)."""


class ModelError(BlocksError, ValueError):
    """A diagram or its file has faults (E0xx, E1xx). `readable` holds what could be read of a file, if anything."""

    def __init__(self, *faults: Fault, readable: Any = None) -> None:
        super().__init__(*faults)
        self.readable = readable


class UsageError(BlocksError, ValueError):
    """A call or a command line cannot be meant (E5xx)."""


class SimulationError(BlocksError, ArithmeticError):
    """A run failed (E3xx). `results` holds what was computed before."""

    exit_status = 3

    def __init__(self, *faults: Fault, results: Any = None) -> None:
        super().__init__(*faults)
        self.results = results


class FMUError(BlocksError, RuntimeError):
    """An FMU cannot be loaded or failed (E2xx). `results` holds what was computed before."""

    exit_status = 4

    def __init__(self, *faults: Fault, results: Any = None) -> None:
        super().__init__(*faults)
        self.results = results


class CompilerError(BlocksError, RuntimeError):
    """Compiled code cannot be made or loaded (E6xx)."""


class AnalysisError(BlocksError, ValueError):
    """A linear model, a margin or a response that does not exist (E7xx)."""


def sentence_of(error: Exception) -> str:
    """Return what an error says, without the code and the place of its first fault."""
    return error.faults[0].message if isinstance(error, BlocksError) else str(error)


def check_mappings(**tables: object) -> None:
    """Refuse arguments that are neither mappings nor None. Raises UsageError (E501)."""
    for word, table in tables.items():
        if table is not None and not isinstance(table, Mapping):
            message, cure = f"must be a mapping, not {table!r}.", f"Write {word}={{name: value}}."
            raise UsageError(Fault("E501", word, message, cure))


# Tracebacks name them as a caller imports them.
for _error in (
    *(BlocksError, DeclarationError, ModelError, UsageError),
    *(SimulationError, FMUError, CompilerError, AnalysisError),
):
    _error.__module__ = "blocks"
del _error


def did_you_mean(word: str, known: Iterable[str], *, quote: str = "'") -> str:
    """A sentence that offers the nearest known word, or an empty string."""
    folded = {name.casefold(): name for name in reversed(list(known))}
    letters = sorted(word.casefold())
    near = [name for name in folded if len(name) == len(letters) and sorted(name) == letters]  # two letters swapped
    inner = [name for name in folded if name.endswith(f".{word.casefold()}")]
    near = near or (inner if len(inner) == 1 else [])  # eso.e, which lies in control
    near = near or difflib.get_close_matches(word.casefold(), list(folded), n=1, cutoff=0.6)
    return f"Did you mean {quote}{folded[near[0]]}{quote}?" if near else ""
