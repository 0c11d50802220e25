"""What an FMU says of its variables, from what the diagram and its blocks say."""

from __future__ import annotations

from collections.abc import Mapping

from ..model.diagram_value import DiagramValue
from ..model.flatten import Flat
from ..text.units import si_text


def doc_of(raw: object) -> str:
    """A "doc" of a file as one line."""
    return " ".join(map(str, raw)) if isinstance(raw, (list, tuple)) else str(raw or "")


def prefix_of(value: DiagramValue, flat: Flat) -> str:
    """The prefix left out of names in a diagram of one block whose outputs are the block's: "PMDCMotor." """
    if len(value.blocks) != 1 or len(flat.blocks) != 1 or value.parameters or not value.outputs:
        return ""
    (name,) = value.blocks
    is_alone = all(source == f"{name}.{output}" for output, source in value.outputs.items())
    return f"{name}." if is_alone else ""


def docs_of(value: DiagramValue, flat: Flat, prefix: str) -> dict[str, str]:
    """The docs of inputs, outputs and signals of blocks, by name; units of states, by "unit:name"; declared units, by
    "display:name"."""
    docs: dict[str, str] = {}
    for name, entry in value.inputs.items():
        if isinstance(entry, Mapping):
            docs[name] = doc_of(entry.get("doc", ""))
    for block in flat.blocks:
        interface = block.interface
        declaration = interface.declaration
        if prefix:
            inputs = {name: declaration.inputs[port.variable].doc for name, port in interface.inputs.items()}
            docs |= {name: doc for name, doc in inputs.items() if not docs.get(name)}
        for name, port in interface.outputs.items():
            known = declaration.readable.get(port.variable)
            docs.setdefault(f"{block.path}.{name}", known.doc if known is not None else "")
            if len(set(port.declared)) == 1 and port.declared[0] != port.unit:
                docs[f"display:{block.path}.{name}"] = port.declared[0]
        for name, state in declaration.states.items():
            path = f"{block.path}.{name}"
            docs.setdefault(path, state.doc)
            units = {(si_text(unit) if unit else "", unit) for unit in interface.declared_units(state)}
            if len(units) == 1:
                unit, declared = units.pop()
                docs[f"unit:{path}"] = unit
                if declared != unit:
                    docs[f"display:{path}"] = declared
    for name, source in value.outputs.items():
        if isinstance(source, str):
            for what in ("", "display:"):
                docs.setdefault(f"{what}{name}", docs.get(f"{what}{source}", ""))
    return docs
