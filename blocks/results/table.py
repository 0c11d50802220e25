"""What result files hold: times, values, names and units, and what is known about the run; and how they are refused."""

from __future__ import annotations

import importlib
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..text.arrays import Array
from ..text.element_names import element_names
from ..text.errors import Fault, UsageError
from ..text.printable import legible

VERSION = 1
TIMES = ("time", "t")


@dataclass(frozen=True)
class FileTable:
    """What a file holds. columns: name -> first column of `values`, shape, unit, as in Results."""

    t: Array  # (rows,)
    values: Any  # (rows, elements), or the `Stored` rows of a file
    columns: Mapping[str, tuple[int, tuple[int, ...], str]]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def named(self) -> list[tuple[str, str, int]]:
        """(name, unit, column of values) of every recorded element."""
        elements = []
        for name, (first, shape, unit) in self.columns.items():
            elements += [(element, unit, first + i) for i, element in enumerate(element_names(name, shape))]
        return elements

    def elements(self) -> list[tuple[str, str, Array]]:
        """(name, unit, values of shape (rows,)) of every recorded element."""
        return [(name, unit, self.values[:, column]) for name, unit, column in self.named()]

    def described(self) -> dict[str, Any]:
        """The metadata with units by signal and the sizes of vectors, which the columns do not give."""
        sizes = {name: math.prod(shape) for name, (_, shape, _) in self.columns.items() if shape}
        units = {name: unit for name, (_, _, unit) in self.columns.items()}
        return {**self.metadata, "units": units, **({"sizes": sizes} if sizes else {})}


def optional(name: str, place: str, extra: str = "tables", *, otherwise: str = "") -> Any:
    """A package that is not needed otherwise. Raises UsageError (E504) where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        cure = f'Install it: pip install {name}; or in a clone of blocks: pip install -e ".[{extra}]". {otherwise}'
        message = f"this needs the package {name}, which is not installed."
        raise UsageError(Fault("E504", place, message, cure.strip())) from None


def versioned(described: Mapping[str, object]) -> dict[str, object]:
    return {"format": "blocks results", "version": VERSION, **described}


def unique(names: Iterable[str], *, longest: int) -> list[str]:
    taken: dict[str, None] = {}
    for name in names:
        text, count = name[:longest], 1
        while text in taken:
            count += 1
            text = f"{name[: longest - len(str(count)) - 1]}_{count}"
        taken[text] = None
    return list(taken)


Content = tuple[list[str], Array, dict[str, str], Mapping[str, Any]]
"""Names of elements, time and their values (rows, 1 + elements), units that the columns give, metadata."""
Refuse = Callable[..., UsageError]


def sizes_of(metadata: Mapping[str, Any], refuse: Refuse) -> tuple[dict[str, str], dict[str, int]]:
    units, sizes = metadata.get("units", {}), metadata.get("sizes", {})
    for key, table, kind in (("units", units, str), ("sizes", sizes, int)):
        if not isinstance(table, Mapping) or not all(type(value) is kind for value in table.values()):
            message = f"its entry {key} does not have the form that blocks writes."
            raise refuse(message, f"Correct or remove the entry {key}.")
    return dict(units), dict(sizes)


def columns_of(
    names: Sequence[str], own: Mapping[str, str], units: Mapping[str, str], sizes: Mapping[str, int]
) -> dict[str, tuple[int, tuple[int, ...], str]]:
    """Elements that belong to a vector are joined, where all of them stand beside each other."""
    columns: dict[str, tuple[int, tuple[int, ...], str]] = {}
    at = 0
    while at < len(names):
        name = names[at]
        base = name.removesuffix("[0]")
        size = sizes.get(base, 0) if base != name else 0
        if 0 < size <= len(names) - at and list(names[at : at + size]) == [f"{base}[{i}]" for i in range(size)]:
            columns[base] = (at, (size,), own.get(name) or units.get(base, ""))
            at += size
            continue
        unit = own.get(name) or units.get(name) or units.get(name.partition("[")[0], "")
        columns[name] = (at, (), unit)
        at += 1
    return columns


def without_twins(names: list[str], refuse: Refuse) -> list[str]:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise refuse(f"has two columns with the name {legible(name)!r}.")
        seen.add(name)
    return names


def parsed(text: str | bytes, refuse: Refuse) -> dict[str, object]:
    try:
        metadata = json.loads(text)
    except ValueError:
        metadata = None
    if not isinstance(metadata, dict):
        raise refuse("its metadata do not have the form that blocks writes.")
    return metadata


def refusal(place: object, code: str = "E503", before: str = "", otherwise: str = "") -> Refuse:
    """Return what makes the errors of a file: without another code, of a file that cannot be read.

    before: begins each message. otherwise: the cure of errors without their own.
    """

    def refuse(message: str, cure: str = "") -> UsageError:
        return UsageError(Fault(code, legible(str(place)), before + message, cure or otherwise))

    return refuse
