"""More forms of linear active disturbance rejection control, with the ports of LESO and LSEF.

Each observer has the inputs y and u and the estimates z1 ... z_{n+1} of a LESO, so that one can take the place of
another. Error-based control needs no form of its own: give the observer and the feedback -b0, the observer the error
r - y as its y, and the feedback nothing as its r.

References:
    [1] R. Madonski, P. Herman, Survey on methods of increasing the efficiency of extended state disturbance observers,
        ISA Transactions 56, 2015.
    [2] K. Łakomy, R. Madonski, Cascade extended state observer for active disturbance rejection control applications
        under measurement noise, ISA Transactions 109, 2021.
    [3] Z. Gao, Scaling and Bandwidth-Parameterization Based Controller Tuning, American Control Conference 2003.
"""

import numpy as np

from ..contract.equations import local, output, requires
from ..contract.variables import Input, Parameter, State
from .adrc import ContinuousObserver, Observer, StateFeedback
from .adrc_laws import b0_unit, binomial_gains, chain, each_error, each_estimate, estimate_units, linear_gains, rates

__all__ = ["CascadeESO", "GeneralizedESO", "LinearObserver", "ReducedESO", "ScheduledESO", "ScheduledLSEF"]


class LinearObserver(Observer, abstract=True):
    """A linear observer whose states are not its estimates."""

    bandwidth = Parameter(None, unit="rad/s", excludes="gains", positive=True, doc="where the poles lie")
    b0 = Parameter(1.0, unit=b0_unit, doc="gain of the control in the plant")
    z = output(
        shape=each_estimate,
        ports="z{}",
        unit=estimate_units,
        doc="estimates of y, its derivatives and the total disturbance",
    )


def _size(order, extension, m):
    return order + extension + 2 * m


def _of_frequencies(frequencies, m):
    """The coefficients of the product of s^2 + w^2 over all w, from the highest power of s^2 down."""
    squares = [1.0]
    for k in range(m):
        w2 = frequencies[k] * frequencies[k]
        squares = [own + w2 * below for own, below in zip([*squares, 0.0], [0.0, *squares], strict=True)]
    return squares


def _generalized_gains(order, extension, m, frequencies, bandwidth):
    """Gains that put all poles at -bandwidth, for the model s^(n + extension) prod(s^2 + w^2)."""
    size = _size(order, extension, m)
    model = {2 * k: c for k, c in enumerate(_of_frequencies(frequencies, m)) if k}
    wanted, gains = linear_gains(size - 1, bandwidth), []
    for k in range(1, size + 1):
        gain = wanted[k - 1] - model.get(k, 0.0)
        for j in range(1, k):
            gain = gain - (model[k - j] * gains[j - 1] if k - j in model else 0.0)
        gains.append(gain)
    return np.stack(gains)


class GeneralizedESO(LinearObserver):
    """Generalized (GPI) extended state observer: a LESO with a model of how the total disturbance f changes.

        dx_i/dt = x_{i+1} + gains_i e,   dx_n/dt = x_{n+1} + b0 u + gains_n e,   e = y - x_1
        dx_N/dt = -c_1 d2/dt2 ... of f + gains_N e,   z_i = x_i for i = 1 ... n + 1

    f is x_{n+1} and its derivatives follow it. The model is d^extension/dt^extension of the product of d2/dt2 + w^2
    over all w in `frequencies`, applied to f, = 0: so f may be a polynomial in time of the degree extension - 1, plus
    an oscillation of each frequency, and is estimated without error in the long run. With extension = 1 and no
    frequencies it is the LESO.

    Give `gains`, one for each of the N = n + extension + 2 (count of frequencies) states, or `bandwidth`, which puts
    all N poles at -bandwidth. More states follow f better, and pass more noise.

    References: H. Sira-Ramírez, A. Luviano-Juárez, M. Ramírez-Neria, E. W. Zurita-Bustamante, Active Disturbance
        Rejection Control of Dynamic Systems, Butterworth-Heinemann 2017. R. Madonski, P. Herman, ISA Transactions 56,
        2015.
    """

    order, unit, unit_u = Observer.order, Observer.unit, Observer.unit_u
    extension = Parameter(2, structural=True, type="int", min=1, doc="derivative of f that is taken as 0")
    frequencies = Parameter([], shape="m", unit="rad/s", positive=True, doc="of oscillations in f")
    bandwidth = LinearObserver.bandwidth
    gains = Parameter(
        _generalized_gains,
        shape=_size,
        unit=lambda order, extension, m: rates("1/s", _size(order, extension, m)),
        doc="gain of the error in each derivative",
    )
    x = State(
        shape=_size,
        unit=lambda unit, order, extension, m: rates(unit, _size(order, extension, m)),
        doc="estimates of y, its derivatives, f and its derivatives",
    )

    @LinearObserver.z
    def z(x, order):
        return x[: order + 1]

    @local(unit=Observer.unit, doc="error of the estimate")
    def e(y, x):
        return y - x[0]

    @x.derivative
    def dx(x, e, u, b0, gains, frequencies, order, extension, m):
        size = _size(order, extension, m)
        control = np.zeros(size)
        control[order - 1] = 1.0
        last = 0.0
        for k, c in enumerate(_of_frequencies(frequencies, m)[1:], start=1):
            last = last - c * x[size - 2 * k]
        return np.concatenate([x[1:], np.reshape(last, (1,))]) + control * (b0 * u) + gains * e


class ReducedESO(LinearObserver):
    """Reduced-order extended state observer: a LESO that takes the measured y for z1, with one pole less.

        z_1 = y,   z_{i+1} = x_i + gains_i y
        dx_i/dt = dz_{i+1} - gains_i dz_1   with   dz_i = z_{i+1},   dz_n = z_{n+1} + b0 u,   dz_{n+1} = 0

    Less lag than a LESO of the same bandwidth, and no filter between the noise of y and the estimates. Give `gains`, or
    `bandwidth`, which puts all n poles at -bandwidth: gains_i is the binomial coefficient (n over i) times bandwidth^i.
    x begins at x_start, which is 0: z then begins at gains y.

    References: R. Madonski, P. Herman, ISA Transactions 56, 2015.
    """

    order, unit, unit_u = Observer.order, Observer.unit, Observer.unit_u
    bandwidth = LinearObserver.bandwidth
    gains = Parameter(
        lambda order, bandwidth: linear_gains(order - 1, bandwidth),
        shape=each_error,
        unit=lambda order: rates("1/s", order),
        doc="gain of y in each estimate",
    )
    b0 = LinearObserver.b0
    x = State(
        shape=each_error,
        unit=lambda unit, order: estimate_units(unit, order)[1:],
        doc="estimates, less gains y",
    )

    @LinearObserver.z
    def z(x, y, gains):
        return np.concatenate([np.reshape(y, (1,)), x + gains * y])

    @x.derivative
    def dx(z, u, b0, gains, order):
        change = chain(z, u, b0, order)
        return change[1:] - gains * change[0]


class CascadeESO(LinearObserver):
    """Cascade extended state observer: slow LESO first, each next one faster, fed by the estimate of the one before it.

        level 1: dx_1/dt = model(x_1, u) + gains_1 (y - x_1[0])
        level i: dx_i/dt = model(x_i, u + (f_1 + ... + f_{i-1})/b0) + gains_i (x_{i-1}[0] - x_i[0])
        z_1 ... z_n: those of the last level;   z_{n+1} = f_1 + ... + f_p,   f_i the last state of level i

    Only the slow first level sees the noise of y, so less of it reaches z than through a LESO as fast as the last
    level. The poles of level i lie at -bandwidth ratio^(i - 1). With levels = 1 it is the LESO.

    References: K. Łakomy, R. Madonski, Cascade extended state observer for active disturbance rejection control
        applications under measurement noise, ISA Transactions 109, 2021.
    """

    order, unit, unit_u = Observer.order, Observer.unit, Observer.unit_u
    levels = Parameter(2, structural=True, type="int", min=1, doc="count of observers in the cascade")
    ratio = Parameter(2.0, min=1.0, doc="how much faster each level is than the one before it")
    bandwidth = Parameter(unit="rad/s", positive=True, doc="where the poles of the first level lie")
    b0 = LinearObserver.b0
    x = State(
        shape=lambda order, levels: levels * (order + 1),
        unit=lambda unit, order, levels: estimate_units(unit, order) * levels,
        doc="estimates of the first level, then of the next ones",
    )

    @requires("b0 must not be 0")
    def has_b0(b0):
        return b0 != 0

    @LinearObserver.z
    def z(x, order, levels):
        each = np.reshape(x, (levels, order + 1))
        return np.concatenate([each[levels - 1, :order], np.reshape(np.sum(each[:, order]), (1,))])

    @x.derivative
    def dx(x, y, u, b0, bandwidth, ratio, order, levels):
        changes, seen, known = [], y, 0.0
        for level, z in enumerate(np.reshape(x, (levels, order + 1))):
            gains = binomial_gains(order + 1, bandwidth * ratio**level)
            changes.append(chain(z, u + known / b0, b0, order) + gains * (seen - z[0]))
            seen, known = z[0], known + z[order]
        return np.concatenate(changes)


class ScheduledESO(ContinuousObserver):
    """LESO whose bandwidth is an input: all n + 1 poles at -bandwidth where that is constant.

        dz_i/dt = z_{i+1} + c_i bandwidth^i e,   dz_n/dt = z_{n+1} + b0 u + c_n bandwidth^n e,   e = y - z1
        dz_{n+1}/dt = c_{n+1} bandwidth^(n+1) e,   c_i the binomial coefficient (n + 1 over i)

    A bandwidth that grows from a small value keeps the estimates from a peak at the start; one that follows the error
    is an adaptive observer.

    References: Z. Gao, Scaling and Bandwidth-Parameterization Based Controller Tuning, ACC 2003, for the gains.
    """

    order, unit, unit_u = Observer.order, Observer.unit, Observer.unit_u
    b0 = Parameter(1.0, unit=b0_unit, doc="gain of the control in the plant")
    bandwidth = Input(unit="rad/s", doc="where the poles lie")

    @ContinuousObserver.z.derivative
    def dz(z, u, e, bandwidth, b0, order):
        return chain(z, u, b0, order) + binomial_gains(order + 1, bandwidth) * e


class ScheduledLSEF(StateFeedback):
    """LSEF whose bandwidth is an input: u = (sum of c_i bandwidth^(n-i+1) (r_i - z_i) - z_{n+1})/b0.

    c_i is the binomial coefficient (n over i - 1), so that all n poles of the compensated plant lie at -bandwidth where
    that is constant. The wanted output and its derivatives are 0 if they are not wired.

    References: Z. Gao, Scaling and Bandwidth-Parameterization Based Controller Tuning, ACC 2003, for the gains.
    """

    order, unit, unit_u = StateFeedback.order, StateFeedback.unit, StateFeedback.unit_u
    b0 = Parameter(1.0, unit=b0_unit, doc="gain of the control in the plant")
    r = Input(0.0, shape=each_error, ports="r{}", unit=StateFeedback.r.unit, doc="wanted output and its derivatives")
    bandwidth = Input(unit="rad/s", doc="where the poles lie")

    @output(unit=StateFeedback.unit_u, doc="control")
    def u(e, z, bandwidth, b0, order):
        return (binomial_gains(order, bandwidth)[::-1] @ e - z[order]) / b0
