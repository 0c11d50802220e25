"""What a person gives to a Diagram or a Run: times, settings, and what rests where nothing is given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from ..contract.enumerations import resting
from ..model.diagram_grammar import MEASURES
from ..model.diagram_value import DiagramValue
from ..model.flatten import Flat
from ..model.settings import seconds
from ..text.errors import Fault, UsageError, did_you_mean, sentence_of
from ..text.printable import legible
from ..text.quantity_text import read_quantity


def time_of(place: str, raw: object) -> Fraction:
    """Return a time in s, exactly. place: named in errors. Raises UsageError (E501)."""
    try:
        return seconds(read_quantity(raw))
    except ValueError as error:
        raise UsageError(Fault("E501", place, sentence_of(error))) from None


def at_rest(value: DiagramValue, flat: Flat) -> dict[str, object]:
    """Zeros for the inputs that a diagram gives no value: where it is looked at around a point, they rest."""
    known = {*value.run.get("inputs", {}), *(name for name, entry in value.inputs.items() if "default" in entry)}
    return {
        entry.name: np.full(entry.shape, resting(entry.type)) if entry.shape
        else False if entry.type == "bool" else resting(entry.type)
        for entry in flat.inputs
        if entry.name not in known
    }


def picked(value: DiagramValue, measures: Sequence[str] | None) -> DiagramValue:
    """Return the diagram with the measures that are asked for. Raises UsageError (E501)."""
    if measures is None:
        return value
    if isinstance(measures, str):
        raise UsageError(Fault("E501", "measures", "must be a list of texts, not one text.", f'Give a list: '
            f'measures=["{legible(measures)}"].'))
    for name in measures:
        if name not in value.measures:
            known = f"Measures: {', '.join(value.measures) or 'none'}."
            kind = name if name in MEASURES else "peak"
            add = f'Add one: diagram.measure("{kind}", "{kind}", of="plant.y").'
            cure = did_you_mean(str(name), value.measures) or (known if value.measures else f"{known} {add}")
            raise UsageError(Fault("E501", legible(str(name)), "the diagram has no such measure.", cure))
    return replace(value, measures={name: value.measures[name] for name in measures})
