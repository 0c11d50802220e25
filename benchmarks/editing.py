"""A diagram edited in Chromium: from a gesture to the painted drawing, frames of a drag, the size of the page.

The reference is the same page at rest, and the drawing alone in the same process (see `drawing`). Chromium is found by
BLOCKS_CHROMIUM or on the PATH; without it nothing is measured.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from blocks.model.document import dumps
from blocks.server.live_server import LiveServer
from tests.support.browser import Browser, found

from .drawing import placed
from .live import p95, tell

__all__ = ["main"]

GOALS = {15: 50, 100: 100, 500: 200}
REPEATS = 7
PAINTED = """(act => new Promise(done => {
  const begun = performance.now(), stage = document.getElementById('stage');
  const seen = new MutationObserver(() => {
    seen.disconnect();
    const channel = new MessageChannel();
    channel.port1.onmessage = () => done(performance.now() - begun);
    requestAnimationFrame(() => channel.port2.postMessage(null));
  });
  seen.observe(stage, {childList: true, subtree: true});
  act();
}))"""
"""Milliseconds from an act to the end of the frame that shows what came of it."""
PRESS = """() => document.getElementById('view')
  .dispatchEvent(new KeyboardEvent('keydown', {{key: '{}', bubbles: true}}))"""
PUT = """() => {{ const field = document.querySelector('#panel input[aria-label="{}"]');
  field.value = '{}'; field.dispatchEvent(new Event('change')); }}"""


def main() -> None:
    if found() is None:
        print("no Chromium: the editor was not measured")
        return
    for blocks, goal in GOALS.items():
        with _edited(blocks) as page:
            _gestures(page, blocks, goal)
            if blocks == 500:
                _frames(page)
    _size()


@contextmanager
def _edited(blocks: int) -> Iterator[Browser]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "placed.json"
        path.write_text(dumps(placed(blocks // 5)))
        server = LiveServer(path, edit=True).start()
        try:
            with Browser() as page:
                page.open(server.url)
                page.until("document.querySelector('#stage svg [data-path]')")
                time.sleep(1.0)
                yield page
        finally:
            server.stop()


def _gestures(page: Browser, blocks: int, goal: float) -> None:
    """A nudge of one block, a parameter that is typed, and the undoing of each, at rest in between."""
    name = f"reference{blocks // 10}"
    page.evaluate(f"document.querySelector('#lists [data-path=\"{name}\"]').click()")
    page.until(f"document.querySelector('#panel input[aria-label=\"{name}.k\"]')")
    times: dict[str, list[float]] = {"moved": [], "set": [], "undone": []}
    spent: dict[str, list[float]] = {what: [] for what in times}
    undo = "() => [...document.querySelectorAll('#edits button')].find(one => one.textContent === 'Undo').click()"
    for k in range(REPEATS):
        for what, act in (
            ("moved", PRESS.format("ArrowRight" if k % 2 else "ArrowDown")),
            ("set", PUT.format(f"{name}.k", k + 2)), ("undone", undo),
        ):  # fmt: skip
            begun = time.process_time()
            times[what].append(page.evaluate(f"{PAINTED}({act})"))
            spent[what].append(1e3 * (time.process_time() - begun))
            time.sleep(1.5)  # what was drawn in haste is drawn well meanwhile
    for what, taken in times.items():
        beside = f"least {min(taken):.0f}, of the processor in the server {min(spent[what]):.0f}"
        tell(f"{blocks} blocks, edit to painted, {what}", statistics.median(taken), "ms", goal, beside=beside)


def _frames(page: Browser) -> None:
    """Frames while a block is dragged to and fro, of 500."""
    page.begin_frames()
    time.sleep(2.0)
    rest = p95(page.end_frames())
    box = "document.querySelector('#stage .picked').getBoundingClientRect()"
    x, y = page.evaluate(f"(b => [b.x + b.width / 2, b.y + b.height / 2])({box})")
    page.begin_frames()
    page.drag(x, y, x + 150, y + 40, steps=150)
    frames = page.end_frames()
    tell("frames while a block of 500 is dragged, p95", p95(frames), "ms", 20, beside=f"at rest {rest:.1f}")


def _size() -> None:
    """What the page loads, compressed."""
    with _edited(15) as page:
        page.call("Network.setCacheDisabled", cacheDisabled=True)
        page.evaluate("location.reload()")
        time.sleep(0.5)
        page.until("document.querySelector('#stage svg [data-path]')")
        kinds = "[...performance.getEntriesByType('resource'), ...performance.getEntriesByType('navigation')]"
        sizes = page.evaluate(f"{kinds}.reduce((sum, one) => sum + one.encodedBodySize, 0)")
    tell("page, compressed", sizes / 1000, "kB", 150)


if __name__ == "__main__":
    main()
