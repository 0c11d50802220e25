"""Older versions of the files: steps that bring a document from one version to the next, with the places of its text.

A file is read by the rules of the newest version, and its faults still point into the text as it is:

    def gains_have_a_section(draft: MigratedDocument) -> None:
        draft.move(("kp",), ("parameters", "kp"))

    DIAGRAM = {1: gains_have_a_section}     # from version 1 to version 2

A step does what it can: what it does not know stays where it is, and the reader reports it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any, TypeAlias

from ..text.json_document import Document
from ..text.json_number import Number

__all__ = ["DIAGRAM", "STUDY", "MigratedDocument", "Step", "migrated"]

Path: TypeAlias = tuple[str | int, ...]
Step: TypeAlias = "Callable[[MigratedDocument], None]"

DIAGRAM: dict[int, Step] = {}
"""The steps of diagram files, by the version at which each begins. The newest is `blocks.model.diagram.VERSION`."""
STUDY: dict[int, Step] = {}
"""The steps of study files. The newest version is `blocks.model.study_grammar.VERSION`."""


class MigratedDocument:
    """A document on its way: `value` may be changed, and `move` takes the places along."""

    def __init__(self, document: Document) -> None:
        self.value: Any = deepcopy(document.value)
        self.places = dict(document.places)

    def move(self, old: Path, new: Path) -> None:
        """Move what stands at a path of keys to another one; within one object it keeps its place among the others.

        Nothing happens where nothing stands there, or where the new place is taken.
        """
        source, target = self._object(old[:-1]), self._object(new[:-1], begun_at=old)
        if source is None or target is None or old[-1] not in source or new[-1] in target:
            return
        entries = [(new[-1] if source is target and key == old[-1] else key, entry) for key, entry in source.items()]
        moved = source[old[-1]]
        source.clear()
        source.update((key, entry) for key, entry in entries if source is target or key != old[-1])
        target[new[-1]] = moved
        for path in [path for path in self.places if path[: len(old)] == old]:
            self.places[(*new, *path[len(old) :])] = self.places.pop(path)

    def _object(self, path: Path, *, begun_at: Path | None = None) -> dict[Any, Any] | None:
        """The object at a path; a missing one is made, with the place in the text of `begun_at`, which moves there."""
        value = self.value
        for k, key in enumerate(path):
            if not isinstance(value, dict) or (key not in value and begun_at not in self.places):
                return None
            if key not in value:
                value[key] = {}
                self.places[path[: k + 1]] = self.places[begun_at or ()]
            value = value[key]
        return value if isinstance(value, dict) else None


def migrated(document: Document, steps: Mapping[int, Step], newest: int) -> tuple[Document, int] | None:
    """A document in its newest version, and the version that it has; None for a version that cannot be read."""
    given = document.value.get("version")
    version = int(given) if isinstance(given, Number) else newest + 1
    if not min(steps, default=newest) <= version <= newest or float(given) != version:
        return None
    if version == newest:
        return document, newest
    draft = MigratedDocument(document)
    for number in range(version, newest):
        steps[number](draft)
    draft.value["version"] = Number(str(newest))
    return Document(draft.value, draft.places, document.text, document.file), version
