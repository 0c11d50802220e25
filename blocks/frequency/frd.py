"""Frequency responses as python-control has them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

__all__ = ["frd"]

Array = np.ndarray[Any, Any]


def frd(value: Array, omega: Array, *, inputs: Sequence[str], outputs: Sequence[str], dt: float = 0.0) -> Any:
    """A control.FrequencyResponseData of `value`, complex, shape (outputs, inputs, n), at `omega` in rad/s.

    dt: 0 for a response in continuous time, else the period in s. Signals keep their names, with "." as "_", which
    python-control does not take.
    """
    import control

    names = {"inputs": [_plain(name) for name in inputs], "outputs": [_plain(name) for name in outputs]}
    return control.FrequencyResponseData(np.asarray(value), np.asarray(omega, dtype=float), dt=dt, **names)


def _plain(name: str) -> str:
    return name.replace(".", "_")
