"""P1 and P2 with Drake. It has no rk4 of fixed step: runge_kutta3 stands for it."""

import numpy as np
import problem as p
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    ConstantVectorSource,
    LinearSystem,
    LogVectorOutput,
    MatrixGain,
    Multiplexer,
    Saturation,
    TrajectorySource,
)
from pydrake.trajectories import PiecewisePolynomial

kind, count, stop, path = p.arguments()


def build():
    builder = DiagramBuilder()
    pulse = PiecewisePolynomial.ZeroOrderHold([0.0, p.ON, p.OFF, 1e9], np.array([[0.0, p.PULSE, 0.0, 0.0]]))
    for number in range(count):
        add = builder.AddSystem
        motor = add(LinearSystem(p.MOTOR_A, p.MOTOR_B, p.MOTOR_C, p.MOTOR_D))
        eso = add(LinearSystem(p.ESO_A, p.ESO_B, p.ESO_C, p.ESO_D))
        seen, law = add(Multiplexer([1, 3])), add(MatrixGain(p.LAW))
        limit = add(Saturation(np.array([-p.LIMIT]), np.array([p.LIMIT])))
        speed, load = add(ConstantVectorSource([1.0])), add(TrajectorySource(pulse))
        into_motor, into_eso = add(Multiplexer([1, 1])), add(Multiplexer([1, 1]))
        for source, sink in (
            (speed.get_output_port(), seen.get_input_port(0)),
            (eso.get_output_port(), seen.get_input_port(1)),
            (seen.get_output_port(), law.get_input_port()),
            (law.get_output_port(), limit.get_input_port()),
            (limit.get_output_port(), into_motor.get_input_port(0)),
            (load.get_output_port(), into_motor.get_input_port(1)),
            (into_motor.get_output_port(), motor.get_input_port()),
            (motor.get_output_port(), into_eso.get_input_port(0)),
            (limit.get_output_port(), into_eso.get_input_port(1)),
            (into_eso.get_output_port(), eso.get_input_port()),
        ):
            builder.Connect(source, sink)
        if number == 0:
            log = LogVectorOutput(motor.get_output_port(), builder)
    simulator = Simulator(builder.Build())
    if kind == "adaptive":
        ResetIntegratorFromFlags(simulator, "runge_kutta5", 1.0)
        simulator.get_mutable_integrator().set_fixed_step_mode(False)
        simulator.get_mutable_integrator().set_target_accuracy(p.RTOL)
    else:
        ResetIntegratorFromFlags(simulator, "runge_kutta3", p.STEP)
        simulator.get_mutable_integrator().set_fixed_step_mode(True)
    return simulator, log


def run(model):
    simulator, log = model
    context = simulator.get_mutable_context()
    simulator.get_system().SetDefaultContext(context)
    context.SetTime(0.0)
    log.FindMutableLog(context).Clear()
    simulator.Initialize()
    for edge in (p.ON, p.OFF):
        if edge < stop:
            simulator.AdvanceTo(edge)
    simulator.AdvanceTo(stop)
    made = log.FindLog(context)
    return made.sample_times().copy(), made.data()[0].copy()


p.report(build, run, path)
