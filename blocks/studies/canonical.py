"""The canonical form of a file: of a diagram, or of a study."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from ..model import diagram_value, study_grammar
from ..model import document as documents
from ..model.project import MAX_BYTES, Project, read_inside
from ..text import json_text
from ..text.errors import Fault
from ..text.json_document import IN_FILES
from . import study


@dataclass(frozen=True)
class Canonical:
    """A file as it is and as it should be, the version that it has, and the version that is written."""

    old: str
    new: str
    version: int
    newest: int


def canonical(file: str, stream: BinaryIO | None = None) -> Canonical:
    """The canonical form of a file, in the newest version. No other file is read.

    stream: where its bytes come from in place of the file. Raises ModelError with the faults of its structure.
    """
    if stream is not None:
        data = stream.read(IN_FILES * MAX_BYTES + 1)
    else:
        project = Project(Path(os.path.realpath(file)).parent)
        data = read_inside(Path(file), project, Fault("E007", "", ""), times=IN_FILES)
    document = json_text.read(data, file=file, times=IN_FILES)
    is_study = isinstance(document.value, dict) and document.value.get("format") == study_grammar.FORMAT
    new = study.canonical(document) if is_study else documents.canonical(document)
    newest = study_grammar.VERSION if is_study else diagram_value.VERSION
    return Canonical(document.text, new, int(document.value["version"]), newest)
