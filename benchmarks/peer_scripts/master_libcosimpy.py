"""libcosim by libcosimpy: the fixed-step algorithm, which is Jacobi with held inputs. It knows FMI 1 and 2."""

import master_problem as p
from libcosimpy.CosimEnums import CosimVariableType
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

path, version, shape, count, steps = p.arguments()
if version == 3:
    raise SystemExit("knows no FMI 3")


def build(kind):
    execution = CosimExecution.from_step_size(round(p.STEP * 1e9))
    slaves = [CosimLocalSlave(fmu_path=path, instance_name=f"f{i}") for i in range(count)]
    places = [execution.add_local_slave(slave) for slave in slaves]
    for place, start in zip(places, p.starts(shape, count), strict=True):
        execution.real_initial_value(place, p.Y0, start)
    for source, sink in p.wires(shape, count):
        execution.connect_real_variables(places[source], p.Y, places[sink], p.U)
    observer = None
    if kind == "recorded":
        observer = CosimObserver.create_time_series(buffer_size=steps + 1)
        execution.add_observer(observer)
        for place in places:
            observer.start_time_series(place, p.Y, CosimVariableType.REAL)
    # Initialization belongs to the first step, and thus to loading.
    if not execution.step(1):
        raise SystemExit("the first step failed")
    return execution, slaves, places, observer


def run(model):
    if not model[0].step(steps - 1):
        raise SystemExit("a step failed")


def last(model):
    _, _, places, observer = model
    if observer is None:
        return None
    # From the last step on, of which there is one sample.
    return [observer.time_series_real_samples(place, p.Y, steps, 1)[2][0] for place in places]


p.report(build, run, last=last)
