"""The record of where the values of parameters come from; the hierarchy writes it.

The hierarchy decides which raw value counts for a parameter: that of the file, of the block entry around, or one that
is set by a path. It chooses the element for one copy, and it knows the unit of a bare number. Flattening evaluates this
raw value; settings, other values in a Plan and sweeps read the record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from .copies import Copy, own_value
from .values import Unit


class Origin(NamedTuple):
    """The source of the value of a parameter.

    written: the entry of the file, for all copies; None if it has none. raw: the raw value that counts in one copy.
    is_listed: whether it is an element of a list for copies. unit: of a bare number. depth: the declared dimensions.
    set_at: the path under which the raw value was set; "" if it is that of the file. is_outer: whether its names are
    the parameters of the diagram around the block, and not of the diagram itself. stream: the name of the stream, if
    the value is the number of a stream; it has no raw value then.
    """

    written: Any
    raw: Any
    is_listed: bool = False
    unit: Unit = ""
    depth: int = 0
    set_at: str = ""
    is_outer: bool = False
    stream: str = ""

    def again(self, raw: object, copies: Sequence[Copy]) -> Any:
        """Return the part of another raw value at the same path that counts in one copy. Raises ModelError."""
        return own_value(raw, self.depth, copies)


Origins = Mapping[str, Origin]
"""The origins of the parameters of a block or of a diagram, by name. What is not there has its default."""


def are_alike(some: Origins, others: Origins) -> bool:
    """Return whether two records of the same parameters are equal."""

    def is_same(one: Origin, other: Origin) -> bool:
        return one.raw is other.raw and (one.set_at, one.stream) == (other.set_at, other.stream)

    return some.keys() == others.keys() and all(is_same(origin, others[name]) for name, origin in some.items())
