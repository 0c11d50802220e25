"""The figures of blocks: those of matplotlib, which show themselves in a notebook, with `%matplotlib` and without it.

matplotlib's own have no form for a notebook: IPython gets one where `%matplotlib inline` or pyplot's `show` sets it up,
and then shows what pyplot has made, which these are not. So each shows itself once, as the last value of a cell or by
`display`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import matplotlib
from matplotlib.figure import Figure as Drawn


class Figure(Drawn):
    """A figure of matplotlib with its forms for a notebook, by media type.

    parts, along: the panels that it shows and the label of their x axis, where it was made of such.
    """

    forms: Mapping[str, Callable[[Figure], object]]
    parts: Sequence[Any] = ()
    along: str = ""

    def savefig(self, fname: Any, **given: Any) -> None:
        """As of matplotlib, on white where nothing else is asked for: a page may be dark.

        PDF and PostScript hold TrueType fonts: publishers refuse the fonts of type 3 that matplotlib writes by itself.
        """
        alpha = self.patch.get_alpha()
        try:
            if given.get("transparent") is None and "facecolor" not in given:
                self.patch.set_alpha(1.0)
            with matplotlib.rc_context({"pdf.fonttype": 42, "ps.fonttype": 42}):
                super().savefig(fname, **given)
        finally:
            self.patch.set_alpha(alpha)

    def _repr_mimebundle_(
        self, include: Collection[str] | None = None, exclude: Collection[str] | None = None
    ) -> dict[str, object]:
        asked = [kind for kind in self.forms if (not include or kind in include) and kind not in (exclude or ())]
        return {kind: self.forms[kind](self) for kind in asked}
