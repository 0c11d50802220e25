"""The explanation of a code: its title, its cause, its cure, and an example that gives it; read from Markdown.

A file has this form, in this order: a heading with the code and its title, a paragraph with the cause, `## What to do`
and a paragraph with the cure, `## For example`, and then

    With plant.fmu, whose only binary is for Windows:       where something must be there that the files do not hold

    ```json loop.json                                       each file of the example, by the name that it has there
    ```

    ```console
    $ blocks run loop.json                                  the command line that is the example
    E301 x.y: at t = 1.0... s the step became ...           one line that is printed; "..." stands for anything
    ```

Without a command line `example.py` is the example, a script; or `loop.json`, a diagram that `blocks check` looks at.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NoReturn

_DIAGRAM, _SCRIPT = "loop.json", "example.py"
"""The names of what is an example by itself."""


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
                return ((_DIAGRAM, self.text), *files, ("", f"$ blocks check {_DIAGRAM}\n{self.said}"))
            case "python":
                return (*files, (_SCRIPT, self.text), ("", self.said))
            case _:
                return (*files, ("", f"$ {self.text}\n{self.said}"))


@dataclass(frozen=True, slots=True)
class Explanation:
    """What a code means in a line, why it is raised, what to do about it, and an example."""

    title: str
    cause: str
    cure: str
    example: Example


_PIECE = re.compile(
    r"# (?P<title>.+)\n"
    r"|## (?P<section>.+)\n"
    r"|(?P<words>(?:(?!\s|[#>|]|[-+*] |\d+[.)] |```).+\n)+)"  # what begins otherwise is no paragraph to Markdown
    r"|```(?P<fence>.*)\n(?P<body>(?:.*\n)*?)```(?:\n|\Z)"
)


class _Reader:
    """The text of a file, read from the top; `line` is that of the piece that was read last, from 1."""

    def __init__(self, text: str, name: str) -> None:
        self.text, self.name, self.at, self.line = text, name, 0, 1

    def refuse(self, reason: str) -> NoReturn:
        raise ValueError(f"{self.name}:{self.line}: {reason}.")

    def piece(self) -> re.Match[str] | None:
        """The next heading, paragraph or fenced block; None at the end."""
        while self.text.startswith("\n", self.at):
            self.at += 1
        self.line = self.text.count("\n", 0, self.at) + 1
        if self.at == len(self.text):
            return None
        found = _PIECE.match(self.text, self.at)
        if found is None:
            self.refuse("this is no heading, no plain paragraph and no fenced block that ends")
        self.at = found.end()
        return found

    def take(self, kind: str, form: str, wanted: str) -> str:
        """What the form, a regular expression, takes out of the next piece, which must be one of this kind."""
        piece = self.piece()
        found = re.fullmatch(form, _in_a_line(piece[kind])) if piece and piece[kind] else None
        if found is None:
            self.refuse(f"{wanted} must stand here")
        return found[1]

    def example(self) -> Example:
        given, files = "", dict[str, str]()
        while (piece := self.piece()) and piece["fence"] != "console":
            found = re.fullmatch("With (.+):", _in_a_line(piece["words"] or ""))
            language, _, name = (piece["fence"] or "").partition(" ")
            if found and not given and not files:
                given = found[1]
            elif language and name and name not in files:
                files[name] = piece["body"]
            else:
                self.refuse('a file, "```json loop.json", or what is printed, "```console", must stand here')
        if piece is None:
            self.refuse('what is printed, "```console", is missing')
        *commands, said = piece["body"].splitlines() or [""]
        match commands:
            case [command] if command.startswith("$ "):
                example = Example("shell", command[2:], said, given, files)
            case [] if said and _SCRIPT in files:
                example = Example("python", files.pop(_SCRIPT).rstrip("\n"), said, given, files)
            case [] if said and _DIAGRAM in files:
                example = Example("diagram", files.pop(_DIAGRAM).rstrip("\n"), said, given, files)
            case _:
                self.refuse(f'this must be one line, below "$ COMMAND" where there is no {_DIAGRAM} and no {_SCRIPT}')
        if self.piece() is not None:
            self.refuse("the file ends with what is printed")
        return example


def _in_a_line(text: str) -> str:
    return " ".join(text.split())


def explanation_in(text: str, name: str) -> Explanation:
    """What the file of a code says: its text and its name, as E101.md. Raises ValueError, with file and line."""
    reader, code = _Reader(text, name), name.removesuffix(".md")
    title = reader.take("title", f"{re.escape(code)}: (.+)", f'"# {code}: TITLE"')
    cause = reader.take("words", "(.+)", "the cause, a paragraph,")
    reader.take("section", "(What to do)", '"## What to do"')
    cure = reader.take("words", "(.+)", "the cure, a paragraph,")
    reader.take("section", "(For example)", '"## For example"')
    return Explanation(title, cause, cure, reader.example())
