"""HTTP and one WebSocket on a port of 127.0.0.1: pages, messages, frames. `guard` decides who is admitted.

An event loop in a thread of its own serves all pages, and hands messages on as they come; what answers them sends when
it is ready.
"""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import hashlib
import logging
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any, NamedTuple

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from ..text.errors import Fault, UsageError
from ..text.json_line import json_line
from .guard import PAGES, SOCKET, TICKET, Admitted, Guard
from .messages import message_of

Message = dict[str, Any]
PAGE = Path(__file__).parent / "page"
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
LONGEST_FILE = 16 * 2**20
"""Bytes of a message, which may hold measured signals."""
MOST_WAITING = 64 * 2**20
"""Bytes that wait for a page that does not take them; beyond, it is cut off, and connects again when it can."""
MOST_ASKED = 64
"""Messages of a page that wait for their answers before no more are read."""
LARGE = 2**18
"""Characters of a message that is answered before another one is read."""
PATIENCE = 2.0  # s for pages to close when the server ends
_SILENT = logging.getLogger("blocks.server")
_SILENT.addHandler(logging.NullHandler())
_SILENT.propagate = False


class Client:
    """A page that is connected. Its methods may be called from any thread."""

    def __init__(self, connection: ServerConnection, loop: asyncio.AbstractEventLoop) -> None:
        self._connection, self._loop = connection, loop
        self._lock = threading.Lock()
        self._waiting: dict[object, str | bytes] = {}  # in the order of sending
        self._bytes = 0
        self._is_open = True
        self._ready, self._has_answer = asyncio.Event(), asyncio.Event()
        self._asked = 0  # messages without an answer

    def send(self, message: Message | str | bytes, slot: str = "") -> bool:
        """Send a message, or a frame (bytes). Of the frames in one slot only the newest waits for a slow page.

        False: this page is closed, or a frame that has not been sent was replaced.
        """
        item = json_line(message) if isinstance(message, dict) else message
        with self._lock:
            if not self._is_open:
                return False
            key: object = slot if isinstance(item, bytes) else object()
            replaced = self._waiting.get(key, b"")
            self._waiting[key] = item
            self._bytes += len(item) - len(replaced)
            if self._bytes > MOST_WAITING:
                self._is_open = False
                self._waiting.clear()
        with contextlib.suppress(RuntimeError):  # the server has ended
            self._loop.call_soon_threadsafe(self._ready.set)
        return self._is_open and not replaced

    def answered(self) -> None:
        """Its oldest message was: the page may ask more."""
        with contextlib.suppress(RuntimeError):  # the server has ended
            self._loop.call_soon_threadsafe(self._take_answer)

    def _take_answer(self) -> None:
        self._asked -= 1
        self._has_answer.set()

    async def _wait_for_answers(self, most: int) -> None:
        """Until no more than so many messages are without an answer."""
        while self._asked > most:
            self._has_answer.clear()
            await self._has_answer.wait()

    async def _pass_on(self) -> None:
        while self._is_open:
            await self._ready.wait()
            self._ready.clear()
            while item := self._next():
                await self._connection.send(item)
        await self._connection.close(1013, "the page reads too slowly")

    def _next(self) -> str | bytes | None:
        with self._lock:
            if not self._waiting:
                return None
            item = self._waiting.pop(next(iter(self._waiting)))
            self._bytes -= len(item)
            return item

    def _closed(self) -> None:
        with self._lock:
            self._is_open = False
            self._waiting.clear()


class Transport:
    """A server that begins with `start()` and ends with `stop()`, or with Python.

    received: called with each message of a page. connected, disconnected: called for each page before its first message
    and after its last. All three must return at once: the event loop calls them.
    framed: the page may stand in a frame of a notebook. `url` holds the token: who has it can do all that a page can.
    """

    def __init__(
        self,
        token: str,
        received: Callable[[Client, Message], None],
        connected: Callable[[Client], None],
        disconnected: Callable[[Client], None],
        *,
        port: int = 0,
        framed: bool = False,
    ) -> None:
        """Raises UsageError (E501) where the port is taken."""
        self._received, self._connected, self._disconnected = received, connected, disconnected
        cure = "Choose another port, or leave --port out to get a free port."
        if not 0 <= port <= 65535:
            raise UsageError(Fault("E501", f"--port {port}", "is not a port: use a number from 0 to 65535.", cure))
        try:
            self._listening = socket.create_server(("127.0.0.1", port))
        except OSError as error:
            raise UsageError(Fault("E501", f"--port {port}", f"cannot be opened: {error.strerror}.", cure)) from None
        self.port: int = self._listening.getsockname()[1]
        self._files = dict(_files())
        self._guard = Guard(token, self.port, self._files, framed=framed)
        self.url = f"http://127.0.0.1:{self.port}{PAGES}{token}/"
        self._loop = asyncio.new_event_loop()
        self._ending = asyncio.Event()
        self._thread = threading.Thread(target=self._run, daemon=True, name=f"server {self.port}")

    def ticket(self) -> str:
        """An address that lets one page in, once."""
        token = new_token()
        self._guard.tickets.append(token)
        return f"http://127.0.0.1:{self.port}{TICKET}{token}"

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Close all pages and the port. Once more does nothing."""
        with contextlib.suppress(RuntimeError):  # the loop is closed already
            self._loop.call_soon_threadsafe(self._ending.set)
        if self._thread.ident is not None:
            self._thread.join(2 * PATIENCE)
        else:
            self._loop.close()
        self._listening.close()

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        server = serve(
            self._talk,
            sock=self._listening,
            process_request=self._answer,
            server_header=None,
            compression=None,  # what goes from memory to memory is faster as it is
            max_size=LONGEST_FILE,
            close_timeout=PATIENCE / 2,
            logger=_SILENT,
        )
        async with server:  # which closes the pages at its end
            await self._ending.wait()

    # --- requests -----------------------------------------------------------------------------------------------------

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """What a request gets; None where it becomes a WebSocket."""
        admitted = self._guard.admit(request.method, request.path, request.headers.raw_items())
        if not isinstance(admitted, Admitted):
            return self._response(admitted.status, request, f"{admitted.reason}\n".encode())
        if admitted.enters:
            page, once = f"{PAGES}{self._guard.token}/", {"Cache-Control": "no-store"}
            if request.headers.get("Sec-Fetch-Site") == "same-site":  # a redirection would still be that other page's
                body = f'<!doctype html><meta http-equiv="refresh" content="0; url={page}">'.encode()
                return self._response(200, request, body, once, "text/html")
            return self._response(303, request, b"", {"Location": page, **once})
        if admitted.route == SOCKET:
            return None
        file = self._files[admitted.route]
        named = {"ETag": file.tag, "Vary": "Accept-Encoding"}
        if file.tag in request.headers.get("If-None-Match", "").split(", "):
            return self._response(304, request, b"", named, file.type)
        is_packed = "gzip" in request.headers.get("Accept-Encoding", "")
        more = {**named, **({"Content-Encoding": "gzip"} if is_packed else {})}
        return self._response(200, request, file.packed if is_packed else file.content, more, file.type)

    def _response(
        self, status: int, request: Request, body: bytes, more: dict[str, str] | None = None, type_: str = "text/plain"
    ) -> Response:
        headers = Headers(
            {
                "Content-Type": f"{type_}; charset=utf-8",
                "Content-Length": str(len(body)),
                "Connection": "close",
                "Cache-Control": "no-store" if status >= 400 else "no-cache",
                "Content-Security-Policy": self._policy(),
                "X-Content-Type-Options": "nosniff",
                "Referrer-Policy": "no-referrer",
                "Cross-Origin-Resource-Policy": "same-origin",
                **(more or {}),
            }
        )
        if status == 304:
            del headers["Content-Length"]
        return Response(status, HTTPStatus(status).phrase, headers, b"" if request.method == "HEAD" else body)

    def _policy(self) -> str:
        """What the page may do: run its own modules, and talk to this server. No text becomes a program or a style."""
        sockets = " ".join(f"ws://{host}" for host in sorted(self._guard.hosts))
        notebooks = "http://localhost:* http://127.0.0.1:* https://localhost:* vscode-webview:"
        frames = notebooks if self._guard.framed else "'none'"
        return (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
            f"connect-src 'self' {sockets}; base-uri 'none'; form-action 'none'; "
            f"frame-ancestors {frames}"
        )

    # --- messages -----------------------------------------------------------------------------------------------------

    async def _talk(self, connection: ServerConnection) -> None:
        client = Client(connection, self._loop)
        sending = self._loop.create_task(client._pass_on())
        try:
            self._connected(client)
            async for sent in connection:
                try:
                    message = message_of(sent)
                    client._asked += 1
                    self._received(client, message)
                    # What it sends meanwhile waits in the network, and then in the page, not here.
                    await client._wait_for_answers(0 if len(sent) > LARGE else MOST_ASKED)
                except UsageError as error:
                    client.send({"is": "error", "faults": [_told(fault) for fault in error.faults]})
        except ConnectionClosed:
            pass
        finally:
            client._closed()
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                await sending
            self._disconnected(client)


class _File(NamedTuple):
    content: bytes
    packed: bytes
    type: str
    tag: str


def _files() -> Iterator[tuple[str, _File]]:
    """The files of the page by their paths, read once: what is not among them is not served."""
    for path in sorted(PAGE.rglob("*")):
        if path.suffix in TYPES and path.is_file():
            route = f"/page/{path.relative_to(PAGE).as_posix()}"
            content = path.read_bytes()
            tag = f'"{hashlib.sha256(content).hexdigest()[:16]}"'
            file = _File(content, gzip.compress(content, mtime=0), TYPES[path.suffix], tag)
            yield "/" if route == "/page/index.html" else route, file


def _told(fault: Fault) -> Message:
    return {"code": fault.code, "place": fault.place, "message": fault.message, "cure": fault.cure}


def new_token() -> str:
    return secrets.token_urlsafe(24)
