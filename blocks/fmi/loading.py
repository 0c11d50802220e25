"""An FMU, unpacked and loaded for one kind, once for all of its instances in this process.

    with open_fmu("x.fmu", "CS", notes=cache) as loaded:
        loaded.description, loaded.interface, loaded.library

    open_fmu("x.fmu", "CS", isolate=True, timeout=10.0, compiled=compiled)     # each instance in a process of its own

A handle is given back by `close`, when nobody refers to it, and at the exit of the interpreter. After the last one the
library is unloaded, and then its folder is removed.
"""

from __future__ import annotations

import ctypes
import os
import threading
import weakref
from pathlib import Path
from types import TracebackType
from typing import Self

from ..text.errors import FMUError
from .archive import DESCRIPTION, Archive, Name, Unpacked, unpack
from .calls import Binding
from .description import remembered
from .exits import forget, watch
from .isolation import CompileC, isolated
from .library import TIMEOUT, Notes, find, folders, load, no_kind, suffix
from .model_description import Description, Interface
from .patience import undisturbed


class _Shared:
    """A binding with its folder and its users."""

    def __init__(self, key: _Key, binding: Binding, files: Unpacked) -> None:
        self.key, self.binding, self.files = key, binding, files
        self.users = 0

    def release(self) -> None:
        if os.getpid() != self.key[0]:
            return
        with _lock:
            self.users -= 1
            if self.users:
                return
            if _shared.get(self.key) is self:
                del _shared[self.key]
        # The library must be unloaded before its file is removed.
        with undisturbed():
            try:
                self.binding.unload()
            finally:
                forget(self.files.folder)
                self.files.close()


_Key = tuple[int, str, str, float]
"""The process, the file's SHA-256, the kind, and the timeout of calls where FMUs are isolated, else 0."""

_lock = threading.RLock()
_shared: dict[_Key, _Shared] = {}


class Loaded:
    """A handle on an FMU that is loaded. path: of its file; place: its name in messages."""

    def __init__(self, path: Path, place: str, shared: _Shared) -> None:
        with _lock:
            shared.users += 1
            self._finalizer = weakref.finalize(self, shared.release)
        self.path, self.place, self._shared = path, place, shared

    @property
    def binding(self) -> Binding:
        if not self._finalizer.alive:
            raise ValueError("the FMU was closed")
        return self._shared.binding

    @property
    def description(self) -> Description:
        return self._shared.binding.description

    @property
    def interface(self) -> Interface:
        return self._shared.binding.interface

    @property
    def library(self) -> ctypes.CDLL:
        return self.binding.library

    @property
    def folder(self) -> Path:
        return self._shared.files.folder

    @property
    def resources(self) -> Path:
        """It need not exist."""
        return self._shared.files.resources

    @property
    def sha256(self) -> str:
        return self._shared.binding.digest

    def again(self) -> Loaded:
        """One more handle, for one more user."""
        if not self._finalizer.alive:
            raise ValueError("the FMU was closed")
        return Loaded(self.path, self.place, self._shared)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Gives the handle back; once more does nothing."""
        self._finalizer()


def open_fmu(
    path: Name,
    kind: str,
    *,
    place: str = "",
    notes: Notes | None = None,
    timeout: float = TIMEOUT,
    isolate: bool = False,
    compiled: CompileC | None = None,
) -> Loaded:
    """The FMU for "ME" or "CS", loaded.

    place: its name in messages; the file's where it is empty. notes: as of `library.load`. timeout: s; how long it may
    take to load; with `isolate`, how long any call may take. isolate: each instance has a process of its own, whose
    library is loaded when the instance is made. compiled: what compiles these processes.

    Raises:
        ModelError: E007 where the file cannot be read.
        FMUError: E201 to E210 where it is no FMU, has no such kind, or does not load here; E217 where it cannot be
            isolated.
        CompilerError: E60x where it is to be isolated and that cannot be compiled.
    """
    if isolate and compiled is None:
        raise ValueError("isolate= needs compiled=, the function that compiles the process")
    file = Path(path)
    place = place or file.name
    files = unpack(file)
    kept = False
    try:
        key = (os.getpid(), files.sha256, kind, timeout if isolate else 0.0)
        with _lock:
            shared = _shared.get(key)
            if shared is not None and not shared.binding.is_broken:
                return Loaded(file, place, shared)
        description = remembered((files.folder / DESCRIPTION).read_bytes(), f"{place}/{DESCRIPTION}")
        interface = description.interface(kind)
        if interface is None or kind not in ("ME", "CS"):
            raise FMUError(no_kind(description, kind, place))
        member = _member(file, files, description, interface, place)
        library, own = files.folder / member, None
        if isolate:
            assert compiled is not None
            own = library
            proxy = isolated(own, fmi=description.fmi, timeout=timeout, place=place, compiled=compiled)
            loaded = ctypes.CDLL(str(proxy))
        else:
            watch(files.folder, place)
            loaded = load(library, place=place, notes=notes, timeout=timeout)
        binding = Binding(loaded, description, interface, files.folder, place, files.sha256, own)
        opened = _Shared(key, binding, files)
        kept = True
        with _lock:
            # Another thread may have been faster; both libraries are good, and each goes with its last user.
            _shared.setdefault(key, opened)
            if opened.binding.is_broken or _shared[key].binding.is_broken:
                _shared[key] = opened
        return Loaded(file, place, opened)
    finally:
        if not kept:
            forget(files.folder)
            files.close()


def _member(file: Path, files: Unpacked, description: Description, interface: Interface, place: str) -> str:
    """The library's name in the folder. Raises FMUError (E201)."""
    for name in folders(description.fmi) if Path(interface.identifier).name == interface.identifier else ():
        member = f"binaries/{name}/{interface.identifier}{suffix()}"
        if (files.folder / member).is_file():
            return member
    # The archive shows why there is none: sources are not unpacked.
    with Archive(file) as archive:
        return find(archive.files, description, interface, place)
