"""Stop everything: every output at its safe value until released, before all rules, whoever asks for more."""

import pytest
from msgspec.structs import replace

from stadimeter.core.command import LevelCommand, TwistCommand
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import EventKind, SafetyMode, Severity
from stadimeter.core.observation import FrameStamp, Observation, OutputFault
from stadimeter.core.persistence import reload
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety
from stadimeter.core.rule import AlarmRule, FollowRule
from stadimeter.core.rules.explaining import explain
from stadimeter.operator_actions import HoldCommand, OperatorAction, OperatorCommand
from support.observing import Rehearsal, measured

NEAR = AlarmRule(
    name="near", target="ball", output="motor", condition=DistanceCondition(below=4.0), severity=Severity.SAFETY
)
FOLLOW = FollowRule(name="follow", target="ball", output="base", distance_m=2.0)
PLAN = Plan(
    targets=("ball",),
    rules=(NEAR, FOLLOW, replace(NEAR, name="vent", output="valve", level=0.0)),
    outputs=(
        LevelOutput(name="motor", fall_per_s=0.1),
        LevelOutput(name="valve", safe_level=0.6),
        BaseOutput(name="base"),
    ),
    safety=Safety(good_frames=1),
)
SAFE = (
    LevelCommand(output="motor", level=0.0),
    LevelCommand(output="valve", level=0.6),
    TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0),
)


class Run(Rehearsal):
    """A run whose outputs a person stops."""

    def ask(self, *commands, distance_m=3.0, faults=(), seconds=0.1, has_frame=True):
        """Give commands with a frame; return the decision."""
        self.now_s = round(self.now_s + seconds, 9)
        frame = FrameStamp(sequence=len(self.decisions), captured_at_s=self.now_s) if has_frame else None
        seen = (measured("ball", self.now_s, distance_m),) if has_frame else ()
        return self.cycle(
            Observation(
                now_s=self.now_s, frame=frame, measurements=seen, output_faults=faults, operator_commands=commands
            )
        )


def stop(by="zoe", why=""):
    return OperatorCommand(id="1", action=OperatorAction.STOP_OUTPUTS, by=by, why=why)


def release(by="ada"):
    return OperatorCommand(id="2", action=OperatorAction.RELEASE_OUTPUTS, by=by)


@pytest.fixture
def run():
    """A run in which every output acts: the motor runs, the valve is shut, the base drives."""
    run = Run(PLAN)
    run.see(3.0, 3.0, 3.0)
    motor, valve, base = run.decisions[-1][1].commands
    assert motor.level > 0
    assert valve.level == 0.0
    assert base.linear_mps != 0
    return run


def kinds(run):
    return [(event.kind, event.source, event.by) for _, decision in run.decisions for event in decision.events][-2:]


def test_every_output_goes_to_its_safe_value_at_once_and_before_rules_of_safety(run):
    decision = run.ask(stop(why="a child"))
    assert decision.commands == SAFE
    assert decision.safety is SafetyMode.STOPPED
    assert {trace.winner for trace in decision.outputs} == {"safety"}
    assert all("by zoe: a child" in trace.reason for trace in decision.outputs)
    assert decision.answers[0].accepted


def test_it_lasts_until_it_is_released_and_then_the_rules_act_again(run):
    run.ask(stop())
    for _ in range(50):
        assert run.ask().commands == SAFE
    assert run.ask(release()).safety is SafetyMode.ACTIVE
    motor, valve, base = run.ask().commands
    assert motor.level > 0
    assert valve.level == 0.0
    assert base.linear_mps != 0


def test_a_second_stop_changes_nothing_and_one_release_ends_both(run):
    run.ask(stop("zoe"))
    again = run.ask(stop("max"))
    assert again.answers[0].accepted
    assert "by zoe" in again.answers[0].words
    assert not again.events
    released = run.ask(release())
    assert released.safety is SafetyMode.ACTIVE
    assert kinds(run) == [(EventKind.STOPPED, "outputs", "zoe"), (EventKind.RELEASED, "outputs", "ada")]


def test_a_release_without_a_stop_is_no_error_and_no_event(run):
    decision = run.ask(release())
    assert decision.answers[0].accepted
    assert not decision.events


@pytest.mark.parametrize("commands", [(release(), stop()), (stop(), stop())])
def test_of_several_in_one_cycle_the_last_one_counts(run, commands):
    assert run.ask(*commands).commands == SAFE
    assert run.ask(stop(), release()).safety is SafetyMode.ACTIVE


def test_holds_end_and_none_begins_before_the_release(run):
    hold = HoldCommand(id="3", output="motor", level=1.0)
    run.ask(hold)
    decision = run.ask(hold, stop())
    assert decision.commands == SAFE
    assert [answer.accepted for answer in decision.answers] == [True, False]
    assert run.ask(release()).outputs[0].held_by == ""


def test_what_stops_outputs_besides_is_still_said_and_outlasts_the_release(run):
    run.ask(stop())
    for _ in range(4):
        decision = run.ask(has_frame=False)
    assert decision.safety is SafetyMode.STOPPED
    assert "by zoe" in decision.safety_reason
    assert "ms old" in decision.safety_reason
    assert run.ask(release(), has_frame=False).safety is SafetyMode.STALE


def test_it_outlasts_a_pause_of_the_program_a_reload_and_a_fault(run):
    run.ask(stop())
    run.ask(seconds=5.0)
    run.ask(faults=(OutputFault(output="motor", reason="no answer"),))
    run.state = reload(run.state, replace(PLAN, rules=())).state
    run.state = reload(run.state, PLAN).state
    for _ in range(3):
        assert run.ask().commands == SAFE


def test_alarms_go_on_beneath(run):
    run.ask(stop())
    for _ in range(30):
        run.ask(distance_m=6.0)
    for _ in range(10):
        decision = run.ask()
    assert decision.rules[0].active
    raised = [event for _, each in run.decisions for event in each.events if event.kind is EventKind.RAISED]
    assert len([event for event in raised if event.source == "near"]) == 2


def test_a_rule_explains_who_keeps_its_output_from_acting(run):
    sentence = explain(run.ask(stop(why="a child")), "near").sentence
    assert "'motor' is kept safe: stopped until released, by zoe: a child" in sentence
