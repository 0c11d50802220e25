"""The canonical form of a file: of a diagram, or of a study."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from ..model import diagram_value, study_grammar
from ..model import document as documents
from ..model.block_types import Library, library_types
from ..model.diagram_value import DiagramValue, is_plain_number
from ..model.flatten import flatten, numbers_in_si
from ..model.project import MAX_BYTES, Project, read_inside
from ..model.resolver import resolver_of
from ..model.version_3 import converted
from ..text import json_text
from ..text.errors import BlocksError, Fault
from . import study


@dataclass(frozen=True)
class Canonical:
    """A file as it is and as it should be, the version that it has, and that in which it is written.

    warnings: why it stays at an older version.
    """

    old: str
    new: str
    version: int
    newest: int
    warnings: tuple[Fault, ...] = ()


def canonical(file: str, stream: BinaryIO | None = None, *, library: Library = ()) -> Canonical:
    """The canonical form of a file, in the newest version.

    Nothing but the file itself is read, unless it is a diagram of an older version with plain numbers in its measures:
    the units of the signals tell whether a number is converted. stream: where its bytes come from in place of the
    file. library: block types beyond the library that ships. Raises ModelError with the faults of its structure.
    """
    if stream is not None:
        data = stream.read(MAX_BYTES + 1)
    else:
        data = read_inside(Path(file), Project(Path(os.path.realpath(file)).parent), Fault("E007", "", ""))
    document = json_text.read(data, file=file)
    is_study = isinstance(document.value, dict) and document.value.get("format") == study_grammar.FORMAT
    if is_study:
        return Canonical(document.text, *study.canonical(document), study_grammar.VERSION)
    newest = diagram_value.PLAIN_VERSION

    warnings: list[Fault] = []

    def convert(value: DiagramValue) -> DiagramValue:
        nonlocal newest
        value = _up_to_date(value, document.text, file, library, warnings)
        newest = documents.written_version(value)
        return value

    new, version = documents.canonical(document, convert)
    return Canonical(document.text, new, version, newest, tuple(warnings))


def _up_to_date(value: DiagramValue, text: str, file: str, library: Library, warnings: list[Fault]) -> DiagramValue:
    """Return the diagram of a file with numbers as version 3 has them.

    If its meaning has faults, it comes back as it is, and warnings gets a fault (W104).
    """
    if not (value.is_before_3 and value.has_plain_numbers):
        return value
    try:
        whole = documents.loads(text, file=file, folder=os.path.dirname(os.path.realpath(file)))
        found = numbers_in_si(whole, flatten(whole, resolver_of(library_types(library))).signals)
    except BlocksError as error:  # an older version keeps its meaning
        name = next(name for name, raw in value.measures.items() if is_plain_number(raw.get("against")))
        first = error.faults[0]
        message = f'the file stays at version {value.version}: the unit of the number in "against" is unknown, '
        message += f"because of {first.code} {first.place}."
        cure = (
            "Fix the faults that `blocks check` finds (add --library MODULE for your own blocks), then format the file."
        )
        warnings.append(value.fault("W104", f"measures.{name}", message, cure, ("measures", name, "against")))
        return value
    return converted(value, found) if found else value
