"""`blocks linearize, blocks observer, blocks adrc-map`."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ..text.errors import AnalysisError, Fault, UsageError
from ..text.quantity_text import value_in
from .option_values import assignments, case_of, check_writable, look_of, number_of, raw_number
from .options import Verbs, takes_json, takes_library, takes_point, takes_several, takes_size
from .output import emit, printable, say

if TYPE_CHECKING:
    from ..api.case import Case
    from ..api.diagram import Diagram

FIGURES = ("bode", "nyquist", "nichols", "sigma", "step", "poles")


def add(verbs: Verbs) -> None:
    linear = verbs.add_parser(
        "linearize",
        help="linear model of a diagram: poles, zeros, margins",
        description="The linear model from one signal to another (--from, --to), or the loop transfer at a signal with "
        "its margins (--loop), in SI units. Signals: outputs (motor.omega), inputs of blocks (motor.v), inputs of the "
        "diagram, locals (eso.e).",
    )
    linear.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON)")
    takes_several(linear, "--from", "A", "an input of the transfer", dest="sources")
    takes_several(linear, "--to", "B", "an output of the transfer", dest="sinks")
    loop = "open the loop at this signal: L, with S = 1/(1 + L); several signals or a vector: margins of them together"
    takes_several(linear, "--loop", "POINT", loop, dest="loops")
    takes_several(linear, "--open", "C", "a signal to cut", dest="openings")
    pade = "replace delays by Padé models of this order; without it, margins of a loop use exact delays"
    linear.add_argument("--pade", metavar="N", type=int, default=0, help=pade)
    linear.add_argument("--plot", metavar="FILE", help="draw it: .svg, .png, .pdf")
    takes_size(linear)
    linear.add_argument(
        "--figure",
        choices=FIGURES,
        help="the figure of --plot (default bode, of several channels sigma); step of a loop shows the closed loop",
    )
    linear.set_defaults(verb=_linearize)

    observer = verbs.add_parser(
        "observer",
        help="poles, bandwidth and noise gain of an observer",
        description="Show how an extended state observer depends on the amplitude of its error: poles, the "
        "bandwidth from the total disturbance to its estimate, the noise gain.",
    )
    observer.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON)")
    observer.add_argument("block", metavar="BLOCK", help="the observer: control_right.eso")
    amplitudes = 'amplitudes of the error, such as 0.1 or "2 rpm" (default: 0.001 0.01 0.1 1)'
    observer.add_argument("--amplitudes", metavar="A", nargs="+", help=amplitudes)
    observer.set_defaults(verb=_observer)

    loop_map = verbs.add_parser(
        "adrc-map",
        help="margins, disturbance rejection and noise of a loop over two parameters",
        description="Margins, disturbance rejection and noise of a loop over one or two parameters, from matrices: the "
        "bandwidths of an ADRC, b0, a gain of the plant, or parameters of any other controller.",
    )
    loop_map.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON)")
    loop_map.add_argument("control", metavar="CONTROL", help="the signal at which the loop is opened: control.u")
    loop_map.add_argument("output", metavar="OUTPUT", help="what is controlled: plant.y")
    over = "a parameter and its range, or three or more values: control.omega_c=1,30"
    takes_several(loop_map, "--over", "NAME=LOW,HIGH", over)
    loop_map.add_argument("--points", metavar="N", type=int, default=60, help="values of each parameter (60)")
    loop_map.add_argument("--measurement", metavar="SIGNAL", default="", help="where noise enters (OUTPUT)")
    loop_map.add_argument("--disturbance", metavar="SIGNAL", default="", help="where the disturbance enters (CONTROL)")
    loop_map.add_argument("--frequency", metavar="W", type=float, help="rad/s: add the rejection at this frequency")
    limit = 'what is allowed: "Ms<1.6", "phase_deg>45"; the rest of the figure is shaded'
    takes_several(loop_map, "--limit", "MEASURE<X", limit)
    best = "print the point where this measure is best: the largest margin, the least of all others"
    loop_map.add_argument("--best", metavar="MEASURE", help=best)
    loop_map.add_argument("--pade", metavar="N", type=int, default=0, help="order of the Padé models of delays")
    loop_map.add_argument("--plot", metavar="FILE", help="draw it: .svg, .png, .pdf")
    loop_map.add_argument("-o", "--out", metavar="FILE", help="write all points as a table (.csv)")
    takes_size(loop_map)
    loop_map.set_defaults(verb=_map)
    override = "replace a block by a gain: q=1 makes a quantizer a unit gain; q=[[1,0],[0,1]] for several signals"
    for verb in (linear, loop_map):
        takes_several(verb, "--override", "BLOCK=GAIN", override, dest="overrides")
    for verb in (linear, observer, loop_map):
        takes_point(verb)
        takes_library(verb)
        takes_json(verb, "one JSON object")


def _overrides(options: argparse.Namespace) -> dict[str, object]:
    return {name: raw_number(v) for name, v in assignments("--override", options.overrides, "q=1").items()}


def _linearizer(options: argparse.Namespace) -> tuple[Diagram, Case, dict[str, Any]]:
    """Return the diagram, its case, and where it is linearized, as `Diagram.linearizer` takes them."""
    from ..api.diagram import Diagram

    diagram = Diagram.load(options.diagram, library=options.library)
    at = number_of("at", options.at)
    point: dict[str, object] = {"at": None if at is None else raw_number(at)}
    for word, items in (("amplitude", options.amplitude), ("sigma", options.sigma)):
        given = assignments(f"--{word}", items, "eso.e=0.1")
        point[word] = {name: v if isinstance(v, dict) else raw_number(v) for name, v in given.items()}
    inputs = {
        name: value if isinstance(value, (dict, bool)) else raw_number(value)
        for name, value in assignments("--input", options.input, "r=1").items()
    }
    return diagram, case_of(argparse.Namespace(**{**vars(options), "input": ()})).updated(inputs=inputs), point


def _linearize(options: argparse.Namespace) -> int:
    if options.plot:
        from ..results import plots

        check_writable("--plot", options.plot, [options.diagram])
        plots.check_format(options.plot)
    elif options.figure is not None:
        raise UsageError(Fault("E501", "--figure", "has no file to draw to.", "Add --plot FILE.svg."))
    look = look_of(options)
    if options.pade < 0:
        raise UsageError(Fault("E501", f"--pade {options.pade}", "is not an order of a Padé model.", "Use 1 to 10."))
    is_loop = bool(options.loops)
    if is_loop == bool(options.sources or options.sinks) or (not is_loop and not (options.sources and options.sinks)):
        cure = "Example: --from r --to motor.omega, or --loop control.u."
        raise UsageError(Fault("E501", "linearize", "needs either --from and --to, or --loop alone.", cure))
    diagram, case, point = _linearizer(options)
    linearizer = diagram.linearizer(case, overrides=_overrides(options), **point)
    if is_loop:
        model: Any = linearizer.exact_loop(options.loops, openings=options.openings, pade=options.pade)
    else:
        model = linearizer.transfer(options.sources, options.sinks, openings=options.openings, pade=options.pade)
    from ..analysis.model_text import check_loop, entry, figure, lines, margins_of

    if is_loop:
        check_loop(model, ", ".join(options.loops))
    known = margins_of(model) if is_loop else None
    if options.json:
        emit(entry(model, known))
    else:
        print(printable(diagram.name))
        for line in lines(model, known):
            print(printable(f"  {line}"))
    if options.plot:
        from ..results import plots

        plots.save(figure(model, options.figure or "", known, look), options.plot)
        say(f"figure in {options.plot}")
    return 0


def _observer(options: argparse.Namespace) -> int:
    from ..analysis.adrc_reports import AMPLITUDES, observer_report

    diagram, case, point = _linearizer(options)
    texts = [text for item in options.amplitudes or () for text in item.split(",") if text]
    given = [value_in(text) for text in texts] or AMPLITUDES
    report = observer_report(diagram, options.block, case, amplitudes=given, **point)
    if options.json:
        emit(report.as_json())
    else:
        print(printable(str(report)))
    return 0


def _map(options: argparse.Namespace) -> int:
    from ..analysis.loop_maps import extreme, loop_map
    from ..results import plots

    for word, place in (("--plot", options.plot), ("--out", options.out)):
        if place:
            check_writable(word, place, [options.diagram])
    if options.plot:
        plots.check_format(options.plot)
    if options.out and not options.out.endswith(".csv"):
        raise UsageError(Fault("E501", f"--out {options.out}", "is no table: its name ends with .csv."))
    look, limits = look_of(options), _limits(options.limit)
    diagram, case, point = _linearizer(options)
    found = loop_map(
        diagram, options.control, options.output, case, over=_ranges(options.over), points=options.points,
        measurement=options.measurement, disturbance=options.disturbance, frequency=options.frequency,
        pade=options.pade, overrides=_overrides(options), **point,
    )  # fmt: skip
    best: dict[str, float] = {}
    failure: AnalysisError | None = None
    try:
        best = found.best(options.best, **limits) if options.best else {}
    except AnalysisError as error:  # print and write the map first
        failure = error
    allowed = int(found.feasible(**limits).sum())
    if options.json:
        there = {name: x if math.isfinite(x) else None for name, x in found.at(best).items()} if best else {}
        emit({**found.as_json(), "allowed": allowed, **({"best": best, "there": there} if best else {})})
    else:
        print(printable(repr(found)))
        if limits:
            print(printable(f"  within {', '.join(options.limit)}: {allowed} points"))
        if best:
            place = ", ".join(f"{name} = {x:.6g}" for name, x in best.items())
            print(printable(f"  {extreme(options.best)} {options.best}: {place}"))
            print("  there: " + ", ".join(f"{name} = {x:.4g}" for name, x in found.at(best).items()))
    if options.out:
        found.to_csv(options.out)
        say(f"table in {options.out}")
    if options.plot:
        plots.save(found.plot(limits=limits or None, best=options.best, **look), options.plot)
        say(f"figure in {options.plot}")
    if failure is not None:
        raise failure
    return 0


def _ranges(items: Sequence[str]) -> dict[str, list[Any]]:
    ranges: dict[str, list[Any]] = {}
    if not items:
        raise UsageError(Fault("E501", "--over", "is missing.", "Example: --over control.omega_c=1,30."))
    for item in items:
        name, _, text = item.partition("=")
        if name.strip() in ranges:
            raise UsageError(Fault("E501", f"--over {item}", "gives this parameter a second time."))
        ranges[name.strip()] = values = [value_in(number) for number in text.split(",")]
        if any(isinstance(value, (str, bool, list)) for value in values):
            cure = "Example: --over control.omega_c=1,30."
            raise UsageError(Fault("E501", f"--over {item}", "is not NAME=LOW,HIGH.", cure))
    return ranges


def _limits(items: Sequence[str]) -> dict[str, tuple[float | None, float | None]]:
    limits: dict[str, tuple[float | None, float | None]] = {}
    for item in items:
        match = re.fullmatch(r"\s*(\w+)\s*([<>])=?\s*(\S+)\s*", item)
        try:
            name, sign, number = match.groups() if match else ("", "", "")
            value = float(number)
        except ValueError:
            cure = 'Example: --limit "Ms<1.6".'
            raise UsageError(Fault("E501", f"--limit {item}", "is not MEASURE<X or MEASURE>X.", cure)) from None
        low, high = limits.get(name, (None, None))
        limits[name] = (value, high) if sign == ">" else (low, value)
    return limits
