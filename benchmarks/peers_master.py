"""Other masters on the chains and rings of benchmarks/master.py, each in an environment of its own: `make bench-peers`.

python -m benchmarks.peers_master [NAME ...]

Times are those of the steps alone, in us for each FMU and step; loading, with the description read and all initialized,
stands beside them for each FMU. The master by hand runs before each tool, on the same core.
"""

from __future__ import annotations

import ctypes
import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .master import COUNTS, RATE, SHAPES, STEPS, Floor, Ours
from .measure import on_one_core
from .peers import FOLDER, SCRIPTS

__all__ = ["PEERS", "main"]


@dataclass(frozen=True)
class Peer:
    """What pip installs; what its build wants to find installed before; a Debian package, and the file in it that the
    tool needs besides.
    """

    packages: tuple[str, ...]
    before: tuple[str, ...] = ()
    debian: str = ""
    library: str = ""


PEERS = {
    "fmpy": Peer(("fmpy",)),
    "libcosimpy": Peer(("libcosimpy",)),
    "ecospy": Peer(("ecospy",), debian="libtbb12", library="libtbb.so.12"),
    # Later versions have another interface in Python. Its build downloads the program from its makers' server.
    "omsimulator": Peer(("OMSimulator<3",)),
    # PyPI has an old version, as source; it needs the FMI Library (FMIL_HOME) and Assimulo.
    "pyfmi": Peer(("pyfmi",), before=("cython", "lxml", "numpy", "scipy", "setuptools", "wheel")),
}
LONGEST = 300.0
"""s that a tool may take for one chain or ring."""


@dataclass(frozen=True)
class Told:
    """Seconds of the least run without and with recording (inf: not measured), and of loading all; the largest
    difference of the outputs at the end from those of the master by hand, NaN where the tool does not tell them.
    """

    plain: float
    recorded: float
    load: float
    apart: float


def _python(name: str) -> Path:
    return FOLDER / f"master-{name}" / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")


def _install(name: str) -> str:
    """An environment with the peer; returns why there is none."""
    peer, folder = PEERS[name], FOLDER / f"master-{name}"
    mark = folder / "installed"
    if mark.exists():
        return ""
    FOLDER.mkdir(parents=True, exist_ok=True)
    pip = [str(_python(name)), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    commands = [[sys.executable, "-m", "venv", "--clear", str(folder)]]
    commands += [[*pip, *peer.before]] if peer.before else []
    commands += [[*pip, *(["--no-build-isolation"] if peer.before else []), *peer.packages]]
    for command in commands:
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=600)
        except subprocess.TimeoutExpired:
            return "the installation took longer than 10 min"
        if done.returncode:
            return f"cannot be installed: {_reason(done.stderr)}"
    if peer.library and not _has(peer.library):
        why = _unpack(peer, folder / "debian")
        if why:
            return why
    listed = subprocess.run([*pip[:3], "list", "--format=json"], capture_output=True, text=True)
    versions = {entry["name"].lower(): entry["version"] for entry in json.loads(listed.stdout)}
    mark.write_text(f"{name} {versions.get(name, '?')}", encoding="utf-8")
    return ""


def _reason(errors: str) -> str:
    """The line of pip's messages that tells most: what a build raised, else the last."""
    lines = [line.strip() for line in errors.splitlines() if line.strip()] or ["no message"]
    raised = [line for line in lines if re.match(r"(error: .* .*|\w*(Error|Exception): )", line)]
    return (raised or [line for line in lines if line.startswith("ERROR:")] or lines)[-1][:230]


def _has(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _unpack(peer: Peer, folder: Path) -> str:
    """A Debian package into a folder, without installing it; returns why not."""
    folder.mkdir(parents=True, exist_ok=True)
    for command in (["apt-get", "download", peer.debian], None):
        if command is None:
            package = next(folder.glob("*.deb"), None)
            if package is None:
                break
            command = ["dpkg-deb", "-x", package.name, "."]
        try:
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)
        except (OSError, subprocess.TimeoutExpired) as error:
            return f"needs {peer.library} (Debian: {peer.debian}): {error}"
        if done.returncode:
            return f"needs {peer.library} (Debian: {peer.debian}): {_reason(done.stderr)}; apt-get update may help"
    return ""


def _ask(name: str, floor: Floor, version: int, shape: str, count: int, exact: Any) -> Told | str:
    """What a peer's script tells, or why it tells nothing."""
    script = SCRIPTS / f"master_{name}.py"
    command = [str(_python(name)), str(script), str(floor.path), str(version), shape, str(count), str(STEPS)]
    env = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST, env=env)
    except subprocess.TimeoutExpired:
        return f"more than {LONGEST:g} s"
    if done.returncode:
        lines = (done.stderr.strip() or done.stdout.strip()).splitlines()
        return lines[-1][:90] if lines else f"ended with {done.returncode}, without a word"
    told = json.loads(done.stdout.splitlines()[-1])
    apart = np.nan if told["last"] is None else float(np.max(np.abs(np.array(told["last"]) - exact)))
    none = float("inf")
    return Told(told.get("plain", none), told.get("recorded", none), told["load"], apart)


def _ours(floor: Floor, shape: str, count: int, exact: Any) -> Told | str:
    made = {}
    for record in (False, True):
        one = Ours(floor.path, shape, count, record)
        if not one.prepare():
            return f"not measured: {one.why[:90]}"
        made[record] = one.stepping([one() for _ in range(9)])[0]
    return Told(made[False], made[True], float("nan"), one.apart(exact[None, :]))


def _row(name: str, told: Told | str, plain: float, recorded: float, count: int) -> str:
    if isinstance(told, str):
        return f"  {name:20}{told}"
    text = f"  {name:20}"
    for theirs, floor in ((told.plain, plain), (told.recorded, recorded)):
        shown = np.isfinite(theirs)
        text += f"{1e6 * theirs / count / STEPS:10.4f}{theirs / floor:9.1f}" if shown else f"{'-':>10}{'-':>9}"
    load = "" if np.isnan(told.load) else f"{1e3 * told.load / count:.3f}"
    apart = "" if np.isnan(told.apart) else f"{told.apart:.0e}"
    return f"{text}{load:>12}{apart:>9}"


def main() -> int:
    names = sys.argv[1:] or list(PEERS)
    unknown = [name for name in names if name not in PEERS]
    if unknown:
        print(f"there is no peer {unknown[0]!r}; there are {', '.join(PEERS)}", file=sys.stderr)
        return 2
    there = []
    for name in names:
        why = _install(name)
        installed = why or (FOLDER / f"master-{name}" / "installed").read_text(encoding="utf-8")
        print(f"{name}: {why}" if why else installed, flush=True)
        there += [] if why else [name]
    with on_one_core():
        for version in (2, 3):
            floor = Floor(version)
            for shape in SHAPES:
                for count in COUNTS:
                    _case(floor, version, shape, count, there)
    return 0


def _case(floor: Floor, version: int, shape: str, count: int, names: list[str]) -> None:
    """One table: the master by hand before each tool, the least of all its runs as the reference."""
    title = f"FMI {version}, {shape} of {count}, {STEPS} steps at {RATE} Hz"
    runs = {record: floor.runner(shape, count, record=record) for record in (False, True)}
    least = {record: float("inf") for record in runs}

    def by_hand() -> None:
        for _ in range(5):
            for record, (run, _) in runs.items():
                least[record] = min(least[record], run())

    by_hand()
    exact = runs[False][1][0]
    rows: list[tuple[str, Told | str]] = [("blocks, native", _ours(floor, shape, count, exact))]
    for name in names:
        by_hand()
        rows.append((name, _ask(name, floor, version, shape, count, exact)))
    by_hand()
    print(f"\n{title}: us for each FMU and step")
    print(f"  {'':20}{'stepping':>10}{'x C':>9}{'recorded':>10}{'x C':>9}{'load ms/FMU':>12}{'apart':>9}")
    floor_told = Told(least[False], least[True], min(floor.load(count) for _ in range(9)), 0.0)
    for name, told in [("C, by hand", floor_told), *rows]:
        print(_row(name, told, least[False], least[True], count), flush=True)


if __name__ == "__main__":
    sys.exit(main())
