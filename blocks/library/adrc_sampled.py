"""Linear active disturbance rejection control in sampled time as one block, in the forms that programs have."""

import math

import numpy as np

from ..contract.equations import local, output, requires
from ..contract.variables import UNLIMITED, Discrete, Input, Parameter
from .adrc import Ticks
from .adrc_laws import (
    after_period,
    b0_unit,
    each_error,
    each_estimate,
    error_units,
    feedback_gains,
    powers,
    rates,
    sampled_gains,
)

__all__ = ["DiscreteADRC"]


def _placed_gains(order, omega_c, period, placement):
    """Gains with all poles of the compensated plant at -omega_c, or of the sampled one at exp(-omega_c period)."""
    if omega_c is None:
        raise ValueError("give feedback or omega_c")
    if placement == "continuous":
        return feedback_gains(order, omega_c)
    # Ackermann's formula in steps of one period, in which the plant is a matrix of numbers.
    shifts = powers(np.eye(order, k=1), order)
    model = sum(shift / math.factorial(k) for k, shift in enumerate(shifts))
    reached = np.array([1.0 / math.factorial(order - i) for i in range(order)])
    columns = np.array([power @ reached for power in powers(model, order)]).T
    decay = -math.expm1(-float(omega_c) * float(period))
    wanted = np.linalg.matrix_power(model - np.eye(order) + decay * np.eye(order), order)
    gains = np.linalg.solve(columns.T, np.eye(order)[-1]) @ wanted
    return gains / float(period) ** np.arange(order, 0, -1)


def _observer_gains(order, omega_o, period):
    if omega_o is None:
        raise ValueError("give observer or omega_o")
    return sampled_gains(order, omega_o, period, "current")


# A polynomial in 1/z is the list of its coefficients. Products are written out: a compiled program adds in this order
# too, where that of a matrix product may be another.


def _dot(one, other):
    return sum(a * b for a, b in zip(one, other, strict=True))


def _later(order, time, z, i):
    """Element i of a chain of integrators a time after z."""
    term, total = 1.0, z[i]
    for m in range(1, order + 1 - i):
        term = term * time / m
        total = total + term * z[i + m]
    return total


def _times_chain(order, response):
    """The response times (1 - 1/z)^(n+1): its first coefficients, beyond which there are none."""
    factor = [math.comb(order + 1, i) * (-1.0) ** i for i in range(order + 2)]
    return [_dot(factor[: k + 1], response[k::-1]) for k in range(len(response))]


def _denominator(order, period, observer):
    """alpha: that of z(k) = (1 - L C)(A z(k-1) + B u(k-1)) + L y(k), without the leading 1."""
    response = [_later(order, k * period, observer, 0) for k in range(1, order + 2)]
    return np.stack(_times_chain(order, [1.0, *response])[1:])


def _of_y(order, period, observer, feedback):
    """beta: from y to (feedback, 1) z."""
    weights = [*[feedback[k] for k in range(order)], 1.0]
    response = [
        _dot(weights, [_later(order, k * period, observer, i) for i in range(order + 1)]) for k in range(order + 1)
    ]
    return np.stack(_times_chain(order, response))


def _of_u(order, period, observer, feedback, b0, alpha, beta):
    """gamma: from u(k-1) to (feedback, 1) z.

    With D = (1 - 1/z)^(n+1), P/D and Q/D from u to (feedback, 1) z and to y of the model alone, the observer has
    e = (D y - Q u)/(D alpha): gamma = (P alpha - beta Q)/D.
    """

    def pushed(k, i):  # what u, held for one period, has done to z_i k periods later
        power = order - i
        return float(period) ** power * (((k + 1.0) ** power - float(k) ** power) / math.factorial(power))

    n = order + 1
    of_y = _times_chain(order, [pushed(k, 0) for k in range(n)])
    weights = [feedback[i] for i in range(order)]
    of_z = _times_chain(order, [_dot(weights, [pushed(k, i) for i in range(order)]) for k in range(n)])
    known, seen = [1.0, *[alpha[k] for k in range(order)]], [beta[k] for k in range(n)]
    product = [_dot(of_z[: k + 1], known[k::-1]) - _dot(of_y[: k + 1], seen[k::-1]) for k in range(n)]
    back = [math.comb(order + k, k) for k in range(n)]
    return b0 * np.stack([_dot(back[: k + 1], product[k::-1]) for k in range(n)])


class DiscreteADRC(Ticks):
    """Linear ADRC at ticks, as one block: from the wanted r and the measured y the control u, held in between.

        v(k) = (sum of feedback_i (r_i(k) - z_i(k)) - z_{n+1}(k))/b0,   u(k) = v(k) within its limits
        z(k) = x(k) + observer (y(k) - x_1(k)),   x(k+1) = A z(k) + B u(k)

    A, B are the exact model of y^(n) = f + b0 u over one period: the observer is a DiscreteESO of the form current, and
    it gets the limited u, so that nothing winds up. Give `omega_c` or `feedback`, and `omega_o` or `observer`. The
    placement of omega_c: continuous takes the gains of an LSEF, right for a short period; discrete puts the poles of
    the sampled plant at exp(-omega_c period).

    The forms give the same u, but for rounding:

    state_space: as above.
    transfer_function: v(k) = (sum of feedback_i r_i(k) - w(k))/b0, with w from y and u by one filter with the
        numerators beta and gamma and the denominator alpha: n + 1 numbers of memory, and no matrix. Its rounding grows
        with 1/(omega_o period)^(n+1), and with it the error that is left at rest. Its memory depends on its gains: if
        they are set during a run, u jumps until the filter has settled; the state_space has no such jump.

    |u(k) - u(k-1)| is at most rate period. While `manual` is above 0, u is u_manual within the limits, and the observer
    follows. With `bumpless`, u goes on from there, and at the start from u_start: what is missing is added to v, and
    fades with the time constant `transfer`, by default 1/omega_c. Without it u jumps to v. du is the change of u, for
    an actuator that adds up.

    References: G. Herbst, Transfer Function Analysis and Implementation of Active Disturbance Rejection Control,
        Control Theory and Technology 19, 2021. G. Herbst, R. Madonski, Tuning and Implementation Variants of
        Discrete-Time ADRC, Control Theory and Technology 21, 2023.
    """

    form = Parameter(
        "state_space", structural=True, choices=("state_space", "transfer_function"), doc="how u is computed"
    )
    order = Parameter(2, structural=True, type="int", min=1, doc="order n of the plant")
    unit = Parameter("", structural=True, type="string", doc='unit of r and y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    period, offset = Ticks.period, Ticks.offset
    b0 = Parameter(1.0, unit=b0_unit, doc="gain of the control in the plant")
    omega_c = Parameter(None, unit="rad/s", excludes="feedback", positive=True, doc="bandwidth of the loop")
    omega_o = Parameter(None, unit="rad/s", excludes="observer", positive=True, doc="bandwidth of the observer")
    placement = Parameter(
        "continuous", structural=True, choices=("continuous", "discrete"), doc="plant whose poles omega_c places"
    )
    feedback = Parameter(
        _placed_gains,
        shape=each_error,
        unit=lambda order: rates("1/s", order)[::-1],
        doc="gain of each error",
    )
    observer = Parameter(
        _observer_gains,
        shape=each_estimate,
        unit=lambda order: rates("1", order + 1),
        doc="gain of the error in each estimate, at each tick",
    )
    lower = Parameter(-UNLIMITED, unit=unit_u, is_limit=True, doc="smallest u")
    upper = Parameter(UNLIMITED, unit=unit_u, is_limit=True, doc="largest u")
    rate = Parameter(UNLIMITED, unit=unit_u / "s", positive=True, is_limit=True, doc="fastest change of u")
    bumpless = Parameter(False, structural=True, type="bool", doc="whether u goes on from u_start and from u_manual")
    transfer = Parameter(
        lambda feedback, order: float(np.abs(feedback[0]) + 1e-300) ** (-1.0 / order),  # 0: it never fades
        unit="s",
        positive=True,
        doc="time constant of bumpless",
    )
    u_start = Parameter(0.0, unit=unit_u, doc="control before the first tick")
    alpha = Parameter(_denominator, shape=each_estimate, doc="denominator of the filter, without the leading 1")
    beta = Parameter(_of_y, shape=each_estimate, doc="numerator of the filter from y(k)")
    gamma = Parameter(_of_u, shape=each_estimate, doc="numerator of the filter from u(k-1)")
    r = Input(0.0, shape=each_error, ports="r{}", unit=error_units, doc="wanted output and its derivatives")
    y = Input(unit=unit, doc="measured output of the plant")
    manual = Input(0.0, doc="above 0: u is u_manual")
    u_manual = Input(0.0, unit=unit_u, doc="control by hand")
    x = Discrete(shape=each_estimate, doc="estimates for the next tick, as predicted; or the memory of the filter")
    last = Discrete(unit=unit_u, doc="u of the last tick")
    added = Discrete(unit=unit_u, doc="what is added to the law for the sake of no bump")
    acted = Discrete(type="bool", doc="whether the law acted at the last tick")

    @requires("b0 must not be 0")
    def has_b0(b0):
        return b0 != 0

    @requires("lower must be below upper")
    def is_ordered(lower, upper):
        return lower < upper

    @local(doc="estimates, or w")
    def z(x, y, observer, beta, form):
        return x[0] + beta[0] * y if form == "transfer_function" else x + observer * (y - x[0])

    @local(unit=unit_u, doc="control of the law")
    def law(r, z, feedback, b0, order, form):
        if form == "transfer_function":
            return (feedback @ r - z) / b0
        return (feedback @ (r - z[:order]) - z[order]) / b0

    @local(unit=unit_u, doc="what is added to the law")
    def shift(law, last, added, acted, manual, bumpless):
        if not bumpless:
            return 0.0 * law
        return np.where((manual > 0.0) | acted, added, last - law)

    @local(unit=unit_u, doc="control before its limits")
    def v(law, shift):
        return law + shift

    @output(unit=unit_u, every=Ticks.period, offset=Ticks.offset, start=u_start, doc="control")
    def u(v, manual, u_manual, last, rate, period, lower, upper):
        near = np.clip(np.where(manual > 0.0, u_manual, v), last - rate * period, last + rate * period)
        return np.clip(near, lower, upper)

    @output(unit=unit_u, every=Ticks.period, offset=Ticks.offset, doc="change of u at the tick")
    def du(u, last):
        return u - last

    @x.next(every=Ticks.period, offset=Ticks.offset)
    def predict(x, y, z, u, alpha, beta, gamma, b0, period, order, form):
        if form == "transfer_function":
            later = np.concatenate([x[1:], np.zeros(1)])
            return later + np.concatenate([beta[1:], np.zeros(1)]) * y + gamma * u - alpha * z
        return after_period(period, z, u, b0, order, form)

    @last.initial
    def start(u_start):
        return u_start

    @last.next(every=Ticks.period, offset=Ticks.offset)
    def keep(u):
        return u

    @added.next(every=Ticks.period, offset=Ticks.offset)
    def fade(shift, period, transfer):
        return shift * np.exp(-period / transfer)

    @acted.next(every=Ticks.period, offset=Ticks.offset)
    def act(manual):
        return manual <= 0.0
