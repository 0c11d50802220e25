"""The wheel in clean environments of every supported Python that is there: size, imports, and whether it works.

python -m benchmarks.installing [--tools] [PYTHON ...]

Builds the wheel, and for each Python makes an environment, installs the wheel with what it depends on, and runs
commands in a folder with diagrams alone. --tools runs the wheel by pipx and uvx as well, which are installed into an
environment of their own. Needs an index of packages, and nothing but Python itself; a minute for each Python.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

__all__ = ["COMMANDS", "build_wheel", "check", "interpreters", "main", "try_commands"]

ROOT = Path(__file__).resolve().parent.parent
SUPPORTED = ("3.11", "3.12", "3.13")
DIAGRAMS = ("motor_pid.json", "paper", "adrc", "analysis")
COMMANDS = (
    ("--version",),
    ("doctor",),
    ("list", "Saturation"),
    ("list", "Scope"),
    ("explain", "E104"),
    ("schema",),
    ("check", "diagrams/paper/iadrc.json"),
    ("run", "diagrams/motor_pid.json", "--out", "a.csv", "--plot", "a.svg"),
    ("draw", "diagrams/motor_pid.json", "-o", "b.svg"),
    ("linearize", "diagrams/analysis/leso_pd.json", "--loop", "control.u"),
    ("export", "diagrams/motor_pid.json", "-o", "motor.fmu"),
    ("fmu", "run", "motor.fmu", "--stop", "1"),
)
"""What must end with 0 in the order given."""


def run(command: Sequence[str | Path], **options: object) -> subprocess.CompletedProcess[str]:
    """A command, with its output; raises RuntimeError with what it said where it fails."""
    # Modules on PYTHONPATH would take the place of what is installed.
    env = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")}
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, env=env, **options)  # type: ignore[call-overload]
    if done.returncode:
        raise RuntimeError(
            f"{' '.join(words)} ended with {done.returncode}:\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
        )
    return done  # type: ignore[no-any-return]


def build_wheel(folder: Path) -> Path:
    """The wheel of this checkout, in `folder`."""
    run([sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT])
    (made,) = folder.glob("*.whl")
    return made


def interpreters() -> dict[str, Path]:
    """By version: supported Pythons on the path, and those of pyenv."""
    found: dict[str, Path] = {}
    for version in SUPPORTED:
        named = shutil.which(f"python{version}")
        pyenv = sorted((Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python3"))
        for path in (*pyenv, *([Path(named)] if named else [])):
            told = subprocess.run(
                [path, "-c", "import sys, venv, ensurepip; print(sys.version[:4])"], capture_output=True, text=True
            )
            if told.stdout.strip() == version:
                found[version] = path
                break
    return found


def try_commands(prefix: Sequence[str | Path], folder: Path) -> int:
    """COMMANDS in a folder with diagrams and nothing else; returns their number."""
    folder.mkdir()
    (folder / "pyproject.toml").touch()
    for name in DIAGRAMS:
        place = ROOT / "diagrams" / name
        copy = shutil.copytree if place.is_dir() else shutil.copy2
        (folder / "diagrams").mkdir(exist_ok=True)
        copy(place, folder / "diagrams" / name)
    for command in COMMANDS:
        run([*prefix, *command], cwd=folder)
    return len(COMMANDS)


def size_of(folder: Path) -> float:
    """In MB of 10^6 bytes."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6


def least(command: Sequence[str | Path], times: int = 5) -> float:
    """The least seconds of a whole process."""
    made = []
    for _ in range(times):
        begun = time.perf_counter()
        run(command)
        made.append(time.perf_counter() - begun)
    return min(made)


def check(wheel: Path, python: Path, folder: Path) -> str:
    """An environment with the wheel; what was measured and tried, in a line."""
    run([python, "-m", "venv", folder])
    scripts = folder / ("Scripts" if sys.platform == "win32" else "bin")
    packages = next(folder.glob("[Ll]ib/**/site-packages"))
    before = size_of(packages)
    begun = time.perf_counter()
    run([scripts / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile", wheel])
    took = time.perf_counter() - begun
    installed = size_of(packages) - before
    ours = size_of(packages / "blocks")
    count = try_commands([scripts / "blocks"], folder / "work")
    pass_, imported = (least([scripts / "python", "-c", code]) for code in ("pass", "import blocks"))
    diagram = least([scripts / "python", "-c", "from blocks import Diagram"])
    return (
        f"installed in {took:.0f} s, {installed:.0f} MB, of which blocks {ours:.1f} MB; {count} commands; "
        f"import blocks {imported - pass_:.3f} s, from blocks import Diagram {diagram - pass_:.2f} s"
    )


def tools(wheel: Path, python: Path, folder: Path) -> list[str]:
    """The wheel by pipx and uvx, which install it by themselves."""
    run([python, "-m", "venv", folder])
    scripts = folder / "bin"
    run([scripts / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "pipx", "uv"])
    told = []
    for name, prefix in (
        ("pipx run", [scripts / "pipx", "run", "--spec", wheel, "blocks"]),
        ("uvx", [scripts / "uvx", "--python", python, "--from", wheel, "blocks"]),
    ):
        count = try_commands(prefix, folder / name.replace(" ", "_"))
        told.append(f"{name}: {count} commands")
    return told


def main(arguments: Sequence[str]) -> int:
    """Checks each Python that is named, else all that are there; 1 where one fails."""
    named = {name: Path(name) for name in arguments if name != "--tools"}
    found = named or interpreters()
    with tempfile.TemporaryDirectory() as folder:
        wheel = build_wheel(Path(folder))
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.2f} MB", flush=True)
        for version in () if named else sorted(set(SUPPORTED) - set(found)):
            print(f"Python {version}: not there")
        status = 0
        for number, (version, python) in enumerate(found.items()):
            try:
                print(f"Python {version}: {check(wheel, python, Path(folder) / f'env{number}')}", flush=True)
            except RuntimeError as error:
                status = 1
                print(f"Python {version}: {error}", flush=True)
        if "--tools" in arguments:
            for line in tools(wheel, next(iter(found.values())), Path(folder) / "tools"):
                print(line, flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
