"""A loop in Python over FMPy's FMU2Slave or FMU3Slave, each with a folder of its own, as FMPy's own examples do it."""

import shutil

import fmpy
import master_problem as p
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

path, version, shape, count, steps = p.arguments()
wires = p.wires(shape, count)


def build(kind):
    description = fmpy.read_model_description(path)
    made = []
    for i, start in enumerate(p.starts(shape, count)):
        slave = (FMU2Slave if version == 2 else FMU3Slave)(
            guid=description.guid,
            unzipDirectory=fmpy.extract(path),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=f"f{i}",
        )
        slave.instantiate()
        if version == 2:
            slave.setupExperiment(startTime=0.0, stopTime=steps * p.STEP)
            slave.setReal([p.Y0], [start])
            slave.enterInitializationMode()
        else:
            slave.setFloat64([p.Y0], [start])
            slave.enterInitializationMode(startTime=0.0, stopTime=steps * p.STEP)
        slave.exitInitializationMode()
        made.append(slave)
    return kind, made


def run(model):
    kind, slaves = model
    rows, u, y = [], [p.U], [p.Y]
    gets = [slave.getReal if version == 2 else slave.getFloat64 for slave in slaves]
    sets = [(slaves[sink].setReal if version == 2 else slaves[sink].setFloat64, source) for source, sink in wires]
    for k in range(steps):
        t = k * p.STEP
        values = [get(y) for get in gets]
        if kind == "recorded":
            rows.append([value for (value,) in values])
        for put, source in sets:
            put(u, values[source])
        for slave in slaves:
            slave.doStep(t, p.STEP)
    return [get(y)[0] for get in gets]


def close(model):
    for slave in model[1]:
        slave.terminate()
        slave.freeInstance()
        shutil.rmtree(slave.unzipDirectory, ignore_errors=True)


p.report(build, run, close=close)
