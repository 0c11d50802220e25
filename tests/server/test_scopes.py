"""Scopes: what pages get of rows. The witness for fewer rows is a loop over bins, in Python numbers."""

import hashlib
import json
import math
import re
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import blocks
from blocks.results.results import Event
from blocks.server.curves import Curve, Window, extremes, firsts, packed, values_at
from blocks.server.measured import LARGEST, Measured
from blocks.server.scopes import EventRows, Page, Scope
from blocks.text.errors import UsageError

VENDOR = Path(blocks.__file__).parent / "server" / "page" / "vendor"


class Rows:
    """A run that stands in: rows up to `count`."""

    def __init__(self, t: Any, values: Any, columns: Any = None) -> None:
        self.all_t, self.all_values = np.asarray(t, float), np.asarray(values, float)
        self.columns = columns or {f"s{k}": (k, (), "V") for k in range(self.all_values.shape[1])}
        self.count = len(self.all_t)
        self.fired: list[Event] = []

    def rows(self) -> tuple[Any, Any]:
        return self.all_t[: self.count], self.all_values[: self.count]

    @property
    def prepared(self) -> Any:
        return SimpleNamespace(plan=SimpleNamespace(settings=SimpleNamespace(start=Fraction(0), stop=Fraction(7))))

    @property
    def t(self) -> float:
        return float(self.all_t[self.count - 1]) if self.count else 0.0

    def events(self, since: int) -> list[Event]:
        return self.fired[since:]


def unpacked(frame: bytes) -> tuple[dict[str, Any], Any, Any]:
    length = int.from_bytes(frame[:4], "little")
    assert (4 + length) % 8 == 0
    header, count = json.loads(frame[4 : 4 + length]), 0
    count = header["count"]
    t = np.frombuffer(frame, "<f8", count, 4 + length)
    columns = np.frombuffer(frame, "<f4", offset=4 + length + 8 * count).reshape(len(header["signals"]), count)
    return header, t, columns


class Shown:
    """What a page has of a curve after the frames so far."""

    def __init__(self, curve: Curve) -> None:
        self.curve, self.t, self.columns, self.frames, self.rows = curve, np.empty(0), np.empty(0), 0, 0

    def take(self, until: float = math.inf) -> bool:
        new = self.curve.frame(until)
        if new is None:
            return False
        since, t, columns = new
        self.t = np.append(self.t[:since], t)
        self.columns = np.append(self.columns[:, :since], columns, axis=1) if since else columns
        self.frames, self.rows = self.frames + 1, self.rows + len(t)
        return True


def slowly(t: Any, values: Any, origin: float, step: float) -> tuple[list[float], list[float]]:
    """Least and largest value of each bin, one value after the other."""
    bins: dict[int, list[tuple[float, float]]] = {}
    for time, value in zip(t.tolist(), values.tolist(), strict=True):
        bins.setdefault(math.floor((time - origin) / step), []).append((time, value))
    times, picked = [], []
    for rows in bins.values():
        numbers = [value for _, value in rows if not math.isnan(value)] or [math.nan]
        low, high = min(numbers), max(numbers)
        order = [low, high]
        if not math.isnan(low):
            found = [value for _, value in rows]
            order = [low, high] if found.index(low) <= found.index(high) else [high, low]
        ends = [(rows[0][0], order[0]), (rows[-1][0], order[1])][: len(rows)]
        times += [time for time, _ in ends]
        picked += [value for _, value in ends]
    return times, picked


def random_rows(count: int, seed: int) -> Rows:
    """Uneven times with jumps (two rows at one time), and columns with NaN and infinities."""
    rng = np.random.default_rng(seed)
    t = np.sort(np.append(rng.uniform(0.0, 7.0, count // 2), rng.uniform(2.0, 2.01, count - count // 2)))
    t[rng.integers(1, count, count // 50)] = 3.0
    values = rng.normal(size=(count, 3))
    values[rng.integers(0, count, count // 3), 1] = np.nan
    values[count // 4 : count // 2, 1] = np.nan
    values[rng.integers(0, count, 5), 2] = [np.inf, -np.inf, 1e300, -1e300, np.nan]
    return Rows(np.sort(t), values)


@pytest.mark.parametrize("seed", range(4))
def test_least_and_largest_values_of_bins_are_those_of_a_loop(seed: int) -> None:
    run = random_rows(3000, seed)
    t, values = run.rows()
    origin, step = float(t[0]), 7.0 / 200
    times, reduced, first, places = extremes(t, list(values.T), origin, step)
    for k in range(3):
        wanted_t, wanted = slowly(t, values[:, k], origin, step)
        assert times.tolist() == wanted_t
        with np.errstate(over="ignore"):
            assert np.array_equal(reduced[k], np.array(wanted).astype(np.float32), equal_nan=True)
    # Bins begin where they say: what lies before is the same without them.
    for row, place in zip(first[1:], places[1:], strict=True):
        assert extremes(t[:row], list(values[:row].T), origin, step)[0].tolist() == times[:place].tolist()


@pytest.mark.parametrize(
    ("window", "extent"),
    [
        ({}, 7.0),
        ({}, None),
        ({"span": 1.5}, 7.0),
        ({"t0": 1.0, "t1": 4.0}, 7.0),
        ({"t0": 1.9, "t1": 2.1}, None),
    ],
)
def test_frames_of_a_growing_run_end_as_one_frame_of_the_whole(window: dict[str, float], extent: float | None) -> None:
    run = random_rows(6000, 9)
    whole = Shown(Curve(run, [(0, 1.0), (1, 1.0)], Window(width=100, **window), extent))
    whole.take()
    run.count = 0
    shown = Shown(Curve(run, [(0, 1.0), (1, 1.0)], Window(width=100, **window), extent))
    rng = np.random.default_rng(1)
    while run.count < 6000:
        run.count = min(6000, run.count + int(rng.integers(0, 40)))
        shown.take()
    t, values = run.rows()
    begin = t[-1] - 1.5 if "span" in window else window.get("t0", -1.0)
    end = window.get("t1", 8.0)
    assert not shown.take()
    inside = (t >= begin) & (t <= end)
    for k in (0, 1):
        seen = shown.columns[k][(shown.t >= begin) & (shown.t <= end)]
        assert np.nanmin(seen) == np.float32(np.nanmin(values[inside, k]))
        assert np.nanmax(seen) == np.float32(np.nanmax(values[inside, k]))
    assert np.all(np.diff(shown.t) >= 0)
    if extent is not None and "span" not in window:
        assert np.array_equal(shown.t, whole.t)
        assert np.array_equal(shown.columns, whole.columns, equal_nan=True)
    assert len(whole.t) <= 4 * 100 + 4


@pytest.mark.parametrize("width", [400, 20])
def test_the_last_rows_may_change_until_others_follow(width: int) -> None:
    run, rng = random_rows(1000, 3), np.random.default_rng(4)
    shown = Shown(Curve(run, [(0, 1.0), (2, 1.0)], Window(width=width), 7.0))
    for count in range(0, 1000, 7):
        run.count = count + 1
        right = run.all_values[count].copy()
        run.all_values[count] = rng.normal(size=3) + 100.0
        shown.take()
        assert count == 0 or shown.columns[0].max() > 90.0
        run.all_values[count] = right
    run.count = 1000
    shown.take()
    whole = Shown(Curve(run, [(0, 1.0), (2, 1.0)], Window(width=width), 7.0))
    whole.take()
    assert np.array_equal(shown.t, whole.t)
    assert np.array_equal(shown.columns, whole.columns, equal_nan=True)


def test_few_rows_come_as_they_are_and_a_peak_of_one_row_is_seen_among_many() -> None:
    t = np.linspace(0.0, 1.0, 400)
    few = Shown(Curve(Rows(t, np.sin(t)[:, None]), [(0, 2.0)], Window(width=100), 1.0))
    few.take()
    assert np.array_equal(few.t, t)
    assert np.array_equal(few.columns[0], (2.0 * np.sin(t)).astype(np.float32))
    t = 1e5 + np.linspace(0.0, 1.0, 200_001)
    values = np.zeros((len(t), 1))
    values[123_456] = 7.0
    many = Shown(Curve(Rows(t, values), [(0, 1.0)], Window(width=500), 1.0))
    many.take()
    assert len(many.t) <= 2002
    assert many.columns[0].max() == 7.0
    assert abs(many.t[many.columns[0].argmax()] - t[123_456]) < 1.0 / 500


def test_a_frame_looks_at_new_rows_only_whatever_was_recorded_before() -> None:
    class Counted(np.ndarray[Any, Any]):
        looked = 0

        def __getitem__(self, key: Any) -> Any:
            made = super().__getitem__(key)
            if isinstance(key, tuple):
                Counted.looked += len(made)
            return np.asarray(made) if isinstance(key, tuple) else made

    run = Rows(np.arange(100_000) * 1e-3, np.zeros((100_000, 1)))
    run.all_values = run.all_values.view(Counted)
    for window, extent in (({}, 100.0), ({"span": 5.0}, 100.0), ({}, None)):
        run.count, Counted.looked = 0, 0
        shown = Shown(Curve(run, [(0, 1.0)], Window(width=100, **window), extent))
        while run.count < 100_000:
            run.count += 500
            shown.take()
        assert shown.frames == 200
        assert Counted.looked < 5 * 100_000
        assert shown.rows < 40_000


def test_frames_hold_times_as_float64_after_a_padded_header() -> None:
    t = np.array([1e4, 1e4 + 1e-9])
    header, times, columns = unpacked(packed({"scope": "a", "signals": ["x", "é"]}, t, np.array([[1, 2], [3, np.nan]])))
    assert header == {"scope": "a", "signals": ["x", "é"], "count": 2}
    assert times.tolist() == t.tolist()
    assert np.array_equal(columns, [[1, 2], [3, np.nan]], equal_nan=True)


def test_values_at_a_time_lie_on_lines_between_rows_and_right_of_a_jump() -> None:
    columns = {"x": (0, (), "m"), "v": (1, (2,), "V")}
    run = Rows([0.0, 1.0, 1.0, 3.0], [[0, 0, np.inf], [2, 1, 1], [5, 1, 1], [9, 2, 1]], columns)
    assert values_at(run, 0.5) == {"x": 1.0, "v": [0.5, None]}
    assert values_at(run, 1.0) == {"x": 5.0, "v": [1.0, 1.0]}
    assert values_at(run, 3.0)["x"] == 9.0
    assert values_at(run, -0.1) == values_at(run, 3.1) == {}


def page_of(run: Rows, *signals: str, **window: float) -> tuple[Page, Scope]:
    page, scope = Page(), Scope("1", signals, Window(width=200, **window))
    assert [*page.frames(1, run)] == []
    page.open(scope)
    return page, scope


def test_a_page_gets_its_signals_ghosts_files_and_events() -> None:
    columns = {"x": (0, (), "rad/s"), "v": (1, (2,), "V")}
    run = Rows(np.arange(8.0), np.arange(24.0).reshape(8, 3), columns)
    run.fired = [Event(2.5, "relay", "crossing"), Event(2.5001, "relay", "crossing"), Event(6.0, "b", "event")]
    page, scope = page_of(run, "x", "v", "unknown")
    page.ghosts[7] = Rows(np.arange(4.0), np.ones((4, 1)), {"x": (0, (), "rad/s")})
    page.files["lab.csv"] = Measured.read("lab.csv", "time [ms],x [rpm],other [mV]\n0,30,1\n1000,,2\n")
    scope.signals = ("x", "v", "unknown", "lab.csv|other")
    page.refresh()
    frames = [unpacked(frame) for frame in page.frames(1, run)]
    headers = [header for header, _, _ in frames]
    wanted = [["x", "v[0]", "v[1]"], ["x"], ["x", "other"], ["cause", "count"]]
    assert [header["signals"] for header in headers] == wanted
    assert [header.get("ghost", header.get("overlay")) for header in headers] == [None, 7, "lab.csv", None]
    assert headers[2]["units"] == ["rad/s", "V"]
    assert frames[2][1].tolist() == [0.0, 1.0]
    assert np.allclose(frames[2][2], [[math.pi, np.nan], [1e-3, 2e-3]], equal_nan=True)
    assert headers[3]["events"] == [["relay", "crossing"], ["b", "event"]]
    assert frames[3][1].tolist() == [2.5, 6.0]
    assert frames[3][2].tolist() == [[0, 1], [2, 1]]
    run.fired.append(Event(6.5, "b", "event"))
    assert [*page.frames(1, run)] == []  # before it has drawn what it got
    page.is_ready = True
    assert [unpacked(frame)[1].tolist() for frame in page.frames(1, run)] == [[2.5, 6.0, 6.5]]


def test_ghosts_come_as_far_as_the_run_that_a_scope_follows() -> None:
    run = Rows(np.linspace(0.0, 7.0, 701), np.zeros((701, 1)))
    page, _ = page_of(run, "s0", span=2.0)
    page.ghosts[3] = Rows(np.linspace(0.0, 7.0, 701), np.ones((701, 1)))
    run.count = 301
    page.refresh()
    ghost = next(t for header, t, _ in map(unpacked, page.frames(1, run)) if "ghost" in header)
    assert 1.0 >= ghost[0] > 0.9
    assert 3.02 > ghost[-1] >= 3.0


def test_many_events_give_a_mark_for_a_pixel_and_how_many_it_stands_for() -> None:
    source = EventRows()
    source.add([Event(k * 1e-5, "b", "crossing") for k in range(50_000)])
    times, columns, _, _ = firsts(source.rows()[0], [source.rows()[1][:, 0]], 0.0, 0.5 / 400)
    assert len(times) <= 401
    assert columns[1].sum() == 50_000


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("x,y\n1,2\n", "E503 lab.csv: has no column 'time' in front."),
        ("time;x\n1;2\n", "E503 lab.csv: separates its columns by ';', where commas are needed."),
        ("time,x\n1,2\n0,3\n", "E503 lab.csv: row 2: the time is no number, or lies before that of the row above."),
        ("time,x\nnan,2\n", "E503 lab.csv: row 1: the time is no number"),
        ("time,x\n1,2,3\n", "E503 lab.csv: line 2: 3 cells for 2 columns."),
        ("time,x [rdps]\n1,2\n", "E503 lab.csv: x: "),
        ("time [kg],x\n1,2\n", "E503 lab.csv: time: is in kg, which is no unit of time."),
        ("time,x [V],x [A]\n1,2,3\n", "E503 lab.csv: has two columns of one name."),
        ("time,x\n", "E503 lab.csv: holds no rows."),
        ("time\n1\n", "E503 lab.csv: has no column but its times."),
        ("", "E503 lab.csv: is empty."),
        ("time,x\n" + " " * LARGEST, "E503 lab.csv: is larger than 8 MiB."),
    ],
)
def test_measured_files_that_cannot_be_shown_are_refused(text: str, wanted: str) -> None:
    with pytest.raises(UsageError, match=re.escape(wanted)):
        Measured.read("lab.csv", text)


def test_a_long_head_is_read_at_once() -> None:
    """Backtracking over all ways to split it, it took minutes, in which nobody was answered."""
    head = f"a [{100_000 * 'x'}"
    assert list(Measured.read("lab.csv", f"t,{head}\n0,1\n").columns) == [head]


def test_a_file_that_blocks_wrote_is_read_as_results_are(tmp_path: Path) -> None:
    results = blocks.Diagram.load("diagrams/motor_pid.json").run(stop=0.01)
    results.save(tmp_path / "r.csv")
    measured = Measured.read("r.csv", (tmp_path / "r.csv").read_text())
    assert np.array_equal(measured.t, results.t)
    assert np.array_equal(measured.values, results.values)
    named = {name: (column, unit) for name, column, unit in results.flat_columns()}
    assert {name: (first, unit) for name, (first, _, unit) in measured.columns.items()} == named


@pytest.mark.parametrize(
    ("signals", "window", "wanted"),
    [
        (["s0"], {"t0": 2.0, "t1": 2.0}, "E501 scope: 2 ... 2 s is no span of time."),
        (["s0"], {"span": 0.0}, "E501 scope.span: must be positive, not 0 s."),
        ([f"s{k}" for k in range(65)], {}, "E501 scope: 65 signals are more than 64 in one scope."),
    ],
)
def test_scopes_that_cannot_be_are_refused(signals: list[str], window: dict[str, float], wanted: str) -> None:
    page, _ = page_of(Rows([0.0], np.zeros((1, 70))))
    with pytest.raises(UsageError, match=re.escape(wanted)):
        page.open(Scope("2", signals, Window(width=100, **window)))
    assert "2" not in page.scopes


def test_measured_columns_of_another_quantity_than_their_signal_are_refused() -> None:
    page, scope = page_of(Rows([0.0], [[1.0]]), "s0")
    file = Measured.read("lab.csv", "t,s0 [A]\n0,1\n")
    with pytest.raises(UsageError, match=re.escape("E505 s0: is in V, and in A in lab.csv")):
        page.add("lab.csv", file)
    assert page.files == {}
    page.files["lab.csv"] = file
    with pytest.raises(UsageError, match=re.escape("E505 s0: is in V, and in A in lab.csv")):
        page.open(scope)


@pytest.mark.parametrize(
    ("name", "digest"),
    [
        ("uplot.js", "5dd9b3281aa64b461b42d9945f6adb2649d346502b12281a9ae0d46599a80eba"),
        ("uplot.css", "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04"),
    ],
)
def test_uplot_is_what_was_published_as_1_6_32(name: str, digest: str) -> None:
    assert hashlib.sha256((VENDOR / name).read_bytes()).hexdigest() == digest
    assert "MIT" in (VENDOR / "uplot.LICENSE").read_text()
