"""Whether the coefficients of a transfer function hold its poles, against exact tests of stability by fractions.

References: E. I. Jury, Theory and Application of the z-Transform Method, Wiley 1964 (polynomials of z); E. J. Routh's
array (of s). Both decide without rounding on the polynomials that doubles in reach of rounding are.
"""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from scipy import signal

from blocks import Biquad, Diagram, DiscreteTransferFunction, TransferFunction
from blocks.compile.conditioning import lost_poles
from tests.support.places import ROOT


def is_stable(den: Any, *, is_sampled: bool) -> bool:
    a = [Fraction(float(x)) for x in den]
    while is_sampled and len(a) > 1:
        if abs(a[-1]) >= abs(a[0]):
            return False
        ratio = a[-1] / a[0]
        a = [x - ratio * y for x, y in zip(a, reversed(a), strict=True)][:-1]
    upper, lower = a[::2], a[1::2]
    while lower and not is_sampled:
        if lower[0] * upper[0] <= 0:
            return False
        ratio = upper[0] / lower[0]
        longer = [*lower, *[Fraction(0)] * (len(upper) - len(lower))]
        upper, lower = lower, [x - ratio * y for x, y in zip(upper[1:], longer[1:], strict=True)]
    return True


def rounded(den: Any, count: int) -> list[Any]:
    """The polynomial, and others of which each coefficient is moved by up to half a unit in its last place."""
    random = np.random.default_rng(1)
    eps = float(np.finfo(float).eps)
    # A unit on either side: half a unit in the last place of a double that is just below a power of 2.
    return [den, *(den * (1 + eps * random.integers(-1, 2, len(den))) for _ in range(count))]


BANDS = [(5, (0.01, 0.02)), (4, (0.001, 0.002)), (6, (0.01, 0.02)), (8, (0.01, 0.02))]
LOWS = [(10, 0.01), (8, 0.001)]
HELD_BANDS = [(5, (0.1, 0.2)), (4, (0.01, 0.02)), (3, (0.01, 0.02)), (8, (0.1, 0.2))]
HELD_LOWS = [(10, 0.1), (6, 0.01), (4, 0.001)]


@pytest.mark.parametrize(("order", "band"), [*BANDS, *LOWS])
def test_poles_that_rounding_moves_over_the_border_are_lost(order: int, band: Any) -> None:
    den = signal.butter(order, band, "low" if np.isscalar(band) else "band")[1]
    assert lost_poles(tuple(den.tolist()), True)
    assert not all(is_stable(one, is_sampled=True) for one in rounded(den, 20))


@pytest.mark.parametrize(("order", "band"), [*HELD_BANDS, *HELD_LOWS])
def test_poles_that_rounding_leaves_on_their_side_are_held(order: int, band: Any) -> None:
    den = signal.butter(order, band, "low" if np.isscalar(band) else "band")[1]
    assert lost_poles(tuple(den.tolist()), True) == ()
    assert all(is_stable(one, is_sampled=True) for one in rounded(den, 20))


@pytest.mark.parametrize(("band", "is_lost"), [((1000, 1001), True), ((100, 200), False)])
def test_poles_of_a_continuous_band_pass_are_lost_where_it_is_narrow(band: Any, is_lost: bool) -> None:
    den = signal.butter(8, band, "band", analog=True)[1]
    assert bool(lost_poles(tuple(den.tolist()), False)) is is_lost
    assert all(is_stable(one, is_sampled=False) for one in rounded(den, 20)) is not is_lost


@pytest.mark.parametrize(
    ("poles", "is_sampled"),
    [
        ([0, 0, 0, -1], False),
        ([0, 2j, -2j, -1], False),
        ([1j, -1j, 3j, -3j, 5j, -5j], False),
        ([-1] * 10, False),
        ([1, 1, 0.9], True),
        ([1, 1, 1, 0.9, 0.7, 0.33], True),
        ([0.9] * 6, True),
        ([1, 0, 0, 0, 0, 0], True),
        ([0] * 30, True),
        (np.exp(0.0314j * np.array([1, -1, 3, -3, 5, -5])), True),
    ],
)
def test_integrators_resonances_and_multiple_poles_are_held(poles: Any, is_sampled: bool) -> None:
    den = np.real(np.poly(poles))
    assert lost_poles(tuple(den.tolist()), is_sampled) == ()


def test_dead_times_and_whole_combs_are_held() -> None:
    for order in (3, 5, 8):
        assert lost_poles(tuple(control.pade(0.2, order)[1]), False) == ()
    for last in (-1.0, -0.5):
        assert lost_poles((1.0, *[0.0] * 49, last), True) == ()


def test_a_diagram_warns_of_lost_poles_and_names_the_cure() -> None:
    band = {"N": 5, "Wn": [0.01, 0.02], "btype": "band"}
    num, den = signal.butter(**band)
    made = Diagram("filters")
    u = made.input("u", default=0.0)
    known = {
        "lost": DiscreteTransferFunction(num=num.tolist(), den=den.tolist(), period=0.005),
        "kept": Biquad(sos=signal.butter(**band, output="sos").tolist(), period=0.005),
        "plain": TransferFunction(num=[1.0], den=[1.0, 2.0, 1.0, 0.0, 0.0]),
        "narrow": TransferFunction(num=[1.0], den=signal.butter(8, [1000, 1001], "band", analog=True)[1].tolist()),
    }
    for name, block in known.items():
        made.add(name, block)
        made.wire(f"{name}.u", u)
    warnings = {fault.place: fault for fault in made.check().warnings}
    assert {place: fault.code for place, fault in warnings.items()} == {"lost": "W105", "narrow": "W105"}
    assert "Biquad" in warnings["lost"].cure
    assert "ZeroPoleGain" in warnings["narrow"].cure


def test_no_diagram_of_the_repository_is_warned() -> None:
    diagrams = [path for path in sorted((ROOT / "diagrams").rglob("*.json")) if _is_diagram(path)]
    assert len(diagrams) > 20
    for path in diagrams:
        text = path.read_text(encoding="utf-8")
        if "TransferFunction" in text:
            assert [fault for fault in Diagram.load(path).check().warnings if fault.code == "W105"] == []


def _is_diagram(path: Path) -> bool:
    return bool(json.loads(path.read_text(encoding="utf-8")).get("format") == "blocks-diagram")
