"""Rows of a batch in processes of their own: for FMUs, programs in Python and engines that hold Python's lock.

Each process takes row after row, also of later calls. One that dies takes its row with it, and another one goes on.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import queue
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from multiprocessing.connection import Connection
from typing import Any, Protocol

from ..engines.run.many_runs import Row
from ..text.errors import Fault

__all__ = ["Rows", "Worker", "in_processes"]


class Rows(Protocol):
    """What runs one row by itself: a Batch."""

    def alone(self, given: Mapping[str, Any], seed: int | None, budget: int | None) -> Row: ...


Task = tuple[int, dict[str, Any], int | None]
"""The number of a row, its raw values and its seed."""


def in_processes(
    batch: Rows, rows: Sequence[Task], budget: int | None, count: int, workers: list[Worker]
) -> Iterator[tuple[int, Row | None]]:
    """What becomes of each row, as it is known; None where Ctrl-C ends it.

    workers: those of the batch that wait for rows, and will do so again afterwards.

    What cannot be pickled runs here, row after row; so do all rows in a process that may have none of its own, as a
    worker of dask, and where processes cannot begin: block types that were defined in a notebook are not known there,
    and a script that does not ask for __name__ == "__main__" would run in each of them.
    """
    count = max(1, min(count, len(rows)))
    try:
        text = b"" if multiprocessing.current_process().daemon else pickle.dumps(batch)
    except Exception:  # pickle raises what the types raise
        text = b""
    if not text:
        yield from _here(batch, rows, budget)
        return
    mine = [workers.pop() if workers else Worker(text) for _ in range(count)]  # other threads may run other rows
    tasks: queue.SimpleQueue[Task] = queue.SimpleQueue()
    for row in rows:
        tasks.put(row)
    done: queue.SimpleQueue[tuple[int, Row] | None] = queue.SimpleQueue()
    left = {row[0]: row for row in rows}
    for worker in mine:
        threading.Thread(target=_work, args=(worker, tasks, done, budget), daemon=True).start()
    try:
        working = count
        while working:
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
        if left:  # they are not waited for
            for worker in mine:
                worker.end()
        else:
            workers += mine
    yield from _here(batch, [*left.values()], budget)


def _here(batch: Rows, rows: Sequence[Task], budget: int | None) -> Iterator[tuple[int, Row | None]]:
    for i, given, seed in rows:
        try:
            yield i, batch.alone(given, seed, budget)
        except KeyboardInterrupt:
            yield -1, None
            return


class Worker:
    """A process that runs one row after the other; another one takes its place where it dies."""

    def __init__(self, text: bytes) -> None:
        """text: the batch."""
        self.text = text
        self.process: Any = None
        self.connection: Connection | None = None
        self.is_ended = False

    def run(self, task: Task, budget: int | None) -> Row | None:
        """What becomes of a row; None where no process can begin."""
        connection = self.connection or self._begun()
        if connection is None:
            return None
        try:
            connection.send((*task[1:], budget))
            ended: Row = connection.recv()
        except (EOFError, OSError):
            self.connection = None
            return self._death()
        return ended

    def _begun(self) -> Connection | None:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, self.text), daemon=True)
        self.process.start()
        theirs.close()
        try:
            ours.recv()
        except (EOFError, OSError):
            return None
        self.connection = ours
        return ours

    def _death(self) -> Row:
        self.process.join(5.0)
        message = f"the process of this row ended, with exit code {self.process.exitcode}."
        return Row(0, {}, Fault("E216", "row", message, "An FMU may have crashed: run the row by itself."), "failed")

    def end(self) -> None:
        self.is_ended = True
        if self.process is not None and self.process.is_alive():
            self.process.terminate()


def _work(worker: Worker, tasks: queue.SimpleQueue[Task], done: queue.SimpleQueue[Any], budget: int | None) -> None:
    """Give rows to a worker until there are none left."""
    try:
        while not worker.is_ended:
            task = tasks.get_nowait()
            ended = worker.run(task, budget)
            if ended is None:
                return
            done.put((task[0], ended))
    except queue.Empty:
        pass
    finally:
        done.put(None)


def _serve(connection: Connection, text: bytes) -> None:
    """A process of its own: run rows as they come."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one who gives rows hears it
    batch = pickle.loads(text)
    with contextlib.suppress(EOFError, OSError):
        connection.send("ready")
        while True:
            given, seed, budget = connection.recv()
            connection.send(batch.alone(given, seed, budget))
