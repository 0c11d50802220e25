"""Rows of sweeps on other machines, by dask.distributed: the only door to it.

What goes out once is a Job: the diagram as one text, with the diagrams and columns of other files in it, and the names
of its block types. Then go chunks of rows, each of some seconds of work: values and run seeds. What comes back are
`BatchRows`, in any order. Each worker makes a Batch of the job, compiled once for its kind of machine, which the cache
knows by its hash. A row's numbers follow from its values and its seed alone, so that no chunks, workers or losses of
workers change a bit.

A worker that is lost is replaced by dask, which runs its chunks again. Of a chunk whose workers died again and again,
each row is run in a process of its own, and one that ends it is "failed".
"""

from __future__ import annotations

import hashlib
import importlib
import math
import os
import pickle
import socket
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..api.batch import Batch, BatchRows
from ..api.case import Case, Work
from ..api.diagram import Diagram
from ..model.block_types import library_types
from ..model.diagram_value import DiagramValue
from ..model.document import dumps, self_contained
from ..model.variants import taken
from ..results.table import optional
from ..text.arrays import Array
from ..text.errors import Fault, FMUError, UsageError
from ..text.printable import legible, one_line
from .sweep import Sweep
from .sweep_file import read_rows, write
from .sweep_margins import Margin, RowMargins

if TYPE_CHECKING:
    from ..contract.block import Block

SECONDS = 1.0, 5.0
"""The work of a chunk. An empty task costs some 10 ms, and what a lost worker had begun is run again."""
GROWTH = 8
"""By how much chunks may grow from what is known of the rows so far."""
SHARE = 4
"""How many chunks a thread gets of what is left, so that all end together."""
FILE = "rows-{}.parquet"
"""What a chunk is called in a folder."""
MOST_BATCHES = 8
"""How many a thread of a worker keeps ready."""
_made = threading.local()  # in a worker: a run is of one thread


# --- what goes out ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Put:
    """Where workers write rows with their signals: a file for each chunk.

    folder: a folder or a URL that all workers can write. fields: those of a Sweep that are the same for all rows; told:
    what it is of, for the metadata.
    """

    folder: str
    fields: Mapping[str, object]
    told: Mapping[str, object]

    def found(self, *, restart: bool) -> Iterator[Sweep]:
        """The rows of files that are there, without signals; where it begins anew, the files are removed.

        Raises UsageError (E506) where they are of another sweep.
        """
        system, root = self.opened()
        for path in sorted(system.glob(f"{root}/{FILE.format('*')}")):
            if restart:
                system.rm(path)
                continue
            with system.open(path, "rb") as stream:
                yield Sweep(**read_rows(stream, path, self.told))

    def write(self, fields: Mapping[str, Any]) -> None:
        """Write a chunk. One that runs again, since its worker was lost, replaces its file by the same rows."""
        numbers = fields["number"]
        name = FILE.format(f"{int(fields['scenario'][0])}-{int(numbers[0]):09d}-{int(numbers[-1]):09d}")
        system, root = self.opened()
        with tempfile.TemporaryDirectory() as place:
            is_local = "file" in system.protocol
            path = Path(root if is_local else place) / name
            write(path, {**self.fields, **fields}, self.told)
            if not is_local:
                system.put_file(str(path), f"{root}/{name}")

    def opened(self) -> tuple[Any, str]:
        """The file system and the folder in it, which is there from then on. Raises UsageError (E501)."""
        from fsspec.core import url_to_fs

        try:
            system, root = url_to_fs(self.folder)
            system.makedirs(root, exist_ok=True)
        except (OSError, ValueError, ImportError) as error:
            raise UsageError(Fault("E501", legible(self.folder), f"{one_line(str(error))}.")) from None
        return system, root


@dataclass(frozen=True)
class Job:
    """All that a worker needs to know of a sweep but its rows.

    text: of the diagram. folder: where the paths of FMUs begin. library: module and name of each block type that does
    not ship. fmus: the SHA-256 of each FMU by its path. names: of the columns. scenarios: the parameters of each.
    case: the rest of what all rows are run with. key: by which a worker knows the job again. computed: of
    the release, the equations and the values of the first scenario, by which it is known that a worker computes the
    same.
    """

    text: str
    folder: str
    library: tuple[tuple[str, str], ...]
    fmus: Mapping[str, str]
    names: tuple[str, ...]
    scenarios: tuple[Mapping[str, Any], ...]
    case: Case
    margins: tuple[Margin, ...]
    key: str
    put: Put | None = None
    computed: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        diagram: Diagram,
        names: Sequence[str],
        scenarios: Sequence[Mapping[str, object]],
        case: Case,
        margins: tuple[Margin, ...] = (),
        *,
        put: Put | None = None,
    ) -> Job:
        """The job of a sweep. Raises ModelError, UsageError (E501) for block types that no worker could import."""
        value = self_contained(taken(diagram.value, case.variants))
        used: dict[str, type[Block]] = {}
        fmus: dict[str, str] = {}
        for inside in _all(value):
            for entry in inside.blocks.values():
                if entry.fmu:
                    path = os.path.abspath(os.path.join(inside.folder, entry.fmu))
                    fmus[path] = _sha256(path)
                elif entry.type:
                    used[entry.type] = entry.cls or diagram.types[entry.type]
        known = library_types()
        own = [block for name, block in used.items() if known.get(name) is not block]
        for block in own:
            if block.__module__ == "__main__" or "." in block.__qualname__:
                message = f"is defined in {block.__module__}, from which workers cannot import it."
                cure = (
                    "Define it at the top level of a module, and send the module to the workers: "
                    "client.upload_file(...)."
                )
                raise UsageError(Fault("E501", block.__qualname__, message, cure))
        library = tuple(sorted((block.__module__, block.__name__) for block in own))
        case = case.without("variants", "parameters").updated(trust=[*fmus])
        job = cls(
            dumps(value), value.folder, library, fmus, tuple(names), tuple(scenarios), case, margins, uuid.uuid4().hex,
            put,
        )  # fmt: skip
        return replace(job, computed=job.digests(job.diagram()))

    def diagram(self) -> Diagram:
        """The diagram, here. Raises UsageError (E501) where block types are missing, FMUError (E202) where FMUs are."""
        types, here = [], f"the worker {socket.gethostname()}:{os.getpid()}"
        for module, name in self.library:
            try:
                types.append(getattr(importlib.import_module(module), name))
            except Exception as error:  # a module may raise anything
                message = f"{here} cannot import it: {type(error).__name__}: {one_line(str(error)).rstrip('.')}."
                raise UsageError(
                    Fault(
                        "E501", f"{module}.{name}", message, "Send the module to the workers: client.upload_file(...)."
                    )
                ) from None
        for path, digest in self.fmus.items():
            if not os.path.exists(path) or _sha256(path) != digest:
                what = "a different FMU" if os.path.exists(path) else "missing"
                cure = "Put the FMU at the same path on all machines."
                raise FMUError(Fault("E202", legible(path), f"is {what} on {here}.", cure))
        diagram = Diagram.from_json(self.text, folder=self.folder, library=types)
        if self.computed and self.digests(diagram) != self.computed:
            message = f"{here} has another release of blocks, or other equations or values."
            raise UsageError(Fault("E501", diagram.name, message, "Install the same packages on the worker as here."))
        return diagram

    def digests(self, diagram: Diagram) -> tuple[str, ...]:
        """What `computed` is here."""
        begun = diagram.start(self.case.without("measures"), parameters=self.scenarios[0])
        origin = begun.results.origin
        begun.leave()
        return () if origin is None else (origin.versions["blocks"], origin.equations, origin.values)

    def made(self, scenario: int) -> tuple[Batch, RowMargins | None]:
        """What runs rows of a scenario, made once by each thread of a worker. Raises as `diagram`, `Diagram.batch`."""
        known: dict[Any, tuple[Batch, RowMargins | None]] = _made.__dict__.setdefault("known", {})
        key = (self.key, scenario)
        if key not in known:
            while len(known) >= MOST_BATCHES:
                del known[next(iter(known))]
            diagram = self.diagram()
            case = self.case.updated(parameters=self.scenarios[scenario])
            margins = RowMargins(diagram, self.margins, case) if self.margins else None
            known[key] = diagram.batch(list(self.names), case), margins
        return known[key]

    def failed(self, status: int) -> BatchRows:
        """A row whose process ended with a status."""
        message = (
            f"E216 row: its process ended with status {status}. An FMU may have crashed, or the memory did not suffice."
        )
        names = (*(self.case.measures or ()), *(margin.name for margin in self.margins))
        measures = {name: np.full(1, np.nan) for name in names}
        return BatchRows(np.array(["failed"]), (message,), measures, np.empty(0), {}, np.zeros(1, np.int64))


def _all(value: DiagramValue) -> Iterator[DiagramValue]:
    yield value
    for entry in value.blocks.values():
        if isinstance(entry.diagram, DiagramValue):
            yield from _all(entry.diagram)


def _sha256(path: str) -> str:
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


# --- on a worker -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Chunk:
    """Rows of a scenario, by their numbers, with their values (m, columns) and seeds, and the budget of each."""

    scenario: int
    numbers: Array
    table: Array
    seeds: Array
    budget: int | None

    def row(self, k: int) -> Chunk:
        numbers, table, seeds = (array[k : k + 1] for array in (self.numbers, self.table, self.seeds))
        return replace(self, numbers=numbers, table=table, seeds=seeds)


def _same(job: Job) -> Job:
    return job


def _run(job: Job, chunk: Chunk) -> tuple[BatchRows, float]:
    """What became of rows, and how many seconds they took once all was compiled."""
    batch, margins = job.made(chunk.scenario)
    begun = time.perf_counter()
    rows = batch(chunk.table, seeds=chunk.seeds, threads=1, max_steps=chunk.budget)
    rows = rows if margins is None else margins.beside(rows, batch, chunk.table, chunk.seeds)
    seconds = time.perf_counter() - begun
    if rows.interrupted:
        raise OSError("a worker was interrupted")
    if job.put is not None:
        job.put.write({
            "varied": dict(zip(job.names, chunk.table.T, strict=True)), "number": chunk.numbers, "seeds": chunk.seeds,
            "scenario": np.full(len(rows), chunk.scenario), "status": rows.status, "messages": rows.messages,
            "steps": rows.steps, "measures": rows.measures, "t": rows.t, "signals": rows.signals,
        })  # fmt: skip
        rows = replace(rows, t=np.empty(0), signals={})
    return rows, seconds


def _run_apart(job: Job, chunk: Chunk) -> list[BatchRows]:
    """Each row in a process of its own, which may die."""
    made = []
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    for k in range(len(chunk.numbers)):
        with tempfile.TemporaryDirectory() as place:
            path = Path(place) / "row"
            path.write_bytes(pickle.dumps((job, chunk.row(k))))
            command = f"from {__name__} import serve; serve({str(path)!r})"
            status = subprocess.run([sys.executable, "-c", command], env=environment, check=False).returncode
            made.append(job.failed(status) if status else pickle.loads(path.read_bytes())[0])
    return made


def serve(path: str) -> None:
    """Run the row of a file, and write what became of it in its place."""
    place = Path(path)
    place.write_bytes(pickle.dumps(_run(*pickle.loads(place.read_bytes()))))


# --- at home ---------------------------------------------------------------------------------------------------


LOCAL = Work()


def run_on(
    on: Any,
    job: Job,
    table: Array,
    seeds: Array,
    made: Any,
    budget: int | None = None,
    work: Work = LOCAL,
    *,
    size: int | None = None,
) -> bool:
    """Run the rows that are "left" on the workers of a client; False where Ctrl-C ended it.

    on: a `distributed.Client`, or the address of a scheduler. table, seeds: (n, columns) and (n,) of the rows, alike in
    all scenarios. made: takes rows that are done (`sweep_run`). budget: the most steps of a row. work: its progress and
    whether it starts over, so that what is in the folder of `job.put` goes. size:
    of chunks in rows; None: SECONDS of work. Raises what a worker refuses, UsageError (E501, E504, E506).
    """
    distributed = optional("distributed", "on", "dask")
    client = on
    if isinstance(on, str):
        try:
            client = distributed.Client(on, timeout=20)
        except (OSError, ValueError) as error:
            cure = "Start one: dask scheduler; then on each machine: dask worker ADDRESS."
            message = f"no dask scheduler answers: {one_line(str(error)).rstrip('.')}."
            raise UsageError(Fault("E501", legible(on), message, cure)) from None
    elif not isinstance(on, distributed.Client) or on.asynchronous:
        cure = "Give a synchronous distributed.Client, or the address of a scheduler."
        raise UsageError(Fault("E501", "on", f"{on!r} is not a client of dask.distributed.", cure))

    def submit(at: Array, task: Callable[..., Any]) -> object:
        scenario, numbers = int(at[0]) // made.n, at % made.n
        chunk = Chunk(scenario, numbers, table[numbers], seeds[numbers], budget)
        future = client.submit(task, held, chunk, pure=False)
        under_way[future] = at, task
        return future

    under_way: dict[Any, tuple[Array, Callable[..., object]]] = {}
    held: object = None
    try:
        for rows in job.put.found(restart=work.restart) if job.put is not None else ():
            made.take(rows.scenario * made.n + rows.number, rows)
        # A task of its own: it goes to each worker once, from another one that has it, and is made again when lost.
        held = client.submit(_same, job, pure=False)
        left, done = np.flatnonzero(made.status == "left"), distributed.as_completed()
        ready = len(made.status) - len(left)
        count, seconds, now, threads, asked = 0, 0.0, 1, 1, -math.inf
        while True:
            if work.progress is not None:
                work.progress(ready, len(made.status))
            if not len(left) and not under_way:
                return True
            if time.monotonic() - asked > 1.0:
                threads, asked = max(1, sum(client.nthreads().values())), time.monotonic()
            while len(left) and len(under_way) < 2 * threads:
                at = left[: size or now]
                at = at[at // made.n == at[0] // made.n]
                left = left[len(at) :]
                done.add(submit(at, _run))
            future = next(done)
            at, task = under_way.pop(future)
            try:
                ended = future.result()
            except distributed.KilledWorker:
                if task is _run:
                    done.add(submit(at, _run_apart))
                    continue
                ended = [job.failed(-9)] * len(at)  # not even processes of their own help
            except (distributed.CancelledError, OSError) as error:
                cure = "Start the sweep again: with out=, it continues with the rows that are left."
                message = f"dask gave up some rows: {one_line(str(error)).rstrip('.')}."
                raise UsageError(Fault("E501", "on", message, cure)) from None
            if isinstance(ended, tuple):
                made.keep(at, ended[0])
                count, seconds = count + len(at), seconds + ended[1]
                low, high = (bound * count / max(seconds, 1e-6) for bound in SECONDS)
                now = max(1, int(min(GROWTH * now, high, max(low, len(left) / (SHARE * threads)))))
            else:
                for k, rows in enumerate(ended):
                    made.keep(at[k : k + 1], rows)
            ready += len(at)
    except KeyboardInterrupt:
        return False
    finally:
        client.cancel([*under_way])
        if client is not on:
            client.close()
