"""Random texts against the reader of diagrams and the expressions: an error of blocks or a diagram, nothing else.

    python -m pip install atheris                # Linux and macOS; in an environment of its own
    python -m benchmarks.fuzz --seconds 600      # writes what it found, and its corpus, into build/fuzz

A text that begins with "=" is an expression: it is parsed and computed. Any other one is a diagram: it is read,
written, read again, and flattened with the library. libFuzzer follows which branches of blocks a text reaches, and
keeps the texts that reach new ones; half of the changes are made on the tree of a document, to get past
the parser.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "build" / "fuzz"
LONGEST = 1 << 14  # bytes of a text
SLOWEST = 5  # s for one text
MEMORY = 1500  # MB
EXPRESSIONS = (
    "=kt/(La*Jeq*n)",
    "=2**-1**2",
    "=min(1, max(a, b, 3))",
    "=atan2(-1, .5e3)",
    "=sqrt(abs(-pi))",
    "=9**9**9",
)
WORDS = (
    "format",
    "blocks-diagram",
    "version",
    "parameters",
    "inputs",
    "outputs",
    "blocks",
    "wires",
    "run",
    "measures",
    "layout",
    "type",
    "diagram",
    "fmu",
    "variants",
    "variant",
    "ports",
    "enable",
    "trigger",
    "value",
    "unit",
    "csv",
    "column",
    "default",
    "size",
    "every",
    "stop",
    "method",
    "step",
    "log",
    "stops",
    "Gain",
    "Sum",
    "Integrator",
    "TransferFunction",
    "Expression",
    "Mux",
    "Selector",
    "g.u",
    "g.y",
    "[0]",
    "==",
    "**",
    "1e308",
    "5e-324",
    "\\ud800",
    "sqrt",
    "atan2",
    "V.s/rad",
    "kg.m2/s3",
)
ODD = (
    "null",
    "true",
    "0",
    "-1",
    "2",
    "1e308",
    "5e-324",
    "1e-18",
    '""',
    '"="',
    '"==x"',
    '"=a+1"',
    '"=pi"',
    '"=1/3"',
    '"V"',
    '"rad/s"',
    '"t"',
    "[]",
    "[1, 2]",
    "[[1, 2], [3]]",
    "{}",
    '"u[0]"',
    '"g.y"',
    '{"value": 1, "unit": "mV"}',
)


def changed(source: Any, chance: random.Random) -> Any:
    """A document with some parts taken out, moved, doubled, or replaced by something else."""
    for _ in range(chance.randint(1, 3)):
        places: list[tuple[Any, Any]] = []
        open_ = [source]
        while open_:
            node = open_.pop()
            for key, value in node.items() if isinstance(node, dict) else enumerate(node):
                places.append((node, key))
                if isinstance(value, dict | list):
                    open_.append(value)
        if not places:
            break
        node, key = chance.choice(places)
        other, other_key = chance.choice(places)
        copy = json.loads(json.dumps(other[other_key]))
        match chance.randint(0, 6):
            case 0:
                del node[key]
            case 1 if isinstance(node, dict):
                node[chance.choice([*WORDS, "a", "x-a", "a.b", "\x1b", str(other_key)])] = node.pop(key)
            case 2:
                node[key] = copy
            case 3 if isinstance(node, dict):
                node[chance.choice([*WORDS, str(other_key) + "2"])] = copy
            case 4 if isinstance(node[key], str):
                node[key] = node[key] + chance.choice(["x", "[0]", ".y", " ", "[99]", "*2", *WORDS])
            case 5 if isinstance(node[key], int | float) and not isinstance(node[key], bool):
                node[key] = chance.choice([-node[key], node[key] * 1000, node[key] / 3, node[key] + 1, str(node[key])])
            case _:
                node[key] = json.loads(chance.choice(ODD))
    return source


def corpus(folder: Path) -> None:
    """The diagrams that ship, small ones, and expressions, one file each."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, text in enumerate(EXPRESSIONS):
        (folder / f"expression{index}").write_text(text, encoding="utf-8")
    for path in sorted((ROOT / "diagrams").rglob("*.json")):
        if path.stat().st_size < LONGEST:
            (folder / path.stem).write_bytes(path.read_bytes())


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fuzz", description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=int, default=600, help="how long (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the random numbers; 0: a new one each time")
    parser.add_argument("text", nargs="?", help="try the text of this file only, such as build/fuzz/crash-...")
    options = parser.parse_args()
    try:
        import atheris
    except ImportError:
        print("atheris is not installed: python -m pip install atheris (Linux and macOS)", file=sys.stderr)
        return 2
    with atheris.instrument_imports(include=["blocks"]):
        from blocks.contract.expressions import Scalar, evaluate, exact_decimal, parse
        from blocks.library import LIBRARY
        from blocks.model import document
        from blocks.model.flatten import flatten
        from blocks.model.resolver import resolver_of
        from blocks.text.errors import ModelError
    resolver = resolver_of(LIBRARY)
    values = {name: Scalar(x, exact_decimal(x)) for name, x in {"a": 0.75, "b": -1.5, "kt": 0.0274, "La": 12.0}.items()}

    def told(error: ModelError) -> None:
        for fault in error.faults:
            assert fault.code.startswith("E"), fault
            assert str(fault).isprintable(), fault
            assert len(str(fault)) < 1500, fault

    def one(data: bytes) -> None:
        try:
            if data.startswith(b"="):
                result = evaluate(parse(data[1:].decode("utf-8", "replace")), values)
                assert math.isfinite(result.value)
                return
            value = document.loads(data, folder=ROOT / "diagrams")
            written = document.dumps(value)
            again = document.loads(written, folder=ROOT / "diagrams")
            assert again == value, "a diagram that is written and read is another one"
            assert document.dumps(again) == written, "a canonical text is written otherwise"
            flatten(value, resolver)
        except ModelError as error:
            told(error)

    def mutate(data: bytes, longest: int, seed: int) -> bytes:
        chance = random.Random(seed)
        if chance.random() < 0.5:
            try:
                source = json.loads(data)
                made = json.dumps(changed(source, chance)).encode()
                if isinstance(source, dict | list) and len(made) <= longest:
                    return made
            except (ValueError, RecursionError, TypeError):
                pass
        made_: bytes = atheris.Mutate(data, longest)
        return made_

    if options.text:
        one(Path(options.text).read_bytes())
        return 0
    corpus(FOLDER / "corpus")
    words = FOLDER / "words"
    words.write_text("".join(f'"{word}"\n'.replace("\\", "\\\\") for word in WORDS), encoding="utf-8")
    flags = [
        f"-max_total_time={options.seconds}",
        f"-max_len={LONGEST}",
        f"-timeout={SLOWEST}",
        f"-rss_limit_mb={MEMORY}",
        f"-dict={words}",
        f"-artifact_prefix={FOLDER}/",
        "-print_final_stats=1",
        f"-seed={options.seed}",
        str(FOLDER / "corpus"),
    ]
    atheris.Setup([sys.argv[0], *flags], one, custom_mutator=mutate)
    atheris.Fuzz()  # ends the process: 0 where nothing was found
    return 0


if __name__ == "__main__":
    sys.exit(main())
