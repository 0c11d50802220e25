"""JSON <-> DiagramValue: the structure of a diagram file, with every fault in its place.

Only structure is read here: which keys there are and of what kind. What names and numbers mean (types, ports, units,
expressions) is settled by `flatten`. Reading a file never runs anything and opens nothing but the subdiagram files that
it names, which must lie in the same project.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from . import jsontext
from .diagram import FORMAT, VERSION, BlockEntry, DiagramValue, is_name
from .errors import Fault, ModelError, UsageError, did_you_mean
from .jsontext import Number, quoted

__all__ = ["dumps", "from_document", "load", "loads", "project_root", "read_inside", "to_document", "write_atomically"]

MAX_BYTES = 16 * 2**20
TOP = (
    "format",
    "version",
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
BLOCK = ("type", "diagram", "fmu", "doc", "parameters")
QUANTITY = ("value", "unit", "doc")
INPUT = ("unit", "default", "size", "type", "doc")
RUN = (
    "start", "stop", "method", "step", "rtol", "atol", "every", "stops", "inputs", "loops", "log", "doc",
)  # fmt: skip
MEASURE = ("type", "of", "against", "from", "to", "band", "unit", "doc")


# --- reading ---------------------------------------------------------------------------------------------------


def load(path: str | Path) -> DiagramValue:
    """The diagram of a file, with the subdiagram files that it names.

    Raises ModelError with all faults found (E0xx; E113 for files that contain each other).
    """
    path = Path(path)
    return _load(path, project_root(path), ())


def loads(text: str | bytes, *, file: str = "", folder: str | Path = "") -> DiagramValue:
    """The diagram of a text. Subdiagram files are looked for from `folder` on."""
    document = jsontext.read(text, file=file)
    folder = str(folder or Path.cwd())
    return _Reader(document, file, folder, project_root(Path(folder) / "x"), ()).diagram()


def from_document(document: Mapping[str, Any], *, folder: str | Path = "") -> DiagramValue:
    """The diagram of a dict, as `json.load` would give it."""
    return loads(dumps_document(document), folder=folder)


def project_root(path: Path) -> Path:
    """The nearest folder above a file that holds pyproject.toml or .git, else the file's own folder."""
    folder = path.resolve().parent
    for candidate in (folder, *folder.parents):
        if (candidate / "pyproject.toml").exists() or (candidate / ".git").exists():
            return candidate
    return folder


def read_inside(path: Path, root: Path, fault: Fault) -> bytes:
    """The bytes of a file inside the project. Raises ModelError (E007, E008), worded from `fault`'s place."""

    def refuse(code: str, message: str, cure: str = "") -> ModelError:
        return ModelError(replace(fault, code=code, message=message, cure=cure))

    try:
        resolved = path.resolve()
        if not resolved.is_relative_to(root):
            raise refuse("E007", f"{quoted(str(path))} lies outside the project.", "Move it into the project's folder.")
        if not resolved.is_file():
            missing = "is a folder" if resolved.is_dir() else "is no file" if resolved.exists() else "does not exist"
            raise refuse("E007", f"{quoted(str(path))} {missing}.", _neighbors(path))
        if resolved.stat().st_size > MAX_BYTES:
            raise refuse("E008", f"{quoted(str(path))} is larger than {MAX_BYTES // 2**20} MiB.")
        return resolved.read_bytes()
    except (OSError, ValueError) as error:
        if isinstance(error, ModelError):
            raise
        raise refuse("E007", f"{quoted(str(path))} cannot be read: {getattr(error, 'strerror', None) or error}.") from None


def _neighbors(path: Path) -> str:
    try:
        return did_you_mean(path.name, [entry.name for entry in path.parent.iterdir()][:500])
    except OSError:
        return ""


def _load(path: Path, root: Path, above: tuple[Path, ...]) -> DiagramValue:
    data = read_inside(path, root if above else path.resolve().parent, Fault("E007", "", ""))
    document = jsontext.read(data, file=str(path))
    return _Reader(document, str(path), str(path.parent), root, (*above, path.resolve())).diagram()


@dataclass
class _Reader:
    """Reads one document; faults are collected, so that one pass tells them all."""

    document: jsontext.Document
    file: str
    folder: str
    root: Path
    above: tuple[Path, ...]
    faults: list[Fault] = field(default_factory=list)

    def fault(
        self, code: str, path: tuple[str | int, ...], message: str, cure: str = "", *, at_key: bool = False
    ) -> None:
        table = self.document.key_positions if at_key else self.document.positions
        line, column = table.get(path) or self.document.positions.get(path, (1, 1))
        place = ".".join(str(part) for part in path)
        self.faults.append(Fault(code, quoted(place) if not place.isprintable() else place[:200], message, cure, path, self.file, line, column))

    def diagram(self) -> DiagramValue:
        value = self.document.value
        if not isinstance(value, dict):
            self.fault("E006", (), f"a diagram is an object {{...}}, not {_kind(value)}.")
        else:
            self.header(value)
        made = None if self.faults else self.body(value, ())
        if self.faults or made is None:
            raise ModelError(*self.faults)
        return made

    def header(self, value: Mapping[str, Any]) -> None:
        if "format" not in value:
            self.fault("E009", (), "the key \"format\" is missing.", f'Begin with {{"format": "{FORMAT}", "version": {VERSION}.')
        elif value["format"] != FORMAT:
            self.fault("E006", ("format",), f"the format is {_shown(value['format'])}.", f'A diagram has "{FORMAT}".')
        elif "version" not in value:
            self.fault("E009", (), "the key \"version\" is missing.", f'Add "version": {VERSION}.')
        elif value["version"] != VERSION or isinstance(value["version"], bool):
            newer = isinstance(value["version"], Number) and value["version"] > VERSION
            cure = "Update blocks (pip install -U blocks-cosim)." if newer else f"This release reads version {VERSION}."
            self.fault("E005", ("version",), f"version {_shown(value['version'])} cannot be read.", cure)

    def body(self, value: Mapping[str, Any], path: tuple[str | int, ...]) -> DiagramValue:
        self.keys(value, path, TOP)
        name = value.get("name", "diagram")
        if not isinstance(name, str) or not is_name(name):
            self.fault("E111", (*path, "name"), f"{_shown(name)} is not a name.", "Use letters, digits and _.")
            name = "diagram"
        parameters = self.table(value, path, "parameters", self.parameter)
        inputs = self.table(value, path, "inputs", self.input)
        outputs = self.table(value, path, "outputs", self.source)
        blocks = self.table(value, path, "blocks", self.block)
        taken: dict[str, str] = {}
        for what, table in (("parameter", parameters), ("input", inputs), ("block", blocks)):
            for key in table:
                if key in taken:
                    self.fault("E109", (*path, what + "s", key), f"'{key}' is a {taken[key]} already.",
                               "Blocks, inputs and parameters share one namespace.", at_key=True)  # fmt: skip
                taken.setdefault(key, what)
        wires = self.table(value, path, "wires", self.source, names=False)
        run = self.object(value, path, "run")
        self.keys(run, (*path, "run"), RUN)
        measures = self.table(value, path, "measures", self.measure)
        layout = self.object(value, path, "layout")
        for key, entry in layout.items():
            pair = isinstance(entry, list) and len(entry) == 2 and all(isinstance(x, Number) for x in entry)
            if not pair:
                self.fault("E004", (*path, "layout", key), "a position is [x, y].")
            if key not in blocks and key not in inputs and key not in outputs:
                self.fault("E105", (*path, "layout", key), f"there is no block '{key[:200]}'.", did_you_mean(key, blocks), at_key=True)
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
            {key: entry for key, entry in value.items() if key.startswith("x-")},
            self.file,
            self.folder,
            self.document.positions,
            path,
        )

    def keys(self, value: Mapping[str, Any], path: tuple[str | int, ...], known: tuple[str, ...]) -> None:
        for key in value:
            if key not in known and not key.startswith("x-"):
                cure = did_you_mean(key, known, quote='"') or f"Known: {', '.join(known)}; own keys begin with x-."
                self.fault("E003", (*path, key), f"the key {quoted(key)} is not known here.", cure, at_key=True)

    def object(self, value: Mapping[str, Any], path: tuple[str | int, ...], key: str) -> dict[str, Any]:
        entry = value.get(key, {})
        if not isinstance(entry, dict):
            self.fault("E004", (*path, key), f"must be an object {{...}}, not {_kind(entry)}.")
            return {}
        return entry

    def table(self, value: Mapping[str, Any], path: tuple[str | int, ...], key: str, read: Any, *, names: bool = True) -> dict[str, Any]:
        """An object whose keys are names (or sinks of wires)."""
        made = {}
        for name, entry in self.object(value, path, key).items():
            if names and not is_name(name):
                self.fault("E111", (*path, key, name), f"{quoted(name)} is not a name.",
                           "Use letters, digits and _, not beginning with a digit.", at_key=True)  # fmt: skip
                continue
            made[name] = read(entry, (*path, key, name))
        return made

    def doc(self, value: Mapping[str, Any], path: tuple[str | int, ...]) -> Any:
        doc = value.get("doc", "")
        if not (isinstance(doc, str) or (isinstance(doc, list) and all(isinstance(line, str) for line in doc))):
            self.fault("E004", (*path, "doc"), "must be a text or a list of lines.")
        return doc

    def source(self, entry: Any, path: tuple[str | int, ...]) -> str:
        if not isinstance(entry, str):
            self.fault("E004", path, f"must be the text of a source such as \"motor.omega\", not {_kind(entry)}.")
            return ""
        return entry

    def parameter(self, entry: Any, path: tuple[str | int, ...]) -> Any:
        if isinstance(entry, dict):
            self.keys(entry, path, QUANTITY)
            if "value" not in entry:
                self.fault("E009", path, "the key \"value\" is missing.")
            elif isinstance(entry["value"], dict):
                self.fault("E004", (*path, "value"), f"must be a number, a text or a list, not {_kind(entry['value'])}.")
            for key in ("unit",):
                if not isinstance(entry.get(key, ""), str):
                    self.fault("E004", (*path, key), f"must be a text, not {_kind(entry[key])}.")
            self.doc(entry, path)
        elif entry is None:
            self.fault("E004", path, "must be a number, a text, a list, true or false, not null.")
        elif isinstance(entry, list):
            self.numbers(entry, path)
        return entry

    def numbers(self, entry: list[Any], path: tuple[str | int, ...]) -> None:
        for index, item in enumerate(entry):
            if isinstance(item, list):
                self.numbers(item, (*path, index))
            elif not isinstance(item, (Number, str)):
                self.fault("E004", (*path, index), f"must be a number, not {_kind(item)}.")

    def input(self, entry: Any, path: tuple[str | int, ...]) -> Any:
        if not isinstance(entry, dict):
            self.fault("E004", path, f"must be an object such as {{\"unit\": \"V\"}}, not {_kind(entry)}.")
            return {}
        self.keys(entry, path, INPUT)
        self.doc(entry, path)
        if not isinstance(entry.get("unit", ""), str):
            self.fault("E004", (*path, "unit"), f"must be a text, not {_kind(entry['unit'])}.")
        if not isinstance(entry.get("default", 0.0), (Number, bool, float)):
            self.fault("E004", (*path, "default"), f"must be a number, not {_kind(entry['default'])}.")
        if entry.get("type", "real") not in ("real", "bool"):
            self.fault("E004", (*path, "type"), f"must be \"real\" or \"bool\", not {_shown(entry['type'])}.")
        size = entry.get("size", 1)
        if isinstance(size, bool) or not isinstance(size, (Number, int)) or not 1 <= size <= 100_000 or size != int(size):
            self.fault("E004", (*path, "size"), f"must be an integer from 1 on, not {_shown(size)}.")
        return entry

    def block(self, entry: Any, path: tuple[str | int, ...]) -> BlockEntry:
        if not isinstance(entry, dict):
            self.fault("E004", path, f"must be an object such as {{\"type\": \"Gain\"}}, not {_kind(entry)}.")
            return BlockEntry()
        self.keys(entry, path, BLOCK)
        kinds = [key for key in ("type", "diagram", "fmu") if key in entry]
        if len(kinds) != 1:
            what = f"has {' and '.join(kinds)}" if kinds else "has none of type, diagram and fmu"
            self.fault("E009" if not kinds else "E003", path, f"{what}; a block is exactly one of the three.", at_key=True)
            return BlockEntry()
        raw = self.object(entry, path, "parameters")
        for name, value in raw.items():
            self.parameter(value, (*path, "parameters", name))
        made = BlockEntry(
            parameters=raw,
            doc=self.doc(entry, path),
            extras={key: value for key, value in entry.items() if key.startswith("x-")},
        )
        kind, what = kinds[0], entry[kinds[0]]
        if kind == "diagram" and isinstance(what, dict):
            self.keys(what, (*path, kind), TOP)
            return replace(made, diagram=self.body(what, (*path, kind)))
        if not isinstance(what, str) or not what:
            self.fault("E004", (*path, kind), f"must be a text, not {_kind(what)}.")
            return made
        if kind == "type":
            return replace(made, type=what)
        if kind == "fmu":
            return replace(made, fmu=what)
        return replace(made, diagram=what, loaded=self.subdiagram(what, (*path, kind)))

    def subdiagram(self, text: str, path: tuple[str | int, ...]) -> DiagramValue | None:
        """The diagram of a file that a block names, relative to this file."""
        if "://" in text or "\0" in text:
            self.fault("E007", path, f"{quoted(text)} is not a path.", "Subdiagrams are files of the project.")
            return None
        target = Path(self.folder) / text
        resolved = target.resolve()
        if resolved in self.above:
            chain = [p.name for p in (*self.above[self.above.index(resolved) :], resolved)]
            self.fault("E113", path, f"the files contain each other: {' -> '.join(chain)}.")
            return None
        try:
            line, column = self.document.positions.get(path, (1, 1))
            data = read_inside(target, self.root, Fault("E007", ".".join(map(str, path)), "", "", path, self.file, line, column))
            document = jsontext.read(data, file=str(target))
            return _Reader(document, str(target), str(target.parent), self.root, (*self.above, resolved)).diagram()
        except ModelError as error:
            self.faults += error.faults
            return None

    def measure(self, entry: Any, path: tuple[str | int, ...]) -> Any:
        if not isinstance(entry, dict):
            self.fault("E004", path, f"must be an object such as {{\"type\": \"ITAE\", ...}}, not {_kind(entry)}.")
            return {}
        self.keys(entry, path, MEASURE)
        for key in ("type", "of"):
            if not isinstance(entry.get(key), str):
                code, what = ("E004", f"must be a text, not {_kind(entry[key])}.") if key in entry else ("E009", f"the key \"{key}\" is missing.")
                self.fault(code, (*path, key) if key in entry else path, what)
        return entry


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
    made: dict[str, Any] = {} if inner else {"format": FORMAT, "version": VERSION}
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
    made.update(value.extras)
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
    if entry.doc:
        made["doc"] = entry.doc
    if entry.parameters:
        made["parameters"] = dict(entry.parameters)
    made.update(entry.extras)
    return made


def _one_per_line(path: tuple[str | int, ...], value: Any) -> bool:
    """A line for each key of a diagram, block, wire, position, measure, parameter, and line of documentation."""
    while len(path) >= 3 and path[0] == "blocks" and path[2] == "diagram":  # an inline subdiagram is a diagram
        path = path[3:]
        if not path:
            return True
    if len(path) == 0:
        return True
    if len(path) == 1:
        return path[0] in TOP and path[0] not in ("run", "format", "version", "name")
    return False


def dumps_document(document: Mapping[str, Any]) -> str:
    def lines(path: tuple[str | int, ...], value: Any) -> bool:
        if _one_per_line(path, value):
            return True
        # A block that is an inline subdiagram is opened up, or all of it would stand on one line.
        tail = path
        while len(tail) > 3 and tail[0] == "blocks" and tail[2] == "diagram":
            tail = tail[3:]
        return len(tail) == 2 and tail[0] == "blocks" and isinstance(value, dict) and isinstance(value.get("diagram"), dict)

    return jsontext.write(document, one_per_line=lines)


def dumps(value: DiagramValue) -> str:
    """The canonical text of a diagram."""
    return dumps_document(to_document(value))


@contextlib.contextmanager
def write_atomically(path: str | Path) -> Iterator[Any]:
    """A text file that replaces `path` when all is written, or leaves it as it was.

    Raises UsageError (E501) where the file cannot be written.
    """
    path = Path(path)
    temporary = ""
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name[:100]}.", suffix=".part", dir=path.parent)
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        with contextlib.suppress(OSError):
            # mkstemp gives 0600; a file that a user saves has the mode that others of theirs have.
            mask = os.umask(0)
            os.umask(mask)
            os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
        temporary = ""
    except OSError as error:
        raise UsageError(
            Fault("E501", str(path), f"cannot be written: {error.strerror or error}.", "Nothing was changed.")
        ) from None
    finally:
        if temporary:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
