"""The numbers by which the master ends, repeats and controls its steps: `limits_header` gives them to its C."""

from __future__ import annotations

MOST_PASSES = 100
"""So many instants may follow each other at one time."""
MOST_GUESSES = 50
"""An algebraic loop across units is given up after so many."""
CONVERGED = 1e-10
"""An iterated step ends at this change of all that is exchanged, relative to its size; or at one that the solvers of
units, by the largest of their tolerances, do not resolve."""
MOST_LEARNT = 300
"""The most exchanged elements whose dependence on each other an iterated step learns."""
DEEPEST = 3
"""A step is iterated until so many instants inside it have cut it short."""
NEAR = 4096
"""So many ulp apart times are near each other."""
CLOSE, ROUGH = 0.1, 1e-3
"""Extrapolation uses only one of two points that are closer than this part of a step: CLOSE if something happened in
the unit, else ROUGH, because rounding would bend a course through both."""
SMALLEST = 1024
"""The smallest part of a step that is tried where a whole one is discarded."""
JUMPED = 1e-11
"""A signal that changes at an instant by less than this part of its last values has not jumped: a limit takes over from
it within a rounding error."""
MISSES, NEAR_MISSES, GROWTH = 30, 10, 1e6
"""What grows without bound: growth.py."""
ROUNDING = 1e-13
"""Two half steps differ from a whole one by this relative to their size, and no error is told from it."""
SAFETY, LEAST, MOST = 0.9, 0.2, 5.0
"""By how much a step may become shorter or longer, and how much less than the estimate allows."""
MOST_SMALL = 100
"""A run stops with an error after so many short steps in a row."""


def limits_header() -> str:
    """All of them, as C reads them."""
    return "".join(f"#define {name} {value!r}\n" for name, value in globals().items() if name.isupper())
