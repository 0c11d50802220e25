"""What a linear model says of its diagram: how each block came into it, and which laws are in the way."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..text.arrays import Array
from .nonlinearities import StaticLaw, nonlinear
from .replaced_slopes import ReplacedSlopes, is_of_one_signal

_CHANGES = 0.05
"""A slope that changes by more within ten times the distance from a singular point is one of this distance."""


@dataclass(frozen=True, slots=True)
class BlockReport:
    """How one block came into a linear model.

    method: "exact", "directional derivatives", "central differences of two steps", "describing function, A = ...",
    "override", "a Padé model of order 3, ...". smoothness: "smooth", or what its equations are at the point ("infinite
    slope of g by e", ...). contributes: whether a change can pass through it from the inputs to the outputs. note: what
    else a reader should know: a law that bends and was given no amplitude beside others that were; a state that does
    not rest.
    """

    path: str
    type: str
    method: str
    smoothness: str
    contributes: bool
    note: str = ""


def report_of(replaced: ReplacedSlopes, kept: Array) -> tuple[BlockReport, ...]:
    """How each block came into a model. kept: which variables contribute to it."""
    graph = replaced.graph
    method: dict[int, list[str]] = {}
    for (node, _), text in replaced.described.items():
        method.setdefault(graph.nodes[node][0], []).append(text)
    rough: dict[int, list[str]] = {}
    for law in replaced.slopes.laws:
        rough.setdefault(graph.nodes[law.node][0], []).append(f"{law.kind} of {law.equation} by {law.by}")
    passes = {graph.nodes[n][0] for n, v in enumerate(graph.variable.tolist()) if v >= 0 and kept[v]}
    notes = _notes(replaced, kept, passes)
    reports = []
    for i, instance in enumerate(graph.plan.instances):
        if instance.hidden:
            continue
        how = "; ".join(dict.fromkeys(method.get(i, ()))) or replaced.slopes.methods.get(i, "exact")
        how = "override" if i in replaced.overridden else how
        kind = instance.tape.name
        text, note = "; ".join(rough.get(i, ())) or "smooth", "; ".join(notes.get(i, ()))
        reports.append(BlockReport(instance.path, kind, how, text, i in passes, note))
    return tuple(reports)


def _notes(replaced: ReplacedSlopes, kept: Array, passes: set[int]) -> dict[int, list[str]]:
    """What a reader should know of the blocks on the way, by instance.

    They are laws that bend but have a slope at the point, beside others whose amplitude was given: with an amplitude of
    their own they would have another slope; laws near a point where their slope is infinite; and states that move,
    where something on the way is not linear.
    """
    graph, notes = replaced.graph, dict[int, list[str]]()
    is_bent, laws = False, {(law.node, law.slot) for law in replaced.slopes.laws}
    for node in np.nonzero(graph.variable >= 0)[0].tolist():
        i, key, element = graph.nodes[node]
        if i not in passes or i in replaced.overridden:  # a slope of 0 lets nothing pass, and may be another one
            continue
        for slot in nonlinear(graph, node):
            column = int(graph.selects[slot])
            if (node, slot) in replaced.described or column < 0:
                continue
            is_on_way = bool(kept[graph.variable[node]] and kept[column])
            is_bent = is_bent or is_on_way
            if is_on_way and (node, slot) not in laws and (text := _near_singular(replaced, node, slot)):
                notes.setdefault(i, []).append(text)
            if replaced.described and (key, element) in graph.type_of[i].bends:
                path = f"{graph.plan.instances[i].path}."
                name, by = graph.node_name(node).removeprefix(path), graph.slot_name(slot).removeprefix(path)
                value = replaced.slopes.everything_of(slot)
                notes.setdefault(i, []).append(
                    f"{name} is nonlinear too, and works at {by} = {value:g}: give its amplitude"
                )
    if is_bent:
        point, plan = replaced.slopes.point, graph.plan
        owner = [node.instance for node in plan.derivatives]
        for k, rate in enumerate(point.rates):
            size = max(plan.nominal[k], abs(point.memory[1][k]))
            if kept[graph.first["x"] + k] and abs(rate) > 1e-6 * size:
                name = plan.states[k].removeprefix(f"{plan.instances[owner[k]].path}.")
                notes.setdefault(owner[k], []).append(f"not at rest: {name} changes by {rate:.3g} a second")
    return notes


def _near_singular(replaced: ReplacedSlopes, node: int, slot: int) -> str:
    """Return a note on a law whose slope at the point is that of its distance from a singular point; "" for others."""
    graph = replaced.graph
    if nonlinear(graph, node)[slot] != {slot}:
        return ""
    law = StaticLaw(replaced.slopes, node, [slot])
    found = law.singular()
    if found is None or abs(found[1]) <= _CHANGES:
        return ""
    (point, change), read = found, graph.slot_name(slot)
    by, name = read.removeprefix(f"{law.path}."), law.name.removeprefix(f"{law.path}.")
    more = f"{abs(change):.0%} {'more' if change > 0 else 'less'}"
    return (
        f"the slope of {name} holds only at {by} = {law.inputs[0]:g}, near {by} = {point:g}, where it is "
        f"infinite: at ten times the distance it is {more}. For its describing function give "
        f'amplitude={{"{read}": A}}, --amplitude {read}=A'
    )


def hints_of(
    replaced: ReplacedSlopes, report: Sequence[BlockReport], nodes: Mapping[int, Sequence[int]]
) -> tuple[str, tuple[BlockReport, ...]]:
    """What to ask for where laws on the way pass nothing on, and the report with notes on these.

    nodes: those laws with their slots.
    """
    graph, notes, hints = replaced.graph, dict[str, str](), dict[str, list[str]]()

    def hint(text: str) -> None:
        hints.setdefault(re.sub(r"\[[0-9]+\](?=\.)", "", text), []).append(text)

    for node, slots in nodes.items():
        path, name = graph.plan.instances[graph.nodes[node][0]].path, graph.node_name(node)
        for slot in slots:
            read = graph.slot_name(slot)
            at = graph.entry_of.get((node, slot))
            slope = replaced.extra.get((node, slot), 0.0) if at is None else replaced.data[at]
            if slope != 0.0 or nonlinear(graph, node)[slot] != {slot}:
                continue
            if (node, slot) in replaced.described:
                hint(f"The gain of {name} is 0 at the amplitude given for {read}: give a larger amplitude.")
                continue
            value = replaced.slopes.everything_of(slot)
            notes[path] = f"passes nothing on at its operating point, {read.removeprefix(f'{path}.')} = {value:g}"
            how = f'its describing function, amplitude={{"{read}": A}} or --amplitude {read}=A'
            if is_of_one_signal(graph, graph.nodes[node][0]):
                how = f'a gain in its place, overrides={{"{path}": 1.0}} or --override {path}=1, or {how}'
            hint(f"{name} passes nothing on at its operating point: use {how}.")
    noted = tuple(replace(block, note=notes.get(block.path, block.note)) for block in report)
    told = ((texts[0], len({*texts}) - 1) for texts in hints.values())
    return " ".join(f"{text} The same holds for {more:,} more copies." if more else text for text, more in told), noted
