"""Active disturbance rejection control: units, gains and laws, as functions. The references are those of `adrc`."""

import math

import numpy as np

from ..text import units


def rates(unit, count):
    """Units of a signal and of its first derivatives: unit, unit/s, unit/s2, ..."""
    return [unit, *(units.quotient(unit, f"s{k}") for k in range(1, count))]


def each_error(order):
    return order


def each_estimate(order):
    return order + 1


def error_units(unit, order):
    return rates(unit, order)


def estimate_units(unit, order):
    return rates(unit, order + 1)


def b0_unit(unit, unit_u, order):
    return units.quotient(units.quotient(unit, f"s{order}"), unit_u)


def of_paper(order, values):
    """The paper's values, one for each error, which exist for order 2."""
    if order != len(values):
        raise ValueError(f"the paper's values are for order {len(values)}; give others for order {order}")
    return values


def observer_gains(order, bandwidth, values):
    """All poles of a linear observer at -bandwidth [3], or the paper's gains."""
    if bandwidth is None:
        if order + 1 != len(values):
            known = len(values) - 1
            raise ValueError(f"the paper's gains are for order {known}; give gains or bandwidth for order {order}")
        return values
    return linear_gains(order, bandwidth)


def linear_gains(order, bandwidth):
    """Gains of a linear observer with all poles at -bandwidth [3]."""
    if bandwidth is None:
        raise ValueError("give gains or bandwidth")
    return [math.comb(order + 1, k) * float(bandwidth) ** k for k in range(1, order + 2)]


def binomial_gains(count, bandwidth):
    """The coefficients of (s + bandwidth)^count, without the first: of a bandwidth that may be a signal."""
    return np.stack([math.comb(count, k) * bandwidth**k for k in range(1, count + 1)])


def powers(matrix, size):
    """The first `size` powers: 1, matrix, matrix^2, ..."""
    matrices = [np.eye(size)]
    for _ in range(size - 1):
        matrices.append(matrices[-1] @ matrix)
    return matrices


def sampled_gains(order, bandwidth, period, form):
    """Gains of a sampled observer: its poles at exp(-bandwidth period), or those of the LESO's Euler steps.

    In the coordinates (z1, its forward difference, its second difference, ...) the model z(k+1) = A z(k) is a chain
    again, as A - 1 is nilpotent; there the gains are binomial coefficients times powers of 1 - exp(-bandwidth
    period), in which nothing cancels however short the period is.
    """
    if bandwidth is None:
        raise ValueError("give gains or bandwidth")
    n = order + 1
    if form == "euler":
        return [period * gain for gain in linear_gains(order, bandwidth)]
    # In steps of one period, so that the matrices hold numbers only.
    shifts = powers(np.eye(n, k=1), n)
    model = sum(shift / math.factorial(k) for k, shift in enumerate(shifts))
    differences = np.array([power[0] for power in powers(model - np.eye(n), n)])
    decay = -math.expm1(-float(bandwidth) * float(period))
    gains = np.linalg.solve(differences, [math.comb(n, k) * decay**k for k in range(1, n + 1)])
    if form == "current":
        gains = np.linalg.solve(model, gains)
    return gains / float(period) ** np.arange(n)


def feedback_gains(order, bandwidth):
    """Gains that put all poles of the compensated plant at -bandwidth [3]."""
    if bandwidth is None:
        raise ValueError("give gains or bandwidth")
    return [math.comb(order, k) * float(bandwidth) ** (order - k) for k in range(order)]


def signed_power(e, a):
    """|e|^a sgn e"""
    return np.abs(e) ** a * np.sign(e)


def bell(m, e):
    """1/(1 + exp(m e^2)), written so that it does not overflow."""
    return 0.5 * (1.0 - np.tanh(0.5 * m * e**2))


def fal(e, a, delta):
    """|e|^a sgn e beyond delta, a straight line within."""
    # The power is held at its value at delta within the line, where its slope would be infinite.
    return np.where(np.abs(e) > delta, np.maximum(np.abs(e), delta) ** a * np.sign(e), e / delta ** (1.0 - a))


def aim(r1, r, alpha, beta, form):
    """s of the INTD."""
    return beta * r1 - (1.0 - alpha) * r if form == "literal" else beta * (r1 - r)


def fhan(x1, x2, r, h):
    """Han's time-optimal acceleration with steps of h: bang-bang far from the origin, linear near it [2]."""
    d = r * h
    y = x1 + h * x2
    a0 = np.sqrt(d**2 + 8.0 * r * np.abs(y))
    a = np.where(np.abs(y) > d * h, x2 + 0.5 * (a0 - d) * np.sign(y), x2 + y / h)
    return -np.where(np.abs(a) > d, r * np.sign(a), r * a / d)


def chain(z, u, b0, order):
    """z2, ..., z_{n+1}, 0, with b0 u where the n-th derivative stands."""
    control = np.zeros(order + 1)
    control[order - 1] = 1.0
    return np.concatenate([z[1:], np.zeros(1)]) + control * (b0 * u)


def after_period(period, z, u, b0, order, form):
    """z after a period in which u and the total disturbance are constant; by one Euler step in that form."""
    term = period * chain(z, u, b0, order)
    z_next = z + term
    for k in range(2, 2 if form == "euler" else order + 2):
        term = np.concatenate([term[1:], np.zeros(1)]) * (period / k)
        z_next = z_next + term
    return z_next
