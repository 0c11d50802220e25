"""Programs as C: calls of functions of types, in straight lines or as loops over equal instances.

A program is a list of `Call`s, each after those that it needs, and of `Copy`s. Equal calls that do not need each other
become one loop with a constant count over rows in which lane i stands at base + stride i; loops of one count are one
where all that goes between them stays in its lane, so that it never leaves a register. What goes between the units of
a program (loops, and straight pieces short enough for gcc) stands in a scratch row w.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from .emit_types import Function, comment

__all__ = ["Call", "Copy", "Printed", "Sink", "Tables", "Value", "print_program"]

Value = tuple[str, Any]
"""A row of memory and an index in it (of q, n and v: or a name for what has no place yet); ("t", 0); ("r", number): what a call of this program gave; ("ge", number): 1 where
that is not negative, else 0. Of "c" the index is an offset."""

LEAST = 4  # so many equal calls make a loop where all of their wires are regular
LEAST_IRREGULAR = 16  # and so many where they are not: registers are faster than short tables
MOST_CALLS, MOST_WEIGHT = 64, 1500  # calls, and operations in them, of one straight piece: gcc takes more than its share
MOST_ON_STACK = 8192  # doubles of scratch
_ROWS = ("x", "d", "s", "p", "u", "h", "z", "k", "q", "v", "n", "c")


@dataclass(frozen=True, slots=True)
class Sink:
    """Where a value goes: a place in `out`. condition: the side without which it is what `off` says.

    off: "zero", "side" (1 or -1, as the side `index` is), "inf", or "keep": then nothing is written.
    """

    index: int
    condition: int | None = None
    off: str = ""


@dataclass(slots=True, eq=False)
class Call:
    """One call: what it takes, the numbers of the values that it gives, and where these go.

    guard: the rates of which one must be due; (): it is always made. fallback: what stands for its values otherwise.
    """

    function: Function
    label: str
    order: int  # the instance
    arguments: list[Value]
    values: list[int]
    sinks: list[list[Sink]]
    guard: tuple[int, ...] = ()
    fallback: list[Value] | None = None


@dataclass(frozen=True, slots=True)
class Copy:
    """A value that goes to a place as it is."""

    value: Value
    sink: Sink


class Tables:
    """Tables of indices, each printed once."""

    def __init__(self) -> None:
        self.names: dict[tuple[int, ...], str] = {}

    def name(self, values: tuple[int, ...]) -> str:
        return self.names.setdefault(values, f"T{len(self.names)}")

    @property
    def text(self) -> str:
        made = []
        for values, name in self.names.items():
            rows = [", ".join(map(str, values[k : k + 20])) for k in range(0, len(values), 20)]
            made.append(f"static const int {name}[] = {{\n    " + ",\n    ".join(rows) + "};\n")
        return "".join(made)


@dataclass(slots=True)
class Printed:
    """What a program is: functions of its units, and the body that calls them; how much scratch it needs."""

    functions: str
    body: str
    scratch: int


@dataclass(slots=True, eq=False)
class _Group:
    """Equal calls: lanes of a loop, or one."""

    calls: list[Call]
    cluster: int = -1

    @property
    def is_loop(self) -> bool:
        return len(self.calls) > 1


@dataclass(slots=True, eq=False)
class _Unit:
    """Groups that are printed together: one loop, or straight calls."""

    groups: list[_Group]
    is_loop: bool
    rows: dict[str, None] = field(default_factory=dict)
    reads_memory: bool = False  # whether a function in it takes all of the memory
    due: bool = False


def print_program(
    name: str,
    calls: Sequence[Call],
    copies: Sequence[Copy],
    place: Callable[[Value], Value],
    tables: Tables,
    *,
    x_at: Sequence[int] | None = None,
    loops: bool = True,
    is_aliased: bool = False,
) -> Printed:
    """A program. `place` turns what is laid out when it is first read into a row and an index.

    is_aliased: whether what it writes is a row that it reads too.
    """
    return _Program(name, calls, copies, place, tables, x_at, is_aliased).printed(loops)


class _Program:
    def __init__(
        self,
        name: str,
        calls: Sequence[Call],
        copies: Sequence[Copy],
        place: Callable[[Value], Value],
        tables: Tables,
        x_at: Sequence[int] | None,
        is_aliased: bool,
    ) -> None:
        self.name, self.calls, self.copies, self.tables = name, calls, copies, tables
        self.place_of, self.x_at, self.is_aliased = place, x_at, is_aliased
        self.made: dict[int, tuple[Call, int]] = {
            value: (call, k) for call in calls for k, value in enumerate(call.values)
        }
        self.group_of: dict[Call, tuple[_Group, int]] = {}
        self.w_at: dict[int, int] = {}
        self.scratch = 0

    # --- which calls are one loop ---------------------------------------------------------------------------------

    def grouped(self, loops: bool) -> list[_Group]:
        """The calls in groups; what needs each other is in different ones."""
        if not loops or len(self.calls) < LEAST:
            groups = [_Group([call]) for call in self.calls]
        else:
            depth: dict[Call, int] = {}
            found: dict[object, list[Call]] = {}
            for call in self.calls:
                level = 0
                for row, index in call.arguments:
                    if row in ("r", "ge"):
                        level = max(level, depth[self.made[index][0]] + 1)
                depth[call] = level
                rows = tuple(row for row, _ in call.arguments)
                forms = tuple(tuple((s.condition is None, s.off) for s in sinks) for sinks in call.sinks)
                fallback = None if call.fallback is None else tuple(row for row, _ in call.fallback)
                key = (call.function.name, level, rows, forms, call.guard, fallback)
                found.setdefault(key, []).append(call)
            groups = []
            for group in found.values():
                if len(group) >= LEAST:
                    groups.append(_Group(sorted(group, key=lambda call: call.order)))
                else:
                    groups += [_Group([call]) for call in group]
        self.assign(groups)
        while True:
            bad = {g: None for g in groups if LEAST_IRREGULAR > len(g.calls) > 1 and not self.is_regular(g)}
            if not bad:
                return groups
            groups = [g for g in groups if g not in bad] + [_Group([call]) for g in bad for call in g.calls]
            self.assign(groups)

    def assign(self, groups: Iterable[_Group]) -> None:
        self.group_of = {call: (group, lane) for group in groups for lane, call in enumerate(group.calls)}

    def is_regular(self, group: _Group) -> bool:
        """Whether all lanes find what they take and put what they give at regular places."""
        for k in range(len(group.calls[0].arguments)):
            column = [call.arguments[k] for call in group.calls]
            if column[0][0] in ("r", "ge"):
                if all(value == column[0] for value in column):
                    continue
                made = [self.group_of[self.made[index][0]] for _, index in column]
                if any(other is not made[0][0] or lane != i for i, (other, lane) in enumerate(made)):
                    return False
                if len(made[0][0].calls) != len(group.calls):
                    return False
            elif column[0][0] not in ("q", "n", "v", "p") and not _affine([index for _, index in column]):
                return False
        first = group.calls[0]
        return all(
            _affine([call.sinks[k][j].index for call in group.calls])
            for k, sinks in enumerate(first.sinks)
            for j in range(len(sinks))
        )

    def needs(self, group: _Group) -> dict[_Group, bool]:
        """The groups that a group reads, and whether each of its lanes reads the same lane there only."""
        found: dict[_Group, bool] = {}
        for lane, call in enumerate(group.calls):
            for row, index in call.arguments:
                if row in ("r", "ge"):
                    other, its = self.group_of[self.made[index][0]]
                    found[other] = found.get(other, True) and its == lane and len(other.calls) == len(group.calls)
        return found

    def clustered(self, groups: list[_Group]) -> list[list[_Group]]:
        """Groups that become one loop: of one count, wired lane by lane, with nothing in between."""
        before = {group: self.needs(group) for group in groups}
        clusters: dict[int, list[_Group]] = {}
        for number, group in enumerate(groups):
            group.cluster = number
            clusters[number] = [group]
        for group in groups:
            if not group.is_loop:
                continue
            for other in before[group]:
                a, b = other.cluster, group.cluster
                if a == b or not other.is_loop or not self.fits(clusters[a], clusters[b], before):
                    continue
                if self.is_between(clusters[a], clusters[b], before, clusters):
                    continue
                for member in clusters[b]:
                    member.cluster = a
                clusters[a] += clusters.pop(b)
        order = {group: number for number, group in enumerate(groups)}
        return [self.in_order(members, before, order) for members in clusters.values()]

    @staticmethod
    def fits(a: list[_Group], b: list[_Group], before: dict[_Group, dict[_Group, bool]]) -> bool:
        one, other = a[0].calls, b[0].calls
        if len(one) != len(other) or one[0].guard != other[0].guard:
            return False
        if any(g.calls[0].function.costly for g in a) != any(g.calls[0].function.costly for g in b):
            return False
        members = [*a, *b]
        return all(lanes for group in members for source, lanes in before[group].items() if source in members)

    @staticmethod
    def is_between(
        a: list[_Group],
        b: list[_Group],
        before: dict[_Group, dict[_Group, bool]],
        clusters: dict[int, list[_Group]],
    ) -> bool:
        """Whether one of two clusters needs the other through a third."""
        pair = {a[0].cluster, b[0].cluster}
        seen: set[int] = set()
        waiting = [s.cluster for group in (*a, *b) for s in before[group] if s.cluster not in pair]
        while waiting:
            number = waiting.pop()
            if number in pair:
                return True
            if number not in seen:
                seen.add(number)
                waiting += [s.cluster for group in clusters[number] for s in before[group] if s.cluster != number]
        return False

    @staticmethod
    def in_order(
        members: list[_Group], before: dict[_Group, dict[_Group, bool]], order: dict[_Group, int]
    ) -> list[_Group]:
        if len(members) == 1:
            return members
        made: list[_Group] = []
        inside, done = set(members), set()
        waiting = sorted(members, key=order.__getitem__)
        while waiting:
            group = next(g for g in waiting if all(s in done or s not in inside for s in before[g]))
            waiting.remove(group)
            done.add(group)
            made.append(group)
        return made

    def units(self, loops: bool) -> list[_Unit]:
        """The clusters in an order in which each comes after what it needs, straight calls in pieces."""
        clusters = self.clustered(self.grouped(loops))
        number = {group: k for k, members in enumerate(clusters) for group in members}
        place = {call: k for k, call in enumerate(self.calls)}
        waiting, users = [0] * len(clusters), [[] for _ in clusters]  # type: ignore[var-annotated]
        for k, members in enumerate(clusters):
            sources = dict.fromkeys(number[s] for group in members for s in self.needs(group))
            sources.pop(k, None)
            waiting[k] = len(sources)
            for source in sources:
                users[source].append(k)
        rank = [(members[0].is_loop, place[members[0].calls[0]], k) for k, members in enumerate(clusters)]
        heap = [rank[k] for k in range(len(clusters)) if waiting[k] == 0]
        heapq.heapify(heap)
        made: list[_Unit] = []
        count = weight = 0
        while heap:
            is_loop, _, k = heapq.heappop(heap)
            own = sum(group.calls[0].function.weight for group in clusters[k])
            full = count >= MOST_CALLS or weight + own > MOST_WEIGHT
            if is_loop or not made or made[-1].is_loop or full:
                made.append(_Unit([], is_loop))
                count = weight = 0
            made[-1].groups += clusters[k]
            count, weight = count + 1, weight + own
            for user in users[k]:
                waiting[user] -= 1
                if waiting[user] == 0:
                    heapq.heappush(heap, rank[user])
        return made

    # --- where values stand ---------------------------------------------------------------------------------------

    def lay_out(self, units: list[_Unit]) -> None:
        """Places in w for what one unit gives to another, or one lane to another; lanes stand side by side."""
        unit_of = {group: k for k, unit in enumerate(units) for group in unit.groups}
        wanted: dict[tuple[_Group, int], None] = {}

        def shared(value: Value, reader: int | None, lane: int) -> None:
            if value[0] not in ("r", "ge"):
                return
            call, k = self.made[value[1]]
            group, its = self.group_of[call]
            if unit_of[group] != reader or (group.is_loop and its != lane):
                wanted[group, k] = None

        for number, unit in enumerate(units):
            for group in unit.groups:
                for lane, call in enumerate(group.calls):
                    for value in call.arguments:
                        shared(value, number, lane)
        alone = len(units) == 1 and not units[0].is_loop
        for copy in self.copies:
            shared(copy.value, 0 if alone else None, 0)
        for group, k in wanted:
            for call in group.calls:
                self.w_at[call.values[k]] = self.scratch
                self.scratch += 1

    # --- printing -------------------------------------------------------------------------------------------------

    def printed(self, loops: bool) -> Printed:
        units = self.units(loops)
        self.lay_out(units)
        alone = len(units) == 1 and not units[0].is_loop
        texts = [self.loop(unit) if unit.is_loop else self.straight(unit, self.copies if alone else ()) for unit in units]
        if self.copies and not alone:
            last = _Unit([], False)
            texts.append(self.copied(self.copies, last))
            units.append(last)
        if alone:
            rows = [f"    const double *const {row} = m->{row};" for row in _ROWS if row in units[0].rows and row != "x"]
            return Printed("", "\n".join([*rows, *texts[0]]), 0)
        functions, body = [], []
        for k, (unit, lines) in enumerate(zip(units, texts, strict=True)):
            used = [row for row in _ROWS if row in unit.rows]
            how = "" if self.is_aliased else "restrict "
            taken = [*(["const BlocksMemory *m"] if unit.reads_memory else []), "double t"]
            taken += [f"const double *{how}{row}" for row in used]
            taken += ["const uint8_t *due"] if unit.due else []
            taken += [f"double *{how}out"]
            given = [*(["m"] if unit.reads_memory else []), "t"]
            given += [row if row == "x" else f"m->{row}" for row in used]
            given += [*(["due"] if unit.due else []), "out"]
            if self.scratch:
                taken.append("double *restrict w")
                given.append("w")
            head = "static void" if unit.is_loop else "static __attribute__((noinline)) void"
            unused = "    (void)t, (void)out" + (", (void)w;" if self.scratch else ";")
            text = "\n".join([unused, *lines])
            functions.append(f"{head} {self.name}_{k}({', '.join(taken)})\n{{\n{text}\n}}\n")
            body.append(f"    {self.name}_{k}({', '.join(given)});")
        if self.scratch:
            on_stack = self.scratch <= MOST_ON_STACK
            body.insert(0, f"    double w[{self.scratch}];" if on_stack else "    double *w = m->w;")
        return Printed("\n".join(functions), "\n".join(body), 0 if self.scratch <= MOST_ON_STACK else self.scratch)

    def row(self, value: Value, unit: _Unit) -> Value:
        """Where a value stands in memory: the row in C and the index."""
        row, index = value
        if row in ("r", "ge"):
            return "w", self.w_at[index]
        row, index = self.place_of(value)
        if row == "x" and self.x_at is not None:
            index = self.x_at[index]
        if row != "t":
            unit.rows[row] = None
        return row, index

    def read(self, value: Value, unit: _Unit, local: dict[int, str]) -> str:
        kind, number = value
        if kind in ("r", "ge") and number in local:
            text = local[number]
        else:
            row, index = self.row(value, unit)
            text = _text(row, str(index))
        return f"(double)({text} >= 0.0)" if kind == "ge" else text

    def straight(self, unit: _Unit, copies: Sequence[Copy]) -> list[str]:
        lines: list[str] = []
        local: dict[int, str] = {}
        for group in unit.groups:
            call = group.calls[0]
            given = [self.read(value, unit, local) for value in call.arguments]
            names = [f"r{len(local) + k}" for k in range(len(call.values))]
            keeps = [f"w[{self.w_at[v]}] = {r};" for v, r in zip(call.values, names, strict=True) if v in self.w_at]
            other = [
                f"{r} = {self.read(value, unit, local)};"
                for r, value in zip(names, call.fallback or (), strict=bool(call.fallback))
            ]
            local.update(zip(call.values, names, strict=True))
            stores = []
            for r, sinks in zip(names, call.sinks, strict=True):
                for sink in sinks:
                    side = "" if sink.condition is None else self.read(("s", sink.condition), unit, {})
                    own = self.read(("s", sink.index), unit, {}) if sink.off == "side" else ""
                    stores.append(_store(str(sink.index), r, sink.off, side, own))
            made = self.call_text(call, given, names, unit)
            by_value = len(names) == 1 and not call.function.takes_memory
            label = f"  /* {comment(call.label)} */"
            if not call.guard:
                if by_value:
                    lines += [f"const double {names[0]} = {made};{label}", *stores, *keeps]
                else:
                    lines += [f"double {', '.join(names)};", f"{made};{label}", *stores, *keeps]
                continue
            unit.due = True
            lines.append(f"double {', '.join(f'{r} = 0.0' for r in names)};")
            lines.append(f"if ({_due(call.guard)}) {{{label}")
            lines += [f"    {line}" for line in (f"{names[0]} = {made};" if by_value else f"{made};", *stores)]
            lines += ["} else {", *(f"    {line}" for line in other)] if other else []
            lines += ["}", *keeps]
        lines = [f"    {line}" for line in lines]
        return lines + self.copied(copies, unit, local)

    def call_text(self, call: Call, given: list[str], names: list[str], unit: _Unit) -> str:
        if call.function.takes_memory:
            unit.reads_memory = True
            given = ["m", *given]
        if len(names) > 1 or call.function.takes_memory:
            given = [*given, *(f"&{r}" for r in names)]
        return f"{call.function.name}({', '.join(given)})"

    def loop(self, unit: _Unit) -> list[str]:
        """A loop over lanes. gcc vectorises at -O2 only loops of an even count, so an odd lane stands alone."""
        count, guard = len(unit.groups[0].calls), unit.groups[0].calls[0].guard
        hoisted: list[str] = []
        body: list[str] = []
        other: list[str] = []
        local: dict[int, str] = {}  # values of lane 0, which stand for those of all lanes

        def column(values: Sequence[Value]) -> str:
            """The text of what stands in one place of every lane."""
            kind, number = values[0]
            test = " >= 0.0" if kind == "ge" else ""
            if kind in ("r", "ge") and number in local:
                group, _ = self.group_of[self.made[number][0]]
                made = [self.group_of[self.made[index][0]] for _, index in values]
                if all(g is group and lane == i for i, (g, lane) in enumerate(made)):
                    return f"(double)({local[number]}{test})" if test else local[number]
            if kind in ("p", "d", "s") and not _affine([index for _, index in values], 1):
                values = [self.place_of(("copy", value)) for value in values]  # side by side
            places = [self.row(value, unit) for value in values]
            text = _text(places[0][0], self.index([index for _, index in places]))
            if all(place == places[0] for place in places) and places[0][0] not in ("t", "c"):
                hoisted.append(f"    const double h{len(hoisted)} = {text};")
                text = f"h{len(hoisted) - 1}"
            return f"(double)({text}{test})" if test else text

        for group in unit.groups:
            calls = group.calls
            first = calls[0]
            given = [column([call.arguments[k] for call in calls]) for k in range(len(first.arguments))]
            names = [f"r{len(local) + k}" for k in range(len(first.values))]
            local.update(zip(first.values, names, strict=True))
            made = self.call_text(first, given, names, unit)
            label = f"  /* {comment(first.label)} and {count - 1} more */"
            if len(names) == 1 and not first.function.takes_memory:
                body.append(f"const double {names[0]} = {made};{label}")
            else:
                body += [f"double {', '.join(names)};", f"{made};{label}"]
            for k, r in enumerate(names):
                if first.values[k] in self.w_at:
                    at = self.index([self.w_at[call.values[k]] for call in calls])
                    body.append(f"w[{at}] = {r};")
                    if first.fallback is not None:
                        other.append(f"w[{at}] = {column([call.fallback[k] for call in calls if call.fallback])};")
                for j, sink in enumerate(first.sinks[k]):
                    at = self.index([call.sinks[k][j].index for call in calls])
                    conditions = [call.sinks[k][j].condition for call in calls]
                    side = "" if sink.condition is None else column([("s", c) for c in conditions if c is not None])
                    own = column([("s", call.sinks[k][j].index) for call in calls]) if sink.off == "side" else ""
                    body.append(_store(at, r, sink.off, side, own))
        costly = any(group.calls[0].function.costly for group in unit.groups)
        odd = count % 2 and not costly and count > 2

        def over(lines: list[str]) -> list[str]:
            inner = [f"        {line}" for line in lines]
            made = [f"    for (int i = 0; i < {count - 1 if odd else count}; i++) {{", *inner, "    }"]
            return [*made, "    {", f"        const int i = {count - 1};", "        (void)i;", *inner, "    }"] if odd else made

        if not guard:
            return [*hoisted, *over(body)]
        unit.due = True
        made = [*hoisted, f"    if ({_due(guard)}) {{", *over(body), "    }"]
        return [*made, "    else {", *over(other), "    }"] if other else made

    def index(self, indices: Sequence[int]) -> str:
        """An index as a function of the lane i."""
        if not _affine(indices):
            return f"{self.tables.name(tuple(indices))}[i]"
        base, stride = indices[0], indices[1] - indices[0] if len(indices) > 1 else 0
        if stride == 0:
            return str(base)
        lane = "i" if stride == 1 else f"{stride} * i"
        return f"{base} + {lane}" if base else lane

    def copied(self, copies: Sequence[Copy], unit: _Unit, local: dict[int, str] | None = None) -> list[str]:
        """Copies, those of equal form in loops."""
        lines: list[str] = []
        runs: dict[object, list[Copy]] = {}
        for copy in sorted(copies, key=lambda copy: copy.sink.index):
            key: object = (copy.value[0], copy.sink.condition is None, copy.sink.off)
            if local is not None and copy.value[0] in ("r", "ge") and copy.value[1] in local:
                key = copy
            runs.setdefault(key, []).append(copy)
        for run in runs.values():
            for piece in _pieces(run, lambda copy: (self.row(copy.value, unit)[1], copy.sink.index)):
                if len(piece) < LEAST:
                    for copy in piece:
                        text = self.read(copy.value, unit, local or {})
                        side = "" if copy.sink.condition is None else self.read(("s", copy.sink.condition), unit, {})
                        own = self.read(("s", copy.sink.index), unit, {}) if copy.sink.off == "side" else ""
                        lines.append("    " + _store(str(copy.sink.index), text, copy.sink.off, side, own))
                    continue
                places = [self.row(copy.value, unit) for copy in piece]
                text = _text(places[0][0], self.index([index for _, index in places]))
                text = f"(double)({text} >= 0.0)" if piece[0].value[0] == "ge" else text
                at = self.index([copy.sink.index for copy in piece])
                conditions = [c.sink.condition for c in piece if c.sink.condition is not None]
                side = own = ""
                if conditions:
                    unit.rows["s"] = None
                    side = _text("s", self.index(conditions))
                    own = _text("s", at)
                store = _store(at, text, piece[0].sink.off, side, own)
                lines.append(f"    for (int i = 0; i < {len(piece)}; i++) {store}")
        return lines


def _pieces(copies: list[Copy], where: Callable[[Copy], tuple[int, int]]) -> list[list[Copy]]:
    """Copies in runs of regular places, in few of them if that can be."""
    if len(copies) < LEAST or copies[0].value[0] == "t":
        return [[copy] for copy in copies]
    places = [where(copy) for copy in copies]
    for period in range(1, min(32, len(copies) // LEAST) + 1):
        # Instances that stand one after the other, each with so many copies.
        if all(_affine([place[k] for place in places[first::period]]) for first in range(period) for k in (0, 1)):
            return [copies[first::period] for first in range(period)]
    made: list[list[Copy]] = []
    last = step = (0, 0)
    for copy, place in zip(copies, places, strict=True):
        moved = (place[0] - last[0], place[1] - last[1])
        if made and (len(made[-1]) == 1 or moved == step):
            made[-1].append(copy)
        else:
            made.append([copy])
        last, step = place, moved
    return made if len(made) <= max(4, len(copies) // 16) else [copies]


def _affine(indices: Sequence[int], most: int | None = None) -> bool:
    """Whether indices are equally spaced, at most so far."""
    if len(indices) < 2:
        return True
    stride = indices[1] - indices[0]
    if most is not None and abs(stride) > most:
        return False
    return all(b - a == stride for a, b in zip(indices, indices[1:], strict=False))


def _text(row: str, index: str) -> str:
    return "t" if row == "t" else f"{row} + {index}" if row == "c" else f"{row}[{index}]"


def _due(guard: tuple[int, ...]) -> str:
    return " || ".join(f"due[{rate}]" for rate in guard)


def _store(at: str, value: str, off: str, side: str, own: str) -> str:
    if not side:
        return f"out[{at}] = {value};"
    if off == "keep":
        return f"if ({side} != 0.0) out[{at}] = {value};"
    other = {"zero": "0.0", "inf": "INFINITY", "side": f"({own} != 0.0 ? 1.0 : -1.0)"}[off]
    return f"out[{at}] = {side} != 0.0 ? {value} : {other};"
