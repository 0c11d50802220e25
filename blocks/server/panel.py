"""What a page shows of one block: what it is, in words and equations, its parameters, its ports, its memory.

Texts are texts; only `mathml` and `more` are HTML, made here, with all that comes from elsewhere escaped.
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
from .document import Document, told_fault
from .facts import Fact, text_of
from .messages import Answer, handles
from .session import Session

__all__ = ["panel_of"]

MOST_ROWS = 300
"""Parameters, inputs and outputs that are shown, each: an FMU may have 100,000."""
LONGEST_DOC = 20_000
"""Characters of a text that are shown."""


def panel_of(document: Document, path: str) -> dict[str, Any]:
    """What is shown of the block, or of the subdiagram, at a path; "" is the diagram itself.

    Values are in the unit beside them, which is that in which a bare number is meant. Raises UsageError (E502).
    """
    shown = document.visible
    hierarchy = Hierarchy(taken(shown.value), shown._draft.resolver, {})
    scope, entry, found = _found(hierarchy.root, path)
    told: dict[str, Any] = {
        "path": path, "type": "", "kind": "diagram", "doc": "", "mathml": "", "more": "", "notes": [], "parameters": [],
        "inputs": [], "outputs": [], "states": [],
    }  # fmt: skip
    if entry is not None:
        told |= {"type": entry.what, "kind": _kind(entry), "doc": _joined(entry.doc), "notes": [*_notes(entry)]}
    inner = entry.inner if entry is not None else scope.value
    if inner is not None:
        told |= _of_diagram(inner, path, document.facts, entry)
    elif entry is not None:
        cls = found.interface.cls if isinstance(found, Leaf) else entry.cls or shown.types.get(entry.type)
        if cls is not None:
            told |= _of_type(cls, path, document.facts, entry, found if isinstance(found, Leaf) else None)
    planned = document.planned
    if inner is not None and planned is not None:
        for row in told["outputs"]:
            known = row["signal"] in planned.signals
            row["unit"] = planned.signal(row["signal"]).unit if known else ""
    if entry is not None:
        told["inputs"] = [{**row, **_source(scope, path, row["name"])} for row in told["inputs"]]
    told["faults"] = [
        told_fault(fault, {path})
        for fault in document.faults
        if f"{fault.place}.".startswith(f"{path}." if path else "")
    ]
    return told


def _found(root: DiagramScope, path: str) -> tuple[DiagramScope, BlockEntry | None, Leaf | DiagramScope | None]:
    """The scope around the block at a path, its entry, and it with its numbers, unless these are faulty."""
    scope, entry, found = root, None, None
    steps = path.split(".") if path else []
    for index, name in enumerate(steps):
        entry = scope.value.blocks.get(name)
        if entry is None:
            raise _no_block(path, name, scope)
        found = scope.children.get(name)
        if index + 1 < len(steps):
            if not isinstance(found, DiagramScope):
                raise _no_block(path, steps[index + 1], None)
            scope = found
    return scope, entry, found


def _no_block(path: str, name: str, scope: DiagramScope | None) -> UsageError:
    cure = "" if scope is None else did_you_mean(name[:200], scope.value.blocks)
    return UsageError(Fault("E502", quoted(path[:200]), "there is no such block.", cure))


def _kind(entry: BlockEntry) -> str:
    return "diagram" if entry.inner is not None else "fmu" if entry.fmu else "block"


def _joined(doc: Any) -> str:
    """A doc of a file, which may be a list of lines, as one text."""
    text = "\n".join(map(str, doc)) if isinstance(doc, (list, tuple)) else str(doc or "")
    return text if len(text) <= LONGEST_DOC else f"{text[:LONGEST_DOC]} ..."


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


# --- a block type ------------------------------------------------------------------------------------------------


def _of_type(cls: Any, path: str, facts: Mapping[str, Fact], entry: BlockEntry, leaf: Leaf | None) -> dict[str, Any]:
    declaration = cls.declaration
    told: dict[str, Any] = {"type": entry.type or entry.what, **_told_by(cls, entry), "parameters": []}
    for row in sheet_of(cls).parameters[:MOST_ROWS]:
        place, raw = f"{path}.{row.name}", entry.parameters.get(row.name)
        unit = row.unit if row.unit != "*" else ""
        told["parameters"].append({**_parameter(place, raw, row.doc, unit, facts.get(place)), "default": row.default})
    if leaf is None:
        return told
    interface = leaf.interface
    docs = {name: v.doc for table in (declaration.readable, declaration.given) for name, v in table.items()}
    for side, ports in (("inputs", interface.inputs), ("outputs", interface.outputs)):
        told[side] = [
            {"name": port.name, "unit": port.unit, "doc": docs.get(port.variable, ""), "size": port.size,
             "default": None if port.default is None else port.default[0], "signal": f"{path}.{port.name}"}
            for port in [*ports.values()][:MOST_ROWS]
        ]  # fmt: skip
    told["states"] = [
        {"name": name, "unit": _si(variable), "doc": variable.doc, "kind": kind}
        for kind, table in (("state", declaration.states), ("discrete", declaration.discretes))
        for name, variable in [*table.items()][:MOST_ROWS]
    ]
    return told


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


def _parameter(path: str, raw: Any, doc: str, unit: str, fact: Fact | None) -> dict[str, Any]:
    """A row of the panel. raw: what the file gives, None for nothing. fact: None where the diagram has faults."""
    told = (
        {"value": None, "unit": unit, "tunable": False, "why": "", "choices": []} if fact is None else fact.told(None)
    )
    keys = ("value", "unit", "tunable", "why", "choices")
    known = {key: told[key] for key in keys}
    return {"name": path.rpartition(".")[2], "path": path, "text": _text(raw), "doc": doc, **known}


def _si(variable: Any) -> str:
    return variable.unit if isinstance(variable.unit, str) else ""


# --- a diagram ---------------------------------------------------------------------------------------------------


def _of_diagram(value: DiagramValue, path: str, facts: Mapping[str, Fact], entry: BlockEntry | None) -> dict[str, Any]:
    prefix = f"{path}." if path else ""
    told: dict[str, Any] = {"type": value.name, **_of_text(_joined(value.doc))}
    given = entry.parameters if entry is not None else {}
    told["parameters"] = []
    for name, said in [*value.parameters.items()][:MOST_ROWS]:
        more = said if isinstance(said, Mapping) else {}
        own = {key: more[key] for key in ("value", "unit") if key in more} or said
        row = _parameter(
            prefix + name, given.get(name) if entry else own, str(more.get("doc", "")), str(more.get("unit", "")),
            facts.get(prefix + name),
        )  # fmt: skip
        told["parameters"].append({**row, "default": _text(own)})
    told["inputs"] = [
        {
            "name": name,
            "unit": str(raw.get("unit", "")),
            "doc": _joined(raw.get("doc")),
            "default": _text(raw.get("default")),
        }
        for name, raw in [*value.inputs.items()][:MOST_ROWS]
    ]
    told["inputs"] += [
        {"name": name, "unit": "", "doc": "", "default": ""} for name in (entry.control_inputs if entry else ())
    ]
    told["outputs"] = [
        {"name": name, "unit": "", "doc": f"from {source}", "signal": prefix + name}
        for name, source in [*value.outputs.items()][:MOST_ROWS]
    ]
    return told


def _source(scope: DiagramScope, path: str, port: str) -> dict[str, str]:
    """Where an input gets its values: the text of its wires, and the block that they begin at."""
    name = path.rpartition(".")[2]
    wires = scope.value.wires
    found = [source for sink, source in wires.items() if sink.partition("[")[0] == f"{name}.{port}"]
    block = str(found[0]).partition(".")[0] if found else ""
    return {
        "source": ", ".join(map(str, found)),
        "from": scope.prefix + block if block in scope.value.blocks else "",
    }


def _text(raw: Any) -> str:
    """A raw value as a person reads it; "" for none."""
    return "" if raw is None else text_of(raw)[:LONGEST_DOC]


@handles
def panel(session: Session, *, path: str) -> Answer:
    return {"is": "panel", **panel_of(session.document, path)}
