"""PyFMI's Master, Jacobi with held inputs. It knows FMI 2 here; it keeps every output in any case."""

import logging
import os
import tempfile

import master_problem as p
from pyfmi import load_fmu
from pyfmi.master import Master

path, version, shape, count, steps = p.arguments()
if version == 3:
    raise SystemExit("its Master knows no FMI 3")
os.chdir(tempfile.mkdtemp())
logging.disable(logging.WARNING)


def build(kind):
    models = [load_fmu(path, kind="CS", log_level=0) for _ in range(count)]
    for model, start in zip(models, p.starts(shape, count), strict=True):
        model.set("y0", start)
    connections = [(models[source], "y", models[sink], "u") for source, sink in p.wires(shape, count)]
    return models, Master(models, connections)


def run(model):
    _, master = model
    options = master.simulate_options()
    options["step_size"] = p.STEP
    options["extrapolation_order"] = 0
    options["result_handling"] = "memory"
    master.simulate(start_time=0.0, final_time=steps * p.STEP, options=options)


def last(model):
    return [float(one.get("y")[0]) for one in model[0]]


p.report(build, run, last=last, kinds=("recorded",))
