"""Noise: a function of tick, seed and stream alone, with the distribution that it promises."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from blocks import Diagram, ModelError, Noise
from blocks.library.noise import uniform
from blocks.model.streams import number_of

COUNT = 20_000
STREAM = number_of(0, "noise")


@pytest.mark.parametrize("seed", [0.0, 1.0, 12345.0])
def test_uniform_numbers_are_uniform_and_independent(seed: float) -> None:
    ticks = np.arange(float(COUNT))
    u, v = uniform(ticks, seed, STREAM, 0.0), uniform(ticks, seed, STREAM, 2.0)
    for sample in (u, v):
        assert 0.0 < sample.min() < sample.max() < 1.0
        assert len(np.unique(sample)) == COUNT
        assert stats.kstest(sample, "uniform").pvalue > 1e-3
    pairs, _, _ = np.histogram2d(u[:-1], u[1:], bins=16, range=[[0, 1], [0, 1]])
    assert stats.chisquare(pairs.ravel()).pvalue > 1e-3
    for other in (v, uniform(ticks, seed + 1.0, STREAM, 0.0), np.roll(u, 1)):
        assert abs(np.corrcoef(u, other)[0, 1]) < 4 / np.sqrt(COUNT)


def test_counters_beyond_2_to_the_26_do_not_repeat() -> None:
    low, high = np.arange(1000.0), np.arange(1000.0) + 67108859.0
    assert abs(np.corrcoef(uniform(low, 0.0, STREAM, 0.0), uniform(high, 0.0, STREAM, 0.0))[0, 1]) < 4 / np.sqrt(1000)


def run(**parameters: object) -> np.ndarray:
    diagram = Diagram("n")
    diagram.add("noise", Noise(period=0.001, **parameters))
    results = diagram.run(stop=2.0, every=0.001)
    return np.asarray(results["noise.y"][np.searchsorted(results.t, np.arange(2000) / 1000, side="right") - 1])


def test_a_run_holds_the_numbers_of_its_ticks() -> None:
    ticks = np.arange(2000.0)
    plain = run(distribution="uniform", seed=3)
    assert plain == pytest.approx(np.sqrt(3) * (2 * uniform(ticks, 3.0, STREAM, 0.0) - 1), rel=1e-12)
    gaussian = run(deviation=2.0, mean=5.0)
    assert stats.kstest((gaussian - 5.0) / 2.0, "norm").pvalue > 1e-3
    assert np.array_equal(gaussian, run(deviation=2.0, mean=5.0))
    assert not np.array_equal(gaussian, run(deviation=2.0, mean=5.0, seed=1))


def test_a_run_that_begins_later_sees_the_same_noise() -> None:
    diagram = Diagram("n")
    diagram.add("noise", Noise(period=0.1))
    whole, part = diagram.run(stop=3.0, every=0.1), diagram.run(start=1.0, stop=3.0, every=0.1)
    assert part["noise.y"][-1] == whole["noise.y"][-1]


def test_a_seed_is_an_integer() -> None:
    diagram = Diagram("n")
    with pytest.raises(ModelError, match=r"E107 .*the seed must be an integer"):
        diagram.add("noise", Noise(seed=0.5))
