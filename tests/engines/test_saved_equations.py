"""A state goes on in the equations that it is of; results and states say which those are."""

import hashlib
import json
import math
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    Constant,
    Diagram,
    Gain,
    Input,
    Integrator,
    Parameter,
    Results,
    Sine,
    Stepped,
    Sum,
    Table,
    TransferFunction,
    TransportDelay,
    UnitDelay,
    UsageError,
    fmu,
    output,
    stepper,
    subdiagram,
)
from blocks.cli import main
from blocks.compare import compare
from blocks.compile.equation_record import Equations
from blocks.contract.program_text import program_text
from blocks.engines.run.saved_state import packed
from tests.support.places import FMUS, ROOT
from tests.support.state_files import damaged

DIFFERENT = "the type or the equations of this block, its inputs, ticks or delays are different."
LIBRARY = """
import numpy as np
from blocks import Block, Parameter, State, output

class Decay(Block):
    rate = Parameter({default})
    x = State(1.0)

    @x.derivative
    def dx(x, rate):
        return {law}

    @output
    def y(x):
        return x
"""
DOCUMENT = {
    "format": "blocks-diagram", "version": 3, "name": "decay", "blocks": {"tank": {"type": "Decay"}},
    "run": {"stop": 2, "rtol": 1e-9, "atol": 1e-12},
}  # fmt: skip


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    before = dict(sys.modules)
    yield
    for name in {"kept_library"} & set(sys.modules) - set(before):
        del sys.modules[name]
    sys.modules.update(before)


@pytest.fixture
def of_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Diagram]:
    """The diagram with the block of a library in a folder."""

    def made(folder: str, law: str = "-rate * x", default: str = "1.0") -> Diagram:
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "kept_library.py").write_text(LIBRARY.format(law=law, default=default))
        monkeypatch.chdir(tmp_path / folder)
        (tmp_path / folder / "decay.json").write_text(json.dumps(DOCUMENT))
        return Diagram.load(tmp_path / folder / "decay.json", library="kept_library")

    return made


def halfway(diagram: Diagram, path: Path, t: float = 1.0, **given: Any) -> Path:
    run = diagram.start(**given)
    run.advance_to(t)
    run.save(path)
    return path


def refused(diagram: Diagram, state: Any, **settings: Any) -> list[str]:
    """Why a state is refused, without what all say."""
    with pytest.raises(UsageError) as caught:
        diagram.run(resume=state, **settings)
    assert {fault.code for fault in caught.value.faults} == {"E506"}
    return [f"{f.place}: {f.message.removeprefix('the state does not fit the diagram: ')}" for f in caught.value.faults]


# --- two libraries of one name -----------------------------------------------------------------------------------


@pytest.mark.parametrize("is_file", [True, False])
def test_a_state_of_a_library_with_another_equation_is_refused_with_the_block_and_the_equation(
    of_library: Any, tmp_path: Path, is_file: bool
) -> None:
    one = of_library("one")
    run = one.start()
    run.advance_to(1.0)
    run.save(tmp_path / "state")
    state = tmp_path / "state" if is_file else run.snapshot()
    assert refused(of_library("two", "-2 * rate * x"), state) == [f"tank: {DIFFERENT}"]
    again = of_library("three", "-rate*x  # the same")
    rest = again.run(resume=state)
    assert rest.warnings == ()
    assert rest["tank.y"][-1] == pytest.approx(math.exp(-2), rel=1e-7)
    assert np.array_equal(rest.values[-1], run.finish().values[-1])


def test_results_of_two_libraries_tell_that_their_equations_differ(of_library: Any, tmp_path: Path) -> None:
    one, two = of_library("one").run(), of_library("two", "-2 * rate * x").run()
    three = of_library("three", "-(rate) * x").run()
    assert one.origin.sha256 == two.origin.sha256 == three.origin.sha256
    assert one.origin.equations == three.origin.equations != two.origin.equations
    assert one.origin.values == two.origin.values
    assert len({len(text) for text in (one.origin.equations, one.origin.values)} - {64}) == 0
    four = of_library("four", default="1.5").run()
    assert four.origin.equations == one.origin.equations
    assert four.origin.values != one.origin.values
    assert any(note.startswith("SHA-256 of the equations: ") for note in compare(one, two).notes)
    assert any(note.startswith("SHA-256 of the values of all parameters: ") for note in compare(one, four).notes)
    for ending in ("csv", "mat"):
        one.save(tmp_path / f"a.{ending}")
        assert Results.load(tmp_path / f"a.{ending}").origin == one.origin


def test_the_digests_are_those_of_the_texts_that_the_documentation_describes(of_library: Any) -> None:
    """Written out by hand."""

    def sha(text: str) -> str:
        return hashlib.sha256(text.encode()).hexdigest()

    diagram = of_library("one", "-rate * x")
    origin = diagram.run().origin
    derivative = "state real scalar\n0 parameter rate 0\n1 neg 0\n2 state x 0\n3 mul 1 2\ngives 3"
    output_y = "output real scalar\n0 state x 0\ngives 0"
    type_ = sha(f"derivative x = {sha(derivative)}\noutput y = {sha(output_y)}\n")
    assert origin.equations == sha(f"blocks-equations 1\nblock tank {type_}")
    rest = sha("nominal = 1 0x1.0000000000000p+0")
    numbers = sha(f"rate = 0x1.0000000000000p+0\nx_start = 0x1.0000000000000p+0\n{rest}")
    assert origin.values == sha(f"blocks-values 1\ntank {numbers}")


@pytest.mark.parametrize("couple", ["each", "together"])
def test_how_blocks_are_stepped_is_not_in_the_digest_of_their_equations(couple: str) -> None:
    d = chain()
    assert d.run(master={"couple": couple, "step": 0.1}).origin.equations == d.run().origin.equations


def test_the_digests_are_computed_when_they_are_asked_for(of_library: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    diagram, asked = of_library("one"), []
    record = Equations.record.fget

    def counted(equations: Equations) -> Any:
        asked.append(1)
        return record(equations)  # type: ignore[misc]

    monkeypatch.setattr(Equations, "record", property(counted))
    results, again = diagram.run(), diagram.run()
    run = diagram.start()
    run.advance_to(1.0)
    run.snapshot()
    assert not asked
    assert len({results.origin.equations, again.origin.equations}) == 1
    assert asked


# --- what differs -------------------------------------------------------------------------------------------------


def chain(**named: Any) -> Diagram:
    """A sine through a gain into an integrator; other blocks by their names."""
    d = Diagram("chain")
    d.add("source", named.pop("source", Sine()))
    d.add("gain", named.pop("gain", Gain(k=2.0)))
    d.add(named.pop("name", "x"), Integrator())
    for name, block in named.items():
        d.add(name, block)
    d.wire("gain.u", "source.y")
    last = next(name for name in d.value.blocks if name not in ("source", "gain", *named))
    d.wire(f"{last}.u", "gain.y")
    d.settings(stop=2.0)
    return d


def test_blocks_that_are_new_gone_or_renamed_are_named(tmp_path: Path) -> None:
    state = halfway(chain(), tmp_path / "state")
    assert refused(chain(more=Constant()), state)[0] == "blocks: the diagram has 'more', which the state lacks."
    wider = halfway(chain(more=Constant()), tmp_path / "wider")
    assert refused(chain(), wider)[0] == "blocks: the state has 'more', which the diagram lacks."
    first, *rest = refused(chain(name="z"), state)
    assert first == "blocks: the diagram has 'z', which the state lacks; the state has 'x', which the diagram lacks."
    assert rest == [
        "states: the diagram has 'z.y', which the state lacks; the state has 'x.y', which the diagram lacks."
    ]


def test_a_wire_that_leads_from_elsewhere_is_named(tmp_path: Path) -> None:
    state = halfway(chain(), tmp_path / "state")
    other = chain().to_json()
    other["wires"]["x.u"] = "source.y"
    assert refused(Diagram.from_json(other), state) == [f"x: {DIFFERENT}"]


def test_a_block_of_another_type_is_named(tmp_path: Path) -> None:
    state = halfway(chain(), tmp_path / "state")
    assert refused(chain(source=Constant(value=1.0)), state) == [f"source: {DIFFERENT}"]


def test_a_block_whose_structural_value_changes_its_equation_is_named(tmp_path: Path) -> None:
    def sums(signs: str) -> Diagram:
        d = chain(sum=Sum(signs=signs))
        d.wire("sum.u1", "gain.y")
        d.wire("sum.u2", "x.y")
        return d

    state = halfway(sums("++"), tmp_path / "state")
    assert refused(sums("+-"), state) == [f"sum: {DIFFERENT}"]


def test_blocks_with_other_ticks_and_delays_are_named(tmp_path: Path) -> None:
    def late(delay: float, period: float) -> Diagram:
        d = chain(late=TransportDelay(delay=delay), tick=UnitDelay(period=period))
        d.wire("late.u", "gain.y")
        d.wire("tick.u", "gain.y")
        return d

    state = halfway(late(0.25, 0.1), tmp_path / "state")
    text = refused(late(0.5, 0.2), state)
    assert text[:2] == [f"late: {DIFFERENT}", f"tick: {DIFFERENT}"]
    assert any(line.startswith("delays: ") for line in text)


def test_many_differences_are_counted(tmp_path: Path) -> None:
    def many(form: Callable[[int], Any]) -> Diagram:
        d = Diagram("many")
        for k in range(30):
            d.add(f"b{k}", form(k))
        d.settings(stop=2.0)
        return d

    state = halfway(many(lambda k: Sine()), tmp_path / "state")
    text = refused(many(lambda k: Constant()), state)
    assert len(text) == 9
    assert text[-1] == "blocks: 'b8', 'b9', 'b10' and 19 more are different too."


# --- values that may differ ---------------------------------------------------------------------------------------


def told(results: Results) -> list[str]:
    return [str(warning) for warning in results.warnings]


def test_a_value_that_changed_in_the_file_is_told_and_counts(tmp_path: Path) -> None:
    """x' = k sin(t): x(2) = k1 (1 - cos 1) + k2 (cos 1 - cos 2)."""
    state = halfway(chain(), tmp_path / "state")
    rest = chain(gain=Gain(k=3.0)).run(resume=state, rtol=1e-9, atol=1e-12)
    assert told(rest) == [
        "W303 gain.k: is 3.0, and was 2.0 (SI) when the state was saved. The run continues with the new value."
    ]
    expected = 2 * (1 - math.cos(1)) + 3 * (math.cos(1) - math.cos(2))
    assert rest["x.y"][-1] == pytest.approx(expected, abs=1e-5)
    assert told(chain().run(resume=state)) == []


def test_values_are_compared_by_the_names_of_blocks_in_any_order(tmp_path: Path) -> None:
    state = halfway(chain(a=Constant(value=2.0), b=Constant(value=3.0)), tmp_path / "state")
    rest = chain(b=Constant(value=5.0), a=Constant(value=2.0)).run(resume=state)
    assert [line.partition(" (SI)")[0] for line in told(rest)] == ["W303 b.value: is 5.0, and was 3.0"]


def test_elements_of_arrays_are_named_and_of_a_table_its_block(tmp_path: Path) -> None:
    def filtered(num: list[float], table: list[float]) -> Diagram:
        d = chain(filter=TransferFunction(num=num, den=[1.0, 2.0]), table=Table(times=np.arange(20.0), values=table))
        d.wire("filter.u", "gain.y")
        return d

    long = [float(k) for k in range(20)]
    state = halfway(filtered([1.0, 5.0], long), tmp_path / "state")
    lines = told(filtered([3.0, 5.0], [*long[:-1], 5.0]).run(resume=state))
    assert lines[0].startswith("W303 filter.num[0]: is 3.0, and was 1.0 (SI) when")
    assert lines[1].startswith("W303 table: a table, a text or a start value of this block has changed since")
    assert len(lines) == 2


def test_the_digests_of_shipped_diagrams_are_the_same_in_another_process() -> None:
    code = """
import sys
from blocks import Diagram
for path in sys.argv[1:]:
    run = Diagram.load(path).start(stop=1.0, engine="reference")
    print(run.results.origin.equations, run.results.origin.values)
"""
    names = ("bouncing_ball", "inverted_pendulum", "motor_pid", "quarter_car", "sampled_loop", "paper/wheel_iadrc")
    paths = [str(ROOT / "diagrams" / f"{name}.json") for name in names]
    environments = ({**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)} for seed in ("1", "2"))
    said = [
        subprocess.run([sys.executable, "-c", code, *paths], env=env, capture_output=True, text=True, check=True).stdout
        for env in environments
    ]
    assert said[0] == said[1]
    assert len(set(said[0].split())) == 2 * len(paths)


def test_a_value_that_is_given_with_the_state_is_meant_and_others_are_still_told(tmp_path: Path) -> None:
    state = halfway(chain(), tmp_path / "state")
    assert told(chain().run(resume=state, parameters={"gain.k": 3.0})) == []
    other = chain(source=Sine(bias=1.0)).run(resume=state, parameters={"gain.k": 3.0})
    assert [line.partition(":")[0] for line in told(other)] == ["W303 source.bias"]


def test_what_was_set_in_the_saved_run_is_no_difference(tmp_path: Path) -> None:
    run = chain().start(parameters={"source.amplitude": 2.0})
    run.advance_to(0.5)
    run.set("gain.k", -1.0)
    run.advance_to(1.0)
    run.save(tmp_path / "state")
    assert told(chain().run(resume=tmp_path / "state")) == []
    assert told(chain().run(resume=run.snapshot())) == []
    state = run.snapshot()
    run.set("gain.k", 4.0)
    run.restore(state)
    assert run.warnings == ()


def test_a_default_of_a_library_that_changed_is_told(of_library: Any, tmp_path: Path) -> None:
    state = halfway(of_library("one"), tmp_path / "state")
    rest = of_library("two", default="3.0").run(resume=state)
    assert told(rest)[0].startswith("W303 tank.rate: is 3.0, and was 1.0 (SI)")
    assert rest["tank.y"][-1] == pytest.approx(math.exp(-4), rel=1e-6)


def test_settings_documentation_and_units_are_no_difference(tmp_path: Path) -> None:
    state = halfway(chain(), tmp_path / "state")
    other = chain(gain=Gain(k=2.0, unit="1"), source=Sine(unit="1"))
    other.settings(method="rk4", step=0.01, log=["x.y"])
    document = {**other.to_json(), "doc": "Another text.", "layout": {"x": [1, 2]}}
    assert told(Diagram.from_json(document).run(resume=state)) == []


# --- programs, FMUs, subdiagrams ----------------------------------------------------------------------------------


class Counter:
    def __init__(self) -> None:
        self.total = 0.0

    def step(self, t: float) -> float:
        self.total += 1.0
        return self.total

    def save(self) -> float:
        return self.total

    def restore(self, saved: float) -> None:
        self.total = saved


class Slower(Counter):
    def step(self, t: float) -> float:
        self.total += 0.5
        return self.total


def counting(program: Any) -> Diagram:
    def one() -> Any:
        return program()

    class Counting(Block):
        y = Stepped()
        counted = stepper(every=0.5)(one)

    d = Diagram("counting")
    d.add("count", Counting())
    d.settings(stop=2.0)
    return d


def test_a_program_with_another_text_goes_on_and_is_told(tmp_path: Path) -> None:
    state = halfway(counting(Counter), tmp_path / "state")
    assert told(counting(Counter).run(resume=state)) == []
    rest = counting(Slower).run(resume=state)
    assert [line[:11] for line in told(rest)] == ["W303 count:"]
    assert "the text of its program has changed since" in told(rest)[0]
    assert rest["count.y"][-1] == 4.0, "3 ticks until 1 s, 2 slower ones until 2 s"
    assert counting(Slower).run().origin.equations != counting(Counter).run().origin.equations


def test_a_program_counts_by_all_constants_that_it_names() -> None:
    def closing_over(gains: Any) -> str:
        def program() -> Any:
            return gains

        return program_text(program)

    def with_default(gain: Any) -> str:
        def scaled(x: float, k: Any = gain, *, most: Any = gain) -> Any:
            return (x, k, most)

        def program() -> Any:
            return scaled(1.0)

        return program_text(program)

    for text in (closing_over, with_default):
        values = (1.0, 2, (1.0, 2.0), (1.0, (3.0, "a")), (1.0, (4.0, "a")), frozenset({"a", "b"}), b"a", 1j)
        assert len({text(value) for value in values}) == len(values)
        assert text((np.int64(3), np.float64(0.5))) == text((3, 0.5))
        # What a program works with may be another thing after each run.
        assert text([1.0]) == text([2.0])


def test_the_sign_of_a_zero_is_a_value(tmp_path: Path) -> None:
    class Angle(Block):
        z = Parameter(0.0)

        @output
        def y(z: Any) -> Any:
            return np.arctan2(z, -1.0)

    def angle(z: float) -> Diagram:
        d = Diagram("d")
        d.add("angle", Angle(z=z))
        d.settings(stop=2.0)
        return d

    plus, minus = angle(0.0).run(), angle(-0.0).run()
    assert (plus["angle.y"][-1], minus["angle.y"][-1]) == (math.pi, -math.pi)
    assert plus.origin is not None
    assert minus.origin is not None
    assert plus.origin.values != minus.origin.values
    assert plus.origin.equations == minus.origin.equations
    (line,) = told(angle(-0.0).run(resume=halfway(angle(0.0), tmp_path / "state")))
    assert line.startswith("W303 angle.z: is -0.0, and was 0.0")


def test_an_fmu_counts_by_its_file(tmp_path: Path) -> None:
    def motor(path: Path) -> Diagram:
        d = Diagram("motor")
        d.add("motor", fmu(path, kind="ME"))
        d.add("source", Constant(value=6.0, unit="V"))
        d.wire("motor.v", "source.y")
        d.settings(stop=0.01)
        return d

    given = FMUS / "PMDCMotor.fmu"
    copied, changed = tmp_path / "copy.fmu", tmp_path / "changed.fmu"
    copied.write_bytes(given.read_bytes())
    with zipfile.ZipFile(given) as old, zipfile.ZipFile(changed, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name))
        new.writestr("extra/note.txt", "more")
    origins = [motor(path).run(stop=0.001).origin.equations for path in (given, copied, changed)]
    assert origins[0] == origins[1] != origins[2]
    state = halfway(motor(given), tmp_path / "state", 0.005)
    assert motor(copied).run(resume=state).warnings == ()
    assert refused(motor(changed), state) == [f"motor: {DIFFERENT}"]


def test_what_enables_a_subdiagram_and_resets_it_counts(tmp_path: Path) -> None:
    def enabled(states: str) -> Diagram:
        part = Diagram("part")
        x = part.add("x", Integrator())
        part.wire(x.u, part.input("u"))
        part.output("y", x.y)
        d = Diagram("enabled")
        d.add("on", Sine(omega=6.0))
        d.add("compare", Above())
        d.wire("compare.u", "on.y")
        box = d.add("box", subdiagram(part), enable={"states": states})
        d.wire(box.u, "on.y")
        d.wire("box.enable", "compare.y")
        d.settings(stop=2.0)
        return d

    state = halfway(enabled("held"), tmp_path / "state")
    assert enabled("held").run(resume=state).warnings == ()
    assert f"box.x: {DIFFERENT}" in refused(enabled("reset"), state)


class Above(Block):
    threshold = Parameter(0.0)
    u = Input()

    @output(type="bool")
    def y(u: Any, threshold: Any) -> Any:
        return u > threshold


# --- states of older releases, and damaged ones -------------------------------------------------------------------


def test_a_state_that_an_older_release_wrote_is_refused_in_plain_words() -> None:
    d = Diagram("kept")
    d.add("source", Sine())
    old = ROOT / "tests" / "support" / "golden" / "state_v1.state"
    with pytest.raises(UsageError, match=r"E506 .*version 1 of saved states cannot be read\. An older release"):
        d.run(stop=2.0, resume=old)


@pytest.mark.parametrize(
    "record", [None, [], {}, {"blocks": []}, {"blocks": {"x": ["a", "b"]}}, {"blocks": {"x": ["a", "b", 1]}}]
)
def test_a_state_whose_equations_are_damaged_is_refused(tmp_path: Path, record: Any) -> None:
    state = halfway(chain(), tmp_path / "state")
    damaged(state, tmp_path / "broken", lambda tree, rows: tree.update(equations=record))
    with pytest.raises(UsageError, match=r"E506 .*is not a saved state: its record of the equations cannot be read"):
        chain().run(resume=tmp_path / "broken")


def test_a_state_is_small(tmp_path: Path) -> None:
    d = Diagram("many")
    for k in range(300):
        d.add(f"b{k}", Integrator())
        d.wire(f"b{k}.u", f"b{max(k - 1, 0)}.y")
    d.settings(stop=2.0)
    run = d.start()
    assert len(packed(run.snapshot())) < 40 * 300


# --- the command line ---------------------------------------------------------------------------------------------


def test_the_command_line_tells_it(of_library: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    of_library("one")
    common = ["run", "decay.json", "--library", "kept_library"]
    assert main([*common, "--stop", "1", "--save", str(tmp_path / "state")]) == 0
    of_library("one", default="2.0")
    capsys.readouterr()
    assert main([*common, "--resume", str(tmp_path / "state")]) == 0
    told = capsys.readouterr()
    assert (told.out + told.err).count("W303 tank.rate: is 2.0, and was 1.0 (SI)") == 1
    of_library("one", "-2 * rate * x")
    assert main([*common, "--resume", str(tmp_path / "state")]) == 2
    said = capsys.readouterr().err
    assert f"E506 tank: the state does not fit the diagram: {DIFFERENT}" in said
