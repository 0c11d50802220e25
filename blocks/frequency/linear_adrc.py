"""Linear ADRC in closed form, for plants y^(n) = f + b0 u of any order n: gains, transfer functions, sampling.

    dz_i/dt = z_{i+1} + b_i e,   dz_n/dt = z_{n+1} + b0 u + b_n e,   dz_{n+1}/dt = b_{n+1} e,   e = y - z1
    u = (k_1 (r - z1) - k_2 z2 - ... - k_n zn - z_{n+1})/b0

With Delta(s) = s^(n+1) + b_1 s^n + ... + b_{n+1} and P(s) = s^n + k_n s^(n-1) + ... + k_1 everything follows from one
division with remainder, Delta P = s^(n+1) D + N:

    u = C_fb (C_pf r - y),   C_fb = N/(b0 s D),   C_pf = k_1 Delta/N

In the plant y^(n) = f + b0 u the characteristic polynomial is then s^(n+1) D + N = Delta P: the poles are those of the
observer and those of the feedback. N and D are sums of products of gains, in which nothing cancels.

What depends on a diagram comes from its own linear model (`observer_report`, `loop_report`); these formulas take gains.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault, UsageError

_DECADES_POINTS = 40  # of the search for cycles: laws of ADRC change their gain slowly along a decade


# --- gains -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains of a linear ADRC: feedback k_1 ... k_n [1/s^n ... 1/s], observer b_1 ... b_{n+1} [1/s ... 1/s^(n+1)].

    They are what the blocks take: LSEF(gains=gains.feedback), LESO(gains=gains.observer). poles: those of the loop with
    the plant y^(n) = f + b0 u, n of the feedback and then n + 1 of the observer [1/s].
    """

    feedback: tuple[float, ...]
    observer: tuple[float, ...]
    poles: tuple[complex, ...]

    @property
    def order(self) -> int:
        """n, the order of the plant."""
        return len(self.feedback)


def bandwidth_gains(n: int, wo: float) -> tuple[float, ...]:
    """b_k = (n + 1 over k) wo^k, k = 1 ... n + 1: all poles of the observer at -wo. wo in rad/s.

    Raises UsageError (E501), also for gains outside the range of floats.

    References: Z. Gao, Scaling and Bandwidth-Parameterization Based Controller Tuning, ACC 2003.
    """
    return _binomial(_order(n) + 1, _positive(wo, "wo"), "wo")


def adrc_gains(n: int, wc: float) -> tuple[float, ...]:
    """k_i = (n over i - 1) wc^(n - i + 1), i = 1 ... n: all poles of the feedback at -wc. wc in rad/s.

    Raises UsageError (E501), also for gains outside the range of floats.

    References: Z. Gao, Scaling and Bandwidth-Parameterization Based Controller Tuning, ACC 2003.
    """
    return _binomial(_order(n), _positive(wc, "wc"), "wc")[::-1]


def _binomial(m: int, w: float, name: str) -> tuple[float, ...]:
    """(m over k) w^k, k = 1 ... m: the coefficients of (s + w)^m below s^m."""
    try:
        coefficients = tuple(math.comb(m, k) * w**k for k in range(1, m + 1))
    except OverflowError:
        coefficients = (math.inf,)
    if not all(0 < gain < math.inf for gain in coefficients):
        raise UsageError(Fault("E501", name, f"{w:g} overflows a double, or vanishes, when raised to the power {m}."))
    return coefficients


def half_gain(n: int, wc: float, wo: float, *, feedback: bool = True, observer: bool = True) -> Gains:
    """Gains of bandwidths wc and wo [rad/s], halved: half the gain of fast noise at about the same speed.

    feedback: k_1 ... k_n are halved, observer: b_1 ... b_{n+1} are. The polynomial of poles at -w becomes
    (s^m + (s + w)^m)/2, whose roots all have the real part -w/2: see `half_gain_poles`. So it is stable for every
    order. The halved gains are b'X of the X > 0 with A'X + X A - 2 X b b'X = -w X, for the chain (A, b) of integrators
    (alpha-controller, alpha = w): x'Xx decays as exp(-w t) whatever the begin.

    z_{n+1}/b0 must not be halved, or half of the disturbance stays. And k_1 multiplies both r and z1: one number, or y
    does not settle at r. LSEF and `controller` do so. Raises UsageError (E501).

    References: G. Herbst, A.-J. Hempel, T. Goehrt, S. Streif, Half-Gain Tuning for Active Disturbance Rejection
    Control, IFAC PapersOnLine 53(2), 2020.
    """
    k, b = adrc_gains(n, wc), bandwidth_gains(n, wo)
    of_feedback = half_gain_poles(n, wc).tolist() if feedback else [complex(-wc)] * n
    of_observer = half_gain_poles(n + 1, wo).tolist() if observer else [complex(-wo)] * (n + 1)
    return Gains(
        tuple(gain / 2.0 for gain in k) if feedback else k,
        tuple(gain / 2.0 for gain in b) if observer else b,
        (*of_feedback, *of_observer),
    )


def half_gain_poles(m: int, w: float) -> Array:
    """Roots of s^m + (s + w)^m = 0: -w/2 (1 + j cot((2 k + 1) pi/(2 m))), k = 0 ... m - 1, by imaginary part.

    m = n: the poles of a halved feedback of bandwidth w in the plant y^(n) = f + b0 u; m = n + 1: those of a halved
    observer. In 1/s.
    """
    m, w = _order(m), _positive(w, "w")
    angles = (2 * np.arange(m) + 1) * math.pi / (2 * m)
    # cos/sin of pi/2 leaves 6e-17, and a pole that is real should have no imaginary part at all.
    imaginary = np.where(2 * np.arange(m) + 1 == m, 0.0, np.cos(angles) / np.sin(angles))
    return np.asarray(-0.5 * w * (1.0 + 1j * imaginary))


def settling_bandwidth(n: int, time: float, band: float = 0.02) -> float:
    """wc [rad/s] for which a step of r settles within `band` after a time [s]: n poles at -wc, the estimates right.

    1 - y = exp(-x) (1 + x + ... + x^(n-1)/(n-1)!) with x = wc t: near 4/time for n = 1 and 6/time for n = 2. Raises
    UsageError (E501).
    """
    return _settled(n, band) / _positive(time, "time")


def settling_time(n: int, wc: float, band: float = 0.02) -> float:
    """The time [s] after which a step of r has settled within `band`: see `settling_bandwidth`."""
    return _settled(n, band) / _positive(wc, "wc")


def _settled(n: int, band: float) -> float:
    from scipy.special import gammainccinv

    if not 0 < _number(band) < 1:
        raise UsageError(Fault("E501", "band", f"must lie between 0 and 1, not {band!r}."))
    return float(gammainccinv(_order(n), band))


def equivalent_bandwidth(n: int, w3db: float) -> float:
    """wo [rad/s] of the observer with all poles at -wo whose f -> z_{n+1} has the bandwidth w3db [rad/s].

    Its response is (wo/(s + wo))^(n+1), so that w3db = wo sqrt(2^(1/(n+1)) - 1).
    """
    return _positive(w3db, "w3db") / math.sqrt(math.expm1(math.log(2.0) / (_order(n) + 1)))


# --- the observer ----------------------------------------------------------------------------------------------------


def observer(n: int, gains: Sequence[float], b0: float) -> object:
    """The observer as a control.StateSpace: inputs y, u, outputs z1 ... z_{n+1}.

    From y to z_i: s^(i-1) (b_i s^(n+1-i) + ... + b_{n+1})/Delta. From u to z_i up to n: b0 s (s^(i-1) + b_1 s^(i-2) +
    ... + b_{i-1})/Delta, and to z_{n+1}: -b0 b_{n+1}/Delta. Raises UsageError (E501).
    """
    import control

    n, b = _order(n), _gains(gains, "gains")
    _count(b, n + 1, "gains")
    A, L = _chain(n + 1), b[:, None]
    A[:, 0] -= b
    B = np.zeros((n + 1, 1))
    B[n - 1] = _nonzero(b0)
    names = [f"z{i}" for i in range(1, n + 2)]
    return control.ss(
        A, np.hstack([L, B]), np.eye(n + 1), np.zeros((n + 1, 2)), inputs=["y", "u"], outputs=names, states=names,
        remove_useless_states=False,
    )  # fmt: skip


def disturbance_estimate(gains: Sequence[float]) -> object:
    """f -> z_{n+1} = b_{n+1}/Delta as a control.TransferFunction, for any plant and any controller."""
    import control

    b = _gains(gains, "gains")
    return control.tf([b[-1]], [1.0, *b], inputs="f", outputs=f"z{len(b)}")


def disturbance_bandwidth(gains: Sequence[float]) -> float:
    """The frequency [rad/s] where f -> z_{n+1} falls to 1/sqrt(2) for the first time.

    The first positive root of |Delta(jw)|^2 = 2 b_{n+1}^2, a polynomial in w^2. Raises AnalysisError (E705) for an
    observer that is not stable.
    """
    b, scale = _stable(gains)
    # Delta(jw) = real(w^2) + j w imaginary(w^2); n + 1 is the degree.
    degree = len(b)
    delta = np.array([1.0, *b])[::-1]
    real = [delta[k] * (-1.0) ** (k // 2) for k in range(0, degree + 1, 2)]
    imaginary = [delta[k] * (-1.0) ** (k // 2) for k in range(1, degree + 1, 2)]
    squares = np.polynomial.polynomial
    size = squares.polyadd(squares.polymul(real, real), [0.0, *squares.polymul(imaginary, imaginary)])
    size[0] -= 2.0 * b[-1] ** 2
    roots = squares.polyroots(size)
    first = min(float(root.real) for root in roots if root.real > 0 and abs(root.imag) < 1e-7 * abs(root))
    for _ in range(3):  # Newton's steps restore the digits that the eigenvalues of a companion matrix lose
        first -= float(squares.polyval(first, size) / squares.polyval(first, squares.polyder(size)))
    return scale * math.sqrt(first)


def noise_gain(gains: Sequence[float]) -> float:
    """The H2 norm of y -> z_{n+1}: the deviation of z_{n+1} under unit white noise (two-sided) on y.

    n = 2: b3 sqrt(b2/(2 (b1 b2 - b3))); n = 1: b2/sqrt(2 b1). Any n: by the Lyapunov equation of the observer. Raises
    AnalysisError (E705) for an observer that is not stable.
    """
    from scipy.linalg import solve_continuous_lyapunov

    b, scale = _stable(gains)
    A = _chain(len(b))
    A[:, 0] -= b
    spread = solve_continuous_lyapunov(A, -np.outer(b, b))
    # In time of 1/scale z_{n+1} is scaled by scale^(n+1) and the density of the noise by scale^(1/2).
    return math.sqrt(float(spread[-1, -1])) * math.pow(scale, len(b) - 0.5)


# --- the controller --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Controller:
    """u = C_fb (C_pf r - y).

    feedback: C_fb, from -y, with an integrator. prefilter: C_pf, with gain 1 at zero frequency and one zero more than
    poles, so that it exists only together with C_fb. system: both of them, realized: a control.StateSpace with inputs r
    and y, output u and the states z1 ... z_{n+1} of the observer. Take `system` or `loop` where numbers matter, the
    transfer functions to read them.
    """

    feedback: object
    prefilter: object
    system: Any

    def loop(self, plant: object) -> Any:
        """L = C_fb plant, a control.StateSpace: the loop opened at the plant's input, negative feedback outside.

        plant: u -> y, a control.StateSpace or TransferFunction of one input and one output.
        """
        import control

        model = control.ss(plant)
        A, B, C, D = (np.asarray(m, dtype=float) for m in (model.A, model.B, model.C, model.D))
        if model.ninputs != 1 or model.noutputs != 1:
            message = f"has {model.ninputs} inputs and {model.noutputs} outputs, but a loop needs one of each."
            raise UsageError(Fault("E501", "plant", message, "Choose one channel: plant[0, 0]."))
        of = self.system
        Ac, Bc, Cc = (np.asarray(m, dtype=float) for m in (of.A, of.B[:, 1:], of.C))
        whole = np.block([[A, np.zeros((len(A), len(Ac)))], [Bc @ C, Ac]])
        return control.ss(
            whole, np.vstack([B, Bc @ D]), np.hstack([np.zeros((1, len(A))), -Cc]), [[0.0]],
            remove_useless_states=False,
        )  # fmt: skip


def controller(n: int, feedback: Sequence[float], observer: Sequence[float], b0: float) -> Controller:
    """C_fb and C_pf of a linear ADRC of order n, from its gains.

    n = 2: C_fb = [(k1 b1 + k2 b2 + b3) s^2 + (k1 b2 + k2 b3) s + k1 b3]/{b0 s [s^2 + (b1 + k2) s + b2 + k2 b1 + k1]}.
    feedback: k_1 ... k_n, observer: b_1 ... b_{n+1}. C_pf has the gain 1 at zero frequency whatever the gains, as k_1
    multiplies r and z1. Raises UsageError (E501).

    References: G. Herbst, Transfer Function Analysis and Implementation of Active Disturbance Rejection Control,
    Control Theory and Technology 19, 2021, with tables of n = 1 and 2.
    """
    import control

    n = _order(n)
    k, b, b0 = _gains(feedback, "feedback"), _gains(observer, "observer"), _nonzero(b0)
    _count(k, n, "feedback")
    _count(b, n + 1, "observer")
    delta, P = np.array([1.0, *b]), np.array([1.0, *k[::-1]])
    product = np.polymul(delta, P)
    D, N = product[: n + 1], product[n + 1 :]
    if not N.any():
        raise UsageError(
            Fault("E501", "controller", "all gains are 0, so that y does not reach u and C_pf does not exist.")
        )
    A = _chain(n + 1)
    A[:, 0] -= b
    A[n - 1, :n] -= k
    A[n - 1, n] = 0.0  # u takes z_{n+1} off: here is the integrator
    B = np.zeros((n + 1, 2))
    B[n - 1, 0], B[:, 1] = k[0], b
    names = [f"z{i}" for i in range(1, n + 2)]
    system = control.ss(
        A, B, np.array([[*-k, -1.0]]) / b0, np.array([[k[0] / b0, 0.0]]), inputs=["r", "y"], outputs=["u"],
        states=names, remove_useless_states=False,
    )  # fmt: skip
    return Controller(control.tf(N, b0 * np.append(D, 0.0)), control.tf(k[0] * delta, N), system)


# --- sampling --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SamplingLimits:
    """Periods [s] of a sampled observer or controller.

    euler: explicit Euler steps of the linear system are stable below it. usual: from 1/40 to 1/20 of the period of the
    bandwidth, between which sampling hardly shows; at most a third of the delay margin, as a sampled controller acts
    1.5 periods late: half a period by its hold, one if it computes as long.

    References: G. F. Franklin, J. D. Powell, M. L. Workman, Digital Control of Dynamic Systems, 3rd ed., Addison-Wesley
    1998, chapter 11.
    """

    euler: float
    usual: tuple[float, float]


def sampling_limits(
    poles: Iterable[complex], bandwidth: float | None = None, delay: float | None = None
) -> SamplingLimits:
    """Limits of the period for a system with these poles [1/s].

    Euler's step z -> z + Ts A z is stable where |1 + Ts p| < 1 for each pole: Ts < -2 Re p/|p|^2. bandwidth [rad/s]:
    that of the closed loop; without it, the modulus of the fastest pole counts. delay [s]: its delay margin. Raises
    UsageError (E501), AnalysisError (E705) where a pole is not in the left half plane.
    """
    try:
        p = np.asarray(list(poles), dtype=complex)
    except (TypeError, ValueError):
        p = np.zeros(0, dtype=complex)
    if p.ndim != 1 or not len(p) or not np.all(np.isfinite(p)):
        raise UsageError(Fault("E501", "poles", "must be finite numbers in 1/s, at least one."))
    worst = p[np.argmax(p.real)]
    if worst.real >= 0:
        message = f"the pole {worst:.6g} 1/s does not decay at any period."
        raise AnalysisError(Fault("E705", "poles", message, "Give poles with negative real parts."))
    w = float(np.max(np.abs(p))) if bandwidth is None else _positive(bandwidth, "bandwidth")
    euler = float(np.min(-2.0 * p.real / np.abs(p) ** 2))
    most = math.inf if delay is None or delay == math.inf else _positive(delay, "delay") / 3
    return SamplingLimits(euler, (min(2 * math.pi / (40 * w), most), min(2 * math.pi / (20 * w), most)))


@dataclass(frozen=True, slots=True)
class EulerCycle:
    """A cycle of two periods, e -> -e -> e, of an observer in Euler steps.

    amplitude: |e|, in the unit of y. stable: whether it comes back after a small change. multipliers: of that change
    from step to step, with the change of sign taken off; stable where all are below 1 in size.
    """

    amplitude: float
    stable: bool
    multipliers: tuple[complex, ...]


def euler_cycles(
    gains: Sequence[float],
    law: Callable[[float], float],
    period: float,
    *,
    amplitude: tuple[float, float] = (1e-15, 1e3),
) -> tuple[EulerCycle, ...]:
    """Cycles of two periods of an observer dz/dt = A0 z + L g(e) in Euler steps, at rest otherwise; by amplitude.

    law: g, odd. gains: L. period: Ts [s]. amplitude: where to look. With z(k + 1) = -z(k),

        z = -Ts/2 (1 + Ts/2 A0)^-1 L g(e)   and   e = -z1 = S g(e),   S = sum of (-1)^(k-1) (Ts/2)^k b_k

    as A0 only shifts: the amplitudes are where g(e)/e = 1/S. A law with an infinite slope at 0 has one for every
    period: its steps never come to rest, however short they are, though the observer does. A linear law has none, and
    1/S is where its steps become unstable. Raises UsageError (E501).
    """
    b, Ts = _gains(gains, "gains"), _positive(period, "period")
    low, high = (_positive(a, "amplitude") for a in amplitude)
    if low >= high:
        raise UsageError(
            Fault("E501", "amplitude", f"the lower limit {low:g} must lie below the upper limit {high:g}.")
        )
    powers = (0.5 * Ts) ** np.arange(1, len(b) + 1)
    S = float(np.sum(b * powers * (-1.0) ** np.arange(len(b))))

    def gap(at: float) -> float:
        A = math.exp(at)
        return S * float(law(A)) / A - 1.0

    from scipy.optimize import brentq

    points = np.linspace(math.log(low), math.log(high), max(2, round(_DECADES_POINTS * math.log10(high / low))))
    values = [gap(float(at)) for at in points]
    if not np.all(np.isfinite(values)):
        raise UsageError(Fault("E501", "law", f"is not finite between {low:g} and {high:g}."))
    cycles = []
    for left, right, a, b_ in zip(points, points[1:], values, values[1:], strict=False):
        if a * b_ < 0 or a == 0:
            at = float(left) if a == 0 else float(brentq(gap, left, right, xtol=1e-15, rtol=8.9e-16))
            cycles.append(_cycle(math.exp(at), b, law, Ts))
    return tuple(cycles)


def _cycle(A: float, b: Array, law: Callable[[float], float], Ts: float) -> EulerCycle:
    h = 1e-5 * A  # relative: the slope of a power changes with the size of e itself
    slope = (float(law(A + h)) - float(law(A - h))) / (2.0 * h)
    step = np.eye(len(b)) + Ts * _chain(len(b))
    step[:, 0] -= Ts * slope * b
    multipliers = np.linalg.eigvals(-step)
    order = np.argsort(-np.abs(multipliers))
    return EulerCycle(A, bool(np.max(np.abs(multipliers)) < 1.0), tuple(multipliers[order].astype(complex).tolist()))


# --- what is given ---------------------------------------------------------------------------------------------------


def _chain(size: int) -> Array:
    """A0: z_i' = z_{i+1}."""
    return np.eye(size, k=1)


def _number(value: Any) -> float:
    """nan for what is no number."""
    try:
        return float(value) if not isinstance(value, str) else math.nan
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _order(n: int) -> int:
    if isinstance(n, bool) or not 1 <= _number(n) < math.inf or int(n) != n:
        raise UsageError(Fault("E501", "n", f"must be an order, 1, 2, 3, ..., not {n!r}."))
    return int(n)


def _positive(value: float, name: str) -> float:
    if not 0 < _number(value) < math.inf:
        raise UsageError(Fault("E501", name, f"must be above 0, not {value!r}."))
    return float(value)


def _nonzero(b0: float) -> float:
    if not math.isfinite(_number(b0)) or b0 == 0:
        raise UsageError(Fault("E501", "b0", f"must be a finite gain other than 0, not {b0!r}."))
    return float(b0)


def _gains(gains: Sequence[float], name: str) -> Array:
    try:
        numbers = np.asarray(gains, dtype=float)
    except (TypeError, ValueError):
        numbers = np.array(math.nan)
    if numbers.ndim != 1 or not len(numbers) or not np.all(np.isfinite(numbers)):
        raise UsageError(Fault("E501", name, "must be finite numbers in one row."))
    return numbers


def _count(gains: Array, count: int, name: str) -> None:
    if len(gains) != count:
        raise UsageError(Fault("E501", name, f"has {len(gains)} values, but {count} are needed."))


def _stable(gains: Sequence[float]) -> tuple[Array, float]:
    """Gains in time of 1/scale, where b_{n+1} is 1, and the scale; of a stable observer."""
    b = _gains(gains, "gains")
    if b[-1] > 0:
        scale = float(b[-1] ** (1.0 / len(b)))
        scaled = b / scale ** np.arange(1, len(b) + 1)
        if np.max(np.roots([1.0, *scaled]).real) < 0:
            return scaled, scale
    p = np.roots([1.0, *b])
    worst = p[np.argmax(p.real)]
    message = f"the observer is not stable: it has the pole {worst:.6g} 1/s."
    raise AnalysisError(
        Fault("E705", "gains", message, "Use bandwidth_gains to compute the gains of a stable observer.")
    )
