"""Chromium without a window, driven by the DevTools protocol: opens a page, waits, points, types, looks, measures.

    with Browser(dark=True) as page:
        page.open(url)
        page.until("document.querySelector('svg')")
        page.click("#run")
        page.assert_clean()

Found by BLOCKS_CHROMIUM, then on the PATH; where there is none, tests that ask for the fixture `chromium` skip.
"""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any, Self

__all__ = ["DEADLINE", "Browser", "found"]

DEADLINE = 40.0
"""Seconds that anything may take, on a machine that is busy with other things."""
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-extensions",
    "--disable-default-apps", "--disable-features=Translate,OptimizationHints", "--remote-debugging-port=0",
)  # fmt: skip
_KEYS = {
    "Enter": 13, "Tab": 9, "Escape": 27, "Backspace": 8, "Delete": 46, "Home": 36, "End": 35, "PageUp": 33,
    "PageDown": 34, "ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40, "F1": 112, "F2": 113, "F5": 116,
    ".": 190, ",": 188, "-": 189, "/": 191, "'": 222,
}  # fmt: skip
_MODIFIERS = {"Alt": 1, "Control": 2, "Meta": 4, "Shift": 8}
_CENTER = """(selector => {
  const found = document.querySelectorAll(selector);
  if (!found.length) return {why: 'nothing matches'};
  const element = found[0];
  element.scrollIntoView({block: 'nearest', inline: 'nearest', behavior: 'instant'});
  const box = element.getBoundingClientRect(), x = box.x + box.width / 2, y = box.y + box.height / 2;
  const hit = document.elementFromPoint(x, y);
  if (!box.width || !box.height) return {why: 'it has no size'};
  if (!hit) return {why: `its center (${x}, ${y}) lies outside of the window`};
  if (hit !== element && !element.contains(hit)) return {why: `covered by ${hit.outerHTML.slice(0, 200)}`};
  return {x, y};
})"""


def _held(modifiers: str) -> int:
    return sum(_MODIFIERS[name] for name in modifiers.split("+") if name)


def found() -> str | None:
    """The path of Chromium, where there is one."""
    asked = os.environ.get("BLOCKS_CHROMIUM")
    return asked or next((path for path in map(shutil.which, _NAMES) if path), None)


class Browser:
    """One page of a Chromium of its own, with a new profile.

    width, height: of the window, in pixels of the screen. zoom: 2.0 is a reader's 200 %: the page has half as many
    pixels of CSS. scale: pixels of a picture per pixel of the screen.
    """

    def __init__(
        self,
        *,
        width: int = 1280,
        height: int = 800,
        dark: bool = False,
        reduced_motion: bool = False,
        scale: float = 1.0,
        zoom: float = 1.0,
    ) -> None:
        self.messages: list[str] = []
        """Errors and warnings of the console, exceptions, refusals of the content security policy, dialogs."""
        self._metrics = {
            "width": round(width / zoom), "height": round(height / zoom), "deviceScaleFactor": scale * zoom,
            "mobile": False,
        }  # fmt: skip
        self._features = [
            {"name": "prefers-color-scheme", "value": "dark" if dark else "light"},
            {"name": "prefers-reduced-motion", "value": "reduce" if reduced_motion else "no-preference"},
        ]
        self._last = 0

    # --- its life ------------------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        self._ends = contextlib.ExitStack()
        with contextlib.ExitStack() as ends:
            profile = Path(ends.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True)))
            self._start(ends, profile)
            self._ends = ends.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.close()

    def _start(self, ends: contextlib.ExitStack, profile: Path) -> None:
        from websockets.sync.client import connect

        program = found()
        assert program is not None, "no Chromium"
        log = ends.enter_context((profile / "stderr.txt").open("w+b"))
        self._process = subprocess.Popen(
            [program, *_OPTIONS, f"--user-data-dir={profile}", "about:blank"],
            stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
        )  # fmt: skip
        ends.callback(self._end)
        port = profile / "DevToolsActivePort"
        begun = time.monotonic()
        while not (port.exists() and port.read_text().count("\n") > 0):
            if self._process.poll() is not None or time.monotonic() > begun + DEADLINE:
                log.seek(0)
                raise RuntimeError(f"Chromium did not start: {log.read().decode(errors='replace')[-2000:]}")
            time.sleep(0.01)
        number, path = port.read_text().split("\n")[:2]
        # No limit of size: a picture of the page is one message.
        address = f"ws://127.0.0.1:{number}{path}"
        self._socket = ends.enter_context(connect(address, max_size=None, compression=None, proxy=None))
        self._session: str | None = None
        pages = [one for one in self.call("Target.getTargets")["targetInfos"] if one["type"] == "page"]
        page = pages[0]["targetId"] if pages else self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.call("Emulation.setDeviceMetricsOverride", **self._metrics)
        self.call("Emulation.setEmulatedMedia", features=self._features)
        self.call("Emulation.setFocusEmulationEnabled", enabled=True)

    def _end(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    # --- the protocol --------------------------------------------------------------------------------------------

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """What the protocol answers to a method. What it tells meanwhile is kept in `messages`."""
        number = self._send(method, params)
        limit = time.monotonic() + DEADLINE
        while True:
            told = json.loads(self._socket.recv(timeout=max(0.0, limit - time.monotonic())))
            if told.get("id") == number:
                if "error" in told:
                    raise RuntimeError(f"{method}: {told['error']}")
                result: dict[str, Any] = told["result"]
                return result
            if "method" in told:
                self._heard(told["method"], told["params"])

    def _send(self, method: str, params: dict[str, Any]) -> int:
        self._last += 1
        message: dict[str, Any] = {"id": self._last, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        self._socket.send(json.dumps(message))
        return self._last

    def _heard(self, event: str, told: dict[str, Any]) -> None:
        if event == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning", "assert"):
            texts = [str(one.get("value", one.get("description", one["type"]))) for one in told["args"]]
            self.messages.append(f"console.{told['type']}: {' '.join(texts)}")
        elif event == "Runtime.exceptionThrown":
            details = told["exceptionDetails"]
            text = details.get("exception", {}).get("description", details["text"])
            self.messages.append(f"exception: {text} ({details.get('url', '')}:{details['lineNumber'] + 1})")
        elif event == "Log.entryAdded" and told["entry"]["level"] in ("error", "warning"):
            entry = told["entry"]
            self.messages.append(f"{entry['source']}: {entry['text']} {entry.get('url', '')}".rstrip())
        elif event == "Page.javascriptDialogOpening":
            self.messages.append(f"dialog: {told['type']}: {told['message']}")
            self._send("Page.handleJavaScriptDialog", {"accept": False})
        elif event in ("Inspector.targetCrashed", "Target.targetCrashed"):
            raise RuntimeError("the page crashed")

    # --- the page ------------------------------------------------------------------------------------------------

    def open(self, url: str) -> None:
        """Go to an address; returns when the page and its modules are loaded."""
        failed = self.call("Page.navigate", url=url).get("errorText")
        assert not failed, f"{url}: {failed}"
        self.until("document.readyState === 'complete'")

    def evaluate(self, expression: str) -> Any:
        """The value of an expression of JavaScript, or of the promise that it is, as JSON has it."""
        told = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True, userGesture=True
        )
        if "exceptionDetails" in told:
            details = told["exceptionDetails"]
            raise RuntimeError(f"{expression[:200]}: {details.get('exception', {}).get('description', details)}")
        return told["result"].get("value")

    def until(self, condition: str, *, deadline: float = DEADLINE) -> Any:
        """Wait until an expression is true and return its value (true for an element); fails with what the page shows.

        An expression that raises is not yet true.
        """
        limit = time.monotonic() + deadline
        while True:
            try:
                asked = f"(async () => {{ const v = await ({condition}); return [!!v, v instanceof Node || v]; }})()"
                holds, value = self.evaluate(asked)
            except RuntimeError as error:
                holds, why = False, str(error)
            else:
                why = f"it is {value!r}"
            if holds:
                return value
            if time.monotonic() > limit:
                shown = self.evaluate("location.href + '\\n' + (document.body ? document.body.innerText : '')")
                picture = Path(tempfile.gettempdir()) / f"blocks-browser-{os.getpid()}.png"
                self.screenshot(picture)
                raise AssertionError(
                    f"not within {deadline:g} s: {condition}\n{why}\nmessages: {self.messages}\n"
                    f"picture: {picture}\n{' '.join(str(shown).split())[:1500]}"
                )
            time.sleep(0.02)

    def still(self, selector: str) -> None:
        """Wait until an element no longer changes, so that places measured in it stay valid."""
        place = f"document.querySelector({json.dumps(selector)})"
        look = f"{place}.outerHTML + JSON.stringify({place}.getBoundingClientRect())"
        wait = "await new Promise(done => setTimeout(done, 300))"
        self.until(f"(async () => {{ const was = {look}; {wait}; return was === {look}; }})()")

    def text(self, selector: str = "body") -> str:
        """The text of the first element that matches, as it is seen."""
        return str(self.evaluate(f"document.querySelector({json.dumps(selector)}).innerText"))

    # --- hands ---------------------------------------------------------------------------------------------------

    def center(self, selector: str) -> tuple[float, float]:
        """The center of an element that can be pointed at; waits until there is one and nothing covers it."""
        condition = f"(found => found.why ? null : found)({_CENTER}({json.dumps(selector)}))"
        try:
            place = self.until(condition)
        except AssertionError as error:
            why = self.evaluate(f"{_CENTER}({json.dumps(selector)})")
            raise AssertionError(f"{selector}: {why}\n{error}") from None
        return float(place["x"]), float(place["y"])

    def click(self, selector: str, *, count: int = 1, modifiers: str = "") -> None:
        """Click at the center of an element. count: 2 is a double click. modifiers: as "Control+Shift"."""
        self.click_at(*self.center(selector), count=count, modifiers=modifiers)

    def click_at(self, x: float, y: float, *, count: int = 1, modifiers: str = "") -> None:
        self._mouse("mouseMoved", x, y, modifiers=modifiers)
        for number in range(1, count + 1):
            self._mouse("mousePressed", x, y, modifiers=modifiers, button="left", buttons=1, clickCount=number)
            self._mouse("mouseReleased", x, y, modifiers=modifiers, button="left", clickCount=number)

    def hover(self, x: float, y: float) -> None:
        self._mouse("mouseMoved", x, y)

    def drag(self, x: float, y: float, to_x: float, to_y: float, *, steps: int = 10, modifiers: str = "") -> None:
        """Press at a point, move to another one in steps, release there."""
        self._mouse("mouseMoved", x, y, modifiers=modifiers)
        self._mouse("mousePressed", x, y, modifiers=modifiers, button="left", buttons=1, clickCount=1)
        for i in range(1, steps + 1):
            part = i / steps
            at = x + part * (to_x - x), y + part * (to_y - y)
            self._mouse("mouseMoved", *at, modifiers=modifiers, button="left", buttons=1)
        self._mouse("mouseReleased", to_x, to_y, modifiers=modifiers, button="left", clickCount=1)

    def wheel(self, x: float, y: float, *, dx: float = 0.0, dy: float = 0.0, modifiers: str = "") -> None:
        """Turn the wheel over a point; dy > 0 is toward the reader, by pixels."""
        self._mouse("mouseWheel", x, y, modifiers=modifiers, deltaX=dx, deltaY=dy)

    def _mouse(self, kind: str, x: float, y: float, *, modifiers: str = "", **more: Any) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, modifiers=_held(modifiers), **more)

    def press(self, *keys: str) -> None:
        """Press keys one after the other: "Tab", "a", "Control+k", "Shift+ArrowLeft"."""
        for chord in keys:
            before, key = (chord[:-1], "+") if chord.endswith("+") else chord.rpartition("+")[::2]
            held = _held(before)
            code = {" ": "Space"}.get(key, f"Key{key.upper()}" if key.isascii() and key.isalpha() else key)
            told: dict[str, Any] = {"key": key, "modifiers": held, "code": code if len(key) == 1 else key}
            if key in _KEYS or key.isalnum():  # "(" has the number of an arrow key
                told["windowsVirtualKeyCode"] = _KEYS.get(key, ord(key.upper()[0]))
            text = "\r" if key == "Enter" else key if len(key) == 1 else ""
            if text and not held & ~_MODIFIERS["Shift"]:
                self.call("Input.dispatchKeyEvent", type="keyDown", text=text, **told)
            else:
                self.call("Input.dispatchKeyEvent", type="rawKeyDown", **told)
            self.call("Input.dispatchKeyEvent", type="keyUp", **told)

    def type(self, text: str) -> None:
        """Type a text, key by key."""
        for letter in text:
            self.press(letter)

    # --- what it shows -------------------------------------------------------------------------------------------

    def screenshot(self, path: Path | str) -> None:
        """The window as a PNG file."""
        Path(path).write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def accessible(self) -> list[dict[str, Any]]:
        """What a screen reader meets, in its order: role, name, and properties such as focusable, checked, level."""
        nodes = self.call("Accessibility.getFullAXTree")["nodes"]
        return [
            {
                "role": node["role"]["value"],
                "name": str(node.get("name", {}).get("value", "")),
                **{one["name"]: one["value"].get("value") for one in node.get("properties", ())},
            }
            for node in nodes
            if not node["ignored"]
        ]

    def begin_frames(self) -> None:
        """Begin to note when frames are drawn."""
        self.evaluate(
            "(() => { const seen = window.__frames = []; (function next(t) { if (window.__frames !== seen) return;"
            " if (t) seen.push(t); requestAnimationFrame(next); })(); })()"
        )

    def end_frames(self) -> list[float]:
        """Milliseconds from frame to frame since `begin_frames`."""
        times = self.evaluate("(() => { const seen = window.__frames; window.__frames = null; return seen; })()")
        return [b - a for a, b in itertools.pairwise(times)]

    def assert_clean(self, *but: str) -> None:
        """No error, warning, exception, refusal or dialog since the start, but those that hold a text of `but`."""
        self.evaluate("new Promise(done => setTimeout(done, 0))")  # what is under way is heard before its answer
        against = [one for one in self.messages if not any(part in one for part in but)]
        assert not against, "\n".join(against)
