"""A package that is missing is reported before anything is computed."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from blocks.cli import main

DIAGRAM: dict[str, Any] = {
    "format": "blocks-diagram", "version": 3, "name": "lag",
    "blocks": {"source": {"type": "Constant"}, "lag": {"type": "FirstOrder", "parameters": {"T": 1.0}}},
    "wires": {"lag.u": "source.y"},
    "measures": {"end": {"type": "peak", "of": "lag.y"}},
    "run": {"stop": 1.0},
}  # fmt: skip
STUDY: dict[str, Any] = {
    "format": "blocks-study", "version": 1, "name": "lag",
    "runs": {"lag": {"diagram": "lag.json"}}, "claims": [],
}  # fmt: skip
TUNE = ["tune", "lag.json", "--minimize", "end", "--over", "lag.T=0.5,2"]


def computes(*_: Any, **__: Any) -> None:
    raise AssertionError("something was computed first")


@pytest.mark.parametrize(
    ("hidden", "command", "message"),
    [
        ("pyarrow", ["run", "lag.json", "--out", "x.parquet"], "E504 x.parquet: this needs the package pyarrow"),
        (
            "pyarrow",
            ["sweep", "lag.json", "--vary", "lag.T=1,2", "--out", "x.parquet"],
            "E504 x.parquet: this needs the package pyarrow",
        ),
        ("pyarrow", [*TUNE, "--out", "x.parquet"], "E504 x.parquet: this needs the package pyarrow"),
        ("cma", TUNE, 'E504 optimizer="cma": this needs the package cma'),
        (
            "distributed",
            ["sweep", "lag.json", "--vary", "lag.T=1,2", "--dask", "tcp://127.0.0.1:1"],
            "E504 --dask: this needs the package distributed",
        ),
        ("matplotlib", ["run", "lag.json", "--plot", "x.png"], "E501 matplotlib: cannot be loaded"),
        ("matplotlib", [*TUNE, "--report", "x"], "E501 matplotlib: cannot be loaded"),
        ("matplotlib", ["study", "study.json"], "E501 matplotlib: cannot be loaded"),
        ("zig", ["export", "lag.json", "-o", "x.fmu", "--platform", "aarch64-darwin"], "E605 aarch64-darwin: zig"),
    ],
)
def test_a_missing_package_is_reported_before_anything_is_computed(
    hidden: str, command: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("lag.json").write_text(json.dumps(DIAGRAM), encoding="utf-8")
    Path("study.json").write_text(json.dumps(STUDY), encoding="utf-8")
    if hidden == "zig":
        monkeypatch.setattr("blocks.compile.toolchain.platforms.find_zig", lambda: None)
        monkeypatch.setattr("blocks.compile.toolchain.platforms.find_compiler", lambda: None)
    else:
        monkeypatch.setitem(sys.modules, hidden, None)
    first = "exportable" if hidden == "zig" else "Diagram.flatten"  # which compiler is needed, a sound diagram tells
    for place in ("api.run.Prepared.of", f"api.diagram.{first}", "api.diagram.Diagram.start"):
        monkeypatch.setattr(f"blocks.{place}", computes)
    assert main(command) == 2
    err = capsys.readouterr().err
    assert err.splitlines()[-1].startswith(message), err
