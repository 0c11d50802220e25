"""What instants cost, against hand-written C that does the same: known edges, ticks, and located switchings."""

from __future__ import annotations

from fractions import Fraction
from functools import partial
from typing import Any

from blocks import Diagram
from blocks.library import DiscreteIntegrator, Gain, Relay, SecondOrder, SquareWave, Step, Sum, ZeroOrderHold

from .measure import FOLDER, HEAD, Made, difference, floors, in_turn, line, native, on_one_core

__all__ = ["main", "pwm", "relay", "sampled"]

MOST = 50.0  # ns
RK4: dict[str, Any] = {"method": "rk4", "step": 0.001}


def pwm() -> Diagram:
    """A filter behind a pulse train: 40,000 edges a second, whose times are known."""
    diagram = Diagram("pwm")
    train = diagram.add("train", SquareWave(period=5e-5, duty=0.4, high=12.0))
    plant = diagram.add("filter", SecondOrder(w=1000.0, d=0.6))
    diagram.wire(plant.u, train.y)
    diagram.settings(stop=0.5, method="rk4", step=1e-5, every=0.01, log=["filter.y", "train.y"])
    return diagram


def sampled() -> Diagram:
    """A plant under a PI controller that is sampled in each step of the solver."""
    diagram = Diagram("sampled")
    plant = diagram.add("plant", SecondOrder(w=5.0, d=0.6))
    aim = diagram.add("aim", Step(at=0.0, after=1.0))
    error = diagram.add("error", Sum(signs="+-"))
    sampler = diagram.add("sampler", ZeroOrderHold(period=0.001))
    ki, kp = diagram.add("ki", Gain(k=2.0)), diagram.add("kp", Gain(k=0.5))
    integral = diagram.add("integral", DiscreteIntegrator(period=0.001))
    control = diagram.add("control", Sum(signs="++"))
    for sink, source in (
        (error.u1, aim.y),
        (error.u2, plant.y),
        (sampler.u, error.y),
        (ki.u, sampler.y),
        (kp.u, sampler.y),
        (integral.u, ki.y),
        (control.u1, kp.y),
        (control.u2, integral.y),
        (plant.u, control.y),
    ):
        diagram.wire(sink, source)
    diagram.settings(stop=20.0, every=0.01, log=["plant.y", "control.y"], **RK4)
    return diagram


def relay() -> Diagram:
    """A plant in a loop with a relay with hysteresis, which switches some seven times a second."""
    diagram = Diagram("relay")
    plant = diagram.add("plant", SecondOrder(w=5.0, d=0.6))
    error = diagram.add("error", Gain(k=-1.0))
    switch = diagram.add("relay", Relay(on_at=0.125, off_at=-0.125, on=8.0, off=-8.0))
    diagram.wire(error.u, plant.y)
    diagram.wire(switch.u, error.y)
    diagram.wire(plant.u, switch.y)
    diagram.settings(stop=1000.0, method="dopri5", rtol=1e-6, atol=1e-9, every=0.1, log=["plant.y", "relay.y"])
    return diagram


def main() -> None:
    with on_one_core():
        print(f"rows each 10 ms\n{HEAD}")
        _one("edges, rk4 10 us, 0.5 s", pwm(), 0, 0.5, Fraction(1, 100_000), 20_000, {})
        _one("ticks, rk4 1 ms, 20 s", sampled(), 1, 20.0, Fraction(1, 1000), 20_000, {})
        print(f"rows each 0.1 s\n{HEAD}")
        _one("relay, dopri5, 1,000 s", relay(), 2, 1000.0, None, 0, {})
        _one("relay, rk4 1 ms, 100 s", relay(), 2, 100.0, Fraction(1, 1000), 0, {**RK4, "stop": 100.0})


def _one(
    label: str, diagram: Diagram, kind: int, until: float, step: Fraction | None, count: int, settings: dict[str, Any]
) -> None:
    """count: of instants, of which each may take MOST ns more than in C; 0: a run may take 1.5 times as long."""
    programs, kept = floors("C", FOLDER / "c" / "instants.c", 2, KIND=kind), {}
    every = Fraction(1, 10) if kind == 2 else Fraction(1, 100)

    def seconds(name: str, run: Any) -> float:
        kept[name] = made = run()
        return float(made.seconds)

    runs = {name: partial(made.run, until, step=step, every=every) for name, made in programs.items()}
    runs["native"] = partial(native, diagram, **settings)
    made = in_turn({name: partial(seconds, name, run) for name, run in runs.items()})
    print(label)
    for name in programs:
        note = ""
        if count:
            beyond = 1e9 * (min(made["native"]) - min(made[name])) / count
            note = f"{beyond:.0f} ns beyond each instant's, <= {MOST:g} {'met' if beyond <= MOST else 'MISSED'}"
        print(line(f"  native / {name}", made["native"], made[name], None if count else 1.5, note))
    one: Made = kept["C"]
    apart = difference(one, kept["native"], every)[0]
    instants = diagram.run(engine="native", **settings).statistics.instants
    print(
        f"    {one.steps} and {kept['native'].steps} steps, {instants} instants, largest difference {apart:.0e}",
        flush=True,
    )
