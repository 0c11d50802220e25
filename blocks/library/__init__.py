"""The block library: every concrete block, by its name."""

from ..contract.block import Block
from .adrc import (
    INLSEF,
    INTD,
    LESO,
    LSEF,
    NESO,
    NLSEF,
    SMESO,
    DiscreteESO,
    DiscreteINLSEF,
    DiscreteINTD,
    DiscreteSMESO,
    TrackingDifferentiator,
)
from .arithmetic import Gain, MatrixGain, Product, Sum
from .continuous import (
    Derivative,
    FirstOrder,
    Integrator,
    LeadLag,
    LimitedIntegrator,
    ResettableIntegrator,
    SecondOrder,
    StateSpace,
    TransferFunction,
    ZeroPoleGain,
)
from .discrete import DiscreteIntegrator, DiscreteStateSpace, DiscreteTransferFunction
from .expression import Expression
from .functions import Abs, Atan2, Divide, Exp, Log, MinMax, Power, Sign, Sqrt, Trigonometry
from .logic import Compare, CompareToConstant, Counter, EdgeDetect, Logic, Switch, SwitchAbove
from .mechanics import BouncingBall, InvertedPendulum, MassSpringDamper, QuarterCar
from .memory import Backlash, RateLimiter, TransportDelay
from .noise import Noise
from .nonlinear import DeadZone, Quantizer, Relay, Saturation
from .pid import PID, DiscretePID
from .robot import Disturbance, Kinematics, MatchedDisturbance, PMDCMotor, WheelMixing
from .sampled import Delay, UnitDelay, ZeroOrderHold
from .sources import Chirp, Constant, Pulse, Ramp, Sawtooth, Sine, SquareWave, Step, Trapezoid
from .tables import LookupTable, LookupTable2D, Table
from .wiring import Demux, Mux, Selector

__all__ = [
    "INLSEF",
    "INTD",
    "LESO",
    "LIBRARY",
    "LSEF",
    "NESO",
    "NLSEF",
    "PID",
    "SMESO",
    "Abs",
    "Atan2",
    "Backlash",
    "BouncingBall",
    "Chirp",
    "Compare",
    "CompareToConstant",
    "Constant",
    "Counter",
    "DeadZone",
    "Delay",
    "Demux",
    "Derivative",
    "DiscreteESO",
    "DiscreteINLSEF",
    "DiscreteINTD",
    "DiscreteIntegrator",
    "DiscretePID",
    "DiscreteSMESO",
    "DiscreteStateSpace",
    "DiscreteTransferFunction",
    "Disturbance",
    "Divide",
    "EdgeDetect",
    "Exp",
    "Expression",
    "FirstOrder",
    "Gain",
    "Integrator",
    "InvertedPendulum",
    "Kinematics",
    "LeadLag",
    "LimitedIntegrator",
    "Log",
    "Logic",
    "LookupTable",
    "LookupTable2D",
    "MassSpringDamper",
    "MatchedDisturbance",
    "MatrixGain",
    "MinMax",
    "Mux",
    "Noise",
    "PMDCMotor",
    "Power",
    "Product",
    "Pulse",
    "Quantizer",
    "QuarterCar",
    "Ramp",
    "RateLimiter",
    "Relay",
    "ResettableIntegrator",
    "Saturation",
    "Sawtooth",
    "SecondOrder",
    "Selector",
    "Sign",
    "Sine",
    "Sqrt",
    "SquareWave",
    "StateSpace",
    "Step",
    "Sum",
    "Switch",
    "SwitchAbove",
    "Table",
    "TrackingDifferentiator",
    "TransferFunction",
    "TransportDelay",
    "Trapezoid",
    "Trigonometry",
    "UnitDelay",
    "WheelMixing",
    "ZeroOrderHold",
    "ZeroPoleGain",
]

LIBRARY: dict[str, type[Block]] = {name: globals()[name] for name in __all__ if name != "LIBRARY"}
"""Block classes by the names that diagrams use."""
