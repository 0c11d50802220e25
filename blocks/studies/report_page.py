"""A page of a report: one HTML text with its tables, figures and style, that asks for nothing from any network.

On a phone a row of a table becomes a paragraph, with the heads of its numbers before them.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..results import plots
from ..text.atomic_write import write_atomically
from ..text.errors import Fault, UsageError


def folder_for(folder: Path) -> None:
    """Make a folder where there is none. Raises UsageError (E501)."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(Fault("E501", str(folder), f"cannot be created: {error.strerror}.")) from None


def written(folder: Path, title: str, verdict: str, parts: Iterable[str], *, is_fine: bool, policy: str = "") -> Path:
    """Write `report.html`: a title, a verdict, then parts that are HTML. policy: the scripts that may run in it.

    Raises UsageError (E501).
    """
    first = f'<p class="verdict {"fine" if is_fine else "odd"}">{escaped(verdict)}</p>'
    body = "\n".join([f"<h1>{escaped(title)}</h1>", first, *filter(None, parts)])
    path = folder / "report.html"
    with write_atomically(path) as stream:
        stream.write(_PAGE.format(title=escaped(title), policy=policy, style=_STYLE, body=body))
    return path


def escaped(text: str) -> str:
    """A text as HTML."""
    return html.escape("".join(c if c.isprintable() else "�" for c in text))


def warned(faults: Sequence[Fault]) -> list[str]:
    """Warnings as HTML."""
    return [f'<p class="against">{escaped(str(fault))}</p>' for fault in faults]


def table(rows: Sequence[Sequence[str]], *, caption: str = "", kinds: Mapping[str, str] | None = None) -> str:
    """Return a head and rows as HTML; columns of numbers are aligned to the right. kinds: classes of cells by text."""
    head, *rows = rows
    columns = [[cell for cell in column if cell not in ("", "-")] for column in zip(*rows, strict=True)]
    is_number = [all(map(_NUMBER.match, cells)) for cells in columns] or [False] * len(head)
    sides = ["number" if number else "" for number in is_number]
    lines = ["".join(f'<th class="{side}">{escaped(name)}</th>' for name, side in zip(head, sides, strict=True))]
    for row in rows:
        cells = ""
        for name, cell, side in zip(head, row, sides, strict=True):
            kind = (kinds or {}).get(cell, "none" if cell in ("", "-") else "")
            told = f' data-head="{escaped(name)}"' if side else ""
            cells += f'<td class="{f"{side} {kind}".strip()}"{told}>{escaped(cell)}</td>'
        lines.append(cells)
    first, *others = [f"<tr>{line}</tr>" for line in lines]
    above = f"<caption>{escaped(caption)}</caption>" if caption else ""
    body = f"<thead>{first}</thead><tbody>{''.join(others)}</tbody>"
    return f'<div class="wide"><table>{above}{body}</table></div>'


def svg_of(figure: Any, folder: Path, name: str, format: str = "png") -> str:
    """Return a figure as SVG; a file of it in the format is written beside the report."""
    svg = plots.svg_text(figure)
    plots.save(figure, folder / f"{name}.{format}")
    return svg


def framed(shown: str, caption: str = "", *, name: str = "") -> str:
    """Return a figure that is HTML with its caption, also HTML. name: by which scripts find it."""
    known, below = f' data-figure="{escaped(name)}"' if name else "", f"<figcaption>{caption}</figcaption>"
    return f"<figure{known}>{below if caption else ''}{shown}</figure>"


def plotted(svg: str, prefix: str) -> str:
    """A figure as HTML, in colors that are lighter on a dark page. prefix: of its ids, as a page holds several."""
    svg = own_ids(svg, prefix)
    for style, (color, _) in enumerate(plots.STYLES):
        svg = svg.replace(color, f"var(--c{style})")
    return f'<div class="plot">{svg}</div>'


def own_ids(svg: str, prefix: str) -> str:
    """The ids of one SVG made unique."""
    return (
        svg.replace('id="', f'id="{prefix}').replace("url(#", f"url(#{prefix}").replace('href="#', f'href="#{prefix}')
    )


_NUMBER = re.compile(r"[≤≥] ?-?[\d∞]|[-+]?(\d|\.\d|∞)")

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
{policy}<title>{title}</title>
<style>{style}</style>
</head>
<body>
<main>
{body}
</main>
</body>
</html>
"""

_STYLE = """
:root { --ink: #1e293b; --soft: #64748b; --line: #cbd5e1; --paper: #ffffff; --good: #1d4ed8; --bad: #b45309;
  --c0: #b45309; --c1: #1d4ed8; --c2: #0f766e; --c3: #7e22ce; --c4: #64748b; --c5: #be123c; }
@media screen and (prefers-color-scheme: dark) {
  :root { --ink: #e2e8f0; --soft: #94a3b8; --line: #475569; --paper: #0f172a; --good: #93c5fd; --bad: #fbbf24;
    --c0: #fbbf24; --c1: #93c5fd; --c2: #5eead4; --c3: #d8b4fe; --c4: #94a3b8; --c5: #fda4af; }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, sans-serif; }
main { max-width: 60rem; margin: 0 auto; padding: 1.5rem 1rem 4rem; }
h1 { font-size: 1.5rem; line-height: 1.25; } h2 { margin-top: 2.2rem; border-bottom: 1px solid var(--line);
  font-size: 1.2rem; }
h1, h2, h3, caption { break-after: avoid; } p, li { overflow-wrap: anywhere; }
h3 { font-size: 1rem; margin: 1.2rem 0 0.3rem; overflow-wrap: anywhere; }
.verdict { font-weight: 600; padding: 0.6rem 0.8rem; border-left: 4px solid var(--good);
  background: color-mix(in srgb, var(--good) 8%, transparent); }
.verdict.odd { border-color: var(--bad); background: color-mix(in srgb, var(--bad) 12%, transparent); }
.source, figcaption, caption { color: var(--soft); }
.wide { overflow-x: auto; } table { border-collapse: collapse; margin: 0.8rem 0; font-size: 0.9rem; }
caption { text-align: left; padding-bottom: 0.2rem; }
th, td { padding: 0.2rem 1.1rem 0.2rem 0; text-align: left; border-bottom: 1px solid var(--line);
  vertical-align: top; white-space: nowrap; }
th.number, td.number { font-variant-numeric: tabular-nums; text-align: right; }
td.good { color: var(--good); } td.bad { color: var(--bad); } td.unexpected { font-weight: 700;
  text-decoration: underline; }
.against { color: var(--bad); } figure { margin: 1.2rem 0; break-inside: avoid; } tr { break-inside: avoid; }
.plot svg { width: 100%; max-width: 46rem; height: auto; display: block; }
.diagram { break-inside: avoid; } .diagram svg { max-width: 100%; height: auto; }
code { overflow-wrap: anywhere; white-space: normal; }
@media screen and (max-width: 40rem) {
  .diagram svg { min-width: 44rem; max-width: none; }
  table, tbody, caption, table.plain td { display: block; } thead, td.none { display: none; }
  tr { display: flex; flex-wrap: wrap; column-gap: 0.9rem; padding: 0.4rem 0; border-bottom: 1px solid var(--line); }
  td, td.number { padding: 0; border: 0; text-align: left; white-space: normal; overflow-wrap: anywhere; }
  td:first-child { font-weight: 600; }
  td[data-head]::before { content: attr(data-head) " "; color: var(--soft); font-weight: 400; }
}
@media print { :root, body { font-size: 11px; } main { max-width: none; padding: 0; } .wide { overflow: visible; }
  .plot svg { max-width: 15cm; } }
"""
