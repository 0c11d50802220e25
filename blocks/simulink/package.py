"""Parts of a model in XML: the ZIP of an .slx, and the text packages that newer releases write as .mdl."""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from ..fmi.archive import Archive
from ..fmi.xmltree import Element, parse
from ..text.errors import Fault, FMUError, ModelError
from .tree import Node

DIAGRAM = "simulink/blockdiagram.xml"
MARK = b"# MathWorks OPC Text Package"
MAX_PART = 64 * 2**20  # bytes of one part
MAX_PARTS = 2 * MAX_PART  # bytes of all parts that are read
MOST_ELEMENTS = 2_000_000  # of all of them
DEEPEST = 60  # systems in systems
AGAIN = "Save the model again, or take a copy that is whole."
_PART = re.compile(rb"^__MWOPC_PART_BEGIN__ /(\S+)([^\S\n][^\n]*)?\n", re.MULTILINE)
_END = re.compile(rb"^__MWOPC_PA(?:RT_BEGIN|CKAGE_END)__", re.MULTILINE)

Read = Callable[[str], bytes]


def nodes_of_archive(path: Path) -> dict[str, Node]:
    """Return the parts of an .slx that describe the model, by their names. Raises ModelError (E007, E010)."""
    try:
        with Archive(path, DIAGRAM) as archive:
            return _nodes(archive.files, lambda name: archive.read(name, MAX_PART), path.name)
    except FMUError as error:
        raise unreadable(error) from None


def nodes_of_text(text: bytes, name: str) -> dict[str, Node]:
    """Return the same of a text package. Raises ModelError (E010)."""
    parts: dict[str, bytes] = {}
    for begin in _PART.finditer(text):
        end = _END.search(text, begin.end())
        part = text[begin.end() : end.start() if end else len(text)]
        if b"BASE64" in (begin[2] or b""):
            try:
                part = base64.b64decode(part)
            except binascii.Error:
                part = b""
        parts.setdefault(begin[1].decode("utf-8", "replace"), part)
    if DIAGRAM not in parts:
        raise ModelError(Fault("E010", name, f"the package holds no {DIAGRAM}.", AGAIN))
    return _nodes(parts, parts.__getitem__, name)


def unreadable(error: FMUError) -> ModelError:
    """Return the error of a model for one of an archive or of XML."""
    return ModelError(*(replace(fault, code="E010", cure=AGAIN) for fault in error.faults))


def _nodes(names: Iterable[str], read: Read, name: str) -> dict[str, Node]:
    known = sorted(set(names))
    wanted = [part for part in known if part.startswith("simulink/") and part.endswith(".xml") and _is_model(part)]
    nodes: dict[str, Node] = {}
    room, left = MAX_PARTS, MOST_ELEMENTS
    try:
        for part in wanted:
            text = read(part)
            room -= len(text)
            nodes[part] = _node(parse(text, f"{name}/{part}", with_text=True), part)
            left -= sum(1 for _ in nodes[part].walk())
            if room < 0 or left < 0:
                message = f"its parts have more than {MAX_PARTS:,} bytes or {MOST_ELEMENTS:,} elements together."
                raise ModelError(Fault("E010", name, message, "Import a part of the model."))
    except FMUError as error:
        raise unreadable(error) from None
    _join(nodes[DIAGRAM], nodes, 0)
    return nodes


def _is_model(part: str) -> bool:
    """Tell whether a part may say something of the model, and not of windows, plots and interfaces."""
    within = part.removeprefix("simulink/")
    return within.startswith(("systems/", "stateflow", "configSet")) or within in ("blockdiagram.xml", "bddefaults.xml")


def _node(element: Element, file: str) -> Node:
    tag, attributes, children, line = element
    if children:
        attributes.pop("", None)  # blanks between its children
    node = Node(attributes.get("ClassName", tag) if tag == "Object" else tag, attributes, [], file, line)
    for child in children:
        name, given, below, _ = child
        text = given.get("", "")
        if name == "P" and "Name" in given:
            # A value that is a part of its own is not read: the name of the part is no value that MATLAB can have.
            node.values.setdefault(given["Name"], text or given.get("Ref", ""))
            continue
        if text and not below:
            node.values.setdefault(name, text)
        node.children.append(_node(child, file))
    return node


def _join(node: Node, parts: dict[str, Node], depth: int) -> None:
    """Put the systems that are parts of their own where they are referred to; each is taken once."""
    if depth > DEEPEST:
        raise ModelError(Fault("E010", node.file, f"systems lie more than {DEEPEST} deep.", AGAIN))
    for system in [child for child in node.walk() if child.kind == "System" and "Ref" in child.values]:
        name = system.values.pop("Ref")
        part = parts.pop(f"simulink/systems/{name}.xml", None)
        if part is None:
            message = f"the system {name[:80]!r} is no part of the package, or two blocks refer to it."
            raise ModelError(Fault("E010", "", message, AGAIN).at(system.file, system.line, 1))
        system.values |= part.values
        system.children, system.file, system.line = part.children, part.file, part.line
        _join(system, parts, depth + 1)
