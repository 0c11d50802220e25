"""Parameters in copies by all their names, against the diagram that is written out by hand."""

from __future__ import annotations

import json
import re
import zipfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, ModelError, Uniform, UsageError, each
from blocks.cli import main
from blocks.studies import study
from tests.support.fleets import named_by_hand, written_out

ROBOT: dict[str, Any] = {
    "parameters": {"a": {"value": 1, "unit": "s"}},
    "inputs": {"u": {}},
    "outputs": {"y": "lag.y", "w": "wheels.y", "z": "law.y"},
    "blocks": {
        "lag": {"type": "FirstOrder", "parameters": {"T": 0.5}},
        "own": {"type": "FirstOrder", "parameters": {"T": "=a"}},
        "wheels": {"copies": 2, "type": "FirstOrder", "parameters": {"T": 0.3}},
        "law": {"type": "MatrixGain", "parameters": {"K": [[1, 2]]}},
    },
    "wires": {"lag.u": "u", "own.u": "lag.y", "wheels.u": "own.y", "law.u": "wheels.y"},
}
BY_HAND = {**ROBOT, "outputs": {"y": "lag.y", "z": "law.y"}}
pytestmark = pytest.mark.usefixtures("native")
PARTS: dict[str, Any] = {
    "format": "blocks-diagram", "version": 3, "parameters": {"n": 3},
    "run": {"stop": 1, "every": 0.1, "method": "rk4", "step": 0.01},
}  # fmt: skip


def diagram(robot: dict[str, Any], copies: Any, a: Any = (1, 2, 4)) -> dict[str, Any]:
    robots = {"copies": copies, "diagram": robot, "parameters": {"a": list(a)}}
    blocks = {"wave": {"type": "Step", "parameters": {"at": 0.05}}, "robots": robots}
    return {**PARTS, "blocks": blocks, "wires": {"robots.u": "wave.y"}}


FLEET = Diagram.from_json({**diagram(ROBOT, "=n"), "measures": {"end": {"type": "peak", "of": "robots.y[1]"}}})
LOG = ["robots.y", "robots.z"]
ALL, WHEELS = range(3), [(k, w) for k in range(3) for w in range(2)]
LAGS = {f"robots[{k}].lag.T": (0.1, 0.2, 0.4)[k] for k in ALL}
NAMES: list[tuple[dict[str, Any], dict[str, Any]]] = [  # as it is given, and what that is copy by copy
    ({"robots.lag.T": 0.2}, {f"robots[{k}].lag.T": 0.2 for k in ALL}),
    ({"robots[*].lag.T": 0.2}, {f"robots[{k}].lag.T": 0.2 for k in ALL}),
    ({"*.lag.T": 0.2}, {f"robots[{k}].lag.T": 0.2 for k in ALL}),
    ({"r*[*].l*g.T": "200 ms"}, {f"robots[{k}].lag.T": 0.2 for k in ALL}),
    ({"*[1].lag.T": 0.2}, {"robots[1].lag.T": 0.2}),
    ({"robots[1].lag.T": 0.2}, {"robots[1].lag.T": 0.2}),
    ({"robots.lag.T": [0.1, 0.2, 0.4]}, LAGS),
    ({"robots[*].lag.T": np.array([0.1, 0.2, 0.4])}, LAGS),
    ({"*.lag.T": {"value": [100, 200, 400], "unit": "ms"}}, LAGS),
    ({"robots.lag.T": [{"value": 100, "unit": "ms"}, 0.2, "=0.8/2"]}, LAGS),
    ({"robots.lag.T": ["100 ms", "0.2 s", 0.4]}, LAGS),
    ({"*.a": ["3 s", "1000 ms", 2]}, {f"robots[{k}].a": (3, 1, 2)[k] for k in ALL}),
    ({"robots.a": [3, 1, 2]}, {f"robots[{k}].a": (3, 1, 2)[k] for k in ALL}),
    ({"robots[*].a": [3, 1, 2]}, {f"robots[{k}].a": (3, 1, 2)[k] for k in ALL}),
    ({"robots.wheels.T": 0.2}, {f"robots[{k}].wheels[{w}].T": 0.2 for k, w in WHEELS}),
    ({"robots.wheels.T": [0.1, 0.2]}, {f"robots[{k}].wheels[{w}].T": (0.1, 0.2)[w] for k, w in WHEELS}),
    ({"robots.wheels.T": [[1, 2], [3, 4], [5, 6]]}, {
        f"robots[{k}].wheels[{w}].T": 1 + 2 * k + w for k, w in WHEELS}),
    ({"robots.wheels[1].T": [1, 2, 3]}, {f"robots[{k}].wheels[1].T": 1 + k for k in ALL}),
    ({"robots[2].wheels[*].T": [1, 2]}, {f"robots[2].wheels[{w}].T": 1 + w for w in range(2)}),
    ({"robots.law.K": [[3, 4]]}, {f"robots[{k}].law.K": [[3, 4]] for k in ALL}),
    ({"robots.law.K": [[[3, 4]], [[5, 6]], [[7, 8]]]}, {f"robots[{k}].law.K": [[3 + 2 * k, 4 + 2 * k]] for k in ALL}),
    ({"robots[1].lag.T": 0.2, "robots.lag.T": 0.7}, {f"robots[{k}].lag.T": (0.7, 0.2)[k == 1] for k in ALL}),
    ({"robots.lag.T": 0.7, "*.lag.T": 0.2}, {f"robots[{k}].lag.T": 0.7 for k in ALL}),
]  # fmt: skip


@cache
def one_by_one(engine: str) -> Any:
    log = [f"robots_{k}.{name}" for k in ALL for name in "yz"]
    return Diagram.from_json(written_out(diagram(BY_HAND, 3))).prepare(log=log, engine=engine)


def by_hand(given: dict[str, Any], engine: str = "native") -> dict[str, np.ndarray[Any, Any]]:
    """What the robots do that stand one by one. given: by numbered names."""
    results = one_by_one(engine).run(parameters={named_by_hand(name): raw for name, raw in given.items()})
    return {f"robots.{name}": np.stack([results[f"robots_{k}.{name}"] for k in ALL], axis=1) for name in "yz"}


def check(results: Any, given: dict[str, Any], engine: str = "native") -> None:
    for name, wanted in by_hand(given, engine).items():
        np.testing.assert_array_equal(np.asarray(results[name]).reshape(wanted.shape), wanted, err_msg=str(given))


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_names_mean_what_is_set_copy_by_copy(engine: str) -> None:
    for given, meant in NAMES:
        check(FLEET.run(log=LOG, parameters=given, engine=engine), meant, engine)
        if len(given) == 1 and engine == "native":
            rows = FLEET.batch([*given], log=LOG)([[*given.values()]])
            check({name: column[0] for name, column in rows.signals.items()}, meant)


def test_other_values_of_a_prepared_model_are_bound() -> None:
    for names in (("robots.lag.T", "robots[1].a"), ("robots.wheels[1].T",), ("*.wheels.T", "robots[0].wheels[1].T")):
        model = FLEET.prepare(log=LOG)
        for value in (0.2, 0.4):
            meant = {f"robots[{k}].lag.T": value for k in ALL} | {"robots[1].a": value}
            if "wheels" in names[0]:
                meant = {f"robots[{k}].wheels[{w}].T": value for k, w in WHEELS if w or len(names) > 1}
            check(model.run(parameters=dict.fromkeys(names, value)), meant)
    model = FLEET.prepare(log=LOG)
    for values in ([0.1, 0.2, 0.4], [0.1, 0.2, 0.4], [0.3, 0.2, 0.4]):
        check(model.run(parameters={"robots.lag.T": values}), {f"robots[{k}].lag.T": values[k] for k in ALL})
    assert FLEET.batch(["*.lag.T"], stop=1)([[0.1], [-1]]).status.tolist() == ["ok", "refused"]


def test_what_is_set_in_a_run_is_the_last_that_was_set() -> None:
    run = FLEET.start(log=LOG, parameters={"robots[1].lag.T": 3})
    run.set("robots[*].lag.T", [0.1, 0.2, 0.4])
    check(run.finish(), LAGS)
    run = FLEET.start(log=LOG)
    run.set("*.lag.T", 0.2)
    run.set("robots[1].lag.T", 0.7)
    check(run.finish(), {f"robots[{k}].lag.T": (0.2, 0.7)[k == 1] for k in ALL})


def test_each_gives_a_value_to_each_copy() -> None:
    for name in ("robots.lag.T", "*[*].lag.T"):
        assert [*FLEET.sweep({each("*.lag.T"): [0.1]}).varied] == [f"robots[{k}].lag.T" for k in ALL]
        sweep = FLEET.sweep({each(name): Uniform(0.1, 0.4)}, n=2, seed=1, log=LOG)
        assert list(sweep.varied) == [f"robots[{k}].lag.T" for k in ALL]
        for row in range(2):
            values = {column: found[row] for column, found in sweep.varied.items()}
            assert len({*values.values()}) == 3
            check({log: sweep.signals[log][row] for log in LOG}, values)
            assert sweep.measures["end"][row] == by_hand(values)["robots.y"][-1, 1]
    assert list(FLEET.sweep({each("*.wheels[1].T"): [0.1]}).varied) == [f"robots[{k}].wheels[1].T" for k in ALL]
    elements = FLEET.sweep({each("robots.law.K[0,1]"): [5.0], "robots.law.K[0,0]": [3.0]}, log=LOG)
    assert list(elements.varied) == [*(f"robots[{k}].law.K[0,1]" for k in ALL), "robots.law.K[0,0]"]
    check({log: elements.signals[log][0] for log in LOG}, {f"robots[{k}].law.K": [[3, 5]] for k in ALL})


def test_copies_may_be_as_many_as_a_row_says() -> None:
    alike = FLEET.to_json()
    del alike["blocks"]["robots"]["parameters"]
    same = Diagram.from_json(alike)
    table = [[2, 0.2], [4, 0.3], [3, [0.1, 0.2, 0.3]], [2, [1, 2, 3]]]
    rows = same.batch(["n", "robots.lag.T"], measures=["end"])(table)
    ends = [same.run(parameters={"robots[1].lag.T": T}).measures["end"] for T in (0.2, 0.3, 0.2)]
    assert rows.status.tolist() == ["ok", "ok", "ok", "refused"]
    assert rows.measures["end"][:3].tolist() == ends
    del alike["measures"]
    single = Diagram.from_json(alike).run(log=["robots.y"], parameters={"n": 1, "*.lag.T": [0.2]})["robots.y"]
    np.testing.assert_array_equal(single[:, 0], by_hand({"robots[0].lag.T": 0.2})["robots.y"][:, 0])


def test_the_value_of_the_diagram_is_told() -> None:
    names = ["robots.a", "robots[2].a", "robots.lag.T", "robots.wheels[1].T", "robots.law.K[0,1]"]
    told = [FLEET.batch([name]).nominal[0] for name in names]
    np.testing.assert_array_equal(told, [np.nan, 4, 0.5, 0.3, 2])
    plain = diagram(ROBOT, 3)
    plain["blocks"]["robots"] = {"diagram": ROBOT, "parameters": {"a": {"value": 700, "unit": "ms"}}}
    assert Diagram.from_json(plain).batch(["robots.a"]).nominal == (0.7,)


@pytest.mark.parametrize(
    ("given", "code", "told"),
    [
        ({"robots.lag.T": [1, 2]}, "E110", "has 2 values, but there are 3 copies of robots"),
        ({"robots[*].lag.T": [1, 2, 3, 4]}, "E110", "has 4 values"),
        ({"robots.wheels.T": [1, 2, 3]}, "E110", "has 3 values, but there are 2 copies of robots.wheels"),
        ({"robots.wheels.T": [[1, 2], [1, 2]]}, "E110", "has 2 values, but there are 3 copies of robots"),
        ({"robots.wheels.T": [[1, 2], [1, 2], [1]]}, "E110", "has 1 value,"),
        ({"robots.lag.T": []}, "E110", "has 0 values"),
        ({"robots[1].lag.T": [1, 2, 3]}, "E110", "shape"),
        ({"robots.lag.T": {"value": [1, 2, 3], "unit": "V"}}, "E104", "V"),
        ({"robots.lag.T": [1, -2, 3]}, "E107", "above 0"),
        ({"robots[3].lag.T": 1}, "E106", "the copies 0 to 2"),
        ({"robots[-1].lag.T": 1}, "E106", "no such parameter"),
        ({"robots[01].lag.T": 1}, "E106", "no such parameter"),
        ({"wave[*].after": 1}, "E106", "no such parameter"),
        ({"robots[*].lug.T": 1}, "E106", "no such parameter"),
        ({"*.own.T": 1}, "E117", "is computed from other"),
        ({"*.lag.T": 1, "robots.l*.T": 2}, "E501", "by \\*.lag.T and by robots.l\\*.T"),
    ],
)  # fmt: skip
def test_what_is_no_value_for_copies_is_told(given: dict[str, Any], code: str, told: str) -> None:
    with pytest.raises((ModelError, UsageError), match=told) as caught:
        FLEET.run(parameters=given)
    assert caught.value.code == code


def test_a_copy_is_varied_once() -> None:
    for first, second in (("robots.lag.T", "robots[1].lag.T"), ("robots[1].lag.T", "*.lag.T"), ("*.lag.T", "*.l*.T")):
        with pytest.raises(UsageError, match="already"):
            FLEET.batch([first, second])
    with pytest.raises(UsageError, match="the copies 0 to 2"):
        FLEET.batch(["robots[3].lag.T"])


def test_the_command_line_and_studies_take_the_same_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("fleet.json").write_text(json.dumps(FLEET.to_json()))
    ends = [FLEET.run(parameters=LAGS).measures["end"], FLEET.run(parameters={"robots.lag.T": 0.2}).measures["end"]]

    def measured(*words: str) -> float:
        assert main([*words, "--json"]) == 0
        lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        found = next(line for line in lines if "measures" in line or "quantiles" in line)
        return float(found["measures"]["end"] if "measures" in found else found["quantiles"]["end"][1])

    assert measured("run", "fleet.json", "--set", "robots[*].lag.T=[0.1,0.2,0.4]") == ends[0]
    assert measured("run", "fleet.json", "--set", "*.lag.T=200 ms") == ends[1]
    assert measured("sweep", "fleet.json", "--vary", "*.lag.T=0.2") == ends[1]
    assert measured("sweep", "fleet.json", "--vary", "n=3", "--scenario", "a:robots.a=[1,2,4],*.lag.T=0.2") == ends[1]
    written = {
        "format": "blocks-study", "version": 1,
        "runs": {"run": {"diagram": "fleet.json", "parameters": {"robots[*].lag.T": [0.1, 0.2, 0.4]}}},
        "sweeps": {"rows": {"diagram": "fleet.json", "vary": {"each(*.lag.T)": [0.2]}}},
    }  # fmt: skip
    Path("study.json").write_text(json.dumps(written))
    outcome = study.run(study.load("study.json"))
    assert outcome.results["run"].measures["end"] == ends[0]
    assert outcome.sweeps["rows"].measures["end"].tolist() == [ends[1]]
    assert list(outcome.sweeps["rows"].varied) == [f"robots[{k}].lag.T" for k in ALL]


def test_what_a_tuning_finds_for_all_copies_is_written(tmp_path: Path) -> None:
    path = tmp_path / "fleet.json"
    path.write_text(json.dumps(FLEET.to_json()))
    found = Diagram.load(path).tune(over={"*.lag.T": (0.1, 0.4)}, minimize="1-end", budget=6)
    found.write(path)
    inside = json.loads(path.read_text())["blocks"]["robots"]["diagram"]["blocks"]["lag"]
    assert inside["parameters"] == {"T": found.values["*.lag.T"]}
    best = FLEET.run(parameters={f"robots[{k}].lag.T": found.values["*.lag.T"] for k in ALL}).measures["end"]
    assert Diagram.load(path).run().measures["end"] == best > FLEET.run().measures["end"]


def test_an_fmu_starts_from_values_of_all_names(tmp_path: Path) -> None:
    FLEET.export(tmp_path / "fleet.fmu", parameters={"*.lag.T": ["100 ms", 0.2, 0.4]}, platforms=())
    description = zipfile.ZipFile(tmp_path / "fleet.fmu").read("modelDescription.xml").decode()
    starts = dict(re.findall(r'name="(robots\[\d\]\.lag\.T)"[^>]* start="([^"]*)"', description))
    assert {name: float(start) for name, start in starts.items()} == LAGS
