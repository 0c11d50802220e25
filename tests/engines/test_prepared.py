"""Prepared models with other values: the same Plans, bit for bit, as those that are made anew."""

import dataclasses
import random
from collections.abc import Iterator, Mapping
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

from blocks import Block, Diagram, Parameter, Sine, TransportDelay, ZeroOrderHold, output
from blocks.compile.bindings import bindings
from blocks.compile.plan import Plan
from blocks.engines.prepared import Prepared
from blocks.library import LIBRARY
from blocks.model.copies import Later
from blocks.text.errors import ModelError
from tests.support.documents import SHIPPED, is_unlike, span
from tests.support.library_variants import VARIANTS
from tests.support.marks import long_but

FIELDS = [field.name for field in dataclasses.fields(Plan) if field.compare and field.name != "signals"]


def prepared(diagram: Diagram, parameters: Mapping[str, Any], settings: Mapping[str, Any]) -> Prepared:
    return Prepared.of(diagram.value, diagram._draft.resolver, parameters, settings, trust=())


def shown(field: Any) -> str:
    """As it is written out, where it is made when it is asked for."""
    return repr(tuple(field) if isinstance(field, Later) else field)


def same(ours: Prepared, anew: Prepared) -> None:
    """All that a run is made of is the same, to the last bit."""
    assert isinstance(ours.plan, Plan)
    assert isinstance(anew.plan, Plan)
    for name in FIELDS:
        assert shown(getattr(ours.plan, name)) == shown(getattr(anew.plan, name)), name
    assert ours.equations.record == anew.equations.record


def others(raw: float, chance: random.Random) -> Iterator[Any]:
    yield from (
        raw * 1.25 + 0.125,
        raw * 0.5,
        -raw,
        0.0,
        -0.0,
        raw,
        raw + 1e9,
        chance.uniform(-5.0, 5.0),
        float(int(raw) + 1),
    )
    yield from (1, True, "x", None, float("nan"), float("inf"), [raw, raw], {"value": raw + 0.5})


def shaped(value: Any, shape: tuple[int, ...]) -> Any:
    if not shape:
        return value
    return [shaped(value, shape[1:]) for _ in range(shape[0])]


def compared(diagram: Diagram, settings: Mapping[str, Any], chance: random.Random, most: int) -> tuple[int, int]:
    """How many other values were taken without flattening, and how many were not though they are valid.

    most: of how many parameters that can be set; those that are computed from others are passed over.
    """
    base = prepared(diagram, {}, settings)
    assert isinstance(base.plan, Plan)
    known = bindings(base.flat, base.plan)
    quick = slow = taken = 0
    for setting in chance.sample(known, len(known)):
        if setting.type == "text" or taken == most:
            continue
        first = float(setting.values[0]) if setting.values else 0.0
        raw = shaped(first, setting.shape)
        try:
            own = prepared(diagram, {setting.path: raw}, settings)
        except ModelError:
            continue
        taken += 1
        for item in others(first, chance):
            given = {setting.path: item if isinstance(item, (list, dict)) else shaped(item, setting.shape)}
            ours = own.with_values(given, settings)
            try:
                anew = prepared(diagram, given, settings)
            except ModelError:
                assert ours is None, given
                continue
            if ours is None:
                slow += 1
            else:
                quick += 1
                same(ours, anew)
    return quick, slow


class Wheel(Block):
    """A parameter whose unit follows from a computed default."""

    kind = Parameter(1, type="int", structural=True)
    form = Parameter(lambda kind: kind, type="int", structural=True)
    speed = Parameter(60.0, unit=lambda form: "rpm" if form == 1 else "rad/s")

    @output
    def y(speed):
        return speed


def test_another_value_is_in_the_unit_that_it_has_where_the_diagram_is_flattened() -> None:
    diagram = Diagram("one")
    diagram.add("wheel", Wheel())
    settings = {"stop": 1.0}
    ours = prepared(diagram, {"wheel.speed": 60.0}, settings).with_values({"wheel.speed": 120.0}, settings)
    assert ours is not None
    same(ours, prepared(diagram, {"wheel.speed": 120.0}, settings))


@pytest.mark.parametrize("name", sorted(LIBRARY))
def test_other_values_of_a_block_make_the_plan_that_is_made_anew(name: str) -> None:
    chance = random.Random(name)
    for given in [given for kind, given in VARIANTS if kind == name]:
        diagram = Diagram.alone(LIBRARY[name](**given))
        compared(diagram, {"stop": 1.0}, chance, 6)


def is_small(path: Path) -> bool:
    return is_unlike(path) and path.stem not in ("formation", "platoon")


@pytest.mark.parametrize("path", long_but(SHIPPED, is_small), ids=lambda path: path.stem)
def test_other_values_in_a_shipped_diagram_make_the_plan_that_is_made_anew(path: Any) -> None:
    diagram = Diagram.load(path)
    if not isinstance(diagram.check(), Plan):
        pytest.skip("it is stepped by a master")
    quick, _ = compared(diagram, {"stop": span(path, 1.0)}, random.Random(path.stem), 8)
    assert quick > 5 or path.stem in ("consensus", "decay")  # whose numbers are in counts, edges and expressions


def test_what_is_derived_of_a_plan_with_other_values_is_of_these() -> None:
    """A derived value that is taken over although it depends on parameters or settings would be one of other runs."""
    diagram = Diagram("late")
    wave = diagram.add("wave", Sine(amplitude=1.0))
    late = diagram.add("late", TransportDelay(delay=0.5))
    held = diagram.add("held", ZeroOrderHold(period=0.25))
    diagram.wire(late.u, wave.y)
    diagram.wire(held.u, late.y)
    diagram.settings(stop=2.0)
    plan = prepared(diagram, {"late.delay": 0.5}, {}).plan
    assert isinstance(plan, Plan)
    derived = [name for name, value in vars(Plan).items() if isinstance(value, cached_property)]
    for name in derived:
        getattr(plan, name)
    parameters = tuple(0.75 if x == 0.5 else x for x in plan.parameters)
    settings = dataclasses.replace(plan.settings, start=Fraction(-3), stop=Fraction(4))
    taken = plan.with_values(parameters, settings)
    anew = dataclasses.replace(plan, parameters=parameters, settings=settings)
    assert taken.delays != plan.delays
    assert taken.time_scale != plan.time_scale
    assert {name: getattr(taken, name) for name in derived} == {name: getattr(anew, name) for name in derived}
    assert {**vars(taken)}.keys() >= {field.name for field in dataclasses.fields(Plan)}
