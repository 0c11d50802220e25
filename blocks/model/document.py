"""JSON <-> DiagramValue: the structure of a diagram file, with every fault in its place.

Only structure is read here: which keys there are and of what kind. What names and numbers mean (types, ports, units,
expressions) is settled by `flatten`. Reading a file never runs anything and opens nothing but the subdiagram files that
it names, which must lie in the same project.

This file is longer than others: reader and writer hold the same keys in the same order, and stand beside each other.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from ..text import json_text
from ..text.atomic_write import real, write_atomically
from ..text.csv_text import read_columns
from ..text.errors import Fault, ModelError, did_you_mean
from ..text.gc_pause import paused
from ..text.json_text import Number, quoted
from ..text.printable import legible
from .diagram import BASE, DEEPEST, FORMAT, VERSION, BlockEntry, DiagramValue, FaultList, is_name, name_cure
from .migrations import DIAGRAM, migrated
from .project import Project, project_of
from .settings import MASTER, QUANTITY
from .streams import is_stream
from .values import Column

__all__ = [
    "RUN",
    "alone",
    "canonical",
    "dumps",
    "entries",
    "from_document",
    "input_faults",
    "load",
    "loads",
    "read_inside",
    "relocated",
    "shape_of",
    "to_document",
    "write_atomically",
]

Steps = tuple[str | int, ...]
"""The place of something in a document: keys and indices from the root."""

MAX_BYTES = 16 * 2**20
LARGEST_SIZE = 100_000
MOST_ROWS = 1_000_000  # of a table
SCHEMA = "$schema"
"""The key that names the JSON Schema of a file. It is for editors: kept, and never looked at."""
HEADER = (SCHEMA, "format", "version")
TOP = (
    "name",
    "doc",
    "parameters",
    "inputs",
    "outputs",
    "blocks",
    "wires",
    "run",
    "measures",
    "layout",
)
OPTIONS = ("kind", "isolate", "timeout")
BLOCK = (
    "type", "diagram", "fmu", "enable", "trigger", "stream", *OPTIONS, "doc", "parameters", "ports", "variant",
    "variants",
)  # fmt: skip
FMU_KINDS = ("CS", "ME")
LONGEST_TIMEOUT = 1e6  # s
TYPES = ("real", "int", "bool")
ENUMERATION = ("enum", "members")
MEMBER = r"^(?!\s*[-+]?[0-9.]+([eE][-+]?[0-9]+)?\s*$)."  # a text that is no number may name a member
COLUMN = ("csv", "column", "unit", "doc")
INPUT = ("unit", "default", "size", "type", "doc")
RUN = (
    "start", "stop", "method", "step", "rtol", "atol", "every", "jumps", "stops", "seed", "inputs", "loops", "log",
    "master", "doc",
)  # fmt: skip
TABLE = ("t", "u", "interpolation", "unit")
INTERPOLATIONS = ("linear", "hold")
ENABLE = ("states", "outputs")
OFF = ("held", "reset")
TRIGGER = ("direction", "every", "offset")
DIRECTIONS = ("up", "down", "both")
MEASURE = ("type", "of", "against", "from", "to", "band", "doc")


# --- reading ---------------------------------------------------------------------------------------------------


def load(path: str | Path) -> DiagramValue:
    """The diagram of a file, with the subdiagram files that it names.

    Raises ModelError with all faults found (E0xx; E113 for files that contain each other).
    """
    path = Path(path)
    resolved = real(path)
    data = read_inside(path, Project(resolved.parent), Fault("E007", "", ""))
    # Absolute, so that it stays the same folder when the program goes to another.
    folder = os.path.abspath(path.parent)
    return _read(data, str(path), folder, _Loading(project_of(path)), (resolved,))


def loads(text: str | bytes, *, file: str = "<text>", folder: str | Path = "") -> DiagramValue:
    """The diagram of a text. Subdiagram files are looked for from `folder` on (the current one unless given)."""
    folder = os.path.abspath(folder)
    return _read(text, file, folder, _Loading(project_of(Path(folder) / "x")), ())


def alone(document: json_text.Document) -> tuple[DiagramValue | None, list[Fault]]:
    """What a file itself says, and its own faults: no other file is opened. None where it is no diagram."""
    loading = _Loading(Project(Path()), is_alone=True)
    try:
        value = _Reader(document, document.file, "", loading, ()).diagram()
    except ModelError as error:  # of too many faults
        loading, value = _Loading(Project(Path())), None
        loading.faults.update(error.faults)
    return value, loading.faults.in_order()


def canonical(document: json_text.Document) -> tuple[str, int]:
    """The canonical text of a diagram's document, in the newest version, and the version that it has.

    What the diagram means may be wrong; its structure may not. Raises ModelError with the faults of that.
    """
    value, faults = alone(document)
    # These leave nothing out of the value.
    faults = [fault for fault in faults if fault.code not in ("E105", "E109")]
    if faults:
        raise ModelError(*faults)
    assert value is not None
    made = dumps(value)
    if alone(json_text.read(made))[0] != value:
        raise AssertionError("the canonical text says something else")
    return made, value.version


def from_document(document: Mapping[str, Any], *, folder: str | Path = "") -> DiagramValue:
    """The diagram of a dict, as `json.load` would give it."""
    folder = os.path.abspath(folder)
    return _unseen(document, folder, project_of(Path(folder) / "x"))


def entries(*, folder: str = "", **sections: Mapping[str, Any]) -> DiagramValue:
    """Some sections of a diagram that is made in Python, as a file in `folder` would hold them. Raises ModelError."""
    folder = os.path.abspath(folder)
    return _unseen({"format": FORMAT, "version": VERSION, **sections}, folder, project_of(Path(folder) / "x"))


def _unseen(document: Mapping[str, Any], folder: str, project: Project) -> DiagramValue:
    """The diagram of a text that nobody sees: its faults have no line."""
    try:
        return _read(dumps_document(document), "", folder, _Loading(project), ())
    except ModelError as error:
        faults = (fault.at("", 0, 0) if fault.file in ("", "<text>") else fault for fault in error.faults)
        raise ModelError(*faults) from None


@paused()
def _read(text: str | bytes, file: str, folder: str, loading: _Loading, above: tuple[Path, ...]) -> DiagramValue:
    document, first = json_text.meant(text, file=file)
    made = _Reader(document, file, folder, loading, above).diagram()
    if first or loading.faults:
        faults, told = FaultList(), {fault.path for fault in first}
        faults.update(first)
        # A number that the text could not give is none for the diagram either.
        faults.update(fault for fault in loading.faults.in_order() if fault.code != "E004" or fault.path not in told)
        raise ModelError(*faults.in_order(), readable=made)
    assert made is not None
    return made


def read_inside(path: Path, project: Project, fault: Fault, shown: str = "") -> bytes:
    """The bytes of a file inside the project. Raises ModelError (E007, E008), worded from `fault`'s place.

    shown: what the message calls the file.
    """
    name = shown or str(path)
    name = quoted(name if len(name) <= 60 else f"...{name[-57:]}")

    def refuse(code: str, message: str, cure: str = "") -> ModelError:
        return ModelError(replace(fault, code=code, message=f"{name} {message}", cure=cure))

    try:
        resolved = real(path)
        if not project.holds(resolved):
            passed = f" ({project.passed})" if project.passed else ""
            cure = "Move it into the project's folder."
            if not project.is_whole:
                cure = f"Put both into a folder of their own below {project.folder}."
            raise refuse("E007", f"lies outside the project{passed}.", cure)
        if not resolved.is_file():
            missing = "is a folder" if resolved.is_dir() else "is no file" if resolved.exists() else "does not exist"
            if os.path.islink(path) and missing == "does not exist":
                raise refuse("E007", "is a link that leads to no file.", "Mend the link, or put a file in its place.")
            raise refuse("E007", f"{missing}.", "Name a file." if resolved.exists() else _neighbors(path))
        # Between the look above and this one, another file may have been put there: a link, a pipe, a larger one.
        flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        with open(os.open(resolved, flags), "rb") as stream:
            if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                raise refuse("E007", "is no file.", "Name a file.")
            data = stream.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            cure = "Keep tables of data in CSV files, and split large diagrams into subdiagram files."
            cure = "Leave out rows that are not needed." if path.suffix.lower() == ".csv" else cure
            raise refuse("E008", f"is larger than {MAX_BYTES // 2**20} MiB.", cure)
        return data
    except (OSError, ValueError) as error:
        if isinstance(error, ModelError):
            raise
        why = error.strerror if isinstance(error, OSError) else str(error)
        raise refuse("E007", f"cannot be read: {why}.") from None


def _neighbors(path: Path) -> str:
    try:
        return did_you_mean(path.name, [entry.name for entry in path.parent.iterdir()][:500])
    except OSError:
        return ""


@dataclass
class _Loading:
    """What the readers of a diagram and of its subdiagram files share. A file is read once, wherever it is used."""

    project: Project
    faults: FaultList = field(default_factory=FaultList)
    files: dict[Path, DiagramValue | None] = field(default_factory=dict)
    tables: dict[Path, list[str]] = field(default_factory=dict)
    is_alone: bool = False  # other files are left closed


@dataclass
class _Reader:
    """Reads one document; faults are collected, so that one pass tells them all."""

    document: json_text.Document
    file: str
    folder: str
    loading: _Loading
    above: tuple[Path, ...]  # the files that contain this one, and itself
    version: int = VERSION  # that the file has
    depth: int = 0  # how many subdiagrams what is being read lies in

    def fault(self, code: str, path: Steps, message: str, cure: str = "", *, at_key: bool = False) -> None:
        table = self.document.key_positions if at_key else self.document.positions
        line, column = (table.get(path) or self.document.positions.get(path, (1, 1))) if self.file else (0, 0)
        place = legible(".".join(str(part) for part in path))
        self.loading.faults.add(Fault(code, place, message, cure, path, self.file, line, column))

    def diagram(self) -> DiagramValue | None:
        value = self.document.value
        if not isinstance(value, dict):
            self.fault("E006", (), f"a diagram must be an object {{...}}, not {_kind(value)}.")
            return None
        if not self.header(value):
            return None
        value = self.document.value
        return self.body(value, (), (*HEADER, *TOP))

    def header(self, value: Mapping[str, Any]) -> bool:
        """Whether this is a diagram that can be read on, be it with a fault of its first two keys."""
        if "format" not in value:
            cure = f'Begin with {{"format": "{FORMAT}", "version": {VERSION}, ...'
            self.fault("E009", (), 'the key "format" is missing.', cure)
            return "blocks" in value
        elif value["format"] != FORMAT:
            cure = f'A diagram has "{FORMAT}".'
            if value["format"] == "blocks-study":
                cure += " This is a study: it is run by `blocks study`."
            self.fault("E006", ("format",), f"the format is {_shown(value['format'])}.", cure)
        elif "version" not in value:
            self.fault("E009", (), 'the key "version" is missing.', f'Add "version": {VERSION}.')
            return True
        elif not isinstance(value["version"], Number):
            what = f"must be a number, not {_shown(value['version'])}."
            self.fault("E005", ("version",), what, f'Write "version": {VERSION}.')
            return True
        elif (made := migrated(self.document, DIAGRAM, VERSION)) is None:
            newer = value["version"] > VERSION
            cure = "Update blocks (pip install -U blocks-cosim)." if newer else f"This release reads version {VERSION}."
            shown = _shown(value["version"]).removeprefix("the number ")
            self.fault("E005", ("version",), f"version {shown} cannot be read.", cure)
        else:
            self.document, self.version = made
            return True
        return False

    def body(self, value: Mapping[str, Any], path: Steps, known: tuple[str, ...]) -> DiagramValue:
        self.keys(value, path, known)
        if SCHEMA in known and not isinstance(value.get(SCHEMA, ""), str):
            self.fault("E004", (*path, SCHEMA), f"must be a text, not {_kind(value[SCHEMA])}.")
        name = value.get("name", "diagram")
        if not isinstance(name, str) or not is_name(name):
            cure = name_cure(name if isinstance(name, str) else "")
            self.fault("E111", (*path, "name"), f"{_shown(name)} is not a name.", cure)
            name = "diagram"
        parameters = self.table(value, path, "parameters", self.parameter)
        inputs = self.table(value, path, "inputs", self.input)
        outputs = self.table(value, path, "outputs", self.source)
        blocks = self.table(value, path, "blocks", self.block)
        taken: dict[str, str] = {}
        for what, table in (("parameter", parameters), ("input", inputs), ("block", blocks)):
            for key in table:
                if key in taken:
                    first = self.document.key_positions.get((*path, taken[key] + "s", key)) if self.file else None
                    where = f" in line {first[0]}" if first else ""
                    self.fault("E109", (*path, what + "s", key), f"the name is taken by the {taken[key]}{where}.",
                               "Rename one: blocks, inputs and parameters share their names.", at_key=True)  # fmt: skip
                taken.setdefault(key, what)
        wires = self.table(value, path, "wires", self.source, names=False)
        run = self.object(value, path, "run")
        self.settings(run, (*path, "run"), inputs)
        measures = self.table(value, path, "measures", self.measure)
        layout = self.object(value, path, "layout")
        for key, entry in layout.items():
            pair = isinstance(entry, list) and len(entry) == 2 and all(isinstance(x, Number) for x in entry)
            if not pair:
                self.fault("E004", (*path, "layout", key), "must be a position [x, y].")
            if key not in blocks and key not in inputs and key not in outputs:
                cure = self.loading.faults.guess(key, blocks)
                self.fault("E105", (*path, "layout", key), f"there is no block {quoted(key)}.", cure, at_key=True)
        return DiagramValue(
            name,
            self.doc(value, path),
            parameters,
            inputs,
            outputs,
            blocks,
            wires,
            run,
            measures,
            layout,
            {key: entry for key, entry in value.items() if key.startswith("x-") or key == SCHEMA},
            self.file,
            self.folder,
            self.document.places if self.file else {},
            path,
            self.version,
        )

    def keys(self, value: Mapping[str, Any], path: Steps, known: tuple[str, ...]) -> None:
        is_block = known[0] == "type" and "fmu" in known
        inside = ' What the block computes with stands in "parameters".' if is_block else ""
        for key in value:
            if key not in known and not key.startswith("x-"):
                cure = f'It belongs into "run": {{"{key}": ...}}.' if known[-1] == TOP[-1] and key in RUN else ""
                cure = cure or self.loading.faults.guess(key, known, quote='"')
                cure = cure or f"Known: {', '.join(known)}; own keys begin with x-.{inside}"
                self.fault("E003", (*path, key), f"the key {quoted(key)} is not known here.", cure, at_key=True)

    def object(self, value: Mapping[str, Any], path: Steps, key: str) -> dict[str, Any]:
        entry = value.get(key, {})
        if not isinstance(entry, dict):
            self.fault("E004", (*path, key), f"must be an object {{...}}, not {_kind(entry)}.")
            return {}
        return entry

    def table(
        self, value: Mapping[str, Any], path: Steps, key: str, read: Callable[[Any, Steps], Any], *, names: bool = True
    ) -> dict[str, Any]:
        """An object whose keys are names (or sinks of wires)."""
        made = {}
        for name, entry in self.object(value, path, key).items():
            if names and not is_name(name):
                self.fault("E111", (*path, key, name), f"{quoted(name)} is not a name.",
                           name_cure(name), at_key=True)  # fmt: skip
                continue
            made[name] = read(entry, (*path, key, name))
        return made

    def doc(self, value: Mapping[str, Any], path: Steps) -> Any:
        doc = value.get("doc", "")
        if not (isinstance(doc, str) or (isinstance(doc, list) and all(isinstance(line, str) for line in doc))):
            self.fault("E004", (*path, "doc"), "must be a text or a list of lines.")
        return doc or ""

    def source(self, entry: Any, path: Steps) -> str:
        if not isinstance(entry, str):
            self.fault("E004", path, f'must be the text of a source such as "motor.omega", not {_kind(entry)}.')
            return ""
        return entry

    def parameter(self, entry: Any, path: Steps) -> Any:
        if isinstance(entry, dict) and "csv" in entry:
            return self.column(entry, path)
        if isinstance(entry, dict):
            self.keys(entry, path, QUANTITY)
            if "value" not in entry:
                self.fault("E009", path, 'the key "value" is missing.')
            else:
                self.plain(entry["value"], (*path, "value"))
            if not isinstance(entry.get("unit", ""), str):
                self.fault("E004", (*path, "unit"), f"must be a text, not {_kind(entry['unit'])}.")
            self.doc(entry, path)
        else:
            self.plain(entry, path)
        return entry

    def column(self, entry: dict[str, Any], path: Steps) -> Any:
        """A column of a CSV file in the project, with its numbers."""
        self.keys(entry, path, COLUMN)
        self.doc(entry, path)
        wrong = [key for key in COLUMN[:3] if not isinstance(entry.get(key, ""), str)]
        for key in wrong:
            self.fault("E004", (*path, key), f"must be a text, not {_kind(entry[key])}.")
        if "column" not in entry:
            self.fault("E009", path, 'the key "column" is missing.')
        if wrong or "column" not in entry or self.loading.is_alone:
            return entry
        line, column = self.document.positions.get((*path, "csv"), (1, 1)) if self.file else (0, 0)
        place = Fault("E007", legible(".".join(map(str, path))), "", "", path, self.file, line, column)
        target = Path(self.folder) / entry["csv"]
        try:
            if target not in self.loading.tables:
                data_ = read_inside(target, self.loading.project, place, entry["csv"])
                try:
                    self.loading.tables[target] = data_.decode("utf-8-sig").split("\n")
                except UnicodeDecodeError:
                    raise ValueError("is no text in UTF-8.") from None
            header, data = read_columns(self.loading.tables[target], {entry["column"]}, most=MOST_ROWS)
            if entry["column"] not in header:
                cure = did_you_mean(entry["column"][:200], header[:500])
                cure = cure or f"Columns: {', '.join(legible(column[:40]) for column in header[:20])}."
                self.fault("E007", (*path, "column"), f"{quoted(entry['csv'])} has no such column.", cure)
                return entry
            return Column(entry, data[:, header.index(entry["column"])].tolist())
        except ModelError as error:
            self.loading.faults.add(error.faults[0])
        except ValueError as error:
            self.fault("E007", (*path, "csv"), f"{quoted(entry['csv'])} {error}")
        return entry

    def plain(self, value: Any, path: Steps) -> None:
        if isinstance(value, list):
            self.numbers(value, path, is_bools=bool(value) and all(isinstance(item, bool) for item in value))
        elif value is None or isinstance(value, dict):
            self.fault("E004", path, f"must be a number, a text, a list, true or false, not {_kind(value)}.")

    def numbers(self, entry: list[Any], path: Steps, *, is_bools: bool) -> None:
        for index, item in enumerate(entry):
            if isinstance(item, list):
                self.numbers(item, (*path, index), is_bools=False)
            elif not isinstance(item, (Number, str)) and not is_bools:
                self.fault("E004", (*path, index), f"must be a number, not {_kind(item)}.")

    def input(self, entry: Any, path: Steps) -> Any:
        if not isinstance(entry, dict):
            self.fault("E004", path, f'must be an object such as {{"unit": "V"}}, not {_kind(entry)}.')
            return {}
        self.keys(entry, path, INPUT)
        self.doc(entry, path)
        if not isinstance(entry.get("unit", ""), str):
            self.fault("E004", (*path, "unit"), f"must be a text, not {_kind(entry['unit'])}.")
        type_ = entry.get("type", "real")
        members = self.members(type_, (*path, "type"))
        if type_ != "real" and type_ != "int" and entry.get("unit"):
            what = "a bool" if type_ == "bool" else "an enumeration"
            self.fault("E004", (*path, "unit"), f"{what} has no unit.", "Leave it out.")
        size = entry.get("size", ())
        try:
            shape = shape_of(size)
        except ValueError:
            what = f"must be an integer from 1 to {LARGEST_SIZE:,}, or a list of such, not {_shown(size)}."
            self.fault("E004", (*path, "size"), what)
        else:
            if "default" in entry:
                default = entry["default"]
                each = shape if isinstance(default, list) else ()
                self.defaults(default, each, type_, members, (*path, "default"))
        return entry

    def defaults(
        self, default: Any, shape: tuple[int, ...], type_: Any, members: Mapping[str, Any], path: Steps
    ) -> None:
        """What an input is where nothing is given: one value, or in rows one for each element."""
        if not shape:
            self.default(default, type_, members, path)
        elif not isinstance(default, list) or len(default) != shape[0]:
            found = f"{len(default)}" if isinstance(default, list) else _shown(default)
            self.fault("E004", path, f"must be one value for all elements, or {shape[0]} in a list, not {found}.")
        else:
            for index, item in enumerate(default):
                self.defaults(item, shape[1:], type_, members, (*path, index))

    def members(self, type_: Any, path: Steps) -> Mapping[str, Any]:
        """The members of the type of an input, where it is an enumeration."""
        shown = '{"enum": "Mode", "members": {"OFF": 0, "ON": 1}}'
        if not isinstance(type_, dict):
            if type_ not in TYPES:
                self.fault("E004", path, f'must be "real", "int", "bool" or {shown}, not {_shown(type_)}.')
            return {}
        self.keys(type_, path, ENUMERATION)
        known = type_.get("members")
        if not (isinstance(type_.get("enum"), str) and type_["enum"] and isinstance(known, dict) and known):
            self.fault("E004", path, "has no name, or no members.", f"An enumeration is {shown}.")
            return {}
        numbers: dict[float, str] = {}
        for name, number in known.items():
            at = (*path, "members", name)
            if not isinstance(number, Number) or not number.is_integer() or abs(number) > 2**53:
                self.fault("E004", at, f"must be an integer up to 2^53, not {_shown(number)}.")
            elif not name:
                self.fault("E004", at, "a member has no name.", at_key=True)
            elif float(number) in numbers:
                self.fault("E004", at, f"{quoted(numbers[float(number)])} has the number {number!r} already.")
            else:
                numbers[float(number)] = name
        return known

    def default(self, default: Any, type_: Any, members: Mapping[str, Any], path: Steps) -> None:
        """What an input is where nothing is given."""
        if members:
            if not isinstance(default, str) or default not in members:
                self.fault("E004", path, f"must be one of {_listed(members)}, not {_shown(default)}.")
        elif type_ == "bool":
            if not isinstance(default, bool):
                self.fault("E004", path, f"must be true or false, not {_kind(default)}.")
        elif isinstance(default, bool) or not isinstance(default, float):
            self.fault("E004", path, f"must be a number, not {_kind(default)}.")
        elif type_ == "int" and not float(default).is_integer():
            self.fault("E004", path, f"must be an integer, not {_shown(default)}.")

    def block(self, entry: Any, path: Steps, *, is_variant: bool = False) -> BlockEntry:
        if not isinstance(entry, dict):
            self.fault("E004", path, f'must be an object such as {{"type": "Gain"}}, not {_kind(entry)}.')
            return BlockEntry()
        # A variant has names for the block's ports, and no variants of its own.
        others = ("variant", "variants") if is_variant else ("ports",)
        self.keys(entry, path, tuple(key for key in BLOCK if key not in others))
        kinds = [key for key in ("type", "diagram", "fmu") if key in entry]
        if len(kinds) != 1:
            what = f"has {' and '.join(kinds)}" if kinds else "has none of type, diagram and fmu"
            what = f"{what}; a block is exactly one of the three."
            self.fault("E003" if kinds else "E009", path, what, at_key=True)
            return BlockEntry()
        raw = self.object(entry, path, "parameters")
        kind, what = kinds[0], entry[kinds[0]]
        made = partial(
            BlockEntry,
            parameters={name: self.parameter(value, (*path, "parameters", name)) for name, value in raw.items()},
            doc=self.doc(entry, path),
            extras={key: value for key, value in entry.items() if key.startswith("x-")},
            control=self.control(entry, path, kind),
            stream=self.stream(entry, path),
            options=self.options(entry, path, kind),
            **(self.variant_ports(entry, path) if is_variant else self.variants(entry, path)),
        )
        if kind == "diagram" and isinstance(what, dict):
            if self.is_too_deep((*path, kind)):
                return BlockEntry()
            self.depth += 1
            inner = self.body(what, (*path, kind), TOP)
            self.depth -= 1
            return made(diagram=inner)
        if not isinstance(what, str) or not what:
            shown = "an empty one" if what == "" else _kind(what)
            self.fault("E004", (*path, kind), f"must be a text, not {shown}.")
            return made()
        if kind == "type":
            return made(type=what)
        if kind == "fmu":
            # Two slashes begin the name of another computer, which Windows would call.
            if "://" in what or "\0" in what or what.replace("\\", "/").startswith("//"):
                self.fault(
                    "E007", (*path, kind), f"{quoted(what)} is not a path.", "An FMU is a file of this computer."
                )
            return made(fmu=what)
        return made(diagram=what, loaded=self.subdiagram(what, (*path, kind)))

    def stream(self, entry: Mapping[str, Any], path: Steps) -> str:
        """The name of the stream of random numbers that a block draws from; "" where it says none."""
        if "stream" not in entry:
            return ""
        stream = entry["stream"]
        if isinstance(stream, str) and is_stream(stream):
            return stream
        if isinstance(stream, str):
            cure = 'It is a name, or a path such as "robot.noise", maybe with / in front.'
            self.fault("E111", (*path, "stream"), f"{quoted(stream)} is not the name of a stream.", cure)
        else:
            self.fault("E004", (*path, "stream"), f"must be a text, not {_kind(stream)}.")
        return ""

    def options(self, entry: Mapping[str, Any], path: Steps, kind: str) -> dict[str, Any]:
        """How an FMU is run."""
        given = {key: entry[key] for key in OPTIONS if key in entry}
        if given and kind != "fmu":
            self.fault("E003", (*path, next(iter(given))), "only an FMU has it.", at_key=True)
            return {}
        if given.get("kind", "CS") not in FMU_KINDS:
            self.fault("E004", (*path, "kind"), f'must be "CS" or "ME", not {_shown(given["kind"])}.')
        if not isinstance(given.get("isolate", False), bool):
            self.fault("E004", (*path, "isolate"), f"must be true or false, not {_kind(given['isolate'])}.")
        timeout = given.get("timeout", 1.0)
        if isinstance(timeout, bool) or not isinstance(timeout, float) or not 0 < timeout <= LONGEST_TIMEOUT:
            what = f"must be a number of seconds above 0, at most {LONGEST_TIMEOUT:,.0f}, not {_shown(timeout)}."
            self.fault("E004", (*path, "timeout"), what)
        return given

    def variants(self, entry: Mapping[str, Any], path: Steps) -> dict[str, Any]:
        """What may stand in place of a block, and which does."""
        made = self.table(entry, path, "variants", partial(self.block, is_variant=True))
        if BASE in made:
            what = f'"{BASE}" is the name of the block itself.'
            self.fault("E109", (*path, "variants", BASE), what, "Name it otherwise.", at_key=True)
        chosen = entry.get("variant", "")
        if not isinstance(chosen, str):
            self.fault("E004", (*path, "variant"), f"must be a text, not {_kind(chosen)}.")
            chosen = ""
        if chosen and chosen not in (BASE, *made):
            known = (BASE, *made)
            cure = self.loading.faults.guess(chosen, known, quote='"') or f"Variants: {', '.join(known)}."
            self.fault("E122", (*path, "variant"), f"there is no variant {quoted(chosen)}.", cure)
            chosen = ""
        return {"variants": made, "variant": chosen}

    def variant_ports(self, entry: Mapping[str, Any], path: Steps) -> dict[str, Any]:
        """The names of a variant's ports by those of the block."""
        made = self.object(entry, path, "ports")
        for name, own in made.items():
            if not isinstance(own, str) or not own:
                self.fault("E004", (*path, "ports", name), f"must be the name of a port, not {_shown(own)}.")
        return {"ports": {name: own for name, own in made.items() if isinstance(own, str)}}

    def control(self, entry: Mapping[str, Any], path: Steps, kind: str) -> dict[str, Any]:
        """What turns a subdiagram on, or triggers it."""
        given = {key: entry[key] for key in ("enable", "trigger") if key in entry}
        if given and kind != "diagram":
            self.fault("E003", (*path, next(iter(given))), "only a subdiagram is enabled or triggered.", at_key=True)
        elif len(given) == 2:
            self.fault("E003", (*path, "trigger"), "a subdiagram is enabled or triggered, not both.", at_key=True)
        for key, value in given.items():
            known = ENABLE if key == "enable" else TRIGGER
            if not isinstance(value, dict):
                self.fault("E004", (*path, key), f"must be an object {{...}}, not {_kind(value)}.")
                return {}
            self.keys(value, (*path, key), known)
            choices = {"states": OFF, "outputs": OFF, "direction": DIRECTIONS}
            for word, allowed in choices.items():
                if word in value and value[word] not in allowed:
                    text = " or ".join(f'"{one}"' for one in allowed)
                    self.fault("E004", (*path, key, word), f"must be {text}, not {_shown(value[word])}.")
            for word in ("every", "offset"):
                if word in value:
                    self.parameter(value[word], (*path, key, word))
            if {"offset", "direction"} <= value.keys() and "every" not in value:
                self.fault("E003", (*path, key, "offset"), 'only ticks ("every") have an offset.', at_key=True)
            if key == "trigger" and ("every" in value) == ("direction" in value):
                self.fault("E009", (*path, key), 'a trigger has "direction" (of a signal) or "every" (a tick).')
                return {}
        return given

    def is_too_deep(self, path: Steps) -> bool:
        """Whether one more subdiagram is one too many, which is a fault then."""
        if self.depth >= DEEPEST:
            cure = "Put some of them beside each other."
            self.fault("E008", path, f"subdiagrams lie more than {DEEPEST} deep.", cure)
        return self.depth >= DEEPEST

    def subdiagram(self, text: str, path: Steps) -> DiagramValue | None:
        """The diagram of a file that a block names, relative to this file."""
        if "://" in text or "\0" in text:
            self.fault("E007", path, f"{quoted(text)} is not a path.", "Subdiagrams are files of the project.")
            return None
        if self.loading.is_alone:
            return None
        target = Path(self.folder) / text
        resolved, loading = real(target), self.loading
        if resolved in self.above:
            chain = [file.name for file in (*self.above[self.above.index(resolved) :], resolved)]
            circle = " -> ".join(map(legible, chain))
            self.fault("E113", path, f"the files contain each other: {circle}.", "Take one out of the circle.")
            return None
        if self.is_too_deep(path):
            return None
        if resolved not in loading.files:
            loading.files[resolved] = None
            line, column = self.document.positions.get(path, (1, 1))
            place = Fault("E007", legible(".".join(map(str, path))), "", "", path, self.file, line, column)
            # Named like the file that names it: "parts/a.json" and not "/home/me/project/parts/a.json".
            shown = os.path.join(os.path.dirname(self.file), text)
            try:
                data = read_inside(target, loading.project, place, shown)
                document = json_text.read(data, file=shown)
            except ModelError as error:
                loading.faults.update(error.faults)
            else:
                above = (*self.above, resolved)
                reader = _Reader(document, shown, str(target.parent), loading, above, depth=self.depth + 1)
                loading.files[resolved] = reader.diagram()
        return loading.files[resolved]

    def settings(self, run: Mapping[str, Any], path: Steps, inputs: Mapping[str, Any]) -> None:
        """The keys of run settings and the kinds of inputs; `read_settings` reads the rest."""
        self.keys(run, path, RUN)
        self.doc(run, path)
        self.keys(self.object(run, path, "master"), (*path, "master"), MASTER)
        for name, entry in self.object(run, path, "inputs").items():
            type_ = inputs[name].get("type") if name in inputs else None
            known = type_.get("members") if isinstance(type_, dict) else None
            members = tuple(known) if isinstance(known, dict) else ()
            for code, spot, message in input_faults(entry, (*path, "inputs", name), members):
                self.fault(code, spot, message, at_key=code == "E003")

    def measure(self, entry: Any, path: Steps) -> Any:
        if not isinstance(entry, dict):
            self.fault("E004", path, f'must be an object such as {{"type": "ITAE", ...}}, not {_kind(entry)}.')
            return {}
        self.keys(entry, path, MEASURE)
        self.doc(entry, path)
        for key in ("type", "of"):
            if not isinstance(entry.get(key), str):
                if key in entry:
                    self.fault("E004", (*path, key), f"must be a text, not {_kind(entry[key])}.")
                else:
                    self.fault("E009", path, f'the key "{key}" is missing.')
        return entry


def shape_of(size: Any) -> tuple[int, ...]:
    """The shape that the "size" of an input means: a number, or a list of them; () of a scalar. Raises ValueError."""
    sizes = size if isinstance(size, (list, tuple)) else [size]
    for one in sizes:
        is_number = isinstance(one, (int, float)) and not isinstance(one, bool)
        if not is_number or not 1 <= one <= LARGEST_SIZE or one != int(one):
            raise ValueError
    if math.prod(sizes) > LARGEST_SIZE or size == []:
        raise ValueError
    return tuple(int(one) for one in sizes)


def input_faults(
    entry: Any, path: Steps, members: Sequence[str] | None = None
) -> Iterator[tuple[str, Steps, str]]:
    """Code, place and message of what is wrong with the value of an input over a run.

    members: of its type, () where that is no enumeration, None where the input is not known.
    """
    if not isinstance(entry, dict):
        yield from _rows(entry, path, members)
        return
    known = QUANTITY if "value" in entry else TABLE
    for key in entry:
        if key not in known and not key.startswith("x-"):
            yield "E003", (*path, key), f"the key {quoted(key)} is not known here: {', '.join(known)}."
    if not isinstance(entry.get("unit", ""), str):
        yield "E004", (*path, "unit"), f"must be a text, not {_kind(entry['unit'])}."
    for key in ("value",) if "value" in entry else TABLE[:2]:
        if key not in entry:
            yield "E009", path, f'the key "{key}" is missing.'
        elif key != "value" and not isinstance(entry[key], list):
            yield "E004", (*path, key), f"must be a list of numbers, not {_kind(entry[key])}."
        else:
            yield from _rows(entry[key], (*path, key), () if key == "t" else members)
    if "value" not in entry and entry.get("interpolation", "hold") not in INTERPOLATIONS:
        yield "E004", (*path, "interpolation"), f'must be "linear" or "hold", not {_shown(entry["interpolation"])}.'


def _rows(entry: Any, path: Steps, members: Sequence[str] | None) -> Iterator[tuple[str, Steps, str]]:
    """What is no number, bool or name of a member, in lists of them."""
    if isinstance(entry, list):
        for index, item in enumerate(entry):
            yield from _rows(item, (*path, index), members)
    elif isinstance(entry, str) and members:
        if entry not in members:
            yield "E004", path, f"must be one of {_listed(members)}, not {quoted(entry)}."
    elif not isinstance(entry, (Number, bool)) and not (
        isinstance(entry, str) and members is None and re.match(MEMBER, entry)
    ):
        yield "E004", path, f"must be a number, or a list of numbers, not {_kind(entry)}."


def _listed(names: Iterable[str]) -> str:
    shown = [quoted(name) for name in islice(names, 21)]
    return ", ".join([*shown[:20], "..."] if len(shown) > 20 else shown)


def _kind(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, (Number, float, int)):
        return f"the number {value!r}"
    return {"str": "a text", "list": "a list [...]", "dict": "an object {...}"}.get(type(value).__name__, "that")


def _shown(value: Any) -> str:
    return quoted(value) if isinstance(value, str) else _kind(value)


# --- writing ---------------------------------------------------------------------------------------------------


def to_document(value: DiagramValue, *, inner: bool = False) -> dict[str, Any]:
    """The dict of a diagram, keys in the canonical order, empty sections left out."""
    own = dict(value.extras)
    schema = {SCHEMA: own.pop(SCHEMA)} if SCHEMA in own else {}
    made: dict[str, Any] = {} if inner else {**schema, "format": FORMAT, "version": VERSION}
    if not inner or value.name != "diagram":
        made["name"] = value.name
    if value.doc:
        made["doc"] = value.doc
    for key in ("parameters", "inputs", "outputs"):
        if getattr(value, key):
            made[key] = dict(getattr(value, key))
    if value.blocks:
        made["blocks"] = {name: _block_document(entry) for name, entry in value.blocks.items()}
    for key in ("wires", "run", "measures", "layout"):
        if getattr(value, key):
            made[key] = dict(getattr(value, key))
    made.update(own)
    return made


def _block_document(entry: BlockEntry) -> dict[str, Any]:
    made: dict[str, Any] = {}
    if entry.type:
        made["type"] = entry.type
    elif entry.fmu:
        made["fmu"] = entry.fmu
    else:
        made["diagram"] = (
            to_document(entry.diagram, inner=True) if isinstance(entry.diagram, DiagramValue) else entry.diagram
        )
    made.update(entry.control)
    if entry.stream:
        made["stream"] = entry.stream
    made.update({key: entry.options[key] for key in OPTIONS if key in entry.options})
    if entry.doc:
        made["doc"] = entry.doc
    for key in ("parameters", "ports"):
        if getattr(entry, key):
            made[key] = dict(getattr(entry, key))
    if entry.variant:
        made["variant"] = entry.variant
    if entry.variants:
        made["variants"] = {name: _block_document(other) for name, other in entry.variants.items()}
    made.update(entry.extras)
    return made


def _one_per_line(path: Steps, value: Any) -> bool:
    """A line for each key of a diagram, block, variant, wire, position, measure, parameter, and line of doc."""
    while len(path) >= 3 and path[0] == "blocks":
        if path[2] == "variants" and len(path) > 3:  # a variant is a block
            path = ("blocks", *path[3:])
        elif path[2] == "diagram":  # an inline subdiagram is a diagram
            path = path[3:]
        else:
            break
    if path[2:] == ("variants",):
        return True
    if len(path) == 2 and path[0] == "blocks":  # and its block is opened up, or all of it would stand on one line
        return isinstance(value, dict) and (isinstance(value.get("diagram"), dict) or bool(value.get("variants")))
    return not path or (len(path) == 1 and path[0] in TOP and path[0] not in ("run", "name"))


def dumps_document(document: Mapping[str, Any]) -> str:
    """The canonical text of a dict."""
    return json_text.write(document, one_per_line=_one_per_line)


def dumps(value: DiagramValue) -> str:
    """The canonical text of a diagram. Raises ModelError (E008) for one made in Python that no file can hold."""
    try:
        return dumps_document(to_document(value))
    except RecursionError:
        message = f"subdiagrams lie more than {DEEPEST} deep."
        raise ModelError(Fault("E008", value.name, message, "Put some of them beside each other.")) from None


def relocated(value: DiagramValue, folder: str | Path) -> DiagramValue:
    """The value as a file in another folder holds it: the paths of other files lead to the same files."""
    old, new = os.path.realpath(value.folder or "."), os.path.realpath(folder)
    if old == new:
        return value

    def path(text: str) -> str:
        if os.path.isabs(text):
            return text
        target = os.path.join(old, text)
        with contextlib.suppress(ValueError):  # on another drive it stays absolute
            target = os.path.relpath(target, new)
        return target.replace(os.sep, "/")

    def parameters(table: Mapping[str, Any]) -> dict[str, Any]:
        return {
            name: Column({**raw, "csv": path(raw["csv"])}, raw.numbers) if isinstance(raw, Column) else raw
            for name, raw in table.items()
        }

    def moved(entry: BlockEntry) -> BlockEntry:
        variants = {name: moved(other) for name, other in entry.variants.items()}
        fmu = path(entry.fmu) if entry.fmu else ""
        entry = replace(entry, parameters=parameters(entry.parameters), fmu=fmu, variants=variants)
        if isinstance(entry.diagram, DiagramValue):
            return replace(entry, diagram=relocated(entry.diagram, folder))
        if not isinstance(entry.diagram, str):
            return entry
        return replace(entry, diagram=path(entry.diagram))

    blocks = {name: moved(entry) for name, entry in value.blocks.items()}
    extras = dict(value.extras)
    if extras.get(SCHEMA) and not re.match(r"[A-Za-z][\w+.-]+:|[/#]", extras[SCHEMA]):  # a path, and no URL
        extras[SCHEMA] = path(extras[SCHEMA])
    moved_parameters = parameters(value.parameters)
    return replace(value, blocks=blocks, parameters=moved_parameters, extras=extras, folder=os.path.abspath(folder))
