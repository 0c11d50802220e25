"""Run cases for some minutes, first those of the covering array, and write what disagrees to files.

python -m tests.support.meeting --seed 3 --minutes 10 --out /tmp/found
python -m tests.support.meeting --seed 3 --minutes 10 --fix touch=none fmu=none/me2
python -m tests.support.meeting --again /tmp/found/300017_1.json
"""

from __future__ import annotations

import argparse
import collections
import itertools
import json
import os
import random
import sys
import time
import traceback
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path

from . import covering, features
from .features import Case
from .shrinking import shrunk
from .ways import Disagreement, disagreements

os.environ.setdefault("BLOCKS_CACHE_DIR", str(Path(__file__).resolve().parents[3] / "build" / "test-cache"))


def cases(seed: int, fixed: Mapping[str, str] | None = None) -> Iterator[Case]:
    """Give the cases of the covering array, and then random ones without end; fixed: the level of some factors."""
    factors = {**features.FACTORS, **{name: level.split("/") for name, level in (fixed or {}).items()}}
    for number, row in enumerate(covering.rows(factors, features.allowed, seed)):
        yield features.case(row, 100000 * seed + number)
    rng = random.Random(seed)
    for number in itertools.count(1000):
        yield features.case(covering.any_row(factors, features.allowed, rng), 100000 * seed + number)


def kind_of(found: Disagreement) -> str:
    """Return what must stay the same while a case shrinks."""
    what = found.signal if found.signal in ("error", "event", "events") else "signal"
    codes = f"{found.ours[:4]} {found.theirs[:4]}" if what == "error" else ""
    pair = pair_of(found)
    return f"same; {' = '.join(pair)}" if pair else f"{found.way}; {what} {codes}".strip()


def pair_of(found: Disagreement) -> tuple[str, ...]:
    """Return the two signals of one run that should be equal."""
    a, equal, b = found.signal.partition(" at ")[0].partition(" = ")
    return (a, b) if equal else ()


def looked_at(case: Case) -> list[Disagreement]:
    """Run a case; an exception that no run should raise is a disagreement, too."""
    try:
        return disagreements(case)
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return [Disagreement("exception", "error", f"{type(error).__name__}: {error}"[:300], f"{last.name}")]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--out", type=Path, default=Path("build/meeting"), help="the folder of the cases that disagree")
    parser.add_argument("--again", type=Path, help="a file of a case: run it once more")
    parser.add_argument("--no-shrink", action="store_true")
    parser.add_argument("--fix", nargs="*", default=[], help="levels, as touch=none or part=held/reset")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if given.again:
        found = looked_at(json.loads(given.again.read_text(encoding="utf-8")))
        print("\n".join(map(str, found)) or "no disagreement")
        return bool(found)
    given.out.mkdir(parents=True, exist_ok=True)
    begin, count, kinds = time.monotonic(), 0, collections.Counter[str]()
    for count, case in enumerate(cases(given.seed, dict(text.split("=") for text in given.fix)), 1):  # noqa: B007
        found = looked_at(case)
        for kind in dict.fromkeys(map(kind_of, found)):
            kinds[kind] += 1
            wanted = next(one for one in found if kind_of(one) == kind)
            print(f"{case['seed']}: {wanted}  {case['row']}", flush=True)
            if kinds[kind] <= 2 and not given.no_shrink:

                def fails(smaller: Case, kind: str = kind) -> bool:
                    return kind in map(kind_of, looked_at(smaller))

                small = shrunk(case, fails, pair_of(wanted))
                file = given.out / f"{case['seed']}_{len(kinds)}.json"
                file.write_text(json.dumps(small, indent=1), encoding="utf-8")
                left = next((str(one) for one in looked_at(small) if kind_of(one) == kind), "")
                print(f"  {file}: {len(small['diagram']['blocks'])} blocks: {left}", flush=True)
        if time.monotonic() - begin > 60 * given.minutes:
            break
    took = time.monotonic() - begin
    print(f"seed {given.seed}: {count} cases in {took:.0f} s; disagreements by kind:")
    print(*(f"  {number:4d} {kind}" for kind, number in kinds.most_common()), sep="\n")
    return bool(kinds)


if __name__ == "__main__":
    sys.exit(main())
