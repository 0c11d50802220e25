"""What can be inserted into a diagram: block types with their pictures, what stands for a word of Simulink, files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

from ..api.catalog import Catalog, sheet_of
from ..contract.block import Block
from ..draw.shapes import Shape, block_shape, num
from ..model.simulink import words

MOST_FILES, MOST_LOOKED_AT, DEEPEST = 200, 20_000, 3
"""Files that are listed, and those that are looked at for them, in folders so deep."""
FIRST = ("sources", "arithmetic", "continuous", "pid", "adrc", "nonlinear", "sampled", "discrete", "logic", "wiring")
"""Groups that are listed before the others, which follow by name."""
Entry = dict[str, Any]


def files_in(folder: Path, ending: str) -> Iterator[Path]:
    """The files with an ending in a folder and in those in it, without hidden ones."""
    yield from islice((path for path in _files(folder) if path.suffix == ending), MOST_FILES)


def _files(folder: Path) -> Iterator[Path]:
    seen = 0
    for at, folders, files in os.walk(folder):
        depth = len(Path(at).relative_to(folder).parts)
        folders[:] = sorted(name for name in folders if not name.startswith(".")) if depth < DEEPEST else []
        seen += len(folders) + len(files)
        if seen > MOST_LOOKED_AT:
            return
        yield from (Path(at, name) for name in sorted(files) if not name.startswith("."))


def is_diagram(path: Path) -> bool:
    """Whether a file begins as diagrams do."""
    with suppress(OSError):
        if path.is_file():
            with path.open("rb") as stream:
                return b'"blocks-diagram"' in stream.read(200)
    return False


def diagrams_in(folder: Path) -> Iterator[Path]:
    """The diagrams in a folder and in those in it."""
    return filter(is_diagram, files_in(folder, ".json"))


def files_beside(file: Path, project: Path) -> Iterator[Entry]:
    """The other diagrams and the FMUs of the project of a diagram file, named as its blocks name them."""
    for kind, found in (("diagram", diagrams_in(project)), ("fmu", files_in(project, ".fmu"))):
        for path in found:
            if path != file:
                name = Path(os.path.relpath(path, file.parent)).as_posix()
                yield {kind: name, "group": f"{kind}s of this project", "doc": path.name}


def entries_of(catalog: Catalog) -> Iterator[Entry]:
    """The block types by group, each with its picture, its parameters and its names in Simulink; then other words.

    A word for which no block stands is told, and cannot be inserted.
    """
    groups = catalog.groups()
    for group in sorted(groups, key=lambda name: FIRST.index(name) if name in FIRST else len(FIRST)):
        for found in groups[group]:
            names = [word.name for word in words().values() if found.name in word.blocks]
            told = {"type": found.name, "group": group, "doc": found.doc.replace("`", ""), "words": names}
            yield told | _sheet(catalog.types[found.name])
    for word in words().values():
        if not word.blocks:
            yield {"word": word.name, "group": "words of Simulink", "doc": word.here.replace("`", "")}


def _sheet(cls: type[Block]) -> Entry:
    sheet = sheet_of(cls)
    inputs, outputs = ([port.name for port in row] for row in (sheet.inputs, sheet.outputs))
    shape = block_shape(sheet.name, lambda _: None, inputs, outputs)
    return {"takes": [row.name for row in sheet.parameters], "picture": _picture(sheet.name, shape)}


def _picture(name: str, shape: Shape) -> Entry:
    """The strokes of a block with short wires at its ports, and the texts that are no names of ports."""
    strokes = [[stroke.style, stroke.d] for stroke in shape.strokes]
    for port, (x, y) in shape.inputs.items():
        strokes.append(["line", f"M{num(x)} {num(y)}{'v' if port == shape.under else 'h-'}8"])
    strokes += [["line", f"M{num(x)} {num(y)}h8"] for x, y in shape.outputs.values()]
    texts = [text for text in shape.texts if text.style != "port" and text.text != name]
    told = [[num(text.x), num(text.y), num(text.size), text.anchor, text.text] for text in texts]
    return {"size": [shape.width, shape.height], "strokes": strokes, "texts": told}
