"""Functions of block types in C, printed from their tapes: scalars in, scalars out.

A function has the operations of the tape in the order of the tape, so that every engine gives the same bits but for
the last ones of the C library's functions. Comparisons are ints of 0 or 1 inside a function and doubles at its edges.
A choice computes both sides and selects, which vectorises; one with a costly call becomes a branch.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ...contract.closure import closure
from ...contract.scalars import COSTLY, JOINS, LOGICAL, OPERATIONS
from ...contract.tape import Tape, TapeNode

_UNVECTORISED = COSTLY | {"pick", "floor", "ceil", "copysign"}
_BOUNDS = {"fmin": "blocks_at_most", "fmax": "blocks_at_least"}
_DEPTH = 6  # expressions nested deeper than this get a name, for readability


@dataclass(frozen=True, slots=True)
class Numbers:
    """What a number of a program is in C: the types of it and of a truth, and of the memory that it is read from.

    are_wide: whether it is that of several runs side by side, for which lanes.h has functions in place of operators.
    """

    real: str
    truth: str
    memory: str
    are_wide: bool

    def constant(self, value: float) -> str:
        return f"lanes_of({number(value)})" if self.are_wide else number(value)

    def as_real(self, truth: str) -> str:
        """1.0 or 0.0 for a truth."""
        return f"lanes_real({truth})" if self.are_wide else f"(double)({truth})"

    def chosen(self, condition: str, yes: str, no: str) -> str:
        return f"lanes_choose({condition}, {yes}, {no})" if self.are_wide else f"{condition} ? {yes} : {no}"

    def called(self, function: str) -> str:
        """The name of a function that C or model.h has of one number."""
        return f"lanes_{function.removeprefix('blocks_')}" if self.are_wide else function


ONE = Numbers("double", "int", "BlocksMemory", False)
LANES = Numbers("V", "M", "LanesMemory", True)


def comment(text: str) -> str:
    """Text made safe for a comment, whatever the names of blocks are."""
    return re.sub(r"[^A-Za-z0-9_.\[\] ]", "_", text)[:120]


def number(value: float) -> str:
    """A double in C, to the last bit."""
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text


def operation_text(op: str, operands: Sequence[str]) -> str:
    """An operation of a tape as an expression; its operands stand in brackets where they need them."""
    c = OPERATIONS[op].c
    if c.isidentifier():
        return f"{c}({', '.join(operands)})"
    if op == "choose":
        return f"{operands[0]} ? {operands[1]} : {operands[2]}"
    if op in ("min", "max"):
        return f"{operands[1]} {c} {operands[0]} ? {operands[1]} : {operands[0]}"
    return f" {c} ".join(operands) if len(operands) == 2 else f"{c}{operands[0]}"


def is_costly(tape: Tape, nodes: Sequence[int]) -> bool:
    """Whether gcc does not vectorise a loop over these nodes."""
    return any(tape.nodes[n].op in _UNVECTORISED for n in nodes)


@dataclass(frozen=True, slots=True)
class Function:
    """A printed function.

    name: in C. inputs: the tape's nodes that it takes, in order. arguments: which argument of the type each of them is;
    -1: it is computed from some. count: the number of its values; one is returned, more are written through pointers.
    weight: the number of operations. costly: see `is_costly`. takes_memory: whether its first argument is the memory.
    """

    name: str
    inputs: tuple[int, ...]
    arguments: tuple[int, ...]
    count: int
    weight: int
    costly: bool
    takes_memory: bool = False


def function_text(
    name: str,
    tape: Tape,
    results: Sequence[int],
    inputs: Mapping[int, str],
    tables: Mapping[int, int],
    what: str,
    numbers: Numbers = ONE,
) -> str:
    """A function that computes nodes of a tape. inputs: the nodes that are arguments, and their names. tables: the
    tables among them, and their sizes."""
    real = numbers.real
    given = [f"const double *{name_}" if n in tables else f"{real} {name_}" for n, name_ in inputs.items()]
    alone = len(results) == 1
    given += [] if alone else [f"{real} *r{k}" for k in range(len(results))]
    head = f"static inline {real if alone else 'void'} {name}({', '.join(given) or 'void'})"
    printer = _Printer(tape, results, inputs, tables, numbers)
    lines = printer.statements()
    values = [printer.real(n) for n in results]
    ends = [f"return {values[0]};"] if alone else [f"*r{k} = {value};" for k, value in enumerate(values)]
    body = "\n".join(f"    {line}" for line in (*lines, *ends))
    return f"{head}  /* {comment(what)} */\n{{\n{body}\n}}\n"


class _Printer:
    """The statements of one function."""

    def __init__(
        self,
        tape: Tape,
        results: Sequence[int],
        inputs: Mapping[int, str],
        tables: Mapping[int, int],
        numbers: Numbers,
    ) -> None:
        self.numbers = numbers
        self.arguments, self.nodes = tape.arguments, tape.nodes
        self.results, self.inputs, self.tables = results, inputs, tables
        self.needed = needed_from(tape, results, inputs)
        self.text: dict[int, tuple[str, int, bool]] = {n: (text, 0, False) for n, text in inputs.items()}
        self.uses: dict[int, int] = dict.fromkeys(results, 2)  # results are read again, at the end
        for n in self.needed:
            for operand in self.nodes[n].operands:
                self.uses[operand] = self.uses.get(operand, 0) + 1
        self.regions()

    def regions(self) -> None:
        """Where each node is computed: the root, or one side of a choice, if nothing else needs it.

        A region is (choice, side); `above` has the one around it. Only choices with something costly on one side keep
        their regions; the nodes of others move up.
        """
        self.above: dict[tuple[int, int], tuple[int, int] | None] = {}
        home: dict[int, tuple[int, int] | None] = dict.fromkeys(self.results)
        costly: set[tuple[int, int]] = set()

        def path(region: tuple[int, int] | None) -> list[tuple[int, int]]:
            regions = []
            while region is not None:
                regions.append(region)
                region = self.above[region]
            return regions[::-1]

        def meet(a: tuple[int, int] | None, b: tuple[int, int] | None) -> tuple[int, int] | None:
            common = None
            for of_a, of_b in zip(path(a), path(b), strict=False):
                if of_a != of_b:
                    break
                common = of_a
            return common

        for n in reversed(self.needed):
            node, region = self.nodes[n], home[n]
            if node.op in COSTLY:
                costly.update(path(region))
            for side, operand in enumerate(node.operands):
                place = region
                if node.op == "choose" and side > 0:
                    place = (n, side)
                    self.above[place] = region
                home[operand] = meet(home[operand], place) if operand in home else place
        branches = {choice for choice, _ in costly}
        self.branches = branches
        self.home: dict[int, tuple[int, int] | None] = {}
        for n in self.needed:
            region = home[n]
            while region is not None and region[0] not in branches:
                region = self.above[region]
            self.home[n] = region

    def statements(self) -> list[str]:
        lines: dict[tuple[int, int] | None, list[str]] = {None: []}
        for n in self.needed:
            node, region = self.nodes[n], self.home[n]
            own = lines.setdefault(region, [])
            if node.op == "constant":
                self.text[n] = (self.numbers.constant(node.value), 0, False)
            elif n in self.branches:
                own += self.branch(n, lines.get((n, 1), ()), lines.get((n, 2), ()))
                self.text[n] = (f"a{n}", 0, False)
            else:
                depth = 1 + max(self.text[operand][1] for operand in node.operands)
                expression, is_logical = self.expression(node)
                if self.uses[n] > 1 or depth > _DEPTH or node.op in COSTLY:
                    kind = self.numbers.truth if is_logical else self.numbers.real
                    own.append(f"const {kind} a{n} = {expression};")
                    expression, depth = f"a{n}", 0
                self.text[n] = (expression, depth, is_logical)
        return lines[None]

    def branch(self, n: int, before_yes: Sequence[str], before_no: Sequence[str]) -> list[str]:
        """A choice that computes what it takes; of several runs what any of them takes, which each chooses from."""
        condition, yes, no = self.nodes[n].operands
        sides = (before_yes, self.real(yes)), (before_no, self.real(no))
        if not self.numbers.are_wide:
            bodies = [[f"    {line}" for line in (*before, f"a{n} = {value};")] for before, value in sides]
            return [f"double a{n};", f"if ({self.logical(condition)}) {{", *bodies[0], "} else {", *bodies[1], "}"]
        made = [f"const M c{n} = {self.logical(condition)};"]
        for name, test, (before, value) in zip("yn", (f"c{n}", f"~c{n}"), sides, strict=True):
            inside = [f"    {line}" for line in (*before, f"{name}{n} = {value};")]
            made += [f"V {name}{n} = lanes_of(0.0);", f"if (lanes_any({test})) {{", *inside, "}"]
        return [*made, f"const V a{n} = lanes_choose(c{n}, y{n}, n{n});"]

    def real(self, n: int) -> str:
        text, _, is_logical = self.text[n]
        return self.numbers.as_real(text) if is_logical else text

    def logical(self, n: int) -> str:
        text, _, is_logical = self.text[n]
        return text if is_logical else f"({text} != 0.0)"

    def expression(self, node: TapeNode) -> tuple[str, bool]:
        op, operands = node.op, node.operands
        is_logical = op in LOGICAL
        if op in JOINS:
            a = [self.logical(operand) for operand in operands]
        elif op == "choose":
            condition, *sides = operands
            is_logical = all(self.text[side][2] for side in sides)
            a = [self.logical(condition), *(self.text[n][0] if is_logical else self.real(n) for n in sides)]
        elif op in ("search", "pick"):
            x, table = operands
            a = [self.real(x), self.text[table][0], str(self.tables[table])]
        else:
            a = [self.real(operand) for operand in operands]
        if op in _BOUNDS and (self.is_bound(operands[0]) or self.is_bound(operands[1])):
            value, bound = a if self.is_bound(operands[1]) else a[::-1]
            return f"{self.numbers.called(_BOUNDS[op])}({value}, {bound})", False
        c = OPERATIONS[op].c
        if c.isidentifier():
            return f"{self.numbers.called(c)}({', '.join(a)})", is_logical
        if self.numbers.are_wide and op == "choose":
            chosen = self.numbers.chosen(*a)
            return chosen.replace("choose", "choose_truth", 1) if is_logical else chosen, is_logical
        if self.numbers.are_wide and op == "not":
            return f"(~{a[0]})", True
        return f"({operation_text(op, a)})", is_logical

    def is_bound(self, n: int) -> bool:
        """Whether a node is never NaN: a constant, a parameter, or one of these without its sign."""
        node = self.nodes[n]
        if node.op in ("neg", "fabs"):
            return self.is_bound(node.operands[0])
        if node.op == "argument":
            return self.arguments[int(node.value)].kind == "parameter"
        return node.op == "constant" and not math.isnan(node.value)


def needed_from(tape: Tape, results: Sequence[int], inputs: Mapping[int, str]) -> list[int]:
    """The nodes that must be computed to get results from inputs, in order."""
    return sorted(closure(results, lambda n: () if n in inputs else tape.nodes[n].operands) - inputs.keys())
