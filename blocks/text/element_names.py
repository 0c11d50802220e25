"""The names of the elements of a signal: u[0], u[1] of a vector, M[0,1] of a matrix."""

from __future__ import annotations

import re

import numpy as np

__all__ = ["element_names", "indexed"]

_INDEX = re.compile(r"(.*)\[(0|[1-9][0-9]{0,6})\]\Z", re.DOTALL)


def element_names(name: str, shape: tuple[int, ...]) -> list[str]:
    """The names of all elements of a signal in C order: u[0], u[1] of a vector, M[0,1] of a matrix."""
    return [f"{name}[{','.join(map(str, i))}]" for i in np.ndindex(shape)] if shape else [name]


def indexed(text: str) -> tuple[str, int | None]:
    """A signal's text and the element that it names: "z[0]" -> ("z", 0). An element has one spelling only."""
    match = _INDEX.match(text) if text.endswith("]") else None
    return (match[1], int(match[2])) if match else (text, None)
