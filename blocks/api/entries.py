"""What a person adds to a diagram, as entries: what a file would say of it, checked as a file is."""

from __future__ import annotations

import builtins
import contextlib
import enum
import inspect
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..contract.block import Block
from ..contract.enumerations import Enumeration, enumeration_of
from ..contract.interface import Port
from ..model import document as documents
from ..model.diagram_value import BlockEntry, is_name
from ..model.raw_values import given_value, raw_of
from ..text import units
from ..text.errors import Fault, UsageError
from ..text.printable import quoted
from ..text.quantity_text import read_quantity

# --- names -----------------------------------------------------------------------------------------------------


def as_name(text: str) -> str:
    """A text as a name: a port of an FMU, as an input or an output of a diagram."""
    name = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_")
    return name if is_name(name) else f"_{name}"[:200]


# --- parameters and inputs -------------------------------------------------------------------------------------


def parameter_entry(value: object, unit: str, doc: str) -> object:
    """The entry of a parameter of a diagram: its value alone, where there is nothing else to say of it."""
    entry = raw_of(value)
    if unit or doc:
        entry = dict(entry) if isinstance(entry, dict) else {"value": entry}
        entry |= {**({"unit": unit} if unit else {}), **({"doc": doc} if doc else {})}
    return entry


def input_entry(
    unit: str, default: object, size: object, type: str | builtins.type[enum.IntEnum] | Enumeration, doc: str
) -> dict[str, object]:
    """The entry of an input of a diagram. Arguments as of `Diagram.input`."""
    kind = Enumeration.of(type) if isinstance(type, builtins.type) and issubclass(type, enum.IntEnum) else type
    entry: dict[str, object] = {} if unit == "" else {"unit": unit}
    if default is not None:
        entry["default"] = read_quantity(raw_of(default)) if kind in ("real", "int") else _named(raw_of(default), kind)
    entry |= {} if size is None else {"size": raw_of(size)}
    entry |= {} if kind == "real" else {"type": kind.entry if isinstance(kind, Enumeration) else kind}
    entry |= {} if doc == "" else {"doc": doc}
    return entry


def input_like(port: Port) -> dict[str, Any]:
    """What `Diagram.input` is to be given for an input that stands for this one."""
    unit = port.declared[0] if port.declared else ""
    kind: str | Enumeration = enumeration_of(port.type) or port.type
    default: object = None
    if port.default is not None:
        values = [item != 0.0 if kind == "bool" else units.from_si(item, unit) for item in port.default]
        default = np.reshape(values, port.shape) if len(set(values)) > 1 else values[0]
    size = (port.shape[0] if len(port.shape) == 1 else port.shape) if port.shape else None
    return {"unit": unit, "size": size, "type": kind, "default": default}


def _named(raw: Any, kind: object) -> object:
    """Members of an enumeration, as files have them: by name."""
    if isinstance(raw, list):
        return [_named(item, kind) for item in raw]
    known = kind.names if isinstance(kind, Enumeration) and not isinstance(raw, (str, bool)) else {}
    return known.get(raw, raw)


# --- blocks ----------------------------------------------------------------------------------------------------


def block_entry(name: str, block: object, folder: str) -> tuple[dict[str, object], BlockEntry]:
    """The values that a Block is given, and its entry without them. folder: where the paths of FMUs begin.

    Raises UsageError (E501) for what is no Block.
    """
    if inspect.isclass(block):
        cure = f"Add an instance: {block.__name__}()."
        raise UsageError(Fault("E501", name, f"{block.__name__} is a class, not a block.", cure))
    if not isinstance(block, Block):
        cure = "Add a Block, a Diagram or a subdiagram(...)."
        cure = "Write MatrixGain(K=...)." if isinstance(block, np.ndarray) else cure
        shown = repr(block)
        if isinstance(block, (str, os.PathLike)):
            shown = str(block)
            made = {".fmu": "fmu", ".json": "subdiagram"}.get(Path(block).suffix.lower())
            cure = f"Write {made}({str(block)[:200]!r})." if made else cure
        raise UsageError(Fault("E501", name, f"{quoted(shown)} is not a block.", cure))
    known = type(block).declaration.parameters
    # None stands for what is not given; a file leaves it out.
    said = {k: v for k, v in block.parameters.items() if v is not None or known[k].default is not None}
    given = {name: given_value(value, known[name]) for name, value in said.items()}
    return given, _entry_of(type(block), folder)


def _entry_of(cls: type[Block], folder: str) -> BlockEntry:
    """The entry of a block of a class: its type, or the path of its FMU from the diagram's folder on."""
    foreign = cls.declaration.foreign
    if foreign is None:
        return BlockEntry(type=cls.__name__, cls=cls)
    from ..model.fmu_block import fmu_type

    path = foreign.path
    with contextlib.suppress(ValueError):  # another drive
        path = Path(os.path.relpath(path, folder))
    usual = inspect.signature(fmu_type).parameters["timeout"].default
    options: dict[str, object] = {"kind": foreign.kind}
    options |= {"isolate": True} if foreign.isolate else {}
    options |= {"timeout": foreign.timeout} if foreign.timeout != usual else {}
    return BlockEntry(fmu=path.as_posix(), options=options, cls=cls)


def checked_entry(
    name: str,
    entry: BlockEntry,
    given: Mapping[str, object],
    folder: str,
    *,
    doc: str,
    control: Mapping[str, object],
    stream: str,
    copies: object = None,
) -> BlockEntry:
    """The entry of a block with all that it is given, which is checked as a file's is.

    A subdiagram was checked before. Raises ModelError with all faults.
    """
    described: dict[str, object] = {"type": entry.type or "Subdiagram"}
    if entry.fmu:
        described = {"fmu": entry.fmu, **entry.options}
    elif control and not entry.type:
        described = {"diagram": {}}
    described |= {"parameters": given, **({"doc": doc} if doc else {})}
    described |= {key: raw_of(value) for key, value in control.items()}
    described |= {"stream": stream} if stream else {}
    described |= {} if copies is None else {"copies": raw_of(copies)}
    read = documents.block(name, described, folder)
    return BlockEntry(
        type=entry.type, diagram=entry.diagram, fmu=entry.fmu, cls=entry.cls, loaded=entry.loaded, stream=read.stream,
        control=read.control, options=read.options, parameters=read.parameters, doc=read.doc, copies=read.copies,
    )  # fmt: skip
