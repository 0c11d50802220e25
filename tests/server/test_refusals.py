"""What each message of a page is refused: a table with a row for every message, so that a new one needs one, too."""

from __future__ import annotations

import inspect
import json
import os
import shutil
import typing
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Any

import pytest

from blocks import BlocksError, Case, Diagram, Gain, ModelError, UsageError
from blocks.server import analysis_messages, gestures, knobs, map_messages, panel, scope_messages  # noqa: F401  # their messages
from blocks.server.editor import Editor
from blocks.server.messages import HANDLERS, answer
from blocks.server.open_document import Document
from blocks.server.scopes import Page
from blocks.server.session import Session
from tests.support.places import ROOT

Row = tuple[dict[str, Any], str]
NO_RUN = "there is no run"
SHOWN = "is open for viewing only"
OUTSIDE = "lies outside the diagram's folder"
PLACES = (
    "../run.csv", "/tmp/run.csv", "a/../../run.csv", "out/run.csv", "out", "", ".", "..", "run\0.csv", "run\n.csv",
    "link.csv",
)  # fmt: skip
"""Names of files that lead out of the folder; `out` is a link to another one, and link.csv to a file there."""
TABLE: dict[str, list[Row]] = {
    "draw": [({"level": "nothing"}, "nothing"), ({"level": "gain"}, "gain")],
    "panel": [({"path": "nothing"}, "nothing"), ({"path": "../gain"}, "gain")],
    "knobs": [],  # of names that are not there it tells nothing
    "set": [
        ({"name": "nothing", "value": 1}, "nothing"),
        ({"name": "gain.k", "value": "import os"}, "gain.k"),
        ({"name": "gain.k", "value": {"value": 1}}, "gain.k"),
        ({"name": "gain.type", "value": "Sum"}, "gain.type"),
        ({"name": "gain.library", "value": "os"}, "gain.library"),
        ({"name": "gain.fmu", "value": "/x.fmu"}, "gain.fmu"),
    ],
    "reset": [],
    "variant": [({"path": "gain", "name": "nothing"}, "nothing"), ({"path": "nothing", "name": "a"}, "nothing")],
    "keep": [({}, "has no file")],
    "script": [({}, "has no file")],
    "run": [({"stop": "soon"}, "soon"), ({"stop": -1.0}, "stop"), ({"stop": 1.0, "pace": 0.0}, "pace")],
    "pause": [({}, NO_RUN)],
    "resume": [({}, NO_RUN)],
    "step": [({"stop": "soon"}, "soon")],
    "stop": [({}, NO_RUN)],
    "cancel": [],  # of what nobody asked it ends nothing
    "scope": [],  # of signals that are not there it shows nothing
    "drawn": [],
    "values": [],
    "runs": [],
    "ghost": [({"run": 7, "on": True}, "run 7"), ({"run": -1, "on": True}, "run -1")],
    "overlay": [({"name": "a.csv", "text": "no table"}, "a.csv"), ({"name": "a.csv", "text": ""}, "a.csv")],
    "save": [*(({"path": path}, OUTSIDE) for path in PLACES), ({"path": "run.csv"}, NO_RUN)],
    "response": [({"input": "nothing"}, "nothing"), ({"input": "u", "output": "nothing"}, "nothing")],
    "modes": [({"amplitude": {"nothing": 1.0}}, "nothing"), ({"at": "end"}, "end"), ({"at": 1e9}, "no run")],
    "cycles": [],
    "loop_map": [
        ({}, "no block with an output u"),
        ({"control": "gain.y", "output": "gain.y", "over": {"gain.k": []}}, "names 1 parameters"),
        ({"control": "gain.y", "output": "gain.y", "over": {"gain.k": [], "nothing": []}}, "nothing"),
    ],
    "color": [({"by": "__class__"}, "__class__")],
    "band": [
        *(({"signal": "gain.y", "file": path}, OUTSIDE) for path in PLACES if path),
        ({"signal": "gain.y", "parameter": "gain.k", "high": 1.0, "n": 10**9}, "rows"),
        ({"signal": "gain.y", "parameter": "gain.k", "low": 2.0, "high": 1.0}, "limits"),
        ({"signal": "gain.y"}, "needs a parameter"),
    ],
    "edit": [({"operations": [{"set": "name", "to": "other"}]}, SHOWN), ({"operations": [{"file": "x"}]}, "level")],
    "undo": [({}, SHOWN)],
    "redo": [({}, SHOWN)],
    "palette": [({}, SHOWN)],
    "insert": [({"entry": {"type": "Gain"}}, SHOWN)],
    "place": [({"names": ["gain"], "by": [1.0, 1.0]}, SHOWN)],
    "arrange": [({"names": []}, SHOWN)],
    "delete": [({"names": ["gain"], "sinks": []}, SHOWN)],
    "copy": [({"names": ["gain"]}, SHOWN)],
    "paste": [({"text": "{}"}, SHOWN)],
    "duplicate": [({"names": ["gain"]}, SHOWN)],
    "put": [({"name": "gain.k", "text": "1"}, SHOWN)],
    "put_all": [({"values": {"gain.k": "1"}}, SHOWN)],
    "define": [({"kind": "input", "text": "r"}, SHOWN)],
    "describe": [({"of": "gain", "text": "x"}, SHOWN)],
    "targets": [({"end": "gain.y"}, SHOWN)],
    "tab": [({"file": "x.json"}, SHOWN)],
    "upload": [({"name": "x.fmu", "text": ""}, SHOWN)],
    "import_model": [({"name": "x.slx", "text": ""}, SHOWN)],
}
WRONG: dict[Any, list[Any]] = {
    str: [1, True, ["a"], {"a": 1}, "x" * 501],
    bool: [0, 1, "true", []],
    int: [1.5, True, "1", 10**301, [1]],
    float: ["1", True, float("nan"), float("inf"), 1e301, -(10**400), [1.0]],
    list: ["a", {"a": 1}, [["a"]], [None], 1001 * ["a"], [501 * "a"]],
    dict: ["a", ["a"], {"a": None}, {501 * "a": 1.0}],
}
"""By type, values that are not of it, or too large."""


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    """That of a diagram without a file, in a folder with links that lead out of it."""
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file.csv").touch()
    folder = tmp_path / "project"
    folder.mkdir()
    (folder / "out").symlink_to(tmp_path / "other")
    (folder / "link.csv").symlink_to(tmp_path / "other" / "file.csv")
    loop = Diagram("loop")
    u = loop.input("u", default=1.0)
    loop.wire(loop.add("gain", Gain(k=2.0)).u, u)
    before = Path.cwd()
    os.chdir(folder)
    made = Session(Document(loop))
    yield made
    made.close()
    os.chdir(before)
    assert sorted(path.name for path in folder.iterdir()) == ["link.csv", "out"]
    assert (tmp_path / "other" / "file.csv").read_bytes() == b""


EMPTY_ZIP = "UEsFBgAAAAAAAAAAAAAAAAAAAAAAAA=="
EDITED: dict[str, list[Row]] = {
    "insert": [
        ({"entry": {}}, 'must have a "type"'),
        ({"entry": {"type": "os.system"}}, "no such block type"),
        ({"entry": {"diagram": "../other/file.json"}}, "outside the project|cannot be read"),
        ({"entry": {"type": "Gain"}, "at": [1.0]}, "is not a position"),
        ({"entry": {"type": "Gain"}, "at": [1e300, 0.0]}, "farther than"),
        ({"entry": {"type": "Gain"}, "level": "nothing"}, "no block"),
        ({"entry": {"type": "Gain"}, "source": "nothing.y"}, "nothing"),
    ],
    "edit": [
        ({"operations": [{"file": "../other/x.json", "set": "name", "to": "x"}]}, "level that the page shows"),
        ({"operations": [{"set": "blocks.gain", "to": {"diagram": "/etc/passwd"}}]}, "outside the project"),
        ({"operations": [{"remove": "format"}]}, "format"),
    ],
    "place": [
        ({"names": ["nothing"], "by": [1.0, 1.0]}, "nothing"),
        ({"names": ["gain"], "by": [1e300, 0.0]}, "farther"),
    ],
    "delete": [({"names": ["nothing"], "sinks": []}, "do not exist")],
    "paste": [
        ({"text": "{}"}, "contains no part"),
        ({"text": '{"layout": [1], "blocks": {"g": {"type": "Gain"}}}'}, "layout"),
        ({"text": '{"layout": [1], "blocks": {"g": {"type": "Gain"}}}', "at": [1.0, 1.0]}, "layout"),
        ({"text": "[" * 1000}, "not JSON"),
    ],
    "put": [
        ({"name": "nothing.k", "text": "1"}, "no such block"),
        ({"name": "__class__", "text": "1"}, "no such parameter"),
    ],
    "define": [
        ({"kind": "block", "text": "x"}, "cannot be added"),
        ({"kind": "parameter", "text": "a b=1"}, "not a name"),
    ],
    "describe": [({"of": "nothing", "text": "x"}, "nothing")],
    "targets": [({"end": "nothing.y"}, "no such port")],
    "tab": [
        ({"file": path}, "lies outside|not a diagram that can be opened") for path in (*PLACES, "/etc/passwd", "~")
    ],
    "import_model": [
        *(({"name": path, "text": ""}, "outside|not the name of a Simulink model") for path in PLACES),
        ({"name": "below/x.slx", "text": ""}, "not the name of a Simulink model"),
        ({"name": "x.slx", "text": "?"}, "not base64"),
        ({"name": "x.mdl", "text": "bm90aGluZw=="}, "begins no Model"),
    ],
    "upload": [
        *(({"name": path, "text": ""}, "outside|not the name of an FMU") for path in PLACES),
        ({"name": "out/x.fmu", "text": ""}, "outside"),
        ({"name": "below/x.fmu", "text": ""}, "not the name of an FMU"),
        ({"name": "x.fmu", "text": "?"}, "not base64"),
        ({"name": "x.fmu", "text": "bm90aGluZw=="}, "is not a zip archive"),
        ({"name": "x.fmu", "text": EMPTY_ZIP}, "no terminal to ask"),
    ],
}
"""What pages may not ask of a diagram that they edit, and what is said: nothing is written."""


@pytest.mark.parametrize("name", sorted(EDITED))
def test_gestures_that_are_refused_write_nothing(name: str, tmp_path: Path) -> None:
    folder, other = tmp_path / "project", tmp_path / "other"
    for one in (folder, other, folder / "below"):
        one.mkdir()
    (folder / "out").symlink_to(other)
    (folder / "link.csv").symlink_to(other / "file.csv")
    (other / "file.csv").touch()
    loop = Diagram("loop")
    loop.wire(loop.add("gain", Gain(k=2.0)).u, loop.input("u", default=1.0))
    loop.save(folder / "loop.json")
    session = Session(Editor(folder / "loop.json", str))
    before = {path: path.read_bytes() if path.is_file() else b"" for path in sorted(tmp_path.rglob("*"))}
    try:
        for fields, message in EDITED[name]:
            with pytest.raises((ModelError, UsageError), match=message):
                answer(session, {"do": name, **fields})
            assert {p: p.read_bytes() if p.is_file() else b"" for p in sorted(tmp_path.rglob("*"))} == before
    finally:
        session.close()


def fields_of(name: str) -> dict[str, tuple[Any, bool]]:
    """The type of each field of a message, and whether it must be there."""
    parameters = inspect.signature(HANDLERS[name]).parameters.values()
    hints = typing.get_type_hints(HANDLERS[name])
    return {p.name: (hints[p.name], p.default is p.empty) for p in parameters if p.kind is p.KEYWORD_ONLY}


def test_every_message_has_a_row() -> None:
    assert set(TABLE) == set(HANDLERS)


def test_no_message_brings_code_or_opens_the_server() -> None:
    names = {field for name in HANDLERS for field in fields_of(name)}
    assert not names & {"library", "module", "trust", "fmu", "host", "port", "token", "engine", "command", "script"}


@pytest.mark.parametrize("name", sorted(HANDLERS))
def test_fields_are_what_the_message_declares(name: str, session: Session) -> None:
    fields = fields_of(name)
    fine = {str: "a", bool: True, int: 1, float: 1.0, list: [], dict: {}, Any: 1}

    def some(kind: Any) -> Any:
        options = typing.get_args(kind) if isinstance(kind, UnionType) else (kind,)
        return fine[typing.get_origin(options[0]) or options[0]]

    whole = {key: some(kind) for key, (kind, must) in fields.items() if must}
    wrong: list[tuple[dict[str, Any], str]] = [({**whole, "library": ["os"]}, f"{name}.library: is not a known key")]
    for key, (kind, must) in fields.items():
        if must:
            wrong.append(({k: v for k, v in whole.items() if k != key}, f"{name}.{key}: is missing"))
        options = {typing.get_origin(each) or each for each in typing.get_args(kind) or (kind,)}
        if kind is not Any and (typing.get_origin(kind) in (list, dict)):
            options = {typing.get_origin(kind)}
        values = WRONG[(options & set(WRONG)).pop()] if len(options & set(WRONG)) == 1 else [[1], {"a": 1}, "x" * 501]
        deep: Any = 1.0
        for _ in range(20):
            deep = [deep]
        if key == "text":
            values = [value for value in values if not isinstance(value, str)]
        wrong += [({**whole, key: value}, f"{name}.{key}: must be") for value in (*values, deep) if kind is not Any]
        wrong += [
            ({**whole, key: value}, f"{name}.{key}: must be") for value in (deep, 1e301, 501 * "x") if kind is Any
        ]
    for given, said in wrong:
        with pytest.raises(UsageError) as refused:
            answer(session, {"do": name, **given}, None)
        assert said in str(refused.value), (given, str(refused.value))
    assert session.live is None


@pytest.mark.parametrize(("name", "given", "said"), [(name, *row) for name, rows in TABLE.items() for row in rows])
def test_what_a_message_means_is_refused(name: str, given: dict[str, Any], said: str, session: Session) -> None:
    with pytest.raises(BlocksError) as refused:
        answer(session, {"do": name, **given}, Page())
    assert all(fault.message.endswith(".") for fault in refused.value.faults)
    assert said in str(refused.value)


def test_a_live_run_takes_the_fmus_that_a_run_takes(tmp_path: Path) -> None:
    project = tmp_path / "project"
    project.mkdir()
    (project / "pyproject.toml").touch()
    shutil.copy(ROOT / "fmus" / "PMDCMotor.fmu", tmp_path / "m.fmu")
    text = {
        "format": "blocks-diagram", "version": 3, "name": "motor",
        "blocks": {"motor": {"fmu": "../m.fmu", "kind": "ME"}, "v": {"type": "Constant"}},
        "wires": {"motor.v": "v.y"}, "run": {"stop": 1},
    }  # fmt: skip
    path = project / "motor.json"
    path.write_text(json.dumps(text))
    with pytest.raises(BlocksError, match="E218") as refused:
        Diagram.load(path).run()
    for trust in ((), str(project)):
        session = Session(Document(path), Case(trust=trust))
        for message in ({"do": "run"}, {"do": "step"}, {"do": "modes"}):
            with pytest.raises(BlocksError, match="E218") as again:
                answer(session, message, None)
            assert again.value.faults == refused.value.faults
        session.close()


def test_a_file_that_was_changed_by_others_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "loop.json"
    loop = Diagram("loop")
    loop.wire(loop.add("gain", Gain(k=2.0)).u, loop.input("u"))
    loop.save(path)
    session = Session(Document(path))
    answer(session, {"do": "set", "name": "gain.k", "value": 3.0}, None)
    changed = path.read_text().replace('"loop"', '"theirs"')
    path.write_text(changed)
    with pytest.raises((UsageError, ModelError), match="has changed since it was read"):
        answer(session, {"do": "keep"}, None)
    assert path.read_text() == changed
    session.close()
