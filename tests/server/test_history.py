"""Undo of a diagram whose files other programs write meanwhile: no step is in the way of those before it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from blocks import BlocksError, Diagram, Gain, Step, subdiagram
from blocks.editing.edits import Edit

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

    with edited(tmp_path / "outer.json") as (ask, _):
        ask("put", name="step.after", text="5")
        before = [path.read_bytes() for path in (sub, tmp_path / "outer.json")]
        ask("put", name="g.k", text="3", level="inside")
        with edited(sub) as (elsewhere, _):
            elsewhere("put", name="g.k", text="4")
        ask("put", name="step.after", text="6")
        assert gain() == 4
        assert [ask("undo")["what"] for _ in range(2)] == ["undone: set step.after", "undone: the change on disk"]
        assert gain() == 3
        ask("redo")
        assert gain() == 4
        ask("undo")
        ask("undo")
        assert [path.read_bytes() for path in (sub, tmp_path / "outer.json")] == before
