"""Drawing: the same bytes for the same diagram, and a geometry in which nothing runs through or over anything."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from itertools import combinations, pairwise, permutations
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.drawing import placed
from blocks.draw import Picture, Ports, picture, ports_of, rendered, svg
from blocks.draw.layout_graph import pieces
from blocks.draw.picture import Box, Wire
from blocks.draw.shapes import polynomial
from blocks.draw.text import cut, plain, width_of
from blocks.model.block_types import library_types
from blocks.model.diagram_value import BlockEntry, DiagramValue
from blocks.model.document import from_document, load, loads
from blocks.model.resolver import resolver_of
from blocks.text.errors import Fault, ModelError
from tests.support.marks import long
from tests.support.places import ROOT

SVG = "{http://www.w3.org/2000/svg}"
NEAR = 1e-6
HEAD = 7.0  # length of an arrow head

Rectangle = tuple[float, float, float, float]


@cache
def resolver() -> Callable[[str], Any]:
    return resolver_of(library_types())


def drawings() -> list[Path]:
    made = []
    for path in sorted((ROOT / "diagrams").rglob("*.json")):
        try:
            load(path)
        except ModelError:  # a study, or another document
            continue
        made.append(path)
    return made


def without_positions(value: DiagramValue) -> DiagramValue:
    blocks = {
        name: entry if entry.loaded is None else replace(entry, loaded=without_positions(entry.loaded))
        for name, entry in value.blocks.items()
    }
    return replace(value, layout={}, blocks=blocks)


def pictured(value: DiagramValue, depth: int = 1, **options: Any) -> Picture:
    return picture(value, ports_of(value, resolver()), depth=depth, **options)


def drawn(value: DiagramValue, **options: Any) -> str:
    return svg(value, ports_of(value, resolver()), **options)


def small(**blocks: BlockEntry) -> DiagramValue:
    return DiagramValue("small", blocks=blocks)


# --- geometry --------------------------------------------------------------------------------------------------


def overlap(a: Rectangle, b: Rectangle, slack: float = NEAR) -> bool:
    return a[0] < b[2] - slack and b[0] < a[2] - slack and a[1] < b[3] - slack and b[1] < a[3] - slack


def legs(wire: Wire) -> Iterable[Rectangle]:
    """The pieces of a wire as rectangles without width."""
    for (x1, y1), (x2, y2) in pairwise(wire.points):
        yield min(x1, x2), min(y1, y2), max(x1, x2), max(y1, y2)


def hits(leg: Rectangle, area: Rectangle) -> bool:
    """Whether a piece of a wire enters the inside of an area."""
    left, top, right, bottom = area[0] + NEAR, area[1] + NEAR, area[2] - NEAR, area[3] - NEAR
    return leg[0] < right and left < leg[2] and leg[1] < bottom and top < leg[3]


def inside(path: str, frame: str) -> bool:
    return path.startswith(frame + ".")


def check_boxes(made: Picture) -> None:
    for a, b in combinations(made.boxes, 2):
        nested = (a.kind == "frame" and inside(b.path, a.path)) or (b.kind == "frame" and inside(a.path, b.path))
        assert nested or not overlap(a.edges, b.edges), (a.path, b.path)
    for box in made.boxes:
        left, top, right, bottom = box.edges
        assert min(left, top, made.width - right, made.height - bottom) >= 0, box.path
        for frame in made.boxes:
            if frame.kind == "frame" and inside(box.path, frame.path):
                around = frame.edges
                room = (left - around[0], top - around[1], around[2] - right, around[3] - bottom)
                assert min(room) > 0, (box.path, frame.path)


def check_wires(made: Picture) -> None:
    """Orthogonal, from port to port, through no block."""
    by_key: dict[tuple[str, bool], Box] = {}
    for box in made.boxes:
        by_key[box.path, box.kind == "output"] = box
    for wire in made.wires:
        for (x1, y1), (x2, y2) in pairwise(wire.points):
            assert (x1 == x2) != (y1 == y2), wire
        source = by_key[wire.source[0], False]
        goal = by_key.get((wire.sink[0], wire.sink[1] == ""), by_key.get((wire.sink[0], False)))
        assert goal is not None
        assert wire.points[0] == pytest.approx(source.outputs[wire.source[1]], abs=NEAR), wire
        assert wire.points[-1] == pytest.approx(goal.inputs[wire.sink[1]], abs=NEAR), wire
        assert wire.points[1][0] > wire.points[0][0], ("leaves to the right", wire)
        (x1, y1), (x2, y2) = wire.points[-2:]
        under = goal.shape.under == wire.sink[1] and bool(goal.shape.under)
        assert y1 - y2 >= HEAD if under else x2 - x1 >= HEAD, ("room for the arrow head", wire)
        for box in made.boxes:
            if box.kind == "frame" and (box in (source, goal) or inside(wire.source[0], box.path)):
                continue
            for leg in legs(wire):
                assert not hits(leg, box.edges), (wire, box.path)


def check_nets(made: Picture) -> None:
    """Nets cross at right angles only, and dots are where and only where a net branches."""
    nets: dict[str, list[Wire]] = {}
    for wire in made.wires:
        nets.setdefault(wire.net, []).append(wire)
    shapes = {net: pieces([wire.points for wire in wires]) for net, wires in nets.items()}
    for (a, one), (b, two) in combinations(shapes.items(), 2):
        for mine, others in zip(one, two, strict=True):
            for level, low, high in mine:
                for other, first, last in others:
                    shared = level == other and low <= last and first <= high
                    assert not shared, ("nets share a piece or touch", a, b, level)
        for flat, upright in ((one[0], two[1]), (two[0], one[1])):
            for y, left, right in flat:
                for x, top, bottom in upright:
                    ends = (x in (left, right) and top <= y <= bottom) or (y in (top, bottom) and left <= x <= right)
                    assert not ends, ("nets touch at an end", a, b, x, y)
    for net, wires in nets.items():
        wanted = set()
        flat, upright = shapes[net]
        for x, top, bottom in upright:
            for y, left, right in flat:
                if left <= x <= right and top <= y <= bottom:
                    ways = (left < x) + (x < right) + (top < y) + (y < bottom)
                    wanted |= {(x, y)} if ways > 2 else set()
        assert {(dot.x, dot.y) for dot in made.dots if dot.net == net} == wanted, (net, wires)


def check_texts(made: Picture) -> None:
    texts = [(box, text) for box in made.boxes for text in box.texts]
    for (_, a), (_, b) in combinations(texts, 2):
        assert not overlap(a.box, b.box, 0.3), (a, b)
    for owner, text in texts:
        for wire in made.wires:
            for leg in legs(wire):
                assert not hits(leg, text.box), (text, wire)
        for box in made.boxes:
            foreign = box is not owner and not (box.kind == "frame" and inside(owner.path, box.path))
            foreign = foreign and not (owner.kind == "frame" and inside(box.path, owner.path))
            assert not foreign or not overlap(text.box, box.edges), (text, box.path)


CLEAR = 4.0
"""Between a text and the outline of another box."""
ABREAST = 7.0
"""Between two nets beside each other."""


def check_clearances(made: Picture) -> None:
    """Texts keep clear of other boxes, and wires of two nets do not run nearly on one line."""
    for owner, box in permutations(made.boxes, 2):
        if "frame" not in (owner.kind, box.kind):
            for text in owner.texts:
                left, top, right, bottom = text.box
                around = (left - CLEAR, top - CLEAR, right + CLEAR, bottom + CLEAR)
                assert not overlap(around, box.edges), (text, box.path)
    nets: dict[str, list[Wire]] = {}
    for wire in made.wires:
        nets.setdefault(wire.net, []).append(wire)
    shapes = [pieces([wire.points for wire in wires]) for wires in nets.values()]
    for one, two in combinations(shapes, 2):
        for mine, others in zip(one, two, strict=True):
            for level, low, high in mine:
                for other, first, last in others:
                    assert abs(level - other) >= ABREAST or high < first or last < low, (level, other, low, high)


def check(made: Picture) -> None:
    check_boxes(made)
    check_wires(made)
    check_nets(made)
    check_texts(made)


def test_the_checks_find_what_they_look_for() -> None:
    made = pictured(without_positions(load(ROOT / "diagrams" / "motor_pid.json")))
    check(made)
    first, *rest = made.wires
    (x, y), *others = first.points
    wrong = [
        replace(made, dots=()),
        replace(made, dots=(*made.dots, replace(made.dots[0], x=0.0))),
        replace(made, wires=(replace(first, points=((x, y + 1), *others)), *rest)),
        replace(made, wires=(replace(rest[1], net="other"), *made.wires)),
        replace(made, boxes=(*made.boxes, replace(made.boxes[0], path="other", y=made.boxes[0].y + 9))),
        replace(made, boxes=(*made.boxes, replace(made.boxes[0], path="other", texts=(), x=others[0][0] - 32))),
    ]
    for picture_ in wrong:
        with pytest.raises(AssertionError):
            check(picture_)


# --- the diagrams that ship ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("positions", "depth"),
    [("given", 1), ("free", 1), ("given", 3), long("free", 3), long("given", 2), long("free", 2)],
)
@pytest.mark.parametrize("path", drawings(), ids=lambda path: path.stem)
def test_nothing_overlaps_in_the_diagrams_that_ship(path: Path, positions: str, depth: int) -> None:
    value = load(path)
    made = pictured(value if positions == "given" else without_positions(value), depth)
    check(made)
    check_clearances(made)
    wires = sum(1 for wire in made.wires if "." not in wire.source[0])
    assert wires == len(value.wires) + len(value.outputs)


@pytest.mark.parametrize("path", drawings(), ids=lambda path: path.stem)
def test_positions_of_the_file_are_kept(path: Path) -> None:
    value = load(path)
    made = pictured(value)
    places = {box.path: (box.x, box.y) for box in made.boxes if box.path in value.layout}
    if not places:
        return
    origin = min(places)
    for name, (x, y) in places.items():
        expected = [float(value.layout[name][k]) - float(value.layout[origin][k]) for k in (0, 1)]
        assert [x - places[origin][0], y - places[origin][1]] == pytest.approx(expected), name


def test_the_rest_is_laid_out_around_given_positions() -> None:
    value = load(ROOT / "diagrams" / "motor_pid.json")
    for kept in ({"motor": [600, 160]}, {"control": [220, 140], "motor": [700, 300]}):
        made = pictured(replace(value, layout=kept))
        check(made)
        places = {box.path: (box.x, box.y) for box in made.boxes}
        if len(kept) == 2:
            assert places["motor"][0] - places["control"][0] == 480
            assert places["motor"][1] - places["control"][1] == 160


@pytest.mark.parametrize("loops", [3, long(14)])  # up to 60 nets, and more
def test_after_an_edit_wires_elsewhere_run_as_before(loops: int) -> None:
    value = placed(loops)
    made = pictured(value)
    check(made)
    (x, y), wires = value.layout["limit2"], value.wires
    edits = [
        {"layout": {**value.layout, "limit2": [x, y + 40]}},
        {"layout": {**value.layout, "limit2": [x + 3, y + 17]}},  # off the grid
        {"wires": {**wires, "law1.y": "plant2.y"}},
        {"wires": {sink: source for sink, source in wires.items() if sink != "law1.y"}},
        {"blocks": {**value.blocks, "new": BlockEntry(type="Gain")}, "layout": {**value.layout, "new": [60, 90]}},
    ]
    for edit in edits:
        edited = replace(value, **edit)
        again = pictured(edited, earlier=made)
        check(again)
        same = [ends for ends, path in again.routes.items() if made.routes.get(ends) == path]
        assert len(same) > len(made.routes) / 2
    assert pictured(value, earlier=made) == made
    # Nothing is taken from a picture of something else.
    other = load(ROOT / "diagrams" / "motor_pid.json")
    assert pictured(other, earlier=made) == pictured(other)


def test_a_position_that_is_none_is_not_used() -> None:
    value = load(ROOT / "diagrams" / "motor_pid.json")
    free = without_positions(value)
    for bad in ([1e308, 0], [float("nan"), 0], ["1", "2"], [1], "here", None, [True, False]):
        assert drawn(replace(value, layout={"motor": bad})) == drawn(free)


def test_positions_far_apart_cost_no_memory() -> None:
    value = load(ROOT / "diagrams" / "motor_pid.json")
    made = pictured(replace(value, layout={"control": [-90_000, 0], "motor": [90_000, 90_000]}))
    check(made)
    places = {box.path: box.x for box in made.boxes}
    assert places["motor"] - places["control"] == 180_000
    blocks = {f"b{k}": BlockEntry(type="Gain") for k in range(400)}
    scattered = DiagramValue("wide", blocks=blocks, layout={name: [200 * k, 200 * k] for k, name in enumerate(blocks)})
    # So many that the lattice would be too large: laid out as if there were no positions.
    assert drawn(scattered) == drawn(replace(scattered, layout={}))


def test_a_loop_is_drawn_as_in_books() -> None:
    """The forward path is one straight line, and feedback comes from below into the second input of the sum."""
    made = pictured(without_positions(load(ROOT / "diagrams" / "sampled_loop.json")))
    forward = [wire for wire in made.wires if wire.sink != ("error", "u2")]
    assert {len(wire.points) for wire in forward} == {2}
    assert len({wire.points[0][1] for wire in forward}) == 1
    (back,) = (wire for wire in made.wires if wire.sink == ("error", "u2"))
    assert len(back.points) == 5
    assert max(y for _, y in back.points) > max(box.edges[3] for box in made.boxes)
    assert len(made.dots) == 1


# --- determinism and form --------------------------------------------------------------------------------------

SCRIPT = """
import sys
from pathlib import Path
from blocks.model.document import load
from blocks.model.block_types import library_types
from blocks.model.resolver import resolver_of
from blocks.draw import ports_of, svg
for path in sys.argv[1:]:
    value = load(Path(path))
    for depth in (1, 2):
        sys.stdout.write(svg(value, ports_of(value, resolver_of(library_types())), depth=depth))
"""


def test_the_bytes_are_the_same_in_every_process() -> None:
    paths = [str(path) for path in drawings()[:4]]
    outputs = []
    for seed in ("0", "1", "4711"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT, *paths], capture_output=True, check=True, cwd=ROOT, env=environment
        )
        outputs.append(done.stdout)
    assert outputs[0] == outputs[1] == outputs[2]
    own = "".join(drawn(load(Path(path)), depth=depth) for path in paths for depth in (1, 2))
    assert own.encode() == outputs[0]


@pytest.mark.parametrize("depth", [long(0), 1, long(2), 99])
@pytest.mark.parametrize("path", drawings(), ids=lambda path: path.stem)
def test_a_drawing_is_xml_that_asks_for_nothing_from_elsewhere(path: Path, depth: int) -> None:
    text = drawn(load(path), depth=depth)
    root = ElementTree.fromstring(text)
    assert root.tag == SVG + "svg"
    assert root.attrib["viewBox"].split()[2:] == [root.attrib["width"], root.attrib["height"]]
    for element in root.iter():
        assert element.tag.removeprefix(SVG) in {"svg", "style", "rect", "g", "path", "circle", "text", "title"}
        assert not {"id", "href", "onload"} & set(element.attrib)
    assert "url(" not in text
    assert "@import" not in text


def listed_ports(group: ElementTree.Element, key: str) -> dict[str, tuple[float, float]]:
    """The ports that a group lists, by name, as a page reads them."""
    at = [float(part) for part in group.attrib["data-at"].split()]
    ports = {}
    for item in filter(None, group.attrib.get(key, "").split(";")):
        x, y, *name = item.split(" ")
        ports[unquote(" ".join(name))] = (at[0] + float(x), at[1] + float(y))
    return ports


@pytest.mark.parametrize("path", drawings(), ids=lambda path: path.stem)
def test_a_page_finds_places_ports_and_ends_of_wires_by_attributes(path: Path) -> None:
    value = load(path)
    picture_ = pictured(value)
    root = ElementTree.fromstring(rendered(picture_, ""))
    groups = {
        (g.attrib["data-path"], g.attrib["class"].split()[0]): g
        for g in root.iter(SVG + "g")
        if "data-path" in g.attrib
    }
    made = {(box.path, box.kind): box for box in picture_.boxes}
    assert set(groups) == set(made)
    for key, box in made.items():
        for data, pins in (("data-in", box.inputs), ("data-out", box.outputs)):
            shift = [float(part) for part in groups[key].attrib["data-at"].split()]
            expected = {name: (shift[0] + x - box.x, shift[1] + y - box.y) for name, (x, y) in pins.items()}
            assert listed_ports(groups[key], data) == {
                name: pytest.approx(at, abs=0.02) for name, at in expected.items()
            }
    places = {key[0]: group.attrib["data-at"] for key, group in groups.items() if key[1] != "output"}
    given = {name: at for name, at in value.layout.items() if name in places}
    assert ("data-origin" in root.attrib) == bool(given)
    for name, (x, y) in given.items():
        origin = [float(part) for part in root.attrib["data-origin"].split()]
        at = [float(part) for part in places[name].split()]
        assert at == pytest.approx([origin[0] + float(x), origin[1] + float(y)], abs=0.02)
    wires = {g.attrib["data-sink"]: g.attrib["data-net"] for g in root.iter(SVG + "g") if "data-sink" in g.attrib}
    assert wires == {**value.wires, **value.outputs}
    dots = {dot.attrib["data-net"] for dot in root.iter(SVG + "circle") if "data-net" in dot.attrib}
    assert dots == {dot.net for dot in picture_.dots}


def test_ports_with_any_name_are_listed() -> None:
    names = ["a;b", "50%", "x y", "0 0 u", "<&\"'", "u"]
    value = small(g=BlockEntry(type="NoSuchType"), s=BlockEntry(type="Step"))
    root = ElementTree.fromstring(drawn(replace(value, wires={f"g.{name}": "s.y" for name in names})))
    (group,) = (g for g in root.iter(SVG + "g") if g.attrib.get("data-path") == "g")
    assert list(listed_ports(group, "data-in")) == names
    assert {g.attrib["data-sink"] for g in root.iter(SVG + "g") if "data-sink" in g.attrib} == {f"g.{n}" for n in names}


def test_a_diagram_without_blocks_is_drawn() -> None:
    check(pictured(DiagramValue("empty")))
    assert "empty" in drawn(DiagramValue("empty"))
    assert "<text" not in drawn(DiagramValue("empty"), title="")


def test_a_diagram_of_fourteen_blocks_fits_on_a_screen() -> None:
    names = ["reference", "error", "control", "limit", "plant", "sensor", "filter"]
    types = ["Step", "Sum", "PID", "Saturation", "TransferFunction", "Gain", "Integrator"]
    blocks, wires = {}, {}
    for loop in ("a", "b"):
        for name, type_ in zip(names, types, strict=True):
            blocks[f"{name}_{loop}"] = BlockEntry(type=type_)
        chain = [f"{name}_{loop}" for name in names]
        wires |= {f"{b}.{'u1' if 'error' in b else 'u'}": f"{a}.y" for a, b in pairwise(chain)}
        wires[f"error_{loop}.u2"] = f"filter_{loop}.y"
    made = pictured(DiagramValue("two_loops", blocks=blocks, wires=wires))
    check(made)
    assert made.width <= 1200
    assert made.height <= 600


def test_two_hundred_blocks_take_less_than_a_second() -> None:
    blocks, wires = {}, {}
    for row in range(20):
        for k in range(10):
            name = f"b{row}_{k}"
            blocks[name] = BlockEntry(type="Sum" if k == 0 else "Gain")
            if k:
                wires[f"{name}.u"] = f"b{row}_{k - 1}.y"
        wires[f"b{row}_0.u1"] = f"b{(row + 19) % 20}_{(row * 3) % 10}.y"
        wires[f"b{row}_0.u2"] = f"b{row}_9.y"
    value = DiagramValue("many", blocks=blocks, wires=wires)
    known = {"Sum": Ports(("u1", "u2"), ("y",)), "Gain": Ports(("u",), ("y",))}
    begin = time.process_time()
    svg(value, lambda path: known[blocks[path].type])
    assert time.process_time() - begin < 1.0
    check(picture(value, lambda path: known[blocks[path].type]))


# --- symbols ---------------------------------------------------------------------------------------------------


def texts_of(value: DiagramValue, **options: Any) -> list[str]:
    return [text.text for box in pictured(value, **options).boxes for text in box.texts]


def test_symbols_show_their_key_parameters() -> None:
    loaded = from_document(
        {
            "format": "blocks-diagram",
            "version": 3,
            "blocks": {
                "k": {"type": "Gain", "parameters": {"k": {"value": 2.5, "unit": "V"}}},
                "sum": {"type": "Sum", "parameters": {"signs": "-+"}},
                "quotient": {"type": "Product", "parameters": {"operations": "*/"}},
                "h": {"type": "TransferFunction", "parameters": {"num": [1], "den": [1, 0.2, 1]}},
                "bound": {"type": "Gain", "parameters": {"k": "=1/b0"}},
                "hold": {"type": "ZeroOrderHold", "parameters": {"period": {"value": 10, "unit": "ms"}}},
                "delay": {"type": "UnitDelay", "parameters": {"period": 0.1}},
            },
        }
    )
    texts = texts_of(loaded)
    for shown in ("2.5 V", "−", "+", "×", "÷", "s² + 0.2s + 1", "1/b0", "10 ms", "0.1", "z⁻¹"):
        assert shown in texts, shown


@pytest.mark.parametrize(
    ("coefficients", "text"),
    [
        ([1], "1"),
        ([1, 0], "s"),
        ([-1, 0, 2.5], "−s² + 2.5"),
        ([2, -1], "2s − 1"),
        ([0, 0], "0"),
        (["k"], ""),
        ([], "0"),
    ],
)
def test_polynomials_are_written_as_on_paper(coefficients: list[Any], text: str) -> None:
    assert polynomial(coefficients) == text


def test_every_block_of_the_library_has_a_drawing() -> None:
    blocks = {f"block_{name}": BlockEntry(type=name) for name in library_types()}
    made = pictured(small(**blocks))
    check(made)
    assert len(made.boxes) == len(blocks)


def test_ports_have_names_inside_where_there_is_more_than_one() -> None:
    texts = texts_of(small(motor=BlockEntry(type="PMDCMotor"), gain=BlockEntry(type="Gain")))
    assert texts.count("omega") == texts.count("tau") == 1
    assert "u" not in texts


def test_fmus_and_subdiagrams_are_marked() -> None:
    inner = DiagramValue("inner", inputs={"u": {}}, outputs={"y": "u"})
    value = DiagramValue(
        "outer",
        blocks={"motor": BlockEntry(fmu="../fmus/PMDCMotor.fmu"), "sub": BlockEntry(diagram=inner)},
        wires={"motor.v": "sub.y", "motor.body.x[1]": "sub.y", "sub.u": "motor.omega"},
    )
    made = pictured(value)
    check(made)
    assert {box.path: box.kind for box in made.boxes} == {"motor": "fmu", "sub": "diagram"}
    texts = texts_of(value)
    assert {"FMU", "PMDCMotor", "inner", "body.x[1]"} <= set(texts)


def test_elements_of_a_vector_are_ports_of_their_own() -> None:
    value = from_document(
        {
            "format": "blocks-diagram",
            "version": 3,
            "inputs": {"r": {}},
            "blocks": {
                "plant": {
                    "type": "StateSpace",
                    "parameters": {"A": [[-1, 0], [0, -2]], "B": [[1, 0], [0, 1]], "C": [[1, 1]]},
                },
                "k": {"type": "Gain"},
            },
            "wires": {"plant.u[0]": "r", "k.u": "plant.x[1]"},
        }
    )
    made = pictured(value)
    check(made)
    (plant,) = (box for box in made.boxes if box.path == "plant")
    assert list(plant.inputs) == ["u[0]", "u[1]"]
    assert list(plant.outputs) == ["y", "x[1]"]
    assert [(mark.path, mark.port) for mark in made.opens] == [("plant", "u[1]")]


# --- faults, rates, hostile texts ------------------------------------------------------------------------------


def test_faults_are_shown_on_their_blocks() -> None:
    value = load(ROOT / "diagrams" / "paper" / "adrc.json")
    faults = [
        Fault("E101", "motor_left.v", "input is not wired."),
        Fault("E101", "control_left.nlsef.r1", "input is not wired."),
        Fault("W105", "robot", "scaled."),
        Fault("E105", "x", "unknown.", path=("wires", "heading_error.u1")),
        Fault("E115", "run.step", "is not allowed."),
    ]
    for depth, place in ((1, "control_left"), (2, "control_left.nlsef")):
        made = pictured(value, depth, faults=faults)
        check(made)
        marked = {box.path: [fault.code for fault in box.faults] for box in made.boxes if box.faults}
        assert marked == {"motor_left": ["E101"], place: ["E101"], "robot": ["W105"], "heading_error": ["E105"]}
        assert made.elsewhere == (faults[4],)
    text = drawn(value, faults=faults)
    root = ElementTree.fromstring(text)
    groups = {group.attrib.get("data-path"): group for group in root.iter(SVG + "g")}
    assert "faulty" in groups["motor_left"].attrib["class"].split()
    assert "warned" in groups["robot"].attrib["class"].split()
    title = groups["motor_left"].find(SVG + "title")
    assert title is not None
    assert str(title.text).startswith("E101 motor_left.v: input is not wired.")
    assert "E115 run.step: is not allowed." in text


def test_an_input_that_is_not_wired_is_an_open_circle() -> None:
    value = small(error=BlockEntry(type="Sum"), motor=BlockEntry(type="PMDCMotor"), step=BlockEntry(type="Step"))
    made = pictured(replace(value, wires={"error.u1": "step.y"}))
    check(made)
    # The torque of the motor has a default.
    assert {(mark.path, mark.port) for mark in made.opens} == {("error", "u2"), ("motor", "v")}
    assert drawn(value).count('class="open"') == 3


def test_a_faulty_diagram_is_drawn_as_far_as_it_is_known() -> None:
    value = DiagramValue(
        "broken",
        blocks={
            "a": BlockEntry(type="NoSuchType"),
            "g": BlockEntry(type="Gain"),
            "s": BlockEntry(diagram="missing.json"),
        },
        wires={
            "a.in": "g.y",
            "g.u": "nowhere.y",
            "ghost.u": "g.y",
            "g.w": "a.out",
            "s.x": "a.out",
            "a.": "g.y",
            "a": "g.",
            "": "",
            "g": "a",
        },
        outputs={"y": "ghost.y", "z": "g.nothing", "b": 3},
    )
    made = pictured(value, 2)
    check(made)
    assert {box.path for box in made.boxes} == {"a", "g", "s", "y", "z", "b"}
    assert ("g", "u") in {(mark.path, mark.port) for mark in made.opens}
    assert {(wire.source, wire.sink) for wire in made.wires} >= {(("g", "y"), ("a", "in")), (("a", "out"), ("g", "w"))}


def test_each_rate_has_a_color_and_a_pattern() -> None:
    value = load(ROOT / "diagrams" / "sampled_loop.json")
    rates = {"sampler": "0.1 s", "gain": "0.1 s", "delay.y": "0.2 s", "plant": "continuous"}
    text = drawn(value, rates=rates)
    made = pictured(value, rates=rates)
    assert {wire.rate for wire in made.wires} == {"", "0.1 s", "0.2 s", "continuous"}
    for label in ("0.1 s", "0.2 s", "continuous"):
        assert f">{label}</text>" in text
    assert "stroke-dasharray:7 3" in text
    assert "stroke-dasharray:2.5 2.5" in text
    assert "stroke-dasharray" not in drawn(value).replace("stroke-dasharray:none", "")


HOSTILE = [
    "<script>alert(1)</script>",
    "a\x00b\x1b[31m\n\r\t\x7f",
    "\"]]> &amp; ' --> <!--",
    "\u202eevil\u2066",
    "\ud800",
    "x" * 10_000,
    "語" * 300,
    "{}:;}</style>",
]


@pytest.mark.parametrize("name", HOSTILE, ids=range(len(HOSTILE)))
def test_hostile_names_stay_text(name: str) -> None:
    inner = DiagramValue(name, inputs={name: {}}, outputs={name: name}, blocks={"x": BlockEntry(type=name)})
    value = DiagramValue(
        name,
        inputs={name: {}},
        outputs={name: f"g.{name}"},
        blocks={
            "g": BlockEntry(type=name, doc=name, parameters={name: name}),
            name + "2": BlockEntry(fmu=name),
            "s": BlockEntry(diagram=inner),
            "k": BlockEntry(type="Gain", parameters={"k": name}),
        },
        wires={f"g.{name}": name, f"s.{name}": "g.y"},
    )
    faults = [Fault("E103", "g", name, name), Fault("E999", name, name)]
    for depth in (1, 2):
        text = drawn(value, depth=depth, faults=faults, rates={"g": name}, title=name)
        root = ElementTree.fromstring(text.encode())  # also: it can be encoded
        assert not list(root.iter(SVG + "script"))
        assert all(c.isprintable() or c == "\n" for c in text)
        assert max(len(element.text or "") for element in root.iter(SVG + "text")) <= 400
        check(picture(value, ports_of(value, resolver()), depth=depth, faults=faults))


def test_texts_are_cut_and_measured() -> None:
    assert cut("abcdef", 4) == "abc…"
    assert plain("a\x00b") == "a�b"
    assert width_of("iii", 10) < width_of("mmm", 10) < width_of("語語語", 10)


def test_subdiagrams_in_each_other_open_level_by_level() -> None:
    value = DiagramValue("level0", inputs={"u": {}}, outputs={"y": "u"})
    for level in range(1, 5):
        value = DiagramValue(
            f"level{level}",
            inputs={"u": {}},
            outputs={"y": "sub.y"},
            blocks={"sub": BlockEntry(diagram=value), "gain": BlockEntry(type="Gain")},
            wires={"gain.u": "u", "sub.u": "gain.y"},
        )
    for depth in range(1, 6):
        made = pictured(value, depth)
        check(made)
        # The innermost one has no blocks, and stays a box.
        assert sum(box.kind == "frame" for box in made.boxes) == min(depth - 1, 3)


# --- random diagrams -------------------------------------------------------------------------------------------

KINDS = {
    "Gain": Ports(("u",), ("y",)),
    "Sum": Ports(("u1", "u2"), ("y",)),
    "Step": Ports((), ("y",)),
    "Plant": Ports(("u", "disturbance"), ("y", "x1", "x2")),
    "Sink": Ports(("a", "b", "c", "d"), ()),
    "Wide": Ports(tuple(f"u{k}" for k in range(7)), tuple(f"y{k}" for k in range(5))),
}


@st.composite
def diagrams(draw: st.DrawFn, most: int = 12) -> DiagramValue:
    kinds = draw(st.lists(st.sampled_from(sorted(KINDS)), min_size=1, max_size=most))
    long = draw(st.booleans())
    blocks = {f"b{k}{'_with_a_long_name' if long else ''}": BlockEntry(type=kind) for k, kind in enumerate(kinds)}
    inputs: dict[str, Any] = {f"in{k}": {} for k in range(draw(st.integers(0, 3)))}
    sources = [*inputs, *(f"{name}.{port}" for name, entry in blocks.items() for port in KINDS[entry.type].outputs)]
    wires = {}
    outputs = {}
    if sources:
        pick = st.sampled_from(sources)
        for name, entry in blocks.items():
            for port in KINDS[entry.type].inputs:
                if draw(st.integers(0, 5)):
                    wires[f"{name}.{port}"] = draw(pick)
        outputs = {f"out{k}": draw(pick) for k in range(draw(st.integers(0, 4)))}
    return DiagramValue("random", inputs=inputs, outputs=outputs, blocks=blocks, wires=wires)


def kind_ports(value: DiagramValue) -> Callable[[str], Ports]:
    return lambda path: KINDS[value.blocks[path].type]


@pytest.mark.long
@settings(max_examples=100, deadline=None)
@given(diagrams())
def test_nothing_overlaps_in_random_diagrams(value: DiagramValue) -> None:
    made = picture(value, kind_ports(value))
    check(made)
    assert len(made.wires) == len(value.wires) + len(value.outputs)
    assert svg(value, kind_ports(value)) == svg(value, kind_ports(value))


@settings(max_examples=40, deadline=None)
@given(diagrams(most=6), diagrams(most=5))
def test_nothing_overlaps_in_random_subdiagrams(outer: DiagramValue, inner: DiagramValue) -> None:
    sources = list(outer.wires.values()) or [""]
    wires = {f"sub.{name}": sources[k % len(sources)] for k, name in enumerate(inner.inputs)}
    blocks = {**outer.blocks, "sub": BlockEntry(diagram=inner)}
    value = replace(outer, blocks=blocks, wires={**outer.wires, **wires})

    def ports(path: str) -> Ports:
        name = path.removeprefix("sub.")
        return KINDS[(inner if name != path else outer).blocks[name].type]

    check(picture(value, ports, depth=2))


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(diagrams(most=9), st.randoms(use_true_random=False), st.booleans())
def test_given_positions_are_kept_in_random_diagrams(value: DiagramValue, random: Any, all_of_them: bool) -> None:
    """On a grid wide enough for their wires; which cell is whose is random."""
    cells = [(column, row) for column in range(4) for row in range(3)]
    random.shuffle(cells)
    layout = {
        name: [400.0 * column, 330.0 * row]
        for name, (column, row) in zip(value.blocks, cells, strict=False)
        if all_of_them or random.random() < 0.6
    }
    value = replace(value, layout=layout)
    made = picture(value, kind_ports(value))
    check(made)
    places = {box.path: (box.x, box.y) for box in made.boxes if box.path in layout}
    for a, b in combinations(places, 2):
        assert places[a][0] - places[b][0] == layout[a][0] - layout[b][0]
        assert places[a][1] - places[b][1] == layout[a][1] - layout[b][1]
    if len(layout) == len(value.blocks):
        column, row = cells[len(layout)]
        moved = replace(value, layout={**layout, min(layout): [400.0 * column, 330.0 * row]})
        check(picture(moved, kind_ports(moved), earlier=made))


def test_the_values_of_a_file_are_json_numbers() -> None:
    """Positions as the reader gives them, which remember their spelling, are numbers as well."""
    document = {"format": "blocks-diagram", "version": 3, "blocks": {"a": {"type": "Step"}, "b": {"type": "Step"}}}
    value = loads(json.dumps({**document, "layout": {"a": [40, 80.5], "b": [300, 80.5]}}))
    a, b = pictured(value).boxes
    assert (b.x - a.x, b.y - a.y) == (260, 0)
