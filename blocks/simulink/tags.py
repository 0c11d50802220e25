"""Goto and From across systems: tags are led through ports, so that each From has its Goto in its own system.

A Goto is led up from its system by Outports to the system that holds both, and down by Inports to each From.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from .tree import Block, End, Line, Model, System

_Path = tuple[str, ...]


@dataclass(slots=True)
class _Added:
    """Holds the blocks and lines that a system gets, and how many ports of each kind its own block gets."""

    blocks: list[Block] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)
    ports: dict[str, int] = field(default_factory=lambda: {"in": 0, "out": 0})


def tag_of(model: Model, block: Block) -> str:
    """Return the tag of a Goto or From."""
    return model.value(block, "GotoTag") or "A"


def with_tags(model: Model) -> System:
    """Return the system of a model with tags led through ports; the same one if none crosses a border."""
    tags: dict[_Path, set[str]] = {}
    gotos: dict[str, _Path] = {}
    froms: list[tuple[_Path, str]] = []
    for path, block in _walk(model.system, ()):
        tag = tag_of(model, block)
        if block.type == "Goto":
            tags.setdefault(path, set()).add(tag)
            if (model.value(block, "TagVisibility") or "local") != "local":
                gotos.setdefault(tag, path)
        elif block.type == "From":
            froms.append((path, tag))
    added: dict[_Path, _Added] = {}
    for path, tag in froms:
        if tag in tags.get(path, ()) or tag not in gotos:
            continue
        shared = 0
        while shared < min(len(path), len(gotos[tag])) and path[shared] == gotos[tag][shared]:
            shared += 1
        for depth in range(len(gotos[tag]), shared, -1):
            _lead(model.system, added, tags, gotos[tag][:depth], tag, is_up=True)
        for depth in range(shared + 1, len(path) + 1):
            _lead(model.system, added, tags, path[:depth], tag, is_up=False)
    return _rebuilt(model.system, (), added) if added else model.system


def _walk(system: System, path: _Path) -> Iterator[tuple[_Path, Block]]:
    left = [(path, system)]
    while left:
        path, system = left.pop()
        for name, block in system.blocks.items():
            yield path, block
            if block.system is not None:
                left.append(((*path, name), block.system))


def _lead(
    top: System, added: dict[_Path, _Added], tags: dict[_Path, set[str]], path: _Path, tag: str, *, is_up: bool
) -> None:
    """Lead a tag out of the system of a path, or into it."""
    outer, inner = (path[:-1], path) if is_up else (path, path[:-1])  # where the tag will be given, and is
    if tag in tags.setdefault(outer, set()):
        return
    tags[outer].add(tag)
    kind = "out" if is_up else "in"
    here = added.setdefault(path, _Added())
    system = top
    for name in path:
        found = system.blocks[name].system
        assert found is not None
        system = found
    here.ports[kind] += 1
    port = "Outport" if is_up else "Inport"
    number = str(sum(one.type == port for one in system.blocks.values()) + here.ports[kind])
    source, sink, own = f"from tag {tag}", f"to tag {tag}", f"tag {tag}"
    for place, block in ((inner, _block("From", source, tag)), (outer, _block("Goto", sink, tag))):
        if all(one.name != block.name for one in added.setdefault(place, _Added()).blocks):
            added[place].blocks.append(block)
    here.blocks.append(replace(_block(port, own, tag), values={"Port": number}))
    if is_up:
        here.lines.append(Line(End(source, "1"), (End(own, "1"),)))
        added[outer].lines.append(Line(End(path[-1], number), (End(sink, "1"),)))
    else:
        added[inner].lines.append(Line(End(source, "1"), (End(path[-1], number),)))
        here.lines.append(Line(End(own, "1"), (End(sink, "1"),)))


def _block(kind: str, name: str, tag: str) -> Block:
    return Block(kind, name, "", (name,), {"GotoTag": tag}, {})


def _rebuilt(system: System, path: _Path, added: dict[_Path, _Added]) -> System:
    blocks = dict(system.blocks)
    for name, block in system.blocks.items():
        at = (*path, name)
        if block.system is not None and any(one[: len(at)] == at for one in added):
            more = added.get(at, _Added()).ports
            ports = {**block.ports, **{key: block.ports.get(key, 0) + count for key, count in more.items() if count}}
            blocks[name] = replace(block, system=_rebuilt(block.system, at, added), ports=ports)
    own = added.get(path, _Added())
    blocks |= {block.name: replace(block, path=(*path, block.name)) for block in own.blocks}
    return replace(system, blocks=blocks, lines=[*system.lines, *own.lines])
