"""`python -m benchmarks [NAME ...]` runs the benchmarks named, or all."""

import os
import sys
import traceback

# Small products of matrices are not worth several threads, and on one core these wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from blocks.text.errors import BlocksError

from . import (
    building,
    container,
    drawing,
    editing,
    fleet,
    fmu,
    instants,
    large_fmu,
    linear,
    live,
    long_run,
    many_runs,
    master,
    measures,
    native_engine,
    prepared,
    reference_engine,
    sparse,
    start,
    startup,
    stiff,
    streamed,
)

BENCHMARKS = {
    "reference_engine": reference_engine.main,
    "startup": startup.main,
    "measures": measures.main,
    "robot": native_engine.main_robot,
    "p1": native_engine.main_p1,
    "p2": native_engine.main_p2,
    "irregular": native_engine.main_irregular,
    "instants": instants.main,
    "prepared": prepared.main,
    "fleet": fleet.main,
    "building": building.main,
    "many_runs": many_runs.main,
    "start": start.main,
    "memory": start.main_memory,
    "long_run": long_run.main,
    "stiff": stiff.main,
    "fmu": fmu.main,
    "large_fmu": large_fmu.main,
    "linear": linear.main,
    "live": live.main,
    "editing": editing.main,
    "master": master.main,
    "container": container.main,
    "streamed": streamed.main,
    "drawing": drawing.main,
    "sparse": sparse.main,
}


def main() -> int:
    names = sys.argv[1:] or list(BENCHMARKS)
    for name in names:
        if name not in BENCHMARKS:
            print(f"there is no benchmark {name!r}; there are {', '.join(BENCHMARKS)}", file=sys.stderr)
            return 2
    failed = 0
    for name in names:
        print(f"== {name}", flush=True)
        try:
            BENCHMARKS[name]()
        except (BlocksError, RuntimeError):  # the other benchmarks can still be measured
            traceback.print_exc()
            failed = 1
    return failed


if __name__ == "__main__":
    sys.exit(main())
