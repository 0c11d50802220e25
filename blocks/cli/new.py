"""`blocks new`."""

from __future__ import annotations

import argparse
import keyword
import os
import re
import sys
from collections.abc import Iterator
from importlib import resources, util
from pathlib import Path
from typing import Any

from ..text.errors import Fault, UsageError
from ..text.printable import legible
from .options import Verbs
from .output import printable

TEMPLATE = "project"
"""The folder of the files, which are data: `NAME` stands for the name, `dot-` for a dot, and each ends with `.txt`."""
SCHEMA = "schemas/diagram.schema.json"


def add(verbs: Verbs) -> None:
    new = verbs.add_parser(
        "new",
        help="make a project that runs: a block of your own, a diagram, tests",
        description="Make a folder with a project that runs at once: a module with a block type, a diagram with it, "
        "tests, a place for FMUs, a README, and what GitHub and VS Code need.",
    )
    new.add_argument(
        "name", metavar="NAME", help="the project's name, or the path of its folder, which must be new or empty"
    )
    new.add_argument("--dry-run", action="store_true", help="list the files, and create none")
    new.add_argument(
        "--adrc",
        nargs="?",
        const="linear",
        metavar="OBSERVER",
        help="make the diagram file NAME of a controller with active disturbance rejection instead; its observer is "
        "linear (unless given), reduced, generalized or cascade",
    )
    new.add_argument("--order", type=int, metavar="N", help="with --adrc: order of the plant (2)")
    new.add_argument("--by", metavar="WHAT", help="with --adrc: what the observer gets, output (unless given) or error")
    new.add_argument("--unit", metavar="UNIT", help="with --adrc: unit of r and y")
    new.add_argument("--unit-u", metavar="UNIT", help="with --adrc: unit of u")
    new.set_defaults(verb=_new)


def _new(options: argparse.Namespace) -> int:
    if options.adrc is not None:
        return _new_controller(options)
    for word in ("order", "by", "unit", "unit_u"):
        if getattr(options, word) is not None:
            raise UsageError(
                Fault("E501", f"--{word.replace('_', '-')}", "has no meaning without --adrc.", "Add --adrc.")
            )
    folder = Path(options.name)
    name = folder.name
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        what = "exists, and is not empty." if folder.is_dir() else "exists, and is a file."
        raise UsageError(Fault("E501", legible(options.name), what, "Choose another name. Nothing was written."))
    _check_name(name)
    files = {place.replace("NAME", name): text.replace("NAME", name) for place, text in _template()}
    if not options.dry_run:
        for place, text in files.items():
            _write(folder / place, text)
        _write(folder / SCHEMA, _schema(folder / f"{name}.py"))
    print(printable(f"{folder}{' would hold:' if options.dry_run else ''}"))
    for place in sorted([*files, SCHEMA]):
        print(printable(f"  {place}"))
    if not options.dry_run:
        print(printable(f"next:\n  cd {folder}\n  blocks run diagrams/loop.json --library {name} --plot loop.svg"))
        print("  python -m pip install pytest\n  python -m pytest")
    return 0


def _new_controller(options: argparse.Namespace) -> int:
    from ..api.adrc import ADRC

    path = Path(options.name)
    if path.suffix != ".json":
        cure = f"Example: blocks new {path.stem or 'control'}.json --adrc."
        raise UsageError(Fault("E501", legible(options.name), "is not a diagram file: its name ends with .json.", cure))
    if path.exists():
        raise UsageError(Fault("E501", legible(options.name), "exists.", "Choose another name. Nothing was written."))
    given = {word: value for word in ("order", "by", "unit", "unit_u") if (value := getattr(options, word)) is not None}
    made = ADRC(observer=options.adrc, **given).source
    assert not isinstance(made, str)
    if not options.dry_run:
        made.save(path)
    print(
        printable(
            f"{path}{' would hold' if options.dry_run else ':'} a controller with the inputs r, y and the output u"
        )
    )
    numbers = "b0, omega_c, omega_o, lower, upper"
    print(
        printable(f'next:\n  use it as a block: {{"diagram": "{path.name}", "parameters": {{"b0": 2, "omega_c": 4}}}}')
    )
    print(printable(f"  its parameters: {numbers}"))
    return 0


def _check_name(name: str) -> None:
    """Refuse what cannot be the name of a module of its own. Raises UsageError (E501)."""
    meant = re.sub(r"\W+", "_", name.lower(), flags=re.ASCII).strip("_")
    cure = "Choose another name. Example: blocks new robot."
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,99}", name) or keyword.iskeyword(name):
        cure = f"Did you mean {meant}?" if re.fullmatch(r"[a-z]\w*", meant) and meant != name else cure
        what = "cannot name a Python module: use small letters, digits and _, and begin with a letter."
        raise UsageError(Fault("E501", legible(name), what, cure))
    found = util.find_spec(name)  # a folder without a module has no origin
    if name in ("tests", *sys.builtin_module_names) or (found is not None and found.origin):
        raise UsageError(Fault("E501", name, "is the name of an existing Python module.", cure))


def _template() -> Iterator[tuple[str, str]]:
    """Yield the paths of the files, relative to the folder of the project, and their texts."""

    def inside(folder: Any, prefix: str) -> Iterator[tuple[str, str]]:
        for entry in sorted(folder.iterdir(), key=lambda each: str(each.name)):
            place = prefix + re.sub(r"^dot-", ".", entry.name)
            if entry.is_dir():
                yield from inside(entry, f"{place}/")
            else:
                yield place.removesuffix(".txt"), entry.read_text(encoding="utf-8")

    yield from inside(resources.files(__package__).joinpath(TEMPLATE), "")


def _write(path: Path, text: str) -> None:
    from ..text.atomic_write import write_atomically

    os.makedirs(path.parent, exist_ok=True)
    with write_atomically(path) as stream:
        stream.write(text)


def _schema(path: Path) -> str:
    """Return the JSON Schema of diagrams with the block types of the module of the template."""
    from ..api.catalog import Catalog
    from ..studies.json_schema import text_of

    spec = util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = util.module_from_spec(spec)
    writes, sys.dont_write_bytecode = sys.dont_write_bytecode, True  # a new project has no compiled copy of its module
    try:
        spec.loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = writes
    return text_of("diagram", Catalog.of(module).types)
