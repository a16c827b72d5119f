"""What an edited configuration would have done on a recording, as the page draws it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.journal import JournalWriter, to_be_recorded
from stadimeter.config.camera_file import camera_file_text
from stadimeter.config.loader import load_configuration
from stadimeter.core.decision import Decision
from stadimeter.core.observation import Observation
from stadimeter.workbench.replay import comparison
from stadimeter.workbench.replay.comparison import SPANS_MAX, Lane
from stadimeter.workbench.server.operations import Desk, find_operation
from support.observing import Rehearsal
from support.saves import CONFIGURATION, LENS

BEFORE = CONFIGURATION.format(below="1 m")
AFTER = CONFIGURATION.format(below="2 m")
FRAMES = 300
IN_AND_OUT = [3.0 - 2.6 * (1 - abs(frame - FRAMES / 2) / (FRAMES / 2)) for frame in range(FRAMES)]
"""From 3 m to 0.4 m and back, at 30 frames a second."""


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    desk = Desk(configuration=tmp_path / "stadimeter.toml", run_socket=tmp_path / "none.sock")
    (tmp_path / "camera.toml").write_text(camera_file_text(LENS))
    desk.configuration.write_text(BEFORE)
    configuration = load_configuration(desk.configuration)
    (tmp_path / "recordings").mkdir()
    writer = JournalWriter(tmp_path / "recordings" / "walk.jsonl", to_be_recorded(configuration))

    class Recorded(Rehearsal):
        def cycle(self, observation: Observation) -> Decision:
            decision = super().cycle(observation)
            writer.write(CycleRecord(observation=observation, decision=decision, applied=(), timings_s={}))
            return decision

    Recorded(configuration.plan, frame_s=1 / 30).see(*IN_AND_OUT)
    writer.close()
    return desk


def diff(desk: Desk, text: str, **args: object) -> Any:
    return find_operation("replaying.replay_diff")(desk, {"name": "walk.jsonl", "text": text, **args}).data


def test_a_farther_threshold_is_crossed_earlier_and_left_later(desk: Desk) -> None:
    found = diff(desk, AFTER)
    (lane,) = found["lanes"]
    (before,), (after,) = lane["before"], lane["after"]
    assert after["from_s"] < before["from_s"] < before["to_s"] < after["to_s"]
    assert before["from_s"] == pytest.approx(2.0 / 2.6 * 5, abs=0.3), "when 1 m was crossed"
    assert after["from_s"] == pytest.approx(1.0 / 2.6 * 5, abs=0.3), "when 2 m was crossed"
    assert found["thresholds_m"] == [2.0]
    (output,) = found["outputs"]
    assert max(level for _, level in output["after"]) == 1.0
    assert found["progress"] == 1.0
    assert [(each["change"], each["source"]) for each in found["differences"]] == [("moved", "near")] * 2


def test_a_recording_that_is_damaged_is_compared_up_to_there(desk: Desk) -> None:
    file = desk.configuration.parent / "recordings" / "walk.jsonl"
    lines = file.read_bytes().split(b"\n")
    lines[200] = b'{"observation":{"now_s":6.0,"frame":nothing}}'
    file.write_bytes(b"\n".join(lines))
    found = diff(desk, AFTER)
    assert (found["progress"], round(found["to_s"])) == (1.0, 7)
    assert any("walk.jsonl:201" in words for words in found["words"])


def test_a_long_recording_is_answered_in_parts_which_come_to_the_same(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_once = diff(desk, AFTER)
    desk.kept.clear()
    ticks = iter(range(100_000))
    monkeypatch.setattr(comparison.time, "monotonic", lambda: next(ticks) / 1000)
    monkeypatch.setattr(comparison.SideBySide.go_on, "__defaults__", (comparison.time.monotonic,))
    shares = []
    while not shares or shares[-1] < 1:
        part = diff(desk, AFTER, for_s=0.1)
        shares.append(part["progress"])
    assert 2 < len(shares) < 10
    assert shares == sorted(shares)
    assert part == at_once


def test_two_who_compare_at_once_both_come_to_the_end_also_while_the_recording_grows(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks = iter(range(100_000))
    monkeypatch.setattr(comparison.SideBySide.go_on, "__defaults__", (lambda: next(ticks) / 1000,))
    recording = desk.configuration.parent / "recordings" / "walk.jsonl"
    line = recording.read_bytes().splitlines(keepends=True)[-1]
    shares = {BEFORE: [0.0], AFTER: [0.0]}
    while min(each[-1] for each in shares.values()) < 1:
        with recording.open("ab") as file:
            file.write(line)
        for text, share in shares.items():
            share.append(diff(desk, text, for_s=0.1)["progress"])
            assert share[-1] == 1 or share[-1] > share[-2]
    assert min(map(len, shares.values())) > 3


def test_of_too_many_spans_those_nearest_to_each_other_are_joined() -> None:
    lane = Lane()
    for number in range(2 * SPANS_MAX):
        begin_s = number * 10.0 + (5.0 if number % 2 else 0.0)
        lane.add(begin_s, is_on=True)
        lane.add(begin_s + 1.0, is_on=False)
    found = lane.thinned()
    assert len(found) == SPANS_MAX
    assert (found[0][0], found[-1][1]) == (lane.spans[0][0], lane.spans[-1][1])
