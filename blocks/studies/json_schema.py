"""The JSON Schema (draft 2020-12) of diagram files and of study files, by which editors complete and check them.

It is made from the grammars by which the readers check, and from the block types with their parameters. What a reader
accepts is valid; of what it refuses, all faults of structure are invalid (kinds of values, keys, names), and those that
need the whole diagram (wires, units, sizes) are not seen.

The files in `schemas/` are what `text_of` gives for the block types that ship.
"""

from __future__ import annotations

import contextlib
import json
import math
import re
from collections.abc import Mapping
from typing import Any

from ..contract.block import Block
from ..contract.declaration import Declaration
from ..contract.variables import NO_LIMIT, REQUIRED, Parameter, Variable
from ..model import diagram_grammar as g
from ..model.study_grammar import STUDY
from ..text import json_writer, units
from ..text.grammar import AnyOf, Choice, Kind, ListOf, Scalar, Schema

DIALECT = "https://json-schema.org/draft/2020-12/schema"
KINDS = ("diagram", "study")

# What parameters of types may be, but for single numbers.
A_FLAG = AnyOf(g.FLAG, g.EXPRESSION, g.quantity(AnyOf(g.FLAG, g.EXPRESSION)), name="flag")
_FLAGS = (g.FLAG, ListOf(g.FLAG), g.EXPRESSION)
FLAGS = AnyOf(*_FLAGS, g.quantity(AnyOf(*_FLAGS)), name="flags")
WORDS = AnyOf(g.EXPRESSION, g.quantity(g.TEXT, "A text."), name="words")
_NUMBERS = (g.NUMBER, g.EXPRESSION, g.LIST)
NUMBERS = AnyOf(*_NUMBERS, g.quantity(AnyOf(*_NUMBERS)), g.COLUMN, name="numbers")


def text_of(kind: str, types: Mapping[str, type[Block]]) -> str:
    """The text of a schema, for these block types by name. It is ASCII, so that any console passes it on unchanged."""
    schema = diagram_schema(types) if kind == "diagram" else study_schema()
    text = json_writer.write(schema, one_per_line=lambda _, value: len(json.dumps(value)) > 100)
    return re.sub(r"[^\x00-\x7f]", lambda match: json.dumps(match[0])[1:-1], text)


def diagram_schema(types: Mapping[str, type[Block]]) -> Schema:
    """The schema of diagram files that knows these block types by name; other types are valid, and not checked."""
    defs: dict[str, Schema] = {}
    body = g.DIAGRAM.schema(defs)
    known = [{"const": name, "description": _about(cls.declaration)} for name, cls in types.items()]
    for name in ("block", "variant"):
        types_of = defs[name]["properties"]["type"]
        own = g.FILLED.schema({}) | {"description": "A type of your own, which --library brings."}
        defs[name]["properties"]["type"] = {"description": types_of["description"], "anyOf": [*known, own]}
        # With copies, a parameter may also be a list with one value for each of them.
        has_copies: Schema = {"required": ["copies"]}
        defs[name]["allOf"] = [{"if": {"not": has_copies}, "then": {"$ref": "#/$defs/types"}}]
    defs["types"] = {"allOf": [{}, *(_of_type(name, cls.declaration, defs) for name, cls in types.items())]}
    return _whole("Diagram file of blocks", body, defs)


def study_schema() -> Schema:
    """The schema of study files."""
    defs: dict[str, Schema] = {}
    return _whole("Study file of blocks", STUDY.schema(defs), defs)


def _whole(title: str, body: Schema, defs: Mapping[str, Schema]) -> Schema:
    head = {"$schema": DIALECT, "title": title, "description": body["description"]}
    return {**head, **body, "$defs": dict(sorted(defs.items()))}


# --- block types -----------------------------------------------------------------------------------------------


def _about(declaration: Declaration) -> str:
    """The text that an editor shows for a block type: its summary, and its ports."""
    d = declaration
    memories: list[Any] = [*d.states.values(), *d.discretes.values(), *d.algebraics.values()]
    given = [variable for variable in d.given.values() if not variable.is_local]
    outputs: list[Variable] = [
        *d.outputs.values(),
        *d.stepped.values(),
        *given,
        *(memory for memory in memories if memory.output),
    ]
    lines = [d.doc.partition("\n")[0]]
    for side, variables in (("Inputs", [*d.inputs.values()]), ("Outputs", outputs)):
        if variables:
            lines.append(f"{side}: {', '.join(map(_port, variables))}")
    return "\n".join(lines)


def _port(variable: Variable) -> str:
    numbered = isinstance(variable.ports, str) and variable.ports
    name = f"{numbered.format(1)}, ..." if numbered else variable.name
    return f"{name}{_in_unit(variable)}"


def _in_unit(variable: Variable) -> str:
    return f" [{variable.unit}]" if isinstance(variable.unit, str) and variable.unit else ""


def _of_type(name: str, declaration: Declaration, defs: dict[str, Schema]) -> Schema:
    """What holds for the parameters of a block of a type."""
    parameters = declaration.settable
    required = [key for key, parameter in parameters.items() if parameter.default is REQUIRED]
    parameters_schema: Schema = {
        "properties": {key: _parameter(parameter, defs) for key, parameter in parameters.items()},
        "additionalProperties": False,
    }
    then: Schema = {"properties": {"parameters": parameters_schema}}
    if required:
        parameters_schema["required"] = required
        then["required"] = ["parameters"]
    return {"if": {"properties": {"type": {"const": name}}, "required": ["type"]}, "then": then}


def _parameter(parameter: Parameter, defs: dict[str, Schema]) -> Schema:
    """The values of a parameter that may be valid: its kind, and the range of a plain number."""
    schema: Schema = {"description": _told(parameter)}
    default = parameter.default
    if not (default is REQUIRED or default is None or callable(default)):
        with contextlib.suppress(ValueError):  # JSON has no infinity
            json.dumps(default, allow_nan=False)
            schema["default"] = default
    return schema | _kind_of(parameter).schema(defs)


def _kind_of(parameter: Parameter) -> Kind:
    if parameter.members:
        return AnyOf(Choice(parameter.members), g.VALUE)
    if parameter.type == "string":
        return AnyOf(Choice(parameter.choices) if parameter.choices else g.TEXT, WORDS)
    if parameter.type == "bool":
        return A_FLAG if parameter.shape == () else FLAGS
    if parameter.shape != ():
        return AnyOf(g.EDGES, NUMBERS) if parameter.sparse else NUMBERS
    number = _number_of(parameter)
    if parameter.is_limit:
        return AnyOf(number, Choice(tuple(NO_LIMIT)), g.COMPUTED)
    return g.SCALAR if number.body({}) == g.NUMBER.body({}) else AnyOf(number, g.COMPUTED)


def _number_of(parameter: Parameter) -> Scalar:
    """The range of a number without a unit of its own. Where a unit is scaled, the ends are not exact."""
    unit, low, high = parameter.unit, parameter.min, parameter.max
    is_exact = isinstance(unit, str) and (not unit or units.parse(unit).exact == 1)
    low, high = (end if is_exact and end is not None and math.isfinite(end) else None for end in (low, high))
    is_whole = parameter.type == "int" and unit == ""
    return Scalar(low=low, high=high, above=0 if parameter.positive else None, is_whole=is_whole)


def _told(parameter: Parameter) -> str:
    """The text that an editor shows for a parameter."""
    notes = ["must be given" if parameter.default is REQUIRED else "computed" if callable(parameter.default) else ""]
    if parameter.positive:
        notes.append("above 0")
    if parameter.min is not None:
        notes.append(f"from {parameter.min:g}" + (f" up to {parameter.max:g}" if parameter.max is not None else " on"))
    said = "; ".join(note for note in notes if note)
    return f"{parameter.doc or parameter.name}{_in_unit(parameter)}" + (f" ({said})" if said else "")
