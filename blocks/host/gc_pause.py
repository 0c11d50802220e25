"""Python's collector of circular garbage, kept from running while much is built that stays."""

from __future__ import annotations

import gc
from contextlib import ContextDecorator


class paused(ContextDecorator):
    """No search for circular garbage inside; as a decorator, none during a call.

    The collector searches whenever there are a quarter more objects than at its last full search. While a large
    diagram is read and planned nearly all of them stay, and the searches take as long as the work itself. Only the
    search waits: what nothing refers to is freed at once, as ever. A collector that is off stays off.
    """

    def _recreate_cm(self) -> paused:
        return paused()  # calls nest, and threads may make them at once

    def __enter__(self) -> None:
        self._runs = gc.isenabled()
        try:
            gc.disable()
        except BaseException:  # Ctrl-C comes at the end of a call
            self.__exit__()
            raise

    def __exit__(self, *raised: object) -> None:
        if self._runs:
            gc.enable()
