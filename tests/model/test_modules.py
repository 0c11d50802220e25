"""A library that is given by its name is the one that its files hold now."""

import importlib
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import pytest

from blocks import Diagram, UsageError

TEXT = """from blocks import Block, Input, output
{head}

class Mine(Block):
    u = Input()

    @output
    def y(u):
        return {gain} * u
"""


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    before = dict(sys.modules)
    yield
    for name in set(sys.modules) - set(before):
        del sys.modules[name]
    sys.modules.update(before)


def written(folder: Path, gain: str = "2.0", name: str = "stale_library", head: str = "") -> Path:
    folder.mkdir(exist_ok=True, parents=True)
    (folder / f"{name}.py").write_text(TEXT.format(gain=gain, head=head))
    return folder


def gain(library: object = "stale_library") -> float:
    blocks = {"b": {"type": "Mine"}}
    document = {"format": "blocks-diagram", "version": 3, "name": "d", "inputs": {"u": {"default": 1}}}
    document |= {"blocks": blocks, "wires": {"b.u": "u"}}
    diagram = Diagram.from_json(document, library=library)  # type: ignore[arg-type]
    return float(diagram.run(stop=1, engine="reference")["b.y"][-1])


def test_a_library_that_was_edited_is_loaded_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(written(tmp_path))
    assert gain() == 2.0
    before = sys.modules["stale_library"]
    assert gain() == 2.0
    assert sys.modules["stale_library"] is before  # its classes stay the same as long as the text does
    written(tmp_path, "3.0")  # within the same second and of the same size
    assert gain() == 3.0
    written(tmp_path, "4.0 +")
    with pytest.raises(UsageError, match="E501 stale_library: the module cannot be imported: SyntaxError"):
        gain()
    written(tmp_path, "4.0")
    assert gain() == 4.0


def test_the_library_of_another_folder_is_another_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder, value in (("a", "2.0"), ("b", "3.0"), ("a", "2.0")):
        monkeypatch.chdir(written(tmp_path / folder, value))
        assert gain() == float(value)
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    with pytest.raises(UsageError, match="E501 stale_library: the module cannot be imported: ModuleNotFoundError"):
        gain()


def test_what_lies_beside_a_library_belongs_to_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(written(tmp_path, "K", head="from stale_helper import K"))
    (tmp_path / "stale_helper.py").write_text("from stale_numbers import K\n")
    for value in ("2.0", "3.0"):
        (tmp_path / "stale_numbers.py").write_text(f"K = {value}\n")
        assert gain() == float(value)


def test_the_parts_of_a_package_belong_to_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "stale_package", "K", "parts", "from .numbers import K")
    (tmp_path / "stale_package" / "__init__.py").write_text("from .parts import Mine\n")
    for value in ("2.0", "3.0"):
        (tmp_path / "stale_package" / "numbers.py").write_text(f"K = {value}\n")
        assert gain("stale_package") == float(value)
        assert gain("stale_package.parts") == float(value)


def test_a_library_that_was_imported_before_is_taken_as_long_as_its_file_is_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.chdir(written(tmp_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    mine = importlib.import_module("stale_library")
    assert gain() == 2.0
    assert sys.modules["stale_library"] is mine
    written(tmp_path, "3.0")
    assert gain() == 3.0


def test_an_edit_before_the_first_look_is_seen_by_what_python_has_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.chdir(written(tmp_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.import_module("stale_library")
    written(tmp_path, "3.00")
    assert gain() == 3.0


def test_two_libraries_of_one_name_are_refused_where_one_was_imported_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(written(tmp_path / "a")))
    mine = importlib.import_module("stale_library")
    monkeypatch.chdir(written(tmp_path / "b", "3.0"))
    with pytest.raises(
        UsageError,
        match=(
            r"E501 stale_library: is already imported "
            r"from .* Pass the module itself"
        ),
    ) as caught:
        gain()
    assert all(str(tmp_path / folder / "stale_library.py") in str(caught.value) for folder in "ab")
    assert gain(mine) == 2.0


def test_a_module_that_has_no_file_is_taken_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    made = types.ModuleType("stale_made")
    exec(TEXT.format(head="", gain="2.0"), made.__dict__)
    monkeypatch.setitem(sys.modules, "stale_made", made)
    assert gain("stale_made") == 2.0
