"""JSON <-> DiagramValue: diagrams read whole, from files, texts and dicts, and written in their canonical form.

What is read is the structure of a file (`document_reader`); it is written with the same keys in the same order.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..host.gc_pause import paused
from ..text import json_text, json_writer
from ..text.atomic_write import real
from ..text.errors import Fault, ModelError
from ..text.grammar import Object
from ..text.json_document import IN_FILES, Document
from .diagram_grammar import BLOCK, BODY, DIAGRAM, SCHEMA, VARIANT
from .diagram_value import DEEPEST, FORMAT, VERSION, BlockEntry, DiagramValue, FaultList
from .document_reader import DocumentReader, Loading
from .project import Project, read_inside
from .values import Column

# --- reading ---------------------------------------------------------------------------------------------------


def load(path: str | Path) -> DiagramValue:
    """The diagram of a file, with the subdiagram files that it names.

    Raises ModelError with all faults found (E0xx; E113 for files that contain each other).
    """
    path = Path(path)
    resolved = real(path)
    data = read_inside(path, Project(resolved.parent), Fault("E007", "", ""), times=IN_FILES)
    # Absolute, so that it stays the same folder when the program goes to another.
    folder = os.path.abspath(path.parent)
    return _read(data, str(path), folder, Loading(path), (resolved,), IN_FILES)


def loads(
    text: str | bytes, *, file: str = "<text>", folder: str | Path = "", texts: Mapping[str, str] | None = None,
    times: int = 1,
) -> DiagramValue:
    """The diagram of a text. Subdiagram files are looked for from `folder` on (the current one unless given).

    texts: what files hold, by their real paths, in place of what is on the disk. times: as of `json_text.read`.
    """
    folder = os.path.abspath(folder)
    return _read(text, file, folder, Loading(Path(folder) / "x", texts=texts or {}), (), times)


def alone(document: Document) -> tuple[DiagramValue | None, list[Fault]]:
    """What a file itself says, and its own faults: no other file is opened. None where it is no diagram."""
    loading = Loading(is_alone=True)
    try:
        value = DocumentReader(document, document.file, "", loading, ()).diagram()
    except ModelError as error:  # of too many faults
        loading, value = Loading(), None
        loading.faults.update(error.faults)
    return value, loading.faults.in_order()


def canonical(document: Document) -> str:
    """The canonical text of a diagram's document.

    What the diagram means may be wrong; its structure may not. Raises ModelError with the faults of that.
    """
    value, faults = alone(document)
    # Faults with these codes leave nothing out of the value.
    faults = [fault for fault in faults if fault.code not in ("E105", "E109")]
    if faults:
        raise ModelError(*faults)
    assert value is not None
    text = dumps(value)
    if alone(json_text.read(text, times=IN_FILES))[0] != value:
        raise AssertionError("the canonical text does not describe the same document")
    return text


def from_document(document: Mapping[str, object], *, folder: str | Path = "") -> DiagramValue:
    """The diagram of a dict, as `json.load` would give it."""
    return _unseen(document, os.path.abspath(folder))


def entries(*, folder: str = "", **sections: Mapping[str, object]) -> DiagramValue:
    """Some sections of a diagram that is made in Python, as a file in `folder` would hold them. Raises ModelError."""
    document = {"format": FORMAT, "version": VERSION, **sections}
    with contextlib.suppress(ValueError):
        loading = Loading(os.path.join(folder, "x"))
        quick = Document(json_text.without_text(document), {}, "", "")
        value = DocumentReader(quick, "", folder, loading, ()).diagram()
        if value is not None and not loading.faults:
            return value
    return _unseen(document, os.path.abspath(folder))  # which has a text to tell of


def block(name: str, entry: Mapping[str, object], folder: str) -> BlockEntry:
    """One block of a diagram that is made in Python, as `entries` gives it. Raises ModelError."""
    with contextlib.suppress(ValueError):
        value = json_text.without_text(entry)
        loading, path = Loading(os.path.join(folder, "x")), ("blocks", name)
        reader = DocumentReader(Document(value, {}, "", ""), "", folder, loading, ())
        BLOCK.check(value, path, reader)
        read = reader.block(value, path)
        if not loading.faults:
            return read
    return entries(folder=folder, blocks={name: entry}).blocks[name]  # which has a text to tell of


def _unseen(document: Mapping[str, object], folder: str) -> DiagramValue:
    """The diagram of a text that nobody sees: its faults have no line."""
    try:
        return _read(dumps_document(document), "", folder, Loading(Path(folder) / "x"), (), IN_FILES)
    except ModelError as error:
        faults = (fault.at("", 0, 0) if fault.file in ("", "<text>") else fault for fault in error.faults)
        raise ModelError(*faults) from None


@paused()
def _read(
    text: str | bytes, file: str, folder: str, loading: Loading, above: tuple[Path, ...], times: int
) -> DiagramValue:
    document, first = json_text.meant(text, file=file, times=times)
    diagram = DocumentReader(document, file, folder, loading, above).diagram()
    if first or loading.faults:
        faults, told = FaultList(), {fault.path for fault in first}
        faults.update(first)
        # A number that the text could not give is none for the diagram either.
        faults.update(fault for fault in loading.faults.in_order() if fault.code != "E004" or fault.path not in told)
        raise ModelError(*faults.in_order(), readable=diagram)
    assert diagram is not None
    return diagram


# --- writing ---------------------------------------------------------------------------------------------------


def to_document(value: DiagramValue, *, inner: bool = False) -> dict[str, object]:
    """The dict of a diagram, keys in the canonical order, empty sections left out."""
    document = {key: _plain(getattr(value, key)) for key in BODY.keys if getattr(value, key) or key == "name"}
    if value.blocks:
        document["blocks"] = {name: entry_document(entry) for name, entry in value.blocks.items()}
    document |= value.extras
    if not inner:
        return DIAGRAM.ordered({"format": FORMAT, "version": VERSION} | document)
    left = {SCHEMA, "name"} if value.name == "diagram" else {SCHEMA}
    return BODY.ordered({key: entry for key, entry in document.items() if key not in left})


def entry_document(entry: BlockEntry, kind: Object = BLOCK) -> dict[str, Any]:
    """The dict of a block."""
    document: dict[str, object] = {"type": entry.type} if entry.type else {"fmu": entry.fmu}
    if not entry.type and not entry.fmu:
        diagram = entry.diagram
        document = {"diagram": to_document(diagram, inner=True) if isinstance(diagram, DiagramValue) else diagram}
    keys = ("copies", "stream", "doc", "parameters", "ports", "variant")
    document |= {key: _plain(getattr(entry, key)) for key in keys if getattr(entry, key)}
    if entry.variants:
        document["variants"] = {name: entry_document(other, VARIANT) for name, other in entry.variants.items()}
    return kind.ordered({**document, **entry.control, **entry.options, **entry.extras})


def _plain(value: object) -> Any:
    return dict(value) if isinstance(value, Mapping) else list(value) if isinstance(value, tuple) else value


def dumps_document(document: Mapping[str, object]) -> str:
    """The canonical text of a dict."""
    return json_writer.write(document, one_per_line=DIAGRAM.lines(document))


def dumps(value: DiagramValue) -> str:
    """The canonical text of a diagram. Raises ModelError (E008) for one made in Python that no file can hold."""
    level: list[DiagramValue] = [value]
    for _ in range(DEEPEST + 1):
        within = [entry for outer in level for entry in outer.blocks.values()]
        within += [variant for entry in within for variant in entry.variants.values()]
        level = [*{id(e.diagram): e.diagram for e in within if isinstance(e.diagram, DiagramValue)}.values()]
    if level:
        message = f"subdiagrams lie more than {DEEPEST} deep."
        raise ModelError(Fault("E008", value.name, message, "Move some of them to a higher level."))
    return dumps_document(to_document(value))


def self_contained(value: DiagramValue) -> DiagramValue:
    """The value with the diagrams and the columns of other files in it, so that its text names no files but FMUs.

    value: with its variants taken.
    """

    def parameters(table: Mapping[str, object]) -> dict[str, Any]:
        return {name: raw.as_value if isinstance(raw, Column) else raw for name, raw in table.items()}

    def whole(entry: BlockEntry) -> BlockEntry:
        inner = entry.inner
        diagram = None if inner is None else self_contained(relocated(inner, value.folder))
        return replace(entry, diagram=diagram, loaded=None, parameters=parameters(entry.parameters))

    blocks = {name: whole(entry) for name, entry in value.blocks.items()}
    return replace(value, blocks=blocks, parameters=parameters(value.parameters))


def relocated(value: DiagramValue, folder: str | Path) -> DiagramValue:
    """The value as a file in another folder holds it: the paths of other files lead to the same files."""
    if value.folder and value.folder == str(folder):  # else the disk is asked
        return value
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

    def parameters(table: Mapping[str, object]) -> dict[str, Any]:
        return {
            name: type(raw)({**raw, "csv": path(raw["csv"])}, raw.numbers, raw.unit) if isinstance(raw, Column) else raw
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
    schema = extras.get(SCHEMA)
    if isinstance(schema, str) and schema and not re.match(r"[A-Za-z][\w+.-]+:|[/#]", schema):  # a path, and no URL
        extras[SCHEMA] = path(schema)
    moved_parameters = parameters(value.parameters)
    return replace(value, blocks=blocks, parameters=moved_parameters, extras=extras, folder=os.path.abspath(folder))
