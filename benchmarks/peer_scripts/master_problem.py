"""A chain or ring of tiny FMUs, for every tool alike; and what a tool's script prints. It needs nothing but Python.

The FMU has the input u (value reference 0), the output y (1) and the parameter y0 (2), which y starts from.
"""

import json
import sys
import time

STEP = 1e-3
U, Y, Y0 = 0, 1, 2


def arguments():
    """The FMU's path, its version of FMI, "chain" or "ring", the number of instances, the steps."""
    path, version, shape, count, steps = sys.argv[1:]
    return path, int(version), shape, int(count), int(steps)


def wires(shape, count):
    """Pairs of instances: whose output, whose input."""
    return [*((i - 1, i) for i in range(1, count)), *([(count - 1, 0)] if shape == "ring" else [])]


def starts(shape, count):
    """The start of each y: in a ring the first is 1."""
    return [1.0 if shape == "ring" and i == 0 else 0.0 for i in range(count)]


def report(build, run, *, close=lambda model: None, last=None, kinds=("plain", "recorded"), repeats=5, longest=8.0):
    """Times build(kind) -> model and run(model), and prints the least times.

    run returns the outputs at the end where the tool tells them, else None; last(model) reads them after the clock
    stopped. kinds: without and with every output kept at every step. No more repeats after `longest` s of one kind.
    """
    told = {"load": float("inf"), "last": None}
    for kind in kinds:
        told[kind], spent = float("inf"), 0.0
        for _ in range(repeats):
            begun = time.perf_counter()
            model = build(kind)
            built = time.perf_counter()
            made = run(model)
            done = time.perf_counter()
            told["load"] = min(told["load"], built - begun)
            told[kind] = min(told[kind], done - built)
            made = last(model) if last is not None else made
            told["last"] = told["last"] if made is None else list(made)
            close(model)
            del model
            spent += time.perf_counter() - begun
            if spent > longest:
                break
    print("\n" + json.dumps(told))
