"""`blocks export`."""

from __future__ import annotations

import argparse
import os
from dataclasses import asdict
from typing import Any

from ..text.errors import Fault, UsageError, did_you_mean
from .option_values import case_of, check_writable
from .options import Verbs, takes_json, takes_library, takes_parameters, takes_settings, takes_several, takes_variants
from .output import emit, printable, say


def add(verbs: Verbs) -> None:
    export = verbs.add_parser(
        "export",
        help="make an FMU of a diagram, or of one block",
        description="Write a diagram, or one block of the library, as an FMU, which needs no Python where it runs.",
    )
    export.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON), or the name of a block type")
    export.add_argument("-o", "--out", metavar="X.fmu", required=True, help="the file to write")
    export.add_argument("--name", metavar="N", default="", help="name of the model (default: the name of the diagram)")
    export.add_argument("--fmi", metavar="2|3", type=int, default=3, help="the version of FMI (default 3)")
    kind = "Co-Simulation or Model Exchange; give it twice for both (default: all that the diagram allows)"
    takes_several(export, "--kind", "CS|ME", kind, type=str.upper, dest="kinds", default=None)
    platform = "x86_64-linux, aarch64-linux, x86_64-windows, x86_64-darwin or aarch64-darwin; may be repeated; none: "
    platform += "sources only (default: this machine's)"
    takes_several(export, "--platform", "P", platform, dest="platforms", default=None)
    takes_settings(export, "stop-when", "method", "step", "rtol", "atol", "seed")
    log = "show this signal instead of the file's choice; may be repeated"
    takes_several(export, "--log", "SIGNAL", log, default=None)
    takes_parameters(export)
    takes_variants(export)
    takes_json(export, "one JSON object")
    export.set_defaults(verb=_export)
    takes_library(export)


def _export(options: argparse.Namespace) -> int:
    from ..api.catalog import Catalog
    from ..api.diagram import Diagram
    from ..api.preparing import other_platforms

    case = case_of(options)
    types = Catalog.of(options.library).types
    if options.diagram in types and not os.path.exists(options.diagram):
        block: Any = types[options.diagram]
        diagram, case = Diagram.alone(block(**case.parameters)), case.without("parameters")  # they fix its ports, too
    elif options.diagram.isidentifier() and not os.path.exists(options.diagram):
        cure = did_you_mean(options.diagram, types) or "`blocks list` names the block types."
        raise UsageError(Fault("E103", options.diagram, "is neither a diagram file nor a block type.", cure))
    else:
        diagram = Diagram.load(options.diagram, library=options.library)
    check_writable("-o", options.out, [options.diagram])
    platforms = [name for name in options.platforms or () if name != "none"] if options.platforms else None
    others = other_platforms(platforms or ())
    if others and not options.json:
        say(f"building for {', '.join(others)}: the first build for a platform takes a minute or two")
    fmu = diagram.export(
        options.out,
        case,
        fmi=options.fmi,
        kinds=options.kinds,
        platforms=platforms,
        name=options.name,
    )
    if options.json:
        emit({"event": "exported", **asdict(fmu), "path": str(fmu.path), "bytes": fmu.path.stat().st_size})
    else:
        print(printable(str(fmu)))
    return 0
