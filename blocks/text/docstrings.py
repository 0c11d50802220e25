"""Docstrings of blocks: paragraphs, lists, formulas and references.

First line: a sentence or a formula.
                                                (a blank line)
    formulas, indented, one line each

A paragraph of text, which may hold formulas.

word: an entry of a list, with lines below it
    indented.
other: another entry.

- a point
References: Author, Title, Journal Year.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from html import escape

from .formula_tree import Names
from .formulas import Code, Formula, Part, Words, formulas_in, html

_ENTRY = re.compile(r"([A-Za-z_][\w, ]{0,40}): (?=\S)")
_POINT = re.compile(r"[-*] (?=\S)")


@dataclass(frozen=True)
class Paragraph:
    text: str


@dataclass(frozen=True)
class Lines:
    """Formulas, one a line, with how far each is indented beyond the others."""

    lines: tuple[tuple[int, str], ...]


@dataclass(frozen=True)
class Entry:
    """An entry of a list: its word ("" for a point) and what is said about it."""

    word: str
    text: str
    pieces: list[Piece] = field(default_factory=list)


@dataclass(frozen=True)
class References:
    entries: tuple[str, ...]


Piece = Paragraph | Lines | Entry | References


def paragraphs_of(text: str, words: Collection[str] = ()) -> list[Piece]:
    """The pieces of a docstring that `inspect.cleandoc` has put straight. words: those that begin entries of lists."""
    made: list[Piece] = []
    for chunk in re.split(r"\n\s*\n", text.strip("\n")):
        lines = chunk.split("\n")
        if lines[0].startswith("References:"):
            made.append(References(_references(lines)))
        elif lines[0].startswith("    "):
            piece = Lines(_indented(lines))
            # What stands under an entry of a list, and deeper than formulas do, belongs to the entry.
            if made and isinstance(made[-1], Entry) and lines[0].startswith(" " * 8):
                made[-1].pieces.append(piece)
            else:
                made.append(piece)
        else:
            made += _text(lines, words)
    return made


def _indented(lines: list[str]) -> tuple[tuple[int, str], ...]:
    least = min(len(line) - len(line.lstrip()) for line in lines)
    return tuple((len(line) - len(line.lstrip()) - least, line.strip()) for line in lines)


def _text(lines: list[str], words: Collection[str]) -> list[Piece]:
    """Paragraphs and entries of lists: the lines below an entry are indented, or it ends where the next one begins."""
    first = _ENTRY.match(lines[0])
    is_list = first is not None and (
        first[1] in words or any(line.startswith("    ") or _ENTRY.match(line) for line in lines[1:])
    )
    made: list[Piece] = []
    gathered: list[str] = []

    def close() -> None:
        if not gathered:
            return
        text = " ".join(line.strip() for line in gathered)
        entry, point = _ENTRY.match(text) if is_list else None, _POINT.match(text)
        if point:
            made.append(Entry("", text[point.end() :]))
        elif entry:
            made.append(Entry(entry[1], text[entry.end() :]))
        else:
            made.append(Paragraph(text))
        gathered.clear()

    for line in lines:
        begins = _POINT.match(line) or (is_list and not line.startswith(" "))
        if begins:
            close()
        gathered.append(line)
    close()
    return made


def _references(lines: list[str]) -> tuple[str, ...]:
    text = " ".join(line.strip() for line in lines).removeprefix("References:").strip()
    parts = re.split(r"\s*(?=\[\d+\] )", text)
    return tuple(part for part in parts if part)


def is_readable(line: str, names: Names) -> bool:
    """Whether a line of formulas was read: at least one formula, and no sign of arithmetic is left among its words."""
    parts: list[Part] = formulas_in(line, names)
    rest = " ".join(part.text for part in parts if isinstance(part, Words)).replace("...", "")
    return (
        any(isinstance(part, Formula) for part in parts)
        and not any(isinstance(part, Code) for part in parts)
        and not re.search(r"[=<>^|_/*+\[\]{}]|\s-\s", rest)
        and rest.count("(") == rest.count(")")
    )


# --- as HTML -----------------------------------------------------------------------------------------------------


def html_of(pieces: Iterable[Piece], names: Names | None) -> str:
    """Pieces as HTML, all their texts escaped. names: those of formulas, which become MathML; None: none is looked for,
    as in texts of files, whose reading must not take long.
    """
    return "".join(_html(piece, names) for piece in pieces)


def _html(piece: Piece, names: Names | None) -> str:
    match piece:
        case Paragraph(text):
            return f"<p>{inline_html(text, names)}</p>"
        case References(entries):
            return "".join(f'<p class="reference">{escape(entry)}</p>' for entry in entries)
        case Entry(word, text):
            term = f"<dt><code>{escape(word)}</code></dt>" if word else ""
            return f"<dl>{term}<dd>{inline_html(text, names)}{html_of(piece.pieces, names)}</dd></dl>"
    if names is None:
        return f"<pre>{escape(chr(10).join(' ' * extra + line for extra, line in piece.lines))}</pre>"
    return f'<div class="formulas">{"".join(_line_html(line, names) for _, line in piece.lines)}</div>'


def _line_html(line: str, names: Names) -> str:
    """A line of formulas; what cannot be read stays as it is written."""
    if not is_readable(line, names):
        return f"<p><code>{escape(line)}</code></p>"
    columns = (inline_html(column, names, display=True) for column in re.split(r" {3,}", line))
    return "<p>" + '<span class="gap"></span>'.join(columns) + "</p>"


def inline_html(text: str, names: Names | None, *, display: bool = False) -> str:
    """A text with its code and its formulas as HTML, escaped. names: see `html_of`."""
    if names is None:
        return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))
    made = []
    for part in formulas_in(text, names):
        match part:
            case Formula():
                made.append(html(part, names, display=display))
            case Code(text):
                made.append(f"<code>{escape(text)}</code>")
            case Words(text):
                made.append(escape(text))
    return "".join(made)
