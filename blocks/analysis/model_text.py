"""What the command line prints of linear models: objects for --json, and lines of text."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from ..frequency.delayed import DelayedModel
from ..frequency.disk import DiskMargins, disk_margins, sensitivities
from ..frequency.doubt import stability
from ..frequency.margins import IN_JSON, Margins, margins
from ..frequency.realization import balanced
from ..frequency.response import bandwidth, dc_gain, poles, zeros
from ..linear.transfer import LoopOfRates, Transfer
from ..model.copies import alike
from ..text.errors import AnalysisError, Fault
from ..text.printable import counted

if TYPE_CHECKING:
    from ..results.plots import Look


def _numbers(values: object) -> list[list[float]]:
    return [[float(p.real), float(p.imag)] for p in np.asarray(values, dtype=complex)]


def _rational(model: Transfer | DelayedModel) -> object:
    """Return the model without its dead time, or None if delays are on several ways: it has no such model."""
    if not isinstance(model, DelayedModel):
        return model
    return model.rational if model.dead_time is not None else None


def _delays(model: DelayedModel) -> str:
    if model.dead_time is not None:
        return f"{counted(model.rational.nstates, 'state')}, dead time {model.dead_time[1]:g} s"
    return f"exact delays of {', '.join(f'{delay:g} s' for delay in model.delays)} on several ways"


def _gain(model: object) -> object:
    """The gain at zero frequency: a number, or rows of numbers; None: infinite."""
    gains = [[float(x) if math.isfinite(x) else None for x in row] for row in np.real(dc_gain(model))]
    return gains[0][0] if _is_single(model) else gains


def _is_single(model: Any) -> bool:
    return len(model.signals[0]) == len(model.signals[1]) == 1


def _bandwidth(model: object) -> float | None:
    """Relative to the gain at zero frequency; None where there is no such gain."""
    if not _is_single(model):
        return None
    try:
        return bandwidth(model)
    except AnalysisError:
        return None


_STABILITY = {"stable": "stable", "border": "at the border of stability within rounding", "unstable": "not stable"}


def _stability(model: object) -> dict[str, object]:
    """The words of `Margins.as_json` of a model that is no loop."""
    verdict = stability(balanced(model))
    return {**dict.fromkeys(IN_JSON), "stable": verdict == "stable", "border": verdict == "border"}


def margins_of(model: Transfer | DelayedModel) -> Margins | DiskMargins:
    """Return the margins of a loop at one signal, or of the channels of a loop at several."""
    is_single = _is_single(model) or isinstance(model, LoopOfRates)
    return margins(model) if is_single else disk_margins(model)


def check_loop(model: Transfer | DelayedModel, point: str) -> None:
    """Raise AnalysisError (E705) for a loop transfer through which nothing comes back."""
    if isinstance(model, DelayedModel):
        return
    if not model.nstates and not model.D.any():
        message = f"a signal that enters there does not come back{'.' if model.hint else ': it is not part of a loop.'}"
        cure = model.hint or "Open the loop at a signal that feeds back to itself."
        raise AnalysisError(Fault("E705", point, message, cure))


def entry(model: Transfer | DelayedModel, known: Margins | DiskMargins | None) -> dict[str, Any]:
    """A model as one object: poles and zeros in 1/s (z of a sampled one), frequencies in rad/s.

    Of a loop with a dead time, poles and zeros are those without it, and `dead_time` is in s; where delays are on
    several ways, the three are None. Of a loop transfer with the margins of the closed loop, whose bandwidth is that of
    T; else `stable` says whether the poles of the model decay, and `border` whether it is at the border of stability
    within rounding.
    """
    rational = _rational(model)
    late = {}
    if isinstance(model, DelayedModel):
        late["dead_time"] = None if model.dead_time is None else model.dead_time[1]
    return {
        "poles": None if rational is None else _numbers(poles(rational)),
        "zeros": None if rational is None else _numbers(zeros(rational)),
        "dc_gain": _gain(model),
        "bandwidth": _bandwidth(model) if known is None else known.bandwidth if isinstance(known, Margins) else None,
        "margins": known.as_json() if known is not None else _stability(model),
        "period": float(model.dt) if model.dt else None,
        "inputs": list(model.signals[0]),
        "outputs": list(model.signals[1]),
        "units": [list(names) for names in model.units],
        "blocks": [asdict(block) for block in model.report],
        **late,
    }


def lines(model: Transfer | DelayedModel, known: Margins | DiskMargins | None) -> Iterator[str]:
    """A model as lines of text. known: the margins of a loop; None: of a model that is no loop."""
    rational = _rational(model)
    yield _title(model, is_loop=known is not None)
    plane = "z" if model.dt else "1/s"
    for title, roots in () if rational is None else (("poles", poles(rational)), ("zeros", zeros(rational))):
        shown = [_pole(p) for p in np.asarray(roots, dtype=complex) if p.imag >= 0]
        rest = f" and {len(shown) - 12} more" if len(shown) > 12 else ""
        yield f"  {title:<10} {'   '.join(shown[:12]) or 'none'}{rest}   [{plane}]"
    if _is_single(model):
        gain = _gain(model)
        yield f"  {'DC gain':<10} {'infinite' if gain is None else f'{gain:.8g}'}"
        width = _bandwidth(model)
        if known is None and width is not None:
            yield f"  {'bandwidth':<10} {width:.8g} rad/s, relative to the DC gain"
    if known is not None:
        shown = str(known).splitlines()
        if rational is None:
            how = "--pade 3 decides it by Padé models"
            shown[0] = f"{'closed loop':<16}stability unknown with delays on several ways; {how}"
        yield from (f"  {line}" for line in shown)
    else:
        yield f"  {_STABILITY[stability(balanced(model))]}"
    yield from _notes(model)


def _title(model: Transfer | DelayedModel, *, is_loop: bool) -> str:
    """Return what the model is of, and its size."""
    ins, outs = (", ".join(names) for names in model.signals)
    time = f", sampled every {model.dt:g} s" if model.dt else ""
    if isinstance(model, LoopOfRates):
        ins = model.point
        time = f", {len(model.times)} values of the signal in a pattern of {model.dt:g} s"
    what = f"loop at {ins}" if is_loop else f"{ins} -> {outs}"
    size = _delays(model) if isinstance(model, DelayedModel) else f"{counted(model.nstates, 'state')}{time}"
    return f"{what}: {size}"


def _notes(model: Transfer | DelayedModel) -> Iterator[str]:
    """How blocks were linearized where it was not exact, and those that are not part of the path."""
    notes = (
        f"{b.path} ({b.type}): {'; '.join(filter(None, (b.method, b.smoothness, b.note)))}"
        for b in model.report
        if b.contributes and (b.method, b.smoothness, b.note) != ("exact", "smooth", "")
    )
    yield from (f"  {note}" for note in alike(notes))
    if model.hint:
        yield f"  {model.hint}"
    idle = alike(b.path for b in model.report if not b.contributes)
    if idle:
        more = f" and {len(idle) - 8} more" if len(idle) > 8 else ""
        yield f"  not part of this path: {', '.join(idle[:8])}{more}"


def figure(
    model: Transfer | DelayedModel, kind: str, known: Margins | DiskMargins | None, look: Look | None = None
) -> Any:
    """A matplotlib figure: "bode", "nyquist", "nichols", "sigma" (of a loop: of S and T), "step" (of a loop: of the
    closed one) or "poles"; "": sigma of a loop at several signals, else bode. known: as of `lines`."""
    look = look or {}
    from ..frequency import figures
    from ..frequency.figure_curves import shown_of, span_of

    is_loop = known is not None

    if isinstance(model, LoopOfRates) and kind != "poles":
        message = "is a loop of several rates: one frequency comes back as several, so that it has no single curve."
        cure = "Draw its poles (--figure poles), or the closed loop (--from, --to)."
        raise AnalysisError(Fault("E705", model.point, message, cure))
    kind = kind or ("sigma" if isinstance(known, DiskMargins) else "bode")
    ins, outs = (", ".join(names) for names in model.signals)
    name = f"{model.name}: loop at {ins}" if is_loop else f"{model.name}: {ins} to {outs}"
    if kind == "sigma" and is_loop:
        shown = {f"{part} of {name}": system for part, system in sensitivities(model).items()}
        omega = span_of(shown_of({"L": model, **shown}, "sigma"), None)
        return figures.sigma(shown, omega, margins=known if isinstance(known, DiskMargins) else None, **look)
    if kind == "sigma":
        return figures.sigma({name: model}, **look)
    if isinstance(model, DelayedModel) and kind not in ("bode", "nyquist", "nichols"):
        message = "the loop has exact delays, but this figure needs a state space."
        raise AnalysisError(Fault("E707", ins, message, "Replace the delays by Padé models: --pade 3."))
    if isinstance(model, DelayedModel) or kind in ("bode", "nyquist", "nichols"):
        return getattr(figures, kind)({name: model}, margins=known if isinstance(known, Margins) else False, **look)
    if kind == "poles":
        return figures.pole_map({name: model}, **look)
    if is_loop:
        return figures.step_figure({f"{model.name}: loop closed at {ins}": model.closed()}, **look)
    return figures.step_figure({name: model}, **look)


def _pole(p: complex) -> str:
    if abs(p.imag) <= 1e-9 * abs(p):
        return f"{p.real:.7g}"
    return f"{p.real:.7g} +- {abs(p.imag):.7g}j"
