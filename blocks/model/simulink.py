"""The equivalents of Simulink's terms."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import NamedTuple

from ..text.printable import quoted


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
    """Return the entry of a term in any case and spacing, or None if there is none."""
    return next((word for word in words().values() if _plain(word.name) == _plain(name)), None)


def hint(name: str) -> str:
    """Return a sentence with the equivalent of a term, or "" if it is none."""
    word = word_of(name)
    return f"The equivalent of {quoted(word.name)}: {word.here}" if word else ""


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name.lower())
