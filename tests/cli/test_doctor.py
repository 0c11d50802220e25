"""`blocks doctor`: what it says about the machine, and its exit code."""

from __future__ import annotations

import json
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from blocks import __version__
from blocks.api import installation
from blocks.cli import main
from blocks.compile.toolchain import cache as caches
from blocks.compile.toolchain import compiler as driver
from blocks.compile.toolchain.compiler import TranslationUnit, build

REAL = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")

pytestmark = pytest.mark.skipif(REAL is None or os.name != "posix", reason="no C compiler")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv(caches.VARIABLE, str(tmp_path / "cache"))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.delenv("BLOCKS_ENGINE", raising=False)
    monkeypatch.setattr(caches, "_refused", {})
    driver._found.cache_clear()
    yield tmp_path / "cache"
    driver._found.cache_clear()


def told(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, list[dict[str, Any]]]:
    status = main(["doctor", "--json", *arguments])
    return status, [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def use(path: Path, body: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path.write_text(f"#!/bin/sh\n{body}\n", encoding="utf-8")
    path.chmod(0o755)
    monkeypatch.setenv("CC", str(path))


def test_versions_compiler_engine_and_cache_are_told(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"blocks {__version__}, Python {platform.python_version()}, ")
    for name in ("numpy", "scipy"):
        assert f"  {name:9} {metadata.version(name)}\n" in out
    compiler = driver.find_compiler()
    assert compiler is not None
    assert f"  compiler  {compiler.command[0]} [{compiler.version}], from {compiler.origin}\n" in out
    assert "a small model was compiled and ran correctly" in out
    assert "auto takes native: the compiler works" in out
    assert f"  cache     {folder}: 0 entries, 0.0 MiB (at most 4000 entries, 512 MiB)\n" in out
    assert list(tmp_path.iterdir()) == [folder]


def test_with_json_it_is_one_object(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    build([TranslationUnit("model.c", "int f;\n")])
    status, (entry,) = told(capsys)
    assert status == 0
    assert entry["event"] == "done"
    assert entry["fine"] is True
    assert entry["engine"] == "native"
    assert entry["self_test_seconds"] > 0
    assert Path(entry["compiler"]["command"][0]).exists()
    assert entry["cache"]["folder"] == str(folder)
    assert entry["cache"]["entries"] == 1
    assert entry["cache"]["bytes"] == sum(path.stat().st_size for path in folder.glob("*/*"))
    assert entry["cache"]["temporary"] is None


def test_clearing_the_cache_says_what_was_there(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    path = build([TranslationUnit("model.c", "int f;\n")])
    assert main(["doctor", "--clear-cache"]) == 0
    assert capsys.readouterr().out == f"{folder}: 1 entry removed, 0.0 MiB\n"
    assert not path.exists()
    status, (entry,) = told(capsys, "--clear-cache")
    assert (status, entry["removed"], entry["folder"]) == (0, 0, str(folder))


@pytest.mark.parametrize("text", ["no-such-compiler", "true", "false"])
def test_a_broken_cc_ends_with_2_and_its_fault(
    text: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", text)
    status, (fault, entry) = told(capsys)
    assert status == 2
    assert (fault["event"], fault["code"], fault["place"]) == ("fault", "E601", "$CC")
    assert (entry["fine"], entry["engine"], entry["self_test_seconds"]) == (False, "none", None)
    assert main(["doctor"]) == 2
    said = capsys.readouterr()
    assert "auto takes none: $CC does not work" in said.out
    assert said.err.startswith("E601 $CC: ")


def test_a_compiler_that_computes_something_else_is_found_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # The rate that the model integrates is made twice as fast.
    use(
        tmp_path / "cc",
        f"for a; do case $a in */rate.c) sed -i 's/: -x/: -x * 2/' $a;; esac; done\nexec {REAL} \"$@\"",
        monkeypatch,
    )
    status, (fault, entry) = told(capsys)
    assert status == 2
    assert fault["code"] == "E603"
    assert "it ended with 0 and printed '0.135" in fault["message"]  # exp(-2)
    assert entry["fine"] is False


def test_code_that_ends_the_process_does_not_end_the_doctor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    change = "sed -i 's/return/__builtin_trap(); return/' $a"
    body = f'for a; do case $a in */rate.c) {change};; esac; done\nexec {REAL} "$@"'
    use(tmp_path / "cc", body, monkeypatch)
    status, (fault, _) = told(capsys)
    assert status == 2
    assert "it ended with -" in fault["message"]


def test_without_a_compiler_all_is_fine_and_the_reference_engine_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(driver, "PACKAGES", ())
    status, (entry,) = told(capsys)
    assert status == 0
    assert (entry["compiler"], entry["engine"]) == (None, "reference")
    assert "no C compiler was found" in entry["reason"]
    assert main(["doctor"]) == 0
    assert "  compiler  none\n" in capsys.readouterr().out


def test_a_cache_that_is_not_trusted_is_told(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    folder.mkdir()
    folder.chmod(0o777)
    status, (entry,) = told(capsys)
    assert status == 0
    assert "other users can write to" in entry["cache"]["temporary"]
    assert entry["cache"]["folder"] != str(folder)
    assert main(["doctor"]) == 0
    assert f"for this process only: other users can write to {folder}" in capsys.readouterr().out
    assert main(["doctor", "--clear-cache"]) == 0
    assert "was left alone" in capsys.readouterr().err


def test_a_package_that_is_missing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installation, "PACKAGES", ("numpy", "no-such-package"))
    health = installation.examine()
    assert "  no-such-package not installed" in list(health.lines())
    assert health.entry()["no-such-package"] is None


def test_an_engine_that_the_environment_names_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    assert installation.examine().entry()["engine_named"] is None
    monkeypatch.setenv("BLOCKS_ENGINE", "reference")
    health = installation.examine()
    assert "  engine    auto takes native: the compiler works; BLOCKS_ENGINE is set to 'reference'" in list(
        health.lines()
    )
    assert health.entry()["engine_named"] == "reference"
