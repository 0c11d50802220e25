"""The places of one block in the rows of memory, laid out once for all blocks of its type.

A diagram has many blocks and few types. What the type alone decides (how many places, under which names, filled by
which results) is settled here; a block adds where its own places begin.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from ..contract.equations import Output
from ..contract.interface import Interface
from ..contract.tape import Tape
from ..contract.tracing import trace
from ..contract.variables import Discrete, Stepped
from .fmu_tape import EVENT, opaque

ROWS = {row: number for number, row in enumerate("xdspwhc")}
"""The rows that blocks have places in, and their numbers in `Footprint.sizes`."""

Result = tuple[str, int]
"""One element of a result of the type: its key, and which."""

Place = tuple[str, int]
"""A row, and a place in it, counted from the block's first one."""


class Start(NamedTuple):
    """The start value of a place of memory: a "result", a "parameter", what is "held" or a "number".

    name: of the result (its key), the parameter, the sampled output. element: of these; or the number itself.
    """

    kind: str
    name: str
    element: Any


class CauseLayout(NamedTuple):
    """A crossing or an event time of the type: the result that gives it, and its resets: results and their places."""

    name: str
    direction: str
    result: Result
    resets: tuple[tuple[Result, Place], ...]


class Clocked(NamedTuple):
    """A sampled result of the type, the equation whose clock it has, and where its elements go."""

    clock: str
    is_output: bool
    elements: tuple[tuple[Result, int], ...]  # with places in d


class Footprint:
    """The memory of one block of a type. Raises DeclarationError (E407) where the type cannot be traced.

    place: where each variable begins. names: of states and discretes, without the block's path. arguments: those of
    the tape: the row, its number and the place; ("input", -1, (variable, element)); "time" or "tick". clashes:
    variables that two causes reset by different equations, with the names of the causes. is_still: nothing happens to
    the block at instants, and it has no histories.
    """

    def __init__(self, interface: Interface) -> None:
        foreign = interface.declaration.foreign
        self.is_foreign = foreign is not None and foreign.kind == "ME"
        self.interface, self.tape = interface, opaque(interface) if self.is_foreign else trace(interface)
        self.sizes = [0] * len(ROWS)
        self.place: dict[str, Place] = {}
        self.names: dict[str, list[str]] = {"x": [], "d": []}
        self.starts: dict[str, list[Start]] = {"x": [], "d": [], "s": []}
        self.outputs: list[Result] = []  # the results that w shows
        self.integers: list[tuple[int, frozenset[float]]] = []  # places in d of ints, and of enumerations
        self._lay_out()
        d = interface.declaration
        self.derivatives = [
            (f"derivative:{name}", e) for name, state in d.states.items() for e in range(self._size(state))
        ]
        self.arguments: list[tuple[str, int, Any]] = []
        for argument in self.tape.arguments:
            if argument.kind in ("time", "tick"):
                self.arguments.append((argument.kind, -1, 0))
            elif argument.kind == "input":
                self.arguments.append(("input", -1, (argument.name, argument.element)))
            else:
                row, first = self.place[argument.name]
                self.arguments.append((row, ROWS[row], first + argument.element))
        self.crossings = [self._cause("crossing", name, cause.direction) for name, cause in d.crossings.items()]
        self.events = [self._cause("event_time", name, "") for name in d.event_times]
        if self.is_foreign:
            self.crossings = [self._cause("crossing", name, "both") for name in self.sides]
            self.events = [self._cause("event_time", EVENT, "")]
        self.clocked: list[Clocked] = []
        self.projections: list[tuple[Result, Place]] = []  # what is replaced after each step
        for key, result in self.tape.results.items():
            if result.clock:
                _, first = self.place[result.target]
                elements = tuple(((key, e), first + e) for e in range(len(result.nodes)))
                self.clocked.append(Clocked(result.clock, result.role == "output", elements))
            elif result.role == "next":
                self.projections += self._replaced(key)
        self.clashes = _clashes(self.tape)
        timed = (self.crossings, self.events, self.clocked, self.projections, d.stepper, d.histories)
        self.is_still = not any(timed)

    def _size(self, variable: Any) -> int:
        return math.prod(self.interface.shape(variable))

    def _lay_out(self) -> None:
        """Places for all variables, row by row in the order of the declaration."""
        d = self.interface.declaration
        for name, places in parameter_places(self.interface).items():
            self._take("p", name, len(places))
        for name in self.interface.tables:
            self._take("c", name, 1)
        for name, state in d.states.items():
            self._remember("x", name, state, self._begins(name))
        for name, discrete in d.discretes.items():
            self._remember("d", name, discrete, self._begins(name))
        for name, algebraic in d.algebraics.items():
            self._show(f"residual:{name}", name, algebraic)
        for name, history in d.histories.items():
            self._take("h", name, self._size(history))
        for name, output in d.outputs.items():
            if output.clock is not None:
                self._remember("d", name, output, ("held", name))
            elif not output.wiring:
                self._show(f"output:{name}", name, output)
        for name, stepped in d.stepped.items():
            self._remember("d", name, stepped, ("held", name))
        for name, crossing in d.crossings.items():
            self._take("s", name, 1)
            begins = Start("result", f"crossing:{name}", 0)
            self.starts["s"].append(begins if crossing.start is None else Start("number", "", float(crossing.start)))
        for name, given in d.given.items():
            self._show(f"output:{name}", name, given)
        # The sides of an FMU are known once it is initialized.
        self.sides = [r.target for r in self.tape.results.values() if r.role == "crossing"] if self.is_foreign else []
        for name in self.sides:
            self._take("s", f"crossing:{name}", 1)
            self.starts["s"].append(Start("number", "", 0.0))

    def _take(self, row: str, name: str, size: int) -> int:
        """Places in a row, and where they begin."""
        first = self.sizes[ROWS[row]]
        self.place[name] = (row, first)
        self.sizes[ROWS[row]] += size
        return first

    def _show(self, key: str, name: str, variable: object) -> None:
        size = self._size(variable)
        self._take("w", name, size)
        self.outputs += [(key, e) for e in range(size)]

    def _remember(self, row: str, name: str, variable: Any, begins: tuple[str, str]) -> None:
        size = self._size(variable)
        first = self._take(row, name, size)
        self.names[row] += names_of(f".{name}", size, self.interface.shape(variable))
        self.starts[row] += [Start(*begins, e) for e in range(size)]
        if isinstance(variable, (Discrete, Output, Stepped)) and variable.type not in ("real", "bool"):
            members = frozenset(float(value) for value in variable.members.values())
            self.integers += [(first + e, members) for e in range(size)]

    def _begins(self, name: str) -> tuple[str, str]:
        start = f"{name}_start"
        if self.is_foreign:
            return ("result", f"initial:{name}")
        return ("parameter", start) if start in self.interface.declaration.parameters else ("result", f"initial:{name}")

    def _replaced(self, key: str) -> tuple[tuple[Result, Place], ...]:
        """The elements of a result, and the places of the variable that it replaces."""
        result = self.tape.results[key]
        row, first = self.place[result.target]
        return tuple(((key, e), (row, first + e)) for e in range(len(result.nodes)))

    def _cause(self, kind: str, name: str, direction: str) -> CauseLayout:
        resets = [
            pair
            for key, result in self.tape.results.items()
            if result.role == "reset" and result.cause == name
            for pair in self._replaced(key)
        ]
        return CauseLayout(name, direction, (f"{kind}:{name}", 0), tuple(resets))


def _clashes(tape: Tape) -> Mapping[str, tuple[str, ...]]:
    resets: dict[str, list[Any]] = {}
    for result in tape.results.values():
        if result.role == "reset":
            resets.setdefault(result.target, []).append(result)
    return {
        target: tuple(result.cause for result in results)
        for target, results in resets.items()
        if len({result.nodes for result in results}) > 1
    }


def parameter_places(interface: Interface) -> dict[str, range]:
    """The places of each parameter of a block in the row p, counted from the block's first one."""
    places, first = dict[str, range](), 0
    for name, parameter in interface.symbolic_parameters.items():
        places[name] = range(first, first + math.prod(interface.shape(parameter)))
        first = places[name].stop
    return places


def names_of(path: str, size: int, shape: tuple[int, ...]) -> list[str]:
    """The names of the elements of a variable."""
    return [path] if shape == () else [f"{path}[{i}]" for i in range(size)]
