"""Every code of the tree of errors explained: title, cause, cure, and an example that gives it.

Each code has a file of its own beside this module, such as E101.md, which is all that has to be written about it.
`blocks explain`, the documentation and the tests read them; the tests run every example.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..errors import (
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
from .explanation import Explanation, explanation_in

FOLDER = Path(__file__).resolve().parent
"""Where the files lie."""


class _Explanations(Mapping[str, Explanation]):
    """By code, sorted. The folder is looked into, and a file is read, when it is asked for, and once."""

    def __init__(self) -> None:
        self._read: dict[str, Explanation] = {}

    @cached_property
    def _files(self) -> dict[str, Path]:
        return {path.stem: path for path in sorted(FOLDER.glob("*.md"))}

    def __getitem__(self, code: str) -> Explanation:
        path = self._files[code]
        if code not in self._read:
            self._read[code] = explanation_in(path.read_text(encoding="utf-8"), path.name)
        return self._read[code]

    def __contains__(self, code: object) -> bool:
        return code in self._files

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)


EXPLAINED = _Explanations()
"""What is told about each code."""


@dataclass(frozen=True, slots=True)
class CodeGroup:
    """The codes that begin alike: what they are about, and how they reach the caller.

    `error` is the exception in Python, if there is one of blocks; `exit_status` that of the command.
    """

    prefix: str
    title: str
    error: type[BlocksError] | None = None
    exit_status: int = 2

    @property
    def codes(self) -> tuple[str, ...]:
        return tuple(code for code in EXPLAINED if code.startswith(self.prefix))

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


def _group(prefix: str, title: str, error: type[BlocksError]) -> CodeGroup:
    return CodeGroup(prefix, title, error, error.exit_status)


GROUPS = (
    _group("E0", "Reading a file", ModelError),
    _group("E1", "The model", ModelError),
    _group("E2", "FMUs", FMUError),
    _group("E3", "A run", SimulationError),
    _group("E4", "A block class", DeclarationError),
    _group("E5", "A call or a command line", UsageError),
    _group("E6", "Compiled code", CompilerError),
    _group("E7", "Linear models and frequency responses", AnalysisError),
    CodeGroup("E9", "blocks itself", None, 70),
    CodeGroup("W1", "The model: warnings", None, 0),
    CodeGroup("W2", "FMUs: warnings", None, 0),
    CodeGroup("W3", "A run: warnings", None, 0),
    CodeGroup("W5", "Many runs: warnings", None, 0),
    CodeGroup("W7", "Linear models: warnings", None, 0),
)


def explained(code: str) -> tuple[str, Explanation]:
    """The code as it is written, and its explanation; capitals do not matter. Raises UsageError (E501)."""
    written = code.strip().upper()
    if written not in EXPLAINED:
        cure = did_you_mean(written, EXPLAINED) or "`blocks explain` lists them all."
        raise UsageError(Fault("E501", repr(code), "is not a code of blocks.", cure))
    return written, EXPLAINED[written]


def group_of(code: str) -> CodeGroup:
    """The group of a code that is one of EXPLAINED."""
    return next(group for group in GROUPS if code.startswith(group.prefix))
