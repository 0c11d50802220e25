"""What a person gives to a Diagram or a Run: times and settings."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from ..model import document as documents
from ..model.settings import seconds
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.printable import legible

__all__ = ["check_settings", "time_of"]


def time_of(place: str, raw: Any) -> Fraction:
    """A time in s, exactly. place: what an error names. Raises UsageError (E501)."""
    try:
        return seconds(raw)
    except ValueError as error:
        message = error.faults[0].message if isinstance(error, ModelError) else str(error)
        raise UsageError(Fault("E501", place, message)) from None


def check_settings(given: Mapping[str, Any]) -> None:
    """Raise UsageError (E501) for what is no setting of a run."""
    for key in given:
        if key not in documents.RUN:
            cure = did_you_mean(key, documents.RUN) or f"Settings: {', '.join(documents.RUN)}."
            raise UsageError(Fault("E501", legible(key), "is not a setting of a run.", cure))
