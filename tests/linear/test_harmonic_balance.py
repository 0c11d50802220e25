"""Harmonic balance: against simulated sweeps, closed forms, and FMUs of the same blocks."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import blocks
from blocks import AnalysisError, Diagram, UsageError, fmu
from blocks.analysis.adrc_reports import observer_report
from blocks.analysis.estimation import SineStream, estimate_response
from blocks.analysis.responses import compare
from blocks.compile.toolchain.compiler import find_compiler
from blocks.frequency import describing
from blocks.frequency.response import bandwidth, dc_gain, response

Array = np.ndarray[Any, Any]
ENGINE = "reference" if find_compiler() is None else "native"
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

# Roots are found to 1e-12 of the amplitude, with describing functions to 1e-12.
EXACT = 1e-9
GAINS = [30.4, 513.4, 1570.8]
ESTIMATES = ["z1", "z2", "z3"]
# The observers and loops of the facts: what harmonics that come back around the observer's own loop do.
OBSERVER_DB, OBSERVER_DEG = 0.05, 0.1
LOOP_DB, LOOP_DEG = 0.2, 1.0


def off(made: Array, wanted: Array) -> tuple[float, float]:
    """The largest differences in dB and in degrees."""
    ratio = made / wanted
    return float(np.max(np.abs(20.0 * np.log10(np.abs(ratio))))), float(np.max(np.abs(np.angle(ratio, deg=True))))


class Cubic(blocks.Block):
    """y = u^3."""

    u = blocks.Input()

    @blocks.output()
    def y(u):
        return u**3


class Square(blocks.Block):
    """y = u^2."""

    u = blocks.Input()

    @blocks.output()
    def y(u):
        return u**2


def loop_around(law: Any, num: list[float], den: list[float]) -> Diagram:
    """r - y through a law into a plant."""
    made = Diagram("loop", library=[type(law)])
    r = made.input("r")
    made.add("error", blocks.Sum(signs="+-"))
    made.add("law", law)
    made.add("plant", blocks.TransferFunction(num=num, den=den))
    made.wire("error.u1", r)
    made.wire("error.u2", "plant.y")
    made.wire("law.u", "error.y")
    made.wire("plant.u", "law.y")
    return made


# --- the observer of the paper --------------------------------------------------------------------------------------


@needs_compiler
def test_the_describing_function_of_the_observer_is_met_by_sweeps_over_three_decades() -> None:
    diagram = Diagram.alone(blocks.SMESO(gains=GAINS))
    linearizer = diagram.linearizer()
    omega = np.geomspace(0.5, 400.0, 12)
    s = 1j * omega
    b1, b2, b3 = GAINS
    linear = np.array([b1 * s**2 + b2 * s + b3, s * (b2 * s + b3), b3 * s**2]) / (s**3 + b1 * s**2 + b2 * s + b3)
    for A, wrong in ((0.01, 5.1), (0.1, 3.3), (1.0, 1.8)):
        made = linearizer.harmonic_response("y", ESTIMATES, omega, amplitude=A)
        swept = estimate_response(diagram, "y", ESTIMATES, SineStream(omega, A), inputs={"u": 0.0}, engine=ENGINE)
        db, degrees = off(made.value, swept.value)
        assert db < OBSERVER_DB
        assert degrees < OBSERVER_DEG
        assert db < 0.0085  # the facts: 0.008 dB and 0.03 deg
        assert degrees < 0.03
        verdict = compare(swept, made)
        assert verdict.is_within
        # The model with N = 1 at all amplitudes is off by what the facts say; a sweep of twelve points nearly shows it.
        assert off(linear, swept.value)[0] == pytest.approx(wrong, abs=0.06)


def test_the_amplitudes_of_the_error_are_those_that_the_law_gives_in_closed_form() -> None:
    made = Diagram.alone(blocks.SMESO(gains=GAINS)).linearizer()
    omega = np.array([0.5, 3.0, 20.0, 400.0])
    found = made.harmonic_response("y", ESTIMATES, omega, amplitude=0.1)
    s = 1j * omega
    chain = GAINS[0] / s + GAINS[1] / s**2 + GAINS[2] / s**3  # from g to z1

    def gain(a: float) -> float:
        return float(0.6265 * describing.power(0.8433, a).gain.real + 0.5878 * describing.power(1.04078, a).gain.real)

    for k in range(len(omega)):
        wanted = brentq(lambda a, k=k: a * abs(1.0 + chain[k] * gain(a)) - 0.1, 1e-12, 1.0, xtol=1e-18, rtol=1e-14)
        assert found.amplitudes["SMESO.e"][k] == pytest.approx(wanted, rel=EXACT)
        assert found.value[0, k] == pytest.approx(1.0 - 1.0 / (1.0 + chain[k] * gain(wanted)), rel=EXACT)


def test_the_bandwidth_of_the_observer_hardly_moves_with_amplitude() -> None:
    report = observer_report(Diagram.alone(blocks.SMESO(gains=GAINS)), "SMESO", amplitudes=[1e-6, 1.0, 10.0])
    assert report.rows[0].bandwidth_f == pytest.approx(3.7182, abs=5e-5)
    assert report.rows[2].bandwidth_f == pytest.approx(3.8323, abs=5e-5)
    N = report.rows[1].N
    assert pytest.approx(1.229572531, rel=1e-9) == N
    b1, b2, b3 = N * np.array(GAINS)
    assert np.allclose(np.sort_complex(report.rows[1].poles), np.sort_complex(np.roots([1.0, b1, b2, b3])), rtol=1e-9)
    assert report.rows[1].noise_h2 == pytest.approx(b3 * math.sqrt(b2 / (2.0 * (b1 * b2 - b3))), rel=1e-9)


def wheel() -> Diagram:
    """The paper's motor under SMESO and INLSEF, which hold it at rest."""
    made = Diagram("wheel")
    d, tau = made.input("d", unit="V"), made.input("tau", unit="N.m")
    made.add("control", blocks.INLSEF(unit="rad/s", unit_u="V"))
    made.add("eso", blocks.SMESO(unit="rad/s", unit_u="V", gains=GAINS))
    made.add("motor", blocks.PMDCMotor())
    made.add("drive", blocks.Sum(unit="V"))
    for k, unit in ((1, "rad/s"), (2, "rad/s2")):
        made.wire(f"control.r{k}", made.add(f"rest{k}", blocks.Constant(value=0.0, unit=unit)).y)
    for k in (1, 2, 3):
        made.wire(f"control.z{k}", f"eso.z{k}")
    for target, source in {
        "eso.y": "motor.omega", "eso.u": "control.u", "drive.u1": "control.u", "motor.v": "drive.y",
    }.items():  # fmt: skip
        made.wire(target, source)
    made.wire("drive.u2", d)
    made.wire("motor.tau", tau)
    return made


@needs_compiler
@pytest.mark.parametrize(("input", "amplitude"), [("d", 0.01), ("d", 1.0), ("tau", 0.1)])
def test_a_loop_of_five_laws_answers_a_disturbance_as_its_sweeps(input: str, amplitude: float) -> None:
    diagram = wheel()
    omega = np.geomspace(0.5, 100.0, 8)
    made = diagram.linearizer().harmonic_response(input, "motor.omega", omega, amplitude=amplitude)
    assert set(made.amplitudes) == {
        "control.e[0]", "control.e[1]", "control.I", "control.v", "eso.e",
    }  # fmt: skip
    rest = {"d": 0.0, "tau": 0.0}
    swept = estimate_response(diagram, input, "motor.omega", SineStream(omega, amplitude), inputs=rest, engine=ENGINE)
    db, degrees = off(made.value, swept.value)
    assert db < LOOP_DB
    assert degrees < LOOP_DEG


@pytest.mark.long
@needs_compiler
def test_an_exported_observer_gives_by_co_simulation_what_the_describing_function_predicts(tmp_path: Path) -> None:
    observer = Diagram.alone(blocks.SMESO(gains=GAINS))
    observer.export(tmp_path / "smeso.fmu", kinds=["CS"])
    diagram = Diagram("outside", folder=tmp_path)
    y = diagram.input("y")
    eso = diagram.add("eso", fmu(tmp_path / "smeso.fmu", kind="CS"))
    diagram.wire(eso.y, y)
    diagram.wire(eso.u, diagram.add("none", blocks.Constant(value=0.0)).y)
    omega = np.array([2.0, 10.0, 40.0])
    predicted = observer.linearizer().harmonic_response("y", ESTIMATES, omega, amplitude=0.1)
    swept = estimate_response(diagram, "y", [f"eso.{name}" for name in ESTIMATES], SineStream(omega, 0.1))
    db, degrees = off(predicted.value, swept.value)
    # Communication points are as close as half their distance changes nothing beyond 1e-4.
    assert db < OBSERVER_DB
    assert degrees < OBSERVER_DEG


# --- single laws in loops -------------------------------------------------------------------------------------------


# A plant of the third order lets through 1 to 3 % of a third harmonic, of which the law makes a little of the first.
THIRD_DB, THIRD_DEG = 0.05, 0.5
PLANT = [1.0, 3.0, 3.0, 1.0]  # (s + 1)^3


@pytest.mark.parametrize(
    ("law", "gain", "A"),
    [
        (blocks.Saturation(lower=-0.5, upper=0.5), lambda a: describing.saturation(-0.5, 0.5, a).gain, 1.5),
        (blocks.DeadZone(lower=-0.2, upper=0.2), lambda a: describing.dead_zone(-0.2, 0.2, a).gain, 1.5),
        (Cubic(), lambda a: 0.75 * a * a, 0.5),
        (blocks.Sign(), lambda a: 4.0 / (math.pi * a), 4.0),
    ],
    ids=["saturation", "dead zone", "cubic", "sign"],
)
def test_a_law_in_a_loop_is_the_root_of_one_equation_and_what_a_sweep_sees(law: Any, gain: Any, A: float) -> None:
    diagram = loop_around(law, [1.0], PLANT)
    omega = np.array([1.0, 3.0])
    made = diagram.linearizer().harmonic_response("r", ["plant.y", "error.y"], omega, amplitude=A)
    P = 1.0 / (1j * omega + 1.0) ** 3
    for k in range(2):
        a = brentq(lambda a, k=k: a * abs(1.0 + P[k] * gain(a)) - A, 1e-9, 10.0, xtol=1e-16, rtol=1e-14)
        assert made.amplitudes["law.u"][k] == pytest.approx(a, rel=EXACT)
        assert made.value[1, k] == pytest.approx(1.0 / (1.0 + P[k] * gain(a)), rel=EXACT)
        assert made.value[0, k] == pytest.approx(1.0 - made.value[1, k], rel=EXACT)
    swept = estimate_response(diagram, "r", ["plant.y", "error.y"], SineStream(omega, A), engine=ENGINE)
    db, degrees = off(made.value, swept.value)
    assert db < THIRD_DB
    assert degrees < THIRD_DEG


def test_a_relay_with_hysteresis_lags_as_its_sweep_does_and_is_constant_below_its_edges() -> None:
    diagram = loop_around(blocks.Relay(on_at=0.3, off_at=-0.3, on=1.0, off=-1.0), [1.0], [1.0, 1.4, 1.0])
    linearizer = diagram.linearizer()
    omega = np.array([2.0, 4.0])
    made = linearizer.harmonic_response("r", ["law.y", "plant.y"], omega, amplitude=2.0)
    swept = estimate_response(diagram, "r", ["law.y", "plant.y"], SineStream(omega, 2.0), engine=ENGINE)
    db, degrees = off(made.value, swept.value)
    assert db < 0.1
    assert degrees < 1.0
    with pytest.raises(AnalysisError, match=r"E704 law\.y: a relay that goes on at 0\.3"):
        linearizer.harmonic_response("r", "law.y", [40.0], amplitude=0.2)


def test_friction_that_holds_is_held_and_friction_that_slides_brakes() -> None:
    """A mass with Coulomb friction sign(v), to which a force r is applied."""
    diagram = Diagram("mass")
    r = diagram.input("r")
    diagram.add("sum", blocks.Sum(signs="+-"))
    diagram.add("mass", blocks.Integrator())
    diagram.add("friction", blocks.Sign())
    diagram.wire("sum.u1", r)
    diagram.wire("sum.u2", "friction.y")
    diagram.wire("mass.u", "sum.y")
    diagram.wire("friction.u", "mass.y")
    linearizer = diagram.linearizer()
    held = linearizer.harmonic_response("r", ["mass.y", "friction.y"], [3.0], amplitude=0.9)
    assert abs(held.value[0, 0]) < 1e-11
    assert held.value[1, 0] == pytest.approx(1.0, rel=1e-9)  # the law gives back what is put in
    slides = linearizer.harmonic_response("r", "mass.y", [3.0], amplitude=4.0)
    # j w v = 4 - (4/pi) v/|v|: w |v| and 4/pi are the legs of a right-angled triangle.
    assert abs(slides.value[0, 0]) == pytest.approx(math.sqrt(16.0 - (4.0 / math.pi) ** 2) / 3.0 / 4.0, rel=EXACT)


def test_two_laws_of_two_signals_answer_as_their_sweep() -> None:
    diagram = Diagram("two")
    r = diagram.input("r")
    diagram.add("error", blocks.Sum(signs="+-"))
    diagram.add("valve", blocks.Saturation(lower=-1.0, upper=1.0))
    diagram.add("tank", blocks.TransferFunction(num=[1.0], den=[1.0, 1.0]))
    diagram.add("gap", blocks.DeadZone(lower=-0.1, upper=0.1))
    diagram.add("pipe", blocks.TransferFunction(num=[3.0], den=[1.0, 1.0]))
    diagram.wire("error.u1", r)
    for target, source in {
        "error.u2": "pipe.y", "valve.u": "error.y", "tank.u": "valve.y", "gap.u": "tank.y", "pipe.u": "gap.y",
    }.items():  # fmt: skip
        diagram.wire(target, source)
    omega = np.array([0.4, 1.0, 2.0])
    made = diagram.linearizer().harmonic_response("r", ["pipe.y", "tank.y"], omega, amplitude=2.0)
    swept = estimate_response(diagram, "r", ["pipe.y", "tank.y"], SineStream(omega, 2.0), engine=ENGINE)
    db, degrees = off(made.value, swept.value)
    assert db < 0.2
    assert degrees < 2.0
    for k in range(3):  # both laws agree with the rest of the diagram
        s = 1j * omega[k]
        a, b = (made.amplitudes[name][k] for name in ("valve.u", "gap.u"))
        forward = (
            describing.saturation(-1.0, 1.0, a).gain * describing.dead_zone(-0.1, 0.1, b).gain * 3.0 / (s + 1.0) ** 2
        )
        assert made.value[0, k] == pytest.approx(forward / (1.0 + forward), rel=1e-6)


def test_a_law_alone_in_a_diagram_is_its_describing_function_and_no_law_makes_the_linear_response() -> None:
    made = Diagram.alone(blocks.Saturation(lower=-1.0, upper=1.0)).linearizer()
    omega = np.array([0.1, 5.0])
    found = made.harmonic_response("u", "y", omega, amplitude=2.0)
    assert np.allclose(found.value, describing.saturation(-1.0, 1.0, 2.0).gain, rtol=EXACT)
    plain = Diagram.alone(blocks.SecondOrder(w=3.0, d=0.2)).linearizer()
    assert np.allclose(
        plain.harmonic_response("u", "y", omega, amplitude=7.0).value, response(plain.model("u", "y"), omega)[:, 0]
    )


@pytest.mark.parametrize(
    ("law", "A"), [(blocks.Saturation(lower=-0.3, upper=2.0), 2.0), (Square(), 0.7)], ids=["saturation", "square"]
)
def test_laws_that_are_not_odd_work_about_the_mean_that_they_make(law: Any, A: float) -> None:
    diagram = loop_around(law, [1.0], PLANT)
    omega = np.array([1.0, 2.0])
    made = diagram.linearizer().harmonic_response("r", ["plant.y", "error.y"], omega, amplitude=A)
    swept = estimate_response(diagram, "r", ["plant.y", "error.y"], SineStream(omega, A), engine=ENGINE)
    db, degrees = off(made.value[1:], swept.value[1:])
    assert db < THIRD_DB
    assert degrees < THIRD_DEG
    # The plant's gain is 1 at rest, so that the mean of what the law gives is that of -error.
    assert np.allclose(made.means["law.u"], swept.mean[1], rtol=0.02)
    assert np.all(made.means["law.u"] < -0.05)
    if isinstance(law, Square):  # u^2 at b + a sin: mean b^2 + a^2/2 = -b, fundamental 2 a b
        for k in range(2):
            b, a = made.means["law.u"][k], made.amplitudes["law.u"][k]
            assert b * b + 0.5 * a * a == pytest.approx(-b, rel=1e-6)
            P = 1.0 / (1j * omega[k] + 1.0) ** 3
            assert made.value[1, k] == pytest.approx(1.0 / (1.0 + 2.0 * b * P), rel=1e-6)


def test_an_actuator_that_stands_off_its_middle_lets_less_through_and_moves() -> None:
    """0 ... 10 V around 7 V: a sine of 5 V is cut above."""
    diagram = Diagram("actuator")
    u = diagram.input("u")
    diagram.add("valve", blocks.Saturation(lower=0.0, upper=10.0))
    diagram.wire("valve.u", u)
    diagram.wire(diagram.add("tank", blocks.FirstOrder(T=0.5)).u, "valve.y")
    made = diagram.linearizer(inputs={"u": 7.0}).harmonic_response("u", ["tank.y"], [0.0, 2.0], amplitude=5.0)
    gain = describing.saturation(0.0, 10.0, 5.0, 7.0).gain
    assert np.allclose(made.value[0], gain / (1.0 + 0.5j * np.array([0.0, 2.0])), rtol=EXACT)
    assert np.allclose(made.means["valve.u"], 7.0)  # no loop moves it


def test_exact_delays_are_part_of_the_balance() -> None:
    diagram = Diagram("late")
    r = diagram.input("r")
    diagram.add("error", blocks.Sum(signs="+-"))
    diagram.add("law", blocks.Saturation(lower=-0.5, upper=0.5))
    diagram.add("late", blocks.TransportDelay(delay=0.3))
    diagram.add("plant", blocks.TransferFunction(num=[1.0], den=PLANT))
    diagram.wire("error.u1", r)
    for target, source in {"error.u2": "plant.y", "law.u": "error.y", "late.u": "law.y", "plant.u": "late.y"}.items():
        diagram.wire(target, source)
    omega = np.array([1.0, 2.0])
    made = diagram.linearizer().harmonic_response("r", ["plant.y", "error.y"], omega, amplitude=1.5)
    s = 1j * omega
    P = np.exp(-0.3 * s) / (s + 1.0) ** 3
    for k in range(2):
        N = describing.saturation(-0.5, 0.5, made.amplitudes["law.u"][k]).gain
        assert made.value[1, k] == pytest.approx(1.0 / (1.0 + P[k] * N), rel=EXACT)
    swept = estimate_response(diagram, "r", ["plant.y", "error.y"], SineStream(omega, 1.5), engine=ENGINE)
    db, degrees = off(made.value, swept.value)
    assert db < THIRD_DB
    assert degrees < THIRD_DEG


def test_a_response_that_jumps_goes_on_along_its_branch_as_long_as_there_is_one() -> None:
    """A spring that hardens: x'' + 0.1 x' + x + x^3 = r."""
    spring = Diagram("spring", library=[Cubic])
    r = spring.input("r")
    spring.add("sum", blocks.Sum(signs="+-"))
    spring.add("mass", blocks.TransferFunction(num=[1.0], den=[1.0, 0.1, 1.0]))
    spring.add("law", Cubic())
    spring.wire("sum.u1", r)
    for target, source in {"sum.u2": "law.y", "mass.u": "sum.y", "law.u": "mass.y"}.items():
        spring.wire(target, source)
    linearizer = spring.linearizer()
    omega, A = np.linspace(0.5, 3.0, 26), 0.5
    up = np.abs(linearizer.harmonic_response("r", "mass.y", omega, amplitude=A).value[0]) * A
    down = np.abs(linearizer.harmonic_response("r", "mass.y", omega[::-1], amplitude=A).value[0])[::-1] * A
    for w, high, low in zip(omega, up, down, strict=True):
        k = 1.0 - w * w
        squares = np.roots([9.0 / 16.0, 1.5 * k, k * k + (0.1 * w) ** 2, -A * A])
        sizes = np.sqrt(np.sort(squares[np.abs(squares.imag) < 1e-9].real))
        assert high == pytest.approx(sizes[-1], rel=EXACT)
        assert low == pytest.approx(sizes[0], rel=EXACT)
    assert up[15] / down[15] > 10.0


# --- laws of several signals ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("R", "A"), [(100.0, 1.0), (30.0, 2.0)])
def test_hans_tracking_differentiator_has_its_bandwidth(R: float, A: float) -> None:
    diagram = Diagram.alone(blocks.TrackingDifferentiator(form="sign", R=R))
    linearizer = diagram.linearizer()
    wanted = 1.341876534 * math.sqrt(R / A)

    def gap(w: float) -> float:
        made = linearizer.harmonic_response("r", ["r1"], [w], amplitude=A)
        return float(abs(made.value[0, 0])) - math.sqrt(0.5)

    found = brentq(gap, 0.9 * wanted, 1.3 * wanted, xtol=1e-9 * wanted)
    assert found == pytest.approx(wanted, rel=1e-8)
    assert wanted == pytest.approx(math.sqrt(4.0 * math.sqrt(2.0) * R / (math.pi * A)), rel=1e-9)
    if R == 100.0:
        assert found == pytest.approx(13.41876534, rel=1e-8)


def test_a_differentiator_that_slides_has_no_balance() -> None:
    linearizer = Diagram.alone(blocks.TrackingDifferentiator(form="sign")).linearizer()
    with pytest.raises(AnalysisError, match=r"E706 TrackingDifferentiator\.\w+: no amplitudes.* at 3 rad/s.*slide"):
        linearizer.harmonic_response("r", "r1", [3.0], amplitude=1.0)


def test_the_papers_differentiator_has_less_bandwidth_for_large_signals() -> None:
    diagram = Diagram.alone(blocks.INTD(form="literal"))
    linearizer = diagram.linearizer()
    small = linearizer.model("r", "r1")
    assert dc_gain(small)[0, 0] == pytest.approx(0.2334493157, rel=1e-9)
    assert bandwidth(small) == pytest.approx(3.659400591, rel=1e-9)
    large = linearizer.harmonic_response("r", "r1", [1.0, 3.522], amplitude=10.0)
    assert bandwidth(large) == pytest.approx(3.522, abs=5e-4)
    assert dc_gain(large)[0, 0] == pytest.approx(0.2334493157, rel=1e-9)
    swept = estimate_response(diagram, "r", "r1", SineStream([1.0, 3.522], 10.0), engine=ENGINE)
    db, degrees = off(large.value, swept.value)
    assert db < 0.02
    assert degrees < 0.1


# --- sampled diagrams -----------------------------------------------------------------------------------------------


def test_a_sampled_observer_answers_sampled_sines_as_its_describing_function() -> None:
    T = 0.01
    diagram = Diagram("sampled")
    y = diagram.input("y")
    diagram.add("eso", blocks.DiscreteSMESO(form="current", period=T, gains=GAINS))
    diagram.wire("eso.u", diagram.add("none", blocks.Constant(value=0.0, unit="V")).y)
    diagram.wire("eso.y", y)
    omega = np.array([2.0, 11.0, 31.0])
    made = diagram.linearizer().harmonic_response("y", ["eso.z1", "eso.z3"], omega, amplitude=0.5)
    assert made.dt == T
    swept = estimate_response(diagram, "y", ["eso.z1", "eso.z3"], SineStream(omega, 0.5), engine=ENGINE)
    held = (1.0 - np.exp(-1j * omega * T)) / (1j * omega * T)
    db, degrees = off(made.value * held, swept.value)
    assert db < OBSERVER_DB
    assert degrees < OBSERVER_DEG


# --- what cannot be had ---------------------------------------------------------------------------------------------


def test_a_law_that_moves_a_mean_which_nothing_holds_is_refused() -> None:
    diagram = Diagram("drift", library=[Square])
    u = diagram.input("u")
    diagram.add("law", Square())
    diagram.add("sum", blocks.Sum())
    diagram.add("integral", blocks.Integrator())
    diagram.wire("sum.u1", u)
    diagram.wire("sum.u2", "integral.y")
    diagram.wire("law.u", "sum.y")
    diagram.wire("integral.u", "law.y")
    with pytest.raises(AnalysisError, match=r"E704 law\.y: shifts the mean: its mean is .* for a sine, but 0 at rest"):
        diagram.linearizer().harmonic_response("u", "integral.y", [1.0], amplitude=1.0)


def test_amplitudes_and_frequencies_that_cannot_be_meant_are_refused() -> None:
    linearizer = loop_around(blocks.Sign(), [1.0], [1.0, 1.0]).linearizer()
    for amplitude in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(UsageError, match=r"E501 amplitude: must be above 0"):
            linearizer.harmonic_response("r", "plant.y", [1.0], amplitude=amplitude)
    for omega in (-1.0, math.nan, math.inf):
        with pytest.raises(UsageError, match=r"E501 omega: must be numbers in rad/s, 0 or more"):
            linearizer.harmonic_response("r", "plant.y", [omega], amplitude=1.0)


def test_at_zero_frequency_stands_what_a_slow_sine_gives() -> None:
    linearizer = loop_around(blocks.Saturation(lower=-0.5, upper=0.5), [2.0], [1.0, 1.0]).linearizer()
    made = linearizer.harmonic_response("r", "plant.y", [0.0, 0.5], amplitude=3.0)
    N = describing.saturation(-0.5, 0.5, made.amplitudes["law.u"][0]).gain.real
    assert made.value[0, 0] == pytest.approx(2.0 * N / (1.0 + 2.0 * N), rel=1e-9)
    behind = Diagram.alone(blocks.Integrator()).linearizer().harmonic_response("u", "y", [0.0], amplitude=1.0)
    assert np.isinf(behind.value[0, 0])


def test_a_harmonic_response_is_data_for_python_control_and_answers_at_other_frequencies() -> None:
    linearizer = loop_around(blocks.Saturation(lower=-0.5, upper=0.5), [2.0], [1.0, 1.0]).linearizer()
    made = linearizer.harmonic_response("r", ["plant.y", "law.y"], [0.3, 1.0], amplitude=3.0)
    data = made.frd()
    assert data.output_labels == ["plant_y", "law_y"] or data.noutputs == 2
    assert np.allclose(data.frdata[:, 0], made.value)
    again = made.response([1.0, 7.0])
    assert np.allclose(again[:, 0, 0], made.value[:, 1], rtol=EXACT)
    assert again.shape == (2, 1, 2)


def test_a_signal_that_is_opened_has_no_loop_around_it() -> None:
    linearizer = loop_around(blocks.Saturation(lower=-0.5, upper=0.5), [2.0], [1.0, 1.0]).linearizer()
    made = linearizer.harmonic_response("error.y", "plant.y", [1.0], amplitude=2.0, openings="error.y")
    N = describing.saturation(-0.5, 0.5, 2.0).gain
    assert made.value[0, 0] == pytest.approx(2.0 * N / (1.0 + 1.0j), rel=EXACT)
