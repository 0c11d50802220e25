"""Scopes: what pages get of rows. The witness for fewer rows is a loop over bins, in Python numbers."""

import hashlib
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import blocks
from blocks.results.results import Event
from blocks.server.curves import Curve, Window, extremes, packed, values_at
from blocks.server.measured import LARGEST, Measured
from blocks.server.scopes import EventRows, Page, Scope
from blocks.text.errors import UsageError
from tests.support.places import DIAGRAMS

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

    def __init__(self, source: Any, columns: list[tuple[int, float]], width: int = 100, **window: float) -> None:
        header = {"signals": [""] * len(columns)}
        self.curve, self.frames = Curve(source, columns, Window(width=width, **window), header), 0

    def take(self) -> bool:
        frame = self.curve.frame()
        if frame is not None:
            _, self.t, self.columns = unpacked(frame)
            self.frames += 1
        return frame is not None


def slowly(t: Any, values: Any, step: float) -> tuple[list[float], list[float]]:
    """Least and largest value of each bin, one value after the other, and the last row."""
    bins: dict[int, list[tuple[float, float]]] = {}
    for time, value in zip(t.tolist(), values.tolist(), strict=True):
        bins.setdefault(math.floor(time / step), []).append((time, value))
    times, picked = [], []
    for rows in bins.values():
        numbers = [value for _, value in rows if not math.isnan(value)] or [math.nan]
        falls = rows[0][1] > rows[-1][1]
        picked += sorted([min(numbers), max(numbers)], reverse=falls)[: len(rows)]
        times += [rows[0][0], rows[-1][0]][: len(rows)]
    if sum(math.floor(time / step) == math.floor(t[-1] / step) for time in t) > 2:
        return [*times, float(t[-1])], [*picked, float(values[-1])]
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
    t, values = random_rows(3000, seed).rows()
    step = 7.0 / 200
    times, reduced, first = extremes(t, list(values.T), step)
    for k in range(3):
        wanted_t, wanted = slowly(t, values[:, k], step)
        assert times.tolist() == wanted_t
        with np.errstate(over="ignore"):
            assert np.array_equal(reduced[k], np.array(wanted).astype(np.float32), equal_nan=True)
    assert np.array_equal(first, np.unique(np.floor(t / step), return_index=True)[1])


@pytest.mark.parametrize("window", [{}, {"span": 1.5}, {"t0": 1.0, "t1": 4.0}, {"t0": 1.9, "t1": 2.1}])
def test_frames_of_a_growing_run_end_as_one_frame_of_the_whole(window: dict[str, float]) -> None:
    """The last row of each frame is another one until the next frame, as the row at the present time may be."""
    run, rng = random_rows(6000, 9), np.random.default_rng(1)
    whole = Shown(run, [(0, 1.0), (1, 1.0)], **window)
    whole.take()
    run.count = 0
    shown = Shown(run, [(0, 1.0), (1, 1.0)], **window)
    while run.count < 6000:
        run.count = min(6000, run.count + int(rng.integers(1, 40)))
        right = run.all_values[run.count - 1].copy()
        run.all_values[run.count - 1] = 100.0
        shown.take()
        run.all_values[run.count - 1] = right
    shown.take()
    assert not shown.take()
    begin = whole.t[1]  # where the bin ends that the window may cut
    assert np.array_equal(shown.t[shown.t > begin], whole.t[whole.t > begin])
    assert np.array_equal(shown.columns[:, shown.t > begin], whole.columns[:, whole.t > begin], equal_nan=True)
    assert len(whole.t) <= 4 * 100 + 4
    t, values = run.rows()
    inside = (t > begin) & (t <= window.get("t1", 8.0))
    for k in (0, 1):
        seen = whole.columns[k][(whole.t > begin) & (whole.t <= window.get("t1", 8.0))]
        assert np.nanmin(seen) == np.float32(np.nanmin(values[inside, k]))
        assert np.nanmax(seen) == np.float32(np.nanmax(values[inside, k]))


def test_few_rows_come_as_they_are_and_a_peak_of_one_row_is_seen_among_many() -> None:
    t = np.linspace(0.0, 1.0, 200)
    few = Shown(Rows(t, np.sin(t)[:, None]), [(0, 2.0)])
    few.take()
    assert np.array_equal(few.t, t)
    assert np.array_equal(few.columns[0], (2.0 * np.sin(t)).astype(np.float32))
    t = 1e5 + np.linspace(0.0, 1.0, 200_001)
    values = np.zeros((len(t), 1))
    values[123_456] = 7.0
    many = Shown(Rows(t, values), [(0, 1.0)], width=500)
    many.take()
    assert len(many.t) <= 2002
    assert many.columns[0].max() == 7.0
    assert abs(many.t[many.columns[0].argmax()] - t[123_456]) < 1.0 / 500
    values[-3:, 0] = [4.0, 9.0, 5.0]  # the legend tells the last value, which is neither the least nor the largest
    many.take()
    assert (many.t[-1], many.columns[0][-1]) == (t[-1], 5.0)


@pytest.mark.parametrize("window", [{}, {"span": 5.0}])
def test_a_frame_looks_at_new_rows_only_whatever_was_recorded_before(window: dict[str, float]) -> None:
    class Counted(np.ndarray[Any, Any]):
        looked = 0

        def __getitem__(self, key: Any) -> Any:
            made = super().__getitem__(key)
            if isinstance(key, tuple):
                Counted.looked += len(made)
            return np.asarray(made) if isinstance(key, tuple) else made

    run = Rows(np.arange(100_000) * 1e-3, np.zeros((100_000, 1)))
    run.all_values = run.all_values.view(Counted)
    run.count, shown = 0, Shown(run, [(0, 1.0)], **window)
    while run.count < 100_000:
        run.count += 500
        shown.take()
    assert shown.frames == 200
    assert Counted.looked < 5 * 100_000
    assert len(shown.t) <= 4 * 100 + 4


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
    assert [*page.frames({}, run)] == []
    page.open(scope)
    return page, scope


def test_a_page_gets_its_signals_ghosts_files_and_events() -> None:
    columns = {"x": (0, (), "rad/s"), "v": (1, (2,), "V")}
    run = Rows(np.arange(8.0), np.arange(24.0).reshape(8, 3), columns)
    run.fired = [Event(2.5, "relay", "crossing"), Event(2.5001, "relay", "crossing"), Event(6.0, "b", "event")]
    page, _ = page_of(run, "v", "x", "unknown", "lab.csv|other")
    page.ghosts.add(7)
    page.add("lab.csv", Measured.read("lab.csv", "time [ms],x [rpm],other [mV]\n0,30,1\n1000,,2\n"))
    ghost = Rows(np.arange(4.0), np.ones((4, 1)), {"x": (0, (), "rad/s")})
    frames = {(header["kind"], header["of"]): (header, t, rows) for header, t, rows in
              map(unpacked, page.frames({7: ghost}, run))}  # fmt: skip
    wanted = [["v[0]", "v[1]", "x"], ["cause", "count"], ["x"], ["x", "other"]]
    assert [header["signals"] for header, _, _ in frames.values()] == wanted
    assert [*frames] == [("run", 0), ("events", 0), ("ghost", 7), ("overlay", "lab.csv")]
    header, t, measured = frames["overlay", "lab.csv"]
    assert header["units"] == ["rad/s", "V"]
    assert t.tolist() == [0.0, 1.0]
    assert np.allclose(measured, [[math.pi, np.nan], [1e-3, 2e-3]], equal_nan=True)
    header, t, fired = frames["events", 0]
    assert header["events"] == [["relay", "crossing"], ["b", "event"]]
    assert t.tolist() == [2.5, 2.5001, 6.0]
    assert fired.tolist() == [[0, 0, 1], [1, 2, 3]]
    run.fired.append(Event(6.5, "b", "event"))
    assert [*page.frames({7: ghost}, run)] == []  # before it has drawn what it got
    page.is_ready = True
    more = [unpacked(frame) for frame in page.frames({7: ghost}, run)]
    assert [(header["kind"], t[-1], rows[1, -1]) for header, t, rows in more] == [("events", 6.5, 4)]


def test_ghosts_come_as_far_as_the_run_that_a_scope_follows() -> None:
    run = Rows(np.linspace(0.0, 7.0, 701), np.zeros((701, 1)))
    page, _ = page_of(run, "s0", span=2.0)
    page.ghosts.add(3)
    ghost = Rows(np.linspace(0.0, 7.0, 701), np.ones((701, 1)))
    run.count = 301
    t = next(t for header, t, _ in map(unpacked, page.frames({3: ghost}, run)) if header["kind"] == "ghost")
    assert 1.0 >= t[0] > 0.9
    assert 3.02 > t[-1] >= 3.0


def test_many_events_give_a_mark_for_a_pixel_and_how_many_there_are() -> None:
    run = Rows([], np.empty((0, 1)))
    run.fired = [Event(k * 1e-5, "b", "crossing") for k in range(50_000)]
    shown = Shown(EventRows(run), [(0, 1.0), (1, 1.0)], width=400)
    shown.take()
    assert len(shown.t) <= 4 * 400 + 2
    assert shown.columns[1, [0, -1]].tolist() == [1, 50_000]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("x,y\n1,2\n", "E503 lab.csv: must have 'time' as its first column."),
        ("time;x\n1;2\n", "E503 lab.csv: separates its columns by ';'. Use commas."),
        (
            "time,x\n1,2\n0,3\n",
            "E503 lab.csv: row 2: the time is not a number, or lies before the time of the row above.",
        ),
        ("time,x\nnan,2\n", "E503 lab.csv: row 1: the time is not a number"),
        ("time,x\n1,2,3\n", "E503 lab.csv: line 2: 3 cells for 2 columns."),
        ('time,x,y\n0,1,"-2,5"\n', 'E503 lab.csv: "-2,5" has a decimal comma. Write a decimal point.'),
        ("time,x [rdps]\n1,2\n", "E503 lab.csv: x: "),
        ("time [kg],x\n1,2\n", "E503 lab.csv: time: "),
        ("time,x [V],x [A]\n1,2,3\n", "E503 lab.csv: has two columns with the name 'x'."),
        ("time,x\n", "E503 lab.csv: has no rows, or no column except the times."),
        ("time\n1\n", "E503 lab.csv: has no rows, or no column except the times."),
        ("", "E503 lab.csv: is empty."),
        ("time,x\n" + " " * LARGEST, "E503 lab.csv: exceeds the limit of 8 MiB."),
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
    results = blocks.Diagram.load(DIAGRAMS / "motor_pid.json").run(stop=0.01)
    results.save(tmp_path / "r.csv")
    measured = Measured.read("r.csv", (tmp_path / "r.csv").read_text())
    assert np.array_equal(measured.t, results.t)
    assert np.array_equal(measured.values, results.values)
    named = {name: (column, unit) for name, column, unit in results.flat_columns()}
    assert {name: (first, unit) for name, (first, _, unit) in measured.columns.items()} == named


@pytest.mark.parametrize(
    ("signals", "window", "wanted"),
    [
        (["s0"], {"t0": 2.0, "t1": 2.0}, "E501 scope: 0 s is not a span of time."),
        (["s0"], {"span": 0.0}, "E501 scope: 0 s is not a span of time."),
        ([f"s{k}" for k in range(65)], {}, "E501 scope: 65 signals do not fit into one scope: the limit is 64."),
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
    with pytest.raises(UsageError, match=re.escape("E505 s0: is in V in the run, but in A in lab.csv")):
        page.add("lab.csv", file)
    assert page.files == {}
    page.files["lab.csv"] = file
    with pytest.raises(UsageError, match=re.escape("E505 s0: is in V in the run, but in A in lab.csv")):
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
