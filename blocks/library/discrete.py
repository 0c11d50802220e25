"""Linear systems in discrete time, and the sampled PID controller.

All act at ticks: at offset + k period, for k = 0, 1, 2 ..., counted from t = 0. An equation of a tick sees the states
from before it.
"""

import numpy as np

from .. import units
from ..declare import Block, Discrete, Input, Parameter, output, requires
from .continuous import UNLIMITED, filter_time, tracking_time

__all__ = ["DiscreteIntegrator", "DiscretePID", "DiscreteStateSpace", "DiscreteTransferFunction"]

_PRESENT = {"forward": 0.0, "backward": 1.0, "trapezoidal": 0.5}
"""The weight a of u at the tick itself, by the form of an integrator."""


class DiscreteIntegrator(Block):
    """y[k] = y[k-1] + period ((1 - a) u[k-1] + a u[k]), from y[0] = y_start on: the integral of u as a sum.

    form: "forward" (a = 0: period/(z - 1), without feedthrough), "backward" (a = 1: period z/(z - 1)) or "trapezoidal"
    (a = 1/2: period/2 (z + 1)/(z - 1)). y stays within lower ... upper, and nothing winds up behind a limit. y_start
    is also y before the first tick.
    """

    form = Parameter("forward", structural=True, choices=("forward", "backward", "trapezoidal"), doc="rule of the sum")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    y_start = Parameter(0.0, unit=lambda unit: unit, doc="y up to the first tick, and at it")
    lower = Parameter(-UNLIMITED, unit=lambda unit: unit, doc="smallest y")
    upper = Parameter(UNLIMITED, unit=lambda unit: unit, doc="largest y")
    u = Input(unit=lambda unit: units.quotient(unit, "s"), doc="input")
    x = Discrete(unit=lambda unit: unit, doc="y at the last tick and what its u adds to the next")
    begun = Discrete(type="bool", doc="whether there was a tick")

    @requires("lower must be below upper")
    def is_ordered(lower, upper):
        return lower < upper

    @requires("y_start must lie within lower ... upper")
    def is_within(y_start, lower, upper):
        return (lower <= y_start) & (y_start <= upper)

    @x.initial
    def start(y_start):
        return y_start

    @output(unit=lambda unit: unit, every=period, offset=offset, start=y_start, doc="integral of the input")
    def y(x, u, begun, period, lower, upper, form):
        now = _PRESENT[form] * period * u
        return np.clip(x + np.where(begun, now, 0.0), lower, upper)

    @x.next(every=period, offset=offset)
    def add(y, u, period, form):
        return y + (1.0 - _PRESENT[form]) * period * u

    @begun.next(every=period, offset=offset)
    def begin():
        return np.True_


class DiscreteTransferFunction(Block):
    """y = num(z)/den(z) u, coefficients from the highest power of z down: num [1], den [1, -0.5] is 1/(z - 0.5).

    Any order with deg(num) <= deg(den), in controllable canonical form, with a = den/den[0] and b = num/den[0]:

        x1[k+1] = x2[k], ..., xn[k+1] = u[k] - a_n x1[k] - ... - a_1 xn[k]
        y[k] = (b_n - a_n b_0) x1[k] + ... + (b_1 - a_1 b_0) xn[k] + b_0 u[k]

    The coefficients are those of scipy.signal.dlti and control.tf; scipy.signal.lfilter counts powers of 1/z, which is
    the same where num and den are of equal length. y[k] depends on u[k] only where num and den have one degree. Zeros
    of num fix the type: a zero coefficient stays zero during a run. The state begins at x_start, which is 0.

    References: T. Kailath, Linear Systems, Prentice-Hall 1980, section 2.3.
    """

    num = Parameter([1.0], shape="m", zeros=True, doc="coefficients of the numerator, highest power first")
    den = Parameter([1.0, 0.0], shape="k", doc="coefficients of the denominator, highest power first")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    y_start = Parameter(0.0, unit=lambda unit: unit, doc="y before the first tick")
    u = Input(unit=lambda unit_u: unit_u, doc="input")
    x = Discrete(shape=lambda k: k - 1, doc="state in controllable canonical form")

    @requires("num and den must not be empty")
    def is_given(m, k):
        return m > 0 and k > 0

    @requires("num must not have more coefficients than den: y would depend on u at later ticks")
    def is_causal(m, k):
        return m <= k

    @requires("the first coefficient of den must not be 0")
    def has_degree(den, k):
        return k == 0 or den[0] != 0

    @x.next(every=period, offset=offset)
    def step(x, u, den, k):
        highest = u - (den[1:] / den[0])[::-1] @ x
        return np.concatenate([x[1:], [highest]])[: k - 1]

    @output(unit=lambda unit: unit, every=period, offset=offset, start=y_start, doc="filtered input")
    def y(x, u, num, den, m, k):
        b = np.concatenate([np.zeros(k - m), num]) / den[0]
        c = b[1:] - den[1:] / den[0] * b[0]
        return c[::-1] @ x + b[0] * u


class DiscreteStateSpace(Block):
    """x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k].

    A is n x n, B n x m, C p x n, D p x m (left out: 0); u, x and y are vectors, whose elements wires name u[0], y[0].
    Zeros of the matrices fix the type: an element of y[k] depends only on the elements of u[k] that D has for it.
    """

    A = Parameter([[0.0]], shape=("n", "n"), zeros=True, doc="from state to the next one")
    B = Parameter([[1.0]], shape=("n", "m"), zeros=True, doc="from input to the next state")
    C = Parameter([[1.0]], shape=("p", "n"), zeros=True, doc="from state to output")
    D = Parameter(lambda p, m: np.zeros((p, m)), shape=("p", "m"), zeros=True, doc="from input to output")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    y_start = Parameter(0.0, shape="p", doc="y before the first tick")
    u = Input(shape=lambda m: m, doc="inputs")
    x = Discrete(shape=lambda n: n, doc="states")

    @x.next(every=period, offset=offset)
    def step(x, u, A, B):
        return A @ x + B @ u

    @output(shape=lambda p: p, every=period, offset=offset, start=y_start, doc="outputs")
    def y(x, u, C, D):
        return C @ x + D @ u


def _pull(kp, ki, period):
    """The integral time, and a period at least: more than all that a limit cuts off is never taken back."""
    return max(tracking_time(kp, ki), period)


def _slope(old, new, last, begun, kd, Tf, period):
    """The derivative part by backward differences, of which the first is taken as 0."""
    return (Tf * old + kd * np.where(begun, new - last, 0.0)) / (Tf + period)


def _unlimited(r, y, integral, slope, last, begun, kp, kd, b, c, Tf, period):
    """The control before its limits."""
    return kp * (b * r - y) + integral + _slope(slope, c * r - y, last, begun, kd, Tf, period)


class DiscretePID(Block):
    """u = sat(kp (b r - y) + integral + kd s/(Tf s + 1) (c r - y)) at ticks: r is wanted, y is measured.

        v[k] = kp (b r[k] - y[k]) + integral[k] + slope[k],   u[k] = v[k] within lower ... upper, else the limit
        integral[k+1] = integral[k] + ki period (r[k] - y[k]) + period/Tt (u[k] - v[k])
        slope[k] = (Tf slope[k-1] + kd (w[k] - w[k-1]))/(Tf + period),   w = c r - y

    The integral is by forward differences, with anti-windup by back-calculation; the filtered derivative is by backward
    differences, which are stable for every Tf from 0 on. b and c weigh r: with c = 0 the derivative is that of the
    measurement alone, so that a step of r gives no kick; with b = c = 1 all acts on the error, as in PID.

    Tf defaults to kd/kp/10 and Tt to the integral time kp/ki (1 s where that is not a time), but not below the
    period. Without given limits u is unlimited.

    While `manual` is above 0, u is u_manual within the limits, and the integral follows, so that the controller goes
    on from there without a bump. The integral has its gain in it: a change of ki does not make u jump. The first slope
    is 0, whatever y is then. With ki = 0 the integral stays at u_start: nothing would ever take back what it followed.

    References: K. J. Åström, B. Wittenmark, Computer-Controlled Systems, 3rd edition, Prentice-Hall 1997, section 8.5.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of r and y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    kp = Parameter(1.0, unit=lambda unit, unit_u: units.quotient(unit_u, unit), doc="proportional gain")
    ki = Parameter(
        0.0,
        unit=lambda unit, unit_u: units.quotient(units.quotient(unit_u, unit), "s"),
        doc="integral gain",
    )
    kd = Parameter(
        0.0,
        unit=lambda unit, unit_u: units.product(units.quotient(unit_u, unit), "s"),
        doc="derivative gain",
    )
    b = Parameter(1.0, doc="weight of r in the proportional part")
    c = Parameter(0.0, doc="weight of r in the derivative part")
    Tf = Parameter(filter_time, unit="s", min=0.0, doc="time constant of the derivative's filter")
    Tt = Parameter(_pull, unit="s", positive=True, doc="tracking time of the anti-windup")
    lower = Parameter(-UNLIMITED, unit=lambda unit_u: unit_u, doc="smallest u")
    upper = Parameter(UNLIMITED, unit=lambda unit_u: unit_u, doc="largest u")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    u_start = Parameter(0.0, unit=lambda unit_u: unit_u, doc="integral part at the first tick, and u before it")
    r = Input(unit=lambda unit: unit, doc="wanted value")
    y = Input(unit=lambda unit: unit, doc="measured value")
    manual = Input(0.0, doc="above 0: u is u_manual")
    u_manual = Input(0.0, unit=lambda unit_u: unit_u, doc="control by hand")
    integral = Discrete(unit=lambda unit_u: unit_u, doc="integral part of u")
    slope = Discrete(unit=lambda unit_u: unit_u, doc="derivative part of u at the last tick")
    last = Discrete(unit=lambda unit: unit, doc="c r - y at the last tick")
    begun = Discrete(type="bool", doc="whether there was a tick")

    @requires("lower must be below upper")
    def is_ordered(lower, upper):
        return lower < upper

    @requires("Tt must not be below the period")
    def is_tracking(Tt, period):
        return Tt >= period

    @output(unit=lambda unit_u: unit_u, every=period, offset=offset, start=u_start, doc="control")
    def u(r, y, manual, u_manual, integral, slope, last, begun, kp, kd, b, c, Tf, period, lower, upper):
        v = _unlimited(r, y, integral, slope, last, begun, kp, kd, b, c, Tf, period)
        return np.clip(np.where(manual > 0.0, u_manual, v), lower, upper)

    @integral.initial
    def bias(u_start):
        return u_start

    @integral.next(every=period, offset=offset)
    def integrate(u, r, y, manual, integral, slope, last, begun, kp, ki, kd, b, c, Tf, Tt, period):
        v = _unlimited(r, y, integral, slope, last, begun, kp, kd, b, c, Tf, period)
        added = np.where(manual > 0.0, u - v, ki * period * (r - y) + period / Tt * (u - v))
        return integral + np.where(ki == 0.0, 0.0, added)

    @slope.next(every=period, offset=offset)
    def differentiate(r, y, slope, last, begun, kd, c, Tf, period):
        return _slope(slope, c * r - y, last, begun, kd, Tf, period)

    @last.next(every=period, offset=offset)
    def remember(r, y, c):
        return c * r - y

    @begun.next(every=period, offset=offset)
    def begin():
        return np.True_
