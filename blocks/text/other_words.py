"""Names that users of other tools write first, and what they mean here: the one table of such hints.

Misspelt names need no entry: `did_you_mean` finds these. An entry is for a name that has no likeness to ours.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

from ..host.ipython_errors import UnknownPort
from .errors import did_you_mean

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

_OPTIONS: Mapping[str, str] = {
    **ARGUMENTS, **dict.fromkeys(("parameters", "parameter", "params", "start_values", "param"), "set"),
    **dict.fromkeys(("output", "save_as", "csv", "save_csv"), "out"), "show": "plot", "inputs": "input",
    "measures": "measure", "signals": "log", "type": "kind",
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

_COMMANDS: Mapping[str, str] = {
    **dict.fromkeys(("simulate", "sim", "start"), "run"),
    **dict.fromkeys(("validate", "verify", "lint"), "check"),
    **dict.fromkeys(("dump", "show", "inspect"), "info"),
    **dict.fromkeys(("open", "gui"), "edit"),
    **dict.fromkeys(("view", "report", "html"), "draw"),
    "search": "list",
    "montecarlo": "sweep",
    "optimize": "tune",
}
"""Commands."""

CONDITION_NAMES: Mapping[str, str] = {
    "time": "The time is t.",
    **dict.fromkeys(("true", "false"), "A bool is a condition by itself: write its name alone, or after not."),
}
"""Names in conditions that are no signals, in small letters, and what to write."""

_PARAMETERS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("min", "minimum", "low", "lower_limit"), ("lower",)),
    **dict.fromkeys(("max", "maximum", "high", "upper_limit"), ("upper",)),
    **dict.fromkeys(("time", "step_time", "t_step", "t0"), ("at",)),
    **dict.fromkeys(("value", "amplitude", "final", "final_value"), ("after",)),
    **dict.fromkeys(("initial", "initial_value"), ("before", "y_start")),
    **dict.fromkeys(("y0", "x0", "ic", "initial_condition"), ("y_start", "x_start")),
    **dict.fromkeys(("h0", "height"), ("after", "h_start")),
    **dict.fromkeys(("n", "steps", "delay", "delay_length", "length"), ("samples",)),
    **dict.fromkeys(("dead_time", "tau", "time_delay"), ("delay", "T")),
    **dict.fromkeys(("sample_time", "Ts", "dt"), ("period",)),
    **dict.fromkeys(("cpr", "resolution", "counts"), ("counts_per_turn",)),
    **dict.fromkeys(("frequency", "freq", "w"), ("omega",)),
    **dict.fromkeys(("expr", "formula", "fcn"), ("expression",)),
    **dict.fromkeys(("gain", "K"), ("gains", "k")),
    "mass": ("m",),
    **dict.fromkeys(("damping", "d", "b"), ("c",)),
    **dict.fromkeys(("stiffness", "spring"), ("k",)),
}
"""Parameters of blocks; the first that a block has is meant."""

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
        **dict.fromkeys(("to_fmu", "export_fmu"), 'diagram.export("x.fmu")'),
        **_REPORT,
    },
    "Results": {
        **dict.fromkeys(("time", "times"), "results.t"),
        **dict.fromkeys(("to_dataframe", "to_df", "dataframe", "df"), "results.to_pandas()"),
        **dict.fromkeys(("keys", "signals"), "results.names"),
        **dict.fromkeys(("y", "u", "outputs", "inputs"), 'results["plant.y"], by the name of the signal'),
        **dict.fromkeys(("x", "states"), 'results["plant.x"], which must be recorded: log=["plant.x"]'),
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
}
"""Attributes, by the class of which they are asked."""

_SYSTEMS: Mapping[str, str] = {
    "Diagram": f"Take a linear model of it: {_LOOP}, or diagram.linearize(u, y).",
    "Linearizer": 'Name the signals: linearizer.loop("control.y"), or linearizer.model(u, y).',
}
"""How to get a linear system from an object that is none, by its class."""


def argument_meant(word: str, known: Collection[str]) -> str:
    """Return a sentence that offers the argument that a word means, else the nearest one, or ""."""
    ours = ARGUMENTS.get(word, "")
    return f"Did you mean '{ours}'?" if ours in known else did_you_mean(word, known)


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
    if "fmu" in known and _COMMANDS.get(word, word) == "info":
        return "Of an FMU: blocks fmu info X.fmu. Of a diagram: blocks check X.json."
    if word.lower().endswith(".json"):
        return f"To run a diagram: blocks run {word}."
    ours = _COMMANDS.get(word, "")
    return f"Did you mean '{ours}'?" if ours in known else did_you_mean(word, known)


def parameter_meant(word: str, known: Collection[str], inputs: Collection[str]) -> str:
    """Return a sentence that offers the parameter of a block that a word means, or "". inputs: of the block."""
    if word in inputs:
        return "It is an input: wire a source to it, such as a Constant. Inputs of a diagram are given to its run."
    ours = next((name for name in _PARAMETERS.get(word, ()) if name in known), "")
    unit = " It is in rad/s: 50 Hz are 50 rev/s." if ours == "omega" else ""
    return f"Did you mean '{ours}'?{unit}" if ours else ""


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
            cure = f"Write {ours}." if ours else did_you_mean(name, known)
            raise UnknownPort(f"{error}. {cure}".rstrip())
