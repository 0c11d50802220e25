"""Sweeps in study files: what they give, how claims about their rows are judged, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram
from blocks.cli import main
from blocks.studies import json_schema, report, study
from blocks.studies.sampling import Normal
from blocks.studies.study_reader import Claim
from blocks.studies.study_sweeps import statistic_of
from tests.support.places import ROOT

pytestmark = pytest.mark.usefixtures("native")

MASS = str(ROOT / "diagrams" / "adrc" / "mass_position.json")
SWEEP: dict[str, Any] = {
    "diagram": MASS,
    "vary": {"mass": {"normal": [1, 0.1]}, "omega_o": [30, {"value": 40, "unit": "rad/s"}]},
    "n": 8, "seed": 3, "log": ["plant.x"], "measures": ["dip"], "settings": {"every": 0.1},
    "scenarios": {"free": {}, "pushed": {"push": -15}},
    "margins": {"gm": {"type": "gain_margin", "loop": "control.u"}},
}  # fmt: skip
CLAIMS: list[dict[str, Any]] = [
    {"sweep": "many", "scenario": "pushed", "measure": "dip", "share": 0.9, "at_most": 0.1, "expect": "holds"},
    {"sweep": "many", "scenario": "free", "measure": "dip", "share": 0.99, "at_least": 0.1, "expect": "fails",
     "reason": "It is pushed less."},
    {"sweep": "many", "measure": "gm", "quantile": 0.5, "published": 5.8, "tolerance": 0.1, "expect": "reproduced"},
    {"sweep": "many", "scenario": "free", "measure": "dip", "statistic": "deviation", "unit": "m"},
    {"run": "one", "measure": "dip", "at_most": 0.05, "expect": "holds"},
]  # fmt: skip
FIGURES: list[dict[str, Any]] = [
    {"name": "bands", "sweep": "many"},
    {"name": "dips", "sweep": "many", "scenario": "free", "of": "dip", "against": "mass"},
]


def document(**changes: Any) -> dict[str, Any]:
    first = {"format": "blocks-study", "version": 1, "name": "many_masses", "runs": {"one": {"diagram": MASS}}}
    return {**first, "sweeps": {"many": SWEEP}, "claims": CLAIMS, "figures": FIGURES, **changes}


def written(tmp_path: Path, **changes: Any) -> Path:
    (tmp_path / "study.json").write_text(json.dumps(document(**changes)), encoding="utf-8")
    return tmp_path / "study.json"


def test_a_sweep_of_a_study_is_that_of_python_and_its_claims_are_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path)
    made = study.run(study.load(path))
    sweep = made.sweeps["many"]
    same = Diagram.load(MASS).sweep(
        {"mass": Normal(1, 0.1), "omega_o": [30, {"value": 40, "unit": "rad/s"}]}, n=8, seed=3, log=["plant.x"],
        measures=["dip"], every=0.1, scenarios={"free": {}, "pushed": {"push": -15}}, margins=SWEEP["margins"],
    )  # fmt: skip
    for name in ("dip", "gm"):
        assert np.array_equal(sweep.measures[name], same.measures[name])
    assert np.array_equal(sweep.signals["plant.x"], same.signals["plant.x"])
    dips = sweep["pushed"].measures["dip"]
    values = [v.value for v in made.verdicts]
    assert values[0] == np.mean(dips <= 0.1)
    assert values[2] == np.median(sweep.measures["gm"])
    assert values[3] == pytest.approx(np.std(sweep["free"].measures["dip"], ddof=1))
    assert [v.verdict for v in made.verdicts] == ["holds", "fails", "reproduced", "", "holds"]
    assert made.is_fine

    assert main(["study", str(path), "--json", "--out", str(tmp_path / "out")]) == 0
    *claims, done = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert claims[0] | {"value": 0} == {
        "event": "claim", "run": None, "measure": "dip", "sweep": "many", "scenario": "pushed", "share": 0.9,
        "at_most": 0.1, "value": 0, "published": None, "ratio": None, "verdict": "holds", "expected": True,
    }  # fmt: skip
    assert (done["held"], done["reproduced"], done["claims"]) == (2, 1, 4)
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    told = "1 of 1 published numbers reproduced within their tolerance; 2 of 3 limits kept"
    for said in ("90 % ≤ 0.1", "32 runs", told, "It is pushed less.", "mass: normal, mean 1, deviation 0.1"):
        assert said in report
    assert (tmp_path / "out" / "dips.png").is_file()

    assert main(["study", str(path), "--set", "many.push=-40", "--out", str(tmp_path / "other")]) == 1
    assert "<- unexpected" in capsys.readouterr().out


def test_rows_without_a_number_keep_no_limit() -> None:
    values = np.array([1.0, 2.0, np.nan, 3.0])
    assert statistic_of(values, ("share", 0.9), ("at_most", 2.0)) == 0.5
    assert statistic_of(values, ("share", 0.9), ("at_least", 2.0)) == 0.5
    assert statistic_of(values, ("quantile", 0.5), None) == 2.0
    assert np.isnan(statistic_of(np.full(2, np.nan), ("mean", np.nan), None))
    # A limit is not kept by the rows that are left.
    lost = np.array([1.0, 2.0, np.nan, 1.5, 1.0])
    assert statistic_of(lost, ("quantile", 1.0), ("at_most", 3.0)) == np.inf
    assert statistic_of(lost, ("quantile", 0.0), ("at_least", 0.5)) == -np.inf
    assert statistic_of(lost, ("quantile", 0.5), ("at_most", 3.0)) == 1.5
    assert statistic_of(lost, ("quantile", 0.1), ("at_least", 0.5)) == -np.inf, "between a row that failed and a number"
    assert statistic_of(lost, ("quantile", 0.9), ("at_most", 3.0)) == np.inf
    assert np.isnan(statistic_of(lost, ("mean", np.nan), ("at_most", 3.0)))
    # Loops that bear any gain.
    assert statistic_of(np.array([1.0, 2.0, np.inf]), ("quantile", 0.5), None) == 2.0
    assert statistic_of(np.array([1.0, 2.0, np.inf]), ("quantile", 0.75), ("at_least", 1.0)) == np.inf
    limit = Claim((), "dip", "", None, "", "", 0.0, "holds", "", "many", "", ("mean", np.nan), ("at_most", 1.0))
    sweep = Diagram.load(MASS).sweep({"mass": [1.0]}, stop=0.1)
    empty = replace(sweep, measures={"dip": np.array([np.nan])})
    assert study.judge(limit, {}, {"many": empty}).verdict == "fails"
    eight = Diagram.load(MASS).sweep({"mass": [1.0] * 8}, stop=0.1)
    made = replace(eight, measures={"dip": np.array([0.5] * 6 + [np.nan] * 2)})
    worst = study.judge(replace(limit, statistic=("quantile", 1.0)), {}, {"many": made})
    assert (worst.value, worst.verdict, worst.rows) == (np.inf, "fails", (6, 8))
    shown = study.judge(replace(limit, statistic=("quantile", 0.5), unit="mrad/s"), {}, {"many": made}, factor=1000.0)
    loaded = study.load(ROOT / "diagrams" / "adrc" / "study.json")
    told = report.table_text(study.StudyResults(loaded, {}, {}, (worst, shown)))
    assert "∞ (6 of 8 rows)" in told
    assert "500 mrad/s (6 of 8 rows)" in told


def changed(**entries: Any) -> dict[str, Any]:
    return {"sweeps": {"many": {**SWEEP, **entries}}}


def margin(**entry: Any) -> dict[str, Any]:
    return changed(margins={"gm": entry})


def claim(**entry: Any) -> dict[str, Any]:
    return {"claims": [{"sweep": "many", "measure": "dip", **entry}]}


@pytest.mark.parametrize(
    ("changes", "code", "place", "said"),
    [
        (changed(vary={"plant.mm": [1]}), "E106", "sweeps.many.vary", "plant.m"),
        (changed(vary={"mass": {"normal": [1]}}), "E501", "sweeps.many.vary", "MEAN,DEVIATION"),
        (changed(vary={"mass": {"norml": [1, 2]}}), "E501", "sweeps.many.vary", "does not give values"),
        (changed(vary={"mass": {"normal": [1, -1]}}), "E501", "sweeps.many.vary.mass", "not a distribution with these"),
        (changed(n=10**15), "E501", "sweeps.many.n", "the limit is 100000000 numbers"),
        (changed(n=3, sampler="saltelli"), "E501", "sweeps.many.n", "Sobol indices"),
        (changed(vary={"mass": 3}), "E004", "sweeps.many.vary.mass", '{"normal": [0.27, 0.02]}'),
        (changed(vary={}), "E009", "sweeps.many", "vary"),
        (changed(sampler="sobel"), "E004", "sweeps.many.sampler", "saltelli"),
        (changed(measures=["dipp"]), "E105", "sweeps.many.measures", "dip"),
        (changed(log=["plant.y"]), "E105", "sweeps.many.log", "plant"),
        (margin(type="gain", loop="control.u"), "E003", "sweeps.many.margins.gm.type", "margin"),
        (margin(type="delay_margin", loop=["control.u"]), "E009", "sweeps.many.margins.gm", "of several signals"),
        (margin(type="Ms", loop=["control.v"]), "E501", "sweeps.many.margins.gm", "control.u"),
        (margin(type="Ms", loop="control.v"), "E501", "sweeps.many.margins.gm", "control.u"),
        (changed(scenarios={"free": {"puhs": 1}}), "E106", "sweeps.many.scenarios.free", "push"),
        (changed(settings={"seed": 1}), "E003", "sweeps.many.settings.seed", "seed"),
        (claim(sweep="may", quantile=1), "E105", "claims.0.sweep", "many"),
        (claim(measure="dpi", quantile=1), "E105", "claims[0]", "dip"),
        (claim(scenario="fre", quantile=1), "E105", "claims[0]", "free"),
        (claim(), "E009", "claims.0", "quantile"),
        ({"claims": [{"run": "one", "measure": "dip", "quantile": 0.5}]}, "E009", "claims.0", 'need a "sweep"'),
        (changed(vary={"mass": {"normal": [1, 1], "uniform": [0, 1]}}), "E004", "sweeps.many.vary.mass", "normal"),
        (claim(share=0.9, expect="holds"), "E009", "claims.0", "at_most"),
        ({"claims": [{"run": "one", "measure": "dip", "at_most": 1}]}, "E009", "claims.0", '"holds" or "fails"'),
        ({"figures": [{"name": "f", "sweep": "many", "of": "dpi"}]}, "E105", "figures[0]", "dip"),
        ({"figures": [{"name": "f", "sweep": "may"}]}, "E105", "figures.0.sweep", "many"),
        ({"runs": {"many": {"diagram": MASS}}, "claims": []}, "E109", "sweeps.many", "already used"),
    ],
)  # fmt: skip
def test_faults_are_found_before_the_first_run_with_their_places(
    tmp_path: Path, changes: dict[str, Any], code: str, place: str, said: str
) -> None:
    path = written(tmp_path, **changes)
    _, faults = study.checked(path)
    told = [fault for fault in faults if fault.code == code and fault.place.startswith(place)]
    assert told, faults
    assert any(said in f"{fault.message} {fault.cure}" for fault in told), told
    assert all(fault.line > 0 for fault in told)


def test_the_schema_and_the_canonical_form_know_sweeps(tmp_path: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    schema = jsonschema.Draft202012Validator(json_schema.study_schema())
    assert not [*schema.iter_errors(document())]
    bad = [
        changed(vary={}), changed(sampler="sobel"), claim(), claim(share=0.5),
        {"claims": [{"run": "one", "measure": "dip", "quantile": 0.5}]},
        {"claims": [{"run": "one", "measure": "dip", "at_most": 1, "expect": "reproduced"}]},
    ]  # fmt: skip
    for changes in bad:
        assert [*schema.iter_errors(document(**changes))], changes
    path = ROOT / "diagrams" / "adrc" / "study.json"
    assert main(["fmt", "--check", str(path)]) == 0


def test_the_study_of_the_motor_holds(tmp_path: Path) -> None:
    path = ROOT / "diagrams" / "adrc" / "study.json"
    assert main(["study", str(path), "--out", str(tmp_path / "out")]) == 0
    assert len([*(tmp_path / "out").glob("*.png")]) == 6


def test_names_in_sweeps_follow_a_rename_of_the_project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("motor_speed.json", "adrc_2.json", "study.json"):
        (tmp_path / name).write_bytes((ROOT / "diagrams" / "adrc" / name).read_bytes())
    monkeypatch.chdir(tmp_path)
    for old, new in (("motor", "drive"), ("control", "law"), ("omega_o", "fast"), ("noise", "hum")):
        assert main(["rename", "motor_speed.json", old, new, "--project"]) == 0
    _, faults = study.checked(tmp_path / "study.json")
    assert faults == []
    text = (tmp_path / "study.json").read_text(encoding="utf-8")
    for word in ('"drive.Jeq": {', '"loop": "law.u"', '["drive.omega", "law.u"]', '["b0", "fast"]', '{"hum": 0.005}'):
        assert word in text
