"""Optimisers that need no derivatives, over the unit cube, whole generations at a time.

`evaluate` takes candidates (n, k), and gives their fitness (n,): smaller is better, inf is no number at all. It raises
`Spent` once the budget is.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from ..results.table import optional
from ..text.arrays import Array
from ..text.errors import BlocksError

Evaluate = Callable[[Array], Array]
SPREAD = 0.2
"""The deviation of the first generation of CMA-ES, in parts of the range of each variable."""
GENERATIONS = 20
"""How many generations of differential evolution a budget is meant for."""


class Spent(Exception):
    """The budget is used up."""


def check_installed(method: str, place: str) -> Any:
    """Return the package of a method, or None if it needs none. Raises UsageError (E504) if it is not installed."""
    otherwise = 'Or choose the optimizer "de", which needs no further package.'
    return optional("cma", place, "tune", otherwise=otherwise) if method == "cma" else None


def cma(evaluate: Evaluate, start: Array, seed: int, budget: int) -> None:
    """CMA-ES (package cma); where it has converged, it begins again at the start with twice the population.

    Raises UsageError (E504) where the package is not installed.

    References:
        N. Hansen, A. Auger, "A restart CMA evolution strategy with increasing population size", CEC 2005.
    """
    package = check_installed("cma", 'method="cma"')
    draw, count = np.random.default_rng(seed), len(start)
    size = 4 + int(3 * np.log(count))
    # The package knows no problem of one variable: a second one means nothing.
    start = np.clip(start if count > 1 else np.append(start, 0.5), 0.02, 0.98)
    while True:
        options = {
            "bounds": [0.0, 1.0], "popsize": size, "verbose": -9, "seed": np.nan,
            "randn": lambda *shape: draw.standard_normal(shape),
        }  # fmt: skip
        with warnings.catch_warnings():  # of its own state, which says nothing to a user
            warnings.simplefilter("ignore")
            strategy = package.CMAEvolutionStrategy(start, SPREAD, options)
            while not strategy.stop():
                candidates = strategy.ask()
                fitness = evaluate(np.clip(candidates, 0.0, 1.0)[:, :count])
                known = fitness[np.isfinite(fitness)]
                worst = known.max() if len(known) else 0.0
                # It computes with fitnesses, though only their order counts.
                strategy.tell(candidates, np.where(np.isfinite(fitness), fitness, worst + 1.0 + abs(worst)).tolist())
        size *= 2


def differential_evolution(evaluate: Evaluate, start: Array, seed: int, budget: int) -> None:
    """Differential evolution (SciPy), whose first generation is a Latin hypercube that holds the start."""
    from scipy import optimize

    count, draw = len(start), np.random.default_rng(seed)
    members = max(5, min(10 * count, budget // GENERATIONS))
    while True:
        strata = np.array([draw.permutation(members) for _ in range(count)]).T
        first = (strata + draw.random((members, count))) / members
        first[0] = start
        try:
            optimize.differential_evolution(
                lambda x: evaluate(np.atleast_2d(x.T)), [(0.0, 1.0)] * count, init=first, maxiter=budget, polish=False,
                vectorized=True, updating="deferred", seed=draw, tol=1e-9,
            )  # fmt: skip
        except RuntimeError as error:  # SciPy hides errors of its function, where they are ValueErrors
            if isinstance(error.__cause__, BlocksError):
                raise error.__cause__ from None
            raise


METHODS = {"cma": cma, "de": differential_evolution}
