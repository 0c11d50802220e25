"""`blocks list`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from ..text.errors import BlocksError, Fault, UsageError
from ..text.printable import legible
from .options import takes_library
from .output import emit, printable

__all__ = ["add"]


def add(verbs: Any) -> None:
    listing = verbs.add_parser(
        "list",
        help="list the block library, or tell about one block",
        description="List the block types, or one type's ports and parameters.",
    )
    listing.add_argument("block", metavar="BLOCK", nargs="?", help="a block type, an FMU, or `measures`")
    listing.add_argument("--json", action="store_true", help="one JSON object per line")
    listing.set_defaults(verb=_list)
    takes_library(listing)


def _list(options: argparse.Namespace) -> int:
    from ..model.block_types import library_types
    from ..model.settings import MEASURES
    from ..text.errors import did_you_mean

    types = library_types(options.library)
    if options.block == "measures":
        for name, what in MEASURES.items():
            if options.json:
                emit({"measure": name, "doc": what})
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
                    emit({"type": cls.__name__, "group": group, "doc": first})
                else:
                    print(printable(f"  {cls.__name__.ljust(width)}  {first}"))
        return 0
    if options.block.endswith(".fmu"):
        from ..model.fmu_block import fmu_type

        _tell(fmu_type(options.block), options.json)
        return 0
    if options.block not in types:
        cure = did_you_mean(options.block[:200], types) or "`blocks list` names them all."
        raise UsageError(Fault("E103", legible(options.block), "there is no such block type.", cure))
    _tell(types[options.block], options.json)
    return 0


def _tell(cls: Any, as_json: bool) -> None:
    """One block type: ports, parameters, equations."""
    declaration = cls.declaration
    inputs, outputs = _port_rows(cls)
    parameters = [(p.name, _unit(p), _default(p), p.doc, _kind(declaration, p)) for p in declaration.settable.values()]
    if as_json:
        emit(
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
    print(printable("\n".join(lines)))


def _port_rows(cls: Any) -> tuple[list[tuple[str, str, str, str]], list[tuple[str, str, str, str]]]:
    from ..contract.resolution import resolve

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
        values = port.default if port.default is None or len(set(port.default)) > 1 else port.default[:1]
        extra = f"default {', '.join(f'{value:g}' for value in values)}" if values is not None else ""
        return port.name, port.unit, extra, variables[port.variable].doc

    return [row(port) for port in interface.inputs.values()], [row(port) for port in interface.outputs.values()]


def _unit(variable: Any) -> str:
    return variable.unit if isinstance(variable.unit, str) else "*"


def _default(parameter: Any) -> str:
    from ..contract.variables import REQUIRED

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
