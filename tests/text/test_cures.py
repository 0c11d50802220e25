"""What is told to be done helps: examples of explanations, changed as their cures say, run without that code.

And every error of FMUs, runs, compiled code and analyses says what to do.
"""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from pathlib import Path

import pytest

from blocks.text.explanations import EXPLAINED
from tests.support.explained_examples import GIVEN, SOURCES, run

CURES: dict[str, tuple[tuple[str, str], ...]] = {
    "E205": (("--kind ME", "--kind CS"),),
    "E211": (('fmu("plant.fmu")', 'fmu("plant.fmu", isolate=True)'),),
    "E215": (("iterated", "gauss-seidel"),),
    "E217": ((" --isolate", ""),),
    "E218": (("loop.json", "loop.json --trust downloads/plant.fmu"),),
    "W204": (('"run": {', '"run": {"loops": "solve", '),),
    "E303": (('"Sqrt"', '"Expression", "parameters": {"expression": "sqrt(max(u1, 0))"}'), ("speed.u", "speed.u1")),
    "E304": (('"off_at": 0', '"off_at": -0.1'),),
    "E305": (
        ("warm(T):\n        return T - 20", "warm(T, on):\n        return T - np.where(on, 26, 20)"),
        ("switched(T):\n        return T < 20", "switched(T, on):\n        return T < np.where(on, 26, 20)"),
    ),
    "E306": (("np.ceil(t)", "np.floor(t) + 1"),),
    "E307": (('"total.u2": "total.y"', '"total.u2": "wanted.y"'),),
    "E309": (("2 * n", "2 * n % 1000"),),
    "E310": (("1 / e", "1 / e if e else 0.0"),),
    "E311": (("1e-6", "0.01"),),
    "E312": (("friction.json", "friction.json --master step=0.001"),),
    "E601": (("CC=clang-99 ", ""),),
    "E603": (("native", "reference"),),
    "E604": (("native", "reference"),),
    "E605": (("native", "reference"),),
    "E606": (("--kind ME", "--kind CS"),),
    "E701": (("plant.y", "plant.y --amplitude sign.u=0.5"),),
    "E702": (
        ("tank.wire(level.u, inflow.y)", 'tank.wire(level.u, tank.input("u"))'),
        ("(tank)", '(tank, inputs={"u": None})'),
    ),
    "E705": (("(model)", '(model, relative="unity")'),),
    "E707": (("plant.y", "plant.y --pade 3"),),
}
"""What is replaced in an example, by code: in its text where that holds it, else in the files beside it."""


@pytest.mark.parametrize("code", CURES)
def test_the_cure_of_a_code_cures_its_example(code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    example = EXPLAINED[code].example
    text, files = example.text, dict(example.files)
    for old, new in CURES[code]:
        if old in text:
            text = text.replace(old, new)
            continue
        assert any(old in content for content in files.values())
        files = {name: content.replace(old, new) for name, content in files.items()}
    monkeypatch.chdir(tmp_path)
    if code in GIVEN:
        GIVEN[code](tmp_path, monkeypatch)
    ran = run(replace(example, text=text, files=files), monkeypatch)
    told = [line for line in ran.lines if re.match(r"\s*[EW]\d{3} ", line)]
    assert not told
    assert ran.error is None
    assert not ran.status


def test_errors_of_fmus_runs_compiled_code_and_analyses_say_what_to_do() -> None:
    without = set()
    for path in SOURCES.rglob("*.py"):
        calls = (node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call))
        for call in (call for call in calls if getattr(call.func, "id", "") == "Fault" and len(call.args) in (2, 3)):
            code = getattr(call.args[0], "value", "")
            if re.match("E[2367]", str(code)) and not any(word.arg == "cure" for word in call.keywords):
                without.add(f"{path.relative_to(SOURCES).as_posix()} {code}")
    # Of many states that do not rest, the last one has the cure.
    assert without == {"linear/limit_cycles.py E705", "linear/operating_point.py E702"}
