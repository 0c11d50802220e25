"""`blocks schema`."""

from __future__ import annotations

import argparse

from .options import Verbs, takes_library


def add(verbs: Verbs) -> None:
    schema = verbs.add_parser(
        "schema",
        help="print the JSON Schema of diagram or study files, for editors",
        description="Print the JSON Schema (draft 2020-12) with which editors complete and check diagram files, "
        "or study files. It contains the block types of the library and of --library.",
    )
    schema.add_argument(
        "kind", metavar="diagram|study", nargs="?", choices=("diagram", "study"), default="diagram",
        help="the kind of file (default: diagram)",
    )  # fmt: skip
    schema.add_argument("-o", "--out", metavar="FILE", help="the file to write (default: stdout)")
    schema.set_defaults(verb=_schema)
    takes_library(schema)


def _schema(options: argparse.Namespace) -> int:
    from ..api.catalog import Catalog
    from ..studies.json_schema import text_of
    from ..text.atomic_write import write_atomically

    text = text_of(options.kind, Catalog.of(options.library).types)
    if options.out in (None, "-"):
        print(text, end="")
        return 0
    with write_atomically(options.out) as stream:
        stream.write(text)
    print(options.out)
    return 0
