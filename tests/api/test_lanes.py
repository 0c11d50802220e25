"""Lanes: rows side by side in vectors, which know nothing of their lane and of each other, within the tolerance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from blocks import (
    Block,
    Diagram,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    LookupTable,
    Noise,
    Parameter,
    Product,
    Pulse,
    Relay,
    Saturation,
    SecondOrder,
    Sine,
    State,
    Step,
    Sum,
    Sweep,
    TransferFunction,
    TransportDelay,
    UnitDelay,
    UsageError,
    ZeroOrderHold,
    local,
)
from blocks.api.batch import BatchRows
from blocks.compile.c import lane_code
from blocks.compile.c.lane_code import Machine
from blocks.model.diagram_grammar import MEASURES
from tests.api.test_batch import Doomed, same, square
from tests.engines.test_native import sanitized
from tests.engines.test_random_diagrams import Wiring, plain, wirings
from tests.support.places import ROOT

Array = Any
pytestmark = [
    pytest.mark.usefixtures("native"),
    pytest.mark.skipif(Machine.own() is None, reason="lanes need gcc on Linux and x86-64"),
]
ROBOT = ROOT / "diagrams/paper/iadrc.json"


def mixed() -> Diagram:
    """A loop with noise, a hold, a crossing, a table, an input that moves, and measures of all kinds."""
    d = Diagram("mixed")
    d.input("load", default=0.5)
    for name, block in {
        "noise": Noise(period=0.01), "wave": SecondOrder(w=7.0, d=0.1, v_start=3.0), "sum": Sum(signs="++-+"),
        "lag": FirstOrder(T=0.1),
        "relay": Relay(on_at=0.2, off_at=-0.2), "hold": ZeroOrderHold(period=0.05), "limit": Saturation(),
        "curve": LookupTable(points=[-1.0, 0.0, 1.0], values=[-2.0, 0.0, 1.0]),
    }.items():  # fmt: skip
        d.add(name, block)
    wires = {
        "limit.u": "wave.y", "sum.u1": "limit.y", "sum.u2": "noise.y", "sum.u3": "hold.y", "sum.u4": "load",
        "lag.u": "sum.y",
        "relay.u": "lag.y", "hold.u": "relay.y", "curve.u": "lag.y", "wave.u": "relay.y",
    }  # fmt: skip
    for sink, source in wires.items():
        d.wire(sink, source)
    d.measure("effort", "total_variation", of="lag.y")
    d.measure("settled", "settling_time", of="lag.y", against=0.0, band=0.5)
    d.measure("late", "ISE", of="sum.y", start=0.5)
    d.measure("top", "peak", of="curve.y")
    d.settings(stop=2.0, every=0.1, inputs={"load": {"t": [0, 1, 2], "u": [0.5, 0.7, 0.1], "interpolation": "linear"}})
    return d


NAMES = ["wave.w", "lag.T"]


def rows_of(count: int) -> list[list[float]]:
    return [[3.0 + 0.9 * i, 0.05 + 0.01 * i] for i in range(count)]


def assert_same(a: BatchRows, b: BatchRows, places: list[int]) -> None:
    """Rows of b are those of a at these places, bit for bit."""
    assert b.status.tolist() == [a.status[k] for k in places]
    assert b.steps.tolist() == a.steps[places].tolist()
    for kind in ("measures", "signals"):
        for name, column in getattr(b, kind).items():
            assert column.tobytes() == getattr(a, kind)[name][places].tobytes(), name


CASES: dict[str, tuple[Any, list[str], dict[str, Any]]] = {
    "mixed": (mixed, NAMES, {"log": ["lag.y", "hold.y"]}),
    "fixed steps": (mixed, NAMES, {"log": ["lag.y"], "method": "rk4", "step": 0.004}),
    "robot": (lambda: Diagram.load(ROBOT), ["Jeq", "torque"], {"stop": 2.0, "log": ["robot.x"], "every": 0.1}),
    "pid": (lambda: Diagram.load(ROOT / "diagrams/motor_pid.json"), ["kp", "voltage"], {"start": 0.25, "stop": 1.5}),
}


@pytest.mark.parametrize("name", CASES)
def test_neither_lanes_nor_neighbours_nor_threads_change_a_bit(name: str) -> None:
    make, names, settings = CASES[name]
    batch = make().batch(names, lanes="fast", **settings)
    assert batch.lanes
    nominal = np.array(batch.nominal)
    table = rows_of(19) if make is mixed else [(nominal * (1 + 0.01 * k)).tolist() for k in range(19)]
    seeds = list(range(19))
    whole = batch(table, seeds=seeds, threads=1)
    assert {*whole.status} == {"ok"}
    order = np.random.default_rng(5).permutation(19).tolist()
    for threads in (1, 2):
        again = batch([table[k] for k in order], seeds=order, threads=threads)
        assert_same(whole, again, order)
    for count in range(1, 10):
        assert_same(whole, batch(table[:count], seeds=seeds[:count], threads=1), seeds[:count])


@pytest.mark.parametrize("name", CASES)
def test_rows_are_single_runs_within_the_tolerance(name: str) -> None:
    make, names, settings = CASES[name]
    exact, fast = (make().batch(names, lanes=lanes, **settings) for lanes in ("exact", "fast"))
    table = rows_of(9) if make is mixed else [(np.array(exact.nominal) * (1 + 0.01 * k)).tolist() for k in range(9)]
    a, b = exact(table, seeds=range(9)), fast(table, seeds=range(9))
    for kind in ("measures", "signals"):
        for key, column in getattr(a, kind).items():
            size = np.nanmax(np.abs(column), initial=0.0)
            assert getattr(b, kind)[key] == pytest.approx(column, rel=1e-5, abs=1e-5 * size, nan_ok=True), key


SHIPPED = (
    "adrc/motor_speed", "adrc/cruise_control", "analysis/smeso_pd", "bouncing_ball", "gallery/uncertain", "motor_pid",
    "paper/iadrc", "paper/wheel_iadrc", "quarter_car", "sampled_loop",
)  # fmt: skip


def variants(diagram: Diagram, count: int, settings: dict[str, Any]) -> tuple[list[str], Array]:
    """Columns that a diagram accepts, and rows around its own values."""
    from tests.api.test_batch import varied

    known = {name: value for name, value in varied(diagram).items() if value}
    good = []
    for name, value in known.items():
        if diagram.batch([name], **settings)([[1.02 * value]]).status[0] == "ok":
            good.append(name)
    base = np.array([known[name] for name in good])
    return good, base * (1 + 0.03 * np.random.default_rng(2).uniform(-1, 1, (count, len(good))))


@pytest.mark.long
@pytest.mark.parametrize("name", SHIPPED)
def test_a_thousand_variants_are_as_near_to_single_runs_as_these_are_to_the_solution(name: str) -> None:
    """The witness is a run of a hundredth of the tolerance."""
    diagram = Diagram.load(ROOT / f"diagrams/{name}.json")
    stop = {"paper/iadrc": 10.0, "paper/wheel_iadrc": 1.0}.get(name, min(float(diagram.value.run["stop"]), 10.0))
    settings: dict[str, Any] = {"stop": stop}
    names, table = variants(diagram, 1000, settings)
    assert names
    is_fixed = diagram.value.run.get("method") == "rk4"
    close = settings if is_fixed else {**settings, "rtol": 1e-8, "atol": 1e-11}
    exact, fast, near = (
        diagram.batch(names, lanes=lanes, **given)(table)
        for lanes, given in (("exact", settings), ("fast", settings), ("exact", close))
    )
    assert fast.how.count("lanes of")
    assert fast.status.tolist() == exact.status.tolist()
    for key, column in exact.measures.items():
        apart, error = np.abs(fast.measures[key] - column), np.abs(column - near.measures[key])
        allowed = 3 * np.nanmax(error, initial=0.0) + 1e-6 * np.nanmax(np.abs(column), initial=0.0)
        assert (np.isnan(apart) == np.isnan(column)).all()
        assert np.nanmax(apart, initial=0.0) <= allowed, key


MACHINES = {"2": Machine.of(2), "4": Machine.of(4), "4 without libmvec": Machine.of(4, libmvec="none")}


@pytest.mark.parametrize("other", MACHINES.values(), ids=MACHINES)
def test_other_machines_have_other_lanes(other: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    own = Machine.own()
    assert own is not None
    if other.width > own.width:
        pytest.skip("this processor has less")
    monkeypatch.setattr(Machine, "own", lambda: other)
    batch = mixed().batch(NAMES, lanes="fast")
    assert batch.lanes.startswith(f"{other.width} lanes of ")
    assert batch.lanes.endswith("libmvec" if other.functions else "libm")
    exact, fast = mixed().batch(NAMES)(rows_of(7)), batch(rows_of(7))
    for key, column in exact.measures.items():
        assert fast.measures[key] == pytest.approx(column, rel=1e-5, nan_ok=True), key


class Functions(Block):
    """All that equations may compute."""

    k = Parameter(0.5)
    u = Input()
    x = State(shape=(35,), output=True)

    @local
    def a(u, k):
        return 0.5 + 0.4 * np.sin(u * k)  # in (0, 1)

    @x.derivative
    def dx(a, u, k, x):
        b = a - 0.5
        return np.array([
            np.exp(b), np.expm1(b), np.log(a), np.log1p(b), np.sin(u), np.cos(u), np.tan(b), np.arcsin(b),
            np.arccos(b), np.arctan(u), np.arctan2(b, a), np.sinh(b), np.cosh(b), np.tanh(u), np.arcsinh(u),
            np.arccosh(1.0 + a), np.arctanh(b), np.hypot(a, u), np.fmod(a, 0.3 + k), np.abs(b) ** k, np.sqrt(a),
            np.floor(5.0 * a) * 0.01, np.ceil(5.0 * a) * 0.01, np.sign(k - 0.6) * a, np.copysign(a, k - 0.7),
            np.minimum(a, k), np.maximum(a, k), np.where(k > 0.6, np.sqrt(a), -a), np.abs(k - a),
            np.where((k > 0.55) & (k < 0.65) | ~(k <= 0.75), 1.0, a), np.where(k == 0.5, a, 1.0),
            np.where(k != 0.5, a, 0.0) * x[0], np.float64(1.0),
            np.where(k > 0.6, np.log(a), np.where(u > 0.0, np.tanh(a), 1.0)),  # of which a run computes what it takes
            np.where(np.log(a) > -0.5 * k, k, np.exp(k * u)),
        ])  # fmt: skip


def test_all_functions_agree_with_those_of_one_number() -> None:
    d = Diagram("functions")
    d.add("f", Functions())
    d.add("wave", Sine(omega=3.0))
    d.wire("f.u", "wave.y")
    settings: dict[str, Any] = {"stop": 2.0, "method": "rk4", "step": 0.01, "every": 0.5, "log": ["f.x"]}
    table = [[0.5 + 0.05 * k] for k in range(9)]
    exact, fast = (d.batch(["f.k"], lanes=lanes, **settings)(table) for lanes in ("exact", "fast"))
    assert fast.signals["f.x"] == pytest.approx(exact.signals["f.x"], rel=1e-11, abs=1e-12)
    assert (np.ptp(exact.signals["f.x"][:, -1], axis=0) > 0).sum() > 25, "they depend on the parameter"


def test_a_row_that_fails_leaves_the_others_as_they_are() -> None:
    table: list[list[Any]] = [[-1.0], [2.0], [float("nan")], [-1e4], [-2.0], ["text"]]
    batch = square().batch(["gain.k"], stop=0.75, log=["x.y"], lanes="fast")
    rows = batch(table, max_steps=5000)
    assert rows.status.tolist() == ["ok", "diverged", "refused", "ok", "ok", "refused"]
    assert np.isnan(rows.measures["last"]).tolist() == [False, True, True, False, False, True]
    assert rows.signals["x.y"][0, -1] == pytest.approx(1 / 1.75, rel=1e-4)
    assert rows.messages[1].startswith("E301 ")
    assert "t = 0.5" in rows.messages[1] or "t = 0.49999" in rows.messages[1]
    assert np.isnan(rows.signals["x.y"][1, -1])
    assert_same(rows, batch([table[0], table[4]]), [0, 4])
    short = batch(table, max_steps=int(rows.steps[0]))
    assert short.status.tolist() == ["ok", "budget", "refused", "budget", "ok", "refused"]
    assert short.messages[3].startswith("E313 square")


@pytest.mark.parametrize("settings", [{"method": "rk4", "step": 0.01}, {"method": "euler", "step": 0.01}], ids=str)
def test_a_fixed_step_that_blows_up_is_told_as_ever(settings: dict[str, Any]) -> None:
    table = [[-1.0], [1.5], [-0.5]]
    exact, fast = (square().batch(["gain.k"], stop=2.0, lanes=lanes, **settings)(table) for lanes in ("exact", "fast"))
    assert fast.status.tolist() == exact.status.tolist() == ["ok", "diverged", "ok"]
    assert fast.messages == exact.messages


def test_a_budget_and_an_interrupt_end_rows_in_lanes() -> None:
    d = mixed()
    d.settings(stop=1e9, inputs={"load": 0.5})
    rows = d.batch(["lag.T"], every=1e8, lanes="fast")([[0.1], [0.2]], max_steps=2000)
    assert rows.status.tolist() == ["budget", "budget"]

    def interrupt(done: int, total: int) -> None:
        if done >= 3:
            raise KeyboardInterrupt

    table = [[0.1 + 0.001 * k] for k in range(400)]
    rows = mixed().batch(["lag.T"], stop=20.0, lanes="fast")(table, threads=1, progress=interrupt)
    assert rows.interrupted
    assert {*rows.status} == {"ok", "left"}
    assert np.isnan(rows.measures["effort"]).tolist() == (rows.status == "left").tolist()


# --- what has no lanes --------------------------------------------------------------------------------------------


def looped() -> Diagram:
    d = Diagram("looped")
    for name, block in {"sum": Sum(signs="+-"), "gain": Gain(k=0.5), "lag": FirstOrder(), "wave": Sine()}.items():
        d.add(name, block)
    for sink, source in {"sum.u1": "wave.y", "sum.u2": "gain.y", "gain.u": "sum.y", "lag.u": "sum.y"}.items():
        d.wire(sink, source)
    d.settings(loops="solve", stop=1.0)
    return d


def delayed() -> Diagram:
    d = Diagram("delayed")
    for name, block in {"wave": Sine(), "late": TransportDelay(delay=0.1), "lag": FirstOrder()}.items():
        d.add(name, block)
    d.wire("late.u", "wave.y")
    d.wire("lag.u", "late.y")
    d.settings(stop=1.0)
    return d


def programmed() -> Diagram:
    d = Diagram("programmed")
    d.add("lag", FirstOrder())
    d.add("program", Doomed())
    d.wire("lag.u", "program.y")
    d.settings(stop=1.0)
    return d


@pytest.mark.parametrize(
    ("make", "settings", "why"),
    [
        (looped, {}, "it has algebraic loops"),
        (delayed, {}, "it has delays"),
        (programmed, {}, "it has blocks with programs in Python"),
        (square, {"method": "radau", "stop": 0.5}, "radau"),
        (lambda: Diagram.load(ROOT / "diagrams/gallery/cart_pole.json"), {}, "each step is looked at closely"),
        (lambda: Diagram.load(ROOT / "diagrams/paper/control_iadrc_sampled.json"), {"stop": 0.1}, "it has no states"),
    ],
    ids=["loop", "delay", "program", "radau", "crossings", "no states"],
)
def test_what_has_no_lanes_says_so_and_runs_exactly(make: Any, settings: dict[str, Any], why: str) -> None:
    batch = make().batch([], lanes="fast", **settings)
    assert batch.lanes == ""
    (warning,) = batch.warnings
    assert warning.code == "W504"
    assert why in warning.message
    assert why in batch.how(3)
    rows = batch([[], []])
    if make is not programmed:
        same(rows, 1, make(), **settings)


def test_a_machine_without_lanes_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Machine, "own", lambda: None)
    batch = square().batch(["gain.k"], stop=0.5, lanes="fast")
    assert "lanes need gcc" in batch.warnings[0].message
    assert batch.how(4, 2) == "2 threads, without lanes: lanes need gcc on Linux and x86-64"


def test_rows_whose_form_has_no_lanes_say_so_and_are_exact(tmp_path: Path) -> None:
    """A numerator of the degree of the denominator closes an algebraic loop."""
    d = Diagram("forms")
    for name, block in {"wave": Step(), "sum": Sum(signs="+-"), "law": TransferFunction(num=[0.0, 1.0])}.items():
        d.add(name, block)
    for sink, source in {"sum.u1": "wave.y", "sum.u2": "law.y", "law.u": "sum.y"}.items():
        d.wire(sink, source)
    d.measure("size", "ISE", of="law.y")
    d.settings(loops="solve", stop=2.0)
    table = [[[0.0, 1.0]], [[0.5, 1.0]], [[0.0, 2.0]]]
    batch = d.batch(["law.num"], lanes="fast")
    rows = batch(table)
    assert batch.lanes
    assert not batch.warnings
    told = "W504 lanes: cannot be used for this row: it has algebraic loops."
    assert rows.messages == ("", told, "")
    same(rows, 1, d, parameters={"law.num": table[1][0]})
    path = tmp_path / "rows.parquet"
    sweep = d.sweep({"law.num": [row[0] for row in table]}, lanes="fast", out=path)
    assert f"1 ok, but row 1: {told}" in sweep.table()
    assert Sweep.load(path).messages == rows.messages


def test_what_cannot_be_meant_is_refused() -> None:
    with pytest.raises(UsageError, match=r"E501 lanes: 'fats' is not a value of lanes\. Did you mean 'fast'"):
        square().batch([], lanes="fats", stop=1.0)
    with pytest.raises(UsageError, match="E501 lanes: 'fast' works on this machine only"):
        square().sweep({"gain.k": [-1.0]}, stop=1.0, lanes="fast", on="tcp://nowhere:1")


def test_a_sweep_tells_its_lanes_and_goes_on_in_no_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyarrow")
    path = tmp_path / "rows.parquet"
    own = Machine.own()
    assert own is not None

    def sweep(lanes: str, **more: Any) -> Sweep:
        made: Sweep = square().sweep({"gain.k": [-1.0, -2.0, -3.0]}, stop=0.5, lanes=lanes, out=path, **more)
        return made

    whole = sweep("fast")
    assert whole.lanes == own.told
    assert own.told in whole.table().splitlines()[0]
    assert Sweep.load(path).lanes == own.told
    path.unlink()

    def interrupt(done: int, total: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    assert sweep("fast", threads=1, progress=interrupt).interrupted
    with pytest.raises(UsageError, match=r"E506.*it belongs to a sweep that differs in its lanes"):
        sweep("exact")
    monkeypatch.setattr(Machine, "own", lambda: replace(own, functions=frozenset()))
    with pytest.raises(UsageError, match=r"E506.*it belongs to a sweep that differs in its lanes"):
        sweep("fast")
    monkeypatch.setattr(Machine, "own", lambda: own)
    assert sweep("fast").measures["last"].tobytes() == whole.measures["last"].tobytes()


# --- lanes beside single runs, bit for bit ------------------------------------------------------------------------

PLAIN = ("adrc/cruise_control", "bouncing_ball", "gallery/observer", "motor_pid", "quarter_car", "sampled_loop")
"""Diagrams whose rates have no functions."""


def assert_exact(exact: BatchRows, fast: BatchRows) -> None:
    assert_same(exact, fast, list(range(len(exact))))
    assert fast.messages == exact.messages


@pytest.mark.parametrize("method", ["rk4", "euler"])
@pytest.mark.parametrize("name", PLAIN)
def test_fixed_steps_without_functions_are_those_of_single_runs_bit_for_bit(name: str, method: str) -> None:
    diagram = Diagram.load(ROOT / f"diagrams/{name}.json")
    stop = min(float(diagram.value.run["stop"]), 2.0)
    log = list(diagram.flatten().log)[:4]
    settings: dict[str, Any] = {"stop": stop, "every": stop / 20, "method": method, "step": stop / 500, "log": log}
    exact, fast = (diagram.batch([], lanes=lanes, **settings) for lanes in ("exact", "fast"))
    assert fast.lanes
    assert_exact(exact([[]] * 3), fast([[]] * 3))


@pytest.mark.parametrize("method", ["rk4", "euler"])
def test_measures_of_each_type_are_those_of_single_runs_bit_for_bit(method: str) -> None:
    """Of a ringing signal and of its square, which five values do not tell, and in windows that begin inside steps."""
    d = Diagram("measured")
    for name, block in {"pulse": Pulse(on=0.1, off=1.3), "wave": SecondOrder(), "square": Product()}.items():
        d.add(name, block)
    for sink, source in {"wave.u": "pulse.y", "square.u1": "wave.y", "square.u2": "wave.y"}.items():
        d.wire(sink, source)
    given = {"settling_time": {"band": 0.05}, "THD": {"omega": 9.0}}
    for of in ("wave.y", "square.y"):
        for kind in MEASURES:
            more = {"against": "pulse.y"} if kind not in ("ISU", "THD", "zero_crossings") else {}
            d.measure(f"{kind}_{of[0]}", kind, of=of, **more, **given.get(kind, {}))
            d.measure(f"{kind}_{of[0]}_late", kind, of=of, start=0.4123, stop=1.9371, **more, **given.get(kind, {}))
    table = [[5.0 + 0.7 * i, 0.02 + 0.1 * i] for i in range(11)]
    settings: dict[str, Any] = {"stop": 2.5, "method": method, "step": 0.01}
    exact, fast = (d.batch(["wave.w", "wave.d"], lanes=lanes, **settings) for lanes in ("exact", "fast"))
    assert fast.lanes
    assert_exact(exact(table), fast(table))


def without_functions(wiring: Wiring) -> Wiring:
    """The same with pulses for sines, and ticks for delays."""
    others = {Sine: Pulse(on=0.3, off=0.9, height=1.1), TransportDelay: UnitDelay(period=0.15, y_start=0.2)}
    return Wiring({name: others.get(type(block), block) for name, block in wiring.blocks.items()}, wiring.wires)


@pytest.mark.long
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(wirings(), st.sampled_from(["rk4", "euler", "dopri5"]))
def test_random_diagrams_in_lanes(wiring: Wiring, method: str) -> None:
    """Also those to which lanes bring nothing, as the run behind a lane takes each step."""
    diagram = plain(without_functions(wiring))
    keys = {Gain: "k", Integrator: "y_start"}
    names = [f"{name}.{keys[type(block)]}" for name, block in wiring.blocks.items() if type(block) in keys]
    log = [f"{name}.y" for name in wiring.blocks]
    for name in wiring.blocks:
        diagram.measure(f"top_{name}", "peak", of=f"{name}.y")
    given: dict[str, Any] = {"stop": 1.5, "every": 0.07, "log": log, "method": method}
    given |= {"rtol": 1e-9, "atol": 1e-11} if method == "dopri5" else {"step": 0.02}
    with mock.patch.object(lane_code, "why_no_gain", return_value=""):
        exact, fast = (diagram.batch(names, lanes=lanes, **given) for lanes in ("exact", "fast"))
        assume(fast.lanes)
        table = np.array(exact.nominal) * (1 + 0.01 * np.arange(11)[:, None])
        a, b = exact(table), fast(table)
    if method != "dopri5":
        assert_exact(a, b)
        return
    assert b.status.tolist() == a.status.tolist()
    assert_same(b, fast(table[::-1]), list(range(11))[::-1])
    for name in log:
        size = 1.0 + np.abs(a.signals[name]).max()
        assert np.abs(a.signals[name][:, -1] - b.signals[name][:, -1]).max() < 1e-6 * size, name


SANITIZED = """
from blocks.engines.native import model
from blocks.model.diagram_grammar import MEASURES
model.EXTRA_FLAGS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", "-g")
from tests.api.test_batch import square
from tests.api.test_lanes import CASES, mixed, rows_of
for make, names, settings in CASES.values():
    batch = make().batch(names, lanes="fast", **settings)
    table = rows_of(11) if make is mixed else [batch.nominal] * 11
    for count, budget in ((11, None), (3, None), (11, 50)):
        assert batch(table[:count], threads=2, max_steps=budget).how.count("lanes of")
for settings in ({}, {"method": "rk4", "step": 0.01}):
    rows = square().batch(["gain.k"], stop=2.0, lanes="fast", **settings)([[-1.0], [1.5], [-1e4]], max_steps=3000)
    assert rows.status[0] == "ok", rows
print("done")
"""


@pytest.mark.long
def test_sanitizers_find_nothing_in_lanes() -> None:
    done = sanitized(0, [], SANITIZED)
    assert "done" in done.stdout, done.stderr[-3000:]
    assert not any(word in done.stderr for word in ("runtime error", "ERROR: AddressSanitizer", "blocks_"))
