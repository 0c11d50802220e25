"""Identification: true values lie in their intervals as often as they should, and what the data do not say is told."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, FirstOrder, Fit, Gain, PMDCMotor, UsageError
from blocks.compile.toolchain.compiler import find_compiler

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")

TRUTH = {"motor.Ra": 0.2, "motor.La": 0.7, "motor.Jeq": 0.3, "motor.Beq": 0.35}
OVER = {"motor.Ra": (0.05, 1.0), "motor.La": (0.2, 2.0), "motor.Jeq": (0.1, 1.0), "motor.Beq": (0.1, 1.0)}
T = np.round(np.arange(0, 501) * 0.02, 12)
V = np.select([T < 1, T < 5], [0.0, 6.0], -2.0)
SPEED, CURRENT = 0.01, 0.05


@pytest.fixture(autouse=True)
def native(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows run in threads by the native engine; by another one they run in processes, which start anew each time."""
    monkeypatch.setenv("BLOCKS_ENGINE", "native")


def plant() -> Diagram:
    diagram = Diagram("plant")
    v, motor = diagram.input("v", unit="V"), diagram.add("motor", PMDCMotor())
    diagram.wire(motor.v, v)
    return diagram


@cache
def quiet() -> tuple[Any, Any]:
    results = plant().run(parameters=TRUTH, inputs={"v": (T, V, "hold")}, stop=10.0, every=0.02, rtol=1e-9, atol=1e-12)
    return np.asarray(results["motor.omega"]), np.asarray(results["motor.i"])


def recorded(seed: int, *, keep: Any = slice(None)) -> dict[str, Any]:
    """A noisy step."""
    draw, (omega, i) = np.random.default_rng(seed), quiet()
    omega, i = omega + SPEED * draw.standard_normal(len(T)), i + CURRENT * draw.standard_normal(len(T))
    return {"time": T[keep], "v": V[keep], "speed": omega[keep], "current": i[keep]}


def fitted(data: Any, over: Any = OVER, signals: tuple[str, ...] = ("omega", "i")) -> Fit:
    columns = {"motor.omega": "speed", "motor.i": "current"}
    compare = {f"motor.{name}": columns[f"motor.{name}"] for name in signals}
    made: Fit = plant().fit(data, over=over, compare=compare, interpolation="hold")
    return made


def test_true_values_lie_in_95_percent_intervals_about_so_often() -> None:
    fits = [fitted(recorded(seed)) for seed in range(8)]
    inside = sum(fit.intervals[k][0] <= true <= fit.intervals[k][1] for fit in fits for k, true in TRUTH.items())
    # 32 intervals: fewer than 27 inside has a probability of 0.2 % where 95 % are.
    assert inside >= 27
    for fit in fits:
        assert not fit.warnings
        assert fit.deviations == pytest.approx({"motor.omega": SPEED, "motor.i": CURRENT}, rel=0.15)
    # The spread of the estimates is what their standard errors say (8 of them know it to a quarter or so).
    for name in TRUTH:
        spread = np.std([fit.values[name] for fit in fits], ddof=1)
        assert 0.4 < spread / np.mean([fit.errors[name] for fit in fits]) < 2.0


def test_intervals_are_those_of_linear_regression_where_the_model_is_linear_in_its_parameter() -> None:
    draw, t = np.random.default_rng(3), np.linspace(0, 5, 101)
    u = np.sin(t)
    y = 1.7 * u + 0.1 * draw.standard_normal(101)
    fit = Diagram.alone(Gain(k=1)).fit(
        {"time": t, "u": u, "y": y}, over={"Gain.k": (0.5, 3.0)}, compare={"Gain.y": "y"}
    )
    slope = u @ y / (u @ u)
    error = np.sqrt(np.sum((y - slope * u) ** 2) / 100 / (u @ u))
    assert fit.values["Gain.k"] == pytest.approx(slope, rel=5e-6), "six digits"
    assert fit.errors["Gain.k"] == pytest.approx(error, rel=1e-5)
    assert fit.intervals["Gain.k"][1] - slope == pytest.approx(1.983972 * error, rel=1e-4), "t of 100 degrees"


def quiet_and_noisy() -> Diagram:
    """One gain k behind the input u, seen by two signals."""
    both = Diagram("both")
    both.parameter("k", 1)
    u = both.input("u")
    for name in ("quiet", "noisy"):
        both.wire(both.add(name, Gain(k="=k")).u, u)
    return both


def test_signals_of_unlike_noise_are_weighed_as_the_best_estimate_weighs_them() -> None:
    both, draw, t = quiet_and_noisy(), np.random.default_rng(4), np.linspace(0, 5, 101)
    x, deviations = np.sin(t), np.array([1e-4, 0.5])
    quiet, noisy = 1.7 * x + deviations[:, None] * draw.standard_normal((2, 101))
    fit = both.fit(
        {"time": t, "u": x, "a": quiet, "b": noisy}, over={"k": (0.5, 3)}, compare={"quiet.y": "a", "noisy.y": "b"}
    )
    weights = 1 / deviations**2
    best, error = weights @ [quiet @ x, noisy @ x] / (weights.sum() * (x @ x)), 1 / np.sqrt(weights.sum() * (x @ x))
    assert abs(fit.values["k"] - best) < 0.02 * error, "and is not rounded to more than its error"
    assert fit.errors["k"] == pytest.approx(error, rel=0.15)
    assert fit.deviations == pytest.approx({"quiet.y": 1e-4, "noisy.y": 0.5}, rel=0.15)


def test_a_quiet_signal_of_few_samples_gives_the_degrees_of_freedom() -> None:
    both, draw, t = quiet_and_noisy(), np.random.default_rng(6), np.linspace(0, 5, 101)
    x, few = np.sin(t), np.arange(101) % 25 == 10
    quiet = np.where(few, 1.7 * x + 1e-4 * draw.standard_normal(101), np.nan)
    data = {"time": t, "u": x, "a": quiet, "b": 1.7 * x + 0.5 * draw.standard_normal(101)}
    fit = both.fit(data, over={"k": (0.5, 3)}, compare={"quiet.y": "a", "noisy.y": "b"})
    # The noisy signal adds next to nothing, so that all is as with the quiet one alone: t of three degrees of freedom.
    slope = quiet[few] @ x[few] / (x[few] @ x[few])
    error = np.sqrt(np.sum((quiet - slope * x)[few] ** 2) / 3 / (x[few] @ x[few]))
    assert fit.intervals["k"] == pytest.approx((slope - 3.182446 * error, slope + 3.182446 * error), abs=0.02 * error)


LAGS = {"K": 2.0, "T": 0.7, "a": 0.5}
NOISE = {"first.y": 1e-4, "second.y": 0.5, "third.y": 0.02}


@cache
def lags() -> tuple[Diagram, Any, Any, dict[str, Any]]:
    """Two lags and a gain of three parameters; times, the input, and the signals without noise."""
    diagram = Diagram("lags")
    for name, value in {"K": 1.5, "T": 0.8, "a": 0.4}.items():
        diagram.parameter(name, value)
    first, second = diagram.add("first", FirstOrder(k="=K", T="=T")), diagram.add("second", FirstOrder(k=1, T="=a"))
    third = diagram.add("third", Gain(k="=K*a"))
    for sink, source in ((first.u, diagram.input("u")), (second.u, first.y), (third.u, second.y)):
        diagram.wire(sink, source)
    t = np.round(np.linspace(0, 6, 121), 12)
    u = np.where(t < 3, 1.0, -0.5)
    accurate: dict[str, Any] = {"stop": 6.0, "every": 0.05, "log": list(NOISE), "rtol": 1e-9, "atol": 1e-12}
    true = diagram.run(parameters=LAGS, inputs={"u": (t, u, "hold")}, **accurate)
    return diagram, t, u, {name: np.asarray(true[name]) for name in NOISE}


def lag_fits(count: int, seeds: int) -> list[Fit]:
    """Fits of the first `count` signals to data of different noise; of one signal two parameters follow."""
    diagram, t, u, true = lags()
    over = dict([("K", (0.5, 6.0)), ("T", (0.2, 2.0)), ("a", (0.1, 2.0))][: max(2, min(count + 1, 3))])
    fits = []
    for seed in range(seeds):
        draw, data = np.random.default_rng(seed), {"time": t, "u": u}
        for name in list(NOISE)[:count]:
            data[name] = true[name] + NOISE[name] * draw.standard_normal(len(t))
        fits.append(diagram.fit(data, over=over, compare={n: n for n in list(NOISE)[:count]}, interpolation="hold"))
    return fits


def test_estimates_of_signals_of_unlike_noise_are_off_by_no_more_than_their_errors_say() -> None:
    for fit in lag_fits(3, 4):
        assert not fit.warnings
        for name, value in fit.values.items():
            # 12 numbers of a normal distribution: one in 1,300 such sets has one beyond 4.
            assert abs(value - LAGS[name]) < 4 * fit.errors[name]


@pytest.mark.long
@pytest.mark.parametrize("count", [1, 2, 3])
def test_95_of_100_intervals_hold_the_truth(count: int) -> None:
    fits = lag_fits(count, 200)
    inside = [low <= LAGS[name] <= high for fit in fits for name, (low, high) in fit.intervals.items()]
    assert 0.93 <= np.mean(inside) <= 0.97


def test_a_speed_alone_does_not_tell_four_parameters_apart() -> None:
    fit = fitted(recorded(1), signals=("omega",))
    (warning,) = fit.warnings
    assert warning.code == "W502"
    assert all(name in f"{warning.place}: {warning.message}" for name in TRUTH)
    assert fit.intervals["motor.Ra"][0] < 0
    three = fitted(recorded(1), {name: OVER[name] for name in list(OVER)[:1]}, signals=("omega",))
    assert not three.warnings


def test_what_has_no_effect_is_told() -> None:
    over = {"motor.Ra": OVER["motor.Ra"], "motor.i_start": (-1e-9, 1e-9)}
    codes = [(fault.code, fault.place) for fault in fitted(recorded(1), over).warnings]
    assert ("W502", "motor.i_start") in codes


def test_data_of_a_file_with_uneven_times_and_gaps_are_fitted_and_written(tmp_path: Path) -> None:
    keep = np.sort(np.random.default_rng(5).choice(len(T), 300, replace=False))
    data = recorded(2, keep=keep)
    data["current"] = np.where(np.arange(300) % 7 == 0, np.nan, data["current"])
    rows = [",".join(data), *(",".join("" if np.isnan(x) else repr(float(x)) for x in row)
                              for row in zip(*data.values(), strict=True))]  # fmt: skip
    (tmp_path / "step.csv").write_text("\n".join(rows))
    plant().save(tmp_path / "plant.json")
    fit = Diagram.load(tmp_path / "plant.json").fit(
        tmp_path / "step.csv", over=OVER, compare={"motor.omega": "speed", "motor.i": "current"}, interpolation="hold"
    )
    # Inputs are held from row to row here, so that edges of the voltage lie up to some samples off.
    for name, true in TRUTH.items():
        assert fit.values[name] == pytest.approx(true, rel=0.25)
    fit.write(tmp_path / "plant.json")
    again = Diagram.load(tmp_path / "plant.json").flatten().blocks[0].resolved.values
    assert {name: float(again[name.split(".")[1]].value) for name in fit.values} == pytest.approx(dict(fit.values))
    assert "data - fit" in fit.plot().axes[1].get_ylabel()


@pytest.mark.parametrize(
    ("data", "compare", "said"),
    [
        ({"time": [0, 1, 2], "v": [0, 1, 2]}, {"motor.omega": "speed"}, "has no column speed"),
        ({"time": [0, 2, 1], "v": [0, 1, 2], "speed": [0, 1, 2]}, {"motor.omega": "speed"}, "times must increase"),
        ({"time": [0.0], "speed": [0.0]}, {"motor.omega": "speed"}, "fewer than two rows"),
        ("nowhere.csv", {"motor.omega": "speed"}, "cannot be read"),
        ({"time": [0, 1]}, {}, "contains no signal"),
        ({"time": [0, 1]}, ["motor.omega"], "compare: must be a mapping"),
        (
            {"time": [0, 1], "v": [0, 1], "speed": [np.nan] * 2},
            {"motor.omega": "speed"},
            "speed: has 0 values, too few for 1",
        ),
        ({"time": [0, 1], "v": [0, 1], "speed": [1]}, {"motor.omega": "speed"}, "one value for each time"),
        (
            {"time": [0, 1], "v": [0, 1], "speed": ["a", 1]},
            {"motor.omega": "speed"},
            "contains a value that is not a number",
        ),
        (
            {"time": [0, 1], "v": [0, 1], "speed": [1, np.inf]},
            {"motor.omega": "speed"},
            "inf in its column speed",
        ),
        ({"time": [0, 1], "v": [-np.inf, 1], "speed": [1, 2]}, {"motor.omega": "speed"}, "-inf .* v, row 1"),
        ({"time": [0, 1], "v": [0, 1], "speed": [1e300, 2]}, {"motor.omega": "speed"}, r"1e\+300 in its column speed"),
        ({"time": [1e8, 1e8 + 1], "v": [0, 1], "speed": [1, 2]}, {"motor.omega": "speed"}, "the run begins at 0 s"),
    ],
)
def test_data_that_cannot_be_compared_are_refused(data: Any, compare: dict[str, str], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        plant().fit(data, over={"motor.Ra": (0.1, 1)}, compare=compare)


def test_a_level_is_a_share() -> None:
    with pytest.raises(UsageError, match="level: must be a number between 0 and 1"):
        plant().fit({"time": [0, 1]}, over={"motor.Ra": (0.1, 1)}, compare={}, level=95)


def lag_data(first: float, dt: float = 0.05) -> dict[str, Any]:
    """A lag of gain 2 and 0.7 s from rest, as a clock that begins at `first` records it; noise 1e-3."""
    t = np.arange(101) * dt
    u = np.where(t < 50 * dt, 1.0, -1.0)
    y = 2 * (1 - np.exp(-t / 0.7)) - np.where(t < 50 * dt, 0.0, 4 * (1 - np.exp(-(t - 50 * dt) / 0.7)))
    return {"time": first + t, "u": u, "y": y + 1e-3 * np.random.default_rng(1).standard_normal(101)}


def lag_fit(data: Any, **settings: Any) -> Fit:
    made: Fit = Diagram.alone(FirstOrder(k=1, T=1), "lag").fit(
        data, over={"FirstOrder.k": (0.1, 10), "FirstOrder.T": (0.1, 10)}, compare={"FirstOrder.y": "y"},
        interpolation="hold", **settings,
    )  # fmt: skip
    return made


@pytest.mark.parametrize("first", [0.0, 1e8, 1.7e9])
@pytest.mark.parametrize("dt", [0.05, 0.037])
def test_the_clock_of_the_data_changes_no_estimate(first: float, dt: float) -> None:
    fit = lag_fit(lag_data(first, dt), start=first)
    assert not fit.warnings
    for name, true in {"FirstOrder.k": 2.0, "FirstOrder.T": 0.7}.items():
        assert abs(fit.values[name] - true) < 4 * fit.errors[name]
    assert fit.deviations["FirstOrder.y"] == pytest.approx(1e-3, rel=0.3)


def test_a_run_that_holds_the_first_input_before_the_data_is_told_unless_it_is_meant() -> None:
    (warning,) = lag_fit(lag_data(100.0)).warnings
    assert (warning.code, warning.place) == ("W505", "time")
    assert (
        "begin at 100 s and the run at 0 s: until then the run holds the first value of u for 100 s" in warning.message
    )
    for meant in ({"start": 100}, {"start": 0}):
        assert not lag_fit(lag_data(100.0), **meant).warnings
    assert not lag_fit(lag_data(0.05)).warnings, "the first sample comes after a period"


def test_times_in_another_unit_are_converted_and_those_of_another_quantity_refused(tmp_path: Path) -> None:
    data = recorded(3)
    over = {"motor.Ra": OVER["motor.Ra"]}
    expected = fitted(data, over)
    for times in ({"value": 1000 * T, "unit": "ms"}, {"value": T, "unit": "s"}):
        assert fitted({**data, "time": times}, over).values == pytest.approx(expected.values, rel=1e-6)
    path = tmp_path / "data.csv"
    columns = np.column_stack([1000 * T, data["v"], data["speed"], data["current"]])
    np.savetxt(path, columns, delimiter=",", header='# units: {"time": "ms"}\ntime,v,speed,current', comments="")
    assert fitted(path, over).values == pytest.approx(expected.values, rel=1e-6)
    with pytest.raises(UsageError, match=r"E501 time: .*kg"):
        fitted({**data, "time": {"value": T, "unit": "kg"}}, over)
