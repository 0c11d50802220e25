"""A live diagram: its command, its page in Chromium, its run beside `run()`. Times of pages are those of the page.

Chromium is found by BLOCKS_CHROMIUM or on the PATH (Debian's `chromium`); without it the page is left out. Other
work on the machine spoils frames before all else: the reference is the same page at rest, in the same browser.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from blocks import Diagram
from blocks.server.live_run import LiveRun
from blocks.server.live_server import LiveServer
from tests.support.browser import Browser, found

from .diagrams import ROOT
from .streamed import waves

__all__ = ["main", "p95", "tell"]

PAPER = ROOT / "diagrams/paper/iadrc.json"
SIGNALS = ("motor_right.omega", "motor_left.omega", "control_right.u", "control_left.u")
REPEATS = 5
WAVES, ROWS = 33, 200_000
WATCH = """
addEventListener('DOMContentLoaded', () => new MutationObserver((_, watch) => {
  if (!document.querySelector('#drawing svg [data-path]')) return;
  watch.disconnect();
  requestAnimationFrame(() => requestAnimationFrame(() => { window.drawnAt = performance.now(); }));
}).observe(document, {subtree: true, childList: true}));
"""

TAKEN = """
window.taken = {};
window.WebSocket = class extends WebSocket {
  constructor(url) {
    super(url);
    this.addEventListener('message', ({data}) => {
      if (typeof data === 'string') return;
      const length = new DataView(data).getUint32(0, true);
      const {scope, count, signals} = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
      const t = new Float64Array(data, 4 + length, count).at(-1);
      const note = () => { if (signals.length > 2) taken[scope] = t; };
      requestAnimationFrame(() => requestAnimationFrame(note));
    });
  }
};
"""
"""Notes for each scope the last time that it has drawn, by the frames that come."""


def tell(label: str, value: float, unit: str, goal: float, *, at_least: bool = False, beside: str = "") -> None:
    is_met = value >= goal if at_least else value <= goal
    told = f"goal {'>=' if at_least else '<='} {goal:g} {unit} {'met' if is_met else 'MISSED'}"
    print(f"{label:44}{value:9.3g} {unit:12}{told}{f'  ({beside})' if beside else ''}", flush=True)


def main() -> None:
    _runs()
    _command()
    if found() is None:
        print("no Chromium: the page was not measured")
        return
    with _served() as server:
        _first_drawing(server)
        with Browser() as page:
            page.open(server.url)
            page.until("document.querySelector('#drawing svg [data-path]')")
            _frames(page)
    _into_scopes()


@contextmanager
def _served(source: Path | Diagram = PAPER) -> Iterator[LiveServer]:
    server = LiveServer(source).start()
    try:
        yield server
    finally:
        server.stop()


def _runs() -> None:
    """Seconds of the processor of whole live runs and of `run`, in turn; those of one that is paced."""
    diagram = Diagram.load(PAPER)
    diagram.run()
    whole: dict[str, list[float]] = {"run": [], "live": []}
    for _ in range(5 * REPEATS):  # the least of some is noisy: a run is short
        begun = time.process_time()
        plain = diagram.run()
        whole["run"].append(time.process_time() - begun)
        begun = time.process_time()
        live = LiveRun(diagram.start(), lambda: None)
        live.go()
        live.wait()
        whole["live"].append(time.process_time() - begun)
        assert live.results().values.tobytes() == plain.values.tobytes()
    ratio = min(whole["live"]) / min(whole["run"])
    tell("CPU of a live run against run()", ratio, "", 1.2, beside=f"run() {min(whole['run']):.3f} s")
    live = LiveRun(diagram.start(), lambda: None)
    live.go(1.0)
    begun, clock = time.process_time(), time.perf_counter()
    time.sleep(5.0)
    share = (time.process_time() - begun) / (time.perf_counter() - clock)
    live.stop()
    tell("paced 1x, of a core", 100 * share, "%", 5)


def _command() -> None:
    """From the command to its address, as a user waits for it."""
    times = []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        command = [sys.executable, "-m", "blocks", "live", str(PAPER), "--no-browser"]
        live = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            assert live.stdout is not None
            while "http://" not in live.stdout.readline():
                assert live.poll() is None, "the command has ended"
            times.append(time.perf_counter() - begun)
        finally:
            live.kill()
            live.communicate()
    tell("command to address", min(times), "s", 0.8, beside=f"median {statistics.median(times):.2f} s")


def _first_drawing(server: LiveServer) -> None:
    """From the navigation to the painted drawing: in a browser that has just begun, and loaded again."""
    made: dict[str, list[float]] = {"cold": [], "warm": []}
    sizes = 0
    for _ in range(REPEATS):
        with Browser() as page:
            page.call("Page.addScriptToEvaluateOnNewDocument", source=WATCH)
            for kind in ("cold", "warm", "warm"):
                page.open(server.url)
                made[kind].append(page.until("window.drawnAt"))
                page.open("about:blank")
            page.call("Network.setCacheDisabled", cacheDisabled=True)
            page.open(server.url)
            page.until("window.drawnAt")
            kinds = "[...performance.getEntriesByType('resource'), ...performance.getEntriesByType('navigation')]"
            sizes = page.evaluate(f"{kinds}.reduce((sum, one) => sum + one.encodedBodySize, 0)")
    for kind, goal in (("cold", 450), ("warm", 200)):
        tell(
            f"first drawing, {kind}", min(made[kind]), "ms", goal, beside=f"median {statistics.median(made[kind]):.0f}"
        )
    tell("page, compressed", sizes / 1000, "kB", 120)


def p95(times: list[float]) -> float:
    return float(np.percentile(times, 95))


def _frames(page: Browser) -> None:
    """Frames at rest, while the drawing is dragged, and while four scopes show a run at 10 times real time."""
    page.begin_frames()
    time.sleep(2.0)
    rest = p95(page.end_frames())
    box = page.evaluate("(({x, y, width, height}) => [x, y, width, height])"
                        "(document.querySelector('#drawing').getBoundingClientRect())")  # fmt: skip
    x, y = box[0] + box[2] - 30, box[1] + box[3] - 30
    page.begin_frames()
    for turn in range(4):
        page.drag(x, y, x - 200, y - (-1) ** turn * 100, steps=60)
        x, y = (x - 200, y) if turn % 2 == 0 else (x + 200, y)
    tell("frames while the drawing is dragged, p95", p95(page.end_frames()), "ms", 20, beside=f"at rest {rest:.1f}")
    _open_scopes(page, SIGNALS)
    page.evaluate("[...document.querySelectorAll('#runbar select')].at(-1).value = '10'")
    _press(page, "Run")
    page.until("document.getElementById('runbar').dataset.state === 'running'")
    page.begin_frames()
    time.sleep(5.0)
    tell("frames, four scopes at 10x, p95", p95(page.end_frames()), "ms", 20, beside=f"at rest {rest:.1f}")
    _press(page, "Stop")


def _into_scopes() -> None:
    """Recorded values that scopes take each second: from Run until four of them show the last row."""
    made = waves(WAVES, ROWS)
    made.run()  # compiled
    with _served(made) as server, Browser() as page:
        page.call("Page.addScriptToEvaluateOnNewDocument", source=TAKEN)
        page.open(server.url)
        page.until("document.querySelector('#stage svg [data-path]')")
        _open_scopes(page, [f"s{k}.y" for k in range(4)])
        for k in range(4, WAVES - 1):
            page.evaluate(
                f"(one => {{ one.value = 's{k}.y'; one.onchange(); }})"
                f"([...document.querySelectorAll('#scopes [aria-label=\"Add a signal to this scope\"]')][{k % 4}])"
            )
        begun = time.perf_counter()
        _press(page, "Run")
        times = "Object.values(window.taken)"
        page.until(f"{times}.length === 4 && {times}.every(t => t > {ROWS / 1000 - 0.002})")
        wall = time.perf_counter() - begun
    begun = time.perf_counter()
    made.run()
    alone = time.perf_counter() - begun
    rate = ROWS * (WAVES - 1) / wall / 1e6
    tell("values into scopes", rate, "million/s", 4, at_least=True, beside=f"{wall:.2f} s, run() alone {alone:.2f} s")


def _open_scopes(page: Browser, signals: Sequence[str]) -> None:
    for signal in signals:
        page.evaluate(f"document.querySelector('#lists [data-signal=\"{signal}\"]').click()")
    page.until(f"document.querySelectorAll('#scopes canvas').length >= {len(signals)}")


def _press(page: Browser, name: str) -> None:
    page.evaluate(f"[...document.querySelectorAll('#runbar button')].find(one => one.textContent === '{name}').click()")


if __name__ == "__main__":
    main()
