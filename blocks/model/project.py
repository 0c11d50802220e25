"""The project of a file: the folder whose files it may name, and whose FMUs may run for it.

It is the nearest folder above the file that holds pyproject.toml or .git, else the file's own. The root, the home
folder and those above it are passed over: such marks there (a repository of settings, say) are about something else,
and would make one project of all that a user has. Where FMUs run, folders that others may write to are passed over as
well: anybody could put an FMU there, or a mark that widens the project to all that lies below.
"""

from __future__ import annotations

import contextlib
import os
import stat
from dataclasses import dataclass, replace
from pathlib import Path

from ..text.atomic_write import real
from ..text.errors import Fault, ModelError, did_you_mean
from ..text.printable import quoted

if os.name == "posix":
    import grp
    import pwd

MARKS = ("pyproject.toml", ".git")
MAX_BYTES = 16 * 2**20
"""Of a file that is read."""


@dataclass(frozen=True, slots=True)
class Project:
    """A folder, without links in it, with all that is below.

    passed: why the nearest folder that was passed over is no project; "" where none was.
    is_whole: False where the file's own folder is no project either; then files directly in it may be read,
    and none of them may run.
    """

    folder: Path
    passed: str = ""
    is_whole: bool = True

    def holds(self, resolved: Path) -> bool:
        """Whether a file, by its path without links, may be read."""
        return resolved.is_relative_to(self.folder) if self.is_whole else resolved.parent == self.folder


def project_of(path: Path, *, runs: bool = False) -> Project:
    """The project of a file. runs: the one whose FMUs may run."""
    own = real(path).parent
    passed, is_whole = "", True
    for folder in (own, *own.parents):
        is_marked = any(os.path.exists(folder / mark) for mark in MARKS)
        if not is_marked and folder != own:
            continue
        why = _never(folder, runs)
        if is_marked and not why:
            return Project(folder, passed)
        if why:
            passed = passed or f"{folder} is not a project, because it {why}"
            is_whole = is_whole and folder != own
    return Project(own, passed, is_whole)


def _never(folder: Path, runs: bool) -> str:
    """Why a folder is no project; "" for one that can be."""
    if folder.parent == folder:
        return "is the root of the disk"
    home = real(Path(os.path.expanduser("~")))
    if home.is_absolute() and home.is_relative_to(folder):
        return "is the home folder" if home == folder else "lies above the home folder"
    return "is writable by other users" if runs and _is_shared(folder) else ""


def open_below(folder: Path, resolved: Path) -> str:
    """The folder on the way from a project to a file in it that others may write to, as a place; "" where none is."""
    between = resolved.relative_to(folder).parents
    open_folder = next((at for parent in between if (at := folder / parent) != folder and _is_shared(at)), None)
    return "" if open_folder is None else f"in {open_folder}, which is writable by other users"


def _is_shared(folder: Path) -> bool:
    """Whether others may write to a folder: all, or a group that is not its owner's own (as it is on many systems)."""
    if os.name != "posix":  # rights are in access lists there, not in the mode
        return False
    try:
        status = os.stat(folder)
    except OSError:
        return True
    if not status.st_mode & stat.S_IWGRP or status.st_mode & stat.S_IWOTH:
        return bool(status.st_mode & stat.S_IWOTH)
    with contextlib.suppress(KeyError):
        owner, group = pwd.getpwuid(status.st_uid).pw_name, grp.getgrgid(status.st_gid)
        return group.gr_name != owner or bool({*group.gr_mem} - {owner})
    return status.st_gid != status.st_uid


def read_inside(path: Path, project: Project, fault: Fault, shown: str = "", times: int = 1) -> bytes:
    """The bytes of a file inside the project. Raises ModelError (E007, E008), worded from `fault`'s place.

    shown: what the message calls the file. times: how many times larger than `MAX_BYTES` it may be.
    """
    name = shown or str(path)
    name = quoted(name if len(name) <= 60 else f"...{name[-57:]}")

    def refuse(code: str, message: str, cure: str = "") -> ModelError:
        return ModelError(replace(fault, code=code, message=f"{name} {message}", cure=cure))

    try:
        resolved = real(path)
        if not project.holds(resolved):
            passed = f" ({project.passed})" if project.passed else ""
            cure = "Move it into the project's folder."
            if not project.is_whole:
                cure = f"Put both into their own folder below {project.folder}."
            raise refuse("E007", f"lies outside the project{passed}.", cure)
        if not resolved.is_file():
            missing = "is a folder" if resolved.is_dir() else "is not a file" if resolved.exists() else "does not exist"
            if os.path.islink(path) and missing == "does not exist":
                raise refuse("E007", "is a link to a file that does not exist.", "Correct or replace the link.")
            sought = _neighbors(path)
            if not sought and fault.file:
                sought = "Paths are relative to the folder of the file that contains them."
            raise refuse("E007", f"{missing}.", "Name a file." if resolved.exists() else sought)
        # Between the look above and this one, another file may have been put there: a link, a pipe, a larger one.
        flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        with open(os.open(resolved, flags), "rb") as stream:
            if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                raise refuse("E007", "is not a regular file.", "Give the path of a file.")
            data = stream.read(times * MAX_BYTES + 1)
        if len(data) > times * MAX_BYTES:
            cure = "Keep tables of data in CSV files, and split large diagrams into subdiagram files."
            cure = "Leave out rows that are not needed." if path.suffix.lower() == ".csv" else cure
            raise refuse("E008", f"is larger than {times * MAX_BYTES // 2**20} MiB.", cure)
        return data
    except (OSError, ValueError) as error:
        if isinstance(error, ModelError):
            raise
        why = error.strerror if isinstance(error, OSError) else str(error)
        raise refuse("E007", f"cannot be read: {why}.") from None


def _neighbors(path: Path) -> str:
    try:
        return did_you_mean(path.name, [entry.name for entry in path.parent.iterdir()][:500])
    except OSError:
        return ""
