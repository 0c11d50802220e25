"""Reads .slx and .mdl into a tree. Nothing in a model is run: MATLAB code is text."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path

from ..host.plain_files import opened
from ..text.errors import Fault, ModelError
from .mdl import decoded, node_of
from .package import AGAIN, DIAGRAM, MARK, nodes_of_archive, nodes_of_text
from .tree import Annotation, Block, End, Line, Mask, Model, Node, System

KINDS = ("Model", "Library", "Subsystem")
MAX_TEXT = 64 * 2**20  # bytes of an .mdl
MOST_SYSTEMS = 60  # of which one lies in the other
SETTINGS = (
    "StartTime", "StopTime", "Solver", "SolverName", "SolverType", "FixedStep", "MaxStep", "MinStep", "InitialStep",
    "RelTol", "AbsTol",
)  # fmt: skip
CALLBACKS = frozenset({
    "PreLoadFcn", "PostLoadFcn", "InitFcn", "StartFcn", "PauseFcn", "ContinueFcn", "StopFcn", "PreSaveFcn",
    "PostSaveFcn", "CloseFcn", "OpenFcn", "LoadFcn", "ModelCloseFcn", "DeleteFcn", "CopyFcn", "ParentCloseFcn",
    "NameChangeFcn", "ClipboardFcn", "DestroyFcn", "PreCopyFcn", "PreDeleteFcn", "UndoDeleteFcn", "MoveFcn",
    "ErrorFcn",
})  # fmt: skip
_PORTS = ("in", "out", "enable", "trigger", "state", "lconn", "rconn", "ifaction", "reset")
_CONFIGURATIONS = ("Simulink.ConfigSet", "Simulink.ConfigSetRef")  # the latter names a variable that holds one
_MASK = ("MaskParameter", "Simulink.MaskParameter")
_ENTRY = re.compile(r"(?s)(.*)#(\w+)(?::(\d+))?")


def read_model(path: str | os.PathLike[str]) -> Model:
    """Read a Simulink model or library as it is written, from an .slx or .mdl; nothing in it is run.

    Raises:
        ModelError: E007 where the file cannot be read, E010 where it is no model of Simulink, or a damaged one.
    """
    path = Path(path)
    try:
        with opened(path) as stream:
            text = stream.read(MAX_TEXT + 1).removeprefix(b"\xef\xbb\xbf")
    except (OSError, ValueError) as error:
        what = getattr(error, "strerror", None) or str(error)
        raise ModelError(Fault("E007", str(path), f"the file cannot be read: {what}.", "Check the path.")) from None
    if text.startswith(b"PK"):
        return _model(nodes_of_archive(path), path)
    if len(text) > MAX_TEXT:
        message = f"the file has more than {MAX_TEXT:,} bytes, which is the limit."
        raise ModelError(Fault("E010", path.name, message, "Import a part of the model."))
    if text.startswith(MARK):
        return _model(nodes_of_text(text, path.name), path)
    _check_kind(text, path)
    return _model({DIAGRAM: node_of(decoded(text), path.name)}, path)


def _check_kind(text: bytes, path: Path) -> None:
    """Raise ModelError (E010) for what often has the name of a model and is none."""
    cure = "Give a model of Simulink: .slx or .mdl."
    if text.startswith(b"\0\5\x16\7"):
        message = f"it is what macOS notes about a file, not the model: {path.name.removeprefix('._')} is."
    elif text.startswith(b"version https://git-lfs"):
        message, cure = "it is a pointer of Git LFS, not the model.", "Run: git lfs pull"
    elif not text.strip():
        message = "the file is empty."
    elif b"\0" in text[:4096]:
        message = "it is neither a package nor a text."
    elif not re.search(rb"^[ \t]*(Model|Library|Subsystem)[ \t]*\{", text, re.MULTILINE):
        message = "it begins no Model and no Library."
    else:
        return
    raise ModelError(Fault("E010", path.name, message, cure))


def _model(parts: Mapping[str, Node], path: Path) -> Model:
    top = parts[DIAGRAM]
    found = next((node for node in top.walk() if node.kind in KINDS), None)
    systems = [] if found is None else found.all("System")
    if found is None or not systems:
        raise ModelError(Fault("E010", path.name, "it holds no system of blocks.", AGAIN))
    nodes = [node for part in (found, *(parts[name] for name in sorted(parts) if name != DIAGRAM)) for node in
             _outside_systems(part)]  # fmt: skip
    name = found.values.get("Name") or path.stem
    active = _active(nodes, parts)
    unread = {
        "the model workspace": found.values.get("WSDataSource") == "MDL-File" and "WSMdlFileData" in found.values,
        "the settings of the solver": active is not nodes and any(one.kind == _CONFIGURATIONS[1] for one in active),
    }
    return Model(
        name,
        path,
        found.kind,
        _settings(found, active),
        _defaults(nodes),
        _callbacks(found.values),
        _system(systems[0], (), _scripts([top, *parts.values()], name), path.name),
        found.values.get("WSMCode", ""),
        tuple(part for part, is_there in unread.items() if is_there),
    )


def _outside_systems(node: Node) -> list[Node]:
    """Return an element and all below it but for systems, whose blocks have objects of their own."""
    found, left = [], [node]
    while left:
        found.append(one := left.pop())
        left.extend(reversed([child for child in one.children if child.kind != "System"]))
    return found


def _active(nodes: list[Node], parts: Mapping[str, Node]) -> list[Node]:
    """Return the elements of the active set of settings, or all where none is marked as active."""
    for node in nodes:
        if node.kind == "ConfigSet" and node.values.get("Active") == "true":
            part = parts.get(node.values.get("PartName", "").removeprefix("/"))
            return nodes if part is None else [*part.walk()]
        if node.kind in _CONFIGURATIONS and node.values.get("PropName") == "ActiveConfigurationSet":
            number = node.values.get("ObjectID")
            same = (one for one in nodes if one.kind == node.kind and one.values.get("ObjectID") == number)
            return next(([*one.walk()] for one in same if one is not node or one.children), nodes)
    return nodes


def _settings(model: Node, nodes: list[Node]) -> dict[str, str]:
    solver = next((node.values for node in nodes if node.kind == "Simulink.SolverCC"), {})
    given = {key: solver.get(key, model.values.get(key)) for key in SETTINGS}
    return {key: value for key, value in given.items() if value is not None}


def _defaults(nodes: list[Node]) -> dict[str, Mapping[str, str]]:
    listed = [node for node in nodes if node.kind == "BlockParameterDefaults"]
    return {
        block.values["BlockType"]: {key: value for key, value in block.values.items() if key != "BlockType"}
        for node in listed
        for block in node.all("Block")
        if "BlockType" in block.values
    }


def _callbacks(values: Mapping[str, str]) -> dict[str, str]:
    return {key: value for key, value in values.items() if key in CALLBACKS and value.strip()}


def _scripts(tops: list[Node], model: str) -> dict[str, str]:
    """Return the texts of MATLAB Functions by the paths of their blocks, whose names are joined by slashes."""
    scripts, charts = {}, {}
    for top in tops:
        for chart in [node for node in top.walk() if node.kind == "chart"]:
            name = chart.values.get("name", "").removeprefix(f"{model}/")
            if chart.values.get("type") != "EML_CHART":
                continue  # of states, which may hold functions too
            script = next((node.values["script"] for node in chart.walk() if "script" in node.values), None)
            charts[chart.values.get("id", "")] = name
            if script is not None:
                scripts[name] = script
        for node in top.walk():
            if node.kind == "state" and node.values.get("chart") in charts:
                for below in node.all("eml"):
                    if "script" in below.values:
                        scripts.setdefault(charts[node.values["chart"]], below.values["script"])
    return scripts


def _system(node: Node, path: tuple[str, ...], scripts: Mapping[str, str], file: str) -> System:
    if len(path) > MOST_SYSTEMS:
        raise ModelError(Fault("E010", "/".join(path)[:200], f"systems lie more than {MOST_SYSTEMS} deep.", AGAIN))
    blocks: dict[str, Block] = {}
    sids: dict[str, str] = {}
    for child in node.all("Block") + node.all("Reference"):
        block = _block(child, path, scripts, file)
        if block.name in blocks:
            message = f"two blocks of one system have the name {block.name[:80]!r}."
            raise ModelError(Fault("E010", "/".join(path)[:200], message, AGAIN).at(child.file or file, child.line, 1))
        blocks[block.name] = block
        if block.sid:
            sids[block.sid] = block.name
    lines = [_line(child, sids, blocks) for child in node.all("Line")]
    notes = [
        Annotation(child.values.get("Name") or child.values.get("Text", ""), child.values.get("Position", ""))
        for child in node.all("Annotation")
    ]
    return System(blocks, lines, notes, node.values)


def _block(node: Node, path: tuple[str, ...], scripts: Mapping[str, str], file: str) -> Block:
    values = dict(node.values)
    for data in node.all("InstanceData"):
        values |= data.values
    for data in node.all("Array"):
        if data.values.get("Type") == "String" and "PropName" in data.values:
            values[data.values["PropName"]] = ",".join(text.values.get("", "") for text in data.children)
    kind, name = values.pop("BlockType", node.kind), values.pop("Name", "")
    sid, at = values.pop("SID", ""), (*path, name)
    systems = node.all("System")
    return Block(
        kind,
        name,
        sid,
        at,
        values,
        _ports(node),
        _system(systems[0], at, scripts, file) if systems else None,
        _mask(node),
        scripts.get("/".join(at), ""),
        _callbacks(values),
        node.file or file,
        node.line,
    )


def _ports(node: Node) -> dict[str, int]:
    counts = [child.values for child in node.all("PortCounts")]
    if counts:
        given = counts[0]
        return {
            key: int(value) for key, value in given.items() if key in _PORTS and value.isdecimal() and len(value) < 6
        }
    numbers = re.findall(r"\d{1,5}", node.values.get("Ports", ""))
    return {key: int(number) for key, number in zip(_PORTS, numbers, strict=False) if int(number)}


def _mask(node: Node) -> Mask | None:
    masks = [child for child in node.children if child.kind in ("Mask", "Simulink.Mask")]
    values = node.values
    if masks:
        mask = masks[0]
        given = [below for below in _parameters(mask) if "Name" in below.values]
        parameters = {below.values["Name"]: below.values.get("Value", "") for below in given}
        return Mask(mask.values.get("Type", ""), parameters, mask.values.get("Initialization", ""))
    if "MaskVariables" not in values and "MaskType" not in values:
        return None
    texts = [text.replace("\\|", "|") for text in re.split(r"(?<!\\)\|", values.get("MaskValueString", ""))]
    numbered = re.findall(r"\b(\w+)=[@&](\d+);", values.get("MaskVariables", ""))
    parameters = {name: texts[int(k) - 1] for name, k in numbered if 0 < int(k[:5]) <= len(texts)}
    return Mask(values.get("MaskType", ""), parameters, values.get("MaskInitialization", ""))


def _parameters(mask: Node) -> list[Node]:
    found = []
    for child in mask.children:
        if child.kind in _MASK:
            found.append(child)
        elif child.values.get("PropName") == "Parameters" or child.values.get("Type") == "Simulink.MaskParameter":
            found.extend(child.children)
    return found


def _line(node: Node, sids: Mapping[str, str], blocks: Mapping[str, Block]) -> Line:
    targets: list[End] = []
    open_ends, left = 0, [node]
    while left:
        one = left.pop()
        branches = one.all("Branch")
        end = _end(one.values, "Dst", sids, blocks)
        if end is not None:
            targets.append(end)
        elif not branches:
            open_ends += 1
        left.extend(reversed(branches))
    name = node.values.get("Name", "")
    return Line(_end(node.values, "Src", sids, blocks), tuple(targets), name, open_ends, node.file, node.line)


def _end(values: Mapping[str, str], side: str, sids: Mapping[str, str], blocks: Mapping[str, Block]) -> End | None:
    entry = _ENTRY.fullmatch(values.get(side, ""))
    if entry:
        kind, number = entry[2], entry[3] or ""
        name, port = sids.get(entry[1], ""), number if kind in ("in", "out") else kind.lower()
        if kind in ("lconn", "rconn"):
            port += number
    else:
        name, port = values.get(f"{side}Block", ""), values.get(f"{side}Port", "").lower()
    return End(name, port or "1") if name in blocks else None
