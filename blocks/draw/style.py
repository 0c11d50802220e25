"""The style sheet of a drawing: its own background, light and dark, and a color and a pattern for each sampled rate."""

from __future__ import annotations

from collections.abc import Mapping

# They differ in pattern as well as in color, for print and for the color-blind.
RATES = (
    ("#b45309", "#fbbf24", "7 3"),
    ("#1d4ed8", "#7aa2ff", "2.5 2.5"),
    ("#047857", "#34d399", "9 3 2 3"),
    ("#7c3aed", "#c4b5fd", "13 4"),
    ("#0e7490", "#67e8f9", "6 2 2 2 2 2"),
    ("#57534e", "#d6d3d1", "1.5 4"),
)

# What was added, removed and changed from one diagram to another: signs and dashes say it too.
MARKS = {"added": ("#15803d", "#4ade80"), "removed": ("#b91c1c", "#f87171"), "changed": ("#b45309", "#fbbf24")}
_MARKED = (
    ".added>.run,.changed>.run{stroke-width:2.4}.removed>.run{stroke-width:1.8;stroke-dasharray:6 4}"
    ".added .face,.changed .face,.added .flag,.changed .flag{stroke-width:2.4}"
    ".removed .face,.removed .flag{stroke-width:1.8;stroke-dasharray:6 4}"
    ".same{opacity:.45}.frame.same{opacity:1}.disk{stroke:none}.stroke{stroke-width:1.8;stroke-linecap:round}"
    ".listed{font-size:11px}"
)

_LIGHT = {"bg": "#ffffff", "fg": "#1f2937", "soft": "#6b7280", "face": "#f8fafc", "flag": "#e5e7eb", "bad": "#b91c1c",
          "warn": "#b45309", "frame": "#f3f6fb"}  # fmt: skip
_DARK = {"bg": "#111827", "fg": "#e5e7eb", "soft": "#9ca3af", "face": "#1f2937", "flag": "#374151", "bad": "#f87171",
         "warn": "#fbbf24", "frame": "#172033"}  # fmt: skip


def style_of(labels: Mapping[str, int], *, marked: bool = False) -> str:
    """The rules for a drawing with some sampled rates, each with the number of its pattern.

    marked: whether it shows what was added, removed and changed.
    """
    fixed = (
        "text{font-family:Helvetica,Arial,'Liberation Sans','DejaVu Sans',sans-serif}"
        "path,rect,circle{fill:none;stroke-width:1.3}.wide .run{stroke-width:2.6}"
        ".thin{stroke-width:.8}.line{stroke-width:1.8;stroke-linejoin:round;stroke-linecap:round}"
        ".title{font-size:15px;font-weight:600}.note{font-size:11px}.sign{font-weight:600}.tag{font-weight:700}"
        ".faulty .face,.warned .face{stroke-width:2.4}.dot,.head,.bg,.solid,.bar,.glyph{stroke:none}"
        ".open{stroke-width:1.8}.bang{stroke-width:1.5}"
    )
    if marked:
        fixed += _MARKED
    rules = [_scoped(fixed), _scoped(_colors(_LIGHT, labels, 0, marked))]
    dark = _scoped(_colors(_DARK, labels, 1, marked))
    return f"{''.join(rules)}@media (prefers-color-scheme:dark){{{dark}}}"


def _scoped(rules: str) -> str:
    """The rules for this drawing only: a page that holds the SVG keeps its own."""
    scoped_rules = []
    for rule in rules.split("}")[:-1]:
        selectors, body = rule.split("{")
        scoped = ",".join(f".blocks-diagram {selector}" for selector in selectors.split(","))
        scoped_rules.append(f"{scoped}{{{body}}}")
    return "".join(scoped_rules)


def _colors(c: Mapping[str, str], labels: Mapping[str, int], mode: int, marked: bool) -> str:
    rules = (
        f".bg{{fill:{c['bg']}}}text{{fill:{c['fg']}}}.port,.small,.frametitle{{fill:{c['soft']}}}"
        f".face{{fill:{c['face']};stroke:{c['fg']}}}.flag{{fill:{c['flag']};stroke:{c['soft']}}}"
        f".frame>.face{{fill:{c['frame']};stroke:{c['soft']}}}.thin{{stroke:{c['soft']}}}.line{{stroke:{c['fg']}}}"
        f".bar,.dot,.head,.solid{{fill:{c['fg']}}}.run{{stroke:{c['fg']}}}"
        f".tag{{fill:{c['bg']}}}.bang{{stroke:{c['bg']}}}"
    )
    for number in sorted(set(labels.values())):
        color, dash = RATES[number][mode], RATES[number][2]
        rules += (
            f".r{number} .run{{stroke:{color};stroke-dasharray:{dash}}}.r{number} .head,.dot.r{number}{{fill:{color}}}"
            f".r{number} .face{{stroke:{color};stroke-dasharray:{dash}}}"
        )
    for style, name in (("faulty", "bad"), ("warned", "warn")):
        rules += f".{style} .face{{stroke:{c[name]};stroke-dasharray:none}}.{style} .glyph{{fill:{c[name]}}}"
    for kind, colors in MARKS.items() if marked else ():
        color = colors[mode]
        rules += (
            f".{kind} .face,.{kind} .flag,.{kind} .run{{stroke:{color}}}.{kind} .head,.{kind}.dot{{fill:{color}}}"
            f".{kind} .disk,.{kind} .told{{fill:{color}}}"
        )
    if marked:
        rules += f".stroke{{stroke:{c['bg']}}}.told{{fill:{c['fg']}}}"
    rules += f".fault,.note{{fill:{c['bad']}}}.warning{{fill:{c['warn']}}}"
    return rules + f".open{{fill:{c['bg']};stroke:{c['bad']}}}"
