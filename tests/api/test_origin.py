"""The origin of a run: the diagram's fingerprint, versions, settings, parameters and inputs."""

from __future__ import annotations

import hashlib
import json
import platform
import struct
from fractions import Fraction
from pathlib import Path

import numpy as np

from blocks import Diagram, __version__
from blocks.api.origin import origin_of
from blocks.model.fingerprint import fingerprint

PART = {
    "format": "blocks-diagram",
    "version": 3,
    "name": "part",
    "parameters": {"k": 2},
    "inputs": {"u": {}},
    "outputs": {"y": "gain.y"},
    "blocks": {"gain": {"type": "Gain", "parameters": {"k": "=k"}}},
    "wires": {"gain.u": "u"},
}
WHOLE = {
    "format": "blocks-diagram",
    "version": 3,
    "name": "whole",
    "inputs": {"r": {"default": 1}},
    "blocks": {"part": {"diagram": "part.json", "parameters": {"k": 3}}},
    "wires": {"part.u": "r"},
    "run": {"stop": 1},
}


def test_an_origin_has_versions_settings_parameters_and_inputs(tmp_path: Path) -> None:
    for document in (PART, WHOLE):
        (tmp_path / f"{document['name']}.json").write_text(json.dumps(document), encoding="utf-8")
    diagram = Diagram.load(tmp_path / "whole.json")
    table = tmp_path / "r.csv"
    table.write_text("time,r\n0,1\n", encoding="utf-8")
    long = np.arange(1000.0)
    given = {"part.k": np.float64(0.5), "text": "=k", "list": [1, True, Fraction(1, 4)]}
    settings = diagram.plan(method="rk4", step=0.1, every=0.5, stops=[0.25]).settings
    fed = [str(table), {"r": {"value": 1, "unit": "m"}, "short": ([0, 1], (2.0, 3)), "long": (long, long)}, {}]
    made = origin_of(diagram.value, settings, parameters=given, inputs=fed, interpolation="hold")
    assert made.sha256 == fingerprint(diagram.value)
    versions = {"blocks": __version__, "python": platform.python_version(), "numpy": np.__version__}
    assert made.versions == versions
    assert made.settings == {
        "start": 0.0, "stop": 1.0, "method": "rk4", "step": 0.1, "every": 0.5, "stops": [0.25],
        "interpolation": "hold",
    }  # fmt: skip
    assert made.parameters == {"part.k": 0.5, "text": "=k", "list": [1, True, 0.25]}
    of_long = {"sha256": hashlib.sha256(struct.pack("<1000d", *range(1000))).hexdigest()}
    assert made.inputs == {
        "r.csv": {"sha256": hashlib.sha256(table.read_bytes()).hexdigest()},
        "r": {"value": 1, "unit": "m"},
        "short": [[0, 1], [2.0, 3]],
        "long": [of_long, of_long],
    }
    assert json.loads(json.dumps(made.parameters)) == made.parameters
    assert json.loads(json.dumps(made.inputs)) == made.inputs


def test_an_adaptive_run_tells_its_tolerances() -> None:
    diagram = Diagram("bare")
    made = origin_of(diagram.value, diagram.plan(stop=2).settings, inputs=None)
    assert made.settings == {"start": 0.0, "stop": 2.0, "method": "dopri5", "rtol": 1e-6, "atol": 1e-9}
    assert (made.parameters, made.inputs) == ({}, {})
