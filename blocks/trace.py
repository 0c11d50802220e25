"""The equations of one block type, run once on symbols and kept as a tape of scalar operations.

A `Tape` is what every engine prints its code from: nodes in an order in which each needs only earlier ones. It says
exactly, element by element, what each result depends on. Nothing below this module knows CasADi.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from .declare import Discrete, Equation, Local, Output, Role
from .errors import DeclarationError, Fault
from .interface import Interface

__all__ = ["Argument", "Node", "Result", "Tape", "numeric", "trace"]

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, slots=True)
class Argument:
    """A scalar that equations read: its kind, the variable, and the element."""

    kind: str  # time, tick, parameter, input, state, discrete, output, held, side
    name: str
    element: int = 0


@dataclass(frozen=True, slots=True)
class Node:
    """One scalar operation. `op` "argument" and "constant" have no operands; `value` is the index or the number."""

    op: str
    operands: tuple[int, ...] = ()
    value: float = 0.0


@dataclass(frozen=True, slots=True)
class Result:
    """What one equation computes, in one of its roles: the nodes of its elements in C order."""

    key: str
    role: str  # output, local, derivative, initial, next, crossing, event_time, reset
    target: str  # the variable's name
    cause: str  # the crossing or event time that calls a reset
    clock: str  # the equation that holds the clock of a sampled result, or ""
    nodes: tuple[int, ...]


@dataclass(frozen=True)
class Tape:
    """All results of one block type over one list of arguments."""

    interface: Interface
    arguments: tuple[Argument, ...]
    nodes: tuple[Node, ...]
    results: Mapping[str, Result]

    @cached_property
    def reads(self) -> tuple[int, ...]:
        """For each node the arguments that it depends on, as a bit set."""
        made: list[int] = []
        for node in self.nodes:
            bits = 1 << int(node.value) if node.op == "argument" else 0
            for operand in node.operands:
                bits |= made[operand]
            made.append(bits)
        return tuple(made)

    def arguments_of(self, node: int) -> tuple[int, ...]:
        """The arguments that a node depends on, in order."""
        bits, found, index = self.reads[node], [], 0
        while bits:
            if bits & 1:
                found.append(index)
            bits >>= 1
            index += 1
        return tuple(found)

    def needed(self, results: Iterable[int]) -> list[int]:
        """The nodes that these nodes need, themselves included, in order."""
        wanted: set[int] = set()
        stack = list(results)
        while stack:
            node = stack.pop()
            if node not in wanted:
                wanted.add(node)
                stack.extend(self.nodes[node].operands)
        return sorted(wanted)


_TAPES: dict[Interface, Tape] = {}
_LOCK = threading.Lock()  # CasADi's symbols are not made for two threads at once


def trace(interface: Interface) -> Tape:
    """The tape of a block type, traced once per process.

    Raises DeclarationError (E407) naming the block, the equation and the cure, where an equation cannot be traced.
    """
    with _LOCK:
        if interface not in _TAPES:
            _TAPES[interface] = _Tracer(interface).tape()
        return _TAPES[interface]


class _Values:
    """The values that equations read, by name; locals are computed when first read."""

    def __init__(self, interface: Interface, known: Mapping[str, Any], run: Callable[[Equation, str], Any]) -> None:
        self.interface, self.known, self.run = interface, dict(known), run

    def __getitem__(self, name: str) -> Any:
        if name not in self.known:
            local = self.interface.declaration.locals[name]
            self.known[name] = self.run(local.equation, "")
        return self.known[name]


class _Tracer:
    def __init__(self, interface: Interface) -> None:
        from . import symbols

        self.symbols, self.interface = symbols, interface
        self.arguments: list[Argument] = []
        self.scalars: list[Any] = []
        d = interface.declaration
        known: dict[str, Any] = dict(interface.structural)
        known["t"] = self._symbol("time", "t", ())
        known["tick"] = self._symbol("tick", "tick", ())
        for name, variable in d.readable.items():
            if name in interface.structural or isinstance(variable, Local):
                continue
            if name in d.parameters:
                if name in interface.symbolic_parameters:
                    known[name] = self._parameter(name)
            elif not (isinstance(variable, Output) and variable.wiring):
                kind = "held" if isinstance(variable, Output) and variable.clock else _KINDS[type(variable).__name__]
                known[name] = self._symbol(kind, name, interface.shape(variable), logical=variable.type == "bool")
        self.values = _Values(interface, known, self._run)

    def _symbol(self, kind: str, name: str, shape: tuple[int, ...], *, logical: bool = False) -> Any:
        made = self.symbols.symbol(name, shape, logical=logical)
        for element, scalar in enumerate(made.items.ravel()):
            self.arguments.append(Argument(kind, name, element))
            self.scalars.append(scalar)
        return made

    def _parameter(self, name: str) -> Any:
        parameter = self.interface.declaration.parameters[name]
        made = self._symbol(
            "parameter", name, self.interface.shape(parameter), logical=parameter.type == "bool"
        )
        pattern = self.interface.patterns.get(name)
        if pattern is not None:
            zero = self.symbols.constant(0.0).items[()]
            flat = [item if keep else zero for item, keep in zip(made.items.ravel(), pattern, strict=True)]
            items = np.empty(len(flat), dtype=object)
            items[:] = flat
            made = self.symbols.Symbols(items.reshape(made.shape))
        return made

    def _run(self, equation: Equation, place: str) -> Any:
        values = [self.values[name] for name in equation.reads]
        try:
            return equation.function(*values)
        except DeclarationError:
            raise
        except Exception as error:  # a user's function may raise anything; each is told with its place
            raise self._refusal(equation, str(error) or type(error).__name__) from error

    def _refusal(self, equation: Equation, message: str) -> DeclarationError:
        return DeclarationError(
            Fault("E407", f"{self.interface.name}.{equation.name}", f"cannot be traced: {message}")
        )

    def tape(self) -> Tape:
        import casadi

        scalars: list[Any] = []
        results: dict[str, tuple[Result, int, int]] = {}
        for equation in self.interface.declaration.equations:
            if equation.roles[0].kind == "output" and getattr(equation.roles[0].target, "wiring", False):
                continue
            value = self.values[equation.name] if equation.roles[0].kind == "local" else self._run(equation, "")
            try:
                made, shape, logical = self.symbols.elements(value)
            except (TypeError, ValueError) as error:
                raise self._refusal(equation, str(error)) from error
            for role in equation.roles:
                made = self._fitted(equation, role, made, shape, logical)
                target = role.target.name if role.target is not None else ""
                cause = role.cause.name if role.cause is not None else ""
                key = f"{role.kind}:{target}" + (f":{cause}" if cause else "")
                result = Result(key, role.kind, target, cause, equation.name if role.clock else "", ())
                results[key] = (result, len(scalars), len(scalars) + len(made))
                scalars += made
        nodes, outputs = _nodes(casadi, self.scalars, scalars, len(self.arguments))
        finished = {
            key: Result(r.key, r.role, r.target, r.cause, r.clock, tuple(outputs[first:last]))
            for key, (r, first, last) in results.items()
        }
        return Tape(self.interface, tuple(self.arguments), nodes, finished)

    def _fitted(self, equation: Equation, role: Role, made: list[Any], shape: tuple[int, ...], logical: bool) -> Any:
        """The elements in the shape that the role's variable has; a scalar fills an array."""
        variable = role.target
        if variable is None or role.kind == "local":
            return made
        needed = self.interface.shape(variable)
        if role.kind in ("crossing", "event_time"):
            wants_bool = False
        else:
            wants_bool = isinstance(variable, (Discrete, Output)) and variable.type == "bool"
        if wants_bool and not logical:
            raise self._refusal(equation, f"'{variable.name}' is a bool, but the equation gives a number.")
        if role.kind == "crossing" and logical:
            raise self._refusal(
                equation, "a crossing gives a number whose sign is the side, not a bool. Return a difference."
            )
        if shape == needed:
            return made
        if shape == () and needed != ():
            return made * int(np.prod(needed))
        raise self._refusal(
            equation, f"gives the shape {shape or 'of a scalar'}, but '{variable.name}' has {needed or 'a scalar'}."
        )


_KINDS = {"Input": "input", "State": "state", "Discrete": "discrete", "Output": "output", "Crossing": "side"}


def _nodes(casadi: Any, arguments: list[Any], results: list[Any], count: int) -> tuple[tuple[Node, ...], list[int]]:
    """CasADi's instructions as nodes in which every value has one place."""
    function = casadi.Function("f", [casadi.vertcat(*arguments)], [casadi.vertcat(*results)] if results else [])
    names = {getattr(casadi, name): name[3:].lower() for name in dir(casadi) if name.startswith("OP_")}
    nodes = [Node("argument", (), float(index)) for index in range(count)]
    register: dict[int, int] = {}
    outputs = [0] * len(results)
    known: dict[Node, int] = {}

    def add(node: Node) -> int:
        # One place for equal nodes: CasADi itself looks for common parts only when asked.
        if node not in known:
            known[node] = len(nodes)
            nodes.append(node)
        return known[node]

    for k in range(function.n_instructions()):
        op = names[function.instruction_id(k)]
        source, target = function.instruction_input(k), function.instruction_output(k)
        if op == "input":
            register[target[0]] = source[1]
        elif op == "output":
            outputs[target[1]] = register[source[0]]
        elif op == "const":
            register[target[0]] = add(Node("constant", (), function.instruction_constant(k)))
        else:
            operands = tuple(register[i] for i in source)
            register[target[0]] = add(_simplified(op, operands, nodes))
    return tuple(nodes), outputs


def _simplified(op: str, operands: tuple[int, ...], nodes: list[Node]) -> Node:
    """CasADi writes a choice as (c ? a : 0) + (!c ? b : 0); that is one node here: c ? a : b."""
    if op == "add":
        left, right = nodes[operands[0]], nodes[operands[1]]
        if left.op == right.op == "if_else_zero":
            first, second = nodes[left.operands[0]], nodes[right.operands[0]]
            if second.op == "not" and second.operands == (left.operands[0],):
                return Node("choose", (left.operands[0], left.operands[1], right.operands[1]))
            if first.op == "not" and first.operands == (right.operands[0],):
                return Node("choose", (right.operands[0], right.operands[1], left.operands[1]))
    return Node(op, operands)


def numeric(interface: Interface, values: Mapping[str, Any]) -> dict[str, Array]:
    """Every result of a type computed by its own Python functions on numbers: the witness of the tape.

    values: all that equations read, by name, including t and tick. Returns arrays by result key.
    """
    known = {**interface.structural, **values}
    table = _Values(interface, known, lambda equation, _: equation.function(*(table[name] for name in equation.reads)))
    made: dict[str, Array] = {}
    for equation in interface.declaration.equations:
        for role in equation.roles:
            variable = role.target
            assert variable is not None
            if isinstance(variable, Output) and variable.wiring:
                continue
            value = np.asarray(table[equation.name] if role.kind == "local" else table.run(equation, ""), dtype=float)
            cause = f":{role.cause.name}" if role.cause is not None else ""
            shape = value.shape if role.kind == "local" else interface.shape(variable)
            made[f"{role.kind}:{variable.name}{cause}"] = np.broadcast_to(value, shape).ravel()
    return made
