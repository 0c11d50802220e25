"""Older versions of the files: steps that bring a document from one version to the next, with the places of its text.

A file is read by the rules of the newest version, and its faults still point into the text as it is:

    def gains_have_a_section(draft: MigratedDocument) -> None:
        draft.move(("kp",), ("parameters", "kp"))

    DIAGRAM = {1: gains_have_a_section}     # from version 1 to version 2

A step does what it can: what it does not know stays where it is, and the reader reports it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

from ..text.json_document import Document
from ..text.json_number import Number
from .migrated_document import MigratedDocument
from .version_2 import pid_takes_r_and_y

__all__ = ["DIAGRAM", "STUDY", "MigratedDocument", "Step", "migrated"]

Step: TypeAlias = Callable[[MigratedDocument], None]

DIAGRAM: dict[int, Step] = {1: pid_takes_r_and_y}
"""The steps of diagram files, by the version at which each begins. The newest is `diagram_value.VERSION`; what
is written as version 2 means the same in it."""
STUDY: dict[int, Step] = {}
"""The steps of study files. The newest version is `blocks.model.study_grammar.VERSION`."""


def migrated(document: Document, steps: Mapping[int, Step], newest: int) -> tuple[Document, int] | None:
    """A document in its newest version, and the version that it has; None for a version that cannot be read."""
    given = document.value.get("version")
    version = int(given) if isinstance(given, Number) else newest + 1
    if not min(steps, default=newest) <= version <= newest or float(given) != version:
        return None
    if version == newest:
        return document, newest
    missing = [steps[number] for number in range(version, newest) if number in steps]
    if not missing:  # the newest one has something more, and nothing that is another
        return document, version
    draft = MigratedDocument(document)
    for step in missing:
        step(draft)
    draft.value["version"] = Number(str(newest))
    return Document(draft.value, draft.places, document.text, document.file), version
