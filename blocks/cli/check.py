"""`blocks check`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from functools import partial

from ..text.errors import Fault
from ..text.printable import counted
from .option_values import variants_of
from .options import Verbs, takes_json, takes_library, takes_variants
from .output import emit, fault_entry, fault_lines, printable


def add(verbs: Verbs) -> None:
    check = verbs.add_parser(
        "check",
        help="find all static faults of a diagram",
        description="Check diagrams: all faults, the order of execution, rates, loops. Of a study: the faults of its "
        "file, of its diagrams, and of the measures, signals and parameters that the study uses.",
    )
    check.add_argument(
        "files", metavar="FILE", nargs="+", help="a diagram file (JSON) or a study; several may be given"
    )
    takes_variants(check)
    takes_json(check)
    check.set_defaults(verb=_check)
    takes_library(check)


def _check(options: argparse.Namespace) -> int:
    statuses = []
    for path in options.files:
        if len(options.files) > 1 and not options.json:
            print(printable(path))
        statuses.append(_check_file(path, options))
    return max(statuses)


def _check_file(path: str, options: argparse.Namespace) -> int:
    from ..api.checked import checked

    findings = checked(path, library=options.library, variants=partial(variants_of, options.variants))
    if not findings.is_diagram:
        status = _check_study(path, options)
        if status is not None:
            return status
    of_fmus = tuple(fault for fmu in findings.fmus for fault in fmu.faults)
    status = 2 if any(not fault.is_warning for fault in findings.faults) else 0
    status = status or (4 if any(not fault.is_warning for fault in of_fmus) else 0)
    head = ""
    if findings.blocks is not None:
        head = f"{findings.name}: {counted(findings.blocks, 'block')}"
        head += f" ({counted(len(findings.fmus), 'FMU')})" if findings.fmus else ""
        head += f", {counted(findings.wires, 'wire')}" if findings.wires is not None else ""
    if findings.states is not None:
        rates = f"{counted(len(findings.rates), 'rate')} ({', '.join(findings.rates)})"
        head += f", {counted(findings.states, 'state')}, {rates}"
    if options.json:
        for fmu in findings.fmus:
            emit(fmu.entry())
    told = (*findings.faults, *of_fmus, *findings.untrusted)
    lines = [head, *(line for fmu in findings.fmus for line in fmu.lines())]
    _tell(path, options, lines, told, () if options.json else findings.order())
    return status


def _tell(
    path: str, options: argparse.Namespace, first: Sequence[str], faults: Sequence[Fault], last: Iterable[str] = ()
) -> None:
    """Print what was found in a file. first: headline, "" for none, and lines above the faults; last: lines below."""
    errors = sum(not fault.is_warning for fault in faults)
    if options.json:
        for fault in faults:
            emit(fault_entry(fault, path))
        emit({"event": "done", "file": path, "errors": errors, "warnings": len(faults) - errors})
        return
    if first[0]:
        print(printable(first[0]))
    for line in (*first[1:], *fault_lines(faults, sys.stdout), *last):
        print(printable(f"  {line}"))
    print(f"{counted(errors, 'error')}, {counted(len(faults) - errors, 'warning')}")


def _check_study(path: str, options: argparse.Namespace) -> int | None:
    """Check a study and return its exit code, or None if the file is no study."""
    from ..studies import study

    loaded, faults = study.checked(path, library=options.library)
    if loaded is None and any(fault.code == "E006" and fault.path == ("format",) for fault in faults):
        return None
    head = ""
    if loaded is not None:
        parts = (("sweep", loaded.sweeps), ("tuning", loaded.tunings))
        many = "".join(f"{counted(len(entries), word)}, " for word, entries in parts if entries)
        head = f"{loaded.name}: {counted(len(loaded.runs), 'run')}, {many}{counted(len(loaded.claims), 'claim')}"
    _tell(path, options, [head], faults)
    return 2 if faults else 0
