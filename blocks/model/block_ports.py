"""What a block of a diagram has: its ports and its parameters, with their units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import islice

from .diagram import BASE, BlockEntry, DiagramValue
from .flatten import interface_of
from .hierarchy import Resolver

__all__ = ["Ports", "listed", "parameter_units", "port_units"]

MOST_LISTED = 40
"""Ports that an error lists."""
Ports = tuple[dict[str, str], dict[str, str]]
"""The inputs and the outputs of a block, with their units."""


def port_units(within: DiagramValue, name: str, entry: BlockEntry, resolver: Resolver) -> Ports:
    """Input and output ports with their units.

    within: the diagram that the block lies in, whose parameters are taken as they are now.
    """
    if entry.variants and entry.variant not in ("", BASE):
        # Wires name the block's own ports; those that only the variant has can be wired as well.
        variant = entry.variants[entry.variant]
        base = replace(entry, variants={}, variant="")
        tables = port_units(within, name, base, resolver), port_units(within, name, variant, resolver)
        taken = set(variant.ports.values())
        own = [{key: unit for key, unit in table.items() if key not in taken} for table in tables[1]]
        return own[0] | tables[0][0], own[1] | tables[0][1]
    inner = entry.inner
    if inner is not None:
        inputs = {key: str(given.get("unit", "")) for key, given in inner.inputs.items()}
        inputs |= dict.fromkeys(entry.control_inputs, "")
        return inputs, dict.fromkeys(inner.outputs, "")
    probe = DiagramValue(within.name, parameters=within.parameters, blocks={name: entry}, folder=within.folder)
    interface = interface_of(probe, name, resolver)
    return (
        {port.name: port.unit for port in interface.inputs.values()},
        {port.name: port.unit for port in interface.outputs.values()},
    )


def parameter_units(entry: BlockEntry, folder: str, resolver: Resolver) -> dict[str, str]:
    """The parameters that a block has, with the units in which bare numbers are meant, where there is one."""
    if entry.inner is not None:
        raws = entry.inner.parameters.items()
        return {key: str(raw.get("unit", "")) if isinstance(raw, Mapping) else "" for key, raw in raws}
    try:
        cls = entry.cls or (resolver.fmu(entry, folder) if entry.fmu else resolver(entry.type))
    except KeyError:
        return {}
    parameters = cls.declaration.parameters
    return {key: known.unit if isinstance(known.unit, str) else "" for key, known in parameters.items()}


def listed(ports: Mapping[str, str]) -> str:
    """Names with their units; of very many, as an FMU may have, the first ones."""
    shown = [f"{name}{f' [{unit}]' if unit else ''}" for name, unit in islice(ports.items(), MOST_LISTED)]
    more = f" and {len(ports) - MOST_LISTED:,} more" if len(ports) > MOST_LISTED else ""
    return (", ".join(shown) or "none") + more
