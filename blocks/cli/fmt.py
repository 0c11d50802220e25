"""`blocks fmt`."""

from __future__ import annotations

import argparse
import sys

from ..text.errors import BlocksError, Fault, UsageError
from ..text.printable import counted
from .options import Verbs, takes_json
from .output import emit, printable, say, tell_faults


def add(verbs: Verbs) -> None:
    fmt = verbs.add_parser(
        "fmt",
        help="write diagram and study files in their canonical form",
        description="Write diagram and study files in their canonical form and in the newest version. The "
        "meaning of a file does not change; a file with faults in its structure is left alone.",
    )
    fmt.add_argument("files", metavar="FILE", nargs="+", help="a diagram or a study; - reads stdin and writes stdout")
    fmt.add_argument("--check", action="store_true", help="write nothing; exit code 1 if a file is not canonical")
    takes_json(fmt)
    fmt.set_defaults(verb=_fmt)


def _fmt(options: argparse.Namespace) -> int:
    from ..studies.canonical import canonical
    from ..text.atomic_write import write_atomically

    if "-" in options.files and (len(options.files) > 1 or options.json):
        raise UsageError(
            Fault("E501", "-", "cannot be combined with files: - reads stdin.", "Example: `blocks fmt - < FILE`.")
        )
    status, changed = 0, 0
    for file in options.files:
        source = ("<stdin>", sys.stdin.buffer) if file == "-" else (file,)
        try:
            form = canonical(*source)
            if form.old != form.new:
                changed += 1
                status = status or (1 if options.check else 0)
                if file != "-" and not options.check:
                    with write_atomically(file, was=form.old.encode()) as stream:
                        stream.write(form.new)
        except BlocksError as error:
            tell_faults(error.faults, options.json, file=file)
            status = error.exit_status
            continue
        if file == "-" and not options.check:
            sys.stdout.write(form.new)
        elif options.json:
            emit({"event": "file", "file": file, "canonical": form.old == form.new, "version": form.version})
        elif form.old != form.new:
            what = "is not canonical" if options.check else "formatted"
            if form.version != form.newest:
                brought = f", converted from version {form.version} to {form.newest}"
                what += f", of version {form.version}" if options.check else brought
            print(printable(f"{file}: {what}"))
    if options.json:
        emit({"event": "done", "files": len(options.files), "changed": changed, "check": options.check})
    elif not changed and not status and options.files != ["-"]:
        say(f"{counted(len(options.files), 'file')} canonical")
    return status
