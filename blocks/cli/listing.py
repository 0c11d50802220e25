"""`blocks list`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from ..text.printable import aligned
from .options import takes_json, takes_library
from .output import emit, printable

if TYPE_CHECKING:
    from ..api.catalog import Sheet

__all__ = ["add"]


def add(verbs: Any) -> None:
    listing = verbs.add_parser(
        "list",
        help="list the block library, or tell about one block",
        description="List the block types, or one type's ports and parameters.",
    )
    listing.add_argument("block", metavar="BLOCK", nargs="?", help="a block type, an FMU, or `measures`")
    takes_json(listing)
    listing.set_defaults(verb=_list)
    takes_library(listing)


def _list(options: argparse.Namespace) -> int:
    from ..api.catalog import Catalog, measures

    catalog = Catalog.of(options.library)
    if options.block == "measures":
        for name, what in measures().items():
            if options.json:
                emit({"measure": name, "doc": what})
            else:
                print(f"{name.ljust(16)}  {what}")
        return 0
    if options.block is None:
        groups: dict[str, list[Any]] = {}
        for cls in catalog.types.values():
            groups.setdefault(cls.__module__.rpartition(".")[2], []).append(cls)
        width = max(map(len, catalog.types))
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
    _tell(catalog.sheet(options.block), options.json)
    return 0


def _tell(sheet: Sheet, as_json: bool) -> None:
    """One block type: ports and parameters."""
    if as_json:
        emit(
            {
                "type": sheet.name,
                "doc": sheet.doc,
                "inputs": [{"name": n, "unit": u, "doc": d} for n, u, _, d in sheet.inputs],
                "outputs": [{"name": n, "unit": u, "doc": d} for n, u, _, d in sheet.outputs],
                "parameters": [row._asdict() for row in sheet.parameters],
            }
        )
        return
    lines = [f"{sheet.name}: {sheet.doc}", ""]
    for title, rows in (("inputs", sheet.inputs), ("outputs", sheet.outputs)):
        lines.append(f"{title}:" if rows else f"{title}: none")
        lines += aligned(rows)
    lines.append("parameters:" if sheet.parameters else "parameters: none")
    lines += aligned([(row.name, row.unit, row.default, row.kind, row.doc) for row in sheet.parameters])
    if any(row.unit == "*" for row in sheet.parameters):
        lines += ["", "* follows from the units that the structural parameters say"]
    print(printable("\n".join(lines)))
