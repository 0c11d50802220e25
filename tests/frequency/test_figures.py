"""Figures over frequency: what is drawn is what was computed, and nothing global is touched."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import control
import matplotlib.image
import numpy as np
import pytest

from blocks.analysis.responses import Response
from blocks.frequency.figures import bode, gang_of_four, nichols, nyquist, pole_map, sigma, step_figure
from blocks.frequency.margins import margins
from blocks.results.plots import STYLES, save, svg_text
from blocks.text.errors import AnalysisError, UsageError

MARK = STYLES[1][0]


def plant() -> Any:
    return control.ss([[0.0, 1.0], [-6.51, -1.615]], [[0.0], [1.755]], [[1.0, 0.0]], 0, name="motor")


def controller() -> Any:
    """PID with a filter."""
    return control.ss([[0.0, 0.0], [0.0, -60.0]], [[20.0], [-300.0]], [[1.0, 1.0]], [[25.0]])


def loop() -> Any:
    return plant() * controller()


def lines(axis: Any) -> dict[str, Any]:
    return {line.get_label(): line for line in axis.get_lines()}


def texts(figure: Any) -> list[str]:
    return [text.get_text() for axis in figure.axes for text in axis.texts]


def curve(axis: Any) -> Any:
    """The longest line of the first style."""
    return max(
        (one for one in axis.get_lines() if one.get_color() == STYLES[0][0]), key=lambda one: len(one.get_xdata())
    )


def test_a_bode_figure_shows_the_response_and_its_margins() -> None:
    system = loop()
    figure = bode(system)
    above, below = figure.axes
    w = curve(above).get_xdata()
    assert curve(above).get_ydata() == pytest.approx(20 * np.log10(np.abs(system(1j * w))), abs=1e-9)
    turned = np.exp(1j * np.radians(curve(below).get_ydata()))
    assert turned == pytest.approx(np.exp(1j * np.angle(system(1j * w))), abs=1e-9)
    assert np.max(np.abs(np.diff(curve(below).get_ydata()))) < 20
    found = margins(system)
    assert f"phase margin {found.phase_deg:.3g}°" in texts(figure)
    assert (above.get_xscale(), above.get_ylabel(), below.get_ylabel()) == ("log", "gain [dB]", "phase [deg]")
    assert below.get_xlabel() == "frequency [rad/s]"
    ends = [line.get_ydata() for line in below.get_lines() if line.get_color() == MARK and len(line.get_xdata()) == 2]
    assert any(abs(y[1] - y[0]) == pytest.approx(found.phase_deg, rel=1e-3) for y in ends)
    assert texts(bode(system, margins=False)) == []


def test_phases_begin_where_the_slope_at_the_low_end_says() -> None:
    for system, first, last in (
        (control.tf([1], [1, 0, 0]), -180, -180),
        (control.tf([1], [1, 0, 0, 0]), -270, -270),
        (control.tf([1, 0], [1, 1]), 90, 0),
        (control.tf([-1], [1, 1]), -180, -270),
        (control.tf([1], [1, 0, 1]) * control.tf([1], [1, 1]), 0, -270),
        (control.tf([1, 0, 1], [1, 3, 3, 1]), 0, -90),
        (control.tf([3, 3], [1, -1, 0]), -270, -90),
    ):
        phase = curve(bode(system, np.geomspace(1e-4, 1e4, 2), margins=False).axes[1]).get_ydata()
        assert phase[0] == pytest.approx(first, abs=0.1)
        assert phase[-1] == pytest.approx(last, abs=0.1)


def test_several_systems_are_told_apart_by_name_color_and_pattern() -> None:
    other = control.ss(0.5 * plant(), name="weaker")
    figure = bode([plant(), other])
    shown = lines(figure.axes[0])
    assert shown["motor"].get_color() == "#b45309"
    assert shown["motor"].get_linestyle() == "-"
    assert shown["weaker"].get_color() == "#1d4ed8"
    assert shown["weaker"].is_dashed()
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == ["motor", "weaker"]
    assert bode({"one": plant()}, margins=False).axes[0].get_title(loc="left") == "one"


def test_measured_points_lie_upon_the_lines() -> None:
    omega = np.geomspace(0.5, 50, 9)
    data = control.frd(plant(), omega)
    for figure in (bode({"model": plant(), "sweep": data}), sigma({"model": plant(), "sweep": data})):
        points = lines(figure.axes[0])["sweep"]
        assert points.get_linestyle() == "None"
        assert points.get_marker() == "o"
        assert points.get_xdata() == pytest.approx(omega)
        assert points.get_ydata() == pytest.approx(20 * np.log10(np.abs(plant()(1j * omega))))
    nyquist({"model": plant(), "sweep": data})
    nichols({"model": plant(), "sweep": data})


def test_a_sampled_response_ends_at_the_nyquist_frequency() -> None:
    period = 0.02
    figure = bode(control.c2d(loop(), period))
    assert curve(figure.axes[0]).get_xdata()[-1] == pytest.approx(math.pi / period)


def test_a_nyquist_figure_has_the_curve_its_mirror_and_the_circle_of_ms() -> None:
    system = loop()
    figure = nyquist(system)
    (axis,) = figure.axes
    found = margins(system)
    assert f"$M_s$ = {found.Ms:.4g}" in texts(figure)
    circle = next(one for one in axis.get_lines() if one.get_color() == MARK and len(one.get_xdata()) == 361)
    distance = np.abs(circle.get_xdata() + 1j * circle.get_ydata() + 1)
    assert distance == pytest.approx(np.full(361, found.modulus))
    values = curve(axis).get_xdata() + 1j * curve(axis).get_ydata()
    assert np.min(np.abs(1 + values)) >= found.modulus * (1 - 1e-12)
    assert np.min(np.abs(1 + values)) == pytest.approx(found.modulus, rel=1e-2)
    low, high = axis.get_xlim()
    assert low < -1 < 1 < high
    assert axis.get_aspect() == 1.0


def test_an_unstable_loop_is_called_so_in_its_figures() -> None:
    system = control.tf([10], [1, 3, 3, 1])
    for figure in (bode(system), nyquist(system), nichols(system)):
        assert figure.axes[0].get_title(loc="right") == "closed loop unstable"


def test_a_nichols_chart_has_the_curves_of_constant_t() -> None:
    figure = nichols(loop())
    (axis,) = figure.axes
    assert "6 dB" in texts(figure)
    contours = [one for one in axis.get_lines() if len(one.get_xdata()) == 721]
    for one in contours:
        values = 10 ** (one.get_ydata() / 20) * np.exp(1j * np.radians(one.get_xdata()))
        total = np.abs(values / (1 + values))
        assert total == pytest.approx(np.full(721, total[360]), rel=1e-9)


def test_singular_values_are_those_of_the_response() -> None:
    random = np.random.default_rng(1)
    system = control.ss(
        -np.diag([1.0, 3.0, 10.0]), random.normal(size=(3, 2)), random.normal(size=(2, 3)), np.zeros((2, 2))
    )
    (axis,) = sigma({"G": system}).axes
    shown = [one for one in axis.get_lines() if len(one.get_xdata()) > 10]
    w = shown[0].get_xdata()
    values = np.linalg.svd(np.moveaxis(np.asarray(system(1j * w)), 2, 0), compute_uv=False)
    for one, column in zip(shown, (0, 1), strict=True):
        assert one.get_ydata() == pytest.approx(20 * np.log10(values[:, column]), abs=1e-8)


def test_the_gang_of_four_names_its_peaks() -> None:
    figure = gang_of_four(plant(), controller())
    found = margins(loop())
    assert [axis.get_title(loc="left")[:2].strip() for axis in figure.axes] == ["S", "T", "PS", "CS"]
    assert f"{found.Ms:.4g} at {found.Ms_frequency:.4g} rad/s" in texts(figure)
    assert f"{found.Mt:.4g} at {found.Mt_frequency:.4g} rad/s" in texts(figure)
    with pytest.raises(UsageError, match="different periods"):
        gang_of_four(plant(), control.c2d(controller(), 0.1))
    with pytest.raises(UsageError, match="give models"):
        gang_of_four(plant(), control.frd(controller(), np.array([1.0, 2.0])))


def test_a_pole_map_shows_poles_zeros_and_the_border() -> None:
    closed = control.feedback(loop(), 1)
    shown = lines(pole_map({"T": closed}).axes[0])
    crosses = shown["T: poles"].get_xdata() + 1j * shown["T: poles"].get_ydata()
    assert np.sort_complex(crosses) == pytest.approx(np.sort_complex(np.linalg.eigvals(closed.A)))
    assert len(shown["T: zeros"].get_xdata()) == 2
    sampled = pole_map(control.c2d(closed, 0.05)).axes[0]
    assert any(len(one.get_xdata()) == 361 for one in sampled.get_lines())
    with pytest.raises(UsageError, match="cannot share a plane"):
        pole_map([closed, control.c2d(closed, 0.05)])


def test_a_step_is_exact() -> None:
    lag = control.ss([[-2.0]], [[1.0]], [[3.0]], 0)
    line = curve(step_figure(lag).axes[0])
    t = line.get_xdata()
    assert line.get_ydata() == pytest.approx(1.5 * (1 - np.exp(-2 * t)), abs=1e-12)
    sampled = control.ss([[0.5]], [[1.0]], [[1.0]], 0, 0.1)
    line = curve(step_figure({"one": sampled}, until=1.0).axes[0])
    assert line.get_drawstyle() == "steps-post"
    assert line.get_ydata() == pytest.approx(2 * (1 - 0.5 ** np.arange(11)))
    second = control.tf([1], [1, 0.4, 1])
    over = math.exp(-0.2 * math.pi / math.sqrt(1 - 0.04))
    assert any(text.startswith(f"{100 * over:.3g} % over") for text in texts(step_figure(second)))
    with pytest.raises(AnalysisError, match="no exact step"):
        step_figure(control.frd(lag, np.array([1.0, 2.0])))
    with pytest.raises(UsageError, match="positive time"):
        step_figure(lag, until=0.0)


class Delayed:
    dt = 0

    def response(self, omega: Any) -> Any:
        with np.errstate(all="ignore"):
            return 2 * np.exp(-0.3j * omega) / (1j * omega)


def test_an_exact_delay_is_drawn() -> None:
    figure = bode(Delayed())
    assert any(text.startswith("gain margin 2.618") for text in texts(figure))
    nyquist(Delayed())
    nichols(Delayed())


def test_what_cannot_be_drawn_is_refused() -> None:
    many = control.ss([[-1.0]], [[1.0, 2.0]], [[1.0]], [[0.0, 0.0]])
    with pytest.raises(UsageError, match=r"E501 bode: .* 1 outputs and 2 inputs\. Choose a channel"):
        bode(many)
    with pytest.raises(UsageError, match="cannot be distinguished"):
        sigma([plant()] * 7)
    with pytest.raises(UsageError, match="cannot be distinguished"):
        bode([])
    with pytest.raises(UsageError, match="positive numbers, in rad/s"):
        bode(plant(), [0.0, 1.0])


def test_names_in_a_figure_are_text_and_settings_from_outside_change_nothing() -> None:
    import matplotlib

    plain = svg_text(bode({"plant": plant()}))
    with matplotlib.rc_context({"font.size": 30.0, "text.usetex": True, "axes.edgecolor": "red"}):
        assert svg_text(bode({"plant": plant()})) == plain
    for figure in (bode, step_figure, pole_map):
        text = svg_text(figure({"_a $\\frac{x$": plant(), "b": plant()})).replace("\u200b", "")
        assert ">_a $\\frac{x$" in text


def test_figures_are_written_and_leave_no_global_state(tmp_path: Path) -> None:
    import matplotlib

    before = dict(matplotlib.rcParams)
    figure = bode(loop())
    assert svg_text(figure).count("currentColor") > 10
    save(figure, tmp_path / "bode.png")
    save(nyquist(loop()), tmp_path / "nyquist.svg")
    assert (tmp_path / "bode.png").stat().st_size > 10_000
    assert dict(matplotlib.rcParams) == before
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or not pyplot.get_fignums()


def test_a_response_that_was_measured_is_drawn_over_a_model_on_white(tmp_path: Path) -> None:
    n = np.ones(3)
    value = np.array([[1.0, 0.5, 0.1j]])
    measured = Response("d", "u", ("y",), np.array([3.0, 1.0, 2.0]), value, n, n, n, n, n, n, n, "sine stream")
    figure = bode([measured, plant()], margins=False)
    points = next(line for line in figure.axes[0].lines if line.get_linestyle() == "None")
    assert points.get_xdata().tolist() == [1.0, 2.0, 3.0]
    assert points.get_ydata() == pytest.approx([20 * np.log10(0.5), -20.0, 0.0])
    figure.savefig(tmp_path / "a.png")
    corner = matplotlib.image.imread(tmp_path / "a.png")[0, 0]
    assert corner.tolist() == [1.0, 1.0, 1.0, 1.0]
    assert figure.patch.get_alpha() == 0.0


FIGURES: dict[str, Any] = {
    "bode": lambda **look: bode(two_gain_margins(), **look),
    "nyquist": lambda **look: nyquist(loop(), **look),
    "nichols": lambda **look: nichols(loop(), **look),
    "sigma": lambda **look: sigma(loop(), **look),
    "gang_of_four": lambda **look: gang_of_four(plant(), controller(), **look),
    "pole_map": lambda **look: pole_map(loop(), **look),
    "step_figure": lambda **look: step_figure(control.feedback(loop()), **look),
}


def two_gain_margins() -> Any:
    """A double integrator, unstable, with a gain margin to either side."""
    lags = control.tf([1], [1, -1]) * control.tf([1], [0.02, 1]) * control.tf([1], [0.01, 1])
    return control.tf([60, 150, 100], [1, 0, 0]) * lags


@pytest.mark.parametrize("name", FIGURES)
def test_each_figure_takes_the_words_of_the_look(name: str) -> None:
    figure = FIGURES[name](size=(3.5, 3.0), title="over all", xlim=(0.5, 2.0))
    assert figure.get_size_inches().tolist() == [3.5, 3.0]
    assert figure._suptitle.get_text() == "over all"
    assert figure.axes[0].get_xlim() == (0.5, 2.0)
    figure.draw_without_rendering()
    for axis in figure.axes:
        label = axis.yaxis.label.get_window_extent()
        assert label.y0 >= -0.5
        assert label.y1 <= figure.bbox.y1
    for wrong in ({"size": (0.0, 3.0)}, {"colour": "red"}, {"ylim": [(0, 1)] * 9}):
        with pytest.raises(UsageError, match="E501 plot"):
            FIGURES[name](**wrong)


@pytest.mark.parametrize("size", [(3.5, 3.0), (3.5, 4.0), (6.2, 4.6)])
def test_labels_of_margins_lie_in_the_axes_and_not_over_each_other(size: tuple[float, float]) -> None:
    figure = bode(two_gain_margins(), size=size)
    figure.draw_without_rendering()
    for axis in figure.axes:
        boxes = [text.get_window_extent() for text in axis.texts]
        whole = axis.get_window_extent()
        for k, box in enumerate(boxes):
            assert whole.x0 <= box.x0
            assert box.x1 <= whole.x1
            assert not any(box.overlaps(other) for other in boxes[:k])
    assert sum(len(axis.texts) for axis in figure.axes) == 3
