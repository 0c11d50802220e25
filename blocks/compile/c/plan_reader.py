"""A Plan read for printing: the level of each node, where values are read, the calls that compute them.

Nothing here knows what a program is for: it turns nodes and references into `Call`s and `Copy`s, prints the functions
of types and of algebraic loops that these need, and gives places to what is laid out when it is first read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from ...contract.tape import Tape
from ..fmu_tape import FmuTape, Request
from ..folding import At, Folded
from ..motion import Motions
from ..plan import AlgebraicLoop, LoopPart, Node, Plan, Program, Reference
from ..scheduler import schedule
from ..tearing import bounds, sensitivities, slopes
from .fmu_requests import request_text
from .function_code import Function, function_text, is_costly, needed_from
from .loops import Call, Place, Value
from .program_code import Tables

FIXED, HELD, MOVING = 0, 1, 2
_PLAIN = frozenset({"x", "d", "s", "p", "u", "h", "t"})  # rows that are read in place
_OF_BLOCKS = frozenset("xdspwh")
_LEVELS = {"p": FIXED, "k": FIXED, "c": FIXED, "d": HELD, "s": HELD, "tick": HELD}


@dataclass(slots=True)
class ProgramScope:
    """What is known in one program: values by reference and by node, and how memory is read."""

    made: dict[Node, int]
    held: dict[Reference, Value]
    moved: Mapping[Reference, Reference]
    is_quick: bool = False  # whether what is fixed inside functions is taken from q
    is_start: bool = False
    is_hot: bool = False  # whether divisions by parameters become products
    is_rounding: bool = False  # whether loops give how far rounding may move their unknowns, which z holds


_GATHER = Function("gather", (), (), 1, 1, True)
K = TypeVar("K")


class Places(dict[K, int]):
    """Places in a row that are given out when they are first asked for; of copies, side by side."""

    size = 0

    def place(self, key: K, lanes: int = 1) -> int | range:
        if key not in self:
            self[key], self.size = self.size, self.size + lanes
        return self[key] if lanes == 1 else range(self[key], self[key] + lanes)


class PlanReader:
    """plan: where there are copies, that of one copy; folded: what it is for the whole diagram.

    watched: by name, what is looked at inside steps.
    """

    def __init__(
        self, plan: Plan, loops: bool, watched: Mapping[str, Sequence[Node | Reference]], folded: Folded | None = None
    ) -> None:
        self.plan, self.loops, self.watched, self.folded = plan, loops, watched, folded
        motions = Motions(plan)
        self.motions = {name: motions.of(asked) for name, asked in watched.items()}
        self.is_bent = motions.is_bent
        self.tables = Tables()
        self.functions: dict[object, Function] = {}
        self.texts: list[str] = []
        self.printed_as: dict[str, tuple[Tape, tuple[int, ...], dict[int, str], dict[int, int], str]] = {}
        self.scratch = 0
        self.same: dict[tuple[str, int, int], None] = {}  # pieces of q and n that loops read as one number if equal
        self.seen_states: dict[tuple[int, int], None] = {}  # of the program at hand, with the lane; -1: in all
        self.sides: tuple[int, ...] = ()  # the crossings in the order in which they follow the rates
        self.kept_tapes: list[Tape] = []
        self.values = 0  # numbers of values given out
        self.q: Places[tuple[int | str, int]] = Places()  # by instance and node of its tape; ('p', index): a copy
        self.v: Places[Node | Reference] = Places()
        self.n: dict[object, int] = {}
        self.numbers: list[float] = []
        self.tape_numbers: dict[int, int] = {}
        self.forms: dict[object, Function] = {}  # by type and results asked for
        self.fixed_arguments: dict[int, int] = {}
        self.before: dict[Node, list[Reference]] = {}  # of what each node reads, what is moving or held
        self.x_at: list[int] = list(range(len(plan.states)))  # of copies: the place of the first
        self.states_of: dict[str, tuple[int, ...]] = {}
        self.is_hot = False  # whether loops of the program at hand read parameters side by side
        self.is_in_prepare = False
        self.read_master()

    # --- the continuous part, once --------------------------------------------------------------------------------

    def read_master(self) -> None:
        """The order of all that is not sampled, and the level of each node."""
        plan = self.plan
        phases = dict.fromkeys(node for motion in self.motions.values() for node in motion.phases)
        asked = [*plan.continuous.results, *phases]
        program = schedule(plan, asked)
        self.steps = program.steps
        self.step_of: dict[Node, int] = {}
        self.level: dict[Node, int] = {}
        self.in_loop: dict[Node, None] = {}
        for number, step in enumerate(self.steps):
            if isinstance(step, AlgebraicLoop):
                for node in step.nodes:
                    self.step_of[node], self.level[node] = number, MOVING
                    self.in_loop[node] = None
                continue
            for node in step.nodes:
                self.step_of[node] = number
                level, before = FIXED, []
                arguments = plan.instances[step.instance].arguments
                for k in plan.instances[step.instance].tape.read_by[node.key][node.element]:
                    reference = arguments[k]
                    its = self.level_of(reference)
                    level = max(level, its)
                    if its > FIXED:
                        before.append(reference)
                if self.gathered(step.instance) is not None:
                    level = MOVING  # it is no function of a type, which could be fixed
                self.level[node], self.before[node] = level, before

    def level_of(self, reference: Reference) -> int:
        row, index = reference
        return self.level[self.plan.outputs[index]] if row == "w" else _LEVELS.get(row, MOVING)

    # --- copies ---------------------------------------------------------------------------------------------------

    def copies_of(self, instance: int) -> int:
        """How many copies an instance stands for."""
        return 1 if self.folded is None else self.folded.copies(instance)

    def gathered(self, instance: int) -> tuple[Reference, ...] | None:
        """What an instance gathers, one for each lane."""
        return None if self.folded is None else self.folded.gathers.get(instance)

    def lanes_of(self, row: str, index: int) -> int:
        """How many copies a place of memory stands for."""
        if self.folded is None:
            return 1
        return self.copies_of(self.plan.outputs[index].instance) if row == "w" else self.folded.lanes(row, index)

    def all_places(self, row: str, index: int) -> range | int:
        """The places of a place of memory in the whole diagram."""
        places = index if self.folded is None else self.folded.places(row, index)
        return places[0] if isinstance(places, range) and len(places) == 1 else places

    def spread(self, instances: Sequence[int]) -> list[range | int]:
        """The numbers in the whole diagram of what instances have one after the other."""
        if self.folded is None:
            return list(range(len(instances)))
        return [numbers[0] if len(numbers) == 1 else numbers for numbers in self.folded.spread(instances)]

    def in_lane(self, value: Value, lane: int | None) -> Value:
        """A value as it is in a certain lane; None: in that of the reader."""
        if lane is None:
            return value
        return (value[0], At(value[1], lane)) if value[0] in ("r", "ge") else ("at", (value, lane))

    def tape_node(self, node: Node) -> int:
        return self.plan.instances[node.instance].tape.results[node.key].nodes[node.element]

    def bound(self, node: Node) -> list[Reference]:
        """The memory that a node reads."""
        instance = self.plan.instances[node.instance]
        arguments = instance.arguments
        return [self.ticked(arguments[k], node) for k in instance.tape.read_by[node.key][node.element]]

    def ticked(self, reference: Reference, node: Node) -> Reference:
        return Reference("tick", self.plan.rate_of.get(node, 0)) if reference.row == "tick" else reference

    def aliased(self, reference: Reference) -> Reference | None:
        """What an unsampled output shows unchanged: a state, a discrete, an input."""
        node: Node = self.plan.outputs[reference.index]
        if node in self.in_loop or self.gathered(node.instance) is not None:
            return None
        tape = self.plan.instances[node.instance].tape
        tape_node = tape.nodes[self.tape_node(node)]
        if tape_node.op != "argument":
            return None
        return self.plan.instances[node.instance].arguments[int(tape_node.value)]

    # --- reading --------------------------------------------------------------------------------------------------

    def new_value(self) -> int:
        self.values += 1
        return self.values

    def value(self, reference: Reference, scope: ProgramScope, key: object) -> Value:
        """Where a reference is read in a program. key: for a number, which has a place of its own."""
        lane: int | None = None
        while True:
            row, index = reference
            if self.folded is not None and row in _OF_BLOCKS:
                lane = index.lane if type(index) is At else None if self.lanes_of(row, index) == 1 else lane
            if reference in scope.held:
                return self.in_lane(scope.held[reference], lane)
            if reference in scope.moved:
                reference = scope.moved[reference]
            elif row == "k":
                return "n", (key, index)
            elif row == "tick":
                return "k", index
            elif row == "c":
                return "c", self.plan.table_places[index].start
            elif row != "w":
                return self.in_lane((row, int(index) if type(index) is At else index), lane)
            else:
                alias = self.aliased(reference)
                if alias is None:
                    return self.in_lane(self.node_value(self.plan.outputs[index], scope), lane)
                reference = alias

    def node_value(self, node: Node, scope: ProgramScope) -> Value:
        if node in scope.made:
            return "r", scope.made[node]
        if self.level[node] == FIXED:
            return "q", (node.instance, self.tape_node(node))
        return "v", node

    def place(self, value: Value) -> Place:
        """The place of a value in memory; what has no place yet gets the next one."""
        row, index = value
        if row == "at":
            own, lane = index
            place = self.place(own)
            return Place(place.row, place.index[lane]) if isinstance(place.index, range) else place
        if row == "copy":
            if not self.is_hot:
                return self.place(index)
            lanes = self.lanes_of(*index)
            if index[0] == "p":
                return Place("q", self.q.place(index, lanes))
            return Place("v", self.v.place(Reference(*index), lanes))
        if isinstance(index, int):
            if row == "x":
                lanes = self.lanes_of(row, index)
                return Place(row, range(self.x_at[index], self.x_at[index] + lanes) if lanes > 1 else self.x_at[index])
            return Place(row, self.all_places(row, index) if row in _OF_BLOCKS else index)
        if row == "q":
            lanes = self.lanes_of("p", index[1]) if index[0] == "p" else self.copies_of(index[0])
            return Place("q", self.q.place(index, lanes))
        if row == "v":
            lanes = self.lanes_of(*index) if isinstance(index, Reference) else self.copies_of(index.instance)
            return Place("v", self.v.place(index, lanes))
        key, number = index
        if key not in self.n:
            self.n[key] = len(self.n)
            self.numbers.append(float(number))
        return Place("n", self.n[key])

    # --- functions of types ---------------------------------------------------------------------------------------

    def tape_number(self, tape: Tape) -> int:
        return self.tape_numbers.setdefault(id(tape), len(self.tape_numbers))

    def function(self, tape: Tape, nodes: tuple[int, ...], fixed: int | None, what: str) -> Function:
        """The function of a type that computes nodes. fixed: the arguments that are fixed, as a bit set; None: what
        depends on these alone is computed with the rest."""
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
            is_fixed = fixed is not None and node.op != "constant" and reads[n] & ~fixed == 0
            if node.op == "argument" or is_fixed:
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
                shape = tape.shape_of(argument.name)
                assert shape is not None
                tables[n] = math.prod(shape)
                names[n] = f"c{n}"
            else:
                names[n] = f"a{n}" if argument is not None else f"q{n}"
        name = f"f{len(self.functions)}"
        computed = needed_from(tape, nodes, names)
        self.printed_as[name] = tape, nodes, names, tables, what
        self.texts.append(function_text(name, *self.printed_as[name]))
        arguments = tuple(int(tape.nodes[n].value) if tape.nodes[n].op == "argument" else -1 for n in names)
        function = Function(name, tuple(names), arguments, len(nodes), 1 + len(computed), is_costly(tape, computed))
        self.functions[key] = function
        return function

    def call(self, instance: int, nodes: Sequence[Node], scope: ProgramScope) -> Call:
        """A call that computes nodes of one instance."""
        block = self.plan.instances[instance]
        tape = block.tape
        if isinstance(tape, FmuTape):
            return self.foreign_call(instance, nodes, scope)
        gathered = self.gathered(instance)
        if gathered is not None:
            scope.made[nodes[0]] = self.new_value()
            taken = [self.value(reference, scope, (instance, k)) for k, reference in enumerate(gathered)]
            label, made = block.path, [scope.made[nodes[0]]]
            return Call(_GATHER, label, instance, taken, made, [[]], lanes=len(gathered), gathers=True)
        fixed = self.fixed_of(instance) if scope.is_quick else None
        form = (id(tape), scope.is_hot, fixed, *(node.result for node in nodes))
        if form not in self.forms:
            asked = tuple(self.tape_node(node) for node in nodes)
            if scope.is_hot:
                asked = tuple(tape.quick.get(n, n) for n in asked)
            what = f"{tape.name} {' '.join(dict.fromkeys(key for _, key, _ in nodes))}"
            self.forms[form] = self.function(tape, asked, fixed, what)
        function = self.forms[form]
        arguments: list[Value] = []
        is_plain = not (scope.held or scope.moved or self.folded is not None)
        for n, k in zip(function.inputs, function.arguments, strict=True):
            if k < 0:
                arguments.append(("q", (instance, n)))
                continue
            reference = block.arguments[k]
            if is_plain and reference.row in _PLAIN:
                arguments.append(reference)
            else:
                arguments.append(self.value(self.ticked(reference, nodes[0]), scope, (instance, k)))
        values = list(range(self.values + 1, self.values + 1 + len(nodes)))
        self.values += len(nodes)
        scope.made.update(zip(nodes, values, strict=True))
        lanes = self.copies_of(instance)
        return Call(function, block.path, instance, arguments, values, [[] for _ in nodes], lanes=lanes)

    def foreign_call(self, instance: int, nodes: Sequence[Node], scope: ProgramScope) -> Call:
        """A call that asks an FMU for nodes: it takes the number of the FMU, time, and the values that they need."""
        block = self.plan.instances[instance]
        function, taken = self.requested(block.tape, [node.result for node in nodes])
        arguments: list[Value] = [("offset", self.plan.foreign_of[instance])]
        arguments += [self.value(block.arguments[k], scope, (instance, k)) for k in taken]
        values = [self.new_value() for _ in nodes]
        scope.made.update(zip(nodes, values, strict=True))
        return Call(function, block.path, instance, arguments, values, [[] for _ in nodes])

    def requested(self, tape: Tape, results: Sequence[tuple[str, int]]) -> tuple[Function, tuple[int, ...]]:
        """The function that asks an FMU for results, and the arguments that it takes after the number of the FMU."""
        form = (id(tape), "foreign", *results)
        if form not in self.forms:
            name = f"f{len(self.functions)}"
            assert isinstance(tape, FmuTape)
            request = Request.of(tape, results)
            self.texts.append(request_text(name, tape, request))
            function = Function(name, (), request.arguments, len(results), 40 * len(results), True, True)
            self.functions[form] = self.forms[form] = function
            self.kept_tapes.append(tape)  # its id is a key
        return self.forms[form], self.forms[form].arguments

    def fixed_of(self, instance: int) -> int:
        """The arguments of an instance that are fixed, as a bit set."""
        if instance not in self.fixed_arguments:
            bits, bit = 0, 1
            for reference in self.plan.instances[instance].arguments:
                row = reference.row
                if row == "p" or row == "k" or row == "c" or (row == "w" and self.level_of(reference) == FIXED):
                    bits |= bit
                bit <<= 1
            self.fixed_arguments[instance] = bits
        return self.fixed_arguments[instance]

    # --- algebraic loops ------------------------------------------------------------------------------------------

    def solved(self, loop: AlgebraicLoop, scope: ProgramScope) -> Call:
        """A call that solves an algebraic loop: it takes what the loop needs from outside, and the guesses."""
        plan = self.plan
        number_of = {reference: k for k, reference in enumerate(loop.unknowns)}
        known: dict[tuple[int, int], tuple[Value, str]] = {}
        n, solved = len(loop.torn), loop.solved
        place = {row: k for k, row in enumerate(solved)}
        texts = {row: f"unknowns[{place[row]}]" if place[row] < n else f"x{row}" for row in solved}
        chained = slopes(plan, loop)

        def evaluated(number: int, part: LoopPart, tape: Tape) -> tuple[list[str], dict[int, str], int]:
            """The lines that compute values and partials of a part, the texts of its arguments, and their weight."""
            block, first = plan.instances[part.instance], Node(part.instance, *part.results[0])
            asked = (*tape.results["value"].nodes, *tape.results["partial"].nodes)
            given: list[str] = []
            if not isinstance(tape, FmuTape):
                function = self.function(tape, asked, None, f"{block.tape.name} value partial")
                inputs = [int(tape.nodes[node].value) for node in function.inputs]
            else:
                results = [(key, e) for key in ("value", "partial") for e in range(len(tape.results[key].nodes))]
                function, read = self.requested(tape, results)
                inputs = list(read)
                given += ["m", str(plan.foreign_of[part.instance])]
            taken: dict[int, str] = {}
            for k in inputs:
                reference = self.ticked(block.arguments[k], first)
                if reference in number_of:
                    taken[k] = texts[number_of[reference]]
                    continue
                if (part.instance, k) not in known:
                    value, text = self.value(reference, scope, (part.instance, k)), f"known[{len(known)}]"
                    if value[0] == "c":
                        value, text = ("offset", value[1]), f"m->c + (int){text}"
                    known[part.instance, k] = value, text
                taken[k] = known[part.instance, k][1]
            given += taken.values()
            names = [f"a{number}_{k}" for k in range(len(asked))]
            lines = [
                f"double {', '.join(names)};",
                f"{function.name}({', '.join((*given, *(f'&{a}' for a in names)))});",
            ]
            if len(asked) == 1 and not isinstance(tape, FmuTape):
                lines = [f"const double {names[0]} = {function.name}({', '.join(given)});"]
            made = ((row, name) for row, name in zip(part.rows, names, strict=False) if place[row] >= n)
            lines += [f"const double {texts[row]} = {name};" for row, name in made]
            return lines, taken, function.weight

        lines, rounding, weight, all_given = list[str](), list[str](), 0, []
        residuals, nodes_of = [""] * len(solved), dict[int, Node]()
        for number, part in enumerate(loop.parts):
            printed, _, its = evaluated(number, part, part.tape)
            weight += its
            lines += [*printed, *(f"const double {name} = {text};" for name, text in chained.made[number])]
            for k, (row, result) in enumerate(zip(part.rows, part.results, strict=True)):
                nodes_of[row] = Node(part.instance, *result)
                is_value = place[row] < n and not loop.is_residual(plan, number, k)
                residuals[place[row]] = f"a{number}_{k} - {texts[row]}" if is_value else f"a{number}_{k}"
            whole = sensitivities(plan, loop, part)
            printed, taken, _ = evaluated(number, part, whole.tape)
            rounding.append("\n    ".join(printed))
            all_given.append((whole.arguments, taken))
        lines += [f"residuals[{k}] = {text};" for k, text in enumerate(residuals)]
        lines += [
            f"matrix[{i * n + k}] = {text};" for i, row in enumerate(chained.matrix) for k, text in enumerate(row)
        ]
        bounded = bounds(plan, loop, all_given, "fabs")
        rounding = [
            "\n    ".join([printed, *(f"const double {name} = {text};" for name, text in bounded.made[number])])
            for number, printed in enumerate(rounding)
        ]
        rounding += [f"bounds[{k}] = {text};" for k, text in enumerate(bounded.matrix[0])]
        guesses: list[Value] = []
        for reference in (loop.unknowns[row] for row in loop.torn):
            if reference in plan.unknowns_at:
                guesses.append(("z", plan.unknowns_at[reference]))
            elif reference.row == "d" and not scope.is_start:
                guesses.append(reference)
            else:
                guesses.append(("n", (("guess", reference), plan.guesses.get(reference, 0.0))))
        if scope.is_rounding:
            rounding += [f"bounds[{n + k}] = g{row};" for k, row in enumerate(solved[n:])]
        solver = self.solver(len(known), n, len(solved) - n, lines, rounding, weight, finds=not scope.is_rounding)
        values = [self.new_value() for _ in solved]
        scope.made.update((nodes_of[row], value) for row, value in zip(solved, values, strict=True))
        path = plan.instances[loop.parts[0].instance].path
        return Call(
            solver,
            path,
            loop.parts[0].instance,
            [*(value for value, _ in known.values()), *guesses],
            values,
            [[] for _ in solved],
        )

    def solver(
        self, known: int, n: int, others: int, lines: list[str], rounding: list[str], weight: int, *, finds: bool
    ) -> Function:
        """The function that solves loops of one form, for n torn unknowns and the others, or gives their rounding."""
        key = ("loop", n, others, *lines, *rounding, known, finds)
        if key in self.functions:
            return self.functions[key]
        name = f"f{len(self.functions)}"
        system = ""
        for what, printed, out in (
            ("system", lines, "double *residuals, double *matrix"), ("rounding", rounding, "double *bounds")
        ):  # fmt: skip
            head = (
                f"static void {name}_{what}(const BlocksMemory *m, const double *known, const double *unknowns, {out})"
            )
            body = "\n".join(f"    {line}" for line in printed)
            system += f"{head}\n{{\n    (void)m, (void)known, (void)unknowns;\n{body}\n}}\n"
        taken = [*(f"double a{k}" for k in range(known)), *(f"double z{k}" for k in range(n))]
        taken += [f"double *r{k}" for k in range(n + others)]
        inside = ", ".join(f"a{k}" for k in range(known)) or "0.0"
        text = (
            f"{system}\nstatic void {name}(const BlocksMemory *m, {', '.join(taken)})\n{{\n"
            f"    const double known[] = {{{inside}}};\n"
            f"    double unknowns[{n + others}] = {{{', '.join(f'z{k}' for k in range(n))}}};\n"
            f"    blocks_{'newton' if finds else 'spread'}"
            f"({name}_system, {name}_rounding, m, known, {n}, {others}, unknowns);\n"
            + "".join(f"    *r{k} = unknowns[{k}];\n" for k in range(n + others))
            + "}\n"
        )
        self.texts.append(text)
        function = Function(name, (), (), n + others, 4 * weight, True, True)
        self.functions[key] = function
        return function

    # --- programs -------------------------------------------------------------------------------------------------

    def sliced(
        self, asked: Iterable[Node | Reference], scope: ProgramScope, *, held: Callable[[Node], bool]
    ) -> list[Call]:
        """The calls of the continuous part that nodes and references need. held: whether a held node is read from v."""
        wanted: dict[Node, None] = {}
        stack: list[Node] = []

        def ask(reference: Reference) -> None:
            lane = -1
            while reference.row == "w":
                lane = getattr(reference.index, "lane", lane)
                alias = self.aliased(reference)
                if alias is None:
                    node = self.plan.outputs[reference.index]
                    if not self.is_known(node, held):
                        stack.append(node)
                    return
                reference = alias
            lane = getattr(reference.index, "lane", lane)
            if reference.row == "x":
                self.seen_states[int(reference.index), lane] = None

        for item in asked:
            if isinstance(item, Node):
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
            if isinstance(step, AlgebraicLoop) and number not in done_loops:
                done_loops[number] = None
                stack += step.nodes
            own = self.before[node] if node in self.before else self.bound(node)
            gathered = self.gathered(node.instance)
            for reference in own if gathered is None else gathered:
                if not (isinstance(step, AlgebraicLoop) and reference in step.unknowns):
                    ask(reference)
        by_step: dict[int, list[Node]] = {}
        for node in wanted:
            by_step.setdefault(self.step_of[node], []).append(node)
        calls = []
        for number in sorted(by_step):
            step = self.steps[number]
            if isinstance(step, AlgebraicLoop):
                calls.append(self.solved(step, scope))
                continue
            nodes = by_step[number]
            if len(nodes) > 1:
                nodes = [node for node in step.nodes if node in wanted]
            calls.append(self.call(step.instance, nodes, scope))
        return calls

    def is_known(self, node: Node, held: Callable[[Node], bool]) -> bool:
        level = self.level[node]
        return level == FIXED or (level == HELD and held(node))

    def calls_of(self, program: Program, scope: ProgramScope) -> list[Call]:
        calls = []
        for step in program.steps:
            if isinstance(step, AlgebraicLoop):
                calls.append(self.solved(step, scope))
            else:
                calls.append(self.call(step.instance, step.nodes, scope))
            for node in step.nodes:
                reference = program.made.get(node)
                if reference is not None and scope.is_rounding and reference in self.plan.unknowns_at:
                    scope.held[reference] = ("z", self.plan.unknowns_at[reference])
                elif reference is not None:
                    scope.held[reference] = ("ge" if reference.row == "s" else "r", scope.made[node])
        return calls
