"""The collector of circular garbage waits while a diagram is read and planned, and is then as it was."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from blocks import Constant, Diagram, Gain, ModelError
from blocks.compile.plan_builder import plan
from blocks.host.gc_pause import paused
from blocks.library import LIBRARY
from blocks.model import document
from blocks.model.flatten import flatten


@pytest.fixture(autouse=True)
def collector() -> Iterator[None]:
    yield
    gc.enable()


def test_it_waits_and_goes_on() -> None:
    with paused():
        assert not gc.isenabled()
        with paused():
            assert not gc.isenabled()
        assert not gc.isenabled()
    assert gc.isenabled()


def test_an_error_does_not_leave_it_off() -> None:
    diagram = Diagram("lost")
    diagram.add("gain", Gain(k=2.0))
    with pytest.raises(ModelError, match="E101"):
        diagram.plan()
    assert gc.isenabled()


def test_one_that_is_off_stays_off() -> None:
    gc.disable()
    with paused():
        pass
    assert not gc.isenabled()


def test_it_waits_while_a_diagram_is_read_flattened_and_planned() -> None:
    diagram = Diagram("small")
    for n in range(300):
        diagram.add(f"b{n}", Constant(value=float(n)))
    text = diagram.dumps()
    resolver = LIBRARY.__getitem__
    document.loads(text)  # what is imported or kept the first time is no part of it
    searches = 0

    def note(phase: str, told: dict[str, int]) -> None:
        nonlocal searches
        searches += phase == "start"

    def counted(work: Callable[[], Any]) -> tuple[Any, int]:
        before = searches
        return work(), searches - before

    limits = gc.get_threshold()
    gc.set_threshold(1)  # a search at every second new object
    gc.callbacks.append(note)
    try:
        _, unpaused = counted(lambda: [[] for _ in range(10_000)])
        value, read = counted(lambda: document.loads(text))
        flat, flattened = counted(lambda: flatten(value, resolver))
        _, planned = counted(lambda: plan(flat))
    finally:
        gc.callbacks.remove(note)
        gc.set_threshold(*limits)
    # A few come before and behind each.
    assert unpaused > 100
    assert max(read, flattened, planned) < 100
