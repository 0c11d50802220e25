"""Where something can be put in, cut or read: outputs of subdiagrams, signals that are only passed on, many names."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from blocks import Demux, Diagram, Gain, Integrator, LookupTable, Mux, RateLimiter, Sum
from blocks.analysis import margins
from blocks.cli import main
from blocks.text.errors import AnalysisError, UsageError
from tests.support.places import ROOT

FOLDER = ROOT / "diagrams"


def plant_with_an_inner_loop() -> Diagram:
    """1/(s + 2), of an integrator with its feedback inside of P, in a loop with unit feedback."""
    inside = Diagram("inside")
    a = inside.input("a")
    inside.add("f", Integrator())
    inside.add("g", Gain(k=-2.0))
    inside.add("sum", Sum())
    for sink, source in {"sum.u1": a, "sum.u2": "g.y", "g.u": "f.y", "f.u": "sum.y"}.items():
        inside.wire(sink, source)
    inside.output("y", "f.y")
    d = Diagram("outside")
    r = d.input("r", default=0.0)
    d.add("e", Sum(signs="+-"))
    d.add("P", inside)
    for sink, source in {"e.u1": r, "e.u2": "P.y", "P.a": "e.y"}.items():
        d.wire(sink, source)
    return d


def test_the_output_of_a_subdiagram_is_cut_outside_of_it() -> None:
    linearizer = plant_with_an_inner_loop().linearizer()
    s = 1j * np.array([0.1, 1.0, 10.0])
    np.testing.assert_allclose(linearizer.loop("P.y")(s), 1 / (s + 2), rtol=1e-12)
    np.testing.assert_allclose(linearizer.sensitivity("P.y")(s), (s + 2) / (s + 3), rtol=1e-12)
    # Inside, the signal has another name, under which all that read it see a change.
    np.testing.assert_allclose(linearizer.loop("P.f.y")(s), 3 / s, rtol=1e-12)


def test_the_loop_at_a_controller_s_output_is_that_at_the_motor() -> None:
    d = Diagram.load(FOLDER / "paper" / "iadrc.json")
    amplitude = {"control_right.eso.e": 0.01, "control_right.nlsef.e": [0.05, 0.5]}
    linearizer = d.linearizer(amplitude=amplitude)
    at_control, at_motor = (margins(linearizer.loop(name)) for name in ("control_right.u", "motor_right.v"))
    assert at_control.phase_deg == pytest.approx(at_motor.phase_deg, rel=1e-9)


def passing_on() -> Diagram:
    d = Diagram("passing_on")
    u = d.input("u", default=0.0)
    for name, block in {"g": Gain(k=2.0), "m": Mux(), "x": Demux(), "h": Gain(k=1.0)}.items():
        d.add(name, block)
    for sink, source in {"g.u": u, "m.u1": "g.y", "m.u2": u, "x.u": "m.y", "h.u": "x.y1"}.items():
        d.wire(sink, source)
    return d


def test_behind_a_cut_a_signal_rests_under_all_of_its_names() -> None:
    linearizer = passing_on().linearizer()
    for name in ("x.y1", "m.y[0]", "h.y"):
        assert linearizer.model("u", name, openings="g.y").D[0, 0] == 0.0
        assert linearizer.model("u", name).D[0, 0] == 2.0


@pytest.mark.parametrize("word", ["inputs", "openings"])
def test_nothing_is_put_in_where_a_signal_is_only_passed_on(word: str) -> None:
    given: dict[str, Any] = {"inputs": "u", "outputs": "h.y", "openings": (), word: ["x.y1"]}
    with pytest.raises(UsageError, match=r"is a copy of a signal.*Name g\.y"):
        passing_on().linearize(given["inputs"], given["outputs"], openings=given["openings"])


def test_what_limits_rates_has_no_linear_model_even_where_it_stands_still() -> None:
    d = Diagram("limited")
    r = d.input("r", default=1.0)
    d.add("b", RateLimiter(rising=100.0, falling=100.0))
    d.wire("b.u", r)
    with pytest.raises(AnalysisError, match="acts at each step"):
        d.linearize("r", "b.y")


def test_a_point_is_not_taken_for_another_one_with_large_parameters() -> None:
    points = np.linspace(-6, 6, 1202)
    flat, steep = points.copy(), points.copy()
    steep[400:800] *= 3
    d = Diagram("table")
    u = d.input("u")
    d.add("t", LookupTable(points=points.tolist(), values=flat.tolist()))
    d.wire("t.u", u)
    for values, slope in ((flat, 1.0), (steep, 3.0)):
        model = d.linearize("u", "t.y", parameters={"t.values": values}, inputs={"u": 0.0123})
        assert model.D[0, 0] == pytest.approx(slope, rel=1e-9)


def test_a_law_that_bends_beside_others_with_amplitudes_is_told() -> None:
    d = Diagram.load(FOLDER / "paper" / "iadrc.json")
    amplitude: dict[str, Any] = {"control_right.eso.e": 0.01, "control_right.nlsef.e[0]": 0.05}
    notes = {row.path: row.note for row in d.linearizer(amplitude=amplitude).loop("motor_right.v").report}
    assert "law[1] is nonlinear too, and works at e[1] = 0: give its amplitude" in notes["control_right.nlsef"]
    amplitude["control_right.nlsef.e[1]"] = 0.5
    notes = {row.path: row.note for row in d.linearizer(amplitude=amplitude).loop("motor_right.v").report}
    assert "law[1]" not in notes["control_right.nlsef"]


def test_a_point_that_is_none_of_rest_is_told_where_something_is_not_linear() -> None:
    d = Diagram.load(FOLDER / "inverted_pendulum.json")
    notes = {row.path: row.note for row in d.linearizer().loop("limit.y").report}
    assert "not at rest: omega changes by" in notes["plant"]
    linear = Diagram.load(FOLDER / "analysis" / "leso_pd.json").linearizer().loop("control.u")
    assert not any(row.note for row in linear.report)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--loop", "r"), "it is not part of a loop"),
        (("--loop", "control.u", "--figure", "bode"), "has no file to draw to"),
        (("--loop", "control.u", "--pade", "-1"), "is not an order of a Padé model"),
        (("--loop", "control.u", "--input", "r=60 V"), "different quantities"),
    ],
)
def test_options_that_would_be_ignored_are_refused(
    arguments: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["linearize", str(FOLDER / "analysis" / "leso_pd.json"), *arguments]) == 2
    assert says in capsys.readouterr().err


def test_an_amplitude_and_a_deviation_of_one_signal_are_refused() -> None:
    d = Diagram.load(FOLDER / "analysis" / "smeso_pd.json")
    with pytest.raises(UsageError, match="is given twice"):
        d.linearizer(amplitude={"eso.e": 0.1}, sigma={"eso.e": 0.1})
