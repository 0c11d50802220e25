"""P1 and P2 with bdsim. Its integrators are SciPy's: there is no fixed step."""

import contextlib
import io

import bdsim
import problem as p

kind, count, stop, path = p.arguments()
A, B, G = p.MOTOR_A, p.MOTOR_B, p.LAW[0]


def build():
    simulation = bdsim.BDSim(graphics=False, progress=False)
    diagram = simulation.blockdiagram()
    watched = None
    for number in range(count):
        # Its LTI_SS refuses to have several outputs: integrators, and a function of each.
        w, i, *z = (diagram.INTEGRATOR(0, name=f"{name}{number}") for name in ("w", "i", "z1_", "z2_", "z3_"))
        limit = diagram.CLIP(-p.LIMIT, p.LIMIT, name=f"limit{number}")
        load = diagram.PIECEWISE((0, 0.0), (p.ON, p.PULSE), (p.OFF, 0.0), name=f"load{number}")

        def function(name, made, *sources):
            block = diagram.FUNCTION(made, nin=len(sources), name=f"{name}{number}")  # noqa: B023
            for place, source in enumerate(sources):
                diagram.connect(source, block[place])
            return block

        diagram.connect(function("law", lambda a, b, c: G[0] + G[1] * a + G[2] * b + G[3] * c, *z), limit)
        diagram.connect(function("dw", lambda w, i, d: A[0, 0] * w + A[0, 1] * i + B[0, 1] * d, w, i, load), w)
        diagram.connect(function("di", lambda w, i, u: A[1, 0] * w + A[1, 1] * i + B[1, 0] * u, w, i, limit), i)
        diagram.connect(function("dz1_", lambda w, a, b: b + 30.4 * (w - a), w, z[0], z[1]), z[0])
        diagram.connect(function("dz2_", lambda w, a, b, u: b + p.B0 * u + 513.4 * (w - a), w, z[0], z[2], limit), z[1])
        diagram.connect(function("dz3_", lambda w, a: 1570.8 * (w - a), w, z[0]), z[2])
        watched = watched or w
    with contextlib.redirect_stdout(io.StringIO()):
        diagram.compile()
    return simulation, diagram, watched


def run(model):
    simulation, diagram, watched = model
    with contextlib.redirect_stdout(io.StringIO()):
        made = simulation.run(
            diagram, stop, dt=p.EVERY, solver="RK45", solver_args={"rtol": p.RTOL, "atol": p.ATOL}, watch=[watched]
        )
    return made.t, made.y[:, 0]


if kind == "fixed":
    raise SystemExit("no fixed step")
p.report(build, run, path)
