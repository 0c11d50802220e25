"""The numbers of the figures of docs/frequency.md, against closed forms and each other."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import frequency_figures as figures
from blocks.analysis import disturbance_bandwidth, equivalent_bandwidth, noise_gain
from blocks.compile.toolchain.compiler import find_compiler

GAINS = {"leso": (30.4, 523.4, 2970.8), "gains": (30.4, 513.4, 1570.8)}
TOLERANCE = 1e-9
"""Both sides are exact but for rounding."""


@pytest.fixture(scope="module")
def observers() -> dict[str, figures.ObserverReport]:
    return figures.observers(figures.AMPLITUDES[::5])


@pytest.mark.parametrize("name", GAINS)
def test_the_lines_of_the_linear_observers_are_those_of_the_closed_forms(name: str, observers) -> None:
    row = observers[name].rows[0]
    assert row.bandwidth_f == pytest.approx(disturbance_bandwidth(GAINS[name]), rel=TOLERANCE)
    assert row.noise_h2 == pytest.approx(noise_gain(GAINS[name]), rel=TOLERANCE)
    assert row.gao == pytest.approx(equivalent_bandwidth(2, row.bandwidth_f), rel=TOLERANCE)


def test_the_curves_of_the_smeso_are_those_of_its_gains_times_n(observers) -> None:
    rows = observers["smeso"].rows
    for row in rows:
        gains = [row.N * gain for gain in GAINS["gains"]]
        assert row.bandwidth_f == pytest.approx(disturbance_bandwidth(gains), rel=TOLERANCE)
        assert row.noise_h2 == pytest.approx(noise_gain(gains), rel=TOLERANCE)
        assert np.sort(np.abs(row.poles)) == pytest.approx(np.sort(np.abs(np.roots([1.0, *gains]))), rel=1e-7)


def test_amplitude_moves_the_noise_and_hardly_the_bandwidth(observers) -> None:
    """What the page says in words."""
    rows = observers["smeso"].rows
    widths, noise = [row.bandwidth_f for row in rows], [row.noise_h2 for row in rows]
    assert (rows[0].amplitude, rows[-1].amplitude) == pytest.approx((1e-6, 10.0))
    assert (widths[0], widths[-1]) == pytest.approx((3.7182, 3.8323), abs=5e-5)
    assert np.all(np.diff(widths) > 0)
    assert np.all(np.diff(noise) < 0)
    assert min(noise) > observers["gains"].rows[0].noise_h2
    louder = [row.amplitude for row in rows if row.noise_h2 > observers["leso"].rows[0].noise_h2]
    assert max(louder) < 1.0001e-5
    pairs = [row.amplitude for row in rows if abs(row.poles[-1].imag) > 0]
    assert 4e-3 < min(pairs) < 7e-3  # of a coarse grid
    # As N grows, the slow pole goes to the root of what N multiplies.
    assert max(row.poles[0].real for row in rows) < max(np.roots(GAINS["gains"])) * 0.95
    assert min(row.poles[0].real for row in rows) > max(np.roots(GAINS["gains"]))


def test_the_law_gives_the_loop_phase_and_takes_it_away_as_e_grows() -> None:
    made = figures.loops(np.array([1.0, 10.0]))
    phases = [made[key].known.phase_deg for key in ("leso", "gains", *reversed(figures.IN_LOOP))]
    assert phases == sorted(phases)
    assert phases == pytest.approx([33.756, 40.192, 41.158, 44.013, 47.562], abs=5e-4)
    assert all(loop.known.stable for loop in made.values())


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler: the sweep takes minutes")
def test_simulated_points_lie_on_the_predicted_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """At some of the figure's frequencies; what is left is the third harmonic that comes back."""
    monkeypatch.setenv("BLOCKS_ENGINE", "native")
    for A, sweep in figures.sweeps(figures.SWEEP[::8]).items():
        made = figures.compare(sweep.measured, sweep.predicted, decibels=0.01, degrees=0.04)
        assert made.is_within, (A, made.worst_decibels, made.worst_degrees)
        assert np.max(np.abs(20 * np.log10(np.abs(sweep.measured.value / sweep.linear)))) > 1.7


def test_the_figures_are_drawn(observers) -> None:
    omega = np.geomspace(1.0, 200.0, 5)
    drawn = [figures.figure_of_observers(observers), figures.figure_of_loops(omega, figures.loops(omega))]
    for figure in drawn:
        assert len(figure.axes) == 3
        assert figures.plots.svg_text(figure).startswith("<svg")
