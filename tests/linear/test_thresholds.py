"""Places where laws bend, as their operations tell, against a search along the input."""

from __future__ import annotations

import numpy as np
import pytest

from blocks import Block, Diagram, Input, Parameter, library, output
from blocks.frequency.law_corners import breaks_of
from blocks.linear.nonlinearities import StaticLaw, nonlinear
from blocks.linear.slopes import slopes_at
from blocks.linear.thresholds import evident

SAME = 1e-12  # a search ends within some roundings of what it looks at


class Many(Block):
    """Every operation that tells where it takes a value."""

    gain = Parameter(4.0)
    u = Input()

    @output
    def scaled(u, gain):
        return np.maximum(gain * (2.0 - u) / 3.0 - 1.0, 0.5)

    @output
    def folded(u, gain):
        return np.abs(np.abs(-u - 0.5) * gain - 2.0)

    @output
    def cut(u):
        return np.sign(np.minimum(u, 1.5) - 1.0) + np.sign(np.maximum(u, 1.5) - 1.0)

    @output
    def rooted(u):
        return np.abs(1.0 + u) ** 0.5 + 1.0 / (u - 3.0)


class Hidden(Block):
    """Laws whose operations do not tell."""

    u = Input()

    @output
    def twice(u):
        return np.abs(u * u + u - 1.0)

    @output
    def both(u):
        return np.maximum(u, np.sin(u))


def laws_of(block: Block) -> list[StaticLaw]:
    """The laws of one signal of a block alone, at rest."""
    slopes = slopes_at(Diagram.alone(block).point())
    graph, made = slopes.graph, []
    for node in np.nonzero(graph.variable >= 0)[0].tolist():
        for slot, coupled in nonlinear(graph, node).items():
            if coupled == {slot}:
                law = StaticLaw(slopes, node, [slot])
                made += [law] if law._switches else []
    return made


def told(law: StaticLaw) -> tuple[float, ...] | None:
    return evident(law.type.tape, law._switches, law.arguments[0], law._constant)


KINDS = (
    *(library.Saturation, library.DeadZone, library.SMESO, library.NLSEF, library.INLSEF),
    *(library.Abs, library.Sign),
)


@pytest.mark.parametrize(
    "block", [Many(), library.NESO(bandwidth=10.0), *(kind() for kind in KINDS)], ids=lambda block: type(block).__name__
)
def test_places_that_operations_tell_are_those_that_a_search_finds(block):
    laws = laws_of(block)
    assert laws
    for law in laws:
        known = told(law)
        assert known is not None, law.name
        found = breaks_of(law, -7.0, 7.1, law.switches)
        assert [u for u in known if abs(u) < 7.0] == pytest.approx(found, rel=SAME, abs=SAME), law.name


def test_places_are_those_of_the_equations():
    made = {law.row[0]: told(law) for law in laws_of(Many())}
    assert made["output:scaled"] == pytest.approx([0.875])  # 4 (2 - u)/3 - 1 = 0.5
    assert made["output:folded"] == (-1.0, -0.5, 0.0)
    assert made["output:cut"] == (1.0, 1.5)  # max(u, 1.5) never comes down to 1
    assert made["output:rooted"] == (-1.0, 3.0)


def test_laws_that_do_not_tell_are_searched():
    made = {law.row[0]: law for law in laws_of(Hidden())}
    assert told(made["output:twice"]) is None
    assert told(made["output:both"]) is None
    golden = (np.sqrt(5.0) - 1.0) / 2.0
    assert made["output:twice"].breaks(0.0, 1.0) == pytest.approx([-1.0 - golden, golden], rel=SAME)
