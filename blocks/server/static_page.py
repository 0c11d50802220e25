"""A diagram with the results of a run as one HTML file: the page of `blocks live`, with its answers written into it.

The modules of the page are joined into one script; `static.js` stands in place of the connection. The file asks for
nothing from any network, and its content security policy lets that one script run.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..api.diagram import Diagram
from ..results.plots import STYLES, Line
from ..results.results import Results
from ..text.arrays import Array
from ..text.element_names import element_names, whole_of
from ..text.errors import Fault, UsageError
from ..text.printable import counted, quoted
from . import panel, scope_messages  # noqa: F401  # what they answer stands in the page
from .curves import thinned
from .messages import answer
from .open_document import Document
from .session import Session

if TYPE_CHECKING:
    from ..results.figure import Figure

PAGE = Path(__file__).parent / "page"
MOST = 3_000_000
"""Bytes of rows in a page; of more rows each stretch keeps its least and its largest value."""
MOST_OF_FIGURES = 700_000
"""The same of all figures of a report."""
LEFT_OUT = frozenset({"runbar.js", "knobs.js", "analysis.js"})
"""Modules that need a server."""
_IMPORT = re.compile(r"^import (?:\* as (\w+)|\{([^}]*)\}|(\w+)) from \"\./([\w./]+)\";\n", re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function\*?|class|const|let) (\w+))", re.MULTILINE)
_DEFAULT = re.compile(r"^export \{ (\w+) as default \};$|^export default (\w+);$", re.MULTILINE)


def page_of(diagram: Diagram, results: Results | None = None, *, variants: Mapping[str, str] | None = None) -> str:
    """The page as HTML. results: what its scopes and values show; without them it is the drawing alone."""
    session = Session(Document(diagram, variants=variants))
    try:
        hello = session.hello()
        document = hello["document"]
        levels = ["", *(block["path"] for block in document["blocks"] if block["kind"] == "diagram")]
        asked: list[dict[str, object]] = [{"do": "draw", "level": level} for level in levels]
        asked += [{"do": "panel", "path": path} for path in ["", *(block["path"] for block in document["blocks"])]]
        told = [answer(session, one) or {} for one in asked]
        for row in (row for one in told for rows in one.get("rows", {}).values() for row in rows):
            row["knob"] = row["knob"] and {**row["knob"], "why": ""}  # nothing is turned here
        answers = [[list(one.values()), what] for one, what in zip(asked, told, strict=True)]
    finally:
        session.close()
    rows, words = _rows(results), ""
    document["signals"] = [] if results is None else _signals(document, results)
    if results is not None:
        statistics = results.statistics
        hello["run"] |= {
            "id": 1, "state": "done", "start": results.span[0], "t": results.span[1], "stop": results.span[1],
            "steps": statistics.steps, "rejected": statistics.rejected, "seconds": statistics.seconds, "faults": [],
        }  # fmt: skip
        words = f"a run to {results.span[1]:.10g} s: {results.rows:,} rows of {counted(len(results.columns), 'signal')}"
        if rows["stretches"]:
            words += f", shown by the least and the largest value of each of {rows['stretches']:,} stretches"
    return _html(document["name"], {"hello": hello, "answers": answers, "rows": rows}, words)


def _signals(document: Mapping[str, Any], results: Results) -> list[dict[str, Any]]:
    """The signals that the results hold. Raises UsageError (E501) where none is of the diagram."""
    paths, inputs = {block["path"] for block in document["blocks"]}, {one["name"] for one in document["inputs"]}
    signals = [
        {"name": name, "unit": unit, "shape": list(shape), "block": whole_of(name, paths)}
        for name, (_, shape, unit) in results.columns.items()
    ]
    if not any(one["block"] or one["name"] in inputs for one in signals):
        message = f"they contain no signal of {quoted(document['name'])}, only {', '.join(results.names[:8])}."
        raise UsageError(Fault("E501", "results", message, "Give a file that `blocks run` wrote for this diagram."))
    return signals


def _rows(results: Results | None) -> dict[str, Any]:
    """The rows as base64, float64 times and float32 columns; of too many the least and largest of each stretch."""
    if results is None:
        return {"t": "", "values": "", "columns": [], "units": {}, "elements": {}, "stretches": 0}
    count = results.values.shape[1]
    t, values = thinned(results.t, results.values, most := max(1000, MOST // (8 + 4 * count)))
    return {
        **_encoded(t, values),
        "columns": [name for name, _, _ in sorted(results.flat_columns(), key=lambda one: one[1])],
        "units": {name: unit for name, _, unit in results.flat_columns()},
        "elements": {name: element_names(name, shape) for name, (_, shape, _) in results.columns.items()},
        "stretches": most // 2 if len(t) < results.rows else 0,
    }


def _encoded(t: Array, values: Array) -> dict[str, str]:
    """Times as float64 and columns, one after the other, as float32, in base64."""
    with np.errstate(over="ignore"):  # what is too large for a picture is infinite there
        columns = values.T.astype("<f4")
    return {
        "t": base64.b64encode(t.astype("<f8").tobytes()).decode(),
        "values": base64.b64encode(columns.tobytes()).decode(),
    }


# --- figures of reports ----------------------------------------------------------------------------------------------


def zooming(figures: Mapping[str, Figure]) -> tuple[str, str]:
    """What lets figures of a report zoom: the policy for its head, and the rows and the script for its end."""
    count = sum(len(part.lines) for figure in figures.values() for part in figure.parts)
    most = max(1000, MOST_OF_FIGURES // (5 * count))
    told = [_zoomed(name, figure, most) for name, figure in figures.items()]
    script = joined("figures.js", {})
    style = "".join(path.read_text(encoding="utf-8") for path in PAGE.glob("vendor/*.css"))
    end = f"""<style>{style}{_FIGURES}</style>
<script type="application/json" id="zoom">{script_safe(told)}</script>
<script type="module">{script}</script>"""
    return _policy(script), end


def _zoomed(name: str, figure: Figure, most: int) -> dict[str, object]:
    """The rows of a figure; lines of the same times stand together."""
    panels, is_thin = [], False
    for part in figure.parts:
        groups: dict[bytes, tuple[Array, list[Array], list[dict[str, object]]]] = {}
        for line in part.lines:
            x, ys, lines = groups.setdefault(np.asarray(line.x).tobytes(), (np.asarray(line.x, float), [], []))
            ys.append(np.asarray(line.y, float))
            lines.append(
                {"label": line.label, "style": line.style, "dash": _dash(line), "points": line.look == "points"}
            )
        for mark in part.markers:
            spot = {"label": mark.label, "style": mark.style, "dash": [], "points": True}
            groups[f"{len(groups)}".encode()] = np.array([mark.x]), [np.array([mark.y])], [spot]
        told = []
        for x, ys, lines in groups.values():
            t, values = thinned(x, np.stack(ys, axis=1), most)
            is_thin |= len(t) < len(x)
            told.append({**_encoded(_apart(t), values), "lines": lines})
        panels.append(
            {"ylabel": part.ylabel, "log": part.log, "height": part.height, "band": part.band, "groups": told}
        )
    words = "drag or press + to zoom in; double-click or press 0 to see all"
    if is_thin:
        words += f"; of each of {most // 2:,} stretches the least and the largest value"
    return {"name": name, "along": figure.along, "panels": panels, "told": words}


def _dash(line: Line) -> list[float]:
    if line.style is None:
        return [2, 4]
    pattern = STYLES[line.style % len(STYLES)][1]
    return [] if isinstance(pattern, str) else [2 * float(length) for length in pattern[1]]


def _apart(t: Array) -> Array:
    """Times that rise: of rows of one time, as a jump has them, each later one stands at the next number."""
    t = t.copy()
    for k in np.flatnonzero(np.diff(t) <= 0) + 1:
        t[k] = np.nextafter(t[k - 1], np.inf)
    return t


# --- the file --------------------------------------------------------------------------------------------------------


def _html(title: str, content: Mapping[str, object], told: str) -> str:
    """index.html with all that it names written into it."""
    script = joined("main.js", {"connection.js": "static.js"})
    page = _HEAD.sub("", (PAGE / "index.html").read_text(encoding="utf-8"))
    style = "".join(path.read_text(encoding="utf-8") for path in (PAGE / "style.css", *PAGE.glob("vendor/*.css")))
    head = f"""{_policy(script)}<title>{html.escape(title)}</title>
<style>{style}{_STATIC}</style>
</head>"""
    body = f"""<script type="application/json" id="content">{script_safe(content)}</script>
<script type="module">{script}</script>
</body>"""
    page = _RUNBAR.sub(lambda _: f'<header id="runbar">{html.escape(told or "no run")}</header>', page)
    return page.replace("</head>", head).replace("</body>", body)


def _policy(script: str) -> str:
    """The content security policy of a page that runs this script and asks for nothing."""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    rules = f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'; base-uri 'none'"
    return f'<meta http-equiv="Content-Security-Policy" content="{rules}">\n'


def script_safe(content: object) -> str:
    """JSON that may stand in a script element: no text in it ends the element, or begins a comment."""
    return json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def joined(main: str, instead: Mapping[str, str]) -> str:
    """A module of the page and all that it imports as the text of one module. instead: modules in place of others."""
    parts: dict[str, str] = {}
    _join(main, instead, parts, ())
    text = "const modules = {};\n" + "".join(parts.values())
    assert "</script" not in text.lower(), "the page's code ends its own element"
    return text


def _join(name: str, instead: Mapping[str, str], parts: dict[str, str], above: tuple[str, ...]) -> None:
    """Put a module into `parts`, after those that it imports."""
    assert name not in above, f"modules import each other: {', '.join((*above, name))}"
    if name in parts:
        return
    text = "export function start() {}\n"
    if name not in LEFT_OUT:
        text = (PAGE / instead.get(name, name)).read_text(encoding="utf-8")
    for _, _, _, path in _IMPORT.findall(text):
        _join(_beside(name, path), instead, parts, (*above, name))
    given = {}
    for first, second in _DEFAULT.findall(text):
        given["default"] = first or second
    text = _DEFAULT.sub("", _IMPORT.sub(lambda found: _imported(name, found), text))
    if not name.startswith("vendor/"):  # which has one export, and speaks of others in comments
        given |= {found: found for found in _EXPORT.findall(text)}
        text = _EXPORT.sub("", text)
        assert not re.search(r"^(import|export)\b", text, re.MULTILINE), f"{name}: an import or export of another form"
    names = ", ".join(f"{key}: {value}" for key, value in given.items())
    parts[name] = f'modules["{name}"] = (() => {{\n{text}\nreturn {{ {names} }};\n}})();\n'


def _imported(name: str, found: re.Match[str]) -> str:
    whole, some, default, path = found.groups()
    taken = whole or (f"{{ default: {default} }}" if default else "{" + some.replace(" as ", ": ") + "}")
    return f'const {taken} = modules["{_beside(name, path)}"];\n'


def _beside(name: str, path: str) -> str:
    """The name of a module that another one imports by "./" and this path."""
    return name.rpartition("/")[0] + "/" + path if "/" in name else path


_HEAD = re.compile(r"<title>.*?</title>\n?|<link [^>]*>\n?|<script [^>]*></script>\n?")
_RUNBAR = re.compile(r"<header id=\"runbar\".*?</header>", re.DOTALL)
_STATIC = """
@media print {
  html, body { display: block; height: auto; overflow: visible; } #lists, #panel, .splitter, button { display: none; }
  #middle, #drawing, #scopes { display: block; height: auto; overflow: visible; break-inside: avoid; }
}
"""
_FIGURES = """
figure > button { font: inherit; font-size: 0.8rem; padding: 0.1rem 0.7rem; color: var(--ink); background: none;
  border: 1px solid var(--line); border-radius: 4px; cursor: pointer; }
.zoomed { max-width: 46rem; } .u-legend { font-size: 0.8rem; }
@media screen { .in-print { display: none; } } @media print { .zoomed, figure > button { display: none; } }
"""
