"""What a diagram has made last, kept for a caller that asks for the same again.

    "model"    the prepared model of the last run, of which other runs are made
    "point"    the point that was asked for last: many transfers of one point are computed from one
    "standing" what the last points were made of: others differ in values of parameters

Nothing else is kept. What is kept here follows from its key and the block classes alone, so that it is never wrong to
keep it or to lose it; a copy or a pickle of a diagram has none of it.
"""

from __future__ import annotations

import threading
from typing import Any

from ..contract.block import BlockMeta
from ..model.diagram_value import DiagramValue


class LastMade:
    """The last one of each kind, and the key that it was made for. Threads may share it."""

    def __init__(self) -> None:
        self._made: dict[str, tuple[object, object]] = {}
        self._lock = threading.Lock()

    def __reduce__(self) -> Any:
        return LastMade, ()

    def keep(self, what: str, key: object, made: object) -> None:
        with self._lock:
            self._made[what] = ((key, BlockMeta.renewals), made)

    def known(self, what: str, key: object) -> Any:
        """Return the last object if it was made for this key; else None."""
        with self._lock:
            known, kept = self._made.get(what, (None, None))
        return kept if key is not None and (key, BlockMeta.renewals) == known else None


def names_files(value: DiagramValue) -> bool:
    """Whether other files, which may change, say what a diagram is."""
    for entry in value.blocks.values():
        is_file = (entry.diagram and entry.inner is None) or entry.fmu or entry.variants
        if is_file or (entry.inner and names_files(entry.inner)):
            return True
    return bool(value.run.get("inputs"))
