"""The fingerprint of a diagram, by which results identify the diagram that they are of."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ..text.json_number import is_number
from .diagram_value import BlockEntry, DiagramValue
from .document import to_document
from .values import Column


def fingerprint(value: DiagramValue) -> str:
    """The SHA-256 of all that a diagram computes: its canonical JSON with the subdiagrams' in place of their paths,
    and the SHA-256 of FMUs in place of theirs.

    Documentation, layout and the spelling of numbers are left out. Block types go in by their names only.
    """
    # The version of the format is no part of what is computed; 1 is what went in when there was no other.
    document = {**to_document(_bare(value)), "version": 1}
    if any(is_number(raw.get("against")) for raw in value.measures.values()):
        document["version"] = 3  # the same number was another value in version 2
    return hashlib.sha256(json.dumps(document).encode()).hexdigest()


def _bare(value: DiagramValue) -> DiagramValue:
    """A diagram with nothing but what computed numbers depend on."""
    return replace(
        value,
        doc="",
        parameters=_without_doc(value.parameters),
        inputs={name: _kept(entry) for name, entry in value.inputs.items()},
        blocks={name: _bare_entry(entry, value.folder) for name, entry in value.blocks.items()},
        run={key: item for key, item in value.run.items() if key != "doc" and not key.startswith("x-")},
        measures={name: _kept(entry) for name, entry in value.measures.items()},
        layout={},
        extras={},
    )


def _bare_entry(entry: BlockEntry, folder: str) -> BlockEntry:
    inner = entry.inner
    diagram = entry.diagram if inner is None else _bare(inner)
    parameters = _without_doc(entry.parameters)
    if entry.fmu:  # its bytes and its kind count, not where it lies or in which process it runs
        options = {key: value for key, value in entry.options.items() if key == "kind"}
        entry = replace(entry, fmu=_sha256_of(Path(folder) / entry.fmu) or entry.fmu, options=options)
    return replace(entry, diagram=diagram, doc="", extras={}, parameters=parameters)


def _sha256_of(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest() if path.is_file() else ""
    except (OSError, ValueError):
        return ""


def _without_doc(entries: Mapping[str, object]) -> dict[str, object]:
    stripped: dict[str, object] = {}
    for name, entry in entries.items():
        if isinstance(entry, Mapping):
            # Of a column of another file the numbers count, not where it lies.
            numbers: dict[str, object] = {}
            if isinstance(entry, Column):
                numbers = {entry.key: entry.numbers, **({"unit": entry.unit} if entry.unit else {})}
            whole = {**numbers, **_kept(entry)}
            stripped[name] = whole["value"] if list(whole) == ["value"] else whole
        else:
            stripped[name] = entry
    return stripped


def _kept(entry: Mapping[str, object]) -> dict[str, object]:
    """Return the entry without its documentation, and without where its numbers lie."""
    return {key: item for key, item in entry.items() if key not in ("doc", "csv", "column") and key[:2] != "x-"}
