"""The usual slips in a JSON text: the message about one, and what it is read as."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, TypeAlias

from .json_document import Path, Position
from .json_number import number_cure
from .printable import quoted

Wanted: TypeAlias = Literal["value", "key", "colon", "comma", "end"]
"""What may stand at a place."""
CLOSERS = {"{": "}", "[": "]"}
# Possessive quantifiers (*+, ++) never give back: a match that fails costs one pass over the text.
INSIDE = r'(?:[^"\\\x00-\x1f\ud800-\udfff]++|\\(?:["\\/bfnrt]|u[0-9a-fA-F]{4}))*+'
"""What may stand in a string."""

_begun_string: Any = re.compile(rf'"{INSIDE}').match
_plain: Any = re.compile(r'[^"\\\x00-\x1f\ud800-\udfff]*+').match
_word = re.compile(r"[\w$.+-]+").match
_whole_part = re.compile(r".*?([0-9]+), ?", re.DOTALL).fullmatch
_EXPECTED = {"value": "a value", "key": "a key in double quotes", "colon": "a colon", "end": "the end of the text"}
_THINGS = {",": "a comma", ":": "a colon", ";": "a semicolon", "#": "a comment", "//": "a comment", "/*": "a comment"}
_NO_COMMENTS = 'JSON has no comments: remove it, or keep it as an entry "x-note": "...".'
_ENTRY = 'An entry of an object is "key": value.'
_Q = r"'`\u00b4\u2018\u2019\u201c\u201d\u201e\u00ab\u00bb"
# What is wanted, inside which bracket, before what: the cure, and what is read: "" nobody knows, " " nothing, "< " that
# before it. The first row that fits holds.
_SLIPS = [
    ("", "", r"(?://|#)[^\n]*+|/\*(?:[^*]++|\*(?!/))*+\*/", _NO_COMMENTS, " "),
    ("", "", r"/\*|//|#", _NO_COMMENTS, ""),
    ("value key", "", rf'[{_Q}]([^{_Q}"\\\x00-\x1f\ud800-\udfff]*+)[{_Q}]', "Write {inside}.", '"'),
    ("", "", rf"[{_Q}]([^{_Q}\n]*+)", "Write {inside}.", ""),
    ("value", "{", "", "Write {key}: and its value, or remove the key.", ""),
    ("value", "", "[,:;]", "Remove it.", ""),
    ("value", "", "", 'A value is "text", 1.5, true, false, null, [...] or {{...}}.', ""),
    ("key", "", r"[\w$.+-]", "Write {word}.", ""),
    ("key", "", "[,;]", "Remove it.", ""),
    ("colon", "", "=", "Write : instead.", ":"),
    ("colon", "", r'(?<=")[\w$.+-]', 'Is a " missing at the end of the key, or one too many?', ""),
    ("colon", "", r'[\w$.+"{[-]', "Put a colon before it.", ""),
    ("key colon", "", "", _ENTRY, ""),
    ("comma", "", r";(?=[ \t\n\r]*+[\]}])", "Remove it.", " "),
    ("comma", "", ";", "Write a comma instead.", ","),
    ("comma", "[", r"\d", "Put a comma before it, if it is another number; digits are not grouped.", "<,"),
    ("comma", "", "[+*/^%-]", 'Write an expression as a text that begins with =, such as "=2*kp".', ""),
    ("comma", "[", ":", "Put entries with keys into {{ }}.", ""),
    ("comma", "", ":", "An entry has one key and one value.", ""),
    ("comma", "", r'[\w$."{[]', "Put a comma before it.", "<,"),
    ("end", "", r"[\]}]", "No bracket is open: remove it.", ""),
    ("end", "", "", "The text must hold one value: remove the rest.", ""),
    ("", "", "", "Remove it.", ""),
]


class Slip(NamedTuple):
    """A slip at an offset. first, piece: what is read in place of the text from there on, "" where that is not known.

    is_certain: nothing else can be meant.
    """

    at: int
    message: str
    cure: str
    first: int = 0
    piece: str = ""
    is_certain: bool = True


def slip(text: str, at: int, wanted: Wanted, path: Path, open_at: int, position: Callable[[int], Position]) -> Slip:
    """What stands at `at` where something else was wanted. open_at: the innermost bracket that is open, or -1."""
    char, word = text[at : at + 1], _word(text, at)
    bracket = text[open_at] if open_at >= 0 else ""
    closer = CLOSERS.get(bracket, "")
    opened = "the {} opened at line {}, column {}"
    expected = f"expected {_EXPECTED.get(wanted) or f'a comma or {closer}'}, but "
    if not char and not bracket:
        return Slip(at, "the text is empty.", "Write one JSON value.")
    if not char:
        message = f"{expected}the text ends before {opened.format(bracket, *position(open_at))} is closed."
        return Slip(at, message, f"Close it with {closer}.")
    if char == '"' and wanted in ("key", "value"):
        return _broken_string(text, at, opened.format("string", *position(at)))
    if char in "]}" and bracket and char != closer:
        message = f"{opened.format(bracket, *position(open_at))} is closed by {closer}, but {char} is here."
        return Slip(at, message, f"Write {closer} here, or close the {bracket} before.")
    if char in "]}" and wanted in (("key", "value") if bracket == "[" else ("key",)):
        comma = text.rindex(",", 0, at)
        return Slip(comma, f"there is a comma before the closing {char}.", "Remove the comma.", comma, " ")
    if wanted == "value" and word:
        return _odd_value(word[0], at)
    if not char.isprintable():
        return Slip(at, f"{expected}the invisible character U+{ord(char):04X} is here.", "Remove it.")
    shown = quoted(word[0]) if word else ""
    thing = _THINGS.get(text[at : at + 2]) or _THINGS.get(char) or shown[1:-1] or char
    if char == '"':
        thing = f"the string {quoted(text[at + 1 : _plain(text, at + 1).end()])}"
    message = f"{expected}{thing} is here."
    if wanted == "key" and word and char.isdigit() and (whole := _whole_part(text[max(0, at - 30) : at])):
        return Slip(at, message, f"Decimals follow a point: {whole[1]}.{word[0]}.")
    key = quoted(path[-1]) if path and isinstance(path[-1], str) else "the key"
    return _listed(text, at, wanted, bracket, message, key, shown)


def _listed(text: str, at: int, wanted: Wanted, bracket: str, message: str, key: str, word: str) -> Slip:
    """Return the slip of the first row of _SLIPS that fits. key, word: those around, as its cure shows them."""
    match, cure, piece = next(
        (match, cure, piece)
        for place, inside, pattern, cure, piece in _SLIPS
        if wanted in (place or wanted) and inside in bracket and (match := re.compile(pattern).match(text, at))
    )
    cure = cure.format(key=key, word=word, inside=quoted(match[1]) if match.lastindex else "")
    if piece == "<,":  # 1 500 is one number for many
        piece = "," if text[at - 1] in " \t\n\r" else ""
        return Slip(at, message, cure, at - 1, piece, is_certain=not text[at].isdigit())
    if piece == '"':
        piece = f'"{match[1]}"'
    return Slip(at, message, cure, at, piece.ljust(len(match[0])) if piece else "")


def _broken_string(text: str, opened_at: int, opened: str) -> Slip:
    """What is wrong in a string."""
    at = _begun_string(text, opened_at).end()
    char, behind = text[at : at + 1], text[at + 1 : at + 2]
    if not char or (char == "\\" and not behind):
        return Slip(at, f"the text ends before {opened} is closed.", 'Close it with ".')
    if char in "\r\n":
        return Slip(at, f"the line ends before {opened} is closed.", r'Close it with ", or write \n.')
    if char == "\\":
        shown = f"\\{behind}" if behind.isprintable() else f"a backslash before U+{ord(behind):04X}"
        cure = r"Write a backslash as \\; a code has four digits: \u00e9."
        return Slip(at, f"{shown} is not an escape of JSON.", cure)
    if char >= " ":
        return Slip(at, f"U+{ord(char):04X} in {opened} is one half of a character.", "Remove it.")
    cure = r"Write \t." if char == "\t" else rf"Write \u{ord(char):04x}, or remove it."
    return Slip(at, f"the control character U+{ord(char):04X} is in {opened}.", cure)


def _odd_value(word: str, at: int) -> Slip:
    """A word where a value is wanted."""
    shown, name = quoted(word)[1:-1], word.strip("+-").lower()
    message, cure = f"expected a value, but {shown} is here.", f"Write {quoted(word)}, if it is a string."
    if name in ("true", "false", "null", "none"):
        literal = name.replace("none", "null")
        return Slip(at, message, f"Write {literal}.", at, literal.ljust(len(word)), is_certain=name == word.lower())
    if name in ("nan", "inf", "infinity"):
        message, cure = f"JSON has no {shown}.", "Write a finite number, or leave the entry out."
        if name != "nan":
            cure = f'Write a finite number; for a missing limit, "{"-" * word.startswith("-")}inf" in quotes.'
    elif word[0] in "+-.0123456789":
        message = f"{shown} is not a JSON number."
        cure = f"Write {quoted('=' + word)}, if it is an expression." if name.isidentifier() else number_cure(word)
    return Slip(at, message, cure, at, "0".ljust(len(word)), is_certain=False)
