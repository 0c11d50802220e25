"""Reports on observers and loops, and the commands that print them: figures of the paper's motor from its diagrams."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

from blocks import LESO, SMESO, Constant, Diagram, DiscreteESO, ScheduledESO
from blocks.analysis import loop_report, observer_report
from blocks.cli import main
from blocks.frequency.margins import IN_JSON
from blocks.text.errors import AnalysisError, UsageError
from tests.support.places import ROOT

FOLDER = ROOT / "diagrams" / "analysis"
DIGITS = 1e-9  # what rounding to ten digits leaves
LINEAR = {
    "leso_pd": {
        "gains": (30.4, 523.4, 2970.8),
        "poles": (-8.970816244, -10.71459188 - 14.70918934j, -10.71459188 + 14.70918934j),
        "bandwidth": 9.856422606, "h2": 422.4727884,
        "gain": 3.041673242, "phase_deg": 33.75572796, "crossover": 14.80974098, "delay": 0.03978115,
        "Ms": 2.043559704, "Mt": 1.739486522, "reference": 5.809135471, "disturbance": 0.14439167, "noise": 350.2185917,
    },
    "smeso_gains_pd": {
        "gains": (30.4, 513.4, 1570.8),
        "poles": (-3.812241604, -13.2938792 - 15.33994189j, -13.2938792 + 15.33994189j),
        "bandwidth": 3.846405550, "h2": 212.4239518,
        "gain": 3.480644231, "phase_deg": 40.19235560, "crossover": 13.83537364, "delay": 0.05070257,
        "Ms": 1.824165977, "Mt": 1.479125861, "reference": 5.246648132, "disturbance": 0.13124097, "noise": 297.7099056,
    },
}  # fmt: skip
"""Known figures to the digits that they were printed with; `disturbance` is that of the torque on the motor's side."""
RATIO = 3.0  # of the gear: the torque on the wheel is so many times that on the motor's side


def loaded(name: str) -> Diagram:
    return Diagram.load(FOLDER / f"{name}.json")


def described(amplitude: float) -> float:
    """Describing function of the SMESO's law in closed form (gamma functions)."""

    def power(a: float) -> float:
        return 2 / math.sqrt(math.pi) * math.gamma(a / 2 + 1) / math.gamma(a / 2 + 1.5) * amplitude ** (a - 1)

    return 0.6265 * power(0.8433) + 0.5878 * power(1.04078)


def observer_witness(gains: tuple[float, ...], N: float = 1.0) -> tuple[Any, float, float]:
    """Poles, bandwidth of f -> z3 and noise gain of an observer of order 2, from its polynomial."""
    b1, b2, b3 = (N * g for g in gains)
    roots = np.roots([1, b1, b2, b3])
    h2 = b3 * math.sqrt(b2 / (2 * (b1 * b2 - b3)))
    # |b3/Delta(j w)|^2 = 1/2 is a polynomial in w^2.
    squares = np.roots([1.0, b1**2 - 2 * b2, b2**2 - 2 * b1 * b3, b3**2 - 2 * b3**2])
    w = min(math.sqrt(x.real) for x in squares if abs(x.imag) < 1e-9 * abs(x) and x.real > 0)
    return sorted(roots, key=lambda p: (abs(p), p.imag)), w, h2


@pytest.mark.parametrize("name", LINEAR)
def test_a_linear_observer_has_the_known_poles_bandwidth_and_noise_gain(name: str) -> None:
    known = LINEAR[name]
    row = observer_report(loaded(name), "eso", amplitudes=[0.1]).rows[0]
    poles, width, h2 = observer_witness(known["gains"])
    assert row.N == 1.0
    np.testing.assert_allclose(row.poles, known["poles"], rtol=DIGITS)
    np.testing.assert_allclose(row.poles, poles, rtol=1e-12)
    assert row.bandwidth_f == pytest.approx(known["bandwidth"], rel=DIGITS)
    assert row.bandwidth_f == pytest.approx(width, rel=1e-12)
    assert row.noise_h2 == pytest.approx(known["h2"], rel=DIGITS)
    assert row.noise_h2 == pytest.approx(h2, rel=1e-12)


@pytest.mark.parametrize("name", LINEAR)
def test_a_loop_has_the_known_margins_and_peaks(name: str) -> None:
    known = LINEAR[name]
    made = loop_report(loaded(name), "control.u", "motor.omega", measurement="eso.y", reference="r", disturbance="tau")
    assert made.margins.stable
    for key in ("gain", "phase_deg", "crossover", "Ms", "Mt"):
        assert getattr(made.margins, key) == pytest.approx(known[key], rel=DIGITS), key
    assert made.margins.delay == pytest.approx(known["delay"], rel=2e-7)  # seven digits are known
    assert made.bandwidth == pytest.approx(known["reference"], rel=DIGITS)
    assert RATIO * made.peak_disturbance[0] == pytest.approx(known["disturbance"], rel=5e-8)
    assert made.peak_noise[0] == pytest.approx(known["noise"], rel=DIGITS)
    gain, phase, _, crossover = control.margin(made.loop)
    assert (made.margins.gain, made.margins.phase_deg) == pytest.approx((gain, phase), rel=1e-9)
    assert made.margins.crossover == pytest.approx(crossover, rel=1e-9)


def test_a_loop_behind_a_slow_differentiator_is_stable_when_it_is_sampled_as_usual() -> None:
    """A hold before the plant: by python-control's exact sampling of the loop."""
    amplitude = {"control_right.nlsef.e": 0.01, "control_right.eso.e": 0.01}
    diagram = Diagram.load(ROOT / "diagrams" / "paper" / "iadrc.json")
    made = loop_report(diagram, "control_right.u", "motor_right.omega", reference="speed.y", amplitude=amplitude)
    assert made.bandwidth is not None
    assert made.margins.bandwidth is not None
    assert made.bandwidth < made.margins.bandwidth / 5
    assert made.sampling is not None

    def largest(period: float) -> float:
        sampled = control.sample_system(control.ss(made.loop), period, method="zoh")
        return float(np.abs(control.poles(control.feedback(sampled, 1))).max())

    assert largest(made.sampling.usual[1]) < 1.0
    assert largest(2 * math.pi / (20 * made.bandwidth)) > 1.0  # as the reference's bandwidth would have it


@pytest.mark.parametrize("amplitude", [1e-4, 1e-3, 1e-2, 0.1, 1.0])
def test_a_controller_at_the_usual_periods_is_stable_with_a_period_for_its_computation(amplitude: float) -> None:
    given = {"control_right.nlsef.e": amplitude, "control_right.eso.e": amplitude}
    diagram = Diagram.load(ROOT / "diagrams" / "paper" / "iadrc.json")
    made = loop_report(diagram, "control_right.u", "motor_right.omega", amplitude=given)
    assert made.sampling is not None
    assert made.margins.delay is not None
    period = made.sampling.usual[1]
    assert period <= made.margins.delay / 3
    sampled = control.sample_system(control.ss(made.loop), period, method="zoh")
    late = sampled * control.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]], period)
    assert np.abs(control.poles(control.feedback(late, 1))).max() < 1.0


def test_the_loop_is_that_of_the_closed_form_of_the_controller() -> None:
    kp, kd, b1, b2, b3 = 144.6642, 25.5574, 30.4, 523.4, 2970.8
    Ra, La, kb, kt, n, Jeq, Beq = 0.1557, 0.82, 1.185, 1.1882, 3, 0.2752, 0.3922
    b0 = kt / (La * Jeq * n)
    s = 1j * np.geomspace(0.1, 300, 50)
    feedback = ((kp * b1 + kd * b2 + b3) * s**2 + (kp * b2 + kd * b3) * s + kp * b3) / (
        b0 * s * (s**2 + (b1 + kd) * s + (b2 + kd * b1 + kp))
    )
    motor = kt / ((Jeq * n * s + Beq * n) * (La * s + Ra) + kt * kb * n)
    loop = loaded("leso_pd").linearizer().loop("control.u")
    np.testing.assert_allclose(loop(s), feedback * motor, rtol=1e-11)


def test_the_smeso_has_the_closed_form_of_its_describing_function() -> None:
    printed = {1e-3: 2.347994160, 1e-2: 1.813412572, 0.1: 1.458138387, 1.0: 1.229572531}
    made = observer_report(loaded("smeso_pd"), "eso", amplitudes=printed)
    assert made.signal == "eso.e"
    for row in made.rows:
        gain = row.N
        assert gain == pytest.approx(printed[row.amplitude], rel=DIGITS)
        assert gain == pytest.approx(described(row.amplitude), rel=1e-11)
        poles, width, h2 = observer_witness((30.4, 513.4, 1570.8), described(row.amplitude))
        np.testing.assert_allclose(row.poles, poles, rtol=1e-10)
        assert row.bandwidth_f == pytest.approx(width, rel=1e-10)
        assert row.noise_h2 == pytest.approx(h2, rel=1e-10)


def test_amplitude_hardly_moves_the_bandwidth_of_the_smeso_but_its_noise_gain() -> None:
    low, high = observer_report(loaded("smeso_pd"), "eso", amplitudes=[1e-6, 10.0]).rows
    assert (low.bandwidth_f, high.bandwidth_f) == pytest.approx((3.7182, 3.8323), abs=5e-5)
    assert low.noise_h2 > 1.5 * high.noise_h2


def test_an_observer_alone_has_the_same_figures_as_in_a_loop() -> None:
    alone = observer_report(Diagram.alone(LESO()), "LESO", amplitudes=[1.0]).rows[0]
    inside = observer_report(loaded("leso_pd"), "eso", amplitudes=[1.0]).rows[0]
    np.testing.assert_allclose(alone.poles, inside.poles, rtol=1e-12)
    assert alone.bandwidth_f == pytest.approx(inside.bandwidth_f, rel=1e-12)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_an_observer_tuned_by_bandwidth_is_told_as_that_bandwidth(order: int) -> None:
    row = observer_report(Diagram.alone(LESO(order=order, bandwidth=20.0)), "LESO", amplitudes=[1.0]).rows[0]
    assert row.gao == pytest.approx(20.0, rel=1e-9)
    # n + 1 equal poles are known to eps^(1/(n+1)) only.
    np.testing.assert_allclose(row.poles, -20.0, rtol=4 * np.finfo(float).eps ** (1 / (order + 1)) * 20)


def test_a_sampled_observer_is_told_in_continuous_poles() -> None:
    loop = Diagram("sampled")
    eso = loop.add("eso", DiscreteESO(period=0.001, bandwidth=30.0, b0=2.0))
    zero = loop.add("zero", Constant(value=0.0))
    loop.wire(eso.y, zero.y)
    loop.wire(eso.u, zero.y)
    row = observer_report(loop, "eso", amplitudes=[1.0]).rows[0]
    np.testing.assert_allclose(np.array(row.poles), -30.0, rtol=1e-3)
    # For a short period it is the continuous one, but for what a period changes.
    assert row.bandwidth_f == pytest.approx(30.0 * math.sqrt(2 ** (1 / 3) - 1), rel=0.02)


@pytest.mark.parametrize(
    ("block", "given", "code", "says"),
    [
        ("motor", {}, "E501", "is not an observer"),
        ("esoo", {}, "E501", "is not a block"),
        ("control", {}, "E501", "control.law"),
        ("eso", {"amplitudes": [0.0]}, "E501", "must be above 0"),
        ("eso", {"amplitudes": [math.nan]}, "E501", "must be above 0"),
        ("eso", {"amplitudes": []}, "E501", "must not be empty"),
    ],
)
def test_what_is_no_observer_is_refused(block: str, given: dict[str, Any], code: str, says: str) -> None:
    with pytest.raises(UsageError, match=says) as caught:
        observer_report(loaded("smeso_pd"), block, **given)
    assert caught.value.code == code


def test_the_loop_with_the_smeso_at_rest_has_no_report_without_an_amplitude() -> None:
    with pytest.raises(AnalysisError, match=r'amplitude=\{"eso.e": A\}'):
        loop_report(loaded("smeso_pd"), "control.u", "motor.omega")
    made = loop_report(loaded("smeso_pd"), "control.u", "motor.omega", amplitude={"eso.e": 1e6})
    assert made.margins.stable


# --- commands ------------------------------------------------------------------------------------------------------


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    status = main(list(arguments))
    out, err = capsys.readouterr()
    return status, out, err


@pytest.mark.parametrize("name", LINEAR)
def test_linearize_prints_one_object(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = said(capsys, "linearize", str(FOLDER / f"{name}.json"), "--loop", "control.u", "--json")
    made = json.loads(out)
    assert status == 0
    assert list(made)[:5] == ["poles", "zeros", "dc_gain", "bandwidth", "margins"]
    assert list(made["margins"]) == [
        "gain",
        "gain_low",
        "phase_deg",
        "crossover",
        "delay",
        "modulus",
        "Ms",
        "Mt",
        "disk",
        "bandwidth",
        "stable",
        "border",
    ]
    for key in ("gain", "phase_deg", "crossover", "Ms", "Mt"):
        assert made["margins"][key] == pytest.approx(LINEAR[name][key], rel=DIGITS)
    assert made["margins"]["gain_low"] is None
    assert made["margins"]["modulus"] == pytest.approx(1.0 / LINEAR[name]["Ms"], rel=DIGITS)
    assert made["bandwidth"] == made["margins"]["bandwidth"]
    table = said(capsys, "linearize", str(FOLDER / f"{name}.json"), "--loop", "control.u")[1]
    assert f"bandwidth of T  {made['bandwidth']:.5g} rad/s" in table
    assert f"modulus margin  {made['margins']['modulus']:.5g} at" in table
    assert made["dc_gain"] is None  # an integrator
    assert made["margins"]["stable"] is True


def test_linearize_tells_a_transfer(capsys: pytest.CaptureFixture[str]) -> None:
    path = str(FOLDER / "leso_pd.json")
    status, out, _ = said(capsys, "linearize", path, "--from", "r", "--to", "motor.omega", "--json")
    made = json.loads(out)
    assert status == 0
    assert made["dc_gain"] == pytest.approx(1.0, rel=1e-12)
    assert made["bandwidth"] == pytest.approx(LINEAR["leso_pd"]["reference"], rel=DIGITS)
    assert made["margins"] == {
        **dict.fromkeys(IN_JSON),
        "stable": True, "border": False,
    }  # fmt: skip
    status, out, _ = said(capsys, "linearize", path, "--from", "r", "--to", "motor.omega")
    assert "bandwidth  5.8091355 rad/s" in out


def test_linearize_opens_loops_and_takes_amplitudes_and_units(capsys: pytest.CaptureFixture[str]) -> None:
    path = str(FOLDER / "smeso_pd.json")
    arguments = ("linearize", path, "--from", "eso.y", "--to", "eso.z3", "--open", "eso.y", "--open", "eso.u", "--json")
    status, out, err = said(capsys, *arguments)
    assert (status, json.loads(out)["code"]) == (2, "E701")
    assert "--amplitude eso.e=A" in err
    for text in ("0.1", "0.1 rad/s", "5.729577951308232 deg/s"):
        status, out, _ = said(capsys, *arguments, "--amplitude", f"eso.e={text}")
        poles = np.array([complex(*pair) for pair in json.loads(out)["poles"]])
        assert status == 0
        expected = observer_witness((30.4, 513.4, 1570.8), described(0.1))[0]
        np.testing.assert_allclose(sorted(poles, key=lambda p: (abs(p), p.imag)), expected, rtol=1e-10)


def test_observer_prints_one_object(capsys: pytest.CaptureFixture[str]) -> None:
    path = str(FOLDER / "smeso_pd.json")
    status, out, _ = said(capsys, "observer", path, "eso", "--amplitudes", "0.001", "1", "--json")
    first, last = json.loads(out)["observer"]
    assert status == 0
    assert first["N"] == pytest.approx(2.347994160, rel=DIGITS)
    assert last["N"] == pytest.approx(1.229572531, rel=DIGITS)
    assert {"amplitude", "N", "poles", "bandwidth_f_z3", "noise_h2_z3"} <= set(first)
    status, listed, _ = said(capsys, "observer", path, "eso", "--amplitudes", "0.001,1", "--json")
    assert listed == out
    status, text, _ = said(capsys, "observer", str(FOLDER / "leso_pd.json"), "eso")
    assert "linear: the same at every amplitude" in text


@pytest.mark.parametrize("kind", ["bode", "nyquist", "nichols", "step", "poles"])
def test_linearize_draws(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "loop.svg"
    arguments = ("linearize", str(FOLDER / "leso_pd.json"), "--loop", "control.u", "--plot", str(picture))
    assert said(capsys, *arguments, "--figure", kind)[0] == 0
    assert picture.read_text("utf-8").lstrip().startswith("<?xml")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "needs either --from and --to, or --loop alone"),
        (("--from", "r"), "needs either --from and --to"),
        (("--loop", "control.u", "--from", "r"), "or --loop alone"),
        (("--loop", "control.w"), "there is no such signal. Did you mean"),
        (("--from", "r", "--to", "motor.omega", "--amplitude", "eso.e"), "is not NAME=VALUE"),
        (("--from", "r", "--to", "motor.omega", "--amplitude", "eso.e=1"), "no nonlinear law reads this signal"),
        (("--from", "r", "--to", "motor.omega", "--amplitude", "eso.e=much"), "is not a number"),
        (("--loop", "control.u", "--plot", "loop.bmp"), "is not a format of pictures"),
        (("--loop", "control.u", "--at", "-1"), "lies before the start"),
    ],
)
def test_what_linearize_cannot_mean_is_told(
    arguments: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, _, err = said(capsys, "linearize", str(FOLDER / "leso_pd.json"), *arguments)
    assert status == 2
    assert says in err
    assert "Traceback" not in err


def test_the_observer_in_the_paper_s_robot_is_found_by_its_path(capsys: pytest.CaptureFixture[str]) -> None:
    path = str(FOLDER.parent / "paper" / "iadrc.json")
    status, out, _ = said(capsys, "observer", path, "control_right.eso", "--amplitudes", "0.1", "--json")
    assert status == 0
    assert json.loads(out)["observer"][0]["N"] == pytest.approx(1.458138387, rel=DIGITS)


def test_a_report_of_a_smeso_of_another_order_has_its_own_estimates() -> None:
    made = observer_report(Diagram.alone(SMESO(order=1, gains=[10.0, 25.0])), "SMESO", amplitudes=[1.0])
    assert "bandwidth_f_z2" in made.as_json()["observer"][0]
    assert "f -> z2" in str(made)


def test_the_cure_for_laws_of_several_signals_is_a_call_that_works() -> None:
    made = Diagram.alone(ScheduledESO(order=2, b0=1.0))
    with pytest.raises(AnalysisError) as refused:
        observer_report(made, "ScheduledESO")
    assert 'diagram.linearize("ScheduledESO.y", "ScheduledESO.z1")' in str(refused.value)
    model = made.linearize("ScheduledESO.y", "ScheduledESO.z1", inputs={"bandwidth": 20.0})
    assert np.linalg.eigvals(model.A) == pytest.approx(-20.0, rel=1e-3)
