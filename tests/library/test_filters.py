"""Digital filters, holds and rate transitions: scipy.signal's recursions, closed forms, tasks played by hand."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy import signal

from blocks import (
    Biquad,
    Diagram,
    FIRFilter,
    FirstOrderHold,
    MovingAverage,
    RateTransition,
    Sine,
    ZeroOrderHold,
)
from tests.library.test_discrete import filtered, noise, sampled
from tests.support.library_variants import reads

RECURSION = 1e-12
"""Two ways to sum the same few hundred products."""


@pytest.mark.parametrize("offset", [0.0, 0.05])
def test_a_fir_filter_is_that_of_lfilter(offset: float) -> None:
    b, u = signal.firwin(21, 0.3), noise(120)
    y = filtered(FIRFilter(b=b, period=0.1, offset=offset), u, 0.1, offset)
    assert y == pytest.approx(signal.lfilter(b, 1.0, u), abs=RECURSION)
    impulse = filtered(FIRFilter(b=b, period=0.1), np.eye(1, 30)[0], 0.1)
    assert impulse.tolist() == [*b, *[0.0] * 9]


def test_a_fir_filter_without_a_first_coefficient_breaks_loops() -> None:
    assert reads("FIRFilter", {"period": 0.1, "b": [0.0, 1.0]}, "output:y") == [set()]
    assert reads("FIRFilter", {"period": 0.1, "b": [1.0, 1.0]}, "output:y") == [{"u[0]"}]
    assert reads("Biquad", {"period": 0.1, "sos": [[0.0, 1.0, 0.0, 1.0, 0.5, 0.0]]}, "output:y") == [set()]


@pytest.mark.parametrize(
    "sos",
    [
        signal.butter(9, 0.02, output="sos"),
        signal.ellip(4, 1.0, 60.0, [0.2, 0.5], "bandpass", output="sos"),
        3.0 * np.array([[1.0, 0.5, 0.0, 1.0, -0.9, 0.0]]),
    ],
    ids=["butter", "ellip", "first order"],
)
def test_biquads_are_those_of_sosfilt(sos: Any) -> None:
    u = noise(150)
    y = filtered(Biquad(sos=sos, period=0.1), u, 0.1)
    assert y == pytest.approx(signal.sosfilt(sos / sos[:, 3:4] if sos[0, 3] == 3.0 else sos, u), abs=RECURSION)


def test_biquads_begin_at_rest_where_sosfilt_zi_says() -> None:
    sos = signal.butter(5, 0.1, output="sos")
    y = filtered(Biquad(sos=sos, period=0.1, x_start=2.5 * signal.sosfilt_zi(sos)), np.full(50, 2.5), 0.1)
    assert y == pytest.approx(2.5, abs=RECURSION)


@pytest.mark.parametrize("samples", [1, 4, 25])
def test_a_moving_average_is_the_mean_of_the_last_inputs(samples: int) -> None:
    u = noise(80)
    y = filtered(MovingAverage(samples=samples, period=0.1, y_start=3.0), u, 0.1)
    past = np.concatenate([np.full(samples - 1, 3.0), u])
    assert y == pytest.approx(np.lib.stride_tricks.sliding_window_view(past, samples).mean(axis=1), abs=RECURSION)


def test_a_moving_average_stops_waves_that_fit_into_it() -> None:
    t = 0.01 * np.arange(200)
    for harmonic in (1, 2, 5):
        y = filtered(MovingAverage(samples=20, period=0.01), np.sin(2.0 * np.pi * harmonic * t / 0.2), 0.01)
        assert y[20:] == pytest.approx(0.0, abs=RECURSION)


# --- holds -----------------------------------------------------------------------------------------------------


def held(**options: Any) -> Any:
    """A first-order hold of a sine, on a grid finer than its ticks, and its samples."""
    d = Diagram("held")
    hold = d.add("hold", FirstOrderHold(period=0.1, offset=0.05, y_start=0.5, **options))
    d.wire(hold.u, d.add("sine", Sine(omega=4.0)).y)
    results = d.run(stop=2.0, every=0.005)
    t = np.asarray(results.t)
    return t, np.asarray(results["hold.y"]), 0.05 + 0.1 * np.arange(20)


def test_a_delayed_first_order_hold_is_linear_interpolation_one_period_late() -> None:
    t, y, ticks = held(form="delayed")
    expected = np.interp(t, np.append(0.05, ticks + 0.1), np.append(0.5, np.sin(4.0 * ticks)))
    assert y == pytest.approx(expected, abs=1e-12)


def test_a_predictive_first_order_hold_goes_on_along_the_last_two_samples() -> None:
    t, y, ticks = held()
    k = np.searchsorted(ticks, t + 1e-12, side="right") - 1
    u = np.sin(4.0 * ticks)
    rise = np.append(0.0, np.diff(u))
    expected = np.where(k < 0, 0.5, u[k] + rise[k] * (t - ticks[k]) / 0.1)
    assert y == pytest.approx(expected, abs=1e-12)


# --- rates -----------------------------------------------------------------------------------------------------


def through(sender: str, receiver: str) -> list[float]:
    """The times of a sender's ticks, as they come to the ticks of a receiver."""
    d = Diagram("rates")
    period_u, period = float(sender), float(receiver)
    hold = d.add("sender", ZeroOrderHold(period=period_u))
    d.wire(hold.u, d.input("u"))
    rate = d.add("rate", RateTransition(period_u=period_u, period=period, y_start=-1.0))
    d.wire(rate.u, hold.y)
    results = d.run(stop=3.05, inputs={"u": ([0.0, 4.0], [0.0, 4.0])})
    return sampled(results, "rate.y", period, int(3.0 / period) + 1).tolist()


@pytest.mark.parametrize(("sender", "receiver"), [("0.3", "0.1"), ("0.1", "0.3"), ("0.3", "0.2"), ("0.2", "0.3")])
def test_a_rate_transition_is_what_tasks_with_priorities_hand_over(sender: str, receiver: str) -> None:
    """Slow to fast, a value is there when its task has had its whole period; fast to slow at once."""
    written, read = Fraction(sender), Fraction(receiver)
    for k, value in enumerate(through(sender, receiver)):
        begun = k * read // written  # ticks of the sender after its first, up to this one of the receiver
        finished = begun - 1 if written > read else begun
        assert value == pytest.approx(float(finished * written) if finished >= 0 else -1.0, abs=1e-12), k


def test_a_rate_transition_breaks_a_loop_only_where_it_delays() -> None:
    assert reads("RateTransition", {"period_u": 0.2, "period": 0.1}, "output:y") == [set()]
    assert reads("RateTransition", {"period_u": 0.1, "period": 0.2}, "output:y") == [{"u[0]"}]
    assert reads("RateTransition", {"period_u": 0.1, "period": 0.2, "mode": "delay"}, "output:y") == [set()]
