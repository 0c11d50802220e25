"""What a study file may hold: every key with its kind, limits, usual value and meaning, once."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

from ..results import plots
from ..text.grammar import AnyOf, Choice, Field, ListOf, Object, Ref, Rule, Scalar, Steps, Table, Text, Told
from .diagram import is_name
from .diagram_grammar import DOC, FILLED, FLAG, NAMES, NUMBER, OPEN_DOC, PLAIN, QUANTITY, RUN, TEXT, header

__all__ = [
    "ASSUMED", "CLAIM", "FIGURE", "FORMAT", "LINE", "MARKER", "ONE_RUN", "PANEL", "SETTINGS", "STUDY", "VERSION",
    "named",
]  # fmt: skip

FORMAT, VERSION = "blocks-study", 1

# --- runs ------------------------------------------------------------------------------------------------------

# The settings of a run are read where it is prepared, those of the master with them.
SETTINGS = Object(
    *(replace(field, is_later=field.key == "master" or field.is_later) for field in RUN.fields if field is not DOC),
    doc="Run settings in place of those of the diagram.",
)


def _values(value: Mapping[str, Any], path: Steps, told: Told) -> Collection[str]:
    parameters = value.get("parameters")
    for key, given in parameters.items() if isinstance(parameters, dict) else ():
        if given is None or (isinstance(given, dict) and "value" not in given):
            what = 'must be a value, such as 0.2, "=kp" or {"value": 200, "unit": "mOhm"}.'
            told.fault("E004", (*path, "parameters", key), what)
    return ()


ONE_RUN = Object(
    Field("diagram", FILLED, "The path of a diagram file, from the folder of this file on.", required=True),
    Field("parameters", Table(Ref(lambda: AnyOf(PLAIN, QUANTITY), dict, is_left=True), Text(refers="own parameter")), (
        'Values of parameters by path ("motor.Ra"), in place of those of the diagram.'
    )),
    Field("variants", Table(Text(what="the name of a variant", refers="variant"), Text(refers="block")), (
        "The variants of blocks that are taken, by path."
    )),
    Field("settings", SETTINGS),
    DOC,
    rules=[Rule(_values)],
    what='an object such as {"diagram": "loop.json"}',
    name="one_run",
    doc="A run: a diagram with parameters, variants and settings of its own.",
)  # fmt: skip

# --- claims ----------------------------------------------------------------------------------------------------

_RUN_NAME = Text(refers="run")


def named(claim: Mapping[str, Any]) -> list[Any]:
    """The runs that a claim names: one, or two in a list; none where it does otherwise."""
    runs = claim.get("runs", [claim.get("run")])
    is_fine = ("run" in claim) != ("runs" in claim) and isinstance(runs, list)
    return runs if is_fine and len(runs) == 1 + ("runs" in claim) else []


def _claim(value: Mapping[str, Any], path: Steps, told: Told) -> Collection[str]:
    runs, reason = named(value), value.get("reason")
    if not runs:
        told.fault("E009", path, 'a claim names one "run", or two "runs" in a list.')
    else:
        for _ in [name for name in runs if not isinstance(name, str)]:
            told.fault("E004", path, "a run is named by a text.")
        if ("runs" in value) != ("as" in value):
            what = 'two runs are compared "as" a "reduction" or an "increase"; one run has no "as".'
            told.fault("E004", path, what)
    if "published" not in value:
        if "expect" in value or "tolerance" in value:
            told.fault("E009", path, 'a claim with "expect" or "tolerance" needs the "published" number.')
        return ("run", "runs")
    if "tolerance" not in value:
        told.fault("E009", path, 'a claim states its "tolerance" between 0 and 1, as in 0.05.')
    if "expect" not in value:
        told.fault("E009", path, 'a claim states what to "expect": "reproduced" or "not reproduced".')
    if value.get("expect") == "not reproduced" and not (isinstance(reason, str) and reason):
        told.fault("E009", path, 'a number that is "not reproduced" needs its "reason".')
    return ("run", "runs")


CLAIM = Object(
    Field("run", _RUN_NAME, "The run that the claim is about."),
    Field("runs", ListOf(_RUN_NAME, 2, 2), "Two runs, whose change in % the claim is about."),
    Field("measure", Text(is_empty=False, refers="measure"), "A measure of the diagram.", required=True),
    Field("as", Choice(("reduction", "increase")), "The change from the first to the second run."),
    Field("published", Scalar(what="a number other than 0, as there is no ratio to it", other=0), (
        "The published number; left out, the value is only shown."
    )),
    Field("unit", TEXT, "Its unit, for the report."),
    Field("source", TEXT, "Where it was published."),
    Field("tolerance", Scalar(what="a number between 0 and 1, as in 0.05", above=0, below=1), (
        "The largest deviation of value/published from 1 that counts as reproduced."
    )),
    Field("expect", Choice(("reproduced", "not reproduced")), "The verdict that is expected."),
    Field("reason", TEXT, "Why a number is not reproduced."),
    rules=[Rule(_claim, lambda _: {
        "oneOf": [{"required": ["run"]}, {"required": ["runs"]}],
        "dependentRequired": {
            "runs": ["as"], "as": ["runs"], "published": ["tolerance", "expect"], "tolerance": ["published"],
            "expect": ["published"],
        },
        "if": {"properties": {"expect": {"const": "not reproduced"}}, "required": ["expect"]},
        "then": {"properties": {"reason": {"minLength": 1}}, "required": ["reason"]},
    })],
    name="claim",
    doc="A measure beside a published number.",
)  # fmt: skip

# --- figures ---------------------------------------------------------------------------------------------------

_LAST_STYLE = len(plots.STYLES) - 1
_CURVE = (
    Field("run", _RUN_NAME, "The name of a run of this study.", required=True),
    Field("signal", FILLED, "A recorded signal.", required=True),
    Field("label", TEXT, "What the legend says."),
    Field("style", Scalar(
        what=f"an integer from 0 to {_LAST_STYLE}, or null for a dotted line", low=0, high=_LAST_STYLE, is_whole=True,
        is_null=True,
    ), "The number of its color and pattern; null: dotted."),
    Field("scale", NUMBER, "A factor of its values.", 1),
)  # fmt: skip
LINE = Object(*_CURVE, name="line", doc="A curve.")


def _place(value: Mapping[str, Any], path: Steps, told: Told) -> Collection[str]:
    if "signal" not in value and "run" not in value:
        if not {"x", "y"} <= value.keys():
            told.fault("E009", path, 'a marker has "run" and "signal", or "x" and "y".')
        return ()
    for key in ("run", "signal"):
        if value.get(key, "") == "" and (key == "signal" or key not in value):
            told.fault("E009", path, f'"{key}" is empty.' if key in value else f'the key "{key}" is missing.')
    return ("signal",) if value.get("signal") == "" else ()


MARKER = Object(
    *(replace(field, required=False) for field in _CURVE),
    Field("x", NUMBER, "Of a marker without a signal: its time."),
    Field("y", NUMBER, "Of a marker without a signal: its value."),
    rules=[Rule(_place, lambda _: {
        "if": {"anyOf": [{"required": ["run"]}, {"required": ["signal"]}]},
        "then": {"required": ["run", "signal"]},
        "else": {"required": ["x", "y"]},
    })],
    name="marker",
    doc="A point: the largest value of a signal, or a place.",
)  # fmt: skip


def _numbers(count: int) -> ListOf:
    return ListOf(NUMBER, count, count, what=f"a list of {count} numbers", is_even=True)


def _objects(kind: Object, least: int = 0, *, is_open: bool = True) -> ListOf:
    return ListOf(kind, least, what="a list of objects", is_even=True, is_open=is_open)


PANEL = Object(
    Field("lines", _objects(LINE, 1), "Its curves.", required=True),
    Field("ylabel", TEXT, "The label of the vertical axis, with the unit in [ ]."),
    Field("markers", _objects(MARKER, is_open=False), "Points with texts."),
    Field("band", _numbers(2), "A grey stretch of time: [from, to]."),
    Field("inset", _numbers(4), "A part that is also shown enlarged: [x0, x1, y0, y1]."),
    Field("log", FLAG, "Whether the axis is logarithmic; of spectra it is."),
    Field("height", Scalar(above=0), "Beside the others.", 1),
    name="panel",
)


def _named(value: Mapping[str, Any], path: Steps, told: Told) -> Collection[str]:
    if not is_name(value.get("name")):
        told.fault("E111", path, 'a figure needs a "name" of letters, digits and _.')
    return ("name",)


FIGURE = Object(
    Field("name", NAMES, "The name of its file.", required=True),
    Field("title", TEXT, "Its title."),
    DOC,
    Field("kind", Choice(("time", "spectrum")), "Signals over time, or their amplitude spectra.", "time"),
    Field("panels", _objects(PANEL, 1), "Axes, from the top.", required=True),
    Field("from", NUMBER, "Begin of the window, in s."),
    Field("to", NUMBER, "End of the window, in s."),
    Field("xlabel", TEXT, "The label of the horizontal axis."),
    rules=[Rule(_named)],
    name="figure",
)

# --- studies ---------------------------------------------------------------------------------------------------

ASSUMED = Object(
    Field("what", TEXT, "What is assumed."),
    Field("why", TEXT, "Why."),
    Field("contradicts", TEXT, "What the source says otherwise."),
)
STUDY = Object(
    *header(FORMAT, VERSION, "study file"),
    Field("name", NAMES, "The name of the study, and of the folder of its report."),
    Field("title", TEXT, "The title of the report."),
    OPEN_DOC,
    Field("source", TEXT, "What is studied: a paper, a book."),
    Field("runs", Table(ONE_RUN, NAMES, tells=False, is_open=True), "The runs, by name."),
    Field("assumed", _objects(ASSUMED), "What the source leaves open."),
    Field("claims", _objects(CLAIM), "Measures beside published numbers."),
    Field("figures", _objects(FIGURE), "Figures of the report."),
    is_open=True,
    doc="Runs of diagrams whose measures are set beside published numbers.",
)
