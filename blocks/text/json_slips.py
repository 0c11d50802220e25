"""The usual slips in a JSON text: the message about one, and what it is read as."""

from __future__ import annotations

import re
from typing import Literal, TypeAlias

from .json_document import Path
from .json_number import number_cure
from .printable import quoted

__all__ = ["LITERALS", "PLAIN", "Wanted", "mended", "plain", "slip"]

Wanted: TypeAlias = Literal["value", "key", "colon", "comma", "end"]
"""What may stand at a place."""

# Possessive quantifiers (*+, ++) never give back: a match that fails costs one pass over the text.
PLAIN = r'[^"\\\x00-\x1f\ud800-\udfff]*+'
_QUOTES = r"'`\u00b4\u2018\u2019\u201c\u201d\u201e\u00ab\u00bb"
plain = re.compile(PLAIN).match
_word = re.compile(r"[\w$.+-]+").match
_strange_quotes = re.compile(rf"[{_QUOTES}]([^{_QUOTES}\n]*+)").match
_odd_string = re.compile(rf"[{_QUOTES}]([^{_QUOTES}\"\\\x00-\x1f\ud800-\udfff]*+)[{_QUOTES}]").match
_whole_part = re.compile(r".*?([0-9]+), ?", re.DOTALL).fullmatch
_closed = re.compile(r"[ \t\n\r]*+[\]}]").match

LITERALS = {"true": True, "false": False, "null": None}
_CLOSERS = {"{": "}", "[": "]"}


def slip(text: str, at: int, path: Path, wanted: Wanted, bracket: str, opened: str) -> tuple[int, str, str]:
    """Offset, message and cure for what stands at `at` where something else was wanted.

    `bracket` is the innermost one that is open, or empty, and `opened` says where it stands.
    """
    closer = _CLOSERS.get(bracket, "")
    key = quoted(path[-1]) if path and isinstance(path[-1], str) else "the key"
    names = {"value": "a value", "key": "a key in double quotes", "colon": "a colon", "end": "the end of the text"}
    expected = names.get(wanted, f"a comma or {closer}")
    char = text[at : at + 1]
    if not char and not bracket:
        return at, "the text is empty.", "Write one JSON value."
    if not char:
        message = f"expected {expected}, but the text ends before {opened} is closed."
        return at, message, f"Close it with {closer}."
    thing = _thing(text, at)
    message = f"expected {expected}, but {thing} stands here."
    if text.startswith(("//", "/*", "#"), at):
        return at, message, 'JSON has no comments: take it out, or keep it as an entry "x-note": "...".'
    if quotes := _strange_quotes(text, at):
        return at, message, f"Write {quoted(quotes[1])}."
    if not char.isprintable():
        return at, message, "Take it out."
    if char in "]}" and bracket and char != closer:
        message = f"{opened} is closed by {closer}, but {char} stands here."
        return at, message, f"Write {closer} here, or close the {bracket} before."
    if char in "]}" and (wanted == "key" or (wanted == "value" and bracket == "[")):
        return text.rindex(",", 0, at), f"a comma stands before the closing {char}.", "Take the comma out."
    if wanted == "value" and (word := _word(text, at)):
        return at, *_odd_value(word[0])
    if wanted == "key" and char.isdigit() and (whole := _whole_part(text[max(0, at - 30) : at])):
        return at, message, f"Decimals follow a point: {whole[1]}.{word[0] if (word := _word(text, at)) else char}."
    is_last = _closed(text, at + 1) is not None
    return at, message, _cure(char, wanted, bracket, _word(text, at), key, text[at - 1], is_last=is_last)


def mended(text: str, at: int, wanted: Wanted, bracket: str) -> tuple[int, str, bool] | None:
    """What a slip at `at` is read as: an offset, the text to put there, and whether nothing else can be meant."""
    char = text[at : at + 1]
    if text.startswith(("//", "#"), at):
        end = text.find("\n", at)
        return at, " " * ((len(text) if end < 0 else end) - at), True
    if text.startswith("/*", at) and (end := text.find("*/", at + 2)) >= 0:
        return at, " " * (end + 2 - at), True
    if char in "]}":
        is_left = bracket and char == _CLOSERS[bracket] and (wanted == "key" or (wanted == "value" and bracket == "["))
        return (text.rindex(",", 0, at), " ", True) if is_left else None
    if wanted in ("key", "value") and (quotes := _odd_string(text, at)):
        return at, f'"{quotes[1]}"', True
    word = _word(text, at)
    if wanted == "value" and word:
        literal = word[0].lower().replace("none", "null")
        is_literal = literal in LITERALS
        return at, literal if is_literal else "0".ljust(len(word[0])), is_literal
    if wanted == "comma" and char == ";":
        return at, " " if _closed(text, at + 1) else ",", True
    if wanted == "comma" and (word or char in '"{[') and text[at - 1] in " \t\n\r" and char not in "+-":
        return at - 1, ",", not (word and word[0][0].isdigit())  # 1 500 is one number for many
    return (at, ":", True) if wanted == "colon" and char == "=" else None


def _cure(
    char: str, wanted: Wanted, bracket: str, word: re.Match[str] | None, key: str, before: str, *, is_last: bool
) -> str:
    match wanted:
        case "value" if bracket == "{":
            return f"Write {key}: and its value, or take the key out."
        case "value":
            return "Take it out." if char in ",:;" else 'A value is "text", 1.5, true, false, null, [...] or {...}.'
        case "key" if word:
            return f"Write {quoted(word[0])}."
        case "key":
            return "Take it out." if char in ",;" else 'An entry of an object is "key": value.'
        case "colon" if char == "=":
            return "Write : instead."
        case "colon" if word and before == '"':
            return 'Is a " missing at the end of the key, or one too many?'
        case "colon":
            return "Put a colon before it." if word or char in '"{[' else 'An entry of an object is "key": value.'
        case "comma" if char == ";":
            return "Take it out." if is_last else "Write a comma instead."
        case "comma" if char.isdigit() and bracket == "[":
            return "Put a comma before it, if it is another number; digits are not grouped."
        case "comma" if char in "+-*/^%":
            return 'An expression is a text that begins with =, such as "=2*kp".'
        case "comma" if char == ":":
            return "Entries with keys stand in { }." if bracket == "[" else "An entry has one key and one value."
        case "comma":
            return "Put a comma before it." if word or char in '"{[' else "Take it out."
        case "end":
            return "No bracket is open: take it out." if char in "]}" else "A text holds one value: take the rest out."


def _thing(text: str, at: int) -> str:
    """What stands at an offset, in words."""
    char = text[at]
    if text.startswith(("//", "/*", "#"), at):
        return "a comment"
    if char == '"' and (string := plain(text, at + 1)):
        return f"the string {quoted(string[0])}"
    if word := _word(text, at):
        return quoted(word[0])[1:-1]
    if not char.isprintable():
        return f"the invisible character U+{ord(char):04X}"
    return {",": "a comma", ":": "a colon", ";": "a semicolon"}.get(char, char)


def _odd_value(word: str) -> tuple[str, str]:
    """Message and cure for a word where a value is wanted."""
    shown = quoted(word)[1:-1]
    plain = word.strip("+-").lower()
    if plain in ("nan", "inf", "infinity"):
        return f"JSON has no {shown}.", "Write a finite number, or leave the entry out."
    if plain in ("true", "false", "null", "none"):
        return f"expected a value, but {shown} stands here.", f"Write {plain.replace('none', 'null')}."
    if word[0] in "+-.0123456789":
        if plain.isidentifier():
            return f"{shown} is not a number of JSON.", f"Write {quoted('=' + word)}, if it is an expression."
        return f"{shown} is not a number of JSON.", number_cure(word)
    return f"expected a value, but {shown} stands here.", f"Write {quoted(word)}, if it is a string."
