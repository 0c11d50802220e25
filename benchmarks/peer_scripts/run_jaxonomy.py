"""P1 and P2 with jaxonomy. The compiled diagram is kept between runs."""

import jaxonomy
import numpy as np
import problem as p
from jaxonomy.library import Adder, Constant, Gain, LTISystem, Multiplexer, Saturate, Step, SumOfElements

kind, count, stop, path = p.arguments()


def build():
    builder = jaxonomy.DiagramBuilder()
    watched = None
    for number in range(count):
        add = builder.add
        motor = add(LTISystem(p.MOTOR_A, p.MOTOR_B, p.MOTOR_C, p.MOTOR_D, name=f"motor{number}"))
        eso = add(LTISystem(p.ESO_A, p.ESO_B, p.ESO_C, p.ESO_D, name=f"eso{number}"))
        seen, law = add(Multiplexer(2, name=f"seen{number}")), add(Gain(p.LAW[0], name=f"law{number}"))
        total = add(SumOfElements(name=f"total{number}"))
        limit = add(Saturate(upper_limit=p.LIMIT, lower_limit=-p.LIMIT, name=f"limit{number}"))
        speed, load = add(Constant(1.0, name=f"speed{number}")), add(Adder(2, name=f"load{number}"))
        on = add(Step(0.0, p.PULSE, p.ON, name=f"on{number}"))
        off = add(Step(0.0, -p.PULSE, p.OFF, name=f"off{number}"))
        into_motor, into_eso = add(Multiplexer(2, name=f"um{number}")), add(Multiplexer(2, name=f"ue{number}"))
        for source, sink, place in (
            (speed, seen, 0),
            (eso, seen, 1),
            (seen, law, 0),
            (law, total, 0),
            (total, limit, 0),
            (limit, into_motor, 0),
            (on, load, 0),
            (off, load, 1),
            (load, into_motor, 1),
            (into_motor, motor, 0),
            (motor, into_eso, 0),
            (limit, into_eso, 1),
            (into_eso, eso, 0),
        ):
            builder.connect(source.output_ports[0], sink.input_ports[place])
        watched = watched or motor.output_ports[0]
    diagram = builder.build()
    given = {"ode_solver_method": "dopri5", "rtol": p.RTOL, "atol": p.ATOL}
    if kind == "fixed":
        given = {"ode_solver_method": "rk4", "max_minor_step_size": p.STEP, "min_minor_step_size": p.STEP}
    options = jaxonomy.SimulatorOptions(save_time_series=True, **given)
    return diagram, diagram.create_context(), options, watched


def run(model):
    diagram, context, options, watched = model
    made = jaxonomy.simulate(diagram, context, (0.0, stop), options=options, recorded_signals={"w": watched})
    return made.time, np.asarray(made.outputs["w"]).reshape(len(made.time))


p.report(build, run, path)
