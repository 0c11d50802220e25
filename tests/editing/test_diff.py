"""What differs between two diagrams: told line by line, drawn, and nothing where two files mean the same."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blocks import Diagram, FirstOrder, Gain, ModelError, cli
from blocks.editing.diff import Change, Differences, differences
from blocks.editing.diff.meaning import same
from blocks.model.block_types import library_types
from blocks.model.diagram_value import DiagramValue
from blocks.model.document import dumps, from_document, load, loads
from blocks.model.resolver import resolver_of
from blocks.text import json_text
from tests.support.places import ROOT

SVG = "{http://www.w3.org/2000/svg}"


@cache
def resolver() -> Any:
    return resolver_of(library_types())


def document(**sections: Any) -> dict[str, Any]:
    return {"format": "blocks-diagram", "version": 3, "name": "d", **sections}


def loop(**changes: Any) -> dict[str, Any]:
    """A loop with something in each section; changes replace sections."""
    made = document(
        parameters={"kp": {"value": 20, "unit": "V.s/rad", "doc": "proportional gain"}, "n": 2},
        inputs={"r": {"unit": "rad/s", "default": 1}, "d": {}},
        outputs={"omega": "motor.omega"},
        blocks={
            "error": {"type": "Sum", "parameters": {"signs": "+-", "unit": "rad/s"}},
            "control": {"type": "Gain", "parameters": {"k": "=kp", "unit": "V", "unit_u": "rad/s"}},
            "motor": {"type": "PMDCMotor", "parameters": {"Ra": {"value": 1200, "unit": "mOhm"}}},
        },
        wires={"error.u1": "r", "error.u2": "motor.omega", "control.u": "error.y", "motor.v": "control.y"},
        run={"stop": 5, "every": 0.01, "log": ["omega", "control.y"], "stops": [1, 2], "inputs": {"r": 2}},
        measures={"ISE": {"type": "ISE", "of": "error.y", "from": 1}},
    )
    return made | changes


def diff(a: Mapping[str, Any], b: Mapping[str, Any], **options: Any) -> Differences:
    values = (from_document(one) for one in (a, b))
    return differences(*values, resolver=resolver(), **options)


def told(a: Mapping[str, Any], b: Mapping[str, Any], **options: Any) -> list[str]:
    """The lines of the changes, each with its section."""
    return [f"{one.group} {one}" for one in diff(a, b, **options)]


def mirrored(change: Change) -> Change:
    """Return the same change, from B to A."""
    kinds: dict[str, Any] = {"added": "removed", "removed": "added"}
    return replace(
        change, kind=kinds.get(change.kind, change.kind), before_path=change.path, path=change.before_path,
        old=change.new, new=change.old, before=change.after, after=change.before,
    )  # fmt: skip


def edited(path: str, value: Any = None, source: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The loop with something put in or, without a value, taken out: "blocks motor type"."""
    made: dict[str, Any] = json.loads(json.dumps(source or loop()))
    *steps, last = path.split()
    target = made
    for step in steps:
        target = target.setdefault(step, {})
    if value is None:
        del target[last]
    else:
        target[last] = value
    return made


# --- what two values mean ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ("0.10", "0.1"),
        ("1e-1", "0.1"),
        ("100", "1e2"),
        ('{"value": 1200, "unit": "mOhm"}', '{"value": 1.2, "unit": "Ohm"}'),
        ('{"value": 1200, "unit": "mOhm", "doc": "a"}', '{"doc": "b", "unit": "V/A", "value": 1.2}'),
        ('{"value": 180, "unit": "deg"}', '{"value": 3.141592653589793, "unit": "rad"}'),
        ('{"value": 2}', "2"),
        ('"=a + b"', '"=(a+b)"'),
        ('"=2*a"', '"=2.0 * a"'),
        ('"=1/4"', "0.25"),
        ("[1, 0.20]", "[1.0, 2e-1]"),
        ('{"value": [1, 2], "unit": "ms"}', '[{"value": 0.001, "unit": "s"}, {"value": 2, "unit": "ms"}]'),
        ('{"t": [0, 1], "u": [0.0, 5]}', '{"u": [0, 5.0], "t": [0, 1.0]}'),
    ],
)
def test_values_are_the_same_however_they_are_spelled(a: str, b: str) -> None:
    assert same(json_text.read(a).value, json_text.read(b).value)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ("1", "1.0000000000000002"),
        ("1", "true"),
        ("0", "false"),
        ("1", '"1"'),
        ('"a"', '"=a"'),
        ('"=a+b"', '"=b+a"'),
        ('"=a-(b-c)"', '"=a-b-c"'),
        ('{"value": 2, "unit": "V"}', "2"),
        ('{"value": 2, "unit": "V"}', '{"value": 2, "unit": "A"}'),
        ('{"value": 1, "unit": "Hz"}', '{"value": 1, "unit": "rad/s"}'),
        ("[1, 2]", "[2, 1]"),
        ("[1]", "1"),
        ("[1, 2]", "[1, 2, 3]"),
    ],
)
def test_values_differ_in_what_they_mean(a: str, b: str) -> None:
    assert not same(json_text.read(a).value, json_text.read(b).value)


def test_a_bare_number_is_in_the_unit_that_the_block_declares() -> None:
    bare = edited("blocks motor parameters Ra", 1.2)
    assert told(loop(), bare) == []
    values = (from_document(one) for one in (loop(), bare))
    assert [str(one) for one in differences(*values)] == ["~ motor: Ra 1200 mOhm -> 1.2"], "the class is not known"
    # The unit of a Step follows from another parameter.
    step = document(blocks={"s": {"type": "Step", "parameters": {"after": 2, "unit": "V"}}})
    other = edited("blocks s parameters after", {"value": 2000, "unit": "mV"}, step)
    assert told(step, other) == []
    assert told(step, edited("blocks s parameters after", 3, step)) == ["blocks ~ s: after 2 V -> 3 V"]


def test_diagrams_that_do_not_differ_run_alike() -> None:
    """The second witness of what counts as the same: numbers of a run, bit by bit."""
    plain = loop()
    other = json.loads(json.dumps(plain), parse_int=float)
    other = {key: other[key] for key in reversed(other)}
    other["version"], other["layout"] = 3, {}
    other["blocks"] = {name: other["blocks"][name] for name in ("motor", "error", "control")}
    other["blocks"]["motor"]["parameters"]["Ra"] = 1.2
    other["wires"] = dict(reversed(other["wires"].items()))
    other["run"]["stop"] = {"value": 5000, "unit": "ms"}
    assert not diff(plain, other)
    results = [Diagram.from_json(one).run(every=0.1, inputs={"d": 0}) for one in (plain, other)]
    for name in ("omega", "control.y"):
        assert results[0][name].tolist() == results[1][name].tolist()


# --- one edit, one line ------------------------------------------------------------------------------------------

EDITS: list[tuple[str, Any, list[str]]] = [
    ("name", "e", ['diagram ~ name "d" -> "e"']),
    ("parameters kp value", 25, ["parameters ~ kp: 20 V.s/rad -> 25 V.s/rad"]),
    ("parameters n", {"value": 2, "unit": "V"}, ["parameters ~ n: 2 -> 2 V"]),
    ("parameters n", None, ["parameters - n: 2"]),
    ("parameters m", "=2*n", ["parameters + m: =2*n"]),
    ("inputs r unit", "rpm", ["inputs ~ r: default 1 rad/s -> 1 rpm", 'inputs ~ r: unit "rad/s" -> "rpm"',
                              "run ~ inputs.r: 2 rad/s -> 2 rpm"]),
    ("inputs r default", None, ["inputs ~ r: default 1 rad/s -> not given"]),
    ("inputs d", None, ["inputs - d"]),
    ("inputs e", {"type": "bool", "doc": "on"}, ['inputs + e: type "bool"']),
    ("outputs omega", "motor.i", ["outputs ~ omega: motor.omega -> motor.i"]),
    ("outputs omega", None, ["outputs - omega: motor.omega"]),
    ("outputs u", "control.y", ["outputs + u: control.y"]),
    ("blocks motor parameters Ra", 0.2, ["blocks ~ motor: Ra 1200 mOhm -> 0.2 Ohm"]),
    ("blocks motor parameters Ra", None, ["blocks ~ motor: Ra 1200 mOhm -> not given (default 0.1557 Ohm)"]),
    ("blocks motor parameters n", 3, ["blocks ~ motor: n not given (default 3.0) -> 3"]),
    ("blocks error parameters signs", "++", ['blocks ~ error: signs "+-" -> "++"']),
    ("blocks motor type", "FirstOrder", ["blocks ~ motor: type PMDCMotor -> FirstOrder"]),
    ("blocks motor variants", {"slow": {"type": "FirstOrder", "parameters": {"T": 2}}},
     ["blocks ~ motor: variants.slow not given -> FirstOrder (T 2 s)"]),
    ("blocks f", {"type": "Gain", "parameters": {"k": 2}}, ["blocks + f: Gain (k 2)"]),
    ("blocks error", None, ['blocks - error: Sum (signs "+-", unit "rad/s")']),
    ("wires error.u1", None, ["wires - error.u1 <- r"]),
    ("wires error.u1", "d", ["wires ~ error.u1: r -> d"]),
    ("wires motor.tau", "d", ["wires + motor.tau <- d"]),
    ("run stop", 6, ["run ~ stop: 5 s -> 6 s"]),
    ("run every", None, ["run - every: 0.01 s"]),
    ("run rtol", 1e-8, ["run + rtol: 1e-08"]),
    ("run log", ["control.y", "motor.i"], ["run + log: motor.i", "run - log: omega"]),
    ("run log", None, ['run - log: ["omega", "control.y"]']),
    ("run stops", [2, 3], ["run + stops: 3 s", "run - stops: 1 s"]),
    ("run inputs r", 3, ["run ~ inputs.r: 2 rad/s -> 3 rad/s"]),
    ("run master", {"step": 0.1, "steps": {"motor": 0.2}},
     ["run + master.step: 0.1 s", "run + master.steps.motor: 0.2 s"]),
    ("measures ISE of", "omega", ['measures ~ ISE: of "error.y" -> "omega"']),
    ("measures ISE to", 2, ["measures ~ ISE: to not given -> 2 s"]),
    ("measures ISE", None, ['measures - ISE: type "ISE", of "error.y", from 1 s']),
    ("measures peak", {"type": "peak", "of": "omega"}, ['measures + peak: type "peak", of "omega"']),
]  # fmt: skip


@pytest.mark.parametrize(("path", "value", "lines"), EDITS, ids=[f"{path}={value}" for path, value, _ in EDITS])
def test_an_edit_is_told_and_nothing_else(path: str, value: Any, lines: list[str]) -> None:
    other = edited(path, value)
    assert told(loop(), other) == lines
    back = sorted(str(mirrored(one)) for one in diff(other, loop()))
    assert back == sorted(line.partition(" ")[2] for line in lines)


NO_EDITS: list[tuple[str, Any]] = [
    ("layout", {"error": [1, 2]}),
    ("doc", "Another text."),
    ("parameters kp doc", "another text"),
    ("blocks motor doc", ["two", "lines"]),
    ("measures ISE doc", "text"),
    ("run doc", "text"),
    ("x-own", {"a": 1}),
    ("blocks motor x-own", 1),
    ("run log", ["control.y", "omega"]),
    ("run stops", [{"value": 2000, "unit": "ms"}, 1.0]),
    ("inputs r unit", "rad.s-1"),
    ("blocks motor variant", "base"),
]


@pytest.mark.parametrize(("path", "value"), NO_EDITS, ids=[f"{path}={value}" for path, value in NO_EDITS])
def test_what_has_no_effect_is_no_difference(path: str, value: Any) -> None:
    assert told(loop(), edited(path, value)) == []


def test_doc_texts_and_own_keys_are_told_on_request() -> None:
    other = edited("x-own", 1, edited("blocks motor doc", "new", edited("parameters kp doc", "P")))
    assert told(loop(), other, doc=True) == [
        "diagram ~ x-own not given -> 1",
        'parameters ~ kp: doc "proportional gain" -> "P"',
        'blocks ~ motor: doc not given -> "new"',
    ]
    assert told(edited("doc", ["a", "b"]), edited("doc", "a\nb"), doc=True) == []


def test_a_long_list_is_told_by_its_first_element_that_differs() -> None:
    table = list(range(40))
    made = document(blocks={"t": {"type": "Table", "parameters": {"t": table, "values": table}}})
    other = edited("blocks t parameters values", [*table[:17], 0, -1, *table[19:]], made)
    assert told(made, other) == ["blocks ~ t: values[17] 17 -> 0 (and 1 more of 40 elements)"]
    assert [str(mirrored(one)) for one in diff(other, made)] == [str(one) for one in diff(made, other)]
    longer = edited("blocks t parameters values", [*table, 40], made)
    (line,) = told(made, longer)
    assert "… 40 elements] -> [" in line
    assert "… 41 elements]" in line


def test_texts_that_differ_behind_what_is_shown_differ_in_the_line_too() -> None:
    (line,) = told(edited("parameters n", "a" * 99 + "b"), edited("parameters n", "a" * 99 + "c"))
    before, after = line.split(" -> ")
    assert "digest" in before
    assert before.removeprefix("parameters ~ n: ") != after


def test_an_enabled_subdiagram_and_the_settings_of_an_fmu_are_compared() -> None:
    inner = {"blocks": {"g": {"type": "Gain"}}}
    a = document(blocks={"s": {"diagram": inner, "trigger": {"every": 0.1}}, "m": {"fmu": "m.fmu", "kind": "ME"}})
    b = edited("blocks s trigger every", {"value": 200, "unit": "ms"}, edited("blocks m timeout", 5, a))
    assert told(a, b) == ["blocks ~ m: timeout not given -> 5", "blocks ~ s: trigger.every 0.1 s -> 200 ms"]
    enabled = edited("blocks s", {"diagram": inner, "enable": {"states": "held"}}, a)
    assert told(a, enabled) == [
        'blocks ~ s: enable not given -> {states: "held"}',
        "blocks ~ s: trigger {every: 0.1} -> not given",
    ]


def test_own_keys_of_an_enabled_subdiagram_have_no_effect() -> None:
    def enabled(**more: Any) -> dict[str, Any]:
        return document(blocks={"s": {"diagram": {"blocks": {}}, "enable": {"states": "held", **more}}})

    assert told(enabled(), enabled(**{"x-own": 1})) == []
    assert told(enabled(), enabled(**{"x-own": 1}), doc=True) == ["blocks ~ s: enable.x-own not given -> 1"]


def test_variants_are_compared_one_by_one() -> None:
    def plant(**changes: Any) -> dict[str, Any]:
        slow = {"type": "FirstOrder", "parameters": {"T": 2}, "ports": {"y": "y"}} | changes
        return document(blocks={"p": {"type": "Gain", "variant": "slow", "variants": {"slow": slow}}})

    assert told(plant(), plant(parameters={"T": 3})) == ["blocks ~ p: variants.slow.T 2 s -> 3 s"]
    assert told(plant(), plant(ports={"y": "x"})) == ['blocks ~ p: variants.slow.ports.y "y" -> "x"']
    assert told(plant(), edited("blocks p variant", "base", plant())) == ['blocks ~ p: variant "slow" -> "base"']


# --- renames -----------------------------------------------------------------------------------------------------


def renamed(source: Mapping[str, Any], **names: str) -> dict[str, Any]:
    """A document with other names for blocks, everywhere."""
    text = json.dumps(source)
    for old, new in names.items():
        text = re.sub(rf'"{old}(["\.])', rf'"{new}\1', text)
    made: dict[str, Any] = json.loads(text)
    return made


def test_a_renamed_block_keeps_its_wires() -> None:
    other = renamed(loop(), error="e")
    assert told(loop(), other) == ["blocks > error -> e: renamed"]
    assert [str(mirrored(one)) for one in diff(other, loop())] == ["> error -> e: renamed"]


def test_blocks_that_are_wired_to_each_other_are_renamed_at_once() -> None:
    other = renamed(loop(), error="e", control="pid", motor="m")
    assert told(loop(), other) == [
        "blocks > error -> e: renamed",
        "blocks > motor -> m: renamed",
        "blocks > control -> pid: renamed",
    ]


def test_a_ring_in_which_no_block_keeps_its_name_is_told_apart_by_its_content() -> None:
    count = 6
    blocks = {f"a{i}": {"type": "Gain", "parameters": {"k": i % 3}} for i in range(count)}
    ring = document(blocks=blocks, wires={f"a{i}.u": f"a{(i + 1) % count}.y" for i in range(count)})
    other = renamed(ring, **{f"a{i}": f"b{(i * 5 + 2) % count}" for i in range(count)})
    made = diff(ring, other)
    assert {one.kind for one in made} == {"renamed"}
    assert len(made) == count


def test_a_chain_of_equal_blocks_is_followed_from_its_end() -> None:
    count = 12
    chain = document(
        inputs={"u": {}},
        blocks={f"a{i}": {"type": "Gain"} for i in range(count)},
        wires={"a0.u": "u"} | {f"a{i}.u": f"a{i - 1}.y" for i in range(1, count)},
    )
    names = {f"a{i}": f"b{count - i}" for i in range(count)}
    made = diff(chain, renamed(chain, **names))
    assert {one.before_path: one.path for one in made} == names


def test_an_input_can_be_renamed_and_run_inputs_and_measures_follow() -> None:
    made = edited("measures ISE against", "r")
    assert told(made, renamed(made, r="wanted")) == ["inputs > r -> wanted: renamed"]


@pytest.mark.parametrize(("version", "difference"), [(3, ["measures ~ e: against =30 -> 30"]), (2, [])])
def test_a_plain_number_of_a_measure_is_not_the_number_in_si(version: int, difference: list[str]) -> None:
    sections = {"blocks": {"n": {"type": "Constant", "parameters": {"unit": "rpm"}}}}
    si, plain = (
        document(**sections, measures={"e": {"type": "peak", "of": "n.y", "against": against}})
        for against in ("=30", 30)
    )
    assert told(si, plain | {"version": version}) == difference


def test_a_renamed_block_may_have_another_neighbor() -> None:
    other = renamed(loop(), control="pid")
    other["blocks"]["filter"] = {"type": "FirstOrder"}
    other["wires"] |= {"filter.u": "motor.omega", "error.u2": "filter.y"}
    other["wires"]["pid.u"] = "r"
    assert told(loop(), other) == [
        "blocks + filter: FirstOrder",
        "blocks > control -> pid: renamed",
        "wires ~ error.u2: motor.omega -> filter.y",
        "wires + filter.u <- motor.omega",
        "wires ~ pid.u: error.y -> r",
    ]


def test_a_block_with_another_value_or_other_wires_is_not_renamed() -> None:
    other = renamed(loop(), motor="m")
    other["blocks"]["m"]["parameters"]["Ra"] = 3
    kinds = [(one.kind, one.path or one.before_path) for one in diff(loop(), other) if one.group == "blocks"]
    assert kinds == [("added", "m"), ("removed", "motor")]
    a = document(blocks={"a": {"type": "Constant"}, "s": {"type": "Sum"}}, wires={"s.u1": "a.y"})
    b = document(blocks={"b": {"type": "Constant"}, "s": {"type": "Sum"}}, wires={"s.u2": "b.y"})
    assert [line.split()[1] for line in told(a, b)] == ["-", "+", "-", "+"]


def test_names_that_are_exchanged_are_two_changes() -> None:
    a = document(blocks={"a": {"type": "Gain"}, "b": {"type": "Gain", "parameters": {"k": 2}}})
    b = document(blocks={"b": {"type": "Gain"}, "a": {"type": "Gain", "parameters": {"k": 2}}})
    assert [one.kind for one in diff(a, b)] == ["changed", "changed"]


def test_many_equal_blocks_are_paired_in_a_second() -> None:
    def many(letter: str) -> DiagramValue:
        blocks = {f"{letter}{i}": {"type": "Gain"} for i in range(1500)}
        wires = {f"{letter}{i}.u": f"{letter}{i - 1}.y" for i in range(1, 1500)}
        return from_document(document(blocks=blocks, wires=wires))

    made = differences(many("a"), many("b"))
    assert {one.kind for one in made} <= {"renamed", "added", "removed", "changed"}


# --- subdiagrams and other files -----------------------------------------------------------------------------------


def nested(**changes: Any) -> dict[str, Any]:
    inner = document(
        inputs={"u": {}}, outputs={"y": "g.y"}, blocks={"g": {"type": "Gain"}}, wires={"g.u": "u"}, run={"stop": 9}
    )
    return inner | changes


def write(folder: Path, **texts: Mapping[str, Any]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, made in texts.items():
        (folder / f"{name}.json").write_text(json.dumps(made), encoding="utf-8")


def inline(made: Mapping[str, Any]) -> dict[str, Any]:
    return {"diagram": {key: item for key, item in made.items() if key not in ("format", "version")}}


def test_inline_subdiagrams_are_compared_with_dotted_paths() -> None:
    deeper = document(blocks={"outer": inline(document(blocks={"inner": inline(nested())}))})
    other = document(blocks={"outer": inline(document(blocks={"inner": inline(nested(wires={}))}))})
    assert told(deeper, other) == ["wires - outer.inner.g.u <- u"]
    other = document(blocks={"outer": inline(document(blocks={"inner": inline(nested(outputs={"y": "u"}))}))})
    assert told(deeper, other) == ["outputs ~ outer.inner.y: g.y -> u"]


def test_a_rename_inside_is_followed_by_what_is_recorded_outside() -> None:
    def outer(inside: Mapping[str, Any], name: str) -> dict[str, Any]:
        log = {"log": ["s.y", f"s.{name}.y"]}
        return document(blocks={"s": inline(inside)}, run=log, measures={"p": {"type": "peak", "of": f"s.{name}.y"}})

    a, b = outer(nested(), "g"), outer(renamed(nested(), g="amplifier"), "amplifier")
    assert told(a, b) == ["blocks > s.g -> s.amplifier: renamed"]


def test_the_run_and_the_measures_of_a_subdiagram_have_no_effect(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").touch()
    write(tmp_path / "a", top=document(blocks={"s": {"diagram": "part.json"}}), part=nested())
    write(tmp_path / "b", top=document(blocks={"s": {"diagram": "part.json"}}), part=nested(run={}))
    assert not differences(load(tmp_path / "a" / "top.json"), load(tmp_path / "b" / "top.json"))


def test_subdiagram_files_are_compared_by_their_content(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").touch()
    write(tmp_path, part=nested(), copy=nested(), other=nested(blocks={"g": {"type": "Gain", "parameters": {"k": 2}}}))
    tops = {name: document(blocks={"s": {"diagram": f"{name}.json"}}) for name in ("part", "copy", "other", "gone")}
    values: dict[str, Any] = {}
    for name, made in tops.items():
        if name != "gone":
            values[name] = loads(json.dumps(made), folder=tmp_path)
    with pytest.raises(ModelError, match="E007") as caught:
        loads(json.dumps(tops["gone"]), folder=tmp_path)
    values["gone"] = caught.value.readable
    values["inline"] = from_document(document(blocks={"s": inline(nested())}))
    assert not differences(values["part"], values["copy"])
    assert not differences(values["part"], values["inline"])
    changes = [str(one) for one in differences(values["part"], values["other"], resolver=resolver())]
    assert changes == ['~ s: diagram "part.json" -> "other.json"', "~ s.g: k not given (default 1.0) -> 2"]
    assert [str(one) for one in differences(values["part"], values["gone"])] == [
        '~ s: diagram "part.json" -> "gone.json"'
    ]
    assert not differences(values["gone"], values["gone"])


def test_columns_of_files_are_compared_by_their_numbers(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").touch()
    for name, numbers in (("a", "1 2"), ("b", "1.0 2"), ("c", "1 3")):
        (tmp_path / f"{name}.csv").write_text("\n".join(["x", *numbers.split()]), encoding="utf-8")

    def value(name: str) -> DiagramValue:
        column = {"csv": f"{name}.csv", "column": "x", "unit": "V"}
        return loads(json.dumps(document(parameters={"p": column})), folder=tmp_path)

    assert not differences(value("a"), value("b"))
    assert [str(one) for one in differences(value("a"), value("c"))] == [
        '~ p: column "x" of "a.csv" V -> column "x" of "c.csv" V'
    ]


def test_fmus_are_compared_by_path_and_bytes_and_never_opened_otherwise(tmp_path: Path) -> None:
    project, outside = tmp_path / "project", tmp_path / "outside.fmu"
    for name, text in (("a/m.fmu", "1"), ("b/m.fmu", "2"), ("c/m.fmu", "1"), ("a/copy.fmu", "1")):
        (project / name).parent.mkdir(parents=True, exist_ok=True)
        (project / name).write_text(text, encoding="utf-8")
    (project / "pyproject.toml").touch()
    outside.write_text("1", encoding="utf-8")
    os.mkfifo(project / "a" / "pipe.fmu")

    def changes(folder: str, fmu: str, other_folder: str = "a", other: str = "m.fmu") -> list[str]:
        values = (
            loads(json.dumps(document(blocks={"m": {"fmu": path}})), folder=project / where)
            for where, path in ((other_folder, other), (folder, fmu))
        )
        return [str(one) for one in differences(*values)]

    assert changes("a", "m.fmu") == changes("c", "m.fmu") == changes("a", "./m.fmu") == changes("c", "../a/m.fmu") == []
    assert changes("b", "m.fmu") == ['~ m: fmu "m.fmu" (SHA-256 6b86b273ff34) -> "m.fmu" (SHA-256 d4735e3a265e)']
    assert changes("a", "copy.fmu") == ['~ m: fmu "m.fmu" -> "copy.fmu" (the same bytes)']
    # A pipe would wait for ever, and what lies outside of the project is not read.
    assert changes("a", "pipe.fmu") == ['~ m: fmu "m.fmu" -> "pipe.fmu"']
    assert changes("a", "../../outside.fmu") == ['~ m: fmu "m.fmu" -> "../../outside.fmu"']
    assert changes("b", "gone.fmu", "a", "gone.fmu") == []


def test_files_that_hold_each_other_many_times_are_compared_once_each(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").touch()

    def tower(folder: Path, k: int) -> DiagramValue:
        parts = {"p0": nested(blocks={"g": {"type": "Gain", "parameters": {"k": k}}})}
        for i in range(1, 26):
            parts[f"p{i}"] = document(blocks={"l": {"diagram": f"p{i - 1}.json"}, "r": {"diagram": f"p{i - 1}.json"}})
        write(folder, **parts)
        return load(folder / "p25.json")

    a, b, c = tower(tmp_path / "a", 1), tower(tmp_path / "b", 1), tower(tmp_path / "c", 2)
    assert not differences(a, b)
    with pytest.raises(ModelError, match=r"E008 the diagrams have more than 100,000 differences\."):
        differences(a, c)


# --- faults --------------------------------------------------------------------------------------------------------


def test_diagrams_with_faults_of_the_model_are_compared() -> None:
    a = loop(wires={"nowhere.u": "nothing.y"}, blocks={"x": {"type": "Nonsense", "parameters": {"a": "=b+"}}})
    b = loop(wires={"nowhere.u": "else.y"}, blocks={"x": {"type": "Nonsense", "parameters": {"a": "=b+c+"}}})
    assert told(a, b) == ["blocks ~ x: a =b+ -> =b+c+", "wires ~ nowhere.u: nothing.y -> else.y"]
    ElementTree.fromstring(diff(a, b).svg())


def test_values_of_the_wrong_kind_are_compared_and_drawn() -> None:
    def read(unit: Any) -> DiagramValue:
        step = {"type": "Step", "parameters": {"after": unit, "unit": unit}}
        with pytest.raises(ModelError) as caught:
            loads(json.dumps(document(parameters={"p": {"value": 1, "unit": unit}}, blocks={"s": step})))
        value: DiagramValue = caught.value.readable
        return value

    made = differences(read({"a": 1}), read([{}]), resolver=resolver())
    assert [(one.place, one.what) for one in made] == [("s", "after"), ("s", "unit")]
    ElementTree.fromstring(made.svg())


def test_a_matrix_whose_edges_are_no_list_is_compared() -> None:
    def read(edges: Any) -> DiagramValue:
        with pytest.raises(ModelError) as caught:
            loads(json.dumps(document(parameters={"p": {"edges": edges, "shape": [2, 2]}})))
        value: DiagramValue = caught.value.readable
        return value

    changes = [str(one) for one in differences(read(1), read(2))]
    assert changes == ["~ p: {edges: 1, shape: [2, 2]} -> {edges: 2, shape: [2, 2]}"]


def test_a_wire_to_a_block_that_comes_with_a_rename_is_kept_apart() -> None:
    a = document(blocks={"g": {"type": "Gain"}}, wires={"g.u": "r", "k.u": "s"}, inputs={"r": {}, "s": {}})
    b = document(blocks={"k": {"type": "Gain"}}, wires={"k.u": "r"}, inputs={"r": {}, "s": {}})
    made = diff(a, b)
    assert [one.kind for one in made if one.group == "blocks"] == ["renamed"]
    assert [str(one) for one in made if one.group == "wires"] == ["- k.u <- s"]


HOSTILE = "\x1b[2Jx\u202e<script>alert(1)</script>&\"'\n\x00"


def hostile(word: str) -> dict[str, Any]:
    """A document with a hostile text at each place that takes any text."""
    bad = HOSTILE + word
    return document(
        doc=bad,
        parameters={"p": bad, "q": {"value": 1, "unit": bad}},
        inputs={"u": {"unit": bad}},
        outputs={"y": bad},
        blocks={
            "t": {"type": bad, "parameters": {bad: bad, f"{bad}2": [1, bad], "k": f"={bad}"}},
            "d": {"diagram": inline(nested(wires={bad: bad}))["diagram"], "enable": {f"x-{bad}": bad}},
            "f": {"fmu": f"{word}{bad}".replace("/", "").replace("\x00", "")},
            f"only_{word}": {"type": bad, "parameters": {bad: bad}},
        },
        wires={f"t.{bad}": f"d.{bad}", f"{bad}.x": bad, "t.u": bad},
        run={"log": [bad], "method": bad, "inputs": {bad: 1}, "master": {"steps": {bad: 1}}, "x-a": bad},
        measures={"m": {"type": bad, "of": bad, "against": bad}},
        **{f"x-{bad}": bad},
    )


def test_hostile_texts_are_told_and_drawn_as_texts() -> None:
    made = diff(hostile("a"), hostile("b"), doc=True, names=(HOSTILE, HOSTILE))
    assert len(made) > 20
    text = str(made)
    assert all(c.isprintable() or c == "\n" for c in text)
    assert text.count("\n") == len(made) + 1 + len({one.group for one in made})
    drawing = made.svg()
    root = ElementTree.fromstring(drawing)
    assert "<script" not in drawing
    assert "\x1b" not in drawing
    assert "\u202e" not in drawing
    known = {"svg", "style", "rect", "text", "g", "title", "path", "circle"}
    assert {element.tag.removeprefix(SVG) for element in root.iter()} <= known


# --- the drawing -----------------------------------------------------------------------------------------------------


def marked(svg: str, kind: str) -> dict[str, list[str]]:
    """The titles of what is marked as one kind: blocks and terminals, wires, and the signs of both."""
    root = ElementTree.fromstring(svg)
    made: dict[str, list[str]] = {"boxes": [], "wires": [], "signs": []}
    for group in root.iter(f"{SVG}g"):
        style = group.get("class", "").split()
        title = group.find(f"{SVG}title")
        if kind in style and title is not None:
            where = "signs" if "sign-of" in style else "wires" if "wire" in style else "boxes"
            made[where].append(str(title.text).split("\n")[0])
    return made


def test_the_drawing_has_a_sign_for_all_that_was_added_removed_and_changed() -> None:
    other = edited("blocks motor parameters Ra", 0.2, edited("run stop", 7))
    other["blocks"]["filter"] = {"type": "FirstOrder"}
    del other["blocks"]["control"]
    other["wires"] = {"error.u1": "r", "error.u2": "filter.y", "filter.u": "motor.omega", "motor.v": "error.y"}
    made = diff(loop(), other)
    svg = made.svg()
    added, removed, changed = (marked(svg, kind) for kind in ("added", "removed", "changed"))
    assert added["boxes"] == ["+ filter: FirstOrder"]
    assert sorted(added["wires"]) == ["+ error.u2 <- filter.y", "+ filter.u <- motor.omega", "+ motor.v <- error.y"]
    assert [title.split(":")[0] for title in removed["boxes"]] == ["- control"]
    assert sorted(removed["wires"]) == ["- control.u <- error.y", "- error.u2 <- motor.omega", "- motor.v <- control.y"]
    assert changed["boxes"] == ["~ motor: Ra 1200 mOhm -> 0.2 Ohm"]
    assert changed["wires"] == []
    for one in (added, removed, changed):
        assert sorted(one["signs"]) == sorted([*one["boxes"], *one["wires"]]), "never by color alone"
    assert ">Ra 1200 mOhm → 0.2 Ohm<" in svg, "written below the name"
    assert "run: ~ stop: 5 s -&gt; 7 s" in svg, "what has no place is listed below"
    assert svg == diff(loop(), other).svg(), "the same bytes each time"


def test_what_stays_is_pale_and_a_drawing_of_one_diagram_has_no_marks() -> None:
    svg = diff(loop(), edited("run stop", 7)).svg()
    root = ElementTree.fromstring(svg)
    blocks = [group.get("class", "") for group in root.iter(f"{SVG}g") if group.get("data-path")]
    assert len(blocks) == 6
    assert all(style.endswith(" same") for style in blocks)
    plain = Diagram.from_json(loop()).draw()
    assert "same" not in plain
    assert "disk" not in plain
    assert "added" not in plain


def test_a_renamed_block_shows_both_names() -> None:
    svg = diff(loop(), renamed(loop(), control="pid")).svg()
    assert ">pid (was control)<" in svg
    assert marked(svg, "changed")["boxes"] == ["> control -> pid: renamed"]
    assert not marked(svg, "added")["wires"]
    assert not marked(svg, "removed")["wires"]


def test_terminals_and_outputs_with_another_source_are_drawn() -> None:
    other = edited("outputs omega", "motor.i", edited("inputs d", None, edited("outputs u", "control.y")))
    svg = diff(loop(), other).svg()
    assert marked(svg, "added")["boxes"] == ["+ u: control.y"]
    assert sorted(marked(svg, "added")["wires"]) == ["+ omega <- motor.i", "+ u: control.y"]
    assert marked(svg, "removed")["boxes"] == ["- d"]
    assert marked(svg, "removed")["wires"] == ["- omega <- motor.omega"]


def test_subdiagrams_that_differ_inside_are_opened_and_no_others() -> None:
    both = document(blocks={"a": inline(nested()), "b": inline(nested())})
    other = document(blocks={"a": inline(nested()), "b": inline(nested(wires={}))})
    made = diff(both, other)
    root = ElementTree.fromstring(made.svg())
    frames = [group.get("data-path") for group in root.iter(f"{SVG}g") if group.get("class", "").startswith("frame")]
    assert frames == ["b"]
    assert marked(made.svg(), "removed")["wires"] == ["- b.g.u <- u"]
    closed = made.svg(depth=1)
    assert 'class="frame' not in closed
    assert marked(closed, "changed")["boxes"] == ["- b.g.u <- u"]


def test_a_block_whose_name_became_that_of_an_input_is_drawn_beside_it() -> None:
    a = document(blocks={"r": {"type": "Step"}, "g": {"type": "Gain"}}, wires={"g.u": "r.y"})
    b = document(inputs={"r": {}}, blocks={"g": {"type": "Gain"}}, wires={"g.u": "r"})
    svg = diff(a, b).svg()
    assert ">r (removed)<" in svg
    assert marked(svg, "removed")["wires"] == ["- g.u <- r.y"]
    assert marked(svg, "added")["wires"] == ["+ g.u <- r"]


# --- any diagram -----------------------------------------------------------------------------------------------------

NAMES = st.sampled_from([f"{letter}{i}" for letter in "abc" for i in range(4)])
NUMBERS = st.one_of(st.integers(-5, 5), st.floats(-1e6, 1e6, allow_nan=False), st.sampled_from([1e-300, 1e300]))
RAW = st.one_of(
    NUMBERS,
    st.booleans(),
    st.sampled_from(["+-", "=k", "=2*k + 1", "", "text"]),
    st.lists(NUMBERS, max_size=9),
    st.builds(lambda v, u: {"value": v, "unit": u}, NUMBERS, st.sampled_from(["V", "mOhm", "rpm", "nonsense"])),
)
TYPES = st.sampled_from(["Gain", "Sum", "PMDCMotor", "Integrator", "Nonsense"])


@st.composite
def documents(draw: st.DrawFn, depth: int = 1) -> dict[str, Any]:
    """Any diagram that can be read; most have faults."""

    def entry() -> dict[str, Any]:
        if depth and draw(st.integers(0, 4)) == 0:
            inner = draw(documents(depth - 1))
            return {"diagram": {key: item for key, item in inner.items() if key not in ("format", "version")}}
        parameters = draw(st.dictionaries(st.sampled_from(["k", "Ra", "signs", "unit"]), RAW, max_size=2))
        return {"type": draw(TYPES), **({"parameters": parameters} if parameters else {})}

    names = draw(st.lists(NAMES, max_size=7, unique=True))
    cut = draw(st.integers(0, len(names)))
    inputs = {name: draw(st.sampled_from([{}, {"unit": "V"}, {"default": 2}])) for name in names[cut:]}
    blocks = {name: entry() for name in names[:cut]}
    ends = [f"{name}.{port}" for name in blocks for port in ("u", "u1", "y")] + list(inputs) or ["gone.y"]
    sinks = [end for end in ends if "." in end]
    wires = draw(st.dictionaries(st.sampled_from(sinks), st.sampled_from(ends), max_size=6)) if sinks else {}
    return document(
        parameters=draw(st.dictionaries(st.sampled_from(["k", "p"]), RAW, max_size=2)),
        inputs=inputs,
        outputs=draw(st.dictionaries(st.sampled_from(["o1", "o2"]), st.sampled_from(ends), max_size=2)),
        blocks=blocks,
        wires=wires,
        run=draw(
            st.sampled_from([{}, {"stop": 1}, {"log": ends[:3]}, {"stop": 2, "inputs": dict.fromkeys(inputs, 1)}])
        ),
        measures=draw(st.dictionaries(st.just("m"), st.just({"type": "peak", "of": ends[0]}), max_size=1)),
    )


def shuffled(raw: Any, draw: Any) -> Any:
    """The same document with its entries in another order."""
    if isinstance(raw, dict):
        return {key: shuffled(raw[key], draw) for key in draw(st.permutations(list(raw)))}
    return raw


@given(documents())
@settings(max_examples=60, deadline=None)
def test_nothing_differs_from_itself_or_from_what_is_saved_and_loaded(made: dict[str, Any]) -> None:
    value = from_document(made)
    assert not differences(value, value)
    again = loads(dumps(value))
    assert again is not value
    assert not differences(value, again)
    assert differences(value, again, doc=True).changes == ()


@given(documents(), st.data())
@settings(max_examples=60, deadline=None)
def test_the_order_of_entries_and_the_layout_are_no_difference(made: dict[str, Any], data: st.DataObject) -> None:
    def lay(raw: dict[str, Any]) -> dict[str, Any]:
        raw["layout"] = {name: [data.draw(st.integers(0, 900)), 0] for name in raw.get("blocks", {})}
        for entry in raw.get("blocks", {}).values():
            if isinstance(entry.get("diagram"), dict):
                lay(entry["diagram"])
        return raw

    other = lay(json.loads(json.dumps(data.draw(st.builds(lambda: shuffled(made, data.draw))))))
    assert not diff(made, other)


@pytest.mark.long
@given(documents(), documents())
@settings(max_examples=100, deadline=None)
def test_both_ways_mirror_each_other_and_can_be_drawn(a: dict[str, Any], b: dict[str, Any]) -> None:
    there, back = diff(a, b), diff(b, a)

    def plain(changes: list[Change]) -> list[str]:
        return sorted(f"{one.group} {one} {one.before_path}" for one in changes)

    assert plain(list(there)) == plain([mirrored(one) for one in back])
    svg = there.svg()
    ElementTree.fromstring(svg)
    assert svg == diff(a, b).svg()


@given(documents(), st.data())
@settings(max_examples=150, deadline=None)
def test_a_single_edit_is_told_alone(made: dict[str, Any], data: st.DataObject) -> None:
    other = json.loads(json.dumps(made))
    sections = [key for key in ("parameters", "outputs", "wires", "blocks", "measures") if made[key]]
    if not sections:
        return
    section = data.draw(st.sampled_from(sections))
    name = data.draw(st.sampled_from(sorted(made[section])))
    match section:
        case "parameters":
            other[section][name] = "=never + seen"
        case "outputs" | "wires":
            other[section][name] = "elsewhere.y"
        case "blocks":
            other[section][name] = {"type": "NeverSeen"}
        case _:
            other[section][name]["of"] = "elsewhere.y"
    changes = list(diff(made, other))
    assert {(one.group, one.place, one.kind) for one in changes} == {(section, name, "changed")}
    # And taking it out.
    del other[section][name]
    (change,) = diff(made, other)
    assert (change.group, change.kind, change.before_path) == (section, "removed", name)


@given(documents(depth=0), st.data())
@settings(max_examples=100, deadline=None)
def test_renaming_all_blocks_is_told_as_renames(made: dict[str, Any], data: st.DataObject) -> None:
    new = data.draw(st.permutations([f"n{i}" for i in range(len(made["blocks"]))]))
    names = dict(zip(made["blocks"], new, strict=True))
    other = renamed(made, **names)
    changes = list(diff(made, other))
    assert {one.kind for one in changes} <= {"renamed"}
    assert {one.before_path for one in changes} == set(names)
    assert {one.path for one in changes} == set(new)


# --- the command -----------------------------------------------------------------------------------------------------


def run(*arguments: str) -> int:
    return cli.main(["diff", *arguments])


@pytest.fixture
def pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pyproject.toml").touch()
    write(tmp_path, a=loop(), b=edited("run stop", 6), c=edited("layout error", [0, 0]))
    return tmp_path


def test_the_exit_code_is_0_for_no_difference_1_for_some_and_2_for_an_error(
    pair: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("a.json", "c.json") == 0
    assert capsys.readouterr().out == "a.json -> c.json: no difference\n"
    assert run("a.json", "b.json") == 1
    assert capsys.readouterr().out == "a.json -> b.json\nrun\n  ~ stop: 5 s -> 6 s\n1 difference: 1 changed\n"
    (pair / "broken.json").write_text('{"format": ', encoding="utf-8")
    for other, code in (("gone.json", "E007"), ("broken.json", "E001"), (".", "E007")):
        assert run("a.json", other) == 2
        assert code in capsys.readouterr().err


def test_a_diagram_may_come_from_stdin(
    pair: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write(pair / "deep", part=nested(), top=document(blocks={"s": {"diagram": "part.json"}}))
    text = (pair / "deep" / "top.json").read_bytes()
    for arguments in (("-", "deep/top.json"), ("deep/top.json", "-")):
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text)))
        assert run(*arguments) == 0, "its subdiagrams lie where those of the other file do"
    assert "<stdin>: no difference" in capsys.readouterr().out
    assert run("-", "-") == 2
    assert "both diagrams cannot come from stdin" in capsys.readouterr().err


def test_json_is_a_line_for_each_change_and_one_for_all(pair: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(pair, d=edited("blocks motor parameters Ra", 0.2, edited("inputs d", None)))
    assert run("a.json", "d.json", "--json") == 1
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines == [
        {"event": "difference", "group": "inputs", "kind": "removed", "path": "d", "before_path": "d", "what": "",
         "old": {}, "new": None},
        {"event": "difference", "group": "blocks", "kind": "changed", "path": "motor", "before_path": "motor",
         "what": "Ra", "old": {"value": 1200.0, "unit": "mOhm"}, "new": 0.2},
        {"event": "done", "equal": False, "differences": 2, "added": 0, "removed": 1, "changed": 1, "renamed": 0},
    ]  # fmt: skip


def test_the_drawing_is_written_and_an_odd_place_is_refused(pair: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("a.json", "b.json", "--svg", "d.svg") == 1
    assert capsys.readouterr().out.endswith("\nd.svg\n")
    ElementTree.parse(pair / "d.svg")
    for arguments, word in (
        (("--svg", "d.png"), "diff draws SVG only"),
        (("--svg", "no/d.svg"), "cannot be written"),
        (("--depth", "0"), "must be 1 to 30: the number of levels"),
        (("c.json",), "more than two files were given"),
        (("--git",), "2 arguments were given; git passes seven."),
    ):
        assert run("a.json", "b.json", *arguments) == 2
        assert word in capsys.readouterr().err


def test_a_merge_that_is_not_settled_is_told_to_git(pair: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--git", "sub/top.json") == 0
    assert capsys.readouterr().out == "sub/top.json is not merged\n"


def test_one_file_is_not_enough(pair: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("a.json") == 2
    assert capsys.readouterr().err == "E501 blocks diff: needs two diagrams to compare. Give two files.\n"


def test_a_file_with_faults_is_compared_as_far_as_it_can_be_read(
    pair: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = edited("blocks motor colour", "red", edited("blocks extra diagram", "gone.json"))
    write(pair, faulty=made)
    assert run("a.json", "faulty.json") == 2
    out, err = capsys.readouterr()
    assert '  + extra: diagram "gone.json"\n' in out
    assert "faulty.json has 2 faults: only the readable part is compared" in err
    assert "E003" in err
    assert "E007" in err
    assert "the unreadable part was not compared" in err
    assert run("faulty.json", "faulty.json", "--json") == 2  # what cannot be read may differ
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["equal"] is None


def test_nothing_is_written_and_no_block_is_made_by_a_comparison(pair: Path) -> None:
    before = sorted(path.name for path in pair.iterdir())
    assert run("a.json", "b.json") == 1
    assert sorted(path.name for path in pair.iterdir()) == before


def test_a_terminal_is_told_no_escape_of_a_file(pair: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(pair, h=hostile("a"), i=hostile("b"))
    assert run("h.json", "i.json", "--doc", "--svg", "x.svg") == 1
    out, err = capsys.readouterr()
    assert all(c.isprintable() or c == "\n" for c in out + err)


@pytest.mark.skipif(shutil.which("git") is None, reason="no git here")
def test_git_shows_what_differs_in_diagrams(pair: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (pair / "tool").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m blocks "$@"\n', encoding="utf-8")
    (pair / "tool").chmod(0o755)
    for variable in [name for name in os.environ if name.startswith("GIT_")]:
        monkeypatch.delenv(variable)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("GIT_CONFIG_GLOBAL", os.devnull)
    monkeypatch.setenv("GIT_CONFIG_NOSYSTEM", "1")

    def git(*arguments: str) -> str:
        identity = ("-c", "user.name=n", "-c", "user.email=e", "-c", "core.pager=cat")
        made = subprocess.run(["git", *identity, *arguments], capture_output=True, text=True, timeout=120, check=True)
        return made.stdout

    write(pair / "sub", top=document(blocks={"s": {"diagram": "part.json"}}), part=nested(), gone=nested())
    (pair / ".gitattributes").write_text("*.json diff=blocks\n", encoding="utf-8")
    git("init", "-q", ".")
    git("config", "diff.blocks.command", f"{pair}/tool diff --git")
    git("add", ".")
    git("commit", "-q", "-m", "one")
    write(pair / "sub", top=document(blocks={"s": {"diagram": "part.json"}}, run={"stop": 3}))
    (pair / "a.json").write_text("{}", encoding="utf-8")
    (pair / "sub" / "gone.json").unlink()
    text = git("diff")
    assert "a/sub/top.json -> b/sub/top.json\nrun\n  + stop: 3 s\n1 difference: 1 added\n" in text
    assert "a/sub/gone.json -> b/sub/gone.json\ninputs\n  - u\n" in text, "a file that is no diagram ends nothing"
    git("commit", "-q", "-a", "-m", "two")
    assert "  + stop: 3 s\n" in git("diff", "HEAD~1", "HEAD", "--", "sub/top.json")


# --- in Python -------------------------------------------------------------------------------------------------------


def test_a_diagram_tells_what_differs_from_another_and_from_a_file(tmp_path: Path) -> None:
    a = Diagram("a")
    a.add("g", Gain(k=2))
    b = a.copy()
    b.add("f", FirstOrder(T=0.1))
    b.wire("f.u", "g.y")
    made = a.diff(b)
    assert made
    assert len(made) == 2
    assert made.counts["added"] == 2
    assert str(made) == "a -> a\nblocks\n  + f: FirstOrder (T 0.1 s)\nwires\n  + f.u <- g.y\n2 differences: 2 added"
    assert repr(made) == f"<Differences {made}>"
    b.save(tmp_path / "b.json")
    assert str(a.diff(tmp_path / "b.json")) == str(made)
    assert not a.diff(a.copy())
    bundle = made._repr_mimebundle_()
    assert bundle["text/plain"] == repr(made)
    assert bundle["image/svg+xml"] == made.svg()


def test_the_figure_of_the_page_on_commands_is_what_the_command_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for name in ("before.json", "after.json"):
        text = page.partition(f":caption: {name}\n\n")[2].partition("```")[0]
        Path(name).write_text(text, encoding="utf-8")
    assert run("before.json", "after.json", "--svg", "diff.svg") == 1
    figure = ROOT / "docs" / "_static" / "diff.svg"
    if os.environ.get("UPDATE_DOCS"):
        shutil.copy("diff.svg", figure)
    assert Path("diff.svg").read_text(encoding="utf-8") == figure.read_text(encoding="utf-8")


@pytest.mark.parametrize("path", sorted((ROOT / "diagrams" / "paper").glob("*adrc*.json")), ids=lambda path: path.name)
def test_a_shipped_diagram_does_not_differ_from_its_canonical_form(path: Path) -> None:
    value = load(path)
    again = loads(dumps(replace(value, layout={})), folder=path.parent)
    assert not differences(value, again, doc=True)


def test_the_two_controllers_of_the_paper_differ_in_their_wheels_only() -> None:
    folder = ROOT / "diagrams" / "paper"
    values = (load(folder / name) for name in ("adrc.json", "iadrc.json"))
    made = differences(*values, resolver=resolver())
    places = {one.place.partition(".")[0] for one in made if one.group == "blocks"}
    assert places == {"control_left", "control_right"}
    assert "~ control_right.eso: type LESO -> SMESO" in str(made)
    assert {one.group for one in made} == {"diagram", "blocks"}
