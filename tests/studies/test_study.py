"""Studies: verdicts, exit codes, the report, and faults of study files."""

from __future__ import annotations

import html
import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from blocks import Case, Diagram, ModelError, SimulationError
from blocks.cli import main
from blocks.results import plots
from blocks.studies import report, report_page, study
from blocks.studies.study_checks import StudyChecks
from blocks.text.errors import Fault
from tests.support.places import ROOT

PAPER = ROOT / "diagrams" / "paper" / "study.json"


def motor_study(path: Path, **changes: Any) -> str:
    """A study of the motor under PID, with the ITAE that it has."""
    document: dict[str, Any] = {
        "format": "blocks-study",
        "version": 1,
        "name": "motor",
        "title": "A motor <b>under</b> PID",
        "source": "nowhere",
        "assumed": [{"what": "Nothing.", "why": "It is ours.", "contradicts": "nobody."}],
        "runs": {
            "soft": {"diagram": str(ROOT / "diagrams" / "motor_pid.json"), "parameters": {"kp": 10}},
            "stiff": {"diagram": str(ROOT / "diagrams" / "motor_pid.json")},
        },
        "claims": [
            {"run": "stiff", "measure": "ITAE", "published": 1.32, "tolerance": 0.01, "expect": "reproduced"},
            {"run": "soft", "measure": "ITAE", "published": 1.32, "tolerance": 0.01, "expect": "not reproduced",
             "reason": "The gain differs."},
            {"runs": ["soft", "stiff"], "measure": "dip", "as": "reduction", "published": 15.0, "unit": "%",
             "tolerance": 0.1, "expect": "reproduced"},
            {"run": "soft", "measure": "dip"},
        ],
        "figures": [
            {"name": "speed", "panels": [{"lines": [{"run": "soft", "signal": "motor.omega"}], "ylabel": "rad/s",
                                          "band": [6, 10], "inset": [0, 1, 0, 1],
                                          "markers": [{"run": "soft", "signal": "motor.omega", "label": "top"}]}]},
            {"name": "spectrum", "kind": "spectrum", "from": 2, "to": 6,
             "panels": [{"lines": [{"run": "stiff", "signal": "control.u"}], "ylabel": "V"}]},
        ],
        **changes,
    }  # fmt: skip
    path.write_text(json.dumps(document), encoding="utf-8")
    return str(path)


@pytest.mark.usefixtures("native")
def test_a_study_judges_every_claim_and_ends_with_0(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = motor_study(tmp_path / "s.json")
    assert main(["study", path, "--json", "--out", str(tmp_path / "out")]) == 0
    *claims, done = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [c["verdict"] for c in claims] == ["reproduced", "not reproduced", "reproduced", None]
    assert [c["run"] for c in claims] == ["stiff", "soft", None, "soft"]
    assert all(c["expected"] for c in claims)
    assert claims[0]["ratio"] == pytest.approx(claims[0]["value"] / 1.32)
    soft = claims[3]["value"]
    assert claims[2]["value"] == pytest.approx(100 * (1 - 0.0936159 / soft), rel=1e-4)
    assert done["event"] == "done"
    assert (done["fine"], done["reproduced"], done["claims"], done["unexpected"]) == (True, 2, 3, 0)
    assert Path(done["report"]).is_file()
    assert main(["study", path, "--latex", "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr()
    assert told.out.splitlines()[0].startswith("\\begin{tabular}")
    assert told.out.splitlines()[-1] == "\\end{tabular}"
    assert "report: " in told.err


@pytest.mark.usefixtures("native")
def test_every_form_of_the_table_has_all_claims(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    claims = [
        {"run": "my_law", "measure": "ITAE", "unit": "rad.s"},
        {"run": "other", "measure": "ITAE", "unit": "rad.s", "published": 1.32, "tolerance": 0.01,
         "expect": "not reproduced", "reason": "The gain differs."},
        {"run": "my_law", "measure": "dip", "at_most": 1, "unit": "rad/s", "expect": "holds"},
        {"runs": ["my_law", "other"], "measure": "dip", "as": "increase", "unit": "%"},
    ]  # fmt: skip
    diagram = str(ROOT / "diagrams" / "motor_pid.json")
    runs = {"my_law": {"diagram": diagram}, "other": {"diagram": diagram, "parameters": {"kp": 10}}}
    path = motor_study(tmp_path / "s.json", runs=runs, claims=claims, figures=[])

    def printed(*forms: str) -> list[str]:
        assert main(["study", path, *forms, "--out", str(tmp_path / "out")]) == 0
        return capsys.readouterr().out.splitlines()

    assert "| my_law | ITAE | - | 1.3176 rad.s | - | - | · |" in printed("--markdown")
    tex = printed("--latex")
    assert tex[0] == r"\begin{tabular}{lllllll}"
    assert r"my\_law & ITAE & - & 1.3176 rad.s & - & - &  \\" in tex
    assert [line.count(r"\_") for line in tex[4:-2]] == [1, 0, 1, 1]
    wide = printed("--wide", "--markdown")
    assert wide[0] == "| measure | unit | my_law | other | my_law / other |"
    assert wide[2] == "| ITAE | rad.s | 1.3176 | 2.60469 ✗ |  |"
    assert wide[3] == "| ITAE, published | rad.s |  | 1.32 |  |"
    assert wide[5] == "| dip, published | rad/s | ≤ 1 |  |  |"
    assert len(wide) == 7
    tex = printed("--wide", "--latex")
    assert tex[2] == r"measure & unit & my\_law & other & my\_law / other \\"
    assert tex[4] == r"ITAE & rad.s & 1.3176 & 2.60469 $\times$ &  \\"
    assert tex[7] == r"dip, published & rad/s & $\le$ 1 &  &  \\"
    assert printed("--wide")[0].split() == ["measure", "unit", "my_law", "other", "my_law", "/", "other"]


@pytest.mark.usefixtures("native")
def test_a_perturbed_parameter_turns_a_verdict_and_the_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = motor_study(tmp_path / "s.json")
    assert main(["study", path, "--out", str(tmp_path / "out"), "--set", "stiff.kp=12"]) == 1
    out = capsys.readouterr().out
    assert re.search(r"stiff .* ✗ not reproduced  <- unexpected", out)
    assert "not as the study expects" in out


class _Reader(HTMLParser):
    """Collects what a browser would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.ids: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for key, value in attrs:
            if key == "id":
                self.ids.append(value or "")
            if key in ("src", "href", "xlink:href", "data") and not (value or "").startswith("#"):
                self.fetched.append(value or "")


@pytest.mark.usefixtures("native")
def test_the_report_stands_alone_and_escapes_what_it_shows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", motor_study(tmp_path / "s.json"), "--out", str(tmp_path / "out")]) == 0
    capsys.readouterr()
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    reader = _Reader()
    reader.feed(text)
    assert reader.fetched == []
    assert not re.search(r"@import|url\((?!#)", text)
    assert len(reader.ids) == len(set(reader.ids))
    assert "A motor &lt;b&gt;under&lt;/b&gt; PID" in text
    for said in ("The gain differs.", "Contradicts the text: nobody.", "not reproduced", "SHA-256", "motor_pid"):
        assert said in text
    assert len(text) < 2_000_000
    for name in ("speed", "spectrum"):
        assert (tmp_path / "out" / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_the_papers_study_holds_all_that_was_published() -> None:
    loaded = study.load(PAPER)
    judged = [c for c in loaded.claims if c.published is not None]
    tables = [c for c in judged if c.source.startswith("Table")]
    assert len(tables) == 14
    assert sum(c.measure == "peak_e_theta" for c in judged) == 2
    assert sum(len(c.runs) == 2 for c in judged) == 5
    assert {(c.runs[0], c.measure) for c in tables if c.expected == "not reproduced"} == {
        ("ADRC", measure) for measure in ("ITAE_right", "ITAE_left", "ISU_right", "ISU_left")
    }
    assert all(c.reason for c in judged if c.expected == "not reproduced")
    assert any(entry["contradicts"] for entry in loaded.assumed)


@pytest.mark.parametrize(
    ("changes", "code", "said"),
    [
        ({"format": "blocks-diagram"}, "E006", "not a study"),
        ({"version": 2}, "E005", "Update blocks"),
        ({"version": 0}, "E005", "version 1"),
        ({"version": "1"}, "E005", 'Write "version": 1.'),
        ({"cliams": []}, "E003", "claims"),
        ({"claims": [{"run": "soft", "measure": "ITAE", "published": 1.0}]}, "E009", "tolerance"),
        ({"claims": [{"run": "sfot", "measure": "ITAE"}]}, "E105", "soft"),
        ({"claims": [{"run": "soft", "measure": "ITEA"}]}, "E105", "ITAE"),
        ({"claims": [{"runs": ["soft", "stiff"], "measure": "ITAE"}]}, "E004", "reduction"),
        (
            {"claims": [{"run": "soft", "measure": "ITAE", "published": 1, "tolerance": 0.1,
                         "expect": "not reproduced"}]},
            "E009", "reason",
        ),
        ({"runs": {"soft": {"diagram": "nowhere.json"}}}, "E007", "nowhere.json"),
        ({"figures": [{"name": "f", "panels": [{"lines": [{"run": "soft", "signal": "motor.omga"}]}]}]}, "E105",
         "motor.omega"),
    ],
)  # fmt: skip
def test_faults_of_a_study_are_told(
    changes: dict[str, Any], code: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if "runs" in changes:
        changes = {**changes, "claims": [], "figures": []}
    path = motor_study(tmp_path / "s.json", **changes)
    assert main(["study", path, "--out", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert code in err
    assert said in err


def test_the_amplitude_spectrum_of_a_sine_has_its_amplitude_at_its_frequency() -> None:
    t = np.arange(0.0, 5.0, 0.002)
    frequency, amplitude = report.amplitude_spectrum(t, 1.0 + 0.3 * np.sin(2 * np.pi * 40.0 * t))
    assert frequency[np.argmax(amplitude)] == pytest.approx(40.0, abs=0.2)
    assert np.max(amplitude) == pytest.approx(0.3, rel=1e-3)


def test_a_study_that_cannot_be_read_is_a_model_error(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"E007"):
        study.load(tmp_path / "nothing.json")


def test_plots_show_signals_by_unit_and_refuse_too_many() -> None:
    from blocks import Diagram, UsageError

    results = Diagram.load(ROOT / "diagrams" / "motor_pid.json").run(stop=2.0)
    figure = results.plot("motor.omega", "speed.y", "control.u")
    assert len(figure.axes) == 2, "two signals in rad/s share a panel"
    assert len(results.plot().axes) >= 1
    assert plots.svg_text(results.plot("motor.omega")) == plots.svg_text(results.plot("motor.omega"))
    with pytest.raises(UsageError, match="most=5"):
        results.plot(*results.names[:5])
    with pytest.raises(KeyError, match=r"motor\.omega"):
        results.plot("motor.omga")


def test_stretches_of_time_stand_beside_each_other_on_a_scale_of_their_own() -> None:
    t = np.linspace(0.0, 10.0, 101)
    line = plots.Line(t, np.where(t < 5.05, np.where(t > 4.95, 1000.0, np.sin(t)), np.cos(t)), "y")
    figure = plots.panels([plots.Panel((line, line), "y", inset=(0, 1, 0, 1))], xlabel="t", windows=[(0, 2), (8, 9)])
    first, second = figure.axes
    assert (first.get_xlim(), second.get_xlim(), first.get_ylim()) == ((0, 2), (8, 9), second.get_ylim())
    assert first.get_ylim()[1] < 1.2, "what lies in no window is not in the scale"
    drawn = second.lines[0].get_xdata()
    assert (drawn[0], drawn[-1]) == (8, 9)


def test_lines_without_a_style_differ_from_all_others_of_their_panel(tmp_path: Path) -> None:
    lines = [{"run": "stiff", "signal": name, **style} for name, style in (
        ("motor.omega", {}), ("motor.i", {"style": 1}), ("control.u", {}), ("motor.omega", {"style": None}),
        ("control.u", {}),
    )]  # fmt: skip
    path = motor_study(tmp_path / "s.json", claims=[], figures=[{"name": "f", "panels": [{"lines": lines}]}])
    loaded = study.load(path)
    figure = report._figure(loaded.figures[0], study.run(loaded).results)
    drawn = [line.get_color() for line in figure.axes[0].lines]
    assert drawn == [plots.STYLES[0][0], plots.STYLES[1][0], plots.STYLES[2][0], plots.INK, plots.STYLES[3][0]]


def test_numbers_stand_right_below_their_heads_and_carry_them_on_a_phone() -> None:
    made = report_page.table([("run", "value", "unit"), ("a", "-1.5e3", "V"), ("b", "-", "")], kinds={"V": "good"})
    assert '<th class="">run</th><th class="number">value</th><th class="">unit</th>' in made
    assert '<td class="number" data-head="value">-1.5e3</td><td class="good">V</td>' in made
    assert '<td class="number none" data-head="value">-</td><td class="none"></td>' in made


def test_all_that_is_wrong_is_told_in_its_place_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    diagram = str(ROOT / "diagrams" / "motor_pid.json")
    path = tmp_path / "study.json"
    path.write_text(
        f"""{{"format": "blocks-study", "version": 1,
 "runs": {{
  "a": {{"diagram": "{diagram}", "parameters": {{"kpp": 3}}, "settings": {{"rtol": 3}}}},
  "b": {{"diagram": "{diagram}"}}
 }},
 "claims": [
  {{"run": "b", "measure": "ITEA"}}
 ],
 "figures": [{{"name": "f", "panels": [{{"lines": [
  {{"run": "b", "signal": "motor.omegas"}}
 ]}}]}}]
}}"""
    )
    ran: list[Any] = []
    monkeypatch.setattr("blocks.api.diagram.Diagram.run", lambda self, **_: ran.append(self))
    with pytest.raises(ModelError) as caught:
        study.run(study.load(path))
    assert [(fault.code, fault.line) for fault in caught.value.faults] == [
        ("E106", 3), ("E115", 3), ("E105", 7), ("E105", 10)
    ]  # fmt: skip
    assert {fault.file for fault in caught.value.faults} == {str(path)}
    assert not ran


def test_faults_of_the_structure_of_a_study_hide_none_of_its_runs(tmp_path: Path) -> None:
    path = tmp_path / "study.json"
    diagram = str(ROOT / "diagrams" / "motor_pid.json")
    path.write_text(
        f"""{{"format": "blocks-study", "version": 1, "bogus": 2,
 "runs": {{
  "a": {{"diagram": "gone.json"}},
  "b": {{"diagram": "{diagram}", "parameters": {{"zz": 1}}}},
  "c": {{"diagram": 5}}
 }}
}}"""
    )
    made, faults = study.checked(path)
    assert made is not None
    assert [(fault.code, fault.line) for fault in faults] == [("E003", 1), ("E007", 3), ("E106", 4), ("E004", 5)]
    assert study.checked(diagram)[0] is None


# --- figures that fail, and runs that are kept -----------------------------------------------------------------


def figure_of(label: str, **more: Any) -> dict[str, Any]:
    line = {"run": "stiff", "signal": "motor.omega", "label": label}
    return {"name": "f", "panels": [{"ylabel": "$y", "lines": [line, line]}], **more}


@pytest.mark.usefixtures("native")
@pytest.mark.parametrize("label", ["cost $\\frac{x$", "$x^2$", "5 $ and 6 $", "_hidden", "\\$a\\$", "a\u0000b"])
def test_a_label_of_a_figure_is_text(label: str, tmp_path: Path) -> None:
    path = motor_study(tmp_path / "s.json", figures=[figure_of(label, xlabel="$t$ [s]")])
    assert main(["study", path, "--out", str(tmp_path / "out")]) == 0
    text = html.unescape((tmp_path / "out" / "report.html").read_text(encoding="utf-8")).replace("\u200b", "")
    for shown in (label.replace("\0", "\ufffd"), "$t$ [s]", "$y"):
        assert f">{shown}</text>" in text


@pytest.mark.long
@pytest.mark.parametrize("settings", [b"text.usetex: True\nfont.size: 30\naxes.facecolor: red\n", b"\xff\xfe: 1\n"])
def test_settings_of_matplotlib_in_the_current_folder_change_no_figure(settings: bytes, tmp_path: Path) -> None:
    """The truth is the picture of a folder without such a file: the same bytes. Settings that matplotlib itself cannot
    read cost the figures, and nothing else."""
    made = []
    for name in ("without", "with"):
        folder = tmp_path / name
        folder.mkdir()
        path = motor_study(folder / "s.json")
        if name == "with":
            (folder / "matplotlibrc").write_bytes(settings)
        command = [sys.executable, "-m", "blocks", "study", path, "--out", "out"]
        done = subprocess.run(command, cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True)
        report_text = (folder / "out" / "report.html").read_text(encoding="utf-8")
        if name == "with" and settings.startswith(b"\xff"):
            assert done.returncode == 2
            assert b"E501 figures[0] matplotlib: cannot be loaded" in done.stderr
            assert "Not drawn: cannot be loaded" in report_text
            return
        assert done.returncode == 0, done.stderr
        made.append([re.findall("<svg.*?</svg>", report_text, re.DOTALL)[0], (folder / "out/speed.png").read_bytes()])
    assert made[0] == made[1]


def test_a_figure_has_the_format_the_size_and_the_range_that_the_study_gives(tmp_path: Path) -> None:
    wide = {**figure_of("a"), "name": "wide", "format": "svg", "size": [8, 2]}
    wide["panels"] = [{**wide["panels"][0], "ylim": [-1, 3]}]
    path = motor_study(tmp_path / "s.json", figures=[{**figure_of("b"), "format": "pdf"}, wide])
    assert main(["study", path, "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "f.pdf").read_bytes().startswith(b"%PDF")
    root = ElementTree.parse(tmp_path / "out" / "wide.svg").getroot()
    assert (root.get("width"), root.get("height")) == ("576pt", "144pt")
    assert not [*(tmp_path / "out").glob("*.png")]
    wide["panels"][0]["ylim"] = [3, -1]
    path = motor_study(tmp_path / "t.json", figures=[{**wide, "format": "jpg"}])
    with pytest.raises(ModelError) as caught:
        study.load(path)
    assert [fault.place for fault in caught.value.faults] == ["figures.0.panels.0.ylim", "figures.0.format"]
    assert "[3, -1] does not end after its start" in str(caught.value)


def test_a_figure_that_fails_costs_that_figure_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn = report.plots.svg_text

    def failing(figure: Any) -> str:
        if "broken" in {one.get_text() for one in figure.axes[0].get_legend().get_texts()}:
            raise RuntimeError("no font of that kind")
        return drawn(figure)

    monkeypatch.setattr(report.plots, "svg_text", failing)
    figures = [figure_of("broken"), {**figure_of("fine"), "name": "g"}]
    path = motor_study(tmp_path / "s.json", figures=figures)
    assert main(["study", path, "--json", "--out", str(tmp_path / "out")]) == 2
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    fault = next(one for one in told if one["event"] == "fault")
    assert (fault["code"], fault["place"]) == ("E501", "figures[0]")
    assert fault["message"] == "f cannot be drawn (RuntimeError: no font of that kind)."
    assert (told[-1]["fine"], told[-1]["report"]) == (True, str(tmp_path / "out" / "report.html"))
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Not drawn: f cannot be drawn" in text
    assert ">fine<" in text
    assert (tmp_path / "out" / "g.png").is_file()


@pytest.mark.parametrize("fails", ["a later run", "the report", "the folder"])
def test_runs_that_are_done_are_kept_whatever_fails_after_them(
    fails: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The truth: the same diagram, run by itself."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    path = motor_study(tmp_path / "s.json")
    folder, run = tmp_path / "out", Diagram.run
    if fails == "a later run":

        def second(self: Diagram, case: Case) -> Any:
            if not case.parameters:
                raise SimulationError(Fault("E301", "motor.omega", "is not finite."))
            return run(self, case)

        monkeypatch.setattr(Diagram, "run", second)
        status = 3
    elif fails == "the report":
        monkeypatch.setattr(report, "summary_line", lambda made: 1 / 0)
        status = 70
    else:
        folder.write_text("a file")
        status = 2
    assert main(["study", path, "--json", "--out", str(folder)]) == status
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    kept = next(one["kept"] for one in told if one["event"] == "kept")
    assert list(kept) == (["soft"] if fails == "a later run" else ["soft", "stiff"])
    assert (Path(kept["soft"]).parent == folder) == (fails != "the folder")
    loaded = study.load(path).runs[0]
    alone = run(StudyChecks(study.load(path)).diagrams["soft"], parameters=loaded.parameters, **dict(loaded.settings))
    alone.save(tmp_path / "alone.csv")
    assert Path(kept["soft"]).read_bytes() == (tmp_path / "alone.csv").read_bytes()


def test_a_claim_is_shown_and_judged_in_its_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    claims: list[dict[str, Any]] = [
        {"run": "stiff", "measure": "dip", "at_most": 50, "unit": "mrad/s", "expect": "fails", "reason": "It dips."},
        {"run": "stiff", "measure": "dip", "published": 0.894, "unit": "rpm", "tolerance": 0.01,
         "expect": "reproduced"},
        {"run": "stiff", "measure": "overshoot", "unit": "%"},
        {"runs": ["soft", "stiff"], "measure": "dip", "as": "reduction", "unit": "%"},
        {"runs": ["soft", "stiff"], "measure": "dip", "as": "reduction"},
    ]  # fmt: skip
    loaded = study.load(motor_study(tmp_path / "study.json", claims=claims))
    made = study.run(loaded)
    measures, soft = (made.results[name].measures for name in ("stiff", "soft"))
    values = [verdict.value for verdict in made.verdicts]
    assert values[0] == pytest.approx(1000 * measures["dip"])
    assert values[1] == pytest.approx(measures["dip"] * 60 / (2 * np.pi))
    assert values[2] == 100 * measures["overshoot"]
    assert values[3] == values[4] == pytest.approx(100 * (1 - measures["dip"] / soft["dip"]))
    assert made.is_fine
    assert " mrad/s " in report.table_text(made)

    wrong = [("dip", "V", "E104", "different quantities"), ("dip", "bananas", "E114", "bananas"),
             ("overshoot", "s", "E104", "different"), ("dip", "1/s", "E104", "different")]  # fmt: skip
    claims = [{"run": "stiff", "measure": measure, "at_most": 1, "unit": unit, "expect": "holds"}
              for measure, unit, *_ in wrong]  # fmt: skip
    _, faults = study.checked(motor_study(tmp_path / "wrong.json", claims=claims))
    assert [(fault.code, fault.place) for fault in faults] == [
        (code, f"claims[{k}].unit") for k, (*_, code, _) in enumerate(wrong)
    ]
    assert all(said in fault.message and fault.line for fault, (*_, said) in zip(faults, wrong, strict=True))
    assert main(["study", str(tmp_path / "wrong.json"), "--out", str(tmp_path / "out")]) != 0
    assert "claims[0].unit" in capsys.readouterr().err
