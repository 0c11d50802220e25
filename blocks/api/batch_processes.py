"""Rows of a batch in processes of their own: for FMUs, programs in Python and engines that hold Python's lock.

Each process takes row after row. One that dies takes its row with it, and another one goes on with the rest.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import queue
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any, Protocol

import numpy as np

from ..text.errors import BlocksError, Fault

__all__ = ["Alone", "Rows", "in_processes"]

Array = np.ndarray[Any, Any]

@dataclass(frozen=True, slots=True)
class Alone:
    """What became of a row that was run by itself."""

    steps: int
    measures: Mapping[str, float]
    fault: Fault | None
    status: str | None
    signals: Array = field(default_factory=lambda: np.empty((0, 0)))  # (rows, elements of all), as far as it came

    @classmethod
    def failed(cls, error: BlocksError, *, is_refused: bool) -> Alone:
        return cls(0, {}, error.faults[0], "refused" if is_refused else None)


class Rows(Protocol):
    """What runs one row by itself: a Batch."""

    def alone(self, given: Mapping[str, Any], seed: int | None, budget: int | None) -> Alone: ...


Task = tuple[int, dict[str, Any], int | None]
"""The number of a row, its raw values and its seed."""


def in_processes(
    batch: Rows, rows: Sequence[Task], budget: int | None, count: int
) -> Iterator[tuple[int, Alone | None]]:
    """What becomes of each row, as it is known; None where Ctrl-C ends it.

    What cannot be pickled runs here, row after row; so do all rows in a process that may have none of its own, as a
    worker of dask, and where processes cannot begin: block types that were defined in a notebook are not known there,
    and a script that does not ask for __name__ == "__main__" would run in each of them.
    """
    try:
        text = b"" if multiprocessing.current_process().daemon else pickle.dumps(batch)
    except Exception:  # pickle raises what the types raise
        text = b""
    if not text:
        yield from _here(batch, rows, budget)
        return
    tasks: queue.SimpleQueue[Task] = queue.SimpleQueue()
    for row in rows:
        tasks.put(row)
    done: queue.SimpleQueue[tuple[int, Alone] | None] = queue.SimpleQueue()
    left = {row[0]: row for row in rows}
    workers = [_Worker(text, budget, tasks, done) for _ in range(max(1, min(count, len(rows))))]
    try:
        working = len(workers)
        while left and working:
            try:
                ended = done.get(timeout=0.1)
            except queue.Empty:
                continue
            if ended is None:
                working -= 1
            else:
                del left[ended[0]]
                yield ended
    except KeyboardInterrupt:
        yield -1, None
        return
    finally:
        for worker in workers:
            worker.end()
    yield from _here(batch, [*left.values()], budget)


def _here(batch: Rows, rows: Sequence[Task], budget: int | None) -> Iterator[tuple[int, Alone | None]]:
    for i, given, seed in rows:
        try:
            yield i, batch.alone(given, seed, budget)
        except KeyboardInterrupt:
            yield -1, None
            return


class _Worker:
    """A process, and the thread that gives it rows."""

    def __init__(
        self, text: bytes, budget: int | None, tasks: queue.SimpleQueue[Task], done: queue.SimpleQueue[Any]
    ) -> None:
        self.text, self.budget, self.tasks, self.done = text, budget, tasks, done
        self.process: Any = None
        self.is_ended = False
        threading.Thread(target=self._work, daemon=True).start()

    def _work(self) -> None:
        try:
            self._take_rows()
        finally:
            self.done.put(None)

    def _take_rows(self) -> None:
        connection: Connection | None = None
        while not self.is_ended:
            try:
                task = self.tasks.get_nowait()
            except queue.Empty:
                break
            if connection is None:
                connection = self._begun()
            if connection is None:
                return
            try:
                connection.send((*task[1:], self.budget))
                self.done.put((task[0], connection.recv()))
            except (EOFError, OSError):
                connection = None
                self.done.put((task[0], self._death()))
        if connection is not None:
            connection.close()

    def _begun(self) -> Connection | None:
        """A process that waits for rows; None where it cannot begin."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, self.text), daemon=True)
        self.process.start()
        theirs.close()
        try:
            ours.recv()
        except (EOFError, OSError):
            return None
        return ours

    def _death(self) -> Alone:
        self.process.join(5.0)
        message = f"the process of this row ended, with exit code {self.process.exitcode}."
        return Alone(0, {}, Fault("E216", "row", message, "An FMU may have crashed: run the row by itself."), "failed")

    def end(self) -> None:
        self.is_ended = True
        if self.process is not None and self.process.is_alive():
            self.process.terminate()


def _serve(connection: Connection, text: bytes) -> None:
    """A process of its own: run rows as they come."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one who gives rows hears it
    batch = pickle.loads(text)
    with contextlib.suppress(EOFError, OSError):
        connection.send("ready")
        while True:
            given, seed, budget = connection.recv()
            connection.send(batch.alone(given, seed, budget))
