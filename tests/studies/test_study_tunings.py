"""Tunings in study files: what they give, how claims and constraints are judged, and what is refused."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from blocks import Constant, Diagram, Step, edit_file
from blocks.api.batch import Batch, BatchRows
from blocks.cli import main
from blocks.compile.toolchain.compiler import find_compiler
from blocks.model import study_grammar
from blocks.studies import json_schema, study
from blocks.studies.optimizers import METHODS
from blocks.text.errors import UsageError

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")
TUNING: dict[str, Any] = {
    "diagram": "bowl.json", "minimize": "a.f + b.f", "over": {"x": [-4, 4]}, "optimizer": "de", "budget": 60,
    "search_seed": 3, "scenarios": {"a": {"c": 0}, "b": {"c": 2}}, "subject_to": ["x <= 0.5", "a.x >= -1"],
    "settings": {"stop": 1},
}  # fmt: skip
CLAIMS: list[dict[str, Any]] = [
    {"tuning": "gains", "measure": "objective", "at_most": 2.6, "expect": "holds"},
    {"tuning": "gains", "measure": "f", "as": "reduction", "published": 87.5, "tolerance": 0.01,
     "expect": "reproduced"},
    {"tuning": "gains", "measure": "b.f", "at_most": 2, "expect": "fails", "reason": "x is bound."},
    {"tuning": "gains", "measure": "a.x"},
]  # fmt: skip


@pytest.fixture(autouse=True)
def native(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows run in threads by the native engine; by another one they run in processes, which start anew each time."""
    monkeypatch.setenv("BLOCKS_ENGINE", "native")


def document(**changes: Any) -> dict[str, Any]:
    runs = {"one": {"diagram": "bowl.json", "settings": {"stop": 1}}}
    first = {"format": "blocks-study", "version": 1, "name": "tuned", "runs": runs}
    return {**first, "tunings": {"gains": TUNING}, "claims": CLAIMS, **changes}


def written(tmp_path: Path, **changes: Any) -> Path:
    """A study of (x - c)^2, which is 20 for c = 0 and c = 2 together where x = 4, and 2.5 where x is at its limit."""
    bowl = Diagram("bowl")
    for name, value in {"x": 4.0, "c": 0.0}.items():
        bowl.parameter(name, value)
    bowl.add("value", Constant(value="=(x - c)**2"))
    bowl.add("place", Constant(value="=x"))
    bowl.add("later", Step(at=0.5))
    bowl.measure("f", "steady_state_error", "value.y")
    bowl.measure("x", "steady_state_error", "place.y")
    bowl.save(tmp_path / "bowl.json")
    (tmp_path / "study.json").write_text(json.dumps(document(**changes)), encoding="utf-8")
    return tmp_path / "study.json"


def test_a_tuning_of_a_study_is_that_of_python_and_its_claims_and_constraints_are_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path)
    made = study.run(study.load(path))
    tuning = made.tunings["gains"]
    asked = {key: TUNING[key] for key in TUNING if key not in ("diagram", "settings")}
    assert tuning.values == Diagram.load(tmp_path / "bowl.json").tune(**asked, stop=1).values
    x = tuning.values["x"]
    assert x == pytest.approx(0.5, abs=0.01)
    values = [v.value for v in made.verdicts]
    assert values[:4] == pytest.approx([x**2 + (x - 2) ** 2, 100 - (x**2 + (x - 2) ** 2) / 0.2, (x - 2) ** 2, abs(x)])
    assert [(v.claim.of, v.claim.measure, v.claim.limit, v.verdict) for v in made.verdicts[4:]] == [
        ("gains/a", "x <= 0.5", ("at_most", 0.5), "holds"), ("gains/b", "x <= 0.5", ("at_most", 0.5), "holds"),
        ("gains", "a.x >= -1", ("at_least", -1.0), "holds"),
    ]  # fmt: skip
    assert [v.verdict for v in made.verdicts[:4]] == ["holds", "reproduced", "fails", ""]
    assert made.is_fine

    assert main(["study", str(path), "--json", "--out", str(tmp_path / "out")]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    claims = [event for event in events if event["event"] == "claim"]
    assert claims[1] | {"value": 0, "ratio": 0} == {
        "event": "claim", "run": None, "measure": "f", "as": "reduction", "tuning": "gains", "scenario": None,
        "value": 0, "published": 87.5, "ratio": 0, "verdict": "reproduced", "expected": True,
    }  # fmt: skip
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for said in ("Minimized: a.f + b.f. 60 candidates in a, b, de, seed 3.", "a.x &gt;= -1", "4 of 5 limits kept"):
        assert said in report
    assert (tmp_path / "out" / "tuning.gains.png").is_file()


def test_a_constraint_that_is_not_met_is_a_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, tunings={"gains": {**TUNING, "subject_to": ["b.f <= -1"], "budget": 20}}, claims=[])
    assert main(["study", str(path), "--out", str(tmp_path / "out")]) == 1
    assert "✗ fails  <- unexpected" in capsys.readouterr().out


def test_a_missing_package_is_told_before_the_first_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cma", None)
    path = written(tmp_path, tunings={"gains": {**TUNING, "optimizer": "cma"}})
    begun: list[str] = []
    with pytest.raises(UsageError, match=r"E504 .*tunings\.gains.*needs the package cma"):
        study.run(study.load(path), begun=begun.append)
    assert not begun
    assert study.checked(path)[1] == []  # the file is right


def test_a_tuning_that_was_interrupted_is_not_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Batch.__call__

    def stopped(self: Batch, *given: Any, **more: Any) -> BatchRows:
        return replace(plain(self, *given, **more), interrupted=True)

    monkeypatch.setattr(Batch, "__call__", stopped)
    claims = [*CLAIMS, {"run": "one", "measure": "f"}]
    made = study.run(study.load(written(tmp_path, claims=claims)))
    assert made.missing == ("gains",)
    assert [v.claim.of for v in made.verdicts] == ["one"]
    assert not made.is_fine


def changed(**entries: Any) -> dict[str, Any]:
    return {"tunings": {"gains": {**TUNING, **entries}}}


def claim(**entry: Any) -> dict[str, Any]:
    return {"claims": [{"tuning": "gains", "measure": "f", **entry}]}


@pytest.mark.parametrize(
    ("changes", "code", "place", "said"),
    [
        (changed(diagram="bole.json"), "E007", "", "bole.json"),
        (changed(minimize="a.g"), "E105", "tunings.gains.minimize", '"g"'),
        (changed(minimize="d.f"), "E105", "tunings.gains.minimize", 'scenario "d"'),
        (changed(minimize="a.f +"), "E501", "tunings.gains.minimize", ""),
        (changed(subject_to=["x <= 1", "y <= 1"]), "E105", "tunings.gains.subject_to[1]", '"y"'),
        (changed(subject_to=["x"]), "E501", "tunings.gains.subject_to[0]", "comparison"),
        (changed(over={"k": [0, 1]}), "E106", "tunings.gains.over", "k"),
        (changed(over={"x": [1, 0]}), "E501", "tunings.gains.over.x", "bounds"),
        (changed(over={"x": [0, 1], "x*": [0, 1]}), "E501", "tunings.gains.over", "once"),
        (changed(over={"x": [1]}), "E004", "tunings.gains.over.x", "2 numbers"),
        (changed(over={}), "E009", "tunings.gains", "over"),
        (changed(optimizer="dee"), "E004", "tunings.gains.optimizer", "de"),
        (changed(scenarios={"a": {"cc": 1}, "b": {}}), "E106", "tunings.gains.scenarios.a", "c"),
        (changed(settings={"seed": 1}), "E003", "tunings.gains.settings.seed", "seed"),
        (claim(tuning="gain"), "E105", "claims.0.tuning", "gains"),
        (claim(measure="a.g"), "E105", "claims[0]", "'a.x'"),
        (claim(run="one"), "E009", "claims.0", '"tuning" or runs'),
        (claim(quantile=0.5), "E009", "claims.0", 'need a "sweep"'),
        ({"runs": {"gains": {"diagram": "bowl.json"}}}, "E109", "tunings.gains", "already used by a run"),
    ],
)  # fmt: skip
def test_faults_are_found_before_the_first_run_with_their_places(
    tmp_path: Path, changes: dict[str, Any], code: str, place: str, said: str
) -> None:
    _, faults = study.checked(written(tmp_path, **changes))
    told = [fault for fault in faults if fault.code == code and fault.place.startswith(place)]
    assert told, faults
    assert any(said in f"{fault.place} {fault.message} {fault.cure}" for fault in told), told
    assert all(fault.line > 0 for fault in told if place)


def test_the_schema_knows_tunings_and_their_methods() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    schema = jsonschema.Draft202012Validator(json_schema.study_schema())
    assert not [*schema.iter_errors(document())]
    claims = claim(run="one"), claim(sweep="s"), claim(quantile=0.5)
    for changes in (changed(over={}), changed(optimizer="dee"), *claims):
        assert [*schema.iter_errors(document(**changes))], changes
    assert {*study_grammar.OPTIMIZERS} == {*METHODS}


def test_names_in_tunings_follow_a_rename_of_the_project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert main(["rename", "bowl.json", "c", "centre", "--project"]) == 0
    edit_file("bowl.json", [{"rename": "measures.f", "to": "cost"}], project=True).write()
    assert study.checked(path)[1] == []
    text = path.read_text(encoding="utf-8")
    for word in ('"a.cost + b.cost"', '"b.cost"', '{"centre": 0}', '"measure": "cost"'):
        assert word in text
