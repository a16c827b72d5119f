"""Cycles of the loop made by hand, for the tests of what watches a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from msgspec.structs import replace

from stadimeter.app.clock import SteppedClock
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.health import Board
from stadimeter.app.live.history import RunHistory
from stadimeter.app.live.snapshot import LiveFeed
from stadimeter.cli.live_view import LiveView
from stadimeter.core.command import Command, LevelCommand, TwistCommand
from stadimeter.core.decision import Decision, Event, OutputTrace, RuleStatus, RuleTrace, SafetyMode
from stadimeter.core.detection import RejectedCandidate
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.message import Message
from stadimeter.core.observation import FrameStamp, Observation

RULES = (
    RuleTrace(rule="too-near", status=RuleStatus.ACTIVE, output="buzzer"),
    RuleTrace(rule="too-far", status=RuleStatus.IDLE, output="motor"),
    RuleTrace(rule="follow", status=RuleStatus.UNKNOWN, output="base"),
    RuleTrace(rule="keep-off", status=RuleStatus.PENDING, output="base"),
    RuleTrace(rule="report", status=RuleStatus.CLEARING),
)
REASONS = {
    "too-near": "0.43 m is below 0.50 m: P 0.97",
    "too-far": "2.43 m is not beyond 3.05 m",
    "follow": "1.43 m too far",
    "keep-off": "for 0.2 s of 0.5 s",
    "report": "clears in 0.4 s",
}
OUTPUTS = (
    OutputTrace(output="buzzer", winner="too-near"),
    OutputTrace(output="motor", winner="safe", reason="nothing asks for more"),
    OutputTrace(output="base", winner="follow", losers=("keep-off",)),
)


def tracked(distance_m: float = 2.4321, sigma_m: float = 0.041, **changes: object) -> Track:
    track = Track(
        target="ball",
        status=TrackStatus.TRACKING,
        distance_m=distance_m,
        depth_m=distance_m,
        closing_mps=0.21,
        sigma_m=sigma_m,
        closing_sigma_mps=0.02,
        bearing_rad=math.radians(-3),
        elevation_rad=0.0,
    )
    return replace(track, **changes)


def cycle_record(
    now_s: float = 0.0,
    *,
    tracks: tuple[Track, ...] | None = None,
    events: tuple[Event, ...] = (),
    commands: tuple[Command, ...] | None = None,
    applied: tuple[Command, ...] | None = None,
    rules: tuple[RuleTrace, ...] = RULES,
    outputs: tuple[OutputTrace, ...] = OUTPUTS,
    safety: SafetyMode = SafetyMode.ACTIVE,
    safety_reason: str = "",
    reasons: Mapping[str, str] | None = None,
    rejected: Mapping[str, tuple[RejectedCandidate, ...]] | None = None,
    **observed: object,
) -> CycleRecord:
    commands = (
        commands
        if commands is not None
        else (
            LevelCommand(output="buzzer", level=1.0, captured_at_s=now_s),
            LevelCommand(output="motor", level=0.62, captured_at_s=now_s),
            TwistCommand(output="base", linear_mps=0.21, angular_radps=0.1, captured_at_s=now_s),
        )
    )
    observed = {"frame": FrameStamp(sequence=round(now_s * 100), captured_at_s=now_s - 0.034), **observed}
    return CycleRecord(
        observation=Observation(now_s=now_s, **observed),
        decision=Decision(
            commands=commands,
            events=events,
            tracks=(tracked(),) if tracks is None else tracks,
            safety=safety,
            safety_reason=safety_reason,
            rules=rules,
            outputs=outputs,
            reasons=REASONS if reasons is None else reasons,
        ),
        applied=commands if applied is None else applied,
        rejected=rejected or {},
        timings_s={"capture": 0.02, "measure": 0.008, "decide": 0.0003, "apply": 0.0002},
    )


def live_view(
    title: str = "test run",
    *,
    trouble: Callable[[], str] = str,
    narration: Callable[[], str] = str,
    messages: Callable[[], Sequence[tuple[float, Message]]] = tuple,
    board: Board | None = None,
    **options: object,
) -> tuple[LiveView, Callable[[CycleRecord], None]]:
    """Return a live view, and what shows it a cycle."""
    history = RunHistory()

    def around() -> dict[str, object]:
        return {"trouble": trouble(), "narration": narration(), "messages": messages()}

    view = LiveView(title, LiveFeed(SteppedClock(), history, around, board or Board()), **options)

    def show(record: CycleRecord) -> None:
        history.add(record)
        view.update(record)

    return view, show
