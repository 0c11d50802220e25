"""The studies of published works on ADRC: their verdicts, and their numbers by SciPy, python-control and by hand."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from numpy.polynomial import polynomial as poly
from scipy.linalg import expm, solve_continuous_are
from scipy.signal import lti, step

from blocks import Diagram
from blocks.cli import main
from tests.support.places import ROOT

WORKS = ROOT / "diagrams" / "adrc"
FAILS = {("carlson_2025", "apart_printed"), ("carlson_2025", "slowest")}
"""Claims of the works that our numbers do not confirm."""
JUDGED = {"herbst_2013": 4, "half_gain_2020": 10, "footprint_2021": 12, "carlson_2025": 8}


@pytest.mark.usefixtures("native")
@pytest.mark.parametrize("work", JUDGED)
def test_a_study_gives_the_verdicts_that_it_expects(
    work: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", str(WORKS / work / "study.json"), "--json", "--out", str(tmp_path)]) == 0
    *events, done = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    claims = [event for event in events if event["event"] == "claim"]
    assert (done["unexpected"], done["claims"]) == (0, JUDGED[work])
    bad = [(work, claim["measure"]) for claim in claims if claim["verdict"] in ("fails", "not reproduced")]
    assert set(bad) == {pair for pair in FAILS if pair[0] == work}
    page = (ROOT / "docs" / "adrc_works.md").read_text(encoding="utf-8")
    (row,) = [line for line in page.splitlines() if line.startswith(f"| `{work}` |")]
    assert f"| {done['reproduced'] + done['held']} of {done['claims']} confirmed" in row
    values = {(work, claim.get("run") or claim.get("sweep"), claim["measure"]): claim["value"] for claim in claims}
    for key, witness in WITNESSES.items():
        if key[0] == work:
            assert values[key] == pytest.approx(witness(), rel=2e-3), key


# --- closed loops by hand --------------------------------------------------------------------------------------
# Polynomials are in rising powers of s, as numpy.polynomial has them.


def adrc_by_hand(n: int, wc: float, wo: float) -> tuple[Any, Any, Any]:
    """C_r, C_y and their common denominator for b0 = 1, from the equations of observer and feedback."""
    if n == 1:
        k, (l1, l2) = wc, (2 * wo, wo**2)
        return np.array([k * l2, k * l1, k]), np.array([k * l2, k * l1 + l2]), np.array([0.0, l1 + k, 1.0])
    k1, k2 = wc**2, 2 * wc
    l1, l2, l3 = 3 * wo, 3 * wo**2, wo**3
    c_y = np.array([k1 * l3, k1 * l2 + k2 * l3, k1 * l1 + k2 * l2 + l3])
    return k1 * np.array([l3, l2, l1, 1.0]), c_y, np.array([0.0, l2 + k2 * l1 + k1, l1 + k2, 1.0])


def loop(c_r: Any, c_y: Any, c: Any, plant: Any) -> tuple[Any, Any]:
    """Numerator and denominator of r to y; `plant` is 1/plant."""
    return c_r, poly.polyadd(poly.polymul(c, plant), c_y)


def falling(coefficients: Any) -> Any:
    return np.asarray(coefficients)[::-1]


def response(system: tuple[Any, Any], times: Any) -> Any:
    return step(lti(falling(system[0]), falling(system[1])), T=times)[1]


def settled(system: tuple[Any, Any], stop: float) -> float:
    times = np.linspace(0.0, stop, 20001)
    y = response(system, times)
    return float(times[np.flatnonzero(np.abs(y - y[-1]) > 0.02)[-1]])


def distance(system: tuple[Any, Any], ideal: tuple[Any, Any], stop: float) -> float:
    times = np.linspace(0.0, stop, 10001)
    return float(np.trapezoid(np.abs(response(system, times) - response(ideal, times)), times))


def first(K: float = 1.0, T: float = 1.0) -> tuple[Any, Any]:
    return loop(*adrc_by_hand(1, 4.0, 40.0), np.array([1.0, T]) / K)


def second(K: float = 1.0, T: float = 1.0) -> tuple[Any, Any]:
    return loop(*adrc_by_hand(2, 1.2, 12.0), np.array([1.0, 2 * T, T**2]) / K)


def pi(K: float = 1.0, T: float = 1.0) -> tuple[Any, Any]:
    c = np.array([3.85, 3.85])
    return loop(c, c, np.array([0.0, 1.0]), np.array([1.0, T]) / K)


def pid(K: float = 1.0, T: float = 1.0) -> tuple[Any, Any]:
    c = 0.6 * np.array([1.0, 2.0, 1.0])
    return loop(c, c, np.array([0.0, 1.0, 0.2]), np.array([1.0, 2 * T, T**2]) / K)


IDEAL_1, IDEAL_2 = ([4.0], [4.0, 1.0]), ([1.44], [1.44, 2.4, 1.0])
KS_1, KS_2, TS_2 = (0.1, 0.2, 0.5, 1, 2, 5, 10), (0.1, 0.2, 0.5, 1, 2, 5), (0.5, 1, 2, 5)


@cache
def carlson(n: int, K: float = 1.0, T: float = 1.0) -> tuple[float, float]:
    """How far PI(D) and ADRC are apart in y and in u after a step, from the printed gains of the PI(D)."""
    g = 10.0
    if n == 1:
        kp, ki, kd = (4 * g**2 + 8 * g) / (2 * g + 1), 16 * g**2 / (2 * g + 1), 0.0
        lag, weight, times, plant = [1.0, 1 / (8 * g + 4)], 4 / kp, np.linspace(0, 3, 12001), [1.0, T]
        ours = adrc_by_hand(1, 4.0, 40.0)
    else:
        q, t = 3 * g**2 + 6 * g + 1, 5.0
        kp, ki = (72 * g**3 + 108 * g**2) / (t**2 * q), 216 * g**3 / (t**3 * q)
        kd, tf = (6 * g**3 + 36 * g**2 + 18 * g) / (t * q), t / (6 * np.sqrt(q))
        lag, weight = [1.0, 2 * tf * (3 * g + 2) / (2 * np.sqrt(q)), tf**2], 36 / (t**2 * kp)
        times, plant = np.linspace(0, 11, 12001), [1.0, 2.0, 1.0]
        ours = adrc_by_hand(2, 1.2, 12.0)
    feedback, c = np.trim_zeros([ki, kp, kd], "b"), poly.polymul([0.0, 1.0], lag)
    theirs = (poly.polymul([ki, weight * kp], lag), feedback, c)
    plant_ = np.asarray(plant) / K
    # The feedback is that of the ADRC: coefficient by coefficient, once the denominators begin alike.
    np.testing.assert_allclose(feedback / c[1], ours[1] / ours[2][1], rtol=1e-12)
    np.testing.assert_allclose(c / c[1], ours[2] / ours[2][1], rtol=1e-12)
    y, u = [], []
    for controller in (ours, theirs):
        num, den = loop(*controller, plant_)
        y.append(response((num, den), times))
        u.append(response((poly.polymul(num, plant_), den), times))
    return tuple(float(np.max(np.abs(a - b))) for a, b in (y, u))  # type: ignore[return-value]


def crossover(c: Any, denominator: Any) -> float:
    system = control.tf(falling(c), falling(denominator)) * control.tf([1], [1, 1])
    return float(control.margin(system)[3])


def growth(T: float) -> float:
    """The largest real part of the poles of ADRC of order 2 with the plant of the text."""
    return float(poly.polyroots(second(T=T)[1]).real.max())


def printed() -> float:
    """How far the printed C_y takes y from that of the ADRC, under a step at the plant's input."""
    times = np.linspace(0, 3, 12001)
    _, c_y, c = adrc_by_hand(1, 4.0, 40.0)
    plant = np.array([1.0, 1.0])
    found = [response((c, loop(c, cy, c, plant)[1]), times) for cy in (c_y, np.array([(16 + 64) * 100.0, 320.0]))]
    return float(np.max(np.abs(found[0] - found[1])))


def noise(k_factor: float, l_factor: float) -> float:
    """|u/noise| at 1000 rad/s in the loop of half_noise.json."""
    k1, k2 = k_factor, 2 * k_factor
    l1, l2, l3 = l_factor * 30, l_factor * 300, l_factor * 1000
    s = 1000j
    c_y = (k1 * l3 + (k1 * l2 + k2 * l3) * s + (k1 * l1 + k2 * l2 + l3) * s**2) / (
        s * (s**2 + (l1 + k2) * s + l2 + k2 * l1 + k1)
    )
    return float(abs(c_y / (1 + c_y / (s + 1) ** 2)))


def less(k_factor: float, l_factor: float) -> float:
    """The reduction of noise, in % as claims have it."""
    return 100 * (1 - noise(k_factor, l_factor) / noise(1, 1))


WITNESSES: dict[tuple[str, str, str], Any] = {
    ("herbst_2013", "nominal_1", "settling_adrc"): lambda: settled(first(), 5.0),
    ("herbst_2013", "nominal_2", "settling_adrc"): lambda: settled(second(), 15.0),
    ("herbst_2013", "nominal_1", "settling_pi"): lambda: np.log(50) / 3.85,
    ("herbst_2013", "nominal_2", "settling_pid"): lambda: settled(pid(), 15.0),
    ("herbst_2013", "K_1", "IAE_adrc"): lambda: max(distance(first(K=x), IDEAL_1, 5) for x in KS_1),
    ("herbst_2013", "K_1", "IAE_pi"): lambda: max(distance(pi(K=x), IDEAL_1, 5) for x in KS_1),
    ("herbst_2013", "T_1", "IAE_adrc"): lambda: max(distance(first(T=x), IDEAL_1, 5) for x in KS_1),
    ("herbst_2013", "T_1", "IAE_pi"): lambda: max(distance(pi(T=x), IDEAL_1, 5) for x in KS_1),
    ("herbst_2013", "K_2", "IAE_adrc"): lambda: max(distance(second(K=x), IDEAL_2, 15) for x in KS_2),
    ("herbst_2013", "K_2", "IAE_pid"): lambda: max(distance(pid(K=x), IDEAL_2, 15) for x in KS_2),
    ("herbst_2013", "T_2", "IAE_adrc"): lambda: max(distance(second(T=x), IDEAL_2, 15) for x in TS_2),
    ("herbst_2013", "T_2", "IAE_pid"): lambda: max(distance(pid(T=x), IDEAL_2, 15) for x in TS_2),
    ("carlson_2025", "load", "apart_printed"): printed,
    ("carlson_2025", "step", "apart"): lambda: carlson(1)[0],
    ("carlson_2025", "step", "apart_u"): lambda: carlson(1)[1],
    ("carlson_2025", "pid_step", "apart"): lambda: carlson(2)[0],
    ("carlson_2025", "pid_step", "apart_u"): lambda: carlson(2)[1],
    ("carlson_2025", "gains", "apart"): lambda: max(carlson(1, K=x)[0] for x in KS_1),
    ("carlson_2025", "times", "apart"): lambda: max(carlson(1, T=x)[0] for x in KS_1),
    ("carlson_2025", "feedback", "crossover_adrc"): lambda: crossover(*adrc_by_hand(1, 4.0, 40.0)[1:]),
    ("carlson_2025", "feedback", "crossover_pi"): lambda: 3.85,
    ("carlson_2025", "slow", "slowest"): lambda: max(growth(T) for T in TS_2),
    ("carlson_2025", "quick", "slowest"): lambda: min(growth(T) for T in (0.1, 0.2)),
}
"""By work, run or sweep, and measure: the number by another way."""


# --- what only a work has --------------------------------------------------------------------------------------


@pytest.mark.usefixtures("native")
def test_halved_gains_solve_the_riccati_equation_and_reduce_the_noise() -> None:
    A, b = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    for w in (2.0, 3.0):
        # A'X + XA - 2 X b b'X = -w X, in the form that SciPy solves.
        X = solve_continuous_are(A + w / 2 * np.eye(2), np.sqrt(2) * b, np.zeros((2, 2)), np.eye(1))
        np.testing.assert_allclose((b.T @ X)[0], [w**2 / 2, w], rtol=1e-10)
        np.testing.assert_allclose(2 * X, [[w**3, w**2], [w**2, 2 * w]], rtol=1e-10)
        np.testing.assert_allclose(poly.polyroots([w**2 / 2, w, 1.0]).real, -w / 2, rtol=1e-12)
    diagram = Diagram.load(WORKS / "half_gain_2020" / "half_noise.json")
    found = {
        factors: diagram.run(parameters={"feedback": factors[0], "observer": factors[1]}).measures["noise"]
        for factors in ((1.0, 1.0), (0.5, 1.0), (1.0, 0.5), (0.5, 0.5))
    }
    for factors, value in found.items():
        assert value * np.sqrt(2) == pytest.approx(noise(*factors), rel=1e-3)
    assert [less(*f) for f in ((1, 0.5), (0.5, 1), (0.5, 0.5))] == pytest.approx([50, 19.325, 59.663], rel=1e-3)


@pytest.mark.parametrize(("n", "limit"), [(1, 1e100), (2, 1e100), (1, 2.0), (2, 1.1)])
def test_the_minimum_footprint_is_the_observer_in_a_loop_of_numpy(n: int, limit: float) -> None:
    diagram = Diagram.load(WORKS / "footprint_2021" / f"footprint_{n}.json")
    results = diagram.run(parameters={"limit": limit}, stop=3.0, every=0.01, rtol=1e-11, atol=1e-13)
    wc, wo, period = ((4.0, 40.0, 0.01), (1.2, 12.0, 0.02))[n - 1]
    plant = {1: ([[-1.0]], [[1.0]]), 2: ([[0.0, 1.0], [-1.0, -2.0]], [[0.0], [1.0]])}[n]
    Ad, Bd = held(*plant, period)
    A, B = held(np.eye(n + 1, k=1), np.eye(n + 1)[:, [n - 1]], period)
    z = np.exp(-wo * period)
    # The observer's gains at ticks as the works have them, of a current observer.
    L = {
        1: [1 - z**2, (1 - z) ** 2 / period],
        2: [1 - z**3, 1.5 * (1 - z) ** 2 * (1 + z) / period, (1 - z) ** 3 / period**2],
    }[n]
    K = {1: np.array([wc, 1.0]), 2: np.array([wc**2, 2 * wc, 1.0])}[n]
    x, ahead, expected = np.zeros((n, 1)), np.zeros((n + 1, 1)), []
    for k in range(round(3.0 / period)):
        y = x[0, 0]
        now = ahead + np.reshape(L, (-1, 1)) * (y - ahead[0, 0])
        wanted = 1.0 if k * period >= 1.0 - 1e-9 else 0.0
        u = float(np.clip(K[0] * wanted - K @ now[:, 0], -limit, limit))
        expected.append(u)
        ahead, x = A @ now + B * u, Ad @ x + Bd * u
    at = np.searchsorted(results.t, np.arange(len(expected)) * period + period / 2) - 1
    np.testing.assert_allclose(results["bound.y"][at], expected, atol=1e-9)


def held(A: Any, B: Any, period: float) -> tuple[Any, Any]:
    """The exact model over a period in which the input is held."""
    n = len(A)
    whole = expm(period * np.block([[np.asarray(A), np.asarray(B)], [np.zeros((1, n + 1))]]))
    return whole[:n, :n], whole[:n, n:]


def test_the_printed_sign_of_the_observers_gain_is_not_stable() -> None:
    # s^2 + l_1 s + l_2 with l_1 = -2 g K_P, l_2 = g^2 K_P^2.
    np.testing.assert_allclose(poly.polyroots([1600.0, -80.0, 1.0]), 40.0, rtol=1e-6)
    # The program's plant K/(s + T) leaves the loop of order 2 stable, the text's does not.
    for T in (0.1, 0.2):
        assert growth(T) > 0
        assert poly.polyroots(loop(*adrc_by_hand(2, 1.2, 12.0), [T, 1.0])[1]).real.max() < 0
