"""The plain view, line by line."""

from __future__ import annotations

from collections.abc import Callable

from stadimeter.app.cycle import CycleRecord
from stadimeter.cli.viewing import PlainView
from stadimeter.core.command import LevelCommand
from stadimeter.core.decision import Event, EventKind, SafetyMode, Severity
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.observation import OutputFault


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


def test_a_target_that_is_not_seen_has_a_reason_in_place_of_a_distance(
    make_record: Callable[..., CycleRecord], make_track: Callable[..., Track]
) -> None:
    lines: list[str] = []
    track = make_track(status=TrackStatus.LOST, reason="largest blob 6 px, limit 12 px")
    PlainView(lines.append).update(make_record(tracks=(track,)))
    assert "ball lost (largest blob 6 px, limit 12 px)  " in lines[0]
    assert "±" not in lines[0]


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
