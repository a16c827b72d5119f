"""Several sights of one thing: the nearest of several targets, and a range sensor beside the camera."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.sight import CountCondition
from stadimeter.core.decide import State, decide, initial_state
from stadimeter.core.decision import EventKind, SafetyMode
from stadimeter.core.measurement import Measurement, MeasurementStatus, Track, TrackStatus
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import LevelOutput, Plan
from stadimeter.core.rule import RampRule
from stadimeter.core.sensor_fusion import MAX_APART_S, SensorPair, fuse, step_disagreements
from stadimeter.core.tracking.life_cycle import NearestOf
from support.observing import measured, missed

# The nearest and the farthest of several targets, which rules watch like any other.

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


# What the camera and a range sensor say of one target is joined by variances, or the sensor disagrees.

PAIR = SensorPair(sensor="front", target="ball", half_beam_rad=0.13, radius_m=0.1)
sigmas = st.floats(1e-3, 0.5)
distances = st.floats(0.2, 5.0)


def measured_by(target, distance_m, sigma_m, *, bearing_rad=0.0, at_s=1.0):
    return Measurement(
        target=target,
        status=MeasurementStatus.MEASURED,
        captured_at_s=at_s,
        distance_m=distance_m,
        depth_m=distance_m * math.cos(bearing_rad),
        sigma_m=sigma_m,
        noise_m=sigma_m / 2,
        bearing_rad=bearing_rad,
        elevation_rad=0.0,
    )


def fused(ball, front, pair=PAIR):
    return fuse({"ball": ball, "front": front}, [pair])


@given(distance_m=distances, sigma_m=sigmas, echo_sigma_m=sigmas, apart_sigmas=st.floats(-4.9, 4.9))
def test_the_joint_distance_lies_between_both_and_is_surer_than_either(distance_m, sigma_m, echo_sigma_m, apart_sigmas):
    echo_m = distance_m + apart_sigmas * math.hypot(sigma_m, echo_sigma_m)
    joint, compared = fused(measured_by("ball", distance_m, sigma_m), measured_by("front", echo_m - 0.1, echo_sigma_m))
    low, high = sorted((distance_m, echo_m))
    assert low - 1e-9 <= joint["ball"].distance_m <= high + 1e-9
    assert joint["ball"].sigma_m < min(sigma_m, echo_sigma_m)
    assert 1 / joint["ball"].sigma_m ** 2 == pytest.approx(1 / sigma_m**2 + 1 / echo_sigma_m**2)
    assert joint["ball"].depth_m / joint["ball"].distance_m == pytest.approx(1.0)
    assert compared == {"front": ""}


def test_beyond_five_standard_deviations_the_camera_stands_and_the_sensor_disagrees():
    ball = measured_by("ball", 1.0, 0.03)
    joint, compared = fused(ball, measured_by("front", 0.5, 0.04))
    assert joint["ball"] is ball
    assert "8 σ" in compared["front"]


@pytest.mark.parametrize(
    "front",
    [
        measured_by("front", 0.9, 0.01, bearing_rad=0.2),
        measured_by("front", 0.9, 0.01, at_s=1.0 - 1.1 * MAX_APART_S),
        Measurement(target="front", status=MeasurementStatus.NOT_FOUND, captured_at_s=1.0),
        measured_by("front", math.nan, 0.01),
        measured_by("front", 0.9, 0.0),
    ],
    ids=["beside the beam", "too old", "nothing seen", "no number", "no sigma"],
)
def test_what_is_not_of_the_same_place_and_moment_is_not_joined(front):
    ball = measured_by("ball", 1.0, 0.03)
    joint, compared = fused(ball, front)
    assert joint["ball"] is ball
    assert compared == {}


def test_a_disagreement_is_reported_when_it_begins_and_when_it_ends():
    sensors, began = step_disagreements(frozenset(), {"front": "apart"}, 1.0)
    sensors, goes_on = step_disagreements(sensors, {"front": "apart"}, 2.0)
    sensors, not_seen = step_disagreements(sensors, {}, 3.0)
    sensors, ended = step_disagreements(sensors, {"front": ""}, 4.0)
    assert [event.kind for event in began] == [EventKind.FAULT]
    assert [event.kind for event in ended] == [EventKind.FAULT_CLEARED]
    assert (goes_on, not_seen, sensors) == ((), (), frozenset())
