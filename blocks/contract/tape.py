"""The equations of one block type, run once on symbols and kept as a tape of scalar operations.

A `Tape` is what every engine prints its code from: nodes in an order in which each needs only earlier ones. It says
exactly, element by element, what each result depends on. Nothing below this module knows CasADi.

The tape has the operations of the equations, as they are written: CasADi's own simplifications are off, because some
change the meaning (sqrt(x)**2 -> x, x/x -> 1, x == x -> true). What is simplified here is what tells that a zero makes
no dependency (0 x -> 0, 0/x -> 0, also where x is inf or NaN) and what costs nothing (1 x, x/1, x + 0). The sign of a
zero is not kept: CasADi has no constant -0.0.
"""

from __future__ import annotations

import hashlib
import math
import operator
import os
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np

from ..fmi.schema import Variable
from ..text.errors import DeclarationError, Fault
from .equations import Local, Output
from .interface import Interface
from .outside import Outside, outside
from .variables import Discrete, Equation, Role

__all__ = [
    "OPERATIONS",
    "Argument",
    "Node",
    "Opaque",
    "OpaqueItem",
    "Result",
    "Tape",
    "fine",
    "jacobian",
    "numeric",
    "trace",
]

OPERATIONS = frozenset({
    *("argument", "constant", "choose", "add", "sub", "mul", "div", "neg", "pow", "sqrt", "exp", "expm1", "log"),
    *("log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
    *("hypot", "fabs", "sign", "floor", "ceil", "fmod", "copysign", "fmin", "fmax", "lt", "le", "eq", "ne"),
    *("and", "or", "not", "search", "pick"),
})  # fmt: skip
"""All that a tape of equations holds. They mean what C's functions mean, but fmin and fmax are NaN where an operand is,
and sign(x) is x where x is neither above nor below 0. Comparisons give 1 or 0; `choose` (c, a, b) is a where c is 1,
else b, and takes nothing from the other; and, or, not are for 1 and 0. `search` (x, table) and `pick` (index, table)
are those of `blocks.contract.table_lookup`; their second operand is an argument that is a table. The tape of an FMU
has `foreign` in their place: what the FMU gives (`Tape.opaque` says what, by its value) where time, states and inputs
are its operands.
"""

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, slots=True)
class Argument:
    """A scalar that equations read, or a whole table: its kind, the variable, and the element."""

    kind: str  # time, tick, parameter, table, input, state, discrete, algebraic, history, output, held, side, local
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
    role: str  # output, local, derivative, residual, initial, next, crossing, event_time, reset, phase
    target: str  # the variable's name
    cause: str  # the crossing or event time that calls a reset
    clock: str  # the equation that holds the clock of a sampled result, or ""
    nodes: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class OpaqueItem:
    """One number that an FMU gives.

    kind: "state", "derivative" and "indicator" by their index, "value" (an element of a variable), "event_time";
    "given": an argument itself; "number"; "partial": the derivative of another item by an argument. scale: what 1 of it
    is in SI.
    """

    kind: str
    index: int
    variable: Variable | None = None
    scale: float = 1.0
    of: OpaqueItem | None = None


@dataclass(frozen=True, slots=True)
class Opaque:
    """How the nodes of an FMU for Model Exchange are had.

    items: what each `foreign` node is, by its value. states: in the order of the FMU, the argument of each and its
    scale. inputs: of each the argument, the variable and its element, and the scale. indicators: how many.
    """

    fmi: int
    items: tuple[OpaqueItem, ...]
    states: tuple[tuple[int, float], ...]
    inputs: tuple[tuple[int, Variable, int, float], ...]
    indicators: int


@dataclass(frozen=True)
class Tape:
    """All results of one block type over one list of arguments.

    quick: for nodes that divide by what only parameters make, the node that multiplies by its reciprocal instead, which
    need be computed but once: the same value but for rounding. What jumps (floor, comparisons) never sees it. opaque:
    of an FMU, what its nodes are. traced: of one that was traced, the symbols that it was made of.
    """

    interface: Interface
    arguments: tuple[Argument, ...]
    nodes: tuple[Node, ...]
    results: Mapping[str, Result]
    quick: Mapping[int, int] = field(default_factory=dict)
    opaque: Opaque | None = None
    periodic: Mapping[int, int] = field(default_factory=dict)
    is_fine: bool = False
    traced: Traced | None = field(default=None, repr=False, compare=False)

    @property
    def name(self) -> str:
        """The name of the type."""
        return self.interface.name

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
        made: dict[str, str] = {}
        for equation in self.interface.declaration.equations:
            for role in equation.roles:
                if role.target is not None:
                    made.setdefault(f"{role.kind}:{role.target.name}", equation.name)
        return made

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
    def order(self) -> dict[str, int]:
        """The place of each result among all."""
        return {key: place for place, key in enumerate(self.results)}

    @cached_property
    def digest(self) -> str:
        """The SHA-256 of all that the tape computes and of the type's name, for keys: a tape lives as long as its type,
        and is asked for its digest by every plan that it is in."""
        results, quick = list(self.results.items()), sorted(self.quick.items())
        parts: tuple[Any, ...] = (self.arguments, self.nodes, results, quick, self.interface.name)
        parts += (self.opaque,) if self.opaque is not None else ()
        return hashlib.sha256(repr(parts).encode()).hexdigest()

    @cached_property
    def orders(self) -> dict[tuple[int, ...], Any]:
        """By nodes, how they are computed: kept here by those who compute the same ones again and again."""
        return {}

    @cached_property
    def kept(self) -> dict[str, Any]:
        """What was made of the whole tape: kept here, each under a name of its own, by those who make it once."""
        return {}

    def needed(self, results: Iterable[int]) -> list[int]:
        """The nodes that these nodes need, themselves included, in order."""
        return _needed(self.nodes, results)


def _needed(nodes: Sequence[Node], results: Iterable[int]) -> list[int]:
    wanted: set[int] = set()
    stack = list(results)
    while stack:
        node = stack.pop()
        if node not in wanted:
            wanted.add(node)
            stack.extend(nodes[node].operands)
    return sorted(wanted)


@dataclass(slots=True, eq=False)
class Traced:
    """What a tape was made of: CasADi's symbols of its arguments, results and lookups, and what was read from outside.

    jacobians: those that were made of it.
    """

    scalars: list[Any]
    results: dict[str, list[Any]]
    lookups: list[Any]
    outside: Outside
    jacobians: dict[tuple[tuple[tuple[str, int], ...], tuple[int, ...]], Tape] = field(default_factory=dict)


_Kind = tuple[Interface, bool]
"""A type, and whether its tape is fine."""
_TAPES: dict[_Kind, Tape] = {}
_LOCK = threading.Lock()  # CasADi's symbols are not made for two threads at once


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
    equations read from outside has changed since: both tapes tell of the same equations.
    """
    with _LOCK:
        if tape.traced is not None and not tape.traced.outside.holds():
            message = "what its equations read from outside has changed since the diagram was prepared."
            raise DeclarationError(Fault("E407", tape.interface.name, message, "Prepare it anew."))
        return _traced(tape.interface, is_fine=True)


def _traced(interface: Interface, *, is_fine: bool) -> Tape:
    read = outside(interface.declaration)
    found = _TAPES.get((interface, is_fine))
    if found is not None and found.traced is not None and found.traced.outside is read:
        return found
    if read.impure:
        raise DeclarationError(*(_impure(interface, e, f"'{name}' gives {what}") for e, name, what in read.impure))
    made = _newly_traced(interface, read, is_fine=is_fine)
    if read.is_opaque or not read.holds():  # they may give something else each time
        equation = _differing(made, _newly_traced(interface, read, is_fine=is_fine))
        if equation:
            raise DeclarationError(_impure(interface, equation, "it gives something else each time that it is asked"))
    assert made.traced is not None
    made.traced.outside = outside(interface.declaration)  # the equations may have changed it themselves
    _TAPES[interface, is_fine] = made
    return made


def _impure(interface: Interface, equation: str, why: str) -> Fault:
    message = f"is not pure: {why}, and equations are run once, so that it would be a constant of the run."
    cure = "Use t, tick, a parameter, an input or a table. Noise makes noise, and a @stepper may do what it likes."
    return Fault("E408", f"{interface.name}.{equation}", message, cure)


def _differing(one: Tape, other: Tape) -> str:
    """The first equation that gives another expression in another tape of the same type; "" where there is none."""
    known: dict[Any, int] = {}
    found: list[dict[str, list[int]]] = []
    for tape in (one, other):
        made: list[int] = []
        for node in tape.nodes:
            key = (node.op, tuple(made[k] for k in node.operands), repr(node.value))
            made.append(known.setdefault(key, len(known)))
        found.append({key: [made[n] for n in result.nodes] for key, result in tape.results.items()})
    for result in one.results.values():
        if found[0][result.key] != found[1][result.key]:
            for equation in one.interface.declaration.equations:
                for role in equation.roles:
                    if role.target is not None and (role.kind, role.target.name) == (result.role, result.target):
                        return equation.name
    return ""


def _newly_traced(interface: Interface, read: Outside, *, is_fine: bool) -> Tape:
    import casadi

    options = casadi.GlobalOptions
    simplifies = options.getSimplificationOnTheFly()
    options.setSimplificationOnTheFly(False)
    try:
        return _Tracer(interface, read, is_fine=is_fine).tape()
    finally:
        options.setSimplificationOnTheFly(simplifies)


def jacobian(tape: Tape, results: Sequence[tuple[str, int]], arguments: Sequence[int]) -> Tape:
    """Exact partial derivatives, as a tape over the same arguments.

    results: elements of results by key. arguments: the ones to derive by. The new tape has the result "value" with the
    elements asked for, and "partial" with their derivatives, (results, arguments) in C order. Where a function has a
    corner, the derivative is that of one of its sides.
    """
    import casadi

    traced = tape.traced
    assert traced is not None  # an FMU gives its derivatives itself
    known = (tuple(results), tuple(arguments))
    with _LOCK:
        if known in traced.jacobians:
            return traced.jacobians[known]
        asked = [traced.results[key][element] for key, element in results]
        # A lookup is constant between the points of its table, so the symbol that stands for it is one here too.
        matrix = casadi.jacobian(casadi.vertcat(*asked), casadi.vertcat(*(traced.scalars[k] for k in arguments)))
        matrix = casadi.densify(matrix)  # or its zeros would have no node
        partials = [matrix[i, j] for i in range(len(asked)) for j in range(len(arguments))]
        nodes, outputs = _nodes(casadi, traced.scalars, [*asked, *partials], traced.lookups)
    made = {
        key: Result(key, key, key, "", "", tuple(places))
        for key, places in (("value", outputs[: len(asked)]), ("partial", outputs[len(asked) :]))
    }
    return traced.jacobians.setdefault(known, Tape(tape.interface, tape.arguments, nodes, made, is_fine=tape.is_fine))


def _refusal(
    interface: Interface, equation: Equation, message: str, error: BaseException | None = None
) -> DeclarationError:
    """E407, with the line of the equation where the `error` came up, or where it begins, if that stands in a file."""
    fault = Fault("E407", f"{interface.name}.{equation.name}", f"cannot be traced: {message}")
    code = getattr(equation.function, "__code__", None)
    if code is None or not os.path.isfile(code.co_filename):
        return DeclarationError(fault)
    line, column = code.co_firstlineno, 0
    frame = error.__traceback__ if error is not None else None
    while frame is not None:
        if frame.tb_frame.f_code is code:
            line, column = frame.tb_lineno, [*code.co_positions()][frame.tb_lasti // 2][2] or 0
        frame = frame.tb_next
    return DeclarationError(fault.at(code.co_filename, line, column + 1))


class _Values:
    """The values that equations read, by name; locals are computed when first read.

    seen: what the other equations see of a local, by its name and what it gives.
    """

    def __init__(
        self,
        interface: Interface,
        known: Mapping[str, Any],
        made: Callable[[Any], Any],
        seen: Callable[[str, Any], Any] = lambda name, value: value,
    ) -> None:
        self.interface, self.known, self.made, self.seen = interface, dict(known), made, seen
        self.given: dict[str, Any] = {}  # by locals

    def __getitem__(self, name: str) -> Any:
        if name not in self.known:
            self.known[name] = self.seen(name, self.local(name))
        return self.known[name]

    def local(self, name: str) -> Any:
        """What the equation of a local gives."""
        if name not in self.given:
            self.given[name] = self.of(self.interface.declaration.locals[name].equation)
        return self.given[name]

    def of(self, equation: Equation) -> Any:
        """What an equation gives, as an array. Raises DeclarationError (E407), with the cause."""
        values = [self[name] for name in equation.reads]
        try:
            return self.made(equation.function(*values))
        except Exception as error:  # a user's function may raise anything; each is told with its place
            cause = error.__cause__ if isinstance(error.__cause__, TypeError) else error  # numpy hides what refused
            text = str(cause) if isinstance(cause, TypeError) else f"{type(error).__name__}: {error}"
            raise _refusal(self.interface, equation, text, error) from error


class _Tracer:
    def __init__(self, interface: Interface, outside: Outside, *, is_fine: bool = False) -> None:
        import blocks.contract.symbols as symbols  # heavy: it loads CasADi

        self.symbols, self.interface, self.outside, self.is_fine = symbols, interface, outside, is_fine
        self.arguments: list[Argument] = []
        self.scalars: list[Any] = []
        self.lookups: list[Any] = []
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
                    known[name] = symbols.Table(name, interface.shape(variable), self.lookups)
                    self.arguments.append(Argument("table", name))
                    self.scalars.append(known[name].symbol)
            elif not (isinstance(variable, Output) and variable.wiring):
                held = isinstance(variable, Output) and variable.clock is not None
                kind = "held" if held else _KINDS[type(variable).__name__]
                known[name] = self._symbol(kind, name, interface.shape(variable), logical=variable.type == "bool")
        apart = (self._local,) if is_fine else ()
        self.values = _Values(interface, known, symbols.returned, *apart)
        symbols.begin()

    def _local(self, name: str, value: Any) -> Any:
        return self._symbol("local", name, value.shape, logical=value.logical)

    def _symbol(self, kind: str, name: str, shape: tuple[int, ...], *, logical: bool = False) -> Any:
        made = self.symbols.symbol(name, shape, logical=logical)
        for element, scalar in enumerate(made.items.ravel()):
            self.arguments.append(Argument(kind, name, element))
            self.scalars.append(scalar)
        return made

    def _parameter(self, name: str) -> Any:
        parameter = self.interface.declaration.parameters[name]
        made = self._symbol("parameter", name, self.interface.shape(parameter), logical=parameter.type == "bool")
        pattern = self.interface.patterns.get(name)
        if pattern is not None:
            zero = self.symbols.constant(0.0).items[()]
            flat = [item if keep else zero for item, keep in zip(made.items.ravel(), pattern, strict=True)]
            items = np.empty(len(flat), dtype=object)
            items[:] = flat
            made = self.symbols.Symbols(items.reshape(made.shape))
        return made

    def tape(self) -> Tape:
        import casadi

        scalars: list[Any] = []
        results: dict[str, tuple[Result, int, int]] = {}
        for equation in self.interface.declaration.equations:
            if equation.roles[0].kind == "output" and getattr(equation.roles[0].target, "wiring", False):
                continue
            is_local = equation.roles[0].kind == "local"
            value = self.values.local(equation.name) if is_local else self.values.of(equation)
            for role in equation.roles:
                made = self._fitted(equation, role, *self.symbols.elements(value))
                target = role.target.name if role.target is not None else ""
                cause = role.cause.name if role.cause is not None else ""
                key = f"{role.kind}:{target}" + (f":{cause}" if cause else "")
                result = Result(key, role.kind, target, cause, equation.name if role.ticks else "", ())
                results[key] = (result, len(scalars), len(scalars) + len(made))
                scalars += made
        nodes, outputs = _nodes(casadi, self.scalars, scalars, self.lookups)
        if not self.is_fine:  # the plain tape sees through locals, and was checked
            self._check_whole(nodes, results, outputs)
            self._check_residuals(nodes, results, outputs)
        by_key = {key: scalars[first:last] for key, (_, first, last) in results.items()}
        traced = Traced(self.scalars, by_key, self.lookups, self.outside)
        finished = {
            key: Result(r.key, r.role, r.target, r.cause, r.clock, tuple(outputs[first:last]))
            for key, (r, first, last) in results.items()
        }
        if self.is_fine:
            return Tape(self.interface, tuple(self.arguments), nodes, finished, is_fine=True, traced=traced)
        nodes, quick = _with_reciprocals(nodes, self.arguments)
        nodes, phases, periodic = _with_phases(nodes, self.arguments, outputs)
        if phases:
            finished["phase"] = Result("phase", "phase", "phase", "", "", phases)
        return Tape(self.interface, tuple(self.arguments), nodes, finished, quick, periodic=periodic, traced=traced)

    def _check_residuals(
        self, nodes: Sequence[Node], results: Mapping[str, tuple[Result, int, int]], outputs: Sequence[int]
    ) -> None:
        """Refuse residuals that do not depend on what they are to determine."""
        for result, first, last in results.values():
            if result.role != "residual":
                continue
            below = (nodes[n] for n in _needed(nodes, outputs[first:last]))
            read = {self.arguments[int(node.value)].name for node in below if node.op == "argument"}
            d = self.interface.declaration
            if result.target not in read and not read & set(d.outputs):
                variable = d.algebraics[result.target]
                equation = next(e for e in d.equations for role in e.roles if role.target is variable)
                raise _refusal(self.interface, equation, f"the residual does not depend on '{result.target}'.")

    def _check_whole(
        self, nodes: Sequence[Node], results: Mapping[str, tuple[Result, int, int]], outputs: Sequence[int]
    ) -> None:
        """Refuse equations of ints and enumerations that may give something between two integers."""
        d = self.interface.declaration
        whole = _whole(nodes, self.arguments, {name: v.type for name, v in d.readable.items()})
        for result, first, last in results.values():
            variable = d.readable.get(result.target)
            if not isinstance(variable, (Discrete, Output)) or variable.type in ("real", "bool"):
                continue
            if not all(whole[node] for node in outputs[first:last]):
                roles = [(e, role) for e in d.equations for role in e.roles]
                equation = next(e for e, role in roles if role.kind == result.role and role.target is variable)
                message = f"'{variable.name}' takes integers only, and what the equation gives may lie between two."
                raise _refusal(self.interface, equation, f"{message} Use np.floor or np.round.")

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
            raise _refusal(self.interface, equation, f"'{variable.name}' is a bool, but the equation gives a number.")
        wants_whole = variable.type not in ("real", "bool") and isinstance(variable, (Discrete, Output))
        if wants_whole and logical:
            what = "an int" if variable.type == "int" else "an enumeration"
            message = f"'{variable.name}' is {what}, but the equation gives a bool. Use np.where(condition, 1, 0)."
            raise _refusal(self.interface, equation, message)
        if role.kind == "event_time" and logical:
            raise _refusal(self.interface, equation, "an event time is a time in s, not a bool.")
        if role.kind == "crossing" and logical:
            raise _refusal(
                self.interface,
                equation,
                "a crossing gives a number whose sign is the side, not a bool. Return a difference.",
            )
        if shape == needed:
            return made
        if shape == () and needed != () and role.kind != "residual":
            return made * int(np.prod(needed))
        raise _refusal(
            self.interface,
            equation,
            f"gives the shape {shape or 'of a scalar'}, but '{variable.name}' has {needed or 'a scalar'}.",
        )


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


def _nodes(
    casadi: Any, arguments: list[Any], results: list[Any], lookups: list[Any]
) -> tuple[tuple[Node, ...], list[int]]:
    """CasADi's instructions as nodes, the arguments first; equal nodes are one, and what nothing needs is left out.

    What was looked up in tables comes in as arguments of their own, which are replaced by the lookups at the end.
    """
    count = len(arguments)
    arguments = [*arguments, *(lookup.result for lookup in lookups)]
    asked = [*results, *(item for lookup in lookups for item in (lookup.operand, lookup.table))]
    function = casadi.Function("f", [casadi.vertcat(*arguments)], [casadi.vertcat(*asked)] if asked else [])
    names = _operations()
    nodes = [Node("argument", (), float(index)) for index in range(len(arguments))]
    register: dict[int, int] = {}
    outputs = [0] * len(asked)
    zero = len(nodes)
    nodes.append(Node("constant", (), 0.0))
    known: dict[Node, int] = {nodes[zero]: zero}

    def add(node: Node) -> int:
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
            op, below = _plain(op, tuple(register[i] for i in source), add)
            made = _simplified(op, below, nodes)
            register[target[0]] = add(made) if isinstance(made, Node) else made
    # A choice that was not one half of another one: derivatives have such.
    nodes = [Node("choose", (*node.operands, zero)) if node.op == "if_else_zero" else node for node in nodes]
    if lookups:
        operands = outputs[len(results) :]
        ops = [lookup.op for lookup in lookups]
        nodes, outputs = _stitched(nodes, outputs[: len(results)], count, ops, operands)
    needed = [*range(count), *(n for n in _needed(nodes, outputs) if n >= count)]
    place = {n: k for k, n in enumerate(needed)}
    kept = (nodes[n] for n in needed)
    return (
        tuple(Node(node.op, tuple(place[n] for n in node.operands), node.value) for node in kept),
        [place[n] for n in outputs],
    )


_JUMPS = frozenset({"floor", "ceil", "fmod", "sign", "lt", "le", "eq", "ne", "search", "pick", "and", "or", "not"})


def _with_reciprocals(nodes: Sequence[Node], arguments: Sequence[Argument]) -> tuple[tuple[Node, ...], dict[int, int]]:
    """The nodes, with those behind them that multiply where these divide by parameters; and which stand for which."""
    kinds = [argument.kind for argument in arguments]
    fixed: list[bool] = []  # nothing but parameters and constants
    plain: list[bool] = []  # nothing but constants
    for node in nodes:
        if node.op == "argument":
            fixed.append(kinds[int(node.value)] == "parameter")
            plain.append(False)
        else:
            fixed.append(all(fixed[k] for k in node.operands))
            plain.append(all(plain[k] for k in node.operands))
    made = [*nodes]
    known: dict[Node, int] = {}
    quick: dict[int, int] = {}

    def add(node: Node) -> int:
        if node not in known:
            known[node] = len(made)
            made.append(node)
        return known[node]

    for n, node in enumerate(nodes):
        if fixed[n] or node.op in _JUMPS:
            continue
        if node.op == "choose":
            operands = (node.operands[0], *(quick.get(k, k) for k in node.operands[1:]))
        else:
            operands = tuple(quick.get(k, k) for k in node.operands)
        if node.op == "div" and fixed[node.operands[1]] and not plain[node.operands[1]]:
            one = add(Node("constant", (), 1.0))
            quick[n] = add(Node("mul", (operands[0], add(Node("div", (one, node.operands[1]))))))
        elif operands != node.operands:
            quick[n] = add(Node(node.op, operands, node.value))
    return tuple(made), quick


_MOVING = frozenset({"time", "input", "state", "algebraic", "history", "output"})
"""The kinds of arguments that may change between instants."""
_TURNS = {"sin": 1 / (2 * math.pi), "cos": 1 / (2 * math.pi), "tan": 1 / math.pi, "floor": 1.0, "ceil": 1.0}
"""By operations that repeat themselves, what a turn of their operand is; of those that jump, from jump to jump."""
_CELL = 0.25  # of a table: one may be passed where another operation may make a quarter turn


def _with_phases(
    nodes: Sequence[Node], arguments: Sequence[Argument], outputs: Sequence[int]
) -> tuple[tuple[Node, ...], tuple[int, ...], dict[int, int]]:
    """The nodes with those behind them that say how far periodic operations have turned; these; and whose they are."""
    made = [*nodes]
    known: dict[Node, int] = {}
    moves = [False] * len(nodes)
    phases: dict[int, int] = {}
    periodic: dict[int, int] = {}

    def add(node: Node) -> int:
        if node not in known:
            known[node] = len(made)
            made.append(node)
        return known[node]

    for n in _needed(nodes, outputs):
        node = nodes[n]
        if node.op == "argument":
            moves[n] = arguments[int(node.value)].kind in _MOVING
            continue
        moves[n] = any(moves[k] for k in node.operands)
        if not moves[n]:
            continue
        if node.op in _TURNS:
            scale = _TURNS[node.op]
            turns = add(Node("mul", (node.operands[0], add(Node("constant", (), scale))))) if scale != 1.0 else None
            place = node.operands[0] if turns is None else turns
        elif node.op == "fmod":
            place = add(Node("div", node.operands))
        elif node.op == "search":
            place = add(Node("mul", (n, add(Node("constant", (), _CELL)))))
        else:
            continue
        periodic[n] = phases.setdefault(place, len(phases))
    return tuple(made), tuple(phases), periodic


@cache
def _operations() -> dict[int, str]:
    """The names of CasADi's operations."""
    import casadi

    return {getattr(casadi, name): name[3:].lower() for name in dir(casadi) if name.startswith("OP_")}


def _plain(op: str, operands: tuple[int, ...], add: Callable[[Node], int]) -> tuple[str, tuple[int, ...]]:
    """What CasADi's derivatives have of operations that a tape does not, by operations that it has."""
    match op:
        case "twice":
            return "add", operands * 2
        case "sq":
            return "mul", operands * 2
        case "inv":
            return "div", (add(Node("constant", (), 1.0)), *operands)
        case "constpow":
            return "pow", operands
    return op, operands


def _stitched(
    nodes: list[Node], outputs: list[int], count: int, ops: list[str], operands: list[int]
) -> tuple[list[Node], list[int]]:
    """The nodes with each argument from `count` on replaced by its lookup, in an order that holds again."""
    made = nodes[:count]
    place = {index: index for index in range(count)}
    known = {node: index for index, node in enumerate(made)}

    def needs(index: int) -> tuple[int, ...]:
        node = nodes[index]
        if node.op == "argument" and index >= count:
            lookup = index - count
            return operands[2 * lookup], operands[2 * lookup + 1]
        return node.operands

    stack = list(reversed(outputs))
    while stack:
        index = stack[-1]
        missing = [] if index in place else [other for other in needs(index) if other not in place]
        if missing:
            stack += missing
            continue
        stack.pop()
        if index not in place:
            node, below = nodes[index], tuple(place[other] for other in needs(index))
            if node.op == "argument":
                node = Node(ops[index - count])
            node = Node(node.op, below, node.value)
            if node not in known:
                known[node] = len(made)
                made.append(node)
            place[index] = known[node]
    return made, [place[index] for index in outputs]


def _simplified(op: str, operands: tuple[int, ...], nodes: list[Node]) -> Node | int:
    """The node of an operation, or the index of a node that gives the same."""
    left, right = operands[0], operands[-1]
    a, b = nodes[left], nodes[right]
    x, y = (node.value if node.op == "constant" else None for node in (a, b))
    if op in _FOLDED and x is not None and y is not None and not (op == "div" and y == 0):
        return Node("constant", (), float(_FOLDED[op](x, y)))
    match op:
        case "add":
            if a.op == b.op == "if_else_zero":
                # CasADi writes a choice as (c ? a : 0) + (!c ? b : 0).
                condition, opposite = nodes[a.operands[0]], nodes[b.operands[0]]
                if opposite == Node("not", a.operands[:1]):
                    if condition.op == "not":
                        return _choice(condition.operands[0], b.operands[1], a.operands[1])
                    return _choice(a.operands[0], a.operands[1], b.operands[1])
            if x == 0 or y == 0:
                return right if x == 0 else left
        case "sub" if y == 0:
            return left
        case "mul":
            if x == 0 or y == 0:
                return Node("constant", (), 0.0)
            if x == 1 or y == 1:
                return right if x == 1 else left
        case "div":
            if x == 0 and y is None:
                return Node("constant", (), 0.0)
            if y == 1:
                return left
        case "and" | "or":
            absorbing = op == "or"
            if x is not None or y is not None:
                other, value = (right, x) if x is not None else (left, y)
                return Node("constant", (), float(absorbing)) if bool(value) == absorbing else other
        case "if_else_zero" if x is not None:
            return right if x else Node("constant", (), 0.0)
        case "assign":
            return left
    return Node(op, operands)


_WHOLE = frozenset({"floor", "ceil", "sign", "search", "lt", "le", "eq", "ne", "and", "or", "not"})
_KEEPS_WHOLE = frozenset({"add", "sub", "mul", "neg", "fabs", "fmin", "fmax", "fmod", "copysign", "choose"})


def _whole(nodes: Sequence[Node], arguments: Sequence[Argument], types: Mapping[str, str]) -> list[bool]:
    """For each node whether it is an integer, whatever the arguments are."""
    made: list[bool] = []
    for node in nodes:
        if node.op == "argument":
            argument = arguments[int(node.value)]
            made.append(argument.kind in ("tick", "side") or types.get(argument.name, "real") != "real")
        elif node.op == "constant":
            made.append(float(node.value).is_integer())
        else:
            below = node.operands[1:] if node.op == "choose" else node.operands
            made.append(node.op in _WHOLE or (node.op in _KEEPS_WHOLE and all(made[k] for k in below)))
    return made


def _choice(condition: int, yes: int, no: int) -> Node | int:
    return yes if yes == no else Node("choose", (condition, yes, no))


_FOLDED: Mapping[str, Callable[[float, float], float]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": lambda x, _: -x,
    "not": lambda x, _: float(not x),
    "lt": operator.lt,
    "le": operator.le,
    "eq": operator.eq,
    "ne": operator.ne,
}


def numeric(interface: Interface, values: Mapping[str, Any]) -> dict[str, Array]:
    """Every result of a type computed by its own Python functions on numbers: the witness of the tape.

    values: all that equations read, by name, including t and tick; bools as 0 and 1 or as they are. Returns arrays
    by result key. Raises DeclarationError (E407) where an equation fails on numbers.
    """
    declaration = interface.declaration
    known: dict[str, Any] = dict(interface.structural)
    for name, value in values.items():
        variable = declaration.readable.get(name)
        made = np.array(value, dtype=bool if variable is not None and variable.type == "bool" else float)
        if variable is not None and not isinstance(variable, Local):
            made = made.reshape(interface.shape(variable))
        made.setflags(write=False)
        known[name] = made[()]  # numpy's scalars: x / 0 is inf, and ~ of a bool is a bool
    table = _Values(interface, known, lambda value: np.asarray(value)[()])
    results: dict[str, Array] = {}
    for equation in declaration.equations:
        for role in equation.roles:
            variable = role.target
            assert variable is not None
            if isinstance(variable, Output) and variable.wiring:
                continue
            result = np.asarray(table[equation.name] if role.kind == "local" else table.of(equation), dtype=float)
            cause = f":{role.cause.name}" if role.cause is not None else ""
            shape = result.shape if role.kind == "local" else interface.shape(variable)
            results[f"{role.kind}:{variable.name}{cause}"] = np.broadcast_to(result, shape).ravel()
    return results
