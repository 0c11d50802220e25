"""Linear systems of python-control and scipy.signal as blocks of the library.

Neither package is loaded to recognize its systems: whoever made one has loaded it. All of a system goes into the
parameters of a block, so the file of the diagram needs neither package.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NoReturn, Protocol

import numpy as np

from ..contract.block import Block
from ..frequency.systems import is_of, polynomials
from ..library.arithmetic import MatrixGain
from ..library.continuous import StateSpace, TransferFunction, ZeroPoleGain
from ..library.discrete import DiscreteStateSpace, DiscreteTransferFunction
from ..model.diagram_value import is_name
from ..text.arrays import Array
from ..text.errors import Fault, UsageError
from ..text.printable import counted, quoted
from .entries import as_name

_SAME = 1e-9
"""Of the size of a root: two roots that differ by less are conjugate, and an imaginary part below it is 0."""


class LinearSystem(Protocol):
    """A StateSpace or TransferFunction of python-control, or an lti or dlti of scipy.signal."""

    @property
    def dt(self) -> Any:
        """The period in s of a sampled system."""


def as_block(name: str, system: object) -> Any:
    """Return the block for a linear system, and anything else as it is. name: of the block, for errors.

    Raises UsageError (E501) for a system that no block of the library can be.
    """
    if is_of(system, "lti", "dlti", package="scipy.signal"):
        return _of_scipy(name, system)
    if is_of(system, "StateSpace"):
        return _of_state_space(name, system)
    if is_of(system, "TransferFunction"):
        return _of_polynomials(name, system)
    if is_of(system, "FrequencyResponseData"):
        _refuse(name, system, "is measured data, which cannot be run.", "Fit a transfer function to the data first.")
    if is_of(system, "InputOutputSystem"):
        cure = "Write its equations as a block class, or add control.linearize(system, x0, u0)."
        _refuse(name, system, "is not linear: its functions cannot be stored in a diagram.", cure)
    return system


def name_of(system: Any) -> str:
    """Return the name of a system of python-control; "" if it has none of its own, or none that a block can have."""
    if not is_of(system, "InputOutputSystem"):
        return ""
    name = str(system.name)
    ports = [as_name(label.partition("[")[0]) for label in (*system.input_labels, *system.output_labels)]
    return name if is_name(name) and name not in ports else ""


def _of_state_space(name: str, system: Any) -> Block:
    names = _port_names(name, system)
    parts = [np.asarray(part) for part in (system.A, system.B, system.C, system.D)]
    return _state_space(name, system, parts, _period(name, system, is_static=system.nstates == 0), names)


def _of_polynomials(name: str, system: Any) -> Block:
    if (system.noutputs, system.ninputs) != (1, 1):
        cure = "Convert it with control.ss, which needs the package slycot for this, or add a block for each of them."
        _refuse(name, system, f"has {system.noutputs} x {system.ninputs} transfer functions.", cure)
    num, den = polynomials(system)[0][0]
    return _transfer_function(
        name, system, num, den, _period(name, system, is_static=max(len(num), len(den)) <= 1),
        _port_names(name, system),
    )  # fmt: skip


def _of_scipy(name: str, system: Any) -> Block:
    period = 0.0 if is_of(system, "lti", package="scipy.signal") else _period(name, system)
    if is_of(system, "StateSpace", package="scipy.signal"):
        parts = [np.asarray(part) for part in (system.A, system.B, system.C, system.D)]
        outputs, inputs = parts[3].shape
        names = {"inputs": "u" if inputs == 1 else "", "outputs": "y" if outputs == 1 else ""}
        return _state_space(name, system, parts, period, names)
    if is_of(system, "TransferFunction", package="scipy.signal"):
        # Several rows are outputs over one denominator, of which scipy knows the exact state space.
        several = np.ndim(system.num) > 1
        return _of_scipy(name, system.to_ss()) if several else _transfer_function(
            name, system, system.num, system.den, period, {}
        )  # fmt: skip
    if np.ndim(system.zeros) > 1:
        return _of_scipy(name, system.to_ss())
    zeros, poles = (_paired(name, system, roots) for roots in (system.zeros, system.poles))
    gain = float(_real(name, system, "gain", system.gain))
    if period:
        return _transfer_function(name, system, gain * np.poly(zeros), np.poly(poles), period, {})
    imaginary = {f"{key}_imag": part.imag for key, part in (("zeros", zeros), ("poles", poles)) if part.imag.any()}
    return ZeroPoleGain(zeros=zeros.real, poles=poles.real, k=gain, **imaginary)


def _state_space(name: str, system: object, parts: Sequence[Array], period: float, names: dict[str, str]) -> Block:
    A, B, C, D = (_real(name, system, key, part) for key, part in zip("ABCD", parts, strict=True))
    if not D.size:
        cure = "Add an input or an output, with zeros in its column or row."
        _refuse(name, system, f"has {counted(D.shape[1], 'input')} and {counted(D.shape[0], 'output')}.", cure)
    given: dict[str, Any] = {key: value for key, value in names.items() if value}
    if not len(A):
        if not period:
            return MatrixGain(K=D, **given)
        # A file cannot hold matrices without rows, so one state stays at 0.
        A, B, C = np.zeros((1, 1)), np.zeros((1, D.shape[1])), np.zeros((D.shape[0], 1))
    given = {"A": A, "B": B, "C": C, **({"D": D} if D.any() else {}), **given}
    return DiscreteStateSpace(period=period, **given) if period else StateSpace(**given)


def _transfer_function(
    name: str, system: object, num: Any, den: Any, period: float, names: dict[str, str]
) -> Block:
    num, den = (np.trim_zeros(_real(name, system, key, part), "f") for key, part in (("num", num), ("den", den)))
    own = {key: text for (key, text), port in zip(names.items(), "uy", strict=False) if text != port}
    given: dict[str, Any] = {"num": num if len(num) else [0.0], "den": den, **own}
    return DiscreteTransferFunction(period=period, **given) if period else TransferFunction(**given)


def _period(name: str, system: Any, *, is_static: bool = False) -> float:
    """Return the period of a system; 0 for continuous time. A gain in no time of its own is continuous."""
    if system.dt is True:
        _refuse(name, system, "is sampled with an unknown period.", "Give the period in s, as in dt=0.01.")
    if system.dt is None and not is_static:
        _refuse(name, system, "has dt=None.", "Give dt=0 for continuous time, or the period in s, as in dt=0.01.")
    return float(system.dt or 0.0)


def _port_names(name: str, system: Any) -> dict[str, str]:
    """Return the names of the ports of a system. Raises UsageError (E501) if two of them become the same name."""
    known: dict[str, str] = {}
    for label in (*system.input_labels, *system.output_labels):
        other = known.setdefault(as_name(label), label)
        if other != label:
            both = f"{quoted(other)} and {quoted(label)}"
            what = f"has the signals {both}, which both become {as_name(label)} in a diagram."
            _refuse(name, system, what, "Rename one of them, with letters, digits and _ only.")
    return {"inputs": _names(system.input_labels, "u"), "outputs": _names(system.output_labels, "y")}


def _names(labels: Sequence[str], letter: str) -> str:
    """Return the names of ports as a block takes them; "" for a vector that python-control has numbered."""
    if list(labels) == [f"{letter}[{k}]" for k in range(len(labels))]:
        return letter if len(labels) == 1 else ""
    return ", ".join(map(as_name, labels))


def _real(name: str, system: object, key: str, given: Any) -> Array:
    array = np.asarray(given)
    if np.iscomplexobj(array) and np.any(array.imag != 0):
        cure = "Use a system with real coefficients: its complex poles and zeros are conjugate pairs."
        _refuse(name, system, f"has a complex {key}.", cure)
    return np.array(array.real, dtype=float)


def _paired(name: str, system: object, given: Any) -> Array:
    """Return roots with each complex one before its conjugate, as ZeroPoleGain has them."""
    roots = np.asarray(given, dtype=complex)
    size = np.abs(roots)
    real, upper, lower = (
        [complex(root) for root in roots[which]]
        for which in (abs(roots.imag) <= _SAME * size, roots.imag > _SAME * size, roots.imag < -_SAME * size)
    )
    pairs: list[complex] = []
    for root in upper:
        partner = min(lower, key=lambda other: abs(other - root.conjugate()), default=None)
        if partner is None or abs(partner - root.conjugate()) > _SAME * abs(root):
            break
        lower.remove(partner)
        pairs += [root, root.conjugate()]
    if lower or len(pairs) != 2 * len(upper):
        cure = "Add the conjugate of each complex pole and zero."
        _refuse(name, system, "has complex poles or zeros without their conjugates.", cure)
    return np.array([*(root.real for root in real), *pairs], dtype=complex)


def _refuse(name: str, system: object, message: str, cure: str) -> NoReturn:
    raise UsageError(Fault("E501", name, f"the {type(system).__name__} {message}", cure))
