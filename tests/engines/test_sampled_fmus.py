"""FMUs that sample, beside the blocks that they were made of: their ticks have one order, whatever they are."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    Diagram,
    DiscretePID,
    FirstOrder,
    Ramp,
    Results,
    Step,
    Sum,
    UnitDelay,
    ZeroOrderHold,
    fmu,
)
from blocks.compile.toolchain.compiler import find_compiler
from blocks.library import LIBRARY
from tests.support.library_variants import VARIANTS, resolved

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")

ENGINES = ("native", "reference")


@cache
def sampled() -> Diagram:
    """All sampled blocks of the library in all their forms with ports that are numbers.

    Not noise, whose numbers follow from its path.
    """
    d = Diagram("sampled")
    for number, (name, given) in enumerate(VARIANTS):
        made = resolved(name, given)
        ports = [*made.interface.inputs.values(), *made.interface.outputs.values()]
        if not made.clocks or name == "Noise" or any(port.shape or port.type != "real" for port in ports):
            continue
        block = f"{name}_{number}"
        d.add(block, LIBRARY[name](**given))
        for port in made.interface.inputs:
            d.wire(f"{block}.{port}", d.input(f"{block}_{port}"))
        for port in made.interface.outputs:
            d.output(f"{block}_{port}_out", f"{block}.{port}")
    return d


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same as FMUs."""
    folder = tmp_path_factory.mktemp("sampled")
    for fmi in (2, 3):
        sampled().export(folder / f"sampled{fmi}.fmu", fmi=fmi)
    return folder


def driven(unit: Any, source: str) -> Diagram:
    """A unit whose inputs jump at ticks. source: "inputs" of the diagram that jump, or the outputs of "holds".

    Holds behind it see its outputs at the same ticks.
    """
    d = Diagram("driven")
    box = d.add("box", unit)
    for name in sampled().value.inputs:
        entering: Any = d.input(name)
        if source == "holds":
            hold = d.add(f"{name}_hold", ZeroOrderHold(period=0.05))
            d.wire(hold.u, entering)
            entering = hold.y
        d.wire(f"box.{name}", entering)
    assert box is not None
    for name in list(sampled().value.outputs)[::3]:
        d.wire(d.add(f"{name}_seen", ZeroOrderHold(period=0.1)).u, f"box.{name}")
    return d


def ran(unit: Any, source: str, late: float = 0.0, **settings: Any) -> Results:
    """Rows at which nothing jumps. late: by how much inputs jump after the ticks, but for the first value."""
    rng, t = np.random.default_rng(3), np.arange(0.0, 1.0, 0.05)
    inputs = {
        name: (np.where(t > 0.0, t + late, t), rng.uniform(0.1, 0.9, len(t)), "hold") for name in sampled().value.inputs
    }
    log = [f"box.{name}" for name in sampled().value.outputs]
    log += [f"{name}_seen.y" for name in list(sampled().value.outputs)[::3]]
    given = {"stop": 0.9, "every": 0.025, "method": "rk4", "step": 0.025, **settings}
    return driven(unit, source).run(inputs=inputs, log=log, **given)


def assert_same(results: Results, expected: Results) -> None:
    for name in expected.names:
        assert np.allclose(results[name], expected[name], rtol=1e-9, atol=1e-12), name


@pytest.mark.parametrize("source", ["inputs", "holds"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_every_sampled_block_is_the_same_as_an_fmu_for_model_exchange(folder: Path, fmi: int, source: str) -> None:
    assert len(sampled().value.blocks) > 30
    expected = ran(sampled(), source, engine="native")
    for engine in ENGINES[: 2 if fmi == 2 else 1]:
        results = ran(fmu(folder / f"sampled{fmi}.fmu", kind="ME"), source, engine=engine)
        assert_same(results, expected)
        assert not [warning for warning in results.warnings if warning.code == "W210"]


def test_every_sampled_block_is_the_same_as_an_fmu_for_co_simulation_with_event_mode(folder: Path) -> None:
    unit = fmu(folder / "sampled3.fmu", kind="CS")
    assert_same(ran(unit, "inputs", master={"step": 0.025}), ran(sampled(), "inputs"))


def test_every_sampled_block_as_an_fmu_for_co_simulation_of_fmi_2_sees_a_jump_at_its_next_tick(folder: Path) -> None:
    """As a block sees one that comes just after the tick."""
    unit = fmu(folder / "sampled2.fmu", kind="CS")
    assert_same(ran(unit, "inputs", master={"step": 0.025}), ran(sampled(), "inputs", late=0.002))


# --- in loops ----------------------------------------------------------------------------------------------------


def exported(block: Block | Diagram, path: Path, fmi: int = 2) -> Any:
    d = block if isinstance(block, Diagram) else Diagram.alone(block)
    d.export(path, fmi=fmi, kinds=("ME",))
    return fmu(path, kind="ME")


def cascade(inner: Any) -> Diagram:
    """Two sampled controllers, one in the loop of the other, that tick at the same times."""
    d = Diagram("cascade")
    outer = d.add("outer", DiscretePID(period=0.1, kp=1.2, ki=1.0))
    d.add("inner", inner)
    fast, slow = d.add("fast", FirstOrder(T=0.15)), d.add("slow", FirstOrder(T=0.6))
    d.wire(outer.r, d.add("step", Step(at=0.5)).y)
    d.wire(outer.y, slow.y)
    d.wire("inner.r", outer.u)
    d.wire("inner.y", fast.y)
    d.wire(fast.u, "inner.u")
    d.wire(slow.u, fast.y)
    d.wire(d.add("seen", ZeroOrderHold(period=0.2)).u, "inner.u")
    return d


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_cascade_is_the_same_with_an_fmu_in_it(tmp_path: Path, fmi: int) -> None:
    block = DiscretePID(period=0.1, kp=2.0, ki=4.0)
    unit = exported(block, tmp_path / "inner.fmu", fmi)
    given: dict[str, Any] = {"stop": 4.0, "every": 0.05, "log": ["slow.y", "inner.u", "seen.y"], "rtol": 1e-9}
    expected = cascade(block).run(engine="native", **given)
    for engine in ENGINES:
        results = cascade(unit).run(engine=engine, **given)
        for name in given["log"]:
            assert np.allclose(results[name], expected[name], rtol=0, atol=1e-6), (name, engine)
        assert not results.warnings


@pytest.mark.parametrize("engine", ENGINES)
def test_fmus_one_behind_the_other_tick_in_the_order_of_their_wires(tmp_path: Path, engine: str) -> None:
    """Three holds of one tick, of which any may be FMUs, in any order of the file; also at the start."""
    unit = exported(ZeroOrderHold(period=0.5), tmp_path / "hold.fmu")
    for kinds in ((0, 1, 0), (1, 1, 1), (1, 0, 1)):
        for names in ("abc", "cba"):
            d = Diagram("chain")
            made = dict(zip("abc", kinds, strict=True))
            for name in names:
                d.add(name, unit if made[name] else ZeroOrderHold(period=0.5))
            for sink, source in zip("abc", (d.add("ramp", Ramp(before=1.0)).y, "a.y", "b.y"), strict=True):
                d.wire(f"{sink}.u", source)
            results = d.run(engine=engine, stop=1.2, every=0.25, log=["a.y", "b.y", "c.y"])
            for name in "abc":
                assert results[f"{name}.y"].tolist() == pytest.approx([1.0, 1.0, 1.5, 1.5, 2.0, 2.0]), (kinds, names)


def plant() -> Diagram:
    """A plant with a disturbance of its own that steps at 1 s, where the controller ticks."""
    d = Diagram("plant")
    first, total = d.add("first", FirstOrder(T=0.5)), d.add("total", Sum())
    d.wire(first.u, d.input("u"))
    d.wire(total.u1, first.y)
    d.wire(total.u2, d.add("disturbance", Step(at=1.0, after=0.4)).y)
    d.output("y", total.y)
    return d


def controlled(unit: Any) -> Diagram:
    d = Diagram("controlled")
    pid = d.add("pid", DiscretePID(period=0.25, kp=1.5, ki=1.0))
    d.add("plant", unit)
    d.wire(pid.r, d.add("wanted", Step(at=0.0)).y)
    d.wire(pid.y, "plant.y")
    d.wire("plant.u", pid.u)
    return d


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_step_inside_a_plant_is_seen_by_a_controller_that_ticks_then(tmp_path: Path, fmi: int) -> None:
    unit = exported(plant(), tmp_path / "plant.fmu", fmi)
    given: dict[str, Any] = {"stop": 2.0, "every": 0.125, "log": ["pid.u", "plant.y"], "rtol": 1e-9}
    expected = controlled(plant()).run(engine="native", **given)
    for engine in ENGINES:
        results = controlled(unit).run(engine=engine, **given)
        for name in given["log"]:
            assert np.allclose(results[name], expected[name], rtol=0, atol=1e-6), (name, engine)
        assert not results.warnings
    before, after = (expected["pid.u"][np.argmin(np.abs(expected.t - t))] for t in (0.875, 1.0))
    assert after < before - 0.3  # it does see it


@pytest.mark.parametrize("engine", ENGINES)
def test_in_a_circle_an_fmu_comes_first_with_a_warning(tmp_path: Path, engine: str) -> None:
    """A UnitDelay as an FMU, whose output the block samples that it delays: y = 1, 2, ... is 1, 1, 2, 2, ..."""
    unit = exported(UnitDelay(period=0.5), tmp_path / "delay.fmu")
    for offset, is_late in ((0.0, True), (0.2, False)):
        d = Diagram("circle")
        d.add("delay", unit)
        add = d.add("add", Sum())
        d.wire(add.u1, "delay.y")
        d.wire(add.u2, d.add("one", Step(at=-1.0)).y)
        d.wire(d.add("hold", ZeroOrderHold(period=0.5, offset=offset)).u, add.y)
        d.wire("delay.u", "hold.y")
        results = d.run(engine=engine, stop=2.0, every=0.5, log=["hold.y"])
        if is_late:
            assert results["hold.y"].tolist() == [1.0, 1.0, 2.0, 2.0, 3.0]
        assert [(w.code, w.place) for w in results.warnings] == [("W210", "delay")] * is_late


@pytest.mark.parametrize("fmi", [2, 3])
def test_fmpy_sees_a_jump_at_a_tick_as_we_do(tmp_path: Path, fmi: int) -> None:
    """An input that jumps at 1 s, where the FMU ticks."""
    from fmpy import simulate_fmu

    unit = exported(ZeroOrderHold(period=0.5), tmp_path / "hold.fmu", fmi)
    signal = np.array([(0.0, 1.0), (1.0, 1.0), (1.0, 2.0), (2.0, 2.0)], dtype=[("time", float), ("u", float)])
    theirs = simulate_fmu(
        str(tmp_path / "hold.fmu"), fmi_type="ModelExchange", stop_time=2.0, output_interval=0.25, input=signal,
        output=["y"],
    )  # fmt: skip
    d = Diagram("jump")
    d.wire(d.add("hold", unit).u, d.input("u"))
    ours = d.run(stop=2.0, every=0.25, inputs={"u": (signal["time"], signal["u"])}, log=["hold.y"], engine="native")
    for t in (0.75, 1.25, 1.75):
        at = np.argmin(np.abs(theirs["time"] - t))
        assert ours["hold.y"][np.argmin(np.abs(ours.t - t))] == theirs["y"][at] == (1.0 if t < 1.0 else 2.0)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_cascade_goes_on_from_a_tick_as_a_whole_run_does(tmp_path: Path, engine: str) -> None:
    """Saved at ticks, and with the same events in the same order by both engines."""
    unit = exported(DiscretePID(period=0.1, kp=2.0, ki=4.0), tmp_path / "inner.fmu", 3)
    d, stops = cascade(unit), [0.5, 0.85, 1.2]
    given: dict[str, Any] = {"stop": 1.5, "stops": stops, "every": 0.05, "log": ["slow.y", "inner.u", "seen.y"]}
    whole = d.run(engine=engine, method="rk4", step=0.05, **given)
    run = d.start(engine=engine, method="rk4", step=0.05, **given)
    for stop in stops:
        run.advance_to(stop)
        run = d.start(engine=engine, method="rk4", step=0.05, resume=run.snapshot(), **given)
    rest = run.finish()
    assert [rest[name][-1] for name in given["log"]] == [whole[name][-1] for name in given["log"]]
    other = d.run(engine="native", method="rk4", step=0.05, **given)
    assert [(e.t, e.block, e.what) for e in whole.events] == [(e.t, e.block, e.what) for e in other.events]
