"""Copies in files: what they mean, what is refused, and where their names are taken."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, FirstOrder, ModelError, Sine, UsageError, edit_file, subdiagram
from blocks.model.copies import Fleet, Layout, alike
from blocks.model.diagram_value import DiagramValue
from blocks.model.fingerprint import fingerprint

HEAD = {"format": "blocks-diagram", "version": 3}
AGENT: dict[str, Any] = {
    "parameters": {"a": {"value": 1, "unit": "s"}, "gains": [1, 2]},
    "inputs": {"u": {"default": 0}, "pair": {"size": 2, "default": 0}},
    "outputs": {"y": "lag.y", "both": "mix.y"},
    "blocks": {
        "lag": {"type": "FirstOrder", "parameters": {"T": "=a"}},
        "mix": {"type": "MatrixGain", "parameters": {"K": [[1, 1], [1, -1]]}},
        "law": {"type": "MatrixGain", "parameters": {"K": [["=a", "=2*a"]]}},
    },
    "wires": {"lag.u": "u", "mix.u": "pair", "law.u": "pair"},
}


def diagram(entry: dict[str, Any] | None = None, wires: dict[str, str] | None = None, **more: Any) -> Diagram:
    robots = {"copies": 3, "diagram": AGENT, **(entry or {})}
    blocks = {"wave": {"type": "Sine"}, "robots": robots, **more.pop("blocks", {})}
    return Diagram.from_json({**HEAD, "blocks": blocks, "wires": wires or {}, **more})


def faults(made: Any, *arguments: Any, **named: Any) -> list[tuple[str, str]]:
    with pytest.raises(ModelError) as caught:
        made(*arguments, **named)
    return [(fault.code, fault.place) for fault in caught.value.faults]


def values(made: Diagram, key: str, parameters: dict[str, Any] | None = None) -> list[float]:
    path, _, name = key.rpartition(".")
    flat = made.flatten(parameters=parameters)
    return [float(b.resolved.values[name].value) for b in flat.blocks if b.path.split("].")[-1] == path]


# --- numbers ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("raw", "wanted"),
    [
        (2, [2, 2, 2]),
        ([1, 2, 4], [1, 2, 4]),
        ({"value": [1000, 2000, 4000], "unit": "ms"}, [1, 2, 4]),
        ("=1+index", [1, 2, 3]),
        ("=(index+1)/copies", [1 / 3, 2 / 3, 1]),
        ([1, "=2*n", "=index"], [1, 14, 2]),
        ({"value": "=1+index", "unit": "ms"}, [1, 2, 3]),  # an expression is in SI
    ],
)
def test_a_parameter_is_one_value_for_all_or_one_for_each(raw: Any, wanted: list[float]) -> None:
    made = diagram({"parameters": {"a": raw}}, parameters={"n": 7})
    assert values(made, "lag.T") == wanted


def test_a_vector_is_one_for_all_and_a_list_of_vectors_one_for_each() -> None:
    blocks = {"k": {"copies": 2, "type": "LSEF", "parameters": {"gains": [[1, 2], [3, 4]]}},
              "same": {"copies": 2, "type": "LSEF", "parameters": {"gains": [1, 2]}}}  # fmt: skip
    made = Diagram.from_json({**HEAD, "blocks": blocks, "inputs": {"u": {"default": 0}}, "wires": {
        f"{name}.{port}": "u" for name in blocks for port in ("r1", "r2", "z1", "z2", "z3")}})  # fmt: skip
    gains = {block.path: block.resolved.values["gains"].value.tolist() for block in made.flatten().blocks}
    assert gains == {"k[0]": [1, 2], "k[1]": [3, 4], "same[0]": [1, 2], "same[1]": [1, 2]}


def test_the_number_of_copies_may_be_computed() -> None:
    made = diagram({"copies": "=2*n"}, parameters={"n": 2})
    assert len(values(made, "lag.T")) == 4
    assert len(values(made, "lag.T", {"n": 3})) == 6


def test_a_parameter_is_set_in_one_copy_or_in_all() -> None:
    made = diagram({"parameters": {"a": [1, 2, 4]}})
    assert values(made, "lag.T", {"robots[1].a": 5}) == [1, 5, 4]
    assert values(made, "lag.T", {"robots.a": 5}) == [5, 5, 5]
    assert values(made, "lag.T", {"robots.a": [7, 8, 9], "robots[0].a": 3}) == [3, 8, 9]
    assert values(diagram(), "lag.T", {"robots[0].a": 3}) == [3, 1, 1]
    plain = diagram(blocks={"lags": {"copies": 2, "type": "FirstOrder"}}, wires={"lags.u": "wave.y"})
    for path, wanted in (("lags[1].T", [1, 3]), ("lags.T", [3, 3])):
        blocks = plain.flatten(parameters={path: 3}).blocks[-2:]
        assert [block.resolved.values["T"].value for block in blocks] == wanted


def test_what_is_wrong_with_numbers_of_copies_is_told() -> None:
    assert faults(diagram({"parameters": {"a": [1, 2]}}).flatten) == [("E110", "robots.a")]
    assert faults(diagram({"parameters": {"a": "=i"}}).flatten) == [("E108", "robots.a")]
    assert faults(diagram({"parameters": {"a": [1, -1, 1]}}).flatten) == [("E107", "robots[1].lag.T")]
    assert faults(diagram({"parameters": {"a": "=1-2*index"}}).flatten) == [("E107", "robots[1].lag.T")]
    assert faults(diagram({"copies": "=n/2"}, parameters={"n": 3}).flatten) == [("E107", "robots.copies")]
    assert faults(diagram({"copies": "=m"}).flatten) == [("E108", "robots.copies")]
    assert faults(diagram(parameters={"index": 1}).flatten) == [("E109", "index")]
    assert faults(diagram().flatten, parameters={"robots[3].a": 1}) == [("E106", "robots[3].a")]
    assert faults(diagram({"parameters": {"a": "=1+index"}}).flatten, parameters={"robots[1].a": 1}) == [
        ("E117", "robots[1].a")
    ]
    for log, more in (("robots[2].lag.y", []), ("robots[3].lag.y", [("E105", "run.log")])):
        wrong = diagram({"parameters": {"a": [1, 2]}}, run={"log": [log]})
        assert faults(wrong.flatten) == [("E110", "robots.a"), *more]
    wrong = diagram({"parameters": {"a": "=1+index"}})  # what is set in one copy is there, though none was looked into
    both = {"robots.a": 1, "robots[1].mix.K": [[1, 1], [1, 2]]}
    assert faults(wrong.flatten, parameters=both) == [("E117", "robots.a")]
    zeros = Diagram.from_json({**HEAD, "blocks": {"m": {"copies": 2, "type": "MatrixGain", "parameters": {
        "K": [[[1]], [[0]]]}}}, "inputs": {"u": {"size": 1, "default": 0}}, "wires": {"m.u": "u"}})  # fmt: skip
    assert faults(zeros.flatten) == [("E123", "m")]


@pytest.mark.parametrize("copies", [0, 1.5, -1, 1e9, True, [2]])
def test_copies_are_a_whole_number(copies: Any) -> None:
    assert [code for code, _ in faults(diagram, {"copies": copies})] == ["E004"]


# --- wires -----------------------------------------------------------------------------------------------------


def test_ports_have_one_more_dimension() -> None:
    made = diagram(
        wires={"robots.u": "wave.y", "first.u": "robots.y[2]", "all.u": "robots.y", "other.pair": "robots.both",
               "one.u": "robots.both[1]", "third.pair[1]": "two.y"},
        blocks={
            "first": {"type": "Gain"}, "all": {"type": "MatrixGain", "parameters": {"K": [[1, 1, 1]]}},
            "other": {"copies": 3, "diagram": AGENT}, "one": {"type": "MatrixGain", "parameters": {"K": [[1, 0]]}},
            "third": {"copies": 3, "diagram": AGENT}, "two": {"type": "Constant", "parameters": {"value": 1}},
        },
    )  # fmt: skip
    assert faults(made.flatten) == [("E110", "third.pair[1]")]
    document = made.to_json()
    del document["wires"]["third.pair[1]"]
    flat = Diagram.from_json(document).flatten()
    assert flat.signals["robots.y"].shape == (3,)
    assert flat.signals["robots.both"].shape == (3, 2)
    assert flat.signals["robots[1].both"].sources == flat.signals["robots.both"].sources[2:4]
    assert flat.signals["robots[1].lag.y"].sources == flat.signals["robots.y"].sources[1:2]


def test_what_does_not_fit_is_refused() -> None:
    assert faults(diagram(wires={"robots.u[3]": "wave.y"}).flatten) == [("E105", "robots.u[3]")]
    assert faults(diagram(outputs={"y": "robots.y[3]"}).flatten) == [("E105", "y")]
    four = {"four": {"copies": 4, "diagram": AGENT}}
    assert faults(diagram(wires={"robots.u": "four.y"}, blocks=four).flatten) == [("E110", "robots.u")]
    needed = {**AGENT, "inputs": {"u": {}, "pair": {"size": 2, "default": 0}}}
    partly = diagram({"diagram": needed}, wires={"robots.u[0]": "wave.y", "robots.u[2]": "wave.y"})
    assert faults(partly.flatten) == [("E101", "robots.u[1]")]


# --- names -----------------------------------------------------------------------------------------------------


def test_the_log_takes_copies_by_number_and_by_pattern() -> None:
    nested = {"copies": 2, "diagram": {"blocks": {"inner": {"copies": 2, "diagram": AGENT}}, "outputs": {}}}
    made = diagram(blocks={"nest": nested})

    def log(*names: str) -> tuple[str, ...]:
        return made.flatten(log=list(names)).log

    assert log("robots.y", "robots.y[1]", "robots[2].lag.y") == ("robots.y", "robots.y[1]", "robots[2].lag.y")
    assert log("robots[*].lag.y") == ("robots[0].lag.y", "robots[1].lag.y", "robots[2].lag.y")
    assert log("robots") == ("robots.y", "robots.both")
    assert log("robots[1]") == tuple(f"robots[1].{name}" for name in ("lag.y", "mix.y", "law.y", "y", "both"))
    assert log("nest[1].inner[0].lag.y") == ("nest[1].inner[0].lag.y",)
    assert log("nest[*].inner[1].y") == ("nest[0].inner[1].y", "nest[1].inner[1].y")
    assert made.flatten().log == ("wave.y", "robots.y", "robots.both")
    for wrong in ("robots[3].lag.y", "robots[0].lug.y", "nest[2].inner[0].lag.y", "robots.lag.y"):
        assert faults(made.flatten, log=[wrong]) == [("E105", "run.log")]


def test_measures_take_signals_of_copies() -> None:
    measures = {"ISE": {"type": "ISE", "of": "robots[1].lag.y"}, "same": {"type": "ISE", "of": "robots.y[1]"}}
    results = diagram(wires={"robots.u": "wave.y"}, measures=measures, run={"stop": 1}).run()
    assert results.measures["ISE"] == results.measures["same"] > 0


def test_what_a_run_meets_in_a_copy_names_it() -> None:
    agent = {"blocks": {"root": {"type": "Product", "parameters": {"operations": "*/"}}},
             "inputs": {"u": {}}, "outputs": {"y": "root.y"}, "wires": {"root.u1": "u", "root.u2": "u"}}  # fmt: skip
    made = Diagram.from_json({**HEAD, "blocks": {"c": {"copies": 2, "diagram": agent}}, "inputs": {
        "u": {"size": 2, "default": [1, 0]}}, "wires": {"c.u": "u"}, "run": {"stop": 1}})  # fmt: skip
    for engine in ("reference", "native"):
        with pytest.raises(Exception, match=r"c\[1\]\.root") as caught:
            made.run(engine=engine)
        assert "E303" in str(caught.value)


def test_noise_of_copies_is_that_of_their_paths() -> None:
    noisy = {"blocks": {"noise": {"type": "Noise"}}, "outputs": {"y": "noise.y"}}
    blocks = {"robots": {"copies": 3, "diagram": noisy}, "by_hand": {"diagram": noisy, "stream": "robots[2]"},
              "plain": {"copies": 2, "type": "Noise", "stream": "wind"}}  # fmt: skip
    blocks["wind"] = {"type": "Noise", "stream": "wind[1]"}
    results = Diagram.from_json({**HEAD, "blocks": blocks}).run(stop=1)
    noise = results["robots.y"]
    assert len({tuple(row) for row in noise.T}) == 3
    np.testing.assert_array_equal(results["by_hand.noise.y"], noise[:, 2])
    np.testing.assert_array_equal(results["wind.y"], results["plain.y"][:, 1])


# --- files -----------------------------------------------------------------------------------------------------


def _error(document: dict[str, Any]) -> ModelError:
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(document)
    return caught.value


def test_copies_are_a_part_of_what_is_computed() -> None:
    def of(made: Diagram) -> str:
        value: DiagramValue = made.value
        return fingerprint(value)

    assert of(diagram({"copies": 3})) != of(diagram({"copies": 4}))


def test_edits_know_copies(tmp_path: Path) -> None:
    path = tmp_path / "fleet.json"
    run = {"stop": 1, "log": ["robots[1].lag.y", "robots.y[0]"]}
    document = diagram(wires={"robots.u": "wave.y"}, run=run).to_json()
    path.write_text(json.dumps(document))
    renamed = edit_file(path, [{"rename": "blocks.robots", "to": "cars"}]).texts[str(path)]
    assert json.loads(renamed)["run"]["log"] == ["cars[1].lag.y", "cars.y[0]"]
    assert json.loads(renamed)["wires"] == {"cars.u": "wave.y"}
    more = edit_file(path, [{"set": "blocks.robots.copies", "to": 5}]).texts[str(path)]
    assert json.loads(more)["blocks"]["robots"]["copies"] == 5
    inner = edit_file(path, [{"rename": "blocks.lag", "to": "slow", "in": "robots"}]).texts[str(path)]
    assert json.loads(inner)["run"]["log"] == ["robots[1].slow.y", "robots.y[0]"]
    with pytest.raises(UsageError, match=r'has "copies", which would be lost'):
        edit_file(path, [{"ungroup": "robots"}])


def test_variants_stand_in_place_of_all_copies() -> None:
    made = diagram({"variants": {"fast": {"type": "FirstOrder", "ports": {"y": "y"}}}, "variant": "fast"},
                   wires={"robots.u": "wave.y"})  # fmt: skip
    assert made.flatten().signals["robots.y"].shape == (3,)
    assert [block.path for block in made.flatten().blocks] == ["wave", "robots[0]", "robots[1]", "robots[2]"]


def test_a_drawing_shows_how_many() -> None:
    assert "\u00d7 3</text>" in diagram().draw()
    assert "\u00d7 n</text>" in diagram({"copies": "=n"}, parameters={"n": 2}).draw()


def test_a_difference_in_the_number_is_told() -> None:
    told = str(diagram({"copies": 3}).diff(diagram({"copies": 4})))
    assert "robots" in told
    assert "copies" in told


def test_a_check_tells_copies_as_one() -> None:
    platoon = Diagram.load(Path(__file__).resolve().parents[2] / "diagrams" / "fleet" / "platoon.json")
    told = str(platoon.check())
    inner = " > ".join(f"vehicles[*].{name} (50 copies)" for name in ("drive", "speed", "way"))
    law = "gaps > closing > vehicles[*].law (50 copies)"  # sparse gains are blocks too, of which parts are computed
    assert f"order: leader > {law} > first_gap > first_closing > way > {inner}\n" in told
    hold = {"copies": 2, "type": "ZeroOrderHold", "parameters": {"period": 0.1}}
    held = {"copies": 2, "diagram": {"blocks": {"hold": hold}, "inputs": {"u": {}}, "wires": {"hold.u": "u"}}}
    made = Diagram.from_json({**HEAD, "blocks": {"wave": {"type": "Sine"}, "r": held}, "wires": {"r.u": "wave.y"}})
    assert "s: r[*].hold[*] (4 copies)\n" in str(made.check())
    assert alike(["a", "b[0].y", "b[2].y", "c[1].y"]) == ["a", "b[*].y (2 copies)", "c[1].y"]


def test_a_model_tells_of_copies_as_one() -> None:
    inner = {"blocks": {"q": {"type": "Quantizer"}, "lag": {"type": "FirstOrder"}}, "inputs": {"u": {}},
             "outputs": {"y": "lag.y"}, "wires": {"q.u": "u", "lag.u": "q.y"}}  # fmt: skip
    made = Diagram.from_json({**HEAD, "inputs": {"u": {}}, "blocks": {
        "c": {"copies": 5, "diagram": inner}, "mean": {"type": "Reduction", "parameters": {"size": 5}}},
        "outputs": {"y": "mean.y"}, "wires": {"c.u": "u", "mean.u": "c.y"}})  # fmt: skip
    with pytest.warns(RuntimeWarning, match="W702"):
        model = made.linearize("u", "y")
    assert model.hint.startswith("c[0].q.y passes nothing on at its operating point: ")
    assert model.hint.endswith(" The same holds for 4 more copies.")
    assert model.hint.count("passes nothing on") == 1


# --- the order in which they stand -----------------------------------------------------------------------------


def test_blocks_stand_copy_by_copy() -> None:
    inner = {"blocks": {"x": {"type": "Sine"}, "w": {"copies": 2, "type": "Sine"}, "z": {"type": "Sine"}}}
    blocks = {"a": {"type": "Sine"}, "r": {"copies": 2, "diagram": inner}, "b": {"type": "Sine"}}
    flat = Diagram.from_json({**HEAD, "blocks": blocks}).flatten()
    of_one = ("x", "w[0]", "w[1]", "z")
    assert [block.path for block in flat.blocks] == ["a", *(f"r[{i}].{name}" for i in (0, 1) for name in of_one), "b"]
    outer = Fleet("r", 2)
    layout = Layout([None, outer, Fleet("r.w", 3, outer), outer, None], 5)
    assert layout.size == 12
    assert [layout.place(2, lane) for lane in range(6)] == [2, 3, 4, 7, 8, 9]
    assert len({*layout.each()}) == 12


def test_python_adds_copies() -> None:
    agent = Diagram("agent")
    agent.output("y", agent.add("lag", FirstOrder()).y)
    agent.wire("lag.u", agent.input("u"))
    fleet = Diagram("fleet")
    robots = fleet.add("robots", subdiagram(agent), copies=100)
    fleet.wire(robots.u, fleet.add("wave", Sine()).y)
    fleet.output("last", robots.y[99])
    assert fleet.flatten().signals["robots.y"].shape == (100,)
    assert str(robots.y[3]) == "robots.y[3]"


@pytest.mark.parametrize(
    ("wires", "said"),
    [
        (
            {"gains.u": "pair.y"},
            "gains.u: has 3 elements, one for each of the 3 copies of gains, but pair.y has 2 elements. "
            "Wire one value for each copy, or one value for all copies.",
        ),
        (
            {"alone.u": "gains.y"},
            "alone.u: is a single value, but gains.y has 3 elements, one for each of the 3 copies of gains. "
            'Wire one copy, as in "gains.y[0]", or give the block "copies": 3.',
        ),
        (
            {"alone.u": "gains[1].y"},
            'alone.u: the source "gains[1].y" is not there. For copy 1, write the element of the port: "gains.y[1]".',
        ),
    ],
)
def test_a_wire_that_does_not_fit_copies_names_them(wires: dict[str, str], said: str) -> None:
    gain = {"type": "Gain"}
    document = {
        "format": "blocks-diagram",
        "version": 3,
        "inputs": {"r": {"default": 1}},
        "blocks": {"gains": {**gain, "copies": 3}, "alone": gain, "pair": {"type": "Mux", "parameters": {"size": 2}}},
        "wires": {"gains.u": "r", "alone.u": "r", "pair.u1": "r", "pair.u2": "r", **wires},
    }
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(document).flatten()
    assert [str(fault).partition(" ")[2] for fault in caught.value.faults] == [said]
