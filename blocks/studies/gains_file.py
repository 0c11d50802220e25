"""Tuned values written into the files of a diagram, by edits on their texts."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..editing import tree
from ..editing.applying import edit_file
from ..editing.edits import Edit, Workspace
from ..editing.spots import spot_of
from ..model.document import loads
from ..model.flatten import Flat, flatten
from ..model.resolver import resolver_of
from ..text.errors import Fault, ModelError, UsageError
from ..text.printable import legible
from ..text.shown import Shown
from ..text.units import to_si

if TYPE_CHECKING:
    from ..api.diagram import Diagram

__all__ = ["Found", "changes", "written"]

CLOSE = 1e-12
"""By how much a value may be off, which is written in another unit, with 13 digits."""


@dataclass(frozen=True, repr=False, kw_only=True)
class Found(Shown):
    """What a tuning and a fit have found.

    values: by parameter, pattern or element of `over`, in its unit (units); nominal: those of the diagram. parameters:
    the same as `Diagram.run(parameters=...)` takes them. targets: the parameters that each of them sets.
    """

    diagram: Diagram
    values: Mapping[str, float]
    nominal: Mapping[str, float]
    units: Mapping[str, str]
    parameters: Mapping[str, Any]
    targets: Mapping[str, tuple[str, ...]]
    warnings: tuple[Fault, ...] = ()

    def write(self, path: str | Path) -> Edit:
        """Put the values into the diagram file `path`, from which the diagram was loaded, or a copy of it.

        Only the characters of the values change, in this file and in those of the subdiagrams that hold some of them;
        they are written all or none. The result lists what changed (`changes`) and takes it back (`undone.write()`).
        Raises UsageError (E501) where the file would not give the diagram with these values then, as for wheels that
        share one file and have got different values.
        """
        edit = written(self, path)
        edit.write()
        return edit


def written(found: Found, path: str | Path) -> Edit:
    """The edit that gives a diagram file the values of a tuning; nothing is written yet.

    Raises UsageError (E501) where the file would not give the tuned diagram: where two blocks share a file and have got
    different values, or where it is another file.
    """
    library = tuple(found.diagram._draft.types.values())
    workspace, first = Workspace.of(path, library)
    operations: dict[Any, dict[str, Any]] = {}
    for column, targets in found.targets.items():
        element = [int(k) for k in re.findall(r"\d+", column.partition("[")[2])]
        for target in targets if found.parameters else ():
            scope, place, entry = _place(workspace, first, target)
            place, to = _new(entry, place, element, found.values[column], found.units[column])
            if to is None:
                raw = found.parameters[target]
                to = raw["value"] if isinstance(raw, Mapping) and not raw.get("unit") else raw
            operations[scope, place] = {"set": [*place], "to": to} | ({"in": scope} if scope else {})
    edit = edit_file(path, list(operations.values()), library=library, check=False)
    _check(found, path, edit)
    return edit


def _place(workspace: Workspace, first: str, target: str) -> tuple[str, tuple[str | int, ...], Any]:
    """The subdiagram that holds a parameter, by its path; the steps to it there; and its entry, None where none is."""
    *blocks, name = target.split(".")
    if not blocks:
        place: tuple[str | int, ...] = ("parameters", name)
        return "", place, tree.table_at(workspace.value(first), ("parameters",)).get(name)
    scope = ".".join(blocks[:-1])
    spot = spot_of(workspace, first, {"in": scope} if scope else {})
    entry = spot.body.names("block").get(blocks[-1], {})
    variant = entry.get("variant", "base")
    place = ("blocks", blocks[-1], *(("variants", variant) if variant != "base" else ()), "parameters")
    return scope, (*place, name), tree.table_at(spot.value, (*spot.scope, *place)).get(name)


def _new(
    entry: Any, place: tuple[str | int, ...], element: list[int], value: float, unit: str
) -> tuple[tuple[str | int, ...], Any]:
    """The steps to the number of an entry that changes, and what it becomes, in the unit that stands there.

    None for the number where the file has no list with the element: then the whole value is written.
    """
    if isinstance(entry, Mapping):
        there = str(entry.get("unit", unit))
        entry, place = entry.get("value"), (*place, "value")
        if there != unit:
            value = float(f"{value * (to_si(1.0, unit) / to_si(1.0, there)):.13g}")
    for index in element:
        if not isinstance(entry, list):
            return place, None
        entry, place = entry[index], (*place, index)
    return place, value


def _check(found: Found, path: str | Path, edit: Edit) -> None:
    """Refuse an edit that changes other values than the tuning did, or to others. Raises UsageError (E501)."""
    texts = {os.path.realpath(name): text for name, text in edit.texts.items()}
    real = os.path.realpath(path)
    resolver = resolver_of(dict(found.diagram._draft.types))

    def read(texts: Mapping[str, str]) -> Flat:
        text = texts.get(real) or Path(real).read_text(encoding="utf-8")
        return flatten(loads(text, file=str(path), folder=os.path.dirname(real), texts=texts), resolver)

    try:
        before, after = read({}), read(texts)
    except ModelError as error:
        raise UsageError(*error.faults) from error
    made = changes(before, after)
    meant = changes(found.diagram.flatten(), found.diagram.flatten(parameters=found.parameters))
    names = {**made, **meant}
    wrong = [name for name in names if not ({name} <= made.keys() & meant.keys() and _same(made[name], meant[name]))]
    if wrong:
        message = f"the file would not give the tuned diagram: {', '.join(map(legible, wrong[:5]))}."
        cure = (
            "Blocks that share a file have one value there: tune them by one pattern. Give the file that the diagram "
            "was loaded from; or use run(parameters=tuning.parameters)."
        )
        raise UsageError(Fault("E501", str(path), message, cure))


def changes(before: Flat, after: Flat) -> dict[str, Any]:
    """The values of parameters of blocks that differ, in SI."""
    known = {block.path: block.resolved.values for block in before.blocks}
    return {
        f"{block.path}.{name}": value.value
        for block in after.blocks
        for name, value in block.resolved.values.items()
        if not _same(known.get(block.path, {}).get(name), value, 0.0)
    }


def _same(a: Any, b: Any, close: float = CLOSE) -> bool:
    a, b = getattr(a, "value", a), getattr(b, "value", b)
    try:
        first, second = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
        return bool(np.allclose(first, second, rtol=close, atol=0.0, equal_nan=True))
    except (TypeError, ValueError):
        return bool(np.array_equal(a, b))
