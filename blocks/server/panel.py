"""What a page shows of one block: what it is, in words and equations, its parameters, its ports, its memory.

Texts are texts; only `mathml` is HTML, made here, with all that comes from elsewhere escaped.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..api.catalog import sheet_of
from ..compile.bindings import bindings
from ..compile.plan import Plan
from ..compile.setting_programs import Setting
from ..contract.type_texts import names_of, pieces_of
from ..model.diagram import BlockEntry, DiagramValue
from ..model.hierarchy import DiagramScope, Hierarchy, Leaf
from ..model.variants import taken
from ..text import units
from ..text.docstrings import html_of, inline_html, paragraphs_of
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.printable import quoted
from .document import Document, told_fault

if TYPE_CHECKING:
    from ..api.diagram import Diagram

__all__ = ["panel", "settings_of"]

MOST_ROWS = 300
"""Parameters, inputs and outputs that are shown, each: an FMU may have 100,000."""
LONGEST_DOC = 20_000
"""Characters of a text that are shown."""


def panel(document: Document, path: str) -> dict[str, Any]:
    """What is shown of the block, or of the subdiagram, at a path; "" is the diagram itself.

    Values are in the unit beside them, which is that in which a bare number is meant. Raises UsageError (E502).
    """
    shown = document.shown
    hierarchy = Hierarchy(taken(shown.value), shown._draft.resolver, {})
    scope, entry, found = _found(hierarchy.root, path)
    settings = settings_of(document)
    told: dict[str, Any] = {
        "path": path, "type": "", "kind": "diagram", "doc": "", "mathml": "", "notes": [], "parameters": [],
        "inputs": [], "outputs": [], "states": [],
    }  # fmt: skip
    if entry is not None:
        told |= {"type": entry.what, "kind": _kind(entry), "doc": _joined(entry.doc), "notes": [*_notes(entry)]}
    inner = entry.inner if entry is not None else scope.value
    if inner is not None:
        told |= _of_diagram(inner, path, settings, entry)
    elif entry is not None:
        cls = found.interface.cls if isinstance(found, Leaf) else entry.cls or shown.types.get(entry.type)
        if cls is not None:
            told |= _of_type(cls, path, settings, entry, found if isinstance(found, Leaf) else None)
    if entry is not None:
        told["inputs"] = [{**row, **_source(scope, path, row["name"])} for row in told["inputs"]]
    told["faults"] = [
        told_fault(fault, {path}) for fault in document.faults if f"{fault.place}.".startswith(f"{path}." if path else "")
    ]
    return told


def settings_of(document: Document) -> Mapping[str, Setting]:
    """All that can be set of the diagram, by path; nothing where it has faults, or is led by a master."""
    shown, plan = document.shown, document.planned
    if not isinstance(plan, Plan):
        return {}
    known = document.kept.get("settings")
    if known is None:
        value = taken(shown.value)
        known = {setting.path: setting for setting in bindings(value, shown.flatten(), plan)}
        document.kept["settings"] = known
    return known  # type: ignore[no-any-return]


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
    if entry.variants:
        yield f"Variants: base, {', '.join(entry.variants)}; chosen: {entry.variant or 'base'}."
    if entry.stream:
        yield f"Random numbers from the stream {entry.stream}."


# --- a block type ------------------------------------------------------------------------------------------------


def _of_type(
    cls: Any, path: str, settings: Mapping[str, Setting], entry: BlockEntry, leaf: Leaf | None
) -> dict[str, Any]:
    declaration = cls.declaration
    if entry.fmu:  # its texts are a stranger's: no formulas are looked for
        doc = html_of(paragraphs_of(declaration.doc[:LONGEST_DOC]), None)
    else:
        names = names_of(cls)
        summary, pieces = pieces_of(cls)
        doc = f'<p class="summary">{inline_html(summary, names, display=True)}</p>{html_of(pieces, names)}'
    told: dict[str, Any] = {"type": entry.type or entry.what, "mathml": doc, "parameters": []}
    for row in sheet_of(cls).parameters[:MOST_ROWS]:
        known = declaration.parameters[row.name]
        raw = entry.parameters.get(row.name)
        setting = settings.get(f"{path}.{row.name}")
        unit = row.unit if row.unit != "*" else ""
        told["parameters"].append({
            **_parameter(f"{path}.{row.name}", raw, unit, row.doc, setting),
            "default": row.default, "choices": [*(known.choices or known.members)],
            **({} if setting else _value_of(leaf, row.name, unit, row.kind)),
        })  # fmt: skip
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


def _parameter(path: str, raw: Any, unit: str, doc: str, setting: Setting | None) -> dict[str, Any]:
    told: dict[str, Any] = {
        "name": path.rpartition(".")[2], "path": path, "text": _text(raw), "value": None, "unit": unit, "doc": doc,
        "tunable": False, "why": "", "low": None, "high": None,
    }  # fmt: skip
    if setting is None:
        return told
    shown = setting.display or setting.unit
    factor = units.scale(setting.unit, shown)
    values = [_out_of_si(value, factor) for value in setting.values[:MOST_ROWS]]
    given = raw.get("value") if isinstance(raw, Mapping) and raw.get("unit", shown) == shown else raw
    if isinstance(given, float) and len(values) == 1:
        values = [float(given)]  # as it is written, and not through SI and back
    is_bound = setting.is_bound
    return told | {
        "value": values[0] if setting.shape == () else values, "unit": shown, "doc": doc or setting.doc,
        "tunable": setting.variability == "tunable" and not is_bound,
        "why": "it is computed from others" if is_bound else setting.why,
        "low": None if setting.low is None else _out_of_si(setting.low, factor),
        "high": None if setting.high is None else _out_of_si(setting.high, factor),
    }  # fmt: skip


def _out_of_si(value: Any, factor: float) -> Any:
    if isinstance(value, (str, bool)):
        return value
    number = float(value) * factor
    return number if np.isfinite(number) else str(number)


def _value_of(leaf: Leaf | None, name: str, unit: str, kind: str) -> dict[str, Any]:
    """The value of a parameter that has no setting: where a master leads, or where there are faults."""
    known = None if leaf is None else leaf.resolved.values.get(name)
    why = kind.partition(" (")[0] if kind and not kind.startswith("(") else "the diagram cannot be tuned as it is"
    if known is None or known.value is None:
        return {"why": why}
    value, factor = known.value, units.scale(units.si_text(unit), unit) if unit else 1.0
    if isinstance(value, (np.ndarray, list, tuple)):
        return {"why": why, "value": [_out_of_si(item, factor) for item in np.ravel(value)[:MOST_ROWS].tolist()]}
    return {"why": why, "value": _out_of_si(value, factor)}


def _si(variable: Any) -> str:
    return variable.unit if isinstance(variable.unit, str) else ""


# --- a diagram ---------------------------------------------------------------------------------------------------


def _of_diagram(
    value: DiagramValue, path: str, settings: Mapping[str, Setting], entry: BlockEntry | None
) -> dict[str, Any]:
    prefix = f"{path}." if path else ""
    told: dict[str, Any] = {"type": value.name, "mathml": html_of(paragraphs_of(_joined(value.doc)), None)}
    given = entry.parameters if entry is not None else {}
    told["parameters"] = []
    for name, raw in [*value.parameters.items()][:MOST_ROWS]:
        said = raw if isinstance(raw, Mapping) else {}
        row = _parameter(
            prefix + name, given.get(name), str(said.get("unit", "")), str(said.get("doc", "")), settings.get(prefix + name)
        )
        own = {key: said[key] for key in ("value", "unit") if key in said} or raw
        if entry is None:
            row["text"] = _text(own)
        told["parameters"].append({**row, "default": _text(own), "choices": []})
    told["inputs"] = [
        {"name": name, "unit": str(raw.get("unit", "")), "doc": _joined(raw.get("doc")), "default": _text(raw.get("default"))}
        for name, raw in [*value.inputs.items()][:MOST_ROWS]
    ]
    told["inputs"] += [{"name": name, "unit": "", "doc": "", "default": ""} for name in (entry.control_inputs if entry else ())]
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
    """A raw value as a person reads it: as the file has it, a quantity with its unit behind."""
    if raw is None:
        return ""
    if isinstance(raw, Mapping):
        return f"{_text(raw.get('value'))} {raw.get('unit', '')}".strip()
    if isinstance(raw, bool):
        return "true" if raw else "false"
    if isinstance(raw, Sequence) and not isinstance(raw, str):
        return f"[{', '.join(_text(item) for item in raw)}]"[:LONGEST_DOC]
    return str(raw)[:LONGEST_DOC]
