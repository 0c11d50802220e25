"""What a prepared diagram computes, block by block: its equations by their texts, what each block reads, its numbers.

It is computed only when it is asked for: a run that is neither saved nor written to a file pays nothing for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ..contract.equation_text import digest_of, equation_texts, hexadecimal, sha256
from ..contract.interface import Interface
from ..contract.resolution import Resolved
from ..contract.tape import Tape
from ..model.flatten import Flat, FlatBlock, InputSource, Source, ValueSource
from ..text.errors import BlocksError
from .coupling import Coupling
from .plan import Plan

__all__ = ["Equations"]

FORM = 1
"""The form of the texts of equations: digests of different forms cannot be compared."""

MOST_NUMBERS = 16
"""Parameters with more numbers are recorded as a digest."""

Record = dict[str, Any]


class Equations:
    """The equations of a diagram, and the numbers in them, by the tapes that a run was prepared with.

    `record` is what a saved state keeps, as plain data for JSON:

        form     1: that of the texts of equations
        types    each name of a block class, with the SHA-256 of the text of each equation by its heading
        numbers  the structural values, which are in the equations; the values of other parameters; the times (ticks and
                 delays); and a digest of the start values and of the nominal sizes
        inputs   of the diagram: type and shape
        blocks   by path: which type, which numbers, and where each input comes from

    Copies and pickles hold the record alone.
    """

    def __init__(self, flat: Flat, prepared: Plan | Coupling, family: object = None) -> None:
        """family: all of the same family have the same equations, and may differ in the values of parameters."""
        self.family = family
        self._make: Callable[[], Equations] | None = None
        # What the record is made of when it is first asked for; not kept after.
        self._prepared: tuple[Flat, Plan | Coupling] | None = (flat, prepared)
        self._record: Record | None = None
        self._files: dict[str, str] = {}  # the SHA-256 of the FMU of a block, by path
        if isinstance(prepared, Plan) and prepared.folded is not None:  # it has no FMUs and no programs
            return
        tapes = _tapes(prepared)
        for block in flat.blocks:
            foreign, stepper = block.interface.declaration.foreign, block.interface.declaration.stepper
            if foreign is not None:
                self._files[block.path] = _file(foreign.path)
            elif stepper is not None:
                equation_texts(tapes[block.path])  # now, while its source is what was imported

    @classmethod
    def later(cls, make: Callable[[], Equations], family: object) -> Equations:
        """Those that are made when they are asked for."""
        equations = cls.recorded(None)
        equations._make, equations.family = make, family
        return equations

    @property
    def is_to_be_made(self) -> bool:
        """Whether they are not known yet, but how to make them."""
        return self._record is None and self._make is not None

    @classmethod
    def read(cls, record: Any) -> Equations | None:
        """Those in the record of a file; None where there is no record, or one of another form.

        Raises ValueError where it is damaged.
        """
        if record is None or (isinstance(record, dict) and record.get("form") != FORM):
            return None
        _check(record)
        return cls.recorded(record)

    @classmethod
    def recorded(cls, record: Record | None) -> Equations:
        """Those in a record."""
        equations = cls.__new__(cls)
        equations._make, equations.family = None, None
        equations._prepared, equations._record, equations._files = None, record, {}
        return equations

    def __reduce__(self) -> tuple[Callable[[Any], Equations], tuple[Record]]:
        return Equations.recorded, (self.record,)

    @property
    def record(self) -> Record:
        """What a saved state keeps: made when it is first asked for, as a run that saves nothing needs none."""
        prepared = self._prepared  # before the record: another thread sets the record and clears this
        if self._record is not None:
            return self._record
        if self._make is not None:
            self._record = self._make().record
            return self._record
        assert prepared is not None
        flat, made = prepared
        blocks = flat.blocks
        recorder = _Recorder(blocks, flat.inputs, _tapes(made), self._files)
        record = recorder.record()
        for part in flat.enabled:
            for index in part.resets:
                reads = record["blocks"][blocks[index].path]["reads"]
                reads["begins anew with"] = ", ".join(filter(None, (reads.get("begins anew with"), part.path)))
        self._record = record
        self._prepared = None
        return record

    @cached_property
    def sha256(self) -> str:
        """The SHA-256 of what is computed, without the values of parameters: see docs/semantics.md for the text."""
        record = self.record
        digests = [digest_of(known["equations"]) for known in record["types"]]
        lines = [
            f"blocks-equations {FORM}",
            *(f"input {name} {record['inputs'][name]}" for name in sorted(record["inputs"])),
        ]
        for path in sorted(record["blocks"]):
            block = record["blocks"][path]
            lines.append(f"block {path} {digests[block['type']]}")
            times = record["numbers"][block["numbers"]]["times"]
            lines += (f"{name} = {block['reads'][name]}" for name in sorted(block["reads"]))
            lines += (f"{name} = {times[name]}" for name in sorted(times))
        return sha256("\n".join(lines))

    @cached_property
    def values_sha256(self) -> str:
        """The SHA-256 of the values of all parameters, and of what is computed from them before a run."""
        record = self.record
        digests = []
        for known in record["numbers"]:
            values = known["values"]
            digests.append(sha256("\n".join((*(f"{name} = {values[name]}" for name in sorted(values)), known["rest"]))))
        lines = (
            "blocks-values 1",
            *(f"{path} {digests[record['blocks'][path]['numbers']]}" for path in sorted(record["blocks"])),
        )
        return sha256("\n".join(lines))


def _tapes(prepared: Plan | Coupling) -> dict[str, Tape]:
    """The tapes of blocks by their paths."""
    plans = [unit.plan for unit in prepared.units] if isinstance(prepared, Coupling) else [prepared]
    return {instance.path: instance.tape for known in plans if known is not None for instance in known.instances}


def _file(path: Any) -> str:
    from ..fmi.archive import sha256_of

    try:
        return sha256_of(path)
    except (BlocksError, OSError):  # it is no longer there: its token says which one it was
        return ""


def _check(record: Any) -> None:
    def texts(entries: Any) -> bool:
        return isinstance(entries, dict) and all(isinstance(text, str) for text in entries.values())

    def within(block: Any, key: str) -> bool:
        return type(block[key]) is int and 0 <= block[key] < len(record[rows[key]])

    rows = {"type": "types", "numbers": "numbers"}
    try:
        is_valid = (
            all(isinstance(known["name"], str) and texts(known["equations"]) for known in record["types"])
            and all(isinstance(known["rest"], str) for known in record["numbers"])
            and all(texts(known[key]) for known in record["numbers"] for key in ("structure", "values", "times"))
            and texts(record["inputs"])
            and all(
                texts(block["reads"]) and within(block, "type") and within(block, "numbers")
                for block in record["blocks"].values()
            )
        )
    except (KeyError, TypeError, AttributeError):
        is_valid = False
    if not is_valid:
        raise ValueError("its record of the equations cannot be read")


class _Recorder:
    """Builds a record; what blocks share is made once."""

    def __init__(
        self, blocks: Sequence[FlatBlock], inputs: Any, tapes: Mapping[str, Tape], files: Mapping[str, str]
    ) -> None:
        self.blocks, self.inputs, self.tapes, self.files = blocks, inputs, tapes, files
        self.types: list[Record] = []
        self.numbers: list[Record] = []
        self.of_type: dict[Any, int] = {}
        self.of_numbers: dict[int, int] = {}
        self.outputs: dict[int, dict[tuple[str, int], str]] = {}  # by the id of an interface
        self.ends = [f"{i.name}[{e}]" if i.shape else i.name for i in inputs for e in range(math.prod(i.shape))]

    def record(self) -> Record:
        blocks = {}
        for block in self.blocks:
            blocks[block.path] = {
                "type": self.type_of(block),
                "numbers": self.numbers_of(block.resolved),
                "reads": dict(self.reads(block)),
            }
        inputs = {i.name: f"{i.type} {'x'.join(map(str, i.shape)) or 'scalar'}" for i in self.inputs}
        return {"form": FORM, "types": self.types, "numbers": self.numbers, "inputs": inputs, "blocks": blocks}

    def type_of(self, block: FlatBlock) -> int:
        tape, file = self.tapes.get(block.path), self.files.get(block.path, "")
        key = (id(tape), file, id(block.interface) if tape is None or file else 0)
        if key not in self.of_type:
            self.of_type[key] = len(self.types)
            foreign = block.interface.declaration.foreign
            if foreign is not None:
                known = foreign.description
                texts = {"fmu": f"FMI {known.fmi} {foreign.kind}\n{known.name}\n{known.token}\n{file}"}
            else:
                assert tape is not None
                texts = dict(equation_texts(tape))
            digests = {heading: sha256(text) for heading, text in texts.items()}
            self.types.append({"name": block.interface.name, "equations": digests})
        return self.of_type[key]

    def numbers_of(self, resolved: Resolved) -> int:
        if id(resolved) not in self.of_numbers:
            self.of_numbers[id(resolved)] = len(self.numbers)
            self.numbers.append(_numbers(resolved))
        return self.of_numbers[id(resolved)]

    def reads(self, block: FlatBlock) -> Iterator[tuple[str, str]]:
        """Where each input comes from, and the time, and whether the block is on."""
        for name, port in block.interface.inputs.items():
            sources = block.sources[port.variable][port.first : port.first + port.size]
            yield f"input {name}", ", ".join(map(self.source, sources))
        for what, index in (("enabled by", block.condition), ("time of", block.time)):
            if index is not None:
                yield what, self.blocks[index].path

    def source(self, source: Source) -> str:
        if isinstance(source, ValueSource):
            return hexadecimal(source.value)
        if isinstance(source, InputSource):
            return self.ends[source.element]
        index, variable, element = source
        block = self.blocks[index]
        return f"{block.path}.{self.names(block.interface).get((variable, element), f'{variable}[{element}]')}"

    def names(self, interface: Interface) -> Mapping[tuple[str, int], str]:
        """The names of the elements of a type's outputs and locals."""
        known = self.outputs.get(id(interface))
        if known is None:
            known = self.outputs[id(interface)] = {
                (port.variable, port.first + k): f"{name}[{k}]" if port.shape else name
                for name, port in (*interface.locals.items(), *interface.outputs.items())
                for k in range(port.size)
            }
        return known


def _numbers(resolved: Resolved) -> Record:
    declaration = resolved.interface.declaration
    # Structural values are in the equations of a type, where it has any.
    is_told = declaration.foreign is None and declaration.stepper is None
    structure: dict[str, str] = {}
    values: dict[str, str] = {}
    for name, value in resolved.values.items():
        if value.value is not None:
            fixes = is_told and declaration.parameters[name].structural
            (structure if fixes else values)[name] = _text(value.value)
    times = {f"ticks of {name}": f"every {every} s from {first} s" for name, (every, first) in resolved.clocks.items()}
    times |= {f"delay of {name}": f"{hexadecimal(delay)} s" for name, (delay, _) in resolved.delays.items()}
    rest = [f"start of {name} = {_text(start)}" for name, start in sorted(resolved.starts.items())]
    rest += [f"before of {name} = {_text(before)}" for name, (_, before) in sorted(resolved.delays.items())]
    rest.append(f"nominal = {_text(resolved.nominal)}")
    return {"structure": structure, "values": values, "times": times, "rest": sha256("\n".join(rest))}


def _signed(number: float) -> str:
    """A number exactly; -0.0 is another value than 0.0, as in atan2 and divisions."""
    return "-0x0p+0" if number == 0 and math.copysign(1.0, number) < 0 else hexadecimal(number)


def _text(value: Any) -> str:
    """A value exactly: a text as it is, numbers as hexadecimal floats in C order behind their shape."""
    if isinstance(value, str):
        return value
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":
        return " ".join(map(str, array.ravel()))
    numbers = " ".join(map(_signed, array.ravel().tolist()))
    if array.shape == ():
        return numbers
    shape = "x".join(map(str, array.shape))
    return f"{shape} {sha256(numbers)}" if array.size > MOST_NUMBERS else f"{shape} {numbers}"
