"""All changes from one diagram to another: their lines, and their drawing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from ...model.diagram_value import DiagramValue
from ...model.hierarchy import Resolver
from .changes import GLYPHS, LONGEST_PATH, Change, in_order
from .meaning import clean
from .merged_drawing import svg
from .walk import Level, Walk


def differences(
    a: DiagramValue,
    b: DiagramValue,
    *,
    names: tuple[str, str] = ("", ""),
    doc: bool = False,
    resolver: Resolver | None = None,
) -> Differences:
    """Find what differs from diagram a to diagram b.

    names: what the two are called (their own names unless given). doc: compare doc texts and keys "x-..." as well.
    resolver: from the name of a block type to its class, which declares the units of bare numbers; without one, a bare
    number and a quantity with a unit are never the same. FMUs are compared by path and by the SHA-256 of their bytes;
    they are not opened. Raises ModelError (E008) for more than 100,000 changes.
    """
    level = Walk(doc, resolver).level(a, b, is_top=True)
    return Differences((names[0] or a.name, names[1] or b.name), in_order(level.changes), level)


@dataclass(frozen=True)
class Differences:
    """All that differs from diagram A to diagram B, in order; false where nothing does.

    names: of A and B, as they are shown. Its text is a line for each change, by section.
    """

    names: tuple[str, str]
    changes: tuple[Change, ...]
    level: Level = field(repr=False, compare=False)

    def __bool__(self) -> bool:
        return bool(self.changes)

    def __len__(self) -> int:
        return len(self.changes)

    def __iter__(self) -> Iterator[Change]:
        return iter(self.changes)

    @property
    def counts(self) -> dict[str, int]:
        """How many changes there are of each kind."""
        return {kind: sum(change.kind == kind for change in self.changes) for kind in GLYPHS}

    def __str__(self) -> str:
        lines = [" -> ".join(clean(name, LONGEST_PATH) for name in self.names)]
        group = ""
        for change in self.changes:
            if change.group != group:
                group = change.group
                lines.append(group)
            lines.append(f"  {change}")
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
        return svg(self.level, self.changes, self.names, depth)

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> dict[str, str]:
        """What a notebook shows: the drawing, and the text where it cannot draw."""
        return {"image/svg+xml": self.svg(), "text/plain": repr(self)}
