"""Tables of numbers: all rows are bound and their results taken at once, and each is a single run bit for bit."""

from unittest import mock

import numpy as np
import pytest

from blocks import (
    CompareToConstant,
    Diagram,
    FirstOrder,
    Gain,
    Integrator,
    Noise,
    Pulse,
    Ramp,
    Saturation,
    SecondOrder,
    Sine,
    Sum,
    TransportDelay,
    UsageError,
)
from blocks.api.batch import Batch
from blocks.compile.rebinding import Rebinding
from blocks.engines.native import code
from blocks.model.diagram_grammar import MEASURES
from blocks.text.arrays import Array
from tests.api.test_batch import same

pytestmark = pytest.mark.usefixtures("native")

COLUMNS = {
    "tau": (0.1, 0.4), "w": (20.0, 90.0), "late.delay": (0.01, 0.2), "limit.lower": (-0.9, -0.2), "gain.k": (0.5, 2.0),
}  # fmt: skip
"""Of `whole`: read by an expression, in a unit, a delay, a bound of a condition, and plain."""


def whole() -> Diagram:
    """A lag behind noise, a delay, limits with events and a part that is enabled."""
    d = Diagram("whole")
    d.parameter("tau", 0.2, unit="s")
    w = d.parameter("w", 60.0, unit="rpm")
    part = Diagram("part")
    u = part.input("u")
    part.wire(part.add("x", Integrator()).u, u)
    part.output("y", part["x"].y)
    for name, block in {
        "noise": Noise(period=0.05), "wave": Sine(omega=w), "mixed": Sum(signs="+++"), "gain": Gain(k=1.0),
        "lag": FirstOrder(T="=tau/2+sqrt(tau)/9"), "limit": Saturation(lower=-0.5, upper=0.5),
        "late": TransportDelay(delay=0.1), "is_on": CompareToConstant(constant=0.0),
    }.items():  # fmt: skip
        d.add(name, block)
    d.add("part", part, enable={})
    wires = {
        "mixed.u1": "wave.y", "mixed.u2": "noise.y", "mixed.u3": "late.y", "gain.u": "mixed.y", "lag.u": "gain.y",
        "limit.u": "lag.y", "late.u": "limit.y", "is_on.u": "lag.y", "part.enable": "is_on.y", "part.u": "limit.y",
    }  # fmt: skip
    for sink, source in wires.items():
        d.wire(sink, source)
    d.measure("ISE", "ISE", of="lag.y")
    d.measure("off", "total_variation", of="part.y", start=0.4)
    d.settings(stop=1.3)
    return d


def table_of(n: int) -> Array:
    low, high = np.array([*COLUMNS.values()]).T
    return np.random.default_rng(5).uniform(low, high, (n, len(COLUMNS)))


def test_rows_of_numbers_are_single_runs_and_python_reads_only_those_that_it_must() -> None:
    d, table, log = whole(), table_of(9), ["limit.y", "part.y"]
    table[2, 0] = -0.1  # the square root of the expression fails
    table[4, 3] = 0.6  # the lower limit is above the upper one
    table[5, 4] = np.nan
    table[6, 4] = 1e308
    batch, seeds, good = d.batch([*COLUMNS], log=log, every=0.1), np.arange(9), [0, 1, 3, 7, 8]
    rows = batch(table, seeds=seeds)
    assert {*rows.status[good]} == {"ok"}
    assert rows.status[[2, 4, 5, 6]].tolist() == ["refused", "refused", "refused", "diverged"]
    for i, row in enumerate(table.tolist()):
        same(rows, i, d, parameters=dict(zip(COLUMNS, row, strict=True)), seed=i, log=log, every=0.1)
    with mock.patch.object(Batch, "given", side_effect=AssertionError):
        again = batch(table[[*good, 6]], seeds=seeds[[*good, 6]])
    assert again.signals["part.y"].tobytes() == rows.signals["part.y"][[*good, 6]].tobytes()
    assert again.messages[-1] == rows.messages[6]


def test_however_a_table_is_written_its_rows_are_the_same() -> None:
    """Also where no column is bound over the whole table."""
    table, batch, units = table_of(6), whole().batch([*COLUMNS]), ("s", "rpm", "s", "", "")
    table[3, 2] = 0.0
    rows = batch(table)
    texts = [[f"{x!r} {unit}" if unit else x for x, unit in zip(row, units, strict=True)] for row in table.tolist()]
    others = [batch(other) for other in (table.tolist(), dict(zip(COLUMNS, table.T, strict=True)), texts)]
    with mock.patch.object(Rebinding, "fill_all", lambda self, table, *_: np.zeros(len(table), dtype=bool)):
        others.append(batch(table))
    for other in others:
        assert other.status.tolist() == rows.status.tolist() == ["ok"] * 3 + ["refused"] + ["ok"] * 2
        assert other.messages == rows.messages
        for name, column in rows.measures.items():
            assert other.measures[name].tobytes() == column.tobytes()


def test_rows_without_seeds_have_the_seed_of_the_diagram_also_after_others() -> None:
    d, table = whole(), [[0.2], [0.3]]
    batch = d.batch(["tau"])
    for seeds in ([7, 8], None, [8, 7]):
        rows = batch(table, seeds=seeds)
        for i, (tau,) in enumerate(table):
            seed = None if seeds is None else seeds[i]
            assert rows.measures["ISE"][i] == d.run(parameters={"tau": tau}, seed=seed).measures["ISE"]


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
def test_a_matrix_of_numpy_whose_rows_are_matrices_is_refused() -> None:
    """A masked array has rows like any other."""
    table, batch = [[0.2, 20.0], [np.nan, 30.0]], whole().batch(["tau", "w"])
    with pytest.raises(UsageError, match="row 0 has 1 values"):
        batch(np.matrix(table))
    masked = batch(np.ma.array(table, mask=[[False, False], [True, False]]))
    assert masked.status.tolist() == ["ok", "refused"]


@pytest.mark.parametrize("lanes", ["exact", "fast"])
def test_integers_are_numbers_up_to_the_last_exact_one(lanes: str) -> None:
    d = Diagram("line")
    d.wire(d.add("gain", Gain(k=1.0)).u, d.add("ramp", Ramp()).y)
    d.measure("peak", "peak", of="gain.y")
    batch = d.batch(["gain.k"], stop=1.0, method="euler", step=0.5, lanes=lanes)
    rows = batch([[3], [2**53], [2**53 + 1], [True], [2.5]])
    assert rows.status.tolist() == ["ok", "ok", "ok", "refused", "ok"]
    assert rows.measures["peak"][[0, 1, 2, 4]].tolist() == [3.0, 2.0**53, 2.0**53, 2.5]
    assert batch(np.array([[3], [4]])).measures["peak"].tolist() == [3.0, 4.0]


@pytest.mark.parametrize("stop", [2.0, 0.3])
@pytest.mark.parametrize("ends", ["", "wave.y > 1.2", "wave.y > -9"])
@pytest.mark.parametrize("lanes", ["exact", "fast"])
def test_measures_and_why_they_have_no_value_are_those_of_single_runs(lanes: str, ends: str, stop: float) -> None:
    """A few types at once, as one that looks back makes Python look at each row. 0.3 is less than 3/10."""
    d = Diagram("measured")
    d.wire(d.add("wave", SecondOrder()).u, d.add("pulse", Pulse(on=0.1, off=1.3)).y)
    given = {"settling_time": {"band": 0.05}, "THD": {"omega": 9.0}}
    for kind in MEASURES:
        more = {"against": "pulse.y"} if kind not in ("ISU", "THD", "zero_crossings") else {}
        d.measure(kind, kind, of="wave.y", **more, **given.get(kind, {}))
        d.measure(f"{kind}_late", kind, of="wave.y", start=0.2, stop=0.7, **more, **given.get(kind, {}))
    d.settings(stop=stop, method="rk4", step=0.01)
    if ends:
        d.settings(stop_when=ends)
    columns = ["wave.w", "pulse.height"]
    plain = [kind for kind in MEASURES if kind not in ("settling_time", "rise_time", "THD")]
    table = [[9.0, 1.0], [9.0, 0.0], [4.0, -1.0], [9.0, 1e150], [0.01, 1.0]]
    runs = [d.run(parameters=dict(zip(columns, row, strict=True))) for row in table]
    for names in (plain, [f"{kind}_late" for kind in plain], [*MEASURES], ["overshoot"]):
        rows = d.batch(columns, measures=names, lanes=lanes)(table)
        for i, run in enumerate(runs):
            for name in names:
                assert rows.measures[name][i].tobytes() == np.float64(run.measures[name]).tobytes(), name
            told = [w for w in run.warnings if w.code == "W307" or w.place.removeprefix("measures.") in names]
            first = {w.code: w for w in reversed(told) if w.code in ("W301", "W307")}
            message = " ".join(f"{code} {w.place}: {w.message}" for code, w in sorted(first.items(), reverse=True))
            assert rows.messages[i] == message


def test_rows_that_fail_in_different_ways_in_one_table_keep_their_messages() -> None:
    """dx/dt = k x: to the end, stopped by its condition, over the budget, and beyond the numbers."""
    d = Diagram("growth")
    x, gain = d.add("x", Integrator(y_start=1.0)), d.add("gain", Gain(k=1.0))
    d.wire(gain.u, x.y)
    d.wire(x.u, gain.y)
    d.measure("ISE", "ISE", of="x.y")
    d.settings(stop=1.0, stop_when="x.y > 100")
    rows = d.batch(["gain.k"])([[1.0], [10.0], [-1e6], [-1.0], [1e308]], max_steps=2000)
    assert rows.status.tolist() == ["ok", "ok", "budget", "ok", "diverged"]
    assert rows.messages[0] == rows.messages[3] == ""
    assert rows.messages[1].startswith("W307 run.stop_when: the run ended at t = 0.4605")  # ln(100)/10
    assert rows.messages[2].startswith("E313 growth")
    assert rows.messages[4].startswith("E30")
    assert np.isnan(rows.measures["ISE"]).tolist() == [False, False, True, False, True]
    assert rows.measures["ISE"][[0, 3]] == pytest.approx([np.expm1(2.0) / 2, -np.expm1(-2.0) / 2], rel=1e-4)


def test_a_batch_behind_a_run_without_optimisation_takes_optimised_code() -> None:
    d = whole()
    with mock.patch.object(code, "PATIENCE", 1e9):
        single = d.run(parameters={"tau": 0.3}, seed=4)
        batch = d.batch(["tau"])
        rows = batch([[0.3]], seeds=[4])
    assert all(form.model.code.is_optimised for form in batch._forms.values())
    assert rows.measures["ISE"][0] == single.measures["ISE"]
