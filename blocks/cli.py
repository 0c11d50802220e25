"""The command `blocks`: run, study, compare, check, draw, list, export, fmu, doctor.

Data go to stdout; progress and diagnostics to stderr. Exit codes: 0 fine; 1 ran, but a claim or tolerance failed;
2 model or usage error; 3 numerical failure, 4 FMU failure and 130 interrupted (partial results are kept).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import re
import shlex
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import AnalysisError, BlocksError, Fault, UsageError, did_you_mean

if TYPE_CHECKING:
    from .api import Diagram
    from .foreign import Found
    from .plan import Plan
    from .results import Results

__all__ = ["main"]

INTERRUPTED = 130
FIGURES = ("bode", "nyquist", "nichols", "step", "poles")
MOST_SHOWN = 24  # signals of one figure; each may need a panel of its own


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    for stream in (sys.stdout, sys.stderr):
        # Consoles that cannot show a character show a stand-in rather than end the run.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    options = _parser().parse_args(arguments)
    try:
        with warnings.catch_warnings():
            # What the engines have to say (that there is no compiler) is for whoever runs the command.
            warnings.showwarning = lambda message, *_: _say(f"warning: {message}")
            return int(options.verb(options))
    except BlocksError as error:
        _tell_faults(error.faults, getattr(options, "json", False))
        return error.exit_status
    except BrokenPipeError:
        # The reader of our output went away (`| head`); nobody is left to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        _say("interrupted")
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    from . import __version__

    parser = argparse.ArgumentParser(prog="blocks", description="Simulate and check block diagrams of control systems.")
    parser.add_argument("--version", action="version", version=f"blocks {__version__}")
    verbs = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    run = verbs.add_parser("run", help="simulate a diagram", description="Simulate a diagram and print its signals.")
    run.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON)")
    _takes_run(run)
    _takes_variants(run)
    _takes_trust(run)
    run.set_defaults(verb=_run)

    study = verbs.add_parser(
        "study",
        help="compare runs with published numbers",
        description="Run a study: tables, figures, one report. Exit code 1 where a verdict is not the expected one.",
    )
    study.add_argument("study", metavar="STUDY", help="a study file (JSON)")
    study.add_argument("--out", metavar="DIR", help="folder for report.html and the figures (default: out/NAME)")
    study.add_argument(
        "--set",
        metavar="RUN.NAME=VALUE",
        action="append",
        default=[],
        dest="parameters",
        help="a parameter of one run: IADRC.torque=2",
    )
    _takes_trust(study)
    study.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    study.add_argument("--json", action="store_true", help="one JSON object per line")
    study.set_defaults(verb=_study)

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

    check = verbs.add_parser(
        "check",
        help="find all static faults of a diagram",
        description="Check a diagram: all faults, the order of execution, rates, loops.",
    )
    check.add_argument("diagram", metavar="DIAGRAM")
    _takes_variants(check)
    check.add_argument("--json", action="store_true", help="one JSON object per line")
    check.set_defaults(verb=_check)

    drawing = verbs.add_parser(
        "draw", help="draw a diagram as SVG", description="Draw a diagram as SVG, with its faults marked on the blocks."
    )
    drawing.add_argument("diagram", metavar="DIAGRAM")
    drawing.add_argument("-o", "--out", metavar="FILE.svg", help="where to write it (default: stdout)")
    drawing.add_argument("--depth", metavar="N", type=int, default=1, help="levels of subdiagrams to show (default 1)")
    _takes_variants(drawing)
    drawing.set_defaults(verb=_draw)

    listing = verbs.add_parser(
        "list",
        help="list the block library, or tell about one block",
        description="List the block types, or one type's ports and parameters.",
    )
    listing.add_argument("block", metavar="BLOCK", nargs="?", help="a block type, an FMU, or `measures`")
    listing.add_argument("--json", action="store_true", help="one JSON object per line")
    listing.set_defaults(verb=_list)

    export = verbs.add_parser(
        "export",
        help="make an FMU of a diagram, or of one block",
        description="Write a diagram, or one block of the library, as an FMU, which needs no Python where it runs.",
    )
    export.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON), or the name of a block type")
    export.add_argument("-o", "--out", metavar="X.fmu", required=True, help="where to write it")
    export.add_argument("--name", metavar="N", default="", help="of the model (default: that of the diagram)")
    export.add_argument("--fmi", metavar="2|3", type=int, default=3, help="the version of FMI (default 3)")
    export.add_argument(
        "--kind",
        metavar="CS|ME",
        type=str.upper,
        action="append",
        dest="kinds",
        help="Co-Simulation or Model Exchange, again for both (default: all that the diagram allows)",
    )
    export.add_argument(
        "--platform",
        metavar="P",
        action="append",
        dest="platforms",
        help="x86_64-linux, aarch64-linux, x86_64-windows, x86_64-darwin or aarch64-darwin, again for more; "
        "none: sources only (default: this machine's)",
    )
    export.add_argument("--method", metavar="M", help="dopri5, rk4 or euler, of Co-Simulation")
    export.add_argument("--step", metavar="H", help="step in s of rk4 and euler")
    export.add_argument("--rtol", metavar="R", help="relative tolerance of dopri5")
    export.add_argument("--atol", metavar="A", help="absolute tolerance of dopri5")
    export.add_argument(
        "--log",
        metavar="SIGNAL",
        action="append",
        help="show this signal (again for more) in place of the file's choice",
    )
    _takes_parameters(export)
    _takes_variants(export)
    export.add_argument("--json", action="store_true", help="one JSON object")
    export.set_defaults(verb=_export)

    fmu = verbs.add_parser("fmu", help="tell about an FMU, run it, or compile its sources")
    parts = fmu.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for what, title, text in (
        ("info", "tell what is inside an FMU", "Tell what is inside an FMU. Nothing is unpacked or loaded."),
        (
            "check",
            "tell whether an FMU would run here",
            "Tell whether an FMU would run here, and why not. Nothing is unpacked or loaded. Exit code 4 where it "
            "cannot.",
        ),
    ):
        part = parts.add_parser(what, help=title, description=text)
        part.add_argument("fmu", metavar="X.fmu")
        if what == "info":
            part.add_argument("--all", action="store_true", help="all variables (30 of a group are shown)")
        part.add_argument("--json", action="store_true", help="one JSON object")
        part.set_defaults(verb=_fmu, what=what)
    alone = parts.add_parser(
        "run",
        help="run an FMU by itself",
        description="Run an FMU by itself, as a diagram of one block: its inputs and outputs are those of the diagram. "
        "This runs its code.",
    )
    alone.add_argument("fmu", metavar="X.fmu")
    alone.add_argument(
        "--kind",
        metavar="CS|ME",
        type=str.upper,
        help="Co-Simulation or Model Exchange (default: CS where it has both)",
    )
    alone.add_argument("--isolate", action="store_true", help="run it in a process of its own")
    _takes_run(alone)
    alone.set_defaults(verb=_run_fmu, library=[])
    compiling = parts.add_parser(
        "compile",
        help="compile the C sources in an FMU for this machine",
        description="Compile the C sources that an FMU carries and put the binary into it. The file is replaced as a "
        "whole.",
    )
    compiling.add_argument("fmu", metavar="X.fmu")
    compiling.add_argument("-o", "--out", metavar="Y.fmu", help="where to write it (default: in its own place)")
    compiling.add_argument(
        "--platform",
        metavar="P",
        action="append",
        dest="platforms",
        help="x86_64-linux, aarch64-linux, x86_64-windows, ..., again for more (default: this machine's)",
    )
    compiling.add_argument("--json", action="store_true", help="one JSON object")
    compiling.set_defaults(verb=_compile)

    linear = verbs.add_parser(
        "linearize",
        help="linear model of a diagram: poles, zeros, margins",
        description="The linear model from one signal to another (--from, --to), or the loop transfer at a signal with "
        "its margins (--loop), in SI units. Signals: outputs (motor.omega), inputs of blocks (motor.v), inputs of the "
        "diagram, locals (eso.e).",
    )
    linear.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON)")
    linear.add_argument(
        "--from", metavar="A", action="append", default=[], dest="sources", help="where a change is put in"
    )
    linear.add_argument("--to", metavar="B", action="append", default=[], dest="sinks", help="what is looked at")
    linear.add_argument("--loop", metavar="POINT", help="open the loop at this signal: L, with S = 1/(1 + L)")
    linear.add_argument(
        "--open", metavar="C", action="append", default=[], dest="openings", help="a signal that is cut"
    )
    linear.add_argument("--pade", metavar="N", type=int, default=0, help="order of the models of exact delays")
    linear.add_argument("--plot", metavar="FILE", help="draw it: .svg, .png, .pdf")
    linear.add_argument(
        "--figure", choices=FIGURES, help="what --plot draws (default bode); step of a loop: of the closed one"
    )
    linear.set_defaults(verb=_linearize)

    observer = verbs.add_parser(
        "observer",
        help="poles, bandwidth and noise gain of an observer",
        description="What an extended state observer does, against the amplitude of its error: poles, the bandwidth "
        "from the total disturbance to its estimate, the noise gain.",
    )
    observer.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON)")
    observer.add_argument("block", metavar="BLOCK", help="the observer: control_right.eso")
    observer.add_argument(
        "--amplitudes", metavar="A", nargs="+", help="of its error, in SI (default: 0.001 0.01 0.1 1)"
    )
    observer.set_defaults(verb=_observer)
    for verb in (linear, observer):
        _takes_point(verb)
        verb.add_argument("--json", action="store_true", help="one JSON object")

    doctor = verbs.add_parser(
        "doctor",
        help="tell what there is to run diagrams with",
        description="Tell versions, the C compiler and whether it works, which engine is taken, and the cache of "
        "compiled code. Exit code 2 where there is a compiler, or CC is set, and it does not work.",
    )
    doctor.add_argument("--clear-cache", action="store_true", help="empty the cache of compiled code, and nothing else")
    doctor.add_argument("--json", action="store_true", help="one JSON object per line")
    doctor.set_defaults(verb=_doctor)
    for verb in (run, study, check, drawing, listing, export, linear, observer):
        verb.add_argument(
            "--library", metavar="MODULE", action="append", default=[], help="a Python module with blocks of your own"
        )
    return parser


def _takes_run(run: argparse.ArgumentParser) -> None:
    run.add_argument("--stop", metavar="T", help="stop time in s")
    run.add_argument("--start", metavar="T", help="start time in s")
    run.add_argument("--method", metavar="M", help="dopri5, rk4, euler or radau")
    run.add_argument("--step", metavar="H", help="step in s of rk4 and euler")
    run.add_argument("--rtol", metavar="R", help="relative tolerance of dopri5 and radau")
    run.add_argument("--atol", metavar="A", help="absolute tolerance of dopri5 and radau")
    run.add_argument("--every", metavar="T", help="recording grid in s (without one: every step)")
    _takes_parameters(run)
    run.add_argument(
        "--input",
        metavar="FILE.csv|NAME=VALUE",
        action="append",
        default=[],
        help="inputs over time (columns time,NAME,...), or one constant input; again for more",
    )
    run.add_argument("--hold", action="store_true", help="hold the values of --input instead of joining them by lines")
    run.add_argument(
        "--log",
        metavar="SIGNAL",
        action="append",
        help="record this signal (again for more) in place of the file's choice",
    )
    run.add_argument(
        "--master",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="a setting of the master: step=0.001, steps.motor=0.002, algorithm=gauss-seidel, order=2, tolerance=1e-6, "
        "couple=each, iterations=50; again for more",
    )
    run.add_argument(
        "-o", "--out", metavar="FILE", help="write the recorded signals: .csv, .parquet, .mat; - for stdout"
    )
    run.add_argument(
        "--plot", metavar="FILE", help="draw the first four signals, or those of --log, over time: .svg, .png, .pdf"
    )
    run.add_argument("--save", metavar="STATE", help="write the state at the stop, from which --resume goes on")
    run.add_argument("--resume", metavar="STATE", help="go on from a state that --save wrote")
    run.add_argument(
        "--engine", metavar="E", choices=("auto", "native", "reference"), help="auto (the default), native or reference"
    )
    run.add_argument("--json", action="store_true", help="one JSON object per line")


def _takes_variants(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "--variant",
        metavar="BLOCK=NAME",
        action="append",
        default=[],
        dest="variants",
        help="what stands in the place of a block that has variants: motor=fmu; motor=base for the block itself",
    )


def _takes_point(verb: argparse.ArgumentParser) -> None:
    """Where a diagram is linearized."""
    verb.add_argument("--at", metavar="T", help="as a run stands at this time in s (default: the start)")
    verb.add_argument(
        "--input",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        dest="held",
        help="the value of an input of the diagram (default: its own, or 0)",
    )
    for option, what in (("amplitude", "amplitude of a sine"), ("sigma", "deviation of a random signal")):
        verb.add_argument(
            f"--{option}",
            metavar="SIGNAL=X",
            action="append",
            default=[],
            help=f"{what} at a law without slope, whose describing function is taken: eso.e=0.1",
        )
    _takes_parameters(verb)
    _takes_variants(verb)
    _takes_trust(verb)


def _takes_trust(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "--trust",
        metavar="PATH",
        action="append",
        default=[],
        help="an FMU, or a folder of FMUs, outside of the project that may run; again for more",
    )


def _takes_parameters(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "--set",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        dest="parameters",
        help='a parameter by its path, maybe with a unit: torque=2, or "motor.Ra=200 mOhm"',
    )


def _say(text: str) -> None:
    print(_printable(text), file=sys.stderr)


def _tell_faults(faults: Sequence[Fault], as_json: bool) -> None:
    """Faults as text on stderr; with --json also as objects on stdout, where a program looks for them."""
    for fault in faults:
        _say(str(fault))
        if as_json:
            _emit(_fault_entry(fault))


def _fault_entry(fault: Fault) -> dict[str, Any]:
    return {
        "event": "fault",
        "code": fault.code,
        "place": fault.place,
        "message": fault.message,
        "cure": fault.cure,
        "file": fault.file,
        "line": fault.line,
        "column": fault.column,
    }


def _printable(text: str) -> str:
    """Names from files may hold control characters, which a terminal would obey."""
    return "".join(c if c.isprintable() or c == "\n" else f"\\x{ord(c):02x}" for c in text)


def _emit(entry: Mapping[str, Any]) -> None:
    print(json.dumps(_finite(entry)), flush=True)


def _finite(value: Any) -> Any:
    """JSON knows neither NaN nor infinity: null stands for them."""
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


# --- blocks run ------------------------------------------------------------------------------------------------

_QUANTITY = re.compile(r"\s*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*(\S.*?)?\s*\Z")


def _value(text: str) -> Any:
    """The value of --set: a number, a number with a unit, true, false, a JSON list, or a text."""
    from .jsontext import Number, read

    match = _QUANTITY.match(text)
    if match:
        number = Number(_json_number(match[1]))
        return {"value": number, "unit": match[2]} if match[2] else number
    if text in ("true", "false"):
        return text == "true"
    if text.startswith("["):
        return read(text, file="--set").value
    return text


def _json_number(text: str) -> str:
    """A number as people write it (+1, .5, 1., 007) in JSON's spelling."""
    sign = "-" if text.startswith("-") else ""
    mantissa, _, exponent = text.lstrip("+-").lower().partition("e")
    whole, _, fraction = mantissa.partition(".")
    return f"{sign}{whole.lstrip('0') or '0'}{'.' + fraction if fraction else ''}{'e' + exponent if exponent else ''}"


def _number(option: str, text: str | None) -> Any:
    if text is None:
        return None
    value = _value(text)
    if isinstance(value, (str, bool, list)):
        raise UsageError(Fault("E501", f"--{option}", f"{text!r} is not a number."))
    return value


def _assignments(option: str, items: Sequence[str], example: str) -> dict[str, Any]:
    """NAME=VALUE options as values by name."""
    made: dict[str, Any] = {}
    for item in items:
        name, separator, text = item.partition("=")
        if not separator or not name.strip():
            raise UsageError(Fault("E501", f"{option} {item}", "is not NAME=VALUE.", f'As in {option} "{example}".'))
        if name.strip() in made:
            raise UsageError(Fault("E501", f"{option} {item}", f"gives {name.strip()} a second value."))
        made[name.strip()] = _value(text)
    return made


def _master(items: Sequence[str]) -> dict[str, Any] | None:
    """The --master options as the object that a file has; None where there is none."""
    made: dict[str, Any] = {}
    for key, value in _assignments("--master", items, "step=0.001").items():
        first, separator, block = key.partition(".")
        if not separator:
            made[key] = value
        elif first == "steps":
            made.setdefault("steps", {})[block] = value
        else:
            message, cure = "is not known.", "A step of one block is steps.BLOCK=0.001."
            raise UsageError(Fault("E501", f"--master {key}", message, cure))
    return made or None


def _fmu(options: argparse.Namespace) -> int:
    from .fmi.telling import tell

    told = tell(options.fmu)
    if options.json:
        _emit({"event": "fmu", **told.entry()})
    else:
        print(_printable(told.info(everything=options.all) if options.what == "info" else told.check()))
    return 4 if options.what == "check" and told.errors else 0


def _compile(options: argparse.Namespace) -> int:
    from .export.compiled import compile_sources

    out = options.out or options.fmu
    _check_writable("-o" if options.out else "X.fmu", out, [])
    made = compile_sources(options.fmu, out, platforms=options.platforms)
    if options.json:
        _emit({"event": "compiled", "path": str(made.path), "binaries": list(made.binaries), "notes": list(made.notes)})
    else:
        print(_printable(str(made)))
    return 0


def _run_fmu(options: argparse.Namespace) -> int:
    """An FMU as a diagram of one block; what it says of times and steps holds unless the command says otherwise."""
    from .api import Diagram
    from .imported import fmu

    block = fmu(options.fmu, options.kind, isolate=options.isolate)
    diagram = Diagram.alone(block)
    foreign = type(block).declaration.foreign
    experiment = foreign.description.experiment
    settings = {"start": experiment.start, "stop": experiment.stop}
    if foreign.kind == "ME":
        settings["rtol"] = experiment.tolerance
    settings |= {"master": {"step": experiment.step}} if foreign.kind == "CS" and experiment.step else {}
    diagram.settings(**{key: value for key, value in settings.items() if value is not None})
    # A parameter of the only block goes without the block's name as well.
    known, name = type(block).declaration.parameters, next(iter(diagram.value.blocks))
    options.parameters = [
        f"{name}.{item}" if item.partition("=")[0].strip() in known else item for item in options.parameters
    ]
    options.diagram, options.variants, options.trust = options.fmu, [], []
    return _run(options, diagram)


def _export(options: argparse.Namespace) -> int:
    from .api import Diagram, library_types
    from .native.platforms import PLATFORMS, this_platform

    parameters = _assignments("--set", options.parameters, "motor.Ra=200 mOhm")
    settings: dict[str, Any] = {key: _number(key, getattr(options, key)) for key in ("step", "rtol", "atol")}
    settings = {key: value for key, value in settings.items() if value is not None}
    settings |= {key: value for key, value in (("method", options.method), ("log", options.log)) if value}
    types = library_types(options.library)
    if options.diagram in types and not os.path.exists(options.diagram):
        block: Any = types[options.diagram]
        diagram, parameters = Diagram.alone(block(**parameters)), {}  # they fix its ports, too
    elif options.diagram.isidentifier() and not os.path.exists(options.diagram):
        cure = did_you_mean(options.diagram, types) or "`blocks list` names the block types."
        raise UsageError(Fault("E103", options.diagram, "there is no such diagram file, and no such block type.", cure))
    else:
        diagram = Diagram.load(options.diagram, library=options.library)
    _check_writable("-o", options.out, [options.diagram])
    platforms = [name for name in options.platforms or () if name != "none"] if options.platforms else None
    others = [name for name in platforms or () if name in PLATFORMS and name != this_platform()]
    if others and not options.json:
        _say(f"building for {', '.join(others)}: the first time, a platform takes a minute or two")
    made = diagram.export(
        options.out,
        fmi=options.fmi,
        kinds=options.kinds,
        platforms=platforms,
        name=options.name,
        parameters=parameters,
        variants=_variants(options.variants),
        **settings,
    )
    if options.json:
        _emit({"event": "exported", **asdict(made), "path": str(made.path), "bytes": made.path.stat().st_size})
    else:
        print(_printable(str(made)))
    return 0


def _variants(items: Sequence[str]) -> dict[str, str]:
    """The --variant options: names of variants by block path."""
    made: dict[str, str] = {}
    for item in items:
        path, separator, name = (part.strip() for part in item.partition("="))
        if not (separator and path and name):
            raise UsageError(Fault("E501", f"--variant {item}", "is not BLOCK=NAME.", "As in --variant motor=fmu."))
        if path in made:
            raise UsageError(Fault("E501", f"--variant {item}", f"chooses a second one for {path}."))
        made[path] = name
    return made


def _run(options: argparse.Namespace, diagram: Diagram | None = None) -> int:
    from . import plots
    from .api import Diagram

    parameters = _assignments("--set", options.parameters, "motor.Ra=200 mOhm")
    constants = [item for item in options.input if "=" in item and not os.path.exists(item)]
    inputs: list[Any] = [item for item in options.input if item not in constants]
    inputs.append(_assignments("--input", constants, "r=1.5 rad/s"))
    settings = {key: _number(key, getattr(options, key)) for key in ("stop", "start", "step", "rtol", "atol", "every")}
    settings |= {"method": options.method, "log": options.log, "master": _master(options.master)}
    diagram = diagram or Diagram.load(options.diagram, library=options.library)
    begun = time.perf_counter()
    _check_targets(options, [options.diagram, *inputs[:-1]])
    progress = _Progress(options.json)
    with _preparing(options.json):
        run = diagram.start(
            inputs=inputs,
            parameters=parameters,
            interpolation="hold" if options.hold else "linear",
            progress=progress,
            resume=options.resume,
            engine=options.engine,
            variants=_variants(options.variants),
            trust=options.trust,
            **settings,
        )
    if run.settings.stop is None:
        raise UsageError(
            Fault("E501", diagram.name, "the run has no end.", 'Give --stop T, or "stop" in the file\'s "run".')
        )
    shown = _shown(options, run.plan)
    for warning in run.plan.warnings:
        if warning.code != "W102":  # every state machine has some; `check` tells them
            _say(str(warning))
    progress.span(run.t, float(run.settings.stop))
    failure: BlocksError | None = None
    try:
        results = run.finish()
    except BlocksError as error:
        if getattr(error, "results", None) is None:
            raise
        failure, results = error, error.results  # type: ignore[attr-defined]
    finally:
        progress.clear()
    if options.save and failure is None:
        run.save(options.save)
    if options.out == "-":
        results.write_csv(sys.stdout)
    elif options.out:
        results.save(options.out)
    if options.plot and len(results.t):
        plots.save(results.plot(*shown, most=len(shown)), options.plot)
    _tell_faults(results.warnings, options.json)
    if failure is not None:
        _tell_faults(failure.faults, options.json)
    _report(options, run, results, time.perf_counter() - begun)
    if failure is not None:
        return failure.exit_status
    if results.interrupted:
        kept = f"; --resume {options.save} goes on from there" if options.save else ""
        _say(f"interrupted at t = {run.t:.10g} s; what was computed up to there is kept{kept}")
        return INTERRUPTED
    return 0


def _check_targets(options: argparse.Namespace, read: list[str]) -> None:
    """Refuse places and formats before the run rather than after it. read: files that must not be replaced."""
    from . import plots, resultfiles

    if options.out and options.out != "-":
        _check_writable("--out", options.out, read)
        resultfiles.check_format(options.out)
    if options.save:
        _check_writable("--save", options.save, read)
    if options.plot:
        _check_writable("--plot", options.plot, read)
        plots.check_format(options.plot)


def _check_writable(option: str, path: str, read: Sequence[str]) -> None:
    folder = os.path.dirname(path) or "."
    if os.path.exists(path) and not os.path.isfile(path):
        what = "is no ordinary file; - stands for stdout"
    elif os.path.exists(path) and any(os.path.exists(other) and os.path.samefile(path, other) for other in read):
        what = "is a file that this run reads"
    elif not os.path.isdir(folder) or not os.access(folder, os.W_OK):
        what = f"the folder {folder} cannot be written to"
    else:
        return
    raise UsageError(Fault("E501", f"{option} {path}", f"{what}.", "Nothing was run."))


def _shown(options: argparse.Namespace, plan: Any) -> list[str]:
    """The elements that --plot draws: the first four, or all of --log. Raises UsageError (E501)."""
    if not options.plot:
        return []
    names: list[str] = []
    for name in plan.log:
        shape = plan.signal(name).shape
        names += [f"{name}[{i}]" for i in range(shape[0])] if shape else [name]
    place = f"--plot {options.plot}"
    if not names:
        raise UsageError(Fault("E501", place, "no signal is recorded.", "Choose some: --log SIGNAL."))
    if options.log is None:
        return names[:4]
    if len(names) > MOST_SHOWN:
        message = f"{len(names)} signals are more than {MOST_SHOWN} in one figure."
        raise UsageError(Fault("E501", place, message, "Choose fewer: --log SIGNAL."))
    return names


@contextlib.contextmanager
def _preparing(quiet: bool) -> Iterator[None]:
    """On a terminal, a word where a run takes long to begin."""
    said = threading.Timer(0.7, _say, ("compiling: a diagram is compiled the first time that it runs",))
    said.daemon = True
    if sys.stderr.isatty() and not quiet:
        said.start()
    try:
        yield
    finally:
        said.cancel()


class _Progress:
    """A bar on stderr where it is a terminal and the run takes more than half a second; else a line per 10 %."""

    def __init__(self, quiet: bool) -> None:
        self.terminal = sys.stderr.isatty()
        self.quiet = quiet
        self.begun = self.shown = self.said = time.perf_counter()
        self.tenth = 0
        self.start = self.stop = 0.0
        self.drawn = False

    def span(self, start: float, stop: float) -> None:
        self.start, self.stop = start, stop

    def __call__(self, t: float) -> None:
        now = time.perf_counter()
        if now - self.shown < 0.1 or now - self.begun < 0.5 or self.stop <= self.start:
            return
        self.shown = now
        share = (t - self.start) / (self.stop - self.start)
        if self.terminal and not self.quiet:
            bar = "█" * int(30 * share) + "░" * (30 - int(30 * share))
            speed = (t - self.start) / (now - self.begun)
            print(
                f"\r {bar} {share:4.0%}  t = {t:.4g} s  {speed:.3g}x real time  [Ctrl-C keeps what is there]\x1b[K",
                end="",
                file=sys.stderr,
                flush=True,
            )
            self.drawn = True
        elif int(10 * share) > self.tenth or now - self.said > 10:
            self.tenth, self.said = int(10 * share), now
            _say(f"{int(100 * share)} %  t = {t:.6g} s")

    def clear(self) -> None:
        if self.drawn:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def _report(options: argparse.Namespace, run: Any, results: Results, seconds: float) -> None:
    statistics, settings = results.statistics, run.settings
    t = float(results.t[-1]) if len(results.t) else float(settings.start)
    if options.json:
        _emit(
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
                "signals": results.summary(),
                "measures": dict(results.measures),
            }
        )
        return
    # With `--out -` the results are what stdout is for.
    stream = sys.stderr if options.out == "-" else sys.stdout
    print(_printable("\n".join(_report_lines(options, run, results, seconds, t))), file=stream)


def _report_lines(options: argparse.Namespace, run: Any, results: Results, seconds: float, t: float) -> Iterator[str]:
    from .cosim.coupling import Coupling

    statistics, settings = results.statistics, run.settings
    accuracy = (
        f"step {float(settings.step):g} s"
        if settings.is_fixed_step
        else f"rtol {settings.rtol:g} atol {settings.atol:g}"
    )
    if isinstance(run.plan, Coupling):  # its units have methods of their own
        accuracy = f"({settings.method})" if settings.is_fixed_step else f"({settings.method}, rtol {settings.rtol:g})"
    begin = float(results.t[0]) if options.resume and len(results.t) else float(settings.start)
    span = f"{begin:g} ... {t:g} s"
    yield f"{results.diagram}  {' '.join(filter(None, (statistics.method, accuracy)))}  {statistics.engine}  {span}"
    if run.given:
        yield "  set: " + ", ".join(f"{path} = {value}" for path, value in run.given.items())
    steps, events = _counted(statistics.steps, "step"), _counted(len(results.events), "event")
    yield f"done in {seconds:.2f} s: {steps}, {statistics.rejected} rejected, {events}"
    yield results.table()
    if results.measures:
        width = max(map(len, results.measures))
        yield "  measures"
        for name, value in results.measures.items():
            # NaN: the run did not reach the window, or the signal did not settle.
            yield f"    {name.ljust(width)}  {value:.7g}" if math.isfinite(value) else f"    {name.ljust(width)}  -"
    if options.out not in (None, "-"):
        yield f"  {len(results.t)} rows in {options.out}"
    if options.save:
        yield f"  state at t = {t:g} s in {options.save}"
    if options.plot and len(results.t):
        yield f"  figure in {options.plot}"


# --- blocks study ----------------------------------------------------------------------------------------------


def _study(options: argparse.Namespace) -> int:
    from . import report, study

    loaded = study.load(options.study)
    folder = Path(options.out) if options.out else Path("out") / loaded.name
    parameters = _assignments("--set", options.parameters, "IADRC.torque=2")
    begun = None if options.json else lambda name: _say(f"running {name}")
    made = study.run(loaded, library=options.library, parameters=parameters, begun=begun, trust=options.trust)
    for v in made.verdicts if options.json else ():
        claim = v.claim
        entry: dict[str, Any] = {
            "event": "claim",
            "run": None if claim.change else claim.runs[0],
            "measure": claim.measure,
        }
        if claim.change:
            entry |= {"runs": list(claim.runs), "as": claim.change}
        entry |= {"value": v.value, "published": claim.published, "ratio": v.ratio, "verdict": v.verdict or None}
        _emit(entry | {"expected": v.is_expected})
    path = report.write(made, folder, _command(options), draw=lambda diagram: diagram.draw())
    if options.json:
        _emit(
            {
                "event": "done",
                "fine": made.is_fine,
                "reproduced": sum(v.verdict == "reproduced" for v in made.verdicts),
                "claims": sum(bool(v.verdict) for v in made.verdicts),
                "unexpected": sum(not v.is_expected for v in made.verdicts),
                "report": str(path),
                "seconds": round(made.seconds, 3),
            }
        )
    else:
        print(report.markdown_table(made) if options.markdown else _printable(report.table_text(made)))
        print(report.summary_line(made))
        print(f"report: {path}")
    return 0 if made.is_fine else 1


def _command(options: argparse.Namespace) -> str:
    words = ["blocks", "study", options.study]
    for name in ("parameters", "library"):
        for item in getattr(options, name):
            words += ["--set" if name == "parameters" else "--library", item]
    return shlex.join(words)


# --- blocks compare --------------------------------------------------------------------------------------------


def _compare(options: argparse.Namespace) -> int:
    from .compare import TOLERANCE, compare
    from .results import Results

    limits = {"tolerance": TOLERANCE, "absolute": 0.0}
    for name in limits:
        given = _number(name, getattr(options, name))
        if isinstance(given, Mapping):
            raise UsageError(Fault("E501", f"--{name}", f"{getattr(options, name)!r} is not a number without unit."))
        limits[name] = limits[name] if given is None else float(given)
    a, b = Results.load(options.a), Results.load(options.b)
    made = compare(a, b, **limits)
    if options.json:
        for one in made.differences:
            _emit(
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
        _emit(
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
        print(_printable("\n".join(_comparison_lines(options, a, b, made))))
    return 0 if made.is_within else 1


def _comparison_lines(options: argparse.Namespace, a: Results, b: Results, made: Any) -> Iterator[str]:
    for path, one in ((options.a, a), (options.b, b)):
        span = f"{one.t[0]:.10g} ... {one.t[-1]:.10g} s"
        yield f"{path}  {one.diagram}  {span}  {_counted(len(one.t), 'row')}"
    if made.is_interpolated:
        span = f"{made.start:.10g} ... {made.stop:.10g} s"
        yield f"  the times differ: compared by lines between rows at {_counted(made.rows, 'time')} of {span}"
    yield from (f"  {note}" for note in made.notes)
    yield made.table()
    for path, names in ((options.a, made.only_a), (options.b, made.only_b)):
        if names:
            yield f"  only in {path}: {', '.join(names)}"
    total, limit = _counted(len(made.differences), "signal"), f"{made.tolerance:g} of the range in A"
    if made.is_within:
        yield f"{total} within {limit}"
    else:
        yield f"{len(made.beyond)} of {total} beyond {limit}, most of all {made.worst.name}"


# --- blocks check ----------------------------------------------------------------------------------------------


def _check(options: argparse.Namespace) -> int:
    from .api import Diagram
    from .cosim.telling import lines
    from .foreign import found
    from .plan import Plan

    plan, flat = None, None
    fmus: list[Found] = []
    faults: tuple[Fault, ...]
    try:
        diagram = Diagram.load(options.diagram, library=options.library)
        diagram = diagram.with_variants(_variants(options.variants))
        flat = diagram.flatten()
        fmus = found(flat)
        plan = diagram.check()
        faults = plan.warnings if plan is not None else ()
    except BlocksError as error:
        faults = error.faults
    of_fmus = tuple(fault for one in fmus for fault in one.faults)
    status = 2 if any(not fault.is_warning for fault in faults) else 0
    status = status or (4 if any(not fault.is_warning for fault in of_fmus) else 0)
    faults = (*faults, *of_fmus)
    errors = [fault for fault in faults if not fault.is_warning]
    if options.json:
        for one in fmus:
            _emit(one.entry())
        for fault in faults:
            _emit(_fault_entry(fault))
        _emit({"event": "done", "errors": len(errors), "warnings": len(faults) - len(errors)})
        return status
    if isinstance(plan, Plan):
        count = sum(not instance.hidden for instance in plan.instances)
        states = _counted(len(plan.states), "state")
        print(_printable(f"{plan.name}: {_counted(count, 'block')}{_of_them(fmus)}, {states}, {_rates(plan)}"))
    elif flat is not None:
        count = sum(not block.hidden for block in flat.blocks)
        print(_printable(f"{flat.name}: {_counted(count, 'block')}{_of_them(fmus)}"))
    for one in fmus:
        for line in one.lines():
            print(_printable(f"  {line}"))
    for fault in faults:
        print(_printable(f"  {fault}"))
    if isinstance(plan, Plan):
        _tell_order(plan)
    elif plan is not None:
        for line in lines(plan):
            print(_printable(f"  {line}"))
    print(f"{_counted(len(errors), 'error')}, {_counted(len(faults) - len(errors), 'warning')}")
    return status


def _of_them(fmus: Sequence[Found]) -> str:
    return f" ({_counted(len(fmus), 'FMU')})" if fmus else ""


def _tell_order(plan: Plan) -> None:
    from .plan import Loop

    program = plan.program([*(("w", i) for i in range(len(plan.outputs))), *plan.derivatives])
    instances = (plan.instances[step.instance] for step in program.order)
    order = list(dict.fromkeys(instance.path for instance in instances if not instance.hidden))
    shown = " > ".join(order[:60]) + (f" > ... ({len(order) - 60} more)" if len(order) > 60 else "")
    if order:
        print(_printable(f"  order: {shown}"))
    loops = [step for step in program.steps if isinstance(step, Loop)]
    for loop in loops:
        names = [plan.node_name((step.instance, *result)) for step in loop.steps for result in step.results]
        print(_printable(f"  solved together: {', '.join(names)}"))
    if not loops:
        print("  no algebraic loop")


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _rates(plan: Any) -> str:
    rates = ["continuous"] if plan.states or not plan.rates else []
    for rate in plan.rates:
        offset = f" from {plan.tick_time(rate.offset):g} s" if rate.offset else ""
        rates.append(f"{plan.tick_time(rate.period):g} s{offset}")
    return f"{_counted(len(rates), 'rate')} ({', '.join(rates)})"


# --- blocks linearize, blocks observer -------------------------------------------------------------------------


def _linearizer(options: argparse.Namespace) -> tuple[Diagram, dict[str, Any]]:
    """The diagram, and where it is linearized, as `Diagram.linearizer` takes it."""
    from .api import Diagram

    diagram = Diagram.load(options.diagram, library=options.library)
    at = _number("at", options.at)
    held = {
        name: value if isinstance(value, (dict, bool)) else _raw_number(value)
        for name, value in _assignments("--input", options.held, "r=1").items()
    }
    point: dict[str, Any] = {
        "at": None if at is None else _raw_number(at),
        "held": held,
        "parameters": _assignments("--set", options.parameters, "motor.Ra=0.2"),
        "variants": _variants(options.variants),
        "trust": options.trust,
    }
    for word, items in (("amplitude", options.amplitude), ("sigma", options.sigma)):
        given = _assignments(f"--{word}", items, "eso.e=0.1")
        point[word] = {name: v if isinstance(v, dict) else _raw_number(v) for name, v in given.items()}
    return diagram, point


def _raw_number(value: Any) -> Any:
    """A number, in SI where a unit stands with it, or a list of numbers. Raises UsageError (E501)."""
    from . import units

    if isinstance(value, list):
        return [_raw_number(item) for item in value]
    if isinstance(value, dict):
        return units.to_si(float(value["value"]), str(value["unit"]))
    if isinstance(value, (str, bool)):
        raise UsageError(Fault("E501", str(value), "is not a number."))
    return float(value)


def _linearize(options: argparse.Namespace) -> int:
    from . import plots
    from .analysis.telling import entry, figure, lines

    if options.plot:
        _check_writable("--plot", options.plot, [options.diagram])
        plots.check_format(options.plot)
    elif options.figure is not None:
        raise UsageError(Fault("E501", "--figure", "there is no file to draw it to.", "Give one: --plot FILE.svg"))
    if options.pade < 0:
        raise UsageError(Fault("E501", f"--pade {options.pade}", "is no order of a model.", "Use 1 to 10."))
    is_loop = options.loop is not None
    if is_loop == bool(options.sources or options.sinks) or (not is_loop and not (options.sources and options.sinks)):
        cure = "As in --from r --to motor.omega, or --loop control.u."
        raise UsageError(Fault("E501", "linearize", "needs --from and --to, or --loop alone.", cure))
    diagram, point = _linearizer(options)
    linearizer = diagram.linearizer(**point)
    if is_loop:
        model = linearizer.loop(options.loop, openings=options.openings, pade=options.pade)
        if not model.nstates and not model.D.any():
            message = "nothing of what is put in there comes back: it is in no loop."
            cure = "A relay or a quantizer on the way passes nothing on where it stands: see limit_cycles in Python."
            raise AnalysisError(Fault("E705", options.loop, message, cure))
    else:
        model = linearizer.model(options.sources, options.sinks, openings=options.openings, pade=options.pade)
    if options.json:
        _emit(entry(model, is_loop=is_loop))
    else:
        print(_printable(diagram.name))
        for line in lines(model, is_loop=is_loop):
            print(_printable(f"  {line}"))
    if options.plot:
        plots.save(figure(model, options.figure or "bode", is_loop=is_loop), options.plot)
        _say(f"figure in {options.plot}")
    return 0


def _observer(options: argparse.Namespace) -> int:
    from .analysis.reports import AMPLITUDES, observer_report

    diagram, point = _linearizer(options)
    texts = [text for item in options.amplitudes or () for text in item.split(",") if text]
    given = [_raw_number(_value(text)) for text in texts] or AMPLITUDES
    report = observer_report(diagram, options.block, amplitudes=given, **point)
    if options.json:
        _emit(report.as_json())
    else:
        print(_printable(str(report)))
    return 0


# --- blocks draw -----------------------------------------------------------------------------------------------


def _draw(options: argparse.Namespace) -> int:
    from .api import Diagram
    from .files import write_atomically

    if not 1 <= options.depth <= 30:
        raise UsageError(Fault("E501", f"--depth {options.depth}", "is not a number of levels.", "Use 1 or more."))
    diagram = Diagram.load(options.diagram, library=options.library)
    text = diagram.draw(depth=options.depth, variants=_variants(options.variants))
    if options.out in (None, "-"):
        print(text)
        return 0
    if not options.out.lower().endswith(".svg"):
        cure = "Name it FILE.svg; browsers and Inkscape turn it into others."
        raise UsageError(Fault("E501", options.out, "a drawing is an SVG.", cure))
    with write_atomically(options.out) as stream:
        stream.write(text)
    print(options.out)
    return 0


# --- blocks list -----------------------------------------------------------------------------------------------


def _list(options: argparse.Namespace) -> int:
    from .api import library_types
    from .errors import did_you_mean
    from .settings import MEASURES

    types = library_types(options.library)
    if options.block == "measures":
        for name, what in MEASURES.items():
            if options.json:
                _emit({"measure": name, "doc": what})
            else:
                print(f"{name.ljust(16)}  {what}")
        return 0
    if options.block is None:
        groups: dict[str, list[Any]] = {}
        for cls in types.values():
            groups.setdefault(cls.__module__.rpartition(".")[2], []).append(cls)
        width = max(map(len, types))
        for group, members in sorted(groups.items()):
            if not options.json:
                print(f"{group}")
            for cls in members:
                first = cls.declaration.doc.partition("\n")[0]
                if options.json:
                    _emit({"type": cls.__name__, "group": group, "doc": first})
                else:
                    print(_printable(f"  {cls.__name__.ljust(width)}  {first}"))
        return 0
    if options.block.endswith(".fmu"):
        from .imported import fmu_type

        _tell(fmu_type(options.block), options.json)
        return 0
    if options.block not in types:
        cure = did_you_mean(options.block, types) or "`blocks list` names them all."
        raise UsageError(Fault("E103", options.block, "there is no such block type.", cure))
    _tell(types[options.block], options.json)
    return 0


def _tell(cls: Any, as_json: bool) -> None:
    """One block type: ports, parameters, equations."""
    declaration = cls.declaration
    inputs, outputs = _port_rows(cls)
    parameters = [
        (p.name, _unit(p), _default(p), p.doc, _kind(declaration, p)) for p in declaration.parameters.values()
    ]
    if as_json:
        _emit(
            {
                "type": cls.__name__,
                "doc": declaration.doc,
                "inputs": [{"name": n, "unit": u, "doc": d} for n, u, _, d in inputs],
                "outputs": [{"name": n, "unit": u, "doc": d} for n, u, _, d in outputs],
                "parameters": [
                    {"name": n, "unit": u, "default": v, "doc": d, "kind": k} for n, u, v, d, k in parameters
                ],
            }
        )
        return
    lines = [f"{cls.__name__}: {declaration.doc}", ""]
    for title, rows in (("inputs", inputs), ("outputs", outputs)):
        lines.append(f"{title}:" if rows else f"{title}: none")
        lines += _columns([(name, unit, extra, doc) for name, unit, extra, doc in rows])
    lines.append("parameters:" if parameters else "parameters: none")
    lines += _columns([(name, unit, value, kind, doc) for name, unit, value, doc, kind in parameters])
    if any(unit == "*" for _, unit, *_ in parameters):
        lines += ["", "* follows from the units that the structural parameters say"]
    print(_printable("\n".join(lines)))


def _port_rows(cls: Any) -> tuple[list[tuple[str, str, str, str]], list[tuple[str, str, str, str]]]:
    from .interface import resolve

    declaration = cls.declaration
    variables: dict[str, Any] = {
        **declaration.inputs,
        **declaration.outputs,
        **declaration.stepped,
        **declaration.given,
        **declaration.states,
        **declaration.discretes,
        **declaration.algebraics,
    }
    try:
        interface = resolve(cls, {}).interface
    except BlocksError:  # a type with parameters that must be given has no ports yet
        rows = [(name, _unit(v), "", v.doc) for name, v in declaration.inputs.items()]
        made = [
            (name, _unit(v), "", v.doc)
            for name, v in variables.items()
            if name not in declaration.inputs and getattr(v, "output", True)
        ]
        return rows, made

    def row(port: Any) -> tuple[str, str, str, str]:
        extra = f"default {port.default:g}" if port.default is not None else ""
        return port.name, port.unit, extra, variables[port.variable].doc

    return [row(port) for port in interface.inputs.values()], [row(port) for port in interface.outputs.values()]


def _unit(variable: Any) -> str:
    return variable.unit if isinstance(variable.unit, str) else "*"


def _default(parameter: Any) -> str:
    from .declare import REQUIRED

    if parameter.default is REQUIRED:
        return "required"
    if parameter.default is None:
        return "optional"
    return "computed" if callable(parameter.default) else f"{parameter.default}"


def _kind(declaration: Any, parameter: Any) -> str:
    kind = "structural" if parameter.structural else "fixed" if parameter.fixed else ""
    return f"{kind} ({' | '.join(parameter.choices)})" if parameter.choices else kind


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    if not rows:
        return []
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]


# --- blocks doctor ---------------------------------------------------------------------------------------------


def _doctor(options: argparse.Namespace) -> int:
    from .doctor import examine
    from .native import cache

    if options.clear_cache:
        place = cache.of_user()
        gone = place.clear()
        if options.json:
            _emit({"event": "done", "removed": gone.entries, "bytes": gone.bytes, "folder": str(place.folder)})
        else:
            entries = f"{gone.entries} {'entry' if gone.entries == 1 else 'entries'}"
            print(_printable(f"{place.folder}: {entries} removed, {gone.bytes / 2**20:.1f} MiB"))
        if place.is_temporary:
            _say(f"the cache of other runs was left alone: {place.reason}")
        return 0
    health = examine()
    if not options.json:
        print(_printable("\n".join(health.lines())))
    _tell_faults(health.faults, options.json)
    if options.json:
        _emit({"event": "done", **health.entry()})
    return 2 if health.faults else 0
