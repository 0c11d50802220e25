"""Copies, switched parts, FMUs, projections, ticks and methods meet in random diagrams; all ways to run them agree.

SEED=7 runs the cases of another seed; `python -m tests.support.meeting --seed 7 --minutes 10` goes on beyond them, and
writes a small file of each case that disagrees.
"""

from __future__ import annotations

import itertools
import json
import os
import random

import pytest

from tests.support.marks import long_but
from tests.support.meeting import covering, features
from tests.support.meeting.features import FACTORS, Case, allowed
from tests.support.meeting.shrinking import shrunk
from tests.support.meeting.ways import disagreements

SEED = int(os.environ.get("SEED", "1"))
ROWS = covering.rows(FACTORS, allowed, SEED)
SHORT, LONG = 64, 300
PARTS = 10
"""Into which the cases are divided, so that several workers share them."""


def cases(count: int) -> list[Case]:
    """Return the cases of the covering array, and as many random ones behind them as are missing."""
    rng = random.Random(SEED)
    rows = [*ROWS, *(covering.any_row(FACTORS, allowed, rng) for _ in range(count - len(ROWS)))]
    return [features.case(row, 100_000 * SEED + number) for number, row in enumerate(rows)]


def assert_agreement(chosen: list[Case]) -> None:
    failed = []
    for case in chosen:
        found = disagreements(case)
        failed += [f"case {case['seed']}: {one}" for one in found[:3]]
    assert not failed, "\n".join(failed)


# Two of ten cases run in `make test`; all pairs of capabilities have met after `make test-long`.
@pytest.mark.parametrize("part", long_but(range(PARTS), lambda part: part in (1, 5)))
def test_all_ways_to_run_a_diagram_agree_where_capabilities_meet(part: int) -> None:
    assert_agreement(cases(SHORT)[part::PARTS])


@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
def test_all_ways_agree_in_many_more_diagrams(part: int) -> None:
    assert_agreement(cases(LONG)[SHORT:][part::PARTS])


def test_the_cases_have_each_pair_of_capabilities() -> None:
    assert len(ROWS) <= SHORT
    assert all(map(allowed, ROWS))
    for a, b in itertools.combinations(FACTORS, 2):
        met = {(row[a], row[b]) for row in ROWS}
        wanted = {(x, y) for x, y in itertools.product(FACTORS[a], FACTORS[b]) if allowed({a: x, b: y})}
        assert met == wanted


def two_gains(k: float) -> Case:
    gains = {name: {"type": "Gain", "parameters": {"k": value}} for name, value in (("a", 2.0), ("b", k))}
    spare = {f"spare{n}": {"type": "FirstOrder"} for n in range(5)}
    document = {
        "format": "blocks-diagram", "version": 3, "name": "gains",
        "blocks": {"wave": {"type": "Sine"}, "middle": {"type": "Gain"}, **gains, **spare},
        "wires": {"middle.u": "wave.y", "a.u": "middle.y", "b.u": "middle.y", **{f"{name}.u": "a.y" for name in spare}},
        "run": {"stop": 1, "every": 0.25, "method": "rk4", "step": 0.05},
    }  # fmt: skip
    same = [["a.y", "b.y", "near"]]
    return {
        "row": {}, "seed": 0, "diagram": document, "fmus": {}, "same": same, "values": {}, "ways": ["reference"],
    }  # fmt: skip


def test_signals_that_should_be_equal_and_are_not_are_reported() -> None:
    assert disagreements(two_gains(2.0)) == []
    first, second = disagreements(two_gains(2.0 + 1e-8))
    assert (first.way, second.way) == ("same, native", "same, reference")
    assert first.signal == "a.y = b.y at 0.25 s"


def test_a_failing_case_shrinks_to_what_it_needs() -> None:
    small = shrunk(two_gains(2.5), lambda case: bool(disagreements(case)), ("a.y", "b.y"))
    assert list(small["diagram"]["blocks"]) == ["wave", "a", "b"]
    assert small["diagram"]["wires"] == {"a.u": "wave.y", "b.u": "wave.y"}
    assert small["ways"] == []
    assert disagreements(json.loads(json.dumps(small)))
