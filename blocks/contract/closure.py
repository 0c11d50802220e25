"""Everything that is reached from somewhere along the arrows of a graph."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from typing import TypeVar

T = TypeVar("T", bound=Hashable)


def closure(begin: Iterable[T], following: Callable[[T], Iterable[T]]) -> set[T]:
    """Return all that can be reached from `begin`, with `begin` itself. following: where one arrow leads."""
    reached, waiting = set[T](), list(begin)
    while waiting:
        item = waiting.pop()
        if item not in reached:
            reached.add(item)
            waiting += following(item)
    return reached
