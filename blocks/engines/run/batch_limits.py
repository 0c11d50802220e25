"""What bounds many runs: how many run at once, and how many steps each may take."""

from __future__ import annotations

import os

from ...text.errors import Fault

__all__ = ["cores", "over_budget"]


def cores() -> int:
    """How many threads or processes can run at once."""
    known = getattr(os, "sched_getaffinity", None)
    return len(known(0)) if known is not None else os.cpu_count() or 1


def over_budget(place: str, budget: int | None, t: float) -> Fault:
    """Why a run was cut short at t."""
    cure = "Give it more steps, or look at its values: such a run may be stiff, or chatter."
    return Fault("E313", place, f"takes more than {budget} steps, of which the last ended at t = {t:.10g} s.", cure)
