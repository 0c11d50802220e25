"""What a result shows of itself: lines and tables, as text for a terminal and as HTML for a notebook.

Both are made of the same parts, so that they say the same. The HTML names no color and no font: it looks as the
notebook does, light or dark.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from .printable import aligned

# A number, maybe with what stands behind it in such cells: "5.2", "-", "+3 % -4 %", "0.12 ± 0.03".
_NUMBERS = re.compile(r"-|([+-]?(\d[\d.]*(e[+-]?\d+)?|inf|nan)( [%±])?( |$))+", re.ASCII)
_CELL = "padding:0.15em 0.6em"


class Table(NamedTuple):
    """Rows of cells; the first one names the columns where there is a head."""

    rows: Sequence[Sequence[str]]
    has_head: bool = True


Part = str | Table


class Shown:
    """What shows itself by its `parts`."""

    __slots__ = ()

    def parts(self) -> Iterable[Part]:
        """Lines and tables, in order."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return as_text(self.parts())

    def _repr_html_(self) -> str:
        return as_html(self.parts())


def as_text(parts: Iterable[Part]) -> str:
    """One line for each line and row."""
    return "\n".join(line for part in parts for line in ([part] if isinstance(part, str) else aligned(part.rows)))


def as_html(parts: Iterable[Part]) -> str:
    """A <div> with a paragraph for each line; columns of numbers are aligned to the right."""
    pieces = [_table(part) if isinstance(part, Table) else _line(re.sub(r"^<(.*)>$", r"\1", part)) for part in parts]
    return f'<div class="blocks-shown" style="overflow-x:auto">{"".join(pieces)}</div>'


def _line(text: str) -> str:
    first, *rest = text.splitlines() or [""]
    return f'<p style="margin:0.3em 0">{"<br/>".join(map(html.escape, [first, *rest]))}</p>'


def _table(table: Table) -> str:
    body = table.rows[1:] if table.has_head else table.rows
    columns = list(zip(*body, strict=True)) or [()] * len(table.rows[0])
    sides = ["right" if column and all(map(_NUMBERS.fullmatch, column)) else "left" for column in columns]
    lines = []
    for k, row in enumerate(table.rows):
        kind = "th" if table.has_head and not k else "td"
        styles = (f"text-align:{side};{_CELL}" for side in sides)
        cells = zip(map(html.escape, row), styles, strict=True)
        lines.append("".join(f'<{kind} style="{style}">{cell}</{kind}>' for cell, style in cells))
    rows = "".join(f"<tr>{line}</tr>" for line in lines)
    head, rest = rows.split("</tr>", 1) if table.has_head else ("", rows)
    head = f"<thead>{head}</tr></thead>" if head else ""
    return f'<table style="font-variant-numeric:tabular-nums;white-space:nowrap">{head}<tbody>{rest}</tbody></table>'
