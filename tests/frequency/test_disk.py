"""Disk margins of several channels together: closed forms, python-control with slycot, brute force and simulations.

Values of python-control are those of version 0.10.2 with slycot 0.7.1, which the project does not need.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import control
import numpy as np
import pytest

from blocks import (
    Diagram,
    FirstOrder,
    Gain,
    Integrator,
    MatrixGain,
    Mux,
    PMDCMotor,
    Relay,
    StateSpace,
    TransferFunction,
    TransportDelay,
    UnitDelay,
    ZeroOrderHold,
    fmu,
)
from blocks.analysis import disk_margins, margins, sigma
from blocks.frequency.structured import scaled, scalings, upper_bounds, worst
from blocks.text.errors import AnalysisError, UsageError
from tests.support.marks import long_but

Array = np.ndarray[Any, Any]
CLOSE = 1e-9
# Of the factors beside the border, relative to the disk.
BESIDE = 1e-3


def satellite(*before: tuple[str, Any]) -> Diagram:
    """The spinning satellite of python-control's documentation: two loops that are one rotation."""
    d = Diagram("satellite")
    C = [[1.0, 10.0], [-10.0, 1.0]]
    plant = StateSpace(A=[[0.0, 10.0], [-10.0, 0.0]], B=np.eye(2), C=C, D=np.zeros((2, 2)), x_start=[1.0, 0.0])
    d.add("plant", plant)
    d.add("k", MatrixGain(K=-np.eye(2)))
    d.wire("k.u", "plant.y")
    if not before:
        d.wire("plant.u", "k.y")
    else:
        d.add("mux", Mux(size=2))
        d.wire("plant.u", "mux.y")
        for k, (name, block) in enumerate(before):
            d.add(name, block)
            d.wire(f"{name}.u", f"k.y[{k}]")
            d.wire(f"mux.u{k + 1}", f"{name}.y")
    return d


A = np.array([[0.0, 1, 0, 0], [-4, -0.4, 1, 0], [0, 0, 0, 1], [1, 0, -9, -0.6]])
B, C = np.eye(4)[:, [1, 3]], np.eye(4)[[0, 2]]
K = np.array([[1.0, 0.8], [-0.8, 1.0]])


def two(first: Any = None, second: Any = None, **more: Any) -> Diagram:
    """Two masses with a gain that couples them, each behind an actuator; more: what comes before or behind it."""
    d = Diagram("two")
    d.add("plant", StateSpace(A=A, B=B, C=C, D=np.zeros((2, 2)), x_start=[1.0, 0.0, 0.0, 0.0]))
    d.add("law", MatrixGain(K=-K))
    d.add("mux", Mux(size=2))
    d.wire("law.u", "plant.y")
    d.wire("plant.u", "mux.y")
    for k, (name, block) in enumerate((("a", first), ("b", second))):
        chain = {name: block or FirstOrder(T=0.5)}
        chain = {f"before{k}": more.get(f"before{k}"), **chain, f"behind{k}": more.get(f"behind{k}")}
        source = f"law.y[{k}]"
        for path, part in chain.items():
            if part is not None:
                d.add(path, part)
                d.wire(f"{path}.u", source)
                source = f"{path}.y"
        d.wire(f"mux.u{k + 1}", source)
    return d


def test_a_spinning_satellite_has_the_margins_of_its_closed_form() -> None:
    """A rotation has eigenvalues: S - T of them is (s -+ 20j - 1)/(s + 1), largest at w^2 + 20 w = 1."""
    linearizer = satellite().linearizer()
    L = linearizer.loop(["k.y[0]", "k.y[1]"])
    found = disk_margins(L)
    w = math.sqrt(101) - 10
    assert found.stable
    assert found.verdict == "stable"
    assert found.disk == pytest.approx(2 * math.sqrt((w * w + 1) / ((w + 20) ** 2 + 1)), rel=CLOSE)
    assert found.disk_frequency == pytest.approx(w, rel=1e-6)
    assert found.disk_most == pytest.approx(found.disk, rel=CLOSE)
    assert found.Ms == pytest.approx(math.sqrt(101), rel=CLOSE)
    assert found.Ms_frequency == pytest.approx(0.1, rel=1e-6)
    assert (found.Mt, found.Mt_frequency) == (pytest.approx(math.sqrt(101), rel=CLOSE), 0.0)
    for one in found.alone:
        assert (one.gain, one.phase_deg, one.disk) == (None, pytest.approx(90.0), pytest.approx(2.0))
    for skew in (1.0, -1.0):
        assert disk_margins(L, skew=skew).disk == pytest.approx(1 / math.sqrt(101), rel=CLOSE)


def test_a_satellite_with_coupled_gains_has_the_published_margin() -> None:
    """python-control's documentation prints 0.3754, 3.3 dB and 21.26 deg, on a coarse grid."""
    plant = control.ss([[0, 10], [-10, 0]], np.eye(2), [[1, 10], [-10, 1]], 0)
    gain = control.ss([], [], [], [[1, -2], [0, 1]])
    for loop in (plant * gain, gain * plant):
        found = disk_margins(loop)
        assert found.disk == pytest.approx(0.3761521530689, rel=1e-5)
        assert 20 * math.log10(found.disk_gains[1]) == pytest.approx(3.306578254661, rel=1e-5)
        assert found.disk_phase_deg == pytest.approx(21.3030754321, rel=1e-5)


@pytest.mark.parametrize(
    ("skew", "disk", "decibel", "degrees"),
    [
        (0.0, 0.2940310701493094, 2.5725635676679093, 16.726916732465003),
        (1.0, 0.26193003591019404, 2.0207055472839635, 15.050721118144411),
        (-1.0, 0.32922918246769534, 2.4719973479740425, 18.94969205669124),
    ],
)
def test_margins_are_those_of_python_control_with_slycot(
    skew: float, disk: float, decibel: float, degrees: float
) -> None:
    found = disk_margins(two().linearizer().loop(["a.y", "b.y"]), skew=skew)
    assert found.disk == pytest.approx(disk, rel=1e-7)
    low, high = found.disk_gains
    assert 20 * math.log10(min(high, 1 / low)) == pytest.approx(decibel, rel=1e-7)
    assert found.disk_phase_deg == pytest.approx(degrees, rel=1e-7)


def test_the_bound_of_mu_is_that_of_slycot() -> None:
    """ab13md of slycot, which may itself be a little above the least bound."""
    for n, known in ((3, 8.05154099832951), (4, 116.69623311053327), (5, 686.0001298469589)):
        k = np.arange(n * n).reshape(n, n)
        m = (np.cos(1.7 * k + n) + 1j * np.sin(2.3 * k * k - n)) * 10.0 ** (np.arange(n)[:, None] - 1)
        bound = float(upper_bounds(m[None])[0])
        assert bound == pytest.approx(known, rel=1e-4)
        assert bound <= float(scaled(m[None], scalings(m[None]))[0])
        delta = worst(m, bound)
        assert abs(np.linalg.det(np.eye(n) - m @ np.diag(delta))) < 1e-9
        assert np.ptp(np.abs(delta)) < 1e-12
        assert np.abs(delta[0]) >= (1 - 1e-12) / bound
        assert n > 3 or np.abs(delta[0]) == pytest.approx(1 / bound, rel=1e-4)


def random_loop(seed: int) -> Any:
    """A loop of two channels, stable when closed, every second one sampled."""
    random = np.random.default_rng(seed)
    n = int(random.integers(2, 6))
    while True:
        a = random.normal(size=(n, n)) - 0.8 * np.eye(n)
        b, c = random.normal(size=(n, 2)), random.normal(size=(2, n))
        d = random.normal(size=(2, 2)) * (seed % 3 == 0) * 0.3
        loop = control.ss(a, b, c, d)
        loop = control.sample_system(loop, 0.3) if seed % 2 else loop
        if growth(loop, np.ones(2)) < -0.02:
            return loop


def growth(loop: Any, factors: Array) -> float:
    """How far the slowest pole is beyond the border where each channel has a factor, complex or not."""
    f = np.diag(factors)
    back = f @ np.linalg.solve(np.eye(len(f)) + loop.D @ f, loop.C)
    poles = np.linalg.eigvals(loop.A - loop.B @ back)
    return float(np.max(np.abs(poles) - 1.0) if loop.dt else np.max(poles.real))


@pytest.mark.parametrize("seed", long_but(range(60), lambda seed: seed < 10))
@pytest.mark.parametrize("skew", [0.0, 0.7])
def test_no_factor_within_the_disk_makes_a_loop_unstable_and_the_worst_just_outside_does(
    seed: int, skew: float
) -> None:
    loop = random_loop(seed)
    found = disk_margins(loop, skew=skew)
    assert found.stable

    def factors(deltas: Array) -> Array:
        return (1 + 0.5 * (1 - skew) * deltas) / (1 - 0.5 * (1 + skew) * deltas)

    random = np.random.default_rng(seed)
    inside = found.disk * (1 - BESIDE)
    for turns in np.exp(1j * random.uniform(-math.pi, math.pi, (1500, 2))):
        assert growth(loop, factors(inside * turns)) < 0
    for turns, size in zip(
        itertools.product(np.exp(1j * np.linspace(0, 2 * np.pi, 24)), repeat=2),
        itertools.cycle((1, 0.6, 0.2)),
        strict=False,
    ):
        assert growth(loop, factors(inside * size * np.array(turns))) < 0
    f = np.array(found.worst)
    deltas = 2 * (f - 1) / ((1 + skew) * f + 1 - skew)
    assert np.abs(deltas) == pytest.approx(found.disk, rel=1e-6)
    if found.disk_frequency < math.inf and np.all(np.abs(f) < 1e6):
        assert growth(loop, f) == pytest.approx(0.0, abs=1e-6)
        assert growth(loop, factors(deltas * (1 + BESIDE))) > 0 > growth(loop, factors(deltas * (1 - BESIDE)))


@pytest.mark.parametrize("seed", range(8))
def test_the_peaks_of_S_and_T_are_those_of_python_control(seed: int) -> None:
    loop = random_loop(seed)
    found = disk_margins(loop)
    one = control.ss([], [], [], np.eye(2), loop.dt)
    S = control.feedback(one, loop)
    omega = np.geomspace(1e-3, np.pi / loop.dt if loop.dt else 1e3, 4000)
    values = np.moveaxis(control.frequency_response(S, omega).frdata, 2, 0)
    for top, w, matrices in (
        (found.Ms, found.Ms_frequency, values),
        (found.Mt, found.Mt_frequency, np.eye(2) - values),
    ):
        sizes = np.linalg.svd(matrices, compute_uv=False)[:, 0]
        assert top >= np.max(sizes) * (1 - 1e-12)
        assert top == pytest.approx(np.max(sizes), rel=1e-3)
        if omega[0] < w < omega[-1]:
            assert np.log(omega[np.argmax(sizes)] / w) == pytest.approx(0.0, abs=0.05)
    for i, alone in enumerate(found.alone):
        assert alone.Ms == pytest.approx(np.max(np.abs(values[:, i, i])), rel=1e-3)


def perturbed(factor: complex, omega: float, share: float) -> Any:
    """f(s) = (1 + d/2)/(1 - d/2), d = +-alpha (b - s)/(b + s): of one size at all frequencies, and the factor at omega.

    share: of its alpha.
    """
    delta = 2 * (factor - 1) / (factor + 1)
    angle = float(np.angle(delta))
    sign = 1.0 if angle <= 0 else -1.0
    angle = angle if angle <= 0 else angle - math.pi
    b, alpha = omega / math.tan(-angle / 2), share * sign * abs(delta)
    return TransferFunction(num=[1 - alpha / 2, b * (1 + alpha / 2)], den=[1 + alpha / 2, b * (1 - alpha / 2)])


@pytest.mark.parametrize("case", ["satellite", "two"])
def test_a_simulation_with_the_worst_factors_oscillates_at_the_border(case: str) -> None:
    make, ends = (satellite, ["k.y[0]", "k.y[1]"]) if case == "satellite" else (two, ["law.y[0]", "law.y[1]"])
    found = disk_margins(make().linearizer().loop(ends))
    w, period = found.disk_frequency, 2 * math.pi / found.disk_frequency
    sizes = {}
    first = [perturbed(f, w, 1.0) for f in found.worst]
    names = ("a", "b") if case == "satellite" else ("before0", "before1")
    d = (
        satellite(*zip(names, first, strict=True))
        if case == "satellite"
        else two(**dict(zip(names, first, strict=True)))
    )
    for share in (0.9, 1.0, 1.1):
        shaped = {name: perturbed(f, w, share) for name, f in zip(names, found.worst, strict=True)}
        given = {f"{name}.{key}": getattr(block, key) for name, block in shaped.items() for key in ("num", "den")}
        run = d.run(stop=24 * period, every=period / 200, rtol=1e-9, atol=1e-12, parameters=given)
        y = np.abs(np.asarray(run["plant.y"])).max(axis=1)
        sizes[share] = y[-200:].max() / y[-2001:-1800].max()
    assert sizes[1.0] == pytest.approx(1.0, abs=1e-3)
    assert sizes[0.9] < 0.9
    assert sizes[1.1] > 1.1


# --- loops of diagrams --------------------


def same(one: Any, other: Any) -> None:
    assert one.verdict == other.verdict
    for name, value in one.as_json().items():
        assert other.as_json()[name] == (None if value is None else pytest.approx(value, rel=1e-7, abs=1e-9)), name


def check_channels(d: Diagram, points: list[str]) -> Any:
    """The matrix closes to the diagram, and its channels alone are the loops at one signal."""
    linearizer = d.linearizer()
    loop = linearizer.loop(points)
    assert loop.signals == (tuple(points), tuple(points))
    whole, closed = (np.sort_complex(np.linalg.eigvals(m.A)) for m in (linearizer.whole(), loop.closed()))
    # Delays add poles at z = 0, which rounding moves far.
    whole, closed = (p[np.abs(p) > 0.01] for p in (whole, closed))
    assert closed == pytest.approx(whole, abs=1e-6)
    found = disk_margins(loop)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        for point, alone in zip(points, found.alone, strict=True):
            same(alone, margins(linearizer.loop(point)))
    return found


def test_the_channels_of_a_loop_at_several_signals_are_the_loops_at_each() -> None:
    check_channels(two(), ["a.y", "b.y"])
    check_channels(two(), ["law.y[0]", "law.y[1]"])
    check_channels(two(), ["a.u", "b.u"])
    check_channels(two(), ["plant.y[0]", "plant.y[1]"])
    check_channels(two(), ["a.y", "law.y[0]", "plant.y[1]"])  # two of one path


@pytest.mark.parametrize(
    ("made", "points"),
    [
        (lambda: two(ZeroOrderHold(period=0.1), ZeroOrderHold(period=0.1)), ["a.y", "b.y"]),
        (lambda: two(ZeroOrderHold(period=0.1), ZeroOrderHold(period=0.1)), ["law.y[0]", "law.y[1]"]),
        (lambda: two(UnitDelay(period=0.1), ZeroOrderHold(period=0.1)), ["a.y", "b.y"]),
        (
            lambda: two(
                ZeroOrderHold(period=0.1), ZeroOrderHold(period=0.1), behind0=TransportDelay(delay=0.13),
                behind1=TransportDelay(delay=0.23),
            ),
            ["behind0.y", "behind1.y"],
        ),
        (
            lambda: two(
                ZeroOrderHold(period=0.1), ZeroOrderHold(period=0.1), behind0=TransportDelay(delay=0.13),
            ),
            ["law.y[0]", "b.y"],
        ),
    ],
)  # fmt: skip
def test_a_sampled_loop_at_several_signals_is_exact_from_tick_to_tick(made: Any, points: list[str]) -> None:
    found = check_channels(made(), points)
    assert found.stable
    assert found.dt == pytest.approx(0.1)


def test_sampled_margins_are_borne_by_the_diagram_itself() -> None:
    """Real factors of the worst corner of gains, put into the diagram: its eigenvalues pass the border near them."""
    d = two(ZeroOrderHold(period=0.1), ZeroOrderHold(period=0.1))
    found = disk_margins(d.linearizer().loop(["a.y", "b.y"]))

    def fastest(gains: tuple[float, float]) -> float:
        changed = np.diag(gains) @ -K
        whole = d.linearizer(parameters={"law.K": changed.tolist()}).whole()
        return float(np.max(np.abs(np.linalg.eigvals(whole.A))))

    low, high = found.disk_gains
    corners = list(itertools.product((low, 1.0, high), repeat=2))
    assert max(fastest(corner) for corner in corners) < 1.0


def test_exact_delays_of_two_channels_are_kept_in_their_response() -> None:
    d = two(Gain(k=0.8), Gain(k=0.8), behind0=TransportDelay(delay=0.05), behind1=TransportDelay(delay=0.1))
    linearizer = d.linearizer()
    points = ["a.y", "b.y"]
    with pytest.raises(AnalysisError, match="E707"):
        linearizer.loop(points)
    exact = linearizer.exact_loop(points)
    found = disk_margins(exact)
    assert found.stable is None
    assert "stability unknown" in str(found)
    by_pade = disk_margins(linearizer.loop(points, pade=8))
    assert by_pade.stable
    assert found.disk == pytest.approx(by_pade.disk, rel=1e-6)
    assert found.Ms == pytest.approx(by_pade.Ms, rel=1e-6)
    sure = disk_margins(exact, unstable_poles=0)
    assert sure.stable
    assert all(one.stable for one in sure.alone)
    loose = disk_margins(
        two(Gain(k=20.0), Gain(k=20.0), behind0=TransportDelay(delay=0.4)).linearizer().exact_loop(points),
        unstable_poles=0,
    )
    assert (loose.stable, loose.verdict, math.isnan(loose.disk)) == (False, "unstable", True)


def test_signals_of_several_values_in_a_pattern_have_no_matrix() -> None:
    rates = two(ZeroOrderHold(period=0.1), ZeroOrderHold(period=0.2)).linearizer()
    with pytest.raises(AnalysisError, match=r"E705 a\.y: takes several values before the ticks repeat"):
        rates.loop(["a.y", "b.y"])
    assert margins(rates.loop("b.y")).stable
    with pytest.raises(AnalysisError, match="E705 disk_margins: a loop of several rates has no disk margin"):
        disk_margins(rates.loop("a.y"))


def test_signals_that_change_at_different_times_are_refused() -> None:
    holds = ZeroOrderHold(period=0.1), ZeroOrderHold(period=0.1)
    for points, more in (
        (["behind0.y", "b.y"], {"behind0": TransportDelay(delay=0.13)}),
        (
            ["behind0.y", "behind1.y"],
            {"behind0": TransportDelay(delay=0.13), "behind1": TransportDelay(delay=0.27)},
        ),
    ):
        with pytest.raises(AnalysisError, match=r"E705 .*takes its values at other times.*before the delays"):
            two(*holds, **more).linearizer().loop(points)
        assert disk_margins(two(*holds, **more).linearizer().loop(["a.y", "b.y"])).stable


def test_a_signal_that_moves_and_acts_between_ticks_is_refused_with_its_name() -> None:
    d = two(ZeroOrderHold(period=0.1), FirstOrder(T=0.5))
    with pytest.raises(AnalysisError, match=r"E705 b\.y: changes and acts between the ticks"):
        d.linearizer().loop(["a.y", "b.y"])


def test_what_cannot_be_a_loop_of_channels_is_refused() -> None:
    linearizer = two().linearizer()
    for given, words in (
        ([], "E501 loop: is opened at no signal"),
        (["a.y", "a.y"], r"E501 a\.y: appears twice"),
        (["law.y", "law.y[1]"], r"E501 law\.y\[1\]: appears twice"),
        ("a.z", r"E501 \"a\.z\": there is no such signal"),
    ):
        for ask in (linearizer.loop, linearizer.sensitivity, linearizer.complementary, linearizer.exact_loop):
            with pytest.raises(UsageError, match=words):
                ask(given)
    loop = linearizer.loop(["a.y", "b.y"])
    with pytest.raises(UsageError, match=r"E501 margins: 2 outputs and 2 inputs.*Use disk_margins"):
        margins(loop)
    with pytest.raises(UsageError, match="E501 disk_margins: 2 outputs and 1 inputs"):
        disk_margins(loop[:, 0])
    with pytest.raises(UsageError, match="E501 skew: must be a number"):
        disk_margins(loop, skew=math.nan)
    with pytest.raises(UsageError, match="E501 disk_margins: measured data"):
        disk_margins(control.frd(loop, [1.0, 2.0]))
    with pytest.raises(AnalysisError, match="E705 margins: 1 \\+ L vanishes"):
        disk_margins(control.ss([], [], [], [[0.0, 1.0], [1.0, 0.0]]))


def test_a_channel_that_feeds_back_to_nothing_is_named() -> None:
    d = two()
    d.add("seen", Gain(k=2.0))
    d.wire("seen.u", "plant.y[0]")
    with pytest.raises(AnalysisError, match=r"E705 seen\.y: has no margin alone"):
        disk_margins(d.linearizer().loop(["a.y", "seen.y"]))


def test_S_and_T_at_several_signals_are_matrices() -> None:
    linearizer = two().linearizer()
    points = ["a.y", "b.y"]
    s = 1j * np.array([0.3, 2.0, 11.0])
    L = linearizer.loop(points)(s)
    back = np.moveaxis(np.linalg.inv(np.eye(2) + np.moveaxis(L, 2, 0)), 0, 2)
    assert linearizer.sensitivity(points)(s) == pytest.approx(back, rel=1e-10)
    assert linearizer.complementary(points)(s) == pytest.approx(np.eye(2)[:, :, None] - back, rel=1e-10, abs=1e-12)
    assert linearizer.loop(points, sign=1.0)(s) == pytest.approx(-L, rel=1e-12)
    assert linearizer.loop("law.y")(s) == pytest.approx(linearizer.loop(["law.y[0]", "law.y[1]"])(s), rel=1e-12)


def test_an_unstable_loop_has_no_numbers_and_one_at_the_border_has_none_to_bear() -> None:
    unstable = disk_margins(two(Gain(k=-40.0)).linearizer().loop(["a.y", "b.y"]))
    assert (unstable.verdict, unstable.alone, unstable.worst) == ("unstable", (), ())
    assert all(math.isnan(x) for x in (unstable.disk, unstable.Ms, unstable.Mt, unstable.disk_phase_deg))
    assert {unstable.as_json()[key] for key in ("disk", "Ms", "Mt", "disk_phase_deg")} == {None}
    assert str(unstable).count("\n") == 0
    assert "it has no margins" in str(unstable)
    border = disk_margins(control.ss(np.zeros((2, 2)), np.eye(2), np.diag([1.0, 0.0]), np.diag([0.0, 1.0])) * 1.0)
    assert border.stable  # the second channel is a gain
    integrators = control.ss([[0.0, 1.0], [0.0, 0.0]], np.eye(2), [[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]])
    found = disk_margins(integrators)
    assert (found.verdict, found.disk, found.Ms) == ("border", 0.0, math.inf)
    assert "AT THE BORDER" in str(found)


@dataclass(frozen=True)
class Responding:
    """A system of which only the response is known."""

    of: Callable[[Array], Any]
    dt: float = 0.0

    def response(self, omega: Array) -> Array:
        return np.asarray(self.of(1j * np.asarray(omega)), dtype=complex)


def on_diagonal(first: Array, second: Array) -> list[list[Array]]:
    return [[first, 0 * first], [0 * first, second]]


ONE, POLE = control.tf([-1.0], [1.0, 1.0]), control.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]])


@pytest.mark.parametrize(
    "loop",
    [
        ONE,
        control.tf([-0.3], [1.0, 0.1 + 0.2]),  # but for rounding
        control.tf([-1.0, 0.0], [1.0, 1.0, 0.0]),  # a factor s in both
        control.tf([-0.5], [1.0, -0.5], 0.1),
        control.append(control.ss(ONE), POLE),  # S has the zero in one channel, L the pole in the other
        control.append(control.ss(control.tf([-0.3, -2.0], [1.0, 0.7, 2.0])), POLE),
        control.tf([[[-1.0], [0.0]], [[0.0], [1.0]]], [[[1.0, 1.0], [1.0]], [[1.0], [1.0, 2.0]]]),
        Responding(lambda s: -1 / (s + 1)),
        Responding(lambda s: -0.5 / (np.exp(0.1 * s) - 0.5), 0.1),
        Responding(lambda s: on_diagonal(-1 / (s + 1), 1 / (s + 2))),
        Responding(lambda s: [[0 * s, 2 / (s + 1)], [0.5 / (s + 3) + 1 / 3, 0 * s]]),  # det(I + L) alone is 0
    ],
)
def test_a_loop_with_1_plus_L_zero_at_rest_has_no_margin_there(loop: object) -> None:
    found = disk_margins(loop)
    assert (found.verdict, found.stable) == ("border", False)
    assert (found.disk, found.disk_frequency, found.Ms, found.Mt) == (0.0, 0.0, math.inf, math.inf)
    assert "AT THE BORDER" in str(found)


@pytest.mark.parametrize("exact", [False, True])
def test_loops_beside_the_border_have_the_margin_of_their_closed_form(exact: bool) -> None:
    """S - T is (1 - L)/(1 + L), (2 - e)/e at rest for L = -(1 - e)/(s + 1): alpha is 2 e/(2 - e)."""
    e = 1e-5
    loop: object = control.append(control.ss([[-1.0]], [[1.0]], [[e - 1.0]], [[0.0]]), POLE)
    if exact:
        loop = Responding(lambda s: on_diagonal((e - 1) / (s + 1), 1 / (s + 2)))
    found = disk_margins(loop)
    assert found.verdict == ("unknown" if exact else "stable")
    assert found.disk == pytest.approx(2 * e / (2 - e), rel=1e-7)
    beyond = control.append(control.ss([[-1.0]], [[1.0]], [[-1.0 - e]], [[0.0]]), POLE)
    assert disk_margins(beyond).verdict == "unstable"


def test_a_loop_at_the_border_at_a_frequency_of_the_grid_has_no_margin() -> None:
    found = disk_margins(Responding(lambda s: on_diagonal(2 / (s * (s + 1) ** 2), 1 / (s + 2))))
    assert (found.verdict, found.disk, found.Ms) == ("border", 0.0, math.inf)
    assert found.disk_frequency == pytest.approx(1.0, rel=1e-9)


def test_loops_of_numbers_that_are_none_are_refused() -> None:
    for loop, words in (
        (control.ss([[math.nan]], [[1.0]], [[1.0]], [[0.0]]), "E501 system: A holds nan, but must be finite"),
        (control.tf([math.inf], [1.0, 1.0]), "E501 system: a numerator holds inf, but must be finite"),
        (control.ss([], [], np.zeros((0, 0)), np.zeros((0, 0))), "E501 disk_margins: 0 outputs and 0 inputs"),
        (Responding(lambda s: np.zeros((0, 0, len(s)))), "E501 disk_margins: 0 outputs and 0 inputs"),
        (Responding(lambda s: on_diagonal(np.nan * s, s)), "E705 0: has no margin alone"),
        (Responding(lambda s: 0 * s - 1), r"E705 0: .*1 \+ L vanishes at all frequencies\. Put a state"),
    ):
        with pytest.raises((UsageError, AnalysisError), match=words):
            disk_margins(loop)
    # A response that is not known everywhere: the rest counts.
    found = disk_margins(Responding(lambda s: np.where(np.abs(s) > 10, np.nan, 1 / (s + 1))))
    assert found.Mt == pytest.approx(0.5, rel=1e-6)


def test_of_more_than_three_channels_the_margin_is_guaranteed_and_the_worst_is_near() -> None:
    random = np.random.default_rng(5)
    a = random.normal(size=(6, 6)) - 3 * np.eye(6)
    loop = control.ss(a, random.normal(size=(6, 5)), random.normal(size=(5, 6)), 0)
    found = disk_margins(loop)
    assert found.stable
    assert found.disk <= found.disk_most * (1 + 1e-12)
    assert found.disk_most < 1.15 * found.disk
    assert found.disk < min(one.disk for one in found.alone)
    assert growth(loop, np.array(found.worst)) == pytest.approx(0.0, abs=1e-6)
    turns = np.exp(1j * random.uniform(-math.pi, math.pi, (4000, 5)))
    for deltas in 0.999 * found.disk * turns:
        assert growth(loop, (1 + deltas / 2) / (1 - deltas / 2)) < 0


def test_one_channel_has_the_disk_margin_of_margins() -> None:
    loop = two().linearizer().loop("a.y")
    together, alone = disk_margins(loop), margins(loop)
    assert together.disk == pytest.approx(alone.disk, rel=1e-9)
    assert together.Ms == pytest.approx(alone.Ms, rel=1e-9)
    assert together.Mt == pytest.approx(alone.Mt, rel=1e-9)
    assert together.disk_gains[1] == pytest.approx(alone.disk_gain, rel=1e-9)
    assert together.disk_phase_deg == pytest.approx(alone.disk_phase_deg, rel=1e-9)


# --- where other features of diagrams meet --------------------


def test_copies_are_channels_of_one_loop() -> None:
    d = Diagram("fleet")
    d.add("lags", FirstOrder(T=1.0), copies=3)
    d.add("law", MatrixGain(K=-(np.eye(3) + 0.5)))
    d.wire("law.u", "lags.y")
    d.wire("lags.u", "law.y")
    found = disk_margins(d.linearizer().loop("law.y"))
    by_hand = control.ss(-np.eye(3), np.eye(3), np.eye(3) + 0.5, 0)
    assert len(found.channels) == 3
    assert found.disk == pytest.approx(disk_margins(by_hand).disk, rel=1e-9)


def test_fmus_for_model_exchange_have_the_margins_of_the_blocks_they_were_made_of() -> None:
    found = []
    for motor in (lambda: fmu("fmus/PMDCMotor.fmu", kind="ME"), PMDCMotor):
        d = Diagram("pair")
        d.add("law", MatrixGain(K=[[-3.0, -2.0], [2.0, -3.0]]))
        d.add("speeds", Mux(size=2))
        for k in range(2):
            d.add(f"m{k}", motor())
            d.wire(f"m{k}.v", f"law.y[{k}]")
            d.wire(f"speeds.u{k + 1}", f"m{k}.omega")
            d.wire(f"m{k}.tau", d.input(f"tau{k}", default=0.0))
        d.wire("law.u", "speeds.y")
        found.append(disk_margins(d.linearizer().loop("law.y")))
    assert found[0].stable
    assert found[0].disk == pytest.approx(found[1].disk, rel=1e-6)
    assert found[0].disk < 0.9 * min(one.disk for one in found[0].alone)


def test_describing_functions_are_gains_of_the_matrix_and_lagging_ones_are_refused() -> None:
    relay = {"on_at": 0.0, "off_at": 0.0, "on": 1.0, "off": -1.0}
    # About -1, where the plant starts.
    d, N = two(Relay(**relay), FirstOrder(T=0.5)), 4 / (math.pi * 2.0) * math.sqrt(1 - 0.25)
    found = disk_margins(d.linearizer(amplitude={"a.u": 2.0}).loop(["law.y[0]", "law.y[1]"]))
    known = disk_margins(two(Gain(k=N), FirstOrder(T=0.5)).linearizer().loop(["law.y[0]", "law.y[1]"]))
    assert found.disk == pytest.approx(known.disk, rel=1e-9)
    with pytest.raises(AnalysisError, match=r"E705 law\.y\[0\]: has no margin alone"):  # flat where it is
        disk_margins(d.linearizer().loop(["law.y[0]", "law.y[1]"]))
    lagging = two(Relay(**{**relay, "on_at": 0.5, "off_at": -0.5}), FirstOrder(T=0.5))
    with pytest.raises(AnalysisError, match="E70"):
        lagging.linearizer(amplitude={"a.u": 2.0}).loop(["law.y[0]", "law.y[1]"])


def test_singular_values_are_drawn_with_their_peaks() -> None:
    L = two().linearizer().loop(["a.y", "b.y"])
    found = disk_margins(L)
    figure = sigma({"S": two().linearizer().sensitivity(["a.y", "b.y"])}, margins=found)
    (axis,) = figure.axes
    assert axis.texts[0].get_text() == "3.917 at 2.071 rad/s"
    top = max(line.get_ydata().max() for line in axis.lines)
    assert top == pytest.approx(20 * math.log10(found.Ms), abs=1e-6)


# --- a warning to who asks for one channel --------------------


def test_who_asks_for_one_channel_of_a_loop_that_is_fragile_together_is_warned() -> None:
    linearizer = satellite().linearizer()
    loop = linearizer.loop("k.y[0]")
    words = r"W701 k\.y\[0\]: .*of k\.y\[0\], k\.y\[1\] has a disk margin of 2 .*0\.09975\. .*"
    words += r'loop\(\["k\.y\[0\]", "k\.y\[1\]"\]\)'
    with pytest.warns(RuntimeWarning, match=words):
        assert margins(loop).phase_deg == pytest.approx(90.0)
    with pytest.warns(RuntimeWarning, match="W701"):
        satellite().sweep(
            {"k.K": [[[-1.0, 0.0], [0.0, -1.0]]] * 3},
            margins={"pm": {"type": "phase_margin", "loop": "k.y[0]"}},
            stop=0.1,
        )


def test_a_warning_of_fragile_channels_is_not_given_where_the_others_do_not_matter() -> None:
    """Warnings are errors here."""
    linearizer = two().linearizer()
    for point in ("law.y[0]", "law.y[1]", "plant.y[0]", "a.y"):
        margins(linearizer.loop(point))
    apart = Diagram("apart")
    apart.add("k", MatrixGain(K=np.diag([-1.0, -1.0])))
    apart.add("x", Integrator())
    apart.add("y", TransferFunction(num=[1.0], den=[1.0, 0.02, 0.0]))
    apart.add("mux", Mux(size=2))
    for sink, origin in {"x.u": "k.y[0]", "y.u": "k.y[1]", "mux.u1": "x.y", "mux.u2": "y.y", "k.u": "mux.y"}.items():
        apart.wire(sink, origin)
    assert margins(apart.linearizer().loop("k.y[0]")).disk == pytest.approx(2.0)
    cut = satellite().linearizer().loop("k.y[0]", openings="k.y[1]")
    assert cut.fragile is None
