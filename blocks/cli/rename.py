"""`blocks rename`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from .options import takes_library
from .output import counted, emit, printable, say

if TYPE_CHECKING:
    from ..editing.rename import Change

__all__ = ["add"]

KINDS = ("block", "input", "parameter", "output")


def add(verbs: Any) -> None:
    rename = verbs.add_parser(
        "rename",
        help="rename a block, an input, a parameter or an output with all that refers to it",
        description="Rename a block, an input, a parameter or an output of a diagram with all wires, expressions, "
        "measures and settings that name it. All other characters of the file stay as they are. Other diagrams and "
        "studies of the project that use the name are told, and left alone unless --project is given.",
    )
    rename.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON)")
    rename.add_argument("old", metavar="OLD", help="its name; control.eso for what lies in the subdiagram control")
    rename.add_argument("new", metavar="NEW", help="its new name, without a path")
    rename.add_argument("--kind", choices=KINDS, help="what is meant, where an output has the name of something else")
    rename.add_argument("--project", action="store_true", help="edit the other files of the project as well")
    rename.add_argument("--dry-run", action="store_true", help="tell what would change, and write nothing")
    rename.add_argument("--json", action="store_true", help="one JSON object per line")
    rename.set_defaults(verb=_rename)
    takes_library(rename)


def _rename(options: argparse.Namespace) -> int:
    from ..editing.rename import renaming

    made = renaming(
        options.diagram,
        options.old,
        options.new,
        kind=options.kind,
        library=options.library,
        project=options.project,
    )
    if not options.dry_run:
        made.write()
    if options.json:
        for event, changes in (("change", made.changes), ("elsewhere", made.elsewhere)):
            for one in changes:
                emit({"event": event, **_entry(one)})
        done = {"event": "done", "kind": made.kind, "old": made.old, "new": made.new, "count": made.count}
        emit(done | {"files": list(made.texts), "written": not options.dry_run, "note": made.note})
        return 0
    for one in made.changes:
        print(printable(_line(one)))
    would = "would be" if options.dry_run else "is"
    places = counted(made.count, "place")
    places += f" of {counted(len(made.texts), 'file')}" if options.project else ""
    print(printable(f"{made.file}: the {made.kind} {made.old} {would} {made.new} now, in {places}"))
    for one in made.elsewhere:
        say(f"warning: not changed: {_line(one)} (--project changes it as well)")
    if made.note:
        say(f"warning: {made.note}")
    return 0


def _line(one: Change) -> str:
    what = f"{one.old} -> {one.new}" if one.old else f"+ {one.new}"
    return f"{one.file}:{one.line}:{one.column}: {what}"


def _entry(one: Change) -> dict[str, Any]:
    return {"file": one.file, "line": one.line, "column": one.column, "old": one.old, "new": one.new}
