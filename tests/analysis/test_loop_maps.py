"""Maps of loops: single points by `margins`, `loop_report` and `peak`, borders of stability by hand."""

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    ADRC,
    PID,
    AnalysisError,
    Constant,
    Diagram,
    DiscreteADRC,
    Expression,
    Gain,
    Integrator,
    ModelError,
    Saturation,
    Sine,
    Step,
    Sum,
    TransferFunction,
    TransportDelay,
    UsageError,
)
from blocks.analysis import LoopMap, loop_map, loop_report, margins, peak
from blocks.analysis import loop_maps as own_module
from blocks.cli import main
from tests.support.places import ROOT

Array = np.ndarray[Any, Any]
PAIRS = ("gain", "phase_deg", "delay", "crossover", "Ms", "Mt", "disk")
OVER = {"control.omega_c": (1.0, 30.0), "control.omega_o": (5.0, 300.0)}


def loop_of(control: Any, plant: Any = None, delay: float = 0.0) -> Diagram:
    d = Diagram("loop")
    c, r = d.add("control", control), d.add("r", Step(at=0.5))
    p = d.add("plant", TransferFunction(num=[2.0], den=[1.0, 1.0, 0.5]) if plant is None else plant)
    d.wire(c.r1 if isinstance(control, DiscreteADRC) else c.r, r.y)
    d.wire(c.y, p.y)
    d.wire(p.u, c.u)
    if delay:
        late = d.add("late", TransportDelay(delay=delay))
        d.wire(late.u, c.u)
        d.unwire("plant.u")
        d.wire(p.u, late.y)
    return d


def same(found: LoopMap, place: tuple[int, ...], known: Any, rel: float = 1e-8) -> None:
    for name in PAIRS:
        single = getattr(known, name)
        single = math.inf if single is None else single
        assert found.measures[name][place] == pytest.approx(single, rel=rel), name
    low = known.gain_low or 0.0
    assert found.measures["gain_low"][place] == pytest.approx(low, rel=rel)


@pytest.mark.parametrize("observer", ["linear", "reduced", "generalized", "cascade"])
def test_a_point_of_the_map_is_what_reports_of_the_loop_say_there(observer: str) -> None:
    d = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0, observer=observer))
    found = loop_map(d, "control.u", "plant.y", over=OVER, points=7, frequency=3.0)
    assert found.parameters == ("control.omega_c", "control.omega_o")
    assert found.present == (4.0, 20.0)
    assert found.units == ("rad/s", "rad/s")
    for i, k in ((0, 0), (6, 0), (2, 5), (6, 6)):
        given = {"control.omega_c": float(found.values[0][i]), "control.omega_o": float(found.values[1][k])}
        known = loop_report(d, "control.u", "plant.y", parameters=given)
        if not known.margins.stable:
            assert np.isnan(found.measures["Ms"][k, i])
            continue
        same(found, (k, i), known.margins)
        assert found.measures["disturbance"][k, i] == pytest.approx(known.peak_disturbance[0], rel=1e-6)
        assert found.measures["noise"][k, i] == pytest.approx(known.peak_noise[0], rel=1e-6)
        assert found.measures["at_frequency"][k, i] == pytest.approx(abs(known.disturbance(3j)), rel=1e-9)


def test_another_controller_and_a_parameter_of_the_plant() -> None:
    d = loop_of(PID(kp=2.0, ki=1.0, kd=0.5, Tf=0.02))
    found = loop_map(d, "control.u", "plant.y", over={"control.kp": [0.5, 1.0, 4.0], "control.ki": [0.1, 1.0, 3.0]})
    for i, k in ((0, 0), (2, 0), (1, 1)):
        given = {"control.kp": float(found.values[0][i]), "control.ki": float(found.values[1][k])}
        same(found, (k, i), margins(d.linearizer(parameters=given).loop("control.u")))


def test_the_range_of_b0_that_stays_stable_is_that_of_routh() -> None:
    # Plant 2/(s + 3), order 1: the characteristic polynomial is s (s + 3)(s + 2 wo + wc) + (2/b0) ((2 wo wc + wo^2) s
    # + wo^2 wc), of order 3: a1 a2 > a3 gives the border.
    wc, wo = 4.0, 20.0

    def is_stable(b0: float) -> bool:
        p = np.polymul([1.0, 3.0, 0.0], [1.0, 2 * wo + wc])
        p = np.polyadd(p, 2.0 / b0 * np.array([2 * wo * wc + wo**2, wo**2 * wc]))
        return bool(p[1] * p[2] > p[3] and (p > 0).all())

    d = loop_of(ADRC(1, b0=2.0, omega_c=wc, omega_o=wo), TransferFunction(num=[2.0], den=[1.0, 3.0]))
    slow = loop_of(ADRC(1, b0=2.0, omega_c=wc, omega_o=wo), TransferFunction(num=[2.0], den=[0.1, 1.3, 3.0]))
    found = loop_map(d, "control.u", "plant.y", over={"control.b0": (0.001, 100.0)}, points=200)
    for b0, Ms in zip(found.values[0], found.measures["Ms"], strict=True):
        assert np.isfinite(Ms) == is_stable(b0)
    # A second pole of the plant: the border lies inside, and is that of the eigenvalues of single models.
    found = loop_map(slow, "control.u", "plant.y", over={"control.b0": (0.001, 100.0)}, points=30)
    stable = [
        bool(margins(slow.linearizer(parameters={"control.b0": float(b0)}).loop("control.u")).stable)
        for b0 in found.values[0]
    ]
    assert np.isfinite(found.measures["Ms"]).tolist() == stable
    assert 0 < sum(stable) < 30


def test_delays_are_pade_models_where_that_is_asked_for() -> None:
    d = loop_of(ADRC(2, b0=2.0, omega_c=2.0, omega_o=10.0), delay=0.05)
    with pytest.raises(AnalysisError) as refused:
        loop_map(d, "control.u", "plant.y", over=OVER, points=3)
    assert refused.value.code == "E707"
    found = loop_map(
        d, "control.u", "plant.y", over={"control.omega_c": (1.0, 3.0), "late.delay": (0.01, 0.1)}, points=3, pade=4
    )
    for i, k in ((0, 0), (2, 2), (0, 2)):
        given = {"control.omega_c": float(found.values[0][i]), "late.delay": float(found.values[1][k])}
        known = margins(d.linearizer(parameters=given).loop("control.u", pade=4))
        if known.stable:
            same(found, (k, i), known, 1e-6)
        else:
            assert np.isnan(found.measures["Ms"][k, i])


def test_a_sampled_loop_is_computed_point_by_point() -> None:
    d = loop_of(DiscreteADRC(period=0.02, b0=2.0, omega_c=4.0, omega_o=20.0))
    over = {"control.omega_c": (1.0, 6.0), "control.omega_o": (5.0, 60.0)}
    found = loop_map(d, "control.u", "plant.y", over=over, points=4)
    for i, k in ((0, 0), (3, 1), (1, 3)):
        given = {"control.omega_c": float(found.values[0][i]), "control.omega_o": float(found.values[1][k])}
        same(found, (k, i), margins(d.linearizer(parameters=given).loop("control.u")), 1e-6)


def test_models_at_once_are_those_of_single_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """A law that bends: the models differ by the operating point, so that they are not taken from one of them."""
    d = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0))
    swing = d.add("swing", Sine(amplitude=0.1))
    d.unwire("control.r")
    d.wire("control.r", swing.y)
    singles = []
    whole = own_module._one_by_one

    def counted(*given: Any) -> Any:
        singles.append(given)
        return whole(*given)

    monkeypatch.setattr(own_module, "_one_by_one", counted)
    quick = loop_map(d, "control.u", "plant.y", over=OVER, points=4)
    assert not singles
    monkeypatch.setattr(own_module, "_at_once", lambda *_: None)
    slow = loop_map(d, "control.u", "plant.y", over=OVER, points=4)
    assert singles
    for name, values in quick.measures.items():
        assert values == pytest.approx(slow.measures[name], rel=1e-10, nan_ok=True), name


def test_what_is_best_lies_within_the_limits_and_no_point_is_better() -> None:
    d = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0))
    found = loop_map(d, "control.u", "plant.y", over=OVER, points=15)
    limits: dict[str, tuple[float | None, float | None]] = {"Ms": (None, 1.5), "noise": (None, 2000.0)}
    best = found.best("disturbance", **limits)
    known = loop_report(d, "control.u", "plant.y", parameters=best)
    assert known.margins.Ms <= 1.5
    assert known.peak_noise[0] <= 2000.0
    allowed = (found.measures["Ms"] <= 1.5) & (found.measures["noise"] <= 2000.0)
    assert (found.feasible(**limits) == allowed).all()
    assert known.peak_disturbance[0] == pytest.approx(found.measures["disturbance"][allowed].min(), rel=1e-6)
    with pytest.raises(AnalysisError) as refused:
        found.best("disturbance", Ms=(None, 1.0))
    assert refused.value.code == "E705"


def test_the_best_margin_is_the_largest_and_places_outside_of_the_map_are_refused() -> None:
    d = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0))
    found = loop_map(d, "control.u", "plant.y", over=OVER, points=9)
    for name in ("phase_deg", "delay", "disk"):
        best = found.best(name, Ms=(None, 2.0))
        allowed = found.measures["Ms"] <= 2.0
        assert found.at(best)[name] == found.measures[name][allowed].max() > found.measures[name][allowed].min()
    with pytest.raises(UsageError, match=r"E501 control\.omega_c: .* lies outside of the map"):
        found.at({**best, "control.omega_c": 1e4})
    with pytest.raises(UsageError, match=r"E501 point: names control\.omega\. Parameters"):
        found.at({"control.omega": 3.0})
    with pytest.raises(UsageError, match=r"E501 over control\.omega_c: \[Hz\] is given, but \[rad/s\] is needed"):
        loop_map(d, "control.u", "plant.y", over={"control.omega_c": ("1 Hz", "9 Hz")})


def test_a_gain_in_place_of_a_limit_gives_the_map_of_the_loop_without_it() -> None:
    """A limiter at its limit at the start passes nothing on: the error names the cure, and the cure works."""
    d = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0, lower=-1.0, upper=1.0))
    d.set("control.lower", 0.5)
    free = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0))
    with pytest.raises(AnalysisError, match=r'overrides=\{"control.limit": 1.0\}'):
        loop_map(d, "control.u", "plant.y", over=OVER, points=4)
    found = loop_map(d, "control.u", "plant.y", over=OVER, points=4, overrides={"control.limit": 1.0})
    expected = loop_map(free, "control.u", "plant.y", over=OVER, points=4)
    for name, values in found.measures.items():
        assert values == pytest.approx(expected.measures[name], rel=1e-9, nan_ok=True)


def test_a_narrow_peak_between_the_points_of_the_grid_is_found() -> None:
    plant = TransferFunction(num=[2.0, 0.004, 200.0], den=[100.0, 100.4, 150.2, 50.0])  # a resonance of 0.2 %
    d = loop_of(ADRC(1, b0=0.02, omega_c=0.3, omega_o=1.5), plant)
    found = loop_map(d, "control.u", "plant.y", over={"control.omega_c": (0.05, 0.4)}, points=5)
    for k, w in enumerate(found.values[0]):
        linearizer = d.linearizer(parameters={"control.omega_c": float(w)})
        known = margins(linearizer.loop("control.u"))
        if known.stable:
            assert found.measures["Ms"][k] == pytest.approx(known.Ms, rel=1e-6)
            disturbance = peak(linearizer.model("control.u", "plant.y")).value
            assert found.measures["disturbance"][k] == pytest.approx(disturbance, rel=1e-6)


def test_the_table_and_the_figure_of_a_map(tmp_path: Path) -> None:
    d = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0))
    found = loop_map(d, "control.u", "plant.y", over=OVER, points=5)
    found.to_csv(tmp_path / "map.csv")
    with (tmp_path / "map.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 25
    assert float(rows[1]["control.omega_c"]) == found.values[0][1]
    assert float(rows[1]["Ms"]) == found.measures["Ms"][0, 1]
    assert float(rows[5]["control.omega_o"]) == found.values[1][1]
    assert "5 x 5 points, 25 of 25 closed and stable" in repr(found)
    assert found.as_json()["measures"]["Ms"][0][1] == found.measures["Ms"][0, 1]
    figure = found.plot("Ms", "noise", limits={"Ms": (None, 1.5)})
    assert [axis.get_title(loc="left") for axis in figure.axes] == ["Ms, largest |S|", "largest |noise → control|"]
    line = loop_map(d, "control.u", "plant.y", over={"control.b0": (0.5, 5.0)}, points=5)
    assert len(line.plot().axes) == 4


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"over": {}}, "one or two"),
        ({"over": {"control.omega_c": (3.0, 1.0)}}, "rising"),
        ({"over": {"control.omega_c": "x"}}, "rising"),
        ({"over": OVER, "points": 1}, "points"),
        ({"over": OVER, "points": 600}, "360000 points"),
        ({"over": {"control.nothing": (1.0, 2.0)}}, "nothing"),
        ({"over": OVER, "control": "no.u"}, "no.u"),
        ({"over": OVER, "control": ["control.u"]}, "name of one signal"),
        ({"over": "control.b0"}, "mapping"),
        ({"over": OVER, "frequency": -1.0}, "from 0 on"),
        ({"over": OVER, "frequency": "3"}, "from 0 on"),
        ({"over": OVER, "at": "now"}, "a time in s"),
    ],
)
def test_what_makes_no_map_is_refused(given: dict[str, Any], said: str) -> None:
    d = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0))
    with pytest.raises((UsageError, ModelError)) as refused:
        loop_map(d, given.pop("control", "control.u"), "plant.y", **given)
    assert said in str(refused.value)


def test_the_command_prints_writes_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0)).save(tmp_path / "loop.json")
    command = ["adrc-map", str(tmp_path / "loop.json"), "control.u", "plant.y", "--points", "5"]
    over = ["--over", "control.omega_c=1,30", "--over", "control.omega_o=5,300"]
    drawn = [
        "--limit",
        "Ms<1.6",
        "--best",
        "disturbance",
        "--plot",
        str(tmp_path / "m.svg"),
        "-o",
        str(tmp_path / "m.csv"),
    ]
    assert main([*command, *over, *drawn]) == 0
    out = capsys.readouterr().out
    assert "within Ms<1.6:" in out
    assert "least disturbance: control.omega_c = " in out
    assert "  there: gain = " in out
    assert (tmp_path / "m.svg").read_text().startswith("<?xml")
    assert len((tmp_path / "m.csv").read_text().splitlines()) == 26
    assert main([*command, *over, "--limit", "Ms<1.01", "--best", "noise", "-o", str(tmp_path / "none.csv")]) != 0
    told = capsys.readouterr()
    assert "within Ms<1.01: 0 points" in told.out
    assert "E705" in told.err
    assert len((tmp_path / "none.csv").read_text().splitlines()) == 26  # written, though no point is within the limits
    for wrong, said in (
        ([], "--over: is missing"),
        ([*over, "--limit", "Ms=1"], "--limit Ms=1"),
        (["--over", "control.omega_c=a,b"], "NAME=LOW,HIGH"),
        ([*over, "--over", "control.omega_c=2,3"], "a second time"),
        ([*over, "-o", "x.json"], ".csv"),
        ([*over, "--best", "Msx"], "Did you mean 'Ms'"),
    ):
        assert main([*command, *wrong]) == 2
        assert said in capsys.readouterr().err


def test_a_law_that_bends_is_taken_at_its_operating_point() -> None:
    d = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0, lower=-5.0, upper=5.0))
    limit = d.add("soft", Saturation(lower=-1.0, upper=1.0))
    d.wire("soft.u", "control.u")
    d.unwire("plant.u")
    d.wire("plant.u", limit.y)
    found = loop_map(d, "control.u", "plant.y", over=OVER, points=3)
    given = {"control.omega_c": float(found.values[0][1]), "control.omega_o": float(found.values[1][1])}
    same(found, (1, 1), margins(d.linearizer(parameters=given).loop("control.u")))


def test_the_robot_of_the_paper_at_an_amplitude_beside_laws_without_a_slope() -> None:
    """The controller of the other wheel has infinite slopes, which are no part of this loop."""
    d = Diagram.load(ROOT / "diagrams" / "paper" / "iadrc.json")
    amplitude = {"control_right.nlsef.e": 0.01, "control_right.eso.e": 0.01}
    over = {"Jeq": (0.2, 0.6), "control_right.Jeq": (0.2, 0.6)}
    found = loop_map(d, "control_right.u", "motor_right.omega", over=over, points=3, amplitude=amplitude)
    for place in ((0, 0), (1, 2)):
        given = {"Jeq": float(found.values[0][place[1]]), "control_right.Jeq": float(found.values[1][place[0]])}
        same(found, place, margins(d.linearizer(parameters=given, amplitude=amplitude).loop("control_right.u")))


def simple_loop(num: list[float], den: list[float]) -> Diagram:
    """A gain before a plant, with a feedback of 1."""
    d = Diagram("simple")
    r, error, gain = d.add("r", Step(at=0.5)), d.add("error", Sum(signs="+-")), d.add("gain", Gain())
    plant = d.add("plant", TransferFunction(num=num, den=den))
    d.wire(error.u1, r.y)
    d.wire(error.u2, plant.y)
    d.wire(gain.u, error.y)
    d.wire(plant.u, gain.y)
    return d


def test_gains_of_a_fast_observer_leave_the_plant_its_digits() -> None:
    d = loop_of(ADRC(3, b0=2.0, omega_c=4.0, omega_o=20.0), TransferFunction(num=[2.0], den=[1.0, 1.0, 0.5, 0.3]))
    found = loop_map(d, "control.u", "plant.y", over={"control.omega_o": [50.0, 1000.0, 3000.0]})
    for k, w in enumerate(found.values[0]):
        known = loop_report(d, "control.u", "plant.y", parameters={"control.omega_o": float(w)})
        same(found, (k,), known.margins, 1e-6)
        assert found.measures["disturbance"][k] == pytest.approx(known.peak_disturbance[0], rel=1e-6)


def test_a_gain_margin_at_rest_is_found() -> None:
    d = simple_loop([2.0], [1.0, -1.0])  # 2 k/(s - 1) is stable for k above 1/2, where L(0) = -1
    found = loop_map(d, "gain.y", "plant.y", over={"gain.k": [0.4, 0.51, 1.0, 10.0]})
    assert found.measures["gain_low"][1:] == pytest.approx(0.5 / found.values[0][1:], rel=1e-9)
    assert np.isnan(found.measures["gain_low"][0])


def test_of_equal_phase_margins_that_of_the_lowest_frequency_is_the_crossover() -> None:
    d = simple_loop([1.0, 0.0, 1.0], [1.0, 0.0, 4.0, 0.0])  # a phase of 90 degrees at each frequency
    found = loop_map(d, "gain.y", "plant.y", over={"gain.k": [0.4, 1.9, 3.0, 100.0]})
    for k, gain in enumerate(found.values[0]):
        same(found, (k,), margins(d.linearizer(parameters={"gain.k": float(gain)}).loop("gain.y")))


def test_the_higher_one_of_two_summits_is_the_peak() -> None:
    d = simple_loop([1.0], [1.0, 0.0])
    for name, source, delay in (("late", "gain.y", 0.4), ("later", "late.y", 0.1)):
        d.add(name, TransportDelay(delay=delay))
        d.wire(f"{name}.u", source)
    d.unwire("plant.u")
    d.wire("plant.u", "later.y")
    found = loop_map(d, "gain.y", "plant.y", over={"gain.k": [0.9, 1.0, 1.1]}, pade=3)
    for k, gain in enumerate(found.values[0]):
        known = margins(d.linearizer(parameters={"gain.k": float(gain)}).loop("gain.y", pade=3))
        assert found.measures["Ms"][k] == pytest.approx(known.Ms, rel=1e-8)


def test_two_crossings_between_points_of_the_grid_are_found() -> None:
    d = loop_of(PID(kp=1.5, ki=3.0, kd=0.5, Tf=0.02))  # the phase is beyond -180 degrees from 1.29 to 1.33 rad/s
    found = loop_map(d, "control.u", "plant.y", over={"control.kp": [1.45, 1.5, 1.55, 1.6]})
    for k, gain in enumerate(found.values[0]):
        same(found, (k,), margins(d.linearizer(parameters={"control.kp": float(gain)}).loop("control.u")))


@pytest.mark.parametrize("den", [[1.0, 1.0], [1.0, 1.0, 0.0]])
@pytest.mark.parametrize("words", [{"output": "way.y"}, {"output": "plant.y", "disturbance": "wind.y"}])
def test_what_lies_outside_of_the_loop_says_nothing_about_its_stability(
    den: list[float], words: dict[str, str]
) -> None:
    d = simple_loop([2.0], den)
    way, drift, wind = d.add("way", Integrator()), d.add("drift", Integrator()), d.add("wind", Step(at=1.0))
    both = d.add("both", Sum())
    d.unwire("plant.u")
    for sink, source in ((way.u, "plant.y"), (drift.u, wind.y), (both.u1, "gain.y"), (both.u2, drift.y)):
        d.wire(sink, source)
    d.wire("plant.u", both.y)
    found = loop_map(d, "gain.y", over={"gain.k": [0.6, 1.0, 3.0]}, measurement="plant.y", frequency=2.0, **words)
    for k, gain in enumerate(found.values[0]):
        known = loop_report(d, "gain.y", parameters={"gain.k": float(gain)}, measurement="plant.y", **words)
        same(found, (k,), known.margins)
        assert found.measures["noise"][k] == pytest.approx(known.peak_noise[0], rel=1e-9)
        assert found.measures["disturbance"][k] == pytest.approx(known.peak_disturbance[0], rel=1e-7)
        assert found.measures["at_frequency"][k] == pytest.approx(abs(known.disturbance(2j)), rel=1e-9)


def test_a_gain_may_be_0_where_a_state_then_has_no_part() -> None:
    d = loop_of(PID(kp=2.0, ki=1.0, kd=0.5, Tf=0.02))
    found = loop_map(d, "control.u", "plant.y", over={"control.ki": (0.0, 1.0), "control.kd": (0.0, 1.0)}, points=3)
    for i, k in ((0, 0), (0, 2), (2, 0), (1, 1)):
        given = {"control.ki": float(found.values[0][i]), "control.kd": float(found.values[1][k])}
        same(found, (k, i), margins(d.linearizer(parameters=given).loop("control.u")))


def test_each_point_has_its_own_operating_point_however_stiff_the_observer_is() -> None:
    d = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=3000.0), TransferFunction(num=[2.0], den=[1.0, 1.0]))
    bend = d.add("bend", Expression(expression="u2 - u1**3"))
    slow = d.add("slow", Integrator())
    d.wire(bend.u1, slow.y)
    d.wire(bend.u2, "control.u")
    d.wire(slow.u, bend.y)
    d.unwire("plant.u")
    d.wire("plant.u", slow.y)
    over = {"slow.y_start": [0.1, 0.5, 1.0], "control.omega_o": [3000.0, 9000.0]}
    found = loop_map(d, "control.u", "plant.y", over=over)
    for i, k in ((0, 0), (1, 0), (2, 1)):
        given = {"slow.y_start": float(found.values[0][i]), "control.omega_o": float(found.values[1][k])}
        same(found, (k, i), margins(d.linearizer(parameters=given).loop("control.u")), 1e-6)


def test_where_a_saturation_holds_the_control_there_is_no_margin() -> None:
    d = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0, lower=-8.0, upper=8.0))
    d.unwire("control.r")
    d.wire("control.r", d.add("now", Constant(value=1.0)).y)  # u begins at omega_c^2/b0
    over = {"control.omega_c": [1.0, 2.0, 5.0, 10.0], "control.b0": [1.0, 2.0, 5.0, 20.0]}
    found = loop_map(d, "control.u", "plant.y", over=over)
    wc, b0 = found.values[0][None, :], found.values[1][:, None]
    assert (np.isnan(found.measures["Ms"]) | (wc**2 / b0 < 8.0)).all()
    same(found, (1, 1), margins(d.linearizer(parameters={"control.omega_c": 2.0}).loop("control.u")))


def test_a_map_over_the_period_of_a_sampled_loop() -> None:
    d = loop_of(DiscreteADRC(period=0.02, b0=2.0, omega_c=4.0, omega_o=20.0))
    found = loop_map(d, "control.u", "plant.y", over={"control.period": [0.01, 0.02, 0.05, 0.1]})
    for k, period in enumerate(found.values[0]):
        same(found, (k,), margins(d.linearizer(parameters={"control.period": float(period)}).loop("control.u")), 1e-6)


def test_what_there_is_none_of_lies_within_no_limit() -> None:
    d = simple_loop([2.0], [1.0, 1.0])  # |L| stays below 1 for k below 1/2
    found = loop_map(d, "gain.y", "plant.y", over={"gain.k": [0.1, 0.4, 0.6, 3.0]})
    assert found.feasible().all()
    assert found.feasible(crossover=(0.1, 50.0)).tolist() == [False, False, True, True]
    assert found.feasible(gain=(2.0, None)).all()
    with pytest.raises(UsageError, match="least, most"):
        found.feasible(Ms=(None, math.nan))
    plane = loop_map(d, "gain.y", "plant.y", over={"gain.k": [0.1, 0.6, 3.0], "plant.num[0]": [1.0, 2.0, 4.0]})
    drawn = plane.plot("crossover").axes[0].collections
    assert not any("////" in (getattr(each, "hatches", None) or ()) for each in drawn)


@pytest.mark.parametrize(("control", "said"), [("r.y", "it is not part of a loop"), ("control.u", "passes nothing on")])
def test_a_signal_that_does_not_come_back_at_any_point_has_no_map(control: str, said: str) -> None:
    d = loop_of(ADRC(2, b0=5.0, omega_c=4.0, omega_o=20.0, lower=-0.1, upper=0.1))
    d.set("r.at", 0.0)
    with pytest.raises(AnalysisError) as refused:
        loop_map(d, control, "plant.y", over={"control.omega_c": (5.0, 30.0)}, points=3)
    assert refused.value.code == "E705"
    assert said in str(refused.value)


def test_ranges_may_be_quantities_and_a_point_has_its_measures() -> None:
    d = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0))
    plain = loop_map(d, "control.u", "plant.y", over=OVER, points=4)
    turns = f"{60.0 * 30.0 / (2 * math.pi):.17g} rpm"
    given = {"control.omega_c": ("1 rad/s", turns), "control.omega_o": [5.0, {"value": 300, "unit": "rad/s"}]}
    found = loop_map(d, "control.u", "plant.y", over=given, points=4)
    for own, other in zip(found.values, plain.values, strict=True):
        assert own == pytest.approx(other)
    with pytest.raises(UsageError, match="over control"):
        loop_map(d, "control.u", "plant.y", over={"control.omega_c": ("1 V", "2 V")}, points=4)
    best = plain.best("disturbance", Ms=(None, 1.6))
    known = loop_report(d, "control.u", "plant.y", parameters=best)
    assert plain.at(best)["Ms"] == pytest.approx(known.margins.Ms)
    assert plain.at(best)["noise"] == pytest.approx(known.peak_noise[0], rel=1e-6)


def test_the_figure_names_its_marks() -> None:
    d = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0))
    found = loop_map(d, "control.u", "plant.y", over=OVER, points=8)
    figure = found.plot("Ms", limits={"Ms": (None, 1.5)}, best="disturbance")
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["present values", "least disturbance within the limits", "outside the limits"]
    best = found.best("disturbance", Ms=(None, 1.5))
    (star,) = [line for line in figure.axes[0].lines if line.get_marker() == "*"]
    assert (star.get_xdata()[0], star.get_ydata()[0]) == tuple(best.values())
    none = found.plot("Ms", limits={"Ms": (None, 1.0)}, best="disturbance")  # no point is within the limits
    assert "least" not in str([text.get_text() for text in none.legends[0].get_texts()])
    with pytest.raises(UsageError, match="Did you mean 'Ms'"):
        found.plot("Ms", best="Msx")


def test_what_is_small_beside_the_largest_response_may_differ_by_rounding(monkeypatch: pytest.MonkeyPatch) -> None:
    d = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0, lower=-8.0, upper=8.0))
    monkeypatch.setattr(own_module, "_one_by_one", None)
    over = {"control.omega_c": (0.8, 20.0), "control.omega_o": (4.0, 100.0)}
    assert np.isfinite(loop_map(d, "control.u", "plant.y", over=over, points=40, pade=5).measures["Ms"]).all()
