"""The timeline for the page: any stretch of time in steps, events of the log, clips, and what is known of a moment."""

from __future__ import annotations

import os
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from stadimeter.app.control.client import ask as ask_run
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.event_log import EventLog
from stadimeter.app.recordings.journal import RecordedConfiguration
from stadimeter.app.recordings.recording import Recorded, RecordingWriter
from stadimeter.app.timeline import TimelineKeeper, event_log_beside
from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.decision import Decision, Event, EventKind, RuleStatus, RuleTrace, SafetyMode, Severity
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.observation import Observation
from stadimeter.errors import ConfigError
from stadimeter.workbench.server import timeline
from stadimeter.workbench.server.operations import Desk, find_operation
from support.observing import Rehearsal
from support.simulated_run import SIMULATED_BALL

RULES = """
[rules.near]
actuator = "motor"
when = { below = "1 m" }
on_delay = "0 s"

[rules.far]
actuator = "motor"
ramp = { from = "2.5 m", to = "3.5 m" }

[world]
"""
BEGAN_S = 1_782_907_200
"""2026-07-01 12:00 UTC."""


def ask(desk: Desk, op: str, **args: object) -> Any:
    return find_operation(op)(desk, {key.rstrip("_"): value for key, value in args.items()}).data


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    path = tmp_path / "room.toml"
    path.write_text(SIMULATED_BALL + RULES)
    return Desk(configuration=path, run_socket=tmp_path / "none.sock")


@pytest.fixture
def folder(desk: Desk) -> Path:
    return desk.configuration.parent / "timeline" / "room"


def keep(
    folder: Path, distances_m: list[float | None], began_s: int = BEGAN_S, rule: str = "near", run_rate: float = 1.0
) -> None:
    """Keep a second for each distance; nearer than 1 m the rule is active. The run's clock has its own rate."""
    times = iter(range(began_s, began_s + len(distances_m)))
    keeper = TimelineKeeper(folder, 1e9, lambda: next(times))
    for second, metres in enumerate(distances_m):
        status = TrackStatus.LOST if metres is None else TrackStatus.TRACKING
        track = Track(target="ball", status=status, distance_m=metres, sigma_m=0.02)
        trace = RuleTrace(rule=rule, status=RuleStatus.ACTIVE if (metres or 9) < 1 else RuleStatus.IDLE)
        decision, observation = (
            SimpleNamespace(tracks=(track,), rules=(trace,)),
            SimpleNamespace(now_s=run_rate * second),
        )
        keeper(SimpleNamespace(decision=decision, observation=observation))  # type: ignore[arg-type]
        keeper.step()
    keeper.close()


def test_a_stretch_is_answered_in_steps_with_extremes_gaps_and_lanes(desk: Desk, folder: Path) -> None:
    keep(folder, [2.0] * 60 + [None] * 60 + [2.0, 0.5, 2.0] + [2.0] * 57)
    found = ask(desk, "timeline.timeline", from_=BEGAN_S - 60, to=BEGAN_S + 240, points=5)
    assert (found["from_s"], found["step_s"], found["count"]) == (BEGAN_S - 60, 60, 5)
    assert found["targets"]["ball"]["low_m"] == [None, 2.0, None, 0.5, None]
    assert found["targets"]["ball"]["high_m"] == [None, 2.0, None, 2.0, None]
    assert found["targets"]["ball"]["mean_m"][3] == pytest.approx(2.0 - 1.5 / 60, abs=1e-3)
    assert found["lanes"] == [
        {"rule": "near", "spans": [(BEGAN_S, BEGAN_S + 120, "idle"), (BEGAN_S + 120, BEGAN_S + 180, "active")]}
    ]
    assert found["is_kept"]


@pytest.mark.parametrize("stretch", [(5, 5), (9, 5), (-1, 5), (0, 1e9)])
def test_a_stretch_that_is_none_is_refused(desk: Desk, stretch: tuple[float, float]) -> None:
    with pytest.raises(ConfigError, match="at most 366 days"):
        ask(desk, "timeline.timeline", from_=stretch[0], to=stretch[1])


@pytest.mark.parametrize("is_service", [True, False])
def test_events_come_from_the_event_log(desk: Desk, folder: Path, is_service: bool) -> None:
    folder.mkdir(parents=True)
    path = folder.parents[1] / "room.log" if is_service else event_log_beside(folder)
    now = datetime.fromtimestamp(BEGAN_S, UTC)
    log = EventLog(path, now=lambda: now, is_right=lambda: True)
    log.say("started: stadimeter 1, room.toml")
    for kind, by in ((EventKind.RAISED, ""), (EventKind.OUT_OF_SERVICE, "zoe")):
        now += timedelta(seconds=10)
        event = Event(kind=kind, source="near", at_s=0.0, severity=Severity.ALARM, reason="0.45 m: below 1 m", by=by)
        log(SimpleNamespace(decision=SimpleNamespace(events=(event,), safety=SafetyMode.STOPPED)))  # type: ignore[arg-type]
    log.close()
    found = ask(desk, "timeline.timeline", from_=BEGAN_S - 5, to=BEGAN_S + 15)["events"]
    assert [(each["unix_s"], each["kind"], each["source"], each["reason"]) for each in found] == [
        (BEGAN_S, "", "", "started: stadimeter 1, room.toml"),
        (BEGAN_S + 10, "raised", "near", "0.45 m: below 1 m"),
    ]
    (last,) = ask(desk, "timeline.timeline", from_=BEGAN_S + 15, to=BEGAN_S + 25)["events"]
    assert (last["kind"], last["by"], last["severity"]) == ("out_of_service", "zoe", "alarm")


def test_thresholds_have_the_names_by_which_they_are_set(desk: Desk) -> None:
    assert ask(desk, "timeline.marks", from_=0, to=60)["thresholds"] == [
        {"rule": "near", "target": "ball", "key": "below", "value_m": 1.0},
        {"rule": "far", "target": "ball", "key": "ramp", "value_m": 2.5},
    ]
    desk.configuration.write_text("broken")
    assert ask(desk, "timeline.marks", from_=0, to=60)["thresholds"] == []


def test_a_moment_that_no_recording_holds_is_told_by_the_timeline(desk: Desk, folder: Path) -> None:
    keep(folder, [2.0, 0.5])
    found = ask(desk, "timeline.moment", at=BEGAN_S + 1.4)
    assert found["by"] == "timeline"
    assert found["targets"][0]["distance_m"] == 0.5
    assert found["rules"] == [{"rule": "near", "status": "active", "reason": ""}]


class Observed(Rehearsal):
    """A rehearsal that keeps what it was given last."""

    def cycle(self, observation: Observation) -> Decision:
        self.observation = observation
        return super().cycle(observation)


@pytest.fixture
def recorded(desk: Desk) -> float:
    """Record two minutes as a clip; the ball is near from the second minute on. Return when it began."""
    rehearsal = Observed(load_configuration(desk.configuration).plan)
    path = desk.configuration.parent / "recordings" / "clips" / "one.mcap"
    path.parent.mkdir(parents=True)
    text = RecordedConfiguration(text=desk.configuration.read_text())
    camera = CameraModel.with_focal_length(60.0, 64, 48)
    writer = RecordingWriter(path, Recorded(configuration=text, camera=camera, sizes={}))
    began_s = time.time()
    for number in range(1200):
        decision = rehearsal.see(2.0 if number < 600 else 0.5)
        writer.write(CycleRecord(observation=rehearsal.observation, decision=decision, applied=(), timings_s={}))
    writer.close()
    os.utime(path, (began_s + 120, began_s + 120))
    return began_s


@pytest.mark.long
def test_a_moment_that_a_recording_holds_is_explained_by_it(desk: Desk, recorded: float) -> None:
    for after_s, status, words in ((30, "idle", "2.000 m"), (110, "active", "0.500 m")):
        found = ask(desk, "timeline.moment", at=recorded + after_s)
        assert (found["by"], found["recording"]) == ("recording", "one.mcap")
        near = next(each for each in found["rules"] if each["rule"] == "near")
        assert near["status"] == status
        assert words in near["reason"]


@pytest.mark.long
def test_a_moment_of_a_run_that_lagged_is_explained_by_the_clock_of_the_run(
    desk: Desk, folder: Path, recorded: float
) -> None:
    """Two minutes of a run took four by the computer's clock: after 100 s the ball is not near yet."""
    keep(folder, [2.0] * 240, began_s=int(recorded), run_rate=0.5)
    path = desk.configuration.parent / "recordings" / "clips" / "one.mcap"
    os.utime(path, (recorded + 240, recorded + 240))
    for after_s, status in ((100, "idle"), (200, "active")):
        found = ask(desk, "timeline.moment", at=recorded + after_s)
        near = next(each for each in found["rules"] if each["rule"] == "near")
        assert (found["held_by"], near["status"]) == ("clips/one.mcap", status)
        assert found["since_s"] == pytest.approx(after_s / 2, abs=1.5)


def test_a_moment_of_the_last_minute_is_explained_by_the_run(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    told = {"rule": "near", "status": "idle", "sentence": "idle: 2.0 m", "evidence": []}

    def answer(_socket: Path, op: str, args: dict[str, float], wait_s: float) -> dict[str, Any]:
        assert (op, wait_s > 0) == ("explain", True)
        assert args["at_unix_s"] == pytest.approx(time.time(), abs=30)
        return {"rules": [told]}

    assert ask_run is timeline.ask
    monkeypatch.setattr(timeline, "ask", answer)
    found = ask(desk, "timeline.moment", at=time.time() - 5)
    assert found["by"] == "run"
    assert found["rules"] == [{"rule": "near", "status": "idle", "reason": "idle: 2.0 m"}]
