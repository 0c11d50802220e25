"""What a block of a diagram has: its ports and its parameters, with their units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import islice

from ..contract.captured_values import Outside, outside
from ..contract.interface import Interface
from ..contract.resolution import loose
from ..text.json_number import Number
from ..text.quantity_text import quantity_of
from .diagram_value import BASE, BlockEntry, DiagramValue
from .flatten import interface_of
from .hierarchy import Hierarchy, Resolver, spelling

MOST_LISTED = 40
"""Ports that an error lists."""
Ports = tuple[Mapping[str, str], Mapping[str, str]]
"""The inputs and the outputs of a block, with their units."""


class Probe:
    """The interfaces of blocks that are added to a diagram one after the other; what those alike share is settled once.

    It holds for the parameters that the diagram has when it is made.
    """

    def __init__(self, within: DiagramValue, resolver: Resolver) -> None:
        """Raises ModelError as `port_units`."""
        self.blocks: dict[str, BlockEntry] = {}
        self.hierarchy = Hierarchy(replace(within, blocks=self.blocks), resolver, {})
        self.known: dict[object, Interface] = {}
        self.read: dict[object, Outside] = {}

    def interface(self, name: str, entry: BlockEntry) -> Interface | None:
        """That of a block whose class is known; None where a fresh look is needed, and from then on."""
        assert entry.cls is not None
        hierarchy, declaration = self.hierarchy, entry.cls.declaration
        read, bounds = outside(declaration), loose(declaration)
        is_same = self.read.setdefault(entry.cls, read) is read and not read.impure and not read.is_opaque
        if not is_same or len(hierarchy.resolved) > 1_000:  # it keeps not more than a diagram needs
            return None
        changed = {name: raw for name, raw in entry.parameters.items() if _is_between(raw, bounds.get(name))}
        key = spelling(entry, hierarchy.root, changed) if bounds.keys() >= {*declaration.streams} else None
        if key in self.known:
            return self.known[key]
        self.blocks[name] = entry
        hierarchy.leaves.clear()
        hierarchy.drawing.clear()
        leaf = hierarchy.leaf(hierarchy.root, name, entry)
        if leaf is None or hierarchy.faults:
            return None
        if key is not None:
            self.known[key] = leaf.interface
        return leaf.interface


def _is_between(raw: object, bounds: tuple[float, float] | None) -> bool:
    """Whether it is a number between two bounds, in SI as well: there it is neither infinite nor 0, if it is not 0."""
    return bounds is not None and type(raw) is Number and bounds[0] < raw < bounds[1] and (not raw or abs(raw) > 1e-100)


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
        return {**own[0], **tables[0][0]}, {**own[1], **tables[0][1]}
    inner = entry.inner
    if inner is not None:
        inputs = {key: str(given.get("unit", "")) for key, given in inner.inputs.items()}
        inputs |= dict.fromkeys(entry.control_inputs, "")
        return inputs, dict.fromkeys(inner.outputs, "")
    interface = interface_alone(within, name, entry, resolver)
    return interface.input_units, interface.output_units


def interface_alone(within: DiagramValue, name: str, entry: BlockEntry, resolver: Resolver) -> Interface:
    """Return the interface of a block, as if it were the only one in a diagram. Raises ModelError."""
    probe = DiagramValue(within.name, parameters=within.parameters, blocks={name: entry}, folder=within.folder)
    return interface_of(probe, name, resolver)


def parameter_units(entry: BlockEntry, folder: str, resolver: Resolver) -> dict[str, str]:
    """The parameters that a block has, with the units in which bare numbers are meant, where there is one."""
    if entry.inner is not None:
        return {key: quantity_of(raw).unit for key, raw in entry.inner.parameters.items()}
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
