"""P1 and P2 with bdsim. Its integrators are SciPy's: there is no fixed step."""

import contextlib
import io

import bdsim
import problem as p

kind, count, stop, path = p.arguments()


def build():
    simulation = bdsim.BDSim(graphics=False, progress=False)
    diagram = simulation.blockdiagram()
    watched = None
    for number in range(count):
        motor = diagram.LTI_SS(A=p.MOTOR_A, B=p.MOTOR_B, C=p.MOTOR_C, name=f"motor{number}")
        eso = diagram.LTI_SS(A=p.ESO_A, B=p.ESO_B, C=p.ESO_C, name=f"eso{number}")
        law = diagram.FUNCTION(lambda a, b, c: float(p.LAW[0] @ [1.0, a, b, c]), nin=3, nout=1, name=f"law{number}")
        limit = diagram.CLIP(-p.LIMIT, p.LIMIT, name=f"limit{number}")
        load = diagram.PIECEWISE((0, 0.0), (p.ON, p.PULSE), (p.OFF, 0.0), name=f"load{number}")
        for k in range(3):
            diagram.connect(eso[k], law[k])
        diagram.connect(law, limit)
        diagram.connect(limit, motor[0])
        diagram.connect(limit, eso[1])
        diagram.connect(load, motor[1])
        diagram.connect(motor, eso[0])
        watched = watched or motor
    with contextlib.redirect_stdout(io.StringIO()):
        diagram.compile()
    return simulation, diagram, watched


def run(model):
    simulation, diagram, watched = model
    with contextlib.redirect_stdout(io.StringIO()):
        made = simulation.run(
            diagram, stop, dt=p.EVERY, solver="RK45", solver_args={"rtol": p.RTOL, "atol": p.ATOL}, watch=[watched]
        )
    return made.t, made.y0


if kind == "fixed":
    raise SystemExit("no fixed step")
p.report(build, run, path)
