"""The type of arrays of numbers, whatever their shape and element type."""

from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


def frozen(array: Array) -> Array:
    """Return the array after it was made read-only."""
    array.setflags(write=False)
    return array
