"""Diagram documents: small ones, the shipped ones, random ones and their mutations."""

import json
import random
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from tests.support.places import ROOT

FOLDER = ROOT / "diagrams"
SHIPPED = sorted(path for path in FOLDER.rglob("*.json") if '"blocks-diagram"' in path.read_text(encoding="utf-8"))
ALIKE = (
    "adrc/adrc_1", "adrc/adrc_2", "adrc/mass_position", "analysis/leso_pd", "analysis/smeso_gains_pd", "paper/adrc",
    "paper/control_adrc", "paper/wheel_adrc",
)  # fmt: skip
"""Those that are built of the same blocks as others: what takes long is looked at there, here by `make test-long`."""


def is_unlike(path: Path) -> bool:
    """Whether a diagram is built as no other one is.

    Those of the gallery and of published works (adrc/WORK) are built of what other tests look at.
    """
    place = path.relative_to(FOLDER)
    return place.parts[0] != "gallery" and len(place.parts) < 3 and place.with_suffix("").as_posix() not in ALIKE


def span(path: Path, most: float) -> float:
    """A time for a run of a diagram, at most what its file says: some tick 200,000 times a second."""
    stop = json.loads(path.read_text(encoding="utf-8")).get("run", {}).get("stop", most)
    return min(most, stop) if isinstance(stop, (int, float)) else most


def document(**sections: Any) -> dict[str, Any]:
    return {"format": "blocks-diagram", "version": 3, "name": "d", **sections}


NESTED = """\
{
 "format": "blocks-diagram",
 "version": 3,
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
SQUARE = {"inputs": {"u": {}}, "outputs": {"y": "p.y"}, "blocks": {"p": {"type": "Power"}}, "wires": {"p.u": "u"}}
# Every key of a diagram and of a study stands in these.
CONTROLLED = {
    "$schema": "diagram-3.schema.json",
    "format": "blocks-diagram",
    "version": 3,
    "name": "all",
    "doc": ["one", "two"],
    "parameters": {"k": {"value": 2, "unit": "V", "doc": "gain", "x-a": 1}, "flags": [True], "rows": [[1], ["=k"]]},
    "inputs": {
        "r": {"unit": "V", "default": [1, 2], "size": 2, "type": "real", "doc": "x"},
        "mode": {"type": {"enum": "Mode", "members": {"off": 0, "on, at last": -3}, "x-a": 1}, "default": "off"},
        "go": {"type": "bool", "default": True, "unit": ""},
        "count": {"type": "int", "default": 3},
    },
    "outputs": {"y": "sine.y"},
    "blocks": {
        "sine": {"type": "Sine", "doc": "s", "parameters": {"amplitude": {"value": 2, "unit": ""}, "omega": "=1/2"}},
        "noise": {"type": "Noise", "stream": "/a.wind"},
        "lags": {"copies": "=k", "type": "FirstOrder", "parameters": {"T": [1, "=1+index"], "y_start": "=index"}},
        "on": {"type": "CompareToConstant", "parameters": {"operator": ">", "constant": 0.5}},
        "sum": {
            "diagram": {
                "name": "inner",
                "inputs": {"u": {}},
                "outputs": {"y": "x.y"},
                "blocks": {"x": {"type": "Integrator"}},
                "wires": {"x.u": "u"},
                "layout": {"x": [1, 2]},
            },
            "enable": {"states": "held", "outputs": "reset"},
        },
        "ticks": {
            "diagram": SQUARE,
            "trigger": {"every": {"value": 100, "unit": "ms"}, "offset": "=0.1/2"},
        },
        "edges": {
            "diagram": SQUARE,
            "trigger": {"direction": "up"},
        },
        "plant": {
            "type": "SecondOrder",
            "variant": "rough",
            "variants": {
                "rough": {"type": "FirstOrder", "parameters": {"T": 2}, "ports": {"u": "u"}},
                "none": {"type": "Gain", "x-a": 1},
            },
            "x-a": None,
        },
    },
    "wires": {"on.u": "sine.y", "sum.u": "sine.y", "sum.enable": "on.y", "ticks.u": "sine.y", "edges.u": "sine.y",
              "edges.trigger": "sine.y", "plant.u": "sine.y", "lags.u": "sine.y"},
    "run": {
        "start": 0, "stop": {"value": 1, "unit": "min"}, "stop_when": "t > 1e9",
        "method": "rk4", "step": 0.1, "rtol": 1e-5, "atol": 1e-6,
        "every": {"value": 200, "unit": "ms", "doc": "grid"}, "jumps": False,
        "stops": [1, {"value": 1, "unit": "s"}], "loops": "solve",
        "seed": 7,
        "inputs": {"r": {"t": [0, 1], "u": [[0, 1], [1, 2]], "interpolation": "hold", "unit": "V", "x-a": 1},
                   "go": False, "mode": {"t": [0, 1], "u": ["off", "on, at last"]}},
        "log": ["sine", "y"], "doc": "d", "x-a": 1,
        "master": {"step": 0.1, "steps": {"sine": {"value": 1, "unit": "s"}}, "algorithm": "iterated", "order": 2,
                   "tolerance": 1e-3, "couple": "together", "iterations": 5},
    },
    "measures": {
        "m": {"type": "settling_time", "of": "plant.y", "against": "sine.y", "from": 0,
              "to": {"value": 1, "unit": "min"}, "band": 0.05, "doc": "d"},
        "n": {"type": "peak", "of": "plant.y", "against": "=1+1", "to": "=2*3"},
    },
    "layout": {"sine": [1, 2.5]},
    "x-own": {"a": [None]},
}  # fmt: skip
STUDY = {
    "$schema": "study-1.schema.json",
    "format": "blocks-study",
    "version": 1,
    "name": "a",
    "title": "t",
    "doc": ["d"],
    "source": "s",
    "runs": {
        "a": {
            "diagram": "d.json",
            "parameters": {"k": 1, "m.T": {"value": 2, "unit": "s"}},
            "variants": {"m": "fmu"},
            "settings": {"rtol": 1e-5, "method": "rk4", "step": 0.1, "inputs": {"u": {"t": [0, 1], "u": [1, 2]}}},
            "doc": "x",
        },
        "b": {"diagram": "d.json"},
    },
    "sweeps": {
        "c": {
            "diagram": "d.json", "parameters": {"k": 1}, "variants": {"m": "fmu"}, "settings": {"rtol": 1e-5},
            "doc": "x",
            "vary": {"a": [1, {"value": 2, "unit": "s"}], "b*.k": {"normal": [0, 1]}, "each(p)": {"lognorm": {"s": 1}}},
            "n": 10, "sampler": "sobol", "seed": 1, "measures": ["m"], "log": ["s"], "max_steps": 100, "lanes": "fast",
            "scenarios": {"q": {}, "h": {"k": 2}},
            "margins": {
                "gm": {"type": "gain_margin", "loop": "u", "openings": ["v"], "amplitude": {"e": 0.1}, "at": 1,
                       "pade": 2, "sigma": {"e": {"value": 1, "unit": "V"}}, "overrides": {"q": 1}, "inputs": {"r": 1}},
                "bw": {"type": "bandwidth", "from": "r", "to": "y"},
            },
        },
    },
    "tunings": {
        "d": {
            "diagram": "d.json", "parameters": {"k": 1}, "variants": {"m": "fmu"}, "settings": {"rtol": 1e-5},
            "doc": "x", "minimize": "q.m + 2*m", "over": {"a": [1, 2], "b*.k": [0, 1e3]}, "subject_to": ["m <= 3"],
            "scenarios": {"q": {}, "h": {"k": 2}}, "optimizer": "de", "budget": 40, "search_seed": 2,
        },
    },
    "assumed": [{"what": "w", "why": "y", "contradicts": "c"}],
    "claims": [
        {"run": "a", "measure": "m", "published": 1.5, "unit": "V", "source": "t", "tolerance": 0.1,
         "expect": "not reproduced", "reason": "r"},
        {"runs": ["a", "b"], "as": "increase", "measure": "m"},
        {"run": "b", "measure": "m", "x-a": 1},
        {"tuning": "d", "measure": "objective", "as": "reduction", "at_least": 50, "expect": "holds"},
        {"tuning": "d", "measure": "q.m"},
        {"sweep": "c", "scenario": "q", "measure": "m", "share": 0.9, "at_most": 1, "expect": "holds"},
        {"sweep": "c", "measure": "gm", "quantile": 0, "at_least": 1, "expect": "fails", "reason": "r"},
        {"sweep": "c", "measure": "m", "statistic": "mean", "published": 1, "tolerance": 0.1, "expect": "reproduced"},
    ],
    "figures": [
        {
            "name": "f", "title": "t", "doc": "d", "kind": "time", "from": 0, "to": 1, "xlabel": "x",
            "format": "svg", "size": [6, 4],
            "windows": [[0, 0.5], [0.5, 1]],
            "panels": [
                {
                    "lines": [{"run": "a", "signal": "s", "label": "l", "style": None, "scale": 2}], "ylabel": "y",
                    "markers": [{"x": 1, "y": 2, "label": "p", "style": 1}, {"run": "a", "signal": "s"}],
                    "band": [0, 1], "inset": [0, 1, 0, 1], "log": True, "height": 2, "ylim": [0, 1],
                }
            ],
        },
        {"name": "g", "title": "t", "doc": "d", "sweep": "c", "scenario": "q", "of": "m", "against": ["a", "b"],
         "kind": "heat map", "bins": 9},
    ],
}  # fmt: skip

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
