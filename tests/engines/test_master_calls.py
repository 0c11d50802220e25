"""In which order the master calls FMUs: both engines the same, call by call, and as docs/cosimulation.md says it.

Witness: an FMU that writes down its calls, with their times and values.
"""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from typing import Any

import pytest

from blocks import CompareToConstant, Diagram, Gain, Integrator, Sine, fmu
from blocks.cli import main
from tests.support.faulty import FAULTS, NEEDS_COMPILER, make

pytestmark = NEEDS_COMPILER
each_fmi = pytest.mark.parametrize("fmi", [2, 3])
each_algorithm = pytest.mark.parametrize(
    ("algorithm", "order"),
    [
        ("jacobi", 0),
        ("jacobi", 1),
        ("jacobi", 2),
        ("gauss-seidel", 0),
        ("gauss-seidel", 1),
        ("iterated", 1),
        ("iterated", 2),
    ],
)
FEED = {
    2: ('index="3" dependencies="2 4"', 'index="3" dependencies="4"'),
    3: ('Output valueReference="2" dependencies="1 3"', 'Output valueReference="2" dependencies="3"'),
}


def logging(folder: Path, fmi: int, *, feeds: bool = True, is_plain: bool = False) -> Path:
    """The FMU x' = k u, y = x + d u, which writes down its calls.

    feeds: whether it says that y depends on u at once. is_plain: its only input is u (in FMI 3 also v), and it has no
    events.
    """
    name = f"calls{fmi}{int(feeds)}{int(is_plain)}"
    path = make(folder, fmi=fmi, name=name, defines=("CALLS",))
    with zipfile.ZipFile(path) as archive:
        entries = {entry: archive.read(entry) for entry in archive.namelist()}
    text = entries["modelDescription.xml"].decode()
    if not feeds:
        assert FEED[fmi][0] in text
        text = text.replace(*FEED[fmi])
    if is_plain:
        text = re.sub(r"<Binary .*?</Binary>|<Clock [^>]*/>", "", text)
        text = text.replace('causality="input" variability="discrete"', 'causality="parameter" variability="fixed"')
        text = text.replace('hasEventMode="true"', 'hasEventMode="false"')
    entries["modelDescription.xml"] = text.encode()
    with zipfile.ZipFile(path, "w") as archive:
        for entry, data in entries.items():
            archive.writestr(entry, data)
    return path


def calls(diagram: Diagram, file: Path, monkeypatch: pytest.MonkeyPatch, engine: str, **master: Any) -> list[list[str]]:
    """Each call in words: the instance, the function, and numbers."""
    file.unlink(missing_ok=True)
    monkeypatch.setenv("FAULTY_CALLS", str(file))
    diagram.run(
        stop=0.05,
        log=["a.y", "b.y"],
        engine=engine,
        method="rk4",
        step=0.0025,
        every=0.01,
        master={"step": 0.01, **master},
    )
    return [line.split() for line in file.read_text().splitlines()]


def same(diagram: Diagram, folder: Path, monkeypatch: pytest.MonkeyPatch, **master: Any) -> list[list[str]]:
    """The calls, which both engines make alike."""
    one, other = (calls(diagram, folder / "calls", monkeypatch, engine, **master) for engine in ("reference", "native"))
    assert [line[:2] for line in one] == [line[:2] for line in other]
    values = [[float(word) for line in made for word in line[2:]] for made in (one, other)]
    assert values[0] == pytest.approx(values[1], rel=1e-9, abs=1e-12)
    assert len(one) > 20
    return other


def ring(path: Path) -> Diagram:
    made = Diagram("ring")
    a, b = (made.add(name, fmu(path, "CS", k=k, x_start=1.0)) for name, k in (("a", 1.0), ("b", -2.0)))
    made.wire(a.u, b.y)
    made.wire(b.u, a.y)
    return made


def mixed(path: Path, **more: Any) -> Diagram:
    """FMUs and an island in a ring, with a switch for one of them. more: parameters of the other."""
    made = Diagram("mixed")
    a = made.add("a", fmu(path, "CS", d=0.5))
    b = made.add("b", fmu(path, "CS", k=-2.0, d=0.25, x_start=1.0, **more))
    wave, high, state = (
        made.add("wave", Sine(omega=250.0)),
        made.add("high", CompareToConstant()),
        made.add("state", Integrator()),
    )
    gain = made.add("gain", Gain(k=3.0))
    made.wire(high.u, wave.y)
    made.wire(a.on, high.y)
    made.wire(a.u, state.y)
    made.wire(b.u, a.y)
    made.wire(gain.u, b.y)
    made.wire(state.u, gain.y)
    return made


@each_fmi
@each_algorithm
@pytest.mark.parametrize("is_plain", [True, False])
def test_both_engines_call_fmus_in_a_ring_alike(
    algorithm: str, order: int, is_plain: bool, fmi: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    diagram = ring(logging(tmp_path, fmi, feeds=False, is_plain=is_plain))
    same(diagram, tmp_path, monkeypatch, algorithm=algorithm, order=order)


def test_what_depends_on_nothing_at_once_is_set_before_a_step_and_got_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    diagram = ring(logging(tmp_path, 2, feeds=False, is_plain=True))
    made = same(diagram, tmp_path, monkeypatch, order=0)
    begun = min(k for k, line in enumerate(made) if line[1] == "DoStep") - 1
    step = ["a SetReal", "a DoStep", "b SetReal", "b DoStep", "b GetReal", "a GetReal"]
    assert [" ".join(line[:2]) for line in made[begun:]] == 5 * step


def test_what_depends_on_inputs_at_once_is_got_after_these_were_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """a.y needs the state of the island, b.y needs a.y: they are set one after the other, and nothing else is."""
    made = same(mixed(logging(tmp_path, 2)), tmp_path, monkeypatch, order=0)
    begun = max(k for k, line in enumerate(made) if line[1] == "DoStep")
    words = [" ".join(line[:3]) for line in made[begun + 1 :]]
    assert words[:4] == ["a SetReal 1", "a GetReal 2", "b SetReal 1", "b GetReal 2"]
    assert not any(word.split()[1] in ("SetBoolean", "SetInteger") for word in words)


@each_fmi
@each_algorithm
def test_both_engines_call_fmus_beside_an_island_alike(
    algorithm: str, order: int, fmi: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    same(mixed(logging(tmp_path, fmi)), tmp_path, monkeypatch, algorithm=algorithm, order=order)


@each_fmi
@pytest.mark.parametrize(
    "master",
    [{"steps": {"b": 0.005}}, {"steps": {"b": 0.005}, "algorithm": "gauss-seidel"}, {"tolerance": 1e-3}],
    ids=["steps", "steps, gauss-seidel", "tolerance"],
)
def test_both_engines_call_fmus_alike_with_steps_of_their_own_and_by_the_error(
    master: dict[str, Any], fmi: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    same(mixed(logging(tmp_path, fmi)), tmp_path, monkeypatch, **master)


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "iterated"])
def test_both_engines_call_fmus_alike_at_events(
    algorithm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    diagram = mixed(logging(tmp_path, 3), fault=FAULTS.index("event"), t_fault=0.025)
    made = same(diagram, tmp_path, monkeypatch, algorithm=algorithm)
    assert ["b", "EnterEventMode"] in made


@each_fmi
def test_outputs_are_got_again_when_initialization_has_been_left(
    fmi: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some FMUs compute them only then."""
    path = logging(tmp_path, fmi, feeds=False, is_plain=True)
    made = [line[1] for line in same(ring(path), tmp_path, monkeypatch) if line[0] == "a"]
    get = "GetReal" if fmi == 2 else "GetFloat64"
    assert get in made[made.index("ExitInitializationMode") : made.index("DoStep")]


def tries(made: list[list[str]], name: str) -> list[list[str]]:
    """The steps of an instance from 0.02 s, in which its event lies."""
    return [line for line in made if line[:2] == [name, "DoStep"] and float(line[2]) == pytest.approx(0.02)]


def test_an_fmu_that_stopped_at_an_event_stays_there_where_nobody_may_stop_sooner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some FMUs save a state without all of what an event needs, and lose the event when they go back."""
    path = logging(tmp_path, 3)
    diagram = Diagram("pair")
    a = diagram.add("a", fmu(path, "CS", x_start=1.0, fault=FAULTS.index("event"), t_fault=0.025))
    b = diagram.add("b", fmu(path, "CS", k=-2.0))
    diagram.wire(b.u, a.y)
    made = same(diagram, tmp_path, monkeypatch)
    assert ["a", "EnterEventMode"] in made
    # Both may stop sooner: a goes back with b, so that neither is ahead of the other.
    assert len(tries(made, "a")) == 2
    alone = Diagram.alone(fmu(path, "CS", x_start=1.0, fault=FAULTS.index("event"), t_fault=0.025))
    (name,) = alone.value.blocks
    for engine in ("reference", "native"):
        file = tmp_path / "calls"
        file.unlink(missing_ok=True)
        alone.run(stop=0.05, engine=engine, every=0.01, master={"step": 0.01}, log=[f"{name}.y"])
        told = [line.split() for line in file.read_text().splitlines()]
        assert "EnterEventMode" in [line[1] for line in told]
        assert len(tries(told, told[0][0])) == 1, engine


@each_fmi
def test_inputs_that_keep_their_start_values_are_never_set(
    fmi: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some FMUs refuse to be given them all in one call. A constant with another value is set."""
    path = logging(tmp_path, fmi)
    diagram = mixed(path)
    made = same(diagram, tmp_path, monkeypatch)
    assert {call for name, call in _sets(made) if name == "b"} == {"SetReal" if fmi == 2 else "SetFloat64"}
    assert "SetBoolean" in {call for name, call in _sets(made) if name == "a"}
    diagram.wire("b.on", diagram.input("on", type="bool", default=True))
    assert "SetBoolean" in {call for name, call in _sets(same(diagram, tmp_path, monkeypatch)) if name == "b"}
    (tmp_path / "calls").unlink()
    assert main(["fmu", "run", str(path), "--kind", "CS", "--stop", "0.05"]) == 0
    assert not [line for line in (tmp_path / "calls").read_text().splitlines() if line.split()[1].startswith("Set")]


def _sets(made: list[list[str]]) -> list[tuple[str, str]]:
    """The instance and the function of each call that sets something but the start of the run."""
    return [(line[0], line[1]) for line in made if line[1].startswith("Set") and not line[1].startswith("SetupE")]
