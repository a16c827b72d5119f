"""Following: the law without the base's own motion, searching, the tether, a target near which it is slow."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import RuleStatus, Severity
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import BaseOutput, Plan, Safety
from stadimeter.core.rule import FollowRule, Search, SlowNear
from stadimeter.core.rules.explaining import explain
from stadimeter.core.rules.follow import (
    GAIN_SHARE,
    MAX_GAIN_PER_S,
    Law,
    RelativeTarget,
    closing_speed_mps,
    follow_twist,
    law_of,
)
from stadimeter.operator_actions import OperatorAction, OperatorCommand
from support.each_case import each_case
from support.observing import measured, missed

FOLLOW = FollowRule(name="follow", target="ball", output="base", distance_m=1.0, linear_max_mps=0.5)
LAW = Law(gain_per_s=1.0, turn_gain_per_s=1.5)


def at(distance_m, bearing_rad=0.0, **moves):
    return RelativeTarget(distance_m=distance_m, bearing_rad=bearing_rad, **moves)


def test_a_base_drives_towards_a_far_target_and_turns_to_it():
    linear, angular = follow_twist(FOLLOW, at(1.2, math.radians(20)), LAW)
    assert linear == pytest.approx(0.2 * math.cos(math.radians(20)))
    assert angular == pytest.approx(-1.5 * math.radians(20))


def test_a_base_within_the_deadband_stands_still():
    assert follow_twist(FOLLOW, at(1.02, 0.01), LAW) == (0.0, 0.0)


def test_a_base_that_moves_goes_on_to_the_middle_of_the_deadband():
    assert follow_twist(FOLLOW, at(1.025), LAW, before=(0.1, 0.0))[0] == pytest.approx(0.025)
    assert follow_twist(FOLLOW, at(1.015), LAW, before=(0.1, 0.0))[0] == 0.0


def test_a_base_does_not_reverse_unless_it_may():
    assert follow_twist(FOLLOW, at(0.5), LAW) == (0.0, 0.0)
    assert follow_twist(replace(FOLLOW, reverse_max_mps=0.1), at(0.5), LAW) == (-0.1, 0.0)


def test_a_base_turns_before_it_drives_to_a_target_behind():
    linear, angular = follow_twist(FOLLOW, at(5.0, math.radians(100)), LAW)
    assert linear == 0.0
    assert angular == -FOLLOW.angular_max_radps


def test_the_speed_of_the_target_itself_is_fed_forward():
    assert follow_twist(FOLLOW, at(1.0, away_mps=0.3), LAW)[0] == pytest.approx(0.3)
    assert follow_twist(FOLLOW, at(2.0, left_mps=0.4), LAW)[1] == pytest.approx(0.2)


@given(st.floats(0, 50), st.floats(-math.pi, math.pi), st.floats(-9, 9), st.floats(-9, 9))
def test_a_base_is_never_asked_for_more_than_its_rule_allows(distance_m, bearing_rad, away_mps, left_mps):
    linear, angular = follow_twist(FOLLOW, at(distance_m, bearing_rad, away_mps=away_mps, left_mps=left_mps), LAW)
    assert 0 <= linear <= FOLLOW.linear_max_mps
    assert abs(angular) <= FOLLOW.angular_max_radps


@given(st.floats(0.01, 5), st.floats(0.2, 3))
def test_from_the_speed_that_it_chooses_a_base_can_come_to_rest_in_time(error_m, gain_per_s):
    law = Law(gain_per_s=gain_per_s, brake_mps2=0.4)
    speed, further = closing_speed_mps(error_m, law), closing_speed_mps(error_m * 1.001, law)
    assert speed * (further - speed) / (error_m * 0.001) <= 0.4 * 1.01, "v dv/dx is the deceleration"


def test_a_gain_that_no_one_states_follows_from_the_delay():
    assert law_of(FOLLOW, 0.35, 0.5).gain_per_s == pytest.approx(1.0)
    assert law_of(FOLLOW, 0.7, 0.5).gain_per_s == pytest.approx(GAIN_SHARE / 0.7)
    assert law_of(FOLLOW, 0.1, 0.5).gain_per_s == MAX_GAIN_PER_S, "what it can brake limits it then"
    assert law_of(FOLLOW, 0.1, 2.0).gain_per_s == pytest.approx(2 * MAX_GAIN_PER_S)


def test_a_stated_gain_counts_as_far_as_the_loop_stays_stable():
    stated = replace(FOLLOW, gain_per_s=2.0)
    assert law_of(stated, 0.2, 0.5).gain_per_s == 2.0
    assert law_of(stated, 1.0, 0.5).gain_per_s == 1.0


# Whole decisions, in a world of one ball, a base that obeys with a lag, and frames of some age


class Floor:
    """A base on a floor, and a ball: what `decide` commands moves the base, and the camera sees where that leads."""

    def __init__(self, rule=FOLLOW, *, ball=(2.0, 0.0), age_s=0.03, lag_s=0.1, safety=None, targets=("ball",)):
        base = BaseOutput(name="base", linear_max_mps=0.6, angular_max_radps=2.0, track_width_m=0.2)
        self.plan = Plan(targets=targets, rules=(rule,), outputs=(base,), safety=safety or Safety())
        self.state = initial_state(self.plan)
        self.ball, self.is_hidden, self.others = ball, False, {}
        self.x = self.y = self.heading = self.speed = self.rate = 0.0
        self.age_s, self.lag_s, self.now_s = age_s, lag_s, 0.0
        self.told, self.events, self.decision, self.observations = [], [], None, []
        self.wheels, self.reports, self.bumped = [0.0, 0.0], False, None
        self._seen = []

    def see(self, place):
        dx, dy = place[0] - self.x, place[1] - self.y
        bearing = math.remainder(self.heading - math.atan2(dy, dx), 2 * math.pi)
        return (math.hypot(dx, dy), bearing) if abs(bearing) < math.radians(28) else None

    @property
    def gap_m(self):
        return math.hypot(self.ball[0] - self.x, self.ball[1] - self.y)

    @property
    def in_view(self):
        return self.see(self.ball) is not None

    def run(self, seconds, *commands, move=None, frame_s=1 / 30):
        for _ in range(round(seconds / frame_s)):
            self.cycle(frame_s, commands, move)
            commands = ()
        return self

    def cycle(self, frame_s, commands=(), move=None):
        self.now_s = round(self.now_s + frame_s, 9)
        kept = math.exp(-frame_s / self.lag_s) if self.lag_s else 0.0
        linear, rate = self.told[-1] if self.told else (0.0, 0.0)
        self.speed += (linear - self.speed) * (1 - kept)
        self.rate += (rate - self.rate) * (1 - kept)
        self.heading += self.rate * frame_s
        self.x += self.speed * frame_s * math.cos(self.heading)
        self.y += self.speed * frame_s * math.sin(self.heading)
        for side, sign in ((0, -1), (1, 1)):
            self.wheels[side] += (self.speed + sign * self.rate * 0.1) * frame_s
        if move is not None:
            self.ball = move(self.now_s)
        seen = {"ball": None if self.is_hidden else self.see(self.ball)}
        seen |= {name: self.see(place) for name, place in self.others.items()}
        self._seen.append((self.now_s, seen))
        ripe = [each for each in self._seen if each[0] <= self.now_s - self.age_s + 1e-9]
        if not ripe:
            return
        at_s, seen = ripe[-1]
        told = [
            measured(name, at_s, where[0], 0.005, where[1]) if where else missed(name, at_s)
            for name, where in seen.items()
        ]
        report = None
        if self.reports or self.bumped is not None:
            wheels = self.wheels if self.reports else (None, None)
            report = BaseReport(at_s=self.now_s, left_m=wheels[0], right_m=wheels[1], is_bumped=self.bumped)
        observation = Observation(
            now_s=self.now_s,
            frame=FrameStamp(sequence=len(self._seen), captured_at_s=at_s),
            measurements=tuple(told),
            base=report,
            operator_commands=tuple(commands),
        )
        self.observations.append(observation)
        self.state, self.decision = decide(self.state, observation)
        (command,) = self.decision.commands
        self.told.append((command.linear_mps, command.angular_radps))
        self.events += [event for event in self.decision.events if event.source == "follow"]

    def kinds(self):
        return [event.kind.value for event in self.events]


@each_case("age_s", [0.03, 0.19])
@each_case("lag_s", [0.0, 0.1, 0.2])
def test_it_comes_to_the_distance_without_overshoot_however_late_it_sees_and_obeys(age_s, lag_s):
    floor, gaps = Floor(ball=(1.5, 0.0), age_s=age_s, lag_s=lag_s), []
    for _ in range(300):
        floor.cycle(1 / 30)
        gaps.append(floor.gap_m)
    assert min(gaps) > 0.95
    assert max(abs(gap - 1) for gap in gaps[80:]) < 0.1, "there within 2.7 s"
    assert abs(gaps[-1] - 1) < 0.035


@each_case("has_odometry", [False, True])
@each_case("share", [0.7, 1.0, 1.3])
def test_behind_a_walking_target_no_lag_is_left_also_where_wheels_go_faster_or_slower_than_told(has_odometry, share):
    floor = Floor(ball=(1.0, 0.0))
    floor.reports = has_odometry
    floor.see = lambda place: (
        place[0] - share * floor.x,
        0.0,
    )  # the floor slips below it, by as much as its wheels err
    floor.run(12, move=lambda t: (1.0 + 0.3 * max(0.0, t - 1), 0.0))
    assert floor.see(floor.ball)[0] == pytest.approx(1.0, abs=0.06)


def test_a_base_slows_down_as_gently_as_it_speeds_up_and_never_jerks():
    floor = Floor(ball=(2.5, 0.3)).run(10)
    speeds = [linear for linear, _ in floor.told]
    changes = [(after - before) * 30 for before, after in itertools.pairwise(speeds)]
    assert max(map(abs, changes)) <= 0.5 + 1e-6
    jerks = [abs(after - before) * 30 for before, after in itertools.pairwise(changes)]
    assert sorted(jerks)[-3] <= 5.0 + 1e-6, "but for the moment at which it arrives"


def test_when_its_target_is_gone_or_much_too_near_it_stops_at_once():
    floor = Floor(ball=(3.0, 0.0)).run(2)
    assert floor.told[-1][0] > 0.4
    floor.is_hidden = True
    floor.run(0.5)
    assert floor.told[-1] == (0.0, 0.0)
    floor = Floor(ball=(3.0, 0.0)).run(2)
    floor.ball = (floor.x + 0.3, 0.0)
    floor.run(0.4)
    assert floor.told[-1][0] == 0.0


def test_following_without_a_finite_bearing_asks_for_nothing():
    floor = Floor()
    floor.see = lambda _: (2.0, math.nan)
    floor.run(1)
    assert set(floor.told) == {(0.0, 0.0)}
    assert floor.decision.rules[0].status is RuleStatus.UNKNOWN


def test_a_slider_drives_and_never_turns_nor_searches():
    floor = Floor(replace(FOLLOW, angular_max_radps=0.0), ball=(2.0, 0.3)).run(4)
    assert floor.x > 0.5
    floor.ball = (floor.x, 5.0)
    floor.run(5)
    assert {rate for _, rate in floor.told} == {0.0}


# Searching


@pytest.mark.parametrize("side", [1, -1])
def test_it_turns_in_steps_to_the_side_where_its_target_left(side):
    floor = Floor(ball=(1.0, 0.35 * side)).run(0.6)
    floor.ball = (math.cos(1.9), side * math.sin(1.9))
    begun = len(floor.told)
    floor.run(5)
    turned = [rate for _, rate in floor.told[begun + 15 :] if rate]
    assert floor.in_view
    assert "search_begun" in floor.kinds()
    assert side * turned[0] > 0
    assert {linear for linear, _ in floor.told[begun + 10 : begun + 40]} == {0.0}, "it turns in place only"


def test_it_looks_first_where_its_target_was_going():
    floor = Floor(ball=(1.5, 0.3)).run(1)
    floor.run(0.4, move=lambda t: (1.5, 0.3 - 1.0 * (t - 1.0)))
    floor.is_hidden = True
    begun = len(floor.told)
    floor.run(3)
    assert next(rate for _, rate in floor.told[begun + 15 :] if rate) < 0, "it was on its way to the right"


def test_between_two_steps_it_looks():
    floor = Floor(ball=(1.0, 0.3)).run(0.6)
    floor.ball = (-1.0, -0.1)
    begun = len(floor.told)
    floor.run(4)
    turning = [rate != 0 for _, rate in floor.told[begun + 12 :]]
    changes = sum(before and not after for before, after in itertools.pairwise(turning))
    assert changes >= 2


def test_what_was_hidden_in_the_middle_of_the_view_is_waited_for():
    floor = Floor(ball=(1.0, 0.0)).run(1)
    floor.is_hidden = True
    floor.run(1)
    floor.is_hidden = False
    floor.run(0.5)
    assert {rate for _, rate in floor.told} == {0.0}
    assert floor.decision.rules[0].status is RuleStatus.IDLE
    assert floor.kinds() == []


def test_it_gives_up_after_its_angle_or_its_time_and_says_so_once():
    for search in (Search(angle_rad=math.radians(90)), Search(for_s=4.0)):
        floor = Floor(replace(FOLLOW, search=search, severity=Severity.ALARM), ball=(1.0, 0.0)).run(1)
        floor.is_hidden = True
        floor.run(20)
        assert floor.kinds() == ["search_begun", "search_ended"]
        assert floor.events[-1].severity is Severity.ALARM
        assert abs(floor.heading) < math.radians(160)
        assert floor.told[-1] == (0.0, 0.0)
        assert "stands still" in explain(floor.decision, "follow").sentence
        floor.is_hidden = False
        floor.ball = (floor.x + 2 * math.cos(floor.heading), floor.y + 2 * math.sin(floor.heading))
        floor.run(1)
        assert floor.told[-1][0] > 0, "it goes on as soon as it sees its target"


def test_nothing_is_searched_that_was_never_seen():
    floor = Floor(ball=(-2.0, 0.0)).run(10)
    assert set(floor.told) == {(0.0, 0.0)}


def test_search_is_off_where_that_is_said():
    floor = Floor(replace(FOLLOW, search=None), ball=(1.0, 0.0)).run(1)
    floor.is_hidden = True
    floor.run(10)
    assert set(floor.told[40:]) == {(0.0, 0.0)}


def test_a_base_that_touches_something_does_not_turn_blindly():
    floor = Floor(ball=(1.0, 0.3)).run(1)
    floor.is_hidden, floor.bumped = True, True
    floor.run(6)
    assert {rate for _, rate in floor.told[45:]} == {0.0}


def test_without_fresh_frames_it_does_not_search():
    floor = Floor(ball=(1.0, 0.3)).run(1)
    floor.is_hidden = True
    floor.run(1)
    frame_at_s = floor.observations[-1].frame.captured_at_s
    for number in range(60):
        now_s = floor.now_s + (number + 1) / 30
        floor.state, decision = decide(floor.state, Observation(now_s=now_s, camera_fault="no frame"))
        if now_s - frame_at_s > 0.2:
            assert decision.commands == (TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0),)


def test_a_run_that_is_armed_anew_does_not_search_for_what_it_saw_before():
    floor = Floor(ball=(1.0, 0.0)).run(1)
    floor.run(0.2, OperatorCommand(id="1", action=OperatorAction.DISARM))
    floor.is_hidden = True
    floor.run(1)
    begun = len(floor.told)
    floor.run(10, OperatorCommand(id="2", action=OperatorAction.ARM))
    assert set(floor.told[begun:]) == {(0.0, 0.0)}


# Tether


@pytest.mark.parametrize("has_odometry", [False, True])
def test_on_a_tether_it_goes_so_far_and_no_further_and_says_so_once(has_odometry):
    floor = Floor(replace(FOLLOW, tether_m=1.5), ball=(6.0, 0.0))
    floor.reports = has_odometry
    floor.run(10)
    assert 1.3 < floor.x <= 1.5
    assert floor.kinds() == ["tethered"]
    assert "tether" in explain(floor.decision, "follow").sentence
    floor.is_hidden = True
    floor.run(6)
    assert floor.told[-1] == (0.0, 0.0)
    assert "search_begun" not in floor.kinds(), "and it does not turn blindly there"


def test_back_towards_where_it_began_it_may_go():
    floor = Floor(replace(FOLLOW, tether_m=1.0, reverse_max_mps=0.4), ball=(6.0, 0.0)).run(6)
    floor.run(4, move=lambda _: (1.2, 0.0))
    assert floor.x < 0.4


def test_where_it_is_armed_the_tether_begins():
    floor = Floor(replace(FOLLOW, tether_m=1.0), ball=(6.0, 0.0)).run(6)
    floor.run(0.1, OperatorCommand(id="1", action=OperatorAction.DISARM))
    floor.run(6, OperatorCommand(id="2", action=OperatorAction.ARM))
    assert 1.7 < floor.x <= 2.0


# Slow near another target

SLOW = replace(FOLLOW, slow=SlowNear(target="wall", start_m=1.5, full_m=0.5))


def test_near_another_target_it_is_slow_and_at_last_it_stands():
    floor = Floor(SLOW, ball=(6.0, 0.3), targets=("ball", "wall"))
    floor.others = {"wall": (3.0, -0.4)}
    fastest = {}
    for _ in range(400):
        floor.cycle(1 / 30)
        away_m = round(math.hypot(3.0 - floor.x, -0.4 - floor.y), 1)
        fastest[away_m] = max(fastest.get(away_m, 0.0), floor.told[-1][0] if floor.told else 0.0)
    assert fastest[2.0] > 0.45
    assert fastest[1.0] < 0.3
    assert math.hypot(3.0 - floor.x, -0.4 - floor.y) > 0.45
    assert floor.told[-1][0] < 0.03


def test_what_it_is_slow_near_counts_where_it_was_seen_last_until_the_base_is_away_from_there():
    floor = Floor(SLOW, ball=(6.0, 0.0), targets=("ball", "wall"))
    floor.others = {"wall": (2.0, 0.2)}
    floor.run(3)
    floor.others = {"wall": (-9.0, 0.0)}  # out of sight
    floor.run(10)
    assert math.hypot(2.0 - floor.x, 0.2 - floor.y) > 0.4
