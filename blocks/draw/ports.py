"""Which ports a block has, for drawing: from its type where that is known, else from the wires."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ..contract.interface import Interface
from ..contract.variables import REQUIRED
from ..model.diagram import DiagramValue
from ..model.flatten import interface_of
from ..model.hierarchy import Resolver
from ..text.errors import ModelError

__all__ = ["Ports", "ports_of"]


@dataclass(frozen=True, slots=True)
class Ports:
    """The port names of a block from top to bottom.

    optional: inputs that may stay unwired. sizes: ports that are vectors. defaults: raw values of parameters that
    the diagram does not give. An empty `Ports` (`known` False) leaves the ports to be found from the wires.
    """

    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    optional: frozenset[str] = frozenset()
    sizes: Mapping[str, int] = field(default_factory=dict)
    defaults: Mapping[str, Any] = field(default_factory=dict)
    known: bool = True

    @classmethod
    def of(cls, interface: Interface) -> Ports:
        """The ports of a block type whose sizes are known."""
        inputs, outputs = interface.inputs, interface.outputs
        parameters = interface.declaration.parameters
        return cls(
            tuple(inputs),
            tuple(outputs),
            frozenset(name for name, port in inputs.items() if port.default is not None),
            {name: port.size for name, port in (*inputs.items(), *outputs.items()) if port.shape},
            {n: p.default for n, p in parameters.items() if p.default is not REQUIRED and not callable(p.default)},
        )


UNKNOWN = Ports(known=False)


def ports_of(diagram: DiagramValue, resolver: Resolver) -> Callable[[str], Ports]:
    """The ports of any block of a diagram by its path ("control_right.td"); `UNKNOWN` where it has faults.

    resolver: from the name of a type to its class, as for `flatten`.
    """
    made: dict[str, Ports] = {}

    def find(path: str) -> Ports:
        if path not in made:
            made[path] = _ports(diagram, path.split("."), resolver)
        return made[path]

    return find


def _ports(diagram: DiagramValue, steps: list[str], resolver: Resolver) -> Ports:
    for step in steps[:-1]:
        inner = diagram.blocks[step].inner
        if inner is None:
            return UNKNOWN
        diagram = inner
    name = steps[-1]
    # Alone, so that the faults of its neighbors do not hide its ports.
    probe = replace(diagram, blocks={name: diagram.blocks[name]}, measures={}, run={}, layout={})
    try:
        return Ports.of(interface_of(probe, name, resolver))
    except (ModelError, AssertionError, KeyError):
        return UNKNOWN
