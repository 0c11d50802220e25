"""Names, paths and texts as messages may show them; counts and tables as commands print them."""

from __future__ import annotations

from collections.abc import Collection, Sequence


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """The lines of a table, each column as wide as its longest cell."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]


def as_markdown(rows: Sequence[Sequence[str]], *, rights: Collection[int] = ()) -> str:
    """Return a Markdown table of a head and rows. rights: the columns that are aligned to the right."""
    head, *others = ["| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in rows]
    rule = "".join("---:|" if k in rights else "---|" for k in range(len(rows[0])))
    return "\n".join([head, f"|{rule}", *others])


def counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def legible(text: str) -> str:
    """A name or a path for a message: as it is, or quoted where it is long or holds what a terminal would obey."""
    return text if len(text) <= 200 and text.isprintable() else quoted(text)


def one_line(text: str) -> str:
    """Text of another program or file for a message: its first 300 characters, on one line, ? for unprintable ones."""
    return "".join(char if char.isprintable() else "?" for char in " ".join(text.split())[:300])


def quoted(text: str) -> str:
    """The text in double quotes for a message: on one line, safe for a terminal, at most 60 characters between them."""
    pieces = [_visible(char) for char in text[:61]]
    length = sum(map(len, pieces))
    if length > 60:
        while length > 57:
            length -= len(pieces.pop())
        pieces.append("...")
    return '"' + "".join(pieces) + '"'


def _visible(char: str) -> str:
    if char in '"\\':
        return "\\" + char
    if char.isprintable():
        return char
    code = ord(char)
    short = {"\n": "\\n", "\r": "\\r", "\t": "\\t"}.get(char)
    return short or (f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}")
