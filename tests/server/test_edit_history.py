"""Undo of a diagram whose files other programs write meanwhile: no step is in the way of those before it."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from blocks import BlocksError, Diagram, Gain, Step, subdiagram
from blocks.editing.edits import Edit
from blocks.server.session import Session

from .test_editor import edited, loop


def test_two_texts_of_another_program_with_the_same_fault_are_undone(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        loop(ask)
        ours = path.read_text()
        broken = ours.replace('"type": "Step", ', "", 1)
        assert broken != ours
        for doc in ("A", "B!"):
            path.write_text(broken.replace('"name": "motor"', f'"name": "motor", "doc": "{doc}"'))
            assert editor.read()
        assert not editor.read()
        with pytest.raises(BlocksError, match="cannot be read"):
            ask("put", name="pid.kp", text="1")
        ask("undo")
        assert '"doc": "A"' in path.read_text()
        ask("undo")
        assert path.read_text() == ours
        ask("undo")
        assert "stop" not in path.read_text()


def test_what_is_no_utf_8_is_undone_and_done_again(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        loop(ask)
        ours = path.read_bytes()
        theirs = ours.replace(b"motor", b"mot\xf6r", 1)
        path.write_bytes(theirs)
        assert editor.read()
        for gesture, text in (("undo", ours), ("redo", theirs), ("undo", ours)):
            ask(gesture)
            assert path.read_bytes() == text


def test_a_program_that_writes_as_soon_as_we_did_is_a_step_behind_the_gesture(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        loop(ask)
        ours = path.read_text()
        write = Edit.write

        def then_another(edit: Edit) -> None:
            write(edit)
            if "7" in next(iter(edit.texts.values())):
                path.write_text(path.read_text() + "\n")

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Edit, "write", then_another)
            ask("put", name="pid.kp", text="7")
        assert [step.what for step in editor.done[-2:]] == ["set pid.kp", "the change on disk"]
        ask("undo")
        ask("undo")
        assert path.read_text() == ours
        for _ in range(2):
            ask("redo")
        assert path.read_text() == ours.replace('"kp": 20', '"kp": 7') + "\n"


def test_what_another_program_writes_into_a_subdiagram_is_undone_in_its_order(tmp_path: Path) -> None:
    inner, outer, sub = Diagram("sub"), Diagram("outer"), tmp_path / "sub.json"
    inner.wire(inner.add("g", Gain(k=2.0)).u, inner.input("u", default=0.0))
    inner.output("y", "g.y")
    inner.save(sub)
    outer = Diagram("outer", folder=tmp_path)
    outer.wire(outer.add("inside", subdiagram("sub.json")).u, outer.add("step", Step()).y)
    outer.save(tmp_path / "outer.json")

    def gain() -> Any:
        return json.loads(sub.read_text())["blocks"]["g"]["parameters"]["k"]

    with edited(tmp_path / "outer.json") as (ask, editor):
        ask("put", name="step.after", text="5")
        before = [path.read_bytes() for path in (sub, tmp_path / "outer.json")]
        ask("put", name="g.k", text="3", level="inside")
        with edited(sub) as (elsewhere, _):
            elsewhere("put", name="g.k", text="4")
        assert editor.read()
        ask("put", name="step.after", text="6")
        assert gain() == 4
        assert [ask("undo")["what"] for _ in range(2)] == ["undone: set step.after", "undone: the change on disk"]
        assert gain() == 3
        ask("redo")
        assert gain() == 4
        ask("undo")
        ask("undo")
        assert [path.read_bytes() for path in (sub, tmp_path / "outer.json")] == before


def test_a_text_that_is_being_written_is_no_step_and_undo_never_writes_it(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        loop(ask)
        ours, steps = path.read_text(), len(editor.done)
        theirs = ours.replace('"kp": 20', '"kp": 21')
        for text in ("", ours[:100], theirs):
            path.write_text(text)
            editor.read()
        assert [step.what for step in editor.done[steps:]] == ["the change on disk"]
        ask("undo")
        assert path.read_text() == ours
        ask("redo")
        assert path.read_text() == theirs
        ask("undo")
        path.write_text(theirs[:100])  # and stays as it is
        editor.read()
        assert (editor.offered, len(editor.done)) == ({"undo": "the change on disk", "redo": ""}, steps)
        ask("undo")
        assert path.read_text() == ours


def test_a_file_that_was_emptied_is_written_again_and_not_taken_for_a_new_one(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        loop(ask)
        ours = path.read_text()
        path.write_text("")
        assert (editor.read(), editor.read()) == (True, False)
        with pytest.raises(BlocksError, match=r"emptied.*Undo to write the file again"):
            ask("put", name="pid.kp", text="1")
        ask("undo")
        assert path.read_text() == ours


def test_a_step_on_a_file_that_another_program_wrote_since_is_told_and_passed_over(tmp_path: Path) -> None:
    sub, path = tmp_path / "sub.json", tmp_path / "motor.json"
    inner = Diagram("sub")
    inner.wire(inner.add("g", Gain(k=2.0)).u, inner.input("u", default=0.0))
    inner.output("y", "g.y")
    inner.save(sub)
    with edited(path) as (ask, editor):
        loop(ask)
        ours = path.read_text()
        ask("insert", entry={"diagram": "sub.json"}, source="step.y")
        ask("edit", operations=[{"rename": ["inputs", "u"], "to": "v"}], level="sub")
        ask("put", name="g.k", text="3", level="sub")
        ask("delete", names=["sub"], sinks=[])
        theirs = sub.read_text().replace('"k": 3', '"k": 4')
        sub.write_text(theirs)  # which nobody reads any more
        ask("undo")
        for what in ("set g.k", "rename"):
            with pytest.raises(BlocksError, match=f'sub.json: was changed by another program after "{what}".*the rest'):
                ask("undo")
        assert [ask("undo")["what"] for _ in range(2)] == ["undone: rename", "undone: insert sub"]
        assert (path.read_text(), sub.read_text()) == (ours, theirs)
        assert editor.offered["redo"] == "insert sub"


def test_what_leads_out_of_the_folder_or_is_no_file_is_not_written(tmp_path: Path) -> None:
    path, other = tmp_path / "project" / "motor.json", tmp_path / "other.json"
    path.parent.mkdir()
    Diagram("other").save(other)
    with edited(path) as (ask, editor):
        loop(ask)
        ours, theirs = path.read_bytes(), other.read_bytes()
        path.unlink()
        path.symlink_to(other)
        editor.read()
        for do, fields in (("undo", {}), ("define", {"kind": "parameter", "text": "k=1"})):
            with pytest.raises(BlocksError, match="now links to another file"):
                ask(do, **fields)
        path.unlink()
        os.mkfifo(path)
        with pytest.raises(BlocksError, match="the file is no longer an ordinary file"):
            ask("undo")
        path.unlink()
        assert other.read_bytes() == theirs
        ask("undo")
        ask("undo")
        assert path.read_bytes() == ours


def test_nothing_is_done_again_after_another_gesture_or_program(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        loop(ask)
        ask("undo")
        ask("put", name="pid.kp", text="7")
        with pytest.raises(BlocksError, match="nothing to redo"):
            ask("redo")
        ask("undo")
        path.write_text(path.read_text().replace('"kp": 20', '"kp": 21'))
        with pytest.raises(BlocksError, match="nothing to redo"):
            ask("redo")
        assert editor.offered == {"undo": "the change on disk", "redo": ""}


def test_a_change_of_equal_size_and_time_is_read(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, _):
        loop(ask)
        ours, found = path.read_text(), path.stat()
        path.write_text(ours.replace('"kp": 20', '"kp": 21'))
        os.utime(path, ns=(found.st_atime_ns, found.st_mtime_ns))
        with pytest.raises(BlocksError, match="changed by another program"):
            ask("put", name="pid.ki", text="31")
        ask("put", name="pid.ki", text="31")
        assert '"kp": 21, "ki": 31' in path.read_text()
        ask("undo")
        ask("undo")
        assert path.read_text() == ours


def test_a_deletion_is_shown_and_undone_before_any_gesture(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        ours = path.read_bytes()
        path.unlink()
        assert (editor.has_changed(), editor.read(), editor.read()) == (True, True, False)
        assert editor.told()["editing"]["undo"] == "the deletion on disk"
        ask("undo")
        assert (path.read_bytes(), editor.offered["undo"]) == (ours, "")
        assert editor.read()  # so that all pages see it


def test_a_gesture_that_is_refused_shows_what_another_program_wrote(tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    with edited(path) as (ask, editor):
        loop(ask)
        path.write_text(path.read_text().replace('"kp": 20', '"kp": 21'))
        told: list[int] = []
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Session, "tell_document", lambda session: told.append(session.document.revision))
            with pytest.raises(BlocksError, match="changed by another program"):
                ask("edit", operations=[{"wire": "step.y", "to": "pid.y"}])
            with pytest.raises(BlocksError, match="is already driven by"):
                ask("edit", operations=[{"wire": "step.y", "to": "pid.y"}])
        assert told == [editor.revision]


def test_steps_hold_what_differs_so_that_all_gestures_are_undone(tmp_path: Path) -> None:
    path = tmp_path / "many.json"
    with edited(path) as (ask, editor):
        empty = path.read_bytes()
        blocks = {f"gain{k}": {"type": "Gain", "parameters": {"k": k}} for k in range(200)}
        ask("paste", text=json.dumps({"blocks": blocks}))
        many = path.read_bytes()
        for k in range(10):
            ask(
                "edit",
                operations=[{"move": f"gain{k}", "to": [k, -k]}, {"set": f"blocks.gain{199 - k}.doc", "to": "é"}],
            )
        assert sum(step.size for step in editor.done) < 10 * len(many)
        for _ in range(10):
            ask("undo")
        assert path.read_bytes() == many
        ask("undo")
        assert path.read_bytes() == empty


def test_the_oldest_steps_are_forgotten_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("blocks.server.edit_history.MOST_BYTES", 5000)
    path = tmp_path / "text.json"
    with edited(path) as (ask, editor):
        for number in range(9):
            ask("describe", of="", text=str(number) * 1000)
        assert 2 <= len(editor.done) < 5
        assert sum(step.size for step in editor.done) <= 5000
        while editor.done:
            ask("undo")
        assert 3 <= int(json.loads(path.read_text())["doc"][0]) < 8


def test_a_subdiagram_that_another_program_changed_counts_after_a_move(tmp_path: Path) -> None:
    sub = tmp_path / "sub.json"
    inner = Diagram("sub")
    inner.wire(inner.add("g", Gain(k=2.0)).u, inner.input("u", default=0.0))
    inner.output("y", "g.y")
    inner.save(sub)
    with edited(tmp_path / "outer.json") as (ask, editor):
        ask("insert", entry={"type": "Step"})
        ask("insert", entry={"diagram": "sub.json"}, source="step.y")
        assert editor.facts["sub.g.k"].nominal == 2.0
        sub.write_text(sub.read_text().replace('"k": 2', '"k": 3'))
        with pytest.raises(BlocksError, match="changed by another program"):
            ask("place", names=["step"], by=[10, 0])
        ask("place", names=["step"], by=[10, 0])
        assert editor.facts["sub.g.k"].nominal == 3.0


def test_pictures_of_levels_that_are_gone_are_forgotten(tmp_path: Path) -> None:
    with edited(tmp_path / "motor.json") as (ask, editor):
        loop(ask)
        ask("edit", operations=[{"group": ["pid"], "as": "control"}])
        ask("draw", level="control")
        assert "control" in editor._pictures
        ask("undo")
        assert "control" not in editor._pictures
