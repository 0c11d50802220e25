"""`python -m benchmarks [NAME ...]` runs the benchmarks named, or all."""

import sys

from . import reference_engine, startup

BENCHMARKS = {"reference_engine": reference_engine.main, "startup": startup.main}


def main() -> int:
    names = sys.argv[1:] or list(BENCHMARKS)
    for name in names:
        if name not in BENCHMARKS:
            print(f"there is no benchmark {name!r}; there are {', '.join(BENCHMARKS)}", file=sys.stderr)
            return 2
    for name in names:
        print(f"== {name}")
        BENCHMARKS[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main())
