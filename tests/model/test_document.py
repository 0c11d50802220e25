"""Diagram files: what is read, what is refused and where, and that a canonical file is written back byte for byte."""

import contextlib
import json
import math
import os
import random
import shutil
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from blocks import Constant, Diagram, ModelError, UsageError, edit_file, subdiagram
from blocks.library import LIBRARY
from blocks.model.diagram_value import DiagramValue
from blocks.model.document import dumps, from_document, load, loads
from blocks.model.flatten import Flat, flatten
from blocks.model.project import MAX_BYTES, project_of
from blocks.model.resolver import resolver_of
from blocks.text.atomic_write import write_atomically
from blocks.text.errors import Fault
from blocks.text.json_document import IN_FILES
from tests.support.documents import NESTED, SHIPPED, diagrams, document, mutated
from tests.support.places import ROOT

GAIN = {"type": "Gain"}


def text(*lines: str) -> str:
    """A diagram's text from the lines behind its header: the first one given is line 3."""
    return "\n".join(['{"format": "blocks-diagram",', ' "version": 3,', *lines]) + "\n"


def faults(source: str | dict[str, Any]) -> list[tuple[str, str, int, int]]:
    """(code, place, line, column) of what is refused."""
    with pytest.raises(ModelError) as caught:
        loads(source) if isinstance(source, str) else from_document(source)
    return [(fault.code, fault.place, fault.line, fault.column) for fault in caught.value.faults]


def only(source: str | dict[str, Any]) -> Any:
    with pytest.raises(ModelError) as caught:
        loads(source) if isinstance(source, str) else from_document(source)
    assert len(caught.value.faults) == 1, str(caught.value)
    return caught.value.faults[0]


def project(folder: Path, **texts: dict[str, Any]) -> Path:
    """A project with diagram files of these names; the path of the first one."""
    (folder / "pyproject.toml").touch()
    for name, made in texts.items():
        (folder / f"{name}.json").write_text(json.dumps(made), encoding="utf-8")
    return folder / f"{next(iter(texts))}.json"


# --- the header ------------------------------------------------------------------------------------------------


def test_a_file_without_a_format_is_refused_with_how_to_begin() -> None:
    fault = only('{"version": 3}')
    assert (fault.code, fault.message) == ("E009", 'the key "format" is missing.')
    assert 'Begin with {"format": "blocks-diagram"' in fault.cure


def test_a_file_of_another_format_is_refused() -> None:
    fault = only('{"format": "flow-chart", "version": 3}')
    assert (fault.code, fault.place, fault.line, fault.column) == ("E006", "format", 1, 12)


@pytest.mark.parametrize("value", [[1], "text", 5, None, True])
def test_a_file_that_is_no_object_is_refused(value: Any) -> None:
    assert only(json.dumps(value)).code == "E006"


def test_a_later_version_asks_for_an_update_and_another_one_does_not() -> None:
    later, odd, bool_ = (
        only(json.dumps({"format": "blocks-diagram", "version": version})) for version in (4, "1", True)
    )
    assert [fault.code for fault in (later, odd, bool_)] == ["E005"] * 3
    assert "Update blocks" in later.cure
    assert odd.cure == bool_.cure == 'Write "version": 3.'
    assert "reads version 3" in only('{"format": "blocks-diagram", "version": 0.5}').cure
    assert "reads version 3" in only('{"format": "blocks-diagram", "version": 0}').cure
    assert only('{"format": "blocks-diagram"}').message == 'the key "version" is missing.'


def test_version_1_is_refused_with_what_to_change() -> None:
    fault = only('{"format": "blocks-diagram",\n "version": 1, "blocks": {"c": {"type": "PID"}}, "cables": {}}')
    assert (fault.code, fault.place, fault.line, fault.column) == ("E005", "version", 2, 13)
    assert fault.message == "version 1 cannot be read, because it has another PID: u was the error, and y the control."
    assert fault.cure == 'Write "version": 2, and change each PID as `blocks explain E005` shows.'


def test_a_fault_of_the_first_two_keys_hides_no_other() -> None:
    wrong = '"blocks": {"g": {"type": "Gain", "k": 1}}}'
    for header in ('{"format": "blocks-diagram", ', '{"format": "blocks-diagram", "version": "1", ', "{"):
        assert [fault[0] for fault in faults(header + wrong)][1:] == ["E003"]
    # What another version means by its keys is not known.
    for header in ('{"format": "blocks-diagram", "version": 99, ', '{"format": "blocks-dia", "version": 3, '):
        assert len(faults(header + wrong)) == 1


def test_slips_of_the_text_hide_no_fault_of_the_structure() -> None:
    text = (
        "\ufeff"
        + """{"format": "blocks-diagram", "version": 3, // a loop
 "blocks": {
  "g": {"type": "Gain", "k": 1,},
  "h": {"typ": "Gain", 'parameters': {"k": 1e999}}
  "i": {"type": "Gain"}
 },
}"""
    )
    assert faults(text) == [
        ("E001", "", 1, 1),
        ("E001", "", 1, 45),
        ("E003", "blocks.g.k", 3, 25),
        ("E001", "blocks.g", 3, 31),
        ("E009", "blocks.h", 4, 3),
        ("E003", "blocks.h.typ", 4, 9),
        ("E001", "blocks.h", 4, 24),
        ("E004", "blocks.h.parameters.k", 4, 44),
        ("E001", "blocks", 5, 3),
        ("E001", "", 6, 3),
    ]


# --- structure -------------------------------------------------------------------------------------------------


def test_an_unknown_key_is_refused_where_it_stands_and_the_nearest_is_offered() -> None:
    fault = only(text(' "blokcs": {}}'))
    assert (fault.code, fault.line, fault.column) == ("E003", 3, 2)
    assert fault.cure == 'Did you mean "blocks"?'


def test_keys_that_begin_with_x_are_kept_everywhere() -> None:
    source = document(
        parameters={"a": {"value": 1, "x-note": [1]}},
        inputs={"u": {"x-note": 1}},
        blocks={"g": {"type": "Gain", "x-note": {"a": None}}},
        run={"x-note": True},
        measures={"m": {"type": "IAE", "of": "g.y", "x-note": "n"}},
    )
    source["x-own"] = {"deep": [1, {"a": 2}]}
    assert Diagram.from_json(source).to_json() == source


@pytest.mark.parametrize(
    ("section", "entry", "code", "place"),
    [
        ("blocks", {"g": 5}, "E004", "blocks.g"),
        ("blocks", {"g": {}}, "E009", "blocks.g"),
        ("blocks", {"g": {"type": "Gain", "fmu": "a.fmu"}}, "E003", "blocks.g"),
        ("blocks", {"g": {"type": ""}}, "E004", "blocks.g.type"),
        ("blocks", {"g": {"type": "Gain", "kind": 1}}, "E003", "blocks.g.kind"),
        ("blocks", {"g": {"type": "Gain", "isolate": True}}, "E003", "blocks.g.isolate"),
        ("blocks", {"g": {"diagram": {}, "timeout": 1}}, "E003", "blocks.g.timeout"),
        ("blocks", {"g": {"fmu": "a.fmu", "kind": "cs"}}, "E004", "blocks.g.kind"),
        ("blocks", {"g": {"fmu": "a.fmu", "kind": None}}, "E004", "blocks.g.kind"),
        ("blocks", {"g": {"fmu": "a.fmu", "kind": ["CS"]}}, "E004", "blocks.g.kind"),
        ("blocks", {"g": {"fmu": "a.fmu", "isolate": 1}}, "E004", "blocks.g.isolate"),
        ("blocks", {"g": {"fmu": "a.fmu", "timeout": 0}}, "E004", "blocks.g.timeout"),
        ("blocks", {"g": {"fmu": "a.fmu", "timeout": 1e7}}, "E004", "blocks.g.timeout"),
        ("blocks", {"g": {"fmu": "a.fmu", "timeout": "10 s"}}, "E004", "blocks.g.timeout"),
        ("blocks", {"g": {"fmu": "a.fmu", "timeout": True}}, "E004", "blocks.g.timeout"),
        ("blocks", {"g": {"fmu": "a.fmu", "knid": "CS"}}, "E003", "blocks.g.knid"),
        ("blocks", {"g": {"fmu": 5}}, "E004", "blocks.g.fmu"),
        ("blocks", {"g": {"fmu": ""}}, "E004", "blocks.g.fmu"),
        ("blocks", {"g": {"fmu": "https://x.org/a.fmu"}}, "E007", "blocks.g.fmu"),
        ("blocks", {"g": {"fmu": "file:///a.fmu"}}, "E007", "blocks.g.fmu"),
        ("blocks", {"g": {"fmu": "//host/share/a.fmu"}}, "E007", "blocks.g.fmu"),
        ("blocks", {"g": {"fmu": "\\\\host\\share\\a.fmu"}}, "E007", "blocks.g.fmu"),
        ("blocks", {"g": {"fmu": "a\0.fmu"}}, "E007", "blocks.g.fmu"),
        ("blocks", {"g": {"fmu": "a.fmu", "enable": {}}}, "E003", "blocks.g.enable"),
        ("run", {"master": 5}, "E004", "run.master"),
        ("run", {"master": {"setp": 1}}, "E003", "run.master.setp"),
        ("blocks", {"g": {"type": "Gain", "parameters": []}}, "E004", "blocks.g.parameters"),
        ("blocks", {"g": {"type": "Gain", "parameters": {"k": None}}}, "E004", "blocks.g.parameters.k"),
        ("blocks", {"g": {"type": "Gain", "parameters": {"k": [1, None]}}}, "E004", "blocks.g.parameters.k.1"),
        ("blocks", {"g": {"type": "Gain", "parameters": {"k": [1, True]}}}, "E004", "blocks.g.parameters.k.1"),
        ("blocks", {"g": {"type": "Gain", "parameters": {"k": {"unit": "V"}}}}, "E009", "blocks.g.parameters.k"),
        ("blocks", {"g": {"diagram": {"version": 3}}}, "E003", "blocks.g.diagram.version"),
        ("blocks", {"2g": GAIN}, "E111", "blocks.2g"),
        ("blocks", {"größe": GAIN}, "E111", "blocks.größe"),
        ("blocks", {"a.b": GAIN}, "E111", "blocks.a.b"),
        ("parameters", {"a": {"value": None}}, "E004", "parameters.a.value"),
        ("parameters", {"a": {"value": {"value": 1}}}, "E004", "parameters.a.value"),
        ("parameters", {"a": {"value": 1, "unit": 5}}, "E004", "parameters.a.unit"),
        ("parameters", {"a": {"value": [[1, {}]]}}, "E004", "parameters.a.value.0.1"),
        ("inputs", {"u": "V"}, "E004", "inputs.u"),
        ("inputs", {"u": {"default": "1"}}, "E004", "inputs.u.default"),
        ("inputs", {"u": {"default": True}}, "E004", "inputs.u.default"),
        ("inputs", {"u": {"type": "bool", "default": 1}}, "E004", "inputs.u.default"),
        ("inputs", {"u": {"type": "bool", "unit": "V"}}, "E004", "inputs.u.unit"),
        ("inputs", {"u": {"type": "enum"}}, "E004", "inputs.u.type"),
        ("inputs", {"u": {"size": 0}}, "E004", "inputs.u.size"),
        ("inputs", {"u": {"size": 1.5}}, "E004", "inputs.u.size"),
        ("inputs", {"u": {"size": True}}, "E004", "inputs.u.size"),
        ("inputs", {"u": {"size": 1e9}}, "E004", "inputs.u.size"),
        ("outputs", {"y": 5}, "E004", "outputs.y"),
        ("wires", {"g.u": ["a.y"]}, "E004", "wires.g.u"),
        ("wires", [], "E004", "wires"),
        ("run", 5, "E004", "run"),
        ("run", {"stopp": 1}, "E003", "run.stopp"),
        ("measures", {"m": {"of": "g.y"}}, "E009", "measures.m"),
        ("measures", {"m": {"type": 5, "of": "g.y"}}, "E004", "measures.m.type"),
        ("measures", {"m": {"type": "IAE", "of": "g.y", "unit": "V"}}, "E003", "measures.m.unit"),
        ("layout", {"g": [1, 2]}, "E105", "layout.g"),
        ("doc", [1], "E004", "doc"),
        ("doc", {}, "E004", "doc"),
        ("name", "two words", "E111", "name"),
        ("name", None, "E111", "name"),
    ],
)
def test_what_is_of_the_wrong_kind_is_refused_in_its_place(section: str, entry: Any, code: str, place: str) -> None:
    fault = only(json.dumps(document(**{section: entry})))
    assert (fault.code, fault.place) == (code, place)
    assert fault.line == 1
    assert fault.column > 1
    assert fault.message.endswith(".")


def test_a_position_is_two_numbers() -> None:
    for wrong in ([1], [1, "2"], 5, [1, 2, 3]):
        assert faults(document(blocks={"g": GAIN}, layout={"g": wrong})) == [("E004", "layout.g", 0, 0)]


def test_blocks_inputs_and_parameters_share_one_namespace() -> None:
    source = text(' "parameters": {"a": 1},', ' "inputs": {"a": {}},', ' "blocks": {"a": {"type": "Gain"}}}')
    assert faults(source) == [("E109", "inputs.a", 4, 13), ("E109", "blocks.a", 5, 13)]


def test_an_output_may_be_called_like_a_block() -> None:
    Diagram.from_json(document(inputs={"u": {}}, blocks={"g": GAIN}, wires={"g.u": "u"}, outputs={"g": "g.y"})).check()


def test_all_faults_are_told_once_in_the_order_of_the_text() -> None:
    source = text(
        ' "blocks": {',
        '  "1a": {"type": "Gain"},',
        '  "b": {"typ": "Gain"},',
        '  "c": {"type": 5}},',
        ' "wires": {"c.u": 1},',
        ' "inputs": {"c": {"size": -1}}}',
    )
    assert faults(source) == [
        ("E111", "blocks.1a", 4, 3),
        ("E009", "blocks.b", 5, 3),
        ("E003", "blocks.b.typ", 5, 9),
        ("E109", "blocks.c", 6, 3),
        ("E004", "blocks.c.type", 6, 17),
        ("E004", "wires.c.u", 7, 19),
        ("E004", "inputs.c.size", 8, 27),
    ]


def test_a_thousand_faults_are_enough() -> None:
    made = faults(document(blocks={f"{i}": GAIN for i in range(20_000)}))
    assert len(made) == 1001
    assert made[-1][0] == "E008"


def test_what_a_terminal_would_obey_is_shown_escaped() -> None:
    with pytest.raises(ModelError) as caught:
        from_document(document(blocks={"a\x1b[31m": GAIN, "b\u202e": {"type": 1}}, layout={"\x07": [0, 0]}))
    assert str(caught.value).replace("\n", "").isprintable()
    assert r"\u001b" in str(caught.value)


def test_a_key_twice_is_refused_by_the_reader_of_the_text() -> None:
    assert faults(text(' "wires": {"a.u": "b.y", "a.u": "c.y"}}')) == [("E002", "wires", 3, 26)]


# --- subdiagram files ------------------------------------------------------------------------------------------


INNER = document(inputs={"u": {}}, outputs={"y": "g.y"}, blocks={"g": GAIN}, wires={"g.u": "u"})


def using(*names: str) -> dict[str, Any]:
    return document(blocks={f"s{k}": {"diagram": name} for k, name in enumerate(names)})


def refused(path: Path) -> Any:
    with pytest.raises(ModelError) as caught:
        load(path)
    assert len(caught.value.faults) == 1, str(caught.value)
    return caught.value.faults[0]


def test_a_subdiagram_file_is_found_from_the_file_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    project(tmp_path / "parts", middle=using("inner.json"), inner=INNER)
    path = project(tmp_path, top=using("parts/middle.json"))
    middle = load(path).blocks["s0"].inner
    assert middle is not None
    assert middle.blocks["s0"].inner == from_document(INNER)


def test_a_file_that_is_used_twice_is_read_once_and_its_faults_are_told_once(tmp_path: Path) -> None:
    path = project(tmp_path, top=using("inner.json", "inner.json"), inner=INNER)
    blocks = load(path).blocks
    assert blocks["s0"].loaded is blocks["s1"].loaded
    path = project(tmp_path, top=using("inner.json", "inner.json"), inner=document(wire={}))
    fault = refused(path)
    assert (fault.code, Path(fault.file).name) == ("E003", "inner.json")


def test_files_are_named_as_the_one_that_names_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "parts").mkdir()
    project(tmp_path / "parts", inner=document(wire={}))
    project(tmp_path, top=using("parts/inner.json"))
    assert refused(Path("top.json")).file == os.path.join("parts", "inner.json")
    project(tmp_path, top=using("parts/" + "x" * 80 + ".json"))
    assert 'xxx.json" does not exist' in refused(Path("top.json")).message


def test_a_missing_file_is_told_with_its_neighbor(tmp_path: Path) -> None:
    fault = refused(project(tmp_path, top=using("iner.json"), inner=INNER))
    assert (fault.code, fault.place, fault.cure) == ("E007", "blocks.s0.diagram", "Did you mean 'inner.json'?")
    assert "does not exist" in fault.message
    assert fault.line == 1
    fault = refused(project(tmp_path, top=using("diagrams/adrc/adrc_2.json")))
    assert fault.cure == "Paths are relative to the folder of the file that contains them."


@pytest.mark.parametrize("name", ["", "http://example.org/a.json", "a\0b.json", "x" * 5000, "."])
def test_what_is_no_file_is_refused(tmp_path: Path, name: str) -> None:
    assert refused(project(tmp_path, top=using(name))).code in ("E004", "E007")


@pytest.mark.parametrize("chain", [["a"], ["a", "b"], ["a", "b", "c"]])
def test_files_that_contain_each_other_are_refused_with_their_chain(tmp_path: Path, chain: list[str]) -> None:
    following = [*chain[1:], chain[0]]
    path = project(tmp_path, **{name: using(f"{other}.json") for name, other in zip(chain, following, strict=True)})
    fault = refused(path)
    assert fault.code == "E113"
    assert " -> ".join(f"{name}.json" for name in [*chain, chain[0]]) in fault.message


def test_a_link_to_a_file_above_makes_a_cycle_too(tmp_path: Path) -> None:
    path = project(tmp_path, a=using("b.json"))
    (tmp_path / "b.json").symlink_to(path)
    assert refused(path).code == "E113"


def test_links_in_a_circle_are_refused(tmp_path: Path) -> None:
    (tmp_path / "b.json").symlink_to(tmp_path / "c.json")
    (tmp_path / "c.json").symlink_to(tmp_path / "b.json")
    assert refused(project(tmp_path, a=using("b.json"))).code == "E007"
    assert refused(tmp_path / "b.json").code == "E007"


def test_files_outside_the_project_are_refused_also_through_links(tmp_path: Path) -> None:
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    project(outside, secret=INNER)
    (inside / "link.json").symlink_to(outside / "secret.json")
    for name in ("../outside/secret.json", "link.json", str(outside / "secret.json")):
        fault = refused(project(inside, top=using(name)))
        assert (fault.code, fault.cure) == ("E007", "Move it into the project's folder.")


def test_the_project_is_the_nearest_folder_with_a_mark(tmp_path: Path) -> None:
    deep = tmp_path / "a" / "b"
    deep.mkdir(parents=True)
    assert project_of(deep / "x.json").folder == deep.resolve()
    (tmp_path / ".git").mkdir()
    assert project_of(deep / "x.json").folder == tmp_path.resolve()
    (deep.parent / "pyproject.toml").touch()
    assert project_of(deep / "x.json").folder == deep.parent.resolve()


def test_home_and_what_is_above_it_is_no_project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "home" / "me"
    deep = home / "work" / "diagrams"
    deep.mkdir(parents=True)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("USERPROFILE", str(home))
    for folder in (home, tmp_path):
        (folder / ".git").mkdir()
    assert project_of(deep / "x.json").folder == deep.resolve(), "settings in the home folder make no project of it"
    (home / "work" / ".git").mkdir()
    assert project_of(deep / "x.json").folder == (home / "work").resolve()
    # A file right there may name those beside it, and nothing below.
    project(home, top=using("inner.json"), inner=INNER)
    load(home / "top.json")
    project(home, top=using("work/inner.json"))
    project(home / "work", inner=INNER)
    fault = refused(home / "top.json")
    assert fault.code == "E007"
    assert f"lies outside the project ({home} is not a project, because it is the home folder)" in fault.message
    assert fault.cure == f"Put both into their own folder below {home}."
    assert not project_of(Path(home.anchor) / "x.json").is_whole


def test_files_that_lie_too_deep_in_each_other_are_refused(tmp_path: Path) -> None:
    made = {f"f{k}": using(f"f{k + 1}.json") for k in range(200)} | {"f200": INNER}
    fault = refused(project(tmp_path, **made))
    assert (fault.code, Path(fault.file).name) == ("E008", "f30.json")


def lag_in_objects(depth: int, *, is_variant: bool) -> dict[str, Any]:
    """A lag at the end of so many objects in each other, each the variant of a block where asked."""

    def entry(made: dict[str, Any], base: str) -> dict[str, Any]:
        return {"type": base, "variant": "own", "variants": {"own": made}} if is_variant else made

    matrices = {"A": {"value": [[-2.0]]}, "B": [[1.0]], "C": [[3.0]], "x_start": [1.0]}
    inner = entry({"type": "StateSpace", "parameters": matrices}, "StateSpace")
    own = {"inputs": {"u": {"default": 0.5}}, "outputs": {"y": "s.y[0]"}, "wires": {"s.u[0]": "u"}}
    for _ in range(depth + 1):
        body = {**own, "blocks": {"s": inner}}
        inner = entry({"diagram": body}, "FirstOrder")
        own = {"inputs": {"u": {"default": 0.5}}, "outputs": {"y": "s.y"}, "wires": {"s.u": "u"}}
    return document(**body, run={"stop": 1.0, "method": "rk4", "step": 0.01, "log": ["y"]})


@pytest.mark.parametrize("is_variant", [False, True])
def test_the_deepest_diagram_that_runs_can_be_saved(is_variant: bool, tmp_path: Path) -> None:
    """Thirty in each other go into a file and come back with the same bits; one more is refused by all alike."""
    made = Diagram.from_json(lag_in_objects(30, is_variant=is_variant))
    made.save(tmp_path / "deep.json")
    read = Diagram.load(tmp_path / "deep.json")
    assert read.value == made.value
    assert read.dumps() == (tmp_path / "deep.json").read_text()
    results = [diagram.run(engine="reference")["y"] for diagram in (made, read)]
    assert results[0].tobytes() == results[1].tobytes()
    assert results[0][-1] == pytest.approx(0.75 + 2.25 * math.exp(-2.0), rel=1e-9)

    inner = made.copy()
    beyond = Diagram("beyond")
    beyond.add("s", inner)
    for refuse in (beyond.flatten, beyond.dumps, lambda: beyond.save(tmp_path / "beyond.json")):
        with pytest.raises(ModelError, match=r"E008 .*subdiagrams lie more than 30 deep") as caught:
            refuse()
        assert caught.value.code == "E008"
    assert not (tmp_path / "beyond.json").exists()
    assert only(lag_in_objects(31, is_variant=is_variant)).code == "E008"


def test_depth_counts_subdiagrams_in_files_and_in_objects_alike(tmp_path: Path) -> None:
    """Ten in each of three files are as many as there may be, and are checked; one more is told."""

    def nested(depth: int, innermost: dict[str, Any]) -> dict[str, Any]:
        for _ in range(depth):
            own = {"inputs": {"u": {}}, "outputs": {"y": "s.y"}, "wires": {"s.u": "u"}}
            innermost = {**own, "blocks": {"s": {"diagram": innermost}}}
        return innermost

    bare = {key: value for key, value in INNER.items() if key not in ("format", "version")}
    for last in (10, 11, 18):
        files: dict[str, Any] = {}
        for name, below in (("a", "b.json"), ("b", "c.json"), ("c", None)):
            own = {"inputs": {"u": {}}, "outputs": {"y": "s.y"}, "wires": {"s.u": "u"}}
            inner = bare if below is None else {**own, "blocks": {"s": {"diagram": below}}}
            files[name] = document(**nested(last if below is None else 9, inner))
        path = project(tmp_path, **files)
        if last == 10:
            value = load(path)
            depth, inner_value = 0, value
            while "g" not in inner_value.blocks:
                inner_value, depth = inner_value.blocks["s"].inner, depth + 1
            assert depth == 30
            flatten(value, resolver_of(LIBRARY))
        else:
            fault = refused(path)
            assert (fault.code, Path(fault.file).name) == ("E008", "c.json")
            assert fault.message == "subdiagrams lie more than 30 deep."


@pytest.mark.parametrize(
    ("name", "written"),
    [("größe_μ", "groesse_mu"), ("Δ T", "Delta_T"), ("\N{MICRO SIGN}", "mu"), ("naïf é", "naif_e"), ("日", "")],
)
def test_a_name_that_is_none_is_told_as_it_could_be_written(name: str, written: str) -> None:
    with pytest.raises(ModelError) as caught:
        loads(json.dumps(document(blocks={name: GAIN})))
    rule = "letters, digits and _, not beginning with a digit."
    assert caught.value.faults[0].cure == (f'Write "{written}": {rule}' if written else f"Use {rule}")


def test_a_key_of_the_run_that_stands_at_the_top_is_told_where_it_belongs() -> None:
    with pytest.raises(ModelError) as caught:
        loads(json.dumps(document(loops="warn", stop=1)))
    assert [(fault.code, fault.cure) for fault in caught.value.faults] == [
        ("E003", 'It belongs into "run": {"loops": ...}.'),
        ("E003", 'It belongs into "run": {"stop": ...}.'),
    ]


def test_files_that_use_each_other_twice_are_refused_before_they_fill_the_memory(tmp_path: Path) -> None:
    made = {f"f{k}": using(*[f"f{k + 1}.json"] * 4) for k in range(20)} | {"f20": INNER}
    value = load(project(tmp_path, **made))
    with pytest.raises(ModelError, match=r"E008 .*blocks, but the limit is 1,000,000"):
        flatten(value, resolver_of(LIBRARY))


def test_a_file_that_is_too_large_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "large.json"
    with open(path, "wb") as stream:
        stream.truncate(IN_FILES * MAX_BYTES + 1)
    assert refused(path).code == "E008"


def test_a_diagram_beyond_the_limit_of_texts_is_saved_as_a_file_and_read(tmp_path: Path) -> None:
    """A text that comes from elsewhere may be a fourth as large."""
    large = Diagram("large")
    for number in range(300):
        large.add(f"block{number}", Constant(value=number / 7), doc="x" * 60_000)
    path, outer = tmp_path / "large.json", Diagram("outer", folder=tmp_path)
    large.save(path)
    assert path.stat().st_size > MAX_BYTES
    read = Diagram.load(path)
    assert read.value.blocks == large.value.blocks
    assert read.dumps() == large.dumps()
    read.remove("block7")
    assert [*read] == [name for name in large if name != "block7"]
    edit_file(path, [{"remove": "blocks.block8"}]).write()
    assert len(Diagram.load(path).value.blocks) == 299
    outer.add("part", subdiagram("large.json"))
    outer.save(tmp_path / "outer.json")
    assert len(Diagram.load(tmp_path / "outer.json").flatten().blocks) == 299
    with pytest.raises(ModelError, match="E008"):
        Diagram.from_json(path.read_bytes())


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="everything can be read here")
def test_a_file_that_must_not_be_read_is_refused(tmp_path: Path) -> None:
    path = project(tmp_path, a=INNER)
    path.chmod(0)
    assert refused(path).code == "E007"


def test_faults_of_several_files_stand_together(tmp_path: Path) -> None:
    path = project(tmp_path, a=document(blocks={"s": {"diagram": "b.json"}}, wires=[]), b=document(run=1))
    with pytest.raises(ModelError) as caught:
        load(path)
    assert sorted((Path(fault.file).name, fault.place) for fault in caught.value.faults) == [
        ("a.json", "wires"),
        ("b.json", "run"),
    ]


# --- writing ---------------------------------------------------------------------------------------------------


def test_a_canonical_file_is_written_back_byte_for_byte() -> None:
    assert dumps(loads(NESTED)) == NESTED


def test_a_file_of_one_line_becomes_canonical_and_keeps_its_numbers() -> None:
    squeezed = "".join(line.strip() for line in NESTED.splitlines())
    assert dumps(loads(squeezed)) == NESTED


def test_a_pretty_printed_dict_gives_the_same_diagram() -> None:
    source = json.loads(NESTED)
    assert from_document(source) == loads(json.dumps(source, indent=4))
    assert Diagram.from_json(source).to_json() == source


def test_saving_into_another_folder_keeps_the_paths_of_subdiagram_files(tmp_path: Path) -> None:
    path = project(tmp_path, top=using("inner.json"), inner=INNER)
    (tmp_path / "out" / "deep").mkdir(parents=True)
    Diagram.load(path).save(tmp_path / "out" / "deep" / "top.json")
    saved = tmp_path / "out" / "deep" / "top.json"
    assert json.loads(saved.read_text())["blocks"]["s0"]["diagram"] == "../../inner.json"
    assert load(saved).blocks["s0"].inner == from_document(INNER)


def test_a_failed_save_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text("old")

    def interrupted() -> None:
        with write_atomically(path) as stream:
            stream.write("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_saving_follows_links_and_keeps_the_mode(tmp_path: Path) -> None:
    real, link = tmp_path / "real.json", tmp_path / "link.json"
    real.write_text("old")
    real.chmod(0o640)
    link.symlink_to(real)
    with write_atomically(link) as stream:
        stream.write("new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    if os.name == "posix":
        assert real.stat().st_mode & 0o777 == 0o640


@pytest.mark.skipif(os.name != "posix", reason="no /dev/null")
def test_a_device_is_written_to_and_not_replaced() -> None:
    with write_atomically("/dev/null") as stream:
        stream.write("gone")
    assert not Path("/dev/null").is_file()


@pytest.mark.parametrize("name", ["missing/a.json", ".", "a\0b"])
def test_a_place_that_cannot_be_written_to_is_a_usage_error(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match=r"E501 .*cannot be written"):
        Diagram("d").save(f"{tmp_path}/{name}")


# --- random files ----------------------------------------------------------------------------------------------


def pruned(body: Any) -> Any:
    """Without what a canonical file leaves out."""
    if not isinstance(body, dict):
        return body
    kept = {key: pruned(value) if key in ("blocks", "diagram") else value for key, value in body.items()}
    if "blocks" in kept:
        kept["blocks"] = {name: pruned(block) for name, block in kept["blocks"].items()}
    return {key: value for key, value in kept.items() if key.startswith(("x-", "diagram")) or value not in ("", [], {})}


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(diagrams)
def test_a_random_diagram_that_is_written_and_read_is_identical(body: dict[str, Any]) -> None:
    value = from_document(document(**body))
    written = dumps(value)
    again = loads(written)
    assert again == value
    assert dumps(again) == written
    assert json.loads(written) == pruned(document(**body))


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(SHIPPED), st.integers(0, 2**32))
@example(SHIPPED[0], 0)
def test_a_mutated_file_gives_faults_or_a_diagram_and_nothing_else(path: Path, seed: int) -> None:
    source = mutated(json.loads(path.read_text(encoding="utf-8")), random.Random(seed))
    told: tuple[Fault, ...] = ()
    try:
        value = loads(json.dumps(source), folder=path.parent)
        assert isinstance(value, DiagramValue)
        assert isinstance(flatten(value, resolver_of(LIBRARY)), Flat)
    except ModelError as error:
        told = error.faults
    assert len(set(told)) == len(told)
    assert all(str(fault).isprintable() and len(str(fault)) < 1500 for fault in told)


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(SHIPPED), st.integers(0, 10_000), st.integers(0, 40), st.binary(max_size=4))
def test_a_damaged_text_gives_faults_or_a_diagram_and_nothing_else(path: Path, at: int, cut: int, put: bytes) -> None:
    data = path.read_bytes()
    at %= len(data)
    with contextlib.suppress(ModelError):
        loads(data[:at] + put + data[at + cut :], folder=path.parent)


# --- FMUs ------------------------------------------------------------------------------------------------------


def test_what_a_file_says_of_an_fmu_is_kept_as_it_is_written() -> None:
    line = (
        '  "motor": {"fmu": "../fmus/X.fmu", "kind": "CS", "isolate": true, "timeout": 1e1, "doc": "a plant", '
        '"parameters": {"Ra": 0.20, "body.m[1]": {"value": 5, "unit": "g"}}, "x-own": 1}\n'
    )
    source = '{\n "format": "blocks-diagram",\n "version": 3,\n "name": "d",\n "blocks": {\n' + line + " }\n}\n"
    value = loads(source)
    assert dumps(value) == source
    entry = value.blocks["motor"]
    assert (entry.fmu, dict(entry.options)) == ("../fmus/X.fmu", {"kind": "CS", "isolate": True, "timeout": 10.0})
    assert Diagram.from_json(source).to_json() == json.loads(source)


def test_options_of_an_fmu_are_written_in_one_order() -> None:
    value = loads(text(' "blocks": {"m": {"timeout": 5, "parameters": {"a": 1}, "kind": "ME", "fmu": "a.fmu"}}}'))
    assert '"m": {"fmu": "a.fmu", "kind": "ME", "timeout": 5, "parameters": {"a": 1}}' in dumps(value)


def test_the_path_of_an_fmu_begins_at_the_folder_of_the_file_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").touch()
    for folder in ("parts", "fmus"):
        (tmp_path / folder).mkdir()
    shutil.copy(ROOT / "fmus" / "PMDCMotor.fmu", tmp_path / "fmus" / "m.fmu")
    inner = document(
        inputs={"v": {"unit": "V"}},
        outputs={"omega": "m.omega"},
        blocks={"m": {"fmu": "../fmus/m.fmu", "kind": "CS"}},
        wires={"m.v": "v"},
    )
    (tmp_path / "parts" / "inner.json").write_text(json.dumps(inner))
    outer = document(
        inputs={"v": {"unit": "V"}},
        blocks={"own": {"fmu": "fmus/m.fmu", "kind": "CS"}, "part": {"diagram": "parts/inner.json"}},
        wires={"own.v": "v", "part.v": "v"},
    )
    (tmp_path / "outer.json").write_text(json.dumps(outer))
    found = Diagram.load(tmp_path / "outer.json").flatten().blocks
    assert [block.path for block in found] == ["own", "part.m"]
    assert {block.interface.declaration.foreign.path.resolve() for block in found} == {tmp_path / "fmus" / "m.fmu"}
