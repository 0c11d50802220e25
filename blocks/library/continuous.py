"""Linear systems in continuous time, and the PID controller."""

import numpy as np

from .. import units
from ..declare import Block, Input, Parameter, State, crossing, local, output, requires

__all__ = ["PID", "Integrator", "StateSpace", "TransferFunction"]

# Far beyond every signal, and its square is still a finite number.
UNLIMITED = 1e100


class Integrator(Block):
    """dy/dt = u, from y_start on."""

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    u = Input(unit=lambda unit: units.quotient(unit, "s"), doc="input")
    y = State(unit=lambda unit: unit, output=True, doc="integral of the input")

    @y.derivative
    def dy(u):
        return u


class TransferFunction(Block):
    """y = num(s)/den(s) u, coefficients from the highest power down: num [1], den [1, 0.2, 1] is 1/(s^2 + 0.2 s + 1).

    Any order with deg(num) <= deg(den), in controllable canonical form, with a = den/den[0] and b = num/den[0]:

        dx1/dt = x2, ..., dxn/dt = u - a_n x1 - ... - a_1 xn
        y = (b_n - a_n b_0) x1 + ... + (b_1 - a_1 b_0) xn + b_0 u

    y depends on u at once only where num and den have one degree. Zeros of num fix the type: a zero coefficient
    stays zero during a run. The state begins at x_start, which is 0.

    References: T. Kailath, Linear Systems, Prentice-Hall 1980, section 2.1.
    """

    num = Parameter([1.0], shape="m", zeros=True, doc="coefficients of the numerator, highest power first")
    den = Parameter([1.0, 1.0], shape="k", doc="coefficients of the denominator, highest power first")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    u = Input(unit=lambda unit_u: unit_u, doc="input")
    x = State(shape=lambda k: k - 1, doc="state in controllable canonical form")

    @requires("num and den must not be empty")
    def is_given(m, k):
        return m > 0 and k > 0

    @requires("num must not have more coefficients than den: the transfer function would not be proper")
    def is_proper(m, k):
        return m <= k

    @requires("the first coefficient of den must not be 0")
    def has_degree(den, k):
        return k == 0 or den[0] != 0

    @x.derivative
    def dx(x, u, den, k):
        highest = u - (den[1:] / den[0])[::-1] @ x
        return np.concatenate([x[1:], [highest]])[: k - 1]

    @output(unit=lambda unit: unit, doc="filtered input")
    def y(x, u, num, den, m, k):
        b = np.concatenate([np.zeros(k - m), num]) / den[0]
        c = b[1:] - den[1:] / den[0] * b[0]
        return c[::-1] @ x + b[0] * u


class StateSpace(Block):
    """dx/dt = A x + B u, y = C x + D u.

    A is n x n, B n x m, C p x n, D p x m (left out: 0); u, x and y are vectors, whose elements wires name u[0], y[0].
    Zeros of the matrices fix the type: an element of y depends at once only on the elements of u that D has for it.
    """

    A = Parameter([[-1.0]], shape=("n", "n"), zeros=True, doc="from state to its derivative")
    B = Parameter([[1.0]], shape=("n", "m"), zeros=True, doc="from input to the state's derivative")
    C = Parameter([[1.0]], shape=("p", "n"), zeros=True, doc="from state to output")
    D = Parameter(lambda p, m: np.zeros((p, m)), shape=("p", "m"), zeros=True, doc="from input to output")
    u = Input(shape=lambda m: m, doc="inputs")
    x = State(shape=lambda n: n, output=True, doc="states")

    @x.derivative
    def dx(x, u, A, B):
        return A @ x + B @ u

    @output(shape=lambda p: p, doc="outputs")
    def y(x, u, C, D):
        return C @ x + D @ u


def _tracking_time(kp, ki):
    """kp/ki, the integral time, where that is a time."""
    return kp / ki if kp * ki > 0 else 1.0


def _filter_time(kp, kd):
    """A tenth of the derivative time kd/kp."""
    if kd == 0:
        return 1.0  # nothing is filtered; a slow pole costs no solver steps
    if kp * kd < 0 or kp == 0:
        raise ValueError("kd/kp/10 is not a time; give Tf")
    return kd / kp / 10


class PID(Block):
    """y = sat(kp u + ki integral of u + kd s/(Tf s + 1) u), with anti-windup by back-calculation.

        v = kp u + integral + kd (u - smoothed)/Tf,   y = v within lower ... upper, else the limit
        d integral/dt = ki u + (y - v)/Tt             0 where ki = 0
        d smoothed/dt = (u - smoothed)/Tf

    u is the control error. Without given limits y is unlimited. Tf defaults to kd/kp/10 and Tt to the integral time
    kp/ki (1 s where that is not a time). A jump of u passes through kd/Tf.

    References: K. J. Åström, T. Hägglund, Advanced PID Control, ISA 2006, section 3.5.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    kp = Parameter(1.0, unit=lambda unit, unit_u: units.quotient(unit, unit_u), doc="proportional gain")
    ki = Parameter(
        0.0,
        unit=lambda unit, unit_u: units.quotient(units.quotient(unit, unit_u), "s"),
        doc="integral gain",
    )
    kd = Parameter(
        0.0,
        unit=lambda unit, unit_u: units.product(units.quotient(unit, unit_u), "s"),
        doc="derivative gain",
    )
    Tf = Parameter(_filter_time, unit="s", positive=True, doc="time constant of the derivative's filter")
    Tt = Parameter(_tracking_time, unit="s", positive=True, doc="tracking time of the anti-windup")
    lower = Parameter(-UNLIMITED, unit=lambda unit: unit, doc="smallest y")
    upper = Parameter(UNLIMITED, unit=lambda unit: unit, doc="largest y")
    u = Input(unit=lambda unit_u: unit_u, doc="control error")
    integral = State(unit=lambda unit: unit, doc="integral part of y")
    smoothed = State(unit=lambda unit_u: unit_u, doc="filtered input, from which the derivative is taken")

    @requires("lower must be below upper")
    def is_ordered(lower, upper):
        return lower < upper

    @local(unit=lambda unit: unit, doc="output before its limits")
    def v(u, integral, smoothed, kp, kd, Tf):
        return kp * u + integral + kd * (u - smoothed) / Tf

    @crossing
    def above(v, upper):
        return v - upper

    @crossing
    def below(v, lower):
        return lower - v

    @output(unit=lambda unit: unit, doc="control")
    def y(v, above, below, lower, upper):
        return np.where(above, upper, np.where(below, lower, v))

    @integral.derivative
    def dintegral(u, v, y, ki, Tt):
        # Without an integral part, back-calculation would make one.
        return np.where(ki == 0.0, 0.0, ki * u + (y - v) / Tt)

    @smoothed.derivative
    def dsmoothed(u, smoothed, Tf):
        return (u - smoothed) / Tf
