"""What is told about a code: its cause, its cure, and an example that gives it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

__all__ = ["FILE", "Example", "Explanation"]

FILE = "loop.json"
"""The name of the diagram of an example."""


@dataclass(frozen=True, slots=True)
class Example:
    """The shortest thing a user would write that gives the code.

    `kind` says what `text` is: the file of a diagram, which `blocks check` looks at; a script in Python; or one
    command line. `said` is a line that is printed, in which "..." stands for anything. `given` says in words what
    must be there besides, such as an FMU for another machine; `files` are texts that lie beside it.
    """

    kind: Literal["diagram", "python", "shell"]
    text: str
    said: str
    given: str = ""
    files: Mapping[str, str] = field(default_factory=dict)

    @property
    def texts(self) -> tuple[tuple[str, str], ...]:
        """All that is shown, in order: files by name with their texts, and last, without a name, what is printed."""
        files = tuple((name, text.rstrip("\n")) for name, text in self.files.items())
        match self.kind:
            case "diagram":
                return ((FILE, self.text), *files, ("", f"$ blocks check {FILE}\n{self.said}"))
            case "python":
                return (*files, ("example.py", self.text), ("", self.said))
            case _:
                return (*files, ("", f"$ {self.text}\n{self.said}"))


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why a code comes and is refused, what to do about it, and an example."""

    cause: str
    cure: str
    example: Example
