"""The programs and diagrams that are measured compute the same: hand-written C, the reference engine, SciPy."""

from __future__ import annotations

import shutil
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from benchmarks import (
    diagrams,
    fmu,
    irregular,
    linear,
    long_run,
    measure,
    native_engine,
    peers,
    same,
    stiff,
    stiff_problems,
)
from blocks import Diagram
from blocks.library import SMESO
from tests.support.places import ROOT

STEP = Fraction(1, 1000)
SAME = 1e-11  # rounding errors of some thousand operations on values of some ten
needs_compiler = pytest.mark.skipif(measure.compiler() is None, reason="there is no C compiler")


def reference(diagram: Diagram, **settings: object) -> measure.Made:
    results = diagram.run(engine="reference", **settings)
    seen = results.statistics
    return measure.Made(seen.seconds, seen.steps, seen.rejected, results.t, results.values)


@needs_compiler
@pytest.mark.parametrize("kind", ["C, located", "C, located, divisions"])
def test_p1_in_c_makes_the_fixed_steps_of_the_reference_engine(kind):
    ours = reference(diagrams.p1(), stop=1.0, method="rk4", step=0.001)
    theirs = native_engine.p1_programs()[kind].run(1.0, step=STEP)
    assert theirs.steps == ours.steps == 1001  # one more than the grid has: the control leaves its limit once
    assert measure.difference(ours, theirs).max() < SAME


@needs_compiler
@pytest.mark.parametrize("kind", ["C, located", "C, located, divisions"])
def test_p1_in_c_makes_about_the_adaptive_steps_of_the_reference_engine(kind):
    # Rounding errors move the steps at the edge of stability, so that no two programs make exactly the same.
    ours, theirs = reference(diagrams.p1()), native_engine.p1_programs()[kind].run(100.0)
    assert theirs.steps == pytest.approx(ours.steps, rel=0.02)
    assert theirs.rejected == pytest.approx(ours.rejected, abs=30)
    assert measure.difference(ours, theirs)[0] < 1e-6


@needs_compiler
def test_p1_in_c_comes_to_the_solution_by_scipy():
    exact = peers.exact_speed(100.0)
    for kind, program in native_engine.p1_programs().items():
        made = program.run(100.0, rtol=1e-12, atol=1e-14)
        assert np.max(np.abs(made.values[:, 0] - exact(made.t))) < 1e-10, kind


@needs_compiler
def test_p1_in_c_with_fixed_steps_keeps_to_the_error_that_is_asked_for():
    exact = peers.exact_speed(100.0)
    made = native_engine.p1_programs()["C"].run(100.0, step=STEP)
    assert made.steps == 100_000
    assert np.max(np.abs(made.values[:, 0] - exact(made.t))) < 3e-6


@needs_compiler
@pytest.mark.parametrize("kind", ["C", "C, other algebra"])
def test_the_robot_in_c_is_the_diagram_of_the_paper(kind):
    program = native_engine.robot_programs()[kind]
    ours = reference(diagrams.robot(), stop=0.3, method="rk4", step=0.001)
    assert measure.difference(ours, program.run(0.3, step=STEP)).max() < SAME
    ours, theirs = reference(diagrams.robot(), stop=26.0), program.run(26.0)
    np.testing.assert_array_equal(theirs.t, ours.t)  # also the two rows at the torque's edge
    assert theirs.steps == pytest.approx(ours.steps, rel=0.02)
    errors = np.max(np.abs(theirs.values - ours.values), axis=0)
    assert errors[1] < 1e-6  # the right wheel's speed
    assert errors.max() < 5e-4  # the controls have an infinite slope where an error is 0


@needs_compiler
@pytest.mark.parametrize("kind", ["C", "C, divisions"])
def test_each_loop_of_p2_in_c_is_p1(kind):
    witness = native_engine.p1_programs()["C"].run(0.5, step=STEP)
    made = native_engine.p2_programs(10)[kind].run(0.5, step=STEP)
    assert made.values.shape == (51, 10)
    assert np.max(np.abs(made.values - witness.values[:, :1])) < SAME


def test_p2_is_the_same_with_and_without_subdiagrams_and_from_files(tmp_path: Path):
    drawn = reference(diagrams.p2(3), stop=0.2)
    one = reference(diagrams.p1(), stop=0.2, method="rk4", step=0.001, log=["motor.omega"])
    assert drawn.values.shape[1] == 3
    for made in (
        reference(diagrams.p2_flat(3), stop=0.2),
        reference(Diagram.load(diagrams.save_p2(3, tmp_path)), stop=0.2),
    ):
        np.testing.assert_array_equal(made.values, drawn.values)
    for column in drawn.values.T:
        np.testing.assert_array_equal(column, one.values[:, 0])


@needs_compiler
def test_irregular_loops_in_c_are_the_diagram_with_their_crossings_and_ticks():
    ours = reference(irregular.draw(24), stop=0.8)
    theirs = measure.Program(irregular.program(24), 10).run(0.8, step=STEP)
    assert ours.steps > 800, "nothing was located"
    assert measure.difference(ours, theirs).max() < SAME


@needs_compiler
def test_every_irregular_loop_in_c_is_that_of_the_diagram():
    ours = reference(irregular.draw(162), stop=0.12, log=irregular.log_of(162, 162))
    theirs = measure.Program(irregular.program(162, 162), 162).run(0.12, step=STEP)
    assert ours.values.shape[1] == 162
    assert measure.difference(ours, theirs).max() < SAME


def test_irregular_loops_are_all_wired_in_another_way():
    kinds = {(loop.plant, loop.control, loop.sensor, loop.limit, loop.coupling) for loop in irregular.loops(162)}
    assert len(kinds) > 155
    assert all(loop.other != loop.number for loop in irregular.loops(200))


def test_the_last_tick_of_the_long_run_is_exact():
    run = diagrams.long_run(2000).start(engine="reference")
    results = run.finish()
    assert len(results.t) == 1001
    assert float(run["clock.y"]) == long_run.last_tick(2000) == 1.995
    assert long_run.last_tick(10**8) == 99999.998


def test_the_rod_as_a_diagram_is_the_one_by_hand():
    rod = next(problem for problem in stiff_problems.PROBLEMS if problem.rod == 200)
    results = rod.made().run(stop=0.01, every=0.01, method="radau", rtol=1e-7, log=rod.log, engine="reference")
    _, exact = stiff.by_scipy(replace(rod, stop=0.01, atol=1e-3), 1e-8)
    assert [results[name][-1] for name in rod.log] == pytest.approx(exact, abs=1e-6)


@needs_compiler
@pytest.mark.parametrize("version", [2, 3])
def test_a_lag_as_an_fmu_makes_the_steps_of_the_one_in_c(version, tmp_path: Path):
    one, u = fmu.opened(fmu.lag(), version, tmp_path), np.ascontiguousarray(fmu.inputs_of(1000)[:, :1])
    made, witness = np.zeros((1000, 1)), np.zeros((1000, 1))
    one.drive(1000, u, made)
    _, last = fmu.lag_by_hand(1000, u, witness)
    np.testing.assert_array_equal(made, witness)
    assert last == witness[-1, 0] > 0.5
    # A constant input: x(1) = k u (1 - exp(-1/T)), and rk4 errs by 1e-14.
    _, last = fmu.lag_by_hand(1000)
    assert last == pytest.approx(fmu.GAIN * (1.0 - np.exp(-1.0 / fmu.TIME_CONSTANT)), rel=1e-12)


@needs_compiler
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", fmu.SHOWN)
def test_the_controller_as_an_fmu_reads_as_its_native_run(name, version, tmp_path: Path):
    u = fmu.inputs_of(300)
    one = fmu.opened(fmu.controller(name, 0.3), version, tmp_path)
    made = np.zeros((300, len(one.names)))
    one.drive(300, u, made)
    diagram, settings = fmu.native_of(name, u, one.names)
    np.testing.assert_array_equal(made, fmu.read_of(diagram, settings, 300))
    assert np.ptp(made[:, one.names.index("u")]) > 0.1


def test_loops_have_the_matrices_by_hand_and_the_model_by_interconnect():
    count, omega = 12, [0.5, 5.0, 50.0]
    made = diagrams.loops(count).linearizer().sparse("speed.y", [f"motor{k}.omega" for k in range(count)])
    ours = linear.transfer(made, omega)
    assert made[0].shape == (54, 54)
    assert linear.apart(ours, linear.transfer(linear.loops_by_hand(count), omega)) < 1e-12
    assert linear.apart(ours, linear.transfer(linear.loops_by_control(count), omega)) < 1e-12


def test_the_robot_has_the_linear_model_of_its_equations_by_hand():
    diagram = diagrams.robot()
    made = diagram.linearize("disturbance.y", "motor_right.omega", at=25.2)
    theirs = linear.by_control(linear.witness_states(diagram.point(at=25.2)))()
    omega = [0.5, 5.0, 50.0]
    # python-control takes one-sided differences of 1e-6, where the laws' slopes change within some hundredths.
    assert linear.apart(linear.transfer(made, omega), linear.transfer(theirs, omega)) < 1e-4


def test_a_sweep_by_scipy_is_the_harmonic_response():
    omega = np.array([5.0, 50.0])
    swept = linear.swept_by_scipy(omega.tolist(), [20, 20])
    linearizer = Diagram.alone(SMESO()).linearizer(inputs={"u": 0.0})
    made = linearizer.harmonic_response("y", ["z1", "z2", "z3"], omega, amplitude=linear.AMPLITUDE)
    assert np.max(np.abs(swept / made.value - 1.0)) < 0.012 / 8.7  # 0.012 dB: the harmonics that are left out


def test_a_difference_is_seen_and_takes_the_right_value_of_a_jump():
    t = np.array([0.0, 0.01, 0.01, 0.02])
    one = measure.Made(0.0, 0, 0, t, np.array([[0.0], [1.0], [2.0], [3.0]]))
    other = measure.Made(0.0, 0, 0, np.array([0.0, 0.01, 0.02]), np.array([[0.0], [2.0], [3.5]]))
    assert measure.difference(one, other) == pytest.approx([0.5])


def test_a_ratio_is_judged_by_the_least_times():
    assert "1.10    2.00  <= 1.15 met" in measure.line("", [1.1, 4.0, 4.0], [1.0, 2.0, 2.0], 1.15)
    assert "MISSED" in measure.line("", [1.2], [1.0], 1.15)


# --- two checkouts -------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_checkout_is_the_same_as_itself_and_not_as_one_with_another_default(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("blocks", "diagrams", "fmus", "tests/support/golden"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    assert same.main([str(tmp_path), "--only", "names"]) == 0
    assert "the same" in capsys.readouterr().out
    changed = tmp_path / "blocks" / "results" / "results.py"
    text = changed.read_text(encoding="utf-8")
    assert "most: int = 4" in text
    changed.write_text(text.replace("most: int = 4", "most: int = 5"), encoding="utf-8")
    assert same.main([str(tmp_path), "--only", "names"]) == 1
    said = capsys.readouterr().out
    assert "blocks.Results" in said
    assert "most: 'int' = 5" in said
