"""`blocks rename`."""

from __future__ import annotations

import argparse

from ..text.printable import counted
from .apply import change_entry, change_line, tell_elsewhere
from .options import Verbs, takes_json, takes_library
from .output import emit, printable

KINDS = ("block", "input", "parameter", "output")


def add(verbs: Verbs) -> None:
    rename = verbs.add_parser(
        "rename",
        help="rename a block, an input, a parameter or an output, and everything that refers to it",
        description="Rename a block, an input, a parameter or an output of a diagram in all wires, expressions, "
        "measures and settings that name it. All other characters of the file stay as they are. Other diagrams and "
        "studies of the project that use the name are listed, and changed only with --project.",
    )
    rename.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON)")
    rename.add_argument("old", metavar="OLD", help="its name; control.eso for eso in the subdiagram control")
    rename.add_argument("new", metavar="NEW", help="its new name, without a path")
    rename.add_argument("--kind", choices=KINDS, help="the kind, if an output shares its name with something else")
    rename.add_argument("--project", action="store_true", help="edit the other files of the project as well")
    rename.add_argument("--dry-run", action="store_true", help="show what would change, and write nothing")
    takes_json(rename)
    rename.set_defaults(verb=_rename)
    takes_library(rename)


def _rename(options: argparse.Namespace) -> int:
    from ..editing.renaming import renaming

    edit = renaming(
        options.diagram,
        options.old,
        options.new,
        kind=options.kind,
        library=options.library,
        project=options.project,
    )
    if not options.dry_run:
        edit.write()
    if options.json:
        for event, changes in (("change", edit.changes), ("elsewhere", edit.elsewhere)):
            for change in changes:
                emit({"event": event, **change_entry(change)})
        done = {"event": "done", "kind": edit.kind, "old": edit.old, "new": edit.new, "count": edit.count}
        emit(done | {"files": list(edit.texts), "written": not options.dry_run, "note": edit.note})
        return 0
    for change in edit.changes:
        print(printable(change_line(change)))
    would = "would be" if options.dry_run else "is"
    places = counted(edit.count, "place")
    places += f" of {counted(len(edit.texts), 'file')}" if options.project else ""
    print(printable(f"{edit.file}: the {edit.kind} {edit.old} {would} {edit.new} now, in {places}"))
    tell_elsewhere(edit)
    return 0
