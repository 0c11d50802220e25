"""What a page shows of one block: what it is, in words and equations, its parameters, its ports, its memory.

Texts are texts; only `mathml` and `more` are HTML, made here, with all that comes from elsewhere escaped. Parameters,
ports and memory are rows of one form (`_row`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ..api.catalog import sheet_of
from ..contract.type_texts import names_of, pieces_of
from ..model.diagram import BlockEntry, DiagramValue
from ..model.hierarchy import DiagramScope, Hierarchy, Leaf
from ..model.variants import taken
from ..text.docstrings import Lines, Paragraph, html_of, inline_html
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.printable import quoted
from .document import told_fault
from .facts import facts_of, text_of
from .messages import Answer, handles
from .session import Session

__all__ = ["knobs_of"]

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
    document = session.document
    shown = document.shown
    scope, entry, found = _found(Hierarchy(taken(shown.value), shown._draft.resolver, {}).root, path)
    kind = "diagram" if entry is None or entry.inner is not None else "fmu" if entry.fmu else "block"
    told: Row = {
        "is": "panel", "path": path, "type": "" if entry is None else entry.type or entry.what, "kind": kind,
        "doc": "" if entry is None else _joined(entry.doc), "notes": [] if entry is None else [*_notes(entry)],
        "mathml": "", "more": "", "rows": {}, **_variants(session, path),
        "faults": [told_fault(f, {path}) for f in document.faults if not path or f"{f.place}.".startswith(f"{path}.")],
    }  # fmt: skip
    inner = scope.value if entry is None else entry.inner
    if inner is not None:
        told |= {"type": inner.name, **_of_text(_joined(inner.doc))}
        rows = _of_diagram(session, inner, f"{path}." if path else "", entry)
    else:
        assert entry is not None
        cls = found.interface.cls if isinstance(found, Leaf) else entry.cls or shown.types.get(entry.type)
        if cls is None:
            return told
        told |= _told_by(cls, entry)
        rows = _of_type(cls, path, entry, found)
    told["rows"] = {title: some[:MOST_ROWS] for title, some in rows.items() if some}
    known = knobs_of(session, [row["knob"] for some in told["rows"].values() for row in some])
    for row in (row for some in told["rows"].values() for row in some):
        row["knob"] = known.get(row["knob"])
    for row in told["rows"].get("Inputs", []) if entry is not None else ():
        row |= _source(scope, path, row["name"])
    return told


def knobs_of(session: Session, names: list[str]) -> dict[str, Row]:
    """Parameters and inputs, by path and by name, as they are in this session."""
    document, set_ = session.document, {**session.values, **session.inputs}
    facts = {name: document.facts[name] for name in names if name in document.facts}
    told = {name: fact.told(set_.get(name)) for name, fact in facts.items()}
    if session.values and any(not row["changed"] for row in told.values()):  # what is computed follows what is set
        now = facts_of(document.shown, document.planned, session.values)
        for name in facts.keys() & now.keys() - set_.keys():
            told[name] |= {key: now[name].told(None)[key] for key in ("value", "low", "high", "text")}
    return told


def _row(name: str, doc: str, unit: str, text: str, **more: str) -> Row:
    """A line of the panel. note: what is smaller below it. knob: the name of what can be turned. link: the block that
    the text leads to. signal: what a scope can show."""
    empty = dict.fromkeys(("note", "knob", "link", "signal"), "")
    return {"name": name, "doc": doc, "unit": unit, "text": text, **empty, **more}


def _found(root: DiagramScope, path: str) -> tuple[DiagramScope, BlockEntry | None, Leaf | DiagramScope | None]:
    """The scope around the block at a path, its entry, and it with its numbers, unless these are faulty."""
    scope, entry, found = root, None, None
    for name in path.split(".") if path else ():
        scope = found if isinstance(found, DiagramScope) else scope
        if (entry is not None and scope is not found) or name not in scope.value.blocks:
            cure = did_you_mean(name[:200], scope.value.blocks)
            raise UsageError(Fault("E502", quoted(path[:200]), "there is no such block.", cure))
        entry, found = scope.value.blocks[name], scope.children.get(name)
    return scope, entry, found


def _joined(doc: Any) -> str:
    """A doc of a file, which may be a list of lines, as one text."""
    text = "\n".join(map(str, doc)) if isinstance(doc, (list, tuple)) else str(doc or "")
    return text if len(text) <= LONGEST_DOC else f"{text[:LONGEST_DOC]} ..."


def _text(raw: Any) -> str:
    """A raw value as a person reads it; "" for none."""
    return "" if raw is None else text_of(raw)[:LONGEST_DOC]


def _notes(entry: BlockEntry) -> Iterator[str]:
    """What the entry says beyond its parameters, in words."""
    enable, trigger = entry.control.get("enable"), entry.control.get("trigger")
    if enable is not None:
        how = ", ".join(f"{key} {_text(raw)}" for key, raw in enable.items()) or "states held, outputs held"
        yield f"Enabled by its input enable; while it is off: {how}."
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


# --- a block type ------------------------------------------------------------------------------------------------


def _of_type(cls: Any, path: str, entry: BlockEntry, found: Any) -> dict[str, list[Row]]:
    declaration = cls.declaration
    rows: dict[str, list[Row]] = {"Parameters": [], "Inputs": [], "Outputs": [], "Memory": []}
    for p in sheet_of(cls).parameters[:MOST_ROWS]:
        text = _text(entry.parameters.get(p.name))
        note = f"default {p.default}" if text and p.default not in ("", text) else ""
        unit = p.unit if p.unit != "*" else ""
        rows["Parameters"].append(_row(p.name, p.doc, unit, text or p.default, note=note, knob=f"{path}.{p.name}"))
    if not isinstance(found, Leaf):
        return rows
    docs = {name: v.doc for table in (declaration.readable, declaration.given) for name, v in table.items()}
    for port in [*found.interface.inputs.values()][:MOST_ROWS]:
        free = "not wired" if port.default is None else f"not wired: {port.default[0]:g}"
        rows["Inputs"].append(_row(port.name, docs.get(port.variable, ""), port.unit, free))
    for port in [*found.interface.outputs.values()][:MOST_ROWS]:
        doc = docs.get(port.variable, "")
        rows["Outputs"].append(_row(port.name, doc, port.unit, "", signal=f"{path}.{port.name}"))
    for kind, table in (("state", declaration.states), ("discrete", declaration.discretes)):
        for name, v in table.items():
            rows["Memory"].append(_row(name, v.doc, v.unit if isinstance(v.unit, str) else "", kind))
    return rows


def _told_by(cls: Any, entry: BlockEntry) -> dict[str, str]:
    """What a class says: its first line with the equations below it, and the rest."""
    if entry.fmu:  # a stranger's text
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


# --- a diagram ---------------------------------------------------------------------------------------------------


def _of_diagram(
    session: Session, value: DiagramValue, prefix: str, entry: BlockEntry | None
) -> dict[str, list[Row]]:
    rows: dict[str, list[Row]] = {"Parameters": [], "Inputs": [], "Outputs": []}
    for name, said in value.parameters.items():
        more = said if isinstance(said, Mapping) else {}
        own = _text({key: more[key] for key in ("value", "unit") if key in more} or said)
        text = _text(entry.parameters.get(name)) if entry is not None else ""
        note = f"default {own}" if text and text != own else ""
        unit, doc = str(more.get("unit", "")), _joined(more.get("doc"))
        rows["Parameters"].append(_row(name, doc, unit, text or own, note=note, knob=prefix + name))
    controls = entry.control_inputs if entry is not None else ()
    for name, raw in (*value.inputs.items(), *((name, {}) for name in controls)):
        free = f"not wired: {_text(raw['default'])}" if "default" in raw else "not wired"
        unit, knob = str(raw.get("unit", "")), name if entry is None else ""
        rows["Inputs"].append(_row(name, _joined(raw.get("doc")), unit, free, knob=knob))
    planned = session.document.planned
    for name, source in value.outputs.items():
        signal = prefix + name
        unit = planned.signal(signal).unit if planned is not None and signal in planned.signals else ""
        rows["Outputs"].append(_row(name, f"from {source}", unit, "", signal=signal))
    return rows


def _source(scope: DiagramScope, path: str, port: str) -> dict[str, str]:
    """Where an input gets its values: the text of its wires, and the block that they begin at."""
    name, wires = path.rpartition(".")[2], scope.value.wires
    found = [str(source) for sink, source in wires.items() if sink.partition("[")[0] == f"{name}.{port}"]
    block = found[0].partition(".")[0] if found else ""
    link = scope.prefix + block if block in scope.value.blocks else ""
    return {"text": ", ".join(found), "link": link} if found else {}
