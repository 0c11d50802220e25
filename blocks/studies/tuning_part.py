"""The part of a tuning that is under way: its candidates, as the rows of a sweep of the objective and the excess.

The optimizer is deterministic: asked once more, it gives the same candidates as long as it gets the same fitness. So a
tuning goes on by asking it from the start, and taking from the part what has been run.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..model.raw_values import raw_of
from ..text.arrays import Array
from ..text.errors import Fault, UsageError
from ..text.printable import legible
from .sweep_file import SweepPart, told_of
from .tuned import Candidates

Problem = Any  # a `Problem`, whose module calls this one


class TuningPart:
    """The generations of candidates in a file; those of an earlier run come first. Raises as `SweepPart`."""

    def __init__(self, problem: Problem, out: str | Path, *, restart: bool) -> None:
        batch, first = problem.batch, next(iter(problem.before.values()))
        low, high = problem.space.low.tolist(), problem.space.high.tolist()
        self.problem, self.columns = problem, list(batch.columns)
        key = {
            "objective": problem.objective.text, "constraints": [(c.scenario, c.text) for c in problem.constraints],
            "bounds": [*zip(self.columns, low, high, strict=True)],
            "scenarios": raw_of({name: dict(given) for name, given in problem.scenarios.items()}),
            "optimizer": problem.optimizer, "budget": problem.budget, "search seed": problem.search_seed,
            "lanes": batch.lanes, "engine": first.statistics.engine,
        }  # fmt: skip
        self.part = SweepPart(out, told_of(first.origin, key), restart=restart)
        self.found = [self._candidates(piece) for piece in reversed(self.part.found)]
        self.seed = int(problem.batch.seed)
        self.count = 0

    def next(self, values: Array) -> Candidates | None:
        """Return the generation of these values (n, k), where it has been run. Raises UsageError (E506)."""
        if not self.found:
            return None
        candidates = self.found.pop()
        if not np.array_equal(candidates.values, values):
            message = "cannot be continued: it holds other candidates, for example of another release of the optimizer."
            cure = "Start over (restart=True, --restart)."
            raise UsageError(Fault("E506", legible(str(self.part.path)), message, cure))
        self.count += len(values)
        return candidates

    def add(self, candidates: Candidates) -> None:
        """Write a generation that has been run."""
        self.part.add(self._fields(candidates, self.count))
        self.count += len(candidates.objective)

    def end(self, history: Candidates, *, interrupted: bool) -> None:
        """Write the whole file; the part stays where the tuning can go on from it."""
        self.part.end({**self._fields(history, 0), "interrupted": interrupted})

    def close(self) -> None:
        self.part.close()

    def _candidates(self, piece: Mapping[str, Any]) -> Candidates:
        values = np.stack([piece["varied"][name] for name in self.columns], axis=1)
        measures = piece["measures"]
        messages = np.array(piece["messages"], dtype=object)
        return Candidates(values, measures["objective"], measures["excess"], piece["status"], piece["steps"], messages)

    def _fields(self, candidates: Candidates, first: int) -> dict[str, object]:
        """Return the fields of a `Sweep` of these candidates, which are numbered from `first` on."""
        n, batch = len(candidates.objective), self.problem.batch
        return {
            "name": self.problem.diagram.name,
            "varied": dict(zip(self.columns, candidates.values.T, strict=True)),
            "units": dict(zip(self.columns, batch.units, strict=True)),
            "scenarios": (), "scenario": np.zeros(n, dtype=np.int64), "number": np.arange(first, first + n),
            "seeds": np.full(n, self.seed, dtype=np.int64), "status": candidates.status,
            "messages": tuple(candidates.messages.tolist()), "steps": candidates.steps,
            "measures": {"objective": candidates.objective, "excess": candidates.excess},
            "t": np.empty(0), "signals": {}, "base": 0, "warnings": self.problem.warnings, "lanes": batch.lanes,
        }  # fmt: skip
