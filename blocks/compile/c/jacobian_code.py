"""Exact derivatives in C: what a PlanJacobian computes, as functions of partial derivatives and tables of sums."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...contract.tracing import jacobian
from ...text.arrays import Array
from ..fmu_tape import FmuTape
from ..jacobian import PlanJacobian, Solve, Sum
from .c_text import ints, reals, table
from .function_code import function_text


@dataclass(frozen=True)
class JacobianText:
    """The text of what is static, and the initializer of a BlocksJacobian."""

    text: str
    initializer: str


def jacobian_text(
    made: PlanJacobian,
    tables: Sequence[range],
    x_at: Sequence[int],
    outputs: str,
    *,
    is_square: bool = False,
    ints: Callable[..., str] = ints,
) -> JacobianText:
    """The C text of a Jacobian. tables: the places of each table of its plan. x_at: the place of each state in the
    model. outputs: the program that gives made.outputs. is_square: of rates by states, whose rows and columns stand in
    the order of the model. ints: how tables are told."""
    pattern = in_order(made, x_at) if is_square else (made.indptr, made.indices, np.arange(len(made.indices)))
    indptr, indices, order = pattern
    texts, calls = [], []
    at = 0
    for number, group in enumerate(made.groups):
        if isinstance(group.tape, FmuTape):  # known by difference quotients alone: see radau.c
            count = len(group.pairs) * len(group.members)
            calls.append(f"    for (int i = 0; i < {count}; i++) out[{group.first} + i] = NAN;")
            at += len(group.members) * len(group.reads)
            continue
        tape = jacobian(group.tape, group.results, sorted(group.by))
        table_of = dict(zip((k for k, a in enumerate(tape.arguments) if a.kind == "table"), group.tables, strict=True))
        size = len(group.members)
        names, sizes, given, gathered = {}, {}, [], []
        needed = [n for n in tape.needed(group.results_at) if tape.nodes[n].op == "argument"]
        for n in needed:
            names[n] = f"a{n}_"
            argument = int(tape.nodes[n].value)
            if argument in table_of:
                places = tables[table_of[argument][1]]
                sizes[n] = len(places)
                given.append(f"tables + {places.start}")
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
    gather = np.array(made.gather)
    is_state = gather < len(x_at)
    gather[is_state] = np.array(x_at, dtype=np.intp)[gather[is_state]]
    texts.append(ints("gather", gather))
    texts.append(
        "static void partials(const double *a, const double *tables, double *out)\n{\n"
        f"    (void)a, (void)tables, (void)out, (void)gather;\n{chr(10).join(calls)}\n}}\n"
    )
    sums, most = [], 0
    for k, stage in enumerate(made.stages):
        text, row, size = _stage(k, stage, ints)
        texts.append(text)
        sums.append(row)
        most = max(most, size)
    texts.append(table("BlocksSum", "sums", sums))
    gates: dict[str, list[tuple[int, Any]]] = {
        "off_partials": [(side, [*numbers]) for side, numbers in made.off_partials],
        "off": [(side, np.flatnonzero(mask[order])) for side, mask in made.off],
    }
    for name, parts in gates.items():
        structs = []
        for k, (side, entries) in enumerate(parts):
            texts.append(ints(f"{name}_{k}", entries))
            structs.append(f"{{{side}, {len(entries)}, {name}_{k}}}")
        texts.append(table("BlocksOff", name, structs))
    texts.append(ints("unused", made.unused, "uint8_t"))
    texts.append(ints("first_value", indptr))
    texts.append(ints("value_rows", indices))
    texts.append(ints("value_entries", made.data_at[order]))
    texts.append(reals("jacobian_numbers", made.numbers))
    rows, columns = made.shape
    fields = {
        "nrows": rows, "ncolumns": columns, "npartials": made.npartials, "nentries": made.nentries,
        "narguments": made.width, "nprobed": len(made.outputs), "nnumbers": len(made.numbers), "nsums": len(sums),
        "noff_partials": len(made.off_partials), "noff": len(made.off), "nmost": most, "numbers": "jacobian_numbers",
        "sums": "sums", "off_partials": "off_partials", "off": "off", "is_unused": "unused", "first": "first_value",
        "rows": "value_rows", "entries": "value_entries", "partials": "partials", "outputs": outputs,
    }  # fmt: skip
    return JacobianText("".join(texts), "{" + ", ".join(f".{name} = {value}" for name, value in fields.items()) + "}")


def in_order(made: PlanJacobian, x_at: Sequence[int]) -> tuple[Array, Array, Array]:
    """The pattern of rates by states (indptr, indices), where state i stands at x_at[i]; and where its values stand in
    made."""
    at = np.array(x_at, dtype=np.intp)
    columns, rows = at[np.repeat(np.arange(len(at)), np.diff(made.indptr))], at[made.indices]
    order = np.lexsort((rows, columns))
    return np.searchsorted(columns[order], np.arange(len(at) + 1)), rows[order], order


SPARSE_FROM, SPARSE_DENSITY = 24, 0.2
"""Elimination takes the pattern into account from so many states on, where no more of its entries differ from 0."""


def elimination(indptr: Array, indices: Array) -> Array | None:
    """The order in which columns of a matrix of this pattern are eliminated, so that little is filled in; None: by rows
    of a dense matrix, as it is small or nearly full."""
    n = len(indptr) - 1
    if n < SPARSE_FROM or len(indices) > SPARSE_DENSITY * n * n:
        return None
    from scipy.sparse import csc_matrix, identity
    from scipy.sparse.linalg import splu

    pattern = csc_matrix((np.full(len(indices), -1.0), indices, indptr), shape=(n, n))
    dominant = (pattern + 2.0 * n * identity(n)).tocsc()  # its pivots are its diagonal
    order: Array = splu(dominant, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0).perm_c
    return np.argsort(order)


def _stage(k: int, stage: Sum | Solve, ints: Callable[..., str]) -> tuple[str, str, int]:
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
