"""What can be set of a diagram: the same numbers as flattening anew, bit for bit, in Python and in C."""

import ctypes
import enum
import math
import random
import re
import shutil
import struct
import subprocess
from collections.abc import Iterable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Block, Diagram, History, Input, ModelError, Parameter, State, output
from blocks.compile.bindings import bindings
from blocks.compile.c.bindings_code import bindings_c
from blocks.compile.plan import Plan
from blocks.compile.plan_builder import plan
from blocks.compile.setting_programs import Setting, evaluated, numbers, put
from blocks.contract.derivatives import derived
from blocks.contract.interface import Value
from blocks.contract.resolution import resolve
from blocks.contract.tape import TapeNode
from blocks.library import LIBRARY
from blocks.model import document
from blocks.model.diagram_grammar import RUN
from blocks.model.diagram_value import DiagramValue
from blocks.model.flatten import flatten
from blocks.model.resolver import resolver_of
from blocks.model.values import names_in
from blocks.text.errors import UsageError
from tests.support.library_variants import VARIANTS
from tests.support.places import ROOT

DIAGRAMS = [
    path
    for path in sorted((ROOT / "diagrams").rglob("*.json"))
    if path.stem != "iadrc_fmu" and '"blocks-study"' not in path.read_text()  # a master steps that one
]
every_diagram = pytest.mark.parametrize("path", DIAGRAMS, ids=[path.stem for path in DIAGRAMS])


def placed(settings: Any, s: Any, p: Any) -> list[float]:
    """The row p with the numbers of settings in their places."""
    row = list(p)
    put(settings, s, row)
    return row


class Color(enum.IntEnum):
    """Numbers with a gap."""

    red = 1
    green = 3


class Mixed(Block):
    """A parameter of each type."""

    flag = Parameter(True, type="bool", doc="a bool")
    count = Parameter(3, type="int", min=1, max=9)
    color = Parameter("red", type=Color)
    speed = Parameter(60.0, unit="rpm", min=-60.0, max=600.0)
    hidden = Parameter(None, unit="s")
    size = Parameter(positive=True)
    z = State(unit="m", shape=2)

    @z.derivative
    def dz(z, flag, count, speed):
        return -z * count * speed * np.where(flag, 1.0, 2.0)

    @output
    def y(z, size, color):
        return z[0] * size + color


class Whole(Block):
    """A vector and a matrix; the gain is a vector as long as the other one."""

    a = Parameter([1.0, 2.0], shape="n")
    b = Parameter(0.5, shape=lambda n: n)
    m = Parameter([[1.0, 2.0], [3.0, 4.0]], shape=("n", "n"))
    u = Input()

    @output
    def y(u, a, b, m):
        return u * np.sum(a * b) + m[0, 0]


def _helped(x):
    return 2.0 * float(x) ** 3 + math.exp(-float(x))


def _bounded(closed):
    def bound(k, low):
        return max(k, low, closed) - min(k, 1.0) + abs(low - k)

    return bound


class Derived(Block):
    """Computed defaults of many kinds."""

    k = Parameter(1.5)
    low = Parameter(0.5)
    v = Parameter([1.0, -2.0, 3.0], shape="n")
    whole = Parameter(2, type="int")
    copy = Parameter(lambda k: k)
    helped = Parameter(lambda k: _helped(k))
    bounded = Parameter(_bounded(0.25))
    chosen = Parameter(lambda k, low: np.where(k > low, k / low, np.sqrt(low)))
    turned = Parameter(lambda v, k: -v * k + [1.0, 2.0, 3.0], shape=lambda n: n)
    twice = Parameter(lambda turned, n: turned / n, shape=lambda n: n)
    signed = Parameter(lambda k: np.abs(k) + (1.0 if k else 2.0) + np.maximum(k, 0.1))
    above = Parameter(lambda k, low: (k > low) * 2.0 - (k == low))
    counted = Parameter(lambda whole: whole + 1, type="int")
    sizes = Parameter(lambda n: [1.0 / (1 + i) for i in range(n)], shape=lambda n: n)
    powers = Parameter(lambda v: v**2, shape=lambda n: n)
    solved = Parameter(lambda low: float(np.linalg.solve(np.eye(2) * low, [1.0, 2.0])[0]))
    u = Input()

    @output
    def y(u, k, copy, helped, bounded, chosen, turned, twice, signed, counted, sizes, powers, solved):
        return u * (k + copy + helped + bounded + chosen + np.sum(turned + twice + sizes + powers) + signed + solved)


TYPES = {**LIBRARY, **{cls.__name__: cls for cls in (Mixed, Whole, Derived)}}
RESOLVER = resolver_of(TYPES)


class Bound:
    """A diagram with its settings; flattened anew with other values."""

    def __init__(self, value: DiagramValue, overrides: dict[str, Any] | None = None, resolver: Any = RESOLVER) -> None:
        self.value, self.resolver, self.overrides = value, resolver, overrides or {}
        flat = flatten(value, resolver, overrides=self.overrides)
        self.plan: Plan = plan(flat)
        self.settings = bindings(flat, self.plan)
        self.named = {setting.path: setting for setting in self.settings}
        self.s = numbers(self.settings)

    def __getitem__(self, path: str) -> Setting:
        return self.named[path]

    def parameters(self, leaves: dict[str, list[float]]) -> list[float]:
        """p after leaves were set."""
        s = list(self.s)
        for path, values in leaves.items():
            first = self.named[path].first
            s[first : first + len(values)] = values
        return placed(self.settings, computed(self.settings, s), self.plan.parameters)

    def anew(self, leaves: dict[str, list[float]]) -> list[float]:
        """p of the diagram flattened with overrides. Raises ModelError."""
        raws = {path: raw(self.named[path], values) for path, values in leaves.items()}
        return list(plan(flatten(self.value, self.resolver, overrides={**self.overrides, **raws})).parameters)


def computed(settings: Sequence[Setting], s: Sequence[float]) -> list[float]:
    """Return the numbers of all settings with the bound ones computed from the leaves."""
    values = list(s)
    for setting in settings:
        for place, program in zip(setting.span, setting.elements or (), strict=False):
            values[place] = evaluated(program, values)
    return values


def raw(setting: Setting, values: Sequence[float]) -> Any:
    """Values in SI as a file would have them."""
    array = np.reshape([bool(x) for x in values] if setting.type == "bool" else values, setting.shape).tolist()
    return {"value": array, "unit": setting.unit} if setting.unit else array


@cache
def of_file(path: Path) -> Bound:
    diagram = Diagram.load(path)
    return Bound(diagram.value, None, resolver_of(diagram._draft.types))


def made(**sections: Any) -> DiagramValue:
    return document.from_document({"format": "blocks-diagram", "version": 3, "name": "d", **sections})


def bound(overrides: dict[str, Any] | None = None, /, **sections: Any) -> Bound:
    return Bound(made(**sections), overrides)


def bits(numbers_: Iterable[float]) -> list[bytes]:
    return [struct.pack("d", x) for x in numbers_]


def others(setting: Setting, rng: random.Random) -> list[float]:
    """Other values, near those of a leaf."""
    if setting.type == "bool":
        return [1.0 - x for x in setting.values]  # type: ignore[operator]
    if setting.members:
        return [float(rng.choice(list(setting.members.values()))) for _ in setting.values]
    if setting.whole:
        return [float(x) + rng.choice((1, 2)) for x in setting.values]
    return [float(x) * rng.uniform(0.9, 1.1) + (0.0 if x else rng.uniform(0.0, 0.1)) for x in setting.values]


def attempted(action: Any) -> tuple[Any, set[str]]:
    """What a call gives, and the codes of its faults."""
    try:
        return action(), set()
    except (ModelError, UsageError) as error:
        return None, {fault.code for fault in error.faults}


def settable(settings: Iterable[Setting]) -> list[Setting]:
    return [x for x in settings if not x.is_bound and x.variability != "constant" and x.values]


def without_inner_copies(settings: Sequence[Setting]) -> list[Setting]:
    """Leave out the settings of copies between the first and the last."""
    copies = [int(match[1]) if (match := re.search(r"\[(\d+)\]", x.path)) else 0 for x in settings]
    return [x for x, copy in zip(settings, copies, strict=True) if copy in (0, max(copies))]


def assert_sound(b: Bound) -> None:
    """What holds for the settings of every diagram."""
    assert bits(computed(b.settings, b.s)) == bits(b.s)
    taken = [place for setting in b.settings for places in setting.places for place in places]
    assert len(set(taken)) == len(taken)
    cleared = [math.nan if i in taken else x for i, x in enumerate(b.plan.parameters)]
    assert bits(placed(b.settings, computed(b.settings, b.s), cleared)) == bits(b.plan.parameters)
    hidden = [x for x in b.plan.instances if x.hidden]
    assert hidden or len(taken) == len(b.plan.parameters)
    count = 0
    for setting in b.settings:
        assert setting.first == (-1 if setting.type == "text" else count)
        count += len(setting.values) if setting.first >= 0 else 0
        assert len(setting.values) == len(setting.places) == (1 if setting.type == "text" else math.prod(setting.shape))
        assert (setting.elements is not None) == (setting.is_bound and setting.type != "text")
        assert bool(setting.why) == (setting.variability != "tunable")
        for program in setting.elements or ():
            assert all(node.value < setting.first for node in program if node.op == "argument")
    assert len(b.named) == len(b.settings)


def assert_follows(b: Bound, *, seed: int = 1) -> int:
    """Leaf by leaf, and all together, settings give what flattening anew gives. Returns how many leaves there are."""
    rng, accepted = random.Random(seed), {}
    for setting in without_inner_copies(settable(b.settings)):
        for values in (others(setting, rng) for _ in range(4)):
            expected, codes = attempted(partial(b.anew, {setting.path: values}))
            assert codes <= {"E107", "E108"}, setting.path  # out of its range, or a condition of the type
            if not codes:
                assert bits(b.parameters({setting.path: values})) == bits(expected), setting.path
                accepted[setting.path] = values
                break
    expected, codes = attempted(partial(b.anew, accepted))
    assert codes or bits(b.parameters(accepted)) == bits(expected)
    return len(accepted)


# --- every diagram that ships ----------------------------------------------------------------------------------


@every_diagram
def test_the_settings_of_a_diagram_give_its_parameters_bit_by_bit(path: Path) -> None:
    assert_sound(of_file(path))


@every_diagram
def test_after_leaves_have_changed_they_give_what_flattening_anew_gives(path: Path) -> None:
    bound = of_file(path)
    assert assert_follows(bound) > 0 or not settable(bound.settings)


@every_diagram
def test_a_run_takes_what_is_tunable_and_refuses_what_is_fixed(path: Path) -> None:
    b, rng = of_file(path), random.Random(2)
    run = Diagram.load(path).start(engine="reference", inputs=dict.fromkeys(b.value.inputs, 0.0))
    clock = {name for _, raw in RUN.quantities(b.value.run) for name in names_in(raw)}  # an FMU has its own
    for setting in without_inner_copies(settable(b.settings)):
        for values in (others(setting, rng) for _ in range(4)):
            _, codes = attempted(partial(run.set, setting.path, raw(setting, values)))
            if codes == {"E107"}:  # out of its range
                continue
            is_tunable = setting.variability == "tunable" and setting.path not in clock
            assert codes == (set() if is_tunable else {"E117"}), setting.path
            if not codes:
                assert bits(b.parameters({setting.path: values})) == bits(run.plan.parameters)
                run.set(setting.path, raw(setting, setting.values))  # type: ignore[arg-type]
            break
    assert bits(run.plan.parameters) == bits(b.plan.parameters)


# --- every block of the library --------------------------------------------------------------------------------


def of_block(name: str, given: dict[str, Any]) -> Bound:
    """A diagram of one block, whose inputs are those of the diagram."""
    interface = resolve(TYPES[name], {key: Value(value) for key, value in given.items()}).interface
    inputs, wires = {}, {}
    for port in interface.inputs.values():
        inputs[f"in_{port.name}"] = {"unit": port.unit} if port.unit else {}
        inputs[f"in_{port.name}"] |= {"size": port.size} if port.shape else {}
        inputs[f"in_{port.name}"] |= {"type": port.type} if port.type != "real" else {}
        wires[f"b.{port.name}"] = f"in_{port.name}"
    plain = {key: np.asarray(x).tolist() if isinstance(x, np.ndarray) else x for key, x in given.items()}
    # In SI, as the values of the table of variants are.
    units = interface.declaration.parameters
    entries = {}
    for key, value in plain.items():
        declared = set(interface.declared_units(units[key])) if not isinstance(value, (str, bool)) else set()
        entries[key] = {"value": value, "unit": declared.pop()} if len(declared) == 1 and "" not in declared else value
    return bound(inputs=inputs, wires=wires, blocks={"b": {"type": name, "parameters": entries}})


@pytest.mark.parametrize(("name", "given"), VARIANTS, ids=[f"{n}-{'-'.join(map(str, g))}" for n, g in VARIANTS])
def test_the_settings_of_a_block_are_its_parameters_and_follow_flattening(name: str, given: dict[str, Any]) -> None:
    b = of_block(name, given)
    assert_sound(b)
    assert_follows(b)
    known = {f"b.{key}" for key, x in TYPES[name].declaration.parameters.items() if x.default is not None}
    assert known <= set(b.named) <= {f"b.{key}" for key in TYPES[name].declaration.parameters}


def test_computed_defaults_of_the_library_are_followed_but_for_powers_of_arrays_and_linear_algebra() -> None:
    alone: dict[str, set[str]] = {}
    for name, given in VARIANTS:
        for setting in of_block(name, given).settings:
            if "which only Python can do" in setting.why:
                alone.setdefault(name, set()).add(setting.path)
    assert alone == {
        "DiscreteADRC": {"b.omega_c", "b.omega_o", "b.feedback", "b.observer"},
        "DiscreteESO": {"b.bandwidth", "b.gains"},
        "NESO": {"b.bandwidth", "b.alpha", "b.delta", "b.gains"},
    }


def test_the_bandwidth_of_a_linear_observer_is_tunable_and_its_gains_follow() -> None:
    b = of_block("LESO", {"order": 2, "bandwidth": 20.0})
    assert b["b.bandwidth"].variability == b["b.gains"].variability == "tunable"
    assert b["b.gains"].is_bound
    place = b["b.gains"].places[0][0]
    assert b.parameters({"b.bandwidth": [30.0]})[place : place + 3] == [90.0, 2700.0, 27000.0]


def test_gains_that_the_class_gives_itself_are_leaves() -> None:
    b = of_block("LESO", {})
    assert not b["b.gains"].is_bound
    assert b["b.gains"].values == (30.4, 523.4, 2970.8)
    assert "b.bandwidth" not in b.named


@pytest.mark.parametrize(
    ("kp", "ki", "kd"), [(1.0, 0.0, 0.0), (2.0, 3.0, 0.5), (-2.0, -3.0, -1.0), (2.0, -3.0, 1.0), (1.0, 1e-300, 0.0)]
)
def test_the_times_of_a_pid_follow_its_gains_through_every_condition(kp: float, ki: float, kd: float) -> None:
    b = of_block("PID", {"kp": 1.0, "ki": 2.0, "kd": 0.1})
    leaves = {"b.kp": [kp], "b.ki": [ki], "b.kd": [kd]}
    assert bits(b.parameters(leaves)) == bits(b.anew(leaves))


def test_where_a_default_refuses_its_arguments_the_number_is_nan() -> None:
    b = of_block("PID", {"kp": 1.0, "kd": 0.1})
    with pytest.raises(ModelError, match="is not a time"):
        b.anew({"b.kp": [-1.0]})
    assert math.isnan(b.parameters({"b.kp": [-1.0]})[b["b.Tf"].places[0][0]])


# --- computed defaults -----------------------------------------------------------------------------------------


def test_functions_with_conditions_helpers_and_closures_are_followed() -> None:
    b = of_block("Derived", {})
    assert_sound(b)
    assert assert_follows(b) >= 3
    followed = ("copy", "helped", "bounded", "chosen", "turned", "twice", "signed", "above", "counted")
    assert all(b[f"b.{name}"].is_bound for name in followed)
    assert not any(b[f"b.{name}"].is_bound for name in ("sizes", "powers", "solved"))
    for seed in range(20):
        rng = random.Random(seed)
        leaves = {"b.k": [rng.uniform(-3, 3)], "b.low": [rng.uniform(-3, 3)]}
        leaves["b.low"] = [abs(leaves["b.low"][0])]
        expected = b.anew(leaves)
        got = b.parameters(leaves)
        place = b["b.solved"].places[0][0]
        assert bits(got[:place]) == bits(expected[:place])


def test_what_an_unfollowed_default_reads_is_constant_and_says_why() -> None:
    b = of_block("Derived", {})
    assert (b["b.v"].variability, b["b.v"].why) == (
        "constant",
        "b.powers is computed from it, which only Python can do (a power of arrays)",
    )
    assert b["b.low"].variability == "constant"
    assert b["b.low"].why.startswith("b.solved is computed from it, which only Python can do (")
    assert b["b.k"].variability == "tunable"
    assert b["b.powers"].variability == b["b.solved"].variability == "tunable"  # leaves now: nothing moves them


def test_a_default_that_was_given_is_a_leaf_and_frees_what_it_would_read() -> None:
    b = of_block("Derived", {"powers": [1.0, 2.0, 3.0], "solved": 4.0})
    assert b["b.v"].variability == b["b.low"].variability == "tunable"
    assert_follows(b)


# --- hierarchies -----------------------------------------------------------------------------------------------

INNER: dict[str, Any] = {
    "parameters": {"Kp": 2.0, "T": {"value": 200, "unit": "ms", "doc": "time"}, "double": "=2*Kp"},
    "inputs": {"u": {}},
    "outputs": {"y": "lag.y"},
    "blocks": {
        "gain": {"type": "Gain", "parameters": {"k": "=double"}},
        "lag": {"type": "FirstOrder", "parameters": {"T": "=T", "k": 3.0}},
    },
    "wires": {"gain.u": "u", "lag.u": "gain.y"},
}


def nested(**given: Any) -> dict[str, Any]:
    return {
        "parameters": {"K": {"value": 1.5, "unit": "rpm", "doc": ["two", "lines"]}, "rest": "=sqrt(K)+1"},
        "inputs": {"u": {}},
        "blocks": {
            "left": {"diagram": INNER, "parameters": given},
            "right": {"diagram": INNER},
        },
        "wires": {"left.u": "u", "right.u": "u"},
    }


def test_parameters_of_subdiagrams_are_bound_where_they_are_given_by_expressions_only() -> None:
    b = bound(**nested(Kp="=rest/K", T={"value": 3, "unit": "min"}))
    assert_sound(b)
    assert assert_follows(b) >= 8
    assert b["left.Kp"].is_bound
    assert not b["left.T"].is_bound
    assert b["left.T"].values == (180.0,)
    assert (b["left.T"].unit, b["left.T"].display) == ("s", "ms")
    assert b["left.double"].is_bound
    assert not b["right.Kp"].is_bound
    assert (b["right.T"].values, b["right.T"].doc) == ((0.2,), "time")
    assert (b["K"].unit, b["K"].display, b["K"].doc) == ("rad/s", "rpm", "two\nlines")
    assert b["left.gain.k"].is_bound
    assert not b["left.lag.k"].is_bound
    assert b["left.lag.y_start"].variability == "fixed"


def test_what_cannot_be_overridden_is_bound_and_the_other_way_round() -> None:
    b = bound(**nested(Kp="=rest/K", T=3.0))
    for setting in b.settings:
        if setting.type != "text" and setting.variability != "constant":
            values = [float(x) for x in setting.values]
            if setting.is_bound:
                with pytest.raises(ModelError, match="E117"):
                    b.anew({setting.path: values})
            else:
                assert bits(b.anew({setting.path: values})) == bits(b.plan.parameters)


def test_overrides_that_the_diagram_was_flattened_with_count() -> None:
    sections = nested(T=0.5)
    b = Bound(made(**sections), {"left.T": {"value": 5, "unit": "ms"}, "left.Kp": "=T*100", "right.lag.k": "=Kp+1"})
    assert_sound(b)
    assert b["left.T"].values == (0.005,)
    assert b["left.Kp"].is_bound
    assert b["left.Kp"].values == (0.5,)
    assert b["right.lag.k"].is_bound
    assert bits(b.parameters({"left.T": [0.25], "right.Kp": [7.0]})) == bits(
        Bound(made(**sections), {"left.T": 250, "left.Kp": 25.0, "right.Kp": 7.0, "right.lag.k": 8.0}).plan.parameters
    )


def test_vectors_and_matrices_are_bound_element_by_element() -> None:
    b = bound(
        parameters={"v": [1.0, 2.0, 3.0], "k": 0.5, "m": [[1, 2, 3], [4, 5, 6], [7, 8, 9]], "w": ["=k", 4, "=2*k"]},
        inputs={"u": {}},
        blocks={
            "a": {"type": "Whole", "parameters": {"a": "=v", "b": "=k", "m": "=m"}},
            "b": {"type": "Whole", "parameters": {"a": ["=k", 2.0, "=k**2"], "b": "=v", "m": [[1, "=k", 3]] * 3}},
            "c": {"type": "Whole", "parameters": {"a": "=w", "m": np.eye(3).tolist()}},
        },
        wires={"a.u": "u", "b.u": "u", "c.u": "u"},
    )
    assert_sound(b)
    assert assert_follows(b) >= 4
    assert b["a.m"].shape == (3, 3)
    assert b["a.m"].elements is not None
    assert b["a.m"].elements[5] == (TapeNode("argument", (), b["m"].first + 5),)
    assert b["b.a"].elements is not None
    assert b["b.a"].elements[1] == (TapeNode("constant", (), 2.0),)
    assert not b["c.b"].is_bound
    assert b["c.b"].values == (0.5, 0.5, 0.5)
    leaves = {"v": [4.0, 5.0, 6.0], "k": [0.125]}
    assert bits(b.parameters(leaves)) == bits(b.anew(leaves))


def test_bools_integers_members_and_texts_pass_whole() -> None:
    b = bound(
        parameters={"on": False, "n": 4, "color": "green", "number": 1, "text": "V", "s": 2},
        blocks={
            "a": {
                "type": "Mixed",
                "parameters": {"flag": "=on", "count": "=n", "color": "=color", "size": "=s"},
            },
            "b": {
                "type": "Mixed",
                "parameters": {"color": "=number", "size": 1.0, "speed": {"value": 1, "unit": "rev/min"}},
            },
            "c": {"type": "Constant", "parameters": {"unit": "=text"}},
        },
    )
    assert_sound(b)
    assert assert_follows(b) >= 6
    assert [b[path].type for path in ("on", "n", "color", "a.flag", "a.count", "a.color", "c.unit")] == [
        *("bool", "real", "text", "bool", "int", "enum", "text"),
    ]
    assert b["a.color"].elements == ((TapeNode("constant", (), 3.0),),)
    assert b["a.color"].members == {"red": 1, "green": 3}
    assert (b["c.unit"].variability, b["c.unit"].values, b["c.unit"].is_bound) == ("constant", ("V",), True)
    assert (b["text"].variability, b["text"].why) == ("constant", "it is a text")
    assert "a.hidden" not in b.named
    # A leaf takes on the range of what it is given to whole.
    assert (b["n"].low, b["n"].high, b["n"].whole) == (1.0, 9.0, True)
    assert (b["s"].low, b["s"].low_open, b["s"].whole) == (0.0, True, False)
    assert b["number"].members == {"red": 1, "green": 3}
    assert b["b.speed"].low == -b["b.speed"].high / 10 == pytest.approx(-2 * math.pi)
    for path, wrong in (("n", 10.0), ("n", 1.5), ("s", 0.0), ("number", 2.0), ("b.speed", 63.0)):
        with pytest.raises(ModelError, match="E107"):
            b.anew({path: [wrong]})
    for path, right in (("n", 9.0), ("n", 1.0), ("s", 5e-324), ("number", 3.0), ("b.speed", b["b.speed"].low)):
        assert right is not None
        b.anew({path: [right]})


# --- what may change -------------------------------------------------------------------------------------------


def test_a_leaf_is_as_strict_as_what_depends_on_it() -> None:
    b = bound(
        parameters={
            "Ts": 0.1,
            "half": "=Ts/2",
            "k": 2.0,
            "x0": 1.0,
            "at": 3.0,
            "free": 1.0,
            "den": [1.0, 2.0],
            "gain": 1,
        },
        inputs={"u": {}},
        blocks={
            "hold": {"type": "ZeroOrderHold", "parameters": {"period": "=half", "y_start": "=k"}},
            "sum": {"type": "Integrator", "parameters": {"y_start": "=x0"}},
            "gain1": {"type": "Gain", "parameters": {"k": "=k"}},
            "gain2": {"type": "Gain", "parameters": {"k": "=x0*free"}},
            "gain3": {"type": "Gain", "parameters": {"k": "=at"}},
            "step": {"type": "Step", "parameters": {"at": "=at"}},
            "tf": {"type": "TransferFunction", "parameters": {"num": ["=gain"], "den": "=den"}},
            "delay": {"type": "TransportDelay", "parameters": {"delay": 0.5, "y_before": 1.0}},
        },
        wires={f"{name}.u": "u" for name in ("hold", "sum", "gain1", "gain2", "gain3", "tf", "delay")},
    )
    assert_sound(b)
    told = {setting.path: (setting.variability, setting.why) for setting in b.settings if "." not in setting.path}
    assert told == {
        "Ts": ("constant", "hold.period: ticks depend on it"),
        "half": ("constant", "hold.period: ticks depend on it"),
        "k": ("constant", "hold.y_start: y holds it before the first tick"),
        "x0": ("fixed", "sum.y_start: it is a start value"),
        "at": ("fixed", "step.at: event times depend on it"),
        "free": ("tunable", ""),
        "den": ("tunable", ""),
        "gain": ("constant", "tf.num: which elements are 0 fixes the type of the block"),
    }
    assert b["gain2.k"].variability == "tunable"  # it can change, with free
    assert b["gain3.k"].variability == "fixed"
    assert (b["delay.delay"].variability, b["delay.delay"].why) == ("fixed", "a delay depends on it")
    assert (b["delay.delay"].low, b["delay.delay"].low_open) == (1e-15, False)
    assert (b["delay.y_before"].variability, b["delay.y_before"].why) == ("fixed", "past holds it before the start")


def test_what_a_function_makes_a_delay_from_is_constant() -> None:
    class Twice(Block):
        """y(t) = u(t - 2 half)."""

        half = Parameter(1.0, unit="s", positive=True)
        u = Input()
        past = History(u, delay=lambda half: 2 * half)

        @output
        def y(past: Any) -> Any:
            return past

    d = Diagram("twice")
    d.wire(d.add("twice", Twice()).u, d.input("u"))
    flat = d.flatten()
    setting = next(one for one in bindings(flat, plan(flat)) if one.path == "twice.half")
    assert (setting.variability, setting.low, setting.low_open) == ("constant", 0.0, True)


def test_what_only_constants_make_is_constant() -> None:
    b = bound(
        parameters={"two": "=2", "turn": "=two*pi"},
        inputs={"u": {}},
        blocks={"g": {"type": "Gain", "parameters": {"k": "=turn"}}},
        wires={"g.u": "u"},
    )
    assert_sound(b)
    assert {setting.variability for setting in b.settings} == {"constant"}
    assert b["g.k"].why == "its value is computed from parameters that cannot be set"
    assert b["two"].elements == ((TapeNode("constant", (), 2.0),),)


def test_measures_keep_what_they_read_from_changing_in_a_run() -> None:
    b = bound(
        parameters={"goal": 1.0, "end": 2.0},
        blocks={"c": {"type": "Constant", "parameters": {"value": "=goal"}}},
        measures={"e": {"type": "IAE", "of": "c.y", "against": "=goal", "to": "=end"}},
    )
    assert [(b[name].variability, b[name].why) for name in ("goal", "end")] == [
        ("fixed", "the measure e depends on it")
    ] * 2


def test_the_ticks_of_a_triggered_subdiagram_are_constant_and_hidden_blocks_have_no_settings() -> None:
    gain = {"gain": {"type": "Gain", "parameters": {"k": "=double"}}}
    inner = INNER | {"blocks": gain, "outputs": {"y": "gain.y"}, "wires": {"gain.u": "u"}}
    b = bound(
        parameters={"Ts": 0.1, "shift": 0.05, "K": 3.0},
        inputs={"u": {}},
        blocks={
            "part": {"diagram": inner, "trigger": {"every": "=2*Ts", "offset": "=shift"}, "parameters": {"Kp": "=K"}}
        },
        wires={"part.u": "u"},
    )
    assert_sound(b)
    assert assert_follows(b) >= 1
    assert any(instance.hidden for instance in b.plan.instances)
    assert [b[name].why for name in ("Ts", "shift")] == ["the ticks of part depend on it"] * 2
    assert b["K"].variability == "tunable"
    assert {setting.path for setting in b.settings if "." in setting.path} == {
        *("part.Kp", "part.T", "part.double", "part.gain.k", "part.gain.unit", "part.gain.unit_u"),
    }


# --- C ---------------------------------------------------------------------------------------------------------

WORDS = {
    "sum": "a + b - 3",
    "ratio": "a/b/3*2 - -a",
    "power": "a**b + a**2 + 2**-b",
    "roots": "sqrt(a) + abs(-b) - abs(b)",
    "least": "min(a, b, 2.5)*max(a, b, 2.5, a*b)",
    "angles": "sin(a) + cos(b)*tan(a) - asin(b/10) + acos(b/10)/atan(a) + atan2(a, -b)",
    "growth": "exp(-a) + log(b) + tanh(a)*exp(b)",
    "folded": "sin(0.5)*a + 3**0.3 + exp(1.1)*log(7)",
    "mixed": "(sum*ratio + power)/(roots - least) + angles*growth",
}


@cache
def functions() -> Bound:
    return bound(
        parameters={"a": 1.7, "b": 0.4, **{name: f"={text}" for name, text in WORDS.items()}},
        inputs={"u": {}},
        blocks={f"g_{name}": {"type": "Gain", "parameters": {"k": f"={name}"}} for name in WORDS},
        wires={f"g_{name}.u": "u" for name in WORDS},
    )


@cache
def large() -> Bound:
    """Many blocks alike, so that loops over tables compute them, and some that differ."""
    blocks: dict[str, Any] = {}
    wires: dict[str, str] = {}
    for n in range(60):
        blocks[f"pid{n}"] = {"type": "PID", "parameters": {"kp": f"=K*{n + 1}.5", "ki": f"=K/{n + 2}", "kd": 0.1 + n}}
        wires |= {f"pid{n}.r": "u", f"pid{n}.y": "u", f"g{n}.u": "u", f"f{n}.u": "u"}
        blocks[f"g{n}"] = {"type": "Gain", "parameters": {"k": "=K" if n % 2 else "=K" + "+K" * n}}
        blocks[f"f{n}"] = {"type": "Gain", "parameters": {"k": f"=K**{n % 5} + sin({n}*K)"}}
    return bound(parameters={"K": 1.25}, inputs={"u": {}}, blocks=blocks, wires=wires)


def test_every_function_of_expressions_is_computed_as_flattening_computes_it() -> None:
    ops = {node.op for x in functions().settings for program in x.elements or () for node in program}
    assert ops >= {"add", "sub", "mul", "div", "pow", "neg", "fabs", "min", "max", "sqrt", "exp", "log", "sin", "cos"}
    assert ops >= {"tan", "asin", "acos", "atan", "atan2", "tanh"}
    assert_sound(functions())
    for seed in range(50):
        rng = random.Random(seed)
        leaves = {"a": [rng.uniform(0.1, 5.0)], "b": [rng.uniform(0.1, 5.0)]}
        assert bits(functions().parameters(leaves)) == bits(functions().anew(leaves))


def test_what_settings_are_computed_by_is_derived_as_equations_are() -> None:
    b = functions()
    places = [b["a"].first, b["b"].first]
    for name in WORDS.keys() - {"mixed"}:
        (program,) = b[name].elements or ()
        nodes, at = [TapeNode("argument", (), float(k)) for k in range(2)], []
        for node in program:
            at.append(places.index(int(node.value)) if node.op == "argument" else len(nodes))
            if node.op != "argument":
                nodes.append(TapeNode(node.op, tuple(at[k] for k in node.operands), node.value))
        partials, (result, *derivatives) = derived(nodes, 2, [at[-1]], [0, 1])
        x = [1.7, 0.4]
        assert evaluated(partials[: result + 1], x) == evaluated(program, b.s)
        for k, place in enumerate(derivatives):
            high, low = ({places[i]: x[i] + step * (i == k) for i in range(2)} for step in (1e-6, -1e-6))
            quotient = (evaluated(program, high) - evaluated(program, low)) / 2e-6
            assert evaluated(partials[: place + 1], x) == pytest.approx(quotient, rel=1e-7, abs=1e-7), name


def compiled(folder: Path, made_: Sequence[Bound], *flags: str) -> list[Any]:
    """The functions of diagrams, by the compiler of the system."""
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("there is no gcc")
    source = "#include <math.h>\n\n"
    for n, b in enumerate(made_):
        source += bindings_c(b.settings, f"bind{n}")
        source += f"\nvoid call{n}(double *s, double *p);\nvoid call{n}(double *s, double *p) {{ bind{n}(s, p); }}\n\n"
    (folder / "bind.c").write_text(source, encoding="utf-8")
    command = [
        gcc,
        "-std=c11",
        "-Wall",
        "-Wextra",
        "-Werror",
        *flags,
        "-shared",
        "-fPIC",
        "bind.c",
        "-o",
        "bind.so",
        "-lm",
    ]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    library = ctypes.CDLL(str(folder / "bind.so"))
    return [getattr(library, f"call{n}") for n in range(len(made_))]


@pytest.mark.parametrize("flags", [("-O2", "-ffp-contract=off"), ("-O0",), ("-O3",)], ids=" ".join)
def test_c_computes_the_same_bits(tmp_path: Path, flags: tuple[str, ...]) -> None:
    made_ = [*map(of_file, DIAGRAMS), functions(), large(), of_block("Derived", {}), of_block("PID", {"kd": 0.1})]
    for b, call in zip(made_, compiled(tmp_path, made_, *flags), strict=True):
        for seed in range(5):
            rng, s = random.Random(seed), list(b.s)
            for setting in settable(b.settings) if seed else ():
                s[setting.first : setting.first + len(setting.values)] = others(setting, rng)
            expected = computed(b.settings, s)
            row = (ctypes.c_double * len(s))(*s)
            p = (ctypes.c_double * len(b.plan.parameters))(*b.plan.parameters)
            call(row, p)
            finite = [i for i, x in enumerate(expected) if math.isfinite(x)]
            assert bits(row[i] for i in finite) == bits(expected[i] for i in finite)
            assert not any(math.isfinite(row[i]) for i in set(range(len(s))) - set(finite))
            places = placed(b.settings, list(row), b.plan.parameters)
            assert list(p) == pytest.approx(places, abs=0.0, rel=0.0, nan_ok=True)


def test_a_large_diagram_is_a_short_text_of_loops() -> None:
    text = bindings_c(large().settings, "bind_large")
    loops = re.findall(r"for \(unsigned k = 0; k < (\d+)u; k\+\+\)", text)
    assert sum(map(int, loops)) > 60 * 6
    assert "static void bind_large(double *s, double *p)\n{" in text
    assert text.count("\n") < 2000


def test_a_diagram_without_parameters_gives_an_empty_function(tmp_path: Path) -> None:
    b = bound(inputs={"u": {}}, blocks={"m": {"type": "Mux"}}, wires={"m.u1": "u", "m.u2": "u"})
    (call,) = compiled(tmp_path, [b], "-O2")
    call((ctypes.c_double * 1)(), (ctypes.c_double * 1)())
