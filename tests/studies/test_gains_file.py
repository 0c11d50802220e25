"""Values that a tuning or a fit has found go into the variant that was run, and nothing else of the file changes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram
from blocks.cli import main
from blocks.compile.toolchain.compiler import find_compiler
from blocks.text import json_document

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")
Variants = dict[str, str]


@pytest.fixture(autouse=True)
def native(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows run in threads by the native engine; by another one they run in processes, which start anew each time."""
    monkeypatch.setenv("BLOCKS_ENGINE", "native")


def gains(folder: Path, choice: str) -> Path:
    """A file with a gain of 2 whose variant alt has 3; `choice` is that of the file."""
    alt = {"type": "Gain", "parameters": {"k": 3}}
    gain = {"type": "Gain", "parameters": {"k": 2}, "variant": choice, "variants": {"alt": alt}}
    return saved(folder / "gains.json", {"gain": gain}, {"gain.u": "u"})


def saved(path: Path, blocks: dict[str, Any], wires: dict[str, str], source: str = "gain.y") -> Path:
    document = {
        "format": "blocks-diagram", "version": 3, "name": path.stem, "inputs": {"u": {"default": 1}},
        "blocks": blocks, "wires": wires, "outputs": {"y": source},
        "measures": {"IAE": {"type": "IAE", "of": source, "against": 5}}, "run": {"stop": 1},
    }  # fmt: skip
    path.write_text(json.dumps(document, indent=1))
    return path


def tuned(path: Path, over: str, variants: Variants) -> Any:
    return Diagram.load(path).tune(
        minimize="IAE", over={over: (4.0, 6.0)}, budget=6, optimizer="de", stop=0.1, variants=variants
    )


@pytest.mark.parametrize(
    ("of_file", "of_run", "as_copy"),
    [("base", "alt", False), ("alt", "base", False), ("alt", "alt", False), ("base", "alt", True)],
)
def test_a_tuning_writes_into_the_variant_that_was_run(tmp_path: Path, of_file: str, of_run: str, as_copy: Any) -> None:
    path = gains(tmp_path, of_file)
    if as_copy:
        diagram = Diagram.load(path).with_variants({"gain": of_run})
        tuning = diagram.tune(minimize="IAE", over={"gain.k": (4.0, 6.0)}, budget=6, optimizer="de", stop=0.1)
    else:
        tuning = tuned(path, "gain.k", {"gain": of_run})
    old = json.loads(path.read_text())
    (change,) = tuning.write(path).changes
    gain = old["blocks"]["gain"]
    assert change.old == ("2" if of_run == "base" else "3")
    (gain if of_run == "base" else gain["variants"]["alt"])["parameters"]["k"] = tuning.values["gain.k"]
    assert json.loads(path.read_text()) == old, "the choice of the file stays"
    again = Diagram.load(path).run(variants={"gain": of_run}, stop=0.1)
    assert again.measures == tuning.after["nominal"].measures


@pytest.mark.parametrize("is_nested", [False, True])
def test_a_copy_that_was_saved_without_its_variants_is_written_too(tmp_path: Path, is_nested: bool) -> None:
    path, block = gains(tmp_path, "base"), "gain"
    if is_nested:
        document = {
            key: value for key, value in json.loads(path.read_text()).items() if key not in ("format", "version")
        }
        plant = {"diagram": document, "variants": {"other": {"diagram": document}}}
        path, block = saved(tmp_path / "loop.json", {"plant": plant}, {"plant.u": "u"}, "plant.y"), "plant.gain"
    choice = {"gain": "alt"} if not is_nested else {"plant": "other", "plant.gain": "alt"}
    diagram = Diagram.load(path).with_variants(choice)
    diagram.save(tmp_path / "chosen.json")
    tuning = diagram.tune(minimize="IAE", over={f"{block}.k": (4.0, 6.0)}, budget=6, optimizer="de", stop=0.1)
    for target in (tmp_path / "chosen.json", path):
        (change,) = tuning.write(target).changes
        assert change.old == "3"


def test_a_fit_writes_into_the_variant_that_was_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, t = gains(tmp_path, "base"), np.linspace(0, 1, 11)
    data = {"time": t, "u": t, "y": 4.5 * t}
    fit = Diagram.load(path).fit(data, over={"gain.k": (1, 9)}, compare={"gain.y": "y"}, variants={"gain": "alt"})
    monkeypatch.setattr(json_document, "LARGEST_TEXT", 300)  # of texts from elsewhere; the file is larger
    (change,) = fit.write(path).changes
    assert change.old == "3"
    gain = json.loads(path.read_text())["blocks"]["gain"]
    assert (gain["parameters"]["k"], gain["variants"]["alt"]["parameters"]["k"]) == (2, pytest.approx(4.5))


@pytest.mark.parametrize(
    ("in_file", "of_file", "of_run"),
    [
        (False, "base", {"plant": "alt"}), (True, "alt", {"plant": "base"}), (True, "base", {"plant": "alt"}),
        (False, "alt", {}),
    ],
)  # fmt: skip
def test_values_inside_the_diagram_of_a_variant_are_written_there(
    tmp_path: Path, in_file: bool, of_file: str, of_run: Variants
) -> None:
    def inner(name: str, k: int) -> Any:
        path = saved(tmp_path / f"{name}.json", {"gain": {"type": "Gain", "parameters": {"k": k}}}, {"gain.u": "u"})
        body = {key: value for key, value in json.loads(path.read_text()).items() if key not in ("format", "version")}
        return path.name if in_file else body

    plant = {"diagram": inner("own", 2), "variant": of_file, "variants": {"alt": {"diagram": inner("other", 3)}}}
    path = saved(tmp_path / "loop.json", {"plant": plant}, {"plant.u": "u"}, "plant.y")
    tuning = tuned(path, "plant.gain.k", of_run)
    (change,) = tuning.write(path).changes
    ran = of_run.get("plant", of_file)
    assert change.old == ("2" if ran == "base" else "3")
    if in_file:
        assert Path(change.file).name == ("own.json" if ran == "base" else "other.json")
    assert json.loads(path.read_text())["blocks"]["plant"]["variant"] == of_file
    assert Diagram.load(path).run(variants=of_run, stop=0.1).measures == tuning.after["nominal"].measures


def test_the_command_writes_into_the_variant_that_it_ran(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = gains(tmp_path, "base")
    command = ["tune", str(path), "--minimize", "IAE", "--over", "gain.k=4,6", "--budget", "6", "--optimizer", "de"]
    assert main([*command, "--variant", "gain=alt", "--write"]) == 0
    assert "written for --variant gain=alt; the file keeps its own choice of variants" in capsys.readouterr().out
    gain = json.loads(path.read_text())["blocks"]["gain"]
    assert (gain["variant"], gain["parameters"]["k"]) == ("base", 2)
    assert gain["variants"]["alt"]["parameters"]["k"] == pytest.approx(5, abs=0.5)
