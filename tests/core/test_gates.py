"""Gates: ramps and follow rules that act only while a condition holds, and what keeps them quiet; steps with one."""

import pytest
from msgspec.structs import replace

from stadimeter.core.command import TwistCommand
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.conditions.sight import PresenceCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import EventKind, RuleStatus, Severity
from stadimeter.core.observation import FrameStamp, Observation, WallTime
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule, EscalationStep, FollowRule, RampRule, Send, Template
from stadimeter.core.rules.explaining import explain
from stadimeter.operator_actions import OperatorAction, OperatorCommand
from support.observing import measured, missed

BY_NIGHT = ScheduleCondition(from_s=79200.0, to_s=21600.0)
NIGHT, DAY = (WallTime(second_of_day=hour * 3600.0, weekday=0) for hour in (23, 12))
OUTPUTS = (LevelOutput(name="buzzer"), BaseOutput(name="base", linear_accel_mps2=0.5, linear_jerk_mps3=5.0))


def gate(condition, suppress_when=None):
    return AlarmRule(name="", target="", condition=condition, suppress_when=suppress_when)


RAMP = RampRule(name="beep", target="ball", output="buzzer", start=2.0, full=1.0, gate=gate(BY_NIGHT))
FOLLOW = FollowRule(
    name="follow", target="ball", output="base", distance_m=1.0, linear_max_mps=0.5,
    gate=gate(PresenceCondition(seen=True, target="tag")),
)  # fmt: skip


class Run:
    """A run on what a test shows: where the ball and the tag are, and what time it is."""

    def __init__(self, *rules):
        tracking = Tracking(confirm_frames=1, coast_s=0.15, outliers_max=0, acceleration_mps2=20.0, autocorrelation=0.0)
        safety = Safety(good_frames=1)
        self.plan = Plan(targets=("ball", "tag"), rules=rules, outputs=OUTPUTS, tracking=tracking, safety=safety)
        self.state = initial_state(self.plan)
        self.now_s, self.frames, self.events, self.notices = 0.0, 0, [], []

    def see(self, ball_m, *, tag_m=None, wall=None, times=1, command=None):
        """Give frames at 10 Hz; return the decision on the last."""
        for _ in range(times):
            self.now_s = round(self.now_s + 0.1, 9)
            self.frames += 1
            seen = [
                missed(name, self.now_s) if at_m is None else measured(name, self.now_s, at_m)
                for name, at_m in (("ball", ball_m), ("tag", tag_m))
            ]
            self.state, decision = decide(
                self.state,
                Observation(
                    now_s=self.now_s,
                    frame=FrameStamp(sequence=self.frames, captured_at_s=self.now_s),
                    measurements=tuple(seen),
                    wall=wall,
                    operator_commands=() if command is None else (command,),
                ),
            )
            command = None
            self.events += [event.kind for event in decision.events]
            self.notices += decision.notices
        return decision

    def order(self, action, rule, **more):
        return OperatorCommand(id="1", action=OperatorAction(action), rule=rule, by="zoe", **more)


def level(decision):
    return decision.commands[0].level


def speed(decision):
    command = next(each for each in decision.commands if isinstance(each, TwistCommand))
    return command.linear_mps


def status(decision, rule):
    return next(trace for trace in decision.rules if trace.rule == rule)


def test_a_ramp_acts_only_while_its_gate_is_open():
    run = Run(RAMP)
    assert level(run.see(1.5, wall=NIGHT, times=5)) == pytest.approx(0.5, abs=0.05)
    decision = run.see(1.5, wall=DAY, times=2)
    assert (level(decision), status(decision, "beep").status) == (0.0, RuleStatus.IDLE)
    assert level(run.see(1.5, wall=NIGHT, times=2)) > 0.4


def test_where_a_gate_cannot_be_known_its_ramp_does_not_act():
    run = Run(RAMP)
    run.see(1.5, wall=NIGHT, times=5)
    decision = run.see(1.5, wall=None)
    assert (level(decision), status(decision, "beep").status) == (0.0, RuleStatus.UNKNOWN)
    assert status(decision, "beep").active is None
    assert "its `when` cannot be known" in decision.reasons["beep"]


def test_a_gate_has_the_hysteresis_of_its_condition():
    run = Run(replace(RAMP, gate=gate(DistanceCondition(below=1.0, deadband=0.5, target="tag"))))
    assert level(run.see(1.5, tag_m=1.3, times=5)) == 0.0
    assert level(run.see(1.5, tag_m=0.8, times=5)) > 0.4
    assert level(run.see(1.5, tag_m=1.3, times=5)) > 0.4
    assert level(run.see(1.5, tag_m=1.8, times=5)) == 0.0


def test_a_base_whose_gate_closes_stands_gently():
    run = Run(FOLLOW)
    before = speed(run.see(3.0, tag_m=2.0, times=40))
    assert before > 0.4
    speeds = [speed(run.see(3.0, tag_m=None)) for _ in range(40)]
    assert 0.0 < speeds[5] < before
    assert speeds[-1] == 0.0
    steps = [one - other for one, other in zip([before, *speeds], speeds, strict=False)]
    assert max(steps) <= 0.5 * 0.1 + 1e-9  # its acceleration, in a tenth of a second
    assert run.state.rules.wanted.get("base", ()) == ()


def test_a_base_whose_gate_cannot_be_known_stands_at_once():
    run = Run(replace(FOLLOW, gate=gate(DistanceCondition(below=5.0, target="tag"))))
    assert speed(run.see(3.0, tag_m=2.0, times=40)) > 0.4
    decision = run.see(3.0, tag_m=None, times=3)
    assert speed(decision) == 0.0
    assert status(decision, "follow").status is RuleStatus.UNKNOWN


def test_a_base_for_safety_whose_gate_closes_stands_at_once():
    run = Run(replace(FOLLOW, severity=Severity.SAFETY))
    assert speed(run.see(3.0, tag_m=2.0, times=40)) > 0.4
    decision = run.see(3.0, tag_m=None, times=3)
    assert speed(decision) == 0.0


def test_a_base_whose_gate_is_closed_neither_searches_nor_moves_when_it_never_opens():
    run = Run(FOLLOW)
    assert speed(run.see(3.0, times=20)) == 0.0
    decision = run.see(None, times=40)
    assert (speed(decision), decision.commands[1].angular_radps) == (0.0, 0.0)
    assert EventKind.SEARCH_BEGUN not in run.events


def test_while_it_brakes_it_gives_the_base_to_no_one_for_longer_than_braking_takes():
    other = replace(FOLLOW, name="other", gate=gate(PresenceCondition(seen=False, target="tag")), priority=50)
    run = Run(FOLLOW, other)
    assert speed(run.see(3.0, tag_m=2.0, times=40)) > 0.4
    run.see(3.0, tag_m=None, times=30)
    assert [request.rule for request in run.state.rules.wanted["base"]] == ["other"]
    assert speed(run.see(3.0, tag_m=None, times=20)) > 0.4


@pytest.mark.parametrize("rule", [replace(RAMP, gate=gate(PresenceCondition(seen=True, target="ball"))), FOLLOW])
def test_a_rule_is_shelved_and_acts_again_when_the_time_is_over(rule):
    run = Run(rule)
    acts = (lambda decision: level(decision) > 0.4) if rule.output == "buzzer" else (lambda d: speed(d) > 0.3)
    far_m = 1.5 if rule.output == "buzzer" else 3.0
    assert acts(run.see(far_m, tag_m=2.0, times=30))
    decision = run.see(far_m, tag_m=2.0, command=run.order("shelve", rule.name, for_s=3.0))
    assert decision.answers[0].accepted
    decision = run.see(far_m, tag_m=2.0, times=15)
    assert not acts(decision)
    assert status(decision, rule.name).inhibits == ("shelved",)
    assert "kept quiet: shelved by zoe for another 1.5 s" in explain(decision, rule.name).sentence
    assert acts(run.see(far_m, tag_m=2.0, times=30))
    assert run.events.count(EventKind.SHELVED) == run.events.count(EventKind.UNSHELVED) == 1


def test_a_rule_without_a_gate_is_taken_out_observed_and_put_back_like_an_alarm():
    run = Run(RampRule(name="beep", target="ball", output="buzzer", start=2.0, full=1.0))
    assert level(run.see(1.5, times=3)) > 0.4
    for action, word, back in (("take-out", "out of service", "put-back"), ("observe", "observed", "act")):
        decision = run.see(1.5, command=run.order(action, "beep"), times=2)
        assert (level(decision), status(decision, "beep").inhibits) == (0.0, (word,))
        assert level(run.see(1.5, command=run.order(back, "beep"), times=2)) > 0.4


def test_what_an_alarm_alone_can_do_is_refused_with_words():
    run = Run(RAMP)
    for action, words in (("acknowledge", "nothing to acknowledge"), ("set-threshold", "no threshold")):
        decision = run.see(1.5, wall=NIGHT, command=run.order(action, "beep", value=1.0))
        assert words in decision.answers[0].words
    assert not run.see(1.5, wall=NIGHT, command=run.order("reset", "beep")).answers[0].accepted


def test_a_safety_rule_cannot_be_shelved():
    run = Run(replace(RAMP, severity=Severity.SAFETY))
    decision = run.see(1.5, wall=NIGHT, command=run.order("shelve", "beep", for_s=1.0))
    assert decision.answers[0].words == "beep: a safety rule cannot be kept quiet"


def test_while_it_is_suppressed_a_ramp_is_quiet_and_not_by_guess():
    run = Run(replace(RAMP, gate=gate(PresenceCondition(seen=True, target="ball"), suppress_when=BY_NIGHT)))
    assert level(run.see(1.5, wall=DAY, times=3)) > 0.4
    decision = run.see(1.5, wall=NIGHT, times=2)
    assert (level(decision), status(decision, "beep").inhibits) == (0.0, ("suppressed",))
    assert level(run.see(1.5, wall=None, times=2)) > 0.4


def test_a_threshold_of_a_gate_is_moved_like_one_of_an_alarm():
    run = Run(replace(RAMP, gate=gate(DistanceCondition(below=1.0, target="tag"))))
    assert level(run.see(1.5, tag_m=1.5, times=5)) == 0.0
    assert run.see(1.5, tag_m=1.5, command=run.order("set-threshold", "beep", value=2.0)).answers[0].accepted
    decision = run.see(1.5, tag_m=1.5, times=2)
    assert level(decision) > 0.4
    assert "`below` is 2.00 m" in explain(decision, "beep").sentence


STEPS = (
    EscalationStep(after_s=0.5, send=Send(template=Template(text="{rule}"), topic="a"), when=BY_NIGHT),
    EscalationStep(after_s=0.5, output="buzzer", when=BY_NIGHT),
)
NEAR = AlarmRule(name="near", target="ball", condition=DistanceCondition(below=1.0), cooldown_s=0.0, escalation=STEPS)


@pytest.mark.parametrize(
    ("wall", "sent", "driven"), [(NIGHT, 1, 1.0), (DAY, 0, 0.0), (None, 1, 0.0)], ids=["holds", "does not", "unknown"]
)
def test_a_step_with_a_condition_is_done_if_that_holds_when_it_is_due(wall, sent, driven):
    run = Run(NEAR)
    run.see(0.5, wall=DAY if wall is NIGHT else NIGHT, times=3)
    decision = run.see(0.5, wall=wall, times=6)
    assert (len(run.notices), level(decision)) == (sent, driven)
    # Judged once: what comes later changes nothing.
    decision = run.see(0.5, wall=NIGHT if wall is not NIGHT else DAY, times=6)
    assert (len(run.notices), level(decision)) == (sent, driven)
