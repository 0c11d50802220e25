r"""JSON text -> plain values, with the position of every value and with the spelling of numbers kept.

    text --read--> Document(value, positions), value --json_writer.write--> text;   write(read(s).value) == s
    if s is canonical

The grammar is RFC 8259 and nothing more. A document with faults raises one ModelError that holds all faults that
can be found: E001 not JSON, E002 a key twice, E004 a number out of range, E008 too large. Slips that can only mean
one thing (a comment, a comma too many, other quotes, NaN) are stepped over; any other ends the pass, since what stands
behind it can only be guessed.

Beside it: numbers (`json_number`), what is read and its limits (`json_document`), what is said of the usual slips
(`json_slips`), and the writer.
"""

from __future__ import annotations

import json
import re
import threading
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import accumulate, chain, islice
from typing import Any, NoReturn

from .errors import Fault, ModelError
from .json_document import (
    LARGEST_COUNT,
    LARGEST_DEPTH,
    LARGEST_TEXT,
    LONGEST_STRING,
    MOST_FAULTS,
    Document,
    Path,
    Position,
    place_of,
)
from .json_number import NUMBER, Number
from .json_slips import LITERALS, PLAIN, Wanted, mended, plain, slip
from .printable import quoted

__all__ = ["meant", "read"]

# Each slip that is stepped over costs a copy of the text.
MOST_SLIPS = 50

# Possessive quantifiers (*+, ++) never give back: a match that fails costs one pass over the text.
_space = re.compile(r"[ \t\n\r]*+").match
_string = re.compile(r'"(?:[^"\\]++|\\.)*+"', re.DOTALL).match
_escape = re.compile(r'\\(?:(["\\/bfnrt])|u([0-9a-fA-F]{4}))').match
_key = re.compile(rf'"({PLAIN})"[ \t\n\r]*+:[ \t\n\r]*+').match
_next = re.compile(r"[ \t\n\r]*+([,\]}])[ \t\n\r]*+").match
# The lookaheads keep 1.5.2, 012 and nullable whole, so that a slip is reported as one word.
_scalar = re.compile(rf'"({PLAIN})"|({NUMBER})(?![\w$.+-])|(true|false|null)(?![\w$.+-])').match
# Of a text without escapes that is JSON: 2 a key, 1 a string, 3 and 4 brackets, 5 another value.
_tokens = re.compile(r'"([^"]*+)"([ \t\n\r]*+:)?|([{\[])|([}\]])|([^ \t\n\r,:"{}\[\]]++)').finditer
_commas = re.compile(r',|"(?:[^"\\]++|\\.)*+"', re.DOTALL).finditer

_ESCAPES = {'"': '"', "\\": "\\", "/": "/", "b": "\b", "f": "\f", "n": "\n", "r": "\r", "t": "\t"}


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
    """Where each value stands, and its key, by path; read from the beginning of the text up to what is asked for.

    One integer holds the offsets of a value and of its key (NO_KEY where it has none): there may be a million. Several
    threads may ask at once. A copy reads all of it again.
    """

    NO_KEY = LARGEST_TEXT

    def __init__(self, reader: _JsonReader) -> None:
        self.reader = reader
        self.known: dict[Path, int] = {}
        self.rest: Iterator[tuple[Path, int, int]] | None = None
        self.lock = threading.Lock()

    def __reduce__(self) -> Any:
        return _Index, (self.reader,)  # where it has come to in the text cannot be copied

    def read_on(self) -> bool:
        """Reads one more value; whether there was one."""
        with self.lock:
            if self.rest is None:
                self.rest = self.reader.marked() if self.reader.marks else _scanned(self.reader.text)
            path, key, at = next(self.rest, ((), -1, -1))
            if at < 0:
                return False
            self.known[path] = (self.NO_KEY if key < 0 else key) * 2 * LARGEST_TEXT + at
            return True

    def offsets(self, path: Path) -> tuple[int, int]:
        """The offsets of the key (NO_KEY: it has none) and of the value. Raises KeyError."""
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
    reader = _JsonReader(text, file)
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
    """The document that the text holds, or that it means in spite of slips, and the faults for these.

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

    Raises ValueError or RecursionError where the text is no JSON, where it has more than that parser checks (escapes,
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
    entries = dict(pairs)
    if len(entries) < len(pairs):
        raise ValueError
    return entries


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


class _JsonReader:
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
        """The value of the text; `faults` are those that did not end the pass."""
        # Commas outside of strings are fewer than values: where they are too many already, the pass is not begun.
        if self.text.count(",") >= LARGEST_COUNT:
            commas = (match.start() for match in _commas(self.text) if match[0] == ",")
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
        while (scalar := _scalar(self.text, at)) is None and self.text[at : at + 1] not in ("{", "[", '"'):
            at = self.step_over(at, "value")
        self.marks += (len(self.path), step, key_at, at)
        if scalar is None:
            match self.text[at : at + 1]:
                case "{":
                    return self.object(at)
                case "[":
                    return self.array(at)
                case _:
                    string, self.at = self.string(at)
                    return string
        self.at = scalar.end()
        match scalar.lastindex:
            case 1:
                return self.short(scalar[1], at)
            case 2:
                try:
                    return Number(scalar[2])
                except ModelError as error:
                    self.fault(error.faults[0], at)
                    return None
            case _:
                return LITERALS[scalar[3]]

    def too_many(self, at: int) -> NoReturn:
        message = f"the text holds more than {LARGEST_COUNT:,} values."
        self.end("E008", at, message, "Keep tables of data in files of their own.")

    def object(self, at: int) -> dict[str, Any]:
        value: dict[str, Any] = {}
        keys: dict[str, int] = {}
        at = self.enter(at)
        while not self.is_left(at := self.past_comments(at, "key"), "}"):
            match = _key(self.text, at)
            key, after = (self.short(match[1], at), match.end()) if match else self.odd_key(at)
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
        while (match := _next(self.text, self.at)) is None or match[1] not in (",", closer):
            self.step_over(self.space(self.at), "comma")
        if match[1] == closer:
            return match.start(1)
        wanted: Wanted = "key" if closer == "}" else "value"
        at = self.past_comments(match.end(), wanted)
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
            match = plain(self.text, at)
            assert match is not None  # it matches the empty string
            pieces.append(match[0])
            at = match.end()
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
        match = _escape(self.text, at)
        if match is None:
            char = self.text[at + 1]
            shown = f"\\{char}" if char.isprintable() else f"a backslash before U+{ord(char):04X}"
            message = f"{shown} begins no escape of JSON."
            self.end("E001", at, message, r"Write a backslash as \\; a code has four digits: \u00e9.")
        if match[1]:
            return _ESCAPES[match[1]], match.end()
        code = int(match[2], 16)
        if not 0xD800 <= code < 0xE000:
            return chr(code), match.end()
        low = _escape(self.text, match.end())
        if code < 0xDC00 and low and low[2] and 0xDC00 <= int(low[2], 16) < 0xE000:
            return chr(0x10000 + (code - 0xD800 << 10) + int(low[2], 16) - 0xDC00), low.end()
        message = rf"\u{match[2]} is one half of a character."
        self.fault(Fault("E001", "", message, r"Write both halves, as in \ud83d\ude00, or the character."), at)
        return "\ufffd", match.end()

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
        match = _space(self.text, at)
        return match.end() if match else at

    def step_over(self, at: int, wanted: Wanted) -> int:
        """Reports a slip and, where it can be mended, goes on behind it as if it were.

        What is put in its place has its length, so that all offsets stay as they are.
        """
        bracket, opened = "", ""
        if self.open:
            bracket = self.text[self.open[-1]]
            line, column = self.lines.position(self.open[-1])
            opened = f"the {bracket} opened at line {line}, column {column}"
        place, message, cure = slip(self.text, at, tuple(self.path), wanted, bracket, opened)
        meant_by = mended(self.text, at, wanted, bracket)
        self.slips += 1
        if meant_by is None or self.slips > MOST_SLIPS:
            self.end("E001", place, message, cure)
        self.fault(Fault("E001", "", message, cure), place)
        first, piece, is_certain = meant_by
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
