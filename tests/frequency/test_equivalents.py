"""The b0 of a plant and the PID in a controller, against formulas by hand and python-control."""

from typing import Any

import control
import numpy as np
import pytest

from blocks import ADRC, Diagram, PMDCMotor, TransferFunction
from blocks.analysis import (
    adrc_gains,
    bandwidth_gains,
    controller,
    equivalent_pid,
    gang_of_six,
    high_frequency_gain,
    margins,
)
from blocks.text.errors import AnalysisError, UsageError


def from_y_to_u(order: int = 2, b0: float = 1.755, **words: Any) -> Any:
    loop = Diagram("loop")
    loop.add("control", ADRC(order, b0=b0, omega_c=6.0, omega_o=30.0, **words))
    for name in ("r", "y"):
        loop.wire(f"control.{name}", loop.input(name))
    loop.output("u", "control.u")
    return loop.linearize("y", "u")


def test_b0_of_the_motor_is_that_of_its_equations() -> None:
    kt, La, Jeq, n = 1.1882, 0.82, 0.2752, 3.0
    order, b0 = high_frequency_gain(Diagram.alone(PMDCMotor(kt=kt, La=La, Jeq=Jeq, n=n)).linearize("v", "omega"))
    assert order == 2
    assert b0 == pytest.approx(kt / (La * Jeq * n), rel=1e-12)


@pytest.mark.parametrize("as_states", [False, True])
@pytest.mark.parametrize("speed", [0.01, 1.0, 100.0])
@pytest.mark.parametrize(
    ("num", "den", "order", "b0"),
    [
        ([3.0], [2.0, 1.0], 1, 1.5),
        ([-0.5, 1.0], [1.0, 2.0, 1.0], 1, -0.5),
        ([7.0], [1.0, 3.0, 3.0, 1.0], 3, 7.0),
        ([0.0, 25.0], [1.0, 0.2, 25.0, 0.0, 0.0], 4, 25.0),
        ([2.0, 1.0], [1.0, 1.0], 0, 2.0),
    ],
)
def test_the_gain_at_high_frequency_is_that_of_the_coefficients(
    num: list[float], den: list[float], order: int, b0: float, speed: float, as_states: bool
) -> None:
    """Also in another time scale, and of states in other coordinates."""
    n = len(den) - 1
    tops = [c * speed ** (len(num) - 1 - k - n) / den[0] for k, c in enumerate(num)]
    system: Any = control.tf(tops, [c * speed**-k / den[0] for k, c in enumerate(den)])
    if as_states:
        system = control.ss(system)
        T = np.random.default_rng(1).normal(size=(n, n)) if speed == 1 else np.eye(n)[::-1]
        system = control.ss(np.linalg.solve(T, system.A @ T), np.linalg.solve(T, system.B), system.C @ T, system.D)
    found = high_frequency_gain(system)
    assert found.order == order
    assert found.b0 == pytest.approx(b0 / speed**order, rel=1e-6)


def test_dense_matrices_give_the_order_or_are_refused() -> None:
    """Turned by orthogonal matrices, whose products leave rounding where a canonical form has zeros."""
    random, refused = np.random.default_rng(7), 0
    for _ in range(200):
        n = int(random.integers(2, 7))
        order = int(random.integers(1, n + 1))
        poles, zeros = (-np.exp(random.uniform(-0.7, 4, size)) for size in (n, n - order))
        b0 = float(random.normal() * 100)
        system: Any = control.ss(control.tf(b0 * np.atleast_1d(np.poly(zeros)), np.poly(poles)))
        Q = np.linalg.qr(random.normal(size=(n, n)))[0]
        try:
            found = high_frequency_gain(control.ss(Q.T @ system.A @ Q, Q.T @ system.B, system.C @ Q, 0))
        except AnalysisError:
            refused += 1
            continue
        assert found.order == order
        assert found.b0 == pytest.approx(b0, rel=0.01)
    assert refused < 30


def test_what_has_no_gain_at_high_frequency_is_refused() -> None:
    with pytest.raises(AnalysisError, match=r"E705 high_frequency_gain: u does not reach y"):
        high_frequency_gain(control.ss(-1.0, 0.0, 1.0, 0.0))
    with pytest.raises(AnalysisError, match=r"E705 .* unknown"):
        high_frequency_gain(control.frd([1.0, 0.5], [1.0, 2.0]))
    with pytest.raises(AnalysisError, match=r"E705 .* improper"):
        high_frequency_gain(control.tf([1.0, 0.0, 0.0], [1.0, 1.0]))
    with pytest.raises(UsageError, match=r"E501 .* sampled"):
        high_frequency_gain(control.tf([1.0], [1.0, -0.5], 0.1))
    with pytest.raises(UsageError, match=r"E501 .* 2 inputs"):
        high_frequency_gain(control.ss(-1.0, [[1.0, 2.0]], 1.0, [[0.0, 0.0]]))


@pytest.mark.parametrize("b0", [1.755, -0.3])
def test_an_adrc_of_order_1_is_a_pi_controller_with_a_filter(b0: float) -> None:
    k1, (b1, b2) = 6.0, bandwidth_gains(1, 30.0)
    found = equivalent_pid(from_y_to_u(1, b0))
    assert found.kp == pytest.approx((k1 * b1 + b2) / (b0 * (k1 + b1)), rel=1e-12)
    assert found.ki == pytest.approx(k1 * b2 / (b0 * (k1 + b1)), rel=1e-12)
    assert (found.kd, found.Td) == (0.0, 0.0)
    assert found.filter == pytest.approx((1 / (k1 + b1), 1.0), rel=1e-12)
    assert found.Ti == pytest.approx(1 / k1 + b1 / b2, rel=1e-12)


@pytest.mark.parametrize(
    ("order", "words"),
    [(1, {}), (2, {}), (1, {"observer": "reduced"}), (2, {"observer": "reduced"}), (2, {"by": "error"})],
)
def test_the_pid_has_the_response_of_the_controller(order: int, words: dict[str, Any]) -> None:
    model = from_y_to_u(order, **words)
    found, s = equivalent_pid(model), 1j * np.geomspace(0.01, 1e4, 50)
    C = (found.kp + found.ki / s + found.kd * s) / np.polyval(found.filter, s)
    assert np.max(np.abs(C / -np.asarray(model(s)) - 1)) < 1e-11
    text = str(found)
    assert f"kp {found.kp:.6g}, ki {found.ki:.6g}, kd {found.kd:.6g}" in text
    assert ("with damping" in text) == (order == 2)


def test_modes_that_cancel_are_no_part_of_the_pid() -> None:
    """Beside the PI controller, two filters that y does not move, and an integrator that cancels."""
    pi = control.ss(control.tf([3.0, 4.0], [1.0, 0.0]))
    model = control.append(-pi, control.ss(control.tf([5.0], [1.0, 5.0])), control.ss(control.tf([1.0], [1.0, 7.0])))
    channel = control.ss(model.A, model.B[:, :1], model.C[:1], model.D[:1, :1], remove_useless_states=False)
    found = equivalent_pid(channel)
    assert (found.kp, found.ki, found.kd, found.filter) == (pytest.approx(3), pytest.approx(4), 0, (1.0,))
    with pytest.raises(AnalysisError, match="has no integrator"):
        equivalent_pid(-control.tf([3.0, 4.0, 0.0], [0.1, 1.0, 0.0]))


def test_controllers_that_are_no_pid_are_refused() -> None:
    cases: tuple[tuple[dict[str, Any], str], ...] = (
        ({"order": 3}, "3 zeros"),
        ({"observer": "generalized"}, "several integrators"),
    )
    for words, why in cases:
        model = from_y_to_u(**words)
        with pytest.raises(AnalysisError, match=f"E705 equivalent_pid: .*{why}"):
            equivalent_pid(model)
    with pytest.raises(AnalysisError, match=r"E705 .* has no integrator"):
        equivalent_pid(Diagram.alone(TransferFunction()).linearize("u", "y"))


def test_the_gang_of_six_shows_what_the_reference_does() -> None:
    """Its six curves, against python-control's feedback of the parts."""
    plant = control.tf([1.755], [1.0, 2.0, 1.0])
    of = controller(2, adrc_gains(2, 6.0), bandwidth_gains(2, 30.0), 1.755)
    figure: Any = gang_of_six(plant, of.system)
    C, F = of.feedback, of.prefilter
    S = 1 / (1 + plant * C)
    expected = (S, plant * C * S, plant * S, C * S, plant * C * F * S, C * F * S)
    for axis, system in zip(figure.axes, expected, strict=True):
        line = next(one for one in axis.get_lines() if len(one.get_xdata()) > 10)
        gain = 20 * np.log10(np.abs(system(1j * line.get_xdata())))
        assert line.get_ydata() == pytest.approx(gain, abs=1e-6)
    assert f"{margins(of.loop(plant)).Ms:.4g} at" in " ".join(t.get_text() for t in figure.axes[0].texts)
    assert "UNSTABLE" not in str([t.get_text() for axis in figure.axes for t in axis.texts])
    fast: Any = gang_of_six(100 * plant, of.system)
    assert (control.feedback(100 * plant * C).poles().real > 0).any()
    assert all("UNSTABLE" in str([t.get_text() for t in axis.texts]) for axis in fast.axes)
    with pytest.raises(UsageError, match=r"E501 gang_of_six: the controller has 1 inputs"):
        gang_of_six(plant, C)
