"""The figures of ISA-18.2, from synthetic events whose figures are known."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.errors import JournalError
from stadimeter.workbench.fleet import alarm_figures
from stadimeter.workbench.fleet.alarm_figures import STALE_ALARM_S, WINDOW_S, AlarmFigures, figures_of

HOUR_S = 3600.0


def figures_after(*events: tuple[float, str, str], now_s: float, began_s: float = 0.0):
    figures = AlarmFigures(began_s)
    for event in events:
        figures.take(*event)
    return figures.figures(now_s)


def test_the_rate_counts_what_was_annunciated_and_not_what_is_kept_quiet() -> None:
    figures = AlarmFigures(0.0)
    for number in range(12):
        figures.take(number * 300.0, "garage/near", "raised")
        figures.take(number * 300.0 + 1, "garage/near", "cleared")
        figures.take(number * 300.0 + 2, "attic/near", "raised", is_annunciated=False)
    found = figures.figures(HOUR_S)
    assert (found["alarms"], found["alarms_per_10_min"], found["most_in_10_min"]) == (12, 2.0, 2)
    assert found["top"] == [{"alarm": "garage/near", "count": 12, "percent": 100.0}]


@pytest.mark.parametrize(("apart_s", "chatters"), [(29.0, True), (30.0, True), (30.5, False)])
def test_an_alarm_that_comes_three_times_within_a_minute_chatters(apart_s: float, chatters: bool) -> None:
    events = [(number * apart_s, "a/x", "raised") for number in range(3)]
    assert figures_after(*events, now_s=100.0)["chattering"] == (["a/x"] if chatters else [])


def test_an_alarm_that_stands_for_more_than_a_day_is_stale_until_it_clears() -> None:
    figures = AlarmFigures(0.0)
    figures.take(0.0, "a/x", "raised")
    figures.take(STALE_ALARM_S / 2, "a/x", "realarmed")
    assert figures.figures(STALE_ALARM_S)["stale"] == []
    assert figures.figures(STALE_ALARM_S + 1)["stale"] == ["a/x"]
    figures.take(STALE_ALARM_S + 2, "a/x", "cleared")
    assert figures.figures(2 * STALE_ALARM_S)["stale"] == []


kinds = st.sampled_from(["raised", "realarmed", "cleared", "acknowledged", "reset", "shelved", "nonsense"])
steps = st.lists(st.tuples(st.floats(0, 2000), st.sampled_from("abc"), kinds, st.booleans()), max_size=80)


@given(steps)
def test_the_flood_and_the_rate_are_those_of_a_naive_count(events) -> None:
    figures, now_s, came_s = AlarmFigures(0.0), 0.0, []
    for step_s, alarm, kind, is_annunciated in events:
        now_s += step_s
        figures.take(now_s, alarm, kind, is_annunciated=is_annunciated)
        if kind in {"raised", "realarmed"} and is_annunciated:
            came_s.append(now_s)
    found = figures.figures(now_s)
    most = max(
        (sum(at_s - WINDOW_S < other_s <= at_s for other_s in came_s[: n + 1]) for n, at_s in enumerate(came_s)),
        default=0,
    )
    assert found["alarms"] == len(came_s) == sum(each["count"] for each in found["top"])
    assert found["most_in_10_min"] == most
    assert (found["floods"] > 0) is (most > 10)
    assert 0 <= found["flood_seconds"] <= found["seconds"] + 1e-6


def test_the_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(alarm_figures, "MAX_ALARMS", 50)
    figures = AlarmFigures(0.0)
    for number in range(200):
        figures.take(float(number), f"a/{number}", "raised")
    found = figures.figures(200.0)
    assert (found["alarms"], found["passed_over"]) == (50, 150)


def line(at: str, kind: str, topic: str = "stadimeter/garage/event/alarm", **more: object) -> str:
    event = {"v": 1, "ts": at, "id": f"boot-{at}", "event_type": kind, "rule": "near", "notify": True, **more}
    return f"{topic} {json.dumps(event)}\n"


def test_a_file_that_mosquitto_sub_wrote_has_figures(tmp_path: Path) -> None:
    raised = line("2026-06-01T12:00:00.000+00:00", "raised")
    text = "".join([
        line("2026-06-01T12:00:30.000+00:00", "acknowledged"),  # devices' messages come in any order
        raised,
        raised,  # at least once
        line("2026-06-01T14:00:05.000+02:00", "raised", "stadimeter/hall/press/event/alarm"),
        "stadimeter/garage/availability online\n",
        "stadimeter/garage/event/alarm {\n",
        line("yesterday", "raised"),
        line("0001-01-01T00:00:00.000+00:00", "raised"),
    ])  # fmt: skip
    (tmp_path / "events.txt").write_text(text)
    found = figures_of(tmp_path / "events.txt")
    assert (found["alarms"], found["seconds"], found["passed_over"]) == (2, 30.0, 3)
    assert {each["alarm"] for each in found["top"]} == {"stadimeter/garage/near", "stadimeter/hall/press/near"}
    assert found["acknowledge_median_s"] == 30.0


def test_a_file_without_events_says_what_is_expected(tmp_path: Path) -> None:
    (tmp_path / "none.txt").write_text("hello\n")
    with pytest.raises(JournalError, match="no event of an alarm; `mosquitto_sub -v"):
        figures_of(tmp_path / "none.txt")
    with pytest.raises(JournalError, match="missing"):
        figures_of(tmp_path / "missing.txt")
