"""Excitation signals: SciPy's maximal sequences bit for bit, spectra by NumPy."""

from typing import Any

import numpy as np
import pytest
from scipy.signal import max_len_seq

from blocks import PRBS, Diagram, Multisine, TransferFunction
from tests.library.test_discrete import sampled
from tests.support.cases import in_one_test
from tests.support.library_variants import evaluate, resolved


def sequence(count: int, period: float = 0.1, **given: Any) -> Any:
    d = Diagram("sequence")
    d.add("b", PRBS(period=period, **given))
    return sampled(d.run(stop=period * (count - 0.5)), "b.y", period, count)


@pytest.mark.parametrize(("order", "seed"), [(2, 3), (5, 9), (8, 255), (9, 1), (32, 2**31 + 5)])
def test_a_prbs_is_the_maximal_sequence_of_scipy(order: int, seed: int) -> None:
    count = min(2**order + 7, 700)
    bits, _ = max_len_seq(order, [seed >> k & 1 for k in range(order)], length=count)
    assert sequence(count, order=order, seed=seed, low=2.0, high=5.0).tolist() == (2.0 + 3.0 * bits).tolist()


@in_one_test("order", range(2, 33))
def test_every_register_moves_as_that_of_scipy(order: int) -> None:
    random = np.random.default_rng(order)
    for _ in range(5):
        register = random.integers(0, 2, order) | np.eye(1, order, int(random.integers(order)), dtype=int)[0]
        _, following = max_len_seq(order, register, length=1)
        made = evaluate("PRBS", {"period": 0.1, "order": order}, register=register.astype(bool))
        assert made["next:register"].tolist() == following.tolist()


def test_a_prbs_has_the_autocorrelation_of_white_noise() -> None:
    y = sequence(127, order=7)
    shifted = [float(np.mean(y * np.roll(y, k))) for k in range(127)]
    assert shifted == pytest.approx([1.0] + [-1.0 / 127.0] * 126, abs=1e-14)


def test_a_multisine_has_its_lines_and_no_others() -> None:
    d = Diagram("lines")
    given = {"harmonics": [1.0, 3.0, 7.0], "period": 2.0, "amplitude": [1.0, 0.5, 2.0], "phase": [0.3, -1.0, 2.0]}
    d.add("b", Multisine(bias=4.0, **given))
    y = np.asarray(d.run(stop=2.0, every=2.0 / 64)["b.y"])[:64]
    lines = np.fft.rfft(y) / 32.0
    expected = np.zeros(33, dtype=complex)
    expected[0], expected[[1, 3, 7]] = 8.0, given["amplitude"] * np.exp(1j * np.array(given["phase"]))
    assert lines == pytest.approx(expected, abs=1e-13)


def test_schroeders_phases_keep_the_crest_low() -> None:
    harmonics = np.arange(1.0, 32.0)
    phase = resolved("Multisine", {"harmonics": harmonics}).values["phase"].value
    k = np.arange(31)
    assert phase == pytest.approx(-np.pi * k * (k + 1) / 31.0, rel=1e-14)

    def crest(phase: Any) -> float:
        t = np.linspace(0.0, 1.0, 4000)[:, None]
        y = np.cos(2.0 * np.pi * harmonics * t + phase).sum(axis=1)
        return float(np.max(np.abs(y)) / np.sqrt(np.mean(y**2)))

    assert crest(phase) < 1.8 < 7.0 < crest(0.0)  # sqrt(2) is that of one sine


def test_whole_periods_of_a_multisine_measure_a_frequency_response() -> None:
    d = Diagram("measured")
    excitation = d.add("excitation", Multisine(period=1.0))
    lag = d.add("lag", TransferFunction(num=[2.0], den=[0.1, 1.0]))
    d.wire(lag.u, excitation.y)
    results = d.run(stop=6.0, every=1.0 / 64, rtol=1e-9)
    u, y = (np.fft.rfft(np.asarray(results[name])[-65:-1])[1:11] for name in ("excitation.y", "lag.y"))
    s = 2j * np.pi * np.arange(1.0, 11.0)
    assert y / u == pytest.approx(2.0 / (0.1 * s + 1.0), rel=1e-6)
