"""A diagram as a frozen value: what a file says, no more and no less.

Values of parameters stay as written (numbers with their spelling, `"=..."` texts, `{"value": ..., "unit": ...}`),
so that a canonical file is written back byte for byte. What they mean is settled by `flatten`.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

from ..text.errors import Fault, ModelError, did_you_mean
from ..text.json_document import AT_KEY, Path, nearest
from ..text.printable import quoted

if TYPE_CHECKING:
    from ..contract.block import Block

BlockClass: TypeAlias = "type[Block]"
FORMAT = "blocks-diagram"
VERSION = 3
"""The version that is written."""
OLD_VERSION = 2
"""A version that is read, too: the plain numbers of its measures are in SI."""
BASE = "base"
"""The name that stands for a block itself where one of its variants is chosen."""
DEEPEST = 30
"""How many subdiagrams may lie in each other."""
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,199}\Z", re.ASCII)
"""Names of blocks, parameters, inputs and outputs: identifiers of at most 200 characters."""
UMLAUTS = {"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss"}


def is_name(text: object) -> bool:
    return isinstance(text, str) and bool(NAME.match(text))


def check_name(name: object) -> None:
    """Raise ModelError (E111) for what is no name."""
    if not is_name(name):
        raise ModelError(Fault("E111", quoted(str(name)), "is not a name.", name_cure(str(name))))


def name_cure(text: str) -> str:
    """How an invalid name could be written: "groesse_mu" for "größe_μ"."""
    mended = re.sub(r"\W+", "_", "".join(map(_spelt, unicodedata.normalize("NFC", text))), flags=re.ASCII).strip("_")
    mended = f"_{mended}" if mended[:1].isdigit() else mended
    rule = "letters, digits and _, not beginning with a digit"
    return f'Write "{mended}": {rule}.' if is_name(mended) else f"Use {rule}."


def _spelt(letter: str) -> str:
    """A letter in English ones: umlauts as in German, others without their accents, Greek ones by their names."""
    if letter in UMLAUTS:
        return UMLAUTS[letter]
    plain = unicodedata.normalize("NFKD", letter)[:1] if not letter.isascii() else letter
    word = unicodedata.name(plain, "").split()
    if word[:1] == ["GREEK"] and "LETTER" in word:
        return word[-1].capitalize() if word[1] == "CAPITAL" else word[-1].lower()
    return plain


@dataclass(frozen=True, slots=True)
class BlockEntry:
    """One block of a diagram: exactly one of `type`, `diagram` (a value or a file's path) and `fmu` (a file's path).

    control: of a subdiagram, "enable" or "trigger" with what the file says. stream: the name of the stream of random
    numbers, or of all those in a subdiagram, where it is not that of the block. options: of an FMU, kind, isolate and
    timeout, those that the file gives. variants: what may stand in place of the block, by name; variant: the one that
    does unless another is asked for, "" for the block itself. ports: of a variant, its own names of the block's ports,
    where they differ. copies: how many blocks the entry makes, as written; None: the block alone. cls: the class, where
    the block was made in Python. loaded: the value of a diagram that is a
    file.
    """

    type: str = ""
    diagram: DiagramValue | str | None = None
    fmu: str = ""
    copies: object = None
    control: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    stream: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, object] = field(default_factory=dict)
    doc: object = ""
    ports: Mapping[str, str] = field(default_factory=dict)
    variant: str = ""
    variants: Mapping[str, BlockEntry] = field(default_factory=dict)
    extras: Mapping[str, object] = field(default_factory=dict)
    cls: BlockClass | None = field(default=None, compare=False, repr=False)
    loaded: DiagramValue | None = field(default=None, compare=False, repr=False)

    @property
    def what(self) -> str:
        """What the block is, for messages: its type, its FMU, its diagram."""
        inner = self.inner
        return self.type or self.fmu or (self.diagram if isinstance(self.diagram, str) else inner.name if inner else "")

    @property
    def control_inputs(self) -> tuple[str, ...]:
        """The inputs that a subdiagram has because it is enabled, or triggered by a signal."""
        return tuple(key for key, raw in self.control.items() if "every" not in raw)

    @property
    def inner(self) -> DiagramValue | None:
        """The subdiagram's value, inline or loaded."""
        return self.diagram if isinstance(self.diagram, DiagramValue) else self.loaded


@dataclass(frozen=True, slots=True)
class DiagramValue:
    """A diagram: blocks, wires (sink -> source), inputs, outputs, parameters, run settings, measures, layout.

    file, positions, prefix: where it was read, for the places of faults. They are not part of the value.
    """

    name: str = "diagram"
    doc: object = ""
    parameters: Mapping[str, object] = field(default_factory=dict)
    inputs: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    blocks: Mapping[str, BlockEntry] = field(default_factory=dict)
    wires: Mapping[str, str] = field(default_factory=dict)
    run: Mapping[str, Any] = field(default_factory=dict)
    measures: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    layout: Mapping[str, Sequence[float]] = field(default_factory=dict)
    extras: Mapping[str, object] = field(default_factory=dict)
    file: str = field(default="", compare=False, repr=False)
    folder: str = field(default="", compare=False, repr=False)  # where its relative paths begin
    positions: Mapping[Path, tuple[int, int]] = field(default_factory=dict, compare=False, repr=False)
    prefix: tuple[str | int, ...] = field(default=(), compare=False, repr=False)

    def fault(self, code: str, place: str, message: str, cure: str = "", path: tuple[str | int, ...] = ()) -> Fault:
        """A fault with its place in the file: that of `path`, or of the nearest thing around it.

        With AT_KEY behind a path it is the place of its key.
        """
        full = nearest((*self.prefix, *path), self.positions)
        line, column = self.positions.get(full, (0, 0))
        full = full[:-1] if full[-1:] == (AT_KEY,) else full
        return Fault(code, place, message, cure, full, self.file, line, column)


def beside(faults: Iterable[Fault], first: Sequence[Fault]) -> list[Fault]:
    """Faults of the meaning without those that follow from faults of the structure, which were found first."""
    names = {str(fault.path[-1]) for fault in first if fault.code in ("E109", "E111") and fault.path}
    return [fault for fault in faults if not any(_follows(fault, cause, names) for cause in first)]


def _follows(fault: Fault, first: Fault, names: Collection[str]) -> bool:
    """Whether a fault may follow from an earlier one: at its place, around it, inside it, or of a refused name."""
    shared = min(len(fault.path), len(first.path))
    if first.code in ("E001", "E002"):  # slips of the text that were read as intended
        return False
    if fault.file != first.file:
        return not fault.path
    if fault.path[:shared] == first.path[:shared]:
        return True
    # A key that is misspelt is missing as well.
    if first.code == "E003" and fault.path[: len(first.path) - 1] == first.path[:-1]:
        return "measures" in first.path[-3:-2] or fault.code in ("E009", "E107")
    if first.code == "E004" and first.path[-1:] in (("blocks",), ("inputs",), ("parameters",), ("wires",)):  # not read
        return fault.path[: len(first.path) - 1] == first.path[:-1]
    return any(str(part).partition(".")[0] in names for part in fault.path)


class FaultList:
    """The faults of one pass, each once, with bounds: neither many faults nor many guesses may take forever."""

    MOST = 1_000
    MOST_COMPARED = 200_000
    LONGEST_MESSAGE = 500

    def __init__(self) -> None:
        self._faults: dict[object, Fault] = {}
        self._compared = 0

    def __bool__(self) -> bool:
        return bool(self._faults)

    def __len__(self) -> int:
        return len(self._faults)

    def add(self, fault: Fault, key: object = None) -> None:
        """Add a fault, unless one with its key is there (without a key: an equal one)."""
        if len(self._faults) >= self.MOST:
            last = Fault("E008", "", f"the check ends after {self.MOST:,} faults.", "Correct these first.")
            raise ModelError(*self.in_order(), last)
        self._faults.setdefault(fault if key is None else key, fault)

    def update(self, faults: Iterable[Fault]) -> None:
        for fault in faults:
            self.add(fault)

    def guess(self, word: str, known: Collection[str], *, quote: str = "'") -> str:
        """`did_you_mean`, or nothing once that has become too much work."""
        self._compared += len(known)
        return "" if self._compared > self.MOST_COMPARED else did_you_mean(word[:200], known, quote=quote)

    def in_order(self) -> list[Fault]:
        """The faults file by file, in the order of the text."""
        files = {fault.file: index for index, fault in reversed(list(enumerate(self._faults.values())))}
        return sorted(self._faults.values(), key=lambda fault: (files[fault.file], fault.line, fault.column))

    def check(self) -> None:
        """Raise ModelError with all faults, if there are any."""
        if self._faults:
            raise ModelError(*self.in_order())
