"""What a user waits for: `import blocks`, `blocks --help`, from file to first result, building in Python."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
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


def built(values: Callable[[int], float], count: int = 600) -> tuple[float, float]:
    """Seconds of the processor for a block and its wire in a chain made in Python, and for its first run in whole."""
    from blocks import Diagram, Gain

    diagram = Diagram("chain")
    begun = time.process_time()
    port = diagram.input("u", default=1.0)
    for index in range(count):
        gain = diagram.add(f"gain{index}", Gain(k=values(index)))
        diagram.wire(gain.u, port)
        port = gain.y
    building = time.process_time() - begun
    diagram.run(stop=0, engine="reference")
    return building / count, time.process_time() - begun


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
    chains: dict[str, Callable[[int], float]] = {"alike": lambda _: 1.0, "of own values": lambda k: 1.0 + k / 1e6}
    for label, values in chains.items():
        made = [built(values) for _ in range(7)]
        block, whole = min(made)[0], min(whole for _, whole in made)
        print(f"600 gains {label:23} {block * 1e3:.3f} ms a block (goal 0.05), {whole:.3f} s with run(stop=0)")
