"""Operations on the files of a project: what each may say, and what the values of the files are after it.

    {"set": "blocks.pid.parameters.kp", "to": 3}        {"wire": "pid.y", "to": "motor.v"}

Every operation is an object whose first key is its name. Places are written as errors tell them (`tree.steps_of`).
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from ..model.block_types import library_types
from ..model.diagram_grammar import BODY, FILLED, NAMES, NUMBER, VARIANT
from ..model.diagram_value import FORMAT, VERSION, DiagramValue, check_name
from ..model.document import dumps_document, entries, entry_document, loads
from ..model.flatten import Flat
from ..model.resolver import resolver_of
from ..model.spreading import fitted, spread
from ..model.values import is_expression
from ..text import grammar, json_text, units
from ..text.errors import BlocksError, Fault, ModelError, UsageError
from ..text.grammar import ANY, AnyOf, Field, ListOf, Object, Scalar, Steps, Table, Text, in_words
from ..text.json_document import IN_FILES, place_of
from ..text.json_edits import same
from ..text.json_number import Number, is_number
from ..text.printable import quoted
from ..text.quantity_text import quantity_of
from . import tree
from .edits import Workspace, files_with
from .grouping import group, ungroup
from .references import SECTIONS, Kind, Reference, Target, references
from .renaming import NAMED, Renamed, same_values
from .renaming import check_name as check_new_name
from .spots import Spot, blocks_of
from .swapping import existing, swapped

_PLACE = AnyOf(
    Text(is_empty=False),
    ListOf(AnyOf(Text(), Scalar(low=0, high=1_000_000, is_whole=True), what="a key or an index"), 1),
    what='a place such as "blocks.pid", or a list of keys and indices',
)
_NAME = Text(pattern=NAMES.pattern, refusal=NAMES.refusal)
_TABLES = [replace(field, required=False) for field in BODY.fields if isinstance(field.kind, Table)]
_POSITION = ListOf(NUMBER, 2, 2, what="a position [x, y]", is_even=True)
_COMMON = (
    Field("in", FILLED, "The path of the subdiagram to edit; without it, the diagram itself."),
    Field("file", FILLED, "Another file of the project, by its path from the folder of the first file."),
)


# --- entries ---------------------------------------------------------------------------------------------------


def _add(spot: Spot, entry: Mapping[str, object]) -> None:
    steps = spot.steps(entry["add"])
    if len(steps) > len(spot.scope) and steps[-2:-1] and steps[-2] in SECTIONS.values() and isinstance(steps[-1], str):
        check_name(steps[-1])
    spot.put(tree.put_in(spot.value, steps, entry["value"], spot.name))


def _set(spot: Spot, entry: Mapping[str, object]) -> None:
    spot.put(tree.replaced(spot.value, spot.steps(entry["set"]), entry["to"], spot.name))


def _remove(spot: Spot, entry: Mapping[str, object]) -> None:
    """An entry, and all entries of the project that mean something of it; expressions keep the values of parameters."""
    workspace, steps = spot.workspace, spot.steps(entry["remove"])
    there = tree.entry_at(spot.value, steps, spot.name)
    if "was" in entry and not same(there, entry["was"]):
        now, was = (
            quoted(value[:200]) if isinstance(value, str) else in_words(value) for value in (there, entry["was"])
        )
        what = f"is now {now}, not {was}."
        raise UsageError(spot.fault("E501", place_of(steps), what, "Check the present value.", steps))
    if not steps:
        raise UsageError(spot.fault("E501", "remove", "an edit cannot remove a whole file."))
    gone: dict[str, set[Steps]] = {spot.file: {steps}}
    others: dict[str, str] = {}
    found = cache(partial(_references, workspace))  # nothing changes before all that goes is known
    while True:
        count = sum(map(len, gone.values()))
        targets = {target for file, places in gone.items() for target in _defined(found(file), file, places)}
        names = {target.name for target in targets}
        for document in () if workspace.is_alone else files_with(names, spot.file, workspace.documents):
            if isinstance(document, str):
                workspace.note = document
            else:
                others[os.path.realpath(document.file)] = document.file
        for file in (spot.file, *others):
            places = gone.setdefault(file, set())
            places |= _that_mean(workspace, file, found(file), targets, places, has_values=file == spot.file)
        if sum(map(len, gone.values())) == count:
            break
    parameters = {target for target in targets if target.kind == "parameter"}
    before = workspace.flat(spot.file) if parameters else ()
    has_values = _put_values(spot, parameters, gone[spot.file])
    for file, places in gone.items():
        if workspace.is_whole or workspace.is_named(file):
            if places:
                workspace.open(Path(others.get(file, file)))
                workspace.put(file, tree.without(workspace.value(file), places))
        else:
            workspace.tell(file, tree.without(workspace.value(file), places))
    if has_values and isinstance(before, Flat):
        after = workspace.flat(spot.file)
        if not isinstance(after, Flat) or not same_values(before, after):
            what = "is used by expressions, which would change their values without it."
            raise UsageError(spot.fault("E501", place_of(steps), what, "Change these expressions first.", steps))


def _put_values(spot: Spot, targets: set[Target], gone: set[Steps]) -> bool:
    """Put the values of parameters that go in place of their names in the expressions of their file.

    Whether there are any. What only hands on a parameter (`=k`) gets what the parameter is, with its unit; elsewhere
    its number stands in SI, as in all expressions.
    """
    values = {target: tree.entry_at(spot.value, (*target.scope, "parameters", target.name), "") for target in targets}
    has_values = False
    for _ in range(len(values)):  # one may be computed from another
        document = spot.workspace.document(spot.file)
        found = [
            reference
            for reference in references(document, spot.file, spot.workspace.documents)
            if reference.targets & targets
            and not tree.is_within(reference.path, gone)
            and _is_formula(reference, _value_at(document.value, reference))
        ]
        names: dict[Target, str] = {}
        value = document.value
        for reference in found:
            target, text = next(iter(reference.targets & targets)), _value_at(document.value, reference)
            raw = values[target]
            if text[1:].strip() == target.name and reference.path[-2] == "parameters":
                raw = {key: part for key, part in raw.items() if key != "doc"} if isinstance(raw, Mapping) else raw
                raw = raw["value"] if isinstance(raw, Mapping) and raw.keys() == {"value"} else raw
                value = tree.replaced(value, reference.path, raw)
            else:
                names[target] = _literal(spot, target, raw, reference.path)
        if not found:
            break
        has_values = True
        left = [reference for reference in found if _value_at(value, reference) == _value_at(document.value, reference)]
        spot.put(tree.with_names(value, left, names))
    return has_values


def _is_formula(reference: Reference, text: object) -> bool:
    """Return whether a text reads parameters only, in one place: an expression, or the condition that ends a run."""
    is_condition = reference.path[-1:] == ("stop_when",)
    return is_expression(text) or (is_condition and all(target.kind == "parameter" for target in reference.targets))


def _value_at(value: object, reference: Reference) -> Any:
    """The text that a reference stands in; None for a key."""
    return None if reference.is_key else tree.entry_at(value, reference.path, "")


def _literal(spot: Spot, target: Target, raw: object, path: Steps) -> str:
    """A parameter's value in an expression."""
    number, unit = quantity_of(raw)
    if isinstance(number, str) and is_expression(number) and not unit:
        return f"({number[1:].strip()})"
    try:
        si = float(number) if is_number(number) else float("nan")
        si = units.to_si(si, unit) if unit else si
    except ValueError:
        si = float("nan")
    if not math.isfinite(si):
        what = f"is used in {place_of(path)}, which cannot hold its value."
        raise UsageError(spot.fault("E501", target.name, what, "Change that expression first.", path))
    text = number.text if isinstance(number, Number) and si == number else repr(si)
    return text if si >= 0 else f"({text})"


def _references(workspace: Workspace, file: str) -> list[Reference]:
    return references(workspace.document(file), file, workspace.documents)


def _defined(found: Iterable[Reference], file: str, places: set[Steps]) -> set[Target]:
    """What is defined at some places of a file, or in what stands there. found: all references in it."""
    return {
        target
        for reference in found
        for target in reference.targets
        if target.file == file and tree.is_within((*target.scope, SECTIONS[target.kind], target.name), places)
    }


def _that_mean(
    workspace: Workspace,
    file: str,
    references_: Iterable[Reference],
    targets: set[Target],
    known: set[Steps],
    *,
    has_values: bool,
) -> set[Steps]:
    """The entries of a file with a name that means one of the targets, and nothing else.

    references_: all in it. has_values: whether expressions get the values of parameters instead.
    """
    document = workspace.document(file)
    found = set()
    for reference in references_:
        if has_values and _is_formula(reference, _value_at(document.value, reference)):
            continue
        # A claim about two runs needs the measures of both; what goes through variants means any of them.
        some = {target for target in reference.targets & targets if target.kind == "measure"}
        is_gone = some or (reference.targets and reference.targets <= targets and not reference.is_open)
        if is_gone and not tree.is_within(reference.path, known):
            place = tree.holder_of(document.value, reference.path, is_key=reference.is_key)
            if not place:
                what = f"is used in {place_of(reference.path)}, which cannot be removed alone."
                fault = Fault(
                    "E501", min(targets).name, what, "Change that entry first.", reference.path, workspace.name(file)
                )
                raise UsageError(fault.at(workspace.name(file), *document.positions[reference.path]))
            found.add(place)
    return found


def _rename(spot: Spot, entry: Mapping[str, Any]) -> None:
    """What is defined at a place, with all that refers to it; what no name refers to, as a wire, gets another key."""
    workspace, steps, new = spot.workspace, spot.steps(entry["rename"]), entry["to"]
    tree.entry_at(spot.value, steps, spot.name)
    kind = next((kind for kind, section in SECTIONS.items() if steps[-2:-1] == (section,)), None)
    target = None if kind is None else Target(spot.file, steps[:-2], kind, str(steps[-1]))
    if target is None or target not in _defined(_references(workspace, spot.file), spot.file, {steps}):
        if not isinstance(steps[-1], str):
            raise UsageError(spot.fault("E501", place_of(steps), "has no name.", "Set another value."))
        around = tree.entry_at(spot.value, steps[:-1], spot.name)
        if new in around:
            raise ModelError(spot.fault("E109", new, "exists already.", "Choose another name.", steps[:-1]))
        return spot.put(tree.with_key(spot.value, steps, new))
    check_new_name(new)
    prefix = "".join(f"{step}." for step in blocks_of(target.scope))
    renamed = Renamed(
        workspace, spot.file, frozenset({target}), new, target.name, prefix, is_looking=spot.file in workspace.names
    )
    replaced = renamed.checked(whole=workspace.is_whole)
    for edit in replaced:
        workspace.changes += edit.changes()
        workspace.take(workspace.open(Path(edit.real)), edit.after)
    workspace.elsewhere += [change for edit in renamed.others if edit not in replaced for change in edit.changes()]
    workspace.note = workspace.note or renamed.note


# --- wires and positions ---------------------------------------------------------------------------------------


def _wire(spot: Spot, entry: Mapping[str, Any]) -> None:
    source, sink = entry["wire"], entry["to"]
    body = spot.body
    readable = [*body.names("block"), *body.names("input"), *body.names("parameter")]
    first = re.split(r"[.\[]", source, maxsplit=1)[0]
    if first not in readable:
        raise spot.missing("block or input", first, readable)
    block, dot, _ = sink.partition(".")
    if block not in body.names("block"):
        raise spot.missing("block", block, body.names("block"))
    if not dot:
        cure = f'Name the input: {{"wire": {quoted(source)}, "to": "{block}.PORT"}}.'
        raise UsageError(spot.fault("E501", sink, "is a block, but a wire ends at an input of a block.", cure))
    given: dict[str, object] = {}
    with suppress(BlocksError):  # the file has other faults
        value, resolver = _diagram_of(spot), resolver_of(library_types(spot.workspace.library))
        sink, source = fitted(value, sink, source, resolver)
        given = {name: entry.copies for name, entry in spread(value, sink, source, resolver).items()}
    wires = tree.table_at(spot.value, (*spot.scope, "wires"))
    if sink in wires:
        cure = f'Unwire it first: {{"unwire": {quoted(sink)}}}.'
        raise ModelError(spot.fault("E109", sink, f"is already driven by {quoted(str(wires[sink]))}.", cure))
    new = tree.replaced(spot.value, (*spot.scope, "wires", sink), source)
    for name, copies in given.items():
        new = tree.replaced(new, (*spot.scope, "blocks", name, "copies"), copies)
    spot.put(new)


def _diagram_of(spot: Spot) -> DiagramValue:
    """Return the diagram that the operation is about. Raises ModelError with the faults of the file."""
    folder = os.path.dirname(os.path.abspath(spot.file))
    value = loads(spot.workspace.document(spot.file).text, file=spot.name, folder=folder, times=IN_FILES)
    for block in blocks_of(spot.scope):
        inner = value.blocks[block].inner
        assert inner is not None
        value = inner
    return value


def _unwire(spot: Spot, entry: Mapping[str, Any]) -> None:
    sink, path = entry["unwire"], (*spot.scope, "wires")
    wires = tree.table_at(spot.value, path)
    if sink not in wires:
        raise spot.missing("wire to", sink, wires)
    spot.put(tree.without(spot.value, [(*path, sink)]))


def _move(spot: Spot, entry: Mapping[str, Any]) -> None:
    name, body = entry["move"], spot.body
    known = [*body.names("block"), *body.names("input"), *body.names("output")]
    if name not in known:
        raise spot.missing("block, input or output", name, known)
    spot.put(tree.replaced(spot.value, (*spot.scope, "layout", name), entry["to"]))


# --- several blocks --------------------------------------------------------------------------------------------


def _swap(spot: Spot, entry: Mapping[str, Any]) -> None:
    """Another block as one more variant, which is chosen, as `Diagram.swap` does it."""
    name, workspace = entry["swap"], spot.workspace
    spot.whole()
    value = _diagram_of(spot)
    existing(value, name)
    other = entries(folder=os.path.dirname(os.path.abspath(spot.file)), blocks={name: entry["for"]}).blocks[name]
    resolver = resolver_of(library_types(workspace.library))
    try:
        changed, _ = swapped(value, name, other, resolver, variant=entry.get("as", ""), ports=entry.get("ports"))
    except ModelError as error:
        words = {"variant=...": '"as": ...', "ports={...}": '"ports": {...}'}
        faults = []
        for fault in error.faults:
            cure = re.sub(r"variant=\.\.\.|ports=\{\.\.\.\}", lambda match: words[match[0]], fault.cure)
            faults.append(replace(fault, cure=cure, file=fault.file or spot.name))
        raise ModelError(*faults) from None
    document, path = entry_document(changed), (*spot.scope, "blocks", name)
    new = tree.replaced(spot.value, (*path, "variant"), document["variant"])
    chosen = document["variant"]
    spot.put(tree.replaced(new, (*path, "variants", chosen), document["variants"][chosen]))


def _paste(spot: Spot, entry: Mapping[str, Any]) -> None:
    """Entries of another diagram; where a name is taken, they get another one, and so does what refers to it there."""
    spot.whole()
    value = spot.value
    taken = {name for kind in NAMED for name in spot.body.names(kind)}
    fragment = {"format": FORMAT, "version": VERSION, **entry["paste"]}
    fragment = _with_free_names(spot, fragment, taken)
    dx, dy = entry.get("by", (0, 0))
    for section in (field.key for field in _TABLES):
        for name, added in fragment.get(section, {}).items():
            path = (*spot.scope, section, name)
            there = tree.table_at(value, path[:-1])
            if section == "layout" and (dx or dy):
                added = [_plain(added[0] + dx), _plain(added[1] + dy)]
            if name in there and section in ("inputs", "parameters", "layout"):
                continue  # it is shared
            value = tree.put_in(value, path, added, spot.name)
    spot.put(value)


def _plain(number: float) -> float:
    return int(number) if number.is_integer() else number


def _with_free_names(spot: Spot, fragment: dict[str, Any], taken: set[str]) -> dict[str, Any]:
    """A diagram whose blocks and parameters have other names than those that are taken."""
    workspace = spot.workspace
    real = f"{spot.file}: pasted"
    there = spot.body
    kinds: tuple[Kind, ...] = ("block", "parameter", "input", "output", "measure")
    for kind in kinds:
        section = SECTIONS[kind]
        for name, added in list(fragment.get(section, {}).items()):
            is_shared = kind in ("input", "parameter") and there.names(kind).get(name) == added
            if is_shared or name not in (there.names(kind) if kind == "measure" else taken):
                continue
            own = {key for part in ("blocks", "inputs", "parameters", "outputs") for key in fragment.get(part, {})}
            count = 2
            while f"{name}_{count}" in taken | own:
                count += 1
            document = json_text.read(dumps_document(fragment), file="<pasted>")
            workspace.documents.known[real] = document
            target = Target(real, (), kind, name)
            found = references(document, real, workspace.documents)
            fragment = tree.with_names(document.value, found, {target: f"{name}_{count}"})
    workspace.documents.known.pop(real, None)
    return fragment


@dataclass(frozen=True)
class Operation:
    """What an operation may say, and what it does."""

    kind: Object
    apply: Callable[[Spot, Mapping[str, Any]], None]


def _operation(apply: Callable[[Spot, Mapping[str, Any]], None], doc: str, *fields: Field) -> Operation:
    first = fields[0]
    return Operation(Object(*fields, *_COMMON, by=first.key, name=first.key, doc=doc), apply)


def _needed(key: str, kind: grammar.Kind, doc: str) -> Field:
    return Field(key, kind, doc, required=True)


OPERATIONS: Mapping[str, Operation] = {
    operation.kind.fields[0].key: operation
    for operation in (
        _operation(
            _add, "Add an entry: under an unused name, or in a list at its end or before the entry with an index.",
            _needed("add", _PLACE, "The place of the entry."), _needed("value", ANY, "The entry."),
        ),
        _operation(
            _set, "Change the value of an entry, or add an entry.",
            _needed("set", _PLACE, "The place of the entry."), _needed("to", ANY, "The value."),
        ),
        _operation(
            _remove, "Remove an entry and everything that refers to it: wires, outputs, log, measures, positions.",
            _needed("remove", _PLACE, "The place of the entry."),
            Field("was", ANY, "The expected entry: if another entry is there, because a list has changed, it stays."),
        ),
        _operation(
            _rename, "Rename an entry, and everything that refers to it.",
            _needed("rename", _PLACE, "The place of the entry."), _needed("to", FILLED, "The new name."),
        ),
        _operation(
            _wire, "Add a wire from a source to an input that has none.",
            _needed("wire", FILLED, 'The source, such as "pid.y".'),
            _needed("to", FILLED, 'The input, such as "motor.v".'),
        ),
        _operation(_unwire, "Remove a wire.", _needed("unwire", FILLED, 'The input, such as "motor.v".')),
        _operation(
            _move, "Move a block, an input or an output in drawings.",
            _needed("move", FILLED, "Its name."), _needed("to", _POSITION, "[x, y] in pixels, to the right and down."),
        ),
        _operation(
            group, "Make a subdiagram of blocks, with inputs, outputs and parameters for everything that "
                "crosses its edge.",
            _needed("group", ListOf(FILLED, 1, what="a list of names of blocks"), "The blocks."),
            _needed("as", _NAME, "The name of the subdiagram."),
        ),
        _operation(
            ungroup, "Replace a subdiagram inside the file by its blocks.",
            _needed("ungroup", FILLED, "The subdiagram."),
        ),
        _operation(
            _swap, "Add another block as a variant of a block, and choose it; wires and values stay.",
            _needed("swap", FILLED, "The block."),
            _needed("for", VARIANT, 'The other block, such as {"fmu": "motor.fmu"}.'),
            Field("as", _NAME, "The name of the variant."),
            Field("ports", Table(Text()), "Ports with different names: from ports of the block to ports of the "
                "other block."),
        ),
        _operation(
            _paste, "Add entries of a diagram: blocks, wires, positions, parameters, inputs, outputs and measures.",
            _needed("paste", Object(*_TABLES), "The sections with the entries."),
            Field("by", _POSITION, "The distance [x, y] by which positions are moved."),
        ),
    )
}  # fmt: skip
"""All operations by their names."""
