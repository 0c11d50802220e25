"""Modules of block types by name, as their files are now: Python keeps what was imported first.

Of each module, its file and a digest of its text are remembered, and the same of the modules that it imports and that
lie beside it. Where one of these differs, all are loaded anew. Of a module that others imported before, the text is
that of its file when it is first asked for, unless Python's compiled copy shows that it was another one.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import os
import sys
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType

from ..text.errors import Fault, UsageError
from ..text.printable import legible


@dataclass(frozen=True, slots=True)
class _Loaded:
    """A module, whether it was loaded here, and the files of it and of those beside it, by name, with their digests."""

    module: ModuleType
    is_own: bool
    files: dict[str, tuple[str, bytes]]

    @property
    def is_current(self) -> bool:
        return all(_digest(file) == digest for file, digest in self.files.values())


_PACKAGES = frozenset({"site-packages", "dist-packages"})
_LOADED: dict[str, _Loaded] = {}


def current(name: str) -> ModuleType:
    """The module of this name, as `import` would find it in a new process.

    Raises what the module raises, and UsageError (E501) where another one of this name was imported before.
    """
    importlib.invalidate_caches()
    before = sys.modules.get(name)
    if before is None:
        return _load(name)
    known = _LOADED.get(name)
    if known is not None and known.module is not before:
        known = None  # somebody else has replaced it
    is_own = known is not None and known.is_own
    file, was = _file(name), getattr(before, "__file__", None)
    if was is None or (file is None and not is_own):
        return before  # it was made or imported from somewhere else, and there is no other one
    if file is None or os.path.realpath(file) != os.path.realpath(was):
        if not is_own:
            message = f"is already imported from {legible(was)}, but the name now leads to {legible(str(file))}."
            cure = "Pass the module itself, or rename one of the two files."
            raise UsageError(Fault("E501", legible(name), message, cure))
        return _load(name)
    if known is None:
        if _is_written_since(before, was):
            return _load(name)
        known = _LOADED[name] = _Loaded(before, False, _files(name))
    return before if known.is_current else _load(name)


def _load(name: str) -> ModuleType:
    """Import a module and those beside it from their files, and remember their digests."""
    known = _LOADED.get(name)
    dropped = {}
    for module_name in (name, *(known.files if known is not None else ())):
        if module_name in sys.modules:
            dropped[module_name] = sys.modules.pop(module_name)
    writes, prefix = sys.dont_write_bytecode, sys.pycache_prefix
    # Python knows a compiled copy by the second and the size of its file: an edit within a second would not be seen.
    sys.dont_write_bytecode = True
    if dropped:  # of which others may have left compiled copies
        sys.pycache_prefix = os.path.join(os.devnull, "none")
    try:
        loaded = importlib.import_module(name)
    except BaseException:
        sys.modules.update(dropped)
        raise
    finally:
        sys.dont_write_bytecode, sys.pycache_prefix = writes, prefix
    _LOADED[name] = _Loaded(loaded, True, _files(name))
    return loaded


def _files(name: str) -> dict[str, tuple[str, bytes]]:
    """The files of a module and of those that it imports and that lie beside it, by name, with their digests."""
    own = _file_of(name)
    if own is None:
        return {}
    top = _file_of(name.partition(".")[0]) if "." in name else own
    folder = Path(top or own).resolve().parent
    file_digests: dict[str, tuple[str, bytes]] = {}
    waiting = [name]
    while waiting:
        module_name = waiting.pop()
        file = _file_of(module_name)
        if file is None or module_name in file_digests or module_name.partition(".")[0] == __name__.partition(".")[0]:
            continue
        path = Path(file).resolve()
        if module_name != name and not (path.is_relative_to(folder) and _PACKAGES.isdisjoint(path.parts)):
            continue
        file_digests[module_name] = (file, _digest(file))
        waiting += _imports(module_name, path)
    return file_digests


def _imports(name: str, file: Path) -> list[str]:
    """The names of the modules that a module may import, by its text."""
    try:
        tree = ast.parse(file.read_bytes())
    except (OSError, SyntaxError, ValueError):
        return []
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    imported: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imported += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = package.split(".")[: max(0, len(package.split(".")) - node.level + 1)]
                base = ".".join([*parts, *([base] if base else [])])
            imported += [base, *(f"{base}.{alias.name}" for alias in node.names)]
    return [
        ".".join(parts[: k + 1])
        for parts in (module_name.split(".") for module_name in imported)
        for k in range(len(parts))
    ]


def _digest(file: str) -> bytes:
    """The digest of the text of a file; b"" where it is gone."""
    try:
        return hashlib.sha256(Path(file).read_bytes()).digest()
    except OSError:
        return b""


def _is_written_since(module: ModuleType, file: str) -> bool:
    """Whether the file of a module has changed since it was compiled, as far as its compiled copy shows."""
    kept = getattr(module, "__cached__", None)
    try:
        head = Path(kept).read_bytes()[:16] if kept else b""
        status = os.stat(file)
    except OSError:
        return False
    if len(head) < 16 or head[4:8] != bytes(4):  # there is no compiled copy, or it is known by a digest
        return False
    words = (int(status.st_mtime) & 0xFFFFFFFF, status.st_size & 0xFFFFFFFF)
    return head[8:16] != b"".join(word.to_bytes(4, "little") for word in words)


def _file(name: str) -> str | None:
    """Where a module of this name would be found now; None where it would not be, or is no file."""
    path: list[str] | None = None
    spec: ModuleSpec | None = None
    parts = name.split(".")
    for k in range(len(parts)):
        spec = PathFinder.find_spec(".".join(parts[: k + 1]), path)
        if spec is None:
            return None
        path = list(spec.submodule_search_locations or ())
    return spec.origin if spec is not None and spec.has_location else None


def _file_of(name: str) -> str | None:
    """The file of a module that is loaded, where it has one that is a text."""
    file = getattr(sys.modules.get(name), "__file__", None)
    return file if isinstance(file, str) and file.endswith(".py") else None
