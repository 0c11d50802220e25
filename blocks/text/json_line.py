"""An object as JSON in one line, as programs read it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any


def json_line(entry: Mapping[str, object]) -> str:
    return json.dumps(_finite(entry), allow_nan=False)


def _finite(value: object) -> Any:
    """JSON knows neither NaN nor infinity: null stands for them."""
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
