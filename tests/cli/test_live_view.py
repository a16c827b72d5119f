"""The live view, read as a person reads it, line by line and as a picture."""

from __future__ import annotations

import io
import math
import re
import threading
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st
from live_view_svg import save_svg
from msgspec.structs import replace
from rich.console import Console
from rich.text import Text

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.health import Board
from stadimeter.app.live.history import DistanceSample
from stadimeter.app.loop import Loop
from stadimeter.cli.keyboard import Keyboard, RunKeys
from stadimeter.cli.live_view import LIMIT_STYLE, LINES, LiveView, StripChart, chart_scale
from stadimeter.cli.viewing import WAITING_MAX, PlainView, ViewThread
from stadimeter.core.command import LevelCommand
from stadimeter.core.decision import Event, EventKind, OutputTrace, RuleStatus, RuleTrace, SafetyMode, Severity
from stadimeter.core.detection import RejectedCandidate
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.observation import OutputFault
from support.cycle_records import live_view
from support.observing import missed

# The live view, read as a person reads it: from the screen.

SIZES = [(80, 24), (120, 35), (200, 50)]


def screen(view: LiveView, width: int = 80, height: int = 24) -> list[str]:
    """Print a view on a terminal without colours and return its rows."""
    raw = io.BytesIO()
    console = Console(
        file=io.TextIOWrapper(raw, "utf-8"),
        width=width,
        height=height,
        no_color=True,
        legacy_windows=False,
        _environ={},
    )
    console.print(view, end="")
    console.file.flush()
    return raw.getvalue().decode().split("\n")[:-1]


def row_with(words: str, rows: list[str]) -> str:
    (row,) = [row for row in rows if words in row]
    return row


def shown(*records: CycleRecord, **options: object) -> LiveView:
    view, show = live_view(**options)
    for record in records:
        show(record)
    return view


def event(number: int, at_s: float = 0.0) -> Event:
    return Event(
        kind=EventKind.RAISED,
        source=f"rule-{number}",
        at_s=at_s,
        severity=Severity.ALARM,
        reason=f"reason {number}",
        sequence=number,
    )


class Everywhere(Keyboard):
    """A keyboard that is there, whatever the test runs in."""

    is_there = True


def test_the_distance_is_shown_with_its_standard_deviation(make_record: Callable[..., CycleRecord]) -> None:
    row = row_with("2.43 m ± 0.04", screen(shown(make_record())))
    assert "closing 0.21 m/s" in row
    assert "3° left" in row


def test_the_top_line_tells_mode_rate_age_and_time(make_record: Callable[..., CycleRecord]) -> None:
    view = shown(*(make_record(1000.0 + number * 0.1) for number in range(124)))
    top = screen(view)[0]
    assert re.search(r"test run +ACTIVE +10\.0 fps  age 34 ms  12\.3 s", top)


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_why_outputs_may_not_act_is_told_below(
    make_record: Callable[..., CycleRecord], width: int, height: int
) -> None:
    record = make_record(
        safety=SafetyMode.STALE, safety_reason="the frame is 0.4 s old", frame=None, camera_fault="no frame in 0.1 s"
    )
    rows = screen(shown(record, trouble=lambda: "the broker is away"), width, height)
    assert "STALE" in rows[0]
    assert [row.strip() for row in rows[1:4]] == [
        "! the frame is 0.4 s old",
        "! no frame in 0.1 s",
        "! the broker is away",
    ]


def test_a_lost_target_says_since_when_and_why(
    make_record: Callable[..., CycleRecord], make_track: Callable[..., Track]
) -> None:
    track = make_track(status=TrackStatus.LOST, measured_at_s=7.0, reason="largest blob 6 px, limit 12 px")
    for width, height in SIZES:
        rows = screen(shown(make_record(10.0, tracks=(track,))), width, height)
        assert any("ball lost" in row for row in rows)
        assert row_with("last seen 3.0 s ago", rows)
        assert row_with("largest blob 6 px, limit 12 px", rows)
        assert not any("closing" in row for row in rows)


DOOR = RejectedCandidate(centre_px=(310.0, 120.0), size_px=24.0, reason="edge scatters by 2.1 px, limit 1.0 px")
LAMP = RejectedCandidate(centre_px=(9.0, 8.0), size_px=7.0, reason="7.0 px wide, limit 12 px")


def unseen(
    make_record: Callable[..., CycleRecord], now_s: float = 10.0, reason: str = "no ball among 2 outlines"
) -> CycleRecord:
    return make_record(
        now_s,
        tracks=(Track(target="ball", reason=reason),),
        measurements=(missed("ball", now_s, reason),),
        rejected={"ball": (DOOR, LAMP)},
    )


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_what_looked_most_like_a_target_that_is_not_found_is_shown_with_the_test_that_it_failed(
    make_record: Callable[..., CycleRecord], width: int, height: int
) -> None:
    rows = screen(shown(unseen(make_record)), width, height)
    assert row_with("no ball among 2 outlines", rows)
    assert row_with("looked at 24 px at 310, 120: edge scatters by 2.1 px, limit", rows)
    assert not any("7.0 px wide" in row for row in rows), "the best of them only"


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_every_rule_is_shown_with_its_state_its_output_and_its_reason(
    make_record: Callable[..., CycleRecord], width: int, height: int
) -> None:
    rows = screen(shown(make_record()), width, height)
    for rule in ("● too-near active   → buzzer", "○ too-far  idle     · motor", "? follow   unknown  → base"):
        assert row_with(rule, rows)
    for rule in ("◔ keep-off pending  × base overruled", "◑ report   clearing alert only"):
        assert row_with(rule, rows)
    for reason in ("2.43 m is not beyond 3.05 m", "for 0.2 s of 0.5 s", "clears in 0.4 s"):
        assert row_with(reason, rows)
    assert row_with("0.43 m is below", rows), "beside the rule, and not again beside the output that it commands"


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_every_output_is_shown_with_its_value_its_winner_and_its_losers(
    make_record: Callable[..., CycleRecord], width: int, height: int
) -> None:
    rows = screen(shown(make_record()), width, height)
    bars = [row_with(value, rows).count("━") for value in ("100 %", "62 %")]
    assert bars[1] / bars[0] == pytest.approx(0.62, abs=0.05)
    assert "▲  0.21 m/s ↺  0.10 rad/s" in row_with("rad/s", rows)
    assert row_with("by follow over keep-off", rows)
    assert row_with("safe value: nothing asks for more", rows)


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_the_newest_event_is_the_first_shown(make_record: Callable[..., CycleRecord], width: int, height: int) -> None:
    records = [make_record(float(number), events=(event(number, float(number)),)) for number in range(40)]
    rows = screen(shown(*records), width, height)
    start = next(number for number, row in enumerate(rows) if row.startswith("events ─"))
    assert "39.0 s rule-39 raised: reason 39" in rows[start + 1]
    assert "38.0 s rule-38 raised: reason 38" in rows[start + 2]


def hostile(make_record: Callable[..., CycleRecord], make_track: Callable[..., Track]) -> CycleRecord:
    nasty = "\x1b[2J\r\n\t[bold]日本語 ± x\x07\u200b" * 20
    return make_record(
        tracks=(make_track(target=nasty, reason=nasty, bearing_rad=math.pi, sigma_m=1e300), Track(target="other")),
        rules=(RuleTrace(rule=nasty, status=RuleStatus.PENDING, output=nasty),),
        reasons={nasty: nasty},
        outputs=(OutputTrace(output=nasty, winner=nasty, reason=nasty, losers=(nasty,)),),
        events=(event(1),),
        safety=SafetyMode.STARTING,
        safety_reason=nasty,
    )


@pytest.mark.parametrize(
    ("width", "height"), [(1, 1), (5, 3), (20, 5), (40, 12), (60, 16), (80, 24), (99, 40), (100, 8), (132, 43)]
)
def test_at_any_size_the_view_fills_the_screen_and_no_more(
    make_record: Callable[..., CycleRecord], make_track: Callable[..., Track], width: int, height: int
) -> None:
    for view in (shown(), shown(make_record()), shown(hostile(make_record, make_track))):
        rows = screen(view, width, height)
        assert len(rows) == height
        assert all(len(row) <= width for row in rows)
        assert all(character.isprintable() for row in rows for character in row)


def test_drawing_is_driven_by_real_time_and_leaves_the_terminal_as_it_was(
    make_record: Callable[..., CycleRecord],
) -> None:
    file, now_s = io.StringIO(), [0.0]
    console = Console(file=file, force_terminal=True, width=80, height=24, _environ={"TERM": "xterm"})
    view, show = live_view(console=console, real_time_s=lambda: now_s[0])
    with view:
        drawn = []
        for number in range(100):
            now_s[0] = number * 0.01
            before = len(file.getvalue())
            show(make_record(float(number)))
            drawn.append(len(file.getvalue()) > before)
    assert 9 <= drawn.count(True) <= 11
    assert file.getvalue().startswith("\x1b[?1049h")
    assert file.getvalue().rstrip("\r\n").endswith(("\x1b[?1049l", "\x1b[?25h", "\x1b[?1049l\x1b[?25h"))


def test_a_slow_computer_draws_less_often(make_record: Callable[..., CycleRecord]) -> None:
    now_s = [0.0]

    class SlowFile(io.StringIO):
        def flush(self) -> None:
            now_s[0] += 0.1

    file = SlowFile()
    console = Console(file=file, force_terminal=True, width=80, height=24, _environ={"TERM": "xterm"})
    view, show = live_view(console=console, real_time_s=lambda: now_s[0])
    with view:
        began_s, drawing_s = now_s[0], 0.0
        while now_s[0] < began_s + 20:
            before_s = now_s[0]
            show(make_record(now_s[0]))
            drawing_s += now_s[0] - before_s
            now_s[0] += 0.01
    assert 0 < drawing_s / 20 <= 0.25


def test_an_error_in_the_run_gives_the_terminal_back(make_record: Callable[..., CycleRecord]) -> None:
    file = io.StringIO()
    console = Console(file=file, force_terminal=True, width=80, height=24, _environ={"TERM": "xterm"})
    view, _ = live_view(console=console)
    with pytest.raises(ZeroDivisionError), view:
        view.update(1 / 0)
    assert "\x1b[?1049l" in file.getvalue()


def test_what_is_wrong_with_the_board_is_said_on_top_however_little_room_there_is(
    make_record: Callable[..., CycleRecord], tmp_path: Path
) -> None:
    (tmp_path / "sys/class/thermal/thermal_zone0").mkdir(parents=True)
    (tmp_path / "sys/class/thermal/thermal_zone0/temp").write_text("84000")
    view, show = live_view(board=Board(folder=tmp_path, root=tmp_path))
    show(make_record())
    assert " ! processor: 84 °C, cool it" in screen(view, 60, 16)[1]


LONG = "2.43 m ± 0.04, below 0.50 m: P 0.00, begins at 0.70, ends at 0.50, and there is more to say of it than fits"


def acts(make_record: Callable[..., CycleRecord]) -> CycleRecord:
    return make_record(
        rules=(
            RuleTrace(rule="near", status=RuleStatus.ACTIVE, output="buzzer"),
            RuleTrace(rule="far", status=RuleStatus.IDLE, output="motor"),
        ),
        reasons={"near": LONG, "far": LONG},
        events=(replace(event(1), reason=LONG),),
    )


@pytest.mark.parametrize(("width", "height"), [(60, 30), (80, 24), (120, 35)])
def test_the_words_of_what_acts_and_of_the_newest_event_take_the_lines_that_they_need(
    make_record: Callable[..., CycleRecord], width: int, height: int
) -> None:
    rows = screen(shown(acts(make_record)), width, height)
    for beside in (" ● near active · buzzer ", "    0.0 s "):
        first = next(number for number, row in enumerate(rows) if row.startswith(beside))
        assert LONG in " ".join(" ".join(row[len(beside) :] for row in rows[first : first + 4]).split())


def test_what_is_told_and_the_keys_stand_at_the_top_and_the_bottom(make_record: Callable[..., CycleRecord]) -> None:
    keys = RunKeys(Loop(build(demo_configuration(), speed=None)), can_pause=True, keyboard=Everywhere(-1))
    for width, height in SIZES:
        rows = screen(shown(make_record(), narration=lambda: "it rolls", keys=keys), width, height)
        assert "> it rolls" in {row.strip() for row in rows[1:4]}  # below what is wrong with this computer
        assert rows[-1].split() == ["q", "quit", "?", "help", "space", "pause"]


# The live view as a picture.

SVG = "{http://www.w3.org/2000/svg}"


def texts(path: Path) -> str:
    root = ET.parse(path).getroot()  # noqa: S314 - a file that we have just written
    assert root.tag == f"{SVG}svg"
    return "\n".join("".join(element.itertext()) for element in root.iter(f"{SVG}text")).replace("\xa0", " ")


@pytest.mark.parametrize(("width", "height"), [(80, 24), (120, 35)])
def test_the_picture_is_well_formed_and_holds_the_figures(
    make_record: Callable[..., CycleRecord], tmp_path: Path, width: int, height: int
) -> None:
    view, show = live_view("test <run> & more")
    for number in range(100):
        show(make_record(number / 10))
    save_svg(view, tmp_path / "view.svg", width, height)
    shown = texts(tmp_path / "view.svg")
    assert "test <run> & more" in shown
    for words in ("2.43 m ± 0.04", "closing 0.21 m/s", "too-near", "active", "keep-off", "1.43 m too far", "62 %"):
        assert words in shown


# The plain view, line by line.


def raised(at_s: float) -> Event:
    return Event(
        kind=EventKind.RAISED, source="too-near", at_s=at_s, severity=Severity.ALARM, reason="0.43 m is below 0.50 m"
    )


def test_a_line_holds_targets_outputs_and_the_rules_that_act(make_record: Callable[..., CycleRecord]) -> None:
    lines: list[str] = []
    PlainView(lines.append).update(make_record(100.0))
    assert lines == [
        (
            "   0.0 s  ball 2.43 m ± 0.04 tracking  buzzer 100 %  motor 62 %  base 0.21 m/s 0.10 rad/s  "
            "ACTIVE too-near: 0.43 m is below 0.50 m: P 0.97  PENDING keep-off: for 0.2 s of 0.5 s  "
            "CLEARING report: clears in 0.4 s"
        )
    ]


def test_there_is_one_line_a_second_of_the_run(make_record: Callable[..., CycleRecord]) -> None:
    lines: list[str] = []
    view = PlainView(lines.append)
    for number in range(61):
        view.update(make_record(100.0 + number / 15))
    assert [line[:10] for line in lines] == [f"   {second}.0 s  " for second in range(5)]


def test_an_event_is_told_at_once(make_record: Callable[..., CycleRecord]) -> None:
    lines: list[str] = []
    view = PlainView(lines.append)
    view.update(make_record(10.0))
    view.update(make_record(10.3, events=(raised(10.3),)))
    assert lines[1:] == ["   0.3 s  * alarm: too-near raised: 0.43 m is below 0.50 m"]


def test_faults_and_safety_are_told(make_record: Callable[..., CycleRecord]) -> None:
    lines: list[str] = []
    record = make_record(
        safety=SafetyMode.STALE,
        safety_reason="the frame is 0.4 s old",
        frame=None,
        camera_fault="no frame in 0.1 s",
        commands=(LevelCommand(output="motor", level=0.0),),
        applied=(),
        output_faults=(OutputFault(output="motor", reason="pin 18 is busy"),),
    )
    PlainView(lines.append).update(record)
    assert "STALE: the frame is 0.4 s old  camera: no frame in 0.1 s  " in lines[0]
    assert "motor OUT OF ORDER: pin 18 is busy" in lines[0]
    assert "motor 0 %" not in lines[0]


def test_trouble_outside_the_loop_is_told_when_it_changes(make_record: Callable[..., CycleRecord]) -> None:
    lines: list[str] = []
    trouble = [""]
    view = PlainView(lines.append, every_s=100.0, trouble=lambda: trouble[0])
    for number, words in enumerate(["", "the broker is away", "the broker is away", "", ""]):
        trouble[0] = words
        view.update(make_record(float(number)))
    assert [line[10:] for line in lines[1:]] == ["the broker is away", "resolved: the broker is away"]


def test_a_driver_s_words_stay_on_one_line(make_record: Callable[..., CycleRecord]) -> None:
    lines: list[str] = []
    record = make_record(output_faults=(OutputFault(output="motor", reason="first\nsecond\x1b[2J é"),))
    PlainView(lines.append).update(record)
    assert len(lines) == 1
    assert lines[0].isprintable()
    assert "2.43 m ± 0.04" in lines[0]


# A view that blocks holds up nothing.


def test_a_view_that_blocks_does_not_block_the_loop_and_what_is_not_shown_is_counted():
    let_go, entered, shown = threading.Event(), threading.Event(), []

    def update(record):
        entered.set()
        assert let_go.wait(120)
        shown.append(record)

    thread = ViewThread(update)
    thread.start()
    thread.submit(0)
    assert entered.wait(120)
    for number in range(1, WAITING_MAX + 51):
        thread.submit(number)
    assert thread.dropped == 50
    let_go.set()
    thread.stop()
    assert shown == list(range(WAITING_MAX + 1))


def test_what_ends_the_view_reaches_the_loop():
    ended = threading.Event()

    def update(record):
        ended.set()
        raise BrokenPipeError

    thread = ViewThread(update)
    thread.start()
    thread.submit(0)
    assert ended.wait(120)
    thread.stop()
    with pytest.raises(BrokenPipeError):
        thread.submit(1)


# The strip chart, read back from its characters.


def samples(distances_m: list[float | None], period_s: float = 0.1, sigma_m: float = 0.0) -> list[DistanceSample]:
    return [
        DistanceSample(at_s=number * period_s, distance_m=distance_m, sigma_m=sigma_m)
        for number, distance_m in enumerate(distances_m)
    ]


def drawn(chart: StripChart, taken: list[DistanceSample], now_s: float = 30.0) -> list[Text]:
    return chart.render([(LINES[0], taken)], now_s)


def plot(chart: StripChart, taken: list[DistanceSample]) -> list[str]:
    """Return the rows right of the axis, without the axis of time."""
    rows = [line.plain for line in drawn(chart, taken)]
    axis = rows[-1].index("└")
    return [row[axis + 1 :].ljust(chart.width - axis - 1) for row in rows[:-1]]


def test_time_without_a_distance_is_a_gap_of_that_length() -> None:
    rows = plot(StripChart(68, 8), samples([2.0] * 100 + [None] * 100 + [2.0] * 101))
    empty = [column for column in range(len(rows[0])) if all(row[column] == " " for row in rows)]
    assert empty == list(range(empty[0], empty[-1] + 1))
    assert len(empty) == pytest.approx(len(rows[0]) / 3, abs=2)
    assert empty[0] == pytest.approx(len(rows[0]) / 3, abs=2)


def test_a_limit_is_dashes_at_its_figure_and_the_line_is_dots_before_it() -> None:
    rows = plot(StripChart(60, 8, limits_m=(2.8,)), samples([2.0] * 301))
    (dashed,) = [number for number, row in enumerate(rows) if "╌" in row]
    assert set(rows[dashed]) == {"╌"}
    label = drawn(StripChart(60, 8, limits_m=(2.8,)), samples([2.0] * 301))[dashed]
    assert label.plain.startswith("2.80 m ┤")
    assert any(span.style == LIMIT_STYLE for span in label.spans)
    assert "╌" not in "".join(plot(StripChart(60, 8, limits_m=(2.0,)), samples([2.0] * 301))), "the line is before it"


@given(
    st.lists(st.none() | st.floats(), max_size=30), st.floats(allow_nan=True), st.integers(0, 90), st.integers(0, 30)
)
def test_whatever_the_figures_the_chart_fits(
    distances_m: list[float | None], sigma_m: float, width: int, height: int
) -> None:
    rows = drawn(StripChart(width, height), samples(distances_m, period_s=1.0, sigma_m=sigma_m))
    assert len(rows) in {0, height}
    assert all(row.cell_len <= width for row in rows)


@given(st.lists(st.floats(0, 1e4), min_size=1), st.floats(0.01, 10), st.integers(2, 40))
def test_a_scale_holds_all_figures_and_labels_are_evenly_spaced(values: list[float], span: float, rows: int) -> None:
    scale = chart_scale(values, span, rows)
    assert all(-1e-6 <= scale.position(value) <= rows - 1 + 1e-6 for value in values)
    labels = list(scale.labels())
    assert len(labels) >= 2
    assert {one - other for (one, _), (other, _) in pairwise(labels)} == {scale.rows_per_step}
    assert scale.low >= 0
