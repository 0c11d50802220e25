"""What a user does in the page of an editor: with the mouse alone, with the keyboard alone."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from blocks.server.editor import Editor
from blocks.server.live_server import LiveServer

from .browser import DEADLINE

__all__ = ["Hands", "edited_page"]

_REST = """new Promise(done => { let last = '', same = 0; (function look() {
  const {x, y, width} = document.getElementById('stage').getBoundingClientRect();
  const now = [x, y, width, document.getElementById('stage').innerHTML.length].join();
  [same, last] = [now === last ? same + 1 : 0, now];
  if (same > 4) done(); else requestAnimationFrame(look); })(); })"""
_PORT = """(([name, kind, own]) => { const box = document.querySelector(`#stage [data-path="${name}"]`);
  const [x, y] = box.dataset.at.split(' ').map(Number);
  const ports = box.dataset[kind].split(';').map(one => one.split(' '));
  const [dx, dy] = ports.find(one => (one[2] ?? '') === own).map(Number);
  const at = document.getElementById('stage').getBoundingClientRect();
  const k = at.width / document.querySelector('#stage svg').width.baseVal.value;
  return [at.x + (x + dx) * k, at.y + (y + dy) * k]; })"""

_BUTTON = """(([where, text]) => { const found = [...document.querySelectorAll(`${where} button`)]
  .find(one => [one.textContent, one.ariaLabel].includes(text) && !one.disabled);
  found.scrollIntoView({block: 'nearest', behavior: 'instant'});
  const box = found.getBoundingClientRect(), [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  return found.contains(document.elementFromPoint(x, y)) && [x, y]; })"""


class Hands:
    """A page of an editor, and the file behind it."""

    def __init__(self, page: Any, server: LiveServer) -> None:
        self.page, self.server = page, server

    @property
    def editor(self) -> Editor:
        document = self.server._open.document
        assert isinstance(document, Editor)
        return document

    def type_name(self, block: str, name: str) -> None:
        """Select a block and type another name over its name, without Return."""
        self.page.click_at(*self.box(block))
        self.page.press("F2")
        self.page.until("document.querySelector('.typed')")
        self.page.press("Control+a")
        self.page.type(name)

    # --- what is seen --------------------------------------------------------------------------------------------

    def rest(self) -> None:
        """Wait until the drawing stands still."""
        self.page.evaluate(_REST)

    def seen(self, what: str) -> None:
        """Wait until something is in the drawing."""
        self.page.until(f"document.querySelector({json.dumps(f'#stage {what}')})")

    def box(self, name: str) -> tuple[float, float]:
        """The center of a block or a terminal on the screen."""
        self.rest()
        where = json.dumps(f'#stage [data-path="{name}"] :is(.face, .flag), #stage [data-path="{name}"].flag')
        x, y = self.page.evaluate(
            f"(b => [b.x + b.width / 2, b.y + b.height / 2])(document.querySelector({where}).getBoundingClientRect())"
        )
        return x, y

    def port(self, end: str, kind: str) -> tuple[float, float]:
        """A port on the screen. kind: "in" or "out"."""
        self.rest()
        name, _, own = end.partition(".")
        x, y = self.page.evaluate(f"{_PORT}({json.dumps([name, kind, own])})")
        return x, y

    def done(self, act: Callable[[], Any]) -> None:
        """Do something that is one more step of the history; returns when the page has taken the answer."""
        steps, limit = len(self.editor.done), time.monotonic() + DEADLINE
        act()
        while len(self.editor.done) == steps and time.monotonic() < limit:
            self.page.evaluate("new Promise(requestAnimationFrame)")
        done = [step.what for step in self.editor.done[steps:]]
        assert len(done) == 1, f"done: {done}. The page shows: {' '.join(self.page.text().split())[:1500]}"
        self.page.until(f"document.body.dataset.revision >= {self.editor.revision}")
        self.page.until("document.querySelector('#view:not([aria-busy=true])')")

    # --- with the keyboard ---------------------------------------------------------------------------------------

    def type_block(self, text: str) -> None:
        """Type into the drawing, the first letter included, and take the first entry."""
        self.rest()
        self.page.press(text[0])
        self.page.until("document.querySelector('dialog.search li')")
        self.page.type(text[1:])
        self.done(lambda: self.page.press("Enter"))

    def tab_to(self, selector: str) -> None:
        """Press Tab until an element has the focus, when it is there."""
        self.page.until(f"document.querySelector({json.dumps(selector)})")
        for _ in range(300):
            if self.page.evaluate(f"document.activeElement?.matches({json.dumps(selector)})"):
                return
            self.page.press("Tab")
        raise AssertionError(f"the Tab key does not lead to {selector}")

    # --- with the mouse ------------------------------------------------------------------------------------------

    def button(self, text: str, where: str = "#edits") -> None:
        """Click the button of a text, or of a label."""
        self.rest()
        x, y = self.page.until(f"{_BUTTON}({json.dumps([where, text])})")
        self.page.click_at(x, y)

    def insert(self, text: str) -> None:
        """Click Add, say what, click the first entry."""
        self.button("Add")
        self.page.until("document.querySelector('dialog.search li')")
        self.page.type(text)
        self.done(lambda: self.page.click("#found [role=option]"))

    def said(self, text: str) -> None:
        """Fill the field of a dialog in, and click OK."""
        self.page.until("document.querySelector('dialog :is(input, textarea)')")
        self.page.evaluate("document.querySelector('dialog :is(input, textarea)').select()")
        for k, line in enumerate(text.split("\n")):
            if k:
                self.page.press("Enter")
            self.page.type(line)
        self.done(lambda: self.button("OK", "dialog"))

    def wire(self, source: str, sink: str) -> None:
        """Drag from an output to an input."""
        self.done(lambda: self.page.drag(*self.port(source, "out"), *self.port(sink, "in")))
        self.seen(f'[data-sink="{sink}"]')


@contextmanager
def edited_page(chromium: Any, path: Path, **given: Any) -> Iterator[Hands]:
    """A file that is edited in a browser."""
    server = LiveServer(path, edit=True, **given).start()
    try:
        with chromium() as page:
            page.open(server.url)
            page.until("!document.getElementById('edits').hidden")
            yield Hands(page, server)
    finally:
        server.stop()
