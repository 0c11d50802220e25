"""Linear systems in discrete time.

All act at ticks: at offset + k period, for k = 0, 1, 2 ..., counted from t = 0. An equation of a tick sees the states
from before it.
"""

import numpy as np

from ..contract.block import Block
from ..contract.equations import output, requires
from ..contract.variables import UNLIMITED, Discrete, Input, Parameter

__all__ = ["DiscreteIntegrator", "DiscreteStateSpace", "DiscreteTransferFunction"]

_PRESENT = {"forward": 0.0, "backward": 1.0, "trapezoidal": 0.5}
"""The weight a of u at the tick itself, by the form of an integrator."""


class DiscreteIntegrator(Block):
    """y[k] = y[k-1] + period ((1 - a) u[k-1] + a u[k]), from y[0] = y_start on: the integral of u as a sum.

    form: "forward" (a = 0: period/(z - 1), without feedthrough), "backward" (a = 1: period z/(z - 1)) or "trapezoidal"
    (a = 1/2: period/2 (z + 1)/(z - 1)). y stays within lower ... upper, and does not wind up at a limit. y_start is
    also y before the first tick. With y_start_of="state" it is the sum before the first tick instead, to which that
    tick adds its part: y[0] = y_start + a period u[0].
    """

    form = Parameter("forward", structural=True, choices=("forward", "backward", "trapezoidal"), doc="rule of the sum")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    y_start = Parameter(0.0, unit=unit, doc="y before and at the first tick")
    y_start_of = Parameter(
        "output",
        structural=True,
        choices=("output", "state"),
        doc="whether y_start is the first y or the sum before it",
    )
    lower = Parameter(-UNLIMITED, unit=unit, is_limit=True, doc="smallest y")
    upper = Parameter(UNLIMITED, unit=unit, is_limit=True, doc="largest y")
    u = Input(unit=unit / "s", doc="input")
    x = Discrete(unit=unit, doc="y at the last tick and the part that its u adds to the next y")
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

    @output(unit=unit, every=period, offset=offset, start=y_start, doc="integral of the input")
    def y(x, u, begun, period, lower, upper, form, y_start_of):
        now = _PRESENT[form] * period * u
        return np.clip(x + (np.where(begun, now, 0.0) if y_start_of == "output" else now), lower, upper)

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
    the same if num and den have equal length. y[k] depends on u[k] only if num and den have the same degree. Zeros of
    num fix the type: a zero coefficient stays zero during a run. The state begins at x_start, which is 0.

    References: T. Kailath, Linear Systems, Prentice-Hall 1980, section 2.3.
    """

    num = Parameter([1.0], shape="m", zeros=True, doc="coefficients of the numerator, highest power first")
    den = Parameter([1.0, 0.0], shape="k", doc="coefficients of the denominator, highest power first")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    y_start = Parameter(0.0, unit=unit, doc="y before the first tick")
    inputs = Parameter("", structural=True, type="string", doc='name of the input; "": u')
    outputs = Parameter("", structural=True, type="string", doc='name of the output; "": y')
    u = Input(unit=unit_u, ports=inputs, doc="input")
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

    @output(unit=unit, ports=outputs, every=period, offset=offset, start=y_start, doc="filtered input")
    def y(x, u, num, den, m, k):
        b = np.concatenate([np.zeros(k - m), num]) / den[0]
        c = b[1:] - den[1:] / den[0] * b[0]
        return c[::-1] @ x + b[0] * u


class DiscreteStateSpace(Block):
    """x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k].

    A is n x n, B n x m, C p x n, D p x m (default: 0); u, x and y are vectors, whose elements wires name u[0], y[0].
    Named inputs and outputs are ports of their own, one for each name.
    Zeros of the matrices fix the type: an element of y[k] depends only on the u[k] for which its row of D is not 0.
    """

    A = Parameter([[0.0]], shape=("n", "n"), zeros=True, doc="from state to the next state")
    B = Parameter([[1.0]], shape=("n", "m"), zeros=True, doc="from input to the next state")
    C = Parameter([[1.0]], shape=("p", "n"), zeros=True, doc="from state to output")
    D = Parameter(lambda p, m: np.zeros((p, m)), shape=("p", "m"), zeros=True, doc="from input to output")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    y_start = Parameter(0.0, shape="p", doc="y before the first tick")
    inputs = Parameter("", structural=True, type="string", doc='names of the inputs, "F, d"; "": one vector u')
    outputs = Parameter("", structural=True, type="string", doc='names of the outputs, "p, v"; "": one vector y')
    u = Input(shape=lambda m: m, ports=inputs, doc="inputs")
    x = Discrete(shape=lambda n: n, doc="states")

    @x.next(every=period, offset=offset)
    def step(x, u, A, B):
        return A @ x + B @ u

    @output(shape=lambda p: p, ports=outputs, every=period, offset=offset, start=y_start, doc="outputs")
    def y(x, u, C, D):
        return C @ x + D @ u
