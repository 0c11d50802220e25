"""Versions of the files: what each one means is pinned by a golden file.

Beside support/golden/diagram_v2.json stands diagram_v2.means.json: the names, the numbers in SI and the results that
this file has. A golden file is never changed again once its version was released; a later release must read the same.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram
from blocks.model import diagram_grammar as g
from blocks.model import diagram_value, document
from blocks.model import study_grammar as s
from blocks.model.block_types import library_types
from blocks.model.hierarchy import Hierarchy
from blocks.model.resolver import resolver_of
from blocks.model.variants import taken
from blocks.model.wires import BlockSource, InputSource, Source
from blocks.studies import study
from blocks.text import json_text
from tests.support.places import SUPPORT

GOLDEN = SUPPORT / "golden"
DIAGRAMS = sorted(GOLDEN.glob("diagram_v?.json"))
STUDIES = sorted(GOLDEN.glob("study_v?.json"))


def means(path: Path) -> Any:
    """What a golden file must mean."""
    return json.loads(path.with_suffix(".means.json").read_text(encoding="utf-8"))


def plain(value: Any) -> Any:
    """A value as JSON has it: fractions and infinity as texts, arrays as lists."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, Fraction):
        return f"{value}"
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else repr(value)
    return value


def meaning_of_diagram(path: Path) -> dict[str, Any]:
    """Names, numbers in SI, and the results of the run that the file describes."""
    loaded = Diagram.load(path)
    flat = loaded.flatten()

    def source(one: Source) -> str:
        if isinstance(one, BlockSource):
            return f"{flat.blocks[one.block].path}.{one.variable}[{one.element}]"
        return f"input {one.element}" if isinstance(one, InputSource) else f"{one.value}"

    root = Hierarchy(taken(loaded.value), resolver_of(library_types()), {}).root
    results = loaded.run(engine="reference")
    return plain(  # type: ignore[no-any-return]
        {
            "name": flat.name,
            "parameters": {
                name: [value.value, value.unit, value.exact]
                for name, value in root.parameters.items()
                if value is not None
            },
            "inputs": {
                one.name: [list(one.shape), one.unit, one.type, one.default and one.default[0]] for one in flat.inputs
            },
            "outputs": flat.outputs,
            "blocks": {
                block.path: {
                    "type": block.interface.name,
                    "parameters": {key: value.value for key, value in block.resolved.values.items()},
                    "wires": {key: [source(one) for one in sources] for key, sources in block.sources.items()},
                }
                for block in flat.blocks
                if not block.hidden
            },
            "signals": {name: [list(one.shape), list(one.units), one.type] for name, one in flat.signals.items()},
            "enabled": [one.path for one in flat.enabled],
            "control": {name: entry.control for name, entry in loaded.value.blocks.items() if entry.control},
            "variants": {
                name: {key: [one.what, one.ports, one.options] for key, one in entry.variants.items()}
                for name, entry in loaded.value.blocks.items()
                if entry.variants
            },
            # What a file says; whether it says so is no part of its meaning.
            "run": {key: value for key, value in asdict(flat.settings).items() if key != "gives_rtol"},
            "log": flat.log,
            "measures": {one.name: asdict(one) for one in flat.measures},
            "layout": {name: [float(x) for x in place] for name, place in loaded.value.layout.items()},
            "kept": dict(loaded.value.extras),
            "results": {
                "times": [len(results.t), float(results.t[-1])],
                "end": {name: np.asarray(results[name])[-1].tolist() for name in results},
                "measures": dict(results.measures),
            },
        }
    )


def meaning_of_study(path: Path) -> dict[str, Any]:
    loaded = study.load(path)
    told = {key: getattr(loaded, key) for key in ("name", "title", "doc", "source", "assumed", "figures")}
    told |= {key: [asdict(one) for one in getattr(loaded, key)] for key in ("runs", "sweeps", "tunings", "claims")}
    made = study.run(loaded)
    return plain(told | {"verdicts": [[one.value, one.verdict] for one in made.verdicts], "is_fine": made.is_fine})  # type: ignore[no-any-return]


def same(made: Any, wanted: Any, place: str = "") -> None:
    """Equal, to the last digit; measured results to 1e-9, which other libraries of the machine may round."""
    if isinstance(wanted, dict):
        assert list(made) == list(wanted), place
        for key, item in wanted.items():
            same(made[key], item, f"{place}.{key}")
    elif isinstance(wanted, list) and isinstance(made, list):
        assert len(made) == len(wanted), place
        for index, item in enumerate(wanted):
            same(made[index], item, f"{place}.{index}")
    elif isinstance(wanted, float) and place.startswith((".results.", ".verdicts.")):
        assert made == pytest.approx(wanted, rel=1e-9, abs=1e-12, nan_ok=True), place
    else:
        assert (type(made), made) == (type(wanted), wanted), place


# --- golden files ----------------------------------------------------------------------------------------------


def test_there_is_a_golden_file_of_each_version() -> None:
    versions = range(diagram_value.OLD_VERSION, diagram_value.VERSION + 1)
    assert [path.name for path in DIAGRAMS] == [f"diagram_v{n}.json" for n in versions]
    assert [path.name for path in STUDIES] == [f"study_v{n}.json" for n in range(1, s.VERSION + 1)]
    for path in (*DIAGRAMS, *STUDIES):
        assert f'"version": {path.stem.partition("_v")[2]},' in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("path", DIAGRAMS, ids=lambda path: path.stem)
def test_a_golden_diagram_means_what_it_meant(path: Path) -> None:
    same(meaning_of_diagram(path), means(path))


def test_the_results_of_version_2_are_those_of_closed_forms() -> None:
    end = means(DIAGRAMS[0])["results"]["end"]
    at_half = 1 - math.exp(-0.5 / 0.25)  # a lag of 0.25 s under 1, from 0.5 s on under 2
    assert end["file.lag.y"] == pytest.approx(2 - (2 - at_half) * math.exp(-0.7 / 0.25), rel=1e-6)
    assert end["while_on.y"] == pytest.approx(5 + 0.25 + 0.25 + 0.2, rel=1e-12)  # the integral of 1 while it is on
    assert end["at_ticks.y"] == pytest.approx(3 * 1.15, rel=1e-12)  # the last tick before 1.2 s
    assert end["third"] == 1.0  # 1000 mV


@pytest.mark.long
@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_a_golden_study_means_what_it_meant(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BLOCKS_ENGINE", "reference")
    same(meaning_of_study(path), means(path))


def keys_of(value: Any) -> set[str]:
    if isinstance(value, dict):
        return set(value) | {key for item in value.values() for key in keys_of(item)}
    return {key for item in value for key in keys_of(item)} if isinstance(value, list) else set()


def test_the_newest_golden_files_use_every_key() -> None:
    text = DIAGRAMS[-1].read_text(encoding="utf-8")
    kinds = (g.DIAGRAM, g.BLOCK, g.VARIANT, g.QUANTITY, g.COLUMN, g.INPUT, g.RUN, g.ENABLE, g.TRIGGER, g.MEASURE)
    known = {key for kind in (*kinds, g.MASTER) for key in kind.keys}
    assert known <= keys_of(json.loads(text))
    for word in ("held", "reset", *g.TYPES, *g.INTERPOLATIONS):
        assert f'"{word}"' in text
    of_study = (s.STUDY, s.ONE_RUN, s.CLAIM, s.ASSUMED, s.FIGURE, s.PANEL, s.LINE, s.MARKER)
    known = {key for kind in of_study for key in kind.keys} - {"$schema"}
    assert known <= keys_of(json.loads(STUDIES[-1].read_text(encoding="utf-8")))


def test_the_newest_golden_files_are_canonical() -> None:
    for path, canonical in ((DIAGRAMS[-1], document.canonical), (STUDIES[-1], study.canonical)):
        text = path.read_text(encoding="utf-8")
        assert canonical(json_text.read(text)) == text
