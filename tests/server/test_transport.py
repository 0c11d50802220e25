"""HTTP and the WebSocket of a live server, over real sockets."""

from __future__ import annotations

import asyncio
import gzip
import json
import math
import queue
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from blocks.server import transport
from blocks.server.transport import PAGE, Client, Transport, new_token
from blocks.text.errors import UsageError
from tests.support.places import ROOT

TOKEN = new_token()
BELOW = f"/k/{TOKEN}"


class Session:
    """What a session would do: greets, answers with what it got, and remembers."""

    def __init__(self) -> None:
        self.clients: queue.Queue[Client] = queue.Queue()
        self.gone: queue.Queue[Client] = queue.Queue()
        self.got: list[dict[str, Any]] = []

    def connected(self, client: Client) -> None:
        client.send({"is": "hello", "t": math.nan})
        self.clients.put(client)

    def received(self, client: Client, message: dict[str, Any]) -> None:
        self.got.append(message)
        client.answered()
        client.send({"is": "echo", **message})


@pytest.fixture
def session() -> Session:
    return Session()


@pytest.fixture
def server(session: Session) -> Iterator[Transport]:
    made = Transport(TOKEN, session.received, session.connected, session.gone.put)
    made.start()
    yield made
    made.stop()


def got(server: Transport, path: str, *, method: str = "GET", **headers: str) -> tuple[int, dict[str, str], bytes]:
    connection = HTTPConnection("127.0.0.1", server.port, timeout=60)
    connection.request(method, path, headers={k.replace("_", "-"): v for k, v in headers.items()})
    response = connection.getresponse()
    content = response.read()
    connection.close()
    return response.status, {name.lower(): value for name, value in response.getheaders()}, content


def socket_of(server: Transport, **changed: Any) -> ClientConnection:
    given: dict[str, Any] = {
        "origin": f"http://127.0.0.1:{server.port}",
        "proxy": None,
    }
    path = changed.pop("path", f"{BELOW}/ws")
    return connect(f"ws://127.0.0.1:{server.port}{path}", **{**given, **changed})


def test_the_address_leads_to_the_page_and_no_cookie_holds_the_token(server: Transport) -> None:
    assert server.url == f"http://127.0.0.1:{server.port}{BELOW}/"
    status, headers, content = got(server, f"{BELOW}/")
    assert "set-cookie" not in headers
    assert (status, headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert content == (PAGE / "index.html").read_bytes()
    for path in ("/", "/page/main.js", f"/?token={TOKEN}"):
        assert got(server, path)[0] == 401
        assert got(server, path, Cookie=f"blocks-{server.port}={TOKEN}")[0] == 401
    ticket = server.ticket().removeprefix(f"http://127.0.0.1:{server.port}")
    status, headers, content = got(server, ticket)
    assert (status, headers["location"], headers["cache-control"], content) == (303, f"{BELOW}/", "no-store", b"")
    assert "set-cookie" not in headers
    assert got(server, ticket)[0] == 401
    opens = {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    ticket = server.ticket().removeprefix(f"http://127.0.0.1:{server.port}")
    status, headers, content = got(server, ticket, **opens)
    assert (status, headers["cache-control"], "set-cookie" in headers) == (200, "no-store", False)
    # So that this page, and not the other one, leads on.
    assert f'http-equiv="refresh" content="0; url={BELOW}/"'.encode() in content


def test_every_file_of_the_page_is_served_as_what_it_is_packed_and_once(server: Transport) -> None:
    types = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
    files = [path for path in PAGE.rglob("*") if path.suffix in types and path.name != "index.html"]
    assert files
    for path in files:
        route = f"{BELOW}/page/{path.relative_to(PAGE).as_posix()}"
        status, headers, content = got(server, route, Accept_Encoding="gzip, br")
        assert (status, headers["content-encoding"]) == (200, "gzip")
        assert headers["content-type"] == f"{types[path.suffix]}; charset=utf-8"
        assert headers["cache-control"] == "no-cache"
        assert gzip.decompress(content) == path.read_bytes()
        assert got(server, route, If_None_Match=headers["etag"])[::2] == (304, b"")
        assert got(server, route, If_None_Match='"other"')[::2] == (200, path.read_bytes())
        assert got(server, route, method="HEAD")[::2] == (200, b"")


def test_every_answer_says_what_the_page_may_do(server: Transport) -> None:
    ticket = server.ticket().removeprefix(f"http://127.0.0.1:{server.port}")
    for path, status in [(f"{BELOW}/", 200), (f"{BELOW}/nothing", 404), ("/", 401), (ticket, 303)]:
        found, headers, _ = got(server, path)
        assert found == status
        policy = dict(part.strip().split(" ", 1) for part in headers["content-security-policy"].split(";"))
        assert (policy["default-src"], policy["script-src"]) == ("'none'", "'self'")
        assert (policy["frame-ancestors"], policy["base-uri"], policy["form-action"]) == 3 * ("'none'",)
        assert (headers["x-content-type-options"], headers["referrer-policy"]) == ("nosniff", "no-referrer")
        assert "server" not in headers


def test_the_page_itself_needs_nothing_that_its_policy_forbids() -> None:
    text = (PAGE / "index.html").read_text(encoding="utf-8")
    assert "style=" not in text
    assert " on" + "click=" not in text
    assert text.count("<script") == text.count('<script type="module" src="page/')
    for path in PAGE.rglob("*.js"):
        assert "eval(" not in path.read_text(encoding="utf-8"), path
        assert "new Function(" not in path.read_text(encoding="utf-8"), path


@pytest.mark.parametrize(
    ("method", "path", "status"), [("POST", "/", 405), ("GET", "/page/../transport.py", 404), ("GET", "/page/", 404)]
)
def test_what_the_guard_refuses_is_refused_over_the_network(
    server: Transport, method: str, path: str, status: int
) -> None:
    assert got(server, f"{BELOW}{path}", method=method)[0] == status
    assert got(server, f"{BELOW}{path}", method=method, Host="evil.example")[0] in (403, 405)


def test_a_socket_opens_for_the_own_page_only(server: Transport, session: Session) -> None:
    for changed in ({"origin": "http://evil.example"}, {"origin": None}, {"path": "/ws"}):
        with pytest.raises(InvalidStatus) as refused:
            socket_of(server, **changed)
        assert refused.value.response.status_code in (401, 403)
    assert session.clients.empty()
    with socket_of(server) as page:
        assert json.loads(page.recv(timeout=60)) == {"is": "hello", "t": None}
        page.send(json.dumps({"do": "draw", "id": 3, "level": "a"}))
        assert json.loads(page.recv(timeout=60)) == {"is": "echo", "do": "draw", "id": 3, "level": "a"}
    assert session.gone.get(timeout=60) is session.clients.get(timeout=60)


@pytest.mark.parametrize(
    "sent",
    [
        "", "x", "[]", "1", '"run"', "null", "{}", '{"do": 1}', '{"do": []}', '{"do": {}}', b'{"do": "run"}',
        '{"do": "run", "id": NaN}', '{"do": "run", "id": {}}', '{"do": "run", "id": 1.5}', '{"do": "run", "id": true}',
        '{"do": "values", "t": NaN}', '{"do": "values", "t": -Infinity}', f'{{"do": "values", "t": 1{5000 * "0"}}}',
        "[" * 100_000,
    ],
    ids=lambda sent: repr(sent[:30]),
)  # fmt: skip
def test_what_is_no_message_reaches_no_session(server: Transport, session: Session, sent: str | bytes) -> None:
    with socket_of(server) as page:
        page.recv(timeout=60)
        page.send(sent)
        answer = json.loads(page.recv(timeout=60))
        assert (answer["is"], [fault["code"] for fault in answer["faults"]]) == ("error", ["E501"])
        page.send(json.dumps({"do": "pause", "id": 1}))  # and the page goes on
        assert json.loads(page.recv(timeout=60))["do"] == "pause"
    assert [message["do"] for message in session.got] == ["pause"]


def test_a_message_that_is_too_long_closes_the_page(server: Transport) -> None:
    with socket_of(server) as page:
        page.recv(timeout=60)
        page.send("x" * (transport.LONGEST_FILE + 1))
        with pytest.raises(ConnectionClosed):
            page.recv(timeout=60)


def test_a_slow_page_gets_the_newest_frame_of_each_slot_and_all_texts() -> None:
    class Slow:
        """A connection that takes one item each time that it is let."""

        def __init__(self) -> None:
            self.items: list[str | bytes] = []
            self.may = asyncio.Semaphore(0)

        async def send(self, item: str | bytes) -> None:
            await self.may.acquire()
            self.items.append(item)

    async def sent() -> tuple[list[str | bytes], int]:
        slow = Slow()
        client = Client(slow, asyncio.get_running_loop())  # type: ignore[arg-type]
        passing = asyncio.create_task(client._pass_on())
        assert client.send(b"first", slot="a")
        while "a" in client._waiting:
            await asyncio.sleep(0)  # it is being sent, and stays so
        for number in range(50):
            client.send({"number": number})
            assert client.send(bytes([number]), slot="a") is (number == 0)  # the others take a place
            client.send(bytes([number]), slot="b")
        waiting = client._bytes
        for _ in range(53):
            slow.may.release()
        while len(slow.items) < 53:
            await asyncio.sleep(0)
        assert "a" not in client._waiting
        passing.cancel()
        return slow.items, waiting

    items, waiting = asyncio.run(sent())
    texts = [json.loads(item)["number"] for item in items if isinstance(item, str)]
    assert texts == list(range(50))
    assert [item for item in items if isinstance(item, bytes)] == [b"first", bytes([49]), bytes([49])]
    assert waiting == sum(len(item) for item in items) - len(b"first")


def test_a_page_that_takes_nothing_is_cut_off(
    server: Transport, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transport, "MOST_WAITING", 2**20)
    with socket_of(server, max_queue=1):
        client = session.clients.get(timeout=60)
        while client.send({"is": "text", "text": "x" * 2**16}):
            pass
        assert not client._waiting
        assert not client.send("more")


@pytest.mark.parametrize(("size", "most"), [(0, transport.MOST_ASKED + 1), (transport.LARGE, 1)])
def test_a_page_that_asks_faster_than_it_is_answered_waits(
    server: Transport, session: Session, monkeypatch: pytest.MonkeyPatch, size: int, most: int
) -> None:
    patience, waiting = threading.Event(), list[Client]()

    def held(client: Client, message: dict[str, Any]) -> None:
        waiting.append(client)
        if len(waiting) >= most:
            patience.set()

    monkeypatch.setattr(server, "_received", held)
    with socket_of(server) as page, socket_of(server) as other:
        asking = threading.Thread(target=lambda: [page.send(f'{{"do": "a"}}{size * " "}') for _ in range(200)])
        asking.start()
        assert patience.wait(60)
        monkeypatch.setattr(server, "_received", session.received)
        other.recv(timeout=60)
        for _ in range(20):  # what another page asks is answered meanwhile
            other.send('{"do": "b"}')
            other.recv(timeout=60)
        assert (len(waiting), [message["do"] for message in session.got]) == (most, 20 * ["b"])
        for client in waiting:
            client.answered()
        page.recv(timeout=60)
        for _ in range(200 - most):
            assert json.loads(page.recv(timeout=60))["do"] == "a"
        asking.join()


def test_a_server_ends_with_its_pages_and_a_port_is_free_again(session: Session) -> None:
    first = Transport(TOKEN, session.received, session.connected, session.gone.put)
    first.start()
    with pytest.raises(UsageError, match=f"E501 --port {first.port}: cannot be opened"):
        Transport(TOKEN, session.received, session.connected, session.gone.put, port=first.port)
    with socket_of(first) as page:
        page.recv(timeout=60)
        first.stop()
        with pytest.raises(ConnectionClosed):
            page.recv(timeout=60)
    first.stop()
    assert not any(thread.name == f"server {first.port}" for thread in threading.enumerate())
    Transport(TOKEN, session.received, session.connected, session.gone.put, port=first.port).stop()


def test_only_this_machine_is_listened_to(server: Transport) -> None:
    assert server._listening.getsockname()[0] == "127.0.0.1"
    with socket.socket() as other:
        other.settimeout(5)
        assert other.connect_ex(("127.0.0.2", server.port)) != 0


def test_a_running_server_does_not_keep_python_from_ending(tmp_path: Path) -> None:
    program = (
        "from blocks.server.transport import Transport, new_token\n"
        "Transport(new_token(), print, print, print).start()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")
