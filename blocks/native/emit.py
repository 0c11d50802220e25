"""A Plan as C: one file, whose text follows from the structure of the diagram alone.

Values of parameters, start values and numbers that stand in the diagram are not in the text but in the rows p, n and c,
so that changing them compiles nothing. Everything has one of three levels:

    fixed       follows from parameters and numbers: computed by `prepare` into q
    held        follows from these and from discretes, sides and tick numbers: whole results of it that continuous
                programs need are computed by `refresh` into v
    moving      all else: computed where it is needed

Programs that run in every step or stage take from a type's function what is fixed in it, too: it becomes an argument
that is read from q. What is in q, v and n gets its place when it is first read, lane by lane, so that loops over equal
instances find it side by side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from ..errors import ModelError
from ..plan import Loop, Node, Plan, Program, Reference, _coinciding
from ..trace import Tape
from .emit_calls import Call, Copy, Sink, Tables, Value, print_program
from .emit_types import Function, comment, function_text, is_costly, needed_from

__all__ = ["Clique", "Emitted", "Stage", "emit"]

_FIXED, _HELD, _MOVING = 0, 1, 2
_LEVELS = {"p": _FIXED, "k": _FIXED, "c": _FIXED, "d": _HELD, "s": _HELD, "tick": _HELD}


@dataclass(frozen=True, slots=True)
class Stage:
    """What is computed together at a tick: the places in d of sampled outputs with their rates, and steppers."""

    slots: tuple[tuple[int, int], ...]
    steppers: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Clique:
    """Rates that may tick together, any of them or all; the first clique that holds the due ones is the one to run."""

    rates: frozenset[int]
    stages: tuple[Stage, ...]


@dataclass(frozen=True)
class Emitted:
    """A model: its C text, and what the text leaves open.

    x_order: the Plan's index of each state of the model. numbers, tables: the rows n and c. sizes: the macros
    BLOCKS_..., by their names without the prefix, where they are numbers.
    """

    source: str
    x_order: tuple[int, ...]
    numbers: tuple[float, ...]
    tables: tuple[float, ...]
    cliques: tuple[Clique, ...]
    sizes: Mapping[str, int]


def emit(
    plan: Plan,
    *,
    measured: Sequence[Reference] = (),
    method: str,
    logged: Sequence[Reference] = (),
    loops: bool = True,
) -> Emitted:
    """The model of a Plan. measured, logged: what its programs of these names give. method: whose stepping loop is
    compiled ("euler", "rk4", "dopri5"; any other: none). loops: False prints every call by itself."""
    return _Emitter(plan, loops).emitted(tuple(measured), method, tuple(logged))


_SIGNATURES = {
    "prepare": "BlocksMemory *m",
    "refresh": "BlocksMemory *m",
    "resets": "const BlocksMemory *m, double t, const double *x, int cause, double *out",
    "anew": "const BlocksMemory *m, double t, const double *x, int part, double *out",
    "outputs": "const BlocksMemory *m, double t, const double *x, int clique, int stage, const uint8_t *due, "
    "double *out",
    "nexts": "const BlocksMemory *m, double t, const double *x, const uint8_t *due, double *out",
    "stepper_inputs": "const BlocksMemory *m, double t, const double *x, int stepper, double *out",
}
_SIGNATURE = "const BlocksMemory *m, double t, const double *x, double *out"


@dataclass(slots=True)
class _Scope:
    """What one program knows: values by reference and by node, and how memory is read in it."""

    made: dict[Node, int]
    held: dict[Reference, Value]
    moved: Mapping[Reference, Reference]
    is_quick: bool = False  # whether what is fixed inside functions is taken from q
    is_start: bool = False


class _Emitter:
    def __init__(self, plan: Plan, loops: bool) -> None:
        self.plan, self.loops = plan, loops
        self.tables = Tables()
        self.functions: dict[object, Function] = {}
        self.texts: list[str] = []
        self.scratch = 0
        self.values = 0  # numbers of values given out
        self.q: dict[object, int] = {}
        self.v: dict[Node | Reference, int] = {}
        self.n: dict[object, int] = {}
        self.numbers: list[float] = []
        self.offsets = [0]
        for table in plan.tables:
            self.offsets.append(self.offsets[-1] + len(table))
        self.tape_numbers: dict[int, int] = {}
        self.reads_of: dict[tuple[int, str, int], tuple[int, ...]] = {}
        self.x_at: list[int] = list(range(len(plan.states)))
        self.states_of: dict[str, tuple[int, ...]] = {}
        self.is_hot = False  # whether loops of the program at hand read parameters side by side
        self.is_in_prepare = False
        self.read_master()

    # --- the continuous part, once --------------------------------------------------------------------------------

    def read_master(self) -> None:
        """The order of everything that is not sampled, and the level of each node."""
        plan = self.plan
        causes = (*plan.crossings, *plan.events)
        asked: list[Node | Reference] = [
            *plan.derivatives,
            *(cause.node for cause in causes),
            *(node for cause in causes for node, _ in cause.resets),
            *(node for node, _ in plan.projections),
            *(node for rate in plan.rates for node, _ in rate.nexts),
            *(("w", i) for i in range(len(plan.outputs))),
        ]
        program = plan.program(asked)
        self.steps = program.steps
        self.step_of: dict[Node, int] = {}
        self.level: dict[Node, int] = {}
        self.in_loop: dict[Node, None] = {}
        for number, step in enumerate(self.steps):
            if isinstance(step, Loop):
                for part in step.parts:
                    for key, element in part.results:
                        node = (part.instance, key, element)
                        self.step_of[node], self.level[node] = number, _MOVING
                        self.in_loop[node] = None
                continue
            for key, element in step.results:
                node = (step.instance, key, element)
                self.step_of[node] = number
                self.level[node] = max((self.level_of(r) for r in self.bound(node)), default=_FIXED)

    def level_of(self, reference: Reference) -> int:
        row, index = reference
        return self.level[self.plan.outputs[index]] if row == "w" else _LEVELS.get(row, _MOVING)

    def tape_node(self, node: Node) -> int:
        return self.plan.instances[node[0]].tape.results[node[1]].nodes[node[2]]

    def arguments_of(self, tape: Tape, n: int) -> tuple[int, ...]:
        key = (id(tape), "", n)
        if key not in self.reads_of:
            self.reads_of[key] = tape.arguments_of(n)
        return self.reads_of[key]

    def bound(self, node: Node) -> list[Reference]:
        """The memory that a node reads."""
        instance = self.plan.instances[node[0]]
        arguments = instance.arguments
        return [self.ticked(arguments[k], node) for k in self.arguments_of(instance.tape, self.tape_node(node))]

    def ticked(self, reference: Reference, node: Node) -> Reference:
        return ("tick", self.plan.rate_of.get(node, 0)) if reference[0] == "tick" else reference

    def aliased(self, reference: Reference) -> Reference | None:
        """What an unsampled output shows as it is: a state, a discrete, an input."""
        node = self.plan.outputs[reference[1]]
        if node in self.in_loop:
            return None
        tape = self.plan.instances[node[0]].tape
        made = tape.nodes[self.tape_node(node)]
        if made.op != "argument":
            return None
        found = self.plan.instances[node[0]].arguments[int(made.value)]
        return None if found[0] == "tick" else found

    # --- reading --------------------------------------------------------------------------------------------------

    def new_value(self) -> int:
        self.values += 1
        return self.values

    def value(self, reference: Reference, scope: _Scope, key: object) -> Value:
        """Where a reference is read in a program. key: the place of a number, which has one of its own."""
        while True:
            if reference in scope.held:
                return scope.held[reference]
            row, index = reference
            if reference in scope.moved:
                reference = scope.moved[reference]
            elif row == "k":
                return "n", (key, index)
            elif row == "tick":
                return "k", index
            elif row == "c":
                return "c", self.offsets[index]
            elif row != "w":
                return row, index
            else:
                found = self.aliased(reference)
                if found is None:
                    return self.node_value(self.plan.outputs[index], scope)
                reference = found

    def node_value(self, node: Node, scope: _Scope) -> Value:
        if node in scope.made:
            return "r", scope.made[node]
        if self.level[node] == _FIXED:
            return "q", (node[0], self.tape_node(node))
        return "v", node

    def place(self, value: Value) -> Value:
        """The row and the index of a value in memory; what has no place yet gets the next one."""
        row, index = value
        if row == "copy":
            if not self.is_hot:
                return index  # type: ignore[no-any-return]
            if index[0] == "p":
                return "q", self.q.setdefault(index, len(self.q))
            return "v", self.v.setdefault(index, len(self.v))
        if isinstance(index, int):
            return value
        if row == "q":
            return "q", self.q.setdefault(index, len(self.q))
        if row == "v":
            return "v", self.v.setdefault(index, len(self.v))
        key, number = index
        if key not in self.n:
            self.n[key] = len(self.n)
            self.numbers.append(float(number))
        return "n", self.n[key]

    # --- functions of types ---------------------------------------------------------------------------------------

    def tape_number(self, tape: Tape) -> int:
        return self.tape_numbers.setdefault(id(tape), len(self.tape_numbers))

    def function(self, tape: Tape, nodes: tuple[int, ...], fixed: int | None, what: str) -> Function:
        """The function of a type that computes nodes. fixed: the arguments that are fixed, as a bit set; None: what
        they make is computed with the rest."""
        reads = tape.reads
        if fixed is not None:
            needed = 0
            for n in nodes:
                needed |= reads[n]
            fixed &= needed
        key = (self.tape_number(tape), nodes, fixed)
        if key in self.functions:
            return self.functions[key]
        inputs: dict[int, str] = {}
        stack, seen = list(nodes), set(nodes)
        while stack:
            n = stack.pop()
            node = tape.nodes[n]
            if node.op == "argument":
                inputs[n] = ""
            elif fixed is not None and node.op != "constant" and reads[n] & ~fixed == 0:
                inputs[n] = ""
            else:
                for operand in node.operands:
                    if operand not in seen:
                        seen.add(operand)
                        stack.append(operand)
        tables: dict[int, int] = {}
        names: dict[int, str] = {}
        for n in sorted(inputs):
            argument = tape.arguments[int(tape.nodes[n].value)] if tape.nodes[n].op == "argument" else None
            if argument is not None and argument.kind == "table":
                variable = tape.interface.declaration.readable[argument.name]
                tables[n] = math.prod(tape.interface.shape(variable))
                names[n] = f"c{n}"
            else:
                names[n] = f"a{n}" if argument is not None else f"q{n}"
        name = f"f{len(self.functions)}"
        computed = needed_from(tape, nodes, names)
        self.texts.append(function_text(name, tape, nodes, names, tables, what))
        made = Function(name, tuple(names), len(nodes), 1 + len(computed), is_costly(tape, computed))
        self.functions[key] = made
        return made

    def call(self, instance: int, nodes: Sequence[Node], scope: _Scope) -> Call:
        """A call that computes nodes of one instance."""
        block = self.plan.instances[instance]
        tape = block.tape
        asked = tuple(self.tape_node(node) for node in nodes)
        fixed = self.fixed_of(instance) if scope.is_quick else None
        what = f"{tape.interface.name} {' '.join(dict.fromkeys(key for _, key, _ in nodes))}"
        function = self.function(tape, asked, fixed, what)
        arguments: list[Value] = []
        for n in function.inputs:
            if tape.nodes[n].op == "argument":
                k = int(tape.nodes[n].value)
                reference = self.ticked(block.arguments[k], nodes[0])
                arguments.append(self.value(reference, scope, (instance, k)))
            else:
                arguments.append(("q", (instance, n)))
        values = [self.new_value() for _ in nodes]
        scope.made.update(zip(nodes, values, strict=True))
        return Call(function, block.path, instance, arguments, values, [[] for _ in nodes])

    def fixed_of(self, instance: int) -> int:
        """The arguments of an instance that are fixed, as a bit set."""
        bits = 0
        for k, reference in enumerate(self.plan.instances[instance].arguments):
            row = reference[0]
            if row == "p" or row == "k" or row == "c" or (row == "w" and self.level_of(reference) == _FIXED):
                bits |= 1 << k
        return bits

    # --- algebraic loops ------------------------------------------------------------------------------------------

    def solved(self, loop: Loop, scope: _Scope) -> Call:
        """A call that solves an algebraic loop: it takes what the loop needs from outside, and the guesses."""
        plan = self.plan
        number_of = {reference: k for k, reference in enumerate(loop.unknowns)}
        known: list[Value] = []
        form: list[object] = [len(loop.unknowns)]
        lines: list[str] = []
        n = len(loop.unknowns)
        residuals, matrix = [""] * n, [[[] for _ in range(n)] for _ in range(n)]  # type: ignore[var-annotated]
        nodes_of: list[Node | None] = [None] * n
        weight = 0
        for number, part in enumerate(loop.parts):
            block = plan.instances[part.instance]
            count, first = len(part.results), (part.instance, *part.results[0])
            asked = (*part.tape.results["value"].nodes, *part.tape.results["partial"].nodes)
            function = self.function(part.tape, asked, None, f"{block.tape.interface.name} value partial")
            weight += function.weight
            given: list[str] = []
            for node in function.inputs:
                k = int(part.tape.nodes[node].value)
                reference = self.ticked(block.arguments[k], first)
                if reference in number_of:
                    given.append(f"unknowns[{number_of[reference]}]")
                    continue
                text = f"known[{len(known)}]"
                value = self.value(reference, scope, (part.instance, k))
                if value[0] == "c":
                    value, text = ("offset", value[1]), f"m->c + (int){text}"
                known.append(value)
                given.append(text)
            made = [f"a{number}_{k}" for k in range(len(asked))]
            if len(asked) == 1:
                lines.append(f"const double {made[0]} = {function.name}({', '.join(given)});")
            else:
                lines.append(f"double {', '.join(made)};")
                lines.append(f"{function.name}({', '.join((*given, *(f'&{a}' for a in made)))});")
            for k, (row, (key, element)) in enumerate(zip(part.rows, part.results, strict=True)):
                nodes_of[row] = (part.instance, key, element)
                is_residual = block.tape.results[key].role == "residual"
                residuals[row] = made[k] if is_residual else f"{made[k]} - unknowns[{row}]"
                for j, column in enumerate(part.columns):
                    matrix[row][column].append(made[count + k * len(part.columns) + j])
                if not is_residual:
                    matrix[row][row].append("-1.0")
        for row in range(n):
            lines.append(f"residuals[{row}] = {residuals[row]};")
            for column in range(n):
                lines.append(f"matrix[{row * n + column}] = {' + '.join(matrix[row][column]) or '0.0'};")
        form += lines
        guesses: list[Value] = []
        for reference in loop.unknowns:
            if reference in plan.unknowns_at:
                guesses.append(("z", plan.unknowns_at[reference]))
            elif reference[0] == "d" and not scope.is_start:
                guesses.append(reference)
            else:
                guesses.append(("n", (("guess", reference), plan.guesses.get(reference, 0.0))))
        solver = self.solver(tuple(form), len(known), n, lines, weight)
        values = [self.new_value() for _ in range(n)]
        for node, value in zip(nodes_of, values, strict=True):
            assert node is not None
            scope.made[node] = value
        path = plan.instances[loop.parts[0].instance].path
        return Call(solver, path, loop.parts[0].instance, [*known, *guesses], values, [[] for _ in range(n)])

    def solver(self, form: tuple[object, ...], known: int, n: int, lines: list[str], weight: int) -> Function:
        """The function that solves loops of one form."""
        key = ("loop", form, known)
        if key in self.functions:
            return self.functions[key]
        name = f"f{len(self.functions)}"
        head = "const BlocksMemory *m, const double *known, const double *unknowns, double *residuals, double *matrix"
        body = "\n".join(f"    {line}" for line in lines)
        system = f"static void {name}_system({head})\n{{\n    (void)m, (void)known, (void)unknowns;\n{body}\n}}\n"
        taken = [*(f"double a{k}" for k in range(known)), *(f"double z{k}" for k in range(n))]
        taken += [f"double *r{k}" for k in range(n)]
        inside = ", ".join(f"a{k}" for k in range(known)) or "0.0"
        text = (
            f"{system}\nstatic void {name}(const BlocksMemory *m, {', '.join(taken)})\n{{\n"
            f"    const double known[] = {{{inside}}};\n"
            f"    double unknowns[] = {{{', '.join(f'z{k}' for k in range(n))}}};\n"
            f"    blocks_newton({name}_system, m, known, {n}, unknowns);\n"
            + "".join(f"    *r{k} = unknowns[{k}];\n" for k in range(n))
            + "}\n"
        )
        self.texts.append(text)
        made = Function(name, (), n, 4 * weight, True, True)
        self.functions[key] = made
        return made

    # --- programs -------------------------------------------------------------------------------------------------

    def sliced(self, asked: Iterable[Node | Reference], scope: _Scope, *, held: Callable[[Node], bool]) -> list[Call]:
        """The calls of the continuous part that nodes and references need. held: whether a held node is read from v."""
        wanted: dict[Node, None] = {}
        stack: list[Node] = []

        def ask(reference: Reference) -> None:
            while reference[0] == "w":
                found = self.aliased(reference)
                if found is None:
                    node = self.plan.outputs[reference[1]]
                    if not self.is_known(node, held):
                        stack.append(node)
                    return
                reference = found
            if reference[0] == "x":
                self.seen_states[reference[1]] = None

        for item in asked:
            if len(item) == 3:
                if not (scope.is_quick and self.is_known(item, held)):
                    stack.append(item)
            else:
                ask(item)
        done_loops: dict[int, None] = {}
        while stack:
            node = stack.pop()
            if node in wanted:
                continue
            wanted[node] = None
            number = self.step_of[node]
            step = self.steps[number]
            if isinstance(step, Loop) and number not in done_loops:
                done_loops[number] = None
                stack += [(part.instance, key, e) for part in step.parts for key, e in part.results]
            for reference in self.bound(node):
                if not (isinstance(step, Loop) and reference in step.unknowns):
                    ask(reference)
        by_step: dict[int, list[Node]] = {}
        for node in wanted:
            by_step.setdefault(self.step_of[node], []).append(node)
        calls = []
        for number in sorted(by_step):
            step = self.steps[number]
            if isinstance(step, Loop):
                calls.append(self.solved(step, scope))
                continue
            nodes = by_step[number]
            if len(nodes) > 1:
                nodes = [(step.instance, k, e) for k, e in step.results if (step.instance, k, e) in wanted]
            calls.append(self.call(step.instance, nodes, scope))
        return calls

    def is_known(self, node: Node, held: Callable[[Node], bool]) -> bool:
        level = self.level[node]
        return level == _FIXED or (level == _HELD and held(node))

    def continuous(
        self,
        name: str,
        asked: Sequence[Node | Reference],
        sinks: Sequence[Sink],
        *,
        is_quick: bool = True,
        guards: Sequence[tuple[int, ...]] = (),
        before: Callable[[list[Call]], None] | None = None,
    ) -> str:
        """The body of a program over the continuous part: `asked` go to `sinks`."""
        scope = _Scope({}, {}, {}, is_quick)
        self.seen_states: dict[int, None] = {}
        calls = self.sliced(asked, scope, held=(lambda node: True) if is_quick else self.v.__contains__)
        copies = self.attach(name, calls, asked, sinks, scope)
        if guards:
            self.guard(calls, {node: guard for node, guard in zip(asked, guards, strict=True) if len(node) == 3}, scope)
        if before is not None:
            before(calls)
        self.states_of[name] = tuple(sorted(self.x_at[i] for i in self.seen_states))
        return self.printed(name, calls, copies, is_hot=is_quick)

    def attach(
        self,
        name: str,
        calls: Sequence[Call],
        asked: Sequence[Node | Reference],
        sinks: Sequence[Sink],
        scope: _Scope,
    ) -> list[Copy]:
        """Sinks at the calls that make what they take; copies for all else."""
        made = {value: (call, k) for call in calls for k, value in enumerate(call.values)}
        copies = []
        for number, (item, sink) in enumerate(zip(asked, sinks, strict=True)):
            if len(item) == 3:
                value = self.node_value(item, scope)
            else:
                value = self.value(item, scope, (name, number))
            if value[0] == "r":
                call, k = made[value[1]]
                call.sinks[k].append(sink)
            else:
                copies.append(Copy(value, sink))
        return copies

    def guard(self, calls: list[Call], guards: Mapping[Node, tuple[int, ...]], scope: _Scope) -> None:
        """Guard each call by the rates that need it."""
        made = {value: call for call in calls for value in call.values}
        wanted: dict[Call, set[int]] = {call: set() for call in calls}
        for node, rates in guards.items():
            wanted[made[scope.made[node]]].update(rates)
        for call in reversed(calls):
            call.guard = tuple(sorted(wanted[call]))
            for row, index in call.arguments:
                if row in ("r", "ge"):
                    wanted[made[index]].update(call.guard)

    def printed(self, name: str, calls: list[Call], copies: list[Copy], *, is_hot: bool = False) -> str:
        self.is_hot = is_hot
        made = print_program(
            name, calls, copies, self.place, self.tables, x_at=self.x_at, loops=self.loops,
            is_aliased=self.is_in_prepare,
        )  # fmt: skip
        self.texts += [made.functions] if made.functions else []
        self.scratch = max(self.scratch, made.scratch)
        return made.body

    def define(self, name: str, body: str) -> None:
        """A program of a fixed name."""
        if name in ("prepare", "refresh"):
            row = "q" if name == "prepare" else "v"
            body = f"    const double t = 0.0, *const x = m->x;\n    double *const out = m->{row};\n{body}"
        signature = _SIGNATURES.get(name, _SIGNATURE)
        if name == "rates":
            signature = "const BlocksMemory *m, double t, const double *restrict x, double *restrict out"
        unused = ", ".join(f"(void){taken.split()[-1].lstrip('*')}" for taken in signature.split(", "))
        if name in ("prepare", "refresh"):
            unused = "(void)t, (void)x, (void)out"
            body, rest = "\n".join(body.split("\n")[:2]), "\n".join(body.split("\n")[2:])
            text = f"{body}\n    {unused};\n{rest}"
        else:
            text = f"    {unused};\n{body}"
        kind = "static inline void" if name == "rates" else "static void"
        self.texts.append(f"{kind} {name}({signature})\n{{\n{text}\n}}\n")

    def selected(self, name: str, by: str, bodies: Sequence[str]) -> None:
        """A program that consists of others, one for each value of an argument."""
        cases = []
        for k, body in enumerate(bodies):
            if body:
                self.texts.append(f"static void {name}_{k}({_SIGNATURE})\n{{\n    (void)m, (void)t, (void)x, (void)out;\n{body}\n}}\n")
                cases.append(f"    case {k}: {name}_{k}(m, t, x, out); break;\n")
        text = f"    (void){by};\n    switch ({by}) {{\n{''.join(cases)}    default: break;\n    }}"
        self.define(name, text)

    def order_states(self, calls: list[Call]) -> None:
        """The model's order of states: those of equal instances side by side, as their loop writes them."""
        groups: dict[object, list[Call]] = {}
        for call in calls:
            if any(call.sinks):
                groups.setdefault((call.function.name, tuple(len(sinks) for sinks in call.sinks)), []).append(call)
        x_order: list[int] = []
        plain: list[int] = []
        rest: list[int] = []
        for group in groups.values():
            columns = [
                [call.sinks[k][j].index for call in sorted(group, key=lambda call: call.order)]
                for k, sinks in enumerate(group[0].sinks)
                for j in range(len(sinks))
            ]
            if len(group) < 4:
                plain += [index for column in columns for index in column]
            else:
                rest += [index for column in columns for index in column]
        known = {index: None for index in (*plain, *rest)}
        copied = [index for index in range(len(self.plan.states)) if index not in known]
        x_order = [*sorted([*plain, *copied]), *rest]
        for place, index in enumerate(x_order):
            self.x_at[index] = place
        self.x_order = tuple(x_order)
        for call in calls:
            call.sinks = [
                [Sink(self.x_at[s.index], s.condition, s.off) for s in sinks] for sinks in call.sinks
            ]

    # --- all of them ----------------------------------------------------------------------------------------------

    def emitted(self, measured: tuple[Reference, ...], method: str, logged: tuple[Reference, ...]) -> Emitted:
        plan = self.plan
        conditions = [instance.condition for instance in plan.instances]

        def of(node: Node) -> int | None:
            return conditions[node[0]]

        def plain(items: Sequence[object]) -> list[Sink]:
            return [Sink(k) for k in range(len(items))]

        def sink(k: int, node: Node, off: str) -> Sink:
            side = of(node)
            return Sink(k) if side is None else Sink(k, side, off)

        self.rates(sink)
        nodes = [cause.node for cause in plan.crossings]
        self.define("crossings", self.continuous("crossings", nodes, [sink(k, n, "side") for k, n in enumerate(nodes)]))
        remembered = tuple(history.source for history in plan.histories)
        for name, asked in (
            ("solutions", plan.unknowns), ("logged", logged), ("measured", measured), ("remembered", remembered),
        ):  # fmt: skip
            self.define(name, self.continuous(name, asked, plain(asked)))
        self.refresh()
        nodes = [cause.node for cause in plan.events]
        sinks = [sink(k, node, "inf") for k, node in enumerate(nodes)]
        self.define("event_times", self.continuous("event_times", nodes, sinks, is_quick=False))
        bodies = []
        for k, cause in enumerate((*plan.crossings, *plan.events)):
            nodes = [node for node, _ in cause.resets]
            bodies.append(self.continuous(f"resets_{k}", nodes, plain(nodes), is_quick=False) if nodes else "")
        self.selected("resets", "cause", bodies)
        nodes = [node for node, _ in plan.projections]
        self.define("projections", self.continuous("projections", nodes, plain(nodes), is_quick=False))
        self.nexts(sink)
        bodies = []
        for k, part in enumerate(plan.steppers):
            references = [reference for _, references, _ in part.inputs for reference in references]
            bodies.append(self.continuous(f"stepper_inputs_{k}", references, plain(references), is_quick=False))
        self.selected("stepper_inputs", "stepper", bodies)
        self.start()
        bodies = []
        for k, enabled in enumerate(plan.enabled):
            program = plan.program(enabled.resets, start=frozenset(enabled.resets))
            bodies.append(self.own(f"anew_{k}", program, plain(enabled.resets)) if enabled.resets else "")
        self.selected("anew", "part", bodies)
        cliques = self.outputs(sink)
        self.prepare()
        moving = any(self.level[cause.node] == _MOVING for cause in plan.crossings)
        return self.finished(measured, method, logged, cliques, moving)

    def rates(self, sink: Callable[[int, Node, str], Sink]) -> None:
        nodes = self.plan.derivatives
        sinks = [sink(k, node, "zero") for k, node in enumerate(nodes)]
        scope = _Scope({}, {}, {}, True)
        self.seen_states = {}
        calls = self.sliced(nodes, scope, held=lambda node: True)
        copies = self.attach("rates", calls, nodes, sinks, scope)
        self.order_states(calls)
        copies = [Copy(c.value, Sink(self.x_at[c.sink.index], c.sink.condition, c.sink.off)) for c in copies]
        copies.sort(key=lambda copy: copy.sink.index)
        self.define("rates", self.printed("rates", calls, copies, is_hot=True))

    def refresh(self) -> None:
        """What is in v by now, and what that needs."""
        nodes = list(self.v)
        scope = _Scope({}, {}, {})
        self.seen_states = {}
        calls = self.sliced(nodes, scope, held=lambda node: False)
        copies = self.attach("refresh", calls, nodes, [Sink(k) for k in range(len(nodes))], scope)
        self.define("refresh", self.printed("refresh", calls, copies))

    def nexts(self, sink: Callable[[int, Node, str], Sink]) -> None:
        pairs = [(node, slot, k) for k, rate in enumerate(self.plan.rates) for node, slot in rate.nexts]
        nodes = [node for node, _, _ in pairs]
        sinks = [sink(slot, node, "keep") for node, slot, _ in pairs]
        body = self.continuous("nexts", nodes, sinks, is_quick=False, guards=[(k,) for _, _, k in pairs])
        self.define("nexts", body)

    def own(self, name: str, program: Program, sinks: Sequence[Sink], *, is_start: bool = True) -> str:
        """The body of a program with an order of its own, in which memory is not filled yet."""
        scope = _Scope({}, {}, program.moved, False, is_start)
        self.seen_states = {}
        calls = self.calls_of(program, scope)
        copies = self.attach(name, calls, program.results, sinks, scope)
        return self.printed(name, calls, copies)

    def calls_of(self, program: Program, scope: _Scope) -> list[Call]:
        calls = []
        for step in program.steps:
            if isinstance(step, Loop):
                calls.append(self.solved(step, scope))
                nodes = [(part.instance, key, e) for part in step.parts for key, e in part.results]
            else:
                nodes = [(step.instance, key, e) for key, e in step.results]
                calls.append(self.call(step.instance, nodes, scope))
            for node in nodes:
                reference = program.made.get(node)
                if reference is not None:
                    scope.held[reference] = ("ge" if reference[0] == "s" else "r", scope.made[node])
        return calls

    def start(self) -> None:
        plan = self.plan
        nx, nd = len(plan.states), len(plan.discretes)
        asked: list[Node | Reference] = [("x", i) for i in range(nx)]
        asked += [("d", i) for i in range(nd)]
        program = plan.program([*asked, *plan.s_start], start=plan.starting)
        places = [*self.x_at, *range(nx, nx + nd + len(plan.s_start))]
        self.define("start", self.own("start", program, [Sink(k) for k in places]))

    def outputs(self, sink: Callable[[int, Node, str], Sink]) -> tuple[Clique, ...]:
        plan = self.plan
        if not plan.rates:
            self.define("outputs", "    (void)clique, (void)stage, (void)due;")
            return ()
        cliques: list[Clique] = []
        cases: list[str] = []
        for rates in self.cliques():
            stages = []
            for number, members in enumerate(plan.stages(rates)):
                slots = tuple((slot, plan.held_nodes[slot][1]) for slot in sorted(members) if slot >= 0)
                stages.append(Stage(slots, tuple(sorted(-1 - key for key in members if key < 0))))
                if not slots:
                    continue
                name = f"outputs_{len(cliques)}_{number}"
                body = self.stage(name, slots, sink)
                signature = "const BlocksMemory *m, double t, const double *x, const uint8_t *due, double *out"
                unused = "    (void)m, (void)t, (void)x, (void)due, (void)out;"
                self.texts.append(f"static void {name}({signature})\n{{\n{unused}\n{body}\n}}\n")
                cases.append(f"    if (clique == {len(cliques)} && stage == {number}) {name}(m, t, x, due, out);")
            cliques.append(Clique(rates, tuple(stages)))
        self.define("outputs", "\n".join(["    (void)clique, (void)stage, (void)due;", *cases]))
        return tuple(cliques)

    def cliques(self) -> list[frozenset[int]]:
        """The sets of rates that have programs, each before those that hold it."""
        plan = self.plan
        everything = frozenset(range(len(plan.rates)))
        if self.can_tick(everything) and not self.is_split(everything):
            return [everything]
        largest = sorted(_coinciding(plan.rates), key=sorted)
        made: dict[frozenset[int], None] = {}
        for clique in largest:
            if not self.is_split(clique):
                made[clique] = None
                continue
            # An algebraic loop through sampled outputs is another one where not all of them are due.
            members = sorted(clique)
            for bits in range(1, 1 << len(members)):
                made[frozenset(k for n, k in enumerate(members) if bits >> n & 1)] = None
        return sorted(made, key=lambda rates: (len(rates), sorted(rates)))

    def can_tick(self, rates: frozenset[int]) -> bool:
        try:
            self.plan.stages(rates)
            self.tick_program(frozenset(slot for k in rates for _, slot in self.plan.rates[k].outputs))
        except ModelError:
            return False
        return True

    def tick_program(self, due: frozenset[int]) -> Program:
        return self.plan.program([("d", slot) for slot in sorted(due)], due=due)

    def is_split(self, rates: frozenset[int]) -> bool:
        """Whether an algebraic loop goes through a sampled output, and not all of the rates must be due."""
        if len(rates) < 2:
            return False
        program = self.tick_program(frozenset(slot for k in rates for _, slot in self.plan.rates[k].outputs))
        return any(r[0] == "d" for step in program.steps if isinstance(step, Loop) for r in step.unknowns)

    def stage(self, name: str, slots: Sequence[tuple[int, int]], sink: Callable[[int, Node, str], Sink]) -> str:
        """The sampled outputs of one stage; one that is not due shows its held value to others."""
        plan = self.plan
        program = self.tick_program(frozenset(slot for slot, _ in slots))
        scope = _Scope({}, {}, {}, False)
        self.seen_states = {}
        calls = [call for call in self.calls_of(program, scope)]
        nodes = [plan.held_nodes[slot][0] for slot, _ in slots]
        sinks = [sink(slot, node, "keep") for (slot, _), node in zip(slots, nodes, strict=True)]
        self.attach(name, calls, nodes, sinks, scope)
        self.guard_stage(calls, {node: rate for node, (_, rate) in zip(nodes, slots, strict=True)}, scope)
        return self.printed(name, calls, [])

    def guard_stage(self, calls: list[Call], rates: Mapping[Node, int], scope: _Scope) -> None:
        """Guard calls by the rates that need them. A sampled output is needed by its own rate only: where another one
        needs it and it is not due, its held value stands there."""
        plan = self.plan
        made = {value: call for call in calls for value in call.values}
        wanted: dict[Call, set[int]] = {call: set() for call in calls}
        fixed: dict[Call, int] = {}
        slot_of = {node: slot for slot, (node, _) in plan.held_nodes.items()}
        place = {value: slot_of[node] for node, value in scope.made.items() if node in rates}
        for node, rate in rates.items():
            fixed[made[scope.made[node]]] = rate
        read = {index for call in calls for row, index in call.arguments if row in ("r", "ge")}
        for call in reversed(calls):
            call.guard = (fixed[call],) if call in fixed else tuple(sorted(wanted[call]))
            if call in fixed and all(value in place for value in call.values):
                if any(value in read for value in call.values):
                    call.fallback = [("d", place[value]) for value in call.values]
            for row, index in call.arguments:
                if row in ("r", "ge"):
                    wanted[made[index]].update(call.guard)

    def prepare(self) -> None:
        """What is in q by now, and what that needs, in the order in which it needs each other."""
        self.is_in_prepare = True
        plan = self.plan
        depth: dict[object, int] = {}
        items = [key for key in self.q if key[0] != "p"]  # type: ignore[index]

        def before(key: tuple[int, int]) -> list[tuple[int, int]]:
            instance, n = key
            block = plan.instances[instance]
            found = []
            for k in self.arguments_of(block.tape, n):
                reference: Reference | None = block.arguments[k]
                while reference is not None and reference[0] == "w":
                    other = self.aliased(reference)
                    if other is None:
                        node = plan.outputs[reference[1]]
                        found.append((node[0], self.tape_node(node)))
                    reference = other
            return found

        stack = list(reversed(items))
        while stack:
            key = stack[-1]
            if key in depth:
                stack.pop()
                continue
            needs = before(key)  # type: ignore[arg-type]
            missing = [other for other in needs if other not in depth]
            if missing:
                stack += missing
                continue
            stack.pop()
            depth[key] = 1 + max((depth[other] for other in needs), default=-1)
            self.q.setdefault(key, len(self.q))
        by_depth: dict[int, dict[int, list[int]]] = {}
        for key, level in depth.items():
            instance, n = key  # type: ignore[misc]
            by_depth.setdefault(level, {}).setdefault(instance, []).append(n)
        bodies = []
        for level in sorted(by_depth):
            calls = []
            for instance, nodes in sorted(by_depth[level].items()):
                calls.append(self.prepared(instance, tuple(sorted(nodes))))
            name = f"prepare_{level}"
            body = self.printed(name, calls, [])
            self.texts.append(f"static void {name}({_SIGNATURE})\n{{\n    (void)m, (void)t, (void)x, (void)out;\n{body}\n}}\n")
            bodies.append(f"    {name}(m, t, x, out);")
        copies = [Copy(("p", key[1]), Sink(slot)) for key, slot in self.q.items() if key[0] == "p"]  # type: ignore[index]
        copies.sort(key=lambda copy: copy.sink.index)
        body = self.printed("prepare_copies", [], copies) if copies else ""
        if copies:
            self.texts.append(f"static void prepare_copied({_SIGNATURE})\n{{\n    (void)x, (void)t;\n{body}\n}}\n")
            bodies.append("    prepare_copied(m, t, x, out);")
        self.define("prepare", "\n".join(bodies))

    def prepared(self, instance: int, nodes: tuple[int, ...]) -> Call:
        """A call that computes nodes inside a type for q."""
        block = self.plan.instances[instance]
        tape = block.tape
        function = self.function(tape, nodes, None, f"{tape.interface.name} fixed")
        scope = _Scope({}, {}, {})
        arguments = []
        for n in function.inputs:
            k = int(tape.nodes[n].value)
            arguments.append(self.value(block.arguments[k], scope, (instance, k)))
        sinks = [[Sink(self.q[instance, n])] for n in nodes]
        return Call(function, block.path, instance, arguments, [self.new_value() for _ in nodes], sinks)

    def finished(
        self,
        measured: tuple[Reference, ...],
        method: str,
        logged: tuple[Reference, ...],
        cliques: tuple[Clique, ...],
        moving: bool,
    ) -> Emitted:
        plan = self.plan
        sizes = {
            "NX": len(plan.states), "ND": len(plan.discretes), "NS": len(plan.crossings), "NP": len(plan.parameters),
            "NU": sum(math.prod(shape) for _, shape, *_ in plan.inputs), "NH": len(plan.histories),
            "NZ": len(plan.unknowns), "NRATES": len(plan.rates), "NQ": len(self.q), "NV": len(self.v),
            "NN": len(self.numbers), "NC": self.offsets[-1], "NW": self.scratch, "NEVENTS": len(plan.events),
            "NLOGGED": len(logged), "NMEASURED": len(measured), "NREMEMBERED": len(plan.histories),
            "NPROJECTIONS": len(plan.projections), "MOVING_SIDES": int(moving),
        }  # fmt: skip
        states = []
        for name in ("logged", "measured", "remembered", "crossings"):
            found = self.states_of[name]
            sizes[f"N{name.upper()}_STATES"] = len(found)
            states.append(f"static const int {name}_states[] = {{{', '.join(map(str, found)) or '0'}}};\n")
        macros = [f"#define BLOCKS_{name} {value}\n" for name, value in sizes.items()]
        known = {"rk4": "RK4", "dopri5": "DOPRI5", "euler": "EULER"}
        macros.append(f"#define BLOCKS_METHOD_{known.get(method, 'NONE')} 1\n")
        source = "".join([
            f"/* {comment(plan.name)} */\n", *macros, '\n#include "model.h"\n\n', self.tables.text, *states, "\n",
            "\n".join(self.texts), '\n#include "steps.h"\n',
        ])  # fmt: skip
        table = tuple(value for values in plan.tables for value in values)
        return Emitted(source, self.x_order, tuple(self.numbers), table, cliques, sizes)
