"""Texts of a drawing: their width by a table, cut, cleaned and escaped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..text.json_number import Number

# Widths of Helvetica in thousandths of the size, as its metrics file (AFM) has them, from the space to the tilde.
_ASCII = (
    278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278,
    556, 556, 556, 556, 556, 556, 556, 556, 556, 556, 278, 278, 584, 584, 584, 556,
    1015, 667, 667, 722, 722, 667, 611, 778, 722, 278, 500, 667, 556, 833, 722, 778,
    667, 778, 722, 667, 611, 722, 667, 944, 667, 667, 611, 278, 278, 278, 469, 556,
    333, 556, 556, 500, 556, 556, 278, 556, 556, 222, 222, 500, 222, 833, 556, 556,
    556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334, 260, 334, 584,
)  # fmt: skip
_OTHERS = {"…": 1000, "−": 584, "×": 584, "÷": 584, "⁻": 400, "�": 1000}
_SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹"
# Sans-serif faces differ; the wider ones (DejaVu Sans, Verdana) are a tenth wider than Helvetica or more.
_RESERVE = 1.12


def width_of(text: str, size: float) -> float:
    """How wide a text is at most, in user units."""
    return size * _RESERVE * sum(map(_thousandths, text)) / 1000


def _thousandths(character: str) -> int:
    code = ord(character)
    if 32 <= code < 127:
        return _ASCII[code - 32]
    if character in _SUPERSCRIPTS:
        return 370
    if character in _OTHERS:
        return _OTHERS[character]
    return 780 if code < 0x1100 else 1100


def plain(text: str) -> str:
    """The text with a replacement character for all that is not printable, controls and surrogates among it."""
    return text if text.isprintable() else "".join(c if c.isprintable() else "\ufffd" for c in text)


def cut(text: str, most: int) -> str:
    """A printable text of at most `most` characters, the last one an ellipsis where something is left out."""
    if len(text) > most:
        text = text[: most - 1] + "…"
    return plain(text)


def fitted(text: str, size: float, width: float) -> str:
    """A printable text that is at most `width` wide."""
    text = cut(text, 200)
    if width_of(text, size) <= width:
        return text
    while text and width_of(text + "…", size) > width:
        text = text[:-1]
    return text + "…"


def escaped(text: str) -> str:
    """The text for XML, in content and in attributes."""
    for character, entity in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ('"', "&quot;"), ("'", "&#39;")):
        text = text.replace(character, entity)
    return text


def shown(raw: object, depth: int = 0) -> str:
    """A parameter's value as the file has it: 0.10, k/2 for "=k/2", [1, 0.2, 1], 2 V."""
    if isinstance(raw, str):
        return cut(raw[1:] if raw.startswith("=") else raw, 200)
    if isinstance(raw, Mapping):
        return f"{shown(raw.get('value', ''), depth + 1)} {shown(str(raw.get('unit', '')))}".strip()
    if isinstance(raw, Number | bool):
        return str(raw)
    if isinstance(raw, float):
        return f"{raw:.6g}"
    if isinstance(raw, Sequence):
        parts = [shown(item, depth + 1) for item in raw[:20]] if depth < 4 else ["…"]
        return f"[{', '.join(parts)}{', …' if len(raw) > 20 else ''}]"
    return cut(str(raw), 200)
