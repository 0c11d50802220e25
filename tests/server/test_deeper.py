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

from blocks import Diagram, Gain, Integrator, Relay, Sum, TransferFunction, TransportDelay
from blocks.server import deeper, knobs, panel, scope_messages  # noqa: F401  # the messages that they answer
from blocks.server.document import Document
from blocks.server.messages import answer
from blocks.server.session import Session
from blocks.text.errors import AnalysisError, UsageError

from .test_browser import served

DIAGRAMS = Path(__file__).resolve().parents[2] / "diagrams"
Ask = Callable[..., Any]


@pytest.fixture
def asking() -> Iterator[Callable[..., tuple[Ask, Session]]]:
    """What asks a session of a diagram."""
    sessions = []

    def of(source: Any, **values: Any) -> tuple[Ask, Session]:
        session = Session(Document(source), **values)
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


def test_margins_of_a_wire_are_those_of_the_closed_form_and_of_python_control(asking: Any) -> None:
    ask, _ = asking(loop(2.0))
    told = ask("response", signal="gain.y")
    margins, curve = told["margins"], told["curve"]
    assert (margins["gain"], margins["gain_frequency"]) == (pytest.approx(3.0), pytest.approx(math.sqrt(2.0)))
    assert (margins["stable"], told["at"]["t"], told["faults"]) == (True, 0.0, [])
    system = control.tf([2.0], [1.0, 3.0, 2.0, 0.0])
    _, phase, _, crossover = control.margin(system)
    assert (margins["phase_deg"], margins["crossover"]) == (pytest.approx(phase), pytest.approx(crossover))
    assert margins["delay"] == pytest.approx(math.radians(phase) / crossover)
    values = system(1j * np.array(curve["omega"]))
    assert curve["decibel"] == pytest.approx(20.0 * np.log10(np.abs(values)))
    assert np.exp(1j * np.radians(curve["degrees"])) == pytest.approx(values / np.abs(values))
    w = curve["omega"][0]  # and the branch: an integrator and two lags
    assert curve["degrees"][0] == pytest.approx(-90.0 - math.degrees(math.atan(w) + math.atan(w / 2.0)))


def test_a_loop_that_is_not_stable_and_one_that_bears_any_gain_are_told_as_such(asking: Any) -> None:
    ask, session = asking(loop(2.0), values={"gain.k": 12.0})
    told = ask("response", signal="gain.y")["margins"]
    assert (told["stable"], told["gain"], told["gain_low"]) == (False, None, pytest.approx(0.5))
    session.values["gain.k"] = 3.0
    assert ask("response", signal="gain.y")["margins"]["gain"] == pytest.approx(2.0)
    told = asking(DIAGRAMS / "motor_pid.json")[0]("response", signal="control.u")["margins"]
    assert (told["stable"], told["gain"], told["gain_frequency"]) == (True, None, None)
    assert ["gain margin", "none: any more gain is borne"] in told["table"]


def test_a_loop_with_an_exact_delay_has_its_exact_margins(asking: Any) -> None:
    made = loop(2.0)
    made.swap("gain", TransportDelay(delay=0.5))
    ask, session = asking(made)
    told = ask("response", signal="gain.y")["margins"]
    system = control.tf([1.0], [1.0, 3.0, 2.0, 0.0])
    _, phase, _, crossover = control.margin(system)
    assert told["phase_deg"] == pytest.approx(phase - math.degrees(0.5 * crossover))
    assert told["delay"] == pytest.approx(math.radians(phase) / crossover - 0.5)
    assert told["stable"] is True
    session.values["gain.delay"] = 5.0
    assert ask("response", signal="gain.y")["margins"]["stable"] is False
    modes = ask("linear")
    assert "Padé" in modes["notes"][0]
    assert not all(mode["stable"] for mode in modes["modes"])


def test_the_response_from_an_input_is_that_of_the_closed_loop(asking: Any) -> None:
    told = asking(loop(2.0))[0]("response", input="r", output="angle.y")
    closed = control.tf([2.0], [1.0, 3.0, 2.0, 2.0])
    assert told["margins"] is None
    size = np.abs(closed(1j * np.array(told["curve"]["omega"])))
    assert told["curve"]["decibel"] == pytest.approx(20.0 * np.log10(size), abs=1e-9)


def test_what_has_no_loop_or_no_slope_is_refused_in_words_with_what_helps(asking: Any) -> None:
    ask, _ = asking(DIAGRAMS / "motor_pid.json")
    (fault,) = ask("response", signal="speed.y")["faults"]
    assert fault["code"] == "E705"
    assert "in no loop" in fault["message"]
    with pytest.raises(UsageError, match="no such signal"):
        ask("response", signal="motor.omgea")
    with pytest.raises(UsageError, match="needs a signal"):
        ask("response", signal="control.u", input="speed.y", output="motor.omega")
    ask, _ = asking(DIAGRAMS / "analysis/smeso_pd.json")
    told = ask("response", signal="control.u")
    (law,) = told["laws"]
    assert ([fault["code"] for fault in told["faults"]], told["curve"]) == (["E701"], None)
    assert (law["signal"], law["rough"], law["laws"]) == ("eso.e", True, ["eso.g"])
    told = ask("response", signal="control.u", amplitude={"eso.e": 0.001})
    assert told["margins"]["gain"] == pytest.approx(5.94, abs=0.005)  # the table of docs/frequency.md
    assert [fault["code"] for fault in ask("linear")["faults"]] == ["E701"]


def test_modes_are_the_eigenvalues_of_the_whole_diagram(asking: Any) -> None:
    told = asking(loop(2.0))[0]("linear")
    wanted = sorted(np.roots([1.0, 3.0, 2.0, 2.0]).tolist(), key=lambda p: -p.real)
    found = [complex(*mode["pole"]) for mode in told["modes"]]
    assert found == [pytest.approx(p) for p in wanted if p.imag >= 0]
    pair = told["modes"][0]
    assert pair["frequency"] == pytest.approx(abs(found[0]))
    assert pair["stable"]
    assert pair["damping"] == pytest.approx(-found[0].real / abs(found[0]))
    assert pair["time_constant"] == pytest.approx(-1.0 / found[0].real)
    assert told["states"] == ["plant.x[0]", "plant.x[1]", "angle.y"]
    assert told["sizes"]["B"] == [3, 1]
    sampled = asking(DIAGRAMS / "sampled_loop.json")[0]("linear")
    z, s = (complex(*sampled["modes"][0][key]) for key in ("pole", "s"))
    assert sampled["period"] == 0.1
    assert cmath.exp(0.1 * s) == pytest.approx(z)


def test_at_a_time_the_run_counts_with_what_was_turned_in_it(asking: Any) -> None:
    ask, session = asking(DIAGRAMS / "inverted_pendulum.json", values={"plant.m": 0.3})
    live = session.begin()
    live.set("plant.m", 0.6)
    live.go()
    assert live.wait(60.0)
    told = ask("linear", t=1.5)
    assert told["at"]["run"]
    assert told["at"]["turned"] == [["plant.m", 0.6, 0.0]]
    assert told["at"]["t"] == 1.5
    other = Diagram.load(DIAGRAMS / "inverted_pendulum.json").linearizer(at=1.5, parameters={"plant.m": 0.6}).whole()
    poles = np.linalg.eigvals(other.A)
    for mode in told["modes"]:
        assert np.min(np.abs(poles - complex(*mode["pole"]))) < 1e-6 * np.max(np.abs(poles))


def test_limit_cycles_are_found_where_the_diagram_rests(asking: Any) -> None:
    made = Diagram("relay")
    plant = made.add("plant", TransferFunction(num=[1.0], den=[1.0, 3.0, 3.0, 1.0]))
    back = made.add("back", Gain(k=-1.0))
    switch = made.add("switch", Relay(on_at=0.0, off_at=0.0, on=1.0, off=-1.0))
    for sink, source in ((plant.u, switch.y), (back.u, plant.y), (switch.u, back.y)):
        made.wire(sink, source)
    (cycle,) = asking(made)[0]("describe")["cycles"]
    assert cycle["omega"] == pytest.approx(math.sqrt(3.0))
    assert cycle["stable"] is True
    assert cycle["amplitudes"] == {"switch.u": pytest.approx(1.0 / (2.0 * math.pi))}
    with pytest.raises(AnalysisError, match="not at rest"):
        asking(DIAGRAMS / "analysis/smeso_pd.json", inputs={"r": 1.0})[0]("describe")


def test_blocks_are_colored_by_their_rates(asking: Any) -> None:
    told = asking(DIAGRAMS / "paper/iadrc_sampled.json")[0]("color", by="rate")
    rates = Diagram.load(DIAGRAMS / "paper/iadrc_sampled.json").check().rate_labels
    leaves = {path: label for path, label in told["blocks"].items() if path in rates}
    assert leaves
    assert leaves == {path: rates[path] for path in leaves}
    assert told["blocks"]["motor_right"] == "continuous"
    assert told["legend"][0] == "continuous"
    with pytest.raises(UsageError, match="no way to color"):
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


def test_a_band_holds_the_quantiles_of_a_sweep(
    asking: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Diagram("lag")
    plant = made.add("plant", TransferFunction(num=[1.0], den=[1.0, 1.0]))
    gain = made.add("gain", Gain(k=1.0))
    made.wire(gain.u, made.input("u", default=1.0))
    made.wire(plant.u, gain.y)
    made.settings(stop=2.0, every=0.5)
    made.save(tmp_path / "lag.json")
    ask, session = asking(tmp_path / "lag.json", inputs={"u": 2.0}, engine="reference")
    told = ask("band", signals=["plant.y"], vary={"gain.k": [1.0, 3.0]}, n=40)
    low, middle, high = (np.array(level[0]) for level in told["signals"]["plant.y"])
    unit = 1.0 - np.exp(-np.array(told["t"]))
    assert told["good"] == told["rows"] == 40
    assert middle == pytest.approx(4.0 * unit, rel=0.02)
    assert low == pytest.approx(2.2 * unit, rel=0.05)
    assert high == pytest.approx(5.8 * unit, rel=0.05)
    with pytest.raises(UsageError, match="2 to 500"):
        ask("band", signals=["plant.y"], vary={"gain.k": [1.0, 3.0]}, n=501)
    with pytest.raises(UsageError, match="lies outside of"):
        ask("band", signals=["plant.y"], file="../sweep.parquet")
    with monkeypatch.context() as patch:
        patch.setattr(Session, "is_asked_more", True)
        with pytest.raises(UsageError, match="another question came when 0 of 40"):
            ask("band", signals=["plant.y"], vary={"gain.k": [1.0, 3.0]}, n=40)
    two = {"measures": [], "log": ["plant.y"], "engine": "reference", "out": tmp_path / "two.parquet"}
    session.document.shown.sweep({"gain.k": [1.0, 2.0]}, **two)
    kept = ask("band", signals=["plant.y"], file="two.parquet")["signals"]["plant.y"]
    assert np.array(kept[1][0]) == pytest.approx(1.5 * unit, rel=1e-5)


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
        page.until("document.querySelectorAll('.analysis-body .chart').length === 3")
        first = page.text(".analysis-body table")
        assert "4.3126 (12.69 dB) at 41.466 rad/s" in first
        page.evaluate("document.querySelector('.law input[type=range]').focus()")
        page.press("ArrowLeft")
        page.until(f"document.querySelector('.analysis-body table').innerText !== {first!r}")
        page.evaluate("document.querySelector('.chart').focus()")
        page.press("End")
        page.until("document.querySelector('#announcer').textContent.includes('rad/s')")
        page.evaluate("document.querySelector('[data-what=modes]').click()")
        page.until("document.querySelector('.analysis-body caption')?.textContent.includes('5 states')")
        page.assert_clean()
