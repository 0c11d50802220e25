"""A document on its way from one version of its format to the next, with the places of its text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from copy import deepcopy
from typing import Any

from ..text.errors import Fault, ModelError
from ..text.json_document import AT_KEY, Document, Path
from ..text.printable import legible


class MigratedDocument:
    """A document on its way: `value` may be changed; `move` and `rewrite` take the places along."""

    def __init__(self, document: Document) -> None:
        self.value: Any = deepcopy(document.value)
        self.places = dict(document.places)
        self.file = document.file

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

    def refuse(self, path: Path, message: str, cure: str) -> None:
        """Raise ModelError (E005) for what the version of the file does not have."""
        found = self.places.get((*path, AT_KEY)) or self.places.get(path) or (1, 1)
        line, column = found if self.file else (0, 0)
        place = legible(".".join(map(str, path)))
        raise ModelError(Fault("E005", place, message, cure, path, self.file, line, column))

    def at(self, path: Path) -> Any:
        """What stands at a path of keys; None where nothing does."""
        value = self.value
        for key in path:
            value = value.get(key) if isinstance(value, dict) else None
        return value

    def rewrite(self, path: Path, entries: Iterable[tuple[str, Any, str]]) -> None:
        """Other entries for the object at a path: keys, values, and the keys whose places in the text they have."""
        target, places = self.at(path), {}
        entries = list(entries)
        for new, entry, old in entries:
            if new != old:
                for below in ((), (AT_KEY,), *_below(entry if entry is target.get(old) else None)):
                    if (*path, old, *below) in self.places:
                        places[*path, new, *below] = self.places[*path, old, *below]
        target.clear()
        target.update((new, entry) for new, entry, _ in entries)
        self.places |= places

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


def _below(value: Any) -> Iterator[Path]:
    """The paths of all that a value holds, and of its keys."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, entry in items:
        yield (key,)
        yield (key, AT_KEY)
        yield from ((key, *path) for path in _below(entry))
