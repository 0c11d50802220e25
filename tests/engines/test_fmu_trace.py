"""Traces and profiles of FMUs: each call in its order, whoever makes it, and not a bit of the run is another.

Witness: FMUs that write down their own calls (tests/support/faulty/calls.h).
"""

from __future__ import annotations

import itertools
import json
import math
import re
import subprocess
import sys
import threading
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, Gain, Relay, Sine, fmu
from blocks.cli import main
from blocks.fmi import trace
from blocks.results.results import Results
from blocks.text.errors import FMUError, UsageError
from tests.engines.test_master_calls import logging, mixed, ring
from tests.support.faulty import FAULTS, NEEDS_COMPILER, make
from tests.support.zoo import zoo

pytestmark = NEEDS_COMPILER
each_fmi = pytest.mark.parametrize("fmi", [2, 3])
each_engine = pytest.mark.parametrize("engine", ["native", "reference"])
SETTINGS: dict[str, Any] = {"stop": 0.05, "method": "rk4", "step": 0.0025, "every": 0.01}
WORDS = {"GetFMUstate": "save", "GetFMUState": "save", "SetFMUstate": "restore", "SetFMUState": "restore"}


def rows_of(file: Path) -> list[dict[str, Any]]:
    """The lines of a trace, all of which are JSON."""
    return [json.loads(line, parse_constant=lambda word: pytest.fail(word)) for line in file.read_text().splitlines()]


def untimed(file: Path) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if key != "us"} for row in rows_of(file)]


def same_bits(one: Results, other: Results) -> None:
    assert np.array_equal(one.t, other.t)
    assert np.array_equal(one.values, other.values, equal_nan=True)
    assert one.events == other.events
    assert one.measures == other.measures
    assert one.statistics.engine == other.statistics.engine
    assert one.statistics.steps == other.statistics.steps


def words_of(row: dict[str, Any], known: set[str]) -> list[str] | None:
    """A call as the FMU writes it down; None: it does not write this one down."""
    name = row["call"][4:]
    name = WORDS.get(name, name)
    if name not in known:
        return None
    given, words = row["given"], [row["fmu"], name]
    if name == "DoStep":
        forgets = int(given["noSetFMUStatePriorToCurrentPoint"])
        return [*words, *(repr(float(given[key])) for key in ("t", "h")), str(forgets)]
    if name in ("SetReal", "SetFloat64", "GetReal", "GetFloat64"):
        moved = given if name.startswith("Set") else row["gives"]
        return [*words, *(repr(float(value)) for value in moved.values())]
    return words


def words_noted(line: str) -> list[str]:
    """The same of what an FMU wrote down."""
    path, name, *rest = line.split()
    if name == "DoStep":
        return [path, name, repr(float(rest[0])), repr(float(rest[1])), rest[2]]
    if name in ("SetReal", "SetFloat64", "GetReal", "GetFloat64"):
        return [path, name, *(repr(float(value)) for value in rest[1::2])]
    return [path, name]


@each_fmi
@each_engine
@pytest.mark.parametrize(
    ("master", "is_plain"),
    [
        ({"order": 0}, True),  # the quick loop of the native master
        ({"algorithm": "gauss-seidel", "order": 2}, False),
        ({"algorithm": "iterated"}, False),
        ({"tolerance": 1e-3}, False),
    ],
)
def test_a_trace_holds_the_calls_that_the_fmus_write_down(
    master: dict[str, Any], is_plain: bool, engine: str, fmi: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noted, file = tmp_path / "noted", tmp_path / "calls.jsonl"
    diagram = ring(logging(tmp_path, fmi, feeds=False, is_plain=True)) if is_plain else mixed(logging(tmp_path, fmi))
    words = {**SETTINGS, "engine": engine, "log": ["a.y", "b.y"], "master": {"step": 0.01, **master}}
    monkeypatch.setenv("FAULTY_CALLS", str(noted))
    results = diagram.run(**words, trace=["a", "b"], trace_file=file)
    monkeypatch.delenv("FAULTY_CALLS")
    own = [words_noted(line) for line in noted.read_text().splitlines()]
    own = [line for line in own if line[1] not in ("Derivatives", "of")]
    known = {line[1] for line in own}
    rows = sorted(rows_of(file), key=lambda row: row["n"])
    assert [call for row in rows if (call := words_of(row, known)) is not None] == own
    assert [row["n"] for row in rows] == [*range(1, len(rows) + 1)]
    assert {row["status"] for row in rows} == {"ok"}
    assert "Instantiate" in rows[0]["call"]
    assert fmi == 2 or rows[0]["given"]["loggingOn"] is True
    assert rows[-1]["call"] == f"fmi{fmi}FreeInstance"
    same_bits(diagram.run(**words), results)


def rings_of_me(fmi: int) -> Diagram:
    made = Diagram("me")
    wave, plant = made.add("wave", Sine(omega=3.0)), made.add("plant", fmu(zoo(fmi), "ME"))
    made.wire(plant.u, wave.y)
    made.add("gain", Gain())
    made.wire(made["gain"].u, plant.y)
    return made


@each_fmi
def test_both_engines_call_an_fmu_for_model_exchange_alike(fmi: int, tmp_path: Path) -> None:
    diagram, traces = rings_of_me(fmi), {}
    for engine in ("native", "reference"):
        words = {"stop": 0.5, "method": "rk4", "step": 0.05, "engine": engine}
        file = tmp_path / f"{engine}.jsonl"
        results = diagram.run(**words, trace="plant", trace_file=file, profile=True)
        same_bits(diagram.run(**words), results)
        traces[engine] = untimed(file)
        steps = [row for row in traces[engine] if row["call"].endswith("CompletedIntegratorStep")]
        assert len(steps) == results.statistics.steps
        assert results.profile is not None
        assert results.profile.fmus[0].calls == len(traces[engine])
    # Between instants both ask what their methods need; what happens in the FMU is the same, at the same times.
    happens = ("Instantiate", "Initialization", "Completed", "EventMode", "DiscreteStates", "TimeMode", "Free")
    native, other = (
        [row for row in traces[engine] if any(word in row["call"] for word in happens)] for engine in traces
    )
    assert [(row["call"], row["given"], row["gives"]) for row in native] == [
        (row["call"], row["given"], row["gives"]) for row in other
    ]
    assert [row["t"] or 0.0 for row in native] == pytest.approx([row["t"] or 0.0 for row in other])
    named = next(row for row in traces["native"] if row["call"].endswith("SetContinuousStates"))
    assert {*named["given"]} == {"x", "s"}


@each_fmi
@each_engine
def test_an_isolated_fmu_is_traced_alike(fmi: int, engine: str, tmp_path: Path) -> None:
    traces = []
    for isolate in (False, True):
        made = Diagram("one")
        made.add("a", fmu(make(tmp_path, fmi=fmi), "CS", isolate=isolate))
        words: dict[str, Any] = {**SETTINGS, "engine": engine, "log": ["a.y"], "master": {"step": 0.01}}
        made.run(**words, trace="*", trace_file=tmp_path / "c.jsonl")
        traces.append(untimed(tmp_path / "c.jsonl"))
    assert traces[0] == traces[1]
    assert len(traces[0]) > 20


@each_fmi
@each_engine
@pytest.mark.parametrize("isolate", [False, True])
def test_a_trace_ends_with_the_call_that_failed(fmi: int, engine: str, isolate: bool, tmp_path: Path) -> None:
    made, file = Diagram("one"), tmp_path / "calls.log"
    made.add("a", fmu(make(tmp_path, fmi=fmi), "CS", isolate=isolate, fault=FAULTS.index("error"), t_fault=0.025))
    words: dict[str, Any] = {**SETTINGS, "engine": engine, "log": ["a.y"], "master": {"step": 0.01}}
    with pytest.raises(FMUError) as caught:
        made.run(**words, trace="a", trace_file=file, profile=True)
    lines = file.read_text().splitlines()
    failed = next(k for k, line in enumerate(lines) if " error " in line and "DoStep" in line)
    assert f"fmi{fmi}DoStep  t = 0.02, h = 0.0" in lines[failed]
    assert lines[failed + 1].strip().startswith("log error (")
    assert lines[-1].endswith(f"fmi{fmi}FreeInstance")
    assert len(lines) - failed <= 4
    assert caught.value.results is not None
    assert caught.value.results.profile is not None


@each_fmi
def test_the_trace_of_a_crash_shows_the_call_that_did_not_return(fmi: int, tmp_path: Path) -> None:
    path, file = make(tmp_path, fmi=fmi), tmp_path / "calls.log"
    code = (
        "from blocks import Diagram, fmu\nmade = Diagram('one')\n"
        f"made.add('a', fmu({str(path)!r}, 'CS', fault={FAULTS.index('segfault')}, t_fault=0.025))\n"
        f"made.run(stop=1, log=['a.y'], master={{'step': 0.01}}, trace='a', trace_file={str(file)!r})\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode < 0, done.stderr
    last = file.read_text().splitlines()[-1]
    assert re.search(rf" \.\.\.  a  fmi{fmi}DoStep  t = 0.02\d*, h = 0.0(1|0999)", last)


def test_a_long_trace_keeps_its_begin_and_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trace, "HEAD", 4000)
    monkeypatch.setattr(trace, "TAIL", 3000)
    made = Diagram("one")
    made.add("a", fmu(make(tmp_path), "CS"))
    words = {"stop": 2.0, "log": ["a.y"], "master": {"step": 0.01}, "every": 0.1}
    results = made.run(**words, trace="a", trace_file=tmp_path / "c.log", profile=True)
    assert results.profile is not None
    calls = results.profile.fmus[0].calls
    made.run(**words, trace="a", trace_file=tmp_path / "c.jsonl")
    for file in (tmp_path / "c.log", tmp_path / "c.jsonl"):
        text = file.read_text()
        assert 4000 + 3000 < len(text) < 4000 + 2 * 3000 + 500
        if file.suffix == ".jsonl":
            rows = rows_of(file)
            (out,) = (row["left_out"] for row in rows if "left_out" in row)
            numbers = [row["n"] for row in rows if "n" in row]
        else:
            (out,) = map(int, re.findall(r"\.\.\. (\d+) calls are left out here", text))
            numbers = [int(line.split()[0]) for line in text.splitlines()[1:] if "left out" not in line]
        gaps = [b - a for a, b in itertools.pairwise(numbers)]
        assert numbers[0] == 1
        assert numbers[-1] == calls
        assert sorted(gaps)[-2:] == [1, out + 1]


def test_texts_of_an_fmu_cannot_break_lines(tmp_path: Path) -> None:
    """A name with a line break, a quote and a control of terminals, and texts with the same."""
    path = make(tmp_path)
    with zipfile.ZipFile(path) as archive:
        entries = {entry: archive.read(entry) for entry in archive.namelist()}
    odd = "y&#10;&quot;&#x9b;31m\\&#x202e;"
    entries["modelDescription.xml"] = entries["modelDescription.xml"].replace(b'name="y"', f'name="{odd}"'.encode())
    with zipfile.ZipFile(path, "w") as archive:
        for entry, data in entries.items():
            archive.writestr(entry, data)
    name = 'y\n"\x9b31m\\\u202e'
    made = Diagram("one")
    made.add("a", fmu(path, "CS", label='no\n"quotes"\x1b[31m'))
    words: dict[str, Any] = {"stop": 0.02, "master": {"step": 0.01}, "trace": "a"}
    made.run(**words, trace_file=tmp_path / "c.jsonl")
    made.run(**words, trace_file=tmp_path / "c.log")
    rows = rows_of(tmp_path / "c.jsonl")
    assert any(name in row["gives"] for row in rows)
    assert {"label": 'no\n"quotes"\x1b[31m'} in [row["given"] for row in rows]
    lines = (tmp_path / "c.log").read_text().split("\n")
    assert len(lines) == len(rows) + 2
    assert all(line.isprintable() for line in lines)


def test_messages_of_chosen_categories_are_in_the_trace(tmp_path: Path) -> None:
    made, file = Diagram("one"), tmp_path / "c.jsonl"
    made.add("a", fmu(make(tmp_path), "CS", fault=FAULTS.index("warning"), t_fault=0.0))
    words: dict[str, Any] = {"stop": 0.02, "log": ["a.y"], "master": {"step": 0.01}, "trace": "a", "trace_file": file}
    said = []
    for categories in ((), "logAll"):
        results = made.run(**words, log_categories=categories)
        messages = [row for row in rows_of(file) if "log" in row]
        said.append({(row["fmu"], row["log"], row["category"]) for row in messages})
        assert [fault.code for fault in results.warnings] == ["W203"]
    assert said[0] == {("a", "warning", "logStatusWarning")}
    assert said[1] == {*said[0], ("a", "ok", "logAll")}
    with pytest.raises(UsageError, match=r'log_categories: the traced FMUs have no category "logEvnts".*logAll'):
        made.run(**words, log_categories=["logEvnts"])


@each_fmi
@pytest.mark.parametrize("outer", [2, 3])
def test_a_diagram_as_an_fmu_reports_the_calls_of_the_fmus_inside(outer: int, fmi: int, tmp_path: Path) -> None:
    """They are those of the same diagram in Python, word for word."""
    diagram = ring(logging(tmp_path, fmi, feeds=False, is_plain=True))
    diagram.output("y", "a.y")
    diagram.settings(stop=0.05, every=0.01, master={"step": 0.01, "order": 0})
    diagram.run(engine="native", trace="*", trace_file=tmp_path / "own.log")
    diagram.export(tmp_path / "whole.fmu", fmi=outer)
    whole = Diagram.alone(fmu(tmp_path / "whole.fmu", "CS"))
    words: dict[str, Any] = {"stop": 0.05, "every": 0.01, "master": {"step": 0.01}}
    file = tmp_path / "c.jsonl"
    traced = whole.run(**words, trace="*", trace_file=file, log_categories="logTrace")
    same_bits(whole.run(**words), traced)
    said = [row["text"].split() for row in rows_of(file) if row.get("category") == "logTrace"]
    own = [line.split() for line in (tmp_path / "own.log").read_text().splitlines()[1:]]
    assert len(said) > 40
    for name in ("a", "b"):
        inside, alone = ([[line[1], *line[4:]] for line in lines if line[5] == name] for lines in (said, own))
        first, other = (next(k for k, line in enumerate(lines) if "DoStep" in line[3]) for lines in (inside, alone))
        ended = [line for line in alone[other:] if line[3][4:] not in ("Terminate", "FreeInstance")]
        assert inside[first - 1 : first + len(ended)] == [alone[other - 1], *ended]
        assert any("InitializationMode" in line[3] for line in inside[:first])


def test_runs_in_threads_keep_their_traces_apart(tmp_path: Path) -> None:
    path = make(tmp_path)
    model = Diagram("one")
    model.add("a", fmu(path, "CS"))
    words = {"stop": 1.0, "log": ["a.y"], "master": {"step": 0.01}, "trace": "a"}
    model.run(**words, trace_file=tmp_path / "alone.jsonl")
    files = [tmp_path / f"{k}.jsonl" for k in range(4)]
    threads = [threading.Thread(target=lambda file=file: model.run(**words, trace_file=file)) for file in files]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    alone = untimed(tmp_path / "alone.jsonl")
    assert all(untimed(file) == alone for file in files)


def test_the_shares_of_a_profile_are_those_of_the_run(tmp_path: Path) -> None:
    path = make(tmp_path)
    made = Diagram("two")
    for name in ("a", "b"):
        made.add(name, fmu(path, "CS"))
    results = made.run(stop=1.0, log=["a.y"], master={"step": 0.01}, profile=True)
    profile = results.profile
    assert profile is not None
    assert {one.fmu for one in profile.fmus} == {"a", "b"}
    for one in profile.fmus:
        assert one.functions["fmi3DoStep"].number == 100
        assert one.calls == sum(calls.number for calls in one.functions.values())
        assert math.isclose(profile.share(one), one.seconds / results.statistics.seconds)
        slowest = max(one.functions, key=lambda name: one.functions[name].seconds)
        assert slowest in str(profile)
    assert 0 < sum(map(profile.share, profile.fmus)) < 1
    assert made.run(stop=0.1, master={"step": 0.01}).profile is None


def test_what_cannot_be_traced_is_refused(tmp_path: Path) -> None:
    made = Diagram("one")
    made.add("motor", fmu(make(tmp_path), "CS"))
    plain = Diagram("plain")
    plain.add("wave", Sine())
    with pytest.raises(UsageError, match=r'E501 trace: "motr" matches no FMU of the diagram\. Did you mean .motor.\?'):
        made.run(stop=1, trace="motr")
    with pytest.raises(UsageError, match="E501 trace: must be a name, or a list of names, not 5"):
        made.run(stop=1, trace=5)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="E501 trace: the diagram has no FMU"):
        plain.run(stop=1, trace="*")
    with pytest.raises(UsageError, match="E501 profile: the diagram has no FMU"):
        plain.run(stop=1, profile=True)
    with pytest.raises(UsageError, match="E501 log_categories: "):
        made.run(stop=1, log_categories=["logAll"])
    with pytest.raises(UsageError, match="E501 trace_file: "):
        made.run(stop=1, trace_file=tmp_path / "c.log")
    with pytest.raises(UsageError, match=r"E501 .*no such folder.*: the trace cannot be written: No such file"):
        made.run(stop=1, trace="motor", trace_file=tmp_path / "no such folder" / "c.log")


def test_commands_write_traces_and_print_profiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    made = Diagram("loop")
    made.add("motor", fmu(make(tmp_path), "CS"))
    made.settings(stop=0.1, master={"step": 0.01})
    made.save("loop.json")
    assert main(["run", "loop.json", "--trace", "motor", "--profile"]) == 0
    text = capsys.readouterr().out
    assert "calls of FMUs" in text
    assert "motor" in text
    assert "fmi3DoStep  t = 0.09" in (tmp_path / "loop.trace.log").read_text()
    assert main(["fmu", "run", "faulty.fmu", "--stop", "0.1", "--trace", "calls.jsonl", "--json", "--profile"]) == 0
    (done,) = (json.loads(line) for line in capsys.readouterr().out.splitlines() if '"done"' in line)
    assert done["profile"][0]["calls"] == len(rows_of(tmp_path / "calls.jsonl"))
    assert main(["run", "loop.json", "--trace", "*", "--trace-file", "loop.json"]) == 2
    assert "is also an input of this command" in capsys.readouterr().err
    assert main(["run", "loop.json", "--log-categories", "logAll"]) == 2
    told = capsys.readouterr().err  # the names of the command
    assert "E501 --log-categories: are of FMUs that are traced, and none is. Choose FMUs by --trace" in told


def test_after_an_early_return_an_fmu_is_where_it_came_to(tmp_path: Path) -> None:
    made = Diagram("events")
    relay = Diagram.alone(Relay(on_at=0.5, off_at=-0.5))
    relay.export(tmp_path / "relay.fmu")
    switch, wave = made.add("switch", fmu(tmp_path / "relay.fmu", "CS")), made.add("wave", Sine(omega=3.0))
    made.wire(switch.u, wave.y)
    made.settings(stop=2.0, master={"step": 0.1})
    made.run(engine="native", trace="switch", trace_file=tmp_path / "calls.jsonl")
    rows = [row for row in rows_of(tmp_path / "calls.jsonl") if "within" not in row]
    pairs = [(row["gives"], after["t"]) for row, after in itertools.pairwise(rows) if row["call"] == "fmi3DoStep"]
    early = [(gives["lastSuccessfulTime"], t) for gives, t in pairs if gives.get("earlyReturn")]
    assert len(early) == 2
    assert all(last == t for last, t in early)
