"""A Plan's programs as straight-line Python.

Each block type becomes functions of scalars, one for each group of results that is computed together; a program
calls them in Plan order. Two spellings are printed: `fast` uses the operators and `math`, which raise where IEEE
arithmetic gives inf or NaN; `safe` uses functions that give them. A program runs fast, and again safe if that raised.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...compile.fmu_tape import FmuTape, Request
from ...compile.plan import AlgebraicLoop, LoopPart, Node, Plan, Program, Reference
from ...compile.scheduler import schedule
from ...compile.tearing import bounds, sensitivities, slopes
from ...contract.scalars import COSTLY, LOGICAL, OPERATIONS
from ...contract.tape import Tape
from ...text.errors import NOT_FINITE, OVERFLOW
from .newton import Nearest, newton, spread

Evaluator = Callable[..., tuple[float, ...]]
"""f(t, x, d, s, p, u, k, h, z, f) -> values: rows of memory as sequences of floats, k the tick numbers by rate; f: the
FMUs of the run, as `blocks.engines.run.model_exchange` has them."""

_DEPTH = 12  # expressions nested deeper than this get a name of their own, to be read and to be parsed


class CompiledPrograms:
    """The programs of one Plan, printed when first asked for. `source` is what was printed, to be read.

    Functions of types are shared by all programs; nothing here changes what a program computes, so that one
    object may serve several runs and threads, and Plans that differ in values of parameters alone.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.functions: dict[Any, str] = {}
        self.requests: dict[Any, tuple[str, list[int]]] = {}
        self.names: dict[bool, dict[str, Any]] = {
            safe: {**table, "c": plan.tables} for safe, table in ((False, _FAST), (True, _SAFE))
        }
        self.source = ""
        self.lock = threading.Lock()
        self.tapes: dict[int, str] = {}
        self.made: dict[Any, Evaluator] = {}

    def program(self, name: str, results: Sequence[Node | Reference], **how: object) -> Evaluator:
        """A function that computes `results`, printed when it is first called; `how` is passed to `schedule`.

        Named "rounding", it gives how far rounding may move each unknown, at the solutions in z.
        """
        key = (name, tuple(results), *sorted(how.items()))
        if key not in self.made:
            self.made[key] = self._later(name, results, how)
        return self.made[key]

    def _later(self, name: str, results: Sequence[Node | Reference], how: dict[str, Any]) -> Evaluator:
        fast: Evaluator | None = None
        slow: Evaluator | None = None

        def printed() -> tuple[Evaluator, Evaluator]:
            with self.lock:  # functions of types are shared by all programs
                body = self._program(name, schedule(self.plan, results, **how), is_start=bool(how.get("start")))
                for safe in (False, True):
                    self._execute(body, safe)
                return self.names[False][name], self.names[True][name]

        def run(*memory: object) -> tuple[float, ...]:
            nonlocal fast, slow
            if fast is None or slow is None:
                fast, slow = printed()
            try:
                return fast(*memory)
            except (ArithmeticError, ValueError):
                with np.errstate(all="ignore"):
                    return slow(*memory)

        return run

    def cure(self, results: Sequence[Node | Reference], memory: Sequence[Any], **how: Any) -> str:
        """What to do about a result that is not finite: whether an operation was undefined, or it overflowed.

        `math` raises where an operation is undefined, and OverflowError where it overflows; sums and products overflow
        without a word. Nothing is known of what an FMU computes.
        """
        program = schedule(self.plan, results, **how)
        tapes = (
            self.plan.instances[step.instance].tape for step in program.steps if not isinstance(step, AlgebraicLoop)
        )
        if any(isinstance(tape, FmuTape) for tape in tapes):
            return NOT_FINITE
        with self.lock:
            self._execute(self._program("cure", program, is_start=False), False)
            evaluate = self.names[False]["cure"]
        try:
            evaluate(*memory)
        except OverflowError:
            return OVERFLOW
        except (ArithmeticError, ValueError):
            return NOT_FINITE
        return OVERFLOW

    def nearest(self, reference: Reference, memory: Sequence[Any]) -> tuple[Reference, Nearest] | None:
        """Return how near the search for an unknown came, and the unknown that kept it from there."""
        program = schedule(self.plan, [reference])
        loops = [step for step in program.steps if isinstance(step, AlgebraicLoop)]
        tried: list[Nearest] = []

        def watched(*how: Any) -> tuple[float, ...]:
            tried.append(Nearest(*how))
            return newton(*how)

        with self.lock, np.errstate(all="ignore"):
            body = self._program("nearest", program, is_start=False)
            names = {**self.names[True], "_newton": watched}
            exec(compile(body, f"<{self.plan.name}>", "exec"), names)
            names["nearest"](*memory)
        for loop, search in zip(loops, tried, strict=True):
            if reference in loop.unknowns:
                return loop.unknowns[loop.torn[search.number]], search
        return None

    def _execute(self, source: str, safe: bool) -> None:
        if not safe:
            self.source += source + "\n\n"
        exec(compile(source, f"<{self.plan.name}>", "exec"), self.names[safe])  # only what this module printed

    def _program(self, name: str, program: Program, *, is_start: bool) -> str:
        plan = self.plan
        lines = [f"def {name}(t, x, d, s, p, u, k, h, z, f=()):"]
        known = {node: f"{row}{index}" for node, (row, index) in program.made.items()}
        # A crossing's value is made, but its side is read.
        held = {ref: f"({known[node]} >= 0.0)" if ref[0] == "s" else known[node] for node, ref in program.made.items()}
        held.update((reference, _read({}, other)) for reference, other in program.moved.items())
        results = dict.fromkeys(item for item in program.results if isinstance(item, Node))
        for node in results:
            known.setdefault(node, f"r{len(known)}")
        for step in program.steps:
            if isinstance(step, AlgebraicLoop):
                lines += self._loop(step, held, known, is_start=is_start, is_rounding=name == "rounding")
                continue
            instance = plan.instances[step.instance]
            if isinstance(instance.tape, FmuTape):
                function, arguments = self._request(step.instance, step.results)
            else:
                function, arguments = self._function(instance.tape, step.results)
            nodes = step.nodes
            values = []
            for argument in arguments:
                row, index = instance.arguments[argument]
                if row == "tick":
                    index = plan.rate_of[nodes[0]]
                values.append(_read(held, Reference(row, index)))
            targets = ", ".join(known[node] for node in nodes)
            comma = "," if len(nodes) == 1 else ""
            begin = f"{function}, " if isinstance(instance.tape, FmuTape) else f"{function}("
            call = f"{begin}{', '.join(values)})"
            lines.append(f"    {targets}{comma} = {call}  # {instance.path}")
        values = [known[item] if isinstance(item, Node) else _read(held, item) for item in program.results]
        if name == "rounding":
            values = [f"e{value}" for value in values]
        lines.append(f"    return ({', '.join(values)}{',' if len(values) == 1 else ''})")
        return "\n".join(lines)

    def _loop(
        self,
        loop: AlgebraicLoop,
        held: dict[Reference, str],
        known: dict[Node, str],
        *,
        is_start: bool,
        is_rounding: bool,
    ) -> list[str]:
        """A loop as a system of equations for Newton's method: residuals, matrix, other unknowns; and rounding."""
        plan = self.plan
        names = [f"{row}{index}" for row, index in loop.unknowns]
        torn = ", ".join(names[row] for row in loop.torn)
        chained = slopes(plan, loop)
        residuals = dict.fromkeys(loop.torn, "")
        lines = [f"    def _loop({torn}):"]
        for number, part in enumerate(loop.parts):
            lines += self._part(number, part, part.tape, held)[0]
            for k, row in enumerate(part.rows):
                if row in residuals:
                    is_residual = loop.is_residual(plan, number, k)
                    residuals[row] = f"a{number}_{k}" if is_residual else f"a{number}_{k} - {names[row]}"
                else:
                    lines.append(f"        {names[row]} = a{number}_{k}")
            lines += [f"        {name} = {text}" for name, text in chained.made[number]]
        solved = [names[row] for row in loop.solved]
        rows = ", ".join(f"({', '.join(row)},)" for row in chained.matrix)
        others = "".join(f"{name}, " for name in solved[len(loop.torn) :])
        lines.append(f"        return ({', '.join(residuals.values())},), ({rows},), ({others})")
        lines += [f"    def _rounding({torn}):"]
        wholes = [sensitivities(plan, loop, part) for part in loop.parts]
        parts = [self._part(k, part, wholes[k].tape, held) for k, part in enumerate(loop.parts)]
        bounded = bounds(
            plan, loop, [(whole.arguments, part[1]) for whole, part in zip(wholes, parts, strict=True)], "abs"
        )
        for number, part in enumerate(loop.parts):
            lines += parts[number][0]
            lines += [
                f"        {names[row]} = a{number}_{k}" for k, row in enumerate(part.rows) if row not in residuals
            ]
            lines += [f"        {name} = {text}" for name, text in bounded.made[number]]
        made = f"({', '.join(bounded.matrix[0])},)"
        if is_rounding:
            made += f", ({''.join(f'g{row}, ' for row in loop.solved[len(loop.torn) :])})"
        lines.append(f"        return {made}")
        guesses = []
        for row in loop.torn:
            reference = loop.unknowns[row]
            if reference in plan.unknowns_at:
                guesses.append(f"z[{plan.unknowns_at[reference]}]")
            else:
                is_held = reference.row == "d" and not is_start  # at the start nothing is held yet
                guesses.append(f"d[{reference.index}]" if is_held else repr(plan.guesses.get(reference, 0.0)))
        if is_rounding:
            places = (f"z[{plan.unknowns_at[reference]}]" for reference in loop.unknowns)
            lines.append(f"    {', '.join(names)}, = {', '.join(places)},")
            targets = ", ".join(f"e{name}" for name in solved)
            lines.append(f"    {targets}, = _spread(_loop, ({', '.join(guesses)},), _rounding)")
        else:
            lines.append(f"    {', '.join(solved)}, = _newton(_loop, ({', '.join(guesses)},), _rounding)")
        return lines

    def _part(
        self, number: int, part: LoopPart, tape: Tape, held: dict[Reference, str]
    ) -> tuple[list[str], dict[int, str]]:
        """The lines that compute values and partials of a part, and the texts of its arguments."""
        instance = self.plan.instances[part.instance]
        asked = tuple((key, e) for key in ("value", "partial") for e in range(len(tape.results[key].nodes)))
        is_foreign = isinstance(tape, FmuTape)
        function, arguments = self._request(part.instance, asked, tape) if is_foreign else self._function(tape, asked)
        texts = {}
        for argument in arguments:
            row, index = instance.arguments[argument]
            if row == "tick":
                index = self.plan.rate_of[Node(part.instance, *part.results[0])]
            texts[argument] = _read(held, Reference(row, index))
        targets = ", ".join(f"a{number}_{k}" for k in range(len(asked)))
        call = f"{function}{', ' if is_foreign else '('}{', '.join(texts.values())})"
        return [f"        {targets}, = {call}  # {instance.path}"], texts

    def _request(
        self, instance: int, results: tuple[tuple[str, int], ...], tape: Tape | None = None
    ) -> tuple[str, list[int]]:
        """What asks an FMU for some of its results, up to the values it takes, and the arguments that these are."""
        tape = tape or self.plan.instances[instance].tape
        key = (id(tape), results)
        if key not in self.requests:
            name = f"_q{len(self.requests)}"
            assert isinstance(tape, FmuTape)
            request = Request.of(tape, results)
            for names in self.names.values():
                names[name] = request
            self.requests[key] = name, list(request.arguments)
        name, arguments = self.requests[key]
        return f"f[{self.plan.foreign_of[instance]}].values({name}", arguments

    def _function(self, tape: Tape, results: tuple[tuple[str, int], ...]) -> tuple[str, list[int]]:
        """The name of a type's function for a group of results, printed if new, and the arguments it takes."""
        nodes = [tape.results[key].nodes[element] for key, element in results]
        needed = tape.needed(nodes)
        arguments = [int(tape.nodes[n].value) for n in needed if tape.nodes[n].op == "argument"]
        key = (id(tape), results)
        if key not in self.functions:
            type_ = self.tapes.setdefault(id(tape), f"{tape.name}_{len(self.tapes)}")
            name = f"{type_}_{sum(1 for other in self.functions if other[0] == id(tape))}"
            for safe in (False, True):
                self._execute(_print_function(name, tape, results, needed, arguments, safe), safe)
            self.functions[key] = name  # now that it is there: an interrupt may come in between
        return self.functions[key], arguments


def _read(held: dict[Reference, str], reference: Reference) -> str:
    row, index = reference
    if reference in held:
        return held[reference]
    if row == "k":
        return repr(index)
    return "t" if row == "t" else f"k[{index}]" if row == "tick" else f"{row}[{index}]"


def _print_function(
    name: str, tape: Tape, results: tuple[tuple[str, int], ...], needed: list[int], arguments: list[int], safe: bool
) -> str:
    """One group of results of a type as a Python function of scalars."""
    uses: dict[int, int] = {}
    for n in needed:
        node = tape.nodes[n]
        for operand in node.operands:
            uses[operand] = uses.get(operand, 0) + 1
    text: dict[int, tuple[str, int]] = {}  # node -> its expression and how deep that is
    lines = []
    for argument, n in zip(arguments, (n for n in needed if tape.nodes[n].op == "argument"), strict=True):
        symbol = tape.arguments[argument]
        scalar = symbol.kind == "table" or tape.shape_of(symbol.name) in (None, ())
        text[n] = (symbol.name if scalar else f"_{symbol.name}_{symbol.element}", 0)
    names = ", ".join(name for name, _ in text.values())
    for n in needed:
        node = tape.nodes[n]
        if node.op == "argument":
            continue
        if node.op == "constant":
            text[n] = (_number(node.value), 0)
            continue
        depth = 1 + max(text[operand][1] for operand in node.operands)
        expression = _expression(node.op, [text[operand][0] for operand in node.operands], safe)
        if uses.get(n, 0) > 1 or depth > _DEPTH:
            lines.append(f"    _{n} = {expression}")
            text[n] = (f"_{n}", 0)
        else:
            text[n] = (expression, depth)
    values = []
    for key, element in results:
        n = tape.results[key].nodes[element]
        values.append(f"({text[n][0]} + 0.0)" if _may_be_logical(tape, n) else text[n][0])
    what = ", ".join(dict.fromkeys(key for key, _ in results))
    lines.append(f"    return ({', '.join(values)}{',' if len(values) == 1 else ''})")
    return f"def {name}({names}):  # {what}\n" + "\n".join(lines)


def _may_be_logical(tape: Tape, n: int) -> bool:
    """Whether Python may compute a node as a bool."""
    node = tape.nodes[n]
    if node.op == "choose":
        return any(_may_be_logical(tape, operand) for operand in node.operands[1:])
    return node.op in LOGICAL


def _number(value: float) -> str:
    if math.isnan(value):
        return "_nan"
    return ("_inf" if value > 0 else "-_inf") if math.isinf(value) else repr(value)


_INFIX = {op: OPERATIONS[op].c for op in ("add", "sub", "mul", "lt", "le", "eq", "ne")} | {"and": "and", "or": "or"}


def _expression(op: str, a: list[str], safe: bool) -> str:
    if op in _INFIX:
        return f"({a[0]} {_INFIX[op]} {a[1]})"
    match op:
        case "div":
            return f"_div({a[0]}, {a[1]})" if safe else f"({a[0]} / {a[1]})"
        case "neg":
            return f"(-{a[0]})"
        case "not":
            return f"(not {a[0]})"
        case "choose":
            return f"({a[1]} if {a[0]} else {a[2]})"
    return f"_{op}({', '.join(a)})"


def _numpy(function: Any) -> Callable[..., float]:
    return lambda *a: float(function(*(np.float64(x) for x in a)))


def _pick_any(index: float, table: Sequence[float]) -> float:
    return math.nan if math.isnan(index) else table[int(min(max(index, 0.0), len(table) - 1.0))]


_FAST: dict[str, object] = {
    **{f"_{op}": operation.value for op, operation in OPERATIONS.items()},
    "_hypot": math.hypot,  # which rounds better than that of C
    "_newton": newton,
    "_spread": spread,
    "_inf": math.inf,
    "_nan": math.nan,
}
_MAY_RAISE = COSTLY - {"search"} | {"div", "sqrt", "floor", "ceil"}
_SAFE: dict[str, object] = {
    **_FAST,
    **{f"_{op}": _numpy(OPERATIONS[op].ieee) for op in _MAY_RAISE},
    "_pick": _pick_any,
}
