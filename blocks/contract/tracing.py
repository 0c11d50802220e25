"""Equations run once on symbols, which makes the tape of a block type, and its exact derivatives.

The tape has the operations of the equations, as they are written. One tape is made at a time, as what symbols refuse is
noted in one place.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..text.errors import DeclarationError, Fault
from . import symbols
from .captured_values import outside
from .derivatives import derived
from .derived_nodes import are_whole, with_phases, with_reciprocals
from .equation_values import EquationValues, refusal
from .equations import Local, Output
from .interface import Interface
from .recorded_nodes import nodes_of
from .scalars import Scalar
from .tape import Argument, Result, Tape, TapeNode, nodes_needed
from .variables import Discrete, Equation, Role

_Kind = tuple[Interface, bool]
"""A type, and whether its tape is fine."""
_TAPES: dict[_Kind, Tape] = {}
_LOCK = threading.Lock()  # of what symbols refuse, and of the tapes
_KINDS = {
    "Input": "input",
    "State": "state",
    "Discrete": "discrete",
    "Algebraic": "algebraic",
    "History": "history",
    "Output": "output",
    "Stepped": "held",
    "Crossing": "side",
}


def trace(interface: Interface) -> Tape:
    """The tape of a block type, traced once, and anew where what its equations read from outside has changed.

    Raises DeclarationError (E407) naming the block, the equation and the cure, where an equation cannot be traced, and
    where one reads random numbers, a clock or files, or gives something else each time (E408).
    """
    with _LOCK:
        return _traced(interface, is_fine=False)


def fine(tape: Tape) -> Tape:
    """The tape of the same type in which each equation stands alone: a local that it reads is an argument.

    So the law of a local can be studied, or replaced, by itself. Raises DeclarationError (E407) where what the
    equations read from outside has changed since: both tapes are of the same equations.
    """
    with _LOCK:
        if tape.outside is not None and not tape.outside.holds():
            message = "values outside the class that its equations read have changed since the diagram was prepared."
            raise DeclarationError(Fault("E407", tape.interface.name, message, "Prepare the diagram again."))
        return _traced(tape.interface, is_fine=True)


def _traced(interface: Interface, *, is_fine: bool) -> Tape:
    read = outside(interface.declaration)
    cached = _TAPES.get((interface, is_fine))
    if cached is not None and cached.outside is read:
        return cached
    if read.impure:
        raise DeclarationError(*(_impure(interface, e, f"'{name}' gives {what}") for e, name, what in read.impure))
    tape = _Tracer(interface, is_fine=is_fine).tape()
    if read.is_opaque or not read.holds():  # they may give something else each time
        equation = _differing(tape, _Tracer(interface, is_fine=is_fine).tape())
        if equation:
            raise DeclarationError(_impure(interface, equation, "it returns something else at each call"))
    tape = replace(tape, outside=outside(interface.declaration))  # the equations may have changed it themselves
    _TAPES[interface, is_fine] = tape
    return tape


def _impure(interface: Interface, equation: str, why: str) -> Fault:
    message = f"is not pure: {why}, but blocks runs an equation once, so the value would stay constant in the run."
    cure = "Use t, tick, a parameter, an input, a table or a Noise block. A @stepper may call any code."
    return Fault("E408", f"{interface.name}.{equation}", message, cure)


def _differing(first: Tape, other: Tape) -> str:
    """The first equation that gives another expression in another tape of the same type; "" where there is none."""
    known: dict[object, int] = {}
    numbered: list[dict[str, list[int]]] = []
    for tape in (first, other):
        numbers: list[int] = []
        for node in tape.nodes:
            key = (node.op, tuple(numbers[k] for k in node.operands), repr(node.value))
            numbers.append(known.setdefault(key, len(known)))
        numbered.append({key: [numbers[n] for n in result.nodes] for key, result in tape.results.items()})
    for result in first.results.values():
        if numbered[0][result.key] != numbered[1][result.key]:
            for equation in first.interface.declaration.equations:
                for role in equation.roles:
                    if role.target is not None and (role.kind, role.target.name) == (result.role, result.target):
                        return equation.name
    return ""


def jacobian(tape: Tape, results: Sequence[tuple[str, int]], arguments: Sequence[int]) -> Tape:
    """Exact partial derivatives, as a tape over the same arguments.

    results: elements of results by key. arguments: the ones to derive by. The new tape has the result "value" with the
    elements asked for, and "partial" with their derivatives, (results, arguments) in C order; see `derivatives` for
    corners and choices.
    """
    known: dict[object, Tape] = tape.kept.setdefault("jacobians", {})
    key = (tuple(results), tuple(arguments))
    if key not in known:
        asked = [tape.results[name].nodes[element] for name, element in results]
        nodes, places = derived(tape.nodes, len(tape.arguments), asked, arguments)
        derivatives = {
            name: Result(name, name, name, "", "", tuple(indices))
            for name, indices in (("value", places[: len(asked)]), ("partial", places[len(asked) :]))
        }
        known.setdefault(key, Tape(tape.interface, tape.arguments, nodes, derivatives, is_fine=tape.is_fine))
    return known[key]


class _Tracer:
    def __init__(self, interface: Interface, *, is_fine: bool) -> None:
        self.interface, self.is_fine = interface, is_fine
        self.arguments: list[Argument] = []
        self.scalars: list[Scalar] = []
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
                elif name in interface.tables:
                    known[name] = symbols.SymbolicTable(interface.shape(variable))
                    self.arguments.append(Argument("table", name))
                    self.scalars.append(known[name].symbol)
            elif not (isinstance(variable, Output) and variable.wiring):
                held = isinstance(variable, Output) and variable.clock is not None
                kind = "held" if held else _KINDS[type(variable).__name__]
                known[name] = self._symbol(kind, name, interface.shape(variable), logical=variable.type == "bool")
        apart = (self._local,) if is_fine else ()
        self.values = EquationValues(interface, known, symbols.returned, *apart)
        symbols.begin()

    def _local(self, name: str, value: Any) -> object:
        return self._symbol("local", name, value.shape, logical=value.logical)

    def _symbol(self, kind: str, name: str, shape: tuple[int, ...], *, logical: bool = False) -> Any:
        symbolic = symbols.symbol(shape, logical=logical)
        for element, scalar in enumerate(symbolic.items.ravel()):
            self.arguments.append(Argument(kind, name, element))
            self.scalars.append(scalar)
        return symbolic

    def _parameter(self, name: str) -> Any:
        parameter = self.interface.declaration.parameters[name]
        symbolic = self._symbol("parameter", name, self.interface.shape(parameter), logical=parameter.type == "bool")
        pattern = self.interface.patterns.get(name)
        if pattern is not None:
            zero = symbols.constant(0.0).items[()]
            flat = [item if keep else zero for item, keep in zip(symbolic.items.ravel(), pattern, strict=True)]
            items = np.empty(len(flat), dtype=object)
            items[:] = flat
            symbolic = symbols.Symbols(items.reshape(symbolic.shape))
        return symbolic

    def tape(self) -> Tape:
        scalars: list[Scalar] = []
        results: dict[str, tuple[Result, int, int]] = {}
        for equation in self.interface.declaration.equations:
            if equation.roles[0].kind == "output" and getattr(equation.roles[0].target, "wiring", False):
                continue
            is_local = equation.roles[0].kind == "local"
            value = self.values.local(equation.name) if is_local else self.values.of(equation)
            for role in equation.roles:
                fitted = self._fitted(equation, role, *symbols.elements(value))
                target = role.target.name if role.target is not None else ""
                cause = role.cause.name if role.cause is not None else ""
                key = f"{role.kind}:{target}" + (f":{cause}" if cause else "")
                result = Result(key, role.kind, target, cause, equation.name if role.ticks else "", ())
                results[key] = (result, len(scalars), len(scalars) + len(fitted))
                scalars += fitted
        nodes, outputs = nodes_of(self.scalars, scalars)
        if not self.is_fine:  # the plain tape sees through locals, and was checked
            self._check_whole(nodes, results, outputs)
            self._check_residuals(nodes, results, outputs)
        finished = {
            key: Result(r.key, r.role, r.target, r.cause, r.clock, tuple(outputs[first:last]))
            for key, (r, first, last) in results.items()
        }
        if self.is_fine:
            return Tape(self.interface, tuple(self.arguments), nodes, finished, is_fine=True)
        nodes, quick = with_reciprocals(nodes, self.arguments)
        nodes, phases, periodic = with_phases(nodes, self.arguments, outputs)
        if phases:
            finished["phase"] = Result("phase", "phase", "phase", "", "", phases)
        return Tape(self.interface, tuple(self.arguments), nodes, finished, quick, periodic=periodic)

    def _check_residuals(
        self, nodes: Sequence[TapeNode], results: Mapping[str, tuple[Result, int, int]], outputs: Sequence[int]
    ) -> None:
        """Refuse residuals that do not depend on what they are to determine."""
        for result, first, last in results.values():
            if result.role != "residual":
                continue
            below = (nodes[n] for n in nodes_needed(nodes, outputs[first:last]))
            read = {self.arguments[int(node.value)].name for node in below if node.op == "argument"}
            d = self.interface.declaration
            if result.target not in read and not read & set(d.outputs):
                variable = d.algebraics[result.target]
                equation = next(e for e in d.equations for role in e.roles if role.target is variable)
                raise refusal(self.interface, equation, f"the residual does not depend on '{result.target}'.")

    def _check_whole(
        self, nodes: Sequence[TapeNode], results: Mapping[str, tuple[Result, int, int]], outputs: Sequence[int]
    ) -> None:
        """Refuse equations of ints and enumerations that may give something between two integers."""
        d = self.interface.declaration
        whole = are_whole(nodes, self.arguments, {name: v.type for name, v in d.readable.items()})
        for result, first, last in results.values():
            variable = d.readable.get(result.target)
            if not isinstance(variable, (Discrete, Output)) or variable.type in ("real", "bool"):
                continue
            if not all(whole[node] for node in outputs[first:last]):
                roles = [(e, role) for e in d.equations for role in e.roles]
                equation = next(e for e, role in roles if role.kind == result.role and role.target is variable)
                message = f"'{variable.name}' takes integers only, but the equation may return other numbers."
                raise refusal(self.interface, equation, f"{message} Use np.floor or np.round.")

    def _fitted(
        self, equation: Equation, role: Role, scalars: list[Scalar], shape: tuple[int, ...], logical: bool
    ) -> list[Scalar]:
        """The elements in the shape that the role's variable has; a scalar fills an array."""
        variable = role.target
        if variable is None or role.kind == "local":
            return scalars
        needed = self.interface.shape(variable)
        if role.kind in ("crossing", "event_time"):
            wants_bool = False
        else:
            wants_bool = isinstance(variable, (Discrete, Output)) and variable.type == "bool"
        if wants_bool and not logical:
            raise refusal(self.interface, equation, f"'{variable.name}' is a bool, but the equation returns a number.")
        wants_whole = variable.type not in ("real", "bool") and isinstance(variable, (Discrete, Output))
        if wants_whole and logical:
            what = "an int" if variable.type == "int" else "an enumeration"
            message = f"'{variable.name}' is {what}, but the equation returns a bool. Use np.where(condition, 1, 0)."
            raise refusal(self.interface, equation, message)
        if role.kind == "event_time" and logical:
            raise refusal(self.interface, equation, "an event time is a time in s, not a bool.")
        if role.kind == "crossing" and logical:
            raise refusal(
                self.interface,
                equation,
                "a crossing must return a number whose sign is the side, not a bool. Return a difference.",
            )
        if shape == needed:
            return scalars
        if shape == () and needed != () and role.kind != "residual":
            return scalars * int(np.prod(needed))
        raise refusal(
            self.interface,
            equation,
            f"returns the shape {shape}, but '{variable.name}' has the shape {needed} (a scalar: ()).",
        )
