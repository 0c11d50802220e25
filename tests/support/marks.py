"""Values of parametrized tests that take long: `make test` leaves them out, and `make test-long` runs them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest


def long(*values: Any) -> Any:
    """The values of one case."""
    return pytest.param(*values, marks=pytest.mark.long)


def long_but(cases: Iterable[Any], is_kept: Callable[..., bool]) -> list[Any]:
    """Cases, all of which take long but those that are kept. A case that is a tuple is given to `is_kept` in parts."""
    listed = [case if isinstance(case, tuple) else (case,) for case in cases]
    return [pytest.param(*case) if is_kept(*case) else long(*case) for case in listed]
