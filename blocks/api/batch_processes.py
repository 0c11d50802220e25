"""Rows of a batch in processes of their own: for FMUs, programs in Python and engines that hold Python's lock.

Each process takes row after row, also of later calls. One that dies takes its row with it, and another one goes on.
They do not import the script of the user, which may have no `if __name__ == "__main__"`, unless it has one and defines
block types itself.
"""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from multiprocessing import spawn
from pathlib import Path
from typing import Any, Protocol

from ..engines.run.many_runs import Row
from ..text.errors import Fault

BEGIN = f"import sys; sys.path[:] = {{}}; from {__name__} import _serve; _serve()"


_BROKEN = (EOFError, OSError, ValueError, pickle.UnpicklingError)
"""Errors of a pipe whose other end is gone, or that Ctrl-C has closed meanwhile (ValueError)."""


class Rows(Protocol):
    """What runs one row by itself: a Batch."""

    def alone(self, given: Mapping[str, object], seed: int | None, budget: int | None) -> Row: ...


Task = tuple[int, dict[str, Any], int | None]
"""The number of a row, its raw values and its seed."""


def in_processes(
    batch: Rows, rows: Sequence[Task], budget: int | None, count: int, workers: list[Worker]
) -> Iterator[tuple[int, Row | None]]:
    """Yield the outcome of each row as soon as it is known, or None if Ctrl-C ends it.

    workers: those of the batch that wait for rows, and will do so again afterwards.

    What no process can take runs here, row after row: see `packed`.
    """
    count = max(1, min(count, len(rows)))
    text, _ = packed(batch)
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
                worker.is_ended = True
                worker.end()
        else:
            workers += mine
    yield from _here(batch, [*left.values()], budget)


def packed(batch: Rows) -> tuple[bytes, str]:
    """Return the bytes that start a process: its preparation and the batch; or b"" and why rows run in this process."""
    if getattr(multiprocessing.current_process(), "daemon", False) or getattr(sys, "frozen", False):
        return b"", "it may not start processes"  # as a worker of dask
    try:
        text = pickle.dumps(batch)
        prepared = spawn.get_preparation_data("blocks")
    except Exception as error:  # pickle raises what the types raise
        return b"", f"the diagram cannot be sent to other processes: {str(error)[:200]}"
    kept = {"sys_path": prepared["sys_path"], "sys_argv": prepared["sys_argv"]}
    if b"__main__" in text:
        script = str(getattr(sys.modules["__main__"], "__file__", None) or "")
        if not script.endswith(".py") or "__main__" not in Path(script).read_text("utf-8", "replace"):
            cure = "define them in a separate module and import it"
            return b"", f"other processes cannot load block types of __main__: {cure}"
        kept |= {key: value for key, value in prepared.items() if key.startswith("init_main")}
    return pickle.dumps(kept) + text, ""


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
        """text: as `packed`."""
        self.text = text
        self.process: subprocess.Popen[bytes] | None = None
        self.is_ended = False

    def run(self, task: Task, budget: int | None) -> Row | None:
        """Return the outcome of a row, or None if no process can start."""
        process = self.process or self._begun()
        if process is None:
            return None
        try:
            _send(process.stdin, (*task[1:], budget))
            ended: Row = pickle.load(process.stdout)  # type: ignore[arg-type]
        except _BROKEN:
            return self._death(process)
        return ended

    def _begun(self) -> subprocess.Popen[bytes] | None:
        command = [sys.executable, *_flags(), "-c", BEGIN.format(ascii([*map(str, sys.path)]))]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.process = process
        try:
            _send(process.stdin, self.text)
            pickle.load(process.stdout)  # type: ignore[arg-type]
        except _BROKEN:
            self.end()
            return None
        return process

    def _death(self, process: subprocess.Popen[bytes]) -> Row:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(5.0)
        message = f"the process of this row ended, with exit code {process.returncode}."
        self.end()
        fault = Fault("E216", "row", message, "An FMU may have crashed. Run the row alone.")
        return Row(0, {}, (fault,), "failed")

    def end(self) -> None:
        process, self.process = self.process, None
        if process is not None:
            process.kill()
            process.wait()
            for stream in (process.stdin, process.stdout):
                with contextlib.suppress(OSError, ValueError):
                    stream.close()  # type: ignore[union-attr]

    def __del__(self) -> None:
        self.end()


def _flags() -> list[str]:
    """Return the options of this Python, such as -X utf8."""
    return subprocess._args_from_interpreter_flags()  # type: ignore[attr-defined, no-any-return]


def _send(stream: Any, value: Any) -> None:
    pickle.dump(value, stream)
    stream.flush()


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


def _serve() -> None:
    """Run rows in a separate process as they arrive on stdin. The output of programs goes to stderr."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one who gives rows hears it
    given, ended = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    with contextlib.suppress(EOFError, OSError):
        text = io.BytesIO(pickle.load(given))
        try:
            spawn.prepare(pickle.load(text))
            batch = pickle.load(text)
        except Exception as error:  # the modules of the user raise what they raise
            sys.exit(f"blocks: a worker process cannot start, so the rows run in this process: {error}")
        _send(ended, "ready")
        while True:
            values, seed, budget = pickle.load(given)
            _send(ended, batch.alone(values, seed, budget))
