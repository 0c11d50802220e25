"""`blocks fmt`."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

from ..text.errors import BlocksError, Fault, UsageError
from .output import counted, emit, printable, say, tell_faults

__all__ = ["add"]


def add(verbs: Any) -> None:
    fmt = verbs.add_parser(
        "fmt",
        help="write diagram and study files in their canonical form",
        description="Write diagram and study files in their canonical form and in the newest version. What a file says "
        "stays as it is; one whose structure has faults is left alone.",
    )
    fmt.add_argument("files", metavar="FILE", nargs="+", help="a diagram or a study; - reads stdin and writes stdout")
    fmt.add_argument("--check", action="store_true", help="write nothing; exit code 1 where a file is not canonical")
    fmt.add_argument("--json", action="store_true", help="one JSON object per line")
    fmt.set_defaults(verb=_fmt)


def _fmt(options: argparse.Namespace) -> int:
    from ..model.diagram import VERSION
    from ..text.atomic_write import write_atomically

    if "-" in options.files and (len(options.files) > 1 or options.json):
        raise UsageError(Fault("E501", "-", "stdin stands alone.", "As in `blocks fmt - < FILE`."))
    status, changed = 0, 0
    for file in options.files:
        try:
            old, new, version = _canonical(file)
            if old != new:
                changed += 1
                status = status or (1 if options.check else 0)
                if file != "-" and not options.check:
                    with write_atomically(file, was=old.encode()) as stream:
                        stream.write(new)
        except BlocksError as error:
            tell_faults(error.faults, options.json, file=file)
            status = error.exit_status
            continue
        if file == "-" and not options.check:
            sys.stdout.write(new)
        elif options.json:
            emit({"event": "file", "file": file, "canonical": old == new, "version": version})
        elif old != new:
            what = "is not canonical" if options.check else "formatted"
            what += f", of version {version}" if version != VERSION and options.check else ""
            what += f", brought from version {version} to {VERSION}" if version != VERSION and not options.check else ""
            print(printable(f"{file}: {what}"))
    if options.json:
        emit({"event": "done", "files": len(options.files), "changed": changed, "check": options.check})
    elif not changed and not status and options.files != ["-"]:
        say(f"{counted(len(options.files), 'file')} canonical")
    return status


def _canonical(file: str) -> tuple[str, str, int]:
    """The text of a file, its canonical text, and its version."""
    from ..model.document import MAX_BYTES, canonical, read_inside
    from ..model.project import Project
    from ..studies import study
    from ..text import json_text

    if file == "-":
        name, data = "<stdin>", sys.stdin.buffer.read(MAX_BYTES + 1)
    else:
        name, data = file, read_inside(Path(file), Project(Path(os.path.realpath(file)).parent), Fault("E007", "", ""))
    document = json_text.read(data, file=name)
    is_study = isinstance(document.value, dict) and document.value.get("format") == study.FORMAT
    new, version = (study.canonical if is_study else canonical)(document)
    return document.text, new, version
