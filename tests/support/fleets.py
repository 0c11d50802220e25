"""Diagrams with copies, and the same diagrams written out by hand: blocks one by one, wires between elements."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

__all__ = ["named_by_hand", "written_out"]

Document = dict[str, Any]


def written_out(document: Mapping[str, Any], vectors: frozenset[str] = frozenset()) -> Document:
    """The document of a diagram without copies that means the same.

    vectors: the sources outside of copies that have an element for each copy. Copies are numbers, and expressions in
    their parameters are those of Python.
    """
    counts = {name: entry["copies"] for name, entry in document["blocks"].items() if "copies" in entry}
    blocks: Document = {}
    for name, entry in document["blocks"].items():
        inner = {"diagram": written_out(entry["diagram"], vectors)} if "diagram" in entry else {}
        if name not in counts:
            blocks[name] = {**entry, **inner}
        for index in range(counts.get(name, 0)):
            given = {key: _own(raw, index, counts[name]) for key, raw in entry.get("parameters", {}).items()}
            own = {"stream": f"{name}[{index}]"} if "Noise" in str(entry) else {}
            kept = {key: value for key, value in entry.items() if key != "copies"}
            blocks[f"{name}_{index}"] = {**kept, **inner, **own, "parameters": given}
    wires: dict[str, str] = {}
    for sink, source in document.get("wires", {}).items():
        block, _, port = sink.partition(".")
        from_block = source.partition(".")[0]
        count = counts.get(block) or counts.get(from_block, 0)
        if block in counts and source.endswith("]") and not sink.endswith("]"):
            wires |= {f"{block}_{index}.{port}": _one(source, counts) for index in range(count)}
        elif sink.endswith("]") or source.endswith("]"):
            wires[_one(sink, counts)] = _one(source, counts)
        elif block in counts:
            for index in range(count):
                outside = f"{source}[{index}]" if source in vectors else source
                wires[f"{block}_{index}.{port}"] = _at(source, index) if from_block in counts else outside
        elif from_block in counts:
            for index in range(count):
                wires[f"{sink}[{index}]"] = _at(source, index)
        else:
            wires[sink] = source
    outputs = {name: _one(source, counts) for name, source in document.get("outputs", {}).items()}
    return {**document, "blocks": blocks, "wires": wires, "outputs": outputs}


def named_by_hand(name: str) -> str:
    """The name that a signal has where it is written out: "robots[3].y" -> "robots_3.y"."""
    return re.sub(r"\[(\d+)\](?=\.)", r"_\1", name)


def named_by_number(name: str) -> str:
    return re.sub(r"_(\d+)(?=\.)", r"[\1]", name)


def _own(raw: Any, index: int, copies: int) -> Any:
    if isinstance(raw, list):
        return raw[index]
    reads = isinstance(raw, str) and re.search(r"\b(index|copies)\b", raw)
    return eval(raw[1:], {"index": index, "copies": copies}) if reads else raw


def _one(text: str, counts: Mapping[str, int]) -> str:
    """An end of a wire; an element of copies is that of one block."""
    name, _, port = text.partition(".")
    match = re.fullmatch(r"(.*)\[(\d+)\]", port)
    return f"{name}_{match[2]}.{match[1]}" if match and name in counts else text


def _at(text: str, index: int) -> str:
    name, _, port = text.partition(".")
    return f"{name}_{index}.{port}"
