"""What a diagram file may hold: every key with its kind, limits, usual value and meaning, once.

Readers check by it, writers take its order, JSON Schemas are made of it, and references are found by it. What needs
more than the value itself (whether a name is there, whether units fit) is not said here.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from ..contract.expressions import FUNCTIONS
from ..text.grammar import (
    AnyOf,
    Choice,
    Constant,
    Field,
    Flag,
    Kind,
    ListOf,
    Object,
    Ref,
    Refusal,
    Rule,
    Scalar,
    Schema,
    Steps,
    Table,
    Text,
    Told,
    in_words,
    listed,
)
from ..text.other_words import BODY_KEYS, MEASURE_KEYS, RUN_KEYS, meant_keys
from ..text.printable import quoted
from ..text.quantity_text import DECIMAL, in_a_file
from . import streams
from .diagram_value import BASE, FORMAT, NAME, OLD_VERSION, VERSION, name_cure

LARGEST_SIZE = 100_000
LARGEST_MATRIX = 1_000_000  # rows or columns of one given by its edges
MOST_ROWS = 1_000_000  # of a table
TIMEOUT, LONGEST_TIMEOUT = 60.0, 1e6  # s, of the calls of an isolated FMU
LARGEST_INTEGER = 2**53  # up to here a double holds every one
LARGEST_SEED = LARGEST_INTEGER
LEAST_RTOL = 1e-13
SCHEMA = "$schema"
"""The key that names the JSON Schema of a file. It is for editors: kept, and never looked at."""
METHODS = ("dopri5", "rk4", "euler", "radau", "auto")
FIXED_STEP = ("rk4", "euler")
MEASURES = {
    "ITAE": "integral of t |e|, t from 0",
    "IAE": "integral of |e|",
    "ISE": "integral of e^2",
    "ISU": "integral of e^2 of a control signal",
    "mean_square": "mean of e^2 over the window (OPI)",
    "peak": "largest |e|",
    "overshoot": "how far the signal goes beyond the final value of `against`, as a part of the step's size",
    "settling_time": "time after which the signal stays within `band` (0.02) of the step's size around the final value",
    "total_variation": "sum of all changes of e",
    "RMS": "square root of the mean of e^2 over the window",
    "rise_time": "time from 10 % to 90 % of the step's size: from the first time there to the first time there",
    "steady_state_error": "|e| at the end of the window",
    "THD": "total harmonic distortion: RMS of all of e but its mean and its fundamental, by that of its fundamental",
    "zero_crossings": "how many times e changes its sign",
    "end_time": "t at the end of the window: of a run that a condition ends, the time of its end; e is not read",
}
"""What a measure can be; e is `of` minus `against`."""
MEASURE_UNITS = {
    "ITAE": (1, 2), "IAE": (1, 1), "ISE": (2, 1), "ISU": (2, 1), "mean_square": (2, 0), "peak": (1, 0),
    "settling_time": (0, 1), "total_variation": (1, 0), "RMS": (1, 0), "rise_time": (0, 1),
    "steady_state_error": (1, 0), "end_time": (0, 1),
}  # fmt: skip
"""The unit of a measure as powers of that of e and of s; others have none."""
MEASURE_NUMBERS = {"against": "", "from": "s", "to": "s", "band": "", "omega": "rad/s"}
"""The keys of a measure that may be numbers, and the units of plain ones; "": that of the signal, or none."""

# --- values ----------------------------------------------------------------------------------------------------

UNITS = ("V", "A", "Ohm", "H", "N", "N.m", "kg", "kg.m2", "m", "m/s", "rad", "rad/s", "rpm", "deg", "s", "1")
NUMBER, FLAG, TEXT, INTEGER = Scalar(), Flag(), Text(), Scalar(is_whole=True)
FILLED = Text(is_empty=False)


def _doc(*, is_open: bool = False) -> Field:
    lines = ListOf(TEXT, is_even=True, is_open=is_open)
    what, doc = "a text or a list of lines", "A text, or a list of lines."
    return Field("doc", AnyOf(TEXT, lines, what=what, is_whole=True, name="doc", doc=doc))


DOC, OPEN_DOC = _doc(), _doc(is_open=True)
UNIT = Field("unit", Text(name="unit", examples=UNITS, doc=(
    "A product of symbols with powers, such as kg.m2/s3, V.s/rad or 1/s. Left out: unknown."
)))  # fmt: skip
NAMES = Text(pattern="^" + NAME.pattern.replace(r"\Z", "$"), refusal=Refusal("E111", "is not a name.", name_cure))
EXPRESSION = Text(name="expression", pattern="^=", refers="expression", doc=(
    "Arithmetic over the parameters of this diagram, after =: numbers, names, pi, + - * / **, brackets, and "
    f"{', '.join(FUNCTIONS)}."
))  # fmt: skip
WORDS = Text(refers="expression")  # an expression, or a text that a type knows
ELEMENT = AnyOf(NUMBER, WORDS, Ref(lambda: _ELEMENTS, list), what="a number", name="element")
_ELEMENTS: Kind = ListOf(ELEMENT)
LIST = AnyOf(ListOf(FLAG, is_even=True), _ELEMENTS, name="list", doc="Numbers or expressions, maybe in rows, or bools.")
PLAIN = AnyOf(NUMBER, FLAG, WORDS, LIST, what="a number, a text, a list, true or false", name="plain")


def quantity(value: Kind, doc: str = "", *, by: str = "value", name: str = "") -> Object:
    doc = doc or "A value with its unit, which must be of the same quantity."
    return Object(Field("value", value, "In the unit.", required=True), UNIT, DOC, by=by, doc=doc, name=name)


QUANTITY = quantity(PLAIN, by="", name="quantity")
COLUMN = Object(
    Field("csv", TEXT, "The path of a CSV file of the project, from the folder of this file on.", required=True),
    Field("column", TEXT, "The name of a column of it.", required=True),
    UNIT,
    DOC,
    by="csv",
    name="column",
    doc="A column of a CSV file.",
)
SHAPE = ListOf(Scalar(low=1, high=LARGEST_MATRIX, is_whole=True), 2, 2, what="two sizes, [rows, columns]")


def _one_source(value: Mapping[str, object], path: Steps, told: Told) -> Collection[str]:
    """Edges stand either here or in a CSV file."""
    if ("edges" in value) == ("csv" in value):
        told.fault("E009", path, 'a sparse matrix needs either "edges" or "csv", not both.')
    return ()


EDGES = Object(
    Field("edges", ListOf(ListOf(NUMBER, 3, 3, what="an edge [row, column, value]")), (
        "`[row, column, value]` for each element that is not 0; rows and columns count from 0."
    )),
    Field("csv", TEXT, "The path of a CSV file with the columns `row`, `column` and `value`, in the place of `edges`."),
    Field("shape", SHAPE, "`[rows, columns]`.", required=True),
    UNIT,
    DOC,
    rules=(Rule(_one_source, lambda _: {"oneOf": [{"required": ["edges"]}, {"required": ["csv"]}]}),),
    by="shape",
    name="edges",
    doc="A sparse matrix: its elements that are not 0.",
)  # fmt: skip
VALUE = AnyOf(
    NUMBER, FLAG, WORDS, LIST, EDGES, COLUMN, QUANTITY, what=PLAIN.what, name="value",
    doc='A number, a quantity with its unit, an expression ("=kt/La"), a list, a text or a bool.',
)  # fmt: skip
COMPUTED = AnyOf(EXPRESSION, quantity(AnyOf(NUMBER, EXPRESSION)), name="computed")
SCALAR, SECONDS = (AnyOf(NUMBER, COMPUTED, name="scalar", unit=unit) for unit in ("", "s"))


def _time(number: Scalar, name: str) -> AnyOf:
    """A time in s, with its unit, or computed."""
    return AnyOf(number, EXPRESSION, quantity(AnyOf(number, EXPRESSION), "A time with its unit."), name=name, unit="s")


QUANTITY_TEXT = Text(
    name="quantity_text", pattern=rf"^\s*{DECIMAL}\s*[^\s,0-9.]", doc='A number with its unit, such as "500 ms".'
)
TIME, DURATION = _time(NUMBER, "time"), _time(Scalar(above=0), "duration")

# --- inputs over time ------------------------------------------------------------------------------------------

INTERPOLATIONS = ("linear", "hold")
# A text that is no number may name a member of an enumeration.
MEMBER = Text(pattern=r"^(?!\s*[-+]?[0-9.]+([eE][-+]?[0-9]+)?\s*$).")
_ROW = "a number, or a list of numbers"
ROWS: Kind = ListOf(AnyOf(NUMBER, FLAG, Ref(lambda: ROWS, list), what=_ROW), what="a list of numbers", name="rows")


def _one_of(members: Sequence[str]) -> Choice:
    return Choice(members, what=f"one of {listed(members)}")


def signal(members: Sequence[str] | None = None) -> AnyOf:
    """The value of an input over a run. members: of its type, () where that is no enumeration, None if unknown."""
    words = (MEMBER,) if members is None else (_one_of(members),) if members else ()
    values: Kind = ListOf(
        AnyOf(NUMBER, FLAG, *words, Ref(lambda: values, list), what=_ROW), what="a list of numbers", name="values"
    )
    table = Object(
        Field("t", ROWS, "Times, in s; two values at one time are a jump.", required=True),
        Field("u", values, "A value for each time; of a vector, a list for each.", required=True),
        Field("interpolation", Choice(INTERPOLATIONS), "Between the times: joined by lines, or held.", "linear"),
        UNIT,
        doc="A table over time.",
    )
    of_all = AnyOf(NUMBER, FLAG, *words, values, what=_ROW)
    return AnyOf(
        *(*of_all.kinds, quantity(of_all), table), what=_ROW, name="signal",
        doc="A number, a name of a member, a list for a vector, a quantity, or a table over time.",
    )  # fmt: skip


SIGNAL = signal()
_TABLE = SIGNAL.kinds[-1]
assert isinstance(_TABLE, Object)
TABLE = _TABLE.keys

# --- run settings ----------------------------------------------------------------------------------------------

SIGNAL_NAME = Text(refers="signal")


def _later(key: str, kind: Kind, doc: str, default: object = None) -> Field:
    """A setting of a run, which is checked when that is prepared, as those are that come from Python."""
    return Field(key, kind, doc, default, is_later=True)


MASTER = Object(
    _later("step", DURATION, "The communication step, in s."),
    _later("steps", Table(DURATION, Text(refers="block")), "Steps of single blocks, by path, in s."),
    _later("algorithm", Choice(("jacobi", "gauss-seidel", "iterated")), (
        "jacobi: all at once; gauss-seidel: one after the other; iterated: again, until the values at their borders "
        "stay."
    ), "jacobi"),
    _later("order", Scalar(low=0, high=2, is_whole=True), (
        "Over a step, inputs are held (0), or follow a line (1) or a parabola (2)."
    ), 1),
    _later("tolerance", Scalar(above=0, below=1), (
        "Of the error by which steps are controlled; without it, steps are fixed."
    )),
    _later("couple", Choice(("together", "each")), (
        "together: all blocks with equations are one unit; each: each is one of its own."
    ), "together"),
    _later("iterations", Scalar(low=1, high=10_000, is_whole=True), 'The most for one step of "iterated".', 20),
    doc="How FMUs of Co-Simulation are stepped together with the rest of the diagram.",
)  # fmt: skip
RUN = Object(
    _later("start", TIME, "Start time, in s.", 0),
    _later("stop", TIME, "Stop time, in s. It must be given here or where the run is started."),
    _later("stop_when", Text(refers="condition"), (
        'A condition over signals that ends the run before its stop: "lift.height >= 3 and not lift.is_open".'
    )),
    _later("method", Choice(METHODS), (
        "dopri5: variable steps; radau: variable steps, for stiff models; auto: dopri5, then radau if a run is found "
        "to be stiff; rk4, euler: fixed steps (`step`)."
    ), "dopri5"),
    _later("step", DURATION, "Step of rk4 and euler, in s."),
    _later("rtol", Scalar(what="a number between 0 and 1", low=LEAST_RTOL, below=1), (
        "Relative tolerance of dopri5, radau and auto."
    ), 1e-6),
    _later("atol", Scalar(above=0, below=1), (
        "Absolute tolerance of dopri5, radau and auto, for states of nominal size 1."
    ), 1e-9),
    _later("every", DURATION, "Recording grid, in s: rows at start + k every. Without it, every step is recorded."),
    _later("jumps", FLAG, "Whether rows before and after each jump are recorded between the rows of the grid.", False),
    _later("stops", ListOf(TIME, what="a list of times"), "Times at which a step must end, in s."),
    _later("seed", Scalar(what="an integer from 0 to 2^53", low=0, high=LARGEST_SEED, is_whole=True), (
        "Of all noise in the run: another one gives other noise in every block."
    ), 0),
    Field("inputs", Table(Ref(lambda: SIGNAL, dict, is_left=True), Text(refers="input")), (
        "Values of the diagram's inputs, by name."
    )),
    _later("loops", Choice(("error", "solve")), (
        "error: algebraic loops are errors; solve: they are solved at every step."
    ), "error"),
    _later("log", ListOf(SIGNAL_NAME, what="a list of signal names", is_even=True), (
        'Signals to record: "motor.omega", an element "z[0]", all outputs of a block "motor", '
        'or a pattern, in which * stands for a part of one name: "motor_*.omega".'
    )),
    Field("master", MASTER),
    DOC,
    strays=meant_keys(RUN_KEYS),
    name="run",
    doc="How the diagram is simulated, unless a run has other settings.",
)  # fmt: skip

# --- inputs of a diagram ---------------------------------------------------------------------------------------

_SHOWN = '{"enum": "Mode", "members": {"OFF": 0, "ON": 1}}'
_MEMBERS = Scalar(what="an integer up to 2^53", low=-LARGEST_INTEGER, high=LARGEST_INTEGER, is_whole=True)


def members_of(type_: object) -> tuple[str, ...]:
    """The members of the type of an input; () where that is no enumeration."""
    members = type_.get("members") if isinstance(type_, dict) else None
    return tuple(members) if isinstance(members, dict) else ()


def _is_named(enumeration: Mapping[str, object]) -> bool:
    return isinstance(enumeration.get("enum"), str) and enumeration["enum"] != ""


def _enumeration(value: Mapping[str, Any], path: Steps, told: Told) -> Collection[str]:
    """A name and members, whose numbers differ."""
    numbers: dict[float, str] = {}
    if not _is_named(value) or not members_of(value):
        told.fault("E004", path, "has no name or no members.", f"Write an enumeration as {_SHOWN}.")
        return ("enum", "members")
    for name, number in value["members"].items():
        at = (*path, "members", name)
        if not _MEMBERS.holds(number):
            _MEMBERS.refuse(number, at, told)
        elif not name:
            told.fault("E004", at, "a member has no name.", at_key=True)
        elif number in numbers:
            told.fault("E004", at, f"{quoted(numbers[number])} already has the number {number!r}.")
        else:
            numbers[number] = name
    return ("enum", "members")


ENUMERATION = Object(
    Field("enum", FILLED, "The name of the enumeration.", required=True),
    Field("members", Table(_MEMBERS, FILLED, least=1), "The numbers of its members, by name.", required=True),
    rules=[Rule(_enumeration)],
    name="enumeration",
    doc="An enumeration. Two with equal members are one, whatever their names.",
)
TYPES: Mapping[str, Kind] = {"real": NUMBER, "int": INTEGER, "bool": FLAG}
"""The types of inputs but for enumerations, with the kinds of their defaults."""
_DEFAULT = AnyOf(NUMBER, FLAG, TEXT, Ref(lambda: _DEFAULTS, list), name="values of a default")
_DEFAULTS: Kind = ListOf(_DEFAULT)
DEFAULT = AnyOf(*_DEFAULT.kinds, quantity(AnyOf(NUMBER, _DEFAULTS, what=_ROW)), name="default")
_SIZE = Scalar(low=1, high=LARGEST_SIZE, is_whole=True)
SIZE = AnyOf(_SIZE, ListOf(_SIZE, 1), what=f"{_SIZE.what}, or a list of such", is_whole=True)


def shape_of(size: object) -> tuple[int, ...]:
    """The shape that the "size" of an input means: a number, or a list of them; () of a scalar. Raises ValueError."""
    shape = tuple(size) if isinstance(size, (list, tuple)) else (size,)
    if size == [] or not all(map(_SIZE.holds, shape)) or math.prod(shape) > LARGEST_SIZE:
        raise ValueError
    return tuple(map(int, shape))


def _input(value: Mapping[str, object], path: Steps, told: Told) -> Collection[str]:
    """The default is of the type and of the size; what is no number has no unit."""
    type_, size = value.get("type", "real"), value.get("size", ())
    if type_ not in ("real", "int") and value.get("unit") and isinstance(value["unit"], str):
        what = "a bool" if type_ == "bool" else "an enumeration"
        told.fault("E004", (*path, "unit"), f"{what} has no unit.", "Leave it out.")
    try:
        shape = shape_of(size)
    except ValueError:
        told.fault("E004", (*path, "size"), f"must be {SIZE.what}, not {in_words(size)}.")
        return ("default", "size")
    if "default" in value:
        default, at = value["default"], (*path, "default")
        if type_ in ("real", "int") and isinstance(default, dict) and "value" in default:  # a quantity
            default, at = default["value"], (*at, "value")
        members = members_of(type_) if isinstance(type_, dict) and _is_named(type_) else ()
        kind = _one_of(members) if members else TYPES.get(str(type_), NUMBER)
        _default(default, shape if isinstance(default, list) else (), kind, at, told)
    return ("default", "size")


def _default(default: object, shape: tuple[int, ...], kind: Kind, path: Steps, told: Told) -> None:
    """The default of an input: one value, or rows with one for each element."""
    if not shape:
        cure = in_a_file(default) if kind in (NUMBER, INTEGER) and path[-1] == "default" else ""
        if cure:
            told.fault("E004", path, f"must be {kind.what}, not {in_words(default)}.", cure)
        else:
            kind.check(default, path, told)
    elif not isinstance(default, list) or len(default) != shape[0]:
        shown = f"{len(default)}" if isinstance(default, list) else in_words(default)
        told.fault("E004", path, f"must be one value for all elements, or a list of {shape[0]} values, not {shown}.")
    else:
        for index, item in enumerate(default):
            _default(item, shape[1:], kind, (*path, index), told)


def _inputs(defs: dict[str, Schema]) -> Schema:
    """The same in the words of a schema."""

    def of(kinds: Kind) -> Schema:
        """One value, or one for each element of a vector or a matrix."""
        element = kinds.schema(defs)
        row = {"type": "array", "items": element}
        whole: list[Schema] = [element, row, {"type": "array", "items": row}]
        if kinds in (NUMBER, INTEGER):
            whole.append({"type": "object", "properties": {"value": {"anyOf": [*whole]}}})
        return {"properties": {"default": {"anyOf": whole}}}

    given: Schema = {"required": ["type"]}
    types = {name: {"properties": {"type": {"const": name}}} | given for name in TYPES}
    of_numbers = {"properties": {"type": {"enum": ["real", "int"]}}}
    return {
        "allOf": [
            *({"if": types[name], "then": of(kind)} for name, kind in TYPES.items()),
            {"if": {"not": given}, "then": of(NUMBER)},
            {"if": {"properties": {"type": {"type": "object"}}} | given, "then": of(TEXT)},
            {"if": of_numbers, "else": {"properties": {"unit": {"maxLength": 0}}}},
            {
                "if": {"properties": {"default": {"type": "array"}}, "required": ["default"]},
                "then": {"required": ["size"]},
            },
        ]
    }


INPUT = Object(
    UNIT,
    Field("default", DEFAULT, (
        "Its value where nothing is given (one, or one for each element). Without one, every run must give it."
    )),
    Field("size", SIZE, "The number of elements of a vector; of a matrix, a list."),
    Field("type", AnyOf(Choice(TYPES, what=f'"real", "int", "bool" or {_SHOWN}'), ENUMERATION, what=(
        f'"real", "int", "bool" or {_SHOWN}'
    )), "The kind of its values; a bool or a member of an enumeration has no unit.", "real"),
    DOC,
    rules=[Rule(_input, _inputs)],
    what='an object such as {"unit": "V"}',
    name="input",
    doc="An input of the diagram.",
)  # fmt: skip

# --- blocks ----------------------------------------------------------------------------------------------------

_NO_PATH = r"://|\u0000"
FILE = Text(
    is_empty=False, forbidden=_NO_PATH,
    refusal=Refusal("E007", "is not a path.", "Give the path of a diagram file in the project."),
)  # fmt: skip
# Two slashes begin the name of another computer, which Windows would call.
_FMU = Text(
    is_empty=False, forbidden=_NO_PATH + r"|^[\\/]{2}",
    refusal=Refusal("E007", "is not a path.", "Give the path of an FMU on this computer."),
)  # fmt: skip
_STREAM = Text(pattern="^" + streams.NAME.pattern.replace(r"\Z", "$"), refusal=Refusal(
    "E111", "is not the name of a stream.", 'Use a name, or a path such as "robot.noise" or "/robot.noise".'
))  # fmt: skip
_OFF = Choice(("held", "reset"))
_TIMEOUT = Scalar(what=f"a number of seconds above 0, at most {LONGEST_TIMEOUT:,.0f}", above=0, high=LONGEST_TIMEOUT)
KINDS = ("type", "diagram", "fmu")
CONTROLS = ("enable", "trigger")
OPTIONS = ("kind", "isolate", "timeout")
TRIGGERS = ("direction", "every")
_CONDITIONAL = (*CONTROLS, *OPTIONS)


def _one_kind(value: Mapping[str, object], path: Steps, told: Told) -> Collection[str]:
    kinds = [key for key in KINDS if key in value]
    if len(kinds) != 1:
        what = f"has {' and '.join(kinds)}" if kinds else "has none of type, diagram and fmu"
        message = f"{what}; a block is exactly one of the three."
        told.fault("E003" if kinds else "E009", path, message, at_key=True)
        return value.keys()
    if value.keys().isdisjoint(_CONDITIONAL):
        return ()
    controls, options = [key for key in CONTROLS if key in value], [key for key in OPTIONS if key in value]
    if controls and "diagram" not in value:
        told.fault("E003", (*path, controls[0]), "only a subdiagram can be enabled or triggered.", at_key=True)
    elif len(controls) == 2:
        told.fault("E003", (*path, controls[1]), "a subdiagram can be enabled or triggered, but not both.", at_key=True)
    if options and "fmu" not in value:
        told.fault("E003", (*path, options[0]), "only an FMU can have this key.", at_key=True)
        return options
    return ()


def _ticks(value: Mapping[str, object], path: Steps, told: Told) -> Collection[str]:
    if {"offset", "direction"} <= value.keys() and "every" not in value:
        told.fault("E003", (*path, "offset"), 'an offset needs ticks: add "every".', at_key=True)
    if ("every" in value) == ("direction" in value):
        told.fault("E009", path, 'a trigger needs either "direction" (for a signal) or "every" (for ticks).')
    for key in ("every", "offset"):
        if key in value:
            VALUE.check(value[key], (*path, key), told)
    return ("every", "offset")


ENABLE = Object(
    Field("states", _OFF, (
        "held: they keep their values while it is off; reset: they start again when it is turned on."
    ), "held"),
    Field("outputs", _OFF, "held: they stay as they are while it is off; reset: they are 0 while it is off.", "held"),
    doc='Of a subdiagram: it gets the bool input "enable".',
)  # fmt: skip
TRIGGER = Object(
    Field("direction", Choice(("up", "down", "both")), (
        'When its input "trigger" comes above 0 (up), below it (down), or both.'
    )),
    Field("every", SECONDS, "At ticks: the time from one to the next, in s."),
    Field("offset", SECONDS, "The time of the first tick, in s.", 0),
    rules=[Rule(_ticks, lambda _: {
        "oneOf": [{"required": [key]} for key in TRIGGERS], "dependentRequired": {"offset": ["every"]},
    })],
    doc='Of a subdiagram: it is computed when its input "trigger" fires, or at ticks.',
)  # fmt: skip
_COPIES = Scalar(low=1, high=LARGEST_SIZE, is_whole=True)
COPIES = Field("copies", AnyOf(_COPIES, EXPRESSION, what=f"{_COPIES.what}, or an expression", is_whole=True), (
    "How many blocks the entry makes: each port has one more dimension, and parameters may read index and copies."
))  # fmt: skip
_BLOCK = (
    Field("type", FILLED, "A block type of the library, or one of your own."),
    Field("diagram", AnyOf(Ref(lambda: BODY, dict, is_left=True), FILE, what="a diagram {...} or the path of one"), (
        "A subdiagram: here, or the path of a diagram file, from the folder of this file on."
    )),
    Field("fmu", _FMU, "The path of an FMU, from the folder of this file on."),
    Field("enable", ENABLE),
    Field("trigger", TRIGGER),
    Field("stream", _STREAM, (
        "The name of the stream of random numbers, or of those in a subdiagram, where it is not that of the block; "
        "with / in front it counts from the whole diagram."
    )),
    Field("kind", Choice(("CS", "ME")), (
        "Of an FMU: CS (Co-Simulation) brings its own solver, ME (Model Exchange) is integrated by the run."
    )),
    Field("isolate", FLAG, "Of an FMU: run it in a process of its own.", False),
    Field("timeout", _TIMEOUT, "Of an isolated FMU: how many seconds a call may take.", TIMEOUT),
    DOC,
    Field("parameters", Table(VALUE, Text(refers="own parameter")), (
        "Values of the type's parameters, of the subdiagram's, or of the FMU's."
    )),
)  # fmt: skip
_RULES = [Rule(_one_kind, lambda _: {
    "oneOf": [{"required": [kind]} for kind in KINDS],
    "dependentRequired": {key: ["diagram"] for key in CONTROLS} | {key: ["fmu"] for key in OPTIONS},
    "not": {"required": [*CONTROLS]},
})]  # fmt: skip
_HINT = ' What the block computes with stands in "parameters".'
_SUCH = 'an object such as {"type": "Gain"}'
VARIANT = Object(
    *_BLOCK,
    Field("ports", Table(Text(what="the name of a port", is_empty=False, refers="own port"), Text(refers="port")), (
        "The variant's own names of the block's ports, where they differ."
    )),
    rules=_RULES, hint=_HINT, what=_SUCH, name="variant", doc="What may stand in place of the block.",
)  # fmt: skip
BLOCK = Object(
    *_BLOCK[: len(KINDS)],
    COPIES,
    *_BLOCK[len(KINDS) :],
    Field("variant", Text(refers="variant"), (
        'The variant that is taken unless another is asked for; "base": the block itself.'
    )),
    Field("variants", Table(
        VARIANT, NAMES, is_open=True, reserved=(BASE, f'"{BASE}" is the name of the block itself.')
    ), "What may stand in place of the block, by name."),
    rules=_RULES, hint=_HINT, what=_SUCH, name="block", doc="A block: exactly one of type, diagram and fmu.",
)  # fmt: skip

# --- diagrams --------------------------------------------------------------------------------------------------

MOMENT = AnyOf(*SECONDS.kinds, QUANTITY_TEXT, unit="s")
MEASURE = Object(
    Field("type", Text(meanings=MEASURES), "What is measured, of e = of - against.", required=True),
    Field("of", SIGNAL_NAME, 'A signal, such as "motor.omega".', required=True),
    Field("against", AnyOf(SCALAR, SIGNAL_NAME), (
        "A signal, or a number in the unit of `of`, that is taken off."
    ), 0, is_later=True),
    Field("from", MOMENT, "Start of the window, in s; left out: the start of the run.", is_later=True),
    Field("to", MOMENT, "End of the window, in s; left out: the end of the run.", is_later=True),
    Field("band", AnyOf(Scalar(above=0, below=1), COMPUTED, QUANTITY_TEXT), (
        "Of settling_time: a part of the step's size."
    ), 0.02, is_later=True),
    Field("omega", AnyOf(Scalar(above=0), COMPUTED, QUANTITY_TEXT, unit="rad/s"), (
        "Of THD: the angular frequency of the fundamental, in rad/s. The window must hold whole periods of it."
    ), is_later=True),
    DOC,
    strays=meant_keys(MEASURE_KEYS),
    what='an object such as {"type": "ITAE", ...}',
    name="measure",
    doc="A number that every run takes.",
)  # fmt: skip
_SOURCE_SHOWN = 'the text of a source such as "motor.omega"'
BODY: Object = Object(
    Field("name", Text(pattern=NAMES.pattern, refusal=Refusal("E111", "is not a name.", name_cure, is_whole=True)), (
        "The name of the diagram."
    ), "diagram"),
    OPEN_DOC,
    Field("parameters", Table(VALUE, NAMES, is_open=True), (
        "Values that blocks share, by name; expressions of this diagram read them."
    )),
    Field("inputs", Table(INPUT, NAMES, is_open=True), "What comes from outside, by name."),
    Field("outputs", Table(Text(what=_SOURCE_SHOWN, refers="source", doc=(
        'A source: "motor.omega", an element "motor.x[0]", or an input.'
    )), NAMES, is_open=True), "What others see of the diagram: sources by name."),
    Field("blocks", Table(BLOCK, NAMES, is_open=True), "The blocks, by name."),
    Field("wires", Table(Text(what=_SOURCE_SHOWN, refers="source", doc=(
        'A source: "control.y", an element "plant.y[1]", or an input of the diagram.'
    )), Text(refers="sink"), is_open=True), 'Where each input of a block comes from: "motor.v": "control.y".'),
    Field("run", RUN),
    Field("measures", Table(MEASURE, NAMES, is_open=True), "Numbers that every run takes, by name."),
    Field("layout", Table(ListOf(NUMBER, 2, 2, what="a position [x, y]", is_even=True, doc=(
        "[x, y] in pixels, to the right and down."
    )), Text(pattern=NAMES.pattern, refers="placed"), tells=False, is_open=True), (
        "The positions of blocks, inputs and outputs in drawings."
    )),
    strays={
        **meant_keys(BODY_KEYS),
        **{field.key: f'It belongs into "run": {{"{field.key}": ...}}.' for field in RUN.fields if field is not DOC},
    },
    name="diagram",
    is_open=True,
    doc="A subdiagram.",
)  # fmt: skip


def header(format_: str, versions: Sequence[int], what: str) -> tuple[Field, ...]:
    """The keys that every file begins with."""
    return (
        Field(SCHEMA, TEXT, "The JSON Schema of this file, for editors: a path or a URL. It is never fetched."),
        Field("format", Constant(format_), f"What marks a {what}.", required=True, is_later=True),
        Field("version", Constant(*versions), "The version of the format.", required=True, is_later=True),
    )


DIAGRAM = Object(
    *header(FORMAT, (OLD_VERSION, VERSION), "diagram file"), *BODY.fields, strays=BODY.strays, is_open=True,
    doc="A block diagram with its parameters, wires, run settings and measures.",
)  # fmt: skip
