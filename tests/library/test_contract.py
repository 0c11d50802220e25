"""Every block of the library keeps the contract, and its static equations are those of the literature."""

import math
import pkgutil
import subprocess
import sys
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import blocks.library
from blocks.contract.block import Block, is_abstract
from blocks.contract.interface import Interface
from blocks.contract.resolution import Resolved
from blocks.contract.table_lookup import pick, search
from blocks.contract.tape import Tape
from blocks.contract.tracing import trace
from blocks.library import LIBRARY
from blocks.text import units
from blocks.text.errors import ModelError
from tests.support.cases import in_one_test
from tests.support.library_variants import VARIANTS, Array, evaluate, reads, resolved
from tests.support.marks import long
from tests.support.on_numbers import numeric

ROUNDING = 1e-12
"""Floats and symbols run the same operations; what remains is the last bits of the elementary functions."""

variants = pytest.mark.parametrize(
    ("name", "given_"), VARIANTS, ids=[f"{name}-{'-'.join(map(str, given_)) or 'plain'}" for name, given_ in VARIANTS]
)


# --- the contract ----------------------------------------------------------------------------------------------

_OPERATIONS = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "neg": np.negative, "pow": np.power,
    "sqrt": np.sqrt, "log": np.log, "floor": np.floor,
    "sin": np.sin, "cos": np.cos, "tanh": np.tanh, "fabs": np.abs, "sign": np.sign, "fmax": np.maximum,
    "fmin": np.minimum,
    "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2, "expm1": np.expm1,
    "exp": np.exp, "fmod": np.fmod,
    "sinh": np.sinh, "cosh": np.cosh, "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh,
    "search": lambda x, table: search(table, x), "pick": lambda index, table: pick(table, index),
    "lt": np.less, "le": np.less_equal, "eq": np.equal, "ne": np.not_equal,
    "not": np.logical_not, "and": np.logical_and, "or": np.logical_or, "choose": lambda c, a, b: a if c else b,
}  # fmt: skip
"""What the tapes of the library hold, in numpy's terms."""


def run_tape(tape: Tape, values: dict[str, Any]) -> tuple[dict[str, Array], dict[str, float]]:
    """The results of a tape on numbers, and for each the largest number on the way to it."""
    arguments: list[Any] = [
        np.ravel(values[a.name]) if a.kind == "table" else float(np.ravel(values[a.name])[a.element])
        for a in tape.arguments
    ]
    made: list[Any] = []
    for node in tape.nodes:
        if node.op == "argument":
            argument = arguments[int(node.value)]
            made.append(argument if np.ndim(argument) else np.float64(argument))
        elif node.op == "constant":
            made.append(np.float64(node.value))
        else:
            made.append(np.float64(_OPERATIONS[node.op](*(made[k] for k in node.operands))))
    results = {key: np.array([made[k] for k in result.nodes]) for key, result in tape.results.items()}

    def finite(value: Any) -> bool:
        return bool(np.size(value)) and bool(np.all(np.isfinite(value)))

    sizes = {
        key: max([float(np.max(np.abs(made[k]))) for k in tape.needed(result.nodes) if finite(made[k])], default=0.0)
        for key, result in tape.results.items()
    }
    return results, sizes


def draw(made: Resolved, rng: np.random.Generator) -> dict[str, Any]:
    """Values for all that the equations of a block read: zeros, signs, small and large numbers."""
    interface, d = made.interface, made.interface.declaration
    values: dict[str, Any] = {"t": float(rng.choice([0.0, 0.5, 1.0, 1.5, 30.0])), "tick": int(rng.integers(0, 1000))}
    for name in interface.tables:
        values[name] = made.values[name].value
    for name in interface.symbolic_parameters:
        value = made.values[name].value
        values[name] = (value * rng.choice([1.0, 0.5, 1.7], size=value.shape))[()]
    for name, variable in {**d.inputs, **d.states, **d.discretes, **d.histories, **d.outputs}.items():
        shape = interface.shape(variable)
        if variable.type == "bool":
            values[name] = np.asarray(rng.integers(0, 2, size=shape), dtype=bool)[()]
        else:
            size = 10.0 ** rng.choice([-9.0, -3.0, -1.0, 0.0, 1.0, 6.0])
            values[name] = (rng.choice([-1.0, 0.0, 1.0], size=shape) * size * rng.random(size=shape))[()]
    for name in d.crossings:
        values[name] = np.bool_(rng.integers(0, 2))
    return values


@variants
@pytest.mark.parametrize("draws", [30, long(300)])
def test_numbers_and_symbols_give_the_same(name: str, given_: dict[str, Any], draws: int) -> None:
    made = resolved(name, given_)
    tape = trace(made.interface)
    rng = np.random.default_rng(7)
    with np.errstate(all="ignore"):  # Product divides by what it is given, and Exp overflows
        for _ in range(draws):
            values = draw(made, rng)
            ours, (theirs, sizes) = numeric(made.interface, values), run_tape(tape, values)
            assert ours.keys() == theirs.keys() - {"phase"}  # which tests/compile/test_motion.py looks at
            for key in ours:
                np.testing.assert_allclose(
                    theirs[key], ours[key], rtol=ROUNDING, atol=ROUNDING * sizes[key], err_msg=f"{key} at {values}"
                )


@in_one_test("name, given_", VARIANTS)
def test_every_unit_can_be_read(name: str, given_: dict[str, Any]) -> None:
    interface = resolved(name, given_).interface
    d = interface.declaration
    declared = [d.parameters, d.inputs, d.states, d.discretes, d.outputs]
    for variable in (variable for table in declared for variable in table.values()):
        for unit in interface.declared_units(variable):
            assert not unit or units.parse(unit)
    for variable in d.locals.values():
        unit = variable.unit
        made = interface._call(unit) if callable(unit) else unit
        for text in [made] if isinstance(made, str) else made:
            assert not text or units.parse(text)


def test_each_class_has_a_variant() -> None:
    assert {name for name, _ in VARIANTS} == set(LIBRARY)


def test_the_library_holds_every_block_class_of_its_modules() -> None:
    found = {}
    for module in pkgutil.iter_modules(blocks.library.__path__):
        for name, value in vars(import_module(f"blocks.library.{module.name}")).items():
            if isinstance(value, type) and issubclass(value, Block) and value is not Block and not is_abstract(value):
                found[name] = value
    assert found == dict(LIBRARY)
    assert sorted(LIBRARY) == sorted(set(blocks.library.__all__) - {"LIBRARY"})


def test_importing_the_library_loads_nothing_heavy() -> None:
    code = "import sys, blocks.library; print([m for m in ('scipy', 'control') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


@in_one_test("cls", LIBRARY.values())
def test_everything_is_documented(cls: Any) -> None:
    d = cls.declaration
    assert d.doc
    assert d.doc.splitlines()[0].endswith((".", ":"))
    for table in (d.parameters, d.inputs, d.states, d.discretes, d.outputs, d.locals):
        for name, variable in table.items():
            assert variable.doc, f"{cls.__name__}.{name}"
            assert not variable.doc.endswith("."), f"{cls.__name__}.{name}: a phrase, not a sentence"


@in_one_test("cls", LIBRARY.values())
def test_one_input_is_called_u_and_one_output_y(cls: Any) -> None:
    d = cls.declaration
    outputs = [*d.outputs, *(name for name, v in {**d.states, **d.discretes}.items() if v.output)]
    if len(outputs) == 1 and not d.inputs:
        assert outputs == ["y"]
    if len(outputs) == len(d.inputs) == 1:
        assert (outputs, list(d.inputs)) == (["y"], ["u"])


@pytest.mark.parametrize(
    ("name", "given_", "sentence"),
    [
        ("Biquad", {"period": 0.1, "sos": [[1.0, 0.0, 0.0, 0.0, 1.0, 0.0]]}, "sos must not be empty, no a0 may be 0"),
        ("Biquad", {"period": 0.1, "sos": [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]}, "has 1 dimension, but 2 are needed"),
        ("BouncingBall", {"h_start": -1.0}, "the ball must start on the floor or above it"),
        ("BouncingBall", {"e": 1.1}, "must be at most 1.0"),
        ("BuckConverter", {"i_start": -1.0}, "i_start must not be below 0: current does not flow back"),
        ("Chirp", {"duration": 0.0}, "must be above 0"),
        ("Chirp", {"form": "exponential", "omega_start": 0.0}, "needs two frequencies of one sign"),
        ("Chirp", {"form": "exponential", "omega_end": -1.0}, "needs two frequencies of one sign"),
        ("Compare", {"operator": "=<"}, "must be one of <, <=, >, >=, equal, unequal"),
        ("CoulombFriction", {"Fc": 2.0, "Fs": 1.0}, "Fs must not be below Fc"),
        ("Counter", {"first": 0.5}, "first and final must be integers, with first below final"),
        ("Counter", {"first": 3.0, "final": 3.0}, "first and final must be integers, with first below final"),
        ("DeadZone", {"upper": -2.0}, "lower must be below upper"),
        ("Delay", {"period": 0.1, "samples": 0}, "must be at least 1"),
        ("Delay", {"period": 0.1, "samples": 1.5}, "must be an integer"),
        ("Demux", {"size": 0}, "must be at least 1"),
        ("Derivative", {"Tf": 0.0}, "must be above 0"),
        ("DiscreteESO", {"bandwidth": 20.0}, "must be given: it has no default"),
        ("DiscreteESO", {"period": 0.1}, "give gains or bandwidth"),
        (
            "DiscreteESO",
            {"form": "euler", "period": 0.1, "bandwidth": 20.0},
            "bandwidth times period must be below 2, or the Euler steps are unstable",
        ),
        ("DiscreteINLSEF", {"period": 0.1, "b0": 0.0}, "b0 must not be 0"),
        ("DiscreteINTD", {"period": 0.1, "alpha": 1.0}, "alpha must lie between 0 and 1"),
        ("DiscreteIntegrator", {"period": 0.1, "form": "tustin"}, "must be one of forward, backward, trapezoidal"),
        ("DiscreteIntegrator", {"period": 0.1, "lower": 1.0, "upper": 1.0}, "lower must be below upper"),
        ("DiscreteIntegrator", {"period": 0.1, "lower": 1.0}, "y_start must lie within lower ... upper"),
        ("DiscretePID", {"period": 0.1, "lower": 1.0, "upper": 1.0}, "lower must be below upper"),
        ("DiscretePID", {"period": 0.1, "kp": 0.0, "kd": 1.0}, "kd/kp/10 is not a time; give Tf"),
        ("DiscretePID", {"period": 0.1, "Tt": 0.05}, "Tt must not be below the period"),
        ("DiscreteSMESO", {"period": 0.1, "order": 3}, "the paper's gains are for order 2"),
        ("DiscreteStateSpace", {"period": 0.1, "A": [[1.0, 2.0]]}, "has the shape 1 x 2, but n x n is needed"),
        ("DiscreteStateSpace", {}, "must be given: it has no default"),
        ("DiscreteTransferFunction", {"period": 0.1, "den": [0.0, 1.0]}, "first coefficient of den must not be 0"),
        ("DiscreteTransferFunction", {"period": 0.1, "num": [1.0] * 3}, "y would depend on u at later ticks"),
        ("DiscreteTransferFunction", {"period": 0.1, "num": []}, "num and den must not be empty"),
        ("Disturbance", {"on": 30.0, "off": 20.0}, "on must not be after off"),
        ("FIRFilter", {"period": 0.1, "b": []}, "b must not be empty"),
        ("FirstOrder", {"T": 0.0}, "must be above 0"),
        ("Expression", {"expression": "u1 +"}, "expression must be arithmetic: '=u1 +', column 5: expected a number"),
        ("Expression", {"expression": "u1 + x"}, "expression reads names that are not u1, u2, ..., k1, k2, ... or t"),
        ("Expression", {"expression": "u1*(1/0)"}, "'=u1*(1/0)', column 6: division by zero in 1.0 / 0.0."),
        ("Expression", {"expression": "u1*(-8)**0.5"}, "'=u1*(-8)**0.5', column 8: a power takes a positive base"),
        ("Expression", {"expression": "mod(u1, 2) + sqrt(-1)"}, "column 14: sqrt takes a number that is not negative"),
        ("Expression", {"expression": "u1 > 10**400"}, "column 8: overflow in 10.0 ** 400.0"),
        ("Expression", {"expression": "k2*u1", "k": [1.0]}, "k must hold as many constants as the expression reads"),
        ("INLSEF", {"order": 3}, "the paper's values are for order 2; give others for order 3"),
        ("INLSEF", {"alpha": [0.5, 0.0]}, "must be above 0"),
        ("INLSEF", {"k1": [1.0, 2.0, 3.0]}, "has the shape 3, but 2 is needed"),
        ("INTD", {"alpha": 1.0}, "alpha must lie between 0 and 1"),
        ("INTD", {"form": "literally"}, "must be one of unit, literal"),
        ("InvertedPendulum", {"l": 0.0}, "must be above 0"),
        ("LESO", {"order": 3}, "the paper's gains are for order 2; give gains or bandwidth for order 3"),
        ("LESO", {"bandwidth": 3.0, "gains": [1.0, 2.0, 3.0]}, "cannot be given together with 'gains'"),
        ("LESO", {"bandwidth": -3.0}, "must be above 0"),
        ("LSEF", {}, "give gains or bandwidth"),
        ("LSEF", {"bandwidth": 1.0, "b0": 0.0}, "b0 must not be 0"),
        ("LeadLag", {"T1": -1.0}, "must be at least 0"),
        ("LeadLag", {"T2": 0.0}, "must be above 0"),
        ("LimitedIntegrator", {"lower": 1.0, "upper": 1.0, "y_start": 1.0}, "lower must be below upper"),
        ("LimitedIntegrator", {"upper": 1.0, "lower": 2.0}, "lower must be below upper"),
        ("Logic", {"operator": "not", "size": 2}, "not has one input"),
        ("LuGreFriction", {"Fs": 0.5}, "Fs must not be below Fc"),
        ("MassSpringDamper", {"c": -1.0}, "must be at least 0"),
        ("LookupTable", {"points": [1.0, 1.0]}, "points must increase"),
        ("LookupTable", {"points": [], "values": []}, "points must not be empty"),
        ("LookupTable", {"points": [1.0, 2.0, 3.0], "values": [0.0, 1.0]}, "makes n = 2, but points makes it 3"),
        ("LookupTable", {"interpolation": "hold", "beyond": "linear"}, "held values do not go on in lines"),
        ("LookupTable2D", {"points1": [0.0], "values": [[0.0, 1.0]]}, "points1 and points2 need two points at least"),
        ("MatchedDisturbance", {"kt": 0.0}, "kt must not be 0"),
        ("MovingAverage", {"period": 0.1, "samples": 0}, "must be at least 1"),
        ("Multisine", {"harmonics": [1.0, 2.5]}, "harmonics must be integers above 0, at least one"),
        ("Multisine", {"harmonics": [1.0, 2.0], "amplitude": [1.0] * 3}, "makes n = 3, but harmonics makes it 2"),
        ("MatrixGain", {"K": [1.0, 2.0]}, "has 1 dimension, but 2 are needed"),
        ("MinMax", {"size": 17}, "must be at most 16"),
        ("Mux", {"size": 1.5}, "must be an integer"),
        ("NESO", {}, "give gains or bandwidth"),
        ("NESO", {"bandwidth": 1.0, "delta": 0.0}, "must be above 0"),
        ("NESO", {"bandwidth": 1.0, "gains": [1.0, 2.0, 3.0]}, "cannot be given together with 'gains'"),
        ("NLSEF", {"b0": 0.0}, "b0 must not be 0"),
        ("NLSEF", {"delta": 0.0}, "must be above 0"),
        ("PID", {"lower": 1.0, "upper": 1.0}, "lower must be below upper"),
        ("PID", {"kp": 0.0, "kd": 1.0}, "kd/kp/10 is not a time; give Tf"),
        ("PID", {"Tf": 0.0}, "must be above 0"),
        ("PMDCMotor", {"La": 0.0}, "must be above 0"),
        ("PRBS", {"period": 0.1, "order": 33}, "must be at most 32"),
        ("PRBS", {"period": 0.1, "order": 4, "seed": 16}, "seed must be below 2^order"),
        ("PRBS", {"period": 0.1, "seed": 0}, "must be at least 1"),
        ("Polynomial", {"c": []}, "c must not be empty"),
        ("Power", {"form": "signed", "exponent": 0.0}, "the signed form needs an exponent above 0"),
        ("Product", {"operations": "*+"}, "operations must be a text of * and /"),
        ("Pulse", {"on": math.nan}, "must be finite"),
        ("Pulse", {"on": 2.0, "off": 1.0}, "on must not be after off"),
        ("Quantizer", {"interval": 0.0}, "must be above 0"),
        ("Quadrotor", {"J": [1.0, 1.0, 0.0]}, "must be above 0"),
        ("QuarterCar", {"mw": 0.0}, "must be above 0"),
        ("RateTransition", {"period": 0.1}, "must be given: it has no default"),
        ("RateTransition", {"period": 0.1, "period_u": 0.1, "mode": "late"}, "must be one of hold, delay"),
        ("Relay", {"on_at": -2.0}, "off_at must not be above on_at"),
        ("ResettableIntegrator", {"direction": "sideways"}, "must be one of up, down, both"),
        ("RateLimiter", {"rising": 0.0}, "must be above 0"),
        ("SMESO", {"order": 1}, "give gains or bandwidth for order 1"),
        ("Saturation", {"lower": 2.0}, "lower must be below upper"),
        ("Sawtooth", {"period": 0.0}, "must be above 0"),
        ("SecondOrder", {"w": 0.0}, "must be above 0"),
        ("Selector", {"elements": []}, "elements must be numbers of elements of u"),
        ("Selector", {"elements": [1, 3], "size": 3}, "elements must be numbers of elements of u"),
        ("Selector", {"elements": [-1, 0]}, "elements must be numbers of elements of u"),
        ("Selector", {"elements": [0.5]}, "must be integers"),
        ("SquareWave", {"duty": 1.5}, "must be at most 1.0"),
        ("StateSpace", {"A": [[1.0, 2.0]]}, "has the shape 1 x 2, but n x n is needed"),
        ("Sum", {"signs": "+a"}, "signs must be a text of + and -"),
        ("Sum", {"signs": ""}, "signs must be a text of + and -"),
        ("Tank", {"h_start": 2.5}, "h_start must lie within 0 ... H"),
        ("Tank", {"c": 1.2}, "must be at most 1.0"),
        ("Table", {"times": [0.0, 0.0]}, "times must increase"),
        ("Table", {"values": 3.0}, "is a table, but a single number is given. Give a list."),
        ("TransportDelay", {"delay": 0.0}, "must be above 0"),
        ("TransferFunction", {"den": [0.0, 1.0]}, "the first coefficient of den must not be 0"),
        ("TransferFunction", {"num": [1.0, 2.0, 3.0]}, "would not be proper"),
        ("TransferFunction", {"num": []}, "num and den must not be empty"),
        ("Trapezoid", {"rise": 0.5, "width": 0.5}, "rise + width + fall must not be longer than the period"),
        ("Trigonometry", {"function": "sec"}, "must be one of sin, cos"),
        ("TwoLinkArm", {"l1": 0.0}, "must be above 0"),
        ("UnitDelay", {}, "must be given: it has no default"),
        ("UnitDelay", {"period": 0.0}, "must be above 0"),
        ("VanDerPol", {"mu": -1.0}, "must be at least 0"),
        ("WheelMixing", {"D": 0.0}, "must be above 0"),
        ("ZeroOrderHold", {"period": 1.0, "offset": -1.0}, "must be at least 0"),
        ("ZeroPoleGain", {"zeros": [1.0, 2.0]}, "there must not be more zeros than poles"),
        ("ZeroPoleGain", {"poles": [-1.0, -1.0], "poles_imag": [2.0, 2.0]}, "complex poles must stand in pairs"),
        ("ZeroPoleGain", {"poles": [-1.0, -1.0], "poles_imag": [-2.0, 2.0]}, "complex poles must stand in pairs"),
        ("ZeroPoleGain", {"poles": [-1.0], "poles_imag": [2.0]}, "complex poles must stand in pairs"),
        ("ZeroPoleGain", {"poles": [-1.0, -1.5], "poles_imag": [2.0, -2.0]}, "complex poles must stand in pairs"),
        (
            "ZeroPoleGain",
            {"zeros": [1.0, 1.0], "zeros_imag": [2.0, 0.0], "poles": [-1.0, -2.0]},
            "complex zeros must stand in pairs",
        ),
    ],
)
def test_values_that_cannot_be_are_refused(name: str, given_: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ModelError) as caught:
        resolved(name, given_)
    assert sentence in str(caught.value)


def ports(interface: Interface) -> dict[str, str]:
    return {port.name: port.unit for port in (*interface.inputs.values(), *interface.outputs.values())}


def test_units_follow_from_that_of_the_output() -> None:
    assert ports(resolved("Integrator", {"unit": "m"}).interface) == {"u": "m/s", "y": "m"}
    assert ports(resolved("LESO", {"unit": "rad/s", "unit_u": "V"}).interface) == {
        "y": "rad/s", "u": "V", "z1": "rad/s", "z2": "rad/s2", "z3": "rad/s3",
    }  # fmt: skip
    feedback = resolved("INLSEF", {"unit": "rad/s", "unit_u": "V"}).interface
    assert ports(feedback) == {
        "r1": "rad/s", "r2": "rad/s2", "z1": "rad/s", "z2": "rad/s2", "z3": "rad/s3", "u": "V", "I": "rad",
    }  # fmt: skip
    assert feedback.declared_units(feedback.declaration.parameters["b0"]) == ("rad/(s3.V)",)
    assert ports(resolved("PID", {"unit": "rad/s", "unit_u": "V"}).interface) == {
        "r": "rad/s", "y": "rad/s", "manual": "", "u_manual": "V", "u": "V",
    }  # fmt: skip
    pid = resolved("PID", {"unit": "rad/s", "unit_u": "V"}).interface
    for key, unit in {"kp": "V.s/rad", "ki": "V/rad", "kd": "V.s2/rad"}.items():
        assert units.same_quantity(pid.declared_units(pid.declaration.parameters[key])[0], unit)


# --- sources ---------------------------------------------------------------------------------------------------


def edges(name: str, cause: str, given_: dict[str, Any]) -> list[float]:
    """All event times after -inf, each asked for at the one before."""
    times, t = [], -math.inf
    for _ in range(10):
        made = resolved(name, given_)
        values = {key: made.values[key].value[()] for key in made.interface.symbolic_parameters}
        flags = dict.fromkeys(made.interface.declaration.discretes, np.False_)
        t = float(numeric(made.interface, {**values, **flags, "t": t})[f"event_time:{cause}"][0])
        if t == math.inf:
            break
        times.append(t)
    return times


def test_edges_of_sources() -> None:
    assert edges("Step", "edge", {"at": 3.0}) == [3.0]
    assert edges("Ramp", "corner", {"at": 3.0}) == [3.0]
    assert edges("Pulse", "edge", {"on": 1.0, "off": 4.0}) == [1.0, 4.0]
    assert edges("Pulse", "edge", {"on": 1.0, "off": 1.0}) == [1.0]
    assert edges("Disturbance", "edge", {}) == [25.0, 50.0]


@pytest.mark.parametrize(("t", "on"), [(0.9, False), (1.0, True), (1.5, True), (2.0, False), (3.0, False)])
def test_a_pulse_is_on_from_its_first_edge_up_to_its_second(t: float, on: bool) -> None:
    made = evaluate("Pulse", {"height": 5.0}, t=t, active=np.bool_(on))
    assert bool(made["initial:active"][0]) is bool(made["reset:active:edge"][0]) is on
    assert made["y"] == (5.0 if on else 0.0)


def test_a_step_at_the_start_has_come() -> None:
    assert evaluate("Step", t=0.0, stepped=np.False_)["initial:stepped"] == 1.0


# --- arithmetic, saturation, linear systems --------------------------------------------------------------------


def test_sums_and_products_follow_their_signs() -> None:
    assert evaluate("Sum", {"signs": "-+-"}, u=np.array([1.0, 10.0, 100.0]))["y"] == -91.0
    assert evaluate("Product", {"operations": "/*/"}, u=np.array([2.0, 10.0, 4.0]))["y"] == 1.25


def test_a_saturation_reads_its_sides() -> None:
    u = {"u": 0.3, "above": np.False_, "below": np.False_}
    assert evaluate("Saturation", **u)["y"] == 0.3
    assert evaluate("Saturation", **{**u, "above": np.True_})["y"] == 1.0
    assert evaluate("Saturation", **{**u, "below": np.True_})["y"] == -1.0


coefficients = st.floats(-5.0, 5.0).map(lambda x: round(x, 2))


@given(st.lists(coefficients, min_size=1, max_size=5), st.lists(coefficients, min_size=1, max_size=5))
@example([1.0], [2.0])
@example([0.0, 0.0, 3.0], [1.0, 0.0, 0.0])
def test_a_transfer_function_is_num_over_den(num: list[float], den: list[float]) -> None:
    den = [den[0] if abs(den[0]) >= 0.5 else 1.0, *den[1:]]
    num = num[: len(den)]
    given_ = {"num": num, "den": den}
    n = len(den) - 1
    at = [evaluate("TransferFunction", given_, x=x, u=0.0) for x in np.eye(n)]
    ahead = evaluate("TransferFunction", given_, x=np.zeros(n), u=1.0)
    A = np.array([made["derivative:x"] for made in at]).reshape(n, n).T
    B, D = ahead["derivative:x"], ahead["y"][0]
    C = np.array([made["y"][0] for made in at])
    for s in (1.7j, 20.0 + 3.0j):
        expected = np.polyval(num, s) / np.polyval(den, s)
        assert C @ np.linalg.solve(s * np.eye(n) - A, B.astype(complex)) + D == pytest.approx(expected, 1e-9, 1e-12)


def test_only_what_passes_through_at_once_is_feedthrough() -> None:
    assert reads("TransferFunction", {"num": [1.0], "den": [1.0, 1.0]}, "output:y") == [set()]
    assert reads("TransferFunction", {"num": [0.0, 1.0], "den": [1.0, 1.0]}, "output:y") == [set()]
    assert reads("TransferFunction", {"num": [1.0, 1.0], "den": [1.0, 1.0]}, "output:y") == [{"u[0]"}]
    matrices = {"A": np.eye(2), "B": np.eye(2), "C": np.eye(2), "D": [[0.0, 2.0], [0.0, 0.0]]}
    assert reads("StateSpace", matrices, "output:y") == [{"u[1]"}, set()]
    assert reads("UnitDelay", {"period": 1.0}, "output:y") == [set()]
    assert reads("ZeroOrderHold", {"period": 1.0}, "output:y") == [{"u[0]"}]
    assert reads("LESO", {}, "derivative:z") == [{"y[0]"}, {"y[0]", "u[0]"}, {"y[0]"}]


def test_a_limited_pid_takes_back_what_the_limit_cuts_off() -> None:
    pid = {"kp": 2.0, "ki": 4.0, "upper": 3.0}
    given = {"r": 8.0, "y": 3.0, "manual": 0.0, "u_manual": 0.0, "smoothed": 5.0}
    given |= {"by_hand": np.False_, "above": np.True_, "below": np.False_}
    made = evaluate("PID", pid, integral=1.0, **given)
    assert made["v"] == 11.0
    assert made["u"] == 3.0
    assert made["derivative:integral"] == 4.0 * 5.0 + (3.0 - 11.0) / 0.5  # Tt = kp/ki
    without = evaluate("PID", {**pid, "ki": 0.0}, integral=0.0, **given)
    assert without["derivative:integral"] == 0.0


def test_the_derivative_of_a_pid_is_filtered_over_a_tenth_of_its_time() -> None:
    values = resolved("PID", {"kp": 2.0, "kd": 1.0}).values
    assert values["Tf"].value == 0.05
    assert resolved("PID").values["Tf"].value == resolved("PID").values["Tt"].value == 1.0


# --- the paper's blocks ----------------------------------------------------------------------------------------


def nlsef(e1: float, e2: float = 0.0) -> float:
    return float(evaluate("NLSEF", r=np.array([e1, e2]), z=np.zeros(3))["u"][0])


@pytest.mark.parametrize(("k", "a", "d"), [(0, 0.1726, 0.4620), (1, 0.8730, 0.24807)])
def test_fal_is_a_line_within_delta_and_a_power_beyond(k: int, a: float, d: float) -> None:
    def fal(e: float) -> float:
        return nlsef(*(e if j == k else 0.0 for j in range(2)))

    assert fal(0.0) == 0.0
    assert fal(0.5 * d) == pytest.approx(0.5 * d**a, rel=1e-15)
    assert fal(d) == pytest.approx(fal(math.nextafter(d, 1.0)), rel=1e-14) == pytest.approx(d**a, rel=1e-14)
    assert fal(2.0 * d) == pytest.approx((2.0 * d) ** a, rel=1e-15)
    assert fal(-3.0 * d) == -fal(3.0 * d)


def test_the_feedbacks_take_off_the_disturbance_that_the_observer_sees() -> None:
    b0 = 1.1882 / (0.82 * 0.2752 * 3.0)
    for name, state in (("NLSEF", {}), ("INLSEF", {"I": 0.0})):
        made = evaluate(name, r=np.zeros(2), z=np.array([0.0, 0.0, 3.0]), **state)
        assert made["u"] == pytest.approx(-3.0 / b0, rel=1e-15)
    assert b0 == pytest.approx(1.755116752, rel=1e-9)


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
@example(0.0, 0.0, 0.0)
@example(1e6, -1e6, 1e6)
def test_the_improved_feedback_stays_finite_and_bounded(e1: float, e2: float, integral: float) -> None:
    made = evaluate("INLSEF", r=np.array([e1, e2]), z=np.zeros(3), I=integral)
    assert all(np.all(np.isfinite(value)) for value in made.values())
    assert abs(made["u"][0]) <= 3.8831


@given(st.floats(-3.5, 3.5), st.floats(-3.5, 3.5), st.floats(-3.5, 3.5))
def test_the_improved_feedback_is_that_of_eqs_2_to_4(e1: float, e2: float, integral: float) -> None:
    def term(k1: float, k2: float, mu: float, alpha: float, e: float) -> float:
        return (k1 + k2 / (1.0 + math.exp(mu * e * e))) * math.copysign(abs(e) ** alpha, e)

    v = (
        term(144.6642, 8.0475, 44.3160, 0.9675, e1)
        + term(25.5574, 4.8814, 48.8179, 1.4487, e2)
        + term(0.0, 0.5308, 26.1493, 3.5032, integral)
    )
    made = evaluate("INLSEF", r=np.array([e1, e2]), z=np.zeros(3), I=integral)
    assert made["v"] == pytest.approx(v, rel=1e-9, abs=1e-12)
    assert made["u"] == pytest.approx(3.8831 * math.tanh(v / 3.8831), rel=1e-9, abs=1e-12)
    assert made["derivative:I"] == e1


def fhan_in_one_formula(x1: float, x2: float, r: float, h: float) -> float:
    """Han's later form of fhan, without branches: every length is that of h x2."""

    def sign(x: float) -> float:
        return 0.0 if x == 0.0 else math.copysign(1.0, x)

    d = r * h * h
    a0 = h * x2
    y = x1 + a0
    a1 = math.sqrt(d * (d + 8.0 * abs(y)))
    a2 = a0 + sign(y) * (a1 - d) / 2.0
    sy = (sign(y + d) - sign(y - d)) / 2.0
    a = (a0 + y - a2) * sy + a2
    sa = (sign(a + d) - sign(a - d)) / 2.0
    return -r * (a / d - sign(a)) * sa - r * sign(a)


@given(st.floats(-2.0, 2.0), st.floats(-20.0, 20.0))
@example(0.0, 0.0)
@example(1e-5, 1e-3)
@example(-5e-5, 0.04)
def test_fhan_is_hans(x1: float, x2: float) -> None:
    made = evaluate("TrackingDifferentiator", r=0.0, r1=x1, r2=x2)
    expected = fhan_in_one_formula(x1, x2, 100.0, 1e-3)
    # The linear zone has the slope r/(h d) = 1e6 over x1, which multiplies the rounding of x1 + h x2.
    assert made["derivative:r2"] == pytest.approx(expected, rel=1e-9, abs=1e-8)


def test_the_sign_form_switches_on_the_braking_parabola() -> None:
    def acceleration(x1: float, x2: float) -> float:
        made = evaluate("TrackingDifferentiator", {"form": "sign"}, r=1.0, r1=1.0 + x1, r2=x2)
        return float(made["derivative:r2"][0])

    assert acceleration(-0.5, 0.0) == 100.0
    assert acceleration(-0.5, 10.1) == -100.0
    assert acceleration(-0.5, 9.9) == 100.0
    assert acceleration(0.0, 0.0) == 0.0


def test_the_literal_intd_settles_at_0_2334_and_the_other_at_1() -> None:
    gain = (1.0 - 0.4968) / 2.1555
    assert round(gain, 4) == 0.2334
    for form, r1 in (("literal", gain), ("unit", 1.0)):
        made = evaluate("INTD", {"form": form}, r=1.0, r1=r1, r2=0.0)
        assert made["derivative:r2"] == pytest.approx(0.0, abs=1e-13)
    made = evaluate("INTD", r=1.0, r1=0.0, r2=2.0)
    assert made["derivative:r2"] == pytest.approx(16.8199**2 * math.tanh(2.1555 / 11.9554) - 16.8199 * 2.0, rel=1e-14)


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_the_bandwidth_puts_all_poles_of_the_observer_in_one_place(order: int) -> None:
    n = order + 1
    columns = [
        evaluate("LESO", {"order": order, "bandwidth": 2.0}, y=0.0, u=0.0, z=z)["derivative:z"] for z in np.eye(n)
    ]
    polynomial = np.poly(np.array(columns).T)
    assert polynomial == pytest.approx(np.poly([-2.0] * n), rel=1e-9)


def test_the_observers_of_the_paper() -> None:
    z, y, u, b0 = np.array([0.9, -2.0, 5.0]), 1.3, 2.5, 1.1882 / (0.82 * 0.2752 * 3.0)
    linear = evaluate("LESO", y=y, u=u, z=z)["derivative:z"]
    e = y - 0.9
    assert linear == pytest.approx([-2.0 + 30.4 * e, 5.0 + b0 * u + 523.4 * e, 2970.8 * e], rel=1e-14)
    g = 0.6265 * e**0.8433 + 0.5878 * e**0.04078 * e
    sliding = evaluate("SMESO", y=y, u=u, z=z)["derivative:z"]
    assert sliding == pytest.approx([-2.0 + 30.4 * g, 5.0 + b0 * u + 513.4 * g, 1570.8 * g], rel=1e-14)
    assert evaluate("SMESO", y=0.5, u=u, z=z)["g"] == -evaluate("SMESO", y=1.3, u=u, z=z)["g"]


def at_rest(tau: float) -> tuple[float, float]:
    """Voltage and current that keep the motor at 1 rad/s against a torque."""
    current = (0.3922 * 3.0 + tau / 3.0) / 1.1882
    return 1.185 * 3.0 + 0.1557 * current, current


@pytest.mark.parametrize(("tau", "d", "control"), [(0.0, 0.0, 3.7092), (3.0, 0.9835, 3.8402)])
def test_theorem_1_in_numbers(tau: float, d: float, control: float) -> None:
    voltage, current = at_rest(tau)
    motor = evaluate("PMDCMotor", omega=1.0, i=current, v=voltage, tau=tau)
    assert motor["derivative:omega"] == pytest.approx(0.0, abs=1e-15)
    assert motor["derivative:i"] == pytest.approx(0.0, abs=1e-15)
    made = evaluate("MatchedDisturbance", omega=1.0, i=current, tau=tau, dtau=0.0)
    assert round(made["d"][0], 4) == d
    assert round(voltage, 4) == control
    assert made["total"] == pytest.approx(-voltage, rel=1e-12)


@given(*(st.floats(-10.0, 10.0) for _ in range(5)))
def test_theorem_1_gives_the_second_derivative_of_the_speed(
    omega: float, i: float, v: float, tau: float, dtau: float
) -> None:
    def slope(omega: float, i: float, tau: float) -> tuple[float, float]:
        made = evaluate("PMDCMotor", omega=omega, i=i, v=v, tau=tau)
        return float(made["derivative:omega"][0]), float(made["derivative:i"][0])

    # The motor is linear, so that a difference over any length is exact.
    domega, di = slope(omega, i, tau)
    second = slope(omega + domega, i + di, tau + dtau)[0] - domega
    total = evaluate("MatchedDisturbance", omega=omega, i=i, tau=tau, dtau=dtau)["total"][0]
    assert 1.1882 / (0.82 * 0.2752 * 3.0) * (v + total) == pytest.approx(second, rel=1e-9, abs=1e-9)


def test_the_robot_turns_towards_its_slower_wheel() -> None:
    made = evaluate("WheelMixing", omega_right=2.0, omega_left=1.0)
    assert (made["v"][0], made["omega"][0]) == pytest.approx((0.1125, 0.1875), rel=1e-15)
    pose = evaluate("Kinematics", v=2.0, omega=0.5, x=0.0, y=0.0, theta=math.pi / 6)
    slopes = [pose[f"derivative:{name}"][0] for name in ("x", "y", "theta")]
    assert slopes == pytest.approx([math.sqrt(3.0), 1.0, 0.5], rel=1e-15)


def test_an_impact_turns_the_ball_or_lays_it_to_rest() -> None:
    made = evaluate("BouncingBall", h=-1e-17, v=-2.0, resting=np.False_)
    assert (made["reset:h:impact"][0], made["reset:v:impact"][0], made["reset:resting:impact"][0]) == (0.0, 1.4, 0.0)
    made = evaluate("BouncingBall", h=-1e-17, v=-1e-3, resting=np.False_)
    assert (made["reset:v:impact"][0], made["reset:resting:impact"][0]) == (0.0, 1.0)
    made = evaluate("BouncingBall", h=0.0, v=0.0, resting=np.True_)
    assert (made["derivative:h"][0], made["derivative:v"][0]) == (0.0, 0.0)
