"""Which engine the tests run by: the reference engine, which is the meaning, unless the environment says otherwise.

`make test` runs the tests that say what happens in a run once more with BLOCKS_ENGINE=native. Code compiled for tests
stays apart from the user's.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

os.environ.setdefault("BLOCKS_ENGINE", "reference")
os.environ.setdefault("BLOCKS_CACHE_DIR", str(Path(__file__).resolve().parents[1] / "build" / "test-cache"))
pytest.register_assert_rewrite("tests.support")
_IS_NATIVE = os.environ["BLOCKS_ENGINE"] == "native"

# In the background of a shell Ctrl-C is ignored, and under nohup SIGHUP; so would all that tests start ignore them.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if os.name == "posix" and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(autouse=True)
def folder_left_as_found() -> Iterator[None]:
    """Tests after this one name files from the same folder."""
    before = os.getcwd()
    yield
    after = os.getcwd()
    os.chdir(before)
    assert after == before


@pytest.fixture(autouse=True)
def optimised(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let runs begin by optimised code, as long ones soon have it, where the native engine is tested, or at length."""
    if _IS_NATIVE or request.node.get_closest_marker("long"):
        from blocks.engines.native import code

        monkeypatch.setattr(code, "QUICKLY", False)


@pytest.fixture
def native(monkeypatch: pytest.MonkeyPatch) -> None:
    """The native engine, by which rows of values run in threads; by another one they run in processes."""
    from blocks.compile.toolchain.compiler import find_compiler

    if find_compiler() is None:
        pytest.skip("there is no C compiler")
    monkeypatch.setenv("BLOCKS_ENGINE", "native")


@pytest.fixture
def chromium() -> Any:
    """`support.browser.Browser`; without a Chromium the test is skipped, and counted at the end.

    Where BLOCKS_BROWSER is "required" it fails instead.
    """
    from .support.browser import Browser, found

    if found() is None and os.environ.get("BLOCKS_BROWSER") == "required":
        pytest.fail(_NO_CHROMIUM)
    if found() is None:
        pytest.skip(_NO_CHROMIUM)
    return Browser


_NO_CHROMIUM = "no Chromium: set BLOCKS_CHROMIUM, or install one by make browser"


def pytest_terminal_summary(terminalreporter: Any) -> None:
    skipped = sum(_NO_CHROMIUM in str(one.longrepr) for one in terminalreporter.stats.get("skipped", ()))
    if skipped:
        terminalreporter.write_line(f"BROWSER NOT TESTED: {skipped} tests skipped, {_NO_CHROMIUM}", yellow=True)
