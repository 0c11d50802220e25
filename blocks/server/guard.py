"""The guard before everything: who may ask this server for what.

A page of any site can make a browser send requests to 127.0.0.1, and any user of the machine can connect to it. So each
request passes `Guard.admit` before anything is looked up, which knows no network; each message of a page passes
`messages.answer` before any function is called. A request is admitted where

- its method is GET or HEAD, and its path is one of those that the server made at its start: no path is ever decoded,
  joined or looked up in a folder;
- its Host is this server's own, so that no name of a foreign site leads here (DNS rebinding);
- its Origin, where it has one, is this server's own; a WebSocket must have one, since browsers let any site open it;
- the browser does not say (Sec-Fetch-Site) that another site makes it, or another port, which may open a page by a
  ticket: that of a diagram in a tab beside this one;
- its path begins with `/k/TOKEN/`. The token is made at the start, and given to nobody but the user. It is never in a
  cookie: browsers send a cookie to all ports of a host, so to the programs of other users of this machine. `/t/TICKET`
  leads one page there, once.
"""

from __future__ import annotations

import hmac
import re
from collections import deque
from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

SOCKET = "/ws"
PAGES, TICKET = "/k/", "/t/"
LONGEST_PATH = 1000  # characters
MOST_TICKETS = 16  # that wait for their pages
_TOKEN = re.compile(r"[\w-]{20,}", re.ASCII).fullmatch


class Admitted(NamedTuple):
    """route: one of the server's paths. enters: the browser is sent to it, below the token."""

    route: str
    enters: bool = False


class Refusal(NamedTuple):
    """status: of HTTP."""

    status: int
    reason: str


class Guard:
    """routes: the paths that there are, `/ws` aside. framed: also for frames of a notebook's page."""

    def __init__(self, token: str, port: int, routes: Collection[str], *, framed: bool = False) -> None:
        if not _TOKEN(token):
            raise ValueError("a token has at least 20 letters, digits, - or _")
        self.token, self.port, self.routes, self.framed = token, port, {*routes, SOCKET}, framed
        self.hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self.tickets: deque[str] = deque(maxlen=MOST_TICKETS)
        """Tokens that let one page in, once; also one that a page of another port of this machine opens."""

    def admit(self, method: str, path: str, headers: Iterable[tuple[str, str]]) -> Admitted | Refusal:
        """headers: names and values as they came; one that decides and appears twice is refused."""
        given: dict[str, list[str]] = {}
        for name, value in headers:
            given.setdefault(name.lower(), []).append(value)
        for name in ("host", "origin", "sec-fetch-site", "sec-fetch-mode", "sec-fetch-dest"):
            if len(given.get(name, ())) > 1:
                return Refusal(400, f"The request has more than one header {name}.")
        one = {name: values[0] for name, values in given.items()}
        if method not in ("GET", "HEAD"):
            return Refusal(405, "This server accepts GET and HEAD only.")
        host = one.get("host", "")
        if host not in self.hosts:
            return Refusal(403, "Open this server as 127.0.0.1 or localhost: it has no other name.")
        if len(path) > LONGEST_PATH:
            return Refusal(414, "This path is too long.")
        route, is_known = self._route(path)
        origin = one.get("origin")
        if origin != f"http://{host}" and (origin is not None or route == SOCKET):
            return Refusal(403, "Pages of other sites may not use this server.")
        is_ticket = is_known and path.startswith(TICKET)
        if not self._is_own(one, route, is_known, is_ticket):
            return Refusal(403, "Pages of other sites may not use this server.")
        if not is_known:
            return Refusal(401, "Open the address with the token that `blocks live` printed at its start.")
        if route not in self.routes:
            return Refusal(404, "There is no such page.")
        if is_ticket:
            self.tickets.remove(path.removeprefix(TICKET))
        return Admitted(route, enters=is_ticket)

    def _route(self, path: str) -> tuple[str, bool]:
        """Return the path without its token, and whether there is one that is right."""
        if path.startswith(TICKET):
            return "/", path.removeprefix(TICKET) in self.tickets
        token, slash, rest = path.removeprefix(PAGES).partition("/")
        return (slash + rest, self._fits(token)) if path.startswith(PAGES) else (path, False)

    def _fits(self, token: str) -> bool:
        # In constant time, so that nobody finds the token letter by letter.
        return hmac.compare_digest(token.encode(), self.token.encode())

    def _is_own(self, one: Mapping[str, str], route: str, is_known: bool, is_ticket: bool) -> bool:
        """Whether a browser, where it says so, makes the request for this server's own page, or for its user."""
        site = one.get("sec-fetch-site", "none")
        if site in ("none", "same-origin"):
            return True
        goes, where = one.get("sec-fetch-mode") == "navigate", one.get("sec-fetch-dest")
        if is_ticket and site == "same-site":
            return goes and where == "document"
        return self.framed and is_known and route == "/" and goes and where in ("iframe", "document")
