"""Analysis in the frequency domain: operating points, margins, describing functions, responses by simulation, ADRC.

    from blocks.analysis import margins, observer_report
    margins(diagram.linearizer().loop("control.u"))

Linear models themselves come from `Diagram.linearize` and `Diagram.linearizer`. The names are loaded when first used.
"""

from __future__ import annotations

import sys
from typing import Any

_PLACES = {
    name: module
    for module, names in {
        "analysis.adrc_reports": "AMPLITUDES LoopReport ObserverReport loop_report observer_report",
        "analysis.estimation": "Chirp OddMultisine SineStream estimate_response",
        "analysis.operating": "find_operating_point limit_cycles operating_points",
        "analysis.responses": "Comparison Response compare",
        "analysis.loop_maps": "LoopMap loop_map",
        "frequency.equivalents": "EquivalentPID HighFrequencyGain equivalent_pid high_frequency_gain",
        "frequency.figures": "bode gang_of_four gang_of_six nichols nyquist pole_map sigma step_figure",
        "frequency.linear_adrc": (
            "Controller EulerCycle Gains SamplingLimits adrc_gains bandwidth_gains controller "
            "disturbance_bandwidth disturbance_estimate equivalent_bandwidth euler_cycles half_gain "
            "half_gain_poles noise_gain observer sampling_limits settling_bandwidth settling_time"
        ),
        "frequency.disk": "DiskMargins disk_margins",
        "frequency.margins": "Margins margins",
        "frequency.response": "bandwidth dc_gain h2 hinf peak poles response zeros",
        "linear.harmonic_balance": "HarmonicResponse Linearizer",
        "linear.limit_cycles": "LimitCycle",
        "linear.linear_model": "LinearModel",
        "linear.operating_point": "Free OperatingPoint",
    }.items()
    for name in names.split()
}

__all__ = sorted([*_PLACES, "describing"])


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name in _PLACES:
        return getattr(import_module(f"blocks.{_PLACES[name]}"), name)
    if name == "describing":
        return import_module("blocks.frequency.describing")
    from importlib.util import find_spec

    from ..text.other_words import analysis_meant

    message = f"module 'blocks.analysis' has no attribute {name!r}. {analysis_meant(name, __all__)}".rstrip()
    # As in `blocks`, where Python's own ImportError has no hint. Modules are imported after an AttributeError.
    is_import = sys._getframe(1).f_globals.get("__name__") == "importlib._bootstrap"
    if is_import and not name.startswith("_") and find_spec(f"{__name__}.{name}") is None:
        raise ImportError(message, name=__name__)
    raise AttributeError(message)


def __dir__() -> list[str]:
    return list(__all__)
