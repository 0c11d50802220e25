"""A JSON document -> DiagramValue: the structure of a diagram file, with every fault in its place.

Only structure is read here: which keys there are and of what kind. What names and numbers mean (types, ports, units,
expressions) is settled by `flatten`. Reading a file never runs anything and opens nothing but the subdiagram files and
the tables that it names, which must lie in the same project.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..text import json_text
from ..text.atomic_write import real
from ..text.csv_text import read_columns
from ..text.errors import Fault, ModelError, did_you_mean
from ..text.grammar import OWN, Object, Steps, in_words, kind_of
from ..text.json_document import IN_FILES, Document
from ..text.json_number import Number, is_number
from ..text.printable import legible, quoted
from .diagram_grammar import (
    BODY,
    CONTROLS,
    DIAGRAM,
    FILE,
    KINDS,
    MOST_ROWS,
    OPTIONS,
    SCHEMA,
    members_of,
    signal,
)
from .diagram_value import (
    BASE,
    DEEPEST,
    FORMAT,
    OLD_VERSION,
    VERSION,
    BlockEntry,
    DiagramValue,
    FaultList,
    is_name,
)
from .project import Project, project_of, read_inside
from .streams import is_stream
from .values import Column, EdgeTable

EDGE = ["row", "column", "value"]
"""The columns of a CSV file of edges."""


@dataclass
class Loading:
    """What the readers of a diagram and of its subdiagram files share. A file is read once, wherever it is used."""

    near: str | Path = ""  # a file of the project
    faults: FaultList = field(default_factory=FaultList)
    files: dict[Path, DiagramValue | None] = field(default_factory=dict)
    tables: dict[Path, list[str]] = field(default_factory=dict)
    is_alone: bool = False  # other files are left closed
    texts: Mapping[str, str] = field(default_factory=dict)  # in place of what real paths hold

    @cached_property
    def project(self) -> Project:
        """Looked for when another file is opened."""
        return project_of(Path(self.near))


@dataclass
class DocumentReader:
    """Reads one document; faults are collected, so that one pass reports all of them."""

    document: Document
    file: str
    folder: str
    loading: Loading
    above: tuple[Path, ...]  # the files that contain this one, and itself
    is_old: bool = False  # whether the file has version 2
    depth: int = 0  # how many subdiagrams are around what is being read

    def fault(self, code: str, path: Steps, message: str, cure: str = "", *, at_key: bool = False) -> None:
        table = self.document.key_positions if at_key else self.document.positions
        line, column = (table.get(path) or self.document.positions.get(path, (1, 1))) if self.file else (0, 0)
        place = legible(".".join(str(part) for part in path))
        self.loading.faults.add(Fault(code, place, message, cure, path, self.file, line, column))

    def guess(self, word: str, known: Collection[str]) -> str:
        return self.loading.faults.guess(word, known, quote='"')

    def diagram(self) -> DiagramValue | None:
        value = self.document.value
        if not isinstance(value, dict):
            self.fault("E006", (), f"a diagram must be an object {{...}}, not {kind_of(value)}.")
            return None
        return self.body(value, (), DIAGRAM) if self.header(value) else None

    def header(self, value: Mapping[str, object]) -> bool:
        """Whether reading can go on: this is a diagram, perhaps with a fault in its first two keys."""
        if "format" not in value:
            cure = f'Begin with {{"format": "{FORMAT}", "version": {VERSION}, ...'
            self.fault("E009", (), 'the key "format" is missing.', cure)
            return "blocks" in value
        elif value["format"] != FORMAT:
            cure = f'A diagram has "{FORMAT}".'
            if value["format"] == "blocks-study":
                cure += " This file is a study: run it with `blocks study`."
            self.fault("E006", ("format",), f"the format is {in_words(value['format'])}.", cure)
        elif "version" not in value:
            self.fault("E009", (), 'the key "version" is missing.', f'Add "version": {VERSION}.')
            return True
        elif not isinstance(value["version"], Number):
            what = f"must be a number, not {in_words(value['version'])}."
            self.fault("E005", ("version",), what, f'Write "version": {VERSION}.')
            return True
        elif (version := float(value["version"])) not in (OLD_VERSION, VERSION):
            shown = in_words(value["version"]).removeprefix("the number ")
            message, cure = f"version {shown} cannot be read.", f"This release reads version {VERSION}."
            if version > VERSION:
                cure = "Update blocks."
            elif version == 1:
                message = "version 1 cannot be read, because it has another PID: u was the error, and y the control."
                cure = f'Write "version": {OLD_VERSION}, and change each PID as `blocks explain E005` shows.'
            self.fault("E005", ("version",), message, cure)
        else:
            self.is_old = version == OLD_VERSION
            return True
        return False

    def body(self, value: Mapping[str, Any], path: Steps, kind: Object = BODY) -> DiagramValue:
        """A diagram whose structure is checked here, but for subdiagrams in it; faulty parts are left out of it."""
        kind.check(value, path, self)
        parameters = self.parameters(_table(value, "parameters", named=True), (*path, "parameters"))
        inputs = {name: _object(entry) for name, entry in _table(value, "inputs", named=True).items()}
        outputs = {name: _text(source) for name, source in _table(value, "outputs", named=True).items()}
        blocks = {
            name: self.block(entry, (*path, "blocks", name))
            for name, entry in _table(value, "blocks", named=True).items()
        }
        self.names({"parameter": parameters, "input": inputs, "block": blocks}, path)
        run = _table(value, "run")
        for name, entry in _table(run, "inputs").items():
            members = members_of(inputs.get(name, {}).get("type"))
            signal(members).check(entry, (*path, "run", "inputs", name), self)
        layout = _table(value, "layout")
        for key in layout:
            if key not in blocks and key not in inputs and key not in outputs:
                cure = self.loading.faults.guess(key, blocks)
                self.fault("E105", (*path, "layout", key), f"there is no block {quoted(key)}.", cure, at_key=True)
        return DiagramValue(
            value["name"] if is_name(value.get("name")) else "diagram",
            _doc(value),
            parameters,
            inputs,
            outputs,
            blocks,
            {sink: _text(source) for sink, source in _table(value, "wires").items()},
            run,
            {name: self.measure(_object(entry)) for name, entry in _table(value, "measures", named=True).items()},
            layout,
            {key: entry for key, entry in value.items() if key.startswith(OWN) or (key == SCHEMA and kind is DIAGRAM)},
            self.file,
            self.folder,
            self.document.places if self.file else {},
            path,
        )

    def measure(self, entry: Mapping[str, object]) -> Mapping[str, object]:
        """Return a measure of version 3: a plain number of version 2 becomes an expression, which is in SI, too."""
        against = entry.get("against")
        if isinstance(against, Mapping) and not against.get("unit"):
            against = against.get("value")
        return {**entry, "against": f"={against!r}"} if self.is_old and is_number(against) else entry

    def names(self, tables: Mapping[str, Mapping[str, object]], path: Steps) -> None:
        """Blocks, inputs and parameters have names that differ."""
        taken: dict[str, str] = {}
        for what, table in tables.items():
            for key in table:
                if key in taken:
                    first = self.document.key_positions.get((*path, taken[key] + "s", key)) if self.file else None
                    where = f" in line {first[0]}" if first else ""
                    self.fault("E109", (*path, what + "s", key), f"the {taken[key]}{where} already has this name.",
"Rename one: blocks, inputs and parameters need different names.", at_key=True)  # fmt: skip
                taken.setdefault(key, what)

    def parameters(self, table: Mapping[str, object], path: Steps) -> dict[str, Any]:
        return {
            name: self.column(raw, (*path, name)) if isinstance(raw, dict) and "csv" in raw else raw
            for name, raw in table.items()
        }

    def column(self, entry: dict[str, Any], path: Steps) -> Any:
        """A column of a CSV file in the project with its numbers, or one of edges with them."""
        wanted = EDGE if "shape" in entry else [entry.get("column")]
        if self.loading.is_alone or not all(isinstance(text, str) for text in (entry.get("csv"), *wanted)):
            return entry
        if not isinstance(entry.get("unit", ""), str):
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
                    raise ValueError("is not a text in UTF-8.") from None
            given: dict[str, str] = {}
            header, data = read_columns(self.loading.tables[target], {*wanted}, most=MOST_ROWS, units=given)
            missing = next((column for column in wanted if column not in header), None)
            if missing is not None:
                cure = did_you_mean(missing[:200], header[:500])
                cure = cure or f"Columns: {', '.join(legible(column[:40]) for column in header[:20])}."
                what = "no such column" if "column" in entry else f"no column {quoted(missing)}"
                key = "column" if "column" in entry else "csv"
                self.fault("E007", (*path, key), f"{quoted(entry['csv'])} has {what}.", cure)
                return entry
            numbers: Any = np.column_stack([data[:, header.index(str(column))] for column in wanted])
            unit = given.get(str(wanted[-1]), "")
            if "shape" in entry:
                return EdgeTable(entry, numbers.tolist(), unit)
            return Column(entry, numbers[:, 0].tolist(), unit)
        except ModelError as error:
            self.loading.faults.add(error.faults[0])
        except ValueError as error:
            self.fault("E007", (*path, "csv"), f"{quoted(entry['csv'])} {error}")
        return entry

    def block(self, entry: Any, path: Steps, *, is_variant: bool = False) -> BlockEntry:
        kinds = [key for key in KINDS if key in entry] if isinstance(entry, dict) else []
        if len(kinds) != 1:
            return BlockEntry()
        kind, what = kinds[0], entry[kinds[0]]
        stream = entry.get("stream")
        parts: dict[str, Any] = {}
        if is_variant:
            parts["ports"] = {name: own for name, own in _table(entry, "ports").items() if isinstance(own, str)}
        else:
            parts["copies"] = entry["copies"] if isinstance(entry.get("copies"), (Number, str)) else None
            if "variants" in entry or "variant" in entry:
                parts |= self.variants(entry, path)
        if kind == "diagram" and isinstance(what, dict):
            if self.is_too_deep((*path, kind)):
                return BlockEntry()
            self.depth += 1
            parts["diagram"] = self.body(what, (*path, kind))
            self.depth -= 1
        elif isinstance(what, str) and what:
            parts[kind] = what
            parts["loaded"] = self.subdiagram(what, (*path, kind)) if kind == "diagram" else None
        return BlockEntry(
            parameters=self.parameters(_table(entry, "parameters"), (*path, "parameters")),
            doc=_doc(entry),
            extras={key: value for key, value in entry.items() if key.startswith(OWN)},
            control=_control(entry) if "enable" in entry or "trigger" in entry else {},
            stream=stream if is_stream(stream) else "",
            options={key: entry[key] for key in OPTIONS if key in entry} if kind == "fmu" else {},
            **parts,
        )

    def variants(self, entry: Mapping[str, object], path: Steps) -> dict[str, Any]:
        """The variants of a block, and the name of the chosen one."""
        variants = {
            name: self.block(other, (*path, "variants", name), is_variant=True)
            for name, other in _table(entry, "variants", named=True).items()
        }
        chosen = _text(entry.get("variant"))
        if chosen and chosen not in (BASE, *variants):
            known = (BASE, *variants)
            cure = self.guess(chosen, known) or f"Variants: {', '.join(known)}."
            self.fault("E122", (*path, "variant"), f"there is no variant {quoted(chosen)}.", cure)
            chosen = ""
        return {"variants": variants, "variant": chosen}

    def is_too_deep(self, path: Steps) -> bool:
        """Whether one more subdiagram is too many, which is reported as a fault."""
        if self.depth >= DEEPEST:
            cure = "Move some of them to a higher level."
            self.fault("E008", path, f"subdiagrams lie more than {DEEPEST} deep.", cure)
        return self.depth >= DEEPEST

    def subdiagram(self, text: str, path: Steps) -> DiagramValue | None:
        """The diagram of a file that a block names, relative to this file."""
        if self.loading.is_alone or not FILE.fits(text):
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
                known = loading.texts.get(str(resolved))
                if known is None:
                    data = read_inside(target, loading.project, place, shown, IN_FILES)
                else:
                    data = known.encode()
                document = json_text.read(data, file=shown, times=IN_FILES)
            except ModelError as error:
                loading.faults.update(error.faults)
            else:
                above = (*self.above, resolved)
                reader = DocumentReader(document, shown, str(target.parent), loading, above, depth=self.depth + 1)
                loading.files[resolved] = reader.diagram()
        return loading.files[resolved]


def _table(value: Mapping[str, object], key: str, *, named: bool = False) -> dict[str, Any]:
    """An object in an object; an empty one where there is none. named: without what has no name for its key."""
    table = _object(value.get(key))
    return {name: entry for name, entry in table.items() if is_name(name)} if named else table


def _object(value: object) -> dict[str, object]:
    return value if isinstance(value, dict) else {}


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""


def _doc(value: Mapping[str, object]) -> object:
    return value.get("doc") or ""


def _control(entry: Mapping[str, Any]) -> dict[str, Mapping[str, object]]:
    """What turns a subdiagram on, or triggers it; nothing where that is faulty."""
    given = {key: entry[key] for key in CONTROLS if key in entry}
    if not all(isinstance(value, dict) for value in given.values()):
        return {}
    trigger = given.get("trigger", {"every": None})
    return given if ("every" in trigger) != ("direction" in trigger) else {}
