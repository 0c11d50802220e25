"""Batches: each row is the run that it stands for, bit for bit, whatever runs beside it."""

import contextlib
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    Diagram,
    FirstOrder,
    Gain,
    Integrator,
    LookupTable,
    Noise,
    Parameter,
    Product,
    Ramp,
    Relay,
    Sine,
    Stepped,
    Sum,
    TransportDelay,
    ZeroOrderHold,
    stepper,
)
from blocks.api import batch as batches
from blocks.api.batch import BatchRows
from blocks.model.varied import columns_of
from blocks.text.arrays import Array
from blocks.text.errors import BlocksError, ModelError, UsageError
from tests.support.documents import SHIPPED, span

pytestmark = pytest.mark.usefixtures("native")


def same(rows: BatchRows, i: int, diagram: Diagram, **given: Any) -> None:
    """Row i is what a run of a fresh copy gives."""
    fault, results = "", None
    try:
        results = diagram.copy().run(**given)
    except BlocksError as error:
        fault = error.code
    if results is None:
        assert rows.status[i] == ("diverged" if fault.startswith("E3") else "refused")
        assert rows.messages[i].startswith(fault)
        return
    assert rows.status[i] == "ok"
    assert rows.steps[i] == results.statistics.steps + results.statistics.rejected
    for name, column in rows.measures.items():
        assert np.array([column[i]]).tobytes() == np.array([results.measures[name]]).tobytes(), name
    for name, signals in rows.signals.items():
        assert signals[i].tobytes() == results[name].tobytes(), name
    if rows.signals:
        assert rows.t.tobytes() == results.t.tobytes()


def varied(diagram: Diagram) -> dict[str, float]:
    """Some parameters of a diagram that have one number each and are not bound, with their values."""
    flat, found = diagram.flatten(), dict[str, float]()
    for name in diagram.value.parameters:
        with contextlib.suppress(ModelError):
            found[name] = columns_of([name], flat)[0].value
    found = {name: value for name, value in found.items() if np.isfinite(value)}
    for block in flat.blocks:
        for key in block.interface.symbolic_parameters.keys() - {*block.interface.declaration.streams}:
            value = block.resolved.values[key].value
            if not isinstance(value, (str, bool)) and value is not None and not np.ndim(value):
                with contextlib.suppress(ModelError):
                    columns_of([f"{block.path}.{key}"], flat)
                    found[f"{block.path}.{key}"] = float(value)
    names = sorted(found)
    return {name: found[name] for name in names[:: max(1, len(names) // 5)]}


FEW = ("adrc", "quarter_car", "bouncing_ball", "sampled_loop", "motor_pid")


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=[] if path.stem in FEW else pytest.mark.long)
        for path in SHIPPED
        if "fmu" not in path.stem
    ],
)
def test_a_row_is_the_run_of_its_values(path: Path) -> None:
    """All shipped diagrams: one parameter after the other gets other values, which may be refused or diverge."""
    diagram = Diagram.load(path)
    known, log = varied(diagram), [name for name in diagram.flatten().log if "." in name][:3]
    table = [list(known.values())]
    for k, value in enumerate(known.values()):
        table += [[*table[0][:k], other, *table[0][k + 1 :]] for other in (value * 1.25, value * 0.8 + 1e-3)]
    stop = span(path, 1.0)
    settings: dict[str, Any] = {"stop": stop, "every": stop / 8, "log": log}
    rows = diagram.batch(list(known), **settings)(table, threads=2, seeds=range(len(table)))
    for i, row in enumerate(table):
        same(rows, i, diagram, parameters=dict(zip(known, row, strict=True)), seed=i, **settings)


def noisy() -> Diagram:
    """A loop with noise, a delay, events and ticks."""
    d = Diagram("noisy")
    for name, block in {
        "noise": Noise(period=0.01), "wave": Sine(omega=7.0), "sum": Sum(signs="++-"), "lag": FirstOrder(T=0.1),
        "relay": Relay(on_at=0.2, off_at=-0.2), "late": TransportDelay(delay=0.03), "hold": ZeroOrderHold(period=0.05),
    }.items():  # fmt: skip
        d.add(name, block)
    wires = {
        "sum.u1": "wave.y", "sum.u2": "noise.y", "sum.u3": "late.y", "lag.u": "sum.y", "relay.u": "lag.y",
        "late.u": "lag.y", "hold.u": "relay.y",
    }  # fmt: skip
    for sink, source in wires.items():
        d.wire(sink, source)
    d.measure("effort", "total_variation", of="lag.y")
    d.measure("settled", "settling_time", of="lag.y", against=0.0, band=0.5)
    d.measure("ise", "ISE", of="sum.y", start=0.5)
    d.settings(stop=2.0, every=0.1)
    return d


NAMES = ["wave.omega", "lag.T", "hold.period"]


def rows_of(count: int) -> list[list[float]]:
    """Values of NAMES; the last one fixes more than numbers."""
    return [[3.0 + i, 0.05 + 0.01 * i, (0.05, 0.04)[i % 2]] for i in range(count)]


def test_threads_order_pieces_and_neighbours_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    batch, table = noisy().batch(NAMES, log=["lag.y", "hold.y"]), rows_of(12)
    whole = batch(table, seeds=range(12), threads=1)
    monkeypatch.setattr(batches, "PIECE", 1)
    pieces = noisy().batch(NAMES, log=["lag.y", "hold.y"])
    for threads, other in ((2, batch), (5, batch), (2, pieces)):
        again = other(table, seeds=range(12), threads=threads)
        assert again.signals["lag.y"].tobytes() == whole.signals["lag.y"].tobytes()
        assert all(again.measures[name].tobytes() == column.tobytes() for name, column in whole.measures.items())
    assert {*whole.status} == {"ok"}
    for i in (0, 5, 11):
        same(whole, i, noisy(), parameters=dict(zip(NAMES, table[i], strict=True)), seed=i, log=["lag.y", "hold.y"])
    order = [7, 3, 11, 0]
    some = batch([table[i] for i in order], seeds=order, threads=2)
    for k, i in enumerate(order):
        assert some.signals["lag.y"][k].tobytes() == whole.signals["lag.y"][i].tobytes()
        for name, column in some.measures.items():
            assert column[k].tobytes() == whole.measures[name][i].tobytes()
    alone = batch.single(table[3], seed=3)
    told = {name: str(float(column[3])) for name, column in whole.measures.items()}
    assert {name: str(value) for name, value in alone.measures.items()} == told


def lagging() -> Diagram:
    """dx/dt = -x(t - T), x = x0 up to t = 0."""
    d = Diagram("lagging")
    T, x0 = d.parameter("T", 1.0, unit="s"), d.parameter("x0", 1.0)
    d.add("x", Integrator(y_start=x0))
    d.add("late", TransportDelay(delay=T, y_before=x0))
    d.add("gain", Gain(k=-1.0))
    for sink, source in {"late.u": "x.y", "gain.u": "late.y", "x.u": "gain.y"}.items():
        d.wire(sink, source)
    return d


def by_steps(t: Array, T: float, x0: float) -> Array:
    """The same by the method of steps: a polynomial more in each interval of T."""
    total = np.zeros_like(t)
    for n in range(int(t[-1] / T) + 2):
        total += np.where(t >= (n - 1) * T, (-1) ** n * (t - (n - 1) * T) ** n / math.factorial(n), 0.0)
    return x0 * total


@pytest.mark.parametrize("settings", [{}, {"method": "rk4", "step": 0.01}, {"method": "radau"}], ids=str)
def test_a_delay_is_bound_as_other_values_are(settings: dict[str, Any]) -> None:
    """Runs of their own agree bit for bit, and the method of steps to the tolerance."""
    d = lagging()
    settings = settings | {"log": ["x.y", "late.y"], "stop": 3.0, "every": 0.125, "rtol": 1e-8}
    batch = d.batch(["T", "x0"], **settings)
    table = [[0.7, 1.0], [0.3, 2.0], [1.9, -1.0], [0.05, 0.5], [7.0, 1.0], [0.0, 1.0], [-1.0, 1.0], [1e-16, 1.0]]
    rows = batch(table, threads=2)
    assert rows.status.tolist() == ["ok"] * 5 + ["refused"] * 3
    assert len(batch._forms) == 1, "all delays have one model"
    assert rows.messages[5] == "E107 late.delay: must be above 0, not 0.0."
    for i, (T, x0) in enumerate(table):
        same(rows, i, d, parameters={"T": T, "x0": x0}, **settings)
        if rows.status[i] == "ok":
            assert rows.signals["x.y"][i] == pytest.approx(by_steps(rows.t, T, x0), abs=1e-6)


def square() -> Diagram:
    """dx/dt = k x^2, which is 1/(1 - k t)."""
    d = Diagram("square")
    d.add("x", Integrator(y_start=1.0))
    d.add("square", Product())
    d.add("gain", Gain(k=-1.0))
    for sink, source in {"square.u1": "x.y", "square.u2": "x.y", "gain.u": "square.y", "x.u": "gain.y"}.items():
        d.wire(sink, source)
    d.measure("last", "peak", of="x.y")
    return d


def test_a_row_that_fails_leaves_the_others_as_they_are() -> None:
    d = square()
    table: list[list[Any]] = [[-1.0], [2.0], [float("nan")], [-1e4], [-2.0], ["text"]]
    rows = d.batch(["gain.k"], stop=0.75, log=["x.y"])(table, max_steps=5000)
    assert rows.status.tolist() == ["ok", "diverged", "refused", "ok", "ok", "refused"]
    assert np.isnan(rows.measures["last"]).tolist() == [False, True, True, False, False, True]
    assert rows.signals["x.y"][0, -1] == pytest.approx(1 / 1.75, rel=1e-4)  # dx/dt = k x^2
    assert rows.messages[1].startswith("E301 ")
    assert "t = 0.5" in rows.messages[1] or "t = 0.49999" in rows.messages[1]
    assert rows.messages[2].startswith("E107 gain.k")
    assert np.isfinite(rows.signals["x.y"][1]).any()
    assert np.isnan(rows.signals["x.y"][1, -1])
    short = d.batch(["gain.k"], stop=0.75)(table, max_steps=int(rows.steps[0]))
    assert short.status[0] == "ok"
    assert short.status[3] == "budget"
    assert short.steps[3] == rows.steps[0]
    assert short.messages[3].startswith("E313 square")


def test_what_is_wrong_with_an_element_names_its_column() -> None:
    d = Diagram("curve")
    d.add("ramp", Ramp())
    d.add("curve", LookupTable())
    d.wire("curve.u", "ramp.y")
    batch = d.batch(["curve.values[1]"], stop=1.0)
    assert batch([[float("nan")]]).messages == ("E107 curve.values[1]: must be a finite number, not nan.",)
    with pytest.raises(UsageError, match=r"E501 curve.values\[1\]: the table has no such column"):
        batch.single({})


def test_rows_that_are_all_refused_are_refused_again() -> None:
    batch = noisy().batch(["lag.T"])
    assert batch([[0.1]]).status.tolist() == ["ok"]
    assert batch([[float("nan")], [-1.0]]).status.tolist() == ["refused", "refused"]


def test_a_form_that_begins_with_an_expression_takes_no_row_for_it() -> None:
    table = [[0.05, 3.0], [0.04, "=2+1"], [0.04, 5.0], [0.04, 7.0]]
    rows = noisy().batch(["hold.period", "wave.omega"], log=["hold.y"])(table)
    for i, (period, omega) in enumerate(table):
        same(rows, i, noisy(), parameters={"hold.period": period, "wave.omega": omega}, log=["hold.y"])


def test_arrays_that_print_alike_are_told_apart() -> None:
    d = Diagram("curve")
    d.add("ramp", Ramp())
    d.add("curve", LookupTable(points=np.linspace(0.0, 1.0, 1500), values=np.zeros(1500)))
    d.wire("curve.u", "ramp.y")
    d.measure("peak", "peak", of="curve.y")
    tall = np.zeros(1500)
    tall[700] = 3.0
    rows = d.batch(["curve.values"], stop=1.0)([[np.zeros(1500)], [tall]])
    assert rows.measures["peak"] == pytest.approx([0.0, 3.0])


def test_rows_with_times_of_their_own_record_no_signals() -> None:
    d = noisy()
    d.parameter("T", 2.0, unit="s")
    d.settings(stop="=T")
    rows = d.batch(["T"], log=["lag.y"])([[2.0], [1.0]])
    assert rows.status.tolist() == ["ok", "refused"]
    assert rows.messages[1].startswith("E501 row: the row changes start, stop or every")
    rows = d.batch(["T"])([[2.0], [1.0]])
    for i, T in enumerate((2.0, 1.0)):
        same(rows, i, d, parameters={"T": T})


def test_a_row_that_never_ends_is_cut_short() -> None:
    d = noisy()
    d.settings(stop=1e9)
    rows = d.batch(["lag.T"], every=1e8)([[0.1], [0.2]], max_steps=2000)
    assert rows.status.tolist() == ["budget", "budget"]


def test_an_interrupt_keeps_what_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(done: int, total: int) -> None:
        if done >= 3:
            raise KeyboardInterrupt

    rows = noisy().batch(["lag.T"], stop=50.0)([[0.1 + 0.01 * k] for k in range(20)], threads=1, progress=interrupt)
    assert rows.interrupted
    assert {*rows.status} == {"ok", "left"}
    assert np.isnan(rows.measures["effort"][rows.status == "left"]).all()
    assert not np.isnan(rows.measures["effort"][rows.status == "ok"]).any()


def test_what_progress_raises_goes_through() -> None:
    def fail(done: int, total: int) -> None:
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError, match="no more"):
        noisy().batch(["lag.T"])([[0.1]] * 4, progress=fail)


class Doomed(Block):
    """A program that takes its process with it where the gain is 3."""

    k = Parameter(1.0)
    y = Stepped(0.0)

    @stepper(every=0.1)
    def program(k):  # type: ignore[no-untyped-def]
        return _Program(k)


class _Program:
    def __init__(self, k: float) -> None:
        self.k = k

    def step(self, t: float) -> float:
        if self.k == 3.0:
            os._exit(7)
        if self.k == 4.0:
            raise RuntimeError("four")
        return self.k * t


def test_programs_run_in_processes_and_one_that_dies_takes_its_row_alone() -> None:
    d = Diagram("doomed")
    d.add("program", Doomed())
    batch = d.batch(["program.k"], stop=1.0, log=["program.y"], every=0.5)
    assert batch.how(4, 2) == "2 processes: it has blocks with programs in Python"
    rows = batch([[1.0], [3.0], [4.0], [2.0]], threads=2)
    assert rows.status.tolist() == ["ok", "failed", "failed", "ok"]
    assert "exit code 7" in rows.messages[1]
    assert "four" in rows.messages[2]
    assert rows.signals["program.y"][3].tolist() == [0.0, 1.0, 2.0]


UNGUARDED = """
from blocks import Diagram
{classes}
def main():
    print("begun")
    d = Diagram("mine")
    d.add("mine", Mine())
    d.measure("p", "peak", of="mine.y")
    rows = d.batch(["mine.k"], stop=1.0)([[2.0], [3.0]], threads=1)
    print(rows.how, *rows.measures["p"])
{begin}
"""
CLASSES = """
from blocks import Block, Parameter, Stepped, stepper
class Mine(Block):
    k = Parameter(1.0)
    y = Stepped(0.0)
    @stepper(every=0.25)
    def program(k):
        return Program(k)
class Program:
    def __init__(self, k): self.k = k
    def step(self, t):
        print("printed")
        return self.k
"""


@pytest.mark.parametrize(
    ("inside", "begin", "how"),
    [
        (False, "main()", "1 process: it has blocks with programs in Python"),
        (
            True,
            "main()",
            "this process only: it has blocks with programs in Python, and other processes cannot "
            "load block types of __main",
        ),
        pytest.param(True, 'if __name__ == "__main__": main()', "1 process: it has", marks=pytest.mark.long),
    ],
    ids=["of a module", "of the script", "of a script with a guard"],
)
def test_a_plain_script_runs_rows_once(inside: bool, begin: str, how: str, tmp_path: Path) -> None:
    """Processes do not import the script; so it says where rows run that need what it defines."""
    (tmp_path / "mine.py").write_text(CLASSES)
    script = tmp_path / "plain.py"
    script.write_text(UNGUARDED.format(classes=CLASSES if inside else "from mine import Mine", begin=begin))
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60)
    told = [line for line in done.stdout.splitlines() if line != "printed"]
    assert len(told) == 2, done.stderr[-2000:]
    assert told[0] == "begun"
    assert told[1].startswith(how)
    assert told[1].endswith(" 2.0 3.0")
    assert not done.stderr.replace("printed\n", "")


@pytest.mark.parametrize("method", ["radau", "auto"])
def test_stiff_rows_are_those_of_runs_and_run_in_threads(method: str) -> None:
    d = noisy()
    rows = d.batch(["lag.T"], method=method, log=["lag.y"])([[0.1], [0.2], [1e-5]], seeds=[1, 2, 3], threads=2)
    assert "thread" in rows.how
    for i, T in enumerate((0.1, 0.2, 1e-5)):
        same(rows, i, noisy(), parameters={"lag.T": T}, seed=i + 1, method=method, log=["lag.y"])


@pytest.mark.parametrize(
    ("given", "told"),
    {
        "none": ({"names": ["lag.tau"]}, "E106 lag.tau"),
        "pattern": ({"names": ["la*.z"]}, "E106 .*matches no parameter"),
        "twice": ({"names": ["lag.T", "l*.T"]}, "E501 .*is already varied by lag.T"),
        "element": ({"names": ["lag.T[0]"]}, "E501 .*name it alone"),
        "measure": ({"names": [], "measures": ["effor"]}, "E501 effor.*effort"),
        "one name": ({"names": "lag.T"}, "E501 lag.T: is a single name"),
        "text": ({"names": [], "measures": "ise"}, "E501 measures"),
        "inputs": ({"names": [], "inputs": {"v": 1.0}}, "E502 v: the diagram has no such input"),
        "jumps": ({"names": [], "jumps": True}, "E501 jumps"),
        "given": ({"names": ["lag.T"], "parameters": {"lag.T": 1.0}}, "E501 lag.T"),
        "setting": ({"names": [], "stp": 1.0}, "E501 stp"),
    }.values(),
)
def test_what_cannot_be_a_batch_is_refused(given: dict[str, Any], told: str) -> None:
    with pytest.raises(UsageError, match=told):
        noisy().batch(**given)


@pytest.mark.parametrize(
    ("table", "more", "told"),
    [
        ([[1.0, 2.0]], {}, "row 0 has 2 values"),
        ({"lag.K": [1.0]}, {}, "no such column"),
        ({"lag.T": [1.0], "x": [1.0]}, {}, "no column x"),
        ([1.0, 2.0], {}, "row 0: must be a list or an array"),
        ("abc", {}, "table: must be a list or an array"),
        ({"lag.T": 1.0}, {}, "lag.T: must be a list or an array"),
        ([[1.0]], {"seeds": [1, 2]}, "2 seeds for 1 row"),
        ([[1.0], [1.0]], {"seeds": [1, -2]}, "integers from 0 to 2.53, but row 1 has -2"),
        ([[1.0]], {"seeds": [1.5]}, "integers from 0 to 2.53, but row 0 has 1.5"),
        ([[1.0]], {"threads": 0}, "threads: must be an integer, 1 or more"),
        ([[1.0]], {"max_steps": -5}, "max_steps: must be an integer, 1 or more"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(table: Any, more: dict[str, Any], told: str) -> None:
    with pytest.raises(UsageError, match=told):
        noisy().batch(["lag.T"])(table, **more)
