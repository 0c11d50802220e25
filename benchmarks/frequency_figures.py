"""Observers and loops of ADRC over frequency and amplitude: the figures of docs/frequency.md, from the diagrams.

    python -m benchmarks.frequency_figures       # writes docs/_parts/frequency_*.html, and prints the numbers

All is computed from diagrams/analysis: the paper's motor under the linear observer of its ADRC (leso_pd), under a
linear one with the gains of the SMESO (smeso_gains_pd), and under the SMESO itself (smeso_pd).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from blocks import SMESO, Diagram
from blocks.analysis import (
    HarmonicResponse,
    Margins,
    ObserverReport,
    Response,
    SineStream,
    compare,
    estimate_response,
    margins,
    observer_report,
    response,
)
from blocks.results import plots

Array = np.ndarray[Any, Any]

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs" / "_parts"
OBSERVERS = {"leso": "leso_pd", "gains": "smeso_gains_pd", "smeso": "smeso_pd"}
AMPLITUDES = np.geomspace(1e-6, 10.0, 176)
"""Of the observer's error, in rad/s."""
IN_LOOP = (1e-3, 1e-1, 10.0)
"""Those of the figure of the loop."""
SWEPT = (0.01, 0.1, 1.0)
"""Amplitudes of y in the sweep, in rad/s."""
SWEEP = np.geomspace(0.5, 400.0, 25)
ESTIMATES = ("z1", "z2", "z3")

INK = "#010203"  # svg_text puts the page's text color there
# Colors that the style sheet of the docs makes lighter on a dark page; patterns and widths tell lines apart in grey.
LESO, GAINS, BENT = "#b45309", "#0f766e", "#1d4ed8"
DASHED, DOTTED = (0, (5, 2)), (0, (1, 1.2))
WIDTHS = (2.4, 1.5, 0.8)
SMALL = 8.5
LABELS = {
    "observers": "Over the amplitude of its error the bandwidth of the SMESO stays near that of its gains; its noise "
    "gain and its fast poles fall.",
    "loops": "Bode plot of the loop and its sensitivity, for two linear observers and the SMESO at three amplitudes.",
    "sweeps": "Simulated points lie on the lines that the describing function gives, at three amplitudes.",
}


@cache
def diagram(name: str) -> Diagram:
    return Diagram.load(ROOT / "diagrams" / "analysis" / f"{OBSERVERS[name]}.json")


# --- numbers ---------------------------------------------------------------------------------------------------


def observers(amplitudes: Array = AMPLITUDES) -> dict[str, ObserverReport]:
    """The three observers against amplitude; the linear ones at one."""
    made = {name: observer_report(diagram(name), "eso", amplitudes=[1.0]) for name in ("leso", "gains")}
    return {**made, "smeso": observer_report(diagram("smeso"), "eso", amplitudes=amplitudes)}


@dataclass(frozen=True)
class Loop:
    """L at the motor's input over omega, with its margins."""

    value: Array
    known: Margins


def loops(omega: Array) -> dict[str | float, Loop]:
    """Of the linear observers by name, of the SMESO by amplitude."""
    made: dict[str | float, Any] = {name: diagram(name).linearizer() for name in ("leso", "gains")}
    for A in IN_LOOP:
        made[A] = diagram("smeso").linearizer(amplitude={"eso.e": A})
    transfers = {key: linearizer.loop("control.u") for key, linearizer in made.items()}
    return {key: Loop(response(L, omega)[0, 0], margins(L)) for key, L in transfers.items()}


@dataclass(frozen=True)
class Sweep:
    """From y to the estimates at one amplitude of y: simulated at points, predicted there and along a line.

    linear, linear_along: with g(e) = e, (estimates, frequencies).
    """

    measured: Response
    predicted: HarmonicResponse
    along: HarmonicResponse
    linear: Array
    linear_along: Array


def alone() -> Diagram:
    """The observer of the diagram, by itself."""
    given = diagram("smeso").value.blocks["eso"].parameters
    return Diagram.alone(SMESO(**{key: given[key] for key in ("Ka", "alpha", "Kb", "beta", "gains")}))


def sweeps(omega: Array = SWEEP) -> dict[float, Sweep]:
    line = np.geomspace(omega[0], omega[-1], 151)
    cut, estimates = ["eso.y", "eso.u"], [f"eso.{z}" for z in ESTIMATES]
    without = diagram("gains").linearizer()
    linear = [without.response("eso.y", estimates, w, openings=cut)[:, 0] for w in (omega, line)]
    made, observer = {}, alone()
    linearizer = observer.linearizer()
    for A in SWEPT:
        measured = estimate_response(observer, "y", ESTIMATES, SineStream(omega, A), inputs={"u": 0.0})
        predicted, along = (linearizer.harmonic_response("y", ESTIMATES, w, amplitude=A) for w in (omega, line))
        made[A] = Sweep(measured, predicted, along, *linear)
    return made


# --- figures ---------------------------------------------------------------------------------------------------


def panels(ratios: tuple[float, ...], height: float) -> tuple[Any, list[Any]]:
    """A figure of axes above each other over one logarithmic axis."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(7.2, height), layout="constrained")
    drawn.patch.set_alpha(0.0)
    axes = list(drawn.subplots(len(ratios), 1, sharex=True, height_ratios=ratios))
    for axis in axes:
        axis.set_xscale("log")
        axis.set_facecolor("none")
        axis.grid(True, color="#94a3b8", alpha=0.35, linewidth=0.5)
        axis.tick_params(colors=INK, which="both", labelsize=9)
        for spine in axis.spines.values():
            spine.set_color(INK)
            spine.set_linewidth(0.8)
    return drawn, axes


def label(axis: Any, x: float, y: float, text: str, *, shift: tuple[float, float] = (0, 5), ha: str = "left") -> None:
    """A word at a line, in the page's ink."""
    axis.annotate(
        text, (x, y), xytext=shift, textcoords="offset points", fontsize=SMALL, color=INK, ha=ha, va="center",
        annotation_clip=False,
    )  # fmt: skip


def titled(axis: Any, text: str) -> None:
    axis.set_title(text, fontsize=9.5, loc="left", color=INK)


def figure_of_observers(made: Mapping[str, ObserverReport]) -> Any:
    """Bandwidth, noise gain and poles against the amplitude of the error."""
    from matplotlib.ticker import NullLocator

    drawn, (width, noise, pole) = panels((1.0, 1.0, 1.25), 7.2)
    smeso = made["smeso"].rows
    A = np.array([row.amplitude for row in smeso])
    figures = {name: [(row.bandwidth_f or np.nan, row.noise_h2) for row in one.rows] for name, one in made.items()}
    for k, axis in enumerate((width, noise)):
        axis.axhline(figures["leso"][0][k], color=LESO, linestyle=DASHED, linewidth=1.5)
        axis.axhline(figures["gains"][0][k], color=GAINS, linestyle=DOTTED, linewidth=1.8)
        axis.plot(A, [row[k] for row in figures["smeso"]], color=BENT, linewidth=1.8)
    titled(width, "bandwidth from the disturbance f to z3 [rad/s]")
    titled(noise, "noise gain from y to z3 (H2 norm)")
    titled(pole, "size of the poles [1/s]")
    width.set_ylim(0, 11.5)
    noise.set_ylim(0, 560)
    left, right = 1.3e-6, 8.0
    ends = [figures["smeso"][0][0], figures["smeso"][-1][0]]
    label(width, left, figures["leso"][0][0], f"LESO: {figures['leso'][0][0]:.2f}", shift=(0, -9))
    label(width, left, ends[0], f"SMESO: {ends[0]:.2f} to {ends[1]:.2f}", shift=(0, -9))
    label(width, right, ends[1], f"gains of the SMESO, linear: {figures['gains'][0][0]:.2f}", shift=(0, 10), ha="right")
    label(noise, right, figures["leso"][0][1], f"LESO: {figures['leso'][0][1]:.0f}", shift=(0, 9), ha="right")
    label(noise, 1e-3, float(np.interp(-3, np.log10(A), [row[1] for row in figures["smeso"]])), "SMESO", shift=(4, 11))
    label(
        noise, left, figures["gains"][0][1], f"gains of the SMESO, linear: {figures['gains'][0][1]:.0f}", shift=(0, -9)
    )

    for name, color, pattern in (("leso", LESO, DASHED), ("gains", GAINS, DOTTED)):
        for size in sorted({round(abs(p), 9) for p in made[name].rows[0].poles}):
            pole.axhline(size, color=color, linestyle=pattern, linewidth=1.5)
    sizes = np.sort([np.abs(row.poles) for row in smeso], axis=1)
    is_pair = np.array([abs(row.poles[-1].imag) > 0 for row in smeso])
    for k in range(3):
        pole.plot(A, sizes[:, k], color=BENT, linewidth=1.8)
    pole.set_yscale("log")
    pole.set_ylim(2.4, 230)
    pole.set_yticks([3, 10, 30, 100], ["3", "10", "30", "100"])
    pole.yaxis.set_minor_locator(NullLocator())
    meet = int(np.argmax(is_pair))
    label(pole, A[meet], sizes[meet, 2], "a complex pair", shift=(8, 9))
    label(pole, 1e-5, float(np.interp(-5, np.log10(A), sizes[:, 2])), "two real poles", shift=(8, 7))
    label(pole, left, sizes[0, 0], "the slow pole of the SMESO makes its bandwidth", shift=(0, -9))
    label(pole, right, abs(made["leso"].rows[0].poles[0]), "LESO", shift=(0, -8), ha="right")
    pole.set_xlabel("amplitude of the error e = y - z1 [rad/s]", color=INK)
    pole.set_xlim(A[0], A[-1])
    pole.xaxis.set_minor_locator(NullLocator())
    return drawn


def figure_of_loops(omega: Array, made: Mapping[str | float, Loop]) -> Any:
    """Gain and phase of L, and |S|."""
    drawn, (gain, phase, sensitivity) = panels((1.1, 1.0, 1.0), 7.4)
    styles: dict[str | float, tuple[str, Any, float]] = {"leso": (LESO, DASHED, 1.6), "gains": (GAINS, DOTTED, 1.9)}
    styles |= {A: (BENT, "-", width) for A, width in zip(IN_LOOP, WIDTHS, strict=True)}
    names: dict[str | float, str] = {"leso": "LESO", "gains": "gains of the SMESO, linear"}
    names |= {A: f"SMESO, A = {A:g} rad/s" for A in IN_LOOP}
    for key, (color, pattern, width) in styles.items():
        L = made[key].value
        look = {"color": color, "linestyle": pattern, "linewidth": width}
        gain.plot(omega, 20 * np.log10(np.abs(L)), label=names[key], **look)
        phase.plot(omega, np.degrees(np.unwrap(np.angle(L))), **look)
        sensitivity.plot(omega, 20 * np.log10(np.abs(1 / (1 + L))), **look)
    titled(gain, "gain of the loop L [dB]")
    titled(phase, "phase of L [deg]")
    titled(sensitivity, "sensitivity |S| = 1/|1 + L| [dB]")
    for axis, y in ((gain, 0.0), (phase, -180.0), (sensitivity, 0.0)):
        axis.axhline(y, color=INK, linewidth=0.7)
    gain.set_ylim(-32, 40)
    phase.set_ylim(-245, -65)
    phase.set_yticks([-225, -180, -135, -90])
    sensitivity.set_ylim(-36, 10)
    gain.legend(fontsize=SMALL, frameon=False, loc="upper right", labelcolor=INK, handlelength=3)
    frequencies(sensitivity, omega)
    return drawn


def figure_of_sweeps(made: Mapping[float, Sweep]) -> Any:
    """From y to z3: the gain, and what the law changes of gain and phase; lines predicted, points simulated."""
    from matplotlib.lines import Line2D

    drawn, (gain, more, lead) = panels((1.2, 1.0, 1.0), 7.4)
    k = ESTIMATES.index("z3")
    handles = []
    for (A, sweep), width, mark in zip(made.items(), WIDTHS, ("o", "s", "^"), strict=True):
        look: dict[str, Any] = {"color": BENT, "linewidth": width}
        # The page's ink: on a dark page the style sheet does not reach markers, which are drawn by reference.
        points: dict[str, Any] = {
            "marker": mark,
            "color": INK,
            "fillstyle": "none",
            "markersize": 4.5,
            "linestyle": "none",
        }
        for axis, of in ((gain, _gain), (more, _gain), (lead, _lead)):
            for omega, value, base, style in (
                (sweep.along.omega, sweep.along.value[k], sweep.linear_along[k], look),
                (sweep.measured.omega, sweep.measured.value[k], sweep.linear[k], points),
            ):
                axis.plot(omega, of(value if axis is gain else value / base), **style)
        handles.append(Line2D([], [], **{**look, **points, "linestyle": "-", "color": BENT}, label=f"A = {A:g} rad/s"))
        handles[-1].set_markeredgecolor(INK)
    one = next(iter(made.values()))
    gain.plot(one.along.omega, _gain(one.linear_along[k]), color=GAINS, linestyle=DOTTED, linewidth=1.8)
    for axis in (more, lead):
        axis.axhline(0.0, color=GAINS, linestyle=DOTTED, linewidth=1.8)
    handles.append(Line2D([], [], color=GAINS, linestyle=DOTTED, linewidth=1.8, label="linear: g(e) = e"))
    titled(gain, "gain from y to z3 [dB]: lines predicted, points simulated")
    titled(more, "beyond the linear model [dB]")
    titled(lead, "beyond the linear model [deg]")
    gain.legend(handles=handles, fontsize=SMALL, frameon=False, loc="lower center", labelcolor=INK, handlelength=3.2)
    frequencies(lead, one.along.omega)
    return drawn


def _gain(value: Array) -> Array:
    return np.asarray(20.0 * np.log10(np.abs(value)))


def _lead(value: Array) -> Array:
    return np.asarray(np.degrees(np.angle(value)))


def frequencies(axis: Any, omega: Array) -> None:
    """The axis below all panels."""
    from matplotlib.ticker import FuncFormatter

    axis.set_xlim(omega[0] / 1.03, omega[-1] * 1.03)
    axis.xaxis.set_major_formatter(FuncFormatter(lambda w, _: f"{w:g}"))
    axis.set_xlabel("frequency [rad/s]", color=INK)


def written(drawn: Any, name: str, told: str) -> None:
    """The figure as a part of a page."""
    text = plots.svg_text(drawn).replace("<svg ", f'<svg role="img" aria-label="{told}" ', 1)
    path = FOLDER / f"frequency_{name}.html"
    path.write_text(f'<figure class="plot">\n{text.strip()}\n</figure>\n', encoding="utf-8")


def main() -> None:
    seen = observers()
    print("observer   amplitude     f -> z3    y -> z3  sizes of the poles")
    for name, one in seen.items():
        for row in one.rows[:: max(1, len(one.rows) // 7)]:
            sizes = "  ".join(f"{abs(p):.4f}" for p in row.poles)
            print(f"{name:9} {row.amplitude:10.4g} {row.bandwidth_f:11.6f} {row.noise_h2:10.4f}  {sizes}")
    omega = np.geomspace(1.0, 200.0, 201)
    opened = loops(omega)
    print("loop       gain margin  phase margin  crossover     Ms     Mt")
    for key, loop in opened.items():
        known = loop.known
        at = f"{known.phase_deg:13.3f} {known.crossover:10.3f}"
        print(f"{key!s:9} {known.gain:12.4f} {at} {known.Ms:6.3f} {known.Mt:6.3f}")
    swept = sweeps()
    print("sweep      describing function: dB, deg      linear model: dB      distortion of z3")
    for A, sweep in swept.items():
        close, far = compare(sweep.measured, sweep.predicted), sweep.measured.value / sweep.linear
        beyond = np.max(np.abs(_gain(far)))
        worst = np.max(sweep.measured.distortion[-1])
        print(f"{A:<9g} {close.worst_decibels:16.4f} {close.worst_degrees:8.4f} {beyond:21.3f} {worst:20.4f}")
    written(figure_of_observers(seen), "observers", LABELS["observers"])
    written(figure_of_loops(omega, opened), "loops", LABELS["loops"])
    written(figure_of_sweeps(swept), "sweeps", LABELS["sweeps"])


if __name__ == "__main__":
    main()
