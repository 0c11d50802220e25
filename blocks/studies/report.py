"""The report of a study: one HTML file with verdicts, figures, drawings, assumptions, and how to repeat it.

It asks for nothing from any network, follows the reader's light or dark setting, reads on a phone, and prints.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from ..results import plots
from ..results.results import Results
from ..text.arrays import Array
from ..text.errors import BlocksError, Fault, ModelError, UsageError, did_you_mean
from ..text.grammar import Steps
from ..text.json_document import place_of
from ..text.printable import aligned, as_markdown, counted
from ..text.version import __version__
from .report_page import escaped, folder_for, framed, own_ids, plotted, svg_of, table, warned, written
from .sampling import values_text
from .study import StudyResults, Verdict
from .study_reader import Claim
from .study_sweeps import StudySweep, figure_of, plain
from .study_tunings import StudyTuning
from .sweep import QUANTILES, Sweep
from .sweep_figures import told_rows
from .sweep_tables import cell_text, tabular
from .sweep_tables import table as sweep_table
from .tuned import Tuning

MOST_POINTS = 2**24
"""Of the grid of a spectrum, which takes 1 GB with its transform."""
FEWEST_RATIOS = 4
"""Published numbers from which a figure shows them beside ours."""
_RATIOS = "claims.ratios"
GLYPHS = {"reproduced": "✓", "not reproduced": "✗", "holds": "✓", "fails": "✗", "": "·"}


# --- verdicts as text ------------------------------------------------------------------------------------------


def summary_line(made: StudyResults) -> str:
    """The study in a sentence."""
    judged = [v for v in made.verdicts if v.verdict and v.claim.limit is None]
    limits = [v for v in made.verdicts if v.claim.limit is not None]
    good = sum(v.verdict == "reproduced" for v in judged)
    reproduced = f"{good} of {len(judged)} published numbers reproduced within their tolerance"
    parts = [reproduced] if judged or not limits else []
    parts += [f"{sum(v.verdict == 'holds' for v in limits)} of {len(limits)} limits kept"] if limits else []
    unexpected = sum(not v.is_expected for v in made.verdicts)
    tail = "all verdicts are as expected" if not unexpected else f"{unexpected} not as the study expects"
    return "; ".join([*parts, tail])


def _rows(verdicts: Sequence[Verdict]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for v in verdicts:
        claim = v.claim
        unit = f" {claim.unit}" if claim.unit else ""
        mark = "" if v.is_expected else "  <- unexpected"
        rows.append(
            (
                claim.of, _row_label(claim),
                _wanted(claim, unit), _here(v, unit),
                "-" if math.isnan(v.ratio) else f"{v.ratio:.4f}", f"{claim.tolerance:.3g}" if claim.published else "-",
                f"{GLYPHS[v.verdict]} {v.verdict}{mark}".strip(),
            )
        )  # fmt: skip
    return rows


def _row_label(claim: Claim) -> str:
    """The measure, without the runs that it is about."""
    return f"{claim.measure}, {claim.change}" if claim.change else claim.label


def _wanted(claim: Claim, unit: str) -> str:
    """The published number, or the limit."""
    if claim.limit is None:
        return "-" if claim.published is None else f"{claim.published:.7g}{unit}"
    part = f"{_share(claim.statistic[1])} " if claim.statistic[0] == "share" else ""
    return f"{part}{'≤' if claim.limit[0] == 'at_most' else '≥'} {claim.limit[1]:.7g}{unit}"


def _here(v: Verdict, unit: str) -> str:
    """The value; of a sweep also how many rows have a number, where some have none."""
    known, count = v.rows
    rows = f" ({known} of {counted(count, 'row')})" if known < count else ""
    if v.claim.statistic[0] == "share":
        return _share(v.value) + rows
    return (f"{v.value:.6g}{unit}" if math.isfinite(v.value) else cell_text(v.value)) + rows


def _share(part: float) -> str:
    return f"{100 * part:.4g} %"


_HEAD = ("run", "measure", "published", "here", "ratio", "tolerance", "verdict")


def table_text(made: StudyResults, *, wide: bool = False) -> str:
    """All claims as an aligned table; wide: with the runs as columns."""
    return "\n".join(line[2:] for line in aligned(_table(made, wide)))


def markdown_table(made: StudyResults, *, wide: bool = False) -> str:
    """All claims as a Markdown table; wide: with the runs as columns."""
    return as_markdown([[*map(cell_text, row)] for row in _table(made, wide)])


def latex_table(made: StudyResults, *, wide: bool = False) -> str:
    """All claims as a tabular of LaTeX with booktabs; wide: with the runs as columns. Verdicts have no glyphs."""
    head, *rows = _table(made, wide)
    return tabular([head, *rows] if wide else [head, *([*row[:-1], row[-1].partition(" ")[2]] for row in rows)])


def _table(made: StudyResults, wide: bool) -> list[tuple[str, ...]]:
    """The head and the rows of the table in each of its forms."""
    return _wide(made.verdicts) if wide else [_HEAD, *_rows(made.verdicts)]


def _wide(verdicts: Sequence[Verdict]) -> list[tuple[str, ...]]:
    """A row for each measure, and a column for each run.

    Below a measure stand its published numbers and limits, if there are any. Claims that agree in measure and run get
    rows of their own.
    """
    columns = tuple(dict.fromkeys(v.claim.of for v in verdicts))
    cells: dict[tuple[str, str, int], dict[str, tuple[str, str]]] = {}
    for v in verdicts:
        claim = v.claim
        unit = "" if claim.statistic[0] == "share" else claim.unit
        key = (_row_label(claim), unit, 0)
        while claim.of in cells.get(key, {}):
            key = (*key[:2], key[2] + 1)
        glyph = f" {GLYPHS[v.verdict]}" if v.verdict else ""
        mark = "" if v.is_expected else " unexpected"
        wanted = _wanted(claim, f" {claim.unit}" if unit != claim.unit else "")
        cells.setdefault(key, {})[claim.of] = f"{_here(v, '')}{glyph}{mark}", "" if wanted == "-" else wanted
    rows: list[tuple[str, ...]] = [("measure", "unit", *columns)]
    for (label, unit, _), found in cells.items():
        known = [found.get(name, ("", "")) for name in columns]
        rows.append((label, unit, *(here for here, _ in known)))
        if any(wanted for _, wanted in known):
            rows.append((f"{label}, published", unit, *(wanted for _, wanted in known)))
    return rows


# --- figures ---------------------------------------------------------------------------------------------------


def _drawn(study_results: StudyResults, folder: Path, made_of: dict[str, object]) -> dict[str, str | Fault]:
    """The study's figures by name, and those of its tunings by "tuning.NAME", as SVG; files of them are written.

    In place of one that failed: its fault. made_of: gets the figures that are made of panels.
    """
    shown: dict[str, str | Fault] = {}
    asked: list[tuple[str, Steps, Callable[[], Any]]] = []
    formats = {str(entry["name"]): str(entry.get("format", "png")) for entry in study_results.study.figures}
    for i, entry in enumerate(study_results.study.figures):
        made = partial(figure_of, entry, study_results.sweeps)
        made = made if "sweep" in entry else partial(_figure, entry, study_results.results)
        asked.append((str(entry["name"]), ("figures", i), made))
    asked += [(f"tuning.{name}", ("tunings", name), tuning.plot) for name, tuning in study_results.tunings.items()]
    published = [v for v in study_results.verdicts if math.isfinite(v.ratio) and v.ratio > 0]
    if len(published) >= FEWEST_RATIOS:
        asked.append((_RATIOS, ("claims",), partial(_ratios, published)))
    for name, path, draw in asked:
        try:
            figure = draw()
            shown[name] = svg_of(figure, folder, name, formats.get(name, "png"))
            made_of |= {name: figure} if figure.parts else {}
        except BlocksError as error:
            shown[name] = replace(error.faults[0], place=f"{place_of(path)} {error.faults[0].place}")
        except Exception as error:  # whatever it is, the rest of the report is written
            message = f"{name} cannot be drawn ({type(error).__name__}: {' '.join(str(error).split())[:200]})."
            cure = "Change the figure, or leave it out."
            shown[name] = study_results.study.fault("E501", place_of(path), message, cure, path)
    return shown


@plots.defaults()
def _ratios(verdicts: Sequence[Verdict]) -> object:
    """Our numbers over the published ones: a dot for each, upon a bar for its tolerance; those far off at the edge."""
    figure = plots.new_figure(plots.WIDTH, 0.9 + 0.19 * len(verdicts))
    axis = figure.subplots()
    rows, ratio = np.arange(len(verdicts)), np.array([v.ratio for v in verdicts])
    tolerance = np.array([v.claim.tolerance for v in verdicts])
    span = min(1.1 * float(np.max(np.abs(ratio - 1))), 2.5 * float(tolerance.max())) or 0.1
    axis.barh(rows, 2 * tolerance, 0.55, left=1 - tolerance, color="#94a3b8", alpha=0.4, label="tolerance")
    axis.axvline(1.0, color=plots.INK, linewidth=0.8)
    shown, is_good = np.clip(ratio, 1 - span, 1 + span), np.array([v.verdict == "reproduced" for v in verdicts])
    for chosen, word, style, mark in ((is_good, "reproduced", 1, "o"), (~is_good, "not reproduced", 0, "X")):
        if chosen.any():
            axis.plot(shown[chosen], rows[chosen], mark, color=plots.STYLES[style][0], label=word, clip_on=False)
    for row in np.flatnonzero(shown != ratio):
        axis.annotate(
            f"{ratio[row]:.3g}", (shown[row], row), xytext=(8 if ratio[row] < 1 else -8, 0), fontsize=8, va="center",
            textcoords="offset points", ha="left" if ratio[row] < 1 else "right", color=plots.INK,
        )  # fmt: skip
    axis.set_xlim(1 - span, 1 + span)
    axis.set_yticks(rows, [plots.plain(f"{row[0]} {row[1]}") for row in _rows(verdicts)], fontsize=8)
    axis.set_ylim(len(verdicts) - 0.4, -0.6)
    axis.grid(True, **plots.GRID)
    axis.set_xlabel("here / published")
    figure.legend(loc="outside upper left", ncols=3, fontsize=8, frameon=False, labelcolor=plots.INK)
    plots.ink(axis)
    return figure


def _figure(entry: Mapping[str, Any], results: Mapping[str, Results]) -> object:
    spectrum = entry.get("kind") == "spectrum"
    if not spectrum:
        used = {str(item["run"]) for panel in entry["panels"] for items in ("lines", "markers")
                for item in panel.get(items, ()) if "run" in item}  # fmt: skip
        results = {name: each.smooth() if name in used else each for name, each in results.items()}
    window = (float(entry.get("from", -math.inf)), float(entry.get("to", math.inf)))
    parts = []
    for panel in entry["panels"]:
        styles = _styles([item.get("style", "") for item in panel["lines"]])
        lines = tuple(_line(item, style, results, window, spectrum)
                      for item, style in zip(panel["lines"], styles, strict=True))  # fmt: skip
        markers = tuple(_marker(item, results, window) for item in panel.get("markers", []))
        band, inset = panel.get("band"), panel.get("inset")
        parts.append(
            plots.Panel(
                lines,
                str(panel.get("ylabel", "")),
                markers,
                band=None if band is None else (float(band[0]), float(band[1])),
                inset=None if inset is None else (float(inset[0]), float(inset[1]), float(inset[2]), float(inset[3])),
                log=bool(panel.get("log", spectrum)),
                height=float(panel.get("height", 1.0)),
            )
        )
    windows = [(float(begin), float(end)) for begin, end in entry.get("windows", ())]
    look: plots.Look = {"size": (float(entry["size"][0]), float(entry["size"][1]))} if "size" in entry else {}
    if any("ylim" in panel for panel in entry["panels"]):
        look["ylim"] = [None if (ends := panel.get("ylim")) is None else (float(ends[0]), float(ends[1]))
                        for panel in entry["panels"]]  # fmt: skip
    label = "frequency [Hz]" if spectrum else "time [s]"
    return plots.panels(parts, xlabel=str(entry.get("xlabel", label)), windows=windows, look=look)


def _signal(
    item: Mapping[str, Any], results: Mapping[str, Results], window: tuple[float, float]
) -> tuple[Array, Array]:
    run, name = str(item["run"]), str(item["signal"])
    try:
        signal = results[run][name]
    except KeyError:
        cure = did_you_mean(name, results[run].names) or f"Recorded: {', '.join(results[run].names)}."
        raise ModelError(Fault("E105", f"figures: {run}.{name}", "the run did not record this signal.", cure)) from None
    line = results[run].line(name, name, 0) if signal.ndim == 1 else plots.Line(signal.t, np.asarray(signal), name)
    inside = (line.x >= window[0]) & (line.x <= window[1])
    return line.x[inside], line.y[inside] * float(item.get("scale", 1.0))


def _styles(given: Sequence[Any]) -> list[int | None]:
    """Return a style for each line of a panel: the given one (None: dotted), or, for "", the next that no other has."""
    numbers = range(len(plots.STYLES))
    free = itertools.cycle([k for k in numbers if k not in given] or numbers)
    return [next(free) if style == "" else None if style is None else int(style) for style in given]


def _line(
    item: Mapping[str, Any], style: int | None, results: Mapping[str, Results], window: tuple[float, float],
    spectrum: bool,
) -> plots.Line:  # fmt: skip
    x, y = _signal(item, results, window)
    if spectrum:
        x, y = amplitude_spectrum(x, y)
    return plots.Line(x, y, str(item.get("label", item["signal"])), style)


def _marker(item: Mapping[str, Any], results: Mapping[str, Results], window: tuple[float, float]) -> plots.Marker:
    style = item.get("style", None)
    label = str(item.get("label", ""))
    if "signal" in item:
        x, y = _signal(item, results, window)
        k = int(np.argmax(np.abs(y)))
        return plots.Marker(float(x[k]), float(y[k]), label or f"{y[k]:.3g}", None if style is None else int(style))
    return plots.Marker(float(item["x"]), float(item["y"]), label, None if style is None else int(style))


def amplitude_spectrum(t: Array, y: Array) -> tuple[Array, Array]:
    """Frequencies in Hz and amplitudes of a signal on an even grid (Hann window; of two rows of one time the last).

    Raises UsageError (E501) where rows are so uneven that the grid would have more than MOST_POINTS.
    """
    keep = np.append(np.diff(t) > 0, True)
    t, y = t[keep], y[keep]
    step = float(np.median(np.diff(t)))
    if (t[-1] - t[0]) / step > MOST_POINTS:
        message = f"steps of {step:.3g} s over {t[-1] - t[0]:.3g} s make more than {MOST_POINTS:,} points."
        raise UsageError(Fault("E501", "spectrum", message, 'Record the run on a grid, or on a coarser grid: "every".'))
    grid = np.arange(t[0], t[-1] + step / 2, step)
    even = y[np.clip(np.searchsorted(t, grid + step * 1e-6, side="right") - 1, 0, len(y) - 1)]
    window = np.hanning(len(even))
    amplitude = 2.0 * np.abs(np.fft.rfft((even - even.mean()) * window)) / window.sum()
    return np.fft.rfftfreq(len(even), step)[1:], np.maximum(amplitude[1:], 1e-16)


def write(
    made: StudyResults,
    folder: Path,
    command: str,
    draw: Callable[[Any], str] | None = None,
    faults: list[Fault] | None = None,
    zoom: Callable[[Mapping[str, Any]], tuple[str, str]] | None = None,
) -> Path:
    """Write `report.html` and the figures into a folder, which is made; returns the report's path.

    command: how it was made. draw: a diagram's drawing as SVG. faults: collects those of figures that failed; the rest
    of the report is written all the same. zoom: what makes figures zoom on a screen, of those that are made of panels:
    a policy for the head of the page and HTML for its end. Raises UsageError (E501) where the report cannot be written.
    """
    folder_for(folder)
    panels: dict[str, object] = {}
    shown = _drawn(made, folder, panels)
    policy, end = zoom(panels) if zoom and panels else ("", "")
    if faults is not None:
        faults += [fault for fault in shown.values() if isinstance(fault, Fault)]
    verdict = f"{'✓' if made.is_fine else '✗'} {summary_line(made)}."
    parts = [*_parts(made, command, shown, draw), end]
    return written(folder, made.study.title, verdict, parts, is_fine=made.is_fine, policy=policy)


# --- the page --------------------------------------------------------------------------------------------------


def _parts(
    study_results: StudyResults, command: str, drawn: Mapping[str, str | Fault], draw: Callable[[Any], str] | None
) -> list[str]:
    """The report as HTML, with the figures that were drawn."""
    study = study_results.study
    is_published = any(v.claim.published is not None for v in study_results.verdicts)
    return [
        *(f"<p>{escaped(line)}</p>" for line in study.doc),
        f'<p class="source">{escaped(study.source)}</p>' if study.source else "",
        f"<h2>{'Published numbers and ours' if is_published else 'Numbers and limits'}</h2>",
        *_tables(study_results),
        framed(_plot(drawn[_RATIOS], "r-")) if _RATIOS in drawn else "",
        _reasons(study_results),
        "<h2>What was assumed</h2>" if study.assumed else "",
        _assumptions(study.assumed),
        "<h2>Figures</h2>" if study.figures else "",
        *_figures(study_results, drawn),
        "<h2>What was run</h2>",
        *_runs(study_results, drawn, draw),
        "<h2>How to repeat it</h2>",
        _repeat(study_results, command),
    ]


def _tables(study_results: StudyResults) -> list[str]:
    """One table for each source that the claims name."""
    groups: dict[str, list[Verdict]] = {}
    for v in study_results.verdicts:
        groups.setdefault(v.claim.source, []).append(v)
    tables = []
    for source, verdicts in groups.items():
        rows = _rows(verdicts)
        kinds = {}
        for v, row in zip(verdicts, rows, strict=True):
            kind = {"✓": "good", "✗": "bad"}.get(GLYPHS[v.verdict], "none")
            kinds[row[-1]] = kind if v.is_expected else f"{kind} unexpected"
        tables.append(table([_HEAD, *rows], caption=source, kinds=kinds))
    return tables


def _reasons(study_results: StudyResults) -> str:
    reasons: dict[str, list[str]] = {}
    for v in study_results.verdicts:
        if v.claim.reason:
            reasons.setdefault(v.claim.reason, []).append(f"{v.claim.of} {v.claim.measure}")
    if not reasons:
        return ""
    items = "".join(f"<li><b>{escaped(', '.join(names))}</b>: {escaped(why)}</li>" for why, names in reasons.items())
    return f"<h3>Why some numbers are not reproduced</h3><ul>{items}</ul>"


def _assumptions(assumed: Sequence[Mapping[str, str]]) -> str:
    items = []
    for entry in assumed:
        text = f"<b>{escaped(entry['what'])}</b>"
        if entry["why"]:
            text += f" {escaped(entry['why'])}"
        if entry["contradicts"]:
            text += f' <span class="against">Contradicts the text: {escaped(entry["contradicts"])}</span>'
        items.append(f"<li>{text}</li>")
    return f"<ul>{''.join(items)}</ul>" if items else ""


def _figures(study_results: StudyResults, drawn: Mapping[str, str | Fault]) -> list[str]:
    parts = []
    for index, entry in enumerate(study_results.study.figures):
        name, doc = str(entry["name"]), entry.get("doc", "")
        doc = doc if isinstance(doc, str) else " ".join(doc)
        caption = f"<b>{escaped(str(entry.get('title', name)))}</b> {escaped(doc)}"
        parts.append(framed(_plot(drawn[name], f"f{index}-"), caption, name=name))
    return parts


def _plot(drawing: str | Fault, prefix: str) -> str:
    if isinstance(drawing, Fault):
        return f'<p class="against">Not drawn: {escaped(drawing.message)}</p>'
    return plotted(drawing, prefix)


def _runs(
    study_results: StudyResults, figures: Mapping[str, str | Fault], draw: Callable[[Any], str] | None
) -> list[str]:
    parts, shown = [], set()
    for entry in study_results.study.all_runs:
        said = {**entry.variants, **entry.parameters, **entry.settings}
        given = ", ".join(f"{key} = {_value(value)}" for key, value in said.items())
        parts.append(
            f"<h3>{escaped(entry.name)}: {escaped(entry.diagram)}</h3><p>{escaped(entry.doc)} "
            f"{escaped(f'With {given}. ' if given else '')}"
        )
        if isinstance(entry, StudySweep):
            parts += _rows_of(entry, study_results.sweeps[entry.name])
        elif isinstance(entry, StudyTuning):
            parts += _search_of(study_results.tunings[entry.name])
            parts.append(framed(_plot(figures[f"tuning.{entry.name}"], f"t{len(parts)}-")))
        else:
            results = study_results.results[entry.name]
            statistics = results.statistics
            parts[-1] += (
                f"{escaped(statistics.method)}, "
                f"{statistics.steps} steps, {statistics.rejected} rejected, {len(results.events)} events.</p>"
            )
        drawn = entry.diagram, *sorted(entry.variants.items())
        if draw is not None and drawn not in shown:
            shown.add(drawn)
            svg = own_ids(draw(study_results.diagrams[entry.name]), f"d{len(shown)}-")
            parts.append(f'<div class="wide diagram">{svg}</div>')
    return parts


def _rows_of(entry: StudySweep, sweep: Sweep) -> list[str]:
    """What varied in a sweep, and the table of its measures."""
    varied = "; ".join(f"{name}: {values_text(plain(raw))}" for name, raw in entry.vary.items())
    words = [f"{key} {entry.options[key]}" for key in ("sampler", "seed") if key in entry.options]
    said = f"Varied: {varied}. {told_rows(sweep)}{''.join(f', {word}' for word in words)}."
    rows = [[*map(cell_text, row)] for row in sweep_table(sweep, (), QUANTILES)]
    why = "".join(f"<li>{escaped(line)}</li>" for line in sweep.failures())
    return [
        f"{escaped(said)}</p>{f'<ul>{why}</ul>' if why else ''}",
        table(rows),
    ]


def _search_of(tuning: Tuning) -> list[str]:
    """What a tuning looked for, and its tables, before and after."""
    names = ", ".join(tuning.scenarios)
    said = f"Minimized: {tuning.minimize}. {len(tuning.history.objective)} candidates in {names}, {tuning.optimizer}, "
    kept = f" {tuning.kept}" if tuning.is_kept else ""
    parts = [f"{escaped(f'{said}seed {tuning.search_seed}.{kept}')}</p>"]
    return [*parts, *warned(tuning.warnings), *(table(of.rows) for of in tuning.tables().values())]


def _value(value: object) -> str:
    if isinstance(value, Mapping) and "value" not in value:  # the settings of the master
        return ", ".join(f"{key} {_value(item)}" for key, item in value.items())
    return f"{value['value']} {value.get('unit', '')}".strip() if isinstance(value, Mapping) else str(value)


def _repeat(study_results: StudyResults, command: str) -> str:
    rows = [("command", command), ("blocks", __version__), ("Python", platform.python_version())]
    for name in ("numpy", "scipy"):
        try:
            rows.append((name, version(name)))
        except PackageNotFoundError:
            continue
    study = study_results.study
    paths = [
        Path(study_results.study.file),
        *(Path(study_results.study.folder) / entry.diagram for entry in study.all_runs),
    ]
    for path in dict.fromkeys(paths):
        rows.append((f"SHA-256 of {path.name}", hashlib.sha256(path.read_bytes()).hexdigest()[:16]))
    for name, results in study_results.results.items():
        if results.origin is not None:
            rows.append((f"SHA-256 of the equations of {name}", results.origin.equations[:16]))
    cells = "".join(f"<tr><td>{escaped(a)}</td><td><code>{escaped(b)}</code></td></tr>" for a, b in rows)
    return f'<div class="wide"><table class="plain">{cells}</table></div>'
