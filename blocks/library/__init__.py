"""The block library: every concrete block, by its name. A module is loaded when a block of it is first used."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..contract.block import Block

_BY_MODULE = {
    "adrc": (
        "DiscreteESO DiscreteINLSEF DiscreteINTD DiscreteSMESO INLSEF INTD LESO LSEF NESO NLSEF SMESO "
        "TrackingDifferentiator"
    ),
    "adrc_observers": "CascadeESO GeneralizedESO ReducedESO ScheduledESO ScheduledLSEF",
    "adrc_sampled": "DiscreteADRC",
    "angles": "Encoder Unwrap Wrap",
    "arithmetic": "DotProduct Gain MatrixGain Norm Product Sum",
    "continuous": (
        "Derivative FirstOrder Integrator LeadLag LimitedIntegrator ResettableIntegrator SecondOrder StateSpace "
        "TransferFunction ZeroPoleGain"
    ),
    "discrete": "DiscreteIntegrator DiscreteStateSpace DiscreteTransferFunction",
    "drives": "Clarke InverseClarke InversePark Park",
    "excitation": "Multisine PRBS",
    "expression": "Expression",
    "filters": "Biquad FIRFilter MovingAverage",
    "flight": "Quadrotor",
    "friction": "CoulombFriction LuGreFriction",
    "functions": "Abs Atan2 Divide Exp Log MinMax Polynomial Power Sign Sqrt Trigonometry",
    "logic": "Compare CompareToConstant Counter EdgeDetect Logic MultiportSwitch Switch SwitchAbove Timer",
    "mechanics": "BouncingBall InvertedPendulum MassSpringDamper QuarterCar TwoLinkArm",
    "memory": "Backlash RateLimiter TransportDelay",
    "noise": "Noise",
    "nonlinear": "DeadZone Quantizer Relay Saturation",
    "observers": "DiscreteStateObserver StateObserver",
    "oscillators": "Lorenz VanDerPol",
    "pid": "DiscretePID PID",
    "power": "BuckConverter",
    "process": "Tank",
    "robot": "Disturbance Kinematics MatchedDisturbance PMDCMotor WheelMixing",
    "sampled": "Delay FirstOrderHold RateTransition UnitDelay ZeroOrderHold",
    "sources": "Chirp Constant Pulse Ramp Sawtooth Sine SquareWave Step Trapezoid",
    "tables": "LookupTable LookupTable2D Table",
    "vectors": "Reduction SwitchedMatrixGain",
    "wiring": "Demux Mux Selector",
}
_MODULES = {name: module for module, names in _BY_MODULE.items() for name in names.split()}


class _Library(Mapping[str, "type[Block]"]):
    """Block classes by the names that diagrams use: abbreviations, then words."""

    def __getitem__(self, name: str) -> type[Block]:
        found: type[Block] = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
        return found

    def __contains__(self, name: object) -> bool:
        return name in _MODULES

    def __iter__(self) -> Iterator[str]:
        return iter(NAMES)

    def __len__(self) -> int:
        return len(NAMES)

    def __reduce__(self) -> str:
        return "LIBRARY"


NAMES = tuple(sorted(_MODULES, key=lambda name: (not name.isupper(), name)))
LIBRARY = _Library()
__all__ = ["LIBRARY", *NAMES]


def __getattr__(name: str) -> Any:
    if name in LIBRARY:
        return LIBRARY[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
