"""The diagrams that are measured, drawn with blocks of the library as a user would, also as JSON text.

P1: a DC motor under linear ADRC with a saturated control and a pulse of torque. P2: N such loops in one diagram.
"""

from __future__ import annotations

from pathlib import Path

from blocks import Block, Diagram, output, subdiagram
from blocks.api.ports import Handle
from blocks.contract.variables import Parameter
from blocks.library import (
    LESO,
    LSEF,
    PID,
    Disturbance,
    FirstOrder,
    Gain,
    Integrator,
    PMDCMotor,
    Saturation,
    Step,
    Sum,
    ZeroOrderHold,
)

__all__ = [
    *("CHAIN", "COUPLING", "GAIN_RATIO", "OBSERVER", "P1_LOG", "PD", "PID_GAINS", "ROOT", "Clock"),
    *("long_run", "loops", "p1", "p2", "p2_flat", "p2_log", "robot", "save_p2"),
]

ROOT = Path(__file__).resolve().parent.parent
P1_LOG = ("motor.omega", "limit.y", "eso.z3")
GAIN_RATIO = 3.0
"""The torque d of P1 acts behind the gearbox; the motor's `tau` acts before it."""


def _loop(diagram: Diagram, prefix: str = "", corners: str = "located") -> None:
    """The six blocks of P1 and their wires."""
    speed = diagram.add(f"{prefix}speed", Step(at=0.0, after=1.0, unit="rad/s"))
    law = diagram.add(f"{prefix}law", LSEF(gains=[144.0, 25.0], b0=1.755, unit="rad/s", unit_u="V"))
    limit = diagram.add(f"{prefix}limit", Saturation(lower=-12.0, upper=12.0, unit="V", corners=corners))
    eso = diagram.add(f"{prefix}eso", LESO(gains=[30.4, 513.4, 1570.8], b0=1.755, unit="rad/s", unit_u="V"))
    load = diagram.add(f"{prefix}load", Disturbance(torque=2.0 * GAIN_RATIO, on=30.0, off=50.0))
    motor = diagram.add(f"{prefix}motor", PMDCMotor(n=GAIN_RATIO))
    for sink, source in (
        (law.r1, speed.y),
        (law.z1, eso.z1),
        (law.z2, eso.z2),
        (law.z3, eso.z3),
        (limit.u, law.u),
        (eso.y, motor.omega),
        (eso.u, limit.y),
        (motor.v, limit.y),
        (motor.tau, load.y),
    ):
        diagram.wire(sink, source)


def p1(corners: str = "located") -> Diagram:
    """corners: whether the instants at which the control meets its limit are located, or it is clipped."""
    diagram = Diagram("p1")
    _loop(diagram, corners=corners)
    diagram.settings(stop=100.0, method="dopri5", rtol=1e-6, atol=1e-9, every=0.01, log=list(P1_LOG))
    return diagram


def p2_log(count: int, port: str = "motor.omega", between: str = ".") -> list[str]:
    """The speeds that are recorded: of at most ten loops, evenly spread."""
    recorded = min(count, 10)
    return [f"loop{j * count // recorded}{between}{port}" for j in range(recorded)]


def p2(count: int, corners: str = "located") -> Diagram:
    """P2 as a diagram of subdiagrams."""
    loop, diagram = Diagram("loop"), Diagram("p2")
    _loop(loop, corners=corners)
    for number in range(count):
        diagram.add(f"loop{number}", subdiagram(loop))
    diagram.settings(stop=10.0, method="rk4", step=0.001, every=0.01, log=p2_log(count))
    return diagram


def p2_flat(count: int) -> Diagram:
    """P2 without subdiagrams: six blocks and nine wires for each loop."""
    diagram = Diagram("p2")
    for number in range(count):
        _loop(diagram, f"loop{number}_")
    diagram.settings(stop=10.0, method="rk4", step=0.001, every=0.01, log=p2_log(count, between="_"))
    return diagram


def save_p2(count: int, folder: Path) -> Path:
    """P2 as two files: the loop, and the diagram that names it `count` times. Returns the path of the second."""
    loop = Diagram("loop")
    _loop(loop)
    loop.save(folder / "loop.json")
    blocks = ",\n".join(f'  "loop{number}": {{"diagram": "loop.json"}}' for number in range(count))
    log = ", ".join(f'"{name}"' for name in p2_log(count))
    run = f'{{"stop": 10, "method": "rk4", "step": 0.001, "every": 0.01, "log": [{log}]}}'
    head = '{\n "format": "blocks-diagram",\n "version": 3,\n "name": "p2",\n'
    text = f'{head} "blocks": {{\n{blocks}\n }},\n "run": {run}\n}}\n'
    path = folder / "p2.json"
    path.write_text(text, encoding="utf-8")
    return path


PD, OBSERVER = (144.0, 25.0), (30.4, 513.4, 1570.8)
PID_GAINS = (20.0, 40.0, 1.0, 0.005)
"""kp, ki, kd and Tf."""
CHAIN, COUPLING = 10, 0.2
"""Loops in a row, and the torque with which the speed of each brakes the next one, in N.m.s/rad."""


def loops(count: int) -> Diagram:
    """Motors that follow one wanted speed, every other one under linear ADRC or a PID, coupled in rows of ten."""
    diagram = Diagram("loops")
    speed = diagram.add("speed", Step(at=0.0, after=1.0, unit="rad/s"))
    motors: list[Handle] = []
    for k in range(count):
        motor = diagram.add(f"motor{k}", PMDCMotor(n=GAIN_RATIO))
        if k % 2 == 0:
            law = diagram.add(f"law{k}", LSEF(gains=list(PD), b0=1.755, unit="rad/s", unit_u="V"))
            eso = diagram.add(f"eso{k}", LESO(gains=list(OBSERVER), b0=1.755, unit="rad/s", unit_u="V"))
            pairs = [(law.r1, speed.y), (law.z1, eso.z1), (law.z2, eso.z2), (law.z3, eso.z3)]
            pairs += [(eso.y, motor.omega), (eso.u, law.u), (motor.v, law.u)]
        else:
            kp, ki, kd, Tf = PID_GAINS
            pid = diagram.add(f"pid{k}", PID(kp=kp, ki=ki, kd=kd, c=1.0, Tf=Tf, unit="rad/s", unit_u="V"))
            pairs = [(pid.r, speed.y), (pid.y, motor.omega), (motor.v, pid.u)]
        if k % CHAIN:
            brake = diagram.add(f"brake{k}", Gain(k=COUPLING, unit="N.m", unit_u="rad/s"))
            pairs += [(brake.u, motors[-1].omega), (motor.tau, brake.y)]
        else:
            pairs.append((motor.tau, diagram.add(f"load{k}", Disturbance(torque=0.0, on=1.0, off=2.0)).y))
        motors.append(motor)
        for sink, source in pairs:
            diagram.wire(sink, source)
    return diagram


def robot(*, measures: bool = False) -> Diagram:
    """The paper's robot under the improved ADRC. With rows of jumps and without measures, as the C program has it."""
    folder = ROOT / "diagrams" / "paper"
    document = Diagram.load(folder / "iadrc.json").to_json()
    document["run"]["jumps"] = True
    if not measures:
        del document["measures"]
    return Diagram.from_json(document, folder=folder)


class Clock(Block):
    """y = t at the last tick."""

    period = Parameter(unit="s", positive=True, doc="time between two ticks")

    @output(unit="s", every=period, doc="time of the last tick")  # type: ignore[untyped-decorator]
    def y(t: float) -> float:
        return t


def long_run(steps: int) -> Diagram:
    """A loop with a sampled controller, run over so many steps of 1 ms; ticks each 7 ms, 1,000 rows.

    The clock is not recorded: it jumps at every tick, and each jump would add two rows.
    """
    diagram = Diagram("long_run", library=Clock)
    plant = diagram.add("plant", FirstOrder(k=2.0, T=0.5))
    error = diagram.add("error", Sum(signs="+-"))
    speed = diagram.add("speed", Step(at=0.0, after=1.0))
    hold = diagram.add("hold", ZeroOrderHold(period=0.007))
    law = diagram.add("law", Gain(k=3.0))
    integral = diagram.add("integral", Integrator())
    both = diagram.add("both", Sum(signs="++"))
    diagram.add("clock", Clock(period=0.007))
    for sink, source in (
        (error.u1, speed.y),
        (error.u2, plant.y),
        (hold.u, error.y),
        (law.u, hold.y),
        (integral.u, hold.y),
        (both.u1, law.y),
        (both.u2, integral.y),
        (plant.u, both.y),
    ):
        diagram.wire(sink, source)
    diagram.settings(stop=steps / 1000, method="rk4", step=0.001, every=steps / 1e6, log=["plant.y"])
    return diagram
