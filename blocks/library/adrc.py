"""Active disturbance rejection control: tracking differentiators, state error feedbacks, extended state observers.

Equations by number and default values are those of [1]. For a plant of order n whose n-th derivative is
y^(n) = f + b0 u, an observer estimates z1 = y, ..., zn = y^(n-1) and the total disturbance z_{n+1} = f; a feedback
acts on the errors between the wanted derivatives r1 ... rn and z1 ... zn, and takes z_{n+1}/b0 off.

Every nonlinear law is a local of one signal, so that it can be studied alone.

References:
    [1] I. K. Ibraheem, W. R. Abdul-Adeem, An Improved Active Disturbance Rejection Control for a Differential Drive
        Mobile Robot with Mismatched Disturbances and Uncertainties.
    [2] J. Han, From PID to Active Disturbance Rejection Control, IEEE Transactions on Industrial Electronics 56(3),
        2009.
    [3] Z. Gao, Scaling and Bandwidth-Parameterization Based Controller Tuning, American Control Conference 2003.
    [4] R. Miklosovic, A. Radke, Z. Gao, Discrete Implementation and Generalization of the Extended State Observer,
        American Control Conference 2006.

This file is longer than others: trackers, feedbacks and observers share their laws, gains and units.
"""

import math

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, local, output, requires
from ..contract.variables import Discrete, Input, Parameter, State
from ..text import units

__all__ = [
    "INLSEF",
    "INTD",
    "LESO",
    "LSEF",
    "NESO",
    "NLSEF",
    "SMESO",
    "DiscreteESO",
    "DiscreteINLSEF",
    "DiscreteINTD",
    "DiscreteSMESO",
    "TrackingDifferentiator",
]

MOTOR_GAIN = 1.1882 / (0.82 * 0.2752 * 3.0)
"""kt/(La Jeq n) of the paper's motor, by theorem 1: the second derivative of its speed for 1 V."""


def _rates(unit, count):
    """Units of a signal and of its first derivatives: unit, unit/s, unit/s2, ..."""
    return [unit, *(units.quotient(unit, f"s{k}") for k in range(1, count))]


def _each_error(order):
    return order


def _each_estimate(order):
    return order + 1


def _error_units(unit, order):
    return _rates(unit, order)


def _estimate_units(unit, order):
    return _rates(unit, order + 1)


def _b0_unit(unit, unit_u, order):
    return units.quotient(units.quotient(unit, f"s{order}"), unit_u)


def _paper(order, values):
    """The paper's values, one for each error, which exist for order 2."""
    if order != len(values):
        raise ValueError(f"the paper's values are for order {len(values)}; give others for order {order}")
    return values


def _observer_gains(order, bandwidth, values):
    """All poles of a linear observer at -bandwidth [3], or the paper's gains."""
    if bandwidth is None:
        if order + 1 != len(values):
            known = len(values) - 1
            raise ValueError(f"the paper's gains are for order {known}; give gains or bandwidth for order {order}")
        return values
    return _gains_of(order, bandwidth)


def _gains_of(order, bandwidth):
    """Gains of a linear observer with all poles at -bandwidth [3]."""
    if bandwidth is None:
        raise ValueError("give gains or bandwidth")
    return [math.comb(order + 1, k) * float(bandwidth) ** k for k in range(1, order + 2)]


def _powers(matrix, size):
    """1, matrix, matrix^2, ...: so many."""
    made = [np.eye(size)]
    for _ in range(size - 1):
        made.append(made[-1] @ matrix)
    return made


def _sampled_gains(order, bandwidth, period, form):
    """Gains of a sampled observer: its poles at exp(-bandwidth period), or those of the LESO's Euler steps.

    In the coordinates (z1, its forward difference, its second difference, ...) the model z(k+1) = A z(k) is a chain
    again, as A - 1 is nilpotent; there the gains are binomial coefficients times powers of 1 - exp(-bandwidth
    period), in which nothing cancels however short the period is.
    """
    if bandwidth is None:
        raise ValueError("give gains or bandwidth")
    n = order + 1
    if form == "euler":
        return [period * gain for gain in _gains_of(order, bandwidth)]
    # In steps of one period, so that the matrices hold numbers only.
    shifts = _powers(np.eye(n, k=1), n)
    model = sum(shift / math.factorial(k) for k, shift in enumerate(shifts))
    differences = np.array([power[0] for power in _powers(model - np.eye(n), n)])
    decay = -math.expm1(-float(bandwidth) * float(period))
    gains = np.linalg.solve(differences, [math.comb(n, k) * decay**k for k in range(1, n + 1)])
    if form == "current":
        gains = np.linalg.solve(model, gains)
    return gains / float(period) ** np.arange(n)


def _feedback_gains(order, bandwidth):
    """Gains that put all poles of the compensated plant at -bandwidth [3]."""
    if bandwidth is None:
        raise ValueError("give gains or bandwidth")
    return [math.comb(order, k) * float(bandwidth) ** (order - k) for k in range(order)]


def _power(e, a):
    """|e|^a sgn e"""
    return np.abs(e) ** a * np.sign(e)


def _bell(m, e):
    """1/(1 + exp(m e^2)), written so that it does not overflow."""
    return 0.5 * (1.0 - np.tanh(0.5 * m * e**2))


def _fal(e, a, delta):
    """|e|^a sgn e beyond delta, a straight line within."""
    # The power is held at its value at delta within the line, where its slope would be infinite.
    return np.where(np.abs(e) > delta, np.maximum(np.abs(e), delta) ** a * np.sign(e), e / delta ** (1.0 - a))


def _aim(r1, r, alpha, beta, form):
    """s of the INTD."""
    return beta * r1 - (1.0 - alpha) * r if form == "literal" else beta * (r1 - r)


def _law(e, k1, k2, mu, alpha):
    """Law of each error of the INLSEF."""
    return (k1 + k2 * _bell(mu, e)) * _power(e, alpha)


def _sliding(e, Ka, alpha, Kb, beta):
    """g of the SMESO."""
    # |e|^beta e as a power of |e|: the product has no derivative at e = 0 that can be computed.
    return Ka * _power(e, alpha) + Kb * _power(e, 1.0 + beta)


def _fhan(x1, x2, r, h):
    """Han's time-optimal acceleration with steps of h: bang-bang far from the origin, linear near it [2]."""
    d = r * h
    y = x1 + h * x2
    a0 = np.sqrt(d**2 + 8.0 * r * np.abs(y))
    a = np.where(np.abs(y) > d * h, x2 + 0.5 * (a0 - d) * np.sign(y), x2 + y / h)
    return -np.where(np.abs(a) > d, r * np.sign(a), r * a / d)


def _chain(z, u, b0, order):
    """z2, ..., z_{n+1}, 0, with b0 u where the n-th derivative stands."""
    control = np.zeros(order + 1)
    control[order - 1] = 1.0
    return np.concatenate([z[1:], np.zeros(1)]) + control * (b0 * u)


def _after(period, z, u, b0, order, form):
    """z after a period in which u and the total disturbance are constant; by one Euler step in that form."""
    term = period * _chain(z, u, b0, order)
    made = z + term
    for k in range(2, 2 if form == "euler" else order + 2):
        term = np.concatenate([term[1:], np.zeros(1)]) * (period / k)
        made = made + term
    return made


class TrackingDifferentiator(Block):
    """Han's tracking differentiator: dr1/dt = r2, dr2/dt = fhan(r1 - r, r2, R, h).

    r1 follows r with the acceleration R at most and r2 is its derivative. The forms:

    fhan: time-optimal with steps of h, from the linear zone of which comes a double pole at -1/h. With

            d = R h, y = x1 + h x2, a0 = sqrt(d^2 + 8 R |y|)
            a = x2 + (a0 - d)/2 sgn y where |y| > d h, else x2 + y/h
            fhan(x1, x2, R, h) = -R sgn a where |a| > d, else -R a/d

    sign: the limit h = 0, dr2/dt = -R sgn(r1 - r + r2 |r2|/(2 R)). It chatters, and an adaptive solver does not get
        through it in reasonable time: use a method with a fixed step.

    References: J. Han, From PID to Active Disturbance Rejection Control, IEEE TIE 56(3), 2009, section III.A. R is the
        paper's; h is assumed.
    """

    form = Parameter("fhan", structural=True, choices=("fhan", "sign"), doc="fhan: smooth near its aim; sign: chatters")
    unit = Parameter("", structural=True, type="string", doc='unit of r; "": unknown')
    R = Parameter(100.0, unit=unit / "s2", positive=True, doc="largest acceleration")
    h = Parameter(1e-3, unit="s", positive=True, doc="step of fhan; not used by the form sign")
    r = Input(unit=unit, doc="signal to follow")
    r1 = State(unit=unit, output=True, doc="followed signal")
    r2 = State(unit=unit / "s", output=True, doc="its derivative")

    @r1.derivative
    def dr1(r2):
        return r2

    @local(doc="distance to the aim, from which the acceleration follows")
    def distance(r1, r):
        return r1 - r

    @r2.derivative
    def dr2(distance, r2, R, h, form):
        if form == "sign":
            return -R * np.sign(distance + r2 * np.abs(r2) / (2.0 * R))
        return _fhan(distance, r2, R, h)


class INTD(Block):
    """Improved nonlinear tracking differentiator, eq. (1): dr1/dt = r2, dr2/dt = -R^2 tanh(s/gamma) - R r2.

    The forms:

    unit: s = beta (r1 - r). r1 settles at r: the DC gain is 1. The paper's tables are had with this form; alpha has
        no effect.
    literal: s = beta r1 - (1 - alpha) r, as eq. (1) is printed. r1 settles at (1 - alpha)/beta r: with the paper's
        values the DC gain is 0.2334.
    """

    form = Parameter("unit", structural=True, choices=("unit", "literal"), doc="unit: DC gain 1; literal: as printed")
    unit = Parameter("", structural=True, type="string", doc='unit of r; "": unknown')
    R = Parameter(16.8199, unit="1/s", positive=True, doc="speed")
    alpha = Parameter(0.4968, doc="weight of r in the literal form, between 0 and 1")
    beta = Parameter(2.1555, positive=True, doc="weight of the distance, or of r1 in the literal form")
    gamma = Parameter(11.9554, unit=unit, positive=True, doc="size of s at which tanh begins to saturate")
    r = Input(unit=unit, doc="signal to follow")
    r1 = State(unit=unit, output=True, doc="followed signal")
    r2 = State(unit=unit / "s", output=True, doc="its derivative")

    @requires("alpha must lie between 0 and 1")
    def is_weight(alpha):
        return 0 < alpha < 1

    @r1.derivative
    def dr1(r2):
        return r2

    @local(unit=unit, doc="distance to the aim")
    def s(r1, r, alpha, beta, form):
        return _aim(r1, r, alpha, beta, form)

    @local(doc="saturated distance")
    def pull(s, gamma):
        return np.tanh(s / gamma)

    @r2.derivative
    def dr2(pull, r2, R):
        return -(R**2) * pull - R * r2


class NLSEF(Block):
    """Nonlinear state error feedback: u = sum of gains_i fal(e_i, alpha_i, delta_i) - z_{n+1}/b0, e_i = r_i - z_i.

        fal(e, a, d) = |e|^a sgn e where |e| > d, else e/d^(1 - a)

    The paper prints alpha and delta for order 2; gains of 1 and the nominal b0 of its motor are assumed.

    References: J. Han, From PID to Active Disturbance Rejection Control, IEEE TIE 56(3), 2009, section III.B.
    """

    order = Parameter(2, structural=True, type="int", min=1, doc="order n of the plant")
    unit = Parameter("", structural=True, type="string", doc='unit of r1 and z1; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    gains = Parameter(1.0, shape=_each_error, doc="gain of each error")
    alpha = Parameter(
        lambda order: _paper(order, [0.1726, 0.8730]),
        shape=_each_error,
        positive=True,
        doc="exponent of each error",
    )
    delta = Parameter(
        lambda order: _paper(order, [0.4620, 0.24807]),
        shape=_each_error,
        unit=_error_units,
        positive=True,
        doc="size of each error up to which its law is linear",
    )
    b0 = Parameter(MOTOR_GAIN, unit=_b0_unit, doc="gain of the control in the plant")
    r = Input(shape=_each_error, ports="r{}", unit=_error_units, doc="wanted output and its derivatives")
    z = Input(shape=_each_estimate, ports="z{}", unit=_estimate_units, doc="estimates, the total disturbance last")

    @requires("b0 must not be 0")
    def has_b0(b0):
        return b0 != 0

    @local(unit=_error_units, doc="errors")
    def e(r, z, order):
        return r - z[:order]

    @local(doc="fal of each error")
    def law(e, alpha, delta):
        return _fal(e, alpha, delta)

    @local(unit=unit_u, doc="control without compensation")
    def u0(law, gains):
        return gains @ law

    @output(unit=unit_u, doc="control")
    def u(u0, z, b0, order):
        return u0 - z[order] / b0


class INLSEF(Block):
    """Improved nonlinear state error feedback, eqs. (2)-(4): u = delta tanh(v/delta) - z_{n+1}/b0, e_i = r_i - z_i.

        v = sum of k_i(e_i) |e_i|^alpha_i sgn e_i + k_integral(I) |I|^alpha_integral sgn I,   dI/dt = e_1
        k_i(e) = k1_i + k2_i/(1 + exp(mu_i e^2)),   k_integral(I) = k3/(1 + exp(mu_integral I^2))

    The paper's k_i1, k_i2, mu_i, alpha_i of order 2 are the defaults; its k3, mu_3, alpha_3 are those of the integral.
    It gives these three and delta, but no equation with them: the law of the integral and tanh are assumed, and so is
    the b0 of its motor. The factor 1/(1 + exp(m e^2)) is computed as (1 - tanh(m e^2/2))/2, which does not overflow.
    Where alpha_i < 1 the law has an infinite slope at e_i = 0.
    """

    order = Parameter(2, structural=True, type="int", min=1, doc="order n of the plant")
    unit = Parameter("", structural=True, type="string", doc='unit of r1 and z1; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    k1 = Parameter(lambda order: _paper(order, [144.6642, 25.5574]), shape=_each_error, doc="gain of each large error")
    k2 = Parameter(
        lambda order: _paper(order, [8.0475, 4.8814]),
        shape=_each_error,
        doc="twice the extra gain of small errors",
    )
    mu = Parameter(
        lambda order: _paper(order, [44.3160, 48.8179]),
        shape=_each_error,
        min=0.0,
        doc="how fast k2 fades with each error",
    )
    alpha = Parameter(
        lambda order: _paper(order, [0.9675, 1.4487]),
        shape=_each_error,
        positive=True,
        doc="exponent of each error",
    )
    k3 = Parameter(0.5308, doc="gain of the integral")
    mu_integral = Parameter(26.1493, min=0.0, doc="how fast k3 fades with the integral")
    alpha_integral = Parameter(3.5032, positive=True, doc="exponent of the integral")
    delta = Parameter(3.8831, unit=unit_u, positive=True, doc="largest control without compensation")
    b0 = Parameter(MOTOR_GAIN, unit=_b0_unit, doc="gain of the control in the plant")
    r = Input(shape=_each_error, ports="r{}", unit=_error_units, doc="wanted output and its derivatives")
    z = Input(shape=_each_estimate, ports="z{}", unit=_estimate_units, doc="estimates, the total disturbance last")
    I = State(unit=unit * "s", output=True, doc="integral of the first error")

    @requires("b0 must not be 0")
    def has_b0(b0):
        return b0 != 0

    @local(unit=_error_units, doc="errors")
    def e(r, z, order):
        return r - z[:order]

    @I.derivative
    def dI(e):
        return e[0]

    @local(doc="law of each error")
    def law(e, k1, k2, mu, alpha):
        return _law(e, k1, k2, mu, alpha)

    @local(doc="law of the integral")
    def integral_law(I, k3, mu_integral, alpha_integral):
        return k3 * _bell(mu_integral, I) * _power(I, alpha_integral)

    @local(unit=unit_u, doc="sum of the laws")
    def v(law, integral_law):
        return np.sum(law) + integral_law

    @local(unit=unit_u, doc="control without compensation")
    def u0(v, delta):
        return delta * np.tanh(v / delta)

    @output(unit=unit_u, doc="control")
    def u(u0, z, b0, order):
        return u0 - z[order] / b0


class LSEF(Block):
    """Linear state error feedback: u = (sum of gains_i (r_i - z_i) - z_{n+1})/b0.

    Give `gains`, or `bandwidth`, which puts all n poles of a plant y^(n) = f + b0 u at -bandwidth, where the estimates
    are right: gains_i is the binomial coefficient (n over i - 1) times bandwidth^(n - i + 1). What is not wired of the
    wanted output and its derivatives is 0.

    References: Z. Gao, Scaling and Bandwidth-Parameterization Based Controller Tuning, ACC 2003.
    """

    order = Parameter(2, structural=True, type="int", min=1, doc="order n of the plant")
    unit = Parameter("", structural=True, type="string", doc='unit of r1 and z1; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    bandwidth = Parameter(None, unit="rad/s", excludes="gains", positive=True, doc="where the poles lie")
    gains = Parameter(
        lambda order, bandwidth: _feedback_gains(order, bandwidth),
        shape=_each_error,
        unit=lambda order: _rates("1/s", order)[::-1],
        doc="gain of each error",
    )
    b0 = Parameter(1.0, unit=_b0_unit, doc="gain of the control in the plant")
    r = Input(0.0, shape=_each_error, ports="r{}", unit=_error_units, doc="wanted output and its derivatives")
    z = Input(shape=_each_estimate, ports="z{}", unit=_estimate_units, doc="estimates, the total disturbance last")

    @requires("b0 must not be 0")
    def has_b0(b0):
        return b0 != 0

    @local(unit=_error_units, doc="errors")
    def e(r, z, order):
        return r - z[:order]

    @output(unit=unit_u, doc="control")
    def u(e, z, gains, b0, order):
        return (gains @ e - z[order]) / b0


class LESO(Block):
    """Linear extended state observer: dz_i/dt = z_{i+1} + gains_i e, dz_n/dt = z_{n+1} + b0 u + gains_n e, e = y - z1.

    dz_{n+1}/dt = gains_{n+1} e. Give `gains`, or `bandwidth`, which puts all n + 1 poles at -bandwidth: gains_i is
    the binomial coefficient (n + 1 over i) times bandwidth^i. Neither given: the paper's gains of order 2.
    The b0 of the paper's motor is assumed.

    References: Z. Gao, Scaling and Bandwidth-Parameterization Based Controller Tuning, ACC 2003.
    """

    order = Parameter(2, structural=True, type="int", min=1, doc="order n of the plant")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    bandwidth = Parameter(None, unit="rad/s", excludes="gains", positive=True, doc="where the poles lie")
    gains = Parameter(
        lambda order, bandwidth: _observer_gains(order, bandwidth, [30.4, 523.4, 2970.8]),
        shape=_each_estimate,
        unit=lambda order: _rates("1/s", order + 1),
        doc="gain of the error in each derivative",
    )
    b0 = Parameter(MOTOR_GAIN, unit=_b0_unit, doc="gain of the control in the plant")
    y = Input(unit=unit, doc="measured output of the plant")
    u = Input(unit=unit_u, doc="control that the plant gets")
    z = State(
        shape=_each_estimate,
        output=True,
        ports="z{}",
        unit=_estimate_units,
        doc="estimates of y, its derivatives and the total disturbance",
    )

    @local(unit=unit, doc="error of the estimate")
    def e(y, z):
        return y - z[0]

    @z.derivative
    def dz(z, u, e, b0, gains, order):
        return _chain(z, u, b0, order) + gains * e


class SMESO(Block):
    """Sliding mode extended state observer, eqs. (5)-(6): a LESO whose error goes through g.

        dz_i/dt = z_{i+1} + gains_i g(e),   dz_n/dt = z_{n+1} + b0 u + gains_n g(e),   dz_{n+1}/dt = gains_{n+1} g(e)
        g(e) = Ka |e|^alpha sgn e + Kb |e|^beta e,   e = y - z1

    Give `gains`, or `bandwidth`, which makes them those of a LESO with all poles at -bandwidth. Neither given: the
    paper's gains of order 2. Where alpha < 1, g has an infinite slope at e = 0. The b0 of the paper's motor is assumed.
    """

    order = Parameter(2, structural=True, type="int", min=1, doc="order n of the plant")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    Ka = Parameter(0.6265, min=0.0, doc="weight of the sliding term")
    alpha = Parameter(0.8433, positive=True, doc="exponent of the sliding term")
    Kb = Parameter(0.5878, min=0.0, doc="weight of the second term")
    beta = Parameter(0.04078, min=0.0, doc="exponent of the factor of the second term")
    bandwidth = Parameter(None, unit="rad/s", excludes="gains", positive=True, doc="where the poles lie for g(e) = e")
    gains = Parameter(
        lambda order, bandwidth: _observer_gains(order, bandwidth, [30.4, 513.4, 1570.8]),
        shape=_each_estimate,
        unit=lambda order: _rates("1/s", order + 1),
        doc="gain of g in each derivative",
    )
    b0 = Parameter(MOTOR_GAIN, unit=_b0_unit, doc="gain of the control in the plant")
    y = Input(unit=unit, doc="measured output of the plant")
    u = Input(unit=unit_u, doc="control that the plant gets")
    z = State(
        shape=_each_estimate,
        output=True,
        ports="z{}",
        unit=_estimate_units,
        doc="estimates of y, its derivatives and the total disturbance",
    )

    @local(unit=unit, doc="error of the estimate")
    def e(y, z):
        return y - z[0]

    @local(unit=unit, doc="law of the error")
    def g(e, Ka, alpha, Kb, beta):
        return _sliding(e, Ka, alpha, Kb, beta)

    @z.derivative
    def dz(z, u, g, b0, gains, order):
        return _chain(z, u, b0, order) + gains * g


class NESO(Block):
    """Nonlinear extended state observer: a LESO whose error goes through fal, with an exponent for each estimate.

        dz_i/dt = z_{i+1} + gains_i fal_i,   fal_i = fal(e, alpha_i, delta),   e = y - z1
        dz_n/dt = z_{n+1} + b0 u + gains_n fal_n,   dz_{n+1}/dt = gains_{n+1} fal_{n+1}
        fal(e, a, d) = |e|^a sgn e where |e| > d, else e/d^(1 - a)

    With exponents below 1 the gain falls as the error grows: a fast observer that does not overshoot as far when it
    starts far off. The exponents are 1, 1/2, 1/4, ... unless given. Give `gains`, or `bandwidth`, which makes gains_i
    the binomial coefficient (n + 1 over i) times bandwidth^i delta^(1 - alpha_i): where |e| <= delta, this is the
    LESO with all poles at -bandwidth. The instants at which |e| passes delta are located.

    References: J. Han, From PID to Active Disturbance Rejection Control, IEEE TIE 56(3), 2009.
    """

    order = Parameter(2, structural=True, type="int", min=1, doc="order n of the plant")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    alpha = Parameter(
        lambda order: [0.5**k for k in range(order + 1)],
        shape=_each_estimate,
        positive=True,
        doc="exponent of the error in each derivative",
    )
    delta = Parameter(0.01, unit=unit, positive=True, doc="size of the error up to which its laws are linear")
    bandwidth = Parameter(None, unit="rad/s", excludes="gains", positive=True, doc="where the poles lie within delta")
    gains = Parameter(
        lambda order, bandwidth, alpha, delta: _gains_of(order, bandwidth) * delta ** (1.0 - alpha),
        shape=_each_estimate,
        doc="gain of each law",
    )
    b0 = Parameter(1.0, unit=_b0_unit, doc="gain of the control in the plant")
    y = Input(unit=unit, doc="measured output of the plant")
    u = Input(unit=unit_u, doc="control that the plant gets")
    z = State(
        shape=_each_estimate,
        output=True,
        ports="z{}",
        unit=_estimate_units,
        doc="estimates of y, its derivatives and the total disturbance",
    )

    @local(unit=unit, doc="error of the estimate")
    def e(y, z):
        return y - z[0]

    @crossing
    def above(e, delta):
        return e - delta

    @crossing
    def below(e, delta):
        return -delta - e

    @local(doc="fal of the error, for each derivative")
    def law(e, above, below, alpha, delta):
        # Up to the located instant a step may look beyond it: there the power goes on, but not to 0, where its slope
        # would be infinite.
        size = np.maximum(np.abs(e), 0.5 * delta)
        return np.where(above | below, size**alpha * np.sign(e), e / delta ** (1.0 - alpha))

    @z.derivative
    def dz(z, u, law, b0, gains, order):
        return _chain(z, u, b0, order) + gains * law


class DiscreteESO(Block):
    """Linear extended state observer in sampled time: from y(k) and u(k) at tick k estimates z(k), held in between.

    With e(k) = y(k) - x1(k), and A, B of y^(n) = f + b0 u over one period in which f and u are constant:

    euler: z(k) = x(k), x(k+1) = A z(k) + B u(k) + gains e(k), with A and B of one Euler step: the LESO in Euler steps.
        `bandwidth` puts the poles at 1 - bandwidth period.
    zoh: the same with the exact A and B; `bandwidth` puts the poles at exp(-bandwidth period).
    current: z(k) = x(k) + gains e(k), x(k+1) = A z(k) + B u(k), with the exact A and B; `bandwidth` puts the poles at
        exp(-bandwidth period). The measurement of a tick counts at that tick; in the other two it counts at the next.

    Give `gains` or `bandwidth`. u(k) is the control at the tick, which may depend on z(k); it should stay constant up
    to the next tick, as it does behind a feedback of z and of a constant reference. Before the first tick z is z_start.

    References: R. Miklosovic, A. Radke, Z. Gao, Discrete Implementation and Generalization of the Extended State
        Observer, ACC 2006. G. F. Franklin, J. D. Powell, M. L. Workman, Digital Control of Dynamic Systems, 3rd ed.,
        Addison-Wesley 1998, section 8.2.
    """

    form = Parameter(
        "current",
        structural=True,
        choices=("euler", "zoh", "current"),
        doc="euler: Euler steps; zoh: exact model; current: exact model, newest measurement",
    )
    order = Parameter(2, structural=True, type="int", min=1, doc="order n of the plant")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    bandwidth = Parameter(
        None, unit="rad/s", excludes="gains", positive=True, doc="where the poles lie, for a short period"
    )
    gains = Parameter(
        lambda order, bandwidth, period, form: _sampled_gains(order, bandwidth, period, form),
        shape=_each_estimate,
        unit=lambda order: _rates("1", order + 1),
        doc="gain of the error in each estimate, at each tick",
    )
    b0 = Parameter(1.0, unit=_b0_unit, doc="gain of the control in the plant")
    z_start = Parameter(0.0, shape=_each_estimate, unit=_estimate_units, doc="estimates at the start")
    y = Input(unit=unit, doc="measured output of the plant")
    u = Input(unit=unit_u, doc="control that the plant gets up to the next tick")
    x = Discrete(shape=_each_estimate, unit=_estimate_units, doc="estimates for the next tick, as predicted")

    @requires("bandwidth times period must be below 2, or the Euler steps are unstable")
    def is_stable(form, bandwidth, period):
        return form != "euler" or bandwidth is None or bandwidth * period < 2

    @x.initial
    def start(z_start):
        return z_start

    @output(
        shape=_each_estimate,
        ports="z{}",
        unit=_estimate_units,
        every=period,
        offset=offset,
        start=z_start,
        doc="estimates of y, its derivatives and the total disturbance",
    )
    def z(x, y, gains, form):
        return x + gains * (y - x[0]) if form == "current" else x

    @x.next(every=period, offset=offset)
    def predict(x, y, u, gains, b0, period, order, form):
        corrected = gains * (y - x[0])
        if form == "current":
            return _after(period, x + corrected, u, b0, order, form)
        return _after(period, x, u, b0, order, form) + corrected


class DiscreteINTD(Block):
    """INTD in sampled time: r1(k+1) = r1(k) + T r2(k), r2(k+1) = r2(k) - T (R^2 tanh(s(k)/gamma) + R r2(k)).

    T is the period, s and the forms are those of INTD. These are Euler steps, as Han takes them for his differentiator:
    r1 and r2 of a tick are made of r at the ticks before it. They settle where R T < 2 and
    beta R T < gamma: with the paper's values, up to T = 0.119 s. Before the first tick r1 and r2 are r1_start and
    r2_start.

    References: J. Han, From PID to Active Disturbance Rejection Control, IEEE TIE 56(3), 2009, section III.A.
    """

    form = Parameter("unit", structural=True, choices=("unit", "literal"), doc="unit: DC gain 1; literal: as printed")
    unit = Parameter("", structural=True, type="string", doc='unit of r; "": unknown')
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    R = Parameter(16.8199, unit="1/s", positive=True, doc="speed")
    alpha = Parameter(0.4968, doc="weight of r in the literal form, between 0 and 1")
    beta = Parameter(2.1555, positive=True, doc="weight of the distance, or of r1 in the literal form")
    gamma = Parameter(11.9554, unit=unit, positive=True, doc="size of s at which tanh begins to saturate")
    r1_start = Parameter(0.0, unit=unit, doc="r1 at the start")
    r2_start = Parameter(0.0, unit=unit / "s", doc="r2 at the start")
    r = Input(unit=unit, doc="signal to follow")
    x1 = Discrete(unit=unit, doc="r1 of the next tick")
    x2 = Discrete(unit=unit / "s", doc="r2 of the next tick")

    @requires("alpha must lie between 0 and 1")
    def is_weight(alpha):
        return 0 < alpha < 1

    @x1.initial
    def start1(r1_start):
        return r1_start

    @x2.initial
    def start2(r2_start):
        return r2_start

    @output(unit=unit, every=period, offset=offset, start=r1_start, doc="followed signal")
    def r1(x1):
        return x1

    @output(unit=unit / "s", every=period, offset=offset, start=r2_start, doc="its derivative")
    def r2(x2):
        return x2

    @x1.next(every=period, offset=offset)
    def step1(x1, x2, period):
        return x1 + period * x2

    @local(unit=unit, doc="distance to the aim")
    def s(x1, r, alpha, beta, form):
        return _aim(x1, r, alpha, beta, form)

    @local(doc="saturated distance")
    def pull(s, gamma):
        return np.tanh(s / gamma)

    @x2.next(every=period, offset=offset)
    def step2(x2, pull, R, period):
        return x2 + period * (-(R**2) * pull - R * x2)


class DiscreteINLSEF(Block):
    """INLSEF in sampled time: its u at each tick, held in between; I(k+1) = I(k) + period e_1(k).

    The laws and the defaults are those of INLSEF. The integral is a sum by forward differences, so that that of a tick
    is made of the errors at the ticks before it. Before the first tick u is u_start.
    """

    order = Parameter(2, structural=True, type="int", min=1, doc="order n of the plant")
    unit = Parameter("", structural=True, type="string", doc='unit of r1 and z1; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    k1 = Parameter(lambda order: _paper(order, [144.6642, 25.5574]), shape=_each_error, doc="gain of each large error")
    k2 = Parameter(
        lambda order: _paper(order, [8.0475, 4.8814]),
        shape=_each_error,
        doc="twice the extra gain of small errors",
    )
    mu = Parameter(
        lambda order: _paper(order, [44.3160, 48.8179]),
        shape=_each_error,
        min=0.0,
        doc="how fast k2 fades with each error",
    )
    alpha = Parameter(
        lambda order: _paper(order, [0.9675, 1.4487]),
        shape=_each_error,
        positive=True,
        doc="exponent of each error",
    )
    k3 = Parameter(0.5308, doc="gain of the integral")
    mu_integral = Parameter(26.1493, min=0.0, doc="how fast k3 fades with the integral")
    alpha_integral = Parameter(3.5032, positive=True, doc="exponent of the integral")
    delta = Parameter(3.8831, unit=unit_u, positive=True, doc="largest control without compensation")
    b0 = Parameter(MOTOR_GAIN, unit=_b0_unit, doc="gain of the control in the plant")
    u_start = Parameter(0.0, unit=unit_u, doc="control before the first tick")
    r = Input(shape=_each_error, ports="r{}", unit=_error_units, doc="wanted output and its derivatives")
    z = Input(shape=_each_estimate, ports="z{}", unit=_estimate_units, doc="estimates, the total disturbance last")
    I = Discrete(unit=unit * "s", doc="integral of the first error")

    @requires("b0 must not be 0")
    def has_b0(b0):
        return b0 != 0

    @local(unit=_error_units, doc="errors")
    def e(r, z, order):
        return r - z[:order]

    @local(doc="law of each error")
    def law(e, k1, k2, mu, alpha):
        return _law(e, k1, k2, mu, alpha)

    @local(doc="law of the integral")
    def integral_law(I, k3, mu_integral, alpha_integral):
        return k3 * _bell(mu_integral, I) * _power(I, alpha_integral)

    @local(unit=unit_u, doc="sum of the laws")
    def v(law, integral_law):
        return np.sum(law) + integral_law

    @local(unit=unit_u, doc="control without compensation")
    def u0(v, delta):
        return delta * np.tanh(v / delta)

    @output(unit=unit_u, every=period, offset=offset, start=u_start, doc="control")
    def u(u0, z, b0, order):
        return u0 - z[order] / b0

    @I.next(every=period, offset=offset)
    def integrate(I, e, period):
        return I + period * e[0]


class DiscreteSMESO(Block):
    """SMESO in sampled time: a DiscreteESO whose error goes through g, with the gains of the SMESO times the period T.

    With g of SMESO and e(k) = y(k) - x1(k), and A, B of y^(n) = f + b0 u over one period in which f and u are constant:

    euler: z(k) = x(k), x(k+1) = A z(k) + B u(k) + T gains g(e(k)), with A and B of one Euler step: the SMESO in Euler
        steps. The measurement of a tick counts at the next one.
    zoh: the same with the exact A and B.
    current: z(k) = x(k) + T gains g(e(k)), x(k+1) = A z(k) + B u(k), with the exact A and B. The measurement of a tick
        counts at that tick: a period less of delay in the loop, for which [4] recommends it.

    `gains`, `bandwidth` and their defaults are those of SMESO: the period must be short against 1/bandwidth. Where
    alpha < 1, g has an infinite slope at e = 0, and e does not settle there: in the end it changes its sign at each
    tick, with |e| near (T gains_1 Ka/2)^(1/(1 - alpha)) for a short T. With the paper's values this is 1e-13 of the
    unit of y at 1 ms, and 1e-11 at 2 ms. u(k) may depend on z(k), and should stay constant up to the next tick. Before
    the first tick z is z_start.

    References: R. Miklosovic, A. Radke, Z. Gao, Discrete Implementation and Generalization of the Extended State
        Observer, ACC 2006, for a linear observer; that its forms are used with g is an assumption. J. Han, From PID to
        Active Disturbance Rejection Control, IEEE TIE 56(3), 2009, has Euler steps of a nonlinear one.
    """

    form = Parameter(
        "current",
        structural=True,
        choices=("euler", "zoh", "current"),
        doc="euler: Euler steps; zoh: exact model; current: exact model, newest measurement",
    )
    order = Parameter(2, structural=True, type="int", min=1, doc="order n of the plant")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    Ka = Parameter(0.6265, min=0.0, doc="weight of the sliding term")
    alpha = Parameter(0.8433, positive=True, doc="exponent of the sliding term")
    Kb = Parameter(0.5878, min=0.0, doc="weight of the second term")
    beta = Parameter(0.04078, min=0.0, doc="exponent of the factor of the second term")
    bandwidth = Parameter(None, unit="rad/s", excludes="gains", positive=True, doc="where the poles lie for g(e) = e")
    gains = Parameter(
        lambda order, bandwidth: _observer_gains(order, bandwidth, [30.4, 513.4, 1570.8]),
        shape=_each_estimate,
        unit=lambda order: _rates("1/s", order + 1),
        doc="gain of g in each derivative",
    )
    b0 = Parameter(MOTOR_GAIN, unit=_b0_unit, doc="gain of the control in the plant")
    z_start = Parameter(0.0, shape=_each_estimate, unit=_estimate_units, doc="estimates at the start")
    y = Input(unit=unit, doc="measured output of the plant")
    u = Input(unit=unit_u, doc="control that the plant gets up to the next tick")
    x = Discrete(shape=_each_estimate, unit=_estimate_units, doc="estimates for the next tick, as predicted")

    @x.initial
    def start(z_start):
        return z_start

    @local(unit=unit, doc="error of the estimate")
    def e(y, x):
        return y - x[0]

    @local(unit=unit, doc="law of the error")
    def g(e, Ka, alpha, Kb, beta):
        return _sliding(e, Ka, alpha, Kb, beta)

    @output(
        shape=_each_estimate,
        ports="z{}",
        unit=_estimate_units,
        every=period,
        offset=offset,
        start=z_start,
        doc="estimates of y, its derivatives and the total disturbance",
    )
    def z(x, g, gains, period, form):
        return x + period * gains * g if form == "current" else x

    @x.next(every=period, offset=offset)
    def predict(z, u, g, gains, b0, period, order, form):
        after = _after(period, z, u, b0, order, form)
        return after if form == "current" else after + period * gains * g
