"""`blocks compare`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..text.errors import Fault, UsageError
from ..text.printable import counted, quoted
from .option_values import number_of
from .options import Verbs, takes_json, takes_several
from .output import emit, printable

if TYPE_CHECKING:
    from ..results.results import Results


def add(verbs: Verbs) -> None:
    comparison = verbs.add_parser(
        "compare",
        help="compare two result files",
        description="Compare the signals that two result files (.csv, .parquet, .mat) have in common. Exit code 0 if "
        "all are within the tolerance, 1 if not. If the times differ, values between rows are interpolated linearly.",
    )
    comparison.add_argument("a", metavar="A", help="a result file; tolerances refer to the ranges of its signals")
    comparison.add_argument("b", metavar="B", help="the file to compare it with")
    comparison.add_argument(
        "--tolerance",
        metavar="X",
        help="the largest difference that passes, as a fraction of the signal's range in A (default 1e-06)",
    )
    comparison.add_argument(
        "--absolute", metavar="X", help="a difference up to this, in the signal's unit, passes as well (default 0)"
    )
    takes_several(
        comparison, "--rename", "NAME=OTHER", "a signal NAME of the first file is called OTHER in the second one"
    )
    takes_json(comparison)
    comparison.set_defaults(verb=_compare)


def _compare(options: argparse.Namespace) -> int:
    from ..results.comparison import TOLERANCE, compare
    from ..results.results import Results

    limits = {"tolerance": TOLERANCE, "absolute": 0.0}
    for name in limits:
        given = number_of(name, getattr(options, name))
        if isinstance(given, Mapping):
            raise UsageError(Fault("E501", f"--{name}", f"{getattr(options, name)!r} must be a number without a unit."))
        limits[name] = limits[name] if given is None else float(given)
    a, b = Results.load(options.a), Results.load(options.b)
    comparison = compare(a, b, **limits, names=_names(options.rename))
    if options.json:
        for difference in comparison.differences:
            emit(
                {
                    "event": "signal",
                    "signal": difference.name,
                    "unit": difference.unit,
                    "difference": difference.absolute,
                    "relative": difference.relative,
                    "t": difference.t,
                    "rmse": difference.rmse,
                    "fit": difference.fit,
                    "within": difference.is_within,
                }
            )
        emit(
            {
                "event": "done",
                "within": comparison.is_within,
                "beyond": len(comparison.beyond),
                "worst": comparison.worst.name,
                **limits,
                "start": comparison.start,
                "stop": comparison.stop,
                "times": comparison.rows,
                "interpolated": comparison.is_interpolated,
                "only_a": list(comparison.only_a),
                "only_b": list(comparison.only_b),
                "notes": list(comparison.notes),
            }
        )
    else:
        print(printable("\n".join(_comparison_lines(options, a, b, comparison))))
    return 0 if comparison.is_within else 1


def _names(pairs: Sequence[str]) -> dict[str, str]:
    """Return the names in the second file by those in the first one. Raises UsageError (E501)."""
    names = {}
    for pair in pairs:
        name, _, other = pair.partition("=")
        if not name or not other:
            fault = Fault("E501", "--rename", f"{quoted(pair)} is not a pair of names.", "Write motor.omega=speed.")
            raise UsageError(fault)
        names[name] = other
    return names


def _comparison_lines(options: argparse.Namespace, a: Results, b: Results, comparison: Any) -> Iterator[str]:
    for path, results in ((options.a, a), (options.b, b)):
        span = f"{results.t[0]:.10g} ... {results.t[-1]:.10g} s"
        yield f"{path}  {results.diagram}  {span}  {counted(len(results.t), 'row')}"
    if comparison.is_interpolated:
        span = f"{comparison.start:.10g} ... {comparison.stop:.10g} s"
        yield f"  the times differ: compared by linear interpolation at {counted(comparison.rows, 'time')} of {span}"
    yield from (f"  {note}" for note in comparison.notes)
    yield comparison.table()
    for path, names in ((options.a, comparison.only_a), (options.b, comparison.only_b)):
        if names:
            yield f"  only in {path}: {', '.join(names)}"
    total = counted(len(comparison.differences), "signal")
    limit = f"{comparison.tolerance:g} of the range in the first file"
    if comparison.is_within:
        yield f"{total} within {limit}"
    else:
        yield f"{len(comparison.beyond)} of {total} beyond {limit}; the worst is {comparison.worst.name}"
