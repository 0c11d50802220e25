"""blocks: block diagrams of control systems, simulated by one exact master algorithm.

The public names are loaded when first used, so that `import blocks` costs next to nothing.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from .library import NAMES
from .text.version import __version__ as __version__

if TYPE_CHECKING:
    from .api.adrc import ADRC as ADRC
    from .api.case import Case as Case
    from .api.diagram import Diagram as Diagram
    from .api.diagram import subdiagram as subdiagram
    from .api.prepared_model import PreparedModel as PreparedModel
    from .api.run import Run as Run
    from .api.simulink_import import from_simulink as from_simulink
    from .contract.block import Block as Block
    from .editing.applying import edit_file as edit_file
    from .model.fmu_block import fmu as fmu

_PLACES = {
    "ADRC": "api.adrc",
    "Algebraic": "contract.variables",
    "AnalysisError": "text.errors",
    "Block": "contract.block",
    "BlocksError": "text.errors",
    "Case": "api.case",
    "CompilerError": "text.errors",
    "DeclarationError": "text.errors",
    "Diagram": "api.diagram",
    "Discrete": "contract.variables",
    "Distribution": "studies.sampling",
    "FMUError": "text.errors",
    "Fault": "text.errors",
    "Fit": "studies.identification",
    "History": "contract.variables",
    "Input": "contract.variables",
    "LogUniform": "studies.sampling",
    "ModelError": "text.errors",
    "Normal": "studies.sampling",
    "Parameter": "contract.variables",
    "PreparedModel": "api.prepared_model",
    "Results": "results.results",
    "Run": "api.run",
    "Signal": "results.results",
    "SimulationError": "text.errors",
    "State": "contract.variables",
    "Stepped": "contract.variables",
    "Sweep": "studies.sweep",
    "Triangular": "studies.sampling",
    "TruncatedNormal": "studies.sampling",
    "Tuning": "studies.tuned",
    "Uniform": "studies.sampling",
    "UsageError": "text.errors",
    "crossing": "contract.equations",
    "each": "studies.sampling",
    "edit_file": "editing.applying",
    "event_time": "contract.equations",
    "fmu": "model.fmu_block",
    "from_simulink": "api.simulink_import",
    "local": "contract.equations",
    "output": "contract.equations",
    "pick": "contract.table_lookup",
    "requires": "contract.equations",
    "search": "contract.table_lookup",
    "stepper": "contract.equations",
    "subdiagram": "api.diagram",
    "wiring": "contract.equations",
}

__all__ = sorted([*_PLACES, *NAMES])


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name in _PLACES:
        return getattr(import_module(f"blocks.{_PLACES[name]}"), name)
    if name in NAMES:
        return getattr(import_module("blocks.library"), name)
    meant = _meant(name)
    message = f"module 'blocks' has no attribute {name!r}. {meant}".rstrip()
    # `from blocks import name` asks here first, but the ImportError that it makes of an AttributeError has no hint.
    if sys._getframe(1).f_globals.get("__name__") == "importlib._bootstrap" and (meant or name[:1].isupper()):
        raise ImportError(message, name=__name__)
    raise AttributeError(message)


def _meant(name: str) -> str:
    """Return a hint for a name that blocks does not have: a term of Simulink, of the analysis, or misspelt."""
    if not name[:1].isupper():
        from importlib import import_module
        from importlib.util import find_spec

        is_of_analysis = name in import_module("blocks.analysis").__all__ and find_spec(f"blocks.{name}") is None
        return f"Write from blocks.analysis import {name}." if is_of_analysis else ""
    from .model.simulink import hint
    from .text.errors import did_you_mean

    return hint(name, __all__) or did_you_mean(name, __all__)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
