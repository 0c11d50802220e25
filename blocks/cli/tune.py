"""`blocks tune`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ..text.errors import Fault, UsageError
from ..text.printable import counted
from .apply import change_entry, change_line
from .option_values import as_options, case_of, check_writable, number_of
from .options import (
    Verbs,
    takes_engine,
    takes_inputs,
    takes_json,
    takes_library,
    takes_master,
    takes_parameters,
    takes_settings,
    takes_several,
    takes_trust,
    takes_variants,
    takes_work,
)
from .output import Progress, emit, printable, say, tell_faults
from .stop_signals import INTERRUPTED, ended_at_once
from .sweep import scenarios_of

if TYPE_CHECKING:
    from ..api.diagram import Diagram
    from ..studies.tuned import Tuning
    from ..studies.tuning import Problem


def add(verbs: Verbs) -> None:
    tune = verbs.add_parser(
        "tune",
        help="find values of parameters that minimize measures, under constraints, in several scenarios",
        description="Find the values within bounds that minimize an expression over measures and satisfy all "
        "constraints, by many runs. Put the name of a scenario before a measure: noisy.variation. ITAE "
        "alone is the mean over all scenarios, and a constraint on it must hold in each. Exit code 1 if a "
        "constraint is violated at the end.",
    )
    tune.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON)")
    tune.add_argument(
        "--minimize", metavar="EXPR", required=True, help='the expression over measures: "ITAE_right + 1e-3*ISU_right"'
    )
    over = "the bounds of a parameter, a pattern (control_*.eso.Ka) or an element (pid.k[0]); may be repeated"
    takes_several(tune, "--over", "NAME=LOW,HIGH", over, required=True)
    scenario = (
        "parameters under which every candidate runs: noisy:sigma=0.001,load=2; quiet: sets nothing; may be repeated"
    )
    takes_several(tune, "--scenario", "NAME:SETTINGS", scenario, dest="scenarios")
    takes_several(tune, "--subject-to", "CONSTRAINT", 'a limit such as "noisy.variation <= 75"; may be repeated')
    methods = "cma (CMA-ES; needs the package cma) or de (differential evolution); default: cma"
    tune.add_argument("--optimizer", metavar="M", default="cma", help=methods)
    tune.add_argument("--budget", metavar="N", default="500", help="number of candidates to run (default: 500)")
    tune.add_argument("--search-seed", metavar="N", default="1", help="seed of the optimizer (default: 1)")
    tune.add_argument("--write", action="store_true", help="write the values into DIAGRAM if all constraints hold")
    takes_work(tune, "candidates")
    tune.add_argument("--report", metavar="DIR", help="write report.html and its figures into a folder")
    takes_parameters(tune)
    takes_settings(tune)
    takes_inputs(tune, files=True)
    takes_master(tune)
    takes_engine(tune)
    takes_variants(tune)
    takes_trust(tune)
    takes_json(tune)
    tune.set_defaults(verb=_tune)
    takes_library(tune)


def _tune(options: argparse.Namespace) -> int:
    from ..api.case import Work
    from ..api.diagram import Diagram
    from ..results import plots
    from ..studies.sweep_file import check_target

    if options.out:
        check_writable("--out", options.out, [options.diagram])
        check_target(options.out)
    if options.report is not None:
        plots.check_loads()
    diagram = Diagram.load(options.diagram, library=options.library)
    places = {name: f"--{name}" for name in ("minimize", "method", "optimizer", "budget", "seed", "threads", "lanes")}
    places["search_seed"] = "--search-seed"
    places |= {f"subject_to[{k}]": f"--subject-to {text}" for k, text in enumerate(options.subject_to)}
    with as_options(places, {r'optimizer="(\w+)"': r"--optimizer \1"}):
        problem = _problem(options, diagram)
    tell_faults(problem.warnings, options.json)
    threads = None if options.threads is None else _whole("threads", options.threads)
    shown = Progress(options.json)

    def told(done: int, total: int) -> None:
        if done and shown.is_due() and not options.json:
            text = f"{done} of {total} candidates  {shown.left(done / total)}"
            shown.show(done / total, text, text)

    try:
        with as_options({}, {"restart=True, --restart": "--restart"}):
            tuning = problem.solve(Work(threads=threads, progress=told, out=options.out, restart=options.restart))
    finally:
        shown.clear()
    ended_at_once()
    return _told(options, tuning)


def _problem(options: argparse.Namespace, diagram: Diagram) -> Problem:
    from ..studies.tuning import problem_of

    return problem_of(
        diagram, case_of(options), minimize=options.minimize, over=_over(options.over),
        scenarios=scenarios_of(options.scenarios), subject_to=options.subject_to, optimizer=options.optimizer,
        budget=_whole("budget", options.budget), search_seed=_whole("search-seed", options.search_seed),
        lanes=options.lanes,
    )  # fmt: skip


def _told(options: argparse.Namespace, tuning: Tuning) -> int:
    """Report what was found, and write it; returns the exit code."""
    changes: Sequence[Any] = ()
    report = None if options.report is None else tuning.report(options.report)
    is_written = options.write and tuning.is_feasible and not (tuning.is_kept or tuning.interrupted)
    if is_written:
        changes = tuning.write(options.diagram).changes
    if options.json:
        for scenario, measure, before, after in tuning.rows():
            emit({"event": "measure", "scenario": scenario, "measure": measure, "before": before, "after": after})
        for change in changes:
            emit({"event": "change", **change_entry(change)})
        emit({
            "event": "done", "objective": tuning.objective, "before": tuning.objective_before,
            "values": dict(tuning.values), "feasible": tuning.is_feasible, "kept": tuning.is_kept,
            "candidates": tuning.ran, "interrupted": tuning.interrupted, "written": is_written,
            "report": None if report is None else str(report),
        })  # fmt: skip
    else:
        print(printable(tuning.head))
        print(printable(tuning.table()))
        if tuning.is_kept:
            print(printable(tuning.kept))
        for change in changes:
            print(printable(change_line(change)))
        if is_written and tuning.variants:
            choices = " ".join(f"--variant {path}={name}" for path, name in tuning.variants.items())
            print(printable(f"written for {choices}; the file keeps its own choice of variants"))
        if options.out:
            print(printable(f"{counted(len(tuning.history.objective), 'candidate')} in {options.out}"))
        if report is not None:
            print(printable(f"report: {report}"))
    if tuning.interrupted:
        unwritten = "; nothing was written, the values so far are in the table" if options.write else ""
        kept = f"; the same command goes on from {options.out}.part" if options.out else ""
        say(f"interrupted after {tuning.ran} of {tuning.budget} candidates{unwritten}{kept}")
        return INTERRUPTED
    if options.write and not is_written:
        say("nothing was written: " + ("constraints are violated" if not tuning.is_feasible else "the values are kept"))
    return 0 if tuning.is_feasible else 1


def _whole(option: str, text: str) -> int:
    number = number_of(option, text)
    if isinstance(number, dict) or not float(number).is_integer():
        raise UsageError(Fault("E501", f"--{option}", f"{text!r} is not an integer."))
    return int(number)


def _over(items: Sequence[str]) -> dict[str, tuple[Any, Any]]:
    over: dict[str, tuple[object, object]] = {}
    for item in items:
        name, bounds = _bounds(item)
        if name in over:
            raise UsageError(Fault("E501", f"--over {item}", "has bounds already.", "Give each name once."))
        over[name] = bounds
    return over


def _bounds(item: str) -> tuple[str, tuple[object, object]]:
    """NAME=LOW,HIGH."""
    from ..text.quantity_text import value_in

    name, separator, text = item.partition("=")
    try:
        low, high = (value_in(part) for part in text.split(","))
    except ValueError:
        low = high = ""
    are_numbers = not any(isinstance(bound, (str, bool, list)) for bound in (low, high))
    are_plain = isinstance(low, float) and isinstance(high, float)
    if not are_numbers or not separator or not name.strip() or (are_plain and not low < high):
        message = "is not NAME=LOW,HIGH, the lower bound first."
        raise UsageError(Fault("E501", f"--over {item}", message, 'Example: --over "kp=1,100".'))
    return name.strip(), (low, high)
