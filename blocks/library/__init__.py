"""The block library: every concrete block, by its name."""

from importlib import import_module
from typing import Any

from ..contract.block import Block, is_abstract

_MODULES = (
    "adrc", "angles", "arithmetic", "continuous", "discrete", "drives", "excitation", "expression", "filters", "flight",
    "friction", "functions", "logic", "mechanics", "memory", "noise", "nonlinear", "observers", "oscillators", "pid",
    "power", "process", "robot", "sampled", "sources", "tables", "vectors", "wiring",
)  # fmt: skip


def _classes(name: str) -> dict[str, Any]:
    module = import_module(f"{__name__}.{name}")
    return {each: getattr(module, each) for each in module.__all__}


_PUBLIC = {name: cls for module in _MODULES for name, cls in _classes(module).items() if not is_abstract(cls)}

LIBRARY: dict[str, type[Block]] = dict(sorted(_PUBLIC.items(), key=lambda item: (not item[0].isupper(), item[0])))
"""Block classes by the names that diagrams use: abbreviations, then words."""

__all__ = ["LIBRARY", *LIBRARY]


def __getattr__(name: str) -> Any:
    if name in LIBRARY:
        return LIBRARY[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
