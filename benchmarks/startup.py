"""What a user waits for: `import blocks`, a word that is no command, from file to first result, building in Python.

`python -m benchmarks.startup BASE` measures another checkout too, in turns, and prints ratios. Python may keep its
bytecode, as it does where nobody forbids it. Compiled code of the diagrams is in the cache.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FMUS = """
from blocks import Diagram, fmu
many = Diagram("many")
for k in range(50):
    many.add(f"motor{k}", fmu("fmus/PMDCMotor.fmu", "CS"))
many.run(stop=0.01)
"""
LOOP = ("-m", "blocks", "linearize", "diagrams/analysis/leso_pd.json", "--loop")
ROWS: tuple[tuple[str, tuple[str, ...], float | None], ...] = (
    ("python -c pass", ("-c", "pass"), None),
    ("import blocks", ("-c", "import blocks"), 0.3),
    ("from blocks import Diagram", ("-c", "from blocks import Diagram"), None),
    ("blocks --help", ("-m", "blocks", "--help"), 0.5),
    ("blocks nonsense", ("-m", "blocks", "nonsense"), 0.1),
    ("blocks run bouncing_ball.json", ("-m", "blocks", "run", "diagrams/bouncing_ball.json"), None),
    ("blocks run paper/iadrc.json", ("-m", "blocks", "run", "diagrams/paper/iadrc.json"), 0.25),
    ("blocks linearize --loop control.u", (*LOOP, "control.u"), 0.5),
    ("... --loop contrl.u, refused", (*LOOP, "contrl.u"), 0.3),
    ("blocks study paper/study.json", ("-m", "blocks", "study", "diagrams/paper/study.json"), 2.0),
    ("50 FMUs of one file, with imports", ("-c", FMUS), None),
)


def seconds(root: Path, arguments: Sequence[str], folder: Path) -> tuple[float, float]:
    """The wall time and the CPU time of a Python program in s. folder: for bytecode and what is written."""
    surroundings = {name: text for name, text in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    surroundings |= {"PYTHONPATH": str(root), "PYTHONPYCACHEPREFIX": str(folder / "bytecode")}
    more = ("--out", str(folder / "study")) if "study" in arguments else ()
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, *arguments, *more], check=False, capture_output=True, cwd=root, env=surroundings)
    wall, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


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


def main(base: Path | None = None, rounds: int = 7) -> None:
    places = [ROOT] if base is None else [base.resolve(), ROOT]
    print(f"{'':36}{'s':>8}{'CPU s':>8}" + ("" if base is None else f"{'before':>10}{'CPU':>8}{'ratio':>8}") + "  goal")
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        for label, arguments, goal in ROWS:
            least = dict.fromkeys(places, (9000000000.0, 9000000000.0))
            for turn in range(1 + (rounds if label.split()[1] != "study" else 3)):
                for place in places:
                    known, new = least[place], seconds(place, arguments, folder)
                    if turn:  # the first one compiles
                        least[place] = min(known[0], new[0]), min(known[1], new[1])
            wall, cpu = least[ROOT]
            line = f"{label:36}{wall:8.3f}{cpu:8.3f}"
            if base is not None:
                before = least[places[0]]
                line += f"{before[0]:10.3f}{before[1]:8.3f}{cpu / before[1]:8.2f}"
            print(line + (f"  {goal} s" if goal else ""), flush=True)
    chains: dict[str, Callable[[int], float]] = {"alike": lambda _: 1.0, "of own values": lambda k: 1.0 + k / 1e6}
    for label, values in chains.items():
        made = [built(values) for _ in range(7)]
        block, whole = min(made)[0], min(whole for _, whole in made)
        print(f"600 gains {label:23} {block * 1e3:.3f} ms a block (goal 0.05), {whole:.3f} s with run(stop=0)")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
