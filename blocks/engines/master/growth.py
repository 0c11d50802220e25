"""Whether a coupling grows without bound, which no unit can detect by itself.

Over a step a unit uses a guess of its inputs. In a circle of units a wrong guess comes back as a value that is more
wrong and, where the step is too long for the circle, by more each time. A signal that grows by itself is guessed well
as long as steps are short compared with its growth. So an element of a circle is watched for points at which it becomes
larger than ever and its guess missed by more than half of its largest size before: MISSES such points, no more than
NEAR_MISSES points apart, in which it grows by GROWTH. The largest step of this growth does not count, as it may be a
jump that was not reported. Bounded signals do not grow further, however wrong the guesses are.
"""

from __future__ import annotations

from collections.abc import Iterator

from ...compile.coupling import Coupling
from ...compile.master_limits import GROWTH, MISSES, NEAR_MISSES
from ...compile.scheduler import components
from ...text.errors import Fault


def circles(coupling: Coupling, can_save: list[bool]) -> Iterator[tuple[int, list[int]]]:
    """Elements that are guessed in a circle of units, with the number of the circle. can_save: of each unit.

    Where steps are iterated, only circles with units that cannot go back are guessed; where the error of steps is
    controlled, the error of a guess is known.
    """
    master, units = coupling.settings.master, coupling.units
    feeding: dict[int, list[int]] = {k: [] for k in range(len(units))}
    for k, unit in enumerate(units):
        feeding[k] = sorted({coupling.elements[place].unit for row, place in unit.links if row == "y"})
    number = 0
    for group in components(feeding):
        is_known = master.tolerance is not None or (master.algorithm == "iterated" and all(can_save[k] for k in group))
        if is_known or (len(group) == 1 and group[0] not in feeding[group[0]]):
            continue
        taken = {
            place
            for k in group
            for (row, place), moves in zip(units[k].links, units[k].continuous, strict=True)
            if row == "y" and moves
        }
        elements = [g for g in sorted(taken) if coupling.elements[g].unit in group and not coupling.elements[g].held]
        if elements:
            yield number, elements
            number += 1


def warning(coupling: Coupling, can_save: list[bool], element: int, t: float) -> Fault:
    """The warning about an element that has grown without bound at t."""
    master, elements = coupling.settings.master, coupling.elements
    chain = _around(coupling, element)
    names = " -> ".join(elements[g].name for g in chain)
    cures = []
    if master.algorithm != "iterated" and all(can_save[elements[g].unit] for g in chain):
        cures.append('the algorithm "iterated" (--master algorithm=iterated)')
    if master.order > 0:
        cures.append("order 0 (--master order=0)")
    cures.append("a shorter communication step (--master step=H)")
    told = ", ".join(cures[:-1]) + (", or " if len(cures) > 1 else "") + cures[-1]
    message = (
        f"the coupling grows without bound in the circle {names}: by t = {t:.6g} s this signal became more than a "
        "million times larger, and each prediction of it was wrong by more than half of its size before."
    )
    return Fault("W305", elements[element].name, message, f"Use {told}.")


def _around(coupling: Coupling, element: int) -> list[int]:
    """The shortest path from an element through units back to it."""
    begun: dict[int, int | None] = {element: None}
    waiting = [element]
    for g in waiting:
        for k in coupling.readers[g]:
            if k == coupling.elements[element].unit:
                chain = [element]
                at: int | None = g
                while at is not None:
                    chain.append(at)
                    at = begun[at]
                return chain[::-1]
            for other in coupling.units[k].outputs:
                if other not in begun:
                    begun[other] = g
                    waiting.append(other)
    return [element]


class Growth:
    """One element that is watched."""

    def __init__(self, circle: int, size: float) -> None:
        self.circle = circle
        self.size = size  # the largest that it was
        self.begin = self.most = 0.0  # what it was as the growth began, and its largest step
        self.points = self.last = self.misses = 0  # how many, and which missed last

    def grows(self, value: float, guess: float) -> bool:
        """At one more point: whether the coupling has grown without bound."""
        self.points += 1
        size, now = self.size, abs(value)
        if not now > size:
            return False
        self.size = now
        if size == 0.0 or not abs(guess - value) > size / 2:
            return False
        if self.misses == 0 or self.points - self.last > NEAR_MISSES:
            self.begin, self.most, self.misses = size, 1.0, 0
        self.misses += 1
        self.last, self.most = self.points, max(self.most, now / size)
        return self.misses >= MISSES and now / self.begin / self.most >= GROWTH
