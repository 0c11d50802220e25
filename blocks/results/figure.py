"""The figures of blocks: those of matplotlib, which show themselves in a notebook, with `%matplotlib` and without it.

matplotlib's own have no form for a notebook: IPython gets one where `%matplotlib inline` or pyplot's `show` sets it up,
and then shows what pyplot has made, which these are not. So each shows itself once, as the last value of a cell or by
`display`.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Collection
from typing import Any

from matplotlib.figure import Figure as Drawn

from .plots import STYLES, defaults, svg_text, written

__all__ = ["Figure"]

# On its own background, as drawings of diagrams have it: a notebook does not tell a picture whether it is dark.
_INK, _PAPER = ("#1f2937", "#e5e7eb"), ("#ffffff", "#111827")
_BRIGHT = ("#fbbf24", "#7aa2ff", "#34d399", "#c4b5fd", "#cbd5e1", "#fb7185")
"""The colors of STYLES upon dark."""


class Figure(Drawn):
    """A figure of matplotlib that a notebook shows: as SVG, light or dark, and as PNG where that cannot be shown."""

    def _repr_mimebundle_(
        self, include: Collection[str] | None = None, exclude: Collection[str] | None = None
    ) -> dict[str, Any]:
        kinds: dict[str, Callable[[], Any]] = {
            "image/svg+xml": self._svg, "image/png": self._png, "text/plain": lambda: repr(self)
        }  # fmt: skip
        asked = [kind for kind in kinds if (not include or kind in include) and kind not in (exclude or ())]
        return {kind: kinds[kind]() for kind in asked}

    def _svg(self) -> str:
        """As `svg_text`, with colors of its own, which follow the scheme that the reader prefers."""
        body = svg_text(self)
        rules = []
        for ink, paper, colors in zip(_INK, _PAPER, ([color for color, _ in STYLES], _BRIGHT), strict=True):
            named = "".join([f";--paper:{paper}", *(f";--c{n}:{color}" for n, color in enumerate(colors))])
            rules.append(f".blocks-figure{{color:{ink};background:{paper}{named}}}")
        for n, (color, _) in enumerate(STYLES):
            body = body.replace(color, f"var(--c{n},{color})")
        width, height = (round(100 * size) for size in self.get_size_inches())
        style = f"<style>{rules[0]}@media (prefers-color-scheme:dark){{{rules[1]}}}</style>"
        size = f'<svg class="blocks-figure" width="{width}" height="{height}" style="max-width:100%;height:auto"'
        head, rest = body.removeprefix("<svg").split(">", 1)
        return f"{size}{head}>{style}{rest}"

    @defaults()
    def _png(self) -> bytes:
        """On white."""
        alpha, stream = self.patch.get_alpha(), io.BytesIO()
        try:
            self.patch.set_alpha(1.0)
            written(self, stream, "png", {}, dpi=100)
        finally:
            self.patch.set_alpha(alpha)
        return stream.getvalue()
