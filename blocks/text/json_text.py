r"""JSON text <-> plain values, with the position of every value and with the spelling of numbers kept.

    text --read--> Document(value, positions), value --write--> text;   write(read(s).value) == s if s is canonical

The grammar is RFC 8259 and nothing more. A document with faults raises one ModelError that holds all faults that
can be found: E001 not JSON, E002 a key twice, E004 a number out of range, E008 too large. Slips that can only mean
one thing (a comment, a comma too many, other quotes, NaN) are stepped over; any other ends the pass, since what stands
behind it can only be guessed.

In the order of this file: numbers, documents, the reader, what it says of the usual slips, the writer. They are one
file because each rule of the text (a limit, an escape, a number) binds the reader and the writer alike.
"""

from __future__ import annotations

import json
import re
import threading
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import accumulate, chain, islice
from math import isfinite
from typing import Any, Literal, NoReturn, Protocol, Self, TypeAlias, runtime_checkable

from .errors import Fault, ModelError

__all__ = ["AT_KEY", "Document", "Number", "meant", "nearest", "place_of", "quoted", "read", "write"]

Path: TypeAlias = tuple[str | int, ...]
Position: TypeAlias = tuple[int, int]

AT_KEY = -1
"""Behind a path in `Document.places`: the place of its key. No list has such an index."""

LARGEST_TEXT = 16 * 1024 * 1024  # bytes in UTF-8
LARGEST_DEPTH = 64
LARGEST_COUNT = 1_000_000
LONGEST_STRING = 100_000
# Every double has a spelling of 25 characters, every integer below 1.8e308 one of 310.
LONGEST_NUMBER = 400
# A text of a million faults would otherwise take a gigabyte to report.
MOST_FAULTS = 1_000
# Each slip that is stepped over costs a copy of the text.
MOST_SLIPS = 50

# Possessive quantifiers (*+, ++) never give back: a match that fails costs one pass over the text.
_NUMBER = r"-?(?:0|[1-9][0-9]*+)(?:\.[0-9]++)?(?:[eE][+-]?[0-9]++)?"
_PLAIN = r'[^"\\\x00-\x1f\ud800-\udfff]*+'
_QUOTES = r"'`\u00b4\u2018\u2019\u201c\u201d\u201e\u00ab\u00bb"
_is_number = re.compile(_NUMBER).fullmatch
_space = re.compile(r"[ \t\n\r]*+").match
_plain = re.compile(_PLAIN).match
_string = re.compile(r'"(?:[^"\\]++|\\.)*+"', re.DOTALL).match
_escape = re.compile(r'\\(?:(["\\/bfnrt])|u([0-9a-fA-F]{4}))').match
_key = re.compile(rf'"({_PLAIN})"[ \t\n\r]*+:[ \t\n\r]*+').match
_next = re.compile(r"[ \t\n\r]*+([,\]}])[ \t\n\r]*+").match
# The lookaheads keep 1.5.2, 012 and nullable whole, so that a slip is told as one word.
_scalar = re.compile(rf'"({_PLAIN})"|({_NUMBER})(?![\w$.+-])|(true|false|null)(?![\w$.+-])').match
_word = re.compile(r"[\w$.+-]+").match
_strange_quotes = re.compile(rf"[{_QUOTES}]([^{_QUOTES}\n]*+)").match
_odd_string = re.compile(rf"[{_QUOTES}]([^{_QUOTES}\"\\\x00-\x1f\ud800-\udfff]*+)[{_QUOTES}]").match
_whole_part = re.compile(r".*?([0-9]+), ?", re.DOTALL).fullmatch
_is_name = re.compile(r"[\w-]{1,60}").fullmatch
# Of a text without escapes that is JSON: 2 a key, 1 a string, 3 and 4 brackets, 5 another value.
_tokens = re.compile(r'"([^"]*+)"([ \t\n\r]*+:)?|([{\[])|([}\]])|([^ \t\n\r,:"{}\[\]]++)').finditer
_commas = re.compile(r',|"(?:[^"\\]++|\\.)*+"', re.DOTALL).finditer

_LITERALS = {"true": True, "false": False, "null": None}
_ESCAPES = {'"': '"', "\\": "\\", "/": "/", "b": "\b", "f": "\f", "n": "\n", "r": "\r", "t": "\t"}
_CLOSERS = {"{": "}", "[": "]"}


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


def place_of(path: Path) -> str:
    """The path as a person reads it: blocks.motor, wires["error.u1"], log[0]; of a long one, its end."""
    place = ""
    for step in path:
        if isinstance(step, int):
            place += f"[{step}]"
        elif _is_name(step):
            place += f".{step}" if place else step
        else:
            place += f"[{quoted(step)}]"
    return place if len(place) <= 120 else "..." + place[-117:]


def nearest(path: Path, places: Mapping[Path, Position]) -> Path:
    """The path, or the longest beginning of it that has a place."""
    while path and path not in places:
        path = path[:-1]
    return path


class Number(float):
    """A number that remembers how it was spelled: 0.10 stays 0.10, and `exact` is 1/10.

    It is a finite float in all else: equality, hash and arithmetic (whose results are plain floats). Only a zero
    is read as zero. Raises ModelError (E004) for what is no JSON number, is out of the range of a double, or has
    more than 400 characters.
    """

    __slots__ = ("_text",)
    _text: str

    def __new__(cls, text: str) -> Self:
        if len(text) > LONGEST_NUMBER:
            message = f"a number of {len(text)} characters: at most {LONGEST_NUMBER} are read."
            raise ModelError(Fault("E004", "", message, "Round it; a float holds 17 digits."))
        if _is_number(text) is None:
            raise ModelError(Fault("E004", "", f"{quoted(text)} is not a number of JSON.", _number_cure(text)))
        number = super().__new__(cls, text)
        if not isfinite(number):
            message = f"{quoted(text)[1:-1]} is too large: a float ends at 1.8e308."
            raise ModelError(Fault("E004", "", message, "Write a smaller number."))
        if not number and text.lower().partition("e")[0].strip("-0."):
            message = f"{quoted(text)[1:-1]} is too small: a float would hold 0."
            raise ModelError(Fault("E004", "", message, "Write 0, or a number from 5e-324 on."))
        number._text = text
        return number

    @property
    def text(self) -> str:
        """The spelling in JSON."""
        return self._text

    @property
    def exact(self) -> Fraction:
        """The number that the text means, before it is rounded to a float."""
        # Fraction("0e999999999") would compute the power of ten; every other exponent is bounded by the float's range.
        return Fraction(self._text) if self else Fraction(0)

    def __repr__(self) -> str:
        return self._text

    def __reduce__(self) -> tuple[type[Self], tuple[str]]:
        return type(self), (self._text,)


@dataclass(frozen=True)
class Document:
    """A JSON text that was read: its value, and where in the text every part of it stands.

    `value` is made of dict (in the order of the text), list, str, Number, bool and None. `positions` maps the path of
    every value (keys and indices from the root, whose path is `()`) to its line and column, both from 1, columns
    in characters; `key_positions` has the position of the key for every path that ends in one.
    """

    value: Any
    positions: Mapping[Path, Position]
    key_positions: Mapping[Path, Position]
    text: str
    file: str

    @property
    def places(self) -> Mapping[Path, Position]:
        """`positions`, and the positions of keys under their paths with AT_KEY behind."""
        return _Places(self.positions, self.key_positions)


class _Places(Mapping[Path, Position]):
    __slots__ = ("_keys", "_values")

    def __init__(self, values: Mapping[Path, Position], keys: Mapping[Path, Position]) -> None:
        self._values = values
        self._keys = keys

    def __getitem__(self, path: Path) -> Position:
        return self._keys[path[:-1]] if path and path[-1] == AT_KEY else self._values[path]

    def __iter__(self) -> Iterator[Path]:
        yield from self._values
        for path in self._keys:
            yield *path, AT_KEY

    def __len__(self) -> int:
        return len(self._values) + len(self._keys)


class _Lines:
    """Line and column of an offset; the lines are counted when first asked."""

    __slots__ = ("_starts", "_text")

    def __init__(self, text: str) -> None:
        self._text = text
        self._starts: list[int] = []

    def position(self, offset: int) -> Position:
        if not self._starts:
            self._starts = [0, *accumulate(len(line) + 1 for line in self._text.split("\n"))]
        line = bisect_right(self._starts, offset)
        return line, offset - self._starts[line - 1] + 1


class _Index:
    """Where each value stands, and its key, by path; found out from the beginning of the text up to what is asked for.

    One integer holds the offsets of a value and of its key (NO_KEY where it has none): there may be a million. Several
    threads may ask at once. A copy finds all of it out anew.
    """

    NO_KEY = LARGEST_TEXT

    def __init__(self, reader: _Reader) -> None:
        self.reader = reader
        self.known: dict[Path, int] = {}
        self.rest: Iterator[tuple[Path, int, int]] | None = None
        self.lock = threading.Lock()

    def __reduce__(self) -> Any:
        return _Index, (self.reader,)  # where it has come to in the text cannot be copied

    def read_on(self) -> bool:
        """One value more; whether there was one."""
        with self.lock:
            if self.rest is None:
                self.rest = self.reader.marked() if self.reader.marks else _scanned(self.reader.text)
            path, key, at = next(self.rest, ((), -1, -1))
            if at < 0:
                return False
            self.known[path] = (self.NO_KEY if key < 0 else key) * 2 * LARGEST_TEXT + at
            return True

    def offsets(self, path: Path) -> tuple[int, int]:
        """Of the key (NO_KEY: it has none) and of the value. Raises KeyError."""
        while path not in self.known and self.read_on():
            pass
        return divmod(self.known[path], 2 * LARGEST_TEXT)


class _Positions(Mapping[Path, Position]):
    """The positions of all values, or of all keys, by path."""

    __slots__ = ("_of_keys", "_places")

    def __init__(self, places: _Index, *, of_keys: bool) -> None:
        self._places = places
        self._of_keys = of_keys

    def __getitem__(self, path: Path) -> Position:
        key, at = self._places.offsets(path)
        if self._of_keys and key == _Index.NO_KEY:
            raise KeyError(path)
        return self._places.reader.lines.position(key if self._of_keys else at)

    def __iter__(self) -> Iterator[Path]:
        while self._places.read_on():
            pass
        for path in self._places.known:
            if not self._of_keys or self._places.offsets(path)[0] != _Index.NO_KEY:
                yield path

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _scanned(text: str) -> Iterator[tuple[Path, int, int]]:
    """Path, offset of the key (or -1) and offset of every value of a text that Python's parser has read (`_quick`)."""
    container: Path = ()
    counts: list[int] = []  # of the open containers: the index of the next entry, -1 in an object
    step: str | int = ""
    key = -1
    for token in _tokens(text):
        kind = token.lastindex
        if kind == 2:
            step, key = token[1], token.start()
            continue
        if kind == 4:
            counts.pop()
            container = container[:-1]
            continue
        path = container
        if counts:
            if counts[-1] >= 0:
                step, key = counts[-1], -1
                counts[-1] += 1
            path = (*container, step)
        yield path, key, token.start()
        if kind == 3:
            container = path
            counts.append(0 if token[3] == "[" else -1)


def read(text: str | bytes, *, file: str = "") -> Document:
    """The document that the text holds; bytes are UTF-8 without a byte-order mark.

    `file` is named in the faults; without one they name "<text>". Limits: 16 MiB, 64 nested containers, 1,000,000
    values, strings of 100,000 and numbers of 400 characters.

    Raises ModelError with all faults that were found, in the order of the text. Its `readable` is the Document that is
    meant, where there is no doubt about that.
    References: RFC 8259.
    """
    text = _decoded(text, file or "<text>")
    reader = _Reader(text, file)
    if text.startswith("\ufeff"):
        message, cure = "the text begins with a byte-order mark.", "Save the file as UTF-8 without one."
        reader.fault(Fault("E001", "", message, cure), 0)
        reader.text = text = " " + text[1:]
    try:
        value = _quick(text)
    except (ValueError, RecursionError):
        value = reader.whole()  # it says what is wrong, if something is
    index = _Index(reader)
    document = Document(value, _Positions(index, of_keys=False), _Positions(index, of_keys=True), text, file)
    if reader.faults:
        raise ModelError(*reader.faults, readable=document if reader.is_certain else None)
    return document


def meant(text: str | bytes, *, file: str = "") -> tuple[Document, tuple[Fault, ...]]:
    """The document that the text holds, or that it means in spite of slips, and the faults that those are.

    Raises ModelError where it could mean something else, too.
    """
    try:
        return read(text, file=file), ()
    except ModelError as error:
        if error.readable is None:
            raise
        return error.readable, error.faults


def _quick(text: str) -> Any:
    """The value of a plain text, by Python's parser, which is ten times as fast and knows no positions.

    Raises ValueError or RecursionError where the text is none, where it has more than that parser checks (escapes,
    halves of characters), and where it may be beyond a limit.
    """
    most = 1 + text.count(",") + text.count("[") + text.count("{")  # values
    # A string that is too long leaves a piece of half that length without quotes, wherever the pieces begin.
    half = LONGEST_STRING // 2
    is_long = any(text.find('"', at, at + half) < 0 for at in range(0, len(text) - half, half))
    if "\\" in text or most > LARGEST_COUNT or is_long or not (text.isascii() or _is_whole(text)):
        raise ValueError
    value = _PLAIN_JSON.decode(text)
    level, depth = [value], 0  # the values of one depth
    while level and depth < LARGEST_DEPTH:
        level = [item for item in level if type(item) is dict or type(item) is list]
        level = list(chain.from_iterable(item.values() if type(item) is dict else item for item in level))
        depth += 1
    if level:
        raise ValueError
    return value


def _of_pairs(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    made = dict(pairs)
    if len(made) < len(pairs):
        raise ValueError
    return made


def _of_constant(word: str) -> Any:
    raise ValueError(word)


_is_whole = re.compile(r"[^\ud800-\udfff]*+").fullmatch
_PLAIN_JSON = json.JSONDecoder(
    object_pairs_hook=_of_pairs, parse_float=Number, parse_int=Number, parse_constant=_of_constant
)


def _decoded(text: str | bytes, file: str) -> str:
    size = len(text)
    if isinstance(text, str) and size <= LARGEST_TEXT and not text.isascii():
        size = len(text.encode("utf-8", "surrogatepass"))
    if size > LARGEST_TEXT:
        message = f"the text has {size:,} bytes: at most {LARGEST_TEXT:,} are read."
        raise ModelError(Fault("E008", "", message, "Keep tables of data in files of their own.", file=file))
    if isinstance(text, str):
        return text
    if text.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in text[:4]:
        message = "the text is in UTF-16 or UTF-32, or not a text."
        raise ModelError(Fault("E001", "", message, "Save the file as UTF-8.", (), file, 1, 1))
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError as error:
        before = text[: error.start].decode("utf-8")
        line, column = _Lines(before).position(len(before))
        message = f"the byte 0x{text[error.start]:02x} stands here, and it is not UTF-8."
        fault = Fault("E001", "", message, "Save the file as UTF-8.", (), file, line, column)
    raise ModelError(fault)


Wanted: TypeAlias = Literal["value", "key", "colon", "comma", "end"]


class _Reader:
    """One pass over a text.

    `at` is the offset behind the value read last, `path` belongs to what is being read (while that is a key or a
    comma, to the container), `open` holds the offsets of the brackets not yet closed. Recursion is bounded by
    LARGEST_DEPTH.
    """

    def __init__(self, text: str, file: str) -> None:
        self.text = text
        self.file = file
        self.lines = _Lines(text)
        self.marks: list[Any] = []
        self.faults: list[Fault] = []
        self.path: list[str | int] = []
        self.open: list[int] = []
        self.at = 0
        self.slips = 0
        self.is_certain = True  # what is meant, in spite of the slips

    def marked(self) -> Iterator[tuple[Path, int, int]]:
        """Path, offset of the key (or -1) and offset of every value that was read."""
        path: Path = ()
        marks = iter(self.marks)
        for depth, step, key, at in zip(marks, marks, marks, marks, strict=True):
            path = (*path[: depth - 1], step) if depth else ()
            yield path, key, at

    def whole(self) -> Any:
        """The value of the text; `faults` are those that the pass did not end at."""
        # Commas outside of strings are fewer than values: where they are too many already, the pass is not begun.
        if self.text.count(",") >= LARGEST_COUNT:
            commas = (found.start() for found in _commas(self.text) if found[0] == ",")
            last = next(islice(commas, LARGEST_COUNT - 1, None), None)
            if last is not None:
                self.too_many(last + 1)
        value = self.value(self.space(0), "", -1)
        end = self.space(self.at)
        while end < len(self.text):
            end = self.step_over(end, "end")
        return value

    def value(self, at: int, step: str | int, key_at: int) -> Any:
        if len(self.marks) == 4 * LARGEST_COUNT:
            self.too_many(at)
        while (found := _scalar(self.text, at)) is None and self.text[at : at + 1] not in ("{", "[", '"'):
            at = self.step_over(at, "value")
        self.marks += (len(self.path), step, key_at, at)
        if found is None:
            match self.text[at : at + 1]:
                case "{":
                    return self.object(at)
                case "[":
                    return self.array(at)
                case _:
                    string, self.at = self.string(at)
                    return string
        self.at = found.end()
        match found.lastindex:
            case 1:
                return self.short(found[1], at)
            case 2:
                try:
                    return Number(found[2])
                except ModelError as error:
                    self.fault(error.faults[0], at)
                    return None
            case _:
                return _LITERALS[found[3]]

    def too_many(self, at: int) -> NoReturn:
        message = f"the text holds more than {LARGEST_COUNT:,} values."
        self.end("E008", at, message, "Keep tables of data in files of their own.")

    def object(self, at: int) -> dict[str, Any]:
        value: dict[str, Any] = {}
        keys: dict[str, int] = {}
        at = self.enter(at)
        while not self.is_left(at := self.past_comments(at, "key"), "}"):
            found = _key(self.text, at)
            key, after = (self.short(found[1], at), found.end()) if found else self.odd_key(at)
            if key in keys:
                line, column = self.lines.position(keys[key])
                message = f"the key {quoted(key)} stands twice, first at line {line}, column {column}."
                self.fault(Fault("E002", "", message, "Rename one, or take one out."), at)
            else:
                keys[key] = at
            self.path.append(key)
            value[key] = self.value(after, key, at)
            self.path.pop()
            at = self.behind_entry("}")
        return value

    def array(self, at: int) -> list[Any]:
        value: list[Any] = []
        at = self.enter(at)
        while not self.is_left(at := self.past_comments(at, "value"), "]"):
            self.path.append(len(value))
            value.append(self.value(at, len(value), -1))
            self.path.pop()
            at = self.behind_entry("]")
        return value

    def behind_entry(self, closer: str) -> int:
        """The offset of the next entry, or of the bracket that closes the container."""
        while (found := _next(self.text, self.at)) is None or found[1] not in (",", closer):
            self.step_over(self.space(self.at), "comma")
        if found[1] == closer:
            return found.start(1)
        wanted: Wanted = "key" if closer == "}" else "value"
        at = self.past_comments(found.end(), wanted)
        if self.text.startswith(closer, at):
            self.step_over(at, wanted)
        return at

    def past_comments(self, at: int, wanted: Wanted) -> int:
        while self.text.startswith(("/", "#"), at):
            at = self.step_over(at, wanted)
        return at

    def is_left(self, at: int, closer: str) -> bool:
        """Whether a container ends here."""
        if not self.text.startswith(closer, at):
            return False
        self.open.pop()
        self.at = at + 1
        return True

    def enter(self, at: int) -> int:
        if len(self.path) >= LARGEST_DEPTH:
            self.end("E008", at, f"containers are nested deeper than {LARGEST_DEPTH}.", "Split the diagram.")
        self.open.append(at)
        return self.space(at + 1)

    def odd_key(self, at: int) -> tuple[str, int]:
        """A key that holds escapes, and the offset behind its colon; or what is wrong with it."""
        while not self.text.startswith('"', at):
            at = self.step_over(at, "key")
        key, end = self.string(at)
        end = self.space(end)
        while not self.text.startswith(":", end):
            end = self.step_over(end, "colon")
        return key, self.space(end + 1)

    def string(self, at: int) -> tuple[str, int]:
        """A string with escapes, and the offset behind its closing quote; or what is wrong with it."""
        opened, pieces = at, list[str]()
        at += 1
        while len(pieces) <= 2 * LONGEST_STRING:  # two for each escape
            found = _plain(self.text, at)
            assert found is not None  # it matches the empty string
            pieces.append(found[0])
            at = found.end()
            char = self.text[at : at + 1]
            if char == '"':
                return self.short("".join(pieces), opened), at + 1
            if char != "\\" or at + 1 == len(self.text):
                self.broken_string(opened, at)
            piece, at = self.escape(at)
            pieces.append(piece)
        behind = _string(self.text, opened)  # nobody needs the rest of what is too long
        if behind is None:
            self.broken_string(opened, len(self.text))
        message = f"a string of more than {LONGEST_STRING:,} characters: at most {LONGEST_STRING:,} are read."
        self.fault(Fault("E008", "", message, "Shorten it."), opened)
        return "", behind.end()

    def escape(self, at: int) -> tuple[str, int]:
        found = _escape(self.text, at)
        if found is None:
            char = self.text[at + 1]
            shown = f"\\{char}" if char.isprintable() else f"a backslash before U+{ord(char):04X}"
            message = f"{shown} begins no escape of JSON."
            self.end("E001", at, message, r"Write a backslash as \\; a code has four digits: \u00e9.")
        if found[1]:
            return _ESCAPES[found[1]], found.end()
        code = int(found[2], 16)
        if not 0xD800 <= code < 0xE000:
            return chr(code), found.end()
        low = _escape(self.text, found.end())
        if code < 0xDC00 and low and low[2] and 0xDC00 <= int(low[2], 16) < 0xE000:
            return chr(0x10000 + (code - 0xD800 << 10) + int(low[2], 16) - 0xDC00), low.end()
        message = rf"\u{found[2]} is one half of a character."
        self.fault(Fault("E001", "", message, r"Write both halves, as in \ud83d\ude00, or the character."), at)
        return "\ufffd", found.end()

    def broken_string(self, opened: int, at: int) -> NoReturn:
        line, column = self.lines.position(opened)
        where = f"the string opened at line {line}, column {column}"
        char = self.text[at : at + 1]
        if char in ("", "\\"):
            self.end("E001", at, f"the text ends before {where} is closed.", 'Close it with ".')
        if char in "\r\n":
            self.end("E001", at, f"the line ends before {where} is closed.", r'Close it with ", or write \n.')
        if char >= " ":
            self.end("E001", at, f"U+{ord(char):04X} in {where} is one half of a character.", "Take it out.")
        cure = r"Write \t." if char == "\t" else rf"Write \u{ord(char):04x}, or take it out."
        self.end("E001", at, f"the control character U+{ord(char):04X} stands in {where}.", cure)

    def short(self, string: str, at: int) -> str:
        if len(string) > LONGEST_STRING:
            message = f"a string of {len(string):,} characters: at most {LONGEST_STRING:,} are read."
            self.fault(Fault("E008", "", message, "Shorten it."), at)
        return string

    def space(self, at: int) -> int:
        found = _space(self.text, at)
        return found.end() if found else at

    def step_over(self, at: int, wanted: Wanted) -> int:
        """Tell of a slip, and where it is one that can be mended, go on behind it as if it were.

        What is put in its place has its length, so that all offsets stay as they are.
        """
        bracket, opened = "", ""
        if self.open:
            bracket = self.text[self.open[-1]]
            line, column = self.lines.position(self.open[-1])
            opened = f"the {bracket} opened at line {line}, column {column}"
        place, message, cure = _slip(self.text, at, tuple(self.path), wanted, bracket, opened)
        mended = _mended(self.text, at, wanted, bracket)
        self.slips += 1
        if mended is None or self.slips > MOST_SLIPS:
            self.end("E001", place, message, cure)
        self.fault(Fault("E001", "", message, cure), place)
        first, piece, is_certain = mended
        self.text = self.text[:first] + piece + self.text[first + len(piece) :]
        self.is_certain &= is_certain
        return self.space(at)

    def fault(self, fault: Fault, at: int) -> None:
        line, column = self.lines.position(at)
        path, file = tuple(self.path), self.file or "<text>"
        self.faults.append(replace(fault, place=place_of(path), path=path, file=file, line=line, column=column))
        if len(self.faults) == MOST_FAULTS:
            self.end("E008", at, f"the reading ends after {MOST_FAULTS:,} faults.", "Mend these first.")

    def end(self, code: str, at: int, message: str, cure: str) -> NoReturn:
        """Ends the pass with one more fault."""
        line, column = self.lines.position(at)
        path = tuple(self.path)
        last = Fault(code, place_of(path), message, cure, path, self.file or "<text>", line, column)
        raise ModelError(*self.faults, last)


def _slip(text: str, at: int, path: Path, wanted: Wanted, bracket: str, opened: str) -> tuple[int, str, str]:
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
    found = _thing(text, at)
    message = f"expected {expected}, but {found} stands here."
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


def _mended(text: str, at: int, wanted: Wanted, bracket: str) -> tuple[int, str, bool] | None:
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
        is_literal = literal in _LITERALS
        return at, literal if is_literal else "0".ljust(len(word[0])), is_literal
    if wanted == "comma" and char == ";":
        return at, " " if _closed(text, at + 1) else ",", True
    if wanted == "comma" and (word or char in '"{[') and text[at - 1] in " \t\n\r" and char not in "+-":
        return at - 1, ",", not (word and word[0][0].isdigit())  # 1 500 is one number for many
    return (at, ":", True) if wanted == "colon" and char == "=" else None


_closed = re.compile(r"[ \t\n\r]*+[\]}]").match


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
    if char == '"' and (string := _plain(text, at + 1)):
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
        return f"{shown} is not a number of JSON.", _number_cure(word)
    return f"expected a value, but {shown} stands here.", f"Write {quoted(word)}, if it is a string."


def _number_cure(text: str) -> str:
    """How a number of another language is written in JSON."""
    if re.fullmatch(r"0[xX][0-9a-fA-F]{1,13}", text):
        return f"Write {int(text, 16)}."
    if len(text) <= 60 and (parts := re.fullmatch(r"([+-]?)0*([0-9_]*)(?:\.([0-9_]*))?([eE][+-]?[0-9]+)?", text)):
        sign, whole, fraction, exponent = parts.groups("")
        mended = f"{sign.strip('+')}{whole or 0}{'.' if parts[3] is not None else ''}{fraction or ''}{exponent}"
        mended = re.sub(r"\.(?![0-9])", ".0", mended.replace("_", ""))
        if _is_number(mended) and re.search("[0-9]", re.split("[eE]", text)[0]):
            return f"Write {mended}."
    return "A number is written like 12, -0.5 or 1e-6."


@runtime_checkable
class _Array(Protocol):
    """A scalar or an array of NumPy, which this module does not import."""

    def tolist(self) -> Any: ...


def write(value: Any, *, one_per_line: Callable[[Path, Any], bool]) -> str:
    r"""The canonical text of a value, with a line break at its end.

    A container for which `one_per_line(path, value)` is true has one entry per line, indented by one space per
    level; every other one stands on one line with all that it holds. An empty one is `{}` or `[]`.

    A Number is written as it was spelled, another float by its shortest repr. Tuples are lists; scalars and arrays of
    NumPy are the numbers they hold. Strings keep all characters but `"`, `\`, control characters, U+2028 and U+2029,
    and halves of surrogate pairs, which are escaped (`read` refuses those halves). The limits are those of `read`.

    Raises ModelError with all faults: E004 for inf, nan and what JSON does not know, E008 for what is too large.
    """
    writer = _Writer(one_per_line)
    writer.put(value, (), "\n")
    if writer.faults:
        raise ModelError(*writer.faults)
    text = "".join(writer.pieces) + "\n"
    if len(text) > LARGEST_TEXT or (not text.isascii() and len(text.encode("utf-8")) > LARGEST_TEXT):
        raise ModelError(Fault("E008", "", f"the text has more than {LARGEST_TEXT:,} bytes.", "Split it."))
    return text


# From here on an integer is rounded to an infinite float: half a spacing above the largest finite one.
_INTEGERS_END = (1 << 1024) - (1 << 970)
_PLAIN_TYPES = (str, int, float, dict, list, tuple, type(None), type)
_escapable = re.compile(r'["\\\x00-\x1f\u2028\u2029\ud800-\udfff]')
_SHORT_ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\t": "\\t"}


def _escaped(found: re.Match[str]) -> str:
    return _SHORT_ESCAPES.get(found[0]) or f"\\u{ord(found[0]):04x}"


class _Writer:
    def __init__(self, one_per_line: Callable[[Path, Any], bool]) -> None:
        self.one_per_line = one_per_line
        self.pieces: list[str] = []
        self.faults: list[Fault] = []
        self.count = 0

    def put(self, value: Any, path: Path, margin: str) -> None:
        """`margin` is the line break and the indentation of this level; it is empty inside a line."""
        self.count += 1
        if self.count > LARGEST_COUNT:
            self.end(path, f"there are more than {LARGEST_COUNT:,} values.")
        if not isinstance(value, _PLAIN_TYPES) and isinstance(value, _Array):
            value = value.tolist()
        if isinstance(value, Mapping | list | tuple):
            self.container(value, path, margin)
        else:
            self.pieces.append(self.scalar(value, path))

    def scalar(self, value: Any, path: Path) -> str:
        # The methods are those of the builtin: NumPy and enumerations have a repr of their own.
        match value:
            case str():
                return self.string(value, path)
            case None | True | False:
                return {None: "null", True: "true", False: "false"}[value]
            case Number():
                return value.text
            case float() if isfinite(value):
                return float.__repr__(value)
            case int() if abs(value) < _INTEGERS_END:
                return int.__repr__(value)
            case float():
                return self.fault("E004", path, f"JSON has no {float.__repr__(value)}.", "Write a finite number.")
            case int():
                return self.fault("E004", path, "an integer is too large: a float ends at 1.8e308.")
            case _:
                return self.fault("E004", path, f"a value of the type {type(value).__name__} has no form in JSON.")

    def string(self, value: str, path: Path) -> str:
        if len(value) > LONGEST_STRING:
            self.fault("E008", path, f"a string of {len(value):,} characters: at most {LONGEST_STRING:,} are written.")
        return '"' + _escapable.sub(_escaped, value) + '"'

    def container(self, value: Mapping[str, Any] | list[Any] | tuple[Any, ...], path: Path, margin: str) -> None:
        if len(path) >= LARGEST_DEPTH:
            self.end(path, f"containers are nested deeper than {LARGEST_DEPTH}, or one holds itself.")
        keyed = isinstance(value, Mapping)
        opening, closing = "{}" if keyed else "[]"
        if not value:
            self.pieces.append(opening + closing)
            return
        lines = bool(margin) and self.one_per_line(path, value)
        inner = margin + " " if lines else ""
        separator = opening + inner
        for key, entry in value.items() if isinstance(value, Mapping) else enumerate(value):
            self.pieces.append(separator)
            if isinstance(key, str):
                self.pieces.append(self.string(key, path) + ": ")
            elif keyed:
                self.fault("E004", path, f"a key is of the type {type(key).__name__}.", "Keys are strings.")
                continue
            self.put(entry, (*path, key), inner)
            separator = "," + (inner or " ")
        self.pieces.append((margin if lines else "") + closing)

    def fault(self, code: str, path: Path, message: str, cure: str = "") -> str:
        if len(self.faults) < MOST_FAULTS:
            self.faults.append(Fault(code, place_of(path), message, cure, path))
        return ""

    def end(self, path: Path, message: str) -> NoReturn:
        raise ModelError(*self.faults, Fault("E008", place_of(path), message, "Split it.", path))
