"""The JSON Schema (draft 2020-12) of diagram files and of study files, by which editors complete and check them.

It is made from the tables that the readers use: their keys, choices and limits, and the block types with their
parameters. A key that a reader knows and this module does not is an error when the schema is made, so the two cannot
drift apart. What a reader accepts is valid; of what it refuses, all faults of structure are invalid (kinds of values,
keys, names), and those that need the whole diagram (wires, units, sizes) are not seen.

The files in `schemas/` are what `text_of` gives for the block types that ship.
"""

from __future__ import annotations

import contextlib
import inspect
import json
import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ..contract.block import Block
from ..contract.declaration import Declaration
from ..contract.variables import REQUIRED, Parameter, Variable
from ..model import diagram, document, settings, streams
from ..model.fmu_block import fmu_type
from ..text import json_text, units
from ..text.expressions import FUNCTIONS
from . import study

__all__ = ["DIALECT", "KINDS", "diagram_schema", "path_of", "study_schema", "text_of"]

DIALECT = "https://json-schema.org/draft/2020-12/schema"
KINDS = ("diagram", "study")

Schema = dict[str, Any]

NAME = "^" + diagram.NAME.pattern.replace(r"\Z", "$")
NO_PATH = r"://|\u0000"
NO_FMU = NO_PATH + r"|^[\\/]{2}"
OWN = {"^x-": {"description": "Anything of your own; it is kept, and has no effect."}}
UNITS = ("V", "A", "Ohm", "H", "N", "N.m", "kg", "kg.m2", "m", "m/s", "rad", "rad/s", "rpm", "deg", "s", "1")


def path_of(kind: str) -> Path:
    """The file of a schema that ships; the name holds the version of the format that it describes."""
    version = {"diagram": diagram.VERSION, "study": study.VERSION}[kind]
    return Path(__file__).parents[1] / "schemas" / f"{kind}-{version}.schema.json"


def text_of(kind: str, types: Mapping[str, type[Block]]) -> str:
    """The text of a schema, for these block types by name. It is ASCII, so that any console gives it on as it is."""
    made = diagram_schema(types) if kind == "diagram" else study_schema()
    text = json_text.write(made, one_per_line=lambda _, value: len(json.dumps(value)) > 100)
    return re.sub(r"[^\x00-\x7f]", lambda found: json.dumps(found[0])[1:-1], text)


# --- pieces ----------------------------------------------------------------------------------------------------


def _in_order(known: Iterable[str], entries: Mapping[str, Schema]) -> dict[str, Schema]:
    """Entries in the order of a reader's table. Raises KeyError where one has a key that the other has not."""
    made = {key: entries[key] for key in known}
    if left := entries.keys() - made.keys():
        raise KeyError(*sorted(left))
    return made


def _object(
    known: Iterable[str], entries: Mapping[str, Schema], *, required: Iterable[str] = (), doc: str = "", **more: Any
) -> Schema:
    """An object with the keys of a reader's table, and keys of one's own. Raises KeyError as `_in_order`."""
    made: Schema = {"type": "object"}
    if doc:
        made["description"] = doc
    made["properties"] = _in_order(known, entries)
    if required:
        made["required"] = list(required)
    return made | {"patternProperties": OWN, "additionalProperties": False} | more


def _table(of: Schema, doc: str, *, names: bool = True) -> Schema:
    """An object whose keys are names, or anything."""
    made: Schema = {"type": "object", "description": doc}
    if names:
        made["propertyNames"] = {"pattern": NAME}
    return made | {"additionalProperties": of}


def _ref(name: str, doc: str = "", **more: Any) -> Schema:
    return {"$ref": f"#/$defs/{name}"} | ({"description": doc} if doc else {}) | more


def _each(one: Schema) -> Schema:
    """One value, or one for each element of a vector or a matrix."""
    row = {"type": "array", "items": one}
    return {"anyOf": [one, row, {"type": "array", "items": row}]}


def _text(doc: str, **more: Any) -> Schema:
    return {"type": "string", "description": doc} | more


def _choice(known: Iterable[str], doc: str, default: str = "") -> Schema:
    return {"enum": list(known), "description": doc} | ({"default": default} if default else {})


def _words(known: Mapping[str, str]) -> list[Schema]:
    """Texts to choose from, each with what it means."""
    return [{"const": word, "description": doc} for word, doc in known.items()]


def _quantity(value: Schema, doc: str = "A value with its unit, which must be of the same quantity.") -> Schema:
    entries = {"value": value | {"description": "In the unit."}, "unit": _ref("unit"), "doc": _ref("doc")}
    return _object(settings.QUANTITY, entries, required=["value"], doc=doc)


def _common() -> dict[str, Schema]:
    """Definitions that diagrams and studies share."""
    number, flag, text = {"type": "number"}, {"type": "boolean"}, {"type": "string"}
    flags = {"type": "array", "items": flag}
    member = {"type": "string", "pattern": document.MEMBER}
    rows = {"type": "array", "items": {"anyOf": [number, flag, _ref("rows")]}}
    above_0 = {"type": "number", "exclusiveMinimum": 0}
    master = settings.MasterSettings()
    usual = settings.RunSettings()
    run = {
        "start": _ref("time", "Start time, in s.", default=0),
        "stop": _ref("time", "Stop time, in s. It must be given here or where the run is started."),
        "method": _choice(
            settings.METHODS,
            "dopri5: variable steps; radau: variable steps, for stiff models; rk4, euler: fixed steps (`step`).",
            usual.method,
        ),
        "step": _ref("duration", "Step of rk4 and euler, in s."),
        "rtol": _between(settings.LEAST_RTOL, "Relative tolerance of dopri5 and radau.", usual.rtol),
        "atol": _between(0, "Absolute tolerance of dopri5 and radau, for states of nominal size 1.", usual.atol),
        "every": _ref("duration", "Recording grid, in s: rows at start + k every. Without it, every step is recorded."),
        "jumps": flag
        | {
            "default": usual.jumps,
            "description": "Whether rows before and after each jump stand between those of the grid.",
        },
        "stops": {"type": "array", "items": _ref("time"), "description": "Times at which a step must end, in s."},
        "seed": {
            "type": "integer",
            "minimum": 0,
            "maximum": settings.LARGEST_SEED,
            "default": usual.seed,
            "description": "Of all noise in the run: another one gives other noise in every block.",
        },
        "inputs": _table(_ref("signal"), "Values of the diagram's inputs, by name.", names=False),
        "loops": _choice(
            settings.LOOPS, "error: algebraic loops are errors; solve: they are solved at every step.", usual.loops
        ),
        "log": {
            "type": "array",
            "items": text,
            "description": 'Signals to record: "motor.omega", an element "z[0]", all outputs of a block "motor".',
        },
        "master": _object(
            settings.MASTER,
            {
                "step": _ref("duration", "The communication step, in s."),
                "steps": _table(_ref("duration"), "Steps of single blocks, by path, in s.", names=False),
                "algorithm": _choice(
                    settings.ALGORITHMS,
                    "jacobi: all at once; gauss-seidel: one after the other; iterated: again, until the values at "
                    "their borders stay.",
                    master.algorithm,
                ),
                "order": {
                    "type": "integer",
                    "minimum": 0,
                    "maximum": settings.HIGHEST_ORDER,
                    "default": master.order,
                    "description": "Over a step, inputs are held (0), or follow a line (1) or a parabola (2).",
                },
                "tolerance": _between(0, "Of the error by which steps are controlled; without it, steps are fixed."),
                "couple": _choice(
                    settings.COUPLINGS,
                    "together: all blocks with equations are one unit; each: each is one of its own.",
                    master.couple,
                ),
                "iterations": {
                    "type": "integer",
                    "minimum": 1,
                    "maximum": settings.MOST_ITERATIONS,
                    "default": master.iterations,
                    "description": 'The most for one step of "iterated".',
                },
            },
            doc="How FMUs of Co-Simulation are stepped together with the rest of the diagram.",
        ),
        "doc": _ref("doc"),
    }
    return {
        "doc": {
            "description": "A text, or a list of lines.",
            "anyOf": [text, {"type": "array", "items": text}],
        },
        "unit": _text(
            "A product of symbols with powers, such as kg.m2/s3, V.s/rad or 1/s. Left out: unknown.", examples=[*UNITS]
        ),
        "expression": _text(
            f"Arithmetic over the parameters of this diagram, after =: numbers, names, pi, + - * / **, brackets, and "
            f"{', '.join(FUNCTIONS)}.",
            pattern="^=",
        ),
        "rows": rows,
        "values": {"type": "array", "items": {"anyOf": [number, flag, member, _ref("values")]}},
        "element": {"anyOf": [number, text, {"type": "array", "items": _ref("element")}]},
        "list": {
            "description": "Numbers or expressions, maybe in rows, or bools.",
            "type": "array",
            "anyOf": [{"items": _ref("element")}, {"items": flag}],
        },
        "plain": {"anyOf": [number, flag, text, _ref("list")]},
        "quantity": _quantity(_ref("plain")),
        "column": _object(
            document.COLUMN,
            {
                "csv": _text("The path of a CSV file of the project, from the folder of this file on."),
                "column": _text("The name of a column of it."),
                "unit": _ref("unit"),
                "doc": _ref("doc"),
            },
            required=["csv", "column"],
            doc="A column of a CSV file.",
        ),
        "value": {
            "description": 'A number, a quantity with its unit, an expression ("=kt/La"), a list, a text or a bool.',
            "anyOf": [number, flag, text, _ref("list"), _ref("quantity"), _ref("column")],
        },
        "scalar": {"anyOf": [number, _ref("computed")]},
        "computed": {
            "anyOf": [_ref("expression"), _quantity({"anyOf": [number, _ref("expression")]})],
        },
        "numbers": {
            "anyOf": [
                number,
                _ref("expression"),
                _ref("list"),
                _quantity({"anyOf": [number, _ref("expression"), _ref("list")]}),
                _ref("column"),
            ]
        },
        "flag": {"anyOf": [flag, _ref("expression"), _quantity({"anyOf": [flag, _ref("expression")]})]},
        "flags": {"anyOf": [flag, flags, _ref("expression"), _quantity({"anyOf": [flag, flags, _ref("expression")]})]},
        "words": {"anyOf": [_ref("expression"), _quantity(text, "A text.")]},
        "time": _time(number),
        "duration": _time(above_0),
        "signal": {
            "description": "A number, a name of a member, a list for a vector, a quantity, or a table over time.",
            "anyOf": [
                number,
                flag,
                member,
                _ref("values"),
                _quantity({"anyOf": [number, flag, member, _ref("values")]}),
                _object(
                    document.TABLE,
                    {
                        "t": _ref("rows", "Times, in s; two values at one time are a jump."),
                        "u": _ref("values", "A value for each time; of a vector, a list for each."),
                        "interpolation": _choice(
                            document.INTERPOLATIONS, "Between the times: joined by lines, or held.", "linear"
                        ),
                        "unit": _ref("unit"),
                    },
                    required=document.TABLE[:2],
                    doc="A table over time.",
                ),
            ],
        },
        "run": _object(document.RUN, run, doc="How the diagram is simulated, unless a run is told otherwise."),
    }


def _time(number: Schema) -> Schema:
    """A time in s, with its unit, or computed."""
    computed = _ref("expression")
    return {"anyOf": [number, computed, _quantity({"anyOf": [number, computed]}, "A time with its unit.")]}


def _between(low: float, doc: str, default: float | None = None) -> Schema:
    """A number above 0, from `low` on, and below 1."""
    least = {"minimum": low} if low else {"exclusiveMinimum": 0}
    usual = {} if default is None else {"default": default}
    return {"type": "number", **least, "exclusiveMaximum": 1, "description": doc, **usual}


def _whole(title: str, doc: str, body: Schema, defs: Mapping[str, Schema]) -> Schema:
    """A schema with its head, without definitions that nothing refers to."""
    used: dict[str, Schema] = {}
    waiting = [body]
    while waiting:
        text = json.dumps(waiting.pop())
        for name in defs:
            if name not in used and f'"#/$defs/{name}"' in text:
                used[name] = defs[name]
                waiting.append(defs[name])
    ordered = {name: defs[name] for name in defs if name in used}
    return {"$schema": DIALECT, "title": title, "description": doc, **body, "$defs": ordered}


def _header(format_: str, version: int, what: str) -> dict[str, Schema]:
    return {
        document.SCHEMA: _text("The JSON Schema of this file, for editors: a path or a URL. It is never fetched."),
        "format": {"const": format_, "description": f"What marks a {what}."},
        "version": {"const": version, "description": "The version of the format."},
    }


# --- diagrams --------------------------------------------------------------------------------------------------


def diagram_schema(types: Mapping[str, type[Block]]) -> Schema:
    """The schema of diagram files that knows these block types by name; other types are valid, and not checked."""
    doc = "A block diagram with its parameters, wires, run settings and measures."
    header = _header(diagram.FORMAT, diagram.VERSION, "diagram file")
    body = _object((*document.HEADER, *document.TOP), header | _body(), required=document.HEADER[1:])
    return _whole("Diagram file of blocks", doc, body, _common() | _of_diagrams(types))


def _body() -> dict[str, Schema]:
    """The keys of a diagram, whether it is a file or a part of one."""
    position = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
    return {
        "name": _text("The name of the diagram.", pattern=NAME, default="diagram"),
        "doc": _ref("doc"),
        "parameters": _table(
            _ref("value"), "Values that blocks share, by name; expressions of this diagram read them."
        ),
        "inputs": _table(_ref("input"), "What comes from outside, by name."),
        "outputs": _table(
            _text('A source: "motor.omega", an element "motor.x[0]", or an input.'),
            "What others see of the diagram: sources by name.",
        ),
        "blocks": _table(_ref("block"), "The blocks, by name."),
        "wires": _table(
            _text('A source: "control.y", an element "plant.y[1]", or an input of the diagram.'),
            'Where each input of a block comes from: "motor.v": "control.y".',
            names=False,
        ),
        "run": _ref("run"),
        "measures": _table(_ref("measure"), "Numbers that every run takes, by name."),
        "layout": _table(
            position | {"description": "[x, y] in pixels, to the right and down."},
            "Where blocks, inputs and outputs stand in drawings.",
        ),
    }


def _of_diagrams(types: Mapping[str, type[Block]]) -> dict[str, Schema]:
    """Definitions of what stands in diagrams."""
    number = {"type": "number"}
    entries = _in_order(document.BLOCK, _block(types))
    kinds = {"oneOf": [{"required": [kind]} for kind in ("type", "diagram", "fmu")]}
    needs = {"enable": ["diagram"], "trigger": ["diagram"], **{key: ["fmu"] for key in document.OPTIONS}}
    common: Schema = {
        **kinds,
        "dependentRequired": needs,
        "not": {"required": ["enable", "trigger"]},
        "allOf": [_ref("types")],
    }

    def block(others: tuple[str, ...], doc: str) -> Schema:
        known = [key for key in document.BLOCK if key not in others]
        return _object(known, {key: entries[key] for key in known}, doc=doc, **common)

    size = {"type": "integer", "minimum": 1, "maximum": document.LARGEST_SIZE}
    return {
        "input": _object(
            document.INPUT,
            {
                "unit": _ref("unit"),
                "default": {
                    "type": ["number", "boolean", "string", "array"],
                    "description": "Its value where nothing is given (one, or one for each element). Without one, "
                    "every run must give it.",
                },
                "size": {
                    "description": "The number of elements of a vector; of a matrix, a list.",
                    "anyOf": [size, {"type": "array", "items": size, "minItems": 1}],
                },
                "type": {
                    "description": "The kind of its values; a bool or a member of an enumeration has no unit.",
                    "default": "real",
                    "anyOf": [{"enum": list(document.TYPES)}, _ref("enumeration")],
                },
                "doc": _ref("doc"),
            },
            doc="An input of the diagram.",
            allOf=[
                *(
                    {
                        "if": {"properties": {"type": {"const": name}}, "required": ["type"]},
                        "then": {"properties": {"default": _each({"type": kind})}},
                    }
                    for name, kind in (("bool", "boolean"), ("real", "number"), ("int", "integer"))
                ),
                {"if": {"not": {"required": ["type"]}}, "then": {"properties": {"default": _each(number)}}},
                {
                    "if": {"properties": {"type": {"type": "object"}}, "required": ["type"]},
                    "then": {"properties": {"default": _each({"type": "string"})}},
                },
                {
                    "if": {"properties": {"type": {"enum": ["real", "int"]}}},
                    "else": {"properties": {"unit": {"maxLength": 0}}},
                },
                {
                    "if": {"properties": {"default": {"type": "array"}}, "required": ["default"]},
                    "then": {"required": ["size"]},
                },
            ],
        ),
        "enumeration": _object(
            document.ENUMERATION,
            {
                "enum": _text("The name of the enumeration.", minLength=1),
                "members": {
                    "description": "The numbers of its members, by name.",
                    "type": "object",
                    "minProperties": 1,
                    "propertyNames": {"minLength": 1},
                    "additionalProperties": {"type": "integer", "minimum": -(2**53), "maximum": 2**53},
                },
            },
            required=document.ENUMERATION,
            doc="An enumeration. Two with equal members are one, whatever their names.",
        ),
        "block": block(("ports",), "A block: exactly one of type, diagram and fmu."),
        "variant": block(("variant", "variants"), "What may stand in place of the block."),
        "diagram": _object(document.TOP, _body(), doc="A subdiagram."),
        "measure": _object(
            document.MEASURE,
            {
                "type": {"description": "What is measured, of e = of - against.", "oneOf": _words(settings.MEASURES)},
                "of": _text('A signal, such as "motor.omega".'),
                "against": {
                    "description": "A signal, or a number, that is taken off.",
                    "anyOf": [{"type": "string"}, _ref("scalar")],
                    "default": 0,
                },
                "from": _ref("scalar", "Begin of the window, in s; left out: the start of the run."),
                "to": _ref("scalar", "End of the window, in s; left out: the end of the run."),
                "band": {
                    "description": "Of settling_time: a part of the step's size.",
                    "anyOf": [number | {"exclusiveMinimum": 0, "exclusiveMaximum": 1}, _ref("computed")],
                    "default": 0.02,
                },
                "doc": _ref("doc"),
            },
            required=("type", "of"),
            doc="A number that every run takes.",
        ),
        "types": {"allOf": [{}, *(_of_type(name, cls.declaration) for name, cls in types.items())]},
    }


def _block(types: Mapping[str, type[Block]]) -> dict[str, Schema]:
    """The keys of a block and of a variant."""
    off = "held: they stay as they are while it is off; reset: "
    trigger = {
        "direction": _choice(
            document.DIRECTIONS, 'When its input "trigger" comes above 0 (up), below it (down), or both.'
        ),
        "every": _ref("scalar", "At ticks: the time from one to the next, in s."),
        "offset": _ref("scalar", "The time of the first tick, in s.", default=0),
    }
    own = {"type": "string", "minLength": 1, "description": "A type of your own, which --library brings."}
    timeout = inspect.signature(fmu_type).parameters["timeout"].default
    known = _words({name: _about(cls.declaration) for name, cls in types.items()})
    return {
        "type": {"description": "A block type of the library, or one of your own.", "anyOf": [*known, own]},
        "diagram": {
            "description": "A subdiagram: here, or the path of a diagram file, from the folder of this file on.",
            "anyOf": [_ref("diagram"), {"type": "string", "minLength": 1, "not": {"pattern": NO_PATH}}],
        },
        "fmu": _text(
            "The path of an FMU, from the folder of this file on.", minLength=1, **{"not": {"pattern": NO_FMU}}
        ),
        "enable": _object(
            document.ENABLE,
            {
                "states": _choice(document.OFF, f"{off}they begin anew when it is turned on.", document.OFF[0]),
                "outputs": _choice(document.OFF, f"{off}they are 0 while it is off.", document.OFF[0]),
            },
            doc='Of a subdiagram: it gets the bool input "enable".',
        ),
        "trigger": _object(
            document.TRIGGER,
            trigger,
            doc='Of a subdiagram: it is computed when its input "trigger" fires, or at ticks.',
            oneOf=[{"required": ["direction"]}, {"required": ["every"]}],
            dependentRequired={"offset": ["every"]},
        ),
        "stream": _text(
            "The name of the stream of random numbers, or of those in a subdiagram, where it is not that of the block; "
            "with / in front it counts from the whole diagram.",
            pattern="^" + streams.NAME.pattern.replace(r"\Z", "$"),
        ),
        "kind": _choice(
            document.FMU_KINDS,
            "Of an FMU: CS (Co-Simulation) brings its own solver, ME (Model Exchange) is integrated by the run.",
        ),
        "isolate": {"type": "boolean", "default": False, "description": "Of an FMU: run it in a process of its own."},
        "timeout": {
            "type": "number",
            "exclusiveMinimum": 0,
            "maximum": document.LONGEST_TIMEOUT,
            "default": timeout,
            "description": "Of an isolated FMU: how many seconds a call may take.",
        },
        "doc": _ref("doc"),
        "parameters": _table(
            _ref("value"), "Values of the type's parameters, of the subdiagram's, or of the FMU's.", names=False
        ),
        "ports": _table(
            {"type": "string", "minLength": 1},
            "The variant's own names of the block's ports, where they differ.",
            names=False,
        ),
        "variant": _text('The variant that is taken unless another is asked for; "base": the block itself.'),
        "variants": _table(_ref("variant"), "What may stand in place of the block, by name.")
        | {"propertyNames": {"pattern": NAME, "not": {"const": diagram.BASE}}},
    }


# --- block types -----------------------------------------------------------------------------------------------


def _about(declaration: Declaration) -> str:
    """A block type for those who hover over its name: its summary, and its ports."""
    d = declaration
    memories: list[Any] = [*d.states.values(), *d.discretes.values(), *d.algebraics.values()]
    given = [made for made in d.given.values() if not made.is_local]
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
    name = f"{variable.ports.format(1)}, ..." if variable.ports else variable.name
    return f"{name}{_in_unit(variable)}"


def _in_unit(variable: Variable) -> str:
    return f" [{variable.unit}]" if isinstance(variable.unit, str) and variable.unit else ""


def _of_type(name: str, declaration: Declaration) -> Schema:
    """What holds for the parameters of a block of a type."""
    parameters = declaration.settable
    required = [key for key, parameter in parameters.items() if parameter.default is REQUIRED]
    made: Schema = {
        "properties": {key: _parameter(parameter) for key, parameter in parameters.items()},
        "additionalProperties": False,
    }
    then: Schema = {"properties": {"parameters": made}}
    if required:
        made["required"] = required
        then["required"] = ["parameters"]
    return {"if": {"properties": {"type": {"const": name}}, "required": ["type"]}, "then": then}


def _parameter(parameter: Parameter) -> Schema:
    """The values of a parameter that may be valid: its kind, and the range of a plain number."""
    made: Schema = {"description": _told(parameter)}
    default = parameter.default
    if not (default is REQUIRED or default is None or callable(default)):
        with contextlib.suppress(ValueError):  # JSON has no infinity
            json.dumps(default, allow_nan=False)
            made["default"] = default
    if parameter.members:
        return made | {"anyOf": [{"enum": list(parameter.members)}, _ref("value")]}
    if parameter.type == "string":
        text = {"enum": list(parameter.choices)} if parameter.choices else {"type": "string"}
        return made | {"anyOf": [text, _ref("words")]}
    if parameter.type == "bool":
        return made | _ref("flag" if parameter.shape == () else "flags")
    if parameter.shape != ():
        return made | _ref("numbers")
    limits = _limits(parameter)
    whole = parameter.type == "int" and parameter.unit == ""
    if limits or whole:
        return made | {"anyOf": [{"type": "integer" if whole else "number", **limits}, _ref("computed")]}
    return made | _ref("scalar")


def _limits(parameter: Parameter) -> Schema:
    """The range of a number without a unit of its own. Where a unit is scaled, the ends are not exact."""
    made: Schema = {}
    if isinstance(parameter.unit, str) and (not parameter.unit or units.parse(parameter.unit).exact == 1):
        ends = {"minimum": parameter.min, "maximum": parameter.max}
        made |= {word: end for word, end in ends.items() if end is not None and math.isfinite(end)}
    return made | ({"exclusiveMinimum": 0} if parameter.positive else {})


def _told(parameter: Parameter) -> str:
    """A parameter for those who hover over it."""
    notes = ["must be given" if parameter.default is REQUIRED else "computed" if callable(parameter.default) else ""]
    if parameter.positive:
        notes.append("above 0")
    if parameter.min is not None:
        notes.append(f"from {parameter.min:g}" + (f" up to {parameter.max:g}" if parameter.max is not None else " on"))
    said = "; ".join(note for note in notes if note)
    return f"{parameter.doc or parameter.name}{_in_unit(parameter)}" + (f" ({said})" if said else "")


# --- studies ---------------------------------------------------------------------------------------------------


def study_schema() -> Schema:
    """The schema of study files."""
    doc = "Runs of diagrams whose measures are set beside published numbers."
    number, text = {"type": "number"}, {"type": "string", "minLength": 1}
    style = {
        "type": ["integer", "null"],
        "minimum": study.STYLES[0],
        "maximum": study.STYLES[-1],
        "description": "The number of its color and pattern; null: dotted.",
    }
    curve = {
        "run": _text("The name of a run of this study."),
        "signal": _text("A recorded signal.", minLength=1),
        "label": _text("What the legend says."),
        "style": style,
        "scale": number | {"default": 1, "description": "A factor of its values."},
    }
    place = {
        "x": number | {"description": "Of a marker without a signal: its time."},
        "y": number | {"description": "Of a marker without a signal: its value."},
    }
    one_of_both: Schema = {
        "if": {"anyOf": [{"required": ["run"]}, {"required": ["signal"]}]},
        "then": {"required": ["run", "signal"]},
        "else": {"required": ["x", "y"]},
    }
    with_reason: Schema = {
        "if": {"properties": {"expect": {"const": "not reproduced"}}, "required": ["expect"]},
        "then": {"properties": {"reason": {"minLength": 1}}, "required": ["reason"]},
    }
    common = _common()
    run = common["run"]["properties"]
    defs = common | {
        "one_run": _object(
            study.RUN,
            {
                "diagram": text | {"description": "The path of a diagram file, from the folder of this file on."},
                "parameters": _table(
                    {"anyOf": [_ref("plain"), _ref("quantity")]},
                    'Values of parameters by path ("motor.Ra"), in place of those of the diagram.',
                    names=False,
                ),
                "variants": _table({"type": "string"}, "The variants of blocks that are taken, by path.", names=False),
                "settings": _object(
                    study.SETTINGS,
                    {key: run[key] for key in study.SETTINGS},
                    doc="Run settings in place of those of the diagram.",
                ),
                "doc": _ref("doc"),
            },
            required=["diagram"],
            doc="A run: a diagram with parameters, variants and settings of its own.",
        ),
        "claim": _object(
            study.CLAIM,
            {
                "run": _text("The run that the claim is about."),
                "runs": {
                    "type": "array",
                    "items": {"type": "string"},
                    "minItems": 2,
                    "maxItems": 2,
                    "description": "Two runs, whose change in % the claim is about.",
                },
                "measure": _text("A measure of the diagram.", minLength=1),
                "as": _choice(study.CHANGES, "The change from the first to the second run."),
                "published": {
                    "type": "number",
                    "not": {"const": 0},
                    "description": "The published number; left out, the value is only shown.",
                },
                "unit": _text("Its unit, for the report."),
                "source": _text("Where it was published."),
                "tolerance": _between(0, "The largest deviation of value/published from 1 that counts as reproduced."),
                "expect": _choice(study.EXPECTED, "The verdict that is expected."),
                "reason": _text("Why a number is not reproduced."),
            },
            required=["measure"],
            doc="A measure beside a published number.",
            oneOf=[{"required": ["run"]}, {"required": ["runs"]}],
            dependentRequired={
                "runs": ["as"],
                "as": ["runs"],
                "published": ["tolerance", "expect"],
                "tolerance": ["published"],
                "expect": ["published"],
            },
            **with_reason,
        ),
        "figure": _object(
            study.FIGURE,
            {
                "name": _text("The name of its file.", pattern=NAME),
                "title": _text("Its title."),
                "doc": _ref("doc"),
                "kind": _choice(study.KINDS, "Signals over time, or their amplitude spectra.", "time"),
                "panels": {
                    "type": "array",
                    "items": _ref("panel"),
                    "minItems": 1,
                    "description": "Axes, from the top.",
                },
                "from": number | {"description": "Begin of the window, in s."},
                "to": number | {"description": "End of the window, in s."},
                "xlabel": _text("The label of the horizontal axis."),
            },
            required=["name", "panels"],
        ),
        "panel": _object(
            study.PANEL,
            {
                "lines": {"type": "array", "items": _ref("line"), "minItems": 1, "description": "Its curves."},
                "ylabel": _text("The label of the vertical axis, with the unit in [ ]."),
                "markers": {"type": "array", "items": _ref("marker"), "description": "Points with texts."},
                "band": _numbers(2, "A grey stretch of time: [from, to]."),
                "inset": _numbers(4, "A part that is also shown enlarged: [x0, x1, y0, y1]."),
                "log": {"type": "boolean", "description": "Whether the axis is logarithmic; of spectra it is."},
                "height": {"type": "number", "exclusiveMinimum": 0, "default": 1, "description": "Beside the others."},
            },
            required=["lines"],
        ),
        "line": _object(study.LINE, curve, required=["run", "signal"], doc="A curve."),
        "marker": _object(
            study.MARKER,
            curve | place,
            doc="A point: the largest value of a signal, or a place.",
            **one_of_both,
        ),
    }
    body = _object(
        (document.SCHEMA, *study.TOP),
        _header(study.FORMAT, study.VERSION, "study file")
        | {
            "name": _text("The name of the study, and of the folder of its report.", pattern=NAME),
            "title": _text("The title of the report."),
            "doc": _ref("doc"),
            "source": _text("What is studied: a paper, a book."),
            "runs": _table(_ref("one_run"), "The runs, by name."),
            "assumed": {
                "type": "array",
                "items": _object(
                    study.ASSUMED,
                    {
                        "what": _text("What is assumed."),
                        "why": _text("Why."),
                        "contradicts": _text("What the source says otherwise."),
                    },
                ),
                "description": "What the source leaves open.",
            },
            "claims": {"type": "array", "items": _ref("claim"), "description": "Measures beside published numbers."},
            "figures": {"type": "array", "items": _ref("figure"), "description": "Figures of the report."},
        },
        required=("format", "version"),
    )
    return _whole("Study file of blocks", doc, body, defs)


def _numbers(count: int, doc: str) -> Schema:
    return {"type": "array", "items": {"type": "number"}, "minItems": count, "maxItems": count, "description": doc}
