"""What a notebook shows: figures, tables, errors, how far a call is; and what Tab and autoreload find."""

from __future__ import annotations

import importlib
import os
import re
import sys
import time
import traceback
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from IPython.core.completer import IPCompleter, provisionalcompleter
from IPython.core.interactiveshell import InteractiveShell
from IPython.extensions.autoreload import superreload
from traitlets.config import Config

from blocks import Constant, Diagram, FirstOrder, Gain, ModelError, Normal, Sum
from blocks.analysis import bode, find_operating_point, margins
from blocks.compare import compare
from blocks.host import progress_line as progress
from blocks.host.progress_line import in_rows, live_line

PNG = b"\x89PNG\r\n\x1a\n"


def loop() -> Diagram:
    made = Diagram("loop")
    r = made.add("r", Constant(value=1, unit="V"))
    error = made.add("error", Sum(signs="+-", unit="V"))
    gain = made.add("gain", Gain(k=3, unit="V", unit_u="V"))
    lag = made.add("lag", FirstOrder(T=0.5, unit="V", unit_u="V"))
    for sink, source in ((error.u1, r.y), (error.u2, lag.y), (gain.u, error.y), (lag.u, gain.y)):
        made.wire(sink, source)
    made.measure("IAE", "IAE", lag.y, r.y)
    made.settings(stop=1, method="rk4", step=0.01, log=[lag.y])
    return made


@pytest.fixture(scope="module")
def shell() -> Iterator[InteractiveShell]:
    config = Config()
    config.HistoryManager.enabled = False
    made = InteractiveShell.instance(config=config)
    made.colors = "nocolor"
    yield made
    InteractiveShell.clear_instance()


def cells_of(html: str) -> list[str]:
    return [cell.text or "" for cell in ElementTree.fromstring(html).iter() if cell.tag in ("td", "th")]


# --- figures ---------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("native")
def test_every_figure_shows_itself_once_as_svg_and_as_png(shell: InteractiveShell) -> None:
    made = loop()
    figures = [
        made.run().plot(),
        bode(made.linearizer().loop("gain.y")),
        made.sweep({"gain.k": Normal(3, 0.1)}, n=3, log=["lag.y"]).plot(),
    ]
    for figure in figures:
        shown, _ = shell.display_formatter.format(figure)
        assert {"image/svg+xml", "image/png", "text/plain"} == set(shown)
        assert shown["image/png"].startswith(PNG)
        root = ElementTree.fromstring(shown["image/svg+xml"])
        assert root.get("width") == str(round(100 * figure.get_size_inches()[0]))
        assert "prefers-color-scheme:dark" in shown["image/svg+xml"]
        assert set(figure._repr_mimebundle_(include={"image/svg+xml"})) == {"image/svg+xml"}
        assert set(figure._repr_mimebundle_(exclude={"image/svg+xml"})) == {"image/png", "text/plain"}
        assert figure.patch.get_alpha() == 0.0
    again = [made.run().plot()._repr_mimebundle_() for _ in range(2)]
    assert {**again[0], "text/plain": ""} == {**again[1], "text/plain": ""}


# --- tables ----------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("native")
def test_html_and_text_are_of_the_same_cells() -> None:
    made = loop()
    results = made.run()
    linearizer = made.linearizer()
    batch = made.batch(["gain.k"])
    shown: dict[str, Any] = {
        "V": results, "lag.y": results["lag.y"], "order": made.check(),
        "phase margin": margins(linearizer.loop("gain.y")),
        "gain.y": linearizer, "IAE": made.sweep({"gain.k": Normal(3, 0.1)}, n=4), "of range": compare(results, results),
        "4 ok": batch([[1], [2], [3], [4]]), "gain.k": batch, "computed": find_operating_point(made),
    }  # fmt: skip
    for word, thing in shown.items():
        text, html = repr(thing), thing._repr_html_()
        assert word in text
        told = "".join(ElementTree.fromstring(html).itertext())
        assert sorted(re.sub(r"[\s<>]", "", told)) == sorted(re.sub(r"^<Signal:|[\s<>]", "", text)), word
        assert thing._repr_html_() == html
        assert "color" not in html
        assert len(text) < 2000
    assert {"lag.y", "V", "min", "IAE"} <= set(cells_of(results._repr_html_()))


@pytest.mark.usefixtures("native")
def test_a_tuning_and_a_fit_show_their_tables() -> None:
    made = loop()
    tuning = made.tune(minimize="IAE", over={"gain.k": (1, 9)}, budget=6)
    assert {"gain.k", "objective at -5 % / +5 %, constraints aside"} <= set(cells_of(tuning._repr_html_()))
    assert repr(tuning) == str(tuning)
    run = made.run(parameters={"gain.k": 4})
    fit = made.fit({"time": run.t, "y": run["lag.y"]}, over={"gain.k": (1, 9)}, compare={"lag.y": "y"})
    assert {"95 % interval", "lag.y"} <= set(cells_of(fit._repr_html_()))
    for found in (tuning, fit):
        assert found.markdown().startswith("| parameter | before | ")
        assert "\n\n| s" in found.markdown(), "the second table begins after an empty line"
        assert found.markdown().count("\n| gain.k | ") == 1


def test_a_part_of_a_signal_is_shown_as_an_array() -> None:
    signal = loop().run()["lag.y"]
    assert repr(signal[:2]).startswith("Signal([")
    assert signal[:2]._repr_html_() is None
    assert repr(signal + 1).startswith("array([")
    assert repr(np.float64(signal[0])) == "np.float64(0.0)"


def test_names_are_text_in_html() -> None:
    assert "<b>" not in loop().run().changed(diagram="<b>x</b>")._repr_html_()


# --- errors ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("made.run(stop=-1)", "ModelError: E115"),
        ("made.run(parameters={'gain.q': 1})", "ModelError: E106"),
        ("results['lag.x']", "KeyError: \"there is no recorded signal 'lag.x'"),
        ("made['gian']", "KeyError: \"there is no block 'gian'"),
        ("made['gain'].out", "AttributeError: E105"),
    ],
)
def test_an_error_shows_the_users_lines_and_the_message(
    shell: InteractiveShell, capsys: pytest.CaptureFixture[str], line: str, said: str
) -> None:
    shell.user_ns.update(made=loop(), results=loop().run())
    done = shell.run_cell(f"def called():\n    return {line}\ncalled()")
    shown = capsys.readouterr().out
    assert "----> 3 called()" in shown
    assert f"----> 2     return {line}" in shown
    assert said.replace('"', "") in shown.replace('"', "")
    assert len(re.findall("^-+> ", shown, re.MULTILINE)) == 2  # none of this package
    error = done.error_in_exec
    frames = traceback.extract_tb(error.__traceback__)
    assert "blocks" in frames[-1].filename  # all of them are there for %debug and outside of a notebook
    shell.run_line_magic("xmode", "Verbose")
    try:
        shell.showtraceback()
        assert len(re.findall("^-+> ", capsys.readouterr().out, re.MULTILINE)) > 2
    finally:
        shell.run_line_magic("xmode", "Context")


def test_the_error_that_one_came_from_is_shown_where_it_has_lines_of_the_user(shell: InteractiveShell) -> None:
    from blocks import UsageError
    from blocks.text.errors import Fault

    def failed(inner: str) -> str:
        names: dict[str, Any] = {"UsageError": UsageError, "Fault": Fault, "loop": loop}
        raised = "raise UsageError(Fault('E501', 'x', 'no.')) from error"
        text = f"try:\n    {inner}\nexcept Exception as error:\n    {raised}"
        with pytest.raises(UsageError) as caught:
            exec(compile(text, "<cell>", "exec"), {"__name__": "cell", **names})
        cause = caught.value.__cause__
        shown = "\n".join(caught.value._render_traceback_())
        assert caught.value.__cause__ is cause
        return shown

    assert "ZeroDivisionError" in failed("1/0")
    assert failed("1/0").endswith("UsageError: E501 x: no.")


# --- how far a call is, and Tab ---------------------------------------------------------------------------------------


@pytest.mark.usefixtures("native")
def test_a_long_call_shows_a_line_that_is_gone_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[dict[str, str]] = []
    with live_line(None, in_rows("rows")) as told:
        assert told is None  # this is no notebook
    monkeypatch.setattr(progress, "_in_notebook", lambda: True)
    monkeypatch.setattr(progress._Line, "show", lambda line, forms: (shown.append(forms), setattr(line, "handle", 1)))
    made = loop()
    made.run()
    assert shown == []  # too short
    monkeypatch.setattr(progress, "SOON", 0.0)
    monkeypatch.setattr(progress, "AGAIN", 0.0)
    made.run()
    made.sweep({"gain.k": Normal(3, 0.1)}, n=4)
    assert shown[-1] == {"text/plain": "", "text/html": ""}
    texts = [forms["text/plain"] for forms in shown]
    assert any(text.startswith("100%  t = 1 s") for text in texts)
    assert any("of 4 rows" in text for text in texts)
    assert all(ElementTree.fromstring(f"<p>{forms['text/html']}</p>") is not None for forms in shown)
    count = len(shown)
    made.run(progress=lambda t, stop: None)  # the caller's own
    assert len(shown) == count


@pytest.mark.usefixtures("native")
def test_tab_completes_blocks_ports_and_signals(shell: InteractiveShell) -> None:
    made = loop()
    sweep = made.sweep({"gain.k": Normal(3, 0.1)}, n=2, scenarios={"quiet": {}, "loud": {"lag.T": 0.4}})
    shell.user_ns.update(made=made, results=made.run(), sweep=sweep, gain=made["gain"])
    completer = shell.Completer
    assert isinstance(completer, IPCompleter)

    def found(text: str) -> list[str]:
        with provisionalcompleter():
            return [match.text.strip("\"'].") for match in completer.completions(text, len(text))]

    assert "lag.y" in " ".join(found('results["la'))
    assert "gain" in found('made["ga')
    assert "loud" in found('sweep["lo')
    assert {"u", "y"} <= set(found("gain."))


# --- autoreload ------------------------------------------------------------------------------------------------------

MODULE = '''"""A block of a user."""

from blocks import Block, Input, Parameter, output


class Own(Block):
    """y = k u + {c}"""

    u = Input()
    k = Parameter({k})
    {more}

    @output
    def y(u, k):
        return k * u + {c}
'''


def test_autoreload_gives_blocks_of_before_the_equations_of_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: InteractiveShell
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    place = tmp_path / "own_blocks_of_notebook.py"

    def write(**values: Any) -> None:
        place.write_text(MODULE.format(**{"more": "", **values}))
        later = time.time() + 10 * values["k"]
        os.utime(place, (later, later))

    write(k=1.0, c=0)
    module = importlib.import_module(place.stem)
    Own, old = module.Own, {}
    made = Diagram("d", library=Own)
    u = made.input("u")
    made.wire(made.add("own", Own()).u, u)
    made.settings(log=["own.y"], stop=1)
    try:
        assert made.run(inputs={"u": 2})["own.y"][-1] == 2.0
        superreload(module, old_objects=old)  # remembers what there is
        write(k=3.0, c=4)
        superreload(module, old_objects=old)
        assert made.run(inputs={"u": 2})["own.y"][-1] == 10.0
        assert made.linearize("u", "own.y").D[0, 0] == 3.0
        write(k=5.0, c=4, more="q = Parameter(1.0)")
        superreload(module, old_objects=old)
        assert Own(q=2).parameters == {"q": 2}
        assert made.run(inputs={"u": 2})["own.y"][-1] == 14.0
        with pytest.raises(AttributeError, match="is declared"):
            Own.k = module.Own.u
    finally:
        sys.modules.pop(place.stem)


def test_a_drawing_is_a_text_that_a_notebook_shows_as_a_picture(shell: InteractiveShell) -> None:
    d = Diagram("x")
    d.add("a", Constant())
    data, _ = shell.display_formatter.format(d.draw(depth=2))  # type: ignore[union-attr]
    assert data["image/svg+xml"] == d.draw(depth=2)
    assert d.draw(depth=2).startswith("<svg ")


def test_a_measure_that_is_misspelled_is_refused_where_it_is_asked_for() -> None:
    d = Diagram("x")
    a = d.add("a", Constant())
    with pytest.raises(ModelError, match=r"E116 measures\.o: there is no measure \"overshot\"\. Did you mean 'over"):
        d.measure("o", "overshot", a.y)
    d.measure("o", "overshoot", a.y, 1.0)  # the name is free still, and the diagram runs
    assert "o" in d.run(stop=1).measures


def test_a_row_in_place_of_a_scenario_is_told_how_it_is_run() -> None:
    d = Diagram("x")
    d.add("a", Constant())
    with pytest.raises(KeyError, match=r"there is no scenario 1\. To run row 1 again, call single\(1\)\."):
        d.sweep({"a.value": [1.0, 2.0]}, log=["a.y"], every=0.5, stop=1)[1]
