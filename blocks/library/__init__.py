"""The block library: every concrete block, by its name."""

from ..declare import Block
from .adrc import INLSEF, INTD, LESO, NLSEF, SMESO, TrackingDifferentiator
from .arithmetic import Gain, Product, Sum
from .continuous import PID, Integrator, StateSpace, TransferFunction
from .mechanics import BouncingBall
from .noise import Noise
from .nonlinear import Saturation
from .robot import Disturbance, Kinematics, MatchedDisturbance, PMDCMotor, WheelMixing
from .sampled import UnitDelay, ZeroOrderHold
from .sources import Constant, Pulse, Ramp, Sine, Step
from .wiring import Demux, Mux

__all__ = [
    "INLSEF",
    "INTD",
    "LESO",
    "LIBRARY",
    "NLSEF",
    "PID",
    "SMESO",
    "BouncingBall",
    "Constant",
    "Demux",
    "Disturbance",
    "Gain",
    "Integrator",
    "Kinematics",
    "MatchedDisturbance",
    "Mux",
    "Noise",
    "PMDCMotor",
    "Product",
    "Pulse",
    "Ramp",
    "Saturation",
    "Sine",
    "StateSpace",
    "Step",
    "Sum",
    "TrackingDifferentiator",
    "TransferFunction",
    "UnitDelay",
    "WheelMixing",
    "ZeroOrderHold",
]

LIBRARY: dict[str, type[Block]] = {name: globals()[name] for name in __all__ if name != "LIBRARY"}
"""Block classes by the names that diagrams use."""
