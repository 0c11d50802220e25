"""The numbers of the gallery, computed once more without blocks: by matrix exponentials between ticks, and by SciPy."""

from __future__ import annotations

import math
import re
from typing import Any

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_lyapunov

from blocks import Diagram
from blocks.analysis import margins
from blocks.compile.toolchain.compiler import find_compiler
from tests.support.places import ROOT

GALLERY = ROOT / "diagrams" / "gallery"
PAGES = ROOT / "docs" / "gallery"
TIGHT: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-12, "engine": "native" if find_compiler() else "reference"}

Array = np.ndarray[Any, Any]


def test_every_page_has_a_card_and_its_place_in_the_navigation() -> None:
    text = (PAGES / "index.md").read_text(encoding="utf-8")
    cards, shown = (
        re.findall(r"^(\w+)$", text[text.index(mark) :].partition("\n```\n")[0], re.MULTILINE)
        for mark in ("```{cards}", "```{toctree}")
    )
    assert cards == shown
    assert sorted(cards) == sorted(path.stem for path in PAGES.glob("*.md") if path.stem != "index")


def held(A: Array, B: Array, h: float) -> tuple[Array, Array]:
    """x(t + h) = F x(t) + G u, for dx/dt = A x + B u with a constant u."""
    n, m = B.shape
    made = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * h)
    return made[:n, :n], made[:n, n:]


class Controller:
    """DiscretePID, as its page says it, with c = 0."""

    def __init__(self, kp: float, ki: float, period: float, low: float, high: float, kd: float = 0, Tf: float = 0):
        self.kp, self.ki, self.kd, self.Tf, self.period, self.limits = kp, ki, kd, Tf, period, (low, high)
        self.integral, self.slope, self.before = 0.0, 0.0, None

    def tick(self, r: float, y: float) -> float:
        if self.kd and self.before is not None:
            self.slope = (self.Tf * self.slope - self.kd * (y - self.before)) / (self.Tf + self.period)
        self.before = y
        v = self.kp * (r - y) + self.integral + self.slope
        u = min(max(v, self.limits[0]), self.limits[1])
        if self.ki:
            Tt = max(self.kp / self.ki, self.period)
            self.integral += self.ki * self.period * (r - y) + self.period / Tt * (u - v)
        return u


@pytest.mark.parametrize("counts", [4096, 512])
def test_the_servo_turns_as_matrix_exponentials_between_its_ticks_say(counts: int) -> None:
    R, L, k, J, b, h = 0.299, 0.082e-3, 0.0302, 3e-5, 5e-6, 1e-4
    A = np.array([[-b / J, k / J, 0], [-k / L, -R / L, 0], [1, 0, 0]])
    F, G = held(A, np.array([[0, -1 / J], [1 / L, 0], [0, 0]]), h)
    angle = Controller(40, 0, 4e-3, -100, 100)
    speed, current = Controller(0.2, 10, 1e-3, -6, 6), Controller(0.246, 897, h, -24, 24)
    x, before, theta, i = np.zeros(3), 0.0, [], []
    for tick in range(4000):
        if tick % 10 == 0:
            count = math.floor(x[2] / (2 * math.pi / counts) + 0.5) * 2 * math.pi / counts
            if tick % 40 == 0:
                omega = angle.tick(2 * math.pi if tick >= 200 else 0.0, count)
            amps = speed.tick(omega, (count - before) / 1e-3)
            before = count
        theta.append(x[2])
        i.append(x[1])
        x = F @ x + G @ [current.tick(amps, x[1]), 0.1 if tick >= 2500 else 0.0]
    made = Diagram.load(GALLERY / "servo.json").run(
        parameters={"counts": counts}, every=h, log=["shaft.y", "motor.i"], **TIGHT
    )
    np.testing.assert_allclose(made["shaft.y"][:4000], theta, atol=1e-6)
    np.testing.assert_allclose(made["motor.i"][:4000], i, atol=1e-4)


def test_the_buck_converter_runs_as_matrix_exponentials_between_its_edges_say() -> None:
    L, R, C, T = 22e-6, 0.02, 100e-6, 5e-6
    A = np.array([[-R / L, -1 / L], [1 / C, -0.4 / C]])
    B = np.array([[1 / L, 0], [0, -1 / C]])
    pid = Controller(0.35, 5200, T, 0, 0.95, kd=1.15e-5, Tf=2e-6)
    x, rows, peaks = np.zeros(2), [], []
    for tick in range(300):
        rows.append(x)
        load = 2.0 if tick >= 200 else 0.0
        duty = pid.tick(min(5.0, 1e4 * tick * T), x[1])
        for span, v in ((duty * T, 12.0), (T - duty * T, 0.0)):
            F, G = held(A, B, span)
            x = F @ x + G @ [v, load]
            peaks.append(x[0])
    made = Diagram.load(GALLERY / "buck.json").run(every=T, log=["coil.y", "capacitor.y"], **TIGHT)
    np.testing.assert_allclose(made["coil.y"][:300], [row[0] for row in rows], atol=1e-6)
    np.testing.assert_allclose(made["capacitor.y"][:300], [row[1] for row in rows], atol=1e-6)
    assert np.ptp(peaks[-20:]) == pytest.approx(0.666, abs=5e-4)  # as the page says


def test_the_pendulum_is_swung_up_and_caught_as_scipy_says() -> None:
    M, m, l, I, b, g = 0.5, 0.2, 0.3, 0.006, 0.1, 9.81
    J = I + m * l * l
    D = (M + m) * J - (m * l) ** 2
    A = np.array(
        [
            [0, 1, 0, 0],
            [0, -J * b / D, -((m * l) ** 2) * g / D, 0],
            [0, 0, 0, 1],
            [0, m * l * b / D, (M + m) * m * g * l / D, 0],
        ]
    )
    K = control.lqr(A, np.array([[0], [J / D], [0], [-m * l / D]]), np.diag([10, 1, 50, 1]), 0.1)[0][0]
    np.testing.assert_allclose(-K, [10, 10.264, 52.629, 9.81], rtol=1e-4)

    def rhs(t: float, s: Array) -> list[float]:
        x, v, theta, omega = s
        if np.cos(theta) >= np.cos(0.4):
            F = 10 * x + 10.264 * v + 52.629 * np.arctan2(np.sin(theta), np.cos(theta)) + 9.81 * omega
        else:
            E = J * omega**2 / 2 + m * g * l * (np.cos(theta) - 1)
            F = 15 * E * omega * np.cos(theta) - 4 * x - v
        F = np.clip(F, -3, 3)
        mass = [[M + m, m * l * np.cos(theta)], [m * l * np.cos(theta), J]]
        dv, domega = np.linalg.solve(mass, [F - b * v + m * l * omega**2 * np.sin(theta), m * g * l * np.sin(theta)])
        return [v, dv, omega, domega]

    theirs = solve_ivp(rhs, (0, 6), [0, 0, math.radians(170), 0], max_step=0.005, rtol=1e-8, dense_output=True).sol
    made = Diagram.load(GALLERY / "cart_pole.json").run(**TIGHT)
    # Each kink of the force costs SciPy, which does not look for it, some 1e-5.
    np.testing.assert_allclose(made["plant.theta"], theirs(made.t)[2], atol=1e-3)
    np.testing.assert_allclose(made["plant.x"], theirs(made.t)[0], atol=1e-3)
    out = np.flatnonzero(np.cos(theirs(made.t)[2]) < 1 - 0.02 * (1 + np.cos(math.radians(10))))
    assert made.t[out[-1] + 1] == pytest.approx(made.measures["caught"], abs=0.011)


def test_the_car_slows_down_on_a_slope_as_its_linear_equations_say() -> None:
    m, drag, slope, wc, wo = 1000, 50, math.radians(5), 1, 5
    # x = (v, z1, z2) from 20 m/s on, u = (wc (r - z1) - z2)/b0
    A = np.array([[-drag / m, -wc, -1], [2 * wo, -2 * wo - wc, 0], [wo**2, -(wo**2), 0]])
    F, G = held(A, np.array([[-9.81 * math.sin(slope)], [0], [0]]), 0.01)
    x, v = np.zeros(3), []
    for _ in range(2000):
        x = F @ x + G @ [1.0]
        v.append(x[0])
    made = Diagram.load(ROOT / "diagrams" / "adrc" / "cruise_control.json").run(**TIGHT)
    assert made.measures["dip"] == pytest.approx(-min(v), rel=1e-3)


def test_the_oven_swings_as_the_closed_forms_of_its_loop_say() -> None:
    """The loop is exp(-late s)/(2 made_for s): y' = (r - y(t - late))/(2 made_for), solved from delay to delay."""
    oven = Diagram.load(GALLERY / "oven.json")
    for ratio in (1, 2):
        # Time in delays; piece k is a polynomial of the time since its begin, and y(t) = 0 up to the first delay.
        piece, highest = np.poly1d([0.0]), 0.0
        for _ in range(20):
            end = piece(1.0)
            piece = np.polyint(ratio / 2 * (1 - piece), k=end) if highest or end else np.poly1d([ratio / 2, 0.0])
            highest = max(highest, *(piece(x) for x in np.linspace(0, 1, 2001)))
        made = oven.run(parameters={"late": 20 * ratio}, stop=300, **TIGHT)
        assert made.measures["overshoot"] == pytest.approx(highest - 1, abs=1e-4)
    margin = margins(oven.linearizer().delayed_loop("control.u"))
    assert 20 + margin.delay == pytest.approx(20 * math.pi, rel=1e-6)
    assert margin.gain == pytest.approx(math.pi, rel=1e-6)


def test_the_uncertain_motors_overshoot_as_scipy_says() -> None:
    R, L, kb, kt, n, b, J, b0 = 0.1557, 0.82, 1.185, 1.1882, 3, 0.3922, 0.5, 1.755

    def motor(omega: float, i: float, u: float) -> list[float]:
        return [(kt * i - b * n * omega) / (J * n), (u - R * i - kb * n * omega) / L]

    def pid(t: float, x: Array) -> list[float]:
        omega, i, integral, smoothed = x
        e = 2 - omega
        v = 20 * e + integral + 4 * (e - smoothed) / 0.02
        u = np.clip(v, -12, 12)
        return [*motor(omega, i, u), 30 * e + (u - v) / (20 / 30), (e - smoothed) / 0.02]

    def adrc(t: float, x: Array) -> list[float]:
        omega, i, z1, z2, z3 = x
        u = np.clip((64 * (2 - z1) - 16 * z2 - z3) / b0, -12, 12)
        e = omega - z1
        return [*motor(omega, i, u), z2 + 108 * e, z3 + b0 * u + 3888 * e, 46656 * e]

    made = Diagram.load(GALLERY / "uncertain.json").run(parameters={"inertia": J}, stop=6, **TIGHT)
    for name, rhs, size in (("pid", pid, 4), ("adrc", adrc, 5)):
        theirs = solve_ivp(rhs, (0, 5), np.zeros(size), method="RK45", rtol=1e-8, atol=1e-10, max_step=0.01)
        assert made.measures[f"overshoot_{name}"] == pytest.approx(max(0, theirs.y[0].max() / 2 - 1), abs=2e-4), name


def test_the_noise_of_both_observers_is_that_of_the_equation_of_lyapunov() -> None:
    made = Diagram.load(GALLERY / "observer.json").run(parameters={"torque": 0}, stop=60, **{**TIGHT, "rtol": 1e-6})
    for name, w in (("slow", 15.0), ("fast", 40.0)):
        gains = np.array([[3 * w], [3 * w**2], [w**3]])
        F, G = held(np.hstack([-gains, [[1, 0], [0, 1], [0, 0]]]), gains, 1e-3)
        deviation = math.sqrt(solve_discrete_lyapunov(F, G @ G.T * 0.0005**2)[2, 2])
        # Three standard errors of a deviation, where 60 s hold 60 w/3 independent values.
        assert np.std(made[f"eso_{name}.z3"][made.t > 1]) == pytest.approx(deviation, rel=3 / math.sqrt(2 * 60 * w / 3))


def test_the_rod_warms_as_the_matrix_exponential_and_the_series_of_the_heat_equation_say() -> None:
    n, length, a = 40, 0.3, 9.7e-5
    A = a * (n / length) ** 2 * (np.eye(n, k=1) + np.eye(n, k=-1) - np.diag([3.0, *[2.0] * (n - 2), 1.0]))
    F, G = held(A, a * (n / length) ** 2 * np.array([[2.0], *[[0.0]] * (n - 1)]), 5.0)
    x, rows = np.zeros(n), []
    for _ in range(301):
        rows.append(x)
        x = F @ x + G @ [60.0]
    # Far from the start the first term of the series is all there is; the slices differ from the rod by their square.
    series = 4 * length**2 / (math.pi**2 * a) * math.log(4 / (0.1 * math.pi))
    for method in ("radau", "dopri5"):
        made = Diagram.load(GALLERY / "rod.json").run(method=method, rtol=1e-6)
        late = made.t >= 60
        np.testing.assert_allclose(made["far.y"][late], [row[-1] for row in rows], atol=1e-3)
        np.testing.assert_allclose(made["middle.y"][late], [(row[19] + row[20]) / 2 for row in rows], atol=1e-3)
        assert made.measures["warm"] == pytest.approx(series, rel=1 / n**2)


def test_observers_of_their_own_laws_are_as_wrong_as_closed_forms_and_a_plain_loop_say() -> None:
    """The page's numbers: of the linear ones the gain of f -> f - z2 at 2 rad/s, of the sliding one steps of RK4."""
    text = (PAGES / "laws.md").read_text(encoding="utf-8")
    told = {
        name: (float(a), float(b))
        for name, a, b in re.findall(r"^(\w+): ([\d.]+) after 1 s, ([\d.]+) after 2 s$", text, re.M)
    }
    for name, bandwidth in (("linear", 20.0), ("prescribed", 400.0)):
        assert told[name][1] == pytest.approx(2 * abs(1 - (bandwidth / (2j + bandwidth)) ** 2), abs=1e-4)

    def rates(t: float, x: Array) -> Array:
        y, z1, z2 = x
        e = y - z1
        return np.array([1 + 2 * math.sin(2 * t), z2 + 1.5 * math.sqrt(5 * abs(e)) * np.sign(e), 5.5 * np.sign(e)])

    x, h, errors = np.array([3.0, 0.0, 0.0]), 1e-4, []
    for k in range(40000):
        t = k * h
        k1 = rates(t, x)
        k2 = rates(t + h / 2, x + h / 2 * k1)
        k3 = rates(t + h / 2, x + h / 2 * k2)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rates(t + h, x + h * k3))
        errors.append(abs(x[2] - 1 - 2 * math.sin(2 * (t + h))))
    assert told["twisting"][0] == pytest.approx(max(errors[10149::50]), abs=2e-3)
    assert max(errors[20000:]) < 2e-3
    assert told["twisting"][1] < 1e-3
