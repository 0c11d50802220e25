"""Where results come from: the diagram, the versions, and what was given to the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any


class _Asked:
    """A field that is computed when it is first read: most results never need it. default: or a function that makes it.
    """

    def __init__(self, default: object) -> None:
        self.default = default

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = f"_{name}"

    def __get__(self, instance: object, owner: type | None = None) -> Any:
        if instance is None:
            return self.default
        value = getattr(instance, self.name)
        if callable(value):
            value = value()
            object.__setattr__(instance, self.name, value)
        return value

    def __set__(self, instance: object, value: object) -> None:
        object.__setattr__(instance, self.name, value)


@dataclass(frozen=True)
class Origin:
    """Where results come from, as result files record it.

    sha256: the diagram's `fingerprint`. versions: of blocks, Python and numpy. settings: of the run, with those of the
    file. parameters: values given in place of the diagram's. inputs: as given to the run; of a file its name and
    SHA-256, of a long table its SHA-256. equations, values: the SHA-256 of the equations of all blocks and of the
    values of all parameters, wherever they come from; "" where they are not known.
    """

    sha256: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    settings: _Asked = _Asked(dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, Any] = field(default_factory=dict)
    equations: _Asked = _Asked("")
    values: _Asked = _Asked("")

    def __getstate__(self) -> dict[str, Any]:
        asked = ("settings", "equations", "values")
        return {f"_{name}" if name in asked else name: getattr(self, name) for name in self.kinds()}

    def told(self) -> dict[str, Any]:
        """The entries in a file: all but digests that are not known."""
        entries = {name: getattr(self, name) for name in self.kinds()}
        return {name: value for name, value in entries.items() if value != ""}

    @classmethod
    def kinds(cls) -> dict[str, type]:
        """The fields, and whether each is a text or a dict."""
        return {known.name: str if known.name in ("sha256", "equations", "values") else dict for known in fields(cls)}
