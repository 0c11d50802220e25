"""Block types by name: those that ship, those of installed packages, and those that a caller brings."""

from __future__ import annotations

import inspect
import os
import sys
import traceback
from collections import ChainMap
from collections.abc import Iterable, Mapping, MutableMapping
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from ..contract.block import Block, is_abstract
from ..text.errors import BlocksError, Fault, UsageError
from ..text.printable import legible
from .modules import current

GROUP = "blocks.library"
"""The entry points of packages that bring blocks."""
Library = Iterable[type[Block] | ModuleType | str] | type[Block] | ModuleType | str


def library_types(library: Library = ()) -> Mapping[str, type[Block]]:
    """Block types by name: those that ship, those of installed packages (entry points `blocks.library`), and `library`.

    library: block classes, modules that hold some, or names of modules, which are imported. Raises UsageError (E501).
    """
    from ..library import LIBRARY

    types: ChainMap[str, type[Block]] = ChainMap({}, cast("MutableMapping[str, type[Block]]", LIBRARY))
    for entry in _entry_points():
        types.update(_types_of(entry.load()))
    given: Any = library
    for item in [given] if isinstance(given, (str, type, ModuleType)) else given:
        classes = _types_of(_imported(item) if isinstance(item, str) else item)
        if not classes:
            name = getattr(item, "__name__", str(item))
            message, cure = "contains no block class.", "Derive one from blocks.Block."
            if isinstance(item, type) and issubclass(item, Block) and is_abstract(item):
                message, cure = "is an abstract block.", f"Derive a block from it, as in class Own({name})."
            raise UsageError(Fault("E501", legible(name), message, cure))
        for key, cls in classes.items():
            if types.get(key, cls) is not cls:
                message = f"{types[key].__module__} already has a block type of this name."
                raise UsageError(Fault("E501", f"{cls.__module__}.{key}", message, "Give yours another name."))
        types.update(classes)
    return types


def _entry_points() -> Any:
    """Those of all packages; reading their metadata takes longer than seeing that none names the group."""
    if not any(map(_may_extend, sys.path)):
        return ()
    from importlib.metadata import entry_points

    return entry_points(group=GROUP)


def _may_extend(place: str) -> bool:
    """Whether a package in a folder of `sys.path` has blocks; a file, such as a zip archive, may hold some."""
    try:
        with os.scandir(place or ".") as entries:
            folders = [entry.path for entry in entries if entry.name.lower().endswith("-info")]
    except NotADirectoryError:
        return True
    except OSError:  # it does not exist
        return False
    for folder in folders:
        with suppress(OSError), open(os.path.join(folder, "entry_points.txt"), "rb") as file:
            if GROUP.encode() in file.read():
                return True
    return False


def _types_of(item: object) -> dict[str, type[Block]]:
    """A block class, or those of a module; abstract classes are left out."""
    values = vars(item).values() if isinstance(item, ModuleType) else [item]
    return {
        value.__name__: value
        for value in values
        if inspect.isclass(value) and issubclass(value, Block) and value is not Block and not is_abstract(value)
    }


def _imported(name: str) -> ModuleType:
    """A module that the caller names; one that lies in the current folder is found too."""
    if name.endswith(".py") or "/" in name or "\\" in name:
        folder = "" if Path(name).parent == Path() else f", with PYTHONPATH={Path(name).parent} in the environment"
        cure = f"Use {Path(name).stem}{folder}."
        raise UsageError(Fault("E501", name, "is a path, but a module's name is needed.", cure))
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        return current(name)
    except BlocksError as error:
        raise type(error)(*(_placed(fault, error) for fault in error.faults)) from error
    except Exception as error:  # a module may raise anything
        cure = "It must be in the current folder or installed." if isinstance(error, ImportError) else ""
        message = f"the module cannot be imported: {type(error).__name__}: {error}."
        raise UsageError(Fault("E501", legible(name), message, cure)) from error
    finally:
        sys.path.remove(here)


def _placed(fault: Fault, error: BlocksError) -> Fault:
    """A fault of a block class with the line of the module that declares it."""
    inside = str(Path(__file__).parents[1])
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not f.filename.startswith((inside, "<"))]
    return fault.at(frames[-1].filename, frames[-1].lineno or 1, 1) if frames else fault
