"""What a page shows of one block: what it is, in words and equations, its parameters, its ports, its memory.

Texts are texts; only `mathml` and `more` are HTML, made here, with all that comes from elsewhere escaped. Parameters,
ports and memory are rows of one form (`_row`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

from ..api.catalog import ParameterRow, PortRow, Sheet, sheet_of
from ..contract.type_texts import names_of, pieces_of
from ..model.diagram_value import BlockEntry, DiagramValue
from ..model.hierarchy import DiagramScope, Hierarchy, Leaf
from ..model.variants import taken
from ..text.docstrings import Lines, Paragraph, html_of, inline_html
from ..text.element_names import indexed
from ..text.errors import BlocksError, Fault, UsageError, did_you_mean
from ..text.printable import quoted
from .facts import facts_of, text_of
from .messages import Answer, handles
from .open_document import told_fault
from .session import Session

MOST_ROWS = 300
"""Parameters, inputs and outputs that are shown, each: an FMU may have 100,000."""
LONGEST_DOC = 20_000
"""Characters of a text that are shown."""
Row = dict[str, Any]


@handles
def panel(session: Session, *, path: str) -> Answer:
    """What is shown of the block, or of the subdiagram, at a path; "" is the diagram itself.

    Values are in the unit beside them, which is that in which a bare number is meant. Raises UsageError (E502).
    """
    document, shown = session.document, session.document.visible
    scope, entry, found = _found(Hierarchy(taken(shown.value), shown._draft.resolver, {}).root, path)
    kind = "diagram" if entry.inner is not None else "fmu" if entry.fmu else "block"
    told: Row = {
        "is": "panel", "path": path, "type": entry.type or entry.what, "kind": kind, "doc": _joined(entry.doc),
        "own": _joined(entry.doc if path else shown.value.doc),
        "notes": [*_notes(entry)], "mathml": "", "more": "", "rows": {}, **_variants(session, path),
        "faults": [told_fault(f, {path}) for f in document.faults if not path or f"{f.place}.".startswith(f"{path}.")],
    }  # fmt: skip
    memory: list[PortRow] = []
    if entry.inner is not None:
        sheet = _sheet(entry.inner, entry.control_inputs)
        told |= {"type": sheet.name, **_of_text(sheet.doc), "run": _run(entry.inner)}
    else:
        interface = found.interface if isinstance(found, Leaf) else None
        cls = entry.cls or shown.types.get(entry.type) if interface is None else interface.cls
        if cls is None:
            return told
        sheet = sheet_of(cls, interface)
        told |= _of_type(cls, is_stranger=bool(entry.fmu))
        for how, table in (("state", cls.declaration.states), ("discrete", cls.declaration.discretes)):
            memory += [PortRow(x, v.unit if isinstance(v.unit, str) else "", how, v.doc) for x, v in table.items()]
    sections: Iterable[tuple[str, Sequence[object]]] = (
        ("Parameters", sheet.parameters), ("Inputs", sheet.inputs), ("Outputs", sheet.outputs), ("Memory", memory),
    )  # fmt: skip
    names = [row.name for some in (sheet.parameters, sheet.inputs) for row in some[:MOST_ROWS]]
    known = knobs_of(session, [f"{path}.{name}".lstrip(".") for name in names])
    for title, rows in sections:
        told["rows"][title] = [_row(title, row, path, scope, entry, known) for row in rows[:MOST_ROWS]]
    return told


def _row(title: str, row: Any, path: str, scope: DiagramScope, entry: BlockEntry, known: Mapping[str, Row]) -> Row:
    """A line of the panel.

    note: what is smaller below it. knob: what can be turned, of those that are known. link: the block that the text
    leads to. signal: what a scope can show.
    """
    name = f"{path}.{row.name}".lstrip(".")
    told: Row = {
        "name": row.name, "doc": row.doc, "unit": row.unit.replace("*", ""), "text": row.default, "note": "",
        "knob": None, "link": "", "signal": "",
    }  # fmt: skip
    if title == "Parameters":
        text = _text(entry.parameters.get(row.name))
        note = f"default {row.default}" if text and row.default not in ("", text) else ""
        told |= {"text": text or row.default, "note": note, "knob": known.get(name)}
    elif title == "Inputs":
        free = f"not wired: {row.default}" if row.default else "not wired"
        told |= {"text": free, "knob": known.get(name), **_source(scope, path, row.name)}
    elif title == "Outputs":
        told |= {"text": "", "signal": name}
    return told


def _run(value: DiagramValue) -> Row:
    """What a diagram says of its runs, as typed."""
    said = {name: _text(value.run.get(name)) for name in ("stop", "every", "method")}
    measures = {}
    for name, raw in value.measures.items():
        keys = (f"{key}={_text(one)}" for key, one in raw.items() if key not in ("type", "doc"))
        measures[name] = " ".join([str(raw.get("type")), *keys])
    return said | {"log": list(value.run.get("log", ())), "measures": measures}


def _sheet(value: DiagramValue, controls: tuple[str, ...]) -> Sheet:
    """A diagram, described as a block type is. controls: inputs that it has besides its own."""
    parameters = []
    for name, said in value.parameters.items():
        more = said if isinstance(said, Mapping) else {}
        own = _text({key: more[key] for key in ("value", "unit") if key in more} or said)
        parameters.append(ParameterRow(name, str(more.get("unit", "")), own, _joined(more.get("doc")), ""))
    inputs = [
        PortRow(name, str(raw.get("unit", "")), _text(raw.get("default")), _joined(raw.get("doc")))
        for name, raw in (*value.inputs.items(), *((name, {}) for name in controls))
    ]
    outputs = [PortRow(name, "", "", f"from {source}") for name, source in value.outputs.items()]
    return Sheet(value.name, _joined(value.doc), tuple(inputs), tuple(outputs), tuple(parameters))


def knobs_of(session: Session, names: list[str]) -> dict[str, Row]:
    """Parameters and inputs, by path and by name, as they are in this session."""
    document, given = session.document, {**session.values, **session.inputs}
    facts = {name: document.facts[name] for name in names if name in document.facts}
    told = {name: fact.told(given.get(name)) for name, fact in facts.items()}
    if session.values and facts.keys() - given.keys():  # what is computed follows what is set
        with suppress(BlocksError):  # a file that is read anew may have lost that
            now = facts_of(document.visible, document.planned, session.values)
            for name in facts.keys() & now.keys() - given.keys():
                told[name] |= {key: now[name].told(None)[key] for key in ("value", "low", "high", "text")}
    return told


def _found(root: DiagramScope, path: str) -> tuple[DiagramScope, BlockEntry, Leaf | DiagramScope | None]:
    """The scope around the block at a path, its entry, and it with its numbers, unless these are faulty.

    One copy of a block is shown by what stands for all of them.
    """
    scope, entry = root, BlockEntry(diagram=root.value)
    found: Leaf | DiagramScope | None = root
    for part in path.split(".") if path else ():
        name = part.partition("[")[0] if isinstance(found, DiagramScope) and _is_copy(found.value, part) else part
        if not isinstance(found, DiagramScope) or name not in found.value.blocks:
            cure = did_you_mean(name[:200], found.value.blocks) if isinstance(found, DiagramScope) else ""
            raise UsageError(Fault("E502", quoted(path[:200]), "there is no such block.", cure))
        scope, entry, found = found, found.value.blocks[name], found.children.get(name)
        number, fleet = indexed(part)[1], None if found is None else found.fleet
        if number is not None and fleet is not None and number >= fleet.count:
            message = f"there is no such copy: the copies have the numbers 0 to {fleet.count - 1}."
            raise UsageError(Fault("E502", quoted(path[:200]), message))
    return scope, entry, found


def _is_copy(value: DiagramValue, part: str) -> bool:
    """Whether a part of a path is a block that has copies, with a number."""
    name, bracket, _ = part.partition("[")
    entry = value.blocks.get(name)
    return bool(bracket) and entry is not None and entry.copies is not None and indexed(part)[1] is not None


def _joined(doc: object) -> str:
    """A doc of a file, which may be a list of lines, as one text."""
    text = "\n".join(map(str, doc)) if isinstance(doc, (list, tuple)) else str(doc or "")
    return text if len(text) <= LONGEST_DOC else f"{text[:LONGEST_DOC]} ..."


def _text(raw: object) -> str:
    """A raw value as a person reads it; "" for none."""
    return "" if raw is None else text_of(raw)[:LONGEST_DOC]


def _notes(entry: BlockEntry) -> Iterator[str]:
    """What the entry says beyond its parameters, in words."""
    if entry.copies is not None:
        yield f"Copies: {_text(entry.copies)}."
    enable, trigger = entry.control.get("enable"), entry.control.get("trigger")
    if enable is not None:
        how = ", ".join(f"{key} {_text(raw)}" for key, raw in enable.items()) or "states held, outputs held"
        yield f"Enabled by its input enable. While disabled: {how}."
    if trigger is not None and "every" in trigger:
        yield f"Triggered every {_text(trigger['every'])}."
    elif trigger is not None:
        yield f"Triggered by its input trigger, {_text(trigger.get('direction', 'up'))}."
    if entry.stream:
        yield f"Random numbers from the stream {entry.stream}."


def _variants(session: Session, path: str) -> Row:
    """The variants of the block at a path, which of them is taken, and whether the run has another one."""
    document, live = session.document, session.live
    inside, entry, choice, known = None if document.diagram is None else document.diagram.value, None, "base", ""
    for name in path.split(".") if path else ():
        known = f"{known}.{name}" if known else name
        entry = inside.blocks.get(name) if inside is not None else None
        if entry is None:
            break
        choice = document.variants.get(known, entry.variant or "base")
        inside = entry.variants.get(choice, entry).inner
    if entry is None or not entry.variants:
        return {"variants": [], "variant": "", "anew": False}
    begun = None if live is None else session.chosen.get(path, entry.variant or "base")
    return {"variants": ["base", *entry.variants], "variant": choice, "anew": begun not in (None, choice)}


def _of_type(cls: Any, *, is_stranger: bool) -> dict[str, str]:
    """What a class says: its first line with the equations below it, and the rest."""
    if is_stranger:
        return _of_text(cls.declaration.doc[:LONGEST_DOC])
    names = names_of(cls)
    summary, pieces = pieces_of(cls)
    first = next((k for k, piece in enumerate(pieces) if not isinstance(piece, Lines)), len(pieces))
    head = f'<p class="summary">{inline_html(summary, names, display=True)}</p>{html_of(pieces[:first], names)}'
    return {"mathml": head, "more": html_of(pieces[first:], names)}


def _of_text(text: str) -> dict[str, str]:
    """The text of a file: its first line, and the rest. No formulas are looked for, which may take long."""
    first, *rest = text.split("\n")
    lines = (f'<p class="point">{inline_html(x[2:], None)}</p>' if x.startswith("- ") else html_of([Paragraph(x)], None)
             for x in rest)  # fmt: skip
    return {"mathml": f"<p>{inline_html(first, None)}</p>" if first else "", "more": "".join(lines)}


def _source(scope: DiagramScope, path: str, port: str) -> dict[str, str]:
    """Where an input gets its values: the text of its wires, and the block that they begin at."""
    name, wires = path.rpartition(".")[2].partition("[")[0], scope.value.wires
    found = [str(source) for sink, source in wires.items() if sink.partition("[")[0] == f"{name}.{port}"]
    block = found[0].partition(".")[0] if found else ""
    link = scope.prefix + block if block in scope.value.blocks else ""
    return {"text": ", ".join(found), "link": link} if found else {}
