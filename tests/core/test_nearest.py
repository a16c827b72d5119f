"""The nearest and the farthest of several targets, which rules watch like any other."""

from __future__ import annotations

from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.sight import CountCondition
from stadimeter.core.decide import State, decide, initial_state
from stadimeter.core.decision import EventKind, SafetyMode
from stadimeter.core.measurement import Measurement, Track, TrackStatus
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import LevelOutput, Plan
from stadimeter.core.rule import RampRule
from stadimeter.core.tracking.life_cycle import NearestOf
from support.observing import measured, missed

MEMBERS = ("balls-1", "balls-2")
PLAN = Plan(
    targets=(*MEMBERS, "balls-nearest", "balls-farthest"),
    nearest=(
        NearestOf(name="balls-nearest", members=MEMBERS),
        NearestOf(name="balls-farthest", members=MEMBERS, is_farthest=True),
    ),
    rules=(RampRule(name="ramp", target="balls-nearest", output="motor", start=2.0, full=1.0),),
    outputs=(LevelOutput(name="motor"),),
)


def look(target: str, at_s: float, distance_m: float | None, noise_m: float) -> Measurement:
    if distance_m is None:
        return missed(target, at_s)
    return measured(target, at_s, distance_m, noise_m, 0.1 if target == "balls-1" else -0.1)


class Running:
    """A run of the core whose two balls are where a test says."""

    def __init__(self) -> None:
        self.state: State = initial_state(PLAN)
        self.frames = 0
        self.events: list[tuple[EventKind, str]] = []
        self.level = 0.0

    def see(self, one_m: float | None, other_m: float | None, frames: int = 20, noise_m: float = 0.005) -> None:
        for _ in range(frames):
            at_s = self.frames / 30
            both = zip(MEMBERS, (one_m, other_m), strict=True)
            seen = tuple(look(name, at_s, distance_m, noise_m) for name, distance_m in both)
            stamp = FrameStamp(sequence=self.frames, captured_at_s=at_s)
            self.state, decision = decide(self.state, Observation(now_s=at_s, frame=stamp, measurements=seen))
            self.events += [(each.kind, each.source) for each in decision.events]
            (command,) = decision.commands
            self.level = command.level
            self.frames += 1

    def track(self, target: str) -> Track:
        return next(each.track for each in self.state.tracks if each.track.target == target)

    def member(self, target: str) -> str:
        return next(each.member for each in self.state.tracks if each.track.target == target)


def test_nearest_and_farthest_are_members_under_another_name() -> None:
    run = Running()
    run.see(1.5, 3.0)
    for name, member in (("balls-nearest", "balls-1"), ("balls-farthest", "balls-2")):
        assert run.track(name).distance_m == run.track(member).distance_m
        assert run.track(name).bearing_rad == run.track(member).bearing_rad


def test_a_ramp_follows_the_nearest_whichever_that_is() -> None:
    run = Running()
    run.see(1.5, 3.0)
    assert abs(run.level - 0.5) < 0.05
    run.see(3.0, 1.25)
    assert abs(run.level - 0.75) < 0.05


def test_the_nearest_does_not_change_between_two_that_are_as_far_away() -> None:
    run = Running()
    run.see(2.0, 3.0)
    members = set()
    for number in range(60):
        run.see(2.0 + 0.003 * (-1) ** number, 2.0 - 0.003 * (-1) ** number, frames=1, noise_m=0.01)
        members.add(run.member("balls-nearest"))
    assert members == {"balls-1"}


def test_when_the_nearest_is_lost_the_other_one_is_the_nearest() -> None:
    run = Running()
    run.see(1.5, 3.0)
    run.see(None, 3.0)
    assert run.member("balls-nearest") == "balls-2"
    assert run.track("balls-nearest").is_valid


def test_with_none_in_sight_it_is_lost_and_since_when_is_its_own() -> None:
    run = Running()
    run.see(1.5, 3.0)
    seen_since_s = run.track("balls-nearest").since_s
    run.see(None, 3.0)
    assert run.track("balls-nearest").since_s == seen_since_s
    run.see(None, None)
    assert run.track("balls-nearest").status is TrackStatus.LOST
    assert run.track("balls-nearest").since_s == run.track("balls-2").since_s


def test_events_are_those_of_members() -> None:
    run = Running()
    run.see(1.5, 3.0)
    run.see(None, None)
    assert {source for kind, source in run.events if kind is EventKind.TARGET_LOST} == {*MEMBERS}


def test_a_count_is_unknown_while_the_camera_is_stale() -> None:
    tracks = {name: Track(target=name) for name in MEMBERS}
    count = CountCondition(targets=MEMBERS, at_most=1)
    assert count.holds(RuleInputs(tracks=tracks, now_s=0.0), False) is True
    stale = RuleInputs(tracks=tracks, now_s=0.0, safety=SafetyMode.STALE)
    assert count.holds(stale, False) is None
    assert count.reading(stale, False) is None
