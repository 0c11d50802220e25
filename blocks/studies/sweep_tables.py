"""Tables of a sweep for reports and papers: measures by scenario, or by the values of parameters."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..text.arrays import Array
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.printable import as_markdown, legible
from .statistics import quantiles

Sweep = Any  # a `Sweep`, whose module calls this one
Cell = str | float
_TEX = {**{c: f"\\{c}" for c in "&%$#_{}"}, "~": r"\textasciitilde{}", "^": r"\^{}", "\\": r"\textbackslash{}",
        "<": r"\textless{}", ">": r"\textgreater{}", "≤": r"$\le$", "≥": r"$\ge$", "∞": r"$\infty$",
        "✓": r"$\surd$", "✗": r"$\times$", "·": r"$\cdot$"}  # fmt: skip


def table(sweep: Sweep, by: str | Sequence[str], q: Sequence[float]) -> list[list[Cell]]:
    """The head and the rows of a table: texts, and numbers. Arguments as of `Sweep.markdown`."""
    names = [by] if isinstance(by, str) else [str(name) for name in by]
    for name in names:
        if name not in sweep.varied:
            cure = did_you_mean(name[:200], sweep.varied) or f"Varied: {', '.join(sweep.varied)}."
            raise UsageError(Fault("E501", legible(name), "is not a varied parameter of the sweep.", cure))
    return [*(_by_values(sweep, names) if names else _by_measure(sweep, np.asarray(q, dtype=float)))]


def _by_measure(sweep: Sweep, q: Array) -> Iterator[list[Cell]]:
    first = ["scenario"] if sweep.scenarios else []
    yield [*first, "measure", "unit", "mean", *(f"{100 * level:g} %" for level in q), "runs", "without"]
    for scenario, part in sweep.each_scenario():
        for name, values in part.measures.items():
            known = values[~np.isnan(values)]
            with np.errstate(invalid="ignore"):  # inf beside -inf
                mean = float(known.mean()) if len(known) else np.nan
            levels = quantiles(values, q).tolist()
            counts = f"{len(values)}", f"{len(values) - len(known)}"
            yield [*([scenario] if first else []), name, sweep.units.get(name, ""), mean, *levels, *counts]


def _by_values(sweep: Sweep, names: Sequence[str]) -> Iterator[list[Cell]]:
    first = ["scenario"] if sweep.scenarios else []
    yield [*first, *(_with_unit(sweep, name) for name in (*names, *sweep.measures)), "runs", "failed", "without"]
    for scenario, part in sweep.each_scenario():
        groups: dict[tuple[Any, ...], list[int]] = {}
        for i, values in enumerate(zip(*(part.varied[name].tolist() for name in names), strict=True)):
            groups.setdefault(tuple(v if isinstance(v, float) else str(v) for v in values), []).append(i)
        for values, rows in sorted(groups.items()) if _are_sortable(groups) else groups.items():
            medians = [float(quantiles(column[rows], np.array([0.5]))[0]) for column in part.measures.values()]
            failed = int(np.count_nonzero(part.status[rows] != "ok"))
            # A run may reach its end where a measure has no number, as margins of a loop that is unstable.
            missing = np.any([np.isnan(column[rows]) for column in part.measures.values()], axis=0)
            counts = f"{len(rows)}", f"{failed}", f"{np.count_nonzero(missing)}"
            yield [*([scenario] if first else []), *values, *medians, *counts]


def _are_sortable(groups: dict[tuple[Any, ...], list[int]]) -> bool:
    return len({tuple(map(type, values)) for values in groups}) == 1


def _with_unit(sweep: Sweep, name: str) -> str:
    return f"{name} [{sweep.units[name]}]" if sweep.units.get(name) else name


def markdown(sweep: Sweep, by: str | Sequence[str], q: Sequence[float]) -> str:
    rows = table(sweep, by, q)
    return as_markdown([[*map(cell_text, row)] for row in rows], rights=_number_columns(rows))


def latex(sweep: Sweep, by: str | Sequence[str], q: Sequence[float]) -> str:
    return tabular(table(sweep, by, q))


def _number_columns(rows: Sequence[Sequence[Cell]]) -> list[int]:
    """Return the places of the columns that hold numbers only, below the head."""
    head, *others = rows
    return [k for k in range(len(head)) if all(not isinstance(row[k], str) or str(row[k]).isdigit() for row in others)]


def tabular(rows: Sequence[Sequence[Cell]]) -> str:
    """A head and rows as a tabular of LaTeX, with the rules of the package booktabs; numbers stand to the right."""
    rights = _number_columns(rows)
    sides = "".join("r" if k in rights else "l" for k in range(len(rows[0])))
    lines = [f"{' & '.join(map(_tex, row))} \\\\" for row in rows]
    # A bracket or a star behind \\ would be its argument.
    first, *rest = [f"{{}}{line}" if line[0] in "[*" else line for line in lines]
    return "\n".join([rf"\begin{{tabular}}{{{sides}}}", r"\toprule", first, r"\midrule", *rest, r"\bottomrule",
                      r"\end{tabular}"])  # fmt: skip


def cell_text(cell: Cell) -> str:
    """A cell as a text."""
    if isinstance(cell, str):
        return "".join(c if c.isprintable() else "\ufffd" for c in cell)
    return "-" if np.isnan(cell) else ("∞" if cell > 0 else "-∞") if np.isinf(cell) else f"{cell:.5g}"


def _tex(cell: Cell) -> str:
    if isinstance(cell, str):
        return "".join(_TEX.get(c, c) for c in cell_text(cell))
    text = cell_text(cell)
    power = re.fullmatch(r"(.*)e([-+])0*(\d+)", text)
    if power is not None:
        sign = "-" if power[2] == "-" else ""
        return rf"${power[1]} \cdot 10^{{{sign}{power[3]}}}$"
    text = text.replace("∞", r"\infty")
    return f"${text}$" if text == r"\infty" or (text.startswith("-") and text != "-") else text
