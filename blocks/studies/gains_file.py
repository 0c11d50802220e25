"""Values of parameters written into the files of a diagram, by edits on their texts."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..editing import tree
from ..editing.applying import edit_file
from ..editing.edits import Edit, Workspace
from ..editing.spots import Spot
from ..model.diagram_value import BASE
from ..model.document import loads
from ..model.flatten import Flat, flatten
from ..model.resolver import resolver_of
from ..model.variants import taken
from ..text.errors import Fault, ModelError, UsageError
from ..text.grammar import Steps
from ..text.json_document import IN_FILES
from ..text.printable import legible
from ..text.units import converted

if TYPE_CHECKING:
    from ..api.diagram import Diagram

_GIVE_THE_FILE = "Give the file that the diagram was loaded from, or pass the values to run(parameters=...)."
CLOSE = 1e-12
"""By how much a value may be off, which is written in another unit, with 13 digits."""


class Value(NamedTuple):
    """What a parameter gets, or an element of it.

    unit: that of the value; None: as the file has it. raw: the whole value of the parameter, as a run is given it.
    """

    path: str
    element: tuple[int, ...]
    value: Any
    unit: str | None
    raw: object


def edit_of(
    diagram: Diagram,
    path: str | Path,
    values: Iterable[Value],
    *,
    parameters: Mapping[str, object],
    chosen: Mapping[str, str] | None = None,
    variants: Mapping[str, str] | None = None,
    inputs: Iterable[Value] = (),
    text: bytes | None = None,
) -> Edit:
    """The edit that gives a diagram file other values of parameters; nothing is written yet.

    parameters: the same, as a run of the diagram is given them. chosen: the variants that a run takes, in place of
    those of the file, which keeps its own choice. variants: those that the file chooses from now on. inputs: of inputs
    of the diagram, numbers in their units, which go where their values stand. text: what the file holds, in place of
    what is on the disk. Raises UsageError (E501) where the file would not give such a diagram then.
    """
    library, variants = tuple(diagram._draft.types.values()), variants or {}
    workspace, first = Workspace.of(path, library, text=text)
    chosen = _open_choices(workspace, first, chosen or {}, diagram.chosen)
    of_run = {**chosen, **variants}
    operations: dict[Any, dict[str, object]] = {}

    def put(file: str, place: Steps, to: object) -> None:
        operations[file, place] = {"set": [*place], "to": to} | ({"file": file} if file != first else {})

    for block, choice in variants.items():
        *around, name = block.split(".")
        spot = _spot(workspace, first, around, of_run)
        put(spot.file, (*spot.scope, "blocks", name, "variant"), choice)
    for given in values:
        file, place, entry = _place(workspace, first, given.path, of_run)
        put(file, *_new(entry, place, given))
    for given in inputs:
        place, entry = _input_place(workspace.value(first), given.path)
        put(first, *_new(entry, place, given))
    edit = edit_file(path, list(operations.values()), library=library, check=False, text=text)
    _check(diagram, parameters, chosen, variants, path, edit, text)
    return edit


def _open_choices(
    workspace: Workspace, first: str, chosen: Mapping[str, str], in_copy: Mapping[str, str]
) -> dict[str, str]:
    """Return the choices that the file leaves open: a copy with chosen variants may have been saved without them."""
    known: dict[str, str] = {}
    for path in sorted(chosen):
        *around, name = path.split(".")
        entry = _spot(workspace, first, around, known).body.names("block").get(name, {})
        if path not in in_copy or tree.table_at(entry, ("variants",)):
            known[path] = chosen[path]
    return known


def _spot(workspace: Workspace, first: str, blocks: Iterable[str], variants: Mapping[str, str]) -> Spot:
    """The subdiagram of these blocks, each inside the one before, in the variants that a run takes."""
    spot, path = Spot(workspace, first), ""
    for name in blocks:
        path, body = f"{path}.{name}" if path else name, spot.body
        entry = body.names("block").get(name, {})
        known = (BASE, *tree.table_at(entry, ("variants",)))
        choice = _choice(path, entry, variants)
        inner = body.inside(name, workspace.documents)[known.index(choice)][0] if choice in known else None
        if inner is None:
            raise UsageError(Fault("E501", legible(path), "is not a diagram in the file.", _GIVE_THE_FILE))
        spot = Spot(workspace, workspace.open(Path(inner.file)), inner.scope)
    return spot


def _choice(path: str, entry: Mapping[str, object], variants: Mapping[str, str]) -> str:
    """The variant of a block that a run takes."""
    return str(variants.get(path, entry.get("variant", BASE)) or BASE)


def _place(workspace: Workspace, first: str, target: str, variants: Mapping[str, str]) -> tuple[str, Steps, object]:
    """The file that holds a parameter, by its path; the steps to it there; and its entry, None where none is."""
    blocks, name = _owner(workspace, first, target.split("."), variants)
    if not blocks:
        place: Steps = ("parameters", name)
        return first, place, tree.table_at(workspace.value(first), ("parameters",)).get(name)
    if any("[" in block for block in blocks):
        cure = "Set the parameter in all copies, or write a list with a value for each copy."
        raise UsageError(
            Fault("E501", target, "belongs to one copy only, and the file holds no values for single copies.", cure)
        )
    spot = _spot(workspace, first, blocks[:-1], variants)
    variant = _choice(".".join(blocks), spot.body.names("block").get(blocks[-1], {}), variants)
    owner = ("variants", variant) if variant != BASE else ()
    place = (*spot.scope, "blocks", blocks[-1], *owner, "parameters")
    return spot.file, (*place, name), tree.table_at(spot.value, place).get(name)


def _owner(workspace: Workspace, first: str, parts: list[str], variants: Mapping[str, str]) -> tuple[list[str], str]:
    """The blocks around a parameter, and its name, which may have dots and brackets if the block is an FMU."""
    for k, name in enumerate(parts[:-1]):
        entry = _spot(workspace, first, parts[:k], variants).body.names("block").get(name)
        if entry is None:  # such as a single copy
            break
        choice = _choice(".".join(parts[: k + 1]), entry, variants)
        if "fmu" in (entry if choice == BASE else tree.table_at(entry, ("variants", choice))):
            return parts[: k + 1], ".".join(parts[k + 1 :])
    return parts[:-1], parts[-1]


def _input_place(value: object, name: str) -> tuple[Steps, object]:
    """Where the value of an input stands: in the settings of the run, or as its default; or where it can stand."""
    of_run = tree.table_at(value, ("run", "inputs"))
    entry = tree.table_at(value, ("inputs",)).get(name, {})
    if name in of_run or "default" not in entry:
        known = of_run.get(name)
        if isinstance(known, Mapping) and "value" not in known:
            message = "is a table over time in the file, and a single value would replace it."
            raise UsageError(Fault("E501", f"run.inputs.{name}", message, "Edit the file, or reset the input."))
        return ("run", "inputs", name), known
    return ("inputs", name, "default"), entry["default"]


def _new(entry: object, place: Steps, given: Value) -> tuple[Steps, object]:
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


def _check(
    diagram: Diagram,
    parameters: Mapping[str, object],
    chosen: Mapping[str, str],
    variants: Mapping[str, str],
    path: str | Path,
    edit: Edit,
    text: bytes | None,
) -> None:
    """Refuse an edit that changes other values than were given, or to others. Raises UsageError (E501)."""
    texts = {os.path.realpath(name): text for name, text in edit.texts.items()}
    real = os.path.realpath(path)
    old = Path(real).read_bytes() if text is None else text
    resolver = resolver_of(copy(diagram._draft.types))

    def read(texts: Mapping[str, str]) -> Flat:
        source = texts.get(real) or old
        value = loads(source, file=str(path), folder=os.path.dirname(real), texts=texts, times=IN_FILES)
        return flatten(taken(value, chosen), resolver)

    try:
        before, after = read({}), read(texts)
    except ModelError as error:
        raise UsageError(*error.faults) from error
    # The variants that the file chooses from now on are a change of it; those of the run alone are none.
    of_run = {path: choice for path, choice in chosen.items() if path not in diagram.chosen}
    meant = diagram.flatten(parameters=parameters, variants={**of_run, **variants})
    made, wanted = changes(before, after), changes(diagram.flatten(variants=of_run), meant)
    names = {**made, **wanted}
    wrong = [n for n in names if not ({n} <= made.keys() & wanted.keys() and _same(made[n], wanted[n]))]
    if wrong:
        message = f"the file cannot store these values: {', '.join(map(legible, wrong[:5]))}."
        cure = (
            "Blocks that share a file share its values: give all of them the same value, or tune them by one pattern. "
        )
        raise UsageError(Fault("E501", str(path), message, cure + _GIVE_THE_FILE))


def changes(before: Flat, after: Flat) -> dict[str, object]:
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
