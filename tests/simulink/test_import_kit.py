"""The kit of small models: imported from every form of file, and simulated as Simulink's documentation says."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest

from blocks import from_simulink
from blocks.text.errors import ModelError
from tests.support.simulink_files import FORMS, model
from tests.support.simulink_kit import CASES, EVERY, REFUSED, Case

TIGHT = {"rtol": 1e-10, "atol": 1e-12, "every": EVERY}
every_case = pytest.mark.parametrize("one", CASES, ids=lambda one: one.name.replace("\n", " "))


def written(one: Case, form: str, folder: Path) -> tuple[Path, list[Path]]:
    """Write a model, those beside it, and its workspaces."""
    folder.mkdir(exist_ok=True)
    for other in one.beside:
        FORMS[form](other, folder)
    for name, text in one.files.items():
        (folder / name).write_text(text)
    return FORMS[form](one.drawn, folder), [folder / name for name in one.files]


@every_case
def test_a_model_runs_as_its_documentation_says(one: Case, tmp_path: Path) -> None:
    documents = {}
    for form in FORMS:
        path, workspace = written(one, form, tmp_path / form.replace(" ", "_"))
        diagram, report = from_simulink(path, workspace)
        assert report.is_whole, report
        assert one.told in str(report)
        documents[form] = diagram.to_json()
    assert all(document == documents["mdl"] for document in documents.values())
    diagram.check()
    for engine in ("reference",):
        results = diagram.run(engine=engine, **{**TIGHT, **one.run})
        with contextlib.suppress(KeyError):
            pass
        expected = one.witness(results.t)
        np.testing.assert_allclose(results["out1"], expected, rtol=one.tolerance, atol=one.tolerance)


@pytest.mark.parametrize("name", REFUSED)
def test_the_report_and_check_name_what_has_no_equal(name: str, tmp_path: Path) -> None:
    inside, piece = REFUSED[name]
    diagram, report = from_simulink(FORMS["split"](model("some", inside), tmp_path))
    missing = [*report.of("left out"), *report.of("unknown")]
    assert [entry.path for entry in missing] == ["Merge" if name.startswith("merge") else "b"]
    assert piece in str(report)
    assert missing[0].cure or missing[0].kind == "left out"
    with pytest.raises(ModelError, match=r"ToWrite|has no value"):
        diagram.check()
