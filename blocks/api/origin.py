"""The origin of a run: what its results were computed from."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..contract.sparse import edges_of
from ..model.diagram_value import DiagramValue
from ..model.fingerprint import fingerprint
from ..model.settings import MasterSettings, RunSettings
from ..results.provenance import Origin
from ..text.version import __version__

MOST_NUMBERS = 50
_PYTHON = platform.python_version()


class _Computed(Protocol):
    """What is computed, of a prepared diagram."""

    @property
    def sha256(self) -> str: ...

    @property
    def values_sha256(self) -> str: ...


def origin_of(
    value: DiagramValue,
    settings: RunSettings,
    *,
    parameters: Mapping[str, object] | None = None,
    inputs: object = None,
    interpolation: str = "linear",
    equations: Callable[[], _Computed | None] | None = None,
    sha256: str = "",
) -> Origin:
    """Return the origin of a run of `value`. parameters, inputs, interpolation: as given to the run.

    equations: gives what it computes, and is called when that is read from the origin. sha256: the diagram's
    fingerprint, where it is known.
    """
    versions = {"blocks": __version__, "python": _PYTHON, "numpy": np.__version__}
    described = {key: _described(item) for key, item in (parameters or {}).items()}

    def described_settings() -> dict[str, object]:
        of_interpolation = {} if interpolation == "linear" else {"interpolation": interpolation}
        return _settings(settings) | of_interpolation

    def told(name: str) -> Callable[[], str]:
        return lambda: getattr(equations(), name, "") if equations is not None else ""

    known = [told("sha256"), told("values_sha256")]
    return Origin(sha256 or fingerprint(value), versions, described_settings, described, _inputs(inputs), *known)


def _settings(settings: RunSettings) -> dict[str, object]:
    """Return the settings of a run, with times in s."""
    described: dict[str, object] = {"start": float(settings.start)}
    if settings.stop is not None:
        described["stop"] = float(settings.stop)
    if settings.stop_when:
        described["stop_when"] = settings.stop_when
    described["method"] = settings.method
    if settings.is_fixed_step:
        described["step"] = None if settings.step is None else float(settings.step)
    else:
        described |= {"rtol": settings.rtol, "atol": settings.atol}
    if settings.every is not None:
        described["every"] = float(settings.every)
        if settings.jumps:
            described["jumps"] = True
    if settings.stops:
        described["stops"] = [float(stop) for stop in settings.stops]
    if settings.seed:
        described["seed"] = settings.seed
    plain = MasterSettings()
    for key in MasterSettings.__dataclass_fields__:
        value = getattr(settings.master, key)
        if value != getattr(plain, key):
            if isinstance(value, Mapping):
                value = {name: float(step) for name, step in value.items()}
            described[f"master.{key}"] = float(value) if isinstance(value, Fraction) else value
    return described


def _inputs(given: Any) -> dict[str, Any]:
    """Describe the data that a run received, by input; a file is a separate entry."""
    sources: dict[str, object] = {}
    for item in given if isinstance(given, (list, tuple)) else [given]:
        if isinstance(item, (str, Path)):
            # A pipe cannot be read a second time.
            path = Path(item)
            sources[path.name] = {"sha256": _sha256(path.read_bytes()) if path.is_file() else ""}
        elif item:
            sources |= {name: _described(value) for name, value in item.items()}
    return sources


def _described(value: Any) -> object:
    """Describe a given value as JSON. The SHA-256 of the doubles replaces more than 50 numbers."""
    if hasattr(value, "tocoo"):
        value = edges_of(value)
    if isinstance(value, Mapping):
        return {str(key): _described(item) for key, item in value.items()}
    if hasattr(value, "__array__"):  # a column of pandas, too
        value = np.asarray(value)
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    if isinstance(value, (list, tuple, np.ndarray)) and len(value) > MOST_NUMBERS:
        numbers = np.asarray(value)
        if numbers.dtype.kind in "biuf":
            return {"sha256": _sha256(np.ascontiguousarray(numbers, dtype="<f8").tobytes())}
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_described(item) for item in value]
    return value if isinstance(value, (str, bool, int)) or value is None else float(value)


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
