"""The rows of a run that go to a file while it goes on, and the run that goes on from such a file.

`FILE.parquet.part` begins when a run has recorded much or for long, so that short runs never have one. Each chunk of
rows in it is followed by the state of the run; a run that is resumed from it cuts off what stands behind the last one,
and records as if it had never stopped.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..compile.coupling import Coupling
from ..engines.driver import Simulation
from ..engines.run.saved_state import State, packed
from ..fmi.patience import patient
from ..results.arrow import Part, Stored, target_of
from ..results.files import check_format
from ..results.provenance import Origin
from ..results.results import Results
from ..text.errors import Fault, UsageError

CHUNK = 2**24
"""Bytes of rows that are written together."""
SECONDS = 60.0
"""After so long fewer are written, so that no more is lost when the process is killed."""


class Streaming:
    """Where the rows of a run go: to `out`, and, where that is Parquet, to its part while the run goes on.

    part: the one that is gone on from. Raises UsageError: E501 for another ending, E504 for a missing package.
    """

    def __init__(self, out: str | Path, part: Part | None = None) -> None:
        self.out, self.part = Path(out), part
        self.is_streamed = check_format(out) == ".parquet"
        self.written = time.monotonic()

    def begin(
        self,
        simulation: Simulation,
        settings: Mapping[str, object],
        results: Callable[[], Results],
        state: Callable[[], State],
    ) -> None:
        """Look at a run after each of its moments. settings: as given. state: from which it goes on."""
        given = {key: value for key, value in settings.items() if key not in ("start", "seed") and value is not None}

        def flush() -> None:
            recorded = simulation.recorded_bytes
            is_late = time.monotonic() - self.written > SECONDS
            if recorded < CHUNK and not (is_late and recorded > 0.0):
                return
            with patient() as look_up:  # rows that were taken are written
                # The state first: an instant that is outstanding happens then, and its rows belong to what is taken.
                kept = None if isinstance(simulation.engine.plan, Coupling) else packed(state())
                if self.part is None:
                    table = results()._table()
                    self.part = Part.begun(self.out, table, {"settings": json.dumps(given, default=float)})
                rows = simulation.engine.taken()
                if len(rows):
                    self.part.add(rows, kept)
                self.written = time.monotonic()
            look_up()

        if self.is_streamed:
            simulation.flush = flush
            if self.part is None:
                Part.check_free(self.out)

    def joined(self, results: Results) -> Results:
        """Return all results of a run, given the results with the rows after the part."""
        if self.part is None:
            return results
        stored = Stored(self.part, np.column_stack([results.t, results.values]))
        return results.changed(t=stored.times, values=stored)

    def keep(self, results: Results) -> None:
        """Write the results to `out`. The part goes, unless the run was interrupted and can go on from it."""
        results.save(self.out)
        if self.part is None:
            return
        if results.stored is not None:
            results.stored.moved(self.out)
        if results.interrupted and self.part.state is not None:
            self.part.close()
        else:
            self.part.drop()
            self.part = None

    def check(self, results: Results) -> Origin:
        """Return the origin in the part. Raises UsageError (E506) with all differences of the run."""
        assert self.part is not None
        was, ours = self.part.metadata, results._table().described()
        known = {
            "diagram": "diagram", "engine": "engine", "sha256": "file of the diagram", "equations": "equations",
            "values": "values of parameters", "units": "recorded signals",
        }  # fmt: skip
        different = [what for key, what in known.items() if was.get(key) != ours.get(key)]
        theirs, settings = was.get("settings", {}), ours.get("settings", {})
        for key in sorted({*settings, *theirs} - {"interpolation"}):  # the inputs are in the state
            if settings.get(key) != theirs.get(key):
                different.append(f"{key} ({theirs.get(key)}, and now {settings.get(key)})")
        releases = [known.get("versions", {}).get("blocks") for known in (was, ours)]
        if releases[0] != releases[1]:
            different.append(f"release of blocks ({releases[0]}, and now {releases[1]})")
        if different:
            cure = "Resume the run with the same settings and files, or start it from the beginning."
            place = str(self.part.path)
            told = [f"was written by a run that differs in its {what}." for what in different]
            raise UsageError(*(Fault("E506", place, message, cure) for message in told))
        return Origin(**{key: was[key] for key in Origin.kinds() if key in was})


def part_to_resume(
    resume: Any, out: str | Path | None, given: Mapping[str, object], settings: Mapping[str, Any]
) -> tuple[Part, Path, dict[str, object]] | None:
    """Return the part from which a run continues, the file that it writes, and its settings; None for other states.

    given: parameters and inputs that were given, by what they are. Raises UsageError: E501, E506.
    """
    target = target_of(resume)
    if target is None:
        return None
    place = str(resume)
    if out is not None and Path(out).absolute() != Path(target).absolute():
        raise UsageError(Fault("E501", str(out), f"cannot be the output of a run that continues {place}: it "
        f"writes {target}.", "Leave out= out."))
    for what, items in given.items():
        if items:
            message = f"stores the {what} of its run, so that they cannot be given again."
            raise UsageError(Fault("E506", place, message, f"Leave the {what} out, or start the run from the "
            "beginning."))
    part = Part.found(resume)
    try:
        recorded = dict(json.loads(part.schema.metadata.get(b"settings", b"{}")))
    except (ValueError, TypeError):
        part.close()
        raise UsageError(Fault("E506", place, "does not contain the settings of its run.", "Start the run from "
        "the beginning.")) from None
    return part, Path(target), {**recorded, **{key: value for key, value in settings.items() if value is not None}}

