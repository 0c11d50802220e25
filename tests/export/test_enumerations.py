"""Enumerations at the borders: inputs and outputs of diagrams, in files, in runs, in FMUs, and of FMUs in diagrams.

The truth is a switch in closed form, and FMPy, which reads and runs the same FMUs.
"""

from __future__ import annotations

import enum
import json
import shutil
import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu

from blocks import Block, Diagram, Gain, Input, Integrator, ModelError, UsageError, fmu, output
from blocks.cli import main
from blocks.export.description_xml import _enumerations
from blocks.export.fmu_model import ExportedVariable
from tests.support.places import ROOT

KINDS = {"CS": "CoSimulation", "ME": "ModelExchange"}
ENGINES = ("reference", "native")
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


class Mode(enum.IntEnum):
    IDLE = 3
    RUN = 7


Odd = enum.IntEnum("Odd.Names", {"off, at last": 1, 'on "now" (=x)': 2, "Größe 3": -4})


class Pick(Block):
    """u where the mode is RUN, otherwise 0."""

    u = Input()
    mode = Input(type=Mode)

    @output
    def y(u, mode):  # type: ignore[no-untyped-def]
        return np.where(mode == Mode.RUN, u, 0.0)

    @output(type=Mode)
    def other(mode):  # type: ignore[no-untyped-def]
        return np.where(mode == Mode.RUN, Mode.IDLE, Mode.RUN)


class Through(Block):
    """An enumeration whose names FMI allows and Python does not."""

    mode = Input(type=Odd)

    @output(type=Odd)
    def same(mode):  # type: ignore[no-untyped-def]
        return mode


def picked(default: Any = Mode.IDLE) -> Diagram:
    d = Diagram("picked", library=Pick)
    u, mode = d.input("u", default=2.0), d.input("mode", type=Mode, default=default)
    pick, x = d.add("pick", Pick()), d.add("x", Integrator())
    d.wire(pick.u, u)
    d.wire(pick.mode, mode)
    d.wire(x.u, pick.y)
    d.output("y", x.y)
    d.output("other", pick.other)
    d.output("same", mode)
    return d


@cache
def exported(folder: Path, fmi: int, what: str) -> Path:
    path = folder / f"{what}{fmi}.fmu"
    (picked() if what == "picked" else Diagram.alone(Through())).export(path, fmi=fmi)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("enumerations")


# --- diagrams ---------------------------------------------------------------------------------------------------


def test_an_enumeration_of_an_input_stands_in_the_file_and_comes_back() -> None:
    text = picked().dumps()
    entry = json.loads(text)["inputs"]["mode"]
    assert entry == {"type": {"enum": "Mode", "members": {"IDLE": 3, "RUN": 7}}, "default": "IDLE"}
    again = Diagram.from_json(text, library=Pick)
    assert again.dumps() == text
    again.check()
    assert "mode" in again.draw()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("members", [("IDLE", "RUN"), (3, 7), (Mode.IDLE, Mode.RUN)])
def test_members_are_given_by_name_or_by_number(engine: str, members: tuple[Any, Any]) -> None:
    run = picked().run(stop=2.0, engine=engine, every=0.5, inputs={"mode": {"t": [0, 1], "u": list(members)}})
    assert run["same"].tolist() == [3, 3, 7, 7, 7]
    assert run["other"].tolist() == [7, 7, 3, 3, 3]
    assert run["y"] == pytest.approx([0, 0, 0, 1, 2])  # 2 (t - 1) from 1 s on
    assert picked("RUN").run(stop=2.0, engine=engine)["y"][-1] == pytest.approx(4.0)


def test_members_come_from_a_csv_file_by_number_and_may_be_set_during_a_run(tmp_path: Path) -> None:
    path = tmp_path / "modes.csv"
    path.write_text("time,mode\n0,3\n1,7\n", encoding="utf-8")
    assert picked().run(stop=2.0, inputs=path)["y"][-1] == pytest.approx(2.0)
    run = picked().start(stop=2.0)
    run.advance(1.5)
    run.set("mode", "RUN")
    run.advance(0.5)
    assert run["y"] == pytest.approx(1.0)
    with pytest.raises(UsageError, match=r"E502 mode: must be one of IDLE \(3\), RUN \(7\), not 'OFF'"):
        run.set("mode", "OFF")


@pytest.mark.parametrize("given", ["OFF", 4, 3.5, True, {"value": 3, "unit": "s"}, ([0, 1], ["IDLE", 4])])
def test_what_is_no_member_is_refused_before_the_run(given: Any) -> None:
    with pytest.raises(UsageError, match="E502 mode: "):
        picked().run(stop=1.0, inputs={"mode": given})


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ({"mode": "OFF"}, 'E004 run.inputs.mode: must be one of "IDLE", "RUN", not "OFF".'),
        ({"u": "IDLE"}, "E004 run.inputs.u: must be a number, or a list of numbers, not a text."),
    ],
)
def test_a_text_in_a_file_that_is_no_member_is_told(entry: dict[str, Any], says: str) -> None:
    document = picked().to_json() | {"run": {"inputs": entry}}
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(document, library=Pick)
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ({"default": 3}, 'inputs.mode.default: must be one of "IDLE", "RUN", not the number 3'),
        ({"default": "OFF"}, 'inputs.mode.default: must be one of "IDLE", "RUN", not "OFF".'),
        ({"unit": "V"}, "inputs.mode.unit: an enumeration has no unit."),
        ({"type": {"enum": "Mode", "members": {"a": 1, "b": 1}}, "default": "a"}, '"a" already has the number 1.'),
    ],
)
def test_a_faulty_enumeration_of_an_input_is_told_in_its_place(entry: dict[str, Any], says: str) -> None:
    document = picked().to_json()
    document["inputs"]["mode"] |= entry
    with pytest.raises(ModelError, match="E004") as caught:
        Diagram.from_json(document, library=Pick)
    assert says in str(caught.value)


def test_an_enumeration_in_a_subdiagram_and_of_a_vector() -> None:
    d = Diagram("outer", library=Pick)
    modes = d.input("modes", type=Mode, size=2, default=["IDLE", Mode.RUN])
    for k in range(2):
        inner = d.add(f"part{k}", picked())
        d.wire(inner.mode, modes[k])
    run = d.run(stop=1.0)
    assert (run["part0.x.y"][-1], run["part1.x.y"][-1]) == (0.0, pytest.approx(2.0))


# --- export -----------------------------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.parametrize("fmi", [2, 3])
def test_enumerations_are_exported_with_their_names_and_items(folder: Path, fmi: int) -> None:
    for what, name, start, items in (
        ("picked", "Mode", "3", [("IDLE", 3), ("RUN", 7)]),
        ("through", "Odd.Names", "1", sorted(((m.name, int(m)) for m in Odd), key=lambda item: item[1])),
    ):
        path = exported(folder, fmi, what)
        assert not validate_fmu(str(path))
        described = read_model_description(str(path))
        assert [t.name for t in described.typeDefinitions] == [name]
        assert [(i.name, int(i.value)) for i in described.typeDefinitions[0].items] == items
        mode = next(v for v in described.modelVariables if v.name == "mode")
        assert (mode.type, mode.variability, mode.start, mode.declaredType.name) == (
            "Enumeration", "discrete", start, name,
        )  # fmt: skip


@needs_compiler
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("engine", ENGINES)
def test_an_fmu_with_an_enumeration_runs_as_in_fmpy(folder: Path, fmi: int, kind: str, engine: str) -> None:
    path = exported(folder, fmi, "picked")
    signal = np.array([(0.0, 2.0, 3), (1.0, 2.0, 3), (1.0, 2.0, 7), (2.0, 2.0, 7)],
                      dtype=[("time", float), ("u", float), ("mode", np.int32)])  # fmt: skip
    rows = simulate_fmu(
        str(path), fmi_type=KINDS[kind], input=signal, stop_time=2.0, output_interval=0.5, output=["y", "other", "same"]
    )
    times, last = np.unique(rows["time"][::-1], return_index=True)
    alone = Diagram.alone(fmu(path, kind=kind))
    entry = alone.to_json()["inputs"]["mode"]
    assert entry == {"default": "IDLE", "type": {"enum": "Mode", "members": {"IDLE": 3, "RUN": 7}}}
    given = {"mode": {"t": [0, 1], "u": ["IDLE", "RUN"]}}
    ours = alone.run(stop=2.0, inputs=given, every=0.5, engine=engine, **({} if kind == "ME" else CS))
    assert ours.t.tolist() == times.tolist()
    assert ours["y"] == pytest.approx(rows["y"][::-1][last], abs=1e-6)
    assert ours["y"][-1] == pytest.approx(2.0)
    assert [ours[name][-1] for name in ("other", "same")] == [rows[name][-1] for name in ("other", "same")] == [3, 7]
    assert [ours[name][0] for name in ("other", "same")] == [rows[name][0] for name in ("other", "same")] == [7, 3]


CS: dict[str, Any] = {"master": {"step": 0.5}}


@needs_compiler
@pytest.mark.parametrize("value", ["Größe 3", "-4"])
def test_blocks_fmu_run_takes_a_member_by_name_or_by_number(
    folder: Path, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = exported(folder, 3, "through")
    assert main(["fmu", "run", str(path), "--input", f"mode={value}", "--stop", "1", "--log", "same"]) == 0
    assert [line.split()[1:5] for line in capsys.readouterr().out.splitlines() if line.split()[:1] == ["same"]] == [
        ["-", "-4", "-4", "-4"]
    ]
    assert main(["fmu", "run", str(path), "--input", "mode=on", "--stop", "1"]) != 0
    assert 'E502 mode: must be one of Größe 3 (-4), "off, at last" (1), ' in capsys.readouterr().err


# --- FMUs in diagrams -------------------------------------------------------------------------------------------


@needs_compiler
def test_enumerations_with_equal_members_are_one_whatever_their_names(folder: Path, tmp_path: Path) -> None:
    Named = enum.IntEnum("Named", {"IDLE": 3, "RUN": 7})

    class Says(Block):
        """RUN from 1 s on."""

        u = Input()

        @output(type=Named)
        def mode(u):  # type: ignore[no-untyped-def]
            return np.where(u > 1.0, Named.RUN, Named.IDLE)

    Diagram.alone(Says()).export(tmp_path / "says.fmu", fmi=2)
    d = Diagram("two", folder=ROOT)
    says, pick = d.add("says", fmu(tmp_path / "says.fmu")), d.add("pick", fmu(exported(folder, 3, "picked")))
    d.wire(says.u, d.input("u", default=5.0))
    d.wire(pick.mode, says.mode)
    run = d.run(stop=1.0, log=["pick.same", "pick.y"])
    assert (run["pick.same"][-1], run["pick.y"][-1]) == (7.0, pytest.approx(2.0, abs=0.1))


@needs_compiler
def test_a_number_that_is_wired_to_an_enumeration_is_refused_with_what_may_be(folder: Path) -> None:
    d = Diagram("wrong")
    pick, gain = d.add("pick", fmu(exported(folder, 2, "picked"))), d.add("gain", Gain())
    d.wire(gain.u, d.input("u"))
    d.wire(pick.mode, gain.y)
    with pytest.raises(ModelError) as caught:
        d.check()
    cure = '{"type": {"enum": "Mode", "members": {"IDLE": 3, "RUN": 7}}, "default": "IDLE"}'
    assert "E104 pick.mode: is of the enum Mode(IDLE=3, RUN=7), but gain.y is a number." in str(caught.value)
    assert f"Wire an input of the diagram: {cure}." in str(caught.value)


def test_names_of_enumerations_are_found_in_time_linear_in_the_variables() -> None:
    """One enumeration among 40,000 variables: a tuple of all names for each of them would take 10 s."""
    many = [ExportedVariable(f"v{k}", k, "local", "continuous") for k in range(40_000)]
    mode = ExportedVariable(
        "mode", 40_000, "input", "discrete", type="enum", members={3: "IDLE", 7: "RUN"}, enumeration="Mode"
    )
    begun = time.process_time()
    assert list(_enumerations([*many, mode]).values()) == ["Mode"]
    assert time.process_time() - begun < 2.0
