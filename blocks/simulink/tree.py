"""A Simulink model as it is written: systems with their blocks, lines, annotations and masks, whatever the file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(slots=True)
class Node:
    """One element of a file, in the form that both formats share.

    kind: the name of the element, or the class of an object. values: what it says, as text; "" is the text of an
    element without a name. file, line: where it begins; the file is a part of the package, or "" in a text file.
    """

    kind: str
    values: dict[str, str] = field(default_factory=dict)
    children: list[Node] = field(default_factory=list)
    file: str = ""
    line: int = 0

    def all(self, kind: str) -> list[Node]:
        """Return the children of a kind."""
        return [child for child in self.children if child.kind == kind]

    def walk(self) -> Iterator[Node]:
        """Yield this element and all below it, in the order of the file."""
        left = [self]
        while left:
            yield (node := left.pop())
            left.extend(reversed(node.children))


@dataclass(frozen=True, slots=True)
class End:
    """One end of a line.

    block: its name in the system. port: "1", "2", ..., "enable", "trigger", "ifaction", "lconn1", ....
    """

    block: str
    port: str


@dataclass(frozen=True, slots=True)
class Line:
    """A line from one port to others.

    source: None where it begins nowhere. open_ends: how many branches end nowhere.
    """

    source: End | None
    targets: tuple[End, ...]
    name: str = ""
    open_ends: int = 0
    file: str = ""
    line: int = 0


@dataclass(frozen=True, slots=True)
class Annotation:
    """A text on the drawing. position: of its corners, as it is written."""

    text: str
    position: str = ""


@dataclass(frozen=True, slots=True)
class Mask:
    """The mask of a block. parameters: names and expressions. initialization: MATLAB code, which is never run."""

    type: str
    parameters: Mapping[str, str]
    initialization: str = ""


@dataclass(frozen=True, slots=True)
class Block:
    """One block. type: its BlockType. values: its parameters as they are written, without defaults.

    path: from the model to the block, by names; names may hold slashes and line breaks. ports: how many it has, by
    "in", "out", "enable", "trigger", "state", "ifaction" and "reset", as far as the file tells. system: what is
    inside a SubSystem. script: the text of a MATLAB Function. callbacks: MATLAB code, which is never run.
    """

    type: str
    name: str
    sid: str
    path: tuple[str, ...]
    values: Mapping[str, str]
    ports: Mapping[str, int]
    system: System | None = None
    mask: Mask | None = None
    script: str = ""
    callbacks: Mapping[str, str] = field(default_factory=dict)
    file: str = ""
    line: int = 0


@dataclass(frozen=True, slots=True)
class System:
    """What is inside the model or a SubSystem; blocks by name."""

    blocks: Mapping[str, Block]
    lines: Sequence[Line]
    annotations: Sequence[Annotation]
    values: Mapping[str, str]

    def walk(self) -> Iterator[Block]:
        """Yield all blocks, those inside of others after them."""
        left = [*reversed([*self.blocks.values()])]
        while left:
            yield (block := left.pop())
            if block.system is not None:
                left.extend(reversed([*block.system.blocks.values()]))


@dataclass(frozen=True, slots=True)
class Model:
    """A model. kind: "Model", "Library", or "Subsystem": one that models refer to. settings: of the solver.

    defaults: parameters by type of block, as far as the file has them.
    callbacks: MATLAB code of the model, which is never run. workspace: the code of the model workspace; "" where it
    has none. unread: parts that are known and hold values, but are not read.
    """

    name: str
    path: Path
    kind: str
    settings: Mapping[str, str]
    defaults: Mapping[str, Mapping[str, str]]
    callbacks: Mapping[str, str]
    system: System
    workspace: str = ""
    unread: tuple[str, ...] = ()

    def value(self, block: Block, name: str) -> str | None:
        """Return a parameter of a block: its own value, else the default of the file; None: the file has neither."""
        own = block.values.get(name)
        return own if own is not None else self.defaults.get(block.type, {}).get(name)
