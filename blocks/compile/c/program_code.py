"""Programs as C: calls of functions of types, in straight lines or in loops over equal instances.

A loop has a constant count; its lane i reads and writes rows of memory at base + stride i, or by a table of indices
where the wiring is not regular. Values that pass between the units of a program (loops, and straight pieces short
enough for gcc) are in a scratch row w.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from ..folding import At
from .function_code import ONE, Numbers, comment
from .loops import LEAST, Call, CallOrder, CallSequence, Copy, EqualCalls, Place, Sink, Value, at_of, is_affine

MOST_RUNS = 8  # runs of equal programs in sequence; for more, a table is shorter
MOST_ON_STACK = 8192  # doubles of scratch
SAME = "@"  # in a text: the lane, or 0 where all lanes read the same number
_ROWS = ("x", "d", "s", "p", "u", "h", "z", "k", "q", "v", "n", "c")


class Tables:
    """Tables of indices, each printed once."""

    def __init__(self) -> None:
        self.names: dict[tuple[int, ...], str] = {}

    def name(self, values: tuple[int, ...]) -> str:
        return self.names.setdefault(values, f"T{len(self.names)}")

    @property
    def text(self) -> str:
        texts = []
        for values, name in self.names.items():
            rows = [", ".join(map(str, values[k : k + 20])) for k in range(0, len(values), 20)]
            texts.append(f"static const int {name}[] = {{\n    " + ",\n    ".join(rows) + "};\n")
        return "".join(texts)


@dataclass(slots=True)
class Printed:
    """A program as text: functions of its units, and the body that calls them; the scratch it needs."""

    functions: str
    body: str
    scratch: int
    same: tuple[tuple[str, int, int], ...] = ()  # pieces of memory (row, first, count) that SAME stands for


def print_program(
    name: str,
    calls: Sequence[Call],
    copies: Sequence[Copy],
    place: Callable[[Value], Place],
    tables: Tables,
    *,
    loops: bool = True,
    is_aliased: bool = False,
    is_hot: bool = False,
    numbers: Numbers = ONE,
) -> Printed:
    """A program. `place` gives the place of a value, and lays out what is first read now.

    is_aliased: whether it writes a row that it also reads.
    """
    return _Program(name, calls, copies, place, tables, is_aliased, is_hot, numbers).printed(loops)


def print_selected(
    name: str,
    programs: Sequence[tuple[Sequence[Call], Sequence[Copy]]],
    place: Callable[[Value], Place],
    tables: Tables,
    numbers: Sequence[Sequence[int]],
) -> Printed:
    """Programs of one kind, one of which is chosen by the argument `which`: those of equal form are one function of
    their lane i. Their copies have no conditions. numbers: of each program those that choose it, one for each lane."""
    forms: dict[object, list[int]] = {}
    for k, (calls, copies) in enumerate(programs):
        if calls or copies:
            # A lane has one value of each call: a program that reads all copies of a block is a function of its own.
            is_lane = len(numbers[k]) == 1 and all(call.lanes == 1 and not call.gathers for call in calls)
            forms.setdefault(_form(calls, copies) if is_lane else k, []).append(k)
    functions = []
    size = sum(map(len, numbers))
    form_of, lane_of = [-1] * size, [0] * size
    for number, members in enumerate(forms.values()):
        function = f"{name}_{number}"
        for lane, which in enumerate(which for k in members for which in numbers[k]):
            form_of[which], lane_of[which] = number, lane
        if len(numbers[members[0]]) > 1:
            text, more = _one_of(function, *programs[members[0]], place, tables, len(numbers[members[0]]))
            functions += more
        elif len(members) == 1:
            calls, copies = programs[members[0]]
            printed = print_program(function, calls, copies, place, tables, loops=False)
            functions.append(printed.functions)
            text = f"    (void)m, (void)t, (void)x, (void)i, (void)out;\n{printed.body}"
        else:
            text = _lanes_of(function, [programs[k] for k in members], place, tables)
        signature = "const BlocksMemory *m, double t, const double *x, int i, double *out"
        functions.append(f"static void {function}({signature})\n{{\n{text}\n}}\n")
    if not forms:
        return Printed("", "    (void)which;", 0)
    return Printed("\n".join(functions), "\n".join(_choice_of(name, form_of, lane_of, tables)), 0)


def _lanes_of(
    function: str,
    programs: Sequence[tuple[Sequence[Call], Sequence[Copy]]],
    place: Callable[[Value], Place],
    tables: Tables,
) -> str:
    """Return the text of one function for programs of equal form, which are its lanes."""
    program = _Program(function, [call for calls, _ in programs for call in calls], (), place, tables, False)
    groups = [EqualCalls(list(calls)) for calls in zip(*(calls for calls, _ in programs), strict=True)]
    program.assign(groups)
    unit = CallSequence(groups, True)
    hoisted, body, _ = program.lanes(unit, [copies for _, copies in programs])
    lines = ["    (void)m, (void)t, (void)x, (void)i, (void)out;", *program.rows(unit), *hoisted]
    return "\n".join([*lines, *(f"    {line}" for line in body)])


def _choice_of(name: str, form_of: Sequence[int], lane_of: Sequence[int], tables: Tables) -> list[str]:
    """Return the lines that call the function of `which`: by its number if few runs of numbers share a function, else
    by a table. form_of, lane_of: by number the function, -1 if there is none, and its lane."""
    runs: list[tuple[int, int, int]] = []  # the first of a run, its form, its lane
    for k, (form, lane) in enumerate(zip(form_of, lane_of, strict=True)):
        if not runs or runs[-1][1] != form or (form >= 0 and runs[-1][2] + k - runs[-1][0] != lane):
            runs.append((k, form, lane))
    lines = ["    (void)m, (void)t, (void)x, (void)which, (void)out;"]
    if len(runs) <= MOST_RUNS:
        ends = [*(first for first, _, _ in runs[1:]), len(form_of)]
        for (first, form, lane), end in zip(runs, ends, strict=True):
            if form >= 0:
                at = "which" + (f" + {lane - first}" if lane > first else f" - {first - lane}" if first > lane else "")
                lines.append(f"    if (which >= {first} && which < {end}) {name}_{form}(m, t, x, {at}, out);")
        return lines
    form_text, lane_text = (f"{tables.name(tuple(values))}[which]" for values in (form_of, lane_of))
    cases = [f"    case {k}: {name}_{k}(m, t, x, lane, out); break;" for k in range(max(form_of) + 1)]
    lines += [f"    const int lane = {lane_text};", f"    switch ({form_text}) {{", *cases, "    default: break;"]
    return [*lines, "    }"]


def _one_of(
    function: str, calls: Sequence[Call], copies: Sequence[Copy], place: Callable[[Value], Place], tables: Tables,
    lanes: int,
) -> tuple[str, list[str]]:  # fmt: skip
    """The body of a program of copies that gives the values of lane i, and functions that it needs."""
    unused = "    (void)m, (void)t, (void)x, (void)i, (void)out;"
    if all(call.lanes == lanes and not call.gathers for call in calls):
        program = _Program(function, calls, (), place, tables, False)
        groups = [EqualCalls([call]) for call in calls]
        program.assign(groups)
        unit = CallSequence(groups, True)
        hoisted, body, _ = program.lanes(unit, [copies])
        return "\n".join([unused, *program.rows(unit), *hoisted, *(f"    {line}" for line in body)]), []
    # It needs values of other copies: all are computed, and one of each is taken.
    count = 0
    for call in calls:
        call.sinks = [[Sink(_wide(sink, lanes)) for sink in sinks] for sinks in call.sinks]
        count += sum(len(sinks) for sinks in call.sinks)
    copies = [Copy(copy.value, Sink(_wide(copy.sink, lanes))) for copy in copies]
    count += len(copies)
    printed = print_program(f"{function}_all", calls, copies, place, tables)
    head = "const BlocksMemory *m, double t, const double *x, double *out"
    whole = f"static void {function}_all({head})\n{{\n    (void)m, (void)t, (void)x, (void)out;\n{printed.body}\n}}\n"
    lines = [f"    double all[{count * lanes}];", f"    {function}_all(m, t, x, all);"]
    lines.append(f"    for (int k = 0; k < {count}; k++) out[k] = all[{lanes} * k + i];")
    return "\n".join([unused, *lines]), [printed.functions, whole]


def _wide(sink: Sink, lanes: int) -> range:
    return range(at_of(sink) * lanes, (at_of(sink) + 1) * lanes)


def _form(calls: Sequence[Call], copies: Sequence[Copy]) -> object:
    """What must be equal in two programs that are one function of lanes."""
    place = {value: (n, k) for n, call in enumerate(calls) for k, value in enumerate(call.values)}

    def of(value: Value) -> object:
        return (value[0], place[value[1]]) if value[0] in ("r", "ge") else value[0]

    call_forms = [
        (call.function.name, *map(of, call.arguments), tuple(tuple(s.index for s in sinks) for sinks in call.sinks))
        for call in calls
    ]
    return tuple(call_forms), tuple((of(copy.value), copy.sink.index) for copy in copies)


class _Program(CallOrder):
    """One program that is printed."""

    def __init__(
        self,
        name: str,
        calls: Sequence[Call],
        copies: Sequence[Copy],
        place: Callable[[Value], Place],
        tables: Tables,
        is_aliased: bool,
        is_hot: bool = False,
        numbers: Numbers = ONE,
    ) -> None:
        super().__init__(calls)
        self.numbers = numbers
        self.same: dict[tuple[str, int, int], None] | None = {} if is_hot else None
        self.name, self.copies, self.tables = name, copies, tables
        self.place_of, self.is_aliased = place, is_aliased
        self.w_at: dict[int, int] = {}
        self.scratch = 0

    # --- where values are -----------------------------------------------------------------------------------------

    def lay_out(self, units: list[CallSequence]) -> None:
        """Places in w for values between units or between lanes; those of lanes are side by side."""
        unit_of = {group: k for k, unit in enumerate(units) for group in unit.groups}
        wanted: dict[tuple[EqualCalls, int], None] = {}

        def maker(value: Value) -> EqualCalls | None:
            return self.group_of[self.made[value[1]][0]][0] if value[0] in ("r", "ge") else None

        def shared(value: Value, reader: int | None, lane: int, *, is_mixed: bool = False) -> None:
            if value[0] not in ("r", "ge"):
                return
            call, k = self.made[value[1]]
            group, its = self.group_of[call]
            is_near = unit_of[group] == reader and (its == lane or not group.is_loop) and not is_mixed
            if not is_near or call.gathers or type(value[1]) is At:
                wanted[group, k] = None

        for number, unit in enumerate(units):
            for group in unit.groups:
                for values in zip(*(call.arguments for call in group.calls), strict=True):
                    # Lanes that read several groups find their values in w alone.
                    is_mixed = len({maker(value) for value in values}) > 1
                    for lane, value in enumerate(values):
                        shared(value, number, lane, is_mixed=is_mixed)
        alone = len(units) == 1 and not units[0].is_loop
        for copy in self.copies:
            shared(copy.value, 0 if alone else None, 0)
        for group, k in wanted:
            for call in group.calls:
                self.w_at[call.values[k]] = self.scratch
                self.scratch += call.lanes

    # --- printing -------------------------------------------------------------------------------------------------

    def printed(self, loops: bool) -> Printed:
        units = self.units(loops)
        self.lay_out(units)
        alone = len(units) == 1 and not units[0].is_loop
        copies = self.copies if alone else ()
        texts = [self.loop(unit) if unit.is_loop else self.straight(unit, copies) for unit in units]
        if self.copies and not alone:
            last = CallSequence([], False)
            texts.append(self.copied(self.copies, last))
            units.append(last)
        if alone:
            return Printed("", "\n".join([*self.rows(units[0]), *texts[0]]), 0)
        functions, body = [], []
        for k, (unit, lines) in enumerate(zip(units, texts, strict=True)):
            used, real = [row for row in _ROWS if row in unit.rows], self.numbers.real
            how = "" if self.is_aliased else "restrict "
            taken = [*([f"const {self.numbers.memory} *m"] if unit.reads_memory else []), f"{real} t"]
            taken += [f"const {self.type_of(row)} *{how}{row}" for row in used]
            taken += ["const uint8_t *due"] if unit.due else []
            taken += [f"{real} *{how}out"]
            given = [*(["m"] if unit.reads_memory else []), "t"]
            given += [row if row == "x" else f"m->{row}" for row in used]
            given += [*(["due"] if unit.due else []), "out"]
            if self.scratch:
                taken.append(f"{real} *restrict w")
                given.append("w")
            head = "static void" if unit.is_loop else "static __attribute__((noinline)) void"
            unused = "    (void)t, (void)out" + (", (void)w;" if self.scratch else ";")
            text = "\n".join([unused, *lines])
            functions.append(f"{head} {self.name}_{k}({', '.join(taken)})\n{{\n{text}\n}}\n")
            body.append(f"    {self.name}_{k}({', '.join(given)});")
        if self.scratch:
            on_stack = self.scratch <= MOST_ON_STACK
            real = self.numbers.real
            body.insert(0, f"    {real} w[{self.scratch}];" if on_stack else f"    {real} *w = m->w;")
        scratch = 0 if self.scratch <= MOST_ON_STACK else self.scratch
        return Printed("\n".join(functions), "\n".join(body), scratch, tuple(self.same or ()))

    def type_of(self, row: str) -> str:
        """That of an element: tables are the same in all lanes."""
        return "double" if row == "c" else self.numbers.real

    def rows(self, unit: CallSequence) -> list[str]:
        """The rows that a unit reads, as names."""
        used = [row for row in _ROWS if row in unit.rows and row != "x"]
        return [f"    const {self.type_of(row)} *const {row} = m->{row};" for row in used]

    def store(self, at: str, value: str, off: str, side: str, own: str) -> str:
        if not side:
            return f"out[{at}] = {value};"
        if off == "keep":
            return f"if ({side} != 0.0) out[{at}] = {value};"
        if off == "side":
            return f"out[{at}] = {side} != 0.0 ? {value} : ({own} != 0.0 ? 1.0 : -1.0);"
        other = self.numbers.constant(math.inf if off == "inf" else 0.0)
        return f"out[{at}] = {self.numbers.chosen(f'{side} != 0.0', value, other)};"

    def row(self, value: Value, unit: CallSequence) -> Place:
        """Find a value in memory: one place."""
        row, index = value
        if row in ("r", "ge"):
            first = self.w_at[index]
            return Place("w", first + index.lane if type(index) is At else first)
        place = self.place_of(value)
        if place.row != "t":
            unit.rows[place.row] = None
        return Place(place.row, place.index[0]) if isinstance(place.index, range) else place

    def of_lanes(self, value: Value, unit: CallSequence) -> Place:
        """Find a value in memory for the lanes of a call of copies: a range of indices, or the one of all."""
        row, index = value
        if row in ("r", "ge"):
            first, lanes = self.w_at[index], self.made[index][0].lanes
            if type(index) is At:
                return Place("w", first + index.lane)
            return Place("w", range(first, first + lanes) if lanes > 1 else first)
        place = self.place_of(value)
        if place.row in ("p", "d", "s") and isinstance(place.index, range) and not is_affine(place.index, 1):
            place = self.place_of(("copy", value))  # side by side
        if place.row != "t":
            unit.rows[place.row] = None
        return place

    def read(self, value: Value, unit: CallSequence, local: dict[int, str]) -> str:
        kind, number = value
        if kind in ("r", "ge") and number in local:
            text = local[number]
        else:
            place = self.row(value, unit)
            text = _text(place.row, str(place.index))
        return self.numbers.as_real(f"{text} >= 0.0") if kind == "ge" else text

    def straight(self, unit: CallSequence, copies: Sequence[Copy]) -> list[str]:
        lines: list[str] = []
        local: dict[int, str] = {}
        calls = [group.calls[0] for group in unit.groups]
        read = (value for call in calls for value in (*call.arguments, *(call.fallback or ())))
        reads = Counter(value[1] for value in (*read, *(copy.value for copy in copies)) if value[0] in ("r", "ge"))
        number = 0
        while number < len(calls):
            chain = self.chain(calls[number:], reads, unit)
            number += len(chain)
            lines += self._called(chain, unit, local)
        lines = [f"    {line}" for line in lines]
        return lines + self.copied(copies, unit, local)

    def _called(self, chain: Sequence[Call], unit: CallSequence, local: dict[int, str]) -> list[str]:
        """Return the lines of a call, or of a chain of them. local: the variables so far; it gets those of the call."""
        call = chain[-1]
        given = [self.read(value, unit, local) for value in call.arguments] if len(chain) == 1 else []
        names = [f"r{len(local) + k}" for k in range(len(call.values))]
        keeps = [f"w[{self.w_at[v]}] = {r};" for v, r in zip(call.values, names, strict=True) if v in self.w_at]
        other = [
            f"{r} = {self.read(value, unit, local)};"
            for r, value in zip(names, call.fallback or (), strict=bool(call.fallback))
        ]
        stores = []
        for r, sinks in zip(names, call.sinks, strict=True):
            for sink in sinks:
                side = "" if sink.condition is None else self.read(("s", sink.condition), unit, {})
                own = self.read(("s", sink.index), unit, {}) if sink.off == "side" else ""
                stores.append(self.store(str(sink.index), r, sink.off, side, own))
        chained = self.chained(chain, names[0], unit, local) if len(chain) > 1 else []
        local.update(zip(call.values, names, strict=True))
        if chained:
            return [*chained, *stores, *keeps]
        code = self.call_text(call, given, names, unit)
        by_value = len(names) == 1 and not call.function.takes_memory
        label = f"  /* {comment(call.label)} */"
        if not call.guard and by_value:
            return [f"const {self.numbers.real} {names[0]} = {code};{label}", *stores, *keeps]
        if not call.guard:
            return [f"{self.numbers.real} {', '.join(names)};", f"{code};{label}", *stores, *keeps]
        unit.due = True
        lines = [f"double {', '.join(f'{r} = 0.0' for r in names)};", f"if ({_due(call.guard)}) {{{label}"]
        lines += [f"    {line}" for line in (f"{names[0]} = {code};" if by_value else f"{code};", *stores)]
        lines += ["} else {", *(f"    {line}" for line in other)] if other else []
        return [*lines, "}", *keeps]

    def chain(self, calls: Sequence[Call], reads: Mapping[int, int], unit: CallSequence) -> list[Call]:
        """The first of some calls, with those behind it that make a loop with it: each is of the value of the one
        before, which nothing else reads, and of memory at equal distances. reads: how often values are read."""
        made = [calls[0]]
        for call in calls[1:]:
            last = made[-1]
            is_link = _is_plain(last) and _is_plain(call) and call.function is last.function
            if not is_link or last.sinks[0] or last.values[0] in self.w_at or reads[last.values[0]] > 1:
                break
            if call.arguments[0] != ("r", last.values[0]):
                break
            made.append(call)
        while len(made) >= LEAST:
            if all(self.is_even(values, unit) for values in _besides(made)):
                return made
            made = made[: len(made) // 2]
        return made[:1]

    def is_even(self, values: Sequence[Value], unit: CallSequence) -> bool:
        """Whether values are in memory at equal distances."""
        if any(kind in ("ge", "t") or (kind == "r" and index not in self.w_at) for kind, index in values):
            return False
        places = [self.row(value, unit) for value in values]
        rows = {place.row for place in places}
        return len(rows) == 1 and rows <= {"w", *_ROWS[:-1]} and is_affine([place.index for place in places])

    def chained(self, calls: Sequence[Call], name: str, unit: CallSequence, local: dict[int, str]) -> list[str]:
        """A loop over calls, each of the value of the one before."""
        columns = [[self.row(value, unit) for value in values] for values in _besides(calls)]
        given = [_text(column[0].row, self.index([place.index for place in column])) for column in columns]
        code = self.call_text(calls[0], [name, *given], [name], unit)
        begin, label = self.read(calls[0].arguments[0], unit, local), f"  /* {comment(calls[0].label)} */"
        loop = f"for (int i = 0; i < {len(calls)}; i++) {name} = {code};{label}"
        return [f"{self.numbers.real} {name} = {begin};", loop]

    def call_text(self, call: Call, given: list[str], names: list[str], unit: CallSequence) -> str:
        if call.function.takes_memory:
            unit.reads_memory = True
            given = ["m", *given]
        if len(names) > 1 or call.function.takes_memory:
            given = [*given, *(f"&{r}" for r in names)]
        return f"{call.function.name}({', '.join(given)})"

    def loop(self, unit: CallSequence) -> list[str]:
        """A loop over lanes. At -O2 gcc vectorises only loops of an even count, so an odd lane is separate."""
        if unit.groups[0].calls[0].gathers:
            return self.gathered(unit)
        count, guard = unit.groups[0].count, unit.groups[0].calls[0].guard
        hoisted, body, other = self.lanes(unit, [])
        costly = any(group.calls[0].function.costly for group in unit.groups)
        odd = count % 2 and not costly and count > 2

        def over(lines: list[str]) -> list[str]:
            inner = [f"        {line}" for line in lines]
            loop_lines = [f"    for (int i = 0; i < {count - 1 if odd else count}; i++) {{", *inner, "    }"]
            last = ["    {", f"        const int i = {count - 1};", "        (void)i;", *inner, "    }"]
            return [*loop_lines, *last] if odd else loop_lines

        if not guard:
            return [*hoisted, *over(body)]
        unit.due = True
        guarded = [*hoisted, f"    if ({_due(guard)}) {{", *over(body), "    }"]
        return [*guarded, "    else {", *over(other), "    }"] if other else guarded

    def gathered(self, unit: CallSequence) -> list[str]:
        """The arguments of a call, one for each lane, side by side in w."""
        (call,) = unit.groups[0].calls
        first = self.w_at[call.values[0]]
        copies = [Copy(value, Sink(first + lane)) for lane, value in enumerate(call.arguments)]
        lines = [line.replace("out[", "w[") for line in self.copied(copies, unit)]
        if not call.guard:
            return lines
        unit.due = True
        return [f"    if ({_due(call.guard)}) {{", *(f"    {line}" for line in lines), "    }"]

    def lanes(self, unit: CallSequence, copies: Sequence[Sequence[Copy]]) -> tuple[list[str], list[str], list[str]]:
        """What lane i of a unit does: what all lanes share, the calls, and what replaces their values where they are
        not made. copies: of each lane, in equal form."""
        hoisted: list[str] = []
        body: list[str] = []
        other: list[str] = []
        local: dict[int, str] = {}  # values of lane 0, for those of all lanes

        # Without calls: several programs of one form have copies each, one program of all lanes has them once.
        is_of_copies = unit.groups[0].calls[0].lanes > 1 if unit.groups else len(copies) == 1

        def of_copies(kind: str, number: object, test: str) -> str:
            """The text of what each lane of a call of copies reads in one place."""
            if kind in ("r", "ge") and type(number) is int and number in local:
                return f"(double)({local[number]}{test})" if test else local[number]
            place = self.of_lanes((kind, number), unit)
            row, index = place.row, place.index
            at = self.index(index) if isinstance(index, range) else str(index)
            if self.same is not None and row in ("q", "n") and isinstance(index, range) and index.step == 1:
                self.same[row, index[0], len(index)] = None
                at = at[:-1] + SAME
            text = _text(row, at)
            if not isinstance(index, range) and row not in ("t", "c", "offset"):
                hoisted.append(f"    const double h{len(hoisted)} = {text};")
                text = f"h{len(hoisted) - 1}"
            return f"(double)({text}{test})" if test else text

        def column(values: Sequence[Value]) -> str:
            """The text of what each lane reads in one place."""
            kind, number = values[0]
            test = " >= 0.0" if kind == "ge" else ""
            if is_of_copies:
                return of_copies(kind, number, test)
            if kind in ("r", "ge") and number in local:
                group, _ = self.group_of[self.made[number][0]]
                producers = [self.group_of[self.made[index][0]] for _, index in values]
                if all(g is group and lane == i for i, (g, lane) in enumerate(producers)):
                    return self.numbers.as_real(f"{local[number]}{test}") if test else local[number]
            if kind in ("p", "d", "s") and not is_affine([self.place_of(value).index for value in values], 1):
                values = [("copy", value) for value in values]  # side by side
            places = [self.row(value, unit) for value in values]
            at, row = self.index([place.index for place in places]), places[0].row
            if self.same is not None and row in ("q", "n") and (at == "i" or at.endswith("+ i")):
                # Parameters: loops read one for all lanes where they are equal.
                self.same[row, places[0].index, len(places)] = None
                at = at[:-1] + SAME
            text = _text(row, at)
            if all(place == places[0] for place in places) and row not in ("t", "c"):
                hoisted.append(f"    const {self.numbers.real} h{len(hoisted)} = {text};")
                text = f"h{len(hoisted) - 1}"
            return self.numbers.as_real(f"{text}{test}") if test else text

        for group in unit.groups:
            calls, count = group.calls, group.count
            first = calls[0]
            given = [column([call.arguments[k] for call in calls]) for k in range(len(first.arguments))]
            names = [f"r{len(local) + k}" for k in range(len(first.values))]
            local.update(zip(first.values, names, strict=True))
            code = self.call_text(first, given, names, unit)
            label = f"  /* {comment(first.label)} and {count - 1} more */"
            if len(names) == 1 and not first.function.takes_memory:
                body.append(f"const {self.numbers.real} {names[0]} = {code};{label}")
            else:
                body += [f"{self.numbers.real} {', '.join(names)};", f"{code};{label}"]
            for k, r in enumerate(names):
                if first.values[k] in self.w_at:
                    at = self.index(self.lane_places([self.w_at[call.values[k]] for call in calls], first))
                    body.append(f"w[{at}] = {r};")
                    if first.fallback is not None:
                        other.append(f"w[{at}] = {column([call.fallback[k] for call in calls if call.fallback])};")
                for j, sink in enumerate(first.sinks[k]):
                    at = self.index(_indices([call.sinks[k][j] for call in calls]))
                    conditions = [call.sinks[k][j].condition for call in calls]
                    side = "" if sink.condition is None else column([("s", c) for c in conditions if c is not None])
                    own = column([("s", call.sinks[k][j].index) for call in calls]) if sink.off == "side" else ""
                    body.append(self.store(at, r, sink.off, side, own))
        for column_ in zip(*copies, strict=True):
            text = column([copy.value for copy in column_])
            at = self.index(_indices([copy.sink for copy in column_]))
            body.append(f"out[{at}] = {text};")
        return hoisted, body, other

    @staticmethod
    def lane_places(firsts: list[int], call: Call) -> Sequence[int]:
        return range(firsts[0], firsts[0] + call.lanes) if call.lanes > 1 else firsts

    def index(self, indices: Sequence[int]) -> str:
        """An index as a function of the lane i."""
        if not is_affine(indices):
            return f"{self.tables.name(tuple(indices))}[i]"
        base, stride = indices[0], indices[1] - indices[0] if len(indices) > 1 else 0
        if stride == 0:
            return str(base)
        lane = "i" if stride == 1 else f"{stride} * i"
        return f"{base} + {lane}" if base else lane

    def copied(self, copies: Sequence[Copy], unit: CallSequence, local: dict[int, str] | None = None) -> list[str]:
        """Copies, those of equal form in loops."""
        lines: list[str] = []
        runs: dict[object, list[Copy]] = {}
        for copy in copies:
            if isinstance(copy.sink.index, range):  # of all lanes
                of_lanes = self.of_lanes(copy.value, unit)
                index = of_lanes.index
                text = _text(of_lanes.row, self.index(index) if isinstance(index, range) else str(index))
                text = f"(double)({text} >= 0.0)" if copy.value[0] == "ge" else text
                at = self.index(copy.sink.index)
                lines.append(f"    for (int i = 0; i < {len(copy.sink.index)}; i++) out[{at}] = {text};")
        copies = [copy for copy in copies if not isinstance(copy.sink.index, range)]
        for copy in sorted(copies, key=lambda copy: at_of(copy.sink)):
            kind = copy.value[0]
            kind = f"at {self.row(copy.value, unit).row}" if kind == "at" else kind
            key: object = (kind, copy.sink.condition is None, copy.sink.off)
            if local is not None and copy.value[0] in ("r", "ge") and copy.value[1] in local:
                key = copy
            runs.setdefault(key, []).append(copy)
        for run in runs.values():
            for piece in _pieces(run, lambda copy: (self.row(copy.value, unit).index, at_of(copy.sink))):
                if len(piece) < LEAST:
                    for copy in piece:
                        text = self.read(copy.value, unit, local or {})
                        side = "" if copy.sink.condition is None else self.read(("s", copy.sink.condition), unit, {})
                        own = self.read(("s", copy.sink.index), unit, {}) if copy.sink.off == "side" else ""
                        lines.append("    " + self.store(str(copy.sink.index), text, copy.sink.off, side, own))
                    continue
                places = [self.row(copy.value, unit) for copy in piece]
                text = _text(places[0].row, self.index([place.index for place in places]))
                text = self.numbers.as_real(f"{text} >= 0.0") if piece[0].value[0] == "ge" else text
                at = self.index([at_of(copy.sink) for copy in piece])
                conditions = [c.sink.condition for c in piece if c.sink.condition is not None]
                side = own = ""
                if conditions:
                    unit.rows["s"] = None
                    side = _text("s", self.index(conditions))
                    own = _text("s", at)
                store = self.store(at, text, piece[0].sink.off, side, own)
                lines.append(f"    for (int i = 0; i < {len(piece)}; i++) {store}")
        return lines


def _pieces(copies: list[Copy], where: Callable[[Copy], tuple[int, int]]) -> list[list[Copy]]:
    """Copies in runs of regular places, as few as possible."""
    if len(copies) < LEAST or copies[0].value[0] == "t":
        return [[copy] for copy in copies]
    places = [where(copy) for copy in copies]
    for period in range(1, min(32, len(copies) // LEAST) + 1):
        # Instances one after the other, each with `period` copies.
        if all(is_affine([place[k] for place in places[first::period]]) for first in range(period) for k in (0, 1)):
            return [copies[first::period] for first in range(period)]
    pieces: list[list[Copy]] = []
    last = step = (0, 0)
    for copy, place in zip(copies, places, strict=True):
        moved = (place[0] - last[0], place[1] - last[1])
        if pieces and (len(pieces[-1]) == 1 or moved == step):
            pieces[-1].append(copy)
        else:
            pieces.append([copy])
        last, step = place, moved
    return pieces if len(pieces) <= max(4, len(copies) // 16) else [copies]


def _indices(sinks: Sequence[Sink]) -> Sequence[int]:
    """The places of lanes: of calls one by one, or of one call of copies."""
    first = sinks[0].index
    return first if isinstance(first, range) else [at_of(sink) for sink in sinks]


def _besides(calls: Sequence[Call]) -> list[tuple[Value, ...]]:
    """What calls read in each place but the first."""
    return list(zip(*(call.arguments[1:] for call in calls), strict=True))


def _is_plain(call: Call) -> bool:
    """Whether a call is always made, of one value that it returns."""
    is_single = len(call.values) == 1 and call.lanes == 1 and not call.gathers
    return is_single and not call.guard and not call.function.takes_memory and bool(call.arguments)


def _text(row: str, index: str) -> str:
    match row:
        case "t":
            return "t"
        case "c":
            return f"c + {index}"
        case "offset":
            return index
    return f"{row}[{index}]"


def _due(guard: tuple[int, ...]) -> str:
    return " || ".join(f"due[{rate}]" for rate in guard)
