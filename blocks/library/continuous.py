"""Linear systems in continuous time, and integrators that stop or jump."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, local, output, requires
from ..contract.variables import UNLIMITED, Discrete, Input, Parameter, State
from ..text import units

__all__ = [
    "Derivative",
    "FirstOrder",
    "Integrator",
    "LeadLag",
    "LimitedIntegrator",
    "ResettableIntegrator",
    "SecondOrder",
    "StateSpace",
    "TransferFunction",
    "ZeroPoleGain",
]


def _gain_unit(unit, unit_u):
    """The unit of a gain that comes before the units in the class body, so that no expression can name them yet."""
    return units.quotient(unit, unit_u)


class Integrator(Block):
    """dy/dt = u, from y_start on."""

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    u = Input(unit=unit / "s", doc="input")
    y = State(unit=unit, output=True, doc="integral of the input")

    @y.derivative
    def dy(u):
        return u


class ResettableIntegrator(Block):
    """dy/dt = u, from y_start on; y becomes y0 at each instant at which the trigger fires.

    The trigger is on while it is above the threshold, so a pulse between 0 and 1 works with the default. direction:
    "up" fires when the trigger goes on, "down" when it goes off, "both" at either. These instants are located. A
    trigger that is on at the start does not fire. y0 is read when the reset happens; unwired, it is 0.
    """

    direction = Parameter("up", structural=True, choices=("up", "down", "both"), doc="edges that reset y")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    threshold = Parameter(0.0, doc="value above which the trigger is on")
    u = Input(unit=unit / "s", doc="input")
    trigger = Input(doc="signal whose edges reset y")
    y0 = Input(0.0, unit=unit, doc="value that y is reset to")
    y = State(unit=unit, output=True, doc="integral of the input since the last reset")

    @y.derivative
    def dy(u):
        return u

    # The side of both is that the trigger is off: a value at the threshold is off. An edge that does not count has
    # a side that never changes.
    @crossing(direction="down")
    def rise(trigger, threshold, direction):
        return -1.0 if direction == "down" else threshold - trigger

    @crossing(direction="up")
    def fall(trigger, threshold, direction):
        return -1.0 if direction == "up" else threshold - trigger

    @rise.reset(y)
    @fall.reset(y)
    def restart(y0):
        return y0


class LimitedIntegrator(Block):
    """dy/dt = u within lower ... upper, else 0: y stops at a limit, and leaves it as soon as u points inwards.

    y does not wind up at a limit. The instants at which y reaches a limit, and the instants at which u turns back, are
    located, so y stops exactly at the limit. If a limit that is set during a run is beyond y, y moves to the limit.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    lower = Parameter(-UNLIMITED, unit=unit, is_limit=True, doc="smallest y")
    upper = Parameter(UNLIMITED, unit=unit, is_limit=True, doc="largest y")
    y_start = Parameter(0.0, unit=unit, doc="y at the start, or the limit that it is beyond")
    u = Input(unit=unit / "s", doc="input")
    y = State(unit=unit, output=True, doc="limited integral of the input")
    at_lower = Discrete(type="bool", doc="whether y rests at the lower limit")
    at_upper = Discrete(type="bool", doc="whether y rests at the upper limit")

    @requires("lower must be below upper")
    def is_ordered(lower, upper):
        return lower < upper

    @y.initial
    def begins(y_start, lower, upper):
        return np.clip(y_start, lower, upper)

    @y.derivative
    def dy(u, at_lower, at_upper):
        return np.where(at_lower | at_upper, 0.0, u)

    # A y at its limit is within: it can leave inwards without another instant.
    @crossing(direction="down")
    def below(y, lower):
        return y - lower

    @crossing(direction="down")
    def above(y, upper):
        return upper - y

    @crossing(direction="up")
    def turn(u, y, lower, upper, at_lower, at_upper):
        """Where y rests: u points inwards, or the limit was moved away."""
        from_lower, from_upper = np.where(y > lower, 1.0, u), np.where(y < upper, 1.0, -u)
        return np.where(at_lower, from_lower, np.where(at_upper, from_upper, -1.0))

    @below.reset(y)
    @above.reset(y)
    def stop(y, lower, upper):
        return np.clip(y, lower, upper)

    @at_lower.initial
    @below.reset(at_lower)
    @turn.reset(at_lower)
    def rests_below(y, u, lower):
        return (y <= lower) & (u < 0.0)

    @at_upper.initial
    @above.reset(at_upper)
    @turn.reset(at_upper)
    def rests_above(y, u, upper):
        return (y >= upper) & (u > 0.0)


class Derivative(Block):
    """y = s/(Tf s + 1) u: the derivative of u, smoothed over Tf.

        d smoothed/dt = y,   y = (u - smoothed)/Tf

    smoothed begins at u, so that y begins at 0. A jump of u by 1 makes y jump by 1/Tf.
    """

    Tf = Parameter(0.01, unit="s", positive=True, doc="time constant of the filter")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    u = Input(unit=unit * "s", doc="input")
    smoothed = State(unit=unit * "s", doc="filtered input")

    @smoothed.initial
    def start(u):
        return u

    @output(unit=unit, doc="filtered derivative of the input")
    def y(u, smoothed, Tf):
        return (u - smoothed) / Tf

    @smoothed.derivative
    def dsmoothed(y):
        return y


class FirstOrder(Block):
    """T dy/dt = k u - y: y = k/(T s + 1) u, from y_start on."""

    k = Parameter(1.0, unit=_gain_unit, doc="gain at rest")
    T = Parameter(1.0, unit="s", positive=True, doc="time constant")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    u = Input(unit=unit_u, doc="input")
    y = State(unit=unit, output=True, doc="output")

    @y.derivative
    def dy(y, u, k, T):
        return (k * u - y) / T


class SecondOrder(Block):
    """d2y/dt2 + 2 d w dy/dt + w^2 y = k w^2 u: y = k w^2/(s^2 + 2 d w s + w^2) u, from y_start and v_start on.

    It oscillates if d < 1: with d = 0 forever, with d < 0 ever more.
    """

    k = Parameter(1.0, unit=_gain_unit, doc="gain at rest")
    d = Parameter(1.0, doc="damping ratio")
    w = Parameter(1.0, unit="rad/s", positive=True, doc="natural frequency, without damping")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    u = Input(unit=unit_u, doc="input")
    y = State(unit=unit, output=True, doc="output")
    v = State(unit=unit / "s", doc="derivative of the output")

    @y.derivative
    def dy(v):
        return v

    @v.derivative
    def dv(y, v, u, k, d, w):
        return w**2 * (k * u - y) - 2.0 * d * w * v


def _lag_size(k, T1, T2):
    """How large the state is where u or y is about 1; 1 at most."""
    with np.errstate(all="ignore"):
        return 1.0 / np.clip(np.nan_to_num(np.abs(k * (1.0 - T1 / T2))), 1.0, 1e150)


class LeadLag(Block):
    """y = k (T1 s + 1)/(T2 s + 1) u: a lead if T1 > T2, a lag if T1 < T2.

        T2 dx/dt = u - x,   y = k (x + T1/T2 (u - x))

    y depends on u at the same instant, by k T1/T2, unless T1 is 0; a T1 of 0 stays 0 during a run. The state begins at
    x_start, which is 0.
    """

    k = Parameter(1.0, unit=_gain_unit, doc="gain at rest")
    T1 = Parameter(1.0, unit="s", min=0.0, zeros=True, doc="time constant of the numerator")
    T2 = Parameter(0.1, unit="s", positive=True, doc="time constant of the denominator")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    u = Input(unit=unit_u, doc="input")
    x = State(unit=unit_u, nominal=_lag_size, doc="input filtered by the denominator")

    @x.derivative
    def dx(x, u, T2):
        return (u - x) / T2

    @output(unit=unit, doc="filtered input")
    def y(x, u, k, T1, T2):
        return k * (x + T1 / T2 * (u - x))


def _canonical_sizes(num, den, m, k):
    """How large the states in canonical form are, one by one, where u or y is about 1; 1 at most.

    The coefficient of s^i of the denominator, a, or of the output row, c, times its state is about u or y where that
    power leads. Where the powers around it lead at every frequency, the state is as small as they make it: the
    largest of |a|, |c| and 1 becomes the least concave curve above it, in logarithms over i, the Newton polygon.
    """
    with np.errstate(all="ignore"):
        a, b = den / den[0], np.concatenate([np.zeros(k - m), num]) / den[0]
        c = np.concatenate([[0.0], b[1:] - a[1:] * b[0]])
        # Beyond these ends atol times the size would leave the range of numbers.
        heights = np.log(np.clip(np.fmax(np.abs(a), np.abs(c)), 1.0, 1e150))[::-1]
    corners = []
    for i in range(k):
        while len(corners) > 1:
            first, middle = corners[-2:]
            if (heights[middle] - heights[first]) * (i - first) > (heights[i] - heights[first]) * (middle - first):
                break
            corners.pop()
        corners.append(i)
    return np.exp(-np.interp(np.arange(k - 1), corners, heights[corners]))


class TransferFunction(Block):
    """y = num(s)/den(s) u, coefficients from the highest power down: num [1], den [1, 0.2, 1] is 1/(s^2 + 0.2 s + 1).

    Any order with deg(num) <= deg(den), in controllable canonical form, with a = den/den[0] and b = num/den[0]:

        dx1/dt = x2, ..., dxn/dt = u - a_n x1 - ... - a_1 xn
        y = (b_n - a_n b_0) x1 + ... + (b_1 - a_1 b_0) xn + b_0 u

    y depends on u at the same instant only if num and den have the same degree. Zeros of num fix the type: a zero
    coefficient stays zero during a run. The state begins at x_start, which is 0.

    The states of a fast plant are small: x1 is u/a_n at rest. Their nominal follows from num and den: it is their size
    when u or y is about 1, but at most 1. So atol weighs the same for a fast plant as for a slow plant.

    References: T. Kailath, Linear Systems, Prentice-Hall 1980, section 2.1.
    """

    num = Parameter([1.0], shape="m", zeros=True, doc="coefficients of the numerator, highest power first")
    den = Parameter([1.0, 1.0], shape="k", doc="coefficients of the denominator, highest power first")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    inputs = Parameter("", structural=True, type="string", doc='name of the input; "": u')
    outputs = Parameter("", structural=True, type="string", doc='name of the output; "": y')
    u = Input(unit=unit_u, ports=inputs, doc="input")
    x = State(shape=lambda k: k - 1, nominal=_canonical_sizes, doc="state in controllable canonical form")

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

    @output(unit=unit, ports=outputs, doc="filtered input")
    def y(x, u, num, den, m, k):
        b = np.concatenate([np.zeros(k - m), num]) / den[0]
        c = b[1:] - den[1:] / den[0] * b[0]
        return c[::-1] @ x + b[0] * u


def _stand_in_pairs(real, imag):
    """Whether the complex ones are neighbors a + bj, a - bj with b > 0."""
    roots = iter(zip(real, imag, strict=True))
    return all(b == 0.0 or (b > 0.0 and next(roots, None) == (a, -b)) for a, b in roots)


def _speeds(poles, poles_imag):
    """How far each pole is from 0, but 1 at least."""
    # A section with the gain 1 at rest would stay near 0 for a run that is short to a slow pole.
    return np.maximum(np.sqrt(poles**2 + poles_imag**2), 1.0)


def _chain(poles, poles_imag):
    """The matrix of the chain of sections."""
    w = _speeds(poles, poles_imag)
    back = np.where(poles_imag > 0.0, poles_imag**2 / w, 0.0)
    return np.diag(poles) + np.diag(w[1:], -1) - np.diag(back[:-1], 1)


def _driven(poles, poles_imag, n):
    """What u drives: the first section."""
    return _speeds(poles, poles_imag) * np.eye(1, n)[0]


def _behind_chain(A, B, zeros, zeros_imag, poles, poles_imag, k, m, n):
    """The factor of the output, and what it multiplies: the row of the states, and u directly."""
    w = _speeds(poles, poles_imag)
    # The last section gives w_1 ... w_n/((s - p_1) ... (s - p_n)) u: each factor takes one w off. The row is
    # c + dj, and d is 0 again after each pair of zeros. Without sections, u passes at once.
    c, d, direct = np.eye(1, n, n - 1)[0], np.zeros(n), float(n == 0)
    for i in range(m):
        direct = c @ B / w[i]
        c, d = (
            (c @ A - zeros[i] * c + zeros_imag[i] * d) / w[i],
            (d @ A - zeros[i] * d - zeros_imag[i] * c) / w[i],
        )
    return k / np.prod(w[m:]), c, direct


def _section_sizes(zeros, zeros_imag, poles, poles_imag, k, m, n):
    """How large the sections are, one by one, where u or y is about 1; 1 at most."""
    with np.errstate(all="ignore"):
        A, B = _chain(poles, poles_imag), _driven(poles, poles_imag, n)
        factor, row, _ = _behind_chain(A, B, zeros, zeros_imag, poles, poles_imag, k, m, n)
        # A section reaches y by those behind it too, each of about the gain 1.
        reach = np.maximum.accumulate(np.nan_to_num(np.abs(factor * row))[::-1])[::-1]
        return 1.0 / np.clip(reach, 1.0, 1e150)


class ZeroPoleGain(Block):
    """y = k (s - z_1) ... (s - z_m)/((s - p_1) ... (s - p_n)) u, with m <= n.

    `zeros` and `poles` hold real parts, zeros_imag and poles_imag imaginary parts, which default to 0. Complex values
    come in pairs of neighbors, first the value above the real axis: poles [-1, -1, -3] with poles_imag [2, -2, 0] are
    -1 + 2j, -1 - 2j and -3.

    The poles form a chain of sections in the order given. u drives the first, and each section drives the next:

        dx_i/dt = p x_i + w x_{i-1}                         of a real pole p
        dx_i/dt = a x_i + w x_{i-1} - b^2/w x_{i+1}         of a pair a +- bj
        dx_{i+1}/dt = a x_{i+1} + w x_i

    With w = |p|, or 1/s if that is more, fast sections have the gain 1 at rest, so their states are about as large as
    u. In a TransferFunction the states shrink with the product of the poles. The output is a row c of the states: a
    factor s - z turns c into c A - z c, and adds c B of u. If entries of the row from a section on are above 1, the
    nominal of its state is 1 over the largest of them. So atol weighs the same for a high gain as for a low gain.

    y depends on u at the same instant only if m = n. An imaginary part of 0 stays 0 during a run. The state begins at
    x_start, which is 0.
    """

    zeros = Parameter([], shape="m", unit="1/s", doc="real parts of the zeros")
    zeros_imag = Parameter(lambda m: np.zeros(m), shape="m", unit="1/s", zeros=True, doc="imaginary parts of the zeros")
    poles = Parameter([-1.0], shape="n", unit="1/s", doc="real parts of the poles")
    poles_imag = Parameter(lambda n: np.zeros(n), shape="n", unit="1/s", zeros=True, doc="imaginary parts of the poles")
    k = Parameter(1.0, doc="gain: the factor before the highest power of s in the numerator")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    inputs = Parameter("", structural=True, type="string", doc='name of the input; "": u')
    outputs = Parameter("", structural=True, type="string", doc='name of the output; "": y')
    u = Input(unit=unit_u, ports=inputs, doc="input")
    x = State(shape=lambda n: n, nominal=_section_sizes, doc="output of each section")

    @requires("there must not be more zeros than poles: the transfer function would not be proper")
    def is_proper(m, n):
        return m <= n

    @requires("complex zeros must stand in pairs of neighbors a + bj, a - bj with b above 0")
    def has_pairs_of_zeros(zeros, zeros_imag):
        return _stand_in_pairs(zeros, zeros_imag)

    @requires("complex poles must stand in pairs of neighbors a + bj, a - bj with b above 0")
    def has_pairs_of_poles(poles, poles_imag):
        return _stand_in_pairs(poles, poles_imag)

    @local(doc="matrix of the chain")
    def A(poles, poles_imag):
        return _chain(poles, poles_imag)

    @local(doc="effect of u on the first section")
    def B(poles, poles_imag, n):
        return _driven(poles, poles_imag, n)

    @x.derivative
    def dx(x, u, A, B):
        return A @ x + B * u

    @output(unit=unit, ports=outputs, doc="filtered input")
    def y(x, u, A, B, zeros, zeros_imag, poles, poles_imag, k, m, n):
        factor, row, direct = _behind_chain(A, B, zeros, zeros_imag, poles, poles_imag, k, m, n)
        return factor * (row @ x + direct * u)


class StateSpace(Block):
    """dx/dt = A x + B u, y = C x + D u.

    A is n x n, B n x m, C p x n, D p x m (default: 0); u, x and y are vectors, whose elements wires name u[0], y[0].
    Named inputs and outputs are ports of their own, one for each name.
    Zeros of the matrices fix the type: an element of y depends directly only on the u for which its row of D is not 0.
    """

    A = Parameter([[-1.0]], shape=("n", "n"), zeros=True, doc="from state to its derivative")
    B = Parameter([[1.0]], shape=("n", "m"), zeros=True, doc="from input to the state's derivative")
    C = Parameter([[1.0]], shape=("p", "n"), zeros=True, doc="from state to output")
    D = Parameter(lambda p, m: np.zeros((p, m)), shape=("p", "m"), zeros=True, doc="from input to output")
    inputs = Parameter("", structural=True, type="string", doc='names of the inputs, "F, d"; "": one vector u')
    outputs = Parameter("", structural=True, type="string", doc='names of the outputs, "p, v"; "": one vector y')
    u = Input(shape=lambda m: m, ports=inputs, doc="inputs")
    x = State(shape=lambda n: n, output=True, doc="states")

    @x.derivative
    def dx(x, u, A, B):
        return A @ x + B @ u

    @output(shape=lambda p: p, ports=outputs, doc="outputs")
    def y(x, u, C, D):
        return C @ x + D @ u
