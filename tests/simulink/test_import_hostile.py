"""What would make an import endless, end it in a trace, or give a wrong number without a word."""

from __future__ import annotations

import base64
import itertools
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from blocks import UsageError, from_simulink
from blocks.api.simulink_import import FromSimulink
from blocks.server import gestures  # noqa: F401  # its messages
from blocks.server.editor import Editor
from blocks.server.messages import answer
from blocks.server.session import Session
from blocks.simulink import Block, Mask, System
from tests.support.simulink_files import FORMS, block, line, model, system


def _made(folder: Path, inside: System, name: str = "m", **more: Any) -> FromSimulink:
    return from_simulink(FORMS["mdl"](model(name, inside, **more), folder))


def _beside(folder: Path, name: str, inside: System, kind: str = "Model") -> None:
    FORMS["mdl"](model(name, inside, kind), folder)


def _chain(*blocks: Block, ends: str = "y") -> System:
    """Return blocks one behind the other, with an Outport at the end."""
    drawn = [*blocks, block("Outport", ends, 900, {}, {"in": 1})]
    return system(drawn, [line((a.name, "1"), (b.name, "1")) for a, b in itertools.pairwise(drawn)])


def _gain(k: str, name: str = "g", sid: int = 2) -> Block:
    return block("Gain", name, sid, {"Gain": k}, {"in": 1, "out": 1})


def _constant(value: str, name: str = "c", sid: int = 1) -> Block:
    return block("Constant", name, sid, {"Value": value}, {"out": 1})


INPORT = block("Inport", "u", 11, {}, {"out": 1})


def _inside(name: str, sid: int, inside: System, mask: Mask | None = None) -> Block:
    return block("SubSystem", name, sid, {}, {"in": 1, "out": 1}, inside=inside, mask=mask)


# --- sizes -----------------------------------------------------------------------------------------------------------


def test_a_mux_that_feeds_itself_and_muxes_of_muxes_end(tmp_path: Path) -> None:
    loop = system([block("Mux", "m", 1, {}, {"in": 2, "out": 1})], [line(("m", "1"), ("m", "1"), ("m", "2"))])
    assert "depends on itself" in _made(tmp_path, loop).report.of("left out")[0].what
    blocks, lines = [_constant("1")], []
    for k in range(14):
        blocks.append(block("Mux", f"m{k}", k + 2, {}, {"in": 2, "out": 1}))
        lines.append(line((blocks[-2].name, "1"), (f"m{k}", "1"), (f"m{k}", "2")))
    report = _made(tmp_path, system(blocks, lines)).report
    assert [entry.what for entry in report.of("left out")] == [
        "its output has 16,384 elements, and 10,000 are the most"
    ]


@pytest.mark.parametrize(("kind", "values"), [
    ("Mux", {"Inputs": "999999999"}), ("BusCreator", {"Inputs": "9" * 5000}), ("Demux", {"Outputs": "999999999"}),
    ("Demux", {"Outputs": "inf"}), ("MinMax", {"Inputs": "999999999"}), ("Logic", {"Inputs": "999999999"}),
    ("Selector", {"Indices": "inf"}), ("Selector", {"Indices": "ones(1,1e6)"}), ("Gain", {"Gain": "ones(1,1e5)"}),
    ("Concatenate", {"NumInputs": "999999999"}), ("SwitchCase", {"CaseConditions": "{-inf}"}),
    ("Lookup", {"InputValues": "1:200000", "Table": "1:200000"}),
])  # fmt: skip
def test_huge_sizes_are_told(kind: str, values: dict[str, str], tmp_path: Path) -> None:
    _made(tmp_path, _chain(_constant("1"), block(kind, "b", 2, values, {"in": 1, "out": 1})))


@pytest.mark.parametrize("size", ["inf", "[2 3]", "999999999", "nobody"])
def test_an_inport_whose_size_is_refused_stays_an_input(size: str, tmp_path: Path) -> None:
    drawn = block("Inport", "u", 1, {"PortDimensions": size}, {"out": 1})
    diagram, report = _made(tmp_path, _chain(drawn))
    assert [entry.path for entry in report.entries if entry.kind != "decided"] == ["u"]
    assert [*diagram.to_json()["inputs"]] == ["u"]


def test_sizes_reach_the_end_of_a_long_chain_that_is_written_backwards(tmp_path: Path) -> None:
    drawn = _chain(_constant("[1 2 3]"), *[_gain("1", f"g{k}", k + 2) for k in range(150)])
    backwards = System(dict(reversed(drawn.blocks.items())), drawn.lines, [], {})
    diagram, report = _made(tmp_path, backwards)
    assert report.is_whole
    assert diagram.run(stop=1)["y"][-1].tolist() == [1, 2, 3]


def test_thousands_of_blocks_that_pass_a_signal_on_are_followed(tmp_path: Path) -> None:
    passing = [block("SignalConversion", f"s{k}", k + 2, {}, {"in": 1, "out": 1}) for k in range(2000)]
    diagram, _ = _made(tmp_path, _chain(_constant("4"), *passing))
    assert diagram.to_json()["outputs"] == {"y": "c.y"}


# --- ports and signals of subsystems ---------------------------------------------------------------------------------


def test_a_scope_inside_may_show_what_arrives(tmp_path: Path) -> None:
    shown = system([INPORT, block("Scope", "s", 12, {}, {"in": 1})], [line(("u", "1"), ("s", "1"))])
    around = system([INPORT, _inside("below", 13, shown)], [line(("u", "1"), ("below", "1"))])
    drawn = _chain(_gain("2"), ends="y")
    drawn.blocks["c"], drawn.blocks["s"] = _constant("3"), _inside("s", 5, around)
    drawn.lines.append(line(("c", "1"), ("g", "1"), ("s", "1")))
    results = _made(tmp_path, drawn).diagram.run(stop=1)
    assert results["c.y"][-1] == 3
    assert results["y"][-1] == 6


def test_a_commented_inport_and_a_port_that_is_no_number_are_no_traces(tmp_path: Path) -> None:
    off = block("Inport", "off", 12, {"Port": "2", "Commented": "on"}, {"out": 1})
    odd = block("Inport", "odd", 13, {"Port": "'x'"}, {"out": 1})
    inner = system([INPORT, off, odd, _gain("2")], [line(("u", "1"), ("g", "1"))])
    assert _made(tmp_path, _chain(_constant("1"), _inside("s", 3, inner))).diagram.to_json()["blocks"]["s"]


# --- libraries and referenced models ---------------------------------------------------------------------------------


def _link(name: str, sid: int, source: str, **values: str) -> Block:
    return block("Reference", name, sid, {"SourceBlock": source, "SourceType": "SubSystem", **values},
                 {"in": 1, "out": 1})  # fmt: skip


def _two(first: Block, second: Block) -> System:
    ends = [block("Outport", f"y{k}", 90 + k, {}, {"in": 1}) for k in (1, 2)]
    lines = [line(("c", "1"), (first.name, "1"), (second.name, "1"))]
    lines += [line((one.name, "1"), (end.name, "1")) for one, end in zip((first, second), ends, strict=True)]
    return system([_constant("1"), first, second, *ends], lines)


def test_two_links_keep_their_values_in_a_subsystem_of_the_link(tmp_path: Path) -> None:
    core = _inside("n", 20, _chain(INPORT, _gain("k")))
    pair = _inside("n", 20, _chain(INPORT, _gain("k")), Mask("m", {"k": "[k 1]"}))
    library = [
        _inside("amp", 1, _chain(INPORT, core), Mask("m", {"k": "2"})),
        _inside("pair", 2, _chain(INPORT, pair), Mask("m", {"k": "2"})),
    ]
    _beside(tmp_path, "parts", system(library), "Library")
    results = _made(tmp_path, _two(_link("a", 2, "parts/amp", k="5"), _link("b", 3, "parts/amp", k="7"))).diagram.run()
    assert (results["y1"][-1], results["y2"][-1]) == (5, 7)
    results = _made(
        tmp_path, _two(_link("a", 2, "parts/pair", k="5"), _link("b", 3, "parts/pair", k="7"))
    ).diagram.run()
    assert (results["y1"][-1].tolist(), results["y2"][-1].tolist()) == ([5, 1], [7, 1])


def test_a_referenced_model_does_not_see_the_masks_around_it(tmp_path: Path) -> None:
    _beside(tmp_path, "part", _chain(INPORT, _gain("k")))
    reference = block("ModelReference", "r", 12, {"ModelName": "part"}, {"in": 1, "out": 1})
    drawn = _chain(_constant("1"), _inside("s", 3, _chain(INPORT, reference), Mask("m", {"k": "9"})))
    assert _made(tmp_path, drawn, callbacks={"InitFcn": "k = 3;"}).diagram.run()["y"][-1] == 3


def test_what_refers_to_itself_is_left_out(tmp_path: Path) -> None:
    both = [block("ModelReference", name, k, {"ModelName": "own"}, {"in": 1, "out": 1}) for k, name in enumerate("ab")]
    _beside(tmp_path, "own", system([INPORT, *both]))
    _beside(tmp_path, "p", system([_link("x", 1, "q/x")]), "Library")
    _beside(tmp_path, "q", system([_link("x", 1, "p/x")]), "Library")
    report = from_simulink(tmp_path / "own.mdl").report
    assert [entry.what for entry in report.of("left out")] == ["models or links refer to each other"] * 2
    report = _made(tmp_path, _chain(_constant("1"), _link("l", 2, "p/x"))).report
    assert [entry.what for entry in report.of("left out")] == ["models or links refer to each other"]
    for k in range(18):  # each holds the next one twice
        pair = [block("ModelReference", name, i, {"ModelName": f"n{k + 1}"}, {"in": 1}) for i, name in enumerate("ab")]
        _beside(tmp_path, f"n{k}", system(pair))
    _beside(tmp_path, "n18", system([_constant("1")]))
    assert "too many blocks" in str(from_simulink(tmp_path / "n0.mdl").report)


# --- values ----------------------------------------------------------------------------------------------------------


def test_true_is_a_value_and_no_variable(tmp_path: Path) -> None:
    diagram, report = _made(tmp_path, _chain(_constant("true"), _gain("true*3")))
    assert report.is_whole
    assert np.all(diagram.run(stop=1)["y"] == 3)


def test_a_damaged_mat_file_is_refused_before_scipy_reads_it(tmp_path: Path) -> None:
    savemat(tmp_path / "w.mat", {"k": 2.0, "s": {"a": np.array([1, "b"], dtype=object)}})
    whole, broken = (tmp_path / "w.mat").read_bytes(), tmp_path / "broken.mat"
    drawn = FORMS["mdl"](model("m", _chain(_constant("k"))), tmp_path)
    assert from_simulink(drawn, tmp_path / "w.mat").report.is_whole
    for at in range(128, len(whole), 3):  # some of them end the process where SciPy reads them
        broken.write_bytes(whole[:at] + b"\xff" + whole[at + 1 :])
        with suppress(UsageError):
            from_simulink(drawn, broken)


def test_a_script_that_is_too_long_is_told(tmp_path: Path) -> None:
    (tmp_path / "long.m").write_text("k = 1;\n" * 200_000)
    report = from_simulink(FORMS["mdl"](model("m", _chain(_constant("2"))), tmp_path), tmp_path / "long.m").report
    assert [(entry.kind, entry.path) for entry in report.entries] == [("unknown", "long.m")]


# --- the report and the page -----------------------------------------------------------------------------------------


def test_long_lines_of_the_report_are_whole_and_show_no_control_characters(tmp_path: Path) -> None:
    name = "a very long name " * 9 + "\x1b[31m"
    drawn = _chain(_constant("1"), block("S-Function", name, 2, {}, {"in": 1, "out": 1}))
    text = str(_made(tmp_path, drawn).report)
    assert "\x1b" not in text
    assert len(text.splitlines()[-1]) > 200
    assert text.endswith("no equal of S-Function here. Write it as a block of your own.")


def test_a_link_that_leads_out_of_the_folder_of_the_page_is_not_followed(tmp_path: Path) -> None:
    folder, outside = tmp_path / "here", tmp_path / "outside.json"
    folder.mkdir()
    (folder / "m.json").symlink_to(outside)
    data = base64.b64encode(FORMS["mdl"](model("m", _chain(_constant("1"))), tmp_path).read_bytes()).decode()
    session = Session(Editor(folder / "own.json"))
    try:
        with pytest.raises(UsageError, match="exists already"):
            answer(session, {"do": "import_model", "name": "m.mdl", "text": data})
    finally:
        session.close()
    assert not outside.exists()


def test_a_bias_may_make_a_vector_of_a_number(tmp_path: Path) -> None:
    drawn = _chain(_constant("3"), block("Bias", "b", 2, {"Bias": "[1 2]"}, {"in": 1, "out": 1}))
    assert _made(tmp_path, drawn).diagram.run(stop=1)["y"][-1].tolist() == [4, 5]


def test_an_output_without_elements_is_told(tmp_path: Path) -> None:
    drawn = _chain(_constant("3"), block("Selector", "b", 2, {"Indices": "[]"}, {"in": 1, "out": 1}), _gain("2"))
    assert _made(tmp_path, drawn).report.entries


# --- sample times ----------------------------------------------------------------------------------------------------


def _delay(period: str, name: str = "d", sid: int = 7) -> Block:
    return block("UnitDelay", name, sid, {"SampleTime": period}, {"in": 1, "out": 1})


CLOCK = block("Clock", "c", 1, {}, {"out": 1})


def test_a_period_that_leaves_a_mask_is_that_of_the_mask(tmp_path: Path) -> None:
    inner = _inside("s", 3, _chain(INPORT, _delay("Ts")), Mask("m", {"Ts": "0.5"}))
    for code in ("Ts = 0.125;", "x = 1;"):  # another Ts outside, or none
        diagram, _ = _made(tmp_path, _chain(CLOCK, inner, _delay("-1")), callbacks={"InitFcn": code})
        assert diagram.run(every=1, stop=3)["y"].tolist() == [0, 0, 1, 2]


def test_a_period_that_comes_into_a_subsystem_is_that_of_the_outside(tmp_path: Path) -> None:
    for mask in (None, Mask("m", {"Ts": "5"})):
        drawn = _chain(CLOCK, _delay("Ts"), _inside("s", 3, _chain(INPORT, _delay("-1")), mask))
        diagram, report = _made(tmp_path, drawn, callbacks={"InitFcn": "Ts = 0.25;"})
        assert report.is_whole
        assert diagram.run(every=1, stop=3)["y"].tolist() == [0, 0.5, 1.5, 2.5]
    diagram, _ = _made(tmp_path, _chain(CLOCK, _delay("Ts"), _inside("s", 3, _chain(INPORT, _delay("-1")))),
                       callbacks={"InitFcn": "Ts = 0.25;"})  # fmt: skip
    assert diagram.run(every=1, stop=3, parameters={"Ts": 0.5})["y"].tolist() == [0, 0, 1, 2]


def test_a_truth_value_goes_into_a_subsystem(tmp_path: Path) -> None:
    compared = block("CompareToConstant", "k", 2, {"relop": ">", "const": "1.5"}, {"in": 1, "out": 1})
    diagram, _ = _made(tmp_path, _chain(CLOCK, compared, _inside("s", 3, _chain(INPORT, _gain("2")))))
    assert diagram.run(every=1, stop=3)["y"].tolist() == [0, 0, 2, 2]


# --- names -----------------------------------------------------------------------------------------------------------


def test_a_block_may_have_the_name_of_what_a_rule_adds(tmp_path: Path) -> None:
    choice = block("Switch", "s", 2, {"Criteria": "u2 > Threshold", "Threshold": "10"}, {"in": 3, "out": 1})
    drawn = _chain(_constant("1"), _gain("7", "s_above", 3), choice)
    drawn.lines.extend([line(("c", "1"), ("s", "2")), line(("c", "1"), ("s", "3"))])
    assert _made(tmp_path, drawn).diagram.run(stop=1)["y"][-1] == 1


def test_a_stop_and_a_variable_inside_may_take_what_arrives(tmp_path: Path) -> None:
    stop = block("Stop", "end", 12, {}, {"in": 1})
    variable = block("ToWorkspace", "w", 13, {"VariableName": "u"}, {"in": 1})
    inner = system([INPORT, stop, variable], [line(("u", "1"), ("end", "1"), ("w", "1"))])
    compared = block("CompareToConstant", "k", 2, {"relop": ">", "const": "1.5"}, {"in": 1, "out": 1})
    drawn = _chain(CLOCK, compared)
    drawn.blocks["s"] = block("SubSystem", "s", 3, {}, {"in": 1}, inside=inner)
    drawn.lines.append(line(("k", "1"), ("s", "1")))
    diagram, report = _made(tmp_path, drawn)
    assert report.is_whole
    assert diagram.run(stop=5).t[-1] == pytest.approx(1.5)


def test_a_variable_that_a_mask_names_and_nobody_knows_is_told_by_its_name(tmp_path: Path) -> None:
    drawn = _chain(_constant("1"), _inside("s", 3, _chain(INPORT, _gain("k")), Mask("m", {"k": "q"})))
    (entry,) = _made(tmp_path, drawn).report.entries
    assert (entry.kind, entry.cure) == ("unknown", "Give q by --workspace.")


def test_pi_may_be_a_variable(tmp_path: Path) -> None:
    diagram, _ = _made(tmp_path, _chain(_constant("pi*k")), callbacks={"InitFcn": "pi = 4; k = 2;"})
    assert diagram.run(stop=1)["y"][-1] == 8
