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
    **ARGUMENTS, **dict.fromkeys(("parameters", "params", "start_values", "param"), "set"), "inputs": "input",
    "measures": "measure", "output": "out", "signals": "log", "save_as": "out", "type": "kind",
}  # fmt: skip
"""Options of the command line, as arguments are written."""

_LOOP = 'diagram.linearizer().loop("control.y")'
_FROM = "; from blocks.analysis import"
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
    },
    "Results": {
        **dict.fromkeys(("time", "times"), "results.t"),
        **dict.fromkeys(("to_dataframe", "to_df", "dataframe", "df"), "results.to_pandas()"),
        **dict.fromkeys(("keys", "signals"), "results.names"),
        **dict.fromkeys(("y", "u", "outputs", "inputs"), 'results["plant.y"], by the name of the signal'),
        **dict.fromkeys(("x", "states"), 'results["plant.x"], which must be recorded: log=["plant.x"]'),
        "items": "{name: results[name] for name in results}",
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
    return f"Did you mean '{ours}'?" if ours in known else did_you_mean(option, known)


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
