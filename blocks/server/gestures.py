"""What a page does to a diagram that it edits: each gesture is a list of operations on its file, and a step of undo.

It is long as all gestures stand together: they share how a text that was typed is read, and how one is done and told.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import io
import os
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

from ..api.catalog import Catalog
from ..api.simulink_import import from_simulink
from ..editing.operations import OPERATIONS
from ..model.block_ports import port_units
from ..model.diagram_grammar import BODY, MEASURES
from ..model.diagram_value import BASE
from ..model.document import entries
from ..model.trust import is_trusted
from ..model.values import is_expression
from ..text import json_text, json_writer, units
from ..text.atomic_write import check_target, refused, write_atomically
from ..text.errors import BlocksError, Fault, ModelError, UsageError, did_you_mean
from ..text.json_number import is_number
from ..text.printable import legible, quoted
from ..text.quantity_text import value_in
from .editor import Editor, Operations, move
from .facts import Fact
from .following import follow, followed
from .messages import Answer, handles
from .open_document import inside
from .palette import entries_of, files_beside, is_diagram
from .session import Session

BESIDE = 30
"""Pixels between what is copied and its copy."""
ROOM = (110, 100)
"""Pixels between the centers of a copy and of what stands there, across and down."""
SECTIONS = ("parameters", "inputs", "outputs", "blocks", "wires", "measures", "layout")
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)


def _editor(session: Session) -> Editor:
    """The document. Raises UsageError (E501) where it cannot be edited."""
    if not isinstance(session.document, Editor):
        name = session.document.name
        raise UsageError(Fault("E501", name, "is open for viewing only.", "To edit it, open it with `blocks edit`."))
    return session.document


def _done(
    session: Session, what: str, operations: Operations, names: Iterable[str] = (), put: Sequence[str] = ()
) -> dict[str, Any]:  # fmt: skip
    """Do a gesture, tell all pages, and answer which names came of it, which other files changed with it, and which
    would have to (`left`). put: what was given values, by their paths.
    """
    before = followed(session)
    with _refused(session) as editor:
        edit = editor.edit(what, operations)
    files = [Path(file).name for file in edit.texts if file != str(editor.file)]
    left = sorted({change.file for change in edit.elsewhere})
    return {**_told(session, what, before, names, files, put), "left": left}


def _begun(session: Session) -> Editor:
    """The document for a gesture that changes it, as it stands on the disk."""
    with _refused(session) as editor:
        editor.begin()
    return editor


@contextmanager
def _refused(session: Session) -> Iterator[Editor]:
    """Show all pages what another program wrote, or which step is undone next, where a gesture is refused for it."""
    editor = _editor(session)
    before = editor.revision, editor.offered
    try:
        yield editor
    except BlocksError:
        if (editor.revision, editor.offered) != before or editor.is_gone:
            session.tell_document()
        raise


def _told(
    session: Session, what: str, before: Mapping[str, Fact], names: Iterable[str] = (), files: Sequence[str] = (),
    put: Sequence[str] = (),
) -> dict[str, Any]:  # fmt: skip
    later = follow(session, before, put)
    if (session.values or session.inputs) and session.document.planned is not None:
        # What is gone cannot be set in the next run.
        for known in (session.values, session.inputs):
            for name in known.keys() - session.document.facts.keys():
                del known[name]
    session.tell_document()
    return {"is": "edited", "what": what, "names": [*names], "files": [*files], "later": later}


def _in(level: str, operation: Mapping[str, object]) -> dict[str, Any]:
    return {**operation, "in": level} if level else {**operation}


@handles
def edit(session: Session, *, operations: list[dict[str, Any]], level: str = "", what: str = "") -> Answer:
    """Apply operations of `blocks apply` on a level. what: the gesture, in words."""
    for operation in operations:
        if "file" in operation or "in" in operation:
            raise UsageError(Fault("E501", "edit", "does not name the level that the page shows.", "Give the level."))
    first = next((key for key in operations[0] if key in OPERATIONS), "edit") if operations else "edit"
    return _done(session, what[:100] or first, [_in(level, operation) for operation in operations])


@handles
def undo(session: Session) -> Answer:
    """Take the last gesture back, or a change that another program wrote."""
    before = followed(session)
    with _refused(session) as editor:
        what = f"undone: {editor.undo()}"
    return _told(session, what, before)


@handles
def redo(session: Session) -> Answer:
    """Do again what was undone last."""
    before = followed(session)
    with _refused(session) as editor:
        what = f"done again: {editor.redo()}"
    return _told(session, what, before)


# --- blocks ----------------------------------------------------------------------------------------------------------


@handles
def palette(session: Session) -> Answer:
    """What can be inserted: block types by group, the diagrams and FMUs of the project."""
    editor = _editor(session)
    catalog = Catalog.of(editor.library)
    entries = [*entries_of(catalog), *files_beside(editor.file.resolve(), editor.project)]
    return {"is": "palette", "entries": entries, "measures": dict(MEASURES)}


@handles
def insert(
    session: Session, *, entry: dict[str, str], level: str = "", text: str = "", at: list[float] | None = None,
    of: str = "", source: str = "", sink: str = "",
) -> Answer:  # fmt: skip
    """Add a block: of a type, a subdiagram or an FMU.

    entry: {"type": ...}, {"diagram": ...} or {"fmu": ...}. text: its parameters as typed, "kp=20 ki=3 1/s"; a value
    alone is that of the first one. at: its place in pixels, from the center of the block or terminal `of`; left out: it
    stands where the layout puts it. source, sink: what its first free input, or its first output, is wired to.
    """
    editor = _begun(session)
    kind = next((key for key in ("type", "diagram", "fmu") if isinstance(entry.get(key), str)), None)
    if kind is None:
        raise UsageError(Fault("E501", "insert.entry", 'must have a "type", "diagram" or "fmu".'))
    body, said = editor.body(level), str(entry[kind])
    base = said if kind == "type" else Path(said).stem
    name = _free(body, re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|\W+", "_", base).lower().strip("_"))
    value: dict[str, object] = {kind: said}
    parameters = dict(_typed(text, _parameters(editor, kind, said)))
    value |= {"parameters": parameters} if parameters else {}
    operations = [_in(level, {"add": ["blocks", name], "value": value})]
    if at is not None:
        operations = [*editor.placing(level), *operations, move(level, name, _place(editor, level, of, at))]
    if source or sink:
        operations.append(_wired(editor, level, name, value, source, sink))
    return _done(session, f"insert {name}", operations, [name])


def _free(body: Mapping[str, Any], base: str) -> str:
    """A name like `base` that no block, input or parameter of a level has."""
    taken = {name for section in ("blocks", "inputs", "parameters") for name in body.get(section, {})}
    base = base if _NAME.fullmatch(base) else "block"
    others = (f"{base}{k}" for k in range(2, len(taken) + 3))
    return next(name for name in (base, *others) if name not in taken)


def _place(editor: Editor, level: str, of: str, at: Sequence[float]) -> list[int]:
    x, y = editor.positions(level).get(of, (0, 0)) if of else (0, 0)
    if len(at) != 2:
        raise UsageError(Fault("E501", "insert.at", "is not a position.", "Give [x, y]."))
    return [round((x + at[0]) / 10) * 10, round((y + at[1]) / 10) * 10]


def _parameters(editor: Editor, kind: str, said: str) -> dict[str, str]:
    """The types of the parameters of a block type, by their names in order; those of others are not known."""
    if kind != "type":
        return {}
    catalog = Catalog.of(editor.library)
    if said not in catalog.types:
        cure = did_you_mean(said[:200], catalog.types)
        raise UsageError(Fault("E103", legible(said[:200]), "there is no such block type.", cure))
    return {name: str(one.type) for name, one in catalog.types[said].declaration.settable.items()}


def _typed(text: str, known: Mapping[str, str]) -> Iterator[tuple[str, Any]]:
    """Parameters as typed, with their raw values. known: their types."""
    # "k==kp" is k with the expression "=kp", and "a == b" a part of one.
    parts = re.split(r"(?:^|(?<=\s))([A-Za-z_]\w*)(?:\s*=(?!=)\s*|=(?==\S))", text.strip())
    own = {name: type_ for name, type_ in known.items() if not re.match(r"unit(_|$)|shape$", name)}
    is_number = isinstance(value_in(parts[0]), (int, float))
    of_kind = [name for name, type_ in own.items() if (type_ == "string") != is_number]
    first = next(iter((*of_kind, *own)), "")
    for name, said in ((first, parts[0]), *zip(parts[1::2], parts[2::2], strict=True)):
        if said.strip() and not name:
            raise UsageError(
                Fault("E501", legible(said[:80]), "is a value without the name of a parameter.", 'Write "name=value".')
            )
        if said.strip():
            yield name, _raw(said, name, known.get(name, ""))


def _raw(text: str, name: str, type_: str) -> Any:
    """A typed value as a file holds it: a number, a quantity, a list, an expression, an object, or a text."""
    text = text.strip()
    if type_ == "string":
        return text
    return json_text.read(text, file=name).value if text.startswith("{") else value_in(text, file=name)


def _wired(
    editor: Editor, level: str, name: str, entry: Mapping[str, object], source: str, sink: str
) -> dict[str, object]:
    """What wires a new block of an entry to a source or a sink that is there."""
    parameters = editor.body(level).get("parameters", {})
    around = entries(folder=str(editor.folder), parameters=parameters, blocks={name: entry})
    inputs, outputs = port_units(around, name, around.blocks[name], editor.resolver)
    if (source and not inputs) or (sink and not outputs):
        what = "input" if source else "output"
        raise UsageError(Fault("E501", name, f"has no {what} to wire.", "Choose another block."))
    if source:
        return _in(level, {"wire": source, "to": f"{name}.{next(iter(inputs))}"})
    return _in(level, {"wire": f"{name}.{next(iter(outputs))}", "to": sink})


@handles
def place(session: Session, *, names: list[str], by: list[float], level: str = "") -> Answer:
    """Move blocks and terminals. The first move on a level that was laid out automatically writes all its positions."""
    editor = _begun(session)
    if len(by) != 2:
        raise UsageError(Fault("E501", "place.by", "is not a distance.", "Give [x, y]."))
    standing = editor.positions(level)
    missing = [name for name in names if name not in standing]
    if missing:
        cure = did_you_mean(missing[0], standing)
        raise UsageError(Fault("E502", legible(missing[0]), "is not in this drawing.", cure))
    moved = [move(level, name, [standing[name][0] + by[0], standing[name][1] + by[1]]) for name in names]
    what = names[0] if len(names) == 1 else f"{len(names)} blocks"
    return _done(session, f"move {what}", [*editor.placing(level), *moved], names)


@handles
def arrange(session: Session, *, names: list[str], level: str = "") -> Answer:
    """Lay out some blocks, all others stay; without names, all."""
    editor = _begun(session)
    before = editor.positions(level)
    after = editor.positions(level, names or before)
    changed = [move(level, name, at) for name, at in after.items() if not names or name in names]
    return _done(session, "lay out", [*(editor.placing(level) if names else ()), *changed], names)


@handles
def delete(session: Session, *, names: list[str], sinks: list[str], level: str = "") -> Answer:
    """Remove blocks, inputs and outputs with all that means something of them, and wires to inputs or outputs."""
    body = _begun(session).body(level)
    wires, outputs = body.get("wires", {}), body.get("outputs", {})
    operations: list[dict[str, object]] = [{"unwire": sink} for sink in dict.fromkeys(sinks) if sink in wires]
    gone = [*sinks, *(name for name in names if name not in body.get("blocks", {}))]
    operations += [{"remove": ["outputs", name]} for name in dict.fromkeys(gone) if name in outputs]
    for section in ("inputs", "blocks"):  # a parameter of this name is not in the drawing
        operations += [{"remove": [section, name]} for name in dict.fromkeys(names) if name in body.get(section, {})]
    if not operations:
        raise UsageError(Fault("E501", "delete", "the selected entries do not exist.", "Select the entries to delete."))
    what = ", ".join([*names, *sinks][:3])
    return _done(session, f"delete {what}", [_in(level, one) for one in operations])


# --- copies ----------------------------------------------------------------------------------------------------------


@handles
def copy(session: Session, *, names: list[str], level: str = "") -> Answer:
    """Blocks and terminals, with the wires between them and the parameters that they read, as text."""
    return {"is": "copied", "text": _fragment(_editor(session).body(level), names)}


def _fragment(body: Mapping[str, Any], names: Sequence[str]) -> str:
    taken: dict[str, dict[str, Any]] = {
        section: {name: entry for name, entry in body.get(section, {}).items() if name in names}
        for section in ("inputs", "outputs", "blocks", "layout")
    }
    own = {*taken["blocks"], *taken["inputs"]}
    taken["wires"] = {
        sink: source for sink, source in body.get("wires", {}).items()
        if sink.partition(".")[0] in own and re.split(r"[.\[]", source)[0] in own
    }  # fmt: skip
    taken["outputs"] = {n: source for n, source in taken["outputs"].items() if re.split(r"[.\[]", source)[0] in own}
    known, read = body.get("parameters", {}), set[str]()
    waiting = [text for part in ("blocks", "inputs") for text in _expressions(taken[part])]
    while waiting:
        new = {name for name in _NAME.findall(waiting.pop()) if name in known} - read
        read |= new
        waiting += [text for name in new for text in _expressions(known[name])]
    taken["parameters"] = {name: entry for name, entry in known.items() if name in read}
    kept = {section: taken[section] for section in SECTIONS if taken.get(section)}
    return json_writer.write(kept, one_per_line=lambda path, value: len(path) < 2)


def _expressions(value: object) -> Iterator[str]:
    if isinstance(value, Mapping):
        yield from (text for each in value.values() for text in _expressions(each))
    elif isinstance(value, list):
        yield from (text for each in value for text in _expressions(each))
    elif isinstance(value, str) and is_expression(value):
        yield value


@handles
def paste(
    session: Session, *, text: str, level: str = "", at: list[float] | None = None, of: str = ""
) -> Answer:  # fmt: skip
    """Add what was copied: entries of a diagram, or a whole one. at, of: where its upper left corner goes."""
    return _pasted(session, "paste", text, level, at, of)


@handles
def duplicate(session: Session, *, names: list[str], level: str = "") -> Answer:
    """A copy of blocks beside them."""
    return _pasted(session, "duplicate", _fragment(_begun(session).body(level), names), level, None, "")


def _pasted(session: Session, what: str, text: str, level: str, at: list[float] | None, of: str) -> Answer:
    editor = _begun(session)
    try:
        value = json_text.read(text, file="<pasted>").value
    except ModelError as error:
        cure = "Copy blocks from a diagram, or their entries from a file."
        raise UsageError(Fault("E501", what, f"the text is not JSON: {error.faults[0].message}", cure)) from None
    fields = {field.key for field in BODY.fields}
    if isinstance(value, Mapping) and not value.keys() & fields and value.keys() & {"type", "diagram", "fmu"}:
        value = {"blocks": {_free(editor.body(level), "pasted"): value}}
    found = {key: value[key] for key in SECTIONS if value.get(key)} if isinstance(value, Mapping) else {}
    if not found:
        raise UsageError(Fault("E501", what, "the text contains no part of a diagram.", "Copy some blocks first."))
    operation: dict[str, object] = {"paste": found}
    layout = found.get("layout")  # the grammar of the operation says what is wrong with it
    placed = (
        [at_ for at_ in layout.values() if isinstance(at_, list) and len(at_) == 2]
        if isinstance(layout, Mapping)
        else []
    )
    operation["by"] = _free_place(editor.positions(level) if placed else {}, placed)
    if at is not None and placed:
        with suppress(TypeError):
            x, y = _place(editor, level, of, at)
            operation["by"] = [x - min(one[0] for one in placed), y - min(one[1] for one in placed)]
    before = editor.body(level)
    placing = editor.placing(level) if placed else []
    told = _done(session, what, [*placing, _in(level, operation)])
    after = editor.body(level)
    new = {part: after.get(part, {}).keys() - before.get(part, {}).keys() for part in ("blocks", "inputs", "outputs")}
    return {**told, "names": [name for part, own in new.items() for name in after.get(part, {}) if name in own]}


def _free_place(standing: Mapping[str, Sequence[int]], copies: Sequence[Sequence[object]]) -> list[int]:
    """How far copies are moved: beside, or down to where they stand on nothing."""
    (xs, ys) = zip(*copies, strict=True) if copies else ((), ())
    if not copies or not all(isinstance(one, (int, float)) for one in (*xs, *ys)):
        return [BESIDE, BESIDE]
    wide, high = ROOM
    for dx, dy in ((BESIDE, BESIDE), *((0, dy) for dy in range(high, 100 * high, 20))):
        left, right, top, bottom = min(xs) + dx - wide, max(xs) + dx + wide, min(ys) + dy - high, max(ys) + dy + high
        if not any(left < x < right and top < y < bottom for x, y in standing.values()):
            return [dx, dy]
    return [BESIDE, BESIDE]


# --- values ----------------------------------------------------------------------------------------------------------


@handles
def put(session: Session, *, name: str, text: str | list[str | None], level: str = "") -> Answer:
    """Write a parameter of a block ("pid.kp"), or a parameter or an input of the level, as typed; "": its default.

    text: of a vector also those of its elements, each as typed; null: it stays as the file has it.

    A run that goes on takes it at once where it can, as it does with what any gesture changes; the answer says where it
    does not (`later`).
    """
    operations = [_in(level, one) for one in _puts(session, name, text, level)]
    return _set(session, [f"{level}.{name}".lstrip(".")], operations)


@handles
def put_all(session: Session, *, values: dict[str, str]) -> Answer:
    """Write several parameters, by their paths, as one step."""
    operations = []
    for path, text in values.items():
        parts = path.split(".")
        level = ".".join(parts[:-2])
        operations += [_in(level, one) for one in _puts(session, ".".join(parts[-2:]), text, level)]
    return _set(session, [*values], operations)


def _puts(session: Session, name: str, text: str | list[str | None], level: str) -> list[dict[str, Any]]:
    """Return the operations, in a level, that write a value as typed."""
    editor = _begun(session)
    body, (block, _, own) = editor.body(level), name.rpartition(".")
    type_ = ""

    def fact() -> Fact | None:  # asked for where it is needed: of many blocks that takes long
        return editor.facts.get(f"{level}.{name}".lstrip("."))

    is_empty = all(each is not None and not each.strip() for each in text)
    if block:
        if block not in body.get("blocks", {}):
            cure = did_you_mean(block, body.get("blocks", {}))
            raise UsageError(Fault("E502", legible(name[:200]), "there is no such block.", cure))
        steps = ["blocks", block, "parameters", own]
        there, path = body.get("blocks", {})[block], f"{level}.{block}".lstrip(".")
        choice = editor.variants.get(path, there.get("variant", BASE))
        if choice in there.get("variants", {}):
            steps[2:2], there = ["variants", choice], there["variants"][choice]
        known = Catalog.of(editor.library).types.get(str(there.get("type")))
        declared = {} if known is None else known.declaration.settable
        type_ = str(declared[own].type) if own in declared else ""
        is_there = own in there.get("parameters", {})
    else:
        section = next((part for part in ("parameters", "inputs") if own in body.get(part, {})), None)
        if section is None:
            raise UsageError(Fault("E502", legible(name[:200]), "there is no such parameter or input."))
        entry = body[section][own]
        steps, is_there = [section, own], True
        if section == "inputs":
            steps, is_there = [*steps, "default"], "default" in entry
        elif is_empty:
            raise UsageError(Fault("E501", legible(name[:200]), "has no default: it needs a value.", "Example: 20 V."))
        elif isinstance(entry, Mapping) and "value" in entry:
            raw = _value(text, name, "", fact, entry)
            more: Mapping[str, object] = raw if _is_quantity(raw) else {"value": raw}
            return [{"set": [*steps, key], "to": one} for key, one in more.items()]
    if is_empty:
        return [{"remove": steps}] if is_there else []
    was = there.get("parameters", {}).get(own) if block else entry.get("default") if section == "inputs" else entry
    raw = _value(text, name, type_, fact, was)
    if isinstance(text, str) and _is_quantity(raw) and (block or steps[0] == "inputs"):
        known_fact = fact()
        if known_fact is not None and raw["unit"] == known_fact.unit:
            raw = raw["value"]  # a bare number is meant in it
    return [{"set": steps, "to": raw}]


def _value(
    text: str | list[str | None], name: str, type_: str, of: Callable[[], Fact | None], was: object
) -> Any:  # fmt: skip
    """Read a typed value; that of elements is in the unit of their parameter, where they have units.

    was: the value of the file. Elements that were not typed (null) are taken from it, and its unit stays.
    """
    if isinstance(text, str):
        return _raw(text, name, type_)
    if not all(each is None or each.strip() for each in text):
        raise UsageError(Fault("E501", legible(name[:200]), "needs a value for each element.", "Example: 2 mH."))
    fact, typed = of(), {k: _raw(each, name, type_) for k, each in enumerate(text) if each is not None}
    given = [each["unit"] for each in typed.values() if _is_quantity(each)]
    kept: Any = [] if len(typed) == len(text) else was
    unit = str(kept["unit"]) if isinstance(kept, Mapping) and "unit" in kept else None
    kept = kept.get("value") if isinstance(kept, Mapping) else kept
    if fact is not None:
        if not isinstance(kept, list):  # one value for all elements, or the default
            kept, unit = fact.nominal, None
        own = fact if unit is None else replace(fact, unit=unit)
        bare = fact.unit if own.unit != fact.unit else None
        typed = {k: own.number(_with_unit(each, bare)) if _is_quantity(_with_unit(each, bare)) else each
                 for k, each in typed.items()}  # fmt: skip
    if given and (fact is None or None in typed.values()):
        needed = "numbers are needed while the diagram has faults" if fact is None else f"[{fact.unit}] is needed"
        message = f"is given in {legible(', '.join(given)[:80])}, but {needed}."
        raise UsageError(Fault("E501", legible(name[:200]), message))
    if len(typed) < len(text) and (fact is None or not isinstance(kept, list) or len(kept) != len(text)):
        raise UsageError(
            Fault("E501", legible(name[:200]), "now has other elements.", "Write the values of all elements.")
        )
    elements = [typed[k] if k in typed else kept[k] for k in range(len(text))]
    return elements if unit is None else {"value": elements, "unit": unit}


def _with_unit(raw: object, unit: str | None) -> object:
    """A number with its unit, where there is one to write."""
    return raw if unit is None or not is_number(raw) else {"value": raw, "unit": unit}


def _set(session: Session, paths: list[str], operations: Operations) -> Answer:
    """Write values, which count in place of what was set in the session."""
    what = ", ".join(".".join(path.split(".")[-2:]) for path in paths[:3])
    told = _done(session, f"set {what}", operations, put=paths)
    session.broadcast({"is": "changed"})
    return told


@handles
def define(session: Session, *, kind: str, text: str, level: str = "", source: str = "") -> Answer:
    """Add an input, an output, a parameter or a measure to a level, as typed: "r", "kp=20 V", "dip=peak of=y.u from=6".

    source: what an output shows. kind "entry": another value of an entry, by its place: "run.stop=5 s".
    """
    editor = _begun(session)
    said, _, value = (part.strip() for part in text.partition("="))
    if kind == "measure" and (typed := re.match(r"(?:(\w+)\s*=\s*)?(\w+)\s+(?=\w+\s*=)", text.strip())):
        measures = editor.body(level).get("measures", {})
        name = typed[1] or _free({"blocks": measures}, typed[2])
        doc = {key: one for key, one in measures.get(name, {}).items() if key == "doc"}  # it is not in what is typed
        measured = {"type": typed[2], **dict(_typed(text.strip()[typed.end() :], {})), **doc}
        return _done(session, f"measure {name}", [_in(level, {"set": ["measures", name], "to": measured})])
    raw: Any = _raw(value, said, "") if value else None
    if kind == "entry":
        return _done(session, f"set {said}", [_in(level, {"set": said, "to": raw})])
    sections = {"input": "inputs", "output": "outputs", "parameter": "parameters", "measure": "measures"}
    if kind not in sections:
        raise UsageError(Fault("E501", "define.kind", f"{quoted(kind)} cannot be added.", did_you_mean(kind, sections)))
    if kind == "input":
        more: Mapping[str, Any] = raw if _is_quantity(raw) else {"value": 0 if raw is None else raw}
        raw = {"default": more["value"]} | {key: one for key, one in more.items() if key == "unit"}
    elif kind == "output":
        raw = value or source
    elif raw is None:
        raise UsageError(Fault("E501", legible(said[:200]), "needs a value.", "Example: kp=20 V."))
    return _done(session, f"add {kind} {said}", [_in(level, {"add": [sections[kind], said], "value": raw})])


@handles
def describe(session: Session, *, of: str, text: str, level: str = "") -> Answer:
    """Write the doc of a block, a parameter or an input of a level, by its name; of "": that of the level."""
    body, lines = _begun(session).body(level), text.strip().splitlines()
    doc: object = lines if len(lines) > 1 else "".join(lines)
    section = next((part for part in ("blocks", "parameters", "inputs") if of in body.get(part, {})), "")
    if of and not section:
        raise UsageError(Fault("E502", legible(of[:200]), "there is no such block, parameter or input."))
    entry = body[section][of] if of else body
    steps = [section, of] if of else []
    operation: dict[str, object] = {"set": [*steps, "doc"], "to": doc}
    if not isinstance(entry, Mapping):
        operation = {"set": steps, "to": {"value": entry, "doc": doc}}
    if not doc:
        operation = {"remove": [*steps, "doc"]} if isinstance(entry, Mapping) and "doc" in entry else {}
    return _done(session, f"describe {of or 'the diagram'}", [_in(level, operation)] if operation else [])


def _is_quantity(raw: object) -> bool:
    return isinstance(raw, Mapping) and raw.keys() == {"value", "unit"}


@handles
def targets(session: Session, *, end: str, level: str = "", kind: str = "") -> Answer:
    """Where a wire from a port may end, or begin where it is an input: by port "", or why not.

    kind: "in" or "out", where a block has two ports of this name.
    """
    editor = _editor(session)
    value, resolver = editor.value_at(level), editor.resolver
    sinks: dict[str, str] = {}
    sources = {name: str(raw.get("unit", "")) for name, raw in value.inputs.items()}
    for name, entry in value.blocks.items():
        with suppress(ModelError, AssertionError, KeyError):
            inputs, outputs = port_units(value, name, entry, resolver)
            sinks |= {f"{name}.{own}": unit for own, unit in inputs.items()}
            sources |= {f"{name}.{own}": unit for own, unit in outputs.items()}
    base = end.partition("[")[0]
    is_source = base in sources and (kind != "in" or base not in sinks)
    if not is_source and base not in sinks:
        cure = did_you_mean(base[:200], [*sources, *sinks])
        raise UsageError(Fault("E502", legible(end[:200]), "there is no such port.", cure))
    unit, others = (sources[base], sinks) if is_source else (sinks[base], sources)
    driven = value.wires if is_source else {}
    told = {}
    for name, other in others.items():
        why = f"is driven by {driven[name]}" if name in driven else ""
        with suppress(BlocksError):
            if not why and not units.same_quantity(unit, other):
                why = f"[{other}] and [{unit}] are different quantities"
        told[name] = why
    return {"is": "targets", "ports": told}


@handles
def tab(session: Session, *, file: str) -> Answer:
    """Open another diagram of the folder; answers its address."""
    editor = _editor(session)
    path = inside(editor.project, os.path.relpath(editor.folder / file, editor.project))
    if editor.opens is None or not is_diagram(path):
        raise UsageError(Fault("E501", legible(file[:200]), "is not a diagram that can be opened here."))
    return {"is": "tab", "url": editor.opens(path)}


@handles
def upload(session: Session, *, name: str, text: str) -> Answer:
    """Write an FMU that was dropped on the page into the folder of the diagram. text: its bytes in base64.

    Answers its path as a block of the diagram names it. A file of this name that holds something else stays. Running an
    FMU runs its code: one that nobody trusts is not written before somebody says yes at the terminal. Then the answer
    says that it waits, and all pages hear of the decision ("permitted", why: why it was not written).
    """
    editor = _editor(session)
    target = inside(editor.folder, name)
    if target.suffix.lower() != ".fmu" or target.parent != editor.folder.resolve():
        raise UsageError(
            Fault("E501", quoted(name[:200]), "is not the name of an FMU.", "Drop a file whose name ends with .fmu.")
        )
    try:
        check_target(target)
    except OSError as error:
        raise refused(name[:200], error) from None
    try:
        data = base64.b64decode(text, validate=True)
    except binascii.Error:
        raise UsageError(Fault("E501", "upload.text", "is not base64.")) from None
    if not target.exists():
        if not is_zipfile(io.BytesIO(data)):
            raise UsageError(Fault("E501", legible(name[:200]), "is not an FMU: it is not a zip archive."))
        if not is_trusted(target, session.trust):
            return _asked(session, target, data)
        _write_new(target, data)
    elif target.read_bytes() != data:
        message = "exists already, with other contents."
        raise UsageError(Fault("E501", legible(name[:200]), message, "Rename one of the two."))
    return {"is": "uploaded", "fmu": target.name, "waits": False}


@handles
def import_model(session: Session, *, name: str, text: str) -> Answer:
    """Make a diagram of a Simulink model that was dropped on the page, in the folder of the diagram.

    text: its bytes in base64. Answers the path of the diagram, and the report. A file of this name stays.
    """
    editor = _editor(session)
    source = inside(editor.folder, name)
    if source.suffix.lower() not in (".slx", ".mdl") or source.parent != editor.folder.resolve():
        message = "is not the name of a Simulink model."
        raise UsageError(Fault("E501", quoted(name[:200]), message, "Drop an .slx or .mdl."))
    target = source.with_suffix(".json")
    if os.path.lexists(target):  # also a link that leads out of the folder, to no file yet
        raise UsageError(Fault("E501", legible(target.name), "exists already.", "Rename it, or rename the model."))
    try:
        data = base64.b64decode(text, validate=True)
    except binascii.Error:
        raise UsageError(Fault("E501", "import_model.text", "is not base64.")) from None
    with tempfile.TemporaryDirectory() as place:
        path = Path(place, source.name)
        path.write_bytes(data)
        diagram, report = from_simulink(path, folder=editor.folder)
    try:
        check_target(target)
        diagram.save(target)
    except OSError as error:
        raise refused(target.name, error) from None
    return {"is": "imported", "diagram": target.name, "whole": report.is_whole, "report": str(report)}


def _asked(session: Session, target: Path, data: bytes) -> Answer:
    """Ask at the terminal whether an FMU that came through the page may be written. Raises UsageError (E501)."""
    name = legible(target.name)
    if session.asks is None:
        cure = "Copy it into the folder by hand, or start with --trust FOLDER (in Python trust=)."
        message = "came through the page and contains code, and there is no terminal to ask for permission to write it."
        raise UsageError(Fault("E501", name, message, cure))
    if session.waits_for:
        message = f"must wait: the terminal still asks about {legible(session.waits_for)}."
        raise UsageError(Fault("E501", name, message, "Answer at the terminal first."))

    def decide(is_wanted: bool) -> None:
        why = "" if is_wanted else "it was declined at the terminal"
        try:
            if is_wanted:
                _write_new(target, data)
        except UsageError as error:
            why = str(error)
        finally:
            session.waits_for = ""
        session.broadcast({"is": "permitted", "fmu": target.name, "why": why})

    session.waits_for = target.name
    digest = hashlib.sha256(data).hexdigest()[:16]
    question = (
        f"{name} ({len(data):,} bytes, SHA-256 {digest}...) came through the page. Running it runs its code with all "
        f"your rights. Write it into {legible(str(target.parent))}?"
    )
    session.asks(question, lambda is_wanted: session.later(lambda: decide(is_wanted)))
    return {"is": "uploaded", "fmu": target.name, "waits": True}


def _write_new(target: Path, data: bytes) -> None:
    """Write a file where there is none. Raises UsageError (E501)."""
    if os.path.lexists(target):  # also a link to nowhere, which would lead out of the folder
        raise UsageError(Fault("E501", legible(target.name), "exists already.", "Rename one of the two."))
    with write_atomically(target) as stream:
        stream.buffer.write(data)
