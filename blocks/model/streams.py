"""Streams of random numbers: each has a name, and a number that its name and the seed of the run give.

The name is the path of the block, unless the block or a subdiagram around it says another one:

    "left": {"diagram": "wheel.json"}                            its block "noise" draws from left.noise
    "front": {"diagram": "wheel.json", "stream": "left"}         from left.noise, now that left is called front
    "gusts": {"type": "Noise", "stream": "/wind"}                from wind, however deep it lies
"""

from __future__ import annotations

import hashlib
import re

_PART = r"[A-Za-z_][A-Za-z0-9_]{0,199}(?:\[[0-9]{1,6}\])?"
NAME = re.compile(rf"/?{_PART}(?:\.{_PART}){{0,30}}\Z", re.ASCII)
"""The name of a stream: that of a block or a copy, or a path; with "/" it counts from the whole diagram, else from its
own."""


def is_stream(text: object) -> bool:
    return isinstance(text, str) and bool(NAME.match(text))


def joined(prefix: str, text: str) -> str:
    """The whole name of a stream that is called `text` in the diagram whose streams begin with `prefix`."""
    return text[1:] if text.startswith("/") else prefix + text


def number_of(seed: int, name: str) -> float:
    """The number of a stream in a run: an integer below 2^52, the same on every machine."""
    digest = hashlib.sha256(f"{seed} {name}".encode()).digest()
    return float(int.from_bytes(digest[:8], "big") >> 12)
