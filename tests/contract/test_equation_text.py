"""The text of equations says what they compute, however they are written and by whatever tape they were kept."""

import math
import os
import random
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import BouncingBall
from blocks.contract.equation_text import digest_of, equation_texts, sha256
from blocks.contract.interface import Value
from blocks.contract.resolution import resolve
from blocks.contract.table_lookup import pick, search
from blocks.contract.tape import Tape, TapeNode
from blocks.contract.tracing import trace
from tests.support.library_variants import VARIANTS, resolved
from tests.support.on_numbers import numeric
from tests.support.places import ROOT

HEAD = """
import numpy as np
from blocks import Block, Discrete, Input, Parameter, State, crossing, event_time, local, output
"""

MEANINGS = {
    "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b, "div": np.divide,
    "neg": lambda a: -a, "pow": np.power, "fabs": abs, "fmin": np.minimum, "fmax": np.maximum,
    "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2, "asinh": np.arcsinh,
    "acosh": np.arccosh, "atanh": np.arctanh, "lt": lambda a, b: a < b, "le": lambda a, b: a <= b,
    "eq": lambda a, b: a == b, "ne": lambda a, b: a != b, "and": np.logical_and, "or": np.logical_or,
    "not": np.logical_not, "choose": lambda c, a, b: a if c else b, "search": lambda x, table: search(table, x),
    "pick": lambda index, table: pick(table, index),
}  # fmt: skip
KINDS = frozenset({
    *("time", "tick", "parameter", "table", "input", "state", "discrete", "algebraic", "history", "output", "held"),
    "side",
})  # fmt: skip


def texts_of(cls: Any, **given: Any) -> Mapping[str, str]:
    return equation_texts(trace(resolve(cls, {name: Value(value) for name, value in given.items()}).interface))


def written(body: str, name: str = "Mine", head: str = "") -> Any:
    """A block class from its text."""
    names: dict[str, Any] = {"__name__": "written"}
    exec(compile(HEAD + head + body, "written.py", "exec"), names)
    return names[name]


def digest(body: str, head: str = "", **given: Any) -> str:
    return digest_of({heading: sha256(text) for heading, text in texts_of(written(body, head=head), **given).items()})


def test_the_text_is_the_one_that_the_documentation_shows() -> None:
    page = (ROOT / "docs" / "semantics.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"```text\n(reset v by impact\n.*?)\n```", page, re.S)
    heading, text = shown.split("\n", 1)
    assert texts_of(BouncingBall)[heading] == text


def test_a_text_is_what_one_would_write_by_hand() -> None:
    cls = written("""
class Mine(Block):
    n = Parameter(2, structural=True, type="int")
    k = Parameter([2.0, 3.0], shape="m")
    u = Input(shape=lambda n: n)
    x = State(shape=lambda n: n)
    count = Discrete(0, type="int")

    @x.derivative
    def dx(x, u, k):
        return k * (u - x) + 0.1

    @crossing(direction="up", start=False)
    def high(x):
        return x[0] - 1

    @count.next(every=0.5)
    def counted(count):
        return count + 1

    @output
    def y(x, high, t, n):
        return np.where(high, x[1], n * np.sin(t))
""")
    assert dict(texts_of(cls)) == {
        "crossing high": "crossing up from false\n0 state x 0\n1 constant 0x1.0000000000000p+0\n2 sub 0 1\ngives 2",
        "derivative x": "state real 2\n0 parameter k 0\n1 input u 0\n2 state x 0\n3 sub 1 2\n4 mul 0 3\n"
        "5 constant 0x1.999999999999ap-4\n6 add 4 5\n7 parameter k 1\n8 input u 1\n9 state x 1\n10 sub 8 9\n"
        "11 mul 7 10\n12 add 11 5\ngives 6 12",
        "input u": "input real 2",
        "next count": "discrete int scalar at ticks\n0 discrete count 0\n1 constant 0x1.0000000000000p+0\n2 add 0 1\n"
        "gives 2",
        "output y": "output real scalar\n0 side high 0\n1 state x 1\n2 constant 0x1.0000000000000p+1\n3 time t 0\n"
        "4 sin 3\n5 mul 2 4\n6 choose 0 1 5\ngives 6",
    }  # fmt: skip


@pytest.mark.parametrize(("name", "given_"), VARIANTS, ids=[f"{name}-{k}" for k, (name, _) in enumerate(VARIANTS)])
def test_what_a_text_says_is_what_the_functions_of_the_block_compute(name: str, given_: dict[str, Any]) -> None:
    """An interpreter of the text, on numbers, against the equations run as they stand in Python."""
    made = resolved(name, given_)
    interface, d = made.interface, made.interface.declaration
    generator = np.random.default_rng(7)
    values: dict[str, Any] = {"t": 0.7, "tick": 3.0}
    for key, variable in d.readable.items():
        if key in interface.structural or getattr(variable, "wiring", False) or key in d.locals:
            continue
        if key in d.parameters:
            if made.values[key].value is not None:
                values[key] = np.asarray(made.values[key].value, dtype=float)
        elif variable.type == "bool":
            values[key] = np.full(interface.shape(variable), True)
        else:
            values[key] = generator.uniform(0.1, 0.9, interface.shape(variable))
            values[key] = np.round(values[key]) if variable.type == "int" else values[key]
    with np.errstate(all="ignore"):
        expected = numeric(interface, values)
        texts = equation_texts(trace(interface))
        for key, numbers in expected.items():
            role, _, rest = key.partition(":")
            if role == "local":
                continue
            heading = f"{role} {rest.replace(':', ' by ')}"
            assert said(texts[heading], values) == pytest.approx(numbers, rel=1e-12, abs=1e-12, nan_ok=True), heading


def said(text: str, values: Mapping[str, Any]) -> list[float]:
    made: list[Any] = []
    for line in text.splitlines():
        first, *words = line.split()
        if first == "gives":
            return [float(made[int(word)]) for word in words]
        if not first.isdigit():
            continue
        assert int(first) == len(made), "lines are numbered in their order"
        op, *rest = words
        if op in KINDS:
            number = np.ravel(values[rest[0]])
            made.append(number if op == "table" else np.float64(number[int(rest[1])]))
        elif op == "constant":
            made.append(np.float64(float.fromhex(rest[0])))
        else:
            operands = [made[int(word)] for word in rest]
            made.append((MEANINGS[op] if op in MEANINGS else vars(np)[op])(*operands))
    raise AssertionError("a text ends with what it gives")


def test_another_tape_of_the_same_equations_has_the_same_text() -> None:
    """Its nodes in another order, equal ones twice, with some that nobody needs; its arguments in another order."""
    for name, given_ in VARIANTS:
        tape = trace(resolved(name, given_).interface)
        if tape.nodes:
            assert equation_texts(shuffled(tape)) == equation_texts(tape), name


def shuffled(tape: Tape) -> Tape:
    rng = random.Random(3)
    order = rng.sample(range(len(tape.arguments)), len(tape.arguments))
    at = {old: new for new, old in enumerate(order)}
    pending = [copy for index in range(len(tape.nodes)) for copy in ((index, 0), (index, 1))]
    made: list[TapeNode] = [TapeNode("constant", (), 77.0)]
    place: dict[tuple[int, int], int] = {}
    while pending:
        ready = [
            one for one in pending if all((k, 0) in place and (k, 1) in place for k in tape.nodes[one[0]].operands)
        ]
        index, copy = rng.choice(ready)
        pending.remove((index, copy))
        node = tape.nodes[index]
        value = float(at[int(node.value)]) if node.op == "argument" else node.value
        operands = tuple(place[k, rng.randrange(2)] for k in node.operands)
        place[index, copy] = len(made)
        made.append(TapeNode(node.op, operands, value))
    results = {
        key: replace(result, nodes=tuple(place[n, rng.randrange(2)] for n in result.nodes))
        for key, result in tape.results.items()
    }
    return Tape(tape.interface, tuple(tape.arguments[k] for k in order), tuple(made), results)


PLAIN = """
class Mine(Block):
    k = Parameter(2.0)
    u = Input()
    x = State()

    @x.derivative
    def dx(x, u, k):
        return -2 * x + np.sin(k * u)

    @output
    def y(x):
        return x
"""

ALIKE = {
    "comments, layout, documentation": '''
class Mine(Block):
    """What it is."""
    k = Parameter(  2.0, unit="1/s", doc="gain")  # the gain
    u = Input(unit="m", doc="in")


    x = State(doc="memory", unit="m")
    @x.derivative
    def dx(x, u, k):
        # here
        return (-2
                * x + np.sin(k * u))
    @output(doc="out", unit="m")
    def y(x): return x
''',
    "other names in Python, another order": """
class Mine(Block):
    x = State()
    u = Input()

    @output
    def y(x):
        return x

    k = Parameter(3.0, min=0.0)

    @x.derivative
    def anything(k, u, x):
        inner = np.sin(k * u)
        outer = -2 * x
        return outer + inner
""",
    "a helper, a local, a constant outside": """
RATE = -2

def bent(value):
    return np.sin(value)

class Mine(Block):
    k = Parameter(2.0)
    u = Input()
    x = State()

    @local
    def part(k, u):
        return bent(k * u)

    @x.derivative
    def dx(x, part):
        return RATE * x + part

    @output
    def y(x):
        return x
""",
}


@pytest.mark.parametrize("body", ALIKE.values(), ids=ALIKE)
def test_how_equations_are_written_is_not_in_their_digest(body: str) -> None:
    assert digest(body) == digest(PLAIN)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("-2 * x", "-3 * x"), ("-2 * x", "-x"), ("-2 * x", "-2.0000000000000004 * x"), ("k * u", "u"),
        ("np.sin", "np.cos"), ("u = Input()", "u = Input(type='bool')"), ("def y", "def z"),
        ("return x\n", "return x + 0 * u if False else 1.0 * x + 1.0\n"), ("x = State()", "x = State(shape=2)"),
    ],
)  # fmt: skip
def test_what_is_computed_is_in_the_digest(old: str, new: str) -> None:
    assert old in PLAIN
    body = PLAIN.replace(old, new).replace("def y(x)", "def y(x, u)" if "u if" in new else "def y(x)")
    if "shape" in new:
        body = body.replace("    def y(x):\n        return x", "    def y(x):\n        return x[0]")
    assert digest(body) != digest(PLAIN)


EVENTS = """
class Mine(Block):
    x = State()
    n = Discrete(0.0)

    @x.derivative
    def dx():
        return 1.0

    @crossing(direction="up")
    def a(x):
        return x - 1

    @crossing(direction="up")
    def b(x):
        return x - 2

    @a.reset(n)
    def first(n):
        return n + 1

    @b.reset(n)
    def second(n):
        return n + 10
"""


def test_directions_sides_and_the_order_of_resets_are_in_the_digest() -> None:
    first, second = re.findall(r"    @[ab]\.reset.*?return n \+ \d+\n", EVENTS, re.S)
    swapped = EVENTS.replace(first, "@@").replace(second, first).replace("@@", second)
    down = EVENTS.replace('direction="up"', 'direction="down"', 1)
    begun = EVENTS.replace('direction="up"', 'direction="up", start=True', 1)
    again = EVENTS.replace("def a(x):\n        return x - 1", "def a(x):\n        return x - 1  # so").replace(
        "    x = State()\n    n = Discrete(0.0)", "    n = Discrete(0.0)\n    x = State()"
    )
    assert len({digest(body) for body in (EVENTS, swapped, down, begun)}) == 4
    assert digest(again) == digest(EVENTS)


def test_ticks_and_what_happens_after_steps_are_told_apart() -> None:
    ticks = """
class Mine(Block):
    n = Discrete()
    @n.next(every=EVERY)
    def counted(n):
        return n + 1
"""
    assert digest(ticks.replace("EVERY", "0.1")) != digest(ticks.replace("EVERY", '"step"'))


def test_zeros_have_no_sign_and_numbers_are_exact() -> None:
    law = "\nclass Mine(Block):\n    @output\n    def y(t):\n        return np.where(t > 1, VALUE, 1.0)\n"
    assert digest(law.replace("VALUE", "-0.0")) == digest(law.replace("VALUE", "0.0"))
    assert digest(law.replace("VALUE", "0.1")) != digest(law.replace("VALUE", repr(math.nextafter(0.1, 1))))


def test_a_structural_value_counts_by_what_follows_from_it() -> None:
    law = """
class Mine(Block):
    signs = Parameter("+-", structural=True, type="string")
    name_of_it = Parameter("V", structural=True, type="string")
    u = Input()
    @output
    def y(u, signs, name_of_it):
        return u if signs[0] == "+" else -u
"""
    assert digest(law, signs="+") == digest(law) == digest(law, name_of_it="A")
    assert digest(law, signs="-") != digest(law)


def test_another_process_with_other_hashes_and_another_folder_has_the_same_digests(tmp_path: Path) -> None:
    code = (
        "import sys; sys.path[:0] = [{root!r}, {folder!r}]\n"
        "import mine; from blocks.contract.equation_text import *; from blocks.contract.tracing import trace\n"
        "from blocks.contract.resolution import resolve\n"
        "texts = equation_texts(trace(resolve(mine.Mine, {{}}).interface))\n"
        "print(digest_of({{heading: sha256(text) for heading, text in texts.items()}}))"
    )
    found = set()
    for seed, folder in (("1", tmp_path / "a"), ("77", tmp_path / "b" / "c")):
        folder.mkdir(parents=True)
        (folder / "mine.py").write_text(HEAD + PLAIN)
        ran = subprocess.run(
            [sys.executable, "-X", "utf8", "-c", code.format(root=str(ROOT), folder=str(folder))],
            env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, text=True, check=True,
        )  # fmt: skip
        found.add(ran.stdout.strip())
    assert found == {digest(PLAIN)}


PROGRAM = """
LIMIT = 3.0

class Averager:
    def __init__(self, gain):
        self.gain = gain

    def step(self, t, u):
        return limited(self.gain * u)

def limited(value):
    return min(value, LIMIT)
"""
STEPPER = """
from blocks import Block, Input, Parameter, Stepped, stepper

class Mine(Block):
    u = Input()
    y = Stepped()

    @stepper(every=0.1)
    def program():
        return Averager(2.0)
"""


def test_a_program_counts_by_its_text_and_that_of_what_it_names(tmp_path: Path) -> None:
    import importlib.util

    count = 0

    def told(text: str) -> str:
        nonlocal count
        count += 1
        path = tmp_path / f"program_{count}.py"
        path.write_text(text + STEPPER)
        spec = importlib.util.spec_from_file_location(path.stem, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[path.stem] = module
        try:
            spec.loader.exec_module(module)
            return texts_of(module.Mine)["program program"]
        finally:
            del sys.modules[path.stem]

    plain = told(PROGRAM)
    assert plain == told(PROGRAM.replace("def step", "# how it goes on\n\n    def step") + "\nOTHER = 4.0\n")
    for old, new in (("LIMIT = 3.0", "LIMIT = 4.0"), ("min(", "max("), ("self.gain * u", "self.gain + u")):
        assert told(PROGRAM.replace(old, new)) != plain, new
