"""Another block in the place of one: which ports are matched, and which values go along."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..model.block_ports import Ports, listed, parameter_units, port_units
from ..model.diagram_value import BASE, BlockEntry, DiagramValue, check_name
from ..model.hierarchy import Resolver
from ..model.variants import Match, Swap, match, used_ports
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.json_number import is_number
from ..text.printable import legible, quoted


def existing(value: DiagramValue, name: str) -> BlockEntry:
    """The block that is to be swapped. Raises ModelError (E105) where there is none."""
    if name not in value.blocks:
        cure = did_you_mean(str(name)[:200], value.blocks) or f"Blocks: {', '.join(value.blocks) or 'none'}."
        raise ModelError(Fault("E105", legible(str(name)), "there is no such block.", cure))
    return value.blocks[name]


def diagrams_along(value: DiagramValue, path: Sequence[str]) -> list[DiagramValue]:
    """Return a diagram and the subdiagrams along a path of blocks, from the outside.

    Raises ModelError (E105) if one is missing, UsageError (E501) if one is not inside this file.
    """
    values = [value]
    for name in path:
        block = existing(values[-1], name)
        if not isinstance(block.diagram, DiagramValue):
            what = "is a diagram in another file" if block.diagram else "is not a subdiagram"
            cure = f"Load {block.diagram}, and swap the block there." if block.diagram else ""
            raise UsageError(Fault("E501", name, f"{what}, so no block in it can be swapped here.", cure))
        values.append(block.diagram)
    return values


def swapped(
    value: DiagramValue,
    name: str,
    entry: BlockEntry,
    resolver: Resolver,
    *,
    variant: str,
    ports: Mapping[str, str] | None,
) -> tuple[BlockEntry, Swap]:
    """The entry of a block with one more variant, which is chosen from now on, and what was matched.

    entry: of what takes the place of the block `name`. Other arguments and errors as of `Diagram.swap`.
    """
    block = value.blocks[name]
    base = replace(block, variants={}, variant="")
    kind = "fmu" if entry.fmu else entry.type or (entry.inner.name if entry.inner is not None else "diagram")
    variant = variant or kind
    check_name(variant)
    if variant == BASE or variant in block.variants:
        message = f"the variant {quoted(variant)} exists already."
        raise ModelError(Fault("E109", name, message, "Choose another name: variant=..."))
    before, after = port_units(value, name, base, resolver), port_units(value, name, entry, resolver)
    matched = _matched(value, name, before, after, dict(ports or {}))
    entry, kept, dropped = _with_values(value, name, base, entry, resolver)
    if base.stream and (entry.cls is None or entry.cls.declaration.streams):
        entry = replace(entry, stream=base.stream)
    inputs, outputs = matched
    paired = {pair.name for pair in (*inputs, *outputs)}, {pair.own for pair in (*inputs, *outputs)}
    swap = Swap(
        name, variant, base.what or "subdiagram", entry.what or "subdiagram", inputs, outputs,
        tuple(key for table in before for key in table if key not in paired[0]),
        tuple(key for table in after for key in table if key not in paired[1]),
        kept, dropped,
    )  # fmt: skip
    entry = replace(entry, ports=swap.ports)
    return replace(block, variant=variant, variants={**block.variants, variant: entry}), swap


def _with_values(
    value: DiagramValue, name: str, old: BlockEntry, new: BlockEntry, resolver: Resolver
) -> tuple[BlockEntry, tuple[str, ...], tuple[tuple[str, str], ...]]:
    """The new entry with the old one's values for parameters of equal names; those kept, and those not and why."""
    kept: list[str] = []
    dropped: list[tuple[str, str]] = []
    units = parameter_units(old, value.folder, resolver), parameter_units(new, value.folder, resolver)
    for key, raw in old.parameters.items():
        if key in new.parameters:
            continue  # it was given anew
        if key not in units[1]:
            dropped.append((key, "there is none of this name"))
            continue
        unit = units[0].get(key, "")
        if is_number(raw) and unit and unit != units[1][key]:
            raw = {"value": raw, "unit": unit}  # it was meant in the unit that the other one declares
        tried = replace(new, parameters={**new.parameters, key: raw})
        try:
            port_units(value, name, tried, resolver)
        except ModelError as error:
            dropped.append((key, error.faults[0].message))
        else:
            new = tried
            kept.append(key)
    return new, tuple(kept), tuple(dropped)


def _matched(
    value: DiagramValue, name: str, before: Ports, after: Ports, known: dict[str, str]
) -> tuple[tuple[Match, ...], tuple[Match, ...]]:
    """The pairs of inputs, and those of outputs. Raises ModelError where a port that the diagram names has none."""
    faults = []
    for key, own in known.items():
        side = 0 if key in before[0] else 1
        if key not in before[side]:
            faults.append(Fault("E105", name, f"has no port {quoted(str(key))}.", did_you_mean(str(key), before[side])))
        elif own not in after[side]:
            what = f"the new block has no {('input', 'output')[side]} {quoted(str(own))}."
            faults.append(Fault("E105", name, what, did_you_mean(str(own), after[side]) or _ports_listed(after[side])))
    matches: list[tuple[Match, ...]] = []
    for side, used in enumerate(used_ports(value, name)) if not faults else ():
        word = ("input", "output")[side]
        # What wires name and the block has not is of another variant, or a fault that `check` reports.
        ports = dict(before[side])
        pairs = match(ports, after[side], {key: own for key, own in known.items() if key in ports})
        matches.append(pairs)
        partners = {pair.name for pair in pairs}
        for text, place in used.items():
            port = text if text in ports or "[" not in text else text.rpartition("[")[0]
            if port in partners or (port not in ports and (port in after[side] or place == "run: log")):
                continue
            shown = f"{port} [{ports[port]}]" if ports.get(port) else port
            message = f"the {word} {shown} ({place}) has no counterpart in the new block."
            faults.append(Fault("E105", name, message, _ports_listed(after[side])))
    if faults:
        raise ModelError(*faults)
    return matches[0], matches[1]


def _ports_listed(ports: Mapping[str, str]) -> str:
    return f"The new block has {listed(ports)}. To pair ports with different names, give ports={{...}}."
