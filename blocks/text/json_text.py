r"""JSON text -> plain values, with the position of every value and with the spelling of numbers kept.

    text --read--> Document(value, places), value --json_writer.write--> text;   write(read(s).value) == s
    if s is canonical

The grammar is RFC 8259 and nothing more. Values are made by Python's parser; a pass of our own says where they stand,
and what is wrong. A document with faults raises one ModelError that holds all faults that can be found: E001 not JSON,
E002 a key twice, E004 a number out of range, E008 too large. Slips that can only mean one thing (a comment, a comma too
many, other quotes, NaN) are stepped over; any other ends the pass, since what stands behind it can only be guessed.
"""

from __future__ import annotations

import json
import re
import threading
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate, chain, count
from typing import Any

from . import json_document as limits
from .errors import Fault, ModelError
from .json_document import AT_KEY, Document, Path, Position, place_of
from .json_number import NUMBER, Number
from .json_slips import CLOSERS, INSIDE, Wanted, slip
from .printable import quoted

# Each slip that is stepped over costs a copy of the text.
MOST_SLIPS = 50
FAR_TOO_MANY = 250_000
"""How many values beyond the limit are told without a look at each."""

# Possessive quantifiers (*+, ++) never give back: a match that fails costs one pass over the text. The lookaheads keep
# 1.5.2, 012 and nullable whole, so that a slip is reported as one word.
_space: Any = re.compile(r"[ \t\n\r]*+").match
_token: Any = re.compile(
    rf'[ \t\n\r]*+(?:(?P<string>"{INSIDE}")|(?P<number>{NUMBER})(?![\w$.+-])|(?P<word>true|false|null)(?![\w$.+-])'
    r"|(?P<open>[{\[])|(?P<close>[}\]])|(?P<comma>,)|(?P<colon>:)|(?P<end>\Z))"
).match
_entry = re.compile(rf'[ \t\n\r]*+(?P<comma>,)?[ \t\n\r]*+(?P<string>"{INSIDE}")[ \t\n\r]*+:').match
_VALUES = ("string", "number", "word", "open")
_strings = re.compile(rf'"{INSIDE}"').sub
# Group 1: the digits of half a character.
_halves = re.compile(r"\\(?:u[dD][89abAB]..\\u[dD][c-fC-F]..|u([dD][89a-fA-F]..)|.)").finditer
_half = re.compile(r"\\u[dD][89a-fA-F]").search


@dataclass
class _Scan:
    """One pass over a text: the paths and offsets of its values, and what is wrong with it.

    `path` belongs to what is being read (while that is a key or a comma, to the container), `open` holds the offsets of
    the brackets not yet closed, each with its keys and with the numbers of its entries. What is put in place of a slip
    (`meant`) has its length.
    """

    text: str
    meant: str
    file: str = ""
    most: int = limits.LARGEST_COUNT
    faults: list[Fault] = field(default_factory=list)
    path: Path = ()
    open: list[tuple[int, dict[str, int], Iterator[int]]] = field(default_factory=list)
    may_close: bool = False  # the innermost bracket
    slips: int = 0
    is_certain: bool = True  # what is meant, in spite of the slips

    @cached_property
    def starts(self) -> list[int]:
        """The offsets of the lines."""
        return [0, *accumulate(len(line) + 1 for line in self.text.split("\n"))]

    def position(self, offset: int) -> Position:
        line = bisect_right(self.starts, offset)
        return line, offset - self.starts[line - 1] + 1

    def marks(self) -> Iterator[tuple[Path, int, int]]:
        """Path, offset of the key (-1: it has none) and offset of every value, in the order of the text.

        Raises ModelError with all faults where one ends the pass.
        """
        wanted: Wanted = "value"
        at, key, key_at, bracket = 0, "", -1, ""
        values = count(1)
        while True:
            if bracket == "{" and wanted in ("key", "comma"):  # a key with what is around it at once, which is faster
                entry = _entry(self.meant, at)
                if entry is not None and bool(entry["comma"]) == (wanted == "comma"):
                    key_at, at, wanted, self.may_close = entry.start("string"), entry.end(), "value", False
                    self.path = (*self.path, self.key(entry["string"], key_at))
                    continue
            token = _token(self.meant, at)
            kind = token.lastgroup if token else ""
            is_value = wanted == "value" and kind in _VALUES
            is_left = kind == "close" and self.may_close and token["close"] == CLOSERS[bracket]
            is_key = wanted == "key" and kind == "string"
            if not (is_value or is_left or is_key or kind == wanted):
                self.step_over(at, wanted)
                continue
            start, at = token.start(kind), token.end()
            if kind == "end":
                return
            if kind == "colon":
                self.path, wanted = (*self.path, key), "value"
                continue
            if is_key:
                key, key_at, self.may_close, wanted = self.key(token["string"], start), start, False, "colon"
                continue
            if is_left:
                self.path = self.path[: -2 if wanted == "value" else -1]
                self.open.pop()
            if is_value:
                if next(values) > self.most:
                    message = f"the text holds more than {self.most:,} values."
                    self.fault("E008", start, message, "Keep tables of data in files of their own.", is_last=True)
                yield self.path, key_at, start
                self.take(kind, token, start)
            bracket = self.meant[self.open[-1][0]] if self.open else ""
            self.may_close = bool(bracket) and kind != "comma"
            wanted = "comma" if bracket else "end"
            if kind in ("open", "comma"):
                wanted = "key" if bracket == "{" else "value"
                if bracket == "[":
                    self.path, key_at = (*self.path, next(self.open[-1][2])), -1

    def take(self, kind: str, token: Any, start: int) -> None:
        """Check a value, and step into it or behind it."""
        if kind == "open":
            if len(self.open) == limits.LARGEST_DEPTH:
                message = f"containers are nested deeper than {limits.LARGEST_DEPTH}."
                self.fault("E008", start, message, "Split the diagram.", is_last=True)
            self.open.append((start, {}, count()))
            return
        if kind == "string":
            self.string(token["string"], start)
        elif kind == "number":
            self.number(token["number"], start)
        self.path = self.path[:-1]

    def key(self, token: str, at: int) -> str:
        key = self.string(token, at)
        first = self.open[-1][1].setdefault(key, at)
        if first != at:
            line, column = self.position(first)
            message = f"the key {quoted(key)} appears twice, first at line {line}, column {column}."
            self.fault("E002", at, message, "Rename or remove one of them.")
        return key

    def number(self, token: str, at: int) -> None:
        if len(token) > 300 or "e" in token or "E" in token:  # no other is out of range
            try:
                Number(token)
            except ModelError as error:
                self.fault("E004", at, error.faults[0].message, error.faults[0].cure)

    def string(self, token: str, at: int) -> str:
        """What a string says."""
        string = token[1:-1]
        if "\\" in string:
            for match in _halves(token) if _half(token) else ():
                if match[1]:
                    message = rf"\u{match[1]} is one half of a character."
                    cure = r"Write both halves, as in \ud83d\ude00, or the character."
                    self.fault("E001", at + match.start(), message, cure)
                    self.put(at + match.start(), r"\ufffd")
            string = json.loads(self.meant[at : at + len(token)])
        if len(string) > limits.LONGEST_STRING:
            message = f"the string has {len(string):,} characters; the limit is {limits.LONGEST_STRING:,}."
            self.fault("E008", at, message, "Shorten it.")
        return string

    def step_over(self, at: int, wanted: Wanted) -> None:
        """Reports a slip and, where it can be mended, mends it."""
        at = _space(self.meant, at).end()
        path, open_at = self.path, self.open[-1][0] if self.open else -1
        place, message, cure, first, piece, is_certain = slip(self.meant, at, wanted, path, open_at, self.position)
        if wanted == "value" and path and isinstance(path[-1], int) and self.meant[at : at + 1] in ("/", "#", "]"):
            self.path = path[:-1]  # it is no entry of the list
        self.slips += 1
        self.fault("E001", place, message, cure, is_last=not piece or self.slips > MOST_SLIPS)
        self.path = path
        self.put(first, piece)
        self.is_certain &= is_certain
        self.may_close |= place < at  # a comma stood before the bracket

    def put(self, at: int, piece: str) -> None:
        self.meant = self.meant[:at] + piece + self.meant[at + len(piece) :]

    def fault(self, code: str, at: int, message: str, cure: str, *, is_last: bool = False) -> None:
        """Tell a fault. is_last: it ends the pass."""
        path, file = self.path, self.file or "<text>"
        self.faults.append(Fault(code, place_of(path), message, cure, path, file, *self.position(at)))
        if is_last:
            raise ModelError(*self.faults)
        if len(self.faults) == limits.MOST_FAULTS:
            message = f"reading stops after {limits.MOST_FAULTS:,} faults."
            self.fault("E008", at, message, "Fix these faults first.", is_last=True)


class _Places(Mapping[Path, Position]):
    """The places of the values and keys of a text that has been read; it is scanned as far as they are asked for.

    Several threads may ask at once. A copy scans the text again.
    """

    def __init__(self, text: str, meant: str) -> None:
        self.scan = _Scan(text, meant)
        self.marks = self.scan.marks()
        self.known: dict[Path, int] = {}
        self.lock = threading.Lock()

    def __reduce__(self) -> Any:
        return _Places, (self.scan.text, self.scan.meant)  # how far it has come cannot be copied

    def scan_on(self) -> bool:
        """Whether there was one more value."""
        with self.lock:
            path, key_at, at = next(self.marks, ((), -1, -1))
            if at >= 0:
                self.known[path] = at
            if key_at >= 0:
                self.known[*path, AT_KEY] = key_at
            return at >= 0

    def __getitem__(self, path: Path) -> Position:
        while path not in self.known and self.scan_on():
            pass
        return self.scan.position(self.known[path])

    def __iter__(self) -> Iterator[Path]:
        while self.scan_on():
            pass
        return iter(self.known)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def read(text: str | bytes, *, file: str = "", times: int = 1) -> Document:
    """The document that the text holds; bytes are UTF-8 without a byte-order mark.

    `file` is named in the faults; without one they name "<text>". Limits: 16 MiB, 160 nested containers, 1,000,000
    values, strings of 100,000 and numbers of 400 characters. times: how many times more bytes and values it may have.

    Raises ModelError with all faults that were found, in the order of the text. Its `readable` is the Document that is
    meant, where there is no doubt about that.
    References: RFC 8259.
    """
    text = _decoded(text, file or "<text>", times * limits.LARGEST_TEXT)
    scan = _Scan(text, text, file, most=times * limits.LARGEST_COUNT)
    if text.startswith("\ufeff"):
        scan.fault("E001", 0, "the text begins with a byte-order mark.", "Save the file as UTF-8 without this mark.")
        scan.text = scan.meant = text = " " + text[1:]
    try:
        value = _quick(text, scan.most)
    except (ValueError, RecursionError):
        _check_count(scan)
        for _ in scan.marks():  # it says what is wrong, if something is
            pass
        value = _AS_MEANT.decode(scan.meant) if scan.is_certain else None
    document = Document(value, _Places(text, scan.meant), text, file)
    if scan.faults:
        raise ModelError(*scan.faults, readable=document if scan.is_certain else None)
    return document


def _check_count(scan: _Scan) -> None:
    """Refuse what holds far too many values at once: a scan would say so late."""
    most, bare = scan.most + FAR_TOO_MANY, scan.text
    if bare.count(",") >= most and '"' in bare:  # some may stand in strings
        bare = _strings(lambda match: " " * len(match[0]), bare)
    if bare.count(",") < most:
        return
    at = -1
    for _ in range(scan.most):
        at = bare.find(",", at + 1)
    message = f"the text holds more than {scan.most:,} values."
    scan.fault("E008", at + 1, message, "Keep tables of data in files of their own.", is_last=True)


def meant(text: str | bytes, *, file: str = "", times: int = 1) -> tuple[Document, tuple[Fault, ...]]:
    """The document that the text holds, or that it means in spite of slips, and the faults for these.

    Raises ModelError where it could mean something else, too.
    """
    try:
        return read(text, file=file, times=times), ()
    except ModelError as error:
        if error.readable is None:
            raise
        return error.readable, error.faults


def without_text(value: Any, left: Iterator[int] | None = None) -> object:
    """What `read` gives for the text of a plain value. Raises ValueError where only a text can tell: faults, limits."""
    kind, left = type(value), left or iter(range(1_000))
    if next(left, None) is None:
        raise ValueError
    if kind is float or kind is int:
        return Number(repr(value))  # its ModelError is a ValueError
    if kind is bool or kind is Number or value is None:
        return value
    if kind is str and len(value) <= 1_000:
        value.encode()  # refuses halves of characters
        return value
    if kind is list or kind is tuple:
        return [without_text(item, left) for item in value]
    if kind is dict and all(type(key) is str and len(key) <= 1_000 and key.isascii() for key in value):
        return {key: without_text(item, left) for key, item in value.items()}
    raise ValueError


def _of_pairs(pairs: list[tuple[str, Any]]) -> dict[str, object]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        raise ValueError
    return entries


def _number(text: str) -> Number | None:
    try:
        return Number(text)
    except ModelError:
        return None


_AS_MEANT = json.JSONDecoder(parse_float=_number, parse_int=_number)
_STRICT = json.JSONDecoder(object_pairs_hook=_of_pairs, parse_float=Number, parse_int=Number, parse_constant=Number)


def _quick(text: str, most: int) -> Any:
    """The value of a text in which nothing is wrong. Raises ValueError or RecursionError where that is not certain."""
    # A string that is too long leaves a piece of half that length without quotes, wherever the pieces begin.
    half = limits.LONGEST_STRING // 2
    bare = text.replace('\\"', "..") if "\\" in text else text
    is_long = any(bare.find('"', at, at + half) < 0 for at in range(0, len(text) - half, half))
    values = 1 + text.count(",") + text.count("[") + text.count("{")  # or fewer
    if is_long or values > most or ("\\u" in text and _half(text)):
        raise ValueError
    text.encode()  # a ValueError, if it holds halves of characters
    value = _STRICT.decode(text)
    level = [value]  # the values of one depth
    for _ in range(limits.LARGEST_DEPTH + 1):
        level = [item for item in level if type(item) is dict or type(item) is list]
        if not level:
            return value
        level = list(chain.from_iterable(item.values() if type(item) is dict else item for item in level))
    raise ValueError


_ARCHIVE = b"PK\x03\x04"  # so begins a ZIP file


def _decoded(text: str | bytes, file: str, largest: int) -> str:
    size = len(text)
    if isinstance(text, str) and size <= largest and not text.isascii():
        size = len(text.encode("utf-8", "surrogatepass"))
    if size > largest:
        message = f"the text has {size:,} bytes; the limit is {largest:,}."
        raise ModelError(Fault("E008", "", message, "Keep tables of data in files of their own.", file=file))
    if isinstance(text, str):
        return text
    if file.lower().endswith((".slx", ".mdl")):
        message, cure = "is a model of Simulink, not a diagram.", f"Make a diagram of it: blocks import {file}"
        raise ModelError(Fault("E001", "", message, cure, (), file, 1, 1))
    if text.startswith(_ARCHIVE):
        message = "is an archive, for example an FMU, not a diagram."
        cure = 'To run an FMU: blocks fmu run X.fmu. To use it as a block of a diagram: {"fmu": "X.fmu"}.'
        if file.lower().endswith(".ssp"):
            message = "is a package of SSP (System Structure and Parameterization), which blocks cannot read."
            cure = 'Unpack it: each FMU in its folder "resources" can be a block of a diagram, {"fmu": "X.fmu"}.'
        raise ModelError(Fault("E001", "", message, cure, (), file, 1, 1))
    line, column, message = 1, 1, "the text is in UTF-16 or UTF-32, or not a text."
    if not text.startswith((b"\xff\xfe", b"\xfe\xff")) and b"\0" not in text[:4]:
        try:
            return text.decode("utf-8")
        except UnicodeDecodeError as error:
            before = text[: error.start].decode("utf-8")
            line, column = _Scan(before, "").position(len(before))
            message = f"the byte 0x{text[error.start]:02x} is not UTF-8."
    raise ModelError(Fault("E001", "", message, "Save the file as UTF-8.", (), file, line, column))
