"""What a person reads in an FMU: documentation/index.html, with the drawing and tables of variables."""

from __future__ import annotations

import html

from .fmu_model import ExportedVariable, Model

_STYLE = """
:root { --ink: #1f2937; --soft: #4b5563; --line: #e5e7eb; --paper: #fff }
@media screen and (prefers-color-scheme: dark) {
  :root { --ink: #e5e7eb; --soft: #9ca3af; --line: #374151; --paper: #111827 } }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); max-width: 60rem;
  margin: 2rem auto; padding: 0 1rem; overflow-wrap: anywhere }
h1 { font-size: 1.6rem; margin-bottom: 0 } h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; break-after: avoid }
p.what, th { color: var(--soft) } p.what { margin-top: .2rem }
table { border-collapse: collapse; table-layout: fixed; width: 100%; font-size: .9rem }
td, th { text-align: left; padding: .25rem .75rem .25rem 0; border-bottom: 1px solid var(--line);
  vertical-align: top }
th:nth-child(1) { width: 26% } th:nth-child(2) { width: 18% } th:nth-child(3) { width: 14% } tr { break-inside: avoid }
td:nth-child(1) { font-family: ui-monospace, monospace } td:nth-child(2), th:nth-child(2) { text-align: right }
figure { margin: 1.5rem 0; overflow-x: auto } svg { max-width: 100%; height: auto }
@media screen and (max-width: 40rem) {
  svg { min-width: 44rem } table, tbody, td { display: block } tr:first-child { display: none }
  tr { display: flex; flex-wrap: wrap; column-gap: .9rem; padding: .4rem 0; border-bottom: 1px solid var(--line) }
  td { padding: 0; border: 0 } td:nth-child(4) { width: 100%; color: var(--soft) } td:empty { display: none } }
"""
_TABLES = (
    ("Inputs", ("input",), ("continuous", "discrete")),
    ("Outputs", ("output",), ("continuous", "discrete")),
    ("Parameters", ("parameter",), ("tunable", "fixed")),
    ("Bound parameters", ("calculatedParameter",), ("tunable", "fixed")),
)
MOST = 200  # rows of one table


def escape(text: str) -> str:
    """Text as HTML, without control characters that a terminal showing the source would obey."""
    return html.escape("".join(char if char.isprintable() or char == "\n" else "\ufffd" for char in text))


def index_html(model: Model, drawing: str) -> str:
    """The page. drawing: the text of an SVG, or nothing."""
    names = {"CS": "Co-Simulation", "ME": "Model Exchange"}
    what = f"{' and '.join(names[kind] for kind in model.kinds)}, exported by blocks {model.version}"
    parts = [
        "<!DOCTYPE html>", '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="color-scheme" content="light dark">', f"<title>{escape(model.name)}</title>",
        f"<style>{_STYLE}</style></head><body>", f"<h1>{escape(model.name)}</h1>",
        f'<p class="what">{escape(what)}</p>',
    ]  # fmt: skip
    if model.doc:
        parts.append(f"<p>{escape(model.doc)}</p>")
    if drawing:
        parts.append(f"<figure>{drawing}</figure>")
    if model.inside:
        parts += ["<h2>FMUs inside</h2>", "<table>", "<tr><th>name</th><th>files</th><th>license</th></tr>"]
        parts += [f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in model.inside]
        parts.append("</table>")
    for title, causalities, variabilities in _TABLES:
        variables = [v for v in model.variables if v.causality in causalities and v.variability in variabilities]
        if variables:
            parts += [f"<h2>{title}</h2>", "<table>", *_rows(variables[:MOST]), "</table>"]
        if len(variables) > MOST:
            parts.append(f"<p>and {len(variables) - MOST} more</p>")
    return "\n".join([*parts, "</body></html>"]) + "\n"


def _rows(variables: list[ExportedVariable]) -> list[str]:
    rows = ["<tr><th>name</th><th>start</th><th>unit</th><th>description</th></tr>"]
    for v in variables:
        shown = ", ".join(_shown(value, v) for value in v.start[:4])
        shown += ", ..." if len(v.start) > 4 else ""
        cells = f'<td>{escape(v.name)}</td><td>{escape(shown)}</td><td>{escape(v.unit)}</td>'
        rows.append(f"<tr>{cells}<td>{escape(v.doc)}</td></tr>")
    return rows


def _shown(value: float | str, variable: ExportedVariable) -> str:
    """Return a start value as a person reads it."""
    if isinstance(value, str):
        return value
    if variable.type == "bool":
        return "true" if value else "false"
    if variable.type == "enum":
        return variable.members.get(int(value), str(int(value)))
    return f"{value:g}" if variable.type == "real" else str(int(value))
