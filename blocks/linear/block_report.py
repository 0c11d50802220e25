"""How blocks came into a linear model."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["BlockReport"]


@dataclass(frozen=True, slots=True)
class BlockReport:
    """How one block came into a linear model.

    method: "exact", "directional derivatives", "central differences of two steps", "describing function, A = ...",
    "override". smoothness: "smooth", or what its equations are at the point ("infinite slope of g by e", ...).
    contributes: whether a change can pass through it from the inputs to the outputs. note: what else a reader should
    know: a law that bends and was given no amplitude beside others that were; a state that does not rest.
    """

    path: str
    type: str
    method: str
    smoothness: str
    contributes: bool
    note: str = ""
