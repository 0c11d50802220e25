"""How the steps of one run are made and controlled: what its settings and its units come to, for Python and C alike."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from .coupling import Coupling

_ALWAYS = 2**62


@dataclass(frozen=True, slots=True)
class Policy:
    """order: of the polynomials that inputs follow. is_sequential: whether a unit takes what others came to in the
    same step. iterated_steps: so many after a jump are iterated, each up to `iterations` times, until no more changes
    than `noise`, which the solvers of units do not resolve.

    is_controlled: whether errors are held to `tolerance` times (ratio + |value|); is_doubled: by comparison with two
    half steps, else with what was predicted. span: the length of the run in s, 1 where it has no end. first_step: in
    s, also after a jump; least_step: more than some shorter ones in a row are an error.
    """

    order: int
    iterations: int
    is_sequential: bool
    is_controlled: bool
    is_doubled: bool
    iterated_steps: int
    noise: float
    tolerance: float
    ratio: float
    span: float
    first_step: float
    least_step: float

    @classmethod
    def of(cls, coupling: Coupling, can_save: Sequence[bool]) -> Policy:
        """can_save: of each unit, whether it can go back."""
        settings, master = coupling.settings, coupling.settings.master
        own = (coupling.tolerance_of(unit) for unit in coupling.units if unit.foreign is not None)
        tolerance, is_doubled = master.tolerance or 0.0, master.tolerance is not None and all(can_save)
        span = 1.0 if settings.stop is None else float(settings.stop) - float(settings.start)
        shortest = float(coupling.shortest)
        return cls(
            order=master.order,
            iterations=master.iterations,
            is_sequential=master.algorithm != "jacobi",
            is_controlled=master.tolerance is not None,
            is_doubled=is_doubled,
            iterated_steps=_ALWAYS if master.algorithm == "iterated" else 2 if master.order == 2 else 0,
            noise=10 * max(settings.rtol, *(value or 0.0 for value in own), 0.0),
            tolerance=tolerance,
            ratio=settings.atol / settings.rtol,
            span=span,
            # A short one where its error cannot be estimated.
            first_step=shortest if is_doubled else shortest * math.sqrt(tolerance or 1.0) / 10,
            least_step=min(1e-12 * span, 1e-6 * shortest),
        )
