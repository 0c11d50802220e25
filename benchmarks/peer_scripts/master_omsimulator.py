"""OMSimulator 2.1: its ordinary master of a weakly coupled system, without its result file."""

import master_problem as p
from OMSimulator import OMSimulator

path, version, shape, count, steps = p.arguments()
if version == 3:
    raise SystemExit("version 2.1 knows no FMI 3")
oms = OMSimulator()
oms.setCommandLineOption("--suppressPath=true --wallTime=false")


def build(kind):
    oms.newModel("model")
    oms.addSystem("model.root", oms.system_wc)
    for i, start in enumerate(p.starts(shape, count)):
        oms.addSubModel(f"model.root.f{i}", path)
        oms.setReal(f"model.root.f{i}.y0", start)
    for source, sink in p.wires(shape, count):
        oms.addConnection(f"model.root.f{source}.y", f"model.root.f{sink}.u")
    oms.setResultFile("model", "")
    oms.setFixedStepSize("model.root", p.STEP)
    oms.setStartTime("model", 0.0)
    oms.setStopTime("model", steps * p.STEP)
    oms.instantiate("model")
    oms.initialize("model")
    return "model"


def run(model):
    oms.simulate(model)


def last(model):
    return [oms.getReal(f"{model}.root.f{i}.y")[0] for i in range(count)]


def close(model):
    oms.terminate(model)
    oms.delete(model)


p.report(build, run, close=close, last=last, kinds=("plain",))
