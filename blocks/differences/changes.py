"""One change, and all changes from one diagram to another: their lines, and their drawing."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from ..diagram import DiagramValue
from .meaning import clean

if TYPE_CHECKING:
    from .pairs import Pairs

__all__ = ["GLYPHS", "GROUPS", "Change", "Differences", "Kind"]

Kind = Literal["added", "removed", "changed", "renamed"]
GROUPS = ("diagram", "parameters", "inputs", "outputs", "blocks", "wires", "run", "measures")
GLYPHS: dict[Kind, str] = {"added": "+", "removed": "-", "changed": "~", "renamed": ">"}
MIRRORED: dict[Kind, Kind] = {"added": "removed", "removed": "added", "changed": "changed", "renamed": "renamed"}
LONGEST_PATH = 300


@dataclass(frozen=True, slots=True)
class Change:
    """One thing that differs.

    group: the section of the file: diagram, parameters, inputs, outputs, blocks, wires, run or measures. kind: added,
    removed, changed or renamed. before_path, path: where it is in A and in B, with dots ("control.eso", of a wire its
    sink); "" where it is not. what: which part of a block, an input or a measure: "type", "variant", a parameter.
    old, new: the raw values, None where there is none. before, after: the same for a person, with a note behind them.
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
        """The same change of what stands under a name, `before` in A and `name` in B, or inside of such a block."""

        def path(first: str, rest: str, other: str) -> str:
            return f"{first}.{rest}" if rest else "" if other else first

        return replace(
            self,
            before_path=path(before, self.before_path, self.path),
            path=path(name, self.path, self.before_path),
            diagram=path(name, self.diagram, "") if is_inside else self.diagram,
        )

    def mirrored(self) -> Change:
        """The same change on the way from B to A."""
        return replace(
            self,
            kind=MIRRORED[self.kind],
            before_path=self.path,
            path=self.before_path,
            old=self.new,
            new=self.old,
            before=self.after,
            after=self.before,
        )

    @property
    def told(self) -> str:
        """What changed, without its place: "type Gain -> PID"."""
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
        told = self.told
        if not place:
            return f"{glyph} {told}"
        separator = " " if told.startswith("<-") else ": " if told else ""
        return f"{glyph} {place}{separator}{told}"

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


def in_order(changes: Iterator[Change]) -> tuple[Change, ...]:
    """By group and place, what a block is before its parameters; numbers in names count as numbers."""

    def natural(text: str) -> list[tuple[str, int]]:
        return [(word, int(digits or 0)) for word, digits in re.findall(r"([^0-9]*)([0-9]{0,18})", text)]

    def place(one: Change) -> Any:
        what = one.what not in ("type", "fmu", "diagram"), natural(one.what)
        return GROUPS.index(one.group), natural(one.place), what, one.kind, one.before_path, one.before, one.after

    return tuple(sorted(changes, key=place))


@dataclass(frozen=True)
class Differences:
    """All that differs from diagram A to diagram B, in order; false where nothing does.

    names: of A and B, as they are told. Its text is a line for each change, by section.
    """

    a: DiagramValue = field(repr=False)
    b: DiagramValue = field(repr=False)
    names: tuple[str, str]
    changes: tuple[Change, ...]
    pairs: Pairs = field(repr=False, compare=False)

    def __bool__(self) -> bool:
        return bool(self.changes)

    def __len__(self) -> int:
        return len(self.changes)

    def __iter__(self) -> Iterator[Change]:
        return iter(self.changes)

    @property
    def counts(self) -> dict[str, int]:
        """How many changes there are of each kind."""
        return {kind: sum(one.kind == kind for one in self.changes) for kind in GLYPHS}

    def __str__(self) -> str:
        lines = [" -> ".join(clean(name, LONGEST_PATH) for name in self.names)]
        group = ""
        for one in self.changes:
            if one.group != group:
                group = one.group
                lines.append(group)
            lines.append(f"  {one}")
        if not self.changes:
            return f"{lines[0]}: no difference"
        kinds = ", ".join(f"{count} {kind}" for kind, count in self.counts.items() if count)
        noun = "difference" if len(self.changes) == 1 else "differences"
        return "\n".join([*lines, f"{len(self.changes)} {noun}: {kinds}"])

    def __repr__(self) -> str:
        return f"<Differences {self}>"

    def svg(self, *, depth: int | None = None) -> str:
        """Both diagrams in one drawing, as the text of an SVG: what was added, removed and changed is marked.

        depth: how many levels of subdiagrams are opened, where they differ inside; all unless given.
        """
        from .drawn import svg

        return svg(self, depth)

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, str]:
        """What a notebook shows: the drawing, and the text where it cannot draw."""
        return {"image/svg+xml": self.svg(), "text/plain": repr(self)}
