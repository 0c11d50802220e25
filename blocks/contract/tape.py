"""The equations of one block type as a tape of scalar operations.

A `Tape` is what every engine prints its code from: nodes in an order in which each needs only earlier ones. It says
exactly, element by element, what each result depends on. `tracing` makes it, of the equations run once on symbols
(`symbols`, whose elements are recorded as `scalars`), and its derivatives (`derivatives`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from .captured_values import Outside
from .closure import closure
from .interface import Interface


@dataclass(frozen=True, slots=True)
class Argument:
    """A scalar that equations read, or a whole table: its kind, the variable, and the element."""

    kind: str  # time, tick, parameter, table, input, state, discrete, algebraic, history, output, held, side, local
    name: str
    element: int = 0


@dataclass(frozen=True, slots=True)
class TapeNode:
    """One scalar operation, of those of `scalars.OPERATIONS`, or an "argument" or a "constant": these have no operands,
    and `value` is the index or the number."""

    op: str
    operands: tuple[int, ...] = ()
    value: float = 0.0


@dataclass(frozen=True, slots=True)
class Result:
    """What one equation computes, in one of its roles: the nodes of its elements in C order."""

    key: str
    role: str  # output, local, derivative, residual, initial, next, crossing, event_time, reset, phase
    target: str  # the variable's name
    cause: str  # the crossing or event time that calls a reset
    clock: str  # the equation that holds the clock of a sampled result, or ""
    nodes: tuple[int, ...]


@dataclass(frozen=True)
class Tape:
    """All results of one block type over one list of arguments.

    quick: for nodes that divide by a function of parameters alone, the node that multiplies by its reciprocal instead,
    which is computed once: the same value but for rounding. What jumps (floor, comparisons) never reads it. outside:
    what the equations of a traced one have read from outside of their class.
    """

    interface: Interface
    arguments: tuple[Argument, ...]
    nodes: tuple[TapeNode, ...]
    results: Mapping[str, Result]
    quick: Mapping[int, int] = field(default_factory=dict)
    periodic: Mapping[int, int] = field(default_factory=dict)
    is_fine: bool = False
    outside: Outside | None = field(default=None, repr=False, compare=False)

    @property
    def name(self) -> str:
        """The name of the type."""
        return self.interface.name

    @property
    def describing(self) -> str:
        """Which describing function y has of u, where its block remembers u; "": as the nodes say."""
        return self.interface.declaration.describing

    def type_of(self, variable: str) -> str | None:
        """The type of a variable that equations read or give ("real", "bool", "int", ...); None: no such variable."""
        known = self.interface.declaration.readable.get(variable)
        return None if known is None else known.type

    def shape_of(self, variable: str) -> tuple[int, ...] | None:
        """The shape of a variable; None: no such variable."""
        known = self.interface.declaration.readable.get(variable)
        return None if known is None else self.interface.shape(known)

    @cached_property
    def equation_of(self) -> dict[str, str]:
        """By the role and the target of a result ("derivative:x"), the name of the equation that gives it."""
        names: dict[str, str] = {}
        for equation in self.interface.declaration.equations:
            for role in equation.roles:
                if role.target is not None:
                    names.setdefault(f"{role.kind}:{role.target.name}", equation.name)
        return names

    @cached_property
    def reads(self) -> tuple[int, ...]:
        """For each node the arguments that it depends on, as a bit set."""
        bit_sets: list[int] = []
        for node in self.nodes:
            bits = 1 << int(node.value) if node.op == "argument" else 0
            for operand in node.operands:
                bits |= bit_sets[operand]
            bit_sets.append(bits)
        return tuple(bit_sets)

    def arguments_of(self, node: int) -> tuple[int, ...]:
        """The arguments that a node depends on, in order."""
        bits, indices, index = self.reads[node], [], 0
        while bits:
            if bits & 1:
                indices.append(index)
            bits >>= 1
            index += 1
        return tuple(indices)

    @cached_property
    def read_by(self) -> dict[str, tuple[tuple[int, ...], ...]]:
        """By result and element the arguments that it depends on, in order."""
        return {key: tuple(map(self.arguments_of, result.nodes)) for key, result in self.results.items()}

    @cached_property
    def fed_by(self) -> dict[str, tuple[tuple[int, ...], ...]]:
        """By result and element the arguments that it depends on and that may be computed by others, in order."""
        # The time of an enabled subdiagram is computed.
        own = [argument.kind in ("tick", "parameter", "table") for argument in self.arguments]
        return {
            key: tuple(tuple(k for k in arguments if not own[k]) for arguments in elements)
            for key, elements in self.read_by.items()
        }

    @cached_property
    def delayed(self) -> dict[str, str]:
        """By history the input that it delays."""
        return {name: history.of.name for name, history in self.interface.declaration.histories.items()}

    @cached_property
    def sampled_locals(self) -> frozenset[str]:
        """The locals that sampled equations alone read."""
        declaration = self.interface.declaration
        return frozenset(name for name in declaration.locals if declaration.is_of_ticks(name))

    @cached_property
    def rearranged(self) -> frozenset[str]:
        """The output ports that are nothing but inputs in another order."""
        outputs = self.interface.declaration.outputs
        wiring = {name for name, output in outputs.items() if output.wiring}
        return frozenset(port for port, known in self.interface.outputs.items() if known.variable in wiring)

    @cached_property
    def order(self) -> dict[str, int]:
        """The place of each result among all."""
        return {key: place for place, key in enumerate(self.results)}

    @cached_property
    def digest(self) -> str:
        """The SHA-256 of all that the tape computes and of the type's name, for keys; kept, as every plan that the
        tape is in asks for it."""
        return hashlib.sha256(repr(self.computed()).encode()).hexdigest()

    def computed(self) -> tuple[Any, ...]:
        """All that the tape computes, and the type's name."""
        results, quick = list(self.results.items()), sorted(self.quick.items())
        return (self.arguments, self.nodes, results, quick, self.interface.name)

    @cached_property
    def orders(self) -> dict[tuple[int, ...], Any]:
        """By nodes, how they are computed: kept here by callers that compute the same ones repeatedly."""
        return {}

    @cached_property
    def kept(self) -> dict[str, Any]:
        """What was derived from the whole tape: kept here by callers, each under a name of its own."""
        return {}

    def needed(self, results: Iterable[int]) -> list[int]:
        """The nodes that these nodes need, themselves included, in order."""
        return nodes_needed(self.nodes, results)


def nodes_needed(nodes: Sequence[TapeNode], results: Iterable[int]) -> list[int]:
    """The nodes that these nodes need, themselves included, in order."""
    return sorted(closure(results, lambda node: nodes[node].operands))
