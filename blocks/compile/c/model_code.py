"""A Plan as C: one file, whose text follows from the structure of the diagram alone.

Values of parameters, start values and numbers that stand in the diagram are not in the text but in the rows p, n and c,
so that changing them compiles nothing. Everything has one of three levels:

    fixed       follows from parameters and numbers: computed by `prepare` into q
    held        follows from these and from discretes, sides and tick numbers: whole results of it that continuous
                programs need are computed by `refresh` into v
    moving      all else: computed where it is needed

In programs that run in every step or stage, what is fixed inside a type's function also becomes an argument that is
read from q. What is in q, v and n gets its place when it is first read, lane by lane, so that loops over equal
instances find it side by side.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from ...host.gc_pause import paused
from ..jacobian import PlanJacobian
from ..motion import looked_at
from ..plan import Cause, Node, Plan, Program, Reference
from ..scheduler import schedule
from ..tableaus import METHODS, STIFF
from ..tick_stages import UnitPlace, rate_sets, sequence_of, tick_program
from .c_text import Filled, ints
from .emitted import Clique, Emitted, Stage
from .function_code import LANES, comment, function_text
from .jacobian_code import elimination, in_order, jacobian_text
from .lane_code import LANE_PROGRAMS, LaneCode
from .loops import Call, Copy, Sink, at_of
from .plan_reader import MOVING, Places, PlanReader, ProgramScope
from .program_code import SAME, print_program, print_selected

RATES = ("rates", "rates_and_sides", "rates_and_measured", "bent_measured", "plain_measured")
LONG, LONGEST = 20_000, 100_000  # characters; a longer program is not printed twice, or is compiled as cold code


@paused()
def emit(
    plan: Plan,
    *,
    measured: Sequence[Reference] = (),
    method: str,
    logged: Sequence[Reference] = (),
    loops: bool = True,
    others: Mapping[str, Sequence[Reference]] = MappingProxyType({}),
    end: str = "",
    lanes: bool = False,
    is_filled: bool = False,
) -> Emitted:
    """The model of a Plan. measured, logged: what its programs of these names give. method: whose stepping loop is
    compiled ("euler", "rk4", "dopri5", "radau", "auto"; any other: none). loops: False prints every call by itself.
    others: what further programs give, by their names; end: C text at the end. lanes: whether programs of several runs
    side by side are printed too. is_filled: whether tables of copies may stand in `Emitted.filled`."""
    folded = plan.folded
    if folded is None or lanes:
        plan = plan if plan.written_out is None else plan.written_out()
        emitter = _Emitter(plan, loops, looked_at(plan, measured, logged))
        if lanes:
            emitter.lanes = LaneCode(lambda name: function_text(name, *emitter.printed_as[name], LANES))
        return emitter.emitted(plan, method, others, end)
    one, of_one = folded.plan, folded.of_one
    watched = looked_at(one, list(map(of_one, measured)), list(map(of_one, logged)))
    others = {name: list(map(of_one, asked)) for name, asked in others.items()}
    emitter = _Emitter(one, True, watched, folded)
    emitter.filled = Filled("blocks_filled") if is_filled else None
    return emitter.emitted(plan, method, others, end)


_SIGNATURES = {
    "prepare": "BlocksMemory *m",
    "refresh": "BlocksMemory *m",
    "resets_given": "const BlocksMemory *m, double t, const double *x, int which, double *out",
    "resets": "const BlocksMemory *m, double t, const double *x, int which, double *out",
    "anew": "const BlocksMemory *m, double t, const double *x, int which, double *out",
    "outputs": "const BlocksMemory *m, double t, const double *x, int clique, int stage, const uint8_t *due, "
    "double *out",
    "nexts": "const BlocksMemory *m, double t, const double *x, const uint8_t *due, double *out",
    "stepper_inputs": "const BlocksMemory *m, double t, const double *x, int which, double *out",
}
_SIGNATURE = "const BlocksMemory *m, double t, const double *x, double *out"




def _plain(items: Sequence[object]) -> list[Sink]:
    return [Sink(k) for k in range(len(items))]


def _listed(places: range | int) -> range:
    return range(places, places + 1) if isinstance(places, int) else places


def _moved(places: range | int, by: int) -> range | int:
    return places + by if isinstance(places, int) else range(places.start + by, places.stop + by, places.step)


class _Emitter(PlanReader):
    lanes: LaneCode | None = None
    filled: Filled | None = None
    is_long = False  # whether the rates are
    whole: Plan
    """The plan of the whole diagram; `plan` is that of one copy where there are copies."""

    def continuous(
        self,
        name: str,
        asked: Sequence[Node | Reference],
        sinks: Sequence[Sink],
        *,
        is_quick: bool = True,
        guards: Sequence[tuple[int, ...]] = (),
    ) -> str:
        """The body of a program over the continuous part: `asked` go to `sinks`."""
        scope = ProgramScope({}, {}, {}, is_quick, is_hot=name in RATES)
        self.seen_states = {}
        calls = self.sliced(asked, scope, held=(lambda node: True) if is_quick else self.v.__contains__)
        copies = self.attach(name, calls, asked, sinks, scope)
        if guards:
            self.guard(calls, {node: guard for node, guard in zip(asked, guards, strict=True) if len(node) == 3}, scope)
        self.states_of[name] = self.states_seen()
        return self.printed(name, calls, copies, is_hot=is_quick)

    def states_seen(self) -> tuple[int, ...]:
        """The places in the model of the states that the program at hand reads."""
        seen: set[int] = set()
        for index, lane in self.seen_states:
            own = self.x_range(index)
            seen |= {own} if isinstance(own, int) else {own[lane]} if lane >= 0 else set(own)
        return tuple(sorted(seen))

    def x_range(self, index: int) -> range | int:
        """The places in the model of a state, in all copies."""
        first, lanes = self.x_at[index], self.lanes_of("x", index)
        return range(first, first + lanes) if lanes > 1 else first

    def attach(
        self,
        name: object,
        calls: Sequence[Call],
        asked: Sequence[Node | Reference],
        sinks: Sequence[Sink],
        scope: ProgramScope,
        *,
        is_local: bool = False,
    ) -> list[Copy]:
        """Attaches sinks to the calls that compute their values; copies for all else. is_local: a sink of a call of
        copies is one number: as one lane alone is computed, or the places are given later."""
        producers = {value: (call, k) for call in calls for k, value in enumerate(call.values)}
        copies = []
        for number, (item, sink) in enumerate(zip(asked, sinks, strict=True)):
            if isinstance(item, Node):
                value = self.node_value(item, scope)
            else:
                value = self.value(item, scope, (name, number))
            if value[0] == "r":
                call, k = producers[value[1]]
                if call.lanes == (len(sink.index) if isinstance(sink.index, range) else 1) and not call.gathers:
                    call.sinks[k].append(sink)
                    continue
                if is_local and call.lanes > 1 and type(value[1]) is int:
                    call.sinks[k].append(sink)
                    continue
            copies.append(Copy(value, sink))
        return copies

    def guard(self, calls: list[Call], guards: Mapping[Node, tuple[int, ...]], scope: ProgramScope) -> None:
        """Guard each call by the rates that need it."""
        producers = {value: call for call in calls for value in call.values}
        wanted: dict[Call, set[int]] = {call: set() for call in calls}
        for node, rates in guards.items():
            wanted[producers[scope.made[node]]].update(rates)
        for call in reversed(calls):
            call.guard = tuple(sorted(wanted[call]))
            for row, index in call.arguments:
                if row in ("r", "ge"):
                    wanted[producers[index]].update(call.guard)

    def printed(self, name: str, calls: list[Call], copies: list[Copy], *, is_hot: bool = False) -> str:
        self.is_hot = is_hot
        printed = print_program(
            name, calls, copies, self.place, self.tables, loops=self.loops,
            is_aliased=self.is_in_prepare, is_hot=name in RATES,
        )  # fmt: skip
        self.scratch = max(self.scratch, printed.scratch)
        if self.lanes is not None and (name in LANE_PROGRAMS or (name == "crossings" and self.is_long)):
            wide = print_program(
                name, calls, copies, self.place, self.tables, loops=self.loops, numbers=LANES
            )
            self.lanes.add(name, wide, calls)
        if not printed.same:
            functions = printed.functions
            if name not in (*RATES, "logged", "plain_measured", "bent_measured") or len(functions) > LONGEST:
                functions = functions.replace("static __attribute__((noinline))", "static BLOCKS_COLD")
            self.texts += [functions] if functions else []
            return printed.body
        self.same.update(dict.fromkeys(printed.same))
        number = re.compile(rf"\b{name}_(\d+)\(")
        self.texts.append(printed.functions.replace(SAME, "i"))
        self.texts.append(number.sub(rf"{name}_same_\1(", printed.functions.replace(SAME, "0")))
        same = number.sub(rf"{name}_same_\1(", printed.body)
        return f"    if (m->same) {{\n{same}\n        return;\n    }}\n{printed.body}"

    def define(self, name: str, body: str) -> None:
        """A program of a fixed name."""
        if name in ("prepare", "refresh"):
            row = "q" if name == "prepare" else "v"
            body = f"    const double t = 0.0, *const x = m->x;\n    double *const out = m->{row};\n{body}"
        signature = _SIGNATURES.get(name, _SIGNATURE)
        is_hot = name in RATES
        is_inline = is_hot or (name == "logged" and len(body) < 4000)
        if is_hot:
            signature = "const BlocksMemory *m, double t, const double *restrict x, double *restrict out"
        unused = ", ".join(f"(void){taken.split()[-1].lstrip('*')}" for taken in signature.split(", "))
        if name in ("prepare", "refresh"):
            unused = "(void)t, (void)x, (void)out"
            body, rest = "\n".join(body.split("\n")[:2]), "\n".join(body.split("\n")[2:])
            text = f"{body}\n    {unused};\n{rest}"
        else:
            text = f"    {unused};\n{body}"
        kind = "static inline void" if is_inline else "static void"
        self.texts.append(f"{kind} {name}({signature})\n{{\n{text}\n}}\n")

    def selected(
        self, name: str, programs: Sequence[tuple[list[Call], list[Copy]]], numbers: Sequence[range] | None = None
    ) -> None:
        """A program that runs one of others, chosen by its argument `which`. numbers: those that choose each."""
        self.is_hot = False
        own = [range(k, k + 1) for k in range(len(programs))] if numbers is None else numbers
        printed = print_selected(name, programs, self.place, self.tables, own)
        self.texts += [printed.functions] if printed.functions else []
        self.define(name, printed.body)

    def part(self, name: str, asked: Sequence[Node | Reference]) -> tuple[list[Call], list[Copy]]:
        """One of the programs that an argument chooses from, over the continuous part."""
        scope = ProgramScope({}, {}, {})
        self.seen_states = {}
        calls = self.sliced(asked, scope, held=self.v.__contains__)
        sinks = [Sink(k) for k in range(len(asked))]
        return calls, self.attach((name, self.new_value()), calls, asked, sinks, scope, is_local=True)

    def beginning(self, resets: tuple[Reference, ...]) -> tuple[list[Call], list[Copy]]:
        """The start values of an enabled subdiagram that begins anew."""
        program = schedule(self.plan, resets, start=frozenset(resets))
        scope = ProgramScope({}, {}, program.moved, False, True)
        calls = self.calls_of(program, scope)
        copies = self.attach(("anew", self.new_value()), calls, resets, [Sink(k) for k in range(len(resets))], scope)
        return calls, copies

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
                [at_of(call.sinks[k][j]) for call in sorted(group, key=lambda call: call.order)]
                for k, sinks in enumerate(group[0].sinks)
                for j in range(len(sinks))
            ]
            if len(group) < 4 and self.folded is None:
                plain += [index for column in columns for index in column]
            else:
                rest += [index for column in columns for index in column]
        known = dict.fromkeys((*plain, *rest))
        copied = [index for index in range(len(self.plan.states)) if index not in known]
        x_order = [*sorted([*plain, *copied]), *rest]
        whole: list[int] = []
        for index in x_order:
            self.x_at[index] = len(whole)
            places = self.all_places("x", index)
            whole += places if isinstance(places, range) else [places]
        self.x_order = tuple(whole)
        for call in calls:
            call.sinks = [[self.at_state(sink) for sink in sinks] for sinks in call.sinks]

    def at_state(self, sink: Sink) -> Sink:
        """A sink of the rate of a state of the plan, as one of the model."""
        assert isinstance(sink.index, int)
        return Sink(self.x_range(sink.index), sink.condition, sink.off)

    # --- all of them ----------------------------------------------------------------------------------------------

    def emitted(self, whole: Plan, method: str, others: Mapping[str, Sequence[Reference]], end: str) -> Emitted:
        plan = self.plan
        self.whole = whole
        nodes = [cause.node for cause in plan.crossings]
        moving = any(self.level[node] == MOVING for node in nodes)
        loop = "dopri5" if method == "auto" else method  # whose stepping loop it begins by
        self.rates()
        has_own_sides = moving and not (self.is_long and loop in METHODS)
        if has_own_sides:
            self.rates_and_sides(nodes)
        quick = self.quick_measures(loop, moving=moving)
        self._define_nodes("crossings", nodes, "side", is_quick=True)
        if moving and not has_own_sides:  # compiling long rates twice takes longer than computing some values twice
            self.sides = tuple(range(len(whole.crossings)))
            body = "    rates(m, t, x, out);\n    crossings(m, t, x, out + BLOCKS_NX);"
            self.define("rates_and_sides", body)
            if self.lanes is not None:
                self.lanes.define("rates_and_sides", body)
        watched = {name: self.watched[name] for name in ("logged", "measured", "remembered")}
        for name, asked in {"solutions": plan.unknowns, **watched, **others}.items():
            self.define(name, self.continuous(name, asked, _plain(asked)))
        for name, motion in self.motions.items():
            if motion.phases:
                named = f"{name}_phases"
                sinks = list(map(Sink, self.side_by_side(motion.phases)))
                self.define(named, self.continuous(named, motion.phases, sinks))
        self.refresh()
        self._define_instants()
        corners = self.corners() if plan.corners or plan.guessed else ""
        self.start()
        self.selected("anew", [self.beginning(part.resets) for part in plan.enabled])
        cliques = self.outputs()
        slopes = self.slopes() if method in STIFF else ""
        self.prepare()
        self.compare_lanes()
        return self.finished(method, cliques, moving, corners + slopes, end, quick)

    def sink(self, k: int | range, node: Node, off: str) -> Sink:
        """Return the sink of a node. off: its value while its subdiagram is off."""
        side = self.plan.instances[node.instance].condition
        return Sink(k) if side is None else Sink(k, side, off)

    def _define_nodes(self, name: str, nodes: Sequence[Node], off: str | None, *, is_quick: bool) -> None:
        """Define a function of nodes. off: their value while their subdiagrams are off; None: they have no sides."""
        places = self.spread([node.instance for node in nodes])
        sinks = list(map(Sink, places))
        if off is not None:
            sinks = [self.sink(place, node, off) for place, node in zip(places, nodes, strict=True)]
        self.define(name, self.continuous(name, nodes, sinks, is_quick=is_quick))

    def _define_instants(self) -> None:
        """Define the functions that instants alone call."""
        plan = self.plan
        if plan.foreign:
            given = [reference for part in plan.foreign for reference in part.inputs]
            self.define("foreign_inputs", self.continuous("foreign_inputs", given, _plain(given), is_quick=False))
        self._define_nodes("event_times", [cause.node for cause in plan.events], "inf", is_quick=False)
        causes = (*plan.crossings, *plan.events)
        resets = [self.part("resets", [node for node, _ in cause.resets]) for cause in causes]
        self.selected("resets", resets, self.numbers_of_causes())
        self._define_nodes("projections", [node for node, _ in plan.projections], None, is_quick=False)
        self.nexts()
        taken = [[r for _, references, _ in part.inputs for r in references] for part in plan.steppers]
        self.selected("stepper_inputs", [self.part("stepper_inputs", references) for references in taken])

    def side_by_side(self, asked: Sequence[Node | Reference]) -> list[range | int]:
        """Places for nodes or references, those of the lanes of each side by side."""
        places = Places[Node | Reference]()
        copies = [self.copies_of(one[0]) if isinstance(one, Node) else self.lanes_of(*one) for one in asked]
        return list(map(places.place, asked, copies))

    def numbers_of_causes(self) -> list[range]:
        """The numbers of each cause in the whole diagram: crossings, then event times."""
        crossings = self.spread([cause.instance for cause in self.plan.crossings])
        events = self.spread([cause.instance for cause in self.plan.events])
        first = len(self.whole.crossings)
        numbers = [*((0, own) for own in crossings), *((first, own) for own in events)]
        return [
            range(k + own, k + own + 1) if isinstance(own, int) else range(k + own.start, k + own.stop, own.step)
            for k, own in numbers
        ]

    def rates(self) -> None:
        nodes = self.plan.derivatives
        sinks = [self.sink(k, node, "zero") for k, node in enumerate(nodes)]
        scope = ProgramScope({}, {}, {}, True, is_hot=True)
        self.seen_states = {}
        calls = self.sliced(nodes, scope, held=lambda node: True)
        copies = self.attach("rates", calls, nodes, sinks, scope, is_local=True)
        self.order_states(calls)
        copies = [Copy(copy.value, self.at_state(copy.sink)) for copy in copies]
        copies.sort(key=lambda copy: copy.sink.index if isinstance(copy.sink.index, int) else copy.sink.index.start)
        printed = len(self.texts)
        body = self.printed("rates", calls, copies, is_hot=True)
        self.define("rates", body)
        self.is_long = len(body) + sum(map(len, self.texts[printed:])) > LONG

    def compare_lanes(self) -> None:
        """Whether all lanes of all loops read the same parameters: reading takes most time where memory is slow."""
        pieces = [f"{{{int(row == 'n')}, {first}, {count}}}" for row, first, count in self.same]
        table = f"    static const int pieces[][3] = {{{', '.join(pieces) or '{0, 0, 0}'}}};\n"
        loop = "for (int k = 0; k < (int)(sizeof pieces / sizeof *pieces); k++)"
        find = "const double *at = (pieces[k][0] ? m->n : m->q) + pieces[k][1];"
        inner = "for (int i = 1; i < pieces[k][2]; i++)\n            if (at[i] != at[0]) return 0;"
        body = f"    {loop} {{\n        {find}\n        {inner}\n    }}\n    return {int(bool(self.same))};"
        self.texts.append(f"static int lanes_are_same(const BlocksMemory *m)\n{{\n{table}{body}\n}}\n")

    def rates_and_sides(self, crossings: Sequence[Node]) -> None:
        """The rates, followed by all crossings: what both need is computed once."""
        nx = len(self.whole.states)
        sinks = [self.sink(self.x_range(k), node, "zero") for k, node in enumerate(self.plan.derivatives)]
        # Those of equal instances side by side, as their loop writes them.
        kinds: dict[object, list[int]] = {}
        for j, (instance, key, element) in enumerate(crossings):
            kinds.setdefault((id(self.plan.instances[instance].tape), key, element), []).append(j)
        order = [j for group in kinds.values() for j in group]
        whole = [_listed(places) for places in self.spread([node.instance for node in crossings])]
        self.sides = tuple(k for group in kinds.values() for k in sorted(k for j in group for k in whole[j]))
        rank = {k: place for place, k in enumerate(self.sides)}
        for j in order:  # each copy has as many of a kind, so that the places of lanes are regular
            first, second = (nx + rank[whole[j][lane]] for lane in (0, min(1, len(whole[j]) - 1)))
            own = range(first, first + (second - first) * len(whole[j]), second - first) if second > first else first
            sinks.append(self.sink(own, crossings[j], "inf"))
        nodes = [*self.plan.derivatives, *(crossings[j] for j in order)]
        self.define("rates_and_sides", self.continuous("rates_and_sides", nodes, sinks))

    def quick_measures(self, method: str, *, moving: bool) -> dict[str, int]:
        """The programs by which the stepping loop measures: at the end of a step behind its rates; inside, what five
        values tell apart from what they do not. Without them it measures like all that is looked at in parts."""
        plan, asked, motion = self.plan, self.watched["measured"], self.motions["measured"]
        is_quick = bool(asked) and method in METHODS and not (motion.phases or motion.histories)
        is_quick = is_quick and not (plan.projections or plan.histories or plan.unknowns or plan.foreign)
        is_shared = is_quick and not moving and not self.is_long
        sizes = {"QUICK_MEASURES": int(is_quick), "SHARES_MEASURED": int(is_shared)}
        sizes["DRIVEN_MEASURES"] = int(motion.is_driven)
        if is_shared:
            first = len(self.whole.states) + len(self.whole.crossings)
            sinks = [self.sink(self.x_range(k), node, "zero") for k, node in enumerate(plan.derivatives)]
            sinks += [Sink(first + k) for k in range(len(asked))]
            body = self.continuous("rates_and_measured", [*plan.derivatives, *asked], sinks)
            self.define("rates_and_measured", body)
        for name, is_bent in (("plain", False), ("bent", True)) if is_quick else ():
            columns = [k for k, bent in enumerate(motion.bent) if bent == is_bent]
            program = f"{name}_measured"
            self.define(program, self.continuous(program, [asked[k] for k in columns], list(map(Sink, columns))))
            states = self.states_of[program]
            sizes |= {f"N{name.upper()}": len(columns), f"N{name.upper()}_STATES": len(states)}
            for what, items in (("STATES", states), ("COLUMNS", columns)):
                rows = ", ".join(map(str, items)) or "0"
                self.texts.append(f"#define BLOCKS_{name.upper()}_{what} {{{rows}}}\n")
                if self.lanes is not None:
                    self.lanes.texts.append(self.texts[-1])
        return sizes

    def refresh(self) -> None:
        """What is in v so far, and what it needs."""
        nodes = list(self.v)
        scope = ProgramScope({}, {}, {})
        self.seen_states = {}
        calls = self.sliced(nodes, scope, held=lambda node: False)
        copies = self.attach("refresh", calls, nodes, [Sink(self.own_place(node)) for node in nodes], scope)
        self.define("refresh", self.printed("refresh", calls, copies))

    def nexts(self) -> None:
        pairs = [(node, slot, k) for k, rate in enumerate(self.plan.rates) for node, slot in rate.nexts]
        nodes = [node for node, _, _ in pairs]
        sinks = [self.sink(self.all_places("d", slot), node, "keep") for node, slot, _ in pairs]
        body = self.continuous("nexts", nodes, sinks, is_quick=False, guards=[(k,) for _, _, k in pairs])
        self.define("nexts", body)

    def own(self, name: str, program: Program, sinks: Sequence[Sink], *, is_start: bool = True) -> str:
        """The body of a program with an order of its own, for memory that is not filled yet."""
        scope = ProgramScope({}, {}, program.moved, False, is_start)
        self.seen_states = {}
        calls = self.calls_of(program, scope)
        copies = self.attach(name, calls, program.results, sinks, scope)
        return self.printed(name, calls, copies)

    def corners(self) -> str:
        """The programs of corners of loops, and their table."""
        plan = self.plan
        nodes = [cause.node for cause in plan.crossings]
        sinks = [self.sink(k, node, "side") for k, node in enumerate(nodes)]
        program = schedule(plan, nodes, given=True)
        self.define("crossings_given", self.own("crossings_given", program, sinks, is_start=False))
        scope = ProgramScope({}, {}, {}, is_rounding=True)
        self.seen_states = {}
        calls = self.calls_of(schedule(plan, plan.unknowns), scope)
        nodes = [plan.outputs[reference.index] for reference in plan.unknowns]
        copies = self.attach("rounding", calls, nodes, list(map(Sink, range(len(nodes)))), scope)
        self.define("rounding", self.printed("rounding", calls, copies))
        resets = [self.given(cause if j in plan.corners else None) for j, cause in enumerate(plan.crossings)]
        self.selected("resets_given", resets)
        numbers = ints("corner_numbers", plan.corners or (0,)) + ints("corner_guessed", plan.guessed or (0,))
        rows = "crossings_given, rounding, start_given, start_solved, resets_given, corner_numbers, corner_guessed"
        sizes = f"{len(plan.corners)}, {len(plan.inner_corners)}, {len(plan.guessed)}"
        return f'\n#include "runtime.h"\n{numbers}static const BlocksCorners corners = {{{rows}, {sizes}}};\n'

    def given(self, cause: Cause | None) -> tuple[list[Call], list[Copy]]:
        """The resets of a crossing where the solutions of loops are those in z."""
        if cause is None or not cause.resets:
            return [], []
        program = schedule(self.plan, [node for node, _ in cause.resets], given=True)
        scope = ProgramScope({}, {}, program.moved)
        self.seen_states = {}
        calls, sinks = self.calls_of(program, scope), [Sink(k) for k in range(len(program.results))]
        return calls, self.attach(("given", self.new_value()), calls, program.results, sinks, scope, is_local=True)

    def start(self) -> None:
        plan = self.plan
        nx, nd = len(self.whole.states), len(self.whole.discretes)
        asked: list[Node | Reference] = [Reference("x", i) for i in range(len(plan.states))]
        asked += [plan.d_start[i] if i in plan.guessed else Reference("d", i) for i in range(len(plan.discretes))]
        asked += [*plan.s_start, *(reference for part in plan.foreign for reference in part.inputs)]
        program = schedule(plan, asked, start=plan.starting)
        places: list[range | int] = [self.x_range(i) for i in range(len(plan.states))]
        places += [_moved(self.all_places("d", i), nx) for i in range(len(plan.discretes))]
        places += [_moved(place, nx + nd) for place in self.spread([cause.instance for cause in plan.crossings])]
        taken = len(asked) - len(places)
        places += range(nx + nd + len(self.whole.crossings), nx + nd + len(self.whole.crossings) + taken)
        self.define("start", self.own("start", program, list(map(Sink, places))))
        if plan.corners or plan.guessed:
            given = schedule(plan, asked, start=plan.starting, given=True)
            self.define("start_given", self.own("start_given", given, list(map(Sink, places))))
            solved = schedule(plan, [*asked, *plan.unknowns], start=plan.starting)
            places += range(len(asked), len(asked) + len(plan.unknowns))
            self.define("start_solved", self.own("start_solved", solved, list(map(Sink, places))))

    def outputs(self) -> tuple[Clique, ...]:
        plan = self.plan
        if not (plan.rates or plan.foreign):
            self.define("outputs", "    (void)clique, (void)stage, (void)due;")
            return ()
        tick_cliques: list[Clique] = []
        cases: list[str] = []
        for rates in rate_sets(plan):
            stages = []
            for number, members in enumerate(sequence_of(plan, rates)):
                if isinstance(members, UnitPlace):
                    late = (*sorted(members.rates), *(-1 - k for k in sorted(members.units)))
                    stages.append(Stage((), late, members.unit))
                    continue
                slots = tuple((slot, plan.held_nodes[slot][1]) for slot in sorted(members) if slot >= 0)
                all_slots = sorted((k, rate) for slot, rate in slots for k in _listed(self.all_places("d", slot)))
                stages.append(Stage(tuple(all_slots), tuple(sorted(-1 - key for key in members if key < 0))))
                if not slots:
                    continue
                name = f"outputs_{len(tick_cliques)}_{number}"
                body = self.stage(name, slots)
                signature = "const BlocksMemory *m, double t, const double *x, const uint8_t *due, double *out"
                unused = "    (void)m, (void)t, (void)x, (void)due, (void)out;"
                self.texts.append(f"static void {name}({signature})\n{{\n{unused}\n{body}\n}}\n")
                cases.append(f"    if (clique == {len(tick_cliques)} && stage == {number}) {name}(m, t, x, due, out);")
            tick_cliques.append(Clique(rates, tuple(stages)))
        self.define("outputs", "\n".join(["    (void)clique, (void)stage, (void)due;", *cases]))
        return tuple(tick_cliques)

    def stage(self, name: str, slots: Sequence[tuple[int, int]]) -> str:
        """The sampled outputs of one stage; others read the held value of one that is not due."""
        plan = self.plan
        program = tick_program(plan, sorted(slot for slot, _ in slots))
        scope = ProgramScope({}, {}, {}, False)
        self.seen_states = {}
        calls = self.calls_of(program, scope)
        nodes = [plan.held_nodes[slot][0] for slot, _ in slots]
        at = [self.all_places("d", slot) for slot, _ in slots]
        sinks = [self.sink(place, node, "keep") for place, node in zip(at, nodes, strict=True)]
        copies = self.attach(name, calls, nodes, sinks, scope)
        assert not copies
        self.guard_stage(calls, {node: rate for node, (_, rate) in zip(nodes, slots, strict=True)}, scope)
        return self.printed(name, calls, [])

    def guard_stage(self, calls: list[Call], rates: Mapping[Node, int], scope: ProgramScope) -> None:
        """Guard calls by the rates that need them. A sampled output is needed by its own rate only: where it is not
        due, others read its held value."""
        plan = self.plan
        producers = {value: call for call in calls for value in call.values}
        wanted: dict[Call, set[int]] = {call: set() for call in calls}
        fixed: dict[Call, int] = {}
        slot_of = {node: slot for slot, (node, _) in plan.held_nodes.items()}
        place = {value: slot_of[node] for node, value in scope.made.items() if node in rates}
        for node, rate in rates.items():
            fixed[producers[scope.made[node]]] = rate
        read = {index for call in calls for row, index in call.arguments if row in ("r", "ge")}
        for call in reversed(calls):
            call.guard = (fixed[call],) if call in fixed else tuple(sorted(wanted[call]))
            shown = call in fixed and any(value in read for value in call.values)
            if shown and all(value in place for value in call.values):
                call.fallback = [("d", place[value]) for value in call.values]
            for row, index in call.arguments:
                if row in ("r", "ge"):
                    wanted[producers[index]].update(call.guard)

    def prepare(self) -> None:
        """What is in q so far, and what it needs, each after what it needs."""
        self.is_in_prepare = True
        plan = self.plan
        depth: dict[tuple[int, int], int] = {}
        stack = [(instance, n) for instance, n in reversed(self.q) if isinstance(instance, int)]

        reads: dict[tuple[int, int], tuple[int, ...]] = {}  # by tape and node

        def before(key: tuple[int, int]) -> list[tuple[int, int]]:
            instance, n = key
            block = plan.instances[instance]
            tape, needed = block.tape, []
            if (id(tape), n) not in reads:
                reads[id(tape), n] = tape.arguments_of(n)
            for k in reads[id(tape), n]:
                reference: Reference | None = block.arguments[k]
                while reference is not None and reference.row == "w":
                    other = self.aliased(reference)
                    if other is None:
                        node = plan.outputs[reference.index]
                        needed.append((node.instance, self.tape_node(node)))
                    reference = other
            return needed

        while stack:
            key = stack[-1]
            if key in depth:
                stack.pop()
                continue
            needs = before(key)
            missing = [other for other in needs if other not in depth]
            if missing:
                stack += missing
                continue
            stack.pop()
            depth[key] = 1 + max((depth[other] for other in needs), default=-1)
            self.q.place(key, self.copies_of(key[0]))
        by_depth: dict[int, dict[int, list[int]]] = {}
        for (instance, n), level in depth.items():
            by_depth.setdefault(level, {}).setdefault(instance, []).append(n)
        bodies = []
        for level in sorted(by_depth):
            calls = []
            for instance, nodes in sorted(by_depth[level].items()):
                calls.append(self.prepared(instance, tuple(sorted(nodes))))
            name = f"prepare_{level}"
            body = self.printed(name, calls, [])
            self.texts.append(
                f"static void {name}({_SIGNATURE})\n{{\n    (void)m, (void)t, (void)x, (void)out;\n{body}\n}}\n"
            )
            bodies.append(f"    {name}(m, t, x, out);")
        copies = [Copy(("p", n), Sink(self.own_place(("p", n)))) for row, n in self.q if row == "p"]
        body = self.printed("prepare_copies", [], copies) if copies else ""
        if copies:
            self.texts.append(f"static void prepare_copied({_SIGNATURE})\n{{\n    (void)x, (void)t;\n{body}\n}}\n")
            bodies.append("    prepare_copied(m, t, x, out);")
        self.define("prepare", "\n".join(bodies))

    def prepared(self, instance: int, nodes: tuple[int, ...]) -> Call:
        """A call that computes nodes inside a type for q."""
        block = self.plan.instances[instance]
        tape = block.tape
        function = self.function(tape, nodes, None, f"{tape.name} fixed")
        scope = ProgramScope({}, {}, {})
        arguments = []
        for n in function.inputs:
            k = int(tape.nodes[n].value)
            arguments.append(self.value(block.arguments[k], scope, (instance, k)))
        lanes = self.copies_of(instance)
        sinks = [[Sink(self.q.place((instance, n), lanes))] for n in nodes]
        made = [self.new_value() for _ in nodes]
        return Call(function, block.path, instance, arguments, made, sinks, lanes=lanes)

    def own_place(self, key: Any) -> range | int:
        """The places in q or in v of something that is there: of a parameter, a node, a place of memory."""
        if isinstance(key, Node):
            return self.v.place(key, self.copies_of(key.instance))
        return (self.q if key[0] == "p" else self.v).place(key, self.lanes_of(*key))

    def slopes(self) -> str:
        """The Jacobian of the rates for a stiff method, and the order in which its columns are eliminated."""
        made = PlanJacobian(self.whole)
        sinks = list(map(Sink, self.side_by_side(made.probed)))
        self.define("slope_outputs", self.continuous("slope_outputs", made.probed, sinks))
        tell = ints if self.filled is None else self.filled.ints
        x_at = np.argsort(self.x_order).tolist()
        derived = jacobian_text(made, self.plan.table_places, x_at, "slope_outputs", is_square=True, ints=tell)
        order = elimination(*in_order(made, x_at)[:2])
        table, name = ("", "0") if order is None else (tell("elimination", order), "elimination")
        own = f"static const BlocksJacobian slopes = {derived.initializer};\n{table}#define ELIMINATION {name}\n"
        row = "" if self.filled is None else self.filled.text
        return f'\n#include "stiff.h"\n{row}{derived.text}{own}'

    def looked_at(self, name: str) -> str:
        """The tables of what is looked at inside a step: the states that it needs, and how else it moves."""
        motion = self.motions[name]
        states = sorted({*self.states_of[name], *self.states_of.get(f"{name}_phases", ())})
        self.states_of[name] = tuple(states)
        tables = [("int", "states", states), ("int", "histories", motion.histories)]
        if self.tells_bent(name):
            tables.append(("uint8_t", "bent", self.all_bent(name)))
        texts = [(kind, what, ", ".join(map(str, items)) or "0") for kind, what, items in tables]
        return "".join(f"static const {kind} {name}_{what}[] = {{{text}}};\n" for kind, what, text in texts)

    def all_bent(self, name: str) -> list[int]:
        """Whether each signal that is looked at is bent, in the whole diagram."""
        bent = self.motions[name].bent
        if name != "crossings":
            return list(map(int, bent))
        all_bent = [0] * len(self.whole.crossings)
        for own, is_bent in zip(self.spread([cause.instance for cause in self.plan.crossings]), bent, strict=True):
            for k in _listed(own):
                all_bent[k] = int(is_bent)
        return all_bent

    def tells_bent(self, name: str) -> bool:
        return name in ("crossings", "measured") and not self.motions[name].is_plain

    def looks(self) -> str:
        """What is looked at inside a step, in the order of runtime.h."""
        rows = []

        def of_blocks(asked: Sequence[Node | Reference]) -> list[Node]:
            return [item for item in asked if isinstance(item, Node)]

        for name, asked in self.watched.items():
            motion = self.motions[name]
            phases = f"{name}_phases" if motion.phases else "0"
            bent = f"{name}_bent" if self.tells_bent(name) else "0"
            counted = of_blocks(asked), motion.phases
            sizes = [sum(self.copies_of(node.instance) for node in nodes) for nodes in counted]
            sizes[0] += sum(isinstance(item, Reference) for item in asked)
            counts = f"{sizes[0]}, {sizes[1]}, {len(self.states_of[name])}, {len(motion.histories)}"
            places = f"{name}_states, {name}_histories, {bent}"
            rows.append(f"    {{{name}, {phases}, {counts}, {places}, {motion.checks(name)}}},\n")
        return f"\nstatic const BlocksLook looks[] = {{\n{''.join(rows)}}};\n"

    def finished(
        self, method: str, cliques: tuple[Clique, ...], moving: bool, slopes: str, end: str, quick: dict[str, int]
    ) -> Emitted:
        plan, own = self.whole, self.plan
        sizes = {
            "NX": len(plan.states), "ND": len(plan.discretes), "NS": len(plan.crossings), "NP": len(plan.parameters),
            "NU": sum(math.prod(shape) for _, shape, *_ in plan.inputs), "NH": len(plan.histories),
            "NZ": len(plan.unknowns), "NRATES": len(plan.rates), "NQ": self.q.size, "NV": self.v.size,
            "NN": len(self.numbers), "NC": sum(map(len, own.tables)), "NW": self.scratch, "NEVENTS": len(plan.events),
            "NLOGGED": len(self.watched["logged"]), "NMEASURED": len(self.watched["measured"]),
            "NREMEMBERED": len(plan.histories), "NPROJECTIONS": len(plan.projections), "MOVING_SIDES": int(moving),
            "BENT_SIDES": int(any(self.is_bent(cause.node) for cause in own.crossings)),
            "HAS_CORNERS": int(bool(plan.corners or plan.guessed)),
            "TURNING_ROWS": int(bool(self.motions["logged"].phases)),
        }  # fmt: skip
        sizes |= quick
        if plan.foreign:
            sizes |= {"NF": len(plan.foreign), "NTAKEN": sum(len(part.inputs) for part in plan.foreign)}
        states = [self.looked_at(name) for name in self.watched]
        sides = ", ".join(map(str, self.sides)) or "0"
        states += [f"static const int sides_at[] = {{{sides}}};\n"] if moving else []
        sizes["NLOGGED_STATES"] = len(self.states_of["logged"])
        macros = [f"#define BLOCKS_{name} {value}\n" for name, value in sizes.items()]
        methods = ("dopri5", "auto") if method == "auto" else (method if method in (*METHODS, *STIFF) else "none",)
        chosen = [f"METHOD_{name.upper()}" for name in methods]
        macros += [f"#define BLOCKS_{name} 1\n" for name in chosen]
        source = "".join([
            f"/* {comment(plan.name)} */\n", *macros, '\n#include "model.h"\n',
            '#include "fmu_bridge.h"\n' if plan.foreign else "", "\n", self.tables.text, *states, "\n",
            "\n".join(self.texts), self.looks(), slopes, '\n#include "steps.h"\n', end,
        ])  # fmt: skip
        table = tuple(value for values in own.tables for value in values)
        lanes = ""
        if self.lanes is not None:
            tables = self.tables.text + (states[-1] if moving else "")
            lanes = self.lanes.source(plan.name, sizes | dict.fromkeys(chosen, 1), tables)
        filled = b"" if self.filled is None else self.filled.values
        return Emitted(source, self.x_order, tuple(self.numbers), table, cliques, sizes, lanes, filled)
