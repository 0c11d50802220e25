"""The cache of compiled code: a private folder of entries by key, bounded, safe to share between processes.

    <folder>/<sha256>/          one entry: a library or an object file, and `check` (its SHA-256, size and name)
    <folder>/failed-<...>/      sources and messages of a build that failed
    <folder>/compiler-<...>     the version that a compiler reported
    <folder>/fmu-loaded         which binaries of FMUs were tried in a process of their own
    <folder>/fmu-folders        the folders from which FMUs of diagrams were taken
    <folder>/tmp-<...>/         work in progress

An entry is made in a folder `tmp-...` and renamed when it is complete, so that nobody sees a partial one; of two
processes that make the same entry at once, the first wins. What does not fit its checksum is removed and made anew: a
truncated library would crash the process that loads it. Code from a folder that others may write to is never loaded: a
temporary folder of this process replaces it.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ...text.errors import CompilerError, Fault

VARIABLE = "BLOCKS_CACHE_DIR"
"""The environment variable that names another folder."""
MAX_BYTES = 512 * 2**20
MAX_ENTRIES = 4000

STALE = 3600.0  # s; work of this age was left behind by a process that was killed
CHECK = "check"
# Only names of this kind are ever removed: the folder may be one that holds other files as well.
ENTRY = re.compile(r"(?:[0-9a-f]{64}|failed-[0-9a-f]{16})\Z")
NOTE = re.compile(r"(?:compiler-[0-9a-f]{16}|fmu-loaded|fmu-folders)\Z")
WORK = re.compile(r"tmp-[0-9a-z_]{8}\Z")


@dataclass(frozen=True, slots=True)
class Size:
    """How many entries there are, and the bytes of their files."""

    entries: int
    bytes: int


@dataclass(frozen=True, slots=True)
class Cache:
    """A folder of entries. `reason` says why it is a temporary one; "" where it is the user's."""

    folder: Path
    reason: str = ""
    max_bytes: int = MAX_BYTES
    max_entries: int = MAX_ENTRIES

    @property
    def is_temporary(self) -> bool:
        return bool(self.reason)

    def find(self, key: str) -> Path | None:
        """The file of an intact entry, marked as used now; None where there is none."""
        entry = self.folder / key
        try:
            digest, length, name = (entry / CHECK).read_text(encoding="ascii").split()
            if os.path.basename(name) != name:
                raise ValueError("the file is in another folder")
            path = entry / name
            seen = os.stat(path)
            mark = (seen.st_ino, seen.st_size, seen.st_mtime_ns)
            if seen.st_size != int(length) or (_whole.get(path) != mark and _digest(path) != digest):
                raise ValueError("the file has changed since it was written")
        except (OSError, ValueError):  # UnicodeDecodeError is a ValueError
            return None
        _whole[path] = mark
        with contextlib.suppress(OSError):  # a read-only cache works too
            os.utime(entry)
        return path

    def store(self, key: str, file: Path) -> Path:
        """A copy of `file` as the entry `key`; returns its path. The limits are for `trim`. Raises OSError."""
        with self.work() as work:
            entry = work / "entry"
            entry.mkdir(mode=0o700)
            shutil.copyfile(file, entry / file.name)
            text = f"{_digest(file)} {file.stat().st_size} {file.name}\n"
            (entry / CHECK).write_text(text, encoding="ascii")
            for last in (False, True):
                try:
                    os.rename(entry, self.folder / key)
                    break
                except OSError:
                    # The name is taken: by an equal entry of another process, or by one that is broken. Any other
                    # cause fails again.
                    path = self.find(key)
                    if path is not None:
                        return path
                    if last:
                        raise
                    _remove(self.folder / key)
        return self.folder / key / file.name

    @contextlib.contextmanager
    def work(self) -> Iterator[Path]:
        """A private folder to work in, removed at the end. Raises OSError where it cannot be made."""
        folder = Path(tempfile.mkdtemp(prefix="tmp-", dir=self.folder))
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def keep_failure(self, key: str, work: Path) -> Path:
        """Keeps the work of a failed build until room is needed; returns its folder."""
        kept = self.folder / f"failed-{key[:16]}"
        _remove(kept)
        with contextlib.suppress(OSError):
            os.rename(work, kept)
            self.trim(keep=kept.name)
        return kept

    def read_note(self, name: str) -> str:
        """The text of a small file of this folder; "" where there is none."""
        try:
            return (self.folder / name).read_text(encoding="utf-8")
        except (OSError, ValueError):
            return ""

    def write_note(self, name: str, text: str) -> None:
        """Writes a small file, whole or not at all; nothing depends on it, so that a failure is no error."""
        with contextlib.suppress(OSError), self.work() as work:
            (work / name).write_text(text, encoding="utf-8")
            os.replace(work / name, self.folder / name)

    def size(self) -> Size:
        listed = self._listed()
        return Size(len(listed), sum(length for _, length, _ in listed))

    def trim(self, keep: str = "") -> None:
        """Removes the least recently used entries, until the limits are kept; never `keep`."""
        listed = self._listed()
        count, total = len(listed), sum(length for _, length, _ in listed)
        for _, length, path in sorted(listed):
            if count <= self.max_entries and total <= self.max_bytes:
                break
            if path.name != keep:
                _remove(path)
                count, total = count - 1, total - length
        self._sweep()

    def make_room(self, key: str) -> None:
        """Keep the limits after `key` was stored: of entries after each build, of bytes after one build in 16 or so.

        To read the sizes of 4000 entries takes 80 ms. The keys are digests, so their first digits are random.
        """
        if key[0] == "0" or len(self._children(ENTRY)) > self.max_entries:
            self.trim(keep=key)

    def clear(self) -> Size:
        """Removes all entries; returns what there was. Other processes' work in progress is left alone."""
        before = self.size()
        for path in (*self._children(ENTRY), *self._children(NOTE)):
            _remove(path)
        self._sweep()
        return before

    def _listed(self) -> list[tuple[float, int, Path]]:
        """Time of the last use in s, bytes, path of each entry."""
        entries = []
        for path in self._children(ENTRY):
            with contextlib.suppress(OSError):  # another process may remove it meanwhile
                entries.append((os.lstat(path).st_mtime, _bytes(path), path))
        return entries

    def _sweep(self) -> None:
        for path in self._children(WORK):
            with contextlib.suppress(OSError):
                if time.time() - os.lstat(path).st_mtime > STALE:
                    _remove(path)

    def _children(self, pattern: re.Pattern[str]) -> list[Path]:
        try:
            return [self.folder / name for name in os.listdir(self.folder) if pattern.match(name)]
        except OSError:
            return []


# Files that this process found intact (inode, size, time of change), so that they are not read again at each use; and
# why a folder was given up.
_whole: dict[Path, tuple[int, int, int]] = {}
_refused: dict[Path, str] = {}
_temporary: dict[int, Path] = {}


def of_user() -> Cache:
    """The user's cache, or a temporary folder of this process where that one cannot be trusted or made."""
    try:
        folder = _place()
    except (OSError, RuntimeError) as error:
        return temporary(f"the folder for caches is not known: {error}")
    if folder in _refused:
        return temporary(_refused[folder])
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = os.stat(folder)
    except OSError as error:
        return temporary(f"{folder} cannot be created: {error.strerror or error}")
    if os.name == "posix":
        if status.st_uid != os.geteuid():
            return temporary(f"{folder} belongs to another user")
        if stat.S_IMODE(status.st_mode) & 0o022:
            return temporary(f"other users can write to {folder}; remove it, and blocks creates it again")
    return Cache(folder)


def refuse(cache: Cache, reason: str) -> Cache:
    """The temporary folder that takes the place of `cache` for the rest of this process."""
    _refused[cache.folder] = reason
    return temporary(reason)


def temporary(reason: str) -> Cache:
    """The temporary folder of this process, removed at its end. Raises CompilerError (E604) where none can be made."""
    process = os.getpid()
    if process not in _temporary or not _temporary[process].is_dir():
        # A forked child gets its own, and leaves its parent's alone at its end.
        try:
            _temporary[process] = Path(tempfile.mkdtemp(prefix="blocks-native-"))
        except OSError as error:
            raise unwritable(Path("temporary folder"), error, reason) from None
        atexit.register(_remove_temporary, process, _temporary[process])
    return Cache(_temporary[process], reason)


def clear() -> Size:
    """Empties the user's cache; returns what there was."""
    return of_user().clear()


def size() -> Size:
    """What the user's cache holds."""
    return of_user().size()


def unwritable(folder: Path, error: OSError, reason: str = "") -> CompilerError:
    """E604, for `folder`; reason: why that one is needed."""
    needed = f"; it is needed because {reason}" if reason else ""
    cure = f"Make room, or set {VARIABLE} to another folder."
    return CompilerError(Fault("E604", str(folder), f"cannot be written to: {error.strerror or error}{needed}.", cure))


def _place() -> Path:
    """The folder that the environment names. Raises RuntimeError where there is no home folder."""
    named = os.environ.get(VARIABLE)
    if named:
        return Path(named).expanduser().absolute()
    if os.name == "nt":
        local = os.environ.get("LOCALAPPDATA")
        root = Path(local) if local else Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        root = Path.home() / "Library" / "Caches"
    else:
        # The XDG specification: a path that is not absolute is to be ignored.
        xdg = os.environ.get("XDG_CACHE_HOME", "")
        root = Path(xdg) if os.path.isabs(xdg) else Path.home() / ".cache"
    return root / "blocks" / "native"


def _digest(path: Path) -> str:
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _bytes(folder: Path | str) -> int:
    """The bytes of all files below; a failed build has folders."""
    with os.scandir(folder) as entries:
        return sum(
            _bytes(entry.path) if entry.is_dir(follow_symlinks=False) else entry.stat(follow_symlinks=False).st_size
            for entry in entries
        )


def _remove(path: Path) -> None:
    """Removes an entry, renamed first, so that nobody finds half of it."""
    aside = path.parent / f"tmp-{os.urandom(4).hex()}"
    with contextlib.suppress(OSError):  # gone already, or in use (Windows)
        os.rename(path, aside)
        if aside.is_dir():
            shutil.rmtree(aside, ignore_errors=True)
        else:
            aside.unlink()


def _remove_temporary(process: int, folder: Path) -> None:
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)
