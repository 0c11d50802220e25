"""What the analyses take: state spaces, transfer functions, measured data, and whatever answers at a frequency.

Responses that were computed become measured data of python-control, too (`frd`)."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault, UsageError
from ..text.other_words import system_of
from .realization import Realization, balanced, check_finite, equivalent, invariant_zeros, period, variable

_MANY = 200  # states; above, zeros of channels would cost more than they are worth
_PART = 256  # frequencies between two calls of a check


@runtime_checkable
class StateSpace(Protocol):
    """A state space by its matrices, such as a control.StateSpace; dt: 0 or None: continuous; else the period in s."""

    A: Any
    B: Any
    C: Any
    D: Any
    dt: object
    nstates: object
    ninputs: object


@runtime_checkable
class Responding(Protocol):
    """A system of which only the response is known, such as one with exact delays."""

    @property
    def dt(self) -> Any:
        """0: continuous; else the period in s."""

    def response(self, omega: Array) -> Array:
        """Complex, (len(omega),) or (outputs, inputs, len(omega))."""


@dataclass(frozen=True, slots=True)
class Source:
    """A system as the analyses see it.

    at: the response at frequencies within [low, high], (outputs, inputs, len(omega)); features: its poles and zeros
    as s, by which grids are laid out (None: unknown); points: the frequencies of measured data; infinity: the gain
    at infinite frequency of a continuous system (None: unknown, or sampled).
    """

    at: Callable[[Array], Array]
    dt: float
    outputs: int
    inputs: int
    low: float
    high: float
    features: Array | None
    points: Array | None
    infinity: Array | None
    realization: Realization | None

    def asking(self, check: Callable[[], None] | None) -> Source:
        """Return the same system, which calls `check` every few frequencies at which it computes responses."""
        if check is None:
            return self

        def at(omega: Array) -> Array:
            parts = []
            for k in range(0, max(1, len(omega)), _PART):
                check()
                parts.append(self.at(omega[k : k + _PART]))
            return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)

        return replace(self, at=at)

    def siso(self, omega: Array) -> Array:
        """The response of one input and one output, (len(omega),)."""
        return np.asarray(self.at(np.atleast_1d(np.asarray(omega, dtype=float)))[0, 0])


def is_of(system: object, *names: str, package: str = "control") -> bool:
    """Whether it is of a class of a package, which is not loaded to know that: who made the system has loaded it."""
    module = sys.modules.get(package)
    return module is not None and isinstance(system, tuple(getattr(module, name) for name in names))


def source(system: Any) -> Source:
    """What the analyses need of a system. Raises UsageError (E501)."""
    if isinstance(system, StateSpace):
        return _ofbalanced(balanced(system))
    if is_of(system, "TransferFunction"):
        return _ofpolynomials(system)
    if is_of(system, "FrequencyResponseData"):
        return _of_points(system)
    if isinstance(system, Responding):
        return _of_response(system)
    if callable(getattr(system, "frd", None)):  # a Response
        return _of_points(system.frd())
    cure = "Give a StateSpace, TransferFunction or FrequencyResponseData, or an object with .response and .dt."
    cure = system_of(type(system).__name__) or cure
    raise UsageError(Fault("E501", "system", f"{type(system).__name__} is not a linear system.", cure))


def _ofbalanced(model: Realization) -> Source:
    seen = model.visible()
    dt = model.dt
    high = math.inf if dt == 0 else math.pi / dt
    features = equivalent(np.concatenate([seen.eigenvalues(), *_channel_zeros(seen)]), dt)
    outputs, inputs = model.d.shape
    infinity = model.d if dt == 0 else None
    return Source(
        lambda omega: seen.at(variable(omega, dt)), dt, outputs, inputs, 0.0, high, features, None, infinity, model
    )


def _channel_zeros(model: Realization) -> list[Array]:
    """Zeros of the whole and of single channels: where a gain dips.

    Of the first few channels only; more would cost more than they are worth.
    """
    pairs = [(i, j) for i in range(model.d.shape[0]) for j in range(model.d.shape[1])][:9]
    parts = [model, *(model.channel(i, j).visible() for i, j in pairs)] if len(pairs) > 1 else [model]
    return [invariant_zeros(part) for part in parts] if len(model.a) <= _MANY else []


def polynomials(system: Any) -> list[list[tuple[Array, Array]]]:
    """(numerator, denominator) of each channel, without leading zeros."""
    return [
        [
            (np.trim_zeros(np.asarray(num, dtype=float), "f"), np.trim_zeros(np.asarray(den, dtype=float), "f"))
            for num, den in zip(nums, dens, strict=True)
        ]
        for nums, dens in zip(system.num_list, system.den_list, strict=True)
    ]


def _ofpolynomials(system: Any) -> Source:
    dt = period(system.dt)
    table = polynomials(system)
    for num, den in (pair for line in table for pair in line):
        check_finite(**{"a numerator": num, "a denominator": den})
    rows, columns = len(table), len(table[0])
    roots = [np.roots(coefficients) for line in table for pair in line for coefficients in pair if len(coefficients)]
    features = np.concatenate([np.zeros(0, complex), *roots])

    def at(omega: Array) -> Array:
        x = 1j * omega if dt == 0 else 1.0 + variable(omega, dt)
        response = np.empty((rows, columns, len(omega)), dtype=complex)
        with np.errstate(divide="ignore", invalid="ignore"):
            for i, line in enumerate(table):
                for j, (num, den) in enumerate(line):
                    top, bottom = np.polyval(num, x) if len(num) else np.zeros(len(x)), np.polyval(den, x)
                    response[i, j] = np.where(bottom == 0, math.inf, top / bottom)
        return response

    proper = dt == 0 and all(len(num) <= len(den) for line in table for num, den in line)
    infinity = None
    if proper:
        infinity = np.array([[n[0] / d[0] if len(n) == len(d) else 0.0 for n, d in line] for line in table])
    high = math.inf if dt == 0 else math.pi / dt
    features = equivalent(features - 1.0, dt) if dt > 0 else features
    return Source(at, dt, rows, columns, 0.0, high, features, None, infinity, None)


def _of_points(system: Any) -> Source:
    order = np.argsort(np.asarray(system.omega, dtype=float))
    omega = np.asarray(system.omega, dtype=float)[order]
    values = np.asarray(system.frdata, dtype=complex)[:, :, order]

    def at(wanted: Array) -> Array:
        index = np.clip(np.searchsorted(omega, wanted), 0, len(omega) - 1)
        index = np.where(np.abs(omega[index - 1] - wanted) < np.abs(omega[index] - wanted), index - 1, index)
        off = np.abs(omega[index] - wanted) > 1e-12 * np.abs(wanted)
        if np.any(off):
            cure = "Use the measured frequencies, or fit a model first."
            message = f"the data were measured at {len(omega)} frequencies, but not at {wanted[off][0]:g} rad/s."
            raise AnalysisError(Fault("E705", "response", message, cure))
        return np.asarray(values[:, :, index])

    outputs, inputs = values.shape[:2]
    low, high = float(omega[0]), float(omega[-1])
    return Source(at, period(system.dt), outputs, inputs, low, high, None, omega, None, None)


def _of_response(system: Responding) -> Source:
    dt = period(system.dt)

    def at(omega: Array) -> Array:
        values = np.asarray(system.response(omega), dtype=complex)
        return values.reshape(1, 1, -1) if values.ndim == 1 else values

    shape = at(np.array([1.0 if dt == 0 else 1e-3 * math.pi / dt])).shape
    high = math.inf if dt == 0 else math.pi / dt
    return Source(at, dt, shape[0], shape[1], 0.0, high, None, None, None, None)


def label(name: str) -> str:
    """A signal's name as python-control takes it."""
    return name.replace(".", "_")


def frd(value: Array, omega: Array, *, inputs: Sequence[str], outputs: Sequence[str], dt: float = 0.0) -> object:
    """A control.FrequencyResponseData of `value`, complex, shape (outputs, inputs, n), at `omega` in rad/s.

    dt: 0 for a response in continuous time, else the period in s. Signals keep their names as `label` has them.
    """
    import control

    names = {"inputs": list(map(label, inputs)), "outputs": list(map(label, outputs))}
    return control.FrequencyResponseData(np.asarray(value), np.asarray(omega, dtype=float), dt=dt, **names)


def interpolated(known: Source) -> Callable[[Array], Array]:
    """Measured data between their points: log gain and unwrapped phase by monotone cubics over log omega."""
    from scipy.interpolate import PchipInterpolator

    assert known.points is not None
    omega = known.points[known.points > 0]
    values = known.siso(omega)
    if len(omega) < 2 or np.any(values == 0) or not np.all(np.isfinite(values)):
        cure = "Give at least two frequencies above zero, with finite values that are not zero."
        raise AnalysisError(Fault("E705", "response", "the measured data cannot be interpolated.", cure))
    x = np.log(omega)
    logs = PchipInterpolator(x, np.stack([np.log(np.abs(values)), np.unwrap(np.angle(values))], axis=-1))

    def at(wanted: Array) -> Array:
        both = logs(np.clip(np.log(wanted), x[0], x[-1]))
        return np.asarray(np.exp(both[:, 0] + 1j * both[:, 1]))

    return at
