"""Linear models of diagrams against closed forms, differences of the blocks' own functions, and python-control."""

from __future__ import annotations

import functools
import gc
import json
import math
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from blocks import (
    INLSEF,
    INTD,
    NLSEF,
    PID,
    SMESO,
    Abs,
    Algebraic,
    Backlash,
    Block,
    Compare,
    CompareToConstant,
    Constant,
    DeadZone,
    Demux,
    Diagram,
    Discrete,
    DiscretePID,
    Divide,
    Expression,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    InvertedPendulum,
    LimitedIntegrator,
    LookupTable,
    MatrixGain,
    MinMax,
    ModelError,
    Mux,
    Parameter,
    PMDCMotor,
    Power,
    Product,
    Quantizer,
    QuarterCar,
    RateLimiter,
    Relay,
    Saturation,
    Sign,
    Sine,
    Sqrt,
    State,
    StateSpace,
    Step,
    Stepped,
    Sum,
    Switch,
    SwitchAbove,
    TrackingDifferentiator,
    TransferFunction,
    TransportDelay,
    ZeroOrderHold,
    crossing,
    fmu,
    output,
    stepper,
)
from blocks.contract.interface import Interface, Value
from blocks.contract.resolution import resolve
from blocks.contract.tracing import trace
from blocks.frequency.margins import margins
from blocks.frequency.response import bandwidth, dc_gain, h2, peak, poles, response
from blocks.library import LIBRARY
from blocks.linear.harmonic_balance import Linearizer
from blocks.linear.point import Point
from blocks.linear.slopes import slopes_at
from blocks.text.errors import AnalysisError, UsageError
from tests.support.fmus import DIAGRAMS
from tests.support.library_variants import VARIANTS, resolved
from tests.support.on_numbers import numeric
from tests.support.zoo import zoo

pytestmark = pytest.mark.filterwarnings("ignore:W702")  # many laws are looked at where they are flat

Array = np.ndarray[Any, Any]

ROUNDING = 1e-12
"""Sums and products of a few numbers, each rounded to 1e-16 of the largest of them."""
DIGITS = 1e-9
"""Figures that are known to ten digits."""
MOTORS = tuple(DIAGRAMS.parent / "fmus" / name for name in ("PMDCMotor.fmu", "PMDCMotor_fmi2.fmu"))
RA, LA, KB, KT, RATIO, JEQ, BEQ = 0.1557, 0.82, 1.185, 1.1882, 3.0, 0.2752, 0.3922
B0 = KT / (LA * JEQ * RATIO)
KP, KD = 144.6642, 25.5574
OBSERVERS: dict[str, dict[str, Any]] = {
    "leso_pd": {
        "gains": (30.4, 523.4, 2970.8),
        "poles": (-8.970816244, complex(-10.71459188, -14.70918934), complex(-10.71459188, 14.70918934)),
        "bandwidth": 9.856422606, "h2": 422.4727884,
        "gain": 3.041673242, "phase": 33.75572796, "crossover": 14.80974098, "delay": 0.03978115,
        "Ms": 2.043559704, "Mt": 1.739486522, "reference": 5.809135471, "disturbance": 0.14439167, "noise": 350.2185917,
    },
    "smeso_gains_pd": {
        "gains": (30.4, 513.4, 1570.8),
        "poles": (-3.812241604, complex(-13.2938792, -15.33994189), complex(-13.2938792, 15.33994189)),
        "bandwidth": 3.846405550, "h2": 212.4239518,
        "gain": 3.480644231, "phase": 40.19235560, "crossover": 13.83537364, "delay": 0.05070257,
        "Ms": 1.824165977, "Mt": 1.479125861, "reference": 5.246648132, "disturbance": 0.13124097, "noise": 297.7099056,
    },
}  # fmt: skip
"""Two linear observers of order 2 on the paper's motor under a PD law; `disturbance`: a torque on the motor's side."""
OMEGA = np.geomspace(0.05, 500.0, 23)
observers = pytest.mark.parametrize("name", OBSERVERS)


@functools.cache
def analysis(name: str) -> Linearizer:
    return Diagram.load(DIAGRAMS / "analysis" / f"{name}.json").linearizer()


def interface_of(block: Block) -> Interface:
    return resolve(type(block), {key: Value(value) for key, value in block.parameters.items()}).interface


def alone(block: Block, **values: Any) -> Diagram:
    """A block "b" whose inputs are those of the diagram, at these values (1 unless given)."""
    d = Diagram("alone")
    d.add("b", block)
    for port, what in interface_of(block).inputs.items():
        default, size = values.get(port, True if what.type == "bool" else 1.0), what.size if what.shape else None
        name = port if port != "b" else "phase_b"
        d.wire(f"b.{port}", d.input(name, type=what.type, size=size, default=default))
    return d


def gain(d: Diagram, input: str = "u", output: str = "b.y", **options: Any) -> float:
    """The one number of a model without states."""
    model = d.linearize(input, output, **options)
    assert model.nstates == 0
    return float(model.D[0, 0])


def at(model: Any, omega: Any = OMEGA) -> Array:
    return response(model, omega)


def motor_matrices() -> tuple[Array, Array]:
    """A and B of the motor: states omega, i; inputs v, tau."""
    A = np.array([[-BEQ / JEQ, KT / (JEQ * RATIO)], [-KB * RATIO / LA, -RA / LA]])
    return A, np.array([[0.0, -1.0 / (RATIO**2 * JEQ)], [1.0 / LA, 0.0]])


def plant(s: Any) -> Any:
    """v -> omega of the motor."""
    (a, b), (c, d) = motor_matrices()[0]
    return b / LA / ((s - a) * (s - d) - b * c)


def feedback(s: Any, gains: tuple[float, float, float]) -> Any:
    """C_fb: y -> -u of the observer with the PD law."""
    b1, b2, b3 = gains
    top = (KP * b1 + KD * b2 + b3) * s**2 + (KP * b2 + KD * b3) * s + KP * b3
    return top / (B0 * s * (s**2 + (b1 + KD) * s + b2 + KD * b1 + KP))


# --- the figures of the paper's observers ---------------------------------------------------------------------------


@observers
def test_an_observer_is_that_of_the_closed_forms(name: str) -> None:
    """y -> z and u -> z with both cut, against polynomials and python-control."""
    b1, b2, b3 = OBSERVERS[name]["gains"]
    cut = {"openings": ["eso.y", "eso.u"]}
    model = analysis(name).model(["eso.y", "eso.u"], ["eso.z1", "eso.z2", "eso.z3"], **cut)
    s = 1j * OMEGA
    delta = s**3 + b1 * s**2 + b2 * s + b3
    from_y = np.array([b1 * s**2 + b2 * s + b3, s * (b2 * s + b3), b3 * s**2]) / delta
    from_u = B0 * np.array([s, s * (s + b1), np.full(len(s), -b3)]) / delta
    known = np.stack([from_y, from_u], axis=1)
    assert at(model) == pytest.approx(known, rel=1e-11)
    assert control.StateSpace(model)(s) == pytest.approx(known, rel=1e-9)
    assert model.state_labels == ["eso_z[0]", "eso_z[1]", "eso_z[2]"]


@observers
def test_an_observer_has_its_poles_bandwidth_and_noise_gain(name: str) -> None:
    known = OBSERVERS[name]
    b1, b2, b3 = known["gains"]
    linearizer, cut = analysis(name), {"openings": ["eso.y", "eso.u"]}
    to_z3 = linearizer.model("eso.u", "eso.z3", **cut)
    assert poles(to_z3) == pytest.approx(np.array(known["poles"]), rel=DIGITS)
    assert np.sort_complex(poles(to_z3)) == pytest.approx(np.sort_complex(np.roots([1, b1, b2, b3])), rel=1e-10)
    # f enters where b0 u does, so that f -> z3 is u -> z3 over its gain at rest.
    assert dc_gain(to_z3)[0, 0] == pytest.approx(-B0, rel=ROUNDING)
    found = bandwidth(to_z3)
    assert found == pytest.approx(known["bandwidth"], rel=DIGITS)

    def drop(w: float) -> float:
        return abs(b3 / ((1j * w) ** 3 + b1 * (1j * w) ** 2 + b2 * 1j * w + b3)) - math.sqrt(0.5)

    assert found == pytest.approx(brentq(drop, 0.1, 100.0, xtol=1e-14), rel=1e-10)
    noise = h2(linearizer.model("eso.y", "eso.z3", **cut))
    assert noise == pytest.approx(known["h2"], rel=DIGITS)
    assert noise == pytest.approx(b3 * math.sqrt(b2 / (2 * (b1 * b2 - b3))), rel=1e-11)


@observers
def test_the_loop_at_the_motor_has_the_margins_of_the_figures(name: str) -> None:
    known = OBSERVERS[name]
    L = analysis(name).loop("control.u")
    assert at(L)[0, 0] == pytest.approx(plant(1j * OMEGA) * feedback(1j * OMEGA, known["gains"]), rel=1e-9)
    found = margins(L)
    assert found.stable
    assert found.gain == pytest.approx(known["gain"], rel=DIGITS)
    ((degrees, crossover),) = [pair for pair in found.phases if pair[0] > 0]
    assert (degrees, crossover) == pytest.approx((known["phase"], known["crossover"]), rel=DIGITS)
    assert min(found.delays)[0] == pytest.approx(known["delay"], rel=2e-7)  # seven digits are known
    assert (found.Ms, found.Mt) == pytest.approx((known["Ms"], known["Mt"]), rel=DIGITS)
    by_control = control.stability_margins(control.StateSpace(L.A, L.B, L.C, L.D))
    assert (by_control[0], by_control[1], by_control[4]) == pytest.approx((found.gain, degrees, crossover), rel=1e-6)


@observers
def test_the_closed_loop_has_the_bandwidth_and_the_peaks_of_the_figures(name: str) -> None:
    known, linearizer = OBSERVERS[name], analysis(name)
    gains = known["gains"]
    from_r = linearizer.model("r", "motor.omega")
    assert bandwidth(from_r) == pytest.approx(known["reference"], rel=DIGITS)
    s = 1j * OMEGA
    b1, b2, b3 = gains
    top = (KP * b1 + KD * b2 + b3) * s**2 + (KP * b2 + KD * b3) * s + KP * b3
    prefilter = KP * (s**3 + b1 * s**2 + b2 * s + b3) / top
    loop = plant(s) * feedback(s, gains)
    assert at(from_r)[0, 0] == pytest.approx(loop / (1 + loop) * prefilter, rel=1e-9)
    # The torque of the figures is on the motor's side of the gear.
    assert RATIO * peak(linearizer.model("tau", "motor.omega")).value == pytest.approx(known["disturbance"], rel=1e-7)
    noise = linearizer.model("n", "control.u")
    assert peak(noise).value == pytest.approx(known["noise"], rel=DIGITS)
    assert at(noise)[0, 0] == pytest.approx(-feedback(s, gains) / (1 + loop), rel=1e-9)


def test_the_literal_differentiator_settles_at_0_2334() -> None:
    d = alone(INTD(form="literal"), r=0.0)
    model = d.linearize("r", "b.r1")
    assert poles(model) == pytest.approx(np.array([-3.96921279, -12.85068721]), rel=1e-8)
    assert dc_gain(model)[0, 0] == pytest.approx(0.2334493157, rel=DIGITS)
    assert bandwidth(model) == pytest.approx(3.659400591, rel=DIGITS)
    R, alpha, beta, gamma = 16.8199, 0.4968, 2.1555, 11.9554
    s = 1j * OMEGA
    assert at(model)[0, 0] == pytest.approx(
        R**2 * (1 - alpha) / gamma / (s**2 + R * s + R**2 * beta / gamma), rel=1e-11
    )


# --- signals: where something is put in, cut and read ----------------------------------------------------------------


def bent() -> Diagram:
    """x' = r - x^3 + u,  y = x^2: with an integrator that holds x where y is 2 r^2, at every r above 0."""
    d = Diagram("bent")
    r = d.input("r", default=1.0)
    error, memory, force = d.add("error", Sum(signs="+-")), d.add("memory", Integrator()), d.add("force", Sum())
    plant = d.add("plant", Cubic())
    d.wire(error.u1, r)
    d.wire(error.u2, plant.y)
    d.wire(memory.u, error.y)
    d.wire(force.u1, memory.y)
    d.wire(force.u2, error.y)
    d.wire(plant.u, force.y)
    return d


class Cubic(Block):
    """x' = u - x^3, y = x^2."""

    u = Input()
    x = State(1.0)

    @x.derivative
    def dx(x, u):  # type: ignore[no-untyped-def]
        return u - x**3

    @output
    def y(x):  # type: ignore[no-untyped-def]
        return x**2


@pytest.mark.parametrize("x", [0.5, 1.0, 2.0])
def test_an_opening_keeps_the_value_that_the_signal_has(x: float) -> None:
    """x' = u - x^3, y = x^2 has the slopes -3 x^2 and 2 x; cut to 0, they would be those at another x."""
    d = bent()
    point = d.point(inputs={"r": x**2}).moved(x=[x**3, x])
    linearizer = Linearizer(slopes_at(point))
    s = 1j * OMEGA
    P, C = 2 * x / (s + 3 * x**2), 1 + 1 / s
    assert at(linearizer.model("force.y", "plant.y", openings="force.y"))[0, 0] == pytest.approx(P, rel=ROUNDING)
    assert at(linearizer.model("plant.u", "plant.y", openings="plant.y"))[0, 0] == pytest.approx(P, rel=ROUNDING)
    for name in ("plant.y", "error.y", "force.y", "error.u2", "plant.u"):
        assert at(linearizer.loop(name))[0, 0] == pytest.approx(P * C, rel=ROUNDING), name
        S, T = linearizer.sensitivity(name), linearizer.complementary(name)
        assert at(S)[0, 0] == pytest.approx(1 / (1 + P * C), rel=1e-11), name
        assert at(S) + at(T) == pytest.approx(np.ones((1, 1, len(OMEGA))), rel=ROUNDING)
        assert at(linearizer.loop(name, sign=1.0)) == pytest.approx(-at(linearizer.loop(name)), rel=ROUNDING)
    assert at(linearizer.model("r", "plant.y"))[0, 0] == pytest.approx(P * C / (1 + P * C), rel=1e-11)
    assert at(linearizer.model("r", "plant.y", openings="plant.y"))[0, 0] == pytest.approx(P * C, rel=ROUNDING)


def test_an_input_of_a_block_alone_sees_what_is_put_in_there() -> None:
    """error.y goes to the memory and to the force: at force.u2 only the second way is disturbed or cut."""
    x = 1.0
    point = bent().point().moved(x=[x**3, x])
    linearizer = Linearizer(slopes_at(point))
    s = 1j * OMEGA
    P = 2 * x / (s + 3 * x**2)
    assert at(linearizer.model("force.u2", "plant.y"))[0, 0] == pytest.approx(P / (1 + P * (1 + 1 / s)), rel=1e-11)
    # With the integral closed, the rest of the loop at force.u2 is P/(1 + P/s).
    assert at(linearizer.loop("force.u2"))[0, 0] == pytest.approx(P / (1 + P / s), rel=1e-11)
    assert at(linearizer.loop("memory.u"))[0, 0] == pytest.approx(P / s / (1 + P), rel=1e-11)
    assert at(linearizer.loop("error.y"))[0, 0] == pytest.approx(P * (1 + 1 / s), rel=1e-11)
    # What is read at an input of a block stands in front of what is put in there, and behind it where both are asked.
    both = linearizer.model("force.u2", ["error.y", "force.u2"])
    assert at(both)[1, 0] - at(both)[0, 0] == pytest.approx(np.ones(len(OMEGA)), rel=ROUNDING)


def test_a_signal_can_be_input_and_output_and_opened() -> None:
    linearizer = analysis("leso_pd")
    S = linearizer.model("control.u", "control.u")
    assert at(S) == pytest.approx(1 / (1 + at(linearizer.loop("control.u"))), rel=1e-10)
    # Cut, nothing of what is put in comes back but what was put in the way round: that is the loop.
    L = linearizer.model("control.u", "control.u", openings="control.u")
    assert at(L) == pytest.approx(-at(linearizer.loop("control.u")), rel=1e-10)
    assert at(linearizer.model("r", "r"))[0, 0] == pytest.approx(np.ones(len(OMEGA)), rel=ROUNDING)
    assert linearizer.model("r", "motor.omega", openings="control.u").nstates == 0


def test_points_within_subdiagrams_are_those_at_their_edges() -> None:
    linearizer = analysis("smeso_gains_pd")
    for inner, outer in (("control.drive.y", "control.u"), ("control.drive.y", "u")):
        for ends in ((inner, "motor.omega"), ("r", inner)):
            outside = tuple(outer if name == inner else name for name in ends)
            assert at(linearizer.model(*ends)) == pytest.approx(at(linearizer.model(*outside)), rel=ROUNDING)
        assert at(linearizer.loop(inner)) == pytest.approx(at(linearizer.loop(outer)), rel=ROUNDING)
    assert at(linearizer.model("control.law.r1", "motor.omega")) == pytest.approx(
        at(linearizer.model("r", "motor.omega")), rel=ROUNDING
    )


def test_what_leaves_a_subdiagram_is_disturbed_outside_of_it_alone() -> None:
    """control.known goes to the observer; within, law.u goes to the drive of the motor as well."""
    linearizer, s = analysis("leso_pd"), 1j * OMEGA
    b1, b2, b3 = OBSERVERS["leso_pd"]["gains"]
    delta = s**3 + b1 * s**2 + b2 * s + b3
    K = np.array([KP, KD, 1.0]) / B0
    from_y = K @ (np.array([b1 * s**2 + b2 * s + b3, s * (b2 * s + b3), b3 * s**2]) / delta)
    from_u = K @ (B0 * np.array([s, s * (s + b1), np.full(len(s), -b3)]) / delta)
    back = 1 + from_y * plant(s) + from_u
    assert at(linearizer.model("control.known", "control.u"))[0, 0] == pytest.approx(-from_u / back, rel=1e-9)
    assert at(linearizer.loop("control.known"))[0, 0] == pytest.approx(from_u / (1 + from_y * plant(s)), rel=1e-9)
    assert at(linearizer.loop("control.law.u"))[0, 0] == pytest.approx(back - 1, rel=1e-9)


def test_locals_and_states_are_signals() -> None:
    """e of the observer is y - z1, and a state that is no output can be read and disturbed."""
    linearizer = analysis("smeso_pd")
    d = Diagram.load(DIAGRAMS / "analysis" / "smeso_pd.json")
    linearizer = d.linearizer(amplitude={"eso.e": 0.1})
    made = linearizer.model("n", ["eso.e", "sensor.y", "eso.z1"])
    e, y, z = at(made)[:, 0]
    assert e == pytest.approx(y - z, rel=1e-10, abs=1e-13)
    cubic = Linearizer(slopes_at(bent().point().moved(x=[1.0, 1.0])))
    read = cubic.model("plant.u", "plant.x", openings="plant.u")
    assert at(read)[0, 0] == pytest.approx(1 / (1j * OMEGA + 3.0), rel=ROUNDING)
    assert made.signals == (("n",), ("eso.e", "sensor.y", "eso.z1"))


def test_vectors_and_their_elements_are_named_by_number() -> None:
    A, B = np.array([[-1.0, 2.0], [0.5, -3.0]]), np.array([[1.0, 0.0], [0.3, 2.0]])
    K = np.array([[1.0, 2.0], [3.0, 4.0]])
    d = Diagram("vectors")
    plant, law, mux = (
        d.add("plant", StateSpace(A=A, B=B, C=np.eye(2), D=np.zeros((2, 2)))),
        d.add("law", MatrixGain(K=K)),
        d.add("mux", Mux(size=2)),
    )
    split = d.add("split", Demux(size=2))
    d.wire(split.u, plant.y)
    for k in range(2):
        total = d.add(f"sum{k}", Sum(signs="+-"))
        d.wire(total.u1, d.input(f"r{k}", default=0.0))
        d.wire(total.u2, getattr(split, f"y{k + 1}"))
        d.wire(getattr(mux, f"u{k + 1}"), total.y)
    d.wire(law.u, mux.y)
    d.wire(plant.u, law.y)
    linearizer = d.linearizer()
    s = 1j * OMEGA[:, None, None]
    P = np.linalg.inv(s * np.eye(2) - A) @ B
    closed = np.moveaxis(np.linalg.solve(np.eye(2) + P @ K, P @ K), 0, -1)
    both = linearizer.model(["r0", "r1"], "plant.y")
    assert both.output_labels == ["plant_y[0]", "plant_y[1]"]
    assert at(both) == pytest.approx(closed, rel=1e-11)
    assert at(linearizer.model("r1", "plant.y[0]"))[0, 0] == pytest.approx(closed[0, 1], rel=1e-11)
    opened = np.moveaxis(P, 0, -1)
    assert at(linearizer.model("law.y", "plant.y", openings="law.y")) == pytest.approx(opened, rel=1e-11)
    assert at(linearizer.model("plant.u[1]", "plant.y", openings="law.y"))[:, 0] == pytest.approx(
        opened[:, 1], rel=1e-11
    )
    # The return difference of both loops at once: S = (1 + K P)^-1 at the plant's input.
    S = np.moveaxis(np.linalg.inv(np.eye(2) + K @ P), 0, -1)
    assert at(linearizer.model("law.y", "law.y")) == pytest.approx(S, rel=1e-11)
    # One loop cut at one element, the other closed.
    inner = linearizer.loop("law.y[0]")
    (a, b), (c, e) = np.moveaxis(K @ P, 0, -1)
    assert at(inner)[0, 0] == pytest.approx(a - b * c / (1 + e), rel=1e-11)
    # Both at once: S is that of the model.
    assert at(linearizer.sensitivity("law.y")) == pytest.approx(S, rel=1e-11)
    assert at(linearizer.loop("law.y")) == pytest.approx(np.moveaxis(K @ P, 0, -1), rel=1e-11)
    with pytest.raises(UsageError, match=r"E501 mux\.u1: is the input of a block that only passes the signal on"):
        linearizer.model("mux.u1", "plant.y")
    interconnected = control.feedback(control.ss(A, B @ K, np.eye(2), np.zeros((2, 2))), np.eye(2))
    assert control.frequency_response(interconnected, OMEGA).frdata == pytest.approx(closed, rel=1e-9)


def test_a_response_is_that_of_the_model() -> None:
    linearizer = analysis("leso_pd")
    ends = ["r", "tau"], ["motor.omega", "control.u"]
    assert linearizer.response(*ends, OMEGA) == pytest.approx(at(linearizer.model(*ends)), rel=1e-11)
    A, B, C, D = (matrix.toarray() for matrix in linearizer.sparse(*ends))
    dense = linearizer.model(*ends)
    for ours, theirs in zip((A, B, C, D), (dense.A, dense.B, dense.C, dense.D), strict=True):
        assert np.array_equal(ours, theirs)


def test_a_model_tells_its_signals_units_and_blocks() -> None:
    model = analysis("leso_pd").model(["r", "tau"], ["motor.omega", "eso.z3"])
    assert isinstance(model, control.StateSpace)
    assert model.dt == 0
    assert (model.input_labels, model.output_labels) == (["r", "tau"], ["motor_omega", "eso_z3"])
    assert model.signals == (("r", "tau"), ("motor.omega", "eso.z3"))
    assert model.units == (("rad/s", "N.m"), ("rad/s", "rad/s3"))
    assert {row.path: (row.method, row.smoothness, row.contributes) for row in model.report} == dict.fromkeys(
        ("control.law", "control.drive", "voltage", "motor", "sensor", "eso"), ("exact", "smooth", True)
    )
    assert {row.path: row.type for row in model.report}["motor"] == "PMDCMotor"
    alone = analysis("leso_pd").model("eso.u", "eso.z3", openings=["eso.y", "eso.u"])
    assert [row.path for row in alone.report if row.contributes] == ["eso"]
    closed = analysis("leso_pd").loop("control.u").closed()
    assert at(closed) == pytest.approx(at(analysis("leso_pd").complementary("control.u")), rel=1e-10)


def test_names_that_python_control_takes_for_one_stay_apart() -> None:
    d = Diagram("names")
    d.wire(d.add("a", Gain(k=2.0)).u, d.input("a_y", default=0.0))
    model = d.linearize("a_y", ["a_y", "a.y"])
    assert model.output_labels == ["a_y", "a_y_2"]
    assert pytest.approx(np.array([[1.0], [2.0]])) == model.D


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("u", "b.z"), r'E501 "b\.z": there is no such signal\. Did you mean .*b\.y'),
        (("ghost", "b.y"), r'E501 "ghost": there is no such signal\. Signals: u, b\.y, b\.u\.'),
        (("u", ["b.y", "b.y"]), r"E501 b\.y: appears twice among the outputs\."),
        ((["u", "u"], "b.y"), r"E501 u: appears twice among the inputs\."),
        (([], "b.y"), r"E501 u: must name a signal\. Example"),
        (("u", []), r"E501 y: must name a signal\. Example"),
        (("u[3]", "b.y"), r'E501 "u\[3\]": there is no such signal'),
    ],
)
def test_what_cannot_be_meant_is_refused(arguments: tuple[Any, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        alone(Gain(k=2.0)).linearize(*arguments)


def test_an_opening_of_no_signal_is_refused() -> None:
    with pytest.raises(UsageError, match="E501"):
        alone(Gain()).linearize("u", "b.y", openings="c.y")
    # An input that is not wired is a place like others.
    d = Diagram("motor")
    d.wire(d.add("m", PMDCMotor()).v, d.input("v", default=0.0))
    assert pytest.approx(motor_matrices()[1][:, 1:], rel=ROUNDING) == d.linearize("m.tau", "m.omega").B


# --- every block of the library ---------------------------------------------------------------------------------------


class Numbers:
    """A block alone by its own Python functions on numbers: (x, u) -> (dx/dt, y), around a point of its diagram.

    Discretes are those of the point; sides follow from the crossings.
    """

    def __init__(self, name: str, given: Mapping[str, Any], point: Point) -> None:
        made = resolved(name, dict(given))
        self.interface, self.declaration = made.interface, made.interface.declaration
        interface, d = self.interface, self.declaration
        self.values: dict[str, Any] = {"t": point.t, "tick": 0}
        self.values |= {key: made.values[key].value for key in (*interface.symbolic_parameters, *interface.tables)}
        plan = point.plan
        for key in d.discretes:
            places = [k for k, known in enumerate(plan.discretes) if known.partition("[")[0] == f"b.{key}"]
            self.values[key] = np.array([point.memory[2][k] for k in places]).reshape(interface.shape(d.discretes[key]))
        self.values |= {key: np.zeros(interface.shape(d.outputs[key])) for key in d.outputs}
        self.reads_outputs = any(argument.kind == "output" for argument in _read(trace(interface)))
        self.sides = dict.fromkeys(d.crossings, False)
        self.moved = False  # whether a side changed on the way

    def at(self, x: Array, u: Array) -> tuple[Array, Array]:
        interface, d = self.interface, self.declaration
        values, first = {**self.values}, 0
        for variables, numbers in ((d.states, x), (d.inputs, u)):
            first = 0
            for key, variable in variables.items():
                size = int(np.prod(interface.shape(variable)))
                values[key] = np.asarray(numbers[first : first + size]).reshape(interface.shape(variable))
                first += size
        with np.errstate(all="ignore"):
            for _ in range(2 if self.reads_outputs else 1):
                made = numeric(interface, {**values, **self.sides})
                sides = {key: bool(made[f"crossing:{key}"][0] >= 0) for key in d.crossings}
                if sides != self.sides:
                    self.moved, self.sides = True, sides
                    made = numeric(interface, {**values, **sides})
                outputs = {key: made[f"output:{key}"] for key in d.outputs if f"output:{key}" in made}
                values |= {key: item.reshape(interface.shape(d.outputs[key])) for key, item in outputs.items()}
        rates = [made[f"derivative:{key}"] for key in d.states]
        seen = [made[f"output:{port.variable}"][port.first : port.first + port.size] for port in self.ports()]
        return tuple(np.concatenate([np.empty(0), *rows]) for rows in (rates, seen))  # type: ignore[return-value]

    def ports(self) -> list[Any]:
        outputs = self.declaration.outputs
        return [p for p in self.interface.outputs.values() if p.variable in outputs and not outputs[p.variable].wiring]

    def matrix(self, x: Array, u: Array, share: float) -> Array:
        """[A B; C D] by central differences of order 4."""
        self.at(x, u)
        self.moved, columns = False, []
        whole = np.concatenate([x, u])
        for j in range(len(whole)):
            h = share * max(1.0, abs(whole[j]))

            def change(factor: float, j: int = j, h: float = h) -> Array:
                sides = []
                for sign in (1.0, -1.0):
                    moved = whole.copy()
                    moved[j] += sign * factor * h
                    sides.append(np.concatenate(self.at(moved[: len(x)], moved[len(x) :])))
                return np.asarray(sides[0] - sides[1])

            columns.append((8.0 * change(1.0) - change(2.0)) / (12.0 * h))
        return np.array(columns).T.reshape(-1, len(whole))


def _read(tape: Any) -> list[Any]:
    return [tape.arguments[k] for rows in tape.read_by.values() for row in rows for k in row]


def is_continuous(plan: Any) -> bool:
    return not (plan.rates or plan.histories or plan.projections or plan.steppers)


@pytest.mark.parametrize(
    ("name", "given"), VARIANTS, ids=[f"{name}-{'-'.join(map(str, given)) or 'plain'}" for name, given in VARIANTS]
)
def test_every_block_has_the_model_that_its_functions_give(name: str, given: dict[str, Any]) -> None:
    """A, B, C and D at random points, where differences over two steps agree that the block is smooth there."""
    inside = {"u": 0.5} if given.get("function") in ("asin", "acos", "atanh") else {}
    begin = alone(LIBRARY[name](**given), **inside).point()
    plan = begin.plan
    types = [kind for _, shape, _, kind, _ in plan.inputs for _ in range(math.prod(shape))]
    inputs = [given_ for given_, _, _, kind, _ in plan.inputs if kind == "real"]
    witness = Numbers(name, given, begin)
    ports = [port for port in witness.ports() if port.type == "real"]
    if not is_continuous(plan) or not inputs or not ports:
        return
    random = np.random.default_rng(list(name.encode()))
    real = np.array([kind == "real" for kind in types], dtype=bool)
    smooth = 0
    for number in range(4):
        low, high = ((0.15, 0.85), (1.15, 1.85))[number % 2]  # laws of sines, and of what is above 1
        x = random.uniform(low, high, len(plan.states))
        u = np.where(real, random.uniform(low, high, len(types)), 1.0)
        point = begin.moved(x=x.tolist(), u=u.tolist())
        witness = Numbers(name, given, point)
        coarse, fine_ = witness.matrix(x, u, 4e-4), witness.matrix(x, u, 2e-4)
        allowed = 1e-6 * np.abs(fine_) + 1e-9
        if witness.moved or not np.all(np.abs(coarse - fine_) <= allowed):  # a corner nearby, or outside of a law
            continue
        smooth += 1
        slopes = slopes_at(point)
        names = [f"b.{port.name}" for port in ports]
        model = Linearizer(slopes).model(inputs, names)
        n = len(plan.states)
        keep = np.concatenate([np.ones(n, dtype=bool), real])
        rows = np.concatenate([np.full(port.size, port.type == "real") for port in witness.ports()])
        A, B = fine_[:n, :n], fine_[:n, n:][:, real]
        C, D = fine_[n:, :n][rows], fine_[n:, n:][np.ix_(rows, real)]
        assert keep.sum() == n + model.ninputs
        own = [plan.states.index(label.replace("b_", "b.", 1)) for label in model.state_labels]
        for ours, theirs in (
            (model.A, A[np.ix_(own, own)]), (model.B, B[own]), (model.C, C[:, own]), (model.D, D),
        ):  # fmt: skip
            assert np.asarray(ours) == pytest.approx(theirs, rel=2e-6, abs=1e-8)
        for s in (0.7 + 1.3j, 2.0 - 5.0j):  # states that are left out change nothing
            whole = C @ np.linalg.solve(s * np.eye(n) - A, B) + D if n else D
            assert np.asarray(model(s)).reshape(whole.shape) == pytest.approx(whole, rel=1e-5, abs=1e-7)
        assert slopes.laws == []
    assert smooth >= 2


def test_the_pendulum_upright_and_hanging_is_that_of_its_equations() -> None:
    """The linear model of the tutorial, with and without friction, at both places of rest."""
    M, m, l, I, b, g = 0.5, 0.2, 0.3, 0.006, 0.1, 9.81
    q = (M + m) * (I + m * l**2) - (m * l) ** 2
    for theta, sign in ((0.0, 1.0), (math.pi, -1.0)):
        A = np.array(
            [
                [0, 1, 0, 0],
                [0, -(I + m * l**2) * b / q, -(m**2) * g * l**2 / q, 0],
                [0, 0, 0, 1],
                [0, sign * m * l * b / q, sign * m * g * l * (M + m) / q, 0],
            ]
        )
        B = np.array([[0], [(I + m * l**2) / q], [0], [-sign * m * l / q]])
        point = alone(InvertedPendulum(), F=0.0).point().moved(x=[0.0, 0.0, theta, 0.0])
        model = Linearizer(slopes_at(point)).model("F", ["b.x", "b.v", "b.theta", "b.omega"])
        assert pytest.approx(A, rel=1e-12, abs=1e-14) == model.A
        assert pytest.approx(B, rel=1e-12) == model.B
        assert np.array_equal(model.C, np.eye(4))


@pytest.mark.parametrize(
    ("block", "x", "u"),
    [
        (InvertedPendulum(d=0.02), [0.1, 0.4, 0.7, -1.3], [2.0]),
        (QuarterCar(), [0.05, 0.3, 0.01, -0.2], [0.02, 100.0]),
    ],
    ids=["pendulum", "car"],
)
def test_plants_are_what_python_control_finds_with_a_good_step(block: Block, x: list[float], u: list[float]) -> None:
    point = alone(block).point().moved(x=x, u=u)
    numbers = Numbers(type(block).__name__, block.parameters, point)
    inputs = [given for given, *_ in point.plan.inputs]
    outputs = [*point.plan.states, *(f"b.{port.name}" for port in numbers.ports())]
    ours = Linearizer(slopes_at(point)).model(inputs, outputs)
    system = control.NonlinearIOSystem(
        lambda t, x, u, params: numbers.at(np.asarray(x), np.atleast_1d(u))[0],
        lambda t, x, u, params: np.concatenate([x, numbers.at(np.asarray(x), np.atleast_1d(u))[1]]),
        states=len(x), inputs=len(u), outputs=len(outputs),
    )  # fmt: skip
    theirs = control.linearize(system, x, u, eps=1e-7)
    size = np.max(np.abs(theirs.D), initial=np.max(np.abs(theirs.C)))
    for one, other in ((ours.A, theirs.A), (ours.B, theirs.B), (ours.C, theirs.C), (ours.D, theirs.D)):
        assert one == pytest.approx(other, rel=1e-5, abs=1e-7 * max(size, 10.0))  # one-sided differences


# --- exact where differences are not ----------------------------------------------------------------------------------


def test_slopes_are_exact_where_those_of_python_control_are_17_percent_off() -> None:
    """g of the SMESO at |e| = 1e-6, over which python-control steps at once."""
    e = -1e-6
    Ka, alpha, Kb, beta = 0.6265, 0.8433, 0.5878, 0.04078

    def g(e: float) -> float:
        return math.copysign(Ka * abs(e) ** alpha + Kb * abs(e) ** (1 + beta), e)

    exact = Ka * alpha * abs(e) ** (alpha - 1) + Kb * (1 + beta) * abs(e) ** beta
    d = alone(SMESO(), y=e, u=0.0)
    ours = d.linearize("b.e", "b.g").D[0, 0]
    assert ours == pytest.approx(exact, rel=1e-13)
    system = control.NonlinearIOSystem(None, lambda t, x, u, params: g(float(np.squeeze(u))), inputs=1, outputs=1)
    theirs = float(control.linearize(system, [], [e]).D[0, 0])
    assert theirs / exact - 1 == pytest.approx(0.17, abs=0.005)
    # At the point itself there is a slope of no use to anybody: it depends on the step.
    for step, slope in ((1e-3, 2.29), (1e-6, 5.79), (1e-9, 16.4)):
        assert float(control.linearize(system, [], [0.0], eps=step).D[0, 0]) == pytest.approx(slope, rel=3e-3)


def test_the_feedback_of_the_paper_has_a_finite_slope_up_to_errors_of_a_million() -> None:
    """1/(1 + exp(mu e^2)) overflows in exp from |e| = 4 on; the slope there is that of the power alone."""
    k1, k2, mu, alpha, delta = 144.6642, 8.0475, 44.3160, 0.9675, 3.8831
    for size in np.geomspace(1e-6, 1e6, 13):
        for e in (size, -size):
            d = alone(INLSEF(), r1=float(e), r2=0.0, z1=0.0, z2=0.0, z3=0.0)
            linearizer = d.linearizer()
            slope = linearizer.model("b.e[0]", "b.law[0]").D[0, 0]
            bell, square = 0.5 * (1 - math.tanh(0.5 * mu * e * e)), math.tanh(0.5 * mu * e * e) ** 2
            known = (k1 + k2 * bell) * alpha * size ** (alpha - 1)
            known += k2 * size**alpha * -0.5 * (1 - square) * mu * size
            assert slope == pytest.approx(known, rel=1e-9, abs=1e-300)
            whole = float(linearizer.model("r1", "b.u").D[0, 0])
            v = (k1 + k2 * bell) * size**alpha
            assert math.isfinite(whole)
            assert whole == pytest.approx(known / math.cosh(min(v / delta, 300.0)) ** 2, rel=1e-6, abs=1e-12)


# --- places without a linear model ------------------------------------------------------------------------------------

POINTS, VALUES = [-1.0, 0.0, 1.0, 2.0], [-3.0, 0.0, 1.0, 4.0]


class Between(Block):
    """y = u in four parts whose sides are crossings: all four are the same line."""

    u = Input()

    @crossing
    def above(u):  # type: ignore[no-untyped-def]
        return u - 1.0

    @output
    def y(u, above):  # type: ignore[no-untyped-def]
        return np.where(above, 2.0 * u - u, u)


class Written(Block):
    """Laws with a slope at 0 that the operations they are made of have not."""

    form = Parameter("product", structural=True, choices=("product", "parts", "square", "cubic", "where", "steep"))
    u = Input()

    @output
    def y(u, form):  # type: ignore[no-untyped-def]
        if form == "product":
            return np.abs(u) * np.sign(u)  # u
        if form == "parts":
            return np.maximum(u, 0.0) + np.minimum(u, 0.0)  # u
        if form == "square":
            return u * np.abs(u) + 3.0 * u  # 3 u and a square with a sign
        if form == "cubic":
            return np.abs(u) ** 3 + np.abs(u) ** 1.5  # both flat at 0
        if form == "where":
            return np.where(u == 0.0, 0.0, np.tanh(u))  # tanh u
        return np.where(u == 0.0, 0.0, np.abs(u) ** 0.5 * np.sign(u))


ROUGH: list[tuple[Block, dict[str, float], str]] = [
    (SMESO(), {"y": 0.0}, "infinite slope"),
    (Power(form="signed", exponent=0.5), {"u": 0.0}, "infinite slope"),
    (Power(form="signed", exponent=0.999), {"u": 0.0}, "infinite slope"),
    (Sqrt(), {"u": 0.0}, "infinite slope"),
    (Written(form="steep"), {"u": 0.0}, "infinite slope"),
    (Abs(), {"u": 0.0}, "corner"),
    (Saturation(), {"u": 1.0}, "corner"),
    (Saturation(), {"u": -1.0}, "corner"),
    (Saturation(corners="clipped"), {"u": 1.0}, "corner"),
    (DeadZone(), {"u": 1.0}, "corner"),
    (MinMax(), {"u1": 2.0, "u2": 2.0}, "corner"),
    (Expression(expression="abs(u1 - u2)"), {"u1": 3.0, "u2": 3.0}, "corner"),
    (LookupTable(points=POINTS, values=VALUES), {"u": 1.0}, "corner"),
    (LookupTable(points=POINTS, values=VALUES), {"u": 2.0}, "corner"),
    (LookupTable(points=POINTS, values=VALUES, interpolation="hold"), {"u": 1.0}, "jump"),
    (Sign(), {"u": 0.0}, "jump"),
    (Quantizer(), {"u": 0.5}, "jump"),
    (Quantizer(), {"u": -1.5}, "jump"),
    (SwitchAbove(), {"u1": 1.0, "u2": 2.0, "control": 0.0}, "jump"),
]
WORDS = {"infinite slope": "has an infinite slope", "corner": "has a corner", "jump": "jumps"}


@pytest.mark.parametrize(("block", "values", "kind"), ROUGH, ids=[f"{type(b).__name__}-{v}" for b, v, _ in ROUGH])
def test_where_a_law_has_no_slope_there_is_an_error_and_its_cure_helps(
    block: Block, values: dict[str, float], kind: str
) -> None:
    d = alone(block, **values)
    slopes = slopes_at(d.point())
    assert {law.kind for law in slopes.laws} == {kind}
    law = slopes.laws[-1]
    name = d.linearizer().graph.slot_name(law.slot)
    given = "b.control" if isinstance(block, SwitchAbove) else name
    seen = "b.g" if isinstance(block, SMESO) else f"b.{law.equation}"
    with pytest.raises(AnalysisError) as caught:
        d.linearize(given if "." in given else "u", seen)
    (fault,) = caught.value.faults
    assert (fault.code, fault.place) == ("E701", seen)
    assert WORDS[kind] in fault.message
    assert f'amplitude={{"{given}"' in fault.cure
    first = next(iter(values))  # within rounding of the place it is the same
    with pytest.raises(AnalysisError, match="E701"):
        alone(block, **{**values, first: values[first] * (1 + 1e-12)}).linearize(given, seen)
    several = isinstance(block, (MinMax, Expression, SwitchAbove))
    if several:  # of no one signal
        with pytest.raises(AnalysisError, match="E704"):
            d.linearize(given, seen, amplitude={given: 0.3})
    elif not isinstance(block, Sqrt):  # which is no number below 0
        model = d.linearize(given, seen, amplitude={given: 0.7})
        assert model.D[0, 0] > 0 or isinstance(block, Abs)
        assert next(row.method for row in model.report if row.path == "b").endswith(", A = 0.7")


SMOOTH: list[tuple[Block, dict[str, float], str, float]] = [
    (Saturation(), {"u": 0.3}, "u", 1.0),
    (Saturation(), {"u": 1.001}, "u", 0.0),
    (Saturation(corners="clipped"), {"u": -0.999}, "u", 1.0),
    (DeadZone(), {"u": 0.0}, "u", 0.0),
    (DeadZone(), {"u": -2.0}, "u", 1.0),
    (Product(), {"u1": 0.0, "u2": 0.0}, "u1", 0.0),
    (Product(), {"u1": 0.0, "u2": 3.0}, "u1", 3.0),
    (Divide(), {"u1": 0.0, "u2": 2.0}, "u2", 0.0),
    (Power(form="signed", exponent=1.5), {"u": 0.0}, "u", 0.0),
    (Power(form="signed", exponent=1.04078), {"u": 0.0}, "u", 0.0),
    (Power(exponent=2.0), {"u": 0.0}, "u", 0.0),
    (Power(form="signed", exponent=2.0), {"u": 0.0}, "u", 0.0),
    (Power(exponent=3.0), {"u": 0.0}, "u", 0.0),
    (Power(exponent=1.0), {"u": 0.0}, "u", 1.0),
    (LookupTable(points=POINTS, values=VALUES), {"u": 0.5}, "u", 1.0),
    (LookupTable(points=POINTS, values=VALUES), {"u": 1.5}, "u", 3.0),
    (LookupTable(points=POINTS, values=VALUES), {"u": 7.0}, "u", 0.0),
    (LookupTable(points=POINTS, values=VALUES, beyond="linear"), {"u": 2.0}, "u", 3.0),
    (LookupTable(points=[0.0, 1.0, 2.0], values=[0.0, 5.0, 10.0]), {"u": 1.0}, "u", 5.0),
    (LookupTable(points=POINTS, values=VALUES, interpolation="hold"), {"u": 0.5}, "u", 0.0),
    (Quantizer(), {"u": 0.2}, "u", 0.0),
    (Relay(), {"u": 0.0}, "u", 0.0),
    (Sign(), {"u": 1e-3}, "u", 0.0),
    (Abs(), {"u": -1e-3}, "u", -1.0),
    (MinMax(function="max"), {"u1": 1.0, "u2": 2.0}, "u1", 0.0),
    (SwitchAbove(), {"u1": 1.0, "u2": 2.0, "control": 0.1}, "u1", 1.0),
    (SwitchAbove(), {"u1": 1.0, "u2": 2.0, "control": 0.1}, "control", 0.0),
    (SwitchAbove(), {"u1": 2.0, "u2": 2.0, "control": 0.1}, "control", 0.0),
    (Expression(expression="u1**2*abs(u1)"), {"u1": 0.0}, "u1", 0.0),
    (Between(), {"u": 1.0}, "u", 1.0),
    (Written(form="product"), {"u": 0.0}, "u", 1.0),
    (Written(form="parts"), {"u": 0.0}, "u", 1.0),
    (Written(form="square"), {"u": 0.0}, "u", 3.0),
    (Written(form="cubic"), {"u": 0.0}, "u", 0.0),
    (Written(form="where"), {"u": 0.0}, "u", 1.0),
]


@pytest.mark.parametrize(
    ("block", "values", "by", "slope"), SMOOTH, ids=[f"{type(b).__name__}-{v}-{by}" for b, v, by, _ in SMOOTH]
)
def test_where_a_law_has_a_slope_there_is_no_false_alarm(
    block: Block, values: dict[str, float], by: str, slope: float
) -> None:
    assert gain(alone(block, **values), by) == pytest.approx(slope, rel=1e-6, abs=1e-4)


def test_no_false_alarm_in_trackers_feedbacks_and_limited_controllers() -> None:
    tracker = alone(TrackingDifferentiator(R=100.0, h=1e-3), r=0.0).linearize("r", "b.r1")
    assert poles(tracker) == pytest.approx(np.array([-1000.0, -1000.0]), rel=1e-6)  # fhan near its aim
    pid = alone(PID(kp=2.0, ki=3.0, lower=-1.0, upper=1.0), r=0.0, y=0.0, manual=0.0)
    assert at(pid.linearize("r", "b.u"))[0, 0] == pytest.approx(2.0 + 3.0 / (1j * OMEGA), rel=1e-9)
    feedback = alone(NLSEF(), r1=0.1, r2=0.0, z1=0.0, z2=0.0, z3=0.0)
    assert gain(feedback, "r1", "b.u") == pytest.approx(0.4620 ** (0.1726 - 1.0), rel=1e-12)
    bound = alone(LimitedIntegrator(lower=-1.0, upper=1.0), u=0.3)
    assert bound.linearize("u", "b.y").B[0, 0] == 1.0
    stuck = alone(LimitedIntegrator(lower=-1.0, upper=1.0, y_start=1.0), u=0.3)
    assert dc_gain(stuck.linearize("u", "b.y"))[0, 0] == 0.0  # pressed against its limit, it does not move


def test_a_law_near_its_corner_within_rounding_of_its_signals_is_at_it() -> None:
    """A loop at rest: e = r - y is 1e-10 where r and y are 1, which only rounding tells from 0."""
    for gap, is_rough in ((1e-10, True), (1e-7, True), (1e-4, False)):
        d = Diagram("near")
        total, law = d.add("total", Sum(signs="+-")), d.add("law", Power(form="signed", exponent=0.5))
        d.wire(total.u1, d.input("r", default=1.0 + gap))
        d.wire(total.u2, d.input("y", default=1.0))
        d.wire(law.u, total.y)
        assert bool(slopes_at(d.point()).laws) == is_rough
        if not is_rough:
            assert gain(d, "r", "law.y") == pytest.approx(0.5 * (d.point().outputs[0]) ** -0.5, rel=1e-9)


def test_the_diagram_of_the_paper_has_no_linear_model_at_rest_and_one_with_an_amplitude() -> None:
    d = Diagram.load(DIAGRAMS / "paper" / "iadrc.json")
    with pytest.raises(AnalysisError) as caught:
        d.linearize("motor_right.v", "motor_right.omega")
    told = {fault.place: fault for fault in caught.value.faults}
    assert {fault.code for fault in told.values()} == {"E701"}
    assert "control_right.eso.g" in told
    assert "has an infinite slope at e = 0" in told["control_right.eso.g"].message
    assert 'amplitude={"control_right.eso.e": A}' in told["control_right.eso.g"].cure
    works = {name: 0.1 for side in ("left", "right") for name in (f"control_{side}.eso.e", f"control_{side}.nlsef.e")}
    model = d.linearize("motor_right.v", "motor_right.omega", amplitude=works)
    assert np.isfinite(model.A).all()
    assert {row.path: row.method for row in model.report}["control_right.eso"].startswith(
        "describing function of e, A = 0.1"
    )
    # What does not pass through the law is known without.
    alone_ = d.linearize("motor_right.v", "motor_right.omega", openings="motor_right.v")
    assert at(alone_)[0, 0] == pytest.approx(plant(1j * OMEGA), rel=1e-9)
    # Near rest in a run the error is within rounding of 0, or the exact slope is there.
    d.linearize("motor_right.v", "motor_right.omega", at=0.5)


class Cancelling(Block):
    """y = a u - b u and a step of the given size at 0."""

    a = Parameter(0.3)
    size = Parameter(0.0)
    u = Input()

    @output
    def y(u, a, size):
        return a * u - (u * 3.0) * (a / 3.0) + np.where(u > 0.0, size, 0.0)


def test_what_rounding_leaves_of_a_sum_is_no_jump_and_a_small_jump_is_one() -> None:
    """Differences of u = 1e-9 and -1e-9 are roundings of 1e-25 and less: a jump of 1e-20 is none of them."""
    for a in np.linspace(0.1, 7.0, 70).tolist():
        assert Diagram.alone(Cancelling(a=a)).linearize("u", "y").D[0, 0] == 0.0, a
        with pytest.raises(AnalysisError, match=r"E701 Cancelling\.y: jumps at u = 0"):
            Diagram.alone(Cancelling(a=a, size=1e-20)).linearize("u", "y")


def test_jumps_are_seen_through_whole_numbers() -> None:
    """A comparison at its threshold turns a switch, though neither has a slope."""
    for u, is_rough in ((1.0, True), (1.2, False)):
        d = Diagram("switched")
        u_ = d.input("u", default=u)
        compare, switch = d.add("compare", CompareToConstant(constant=1.0)), d.add("switch", Switch())
        d.wire(compare.u, u_)
        d.wire(switch.control, compare.y)
        d.wire(switch.u1, d.input("a", default=5.0))
        d.wire(switch.u2, d.input("b", default=7.0))
        if is_rough:
            with pytest.raises(AnalysisError, match=r"E701 compare\.y: jumps at u = 1"):
                d.linearize("u", "switch.y")
            assert gain(d, "a", "switch.y") == 1.0  # it stays where it is while u does
        else:
            assert gain(d, "u", "switch.y") == 0.0
    for port in ("u1", "u2"):  # either of them may move
        other = {"u1": "u2", "u2": "u1"}[port]
        d = Diagram("compared")
        compare, switch = d.add("compare", Compare()), d.add("switch", Switch())
        d.wire(f"compare.{port}", d.input("u", default=2.0))
        d.wire(f"compare.{other}", d.add("two", Constant(value=2.0)).y)
        d.wire(switch.control, compare.y)
        d.wire(switch.u1, "u")
        d.wire(switch.u2, d.add("three", Constant(value=3.0)).y)
        with pytest.raises(AnalysisError, match=rf"E701 compare\.y: jumps at {port} = 2"):
            d.linearize("u", "switch.y")


def test_a_law_that_does_not_contribute_is_no_trouble() -> None:
    d = alone(SMESO(), y=0.0)
    d.wire(d.add("g", Gain(k=3.0)).u, "u")
    assert gain(d, "u", "g.y") == 3.0
    assert at(d.linearize("u", "b.z1", openings="b.e"))[0, 0] == pytest.approx(B0 / (1j * OMEGA) ** 2, rel=1e-12)
    report = {row.path: row for row in d.linearize("u", "g.y").report}
    assert report["b"].smoothness == "infinite slope of g by e"
    assert not report["b"].contributes


# --- describing functions ---------------------------------------------------------------------------------------------


def power_gain(a: float, A: float) -> float:
    return 2 / math.sqrt(math.pi) * math.gamma(a / 2 + 1) / math.gamma(a / 2 + 1.5) * A ** (a - 1)


def random_power_gain(a: float, s: float) -> float:
    return 2 ** ((a + 1) / 2) * math.gamma(a / 2 + 1) / math.sqrt(math.pi) * s ** (a - 1)


@pytest.mark.parametrize(
    ("size", "N", "random"),
    [(1e-3, 2.347994160, 2.201970321), (1e-2, 1.813412572, 1.715706885), (0.1, 1.458138387, 1.394518192),
     (1.0, 1.229572531, 1.190155758)],
)  # fmt: skip
def test_the_law_of_the_observer_at_an_amplitude(size: float, N: float, random: float) -> None:
    d = Diagram.load(DIAGRAMS / "analysis" / "smeso_pd.json")
    made = d.linearize("eso.e", "eso.g", amplitude={"eso.e": size}, openings="eso.g").D[0, 0]
    assert made == pytest.approx(N, rel=DIGITS)
    assert made == pytest.approx(0.6265 * power_gain(0.8433, size) + 0.5878 * power_gain(1.04078, size), rel=1e-10)
    noisy = d.linearize("eso.e", "eso.g", sigma={"eso.e": size}, openings="eso.g").D[0, 0]
    assert noisy == pytest.approx(random, rel=DIGITS)
    known = 0.6265 * random_power_gain(0.8433, size) + 0.5878 * random_power_gain(1.04078, size)
    assert noisy == pytest.approx(known, rel=1e-10)
    # In the observer it takes the place of 1 before all gains.
    observer = d.linearize("eso.u", "eso.z3", amplitude={"eso.e": size}, openings=["eso.y", "eso.u"])
    roots = np.roots([1.0, 30.4 * N, 513.4 * N, 1570.8 * N])
    assert np.sort_complex(poles(observer)) == pytest.approx(np.sort_complex(roots), rel=1e-8)


def saturation_gain(A: float) -> float:
    q = min(1.0, 1.0 / A)
    return 2 / math.pi * (math.asin(q) + q * math.sqrt(1 - q * q))


def table(u: float) -> float:
    return float(np.interp(u, POINTS, VALUES))


@pytest.mark.parametrize("A", [0.3, 0.9, 1.7, 40.0])
def test_describing_functions_of_blocks_are_the_closed_forms(A: float) -> None:
    assert gain(alone(Saturation(), u=0.0), amplitude={"b.u": A}) == pytest.approx(saturation_gain(A), rel=1e-10)
    assert gain(alone(DeadZone(), u=0.0), amplitude={"u": A}) == pytest.approx(1 - saturation_gain(A), abs=1e-10)
    assert gain(alone(Sign(), u=0.0), amplitude={"b.u": A}) == pytest.approx(4 / (math.pi * A), rel=1e-10)
    assert gain(alone(Power(form="signed", exponent=0.5), u=0.0), amplitude={"b.u": A}) == pytest.approx(
        power_gain(0.5, A), rel=1e-10
    )
    assert gain(alone(Saturation(), u=0.0), sigma={"b.u": A}) == pytest.approx(
        math.erf(1 / (A * math.sqrt(2))), rel=1e-10
    )
    assert gain(alone(Sign(), u=0.0), sigma={"b.u": A}) == pytest.approx(math.sqrt(2 / math.pi) / A, rel=1e-10)
    levels = [(k + 0.5) for k in range(int(A + 0.5)) if k + 0.5 < A]
    quantized = sum(4 / (math.pi * A) * math.sqrt(1 - (d / A) ** 2) for d in levels)
    assert gain(alone(Quantizer(), u=0.0), amplitude={"b.u": A}) == pytest.approx(quantized, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("bias", [0.0, 0.7])
def test_a_table_has_the_describing_function_that_quadrature_gives(bias: float) -> None:
    def held(u: float) -> float:
        return VALUES[max(0, int(np.searchsorted(POINTS, u, side="right")) - 1)]

    def by_hand(law: Callable[[float], float], A: float) -> float:
        breaks = sorted(math.asin((p - bias) / A) for p in POINTS if abs(p - bias) < A)
        edges = pairwise([-math.pi / 2, *breaks, math.pi / 2])
        return 2 / (math.pi * A) * sum(quad(lambda x: law(bias + A * math.sin(x)) * math.sin(x), *e)[0] for e in edges)

    for kind, law in (("linear", table), ("hold", held)):
        d = alone(LookupTable(points=POINTS, values=VALUES, interpolation=kind), u=bias)
        for A in (0.5, 1.5, 3.0):
            assert gain(d, amplitude={"b.u": A}) == pytest.approx(by_hand(law, A), rel=1e-9)


def test_a_vector_of_laws_takes_one_amplitude_or_one_for_each() -> None:
    d = alone(INLSEF(), r1=0.0, r2=0.0, z1=0.0, z2=0.0, z3=0.0)
    k1, k2, mu, alpha = (144.6642, 25.5574), (8.0475, 4.8814), (44.3160, 48.8179), (0.9675, 1.4487)

    def by_hand(n: int, A: float) -> float:
        def law(x: float) -> float:
            e = A * math.sin(x)
            return (k1[n] + k2[n] * 0.5 * (1 - math.tanh(0.5 * mu[n] * e * e))) * e ** alpha[n] * math.sin(x)

        return 4 / (math.pi * A) * float(quad(law, 0, math.pi / 2, epsabs=1e-13, epsrel=1e-13)[0])

    both = d.linearizer(amplitude={"b.e": 0.2})
    each = d.linearizer(amplitude={"b.e": [0.2, 3.0]})
    assert both.model("b.e[1]", "b.law[1]").D[0, 0] == pytest.approx(by_hand(1, 0.2), rel=1e-9)
    assert each.model("b.e[0]", "b.law[0]").D[0, 0] == pytest.approx(by_hand(0, 0.2), rel=1e-9)
    assert each.model("b.e[1]", "b.law[1]").D[0, 0] == pytest.approx(by_hand(1, 3.0), rel=1e-9)
    for made, names in ((d.linearizer(amplitude={"b.e[0]": 0.2}), {"b.e[0]"}), (both, {"b.e[0]", "b.e[1]"})):
        described = {made.graph.slot_name(slot) for _, slot in made.described}
        assert described == names


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"b.e": 0.0}, r"E501 amplitude of b\.e: must be above 0, not 0\.0\."),
        ({"b.e": -1.0}, r"E501 amplitude of b\.e: must be above 0, not -1\.0\."),
        ({"b.e": math.nan}, r"E501 amplitude of b\.e: must be above 0, not nan\."),
        ({"b.e": math.inf}, r"E501 amplitude of b\.e: must be above 0, not inf\."),
        ({"b.e": [1.0, 2.0]}, r"E501 amplitude of b\.e: \[1\.0, 2\.0\] is neither a number nor 1 numbers\."),
        ({"b.e": "large"}, r"E501 amplitude of b\.e: large is neither a number nor 1 numbers\."),
        ({"b.u": 1.0}, r"E501 amplitude of b\.u: no nonlinear law reads this signal\. The laws without a slope "
            r".* b\.e\."),
        ({"eso.e": 1.0}, r'E501 "eso\.e": there is no such signal\.'),
    ],
)
def test_amplitudes_that_cannot_be_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        alone(SMESO(), y=0.0).linearize("y", "b.z1", amplitude=given)
    with pytest.raises(UsageError, match=message.replace("amplitude of", "sigma of")):
        alone(SMESO(), y=0.0).linearize("y", "b.z1", sigma=given)


def test_a_relay_with_hysteresis_lags_and_has_no_state_space() -> None:
    with pytest.raises(AnalysisError, match=r"E704 b\.y: lags behind its input: .* Compute its response"):
        alone(Relay(), u=0.0).linearize("u", "b.y", amplitude={"b.u": 2.0})
    assert gain(alone(Relay(on_at=0.0, off_at=0.0), u=0.0), amplitude={"b.u": 2.0}) == pytest.approx(
        2 / math.pi, rel=1e-10
    )


# --- laws that pass nothing on ----------------------------------------------------------------------------------------


def servo(law: Block | None, controller: Block) -> Diagram:
    """c drives 3/(s (s + 1)); y comes back to it, through a law q if there is one."""
    d = Diagram("servo")
    d.add("c", controller)
    d.add("p", TransferFunction(num=[3.0], den=[1.0, 1.0, 0.0]))
    d.wire("p.u", "c.u" if isinstance(controller, DiscretePID) else "c.y")
    read, back = ("c.y", 1.0) if isinstance(controller, DiscretePID) else ("c.u", -1.0)
    if isinstance(controller, DiscretePID):
        d.wire("c.r", d.input("r"))
    d.add("back", Gain(k=back))
    d.wire(read, "back.y")
    if law is None:
        d.wire("back.u", "p.y")
    else:
        d.add("q", law)
        d.wire("q.u", "p.y")
        d.wire("back.u", "q.y")
    return d


CONTROLLERS = {"continuous": FirstOrder(T=0.1), "sampled": DiscretePID(kp=1.0, ki=0.2, period=0.05)}
STEPS = {
    "a quantizer": (Quantizer(interval=0.1), lambda A: quantizer_gain(A / 0.1)),
    "a relay": (Relay(on_at=0.0, off_at=0.0, on=0.5, off=-0.5), lambda A: 4 * 0.5 / (math.pi * A)),
    "a relay off its edge": (Relay(on_at=0.2, off_at=0.2), lambda A: 4 / (math.pi * A) * math.sqrt(1 - (0.2 / A) ** 2)),
    "a relay with hysteresis": (Relay(on_at=0.1, off_at=-0.1), None),
    "a dead zone": (DeadZone(lower=-0.1, upper=0.1), lambda A: 1 - saturation_gain(A / 0.1)),
}


class Rounded(Block, describing="quantizer"):
    """A quantizer that holds its level in another way than that of the library: replaced after each step."""

    interval = Parameter(1.0, positive=True)
    u = Input()
    level = Discrete()

    @level.initial
    def begins(u, interval):
        return np.floor(u / interval + 0.5)

    @level.next(every="step")
    def nearest(u, level, interval):
        return np.where(abs(u / interval - level) > 0.5, np.floor(u / interval + 0.5), level)

    @output
    def y(level, interval):
        return level * interval


def quantizer_gain(A: float) -> float:
    """4/(pi A) sum sqrt(1 - ((2k - 1)/(2A))^2) over the steps of an interval of 1 that A passes."""
    steps = (k - 0.5 for k in range(1, int(A + 0.5) + 1))
    return sum(4 / (math.pi * A) * math.sqrt(1 - (step / A) ** 2) for step in steps)


@pytest.mark.parametrize("which", CONTROLLERS)
@pytest.mark.parametrize("name", STEPS)
def test_a_loop_that_a_law_holds_up_names_the_calls_that_give_its_margins(name: str, which: str) -> None:
    """Each cure is taken from the message: a unit gain makes the loop without the law, and N(A) makes N(A) times it."""
    law, closed_form = STEPS[name]
    d, without = servo(law, CONTROLLERS[which]), servo(None, CONTROLLERS[which]).linearizer().loop("p.u")
    with pytest.raises(AnalysisError, match=r"E70[15] ") as raised:
        margins(d.linearizer().loop("p.u"))
    told = str(raised.value)
    assert "--override q=1" in told
    assert "--amplitude q.u=A" in told
    (override,) = re.findall(r"overrides=(\{.*?\})", told)
    as_unit_gain = d.linearizer(overrides=json.loads(override)).loop("p.u")
    made, known = margins(as_unit_gain).as_json(), margins(without).as_json()
    assert [name for name in made if made[name] is None] == [name for name in known if known[name] is None]
    assert made["stable"] == known["stable"]
    for name in made:
        assert made[name] is None or made[name] == pytest.approx(known[name], rel=1e-7), name
    (amplitude,) = re.findall(r"amplitude=(\{.*?\})", told)
    for A in (0.3, 0.7, 12.3):
        given = json.loads(amplitude.replace("A", str(A)))
        if closed_form is None:
            with pytest.raises(AnalysisError, match=r"E704 q\.y: lags behind its input: .* --override q=1"):
                d.linearizer(amplitude=given)
            continue
        described = d.linearizer(amplitude=given).loop("p.u")
        omega = np.geomspace(0.1, 50.0, 9)
        wanted = closed_form(A) * response(without, omega)
        assert np.allclose(response(described, omega), wanted, rtol=DIGITS), A
        phase = margins(closed_form(A) * control.ss(without)).phase_deg
        assert margins(described).phase_deg == pytest.approx(phase, rel=1e-7)


@pytest.mark.parametrize("A", [0.3, 0.7, 12.3])
def test_a_block_that_says_which_describing_function_it_has_keeps_its_memory_as_it_likes(A: float) -> None:
    without = servo(None, FirstOrder(T=0.1)).linearizer().loop("p.u")
    described = servo(Rounded(interval=0.1), FirstOrder(T=0.1)).linearizer(amplitude={"q.u": A}).loop("p.u")
    omega = np.geomspace(0.1, 50.0, 9)
    assert np.allclose(response(described, omega), quantizer_gain(A / 0.1) * response(without, omega), rtol=DIGITS)


def test_what_stands_in_the_way_is_told_with_the_model_too() -> None:
    d = servo(Quantizer(interval=0.1), CONTROLLERS["sampled"])
    model = d.linearize("p.u", "q.y")
    assert not model.D.any()
    assert model.hint.startswith("q.y passes nothing on at its operating point: use a gain in its place")
    (note,) = [block.note for block in model.report if block.path == "q"]
    assert note == "passes nothing on at its operating point, u = 0"
    with pytest.raises(AnalysisError, match=r"E705 bandwidth: .* --override q=1"):
        bandwidth(model)
    assert d.linearize("p.u", "p.y").hint == ""
    # What passes no law has nothing to be told, and at an amplitude that passes no step there is another cure.
    assert d.linearizer().loop("r").hint == ""
    small = d.linearizer(amplitude={"q.u": 0.04}).loop("p.u")
    with pytest.raises(AnalysisError, match=r"The gain of q\.y is 0 at the amplitude given for q\.u: give a larger"):
        margins(small)


# --- models in the place of blocks ------------------------------------------------------------------------------------


def driven() -> Diagram:
    """r -> motor -> gain 2 -> y, and back."""
    d = Diagram("driven")
    total, motor, gain_ = d.add("total", Sum(signs="+-")), d.add("motor", PMDCMotor()), d.add("gain", Gain(k=2.0))
    d.wire(total.u1, d.input("r", default=0.0))
    d.wire(total.u2, gain_.y)
    d.wire(motor.v, total.y)
    d.wire(motor.tau, d.input("tau", default=0.0))
    d.wire(gain_.u, motor.omega)
    return d


@pytest.mark.parametrize(
    ("given", "transfer"),
    [
        (5.0, lambda s: 5.0 + 0 * s),
        ([[5.0]], lambda s: 5.0 + 0 * s),
        (control.tf([1.0, 4.0], [1.0, 2.0, 3.0]), lambda s: (s + 4) / (s**2 + 2 * s + 3)),
        (control.ss([[-3.0]], [[2.0]], [[1.0]], [[0.5]]), lambda s: 2 / (s + 3) + 0.5),
    ],
    ids=["gain", "matrix", "transfer function", "state space"],
)
def test_a_model_in_the_place_of_a_block(given: Any, transfer: Any) -> None:
    s = 1j * OMEGA
    linearizer = driven().linearizer(overrides={"gain": given})
    P, G = plant(s), transfer(s)
    model = linearizer.model("r", "motor.omega")
    assert at(model)[0, 0] == pytest.approx(P / (1 + P * G), rel=1e-10)
    assert at(linearizer.loop("gain.y"))[0, 0] == pytest.approx(P * G, rel=1e-10)
    assert at(linearizer.model("gain.u", "gain.y", openings="gain.u"))[0, 0] == pytest.approx(G, rel=1e-10)
    assert {row.path: row.method for row in model.report} == {"total": "exact", "motor": "exact", "gain": "override"}
    states = [label for label in model.state_labels if "override" in label]
    assert len(states) == (0 if np.isscalar(given) or isinstance(given, list) else control.ss(given).nstates)


def test_a_model_in_the_place_of_a_plant_with_states() -> None:
    """The motor by a transfer matrix from v, tau to omega, i: its states are gone, its outputs are read as before."""
    s = 1j * OMEGA
    table_ = control.tf([[[1.0], [-0.5]], [[2.0], [0.1]]], [[[0.2, 1.0], [1.0, 1.0]], [[0.1, 1.0], [0.3, 1.0]]])
    linearizer = driven().linearizer(overrides={"motor": table_})
    P, Q = 1 / (0.2 * s + 1), -0.5 / (s + 1)
    assert at(linearizer.model("r", "motor.omega"))[0, 0] == pytest.approx(P / (1 + 2 * P), rel=1e-11)
    assert at(linearizer.model("tau", "gain.y"))[0, 0] == pytest.approx(2 * Q / (1 + 2 * P), rel=1e-11)
    assert at(linearizer.model("r", "motor.i"))[0, 0] == pytest.approx(2 / (0.1 * s + 1) / (1 + 2 * P), rel=1e-11)
    assert at(linearizer.loop("motor.omega"))[0, 0] == pytest.approx(2 * P, rel=1e-11)
    labels = linearizer.model("r", "motor.omega").state_labels
    assert all(label.startswith("motor_override") for label in labels)


@pytest.mark.parametrize(
    ("path", "given", "message"),
    [
        ("engine", 1.0, r"E501 engine: there is no such block\. Blocks: total, motor, gain\."),
        ("gain", [[1.0, 2.0]], r"E501 gain: the model has 2 inputs and 1 outputs, but the block has 1 and 1\."),
        ("motor", 1.0, r"E501 motor: the model has 1 inputs and 1 outputs, but the block has 2 and 2\."),
        ("gain", control.tf([1.0], [1.0, 1.0], 0.1), r"E501 gain: the override is a sampled model\."),
        ("gain", control.tf([1.0, 0.0], [1.0]), r"E501 gain: the numerator has a higher degree"),
        ("gain", math.nan, r"E501 gain: is not a linear model\."),
        ("gain", "2", r"E501 gain: is not a linear model\."),
        ("gain", 1j, r"E501 gain: is not a linear model\."),
        ("gain", None, r"E501 gain: is not a linear model\."),
        ("gain", control.frd([1.0, 2.0], [1.0, 2.0]), r"E501 gain: is not a linear model\."),
    ],
)
def test_models_that_do_not_fit_a_block_are_refused(path: str, given: Any, message: str) -> None:
    if given == "2":  # a text that is a number is no number
        given = "two"
    with pytest.raises(UsageError, match=message):
        driven().linearizer(overrides={path: given})


def test_only_blocks_of_their_own_can_be_replaced() -> None:
    d = Diagram.load(DIAGRAMS / "analysis" / "leso_pd.json")
    with pytest.raises(UsageError, match=r"E501 control: is a subdiagram; overrides replace single blocks\."):
        d.linearizer(overrides={"control": 1.0})
    mux = Diagram("mux")
    for k in (1, 2):
        mux.wire(f"m.u{k}", mux.input(f"u{k}", default=0.0)) if k > 1 else mux.add("m", Mux(size=2))
    mux.wire("m.u1", mux.input("u1", default=0.0))
    with pytest.raises(UsageError, match=r"E501 m: only passes signals on, so that there is nothing to replace\."):
        mux.linearizer(overrides={"m": np.eye(2)})


def test_a_model_in_the_place_of_a_law_without_a_slope() -> None:
    d = Diagram("law")
    law, plant_ = d.add("law", Sign()), d.add("plant", FirstOrder(T=0.5))
    total = d.add("total", Sum(signs="+-"))
    d.wire(total.u1, d.input("r", default=0.0))
    d.wire(total.u2, plant_.y)
    d.wire(law.u, total.y)
    d.wire(plant_.u, law.y)
    with pytest.raises(AnalysisError, match="E701"):
        d.linearize("r", "plant.y")
    model = d.linearize("r", "plant.y", overrides={"law": 3.0})
    assert poles(model) == pytest.approx(np.array([-8.0]), rel=1e-12)


# --- delays -----------------------------------------------------------------------------------------------------------


def delayed(tau: float = 0.3) -> Diagram:
    """r -> integrator with gain 2 -> delay -> y, and back."""
    d = Diagram("delayed")
    total, plant_, gain_ = d.add("total", Sum(signs="+-")), d.add("plant", Integrator()), d.add("gain", Gain(k=2.0))
    lag = d.add("lag", TransportDelay(delay=tau))
    d.wire(total.u1, d.input("r", default=0.0))
    d.wire(total.u2, lag.y)
    d.wire(gain_.u, total.y)
    d.wire(plant_.u, gain_.y)
    d.wire(lag.u, plant_.y)
    return d


def test_delays_are_exact_in_responses_and_told_in_models() -> None:
    tau, s = 0.3, 1j * OMEGA
    linearizer = delayed(tau).linearizer()
    L = 2 / s * np.exp(-s * tau)
    assert linearizer.response("r", "lag.y", OMEGA)[0, 0] == pytest.approx(L / (1 + L), rel=1e-11)
    assert linearizer.response("r", "plant.y", OMEGA)[0, 0] == pytest.approx(2 / s / (1 + L), rel=1e-11)
    assert linearizer.response("lag.u", "lag.y", OMEGA, openings="lag.u")[0, 0] == pytest.approx(
        np.exp(-s * tau), rel=1e-13
    )
    both = linearizer.response(["r", "lag.y"], ["total.y", "lag.u"], OMEGA)
    assert both[0, 0] == pytest.approx(1 / (1 + L), rel=1e-11)
    assert both[0, 1] == pytest.approx(-1 / (1 + L), rel=1e-11)
    for ask in (lambda: linearizer.model("r", "lag.y"), lambda: linearizer.loop("lag.y")):
        with pytest.raises(
            AnalysisError, match=r"E707 delayed: the transfer has exact delays, .* lag\.past \(0\.3 s\)\. .* pade=3"
        ):
            ask()
    # What does not pass through the delay has a model.
    assert linearizer.model("gain.u", "plant.y", openings="lag.y").nstates == 1


def test_the_cure_of_exact_delays_names_what_keeps_them() -> None:
    tau = 0.3
    linearizer = delayed(tau).linearizer()
    with pytest.raises(AnalysisError) as told:
        linearizer.loop("lag.y")
    cure = told.value.faults[0].cure
    for name in ("response", "delayed", "delayed_loop"):
        assert f"{name}(" in cure
        assert callable(getattr(linearizer, name))
    assert "margins()" in cure
    # L = 2 e^(-s tau) / s: |L| = 1 at 2 rad/s, and its phase is -pi where omega tau = pi / 2.
    exact = margins(linearizer.delayed_loop("lag.y"))
    assert exact.phase_deg == pytest.approx(90.0 - math.degrees(2.0 * tau), rel=1e-6)
    assert exact.gain == pytest.approx(math.pi / (4.0 * tau), rel=1e-6)
    fitted = margins(linearizer.loop("lag.y", pade=3))
    assert fitted.phase_deg == pytest.approx(exact.phase_deg, rel=1e-3)


@pytest.mark.parametrize("order", [1, 2, 5])
def test_delays_by_pade_models_are_those_of_python_control(order: int) -> None:
    tau, s = 0.3, 1j * OMEGA
    linearizer = delayed(tau).linearizer()
    delay = control.tf(*control.pade(tau, order))
    L = 2 / s * delay(s)
    loop = linearizer.loop("plant.y", pade=order)
    assert at(loop)[0, 0] == pytest.approx(L, rel=1e-9)
    assert at(linearizer.model("r", "lag.y", pade=order))[0, 0] == pytest.approx(L / (1 + L), rel=1e-9)
    assert at(linearizer.sensitivity("plant.y", pade=order))[0, 0] == pytest.approx(1 / (1 + L), rel=1e-9)
    assert loop.state_labels == ["plant_y", *(f"lag_past_pade[{k}]" for k in range(order))]
    told = {block.path: block.method for block in linearizer.loop_transfer("plant.y", pade=order).report}
    assert told["lag"] == f"a Padé model of order {order}, near up to about {2 * order / tau:.3g} rad/s"
    assert told["plant"] == "exact"
    low = OMEGA[OMEGA < 0.5]
    exact = linearizer.response("r", "lag.y", low)
    assert at(linearizer.model("r", "lag.y", pade=order), low) == pytest.approx(exact, rel=1e-2 / 10**order)


def test_several_delays_in_a_circle_without_states() -> None:
    """y = u - 0.5 y(t - 0.2) + 0.3 y(t - 0.5): only delays stand in the loops."""
    d = Diagram("echo")
    total = d.add("total", Sum(signs="+-+"))
    d.wire(total.u1, d.input("u", default=0.0))
    for k, (delay, k_gain) in enumerate(((0.2, 0.5), (0.5, 0.3)), 2):
        lag, weak = d.add(f"lag{k}", TransportDelay(delay=delay)), d.add(f"weak{k}", Gain(k=k_gain))
        d.wire(lag.u, total.y)
        d.wire(weak.u, lag.y)
        d.wire(getattr(total, f"u{k}"), weak.y)
    s = 1j * OMEGA
    known = 1 / (1 + 0.5 * np.exp(-0.2 * s) - 0.3 * np.exp(-0.5 * s))
    linearizer = d.linearizer()
    assert linearizer.response("u", "total.y", OMEGA)[0, 0] == pytest.approx(known, rel=1e-11)
    two = [control.tf(*control.pade(delay, 3))(s) for delay in (0.2, 0.5)]
    by_pade = at(linearizer.model("u", "total.y", pade=3))[0, 0]
    assert by_pade == pytest.approx(1 / (1 + 0.5 * two[0] - 0.3 * two[1]), rel=1e-9)


# --- algebraic loops --------------------------------------------------------------------------------------------------


def test_an_algebraic_loop_is_solved_for_small_changes() -> None:
    """y = tanh(u - 2 y): dy/du = t/(1 + 2 t), with t the slope of tanh there."""
    d = Diagram("loop")
    total, law, twice = (
        d.add("total", Sum(signs="+-")),
        d.add("law", Expression(expression="tanh(u1)")),
        d.add("twice", Gain(k=2.0)),
    )
    d.wire(total.u1, d.input("u", default=0.7))
    d.wire(total.u2, twice.y)
    d.wire(law.u1, total.y)
    d.wire(twice.u, law.y)
    y = brentq(lambda y: math.tanh(0.7 - 2 * y) - y, -1.0, 1.0, xtol=1e-15)
    t = 1 - y**2
    linearizer = d.linearizer(loops="solve")
    assert float(linearizer.model("u", "law.y").D[0, 0]) == pytest.approx(t / (1 + 2 * t), rel=1e-10)
    assert float(linearizer.loop("law.y").D[0, 0]) == pytest.approx(2 * t, rel=1e-10)
    assert float(linearizer.sensitivity("law.y").D[0, 0]) == pytest.approx(1 / (1 + 2 * t), rel=1e-10)
    with pytest.raises(AnalysisError, match=r"E701 .*: an algebraic loop through it has no unique solution"):
        d.linearize("u", "law.y", overrides={"law": -0.5}, loops="solve")  # y = -0.5 (u - 2 y)


class Implicit(Block):
    """z^3 + z = u + x, x' = -z."""

    u = Input()
    x = State(1.0, output=True)
    z = Algebraic(1.0, output=True)

    @z.residual
    def rz(z, u, x):  # type: ignore[no-untyped-def]
        return z**3 + z - u - x

    @x.derivative
    def dx(z):  # type: ignore[no-untyped-def]
        return -z


def test_algebraic_variables_are_seen_through() -> None:
    d = alone(Implicit(), u=1.0)
    slope = 1 / (3 * 1.0**2 + 1)  # z = 1 where z^3 + z = 2
    s = 1j * OMEGA
    model = d.linearize("u", ["b.z", "b.x"])
    assert at(model)[1, 0] == pytest.approx(-slope / (s + slope), rel=1e-9)
    assert at(model)[0, 0] == pytest.approx(slope * s / (s + slope), rel=1e-9)
    assert np.isclose(model.A[0, 0], -slope, rtol=1e-10)


# --- FMUs -------------------------------------------------------------------------------------------------------------


def motor_of(path: Path, **given: Any) -> Diagram:
    d = Diagram("motor")
    motor = d.add("motor", fmu(path, **given))
    d.wire(motor.v, d.input("v", unit="V", default=0.0))
    d.wire(motor.tau, d.input("tau", unit="N.m", default=0.0))
    return d


def without_derivatives(path: Path, folder: Path) -> Path:
    """The same FMU, which says that it gives no directional derivatives."""
    made = folder / f"plain_{path.name}"
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(made, "w") as new:
        for entry in old.namelist():
            data = old.read(entry)
            if entry == "modelDescription.xml":
                for word in (b"providesDirectionalDerivatives", b"providesDirectionalDerivative"):
                    data = data.replace(word + b'="true"', word + b'="false"')
            new.writestr(entry, data)
    return made


@pytest.mark.parametrize("path", MOTORS, ids=["FMI 3", "FMI 2"])
@pytest.mark.parametrize("method", ["directional derivatives", "central differences of two steps"])
def test_the_fmu_of_the_motor_is_the_motor(path: Path, method: str, tmp_path: Path) -> None:
    A, B = motor_matrices()
    exact = method == "directional derivatives"
    d = motor_of(path if exact else without_derivatives(path, tmp_path), kind="ME")
    error = 1e-12 if exact else 1e-9  # of a linear law, differences are exact but for rounding over their step
    for at_ in (None, 0.3):
        model = d.linearize(["v", "tau"], ["motor.omega", "motor.i"], at=at_, inputs={"v": 6.0})
        assert model.state_labels == ["motor_omega", "motor_i"]
        for made, known in ((model.A, A), (model.B, B), (model.C, np.eye(2)), (model.D, np.zeros((2, 2)))):
            assert np.max(np.abs(made - known)) <= error
        assert [(row.path, row.method) for row in model.report] == [("motor", method)]
        assert model.units == (("V", "N.m"), ("rad/s", "A"))


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_with_direct_outputs_and_units_of_its_own(fmi: int) -> None:
    """x' = -a x + 1000 (u + k) in mm, y = x + 1000 u in mm, feed = u: in SI all are of size 1."""
    d = Diagram("zoo")
    z = d.add("z", fmu(zoo(fmi), kind="ME", a=3.0))
    d.wire(z.u, d.input("u", default=0.25))
    model = d.linearize("u", ["z.y", "z.feed"])
    s = 1j * OMEGA
    assert at(model)[0, 0] == pytest.approx(1 + 1 / (s + 3), rel=1e-9)
    assert at(model)[1, 0] == pytest.approx(np.ones(len(s)), rel=1e-12)


def test_an_fmu_in_a_loop_has_the_loop_of_its_block() -> None:
    def loop(block: Block) -> Linearizer:
        d = Diagram("loop")
        law, motor = d.add("law", PID(kp=2.0, ki=5.0)), d.add("motor", block)
        d.wire(law.r, d.input("r", unit="rad/s", default=0.0))
        d.wire(law.y, motor.omega)
        d.wire(motor.v, law.u)
        d.wire(motor.tau, d.input("tau", unit="N.m", default=0.0))
        return d.linearizer()

    one, other = loop(fmu(MOTORS[0], kind="ME")), loop(PMDCMotor())
    for name in ("motor.v", "motor.omega", "law.u"):
        assert at(one.loop(name)) == pytest.approx(at(other.loop(name)), rel=1e-10)
    assert at(one.model(["r", "tau"], ["motor.i", "law.u"])) == pytest.approx(
        at(other.model(["r", "tau"], ["motor.i", "law.u"])), rel=1e-10
    )


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_sampled_fmu_has_no_linear_model_between_its_events(fmi: int, tmp_path: Path) -> None:
    """Between events its output rests: a gain of 0 there would be that of no loop."""
    Diagram.alone(ZeroOrderHold(period=0.1)).export(tmp_path / "hold.fmu", fmi=fmi)
    d = Diagram("held")
    hold, lag, r = d.add("hold", fmu(tmp_path / "hold.fmu", kind="ME")), d.add("lag", FirstOrder()), d.input("r")
    error, sensor = d.add("error", Sum(signs="+-")), d.add("sensor", FirstOrder(T=0.2))
    for a, b in ((error.u1, r), (error.u2, sensor.y), (hold.u, error.y), (lag.u, hold.y), (sensor.u, lag.y)):
        d.wire(a, b)
    for asked in (lambda: d.linearize("r", "lag.y"), lambda: d.linearizer().loop("hold.u")):
        with pytest.raises(AnalysisError, match=r"E703 hold: is an FMU whose discrete outputs change at its events"):
            asked()
    model = d.linearize("hold.y", "sensor.y", openings=["hold.y"])
    s = 1j * OMEGA
    assert at(model)[0, 0] == pytest.approx(1 / ((s + 1) * (0.2 * s + 1)), rel=1e-9)


def test_fmus_of_co_simulation_have_no_linear_model() -> None:
    with pytest.raises(AnalysisError, match=r'E703 motor: is a Co-Simulation FMU.* Import it as "kind": "ME"'):
        motor_of(MOTORS[0], kind="CS").linearize("v", "motor.omega")


def test_an_fmu_for_co_simulation_only_is_not_imported_as_another_kind(tmp_path: Path) -> None:
    Diagram.alone(FirstOrder()).export(tmp_path / "lag.fmu", kinds=["CS"])
    lag = Diagram.alone(fmu(tmp_path / "lag.fmu"))
    for asked in (lambda: lag.linearize("u", "y"), lag.plan):
        with pytest.raises((AnalysisError, ModelError), match=r"E(703|118) .* for Co-Simulation only: export it"):
            asked()


@pytest.fixture
def nothing_stays() -> Iterator[None]:
    """Every instance of an FMU is freed when nobody refers to what was made of it."""
    from tests.support.model_exchange import live

    before = live()
    yield
    gc.collect()
    assert live() == before


@pytest.mark.parametrize("at_", [None, 0.2])
def test_fmus_are_closed_with_the_linearizer(at_: float | None, nothing_stays: None) -> None:
    from tests.support.model_exchange import live

    before = live()
    d = motor_of(MOTORS[0], kind="ME")
    linearizer = d.linearizer(at=at_)
    assert live() > before
    model, other = linearizer.model("v", "motor.omega"), linearizer.model("motor.tau", "motor.i")
    with pytest.raises(UsageError):
        linearizer.model("v", "ghost")
    with pytest.raises(UsageError):
        d.linearize("v", "ghost", at=at_)
    del linearizer
    assert live() == before  # models do not hold them
    assert (model.nstates, other.nstates) == (2, 2)


# --- what has no linear model, and what stands still ------------------------------------------------------------------


class Doubling:
    """Twice what it is given, whatever else it may do."""

    def step(self, t: float, u: float) -> float:
        return 2.0 * u


class Programmed(Block):
    """A program in Python."""

    u = Input()
    y = Stepped(0.0)

    @stepper(every=0.1)
    def program():  # type: ignore[no-untyped-def]
        return Doubling()


@pytest.mark.parametrize("block", [RateLimiter(), Backlash(), Programmed()], ids=lambda block: type(block).__name__)
def test_programs_and_what_remembers_each_step_have_no_linear_model(block: Block) -> None:
    d = alone(block, u=0.0)
    d.wire(d.add("after", FirstOrder()).u, "b.y")
    d.wire(d.add("other", FirstOrder()).u, "u")
    for ends in (("u", "b.y"), ("b.u", "b.y"), ("u", "after.y")):
        with pytest.raises(AnalysisError, match=r"E703 b: acts at each step, or is a program"):
            d.linearize(*ends)
    # What does not pass through it has one, and a model can take its place.
    assert at(d.linearize("u", "other.y"))[0, 0] == pytest.approx(1 / (1j * OMEGA + 1), rel=1e-12)
    assert at(d.linearize("b.y", "after.y"))[0, 0] == pytest.approx(1 / (1j * OMEGA + 1), rel=1e-12)
    assert at(d.linearize("u", "after.y", overrides={"b": 3.0}))[0, 0] == pytest.approx(3 / (1j * OMEGA + 1), rel=1e-12)


def part() -> Diagram:
    d = Diagram("part")
    u = d.input("u")
    d.wire(d.add("x", FirstOrder(T=0.5)).u, u)
    d.wire(d.add("g", Gain(k=2.0)).u, u)
    d.output("x", d["x"].y)
    d.output("v", d["g"].y)
    return d


def switched(on: float, **how: str) -> Diagram:
    d = Diagram("switched")
    u, is_on = d.input("u", default=1.0), d.add("is_on", CompareToConstant(constant=0.5))
    inner = d.add("part", part(), enable=how)
    d.wire(is_on.u, d.input("on", default=on))
    d.wire(inner.u, u)
    d.wire(inner.enable, is_on.y)
    d.wire(d.add("after", FirstOrder()).u, inner.x)
    return d


@pytest.mark.parametrize("how", [{}, {"outputs": "reset"}, {"states": "reset"}], ids=str)
def test_a_subdiagram_that_is_off_stands_still(how: dict[str, str]) -> None:
    s = 1j * OMEGA
    running, resting = switched(1.0, **how).linearizer(), switched(0.0, **how).linearizer()
    assert at(running.model("u", "part.x"))[0, 0] == pytest.approx(1 / (0.5 * s + 1), rel=1e-12)
    assert at(running.model("u", "after.y"))[0, 0] == pytest.approx(1 / (0.5 * s + 1) / (s + 1), rel=1e-11)
    assert float(running.model("u", "part.v").D[0, 0]) == 2.0
    for name in ("part.x", "part.v", "after.y", "part.x.y"):
        assert np.all(at(resting.model("u", name)) == 0.0), name
    assert np.all(at(resting.model("part.x.u", "part.x.y")) == 0.0)  # also seen from inside
    for linearizer in (running, resting):
        assert np.all(at(linearizer.model("on", "after.y")) == 0.0)
    with pytest.raises(AnalysisError, match=r"E701 is_on\.y: jumps at u = 0\.5"):
        switched(0.5, **how).linearize("on", "after.y")


def test_a_time_of_a_run_is_a_point_as_well() -> None:
    """x' = u - x^3 from 1 with u = 1/8: the slope is -3 x(t)^2, and events on the way have happened."""
    d = alone(Cubic(), u=0.0)
    for t in (0.0, 0.5, 3.0):
        x = 1 / math.sqrt(1 + 2 * t)
        model = d.linearize("u", "b.y", at=t, rtol=1e-10, atol=1e-12)
        assert model.A[0, 0] == pytest.approx(-3 * x**2, rel=1e-8)
        assert model.C[0, 0] == pytest.approx(2 * x, rel=1e-8)
    stepped = Diagram("stepped")
    law, step = stepped.add("law", Saturation()), stepped.add("step", Step(at=1.0, before=0.0, after=3.0))
    total = stepped.add("total", Sum())
    stepped.wire(total.u1, step.y)
    stepped.wire(total.u2, stepped.input("u", default=0.0))
    stepped.wire(law.u, total.y)
    slopes = [gain(stepped, "u", "law.y", at=t) for t in (0.5, 1.0, 1.5)]
    assert slopes == [1.0, 0.0, 0.0]
    with pytest.raises(UsageError, match="E501 at"):
        stepped.linearize("u", "law.y", at=-1.0)


def test_values_that_are_held_and_parameters_are_those_of_the_model() -> None:
    d = alone(Power(exponent=3.0), u=1.0)
    assert gain(d, inputs={"u": 2.0}) == pytest.approx(12.0, rel=1e-14)
    assert gain(d, parameters={"b.exponent": 2.0}, inputs={"u": 5.0}) == pytest.approx(10.0, rel=1e-14)
    angle = Diagram("angle")
    sine = angle.add("b", Expression(expression="sin(u1)"))
    angle.wire(sine.u1, angle.input("u", unit="deg", default=60.0))
    assert gain(angle) == pytest.approx(0.5, rel=1e-12)  # in rad, whatever the input is declared in
    assert gain(angle, inputs={"u": 0.0}) == pytest.approx(1.0, rel=1e-12)


def test_points_of_values_that_differ_in_their_last_digits_are_told_apart() -> None:
    """They are kept by what was given, and an array prints eight digits of it."""
    d = Diagram("near")
    row = d.add("row", MatrixGain(K=[[1.0, 2.0]]))
    d.wire(row.u, d.input("u", size=2))
    d.wire(d.add("p", Power(exponent=3.0)).u, "row.y[0]")
    for first in (1.0, 1.0 + 1e-9):
        D = d.linearize("u", "p.y", inputs={"u": np.array([first, 1.0])}).D
        assert D[0] == pytest.approx(3 * (first + 2.0) ** 2 * np.array([1.0, 2.0]), rel=1e-14)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda made: made.response("r", "lag.y", [1.0, math.nan]), r"E501 response: frequencies must be finite "
            r"numbers"),
        (lambda made: made.response("r", "lag.y", [[1.0, 2.0]]), r"E501 response: frequencies must be finite numbers"),
        (lambda made: made.model("r", "lag.y", pade=2.5), r"E501 pade: must be an order, 1 or more, not 2\.5\."),
        (lambda made: made.model("r", "lag.y", pade=-1), r"E501 pade: must be an order, 1 or more, not -1\."),
    ],
)
def test_frequencies_and_orders_that_cannot_be_are_refused(ask: Callable[[Linearizer], Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        ask(delayed().linearizer())


def test_a_law_gets_one_size() -> None:
    for more in ({"sigma": {"b.u": 1.0}}, {"amplitude": {"b.u": 2.0, "u": 3.0}}):
        with pytest.raises(UsageError, match=r"E501 .* is given twice"):
            alone(Saturation(), u=0.0).linearizer(**{"amplitude": {"b.u": 2.0}, **more})


def test_an_fmu_of_a_law_without_a_slope_is_refused_as_its_block_is(tmp_path: Path) -> None:
    """By its own derivatives, and by differences of two steps, which do not agree there."""
    d = alone(SMESO(), y=0.0, u=0.0)
    for name in ("z1", "z3"):
        d.output(name, f"b.{name}")
    d.export(tmp_path / "smeso.fmu")
    for path in (tmp_path / "smeso.fmu", without_derivatives(tmp_path / "smeso.fmu", tmp_path)):
        for e in (0.0, 0.1):
            outer = Diagram("outer")
            b = outer.add("b", fmu(path, kind="ME"))
            outer.wire(b.y, outer.input("y", default=e))
            outer.wire(b.u, outer.input("u", default=0.0))
            if e == 0.0:
                with pytest.raises(AnalysisError, match=r"E701 b\.z: has no slope at this point"):
                    outer.linearize("y", ["b.z1", "b.z3"])
            else:
                ours = outer.linearize("y", ["b.z1", "b.z3"])
                theirs = d.linearize("y", ["b.z1", "b.z3"], inputs={"y": e})
                assert at(ours) == pytest.approx(at(theirs), rel=1e-8)


def test_points_of_other_values_are_those_of_a_fresh_diagram_and_cost_no_new_model(monkeypatch):
    from blocks.api import points

    flattened = []
    flat_of = points.flat_of
    monkeypatch.setattr(points, "flat_of", lambda *given: flattened.append(given) or flat_of(*given))
    file = DIAGRAMS / "adrc" / "mass_position.json"
    kept = Diagram.load(file)
    for at in (None, 0.4):
        for mass, omega_o in ((1.0, 40.0), (1.3, 25.0), (0.7, 60.0)):
            given = {"parameters": {"mass": mass, "omega_o": omega_o}, "at": at}
            loop = kept.linearizer(**given).loop_transfer("control.u")
            fresh = Diagram.load(file).linearizer(**given).loop_transfer("control.u")
            for key in "ABCD":
                assert np.array_equal(getattr(loop, key), getattr(fresh, key)), (key, given)
    assert len(flattened) == 1 + 6  # the six fresh ones flatten for themselves
    with pytest.raises(ModelError, match="E106"):
        kept.linearizer(parameters={"mas": 1.0})


# --- what a law depends on, and where its slope is that of one distance ---------------------------------------------


def around_a_law(law: Any, port: str, **others: Block) -> Diagram:
    """An integrator behind a law of e = -x, whose other inputs have sources."""
    d = Diagram("around")
    back, x, it = d.add("back", Gain(k=-1.0)), d.add("x", Integrator()), d.add("law", law)
    d.wire(back.u, x.y)
    d.wire(f"law.{port}", back.y)
    d.wire(x.u, it.y)
    for name, source in others.items():
        d.wire(f"law.{name}", d.add(f"source_{name}", source).y)
    return d


def test_a_law_that_is_linear_at_a_fixed_time_is_no_law_of_several_signals() -> None:
    """w(t) e: of Gelb and Vander Velde the describing function is w(t) itself."""
    wave = Sine(amplitude=1.0, omega=1.0, bias=2.0)
    late = around_a_law(Expression(expression="u1*u2"), "u2", u1=wave)
    with pytest.raises(UsageError, match=r"E501 amplitude of law\.u2: no nonlinear law reads this signal"):
        late.linearizer(amplitude={"law.u2": 0.1})
    assert float((late.linearizer().loop("back.y").C @ late.linearizer().loop("back.y").B)[0, 0]) == pytest.approx(2.0)
    # Of w(t) |e| e it is w(t) 8 A/(3 pi), and a law of two signals that move is still refused.
    bent = around_a_law(Expression(expression="u1*abs(u2)*u2"), "u2", u1=wave).linearizer(amplitude={"law.u2": 0.1})
    gain, = bent.gains.values()
    assert gain == pytest.approx(2.0 * 8 * 0.1 / (3 * math.pi), rel=1e-9)
    both = around_a_law(Expression(expression="u1*u2"), "u2")
    both.wire("law.u1", "x.y")
    with pytest.raises(AnalysisError, match=r"E704 law\.y: is a law of several signals \(law\.u1, law\.u2\)"):
        both.linearizer(amplitude={"law.u2": 0.1})


@pytest.mark.parametrize("given", [[3], ("back.y", None), 3, None])
def test_a_loop_is_opened_at_signals_by_name(given: Any) -> None:
    linearizer = around_a_law(Gain(k=2.0), "u").linearizer()
    for ask in (linearizer.loop, linearizer.delayed_loop, linearizer.sensitivity, linearizer.complementary):
        with pytest.raises(UsageError, match=r"E501 signal: .* is not the name of a signal"):
            ask(given)
    with pytest.raises(UsageError, match="E501 signal"):
        linearizer.model([given], "x.y")


@pytest.mark.parametrize(("exponent", "less"), [(0.5, "68%"), (0.8433, "30%"), (0.2, "84%")])
@pytest.mark.parametrize("distance", [1e-9, 1e-3, 1.0])
def test_near_a_singular_point_a_slope_is_noted_to_be_that_of_the_distance(
    exponent: float, less: str, distance: float
) -> None:
    """The slope of sgn(e) |e|^a goes with |e|^(a - 1): ten times as far it is 1 - 10^(a - 1) less."""
    d = around_a_law(Expression(expression=f"u1*abs(u1)**({exponent}-1)"), "u1")
    model = d.linearizer(parameters={"x.y_start": -distance}).loop("back.y")
    (note,) = [block.note for block in model.report if block.path == "law"]
    assert f"near u1 = 0, where it is infinite: at ten times the distance it is {less} less" in note
    assert 'amplitude={"law.u1": A}' in note
    assert float((model.C @ model.B)[0, 0]) == pytest.approx(exponent * distance ** (exponent - 1), rel=1e-9)


@pytest.mark.parametrize("law", ["u1*abs(u1)", "abs(u1)", "u1**3", "sqrt(1+u1**2)", "u1 + 0.001*u1*abs(u1)**(-0.1)"])
def test_a_law_whose_slope_is_nowhere_infinite_or_hardly_changes_has_no_such_note(law: str) -> None:
    d = around_a_law(Expression(expression=law), "u1")
    model = d.linearizer(parameters={"x.y_start": -1e-3}).loop("back.y")
    assert not any("infinite" in block.note for block in model.report)


def test_a_pattern_gives_an_amplitude_to_all_laws_that_read_its_signals() -> None:
    d = Diagram("d")
    d.input("r")
    d.add("lag", FirstOrder(T=1))
    for k in ("a", "b"):
        d.add(f"limit_{k}", Saturation(lower=-1, upper=1))
    d.wire("limit_a.u", "r")
    d.wire("lag.u", "limit_a.y")
    d.wire("limit_b.u", "lag.y")
    d.output("y", "limit_b.y")
    by_name = d.linearize("r", "y", amplitude={"limit_a.u": 2, "limit_b.u": 2})
    by_pattern = d.linearize("r", "y", amplitude={"limit_*.u": 2})
    assert np.array_equal(by_pattern.C, by_name.C)
    assert np.array_equal(by_pattern.B, by_name.B)
    assert not np.array_equal(by_pattern.B, d.linearize("r", "y").B)
    # A law that both its input and the signal at it match has the amplitude once.
    assert np.array_equal(d.linearize("r", "y", amplitude={"*.*": 2}).C, by_name.C)
    with pytest.raises(UsageError, match=r"E501 amplitude of \*\.q: matches no signal that a nonlinear law reads\."):
        d.linearize("r", "y", amplitude={"*.q": 2})
