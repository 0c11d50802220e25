"""The names of the elements of a signal: u[0], u[1] of a vector, M[0,1] of a matrix; and patterns of names."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable
from itertools import product

_NAME = re.compile(r"(.*)\[([A-Za-z_][A-Za-z0-9_]*)\]\Z", re.DOTALL)
_INDEX = re.compile(r"(.*)\[(0|[1-9][0-9]{0,6})\]\Z", re.DOTALL)


def element_names(name: str, shape: tuple[int, ...]) -> list[str]:
    """The names of all elements of a signal in C order: u[0], u[1] of a vector, M[0,1] of a matrix."""
    return [f"{name}[{','.join(map(str, i))}]" for i in product(*map(range, shape))] if shape else [name]


def indexed(text: str) -> tuple[str, int | None]:
    """A signal's text and the element that it names: "z[0]" -> ("z", 0). An element has one spelling only."""
    match = _INDEX.match(text) if text.endswith("]") else None
    return (match[1], int(match[2])) if match else (text, None)


def named_element(text: str) -> tuple[str, str]:
    """A signal's text and the name of the element that it names: "pose.y[theta]" -> ("pose.y", "theta"), else ""."""
    match = _NAME.match(text) if text.endswith("]") else None
    return (match[1], match[2]) if match else (text, "")


def whole_of(path: str, known: Container[str]) -> str:
    """Return the longest beginning of a path that is known: the block that holds a signal or a part; "" if none is."""
    while path and path not in known:
        path = path.rpartition(".")[0]
    return path


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    """The names that a pattern names; * stands for a part of one name between dots: "motor_*.omega"."""
    form = re.compile("[^.]*".join(map(re.escape, pattern.split("*"))))
    return [name for name in names if form.fullmatch(name)]
