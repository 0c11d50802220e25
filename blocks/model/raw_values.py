"""Values of Python as a diagram file would hold them."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from numbers import Rational
from typing import Any

import numpy as np

from ..text.errors import Fault, UsageError
from ..text.printable import quoted

__all__ = ["raw_of"]


def raw_of(value: Any) -> Any:
    """A value as the file would hold it. Raises UsageError (E501)."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, (str, bool, int, float)) or value is None:
        return value
    if isinstance(value, (list, tuple)):
        return [raw_of(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): raw_of(item) for key, item in value.items()}
    if isinstance(value, (Rational, Decimal)):
        return float(value)
    raise UsageError(Fault("E501", "", f"{quoted(repr(value))} is not a value that a diagram can hold."))
