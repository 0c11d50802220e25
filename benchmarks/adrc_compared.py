"""ADRC beside PID, LQG and H-infinity loop shaping on ten plants: `python -m benchmarks.adrc_compared [--write]`.

Each controller is tuned to the smallest integral of |y| after a step of load, from matrices alone, under the same
limits for each: Ms and Mt at most 1.8, and the same deviation of u under white noise on y. Then blocks runs each loop,
nominal and with plants that differ by up to 30 %. `--write` puts the table into docs/adrc_compared.md.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # several threads only wait for each other in small matrices

import control
import numpy as np
from scipy.linalg import expm, solve_continuous_are
from scipy.optimize import differential_evolution, minimize

from blocks import ADRC, Block, Diagram, Input, Parameter, StateSpace, Step, Sum, TransferFunction, Uniform
from blocks import State as BlockState
from blocks import TransportDelay as Delay
from blocks.analysis import adrc_gains, bandwidth_gains, controller, half_gain

PAGE = Path(__file__).resolve().parents[1] / "docs" / "adrc_compared.md"
HIGHEST = 1.8  # of |S| and |T|
POINTS = 1024  # of a step response
PADE = 6
ROWS = 200
MARKS = ("<!-- tables -->", "<!-- end of the tables -->")
SPREAD = 0.3

Matrices = tuple[np.ndarray, np.ndarray, np.ndarray]


class Pendulum(Block):
    """tau^2 y'' = k u - 4 sin y - 0.5 tau y'."""

    k = Parameter(1.0)
    tau = Parameter(1.0, positive=True)
    u = Input()
    y = BlockState(output=True)
    v = BlockState()

    @y.derivative
    def dy(v, tau):  # type: ignore[no-untyped-def]
        return v / tau

    @v.derivative
    def dv(y, v, u, k, tau):  # type: ignore[no-untyped-def]
        return (k * u - 4 * np.sin(y) - 0.5 * v) / tau


class Plant(NamedTuple):
    """A plant: P(s), its dead time [s], the deviation that noise on y may give u, and the time until it rests [s]."""

    name: str
    text: str
    num: tuple[float, ...]
    den: tuple[float, ...]
    noise: float
    rest: float
    delay: float = 0.0
    nonlinear: bool = False

    def matrices(self) -> Matrices:
        """Return A, B, C, with the dead time by Padé."""
        model = control.tf(self.num, self.den)
        if self.delay:
            model = model * control.tf(*control.pade(self.delay, PADE))
        model = control.ss(model)
        return np.asarray(model.A), np.asarray(model.B), np.asarray(model.C)

    def response(self, s: np.ndarray) -> np.ndarray:
        return np.polyval(self.num, s) / np.polyval(self.den, s) * np.exp(-self.delay * s)


PLANTS = (
    Plant("lag", "1/(s + 1)", (1.0,), (1.0, 1.0), 20.0, 10.0),
    Plant("three lags", "1/(s + 1)³", (1.0,), (1.0, 3.0, 3.0, 1.0), 20.0, 30.0),
    Plant("integrator, lag", "1/(s (s + 1))", (1.0,), (1.0, 1.0, 0.0), 20.0, 30.0),
    Plant("double integrator", "1/s²", (1.0,), (1.0, 0.0, 0.0), 20.0, 30.0),
    Plant("unstable", "1/((s - 1)(0.1 s + 1))", (1.0,), (0.1, 0.9, -1.0), 60.0, 10.0),
    Plant("zero on the right", "(1 - 0.5 s)/(s + 1)²", (-0.5, 1.0), (1.0, 2.0, 1.0), 20.0, 30.0),
    Plant("dead time", "e⁻ˢ/(s + 1)", (1.0,), (1.0, 1.0), 20.0, 30.0, 1.0),
    Plant("resonance", "1/(s² + 0.1 s + 1)", (1.0,), (1.0, 0.1, 1.0), 20.0, 30.0),
    Plant("two masses", "25/(s² (s² + 0.2 s + 25))", (25.0,), (1.0, 0.2, 25.0, 0.0, 0.0), 20.0, 60.0),
    Plant("pendulum", "y″ = u - 4 sin y - 0.5 y′", (1.0,), (1.0, 0.5, 4.0), 20.0, 30.0, 0.0, nonlinear=True),
)


@dataclass(frozen=True)
class Law:
    """A controller from (r, y) to u."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray

    @classmethod
    def of(cls, system: Any) -> Law:
        return cls(*(np.asarray(m, dtype=float) for m in (system.A, system.B, system.C, system.D)))


Design = Callable[[Plant, Matrices, np.ndarray], Law]


# --- the methods: from a few numbers to a law -----------------------------------------------------------------------


def pid(plant: Plant, model: Matrices, x: np.ndarray) -> Law:
    """kp, ki, kd behind a filter of order 2 of what is measured; b: weight of r in the proportional part."""
    kp, ki, kd, Tf, b = x
    a0, a1 = 2 / Tf**2, 2 / Tf  # y filtered: 1/(Tf² s²/2 + Tf s + 1)
    A = np.array([[0.0, 1.0, 0.0], [-a0, -a1, 0.0], [-1.0, 0.0, 0.0]])
    B = np.array([[0.0, 0.0], [0.0, a0], [1.0, 0.0]])
    return Law(A, B, np.array([[-kp, -kd, ki]]), np.array([[b * kp, 0.0]]))


def adrc(order: int, *, halved: bool = False) -> Design:
    """b0, the bandwidth of the loop and that of the observer."""

    def made(plant: Plant, model: Matrices, x: np.ndarray) -> Law:
        b0, wc, wo = x
        if halved:
            gains = half_gain(order, wc, wo)
            return Law.of(controller(order, gains.feedback, gains.observer, b0).system)
        return Law.of(controller(order, adrc_gains(order, wc), bandwidth_gains(order, wo), b0).system)

    return made


def adrc_delayed(plant: Plant, model: Matrices, x: np.ndarray) -> Law:
    """ADRC of order 1 whose observer gets u later by the dead time."""
    b0, wc, wo = x
    l1, l2 = bandwidth_gains(1, wo)
    late = control.ss(control.tf(*control.pade(plant.delay, PADE)))
    Al, Bl, Cl, Dl = (np.asarray(m) for m in (late.A, late.B, late.C, late.D))
    n = len(Al)
    F = np.array([[-wc / b0, -1 / b0]])
    inner = np.array([[-l1, 1.0], [-l2, 0.0]])
    to = np.array([[b0], [0.0]])
    A = np.block([[inner + to @ Dl @ F, to @ Cl], [Bl @ F, Al]])
    g = wc / b0
    B = np.block([[to @ Dl * g, np.array([[l1], [l2]])], [Bl * g, np.zeros((n, 1))]])
    return Law(A, B, np.hstack([F, np.zeros((1, n))]), np.array([[g, 0.0]]))


def lqg(plant: Plant, model: Matrices, x: np.ndarray) -> Law:
    """LQR with the weight rho of u, a Kalman filter that also estimates a load that drifts; u takes the load off."""
    rho, drift, noise = x
    A, B, C = model
    n = len(A)
    P = solve_continuous_are(A, B, C.T @ C, np.array([[rho]]))
    K = B.T @ P / rho
    Aw, Cw = np.block([[A, B], [np.zeros((1, n + 1))]]), np.hstack([C, [[0.0]]])
    W = np.diag(np.append(np.zeros(n), drift)) + np.vstack([B, [[0.0]]]) @ np.vstack([B, [[0.0]]]).T
    X = solve_continuous_are(Aw.T, Cw.T, W, np.array([[noise]]))
    L = X @ Cw.T / noise
    F = -np.hstack([K, [[1.0]]])
    # At rest y = r: u = N r without load.
    rest = np.linalg.solve(np.block([[A, B], [C, np.zeros((1, 1))]]), np.append(np.zeros(n), 1.0))
    N = float(rest[-1] + (K @ rest[:n])[0])
    Bu = np.vstack([B, [[0.0]]])
    return Law(Aw - L @ Cw + Bu @ F, np.hstack([Bu * N, L]), F, np.array([[N, 0.0]]))


def shaped(plant: Plant, model: Matrices, x: np.ndarray) -> Law:
    """H-infinity loop shaping (McFarlane, Glover 1992) of k (s + wi)/(s (Tf s + 1)); r by the gain at rest."""
    k, wi, Tf = x
    A, B, C = model
    W = control.ss(control.tf([k, k * wi], [Tf, 1.0, 0.0]))
    Aw, Bw, Cw = (np.asarray(m) for m in (W.A, W.B, W.C))
    As = np.block([[A, B @ Cw], [np.zeros((len(Aw), len(A))), Aw]])
    Bs, Cs = np.vstack([np.zeros((len(A), 1)), Bw]), np.hstack([C, np.zeros((1, len(Aw)))])
    X = solve_continuous_are(As, Bs, Cs.T @ Cs, np.eye(1))
    Z = solve_continuous_are(As.T, Cs.T, Bs @ Bs.T, np.eye(1))
    gamma = 1.1 * math.sqrt(1 + np.abs(np.linalg.eigvals(X @ Z)).max())
    F = -Bs.T @ X
    L = (1 - gamma**2) * np.eye(len(As)) + X @ Z
    H = gamma**2 * np.linalg.solve(L.T, Z @ Cs.T)
    Ak = As + Bs @ F + H @ Cs
    Ck = Bs.T @ X
    rest = float((-Ck @ np.linalg.solve(Ak, H))[0, 0])  # of y -> W's input, positive feedback
    # states: of the controller, of W
    whole = np.block([[Ak, np.zeros((len(Ak), len(Aw)))], [Bw @ Ck, Aw]])
    B2 = np.block([[np.zeros((len(Ak), 1)), H], [-Bw * rest, np.zeros((len(Aw), 1))]])
    return Law(whole, B2, np.hstack([np.zeros((1, len(Ak))), Cw]), np.zeros((1, 2)))


class Method(NamedTuple):
    """A way to a controller: its name and form, numbers to tune with their ranges, and what makes a law of them."""

    name: str
    form: str
    numbers: tuple[tuple[str, float, float], ...]
    design: Design
    words: dict[str, Any] | None = None  # of the block ADRC, beside the numbers


NAMES = ("ADRC", "PID", "LQG", "H-infinity")
_ADRC = (("b0", 0.05, 1000.0), ("omega_c", 0.01, 50.0), ("omega_o", 0.1, 2000.0))
_PID = (("kp", 1e-3, 100.0), ("ki", 1e-5, 200.0), ("kd", 1e-3, 50.0), ("Tf", 3e-3, 2.0), ("b", 0.01, 1.0))
_LQG = (("rho", 1e-4, 10.0), ("drift", 1e-2, 1e3), ("noise", 1e-7, 1e-1))
_SHAPED = (("k", 0.1, 100.0), ("wi", 0.01, 10.0), ("Tf", 3e-3, 1.0))


class Unstable(RuntimeError):
    """No numbers of a method give a stable loop."""


def methods(plant: Plant) -> Iterator[Method]:
    """Yield the methods for a plant; of several with one name, the best counts."""
    for order in (1, 2):
        yield Method("ADRC", f"ADRC of order {order}", _ADRC, adrc(order), {"order": order})
        yield Method("ADRC", f"ADRC of order {order}, half gain", _ADRC, adrc(order, halved=True))
    if plant.delay:
        yield Method("ADRC", "ADRC of order 1, delayed u", _ADRC, adrc_delayed, {"order": 1, "delay": plant.delay})
    yield Method("PID", "PID", _PID, pid)
    yield Method("LQG", "LQG", _LQG, lqg)
    yield Method("H-infinity", "H-infinity", _SHAPED, shaped)


# --- what a loop does -----------------------------------------------------------------------------------------------


class Found(NamedTuple):
    """Ms, Mt, deviation of u under unit white noise on y, integrals of |y| after a load and of |1 - y| after r."""

    Ms: float
    Mt: float
    noise: float
    load: float
    track: float


def found(plant: Plant, model: Matrices, law: Law) -> Found | None:
    """Judge a linear loop; None where it is not stable."""
    A, B, C = model
    n = len(A)
    By, Br = law.B[:, 1:], law.B[:, :1]
    whole = np.block([[A + B @ law.D[:, 1:] @ C, B @ law.C], [By @ C, law.A]])
    if np.linalg.eigvals(whole).real.max() >= -0.01 / plant.rest:
        return None
    w = np.geomspace(1e-2, 1e5, 700) * (10 / plant.rest)
    s = 1j * w
    values, V = np.linalg.eig(law.A)
    K = -((law.C @ V) * np.linalg.solve(V, By)[:, 0] / (s[:, None] - values)).sum(axis=1) - law.D[0, 1]
    L = plant.response(s) * K
    S = 1 / (1 + L)
    # (1/pi) times the integral of |C S|^2 over w: what a Lyapunov equation gives, but for stiff loops not in digits.
    noise = math.sqrt(np.trapezoid(np.abs(K * S) ** 2 * w, np.log(w)) / math.pi)
    sizes = []
    for entry, rest in ((np.vstack([B, np.zeros((len(law.A), 1))]), 0.0), (np.vstack([B @ law.D[:, :1], Br]), 1.0)):
        h = plant.rest / POINTS
        at_rest = -np.linalg.solve(whole, entry)
        # x(t) - rest, doubled in time
        step, x = expm(whole * h), -at_rest
        while x.shape[1] < POINTS:
            x, step = np.hstack([x, step @ x]), step @ step
        y = (C @ (x[:n] + at_rest[:n]))[0]
        sizes.append(float(np.trapezoid(np.abs(rest - y), dx=h)))
    return Found(float(np.abs(S).max()), float(np.abs(1 - S).max()), noise, *sizes)


def _tracked(plant: Plant, model: Matrices, method: Method, x: np.ndarray) -> float:
    got = found(plant, model, method.design(plant, model, x))
    return math.inf if got is None else got.track


def tuned(plant: Plant, method: Method, seed: int = 1) -> tuple[np.ndarray, Found]:
    """Search the numbers of a method for the smallest integral after a load within the limits."""
    model = plant.matrices()
    low, high = (np.log([row[k] for row in method.numbers]) for k in (1, 2))

    def cost(z: np.ndarray) -> float:
        try:
            got = found(plant, model, method.design(plant, model, np.exp(z)))
        except (np.linalg.LinAlgError, ValueError):
            return 100.0
        if got is None or not math.isfinite(got.load):
            return 50.0
        over = sum(
            max(0.0, math.log(max(one, 1e-300) / limit))
            for one, limit in ((got.Ms, HIGHEST), (got.Mt, HIGHEST), (got.noise, plant.noise))
        )
        return math.log(got.load) + 0.02 * math.log(got.track) + 20 * over

    bounds = list(zip(low, high, strict=True))
    best = differential_evolution(cost, bounds, seed=seed, popsize=12, maxiter=50, tol=1e-6, polish=False, init="sobol")
    ends = {"maxiter": 400, "xatol": 1e-4, "fatol": 1e-6}
    best = minimize(cost, best.x, method="Nelder-Mead", bounds=bounds, options=ends)
    x = np.exp(best.x)
    if method.name == "PID":  # b, which the load does not see
        x[-1] = min(np.linspace(0, 1, 21), key=lambda b: _tracked(plant, model, method, np.append(x[:-1], b)))
    got = found(plant, model, method.design(plant, model, x))
    if got is None:
        raise Unstable(f"{method.form} does not stabilize {plant.name}")
    return x, got


# --- the same loop in blocks ----------------------------------------------------------------------------------------


def loop(plant: Plant, method: Method, x: np.ndarray) -> Diagram:
    """The loop as a diagram with the parameters k, tau and dead: factors of gain, times and dead time of the plant."""
    d = Diagram("loop")
    for name in ("k", "tau", "dead"):
        d.parameter(name, 1.0)
    half = plant.rest
    wanted, load = d.add("wanted", Step(at=0.0)), d.add("load", Step(at=half))
    if plant.nonlinear:
        p = d.add("plant", Pendulum(k="=k", tau="=tau"))
    else:
        last = len(plant.den) - 1
        den = [f"={a!r}*tau**{last - i}" for i, a in enumerate(plant.den)]
        top = len(plant.num) - 1
        num = [f"=k*{b!r}*tau**{top - i}" for i, b in enumerate(plant.num)]
        p = d.add("plant", TransferFunction(num=num, den=den))
    total = d.add("total", Sum(signs="++"))
    if method.words is not None:
        b0, wc, wo = map(float, x)
        d.add("control", ADRC(**method.words, b0=b0, omega_c=wc, omega_o=wo))
    else:
        law = method.design(plant, plant.matrices(), x)
        d.add("control", StateSpace(A=law.A, B=law.B, C=law.C, D=law.D, inputs="r, y", outputs="u"))
    d.wire("control.r", wanted.y)
    d.wire("control.y", p.y)
    d.wire("total.u1", "control.u")
    d.wire("total.u2", load.y)
    if plant.delay:
        late = d.add("late", Delay(delay=f"=dead*{plant.delay!r}"))
        d.wire(late.u, total.y)
        d.wire(p.u, late.y)
    else:
        d.wire(p.u, total.y)
    d.measure("track", "IAE", of="plant.y", against="wanted.y", stop=half)
    d.measure("load", "IAE", of="plant.y", against="wanted.y", start=half)
    return d


def runs(plant: Plant, d: Diagram) -> tuple[dict[str, float], float, float]:
    """The nominal run, the share of the plants with a loop that is lost, and the integral that 95 % stay below."""
    settings: dict[str, Any] = {"stop": 2 * plant.rest, "method": "auto", "rtol": 1e-6, "atol": 1e-9}
    nominal = d.run(every=plant.rest, **settings).measures
    factor = Uniform(1 - SPREAD, 1 + SPREAD)
    over = {"k": factor, "tau": factor} | ({"dead": factor} if plant.delay else {})
    rows = d.sweep(over, n=ROWS, seed=1, sampler="halton", max_steps=200000, threads=1, **settings)
    load = np.array(rows.measures["load"], dtype=float)
    lost = ~(load < 10 * nominal["load"])
    return dict(nominal), float(lost.mean()), float(np.quantile(np.where(lost, np.inf, load), 0.95, method="lower"))


# --- the tables -----------------------------------------------------------------------------------------------------


class Row(NamedTuple):
    """The best design of a method for a plant, by its form, and what its loop does."""

    plant: str
    form: str
    x: np.ndarray
    got: Found
    nominal: dict[str, float]
    lost: float
    worst: float


def rows(plant: Plant) -> list[Row]:
    """Tune and run every method on a plant; of the forms of ADRC the best one."""
    best: dict[str, tuple[Method, np.ndarray, Found]] = {}
    for method in methods(plant):
        with suppress(Unstable):
            x, got = tuned(plant, method)
            if method.name not in best or got.load < best[method.name][2].load:
                best[method.name] = method, x, got
    return [Row(plant.name, m.form, x, got, *runs(plant, loop(plant, m, x))) for m, x, got in best.values()]


def tables(made: list[Row]) -> str:
    """Return the two tables of the page: what the loops do, and the numbers that were tuned."""
    lines = ["| plant | " + " | ".join(NAMES) + " |", "|---|" + "---|" * len(NAMES)]
    logs: dict[str, list[float]] = {name: [] for name in NAMES}
    numbers = ["| plant | controller | numbers | Ms | Mt | noise |", "|---|---|---|---|---|---|"]
    for plant in PLANTS:
        of, cells = {}, []
        for row in (row for row in made if row.plant == plant.name):
            method = next(method for method in methods(plant) if method.form == row.form)
            of[method.name] = row
            told = ", ".join(f"{name} {value:.4g}" for (name, *_), value in zip(method.numbers, row.x, strict=True))
            rest = f"{row.got.Ms:.2f} | {row.got.Mt:.2f} | {row.got.noise:.3g}"
            numbers.append(f"| {plant.name} | {row.form} | {told} | {rest} |")
        least = min(row.nominal["load"] for row in of.values())
        for name in NAMES:
            row = of[name]
            kept = f"{row.worst:.3g}" if row.lost <= 0.05 else f"{row.lost:.0%} lost"
            cells.append(f"{row.nominal['load']:.3g} ({kept}); {row.nominal['track']:.3g}")
            logs[name].append(math.log(row.nominal["load"] / least))
        lines.append(f"| {plant.name}, {plant.text} | " + " | ".join(cells) + " |")
    means = (f"{math.exp(sum(logs[name]) / len(PLANTS)):.2f}" for name in NAMES)
    lines.append(f"| mean ratio to the best | {' | '.join(means)} |")
    return "\n".join([*lines, "", *numbers, ""])


def main() -> None:
    with ProcessPoolExecutor() as pool:
        made = []
        for some in pool.map(rows, PLANTS):
            made += some
            print(*(f"{row.plant}: {row.form} {row.x}, {row.got}" for row in some), sep="\n", flush=True)
    text = tables(made)
    print(text)
    if "--write" in sys.argv:
        page = PAGE.read_text(encoding="utf-8")
        before, after = page.partition(MARKS[0])[0], page.partition(MARKS[1])[2]
        PAGE.write_text(f"{before}{MARKS[0]}\n\n{text}\n{MARKS[1]}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
