"""The guard before everything: who may ask this server for what.

A page of any site can make a browser send requests to 127.0.0.1, and any user of the machine can connect to it. So each
request passes `Guard.admit` before anything is looked up, and each message of a page passes `message_of` before any
function is called; both are pure, and know no network. A request is admitted where

- its method is GET or HEAD, and its path is one of those that the server made at its start: no path is ever decoded,
  joined or looked up in a folder;
- its Host is this server's own, so that no name of a foreign site leads here (DNS rebinding);
- its Origin, where it has one, is this server's own; a WebSocket must have one, since browsers let any site open it;
- the browser does not say (Sec-Fetch-Site) that another site makes it;
- it holds the token, which is made at the start and told to nobody but the user: in a cookie, which `/?token=...` sets,
  or, in notebooks, in the path `/k/TOKEN/`, as browsers send no SameSite=Strict cookie into frames of other sites.
"""

from __future__ import annotations

import hmac
import json
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, NamedTuple

from ..text.errors import Fault, UsageError, did_you_mean

__all__ = ["MESSAGES", "Admitted", "Guard", "Refusal", "cookie_name", "message_of"]

SOCKET = "/ws"
LONGEST_PATH = 1000  # characters
_TOKEN = re.compile(r"[\w-]{20,}", re.ASCII).fullmatch


class Admitted(NamedTuple):
    """route: one of the server's paths. enters: the browser is given the cookie and sent to `/`."""

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

    def admit(self, method: str, path: str, headers: Iterable[tuple[str, str]]) -> Admitted | Refusal:
        """headers: names and values as they came; one that decides and stands twice is refused."""
        given: dict[str, list[str]] = {}
        for name, value in headers:
            given.setdefault(name.lower(), []).append(value)
        for name in ("host", "origin", "cookie", "sec-fetch-site", "sec-fetch-mode", "sec-fetch-dest"):
            if len(given.get(name, ())) > 1:
                return Refusal(400, f"There is more than one header {name}.")
        one = {name: values[0] for name, values in given.items()}
        if method not in ("GET", "HEAD"):
            return Refusal(405, "There is nothing here but to read: GET and HEAD.")
        host = one.get("host", "")
        if host not in self.hosts:
            return Refusal(403, "This is the server of 127.0.0.1, and not of another name.")
        if len(path) > LONGEST_PATH:
            return Refusal(414, "This path is too long.")
        route, is_known = self._route(path, one.get("cookie", ""))
        origin = one.get("origin")
        if origin != f"http://{host}" and (origin is not None or route == SOCKET):
            return Refusal(403, "Pages of other sites do not get in.")
        if not self._is_own(one, route, is_known and path.startswith("/k/")):
            return Refusal(403, "Pages of other sites do not get in.")
        if not is_known:
            return Refusal(401, "Open the address with the token that `blocks live` printed when it began.")
        if route not in self.routes:
            return Refusal(404, "There is nothing here.")
        return Admitted(route, enters=path.startswith("/?"))

    def _route(self, path: str, cookies: str) -> tuple[str, bool]:
        """The path without its token, and whether there is one that is right."""
        if path.startswith("/?token="):
            return "/", self._fits(path.removeprefix("/?token="))
        if self.framed and path.startswith("/k/"):
            token, _, rest = path.removeprefix("/k/").partition("/")
            return f"/{rest}", self._fits(token)
        name = cookie_name(self.port)
        pairs = (pair.strip().partition("=") for pair in cookies.split(";"))
        values = [value for key, _, value in pairs if key == name]
        return path, len(values) == 1 and self._fits(values[0])

    def _fits(self, token: str) -> bool:
        # In constant time, so that nobody finds the token letter by letter.
        return hmac.compare_digest(token.encode(), self.token.encode())

    def _is_own(self, one: Mapping[str, str], route: str, in_path: bool) -> bool:
        """Whether a browser, where it says so, makes the request for this server's own page, or for its user."""
        site = one.get("sec-fetch-site", "none")
        if site in ("none", "same-origin"):
            return True
        opens = one.get("sec-fetch-mode") == "navigate" and one.get("sec-fetch-dest") in ("iframe", "document")
        return self.framed and in_path and route == "/" and opens


def cookie_name(port: int) -> str:
    """A cookie is sent to all ports of a host: a name for each lets several servers run."""
    return f"blocks-{port}"


# --- messages --------------------------------------------------------------------------------------------------------


LONGEST = 500  # characters of a text, but for measured signals
LONGEST_FILE = 16 * 2**20  # bytes of measured signals
MOST = 1000  # items of a list
GREATEST = 1e300


def text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= LONGEST


def long_text(value: Any) -> bool:
    return isinstance(value, str)  # of which the transport limits the size


def number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= GREATEST


def count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 2**31


def flag(value: Any) -> bool:
    return isinstance(value, bool)


def texts(value: Any) -> bool:
    return isinstance(value, list) and len(value) <= MOST and all(map(text, value))


def setting(value: Any) -> bool:
    """A value of a parameter: a number, a text (maybe with a unit), true or false, a vector or a matrix."""
    if isinstance(value, list):
        rows = [row if isinstance(row, list) else [row] for row in value]
        return sum(map(len, rows)) <= MOST and len(rows) <= MOST and all(number(item) for row in rows for item in row)
    return number(value) or text(value) or flag(value)


Kind = Callable[[Any], bool]
MESSAGES: dict[str, dict[str, Kind]] = {
    "draw": {"level": text},
    "panel": {"path": text},
    "run": {"stop?": number, "pace?": number},
    "pause": {},
    "resume": {},
    "step": {},
    "stop": {},
    "pace": {"pace?": number},
    "set": {"name": text, "value": setting},
    "reset": {"name?": text},
    "keep": {"names?": texts},
    "script": {},
    "scope": {"scope": text, "signals": texts, "width": count, "t0?": number, "t1?": number, "span?": number},
    "unscope": {"scope": text},
    "values": {"t": number},
    "runs": {},
    "ghost": {"run": count, "on": flag},
    "forget": {"run": count},
    "overlay": {"name": text, "text": long_text},
    "unoverlay": {"name": text},
    "save": {"path": text},
}
"""The fields of each message of a page, each with what its value must be; `?`: it may be absent, or null. A message
that does not stand here reaches no function. None names a module, a library, an FMU to be trusted or a host: such are
given where the server is started."""


def message_of(sent: str | bytes) -> dict[str, Any]:
    """A message of a page: `do`, maybe `id`, and the fields of MESSAGES. Raises UsageError (E501), all faults at once.

    Optional fields that are null are left out.
    """
    try:
        message = json.loads(sent, parse_constant=_no_number) if isinstance(sent, str) else None
    except (ValueError, RecursionError):
        message = None
    if not isinstance(message, dict):
        raise UsageError(Fault("E501", "message", "is not an object of JSON."))
    do = message.get("do")
    if not isinstance(do, str) or do not in MESSAGES:
        near = did_you_mean(do[:LONGEST], MESSAGES) if isinstance(do, str) else ""
        raise UsageError(Fault("E501", "message", "asks for nothing that is known here.", near))
    if not count(message.get("id", 0)):
        raise UsageError(Fault("E501", f"{do}.id", "is no count."))
    faults = []
    fields = {name.removesuffix("?"): name.endswith("?") for name in MESSAGES[do]}
    for name in sorted(message.keys() - fields.keys() - {"do", "id"}):
        faults.append(Fault("E501", f"{do}.{name[:40]}", "is not known.", did_you_mean(name[:LONGEST], fields)))
    for (name, optional), fits in zip(fields.items(), MESSAGES[do].values(), strict=True):
        if message.get(name) is None:
            message.pop(name, None)
            if not optional:
                faults.append(Fault("E501", f"{do}.{name}", "is missing."))
        elif not fits(message[name]):
            faults.append(
                Fault("E501", f"{do}.{name}", f"is no {fits.__name__.replace('_', ' ')} of a permitted size.")
            )
    if faults:
        raise UsageError(*faults)
    return message


def _no_number(word: str) -> float:
    raise ValueError(word)
