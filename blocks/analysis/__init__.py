"""Analysis in the frequency domain: operating points, margins, describing functions, responses by simulation, ADRC.

    from blocks.analysis import margins, observer_report
    margins(diagram.linearizer().loop("control.u"))

Linear models themselves come from `Diagram.linearize` and `Diagram.linearizer`. The names are loaded when first used.
"""

from __future__ import annotations

from typing import Any

_PLACES = {
    "AMPLITUDES": "analysis.reports",
    "Chirp": "analysis.estimate",
    "Comparison": "analysis.estimate",
    "Controller": "linear.adrc",
    "EulerCycle": "linear.adrc",
    "Free": "linear.operating",
    "Gains": "linear.adrc",
    "HarmonicResponse": "linear.balance",
    "LimitCycle": "linear.cycles",
    "LinearModel": "linear.model",
    "Linearizer": "linear.linearizer",
    "LoopReport": "analysis.reports",
    "Margins": "linear.margins",
    "ObserverReport": "analysis.reports",
    "OddMultisine": "analysis.estimate",
    "OperatingPoint": "linear.operating",
    "Response": "analysis.estimate",
    "SamplingLimits": "linear.adrc",
    "SineStream": "analysis.estimate",
    "adrc_gains": "linear.adrc",
    "bandwidth": "linear.response",
    "bandwidth_gains": "linear.adrc",
    "bode": "linear.figures",
    "compare": "analysis.estimate",
    "controller": "linear.adrc",
    "dc_gain": "linear.response",
    "disturbance_bandwidth": "linear.adrc",
    "disturbance_estimate": "linear.adrc",
    "equivalent_bandwidth": "linear.adrc",
    "estimate_response": "analysis.estimate",
    "euler_cycles": "linear.adrc",
    "find_operating_point": "analysis.operating",
    "gang_of_four": "linear.figures",
    "h2": "linear.response",
    "half_gain": "linear.adrc",
    "half_gain_poles": "linear.adrc",
    "hinf": "linear.response",
    "limit_cycles": "analysis.cycles",
    "loop_report": "analysis.reports",
    "margins": "linear.margins",
    "nichols": "linear.figures",
    "noise_gain": "linear.adrc",
    "nyquist": "linear.figures",
    "observer": "linear.adrc",
    "observer_report": "analysis.reports",
    "operating_points": "analysis.operating",
    "peak": "linear.response",
    "pole_map": "linear.figures",
    "poles": "linear.response",
    "response": "linear.response",
    "sampling_limits": "linear.adrc",
    "sigma": "linear.figures",
    "step_figure": "linear.figures",
    "zeros": "linear.response",
}
_MODULES = {"describing": "linear.describing"}

__all__ = sorted([*_PLACES, *_MODULES])


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name in _PLACES:
        return getattr(import_module(f"blocks.{_PLACES[name]}"), name)
    if name in _MODULES:
        return import_module(f"blocks.{_MODULES[name]}")
    raise AttributeError(f"module 'blocks.analysis' has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
