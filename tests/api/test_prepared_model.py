"""Prepared models: runs that are prepared once are those that are prepared anew, and nothing stale is used."""

import copy
import pickle
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    Diagram,
    Gain,
    Input,
    Integrator,
    Parameter,
    Results,
    Sine,
    Stepped,
    TransportDelay,
    ZeroOrderHold,
    fmu,
    output,
    stepper,
    subdiagram,
)
from blocks.text.errors import BlocksError
from tests.support.documents import SHIPPED, is_unlike, span
from tests.support.marks import long_but

ROOT = Path(__file__).parents[2]
OUTSIDE = 2.0


class Scaled(Block):
    """y = OUTSIDE u, by a number that is read from outside."""

    u = Input(doc="in")

    @output(doc="out")
    def y(u: Any) -> Any:
        return OUTSIDE * u


def loop() -> Diagram:
    diagram = Diagram("loop")
    k = diagram.parameter("k", 2.0)
    T = diagram.parameter("T", 1.0, unit="s")
    u = diagram.input("u", default=1.0)
    gain = diagram.add("gain", Gain(k=k))
    lag = diagram.add("lag", Integrator())
    diagram.wire(gain.u, u)
    diagram.wire(lag.u, gain.y)
    diagram.measure("at_end", "mean_square", lag.y, start=T)
    diagram.settings(stop="=2*T", every=0.25)
    return diagram


def same(ours: Results, anew: Results) -> None:
    """The same to the last bit, with the same origin."""
    assert ours.names == anew.names
    assert ours.t.tobytes() == anew.t.tobytes()
    for name in anew.names:
        assert ours[name].tobytes() == anew[name].tobytes(), name
    assert list(ours.events) == list(anew.events)
    assert repr(ours.measures) == repr(anew.measures)
    assert ours.warnings == anew.warnings
    assert ours.origin is not None
    assert anew.origin is not None
    assert ours.origin.told() == anew.origin.told()
    assert (ours.statistics.steps, ours.statistics.evaluations) == (anew.statistics.steps, anew.statistics.evaluations)


# --- the same bits -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", long_but(SHIPPED, is_unlike), ids=lambda path: path.stem)
def test_runs_of_a_prepared_model_are_fresh_runs(path: Path) -> None:
    """Of all shipped diagrams: in turn, with other times, logs and parameters, and the first again."""
    diagram = Diagram.load(path)
    inputs = {name: 0.5 for name, entry in diagram.value.inputs.items() if "default" not in entry}
    stop = span(path, 0.1 if path.parent.name == "paper" else 0.5)
    given: dict[str, Any] = {"inputs": inputs, "stop": stop} if inputs else {"stop": stop}
    model = diagram.prepare(rtol=1e-5) if "method" not in diagram.value.run else diagram.prepare()
    fixed = model._base.settings
    log = list(diagram.run(**given, **fixed).names[:2])
    grids = {"every": stop / 5}, {"jumps": True, "every": stop / 2.5}
    for more in ({}, {"stop": stop / 2}, grids[0], {"log": log}, {"log": []}, grids[1], {}):
        same(model.run(**{**given, **more}), Diagram.load(path).run(**{**given, **fixed, **more}))


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_a_delay_of_a_prepared_model_is_that_of_a_fresh_run(
    engine: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is flattened for it. Also where a run goes on from a saved state."""
    diagram = Diagram("late")
    wave, late, lag = diagram.add("wave", Sine(omega=5.0)), diagram.add("late", TransportDelay()), Integrator()
    diagram.wire(late.u, wave.y)
    diagram.wire(diagram.add("lag", lag).u, late.y)
    diagram.settings(stop=2.0, every=0.25)
    model = diagram.prepare(parameters={"late.delay": 0.2, "late.y_before": 0.0}, engine=engine)
    pairs = [(0.9, 1.0), (0.03, 2.0), (5.0, -1.0)]
    others = [{"late.delay": delay, "late.y_before": before} for delay, before in pairs]
    fresh = [diagram.copy().run(parameters=given, engine=engine) for given in others]
    with monkeypatch.context() as patch:
        patch.setattr("blocks.engines.prepared.flatten", None)
        ours = [model.run(parameters=given) for given in others]
    for one, other in zip(ours, fresh, strict=True):
        same(one, other)
    run = diagram.copy().start(parameters=others[0], engine=engine)
    run.advance_to(1.0)
    run.save(tmp_path / "half.state")
    rest, whole = diagram.run(resume=tmp_path / "half.state"), model.run(parameters=others[0], stops=[1.0])
    assert rest["lag.y"].tobytes() == whole["lag.y"][whole.t >= 1.0].tobytes()


def test_log_every_and_streams_of_rows_change_no_bit_of_anything_else() -> None:
    """The last row is on every grid, and the measures are of the steps."""
    diagram = Diagram.load(ROOT / "diagrams" / "paper" / "iadrc.json")
    model = diagram.prepare(stop=3.0)
    whole = model.run()
    for more in ({"every": 1.0}, {"every": 0.125, "log": whole.names[:3]}, {"log": []}, {"every": 3.0, "jumps": True}):
        results = model.run(**more)
        assert results.measures == whole.measures
        assert list(results.events) == list(whole.events)
        assert results.statistics.steps == whole.statistics.steps
        for name in results.names:
            assert results[name][-1] == whole[name][-1]


def test_a_resumed_run_is_the_run_of_a_prepared_model(tmp_path: Path) -> None:
    model = loop().prepare()
    run = loop().start(parameters={"k": 3.0})
    run.advance_to(1.0)
    run.save(tmp_path / "half.state")
    rest, whole = loop().run(resume=tmp_path / "half.state"), model.run(parameters={"k": 3.0}, stops=[1.0])
    at = whole.t >= 1.0
    assert rest["lag.y"].tobytes() == whole["lag.y"][at].tobytes()
    assert rest.measures == whole.measures


def test_a_run_goes_back_and_on_with_another_value_as_a_fresh_one_does() -> None:
    diagram = Diagram.load(ROOT / "diagrams" / "paper" / "adrc.json")
    run = diagram.start(stop=2.0)
    run.advance_to(1.0)
    state = run.snapshot()
    for value in (0.3, 0.4, 0.3):
        run.restore(state)
        run.set("Jeq", value)
        run.finish()
        other = Diagram.load(ROOT / "diagrams" / "paper" / "adrc.json").start(stop=2.0, resume=state)
        other.set("Jeq", value)
        other.finish()
        assert {name: run[name] for name in ("motor_right.omega", "robot.x")} == {
            name: other[name] for name in ("motor_right.omega", "robot.x")
        }
        assert run.snapshot().equations is not None
        assert run.snapshot().equations.record == other.snapshot().equations.record  # type: ignore[union-attr]


# --- values ------------------------------------------------------------------------------------------------------


BAD = [
    {"gain.k": 1.0}, {"k": "x"}, {"k": float("nan")}, {"k": None}, {"k": [1, 2]}, {"k": {"value": 1, "unit": "m"}},
    {"nothing": 1.0}, {"T": 0.0}, {"T": -1.0}, {"T": True},
]  # fmt: skip


@pytest.mark.parametrize("given", BAD, ids=repr)
def test_bad_values_are_told_as_by_a_fresh_run(given: dict[str, Any]) -> None:
    def told(run: Callable[..., Results]) -> str:
        try:
            return repr(run(parameters=given).measures)
        except BlocksError as error:
            return str(error)

    model, diagram = loop().prepare(), loop()
    for name in given:
        if name in ("k", "T"):
            model.run(parameters={name: 1.5})
            diagram.run(parameters={name: 1.5})
    assert told(model.run) == told(diagram.run) == told(loop().run)
    same(model.run(), loop().run())  # nothing stays of it


def test_what_the_times_of_the_run_and_measures_are_computed_from_is_followed() -> None:
    model = loop().prepare()
    for value in (1.0, 0.5, 1.5, 1.0):
        results = model.run(parameters={"T": value})
        assert results.t[-1] == 2 * value
        same(results, loop().run(parameters={"T": value}))


def test_arrays_that_are_changed_after_a_run_count_as_they_are_then() -> None:
    diagram = loop()
    values = {"k": np.array(1.0)}
    first = diagram.run(parameters=values)
    values["k"][...] = 2.0
    second = diagram.run(parameters=values)
    values["k"][...] = 3.0
    same(second, loop().run(parameters={"k": np.array(2.0)}))
    assert first.origin is not None
    assert first.origin.told() == loop().run(parameters={"k": np.array(1.0)}).origin.told()  # type: ignore[union-attr]


# --- what is stale is not used -------------------------------------------------------------------------------------


def constant(value: float = 1.0) -> Diagram:
    diagram = Diagram("outside", library=Scaled)
    u = diagram.input("u", default=value)
    scaled = diagram.add("scaled", Scaled())
    diagram.wire(scaled.u, u)
    diagram.settings(stop=1.0, every=1.0)
    return diagram


def test_a_run_sees_what_was_edited_and_a_prepared_model_does_not() -> None:
    diagram = loop()
    model = diagram.prepare()
    before = diagram.run()
    diagram.add("more", Gain(k=5.0))
    diagram.wire("more.u", "lag.y")
    after = diagram.run()
    assert "more.y" in after.names
    assert "more.y" not in before.names
    same(model.run(), before)


def test_a_run_sees_what_equations_read_from_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    diagram = constant()
    model = diagram.prepare()
    assert diagram.run()["scaled.y"][-1] == model.run()["scaled.y"][-1] == 2.0
    monkeypatch.setattr("tests.api.test_prepared_model.OUTSIDE", 3.0)
    assert diagram.run()["scaled.y"][-1] == 3.0
    assert model.run()["scaled.y"][-1] == 2.0
    with pytest.raises(
        BlocksError, match="E501 outside: its equations read Python values from outside the blocks, which"
    ):
        model.run(log=[])
    assert model.run()["scaled.y"][-1] == 2.0


def test_a_run_sees_another_engine_and_another_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    diagram = loop()
    assert diagram.run(engine="native").statistics.engine == "native"
    assert diagram.run(engine="reference").statistics.engine == "reference"
    monkeypatch.setenv("BLOCKS_ENGINE", "reference")
    assert diagram.run().statistics.engine == "reference"
    monkeypatch.setenv("BLOCKS_ENGINE", "native")
    assert diagram.run().statistics.engine == "native"
    monkeypatch.delenv("BLOCKS_ENGINE")
    monkeypatch.setattr("blocks.engines.selection.find_compiler", lambda: None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        assert diagram.run().statistics.engine == "reference"


def test_a_run_sees_another_fmu_of_the_same_name(tmp_path: Path) -> None:
    file = tmp_path / "gain.fmu"
    source = Diagram("source")
    u = source.input("u", default=1.0)
    source.wire(source.add("gain", Gain(k=2.0)).u, u)
    source.output("y", "gain.y")
    source.export(file)
    diagram = Diagram("user", folder=tmp_path)
    diagram.add("block", fmu(file))
    first = diagram.run(stop=0.1, trust=tmp_path)
    assert first["block.y"][-1] == 2.0
    other = Diagram("source")
    u = other.input("u", default=1.0)
    other.wire(other.add("gain", Gain(k=7.0)).u, u)
    other.output("y", "gain.y")
    other.export(file)
    with pytest.raises(BlocksError, match="changed since the diagram was loaded"):
        diagram.run(stop=0.1, trust=tmp_path)


def test_trust_is_of_one_run(tmp_path: Path) -> None:
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    file = folder / "motor.fmu"
    file.write_bytes((ROOT / "fmus" / "PMDCMotor.fmu").read_bytes())
    project = tmp_path / "project"
    project.mkdir()
    (project / "user.json").write_text(
        '{"format": "blocks-diagram", "version": 3, "name": "user", "inputs": {"v": {"default": 1}, "tau": '
        '{"default": 0}}, "wires": {"m.v": "v", "m.tau": "tau"}, "blocks": {"m": {"fmu": "../elsewhere/motor.fmu"}}}',
        encoding="utf-8",
    )
    diagram = Diagram.load(project / "user.json")
    diagram.run(stop=0.01, trust=folder)
    with pytest.raises(BlocksError):
        diagram.run(stop=0.01)


def test_a_structural_value_makes_a_form_of_its_own() -> None:
    diagram = Diagram("forms")
    u = diagram.input("u", default=1.0)
    block = diagram.add("gain", Gain(k=2.0))
    diagram.wire(block.u, u)
    held = diagram.add("hold", ZeroOrderHold(period=0.01))
    diagram.wire(held.u, block.y)
    model = diagram.prepare(stop=0.1)
    for number in range(12):
        given: dict[str, Any] = {"parameters": {"hold.period": 0.01 * (1 + number)}, "log": ["hold.y"], "seed": number}
        same(model.run(**given), diagram.copy().run(stop=0.1, **given))
    assert len(model._forms) == 8


# --- threads, pickles -----------------------------------------------------------------------------------------------


def test_threads_may_share_a_model() -> None:
    model = Diagram.load(ROOT / "diagrams" / "paper" / "adrc.json").prepare(stop=1.0)
    values = [0.2 + 0.01 * k for k in range(12)]
    alone = [model.run(parameters={"Jeq": value}) for value in values]
    got: dict[float, Results] = {}

    def work(mine: list[float]) -> None:
        for value in mine:
            got[value] = model.run(parameters={"Jeq": value})

    threads = [threading.Thread(target=work, args=(values[k::4],)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for value, results in zip(values, alone, strict=True):
        same(got[value], results)


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_a_refused_run_in_one_thread_changes_no_run_in_another(engine: str) -> None:
    model = loop().prepare(engine=engine)
    plain, other = loop().run(engine=engine), loop().run(engine=engine, parameters={"k": 3.0})
    wrong: list[BaseException] = []

    def work(bad: dict[str, Any]) -> None:
        try:
            for _ in range(20):
                with pytest.raises(BlocksError):
                    model.run(parameters=bad)
                same(model.run(), plain)
                same(model.run(parameters={"k": 3.0}), other)
        except BaseException as error:
            wrong.append(error)

    threads = [threading.Thread(target=work, args=(bad,)) for bad in ({"k": "x"}, {"nothing": 1.0})]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


@pytest.mark.parametrize("engine", ["native", "reference"])
@pytest.mark.parametrize("settings", [{}, {"every": None, "jumps": True}])
def test_results_of_two_runs_share_nothing_that_can_be_changed(engine: str, settings: dict[str, Any]) -> None:
    model = loop().prepare(engine=engine, **settings)
    first, second = model.run(), model.run()
    kept = second.values.tobytes(), dict(second.columns), second.origin.told()  # type: ignore[union-attr]
    assert not np.shares_memory(first.values, second.values)
    assert not np.shares_memory(first.t, second.t)
    for mapping in (first.columns, first.measures, first.origin.settings, first.origin.versions):  # type: ignore[union-attr]
        mapping.clear()  # type: ignore[attr-defined]
    for k in range(5):
        model.run(parameters={"k": 5.0 + k})
    third = model.run()
    for results in (second, third):
        assert (results.values.tobytes(), dict(results.columns), results.origin.told()) == kept  # type: ignore[union-attr]
    assert second.measures == third.measures != {}


def test_origins_are_equal_and_pickled_as_what_they_say() -> None:
    """Settings, equations and values are described when they are read."""
    unread, read = loop().run().origin, loop().run().origin
    assert read is not None
    assert (read.settings["stop"], read.settings["every"]) == (2.0, 0.25)
    assert unread == read == pickle.loads(pickle.dumps(loop().run().origin))
    assert loop().run(stop=3.0).origin != read


@pytest.mark.parametrize("again", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy, copy.copy])
def test_a_model_is_pickled_as_what_it_is_made_of(again: Callable[[Any], Any]) -> None:
    model = loop().prepare(parameters={"k": 4.0}, rtol=1e-8)
    other = again(model)
    same(other.run(stop=1.0), model.run(stop=1.0))
    same(other.run(parameters={"k": 1.0}), loop().run(parameters={"k": 1.0}, rtol=1e-8))


# --- what a second run must not take from the first ------------------------------------------------------------------


@pytest.mark.parametrize("edge", [{"trigger": {"every": 0.1}}, {"enable": {"states": "held"}}])
def test_parameters_of_subdiagrams_with_an_edge_are_set_again(edge: dict[str, Any]) -> None:
    inner = Diagram("inner")
    k, u = inner.parameter("k", 1.0), inner.input("u")
    inner.wire(inner.add("gain", Gain(k=k)).u, u)
    inner.output("y", "gain.y")

    def made() -> Diagram:
        diagram = Diagram("edges")
        x, on = diagram.input("x", default=1.0), diagram.input("on", type="bool", default=True)
        block = diagram.add("b", subdiagram(inner), **edge)
        diagram.wire(block.u, x)
        if "enable" in edge:
            diagram.wire(block.enable, on)
        return diagram

    diagram = made()
    for value in (1.0, 2.0, 3.0):
        given = {"stop": 0.5, "parameters": {"b.k": value}}
        same(diagram.run(**given), made().run(**given))
    run = diagram.start(stop=0.5)
    for value in (2.0, 3.0):
        run.set("b.k", value)
        assert (run["b.y"], run.given) == (value, {"b.k": f"{value:g}"})


class Defaulted(Block):
    """y = c u, where c = OUTSIDE k by default."""

    k = Parameter(1.0, doc="k")
    c = Parameter(lambda k: OUTSIDE * k, doc="c")
    u = Input(doc="in")

    @output(doc="out")
    def y(u: Any, c: Any) -> Any:
        return c * u


def test_computed_defaults_are_of_what_is_outside_now(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where k = 0 hides what the default reads, too."""
    diagram = Diagram("defaults", library=Defaulted)
    u = diagram.input("u", default=1.0)
    diagram.wire(diagram.add("s", Defaulted()).u, u)
    model = diagram.prepare(stop=1.0)

    def both(run: Callable[..., Results]) -> list[float]:
        return [float(run(stop=1.0, parameters={"s.k": k})["s.y"][-1]) for k in (0.0, 1.0)]

    assert both(diagram.run) == [0.0, 2.0]
    model.run(parameters={"s.k": 0.0})
    known = diagram.run(stop=1.0, parameters={"s.k": 1.0}).origin
    monkeypatch.setattr("tests.api.test_prepared_model.OUTSIDE", 3.0)
    assert both(diagram.run) == [0.0, 3.0]
    try:
        assert model.run(parameters={"s.k": 1.0})["s.y"][-1] == 2.0
    except BlocksError as error:
        assert "which have changed since the model was prepared" in str(error)  # noqa: PT017
    fresh = diagram.run(stop=1.0, parameters={"s.k": 1.0}).origin
    assert known is not None
    assert fresh is not None
    assert known.told().get("values") != fresh.told()["values"]


class Doubling:
    def __init__(self, w: Any) -> None:
        self.w = w

    def step(self, t: float, u: float) -> dict[str, float]:
        self.w *= 2.0
        return {"y": float(np.sum(self.w)) * u}


class Program(Block):
    """A program that changes the array that it was made with."""

    period = Parameter(0.1, unit="s", doc="period")
    w = Parameter([1.0, 2.0], shape=("n",), doc="weights")
    u = Input(doc="in")
    y = Stepped(0.0, doc="out")

    @stepper(every=period)
    def program(w: Any) -> Doubling:
        return Doubling(w)


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_programs_of_two_runs_share_no_array(engine: str) -> None:
    diagram = Diagram("programs", library=Program)
    u = diagram.input("u", default=1.0)
    diagram.wire(diagram.add("s", Program()).u, u)
    model = diagram.prepare(stop=0.5, every=0.1, engine=engine)
    assert {float(model.run()["s.y"][-1]) for _ in range(3)} == {3.0 * 2**6}


def test_a_start_value_cannot_be_set_in_a_run_though_another_run_had_it() -> None:
    diagram = loop()
    one, other = diagram.start(parameters={"lag.y_start": 5.0}), diagram.start(parameters={"lag.y_start": 7.0})
    one.restore(other.snapshot())
    with pytest.raises(BlocksError, match="cannot change during a run"):
        one.set("lag.y_start", 5.0)


def test_what_cannot_be_prepared_or_read_is_told() -> None:
    diagram = loop()
    for given in ({"parameters": {"k": 10**5000}}, {"stop": 10**5000}):
        diagram.run(**({"parameters": {"k": 1}} if "parameters" in given else {"stop": 1}))
        with pytest.raises(BlocksError) as told:
            diagram.run(**given)
        with pytest.raises(BlocksError) as fresh:
            loop().run(**given)
        assert str(told.value) == str(fresh.value)
