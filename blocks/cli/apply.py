"""`blocks apply`."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from ..text.errors import ModelError
from ..text.printable import counted
from .options import Verbs, takes_json, takes_library
from .output import emit, fault_entry, printable, say

if TYPE_CHECKING:
    from ..editing.edits import Change, Edit


def add(verbs: Verbs) -> None:
    apply = verbs.add_parser(
        "apply",
        help="edit a diagram or study file by a list of operations",
        description="Edit a diagram or study file, and the files that it refers to, by a list of operations: "
        "add, set, remove, "
        "rename, wire, unwire, move, group, ungroup, swap, paste. Only the characters that must change are "
        "changed; either all files are written, or none.",
    )
    apply.add_argument("file", metavar="FILE", help="a diagram or a study file (JSON)")
    apply.add_argument("operations", metavar="OPS.json", help="a JSON file with a list of operations, or - for stdin")
    apply.add_argument("--project", action="store_true", help="edit the other files of the project as well")
    apply.add_argument("--dry-run", action="store_true", help="show what would change, and write nothing")
    apply.add_argument("--strict", action="store_true", help="write nothing if the diagram would get new faults")
    takes_json(apply)
    apply.set_defaults(verb=_apply)
    takes_library(apply)


def _apply(options: argparse.Namespace) -> int:
    from ..editing.applying import edit_file, operations_of

    data = sys.stdin.buffer.read() if options.operations == "-" else None
    operations = operations_of("<stdin>" if options.operations == "-" else options.operations, data)
    edit = edit_file(options.file, operations, library=options.library, project=options.project)
    if edit.faults and options.strict:
        raise ModelError(*edit.faults)
    if not options.dry_run:
        edit.write()
    if options.json:
        for event, changes in (("change", edit.changes), ("elsewhere", edit.elsewhere)):
            for change in changes:
                emit({"event": event, **change_entry(change)})
        for fault in edit.faults:
            emit({"event": "fault", **fault_entry(fault)})
        done = {"event": "done", "operations": len(operations.value), "files": list(edit.texts)}
        emit(done | {"written": not options.dry_run, "note": edit.note})
        return 0
    for change in edit.changes:
        print(printable(change_line(change)))
    would = "would be" if options.dry_run else "are" if len(edit.texts) != 1 else "is"
    files = counted(len(edit.texts), "file") if len(edit.texts) != 1 else next(iter(edit.texts))
    count = counted(len(operations.value), "operation")
    print(printable(f"{files} {would} edited, by {count}" if edit.texts else f"nothing changes by {count}"))
    tell_elsewhere(edit)
    for fault in edit.faults:
        say(f"warning: new: {fault}")
    return 0


def tell_elsewhere(edit: Edit) -> None:
    """Print on stderr the changes that other files would need."""
    for change in edit.elsewhere:
        say(f"warning: left unchanged: {change_line(change)} (--project changes it as well)")
    if edit.note:
        say(f"warning: {edit.note}")


def change_line(change: Change) -> str:
    """Return a change as a line of text; long values are cut."""
    old, new = (_short(text) for text in (change.old, change.new))
    what = f"{old} -> {new}" if old and new else f"+ {new}" if new else f"- {old}"
    return f"{change.file}:{change.line}:{change.column}: {what}"


def _short(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= 100 else f"{line[:97]}..."


def change_entry(change: Change) -> dict[str, object]:
    """Return a change as an object."""
    return {"file": change.file, "line": change.line, "column": change.column, "old": change.old, "new": change.new}
