"""Python's collector of circular garbage, kept from running while much is built that stays."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def paused() -> Iterator[None]:
    """No search for circular garbage inside; as a decorator, none during a call.

    The collector searches whenever there are a quarter more objects than at its last full search. While a large
    diagram is read and planned nearly all of them stay, and the searches take as long as the work itself. Only the
    search waits: what nothing refers to is freed at once, as ever. A collector that is off stays off.
    """
    runs = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if runs:
            gc.enable()
