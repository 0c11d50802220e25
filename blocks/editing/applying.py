"""Lists of operations on the files of a project: applied in their order, checked as a whole, written all or none."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..model.block_ports import MOST_LISTED
from ..model.block_types import Library
from ..model.document_reader import DocumentReader, Loading
from ..model.project import Project, read_inside
from ..text import json_text, json_writer
from ..text.errors import BlocksError, Fault, ModelError, UsageError, did_you_mean
from ..text.grammar import OWN
from ..text.json_document import Document, place_of
from ..text.printable import legible
from .edits import Edit, Workspace
from .operations import OPERATIONS
from .references import SECTIONS, Documents
from .spots import Spot, spot_of


def edit_file(
    path: str | Path,
    operations: Iterable[Mapping[str, object]] | Document,
    *,
    library: Library = (),
    project: bool = False,
    text: str | bytes | None = None,
    check: bool = True,
) -> Edit:
    """What a list of operations makes of a diagram or study file, and of the files that it names: nothing is written.

        edit_file("loop.json", [{"set": "blocks.pid.parameters.kp", "to": 3}]).write()

    Only the characters that must change do. `write` writes all files or none, and `undone` gives the old texts back.
    The operations: docs/diagram_file.md, "Edits".

    library: block types of one's own, as for `Diagram.load`. project: edit the other files of the project as well that
    refer to what is removed or renamed; else `elsewhere` tells of them. text: what the file holds, in place of what is
    on the disk. check: look for new faults in the meaning of the diagram (`faults`), which are no errors. Raises
    ModelError and UsageError; faults that the files had before are none.
    """
    if isinstance(operations, (str, bytes, Mapping)) or not isinstance(operations, (Document, Iterable)):
        what = f"must be a list of operations, not {type(operations).__name__}."
        raise UsageError(Fault("E501", "operations", what, 'Give [{"set": "run.stop", "to": 5}].'))
    document = operations if isinstance(operations, Document) else _written([*operations])
    entries = checked(document)
    workspace, first = Workspace.of(path, library, text=text)
    workspace.is_whole = project
    for index, (name, entry) in enumerate(entries):
        try:
            OPERATIONS[name].apply(spot_of(workspace, first, entry), entry)
        except BlocksError as error:
            where = f"operation {index + 1} ({name}): " if len(entries) > 1 else ""
            raise type(error)(*(replace(fault, message=where + fault.message) for fault in error.faults)) from error
    edit = workspace.edit()
    return replace(edit, faults=workspace.new_faults(first)) if check else edit


def text_without(text: str, name: str, folder: str, library: Library) -> str:
    """Return the text of a diagram without an entry, and without everything that refers to it; no file is changed.

    name: of a block, an input, a parameter, an output or a measure. folder: where relative paths begin. Raises
    UsageError (E501).
    """
    project = Project(Path(folder))
    workspace = Workspace(project, Documents(project), {}, library=library, is_alone=True)
    first = workspace.open(Path(folder, ".unsaved diagram"), text=text, is_first=True)
    value = workspace.value(first)
    if not isinstance(name, str):
        raise UsageError(Fault("E501", "remove", f"{legible(repr(name))} is not a name.", 'Example: remove("motor").'))
    sections = [section for section in SECTIONS.values() if name in value.get(section, {})]
    if not sections:
        names = [key for section in SECTIONS.values() for key in value.get(section, {})]
        cure = did_you_mean(name, names) or f"Names: {', '.join(names[:MOST_LISTED]) or 'none'}."
        raise UsageError(Fault("E501", legible(name), "there is nothing of this name to remove.", cure))
    try:
        OPERATIONS["remove"].apply(Spot(workspace, first), {"remove": f"{sections[0]}.{name}"})
    except BlocksError as error:
        raise type(error)(*(replace(fault, file="", line=0, column=0) for fault in error.faults)) from error
    return workspace.document(first).text


def operations_of(path: str | Path, data: bytes | None = None) -> Document:
    """The operations of a JSON file. data: its bytes, where they come from elsewhere. Raises ModelError (E0xx)."""
    if data is None:
        data = read_inside(Path(path), Project(Path(os.path.realpath(path)).parent), Fault("E007", "", ""))
    return json_text.read(data, file=str(path))


def _written(operations: list[Any]) -> Document:
    """Operations from Python, as a file would hold them: NumPy's numbers are numbers then."""
    document = json_text.read(json_writer.write(operations, one_per_line=lambda path, value: False))
    return replace(document, file="")


def checked(document: Document) -> list[tuple[str, Mapping[str, object]]]:
    """The operations with their names. Raises ModelError with all faults of what they say."""
    reader = DocumentReader(document, document.file, "", Loading(), ())
    named: list[tuple[str, Mapping[str, object]]] = []
    if not isinstance(document.value, list):
        reader.fault("E004", (), 'operations must be a list: [{"set": ..., "to": ...}].')
    for index, entry in enumerate(document.value if isinstance(document.value, list) else ()):
        name = next((key for key in entry if key in OPERATIONS), None) if isinstance(entry, dict) else None
        if name is None:
            words = [key for key in entry if not key.startswith(OWN)] if isinstance(entry, dict) else []
            cure = next(filter(None, (did_you_mean(word[:200], OPERATIONS, quote='"') for word in words)), "")
            cure = cure or f"Operations: {', '.join(OPERATIONS)}."
            reader.fault("E004", (index,), "is not an operation.", cure)
            continue
        OPERATIONS[name].kind.check(entry, (index,), reader)
        named.append((name, entry))
    if reader.loading.faults:
        faults = reader.loading.faults.in_order()
        raise ModelError(*(replace(fault, place=f"operations{place_of(fault.path)}") for fault in faults))
    return named
