"""The JSON Schema of diagram and study files, by the package jsonschema: what the readers take is valid, and what they
refuse for its structure is not.
"""

from __future__ import annotations

import copy
import json
import random
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from jsonschema import Draft202012Validator

from blocks import Diagram, ModelError
from blocks.cli import main
from blocks.contract.expressions import FUNCTIONS
from blocks.contract.variables import REQUIRED
from blocks.library import LIBRARY
from blocks.model import diagram_grammar as g
from blocks.model import study_grammar as s
from blocks.model.block_types import library_types
from blocks.model.diagram_value import BASE
from blocks.model.document import dumps, from_document, load, loads
from blocks.model.fingerprint import fingerprint
from blocks.model.flatten import flatten
from blocks.model.hierarchy import Hierarchy
from blocks.model.resolver import resolver_of
from blocks.model.settings import read_settings
from blocks.model.values import value_of
from blocks.model.variants import taken
from blocks.studies import json_schema, study
from blocks.studies.study_sweeps import ManyRuns
from blocks.text.errors import BlocksError
from blocks.text.units import parse
from tests.support.documents import CONTROLLED, NESTED, SHIPPED, STUDY, diagrams, document, mutated
from tests.support.library_variants import VARIANTS
from tests.support.samples import FENCE, PAGES, ROOT

STUDIES = sorted(path for path in (ROOT / "diagrams").rglob("*.json") if path not in SHIPPED)
STRUCTURE = {"E003", "E004", "E005", "E006", "E009", "E111"}
"""The codes of faults that a schema sees: kinds of values, keys, the header, names."""

OF = {kind: Draft202012Validator(json.loads(json_schema.text_of(kind, LIBRARY))) for kind in json_schema.KINDS}


def kind_of(source: Any) -> str:
    return "study" if isinstance(source, dict) and source.get("format") == s.FORMAT else "diagram"


def faults(source: Any, kind: str = "") -> list[str]:
    """What the schema says against a document."""
    errors = OF[kind or kind_of(source)].iter_errors(source)
    return [f"{'.'.join(map(str, error.absolute_path))}: {error.message[:300]}" for error in errors]


def with_parts(path: tuple[Any, ...], value: Any, source: Any) -> Any:
    """The document with one part replaced; ... takes it out."""
    made = copy.deepcopy(source)
    node = made
    for step in path[:-1]:
        node = node[step]
    if value is ...:
        del node[path[-1]]
    else:
        node[path[-1]] = value
    return made


# --- the schema itself -----------------------------------------------------------------------------------------


def path_of(kind: str) -> Path:
    """Return the file of a schema that ships; its name holds the version of the format."""
    (path,) = (ROOT / "blocks" / "schemas").glob(f"{kind}-*.schema.json")
    return path


@pytest.mark.parametrize("kind", json_schema.KINDS)
def test_the_files_that_ship_are_what_the_tables_make(kind: str) -> None:
    path = path_of(kind)
    cure = f"python -m blocks schema {kind} -o {path.relative_to(ROOT)}"
    assert path.read_text(encoding="utf-8") == json_schema.text_of(kind, LIBRARY), cure


def schemas(node: Any) -> Iterator[dict[str, Any]]:
    """Every schema within a schema."""
    if not isinstance(node, dict):
        return
    yield node
    for word in ("properties", "patternProperties", "$defs", "dependentSchemas"):
        for inner in node.get(word, {}).values():
            yield from schemas(inner)
    for word in ("anyOf", "oneOf", "allOf"):
        for inner in node.get(word, []):
            yield from schemas(inner)
    for word in ("items", "additionalProperties", "propertyNames", "if", "then", "else", "not"):
        yield from schemas(node.get(word))


@pytest.mark.parametrize("kind", json_schema.KINDS)
def test_a_schema_is_one_by_its_metaschema_and_has_no_word_that_means_nothing(kind: str) -> None:
    made = json.loads(path_of(kind).read_text(encoding="utf-8"))
    Draft202012Validator.check_schema(made)
    assert made["$schema"] == json_schema.DIALECT
    known = {"$schema", "$defs", "$ref", "title", "description", "default", "examples", "type", "enum", "const"}
    known |= {"properties", "patternProperties", "additionalProperties", "propertyNames", "required", "items"}
    known |= {"anyOf", "oneOf", "allOf", "not", "if", "then", "else", "dependentRequired", "pattern", "minLength"}
    known |= {"dependentSchemas"}
    known |= {"maxLength", "minItems", "maxItems", "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"}
    known |= {"minProperties", "maxProperties"}
    for node in schemas(made):
        assert set(node) <= known
        if "$ref" in node:
            assert node["$ref"].removeprefix("#/$defs/") in made["$defs"]
        if "properties" in node and "if" not in node:
            assert set(node.get("required", ())) <= set(node["properties"]) | {"parameters"}


@pytest.mark.parametrize("kind", json_schema.KINDS)
def test_editors_have_something_to_show_for_every_key(kind: str) -> None:
    made = json.loads(path_of(kind).read_text(encoding="utf-8"))
    for node in schemas(made):
        if node.get("additionalProperties") is False:
            for key, entry in node["properties"].items():
                shown = entry if "description" in entry else made["$defs"][entry["$ref"].removeprefix("#/$defs/")]
                assert shown["description"], key


def test_defaults_are_valid() -> None:
    made = json_schema.diagram_schema(LIBRARY)
    count = 0
    for node in schemas(made):
        if "default" in node:
            own = Draft202012Validator(node | {"$defs": made["$defs"]})
            assert not list(own.iter_errors(node["default"])), node
            count += 1
    assert count > 150


def test_units_and_functions_that_it_names_are_there() -> None:
    defs = json_schema.diagram_schema({})["$defs"]
    for unit in defs["unit"]["examples"]:
        parse(unit)
    assert all(name in defs["expression"]["description"] for name in FUNCTIONS)


# --- what is valid ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", [*SHIPPED, *STUDIES], ids=lambda path: str(path.relative_to(ROOT)))
def test_what_ships_is_valid(path: Path) -> None:
    assert faults(json.loads(path.read_text(encoding="utf-8"))) == []


def test_the_samples_of_the_pages_are_valid() -> None:
    count = 0
    for page in PAGES:
        for match in FENCE.finditer(page.read_text(encoding="utf-8")):
            if match["kind"].endswith("json") and '"format": "blocks-' in match["body"]:
                made = json.loads(match["body"])
                is_broken = kind_of(made) == "diagram" and not judged(made, ROOT)[0]  # one that shows what is told
                assert is_broken or faults(made) == [], (page.name, match["body"])
                count += 1
    assert count > 15


def test_every_key_has_a_valid_form(tmp_path: Path) -> None:
    assert faults(CONTROLLED) == []
    Diagram.from_json(CONTROLLED).check()
    assert faults(STUDY) == []
    path = tmp_path / "s.json"
    path.write_text(json.dumps(STUDY))
    study.load(path)

    def keys(node: Any) -> Iterator[str]:
        if isinstance(node, (dict, list)):
            for key in node:
                yield from [key] if isinstance(node, dict) else []
                yield from keys(node[key] if isinstance(node, dict) else key)

    known = {key for kind in (g.DIAGRAM, g.BLOCK, g.VARIANT, g.INPUT, g.RUN, g.MEASURE) for key in kind.keys}
    assert {*known, *g.TABLE} - {"fmu", *g.OPTIONS} <= set(keys(CONTROLLED))
    of_study = (s.STUDY, s.ONE_RUN, s.CLAIM, s.FIGURE, s.PANEL, s.MARKER, s.ONE_SWEEP, s.ONE_TUNING, s.MARGIN,
                s.SWEEP_FIGURE)
    assert {key for kind in of_study for key in kind.keys} <= set(keys(STUDY))


def test_fmus_are_valid_with_any_parameters() -> None:
    entry = {
        "fmu": "../x.fmu",
        "kind": "ME",
        "isolate": True,
        "timeout": 1e6,
        "parameters": {"body.m[1]": 1, "der(x)": 2},
    }
    made = document(blocks={"m": entry, "n": {"type": "Gain", "variants": {"fmu": entry | {"ports": {"y": "a.b"}}}}})
    assert faults(made) == []
    from_document(made)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(diagrams)
def test_every_random_diagram_is_valid_in_its_canonical_form(body: dict[str, Any]) -> None:
    assert faults(json.loads(dumps(from_document(document(**body))))) == []


# --- what is not -----------------------------------------------------------------------------------------------

BLOCKS = ("blocks",)
BROKEN = [
    (("format",), "blocks", "E006"),
    (("format",), ..., "E009"),
    (("version",), ..., "E009"),
    (("version",), 4, "E005"),
    (("version",), True, "E005"),
    (("$schema",), 5, "E004"),
    (("name",), "two words", "E111"),
    (("name",), None, "E111"),
    (("name",), "a" * 201, "E111"),
    (("doc",), 5, "E004"),
    (("doc",), [1], "E004"),
    (("blokcs",), {}, "E003"),
    (("parameters",), [], "E004"),
    (("parameters", "2k"), 1, "E111"),
    (("parameters", "k"), None, "E004"),
    (("parameters", "k"), {"unit": "V"}, "E009"),
    (("parameters", "k"), {"value": {"value": 1}}, "E004"),
    (("parameters", "k"), {"value": 1, "unit": 5}, "E004"),
    (("parameters", "k"), {"value": 1, "units": "V"}, "E003"),
    (("parameters", "k"), [1, None], "E004"),
    (("parameters", "k"), [1, True], "E004"),
    (("parameters", "k"), [[True]], "E004"),
    (("parameters", "k"), {"csv": "a.csv"}, "E009"),
    (("parameters", "k"), {"csv": 5, "column": "a"}, "E004"),
    (("parameters", "k"), {"csv": "a.csv", "column": "a", "value": 1}, "E003"),
    (("inputs", "r"), "V", "E004"),
    (("inputs", "r", "unit"), 5, "E004"),
    (("inputs", "r", "default"), "1", "E004"),
    (("inputs", "r", "default"), True, "E004"),
    (("inputs", "go", "default"), 1, "E004"),
    (("inputs", "go", "unit"), "V", "E004"),
    (("inputs", "count", "default"), 1.5, "E004"),
    (("inputs", "r", "size"), 0, "E004"),
    (("inputs", "r", "size"), 1.5, "E004"),
    (("inputs", "r", "size"), 1e9, "E004"),
    (("inputs", "r", "type"), "enum", "E004"),
    (("inputs", "r", "default"), ["1", 2], "E004"),
    (("inputs", "r", "size"), [], "E004"),
    (("inputs", "r", "size"), [2, 1.5], "E004"),
    (("inputs", "r", "size"), [[2]], "E004"),
    (("inputs", "r", "default"), [["1", 2]], "E004"),
    (("inputs", "count", "default"), [3], "E004"),
    (("inputs", "mode", "default"), 1, "E004"),
    (("inputs", "mode", "unit"), "V", "E004"),
    (("inputs", "mode", "type"), {"enum": "Mode"}, "E004"),
    (("inputs", "mode", "type"), {"enum": "Mode", "members": {}}, "E004"),
    (("inputs", "mode", "type"), {"enum": "", "members": {"a": 1}}, "E004"),
    (("inputs", "mode", "type"), {"enum": "Mode", "members": {"a": 1.5}}, "E004"),
    (("inputs", "mode", "type"), {"enum": "Mode", "members": {"": 1}}, "E004"),
    (("inputs", "mode", "type"), {"enum": "Mode", "members": {"off": 0}, "value": 1}, "E003"),
    (("outputs", "y"), 5, "E004"),
    (("outputs", "a.b"), "sine.y", "E111"),
    (("blocks",), 5, "E004"),
    (("blocks", "sine"), 5, "E004"),
    (("blocks", "sine"), {}, "E009"),
    (("blocks", "a b"), {"type": "Sine"}, "E111"),
    (("blocks", "sine", "fmu"), "a.fmu", "E003"),
    (("blocks", "sine", "type"), "", "E004"),
    (("blocks", "sine", "type"), 5, "E004"),
    (("blocks", "sine", "typ"), "Sine", "E003"),
    (("blocks", "sine", "kind"), "CS", "E003"),
    (("blocks", "sine", "enable"), {}, "E003"),
    (("blocks", "sine", "ports"), {}, "E003"),
    (("blocks", "sine", "doc"), 1, "E004"),
    (("blocks", "sine", "parameters"), [], "E004"),
    (("blocks", "sine", "parameters", "omega"), None, "E004"),
    (("blocks", "sine"), {"fmu": "http://x/a.fmu"}, "E007"),
    (("blocks", "sine"), {"fmu": "\\\\host\\a.fmu"}, "E007"),
    (("blocks", "sine"), {"diagram": "http://x/a.json"}, "E007"),
    (("blocks", "sine"), {"fmu": "a.fmu", "kind": "cs"}, "E004"),
    (("blocks", "sine"), {"fmu": "a.fmu", "isolate": 1}, "E004"),
    (("blocks", "sine"), {"fmu": "a.fmu", "timeout": 0}, "E004"),
    (("blocks", "sine"), {"fmu": "a.fmu", "timeout": 1e7}, "E004"),
    (("blocks", "sum", "diagram", "version"), 1, "E003"),
    (("blocks", "sum", "diagram", "blocks", "x y"), {"type": "Gain"}, "E111"),
    (("blocks", "sum", "enable", "states"), "kept", "E004"),
    (("blocks", "sum", "enable"), True, "E004"),
    (("blocks", "sum", "trigger"), {"every": 1}, "E003"),
    (("blocks", "edges", "trigger"), {}, "E009"),
    (("blocks", "edges", "trigger", "every"), 1, "E009"),
    (("blocks", "edges", "trigger", "offset"), 1, "E003"),
    (("blocks", "edges", "trigger", "direction"), "rising", "E004"),
    (("blocks", "plant", "variant"), 1, "E004"),
    (("blocks", "plant", "variants", "base"), {"type": "Gain"}, "E109"),
    (("blocks", "plant", "variants", "rough", "variant"), "x", "E003"),
    (("blocks", "plant", "variants", "rough", "ports", "u"), 5, "E004"),
    (("wires", "on.u"), ["sine.y"], "E004"),
    (("wires",), [], "E004"),
    (("run", "stopp"), 1, "E003"),
    (("run", "doc"), 1, "E004"),
    (("run", "stop"), "5 s", "E115"),
    (("run", "stop"), {"value": 5, "units": "s"}, "E115"),
    (("run", "method"), "RK4", "E115"),
    (("run", "rtol"), 1, "E115"),
    (("run", "every"), 0, "E115"),
    (("run", "stops"), 5, "E115"),
    (("run", "loops"), "ignore", "E115"),
    (("run", "log"), "y", "E115"),
    (("run", "inputs"), [], "E004"),
    (("run", "inputs", "r"), "1", "E004"),
    (("run", "inputs", "r"), {"t": [0, 1]}, "E009"),
    (("run", "inputs", "r"), {"t": [0, 1], "u": [0, "1"]}, "E004"),
    (("run", "inputs", "r", "interpolation"), "cubic", "E004"),
    (("run", "inputs", "r", "v"), 1, "E003"),
    (("run", "master"), 5, "E004"),
    (("run", "master", "setp"), 1, "E003"),
    (("run", "master", "order"), 3, "E115"),
    (("run", "master", "steps", "sine"), 0, "E115"),
    (("measures", "m", "of"), ..., "E009"),
    (("measures", "m", "of"), 5, "E004"),
    (("measures", "m", "type"), "IEA", "E116"),
    (("measures", "m", "unit"), "V", "E003"),
    (("measures", "m", "doc"), 1, "E004"),
    (("measures", "m", "from"), "begin", "E116"),
    (("layout", "sine"), [1], "E004"),
    (("layout", "sine"), [1, "2"], "E004"),
]  # fmt: skip


@pytest.mark.parametrize(("path", "value", "code"), BROKEN, ids=lambda item: str(item)[:40])
def test_what_is_broken_is_refused_by_the_reader_and_by_the_schema(
    path: tuple[Any, ...], value: Any, code: str
) -> None:
    made = with_parts(path, value, CONTROLLED)
    assert faults(made) != []
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(made).check()
    assert code in {fault.code for fault in caught.value.faults}, str(caught.value)


@pytest.mark.parametrize("made", [[], "text", 5, None, True])
def test_what_is_no_object_is_no_diagram(made: Any) -> None:
    assert faults(made) != []


CLAIM = ("claims", 0)
PANEL = ("figures", 0, "panels", 0)
BROKEN_STUDIES = [
    (("format",), "blocks-diagram", "E006"),
    (("version",), True, "E005"),
    (("version",), ..., "E009"),
    (("$schema",), 5, "E004"),
    (("name",), "../../x", "E111"),
    (("title",), 5, "E004"),
    (("cliams",), [], "E003"),
    (("runs",), [], "E004"),
    (("runs", "a b"), {"diagram": "d.json"}, "E111"),
    (("runs", "a"), 5, "E004"),
    (("runs", "a", "diagram"), ..., "E009"),
    (("runs", "a", "diagram"), "", "E009"),
    (("runs", "a", "parameters"), [], "E004"),
    (("runs", "a", "parameters", "k"), None, "E004"),
    (("runs", "a", "parameters", "k"), {"csv": "a.csv", "column": "a"}, "E004"),
    (("runs", "a", "variants", "m"), 1, "E004"),
    (("runs", "a", "settings", "engine"), "native", "E003"),
    (("runs", "a", "settings", "inputs"), "a.csv", "E004"),
    (("runs", "a", "settings", "inputs", "u"), {"t": [0], "u": ["1"]}, "E004"),
    (("assumed", 0, "who"), "x", "E003"),
    (("assumed", 0, "what"), 1, "E004"),
    (("claims",), {}, "E004"),
    ((*CLAIM, "measure"), ..., "E009"),
    ((*CLAIM, "run"), 5, "E004"),
    ((*CLAIM, "run"), ..., "E009"),
    ((*CLAIM, "runs"), ["a", "b"], "E009"),
    ((*CLAIM, "as"), "increase", "E004"),
    ((*CLAIM, "published"), None, "E004"),
    ((*CLAIM, "published"), 0, "E004"),
    ((*CLAIM, "published"), ..., "E009"),
    ((*CLAIM, "tolerance"), 1.5, "E004"),
    ((*CLAIM, "tolerance"), ..., "E009"),
    ((*CLAIM, "expect"), "", "E004"),
    ((*CLAIM, "expect"), ..., "E009"),
    ((*CLAIM, "reason"), ..., "E009"),
    ((*CLAIM, "reason"), "", "E009"),
    (("claims", 1, "runs"), ["a"], "E009"),
    (("claims", 1, "as"), ..., "E004"),
    (("claims", 1, "as"), "decrease", "E004"),
    (("figures", 0, "name"), ..., "E111"),
    (("figures", 0, "name"), "../f", "E111"),
    (("figures", 0, "kind"), "bode", "E004"),
    (("figures", 0, "from"), None, "E004"),
    (("figures", 0, "panels"), ..., "E009"),
    (("figures", 0, "panels"), [], "E009"),
    (("figures", 0, "windows"), [[0]], "E004"),
    ((*PANEL, "lines"), [], "E009"),
    ((*PANEL, "band"), 5, "E004"),
    ((*PANEL, "inset"), [0, 1], "E004"),
    ((*PANEL, "log"), 1, "E004"),
    ((*PANEL, "height"), 0, "E004"),
    ((*PANEL, "lines", 0, "signal"), ..., "E009"),
    ((*PANEL, "lines", 0, "run"), ..., "E009"),
    ((*PANEL, "lines", 0, "style"), 6, "E004"),
    ((*PANEL, "lines", 0, "style"), True, "E004"),
    ((*PANEL, "lines", 0, "x"), 1, "E003"),
    ((*PANEL, "markers", 0, "y"), ..., "E009"),
    ((*PANEL, "markers", 1, "signal"), ..., "E009"),
]  # fmt: skip


@pytest.mark.parametrize(("path", "value", "code"), BROKEN_STUDIES, ids=lambda item: str(item)[:40])
def test_a_broken_study_is_refused_by_the_reader_and_by_the_schema(
    path: tuple[Any, ...], value: Any, code: str, tmp_path: Path
) -> None:
    made = with_parts(path, value, STUDY)
    assert faults(made, "study") != []
    file = tmp_path / "s.json"
    file.write_text(json.dumps(made), encoding="utf-8")
    with pytest.raises(ModelError) as caught:
        study.load(file)
    # Where no run can be read, none is there.
    assert {fault.code for fault in caught.value.faults} - {"E105"} == {code}, str(caught.value)


# --- the two judges on random files ----------------------------------------------------------------------------


def judged(source: dict[str, Any], folder: Path) -> tuple[bool, set[str]]:
    """Whether a diagram has no fault, whichever variants are taken, and the codes of its faults."""
    try:
        value = loads(json.dumps(source), folder=folder)
        flatten(value, resolver_of(LIBRARY))
        for name, entry in value.blocks.items():
            for choice in (BASE, *entry.variants) if entry.variants else ():
                flatten(taken(value, {name: choice}), resolver_of(LIBRARY))
    except BlocksError as error:
        # Which input has members, and which, so that a text may be its value, is more than a schema can know.
        told = {fault: f"{fault.place}: {fault.message}" for fault in error.faults}
        beyond = {fault for fault in told if re.match(r"(run\.)?inputs\..*(not a text|one of|in a list)", told[fault])}
        return False, {fault.code for fault in error.faults if fault not in beyond}
    return True, set()


def judged_study(source: dict[str, Any], folder: Path) -> tuple[bool, set[str]]:
    """The same of a study, with the values that its runs would read; "" stands for a fault of these."""
    path = folder / "s.json"
    path.write_text(json.dumps(source), encoding="utf-8")
    try:
        made = study.load(path)
        for run in made.all_runs:
            tables = [run.parameters, *(run.scenarios.values() if isinstance(run, ManyRuns) else ())]
            for raw in (raw for table in tables for raw in table.values()):
                value_of(raw, "", {})
            if read_settings(run.settings)[1]:
                return False, {""}
    except BlocksError as error:
        return False, {fault.code for fault in error.faults}
    return True, set()


@pytest.mark.long
@pytest.mark.parametrize("part", range(2))
def test_random_faults_are_judged_alike_by_the_reader_and_by_the_schema(part: int, tmp_path: Path) -> None:
    of_diagrams = [(json.loads(path.read_text(encoding="utf-8")), path.parent) for path in SHIPPED]
    of_diagrams += [(source, tmp_path) for source in (json.loads(NESTED), CONTROLLED)] * 8
    of_studies = [(source, tmp_path) for source in (STUDY, STUDY, json.loads(STUDIES[0].read_text(encoding="utf-8")))]
    count = {True: 0, False: 0}
    for seed in range(part * 300, (part + 1) * 300):
        chance = random.Random(seed)
        is_study = chance.random() < 0.3
        source, folder = chance.choice(of_studies if is_study else of_diagrams)
        made = mutated(source, chance)
        is_good, codes = (judged_study if is_study else judged)(made, folder)
        told = faults(made, "study" if is_study else "diagram")
        if is_good:
            assert told == [], (seed, told)
        elif codes & STRUCTURE:
            assert told != [], (seed, codes)
        count[bool(told)] += 1
    assert min(count.values()) > 40


# --- block types -----------------------------------------------------------------------------------------------

VALUES: list[Any] = [
    0, 1, 2, -1, 0.5, 2**53 + 2, "", "abc", "=k", "=w", "=t", "=f", "==x", "+-", "linear", "<", True, [], [1], [0, 2.5],
    [True], [True, False], ["=k"], ["abc"], [[1]], [[1, 0], [0, 1]], [[True]], {"value": 1}, {"value": 1, "unit": "V"},
    {"value": -1, "unit": "s"}, {"value": "=k", "x-a": 1}, {"value": "linear"}, {"value": True}, {"value": [1, 2]},
    {"value": "=t"}, {"value": "=f", "unit": "", "doc": "d"},
]  # fmt: skip


def of_kinds() -> list[tuple[str, str]]:
    """A block type and a parameter for each kind of parameter that there is."""
    found: dict[Any, tuple[str, str]] = {}
    for name, cls in LIBRARY.items():
        for key, p in cls.declaration.parameters.items():
            unit = p.unit if isinstance(p.unit, str) else callable
            default = REQUIRED if p.default is REQUIRED else callable(p.default)
            limits = (p.min is None, p.max is None, p.positive, bool(p.choices))
            found.setdefault((p.type, p.structural, p.shape == (), unit in ("", "1"), default, *limits), (name, key))
    return [*found.values()]


@pytest.mark.parametrize(("name", "key"), of_kinds())
def test_what_a_block_type_takes_as_a_parameter_is_valid(name: str, key: str) -> None:
    parameters = LIBRARY[name].declaration.parameters
    needed = next(given for other, given in VARIANTS if other == name)  # what it cannot do without
    needed = {other: value for other, value in needed.items() if parameters[other].default in (REQUIRED, None)}
    needed = {**{other: 1 for other, p in parameters.items() if p.default is REQUIRED}, **needed}
    choices = parameters[key].choices or ("linear",)
    taken = refused = 0
    for value in [*VALUES, *choices]:
        block = {"type": name, "parameters": {**needed, key: value}}
        made = document(parameters={"k": 1, "w": [1, 2], "t": choices[-1], "f": True}, blocks={"b": block})
        try:
            Hierarchy(from_document(made), resolver_of(LIBRARY), {}).faults.check()
        except ModelError:
            refused += bool(faults(made))
            continue
        assert faults(made) == [], value
        taken += 1
    assert taken > 0
    assert refused > 5


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ({"type": "PMDCMotor", "parameters": {"Raa": 1}}, "'Raa'"),
        ({"type": "PMDCMotor", "parameters": {"Ra": True}}, "True is not valid"),
        ({"type": "PMDCMotor", "parameters": {"La": 0}}, "0 is not valid"),
        ({"type": "PMDCMotor", "parameters": {"Ra": "0.2"}}, "'0.2' is not valid"),
        ({"type": "Compare", "parameters": {"operator": "=="}}, ""),
        ({"type": "Compare", "parameters": {"operator": "!"}}, "'!' is not valid"),
        ({"type": "Mux", "parameters": {"size": 1.5}}, "1.5 is not valid"),
        ({"type": "UnitDelay"}, "'parameters' is a required"),
        ({"type": "UnitDelay", "parameters": {}}, "'period' is a required"),
        ({"type": "TransferFunction", "parameters": {"num": "1 2"}}, "'1 2' is not valid"),
        ({"type": "Acme", "parameters": {"anything": 1}}, ""),
    ],
)
def test_the_parameters_of_a_known_type_are_checked_and_other_types_are_left_alone(
    block: dict[str, Any], said: str
) -> None:
    told = faults(document(blocks={"b": block}))
    assert (said in " ".join(told)) if said else told == []


def test_what_a_type_is_stands_beside_its_name() -> None:
    known = json_schema.diagram_schema(LIBRARY)["$defs"]["block"]["properties"]["type"]["anyOf"]
    shown = {entry["const"]: entry["description"] for entry in known if "const" in entry}
    assert set(shown) == set(LIBRARY)
    assert shown["PMDCMotor"].splitlines()[1:] == ["Inputs: v [V], tau [N.m]", "Outputs: omega [rad/s], i [A]"]
    assert "Inputs: u1, ..." in shown["Mux"]


# --- $schema in files ------------------------------------------------------------------------------------------


def test_a_file_that_names_its_schema_keeps_it_first_and_means_the_same(tmp_path: Path) -> None:
    plain = Diagram.from_json(document(blocks={"g": {"type": "Sine"}}))
    path = tmp_path / "d.json"
    path.write_text(json.dumps({"format": "blocks-diagram", "version": 3, "$schema": "./s.json", "name": "d",
                                "blocks": {"g": {"type": "Sine"}}}), encoding="utf-8")  # fmt: skip
    made = Diagram.load(path)
    assert made.dumps() == plain.dumps().replace("{", '{\n "$schema": "./s.json",', 1)
    assert fingerprint(made.value) == fingerprint(plain.value)
    made.save(path)
    assert load(path) == made.value
    (tmp_path / "deep").mkdir()
    made.save(tmp_path / "deep" / "d.json")
    assert json.loads((tmp_path / "deep" / "d.json").read_text())["$schema"] == "../s.json"


@pytest.mark.parametrize("url", ["https://nowhere.invalid/s.json", "file:///s.json", "/s.json", "#", "", "a b"])
def test_where_a_schema_is_said_to_be_is_never_looked_at(url: str, tmp_path: Path) -> None:
    made = Diagram.from_json({"$schema": url, **document()}, folder=tmp_path)
    made.check()
    made.save(tmp_path / "d.json")
    assert json.loads((tmp_path / "d.json").read_text())["$schema"] == url


def test_only_a_whole_file_names_a_schema() -> None:
    with pytest.raises(ModelError, match="E003"):
        from_document(document(blocks={"s": {"diagram": {"$schema": "a"}}}))
    inner = Diagram.from_json({"$schema": "a", **document()})
    outer = Diagram("outer")
    from blocks import subdiagram

    outer.add("s", subdiagram(inner))
    assert "$schema" not in outer.dumps()
    assert faults(outer.to_json()) == []


# --- the command -----------------------------------------------------------------------------------------------


def test_the_command_prints_what_ships_or_writes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert library_types() == LIBRARY
    for kind in json_schema.KINDS:
        assert main(["schema", kind]) == 0
        assert capsys.readouterr().out == path_of(kind).read_text(encoding="utf-8")
    out = tmp_path / "s.json"
    assert main(["schema", "-o", str(out)]) == 0
    assert capsys.readouterr().out == f"{out}\n"
    assert out.read_bytes() == path_of("diagram").read_bytes()
    assert main(["schema", "stdy"]) == 2
    assert main(["schema", "-o", str(tmp_path / "missing" / "s.json")]) == 2


OWN = '''
"""Own blocks."""
import enum
from blocks import Block, Input, Parameter, output


class Mode(enum.IntEnum):
    slow = 1
    fast = 2


class Acme(Block):
    """y = k u, größer."""

    k = Parameter(1.0, doc="gain", unit="rpm", min=0)
    top = Parameter(1e300, doc="hardly an end")
    mode = Parameter(2, type=Mode)
    gains = Parameter([1.0], shape="n")
    is_on = Parameter(False, type="bool")
    u = Input()

    @output
    def y(u, k):
        return k * u
'''


def test_own_types_are_known_with_their_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "own_blocks_of_schema.py").write_text(OWN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert main(["schema", "--library", "own_blocks_of_schema"]) == 0
    text = capsys.readouterr().out
    assert text.isascii()
    made = json.loads(text)
    Draft202012Validator.check_schema(made)
    judge = Draft202012Validator(made)
    assert "größer" in json.dumps(made, ensure_ascii=False)

    def is_valid(**parameters: Any) -> bool:
        return judge.is_valid(document(blocks={"a": {"type": "Acme", "parameters": parameters}}))

    assert is_valid(k=-5e-324, top=3, mode="fast", gains=[1, "=2"], is_on=True)
    assert not is_valid(K=1)
    assert not is_valid(k=True)
    assert not is_valid(is_on=1)
    assert re.search(r'"Acme"', text)
