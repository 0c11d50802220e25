"""Who may ask a live server for what: each request that a guard refuses, and each that it admits."""

from __future__ import annotations

import pytest

from blocks.server.guard import Admitted, Guard, Refusal

TOKEN = "x8Jk_2-v0Qm5ZtL7bR3nWy9A"
HOST = "127.0.0.1:8123"
ROUTES = {"/": 200, "/page/main.js": 200}
OWN = {"Host": HOST}
BELOW = f"/k/{TOKEN}"
SOCKET = {**OWN, "Origin": f"http://{HOST}"}
FRAME = {"Host": HOST, "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "iframe"}
Headers = dict[str, str]


def asked(method: str, path: str, headers: Headers, *, framed: bool = False) -> Admitted | Refusal:
    return Guard(TOKEN, 8123, ROUTES, framed=framed).admit(method, path, headers.items())


@pytest.mark.parametrize(
    ("method", "route", "headers"),
    [
        ("GET", "/", OWN),
        ("HEAD", "/page/main.js", OWN),
        ("GET", "/", {**OWN, "Cookie": "other=1; blocks-8123=z"}),
        ("GET", "/", {**OWN, "Host": "localhost:8123"}),
        ("GET", "/", {**OWN, "Sec-Fetch-Site": "none", "Sec-Fetch-Mode": "navigate"}),
        ("GET", "/page/main.js", {**OWN, "Sec-Fetch-Site": "same-origin", "Origin": f"http://{HOST}"}),
        ("GET", "/ws", SOCKET),
        ("GET", "/ws", {**SOCKET, "Sec-Fetch-Site": "same-origin", "Sec-Fetch-Mode": "websocket"}),
    ],
)
def test_the_own_page_and_its_user_are_admitted(method: str, route: str, headers: Headers) -> None:
    for framed in (False, True):
        assert asked(method, f"{BELOW}{route}", headers, framed=framed) == Admitted(route)


@pytest.mark.parametrize("route", [*ROUTES, "/ws"])
@pytest.mark.parametrize(
    ("status", "method", "below", "changed"),
    [
        (405, "POST", BELOW, {}),
        (405, "OPTIONS", BELOW, {}),
        (405, "get", BELOW, {}),
        (403, "GET", BELOW, {"Host": "evil.example:8123"}),  # a name that was bent to 127.0.0.1
        (403, "GET", BELOW, {"Host": "127.0.0.1:8124"}),
        (403, "GET", BELOW, {"Host": "127.0.0.1"}),
        (403, "GET", BELOW, {"Host": "localhost.:8123"}),
        (403, "GET", BELOW, {"Host": ""}),
        (403, "GET", BELOW, {"Origin": "http://evil.example"}),
        (403, "GET", BELOW, {"Origin": "null"}),
        (403, "GET", BELOW, {"Origin": f"https://{HOST}"}),
        (403, "GET", BELOW, {"Origin": "http://127.0.0.1:8124"}),
        (403, "GET", BELOW, {"Origin": "http://localhost:8123"}),  # not the host that is asked
        (403, "GET", BELOW, {"Sec-Fetch-Site": "cross-site"}),
        (403, "GET", BELOW, {"Sec-Fetch-Site": "same-site"}),  # another port of this machine
        (403, "GET", BELOW, {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "iframe"}),
        (401, "GET", "", {}),
        (401, "GET", "", {"Cookie": f"blocks-8123={TOKEN}"}),  # which browsers would send to all ports
        (401, "GET", "", {"Authorization": f"Bearer {TOKEN}"}),
        (401, "GET", "/k/", {}),
        (401, "GET", f"/k/{TOKEN[:-1]}", {}),
        (401, "GET", f"/k/{TOKEN}x", {}),
        (401, "GET", f"/K/{TOKEN}", {}),
        (401, "GET", f"//k/{TOKEN}", {}),
        (401, "GET", f"/t/{TOKEN}", {}),  # the token is no ticket
        (401, "GET", "/k/\u00e9", {}),
    ],
)
def test_each_route_is_refused_to_anybody_else(
    route: str, status: int, method: str, below: str, changed: Headers
) -> None:
    refusal = asked(method, f"{below}{route}", {**SOCKET, **changed})
    assert isinstance(refusal, Refusal)
    assert refusal.status == status
    assert refusal.reason.endswith(".")
    assert TOKEN not in refusal.reason


def test_a_web_socket_tells_from_which_page_it_comes() -> None:
    assert asked("GET", f"{BELOW}/ws", OWN) == Refusal(403, "Pages of other sites may not use this server.")
    assert asked("GET", f"{BELOW}/{2000 * 'x'}", OWN) == Refusal(414, "This path is too long.")


@pytest.mark.parametrize("name", ["Host", "Origin", "Sec-Fetch-Site"])
def test_headers_that_decide_stand_once(name: str) -> None:
    refusal = Guard(TOKEN, 8123, ROUTES).admit("GET", f"{BELOW}/", [*SOCKET.items(), (name.upper(), ""), (name, "")])
    assert isinstance(refusal, Refusal)
    assert refusal.status == 400


@pytest.mark.parametrize(
    "path",
    [
        "", "page/main.js", "//page/main.js", "/page/../main.js", "/page/%2e%2e/transport.py", "/page", "/page/",
        "/page/../../guard.py", "/page/main.js/", "/page\\main.js", "/PAGE/main.js", "/page/main.js?x",
        "/page/main.js%00", "/index.html", "/?", "/?token=1", "/etc/passwd", f"http://{HOST}/", "/ws/", f"{BELOW}/",
    ],
)  # fmt: skip
def test_other_paths_lead_nowhere(path: str) -> None:
    refusal = asked("GET", f"{BELOW}{path}" if path.startswith("/") or not path else f"{BELOW}/{path}x", OWN)
    assert isinstance(refusal, Refusal)
    assert refusal.status == 404
    stranger = asked("GET", "/" if path == f"{BELOW}/" else path, OWN)
    assert isinstance(stranger, Refusal)
    assert stranger.status == 401  # who hears nothing of which there are


@pytest.mark.parametrize("token", ["", TOKEN[:-1], f"{TOKEN}/", TOKEN.lower(), f"{TOKEN}&x={TOKEN}", f"%78{TOKEN[1:]}"])
def test_wrong_tokens_let_nobody_in(token: str) -> None:
    for framed in (False, True):
        for path in (f"/?token={token}", f"/t/{token}", f"/k/{token}/", f"/k/{token}/ws"):
            assert isinstance(asked("GET", path, {"Host": HOST, "Origin": f"http://{HOST}"}, framed=framed), Refusal)


def test_a_ticket_lets_one_page_in_once() -> None:
    guard = Guard(TOKEN, 8123, ROUTES)
    guard.tickets.append("t" * 32)
    enter = "GET", f"/t/{'t' * 32}"
    assert isinstance(guard.admit(*enter, [("Host", "evil.example:8123")]), Refusal)  # which does not use it up
    assert guard.admit(*enter, [("Host", HOST)]) == Admitted("/", enters=True)
    assert isinstance(guard.admit(*enter, [("Host", HOST)]), Refusal)


def test_a_page_of_another_port_opens_one_in_a_tab_by_a_ticket_alone() -> None:
    opens = {"Host": HOST, "Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    for given, token, is_let_in in (
        (opens, "t" * 32, True),
        (opens, TOKEN, False),
        ({**opens, "Sec-Fetch-Site": "cross-site"}, "t" * 32, False),
        ({**opens, "Sec-Fetch-Dest": "iframe"}, "t" * 32, False),
        ({**opens, "Sec-Fetch-Mode": "no-cors", "Sec-Fetch-Dest": "script"}, "t" * 32, False),
        ({**opens, "Origin": "http://127.0.0.1:8124"}, "t" * 32, False),
    ):
        guard = Guard(TOKEN, 8123, ROUTES)
        guard.tickets.append("t" * 32)
        found = guard.admit("GET", f"/t/{token}", given.items())
        assert found == Admitted("/", enters=True) if is_let_in else isinstance(found, Refusal)
        assert isinstance(guard.admit("GET", f"{BELOW}/", given.items()), Refusal)


def test_tickets_that_no_page_takes_do_not_heap_up() -> None:
    guard = Guard(TOKEN, 8123, ROUTES)
    for number in range(100):
        guard.tickets.append(f"{number:032}")
    assert isinstance(guard.admit("GET", f"/t/{0:032}", [("Host", HOST)]), Refusal)
    assert guard.admit("GET", f"/t/{99:032}", [("Host", HOST)]) == Admitted("/", enters=True)


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_notebook_holds_the_page_in_a_frame(site: str) -> None:
    frame = {**FRAME, "Sec-Fetch-Site": site}
    assert asked("GET", f"/k/{TOKEN}/", frame, framed=True) == Admitted("/")
    own = {"Host": HOST, "Sec-Fetch-Site": "same-origin", "Origin": f"http://{HOST}"}
    assert asked("GET", f"/k/{TOKEN}/page/main.js", own, framed=True) == Admitted("/page/main.js")
    assert asked("GET", f"/k/{TOKEN}/ws", own, framed=True) == Admitted("/ws")
    for path in ("/", "/page/main.js", "/ws", "/k/", f"/k/{TOKEN}", f"/k/{TOKEN}/..", f"/k/{TOKEN}/page/../ws"):
        assert isinstance(asked("GET", path, own, framed=True), Refusal)
    for path, changed in [
        (f"/k/{TOKEN}/page/main.js", {}),  # as a script of another site
        (f"/k/{TOKEN}/ws", {}),
        (f"/k/{TOKEN}/", {"Sec-Fetch-Mode": "no-cors", "Sec-Fetch-Dest": "script"}),
        (f"/k/{TOKEN}/", {"Sec-Fetch-Dest": "embed"}),
        (f"/k/{TOKEN}/", {"Origin": "http://localhost:8888"}),
    ]:
        assert isinstance(asked("GET", path, {**frame, **changed}, framed=True), Refusal)


def test_a_token_is_long() -> None:
    with pytest.raises(ValueError, match="20 letters"):
        Guard("short", 8123, ROUTES)
