"""What results are results of: the diagram, the versions, and what was given to the run."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..model.diagram import BlockEntry, DiagramValue
from ..model.document import to_document
from ..model.settings import MasterSettings, RunSettings
from ..model.values import Column
from ..text.version import __version__

__all__ = ["Origin", "fingerprint", "origin_of"]

MOST_NUMBERS = 50


class _Asked:
    """A text that is computed when it is first read: most results are never asked what their equations were."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = f"_{name}"

    def __get__(self, instance: Any, owner: type | None = None) -> str:
        if instance is None:
            return ""  # the default of the field
        value = getattr(instance, self.name)
        if not isinstance(value, str):
            value = value()
            object.__setattr__(instance, self.name, value)
        return str(value)

    def __set__(self, instance: Any, value: str | Callable[[], str]) -> None:
        object.__setattr__(instance, self.name, value)


@dataclass(frozen=True)
class Origin:
    """What results are results of, as result files keep it.

    sha256: the diagram's `fingerprint`. versions: of blocks, Python and numpy. settings: of the run, with those of the
    file. parameters: values given in place of the diagram's. inputs: as given to the run; of a file its name and
    SHA-256, of a long table its SHA-256. equations, values: the SHA-256 of the equations of all blocks and of the
    values of all parameters, wherever they come from; "" where they are not known.
    """

    sha256: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, Any] = field(default_factory=dict)
    equations: _Asked = _Asked()
    values: _Asked = _Asked()

    def __getstate__(self) -> dict[str, Any]:
        asked = ("equations", "values")
        return {f"_{name}" if name in asked else name: getattr(self, name) for name in self.kinds()}

    def told(self) -> dict[str, Any]:
        """What a file says of it: all but digests that are not known."""
        made = {name: getattr(self, name) for name in self.kinds()}
        return {name: value for name, value in made.items() if value != ""}

    @classmethod
    def kinds(cls) -> dict[str, type]:
        """The fields, and whether each is a text or a dict."""
        return {known.name: str if known.name in ("sha256", "equations", "values") else dict for known in fields(cls)}


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
    parameters: Mapping[str, Any] | None = None,
    inputs: Any = None,
    interpolation: str = "linear",
    equations: _Computed | None = None,
) -> Origin:
    """The origin of a run of `value`. parameters, inputs, interpolation: as given to the run.

    equations: what it computes, which is asked when the origin is.
    """
    # The package's version is its door's, which lies above this module.
    own = __version__
    versions = {"blocks": own, "python": platform.python_version(), "numpy": np.__version__}
    described = {key: _described(item) for key, item in (parameters or {}).items()}
    made = _settings(settings)
    if interpolation != "linear":
        made["interpolation"] = interpolation
    origin = Origin(fingerprint(value), versions, made, described, _inputs(inputs))
    if equations is None:
        return origin
    return replace(origin, equations=lambda: equations.sha256, values=lambda: equations.values_sha256)


def fingerprint(value: DiagramValue) -> str:
    """The SHA-256 of all that a diagram computes: its canonical JSON with the subdiagrams' in place of their paths,
    and the SHA-256 of FMUs in place of theirs.

    Documentation, layout and the spelling of numbers are left out. Block types go in by their names only.
    """
    return _sha256(json.dumps(to_document(_bare(value))).encode())


def _bare(value: DiagramValue) -> DiagramValue:
    """A diagram without what no number depends on."""
    return replace(
        value,
        doc="",
        parameters=_without_doc(value.parameters),
        inputs=_without_doc(value.inputs),
        blocks={name: _bare_entry(entry, value.folder) for name, entry in value.blocks.items()},
        run={key: item for key, item in value.run.items() if key != "doc" and not key.startswith("x-")},
        measures=_without_doc(value.measures),
        layout={},
        extras={},
    )


def _bare_entry(entry: BlockEntry, folder: str) -> BlockEntry:
    inner = entry.inner
    diagram = entry.diagram if inner is None else _bare(inner)
    parameters = _without_doc(entry.parameters)
    if entry.fmu:  # it counts by its bytes and its kind, and not by where it lies or in which process it runs
        options = {key: value for key, value in entry.options.items() if key == "kind"}
        entry = replace(entry, fmu=_sha256_of(Path(folder) / entry.fmu) or entry.fmu, options=options)
    return replace(entry, diagram=diagram, doc="", extras={}, parameters=parameters)


def _sha256_of(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest() if path.is_file() else ""
    except (OSError, ValueError):
        return ""


def _without_doc(entries: Mapping[str, Any]) -> dict[str, Any]:
    made: dict[str, Any] = {}
    for name, entry in entries.items():
        if isinstance(entry, Mapping):
            # A column of another file counts by its numbers, and not by where it lies.
            numbers = {"value": entry.numbers} if isinstance(entry, Column) else {}
            kept = {key: item for key, item in entry.items() if key not in ("doc", "csv", "column") and key[:2] != "x-"}
            whole = {**numbers, **kept}
            made[name] = whole["value"] if list(whole) == ["value"] else whole
        else:
            made[name] = entry
    return made


def _settings(settings: RunSettings) -> dict[str, Any]:
    """The settings that hold for a run; times in s."""
    made: dict[str, Any] = {"start": float(settings.start)}
    if settings.stop is not None:
        made["stop"] = float(settings.stop)
    made["method"] = settings.method
    if settings.is_fixed_step:
        made["step"] = None if settings.step is None else float(settings.step)
    else:
        made |= {"rtol": settings.rtol, "atol": settings.atol}
    if settings.every is not None:
        made["every"] = float(settings.every)
        if settings.jumps:
            made["jumps"] = True
    if settings.stops:
        made["stops"] = [float(stop) for stop in settings.stops]
    if settings.seed:
        made["seed"] = settings.seed
    plain = MasterSettings()
    for key in MasterSettings.__dataclass_fields__:
        value = getattr(settings.master, key)
        if value != getattr(plain, key):
            if isinstance(value, Mapping):
                value = {name: float(step) for name, step in value.items()}
            made[f"master.{key}"] = float(value) if isinstance(value, Fraction) else value
    return made


def _inputs(given: Any) -> dict[str, Any]:
    """What a run was fed with, by input; a file is an entry of its own."""
    made: dict[str, Any] = {}
    for item in given if isinstance(given, (list, tuple)) else [given]:
        if isinstance(item, (str, Path)):
            # A pipe cannot be read a second time.
            path = Path(item)
            made[path.name] = {"sha256": _sha256(path.read_bytes()) if path.is_file() else ""}
        elif item:
            made |= {name: _described(value) for name, value in item.items()}
    return made


def _described(value: Any) -> Any:
    """A given value as JSON holds it; more than 50 numbers are told by the SHA-256 of their doubles."""
    if isinstance(value, Mapping):
        return {str(key): _described(item) for key, item in value.items()}
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
