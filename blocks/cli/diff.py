"""`blocks diff`."""

from __future__ import annotations

import argparse
import os
import sys
from typing import TYPE_CHECKING

from ..text.errors import Fault, ModelError, UsageError
from ..text.printable import counted
from .options import Verbs, takes_json, takes_library
from .output import emit, printable, say

if TYPE_CHECKING:
    from ..api.comparing import Readable

STDIN = "-"
MOST_BYTES = 2**25  # of stdin; the reader refuses what is larger than 16 MiB


def add(verbs: Verbs) -> None:
    diff = verbs.add_parser(
        "diff",
        help="show the differences between two diagrams",
        description="Show the differences between diagram A and diagram B: blocks, wires, inputs, outputs, "
        "parameters, run "
        "settings, measures, in subdiagrams too. Layout, the order of entries and the spelling of numbers do "
        "not count. Exit code 0 if there are no differences, 1 if there are some.",
    )
    diff.add_argument(
        "a", metavar="A", help="a diagram file (JSON); - for stdin, read as if it lay in the folder of the other file"
    )
    diff.add_argument("b", metavar="B", nargs="?", help="the other diagram")
    diff.add_argument("rest", nargs="*", help=argparse.SUPPRESS)  # what git gives beyond its two files
    diff.add_argument(
        "--svg", metavar="FILE.svg", help="draw both in one picture that marks what was added, removed and changed"
    )
    diff.add_argument("--depth", metavar="N", type=int, help="levels of subdiagrams that --svg opens (default: all)")
    diff.add_argument("--doc", action="store_true", help="compare doc texts and keys x-... as well")
    takes_json(diff)
    diff.add_argument("--git", action="store_true", help="take the arguments that git passes to its diff.NAME.command")
    takes_library(diff)
    diff.set_defaults(verb=_diff)


def _diff(options: argparse.Namespace) -> int:
    if options.svg and not options.svg.lower().endswith(".svg"):
        raise UsageError(
            Fault("E501", options.svg, "the format is not supported: diff draws SVG only.", "Name it FILE.svg.")
        )
    if options.depth is not None and not 1 <= options.depth <= 30:
        raise UsageError(Fault("E501", f"--depth {options.depth}", "must be 1 to 30: the number of levels to open."))
    if options.git:
        return _for_git(options)
    if options.b is None:
        raise UsageError(Fault("E501", "blocks diff", "needs two diagrams to compare.", "Give two files."))
    if options.rest:
        place = f"blocks diff: {' '.join(options.rest)[:200]}"
        raise UsageError(Fault("E501", place, "more than two files were given.", "Give two files."))
    if options.a == options.b == STDIN:
        raise UsageError(Fault("E501", "-", "both diagrams cannot come from stdin.", "Give a file for one of them."))
    folders = [os.path.dirname(path) if path != STDIN else "" for path in (options.b, options.a)]
    a, b = (_read(path, folder) for path, folder in zip((options.a, options.b), folders, strict=True))
    names = ["<stdin>" if path == STDIN else path for path in (options.a, options.b)]
    status = _tell(options, a, b, (names[0], names[1]))
    return ModelError.exit_status if a[1] or b[1] else status


def _for_git(options: argparse.Namespace) -> int:
    """PATH OLD-FILE OLD-HEX OLD-MODE NEW-FILE NEW-HEX NEW-MODE [NEW-PATH ...], in the topmost folder of the tree.

    A difference is no failure for git, and neither is a file that is no diagram: the other files are still to come.
    """
    given = [options.a, *([options.b] if options.b is not None else []), *options.rest]
    if len(given) == 1:  # a merge that is not settled
        print(printable(f"{given[0]} is not merged"))
        return 0
    if len(given) not in (7, 8, 9):
        cure = 'Let git call it: git config diff.blocks.command "blocks diff --git".'
        raise UsageError(
            Fault("E501", "--git", f"{counted(len(given), 'argument')} were given; git passes seven.", cure)
        )
    old, new = given[1], given[4]
    path = given[7] if len(given) > 7 else given[0]  # renamed
    try:
        # Git puts an old version into a folder for temporary files; its subdiagrams lie where the path says.
        names = f"a/{given[0]}", f"b/{path}"
        a, b = (_read(file, os.path.dirname(path), shown=name) for file, name in zip((old, new), names, strict=True))
        _tell(options, a, b, names)
    except ModelError as error:
        say(f"{path} is not compared as a diagram:")
        for fault in error.faults[:3]:
            say(f"  {fault}")
    return 0


def _read(path: str, folder: str, *, shown: str = "") -> Readable:
    """Read the diagram of a file, and its faults.

    folder: where the paths of a text from stdin begin, and of a file that is called `shown`.
    """
    from ..api.comparing import nothing, readable

    if path == os.devnull:  # what git gives for a file that is not there
        return nothing()
    name = shown or ("<stdin>" if path == STDIN else path)
    if shown or path == STDIN:
        value, faults = readable(name, _bytes(path), folder=folder)
    else:
        value, faults = readable(path)
    if faults:
        say(f"{name} has {counted(len(faults), 'fault')}: only the readable part is compared")
        for fault in faults[:3]:
            say(f"  {fault}")
        if len(faults) > 3:
            say(f"  and {len(faults) - 3} more: see `blocks check`")
    return value, faults


def _bytes(path: str) -> bytes:
    if path == STDIN:
        return sys.stdin.buffer.read(MOST_BYTES)
    try:
        with open(path, "rb") as stream:
            return stream.read(MOST_BYTES)
    except OSError as error:
        raise ModelError(Fault("E007", path, f"cannot be read: {error.strerror}.")) from None


def _tell(options: argparse.Namespace, a: Readable, b: Readable, names: tuple[str, str]) -> int:
    from ..api.comparing import compared
    from ..text.atomic_write import write_atomically

    diff = compared(a[0], b[0], names=names, doc=options.doc, library=options.library)
    has_faults = bool(a[1] or b[1])  # so that the two may differ in more than is reported
    if options.svg:
        text = diff.svg(depth=options.depth)
        with write_atomically(options.svg) as stream:
            stream.write(text)
    if options.json:
        for difference in diff:
            emit({"event": "difference", **difference.entry()})
        emit({"event": "done", "equal": None if has_faults else not diff, "differences": len(diff), **diff.counts})
    else:
        print(printable(str(diff)))
        if has_faults:
            say("the unreadable part was not compared")
        if options.svg:
            print(options.svg)
    return 1 if diff else 0
