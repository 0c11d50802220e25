"""An FMU 2 for Co-Simulation by libcosim: run_fmu_libcosimpy.py X.fmu STOP STEP OUT.csv {"outputs": ..., "starts": ..}.

Variables go by value reference here: both are {name: reference} and {reference: value}.
"""

import json
import sys

from libcosimpy.CosimEnums import CosimVariableType
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

path, stop, step, out, asked = sys.argv[1], float(sys.argv[2]), float(sys.argv[3]), sys.argv[4], json.loads(sys.argv[5])
execution = CosimExecution.from_step_size(round(step * 1e9))
slave = CosimLocalSlave(fmu_path=path, instance_name="f")
place = execution.add_local_slave(slave)
for reference, value in asked["starts"].items():
    execution.real_initial_value(place, int(reference), value)
steps = round(stop / step)
observer = CosimObserver.create_time_series(buffer_size=steps + 1)
execution.add_observer(observer)
for reference in asked["outputs"].values():
    observer.start_time_series(place, reference, CosimVariableType.REAL)
if not execution.step(steps):
    raise SystemExit("a step failed")
columns, times = [], None
for reference in asked["outputs"].values():
    told, _, values = observer.time_series_real_samples(place, reference, 1, steps)
    columns.append(list(values))
    times = [ns * 1e-9 for ns in told]
with open(out, "w", encoding="utf-8") as file:
    file.write(",".join(["time", *asked["outputs"]]) + "\n")
    for row in zip(times, *columns, strict=True):
        file.write(",".join(map(repr, row)) + "\n")
