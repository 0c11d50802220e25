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
"""

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, local, output, requires
from ..contract.variables import Discrete, Input, Parameter, State
from .adrc_laws import (
    after_period,
    aim,
    b0_unit,
    bell,
    chain,
    each_error,
    each_estimate,
    error_units,
    estimate_units,
    fal,
    feedback_gains,
    fhan,
    linear_gains,
    observer_gains,
    of_paper,
    rates,
    sampled_gains,
    signed_power,
)

__all__ = [
    "INLSEF", "INTD", "LESO", "LSEF", "NESO", "NLSEF", "SMESO", "ContinuousObserver", "ContinuousTracker",
    "DiscreteESO", "DiscreteINLSEF", "DiscreteINTD", "DiscreteSMESO", "ImprovedFeedback", "ImprovedTracker",
    "ImprovedTracking", "NonlinearObserver", "Observer", "SampledObserver", "SlidingLaw", "StateFeedback", "Ticks",
    "Tracker", "TrackingDifferentiator",
]  # fmt: skip

MOTOR_GAIN = 1.1882 / (0.82 * 0.2752 * 3.0)
"""kt/(La Jeq n) of the paper's motor, by theorem 1: the second derivative of its speed for 1 V."""


class Ticks(Block, abstract=True):
    """What is computed at ticks."""

    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")


class Tracker(Block, abstract=True):
    """What follows a signal."""

    unit = Parameter("", structural=True, type="string", doc='unit of r; "": unknown')
    r = Input(unit=unit, doc="signal to follow")


class ContinuousTracker(Tracker, abstract=True):
    """A signal r1 that follows another, and its derivative r2."""

    r1 = State(unit=Tracker.unit, output=True, doc="followed signal")
    r2 = State(unit=Tracker.unit / "s", output=True, doc="its derivative")

    @r1.derivative
    def dr1(r2):
        return r2


class ImprovedTracker(Tracker, abstract=True):
    """What follows a signal in a form of the INTD."""

    form = Parameter("unit", structural=True, choices=("unit", "literal"), doc="unit: DC gain 1; literal: as printed")
    unit = Tracker.unit


class ImprovedTracking(Block, abstract=True):
    """The law of the INTD, of a distance s to the aim."""

    R = Parameter(16.8199, unit="1/s", positive=True, doc="speed")
    alpha = Parameter(0.4968, doc="weight of r in the literal form, between 0 and 1")
    beta = Parameter(2.1555, positive=True, doc="weight of the distance, or of r1 in the literal form")
    gamma = Parameter(11.9554, unit=Tracker.unit, positive=True, doc="size of s at which tanh begins to saturate")
    s = local(unit=Tracker.unit, doc="distance to the aim")

    @requires("alpha must lie between 0 and 1")
    def is_weight(alpha):
        return 0 < alpha < 1

    @local(doc="saturated distance")
    def pull(s, gamma):
        return np.tanh(s / gamma)


class StateFeedback(Block, abstract=True):
    """A feedback of the errors between the wanted derivatives and the estimates, which takes z_{n+1}/b0 off."""

    order = Parameter(2, structural=True, type="int", min=1, doc="order n of the plant")
    unit = Parameter("", structural=True, type="string", doc='unit of r1 and z1; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    b0 = Parameter(MOTOR_GAIN, unit=b0_unit, doc="gain of the control in the plant")
    r = Input(shape=each_error, ports="r{}", unit=error_units, doc="wanted output and its derivatives")
    z = Input(shape=each_estimate, ports="z{}", unit=estimate_units, doc="estimates, the total disturbance last")

    @requires("b0 must not be 0")
    def has_b0(b0):
        return b0 != 0

    @local(unit=error_units, doc="errors")
    def e(r, z, order):
        return r - z[:order]


class ImprovedFeedback(Block, abstract=True):
    """The laws of the INLSEF, of the errors e and their integral I."""

    k1 = Parameter(lambda order: of_paper(order, [144.6642, 25.5574]), shape=each_error, doc="gain of each large error")
    k2 = Parameter(
        lambda order: of_paper(order, [8.0475, 4.8814]),
        shape=each_error,
        doc="twice the extra gain of small errors",
    )
    mu = Parameter(
        lambda order: of_paper(order, [44.3160, 48.8179]),
        shape=each_error,
        min=0.0,
        doc="how fast k2 fades with each error",
    )
    alpha = Parameter(
        lambda order: of_paper(order, [0.9675, 1.4487]),
        shape=each_error,
        positive=True,
        doc="exponent of each error",
    )
    k3 = Parameter(0.5308, doc="gain of the integral")
    mu_integral = Parameter(26.1493, min=0.0, doc="how fast k3 fades with the integral")
    alpha_integral = Parameter(3.5032, positive=True, doc="exponent of the integral")
    delta = Parameter(3.8831, unit=StateFeedback.unit_u, positive=True, doc="largest control without compensation")

    @local(doc="law of each error")
    def law(e, k1, k2, mu, alpha):
        return (k1 + k2 * bell(mu, e)) * signed_power(e, alpha)

    @local(doc="law of the integral")
    def integral_law(I, k3, mu_integral, alpha_integral):
        return k3 * bell(mu_integral, I) * signed_power(I, alpha_integral)

    @local(unit=StateFeedback.unit_u, doc="sum of the laws")
    def v(law, integral_law):
        return np.sum(law) + integral_law

    @local(unit=StateFeedback.unit_u, doc="control without compensation")
    def u0(v, delta):
        return delta * np.tanh(v / delta)


class Observer(Block, abstract=True):
    """What estimates the output of a plant y^(n) = f + b0 u, its derivatives and f, from y and u."""

    order = Parameter(2, structural=True, type="int", min=1, doc="order n of the plant")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    b0 = Parameter(MOTOR_GAIN, unit=b0_unit, doc="gain of the control in the plant")
    y = Input(unit=unit, doc="measured output of the plant")
    u = Input(unit=unit_u, doc="control that the plant gets")


class ContinuousObserver(Observer, abstract=True):
    """An observer whose estimates are states."""

    z = State(
        shape=each_estimate,
        output=True,
        ports="z{}",
        unit=estimate_units,
        doc="estimates of y, its derivatives and the total disturbance",
    )

    @local(unit=Observer.unit, doc="error of the estimate")
    def e(y, z):
        return y - z[0]


class NonlinearObserver(ContinuousObserver, abstract=True):
    """An extended state observer with a law of the error e, one for all derivatives or one for each.

        dz_i/dt = z_{i+1} + gains_i law_i,   dz_n/dt = z_{n+1} + b0 u + gains_n law_n
        dz_{n+1}/dt = gains_{n+1} law_{n+1},   e = y - z1

    Give `gains`, or `bandwidth`, which makes them those of a linear observer with all poles at -bandwidth.
    """

    bandwidth = Parameter(None, unit="rad/s", excludes="gains", positive=True, doc="where the poles lie for law = e")
    gains = Parameter(
        lambda order, bandwidth: linear_gains(order, bandwidth),
        shape=each_estimate,
        doc="gain of each law",
    )
    b0 = Parameter(1.0, unit=b0_unit, doc="gain of the control in the plant")
    law = local(doc="law of the error")

    @ContinuousObserver.z.derivative
    def dz(z, u, law, b0, gains, order):
        return chain(z, u, b0, order) + gains * law


class SlidingLaw(Block, abstract=True):
    """The law of the SMESO, of the error e."""

    Ka = Parameter(0.6265, min=0.0, doc="weight of the sliding term")
    alpha = Parameter(0.8433, positive=True, doc="exponent of the sliding term")
    Kb = Parameter(0.5878, min=0.0, doc="weight of the second term")
    beta = Parameter(0.04078, min=0.0, doc="exponent of the factor of the second term")
    bandwidth = Parameter(None, unit="rad/s", excludes="gains", positive=True, doc="where the poles lie for g(e) = e")
    gains = Parameter(
        lambda order, bandwidth: observer_gains(order, bandwidth, [30.4, 513.4, 1570.8]),
        shape=each_estimate,
        unit=lambda order: rates("1/s", order + 1),
        doc="gain of g in each derivative",
    )

    @local(unit=Observer.unit, doc="law of the error")
    def g(e, Ka, alpha, Kb, beta):
        # |e|^beta e as a power of |e|: the product has no derivative at e = 0 that can be computed.
        return Ka * signed_power(e, alpha) + Kb * signed_power(e, 1.0 + beta)


class SampledObserver(Observer, Ticks, abstract=True):
    """An observer in sampled time: x is its state at a tick, of which z follows."""

    form = Parameter(
        "current",
        structural=True,
        choices=("euler", "zoh", "current"),
        doc="euler: Euler steps; zoh: exact model; current: exact model, newest measurement",
    )
    order = Observer.order
    unit = Observer.unit
    unit_u = Observer.unit_u
    period = Ticks.period
    offset = Ticks.offset
    z_start = Parameter(0.0, shape=each_estimate, unit=estimate_units, doc="estimates at the start")
    u = Input(unit=unit_u, doc="control that the plant gets up to the next tick")
    x = Discrete(shape=each_estimate, unit=estimate_units, doc="estimates for the next tick, as predicted")
    z = output(
        shape=each_estimate,
        ports="z{}",
        unit=estimate_units,
        every=period,
        offset=offset,
        start=z_start,
        doc="estimates of y, its derivatives and the total disturbance",
    )

    @x.initial
    def start(z_start):
        return z_start


class TrackingDifferentiator(ContinuousTracker):
    """Han's tracking differentiator: dr1/dt = r2, dr2/dt = fhan(r1 - r, r2, R, h).

    r1 follows r with the acceleration R at most and r2 is its derivative. The forms:

    fhan: time-optimal with steps of h; its linear zone gives a double pole at -1/h. With

            d = R h, y = x1 + h x2, a0 = sqrt(d^2 + 8 R |y|)
            a = x2 + (a0 - d)/2 sgn y if |y| > d h, else x2 + y/h
            fhan(x1, x2, R, h) = -R sgn a if |a| > d, else -R a/d

    sign: the limit h = 0, dr2/dt = -R sgn(r1 - r + r2 |r2|/(2 R)). It chatters, and an adaptive solver does not get
        through it in reasonable time: use a method with a fixed step.

    References: J. Han, From PID to Active Disturbance Rejection Control, IEEE TIE 56(3), 2009, section III.A. R is the
        paper's; h is assumed.
    """

    form = Parameter("fhan", structural=True, choices=("fhan", "sign"), doc="fhan: smooth near its aim; sign: chatters")
    unit = Tracker.unit
    R = Parameter(100.0, unit=unit / "s2", positive=True, doc="largest acceleration")
    h = Parameter(1e-3, unit="s", positive=True, doc="step of fhan; not used by the form sign")

    @local(doc="distance to the aim, from which the acceleration follows")
    def distance(r1, r):
        return r1 - r

    @ContinuousTracker.r2.derivative
    def dr2(distance, r2, R, h, form):
        if form == "sign":
            return -R * np.sign(distance + r2 * np.abs(r2) / (2.0 * R))
        return fhan(distance, r2, R, h)


class INTD(ImprovedTracker, ContinuousTracker, ImprovedTracking):
    """Improved nonlinear tracking differentiator, eq. (1): dr1/dt = r2, dr2/dt = -R^2 tanh(s/gamma) - R r2.

    The forms:

    unit: s = beta (r1 - r). r1 settles at r: the DC gain is 1. The paper's tables follow from this form; alpha
        has no effect.
    literal: s = beta r1 - (1 - alpha) r, as eq. (1) is printed. r1 settles at (1 - alpha)/beta r: with the paper's
        values the DC gain is 0.2334.
    """

    @ImprovedTracking.s
    def s(r1, r, alpha, beta, form):
        return aim(r1, r, alpha, beta, form)

    pull = ImprovedTracking.pull

    @ContinuousTracker.r2.derivative
    def dr2(pull, r2, R):
        return -(R**2) * pull - R * r2


class NLSEF(StateFeedback):
    """Nonlinear state error feedback: u = sum of gains_i fal(e_i, alpha_i, delta_i) - z_{n+1}/b0, e_i = r_i - z_i.

        fal(e, a, d) = |e|^a sgn e if |e| > d, else e/d^(1 - a)

    The paper prints alpha and delta for order 2; gains of 1 and the nominal b0 of its motor are assumed.

    References: J. Han, From PID to Active Disturbance Rejection Control, IEEE TIE 56(3), 2009, section III.B.
    """

    gains = Parameter(1.0, shape=each_error, doc="gain of each error")
    alpha = Parameter(
        lambda order: of_paper(order, [0.1726, 0.8730]),
        shape=each_error,
        positive=True,
        doc="exponent of each error",
    )
    delta = Parameter(
        lambda order: of_paper(order, [0.4620, 0.24807]),
        shape=each_error,
        unit=error_units,
        positive=True,
        doc="size of each error up to which its law is linear",
    )
    b0 = StateFeedback.b0

    @local(doc="fal of each error")
    def law(e, alpha, delta):
        return fal(e, alpha, delta)

    @local(unit=StateFeedback.unit_u, doc="control without compensation")
    def u0(law, gains):
        return gains @ law

    @output(unit=StateFeedback.unit_u, doc="control")
    def u(u0, z, b0, order):
        return u0 - z[order] / b0


class INLSEF(StateFeedback, ImprovedFeedback):
    """Improved nonlinear state error feedback, eqs. (2)-(4): u = delta tanh(v/delta) - z_{n+1}/b0, e_i = r_i - z_i.

        v = sum of k_i(e_i) |e_i|^alpha_i sgn e_i + k_integral(I) |I|^alpha_integral sgn I,   dI/dt = e_1
        k_i(e) = k1_i + k2_i/(1 + exp(mu_i e^2)),   k_integral(I) = k3/(1 + exp(mu_integral I^2))

    The paper's k_i1, k_i2, mu_i, alpha_i of order 2 are the defaults; its k3, mu_3, alpha_3 are the defaults of the
    integral. The paper gives these three and delta, but no equation with them: the law of the integral and tanh are
    assumed, and so is the b0 of its motor. The factor 1/(1 + exp(m e^2)) is computed as (1 - tanh(m e^2/2))/2, which
    does not overflow. If alpha_i < 1 the law has an infinite slope at e_i = 0.
    """

    b0 = StateFeedback.b0
    I = State(unit=StateFeedback.unit * "s", output=True, doc="integral of the first error")

    @I.derivative
    def dI(e):
        return e[0]

    law, integral_law = ImprovedFeedback.law, ImprovedFeedback.integral_law
    v, u0 = ImprovedFeedback.v, ImprovedFeedback.u0

    @output(unit=StateFeedback.unit_u, doc="control")
    def u(u0, z, b0, order):
        return u0 - z[order] / b0


class LSEF(StateFeedback):
    """Linear state error feedback: u = (sum of gains_i (r_i - z_i) - z_{n+1})/b0.

    Give `gains`, or `bandwidth`, which puts all n poles of a plant y^(n) = f + b0 u at -bandwidth if the estimates are
    right: gains_i is the binomial coefficient (n over i - 1) times bandwidth^(n - i + 1). The wanted output and its
    derivatives are 0 if they are not wired.

    References: Z. Gao, Scaling and Bandwidth-Parameterization Based Controller Tuning, ACC 2003.
    """

    bandwidth = Parameter(None, unit="rad/s", excludes="gains", positive=True, doc="where the poles lie")
    gains = Parameter(
        lambda order, bandwidth: feedback_gains(order, bandwidth),
        shape=each_error,
        unit=lambda order: rates("1/s", order)[::-1],
        doc="gain of each error",
    )
    b0 = Parameter(1.0, unit=b0_unit, doc="gain of the control in the plant")
    r = Input(0.0, shape=each_error, ports="r{}", unit=error_units, doc="wanted output and its derivatives")
    z = StateFeedback.z

    @output(unit=StateFeedback.unit_u, doc="control")
    def u(e, z, gains, b0, order):
        return (gains @ e - z[order]) / b0


class LESO(ContinuousObserver):
    """Linear extended state observer: dz_i/dt = z_{i+1} + gains_i e, dz_n/dt = z_{n+1} + b0 u + gains_n e, e = y - z1.

    dz_{n+1}/dt = gains_{n+1} e. Give `gains`, or `bandwidth`, which puts all n + 1 poles at -bandwidth: gains_i is the
    binomial coefficient (n + 1 over i) times bandwidth^i. The default is the paper's gains of order 2. The b0 of the
    paper's motor is assumed.

    References: Z. Gao, Scaling and Bandwidth-Parameterization Based Controller Tuning, ACC 2003.
    """

    bandwidth = Parameter(None, unit="rad/s", excludes="gains", positive=True, doc="where the poles lie")
    gains = Parameter(
        lambda order, bandwidth: observer_gains(order, bandwidth, [30.4, 523.4, 2970.8]),
        shape=each_estimate,
        unit=lambda order: rates("1/s", order + 1),
        doc="gain of the error in each derivative",
    )
    b0 = Observer.b0

    @ContinuousObserver.z.derivative
    def dz(z, u, e, b0, gains, order):
        return chain(z, u, b0, order) + gains * e


class SMESO(ContinuousObserver, SlidingLaw):
    """Sliding mode extended state observer, eqs. (5)-(6): a LESO whose error goes through g.

        dz_i/dt = z_{i+1} + gains_i g(e),   dz_n/dt = z_{n+1} + b0 u + gains_n g(e),   dz_{n+1}/dt = gains_{n+1} g(e)
        g(e) = Ka |e|^alpha sgn e + Kb |e|^beta e,   e = y - z1

    Give `gains`, or `bandwidth`, which makes them those of a LESO with all poles at -bandwidth. The default is the
    paper's gains of order 2. If alpha < 1, g has an infinite slope at e = 0. The b0 of the paper's motor is assumed.
    """

    b0 = Observer.b0

    @ContinuousObserver.z.derivative
    def dz(z, u, g, b0, gains, order):
        return chain(z, u, b0, order) + gains * g


class NESO(NonlinearObserver):
    """Nonlinear extended state observer: a LESO whose error goes through fal, with an exponent for each estimate.

        dz_i/dt = z_{i+1} + gains_i fal_i,   fal_i = fal(e, alpha_i, delta),   e = y - z1
        dz_n/dt = z_{n+1} + b0 u + gains_n fal_n,   dz_{n+1}/dt = gains_{n+1} fal_{n+1}
        fal(e, a, d) = |e|^a sgn e if |e| > d, else e/d^(1 - a)

    With exponents below 1 the gain falls as the error grows: a fast observer overshoots less if it starts far off. The
    default exponents are 1, 1/2, 1/4, ... Give `gains`, or `bandwidth`, which makes gains_i the binomial coefficient
    (n + 1 over i) times bandwidth^i delta^(1 - alpha_i): if |e| <= delta, this is the LESO with all poles at
    -bandwidth. The instants at which |e| passes delta are located.

    References: J. Han, From PID to Active Disturbance Rejection Control, IEEE TIE 56(3), 2009.
    """

    alpha = Parameter(
        lambda order: [0.5**k for k in range(order + 1)],
        shape=each_estimate,
        positive=True,
        doc="exponent of the error in each derivative",
    )
    delta = Parameter(0.01, unit=Observer.unit, positive=True, doc="size of the error up to which its laws are linear")
    bandwidth = Parameter(None, unit="rad/s", excludes="gains", positive=True, doc="where the poles lie within delta")
    gains = Parameter(
        lambda order, bandwidth, alpha, delta: linear_gains(order, bandwidth) * delta ** (1.0 - alpha),
        shape=each_estimate,
        doc="gain of each law",
    )
    b0 = NonlinearObserver.b0

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

    dz = NonlinearObserver.dz


class DiscreteESO(SampledObserver):
    """Linear extended state observer in sampled time: from y(k) and u(k) at tick k estimates z(k), held in between.

    With e(k) = y(k) - x1(k), and A, B of y^(n) = f + b0 u over one period in which f and u are constant:

    euler: z(k) = x(k), x(k+1) = A z(k) + B u(k) + gains e(k), with A and B of one Euler step: the LESO in Euler steps.
        `bandwidth` puts the poles at 1 - bandwidth period.
    zoh: the same with the exact A and B; `bandwidth` puts the poles at exp(-bandwidth period).
    current: z(k) = x(k) + gains e(k), x(k+1) = A z(k) + B u(k), with the exact A and B; `bandwidth` puts the poles at
        exp(-bandwidth period). The measurement of a tick counts at that tick; in the other two it counts at the next.

    Give `gains` or `bandwidth`. u(k) is the control at the tick, which may depend on z(k); it should be constant up to
    the next tick, as it is after a feedback of z and of a constant reference. Before the first tick z is z_start.

    References: R. Miklosovic, A. Radke, Z. Gao, Discrete Implementation and Generalization of the Extended State
        Observer, ACC 2006. G. F. Franklin, J. D. Powell, M. L. Workman, Digital Control of Dynamic Systems, 3rd ed.,
        Addison-Wesley 1998, section 8.2.
    """

    bandwidth = Parameter(
        None, unit="rad/s", excludes="gains", positive=True, doc="where the poles lie, for a short period"
    )
    gains = Parameter(
        lambda order, bandwidth, period, form: sampled_gains(order, bandwidth, period, form),
        shape=each_estimate,
        unit=lambda order: rates("1", order + 1),
        doc="gain of the error in each estimate, at each tick",
    )
    b0 = Parameter(1.0, unit=b0_unit, doc="gain of the control in the plant")
    z_start = SampledObserver.z_start

    @requires("bandwidth times period must be below 2, or the Euler steps are unstable")
    def is_stable(form, bandwidth, period):
        return form != "euler" or bandwidth is None or bandwidth * period < 2

    @SampledObserver.z
    def z(x, y, gains, form):
        return x + gains * (y - x[0]) if form == "current" else x

    @SampledObserver.x.next(every=Ticks.period, offset=Ticks.offset)
    def predict(x, y, u, gains, b0, period, order, form):
        corrected = gains * (y - x[0])
        if form == "current":
            return after_period(period, x + corrected, u, b0, order, form)
        return after_period(period, x, u, b0, order, form) + corrected


class DiscreteINTD(ImprovedTracker, Ticks, ImprovedTracking):
    """INTD in sampled time: r1(k+1) = r1(k) + T r2(k), r2(k+1) = r2(k) - T (R^2 tanh(s(k)/gamma) + R r2(k)).

    T is the period, s and the forms are those of INTD. These are Euler steps, as Han takes them for his differentiator:
    r1 and r2 of a tick follow from r at the ticks before it. They settle if R T < 2 and beta R T < gamma: with the
    paper's values, up to T = 0.119 s. Before the first tick r1 and r2 are r1_start and r2_start.

    References: J. Han, From PID to Active Disturbance Rejection Control, IEEE TIE 56(3), 2009, section III.A.
    """

    r1_start = Parameter(0.0, unit=Tracker.unit, doc="r1 at the start")
    r2_start = Parameter(0.0, unit=Tracker.unit / "s", doc="r2 at the start")
    x1 = Discrete(unit=Tracker.unit, doc="r1 of the next tick")
    x2 = Discrete(unit=Tracker.unit / "s", doc="r2 of the next tick")

    @x1.initial
    def start1(r1_start):
        return r1_start

    @x2.initial
    def start2(r2_start):
        return r2_start

    @output(unit=Tracker.unit, every=Ticks.period, offset=Ticks.offset, start=r1_start, doc="followed signal")
    def r1(x1):
        return x1

    @output(unit=Tracker.unit / "s", every=Ticks.period, offset=Ticks.offset, start=r2_start, doc="its derivative")
    def r2(x2):
        return x2

    @x1.next(every=Ticks.period, offset=Ticks.offset)
    def step1(x1, x2, period):
        return x1 + period * x2

    @ImprovedTracking.s
    def s(x1, r, alpha, beta, form):
        return aim(x1, r, alpha, beta, form)

    pull = ImprovedTracking.pull

    @x2.next(every=Ticks.period, offset=Ticks.offset)
    def step2(x2, pull, R, period):
        return x2 + period * (-(R**2) * pull - R * x2)


class DiscreteINLSEF(StateFeedback, Ticks, ImprovedFeedback):
    """INLSEF in sampled time: its u at each tick, held in between; I(k+1) = I(k) + period e_1(k).

    The laws and the defaults are those of INLSEF. The integral is a sum by forward differences, so its value at a tick
    follows from the errors at the ticks before it. Before the first tick u is u_start.
    """

    b0 = StateFeedback.b0
    u_start = Parameter(0.0, unit=StateFeedback.unit_u, doc="control before the first tick")
    I = Discrete(unit=StateFeedback.unit * "s", doc="integral of the first error")

    @output(unit=StateFeedback.unit_u, every=Ticks.period, offset=Ticks.offset, start=u_start, doc="control")
    def u(u0, z, b0, order):
        return u0 - z[order] / b0

    @I.next(every=Ticks.period, offset=Ticks.offset)
    def integrate(I, e, period):
        return I + period * e[0]


class DiscreteSMESO(SampledObserver, SlidingLaw):
    """SMESO in sampled time: a DiscreteESO whose error goes through g, with the gains of the SMESO times the period T.

    With g of SMESO and e(k) = y(k) - x1(k), and A, B of y^(n) = f + b0 u over one period in which f and u are constant:

    euler: z(k) = x(k), x(k+1) = A z(k) + B u(k) + T gains g(e(k)), with A and B of one Euler step: the SMESO in Euler
        steps. The measurement of a tick counts at the next one.
    zoh: the same with the exact A and B.
    current: z(k) = x(k) + T gains g(e(k)), x(k+1) = A z(k) + B u(k), with the exact A and B. The measurement of a tick
        counts at that tick: a period less of delay in the loop, for which [4] recommends it.

    `gains`, `bandwidth` and their defaults are those of SMESO: the period must be short against 1/bandwidth. If
    alpha < 1, g has an infinite slope at e = 0, and e does not settle there: in the end it changes its sign at each
    tick, with |e| near (T gains_1 Ka/2)^(1/(1 - alpha)) for a short T. With the paper's values this is 1e-13 of the
    unit of y at 1 ms, and 1e-11 at 2 ms. u(k) may depend on z(k), and should be constant up to the next tick. Before
    the first tick z is z_start.

    References: R. Miklosovic, A. Radke, Z. Gao, Discrete Implementation and Generalization of the Extended State
        Observer, ACC 2006, for a linear observer; that its forms are used with g is an assumption. J. Han, From PID to
        Active Disturbance Rejection Control, IEEE TIE 56(3), 2009, has Euler steps of a nonlinear one.
    """

    b0 = Observer.b0
    z_start = SampledObserver.z_start

    @local(unit=Observer.unit, doc="error of the estimate")
    def e(y, x):
        return y - x[0]

    g = SlidingLaw.g

    @SampledObserver.z
    def z(x, g, gains, period, form):
        return x + period * gains * g if form == "current" else x

    @SampledObserver.x.next(every=Ticks.period, offset=Ticks.offset)
    def predict(z, u, g, gains, b0, period, order, form):
        after = after_period(period, z, u, b0, order, form)
        return after if form == "current" else after + period * gains * g
