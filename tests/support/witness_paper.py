"""Independent witness of the mobile robot example: plain SciPy, written out by hand.

The complete closed loop of I. K. Ibraheem and W. R. Abdul-Adeem, "An Improved Active Disturbance Rejection Control for
a Differential Drive Mobile Robot with Mismatched Disturbances and Uncertainties", with both of its controllers (ADRC
and IADRC), as two right-hand sides on plain floats.  It shares no code with the package that it is compared to.

Every wheel has a tracking differentiator (``td``), a nonlinear state error feedback (``nlsef``; its integrator exists
only in the IADRC), an extended state observer (``eso``) and a motor.  Both wheels drive the robot (``robot``), and the
same kinematics driven at exactly 1 rad/s on both sides is the ``reference``.  All states are zero at t = 0 but the two
headings, pi/4.  A torque of 3 N.m acts on the right wheel for 25 <= t < 50; every run restarts exactly at 25 and 50.

Assumed, because the paper does not print them: the torque's size and its window, the heading, gains of 1 in the
classical NLSEF, b0 = b^ in both observers, and the step h = 1 ms of fhan.

``IADRC_NAMES`` and ``ADRC_NAMES`` give the order of the states.  ``python tests/support/witness_paper.py`` prints the
measures and some controls at rtol 1e-10, atol 1e-12.

On the solver.  The IADRC is smooth but for the powers |e|^a at e = 0; an explicit pair is right for it (LSODA and
Radau take minutes at such tolerances).  The ADRC has the double pole -1/h = -1000 1/s of fhan's linear zone, which
holds an explicit pair at steps of some milliseconds, and fhan and fal have corners.  DOP853 without a max_step
converges on both: its error control keeps the step at the edge of stability, and what remains there is of the size of
the tolerance.  Against rtol 1e-12 the measures move by less than 1e-7 (relative) at rtol 1e-9 and by less than 1e-8 at
rtol 1e-10; max_step = 1 ms, RK45, LSODA and Radau give the same within 5e-7.  For the ADRC ``method="LSODA"`` gives
8 digits in a tenth of the time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp  # type: ignore[import-untyped, unused-ignore]
from scipy.optimize import minimize_scalar  # type: ignore[import-untyped, unused-ignore]

# Motor and robot (printed in the paper)
RA, LA, KB, KT, N_GEAR, JEQ, BEQ = 0.1557, 0.82, 1.185, 1.1882, 3.0, 0.2752, 0.3922
D_TRACK, R_WHEEL = 0.40, 0.075
B_HAT = KT / (LA * JEQ * N_GEAR)

# IADRC (printed in the paper)
INTD_BETA, INTD_GAMMA, INTD_R = 2.1555, 11.9554, 16.8199
K11, K12, K21, K22, K3, DELTA = 144.6642, 8.0475, 25.5574, 4.8814, 0.5308, 3.8831
MU1, MU2, MU3 = 44.3160, 48.8179, 26.1493
ALPHA1, ALPHA2, ALPHA3 = 0.9675, 1.4487, 3.5032
K_ALPHA, SM_ALPHA, K_BETA, SM_BETA = 0.6265, 0.8433, 0.5878, 0.04078
SM_L1, SM_L2, SM_L3 = 30.4, 513.4, 1570.8

# ADRC (printed in the paper, but the step of fhan)
TD_R, TD_H = 100.0, 1e-3
FAL_A1, FAL_D1, FAL_A2, FAL_D2 = 0.1726, 0.4620, 0.8730, 0.24807
LE_L1, LE_L2, LE_L3 = 30.4, 523.4, 2970.8

# Run
R_SET, TORQUE, T_ON, T_OFF, T_END, HEADING = 1.0, 3.0, 25.0, 50.0, 100.0, math.pi / 4
SEGMENTS = ((0.0, T_ON, 0.0), (T_ON, T_OFF, TORQUE), (T_OFF, T_END, 0.0))

IADRC_NAMES = (
    "control_right.td.r1",
    "control_right.td.r2",
    "control_right.nlsef.I",
    "control_right.eso.z1",
    "control_right.eso.z2",
    "control_right.eso.z3",
    "motor_right.omega",
    "motor_right.i",
    "control_left.td.r1",
    "control_left.td.r2",
    "control_left.nlsef.I",
    "control_left.eso.z1",
    "control_left.eso.z2",
    "control_left.eso.z3",
    "motor_left.omega",
    "motor_left.i",
    "robot.x",
    "robot.y",
    "robot.theta",
    "reference.x",
    "reference.y",
    "reference.theta",
)
ADRC_NAMES = tuple(name for name in IADRC_NAMES if not name.endswith(".nlsef.I"))
NAMES = {"IADRC": IADRC_NAMES, "ADRC": ADRC_NAMES}

MEASURES = ("OPI_x", "OPI_y", "OPI_theta", "ITAE_right", "ISU_right", "ITAE_left", "ISU_left", "peak_e_theta")


CONVERGED: dict[str, dict[str, float]] = {
    "ADRC": {
        "OPI_x": 1.15321589e-3,
        "OPI_y": 1.65704697e-3,
        "OPI_theta": 5.49244605e-6,
        "ITAE_right": 7.35664656,
        "ISU_right": 1396.35956,
        "ITAE_left": 0.442883801,
        "ISU_left": 1367.47186,
        "peak_e_theta": 0.0103542694,
    },
    "IADRC": {
        "OPI_x": 5.25921644e-4,
        "OPI_y": 7.39645861e-4,
        "OPI_theta": 1.66938641e-6,
        "ITAE_right": 1.76855665,
        "ISU_right": 1407.37530,
        "ITAE_left": 0.145736867,
        "ISU_left": 1372.05350,
        "peak_e_theta": 3.30486137e-3,
    },
}
"""What ``measures`` converges to: its values at rtol 1e-12, atol 1e-14, to 9 digits."""


# ---------------------------------------------------------------------------------------------------------------------
# Functions of the controllers


def _power(e: float, a: float) -> float:
    """|e|^a sgn e"""
    return math.copysign(math.pow(abs(e), a), e)


def _fal(e: float, a: float, d: float) -> float:
    return _power(e, a) if abs(e) > d else e / math.pow(d, 1.0 - a)


def _fhan(x1: float, x2: float, r: float, h: float) -> float:
    d = r * h
    y = x1 + h * x2
    if abs(y) > d * h:
        a = x2 + math.copysign(0.5 * (math.sqrt(d * d + 8.0 * r * abs(y)) - d), y)
    else:
        a = x2 + y / h
    return -math.copysign(r, a) if abs(a) > d else -r * a / d


def _bell(m: float, e: float) -> float:
    """1 / (1 + exp(m e^2)) in a form that cannot overflow"""
    return 0.5 * (1.0 - math.tanh(0.5 * m * e * e))


def _inlsef_v(e1: float, e2: float, integral: float) -> float:
    """Improved feedback before its tanh"""
    return (
        (K11 + K12 * _bell(MU1, e1)) * _power(e1, ALPHA1)
        + (K21 + K22 * _bell(MU2, e2)) * _power(e2, ALPHA2)
        + K3 * _bell(MU3, integral) * _power(integral, ALPHA3)
    )


def _inlsef(e1: float, e2: float, integral: float) -> float:
    return DELTA * math.tanh(_inlsef_v(e1, e2, integral) / DELTA)


def _nlsef(e1: float, e2: float) -> float:
    return _fal(e1, FAL_A1, FAL_D1) + _fal(e2, FAL_A2, FAL_D2)


def _smeso_g(e: float) -> float:
    return K_ALPHA * _power(e, SM_ALPHA) + K_BETA * math.pow(abs(e), SM_BETA) * e


# ---------------------------------------------------------------------------------------------------------------------
# The two systems


def _iadrc_wheel(x: Sequence[float], torque: float) -> list[float]:
    """Derivatives of one wheel: td.r1, td.r2, nlsef.I, eso.z1, eso.z2, eso.z3, motor.omega, motor.i"""
    r1, r2, integral, z1, z2, z3, omega, current = x
    e1 = r1 - z1
    u = _inlsef(e1, r2 - z2, integral) - z3 / B_HAT
    g = _smeso_g(omega - z1)
    return [
        r2,
        -INTD_R * INTD_R * math.tanh(INTD_BETA * (r1 - R_SET) / INTD_GAMMA) - INTD_R * r2,
        e1,
        z2 + SM_L1 * g,
        z3 + B_HAT * u + SM_L2 * g,
        SM_L3 * g,
        (-BEQ * N_GEAR * omega + KT * current - torque / N_GEAR) / (JEQ * N_GEAR),
        (-KB * N_GEAR * omega - RA * current + u) / LA,
    ]


def _adrc_wheel(x: Sequence[float], torque: float) -> list[float]:
    """Derivatives of one wheel: td.r1, td.r2, eso.z1, eso.z2, eso.z3, motor.omega, motor.i"""
    r1, r2, z1, z2, z3, omega, current = x
    u = _nlsef(r1 - z1, r2 - z2) - z3 / B_HAT
    g = omega - z1
    return [
        r2,
        _fhan(r1 - R_SET, r2, TD_R, TD_H),
        z2 + LE_L1 * g,
        z3 + B_HAT * u + LE_L2 * g,
        LE_L3 * g,
        (-BEQ * N_GEAR * omega + KT * current - torque / N_GEAR) / (JEQ * N_GEAR),
        (-KB * N_GEAR * omega - RA * current + u) / LA,
    ]


def _pose(right: float, left: float, theta: float) -> list[float]:
    """Derivatives of x, y, theta for the two wheel speeds"""
    v = 0.5 * R_WHEEL * (right + left)
    return [v * math.cos(theta), v * math.sin(theta), R_WHEEL * (right - left) / D_TRACK]


def iadrc_rhs(t: float, x: Sequence[float], torque: float) -> list[float]:
    """Derivatives of the 22 states of ``IADRC_NAMES``; torque is that on the right wheel, in N.m."""
    return (
        _iadrc_wheel(x[0:8], torque)
        + _iadrc_wheel(x[8:16], 0.0)
        + _pose(x[6], x[14], x[18])
        + _pose(R_SET, R_SET, x[21])
    )


def adrc_rhs(t: float, x: Sequence[float], torque: float) -> list[float]:
    """Derivatives of the 20 states of ``ADRC_NAMES``; torque is that on the right wheel, in N.m."""
    return (
        _adrc_wheel(x[0:7], torque) + _adrc_wheel(x[7:14], 0.0) + _pose(x[5], x[12], x[16]) + _pose(R_SET, R_SET, x[19])
    )


RHS: dict[str, Callable[[float, Sequence[float], float], list[float]]] = {"IADRC": iadrc_rhs, "ADRC": adrc_rhs}


def initial_state(which: str) -> list[float]:
    """The state at t = 0: zero but for the two headings."""
    return [HEADING if name.endswith(".theta") else 0.0 for name in NAMES[which]]


def torque_at(t: float) -> float:
    """The torque on the right wheel: 3 N.m for 25 <= t < 50."""
    return TORQUE if T_ON <= t < T_OFF else 0.0


# ---------------------------------------------------------------------------------------------------------------------
# Signals


def signals(name: str, t: float, x: Sequence[float]) -> float:
    """The value of a state or of an algebraic signal at time t and state x (ADRC or IADRC by the length of x).

    Signals: ``control_SIDE.`` u, nlsef.e1, nlsef.e2, nlsef.u0, nlsef.v (IADRC only), eso.g, eso.disturbance (z3/b^, in
    volt); ``motor_SIDE.`` u, torque, omega_dot; ``error.`` x, y, theta (reference less robot).
    """
    which = "IADRC" if len(x) == len(IADRC_NAMES) else "ADRC"
    names = NAMES[which]
    if len(x) != len(names):
        raise ValueError(f"a state of {len(x)} numbers is neither that of the IADRC nor that of the ADRC")
    state = dict(zip(names, (float(value) for value in x), strict=True))
    if name in state:
        return state[name]
    block, _, signal = name.partition(".")
    if block == "error" and signal in ("x", "y", "theta"):
        return state[f"reference.{signal}"] - state[f"robot.{signal}"]
    kind, _, side = block.partition("_")
    if kind in ("control", "motor") and side in ("right", "left"):
        control, motor = f"control_{side}", f"motor_{side}"
        z3, omega, current = state[f"{control}.eso.z3"], state[f"{motor}.omega"], state[f"{motor}.i"]
        e1 = state[f"{control}.td.r1"] - state[f"{control}.eso.z1"]
        e2 = state[f"{control}.td.r2"] - state[f"{control}.eso.z2"]
        innovation = omega - state[f"{control}.eso.z1"]
        torque = torque_at(t) if side == "right" else 0.0
        if which == "IADRC":
            integral = state[f"{control}.nlsef.I"]
            u0, g = _inlsef(e1, e2, integral), _smeso_g(innovation)
            if name == f"{control}.nlsef.v":
                return _inlsef_v(e1, e2, integral)
        else:
            u0, g = _nlsef(e1, e2), innovation
        values = {
            f"{control}.u": u0 - z3 / B_HAT,
            f"{control}.nlsef.e1": e1,
            f"{control}.nlsef.e2": e2,
            f"{control}.nlsef.u0": u0,
            f"{control}.eso.g": g,
            f"{control}.eso.disturbance": z3 / B_HAT,
            f"{motor}.u": u0 - z3 / B_HAT,
            f"{motor}.torque": torque,
            f"{motor}.omega_dot": (-BEQ * N_GEAR * omega + KT * current - torque / N_GEAR) / (JEQ * N_GEAR),
        }
        if name in values:
            return values[name]
    raise KeyError(name)


# ---------------------------------------------------------------------------------------------------------------------
# Solutions


def solve(
    which: str,
    rtol: float,
    atol: float,
    t_eval: Sequence[float] | np.ndarray,
    method: str = "DOP853",
    max_step: float = math.inf,
) -> np.ndarray:
    """The states at the ascending times t_eval in 0..100, one row per time, columns as in ``NAMES[which]``.

    Three runs of ``solve_ivp``, restarted exactly at 25 and 50.  A time of exactly 25 or 50 gets the start of the run
    that begins there (the states are continuous; a signal that jumps takes its value after the jump, by ``torque_at``).
    """
    rhs = RHS[which]
    times = np.asarray(t_eval, dtype=float)
    if times.size and (times[0] < 0.0 or times[-1] > T_END or np.any(np.diff(times) <= 0.0)):
        raise ValueError("t_eval must ascend within 0..100")
    x0 = np.array(initial_state(which))
    rows = []
    for start, end, torque in SEGMENTS:
        inside = times[(times >= start) & ((times < end) | (end == T_END))]

        def plain(t: float, x: np.ndarray, torque: float = torque) -> list[float]:
            return rhs(t, x.tolist(), torque)

        asked = inside if inside.size and inside[-1] == end else np.append(inside, end)
        sol = solve_ivp(plain, (start, end), x0, method, asked, rtol=rtol, atol=atol, max_step=max_step)
        if not sol.success:
            raise RuntimeError(sol.message)
        rows.append(sol.y[:, : inside.size].T)
        x0 = sol.y[:, -1]
    return np.concatenate(rows)


def solve_rk45(which: str, rtol: float, atol: float) -> tuple[float, int, np.ndarray]:
    """SciPy's RK45 over the three segments without output: (seconds, right-hand sides, state at 100 s)."""
    rhs = RHS[which]
    x0 = np.array(initial_state(which))
    nfev = 0
    begun = time.perf_counter()
    for start, end, torque in SEGMENTS:

        def plain(t: float, x: np.ndarray, torque: float = torque) -> list[float]:
            return rhs(t, x.tolist(), torque)

        sol = solve_ivp(plain, (start, end), x0, "RK45", (end,), rtol=rtol, atol=atol)
        if not sol.success:
            raise RuntimeError(sol.message)
        nfev += int(sol.nfev)
        x0 = sol.y[:, -1]
    return time.perf_counter() - begun, nfev, x0


def measures(
    which: str,
    samples: int = 20001,
    rtol: float = 1e-10,
    atol: float = 1e-12,
    method: str = "DOP853",
    max_step: float = math.inf,
) -> dict[str, float]:
    """The eight measures of ``MEASURES``.

    OPI, ITAE and ISU are seven more states of the system, under the same error control (with an absolute tolerance
    1e-4 times that of the other states, since they are small); OPI is the integral of the squared error divided by
    100 s.  The peak is the largest |e_theta| on a uniform grid of the dense output, refined between the neighbours.
    """
    rhs = RHS[which]
    names = NAMES[which]
    n = len(names)
    right, left = names.index("motor_right.omega"), names.index("motor_left.omega")
    pose, reference = names.index("robot.x"), names.index("reference.x")
    half = names.index("control_left.td.r1")
    tolerances = np.concatenate([np.full(n, atol), np.full(7, 1e-4 * atol)])

    if which == "IADRC":

        def control(w: Sequence[float]) -> float:
            return _inlsef(w[0] - w[3], w[1] - w[4], w[2]) - w[5] / B_HAT
    else:

        def control(w: Sequence[float]) -> float:
            return _nlsef(w[0] - w[2], w[1] - w[3]) - w[4] / B_HAT

    state = np.array(initial_state(which) + [0.0] * 7)
    peak = 0.0
    for start, end, torque in SEGMENTS:

        def plain(t: float, a: np.ndarray, torque: float = torque) -> list[float]:
            x = a.tolist()
            e = [x[reference + k] - x[pose + k] for k in range(3)]
            return [
                *rhs(t, x[:n], torque),
                e[0] * e[0],
                e[1] * e[1],
                e[2] * e[2],
                t * abs(R_SET - x[right]),
                control(x[:half]) ** 2,
                t * abs(R_SET - x[left]),
                control(x[half:pose]) ** 2,
            ]

        sol: Any = solve_ivp(
            plain, (start, end), state, method, dense_output=True, rtol=rtol, atol=tolerances, max_step=max_step
        )
        if not sol.success:
            raise RuntimeError(sol.message)

        def e_theta(t: float, dense: Any = sol.sol) -> float:
            row = dense(t)
            return abs(float(row[reference + 2] - row[pose + 2]))

        grid = np.linspace(start, end, max(3, round((samples - 1) * (end - start) / T_END) + 1))
        values = sol.sol(grid)
        sizes = np.abs(values[reference + 2] - values[pose + 2])
        k = int(np.argmax(sizes))
        peak = max(peak, float(sizes[k]))
        if sizes[k] > 1e-6:
            bounds = (float(grid[max(k - 1, 0)]), float(grid[min(k + 1, grid.size - 1)]))
            best = minimize_scalar(lambda t, f=e_theta: -f(t), bounds=bounds, method="bounded", options={"xatol": 1e-8})
            peak = max(peak, -float(best.fun))
        state = sol.y[:, -1]
    q = state[n:].tolist()
    return dict(zip(MEASURES, [q[0] / T_END, q[1] / T_END, q[2] / T_END, *q[3:], peak], strict=True))


def controls(which: str, rtol: float = 1e-10, atol: float = 1e-12) -> dict[str, float]:
    """Some controls in volt: before the torque (24 s), under it (49 s) and at the end (100 s)."""
    times = (24.0, 49.0, 100.0)
    states = solve(which, rtol, atol, times)
    return {
        f"control_{side}.u at {t:g} s": signals(f"control_{side}.u", t, row)
        for t, row in zip(times, states.tolist(), strict=True)
        for side in ("right", "left")
    }


def main() -> None:
    """Print the tables."""
    columns: dict[str, dict[str, float]] = {}
    for which in ("ADRC", "IADRC"):
        begun = time.perf_counter()
        columns[which] = measures(which) | controls(which)
        print(f"{which}: {time.perf_counter() - begun:.1f} s")
    print(f"{'DOP853, rtol 1e-10, atol 1e-12':32s} {'ADRC':>18s} {'IADRC':>18s}")
    for name in columns["ADRC"]:
        print(f"{name:32s} {columns['ADRC'][name]:18.10g} {columns['IADRC'][name]:18.10g}")
    print("Largest relative difference from CONVERGED")
    for which, values in CONVERGED.items():
        worst = max(MEASURES, key=lambda name: abs(columns[which][name] / values[name] - 1.0))
        print(f"{which}: {abs(columns[which][worst] / values[worst] - 1.0):.1e} ({worst})")
    for which in ("ADRC", "IADRC"):
        seconds, nfev, _ = solve_rk45(which, 1e-6, 1e-9)
        print(f"RK45, rtol 1e-6, atol 1e-9, {which}: {nfev} right-hand sides, {seconds:.2f} s")


if __name__ == "__main__":
    main()
