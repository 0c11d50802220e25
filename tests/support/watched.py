"""Commands of `blocks`, each in a process of its own that is bounded and watched; a warm server forks them.

    with Watch() as watch:
        seen = watch(["check", "a.json"], folder)
        seen.status, seen.out, seen.err, seen.cpu, seen.memory, seen.deeds

Importing takes longer than refusing a file, so one server imports all that a command may need, and forks for each
command. A child gets no more than MEMORY on top of what the server holds, ends after PROCESSOR seconds of work or
SECONDS of waiting, and tells by an audit hook what a program must not do that only reads: deeds.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from tests.support.places import ROOT

MEMORY = 500 * 2**20  # bytes
PROCESSOR = 8
SECONDS = 60

# Events of sys.addaudithook that a command which refuses a file has no reason to raise.
FORBIDDEN = (
    "os.system",
    "os.exec",
    "os.fork",
    "os.forkpty",
    "os.posix_spawn",
    "os.spawn",
    "os.startfile",
    "pty.spawn",
    "subprocess.Popen",
    "ctypes.dlopen",
    "socket.connect",
    "socket.bind",
    "socket.getaddrinfo",
    "socket.gethostby",
    "socket.sendto",
    "urllib.",
    "ftplib.",
    "smtplib.",
    "http.",
    "pickle.find_class",
    "shelve.",
    "sqlite3.",
    "webbrowser.",
    "code.__new__",
    "os.remove",
    "os.rename",
    "os.mkdir",
    "os.rmdir",
    "os.link",
    "os.symlink",
    "os.chmod",
    "os.chown",
    "os.truncate",
    "os.utime",
    "os.putenv",
    "os.chdir",
    "shutil.",
    "tempfile.",
    "os.kill",
    "sys.addaudithook",
    "glob.",
    "os.mkfifo",
    "os.mknod",
)


@dataclass(frozen=True)
class Seen:
    """What a command did. cpu: s of the processor. memory: bytes at most, with what the server held. deeds: events."""

    status: int
    out: str
    err: str
    cpu: float
    memory: int
    deeds: tuple[str, ...]

    @property
    def said(self) -> str:
        return self.out + self.err

    @property
    def faults(self) -> list[dict[str, Any]]:
        """The faults that --json tells."""
        made = [json.loads(line) for line in self.out.splitlines() if line.startswith('{"event": "fault"')]
        return [one for one in made if one["event"] == "fault"]


class Watch:
    def __enter__(self) -> Self:
        surroundings = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}
        self.server = subprocess.Popen(
            [sys.executable, "-m", "tests.support.watched"],
            cwd=ROOT,
            env=surroundings,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        return self

    def __exit__(self, *_: object) -> None:
        assert self.server.stdin is not None
        assert self.server.stdout is not None
        self.server.stdin.close()
        self.server.stdout.close()
        self.server.wait(60)

    def __call__(self, words: list[str], folder: Path, *, writes: bool = False, **surroundings: str) -> Seen:
        """What a command does that is given in `folder`. writes: what it writes is no deed."""
        assert self.server.stdin is not None
        assert self.server.stdout is not None
        asked = {"words": words, "folder": str(folder), "surroundings": surroundings, "writes": writes}
        self.server.stdin.write(json.dumps(asked) + "\n")
        self.server.stdin.flush()
        told = json.loads(self.server.stdout.readline())
        return Seen(**{**told, "deeds": tuple(told["deeds"])})


def warm() -> None:
    """Import what commands import, and do once what is done once."""
    import importlib

    from blocks.cli import main

    for name in (
        "control",
        "matplotlib.pyplot",
        "pyarrow.parquet",
        "scipy.io",
        "scipy.linalg",
        "scipy.signal",
    ):
        importlib.import_module(name)
    ball, motor = str(ROOT / "diagrams" / "bouncing_ball.json"), str(ROOT / "diagrams" / "motor_pid.json")
    with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stdout(nowhere):
        for words in (
            ["check", str(ROOT / "diagrams" / "paper" / "iadrc_fmu.json")],
            ["run", ball, "--stop", "0.1", "--engine", "reference"],
            ["draw", ball],
            ["list"],
            ["linearize", motor, "--from", "control.u", "--to", "motor.omega"],
        ):
            main(words)
    for name in ("studies.study", "studies.report", "results.comparison", "export.exporter", "fmi.summary"):
        importlib.import_module(f"blocks.{name}")


def serve() -> None:
    out = os.dup(1)
    os.dup2(2, 1)
    warm()
    for line in sys.stdin:
        os.write(out, (json.dumps(forked(json.loads(line), out)) + "\n").encode())


def forked(asked: dict[str, Any], out: int) -> dict[str, Any]:
    with tempfile.TemporaryFile() as said, tempfile.TemporaryFile() as complained, tempfile.TemporaryFile() as deeds:
        child = os.fork()
        if not child:
            os.close(out)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(said.fileno(), 1)
            os.dup2(complained.fileno(), 2)
            obey(asked, deeds.fileno())
        _, ended, used = os.wait4(child, 0)
        texts = []
        for stream in (said, complained, deeds):
            stream.seek(0)
            texts.append(stream.read(2_000_000).decode("utf-8", "backslashreplace"))
    return {
        "status": os.waitstatus_to_exitcode(ended),
        "out": texts[0],
        "err": texts[1],
        "cpu": used.ru_utime + used.ru_stime,
        "memory": used.ru_maxrss * 1024,
        "deeds": texts[2].splitlines(),
    }


def obey(asked: dict[str, Any], deeds: int) -> None:
    """The command, in the child; never returns."""
    status = 99
    try:
        os.environ.update(asked["surroundings"])
        os.chdir(asked["folder"])
        tempfile.tempdir = None
        held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (held + MEMORY, held + MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR, PROCESSOR))
        signal.alarm(SECONDS)
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        from blocks.cli import main

        folder, writes = os.path.realpath(asked["folder"]), asked["writes"]

        def audit(event: str, arguments: tuple[Any, ...]) -> None:
            told = ""
            if event == "open":
                path, _, flags = arguments
                if not writes and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT) and not isinstance(path, int):
                    told = f"open for writing {path!r}"
            elif event == "import":
                place = str(arguments[1] or "")
                if place.startswith(folder):
                    told = f"import {arguments[0]} from {place}"
            elif event in ("compile", "exec"):
                name = str(arguments[1]) if event == "compile" else getattr(arguments[0], "co_filename", "")
                if name.startswith(folder):
                    told = f"{event} {name}"
            elif event.startswith(FORBIDDEN) and not writes:
                told = event
            if told:
                os.write(deeds, (told + "\n").encode("utf-8", "backslashreplace"))

        sys.addaudithook(audit)
        status = main(asked["words"])
        sys.stdout.flush()
        sys.stderr.flush()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 98
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


if __name__ == "__main__":
    serve()
