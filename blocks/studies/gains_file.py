"""Values of parameters written into the files of a diagram, by edits on their texts."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

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
from ..text.units import converted

if TYPE_CHECKING:
    from ..api.diagram import Diagram

__all__ = ["Found", "Value", "changes", "edit_of", "written"]

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


class Value(NamedTuple):
    """What a parameter gets, or an element of it.

    unit: that of the value; None: as the file has it. raw: the whole value of the parameter, as a run is given it.
    """

    path: str
    element: tuple[int, ...]
    value: Any
    unit: str | None
    raw: Any


def written(found: Found, path: str | Path) -> Edit:
    """The edit that gives a diagram file the values of a tuning; nothing is written yet.

    Raises UsageError (E501) where the file would not give the tuned diagram: where two blocks share a file and have got
    different values, or where it is another file.
    """
    values = [
        Value(
            target,
            tuple(int(k) for k in re.findall(r"\d+", column.partition("[")[2])),
            found.values[column],
            found.units[column],
            found.parameters[target],
        )
        for column, targets in found.targets.items()
        for target in (targets if found.parameters else ())
    ]
    return edit_of(found.diagram, path, values, parameters=found.parameters)


def edit_of(
    diagram: Diagram,
    path: str | Path,
    values: Iterable[Value],
    *,
    parameters: Mapping[str, Any],
    variants: Mapping[str, str] | None = None,
    inputs: Iterable[Value] = (),
    text: bytes | None = None,
) -> Edit:
    """The edit that gives a diagram file other values of parameters; nothing is written yet.

    parameters: the same, as a run of the diagram is given them. variants: those that the file chooses then. inputs: of
    inputs of the diagram, numbers in their units, which go where their values stand. text: what the file holds, in
    place of what is on the disk. Raises UsageError (E501) where the file would not give such a diagram then.
    """
    library, variants = tuple(diagram._draft.types.values()), variants or {}
    workspace, first = Workspace.of(path, library, text=text)
    operations: dict[Any, dict[str, Any]] = {}

    def put(scope: str, place: tuple[str | int, ...], to: Any) -> None:
        operations[scope, place] = {"set": [*place], "to": to} | ({"in": scope} if scope else {})

    for block, choice in variants.items():
        scope, _, name = block.rpartition(".")
        put(scope, ("blocks", name, "variant"), choice)
    for given in values:
        scope, place, entry = _place(workspace, first, given.path, variants)
        put(scope, *_new(entry, place, given))
    for given in inputs:
        place, entry = _input_place(workspace.value(first), given.path)
        put("", *_new(entry, place, given))
    edit = edit_file(path, list(operations.values()), library=library, check=False, text=text)
    _check(diagram, diagram.flatten(parameters=parameters, variants=variants), path, edit, text)
    return edit


def _place(
    workspace: Workspace, first: str, target: str, variants: Mapping[str, str]
) -> tuple[str, tuple[str | int, ...], Any]:
    """The subdiagram that holds a parameter, by its path; the steps to it there; and its entry, None where none is."""
    *blocks, name = target.split(".")
    if not blocks:
        place: tuple[str | int, ...] = ("parameters", name)
        return "", place, tree.table_at(workspace.value(first), ("parameters",)).get(name)
    if any("[" in block for block in blocks):
        cure = "Set it in all copies, or write a list with a value for each."
        raise UsageError(Fault("E501", target, "is of one copy, for which the file has no place.", cure))
    scope = ".".join(blocks[:-1])
    spot = spot_of(workspace, first, {"in": scope} if scope else {})
    entry = spot.body.names("block").get(blocks[-1], {})
    variant = variants.get(".".join(blocks), entry.get("variant", "base"))
    place = ("blocks", blocks[-1], *(("variants", variant) if variant != "base" else ()), "parameters")
    return scope, (*place, name), tree.table_at(spot.value, (*spot.scope, *place)).get(name)


def _input_place(value: Any, name: str) -> tuple[tuple[str | int, ...], Any]:
    """Where the value of an input stands: in the settings of the run, or as its default; or where it can stand."""
    of_run = tree.table_at(value, ("run", "inputs"))
    entry = tree.table_at(value, ("inputs",)).get(name, {})
    if name in of_run or "default" not in entry:
        known = of_run.get(name)
        if isinstance(known, Mapping) and "value" not in known:
            message = "is a table over time in the file, which one value would replace."
            raise UsageError(Fault("E501", f"run.inputs.{name}", message, "Edit the file, or reset the input."))
        return ("run", "inputs", name), known
    return ("inputs", name, "default"), entry["default"]


def _new(entry: Any, place: tuple[str | int, ...], given: Value) -> tuple[tuple[str | int, ...], Any]:
    """The steps to what changes of an entry, and what it becomes: a number in the unit that stands there.

    The whole raw value where the entry has no list with the element, or no number, or no unit to keep.
    """
    raw, value, around = given.raw, given.value, place
    whole = raw["value"] if isinstance(raw, Mapping) and not raw.get("unit") else raw
    if isinstance(entry, Mapping) and "value" in entry:
        there = str(entry.get("unit", given.unit))
        entry, place = entry.get("value"), (*place, "value")
        if given.unit is not None and there != given.unit:
            value = _in_unit(value, given.unit, there)
    elif isinstance(entry, Mapping) or (isinstance(raw, Mapping) and not given.element):
        return place, whole
    for index in given.element:
        if not isinstance(entry, list):
            return around, whole
        entry, place = entry[index], (*place, index)
    return place, value


def _in_unit(value: Any, unit: str, wanted: str) -> Any:
    """Numbers in another unit."""
    if isinstance(value, (list, tuple)):
        return [_in_unit(item, unit, wanted) for item in value]
    number = float(f"{converted(value, unit, wanted):.13g}")
    return int(number) if number.is_integer() and abs(number) < 1e13 else number


def _check(diagram: Diagram, meant: Flat, path: str | Path, edit: Edit, text: bytes | None) -> None:
    """Refuse an edit that changes other values than were given, or to others. Raises UsageError (E501)."""
    texts = {os.path.realpath(name): text for name, text in edit.texts.items()}
    real = os.path.realpath(path)
    old = Path(real).read_bytes() if text is None else text
    resolver = resolver_of(dict(diagram._draft.types))

    def read(texts: Mapping[str, str]) -> Flat:
        source = texts.get(real) or old
        return flatten(loads(source, file=str(path), folder=os.path.dirname(real), texts=texts), resolver)

    try:
        before, after = read({}), read(texts)
    except ModelError as error:
        raise UsageError(*error.faults) from error
    made, wanted = changes(before, after), changes(diagram.flatten(), meant)
    names = {**made, **wanted}
    wrong = [n for n in names if not ({n} <= made.keys() & wanted.keys() and _same(made[n], wanted[n]))]
    if wrong:
        message = f"the file would not give the diagram with these values: {', '.join(map(legible, wrong[:5]))}."
        cure = (
            "Blocks that share a file have one value there: change all of them alike, or tune them by one pattern. "
            "Give the file that the diagram was loaded from; or give the values to run(parameters=...)."
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
