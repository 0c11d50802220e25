"""One FMU for Co-Simulation by ecos: run_fmu_ecospy.py X.fmu STOP STEP OUT.csv {"outputs": [...], "starts": {...}}."""

import ctypes
import json
import sys
from pathlib import Path

found = sorted((Path(sys.prefix) / "debian").rglob("libtbb.so.12"))
if found:
    ctypes.CDLL(str(found[0]), ctypes.RTLD_GLOBAL)

from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure  # noqa: E402

path, stop, step, out, asked = sys.argv[1], float(sys.argv[2]), float(sys.argv[3]), sys.argv[4], json.loads(sys.argv[5])
EcosLib.set_log_level("warn")
with EcosSimulationStructure() as structure:
    structure.add_model("f", path)
    structure.add_parameter_set("starts", {f"f::{name}": value for name, value in asked["starts"].items()})
    simulation = EcosSimulation(structure=structure, step_size=step)
simulation.init(parameter_set="starts")
rows = []
for k in range(round(stop / step) + 1):
    if k:
        simulation.step(1)
    rows.append([k * step, *(simulation.get_real(f"f::{name}") for name in asked["outputs"])])
simulation.terminate()
simulation.free()
with open(out, "w", encoding="utf-8") as file:
    file.write(",".join(["time", *asked["outputs"]]) + "\n")
    file.writelines(",".join(map(repr, row)) + "\n" for row in rows)
