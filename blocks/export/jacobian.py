"""Exact derivatives in C: what a PlanJacobian computes, as functions of partial derivatives and tables of sums."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..compile.c.functions import function_text
from ..compile.jacobian import PlanJacobian, Solve, Sum
from ..contract.tracing import jacobian
from .c_text import ints, reals, table

__all__ = ["JacobianText", "jacobian_text"]

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class JacobianText:
    """The text of what is static, and the initializer of an FmuJacobian."""

    text: str
    initializer: str


def jacobian_text(made: PlanJacobian, tables_at: Sequence[int]) -> JacobianText:
    """The C text of a Jacobian. tables_at: where each table of the plan begins in the row of tables."""
    texts, calls = [], []
    at = 0
    for number, group in enumerate(made.groups):
        tape = jacobian(group.tape, group.results, sorted(group.by))
        table_of = dict(zip((k for k, a in enumerate(tape.arguments) if a.kind == "table"), group.tables, strict=True))
        size = len(group.members)
        names, sizes, given, gathered = {}, {}, [], []
        needed = [n for n in tape.needed(group.results_at) if tape.nodes[n].op == "argument"]
        for n in needed:
            names[n] = f"a{n}_"
            argument = int(tape.nodes[n].value)
            if argument in table_of:
                where = table_of[argument][1]
                sizes[n] = tables_at[where + 1] - tables_at[where]
                given.append(f"tables + {tables_at[where]}")
        for k, n in enumerate(group.reads):
            gathered.append((n, f"a[gather[{at + k * size} + i]]"))
        at += size * len(group.reads)
        if not group.results_at:
            continue
        # In the order of `names`: tables and numbers as the function takes them.
        by_node = dict(gathered)
        tables_given = iter(given)
        arguments = [by_node[n] if n in by_node else next(tables_given) for n in names]
        name = f"partial_{number}"
        texts.append(function_text(name, tape, group.results_at, names, sizes, f"{tape.name} partials"))
        outs = [f"out + {group.first + k * size} + i" for k in range(len(group.results_at))]
        if len(outs) == 1:
            calls.append(
                f"    for (int i = 0; i < {size}; i++) out[{group.first} + i] = {name}({', '.join(arguments)});"
            )
        else:
            calls.append(f"    for (int i = 0; i < {size}; i++) {name}({', '.join([*arguments, *outs])});")
    texts.append(ints("gather", made.gather))
    texts.append(
        "static void partials(const double *a, const double *tables, double *out)\n{\n"
        f"    (void)a, (void)tables, (void)out, (void)gather;\n{chr(10).join(calls)}\n}}\n"
    )
    sums, most = [], 0
    for k, stage in enumerate(made.stages):
        text, row, size = _stage(k, stage)
        texts.append(text)
        sums.append(row)
        most = max(most, size)
    texts.append(table("FmuSum", "sums", sums))
    gates = {
        "off_partials": [(side, [*numbers]) for side, numbers in made.off_partials],
        "off": [(side, [i for i, is_in in enumerate(mask) if is_in]) for side, mask in made.off],
    }
    for name, parts in gates.items():
        structs = []
        for k, (side, entries) in enumerate(parts):
            texts.append(ints(f"{name}_{k}", entries))
            structs.append(f"{{{side}, {len(entries)}, {name}_{k}}}")
        texts.append(table("FmuOff", name, structs))
    texts.append(ints("unused", made.unused, "uint8_t"))
    texts.append(ints("first_value", made.indptr))
    texts.append(ints("value_rows", made.indices))
    texts.append(ints("value_entries", made.data_at))
    texts.append(reals("jacobian_numbers", made.numbers))
    rows, columns = made.shape
    fields = {
        "nrows": rows, "ncolumns": columns, "npartials": made.npartials, "nentries": made.nentries,
        "narguments": made.width, "nprobed": len(made.outputs), "nnumbers": len(made.numbers), "nsums": len(sums),
        "noff_partials": len(made.off_partials), "noff": len(made.off), "nmost": most, "numbers": "jacobian_numbers",
        "sums": "sums", "off_partials": "off_partials", "off": "off", "is_unused": "unused", "first": "first_value",
        "rows": "value_rows", "entries": "value_entries", "partials": "partials",
    }  # fmt: skip
    return JacobianText("".join(texts), "{" + ", ".join(f".{name} = {value}" for name, value in fields.items()) + "}")


def _stage(k: int, stage: Sum | Solve) -> tuple[str, str, int]:
    """The arrays of a stage, its row in the table of sums, and how many unknowns it has."""
    text = []

    def array(name: str, values: Array | None) -> str:
        if values is None:
            return "0"
        text.append(ints(f"{name}_{k}", values))
        return f"{name}_{k}"

    if isinstance(stage, Sum):
        fields = {
            "lo": stage.lo, "hi": stage.hi, "nterms": len(stage.partials), "starts": array("sum_starts", stage.starts),
            "partials": array("sum_partials", stage.partials), "sources": array("sum_sources", stage.sources),
        }  # fmt: skip
        size = 0
    else:
        size = len(stage.own)
        text.append(reals(f"loop_own_{k}", stage.own))
        places, partials, sources = stage.outer
        fields = {
            "is_loop": 1, "lo": stage.lo, "hi": stage.hi, "n": size, "nterms": len(places),
            "partials": array("loop_partials", partials), "sources": array("loop_sources", sources),
            "places": array("loop_places", places), "ninner": len(stage.inner[0]),
            "inner_places": array("inner_places", stage.inner[0]),
            "inner_partials": array("inner_partials", stage.inner[1]), "own": f"loop_own_{k}",
        }  # fmt: skip
    row = "{" + ", ".join(f".{name} = {value}" for name, value in fields.items()) + "}"
    return "".join(text), row, size
