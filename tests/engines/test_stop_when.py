"""A condition ends a run before its stop (`stop_when`): at the right time, everywhere, and on its own in each row."""

import json
import math
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu

from blocks import (
    CompareToConstant,
    Constant,
    Diagram,
    FirstOrder,
    Gain,
    Integrator,
    ModelError,
    Mux,
    Ramp,
    Relay,
    TransportDelay,
    UsageError,
    ZeroOrderHold,
    edit_file,
    fmu,
)  # fmt: skip
from blocks.cli import main
from blocks.compile.toolchain.compiler import find_compiler

NEEDS_COMPILER = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")
ENGINES = ["reference", pytest.param("native", marks=NEEDS_COMPILER)]
METHODS = {"dopri5": {}, "radau": {}, "auto": {}, "rk4": {"step": 0.05}}
G, HEIGHT = 9.81, 10.0
FALL = math.sqrt(2 * HEIGHT / G)


def falling() -> Diagram:
    """A body that falls from HEIGHT: it is at 0 after FALL seconds, whatever the method."""
    d = Diagram("fall")
    d.parameter("floor", 0.0, unit="m")
    pull = d.add("pull", Gain(k=-G, unit="m/s2"))
    speed = d.add("speed", Integrator(unit="m/s"))
    height = d.add("height", Integrator(y_start=HEIGHT, unit="m"))
    d.wire(pull.u, d.add("one", Constant(value=1.0)).y)
    d.wire(speed.u, pull.y)
    d.wire(height.u, speed.y)
    d.output("h", height.y)
    d.measure("highest", "peak", of=height.y)
    d.measure("late", "peak", of=height.y, start=1.0, stop=3.0)
    return d


def told(warnings) -> list[str]:
    return [fault.message for fault in warnings if fault.code == "W307"]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", METHODS)
def test_a_run_ends_at_the_located_crossing_of_its_condition(method, engine):
    results = falling().run(stop=5, stop_when="height.y <= 0", method=method, engine=engine, **METHODS[method])
    assert results.t[-1] == pytest.approx(FALL, abs=8 * math.ulp(FALL))
    assert results["h"][-1] == pytest.approx(0, abs=1e-13)
    assert told(results.warnings) == [f"the run ended at t = {FALL:.10g} s: height.y <= 0."]
    assert not results.interrupted


@pytest.mark.parametrize("engine", ENGINES)
def test_an_oscillator_ends_where_both_comparisons_hold(engine):
    d = Diagram("d")
    x, v, minus = d.add("x", Integrator(y_start=1.0)), d.add("v", Integrator()), d.add("minus", Gain(k=-1.0))
    d.wire(x.u, v.y)
    d.wire(minus.u, x.y)
    d.wire(v.u, minus.y)
    results = d.run(stop=9, stop_when="x.y >= 0.5 and v.y > 0", rtol=1e-10, engine=engine)  # x = cos t
    assert results.t[-1] == pytest.approx(5 * math.pi / 3, abs=1e-8)


@pytest.mark.parametrize("engine", ENGINES)
def test_the_last_row_is_at_the_end_and_the_grid_before_stays(engine):
    results = falling().run(stop=5, stop_when="height.y <= floor", every=0.5, engine=engine)
    assert results.t.tolist() == pytest.approx([0, 0.5, 1.0, FALL])
    assert results.measures["highest"] == HEIGHT
    assert math.isnan(results.measures["late"])
    assert any(fault.code == "W301" for fault in results.warnings)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_condition_that_is_true_at_the_start_gives_one_row(engine):
    run = falling().start(stop=5, stop_when="height.y > 9 or not t < 3", engine=engine)
    results = run.finish()
    assert results.t.tolist() == [0.0]
    assert run.ended.code == "W307"


@pytest.mark.parametrize("engine", ENGINES)
def test_a_row_that_ends_at_once_says_so_before_the_measures_that_it_lacks(engine):
    rows = falling().sweep({"floor": [20.0, 5.0]}, stop=5, stop_when="height.y <= floor", engine=engine)
    begins = [re.findall(r"W[0-9]{3} [a-z_.]+", message) for message in rows.messages]
    assert begins == [["W307 run.stop_when", "W301 measures.highest"], ["W307 run.stop_when", "W301 measures.late"]]
    assert "the run ended at t = 0 s: height.y <= floor." in rows.messages[0]
    assert rows.measures["highest"][1] == HEIGHT


@pytest.mark.parametrize("engine", ENGINES)
def test_a_sampled_signal_ends_the_run_at_its_tick_after_the_instant(engine):
    d = falling()
    hold = d.add("hold", ZeroOrderHold(period=0.25, unit="m"))
    relay = d.add("relay", Relay(on_at=5.0, off_at=4.0))
    d.wire(hold.u, "height.y")
    d.wire(relay.u, hold.y)
    tick = math.ceil(FALL / 0.25) * 0.25
    results = d.run(stop=5, stop_when="hold.y <= 0", engine=engine)
    assert results.t[-1] == tick
    assert results["hold.y"][-1] == results["h"][-1] < 0
    assert results["relay.y"][-1] == -1
    assert results.t[-2] == tick  # the jump of the hold has both of its rows


@pytest.mark.parametrize("engine", ENGINES)
def test_elements_delays_bools_and_enabled_parts_are_read(engine):
    d = falling()
    late, both = (
        d.add("late", TransportDelay(delay=0.5, unit="m", y_before=HEIGHT)),
        d.add("both", Mux(names="now, before")),
    )
    for sink, source in ((late.u, "height.y"), (both.u1, "height.y"), (both.u2, late.y)):
        d.wire(sink, source)
    inner = Diagram("inner")
    inner.output("y", inner.add("low", Relay(on_at=1.0, off_at=0.5)).y)
    inner.wire("low.u", inner.input("u"))
    part = d.add("part", inner, enable={"states": "held", "outputs": "held"})
    d.wire(part.u, "height.y")
    d.wire(part.enable, d.input("on", type="bool", default=True))
    for text, fallen in (
        ("both.y[before] <= 0", FALL + 0.5),
        ("both.y[1] <= 0", FALL + 0.5),
        ("late.y <= 0", FALL + 0.5),
    ):
        assert d.run(stop=5, stop_when=text, engine=engine).t[-1] == pytest.approx(fallen, abs=1e-9)
    at = math.sqrt(2 * (HEIGHT - 0.5) / G)
    assert d.run(stop=5, stop_when="on and part.low.y < 0.5", engine=engine).t[-1] == pytest.approx(at, abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_copy_ends_the_run_of_all(engine):
    d = Diagram("fleet")
    lags = d.add("lags", FirstOrder(T=[1.0, 0.5, 2.0]), copies=3)
    d.wire(lags.u, d.add("one", Constant(value=1.0)).y)
    for name in ("lags[1].y", "lags.y[1]"):
        results = d.run(stop=5, stop_when=f"{name} >= 0.5", rtol=1e-9, engine=engine)
        assert results.t[-1] == pytest.approx(0.5 * math.log(2), abs=1e-8)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_parameter_and_an_input_that_are_set_move_the_end(engine):
    d = falling()
    run = d.start(stop=5, stop_when="height.y <= floor", engine=engine)
    run.advance(0.5)
    assert run.ended is None
    run.set("floor", 9.5)
    assert run["height.y"] < 9.5
    run.finish()
    assert run.t == 0.5
    with pytest.raises(UsageError, match=r"the run is over: its condition ended it at t = 0\.5 s"):
        run.advance(1)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_from_a_saved_state_ends_where_the_whole_run_does(engine, tmp_path):
    d = falling()
    run = d.start(stop=5, stop_when="height.y <= 0", engine=engine)
    run.advance(0.5)
    run.save(tmp_path / "state")
    whole, rest = run.finish(), d.run(stop=5, stop_when="height.y <= 0", resume=tmp_path / "state", engine=engine)
    assert (rest.t[-1], rest["h"][-1]) == (whole.t[-1], whole["h"][-1])


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", ["dopri5", "radau"])
def test_a_run_that_ended_goes_on_with_another_condition(engine, method, tmp_path):
    d = falling()
    run = d.start(stop=5, stop_when="height.y <= 5", engine=engine, method=method)
    run.finish()
    run.save(tmp_path / "state")
    for state in (tmp_path / "state", run.snapshot()):
        for text, end in (
            ("height.y <= floor and speed.y < 0", FALL), ("", 2), ("height.y <= 5", run.t), ("height.y < 6", run.t),
        ):  # fmt: skip
            rest = d.run(stop=2, stop_when=text, resume=state, engine=engine, method=method)
            assert rest.t[-1] == pytest.approx(end, abs=1e-12)
    plain = d.start(stop=5, engine=engine, method=method)
    plain.advance(0.5)
    rest = d.run(stop=2, stop_when="height.y <= 0", resume=plain.snapshot(), engine=engine, method=method)
    assert rest.t[-1] == pytest.approx(FALL, abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_goes_on_with_another_condition_that_has_mod(engine, tmp_path):
    d = falling()
    plain, ended = d.start(stop=5, engine=engine), d.start(stop=5, stop_when="mod(height.y, 3) <= 0.8", engine=engine)
    plain.advance(0.25)
    ended.finish()
    assert ended.t == pytest.approx(math.sqrt(2 * 0.2 / G), abs=1e-12)  # mod(9.8, 3) = 0.8
    for run in (plain, ended):
        run.save(tmp_path / "state")
        for state in (tmp_path / "state", run.snapshot()):
            for text, height in (
                ("mod(height.y, 4) > 3.5", 8.0),
                ("mod(-height.y, 4) < 2.1 and height.y < 9", 8.0),
                ("mod(-height.y, 4) >= 2.5 and height.y < 8", 5.5),
                ("mod(2*mod(height.y, 4), 3) < 0.5 and height.y < 9.6", 9.6),
            ):
                rest = d.run(stop=2, stop_when=text, resume=state, engine=engine)
                assert rest.t[-1] == pytest.approx(math.sqrt(2 * (HEIGHT - height) / G), abs=1e-12), text
            assert d.run(stop=1, resume=state, engine=engine).t[-1] == 1


@pytest.mark.parametrize("engine", ENGINES)
def test_a_measure_has_the_time_of_the_end(engine):
    d = falling()
    d.measure("ended", "end_time", of="speed.y")
    d.measure("early", "end_time", of="speed.y", start=0.25, stop=0.5)
    d.measure("never", "end_time", of="speed.y", stop=3.0)
    results = d.run(stop=4, stop_when="height.y <= 0", engine=engine, every=0.3)
    assert results.measures["ended"] == results.t[-1] == pytest.approx(FALL, abs=1e-12)
    assert results.measures["early"] == 0.5
    assert math.isnan(results.measures["never"])
    assert [fault.place for fault in results.warnings if fault.code == "W301"] == ["measures.late", "measures.never"]
    whole = d.run(stop=4, engine=engine)
    assert (whole.measures["ended"], whole.measures["never"]) == (4.0, 3.0)
    at_once = d.run(start=1, stop=4, stop_when="height.y <= 10", engine=engine)
    assert (len(at_once.t), at_once.measures["ended"]) == (1, 1.0)
    coupled = d.run(stop=4, stop_when="height.y <= 0", engine=engine, master={"couple": "each", "step": 0.01})
    assert coupled.measures["ended"] == coupled.t[-1] == pytest.approx(FALL, abs=0.01)


@NEEDS_COMPILER
@pytest.mark.parametrize("lanes", ["exact", "fast"])
def test_a_sweep_has_the_time_at_which_each_row_ended(lanes):
    d, pulls = falling(), np.array([-9.81, -5.0, -1.0, -20.0])
    d.measure("ended", "end_time", of="height.y")
    rows = d.batch(["pull.k"], stop=3, stop_when="height.y <= 0", lanes=lanes)(pulls[:, None])
    assert rows.measures["ended"] == pytest.approx(np.minimum(np.sqrt(2 * HEIGHT / -pulls), 3.0), abs=1e-12)
    assert d.sweep({"pull.k": pulls}, stop=3).units["ended"] == "s"


def test_a_point_of_a_run_may_lie_behind_the_end():
    d = falling()
    assert d.point(at=2.0, stop_when="height.y <= 5", stop=5).t == 2.0


@NEEDS_COMPILER
@pytest.mark.parametrize("lanes", ["exact", "fast"])
def test_each_row_of_a_batch_ends_on_its_own(lanes):
    d, condition = falling(), "height.y <= floor"
    table = [[-9.81], [-5.0], [-1.0], [-20.0], [-7.0]]
    batch = d.batch(["pull.k"], stop=3, stop_when=condition, log=["h"], every=0.25, lanes=lanes)
    rows = batch(table)
    assert {*rows.status} == {"ok"}
    for k, (pull,) in enumerate(table):
        single = d.run(stop=3, stop_when=condition, parameters={"pull.k": pull}, log=["h"], every=0.25)
        own = [f"{warning.code} {warning.place}: {warning.message}" for warning in single.warnings]
        assert rows.messages[k] == " ".join(sorted(own, reverse=True))
        count = int(np.sum(np.isin(rows.t, single.t)))
        assert np.isnan(rows.signals["h"][k][count:]).all()
        same = np.array_equal if lanes == "exact" else np.allclose
        assert same(rows.signals["h"][k][:count], single["h"][:count])
        assert rows.measures["highest"][k] == single.measures["highest"]


@NEEDS_COMPILER
def test_a_column_may_be_a_parameter_of_the_condition():
    rows = falling().batch(["floor"], stop=3, stop_when="height.y <= floor")([[0.0], [5.0]])
    times = [math.sqrt(2 * (HEIGHT - floor) / G) for floor in (0, 5)]
    for message, t in zip(rows.messages, times, strict=True):
        assert f"the run ends at {t:.10g} s" in message


@NEEDS_COMPILER
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("fmi", [2, 3])
def test_co_simulated_fmus_end_the_run_on_the_course_of_their_outputs(fmi, engine, tmp_path):
    path = tmp_path / "fall.fmu"
    falling().export(path, fmi=fmi)
    d = Diagram("d")
    d.add("body", fmu(path, kind="CS"))
    step = 0.01
    line = {"step": step, "order": 1}
    for master in (line, {**line, "couple": "each"}, {"tolerance": 1e-5}, {"step": step, "algorithm": "gauss-seidel"}):
        results = d.run(stop=5, stop_when="body.h <= 0 and t > 0.1", master=master, engine=engine, trust=tmp_path)
        end = FALL if "tolerance" in master else math.ceil(FALL / step) * step
        assert results.t[-1] == pytest.approx(end, abs=1e-9)
        assert told(results.warnings)
        assert results["body.h"][-1] == pytest.approx(HEIGHT - G * results.t[-1] ** 2 / 2, abs=1e-9)
    d = Diagram("d")
    d.add("body", fmu(path, kind="ME"))
    results = d.run(stop=5, stop_when="body.h <= 0", engine=engine, trust=tmp_path, every=0.5)
    assert results.t[-1] == pytest.approx(FALL, abs=8 * math.ulp(FALL))


@NEEDS_COMPILER
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_exported_fmu_asks_for_the_end(fmi, tmp_path):
    path = tmp_path / "fall.fmu"
    falling().export(path, fmi=fmi, stop_when="height.y <= floor")
    assert not validate_fmu(str(path))
    early = {"early_return_allowed": True} if fmi == 3 else {}
    rows = simulate_fmu(str(path), stop_time=5, output_interval=0.1, fmi_type="CoSimulation", **early)
    assert rows["time"][-1] == pytest.approx(FALL, abs=1e-12)
    assert rows["h"][-1] == pytest.approx(0, abs=1e-12)
    rows = simulate_fmu(str(path), stop_time=5, output_interval=0.1, fmi_type="CoSimulation")
    assert rows["time"][-1] == pytest.approx(FALL, abs=0.1)
    rows = simulate_fmu(str(path), stop_time=5, fmi_type="ModelExchange", start_values={"floor": 5.0})
    assert rows["time"][-1] == pytest.approx(math.sqrt(2 * (HEIGHT - 5) / G), abs=1e-5)
    for kind in ("CS", "ME"):  # and blocks hears it
        d = Diagram("d")
        d.add("body", fmu(path, kind=kind))
        results = d.run(stop=5, trust=tmp_path, master={"step": 0.1}, every=0.1)
        assert results.t[-1] == pytest.approx(FALL, abs=8 * math.ulp(FALL))
        assert [fault.code for fault in results.warnings] == ["W206"]


@NEEDS_COMPILER
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("isolate", [False, True])
def test_an_fmu_without_early_return_ends_the_run_at_the_time_that_it_names(isolate, engine, tmp_path):
    falling().export(tmp_path / "fall.fmu")
    whole = Diagram("whole")
    whole.output("h", whole.add("body", fmu(tmp_path / "fall.fmu", kind="CS")).h)
    case = {"stop": 5, "master": {"step": 0.03}, "trust": tmp_path}
    own = whole.run(**case, stop_when="t >= 1.17")
    whole.export(tmp_path / "whole.fmu", **case, stop_when="t >= 1.17")
    with zipfile.ZipFile(tmp_path / "whole.fmu") as archive:
        assert b"hasEventMode" not in archive.read("modelDescription.xml")
    d = Diagram("d")
    d.add("inner", fmu(tmp_path / "whole.fmu", isolate=isolate))
    results = d.run(stop=5, master={"step": 0.1}, engine=engine, trust=tmp_path)
    assert own.t[-1] == pytest.approx(1.17, abs=1e-12)  # a point of the inner step, none of the outer
    assert results.t[-1] == own.t[-1]
    assert results["inner.h"][-1] == pytest.approx(HEIGHT - G * own.t[-1] ** 2 / 2, abs=1e-9)
    rows = simulate_fmu(str(tmp_path / "whole.fmu"), stop_time=5, output_interval=0.1)
    assert (rows["time"][-1], rows["h"][-1]) == pytest.approx((1.2, HEIGHT - G * 1.17**2 / 2))  # FMPy asks no time


@NEEDS_COMPILER
def test_the_condition_changes_no_bit_before_the_end():
    d = falling()
    whole, cut = d.run(stop=5, every=0.01), d.run(stop=5, every=0.01, stop_when="height.y <= 0")
    assert np.array_equal(whole["h"][: cut.rows - 1], cut["h"][:-1])


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ("height.z <= 0", "E105", "there is no signal \"height.z\". Did you mean 'height.y'?"),
        ("height.y <= 3 ft", "E105", 'there is no signal "ft". Numbers are in SI: write them without a unit.'),
        ("height.y", "E108", '"height.y" is a number, not a condition. Compare it, as in x >= 3.'),
        ("height.y and t > 1", "E108", "column 10: 'and' takes truth values, not numbers."),
        ("height.y = 3", "E108", "Write one = at the start only, and == for equality."),
        ("height.y > 1/0", "E108", "'=height.y > 1/0', column 13: division by zero in 1.0 / 0.0."),
        ("height.y > 3 and", "E108", "column 17: expected a number"),
        ("height.y > speed.y", "E104", "height.y [m] and speed.y [m/s] are different quantities."),
        ("both.y > 3", "E110", 'both.y has 2 elements. Name one, as in "both.y[0]".'),
        (3, "E115", 'must be a text, not 3. Example: "lift.height >= 3".'),
    ],
)
def test_a_condition_that_cannot_be_read_is_refused(text, code, message):
    d = falling()
    both = d.add("both", Mux(size=2))
    d.wire(both.u1, "height.y")
    d.wire(both.u2, "height.y")
    with pytest.raises(ModelError) as refused:
        d.run(stop=1, stop_when=text)
    (fault,) = refused.value.faults
    assert (fault.code, fault.place) == (code, "run.stop_when")
    assert message in str(fault)


def test_a_condition_in_a_file_is_kept_renamed_and_removed(tmp_path):
    path = tmp_path / "fall.json"
    falling().save(path)
    tree = json.loads(path.read_text())
    tree["run"] = {"stop": 5, "stop_when": "height.y <= floor or h < 0"}
    path.write_text(json.dumps(tree))
    assert Diagram.load(path).run(engine="reference").t[-1] == pytest.approx(FALL)
    assert Diagram.load(path).run(engine="reference", stop_when="", stop=2).t[-1] == 2
    renames = [{"rename": f"{old}", "to": new} for old, new in
               (("blocks.height", "z"), ("parameters.floor", "low"), ("outputs.h", "out"))]  # fmt: skip
    edit_file(path, renames).write()
    assert json.loads(path.read_text())["run"]["stop_when"] == "z.y <= low or out < 0"
    edit_file(path, [{"remove": "blocks.speed"}, {"remove": "parameters.low"}]).write()
    assert json.loads(path.read_text())["run"]["stop_when"] == "z.y <= 0.0 or out < 0"  # parameters leave their values
    edit_file(path, [{"remove": "blocks.z"}]).write()
    assert "stop_when" not in json.loads(path.read_text())["run"]


def test_the_command_line_reports_the_end(tmp_path):
    falling().save(tmp_path / "fall.json")
    command = [sys.executable, "-m", "blocks", "run", "fall.json", "--stop", "5", "--engine", "reference", "--json"]
    done = subprocess.run(
        [*command, "--stop-when", "height.y <= floor"], cwd=tmp_path, capture_output=True, text=True, check=True,
        env={"PYTHONPATH": str(Path(__file__).parents[2]), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)},
    )  # fmt: skip
    last = json.loads(done.stdout.splitlines()[-1])
    assert last["t"] == pytest.approx(FALL)
    assert last["ended"] == f"the run ended at t = {FALL:.10g} s: height.y <= floor."


@NEEDS_COMPILER
def test_the_command_line_exports_a_condition(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    falling().save("fall.json")
    assert main(["export", "fall.json", "-o", "fall.fmu", "--fmi", "2", "--stop-when", "height.y <= 3"]) == 0
    rows = simulate_fmu("fall.fmu", stop_time=5, output_interval=0.1, fmi_type="CoSimulation")
    assert rows["time"][-1] == pytest.approx(math.sqrt(2 * (HEIGHT - 3) / G), abs=1e-12)


def test_the_origin_of_results_has_the_condition():
    results = falling().run(stop=5, stop_when="height.y <= 0", engine="reference")
    assert results.origin.settings["stop_when"] == "height.y <= 0"


def test_a_block_with_a_fault_of_its_own_is_reported_alone() -> None:
    value = {"format": "blocks-diagram", "version": 3, "name": "o", "run": {"stop": 1, "stop_when": "g.y > 1"}}
    with pytest.raises(ModelError) as caught:
        Diagram.from_json({**value, "blocks": {"g": {"type": "Nope"}}}).check()
    assert [fault.code for fault in caught.value.faults] == ["E103"]


def test_a_signal_may_be_called_like_a_function() -> None:
    diagram = Diagram("d")
    diagram.input("mod", default=0)
    diagram.add("r", Ramp())
    results = diagram.run(stop=5, stop_when="r.y > mod + mod(7, 4)")
    assert results.t[-1] == pytest.approx(3, rel=1e-14)


@pytest.mark.parametrize("count", [140, 300])
def test_a_condition_that_is_too_long_is_refused(count: int) -> None:
    diagram = Diagram("d")
    on = diagram.add("e", CompareToConstant())
    diagram.wire(on.u, diagram.add("r", Ramp()).y)
    with pytest.raises(ModelError, match=r"E108 run\.stop_when: the condition (reads too many|has 2096 characters)"):
        diagram.run(stop=1, stop_when=" or ".join(["e.y"] * count))


def test_a_removed_parameter_leaves_its_value_in_the_condition() -> None:
    diagram = Diagram("d")
    limit = diagram.parameter("limit", 3)
    diagram.add("r", Ramp())
    diagram.settings(stop=5, stop_when=f"r.y > {limit[1:]}")
    diagram.remove("limit")
    assert diagram.to_json()["run"]["stop_when"] == "r.y > 3"
    assert diagram.run().t[-1] == pytest.approx(3, rel=1e-14)


@pytest.mark.parametrize(
    ("condition", "said"),
    [
        ("r.y >= limit", r"r\.y \[m\] and limit \[V\] are different quantities"),
        ("fast.y >= 50", r'fast\.y is in km/h, but numbers of a condition are in SI.*"value": 50, "unit": "km/h"'),
    ],
)
def test_a_comparison_of_unlike_units_is_refused(condition: str, said: str) -> None:
    diagram = Diagram("d")
    diagram.parameter("limit", 3, unit="V")
    diagram.parameter("top", 36, unit="km/h")
    diagram.add("r", Ramp(unit="m"))
    diagram.add("fast", Ramp(unit="km/h"))
    with pytest.raises(ModelError, match=f"E104 run.stop_when: {said}"):
        diagram.run(stop=50, stop_when=condition)
    assert diagram.run(stop=50, stop_when="fast.y >= top").t[-1] == pytest.approx(36)
    assert diagram.run(stop=50, stop_when="r.y >= 7").t[-1] == pytest.approx(7)
