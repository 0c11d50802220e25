"""The measures of a step response from its samples, as `control.step_info` names and defines them."""

from __future__ import annotations

import math

import numpy as np

from ..text.arrays import Array

SHARES = ("RiseTime", "SettlingTime", "SettlingMin", "SettlingMax", "Overshoot", "Undershoot")
"""The keys that need a final value."""


def step_info(y: Array, t: Array, final: float | None, threshold: float, rise: tuple[float, float]) -> dict[str, float]:
    """Return the measures of a response y at times t, (rows,), to a step from 0 at t = 0.

    final: the value at which it settles (None: its last value). threshold: half the width of the band of the settling
    time, and rise: the levels of the rise time, as shares of the final value. Overshoot and Undershoot are in percent.
    NaN: what the response does not reach, and all shares of a final value that is 0 or not finite.
    """
    final = float(y[-1]) if final is None else float(final)
    top = int(np.argmax(np.abs(y)))
    known = {"Peak": abs(float(y[top])), "PeakTime": float(t[top]), "SteadyStateValue": final}
    if final == 0.0 or not math.isfinite(final) or not np.all(np.isfinite(y)):
        return {**dict.fromkeys(SHARES, math.nan), **known}
    toward = math.copysign(1.0, final) * y
    low, high = (_first(toward >= abs(level * final)) for level in rise)
    outside = np.flatnonzero(np.abs(y / final - 1.0) >= threshold)
    settled = int(outside[-1]) + 1 if len(outside) else 0
    values = (
        math.nan if low is None or high is None else t[high] - t[low],
        t[settled] if settled < len(t) else math.nan,
        math.nan if high is None else min(y[high:].min(), final),
        math.nan if high is None else max(y[high:].max(), final),
        100.0 * max(0.0, toward.max() / abs(final) - 1.0),
        100.0 * max(0.0, -toward.min() / abs(final)),
    )
    return {**{name: float(value) for name, value in zip(SHARES, values, strict=True)}, **known}


def _first(is_true: Array) -> int | None:
    """Return the first index at which an array is true; None if it is nowhere."""
    index = int(np.argmax(is_true))
    return index if is_true[index] else None
