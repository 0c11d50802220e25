"""`blocks completion`: what the shells offer at a Tab, in real shells."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from blocks.cli import COMMANDS, main
from blocks.cli.completion import words_after

ROOT = Path(__file__).parents[2]
INNER = {"format": "blocks-diagram", "version": 3, "parameters": {"T": 1}, "blocks": {"lag": {"type": "FirstOrder"}}}
DRIVE = {
    "format": "blocks-diagram", "version": 3,
    "parameters": {"torque": 1}, "inputs": {"u": {}}, "measures": {"ITAE": {"type": "ITAE", "of": "motor.omega"}},
    "blocks": {
        "motor": {"type": "PMDCMotor", "variants": {"own": {"type": "OwnMotor", "parameters": {"x": 1}}}},
        "own": {"type": "OwnBlock", "parameters": {"secret": 2}},
        "filter": {"diagram": "inner.json"},
    },
    "wires": {"motor.v": "own.w"},
}  # fmt: skip


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.json").write_text(json.dumps(DRIVE), encoding="utf-8")
    (tmp_path / "inner.json").write_text(json.dumps(INNER), encoding="utf-8")
    (tmp_path / "broken.json").write_text("{", encoding="utf-8")
    (tmp_path / "OwnBlock.py").write_text("raise SystemExit('this must not run')", encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(
    ("typed", "kind", "words"),
    [
        ("", "words", sorted(COMMANDS)),
        ("sw", "words", ["sweep"]),
        ("run ", "files json", []),
        ("run drive.json --en", "words", ["--engine"]),
        ("run --engine r", "words", ["reference"]),
        ("run --method ra", "words", ["radau"]),
        ("run drive.json --set motor.L", "words nospace", ["motor.La="]),
        ("run drive.json --set filter.T", "words nospace", ["filter.T="]),
        ("run drive.json --set filter.lag.unit", "words nospace", ["filter.lag.unit=", "filter.lag.unit_u="]),
        ("run drive.json --set own.", "words nospace", ["own.secret="]),
        ("run drive.json --set = to", "words nospace", ["torque="]),  # as bash parts --set=to
        ("sweep drive.json --vary to", "words nospace", ["torque="]),
        ("sweep drive.json --measure ", "words", ["ITAE"]),
        ("run --log motor.", "words", []),  # the diagram is not named yet
        ("run drive.json --log mo", "words", ["motor", "motor.i", "motor.omega"]),
        ("run drive.json --log own", "words", ["own", "own.w"]),
        ("run drive.json --variant ", "words", ["motor=base", "motor=own"]),
        ("run drive.json --library O", "words", ["OwnBlock"]),
        ("run drive.json -o ", "files", []),
        ("run drive.json too", "words", []),
        ("run broken.json --set ", "words nospace", []),
        ("run missing.json --log ", "words", []),
        ("list Zero", "words", ["ZeroOrderHold", "ZeroPoleGain"]),
        ("explain E10", "words", [f"E10{k}" for k in range(1, 10)]),
        ("fmu co", "words", ["compile"]),
        ("fmu run motor.fmu --st", "words", ["--start", "--step", "--stop", "--stop-when"]),
        ("fmu info ", "files fmu", []),
        ("linearize drive.json --amplitude motor.o", "words nospace", ["motor.omega="]),
        ("compare a.csv ", "files", []),
        ("nothing ", "words", []),
    ],
)  # fmt: skip
def test_words_go_on_as_the_command_and_its_diagram_say(typed: str, kind: str, words: list[str]) -> None:
    given = typed.split() + ([""] if not typed or typed.endswith(" ") else [])
    assert words_after(given) == (kind, words)


def test_what_a_file_names_is_not_imported_and_nothing_heavy_is_loaded(folder: Path) -> None:
    program = (
        "import sys; from blocks.cli import main\n"
        "main(['completion', 'words', '--', 'run', 'drive.json', '--set', 'mo'])\n"
        "print(sorted({'numpy', 'blocks.contract.block', 'blocks.api.diagram', 'OwnBlock'} & {*sys.modules}))"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment, check=True)
    lines = done.stdout.splitlines()
    assert lines[:2] == ["words nospace", "motor.Beq="]
    assert lines[-1] == "[]"


SCRIPTS = {
    "bash": 'eval "$(blocks completion bash)"\n'
    'ask() { COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _blocks blocks; echo "${COMPREPLY[*]}"; }\n'
    'ask blocks swe; ask blocks run dri; ask blocks run drive.json --set motor.L; ask blocks list "ZeroO"\n',
    "zsh": "compdef() { :; }\n"
    "compadd() { echo ${found[*]}; }\n"
    'eval "$(blocks completion zsh)"\n'
    "ask() { words=($@); CURRENT=$#; _blocks; }\n"
    "_files() { echo drive.json; }\n"
    'ask blocks swe; ask blocks run dri; ask blocks run drive.json --set motor.L; ask blocks list "ZeroO"\n',
    "fish": "blocks completion fish | source\n"
    'for typed in "blocks swe" "blocks run dri" "blocks run drive.json --set motor.L" "blocks list ZeroO"\n'
    'complete -C "$typed"\nend\n',
}


@pytest.mark.parametrize("shell", SCRIPTS)
def test_the_scripts_complete_in_their_shells(shell: str, folder: Path) -> None:
    found = shutil.which(shell)
    if found is None:
        pytest.skip(f"{shell} is not installed")
    program = folder / "bin" / "blocks"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m blocks "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    environment = {**os.environ, "PATH": f"{program.parent}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    environment |= {"HOME": str(folder), "XDG_CONFIG_HOME": str(folder / "config")}
    command = [found, *(["--norc"] if shell == "bash" else ["-f"] if shell == "zsh" else []), "-c", SCRIPTS[shell]]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.stderr == ""
    assert done.stdout.split() == ["sweep", "drive.json", "motor.La=", "ZeroOrderHold"]


def test_a_shell_that_is_not_known_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "tcsh"]) == 2
    assert "Choose one of: bash, zsh, fish, words." in capsys.readouterr().err
