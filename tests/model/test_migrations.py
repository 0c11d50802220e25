"""Versions of the files: what each one means is pinned by a golden file, and older ones are brought up to the newest.

Beside support/golden/diagram_v1.json stands diagram_v1.means.json: the names, the numbers in SI and the results that
this file has. A golden file is never changed again once its version was released; a later release must read the same.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, ModelError
from blocks.cli import main
from blocks.model import diagram_grammar as g
from blocks.model import diagram_value, document, migrations
from blocks.model import study_grammar as s
from blocks.model.block_types import library_types
from blocks.model.flatten import BlockSource, InputSource, Source
from blocks.model.hierarchy import Hierarchy
from blocks.model.migrations import MigratedDocument
from blocks.model.resolver import resolver_of
from blocks.model.variants import taken
from blocks.studies import study
from blocks.text import json_text
from blocks.text.json_document import AT_KEY
from tests.support.places import SUPPORT

GOLDEN = SUPPORT / "golden"
DIAGRAMS = sorted(GOLDEN.glob("diagram_v?.json"))
STUDIES = sorted(GOLDEN.glob("study_v?.json"))


def means(path: Path) -> Any:
    """What a golden file must mean."""
    return json.loads(path.with_suffix(".means.json").read_text(encoding="utf-8"))


def plain(value: Any) -> Any:
    """A value as JSON has it: fractions and infinity as texts, arrays as lists."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, Fraction):
        return f"{value}"
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else repr(value)
    return value


def meaning_of_diagram(path: Path) -> dict[str, Any]:
    """Names, numbers in SI, and the results of the run that the file describes."""
    loaded = Diagram.load(path)
    flat = loaded.flatten()

    def source(one: Source) -> str:
        if isinstance(one, BlockSource):
            return f"{flat.blocks[one.block].path}.{one.variable}[{one.element}]"
        return f"input {one.element}" if isinstance(one, InputSource) else f"{one.value}"

    root = Hierarchy(taken(loaded.value), resolver_of(library_types()), {}).root
    results = loaded.run(engine="reference")
    return plain(  # type: ignore[no-any-return]
        {
            "name": flat.name,
            "parameters": {
                name: [value.value, value.unit, value.exact]
                for name, value in root.parameters.items()
                if value is not None
            },
            "inputs": {
                one.name: [list(one.shape), one.unit, one.type, one.default and one.default[0]] for one in flat.inputs
            },
            "outputs": flat.outputs,
            "blocks": {
                block.path: {
                    "type": block.interface.name,
                    "parameters": {key: value.value for key, value in block.resolved.values.items()},
                    "wires": {key: [source(one) for one in sources] for key, sources in block.sources.items()},
                }
                for block in flat.blocks
                if not block.hidden
            },
            "signals": {name: [list(one.shape), list(one.units), one.type] for name, one in flat.signals.items()},
            "enabled": [one.path for one in flat.enabled],
            "control": {name: entry.control for name, entry in loaded.value.blocks.items() if entry.control},
            "variants": {
                name: {key: [one.what, one.ports, one.options] for key, one in entry.variants.items()}
                for name, entry in loaded.value.blocks.items()
                if entry.variants
            },
            # What a file says; whether it says so is no part of its meaning.
            "run": {key: value for key, value in asdict(flat.settings).items() if key != "gives_rtol"},
            "log": flat.log,
            "measures": {one.name: asdict(one) for one in flat.measures},
            "layout": {name: [float(x) for x in place] for name, place in loaded.value.layout.items()},
            "kept": dict(loaded.value.extras),
            "results": {
                "times": [len(results.t), float(results.t[-1])],
                "end": {name: np.asarray(results[name])[-1].tolist() for name in results},
                "measures": dict(results.measures),
            },
        }
    )


def meaning_of_study(path: Path) -> dict[str, Any]:
    loaded = study.load(path)
    told = {key: getattr(loaded, key) for key in ("name", "title", "doc", "source", "assumed", "figures")}
    told |= {key: [asdict(one) for one in getattr(loaded, key)] for key in ("runs", "sweeps", "tunings", "claims")}
    made = study.run(loaded)
    return plain(told | {"verdicts": [[one.value, one.verdict] for one in made.verdicts], "is_fine": made.is_fine})  # type: ignore[no-any-return]


def same(made: Any, wanted: Any, place: str = "") -> None:
    """Equal, to the last digit; measured results to 1e-9, which other libraries of the machine may round."""
    if isinstance(wanted, dict):
        assert list(made) == list(wanted), place
        for key, item in wanted.items():
            same(made[key], item, f"{place}.{key}")
    elif isinstance(wanted, list) and isinstance(made, list):
        assert len(made) == len(wanted), place
        for index, item in enumerate(wanted):
            same(made[index], item, f"{place}.{index}")
    elif isinstance(wanted, float) and place.startswith((".results.", ".verdicts.")):
        assert made == pytest.approx(wanted, rel=1e-9, abs=1e-12, nan_ok=True), place
    else:
        assert (type(made), made) == (type(wanted), wanted), place


# --- golden files ----------------------------------------------------------------------------------------------


def test_there_is_a_golden_file_of_each_version() -> None:
    assert [path.name for path in DIAGRAMS] == [f"diagram_v{n}.json" for n in range(1, diagram_value.VERSION + 1)]
    assert [path.name for path in STUDIES] == [f"study_v{n}.json" for n in range(1, s.VERSION + 1)]
    for path in (*DIAGRAMS, *STUDIES):
        assert f'"version": {path.stem.partition("_v")[2]},' in path.read_text(encoding="utf-8")


def test_there_is_a_step_from_each_older_version() -> None:
    assert list(migrations.DIAGRAM) == list(range(1, diagram_value.PLAIN_VERSION)), "version 3 has something more alone"
    assert list(migrations.STUDY) == list(range(1, s.VERSION))


@pytest.mark.parametrize("path", DIAGRAMS, ids=lambda path: path.stem)
def test_a_golden_diagram_means_what_it_meant(path: Path) -> None:
    same(meaning_of_diagram(path), means(path))


def test_the_results_of_version_1_are_those_of_closed_forms() -> None:
    end = means(DIAGRAMS[0])["results"]["end"]
    at_half = 1 - math.exp(-0.5 / 0.25)  # a lag of 0.25 s under 1, from 0.5 s on under 2
    assert end["file.lag.y"] == pytest.approx(2 - (2 - at_half) * math.exp(-0.7 / 0.25), rel=1e-6)
    assert end["while_on.y"] == pytest.approx(5 + 0.25 + 0.25 + 0.2, rel=1e-12)  # the integral of 1 while it is on
    assert end["at_ticks.y"] == pytest.approx(3 * 1.15, rel=1e-12)  # the last tick before 1.2 s
    assert end["third"] == 1.0  # 1000 mV


@pytest.mark.long
@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_a_golden_study_means_what_it_meant(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BLOCKS_ENGINE", "reference")
    same(meaning_of_study(path), means(path))


def keys_of(value: Any) -> set[str]:
    if isinstance(value, dict):
        return set(value) | {key for item in value.values() for key in keys_of(item)}
    return {key for item in value for key in keys_of(item)} if isinstance(value, list) else set()


def test_the_newest_golden_files_use_every_key() -> None:
    text = DIAGRAMS[-1].read_text(encoding="utf-8")
    kinds = (g.DIAGRAM, g.BLOCK, g.VARIANT, g.QUANTITY, g.COLUMN, g.INPUT, g.RUN, g.ENABLE, g.TRIGGER, g.MEASURE)
    known = {key for kind in (*kinds, g.MASTER) for key in kind.keys}
    assert known <= keys_of(json.loads(text))
    for word in ("held", "reset", *g.TYPES, *g.INTERPOLATIONS):
        assert f'"{word}"' in text
    of_study = (s.STUDY, s.ONE_RUN, s.CLAIM, s.ASSUMED, s.FIGURE, s.PANEL, s.LINE, s.MARKER)
    known = {key for kind in of_study for key in kind.keys} - {"$schema"}
    assert known <= keys_of(json.loads(STUDIES[-1].read_text(encoding="utf-8")))


def test_the_newest_golden_files_are_canonical() -> None:
    for path, canonical in ((DIAGRAMS[-1], document.canonical), (STUDIES[-1], study.canonical)):
        text = path.read_text(encoding="utf-8")
        assert canonical(json_text.read(text))[0] == text


# --- an invented older version ---------------------------------------------------------------------------------

OLD = """{
 "format": "blocks-diagram", "version": 0,
 "name": "old",
 "sources": {"u": {"default": 2}},
 "nodes": {
  "g": {"type": "Gain", "parameters": {"k": 3}},
  "part": {"diagram": {"blocks": {}}}
 },
 "wires": {"g.u": "u"},
 "stop": {"value": 100, "unit": "ms"}, "every": 0.1,
 "x-own": 1
}
"""
NEW = """{
 "format": "blocks-diagram",
 "version": 2,
 "name": "old",
 "inputs": {
  "u": {"default": 2}
 },
 "blocks": {
  "g": {"type": "Gain", "parameters": {"k": 3}},
  "part": {
   "diagram": {}
  }
 },
 "wires": {
  "g.u": "u"
 },
 "run": {"stop": {"value": 100, "unit": "ms"}, "every": 0.1},
 "x-own": 1
}
"""


def from_0(draft: MigratedDocument) -> None:
    """Version 0 had other names for two sections, and the times of the run at the top."""
    draft.move(("sources",), ("inputs",))
    draft.move(("nodes",), ("blocks",))
    for key in ("stop", "every"):
        draft.move((key,), ("run", key))


@pytest.fixture
def version_0(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(migrations.DIAGRAM, 0, from_0)


def faults(text: str) -> list[tuple[str, tuple[str | int, ...], int, int]]:
    with pytest.raises(ModelError) as caught:
        Diagram.load(text).check() if text.endswith(".json") else Diagram.from_json(text).check()
    return [(fault.code, fault.path, fault.line, fault.column) for fault in caught.value.faults]


@pytest.mark.usefixtures("version_0")
def test_an_older_file_is_what_the_newest_version_says_of_it() -> None:
    old, new = Diagram.from_json(OLD), Diagram.from_json(NEW)
    assert old.value == new.value
    assert (old.value.version, new.value.version) == (0, 2)
    results = old.run(engine="reference")
    assert results["g.y"][-1] == 6.0
    assert results.t[-1] == 0.1


@pytest.mark.usefixtures("version_0")
def test_faults_of_an_older_file_point_into_its_text(tmp_path: Path) -> None:
    path = tmp_path / "old.json"
    text = OLD.replace('"k"', '"kk"').replace('"u": {"default": 2}', '"u": {"default": "2"}').replace('"ms"', '"kg"')
    path.write_text(text.replace('"x-own"', '"own"'), encoding="utf-8")
    lines = path.read_text(encoding="utf-8").splitlines()
    found = faults(str(path))
    assert {(code, path) for code, path, *_ in found} == {
        ("E004", ("inputs", "u", "default")),
        ("E003", ("own",)),
        ("E106", ("blocks", "g", "parameters", "kk")),
        ("E115", ("run", "stop")),
    }
    for _, place, line, column in found:
        rest = lines[line - 1][column - 1 :]
        wanted = {"default": '"2"', "own": '"own"', "kk": '"kk"', "stop": '{"value": 100'}[str(place[-1])]
        assert rest.startswith(wanted) or rest.startswith("3")


@pytest.mark.usefixtures("version_0")
def test_what_a_step_does_not_know_stays_and_is_told_where_it_stands() -> None:
    # The new name beside the old one, and an old section that is no object.
    assert faults(OLD.replace('"x-own"', '"inputs": {}, "x-own"')) == [
        ("E003", ("sources",), 4, 2),
        ("E105", ("wires", "g.u"), 9, 19),
    ]
    codes = [(code, path, line) for code, path, line, _ in faults(OLD.replace('"x-own"', '"run": 5, "x-own"'))]
    assert codes == [("E003", ("stop",), 10), ("E003", ("every",), 10), ("E004", ("run",), 11)]


@pytest.mark.usefixtures("version_0")
def test_check_warns_of_an_older_file_and_fmt_brings_it_up_to_date(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "old.json"
    path.write_text(OLD, encoding="utf-8")
    assert main(["check", str(path)]) == 0
    out = capsys.readouterr().out
    assert f"W103 {path}:2:41 version: the file has version 0; the newest version is 2." in out
    assert "0 errors, 1 warning" in out
    assert main(["fmt", "--check", str(path)]) == 1
    assert capsys.readouterr().out == f"{path}: is not canonical, of version 0\n"
    assert main(["rename", str(path), "g", "h"]) == 2
    assert f"blocks fmt {path}" in capsys.readouterr().err
    assert main(["fmt", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}: formatted, converted from version 0 to 2\n"
    assert path.read_text(encoding="utf-8") == NEW
    assert main(["check", str(path)]) == 0
    assert "W103" not in capsys.readouterr().out


@pytest.mark.usefixtures("version_0")
def test_a_subdiagram_file_may_be_older_than_the_file_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "old.json").write_text(OLD, encoding="utf-8")
    blocks = {name: {"diagram": "old.json"} for name in ("a", "b")}
    text = json.dumps({"format": "blocks-diagram", "version": 2, "blocks": blocks, "wires": {"a.u": "c.y"}})
    text = text.replace('{"a"', '{"c": {"type": "Sine"}, "a"')
    warnings = Diagram.from_json(text, folder=tmp_path).flatten().warnings
    assert [(one.code, one.line, Path(one.file).name) for one in warnings] == [("W103", 2, "old.json")]


def test_a_version_that_no_step_begins_at_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert faults(OLD) == [("E005", ("version",), 2, 41)]
    monkeypatch.setitem(migrations.DIAGRAM, 0, from_0)
    for version in ("-1", "0.5", "4", "true", '"0"', "1e300", "null"):
        assert ("E005", ("version",), 2, 41) in faults(OLD.replace('"version": 0', f'"version": {version}'))


def test_several_steps_follow_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(migrations.DIAGRAM, 0, from_0)
    monkeypatch.setitem(migrations.DIAGRAM, -1, lambda draft: draft.move(("cables",), ("wires",)))
    old = OLD.replace('"wires"', '"cables"').replace('"version": 0', '"version": -1')
    assert Diagram.from_json(old).value == Diagram.from_json(NEW).value
    text = old.replace('"g.u": "u"', '"g.u": "w"')
    assert faults(text) == [("E105", ("wires", "g.u"), 9, 20)]


def test_a_study_of_an_older_version_is_read_as_well(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    text = STUDIES[0].read_text(encoding="utf-8")
    old = text.replace('"version": 1', '"version": 0').replace('"assumed"', '"assumptions"')
    monkeypatch.setitem(migrations.STUDY, 0, lambda draft: draft.move(("assumptions",), ("assumed",)))
    path = tmp_path / "study.json"
    path.write_text(old, encoding="utf-8")
    assert study.load(path).assumed == study.load(STUDIES[0]).assumed
    assert study.canonical(json_text.read(old)) == (text, 0)


def test_a_draft_keeps_the_order_of_keys_and_all_places() -> None:
    text = '{"a": 1, "b": {"c": [2, {"d": 3}]}, "e": 4}'
    draft = MigratedDocument(json_text.read(text))
    was = dict(draft.places)
    draft.move(("b",), ("z",))
    assert json.dumps(draft.value, default=float) == '{"a": 1.0, "z": {"c": [2.0, {"d": 3.0}]}, "e": 4.0}'
    draft.move(("z", "c"), ("new", "deep", "c"))
    assert draft.value == {"a": 1, "z": {}, "e": 4, "new": {"deep": {"c": [2, {"d": 3}]}}}
    assert draft.places[("new", "deep", "c", 1, "d")] == was[("b", "c", 1, "d")]
    assert draft.places[("new", "deep", "c", AT_KEY)] == (1, text.index('"c"') + 1)
    assert draft.places[("new",)] == was[("b", "c")]
    before = (json.dumps(draft.value), dict(draft.places))
    for old, new in [
        (("none",), ("f",)),
        (("none",), ("g", "f")),
        (("a",), ("e",)),
        (("a",), ("e", "f")),
        (("a", "b"), ("c",)),
    ]:
        draft.move(old, new)
    assert (json.dumps(draft.value), draft.places) == before
    assert json_text.read(text).value["b"]["c"][1] == {"d": 3}, "the document that was read stays"
