"""What a diagram has made last, kept for a caller that asks for the same again.

    "run"      the run that ended last: `run()` without arguments begins it anew, and prepares nothing
    "point"    the point that was asked for last: many transfers of one point are computed from one

Nothing else is kept. What is kept here follows from its key alone, so that it is never wrong to keep it or to lose it;
a copy or a pickle of a diagram has none of it.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from ..model.diagram import DiagramValue
from ..results.results import Results

if TYPE_CHECKING:
    from .run import Run

__all__ = ["LastMade", "names_files", "repeated", "run_key"]

MOST_KEPT = 2**24
"""Bytes of rows of a run that is kept for the next one."""


class LastMade:
    """The last one of each kind, and the key that it was made for. Threads may share it."""

    def __init__(self) -> None:
        self._made: dict[str, tuple[Any, Any]] = {}
        self._lock = threading.Lock()

    def __reduce__(self) -> Any:
        return LastMade, ()

    def keep(self, what: str, key: Any, made: Any) -> None:
        with self._lock:
            self._made[what] = (key, made)

    def known(self, what: str, key: Any) -> Any:
        """The last one, where it was made for this key; else None."""
        with self._lock:
            known, kept = self._made.get(what, (None, None))
        return kept if key is not None and key == known else None

    def taken(self, what: str, key: Any) -> Any:
        """As `known`, but it is no longer kept, whatever its key, so that at most one caller has it."""
        with self._lock:
            known, kept = self._made.pop(what, (None, None))
        return kept if key is not None and key == known else None


def run_key(value: DiagramValue, engine: str | None, settings: Mapping[str, Any]) -> Any:
    """What a run without inputs follows from; None where that is not known before the run."""
    plain = (str, int, float, type(None))
    if not all(isinstance(item, plain) for item in settings.values()) or names_files(value):
        return None
    given = tuple((name, type(item), item) for name, item in settings.items())  # 1 is no True
    return id(value), value, engine, os.environ.get("BLOCKS_ENGINE"), os.environ.get("CC"), given


def names_files(value: DiagramValue) -> bool:
    """Whether other files, which may change, say what a diagram is."""
    for entry in value.blocks.values():
        is_file = (entry.diagram and entry.inner is None) or entry.fmu or entry.variants
        if is_file or (entry.inner and names_files(entry.inner)):
            return True
    return bool(value.run.get("inputs"))


def repeated(last: LastMade, key: Any, start: Callable[[], Run]) -> Results:
    """What a run gives; the same run again is not prepared again. key: its `run_key`. start: begins it."""
    known: Run | None = last.taken("run", key)
    known = known if known is not None and known.is_current else None
    if known is not None:
        known.again()
    run = known or start()
    results = run.finish()
    # One that records much is not kept, nor one that would never be taken, as FMUs may be in it.
    if key is not None and run.is_repeatable and not results.interrupted and run.recorded_bytes <= MOST_KEPT:
        last.keep("run", key, run)
    return results
