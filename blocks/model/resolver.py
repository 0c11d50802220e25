"""The block classes that a diagram may use, and those of the FMUs that it names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ..contract.block import Block
from ..text.errors import BlocksError, Fault, ModelError
from ..text.printable import legible, quoted
from .diagram_value import BlockEntry
from .hierarchy import Resolver


class _Classes:
    """The block classes that a diagram may use; see `blocks.model.hierarchy.Resolver`."""

    def __init__(self, types: Mapping[str, type[Block]]) -> None:
        self.types = types

    def __call__(self, name: str, /) -> type[Block]:
        if name not in self.types:
            raise KeyError(*self.types)
        return self.types[name]

    def fmu(self, entry: BlockEntry, folder: str) -> type[Block]:
        from .fmu_block import fmu_type

        try:
            return fmu_type(Path(folder) / entry.fmu, **entry.options)
        except (OSError, ValueError) as error:  # of a name that no file can have
            if isinstance(error, BlocksError):
                raise
            message = f"{quoted(entry.fmu[:200])} cannot be read."
            raise ModelError(Fault("E007", legible(entry.fmu), message, "Check the path.")) from None


def resolver_of(types: Mapping[str, type[Block]]) -> Resolver:
    return _Classes(types)
