"""Times of a run that are computed from parameters: exact, checked, renamed, and the same as if they were numbers."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from blocks import Diagram, Integrator, ModelError, Sine, UsageError
from blocks.cli import main
from blocks.compile.bindings import bindings
from blocks.compile.toolchain.compiler import find_compiler
from blocks.editing.renaming import renaming
from blocks.library import LIBRARY
from blocks.studies import json_schema
from blocks.text.errors import BlocksError

ENGINES = [
    "reference",
    pytest.param("native", marks=pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")),
]


def diagram(**run: Any) -> Diagram:
    d = Diagram("d")
    d.parameter("T", 1.5, unit="s")
    d.parameter("n", 3)
    d.parameter("v", 2, unit="V")
    d.parameter("is_on", True)
    d.add("sine", Sine())
    d.add("sum", Integrator())
    d.wire("sum.u", "sine.y")
    d.settings(**run)
    return d


def settings(d: Diagram, **options: Any) -> Any:
    return d.flatten(**options).settings


def codes(d: Diagram, **given: Any) -> list[str]:
    with pytest.raises(BlocksError) as caught:
        d.flatten(**given)
    return [f"{fault.code} {fault.place}" for fault in caught.value.faults]


# --- what they mean --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
def test_a_grid_of_thirds_is_exact(engine: str) -> None:
    results = diagram(stop=200, every="=1/3", log=["sine.y"]).run(engine=engine)
    # k/3 is the double nearest to the fraction; k times the double 1/3, or a sum of such, is another one.
    assert results.t.tolist() == [k / 3 for k in range(601)]
    assert any(k * (1 / 3) != k / 3 for k in range(601))


def test_every_time_may_be_an_expression_in_the_file_and_on_top_of_it() -> None:
    run = {
        "start": "=T/5",
        "stop": {"value": "=2*T", "unit": "s"},
        "method": "rk4",
        "step": "=T/n/100",
        "every": "=1/n",
        "stops": ["=T/7", 1, "=T"],
        "master": {"step": "=T/11", "steps": {"sum": "=1/13"}},
    }
    third = Fraction(3, 2)
    for made in (settings(diagram(**run)), settings(diagram(), **run)):
        assert (made.start, made.stop, made.step, made.every) == (third / 5, 3, third / 300, Fraction(1, 3))
        assert made.stops == (third / 7, 1, third)
        assert (made.master.step, dict(made.master.steps)) == (third / 11, {"sum": Fraction(1, 13)})
    changed = settings(diagram(**run), parameters={"T": 3}, every="=T/7", stops=[2])
    assert (changed.stop, changed.every, changed.stops) == (6, Fraction(3, 7), (2,))
    assert settings(diagram(**run), step=0.5, master={"step": 0.25}).master.step == Fraction(1, 4)
    assert settings(diagram(stop="=sqrt(2)")).stop == Fraction("1.4142135623730951")


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_is_that_with_numbers(engine: str) -> None:
    one = diagram(stop="=2*T", method="rk4", step="=T/n/100", every="=T/10").run(engine=engine)
    other = diagram(stop=3, method="rk4", step=0.005, every=0.15).run(engine=engine)
    assert one.t.tobytes() == other.t.tobytes()
    assert one.values.tobytes() == other.values.tobytes()


def test_the_command_line_takes_expressions(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "d.json"
    diagram(stop=1).save(path)
    options = ["--stop", "=2*T", "--every", "=1/3", "--log", "sine.y", "--set", "T=1", "-o", str(tmp_path / "r.csv")]
    assert main(["run", str(path), *options]) == 0
    rows = [line for line in (tmp_path / "r.csv").read_text().splitlines() if line[0].isdigit()]
    assert [float(row.split(",")[0]) for row in rows] == [k / 3 for k in range(7)]
    assert main(["run", str(path), "--every", "=q"]) == 2
    assert "E108 run.every" in capsys.readouterr().err


# --- what is refused -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("raw", "code"),
    [("=q", "E108"), ("=1+", "E108"), ("=1/0", "E108"), ("=v", "E104"), ("=is_on", "E115"), ("=1e40", "E115"),
     ("==T", "E115"), ("T", "E115"), ({"value": "=T", "unit": "V"}, "E104")],
)  # fmt: skip
def test_a_bad_one_is_told_once_wherever_it_stands(raw: Any, code: str) -> None:
    for run, place in (
        ({"stop": raw}, "run.stop"),
        ({"every": raw}, "run.every"),
        ({"stops": [raw]}, "run.stops"),
        ({"method": "rk4", "step": raw}, "run.step"),
        ({"master": {"step": raw}}, "run.master.step"),
    ):
        assert codes(diagram(**run)) == [f"{code} {place}"]
        good = {
            "stop": "=T",
            "every": "=T/2",
            "stops": ["=T"],
            "method": "rk4",
            "step": "=T/9",
            "master": {"step": "=T"},
        }
        assert codes(diagram(**good), **run) == [f"{code} {place}"]
    assert codes(diagram(master={"steps": {"sum": raw}}))[0].startswith(f"{code} run.master.steps")


def test_what_comes_out_is_checked_as_a_number_is() -> None:
    assert codes(diagram(stop=1), every="=0*T") == ["E115 run.every"]
    assert codes(diagram(stop="=0-T")) == ["E115 run.stop"]
    assert codes(diagram(stop=10), every="=T*1e-12") == ["E115 run.every"]


def test_the_place_in_the_file_is_that_of_the_expression() -> None:
    text = json.dumps({"format": "blocks-diagram", "version": 3, "run": {"stop": 1, "stops": [0.5, "=q"]}}, indent=1)
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(text).check()
    (fault,) = caught.value.faults
    assert text.splitlines()[fault.line - 1][fault.column - 1 :] == '"=q"'


@pytest.mark.parametrize("key", ["stop", "step", "every", "stops", "master"])
def test_a_parameter_that_a_time_reads_cannot_change_during_the_run(key: str) -> None:
    raw: Any = {"stops": ["=T"], "master": {"step": "=T"}}.get(key, "=T")
    d = diagram(**{"stop": 3, "method": "rk4", "step": 0.01, key: raw})
    run = d.start()
    run.advance_to(0.5)
    with pytest.raises(UsageError, match=rf"E117 T: cannot change during a run: {key} in the settings"):
        run.set("T", 1)
    run.set("n", 5)
    run.set("T", 1.5)  # what it is
    run.advance_to(1)


# --- where else they are read ----------------------------------------------------------------------------------


def test_a_parameter_that_is_renamed_is_renamed_in_them(tmp_path: Path) -> None:
    path = tmp_path / "d.json"
    run = {
        "stop": "=2*T",
        "every": {"value": "=T/7", "unit": "s"},
        "stops": ["=T", 1],
        "master": {"steps": {"sum": "=T"}},
    }
    diagram(**run).save(path)
    before = settings(Diagram.load(path))
    made = renaming(path, "T", "period")
    made.write()
    assert json.loads(path.read_text())["run"] == json.loads(json.dumps(run).replace("T", "period"))
    assert settings(Diagram.load(path)) == before
    study = {
        "format": "blocks-study", "version": 1, "name": "s",
        "runs": {"a": {"diagram": "d.json", "settings": {"every": "=period/3"}}},
    }  # fmt: skip
    (tmp_path / "study.json").write_text(json.dumps(study), encoding="utf-8")
    (tmp_path / "pyproject.toml").touch()
    renaming(path, "period", "T", project=True).write()
    assert json.loads((tmp_path / "study.json").read_text())["runs"]["a"]["settings"] == {"every": "=T/3"}


def test_the_schema_knows_them() -> None:
    schema = Draft202012Validator(json_schema.diagram_schema(LIBRARY))
    run = {
        "stop": "=2*T",
        "every": {"value": "=T", "unit": "s"},
        "stops": ["=T"],
        "master": {"step": "=T", "steps": {"a": "=T"}},
    }
    assert [*schema.iter_errors({"format": "blocks-diagram", "version": 3, "run": run})] == []
    assert [*schema.iter_errors({"format": "blocks-diagram", "version": 3, "run": {"stop": "T"}})] != []


def test_in_an_fmu_the_step_stays_and_so_what_it_is_computed_from() -> None:
    d = diagram(stop="=9*n", method="rk4", step="=T/100")
    flat = d.flatten()
    found = {one.path: (one.variability, one.why) for one in bindings(flat, d.plan())}
    assert found["T"] == ("constant", "the step of the run depends on it")
    assert found["n"][0] == "tunable"


def test_differences_are_told_as_those_of_other_values() -> None:
    assert not diagram(stop="=2*T").diff(diagram(stop="=2*T"))
    assert [change.path for change in diagram(stop="=2*T").diff(diagram(stop="=3*T")).changes] == ["stop"]


@pytest.mark.parametrize("text", ["1/3", "T/7"])
def test_a_time_that_looks_like_an_expression_says_how_one_is_written(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "d.json").write_text('{"format": "blocks-diagram", "version": 3, "inputs": {"r": {"default": 1}}}')
    assert main(["run", str(tmp_path / "d.json"), "--every", text]) != 0
    assert f'Begin an expression with "=": --every "={text}".' in capsys.readouterr().err
