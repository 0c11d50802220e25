"""`blocks fmu`."""

from __future__ import annotations

import argparse
import os
from collections.abc import Container, Mapping
from typing import TYPE_CHECKING, Any

from ..host.gc_pause import paused
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.printable import legible
from .option_values import assignments, check_writable
from .options import Verbs, takes_json, takes_profile, takes_run, takes_several
from .output import emit, printable, say, waiting
from .run import run_diagram

if TYPE_CHECKING:
    from ..api.diagram import Diagram
    from ..fmi.model_description import ModelVariable
    from ..model.fmu_block import Foreign

_SIZE = "structuralParameter"
_SHOWN = 30  # names


def add(verbs: Verbs) -> None:
    fmu = verbs.add_parser("fmu", help="inspect an FMU, run it, or compile its sources")
    parts = fmu.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for what, title, text in (
        ("info", "show the contents of an FMU", "Show the contents of an FMU. Nothing is unpacked or loaded."),
        (
            "check",
            "check whether an FMU can run here",
            "Check whether an FMU can run here, and show why not. Nothing is unpacked or loaded. Exit code 4 if "
            "it cannot.",
        ),
    ):
        part = parts.add_parser(what, help=title, description=text)
        part.add_argument("fmus", metavar="X.fmu", nargs="+")
        if what == "info":
            part.add_argument(
                "--all", action="store_true", help="show locals too, and all variables of each group (otherwise 30)"
            )
        takes_json(part, "one JSON object for each FMU")
        part.set_defaults(verb=_fmu, what=what)
    alone = parts.add_parser(
        "run",
        help="run an FMU by itself",
        description="Run an FMU by itself, as a diagram of one block: its inputs and outputs become those of "
        "the diagram. This runs the FMU's code.",
    )
    alone.add_argument("fmu", metavar="X.fmu")
    kind = "Co-Simulation or Model Exchange (default: Co-Simulation if it has both)"
    alone.add_argument("--kind", metavar="CS|ME", type=str.upper, help=kind)
    alone.add_argument("--isolate", action="store_true", help="run it in a process of its own")
    takes_run(alone)
    alone.add_argument(
        "--trace", metavar="FILE", dest="trace_file", help="write all calls of the FMU: text, or .jsonl for JSON lines"
    )
    takes_profile(alone)
    alone.set_defaults(verb=_run_fmu, library=[])
    compiling = parts.add_parser(
        "compile",
        help="compile the C sources in an FMU for this machine",
        description="Compile the C sources that an FMU contains and add the binary to it. The whole file is "
        "replaced at once.",
    )
    compiling.add_argument("fmu", metavar="X.fmu")
    compiling.add_argument("-o", "--out", metavar="Y.fmu", help="the file to write (default: replace the FMU)")
    platform = "x86_64-linux, aarch64-linux, x86_64-windows, ...; may be repeated (default: this machine's)"
    takes_several(compiling, "--platform", "P", platform, dest="platforms", default=None)
    takes_json(compiling, "one JSON object")
    compiling.set_defaults(verb=_compile)


def _fmu(options: argparse.Namespace) -> int:
    from ..fmi.summary import tell

    errors = 0
    for path in options.fmus:
        with waiting(f"reading {path}", quiet=options.json), paused():
            told = tell(path)
            errors += len(told.errors)
            if options.json:
                emit({"event": "fmu", **told.entry()})
            else:
                print(printable(told.info(everything=options.all) if options.what == "info" else told.check()))
    return 4 if options.what == "check" and errors else 0


def _compile(options: argparse.Namespace) -> int:
    from ..export.source_fmu import compile_sources

    out = options.out or options.fmu
    check_writable("-o" if options.out else "X.fmu", out, [])
    fmu = compile_sources(options.fmu, out, platforms=options.platforms)
    if options.json:
        emit({"event": "compiled", "path": str(fmu.path), "binaries": list(fmu.binaries), "notes": list(fmu.notes)})
    else:
        print(printable(str(fmu)))
    return 0


def _run_fmu(options: argparse.Namespace) -> int:
    """An FMU as a diagram of one block; its own times and steps hold unless the command gives others."""
    options.diagram, options.variants, options.trust = options.fmu, [], []
    options.trace = ["*"] if options.trace_file else []
    if options.trace_file:
        check_writable("--trace", options.trace_file, [options.fmu])
    is_chosen = options.log is not None
    with waiting(f"reading {options.fmu}", quiet=options.json), paused():
        diagram = _alone(options)
    return run_diagram(options, lambda: diagram, is_chosen=is_chosen)


def _alone(options: argparse.Namespace) -> Diagram:
    """The diagram; a parameter without the name of a block is one of its only block."""
    from ..api.diagram import Diagram
    from ..fmi.description import EXPERIMENT

    block = _with_sizes(options)
    diagram = Diagram.alone(block)
    foreign = type(block).declaration.foreign
    experiment = foreign.description.experiment
    settings = {"start": experiment.start, "stop": experiment.stop}
    if foreign.kind == "ME":
        settings["rtol"] = experiment.tolerance
    diagram.settings(**{key: value for key, value in settings.items() if value is not None})
    for fault in foreign.description.warnings:
        if fault.place == EXPERIMENT:
            say(str(fault))
    _check_names(options, _name_of_block(diagram), type(block).declaration)
    _unwire_others(options, diagram, type(block).declaration)
    _rename_options(options, diagram, type(block).declaration)
    return diagram


def _name_of_block(diagram: Diagram) -> str:
    """Return the name of the only block."""
    return next(iter(diagram.value.blocks))


def _check_names(options: argparse.Namespace, block: str, declared: Any) -> None:
    """Refuse names of --set that the FMU does not have, and start values that are given to --start."""
    known, inputs, variables = declared.parameters, declared.inputs, declared.foreign.variables
    variable = str(options.start or "").partition("=")[0].strip()
    if variable and f"{variable}_start" in known:
        cure = f"A start value is a parameter: --set {options.start.replace(variable, f'{variable}_start', 1)}."
        raise UsageError(Fault("E501", "--start", "is the time at which the run begins.", cure))
    for name in filter(None, map(_name, options.parameters)):
        if name in known or _whole(name) in known or "*" in name or name.startswith(f"{block}."):
            continue
        if _is_text(name, variables):
            continue
        cure = did_you_mean(name[:200], known) or f"Parameters: {', '.join([*known][:_SHOWN]) or 'none'}."
        if name in inputs:
            cure = f"It is an input: --input {name}=..."
        elif f"{name}_start" in known:
            cure = f"Its start value is a parameter: --set {name}_start=..."
        raise UsageError(Fault("E106", legible(name), "the FMU has no such parameter.", cure))


def _whole(name: str) -> str:
    """Return the name of the array of an element."""
    return name.rpartition("[")[0] if name.endswith("]") else name


def _unwire_others(options: argparse.Namespace, diagram: Diagram, declared: Any) -> None:
    """Leave inputs that no option gives to the FMU, which has their start values: some FMUs refuse to be given them."""
    from ..api.entries import as_name

    name = _name_of_block(diagram)
    given = {_name(item) for item in options.input}
    if "" in given:  # a file
        return
    for port, variable in declared.inputs.items():
        if variable.default is not None and given.isdisjoint((port, as_name(port))):
            diagram.unwire(f"{name}.{port}")


def _with_sizes(options: argparse.Namespace) -> Any:
    """Return the block of the FMU. Values of its sizes, and of arrays of these sizes, leave the options."""
    from ..model.fmu_block import fmu

    block = fmu(options.fmu, options.kind, isolate=options.isolate)
    variables, known = type(block).declaration.foreign.variables, type(block).declaration.parameters
    sizes = [name for name, variable in variables.items() if variable.causality == _SIZE]
    if not sizes:
        return block
    # Inputs follow from sizes: these, and the arrays of these sizes, are set before there is a diagram.
    given = assignments("--set", options.parameters, "n=2")
    of_block = {name.removeprefix(f"{type(block).__name__}."): name for name in given}
    of_block = {name: full for name, full in of_block.items() if name in known}
    if not any(name in of_block for name in sizes):
        return block
    taken = {name: given[full] for name, full in of_block.items()}
    block = fmu(options.fmu, options.kind, isolate=options.isolate, parameters=taken)
    left = [item for item in options.parameters if item.partition("=")[0].strip() not in of_block.values()]
    options.parameters = left
    return block


def _rename_options(options: argparse.Namespace, diagram: Diagram, declared: Any) -> None:
    """Give the options the names of the diagram in place of those of the FMU. declared: of the block."""
    from ..api.entries import as_name

    foreign = declared.foreign
    name = _name_of_block(diagram)
    # No wire carries a text: its start value is a parameter.
    texts = [item for item in options.input if _is_text(_name(item), foreign.variables)]
    start = [
        _renamed(item, "{}_start") if _is_text(_name(item), foreign.variables) else item
        for item in (*options.parameters, *texts)
    ]
    options.parameters = [
        _renamed(item, f"{name}.{{}}") if {_name(item), _whole(_name(item))} & declared.parameters.keys() else item
        for item in start
    ]
    # A port of the diagram is renamed if its name in the FMU is not allowed here ("a[1].b").
    ports = {
        own: as_name(own) for own, variable in foreign.variables.items() if variable.causality in ("input", "output")
    }
    options.input = [_renamed(item, ports.get(_name(item), "{}")) for item in options.input if item not in texts]
    if options.log is None and not any(variable.causality == "output" for variable in foreign.variables.values()):
        options.log = _without_outputs(foreign, [*declared.inputs], declared.readable)
    elif options.log is None:  # by default a diagram also records what its blocks give: the same under other names
        options.log = [*diagram.value.inputs, *diagram.value.outputs]
    if options.log is not None:
        others = {own: f"{name}.{own}" for own in declared.readable}
        options.log = [{**others, **ports}.get(item, item) for item in options.log]


def _name(item: str) -> str:
    """Return the name in NAME=VALUE; "" if the item is a file."""
    name, equals, _ = item.partition("=")
    return name.strip() if equals and not os.path.exists(item) else ""


def _renamed(item: str, form: str) -> str:
    """Rename the name in NAME=VALUE. form: the new name, in which {} is the old one."""
    name = _name(item)
    return f"{form.replace('{}', name)}={item.partition('=')[2]}" if name else item


def _is_text(name: str, variables: Mapping[str, ModelVariable]) -> bool:
    """Whether an input holds a text."""
    start = variables.get(f"{name}_start")
    return start is not None and (start.type, start.causality, start.name) == ("String", "input", name)


def _without_outputs(foreign: Foreign, inputs: list[str], readable: Container[str]) -> list[str] | None:
    """Return the variables to record of an FMU without outputs: its states, or else its local variables."""
    states = [state.name for state in foreign.description.structure.states if state.name in readable]
    others = [other for other, variable in foreign.variables.items() if variable.causality == "local"]
    shown = (states or [other for other in others if other in readable])[:_SHOWN]
    what = "states" if states else "local variables"
    if shown:
        more = f" (the first {_SHOWN})" if len(shown) == _SHOWN else ""
        say(f"{foreign.path.name} has no outputs: its {what}{more} are recorded; --log NAME records other variables.")
    else:
        say(f"{foreign.path.name} has no outputs, and no other variable can be recorded.")
    return [*inputs, *shown] if shown else None
