"""The order in which rules were raised."""

from msgspec.structs import replace

from stadimeter.app.persistence.resumption import read_state, state_text
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.of_rules import SequenceCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.persistence import restore_alarms, snapshot_alarms
from stadimeter.core.plan import Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule
from stadimeter.core.rules.explaining import explain
from support.observing import measured

LEFT, RIGHT = (
    AlarmRule(name=name, target=name, condition=DistanceCondition(below=1.0), off_delay_s=0.0)
    for name in ("left", "right")
)
ORDER = SequenceCondition(rules=("left", "right"), within_s=2.0)


class Run:
    """A run of two balls, at 10 Hz."""

    def __init__(self, condition=ORDER):
        order = AlarmRule(name="order", target="left", condition=condition, off_delay_s=0.0)
        tracking = Tracking(confirm_frames=1, outliers_max=0, acceleration_mps2=500.0, autocorrelation=0.0)
        self.plan = Plan(
            targets=("left", "right"), rules=(order, LEFT, RIGHT), tracking=tracking, safety=Safety(good_frames=1)
        )
        self.state = initial_state(self.plan)
        self.now_s, self.frames = 0.0, 0

    def see(self, left_m, right_m, for_s=0.5):
        """Return whether the order is active after some time in which the balls stand there."""
        for _ in range(round(for_s * 10)):
            self.now_s = round(self.now_s + 0.1, 9)
            self.frames += 1
            seen = (measured("left", self.now_s, left_m, 0.001), measured("right", self.now_s, right_m, 0.001))
            stamp = FrameStamp(sequence=self.frames, captured_at_s=self.now_s)
            observation = Observation(now_s=self.now_s, frame=stamp, measurements=seen)
            self.state, self.decision = decide(self.state, observation)
        return self.decision.rules[0].active


FAR, CLOSE = 3.0, 0.5


def test_it_holds_from_the_last_raise_on_while_the_last_rule_is_active():
    run = Run()
    assert run.see(FAR, FAR) is False
    assert run.see(CLOSE, FAR) is False
    assert run.see(CLOSE, CLOSE) is True
    assert run.see(FAR, CLOSE, 5.0) is True
    assert run.see(FAR, FAR) is False


def test_the_other_order_and_one_that_takes_too_long_are_none():
    run = Run()
    run.see(FAR, FAR)
    run.see(FAR, CLOSE)
    assert run.see(CLOSE, CLOSE, 5.0) is False
    run.see(FAR, FAR)
    run.see(CLOSE, FAR, 3.0)
    assert run.see(CLOSE, CLOSE) is False


def test_both_in_one_picture_are_in_no_order():
    run = Run()
    run.see(FAR, FAR)
    assert run.see(CLOSE, CLOSE, 3.0) is False


def test_the_first_may_be_over_when_the_last_comes():
    run = Run()
    run.see(FAR, FAR)
    run.see(CLOSE, FAR)
    run.see(FAR, FAR)
    assert run.see(FAR, CLOSE) is True


def test_what_the_first_does_later_changes_nothing():
    run = Run()
    run.see(FAR, FAR)
    run.see(CLOSE, FAR)
    run.see(FAR, CLOSE)
    assert run.see(CLOSE, CLOSE) is True


def test_the_last_alone_again_is_no_order():
    run = Run()
    run.see(FAR, FAR)
    run.see(CLOSE, FAR)
    run.see(FAR, CLOSE)
    run.see(FAR, FAR, 3.0)
    assert run.see(FAR, CLOSE) is False


def test_with_a_time_it_holds_for_that_long_whatever_comes():
    run = Run(replace(ORDER, for_s=2.0))
    run.see(FAR, FAR)
    run.see(CLOSE, FAR)
    assert run.see(FAR, CLOSE) is True
    assert run.see(FAR, FAR, 1.0) is True
    assert run.see(FAR, FAR, 1.0) is False
    run = Run(replace(ORDER, for_s=1.0))
    run.see(FAR, FAR)
    run.see(CLOSE, FAR)
    assert run.see(FAR, CLOSE, 3.0) is False


def test_it_is_remembered_beyond_a_restart_and_in_a_recording():
    run = Run()
    run.see(FAR, FAR)
    run.see(CLOSE, FAR)
    run.see(CLOSE, CLOSE)
    begun = initial_state(run.plan)
    recorded = read_state(state_text(run.state), begun)
    assert recorded.rules.raised_at_s == run.state.rules.raised_at_s
    snapshot = snapshot_alarms(run.state)
    run.state = restore_alarms(begun, snapshot, shift_s=100.0, from_s=run.now_s + 100, now_s=run.now_s + 100)
    run.now_s += 100.0
    assert run.see(CLOSE, CLOSE) is True


def test_an_explanation_says_when_each_was_raised():
    run = Run()
    run.see(FAR, FAR)
    run.see(CLOSE, FAR)
    words = explain(run.decision, "order").sentence
    assert "left was raised 0.4 s ago, right was not raised; in this order within 2 s" in words
