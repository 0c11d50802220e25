"""`blocks live` and `Diagram.live()`: from the address to the end."""

from __future__ import annotations

import base64
import http.client
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from websockets.sync.client import ClientConnection, connect

from blocks import Diagram, Gain, ModelError
from blocks.cli import main
from blocks.fmi.callbacks import instances
from blocks.server.live_server import LiveServer
from blocks.server.open_document import Document
from blocks.server.session import Session
from tests.support.faulty import FAULTS, NEEDS_COMPILER, make
from tests.support.places import ROOT

MOTOR = str(ROOT / "diagrams/motor_pid.json")
FMUS = str(ROOT / "diagrams/paper/iadrc_fmu.json")
"""Two FMUs for Co-Simulation."""


@contextmanager
def page_of(url: str) -> Iterator[ClientConnection]:
    """The socket of a page that the address lets in."""
    parts = urlsplit(url)
    connection = http.client.HTTPConnection(parts.netloc, timeout=60)
    connection.request("GET", parts.path)
    response = connection.getresponse()
    path = response.getheader("Location") or parts.path  # a ticket leads to the page
    assert response.status == (200 if path == parts.path else 303)
    origin: Any = f"http://{parts.netloc}"
    with connect(f"ws://{parts.netloc}{path}ws", proxy=None, max_size=None, origin=origin) as page:
        yield page
    connection.close()


def asked(page: ClientConnection, **message: Any) -> dict[str, Any]:
    """The answer to a message."""
    page.send(json.dumps({**message, "id": 7}))
    while True:
        told = page.recv(timeout=60)
        if isinstance(told, str) and (answer := json.loads(told)).get("re") == 7:
            return dict(answer)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="there is no pseudo-terminal")
def test_an_fmu_that_came_through_the_page_is_asked_about_at_the_terminal(tmp_path: Path) -> None:
    import pty

    data = (ROOT / "fmus/PMDCMotor.fmu").read_bytes()
    ours, theirs = pty.openpty()
    words = [sys.executable, "-m", "blocks", "edit", "new.json", "--no-browser"]
    said = ""

    def read_until(text: str) -> None:
        nonlocal said
        while text not in said:
            assert select.select([ours], [], [], 60.0)[0], said
            said += os.read(ours, 4096).decode()

    with subprocess.Popen(words, stdin=theirs, stdout=theirs, stderr=theirs, cwd=tmp_path) as process:
        read_until("Ctrl-C ends it")
        url = next(word for word in said.split() if word.startswith("http://"))
        with page_of(url) as page:
            for answer, is_written in (("n", False), ("y", True)):
                said = ""
                os.write(ours, b"y\n")  # which answers nothing: it was typed before the question
                time.sleep(0.2)
                told = asked(page, do="upload", name="m.fmu", text=base64.b64encode(data).decode())
                assert told["waits"]
                read_until("[y/N]")
                assert not (tmp_path / "m.fmu").exists()
                os.write(ours, f"{answer}\n".encode())
                while (told := json.loads(page.recv(timeout=60))).get("is") != "permitted":
                    pass
                assert (told["fmu"], not told["why"]) == ("m.fmu", is_written)
                assert (tmp_path / "m.fmu").exists() == is_written
        process.send_signal(signal.SIGINT)
        process.wait(60)
    os.close(ours)
    os.close(theirs)


@pytest.mark.long
def test_a_command_prints_its_address_serves_and_ends_by_a_signal() -> None:
    words = [sys.executable, "-m", "blocks", "live", MOTOR, "--json", "--set", "pid.kp=0.5", "--input", "r=7"]
    for number in (signal.SIGINT, signal.SIGTERM):
        with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
            assert process.stdout is not None
            told = json.loads(process.stdout.readline())
            assert told["event"] == "live"
            with page_of(told["url"]) as page:  # waits until the diagram is read
                hello = json.loads(page.recv(timeout=60))
                assert (hello["is"], hello["document"]["name"]) == ("hello", "motor_pid")
                process.send_signal(number)
                rest = process.communicate(timeout=60)
            assert (process.returncode, *rest) == (128 + number, "", "")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            [MOTOR, "--host", "0.0.0.0"],
            "E501 --host 0.0.0.0: is refused: the server accepts connections from this machine only. To reach "
            "it from another",
        ),
        ([MOTOR, "--port", "70000"], "E501 --port 70000: is not a port: use a number from 0 to 65535."),
        (["no/such.json"], 'E007 "no/such.json" does not exist.'),
        ([str(ROOT)], f'E007 "{ROOT}" is a folder.'),
        ([MOTOR, "--set", "kp"], "E501 --set kp: is not NAME=VALUE."),
        ([MOTOR, "--variant", "kp"], "E501 --variant kp"),
        ([MOTOR, "--stop", "1"], "E501 blocks live: --stop is not an option of this command."),
    ],
)
def test_a_command_that_cannot_serve_says_why(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["live", *words]) == 2
    out, err = capsys.readouterr()
    assert (out, err[: len(said)]) == ("", said)


@pytest.mark.parametrize(
    ("file", "said"),
    [("no/new.json", "E501 no/new.json: cannot be written: No such file"), (".", 'E007 "." is a folder.')],
)
def test_an_editor_of_what_cannot_be_written_has_no_address(
    file: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["edit", file, "--no-browser"]) == 2
    out, err = capsys.readouterr()
    assert (out, err[: len(said)]) == ("", said)


@pytest.mark.parametrize("text", ["", "{", "[]", "\x00", '{"format": "blocks-diagram", "version": 99}'])
def test_a_file_with_faults_opens_and_tells_them(text: str, tmp_path: Path) -> None:
    path = tmp_path / "broken.json"
    path.write_text(text)
    server = LiveServer(path).start()
    try:
        with page_of(server.url) as page:
            document = json.loads(page.recv(timeout=60))["document"]
            assert document["faults"]
            assert document["faults"][0]["code"].startswith("E")
            assert asked(page, do="run")["is"] == "error"
            assert asked(page, do="draw")["is"] == "error"
    finally:
        server.stop()


def test_a_missing_file_leaves_no_server(tmp_path: Path) -> None:
    server = LiveServer(tmp_path / "none.json")
    with pytest.raises(ModelError, match=r"none\.json"):
        server.start()
    server.stop()


def test_a_notebook_shows_a_diagram_that_has_no_file(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list(os.environ):
        if name.startswith(("JUPYTERHUB", "COLAB", "KAGGLE", "BINDER")):
            monkeypatch.delenv(name)
    loop = Diagram("loop")
    loop.wire(loop.add("gain", Gain(k=2.0)).u, loop.input("u", default=3.0))
    server = loop.live(parameters={"gain.k": 5.0})
    try:
        html = server._repr_html_()
        assert f'<iframe src="{server.url}"' in html
        monkeypatch.setenv("JUPYTERHUB_USER", "somebody")
        told = server._repr_html_()
        assert "<iframe" not in told
        assert f"ssh -L {server.port}:127.0.0.1:{server.port}" in told
        with page_of(server.url) as page:
            assert json.loads(page.recv(timeout=60))["document"]["file"] == ""
            assert asked(page, do="panel", path="gain")["type"] == "Gain"
            assert asked(page, do="step", stop=1.0)["is"] == "run"
            assert asked(page, do="values", t=0.0)["values"]["gain.y"] == 15.0
            refused = asked(page, do="keep")
            assert refused["faults"][0]["message"] == "has no file to store the values in."
    finally:
        server.stop()


@pytest.mark.long
@pytest.mark.parametrize(("path", "pace"), [(MOTOR, 1.0), (FMUS, None)])
def test_what_python_leaves_behind_ends_with_it(path: str, pace: float | None, tmp_path: Path) -> None:
    program = (
        "from blocks import Diagram\n"
        f"server = Diagram.load({path!r}).live()\n"
        f"server._open.begin(1e4).go({pace})\n"
        "print(server.url)\n"
    )
    given: dict[str, Any] = {"cwd": ROOT, "timeout": 120, "env": {**os.environ, "TMPDIR": str(tmp_path)}}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, **given)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("http://127.0.0.1:")
    assert not list(tmp_path.iterdir())


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_ends_a_run_with_its_fmus(number: signal.Signals, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "blocks", "live", FMUS, "--json"]
    given: dict[str, Any] = {"cwd": ROOT, "text": True, "env": {**os.environ, "TMPDIR": str(tmp_path)}}
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **given) as process:
        assert process.stdout is not None
        with page_of(json.loads(process.stdout.readline())["url"]) as page:
            assert asked(page, do="run", stop=1e4)["state"] == "running"
            assert list(tmp_path.iterdir())
            process.send_signal(number)
            rest = process.communicate(timeout=60)
    assert (process.returncode, *rest) == (128 + number, "", "")
    assert not list(tmp_path.iterdir())


def test_fmus_are_freed_when_a_run_stops_ends_fails_or_gives_way_to_another() -> None:
    session = Session(Document(FMUS))
    for stop in (1e4, 1e4, 0.01):
        live = session.begin(stop)
        assert len(instances()) == 2  # those of the run before are gone
        live.go()
    assert live.wait(60)
    assert not instances()
    live = session.begin(1e4)
    live.stop()
    assert live.wait(60)
    assert not instances()
    live = session.begin(1e4)
    live._look = {}.__getitem__  # type: ignore[method-assign, assignment]  # a mistake of blocks itself
    live.go()
    assert live.wait(60)
    assert live.state == "failed"
    assert not instances()
    session.begin(1e4).go()
    session.close()
    assert not instances()


@pytest.mark.long
@NEEDS_COMPILER
def test_a_second_signal_ends_a_command_whose_fmu_hangs(tmp_path: Path) -> None:
    (tmp_path / "unpacked").mkdir()
    make(tmp_path, name="plant")
    fault = {"fault": FAULTS.index("hang"), "t_fault": 0.0}
    text = {"format": "blocks-diagram", "version": 3, "name": "hangs", "run": {"stop": 100}}
    text |= {"blocks": {"f": {"fmu": "plant.fmu", "kind": "CS", "parameters": fault}}}
    (tmp_path / "hangs.json").write_text(json.dumps(text))
    words = [sys.executable, "-m", "blocks", "live", str(tmp_path / "hangs.json"), "--json"]
    given: dict[str, Any] = {"cwd": ROOT, "text": True, "env": {**os.environ, "TMPDIR": str(tmp_path / "unpacked")}}
    given |= {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(words, **given) as process, ExitStack() as ends:
        ends.callback(process.kill)  # else a failed assertion waits for the FMU that hangs
        assert process.stdout is not None
        assert process.stderr is not None
        with page_of(json.loads(process.stdout.readline())["url"]) as page:
            assert asked(page, do="run")["state"] == "running"
            assert asked(page, do="draw")["is"] == "drawing"
            refused = asked(page, do="run")  # as there would be two of the FMU
            assert "computing one step" in refused["faults"][0]["message"]
            process.send_signal(signal.SIGINT)
            assert "a second Ctrl-C ends it at once" in process.stderr.readline()
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=60)
    assert process.returncode == 130
    assert not list((tmp_path / "unpacked").iterdir())
