"""P1 and P2 with PathSim."""

import problem as p
from pathsim import Connection, Simulation
from pathsim.blocks import Adder, Amplifier, Clip, Constant, Scope, StateSpace, StepSource
from pathsim.solvers import RK4, RKDP54

kind, count, stop, path = p.arguments()


def build():
    blocks, wires, scope = [], [], Scope()
    for number in range(count):
        motor = StateSpace(p.MOTOR_A, p.MOTOR_B, p.MOTOR_C, p.MOTOR_D)
        eso = StateSpace(p.ESO_A, p.ESO_B, p.ESO_C, p.ESO_D)
        gains = [Amplifier(float(gain)) for gain in p.LAW[0]]
        total, limit = Adder(), Clip(-p.LIMIT, p.LIMIT)
        speed, pulse = Constant(1.0), StepSource([p.PULSE, 0.0], [p.ON, p.OFF])
        blocks += [motor, eso, *gains, total, limit, speed, pulse]
        wires += [Connection(speed, gains[0]), *(Connection(eso[k], gains[k + 1]) for k in range(3))]
        wires += [Connection(gain, total[k]) for k, gain in enumerate(gains)]
        wires += [Connection(total, limit), Connection(limit, motor[0], eso[1]), Connection(pulse, motor[1])]
        wires += [Connection(motor, eso[0], *([scope] if number == 0 else []))]
    given = {"dt": p.STEP, "Solver": RK4}
    if kind == "adaptive":
        given = {"Solver": RKDP54, "tolerance_lte_rel": p.RTOL, "tolerance_lte_abs": p.ATOL}
    return Simulation([*blocks, scope], wires, log=False, **given), scope


def run(model):
    simulation, scope = model
    simulation.run(stop, reset=True, adaptive=kind == "adaptive")
    t, (w, *_) = scope.read()
    return t, w


p.report(build, run, path, repeats=3 if kind == "adaptive" else 1)
