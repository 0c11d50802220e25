"""`blocks run`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from ..fmi.exits import telling
from ..host.gc_pause import paused
from ..text.errors import BlocksError, Fault, FMUError, UsageError
from ..text.printable import counted
from .option_values import as_options, case_of, check_writable, look_of
from .options import Verbs, takes_library, takes_profile, takes_run, takes_several, takes_trust, takes_variants
from .output import Progress, emit, printable, say, silence, tell_faults, waiting
from .stop_signals import INTERRUPTED, ended_at_once

if TYPE_CHECKING:
    from ..api.case import Case
    from ..api.diagram import Diagram
    from ..api.run import Run
    from ..results.results import Results

PRINTED = "rows on stdout"
LONG = 100_000  # rows that take a moment to write
MOST_SHOWN = 24  # signals of one figure; each may need a panel of its own
_OBSERVED = {word: f"--{word.replace('_', '-')}" for word in ("trace", "trace_file", "log_categories", "profile")}


def add(verbs: Verbs) -> None:
    run = verbs.add_parser("run", help="simulate a diagram", description="Simulate a diagram and print its signals.")
    run.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON)")
    takes_run(run)
    trace = "write all calls of this FMU to a file; may be repeated, and * means all FMUs"
    takes_several(run, "--trace", "FMU", trace)
    file = "the file of --trace: text, or .jsonl for JSON lines (default: DIAGRAM.trace.log)"
    run.add_argument("--trace-file", metavar="FILE", help=file)
    takes_profile(run)
    takes_variants(run)
    takes_trust(run)
    run.set_defaults(verb=run_diagram)
    takes_library(run)


def run_diagram(
    options: argparse.Namespace, made: Callable[[], Diagram] | None = None, *, is_chosen: bool | None = None
) -> int:
    """made: gives the diagram, which is no file then. is_chosen: whether --log chose what is recorded, if it may not
    be asked."""
    from ..api.case import sources
    from ..api.diagram import Diagram
    from ..results.arrow import target_of

    case = case_of(options)
    options.out = options.out or target_of(options.resume)
    progress = _Progress(options.json)
    with paused():  # nearly all objects that are made here stay
        with waiting(f"reading {options.diagram}", quiet=options.json):
            diagram = Diagram.load(options.diagram, library=options.library) if made is None else made()
        begun = time.perf_counter()
        _check_targets(options, [options.diagram, *(each for each in sources(case.inputs) if isinstance(each, str))])
        run = _started(options, diagram, progress, case)
    if run.settings.stop is None:
        raise UsageError(
            Fault("E501", diagram.name, "the run has no stop time.", 'Give --stop T, or "stop" in the file\'s "run".')
        )
    shown = _shown(options, run.plan, is_chosen=options.log is not None if is_chosen is None else is_chosen)
    for warning in run.plan.warnings:
        if warning.code != "W102":  # every state machine has some; `check` reports them
            say(str(warning))
    tell_faults(run.warnings, options.json)
    progress.span(run.t, float(run.settings.stop))
    failure: BlocksError | None = None

    def ended(error: FMUError) -> int:
        """Report that an FMU ends this process."""
        progress.clear()
        results = run.results
        if results.rows:
            rest = f" Results up to {results.span[1]:.10g} s are kept."
            error = FMUError(*(replace(fault, cure=fault.cure + rest) for fault in error.faults))
        return _concluded(options, run, results, shown, error, time.perf_counter() - begun, progress.told)

    try:
        with telling(ended):
            results = run.finish()
    except BlocksError as error:
        if getattr(error, "results", None) is None:
            raise
        failure, results = error, error.results  # type: ignore[attr-defined]
    finally:
        progress.clear()
    return _concluded(options, run, results, shown, failure, time.perf_counter() - begun, progress.told)


def _started(
    options: argparse.Namespace,
    diagram: Diagram,
    progress: _Progress,
    case: Case,
) -> Run:
    from ..api.diagram import run_of
    from ..api.preparing import longest_compilation
    from ..api.run import RunOptions
    from ..results.arrow import target_of

    word = "compiling: this happens the first time that a diagram runs"
    late = f"still preparing the run; a compiler that hangs is stopped after {longest_compilation():g} s"
    with waiting(word, late=late, quiet=options.json):
        given = RunOptions(
            progress=progress,
            notice=lambda fault: progress.tell(fault, options.json),
            resume=options.resume,
            loading=_name_fmus,
            out=None if options.out == "-" and not target_of(options.resume) else options.out,
            trace=options.trace,
            trace_file=options.trace_file,
            log_categories=[name.strip() for name in (options.log_categories or "").split(",") if name.strip()],
            profile=options.profile,
        )
        with as_options(_OBSERVED, {r"\bby trace\b": "by --trace"}):
            return run_of(diagram, case, given)


def _concluded(
    options: argparse.Namespace,
    run: Run,
    results: Results,
    shown: Sequence[str],
    failure: BlocksError | None,
    seconds: float,
    told: Sequence[Fault],
) -> int:
    """Write and report the results of a run; returns the exit code. told: the warnings that were printed already."""
    ended_at_once()
    if results.interrupted and options.out and results.rows > LONG:
        say(f"interrupted: writing {results.rows} rows to {options.out}; a second Ctrl-C loses them")
    written, refused = _written(options, run, results, shown, is_whole=failure is None)
    results = run.concluded(results)
    if run.trace_file is not None:
        written.append(f"trace of calls in {run.trace_file}")
    known = (*run.warnings, *run.plan.warnings, *told)
    tell_faults([warning for warning in results.warnings if warning not in known], options.json)
    if failure is not None:
        tell_faults(failure.faults, options.json)
    tell_faults(refused, options.json)
    _report(options, run, results, seconds, written)
    if refused:
        say(f"kept: {', '.join(written) or 'only the table'}")
    if failure is not None:
        return failure.exit_status
    if results.interrupted:
        state = options.save if options.save and not refused else run.part
        kept = f"; --resume {state} goes on from there" if state else ""
        say(f"interrupted at t = {run.t:.10g} s; the results up to this time are kept{kept}")
        return INTERRUPTED
    return UsageError.exit_status if refused else 0


def _name_fmus(value: Any) -> None:
    """Say which FMUs of the diagram lie in folders from which none was loaded before."""
    from ..api.preparing import new_folders

    new = (f"{', '.join(names)} of {folder}" for folder, names in new_folders(value).items())
    said = "; ".join(new)
    if said:
        say(f"loading FMUs from a folder for the first time: {said}")


def _written(
    options: argparse.Namespace, run: Run, results: Results, shown: Sequence[str], *, is_whole: bool
) -> tuple[list[str], list[Fault]]:
    """Write what was asked for, each file by itself: what was written, and the faults of the rest."""
    from ..results import plots

    t = results.span[1] if results.rows else run.t
    rows = f"{results.rows} rows in {options.out}"
    wanted: list[tuple[str, str, Callable[[], None]]] = []
    if options.save and is_whole:
        wanted.append((options.save, f"state at t = {t:g} s in {options.save}", lambda: run.save(options.save)))
    if options.out == "-":
        wanted.append(("stdout", PRINTED, lambda: _print_rows(results)))
    elif options.out:
        wanted.append((options.out, rows, lambda: run.keep(results)))
    if options.plot and results.rows:
        figure = partial(results.plot, *shown, most=len(shown), **look_of(options))
        wanted.append((options.plot, f"figure in {options.plot}", lambda: plots.save(figure(), options.plot)))
    written: list[str] = []
    refused: list[Fault] = []
    for place, what, write in wanted:
        try:
            write()
        except BlocksError as error:
            refused += error.faults
        except BrokenPipeError:  # `| head` has read enough
            silence(sys.stdout)
        except (OSError, MemoryError) as error:
            why = error.strerror if isinstance(error, OSError) else "there is not enough memory"
            refused.append(Fault("E501", place, f"cannot be written: {why or error}."))
            if place == "stdout":
                silence(sys.stdout)
        else:
            written.append(what)
    return written, refused


def _print_rows(results: Results) -> None:
    results.write_csv(sys.stdout)
    sys.stdout.flush()


def _check_targets(options: argparse.Namespace, read: list[str]) -> None:
    """Refuse places and formats before the run rather than after it. read: files that must not be replaced."""
    from ..results import plots
    from ..results.files import check_format

    if options.out and options.out != "-":
        check_writable("--out", options.out, read)
        check_format(options.out)
    if options.save:
        check_writable("--save", options.save, read)
    if options.trace_file:
        check_writable("--trace-file", options.trace_file, read)
    if options.plot:
        check_writable("--plot", options.plot, read)
        look_of(options)
        plots.check_format(options.plot)


def _shown(options: argparse.Namespace, plan: Any, *, is_chosen: bool) -> list[str]:
    """Return the elements that --plot draws: all of --log, or else the first four, of which inputs come last.

    Raises UsageError (E501).
    """
    if not options.plot:
        return []
    names: list[str] = []
    inputs = {name for name, *_ in plan.inputs}
    for name in plan.log if is_chosen else sorted(plan.log, key=inputs.__contains__):
        shape = plan.signal(name).shape
        names += [f"{name}[{i}]" for i in range(shape[0])] if shape else [name]
    place = f"--plot {options.plot}"
    if not names:
        raise UsageError(Fault("E501", place, "no signal is recorded.", "Choose signals: --log SIGNAL."))
    if not is_chosen:
        return names[:4]
    if len(names) > MOST_SHOWN:
        message = f"{len(names)} signals do not fit into one figure: the limit is {MOST_SHOWN}."
        raise UsageError(Fault("E501", place, message, "Choose fewer signals: --log SIGNAL."))
    return names


class _Progress:
    """How far a run is: its time, how it goes beside real time, and how long it will go on."""

    def __init__(self, quiet: bool) -> None:
        self.quiet, self.shown = quiet, Progress(quiet)
        self.start = self.stop = 0.0
        self.told: list[Fault] = []

    def tell(self, fault: Fault, as_json: bool) -> None:
        """Print a warning while the run goes on."""
        self.shown.clear()
        self.told.append(fault)
        tell_faults([fault], as_json)

    def span(self, start: float, stop: float) -> None:
        self.start, self.stop = start, stop
        self.shown = Progress(self.quiet)  # what it took to prepare the run is no measure of what is left

    def __call__(self, t: float, _: float) -> None:
        if self.stop <= self.start or not self.shown.is_due():
            return
        speed = (t - self.start) / self.shown.seconds
        share = (t - self.start) / (self.stop - self.start)
        left = self.shown.left(share)
        self.shown.show(share, f"t = {t:.4g} s  {speed:.3g}x real time  {left}", f"t = {t:.6g} s  {left}")

    def clear(self) -> None:
        self.shown.clear()


def _report(options: argparse.Namespace, run: Run, results: Results, seconds: float, written: Sequence[str]) -> None:
    statistics, settings = results.statistics, run.settings
    t = results.span[1] if results.rows else float(settings.start)
    if options.json:
        emit(
            {
                "event": "done",
                "t": t,
                "steps": statistics.steps,
                "rejected": statistics.rejected,
                "evaluations": statistics.evaluations,
                "events": len(results.events),
                "seconds": round(seconds, 6),
                "method": statistics.method,
                "engine": statistics.engine,
                "interrupted": results.interrupted,
                "ended": run.ended and run.ended.message,
                "signals": results.summary(),
                "measures": dict(results.measures),
                **({} if results.profile is None else {"profile": results.profile.entries()}),
            }
        )
        return
    # With `--out -` the results are what stdout is for.
    stream = sys.stderr if options.out == "-" else sys.stdout
    files = (f"  {what}" for what in written if what != PRINTED)
    lines = [*_report_lines(options, run, results, seconds, t), *files]
    print(printable("\n".join(lines)), file=stream)


def _report_lines(options: argparse.Namespace, run: Run, results: Results, seconds: float, t: float) -> Iterator[str]:
    from ..api.run import tolerances_of_fmus
    from ..results.results import measured

    statistics, settings = results.statistics, run.settings
    accuracy = (
        f"step {float(settings.step):g} s"
        if settings.step is not None
        else f"rtol {settings.rtol:g} atol {settings.atol:g}"
    )
    own = tolerances_of_fmus(run)
    if own is not None:  # the units of a master have methods of their own
        accuracy = settings.method if settings.is_fixed_step else f"{settings.method}, rtol {settings.rtol:g}"
        accuracy = f"({accuracy}; FMUs {', '.join(f'{value:g}' for value in own)})" if own else f"({accuracy})"
    begin = results.span[0] if options.resume and results.rows else float(settings.start)
    span = f"{begin:g} ... {t:g} s"
    joint = ", " if ":" in statistics.method else " "  # of auto, which tells what it has decided
    method = joint.join(filter(None, (statistics.method, accuracy)))
    yield f"{results.diagram}  {method}  {statistics.engine}  {span}"
    if run.given:
        yield "  set: " + ", ".join(f"{path} = {value}" for path, value in run.given.items())
    steps, events = counted(statistics.steps, "step"), counted(len(results.events), "event")
    yield f"done in {seconds:.2f} s: {steps}, {statistics.rejected} rejected, {events}"
    yield results.table()
    if results.measures:
        width = max(map(len, results.measures))
        yield "  measures"
        for name, value in results.measures.items():
            yield f"    {name.ljust(width)}  {measured(value)}"
    if results.profile is not None:
        yield f"  calls of FMUs, in {results.profile.seconds:.3g} s of the run"
        yield str(results.profile)
