"""Diagram documents: small ones, the shipped ones, random ones and their mutations."""

import json
import random
from typing import Any

from hypothesis import strategies as st

from tests.support.places import ROOT

FOLDER = ROOT / "diagrams"
SHIPPED = sorted(path for path in FOLDER.rglob("*.json") if '"blocks-diagram"' in path.read_text(encoding="utf-8"))


def document(**sections: Any) -> dict[str, Any]:
    return {"format": "blocks-diagram", "version": 1, "name": "d", **sections}


NESTED = """\
{
 "format": "blocks-diagram",
 "version": 1,
 "name": "outer",
 "doc": "one line",
 "parameters": {
  "k": {"value": 2.50, "unit": "V", "doc": ["a", "b"]},
  "gains": [1, 2e-3, "=k"]
 },
 "inputs": {
  "r": {"unit": "V", "default": -0.0}
 },
 "outputs": {
  "y": "inner.y"
 },
 "blocks": {
  "inner": {
   "diagram": {
    "name": "own_name",
    "parameters": {
     "k": 1
    },
    "inputs": {
     "u": {}
    },
    "outputs": {
     "y": "deep.y"
    },
    "blocks": {
     "deep": {
      "diagram": {
       "inputs": {
        "u": {}
       },
       "outputs": {
        "y": "g.y"
       },
       "blocks": {
        "g": {"type": "Gain", "parameters": {"k": 1E+2}}
       },
       "wires": {
        "g.u": "u"
       },
       "layout": {
        "g": [0, 1.0]
       }
      }
     }
    },
    "wires": {
     "deep.u": "u"
    }
   },
   "doc": ["first", "second"],
   "parameters": {"k": "=k"},
   "x-own": [1, 2]
  },
  "z": {"type": "Constant"},
  "a": {"type": "Constant"}
 },
 "wires": {
  "inner.u": "r"
 },
 "run": {"stop": 1.00, "rtol": 1e-06, "log": ["a.y", "z.y"]},
 "layout": {
  "r": [0, 0],
  "a": [1, 2]
 },
 "x-note": {"kept": [true, null]}
}
"""
names = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True)
numbers = st.one_of(
    st.integers(-(2**53), 2**53), st.floats(allow_nan=False, allow_infinity=False), st.sampled_from([0, -0.0, 1e-6])
)
own = st.dictionaries(
    names.map("x-{}".format), st.recursive(st.none() | numbers | st.text(max_size=5), st.lists), max_size=1
)
docs = st.one_of(st.text(max_size=20), st.lists(st.text(max_size=9), max_size=3))
plain = st.one_of(numbers, st.text(max_size=9), st.booleans(), st.lists(numbers, max_size=3))
quantities = st.builds(
    lambda value, unit, doc, more: {"value": value, "unit": unit, "doc": doc, **more},
    plain,
    st.text(max_size=4),
    docs,
    own,
)
values = st.one_of(plain, quantities)
tables = st.dictionaries(names, values, max_size=3)


def bodies(inner: st.SearchStrategy[dict[str, Any]]) -> st.SearchStrategy[dict[str, Any]]:
    kinds = st.one_of(names.map(lambda name: {"type": name}), inner.map(lambda body: {"diagram": body}))
    blocks = st.builds(
        lambda kind, parameters, doc, more: {**kind, "doc": doc, "parameters": parameters, **more},
        kinds,
        tables,
        docs,
        own,
    )
    return st.builds(
        made,
        st.lists(names, max_size=8, unique=True),
        st.lists(blocks, max_size=4),
        st.lists(values, max_size=3),
        st.dictionaries(names, st.text(max_size=6), max_size=3),
        st.dictionaries(st.text(max_size=6), st.text(max_size=6), max_size=3),
        docs,
        own,
    )


def made(
    words: list[str],
    blocks: list[Any],
    parameters: list[Any],
    outputs: dict[str, str],
    wires: dict[str, str],
    doc: Any,
    more: dict[str, Any],
) -> dict[str, Any]:
    """A diagram's body; the words are handed out as names, since blocks, inputs and parameters share them."""
    words = [*words]
    body: dict[str, Any] = {"doc": doc, "outputs": outputs, "wires": wires, **more}
    body["parameters"] = {words.pop(): value for value in parameters[: len(words)]}
    body["blocks"] = {words.pop(): block for block in blocks[: len(words)]}
    body["layout"] = {name: [k, -0.5] for k, name in enumerate(body["blocks"])}
    body["inputs"] = {word: {"unit": "V", "default": 1.5} for word in words}
    return body


diagrams = st.recursive(bodies(st.just({})), bodies, max_leaves=4)


def mutated(source: Any, chance: random.Random) -> Any:
    """The document with one part taken out, doubled, or replaced by something else."""
    places: list[tuple[Any, Any]] = []

    def visit(node: Any) -> None:
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            places.append((node, key))
            if isinstance(value, (dict, list)):
                visit(value)

    made = json.loads(json.dumps(source))
    for _ in range(chance.randint(1, 3)):
        places.clear()
        visit(made)
        node, key = chance.choice(places)
        other, other_key = chance.choice(places)
        odd = [None, True, 0, -1, 1e308, 5e-324, "", "=", "==x", "=a+1", "=pi", "V", "t", [], [[1, 2], [3]], {}, "u[0]"]
        match chance.randint(0, 4):
            case 0:
                del node[key]
            case 1 if isinstance(node, dict):
                node[chance.choice(["x-a", "class", "t", "é", "a.b", "value", "unit", "", "\x1b"])] = node.pop(key)
            case 2:
                node[key] = json.loads(json.dumps(other[other_key]))
            case 3 if isinstance(node[key], str):
                node[key] = node[key] + chance.choice(["x", "[0]", ".y", " ", "[99]"])
            case _:
                node[key] = chance.choice(odd)
    return made
