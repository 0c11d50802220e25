"""What a master gets wrong easily: unrelated instants, chains without a way back, readers that are ahead."""

import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from blocks import (
    Block,
    Diagram,
    Expression,
    FirstOrder,
    FMUError,
    Input,
    Integrator,
    Pulse,
    Ramp,
    SimulationError,
    Sine,
    State,
    Sum,
    ZeroOrderHold,
    fmu,
)
from blocks.compile.toolchain.compiler import find_compiler
from tests.support.marks import long
from tests.support.places import ROOT

ENGINES = ["reference", *(["native"] if find_compiler() is not None else [])]
each_engine = pytest.mark.parametrize("engine", ENGINES)


class Half(Block):
    """One half of an oscillator: x' = u, or x' = -u."""

    u = Input()
    x = State(1.0, output=True)

    @x.derivative
    def dx(u):
        return u


class OtherHalf(Block):
    """The other half."""

    u = Input()
    x = State(output=True)

    @x.derivative
    def dx(u):
        return -u


def oscillator() -> Diagram:
    made = Diagram("oscillator")
    a, b = made.add("a", Half()), made.add("b", OtherHalf())
    made.wire(a.u, b.x)
    made.wire(b.u, a.x)
    return made


@each_engine
@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "iterated"])
@pytest.mark.parametrize("order", [1, 2])
def test_ticks_of_a_block_that_nobody_reads_change_nothing_elsewhere(engine: str, algorithm: str, order: int) -> None:
    ends = []
    for is_ticking in (False, True):
        made = oscillator()
        if is_ticking:
            hold = made.add("hold", ZeroOrderHold(period=0.03))
            made.wire(hold.u, made.add("sine", Sine()).y)
        results = made.run(
            stop=1, engine=engine, rtol=1e-10, atol=1e-12,
            master={"step": 0.1, "algorithm": algorithm, "order": order, "couple": "each"},
        )  # fmt: skip
        ends.append([results[name][-1] for name in ("a.x", "b.x")])
    assert ends[1] == pytest.approx(ends[0], abs=5e-3)
    assert ends[0] == pytest.approx([np.cos(1), -np.sin(1)], abs=1e-2)


@each_engine
def test_error_control_sees_a_chain_that_nobody_reads(engine: str) -> None:
    made = Diagram("chain")
    lag = made.add("lag", FirstOrder(T=0.2))
    made.wire(lag.u, made.add("sine", Sine(omega=6.0)).y)
    exact = made.run(stop=3, rtol=1e-11, atol=1e-13)["lag.y"][-1]
    for tolerance in (1e-2, 1e-4):
        results = made.run(
            stop=3, engine=engine, rtol=1e-10, atol=1e-12, master={"tolerance": tolerance, "couple": "each"}
        )
        assert results["lag.y"][-1] == pytest.approx(exact, abs=tolerance)


@each_engine
def test_time_never_goes_back_and_nobody_misses_a_jump(engine: str) -> None:
    made = Diagram("late")
    area = made.add("area", Integrator())
    made.wire(area.u, made.add("pulse", Pulse(on=0.33, off=0.71)).y)
    results = made.run(stop=1, engine=engine, master={"step": 0.1, "steps": {"area": 0.02}, "couple": "each"})
    assert np.all(np.diff(results.t) >= 0)
    assert results["area.y"][-1] == pytest.approx(0.38, abs=1e-9)


@pytest.mark.parametrize(("engine", "n"), [*((engine, 20) for engine in ENGINES), *(long(e, 250) for e in ENGINES[1:])])
def test_an_island_of_many_inputs_goes_back(engine: str, n: int) -> None:
    made = Diagram("wide")
    made.add("total", Sum(signs="+" * n))
    one = made.add("one", Sine())
    for k in range(n):
        part = made.add(f"part{k}", Integrator())
        made.wire(part.u, one.y)
        made.wire(f"total.u{k + 1}", part.y)
    results = made.run(stop=0.2, engine=engine, log=["total.y"], master={"tolerance": 1e-2, "couple": "each"})
    assert np.isfinite(results["total.y"]).all()


@each_engine
def test_an_fmu_that_was_exchanged_is_refused(engine: str, tmp_path: Path) -> None:
    shutil.copy(ROOT / "fmus" / "PMDCMotor.fmu", tmp_path / "x.fmu")
    made = Diagram("m")
    made.add("motor", fmu(tmp_path / "x.fmu", "CS"))
    made.run(stop=0.01, engine=engine)
    shutil.copy(ROOT / "fmus" / "IADRC.fmu", tmp_path / "x.fmu")
    with pytest.raises(FMUError, match=r"E205 motor: the file x.fmu has changed since the diagram was loaded\."):
        made.run(stop=0.01, engine=engine)


# --- steps by the error ----------------------------------------------------------------------------------------------


def trembling(folder: Path, omega: float, *, goes_back: bool) -> Diagram:
    """An FMU that gives 1 + sin(omega t)/100, into a lag of 1 s."""
    source = Diagram("trembling")
    ramp, wave = source.add("ramp", Ramp()), source.add("wave", Expression(expression=f"1 + 0.01*sin({omega!r}*u1)"))
    source.wire(wave.u1, ramp.y)
    source.output("y", wave.y)
    source.export(folder / "whole.fmu", fmi=2, kinds=["CS"])
    said = b"" if goes_back else b' canGetAndSetFMUstate="true"'
    with zipfile.ZipFile(folder / "whole.fmu") as whole, zipfile.ZipFile(folder / "f.fmu", "w") as archive:
        for name in whole.namelist():
            data = whole.read(name)
            if said and name == "modelDescription.xml":
                assert said in data
                data = data.replace(said, b"")
            archive.writestr(name, data)
    made = Diagram("top")
    f, lag = made.add("f", fmu(folder / "f.fmu", "CS")), made.add("lag", FirstOrder(T=1.0))
    made.wire(lag.u, f.y)
    return made


@pytest.mark.skipif(find_compiler() is None, reason="an FMU is made")
@each_engine
@pytest.mark.parametrize("goes_back", [True, False])
def test_steps_that_no_error_allows_end_the_run_and_name_the_signal(
    engine: str, goes_back: bool, tmp_path: Path
) -> None:
    # At 1e13 rad/s no step above 1e-14 s sees more of the sine than noise of 1 %.
    diagram = trembling(tmp_path, 1e13, goes_back=goes_back)
    said = r"E301 (f|lag)\.y: at t = .* its error still exceeds the tolerance 0\.0001"
    with pytest.raises(SimulationError, match=said) as caught:
        diagram.run(stop=5.0, engine=engine, master={"tolerance": 1e-4, "step": 1e-3})
    results = caught.value.results
    assert results["lag.y"][-1] == pytest.approx(0.0, abs=1e-5)
    assert results.statistics.steps < 5000


@pytest.mark.skipif(find_compiler() is None, reason="an FMU is made")
@each_engine
@pytest.mark.parametrize("goes_back", [True, False])
def test_short_steps_that_a_signal_needs_are_made(engine: str, goes_back: bool, tmp_path: Path) -> None:
    # 1e5 rad/s over 1e-3 s; the same over 1 s needs steps of the same length, 1e-6 of the run.
    diagram = trembling(tmp_path, 1e5, goes_back=goes_back)
    results = diagram.run(stop=1e-3, engine=engine, every=1e-4, master={"tolerance": 1e-4, "step": 1e-6})
    t = np.asarray(results.t)
    assert results["f.y"] == pytest.approx(1 + 0.01 * np.sin(1e5 * t), abs=1e-6)
    assert results["lag.y"] == pytest.approx(1 - np.exp(-t), abs=1e-4)
