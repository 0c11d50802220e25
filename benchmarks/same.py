"""Whether two checkouts do the same: `python -m benchmarks.same BASE` prints what differs between BASE and this one.

BASE is a folder, or a revision of this repository. Both do the same work on the same files (those of BASE) in processes
of their own, side by side, by the same Python; what they say and compute is compared to the last bit and letter:

    names       public names, members, signatures
    told        what commands print about blocks, codes, options, files: list, explain, schema, --help, check, fmt, diff
    drawn       drawings
    runs        shipped diagrams and a large one x methods x engines, whole and resumed: rows, events, measures, counts
    analysed    linear models, observers, the paper's study with its report
    code        the C that runs compile, and the compiler's arguments, as text; and as `cc -E -P` leaves it
    fmus        exported FMUs: descriptions, files, tokens
    faults      what commands say of hostile files, and of shipped files with one value changed, misspelt or taken out
    loads       states, results and the cache that BASE wrote, read by both

Exit code 1 where something differs. `--only PART ...` takes some of them, `--as-c` compares code as `cc -E -P` leaves
it alone (comments and names of files may differ then). `--share N` takes every N-th diagram, hostile file and changed
value of what takes long: with 8 it is done in minutes. Times, paths and addresses are no part of what is compared.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import difflib
import hashlib
import importlib.util
import inspect
import io
import json
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import traceback
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parents[1]
PARTS = ("names", "told", "drawn", "runs", "analysed", "code", "fmus", "faults", "loads")
METHODS: dict[str, dict[str, Any]] = {
    "dopri5": {"rtol": 1e-6, "atol": 1e-9},
    "radau": {"rtol": 1e-5, "atol": 1e-8},
    "rk4": {"step": 0.001},
    "euler": {"step": 0.001},
}
STOP = 1.5  # s: what the reference engine runs of each diagram
MUTANTS = 800
REFUSED = ("ModelError", "UsageError", "SimulationError", "FMUError", "AnalysisError")
MEMORY = 500 * 2**20  # bytes
SHOWN = 40  # lines of one difference

# What differs from run to run: times, places, addresses.
FLEETING = (
    (re.compile(r"done in [0-9.]+ s"), "done in ... s"),
    (re.compile(r"[0-9]+ %  t = [^\n]*\n"), ""),
    (re.compile(r"0x[0-9a-f]{6,}"), "0x..."),
    (re.compile(r'"(?:seconds|created|started|generationDateAndTime)": ?"?[^,"}]*"?'), '"..."'),
    (re.compile(r'generationDateAndTime="[^"]*"'), 'generationDateAndTime="..."'),
    (re.compile(r"/tmp/[\w./-]*"), "/tmp/..."),
    (re.compile(r"\b[0-9.]+ (?:m|u|µ)?s(?= of the processor| CPU)"), "... s"),
)

Facts = Iterator[tuple[str, str]]


# --- what one checkout does: this part runs in a process whose `blocks` is that of the checkout -----------------


class Probe:
    """The work of one checkout, in the folder `work`, which holds copies of BASE's files."""

    def __init__(self, root: Path, work: Path, tests: Path, share: int) -> None:
        self.root, self.work, self.tests, self.share = root, work, tests, share
        self.diagrams = sorted(
            path.relative_to(work)
            for path in (work / "diagrams").rglob("*.json")
            if '"blocks-diagram"' in path.read_text(encoding="utf-8")
        )
        self.studies = sorted(
            path.relative_to(work)
            for path in (work / "diagrams").rglob("*.json")
            if '"blocks-study"' in path.read_text(encoding="utf-8")
        )

    def plain(self, text: str) -> str:
        """A text without what is fleeting."""
        text = text.replace(str(self.work), "<work>").replace(str(self.root), "<blocks>")
        for pattern, put in FLEETING:
            text = pattern.sub(put, text)
        return text

    def command(self, *words: str) -> str:
        """What `blocks ...` prints, and how it ends."""
        from blocks.cli import main

        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                status: Any = main(list(words))
            except SystemExit as ended:
                status = ended.code
        return self.plain(f"{out.getvalue()}-- stderr\n{err.getvalue()}-- {status}\n")

    # --- the parts

    def names(self) -> Facts:
        import blocks
        from blocks import analysis, compare, library

        yield "blocks", "\n".join(dir(blocks))
        yield "blocks.library.LIBRARY", "\n".join(library.LIBRARY)
        for module in (blocks, analysis, compare):
            for name in module.__all__:
                yield f"{module.__name__}.{name}", "\n".join(_shape(getattr(module, name)))

    def told(self) -> Facts:
        from blocks.library import LIBRARY

        listed = self.command("explain")
        codes = sorted(set(re.findall(r"\b[EW][0-9]{3}\b", listed)))
        yield "explain", listed
        for code in codes:
            yield f"explain {code}", self.command("explain", code)
        yield "list", self.command("list")
        yield "list --json", self.command("list", "--json")
        for name in LIBRARY:
            yield f"list {name}", self.command("list", name)
        for kind in ("diagram", "study"):
            yield f"schema {kind}", self.command("schema", kind)
        yield "--help", self.command("--help")
        verbs = re.findall(r"^ {4}([a-z]+) ", self.command("--help"), re.MULTILINE)
        for verb in verbs:
            yield f"{verb} --help", self.command(verb, "--help")
        for path in (*self.diagrams, *self.studies):
            yield f"check {path}", self.command("check", str(path))
            yield f"check --json {path}", self.command("check", "--json", str(path))
            yield f"fmt {path}", self.command("fmt", "--check", str(path))
        for a, b in zip(self.diagrams, self.diagrams[1:], strict=False):
            yield f"diff {a} {b}", self.command("diff", str(a), str(b))
        for path in sorted((self.work / "fmus").glob("*.fmu")):
            for verb in ("info", "check"):
                yield f"fmu {verb} {path.name}", self.command("fmu", verb, f"fmus/{path.name}")

    def drawn(self) -> Facts:
        from blocks import Diagram

        for path in self.diagrams:
            for depth in (0, 1, 3):
                yield f"draw {path} {depth}", Diagram.load(path).draw(depth=depth)

    def runs(self) -> Facts:
        for name, load in self.models():
            for method, settings in METHODS.items():
                for engine in ("native", "reference"):
                    given = {**settings, "method": method, "stop": STOP}
                    yield f"run {name} {method} {engine}", self.guarded(_run, load, engine, given)
                    yield f"resume {name} {method} {engine}", self.guarded(_resumed, load, engine, given)
            yield f"run {name} as it stands", self.guarded(_run, load, "native", {})

    def models(self) -> Iterator[tuple[str, Callable[[], Any]]]:
        """Diagrams by name, and how each is made anew."""
        from blocks import Diagram

        for path in self.diagrams[:: self.share]:
            yield str(path), lambda path=path: Diagram.load(path)
        yield "large", _large

    def guarded(self, work: Callable[..., str], *given: Any) -> str:
        from blocks import BlocksError

        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return work(*given)
        except BlocksError as error:
            return self.plain(f"{type(error).__name__}: {error}")

    def analysed(self) -> Facts:
        motor, robot = "diagrams/motor_pid.json", "diagrams/paper/iadrc.json"
        watched = "diagrams/analysis/smeso_pd.json"
        for words in (
            ("linearize", motor, "--from", "control.y", "--to", "motor.omega"),
            ("linearize", motor, "--loop", "control.y", "--at", "3", "--json"),
            ("linearize", motor, "--from", "control.u", "--to", "motor.omega"),
            ("linearize", robot, "--loop", "control_right.u", "--at", "5"),
            ("linearize", watched, "--loop", "motor.v", "--amplitude", "eso.e=0.1"),
            ("observer", watched, "eso", "--json"),
            ("observer", watched, "eso"),
            ("study", "diagrams/paper/study.json", "--out", "report"),
            ("study", "diagrams/paper_fmu/study.json", "--out", "report_fmu", "--markdown"),
        ):
            yield " ".join(words), self.command(*words)
        yield "report", self.plain((self.work / "report" / "report.html").read_text(encoding="utf-8"))

    def code(self) -> Facts:
        """From what the runs before compiled: see `_compiler`."""
        calls = set()
        for folder in sorted((self.work / "calls").iterdir()):
            arguments = (folder / "arguments").read_text(encoding="utf-8").splitlines()
            flags = [word for word in arguments if word.startswith(("-D", "-std")) or folder.joinpath(word).is_dir()]
            flags = [word if word.startswith("-") else f"-I{word}" for word in flags]
            headers = "".join(_digest(path.read_bytes()) for path in sorted(folder.rglob("*.h")))
            for source in (word for word in arguments if word.endswith(".c") and folder.joinpath(word).is_file()):
                text = folder.joinpath(source).read_bytes()
                as_c = _preprocessed(folder, source, *flags)
                shown = " ".join("FILE" if word.endswith((".c", ".o", ".so")) else word for word in arguments)
                calls.add((_digest(as_c.encode()), _digest(text) + _digest(headers.encode()), self.plain(shown)))
        assert len(calls) > 20, "the compiler was hardly called"
        for number, name in enumerate(("as C", "text", "arguments")):
            yield name, "\n".join(sorted({call[number] for call in calls}))

    def fmus(self) -> Facts:
        for name, load in self.models():
            for fmi in (2, 3):
                yield from self.exported(f"{name} FMI {fmi}", load, fmi)

    def exported(self, name: str, load: Callable[[], Any], fmi: int) -> Facts:
        path = self.work / "exported.fmu"
        path.unlink(missing_ok=True)
        said = self.guarded(lambda: str(load().export(path, fmi=fmi) and ""))
        if not path.exists():
            yield f"{name} refused", said
            return
        with zipfile.ZipFile(path) as archive, tempfile.TemporaryDirectory() as folder:
            archive.extractall(folder)
            inside = sorted(archive.namelist())
            described = Path(folder, "modelDescription.xml").read_text(encoding="utf-8")
            said_token = str(re.findall(r'(?:guid|instantiationToken)="([^"]*)"', described)[0])
            yield f"{name} files", "\n".join(inside)
            yield f"{name} token", said_token
            for entry in inside:
                file = Path(folder, entry)
                if entry.endswith(".xml"):
                    text = self.plain(file.read_text(encoding="utf-8"))
                    yield f"{name} {entry}", text.replace(said_token, "TOKEN")
                elif entry.endswith(".c"):
                    yield f"{name} {entry} text", _digest(file.read_bytes())
                    as_c = _preprocessed(file.parent, file.name).replace(said_token, "TOKEN")
                    yield f"{name} {entry} as C", _digest(as_c.encode())
                elif entry.endswith(".h"):
                    yield f"{name} {entry} text", _digest(file.read_bytes())
                elif not file.is_dir() and not entry.startswith("binaries/"):
                    yield f"{name} {entry}", _digest(file.read_bytes())

    def faults(self) -> Facts:
        yield from self.hostile()
        yield from self.mutants()

    def hostile(self) -> Facts:
        place = importlib.util.spec_from_file_location("hostile_cases", self.tests)
        assert place is not None
        assert place.loader is not None
        module = importlib.util.module_from_spec(place)
        sys.modules[place.name] = module
        place.loader.exec_module(module)
        for case in module.CASES[:: self.share]:
            with tempfile.TemporaryDirectory(dir=self.work) as folder:
                inside = Path(folder, "project")
                inside.mkdir()
                (inside / "pyproject.toml").touch()
                for name in module.NAMES:
                    (inside / f"{name}.py").write_text(module.CANARY, encoding="utf-8")
                Path(folder, "outside.json").write_text("{}", encoding="utf-8")
                case.put(inside)
                for reads in case.reads:
                    engine = ["--engine", "reference"] if reads[0] == "run" else []
                    words = (*reads, *engine, *(["--json"] if reads[0] != "draw" else []))
                    said = self.bounded(words, inside).replace(Path(folder).name, "<folder>")
                    yield f"hostile {case.name[:60]!r} {' '.join(reads)}", said

    def bounded(self, words: tuple[str, ...], folder: Path) -> str:
        """A command in a process of its own, which gets no more than MEMORY on top of what this one holds."""
        with tempfile.TemporaryFile() as said:
            child = os.fork()
            if not child:
                status = 1
                try:
                    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
                    resource.setrlimit(resource.RLIMIT_AS, (held + MEMORY, held + MEMORY))
                    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
                    os.chdir(folder)
                    said.write(self.command(*words).encode("utf-8", "backslashreplace"))
                    said.flush()
                    status = 0
                except BaseException:
                    said.write(traceback.format_exc().encode())
                    said.flush()
                finally:
                    os._exit(status)
            ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            said.seek(0)
            return f"{said.read().decode('utf-8')}ended with {ended}"

    def mutants(self) -> Facts:
        """Shipped and golden files, one value of each replaced, misspelt or taken out: by one seed for all."""
        choice = random.Random(1)
        golden = sorted(path.relative_to(self.work) for path in self.work.glob("golden/*v1.json"))
        files = [*self.diagrams, *self.studies, *golden]
        documents = {path: json.loads((self.work / path).read_text(encoding="utf-8")) for path in files}
        everywhere = [(path, place) for path, made in documents.items() for place in _places(made)]
        for number, (path, place) in enumerate(choice.sample(everywhere, min(MUTANTS // self.share, len(everywhere)))):
            made = copy.deepcopy(documents[path])
            what = _mutated(made, place, choice)
            file = path.with_name("mutant.json")
            (self.work / file).write_text(json.dumps(made, indent=1), encoding="utf-8")
            label = f"mutant {number} of {path}: {'.'.join(map(str, place))} {what}"
            yield label, self.command("check", "--json", str(file))
            if number % 10 == 0:
                yield f"{label}, in words", self.command("check", str(file))
            (self.work / file).unlink()

    def loads(self) -> Facts:
        """What BASE left: the folder of what it wrote is BASE's in both."""
        from blocks import Diagram, Results

        kept = self.work / "kept"
        for path in self.diagrams[:: self.share]:
            folder = kept / _digest(str(path).encode())[:16]
            for engine in ("native", "reference"):
                state = folder / f"{engine}.state"
                if state.exists():
                    given: dict[str, Any] = {"stop": STOP, "resume": state}
                    text = self.guarded(_run, lambda path=path: Diagram.load(path), engine, given)
                    yield f"state {path} {engine}", text
            for file in sorted(folder.glob("results.*")):
                yield f"results {path} {file.suffix}", self.guarded(lambda file: _digest_of(Results.load(file)), file)

    def leave(self) -> None:
        """Write the states and results that `loads` reads."""
        from blocks import BlocksError, Diagram

        for path in self.diagrams[:: self.share]:
            folder = self.work / "kept" / _digest(str(path).encode())[:16]
            folder.mkdir(parents=True, exist_ok=True)
            for engine in ("native", "reference"):
                with contextlib.suppress(BlocksError):
                    run = Diagram.load(path).start(engine=engine, inputs=_inputs(Diagram.load(path)))
                    run.advance_to(STOP / 2)
                    run.save(folder / f"{engine}.state")
            with contextlib.suppress(BlocksError):
                results = Diagram.load(path).run(stop=STOP, inputs=_inputs(Diagram.load(path)))
                for ending in ("csv", "parquet", "mat"):
                    results.save(folder / f"results.{ending}")


def _shape(thing: Any) -> Iterator[str]:
    """The signature of a function; of a class its public members and theirs."""
    if inspect.isclass(thing):
        for name in dir(thing):
            if not name.startswith("_") or name in ("__init__", "__call__"):
                member = inspect.getattr_static(thing, name)
                member = getattr(member, "__func__", getattr(member, "fget", member))
                told = str(inspect.signature(member)) if inspect.isfunction(member) else type(member).__name__
                yield f"{name} {told} {inspect.getdoc(member) if inspect.isfunction(member) else ''}"
    elif callable(thing):
        yield f"{inspect.signature(thing)} {inspect.getdoc(thing)}"
    else:
        yield type(thing).__name__


def _inputs(diagram: Any) -> dict[str, float]:
    """A value for every input that has none of its own."""
    inputs = diagram.to_json().get("inputs", {})
    return {name: 0.5 for name, entry in inputs.items() if "default" not in entry and not entry.get("size")}


def _large() -> Any:
    """More instances than are emitted anew each time."""
    from blocks import Diagram
    from blocks.library import FirstOrder, Gain, Sine

    made = Diagram("large")
    source = made.add("source", Sine(omega=3.0)).y
    for k in range(150):
        gain = made.add(f"g{k}", Gain(k=0.99))
        lag = made.add(f"lag{k}", FirstOrder(T=0.1 + 0.001 * k))
        made.wire(gain.u, source)
        made.wire(lag.u, gain.y)
        source = lag.y
    made.settings(stop=2, every=0.01, log=["lag0.y", "lag149.y"])
    return made


def _run(load: Callable[[], Any], engine: str, settings: dict[str, Any]) -> str:
    diagram = load()
    resumed = "resume" in settings
    return _digest_of(diagram.run(engine=engine, inputs=None if resumed else _inputs(diagram), **settings))


def _resumed(load: Callable[[], Any], engine: str, settings: dict[str, Any]) -> str:
    diagram = load()
    run = diagram.start(engine=engine, inputs=_inputs(diagram), **settings)
    run.advance_to(settings["stop"] / 2)
    state = run.snapshot()
    first = _digest_of(run.results)
    return first + "\n" + _digest_of(load().run(engine=engine, resume=state, **settings))


def _digest_of(results: Any) -> str:
    """All that results hold but times and places."""
    seen = results.statistics
    lines = [
        f"t {len(results.t)} {_digest(results.t.tobytes())}",
        *(f"{name} [{results[name].unit}] {_digest(results[name].tobytes())}" for name in results.names),
        *(f"event {event}" for event in results.events),
        *(f"measure {name} {float(value).hex()}" for name, value in results.measures.items()),
        *(f"warning {fault}" for fault in results.warnings),
        f"{seen.method} {seen.engine} {seen.steps} {seen.rejected} {seen.evaluations} {seen.instants}",
    ]
    return "\n".join(lines)


def _digest(raw: bytes) -> str:
    return hashlib.sha256(raw).hexdigest()


def _preprocessed(folder: Path, source: str, *flags: str) -> str:
    """C without comments, with what it includes in its place: what the compiler sees."""
    command = ["cc", "-E", "-P", *flags, source]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return done.stdout


def _places(node: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if place:
        yield place
    for key, item in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield from _places(item, (*place, key))


def _mutated(document: Any, place: tuple[Any, ...], choice: random.Random) -> str:
    """Change a document at a place; returns what was done."""
    node = document
    for step in place[:-1]:
        node = node[step]
    last = place[-1]
    what = choice.choice(("taken out", "misspelt", "replaced"))
    if what == "taken out":
        del node[last]
    elif what == "misspelt" and isinstance(last, str):
        node[last + choice.choice("xs")] = node.pop(last)
    elif what == "misspelt" and isinstance(node[last], str):
        node[last] += choice.choice("xs")
    else:
        node[last] = choice.choice([None, True, -1, 0, 2.5, "", "x", "=nothing", "3 kg", [], [1, "a"], {}, {"a": 1}])
        what = f"= {node[last]!r}"
    return what


def probe(root: str, work: str, tests: str, share: str, parts: list[str]) -> None:
    """Do the parts and write what is so, one JSON list a line."""
    sys.path[:] = [root, *(path for path in sys.path if Path(path or ".").resolve() not in (HERE, HERE / "benchmarks"))]
    import blocks

    assert Path(str(blocks.__file__)).resolve().is_relative_to(Path(root).resolve()), blocks.__file__
    os.chdir(work)
    made = Probe(Path(root), Path(work), Path(tests), int(share))
    with open(Path(work, "facts"), "a", encoding="utf-8", buffering=1) as file:
        for part in parts:
            if part == "leave":
                made.leave()
                continue
            for name, text in getattr(made, part)():
                file.write(json.dumps([part, name, text]) + "\n")
            print(f"{part} done: {root}", file=sys.stderr, flush=True)


# --- the comparison --------------------------------------------------------------------------------------------


def _compiler(work: Path) -> Path:
    """A compiler that keeps what it is given in `work`/calls before it does its work."""
    (work / "calls").mkdir()
    file = work / "recording-cc"
    real = shutil.which(os.environ.get("CC", "") or "cc")
    file.write_text(
        f"""#!/bin/sh
for word in "$@"; do case "$word" in
  *.c) [ -n "$kept" ] || {{ kept=$(mktemp -d "{work}/calls/XXXXXXXXXX"); cp -r . "$kept"; }};;
esac; done
[ -z "$kept" ] || printf '%s\\n' "$@" > "$kept/arguments"
exec {real} "$@"
"""
    )
    file.chmod(0o755)
    return file


def _start(root: Path, work: Path, tests: Path, share: int, parts: list[str]) -> subprocess.Popen[bytes]:
    surroundings = {name: value for name, value in os.environ.items() if name not in ("BLOCKS_ENGINE", "PYTHONPATH")}
    surroundings |= {
        "BLOCKS_CACHE_DIR": str(work / "cache"),
        "CC": str(work / "recording-cc"),
        "MPLCONFIGDIR": str(work / "mpl"),
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONHASHSEED": "0",
        "COLUMNS": "120",
        "SOURCE_DATE_EPOCH": "0",
    }
    where = map(str, (root, work, tests, share))
    command = [sys.executable, "-P", str(Path(__file__).resolve()), "--probe", *where, *parts]
    return subprocess.Popen(command, cwd=work, env=surroundings, stdin=subprocess.DEVNULL)


def _checkout(base: str, folder: Path) -> Path:
    """The folder of BASE: itself, or what a revision of this repository holds."""
    if Path(base, "blocks").is_dir():
        return Path(base).resolve()
    made = folder / "base"
    made.mkdir()
    packed = subprocess.run(["git", "-C", str(HERE), "archive", base], capture_output=True, check=True).stdout
    subprocess.run(["tar", "-x", "-C", str(made)], input=packed, check=True)
    return made


def _facts(work: Path) -> dict[tuple[str, str], str]:
    with open(work / "facts", encoding="utf-8") as file:
        return {(part, name): text for part, name, text in map(json.loads, file)}


def _report(parts: list[str], base: dict[tuple[str, str], str], ours: dict[tuple[str, str], str], as_c: bool) -> int:
    """Print what differs, part by part; the number of differences."""
    differing = 0
    for part in PARTS:
        keys = [key for key in {**base, **ours} if key[0] == part]
        if as_c:
            keys = [key for key in keys if not key[1].endswith((" text", " token")) and key[1] != "text"]
        unlike = [key for key in keys if base.get(key) != ours.get(key)]
        differing += len(unlike)
        if part in parts:
            refused = sum(ours.get(key, "").startswith(REFUSED) for key in keys)
            print(f"{part:10}{len(keys):6} compared, {len(unlike)} differ; {refused} are refusals", flush=True)
            if not any(ours.get(key) for key in keys):
                raise RuntimeError(f"{part}: there is nothing to compare")
        for key in unlike:
            old, new = base.get(key, ""), ours.get(key, "")
            lines = list(difflib.unified_diff(old.splitlines(), new.splitlines(), "base", "ours", lineterm="", n=0))
            print(f"  {key[1]}")
            for line in lines[2 : SHOWN + 2]:
                print(f"    {line[:300]}")
            if len(lines) > SHOWN + 2:
                print(f"    ... {len(lines) - SHOWN - 2} lines more")
    return differing


def main(arguments: list[str] | None = None) -> int:
    reads = argparse.ArgumentParser(prog="python -m benchmarks.same", description=(__doc__ or "").split("\n")[0])
    reads.add_argument("base", metavar="BASE", help="a checkout's folder, or a revision of this repository")
    reads.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART", help=", ".join(PARTS))
    reads.add_argument("--as-c", action="store_true", help="compare C without its comments and names of files")
    reads.add_argument("--share", type=int, default=1, metavar="N", help="take every N-th of what takes long")
    reads.add_argument("--keep", metavar="DIR", help="keep what both did in this folder")
    given = reads.parse_args(arguments)
    if "code" in given.only and "runs" not in given.only:
        reads.error("code: what runs compile is compared: --only runs code")
    with contextlib.ExitStack() as stack:
        top = Path(given.keep or stack.enter_context(tempfile.TemporaryDirectory(prefix="blocks-same-"))).resolve()
        top.mkdir(parents=True, exist_ok=True)
        roots = {"base": _checkout(given.base, top), "ours": HERE}
        hostile = next(HERE.glob("tests/**/hostile.py"))
        works = {}
        for side in roots:
            works[side] = top / f"work-{side}"
            works[side].mkdir()
            (works[side] / "pyproject.toml").touch()  # the mark of a project: its own FMUs may run
            for name in ("diagrams", "fmus"):
                shutil.copytree(roots["base"] / name, works[side] / name)
            golden = next(roots["base"].glob("tests/**/golden"))
            shutil.copytree(golden, works[side] / "golden")
            _compiler(works[side])
        parts = [part for part in PARTS if part in given.only and part != "loads"]
        if _failed([_start(roots[side], works[side], hostile, given.share, parts) for side in roots]):
            return 2
        if "loads" in given.only:
            if _failed([_start(roots["base"], works["base"], hostile, given.share, ["leave"])]):
                return 2
            for name in ("kept", "cache"):
                shutil.rmtree(works["ours"] / name, ignore_errors=True)
                shutil.copytree(works["base"] / name, works["ours"] / name)
            if _failed([_start(roots[side], works[side], hostile, given.share, ["loads"]) for side in roots]):
                return 2
        differing = _report(given.only, *(_facts(works[side]) for side in roots), given.as_c)
    print("the same" if not differing else f"{differing} differences")
    return int(differing > 0)


def _failed(processes: list[subprocess.Popen[bytes]]) -> bool:
    ended = [process.wait() for process in processes]
    if any(ended):
        print(f"a process ended with {ended}", file=sys.stderr)
    return any(ended)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--probe"]:
        probe(*sys.argv[2:6], sys.argv[6:])
    else:
        sys.exit(main())
