"""`blocks compare`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from ..text.errors import Fault, UsageError
from .output import counted, emit, printable
from .values import number_of

if TYPE_CHECKING:
    from ..results.results import Results

__all__ = ["add"]


def add(verbs: Any) -> None:
    comparison = verbs.add_parser(
        "compare",
        help="compare two result files",
        description="Compare the signals that two result files (.csv, .parquet, .mat) have in common. Exit code 0 "
        "where all are within the tolerance, 1 where one is not. Where the times differ, rows are joined by lines.",
    )
    comparison.add_argument("a", metavar="A", help="a result file; ranges are those of its signals")
    comparison.add_argument("b", metavar="B", help="another one")
    comparison.add_argument(
        "--tolerance", metavar="X", help="how far a signal may be off, as a part of its range in A (default 1e-06)"
    )
    comparison.add_argument(
        "--absolute", metavar="X", help="a difference up to this, in the signal's unit, passes as well (default 0)"
    )
    comparison.add_argument("--json", action="store_true", help="one JSON object per line")
    comparison.set_defaults(verb=_compare)


def _compare(options: argparse.Namespace) -> int:
    from ..results.compare import TOLERANCE, compare
    from ..results.results import Results

    limits = {"tolerance": TOLERANCE, "absolute": 0.0}
    for name in limits:
        given = number_of(name, getattr(options, name))
        if isinstance(given, Mapping):
            raise UsageError(Fault("E501", f"--{name}", f"{getattr(options, name)!r} is not a number without unit."))
        limits[name] = limits[name] if given is None else float(given)
    a, b = Results.load(options.a), Results.load(options.b)
    made = compare(a, b, **limits)
    if options.json:
        for one in made.differences:
            emit(
                {
                    "event": "signal",
                    "signal": one.name,
                    "unit": one.unit,
                    "difference": one.absolute,
                    "relative": one.relative,
                    "t": one.t,
                    "within": one.is_within,
                }
            )
        emit(
            {
                "event": "done",
                "within": made.is_within,
                "beyond": len(made.beyond),
                "worst": made.worst.name,
                **limits,
                "start": made.start,
                "stop": made.stop,
                "times": made.rows,
                "interpolated": made.is_interpolated,
                "only_a": list(made.only_a),
                "only_b": list(made.only_b),
                "notes": list(made.notes),
            }
        )
    else:
        print(printable("\n".join(_comparison_lines(options, a, b, made))))
    return 0 if made.is_within else 1


def _comparison_lines(options: argparse.Namespace, a: Results, b: Results, made: Any) -> Iterator[str]:
    for path, one in ((options.a, a), (options.b, b)):
        span = f"{one.t[0]:.10g} ... {one.t[-1]:.10g} s"
        yield f"{path}  {one.diagram}  {span}  {counted(len(one.t), 'row')}"
    if made.is_interpolated:
        span = f"{made.start:.10g} ... {made.stop:.10g} s"
        yield f"  the times differ: compared by lines between rows at {counted(made.rows, 'time')} of {span}"
    yield from (f"  {note}" for note in made.notes)
    yield made.table()
    for path, names in ((options.a, made.only_a), (options.b, made.only_b)):
        if names:
            yield f"  only in {path}: {', '.join(names)}"
    total, limit = counted(len(made.differences), "signal"), f"{made.tolerance:g} of the range in A"
    if made.is_within:
        yield f"{total} within {limit}"
    else:
        yield f"{len(made.beyond)} of {total} beyond {limit}, most of all {made.worst.name}"
