"""FMUs of other tools run here, and ours run there, to the same numbers: a part of what the benchmarks look through."""

from __future__ import annotations

import pytest

from benchmarks import exported_fmus, foreign_fmus
from tests.support.places import ROOT


@pytest.mark.long
def test_fmus_of_other_packages_and_our_own_give_what_fmpy_gives(capsys: pytest.CaptureFixture[str]) -> None:
    status = foreign_fmus.main([])
    told = capsys.readouterr().out
    assert status == 0, told
    assert told.splitlines()[-1] == "8 same (5 FMUs)", told


def test_exported_diagrams_give_in_other_tools_what_we_give(capsys: pytest.CaptureFixture[str]) -> None:
    status = exported_fmus.main([str(ROOT / "diagrams" / name) for name in ("bouncing_ball.json", "sampled_loop.json")])
    told = capsys.readouterr().out
    assert status == 0, told
    assert "0 beyond 1e-06; 0 refused" in told.splitlines()[-1], told
