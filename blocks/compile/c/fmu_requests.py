"""Functions in C that ask an FMU for some of its results."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ...fmi.types import code_of
from ..fmu_tape import FmuTape, Request
from .function_code import number

KINDS = ("state", "derivative", "indicator", "value", "event_time", "given", "number", "partial")

def request_text(name: str, tape: FmuTape, request: Request) -> str:
    """A function of the FMU's number, time and the needed values."""
    first, total = dict[int, int](), 0
    variables = []
    for item in request.items:
        if item.variable is not None and id(item.variable) not in first:
            first[id(item.variable)] = total
            size = math.prod(item.variable.shape)
            variables.append((item.variable.reference, code_of(item.variable.type, tape.opaque.fmi), total, size, 0))
            total += size
    items = []
    for item in request.items:
        index = item.index
        if item.variable is not None:
            index += first[id(item.variable)]
        elif item.kind == "given":
            index -= 1
        by = -1
        if item.of is not None:  # the item that is derived, and the input
            index = request.items.index(item.of)
            by = next(k for k, (argument, *_) in enumerate(tape.opaque.inputs) if argument == item.index)
        items.append((KINDS.index(item.kind), index, by, number(item.scale), number(item.offset)))
    kinds = sum(1 << kind for kind in {kind for kind, *_ in items})
    states = [n for place, k in request.states for n in (place - 1, k)]
    inputs = [n for place, k in request.inputs for n in (place - 1, k)]
    taken = [f"double a{k}" for k in range(len(request.arguments))] + [f"double *r{k}" for k in range(len(items))]
    given = ", ".join(f"a{k}" for k in range(1, len(request.arguments))) or "0.0"
    sizes = (len(request.states), len(request.inputs), len(variables), len(items), kinds)
    places = f"{name}_states, {name}_inputs, {name}_variables, {name}_items"
    lines = [
        f"static const int {name}_states[] = {_list(states)}, {name}_inputs[] = {_list(inputs)};",
        f"static const BlocksVariable {name}_variables[] = {_rows(variables, '{0, 0, 0, 0, 0}')};",
        f"static const BlocksItem {name}_items[] = {_rows(items, '{0, 0, 0, 0.0, 0.0}')};",
        f"static const BlocksRequest {name}_request = {{{', '.join(map(str, sizes))}, {places}}};",
        f"static void {name}(const BlocksMemory *m, int unit, {', '.join(taken)})",
        "{",
        f"    const double given[] = {{{given}}};",
        f"    double made[{len(items)}];",
        f"    blocks_foreign_values(((BlocksForeigns *)m->f)->units + unit, &{name}_request, a0, given, made);",
        *(f"    *r{k} = made[{k}];" for k in range(len(items))),
        "}",
    ]
    return "\n".join(lines) + "\n"


def _list(values: Sequence[int]) -> str:
    return f"{{{', '.join(map(str, values)) or '0'}}}"


def _rows(rows: Sequence[Sequence[object]], nothing: str) -> str:
    text = ", ".join(f"{{{', '.join(map(str, row))}}}" for row in rows)
    return f"{{{text or nothing}}}"
