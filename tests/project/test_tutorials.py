"""The notebooks of the documentation run, show what their pages hold, and are small.

`UPDATE_DOCS=1 python -m pytest tests/project/test_tutorials.py` writes what they show now into them.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

from tests.support.places import ROOT

NOTEBOOKS = sorted((ROOT / "docs" / "tutorials").glob("*.ipynb"))
LARGEST = 200_000  # bytes


def _kept(outputs: list[Any]) -> list[Any]:
    """Outputs as the files hold them: no lines of progress, and no PNG of what is there as SVG."""
    kept = []
    for output in outputs:
        forms = output.get("data", {})
        if "image/svg+xml" in forms:
            forms.pop("image/png", None)
        if output.output_type not in ("display_data", "execute_result") or any(forms.values()):
            kept.append(output)
    return kept


def _kinds(cell: Any) -> list[tuple[str, list[str]]]:
    return [(output.output_type, sorted(output.get("data", {}))) for output in cell.get("outputs", [])]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_small_and_without_errors_but_those_that_it_means(path: Path) -> None:
    assert path.stat().st_size < LARGEST
    for cell in nbformat.read(path, 4).cells:
        tags = cell.metadata.get("tags", [])
        assert any(kind == "error" for kind, _ in _kinds(cell)) == ("raises-exception" in tags), cell.source
        assert str(ROOT) not in str(cell)


@pytest.mark.long
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_what_its_page_holds(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    notebook = nbformat.read(path, 4)
    before = [_kinds(cell) for cell in notebook.cells]
    place = {"metadata": {"path": str(tmp_path)}}
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources=place).execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if "outputs" in cell:
            cell.outputs = _kept(cell.outputs)
    if os.environ.get("UPDATE_DOCS"):
        nbformat.write(notebook, path)
    else:
        assert [_kinds(cell) for cell in notebook.cells] == before
