"""Diagrams with copies, and the same diagrams written out by hand: blocks one by one, wires between elements."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from blocks.contract.resolution import Resolved
from blocks.text.errors import BlocksError
from tests.support.library_variants import Array, resolved

__all__ = ["beside_copies", "inputs_beside_copies", "named_by_hand", "named_by_number", "other_values", "written_out"]

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


# --- equal blocks beside copies ---------------------------------------------------------------------------------------

AGENT: Document = {
    "parameters": {"a": 0.5}, "inputs": {"u": {"default": 0.3}}, "outputs": {"y": "out.y"},
    "blocks": {
        "wave": {"type": "SecondOrder", "parameters": {"w": "=5+a", "v_start": 3}},
        "relay": {"type": "Relay", "parameters": {"on_at": 0.1, "off_at": "=-a"}},
        "sum": {"type": "Sum", "parameters": {"signs": "+-"}},
        "table": {"type": "LookupTable", "parameters": {"points": [-1, 0, 0.5, 1], "values": [-2, 0, 1, 3]}},
        "hold": {"type": "UnitDelay", "parameters": {"period": 0.05}},
        "out": {"type": "FirstOrder", "parameters": {"T": "=a"}},
    },
    "wires": {"wave.u": "u", "relay.u": "wave.y", "sum.u1": "relay.y", "sum.u2": "table.y", "table.u": "out.y",
              "hold.u": "sum.y", "out.u": "hold.y"},
}  # fmt: skip
"""It has places in every row of memory, and a table."""

_TIMES = frozenset({"period", "offset", "period_u", "delay", "duration", "stream"})
_POSITIVE, _SMALL = ("Log", "Power", "Sqrt"), ("asin", "acos", "atanh")


def _numbers(name: str, given: Mapping[str, Any]) -> tuple[Resolved, list[str]]:
    """A block, and its parameters that may have other values: real numbers that follow from no other."""
    made = resolved(name, dict(given))
    declared = made.interface.declaration.parameters
    keys = [
        key
        for key in made.interface.symbolic_parameters
        if key not in _TIMES
        and declared[key].type == "real"
        and not declared[key].members
        and (key in given or not callable(declared[key].default))
    ]
    return made, keys


def _moved(name: str, given: Mapping[str, Any], factor: float) -> Document:
    """The parameters of a block that the type lets be larger by a factor."""
    made, keys = _numbers(name, given)
    moved = dict(given)
    for key in keys:
        value = (np.asarray(made.values[key].value) * factor + (factor - 1.0) * key.endswith("_start")).tolist()
        try:
            resolved(name, {**moved, key: value})
        except BlocksError:
            continue
        moved[key] = value
    return {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in moved.items()}


def beside_copies(entries: Sequence[tuple[str, Mapping[str, Any]]], count: int, where: Collection[str]) -> Document:
    """Equal blocks of each entry, "b0n0", "b0n1" ..., with numbers of their own and common inputs, beside copies.

    where: copies come "first", "last", "between" equal blocks.
    """

    def fleet(tag: str, copies: int) -> Document:
        agents = {"copies": copies, "diagram": AGENT, "parameters": {"a": "=0.2+0.3*index"}}
        gains = {"copies": copies + 1, "type": "Gain", "parameters": {"k": "=2+index"}}
        return {f"agents{tag}": agents, f"gains{tag}": gains} if tag in where else {}

    inputs: Document = {}
    wires: dict[str, str] = {}
    rows: list[Document] = []
    for n, (name, given) in enumerate(entries):
        kind = "positive" if name in _POSITIVE else "small" if given.get("function") in _SMALL else "plain"
        kind = "large" if given.get("function") == "acosh" else kind
        for port in resolved(name, dict(given)).interface.inputs.values():
            entry = {"type": port.type, **({"size": port.size} if port.shape else {})}
            inputs[f"{kind}{n}_{port.name}"] = entry | ({"unit": port.unit} if port.unit else {})
            wires |= {f"b{n}n{k}.{port.name}": f"{kind}{n}_{port.name}" for k in range(count)}
        moved = [_moved(name, given, 1 + 0.03 * k) for k in range(count)]
        rows.append({f"b{n}n{k}": {"type": name, "parameters": own} for k, own in enumerate(moved)})
    blocks = {"wave": {"type": "Sine"}, **fleet("first", 3)}
    for first, last in ((0, count // 2), (count // 2, count)):
        for row in rows:
            blocks |= dict([*row.items()][first:last])
        blocks |= fleet("last" if first else "between", 4 if first else 2)
    wires |= {f"{name}.u": "wave.y" for name in blocks if name.startswith("gains")}
    return {"format": "blocks-diagram", "version": 3, "inputs": inputs, "blocks": blocks, "wires": wires}


def inputs_beside_copies(document: Mapping[str, Any]) -> dict[str, tuple[Array, Array, str]]:
    """Inputs that move, within what their blocks can take."""
    made: dict[str, tuple[Array, Array, str]] = {}
    t, plain = np.array([0.0, 0.31, 0.62, 0.95]), np.array([0.3, 1.7, -0.8, 0.9])
    for number, (name, entry) in enumerate(document["inputs"].items()):
        kind = re.match("[a-z]+", name)
        assert kind is not None
        forms = {"positive": abs(plain), "small": plain / 3, "large": plain + 2.5}
        u = forms.get(kind[0], plain + 0.1 * (number % 7))
        columns = np.column_stack([u + 0.2 * k for k in range(entry.get("size", 1))])
        made[name] = t, columns if "size" in entry else u, "linear"
        if entry["type"] == "bool":
            made[name] = t, np.array([0.0, 1.0, 0.0, 1.0]), "hold"
    return made


def other_values(document: Mapping[str, Any], factor: float = 1.02) -> dict[str, Any]:
    """Other values of a parameter of each block outside of copies, by path."""
    values: dict[str, Any] = {}
    for block, entry in document["blocks"].items():
        if "copies" not in entry and entry.get("parameters"):
            old, new = entry["parameters"], _moved(entry["type"], entry["parameters"], factor)
            values |= {f"{block}.{key}": new[key] for key in new if key not in old or new[key] != old[key]}
    return values
