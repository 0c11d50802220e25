"""Exact delays in discrete-time models: against runs, closed forms, and holds with an offset."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

import blocks
from blocks import AnalysisError, BlocksError, Diagram, UsageError
from blocks.analysis import limit_cycles
from blocks.frequency.margins import margins
from blocks.frequency.response import response

Array = np.ndarray[Any, Any]
PERIOD = 0.1
IRRATIONAL = PERIOD * math.sqrt(2.0) / 3.0

# A run at rtol = atol = 1e-12 is right to some 1e-11 of what it shows after some periods.
RUN = 1e-10
# Two routes in double precision through matrices of norm 1.
SAME = 1e-11


def delayed_loop(
    before: Sequence[float] = (), between: Sequence[float] = (), behind: Sequence[float] = (), *, slow: float = 0.0,
    offset: float = 0.0, plant: Any = None, gain: float = 1.0, inner: float = 0.0,
) -> Diagram:  # fmt: skip
    """r - y through a sampled block, delays, d, a lag, delays, a plant, delays, and a hold of another rate.

    inner: the delay of a feedback around the lag.
    """
    made = Diagram("late")
    r, d = made.input("r"), made.input("d", default=0.0)
    made.add("error", blocks.Sum(signs="+-"))
    made.wire("error.u1", r)
    num = [0.9 * gain, -0.6 * gain]
    controller = blocks.DiscreteTransferFunction(num=num, den=[1.0, -0.4], period=PERIOD, offset=offset)
    parts: list[tuple[str, Any]] = [("controller", controller)]
    parts += [(f"before{k}", blocks.TransportDelay(delay=delay)) for k, delay in enumerate(before)]
    parts += [("load", blocks.Sum(signs="+++")), ("lag", blocks.FirstOrder(T=0.3, k=1.5))]
    parts += [(f"between{k}", blocks.TransportDelay(delay=delay)) for k, delay in enumerate(between)]
    parts += [("plant", plant or blocks.TransferFunction(num=[1.0], den=[1.0, 0.5]))]
    parts += [(f"behind{k}", blocks.TransportDelay(delay=delay)) for k, delay in enumerate(behind)]
    parts += [("sensor", blocks.ZeroOrderHold(period=slow) if slow else blocks.Gain(k=1.0))]
    origin = "error"
    for name, block in parts:
        made.add(name, block)
        made.wire(f"{name}.u1" if name == "load" else f"{name}.u", f"{origin}.y")
        origin = name
    made.wire("load.u2", d)
    made.wire("error.u2", "sensor.y")
    made.add("inner", blocks.TransportDelay(delay=inner) if inner else blocks.Gain(k=0.0))
    made.wire("inner.u", "lag.y")
    made.wire("load.u3", "inner.y")
    return made


def random(count: int, seed: int) -> Array:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, count)


def from_model(model: Any, u: Array) -> Array:
    """The response of a model to u, (inputs, steps), from rest: (outputs, steps)."""
    A, B, C, D = (np.asarray(m) for m in (model.A, model.B, model.C, model.D))
    x, made = np.zeros(len(A)), []
    for k in range(u.shape[1]):
        made.append(C @ x + D @ u[:, k])
        x = A @ x + B @ u[:, k]
    return np.array(made).T


def run_of(diagram: Diagram, names: list[str], times: Array, u: Array, every: float) -> Array:
    """The values in a run just after what happens at times, where r and d take new values: (names, times)."""
    given = {}
    for name, values in zip(("r", "d"), u, strict=True):
        begins = times[0] > 0.0
        given[name] = (np.r_[0.0, times] if begins else times, np.r_[0.0, values] if begins else values, "hold")
    every = every if times[0] == 0.0 else 0.5 * every
    run = diagram.run(
        inputs=given, stop=float(times[-1]) + 0.4 * every, every=every, log=names, rtol=1e-12, atol=1e-12,
        engine="reference",
    )  # fmt: skip
    rows = np.searchsorted(run.t, times + 1e-9, side="right") - 1
    assert np.max(np.abs(run.t[rows] - times)) < 1e-9
    return np.array([run[name][rows] for name in names])


LOOPS: list[dict[str, Any]] = [
    {"before": [0.03]},
    {"before": [0.1]},
    {"before": [IRRATIONAL]},
    {"between": [0.27]},
    {"between": [0.1]},
    {"behind": [0.27]},
    {"behind": [0.1]},
    {"behind": [3 * 0.1], "before": [0.2]},  # one unit in the last place above three periods
    {"before": [0.03], "between": [0.07], "behind": [IRRATIONAL]},
    {"behind": [0.05, 0.05], "offset": 0.05},
    {"between": [IRRATIONAL], "slow": 0.25},
    {"before": [0.7], "behind": [0.13], "slow": 0.25},
]


@pytest.mark.parametrize("delays", LOOPS, ids=str)
def test_a_loop_with_delays_answers_as_its_model(delays: dict[str, Any]) -> None:
    diagram = delayed_loop(**delays)
    names = ["plant.y", "sensor.y", "controller.y", "lag.y", "load.y"]
    model = diagram.linearize(["r", "d"], names)
    assert model.dt == pytest.approx(0.5 if "slow" in delays else PERIOD, rel=1e-15)
    count = 6 if "slow" in delays else 20
    u = np.array([random(count, 1), random(count, 2)])
    times = delays.get("offset", 0.0) + model.dt * np.arange(count)
    assert np.allclose(run_of(diagram, names, times, u, model.dt), from_model(model, u), rtol=RUN, atol=RUN)


@pytest.mark.parametrize("delays", [{"between": [0.13]}, {"before": [IRRATIONAL], "behind": [0.6]}], ids=str)
def test_a_lifted_model_with_delays_has_all_base_steps_of_a_run(delays: dict[str, Any]) -> None:
    diagram, names = delayed_loop(**delays, slow=0.15), ["plant.y", "controller.y", "load.y"]
    model = diagram.linearizer().lifted(["r", "d"], names)
    assert model.steps == 6
    count = 6 * 5
    u = np.array([random(count, 1), random(count, 2)])
    seen = run_of(diagram, names, 0.05 * np.arange(count), u, 0.05)
    stacked = u.T.reshape(5, 12).T  # by pattern: the inputs of its first base step, then those of the next
    known = from_model(model, stacked).T.reshape(count, 3).T
    assert np.allclose(seen, known, rtol=RUN, atol=RUN)


@pytest.mark.parametrize("delay", [0.03, 0.1, 0.27, IRRATIONAL])
def test_an_integrator_behind_a_delayed_hold_is_its_modified_z_transform(delay: float) -> None:
    diagram = Diagram("integrator")
    parts = {"hold": blocks.ZeroOrderHold(period=PERIOD), "late": blocks.TransportDelay(delay=delay)}
    for name, block in (parts | {"plant": blocks.Integrator(), "back": blocks.Gain(k=-1.0)}).items():
        diagram.add(name, block)
    for origin, sink in itertools.pairwise(["plant", "back", "hold", "late", "plant"]):
        diagram.wire(f"{sink}.u", f"{origin}.y")
    loop = diagram.linearizer().loop("hold.y")
    omega = np.geomspace(0.1, 30.0, 20)
    z = np.exp(1j * omega * PERIOD)
    # y[k+1] = y[k] + (T - rest) u[k - whole] + rest u[k - whole - 1]
    whole = 1 if delay == 0.1 else int(delay / PERIOD)
    rest = delay - whole * PERIOD
    wanted = z ** -float(whole) * ((PERIOD - rest) + rest / z) / (z - 1.0)
    assert np.allclose(response(loop, omega)[0, 0], wanted, rtol=SAME)
    found = np.sort(np.abs(np.linalg.eigvals(np.asarray(loop.A))))
    assert found[-1] == pytest.approx(1.0, rel=1e-15)
    assert np.all(found[:-1] == 0.0)


@pytest.mark.parametrize(
    ("slow", "point"), [(0.0, "controller.y"), (0.0, "before0.y"), (0.0, "sensor.y"), (0.25, "load.y")]
)
def test_the_gain_margin_of_a_delayed_loop_is_the_border_of_its_poles(point: str, slow: float) -> None:
    delays: dict[str, Any] = {"before": [0.13], "between": [IRRATIONAL], "slow": slow}
    found = margins(delayed_loop(**delays).linearizer().loop(point))
    assert found.stable
    assert found.gain is not None
    radius = [
        np.max(np.abs(delayed_loop(**delays, gain=found.gain * factor).linearize("r", "plant.y").poles()))
        for factor in (1.0 - 1e-6, 1.0 + 1e-6)
    ]
    assert radius[0] < 1.0 < radius[1]


def test_a_delay_commutes_with_a_plant() -> None:
    omega = np.geomspace(0.1, 31.0, 30)
    parts: list[dict[str, Any]] = [
        {"before": [0.17]},
        {"between": [0.17]},
        {"behind": [0.17]},
        {"before": [0.1], "behind": [0.07]},
    ]
    loops = [delayed_loop(**part).linearizer().loop("controller.y") for part in parts]
    first = response(loops[0], omega)
    for loop in loops[1:]:
        assert np.allclose(response(loop, omega), first, rtol=SAME)
        assert margins(loop).phase_deg == pytest.approx(margins(loops[0]).phase_deg, rel=1e-10)


@pytest.mark.parametrize("delays", [{"before": [0.03]}, {"between": [0.27]}, {"behind": [IRRATIONAL, 0.2]}], ids=str)
def test_delays_add_no_poles_but_zero(delays: dict[str, Any]) -> None:
    plant = blocks.TransferFunction(num=[2.0], den=[1.0, -2.0, 0.0])  # at 0 and 2
    loop = delayed_loop(**delays, plant=plant).linearizer().loop("controller.y")
    found = np.sort(np.abs(np.linalg.eigvals(np.asarray(loop.A))))
    known = [0.4, math.exp(-PERIOD / 0.3), 1.0, math.exp(2.0 * PERIOD)]
    assert np.allclose(found[-4:], known, rtol=1e-9)
    assert np.all(found[:-4] == 0.0)


@pytest.mark.parametrize("unstable", [False, True])
def test_stability_with_a_delay_is_that_of_a_run(unstable: bool) -> None:
    limit = margins(delayed_loop(behind=[0.27]).linearizer().loop("controller.y")).gain
    assert limit is not None
    diagram = delayed_loop(behind=[0.27], gain=limit * (1.03 if unstable else 0.97))
    assert margins(diagram.linearizer().loop("sensor.y")).stable is not unstable
    run = diagram.run(inputs={"r": 1.0}, stop=30.0, every=0.1, engine="reference", log=["plant.y"])
    early, late = (np.ptp(run["plant.y"][(run.t > begin) & (run.t < begin + 6.0)]) for begin in (12.0, 24.0))
    assert late > 1.1 * early if unstable else late < 0.9 * early


def test_a_sampled_block_reads_what_a_delay_gives_at_its_tick() -> None:
    """A delay of one period between two holds is a delay by one sample: its new value arrives before the tick."""
    diagram = Diagram("holds")
    parts = {"first": blocks.ZeroOrderHold(period=PERIOD), "late": blocks.TransportDelay(delay=PERIOD)}
    for name, block in (parts | {"second": blocks.ZeroOrderHold(period=PERIOD)}).items():
        diagram.add(name, block)
    diagram.wire("first.u", diagram.input("r"))
    diagram.wire("late.u", "first.y")
    diagram.wire("second.u", "late.y")
    model = diagram.linearize("r", "second.y")
    assert (model.nstates, float(model.D[0, 0])) == (1, 0.0)
    omega = np.array([1.0, 20.0])
    assert np.allclose(response(model, omega)[0, 0], np.exp(-1j * omega * PERIOD), rtol=1e-14)
    assert np.allclose(diagram.linearizer().response("r", "second.y", omega), response(model, omega), rtol=1e-14)


def test_a_delay_that_acts_back_on_itself_in_continuous_time_has_pade_models_only() -> None:
    linearizer = delayed_loop(before=[0.03], inner=0.2).linearizer()
    asked: list[Callable[[], Any]] = [
        lambda: linearizer.model("r", "plant.y"), lambda: linearizer.loop("controller.y"),
        lambda: linearizer.exact_loop("controller.y"), lambda: linearizer.lifted("r", "plant.y"),
        lambda: linearizer.response("r", "plant.y", 1.0),
    ]  # fmt: skip
    for ask in asked:
        with pytest.raises(AnalysisError, match=r"E707 late: .*: inner\.past \(0\.2 s\)\. .*pade=3 in model"):
            ask()
    # With the inner loop open all is exact.
    assert linearizer.loop("controller.y", openings="inner.y").nstates > 3
    model = linearizer.model("r", "plant.y", pade=3)
    assert ["Padé" in block.method for block in model.report if "Delay" in block.type] == [True, True]


def test_a_loop_is_not_opened_where_a_delay_reads_what_moves_between_ticks() -> None:
    linearizer = delayed_loop(behind=[0.13]).linearizer()
    with pytest.raises(AnalysisError, match=r"E705 plant\.y: changes and acts between the ticks"):
        linearizer.loop("plant.y")
    # Behind the delay only the tick reads it.
    omega = np.array([1.0, 10.0])
    behind, held = linearizer.loop("behind0.y"), linearizer.loop("controller.y")
    assert np.allclose(response(behind, omega), response(held, omega), rtol=SAME)


def test_a_loop_with_sampled_blocks_has_no_model_of_frequencies_alone() -> None:
    linearizer = delayed_loop(before=[0.13]).linearizer()
    with pytest.raises(UsageError, match=r"E501 late: sampled blocks contribute.*model\(\)"):
        linearizer.delayed_loop("controller.y")
    loop = linearizer.exact_loop("controller.y")
    assert loop.dt == PERIOD
    assert not any("Padé" in block.method for block in loop.report)


def test_delays_that_keep_too_much_are_refused() -> None:
    with pytest.raises(BlocksError, match=r"E703 late: exact delays keep \d+ values from tick to tick.*pade=3"):
        delayed_loop(before=[1000.0]).linearizer().loop("controller.y")


def test_a_dead_time_of_many_periods_has_the_margins_of_as_many_unit_delays() -> None:
    plant = blocks.TransferFunction(num=[0.3], den=[1.0, 0.0])
    rest = {"plant": plant, "back": blocks.Gain(k=-1.0)}
    chains: list[dict[str, Any]] = [
        {"late": blocks.Delay(samples=20, period=PERIOD)} | rest,
        {"late": blocks.ZeroOrderHold(period=PERIOD), "dead": blocks.TransportDelay(delay=20 * PERIOD)} | rest,
    ]
    found = []
    for chain in chains:
        diagram = Diagram("dead")
        for name, block in chain.items():
            diagram.add(name, block)
        for origin, sink in itertools.pairwise([*chain, "late"]):
            diagram.wire(f"{sink}.u", f"{origin}.y")
        found.append(margins(diagram.linearizer().loop("late.y")))
    sampled, exact = found
    assert sampled.stable
    assert exact.stable
    for name in ("gain", "phase_deg", "delay", "modulus", "Ms"):
        assert getattr(exact, name) == pytest.approx(getattr(sampled, name), rel=1e-9)


def test_limit_cycles_with_a_dead_time_are_those_of_a_hold_with_an_offset() -> None:
    rest = {"plant": blocks.TransferFunction(num=[6.0], den=[1.0, 1.0, 0.0]), "back": blocks.Gain(k=-1.0)}
    law, hold = {"law": blocks.Saturation(lower=-0.1, upper=0.1)}, {"hold": blocks.ZeroOrderHold(period=PERIOD)}
    lags: list[dict[str, Any]] = [
        hold | {"late": blocks.ZeroOrderHold(period=PERIOD, offset=0.07)},
        hold | {"late": blocks.TransportDelay(delay=0.07)},
    ]
    diagrams = []
    for lag in lags:
        diagram = Diagram("cycle")
        chain: dict[str, Any] = law | lag | {"lag": blocks.FirstOrder(T=0.5)} | rest
        for name, block in chain.items():
            diagram.add(name, block)
        for origin, sink in itertools.pairwise([*chain, "law"]):
            diagram.wire(f"{sink}.u", f"{origin}.y")
        diagrams.append(diagram)
    held, exact = (limit_cycles(diagram) for diagram in diagrams)
    assert len(exact) == len(held) == 1
    assert exact[0].omega == pytest.approx(held[0].omega, rel=1e-9)
    assert exact[0].amplitudes["law.u"] == pytest.approx(held[0].amplitudes["law.u"], rel=1e-9)


def test_a_law_that_acts_on_a_delay_between_ticks_has_no_harmonic_balance() -> None:
    diagram = Diagram("law")
    chain: dict[str, Any] = {"sensor": blocks.ZeroOrderHold(period=PERIOD), "lag": blocks.FirstOrder(T=0.5)}
    chain |= {"law": blocks.Saturation(lower=-0.1, upper=0.1), "late": blocks.TransportDelay(delay=0.07)}
    for name, block in chain.items():
        diagram.add(name, block)
    diagram.wire("sensor.u", diagram.input("r"))
    for origin, sink in itertools.pairwise(chain):
        diagram.wire(f"{sink}.u", f"{origin}.y")
    diagram.add("reader", blocks.ZeroOrderHold(period=PERIOD))
    diagram.wire("reader.u", "late.y")
    with pytest.raises(AnalysisError, match=r"E704 law\.y: is read between the ticks"):
        diagram.linearizer().harmonic_response("r", ["reader.y"], [1.0], amplitude=1.0)
