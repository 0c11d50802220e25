"""Small models of Simulink, one for each type of block and each trap, and what their outputs are.

What an output is follows from the documentation of Simulink: a closed form, a difference equation, or SciPy. Nothing
here calls a block of ours.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from blocks.simulink import Block, Mask, Model, System
from tests.support.simulink_files import block, line, model, system

Array = Any
Witness = Callable[[Array], Array]
EVERY = 0.0371  # of rows: no tick and no edge of the kit, but the one at 0, is a multiple of it


@dataclass(frozen=True)
class Case:
    """A model, and its output out1 over time. told: a piece of the report. run: how it is run.

    parameters: numbers that the diagram is run with. beside: models that lie in the folder. files: workspaces.
    """

    name: str
    drawn: Model
    witness: Witness
    told: str = ""
    run: Mapping[str, Any] = field(default_factory=dict)
    beside: Sequence[Model] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    tolerance: float = 1e-7


# --- drawing ----------------------------------------------------------------------------------------------------------


def sub(blocks: Mapping[str, Any], wires: str, **values: str) -> tuple[Any, ...]:
    """Return a SubSystem for `sketch`."""
    return "SubSystem", values, sketch(blocks, wires)


def masked(inside: tuple[Any, ...], parameters: Mapping[str, str], code: str = "") -> tuple[Any, ...]:
    return *inside, Mask("", parameters, code)


def sketch(blocks: Mapping[str, Any], wires: str) -> System:
    """Return a system. blocks: (type, parameters) by name. wires: "a>b" from output 1 to input 1, "a:2>b:3,c:enable".

    "a>b=speed" names a line. In names, wires have _ for what is no letter. Ports in1, ..., out1, ... need no entry.
    """
    by_key = {re.sub(r"\W", "_", name): name for name in blocks}
    given = {name: (each if isinstance(each, tuple) else (each, {})) for name, each in blocks.items()}
    drawn, ports = [], dict[str, dict[str, int]]()

    def end(text: str, side: str) -> tuple[str, str]:
        key, _, port = text.partition(":")
        name = by_key.get(key, key)
        if name not in given:
            kind = {"i": "Inport", "o": "Outport"}[name[0]]
            given[name] = kind, {"Port": re.sub(r"\D", "", name)}
        counts, port = ports.setdefault(name, {}), port or "1"
        if port.isdecimal():
            counts[side] = max(counts.get(side, 0), int(port))
        else:
            counts[port] = 1
        return name, port

    for wire in wires.split():
        source, _, rest = wire.partition(">")
        targets, _, label = rest.partition("=")
        drawn.append(line(end(source, "out"), *(end(one, "in") for one in targets.split(",")), name=label))
    made: list[Block] = []
    for name, (kind, values, *more) in given.items():
        inside, mask = [*more, None, None][:2]
        counts = {**ports.get(name, {}), **{key: int(value) for key, value in values.items() if key in ("in", "out")}}
        kept = {key: value for key, value in values.items() if key not in ("in", "out")}
        made.append(block(kind, name, next(SIDS), kept, counts, inside=inside, mask=mask))
    return system(made, drawn)


def _count() -> Any:
    k = 0
    while True:
        yield (k := k + 1)


SIDS = _count()
CASES: list[Case] = []


def case(
    name: str,
    blocks: Mapping[str, Any],
    wires: str,
    witness: Witness,
    *,
    stop: str = "1.99",
    told: str = "",
    settings: Mapping[str, str] | None = None,
    callbacks: Mapping[str, str] | None = None,
    defaults: Mapping[str, Mapping[str, str]] | None = None,
    **more: Any,
) -> None:
    """Add a model to the kit."""
    drawn = model(
        re.sub(r"\W", "_", name),
        sketch(blocks, wires),
        settings={"StopTime": stop, "SolverName": "ode45", **(settings or {})},
        callbacks=callbacks or {},
        defaults=defaults or {},
    )
    CASES.append(Case(name, drawn, witness, told, **more))


def link(source: str, kind: str = "", **values: str) -> tuple[str, dict[str, str]]:
    """Return a link to a library for `sketch`."""
    return "Reference", {"SourceBlock": source, **({"SourceType": kind} if kind else {}), **values}


# --- witnesses --------------------------------------------------------------------------------------------------------


def columns(*each: Any) -> Witness:
    """Return a vector over time of functions and numbers."""
    return lambda t: np.stack([one(t) if callable(one) else np.full(t.shape, float(one)) for one in each], axis=-1)


def numbers(t: Array, period: float, offset: float = 0.0) -> Array:
    """Return the number of the last tick at or before each time."""
    return np.floor((t - offset) / period + 1e-9).astype(int)


def sampled(period: float, sequence: Callable[[Array], Array], offset: float = 0.0, before: float = 0.0) -> Witness:
    """Return what holds its value from tick to tick. sequence: of the numbers of ticks, 0 first."""

    def held(t: Array) -> Array:
        k = numbers(t, period, offset)
        return np.where(k < 0, before, np.asarray(sequence(np.arange(k.max() + 1)))[np.maximum(k, 0)])

    return held


def recursion(period: float, step: Callable[[Any, float, int], tuple[Any, float]], u: Witness, start: Any) -> Witness:
    """Return the outputs of ticks: step(state, input, k) gives the next state and the output."""

    def sequence(k: Array) -> Array:
        state, outputs = start, []
        for one, value in zip(k, u(period * k), strict=True):
            state, y = step(state, value, one)
            outputs.append(y)
        return np.array(outputs)

    return sampled(period, sequence)


def solved(
    f: Callable[[float, Array], Any], start: Sequence[float], y: Callable[[Array, Array], Array], *edges: float
) -> Witness:
    """Return y(t, x) of dx/dt = f(t, x). edges: times at which f jumps."""

    def at(t: Array) -> Array:
        x, out = np.array(start, float), np.zeros((len(start), t.size))
        borders = [0.0, *edges, float(t.max()) + 1e-3]
        for low, high in pairwise(borders):
            part = solve_ivp(f, (low, high), x, "DOP853", rtol=1e-12, atol=1e-13, dense_output=True)
            inside = (t >= low) & (t < high)
            if inside.any():
                out[:, inside] = part.sol(t[inside])
            x = part.y[:, -1]
        return y(t, out)

    return at


def pulse(t: Array, period: float, width: float, delay: float = 0.0) -> Array:
    return np.where((t >= delay - 1e-12) & ((t - delay) % period < width - 1e-12), 1.0, 0.0)


SIN = ("Sin", {"Amplitude": "2", "Frequency": "3", "Phase": "0.5", "Bias": "0.25"})
CLOCK = ("Clock", {})


def wave(t: Array) -> Array:
    """Return the output of SIN."""
    return 2 * np.sin(3 * t + 0.5) + 0.25


def after(
    first: str,
    u: tuple[Any, ...],
    kind: str,
    name: str,
    y: Callable[[Array], Array],
    u_of: Witness,
    values: Mapping[str, str] | None = None,
    **more: Any,
) -> None:
    """Add a model of a source and a block behind it. y: of what the source gives."""
    case(name, {first: u, "b": (kind, values or {})}, f"{first}>b b>out1", lambda t: y(u_of(t)), **more)


def of_sin(
    kind: str, name: str, y: Callable[[Array], Array], values: Mapping[str, str] | None = None, **more: Any
) -> None:
    after("s", SIN, kind, name, y, wave, values, **more)


def source(name: str, kind: str, values: Mapping[str, str], witness: Witness, **more: Any) -> None:
    case(name, {"b": (kind, values)}, "b>out1", witness, **more)


# A row for each model: reformatted, the table would be three times as long.
# fmt: off

# --- sources ----------------------------------------------------------------------------------------------------------

source("constant vector", "Constant", {"Value": "[3 -1 1/4]"}, columns(3, -1, 0.25))
source("constant expression", "Constant", {"Value": "2*pi/4 + sqrt(2)"}, lambda t: np.full(t.shape, np.pi / 2 + 2**0.5))
source("constant column", "Constant", {"Value": "linspace(1, 2, 3)'"}, columns(1, 1.5, 2))
source("ground", "Ground", {}, lambda t: 0 * t)
source("step", "Step", {"Time": "0.4", "Before": "-1", "After": "2"}, lambda t: np.where(t < 0.4, -1.0, 2.0))
source("step defaults", "Step", {}, lambda t: np.where(t < 1, 0.0, 1.0), defaults={"Step": {"Time": "1"}})
source("step sampled", "Step", {"Time": "0.4", "SampleTime": "0.25"}, lambda t: np.where(t < 0.5, 0.0, 1.0))
source("step vector", "Step", {"Time": "[0.4 0.8]", "After": "[1 2]"},
       columns(lambda t: np.where(t < 0.4, 0.0, 1.0), lambda t: np.where(t < 0.8, 0.0, 2.0)))
case("ramp", {"b": link("simulink/Sources/Ramp", "Ramp", slope="2", start="0.3", X0="1")}, "b>out1",
     lambda t: 1 + 2 * np.maximum(t - 0.3, 0))
source("sine", *SIN, wave)
source("sine vector", "Sin", {"Amplitude": "[1 2]", "Frequency": "[1 3]"}, columns(np.sin, lambda t: 2 * np.sin(3 * t)))
source("sine sampled", "Sin", {**SIN[1], "SampleTime": "0.1"}, sampled(0.1, lambda k: wave(0.1 * k)))
source("sine sample based",
       "Sin", {"SineType": "Sample based", "Samples": "10", "Offset": "3", "Amplitude": "2", "Bias": "1",
               "SampleTime": "0.1"},
       sampled(0.1, lambda k: 2 * np.sin(2 * np.pi * (k + 3) / 10) + 1))
after("c", CLOCK, "Sin", "sine of a signal", lambda u: 2 * np.sin(3 * u), lambda t: t,
      {"TimeSource": "Use external signal", "Amplitude": "2", "Frequency": "3"})
source("pulses", "DiscretePulseGenerator",
       {"Amplitude": "3", "Period": "0.5", "PulseWidth": "30", "PhaseDelay": "0.1", "PulseType": "Time based"},
       lambda t: 3 * pulse(t, 0.5, 0.15, 0.1))
source("pulses of samples", "DiscretePulseGenerator",
       {"Amplitude": "3", "Period": "5", "PulseWidth": "2", "PhaseDelay": "1", "SampleTime": "0.1",
        "PulseType": "Sample based"},
       lambda t: 3 * pulse(t, 0.5, 0.2, 0.1))
source("generator sine", "SignalGenerator", {"WaveForm": "sine", "Amplitude": "2", "Frequency": "0.7"},
       lambda t: 2 * np.sin(2 * np.pi * 0.7 * t))
source("generator sine in rad", "SignalGenerator", {"Frequency": "2", "Units": "rad/sec"}, lambda t: np.sin(2 * t))
source("generator square", "SignalGenerator", {"WaveForm": "square", "Amplitude": "2", "Frequency": "0.7"},
       lambda t: np.where((0.7 * t) % 1 >= 0.5, 2.0, -2.0))
source("clock", "Clock", {}, lambda t: t)
source("clock sampled", "DigitalClock", {"SampleTime": "0.3"}, sampled(0.3, lambda k: 0.3 * k))
source("from the workspace", "FromWorkspace", {"VariableName": "simin", "OutputAfterFinalValue": "Holding final value"},
       lambda t: np.interp(t, [0, 0.5, 1.3], [1, 3, 0]), callbacks={"InitFcn": "simin = [0 1; 0.5 3; 1.3 0];"})
source("from the workspace extrapolated", "FromWorkspace", {"VariableName": "[0 1; 1 3]"}, lambda t: 1 + 2 * t,
       stop="0.9")
case("repeating sequence",
     {"b": link("simulink/Sources/Repeating\nSequence", "Repeating table", rep_seq_t="[0 0.3 1]", rep_seq_y="[0 2 1]")},
     "b>out1", lambda t: np.interp(t % 1, [0, 0.3, 1], [0, 2, 1]))
case("chirp", {"b": link("simulink/Sources/Chirp Signal", "chirp", f1="0.1", T="100", f2="1")}, "b>out1",
     lambda t: np.sin(2 * np.pi * (0.1 * t + 0.9 / 200 * t**2)), stop="3")
case("uniform random numbers",
     {"b": ("UniformRandomNumber", {"Minimum": "2", "Maximum": "2.000000001", "SampleTime": "0.1"})},
     "b>out1", lambda t: 2 + 0 * t, told="other numbers")
case("random numbers", {"b": ("RandomNumber", {"Mean": "3", "Variance": "1e-20", "SampleTime": "0.1"})}, "b>out1",
     lambda t: 3 + 0 * t, told="other numbers")

# --- arithmetic -------------------------------------------------------------------------------------------------------

VECTOR = ("Constant", {"Value": "[1 2 3]"})
of_sin("Gain", "gain", lambda u: 2.5 * u, {"Gain": "5/2"})
of_sin("Gain", "gain of a vector", lambda u: np.stack([u, -2 * u], -1), {"Gain": "[1 -2]"})
for kind, given, y in (("Matrix(K*u)", "[1 2 3; 4 5 6]", [14, 32]), ("Matrix(K*u) (u vector)", "[0 0 1]", [3]),
                       ("Matrix(u*K)", "[1 4; 2 5; 3 6]", [14, 32])):
    case(f"gain {kind}", {"v": VECTOR, "b": ("Gain", {"Gain": given, "Multiplication": kind})}, "v>b b>out1",
         columns(*y) if len(y) > 1 else lambda t: 3 + 0 * t)
for signs, y in (("|+-", lambda u, t: u - t), ("+|-", lambda u, t: u - t), ("2", lambda u, t: u + t),
                 ("-|+|", lambda u, t: t - u), ("--", lambda u, t: -u - t)):
    case(f"sum {signs}", {"s": SIN, "c": CLOCK, "b": ("Sum", {"Inputs": signs})}, "s>b c>b:2 b>out1",
         lambda t, y=y: y(wave(t), t))
case("sum of a vector", {"v": VECTOR, "b": ("Sum", {"Inputs": "-"})}, "v>b b>out1", lambda t: -6 + 0 * t)
case("sum of a scalar and a vector", {"s": SIN, "v": VECTOR, "b": ("Sum", {"Inputs": "+-"})}, "s>b v>b:2 b>out1",
     columns(*(lambda t, i=i: wave(t) - i for i in (1, 2, 3))))
for signs, y in (("2", lambda u, t: u * t), ("*/", lambda u, t: u / (1 + t)), ("/*", lambda u, t: (1 + t) / u)):
    u = "e" if "/" in signs else "c"
    case(f"product {signs}", {"s": ("Sin", {"Bias": "3"}), "c": CLOCK, "e": ("Bias", {"Bias": "1"}), "b": ("Product",
     {"Inputs": signs})},
         f"c>e s>b {u}>b:2 b>out1", lambda t, y=y: y(np.sin(t) + 3, t))
case("product of three", {"s": SIN, "b": ("Product", {"Inputs": "3"})}, "s>b,b:2,b:3 b>out1", lambda t: wave(t) ** 3)
case("product of a vector", {"v": VECTOR, "b": ("Product", {"Inputs": "*"})}, "v>b b>out1", lambda t: 6 + 0 * t)
case("divided by a vector", {"v": VECTOR, "b": ("Product", {"Inputs": "/"})}, "v>b b>out1", lambda t: 1 / 6 + 0 * t)
of_sin("Bias", "bias", lambda u: u - 0.75, {"Bias": "-3/4"})
of_sin("Abs", "abs", np.abs)
of_sin("Signum", "signum", np.sign)
of_sin("UnaryMinus", "unary minus", np.negative)
case("dot product", {"v": VECTOR, "s": SIN, "g": ("Gain", {"Gain": "[1 0 2]"}), "b": ("DotProduct", {})},
     "s>g v>b g>b:2 b>out1", lambda t: 7 * wave(t))
of_sin("Polyval", "polynomial", lambda u: np.polyval([1, -2, 3], u), {"Coefs": "[1 -2 3]"})
case("friction", {"s": SIN, "b": link("simulink/Discontinuities/Coulomb &\nViscous Friction",
                                      "Coulombic and Viscous Friction", offset="0.5", gain="3")},
     "s>b b>out1", lambda t: np.sign(wave(t)) * (3 * np.abs(wave(t)) + 0.5))

# --- functions --------------------------------------------------------------------------------------------------------

BASE = ("Sin", {"Amplitude": "0.4", "Bias": "0.5", "Frequency": "5"})


def base(t: Array) -> Array:
    """Return the output of BASE: between 0.1 and 0.9."""
    return 0.4 * np.sin(5 * t) + 0.5


def away(u: Array) -> Array:
    """Round as MATLAB does: half away from 0."""
    return np.sign(u) * np.floor(np.abs(u) + 0.5)


for operator, y in {
    "exp": np.exp, "log": np.log, "10^u": lambda u: 10**u, "log10": np.log10, "magnitude^2": np.square,
     "conj": np.array,
    "square": np.square, "reciprocal": lambda u: 1 / u, "transpose": np.array, "sqrt": np.sqrt,
     "1/sqrt": lambda u: u**-0.5,
}.items():
    after("s", BASE, "Math", f"math {operator}", y, base, {"Operator": operator})
for operator, y in {
    "pow": lambda u, v: u**v, "hypot": np.hypot, "mod": lambda u, v: np.mod(u - 0.55, v), "rem": lambda u,
     v: np.fmod(u - 0.55, v),
}.items():
    bias = "-0.55" if operator in ("mod", "rem") else "0"
    case(f"math {operator}", {"s": BASE, "e": ("Bias", {"Bias": bias}), "k": ("Constant", {"Value": "0.3"}),
                              "b": ("Math", {"Operator": operator})},
         "s>e e>b k>b:2 b>out1", lambda t, y=y: y(base(t), 0.3))
for operator, y in {
    "sqrt": np.sqrt, "signedSqrt": lambda u: np.sign(u) * np.sqrt(abs(u)), "rSqrt": lambda u: u**-0.5,
}.items():
    after("s", BASE, "Sqrt", f"root {operator}", y, base, {"Operator": operator})
of_sin("Sqrt", "root signed", lambda u: np.sign(u) * np.sqrt(abs(u)), {"Operator": "signedSqrt"})
for operator, y in {"floor": np.floor, "ceil": np.ceil, "round": away, "fix": np.trunc}.items():
    of_sin("Rounding", f"rounding {operator}", y, {"Operator": operator})
case("rounding of halves", {"v": ("Constant", {"Value": "[-2.5 -0.5 0.5 1.5 2.5]"}), "b": ("Rounding",
     {"Operator": "round"})},
     "v>b b>out1", columns(-3, -1, 1, 2, 3))
for operator in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "atanh"):
    after("s", BASE, "Trigonometry", f"trigonometry {operator}", getattr(np, operator.replace("asin",
     "arcsin").replace("acos", "arccos").replace("atan", "arctan")),
          base, {"Operator": operator})
case("trigonometry atan2", {"s": SIN, "c": CLOCK, "b": ("Trigonometry", {"Operator": "atan2"})}, "s>b c>b:2 b>out1",
     lambda t: np.arctan2(wave(t), t))
case("trigonometry sincos", {"s": SIN, "b": ("Trigonometry", {"Operator": "sincos"}), "m": ("Sum", {"Inputs": "+-"})},
     "s>b b>m b:2>m:2 m>out1", lambda t: np.sin(wave(t)) - np.cos(wave(t)))
for expression, y in {
    "u^2 - 3*u + 1": lambda u, t: u**2 - 3 * u + 1,
    "u(1)*exp(-2*u(2))": lambda u, t: u * np.exp(-2 * t),
    "-u(1)^2": lambda u, t: -(u**2),
    "(u(1)>0)*u(2)": lambda u, t: (u > 0) * t,
    "a*((u(1) > 0) + (u(2) > 1) > 1) + (u(1) > 0)": lambda u, t: 2.5 * ((u > 0) & (t > 1)) + (u > 0),
    "u(1) > 0.5 && u(2) < 1.5": lambda u, t: 1.0 * ((u > 0.5) & (t < 1.5)),
    "!(u(1) > 0)": lambda u, t: 1.0 * (u <= 0),
    "u(1) == 0 || u(2) >= 1": lambda u, t: 1.0 * ((u == 0) | (t >= 1)),
    "sgn(u(1)) + abs(u(1))": lambda u, t: np.sign(u) + abs(u),
    "ln(3+u(1)) + log10(3+u(1)) + log(3 + u)": lambda u, t: 2 * np.log(3 + u) + np.log10(3 + u),
    "pow(u(2), 3) + hypot(u(1), u(2)) + power(2, u)": lambda u, t: t**3 + np.hypot(u, t) + 2**u,
    "rem(u(1), 0.7) + floor(u(1)) + ceil(u(2))": lambda u, t: np.fmod(u, 0.7) + np.floor(u) + np.ceil(t),
    "a*sin(u(2)) + b;": lambda u, t: 2.5 * np.sin(t) - 1,
    "sinh(u(1)) - cosh(u(1)) + tanh(u(2)) + atan2(u(1), u(2) + 1)":
        lambda u, t: np.sinh(u) - np.cosh(u) + np.tanh(t) + np.arctan2(u, t + 1),
    "u(2)/2 + 1e-1 - .5 + 3.": lambda u, t: t / 2 + 2.6,
}.items():
    case(f"Fcn {expression}", {"s": SIN, "c": CLOCK, "m": ("Mux", {"Inputs": "2"}), "b": ("Fcn", {"Expr": expression})},
         "s>m c>m:2 m>b b>out1", lambda t, y=y: y(wave(t), t), callbacks={"InitFcn": "a = 2.5; b = -1;"})

# --- logic and switches -----------------------------------------------------------------------------------------------

for operator, y in {"==": np.equal, "~=": np.not_equal, "<": np.less, "<=": np.less_equal, ">=": np.greater_equal,
                    ">": np.greater}.items():
    case(f"relation {operator}", {"s": SIN, "k": ("Constant", {"Value": "[0.25 9]"}), "b": ("RelationalOperator",
     {"Operator": operator})},
         "s>b k>b:2 b>out1", columns(*(lambda t, y=y, k=k: 1.0 * y(wave(t), k) for k in (0.25, 9))))
case("compared to a constant", {"s": SIN, "b": link("simulink/Logic and Bit\nOperations/Compare\nTo Constant",
                                                    "Compare To Constant", relop=">", const="1.5")},
     "s>b b>out1", lambda t: 1.0 * (wave(t) > 1.5))
case("compared to zero", {"s": SIN, "b": link("simulink/Logic and Bit\nOperations/Compare\nTo Zero", "Compare To Zero",
                                              relop="<=")},
     "s>b b>out1", lambda t: 1.0 * (wave(t) <= 0))
case("interval test", {"s": SIN, "b": link("simulink/Logic and Bit\nOperations/Interval Test", "Interval Test",
                                           lowlimit="-1", uplimit="1")},
     "s>b b>out1", lambda t: 1.0 * (abs(wave(t)) <= 1))
for operator, y in {"AND": lambda a, b: a & b, "OR": lambda a, b: a | b, "NAND": lambda a, b: ~(a & b), "NOR": lambda a,
                    b: ~(a | b),
                    "XOR": lambda a, b: a ^ b, "NXOR": lambda a, b: ~(a ^ b)}.items():
    case(f"logic {operator}", {"s": SIN, "c": CLOCK, "p": ("Signum", {}), "a": ("RelationalOperator",
     {"Operator": ">"}),
                               "b": ("Logic", {"Operator": operator}), "n": ("DiscretePulseGenerator",
                               {"PulseType": "Time based", "Period": "0.7",
                               "PulseWidth": "40"})},
         "s>a c>a:2 a>b n>b:2 b>out1",
         lambda t, y=y: 1.0 * y(wave(t) > t, pulse(t, 0.7, 0.28) > 0))
case("logic NOT", {"s": SIN, "p": ("Saturate", {"LowerLimit": "0", "UpperLimit": "inf"}), "b": ("Logic",
     {"Operator": "NOT"}), "g": ("Gain", {"Gain": "2"})},
     "s>p p>b b>g g>out1", lambda t: 2.0 * (wave(t) <= 0))
case("logic of a vector", {"v": ("Constant", {"Value": "[1 0 2]"}), "b": ("Logic", {"Operator": "OR", "Inputs": "1"})},
     "v>b b>out1", lambda t: 1 + 0 * t)
for criteria, threshold, y in (("u2 >= Threshold", "0.25", lambda u: u >= 0.25), ("u2 > Threshold", "1",
     lambda u: u > 1), ("u2 ~= 0", "7", lambda u: u != 0)):
    case(f"switch {criteria}", {"s": SIN, "c": CLOCK, "k": ("Constant", {"Value": "[1 2]"}), "b": ("Switch",
     {"Criteria": criteria, "Threshold": threshold})},
         "c>b s>b:2 k>b:3 b>out1", columns(*(lambda t, y=y, k=k: np.where(y(wave(t)), t, k) for k in (1, 2))))
for criteria, threshold in (("u2 >= Threshold", "0.5"), ("u2 > Threshold", "0"), ("u2 ~= 0", "0"), ("u2 >= Threshold",
     "1")):
    case(f"switch of a bool {criteria} {threshold}",
         {"s": SIN, "c": CLOCK, "o": link("simulink/x/Compare To Zero", "Compare To Zero", relop=">"), "b": ("Switch",
         {"Criteria": criteria, "Threshold": threshold})},
         "s>o c>b o>b:2 s>b:3 b>out1", lambda t: np.where(wave(t) > 0, t, wave(t)))
case("switch of a bool always", {"s": SIN, "o": link("simulink/x/Compare To Zero", "Compare To Zero", relop=">"),
                                 "b": ("Switch", {"Threshold": "0"})},
     "s>o,b o>b:2 b>out1", wave)
INDEX = ("Fcn", {"Expr": "floor(u) + 1"})
case("multiport switch", {"c": CLOCK, "i": INDEX, "s": SIN, "v": VECTOR, "b": ("MultiPortSwitch", {"Inputs": "2"})},
     "c>i i>b s>b:2 v>b:3 b>out1",
     columns(*(lambda t, k=k: np.where(t < 1, wave(t), k) for k in (1, 2, 3))))
case("multiport switch from 0", {"c": CLOCK, "i": ("Rounding", {"Operator": "floor"}), "s": SIN,
                                 "b": ("MultiPortSwitch", {"Inputs": "2", "DataPortOrder": "Zero-based contiguous"})},
     "c>i i>b s>b:2 c>b:3 b>out1", lambda t: np.where(t < 1, wave(t), t), stop="1.9")
case("multiport switch of one vector", {"c": CLOCK, "i": INDEX, "v": VECTOR, "b": ("MultiPortSwitch", {"Inputs": "1"})},
     "c>i i>b v>b:2 b>out1",
     lambda t: np.floor(t) + 1)
case("manual switch", {"s": SIN, "c": CLOCK, "b": ("ManualSwitch", {"sw": "0"})}, "s>b c>b:2 b>out1", lambda t: t,
     told="passes input 2")
case("min of two", {"s": SIN, "c": CLOCK, "b": ("MinMax", {"Function": "min", "Inputs": "2"})}, "s>b c>b:2 b>out1",
     lambda t: np.minimum(wave(t), t))
case("max of a vector", {"s": SIN, "v": VECTOR, "g": ("Product", {}), "b": ("MinMax", {"Function": "max"})},
     "s>g v>g:2 g>b b>out1",
     lambda t: np.maximum(wave(t), 3 * wave(t)))

# --- discontinuities and tables ---------------------------------------------------------------------------------------

of_sin("Saturate", "saturation", lambda u: np.clip(u, -1, 1.5), {"LowerLimit": "-1", "UpperLimit": "1.5"})
of_sin("Saturate", "saturation to inf", lambda u: np.maximum(u, 0), {"LowerLimit": "0", "UpperLimit": "inf"})
of_sin("Saturate", "saturation of copies", lambda u: np.stack([np.clip(u, -1, 1), np.clip(u, -1, 2)], -1),
       {"LowerLimit": "-1", "UpperLimit": "[1 2]"})
of_sin("Saturate", "saturation defaults", lambda u: np.clip(u, -0.5, 0.5))
of_sin("DeadZone", "dead zone", lambda u: np.maximum(u - 1, 0) + np.minimum(u + 0.5, 0), {"LowerValue": "-0.5",
     "UpperValue": "1"})
of_sin("Quantizer", "quantizer", lambda u: 0.3 * away(u / 0.3), {"QuantizationInterval": "0.3"})


def hysteresis(t: Array, high: float, low: float, on: float, off: float, before: float) -> Array:
    """Return what becomes on where SIN is above high, and off where it is below low."""
    fine = np.linspace(0, 2, 400_001)
    u = wave(fine)
    last = np.maximum.accumulate(np.where((u > high) | (u < low), np.arange(u.size), -1))
    return np.where(last < 0, before, np.where(u[last] > high, on, off))[np.searchsorted(fine, t, "right") - 1]


case("relay", {"s": SIN, "b": ("Relay", {"OnSwitchValue": "1.5", "OffSwitchValue": "-1", "OnOutputValue": "5",
                                         "OffOutputValue": "-5"})},
     "s>b b>out1", lambda t: hysteresis(t, 1.5, -1, 5, -5, -5))


def backlash(t: Array) -> Array:
    """Return a Backlash of width 1 behind 2 sin t."""
    y, out, fine = 0.0, [], np.linspace(0, 6, 600_001)
    for u in 2 * np.sin(fine):
        y = min(max(y, u - 0.5), u + 0.5)
        out.append(y)
    return np.interp(t, fine, out)


case("backlash", {"s": ("Sin", {"Amplitude": "2"}), "b": ("Backlash", {"BacklashWidth": "1", "InitialOutput": "0"})},
     "s>b b>out1", backlash, stop="6", tolerance=1e-5)
case("rate limiter", {"s": ("Step", {"Time": "0.5", "After": "3"}), "b": ("RateLimiter", {"RisingSlewLimit": "2",
     "FallingSlewLimit": "-1"})},
     "s>b b>out1", lambda t: np.clip(2 * (t - 0.5), 0, 3), stop="3", tolerance=1e-5)
case("table 1 of old", {"c": CLOCK, "b": ("Lookup", {"InputValues": "[0.5 1 1.5]", "Table": "[1 3 2]"})}, "c>b b>out1",
     lambda t: np.where(t < 1, 1 + 4 * (t - 0.5), 3 - 2 * (t - 1)))
for method, beyond, y in (
    ("Linear point-slope", "Linear", lambda t: np.where(t < 1, 1 + 4 * (t - 0.5), 3 - 2 * (t - 1))),
    ("Linear point-slope", "Clip", lambda t: np.interp(t, [0.5, 1, 1.5], [1, 3, 2])),
    ("Flat", "Clip", lambda t: np.select([t < 1, t < 1.5], [1.0, 3.0], 2.0)),
):
    case(f"table {method} {beyond}", {"c": CLOCK, "b": ("Lookup_n-D", {"NumberOfTableDimensions": "1",
     "BreakpointsForDimension1": "[0.5 1 1.5]",
                                      "Table": "[1 3 2]", "InterpMethod": method, "ExtrapMethod": beyond})},
                                      "c>b b>out1", y)
case("table of even spacing", {"c": CLOCK, "b": ("Lookup_n-D", {
    "NumberOfTableDimensions": "1", "BreakpointsSpecification": "Even spacing",
     "BreakpointsForDimension1FirstPoint": "0",
    "BreakpointsForDimension1Spacing": "0.8", "Table": "[1 3 2 5]"})}, "c>b b>out1", lambda t: np.interp(t, [0, 0.8,
     1.6, 2.4], [1, 3, 2, 5]))
case("table 2", {"c": CLOCK, "s": BASE, "b": ("Lookup_n-D", {
    "NumberOfTableDimensions": "2", "BreakpointsForDimension1": "[0 2]", "BreakpointsForDimension2": "[0 1]",
     "Table": "[1 3; 5 11]"})},
     "c>b s>b:2 b>out1", lambda t: 1 + 2 * t + 2 * base(t) + 2 * t * base(t))

# --- continuous -------------------------------------------------------------------------------------------------------


def area(t: Array) -> Array:
    """Return the integral of SIN from 0."""
    return 2 / 3 * (np.cos(0.5) - np.cos(3 * t + 0.5)) + 0.25 * t


def both(name: str, kind: str, values: Mapping[str, str], witness: Witness, **more: Any) -> None:
    """Add a model of SIN and a block behind it, whose output is given over time."""
    case(name, {"s": SIN, "b": (kind, values)}, "s>b b>out1", witness, **more)


both("integrator", "Integrator", {"InitialCondition": "-1"}, lambda t: area(t) - 1)
both("integrator of copies", "Integrator", {"InitialCondition": "[0 2]"}, lambda t: np.stack([area(t), area(t) + 2],
     -1))
both("integrator without limits", "Integrator", {"LimitOutput": "off", "UpperSaturationLimit": "0.1",
                                                 "LowerSaturationLimit": "0"}, area)
case("integrator with limits", {"s": ("Sin", {"Frequency": "2"}), "b": ("Integrator", {"LimitOutput": "on",
     "UpperSaturationLimit": "0.7", "LowerSaturationLimit": "-inf"})},
     "s>b b>out1", solved(lambda t, x: [np.sin(2 * t)], [0.0], lambda t, x: np.select(
         [t < np.arccos(1 - 1.4) / 2, t < np.pi / 2], [(1 - np.cos(2 * t)) / 2, 0.7], 0.7 - (1 + np.cos(2 * t)) / 2)),
         stop="3")
case("integrator with a constant start", {"s": SIN, "k": ("Constant", {"Value": "4"}), "b": ("Integrator",
     {"InitialConditionSource": "external"})},
     "s>b k>b:2 b>out1", lambda t: area(t) + 4)
case("integrator with a start", {"s": SIN, "g": ("Gain", {"Gain": "2"}), "b": ("Integrator",
     {"InitialConditionSource": "external"})},
     "s>b,g g>b:2 b>out1", lambda t: area(t) + 2 * wave(0.0))
PULSES = ("DiscretePulseGenerator", {"PulseType": "Time based", "Period": "0.8", "PulseWidth": "50",
                                     "PhaseDelay": "0.4"})  # on at 0.4, off at 0.8, ...
for way, edges in (("rising", [0.4, 1.2]), ("falling", [0.8, 1.6]), ("either", [0.4, 0.8, 1.2, 1.6])):
    case(f"integrator with reset {way}", {"k": ("Constant", {}), "p": PULSES, "b": ("Integrator", {"ExternalReset": way,
     "InitialCondition": "2"})},
         "k>b p>b:2 b>out1", lambda t, e=edges: 2 + t - np.array([0.0, *e])[np.searchsorted(e, t, "right")])
case("integrator with reset to a start", {"k": ("Constant", {}), "p": PULSES, "i": ("Constant", {"Value": "-3"}),
                                          "b": ("Integrator", {"ExternalReset": "rising",
                                          "InitialConditionSource": "external"})},
     "k>b p>b:2 i>b:3 b>out1", lambda t: t - np.array([0, 0.4, 1.2])[np.searchsorted([0.4, 1.2], t, "right")] - 3)
case("integrator with a state port", {"k": ("Constant", {}), "b": ("Integrator", {"ShowStatePort": "on"}), "g": ("Gain",
     {"Gain": "2"}), "end": "Terminator"},
     "k>b b:state>g g>out1 b>end", lambda t: 2 * t)
case("feedback", {"s": SIN, "e": ("Sum", {"Inputs": "|+-"}), "b": ("Integrator", {"InitialCondition": "1"})},
     "s>e e>b b>e:2,out1",
     solved(lambda t, x: [wave(t) - x[0]], [1.0], lambda t, x: x[0]))
both("second order integrator", "SecondOrderIntegrator", {"ICX": "1", "ICDXDT": "-2"},
     lambda t: 1 - 2 * t + solved(lambda t, x: [x[1], wave(t)], [0.0, 0.0], lambda t, x: x[0])(t))
both("transfer function", "TransferFcn", {"Numerator": "[2 1]", "Denominator": "[1 0.4 9]"},
     solved(lambda t, x: [x[1], wave(t) - 0.4 * x[1] - 9 * x[0]], [0.0, 0.0], lambda t, x: 2 * x[1] + x[0]))
both("transfer function with feedthrough", "TransferFcn", {"Numerator": "[3 1]", "Denominator": "[2 1]"},
     solved(lambda t, x: [(wave(t) - x[0]) / 2], [0.0], lambda t, x: x[0] + 3 * (wave(t) - x[0]) / 2))
both("transfer function with a zero in front", "TransferFcn", {"Numerator": "[0 0 4]", "Denominator": "[1 4]"},
     solved(lambda t, x: [4 * (wave(t) - x[0])], [0.0], lambda t, x: x[0]))
both("transfer function of variables", "TransferFcn", {"Numerator": "1", "Denominator": "[tau 1]"},
     solved(lambda t, x: [(wave(t) - x[0]) / 0.3], [0.0], lambda t, x: x[0]), callbacks={"PreLoadFcn": "tau = 0.3;"})
both("poles and zeros", "ZeroPole", {"Zeros": "[-1]", "Poles": "[-2 -3]", "Gain": "6"},
     solved(lambda t, x: [x[1], wave(t) - 6 * x[0] - 5 * x[1]], [0.0, 0.0], lambda t, x: 6 * (x[0] + x[1])))
both("poles alone", "ZeroPole", {"Zeros": "[]", "Poles": "[-2]", "Gain": "3"}, solved(lambda t, x: [wave(t) - 2 * x[0]],
     [0.0], lambda t, x: 3 * x[0]))
both("state space", "StateSpace", {"A": "[0 1; -4 -1]", "B": "[0; 1]", "C": "eye(2)", "D": "[0; 0.5]",
                                   "InitialCondition": "[1 -1]"},
     solved(lambda t, x: [x[1], wave(t) - 4 * x[0] - x[1]], [1.0, -1.0], lambda t,
            x: np.stack([x[0], x[1] + 0.5 * wave(t)], -1)))
both("transport delay", "TransportDelay", {"DelayTime": "0.3", "InitialOutput": "7"}, lambda t: np.where(t < 0.3, 7.0,
     wave(t - 0.3)), tolerance=1e-6, run={"rtol": 1e-9, "every": EVERY / 2})
after("c", CLOCK, "Derivative", "derivative of a ramp", lambda u: np.ones_like(u), lambda t: t, tolerance=1,
      told="smoothed")

# --- sampled ----------------------------------------------------------------------------------------------------------

H = "0.1"


def ticking(name: str, kind: str, values: Mapping[str, str], step: Callable[[Any, float, int], tuple[Any, float]],
            start: Any, **more: Any) -> None:
    """Add a block that ticks each 0.1 s behind SIN, and its difference equation."""
    both(name, kind, {"SampleTime": H, **values}, recursion(0.1, step, wave, start), **more)


def filtered(b: Sequence[float], a: Sequence[float]) -> Witness:
    return sampled(0.1, lambda k: lfilter(b, a, wave(0.1 * k)))


ticking("hold", "ZeroOrderHold", {}, lambda x, u, k: (x, u), 0)
both("hold with an offset", "ZeroOrderHold", {"SampleTime": "[0.1 0.03]"}, sampled(0.1, lambda k: wave(0.1 * k + 0.03),
     0.03))
ticking("unit delay", "UnitDelay", {"InitialCondition": "5"}, lambda x, u, k: (u, x), 5)
both("unit delay of old", "UnitDelay", {"X0": "5", "SampleTime": H}, recursion(0.1, lambda x, u, k: (u, x), wave, 5))
ticking("delay", "Delay", {"DelayLength": "3", "InitialCondition": "5"}, lambda x, u, k: ([*x[1:], u], x[0]), [5] * 3)
ticking("delay default", "Delay", {}, lambda x, u, k: ([*x[1:], u], x[0]), [0] * 2)
case("delay of integers", {"s": SIN, "b": link("simulink/Discrete/Integer Delay", "Integer Delay", NumDelays="4",
                                               vinit="1", samptime=H)}, "s>b b>out1",
     recursion(0.1, lambda x, u, k: ([*x[1:], u], x[0]), wave, [1] * 4))
case("memory", {"s": ("Sin", {**SIN[1], "SampleTime": H}), "b": ("Memory", {"X0": "5"})}, "s>b b>out1", recursion(0.1,
     lambda x, u, k: (u, x), wave, 5),
     settings={"SolverName": "FixedStepDiscrete", "FixedStep": H}, told="delays by")
case("unit delay inherits", {"s": SIN, "z": ("ZeroOrderHold", {"SampleTime": H}), "g": ("Gain", {"Gain": "2"}),
                             "b": ("UnitDelay", {"SampleTime": "-1"})},
     "s>z z>g g>b b>out1", recursion(0.1, lambda x, u, k: (2 * u, x), wave, 0))
case("unit delay inherits an offset", {"s": SIN, "z": ("ZeroOrderHold", {"SampleTime": "[0.1 0.03]"}),
                                       "b": ("UnitDelay", {"SampleTime": "-1"})},
     "s>z z>b b>out1", sampled(0.1, lambda k: np.concatenate([[0], wave(0.1 * k[:-1] + 0.03)]), 0.03))
case("a loop inherits", {"s": ("Sin", {**SIN[1], "SampleTime": H}), "a": ("Sum", {}), "b": ("UnitDelay",
     {"SampleTime": "-1", "InitialCondition": "1"})},
     "s>a b>a:2,out1 a>b", recursion(0.1, lambda x, u, k: (x + u, x), wave, 1))
case("two rates", {"s": SIN, "z": ("ZeroOrderHold", {"SampleTime": H}), "r": ("RateTransition",
     {"OutPortSampleTime": "0.3"}), "b": ("UnitDelay", {"SampleTime": "-1"})},
     "s>z z>r r>b b>out1", sampled(0.3, lambda k: np.concatenate([[0], wave(0.3 * k[:-1])])))
case("rate transition to a faster rate", {"s": SIN, "z": ("ZeroOrderHold", {"SampleTime": "0.2"}),
                                          "r": ("RateTransition", {"OutPortSampleTime": H, "InitialCondition": "9"})},
     "s>z z>r r>out1", sampled(0.2, lambda k: np.concatenate([[9], wave(0.2 * k[:-1])])))
case("gain sampled", {"s": SIN, "b": ("Gain", {"Gain": "2", "SampleTime": H})}, "s>b b>out1", sampled(0.1,
     lambda k: 2 * wave(0.1 * k)))
case("sum sampled", {"s": SIN, "b": ("Sum", {"SampleTime": H})}, "s>b,b:2 b>out1", sampled(0.1,
     lambda k: 2 * wave(0.1 * k)))


def summed(form: str, h: float, gain: float, start: float) -> Callable[[Any, float, int], tuple[Any, float]]:
    """Return the difference equation of a Discrete-Time Integrator; h: its period, or 1 if it accumulates."""
    weight = {"Forward Euler": 0.0, "Backward Euler": 1.0, "Trapezoidal": 0.5}[form]

    def step(x: float, u: float, k: int) -> tuple[float, float]:
        y = x + weight * h * gain * u
        return y + (1 - weight) * h * gain * u, y

    return step


for form in ("Forward Euler", "Backward Euler", "Trapezoidal"):
    for word, h in (("Integration", 0.1), ("Accumulation", 1.0)):
        for gain in ("1.0", "2.5"):
            ticking(f"sampled integrator {word} {form} {gain}", "DiscreteIntegrator",
                    {"IntegratorMethod": f"{word}: {form}", "gainval": gain, "InitialCondition": "3",
                     "InitialConditionSetting": "State (most efficient)"}, summed(form, h,
                    float(gain), 3), 3.0)
both("sampled integrator with a first output", "DiscreteIntegrator",
     {"IntegratorMethod": "Integration: Backward Euler", "InitialConditionSetting": "Output", "InitialCondition": "3",
      "SampleTime": H},
     recursion(0.1, lambda x, u, k: (3.0, 3.0) if k == 0 else (x + 0.1 * u, x + 0.1 * u), wave, 3.0))
ticking("sampled integrator with limits", "DiscreteIntegrator", {"LimitOutput": "on", "UpperSaturationLimit": "0.8",
     "LowerSaturationLimit": "-0.1"},
        lambda x, u, k: (min(max(x + 0.1 * u, -0.1), 0.8), x), 0.0)
both("transfer function in z", "DiscreteTransferFcn", {"Numerator": "[1 2]", "Denominator": "[1 0.5 0.1]",
                                                       "SampleTime": H}, filtered([0, 1, 2], [1, 0.5, 0.1]))
both("transfer function in z, not monic", "DiscreteTransferFcn", {"Numerator": "[1 2]", "Denominator": "[2 0.5]",
     "SampleTime": H}, filtered([1, 2], [2, 0.5]))
both("filter in 1/z", "DiscreteFilter", {"Numerator": "[1 2]", "Denominator": "[1 0.5 0.1]", "SampleTime": H},
     filtered([1, 2], [1, 0.5, 0.1]))
both("filter in 1/z with a delay", "DiscreteFilter", {"Numerator": "[0 1]", "Denominator": "[1 -0.5]", "SampleTime": H},
     filtered([0, 1], [1, -0.5]))
both("poles and zeros in z", "DiscreteZeroPole", {"Zeros": "[0.5]", "Poles": "[0.2 -0.3]", "Gain": "2",
                                                  "SampleTime": H},
     filtered([0, 2, -1], [1, 0.1, -0.06]))
both("FIR filter", "DiscreteFir", {"Coefficients": "[0.5 0.25 -1]", "SampleTime": H}, filtered([0.5, 0.25, -1], [1]))
both("state space in z", "DiscreteStateSpace", {"A": "[0.5 1; 0 -0.2]", "B": "[0; 1]", "C": "[1 2]", "D": "3",
                                                "X0": "[1 0]", "SampleTime": H},
     recursion(0.1, lambda x, u, k: (np.array([[0.5, 1], [0, -0.2]]) @ x + [0, u], x[0] + 2 * x[1] + 3 * u), wave,
               np.array([1.0, 0.0])))
HELD = ("Sin", {**SIN[1], "SampleTime": H})
for name, values, scale in (("Difference", {}, 1.0), ("Discrete Derivative", {"gainval": "2"}, 20.0)):
    case(name, {"s": HELD, "b": link(f"simulink/Discrete/{name}", name, **values)}, "s>b b>out1",
         recursion(0.1, lambda x, u, k, scale=scale: (u, scale * (u - x)), wave, 0.0))

# --- PID --------------------------------------------------------------------------------------------------------------


def pid(p: float, i: float, d: float, n: float, start: float = 0.0, low: float = -np.inf, high: float = np.inf,
        back: float = 0.0) -> Witness:
    """Return a continuous PID: x[0] is its integral, x[1] the state of its filter."""

    def total(t: Any, x: Any) -> Any:
        return p * wave(t) + x[0] + n * (d * wave(t) - x[1])

    def f(t: float, x: Array) -> Any:
        u = total(t, x)
        return [i * wave(t) + back * (np.clip(u, low, high) - u), n * (d * wave(t) - x[1])]

    return solved(f, [start, 0.0], lambda t, x: np.clip(total(t, x), low, high))


PID = "simulink/Continuous/PID Controller"


def controlled(name: str, witness: Witness, source: str = PID, kind: str = "PID 1dof", **values: str) -> None:
    case(name, {"s": SIN, "b": link(source, kind, **values)}, "s>b b>out1", witness, tolerance=1e-6)


controlled("PI default", pid(1, 1, 0, 100), Controller="PI")
controlled("P", pid(4, 0, 0, 100), Controller="P", P="4", I="7", D="8")
controlled("I", pid(0, 3, 0, 100), Controller="I", P="4", I="3")
controlled("PD", pid(2, 0, 0.5, 20), Controller="PD", P="2", D="0.5", N="20")
controlled("PID", pid(2, 3, 0.5, 20, 1), Controller="PID", P="2", I="3", D="0.5", N="20",
           InitialConditionForIntegrator="1")
controlled("PID ideal", pid(2, 6, 1, 20), Controller="PID", Form="Ideal", P="2", I="3", D="0.5", N="20")
controlled("PI limited", pid(2, 3, 0, 100, 0, -1, 2), Controller="PI", P="2", I="3", LimitOutput="on",
           UpperSaturationLimit="2", LowerSaturationLimit="-1")
controlled("PI back-calculation", pid(2, 3, 0, 100, 0, -1, 2, 4), Controller="PI", P="2", I="3", LimitOutput="on",
           UpperSaturationLimit="2",
           LowerSaturationLimit="-1", AntiWindupMode="back-calculation", Kb="4")


def sampled_pid(p: float, i: float, d: float, n: float, form: str, slope: str, low: float = -np.inf,
                high: float = np.inf, back: float = 0.0) -> Witness:
    """Return a discrete PID with integral and filter of these forms: x[0] and x[1]."""
    h, weights = 0.1, {"Forward Euler": 0.0, "Backward Euler": 1.0, "Trapezoidal": 0.5}
    a, b = weights[form], weights[slope]

    def step(x: Any, e: float, k: int) -> Any:
        v = n * (d * e - x[1]) / (1 + n * b * h)  # v = n (d e - x - b h v)
        total = (p * e + x[0] + v) if back else (p * e + x[0] + a * h * i * e + v)
        w = i * e + back * (np.clip(total, low, high) - total)
        return (x[0] + h * w, x[1] + h * v), np.clip(total, low, high)

    return recursion(0.1, step, wave, (0.0, 0.0))


DISCRETE = {"TimeDomain": "Discrete-time", "SampleTime": H, "P": "2", "I": "3", "D": "0.05", "N": "8"}
for form in ("Forward Euler", "Backward Euler", "Trapezoidal"):
    controlled(f"sampled PID {form}", sampled_pid(2, 3, 0.05, 8, form, form),
               "simulink/Discrete/Discrete PID Controller",
               Controller="PID", IntegratorMethod=form, FilterMethod=form, **DISCRETE)
controlled("sampled PI back-calculation", sampled_pid(2, 3, 0, 8, "Forward Euler", "Forward Euler", -1, 2, 4), **{
    **DISCRETE, "Controller": "PI", "LimitOutput": "on", "UpperSaturationLimit": "2", "LowerSaturationLimit": "-1",
    "AntiWindupMode": "back-calculation", "Kb": "4"})

# --- vectors, buses, tags ---------------------------------------------------------------------------------------------

case("mux of vectors", {"s": SIN, "v": VECTOR, "m": ("Mux", {"Inputs": "2"})}, "s>m v>m:2 m>out1", columns(wave, 1, 2,
     3))
case("mux by sizes", {"s": SIN, "v": VECTOR, "m": ("Mux", {"Inputs": "[1 3]"})}, "s>m v>m:2 m>out1", columns(wave, 1, 2,
     3))
case("mux and demux", {"s": SIN, "c": CLOCK, "m": ("Mux", {}), "d": ("Demux", {"Outputs": "2"}), "b": ("Sum",
     {"Inputs": "+-"})},
     "s>m c>m:2 m>d d>b:2 d:2>b b>out1", lambda t: t - wave(t))
case("demux in parts", {"v": ("Constant", {"Value": "[1 2 3 4 5]"}), "d": ("Demux", {"Outputs": "[2 -1 1]"}),
                        "m": ("Mux", {"Inputs": "3"})},
     "v>d d>m:3 d:2>m d:3>m:2 m>out1", columns(3, 4, 5, 1, 2))
case("demux unevenly", {"v": ("Constant", {"Value": "[1 2 3 4 5]"}), "d": ("Demux", {"Outputs": "2"})}, "v>d d:2>out1",
     columns(4, 5))
case("concatenate", {"s": SIN, "v": VECTOR, "b": ("Concatenate", {"NumInputs": "2"})}, "v>b s>b:2 b>out1", columns(1, 2,
     3, wave))
case("selector", {"v": VECTOR, "b": ("Selector", {"Indices": "[3 1]", "InputPortWidth": "3",
                                                  "IndexMode": "One-based"})}, "v>b b>out1", columns(3, 1))
case("selector from 0", {"v": VECTOR, "b": ("Selector", {"IndexParamArray": "{[2]}", "IndexMode": "Zero-based"})},
     "v>b b>out1", lambda t: 3 + 0 * t)
case("selector of a range", {"v": VECTOR, "b": ("Selector", {"IndexOptions": "Starting index (dialog)", "Indices": "2",
     "OutputSizes": "2"})}, "v>b b>out1", columns(2, 3))
case("bus", {"s": SIN, "v": VECTOR, "m": ("BusCreator", {"Inputs": "2"}), "b": ("BusSelector",
     {"OutputSignals": "state,speed"}), "g": ("Gain", {"Gain": "10"}), "x": ("Mux", {})},
     "s>m=speed v>m:2=state m>b b>g g>x b:2>x:2 x>out1", columns(10, 20, 30, wave))
case("bus in a bus", {"s": SIN, "c": CLOCK, "v": VECTOR, "a": ("BusCreator", {"Inputs": "2"}), "m": ("BusCreator",
     {"Inputs": "'pose','e v'"}),
                      "b": ("BusSelector", {"OutputSignals": "pose.y,e v,pose.x"}), "x": ("Mux", {"Inputs": "3"})},
     "s>a=x c>a:2=y a>m=pose v>m:2 m>b b>x b:2>x:2 b:3>x:3 x>out1", columns(lambda t: t, 1, 2, 3, wave))
case("bus assignment", {"s": SIN, "c": CLOCK, "v": VECTOR, "m": ("BusCreator", {"Inputs": "'a','b'"}),
                        "q": ("BusAssignment", {"AssignedSignals": "a"}),
                        "b": ("BusSelector", {"OutputSignals": "b,a"}), "x": ("Mux", {})},
     "s>m v>m:2 m>q c>q:2 q>b b>x b:2>x:2 x>out1", columns(1, 2, 3, lambda t: t))
case("bus through a subsystem", {"s": SIN, "c": CLOCK, "m": ("BusCreator", {"Inputs": "'a','b'"}),
                                 "u": sub({"b": ("BusSelector", {"OutputSignals": "b"})}, "in1>b b>out1")},
                                 "s>m c>m:2 m>u u>out1", lambda t: t)
case("tags", {"s": SIN, "Goto": ("Goto", {"GotoTag": "omega"}), "From": ("From", {"GotoTag": "omega"}), "g": ("Gain",
     {"Gain": "2"})}, "s>Goto From>g g>out1", lambda t: 2 * wave(t))
case("tags of a vector", {"v": VECTOR, "Goto": ("Goto", {}), "From": ("From", {})}, "From>out1 v>Goto", columns(1, 2,
     3))
case("tags around a loop", {"k": ("Constant", {"Value": "2"}), "From": ("From", {"GotoTag": "x"}), "e": ("Sum",
     {"Inputs": "+-"}), "i": ("Integrator", {}), "Goto": ("Goto", {"GotoTag": "x"})},
     "k>e From>e:2 e>i i>Goto,out1", lambda t: 2 * (1 - np.exp(-t)))
case("types and specifications", {"s": SIN, "a": ("DataTypeConversion", {"OutDataTypeStr": "double"}),
                                  "b": ("SignalSpecification", {}), "d": ("SignalConversion", {})},
     "s>a a>b b>d d>out1", wave)
case("type of a truth value", {"s": SIN, "o": link("simulink/x/Compare To Zero", "Compare To Zero", relop=">"),
                               "a": ("DataTypeConversion", {"OutDataTypeStr": "double"}), "g": ("Gain", {"Gain": "3"})},
     "s>o o>a a>g g>out1", lambda t: 3.0 * (wave(t) > 0))
case("width", {"v": VECTOR, "b": ("Width", {})}, "v>b b>out1", lambda t: 3 + 0 * t)
case("scopes and displays", {"s": SIN, "a": "Scope", "b": "Display", "w": ("ToWorkspace", {"VariableName": "y"}),
                             "end": "Terminator"}, "s>a,b,w,end,out1", wave)

# --- subsystems -------------------------------------------------------------------------------------------------------

TWICE = {"g": ("Gain", {"Gain": "2"})}
case("subsystem", {"s": SIN, "u": sub(TWICE, "in1>g g>out1")}, "s>u u>out1", lambda t: 2 * wave(t))
case("subsystems three deep", {"s": SIN,
                               "u": sub({"v": sub({"w": sub(TWICE, "in1>g g>out1")}, "in1>w w>out1"), "k": ("Bias",
                               {"Bias": "1"})}, "in1>v v>k k>out1")},
     "s>u u>out1", lambda t: 2 * wave(t) + 1)
case("subsystem with crossed ports", {"s": SIN, "c": CLOCK, "u": sub({}, "in1>out2 in2>out1"), "b": ("Sum",
     {"Inputs": "+-"})}, "s>u c>u:2 u>b u:2>b:2 b>out1", lambda t: t - wave(t))
case("subsystem of vectors", {"v": VECTOR, "u": sub({"i": ("Integrator", {})}, "in1>i i>out1")}, "v>u u>out1",
     columns(*(lambda t, k=k: k * t for k in (1, 2, 3))))
case("subsystem inherits a rate", {"s": HELD, "u": sub({"d": ("UnitDelay", {"SampleTime": "-1"})}, "in1>d d>out1")},
     "s>u u>out1", recursion(0.1, lambda x, u, k: (u, x), wave, 0.0))
case("atomic subsystem", {"s": SIN, "u": sub(TWICE, "in1>g g>out1", TreatAsAtomicUnit="on")}, "s>u u>out1",
     lambda t: 2 * wave(t))
case("open inputs", {"u": sub({"a": ("Bias", {"Bias": "3"})}, "in1>a a>out1"), "b": ("Sum", {"in": "2"})}, "u>b b>out1",
     lambda t: 3 + 0 * t, told="which is 0 there")
CLOCKED = {"i": ("Integrator", {}), "k": ("Constant", {}), "EnablePort": ("EnablePort", {"StatesWhenEnabling": "held"})}


def on_time(t: Array) -> Array:
    """Return how long PULSES have been on."""
    n, rest = np.divmod(np.maximum(t - 0.4, 0), 0.8)
    return 0.4 * n + np.minimum(rest, 0.4)


case("enabled subsystem", {"p": PULSES, "u": sub(CLOCKED, "k>i i>out1")}, "p>u:enable u>out1", on_time)
case("enabled subsystem with reset", {"p": PULSES,
                                      "u": sub({**CLOCKED, "EnablePort": ("EnablePort",
                                      {"StatesWhenEnabling": "reset"})}, "k>i i>out1")}, "p>u:enable u>out1",
     lambda t: np.select([t < 0.4, t < 0.8, t < 1.2, t < 1.6], [0 * t, t - 0.4, 0.4, t - 1.2], 0.4))
case("enabled subsystem with reset outputs", {"p": PULSES, "s": SIN,
                                              "u": sub({"EnablePort": "EnablePort", "out1": ("Outport",
                                              {"OutputWhenDisabled": "reset", "InitialOutput": "0"})}, "in1>out1")},
     "s>u p>u:enable u>out1", lambda t: wave(t) * pulse(t, 0.8, 0.4, 0.4))
case("enabled by a truth value", {"s": SIN, "c": CLOCK, "o": link("simulink/x/Compare To Constant",
     "Compare To Constant", relop=">=", const="1"), "u": sub(CLOCKED, "k>i i>out1")},
     "c>o o>u:enable u>out1", lambda t: np.maximum(t - 1, 0))
case("enabled before its first run", {"c": CLOCK, "o": ("Bias", {"Bias": "-1"}),
                                      "u": sub({"EnablePort": "EnablePort", "k": ("Constant", {"Value": "5"}),
                                                "out1": ("Outport", {"InitialOutput": "-2"})}, "k>out1")},
     "c>o o>u:enable u>out1", lambda t: np.where(t > 1, 5.0, -2.0))
for way, edges in (("rising", [0.4, 1.2]), ("falling", [0.8, 1.6]), ("either", [0.4, 0.8, 1.2, 1.6])):
    case(f"triggered subsystem {way}", {"s": SIN, "p": PULSES,
                                        "u": sub({"TriggerPort": ("TriggerPort", {"TriggerType": way}), "g": ("Gain",
                                        {"Gain": "2"}), "out1": ("Outport", {"InitialOutput": "0"})}, "in1>g g>out1")},
         "s>u p>u:trigger u>out1", lambda t,
         e=edges: np.array([0.0, *2 * wave(np.array(e))])[np.searchsorted(e, t, "right")])
ACTION = ("ActionPort", {})
case("if and else", {"s": SIN, "If": ("If", {"NumInputs": "1", "IfExpression": "u1 > 0.5", "ShowElse": "on"}),
                     "Merge": ("Merge", {"Inputs": "2"}),
                     "a": sub({"Action": ACTION, "g": ("Gain", {"Gain": "2"})}, "in1>g g>out1"),
                     "b": sub({"Action": ACTION, "g": ("Gain", {"Gain": "-1"})}, "in1>g g>out1")},
     "s>If,a,b If>a:ifaction If:2>b:ifaction a>Merge b>Merge:2 Merge>out1", lambda t: np.where(wave(t) > 0.5, 2,
     -1) * wave(t))
case("elseif", {"s": SIN, "c": CLOCK, "If": ("If", {"NumInputs": "2", "IfExpression": "u1 > 1 & u2 < 1",
                                                    "ElseIfExpressions": "u2 > 1.5, u1 < 0", "ShowElse": "on"}),
                                                    "Merge": ("Merge", {"Inputs": "4"}),
                **{n: sub({"Action": ACTION, "k": ("Constant", {"Value": v})}, "k>out1") for n, v in zip("abde", "1234",
                strict=True)}},
     "s>If c>If:2 If>a:ifaction If:2>b:ifaction If:3>d:ifaction If:4>e:ifaction "
     "a>Merge b>Merge:2 d>Merge:3 e>Merge:4 Merge>out1",
     lambda t: np.select([(wave(t) > 1) & (t < 1), t > 1.5, wave(t) < 0], [1.0, 2.0, 3.0], 4.0))
case("switch case", {"t": CLOCK, "g": ("Gain", {"Gain": "3"}), "i": ("Rounding", {"Operator": "floor"}),
                     "SwitchCase": ("SwitchCase", {"CaseConditions": "{1,[2 4]}", "ShowDefaultCase": "on"}),
                     "Merge": ("Merge", {"Inputs": "3"}),
                     **{n: sub({"Action": ACTION, "k": ("Constant", {"Value": v})}, "k>out1") for n, v in zip("abc",
                     "123", strict=True)}},
     "t>g g>i i>SwitchCase SwitchCase>a:ifaction SwitchCase:2>b:ifaction SwitchCase:3>c:ifaction "
     "a>Merge b>Merge:2 c>Merge:3 Merge>out1",
     lambda t: np.choose(np.floor(3 * t).astype(int), [3.0, 1.0, 2.0, 3.0, 2.0, 3.0]))

# --- variables, masks, files ------------------------------------------------------------------------------------------

case("tunable", {"s": SIN, "b": ("Gain", {"Gain": "kp"})}, "s>b b>out1", lambda t: 7 * wave(t),
     callbacks={"InitFcn": "kp = 3;"}, run={"parameters": {"kp": 7}})
case("tunable expression", {"s": SIN, "b": ("Gain", {"Gain": "2*kp^2 - k0"})}, "s>b b>out1", lambda t: 17.5 * wave(t),
     callbacks={"InitFcn": "kp = 1; k0 = 0.5;"}, run={"parameters": {"kp": 3}})
MASKED = masked(sub({"g": ("Gain", {"Gain": "k"}), "b": ("Bias", {"Bias": "off"})}, "in1>g g>b b>out1"), {"k": "2*kp",
     "off": "-1"})
case("mask", {"s": SIN, "u": MASKED}, "s>u u>out1", lambda t: 6 * wave(t) - 1, callbacks={"InitFcn": "kp = 3; k = 99;"})
case("tunable through a mask", {"s": SIN, "u": MASKED}, "s>u u>out1", lambda t: 10 * wave(t) - 1,
     callbacks={"InitFcn": "kp = 3;"}, run={"parameters": {"kp": 5}})
case("mask with code", {"s": SIN, "u": masked(sub({"g": ("Gain", {"Gain": "K"})}, "in1>g g>out1"), {"R": "4",
     "L": "0.5"}, "K = R/L; % gain")}, "s>u u>out1", lambda t: 8 * wave(t))
case("mask with code of its own name", {"s": SIN, "u": masked(sub({"g": ("Gain", {"Gain": "k"})}, "in1>g g>out1"),
     {"k": "50"}, "k = k/100;")}, "s>u u>out1", lambda t: 0.5 * wave(t))
case("masks in masks", {"s": SIN,
                        "u": masked(sub({"v": masked(sub({"g": ("Gain", {"Gain": "k"})}, "in1>g g>out1"),
                                                     {"k": "k + 1"})}, "in1>v v>out1"), {"k": "k*10"})},
     "s>u u>out1", lambda t: 41 * wave(t), callbacks={"InitFcn": "k = 4;"})
case("mask of a vector", {"s": SIN, "u": masked(sub({"g": ("Gain", {"Gain": "k"})}, "in1>g g>out1"), {"k": "[1 2]"})},
     "s>u u>out1", columns(wave, lambda t: 2 * wave(t)))
case("workspace of a script", {"s": SIN, "b": ("Gain", {"Gain": "motor.k*a(2)"})}, "s>b b>out1", lambda t: 6 * wave(t),
     files={"init.m": "% values\na = [1, 2]; b = 7;\nmotor.k = 3; disp(a)\n"})
LIBRARY = model("parts", system([block("SubSystem", "Twice /\n& more", 1, {}, {"in": 1, "out": 1},
                inside=sketch({"g": ("Gain", {"Gain": "k"})}, "in1>g g>out1"), mask=Mask("", {"k": "2"}))]), "Library")
case("library", {"s": SIN, "a": link("parts/Twice \n& more".replace("\n", "//\n")), "b": link("parts/Twice //\n& more",
     "SubSystem", k="-5"), "m": ("Mux", {})},
     "s>a,b a>m b>m:2 m>out1", columns(lambda t: 2 * wave(t), lambda t: -5 * wave(t)), beside=[LIBRARY])
INNER = model("inner", sketch({"i": ("Integrator", {"InitialCondition": "x0"})}, "in1>i i>out1"),
              callbacks={"InitFcn": "x0 = 2;"})
case("model reference", {"s": SIN, "r": ("ModelReference", {"ModelNameDialog": "inner.slx", "ModelName": "inner"})},
     "s>r r>out1", lambda t: area(t) + 2, beside=[INNER])
case("commented", {"s": SIN, "g": ("Gain", {"Gain": "9", "Commented": "on"}), "h": ("Gain", {"Gain": "9",
     "Commented": "through"}), "b": ("Sum", {"in": "2"})},
     "s>g,h g>b h>b:2 b>out1", wave)
case("names", {"Sinus\n(Wärme)": SIN, "a/b\\c": ("Gain", {"Gain": "2"}), "a b c": ("Gain", {"Gain": "3"}),
               "∫": ("Integrator", {}), 'k of the "EMF"': ("Sum", {"Inputs": "3"})},
     "Sinus__Wärme_>a_b_c,_ a_b_c>k_of_the__EMF_ _>k_of_the__EMF_:3 k_of_the__EMF_>out1",
     lambda t: 3 * wave(t) + area(t))
case("names of variables and blocks", {"s": SIN, "k": ("Gain", {"Gain": "k"}), "index": ("Gain", {"Gain": "K"})},
     "s>k k>index index>out1", lambda t: 6 * wave(t), callbacks={"InitFcn": "k = 2; K = 3;"})
case("algebraic loop", {"s": SIN, "e": ("Sum", {"Inputs": "|+-"}), "g": ("Gain", {"Gain": "0.5"})},
     "s>e e>g,out1 g>e:2", lambda t: wave(t) / 1.5, told="algebraic loop")
case("stop", {"c": CLOCK, "r": ("RelationalOperator", {"Operator": ">="}), "k": ("Constant", {"Value": "0.7"}),
              "Stop": "Stop"}, "c>r,out1 k>r:2 r>Stop",
     lambda t: np.where(t[-1] < 0.7001, t, np.nan))
case("stop by a number", {"p": PULSES, "c": CLOCK, "Stop": "Stop"}, "p>Stop c>out1",
     lambda t: np.where(abs(t[-1] - 0.4) < 1e-6, t, np.nan))
case("fixed step", {"s": SIN, "i": ("Integrator", {})}, "s>i i>out1", area, settings={"SolverName": "ode4",
     "FixedStep": "0.001"}, run={"rtol": 1e-9})


# --- what has no equal here -------------------------------------------------------------------------------------------


def merged(**values: str) -> tuple[System, str]:
    """Return an If without an else, whose two subsystems are merged."""
    inside = {n: sub({"Action": ACTION, "k": ("Constant", {"Value": v})}, "k>out1") for n, v in zip("ab", "12",
     strict=True)}
    parts = {"s": SIN, "If": ("If", {"ElseIfExpressions": "u1 < 0", **values}), "Merge": ("Merge", {"Inputs": "2"}),
             **inside}
    return sketch(parts, "s>If If>a:ifaction If:2>b:ifaction a>Merge b>Merge:2 Merge>out1"), "none of its inputs runs"


REFUSED = {
    "merge without else": merged(ShowElse="off"),
    "merge of some": merged(ShowElse="on"),
    "sawtooth": (sketch({"b": ("SignalGenerator", {"WaveForm": "sawtooth"})}, "b>out1"), "sawtooth"),
    "matrix": (sketch({"b": ("Constant", {"Value": "[1 2; 3 4]"})}, "b>out1"), "matrix"),
    "no variable": (sketch({"b": ("Constant", {"Value": "ones(n, 1)"})}, "b>out1"), "Give n by --workspace"),
    "function": (sketch({"b": ("Fcn", {"Expr": "evil(u)"})}, "in1>b b>out1"), "evil(u)"),
    "level": (sketch({"p": PULSES, "b": ("Integrator", {"ExternalReset": "level"})}, "in1>b p>b:2 b>out1"), "level"),
    "element": (sketch({"v": VECTOR, "b": ("Selector", {"Indices": "[4]"})}, "v>b b>out1"), "element 4 of 3"),
    "signal": (sketch({"m": "BusCreator", "b": ("BusSelector", {"OutputSignals": "z"})},
                      "in1>m=a in2>m:2=b m>b b>out1"), "no signal 'z'"),
    "sizes": (sketch({"v": VECTOR, "w": ("Constant", {"Value": "[1 2]"}), "b": "Sum"}, "v>b w>b:2 b>out1"),
              "3, 2 elements"),
    "no library": (sketch({"b": link("mine/Block")}, "in1>b b>out1"), "mine"),
    "no model": (sketch({"b": ("ModelReference", {"ModelName": "mine"})}, "in1>b b>out1"), "mine"),
    "S-Function": (sketch({"b": ("S-Function", {"FunctionName": "f"})}, "in1>b b>out1"), "S-Function"),
}
"""Systems, and a piece of what the report says of their block b, or of Merge."""
