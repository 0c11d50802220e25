"""Files that are whole or absent: text is written beside its target, and replaces it when it is complete.

    <folder>/.<name>.<machine><random>.part     what is being written; locked by its writer as long as that lives

What a killed process left behind is removed by the next one that writes the same file: the lock tells the two apart.
Without locks (Windows) it is removed when it is a day old.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import platform
import re
import stat
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from ..host.locks import LOCKS, hold, lock
from .errors import Fault, UsageError
from .printable import legible

LONGEST = 100  # bytes of a name that stand in that of its part, which must not be too long
STALE = 86400.0  # s
PATIENCE = 2.0  # s for which a lock of another program on a file is waited for
UNSYNCED = (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EROFS)
"""The errors of file systems that cannot write through to the disk."""
CURES = {
    errno.ENOSPC: "Make room, or name a file on another disk.",
    errno.EDQUOT: "Make room, or name a file on another disk.",
    errno.EFBIG: "Write less, or name a file where larger ones may be.",
    errno.ENAMETOOLONG: "Shorten the name.",
    errno.EISDIR: "Name a file in it.",
    errno.ENOENT: "Make the folder, or name another one.",
    errno.ENOTDIR: "Name a file in a folder.",
    errno.EACCES: "Name a file that you may write to, in a folder that you may write to.",
    errno.EPERM: "Name a file in a folder that you may write to.",
    errno.EBUSY: "Run it again.",
    errno.EROFS: "Name a file in a folder that can be written to.",
    errno.EILSEQ: "Set PYTHONUTF8=1, or choose another name.",
}

_parts: set[str] = set()


def known_ending(path: str | Path, endings: Iterable[str], what: str) -> str:
    """The ending of a path, in small letters. Raises UsageError (E501) where it is none of the endings of `what`."""
    ending = Path(path).suffix.lower()
    *others, last = endings
    if ending not in (*others, last):
        this = f"the ending {legible(ending)!r} is" if ending else "a name without ending is"
        cure = f"Use {', '.join(others)}{' or ' if others else ''}{last}."
        raise UsageError(Fault("E501", legible(str(path)), f"{this} not a format of {what}.", cure))
    return ending


def real(path: Path) -> Path:
    """The path without links; unlike Path.resolve, this raises nothing for links in a circle."""
    try:
        return Path(os.path.realpath(path))
    except ValueError:  # a NUL
        return path


@contextlib.contextmanager
def write_atomically(path: str | Path, *, was: bytes | None = None) -> Iterator[Any]:
    """A text file that replaces `path` when all is written, or leaves it as it was, whatever happens.

    was: what a file that is edited must still hold then. A link is followed; a device or a pipe is written to as
    it is, unless something is to be edited. Raises UsageError (E501) where that cannot be done.
    """
    target = real(Path(path))
    try:
        is_device = _is_device(target)
        if is_device and was is not None:
            raise OSError(errno.EINVAL, "the file is no longer an ordinary file", str(target))
        with _device(target) if is_device else _part(target, was) as stream:
            yield stream
    except OSError as error:
        raise refused(path, error) from None


def refused(path: str | Path, error: OSError) -> UsageError:
    """The error of a file that cannot be written: E501."""
    why = error.strerror or str(error)
    cure = f"Nothing was changed. {CURES.get(error.errno or 0, '')}".rstrip()
    return UsageError(Fault("E501", legible(str(path)), f"cannot be written: {why}.", cure))


def check_target(path: str | Path) -> None:
    """Raise OSError where a file clearly cannot be written: by its folder, its name, what stands there."""
    target = real(Path(path))
    if _is_device(target):
        return
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
    with contextlib.suppress(FileNotFoundError):
        os.lstat(target)  # its name may be too long
    os.lstat(target.parent)
    if not target.parent.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(target.parent))
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target.parent))


def drop_parts() -> None:
    """Remove what this process is writing: for a process that ends at once."""
    for part in tuple(_parts):
        with contextlib.suppress(OSError):
            os.unlink(part)


def _is_device(target: Path) -> bool:
    """Whether something stands there that is neither a file nor a folder. Raises OSError."""
    if "\0" in str(target):
        raise OSError(errno.EINVAL, "the name holds a NUL", str(target))
    try:
        os.fsencode(target)
    except UnicodeEncodeError:
        what = f"file names use the encoding {sys.getfilesystemencoding()} here, which lacks characters of this name"
        raise OSError(errno.EILSEQ, what, str(target)) from None
    try:
        mode = os.stat(target).st_mode
    except FileNotFoundError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


@contextlib.contextmanager
def _device(target: Path) -> Iterator[object]:
    with open(target, "w", encoding="utf-8", newline="\n") as stream:
        yield stream


@contextlib.contextmanager
def _part(target: Path, was: bytes | None) -> Iterator[object]:
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
    if target.exists() and not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target))
    first = _first(target)
    _sweep(target.parent, first)
    handle, part = _made(target.parent, first)
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as stream:
            yield stream
            stream.flush()
            _sync(handle)
            _give(part, target)
            if sys.platform != "win32":  # while it is locked; Windows replaces only what is closed
                with _unchanged(target, was):
                    os.replace(part, target)
                part = _done(part)
        if part:
            with _unchanged(target, was):
                os.replace(part, target)
            part = _done(part)
        _sync_folder(target.parent)
    finally:
        if part:
            with contextlib.suppress(OSError):
                os.unlink(part)
            _done(part)


def _give(part: str, target: Path) -> None:
    """Gives a part the owner and mode of the file that it replaces, as far as allowed."""
    if sys.platform != "win32":
        with contextlib.suppress(OSError):
            known = os.stat(target)
            os.chown(part, known.st_uid, known.st_gid)
    with contextlib.suppress(OSError):
        os.chmod(part, _mode(target))


@contextlib.contextmanager
def _unchanged(target: Path, was: bytes | None) -> Iterator[None]:
    """Check that a file still holds `was`, and lock it within. Raises OSError, also where others keep it locked."""
    if was is None:
        yield
        return
    with open(target, "rb") as stream:
        limit = time.monotonic() + PATIENCE
        while not hold(stream.fileno()):  # whoever may read a file may lock it, for ever
            if time.monotonic() > limit:
                raise OSError(errno.EBUSY, f"another program has locked it for more than {PATIENCE:g} s", str(target))
            time.sleep(0.01)
        if target.read_bytes() != was:
            raise OSError(errno.EBUSY, "another program changed the file in the meantime", str(target))
        yield


def _done(part: str) -> str:
    _parts.discard(part)
    return ""


def _first(target: Path) -> str:
    """How the names of parts of a target begin. Only those of this machine can be known to be left behind."""
    encoding = sys.getfilesystemencoding()
    name = os.fsencode(target.name)[:LONGEST].decode(encoding, "ignore")
    return f".{name}.{hashlib.sha256(platform.node().encode()).hexdigest()[:8]}"


def _made(folder: Path, first: str) -> tuple[int, str]:
    """A new part and its name. Raises OSError."""
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    while True:
        part = str(folder / f"{first}{os.urandom(4).hex()}.part")
        _parts.add(part)
        try:
            handle = os.open(part, flags, 0o600)
        except FileExistsError:
            _parts.discard(part)
            continue
        except BaseException:
            _parts.discard(part)
            raise
        if _is_ours(handle):
            return handle, part
        os.close(handle)
        _parts.discard(part)


def _is_ours(handle: int) -> bool:
    """Lock a new part; whether nobody has removed it before that."""
    if not LOCKS:
        return True
    with contextlib.suppress(OSError):  # a file system without locks: nobody gets one to remove it
        lock(handle, wait=True)
    return os.fstat(handle).st_nlink > 0


def _sweep(folder: Path, first: str) -> None:
    """Remove parts of a target whose writers do not live any more."""
    left = re.compile(re.escape(first) + r"[0-9a-f]{8}\.part")
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if left.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                with contextlib.suppress(OSError):
                    _remove_left(entry.path)


def _remove_left(part: str) -> None:
    """Remove a part, unless its writer lives. Raises OSError."""
    if not LOCKS:
        if time.time() - os.stat(part).st_mtime > STALE:
            os.unlink(part)
        return
    handle = os.open(part, os.O_RDWR | os.O_NOFOLLOW)
    try:
        lock(handle)
        os.unlink(part)
    finally:
        os.close(handle)


def _sync(handle: int) -> None:
    """Write through to the disk, so that the new name has its content after a loss of power."""
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in UNSYNCED:
            raise


def _sync_folder(folder: Path) -> None:
    if sys.platform == "win32":
        return
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _mode(path: Path) -> int:
    """The mode of a file, or that of a new one: a part is for its writer alone."""
    try:
        return path.stat().st_mode & 0o777
    except OSError:
        return 0o666 & ~_mask()


def _mask() -> int:
    """The umask, which other threads create files by at the same time: it is read without being changed, on Linux."""
    with contextlib.suppress(OSError, ValueError), open("/proc/self/status", "rb") as lines:
        for line in lines:
            if line.startswith(b"Umask:"):
                return int(line.split()[1], 8)
    mask = os.umask(0o077)  # elsewhere a file of another thread may get too few rights for an instant, not too many
    os.umask(mask)
    return mask
