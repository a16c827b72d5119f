"""What a live view remembers."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from stadimeter.app.live.history import EVENTS_MAX, WINDOW_S, RunHistory
from stadimeter.core.decision import Event, EventKind, Severity
from stadimeter.core.measurement import TrackStatus
from stadimeter.core.observation import FrameStamp
from support.cycle_records import cycle_record, tracked


def event(number: int) -> Event:
    return Event(
        kind=EventKind.RAISED, source=f"rule-{number}", at_s=0.0, severity=Severity.INFO, reason="", sequence=number
    )


def test_distances_older_than_the_window_are_forgotten():
    history = RunHistory()
    for number in range(4000):
        history.add(cycle_record(number * 0.1, tracks=(tracked(number / 100),)))
    times_s = [sample.at_s for sample in history.samples_after(-1.0)["ball"]]
    assert times_s[0] >= 399.9 - WINDOW_S
    assert times_s[0] == pytest.approx(399.9 - WINDOW_S, abs=0.11)
    assert times_s[-1] == pytest.approx(399.9)


def test_a_fast_loop_does_not_fill_the_memory_but_a_loss_is_always_kept():
    history = RunHistory()
    for number in range(5000):
        status = TrackStatus.LOST if number == 4000 else TrackStatus.TRACKING
        history.add(cycle_record(number * 0.002, tracks=(tracked(status=status),)))
    kept = history.samples_after(-1.0)["ball"]
    assert len(kept) <= 10 / 0.1 + 3
    assert [sample.at_s for sample in kept if sample.distance_m is None] == [8.0]


def test_the_newest_event_comes_first_and_old_ones_go():
    history = RunHistory()
    for number in range(0, 1000, 2):
        history.add(cycle_record(float(number), events=(event(number), event(number + 1))))
    assert [one.sequence for one in history.events] == list(range(999, 999 - EVENTS_MAX, -1))


def test_an_event_keeps_its_time_by_the_computers_clock_when_a_stepped_clock_falls_behind():
    real_s = 100.0
    history = RunHistory(lambda: real_s)
    history.add(cycle_record(1.0, events=(replace(event(0), at_s=1.0),)))
    real_s = 107.0
    unix_s = history.wall_clock(2.0, 1_000_007.0)
    assert (unix_s(1.0), unix_s(1.5)) == (1_000_000.0, 1_000_006.5)


def test_the_rate_and_the_age_are_those_of_frames_not_of_cycles():
    history = RunHistory()
    assert (history.frame_rate_hz, history.frame_age_s) == (0.0, None)
    for number in range(100):
        frame = FrameStamp(sequence=number, captured_at_s=number * 0.05) if number % 2 == 0 else None
        history.add(cycle_record(number * 0.05, frame=frame))
    assert history.frame_rate_hz == pytest.approx(10.0)
    assert history.frame_age_s == pytest.approx(0.05)


def test_the_rate_falls_to_zero_when_frames_stop():
    history = RunHistory()
    for number in range(20):
        history.add(cycle_record(number * 0.1))
    history.add(cycle_record(10.0, frame=None))
    assert history.frame_rate_hz == 0.0
    assert history.frame_age_s == pytest.approx(10.0 - 1.9 + 0.034)
