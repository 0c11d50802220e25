"""The rules by which a file does no harm, each attacked.

The sections stand in the order of the rules. Most attacks by files are cases of tests/support/hostile.py, which
tests/cli/test_hostile.py gives to the commands; where another module attacks a rule already, a comment names it.
"""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import stat
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from blocks import Diagram, ModelError
from blocks.compile.toolchain import cache as caches
from blocks.compile.toolchain.cache import Cache
from blocks.compile.toolchain.compiler import find_compiler
from blocks.fmi.library import folders, suffix
from tests.support.hostile import CANARY, HEADER, TRACE, kept
from tests.support.places import ROOT
from tests.support.watched import Watch

MOTOR = ROOT / "fmus" / "PMDCMotor.fmu"
LINUX = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="commands are watched on Linux")
NEEDS_COMPILER = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
POSIX = pytest.mark.skipif(os.name != "posix", reason="links and modes of POSIX")
SECRET = "319058.46"  # in no path of a test: "42" is, once pytest has made 42 folders


@pytest.fixture(scope="module")
def watch() -> Iterator[Watch]:
    with Watch() as made:
        yield made


def project(folder: Path, **sections: Any) -> Path:
    """A project with the diagram a.json."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "pyproject.toml").touch()
    source = {"format": "blocks-diagram", "version": 3, "name": "d", "run": {"stop": 1}, **sections}
    (folder / "a.json").write_text(json.dumps(source), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def poisoned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU whose binary writes the file TRACE beside HOME as soon as it is loaded."""
    folder = tmp_path_factory.mktemp("poison")
    (folder / "evil.c").write_text(
        "#include <stdio.h>\n#include <stdlib.h>\n"
        "__attribute__((constructor)) static void harm(void) {\n"
        f'    char path[4096]; snprintf(path, sizeof path, "%s/{TRACE}", getenv("HOME"));\n'
        '    FILE *file = fopen(path, "w"); if (file) fclose(file);\n'
        "}\n",
        encoding="utf-8",
    )
    subprocess.run(["cc", "-shared", "-fPIC", "-o", "evil.so", "evil.c"], cwd=folder, check=True)
    name = f"binaries/{folders(3)[0]}/PMDCMotor{suffix()}"
    with zipfile.ZipFile(MOTOR) as old, zipfile.ZipFile(folder / "x.fmu", "w") as new:
        for entry in old.namelist():
            new.writestr(entry, (folder / "evil.so").read_bytes() if entry == name else old.read(entry))
        assert name in old.namelist()
    return folder / "x.fmu"


FMU = {
    "inputs": {"v": {"unit": "V", "default": 6}},
    "outputs": {"omega": "m.omega"},
    "blocks": {"m": {"fmu": "x.fmu", "kind": "CS"}},
    "wires": {"m.v": "v"},
}


# --- loading, checking, drawing and listing load no binary, and import nothing that a file names ---------------------


@LINUX
@NEEDS_COMPILER
def test_telling_about_an_fmu_never_loads_it(poisoned: Path, watch: Watch, tmp_path: Path) -> None:
    folder = project(tmp_path / "project", **FMU)
    shutil.copy(poisoned, folder / "x.fmu")
    telling = (
        "check a.json",
        "draw a.json",
        "list x.fmu",
        "fmu info x.fmu",
        "fmu check x.fmu",
        "run a.json --stop nan",
    )
    for words in map(str.split, telling):
        seen = watch(words, folder, HOME=str(tmp_path))
        assert seen.status in (0, 2), seen.said
        assert seen.deeds == ()
        assert not (tmp_path / TRACE).exists(), words
    # The trap works: running is what loads.
    watch(["run", "a.json"], folder, writes=True, HOME=str(tmp_path), BLOCKS_CACHE_DIR=str(tmp_path / "cache"))
    assert (tmp_path / TRACE).exists()


def planted(folder: Path) -> Path:
    """A project full of modules that must not be imported, also as an installed package with types for `blocks`."""
    project(folder, blocks={"b": {"type": "evil.Evil"}})
    for name in ("evil", "blocks_library", "numpy", "difflib", "scipy", "json", "fmpy", "control"):
        (folder / f"{name}.py").write_text(CANARY, encoding="utf-8")
    package = folder / "evil-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: evil\nVersion: 1.0\n", encoding="utf-8")
    (package / "entry_points.txt").write_text("[blocks.library]\nevil = evil\n", encoding="utf-8")
    return folder


@pytest.mark.parametrize("words", [["check", "a.json"], ["run", "a.json"], ["draw", "a.json"], ["list"]], ids=" ".join)
def test_modules_beside_a_diagram_are_not_imported(words: list[str], tmp_path: Path) -> None:
    folder = planted(tmp_path / "project")
    without = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-m", "blocks", *words], cwd=folder, env=without, capture_output=True, text=True, check=False
    )
    assert done.returncode in (0, 2), done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.rglob(TRACE))
    assert not list(folder.rglob("__pycache__"))


def test_a_module_is_imported_where_the_caller_names_it(tmp_path: Path) -> None:
    """So that the trap above is one."""
    folder = planted(tmp_path / "project")
    done = subprocess.run(
        [sys.executable, "-m", "blocks", "check", "a.json", "--library", "evil"],
        cwd=folder,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 2
    assert (folder / TRACE).exists()


# Types that are named like modules and calls ("os.system", "./evil.py"): tests/support/hostile.py, "a type ...".


# --- FMUs from outside of the project are run only where they are trusted --------------------------------------------
# By names, links, marks of projects, variants and subdiagrams: tests/model/test_trust.py, "trust".


@LINUX
@POSIX
@NEEDS_COMPILER
@pytest.mark.parametrize("way", ["path", "link", "folder", "twice"])
def test_an_fmu_from_outside_is_not_loaded_unless_it_is_trusted(
    way: str, poisoned: Path, watch: Watch, tmp_path: Path
) -> None:
    name = {"path": "../there/x.fmu", "link": "x.fmu", "folder": "sub/x.fmu", "twice": "one.fmu"}[way]
    folder = project(tmp_path / "here", **{**FMU, "blocks": {"m": {"fmu": name, "kind": "CS"}}})
    there = tmp_path / "there"
    there.mkdir()
    shutil.copy(poisoned, there / "x.fmu")
    if way in ("link", "twice"):
        (folder / "x.fmu").symlink_to(there / "x.fmu")
        (folder / "one.fmu").symlink_to("x.fmu")
    if way == "folder":
        (folder / "sub").symlink_to(there)
    home = {"HOME": str(tmp_path), "BLOCKS_CACHE_DIR": str(tmp_path / "cache")}
    seen = watch(["run", "a.json", "--json"], folder, **home)
    assert seen.status == 4
    assert [fault["code"] for fault in seen.faults] == ["E218"]
    assert seen.deeds == ()
    assert not (tmp_path / TRACE).exists()
    watch(["run", "a.json", "--trust", str(there)], folder, writes=True, **home)
    assert (tmp_path / TRACE).exists()


# Addresses of the network, UNC paths, devices: tests/support/hostile.py, "an FMU at ...", "a subdiagram at ...".


# --- tables are read under the same root, and blocks write no files ---------------------------------------------------


@POSIX
@pytest.mark.parametrize("name", ["../secret.csv", "link.csv", "sub/secret.csv", "{}/secret.csv"])
def test_a_table_from_outside_is_not_read(name: str, tmp_path: Path) -> None:
    (tmp_path / "secret.csv").write_text(f"key\n{SECRET}\n", encoding="utf-8")
    entry = {"csv": name.format(tmp_path), "column": "key"}
    folder = project(tmp_path / "here", parameters={"p": entry})
    (folder / "link.csv").symlink_to(tmp_path / "secret.csv")
    (folder / "sub").symlink_to(tmp_path)
    with pytest.raises(ModelError, match=r"E007 .*lies outside the project") as caught:
        Diagram.load(folder / "a.json")
    assert SECRET not in str(caught.value)


@pytest.mark.skipif(not hasattr(os, "O_NOFOLLOW"), reason="links are followed there")
def test_a_link_that_is_put_there_after_the_look_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A race: the file was a plain one when its place was looked at."""
    (tmp_path / "secret.json").write_text(f'{{"key": {SECRET}}}', encoding="utf-8")
    folder = project(tmp_path / "here")
    real = Path.is_file

    def swapped(path: Path) -> bool:
        answer = real(path)
        if path.name == "a.json" and not path.is_symlink():
            path.unlink()
            path.symlink_to(tmp_path / "secret.json")
        return answer

    monkeypatch.setattr(Path, "is_file", swapped)
    with pytest.raises(ModelError, match="E007") as caught:
        Diagram.load(folder / "a.json")
    assert SECRET not in str(caught.value)


@LINUX
@pytest.mark.parametrize("name", ["bouncing_ball", "motor_pid", "quarter_car", "sampled_loop"])
def test_a_run_writes_nothing_that_it_was_not_asked_for(name: str, watch: Watch, tmp_path: Path) -> None:
    folder = project(tmp_path / "here")
    shutil.copy(ROOT / "diagrams" / f"{name}.json", folder / "a.json")
    before = sorted(tmp_path.rglob("*"))
    seen = watch(["run", "a.json", "--engine", "reference", "--stop", "0.2"], folder, HOME=str(tmp_path))
    assert seen.status == 0, seen.said
    assert seen.deeds == ()
    assert sorted(tmp_path.rglob("*")) == before


# --- saved states are JSON and arrays ---------------------------------------------------------------------------------
# Pickles, arrays of objects, bombs, odd members, shapes and headers: tests/support/hostile.py, "a state: ...".


def test_a_state_is_made_of_json_and_numbers_and_names_no_class(tmp_path: Path) -> None:
    run = Diagram.load(ROOT / "diagrams" / "bouncing_ball.json").start(engine="reference")
    run.advance_to(0.1)
    run.save(tmp_path / "s.state")
    with zipfile.ZipFile(tmp_path / "s.state") as archive:
        assert sorted(archive.namelist()) == ["rows", "state.json"]
        text = archive.read("state.json")
        sizes = [(int(kind[-1]), math.prod(shape)) for kind, shape in json.loads(text)["rows"].values()]
        assert len(archive.read("rows")) == sum(size * count for size, count in sizes)
    assert json.loads(text)["format"] == "blocks-state"
    assert not re.search(rb"__|module|numpy|pickle", text)


@LINUX
def test_a_state_that_says_more_than_its_file_holds_is_refused(watch: Watch, tmp_path: Path) -> None:
    folder = project(tmp_path / "here", blocks={"c": {"type": "Integrator"}}, wires={"c.u": "c.y"})
    kept({**HEADER, "overrides": {"c.y_start": "=__import__('evil')"}})(folder / "s.state")
    seen = watch(["run", "a.json", "--resume", "s.state", "--json"], folder)
    assert seen.status == 2
    assert seen.deeds == ()


# --- XML without document types and entities; archives with bounds ----------------------------------------------------
# Document types, entities, depth, sizes: tests/fmi/test_description.py and tests/support/hostile.py, "an FMU: ...".
# Names, links, bombs, truncations, random damage: tests/fmi/test_archive.py.


@POSIX
def test_names_that_differ_by_case_overwrite_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a file system does not tell them apart, the second one finds its place taken."""
    from blocks.fmi import archive
    from blocks.text.errors import FMUError

    with zipfile.ZipFile(MOTOR) as old, zipfile.ZipFile(tmp_path / "x.fmu", "w") as new:
        new.writestr("modelDescription.xml", old.read("modelDescription.xml"))
        new.writestr("resources/a", b"first")
        new.writestr("resources/A", b"second")
    plain = os.open
    monkeypatch.setattr(archive.os, "open", lambda path, *more: plain(str(path).replace("/A", "/a"), *more))
    with pytest.raises(FMUError, match="E210"):
        archive.unpack(tmp_path / "x.fmu")


# --- expressions are bounded and evaluate nothing ---------------------------------------------------------------------
# Texts: tests/contract/test_expressions.py, and "expression: ..." in support/hostile.py. That no module calls
# eval or exec but the printer of equations: tests/project/test_project.py.


def test_what_is_printed_to_be_run_holds_no_text_of_a_file(tmp_path: Path) -> None:
    """The printer writes Python: names of a diagram, which are identifiers, stand in its comments only."""
    sections = {"blocks": {"zzz_evil": {"type": "Gain"}}, "inputs": {"r_evil": {"default": 1}}}
    project(tmp_path / "here", doc="harm", wires={"zzz_evil.u": "r_evil"}, **sections)
    program = (
        "import re, sys\n"
        "from blocks import Diagram\n"
        "seen = []\n"
        "def listen(event, given):\n"
        "    if event == 'compile' and given[0] is not None and str(given[1]).startswith('<'):\n"
        "        seen.append(given[0] if isinstance(given[0], str) else bytes(given[0]).decode())\n"
        "sys.addaudithook(listen)\n"
        "Diagram.load('a.json').run(engine='reference')\n"
        "bare = [re.sub('#.*', '', text) for text in seen]\n"
        "print(len(seen), any('evil' in text for text in bare), any('harm' in text for text in seen))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path / "here", capture_output=True, text=True, check=True
    )
    count, *is_there = done.stdout.split()
    assert int(count) > 0
    assert is_there == ["False", "False"]


# --- names are escaped: C, HTML, SVG, XML, terminals ------------------------------------------------------------------
# SVG: tests/draw/test_draw.py, "hostile names". Study reports: tests/studies/test_study.py. XML:
# tests/export/test_description_xml.py, "odd texts". Terminals: every case of tests/support/hostile.py.

ODD = """</script><img src=x onerror=alert(1)> */ ??/ \\
%s%n "'`$(touch harm)` \x1b]0;owned\x07 \x9b31m \u202e \u2028 ]]> --> {0.__class__} \\x41 \\"""


@NEEDS_COMPILER
@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("fmi", [2, 3])
def test_odd_texts_of_a_diagram_stay_texts_in_an_fmu(fmi: int, tmp_path: Path) -> None:
    folder = project(
        tmp_path / "here",
        doc=[ODD, ODD],
        parameters={"k": {"value": 2, "doc": ODD}},
        inputs={"r": {"default": 1, "doc": ODD}},
        blocks={"g": {"type": "Gain", "doc": ODD, "parameters": {"k": "=k"}}},
        wires={"g.u": "r"},
        outputs={"y": "g.y"},
        **{"x-note": ODD},
    )
    Diagram.load(folder / "a.json").export(tmp_path / "x.fmu", fmi=fmi)
    with zipfile.ZipFile(tmp_path / "x.fmu") as archive:
        texts = {name: archive.read(name) for name in archive.namelist() if not name.startswith("binaries")}
    root = ElementTree.fromstring(texts["modelDescription.xml"])
    assert any("onerror" in text for one in root.iter() for text in one.attrib.values())
    for name, raw in texts.items():
        text = raw.decode("utf-8")
        assert not re.search("[\x00-\x08\x0b\x0c\x0e-\x1f]", text), name
        if name.endswith((".html", ".xml")):
            assert "<img" not in text, name
            assert "</script>" not in text, name
        if name.endswith((".c", ".h")):
            assert "onerror" not in re.sub(r'"(?:[^"\\\n]|\\.)*"', "", text), name
            assert "??/" not in text, name


@LINUX
def test_what_is_said_of_odd_texts_is_printable(watch: Watch, tmp_path: Path) -> None:
    folder = project(
        tmp_path / "here",
        doc=ODD,
        blocks={"g": {"type": ODD}, "h": {"type": "Gain", "parameters": {ODD: ODD}}},
        wires={ODD: ODD},
        outputs={"y": ODD},
        run={"log": [ODD], "method": ODD, ODD: 1},
        measures={"m": {"type": ODD, "of": ODD}},
        layout={ODD: [1, 2]},
    )
    for words in (["check", "a.json"], ["check", "a.json", "--json"], ["run", "a.json"], ["draw", "a.json"]):
        seen = watch(words, folder)
        assert seen.said
        assert all(line.isprintable() for line in seen.said.split("\n")), words
        assert "<img" not in seen.out or words[0] == "check"


# --- the cache is private ---------------------------------------------------------------------------------------------
# Modes, owners, broken entries: tests/compile/test_compiler.py, "the cache".


@POSIX
@pytest.mark.parametrize("mode", [0o777, 0o720, 0o702])
def test_a_link_to_a_folder_that_others_may_write_to_is_no_cache(
    mode: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared").chmod(mode)
    (tmp_path / "cache").symlink_to(tmp_path / "shared")
    monkeypatch.setenv(caches.VARIABLE, str(tmp_path / "cache"))
    place = caches.of_user()
    assert place.is_temporary
    assert stat.S_IMODE(place.folder.stat().st_mode) == 0o700
    assert list((tmp_path / "shared").iterdir()) == []


@pytest.mark.parametrize("name", ["../../evil.so", "/tmp/evil.so", "sub/evil.so"])
def test_an_entry_that_names_a_library_elsewhere_is_none(name: str, tmp_path: Path) -> None:
    place, key = Cache(tmp_path / "cache"), "0" * 64
    (tmp_path / "cache" / key / "sub").mkdir(parents=True)
    evil = tmp_path / "evil.so"
    evil.write_bytes(b"evil")
    (tmp_path / "cache" / key / "sub" / "evil.so").write_bytes(b"evil")
    check = place.folder / key / "check"
    check.write_text(f"{caches._digest(evil)} 4 {name.replace('/tmp', str(tmp_path))}\n", encoding="ascii")
    assert place.find(key) is None


def test_a_library_that_was_put_into_an_entry_is_not_found(tmp_path: Path) -> None:
    (tmp_path / "cache").mkdir(mode=0o700)
    (tmp_path / "a.so").write_bytes(b"good")
    place = Cache(tmp_path / "cache")
    path = place.store("0" * 64, tmp_path / "a.so")
    assert place.find("0" * 64) == path
    path.write_bytes(b"evil")
    os.utime(path, ns=(1, 1))
    assert place.find("0" * 64) is None
