"""What a study file may hold: every key with its kind, limits, usual value and meaning, once."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

from ..results import plots
from ..text.grammar import AnyOf, Choice, Field, Kind, ListOf, Object, Ref, Rule, Scalar, Steps, Table, Text, Told
from ..text.other_words import margin_meant
from .diagram_grammar import DOC, FILLED, FLAG, NAMES, NUMBER, OPEN_DOC, PLAIN, QUANTITY, RUN, TEXT, TIME, header
from .diagram_value import is_name

FORMAT, VERSION = "blocks-study", 1

# --- runs ------------------------------------------------------------------------------------------------------

# The settings of a run are read where it is prepared, those of the master with them.
SETTINGS = Object(
    *(replace(field, is_later=field.key == "master" or field.is_later) for field in RUN.fields if field is not DOC),
    doc="Run settings in place of those of the diagram.",
)


def _values(value: Mapping[str, object], path: Steps, told: Told) -> Collection[str]:
    parameters = value.get("parameters")
    for key, given in parameters.items() if isinstance(parameters, dict) else ():
        if given is None or (isinstance(given, dict) and "value" not in given):
            what = 'must be a value, such as 0.2, "=kp" or {"value": 200, "unit": "mOhm"}.'
            told.fault("E004", (*path, "parameters", key), what)
    return ()


_PARAMETERS = Table(Ref(lambda: AnyOf(PLAIN, QUANTITY), dict, is_left=True), Text(refers="own parameter"))
_MODEL = (
    Field("diagram", FILLED, "The path of a diagram file, from the folder of this file on.", required=True),
    Field("parameters", _PARAMETERS, (
        'Values of parameters by path or pattern ("motor.Ra"), in place of those of the diagram.'
    )),
    Field("variants", Table(Text(what="the name of a variant", refers="variant"), Text(refers="block")), (
        "The variants of blocks that are taken, by path."
    )),
)  # fmt: skip
ONE_RUN = Object(
    *_MODEL,
    Field("settings", SETTINGS),
    DOC,
    rules=[Rule(_values)],
    what='an object such as {"diagram": "loop.json"}',
    name="one_run",
    doc="A run: a diagram with parameters, variants and settings of its own.",
)  # fmt: skip

# --- sweeps ----------------------------------------------------------------------------------------------------

SWEEP_FIGURES = ("bands", "histogram", "ecdf", "scatter", "heat map")
SAMPLERS = ("random", "sobol", "halton", "lhs", "saltelli")
MARGINS = {
    "gain_margin": "the factor of gain that the loop bears",
    "phase_margin": "the phase that the loop bears, in deg",
    "delay_margin": "the delay that the loop bears, in s",
    "modulus_margin": "the least |1 + L|",
    "disk_margin": "the largest disk of factors of gain and phase that the loop bears",
    "Ms": "the largest |S|, S = 1/(1 + L)",
    "Mt": "the largest |T|, T = L/(1 + L)",
    "crossover": "the frequency of the phase margin, in rad/s",
    "bandwidth": "that of T, or from a signal to another, in rad/s, relative to the gain at zero frequency",
    "slowest_pole": "the largest real part of the poles of the closed loop, or from a signal to another, in 1/s",
    "damping": "the least damping of these poles",
}
"""What a sweep can tell of the linear model of each row."""
_OF_ENDS = ("bandwidth", "slowest_pole", "damping")
_OF_CHANNELS = ("disk_margin", "Ms", "Mt", "slowest_pole", "damping")
_SIGNAL = Text(is_empty=False, refers="signal")
_SIZES = Table(AnyOf(Scalar(above=0), QUANTITY), _SIGNAL)


def _margin(value: Mapping[str, object], path: Steps, told: Told) -> Collection[str]:
    kind, is_loop = value.get("type"), "loop" in value
    if isinstance(kind, str) and kind not in MARGINS:
        cure = margin_meant(kind) or told.guess(kind, MARGINS) or f"Margins: {', '.join(MARGINS)}."
        told.fault("E003", (*path, "type"), f'"{kind}" is not a margin.', cure)
    elif (("from" in value) != ("to" in value)) or is_loop == ("from" in value):
        told.fault("E009", path, 'a margin needs either "loop", the signal at which it is opened, or "from" and "to".')
    elif not is_loop and kind not in _OF_ENDS:
        told.fault("E009", path, f'{kind} needs a "loop", the signal at which the loop is opened.')
    elif isinstance(value.get("loop"), list) and kind not in _OF_CHANNELS:
        message = f"{kind} is of a loop at one signal; of several signals there are {', '.join(_OF_CHANNELS)}."
        told.fault("E009", path, message)
    return ()


MARGIN = Object(
    Field("type", Text(meanings=MARGINS), "The number that is computed from the linear model.", required=True),
    Field("loop", AnyOf(_SIGNAL, ListOf(_SIGNAL, 1)), "The signal at which the loop is opened; several: together."),
    Field("from", _SIGNAL, "Where a change is put in."),
    Field("to", _SIGNAL, "Where it is looked at."),
    Field("openings", ListOf(_SIGNAL), "Signals that are cut."),
    Field("amplitude", _SIZES, "By signal, the amplitude of a sine at laws that have no slope."),
    Field("sigma", _SIZES, "By signal, the deviation of noise at laws that have no slope."),
    Field("overrides", Table(AnyOf(NUMBER, ListOf(ListOf(NUMBER))), Text(refers="block")), (
        "Gains in the place of blocks, by path."
    )),
    Field("inputs", Table(AnyOf(NUMBER, FLAG, ListOf(NUMBER), QUANTITY), Text(refers="input")), (
        "Values of its inputs."
    )),
    Field("at", TIME, "The time of a run at which the row is linearized; left out: its start."),
    Field("pade", Scalar(low=0, high=20, is_whole=True), "The order of the models of exact delays.", 0),
    rules=[Rule(_margin, lambda _: {
        "oneOf": [
            {"required": ["loop"], "not": {"anyOf": [{"required": ["from"]}, {"required": ["to"]}]}},
            {"required": ["from", "to"], "not": {"required": ["loop"]}},
        ],
        "if": {"required": ["from"]},
        "then": {"properties": {"type": {"enum": [*_OF_ENDS]}}},
        "dependentSchemas": {"loop": {
            "if": {"properties": {"loop": {"type": "array"}}},
            "then": {"properties": {"type": {"enum": [*_OF_CHANNELS]}}},
        }},
    })],
    what='an object such as {"type": "gain_margin", "loop": "control.u"}',
    strays={"held": 'It is "inputs" now.'},
    name="margin",
    doc="A margin, a pole or a bandwidth of each row, by linearizing it.",
)  # fmt: skip
_SUCH = 'a list of values, or such as {"normal": [0.27, 0.02]}'
_VARIED = AnyOf(
    ListOf(AnyOf(PLAIN, QUANTITY), 1), Table(AnyOf(ListOf(NUMBER), Table(NUMBER)), least=1, most=1, what=_SUCH),
    what=_SUCH, name="varied",
    doc="Values in the unit of the parameter: a list; linspace, geomspace [from, to, count]; normal [mean, deviation]; "
    "uniform, loguniform [low, high]; triangular [low, mode, high]; truncatednormal [mean, deviation, low, high]; or "
    'a distribution of scipy.stats with its parameters, {"lognorm": {"s": 0.3, "scale": 2}}.',
)  # fmt: skip


def _varies(value: Mapping[str, object], path: Steps, told: Told) -> Collection[str]:
    for key in ("vary", "over"):
        if value.get(key) == {}:
            told.fault("E009", path, f'"{key}" is empty.')
    return _values(value, path, told)


_OF_ROWS = Object(*(field for field in SETTINGS.fields if field.key not in ("seed", "log")), doc=SETTINGS.doc)
LANES = ("exact", "fast")
ONE_SWEEP = Object(
    *_MODEL,
    Field("vary", Table(_VARIED, Text(refers="own parameter"), least=1), (
        'What varies, by path; "motor_*.Ra": one value for all that it names; "each(motor_*.Ra)": one for each.'
    ), required=True),
    Field("n", Scalar(low=1, is_whole=True), "Draws of the distributions; lists are crossed with them."),
    Field("sampler", Choice(SAMPLERS), "How they are drawn.", "random"),
    Field("seed", Scalar(low=0, is_whole=True), "Of the draws, and of the seeds of all runs.", 0),
    Field("measures", ListOf(Text(refers="measure")), "The measures that are taken; left out: all."),
    Field("log", ListOf(_SIGNAL), "Signals that are kept, for bands over time."),
    Field("margins", Table(MARGIN, NAMES, is_open=True), "Of the linear model of each row, by name."),
    Field("scenarios", Table(_PARAMETERS, NAMES), "By name, parameters set on top; all rows run in each."),
    Field("max_steps", Scalar(low=1, is_whole=True), "The most steps of a run."),
    Field("lanes", Choice(LANES), "Whether rows are single runs bit for bit, or within the tolerance.", "exact"),
    Field("settings", _OF_ROWS),
    DOC,
    rules=[Rule(_varies)],
    strays={"budget": 'It is "max_steps" now.'},
    what='an object such as {"diagram": "loop.json", "vary": {...}}',
    name="one_sweep",
    doc="A sweep: runs of a diagram with varied parameters.",
    is_open=True,
)  # fmt: skip

# --- tunings ---------------------------------------------------------------------------------------------------

OPTIMIZERS = ("cma", "de")
_MEASURES = Text(is_empty=False, refers="measures")


def _numbers(count: int) -> ListOf:
    return ListOf(NUMBER, count, count, what=f"a list of {count} numbers", is_even=True)


ONE_TUNING = Object(
    *_MODEL,
    Field("minimize", _MEASURES, (
        'An expression over measures: "ITAE + 1e-3*noisy.ISU"; a bare name is the mean over the scenarios.'
    ), required=True),
    Field("over", Table(_numbers(2), Text(refers="own parameter"), least=1), (
        'The least and the largest value, by path ("motor.Ra"), pattern ("motor_*.Ra") or element ("pid.k[0]").'
    ), required=True),
    Field("subject_to", ListOf(_MEASURES), (
        'Constraints: "noisy.variation <= 75"; one of bare names holds in each scenario.'
    )),
    Field("scenarios", Table(_PARAMETERS, NAMES), (
        "By name, parameters set on top; each candidate runs in all. Left out: one, named nominal."
    )),
    Field("optimizer", Choice(OPTIMIZERS), "CMA-ES (package cma), or differential evolution.", "cma"),
    Field("budget", Scalar(low=1, is_whole=True), "How many candidates are run.", 500),
    Field("search_seed", Scalar(low=0, is_whole=True), "Of the optimizer.", 1),
    Field("lanes", Choice(LANES), "As of a sweep.", "exact"),
    Field("settings", _OF_ROWS),
    DOC,
    rules=[Rule(_varies)],
    strays={"method": 'It is "optimizer" now.', "seed": 'It is "search_seed" now.'},
    what='an object such as {"diagram": "loop.json", "minimize": "ITAE", "over": {...}}',
    name="one_tuning",
    doc="A tuning: a search for values of parameters that make measures small.",
    is_open=True,
)  # fmt: skip

# --- claims ----------------------------------------------------------------------------------------------------

_RUN_NAME, _SWEEP_NAME, _TUNING_NAME = Text(refers="run"), Text(refers="sweep"), Text(refers="tuning")
_STATISTICS = ("quantile", "statistic", "share")
_LIMITS = ("at_most", "at_least")


def named(claim: Mapping[str, Any]) -> list[Any]:
    """The runs that a claim names: one, or two in a list; none where it does otherwise."""
    runs = claim.get("runs", [claim.get("run")])
    is_fine = ("run" in claim) != ("runs" in claim) and isinstance(runs, list)
    return runs if is_fine and len(runs) == 1 + ("runs" in claim) else []


def _claim(value: Mapping[str, object], path: Steps, told: Told) -> Collection[str]:
    runs, reason = named(value), value.get("reason")
    if "sweep" in value:
        _of_sweep(value, path, told)
    elif "tuning" in value:
        if {"run", "runs"} & value.keys():
            told.fault("E009", path, 'a claim names either a "tuning" or runs, not both.')
    elif not runs:
        told.fault("E009", path, 'a claim needs one "run", or a list of two "runs".')
    else:
        for _ in [name for name in runs if not isinstance(name, str)]:
            told.fault("E004", path, "the name of a run must be a text.")
        if ("runs" in value) != ("as" in value):
            what = 'a claim about two runs needs "as": "reduction" or "increase"; a claim about one run has no "as".'
            told.fault("E004", path, what)
    if "sweep" not in value and {*_STATISTICS, "scenario"} & value.keys():
        told.fault("E009", path, f'{", ".join(_STATISTICS)} and scenario need a "sweep".')
    limits = [key for key in _LIMITS if key in value]
    if limits:
        if len(limits) > 1 or "published" in value or "tolerance" in value:
            told.fault("E009", path, 'a claim needs one of "at_most", "at_least", and "published" with "tolerance".')
        if value.get("expect", "reproduced") in ("reproduced", "not reproduced"):
            told.fault("E009", path, 'a claim with a limit needs "expect": "holds" or "fails".')
    elif "published" not in value:
        if "expect" in value or "tolerance" in value:
            told.fault("E009", path, 'a claim with "expect" or "tolerance" needs the "published" number.')
        return ("run", "runs")
    else:
        if "tolerance" not in value:
            told.fault("E009", path, 'a claim needs a "tolerance" between 0 and 1, as in 0.05.')
        if value.get("expect", "holds") in ("holds", "fails"):
            told.fault("E009", path, 'a claim needs "expect": "reproduced" or "not reproduced".')
    if value.get("expect") in ("not reproduced", "fails") and not (isinstance(reason, str) and reason):
        what = 'a number that is "not reproduced"' if value["expect"] != "fails" else "a limit that fails"
        told.fault("E009", path, f'{what} needs its "reason".')
    return ("run", "runs")


def _of_sweep(value: Mapping[str, object], path: Steps, told: Told) -> None:
    if {"run", "runs", "as", "tuning"} & value.keys():
        told.fault("E009", path, 'a claim names either a "sweep" or runs, not both.')
    if sum(key in value for key in _STATISTICS) != 1:
        told.fault("E009", path, f"a claim about a sweep needs exactly one of {', '.join(_STATISTICS)}.")
    elif "share" in value and not {*_LIMITS} & value.keys():
        told.fault("E009", path, 'a "share" counts the rows that keep a limit: add "at_most" or "at_least".')


CLAIM = Object(
    Field("run", _RUN_NAME, "The run that the claim is about."),
    Field("runs", ListOf(_RUN_NAME, 2, 2), "Two runs, whose change in % the claim is about."),
    Field("sweep", _SWEEP_NAME, "The sweep about whose rows the claim is."),
    Field("scenario", Text(refers="scenario"), "One of its scenarios; left out: the rows of all."),
    Field("tuning", _TUNING_NAME, "The tuning about whose best values the claim is."),
    Field("measure", Text(is_empty=False, refers="measure"), (
        'A measure, or a margin of the sweep; of a tuning, one in a scenario ("noisy.variation"), the mean over all '
        'scenarios ("variation"), or what is minimized ("objective").'
    ), required=True),
    Field("as", Choice(("reduction", "increase")), (
        "The change from the first to the second run; of a tuning, from before to after."
    )),
    Field("quantile", Scalar(low=0, high=1), "Of a sweep: the claim is about this quantile; 0.5: the median."),
    Field("statistic", Choice(("mean", "deviation")), "Of a sweep: its mean or standard deviation."),
    Field("share", Scalar(low=0, high=1), (
        "Of a sweep: the least share of all rows that keep the limit; a row without a number does not."
    )),
    Field("at_most", NUMBER, "A limit of the value, in the unit of the claim."),
    Field("at_least", NUMBER, "The same, from below."),
    Field("published", Scalar(what="a number other than 0, as there is no ratio to it", other=0), (
        "The published number; left out, the value is only shown."
    )),
    Field("unit", TEXT, "The unit of its numbers, and of the value."),
    Field("source", TEXT, "Where it was published."),
    Field("tolerance", Scalar(what="a number between 0 and 1, as in 0.05", above=0, below=1), (
        "The largest deviation of value/published from 1 that counts as reproduced."
    )),
    Field("expect", Choice(("reproduced", "not reproduced", "holds", "fails")), (
        'The verdict that is expected: "holds" or "fails" of a limit.'
    )),
    Field("reason", TEXT, "Why a number is not reproduced, or a limit fails."),
    rules=[Rule(_claim, lambda _: {
        "oneOf": [{"required": [key]} for key in ("run", "runs", "sweep", "tuning")],
        "dependentRequired": {
            "runs": ["as"], "published": ["tolerance", "expect"], "tolerance": ["published"],
            **{key: ["sweep"] for key in ("scenario", *_STATISTICS)}, **{key: ["expect"] for key in _LIMITS},
        },
        "allOf": [
            {"if": {"required": ["as"]}, "then": {"anyOf": [{"required": [key]} for key in ("runs", "tuning")]}},
            {"if": {"properties": {"expect": {"enum": ["not reproduced", "fails"]}}, "required": ["expect"]},
             "then": {"properties": {"reason": {"minLength": 1}}, "required": ["reason"]}},
            {"if": {"required": ["sweep"]}, "then": {"oneOf": [{"required": [key]} for key in _STATISTICS]}},
            {"if": {"required": ["expect"]}, "then": {
                "oneOf": [{"required": [key]} for key in ("published", *_LIMITS)]
            }},
            {"if": {"anyOf": [{"required": [key]} for key in _LIMITS]},
             "then": {"properties": {"expect": {"enum": ["holds", "fails"]}}},
             "else": {"properties": {"expect": {"enum": ["reproduced", "not reproduced"]}, "share": False}}},
        ],
    })],
    name="claim",
    doc="A measure beside a published number, or within a limit.",
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
    ), "The number of its color and pattern; null: dotted. Without it, the next that no other line of the panel has."),
    Field("scale", NUMBER, "A factor of its values.", 1),
)  # fmt: skip
LINE = Object(*_CURVE, name="line", doc="A curve.")


def _place(value: Mapping[str, object], path: Steps, told: Told) -> Collection[str]:
    if "signal" not in value and "run" not in value:
        if not {"x", "y"} <= value.keys():
            told.fault("E009", path, 'a marker needs either "run" and "signal", or "x" and "y".')
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


def _objects(kind: Kind, least: int = 0, *, is_open: bool = True) -> ListOf:
    return ListOf(kind, least, what="a list of objects", is_even=True, is_open=is_open)


def _has_limits(value: Mapping[str, Any], path: Steps, told: Told) -> Collection[str]:
    _check_span(value.get("ylim"), (*path, "ylim"), told)
    return ()


PANEL = Object(
    Field("lines", _objects(LINE, 1), "Its curves.", required=True),
    Field("ylabel", TEXT, "The label of the vertical axis, with the unit in [ ]."),
    Field("markers", _objects(MARKER, is_open=False), "Points with texts."),
    Field("band", _numbers(2), "A grey stretch of time: [from, to]."),
    Field("inset", _numbers(4), "A part that is also shown enlarged: [x0, x1, y0, y1]."),
    Field("log", FLAG, "Whether the axis is logarithmic; of spectra it is."),
    Field("height", Scalar(above=0), "Beside the others.", 1),
    Field("ylim", _numbers(2), "The least and the largest value of the vertical axis: [from, to]."),
    rules=[Rule(_has_limits)],
    name="panel",
)


def _named(value: Mapping[str, object], path: Steps, told: Told) -> Collection[str]:
    if not is_name(value.get("name")):
        told.fault("E111", path, 'a figure needs a "name" of letters, digits and _.')
    return ("name",)


def _check_span(span: object, path: Steps, told: Told) -> None:
    if isinstance(span, list) and len(span) == 2 and _numbers(2).takes(span) and span[0] >= span[1]:
        told.fault("E004", path, f"{span} does not end after its start. Write [from, to].")


def _rising(value: Mapping[str, Any], path: Steps, told: Told) -> Collection[str]:
    for k, window in enumerate(value.get("windows", ())):
        _check_span(window, (*path, "windows", k), told)
    return ()


_FORMAT = Field("format", Choice(("png", "svg", "pdf")), "The format of its file, beside the report.", "png")


FIGURE = Object(
    Field("name", NAMES, "The name of its file.", required=True),
    Field("title", TEXT, "Its title."),
    DOC,
    _FORMAT,
    Field(
        "size",
        ListOf(Scalar(above=0, high=100), 2, 2, what="a size [width, height]", is_even=True),
        "Its width and its height, in inches.",
    ),
    Field("kind", Choice(("time", "spectrum")), "Signals over time, or their amplitude spectra.", "time"),
    Field("panels", _objects(PANEL, 1), "Axes, from the top.", required=True),
    Field("from", NUMBER, "Start of the window, in s."),
    Field("to", NUMBER, "End of the window, in s."),
    Field(
        "windows",
        ListOf(_numbers(2), 1, what="a list of [from, to]"),
        ("Stretches [from, to] of the horizontal axis, beside each other; left out: all of it."),
    ),
    Field("xlabel", TEXT, "The label of the horizontal axis."),
    rules=[Rule(_named), Rule(_rising)],
    name="figure",
)
_SOME = AnyOf(FILLED, ListOf(FILLED, 1), what="a name, or a list of names")
SWEEP_FIGURE = Object(
    Field("name", NAMES, "The name of its file.", required=True),
    Field("title", TEXT, "Its title."),
    DOC,
    _FORMAT,
    Field("sweep", _SWEEP_NAME, "The name of a sweep of this study.", required=True),
    Field("scenario", Text(refers="scenario"), "One of its scenarios; left out: all."),
    Field("of", _SOME, "Signals that it keeps, measures, margins or varied parameters; left out: all signals."),
    Field("against", _SOME, "Measures or varied parameters: one or more (scatter), or two (heat map)."),
    Field("kind", Choice(SWEEP_FIGURES), "What is drawn, where it does not follow from these."),
    Field("bins", Scalar(low=1, high=1000, is_whole=True), "Of a histogram, or of each axis of a heat map."),
    rules=[Rule(_named)],
    by="sweep",
    name="sweep_figure",
    doc="A figure of a sweep: bands over time of signals; histograms, scatter or a heat map of measures.",
)

# --- studies ---------------------------------------------------------------------------------------------------

ASSUMED = Object(
    Field("what", TEXT, "What is assumed."),
    Field("why", TEXT, "Why."),
    Field("contradicts", TEXT, "What the source says otherwise."),
)
STUDY = Object(
    *header(FORMAT, (VERSION,), "study file"),
    Field("name", NAMES, "The name of the study, and of the folder of its report."),
    Field("title", TEXT, "The title of the report."),
    OPEN_DOC,
    Field("source", TEXT, "What is studied: a paper, a book."),
    Field("runs", Table(ONE_RUN, NAMES, tells=False, is_open=True), "The runs, by name."),
    Field("sweeps", Table(ONE_SWEEP, NAMES, tells=False, is_open=True), "Sweeps, by name: runs that vary."),
    Field("tunings", Table(ONE_TUNING, NAMES, tells=False, is_open=True), "Tunings, by name."),
    Field("assumed", _objects(ASSUMED), "What the source leaves open."),
    Field("claims", _objects(CLAIM), "Measures beside published numbers."),
    Field("figures", _objects(AnyOf(SWEEP_FIGURE, FIGURE)), "Figures of the report."),
    is_open=True,
    doc="Runs of diagrams whose measures are set beside published numbers.",
)
