"""P1 and P2 with SciPy and equations by hand, restarted at the edges of the pulse. Fixed steps in plain Python."""

from itertools import pairwise

import numpy as np
import problem as p
from scipy.integrate import solve_ivp

kind, count, stop, path = p.arguments()


def rates(x, d):
    w, i, z1, z2, z3 = x
    u = np.minimum(np.maximum((144.0 * (1.0 - z1) - 25.0 * z2 - z3) / p.B0, -p.LIMIT), p.LIMIT)
    e = w - z1
    return np.array(
        [
            -0.3922 * w / p.J + 1.1882 * i / (p.J * p.N_GEAR) - d / (p.J * p.N_GEAR),
            -1.185 * p.N_GEAR * w / p.L - 0.1557 * i / p.L + u / p.L,
            z2 + 30.4 * e,
            z3 + p.B0 * u + 513.4 * e,
            1570.8 * e,
        ]
    )


def scalar_rates(x, d):
    w, i, z1, z2, z3 = x
    u = (144.0 * (1.0 - z1) - 25.0 * z2 - z3) / p.B0
    u = p.LIMIT if u > p.LIMIT else -p.LIMIT if u < -p.LIMIT else u
    e = w - z1
    return (
        -0.3922 * w / p.J + 1.1882 * i / (p.J * p.N_GEAR) - d / (p.J * p.N_GEAR),
        -1.185 * p.N_GEAR * w / p.L - 0.1557 * i / p.L + u / p.L,
        z2 + 30.4 * e,
        z3 + p.B0 * u + 513.4 * e,
        1570.8 * e,
    )


def parts():
    edges = [0.0, *(edge for edge in (p.ON, p.OFF) if edge < stop), stop]
    return [(a, b, p.PULSE if p.ON <= a < p.OFF else 0.0) for a, b in pairwise(edges)]


def adaptive(model):
    x, t, w = np.zeros(5), [], []
    for begin, end, d in parts():
        asked = np.arange(round(begin / p.EVERY), round(end / p.EVERY) + 1) / round(1 / p.EVERY)
        made = solve_ivp(
            lambda t, x, d=d: scalar_rates(x.tolist(), d),
            (begin, end), x, "RK45", np.clip(asked, begin, end), rtol=p.RTOL, atol=p.ATOL,
        )  # fmt: skip
        x = made.y[:, -1]
        t.append(made.t)
        w.append(made.y[0])
    return np.concatenate(t), np.concatenate(w)


def fixed(model):
    x, t, w, h = np.zeros((5, count)), [], [], p.STEP
    for k in range(round(stop / h)):
        if k % 10 == 0:
            t.append(k * h)
            w.append(x[0, 0])
        d = p.PULSE if p.ON <= k * h < p.OFF else 0.0
        k1 = rates(x, d)
        k2 = rates(x + h / 2 * k1, d)
        k3 = rates(x + h / 2 * k2, d)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rates(x + h * k3, d))
    return t, w


p.report(lambda: None, adaptive if kind == "adaptive" else fixed, path)
