"""The error of co-simulation against the communication step, for each algorithm: the figure of docs/cosimulation.md.

    python -m benchmarks.coupling_error          # writes docs/_parts/coupling_error.html, and prints the numbers

Two masses on springs, coupled by displacement and force, each solved to 1e-10 and coupled with the other only at
communication points. The error is the largest of the four states at t = 10 s, against the exponential of the matrix.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.linalg import expm

from blocks import Diagram
from blocks.results import plots
from tests.support.coupled_systems import Displaced, Forced

ALGORITHMS = {"jacobi": "#1d4ed8", "gauss-seidel": "#b45309", "iterated": "#0f766e"}
"""Colors that the style sheet of the docs makes lighter on a dark page."""
STYLES = {0: "-", 1: (0, (5, 2)), 2: (0, (1, 1.2))}
STEPS = (0.2, 0.1, 0.05, 0.025, 0.0125)
NAMES = ("a.x", "a.v", "b.x", "b.v")
PATH = Path(__file__).resolve().parent.parent / "docs" / "_parts" / "coupling_error.html"
LABEL = "Log-log plot: the error falls with the first, second and third power of the step for orders 0, 1 and 2."


def two_masses() -> Diagram:
    made = Diagram("two")
    a, b = made.add("a", Displaced()), made.add("b", Forced())
    made.wire(a.F, b.F)
    made.wire(b.x1, a.x)
    made.wire(b.v1, a.v)
    return made


def error(step: float, algorithm: str, order: int) -> float:
    """The largest error of the states at t = 10 s."""
    matrix = np.array([[0, 1, 0, 0], [-2, -0.2, 1, 0.1], [0, 0, 0, 1], [1, 0.1, -2, -0.2]])
    exact = expm(10 * matrix) @ [1, 0, 0, 0]
    master = {"step": step, "algorithm": algorithm, "order": order, "couple": "each"}
    results = two_masses().run(stop=10, rtol=1e-10, atol=1e-12, master=master)
    return float(np.max(np.abs([results[name][-1] for name in NAMES] - exact)))


def errors() -> dict[tuple[str, int], list[float]]:
    return {
        (algorithm, order): [error(step, algorithm, order) for step in STEPS]
        for algorithm in ALGORITHMS
        for order in STYLES
    }


def figure(made: dict[tuple[str, int], list[float]]) -> str:
    """An SVG with a line for each algorithm (by color) and order (by pattern)."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    ink = "#010203"  # svg_text puts the page's text color there
    drawn = Figure(figsize=(7.2, 4.6), layout="constrained")
    drawn.patch.set_alpha(0.0)
    axis = drawn.subplots()
    axis.set_facecolor("none")
    for (algorithm, order), values in made.items():
        axis.loglog(STEPS, values, color=ALGORITHMS[algorithm], linestyle=STYLES[order], linewidth=1.6)
    axis.set_xlabel("communication step H [s]", color=ink)
    axis.set_ylabel("largest error at t = 10 s", color=ink)
    axis.set_xticks(STEPS, [f"{step:g}" for step in STEPS])
    axis.minorticks_off()
    axis.tick_params(colors=ink, which="both")
    axis.grid(True, color="#94a3b8", alpha=0.35, linewidth=0.5)
    for spine in axis.spines.values():
        spine.set_color(ink)
    handles = [Line2D([], [], color=color, label=name) for name, color in ALGORITHMS.items()]
    held = ("inputs are held: order 0", "follow lines: order 1", "follow parabolas: order 2")
    handles += [Line2D([], [], color=ink, linestyle=STYLES[k], label=name) for k, name in enumerate(held)]
    axis.legend(handles=handles, fontsize=9, frameon=False, loc="lower right", labelcolor=ink)
    return plots.svg_text(drawn).replace("<svg ", f'<svg role="img" aria-label="{LABEL}" ', 1)


def main() -> None:
    made = errors()
    for (algorithm, order), values in made.items():
        print(f"{algorithm:13} {order}  ", "  ".join(f"{value:.3e}" for value in values))
    PATH.write_text(f'<figure class="plot">\n{figure(made).strip()}\n</figure>\n', encoding="utf-8")


if __name__ == "__main__":
    main()
