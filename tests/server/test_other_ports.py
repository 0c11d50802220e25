"""A server on another port of this machine, in the same browser: it learns nothing, and gets nothing."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from blocks import Constant, Diagram
from tests.support.hands import edited_page

pytestmark = pytest.mark.long

ATTEMPTS = {
    "reads the page": "fetch(OWN + '/', {credentials: 'include'}).then(() => 'in', () => 'refused')",
    "reads it without asking": """fetch(OWN + '/', {mode: 'no-cors', credentials: 'include'})
        .then(a => a.type, () => 'refused')""",
    "opens the socket": """new Promise(done => { const made = new WebSocket(OWN.replace('http', 'ws') + '/ws');
        made.onopen = () => done('in'); made.onerror = () => done('refused'); })""",
    "loads a module": "import(OWN + '/page/main.js').then(() => 'in', () => 'refused')",
    "loads a script": """new Promise(done => { const made = document.createElement('script');
        made.src = OWN + '/page/vendor/uplot.js'; made.type = 'module';
        made.onload = () => done('in'); made.onerror = () => done('refused'); document.head.append(made); })""",
    "writes": """fetch(OWN + '/ws', {method: 'POST', mode: 'no-cors', credentials: 'include',
        body: JSON.stringify({do: 'undo', id: 1})}).then(a => a.type, () => 'refused')""",
    "shows it in a frame": """new Promise(done => { const made = document.createElement('iframe');
        made.src = OWN + '/'; made.onload = () => done(made.contentDocument ? 'in' : 'refused');
        document.body.append(made); })""",
    "looks at the cookies": "document.cookie || 'none'",
}
"""By what a page of another port tries, how; OWN is the origin of the editor."""


@contextmanager
def other_server() -> Iterator[tuple[str, list[str]]]:
    """The address of a server of somebody else on this machine, and all that it was sent."""
    got: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            got.append(f"{self.requestline}\n{self.headers}")
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>other</title>")

        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/", got
    finally:
        server.shutdown()
        server.server_close()


def test_a_server_on_another_port_gets_neither_the_token_nor_the_page(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "loop.json"
    loop = Diagram("loop")
    loop.add("one", Constant(value=1.0))
    loop.save(path)
    before = path.read_bytes()
    with other_server() as (address, got), edited_page(chromium, path) as hands:
        page = hands.page
        token = hands.server.url.rstrip("/").rpartition("/")[2]
        assert len(token) > 20
        assert not page.call("Network.getAllCookies")["cookies"]
        own = hands.server.url.partition("/k/")[0]
        page.evaluate(f"location.assign({address!r})")  # as a link in the page would lead there
        page.until("document.title === 'other'")
        found = {}
        for what, how in ATTEMPTS.items():
            found[what] = page.evaluate(f"(async () => {{ const OWN = {own!r}; return await ({how}); }})()")
        assert found == {**dict.fromkeys(ATTEMPTS, "refused"), "looks at the cookies": "none"}
        assert got
        assert token not in "".join(got)
        assert own not in "".join(got)
        assert not any(line.lower().startswith("cookie:") for one in got for line in one.splitlines())
        assert path.read_bytes() == before
        # The user's own page goes on to work, with the token in its path alone.
        page.open(hands.server.url)
        page.until("!document.getElementById('edits').hidden")
        assert not page.call("Network.getAllCookies")["cookies"]
