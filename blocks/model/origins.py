"""Where the values of parameters come from: the one record of it, which the hierarchy leaves.

The hierarchy decides which raw value counts for a parameter: that of the file, of the block entry around, or one that
is set by a path. It chooses the element for one copy, and it knows the unit of a bare number. Flattening evaluates what
it found; settings, other values in a Plan and sweeps read it here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from .copies import Copy, own_value
from .values import Unit


class Origin(NamedTuple):
    """What the value of a parameter is computed from.

    written: what the file says, for all copies; None where it says nothing. raw: what counts in one copy. is_listed:
    whether it is an element of a list for copies. unit: of a bare number. depth: the declared dimensions. set_at: the
    path under which the raw value was set; "" where it is that of the file. is_outer: whether its names are the
    parameters of the diagram around the block, and not of the diagram itself. stream: of the number of a stream, its
    name; no raw value says it.
    """

    written: Any
    raw: Any
    is_listed: bool = False
    unit: Unit = ""
    depth: int = 0
    set_at: str = ""
    is_outer: bool = False
    stream: str = ""

    def again(self, raw: Any, copies: Sequence[Copy]) -> Any:
        """What another raw value that is set at the same path says in one copy. Raises ModelError."""
        return own_value(raw, self.depth, copies)


Origins = Mapping[str, Origin]
"""The origins of the parameters of a block or of a diagram, by name. What is not there has its default."""


def are_alike(some: Origins, others: Origins) -> bool:
    """Return whether two records of the same parameters say the same."""

    def is_same(one: Origin, other: Origin) -> bool:
        return one.raw is other.raw and (one.set_at, one.stream) == (other.set_at, other.stream)

    return some.keys() == others.keys() and all(is_same(origin, others[name]) for name, origin in some.items())
