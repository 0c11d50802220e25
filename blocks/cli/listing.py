"""`blocks list`."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import TYPE_CHECKING

from ..text.errors import Fault, UsageError
from ..text.printable import aligned
from .options import Verbs, takes_json, takes_library
from .output import emit, printable

if TYPE_CHECKING:
    from ..api.catalog import Catalog, Found, Sheet, Word


def add(verbs: Verbs) -> None:
    listing = verbs.add_parser(
        "list",
        help="list the block library, or describe one block",
        description="List all block types or a group of them, show the ports and parameters of one type, or "
        "search for words.",
    )
    what = "a block type, a group of types, an FMU, `measures`, or a Simulink term"
    listing.add_argument("block", metavar="BLOCK", nargs="?", help=what)
    listing.add_argument(
        "--search", metavar="TEXT", help="find block types whose text contains these words; Simulink terms work too"
    )
    takes_json(listing)
    listing.set_defaults(verb=_list)
    takes_library(listing)


def _list(options: argparse.Namespace) -> int:
    from ..api.catalog import Catalog, measures, word_of

    catalog = Catalog.of(options.library)
    if options.block == "measures":
        for name, what in measures().items():
            if options.json:
                emit({"measure": name, "doc": what})
            else:
                print(f"{name.ljust(16)}  {what}")
        return 0
    if options.search is not None:
        return _found(catalog, options)
    groups = catalog.groups()
    if options.block is None or (options.block in groups and options.block not in catalog.types):
        width = max(map(len, catalog.types))
        for group, members in groups.items():
            if options.block not in (None, group):
                continue
            if not options.json:
                print(f"{group}")
            _rows(members, width, options.json)
        return 0
    word = None if options.block in catalog.types else word_of(options.block)
    if word is not None:
        _tell_words([word], options.json)
    else:
        _tell(catalog.sheet(options.block), options.json)
    return 0


def _found(catalog: Catalog, options: argparse.Namespace) -> int:
    """Print what `--search` finds. Raises UsageError (E501) if it finds nothing."""
    if options.block is not None or not options.search.split():
        what, cure = (
            "takes one text, and cannot be combined with a block type.",
            'Example: blocks list --search "rate limit".',
        )
        raise UsageError(Fault("E501", f"--search {options.search}", what, cure))
    found, words = catalog.search(options.search)
    if not found and not words:
        message, cure = "matches no block type and no Simulink term.", "`blocks list` shows all types."
        raise UsageError(Fault("E501", f"--search {options.search}", message, cure))
    _rows(found, max((len(each.name) for each in found), default=0), options.json)
    _tell_words(words, options.json)
    return 0


def _rows(found: Iterable[Found], width: int, as_json: bool) -> None:
    for name, group, doc, words in found:
        if as_json:
            emit({"type": name, "group": group, "doc": doc, **({"simulink": list(words)} if words else {})})
        else:
            told = f"  (Simulink: {', '.join(words)})" if words else ""
            print(printable(f"  {name.ljust(width)}  {doc}{told}"))


def _tell_words(words: Iterable[Word], as_json: bool) -> None:
    """Print the entries for words of Simulink."""
    for word in words:
        if as_json:
            emit({"simulink": word.name, "here": word.here, "blocks": list(word.blocks), "see": word.see})
            continue
        print(printable(f"Simulink's {word.name}: {word.here}"))
        for name in word.blocks:
            print(printable(f"  blocks list {name}"))
        print(printable(f"  documentation: {word.see}"))


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
        lines += ["", "* depends on the structural parameters, which set the unit"]
    print(printable("\n".join(lines)))
