"""Copies and pickles: a diagram is the same in them, with its files and places; a run refuses them."""

import copy
import json
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    BouncingBall,
    Diagram,
    FMUError,
    Gain,
    Input,
    Integrator,
    ModelError,
    Parameter,
    PMDCMotor,
    Step,
    UsageError,
    fmu,
    output,
)
from tests.support.places import DIAGRAMS, FMUS, PAPER, ROOT


class Tripled(Block):
    """y = 3 k u."""

    k = Parameter(1.0)
    u = Input()

    @output
    def y(u, k):
        return 3.0 * k * u


WAYS: dict[str, Callable[[Any], Any]] = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda made: pickle.loads(pickle.dumps(made)),
    "pickle of protocol 2": lambda made: pickle.loads(pickle.dumps(made, 2)),
    "copy of a copy": lambda made: copy.deepcopy(pickle.loads(pickle.dumps(made))),
}
FILES = sorted(path for path in DIAGRAMS.rglob("*.json") if '"blocks-diagram"' in path.read_text(encoding="utf-8"))


def told(diagram: Diagram, **settings: Any) -> list[tuple[str, str, int, int]]:
    """The faults of a diagram with their places."""
    with pytest.raises(ModelError) as caught:
        diagram.run(**settings)
    return [(str(fault), fault.file, fault.line, fault.column) for fault in caught.value.faults]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_copy_of_a_shipped_diagram_is_equal_in_all(path: Path, way: str) -> None:
    loaded = Diagram.load(path)
    made = WAYS[way](loaded)
    assert made.dumps() == loaded.dumps() == Diagram.load(path).dumps()
    assert made.value == loaded.value
    assert made.value.file == loaded.value.file
    assert made.value.folder == loaded.value.folder
    assert dict(made.value.positions) == dict(loaded.value.positions)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", ["sampled_loop.json", "paper/control_iadrc_sampled.json", "paper/iadrc_fmu.json"])
def test_a_copy_of_a_diagram_with_files_below_it_runs_alike(name: str, way: str) -> None:
    loaded = Diagram.load(DIAGRAMS / name)
    inputs = {key: 0.5 for key, entry in loaded.value.inputs.items() if "default" not in entry}
    settings = {"stop": 0.05, "inputs": inputs, "engine": "reference"}
    made = WAYS[way](loaded)
    expected = loaded.run(**settings)
    assert expected.values.any()
    assert np.array_equal(made.run(**settings).values, expected.values)


def broken(folder: Path) -> Diagram:
    """A file, its subdiagram and a variant of that, each with a fault of its own, and a block type of ours."""
    inner = {
        "format": "blocks-diagram", "version": 3, "inputs": {"u": {}}, "outputs": {"y": "g.y"},
        "blocks": {"g": {"type": "Gain", "parameters": {"k": -1}}}, "wires": {"g.u": "u"},
    }  # fmt: skip
    other = {**inner, "blocks": {"g": {"type": "Gain", "parameters": {"q": 2}}}}
    outer = {
        "format": "blocks-diagram", "version": 3,
        "blocks": {
            "one": {"type": "Constant", "parameters": {"nothing": 1}},
            "ours": {"type": "Tripled", "parameters": {"k": 2}},
            "sub": {"diagram": "inner.json", "variants": {"other": {"diagram": "other.json"}}},
        },
        "wires": {"ours.u": "one.y", "sub.u": "ours.z"},
    }  # fmt: skip
    inner["wires"] = {"g.u": "v"}
    for name, document in {"inner": inner, "other": other, "outer": outer}.items():
        (folder / f"{name}.json").write_text(json.dumps(document, indent=1), encoding="utf-8")
    return Diagram.load(folder / "outer.json", library=Tripled)


@pytest.mark.parametrize("way", WAYS)
def test_faults_of_a_copy_have_the_places_of_the_files(tmp_path: Path, way: str) -> None:
    before = WAYS[way](broken(tmp_path))  # nothing was asked for its place yet
    loaded = broken(tmp_path)
    faults = [told(loaded, stop=1.0, variants=variants) for variants in ({}, {"sub": "other"})]
    assert [Path(fault[1]).name for fault in faults[0]] == ["outer.json", "outer.json", "inner.json"]
    assert [Path(fault[1]).name for fault in faults[1]] == ["outer.json", "outer.json", "other.json"]
    text = (tmp_path / "inner.json").read_text(encoding="utf-8").splitlines()
    _, _, line, column = faults[0][-1]
    assert text[line - 1][column - 1 :] == '"v"'
    for made in (before, WAYS[way](loaded)):
        assert [told(made, stop=1.0, variants=variants) for variants in ({}, {"sub": "other"})] == faults


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_of_what_was_built_and_run_is_a_diagram_of_its_own(way: str) -> None:
    diagram = Diagram("built", library=Tripled)
    diagram.add("ours", Tripled(k=0.5))
    diagram.add("x", Integrator())
    diagram.wire("ours.u", diagram.input("u", default=2.0))
    diagram.wire("x.u", "ours.y")
    first = diagram.run(stop=1.0)
    diagram.point()
    diagram.add("more", Gain())  # stands in what is not yet frozen
    diagram.note = "ours"  # type: ignore[attr-defined]
    made = WAYS[way](diagram)
    assert made.note == "ours"
    diagram.add("later", Gain())
    made.add("beside", Gain())
    assert [*made.value.blocks] == ["ours", "x", "more", "beside"]
    assert [*diagram.value.blocks] == ["ours", "x", "more", "later"]
    made.wire("more.u", "x.y")
    made.wire("beside.u", "x.y")
    results = made.run(stop=1.0)
    assert results["x.y"][-1] == pytest.approx(3.0, rel=1e-9), "the integral of 3 * 0.5 * 2 over 1 s"
    assert results["x.y"][-1] == first["x.y"][-1]


@pytest.mark.parametrize("kind", ["CS", "ME"])
@pytest.mark.parametrize("way", WAYS)
def test_a_block_that_is_an_fmu_is_copied_with_its_way_of_running(way: str, kind: str) -> None:
    block = fmu(FMUS / "PMDCMotor.fmu", kind=kind, isolate=kind == "CS", timeout=20.0, Ra=0.3)
    again = WAYS[way](block)
    assert again == block
    assert type(again) is type(block), "one file has one class"
    diagram, plain = Diagram("motor"), Diagram("motor")
    for made, motor in ((diagram, block), (plain, PMDCMotor(Ra=0.3))):
        made.add("step", Step(at=0.0, after=6.0, unit="V"))
        made.add("motor", motor)
        made.wire("motor.v", "step.y")
    inner = Diagram("outer")
    inner.add("sub", diagram)
    copied = WAYS[way](inner)
    assert copied.dumps() == inner.dumps()
    settings = {"stop": 0.02, "engine": "reference", "every": 0.01, "rtol": 1e-8}
    assert np.array_equal(copied.run(**settings).values, inner.run(**settings).values)
    if kind == "ME":
        expected = plain.run(**settings)["motor.omega"]
        assert copied.run(**settings)["sub.motor.omega"] == pytest.approx(expected, rel=1e-6)


def test_a_diagram_that_names_an_fmu_outside_of_its_project_is_as_little_trusted_when_it_is_copied(
    tmp_path: Path,
) -> None:
    (tmp_path / "project").mkdir()
    named = {"m": {"fmu": str(FMUS / "PMDCMotor.fmu"), "kind": "CS", "parameters": {}}}
    file = tmp_path / "project" / "d.json"
    document = {"format": "blocks-diagram", "version": 3, "blocks": named, "wires": {"m.v": "u"}}
    file.write_text(json.dumps({**document, "inputs": {"u": {"unit": "V", "default": 1}}}), encoding="utf-8")
    for way in WAYS.values():
        with pytest.raises(FMUError, match="E218"):
            way(Diagram.load(file)).run(stop=0.01)


def test_a_pickle_is_the_diagram_in_another_process() -> None:
    diagram = Diagram.load(PAPER / "control_iadrc.json")
    script = "import pickle, sys; sys.stdout.write(pickle.load(sys.stdin.buffer).dumps())"
    ran = subprocess.run(
        [sys.executable, "-X", "utf8", "-c", script], input=pickle.dumps(diagram), capture_output=True, cwd=ROOT,
        check=True,
    )  # fmt: skip
    assert ran.stdout.decode().replace("\r\n", "\n") == diagram.dumps()


@pytest.mark.parametrize("way", WAYS)
def test_a_run_is_not_copied_and_says_what_to_take_instead(way: str) -> None:
    diagram = Diagram("ball")
    diagram.add("ball", BouncingBall())
    run = diagram.start(stop=1.0)
    run.advance(0.4)
    for error in (UsageError, TypeError):
        with pytest.raises(error, match=r"^E501 ball: a run cannot be copied or pickled.*snapshot\(\).*save\(path\)"):
            WAYS[way](run)
    other = diagram.start(stop=1.0, resume=WAYS[way](run.snapshot()))
    assert other["ball.h"] == run["ball.h"]
    run.advance_to(1.0)
    other.advance_to(1.0)
    assert other["ball.h"] == run["ball.h"]
    assert other["ball.v"] == run["ball.v"]
