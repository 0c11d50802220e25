"""Copies for a vector: the blocks with scalar ports that a wire from a vector needs once for each element."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial

from ..contract.block import Block
from ..contract.interface import Interface
from ..text.element_names import indexed, named_element
from ..text.errors import BlocksError
from .block_ports import interface_alone
from .diagram_value import BlockEntry, DiagramValue
from .hierarchy import Resolver

Alone = Callable[[str, BlockEntry], Interface]
"""Gives the interface of a block in a diagram; raises ModelError."""


def spread(
    value: DiagramValue, sink: str, source: str, resolver: Resolver, alone: Alone | None = None
) -> dict[str, BlockEntry]:
    """Return the entries that get copies because of a new wire, by name, with one copy for each element.

    A block of the library, or one of your own, gets copies if a vector reaches an input that takes one value. The
    blocks that read its outputs then see a vector too, and follow. Subdiagrams, FMUs, blocks that rearrange elements
    (Mux), and blocks that have copies stay as they are.

    value: the diagram; its wires need not hold the new one. alone: gives interfaces of its blocks, if they are known.
    """
    changed: dict[str, BlockEntry] = {}
    alone = alone or partial(interface_alone, value, resolver=resolver)
    wires = [(sink, source)]
    while wires:
        sink, source = wires.pop()
        name, _, port = sink.partition(".")
        entry = value.blocks.get(name)
        if entry is None or name in changed or entry.copies is not None or entry.variants:
            continue
        cls = _class_of(entry, resolver)
        copies = None if cls is None or _rearranges(cls) else _copies_of(value, changed, source, resolver, alone)
        if copies is not None and _shape(name, entry, port, alone, is_input=True) == ():
            changed[name] = replace(entry, copies=copies)
            wires += [(other, text) for other, text in value.wires.items() if text.partition(".")[0] == name]
    return changed


def fitted(
    value: DiagramValue, sink: str, source: str, resolver: Resolver, alone: Alone | None = None
) -> tuple[str, str]:
    """Return a wire between a vector of one element and a single value, which names the element: "plant.u[0]"."""
    if "[" in sink or "[" in source:
        return sink, source
    alone = alone or partial(interface_alone, value, resolver=resolver)
    shapes: list[tuple[int, ...] | None] = []
    for text, is_input in ((sink, True), (source, False)):
        name, _, port = text.partition(".")
        if not is_input and text in value.inputs and "size" not in value.inputs[text]:
            shapes.append(())
            continue
        entry = value.blocks.get(name)
        cls = None if entry is None or entry.copies is not None or entry.variants else _class_of(entry, resolver)
        if entry is None or cls is None:
            return sink, source
        is_vector = _has_vectors(cls, is_input=is_input)
        shapes.append(_shape(name, entry, port, alone, is_input=is_input) if is_vector else ())
    if shapes == [(1,), ()]:
        return f"{sink}[0]", source
    return (sink, f"{source}[0]") if shapes == [(), (1,)] else (sink, source)


def _copies_of(
    value: DiagramValue, changed: Mapping[str, BlockEntry], source: str, resolver: Resolver, alone: Alone
) -> object:
    """Return the number of copies, or its expression, that fits a source; None if the source is no vector."""
    base, index = indexed(source)
    if index is not None or named_element(source)[1]:
        return None
    if base in value.inputs:
        size = value.inputs[base].get("size")
        return None if isinstance(size, list) else size
    name, _, port = base.partition(".")
    entry = changed.get(name) or value.blocks.get(name)
    cls = None if entry is None else _class_of(entry, resolver)
    if entry is None or cls is None or (entry.copies is None and not _has_vectors(cls, is_input=False)):
        return None
    shape = _shape(name, entry, port, alone)
    if entry.copies is not None:
        return entry.copies if shape == () else None
    return shape[0] if shape is not None and len(shape) == 1 else None


def _class_of(entry: BlockEntry, resolver: Resolver) -> type[Block] | None:
    """Return the class of a block that is neither a subdiagram nor an FMU."""
    with suppress(KeyError):
        return (entry.cls or resolver(entry.type)) if entry.type else None
    return None


@cache
def _has_vectors(cls: type[Block], *, is_input: bool) -> bool:
    """Return whether an input, or an output, of a class may have several elements."""
    said = cls.declaration
    tables = (said.outputs, said.states, said.discretes, said.algebraics, said.given, said.stepped)
    ports = said.inputs.values() if is_input else (variable for table in tables for variable in table.values())
    return any(port.shape != () for port in ports if getattr(port, "output", True))


@cache
def _rearranges(cls: type[Block]) -> bool:
    return any(output.wiring for output in cls.declaration.outputs.values())


def _shape(name: str, entry: BlockEntry, port: str, alone: Alone, *, is_input: bool = False) -> tuple[int, ...] | None:
    """Return the shape of a port of a block, or of one of its copies; None if it has none yet."""
    interface: Interface | None = None
    with suppress(BlocksError):
        interface = alone(name, entry)
    ports = {} if interface is None else interface.inputs if is_input else interface.outputs
    return ports[port].shape if port in ports else None
