"""The documentation builds without a warning and without the network, its samples run, and it tells about everything.

`UPDATE_DOCS=1 python -m pytest tests/project/test_docs.py` writes what the samples print now into the pages.
"""

from __future__ import annotations

import inspect
import json
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest

import blocks
import blocks.analysis
import blocks.graph
from blocks import Block, Diagram, cli
from blocks.contract import expressions
from blocks.contract.interface import Value
from blocks.contract.type_texts import interface_of, names_of, pieces_of, resolved_of
from blocks.contract.variables import REQUIRED
from blocks.library import LIBRARY
from blocks.model import diagram_grammar as g
from blocks.model import study_grammar as s
from blocks.text import docstrings, formulas
from blocks.text.explanations import EXPLAINED
from blocks.text.grammar import Object
from tests.support.marks import long_but
from tests.support.on_numbers import numeric
from tests.support.samples import PAGES, ROOT, Page, workplace

DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS / "_ext"))

import reference  # noqa: E402

QUICK, SLOW = {"gallery/index.md"}, {"cookbook.md"}
"""Pages of subfolders whose samples every run of the tests executes, as those of all other pages are but these."""

UPDATE = bool(os.environ.get("UPDATE_DOCS"))


# --- samples ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    long_but(
        [path.relative_to(DOCS).as_posix() for path in PAGES],
        lambda name: name in QUICK or ("/" not in name and name not in SLOW),
    ),
)
def test_the_samples_of_a_page_run_and_print_what_it_says(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = Page(DOCS / name, update=UPDATE)
    with workplace(tmp_path, monkeypatch):
        page.run()
        for cls in {value for value in page.names.values() if inspect.isclass(value) and issubclass(value, Block)}:
            if cls.__module__ == "samples" and cls.__name__ != "Wrong":
                _runs(cls)
        for figure in (DOCS / "_static").glob("*.png") if UPDATE else ():
            for made in tmp_path.rglob(figure.name):
                shutil.copy(made, figure)
    if UPDATE:
        page.file.write_text(page.text, encoding="utf-8")


def _runs(cls: type[Block]) -> None:
    """A block class of a page can be run: alone, with inputs from outside, for a second."""
    diagram = Diagram("sample")
    required = {name: 0.1 for name, p in cls.declaration.parameters.items() if p.default is REQUIRED}
    handle = diagram.add("block", cls(**required))
    inputs = {}
    for name, port in interface_of(cls).inputs.items():
        source = diagram.input(f"in_{name}", unit=port.unit, size=port.size if port.shape else None, type=port.type)
        inputs[f"in_{name}"] = np.linspace(0.5, 1.5, port.size) if port.shape else port.type == "bool" or 0.7
        diagram.wire(getattr(handle, name), source)
    results = diagram.run(stop=1, inputs=inputs)
    assert results.statistics.instants > 0


# --- what the pages tell about -----------------------------------------------------------------------------------


def _rows(page: str) -> set[str]:
    """The code in the first cells of the tables of a page."""
    text = (DOCS / page).read_text(encoding="utf-8")
    cells = re.findall(r"^\| *([^|]*?) *\|", text, re.MULTILINE)
    return {word for cell in cells for word in re.findall(r"`([^`]+)`", cell)}


def test_the_page_on_files_names_every_key() -> None:
    kinds = {name: kind for module in (g, s) for name, kind in vars(module).items() if isinstance(kind, Object)}
    text = (DOCS / "diagram_file.md").read_text(encoding="utf-8")
    tables = dict(re.findall(r"^```\{keys\} (\w+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL))
    for name, kind in kinds.items():
        if not name.startswith("_") and name not in tables:
            shown = {*g.BLOCK.keys, *g.RUN.keys, *g.DIAGRAM.keys}  # what has the same keys has no table of its own
            for key in set(kind.keys) - shown:
                assert f'"{key}"' in text or f"`{key}`" in text, (name, key)
    for name, more in tables.items():
        assert {line.partition(": ")[0] for line in more.splitlines()} <= set(kinds[name].keys)
        assert all(field.doc or field.kind.doc for field in kinds[name].fields), name
    assert {"DIAGRAM", "BLOCK", "INPUT", "RUN", "MEASURE", "STUDY", "ONE_RUN", "CLAIM", "FIGURE"} <= set(tables)
    assert " ".join(expressions.FUNCTIONS) in text
    assert all(method in g.RUN.by_key["method"].doc for method in g.METHODS)


def test_the_page_on_the_contract_names_every_argument_and_every_word() -> None:
    from blocks.contract import equations
    from blocks.contract.class_body import RESERVED

    text = (DOCS / "contract.md").read_text(encoding="utf-8")
    for word in ("Parameter", "Input", "State", "Discrete", "History", "output", "local", "crossing", "wiring"):
        thing = getattr(blocks, word)
        for name in inspect.signature(thing).parameters:
            if name not in ("function", "of"):
                assert re.search(rf"\b{name}\b", text), (word, name)
    assert all(word in text for word in equations.__all__ if word[0].islower())
    assert all(f"`{name}`" in text for name in RESERVED)


def test_the_page_on_methods_names_every_method() -> None:
    assert set(g.METHODS) <= _rows("semantics.md")


def test_every_public_name_has_its_place_on_the_python_page() -> None:
    text = (DOCS / "python.md").read_text(encoding="utf-8")
    told = re.findall(r"^```\{python\} (\w+)$", text, re.MULTILINE)
    analysis = set(blocks.analysis.__all__) - {"AMPLITUDES", "describing"}
    assert sorted(told) == sorted((set(blocks.__all__) - set(LIBRARY)) | analysis | set(blocks.graph.__all__))


def test_members_of_the_classes_that_a_public_one_stands_on_are_told() -> None:
    told = dict(reference.members_of(blocks.analysis.Linearizer))
    assert {"model", "loop", "sensitivity", "complementary", "harmonic_response"} <= set(told)
    assert "tobytes" not in dict(reference.members_of(blocks.Signal)), "numpy's own are numpy's"


# --- formulas ----------------------------------------------------------------------------------------------------

XYZ = formulas.Names(frozenset({"x", "y", "z", "u", "k", "T", "at", "before", "omega", "signs"}), frozenset({"x"}))


def _first(text: str, names: formulas.Names = XYZ) -> formulas.Formula:
    return next(part for part in formulas.formulas_in(text, names) if isinstance(part, formulas.Formula))


def _shown(text: str, *, display: bool = True) -> str:
    """The MathML of a formula, shortened: {above|below} is a fraction, a_b a subscript, a^b a superscript."""
    html = formulas.html(_first(text), XYZ, display=display).replace("<wbr>", "")
    root = ElementTree.fromstring(f"<x>{html}</x>")

    def told(node: ElementTree.Element) -> str:
        parts = [told(child) for child in node]
        match node.tag:
            case "mfrac":
                return f"{{{parts[0]}|{parts[1]}}}"
            case "msub":
                return f"{parts[0]}_{parts[1]}"
            case "msup":
                return f"{parts[0]}^{parts[1]}"
            case "msqrt":
                return f"root[{''.join(parts)}]"
            case "mspace":
                return " "
        return (node.text or "") + "".join(parts)

    return "".join(told(child) for child in root).replace("\u2061", "")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("T dy/dt = k u - y", "T {dy|dt}=k u−y"),
        ("y = a/b c", "y={a|b} c"),  # from left to right
        ("y = a/(b c)", "y={a|b c}"),
        ("y = k u/T z", "y={k u|T} z"),
        ("y = (k + u)/T", "y={k+u|T}"),
        ("y = k/u/T", "y={{k|u}|T}"),
        ("y = x^2 u^(1 - k)", "y=x^2 u^1−k"),
        ("y^(n) = u", "y^(n)=u"),  # a derivative, not a power
        ("y = e^-k", "y=e^−k"),
        ("y = omega_right - z_{n+1}/b0", "y=ω_right−{z_n+1|b_0}"),
        ("dz_i/dt = z_{i+1}", "{dz_i|dt}=z_i+1"),
        ("d omega/dt = -g", "{dω|dt}=−g"),
        ("omega'' = u", "ω^′′=u"),
        ("y = sqrt(2 x/g)", "y=root[2 x/g]"),
        ("y = |x|^a sgn x", "y=|x|^a sgn x"),
        ("v = sum of k_i x_i + u", "v=∑k_i x_i+u"),
        ("y = k u + 2 integral of u", "y=k u+2 ∫u dt"),
        ("y = u1 u2 ...", "y=u_1 u_2 …"),
        ("dxn/dt = u - a_1 xn", "{dx_n|dt}=u−a_1 x_n"),
        ("d2y/dt2 + k dy/dt = u", "{d^2y|dt^2}+k {dy|dt}=u"),
        ("y = +- u1 +- u2", "y=±u_1±u_2"),
        ("x[k+1] = x[k] + u[k]", "x[k+1]=x[k]+u[k]"),
        ("y = k (s - z_1) ... (s - z_m)/((s - p_1) ... (s - p_n)) u", "y={k (s−z_1) … (s−z_m)|(s−p_1) … (s−p_n)} u"),
        ("y = atan2(u1, u2)", "y=atan2(u_1,u_2)"),
        ("0 <= t < T", "0≤t<T"),
        ("y = 1e-3 u", "y=1×10^−3 u"),
    ],
)
def test_a_formula_is_shown_as_its_text_means_it(text: str, shown: str) -> None:
    assert _first(text).text == text
    assert _shown(text) == shown


def test_in_a_line_of_text_a_fraction_has_a_slash_unless_that_would_mislead() -> None:
    assert _shown("y = k/(T u)", display=False) == "y=k/(T u)"
    assert _shown("y = k/T u", display=False) == "y={k|T} u"
    assert _shown("dy/dt = u", display=False) == "dy/dt=u"
    assert _shown("T dy/dt = u", display=False) == "T {dy|dt}=u"


@pytest.mark.parametrize(
    "text",
    [
        "u is the control error.",
        "A is n x n, B n x m, C p x n.",
        "an omega in rev/s, or 3 N.m from 25 s on",
        "the x-axis, a two-sided density, eqs. (2)-(4) and fig. 5",
        "It acts at each tick; before that y holds.",
        "num [1], den [1, -0.5], u[0]",
        "the integral of u",
        "y = a formula over the inputs",
        "the block's output and/or its inputs",
    ],
)
def test_text_stays_text(text: str) -> None:
    assert not [part for part in formulas.formulas_in(text, XYZ) if isinstance(part, formulas.Formula)]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("y = before for t < at, after for t >= at.", ["y = before", "t < at", "t >= at"]),
        ('y = "=k u", `x + y`, and u > 0', ["u > 0"]),
        ("v turns into -k v; the rest", ["-k v"]),
        ("from 0 at t = at on", ["t = at"]),
        ("Periods begin at at + k period, before + k (t - at) later", ["at + k", "before + k (t - at)"]),
        ("At k = 0 (without u) y = u/(1 + k).", ["k = 0", "y = u/(1 + k)"]),
    ],
)
def test_formulas_are_found_in_text(text: str, found: list[str]) -> None:
    parts = formulas.formulas_in(text, XYZ)
    assert [part.text for part in parts if isinstance(part, formulas.Formula)] == found


def _texts() -> Iterator[tuple[str, formulas.Names, str, str]]:
    """Every text of every block's docstring: the type, its names, the text, and its kind: summary, line or text."""
    for name, cls in LIBRARY.items():
        names = names_of(cls)
        summary, pieces = pieces_of(cls)
        yield name, names, summary, "summary"
        for piece in _each(pieces):
            if isinstance(piece, docstrings.Lines):
                yield from ((name, names, line, "line") for _, line in piece.lines)
            elif isinstance(piece, (docstrings.Paragraph, docstrings.Entry)):
                yield name, names, piece.text, "text"


def _each(pieces: list[docstrings.Piece]) -> Iterator[docstrings.Piece]:
    for piece in pieces:
        yield piece
        if isinstance(piece, docstrings.Entry):
            yield from _each(piece.pieces)


def test_no_word_of_a_docstring_is_lost() -> None:
    for name, cls in LIBRARY.items():
        summary, pieces = pieces_of(cls)
        told = summary
        for piece in _each(pieces):
            match piece:
                case docstrings.Lines():
                    told += "".join(line for _, line in piece.lines)
                case docstrings.Entry():
                    told += (f"{piece.word}:" if piece.word else "-") + piece.text
                case docstrings.References():
                    told += "References:" + "".join(piece.entries)
                case docstrings.Paragraph():
                    told += piece.text
        assert "".join(told.split()) == "".join(cls.declaration.doc.split()), name
    for name, names, text, _ in _texts():
        parts = formulas.formulas_in(text, names)
        whole = "".join(part.node.plain() if isinstance(part, formulas.Formula) else part.text for part in parts)
        assert "".join(whole.split()) == "".join(text.replace("`", "").split()), name


def test_the_lines_of_formulas_in_docstrings_can_be_read() -> None:
    """A line that cannot is shown as it is written, which is right, but seldom meant."""
    unread = [
        (name, text)
        for name, names, text, kind in _texts()
        if kind == "line" and not docstrings.is_readable(text, names)
    ]
    assert unread == []


def test_mathml_is_well_formed_and_plain() -> None:
    """Elements of MathML Core only: what every browser shows without help."""
    known = {"span", "math", "mrow", "mi", "mn", "mo", "mtext", "mspace", "mfrac", "msqrt", "msub", "msup", "wbr"}
    count = 0
    for name, names, text, _ in _texts():
        for part in formulas.formulas_in(text, names):
            if isinstance(part, formulas.Formula):
                for display in (True, False):
                    html = formulas.html(part, names, display=display).replace("<wbr>", "<wbr/>")
                    root = ElementTree.fromstring(html)
                    assert {element.tag for element in root.iter()} <= known, (name, text)
                    assert root.get("aria-label") == part.text
                count += 1
    assert count > 100


# Words behind which an equation holds only sometimes, or says something else.
CONDITIONS = re.compile(
    r"\b(where|within|for|from|else|until|while|if|at|when|unless|of|by|with|as|on|held|every|during|after|in|then)\b"
)


def test_the_equations_of_docstrings_are_those_of_the_blocks() -> None:
    """The trees of formulas, computed with the numbers that the blocks' own functions give.

    What is compared: equations without conditions, all of whose names have a value in the block.
    """
    compared: dict[str, int] = {}
    for name, names, text, kind in _texts():
        parts = formulas.formulas_in(text, names)
        for index, part in enumerate(parts if kind != "text" else []):
            around = [parts[k].text for k in (index - 1, index + 1) if 0 <= k < len(parts)]
            if not isinstance(part, formulas.Formula) or CONDITIONS.search(" ".join(around).lower()):
                continue
            if not isinstance(part.node, formulas.Relation) or [sign for sign, _ in part.node.sides] != ["", "="]:
                continue
            left, right = (side for _, side in part.node.sides)
            for seed in range(3):
                known = _numbers(LIBRARY[name], seed)
                try:
                    values = left.value(known), right.value(known)
                except (KeyError, TypeError, IndexError):
                    break
                # Terms of size 1 that cancel leave some ulp.
                np.testing.assert_allclose(values[0], values[1], rtol=1e-12, atol=1e-14, err_msg=f"{name}: {part.text}")
                compared[name] = compared.get(name, 0) + 1
    assert {"PMDCMotor", "Gain", "Kinematics", "WheelMixing", "Sine", "INTD"} <= set(compared)
    assert sum(compared.values()) >= 100


def _numbers(cls: Any, seed: int) -> dict[str, Any]:
    """A value for each name of a block, by its own functions, at a random place."""
    rng = np.random.default_rng(seed)
    d = cls.declaration
    plain = {
        key: p.default
        for key, p in d.parameters.items()
        if not p.structural and isinstance(p.default, float) and p.type == "real" and p.shape == ()
    }
    moved = {key: Value(float(value * rng.uniform(0.8, 1.2))) for key, value in plain.items()}
    resolved = resolved_of(cls, moved) or resolved_of(cls)
    interface = resolved.interface
    known: dict[str, Any] = {"t": rng.uniform(0, 2), "tick": 3.0}
    for key, value in resolved.values.items():
        if value.value is not None and key not in interface.structural:
            known[key] = value.value[()]
    for key, variable in {**d.inputs, **d.states, **d.discretes, **getattr(d, "histories", {})}.items():
        shape = interface.shape(variable)
        known[key] = rng.uniform(0.1, 0.9, shape)[()] if variable.type == "real" else np.zeros(shape, bool)[()]
    for key in (*d.outputs, *d.crossings):
        known[key] = np.zeros(interface.shape(d.readable[key]))[()]
    for _ in range(5):  # outputs read outputs, and sides
        made = numeric(interface, known)
        for key in d.outputs:
            if f"output:{key}" in made:
                known[key] = made[f"output:{key}"].reshape(interface.shape(d.outputs[key]))[()]
        for key in d.crossings:
            known[key] = bool(made[f"crossing:{key}"][0] >= 0)
    for key in d.locals:
        known[key] = made[f"local:{key}"] if made[f"local:{key}"].size > 1 else made[f"local:{key}"][0]
    for key, state in d.states.items():
        rate = made[f"derivative:{key}"].reshape(interface.shape(state))
        known[f"d{key}/dt"] = rate[()]
    known |= {key: value for key, value in interface.structural.items() if isinstance(value, (int, float))}
    for port in (*interface.inputs.values(), *interface.outputs.values()):
        if port.size == 1 and port.shape == () and port.variable in known:
            known.setdefault(port.name, np.ravel(known[port.variable])[port.first])
    return known


# --- the site ----------------------------------------------------------------------------------------------------


class _Links(HTMLParser):
    """What a page refers to: (tag, attribute, value), and its ids."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, str, str, dict[str, str | None]]] = []
        self.ids: set[str] = set()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = dict(attributes)
        self.ids.add(given.get("id") or "")
        for key in ("src", "href", "srcset", "poster", "data"):
            if given.get(key):
                self.found.append((tag, key, given[key] or "", given))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The documentation, built as `make docs` builds it, from a copy: a build writes pages beside the others."""
    folder = tmp_path_factory.mktemp("docs")
    shutil.copytree(DOCS, folder / "docs", ignore=shutil.ignore_patterns("library", "__pycache__"))
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "-d", str(folder / "trees")]
    # Plots are runs: natively where there is a compiler, as `make docs` makes them.
    env = {**os.environ, "BLOCKS_ENGINE": "auto"}
    command += [str(folder / "docs"), str(folder / "html")]
    done = subprocess.run(command, capture_output=True, text=True, env=env)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "html"


@pytest.mark.long
def test_the_site_builds_without_a_warning_and_has_every_block(site: Path) -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in (site / "library").glob("*.html"))
    for name in LIBRARY:
        assert f'id="block-{name.lower()}"' in text
        assert f"symbol of {name}" in text, f"{name} has no symbol: its ports are not known with its default sizes"
    commands = (site / "commands.html").read_text(encoding="utf-8")
    parser = cli._parser()
    verbs = next(action.choices for action in parser._actions if isinstance(action.choices, dict))
    for verb, sub in verbs.items():
        assert f"blocks {verb}" in commands
        for option in sub._option_string_actions:
            assert option in commands or option in ("-h", "--help")
    codes = (site / "errors.html").read_text(encoding="utf-8")
    assert all(f'id="{code.lower()}"' in codes for code in EXPLAINED)


@pytest.mark.long
def test_an_opened_page_asks_nothing_of_the_network(site: Path) -> None:
    """Nothing is loaded from elsewhere; links that a reader may follow are another matter."""
    for path in site.rglob("*.html"):
        links = _Links()
        links.feed(path.read_text(encoding="utf-8"))
        for tag, key, value, given in links.found:
            if tag == "a":
                continue
            assert not value.startswith(("http:", "https:", "//")), (path.name, tag, key, value, given)
    for path in site.rglob("*.css"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"@import|url\(\s*['\"]?(https?:)?//", text), path
    for path in site.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"url\(\s*['\"]?(https?:)?//|MathJax|katex", text, re.IGNORECASE), path


@pytest.mark.long
def test_every_link_inside_the_site_leads_somewhere(site: Path) -> None:
    pages = {}
    for path in site.rglob("*.html"):
        pages[path.resolve()] = links = _Links()
        links.feed(path.read_text(encoding="utf-8"))
    for path, links in pages.items():
        for tag, _, value, _ in links.found:
            parts = urlsplit(value)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert target.exists(), (path.name, value)
            if tag == "a" and parts.fragment and target in pages:
                assert unquote(parts.fragment) in pages[target].ids, (path.name, value)


@pytest.mark.long
def test_simulinks_words_lead_to_blocks_and_pages_that_are_there(site: Path) -> None:
    words = json.loads((ROOT / "blocks" / "model" / "simulink_words.json").read_text(encoding="utf-8"))
    assert {"Scope", "Clock", "Fcn", "Memory", "To Workspace", "Goto", "Rate Transition", "S-Function"} <= set(words)
    assert list(words) == sorted(words, key=str.lower)
    for word, entry in words.items():
        assert set(entry) == {"here", "blocks", "see"}, word
        assert set(entry["blocks"]) <= set(LIBRARY), word
        name, _, anchor = entry["see"].partition("#")
        text = (site / name).with_suffix(".html").read_text(encoding="utf-8")
        assert not anchor or f'id="{anchor}"' in text, (word, entry["see"])
        assert word in (site / "glossary.html").read_text(encoding="utf-8").replace("&amp;", "&"), word
