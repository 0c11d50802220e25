"""Random and damaged files: an error of blocks or what the file says, and never anything else.

Diagrams with everything that a file can hold are written and read back; and every kind of file that is read is damaged
byte by byte: diagrams, studies, states, tables, results, FMUs and their descriptions. Diagrams alone, and texts of JSON
and of expressions: tests/model/test_document.py, tests/text/test_json_text.py, tests/contract/test_expressions.py.
"""

from __future__ import annotations

import functools
import tempfile
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from blocks import Diagram
from blocks.compile.equation_record import Equations
from blocks.compile.inputs import read_csv
from blocks.engines.run.saved_state import Kept
from blocks.fmi.archive import Archive
from blocks.fmi.description import parse
from blocks.model import document
from blocks.results.files import FORMATS, read, write
from blocks.results.table import FileTable
from blocks.studies import study
from blocks.text.errors import BlocksError, Fault
from tests.support.documents import docs, names, numbers, own, values
from tests.support.places import ROOT

BALL = ROOT / "diagrams" / "bouncing_ball.json"
ROBOT = ROOT / "diagrams" / "sampled_loop.json"
FMUS = sorted((ROOT / "fmus").glob("*.fmu"))
STUDIES = sorted(path for path in (ROOT / "diagrams").rglob("*.json") if '"blocks-study"' in path.read_text("utf-8"))

# --- diagrams with everything -----------------------------------------------------------------------------------------

times = st.one_of(
    st.floats(1e-9, 1e9), st.builds(lambda value: {"value": value, "unit": "ms"}, numbers), st.just("=1/3")
)
off = st.sampled_from(["held", "reset"])
controls = st.one_of(
    st.just({}),
    st.fixed_dictionaries({"enable": st.fixed_dictionaries({}, optional={"states": off, "outputs": off})}),
    st.fixed_dictionaries({"trigger": st.fixed_dictionaries({"direction": st.sampled_from(["up", "down", "both"])})}),
    st.fixed_dictionaries({"trigger": st.fixed_dictionaries({"every": times}, optional={"offset": times})}),
)
options = st.fixed_dictionaries(
    {},
    optional={"kind": st.sampled_from(["CS", "ME"]), "isolate": st.booleans(), "timeout": st.floats(1e-3, 1e6)},
)
inputs = st.one_of(
    st.fixed_dictionaries(
        {}, optional={"unit": st.text(max_size=5), "default": numbers, "size": st.integers(1, 9), "doc": docs}
    ),
    st.fixed_dictionaries({"type": st.just("bool")}, optional={"default": st.booleans()}),
    st.fixed_dictionaries(
        {"type": st.just("int")}, optional={"default": st.integers(-99, 99), "unit": st.text(max_size=3)}
    ),
)
columns = st.fixed_dictionaries(
    {"csv": st.just("t.csv"), "column": st.sampled_from(["a", "b"])},
    optional={"unit": st.text(max_size=3), "doc": docs},
)
measures = st.fixed_dictionaries(
    {"type": st.text(max_size=9), "of": st.text(max_size=9)},
    optional={
        "against": st.one_of(numbers, st.text(max_size=9)),
        "from": numbers,
        "to": numbers,
        "band": numbers,
        "doc": docs,
    },
)
runs = st.fixed_dictionaries(
    {},
    optional={
        "start": numbers,
        "stop": numbers,
        "method": st.text(max_size=6),
        "rtol": numbers,
        "every": numbers,
        "stops": st.lists(numbers, max_size=3),
        "log": st.lists(st.text(max_size=9), max_size=3),
        "loops": st.text(max_size=5),
    },
)


def entries(inner: st.SearchStrategy[dict[str, Any]]) -> st.SearchStrategy[dict[str, Any]]:
    """A block of any kind, with what may stand in its place."""
    kinds = st.one_of(
        names.map(lambda name: {"type": name}),
        st.builds(lambda path, given: {"fmu": f"{path}.fmu", **given}, names, options),
        st.builds(lambda body, given: {"diagram": body, **given}, inner, controls),
    )
    more = st.fixed_dictionaries(
        {}, optional={"doc": docs, "parameters": st.dictionaries(names, values | columns, max_size=2)}
    )
    plain = st.builds(lambda kind, given, kept: {**kind, **given, **kept}, kinds, more, own)
    ports = st.dictionaries(names, names, max_size=2)
    variants = st.dictionaries(
        names.filter(lambda name: name != "base"),
        st.builds(lambda entry, given: {**entry, "ports": given}, plain, ports),
        max_size=2,
    )

    def varied(entry: dict[str, Any], given: dict[str, Any], chosen: int) -> dict[str, Any]:
        known = ["base", *given]
        return {**entry, "variants": given, "variant": known[chosen % len(known)]} if given else entry

    return st.builds(varied, plain, variants, st.integers(0, 9))


def bodies(inner: st.SearchStrategy[dict[str, Any]]) -> st.SearchStrategy[dict[str, Any]]:
    def made(
        words: list[str], blocks: list[Any], taken: list[Any], given: list[Any], rest: dict[str, Any]
    ) -> dict[str, Any]:
        body = dict(rest)
        for section, items in (("blocks", blocks), ("inputs", taken), ("parameters", given)):
            body[section] = {words.pop(): item for item in items if words}
        body["layout"] = {name: [k, -0.5] for k, name in enumerate(body["blocks"])}
        return body

    rest = st.fixed_dictionaries(
        {"run": runs, "measures": st.dictionaries(names, measures, max_size=2), "doc": docs},
        optional={
            "outputs": st.dictionaries(names, st.text(max_size=6), max_size=2),
            "wires": st.dictionaries(st.text(max_size=6), st.text(max_size=6), max_size=2),
            "name": names,
        },
    )
    words = st.lists(names, min_size=4, max_size=9, unique=True)
    return st.builds(
        made,
        words,
        st.lists(entries(inner), max_size=3),
        st.lists(inputs, max_size=2),
        st.lists(values | columns, max_size=2),
        rest,
    )


diagrams = st.recursive(bodies(st.just({})), bodies, max_leaves=3)


@functools.cache
def folder() -> Path:
    """A project with a table."""
    kept = tempfile.TemporaryDirectory(prefix="blocks-test-")
    _folders.append(kept)
    made = Path(kept.name)
    (made / "pyproject.toml").touch()
    (made / "t.csv").write_text("a,b\n1,0.1\n2,-3e5\n", encoding="utf-8")
    return made


_folders: list[tempfile.TemporaryDirectory[str]] = []


@settings(max_examples=80, deadline=None, suppress_health_check=list(HealthCheck))
@given(diagrams)
def test_a_diagram_with_everything_is_identical_when_it_was_written_and_read(body: dict[str, Any]) -> None:
    source = {"format": "blocks-diagram", "version": 3, **body}
    value = document.from_document(source, folder=folder())
    written = document.dumps(value)
    again = document.loads(written, folder=folder())
    assert again == value
    assert document.dumps(again) == written
    assert document.dumps(document.loads(written.encode(), folder=folder())) == written


# --- damaged bytes ----------------------------------------------------------------------------------------------------

pieces = st.one_of(
    st.binary(max_size=6),
    st.sampled_from(
        [
            b"\0",
            b"\xff\xff\xff\xff",
            b"\x00\x00\x00\x80",
            b"nan",
            b"1e999",
            b"-1",
            b'"',
            b"[",
            b"{",
            b"}",
            b"\n",
            b",",
            b"null",
            b"\xed\xa0\x80",
            b"PK\x03\x04",
            b"PK\x05\x06",
            b"<",
            b"&a;",
            b"\x1b[2J",
        ]
    ),
)
damages = st.lists(st.tuples(st.integers(0, 2**24), st.integers(0, 30), pieces), min_size=1, max_size=4)


def damaged(data: bytes, damage: list[tuple[int, int, bytes]]) -> bytes:
    for at, cut, put in damage:
        at %= len(data) + 1
        data = data[:at] + put + data[at + cut :]
    return data


def table() -> FileTable:
    t = np.linspace(0.0, 1.0, 20)
    made = np.column_stack([np.sin(t), t, t**2])
    return FileTable(
        t, made, {"motor.omega": (0, (), "rad/s"), "z": (1, (2,), "")}, {"engine": "reference", "stop": 1.0}
    )


@functools.cache
def shipped() -> dict[str, bytes]:
    """A sound file of each kind, by its name."""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        for ending in FORMATS:
            if ending != ".parquet" or pytest.importorskip("pyarrow"):
                write(place / f"results{ending}", table())
        run = Diagram.load(ROBOT).start(engine="reference", stop=2.0)
        run.advance_to(1.0)
        run.save(place / "s.state")
        (place / "inputs.csv").write_text("time,r\n0,1\n0.5,2\n1,-3\n", encoding="utf-8")
        for path in (*FMUS, *STUDIES):
            (place / path.name).write_bytes(path.read_bytes())
        with zipfile.ZipFile(FMUS[0]) as archive:
            (place / "modelDescription.xml").write_bytes(archive.read("modelDescription.xml"))
        return {path.name: path.read_bytes() for path in sorted(place.iterdir())}


@functools.cache
def plan() -> Any:
    source = {"format": "blocks-diagram", "version": 3, "inputs": {"r": {}}, "outputs": {"y": "r"}, "run": {"stop": 1}}
    return Diagram.from_json(source).check()


@functools.cache
def plan_of_state() -> tuple[Any, Equations]:
    diagram = Diagram.load(ROBOT)
    made = diagram.start(engine="reference", stop=2.0).plan
    return made, Equations(diagram.flatten(), made)


def read_fmu(path: Path) -> None:
    with Archive(path) as archive:
        parse(archive.read("modelDescription.xml"))
        for name, size in archive.files.items():
            if size < 100_000:
                archive.read(name)


READERS: dict[str, Callable[[Path], object]] = {
    ".fmu": read_fmu,
    ".json": study.load,
    ".state": lambda path: Kept(path).fitted(*plan_of_state()),
    ".xml": lambda path: parse(path.read_bytes()),
    "inputs.csv": lambda path: read_csv(path, plan()),
    "results.csv": read,
    "results.mat": read,
    "results.parquet": read,
}
KINDS = [
    "IADRC.fmu",
    "PMDCMotor.fmu",
    "PMDCMotor_fmi2.fmu",
    "s.state",
    "modelDescription.xml",
    "inputs.csv",
    "results.csv",
    "results.mat",
    "results.parquet",
    *sorted({path.name for path in STUDIES}),
]


def check(name: str, data: bytes) -> None:
    """What reads a kind of file gives something, or an error of blocks that is one line for each fault."""
    path = folder() / name
    path.write_bytes(data)
    reader = READERS.get(name) or READERS[path.suffix]
    told: tuple[Fault, ...] = ()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # packages that read foreign formats warn of what is odd in them
        try:
            reader(path)
        except BlocksError as error:
            told = error.faults
    assert all(str(fault).isprintable() and len(str(fault)) < 3000 for fault in told), told


@pytest.mark.parametrize("name", KINDS)
def test_a_sound_file_is_read(name: str) -> None:
    (folder() / name).write_bytes(shipped()[name])
    (READERS.get(name) or READERS[Path(name).suffix])(folder() / name)


@pytest.mark.parametrize("name", KINDS)
@settings(max_examples=60, deadline=None)
@given(damage=damages)
def test_a_damaged_file_gives_an_error_of_blocks_or_what_it_says(
    name: str, damage: list[tuple[int, int, bytes]]
) -> None:
    check(name, damaged(shipped()[name], damage))


@pytest.mark.parametrize("name", KINDS)
@settings(max_examples=25, deadline=None)
@given(data=st.binary(max_size=300))
def test_random_bytes_give_an_error_of_blocks(name: str, data: bytes) -> None:
    check(name, data)


@settings(max_examples=60, deadline=None)
@given(damage=damages, member=st.sampled_from(["state.json", "rows"]))
def test_a_state_whose_members_are_damaged_is_refused_or_taken(
    damage: list[tuple[int, int, bytes]], member: str
) -> None:
    """The checksums of an archive find most damage; whoever makes a file makes these as well."""
    source, target = folder() / "whole.state", folder() / "s.state"
    source.write_bytes(shipped()["s.state"])
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            new.writestr(name, damaged(old.read(name), damage) if name == member else old.read(name))
    check("s.state", target.read_bytes())


@settings(max_examples=60, deadline=None)
@given(damage=damages)
def test_an_fmu_whose_description_is_damaged_is_refused_or_taken(damage: list[tuple[int, int, bytes]]) -> None:
    target = folder() / "x.fmu"
    with zipfile.ZipFile(target, "w") as new:
        new.writestr("modelDescription.xml", damaged(shipped()["modelDescription.xml"], damage))
    check("x.fmu", target.read_bytes())
