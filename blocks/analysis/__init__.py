"""Analysis in the frequency domain: operating points, margins, describing functions, responses by simulation, ADRC.

    from blocks.analysis import margins, observer_report
    margins(diagram.linearizer().loop("control.u"))

Linear models themselves come from `Diagram.linearize` and `Diagram.linearizer`. The names are loaded when first used.
"""

from __future__ import annotations

from typing import Any

_PLACES = {
    "AMPLITUDES": "analysis.adrc_reports",
    "Chirp": "analysis.estimation",
    "Comparison": "analysis.estimation",
    "Controller": "frequency.adrc",
    "EulerCycle": "frequency.adrc",
    "Free": "linear.operating_point",
    "Gains": "frequency.adrc",
    "HarmonicResponse": "linear.harmonic_balance",
    "LimitCycle": "linear.limit_cycles",
    "LinearModel": "linear.linear_model",
    "Linearizer": "linear.linearizer",
    "LoopReport": "analysis.adrc_reports",
    "Margins": "frequency.margins",
    "ObserverReport": "analysis.adrc_reports",
    "OddMultisine": "analysis.estimation",
    "OperatingPoint": "linear.operating_point",
    "Response": "analysis.estimation",
    "SamplingLimits": "frequency.adrc",
    "SineStream": "analysis.estimation",
    "adrc_gains": "frequency.adrc",
    "bandwidth": "frequency.response",
    "bandwidth_gains": "frequency.adrc",
    "bode": "frequency.figures",
    "compare": "analysis.estimation",
    "controller": "frequency.adrc",
    "dc_gain": "frequency.response",
    "disturbance_bandwidth": "frequency.adrc",
    "disturbance_estimate": "frequency.adrc",
    "equivalent_bandwidth": "frequency.adrc",
    "estimate_response": "analysis.estimation",
    "euler_cycles": "frequency.adrc",
    "find_operating_point": "analysis.operating",
    "gang_of_four": "frequency.figures",
    "h2": "frequency.response",
    "half_gain": "frequency.adrc",
    "half_gain_poles": "frequency.adrc",
    "hinf": "frequency.response",
    "limit_cycles": "analysis.cycles",
    "loop_report": "analysis.adrc_reports",
    "margins": "frequency.margins",
    "nichols": "frequency.figures",
    "noise_gain": "frequency.adrc",
    "nyquist": "frequency.figures",
    "observer": "frequency.adrc",
    "observer_report": "analysis.adrc_reports",
    "operating_points": "analysis.operating",
    "peak": "frequency.response",
    "pole_map": "frequency.figures",
    "poles": "frequency.response",
    "response": "frequency.response",
    "sampling_limits": "frequency.adrc",
    "sigma": "frequency.figures",
    "step_figure": "frequency.figures",
    "zeros": "frequency.response",
}
_MODULES = {"describing": "frequency.describing"}

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
