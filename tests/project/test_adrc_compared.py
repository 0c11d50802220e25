"""The page that compares ADRC with others: its numbers, once more from the gains that it prints."""

from __future__ import annotations

import math
import re
from typing import Any, NamedTuple

import control
import numpy as np
import pytest

from benchmarks import adrc_compared as compared
from blocks.analysis import margins

PAGE = compared.PAGE.read_text(encoding="utf-8")


class Printed(NamedTuple):
    """A row of the page's second table."""

    plant: compared.Plant
    method: compared.Method
    x: np.ndarray
    Ms: float
    Mt: float
    noise: float


def printed() -> list[Printed]:
    """Read the second table of the page."""
    plants = {plant.name: plant for plant in compared.PLANTS}
    found = []
    for line in PAGE.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 6 and cells[0] in plants:
            plant = plants[cells[0]]
            method = next(method for method in compared.methods(plant) if method.form == cells[1])
            x = np.array([float(number) for number in re.findall(r"[\d.e+-]+(?=,|$)", cells[2])])
            found.append(Printed(plant, method, x, *map(float, cells[3:])))
    return found


def cell(plant: compared.Plant, name: str) -> tuple[float, float, float | None, float]:
    """Return integral after a load, what 95 % stay below, the share that is lost, integral after r, as printed."""
    line = next(line for line in PAGE.splitlines() if line.startswith(f"| {plant.name}, "))
    text = line.strip("| ").split(" | ")[1 + compared.NAMES.index(name)]
    load, kept, track = re.fullmatch(r"([\d.e-]+) \((.*)\); ([\d.e-]+)", text).groups()  # type: ignore[union-attr]
    lost = re.fullmatch(r"(\d+)% lost", kept)
    return float(load), math.inf if lost else float(kept), int(lost[1]) / 100 if lost else None, float(track)


ROWS = printed()


def test_every_plant_has_every_controller() -> None:
    assert {(row.plant.name, row.method.name) for row in ROWS} == {
        (plant.name, name) for plant in compared.PLANTS for name in compared.NAMES
    }


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.plant.name}-{row.method.name}")
def test_the_printed_numbers_give_the_printed_loop(row: Printed) -> None:
    """From matrices; and within the limits that all have to keep."""
    plant, model = row.plant, row.plant.matrices()
    got = compared.found(plant, model, row.method.design(plant, model, row.x))
    assert got is not None
    load, _, _, track = cell(plant, row.method.name)
    assert got.Ms == pytest.approx(row.Ms, abs=0.006)
    assert got.Mt == pytest.approx(row.Mt, abs=0.006)
    assert got.noise == pytest.approx(row.noise, rel=6e-3)
    assert max(row.Ms, row.Mt) <= compared.HIGHEST + 0.005
    assert row.noise <= plant.noise * 1.002
    if not plant.nonlinear:
        assert got.load == pytest.approx(load, rel=0.02)
        assert got.track == pytest.approx(track, rel=0.03)


@pytest.mark.parametrize("row", ROWS[::6], ids=lambda row: f"{row.plant.name}-{row.method.name}")
def test_runs_and_margins_of_the_diagram_agree(row: Printed) -> None:
    diagram = compared.loop(row.plant, row.method, row.x)
    load, _, _, track = cell(row.plant, row.method.name)
    run = diagram.run(stop=2 * row.plant.rest, method="auto", rtol=1e-6, atol=1e-9, every=row.plant.rest)
    assert run.measures["load"] == pytest.approx(load, rel=6e-3)
    assert run.measures["track"] == pytest.approx(track, rel=6e-3)
    if not row.plant.nonlinear:
        linear = diagram.linearizer()
        opened = linear.delayed_loop("total.y") if row.plant.delay else linear.loop("total.y")
        assert margins(opened).Ms == pytest.approx(row.Ms, abs=0.02)


@pytest.mark.parametrize("row", [row for row in ROWS if row.method.name == "PID"], ids=lambda row: row.plant.name)
def test_the_pid_is_the_one_of_the_textbook(row: Printed) -> None:
    """C = (kp + ki/s + kd s)/(Tf^2 s^2/2 + Tf s + 1) by python-control, with the norm of u under noise by its norm."""
    kp, ki, kd, Tf, _ = row.x
    C = control.tf([kd, kp, ki], [1.0, 0.0]) * control.tf([1.0], [Tf**2 / 2, Tf, 1.0])
    w = np.geomspace(1e-3, 1e5, 20000)
    L = np.asarray(C(1j * w)) * row.plant.response(1j * w)
    assert np.abs(1 / (1 + L)).max() == pytest.approx(row.Ms, abs=0.006)
    if not row.plant.delay:
        CS: Any = control.feedback(C, control.tf(row.plant.num, row.plant.den))
        assert control.norm(control.ss(CS), 2) == pytest.approx(row.noise, rel=0.01)


@pytest.mark.long
@pytest.mark.parametrize("row", ROWS[::13], ids=lambda row: f"{row.plant.name}-{row.method.name}")
def test_the_share_of_other_plants_is_the_printed_one(row: Printed) -> None:
    _, worst, lost, _ = cell(row.plant, row.method.name)
    _, share, kept = compared.runs(row.plant, compared.loop(row.plant, row.method, row.x))
    assert share == pytest.approx(lost or 0.0, abs=0.02 if lost else 0.05)
    if not lost:
        assert kept == pytest.approx(worst, rel=0.02)
