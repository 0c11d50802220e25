"""The kit of small models: imported from every form of file, and simulated as Simulink's documentation says."""

from __future__ import annotations

import math
import random
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from blocks import Diagram, from_simulink
from blocks.simulink import System
from blocks.text.errors import BlocksError, ModelError
from tests.support.simulink_files import FORMS, block, line, mdl_text, model, packed, parts_of, system
from tests.support.simulink_kit import CASES, EVERY, REFUSED, SIDS, Case

TIGHT = {"rtol": 1e-10, "atol": 1e-12, "every": EVERY}
LEFT = pytest.mark.xfail(
    strict=True, reason="before its first run, outputs are those at the start, and the report tells it"
)
BEFORE = {"enabled before its first run", *(f"triggered subsystem {way}" for way in ("rising", "falling", "either"))}
every_case = pytest.mark.parametrize(
    "one", [pytest.param(one, id=one.name, marks=[LEFT] if one.name in BEFORE else []) for one in CASES]
)


def written(one: Case, form: str, folder: Path) -> tuple[Path, list[Path]]:
    """Write a model, those beside it, and its workspaces."""
    folder.mkdir(exist_ok=True)
    for other in one.beside:
        FORMS[form](other, folder)
    for name, text in one.files.items():
        (folder / name).write_text(text)
    return FORMS[form](one.drawn, folder), [folder / name for name in one.files]


@every_case
def test_a_model_runs_as_its_documentation_says(one: Case, tmp_path: Path) -> None:
    documents = {}
    for form in FORMS:
        path, workspace = written(one, form, tmp_path / form.replace(" ", "_"))
        diagram, report = from_simulink(path, workspace)
        assert report.is_whole, report
        assert one.told in str(report)
        documents[form] = diagram.to_json()
    assert all(document == documents["mdl"] for document in documents.values())
    diagram.check()
    compare(one, diagram, "reference")


def compare(one: Case, diagram: Diagram, engine: str) -> None:
    results = diagram.run(engine=engine, **{**TIGHT, **one.run})
    np.testing.assert_allclose(results["out1"], one.witness(results.t), rtol=one.tolerance, atol=one.tolerance)


@pytest.mark.parametrize("one", [pytest.param(one, id=one.name, marks=[] if k % 16 == 0 else [pytest.mark.long])
                                 for k, one in enumerate(CASES) if one.name not in BEFORE])  # fmt: skip
def test_compiled_code_gives_the_same(one: Case, tmp_path: Path, native: None) -> None:
    path, workspace = written(one, "mdl", tmp_path)
    compare(one, from_simulink(path, workspace).diagram, "native")


@pytest.mark.parametrize("name", REFUSED)
def test_the_report_and_check_name_what_has_no_equal(name: str, tmp_path: Path) -> None:
    inside, piece = REFUSED[name]
    diagram, report = from_simulink(FORMS["split"](model("some", inside), tmp_path))
    missing = [*report.of("left out"), *report.of("unknown")]
    assert [entry.path for entry in missing] == ["Merge" if name.startswith("merge") else "b"]
    assert piece in str(report)
    assert missing[0].cure or missing[0].kind == "left out"
    with pytest.raises(ModelError, match=r"ToWrite|has no value"):
        diagram.check()


# --- random graphs ----------------------------------------------------------------------------------------------------

_names = st.text(st.sampled_from("ab \n/ü_1(K\"'é&<"), min_size=1, max_size=5).filter(str.strip)
_gains = st.integers(-8, 8).map(lambda k: k / 4)


@st.composite
def graphs(draw: st.DrawFn, depth: int, width: int) -> tuple[System, Any]:
    """Return a system with inputs and outputs of this number, and its function: nested systems, branches, gains."""
    names = draw(st.lists(_names, min_size=2 * width + 1, max_size=2 * width + 5, unique=True))
    ports, names = names[: 2 * width], names[2 * width :]
    drawn = [
        block("Inport", name, next(SIDS), {"Port": str(k + 1)}, {"out": 1}) for k, name in enumerate(ports[:width])
    ]
    signals = [((name, "1"), lambda x, k=k: x[k]) for k, name in enumerate(ports[:width])]
    targets: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for name in names:
        kinds = ["Gain", "Sum", "Constant", "Saturate", "Product"] + (["SubSystem"] * 2 if depth else [])
        kind = draw(st.sampled_from(kinds))
        values, inside = {}, None
        count = {"Gain": 1, "Saturate": 1, "Constant": 0, "SubSystem": width}.get(kind, draw(st.integers(2, 4)))
        chosen = [draw(st.sampled_from(signals)) for _ in range(count)]
        read = [one for _, one in chosen]
        if kind == "Gain":
            values["Gain"] = repr(k := draw(_gains))
            f = [lambda x, k=k, read=read: k * read[0](x)]
        elif kind == "Constant":
            values["Value"] = repr(k := draw(_gains))
            f = [lambda x, k=k: k]
        elif kind == "Saturate":
            values |= {"LowerLimit": "-inf", "UpperLimit": repr(k := draw(_gains))}
            f = [lambda x, k=k, read=read: min(read[0](x), k)]
        elif kind == "Product":
            values["Inputs"] = str(count)
            f = [lambda x, read=read: math.prod(one(x) for one in read)]
        elif kind == "Sum":
            values["Inputs"] = "|".join(signs := draw(st.lists(st.sampled_from("+-"), min_size=count, max_size=count)))
            f = [
                lambda x, s=signs, read=read: sum(
                    one(x) * (1 if a == "+" else -1) for a, one in zip(s, read, strict=True)
                )
            ]
        else:
            inside, inner = draw(graphs(depth - 1, width))
            f = [lambda x, k=k, inner=inner, read=read: inner([one(x) for one in read])[k] for k in range(width)]
        drawn.append(block(kind, name, next(SIDS), values, {"in": count, "out": len(f)}, inside=inside))
        for k, (end, _) in enumerate(chosen, 1):
            targets.setdefault(end, []).append((name, str(k)))
        signals += [((name, str(k)), one) for k, one in enumerate(f, 1)]
    last = []
    for k, name in enumerate(ports[width:], 1):
        end, one = draw(st.sampled_from(signals))
        drawn.append(block("Outport", name, next(SIDS), {"Port": str(k)}, {"in": 1}))
        targets.setdefault(end, []).append((name, "1"))
        last.append(one)
    lines = [line(end, *ends) for end, ends in targets.items()]
    return system(drawn, lines), lambda x: [one(x) for one in last]


def agree(graph: tuple[System, Any], form: str, folder: Path) -> None:
    """Compare the outputs of a diagram with the numbers that its graph gives."""
    inside, f = graph
    path = FORMS[form](model("some", inside, settings={"StopTime": "1"}), folder)
    diagram, report = from_simulink(path)
    assert report.is_whole, report
    document = diagram.to_json()
    assert len(document["inputs"]) == len(document["outputs"]) == 2
    given = dict(zip(document["inputs"], (0.75, -1.5), strict=True))
    results = diagram.run(stop=1, inputs=given)
    expected = f([0.75, -1.5])
    np.testing.assert_allclose([results[name][-1] for name in document["outputs"]], expected, rtol=1e-12, atol=1e-12)


FOUND = [Phase.explicit, Phase.generate]  # shrinking a graph takes minutes
QUIET = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large]


@settings(max_examples=12, deadline=None, suppress_health_check=QUIET, derandomize=True, phases=FOUND)
@given(graph=graphs(2, 2), form=st.sampled_from([*FORMS]))
def test_nested_systems_compute_what_their_graph_says(graph: tuple[System, Any], form: str, tmp_path: Path) -> None:
    agree(graph, form, tmp_path)


@pytest.mark.long
@settings(max_examples=500, deadline=None, suppress_health_check=QUIET, phases=FOUND)
@given(graph=graphs(3, 2), form=st.sampled_from([*FORMS]))
def test_many_nested_systems_compute_what_their_graph_says(
    graph: tuple[System, Any], form: str, tmp_path: Path
) -> None:
    agree(graph, form, tmp_path)


# --- files with faults ------------------------------------------------------------------------------------------------

PIECES = (
    b"",
    b"{",
    b"}",
    b'"',
    b"-1",
    b"inf",
    b"NaN",
    b"1e999",
    b"[",
    b"]'",
    b"99999",
    b"on",
    b"Gain",
    b"\xff",
    b"u(9)",
    b"0",
)


def spoilt(text: bytes, chance: random.Random) -> bytes:
    """Return a text with one to three faults: pieces cut out, doubled, or put in."""
    for _ in range(chance.randint(1, 3)):
        text = text or b" "
        where, size = chance.randrange(len(text)), chance.choice((1, 1, 4, 30, 300))
        kept = chance.choice((chance.choice(PIECES), text[where : where + size] * 2, text[:where][-size:]))
        if chance.random() < 0.5:  # a value as a whole
            values = [*re.finditer(rb'(?<=\t)"[^"\n]*"|(?<=">)[^<\n]+(?=</P>)', text)]
            if values:
                found = chance.choice(values)
                piece = chance.choice(PIECES)
                text = (
                    text[: found.start()]
                    + (b'"' + piece + b'"' if found[0][:1] == b'"' else piece)
                    + text[found.end() :]
                )
                continue
        text = text[:where] + kept + text[where + size :]
    return text


def hold_or_tell(number: int, folder: Path) -> None:
    """Import a spoilt file of the kit: it gives a report or a fault with a cure, within a second."""
    chance = random.Random(number)
    one = chance.choice(CASES)
    if chance.random() < 0.5:
        path = folder / "some.mdl"
        path.write_bytes(spoilt(mdl_text(one.drawn), chance))
    else:
        parts = parts_of(one.drawn, split=chance.random() < 0.5)
        name = chance.choice([name for name in parts if name.endswith(".xml")])
        path = packed(folder / "some.slx", parts | {name: spoilt(parts[name], chance)})
    begin = time.process_time()
    try:
        diagram, report = from_simulink(path)
        assert str(report)
        assert report.to_json() is not None
        diagram.check()
    except BlocksError as error:
        told = [fault.message for fault in error.faults]
        if not all(told):
            pytest.fail(f"{number}: a fault without a word")
    assert time.process_time() - begin < 1, number


def test_a_spoilt_file_gives_a_report_or_a_fault(tmp_path: Path) -> None:
    for number in range(300):
        hold_or_tell(number, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("first", range(0, 5000, 500))
def test_many_spoilt_files_give_a_report_or_a_fault(first: int, tmp_path: Path) -> None:
    for number in range(first, first + 500):
        hold_or_tell(number, tmp_path)
