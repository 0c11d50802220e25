"""PID controllers: continuous, and sampled for use by hand too."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, local, output, requires
from ..contract.variables import UNLIMITED, Discrete, Input, Parameter, State

__all__ = ["PID", "DiscretePID"]


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
    """u = sat(kp (b r - y) + integral + kd s/(Tf s + 1) (c r - y)): r is wanted, y is measured.

        v = kp (b r - y) + integral + kd (c r - y - smoothed)/Tf,   u = v within lower ... upper, else the limit
        d integral/dt = ki (r - y) + (u - v)/Tt       0 if ki = 0
        d smoothed/dt = (c r - y - smoothed)/Tf

    Anti-windup is by back-calculation. b and c weight r: with c = 0 the derivative acts on the measurement only, so a
    step of r gives no kick; with c = 1 the step passes through kd/Tf. smoothed begins at smoothed_start, which is 0 by
    default, so a y which begins elsewhere is a jump to the derivative.

    Tf defaults to kd/kp/10 and Tt to the integral time kp/ki (1 s if that is not a time). Without given limits u is
    unlimited.

    While `manual` is above 0, u is u_manual within the limits, and the integral approaches the value that makes v = u,
    with the time constant Tt: the controller then takes over without a bump. With ki = 0 the integral stays at u_start.

    DiscretePID is the same at ticks, with the same names.

    References: K. J. Åström, T. Hägglund, Advanced PID Control, ISA 2006, sections 3.4 and 3.5.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of r and y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    kp = Parameter(1.0, unit=unit_u / unit, doc="proportional gain")
    ki = Parameter(0.0, unit=unit_u / unit / "s", doc="integral gain")
    kd = Parameter(0.0, unit=unit_u / unit * "s", doc="derivative gain")
    b = Parameter(1.0, doc="weight of r in the proportional part")
    c = Parameter(0.0, doc="weight of r in the derivative part")
    Tf = Parameter(_filter_time, unit="s", positive=True, doc="time constant of the derivative's filter")
    Tt = Parameter(_tracking_time, unit="s", positive=True, doc="tracking time of the anti-windup")
    lower = Parameter(-UNLIMITED, unit=unit_u, is_limit=True, doc="smallest u")
    upper = Parameter(UNLIMITED, unit=unit_u, is_limit=True, doc="largest u")
    u_start = Parameter(0.0, unit=unit_u, doc="integral part at the start")
    r = Input(unit=unit, doc="wanted value")
    y = Input(unit=unit, doc="measured value")
    manual = Input(0.0, doc="above 0: u is u_manual")
    u_manual = Input(0.0, unit=unit_u, doc="control by hand")
    integral = State(unit=unit_u, doc="integral part of u")
    smoothed = State(unit=unit, doc="filtered c r - y, from which the derivative is taken")

    @requires("lower must be below upper")
    def is_ordered(lower, upper):
        return lower < upper

    @local(unit=unit_u, doc="control before its limits, from the equations")
    def v(r, y, integral, smoothed, kp, kd, b, c, Tf):
        return kp * (b * r - y) + integral + kd * (c * r - y - smoothed) / Tf

    # A manual of 0 is automatic, and no side changes while it is not wired.
    @crossing
    def by_hand(manual):
        return np.where(manual > 0.0, manual, -UNLIMITED)

    @local(unit=unit_u, doc="control before its limits, from the equations or by hand")
    def asked(v, by_hand, u_manual):
        return np.where(by_hand, u_manual, v)

    @crossing
    def above(asked, upper):
        return asked - upper

    @crossing
    def below(asked, lower):
        return lower - asked

    @output(unit=unit_u, doc="control")
    def u(asked, above, below, lower, upper):
        return np.where(above, upper, np.where(below, lower, asked))

    @integral.initial
    def bias(u_start):
        return u_start

    @integral.derivative
    def dintegral(r, y, v, u, by_hand, ki, Tt):
        # Without an integral part, back-calculation would make one.
        return np.where(ki == 0.0, 0.0, np.where(by_hand, 0.0, ki * (r - y)) + (u - v) / Tt)

    @smoothed.derivative
    def dsmoothed(r, y, smoothed, c, Tf):
        return (c * r - y - smoothed) / Tf


def _pull(kp, ki, period):
    """The integral time, but a period at least, so that no more than what a limit cuts off is taken back."""
    return max(_tracking_time(kp, ki), period)


def _slope(old, new, last, begun, kd, Tf, period):
    """The derivative part by backward differences; the first one is taken as 0."""
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
    differences, which are stable for every Tf from 0 on. b and c weight r: with c = 0 the derivative acts on the
    measurement only, so a step of r gives no kick; with b = c = 1 all parts act on the error.

    Tf defaults to kd/kp/10 and Tt to the integral time kp/ki (1 s if that is not a time), but not below the period.
    Without given limits u is unlimited.

    While `manual` is above 0, u is u_manual within the limits, and the integral follows, so the controller then takes
    over without a bump. The integral contains its gain: a change of ki does not make u jump. The first slope is 0 for
    every y. With ki = 0 the integral stays at u_start, because nothing would ever undo its changes.

    References: K. J. Åström, B. Wittenmark, Computer-Controlled Systems, 3rd edition, Prentice-Hall 1997, section 8.5.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of r and y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    kp = Parameter(1.0, unit=unit_u / unit, doc="proportional gain")
    ki = Parameter(0.0, unit=unit_u / unit / "s", doc="integral gain")
    kd = Parameter(0.0, unit=unit_u / unit * "s", doc="derivative gain")
    b = Parameter(1.0, doc="weight of r in the proportional part")
    c = Parameter(0.0, doc="weight of r in the derivative part")
    Tf = Parameter(_filter_time, unit="s", min=0.0, doc="time constant of the derivative's filter")
    Tt = Parameter(_pull, unit="s", positive=True, doc="tracking time of the anti-windup")
    lower = Parameter(-UNLIMITED, unit=unit_u, is_limit=True, doc="smallest u")
    upper = Parameter(UNLIMITED, unit=unit_u, is_limit=True, doc="largest u")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    u_start = Parameter(0.0, unit=unit_u, doc="integral part at the first tick, and u before it")
    r = Input(unit=unit, doc="wanted value")
    y = Input(unit=unit, doc="measured value")
    manual = Input(0.0, doc="above 0: u is u_manual")
    u_manual = Input(0.0, unit=unit_u, doc="control by hand")
    integral = Discrete(unit=unit_u, doc="integral part of u")
    slope = Discrete(unit=unit_u, doc="derivative part of u at the last tick")
    last = Discrete(unit=unit, doc="c r - y at the last tick")
    begun = Discrete(type="bool", doc="whether there was a tick")

    @requires("lower must be below upper")
    def is_ordered(lower, upper):
        return lower < upper

    @requires("Tt must not be below the period")
    def is_tracking(Tt, period):
        return Tt >= period

    @output(unit=unit_u, every=period, offset=offset, start=u_start, doc="control")
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
