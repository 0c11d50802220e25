"""A diagram that pages edit: gestures, their undoing, the file beside other programs, the page in a browser."""

from __future__ import annotations

import base64
import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from blocks import (
    PID,
    Block,
    BlocksError,
    Case,
    Diagram,
    Input,
    Parameter,
    PMDCMotor,
    Step,
    UsageError,
    output,
    subdiagram,
)
from blocks.draw import picture, ports_of, rendered
from blocks.model.document import dumps
from blocks.server import analysis_messages, gestures, knobs, panel, scope_messages  # noqa: F401  # their messages
from blocks.server.editor import Editor
from blocks.server.live_server import LiveServer
from blocks.server.messages import answer
from blocks.server.session import Session
from blocks.text.atomic_write import write_atomically
from tests.support.places import ROOT

Ask = Callable[..., Any]


class Twice(Block):
    """y = k u: a block of one's own."""

    k = Parameter(2.0)
    u = Input()

    @output
    def y(u, k):
        return k * u


@contextmanager
def edited(
    path: Path, trust: Any = (), asks: Any = None, seen: list[Session] | None = None, **given: Any
) -> Iterator[tuple[Ask, Editor]]:  # fmt: skip
    editor = Editor(path, **given)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("blocks.server.session.LOOK", 1e6)  # its thread must not look at the file while this one writes
        session = Session(editor, Case(trust=trust), asks)
        if seen is not None:
            seen.append(session)
        try:
            yield lambda do, **fields: answer(session, {"do": do, **fields}), editor
        finally:
            session.close()


def loop(ask: Ask) -> None:
    """A motor under a PID controller, from an empty file on."""
    ask("insert", entry={"type": "Step"}, text="at=1 after=2 unit=rad/s")
    ask("insert", entry={"type": "PID"}, text="kp=20 ki=30 lower=-12 upper=12 unit=rad/s unit_u=V", source="step.y")
    ask("insert", entry={"type": "PMDCMotor"}, source="pid.u")
    ask("edit", operations=[{"wire": "pmdc_motor.omega", "to": "pid.y"}])
    ask("define", kind="output", text="omega", source="pmdc_motor.omega")
    ask("define", kind="entry", text="run.stop=4")


def test_gestures_make_a_diagram_that_runs_and_are_undone_to_the_empty_file(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        empty = path.read_bytes()
        assert Diagram.load(path).name == "motor"
        loop(ask)
        made = path.read_bytes()
        steps = len(editor.done)
        built = Diagram("motor")
        step = built.add("step", Step(at=1, after=2, unit="rad/s"))
        pid = built.add("pid", PID(kp=20, ki=30, lower=-12, upper=12, unit="rad/s", unit_u="V"))
        motor = built.add("pmdc_motor", PMDCMotor())
        for sink, source in ((pid.r, step.y), (motor.v, pid.u), (pid.y, motor.omega)):
            built.wire(sink, source)
        built.output("omega", motor.omega)
        built.settings(stop=4)
        runs = [one.run(engine="reference") for one in (Diagram.load(path), built)]
        assert np.array_equal(*(run["pmdc_motor.omega"] for run in runs))
        for _ in range(steps):
            ask("undo")
        assert path.read_bytes() == empty
        with pytest.raises(UsageError, match="nothing to undo"):
            ask("undo")
        for _ in range(steps):
            ask("redo")
        assert path.read_bytes() == made == dumps(Diagram.load(path).value).encode()
        with pytest.raises(UsageError, match="nothing to redo"):
            ask("redo")


def test_the_first_move_in_an_automatic_layout_writes_all_positions_and_moves_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        loop(ask)
        before = editor.positions("")
        ask("place", names=["pid"], by=[20, 40])
        x, y = before["pid"]
        assert json.loads(path.read_text())["layout"] == before | {"pid": [x + 20, y + 40]}
        assert editor.positions("") == before | {"pid": [x + 20, y + 40]}
        for level, draw in editor.rough():
            editor.settle(level, *draw())
        value = Diagram.load(path).value
        shown = rendered(picture(value, ports_of(value, editor.resolver)), value.name)
        assert editor.drawing("") == shown  # at rest it is what `blocks draw` draws
        ask("arrange", names=["pid"])
        ask("arrange", names=[])
        with pytest.raises(UsageError, match="not in this drawing"):
            ask("place", names=["nothing"], by=[1, 1])


def test_a_file_that_was_deleted_on_the_disk_is_written_again_by_undo(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        loop(ask)
        text = path.read_bytes()
        path.unlink()
        with pytest.raises(UsageError, match=r"renamed by another program.*Undo to write the file again"):
            ask("put", name="pid.ki", text="31")
        assert not path.exists()
        assert editor.told()["editing"]["undo"] == "the deletion on disk"
        assert ask("undo")["what"] == "undone: the deletion on disk"
        assert path.read_bytes() == text
        ask("put", name="pid.ki", text="31")
        ask("undo")
        assert path.read_bytes() == text


def test_what_another_program_wrote_is_never_overwritten_and_can_be_undone(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        loop(ask)
        ours = path.read_text()
        theirs = ours.replace('"kp": 20', '"kp": 21')
        path.write_text(theirs)
        with pytest.raises(UsageError, match="changed by another program; the page now shows the new text"):
            ask("put", name="pid.ki", text="31")  # which was typed without a look at it
        assert path.read_text() == theirs
        ask("put", name="pid.ki", text="31")
        assert path.read_text() == theirs.replace('"ki": 30', '"ki": 31')
        ask("undo")
        assert path.read_text() == theirs
        ask("undo")
        assert path.read_text() == ours
        ask("redo")
        edit = gestures.Editor.edit
        with pytest.MonkeyPatch.context() as patch:  # it is written between our look at the file and our writing
            patch.setattr(Editor, "_catch_up", lambda self: None)
            path.write_text(ours)
            with pytest.raises(UsageError, match="another program changed the file in the meantime"):
                edit(editor, "set", [{"set": "run.stop", "to": 9}])
        assert path.read_text() == ours
        editor._catch_up()
        path.write_text('{"format": broken')
        with pytest.raises(UsageError, match="cannot be read as a diagram"):
            ask("put", name="pid.ki", text="32")
        ask("undo")
        assert path.read_text() == ours


def test_no_gesture_is_made_of_what_stood_there_before_another_program_wrote(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, _):
        loop(ask)
        ours = path.read_text()
        gesture: dict[str, dict[str, Any]] = {
            "insert": {"entry": {"type": "Gain"}, "at": [10, 10], "of": "pid"},
            "place": {"names": ["pid"], "by": [10, 0]},
            "arrange": {"names": []},
            "delete": {"names": ["pid"], "sinks": []},
            "duplicate": {"names": ["pid"]},
            "paste": {"text": '{"blocks": {"g": {"type": "Gain"}}}'},
            "put": {"name": "pid.kp", "text": "7"},
            "define": {"kind": "parameter", "text": "k=1"},
            "describe": {"of": "pid", "text": "x"},
            "edit": {"operations": [{"set": "run.stop", "to": 9}]},
        }
        for number, (do, fields) in enumerate(gesture.items()):
            theirs = ours.replace(
                '"name": "motor"', f'"name": "motor", "doc": "{number}", "layout": {{"pid": [500, {number}]}}'
            )
            path.write_text(theirs)
            with pytest.raises(UsageError, match="changed by another program; the page now shows the new text"):
                ask(do, **fields)
            assert path.read_text() == theirs
            ask(do, **fields)
            assert path.read_text() != theirs
            ask("undo")
            assert path.read_text() == theirs


def test_a_file_that_cannot_be_written_stays_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        loop(ask)
        before, steps = path.read_bytes(), len(editor.done)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("blocks.text.atomic_write._sync", Mock(side_effect=OSError(28, "no room")))
            with pytest.raises(UsageError, match="no room"):
                ask("put", name="pid.kp", text="1")
        assert (path.read_bytes(), len(editor.done)) == (before, steps)
        assert [file.name for file in tmp_path.iterdir()] == ["motor.json"]


def test_what_would_make_the_file_unreadable_or_stand_too_far_away_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        loop(ask)
        before, steps = path.read_bytes(), len(editor.done)
        for name in ("motor.json", "../../nothing.json"):  # itself, and one that is not there
            with pytest.raises(BlocksError, match="json"):
                ask("insert", entry={"diagram": name})
        for by in ([1e300, 0], [0, -2e6]):
            with pytest.raises(UsageError, match="farther than 1e"):
                ask("place", names=["pid"], by=by)
        with pytest.raises(UsageError, match="farther than 1e"):
            ask("insert", entry={"type": "Gain"}, at=[1e300, 0])
        assert (path.read_bytes(), len(editor.done)) == (before, steps)
        ask("put", name="pid.kp", text="3")  # it goes on


def test_words_that_are_typed_are_entries_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"

    def file() -> Any:
        return json.loads(path.read_text())

    with edited(path) as (ask, _):
        loop(ask)
        ask("insert", entry={"type": "Gain"}, text="3")
        ask("insert", entry={"type": "Gain"}, text="k==2*3")
        ask("insert", entry={"type": "Sum"}, text="+-")
        ask("insert", entry={"type": "Trigonometry"}, text="sin")
        blocks = [file()["blocks"][name]["parameters"] for name in ("gain", "gain2", "sum", "trigonometry")]
        assert blocks == [{"k": 3}, {"k": "=2*3"}, {"signs": "+-"}, {"function": "sin"}]
        ask("define", kind="measure", text="peak of=pid.u from=1")
        ask("define", kind="measure", text="peak of=pid.u")
        ask("define", kind="measure", text="dip = peak of=pid.u")
        ask("define", kind="measure", text="dip=IAE of=pid.u")  # another one in its place
        peak = {"type": "peak", "of": "pid.u"}
        assert file()["measures"] == {"peak": peak | {"from": 1}, "peak2": peak, "dip": {"type": "IAE", "of": "pid.u"}}
        ask("define", kind="parameter", text="c=3")
        ask("describe", of="", text="one\n two ")
        ask("describe", of="pid", text="a law")
        ask("describe", of="c", text="a number")
        assert (file()["doc"], file()["blocks"]["pid"]["doc"]) == (["one", " two"], "a law")
        assert file()["parameters"]["c"] == {"value": 3, "doc": "a number"}
        for name in ("", "pid", "c"):
            ask("describe", of=name, text=" ")
        assert "doc" not in file()
        assert file()["parameters"]["c"] in (3, {"value": 3})
        with pytest.raises(UsageError, match="no such block, parameter or input"):
            ask("describe", of="nothing", text="x")


def test_the_palette_has_types_words_and_the_files_of_the_project(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text("")
    for name in ("a/one.json", "b/two.json", "b/.hidden.json", "b/no_diagram.json"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        text = "{}" if name.endswith("no_diagram.json") else dumps(Diagram("x").value)
        (tmp_path / name).write_text(text)
    with edited(tmp_path / "a/one.json") as (ask, editor):
        entries = ask("palette")["entries"]
        assert [one["diagram"] for one in entries if "diagram" in one] == ["../b/two.json"]
        known = {one["type"]: one for one in entries if "type" in one}
        assert known["PID"]["takes"][:3] == ["unit", "unit_u", "kp"]
        assert "Transport Delay" in known["TransportDelay"]["words"]
        assert all(one["picture"]["strokes"] for one in known.values())
        assert "Scope" in [one.get("word") for one in entries]
        ask("insert", entry={"diagram": "../b/two.json"})
        editor.opens = str
        assert ask("tab", file="../b/two.json")["url"] == str(tmp_path / "b/two.json")
        for name in ("../b/no_diagram.json", "../../x.json", "/etc/passwd", ""):
            with pytest.raises(UsageError):
                ask("tab", file=name)


def test_an_empty_file_is_no_new_diagram(tmp_path: Path) -> None:
    path = tmp_path / "empty.json"
    path.touch()
    with pytest.raises(UsageError, match="is empty, and is therefore not a diagram"):
        Editor(path)
    assert path.read_bytes() == b""


def test_all_tabs_of_a_diagram_share_its_history(tmp_path: Path) -> None:
    one, two = tmp_path / "one.json", tmp_path / "two.json"
    Diagram("two").save(two)
    server = LiveServer(one, edit=True).start()
    try:
        (tmp_path / "link.json").symlink_to(one)

        def port(of: LiveServer, file: str) -> int:
            return int(answer(of._open, {"do": "tab", "file": file})["url"].split(":")[2].partition("/")[0])  # type: ignore[index]

        other = port(server, "two.json")
        assert other != server.port == port(server, "one.json") == port(server, "link.json")
        beside = server._tabs[two]
        assert (beside.port, port(beside, "one.json"), port(beside, "two.json")) == (other, server.port, other)
    finally:
        server.stop()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", other))


def test_elements_of_a_vector_are_typed_as_numbers_quantities_and_expressions(tmp_path: Path) -> None:
    path = tmp_path / "vector.json"
    with edited(path) as (ask, _):
        ask("edit", operations=[{"set": "parameters.g", "to": {"value": [3, 4], "unit": "V"}}])
        ask("define", kind="parameter", text="h=5")
        ask("insert", entry={"type": "Step"})
        ask("insert", entry={"type": "TransferFunction"}, text="num=[1, 2] den=[1, 2, 3]", source="step.y")

        def now() -> Any:
            value = json.loads(path.read_text())
            return value["blocks"]["transfer_function"]["parameters"]["den"], value["parameters"]["g"]

        ask("put", name="transfer_function.den", text=["1", "=h", " 3"])
        ask("put", name="g", text=["2 mV", "3"])
        assert now() == ([1, "=h", 3], {"value": [0.002, 3], "unit": "V"})
        for name, text, why in (
            ("g", ["2 s", "3"], r"given in s, but \[V\] is needed"),
            ("g", ["", "3"], "a value for each element"),
        ):
            with pytest.raises(UsageError, match=why):
                ask("put", name=name, text=text)


def test_elements_that_nobody_typed_stay_as_the_file_spells_them(tmp_path: Path) -> None:
    path = tmp_path / "vector.json"
    path.write_text(json.dumps({
        "format": "blocks-diagram", "version": 3, "name": "vector", "inputs": {"u": {"default": 1}},
        "parameters": {"g": {"value": [3.5, 4], "unit": "V", "doc": "gains"}},
        "blocks": {
            "lag": {"type": "ZeroPoleGain", "parameters": {"poles": {"value": [-0.2, -0.301], "unit": "1/ms"}}},
            "same": {"type": "TransferFunction", "parameters": {"num": [1], "den": [1.5, 2]}},
        },
        "wires": {"lag.u": "u", "same.u": "u"},
    }).replace("1.5,", "1.50,"))  # fmt: skip
    with edited(path) as (ask, editor):
        assert not editor.faults, editor.faults

        def now(block: str) -> Any:
            return json.loads(path.read_text())["blocks"][block]["parameters"]

        ask("put", name="lag.poles", text=[None, "-400"])  # in 1/s, as the page shows it
        assert now("lag")["poles"] == {"value": [-0.2, -0.4], "unit": "1/ms"}
        ask("put", name="lag.poles", text=[None, "-0.5 1/ms"])
        assert now("lag")["poles"] == {"value": [-0.2, -0.5], "unit": "1/ms"}
        ask("put", name="same.den", text=[None, "3"])
        assert "[1.50, 3]" in path.read_text()
        ask("put", name="g", text=["5 mV", None])
        assert json.loads(path.read_text())["parameters"]["g"] == {"value": [0.005, 4], "unit": "V", "doc": "gains"}
        for text, why in (([None, "2 s"], r"given in s, but \[1/s\]"), ([None, None, "3"], "has other elements")):
            with pytest.raises(UsageError, match=why):
                ask("put", name="lag.poles", text=text)


def test_a_measure_that_is_changed_keeps_its_doc(tmp_path: Path) -> None:
    path = tmp_path / "measured.json"
    with edited(path) as (ask, _):
        ask("insert", entry={"type": "Step"})
        ask("define", kind="measure", text="top=peak of=step.y")
        ask("edit", operations=[{"set": "measures.top.doc", "to": "the largest"}])
        ask("define", kind="measure", text="top=peak of=step.y from=2")
        assert json.loads(path.read_text())["measures"]["top"] == {
            "type": "peak", "of": "step.y", "from": 2, "doc": "the largest",
        }  # fmt: skip


def test_long_texts_of_spaces_are_read_at_once(tmp_path: Path) -> None:
    spaces = " " * 90_000
    with edited(tmp_path / "long.json") as (ask, _):
        ask("define", kind="parameter", text="g=1")
        ask("insert", entry={"type": "Gain"}, text=f"a{spaces}!")
        ask("put", name="g", text=f"1 x{spaces}y")


def test_what_is_deleted_in_the_drawing_is_what_is_drawn_by_that_name(tmp_path: Path) -> None:
    path = tmp_path / "names.json"
    with edited(path) as (ask, _):
        ask("define", kind="parameter", text="w=1")
        ask("insert", entry={"type": "Gain"}, text="k==w")
        for output in ("w", "gain", "z"):
            ask("define", kind="output", text=output, source="gain.y")
        ask("delete", names=["w"], sinks=[])
        value = json.loads(path.read_text())
        assert (value["parameters"], value["outputs"]) == ({"w": 1}, {"gain": "gain.y", "z": "gain.y"})
        ask("delete", names=[], sinks=["gain"])  # the wire to the output
        value = json.loads(path.read_text())
        assert (list(value["blocks"]), value["outputs"]) == (["gain"], {"z": "gain.y"})
        ask("delete", names=["gain"], sinks=[])
        assert "outputs" not in json.loads(path.read_text())


def test_a_value_is_put_into_the_variant_that_is_chosen(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, _):
        loop(ask)
        ask("edit", operations=[{"swap": "pid", "for": {"type": "PID", "parameters": {"kp": 5}}, "as": "other"}])

        def gains() -> list[Any]:
            block = json.loads(path.read_text())["blocks"]["pid"]
            return [one["parameters"].get("kp") for one in (block, block["variants"]["other"])]

        before = gains()
        ask("put", name="pid.kp", text="99")
        assert gains() == [before[0], 99]
        ask("variant", path="pid", name="base")
        ask("put", name="pid.kp", text="7")
        assert gains() == [7, 99]
        ask("variant", path="pid", name="other")
        ask("put", name="pid.kp", text="")
        assert gains() == [7, None]


def test_other_files_that_a_gesture_leaves_as_they_are_are_named(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text("")
    inner = Diagram("sub")
    inner.output("y", inner.input("u", default=0.0))
    inner.save(tmp_path / "sub.json")
    for name in ("one", "other"):
        outer = Diagram(name, folder=tmp_path)
        outer.wire(outer.add("inside", subdiagram("sub.json")).u, outer.add("step", Step()).y)
        outer.save(tmp_path / f"{name}.json")
    with edited(tmp_path / "one.json") as (ask, _):
        told = ask("edit", operations=[{"rename": ["inputs", "u"], "to": "v"}], level="inside")
        assert told["files"] == ["sub.json"]
        assert [Path(file).name for file in told["left"]] == ["other.json"]


def test_blocks_of_ones_own_are_in_the_palette_and_can_be_inserted(tmp_path: Path) -> None:
    with edited(tmp_path / "own.json", library=[Twice]) as (ask, editor):
        (own,) = [one for one in ask("palette")["entries"] if one.get("type") == "Twice"]
        assert own["doc"] == "y = k u: a block of one's own."
        ask("insert", entry={"type": "Twice"}, text="2")
        assert editor.body("")["blocks"] == {"twice": {"type": "Twice", "parameters": {"k": 2}}}


def test_targets_say_where_a_wire_fits_and_why_not(tmp_path: Path) -> None:
    with edited(tmp_path / "motor.json") as (ask, _):
        loop(ask)
        told = ask("targets", end="pid.u")["ports"]
        assert told["pmdc_motor.v"] == "is driven by pid.u"
        assert "different quantities" in told["pmdc_motor.tau"]
        assert told["pid.manual"] == ""
        told = ask("targets", end="pmdc_motor.tau")["ports"]
        assert "different quantities" in told["pid.u"]
        with pytest.raises(UsageError, match="no such port"):
            ask("targets", end="pid.nothing")


def test_values_are_written_as_typed_and_go_back_to_their_defaults(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"

    def pid() -> Any:
        return json.loads(path.read_text())["blocks"]["pid"]["parameters"]

    with edited(path) as (ask, _):
        loop(ask)
        ask("put", name="pid.kp", text="25 V.s/rad")
        assert pid()["kp"] == 25  # the declared unit needs no word
        ask("put", name="pid.upper", text="9000 mV")
        assert pid()["upper"] == {"value": 9000, "unit": "mV"}
        ask("put", name="pid.kp", text="=2*3")
        ask("put", name="pid.ki", text="")
        ask("put", name="pid.unit_u", text="V")
        upper = {"value": 9000, "unit": "mV"}
        assert pid() == {"kp": "=2*3", "lower": -12, "upper": upper, "unit": "rad/s", "unit_u": "V"}
        ask("define", kind="parameter", text="gain=3 1/s")
        ask("put", name="gain", text="4")
        ask("define", kind="input", text="r=1 rad/s")
        document = json.loads(path.read_text())
        assert document["parameters"]["gain"] == {"value": 4, "unit": "1/s"}
        with pytest.raises(UsageError, match="gain: has no default: it needs a value"):
            ask("put", name="gain", text=" ")
        assert document["inputs"]["r"] == {"default": 1, "unit": "rad/s"}
        ask("put", name="r", text="2")
        assert json.loads(path.read_text())["inputs"]["r"]["default"] == 2
        for text, why in (("[1,", "pid.kp"), ('{"a"', "pid.kp")):
            with pytest.raises(BlocksError, match=why):
                ask("put", name="pid.kp", text=text)


def test_copies_take_wires_and_parameters_along(tmp_path: Path) -> None:
    with edited(tmp_path / "motor.json") as (ask, editor):
        loop(ask)
        ask("define", kind="parameter", text="gain=3")
        ask("put", name="pid.kp", text="=gain")
        text = ask("copy", names=["pid", "pmdc_motor"])["text"]
        assert json.loads(text)["wires"] == {"pmdc_motor.v": "pid.u", "pid.y": "pmdc_motor.omega"}
        assert json.loads(text)["parameters"] == {"gain": 3}
        assert ask("paste", text=text)["names"] == ["pid_2", "pmdc_motor_2"]
        assert ask("duplicate", names=["step"])["names"] == ["step_2"]
        ask("place", names=["step"], by=[10, 0])  # from here on all have positions
        for copies in (["pid", "pmdc_motor"], ["pid"], ["step_2"]):
            before = editor.positions("")
            names = ask("duplicate", names=copies)["names"]
            after = editor.positions("")
            assert {name: after[name] for name in before} == before
            apart = [abs(np.subtract(after[name], at)) for name in names for at in before.values()]
            assert all(dx >= 60 or dy >= 100 for dx, dy in apart)  # of blocks of 90 by 100 pixels
            dx, dy = np.subtract(after[names[0]], before[copies[0]])
            assert abs(dx) + dy < 500
    other = tmp_path / "other.json"
    with edited(other) as (ask, _):
        assert ask("paste", text=text)["names"] == ["pid", "pmdc_motor"]
        assert json.loads(other.read_text())["parameters"] == {"gain": 3}
        assert ask("paste", text='{"type": "Gain"}')["names"] == ["pasted"]
        for text in ("no json", "[]", "{}", '{"blocks": {"a b": {}}}', '{"blocks": 3}'):
            with pytest.raises(BlocksError):
                ask("paste", text=text)


def test_a_fault_has_a_button_that_does_what_its_cure_says(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        loop(ask)
        good = json.loads(path.read_text())
        for place, bad in (
            (["blocks", "pid", "type"], "PDI"), (["wires", "pmdc_motor.v"], "pid.uu"),
            (["blocks", "pid", "parameters", "kdd"], 3),
        ):  # fmt: skip
            ask("edit", operations=[{"set": place, "to": bad}])
            (fault,) = [one for one in editor.told()["faults"] if one.get("remedies")]
            ask("edit", operations=fault["remedies"][0]["operations"])
            assert not editor.told()["faults"]
        good["blocks"]["pid"]["parameters"]["kd"] = 3
        assert json.loads(path.read_text()) == good
        ask("edit", operations=[{"set": ["blocks", "pid", "parameters", "kpp"], "to": 3}])
        ((remedy,),) = (one["remedies"] for one in editor.told()["faults"])  # there is a kp
        assert remedy["label"] == "Remove kpp"
        ask("edit", operations=remedy["operations"])
        assert json.loads(path.read_text()) == good
        ask("delete", names=[], sinks=["pmdc_motor.v"])
        (fault,) = editor.told()["faults"]
        assert fault["remedies"][-1] == {"label": "Connect ...", "sink": "pmdc_motor.v"}


def test_an_fmu_that_is_dropped_takes_the_place_of_a_block_with_its_wires(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    data = base64.b64encode((ROOT / "fmus/PMDCMotor.fmu").read_bytes()).decode()
    with edited(path, trust=tmp_path) as (ask, editor):
        loop(ask)
        assert ask("upload", name="PMDCMotor.fmu", text=data)["fmu"] == "PMDCMotor.fmu"
        ask("edit", operations=[{"swap": "pmdc_motor", "for": {"fmu": "PMDCMotor.fmu"}}])
        entry = json.loads(path.read_text())["blocks"]["pmdc_motor"]
        assert entry["variants"][entry["variant"]] == {"fmu": "PMDCMotor.fmu"}
        assert [fault["code"] for fault in editor.told()["faults"]] == ["W211"]  # no step is given
        for name in ("../x.fmu", "x.so", "sub/x.fmu", ""):
            with pytest.raises(UsageError):
                ask("upload", name=name, text=data)
        with pytest.raises(UsageError, match="with other contents"):
            ask("upload", name="PMDCMotor.fmu", text="AAAA")
        with pytest.raises(UsageError, match="base64"):
            ask("upload", name="y.fmu", text="?")


def test_an_fmu_that_is_dropped_is_written_after_a_yes_at_the_terminal_only(tmp_path: Path) -> None:
    path, fmu = tmp_path / "motor.json", tmp_path / "PMDCMotor.fmu"
    data = base64.b64encode((ROOT / "fmus/PMDCMotor.fmu").read_bytes()).decode()
    questions: list[tuple[str, Any]] = []
    with edited(path) as (ask, _), pytest.raises(UsageError, match="no terminal to ask"):
        ask("upload", name="PMDCMotor.fmu", text=data)
    with edited(path, trust=[path]) as (ask, _), pytest.raises(UsageError, match="no terminal to ask"):
        ask("upload", name="PMDCMotor.fmu", text=data)
    session_of: list[Session] = []
    with edited(path, asks=lambda *question: questions.append(question), seen=session_of) as (ask, _):
        for says_yes in (False, True):
            assert ask("upload", name="PMDCMotor.fmu", text=data) == {
                "is": "uploaded", "fmu": "PMDCMotor.fmu", "waits": True,
            }  # fmt: skip
            with pytest.raises(UsageError, match=r"the terminal still asks about PMDCMotor\.fmu"):
                ask("upload", name="other.fmu", text=data)
            ((question, decide),) = questions
            assert question.startswith("PMDCMotor.fmu (")
            assert question.endswith(f"Write it into {tmp_path}?")
            assert [*tmp_path.glob("*.fmu")] == []
            questions.clear()
            decide(says_yes)
            limit = time.monotonic() + 60
            while session_of[0].waits_for and time.monotonic() < limit:
                time.sleep(0.01)
            assert fmu.exists() == says_yes
        assert fmu.read_bytes() == base64.b64decode(data)
        assert not ask("upload", name="PMDCMotor.fmu", text=data)["waits"]  # it is there


def test_a_dropped_fmu_does_not_leave_its_folder_through_a_link_that_is_made_while_the_question_waits(
    tmp_path: Path,
) -> None:
    folder, outside = tmp_path / "project", tmp_path / "outside.fmu"
    folder.mkdir()
    data = base64.b64encode((ROOT / "fmus/PMDCMotor.fmu").read_bytes()).decode()
    decisions: list[Any] = []
    session_of: list[Session] = []
    with edited(folder / "a.json", asks=lambda _, decide: decisions.append(decide), seen=session_of) as (ask, _):
        ask("upload", name="x.fmu", text=data)
        (folder / "x.fmu").symlink_to(outside)
        decisions[0](True)
        limit = time.monotonic() + 60
        while session_of[0].waits_for and time.monotonic() < limit:
            time.sleep(0.01)
        assert not outside.exists()


def test_an_fmu_with_the_name_of_a_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "folder.fmu").mkdir()
    refused = pytest.raises(UsageError, match=r"E501 folder\.fmu: cannot be written: Is a directory")
    with edited(tmp_path / "a.json", trust=tmp_path) as (ask, _), refused:
        ask("upload", name="folder.fmu", text="UEsD")


GESTURES = st.one_of(
    st.builds(lambda t, x: ("insert", {"entry": {"type": t}, **({"at": [x, x]} if x else {})}),
              st.sampled_from(["Gain", "Sum", "Integrator", "Step", "PID"]), st.sampled_from([0, 40, -200])),
    st.builds(lambda k, m: ("wire", (k, m)), st.integers(0, 9), st.integers(0, 9)),
    st.builds(lambda k: ("delete", k), st.integers(0, 9)),
    st.builds(lambda k, dx: ("place", (k, dx)), st.integers(0, 9), st.sampled_from([-20, 10, 130])),
    st.builds(lambda k: ("duplicate", k), st.integers(0, 9)),
    st.builds(lambda k: ("group", k), st.integers(0, 9)),
    st.builds(lambda k: ("rename", k), st.integers(0, 9)),
    st.builds(lambda k: ("cut and paste", k), st.integers(0, 9)),
    st.builds(lambda k: ("ungroup", k), st.integers(0, 9)),
    st.builds(lambda k: ("swap", k), st.integers(0, 9)),
    st.builds(lambda t: ("define", t), st.sampled_from([
        ("parameter", "kp=20 V"), ("parameter", "kp=1"), ("input", "r=1"), ("measure", "peak of=gain.y"),
        ("entry", "run.stop=5"),
    ])),
    st.builds(lambda k, t: ("put", (k, t)), st.integers(0, 9), st.sampled_from(["3", "=kp*2", "", "[1]", "4 V", "x"])),
    st.builds(lambda k, t: ("describe", (k, t)), st.integers(0, 9), st.sampled_from(["", "a text", "two\nlines"])),
    st.builds(lambda k: ("output", k), st.integers(0, 9)),
    st.builds(lambda n: ("another program", n), st.integers(0, 3)),
    st.sampled_from([("arrange", None), ("undo", None), ("redo", None)]),
)  # fmt: skip


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(GESTURES, min_size=1, max_size=12))
def test_random_gestures_keep_the_file_canonical_and_are_undone_byte_for_byte(
    tmp_path: Path, asked: list[tuple[str, Any]]
) -> None:
    path = tmp_path / "random.json"
    path.unlink(missing_ok=True)
    with edited(path) as (ask, editor):
        texts: list[bytes | None] = [path.read_bytes()]
        for do, what in asked:
            value = Diagram.load(path).value
            names = list(value.blocks) or ["none"]
            pick = names[what % len(names)] if isinstance(what, int) else ""
            steps = len(editor.done)
            with suppress(BlocksError):
                if do == "insert":
                    ask("insert", **what)
                elif do == "wire":
                    one, two = (names[k % len(names)] for k in what)
                    ask("edit", operations=[{"wire": f"{one}.y", "to": f"{two}.u"}])
                elif do == "place":
                    ask("place", names=[names[what[0] % len(names)]], by=[what[1], 10])
                elif do == "delete":
                    ask("delete", names=[pick], sinks=[])
                elif do == "duplicate":
                    ask("duplicate", names=[pick])
                elif do == "group":
                    ask("edit", operations=[{"group": [pick], "as": f"{pick}_group"}])
                elif do == "cut and paste":
                    text = ask("copy", names=[pick])["text"]
                    ask("delete", names=[pick], sinks=[])
                    ask("paste", text=text)
                elif do == "ungroup":
                    ask("edit", operations=[{"ungroup": pick}])
                elif do == "swap":
                    ask("edit", operations=[{"swap": pick, "for": {"type": "Gain"}}])
                elif do == "define":
                    ask("define", kind=what[0], text=what[1])
                elif do == "put":
                    ask("put", name=f"{names[what[0] % len(names)]}.k", text=what[1])
                elif do == "describe":
                    ask("describe", of=names[what[0] % len(names)], text=what[1])
                elif do == "output":
                    ask("define", kind="output", text="y", source=f"{pick}.y")
                elif do == "another program":
                    other = Diagram.load(path).value
                    path.write_text(dumps(replace(other, run={**other.run, "stop": what + 1})))
                    editor._catch_up()
                elif do == "rename":
                    ask("edit", operations=[{"rename": ["blocks", pick], "to": f"{pick}x"}])
                else:
                    ask(do, **({"names": []} if do == "arrange" else {}))
            text = path.read_bytes()
            assert text == editor.text == dumps(Diagram.load(path).value).encode()
            assert dict(editor.body("")) == json.loads(text)  # the file is the model
            if len(editor.done) > steps + 1:  # cut and paste
                texts = [*texts[: steps + 1], None, text]
            elif len(editor.done) > steps:
                texts = [*texts[: steps + 1], text]
            assert texts[len(editor.done)] in (text, None)  # between cut and paste
            editor.drawing("")
        while editor.done:
            ask("undo")
            assert texts[len(editor.done)] in (path.read_bytes(), None)


@pytest.mark.long
def test_a_motor_under_control_is_drawn_by_hand_run_and_undone(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    server = LiveServer(path, edit=True).start()
    empty = path.read_bytes()
    try:
        with chromium() as page:
            page.open(server.url)
            page.until("!document.getElementById('edits').hidden")

            def settled(what: str) -> None:
                page.until(f"document.querySelectorAll('#stage {what}').length > 0")

            def box(name: str) -> tuple[float, float]:
                x, y = page.evaluate(
                    f"(b => [b.x + b.width / 2, b.y + b.height / 2])(document.querySelector("
                    f"'#stage [data-path={name}] .face').getBoundingClientRect())"
                )
                return x, y

            def port(name: str, kind: str, own: str) -> tuple[float, float]:
                x, y = page.evaluate(
                    f"(() => {{ const box = document.querySelector('#stage [data-path={name}]');"
                    f" const [x, y] = box.dataset.at.split(' ').map(Number);"
                    f" const [dx, dy] = box.dataset.{kind}.split(';').map(one => one.split(' '))"
                    f".find(one => one[2] === '{own}').map(Number);"
                    " const at = document.querySelector('#stage').getBoundingClientRect();"
                    " const k = at.width / document.querySelector('#stage svg').width.baseVal.value;"
                    " return [at.x + (x + dx) * k, at.y + (y + dy) * k]; })()"
                )
                return x, y

            page.evaluate("document.getElementById('view').focus()")
            for text, name in (
                ("step at=1 after=2 unit=rad/s", "step"), ("pid kp=20 ki=30 unit=rad/s unit_u=V", "pid"),
                ("pmdc", "pmdc_motor"),
            ):  # fmt: skip
                page.press(text[0])  # the first letter counts
                page.until("document.querySelector('dialog.search li')")
                page.type(text[1:])
                page.press("Enter")
                settled(f"[data-path={name}]")
            page.still("#stage")
            x, y = box("pmdc_motor")
            page.drag(x, y, x + 200, y - 60)
            page.until("document.querySelector('#stage svg').dataset.origin")
            for source, sink in (("step.y", "pid.r"), ("pid.u", "pmdc_motor.v"), ("pmdc_motor.omega", "pid.y")):
                page.still("#stage")  # the page redraws, and a wire begins at the final place of its port
                page.drag(*port(source.split(".")[0], "out", source.split(".")[1]),
                          *port(sink.split(".")[0], "in", sink.split(".")[1]))  # fmt: skip
                settled(f'[data-sink="{sink}"]')
            page.still("#stage")
            page.drag(*port("step", "out", "y"), *port("pmdc_motor", "in", "tau"))
            page.until("document.querySelector('#edits .refusal').innerText.includes('different quantities')")
            page.click_at(*box("pid"))
            page.press("F2")
            page.until("document.querySelector('.typed')")
            page.type("control")
            page.press("Enter")
            settled("[data-path=control]")
            assert Diagram.load(path).check()
            steps = len(server._open.document.done)  # type: ignore[attr-defined]
            page.press(*steps * ["Control+z"])
            page.until("!document.querySelector('#stage [data-path]')")
            page.assert_clean()
        assert path.read_bytes() == empty
    finally:
        server.stop()


def test_an_editor_that_is_killed_while_it_writes_leaves_a_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, _):
        loop(ask)
        before = path.read_bytes()
        with suppress(KeyboardInterrupt), write_atomically(path, was=before) as stream:
            stream.write(before.decode()[:50])
            stream.flush()
            assert path.read_bytes() == before  # what a kill here would leave
            raise KeyboardInterrupt
        ask("put", name="pid.kp", text="5")
        assert [file.name for file in tmp_path.iterdir()] == ["motor.json"]


def test_a_diagram_opens_the_file_it_was_saved_in_or_loaded_from_and_one_without_says_how(tmp_path: Path) -> None:
    path, other = tmp_path / "motor.json", tmp_path / "other.json"
    with edited(path) as (ask, _):
        loop(ask)
    loaded = Diagram.load(path)
    made = Diagram("motor")
    with pytest.raises(UsageError, match="save"):
        made.edit()
    for diagram, saved in ((loaded, None), (made, other), (loaded, other)):
        if saved:
            diagram.save(saved)
        server = diagram.edit()
        try:
            assert isinstance(server._open.document, Editor)
            assert server._open.document.file == (saved or path)
        finally:
            server.stop()
    with pytest.raises(UsageError, match="save"):
        made.copy().edit()
