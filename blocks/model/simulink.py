"""The equivalents of Simulink's terms."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from functools import cache
from importlib import resources
from typing import NamedTuple

from ..text.printable import quoted

TYPES = {
    "CombinatorialLogic": "Combinatorial Logic", "DataTypeConversion": "Data Type Conversion",
    "DiscreteFilter": "Discrete Filter", "DiscreteFir": "Discrete FIR Filter",
    "DiscreteIntegrator": "Discrete-Time Integrator", "DiscretePulseGenerator": "Pulse Generator",
    "DiscreteStateSpace": "Discrete State-Space", "DiscreteTransferFcn": "Discrete Transfer Fcn",
    "DiscreteZeroPole": "Discrete Zero-Pole", "EnablePort": "Enable", "HitCross": "Hit Crossing",
    "Interpolation_n-D": "n-D Lookup Table", "Logic": "Logical Operator", "Lookup_n-D": "n-D Lookup Table",
    "Lookup2D": "2-D Lookup Table", "M-S-Function": "Level-2 MATLAB S-Function", "Math": "Math Function",
    "MATLABFcn": "Interpreted MATLAB Function", "RandomNumber": "Random Number", "Rounding": "Math Function",
    "Saturate": "Saturation", "SecondOrderIntegrator": "Integrator, Second-Order", "Signum": "Sign",
    "Sin": "Sine Wave", "Stop": "Stop Simulation", "SwitchCase": "Switch Case", "TriggerPort": "Trigger",
    "Trigonometry": "Trigonometric Function", "UniformRandomNumber": "Uniform Random Number",
}  # fmt: skip
"""BlockTypes of files that have another name in the library of Simulink."""


class Word(NamedTuple):
    """A term of Simulink. here: its equivalent. blocks: the types among it. see: a place of the documentation."""

    name: str
    here: str
    blocks: tuple[str, ...]
    see: str

    @property
    def meant(self) -> tuple[str, ...]:
        """The type of this name alone if there is one, else all."""
        same = [name for name in self.blocks if _plain(name) == _plain(self.name)]
        return tuple(same) or self.blocks


@cache
def words() -> Mapping[str, Word]:
    """Return the entries of all terms."""
    text = resources.files(__package__).joinpath("simulink_words.json").read_text(encoding="utf-8")
    return {name: Word(name, raw["here"], tuple(raw["blocks"]), raw["see"]) for name, raw in json.loads(text).items()}


def word_of(name: str) -> Word | None:
    """Return the entry of a term or BlockType in any case and spacing, or None if there is none."""
    name = next((title for type_, title in TYPES.items() if _plain(type_) == _plain(name)), name)
    return next((word for word in words().values() if _plain(word.name) == _plain(name)), None)


def hint(name: str, types: Iterable[str] = ()) -> str:
    """Return a sentence with the equivalent of a term, or "" if it is none, or one of the types but for its case."""
    word = None if name.casefold() in map(str.casefold, types) else word_of(name)
    return f"The equivalent of {quoted(word.name)}: {word.here}" if word else ""


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name.lower())
