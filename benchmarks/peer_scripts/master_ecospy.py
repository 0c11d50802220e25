"""ecos by ecospy: its fixed-step algorithm. What it records goes into a CSV file.

It needs libtbb.so.12, which benchmarks/peers_master.py puts beside the environment where the machine has none.
"""

import ctypes
import os
import sys
import tempfile
from pathlib import Path

import master_problem as p

found = sorted((Path(sys.prefix) / "debian").rglob("libtbb.so.12"))
if found:
    ctypes.CDLL(str(found[0]), ctypes.RTLD_GLOBAL)

from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure  # noqa: E402

path, version, shape, count, steps = p.arguments()
EcosLib.set_log_level("warn")
folder = tempfile.mkdtemp()
table = os.path.join(folder, "rows.csv")


def build(kind):
    with EcosSimulationStructure() as structure:
        for i in range(count):
            structure.add_model(f"f{i}", path)
        for source, sink in p.wires(shape, count):
            structure.make_real_connection(f"f{source}::y", f"f{sink}::u")
        structure.add_parameter_set("starts", {f"f{i}::y0": s for i, s in enumerate(p.starts(shape, count))})
        simulation = EcosSimulation(structure=structure, step_size=p.STEP)
    if kind == "recorded":
        simulation.add_csv_writer(table, identifiers=[f"f{i}::y" for i in range(count)])
    simulation.init(parameter_set="starts")
    return simulation


def run(simulation):
    simulation.step(steps)


def last(simulation):
    return [simulation.get_real(f"f{i}::y") for i in range(count)]


def close(simulation):
    simulation.terminate()
    simulation.free()


try:
    p.report(build, run, close=close, last=last)
finally:
    for name in os.listdir(folder):
        os.remove(os.path.join(folder, name))
    os.rmdir(folder)
