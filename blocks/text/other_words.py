"""Names that users of other tools write first, and what they mean here: the one table of such hints.

Misspelt names need no entry: `did_you_mean` finds these. An entry is for a name that has no likeness to ours.
"""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from ..host.ipython_errors import UnknownPort
from .errors import Fault, UsageError, did_you_mean

_P = ParamSpec("_P")
_R = TypeVar("_R")

ARGUMENTS: Mapping[str, str] = {
    **dict.fromkeys(("stop_time", "t_stop", "t_final", "t_end", "tf", "T", "duration", "final_time", "tstop"), "stop"),
    **dict.fromkeys(("end", "end_time", "until"), "stop"),
    **dict.fromkeys(("start_time", "t_start", "t0"), "start"),
    **dict.fromkeys(("max_step", "step_size", "stepsize", "dt", "h", "fixed_step"), "step"),
    **dict.fromkeys(("solver", "integrator"), "method"),
    **dict.fromkeys(("tol", "tolerance", "relative_tolerance", "reltol"), "rtol"),
    **dict.fromkeys(("absolute_tolerance", "abstol"), "atol"),
    **dict.fromkeys(("output_interval", "sample_time", "Ts", "t_eval"), "every"),
    **dict.fromkeys(("output", "outputs", "signals", "record"), "log"),
    **dict.fromkeys(("params", "start_values"), "parameters"),
    **dict.fromkeys(("U", "u", "input"), "inputs"),
    "measure": "measures",
    **dict.fromkeys(("workers", "n_jobs", "processes"), "threads"),
}
"""Arguments of runs."""
ROWS: Mapping[str, str] = dict.fromkeys(("N", "runs", "samples", "size", "trials", "n_runs", "n_samples"), "n")
"""Arguments of sweeps beyond those of runs."""
_STARTS = 'Start values are parameters: parameters={"plant.x_start": [1, 0]}.'
_CURES: Mapping[str, str] = {
    **dict.fromkeys(("x0", "X0", "y0", "initial", "initial_state", "initial_conditions"), _STARTS),
    "loop": 'Write diagram.linearizer().loop("control.y").',
    "pade": 'Write it where the loop is opened: diagram.linearizer().loop("control.y", pade=3).',
    "set": "Did you mean 'parameters'?",
    "grid": "Lists of values make a grid.",
}
"""Arguments of runs that are written elsewhere."""

_OPTIONS: Mapping[str, str] = {
    **ARGUMENTS, **dict.fromkeys(("parameters", "parameter", "params", "start_values", "param", "x0"), "set"),
    **dict.fromkeys(("output", "save_as", "csv", "save_csv"), "out"), "inputs": "input", "measures": "measure",
    "signals": "log", "type": "kind", **dict.fromkeys(("bode", "nyquist", "nichols"), "figure"),
    **dict.fromkeys(("show", "pdf", "png", "svg"), "plot"),
}  # fmt: skip
"""Options of the command line, as arguments are written."""

_PAGE = "`blocks draw DIAGRAM.json --run -o FILE.html` writes a page with the results."
_OTHERWISE: Mapping[str, str] = {
    **dict.fromkeys(("html", "report"), _PAGE),
    **dict.fromkeys(
        ("title", "xlabel", "ylabel", "xlim", "ylim", "label", "legend"),
        'A figure is labelled in Python: results.plot("motor.omega", title="...", ylabel="...").',
    ),
}
"""What no option does."""

COMMANDS: Mapping[str, str] = {
    **dict.fromkeys(("simulate", "sim", "start"), "run"),
    **dict.fromkeys(("validate", "verify", "lint"), "check"),
    **dict.fromkeys(("dump", "show", "inspect"), "info"),
    **dict.fromkeys(("open", "gui"), "edit"),
    **dict.fromkeys(("view", "report", "html"), "draw"),
    "search": "list",
    "montecarlo": "sweep",
    "optimize": "tune",
    **dict.fromkeys(("codegen", "build", "compile"), "export"),
}
"""Commands."""
_LOOPED = "linearize DIAGRAM --loop SIGNAL"
LINES: Mapping[str, str] = {
    **dict.fromkeys(("margins", "margin"), _LOOPED),
    **{name: f"{_LOOPED} --figure {name} --plot {name}.svg" for name in ("bode", "nyquist", "nichols")},
    "step": "linearize DIAGRAM --from SIGNAL --to SIGNAL --figure step --plot step.svg",
}
"""Commands that are options of another one, and how they are written."""

CONDITION_NAMES: Mapping[str, str] = {
    "time": "The time is t.",
    **dict.fromkeys(("true", "false"), "A bool is a condition by itself: write its name alone, or after not."),
}
"""Names in conditions that are no signals, in small letters, and what to write."""

MEASURE_TYPES: Mapping[str, str] = {
    **dict.fromkeys(("max", "maximum", "max_error", "max_abs"), "peak"),
    **dict.fromkeys(("tv", "variation"), "total_variation"),
    **dict.fromkeys(("ts", "settling"), "settling_time"),
    **dict.fromkeys(("tr", "rise"), "rise_time"),
    **dict.fromkeys(("sse", "ess", "final_error"), "steady_state_error"),
    **dict.fromkeys(("mse", "msq"), "mean_square"),
    **dict.fromkeys(("energy", "effort", "control_effort"), "ISU"),
}
"""Types of measures, in lower case."""

RUN_KEYS: Mapping[str, str] = {
    word: ours for word, ours in ARGUMENTS.items() if ours not in ("parameters", "measures", "threads")
}
"""Keys of "run" in a file."""
MEASURE_KEYS: Mapping[str, str] = {
    **dict.fromkeys(("signal", "output", "y"), "of"),
    **dict.fromkeys(("reference", "ref", "setpoint", "target"), "against"),
    **dict.fromkeys(("start", "begin", "t_start"), "from"),
    **dict.fromkeys(("stop", "end", "until", "t_end"), "to"),
    **dict.fromkeys(("tolerance", "tol"), "band"),
}
"""Keys of a measure."""
BODY_KEYS: Mapping[str, str] = {
    **dict.fromkeys(("connections", "connect", "links", "edges"), "wires"),
    **dict.fromkeys(("nodes", "components", "systems"), "blocks"),
    **dict.fromkeys(("simulation", "sim", "settings"), "run"),
    **dict.fromkeys(("constants", "variables"), "parameters"),
}
"""Keys of a diagram."""

MARGIN_TYPES: Mapping[str, str] = {
    **dict.fromkeys(("gm",), "gain_margin"), **dict.fromkeys(("pm",), "phase_margin"),
    **dict.fromkeys(("dm",), "delay_margin"), **dict.fromkeys(("sm",), "modulus_margin"),
    **dict.fromkeys(("wcp", "wgc"), "crossover"), **dict.fromkeys(("bw",), "bandwidth"),
}  # fmt: skip
"""Types of margins."""

_PERIOD = ("ts", "dt", "h", "t", "sampletime", "samplingtime", "sampleperiod", "samplingperiod")
_DELAY = ("delay", "delaytime", "timedelay", "deadtime", "tau", "time")
_START = ("x0", "y0", "initial", "initialvalue", "initialcondition", "initialstate", "init", "ic")
PARAMETERS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(_PERIOD, ("period",)),
    **dict.fromkeys(_DELAY, ("delay",)),
    "tau": ("delay", "T", "Tf"), "timeconstant": ("T", "Tf"), "t": ("period", "at", "times", "delay"),
    **dict.fromkeys(("time", "steptime", "tstep", "t0", "start", "starttime"), ("at", "delay")),
    **dict.fromkeys(("value", "amplitude", "final", "finalvalue"), ("after", "value")),
    **dict.fromkeys(("initial", "initialvalue"), ("before",)),
    "h0": ("h_start",), "height": ("after", "h_start"),
    **dict.fromkeys(("n", "steps", "delaylength", "length"), ("samples",)),
    **dict.fromkeys(("sigma", "std", "stddev", "stdev", "standarddeviation"), ("deviation",)),
    **dict.fromkeys(("frequency", "freq", "f", "w"), ("omega",)),
    **dict.fromkeys(("wc", "omegac"), ("omega_c", "bandwidth")),
    **dict.fromkeys(("wo", "omegao"), ("omega_o", "bandwidth")),
    **dict.fromkeys(("wn", "w0", "omegan", "omega0"), ("w", "omega")), "zeta": ("d",),
    **dict.fromkeys(("cpr", "resolution", "counts"), ("counts_per_turn",)),
    "numerator": ("num",), "denominator": ("den",),
    "gain": ("k", "K"), "p": ("kp",), "i": ("ki",), "d": ("kd", "c"), "b": ("c",), "damping": ("c", "d"),
    "mass": ("m",), "stiffness": ("k",), "spring": ("k",),
    **dict.fromkeys(("min", "umin", "minimum", "lowerlimit", "low"), ("lower",)),
    **dict.fromkeys(("max", "umax", "maximum", "upperlimit", "high"), ("upper",)),
    **dict.fromkeys(("expr", "formula", "equation", "function", "fcn"), ("expression",)),
    "inputs": ("signs", "operations"), **dict.fromkeys(("breakpoints", "x", "xp"), ("points",)),
    **dict.fromkeys(("table", "y", "fp"), ("values",)),
}  # fmt: skip
"""Parameters of blocks, in small letters without underscores; the first that a block has is meant."""
_CONVERTED: Mapping[str, tuple[str, str]] = {
    "ti": ("ki", "ki = kp/Ti"), "td": ("kd", "kd = kp Td"),
    **dict.fromkeys(("variance", "var"), ("deviation", "deviation, the square root of the variance")),
}  # fmt: skip
"""Parameters that are another number here."""
SAMPLED: Mapping[str, str] = {
    "LESO": "DiscreteESO",
    **{name: f"Discrete{name}" for name in ("ADRC", "INLSEF", "INTD", "Integrator", "PID", "SMESO")},
    **{name: f"Discrete{name}" for name in ("StateObserver", "StateSpace", "TransferFunction")},
}
"""The sampled form of a type, by the type in continuous time."""
TYPES: Mapping[str, str] = {"ADRC": "It is a diagram: `blocks new FILE --adrc` writes it."}
"""Names that are no block types, and what they are."""

_LOOP = 'diagram.linearizer().loop("control.y")'
_FROM = "; from blocks.analysis import"
_REPORT = dict.fromkeys(
    ("report", "to_html", "html"), 'diagram.save("x.json"), then `blocks draw x.json --run -o x.html`'
)
_ATTRIBUTES: Mapping[str, Mapping[str, str]] = {
    "Diagram": {
        **dict.fromkeys(("connect", "connection"), "diagram.wire(sink, source)"),
        **dict.fromkeys(("simulate", "sim", "forced_response"), "diagram.run(stop=10)"),
        **dict.fromkeys(("monte_carlo", "montecarlo"), 'diagram.sweep({"plant.k": Normal(1, 0.1)}, n=1000)'),
        **dict.fromkeys(("optimize", "minimize"), "diagram.tune(minimize=..., over=...)"),
        **{name: f"{name}({_LOOP}){_FROM} {name}" for name in ("margins", "bode", "nyquist", "nichols")},
        "margin": f"margins({_LOOP}){_FROM} margins",
        "poles": f"poles(diagram.linearize(u, y)){_FROM} poles",
        "plot": 'diagram.run(stop=10).plot("plant.y"); diagram.draw() is the drawing, as SVG',
        **dict.fromkeys(("svg", "show", "to_svg"), "diagram.draw()"),
        "step_response": "diagram.run(stop=10), with a Step as its source",
        "step_info": 'diagram.run(stop=10).step_info("plant.y")',
        "add_block": "diagram.add(name, block)",
        **dict.fromkeys(("blocks", "keys", "names"), "list(diagram)"),
        "to_dict": "diagram.to_json()",
        **dict.fromkeys(("to_fmu", "export_fmu", "to_c", "codegen", "generate_code"), 'diagram.export("x.fmu")'),
        **_REPORT,
    },
    "Results": {
        **dict.fromkeys(("time", "times"), "results.t"),
        **dict.fromkeys(("to_dataframe", "to_df", "dataframe", "df"), "results.to_pandas()"),
        **dict.fromkeys(("keys", "signals"), "results.names"),
        **dict.fromkeys(("y", "u", "outputs", "inputs"), 'results["plant.y"], by the name of the signal'),
        **dict.fromkeys(("x", "states"), 'results["plant.x"], which must be recorded: log=["plant.x"]'),
        **dict.fromkeys(("overshoot", "settling_time", "rise_time"), 'results.step_info("plant.y")'),
        "items": "{name: results[name] for name in results}",
        **dict.fromkeys(("to_excel", "to_xlsx", "export"), 'results.to_csv("x.csv"), which spreadsheets open'),
        **_REPORT,
        "show": "results.plot()",
        "get": 'results["plant.y"]',
    },
    "Sweep": {
        **dict.fromkeys(("to_dataframe", "to_df", "dataframe", "df"), "sweep.to_pandas()"),
        **dict.fromkeys(("runs", "results", "rows"), "sweep.single(0), the Results of row 0"),
        **dict.fromkeys(("keys", "names"), "sweep.scenarios, sweep.measures, sweep.signals"),
        **dict.fromkeys(("mean", "std", "describe"), "sweep.to_pandas().describe(), sweep.quantiles()"),
        **dict.fromkeys(("time", "times"), "sweep.t"),
    },
    "Margins": {**dict.fromkeys(("plot", "bode"), f"bode(loop), of what margins took{_FROM} bode")},
}
"""Attributes, by the class of which they are asked."""
_ITEMS: Mapping[str, str] = {"Diagram": "diagram", "Results": "results"}
"""What has items by name, by its class."""

_ANALYSES: Mapping[str, str] = {
    **dict.fromkeys(("margin", "stability_margins"), "margins(loop)"),
    "step_info": 'diagram.run(stop=10).step_info("plant.y")',
    **dict.fromkeys(("step_response", "forced_response"), "diagram.run(stop=10)"),
    "linearize": "diagram.linearize(u, y)",
}
"""Functions of python-control."""

_SYSTEMS: Mapping[str, str] = {
    "Diagram": f"Take a linear model of it: {_LOOP}, or diagram.linearize(u, y).",
    "Linearizer": 'Name the signals: linearizer.loop("control.y"), or linearizer.model(u, y).',
}
"""How to get a linear system from an object that is none, by its class."""


def argument_meant(word: str, known: Collection[str]) -> str:
    """Return a sentence that offers the argument that a word means, else the nearest one, or ""."""
    ours = ARGUMENTS.get(word, "")
    return f"Did you mean '{ours}'?" if ours in known else _CURES.get(word) or did_you_mean(word, known)


def check_arguments(words: Collection[str], meant: Mapping[str, str]) -> None:
    """Refuse words that mean another argument. Raises UsageError (E501)."""
    for word in words:
        if word in meant:
            raise UsageError(Fault("E501", word, "is not an argument.", f"Did you mean '{meant[word]}'?"))


def hinted(**cures: str) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Make a function refuse arguments that it does not have with a cure. Such a call raises UsageError (E501)."""

    def decorated(function: Callable[_P, _R]) -> Callable[_P, _R]:
        @functools.wraps(function)
        def called(*args: _P.args, **words: _P.kwargs) -> _R:
            try:
                return function(*args, **words)
            except TypeError:
                known = inspect.signature(function).parameters
                word = next((word for word in words if word not in known), None)
                if word is None:
                    raise
                cure = cures.get(word) or parameter_meant(word, known, (), function.__name__)
                cure = cure or did_you_mean(word, known)
                cure = cure or f"Arguments: {', '.join(name for name in known if name != 'self')}."
                place = f"{function.__name__}({word}=)"
                raise UsageError(Fault("E501", place, "there is no such argument.", cure)) from None

        return called

    return decorated


def option_meant(option: str, known: Collection[str]) -> str:
    """Return the same for an option of the command line, such as --stop-time. known: with their dashes."""
    word = option.strip("-").replace("-", "_")
    if word in ("measure", "measures") and "--measure" not in known:
        return "The command computes all measures of the diagram."
    ours = f"--{_OPTIONS.get(word, '')}"
    if ours in known:
        return f"Did you mean '{ours}'?"
    names = [name[2:] for name in known if name.startswith("--")]  # dashes alone are no likeness
    return _OTHERWISE.get(word, "") or did_you_mean(word.replace("_", "-"), names).replace("'", "'--", 1)


def command_meant(word: str, known: Collection[str]) -> str:
    """Return the same for a command. known: the commands at its place, of `blocks` or of `blocks fmu`."""
    is_fmu = word.lower().endswith(".fmu")
    if is_fmu:
        return f"To see what is in an FMU: blocks fmu info {word}."
    if "fmu" in known and COMMANDS.get(word, word) == "info":
        return "Of an FMU: blocks fmu info X.fmu. Of a diagram: blocks check X.json."
    if word.lower().endswith(".json"):
        return f"To run a diagram: blocks run {word}."
    if "linearize" in known and word in LINES:
        return f"Write `blocks {LINES[word]}`."
    ours = COMMANDS.get(word, "")
    return f"Did you mean '{ours}'?" if ours in known else did_you_mean(word, known)


def meant_keys(words: Mapping[str, str]) -> dict[str, str]:
    """Return a sentence for each word that offers the key that it means."""
    return {word: f'Did you mean "{ours}"?' for word, ours in words.items()}


def measure_meant(type_: str) -> str:
    """Return a sentence that offers the type of measure that a word means, or ""."""
    ours = MEASURE_TYPES.get(type_.casefold())
    return f"Did you mean '{ours}'?" if ours else ""


def margin_meant(type_: str) -> str:
    """Return a sentence that offers the type of margin that a word means, or ""."""
    ours = MARGIN_TYPES.get(type_.casefold())
    return f'Did you mean "{ours}"?' if ours else ""


def parameter_meant(word: str, known: Collection[str], inputs: Collection[str] = (), owner: str = "") -> str:
    """Return a sentence that offers the parameter that a word means, or "" if it is nearly the name of one.

    known: the parameters of the block; of paths ("plant.x0") the paths of all. inputs, owner: its inputs, its type.
    """
    if word in inputs:
        return "It is an input: wire a source to it, such as a Constant. Inputs of a diagram are given to its run."
    block, dot, word = word.rpartition(".")
    before = f"{block}{dot}"
    if dot:
        known = [name.removeprefix(before) for name in known if name.startswith(before)]
    if difflib.get_close_matches(word.casefold(), [name.casefold() for name in known], n=1, cutoff=0.8):
        return ""
    plain = word.casefold().replace("_", "")
    ours = [name for name in PARAMETERS.get(plain, ()) if name in known][:1]
    if not ours and plain in _START:
        ours = [name for name in known if name.endswith("_start") and "." not in name]
    if ours:
        unit = " It is in rad/s: 50 Hz are 50 rev/s." if ours == ["omega"] else ""
        return f"Did you mean {', '.join(repr(before + name) for name in ours)}?{unit}"
    name, converted = _CONVERTED.get(plain, ("", ""))
    if name in known:
        return f"Write {converted}."
    if plain in _DELAY and owner == "Delay":
        return "It delays by samples. TransportDelay has a delay in s."
    if (plain == "period" or plain in _PERIOD) and owner in SAMPLED:
        return f"{SAMPLED[owner]} has a period."
    return ""


def analysis_meant(word: str, known: Collection[str]) -> str:
    """Return a sentence that offers what a name that blocks.analysis lacks means, else the nearest name, or ""."""
    return f"Write {_ANALYSES[word]}." if word in _ANALYSES else did_you_mean(word, known)


def signal_meant(word: str, known: Collection[str]) -> str:
    """Return a sentence that offers the nearest recorded signal, or where the times are, or ""."""
    return "The times are results.t." if word in ("t", "time") else did_you_mean(word, known)


def system_of(kind: str) -> str:
    """Return how to get a linear system from an object of a class, or ""."""
    return _SYSTEMS.get(kind, "")


class Guided:
    """An object whose errors for unknown attributes say what to write instead."""

    __slots__ = ()

    if not TYPE_CHECKING:  # a type checker would take any attribute for a known one

        def __getattr__(self, name: str) -> object:
            if hasattr(type(self), name):  # a property that raised AttributeError, which says what is wrong
                return object.__getattribute__(self, name)
            kind = type(self).__name__
            error = f"'{kind}' object has no attribute '{name}'"
            if name.startswith("_"):
                raise AttributeError(error)
            ours = _ATTRIBUTES.get(kind, {}).get(name, "")
            known = [each for each in dir(type(self)) if not each.startswith("_")]
            if kind in _ITEMS and name in self:
                ours = f'{_ITEMS[kind]}["{name}"]'
            cure = f"Write {ours}." if ours else did_you_mean(name, known)
            raise UnknownPort(f"{error}. {cure}".rstrip())
