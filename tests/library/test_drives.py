"""Clarke and Park: closed forms of balanced phases, matrices of the literature, and the power that they keep."""

import numpy as np
import pytest

from blocks import Clarke, Diagram, InverseClarke, InversePark, Park, Ramp, Sine
from tests.support.library_variants import evaluate

THIRD = 2.0 * np.pi / 3.0


def test_balanced_phases_are_a_vector_at_rest_in_turning_axes() -> None:
    """cos(theta + phi) and its shifted ones: d = cos phi, q = sin phi, of the same amplitude."""
    d = Diagram("balanced")
    clarke, park, back = d.add("clarke", Clarke()), d.add("park", Park()), d.add("back", InversePark())
    phases, angle = d.add("phases", InverseClarke()), d.add("angle", Ramp(slope=100.0, unit="rad"))
    for k, name in enumerate("abc"):
        sine = Sine(amplitude=325.0, omega=100.0, phase=np.pi / 2.0 + 0.4 - k * THIRD, bias=7.0, unit="V")
        d.wire(f"clarke.{name}", d.add(f"v{name}", sine).y)
    for block in (park, back):
        d.wire(block.theta, angle.y)
    for name in ("alpha", "beta"):
        d.wire(f"park.{name}", f"clarke.{name}")
        d.wire(f"phases.{name}", f"back.{name}")
    for name in "dq":
        d.wire(f"back.{name}", f"park.{name}")
    d.wire(phases.zero, clarke.zero)
    results = d.run(stop=0.1, every=0.001)
    assert results["park.d"] == pytest.approx(325.0 * np.cos(0.4), rel=1e-12)
    assert results["park.q"] == pytest.approx(325.0 * np.sin(0.4), rel=1e-12)
    assert results["clarke.zero"] == pytest.approx(7.0, rel=1e-12)
    for name in "abc":
        assert results[f"phases.{name}"] == pytest.approx(results[f"v{name}.y"], abs=1e-11)


def test_the_transformations_are_the_matrices_of_krause() -> None:
    """Of the book's matrix to axes at theta, which names q what lies on phase a at theta = 0 and d what lags it."""
    random = np.random.default_rng(2)
    for _ in range(5):
        theta, *abc = random.uniform(-3.0, 3.0, 4)
        shifts = theta - THIRD * np.arange(3.0)
        q, d, zero = 2.0 / 3.0 * np.vstack([np.cos(shifts), np.sin(shifts), [0.5] * 3]) @ abc
        clarke = evaluate("Clarke", **dict(zip("abc", abc, strict=True)))
        park = evaluate("Park", alpha=clarke["alpha"][0], beta=clarke["beta"][0], theta=theta - np.pi / 2.0)
        assert (park["d"][0], park["q"][0], clarke["zero"][0]) == pytest.approx((d, q, zero), abs=1e-14)


@pytest.mark.parametrize("scaling", ["amplitude", "power"])
def test_the_inverse_undoes_and_power_is_kept(scaling: str) -> None:
    random = np.random.default_rng(3)
    v, i = random.normal(size=(2, 3))
    seen = [evaluate("Clarke", {"scaling": scaling}, **dict(zip("abc", x, strict=True))) for x in (v, i)]
    vectors = [np.array([made[name][0] for name in ("alpha", "beta", "zero")]) for made in seen]
    for x, (alpha, beta, zero) in zip((v, i), vectors, strict=True):
        made = evaluate("InverseClarke", {"scaling": scaling}, alpha=alpha, beta=beta, zero=zero)
        assert [made[name][0] for name in "abc"] == pytest.approx(x, abs=1e-14)
    weights = {"amplitude": [1.5, 1.5, 3.0], "power": [1.0, 1.0, 1.0]}[scaling]
    assert np.sum(weights * vectors[0] * vectors[1]) == pytest.approx(v @ i, rel=1e-13)
