"""Frequency responses that were estimated, and how far they are from models and from each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..frequency.response import response
from ..frequency.systems import frd, label
from ..text.arrays import Array
from ..text.errors import Fault, UsageError


@dataclass(frozen=True, eq=False)
class Response:
    """A frequency response that was estimated.

    value: complex, shape (outputs, n), at omega [rad/s], shape (n,), in SI units of output over input. amplitude: of
    the excitation at each frequency, in SI. harmonics: of sine streams, the size of the 2nd, 3rd ... harmonic over that
    of the fundamental, shape (outputs, k - 1, n). distortion: of sine streams the root of the sum of their squares; of
    multisines the level of the lines around that were not excited; NaN of chirps; shape (outputs, n). mean: of each
    output. settled: whether the last windows agreed, shape (n,); of chirps, whether the diagram came to rest where it
    had begun. periods: in the window that counted. seconds: simulated for a frequency. method: "sine stream", "odd
    multisine" or "chirp". units: of the outputs. is_approximate: of chirps. even, odd: of multisines, what stands at
    all even and all odd lines that were not excited over what stands at those that were, shape (outputs,).
    """

    diagram: str
    input: str
    outputs: tuple[str, ...]
    omega: Array
    value: Array
    amplitude: Array
    harmonics: Array
    distortion: Array
    mean: Array
    settled: Array
    periods: Array
    seconds: Array
    method: str
    units: tuple[str, ...] = ()
    is_approximate: bool = False
    even: Array = field(default_factory=lambda: np.empty(0))
    odd: Array = field(default_factory=lambda: np.empty(0))

    @property
    def decibels(self) -> Array:
        """20 lg |value|, shape (outputs, n)."""
        with np.errstate(divide="ignore"):
            return 20.0 * np.log10(np.abs(self.value))

    @property
    def degrees(self) -> Array:
        """The phase, followed along omega, shape (outputs, n)."""
        return np.degrees(np.unwrap(np.angle(self.value), axis=1))

    def frd(self) -> object:
        """As control.FrequencyResponseData, for its plots and for `blocks.frequency`; frequencies in their order."""
        order = np.argsort(self.omega, kind="stable")
        value = self.value[:, None, order]
        return frd(value, self.omega[order], inputs=[self.input], outputs=self.outputs)

    def __str__(self) -> str:
        approximate = ", approximate" if self.is_approximate else ""
        lines = [f"{self.diagram}: {self.input} -> {', '.join(self.outputs)} ({self.method}{approximate})"]
        titles = "".join(f"{'dB':>10} {'deg':>9} {'dist.':>8}" for _ in self.outputs)
        lines.append(f"{'rad/s':>11} {'amplitude':>10}{titles}")
        decibels, degrees = self.decibels, self.degrees
        for k, omega in enumerate(self.omega):
            row = f"{omega:11.5g} {self.amplitude[k]:10.4g}"
            for i in range(len(self.outputs)):
                row += f"{decibels[i, k]:10.3f} {degrees[i, k]:9.2f} {self.distortion[i, k]:8.2g}"
            lines.append(row + ("" if self.settled[k] else "  not settled"))
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two responses side by side, A over B: differences in dB and in degrees within -180 ... 180, (outputs, n)."""

    outputs: tuple[str, ...]
    omega: Array
    decibels: Array
    degrees: Array
    most_decibels: float
    most_degrees: float

    @property
    def _within(self) -> Array:
        return (np.abs(self.decibels) <= self.most_decibels) & (np.abs(self.degrees) <= self.most_degrees)

    @property
    def is_within(self) -> bool:
        """Whether all differences are within the bounds; one that is no number is not."""
        return bool(self._within.all())

    @property
    def worst_decibels(self) -> float:
        """The largest difference in dB."""
        return float(np.max(np.abs(self.decibels)))

    @property
    def worst_degrees(self) -> float:
        """The largest difference in degrees."""
        return float(np.max(np.abs(self.degrees)))

    def __str__(self) -> str:
        within = self._within
        lines = [f"{'rad/s':>11}" + "".join(f"{name + ' dB':>24}{'deg':>9}" for name in self.outputs)]
        for k, omega in enumerate(self.omega):
            cells = zip(self.decibels[:, k], self.degrees[:, k], strict=True)
            row = f"{omega:11.5g}" + "".join(f"{a:24.4f}{b:9.3f}" for a, b in cells)
            lines.append(row + ("" if within[:, k].all() else "  beyond"))
        verdict = "within" if self.is_within else "beyond"
        lines.append(
            f"{verdict} {self.most_decibels:g} dB and {self.most_degrees:g} deg: "
            f"at most {self.worst_decibels:.4f} dB and {self.worst_degrees:.3f} deg apart"
        )
        return "\n".join(lines)


def compare(a: Response, b: object, *, decibels: float = 0.5, degrees: float = 3.0) -> Comparison:
    """How far a response is from a model, or from another response, at the frequencies of A, with a verdict.

    b: a Response at the same frequencies, a linear system of python-control, measured data, or an object with
    `response(omega)`. Of a system with more inputs and outputs, those with A's names are taken. Raises UsageError
    (E501) where they do not fit.
    """
    values = _other(a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = a.value / values
        apart = 20.0 * np.log10(np.abs(ratio))
    turned = np.degrees(np.angle(ratio))
    turned[np.isnan(ratio)] = np.nan
    return Comparison(a.outputs, a.omega, apart, turned, float(decibels), float(degrees))


def _other(a: Response, b: object) -> Array:
    """The values of a model at the frequencies of A, shape (outputs, n)."""
    if isinstance(b, Response):
        if b.value.shape != a.value.shape or not np.allclose(b.omega, a.omega, rtol=1e-6, atol=0.0):
            message = "the responses differ in their frequencies or in their number of outputs."
            raise UsageError(Fault("E501", "compare", message, "Estimate both with the same signal."))
        return b.value
    whole = response(b, a.omega)
    rows = _picked(a.outputs, getattr(b, "output_labels", None), whole.shape[0], "output")
    columns = _picked((a.input,), getattr(b, "input_labels", None), whole.shape[1], "input")
    return whole[rows, columns[0], :]


def _picked(names: Sequence[str], labels: Any, count: int, what: str) -> list[int]:
    """The positions of names among those of a model; in order where no name matches and it has as many."""
    spelled = [str(label) for label in labels or ()]
    for known_ in (list(names), list(map(label, names))):
        if all(name in spelled for name in known_):
            return [spelled.index(name) for name in known_]
    if len(names) == count:
        return list(range(count))
    message = f"the model has {count} {what}s ({', '.join(spelled)}), but {', '.join(names)} is missing."
    raise UsageError(Fault("E501", "compare", message, f"Give a model with the {what}s of the response."))
