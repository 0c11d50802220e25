"""Who may ask a live server for what: each request that a guard refuses, and each that it admits."""

from __future__ import annotations

import pytest

from blocks.server.guard import Admitted, Guard, Refusal, cookie_name

TOKEN = "x8Jk_2-v0Qm5ZtL7bR3nWy9A"
HOST = "127.0.0.1:8123"
ROUTES = {"/": 200, "/page/main.js": 200}
OWN = {"Host": HOST, "Cookie": f"blocks-8123={TOKEN}"}
SOCKET = {**OWN, "Origin": f"http://{HOST}"}
FRAME = {"Host": HOST, "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "iframe"}
Headers = dict[str, str]


def asked(method: str, path: str, headers: Headers, *, framed: bool = False) -> Admitted | Refusal:
    return Guard(TOKEN, 8123, ROUTES, framed=framed).admit(method, path, headers.items())


@pytest.mark.parametrize(
    ("method", "path", "headers", "route"),
    [
        ("GET", "/", OWN, "/"),
        ("HEAD", "/page/main.js", OWN, "/page/main.js"),
        ("GET", "/", {**OWN, "Cookie": f"other=1; blocks-8123={TOKEN}; blocks-8124=z"}, "/"),
        ("GET", "/", {**OWN, "Host": "localhost:8123"}, "/"),
        ("GET", "/", {**OWN, "Sec-Fetch-Site": "none", "Sec-Fetch-Mode": "navigate"}, "/"),
        ("GET", "/page/main.js", {**OWN, "Sec-Fetch-Site": "same-origin", "Origin": f"http://{HOST}"}, "/page/main.js"),
        ("GET", "/ws", SOCKET, "/ws"),
        ("GET", "/ws", {**SOCKET, "Sec-Fetch-Site": "same-origin", "Sec-Fetch-Mode": "websocket"}, "/ws"),
        ("GET", f"/?token={TOKEN}", {"Host": HOST}, "/"),
    ],
)
def test_the_own_page_and_its_user_are_admitted(method: str, path: str, headers: Headers, route: str) -> None:
    assert asked(method, path, headers) == Admitted(route, enters=path.startswith("/?"))


@pytest.mark.parametrize("route", [*ROUTES, "/ws"])
@pytest.mark.parametrize(
    ("status", "method", "changed"),
    [
        (405, "POST", {}),
        (405, "OPTIONS", {}),
        (405, "get", {}),
        (403, "GET", {"Host": "evil.example:8123"}),  # a name that was bent to 127.0.0.1
        (403, "GET", {"Host": "127.0.0.1:8124"}),
        (403, "GET", {"Host": "127.0.0.1"}),
        (403, "GET", {"Host": "localhost.:8123"}),
        (403, "GET", {"Host": ""}),
        (403, "GET", {"Origin": "http://evil.example"}),
        (403, "GET", {"Origin": "null"}),
        (403, "GET", {"Origin": f"https://{HOST}"}),
        (403, "GET", {"Origin": "http://127.0.0.1:8124"}),
        (403, "GET", {"Origin": "http://localhost:8123"}),  # not the host that is asked
        (403, "GET", {"Sec-Fetch-Site": "cross-site"}),
        (403, "GET", {"Sec-Fetch-Site": "same-site"}),  # another port of this machine
        (403, "GET", {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "iframe"}),
        (401, "GET", {"Cookie": ""}),
        (401, "GET", {"Cookie": "blocks-8123="}),
        (401, "GET", {"Cookie": f"blocks-8123={TOKEN[:-1]}"}),
        (401, "GET", {"Cookie": f"blocks-8123={TOKEN}x"}),
        (401, "GET", {"Cookie": f"blocks-8124={TOKEN}"}),
        (401, "GET", {"Cookie": "blocks-8123=\u00e9"}),
        (401, "GET", {"Cookie": f"blocks-8123={TOKEN}; blocks-8123=other"}),
    ],
)
def test_each_route_is_refused_to_anybody_else(route: str, status: int, method: str, changed: Headers) -> None:
    refusal = asked(method, route, {**SOCKET, **changed})
    assert isinstance(refusal, Refusal)
    assert refusal.status == status
    assert refusal.reason.endswith(".")
    assert TOKEN not in refusal.reason


def test_a_web_socket_tells_from_which_page_it_comes() -> None:
    assert asked("GET", "/ws", OWN) == Refusal(403, "Pages of other sites do not get in.")
    assert asked("GET", f"/{2000 * 'x'}", OWN) == Refusal(414, "This path is too long.")


@pytest.mark.parametrize("name", ["Host", "Origin", "Cookie", "Sec-Fetch-Site"])
def test_headers_that_decide_stand_once(name: str) -> None:
    refusal = Guard(TOKEN, 8123, ROUTES).admit("GET", "/", [*SOCKET.items(), (name.upper(), ""), (name, "")])
    assert isinstance(refusal, Refusal)
    assert refusal.status == 400


@pytest.mark.parametrize(
    "path",
    [
        "", "page/main.js", "//page/main.js", "/page/../main.js", "/page/%2e%2e/transport.py", "/page", "/page/",
        "/page/../../guard.py", "/page/main.js/", "/page\\main.js", "/PAGE/main.js", "/page/main.js?x",
        "/page/main.js%00", "/index.html", "/?", "/?toke=1", "/etc/passwd", f"http://{HOST}/", "/ws/", f"/k/{TOKEN}/",
    ],
)  # fmt: skip
def test_other_paths_lead_nowhere(path: str) -> None:
    refusal = asked("GET", path, OWN)
    assert isinstance(refusal, Refusal)
    assert refusal.status == 404
    stranger = asked("GET", path, {"Host": HOST})
    assert isinstance(stranger, Refusal)
    assert stranger.status == 401  # who hears nothing of which there are


@pytest.mark.parametrize("token", ["", TOKEN[:-1], f"{TOKEN}/", TOKEN.lower(), f"{TOKEN}&x={TOKEN}", f"%78{TOKEN[1:]}"])
def test_wrong_tokens_let_nobody_in(token: str) -> None:
    for framed in (False, True):
        for path in (f"/?token={token}", f"/k/{token}/", f"/k/{token}/ws"):
            assert isinstance(asked("GET", path, {"Host": HOST, "Origin": f"http://{HOST}"}, framed=framed), Refusal)


def test_a_ticket_lets_one_page_in_once() -> None:
    guard = Guard(TOKEN, 8123, ROUTES)
    guard.tickets.append("t" * 32)
    enter = "GET", f"/?token={'t' * 32}"
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
        found = guard.admit("GET", f"/?token={token}", given.items())
        assert found == Admitted("/", enters=True) if is_let_in else isinstance(found, Refusal)
        assert isinstance(guard.admit("GET", "/", {**given, "Cookie": f"blocks-8123={TOKEN}"}.items()), Refusal)


def test_tickets_that_no_page_takes_do_not_heap_up() -> None:
    guard = Guard(TOKEN, 8123, ROUTES)
    for number in range(100):
        guard.tickets.append(f"{number:032}")
    assert isinstance(guard.admit("GET", f"/?token={0:032}", [("Host", HOST)]), Refusal)
    assert guard.admit("GET", f"/?token={99:032}", [("Host", HOST)]) == Admitted("/", enters=True)


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_notebook_holds_the_page_in_a_frame(site: str) -> None:
    frame = {**FRAME, "Sec-Fetch-Site": site}
    assert asked("GET", f"/k/{TOKEN}/", frame, framed=True) == Admitted("/")
    own = {"Host": HOST, "Sec-Fetch-Site": "same-origin", "Origin": f"http://{HOST}"}
    assert asked("GET", f"/k/{TOKEN}/page/main.js", own, framed=True) == Admitted("/page/main.js")
    assert asked("GET", f"/k/{TOKEN}/ws", own, framed=True) == Admitted("/ws")
    for path in ("/", "/page/main.js", "/ws", "/k/", f"/k/{TOKEN}", f"/k/{TOKEN}/..", f"/k/{TOKEN}/page/../ws"):
        assert isinstance(asked("GET", path, {**own, "Cookie": ""}, framed=True), Refusal)
    for path, changed in [
        (f"/k/{TOKEN}/page/main.js", {}),  # as a script of another site
        (f"/k/{TOKEN}/ws", {}),
        (f"/k/{TOKEN}/", {"Sec-Fetch-Mode": "no-cors", "Sec-Fetch-Dest": "script"}),
        (f"/k/{TOKEN}/", {"Sec-Fetch-Dest": "embed"}),
        (f"/k/{TOKEN}/", {"Origin": "http://localhost:8888"}),
        (f"/?token={TOKEN}", {}),
    ]:
        assert isinstance(asked("GET", path, {**frame, **changed}, framed=True), Refusal)


def test_a_token_is_long_and_cookies_of_ports_differ() -> None:
    with pytest.raises(ValueError, match="20 letters"):
        Guard("short", 8123, ROUTES)
    assert cookie_name(1) != cookie_name(2)
