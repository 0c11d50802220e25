"""Snapshots: a run that was saved at a stop and goes on is the run that never stopped, bit for bit."""

import json
import math
import random
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    PID,
    Block,
    BlocksError,
    BouncingBall,
    Constant,
    Diagram,
    FirstOrder,
    Gain,
    Integrator,
    Noise,
    Pulse,
    RateLimiter,
    Sine,
    Step,
    Stepped,
    Sum,
    TransferFunction,
    TransportDelay,
    UnitDelay,
    UsageError,
    ZeroOrderHold,
    fmu,
    stepper,
)  # fmt: skip
from tests.support.marks import long_but
from tests.support.places import ROOT
from tests.support.state_files import damaged

SHIPPED = sorted(
    path
    for path in (ROOT / "diagrams").rglob("*.json")
    if json.loads(path.read_text()).get("run", {}).get("stop")
    and path.stem != "iadrc_fmu"  # a master's run begins anew
)


def mixed() -> Diagram:
    """States, ticks, noise, events, a delay, a limiter, a loop that is solved, and measures of all kinds."""
    d = Diagram("mixed")
    r, noise = d.add("r", Pulse(on=0.35, off=1.2)), d.add("noise", Noise(period=0.07, deviation=0.1))
    sensor, pid = d.add("sensor", Sum()), d.add("pid", PID(kp=2.0, ki=1.0, kd=0.1, c=1.0, lower=-3.0, upper=3.0))
    hold, late = d.add("hold", ZeroOrderHold(period=0.05)), d.add("late", TransportDelay(delay=0.13))
    limiter, plant = (
        d.add("limiter", RateLimiter(rising=20.0)),
        d.add("plant", TransferFunction(num=[1.0], den=[0.2, 1.0])),
    )
    delay = d.add("delay", UnitDelay(period=0.1))
    d.add("ball", BouncingBall(h_start=0.3))
    loop, gain = d.add("loop", Sum()), d.add("gain", Gain(k=-0.5))
    d.wire(sensor.u1, plant.y)
    d.wire(sensor.u2, noise.y)
    d.wire(pid.r, r.y)
    d.wire(pid.y, sensor.y)
    d.wire(hold.u, pid.u)
    d.wire(late.u, hold.y)
    d.wire(limiter.u, late.y)
    d.wire(plant.u, limiter.y)
    d.wire(delay.u, plant.y)
    d.wire(loop.u1, plant.y)
    d.wire(loop.u2, gain.y)
    d.wire(gain.u, loop.y)
    for name in ("IAE", "ITAE", "ISE", "peak", "total_variation", "overshoot", "settling_time", "mean_square"):
        d.measure(name, type=name, of="plant.y", against=1.0)
    d.settings(stop=2.0, loops="solve")
    return d


def after(results: Any, t: float) -> tuple[Any, Any]:
    rows = results.t > t
    return results.t[rows], np.column_stack(
        [np.asarray(results[name])[rows].reshape(rows.sum(), -1) for name in results]
    )


def same(whole: Any, rest: Any, t: float) -> None:
    for ours, theirs in zip(after(rest, t), after(whole, t), strict=True):
        assert ours.tobytes() == theirs.tobytes()
    assert [event for event in whole.events if event.t > t] == list(rest.events)
    assert np.array_equal(list(whole.measures.values()), list(rest.measures.values()), equal_nan=True)


METHODS: list[dict[str, Any]] = [{}, {"method": "rk4", "step": 0.01}, {"method": "radau"}, {"every": 0.03}]


@pytest.mark.parametrize("settings", long_but(METHODS, lambda settings: "step" in settings), ids=str)
def test_fifty_stops_in_a_row_change_nothing(tmp_path: Path, settings: dict[str, Any]) -> None:
    rng = random.Random(11)
    stops = sorted({round(rng.uniform(0.0, 2.0), rng.choice([1, 2, 5])) for _ in range(60)} - {0.0, 2.0})[:50]
    d = mixed()
    whole = d.run(stops=stops, **settings)
    run = d.start(stops=stops, **settings)
    for k, stop in enumerate(stops):
        run.advance_to(stop)
        run.save(tmp_path / "state")
        if k % 10 == 0:
            rest = d.run(stops=stops, resume=tmp_path / "state", **settings)
            same(whole, rest, stop)
        run = d.start(stops=stops, resume=tmp_path / "state", **settings)
    same(whole, run.finish(), stops[-1])


@pytest.mark.parametrize(
    "path",
    long_but(SHIPPED, lambda path: path.parent.name not in ("paper", "gallery") or path.stem == "iadrc"),
    ids=lambda path: path.stem,
)
def test_every_diagram_that_ships_goes_on_from_fifty_stops(path: Path) -> None:
    d = Diagram.load(path)
    full = float(d.plan().settings.stop or 1.0)
    end = min(full, 4.0)
    rng = random.Random(path.stem)
    stops = sorted({round(rng.uniform(0.0, end), 4) for _ in range(50)} - {0.0, end})
    given = {"rtol": 1e-4, "atol": 1e-6} if "step" not in d.to_json()["run"] else {}
    settings: dict[str, Any] = {"stop": end, "stops": stops, **given}
    whole = d.run(**settings)
    run = d.start(**settings)
    for stop in stops:
        run.advance_to(stop)
        run = d.start(resume=run.snapshot(), **settings)
        assert run.warnings == ()
    same(whole, run.finish(), stops[-1])


def test_a_snapshot_can_be_gone_back_to() -> None:
    d = mixed()
    run = d.start()
    run.advance_to(0.7)
    state = run.snapshot()
    first = run.finish()
    run.restore(state)
    assert run.t == 0.7
    same(first, run.finish(), 0.7)


def test_what_was_set_during_the_run_is_kept(tmp_path: Path) -> None:
    d = Diagram("set")
    u = d.input("u", default=1.0)
    gain, x = d.add("gain", Gain(k=2.0)), d.add("x", Integrator())
    d.wire(gain.u, u)
    d.wire(x.u, gain.y)
    run = d.start(stop=3.0)
    run.advance_to(1.0)
    run.set("u", 3.0)
    run.set("gain.k", -1.0)
    run.save(tmp_path / "state")
    whole = run.finish()
    rest = d.run(stop=3.0, resume=tmp_path / "state")
    same(whole, rest, 1.0)
    assert rest["x.y"][-1] == pytest.approx(2.0 - 3.0 * 2.0)
    other = d.run(stop=3.0, resume=tmp_path / "state", inputs={"u": 0.0}, parameters={"gain.k": 5.0})
    assert other["x.y"][-1] == pytest.approx(2.0)


def test_the_same_state_is_the_same_file(tmp_path: Path) -> None:
    run = mixed().start()
    run.advance_to(0.5)
    run.save(tmp_path / "a")
    run.save(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def saved(tmp_path: Path) -> Path:
    run = mixed().start()
    run.advance_to(0.5)
    run.save(tmp_path / "state")
    return tmp_path / "state"


def refusal(d: Diagram, path: Any, **settings: Any) -> str:
    with pytest.raises(UsageError) as caught:
        d.run(resume=path, **settings)
    assert {fault.code for fault in caught.value.faults} == {"E506"}
    return str(caught.value)


def test_a_state_of_another_diagram_is_refused_with_the_reasons(tmp_path: Path) -> None:
    path = saved(tmp_path)
    other = mixed()
    other.add("more", Sine())
    other.add("x", Step())
    text = refusal(other, path)
    assert "event times: the state does not fit the diagram: the diagram has 'x.edge', which the state lacks" in text
    plain = Diagram("plain")
    plain.add("one", Constant())
    text = refusal(plain, path, stop=1.0)
    assert "states: the state does not fit the diagram: the state has 'pid.integral'" in text
    assert "delays: " in text
    assert "rates: " in text


def test_a_stop_before_the_state_is_refused(tmp_path: Path) -> None:
    assert "the state is at t = 0.5 s, outside the run from 0.0 s to 0.25 s" in refusal(
        mixed(), saved(tmp_path), stop=0.25
    )


def test_a_file_that_is_no_state_is_refused(tmp_path: Path) -> None:
    d = mixed()
    path = saved(tmp_path)
    data = path.read_bytes()
    broken = tmp_path / "broken"
    assert "cannot be read" in refusal(d, tmp_path / "nothing")
    for content in (b"", b"hello", data[:-30], data[:100] + bytes([data[100] ^ 1]) + data[101:]):
        broken.write_bytes(content)
        assert "is not a saved state" in refusal(d, broken)
    with zipfile.ZipFile(broken, "w") as archive:
        archive.writestr("state.json", "{}")
    assert "is not a saved state" in refusal(d, broken)

    def changed(**entries: Any) -> Path:
        return damaged(path, broken, lambda tree, rows: tree.update(entries))

    assert 'its format is not "blocks-state"' in refusal(d, changed(format="x"))
    assert "version 3 of saved states cannot be read. Use a newer release of blocks." in refusal(d, changed(version=3))
    assert "is not a saved state: a row has no shape" in refusal(d, with_rows(path, broken, {"x": ["<f8", [-1]]}))
    assert "is not a saved state: its rows are incomplete" in refusal(d, with_rows(path, broken, {"x": ["<f8", [9]]}))
    assert "is not a saved state" in refusal(d, with_rows(path, broken, {"x": ["O", [1]]}))
    assert "is not a saved state: it lacks the row 't'" in refusal(d, with_rows(path, broken, {}))


def with_rows(path: Path, made: Path, shapes: dict[str, Any]) -> Path:
    """A state with other kinds and shapes of rows than it has bytes for; of none, without bytes."""
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(made, "w") as new:
        tree, data = json.loads(old.read("state.json")), old.read("rows")
        new.writestr("state.json", json.dumps({**tree, "rows": shapes}))
        new.writestr("rows", data if shapes else b"")
    return made


@pytest.mark.parametrize(
    "settings", [{"method": "euler", "step": 0.1}, {"method": "rk4", "step": 0.1}, {}, {"method": "radau"}], ids=str
)
def test_what_is_given_anew_counts_from_the_state_on(settings: dict[str, Any]) -> None:
    """As if it were set there: rates, event times and inputs follow it, and what is not given stays."""
    d = Diagram("anew")
    u, v = d.input("u", default=1.0), d.input("v", default=0.0)
    gain, x, y, pulse, z = (
        d.add("gain", Gain(k=2.0)), d.add("x", Integrator()), d.add("y", Integrator()),
        d.add("p", Pulse(on=0.0, off=3.0)),
        d.add("z", Integrator()),
    )  # fmt: skip
    d.wire(gain.u, u)
    d.wire(x.u, gain.y)
    d.wire(y.u, v)
    d.wire(z.u, pulse.y)
    run = d.start(stop=4.0, **settings)
    run.advance_to(1)
    run.set("v", 5.0)
    state = run.snapshot()
    stopped = d.run(stop=4.0, resume=state, inputs={"u": 0.0}, **settings)
    assert [stopped[f"{name}.y"][-1] for name in "xyz"] == pytest.approx([2.0, 15.0, 3.0], abs=1e-9)
    other = d.run(stop=4.0, resume=state, parameters={"gain.k": 0.0, "p.off": 2.0}, **settings)
    assert [other[f"{name}.y"][-1] for name in "xyz"] == pytest.approx([2.0, 15.0, 2.0], abs=1e-9)


def test_a_start_beside_a_state_is_refused() -> None:
    run = mixed().start()
    run.advance_to(0.5)
    with pytest.raises(UsageError, match="E501 start: cannot be set for a resumed run"):
        mixed().run(resume=run.snapshot(), start=0.1)


def test_a_parameter_that_was_set_must_be_in_the_diagram(tmp_path: Path) -> None:
    d = Diagram("one")
    d.add("gain", Constant(value=1.0))
    run = d.start(stop=1.0, parameters={"gain.value": 2.0})
    run.advance_to(0.5)
    other = Diagram("other")
    other.add("sine", Sine())
    with pytest.raises(UsageError, match=r"E506 other: the state does not fit the diagram: it sets gain\.value"):
        other.run(stop=1.0, resume=run.snapshot())


def test_values_that_no_run_could_have_left_are_refused(tmp_path: Path) -> None:
    d = mixed()
    path = saved(tmp_path)
    broken = tmp_path / "broken"

    def with_number(name: str, number: float) -> Path:
        def damage(tree: Any, rows: Any) -> None:
            rows[name].reshape(-1)[0] = number

        return damaged(path, broken, damage)

    for name, number in (
        ("step", math.nan), ("step", -1.0), ("error", 0.0), ("x", math.inf), ("d", math.nan), ("s", 0.5), ("t", 0.25),
        ("broken", math.nan), ("z", math.nan), ("events", math.nan), ("ticks", -1), ("fixed", -1),
        ("stiffness", 0.5), ("parameters", math.inf), ("fired", math.nan), ("ticks", 0), ("events", -1.0),
    ):  # fmt: skip
        assert "is not a saved state" in refusal(d, with_number(name, number)), name
    times = (("exact", "1e999999999"), ("exact", "2/1"), ("start", "1/0"))
    for key, value in (*times, ("steppers", [1, 2]), ("foreign", [1])):
        damaged(path, broken, lambda tree, rows, key=key, value=value: tree.update({key: value}))
        assert "is not a saved state" in refusal(d, broken), key
    damaged(path, broken, lambda tree, rows: rows["past.breaks"].fill(-1e300))
    assert "its past breaks at times that are not possible" in refusal(d, broken)
    for name in ("x", "past.parts", "measures.known"):
        damaged(path, broken, lambda tree, rows, name=name: rows.pop(name))
        assert f"is not a saved state: it lacks the row '{name}'" in refusal(d, broken)
    damaged(path, broken, lambda tree, rows: rows.update(more=np.zeros(1)))
    assert "no place for the row 'more'" in refusal(d, broken)
    damaged(path, broken, lambda tree, rows: rows.update(between=np.array(0)))
    assert "its last recorded row is incomplete" in refusal(d, broken)


def places(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The paths of all texts in a tree of JSON values, and of all keys: these end with None."""
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        if isinstance(tree, dict):
            yield (*path, key, None)
        if isinstance(value, str):
            yield (*path, key)
        elif isinstance(value, (dict, list)):
            yield from places(value, (*path, key))


@pytest.mark.parametrize("odd", ["\ud800", "\x1b[2J", "x" * 5000], ids=["surrogate", "escape", "long"])
def test_what_a_damaged_state_says_is_shown_safely(odd: str, tmp_path: Path) -> None:
    """Each text and each key of a state is another one, and messages are short lines that any terminal may have."""
    d = Diagram.load(ROOT / "diagrams" / "sampled_loop.json")
    run = d.start(stop=2.0, parameters={"k": 1.0, "period": {"value": 200.0, "unit": "ms"}})
    run.advance_to(1.0)
    run.save(tmp_path / "state")
    broken, seen = tmp_path / "broken", set()
    with zipfile.ZipFile(tmp_path / "state") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for path in places(json.loads(members["state.json"])):
        tree = json.loads(members["state.json"])
        *way, last = path if path[-1] is not None else path[:-1]
        place = tree
        for key in way:
            place = place[key]
        if path[-1] is None:
            place[odd] = place.pop(last)
        else:
            place[last] += odd
        with zipfile.ZipFile(broken, "w") as archive:
            for name, content in (members | {"state.json": json.dumps(tree).encode()}).items():
                archive.writestr(name, content)
        try:
            faults = d.start(stop=2.0, resume=broken).warnings
        except BlocksError as error:
            faults = error.faults
        for fault in faults:
            seen.add(fault.code)
            assert str(fault).isprintable(), ascii(str(fault))
            assert len(str(fault)) < 2000, str(fault)
    assert seen >= {"E506", "W303"}


def test_results_of_a_run_that_goes_on_tell_where_they_begin() -> None:
    run = mixed().start()
    run.advance_to(0.5)
    rest = mixed().run(resume=run.snapshot())
    assert rest.t[0] == 0.5
    assert rest.origin is not None
    assert rest.origin.settings["start"] == 0.5


@pytest.mark.parametrize("engine", ["reference", None])
@pytest.mark.parametrize("start", [0.05, -1.0])
def test_grids_of_a_run_that_goes_on_count_from_where_it_was_begun(tmp_path: Path, engine: Any, start: float) -> None:
    d = Diagram("late")
    d.wire(d.add("sum", Integrator()).u, d.add("sine", Sine(omega=3.0)).y)
    settings: dict[str, Any] = {"stop": start + 1, "method": "rk4", "step": 0.1, "every": 0.2, "engine": engine}
    whole = d.run(start=start, **settings)
    run = d.start(start=start, **settings)
    run.advance_to(start + 0.4)
    run.save(tmp_path / "half")
    state = run.snapshot()
    run.finish()
    run.restore(state)
    for rest in (run.finish(), d.run(resume=tmp_path / "half", **settings)):
        assert rest.t.tolist() == whole.t.tolist()[2:]
        assert rest.values.tobytes() == whole.values[2:].tobytes()
    damaged(tmp_path / "half", tmp_path / "odd", lambda tree, rows: tree.update(start="1e9"))
    with pytest.raises(UsageError, match="is not a saved state"):
        d.run(resume=tmp_path / "odd", **settings)


def _longer(tree: dict[str, Any], rows: dict[str, Any]) -> None:
    rows["measures.known"] = np.full(1000, 1e300)


def _crowded(tree: dict[str, Any], rows: dict[str, Any]) -> None:
    rows["crossed"] = np.arange(2000.0)


def _of_another_kind(tree: dict[str, Any], rows: dict[str, Any]) -> None:
    rows["fixed"] = np.array(2.0**65)


def _without_past(tree: dict[str, Any], rows: dict[str, Any]) -> None:
    for key, shape in (("starts", (0,)), ("ends", (0,)), ("parts", (0, 6, 1))):
        rows[f"past.{key}"] = np.empty(shape)
    rows["past.passed"][0] = 3


def _out_of_order(tree: dict[str, Any], rows: dict[str, Any]) -> None:
    rows["past.orders"][0] = -5


def _shortened(tree: dict[str, Any], rows: dict[str, Any]) -> None:
    rows["carried"] = np.zeros(3)


def _beside_the_pivots(tree: dict[str, Any], rows: dict[str, Any]) -> None:
    rows["carried"] = np.append(rows["carried"], 1e6)


@pytest.mark.parametrize(
    ("damage", "method"),
    [
        *((damage, "dopri5") for damage in (_longer, _crowded, _of_another_kind, _without_past, _out_of_order)),
        (_shortened, "radau"),
        (_beside_the_pivots, "radau"),
    ],
)
def test_a_state_that_compiled_code_could_not_hold_is_refused(damage: Any, method: str, tmp_path: Path) -> None:
    diagram = Diagram("late")
    u = diagram.input("u", default=1.0)
    lag = diagram.add("lag", FirstOrder())
    late = diagram.add("late", TransportDelay(delay=0.1))
    diagram.wire(lag.u, u)
    diagram.wire(late.u, lag.y)
    diagram.measure("size", "mean_square", late.y)
    diagram.settings(stop=1.0, method=method)
    run = diagram.start()
    run.advance_to(0.5)
    run.save(tmp_path / "good.state")
    damaged(tmp_path / "good.state", tmp_path / "bad.state", damage)
    assert len(diagram.run(resume=tmp_path / "good.state").t) > 1
    for engine in ("native", "reference"):
        with pytest.raises(UsageError, match="E506"):
            diagram.run(resume=tmp_path / "bad.state", engine=engine)


class Counter:
    """Count the steps."""

    def __init__(self) -> None:
        self.count = 0.0

    def step(self, t: float) -> float:
        self.count += 1
        return self.count

    def save(self) -> dict[str, float]:
        return {"count": self.count}

    def restore(self, value: dict[str, float]) -> None:
        self.count = value["count"]


class Counted(Block):
    """Give the number of steps of a program."""

    y = Stepped()

    @stepper(every=0.1)
    def program():  # type: ignore[no-untyped-def]
        return Counter()


@pytest.mark.parametrize("engine", ["native", "reference"])
@pytest.mark.parametrize("blob", [7, "x", {}, {"saved": None}, {"saved": {}}, ["saved"]], ids=repr)
def test_a_damaged_state_of_a_stepper_is_refused_by_its_name(blob: Any, engine: Any, tmp_path: Path) -> None:
    diagram = Diagram("counted")
    diagram.add("counter", Counted())
    run = diagram.start(stop=1.0)
    run.advance_to(0.5)
    run.save(tmp_path / "good.state")
    damaged(tmp_path / "good.state", tmp_path / "bad.state", lambda tree, rows: tree.update(steppers=[blob]))
    assert diagram.run(stop=1.0, resume=tmp_path / "good.state")["counter.y"][-1] == 11
    with pytest.raises(UsageError, match=r"E506 counter: its stepper cannot be restored: "):
        diagram.run(stop=1.0, resume=tmp_path / "bad.state", engine=engine)


@pytest.mark.parametrize("engine", ["native", "reference"])
@pytest.mark.parametrize(
    "damage",
    [
        lambda blob: None,
        lambda blob: "x",
        lambda blob: {"state": blob["state"]},
        lambda blob: {**blob, "state": None},
        lambda blob: {**blob, "state": blob["state"][:-8]},
        lambda blob: {**blob, "state": "!" + blob["state"]},
        lambda blob: {**blob, "numbers": blob["numbers"][:8]},
        lambda blob: {**blob, "numbers": ""},
    ],
    ids=["none", "text", "no numbers", "no state", "cut", "no base64", "few numbers", "without numbers"],
)
def test_a_damaged_state_of_an_fmu_is_refused_by_its_name(damage: Any, engine: Any, tmp_path: Path) -> None:
    diagram = Diagram("driven")
    wave, motor = diagram.add("wave", Sine()), diagram.add("motor", fmu(ROOT / "fmus" / "PMDCMotor.fmu", kind="ME"))
    diagram.wire(motor.v, wave.y)
    run = diagram.start(stop=1.0)
    run.advance_to(0.5)
    run.save(tmp_path / "good.state")

    def change(tree: dict[str, Any], rows: dict[str, Any]) -> None:
        tree["foreign"] = [damage(blob) for blob in tree["foreign"]]

    damaged(tmp_path / "good.state", tmp_path / "bad.state", change)
    assert len(diagram.run(stop=1.0, resume=tmp_path / "good.state").t) > 1
    with pytest.raises(UsageError, match=r"E506 motor: the state of PMDCMotor\.fmu cannot be restored: "):
        diagram.run(stop=1.0, resume=tmp_path / "bad.state", engine=engine)


def test_a_state_of_few_bytes_that_would_fill_the_memory_is_refused(tmp_path: Path) -> None:
    diagram = mixed()
    diagram.start().save(tmp_path / "good.state")

    def fill(tree: dict[str, Any], rows: dict[str, Any]) -> None:
        tree["overrides"] = {"filling": [[]] * 2**21}

    damaged(tmp_path / "good.state", tmp_path / "bad.state", fill)
    with pytest.raises(UsageError, match=r"E506 .*is not a saved state: it is too large"):
        diagram.run(stop=1.0, resume=tmp_path / "bad.state")
