"""Streams of random numbers: blocks are independent of each other, and keep their numbers in all that happens to them.

The truth is `samples`, which computes in Python's integers what the page of Noise and `docs/semantics.md` say.
"""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from blocks import (
    Block,
    Constant,
    DeclarationError,
    Diagram,
    FirstOrder,
    Gain,
    ModelError,
    Noise,
    Parameter,
    UsageError,
    output,
)
from blocks.cli import main
from blocks.compile.c.model_code import emit
from blocks.compile.toolchain.compiler import find_compiler
from blocks.editing.renaming import renaming
from blocks.model.document import load, loads
from blocks.model.streams import is_stream, number_of
from tests.support.fmus import exported
from tests.support.places import ROOT

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")
ENGINES = ["reference", pytest.param("native", marks=needs_compiler)]
P, Q = 67108859, 67108837


def word(tick: int, seed: int, stream: int, salt: int, m: int) -> int:
    x = (tick % m + 40503 * salt) % m
    shifts = (seed, tick // m + 7919 * salt, 2654435 + salt + stream % 2**26, stream // 2**26, seed)
    for factor, shift in zip((48271, 69621, 16807, 742938, 39373), shifts, strict=True):
        x = pow(factor * x + shift % m, 3, m)
    return x


def samples(name: str, count: int, *, seed: int = 0, of_run: int = 0) -> list[float]:
    """The first numbers of a uniform Noise of deviation 1, from the name of its stream."""
    stream = int.from_bytes(hashlib.sha256(f"{of_run} {name}".encode()).digest()[:8], "big") >> 12
    made = []
    for tick in range(count):
        u = (word(tick, seed, stream, 0, P) + (word(tick, seed, stream, 1, Q) + 0.5) / Q) / P
        made.append(math.sqrt(3.0) * (2.0 * u - 1.0))
    return made


def noise(**parameters: Any) -> Noise:
    return Noise(distribution="uniform", period=0.25, **parameters)


def at_ticks(results: Any, name: str, count: int) -> list[float]:
    """The values within the first periods, each of 0.25 s."""
    rows = np.searchsorted(results.t, 0.25 * np.arange(count) + 0.125)
    return np.asarray(results[name])[rows].tolist()  # type: ignore[no-any-return]


def numbers(diagram: Diagram, name: str, count: int = 20, **options: Any) -> list[float]:
    return at_ticks(diagram.run(stop=0.25 * count, **options), name, count)


def wheel() -> Diagram:
    inner = Diagram("wheel")
    inner.add("noise", noise())
    inner.output("y", "noise.y")
    return inner


def robot() -> Diagram:
    d = Diagram("robot")
    d.add("left", wheel())
    d.add("right", wheel())
    d.add("noise", noise())
    return d


# --- what the numbers are --------------------------------------------------------------------------------------


def test_two_blocks_with_default_seeds_are_independent_and_each_has_its_variance() -> None:
    d, count = Diagram("two"), 20_000
    for name in ("a", "b"):
        d.add(name, Noise(period=0.25))
    results = d.run(stop=0.25 * count)
    a, b = (np.array(at_ticks(results, f"{name}.y", count)) for name in ("a", "b"))
    assert not np.any(a == b)
    assert abs(np.corrcoef(a, b)[0, 1]) < 4 / math.sqrt(count)
    for lag in (1, 2, 3):
        assert abs(np.corrcoef(a[lag:], b[:-lag])[0, 1]) < 4 / math.sqrt(count)
    for one in (a, b):
        assert stats.kstest(one, "norm").pvalue > 1e-3
        assert np.var(one) == pytest.approx(1.0, abs=4 * math.sqrt(2 / count))
    # The variance of a sum is the sum of the variances: with one stream for both it would be 4.
    assert np.var(a + b) == pytest.approx(2.0, abs=8 * math.sqrt(2 / count))


def test_a_thousand_streams_average_as_independent_ones_do() -> None:
    count, ticks = 1000, np.arange(400)
    drawn = np.array([[word(int(k), 0, int(number_of(0, f"n{i}")), 0, P) / P for k in ticks] for i in range(count)])
    means = drawn.mean(axis=0)  # over the streams, at each tick
    assert stats.kstest((means - 0.5) * math.sqrt(12 * count), "norm").pvalue > 1e-3


@pytest.mark.parametrize("engine", ENGINES)
def test_the_numbers_follow_from_path_seed_and_seed_of_the_run_bit_by_bit(engine: str) -> None:
    d = robot()
    for path in ("noise", "left.noise", "right.noise"):
        assert numbers(d, f"{path}.y", engine=engine) == samples(path, 20)
    assert numbers(d, "left.noise.y", engine=engine, seed=5) == samples("left.noise", 20, of_run=5)
    changed = {"left.noise.seed": 3}
    assert numbers(d, "left.noise.y", engine=engine, parameters=changed) == samples("left.noise", 20, seed=3)


def test_the_number_of_a_stream_is_the_same_for_ever() -> None:
    assert number_of(0, "noise") == int(hashlib.sha256(b"0 noise").hexdigest()[:13], 16)
    assert len({number_of(seed, f"n{k}") for seed in range(30) for k in range(300)}) == 9000


@pytest.mark.parametrize("engine", ENGINES)
def test_a_stream_that_two_blocks_name_is_one_where_their_seeds_are_equal(engine: str) -> None:
    d = Diagram("wind")
    d.add("a", noise(), stream="wind")
    d.add("b", noise(), stream="/wind")
    d.add("c", noise(seed=1), stream="wind")
    assert numbers(d, "a.y", engine=engine) == numbers(d, "b.y", engine=engine) == samples("wind", 20)
    assert numbers(d, "c.y", engine=engine) == samples("wind", 20, seed=1)
    assert Diagram.from_json(d.dumps()).value.blocks == d.value.blocks
    assert '"b": {"type": "Noise", "stream": "/wind", "parameters"' in d.dumps()


def test_a_name_counts_from_its_diagram_and_with_a_slash_from_the_whole() -> None:
    inner = Diagram("inner")
    inner.add("own", noise(), stream="gusts.x")
    inner.add("shared", noise(), stream="/wind")
    d = Diagram("d")
    d.add("a", inner)
    d.add("b", inner, stream="c")
    d.add("e", inner, stream="/far.away")
    expected = {"a.own": "a.gusts.x", "b.own": "c.gusts.x", "e.own": "far.away.gusts.x", "b.shared": "wind"}
    for path, stream in expected.items():
        assert numbers(d, f"{path}.y") == samples(stream, 20)


def test_a_variant_has_the_stream_of_its_block_or_one_of_its_own() -> None:
    d = Diagram("d")
    d.add("n", Constant())
    d.swap("n", noise(), variant="plain")
    document = d.to_json()
    document["blocks"]["n"]["variants"]["named"] = {**document["blocks"]["n"]["variants"]["plain"], "stream": "x"}
    d = Diagram.from_json(document)
    assert numbers(d, "n.y", variants={"n": "plain"}) == samples("n", 20)
    assert numbers(d, "n.y", variants={"n": "named"}) == samples("x", 20)
    assert numbers(d, "n.y", variants={"n": "base"}) == [1.0] * 20


def test_what_is_swapped_in_draws_from_the_stream_that_the_block_names() -> None:
    d = Diagram("d")
    for name in ("plain", "part", "still"):
        d.add(name, noise(), stream=f"old_{name}")
    d.add("wheel", wheel(), stream="left")
    d.swap("plain", noise(mean=1.0))
    d.swap("part", wheel())
    d.swap("still", Constant())
    d.swap("wheel", wheel())
    assert numbers(d, "plain.y") == pytest.approx(1 + np.array(samples("old_plain", 20)))
    assert numbers(d, "part.y") == samples("old_part.noise", 20)
    assert numbers(d, "wheel.y") == samples("left.noise", 20)
    assert "stream" not in d.to_json()["blocks"]["still"]["variants"]["Constant"]


# --- what is refused -------------------------------------------------------------------------------------------


def refused(blocks: dict[str, Any], **sections: Any) -> list[str]:
    text = {"format": "blocks-diagram", "version": 3, "blocks": blocks, **sections}
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(json.dumps(text, indent=1)).check()
    return [f"{fault.code} {fault.place}: {fault.message}" for fault in caught.value.faults]


PLAIN: dict[str, Any] = {"type": "Noise"}


@pytest.mark.parametrize(
    ("blocks", "place"),
    [
        ({"a": PLAIN, "b": {**PLAIN, "stream": "a"}}, "b"),
        ({"b": {**PLAIN, "stream": "a"}, "a": PLAIN}, "a"),
        ({"l": {"diagram": {"blocks": {"n": PLAIN}}}, "n": {**PLAIN, "stream": "l.n"}}, "n"),
        ({"l": {"diagram": {"blocks": {"n": {**PLAIN, "stream": "/k"}}}}, "k": PLAIN}, "k"),
        # The subdiagram says a name, and that is none that tells the two blocks in it apart.
        ({"l": {"stream": "k", "diagram": {"blocks": {"n": {**PLAIN, "stream": "m"}, "m": PLAIN}}}}, "l.m"),
        # A block that was renamed keeps its stream, and another one takes its old name.
        ({"new": {"diagram": {"blocks": {"n": PLAIN}}, "stream": "old"}, "old": {"diagram": {"blocks": {"n": PLAIN}}}},
         "old.n"),
    ],
)  # fmt: skip
def test_a_stream_that_only_one_of_two_blocks_names_is_refused(blocks: dict[str, Any], place: str) -> None:
    (message,) = refused(blocks)
    assert message.startswith(f"E109 {place}: draws from the stream ")


def test_streams_that_both_name_may_be_named_by_what_is_around_them() -> None:
    inside = {"diagram": {"blocks": {"n": PLAIN}}, "stream": "both"}
    text = {"format": "blocks-diagram", "version": 3, "blocks": {"l": inside, "r": inside}, "run": {"stop": 1}}
    results = Diagram.from_json(text).run()
    assert np.array_equal(results["l.n.y"], results["r.n.y"])


def test_a_stream_of_very_many_blocks_is_looked_through_at_once() -> None:
    blocks = {f"n{k}": {**PLAIN, "stream": "wind"} for k in range(6_000)}
    inside = {f"s{k}": {"diagram": {"blocks": {"n": PLAIN}}, "stream": "gusts"} for k in range(2_000)}
    text = {"format": "blocks-diagram", "version": 3, "blocks": {**blocks, **inside}}
    Diagram.from_json(text).flatten()


@pytest.mark.parametrize("stream", ["", "a b", "a..b", "/", "//a", "a/b", ".a", "a.", "9", "ä", "a\n", "x" * 201])
def test_what_is_no_name_of_a_stream_is_refused_with_its_place(stream: str) -> None:
    assert not is_stream(stream)
    (message,) = refused({"a": {**PLAIN, "stream": stream}})
    assert message.startswith("E111 blocks.a.stream: ")
    if stream:
        with pytest.raises(ModelError, match="E111"):
            Diagram("d").add("a", Noise(), stream=stream)


def test_what_draws_nothing_has_no_stream_and_the_number_is_given_by_nobody() -> None:
    assert refused({"a": {"type": "Gain", "stream": "x"}, "k": {"type": "Constant"}}, wires={"a.u": "k.y"}) == [
        "E003 a.stream: draws no random numbers, so it has no stream."
    ]
    assert refused({"a": {"type": "Noise", "stream": 3}}) == ["E004 blocks.a.stream: must be a text, not the number 3."]
    (message,) = refused({"a": {"type": "Noise", "parameters": {"stream": "x"}}})
    assert message.startswith("E106 a.stream: Noise has no parameter of this name")
    with pytest.raises(ModelError, match=r'E106 .*add\("x", Noise\(\), stream="..."\)'):
        Noise(stream="x")
    with pytest.raises(ModelError, match=r"E106 noise\.stream"):
        robot().run(stop=1, parameters={"noise.stream": 1})
    run = robot().start(stop=1)
    with pytest.raises(UsageError, match="E502"):
        run.set("noise.stream", 1)


@pytest.mark.parametrize("seed", [-1, 0.5, 2.0**54, True, "1", {"value": 1, "unit": "s"}, math.inf])
def test_the_seed_of_a_run_is_an_integer(seed: Any) -> None:
    with pytest.raises(ModelError, match=r"E115 run\.seed: must be an integer from 0 to 2\^53"):
        robot().run(stop=1, seed=seed)


def test_a_parameter_is_the_number_of_a_stream_and_nothing_else() -> None:
    with pytest.raises(DeclarationError, match="E405"):
        Parameter(1.0, stream=True)
    with pytest.raises(DeclarationError, match="E405"):
        Parameter(stream=True, unit="V")


# --- what happens to a run -------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
def test_a_seed_that_is_set_counts_from_the_next_tick_on(engine: str) -> None:
    run = robot().start(stop=5, engine=engine)
    run.advance_to(2.375)
    run.set("left.noise.seed", 9)
    made = at_ticks(run.finish(), "left.noise.y", 20)
    assert made == samples("left.noise", 10) + samples("left.noise", 20, seed=9)[10:]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_that_is_resumed_goes_on_with_its_noise(engine: str, tmp_path: Path) -> None:
    d, whole = robot(), samples("left.noise", 20, of_run=4)
    d.settings(seed=1)
    run = d.start(seed=4, engine=engine)
    run.advance_to(2.375)
    run.save(tmp_path / "state")
    d.settings(seed=2)  # what the file says counts for runs that begin
    for state in (tmp_path / "state", run.snapshot()):
        for given in ({}, {"seed": 4}):
            rest = d.run(stop=5, resume=state, engine=engine, **given)
            rows = np.searchsorted(rest.t, 0.25 * np.arange(10, 20) + 0.125)
            assert np.asarray(rest["left.noise.y"])[rows].tolist() == whole[10:]
        with pytest.raises(UsageError, match=r"E506 robot: the state comes from a run with the seed 4"):
            d.run(stop=5, resume=state, engine=engine, seed=5)
    other = d.start(seed=7, engine=engine)
    other.restore(tmp_path / "state")
    other.set("left.noise.seed", 0)
    other.advance_to(2.625)
    assert other["left.noise.y"] == whole[10]


@needs_compiler
def test_another_seed_is_not_compiled_anew() -> None:
    texts = {repr(emit(robot().plan(seed=seed), method="dopri5")) for seed in (0, 1, 99)}
    assert len(texts) == 1


def test_a_linear_model_does_not_depend_on_the_seed() -> None:
    d = Diagram("d")
    u = d.input("u", default=0.0)
    add, plant = d.add("gain", Gain(k=2.0)), d.add("plant", FirstOrder(T=0.5))
    d.add("noise", noise())
    d.wire(add.u, u)
    d.wire(plant.u, add.y)
    for seed in (0, 3):
        system = d.linearize("u", "plant.y", seed=seed)
        assert system(0.0) == pytest.approx(2.0)
        assert system.poles() == pytest.approx([-2.0])


def test_the_command_line_and_the_origin_of_results_have_the_seed(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "d.json"
    robot().save(path)
    asked = ["--stop", "5", "--seed", "12", "--every", "0.125", "--log", "noise.y"]
    assert main(["run", str(path), *asked, "-o", str(tmp_path / "r.csv")]) == 0
    capsys.readouterr()
    lines = [line for line in (tmp_path / "r.csv").read_text().splitlines() if line[0].isdigit()]
    rows = {float(t): float(y) for t, y in (line.split(",") for line in lines)}
    assert [rows[0.25 * k + 0.125] for k in range(20)] == samples("noise", 20, of_run=12)
    origin = robot().run(stop=1, seed=12).origin
    assert origin is not None
    assert origin.settings["seed"] == 12


# --- exported --------------------------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.parametrize("kind", ["CS", "ME"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_exported_diagram_keeps_its_streams(fmi: int, kind: str) -> None:
    d = robot()
    d.output("l", "left.y")
    fmu = exported(d, fmi, seed=6)
    made = []
    with fmu.instance(kind) as one:
        one.begin(stop=5.0)
        for k in range(20):
            if kind == "CS":
                one.step(0.25 * k, 0.125)
            else:
                one.events()
                one.raw.enterContinuousTimeMode()
            made.append(one["l"])
            if k == 9:
                if kind == "ME":
                    one.raw.enterEventMode()
                one.set("left.noise.seed", 2)
                if kind == "ME":
                    one.raw.enterContinuousTimeMode()
            if kind == "CS":
                one.step(0.25 * k + 0.125, 0.125 - 1e-9 if k == 19 else 0.125)
            else:
                one.raw.setTime(0.25 * (k + 1))
                one.raw.enterEventMode()
        assert not one.errors
    expected = samples("left.noise", 20, of_run=6)[:10] + samples("left.noise", 20, seed=2, of_run=6)[10:]
    assert made == expected


@needs_compiler
def test_a_noise_that_is_exported_alone_has_the_stream_of_its_type() -> None:
    fmu = exported(Diagram.alone(noise()), 3)
    with fmu.instance() as one:
        one.begin(stop=5.0)
        one.step(0.0, 0.125)
        assert one["y"] == samples("Noise", 1)[0]


# --- renamed ---------------------------------------------------------------------------------------------------


def drawn(path: Path, name: str) -> list[float]:
    return numbers(Diagram.load(path), name)


@pytest.mark.parametrize("is_file", [False, True])
def test_a_block_that_is_renamed_keeps_its_numbers(is_file: bool, tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").touch()
    wheel().save(tmp_path / "wheel.json")
    d = robot()
    if is_file:
        d = Diagram("robot", folder=tmp_path)
        for name in ("left", "right"):
            d.add(name, Diagram.load(tmp_path / "wheel.json"))
        document = d.to_json()
        for name in ("left", "right"):
            document["blocks"][name]["diagram"] = "wheel.json"
        d = Diagram.from_json(document, folder=tmp_path)
        d.add("noise", noise())
    path = tmp_path / "d.json"
    d.save(path)
    renaming(path, "left", "front").write()
    renaming(path, "noise", "wind").write()
    assert main(["fmt", "--check", str(path)]) == 0
    assert drawn(path, "front.noise.y") == samples("left.noise", 20)
    assert drawn(path, "right.noise.y") == samples("right.noise", 20)
    assert drawn(path, "wind.y") == samples("noise", 20)
    if is_file:
        renaming(tmp_path / "wheel.json", "noise", "gusts").write()
        assert main(["fmt", "--check", str(tmp_path / "wheel.json")]) == 0
    else:
        renaming(path, "front.noise", "gusts").write()
    assert drawn(path, "front.gusts.y") == samples("left.noise", 20)
    assert drawn(path, "right.gusts.y" if is_file else "right.noise.y") == samples("right.noise", 20)
    renaming(path, "front", "first").write()  # it says its stream already
    assert drawn(path, "first.gusts.y") == samples("left.noise", 20)
    assert path.read_text().count('"stream"') == (2 if is_file else 3)


def test_a_variant_that_draws_keeps_its_numbers_and_what_draws_nothing_gets_no_stream(tmp_path: Path) -> None:
    d = Diagram("d")
    d.add("n", Constant())
    d.add("k", Constant())
    d.swap("n", noise(), variant="rough")
    path = tmp_path / "d.json"
    d.save(path)
    renaming(path, "n", "m").write()
    renaming(path, "k", "c").write()
    assert drawn(path, "m.y") == samples("n", 20)
    made = json.loads(path.read_text())["blocks"]
    assert made["m"]["variants"]["rough"]["stream"] == "n"
    assert "stream" not in made["m"]
    assert "stream" not in made["c"]
    assert load(path) == loads(path.read_text(), folder=tmp_path)


def test_a_stream_is_put_in_where_the_text_has_its_own_form_and_is_told(tmp_path: Path, capsys: Any) -> None:
    text = '{"format": "blocks-diagram", "version": 3,\n "blocks": {"n": {"doc": "x",\n\t"type" :"Noise"\n}}}'
    path = tmp_path / "d.json"
    path.write_text(text, encoding="utf-8")
    assert main(["rename", str(path), "n", "m"]) == 0
    out = capsys.readouterr().out
    assert '+ "stream": "n"' in out
    assert "in 1 place" in out
    assert path.read_text() == text.replace('"n"', '"m"').replace('"Noise"', '"Noise",\n\t"stream": "n"')


# --- compared --------------------------------------------------------------------------------------------------


def test_a_renamed_block_that_keeps_its_stream_is_renamed_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "d.json"
    robot().save(path)
    before = Diagram.load(path)
    renaming(path, "left", "front").write()
    renaming(path, "noise", "wind").write()
    assert [(change.kind, change.before_path, change.path) for change in before.diff(path).changes] == [
        ("renamed", "left", "front"),
        ("renamed", "noise", "wind"),
    ]


def test_a_stream_that_changes_is_a_difference() -> None:
    def of(name: str, stream: str = "") -> Diagram:
        d = Diagram("d")
        d.add(name, wheel(), stream=stream)
        d.add(f"gain_{name}", Constant(value=4.0))
        return d

    def told(a: Diagram, b: Diagram) -> list[str]:
        return [change.what or change.kind for change in a.diff(b).changes]

    assert told(of("a"), of("a")) == []
    assert told(of("a"), of("a", "a")) == []
    assert told(of("a"), of("a", "x")) == ["stream"]
    assert told(of("a"), of("b", "a")) == ["renamed", "renamed"]
    assert sorted(told(of("a"), of("b"))) == ["renamed", "renamed", "stream"]
    one, other = robot(), robot()
    other.settings(seed=3)
    assert [str(change.path) for change in one.diff(other).changes] == ["seed"]


class Coin(Block):
    """y = the number of the stream, divided by 2^52."""

    share = Parameter(stream=True)

    @output
    def y(share):  # type: ignore[no-untyped-def]
        return share / 2.0**52


@pytest.mark.parametrize("engine", ENGINES)
def test_classes_of_ones_own_draw_from_streams_too(engine: str) -> None:
    d = Diagram("d")
    d.add("a", Coin())
    d.add("b", Coin(), stream="c")
    results = d.run(stop=1, engine=engine, seed=3)
    assert [results[f"{name}.y"][0] * 2**52 for name in "ab"] == [number_of(3, "a"), number_of(3, "c")]


def test_no_shipped_diagram_names_a_stream_that_it_does_not_need() -> None:
    for path in (ROOT / "diagrams").rglob("*.json"):
        assert '"stream"' not in path.read_text(encoding="utf-8")
