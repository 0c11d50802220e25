"""blocks: block diagrams of control systems, simulated by one exact master algorithm.

The public names are loaded when first used, so that `import blocks` costs next to nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .api import Diagram as Diagram
    from .api import Run as Run
    from .api import subdiagram as subdiagram
    from .declare import Block as Block
    from .imported import fmu as fmu

_PLACES = {
    "Algebraic": "declare",
    "AnalysisError": "errors",
    "Block": "declare",
    "BlocksError": "errors",
    "CompilerError": "errors",
    "DeclarationError": "errors",
    "Diagram": "api",
    "Discrete": "declare",
    "FMUError": "errors",
    "Fault": "errors",
    "History": "declare",
    "Input": "declare",
    "ModelError": "errors",
    "Parameter": "declare",
    "Results": "results",
    "Run": "api",
    "Signal": "results",
    "SimulationError": "errors",
    "State": "declare",
    "Stepped": "declare",
    "UsageError": "errors",
    "crossing": "declare",
    "event_time": "declare",
    "fmu": "imported",
    "local": "declare",
    "output": "declare",
    "pick": "lookup",
    "requires": "declare",
    "search": "lookup",
    "stepper": "declare",
    "subdiagram": "api",
    "wiring": "declare",
}

# The names of the library, written out so that they are known without loading it.
_LIBRARY = (
    "INLSEF", "INTD", "LESO", "LSEF", "NESO", "NLSEF", "PID", "SMESO", "Abs", "Atan2", "Backlash", "BouncingBall",
    "Chirp", "Compare", "CompareToConstant", "Constant", "Counter", "DeadZone", "Delay", "Demux", "Derivative",
    "DiscreteESO", "DiscreteINLSEF", "DiscreteINTD", "DiscreteIntegrator", "DiscretePID", "DiscreteSMESO",
    "DiscreteStateSpace", "DiscreteTransferFunction", "Disturbance", "Divide", "EdgeDetect", "Exp", "Expression",
    "FirstOrder", "Gain", "Integrator", "InvertedPendulum", "Kinematics", "LeadLag", "LimitedIntegrator", "Log",
    "Logic", "LookupTable", "LookupTable2D", "MassSpringDamper", "MatchedDisturbance", "MatrixGain", "MinMax",
    "Mux", "Noise", "PMDCMotor", "Power", "Product", "Pulse", "Quantizer", "QuarterCar", "Ramp", "RateLimiter",
    "Relay", "ResettableIntegrator", "Saturation", "Sawtooth", "SecondOrder", "Selector", "Sign", "Sine", "Sqrt",
    "SquareWave", "StateSpace", "Step", "Sum", "Switch", "SwitchAbove", "Table", "TrackingDifferentiator",
    "TransferFunction", "TransportDelay", "Trapezoid", "Trigonometry", "UnitDelay", "WheelMixing", "ZeroOrderHold",
    "ZeroPoleGain",
)  # fmt: skip

__all__ = sorted([*_PLACES, *_LIBRARY])


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name in _PLACES:
        return getattr(import_module(f"blocks.{_PLACES[name]}"), name)
    if name in _LIBRARY:
        return getattr(import_module("blocks.library"), name)
    raise AttributeError(f"module 'blocks' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
