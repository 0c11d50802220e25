"""Margins, poles and bandwidths of the rows of a sweep, beside python-control and closed forms."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

from blocks import Diagram, FirstOrder, Gain, Integrator, Step, Sum, TransportDelay, ZeroOrderHold
from blocks.analysis import bandwidth, disk_margins, margins, poles
from blocks.model.study_grammar import MARGINS
from blocks.studies.sweep import Sweep
from blocks.text.errors import UsageError
from tests.support.places import ROOT

pytestmark = pytest.mark.usefixtures("native")

MASS = ROOT / "diagrams" / "adrc" / "mass_position.json"
LOOP = {
    name: {"type": name, "loop": "control.u"}
    for name in ("gain_margin", "phase_margin", "delay_margin", "Ms", "crossover", "slowest_pole", "damping")
}


def loop_of(mass: float, omega_o: float, omega_c: float = 8.0, damping: float = 10.0, stiffness: float = 20.0) -> Any:
    """The loop transfer of linear ADRC at its output u, after Gao: what comes back there with the turned sign."""
    b0 = 1.0 / mass
    gains = np.array([[3 * omega_o], [3 * omega_o**2], [omega_o**3]])
    A = np.array([[0.0, 1, 0], [0, 0, 1], [0, 0, 0]]) - gains @ np.array([[1.0, 0, 0]])
    law = np.array([[omega_c**2, 2 * omega_c, 1.0]]) / b0
    heard = A - np.array([[0.0], [b0], [0.0]]) @ law  # the observer hears the control that it leads to
    plant = control.ss([[0, 1], [-stiffness / mass, -damping / mass]], [[0], [1 / mass]], [[1, 0]], 0)
    return control.series(plant, control.ss(heard, gains, law, 0))


def test_a_row_has_the_margins_of_several_channels_together() -> None:
    satellite = Diagram.load("diagrams/analysis/satellite.json")
    both = ["k.y[0]", "k.y[1]"]
    wanted: dict[str, Any] = {
        name: {"type": name, "loop": both} for name in ("disk_margin", "Ms", "Mt", "slowest_pole")
    }
    wanted["vector"] = {"type": "disk_margin", "loop": "k.y"}
    sweep = satellite.sweep({"plant.A": [[[0, a], [-a, 0]] for a in (0, 5, 10)]}, margins=wanted, stop=0.1)
    for k, a in enumerate((0, 5, 10)):
        linearizer = satellite.linearizer(parameters={"plant.A": [[0, a], [-a, 0]]})
        found = disk_margins(linearizer.loop(both))
        if not found.stable:
            assert np.isnan(sweep.measures["disk_margin"][k])
            assert "E705 k.y[0], k.y[1]: the closed loop is not stable" in sweep.messages[k]
            continue
        for name, value in {"disk_margin": found.disk, "vector": found.disk, "Ms": found.Ms, "Mt": found.Mt}.items():
            assert sweep.measures[name][k] == pytest.approx(value, rel=1e-9), name
        assert sweep.measures["slowest_pole"][k] == pytest.approx(-1.0)
    for loop, words in (
        (both, "E501 margins.gm: gain_margin is of a loop at one signal; of several signals there are disk_margin"),
        ("k.y", "has several channels, which have no gain_margin. Use disk_margin, Ms, Mt."),
    ):
        with pytest.raises(UsageError, match=re.escape(words)):
            satellite.sweep(
                {"k.K": [[[-1, 0], [0, -1]]]}, margins={"gm": {"type": "gain_margin", "loop": loop}}, stop=0.1
            )


def test_margins_of_each_row_are_those_of_python_control() -> None:
    diagram = Diagram.load(MASS)
    grid = {"mass": [0.5, 1.0, 2.0], "omega_o": [20.0, 40.0, 80.0]}
    sweep = diagram.sweep(grid, margins=LOOP, measures=["ITAE"], stop=1.5)
    assert list(sweep.measures) == ["ITAE", *LOOP]
    assert sweep.units["phase_margin"] == "deg"
    assert sweep.messages == ("",) * 9
    for i in range(9):
        loop = loop_of(sweep.varied["mass"][i], sweep.varied["omega_o"][i])
        gain, phase, _, crossover = control.margin(loop)
        row = {name: column[i] for name, column in sweep.measures.items()}
        assert row["gain_margin"] == pytest.approx(gain, rel=1e-6)
        assert row["phase_margin"] == pytest.approx(phase, rel=1e-6)
        assert row["crossover"] == pytest.approx(crossover, rel=1e-6)
        assert row["delay_margin"] == pytest.approx(np.radians(phase) / crossover, rel=1e-6)
        assert row["Ms"] >= 1 / np.abs(1 + loop(1j * np.geomspace(1, 1e3, 2000))).min() * (1 - 1e-9)
        closed = control.poles(control.feedback(loop))
        assert row["slowest_pole"] == pytest.approx(closed.real.max(), rel=1e-6)
        assert row["damping"] == pytest.approx((-closed.real / np.abs(closed)).min(), rel=1e-6)


def test_margins_of_a_row_keep_its_dead_time_exact() -> None:
    """4 e^(-s T)/(s + 1): |L| = 1 at sqrt(15); with T = 1 s the closed loop is not stable."""
    diagram = Diagram("late")
    for name, block in {"late": TransportDelay(), "lag": FirstOrder(T=1.0), "back": Gain(k=-4.0)}.items():
        diagram.add(name, block)
    for sink, origin in (("late", "back"), ("lag", "late"), ("back", "lag")):
        diagram.wire(f"{sink}.u", f"{origin}.y")
    asked = {name: {"type": name, "loop": "back.y"} for name in ("delay_margin", "phase_margin")}
    delays = np.array([0.1, 0.2, 1.0])
    sweep = diagram.sweep({"late.delay": delays.tolist()}, margins=asked, measures=[], stop=0.1)
    w = np.sqrt(15.0)
    phase = np.pi - np.arctan(w) - w * delays
    assert np.degrees(phase[:2]) == pytest.approx(sweep.measures["phase_margin"][:2], rel=1e-12)
    assert phase[:2] / w == pytest.approx(sweep.measures["delay_margin"][:2], rel=1e-12)
    assert np.isnan(sweep.measures["delay_margin"][2])
    assert "the closed loop is not stable" in sweep.messages[2]


def test_a_row_is_what_its_own_diagram_gives_to_the_last_bit(tmp_path: Path) -> None:
    asked: dict[str, Any] = {
        "gm": {"type": "gain_margin", "loop": "control.u", "at": 1.2},
        "width": {"type": "bandwidth", "from": "wanted.y", "to": "plant.x"},
        "slow": {"type": "slowest_pole", "from": "wanted.y", "to": "plant.x"},
    }
    scenarios: dict[str, Any] = {"light": {}, "stiff": {"stiffness": 60.0}}
    given = {"margins": asked, "measures": [], "stop": 2.0, "scenarios": scenarios}
    sweep = Diagram.load(MASS).sweep({"mass": [0.6, 1.7]}, out=tmp_path / "rows.parquet", **given)
    for i, mass in enumerate([0.6, 1.7, 0.6, 1.7]):
        parameters = {**scenarios[("light", "stiff")[i // 2]], "mass": mass}
        later = Diagram.load(MASS).linearizer(parameters=parameters, at=1.2)
        assert sweep.measures["gm"][i] == margins(later.loop("control.u")).gain
        model = Diagram.load(MASS).linearizer(parameters=parameters).model("wanted.y", "plant.x")
        assert sweep.measures["width"][i] == bandwidth(model)
        assert sweep.measures["slow"][i] == poles(model).real.max()
    known = Sweep.load(tmp_path / "rows.parquet")
    assert all(np.array_equal(known.measures[name], sweep.measures[name]) for name in asked)
    assert known.units["width"] == "rad/s"


def test_a_law_without_a_slope_needs_its_amplitude_and_a_row_without_it_says_so() -> None:
    diagram = Diagram.load(ROOT / "diagrams" / "analysis" / "smeso_pd.json")
    loop = {"type": "gain_margin", "loop": "control.u"}
    small, usual = ({**loop, "amplitude": {"eso.e": size}} for size in (0.001, 0.1))
    asked = {"bare": loop, "small": small, "usual": usual}
    sweep = diagram.sweep({"kp": [144.6642, 200.0]}, margins=asked, measures=[], stop=0.01)
    assert np.isnan(sweep.measures["bare"]).all()
    assert list(sweep.status) == ["ok", "ok"]
    assert all("bare: E701 eso.g: has an infinite slope" in message for message in sweep.messages)
    assert sweep.measures["small"][0] == pytest.approx(5.94, abs=0.005)  # docs/frequency.md, The loop
    assert sweep.measures["usual"][0] == pytest.approx(4.31, abs=0.005)


def test_an_unstable_loop_has_no_margins_and_a_bearing_one_endless_ones() -> None:
    diagram = Diagram.load(ROOT / "diagrams" / "analysis" / "leso_pd.json")
    asked = {"gm": {"type": "gain_margin", "loop": "control.u"}, "slow": {"type": "slowest_pole", "loop": "control.u"}}
    sweep = diagram.sweep({"motor.Jeq": [0.2752, 0.05]}, margins=asked, measures=[], stop=0.01)
    assert sweep.measures["gm"][0] == pytest.approx(3.0417, abs=5e-5)
    assert np.isnan(sweep.measures["gm"][1])
    assert sweep.measures["slow"][1] > 0
    assert "gm: E705 control.u: the closed loop is not stable" in sweep.messages[1]
    plain = Diagram.load(ROOT / "diagrams" / "motor_pid.json")
    asked = {"gm": {"type": "gain_margin", "loop": "control.u"}}
    (found,) = plain.sweep({"kp": [8.0]}, margins=asked, stop=0.01).measures["gm"]
    known = margins(plain.linearizer(parameters={"kp": 8.0}).loop("control.u"))
    assert known.stable
    assert found == (np.inf if known.gain is None else known.gain)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"loop": "control.u"}, 'the key "type" is missing'),
        ({"type": "gain_margn", "loop": "control.u"}, "gain_margin"),
        ({"type": "gain_margin"}, 'a margin needs either "loop"'),
        ({"type": "gain_margin", "from": "wanted.y", "to": "plant.x"}, 'gain_margin needs a "loop"'),
        ({"type": "gain_margin", "loop": "control.u", "amplitudes": {}}, "amplitude"),
        ({"type": "gain_margin", "lop": "control.u"}, 'the key "lop" is not known here. Did you mean "loop"?'),
        ({"type": "gain_margin", "loop": "control.x"}, "there is no such signal"),
        ({"type": "gain_margin", "loop": "control.u", "amplitude": {"plant.x": 0.1}}, "amplitude of plant.x"),
    ],
)
def test_what_is_no_margin_is_refused_before_the_first_run(entry: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError) as refused:
        Diagram.load(MASS).sweep({"mass": [1.0]}, margins={"gm": entry})
    assert refused.value.code == "E501"
    assert said in str(refused.value)


def test_the_page_about_many_runs_names_all_types() -> None:
    page = (ROOT / "docs" / "many_runs.md").read_text(encoding="utf-8")
    for name, what in MARGINS.items():
        assert f"| `{name}` | {what} |" in page.replace(r"\|", "|")


def test_the_message_of_a_row_with_delays_names_what_a_margin_takes() -> None:
    diagram = Diagram("delayed")
    error, lag = diagram.add("error", Sum(signs="+-")), diagram.add("lag", FirstOrder())
    delay = diagram.add("delay", TransportDelay(delay=0.1))
    diagram.wire(error.u1, diagram.add("step", Step()).y)
    diagram.wire(delay.u, error.y)
    diagram.wire(lag.u, delay.y)
    diagram.wire(error.u2, lag.y)
    margin = {"type": "slowest_pole", "loop": "error.y"}
    sweep = diagram.sweep({"lag.k": [0.5]}, stop=0.1, measures=[], margins={"pole": margin})
    assert "E707" in sweep.messages[0]
    assert '{"type": "slowest_pole", "pade": 3, ...}' in sweep.messages[0]
    sweep = diagram.sweep({"lag.k": [0.5]}, stop=0.1, measures=[], margins={"pole": {**margin, "pade": 3}})
    assert sweep.measures["pole"][0] < 0.0


def test_a_margin_of_a_sampled_loop_with_a_dead_time_is_exact() -> None:
    diagram = Diagram("dead")
    parts = {"hold": ZeroOrderHold(period=0.5), "late": TransportDelay(delay=0.5), "plant": Integrator()}
    for name, block in (parts | {"gain": Gain(k=-1.0)}).items():
        diagram.add(name, block)
    for origin, sink in (("gain", "hold"), ("hold", "late"), ("late", "plant"), ("plant", "gain")):
        diagram.wire(f"{sink}.u", f"{origin}.y")
    margin = {"type": "gain_margin", "loop": "hold.y"}
    sweep = diagram.sweep({"late.delay": [0.5, 1.0]}, stop=0.1, measures=[], margins={"gm": margin})
    # z^n (z - 1) + k T has roots on the unit circle at k T = 2 sin(pi/(4 n + 2)).
    assert sweep.messages == ("", "")
    known = [2.0 * math.sin(math.pi / (4 * n + 2)) / 0.5 for n in (1, 2)]
    assert sweep.measures["gm"] == pytest.approx(known, rel=1e-9)
