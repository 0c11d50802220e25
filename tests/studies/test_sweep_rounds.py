"""Rows of a sweep that take many more steps than the others: they come last, and end."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, FirstOrder, Sine, Sweep
from blocks.compile.toolchain.compiler import find_compiler
from blocks.studies import sweep_run

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="without a compiler each call begins processes")
T = [0.1, 0.2, 1e-6, 0.15, 0.3, 0.25]
"""A row of some hundred steps takes 3 million where T is 1e-6."""


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep_run, "STEPS", 500)
    monkeypatch.setattr(sweep_run, "TIMES", 30)


def swept(values: list[float], **options: Any) -> Sweep:
    diagram = Diagram("lag")
    diagram.add("wave", Sine())
    lag = diagram.add("lag", FirstOrder(T=0.1))
    diagram.wire("lag.u", "wave.y")
    diagram.measure("top", "peak", lag.y)
    sweep: Sweep = diagram.sweep({"lag.T": values}, stop=10, engine="native", **options)
    return sweep


def told(sweep: Sweep) -> dict[str, Any]:
    return {
        "status": sweep.status.tolist(), "messages": sweep.messages, "steps": sweep.steps.tolist(),
        "top": sweep.measures["top"].tobytes(),
    }  # fmt: skip


def test_one_row_that_does_not_end_is_cut_short_after_all_others_are_done() -> None:
    done: list[int] = []
    named: list[tuple[int, str]] = []
    sweep = swept(T, progress=lambda count, _: done.append(count), notice=lambda text: named.append((done[-1], text)))
    assert sweep.status.tolist() == ["ok", "ok", "budget", "ok", "ok", "ok"]
    most = 30 * int(np.median(np.delete(sweep.steps, 2)))
    assert sweep.messages[2] == f"E313 lag: needs more than {most} steps, the most that it may take."
    ((_, said),) = named
    end = f"up to {most:,} steps"
    assert said == (
        f"more than 500 steps: row 2 (lag.T = 1e-06). All other rows are done; the sweep continues with these "
        f"rows, {end}."
    )
    alone = swept(T[:2] + T[3:])
    assert np.delete(sweep.measures["top"], 2).tobytes() == alone.measures["top"].tobytes()


def test_a_row_that_takes_long_and_ends_is_done_with_the_same_bits() -> None:
    values = [0.1, 0.2, 2e-3, 0.15, 0.3]  # 1,500 steps, within 30 times those of the others
    sweep, given = swept(values), swept(values, max_steps=10**9)
    assert sweep.steps[2] > 500
    assert told(sweep) == told(given)


def test_where_most_rows_take_long_none_is_cut_short() -> None:
    sweep = swept([1e-4, 2e-4, 0.1])
    assert sweep.status.tolist() == ["ok"] * 3
    assert sweep.steps[0] > 30 * sweep.steps[2]
    assert swept([1e-4]).status.tolist() == ["ok"]


def test_with_fixed_steps_no_row_begins_again() -> None:
    named: list[str] = []
    sweep = swept([0.1, 0.2, 0.3], method="rk4", step=0.01, notice=named.append)
    assert sweep.steps.tolist() == [1000] * 3
    assert not named


def test_a_budget_that_is_given_counts_alone() -> None:
    assert swept(T, max_steps=700).messages[2] == "E313 lag: needs more than 700 steps, the most that it may take."


@pytest.mark.parametrize("values", [T, [0.1, 0.2, 2e-3, 0.15, 0.3, 1e-6]])
def test_a_sweep_that_was_killed_between_its_rounds_goes_on_to_the_same_rows(
    tmp_path: Path, values: list[float]
) -> None:
    def interrupt(_: str) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "rows.parquet"
    first = swept(values, out=out, notice=interrupt)
    assert first.interrupted
    assert first.status[2] == "left"
    again = swept(values, out=out)
    assert told(again) == told(swept(values))


def test_a_sweep_that_was_killed_in_its_last_round_keeps_its_budget(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = [0.1, 0.2, 2e-3, 0.15, 0.3, 1e-6]
    whole = swept(values)
    keep: Callable[..., None] = sweep_run._Made.keep

    def kept(made: Any, at: Any, rows: Any) -> None:
        keep(made, at, rows)
        if "ok" in rows.status[at == 2]:  # the long row is written, and changes the median of all that are done
            raise KeyboardInterrupt

    out = tmp_path / "rows.parquet"
    with monkeypatch.context() as patch:
        patch.setattr(sweep_run._Made, "keep", kept)
        assert swept(values, out=out, threads=1).status.tolist() == ["ok"] * 5 + ["left"]
    assert told(swept(values, out=out, threads=1)) == told(whole)
