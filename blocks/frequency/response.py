"""What a linear system does at each frequency: responses, poles, zeros, bandwidths, norms and peaks.

Accepted everywhere: control.StateSpace, control.TransferFunction, control.FrequencyResponseData, and `Responding`, an
object of which only the response is known. Frequencies in rad/s, poles in 1/s or as z. A sampled system without a
period (dt = True) is taken with period 1 s.

Reference: N. A. Bruinsma, M. Steinbuch, A fast algorithm to compute the H-infinity norm, Syst. Control Lett. 14 (1990).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

import numpy as np

from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault, UsageError
from .realization import (
    Realization,
    around_zero,
    balanced,
    components,
    count_at_zero,
    growth,
    invariant_zeros,
    period,
    regular,
)
from .search import Peak, curve, first_fall, highest, largest, layout, refined, summit
from .systems import Source, StateSpace, is_of, polynomials, source

HALF_POWER = 10.0 * math.log10(2.0)  # dB: a gain of 1/sqrt(2)
_EPS = float(np.finfo(float).eps)
_LIKELY = 1e-6  # of the norm of a matrix: eigenvalues that may be at zero, and moved by what makes them ill-conditioned


def response(system: object, omega: Iterable[float] | float) -> Array:
    """The complex response at frequencies omega [rad/s], shape (outputs, inputs, len(omega)).

    inf at a pole. Sampled systems: z = exp(j omega dt), and omega at most pi/dt. Raises AnalysisError (E705) for
    measured data at a frequency that was not measured, and UsageError (E501).
    """
    wanted = np.atleast_1d(np.asarray(omega, dtype=float))
    if wanted.ndim != 1 or not np.all(np.isfinite(wanted)):
        raise UsageError(Fault("E501", "response", "frequencies must be finite numbers in one row, in rad/s."))
    return source(system).at(wanted)


def poles(system: object) -> Array:
    """Poles, sorted by size: s in 1/s, or z. Hidden modes are among them.

    Transfer functions: the roots of the denominators; a root that several channels share is listed once for each.
    Raises AnalysisError (E705) where only a response is known.
    """
    if isinstance(system, StateSpace):
        model = balanced(system)
        return _sorted(model.eigenvalues() + (1.0 if model.dt > 0 else 0.0))
    if is_of(system, "TransferFunction"):
        roots = [np.roots(den) for line in polynomials(system) for _, den in line]
        return _sorted(np.concatenate([np.zeros(0, complex), *roots]))
    source(system)
    cure = "Give a state space or a transfer function: a fitted model, or pade=3 for delays."
    raise AnalysisError(Fault("E705", "poles", "the poles of measured or delayed responses are unknown.", cure))


def zeros(system: Any) -> Array:
    """Finite invariant zeros, sorted by size: s in 1/s, or z. A hidden mode is both a pole and a zero.

    Zeros of (A, B, C, D) by reduction to a pencil without infinite zeros, of any number of inputs and outputs;
    transfer functions have zeros here with one input and one output. Raises AnalysisError (E705).
    """
    if isinstance(system, StateSpace):
        model = balanced(system)
        return _sorted(invariant_zeros(model) + (1.0 if model.dt > 0 else 0.0))
    if is_of(system, "TransferFunction") and system.ninputs == system.noutputs == 1:
        return _sorted(np.asarray(np.roots(polynomials(system)[0][0][0]), dtype=complex))
    source(system)
    cure = "Give a StateSpace."
    raise AnalysisError(
        Fault("E705", "zeros", "the zeros of a response or of a matrix of polynomials are unknown.", cure)
    )


def _sorted(values: Array) -> Array:
    return values[np.lexsort((values.imag, values.real, np.abs(values)))]


def dc_gain(system: object) -> Array:
    """The gain at zero frequency, real, (outputs, inputs); inf (with its sign) where there is an integrator.

    An integrator that cancels, in the structure or in numbers, leaves the finite gain. Raises AnalysisError (E705) for
    measured data without zero frequency.
    """
    known = source(system)
    if known.points is not None or known.features is None:
        return known.at(np.array([0.0]))[:, :, 0].real
    out = np.empty((known.outputs, known.inputs))
    for i in range(known.outputs):
        for j in range(known.inputs):
            out[i, j] = _dc_of_channel(known, system, i, j)
    return out


def _dc_of_channel(known: Source, system: object, output: int, input: int) -> float:
    if known.realization is not None:
        model = known.realization.channel(output, input).visible()
        if not len(model.a):
            return float(model.d[0, 0])
        sound = all(regular(model.a[np.ix_(k, k)]) for k in components(model.a))
        if sound or not count_at_zero(model.eigenvalues(), float(np.linalg.norm(model.a)), _LIKELY):
            vanishes = not regular(np.block([[model.a, model.b], [model.c, model.d]]))
            if vanishes and (sound or np.any(invariant_zeros(model) == 0)):
                return 0.0  # a zero at zero frequency, and not what rounding leaves of it
            with suppress(np.linalg.LinAlgError):
                return float((model.d - model.c @ np.linalg.solve(model.a, model.b))[0, 0])
        return around_zero(model.at, model.eigenvalues(), float(np.linalg.norm(model.a)))
    num, den = polynomials(system)[output][input]
    point = 0.0 if known.dt == 0 else 1.0
    sound = _is_sure(den, point)
    roots = np.roots(den) - point
    size = float(np.max(np.abs(roots), initial=0.0))
    if sound or (np.polyval(den, point) and not count_at_zero(roots, size, _LIKELY)):
        if not _is_sure(num, point) and (sound or not len(num) or count_at_zero(np.roots(num) - point, 1.0)):
            return 0.0
        return float(np.polyval(num, point) / np.polyval(den, point))
    return around_zero(lambda p: (np.polyval(num, p + point) / np.polyval(den, p + point))[None, None], roots)


def _is_sure(coefficients: Array, point: float) -> bool:
    """Whether the value of a polynomial is more than what rounding leaves of 0."""
    floor = 8 * len(coefficients) * _EPS * float(np.sum(np.abs(coefficients)))
    return len(coefficients) > 0 and abs(float(np.polyval(coefficients, point))) > floor


def bandwidth(system: object, *, drop: float = HALF_POWER, relative: str = "dc") -> float | None:
    """The frequency [rad/s] at which the gain has fallen by `drop` [dB], to full precision; None: it never does.

    relative: "dc": the lowest at which the gain falls below its value at zero frequency; "peak": the lowest above the
    peak's own frequency; "unity": the lowest at which it falls from above to 0 dB - drop. One input, one output.
    Raises AnalysisError (E705) where the gain at zero frequency is zero or infinite, and UsageError (E501).
    """
    known = single(system, "bandwidth")
    if relative not in ("dc", "peak", "unity"):
        raise UsageError(Fault("E501", "bandwidth", f"relative= must be 'dc', 'peak' or 'unity', not {relative!r}."))
    if not drop > 0:
        raise UsageError(Fault("E501", "bandwidth", f"drop= must be a positive number of dB, not {drop!r}."))
    begin = 0.0
    if relative == "dc":
        reference = abs(float(dc_gain(system)[0, 0]))
        if reference == 0 or math.isinf(reference):
            what, cure = "zero", str(getattr(system, "hint", "")) or "Use relative='peak' or relative='unity'."
            if reference:
                what, cure = "infinite (there is an integrator)", "Use relative='unity'."
            raise AnalysisError(Fault("E705", "bandwidth", f"the gain at zero frequency is {what}.", cure))
    elif relative == "peak":
        top = peak(system)
        reference, begin = top.value, top.frequency
        if math.isinf(reference) or reference == 0:
            what = "no largest value" if reference else "no value but zero"
            raise AnalysisError(Fault("E705", "bandwidth", f"the gain has {what}.", "Use relative='unity'."))
        if begin >= known.high:
            return None
    else:
        reference = 1.0
    at = curve(known)
    omega, values = refined(at, layout(known))
    if known.dt > 0 and known.points is None:
        omega, values = np.append(omega, known.high), np.append(values, at(np.array([known.high])))
    gains = np.abs(values)
    if begin > 0:
        gains = np.append(reference, gains[omega > begin])
        omega = np.append(begin, omega[omega > begin])
    level = reference * 10 ** (-drop / 20)
    return first_fall(lambda w: np.abs(at(w)), omega, gains, level, above=relative != "unity")


def single(system: object, place: str) -> Source:
    """Return the source of a system of one input and one output. Raises UsageError (E501) for others."""
    known = source(system)
    if (known.outputs, known.inputs) != (1, 1):
        what = f"{known.outputs} outputs and {known.inputs} inputs, but must have one of each."
        raise UsageError(Fault("E501", place, what, "Choose a channel: system[i, j]."))
    return known


def peak(system: object) -> Peak:
    """The largest gain over all frequencies, stable or not; inf at a pole on the axis. MIMO: of singular values.

    Of measured data: the largest measured value.
    """
    known = source(system)

    def gain(omega: Array) -> Array:
        return largest(known.at(omega))

    if known.points is not None:
        gains = gain(known.points)
        return Peak(float(np.max(gains)), float(known.points[int(np.argmax(gains))]))
    limits = [0.0, known.high] if known.dt > 0 else [0.0]
    with np.errstate(all="ignore"):
        ends = [Peak(float(v), w) for v, w in zip(gain(np.array(limits)), limits, strict=True) if not np.isnan(v)]
    if known.infinity is not None:
        ends.append(Peak(float(np.linalg.norm(known.infinity, 2)), math.inf))
    omega, values = refined(lambda w: gain(w).astype(complex), layout(known))
    return highest(gain, omega, np.abs(values), ends)


def _decaying(system: Any, place: str) -> Realization | None:
    """The visible part, whose poles all decay; raises AnalysisError (E705) otherwise. None: a transfer function."""
    if isinstance(system, StateSpace):
        model: Realization | None = balanced(system).visible()
        assert model is not None
        modes, dt = model.eigenvalues(), model.dt
    elif is_of(system, "TransferFunction"):
        model, dt = None, period(system.dt)
        modes = poles(system) - (1.0 if dt > 0 else 0.0)
    else:
        raise AnalysisError(Fault("E705", place, "the stability of a response is unknown.", "Use peak()."))
    growing = modes[growth(modes, dt) >= 0]
    if len(growing):
        worst = growing[0] + (1.0 if dt > 0 else 0.0)
        message = f"the system is not stable: a pole at {complex(worst):.6g}."
        raise AnalysisError(Fault("E705", place, message, "Give a closed loop, or use peak()."))
    return model


def h2(system: Any) -> float:
    """The H2 norm: the standard deviation of the outputs under unit white noise at the inputs (two-sided density 1).

    Sampled systems: under white samples of variance 1. inf where a continuous system has a direct gain. Raises
    AnalysisError (E705) where the system is not stable.
    """
    from scipy.linalg import solve_continuous_lyapunov

    model = _decaying(system, "h2")
    if model is None:
        import control

        # Squares of channels add up; each has its own realization.
        channels = [control.tf2ss(system[i, j]) for i in range(system.noutputs) for j in range(system.ninputs)]
        return math.hypot(*(h2(channel) for channel in channels))
    direct = float(np.linalg.norm(model.d))
    if model.dt == 0 and direct > 0:
        return math.inf
    if not len(model.a):
        return direct
    if model.dt == 0:
        gramian = solve_continuous_lyapunov(model.a, -model.b @ model.b.T)
    else:
        # The bilinear map keeps the gramian, and with A - I it keeps the digits of poles near z = 1.
        inverse = np.linalg.inv(model.a + 2 * np.eye(len(model.a)))
        b = inverse @ model.b
        gramian = solve_continuous_lyapunov(inverse @ model.a, -2 * b @ b.T)
    return math.hypot(math.sqrt(max(0.0, float(np.trace(model.c @ gramian @ model.c.T)))), direct)


def hinf(system: object) -> Peak:
    """The H-infinity norm and its frequency: the peak, proved to be the highest by the Hamiltonian's eigenvalues.

    Raises AnalysisError (E705) where the system is not stable.
    """
    model = _decaying(system, "hinf")
    best = peak(system)
    if model is None or not len(model.a) or best.value == 0:
        return best
    known = source(system)
    for _ in range(20):
        crossings = _level_crossings(model, best.value * (1 + 1e-8))
        if len(crossings) < 2:
            break
        middle = np.sqrt(crossings[1:] * crossings[:-1])
        gains = largest(known.at(middle))
        k = int(np.argmax(gains))
        if gains[k] <= best.value * (1 + 1e-8):
            break
        at, value = summit(lambda w: largest(known.at(w)), crossings[k], crossings[k + 1])
        best = max(
            best, Peak(float(gains[k]), float(middle[k])), Peak(value, at), key=lambda candidate: candidate.value
        )
    return best


def _level_crossings(model: Realization, level: float) -> Array:
    """Frequencies at which a singular value is `level`, above the largest one of D."""
    a, b, c, d, dt = model.a, model.b, model.c, model.d, model.dt
    if dt > 0:
        # z = (1 + w)/(1 - w) keeps the norm: (A + I)^-1 = (delta + 2 I)^-1.
        inverse = np.linalg.inv(a + 2 * np.eye(len(a)))
        a, b, c, d = inverse @ a, math.sqrt(2) * inverse @ b, math.sqrt(2) * c @ inverse, d - c @ inverse @ b
    r = level**2 * np.eye(d.shape[1]) - d.T @ d
    f = a + b @ np.linalg.solve(r, d.T @ c)
    q = c.T @ (np.eye(d.shape[0]) + d @ np.linalg.solve(r, d.T)) @ c
    hamiltonian = np.block([[f, b @ np.linalg.solve(r, b.T)], [-q, -f.T]])
    eigenvalues = np.linalg.eigvals(hamiltonian)
    near = np.abs(eigenvalues.real) < 1e-8 * np.maximum(np.abs(eigenvalues), 1e-8 * np.max(np.abs(eigenvalues)))
    omega = np.unique(eigenvalues.imag[near & (eigenvalues.imag > 0)])
    return np.asarray(2 * np.arctan(omega) / dt if dt > 0 else omega)
