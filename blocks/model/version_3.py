"""From version 2 of diagrams to version 3: a number that a measure takes off is in the declared unit of its signal.

    "of": "motor.n", "against": 30     ->     "against": {"value": 30, "unit": "rad/s"}     (motor.n is in rpm)

Version 2 takes a plain number in SI. A number is converted only if it would change, which the units of the signals
tell; most files of version 2 have none, and stay as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from .diagram_value import VERSION, DiagramValue, is_plain_number


def converted(value: DiagramValue, in_si: Mapping[str, str]) -> DiagramValue:
    """Convert an older diagram to version 3. in_si: the SI units of the numbers that would change, by measure."""
    measures = {
        name: {**raw, "against": {"value": raw["against"], "unit": in_si[name]}} if name in in_si else raw
        for name, raw in value.measures.items()
    }
    return replace(value, measures=measures, version=VERSION)


def with_expressions(measures: Mapping[str, Mapping[str, object]]) -> dict[str, Mapping[str, object]]:
    """Return measures of an older diagram for version 3 where units are not known: expressions are in SI."""
    return {
        name: {**raw, "against": f"={raw['against']!r}"} if is_plain_number(raw.get("against")) else raw
        for name, raw in measures.items()
    }
