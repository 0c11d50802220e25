"""One change from one diagram to another, and the order of all changes."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

from ...model.diagram_grammar import BODY
from .meaning import clean

Kind = Literal["added", "removed", "changed", "renamed"]
GROUPS = ("diagram", *(key for key in BODY.keys if key not in ("name", "doc", "layout")))
GLYPHS: dict[Kind, str] = {"added": "+", "removed": "-", "changed": "~", "renamed": ">"}
LONGEST_PATH = 300


@dataclass(frozen=True, slots=True)
class Change:
    """One thing that differs.

    group: the section of the file: diagram, parameters, inputs, outputs, blocks, wires, run or measures. kind: added,
    removed, changed or renamed. before_path, path: where it is in A and in B, with dots ("control.eso", of a wire its
    sink); "" where it is not. what: which part of a block, an input or a measure: "type", "variant", a parameter.
    old, new: the raw values, None where there is none. before, after: the same as text. note: text that follows them.
    diagram: the path of the subdiagram in which it lies, "" for the diagram itself.
    """

    group: str
    kind: Kind
    before_path: str
    path: str
    what: str = ""
    old: Any = None
    new: Any = None
    before: str = ""
    after: str = ""
    note: str = ""
    diagram: str = ""

    @property
    def place(self) -> str:
        return self.path or self.before_path

    def under(self, before: str, name: str, *, is_inside: bool = False) -> Change:
        """Return the change with paths below a name: `before` in A, `name` in B.

        is_inside: it is in a block's diagram.
        """
        is_only_in_a, is_only_in_b = self.kind == "removed", self.kind == "added"

        def path(first: str, rest: str, is_missing: bool) -> str:
            return f"{first}.{rest}" if rest else "" if is_missing else first

        return replace(
            self,
            before_path=path(before, self.before_path, is_only_in_b),
            path=path(name, self.path, is_only_in_a),
            diagram=path(name, self.diagram, False) if is_inside else self.diagram,
        )

    @property
    def summary(self) -> str:
        """Describe what changed, without its place: "type Gain -> PID"."""
        match self.kind:
            case "added":
                return self.after
            case "removed":
                return self.before
            case "renamed":
                return f"was {clean(self.before_path, LONGEST_PATH)}"
            case _:
                return f"{clean(self.what)} {self.before} -> {self.after}{self.note}".strip()

    def __str__(self) -> str:
        glyph, place = GLYPHS[self.kind], clean(self.place, LONGEST_PATH)
        if self.kind == "renamed":
            return f"{glyph} {clean(self.before_path, LONGEST_PATH)} -> {place}: renamed"
        summary = self.summary
        if not place:
            return f"{glyph} {summary}"
        separator = " " if summary.startswith("<-") else ": " if summary else ""
        return f"{glyph} {place}{separator}{summary}"

    def entry(self) -> dict[str, Any]:
        """The change as plain values, for JSON."""
        return {
            "group": self.group,
            "kind": self.kind,
            "path": self.place,
            "before_path": self.before_path,
            "what": self.what,
            "old": self.old,
            "new": self.new,
        }


def in_order(changes: Iterable[Change]) -> tuple[Change, ...]:
    """Sort by group and place, the type of a block before its parameters; numbers in names compare as numbers."""

    def natural(text: str) -> list[tuple[str, int]]:
        return [(word, int(digits or 0)) for word, digits in re.findall(r"([^0-9]*)([0-9]{0,18})", text)]

    def place(change: Change) -> Any:
        what = change.what not in ("type", "fmu", "diagram"), natural(change.what)
        return (
            GROUPS.index(change.group),
            natural(change.place),
            what,
            change.kind,
            change.before_path,
            change.before,
            change.after,
        )

    return tuple(sorted(changes, key=place))
