"""How far a long call is, in a notebook: a line below its cell that is replaced, and gone at the end."""

from __future__ import annotations

import html
import multiprocessing
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

SOON, AGAIN = 0.5, 0.2  # s until it is first shown, and between two of it
Told = Callable[..., None]


def live_line(given: Told | None, words: Callable[..., tuple[float, str]]) -> AbstractContextManager[Told | None]:
    """What a long call is to report to: `given`, where a caller gave it; in a notebook a line; else None.

    words: of what is reported, the share that is done, from 0 to 1, and how far it is in words.
    """
    return nullcontext(given) if given is not None or not _in_notebook() else _Line(words)


def in_rows(noun: str) -> Callable[[int, int], tuple[float, str]]:
    """Words for how many of all are done."""
    return lambda done, total: (done / max(total, 1), f"{done} of {total} {noun}")


def _in_notebook() -> bool:
    """Whether this is the main thread of a kernel, where the output of the cell is that of this call."""
    if "ipykernel" not in sys.modules or threading.current_thread() is not threading.main_thread():
        return False
    if multiprocessing.parent_process() is not None:
        return False
    return hasattr(sys.modules["IPython"].get_ipython(), "kernel")


class _Line:
    handle: Any = None

    def __init__(self, words: Callable[..., tuple[float, str]]) -> None:
        self.words = words
        self.begun = time.perf_counter()
        self.due = self.begun + SOON

    def __enter__(self) -> _Line:
        return self

    def __exit__(self, *raised: object) -> None:
        if self.handle is not None:
            self.show({"text/plain": "", "text/html": ""})

    def __call__(self, *told: object) -> None:
        now = time.perf_counter()
        if now < self.due:
            return
        self.due = now + AGAIN
        share, text = self.words(*told)
        left = (now - self.begun) * (1 / share - 1) if share > 0 else 0.0
        text = f"{share:.0%}  {text}" + (f"  {left:.0f} s left" if left >= 1 else "")
        bar = f'<progress max="1" value="{share:.3f}"></progress>'
        self.show({"text/plain": text, "text/html": f"{bar} {html.escape(text)}"})

    def show(self, forms: dict[str, str]) -> None:
        if self.handle is None:
            self.handle = sys.modules["IPython"].display.display(forms, raw=True, display_id=True)
        else:
            self.handle.update(forms, raw=True)
