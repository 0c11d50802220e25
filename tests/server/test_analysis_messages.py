"""Loops, linear models, rates and bands that a live page asks for."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

from blocks import Case, Diagram, Gain, Integrator, Pulse, Relay, Sum, TransferFunction, TransportDelay, ZeroOrderHold
from blocks.server import analysis_messages, knobs, panel, scope_messages  # noqa: F401  # the messages that they answer
from blocks.server.messages import answer
from blocks.server.open_document import Document
from blocks.server.session import Session
from blocks.text.errors import AnalysisError, UsageError

from .test_browser import served

DIAGRAMS = Path(__file__).resolve().parents[2] / "diagrams"
Ask = Callable[..., Any]


@pytest.fixture
def asking() -> Iterator[Callable[..., tuple[Ask, Session]]]:
    """What asks a session of a diagram."""
    sessions = []

    def of(source: Any, **words: Any) -> tuple[Ask, Session]:
        session = Session(Document(source), Case(**words))
        sessions.append(session)
        return lambda do, **fields: answer(session, {"do": do, **fields}), session

    yield of
    for session in sessions:
        session.close()


def loop(k: float) -> Diagram:
    """k/(s (s + 1)(s + 2)) with negative feedback: at the border for k = 6, at sqrt(2) rad/s."""
    made = Diagram("servo")
    error, gain = made.add("error", Sum(signs="+-")), made.add("gain", Gain(k=k))
    plant, angle = made.add("plant", TransferFunction(num=[1.0], den=[1.0, 3.0, 2.0])), made.add("angle", Integrator())
    made.wire(error.u1, made.input("r", default=0.0))
    for sink, source in ((gain.u, error.y), (plant.u, gain.y), (angle.u, plant.y), (error.u2, angle.y)):
        made.wire(sink, source)
    return made


def told_poles(told: dict[str, Any]) -> list[complex]:
    return [complex(row[0].replace(" ± ", "+").replace(" ", "")) for row in told["rows"]]


def test_margins_of_a_wire_are_those_of_the_closed_form_and_of_python_control(asking: Any) -> None:
    ask, _ = asking(loop(2.0))
    told = ask("response", input="gain.y")
    margins = told["margins"]
    assert margins["gain"] == pytest.approx(3.0)
    assert (margins["stable"], told["title"], told["faults"]) == (
        True, "Loop opened at gain.y. Linearized at t = 0 s.", [],
    )  # fmt: skip
    assert ["gain margin", "3 (9.542 dB) at 1.4142 rad/s"] in told["rows"]
    system = control.tf([2.0], [1.0, 3.0, 2.0, 0.0])
    _, phase, _, crossover = control.margin(system)
    assert (margins["phase_deg"], margins["crossover"]) == (pytest.approx(phase), pytest.approx(crossover))
    assert margins["delay"] == pytest.approx(math.radians(phase) / crossover)
    omega, decibel, degrees = told["curve"]
    values = system(1j * np.array(omega))
    assert decibel == pytest.approx(20.0 * np.log10(np.abs(values)))
    assert np.exp(1j * np.radians(degrees)) == pytest.approx(values / np.abs(values))
    w = omega[0]  # and the branch: an integrator and two lags
    assert degrees[0] == pytest.approx(-90.0 - math.degrees(math.atan(w) + math.atan(w / 2.0)))
    assert [figure[:4] for figure in told["figures"]] == ["<svg", "<svg"]


def test_a_channel_that_is_fragile_together_with_the_others_has_a_note(asking: Any) -> None:
    ask, _ = asking(DIAGRAMS / "analysis" / "satellite.json")
    told = ask("response", input="k.y[0]")
    assert told["margins"]["phase_deg"] == pytest.approx(90.0)
    assert told["more"][0].startswith("W701 k.y[0]: this margin is of one channel alone.")
    with pytest.raises(UsageError, match=r"E501 k\.y: has 2 elements"):
        ask("response", input="k.y")


def test_a_loop_that_is_not_stable_and_one_that_bears_any_gain_are_told_as_such(asking: Any) -> None:
    ask, session = asking(loop(2.0), parameters={"gain.k": 12.0})
    told = ask("response", input="gain.y")["margins"]
    assert (told["stable"], told["gain"], told["gain_low"]) == (False, None, pytest.approx(0.5))
    session.values["gain.k"] = 3.0
    assert ask("response", input="gain.y")["margins"]["gain"] == pytest.approx(2.0)
    told = asking(DIAGRAMS / "motor_pid.json")[0]("response", input="control.u")
    assert (told["margins"]["stable"], told["margins"]["gain"]) == (True, None)
    assert ["gain margin", "none: the loop stays stable for any larger gain"] in told["rows"]


def test_a_loop_with_an_exact_delay_has_its_exact_margins(asking: Any) -> None:
    made = loop(2.0)
    made.swap("gain", TransportDelay(delay=0.5))
    ask, session = asking(made)
    told = ask("response", input="gain.y")["margins"]
    system = control.tf([1.0], [1.0, 3.0, 2.0, 0.0])
    _, phase, _, crossover = control.margin(system)
    assert told["phase_deg"] == pytest.approx(phase - math.degrees(0.5 * crossover))
    assert told["delay"] == pytest.approx(math.radians(phase) / crossover - 0.5)
    assert told["stable"] is True
    session.values["gain.delay"] = 5.0
    assert ask("response", input="gain.y")["margins"]["stable"] is False
    modes = ask("modes")
    assert "Padé" in modes["notes"][1]
    assert "no" in [row[1] for row in modes["rows"]]


def test_a_sampled_loop_with_a_delay_is_exact_unless_the_delay_acts_back_on_itself(asking: Any) -> None:
    parts = {"hold": ZeroOrderHold(period=0.5), "late": TransportDelay(delay=0.3), "sum": Sum()}
    parts |= {"plant": TransferFunction(num=[1.0], den=[1.0, 3.0, 2.0, 0.0]), "back": Gain(k=-1.0), "own": Gain(k=0.0)}
    made = Diagram("late")
    for name, block in parts.items():
        made.add(name, block)
    wires = {"late.u": "hold", "sum.u1": "late", "sum.u2": "own", "plant.u": "sum", "own.u": "plant", "back.u": "plant"}
    for sink, source in (wires | {"hold.u": "back"}).items():
        made.wire(sink, f"{source}.y")
    ask, _ = asking(made)
    told = ask("response", input="hold.y")
    assert "Padé" not in " ".join(told["more"])
    # 1/(s (s + 1)(s + 2)) and a dead time behind a hold: by the partial fractions 1/2, -1, 1/2 of the poles 0, -1, -2.
    z, T, rest = cmath.exp(0.2j * 0.5), 0.5, 0.5 - 0.3
    L = 0j
    for residue, pole in ((0.5, 0.0), (-1.0, -1.0), (0.5, -2.0)):
        late, whole = ((cmath.exp(pole * t) - 1.0) / pole if pole else t for t in (rest, T))
        L += residue * (late + (whole - late) / z) / (z - cmath.exp(pole * T))
    omega, decibel, _ = told["curve"]
    assert np.interp(0.2, omega, decibel) == pytest.approx(20.0 * math.log10(abs(L)), abs=1e-2)
    assert told["margins"]["stable"] is True
    assert "Padé" not in " ".join(ask("modes")["notes"])
    made.swap("own", TransportDelay(delay=0.2))
    told = asking(made)[0]("response", input="hold.y")
    assert told["more"][0].startswith("All of this: with Padé models")


def test_the_response_from_an_input_is_that_of_the_closed_loop(asking: Any) -> None:
    told = asking(loop(2.0))[0]("response", input="r", output="angle.y")
    closed = control.tf([2.0], [1.0, 3.0, 2.0, 2.0])
    assert "margins" not in told
    omega, decibel, _ = told["curve"]
    assert decibel == pytest.approx(20.0 * np.log10(np.abs(closed(1j * np.array(omega)))), abs=1e-9)


def test_what_has_no_loop_or_no_slope_is_refused_in_words_with_what_helps(asking: Any) -> None:
    ask, _ = asking(DIAGRAMS / "motor_pid.json")
    (fault,) = ask("response", input="speed.y")["faults"]
    assert fault["code"] == "E705"
    assert "not part of a loop" in fault["message"]
    with pytest.raises(UsageError, match="no such signal"):
        ask("response", input="motor.omgea")
    with pytest.raises(UsageError, match="is not a point of the run"):
        ask("response", input="control.u", at="end")
    ask, _ = asking(DIAGRAMS / "analysis/smeso_pd.json")
    told = ask("response", input="control.u")
    (law,) = told["laws"]
    assert [(fault["code"], "slider" in fault["cure"]) for fault in told["faults"]] == [("E701", True)]
    assert (law["signal"], law["rough"], law["laws"]) == ("eso.e", True, ["eso.g"])
    told = ask("response", input="control.u", amplitude={"eso.e": 0.001})
    assert told["margins"]["gain"] == pytest.approx(5.94, abs=0.005)  # the table of docs/frequency.md
    assert [fault["code"] for fault in ask("modes")["faults"]] == ["E701"]


def test_modes_are_the_eigenvalues_of_the_whole_diagram(asking: Any) -> None:
    told = asking(loop(2.0))[0]("modes")
    wanted = sorted(np.roots([1.0, 3.0, 2.0, 2.0]).tolist(), key=lambda p: -p.real)
    assert told_poles(told) == [pytest.approx(p, rel=1e-5) for p in wanted if p.imag >= 0]
    _, decays, damping, frequency, constant, states = told["rows"][0]
    assert (decays, frequency, constant) == ("yes", pytest.approx(abs(wanted[0])), pytest.approx(-1 / wanted[0].real))
    assert damping == pytest.approx(-wanted[0].real / abs(wanted[0]))
    assert {*states.split(", ")} <= {"plant.x[0]", "plant.x[1]", "angle.y"}
    assert told["notes"] == ["3 states."]
    sampled = asking(DIAGRAMS / "sampled_loop.json")[0]("modes")
    _, _, damping, frequency, _, _ = sampled["rows"][0]
    s = frequency * complex(-damping, math.sqrt(1.0 - damping**2))
    assert sampled["head"][0] == "eigenvalue [z, sampled every 0.1 s]"
    assert cmath.exp(0.1 * s) == pytest.approx(told_poles(sampled)[0], rel=1e-5)


def test_at_a_time_the_run_counts_with_what_was_turned_in_it(asking: Any) -> None:
    ask, session = asking(DIAGRAMS / "inverted_pendulum.json", parameters={"plant.m": 0.3})
    live = session.begin()
    live.set("plant.m", 0.6)
    live.go()
    assert live.wait(60.0)
    told = ask("modes", at=1.5)
    assert told["title"] == "Linearized at t = 1.5 s of the run, with plant.m = 0.6 set in it."
    other = Diagram.load(DIAGRAMS / "inverted_pendulum.json").linearizer(at=1.5, parameters={"plant.m": 0.6}).whole()
    poles = np.linalg.eigvals(other.A)
    assert all(np.min(np.abs(poles - pole)) < 1e-5 * np.max(np.abs(poles)) for pole in told_poles(told))


def test_limit_cycles_are_found_where_the_diagram_rests(asking: Any) -> None:
    made = Diagram("relay")
    plant = made.add("plant", TransferFunction(num=[1.0], den=[1.0, 3.0, 3.0, 1.0]))
    back = made.add("back", Gain(k=-1.0))
    switch = made.add("switch", Relay(on_at=0.0, off_at=0.0, on=1.0, off=-1.0))
    for sink, source in ((plant.u, switch.y), (back.u, plant.y), (switch.u, back.y)):
        made.wire(sink, source)
    ask = asking(made)[0]
    ((omega, period, stable, amplitudes, _),) = ask("cycles", at="start")["rows"]
    assert (omega, period) == (pytest.approx(math.sqrt(3.0)), pytest.approx(2.0 * math.pi / math.sqrt(3.0)))
    assert (stable, amplitudes) == ("yes", f"switch.u {1.0 / (2.0 * math.pi):.4g}")
    with pytest.raises(AnalysisError, match="at the start"):  # a relay at its edge is found at rest by no search
        ask("cycles")
    with pytest.raises(AnalysisError, match="not at rest"):
        asking(DIAGRAMS / "analysis/smeso_pd.json", inputs={"r": 1.0})[0]("cycles", at="start")


def test_blocks_are_colored_by_their_rates(asking: Any) -> None:
    told = asking(DIAGRAMS / "paper/iadrc_sampled.json")[0]("color", by="rate")
    rates = Diagram.load(DIAGRAMS / "paper/iadrc_sampled.json").check().rate_labels
    leaves = {path: label for path, label in told["blocks"].items() if path in rates}
    assert leaves
    assert leaves == {path: rates[path] for path in leaves}
    assert told["blocks"]["motor_right"] == "continuous"
    assert told["legend"][0] == "continuous"
    with pytest.raises(UsageError, match="not a way to color"):
        asking(DIAGRAMS / "motor_pid.json")[0]("color", by="speed")


def test_blocks_are_colored_by_the_steps_that_were_rejected_for_them(asking: Any) -> None:
    ask, session = asking(DIAGRAMS / "paper/iadrc.json", engine="reference")
    live = session.begin(2.0)
    live.go()
    assert live.wait(60.0)
    blocks = ask("color", by="rejected")["blocks"]
    assert sum(count for path, count in blocks.items() if "." not in path) == live.rejected > 0
    inside = sum(count for path, count in blocks.items() if path.startswith("control_right."))
    assert blocks["control_right"] == inside
    with pytest.raises(UsageError, match="no run"):
        asking(DIAGRAMS / "motor_pid.json")[0]("color", by="rejected")


def test_a_band_holds_the_quantiles_of_a_sweep(asking: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = Diagram("lag")
    plant = made.add("plant", TransferFunction(num=[1.0], den=[1.0, 1.0]))
    gain = made.add("gain", Gain(k=1.0))
    made.wire(gain.u, made.input("u", default=1.0))
    made.wire(plant.u, gain.y)
    made.settings(stop=2.0, every=0.5)
    made.save(tmp_path / "lag.json")
    ask, session = asking(tmp_path / "lag.json", inputs={"u": 2.0}, engine="reference")
    asked: dict[str, Any] = {"signal": "plant.y", "parameter": "gain.k", "low": 1.0, "high": 3.0, "n": 40}
    told = ask("band", **asked)
    low, middle, high = (np.array(level[0]) for level in told["band"]["signals"]["plant.y"])
    unit = 1.0 - np.exp(-np.array(told["band"]["t"]))
    assert told["title"] == "Band of plant.y over 40 of 40 runs."
    assert middle == pytest.approx(4.0 * unit, rel=0.02)
    assert low == pytest.approx(2.2 * unit, rel=0.05)
    assert high == pytest.approx(5.8 * unit, rel=0.05)
    with pytest.raises(UsageError, match="2 to 500"):
        ask("band", **{**asked, "n": 501})
    with pytest.raises(UsageError, match="lies outside the"):
        ask("band", signal="plant.y", file="../sweep.parquet")
    with monkeypatch.context() as patch:
        patch.setattr(Session, "is_asked_more", True)
        with pytest.raises(UsageError, match="another request stopped this one when 0 of 40"):
            ask("band", **asked)
    two = {"measures": [], "log": ["plant.y"], "engine": "reference", "out": tmp_path / "two.parquet"}
    session.document.shown.sweep({"gain.k": [1.0, 2.0]}, **two)
    kept = ask("band", signal="plant.y", file="two.parquet")["band"]["signals"]["plant.y"]
    assert np.array(kept[1][0]) == pytest.approx(1.5 * unit, rel=1e-5)


def test_an_amplitude_without_a_linear_model_is_refused_and_can_be_chosen_anew(asking: Any) -> None:
    made = loop(2.0)
    made.swap("gain", Relay(on_at=0.5, off_at=-0.5, on=1.0, off=-1.0))
    ask, _ = asking(made)
    told = ask("response", input="gain.y", amplitude={"gain.u": 0.6})
    assert [(fault["code"], "slider" in fault["cure"]) for fault in told["faults"]] == [("E704", True)]
    assert [(law["signal"], law["laws"]) for law in told["laws"]] == [("gain.u", ["gain.y"])]


def test_a_value_that_was_set_twice_is_told_as_it_is(asking: Any) -> None:
    ask, session = asking(DIAGRAMS / "inverted_pendulum.json")
    live = session.begin()
    for mass in (0.6, 0.7):
        live.set("plant.m", mass)
    live.go()
    assert live.wait(60.0)
    assert ask("modes", at=1.0)["title"] == "Linearized at t = 1 s of the run, with plant.m = 0.7 set in it."


def test_a_band_keeps_a_peak_of_one_row(asking: Any, tmp_path: Path) -> None:
    made = Diagram("pulse")
    pulse = made.add("pulse", Pulse(on=0.50005, off=0.50015))
    gain = made.add("gain", Gain(k=1.0))
    made.wire(gain.u, pulse.y)
    made.settings(stop=1.0, every=1e-4)
    made.save(tmp_path / "pulse.json")
    told = asking(tmp_path / "pulse.json")[0]("band", signal="gain.y", parameter="gain.k", low=1.0, high=3.0, n=4)
    (levels,) = told["band"]["signals"].values()
    high = np.array(levels[2][0])
    t = np.array(told["band"]["t"])
    assert len(t) < 1500
    assert (t[0], t[-1]) == (0.0, 1.0)
    assert np.all(np.diff(t) >= 0.0)
    assert t[high > 0.0] == pytest.approx([0.5], abs=2e-3)  # one row in 10,001
    assert high.max() > 2.0


@pytest.mark.long
def test_a_page_shows_the_margins_of_the_wire_that_is_clicked(chromium: Any) -> None:
    with served(DIAGRAMS / "analysis/smeso_pd.json") as server, chromium() as page:
        page.open(server.url)
        page.until("document.querySelector('#drawing [data-net=\"control.u\"] path')")
        x, y = page.evaluate(
            "(() => { const line = document.querySelector('[data-net=\"control.u\"] path.run');"
            " const p = line.getPointAtLength(9).matrixTransform(line.getScreenCTM()); return [p.x, p.y]; })()"
        )
        page.click_at(x, y)
        page.press("b")
        page.until("document.querySelector('.analysis-body .fault')?.textContent.includes('infinite slope')")
        page.click(".law input[type=checkbox]")
        page.until("[...document.querySelectorAll('.result img')].filter(one => one.naturalWidth > 0).length === 2")
        first = page.text(".result table")
        assert "4.3126 (12.69 dB) at 41.466 rad/s" in first
        page.evaluate("document.querySelector('.law input[type=range]').focus()")
        page.press("ArrowLeft")
        page.until(f"document.querySelector('.result table').innerText !== {first!r}")
        page.evaluate("document.querySelector('[aria-label=\"Read out the curve\"]').focus()")
        page.press("End")
        page.until("document.activeElement.getAttribute('aria-valuetext').startsWith('1000 rad/s: -')")
        page.evaluate("document.querySelector('[data-what=modes]').click()")
        page.until("document.querySelector('.result thead')")
        assert page.text(".result .hint") == "5 states."
        page.assert_clean()
