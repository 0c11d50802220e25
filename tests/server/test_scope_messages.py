"""What pages ask of their scopes, of a session with real runs; and the same in a browser."""

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import blocks.server.scope_messages  # noqa: F401  # its messages
from blocks import Diagram, Gain, Results, Sine, ZeroOrderHold
from blocks.server import scopes, session
from blocks.server.messages import answer
from blocks.server.open_document import Document, inside
from blocks.server.scopes import Page
from blocks.server.session import Session
from blocks.server.transport import Transport, new_token
from blocks.text.errors import UsageError

from .test_scopes import unpacked

DIAGRAMS = Path(__file__).parents[2] / "diagrams"
Do = Callable[..., dict[str, Any]]


class Client:
    """A page that nobody sees."""

    def send(self, message: Any, slot: str = "") -> bool:
        return True

    def answered(self) -> None:
        pass


@pytest.fixture
def motor(tmp_path: Path) -> Iterator[tuple[Session, Page, Do]]:
    """A session of a PID loop with a page of no browser, and what answers it."""
    path = tmp_path / "lab" / "motor_pid.json"
    path.parent.mkdir()
    path.write_bytes((DIAGRAMS / "motor_pid.json").read_bytes())
    made, page = Session(Document(path)), Page()
    made.pages[Client()] = page
    yield made, page, lambda do, **fields: answer(made, {"do": do, **fields}, page) or {}
    made.close()


def run(made: Session, stop: float = 0.2) -> Results:
    live = made.begin(stop)
    live.go()
    assert live.wait(60.0)
    return live.results()


def test_frames_and_values_are_those_of_the_results(motor: tuple[Session, Page, Do]) -> None:
    made, _, do = motor
    page = Page()  # which the session does not feed
    answer(made, {"do": "scope", "scope": "1", "signals": ["motor.omega"], "width": 8000}, page)
    results = run(made)
    frames = [unpacked(frame) for frame in page.frames(made.runs, made.live)]
    header, t, columns = frames[0]
    assert header["signals"] == ["motor.omega"]
    assert header["units"] == ["rad/s"]
    assert t.tolist() == results.t.tolist()
    assert columns[0].tolist() == results["motor.omega"].astype(np.float32).tolist()
    at = float(results.t[7] + 0.25 * (results.t[8] - results.t[7]))
    wanted = np.interp(at, results.t, results["motor.omega"])
    assert do("values", t=at)["values"]["motor.omega"] == pytest.approx(wanted, rel=1e-14)
    assert do("values", t=results.t[7])["values"]["motor.omega"] == results["motor.omega"][7]


def test_the_values_at_the_end_of_a_run_are_those_of_its_last_row(motor: tuple[Session, Page, Do]) -> None:
    made, _, do = motor
    assert do("values", t=0.0)["values"] == {}
    rows = np.array([0.0, 0.01]), np.array([[1.0], [2.0]])  # of a grid, while the run is between two of its rows
    live: Any = SimpleNamespace(t=0.015, columns={"x": (0, (), "m")}, rows=lambda: rows)
    live.stop, live.wait = lambda: None, lambda patience: True
    made.live = live
    assert do("values", t=0.015) == {"is": "values", "t": 0.01, "values": {"x": 2.0}, "others": {}}
    assert do("values", t=0.005)["values"] == {"x": 1.5}
    assert do("values", t=0.016)["values"] == {}


def test_earlier_runs_are_named_by_what_was_turned_shown_and_forgotten(motor: tuple[Session, Page, Do]) -> None:
    made, page, do = motor
    do("scope", scope="1", signals=["motor.omega"], width=500)
    first = run(made)
    made.values["motor.Ra"] = 1.5
    live = made.begin(0.2)
    live.set("motor.Ra", 2.5)
    live.go()
    assert live.wait(60.0)
    run(made)
    told = do("runs")["runs"]
    wanted = ["run 1", "run 2: motor.Ra = 1.5, motor.Ra = 2.5 at 0 s", "run 3: motor.Ra = 1.5"]
    assert [one["label"] for one in told] == wanted
    assert [one["is_live"] for one in told] == [False, False, True]
    do("ghost", run=1, on=True)
    quiet = Page()  # which the session does not feed
    answer(made, {"do": "scope", "scope": "1", "signals": ["motor.omega"], "width": 500}, quiet)
    answer(made, {"do": "ghost", "run": 1, "on": True}, quiet)
    shown = [unpacked(frame) for frame in quiet.frames(made.runs, made.live)]
    ghost = next(columns for header, _, columns in shown if header["kind"] == "ghost")
    assert ghost[0].max() == np.float32(first["motor.omega"].max())
    with pytest.raises(UsageError, match=re.escape("E501 run 3: is not in the list of earlier runs.")):
        do("ghost", run=3, on=True)
    do("ghost", run=1, on=False, forget=True)
    assert page.ghosts == set()
    assert [one["id"] for one in do("runs")["runs"]] == [2, 3]


def test_the_oldest_runs_are_forgotten(motor: tuple[Session, Page, Do], monkeypatch: pytest.MonkeyPatch) -> None:
    made, page, do = motor
    monkeypatch.setattr(scopes, "MOST_RUNS", 2)
    run(made, 0.01)
    run(made, 0.01)
    do("ghost", run=1, on=True)
    run(made, 0.01)
    assert [of for kind, of, _ in page.sources if kind == "ghost"] == [1]
    run(made, 0.01)
    do("drawn")
    assert [*made.runs] == [2, 3, 4]
    assert [of for kind, of, _ in page.sources if kind == "ghost"] == []
    monkeypatch.setattr(scopes, "MOST_BYTES", 1)
    run(made, 0.01)
    assert [*made.runs] == [5]


def test_of_many_signals_those_of_the_scopes_are_recorded(
    motor: tuple[Session, Page, Do], monkeypatch: pytest.MonkeyPatch
) -> None:
    made, _, do = motor
    monkeypatch.setattr(session, "MOST_LOGGED", 1)
    log = [*made.document.shown.check().log]
    other = next(name for name in made.document.shown.check().signals if name not in log)
    do("scope", scope="1", signals=[other, "unknown"], width=100)
    assert run(made, 0.01).names == (*log, other)


def test_results_are_saved_in_the_folder_of_the_diagram_alone(motor: tuple[Session, Page, Do]) -> None:
    made, _, do = motor
    with pytest.raises(UsageError, match="there is no run"):
        do("save", path="a.csv")
    results = run(made)
    for path in ("../a.csv", "/tmp/a.csv", "x/../../a.csv", "", ".", "a\n.csv"):
        with pytest.raises(UsageError, match=re.escape("lies outside the diagram's folder.")):
            do("save", path=path)
    (made.document.folder / "link").symlink_to(made.document.folder.parent)
    with pytest.raises(UsageError, match=re.escape("lies outside the diagram's folder.")):
        do("save", path="link/a.csv")
    with pytest.raises(UsageError, match="is too long for the name of a file"):
        do("save", path="a" * 300 + ".csv")
    for path in ("motor_pid.json", "a.txt"):
        with pytest.raises(UsageError, match="E501"):
            do("save", path=path, replaces=True)
    assert do("save", path="a.csv") == {"is": "saved", "path": "a.csv"}
    again = Results.load(made.document.folder / "a.csv")
    assert np.array_equal(again.values, results.values)
    with pytest.raises(UsageError, match="exists already"):
        do("save", path="a.csv")
    do("save", path="a.csv", replaces=True)
    assert inside(made.document.folder, "new/a.csv") == made.document.folder / "new" / "a.csv"


def test_a_measured_file_is_told_by_its_columns(motor: tuple[Session, Page, Do]) -> None:
    _, page, do = motor
    told = do("overlay", name="lab.csv", text="t [ms],motor.omega [rpm],temperature\n0,1,2\n500,3,4\n")
    assert told["columns"] == [{"name": "motor.omega", "unit": "rpm"}, {"name": "temperature", "unit": ""}]
    for k in range(7):
        do("overlay", name=f"{k}.csv", text="t,x\n0,1\n")
    with pytest.raises(UsageError, match="cannot be added: the limit is 8 files"):
        do("overlay", name="9.csv", text="t,x\n0,1\n")
    do("overlay", name="lab.csv", text=None)
    assert len(page.files) == 7


FILE = """(async () => {
  const input = document.querySelector('input[type=file]'), list = new DataTransfer();
  list.items.add(new File(['time,motor_right.omega [rpm]\\n49,9\\n50,9.5\\n51,9.6\\n'], 'lab <b>.csv'));
  input.files = list.files;
  await input.onchange();
})()"""


@pytest.mark.long
def test_scopes_in_a_browser(chromium: Any) -> None:
    """A run in scopes: the numbers of the legend, zoom, the cursor by keys, ghosts and a measured file."""
    made = Session(Document(Diagram.load(DIAGRAMS / "paper" / "iadrc.json")))
    transport = Transport(new_token(), made.received, made.connected, made.disconnected)
    transport.start()
    try:
        with chromium() as page:
            page.open(transport.url)
            page.until("document.querySelector('#drawing svg [data-net]')")
            made.received(next(iter(made.pages)), {"do": "run", "id": 0})
            # A first run opens a scope of what the file logs.
            page.until("document.querySelectorAll('.scope tbody tr').length === 3")
            page.until("document.querySelector('.scope-runs').textContent.includes('none yet')")
            assert made.running.wait(60.0)
            results = made.running.results()
            legend = "[...document.querySelectorAll('.scope tbody tr')].map(row => row.innerText.split('\\t'))"
            high = f"{results['motor_right.omega'].max():.5g}"
            page.until(f"({legend}).some(row => row[0].trim() === 'motor_right.omega' && row[4] === '{high}')")
            page.until("document.querySelector('.scope caption').textContent === '0 s to 100 s; 2 events'")
            page.click(".scope .u-over")
            page.until("document.querySelector('.scope-at').textContent.includes('pinned')")
            page.evaluate("document.querySelector('.scope-plot').focus()")
            page.press("Home", "+", "Shift+ArrowRight")
            page.until("document.querySelector('.scope-at').textContent === 't = 2 s, pinned'")
            page.until("document.querySelector('.scope caption').textContent === '0 s to 50 s; 2 events'")
            # The value at the cursor on its wire, as the results have it.
            right = np.interp(2.0, results.t, results["motor_right.omega"])
            shown = "[...document.querySelectorAll('.wire-value')].map(one => one.textContent)"
            page.until(f"({shown}).includes('{float(f'{right:.5g}'):g}')")
            made.values["motor_right.Ra"] = 0.2
            made.received(next(iter(made.pages)), {"do": "run", "id": 0})
            page.evaluate("document.querySelector('.scope-bar details').open = true")
            page.until("document.querySelector('.scope-runs input')")
            page.click(".scope-runs input")
            page.until(f"({legend}).some(row => row[0].trim() === 'motor_right.omega, run 1')")
            page.evaluate(FILE)
            page.until(f"({legend}).some(row => row[0].trim() === 'motor_right.omega, lab <b>.csv')")
            tree = page.accessible()
            assert any(node["role"] == "table" and "0 s to 50 s" in node["name"] for node in tree)
            page.assert_clean()
    finally:
        transport.stop()
        made.close()


SLOW = """const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (text) {
  setTimeout(() => send.call(this, text), text.includes('"do":"values"') ? 200 : 0);
};"""
"""Questions for values wait: the run ends before the answer."""


@pytest.mark.long
def test_values_on_wires_after_runs_of_few_rows_are_those_of_the_last_row(
    chromium: Any, motor: tuple[Session, Page, Do]
) -> None:
    made, _, _ = motor
    transport = Transport(new_token(), made.received, made.connected, made.disconnected)
    transport.start()
    nets = "[...document.querySelectorAll('#drawing g[data-net]')].filter(one => one.querySelector('path.run'))"
    shown = "[...document.querySelectorAll('.wire-value')].map(one => one.textContent)"
    try:
        with chromium() as page:
            page.call("Page.addScriptToEvaluateOnNewDocument", source=SLOW)
            page.open(transport.url)
            page.until("document.querySelector('#drawing g[data-net]')")
            names = dict.fromkeys(page.evaluate(f"{nets}.map(one => one.dataset.net)"))
            for number, stop in enumerate((1.025, 1.0053, 1.06), 1):
                page.evaluate(f"document.querySelector('#runbar label input').value = '{stop}'")
                page.press("r")
                page.until(f"document.getElementById('runbar').innerText.includes('done: t = {stop} of')")
                assert made.number == number
                results = Diagram.load(DIAGRAMS / "motor_pid.json").run(stop=stop)
                texts = [f"{float(f'{results[name][-1]:.5g}'):.5g}" for name in names]
                page.until(f"JSON.stringify({shown}) === {json.dumps(json.dumps(texts, separators=(',', ':')))}")
            page.assert_clean()
    finally:
        transport.stop()


@pytest.mark.long
def test_numbers_at_the_cursor_are_those_of_the_run_that_is_shown(chromium: Any, native: None) -> None:
    """Far from t = 0, of 20,000 rows, after a new run, of a ghost and of an element of a matrix."""
    d = Diagram("far")
    d.wire(d.add("gain", Gain(k=2.0)).u, d.add("sine", Sine(omega=2e4)).y)
    d.wire(d.add("hold", ZeroOrderHold(period=1e-3)).u, "gain.y")
    d.settings(start=1e6, stop=1000000.02, method="rk4", step=1e-6, log=["gain.y"])
    made = Session(Document(d))
    transport = Transport(new_token(), made.received, made.connected, made.disconnected)
    transport.start()
    try:
        with chromium() as page:
            page.open(transport.url)
            page.until("document.querySelector('#drawing svg [data-net]')")
            client = next(iter(made.pages))
            made.received(client, {"do": "run", "id": 0})
            page.until("document.querySelector('.scope-plot canvas')")
            assert made.running.wait(60.0)
            page.until("document.querySelector('#runbar .told').textContent.includes('t = 1000000.02 of')")
            first = made.running.results()
            page.evaluate("document.querySelector('.scope-plot').focus()")
            page.press("Home", "Shift+ArrowRight", "ArrowRight", "ArrowRight", "ArrowRight")
            page.until("document.querySelector('.scope-at').textContent === 't = 1000000.00092 s, pinned'")
            cells = "[...document.querySelectorAll('.scope tbody tr')].map(row => row.innerText.split('\\t'))"
            at = float(np.interp(1000000.00092, first.t, first["gain.y"]))
            last = float(first["gain.y"][-1])
            page.until(f"{cells}.some(row => Math.abs(row[2] - {at}) < 2e-4 && Math.abs(row[5] - {last}) < 2e-4)")
            made.values["gain.k"] = 3.0
            made.received(client, {"do": "run", "id": 0})
            wires = "[...document.querySelectorAll('.wire-value')].map(one => Number(one.textContent))"
            page.until(f"{wires}.some(one => Math.abs(one - {1.5 * at}) < 4e-4)")
            page.evaluate("document.querySelector('.scope-bar details').open = true")
            page.until("document.querySelector('.scope-runs input')")
            page.click(".scope-runs input")
            page.until(f"{cells}.some(row => row[0].includes('run 1') && Math.abs(row[2] - {at}) < 2e-4)")
            scope = "Scope.prototype.element.call({pane: {shape: () => [2, 3]}}, 'm.y[1,0]')"
            module = "import(new URL('page/scope.js', location.href).href)"
            assert page.evaluate(f"{module}.then(({{Scope}}) => {scope})") == ["m.y", 3]
            page.assert_clean()
    finally:
        transport.stop()
        made.close()
