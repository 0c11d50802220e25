"""Signals that touch a threshold to within rounding: sides change where a signal goes through it, and nowhere else."""

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest

from blocks import (
    Abs,
    Backlash,
    CompareToConstant,
    Constant,
    Counter,
    DeadZone,
    Diagram,
    Expression,
    FirstOrder,
    MatrixGain,
    Multisine,
    Mux,
    Relay,
    Saturation,
    Sine,
    StateSpace,
    Step,
    Sum,
    SwitchAbove,
    Table,
    ZeroOrderHold,
)
from tests.support.marks import long

STOP = 3.0
Wave = Callable[[np.ndarray], np.ndarray]
SIGNALS: dict[str, tuple[Any, float, Wave]] = {
    "sines": (
        lambda: Multisine(harmonics=[1, 3, 4], period=1.5, amplitude=0.4),
        0.2,
        lambda t: 0.4 * sum(np.cos(2 * np.pi * n * t / 1.5 - p * np.pi / 3) for n, p in ((1, 0), (3, 2), (4, 6))),
    ),
    "sine": (
        lambda: Sine(amplitude=0.3, omega=6.0 * math.pi),
        0.3,
        lambda t: 0.3 * np.sin(6 * np.pi * t),
    ),
    "parabola": (lambda: Expression(expression="0.7-(t-1.1)**2"), 0.7, lambda t: 0.7 - (t - 1.1) ** 2),
    "saddle": (lambda: Expression(expression="(t-1.25)**3+0.7"), 0.7, lambda t: (t - 1.25) ** 3 + 0.7),
    "through": (
        lambda: Expression(expression="(t-1.25)**2*(t-0.5)+0.7"),
        0.7,
        lambda t: (t - 1.25) ** 2 * (t - 0.5) + 0.7,
    ),
    "rounded": (
        lambda: Expression(expression="sin(10*t)+sin(30*t)/3-2/3+1000-1000"),
        0.0,
        lambda t: np.sin(10 * t) + np.sin(30 * t) / 3 - 2 / 3,
    ),
    "one": (lambda: Expression(expression="sin(7*t)**2+cos(7*t)**2"), 1.0, np.ones_like),
}
"""Signals, a threshold that each touches, and their closed forms."""


def passes(wave: Wave, threshold: float) -> list[int]:
    """How often a signal comes to be above a threshold, and how often below, by more than rounding."""
    y = wave(np.linspace(0.0, STOP, 300_001)) - threshold
    signs = np.sign(y[np.abs(y) > 1e-9])
    return [int(np.sum(np.diff(signs) > 0)), int(np.sum(np.diff(signs) < 0))]


def laws(tick: float | None, *, above: float = 0.0, only: Iterable[str] = tuple(SIGNALS)) -> Diagram:
    """Return a diagram of signals before all blocks with a threshold, `above` higher than the signals reach."""
    signals = {name: SIGNALS[name] for name in only}
    d = Diagram("laws")
    d.add("zero", Constant(value=0.0))
    d.add("all", Sum(signs="+" * len(signals)))
    d.wire(d.add("lag", FirstOrder(T=0.5)).u, "all.y")
    for n, (name, (make, reached, _)) in enumerate(signals.items(), 1):
        threshold = reached + above
        d.add(name, make())
        d.wire(f"all.u{n}", f"{name}.y")
        for law, block in {
            "limit": Saturation(lower=-50.0, upper=threshold),
            "dead": DeadZone(lower=-50.0, upper=threshold),
            "compare": CompareToConstant(constant=threshold),
            "strict": CompareToConstant(constant=threshold, operator=">"),
            "counter": Counter(threshold=threshold),
            "relay": Relay(on_at=threshold, off_at=-50.0),
            "switch": SwitchAbove(threshold=threshold),
        }.items():
            d.add(f"{name}_{law}", block)
            d.wire(f"{name}_{law}.{'control' if law == 'switch' else 'u'}", f"{name}.y")
        d.wire(f"{name}_switch.u1", "zero.y")
        d.wire(f"{name}_switch.u2", "zero.y")
        d.add(f"{name}_level", Constant(value=threshold))
        d.wire(d.add(f"{name}_rest", Sum(signs="+-")).u1, f"{name}.y")
        d.wire(f"{name}_rest.u2", f"{name}_level.y")
        d.wire(d.add(f"{name}_abs", Abs()).u, f"{name}_rest.y")
        if tick is not None:
            d.wire(d.add(f"{name}_hold", ZeroOrderHold(period=tick)).u, f"{name}.y")
        d.measure(f"{name}_rises", "steady_state_error", of=f"{name}_counter.y")
        d.measure(f"{name}_signs", "zero_crossings", of=f"{name}_rest.y")
    return d


METHODS: dict[str, dict[str, Any]] = {
    "dopri5": {},
    "rk4": {"method": "rk4", "step": 0.01},
    "coarse": {"method": "rk4", "step": 0.037},
    "euler": {"method": "euler", "step": 0.01},
    "radau": {"method": "radau"},
    "auto": {"method": "auto"},
}
TICKS = {"rk4": 0.05, "coarse": 0.25, "euler": 0.25, "radau": 0.05, "auto": 0.1}
FEW = [("dopri5", None), ("dopri5", 0.25), *TICKS.items()]


def counts(results: Any) -> dict[str, list[int]]:
    """How often the sides of each block changed, upwards and downwards as its counter and the others have it."""
    fired = [event.block for event in results.events]
    found = {}
    for name in SIGNALS:
        rises = fired.count(f"{name}_counter")
        both = {fired.count(f"{name}_{law}") for law in ("limit", "dead", "compare", "switch", "abs")}
        strict = fired.count(f"{name}_strict")
        found[name] = [rises, *both, strict, fired.count(f"{name}_relay")]
        assert results.measures[f"{name}_rises"] == rises
    return found


def expected() -> dict[str, list[int]]:
    """The same by the closed forms."""
    wanted = {}
    for name, (_, threshold, wave) in SIGNALS.items():
        rises, falls = passes(wave, threshold)
        begins_above = float(wave(np.zeros(1))[0]) - threshold > 1e-9
        wanted[name] = [rises, rises + falls, rises + falls, int(rises > 0 and not begins_above)]
    return wanted


@pytest.mark.parametrize(("method", "tick"), FEW)
def test_sides_change_where_a_signal_goes_through_a_threshold_and_not_where_it_touches_it(
    method: str, tick: float | None
) -> None:
    assert counts(laws(tick).run(stop=STOP, engine="native", **METHODS[method])) == expected()


@pytest.mark.parametrize(("method", "tick"), [("dopri5", 0.25), long("rk4", None), long("radau", 0.25)])
def test_the_reference_engine_sees_the_same_touches(method: str, tick: float | None) -> None:
    assert counts(laws(tick).run(stop=STOP, engine="reference", **METHODS[method])) == expected()


def test_a_grid_changes_no_touch() -> None:
    diagram = laws(0.25)
    assert counts(diagram.run(stop=STOP, every=0.01)) == counts(diagram.run(stop=STOP, every=0.25)) == expected()


def peaks(above: float, tick: float | None) -> Diagram:
    """A sine with peaks at 0.25 s, 1.25 s, 2.25 s, a threshold that is `above` higher, and a count of its rises."""
    d = Diagram("peaks")
    wave = d.add("wave", Sine(amplitude=0.2, omega=2.0 * math.pi))
    counter = d.add("counter", Counter(threshold=0.2 + above))
    d.wire(counter.u, wave.y)
    d.wire(d.add("lag", FirstOrder(T=0.5)).u, wave.y)
    if tick is not None:
        hold = d.add("hold", ZeroOrderHold(period=tick))
        d.wire(hold.u, counter.y)
    return d


@pytest.mark.parametrize("engine", ["native", "reference"])
@pytest.mark.parametrize("settings", [{}, {"method": "rk4", "step": 0.01}], ids=["dopri5", "rk4"])
def test_a_signal_that_goes_a_little_above_its_threshold_crosses_it(engine: str, settings: dict[str, Any]) -> None:
    # At the ticks it is seen above; 1e-9 and 1e-12 are far more than its rounding errors.
    for above, rises in ((-1e-9, 3), (-1e-12, 3), (0.0, 0), (1e-12, 0), (1e-9, 0)):
        results = peaks(above, 0.25).run(stop=STOP, engine=engine, **settings)
        assert results["counter.y"][-1] == rises, above


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_a_jump_to_the_threshold_and_a_ramp_that_reaches_it_at_a_tick_switch(engine: str) -> None:
    d = Diagram("ties")
    d.add("step", Step(at=0.35, before=0.0, after=0.5))
    d.add("ramp", Expression(expression="t"))
    d.add("jumped", Relay(on_at=0.5, off_at=-1.0))
    d.add("reached", Relay(on_at=0.5, off_at=-1.0))
    d.add("hold", ZeroOrderHold(period=0.25))
    for sink, source in {"jumped.u": "step.y", "reached.u": "ramp.y", "hold.u": "reached.y"}.items():
        d.wire(sink, source)
    results = d.run(stop=1.0, engine=engine)
    assert [(event.block, event.t) for event in results.events if event.block != "step"] == [
        ("jumped", 0.35),
        ("reached", 0.5),
    ]
    assert results["hold.y"][results.t == 0.5].tolist()[-1] == 1.0


def test_lanes_and_rows_see_the_same_touches() -> None:
    names = ["sines_counter.threshold", "sine_counter.threshold"]
    for settings in ({}, {"method": "rk4", "step": 0.01}):
        diagram = laws(0.25, only=("sines", "sine"))
        diagram.settings(stop=STOP)
        for lanes in ("exact", "fast"):
            made = diagram.batch(names, lanes=lanes, **settings)([[0.2, 0.3], [0.2, 0.29], [0.1, 0.3], [0.2, 0.3]])
            assert {*made.status} == {"ok"}
            rises = made.measures["sines_rises"].tolist(), made.measures["sine_rises"].tolist()
            assert rises[0][0] == rises[0][1] == rises[0][3] == expected()["sines"][0]
            assert rises[1] == [0.0, 9.0, 0.0, 0.0]


def test_a_polynomial_of_radau_that_begins_with_another_slope_than_the_rates_is_no_zeno() -> None:
    # States rest on exactly 0 until the backlash is taken up: what falls then begins with a slope of 0.
    d = Diagram("rest")
    d.add("table", Table(times=[0.0, 0.3, 0.5], values=[0.0, 1.0, -1.0], interpolation="linear"))
    d.add("backlash", Backlash(width=0.2))
    d.add("both", Mux(size=2))
    d.add(
        "plant",
        StateSpace(A=[[-1.0, 2.0], [-2.0, -1.5]], B=[[1.0, 0.0], [0.3, 1.0]], C=[[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]),
    )
    d.add("gain", MatrixGain(K=[[-0.5, -0.2, 0.0]]))
    d.add("counter", Counter(threshold=0.0))
    for sink, source in {
        "backlash.u": "table.y", "both.u1": "backlash.y", "both.u2": "backlash.y", "plant.u": "both.y",
        "gain.u": "plant.y", "counter.u": "gain.y[0]",
    }.items():  # fmt: skip
        d.wire(sink, source)
    for engine in ("native", "reference"):
        explicit, implicit = (d.run(stop=2.0, method=method, engine=engine) for method in ("dopri5", "radau"))
        assert implicit["counter.y"][-1] == explicit["counter.y"][-1]
