"""What linear models and frequency responses cost, each beside what gives the same without this library.

The paper's robot against python-control's `linearize` of the equations written out by hand, a thousand loops against
the same matrices put together by hand and against python-control's `interconnect`, a sine sweep of an observer against
the same sines through SciPy's solver, a map of margins against reports of single points. What both sides give is
compared.
"""

from __future__ import annotations

import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from blocks import Diagram

from . import diagrams

__all__ = ["apart", "by_control", "loops_by_control", "loops_by_hand", "main", "swept_by_scipy", "transfer"]

Array = np.ndarray[Any, Any]
LAWS = tuple(f"control_{side}.{law}" for side in ("right", "left") for law in ("nlsef.e", "eso.e"))
AMPLITUDE = 0.1
OMEGA = np.geomspace(0.5, 400.0, 40)
"""Of the sweeps, in rad/s."""
COUNT = 1000
FEW = 20
"""Loops that python-control connects: its time grows with the square of their number."""
RA, LA, KB, KT, JEQ, BEQ = 0.1557, 0.82, 1.185, 1.1882, 0.2752, 0.3922
TORQUE = -1.0 / diagrams.GAIN_RATIO / (JEQ * diagrams.GAIN_RATIO)
"""What a torque does to the acceleration of a motor, in 1/(kg.m2)."""
B0 = 1.755
REPEATS = 30


def timed(run: Callable[[], Any], repeats: int = REPEATS) -> tuple[list[float], Any]:
    """Seconds of each of some calls after a first one, and what the last one gave."""
    made = run()
    seconds = []
    for _ in range(repeats):
        begun = time.perf_counter()
        made = run()
        seconds.append(time.perf_counter() - begun)
    return seconds, made


def tell(label: str, seconds: Sequence[float], goal: float | None = None, reference: Sequence[float] = ()) -> None:
    """One row: least and median in ms, how often the reference goes into it, the goal in ms."""
    least, median = 1e3 * min(seconds), 1e3 * statistics.median(seconds)
    ratio = f"{1e-3 * least / min(reference):10.3f}" if reference else f"{'':10}"
    verdict = "" if goal is None else f"goal {goal:g} ms {'met' if least <= goal else 'MISSED'}"
    print(f"{label:62}{least:10.2f}{median:10.2f}{ratio}  {verdict}", flush=True)


HEAD = f"{'':62}{'least ms':>10}{'median':>10}{'ratio':>10}"


def apart(made: Array, wanted: Array) -> float:
    """The largest difference of two responses, as a part of the largest value."""
    return float(np.max(np.abs(made - wanted)) / np.max(np.abs(wanted)))


def transfer(matrices: Any, omega: Sequence[float]) -> Array:
    """C (j omega - A)^-1 B + D of sparse matrices or of a model: (frequencies, outputs), for the first input."""
    from scipy import sparse
    from scipy.sparse.linalg import splu

    A, B, C, D = matrices if isinstance(matrices, tuple) else (matrices.A, matrices.B, matrices.C, matrices.D)
    made = []
    for w in omega:
        whole = sparse.csc_matrix(1j * w * sparse.eye_array(A.shape[0]) - sparse.csc_matrix(A))
        solved = splu(whole).solve(sparse.csc_matrix(B).toarray()[:, 0].astype(complex))
        made.append(sparse.csr_matrix(C) @ solved + sparse.csr_matrix(D).toarray()[:, 0])
    return np.array(made)


# --- the paper's robot -------------------------------------------------------------------------------------------


def by_control(states: Sequence[float]) -> Callable[[], Any]:
    """python-control's linearize of the robot's equations by hand, from the torque to the right wheel's speed."""
    import control

    from tests.support import witness_paper as witness

    place = witness.IADRC_NAMES.index("motor_right.omega")
    system = control.nlsys(
        lambda t, x, u, params: witness.iadrc_rhs(t, x.tolist(), float(u[0])),
        lambda t, x, u, params: x[place : place + 1],
        inputs=["torque"], outputs=["omega"], states=len(witness.IADRC_NAMES),
    )  # fmt: skip
    return lambda: control.linearize(system, list(states), [witness.TORQUE])


def witness_states(point: Any) -> list[float]:
    """The states of the robot in the order of the equations by hand."""
    from tests.support import witness_paper as witness

    known = dict(zip(point.plan.states, point.memory[1], strict=True))
    elements = {"z1": "z[0]", "z2": "z[1]", "z3": "z[2]"}
    made = []
    for name in witness.IADRC_NAMES:
        block, _, last = name.rpartition(".")
        block = f"{block}.kinematics" if block in ("robot", "reference") else block
        made.append(known[f"{block}.{elements.get(last, last)}"])
    return made


def robot() -> None:
    from blocks.linear.harmonic_balance import Linearizer
    from blocks.linear.slopes import slopes_at

    diagram = Diagram.load(diagrams.ROOT / "diagrams" / "paper" / "iadrc.json")
    ends = ("disturbance.y", "motor_right.omega")
    point = diagram.point(at=25.2)
    reference, theirs = timed(by_control(witness_states(point)))
    tell("python-control's linearize, equations by hand, 22 states", reference)
    seconds, ours = timed(lambda: diagram.linearize(*ends, at=25.2))
    tell("torque -> speed at 25.2 s: Diagram.linearize again", seconds, 5.0, reference)
    linearizer = diagram.linearizer(at=25.2)
    tell("    Linearizer.model", timed(lambda: linearizer.model(*ends))[0], 5.0, reference)
    rng = np.random.default_rng(1)

    def moved(base: Any, size: float) -> Any:
        return base.moved(x=np.asarray(base.memory[1]) + size * rng.standard_normal(len(base.memory[1])))

    seconds, _ = timed(lambda: Linearizer(slopes_at(moved(point, 1e-3))).model(*ends))
    tell("    at a new point each time", seconds, 5.0, reference)
    off = apart(transfer(ours, OMEGA.tolist()), transfer(theirs, OMEGA.tolist()))
    print(f"    from python-control's, which takes one-sided differences, it is {off:.1e} off")

    plant = ("motor_right.v", "motor_right.omega")
    seconds, _ = timed(lambda: diagram.linearize(*plant, openings="control_right.u"))
    tell("the motor alone, at rest: Diagram.linearize again", seconds, 5.0, reference)
    amplitude = dict.fromkeys(LAWS, AMPLITUDE)
    seconds, _ = timed(lambda: diagram.linearize("speed.y", ends[1], amplitude=amplitude))
    tell("wanted -> speed at rest, 6 laws with amplitudes: again", seconds, 5.0, reference)
    rest = diagram.point()
    seconds, _ = timed(lambda: Linearizer(slopes_at(moved(rest, 1e-3)), amplitude=amplitude).model("speed.y", ends[1]))
    tell("    at a new point each time", seconds, 5.0, reference)

    def other() -> Any:
        return diagram.linearize("speed.y", ends[1], amplitude=dict.fromkeys(LAWS, rng.uniform(0.05, 0.2)))

    tell("    with new amplitudes each time", timed(other)[0], 5.0, reference)
    places = ["speed.y", "disturbance.y", "motor_right.v", "motor_left.v", "control_right.eso.y"]
    seen = [*(f"control_right.{name}" for name in ("u", "z1", "z2", "z3", "disturbance")), "motor_right.omega"]
    seen += [*(f"control_left.{name}" for name in ("u", "z1", "z2", "z3", "disturbance")), "motor_left.omega"]
    seen += ["motor_right.i", "motor_left.i", "robot.x", "robot.y", "robot.theta", "heading_error.y", "reference.x"]
    seen = [*seen, "control_right.eso.z1"]
    linearizer = diagram.linearizer(amplitude=amplitude)
    seconds, _ = timed(lambda: [linearizer.model(a, b) for a in places for b in seen], 5)
    tell(f"{len(places) * len(seen)} transfers of one Linearizer, one by one", seconds)
    seconds, _ = timed(lambda: linearizer.model(places, seen), 5)
    tell("    all in one model", seconds)


# --- many loops --------------------------------------------------------------------------------------------------


def loops_by_hand(count: int) -> tuple[Any, Any, Any, Any]:
    """A, B, C, D of `diagrams.loops` from its equations: by the wanted speed, the speeds of all motors."""
    from scipy import sparse

    parts = [_adrc_loop() if k % 2 == 0 else _pid_loop() for k in range(count)]
    first = np.cumsum([0, *(len(A) for A, _, _ in parts)])
    size = int(first[-1])
    speeds = np.array([first[k] + place for k, (_, _, place) in enumerate(parts)])
    behind = [k for k in range(count) if k % diagrams.CHAIN]
    brake = (np.full(len(behind), TORQUE * diagrams.COUPLING), (speeds[behind], speeds[[k - 1 for k in behind]]))
    A = sparse.csr_matrix(sparse.block_diag([A for A, _, _ in parts])) + sparse.csr_matrix(brake, shape=(size, size))
    B = sparse.csr_matrix(np.concatenate([b for _, b, _ in parts])[:, None])
    C = sparse.csr_matrix((np.ones(count), (np.arange(count), speeds)), shape=(count, size))
    return A, B, C, sparse.csr_matrix((count, 1))


def _motor() -> tuple[Array, Array]:
    """The paper's motor: the matrix of (omega, i), and what the voltage does."""
    A = [[-BEQ / JEQ, KT / (JEQ * diagrams.GAIN_RATIO)], [-KB * diagrams.GAIN_RATIO / LA, -RA / LA]]
    return np.array(A), np.array([0.0, 1.0 / LA])


def _adrc_loop() -> tuple[Array, Array, int]:
    """The matrix of (z1, z2, z3, omega, i), what the wanted speed does, and where omega stands."""
    (kp, kd), (l1, l2, l3) = diagrams.PD, diagrams.OBSERVER
    motor, b = _motor()
    u = np.array([-kp / B0, -kd / B0, -1.0 / B0, 0.0, 0.0])  # by the states; kp/b0 by the wanted speed
    A = np.zeros((5, 5))
    A[:3, :4] = [[-l1, 1.0, 0.0, l1], [-l2, 0.0, 1.0, l2], [-l3, 0.0, 0.0, l3]]
    A[1] += B0 * u
    A[3:, 3:] = motor
    A[3:] += np.outer(b, u)
    return A, np.array([0.0, kp, 0.0, *(b * kp / B0)]), 3


def _pid_loop() -> tuple[Array, Array, int]:
    """The same of a PID: (integral, smoothed, omega, i)."""
    kp, ki, kd, Tf = diagrams.PID_GAINS
    motor, b = _motor()
    direct = kp + kd / Tf
    u = np.array([1.0, -kd / Tf, -direct, 0.0])
    A = np.zeros((4, 4))
    A[0, 2], A[1, 1], A[1, 2] = -ki, -1.0 / Tf, -1.0 / Tf
    A[2:, 2:] = motor
    A[2:] += np.outer(b, u)
    return A, np.array([ki, 1.0 / Tf, *(b * direct)]), 2


def loops_by_control(count: int) -> Any:
    """`diagrams.loops` by python-control's interconnect of motors and controllers."""
    import control

    (kp, kd), (l1, l2, l3), b0 = diagrams.PD, diagrams.OBSERVER, B0
    p, ki, d, Tf = diagrams.PID_GAINS
    motor, b = _motor()
    drive = np.column_stack([b, [TORQUE * diagrams.COUPLING, 0.0]])  # by the voltage, and by the speed that brakes
    u = np.array([[-kp / b0, -kd / b0, -1.0 / b0]])
    observer = np.array([[-l1, 1.0, 0.0], [-l2, 0.0, 1.0], [-l3, 0.0, 0.0]]) + np.outer([0.0, b0, 0.0], u[0])
    hears, direct = np.array([[0.0, l1], [kp, l2], [0.0, l3]]), p + d / Tf
    adrc = (observer, hears, u, [[kp / b0, 0.0]])
    pid = (
        [[0.0, 0.0], [0.0, -1.0 / Tf]], [[ki, -ki], [1.0 / Tf, -1.0 / Tf]], [[1.0, -d / Tf]], [[direct, -direct]],
    )  # fmt: skip
    systems: list[Any] = []
    connections: list[Any] = []
    for k in range(count):
        speed = ([[1.0, 0.0]], [[0.0, 0.0]])
        systems.append(control.ss(motor, drive, *speed, inputs=["v", "by"], outputs=["omega"], name=f"motor{k}"))
        law = adrc if k % 2 == 0 else pid
        systems.append(control.ss(*law, inputs=["r", "y"], outputs=["u"], name=f"law{k}"))
        connections += [[f"motor{k}.v", f"law{k}.u"], [f"law{k}.y", f"motor{k}.omega"]]
        if k % diagrams.CHAIN:
            connections.append([f"motor{k}.by", f"motor{k - 1}.omega"])
    return control.interconnect(
        systems, connections, inplist=[[f"law{k}.r" for k in range(count)]], inputs=["r"],
        outlist=[f"motor{k}.omega" for k in range(count)], outputs=count, check_unused=False,
    )  # fmt: skip


def loops() -> None:
    print(f"{COUNT} loops, from the wanted speed to all speeds, sparse")
    names = {count: [f"motor{k}.omega" for k in range(count)] for count in (FEW, COUNT)}
    hand, wanted = timed(lambda: loops_by_hand(COUNT), 3)
    tell("matrices by hand, put together by SciPy", hand)
    made: Any = None
    times = []
    for _ in range(4):  # of diagrams that know nothing of each other; the first one imports and is left out
        diagram = diagrams.loops(COUNT)
        begun = time.perf_counter()
        diagram.plan()
        flat = time.perf_counter()
        diagram.point()
        stood = time.perf_counter()
        linearizer = diagram.linearizer()
        made = linearizer.sparse("speed.y", names[COUNT])
        done = time.perf_counter()
        linearizer.sparse("speed.y", names[COUNT])
        times.append((flat - begun, done - flat, done - stood, time.perf_counter() - done))
    planned, whole, wired, again = zip(*times[1:], strict=True)
    tell("flatten and plan alone", planned)
    tell("from Diagram to matrices, flatten, plan and start included", whole, 2000.0, hand)
    tell("    without these", wired, None, hand)
    tell("    another transfer of the same point", again, None, hand)
    A, omega = made[0], [0.5, 5.0, 50.0]
    off = apart(transfer(made, omega), transfer(wanted, omega))
    print(f"    {A.shape[0]} states, {A.nnz} numbers in A; from those by hand its responses are {off:.1e} off")
    few = diagrams.loops(FEW)
    theirs, system = timed(lambda: loops_by_control(FEW), 3)
    tell(f"python-control's interconnect of {FEW} loops", theirs)
    few.linearize("speed.y", names[FEW])
    seconds, ours = timed(lambda: diagrams.loops(FEW).linearize("speed.y", names[FEW]), 5)
    tell(f"ours of {FEW} loops, with the making of the Diagram", seconds, None, theirs)
    off = apart(transfer(ours, [5.0]), transfer(system, [5.0]))
    print(f"    they are {off:.1e} apart")


# --- a sweep -----------------------------------------------------------------------------------------------------


def swept_by_scipy(omega: Sequence[float], periods: Sequence[int]) -> Array:
    """The response of the paper's observer from y to z1, z2, z3, by DOP853: all periods but the last one settle it."""
    from scipy.integrate import solve_ivp

    from tests.support import witness_paper as witness

    made = []
    for w, count in zip(omega, periods, strict=True):

        def rates(t: float, x: Array, w: float = w) -> list[float]:
            g = witness._smeso_g(AMPLITUDE * math.sin(w * t) - x[0])
            return [x[1] + witness.SM_L1 * g, x[2] + witness.SM_L2 * g, witness.SM_L3 * g]

        end = 2.0 * math.pi * count / w
        times = end - 2.0 * math.pi / w * (1.0 - np.arange(64) / 64)
        answer = solve_ivp(rates, (0.0, end), [0.0] * 3, "DOP853", times, rtol=1e-8, atol=1e-11)
        if not answer.success:
            raise RuntimeError(answer.message)
        made.append(2j * np.mean(answer.y * np.exp(-1j * w * times), axis=1) / AMPLITUDE)
    return np.array(made).T


def sweep() -> None:
    from blocks.analysis.estimation import SineStream, estimate_response
    from blocks.library import SMESO

    seen, signal = ["z1", "z2", "z3"], SineStream(OMEGA, AMPLITUDE)
    print(f"the paper's observer, y to z1, z2, z3 at {len(OMEGA)} frequencies of 0.5 to 400 rad/s, A = {AMPLITUDE}")

    def estimated() -> Any:
        return estimate_response(Diagram.alone(SMESO()), "y", seen, signal=signal, inputs={"u": 0.0}, engine="native")

    begun = time.perf_counter()
    estimated()
    print(f"the first sweep, where a cold cache compiles: {time.perf_counter() - begun:.2f} s")
    seconds, ours = timed(estimated, 5)
    counts = np.round(ours.seconds * OMEGA / (2.0 * math.pi)).astype(int)
    begun = time.perf_counter()
    theirs = swept_by_scipy(OMEGA.tolist(), counts.tolist())
    scipy = [time.perf_counter() - begun]
    tell("SciPy's DOP853, rtol 1e-8, through the same periods", scipy)
    tell("estimate_response, sines", seconds, 2000.0, scipy)
    print(f"    {int(counts.sum())} periods; they are {apart(ours.value, theirs):.1e} apart")
    linearizer = Diagram.alone(SMESO()).linearizer(inputs={"u": 0.0})
    seconds, made = timed(lambda: linearizer.harmonic_response("y", seen, OMEGA, amplitude=AMPLITUDE), 5)
    tell("harmonic_response", seconds, None, scipy)
    ratio = ours.value / made.value
    decibels, degrees = np.max(np.abs(20.0 * np.log10(np.abs(ratio)))), np.max(np.abs(np.angle(ratio, deg=True)))
    print(f"    within {decibels:.4f} dB and {degrees:.3f} deg of the sweep")


def first() -> None:
    """The first call in a process: what python-control takes of it to be loaded."""
    path = diagrams.ROOT / "diagrams" / "analysis" / "leso_pd.json"
    load = f"from blocks import Diagram; d = Diagram.load({str(path)!r})"
    code = f"import time, numpy; {load}; t = time.perf_counter(); {{}}; print(time.perf_counter() - t)"
    for label, what in (
        ("first call of linearize in a process", 'd.linearize("r", "y")'),
        ("    of which `import control`", "import control"),
        ("first sparse matrices, for which it is not loaded", 'd.linearizer().sparse("r", "y")'),
    ):
        done = [
            subprocess.run(
                [sys.executable, "-c", code.format(what)], cwd=diagrams.ROOT, check=True, capture_output=True, text=True
            )
            for _ in range(4)
        ]
        tell(label, [float(one.stdout) for one in done[1:]])


def plane() -> None:
    """A map of 100 x 100 points of a loop under ADRC, beside `margins` and peaks of single points."""
    from blocks import ADRC, TransferFunction
    from blocks.analysis import loop_map, loop_report

    loop = Diagram("loop")
    control = loop.add("control", ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0))
    plant = loop.add("plant", TransferFunction(num=[2.0], den=[1.0, 1.0, 0.5]))
    loop.wire(control.r, loop.input("r", default=0.0))
    loop.wire(control.y, plant.y)
    loop.wire(plant.u, control.u)
    over = {"control.omega_c": (1.0, 30.0), "control.omega_o": (5.0, 300.0)}
    ends = "control.u", "plant.y"
    seconds, made = timed(lambda: loop_map(loop, *ends, over=over, points=100), 3)
    places = [(k, 99 - k) for k in range(0, 100, 10)]

    def single(i: int, k: int) -> Any:
        given = {"control.omega_c": float(made.values[0][i]), "control.omega_o": float(made.values[1][k])}
        return loop_report(loop, *ends, parameters=given)

    alone, reports = timed(lambda: [single(*place) for place in places], 3)
    for (i, k), report in zip(places, reports, strict=True):
        known = report.margins.Ms, report.peak_disturbance[0], report.peak_noise[0]
        assert np.allclose([made.measures[name][k, i] for name in ("Ms", "disturbance", "noise")], known, rtol=1e-6)
    each = [1e4 / len(places) * second for second in alone]
    tell("a map of 100 x 100 points of a loop under ADRC", seconds, 10_000)
    tell("  the same by loop_report of each point (of ten, scaled)", each, reference=seconds)


def main() -> None:
    print(HEAD)
    robot()
    loops()
    sweep()
    plane()
    first()
