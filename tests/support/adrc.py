"""Blocks of active disturbance rejection control on numbers, and the plants that their theory is about."""

from typing import Any

import numpy as np
from scipy.linalg import expm

from blocks import Results
from blocks.contract.interface import Value
from blocks.contract.resolution import Resolved, resolve
from blocks.library import LIBRARY
from tests.support.on_numbers import numeric

Array = np.ndarray[Any, Any]


def resolved(name: str, **given: Any) -> Resolved:
    return resolve(LIBRARY[name], {key: Value(value) for key, value in given.items()})


def evaluate(name: str, given: dict[str, Any], /, **read: Any) -> dict[str, Array]:
    """All results of a block by the keys of the contract, from the values that its equations read."""
    made = resolved(name, **given)
    parameters = {key: made.values[key].value[()] for key in made.interface.symbolic_parameters}
    return numeric(made.interface, {"t": 0.0, "tick": 0, **parameters, **read})


def gains_of(name: str, **given: Any) -> Array:
    return np.asarray(resolved(name, **given).values["gains"].value)


def chain(order: int, b0: float) -> tuple[Array, Array, Array]:
    """A, B, C of y^(order) = f + b0 u with the constant f as the last state."""
    B = np.zeros((order + 1, 1))
    B[order - 1] = b0
    return np.eye(order + 1, k=1), B, np.eye(1, order + 1)


def after(A: Array, B: Array, h: float) -> tuple[Array, Array]:
    """A and B over a time h in which the input is constant."""
    n = len(A)
    both = expm(h * np.block([[A, B], [np.zeros((1, n + 1))]]))
    return both[:n, :n], both[:n, n:]


def right_rows(results: Results, times: Array) -> Array:
    """The rows of the right values at recorded times."""
    return np.searchsorted(results.t, times + 1e-9, side="right") - 1
