"""P1 and P2 as matrices, for every tool alike; and what a tool's script prints. It needs numpy alone.

A loop is a motor (inputs u, d; output w), an observer (inputs w, u; outputs z), a gain over (r, z), a limit of +-12, a
set point of 1, and a pulse d = 2 from 30 s to 50 s.
"""

import json
import sys
import time

import numpy as np

RTOL, ATOL = 1e-6, 1e-9
STEP, EVERY = 1e-3, 1e-2
LIMIT, PULSE, ON, OFF = 12.0, 2.0, 30.0, 50.0
J, N_GEAR, L, B0 = 0.2752, 3.0, 0.82, 1.755

MOTOR_A = np.array([[-0.3922 / J, 1.1882 / (J * N_GEAR)], [-1.185 * N_GEAR / L, -0.1557 / L]])
MOTOR_B = np.array([[0.0, -1.0 / (J * N_GEAR)], [1.0 / L, 0.0]])
MOTOR_C, MOTOR_D = np.array([[1.0, 0.0]]), np.zeros((1, 2))
ESO_A = np.array([[-30.4, 1.0, 0.0], [-513.4, 0.0, 1.0], [-1570.8, 0.0, 0.0]])
ESO_B = np.array([[30.4, 0.0], [513.4, B0], [1570.8, 0.0]])
ESO_C, ESO_D = np.eye(3), np.zeros((3, 2))
LAW = np.array([[144.0, -144.0, -25.0, -1.0]]) / B0


def arguments():
    """What to run: ("adaptive" | "fixed", number of loops, stop), and the file for the speed of the first loop."""
    kind, count, stop, path = sys.argv[1:]
    return kind, int(count), float(stop), path


def report(build, run, path, repeats=3):
    """Times build() -> model and run(model) -> (t, w), and writes what the last run gave.

    first: building and the first run. again: the least time of a run of a model that is there.
    """
    begun = time.perf_counter()
    model = build()
    built = time.perf_counter()
    t, w = run(model)
    first = time.perf_counter() - begun
    again = []
    for _ in range(repeats):
        if again and sum(again) > 60.0:
            break
        begun_again = time.perf_counter()
        t, w = run(model)
        again.append(time.perf_counter() - begun_again)
    np.savez(path, t=np.asarray(t, dtype=float), w=np.asarray(w, dtype=float))
    print(json.dumps({"build": built - begun, "first": first, "again": min(again)}))
