"""What is open: the document, its run and what was turned in it, and the pages that look at it.

All that a session does, it does in one thread, in the order in which it was asked: messages of pages, news of the run,
and a look at the file twice a second. So no handler needs a lock. What takes long is done aside, by a second thread,
which sees all as it stood when it was asked.
"""

from __future__ import annotations

import copy
import math
import queue
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from ..api.case import EMPTY, Case
from ..api.diagram import Diagram
from ..text.element_names import indexed
from ..text.errors import BlocksError, Fault, UsageError
from ..text.version import __version__
from .live_run import PATIENCE, LiveRun, check_pace, own_fault
from .messages import ASIDE, Answer, answer, handles
from .open_document import Document, told_fault
from .scopes import Page, trim

Asks = Callable[[str, Callable[[bool], None]], None]

LOOK = 0.5
"""Seconds between two looks at the file."""
NEWS = 1 / 15
"""Seconds between two messages of how the run stands."""
MOST_LOGGED = 1000
"""Elements of signals that a live run records all."""


class Client(Protocol):
    """A page that is connected."""

    def send(self, message: dict[str, Any] | bytes, slot: str = "") -> bool:
        """Send a message, or a binary frame, from any thread; of the frames in a slot only the newest waits."""

    def answered(self) -> None:
        """One of its messages was."""


class Session:
    """An open document with its run.

    values, inputs: what was set in place of what the file says, by path and by name, for this run and the next ones.
    runs: the live run, of the number `number`, and earlier ones, whose rows are kept; begun: what was set when they
    began; chosen: the variants of the live one. pages: the scopes of each page. hearers: called when the run has news,
    or another document was read. engine, trust: as of `Diagram.run`. asks: puts a question to the user at the terminal,
    and calls back with the answer, from any thread; None without a terminal. waits_for: the file that a question is
    about. Modules that answer messages stand above this one.
    """

    def __init__(
        self,
        document: Document,
        case: Case = EMPTY,
        asks: Asks | None = None,
    ) -> None:
        self.document, self.case, self.asks = document, case.without("variants", "log"), asks
        self.engine, self.trust = case.engine, case.trust
        self.waits_for = ""
        self.values, self.inputs = dict(case.parameters), dict(case.named_inputs())
        self.server = secrets.token_hex(8)
        self.runs: dict[int, LiveRun] = {}
        self.live: LiveRun | None = None
        self.begun: dict[int, dict[str, Any]] = {}
        self.chosen: dict[str, str] = {}
        self.pages: dict[Client, Page] = {}
        self.maps: dict[str, tuple[int, Any]] = {}  # the last map of a loop, by what it was asked for
        self.hearers: list[Callable[[], None]] = []
        self.number = 0
        self._todo: queue.SimpleQueue[tuple[Client | None, Any]] = queue.SimpleQueue()
        self._is_told = threading.Event()  # news of the run wait in the queue
        self._told = 0.0
        self._aside: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._jobs: list[_Job] = []  # what is computed aside, and what waits for that
        self._job: _Job | None = None  # of a session as it stood
        self._is_settling = False
        # Python waits for this one: it ends daemon threads where they are, which an FMU that computes does not survive.
        self._thread = threading.Thread(target=self._work, name="blocks session", daemon=False)
        self._second = threading.Thread(target=self._work_aside, name="blocks session", daemon=True)
        self._thread.start()
        self._second.start()

    # --- from other threads ------------------------------------------------------------------------------------------

    def connected(self, client: Client) -> None:
        self._todo.put((client, "connected"))

    def disconnected(self, client: Client) -> None:
        self._todo.put((client, "disconnected"))

    def received(self, client: Client, message: Mapping[str, object]) -> None:
        """A message of a page."""
        self._todo.put((client, message))

    def changed(self) -> None:
        """The run has news."""
        if not self._is_told.is_set():
            self._is_told.set()
            self._todo.put((None, "news"))

    def later(self, act: Callable[[], None]) -> None:
        """Do something in the thread of the session."""
        self._todo.put((None, act))

    def close(self) -> None:
        """End the run and the threads, after what they are in: a step of an FMU may take long."""
        self._todo.put((None, "close"))
        self._thread.join()

    # --- in its own thread -------------------------------------------------------------------------------------------

    def _work(self) -> None:
        looked = time.monotonic()
        while threading.main_thread().is_alive():  # else Python is about to end
            try:
                client, what = self._todo.get(timeout=LOOK)
            except queue.Empty:
                client, what = None, ""
            if what == "close":
                break
            try:
                self._do(client, what)
                if not what:
                    self._settle()
                if time.monotonic() - looked > LOOK:
                    looked = time.monotonic()
                    if self.document.has_changed() and self.document.read():
                        self.tell_document()
            except Exception as error:  # what one page asked for, or a bad file, must not silence the others
                self.broadcast(_failed(error))
        self._drop(list(self._jobs))
        self._aside.put(None)
        self._leave()
        self._second.join()

    def _do(self, client: Client | None, what: Any) -> None:
        if what == "news":
            self._is_told.clear()
            self.tell_run()
            for each in self.pages:
                self._show(each)
            for hear in self.hearers:
                hear()
        elif client is None and isinstance(what, dict):
            self._take(**what)
        elif client is None and callable(what):
            what()
        elif client is not None and what == "connected":
            self.pages[client] = Page()
            client.send(self.hello())
        elif client is not None and what == "disconnected":
            self.pages.pop(client, None)
            self._drop([job for job in self._jobs if job.client is client])
        elif client is not None and what.get("do") in ASIDE:
            self._put_aside(client, what)
        elif client in self.pages:
            self._answer(client, what, self)
            self._show(client)

    def _settle(self) -> None:
        """When nothing is asked: what was drawn in haste is drawn well, in a thread: the next gesture need not wait."""
        if not self._is_settling and (rough := self.document.rough()):
            self._is_settling = True
            told = (self.document.revision, rough)
            threading.Thread(target=self._draw_well, args=told, name="blocks drawing", daemon=True).start()

    def _draw_well(self, revision: int, rough: list[Any]) -> None:
        made: list[object] = []
        try:
            made = [(level, *draw()) for level, draw in rough]
        finally:
            self._todo.put((None, {"revision": revision, "made": made}))

    def _take(self, revision: int, made: list[Any]) -> None:
        """Show what was drawn well, where the document is still the same."""
        self._is_settling = False
        for level, drawn, svg in made if revision == self.document.revision else ():
            if self.document.settle(level, drawn, svg):
                for client, page in self.pages.items():
                    if page.level == level:
                        client.send({"is": "drawing", "level": level, "svg": svg, "settled": True})

    def _show(self, client: Client) -> None:
        for number, frame in enumerate(self.pages[client].frames(self.runs, self.live)):
            client.send(frame, slot=f"scopes {number}")

    def _work_aside(self) -> None:
        while (job := self._aside.get()) is not None:
            self._answer(job.client, job.message, job.seen)
            self._jobs.remove(job)

    def _put_aside(self, client: Client, message: Mapping[str, object]) -> None:
        """Let the second thread answer a message, as all stands now."""
        seen = self._as_it_stands()
        seen._job = job = _Job(client, message, seen)
        self._jobs.append(job)
        self._aside.put(job)

    def cancel(self, page: Page | None, number: int) -> None:
        """End what a page asked for by the message of a number, where it is computed aside."""
        own = [job for job in self._jobs if self.pages.get(job.client) is page]
        self._drop([job for job in own if job.message.get("id") == number])

    def _drop(self, jobs: list[_Job]) -> None:
        for job in jobs:
            job.is_dropped = job.message.get("do") != "save"  # a file counts, like an edit

    def check_wanted(self) -> None:
        """Raise UsageError (E501) where nobody waits any more for what this session, as it stood, is asked."""
        if self._job is not None and self._job.is_dropped:
            raise UsageError(Fault("E501", str(self._job.message.get("do")), "was cancelled.", "Request it again."))

    def _as_it_stands(self) -> Session:
        """The same, with a document and values that do not change any more."""
        seen = copy.copy(self)
        seen.document = copy.copy(self.document)
        seen.document.variants = {**self.document.variants}
        seen.values, seen.inputs = {**self.values}, {**self.inputs}
        return seen

    def _answer(self, client: Client, message: Mapping[str, object], asked: Session) -> None:
        """asked: this session, or what it was when the message came."""
        try:
            try:
                asked.check_wanted()
                told = answer(asked, message, self.pages.get(client))
            except BlocksError as error:
                paths = asked.document.paths
                told = {"is": "error", "faults": [told_fault(fault, paths) for fault in error.faults]}
        except Exception as error:  # a page must not end the session of another one
            told = _failed(error)
        finally:
            client.answered()
        if told is not None:
            client.send({**told, "re": message.get("id")})

    @property
    def is_outdated(self) -> bool:
        """Whether the page that asks this, aside, has asked something else since."""
        jobs = list(self._jobs)
        later = jobs[jobs.index(self._job) + 1 :] if self._job in jobs else []
        return any(job.client is self._job.client for job in later) if self._job is not None else False

    @property
    def is_asked_more(self) -> bool:
        """Whether another question waits to be answered aside: what takes very long ends for it."""
        return not self._aside.empty()

    def broadcast(self, message: dict[str, Any]) -> None:
        """Send a message to all pages."""
        for client in self.pages:
            client.send(message)

    def tell_document(self) -> None:
        """Tell all pages that the document is another one now, with the drawing of the level that each shows."""
        told, document = self.document.told(), self.document
        levels = {"", *(block["path"] for block in told["blocks"] if block["kind"] == "diagram")}
        for client, page in self.pages.items():
            while page.level not in levels:
                page.level = page.level.rpartition(".")[0]
            svg = document.drawing(page.level) if document.diagram is not None else ""
            client.send({"is": "document", **told, "level": page.level, "svg": svg})
        for hear in self.hearers:
            hear()

    def hello(self) -> dict[str, Any]:
        """All that a page needs to show the document at once."""
        document = self.document
        svg = document.drawing("") if document.diagram is not None else ""
        return {
            "is": "hello", "server": self.server, "version": __version__, "document": document.told(), "svg": svg,
            "run": self.run_told(),
        }  # fmt: skip

    # --- the run -----------------------------------------------------------------------------------------------------

    def begin(self, stop: object = None) -> LiveRun:
        """A new run, which stands at its start, in the place of the one that was."""
        shown = self.document.shown
        self._leave(PATIENCE)
        trim(self.runs)
        settings: dict[str, Any] = {} if stop is None else {"stop": stop}
        run = shown.start(
            self.case.without("parameters", "inputs"), parameters=self.values, inputs=self.inputs,
            log=self._logged(shown), **settings,
        )  # fmt: skip
        self.number += 1
        self.begun[self.number], self.chosen = {**self.values, **self.inputs}, dict(self.document.variants)
        self.live = self.runs[self.number] = LiveRun(run, self.changed)
        return self.live

    def _leave(self, patience: float | None = None) -> None:
        """End the run, and wait until its FMUs are freed: of some there can be only one. Raises UsageError (E501)."""
        if self.live is not None:
            self.live.stop()
            if not self.live.wait(patience):
                raise UsageError(self.live.busy)
            self.live = None

    def _logged(self, shown: Diagram) -> list[str]:
        """What a live run records: all signals; where these are too many, those of the file and of the scopes."""
        planned = self.document.planned or shown.check()
        names = list(planned.signals)
        elements = sum(len(planned.signal(name).references) for name in names)
        if elements <= MOST_LOGGED:
            return names
        scoped = {indexed(name)[0] for page in self.pages.values() for name in page.signals()}
        return list(dict.fromkeys([*planned.log, *(name for name in names if name in scoped)]))

    @property
    def running(self) -> LiveRun:
        """The run. Raises UsageError (E501) where there is none."""
        if self.live is None:
            raise UsageError(Fault("E501", self.document.name, "there is no run.", "Start a run first."))
        return self.live

    def run_told(self) -> dict[str, object]:
        """How the run stands, as the page gets it."""
        live = self.live
        if live is None:
            return {"is": "run", "id": 0, "state": "none"}
        settings = live.prepared.plan.settings
        paths = self.document.paths if live.error else set()
        faults = [] if live.error is None else [told_fault(fault, paths) for fault in live.error.faults]
        return {
            "is": "run", "id": self.number, "state": live.state, "t": live.t, "steps": live.steps,
            "rejected": live.rejected, "pace": live.pace, "lag": live.lag, "seconds": live.seconds, "faults": faults,
            "start": float(settings.start), "stop": None if settings.stop is None else float(settings.stop),
            "failing": _plain(live.failing()),
        }  # fmt: skip

    def tell_run(self) -> None:
        """Tell all pages how the run stands, not more often than they can show."""
        now = time.monotonic()
        live = self.live
        if now - self._told < NEWS and live is not None and live.state == "running":
            return
        self._told = now
        self.broadcast(self.run_told())


@dataclass(eq=False, slots=True)
class _Job:
    """What a page asked for, which is computed aside; is_dropped: nobody waits for it any more."""

    client: Client
    message: Mapping[str, Any]
    seen: Session
    is_dropped: bool = False


def _failed(error: Exception) -> dict[str, object]:
    return {"is": "error", "faults": [told_fault(own_fault(error), set())]}


def _plain(failing: dict[str, Any] | None) -> dict[str, Any] | None:
    """Where a run failed, numbers that are not finite as texts."""
    if failing is None:
        return None
    return {**failing, "rows": [[x if math.isfinite(x) else str(x) for x in row] for row in failing["rows"]]}


# --- messages --------------------------------------------------------------------------------------------------------


@handles
def draw(session: Session, page: Page | None, *, level: str = "") -> Answer:
    svg = session.document.drawing(level)
    if page is not None:
        page.level = level
    return {"is": "drawing", "level": level, "revision": session.document.revision, "svg": svg}


@handles
def cancel(session: Session, page: Page | None, *, of: int) -> Answer:
    """End the analysis that this page asked for by its message of a number. Without one nothing happens."""
    session.cancel(page, of)
    return {"is": "done"}


@handles
def run(session: Session, *, stop: str | float | None = None, pace: float | None = None) -> Answer:
    check_pace(pace)  # a run that stands stays where the question is refused
    session.begin(stop).go(pace)
    return session.run_told()


@handles
def pause(session: Session) -> Answer:
    session.running.pause()
    return session.run_told()


@handles
def resume(session: Session, *, pace: float | None = None) -> Answer:
    session.running.go(pace)
    return session.run_told()


@handles
def step(session: Session, *, stop: str | float | None = None) -> Answer:
    (session.live or session.begin(stop)).step()
    return session.run_told()


@handles
def stop(session: Session) -> Answer:
    session.running.stop()
    return session.run_told()
