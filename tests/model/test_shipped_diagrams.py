"""The diagram files of this project are canonical, and free of faults."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram
from blocks.contract.resolution import resolve
from blocks.library import LIBRARY
from blocks.model import document
from blocks.model.flatten import Flat
from tests.support.documents import SHIPPED
from tests.support.places import ROOT

FOLDER = ROOT / "diagrams"
FILES = SHIPPED
PAPER = ("adrc", "iadrc")
MEASURES = ["OPI_x", "OPI_y", "OPI_theta", "ITAE_right", "ISU_right", "ITAE_left", "ISU_left", "peak_e_theta"]

each_file = pytest.mark.parametrize("path", FILES, ids=[str(path.relative_to(FOLDER)) for path in FILES])
each_paper = pytest.mark.parametrize("name", PAPER)


def flat(path: Path, **overrides: Any) -> Flat:
    return Diagram.load(path).flatten(parameters=overrides)


def parameter(made: Flat, path: str) -> Any:
    block, _, name = path.rpartition(".")
    return next(one.resolved.values[name].value for one in made.blocks if one.path == block)


@each_file
def test_a_file_is_canonical(path: Path) -> None:
    assert document.dumps(document.load(path)) == path.read_text(encoding="utf-8")


@each_file
def test_a_file_has_no_faults(path: Path) -> None:
    made = Diagram.load(path).check()
    assert made is None or not made.warnings


@each_file
def test_every_signal_of_a_file_has_a_unit_unless_it_has_none(path: Path) -> None:
    # Those of adrc_n come where it is used; what a StateSpace has inside, as that of the rod, has none. What the agents
    # agree on is left open.
    without = {"sampled_loop", "adrc_1", "adrc_2", "adrc_3", "rod", "consensus", "satellite"}
    made = flat(path)
    if made.name not in without:
        assert [name for name, signal in made.signals.items() if "" in signal.units and signal.type == "real"] == []


@each_file
def test_every_block_has_a_place_of_its_own_on_the_grid(path: Path) -> None:
    diagram = document.load(path)
    places = [tuple(float(x) for x in diagram.layout[name]) for name in (*diagram.blocks, *diagram.inputs)]
    assert len(set(places)) == len(places)
    assert all(x % 20 == 0 for place in places for x in place)


@each_file
def test_a_file_says_what_it_is(path: Path) -> None:
    diagram = document.load(path)
    assert diagram.doc
    assert diagram.name == path.stem
    assert all(isinstance(entry, dict) and entry.get("doc") for entry in diagram.parameters.values())


@each_paper
def test_the_papers_diagrams_have_its_parts(name: str) -> None:
    diagram = document.load(FOLDER / "paper" / f"{name}.json")
    assert list(diagram.measures) == MEASURES
    assert set(diagram.parameters) == {"torque", "torque_on", "torque_off", "heading", "Jeq"}
    for side in ("left", "right"):
        assert diagram.blocks[f"motor_{side}"].type == "PMDCMotor"
        controller = diagram.blocks[f"control_{side}"].inner
        assert controller is not None
        assert {"td", "nlsef", "eso"} < set(controller.blocks)


@each_paper
def test_what_a_user_sets_reaches_the_blocks(name: str) -> None:
    path = FOLDER / "paper" / f"{name}.json"
    made = flat(path)
    assert parameter(made, "robot.kinematics.theta_start") == parameter(made, "reference.kinematics.theta_start")
    assert parameter(made, "robot.kinematics.theta_start") == np.pi / 4
    assert parameter(made, "disturbance.torque") == 3.0
    nominal = 1.1882 / (0.82 * 0.2752 * 3.0)
    changed = flat(path, torque=6.0, torque_on=30, heading={"value": 90, "unit": "deg"}, Jeq=0.4)
    assert parameter(changed, "robot.kinematics.theta_start") == np.pi / 2
    assert (parameter(changed, "disturbance.torque"), parameter(changed, "disturbance.on")) == (6.0, 30.0)
    for side in ("left", "right"):
        assert parameter(changed, f"motor_{side}.Jeq") == 0.4
        for block in ("nlsef", "eso"):
            assert parameter(changed, f"control_{side}.{block}.b0") == pytest.approx(nominal, rel=1e-15)


@each_paper
def test_the_papers_values_in_the_files_are_the_defaults_of_the_library(name: str) -> None:
    for block in flat(FOLDER / "paper" / f"{name}.json").blocks:
        if block.path.startswith("control_right.") and block.path != "control_right.estimate":
            defaults = resolve(LIBRARY[block.interface.name], {}).values
            for key, value in block.resolved.values.items():
                if key not in ("unit", "unit_u", "form") and value.value is not None:
                    assert defaults[key].value == pytest.approx(value.value, rel=1e-15), f"{block.path}.{key}"
