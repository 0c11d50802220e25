"""Pictures after edits: what they take over from those before is what they would make; blocks that lie upon others."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from benchmarks.drawing import placed
from blocks import Diagram
from blocks.draw import picture, ports_of, rendered
from blocks.draw.maze import Maze
from blocks.draw.picture import Kept
from blocks.model.diagram_value import DiagramValue
from blocks.model.document import dumps
from blocks.text.errors import Fault


def edits(value: DiagramValue) -> list[tuple[str, DiagramValue, dict[str, Any]]]:
    """The diagram again and again, with what is shown of it."""
    blocks, layout, wires = dict(value.blocks), dict(value.layout), dict(value.wires)
    x, y = layout["law1"]
    left = min(one[0] for one in layout.values())
    sink = next(sink for sink in wires if sink.startswith("law1."))
    law = blocks["law1"]
    other = replace(law, parameters={**law.parameters, "k": 7.5})
    return [
        ("moved", replace(value, layout={**layout, "law1": [x + 20, y + 60]}), {}),
        ("back", value, {}),
        ("beyond the edge", replace(value, layout={**layout, "law1": [left - 200, y]}), {}),
        ("set", replace(value, blocks={**blocks, "law1": other}), {}),
        ("unwired", replace(value, wires={key: one for key, one in wires.items() if key != sink}), {}),
        ("faulty", value, {"faults": [Fault("E101", sink, "input is not wired.")]}),
        ("sampled", value, {"rates": {"law1": "1 ms", "law2": "2 ms"}}),
        ("renamed", replace(value, doc="another"), {}),
    ]


def test_what_is_taken_over_is_what_would_be_made() -> None:
    diagram = Diagram.from_json(dumps(placed(4)))
    resolver = diagram._draft.resolver

    def drawn(value: DiagramValue, shown: dict[str, Any], earlier: Any) -> Any:
        return picture(value, ports_of(value, resolver), earlier=earlier, **shown)

    before = drawn(diagram.value, {}, None)
    rendered(before, "kept")
    for what, value, shown in edits(diagram.value):
        alone = drawn(value, shown, replace(before, kept=Kept()))
        before = drawn(value, shown, before)
        assert before == alone, what
        assert rendered(before, "kept") == rendered(alone, "kept"), what


def test_a_block_upon_another_one_has_its_wires_without_a_search_through_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where an end lies inside of a block, there is no path around it to look for, again and again."""
    value = Diagram.from_json(dumps(placed(4))).value
    ports = ports_of(value, Diagram.from_json(dumps(placed(4)))._draft.resolver)
    x, y = value.layout["error0"]
    routed: list[int] = []
    net = Maze._net
    monkeypatch.setattr(Maze, "_net", lambda self, index: routed.append(index) or net(self, index))
    before = picture(value, ports)
    once = len(routed)
    on_it = replace(value, layout={**value.layout, "reference0": [x + 10, y + 10]})
    made = picture(on_it, ports)
    assert len(routed) == 2 * once
    assert {wire.sink for wire in made.wires} == {wire.sink for wire in before.wires}
    boxes = {box.path: box for box in made.boxes}
    for wire in made.wires:
        (source, out), (sink, entry) = wire.source, wire.sink
        assert (wire.points[0], wire.points[-1]) == (boxes[source].outputs[out], boxes[sink].inputs[entry])
    del routed[:]
    picture(on_it, ports, earlier=before)
    assert len(routed) < 10


def test_what_stays_is_not_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    diagram = Diagram.from_json(dumps(placed(4)))
    value, ports = diagram.value, ports_of(diagram.value, diagram._draft.resolver)
    before = picture(value, ports)
    rendered(before, "kept")
    made: list[Any] = []
    take = Kept.take
    monkeypatch.setattr(
        Kept, "take", lambda self, name, of, make: take(self, name, of, lambda: made.append(name) or make())
    )
    x, y = value.layout["law1"]
    after = picture(replace(value, layout={**value.layout, "law1": [x, y + 10]}), ports, earlier=before)
    rendered(after, "kept")
    assert {name[2] for name in made if name[0] in ("node", "box")} == {"law1"}
    assert len(made) < 20
