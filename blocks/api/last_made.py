"""What a diagram has made last, kept for a caller that asks for the same again.

    "run"      the run that ended last: `run()` without arguments begins it anew, and prepares nothing
    "point"    the point that was asked for last: many transfers of one point are computed from one

Nothing else is kept. What is kept here follows from its key alone, so that it is never wrong to keep it or to lose it;
a copy or a pickle of a diagram has none of it.
"""

from __future__ import annotations

import threading
from typing import Any

__all__ = ["LastMade"]


class LastMade:
    """By what it is: the last one, and the key that it was made for. Threads may share it."""

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
            known, made = self._made.get(what, (None, None))
        return made if key is not None and key == known else None

    def taken(self, what: str, key: Any) -> Any:
        """As `known`; it is not kept any more, whichever it is, so that one caller alone has it, or nobody."""
        with self._lock:
            known, made = self._made.pop(what, (None, None))
        return made if key is not None and key == known else None
