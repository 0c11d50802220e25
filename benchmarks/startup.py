"""What a user waits for: `import blocks`, `blocks --help`, from file to first result."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def best(command: list[str], repeats: int = 7) -> float:
    """The shortest wall time of a command in s."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, cwd=ROOT)
        times.append(time.perf_counter() - begun)
    return min(times)


def main() -> None:
    python = sys.executable
    bare = best([python, "-c", "pass"])
    print(f"python -c pass                    {bare:.3f} s")
    for label, command, limit in (
        ("import blocks", ["-c", "import blocks"], 0.3),
        ("from blocks import Diagram", ["-c", "from blocks import Diagram"], None),
        ("blocks --help", ["-m", "blocks", "--help"], 0.5),
        ("blocks run bouncing_ball.json", ["-m", "blocks", "run", "diagrams/bouncing_ball.json"], None),
    ):
        seconds = best([python, *command])
        goal = f"(goal {limit} s)" if limit else ""
        print(f"{label:33} {seconds:.3f} s, {seconds - bare:.3f} s beyond Python  {goal}")
