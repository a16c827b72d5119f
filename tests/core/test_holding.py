"""Outputs that people hold: for half a second, below safety, and above all rules but those of safety."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.command import LevelCommand, TwistCommand
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import SafetyMode, Severity
from stadimeter.core.holding import HOLD_S
from stadimeter.core.observation import FrameStamp, Observation, OutputFault
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety
from stadimeter.core.rule import AlarmRule, EscalationStep, FollowRule
from stadimeter.core.rules.explaining import explain
from stadimeter.operator_actions import HoldCommand
from support.observing import Rehearsal, measured

NEAR = AlarmRule(name="near", target="ball", output="motor", condition=DistanceCondition(below=1.0))
PLAN = Plan(
    targets=("ball",),
    rules=(NEAR,),
    outputs=(LevelOutput(name="motor"), LevelOutput(name="slow", rise_per_s=1.0), BaseOutput(name="base")),
    safety=Safety(good_frames=1),
)
NAN = float("nan")


class Run(Rehearsal):
    """A run in which a person holds outputs."""

    def hold(self, output="motor", seconds=0.1, distance_m=3.0, faults=(), **how):
        """Give a frame and a command with it; return the answer."""
        self.now_s = round(self.now_s + seconds, 9)
        command = HoldCommand(id="1", output=output, by="Ada", **how)
        decision = self.cycle(self.frame(distance_m, faults, (command,)))
        return decision.answers[0]

    def frame(self, distance_m=3.0, faults=(), commands=()):
        return Observation(
            now_s=self.now_s,
            frame=FrameStamp(sequence=len(self.decisions), captured_at_s=self.now_s),
            measurements=(measured("ball", self.now_s, distance_m),),
            output_faults=faults,
            operator_commands=commands,
        )

    def output(self, name="motor"):
        """Return what an output does, and the trace that says why."""
        decision = self.decisions[-1][1]
        (command,) = [each for each in decision.commands if each.output == name]
        (trace,) = [each for each in decision.outputs if each.output == name]
        return command, trace


@pytest.fixture
def run():
    run = Run(PLAN)
    run.see(3.0, 3.0)
    return run


def test_an_output_is_held_for_half_a_second_and_a_trace_says_by_whom(run):
    assert run.hold(level=0.4).words == "motor: held at 40%"
    command, trace = run.output()
    assert (command.level, trace.winner, trace.held_by) == (0.4, "operator", "Ada")
    run.see(3.0, 3.0, 3.0, 3.0)
    assert run.output()[0].level == 0.4
    run.see(3.0)
    command, trace = run.output()
    assert (command.level, trace.winner, trace.held_by) == (0.0, "safe", "")


def test_a_hold_that_is_repeated_goes_on_and_one_that_is_let_go_of_ends_at_once(run):
    for _ in range(4):
        run.hold(level=1.0, seconds=0.3 - 0.1 * (len(run.decisions) % 2))
        assert run.output()[0].level == 1.0
    assert run.hold(is_release=True).accepted
    assert run.output()[0].level == 0.0
    assert run.hold(is_release=True).words == "motor: it was not held"


def test_a_held_output_stands_before_a_rule_and_the_rule_acts_again_afterwards(run):
    run.see(0.5, 0.5)
    run.hold(level=0.2, distance_m=0.5)
    command, trace = run.output()
    assert (command.level, trace.losers) == (0.2, ("near",))
    run.see(*[0.5] * 6)
    assert run.output()[1].winner == "near"


def test_a_rule_whose_output_is_held_explains_by_whom(run):
    run.see(0.5, 0.5)
    run.hold(level=0.2, distance_m=0.5)
    assert explain(run.decisions[-1][1], "near").sentence.endswith("; but 'motor' is held by Ada, to try it")


def test_no_hold_stands_before_a_rule_of_safety():
    rules = (NEAR, replace(NEAR, name="touching", severity=Severity.SAFETY, condition=DistanceCondition(below=0.6)))
    run = Run(replace(PLAN, rules=rules))
    run.see(0.5, 0.5, 0.5)
    assert run.hold(level=0.0, distance_m=0.5).accepted
    command, trace = run.output()
    assert (command.level, trace.winner, trace.losers) == (1.0, "touching", ("operator", "near"))


def test_no_hold_stands_before_what_the_escalation_of_a_rule_of_safety_wants():
    stop = (EscalationStep(output="base"),)
    run = Run(replace(PLAN, rules=(replace(NEAR, severity=Severity.SAFETY, escalation=stop),)))
    run.see(0.5, 0.5, 0.5)
    run.hold("base", linear_mps=0.2, distance_m=0.5)
    run.hold("base", linear_mps=0.2, distance_m=0.5)
    command, trace = run.output("base")
    assert (command.linear_mps, trace.winner, trace.losers) == (0.0, "near", ("operator",))


def test_a_base_is_held_no_faster_than_a_test_may_be(run):
    run.hold("base", linear_mps=3.0, angular_radps=-9.0)
    for _ in range(10):
        run.hold("base", linear_mps=3.0, angular_radps=-9.0)
    command, _ = run.output("base")
    assert (command.linear_mps, command.angular_radps) == (0.2, -0.5)
    run.see(*[3.0] * 5)
    assert run.output("base")[0] == TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0)


def test_a_held_output_rises_no_faster_than_its_limit(run):
    run.hold("slow", level=1.0)
    assert run.output("slow")[0].level == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("output", "how", "words"),
    [
        ("motor", {"level": NAN}, "level nan is not between 0 and 1"),
        ("motor", {"level": 1.01}, "level 1.01 is not between 0 and 1"),
        ("motor", {}, "takes a level"),
        ("motor", {"linear_mps": 0.1}, "takes a level"),
        ("base", {"level": 1.0}, "takes a speed"),
        ("base", {"linear_mps": NAN}, "not both finite"),
        ("base", {"angular_radps": float("inf")}, "not both finite"),
        ("rotor", {"level": 1.0}, "there is no output 'rotor'; the outputs are: motor, slow, base"),
    ],
)
def test_what_no_output_can_do_is_refused_in_words(run, output, how, words):
    answer = run.hold(output, **how)
    assert not answer.accepted
    assert words in answer.words
    assert run.state.holds == ()


def test_nothing_is_held_without_fresh_frames_and_a_hold_does_not_come_back_with_them(run):
    run.hold(level=1.0)
    run.wait(0.3)
    assert run.output()[1].winner == "safety"
    assert run.state.holds == ()
    run.see(3.0)
    assert run.output()[0].level == 0.0


def test_an_output_that_is_out_of_order_is_not_held_and_the_answer_says_why(run):
    answer = run.hold(level=1.0, faults=(OutputFault(output="motor", reason="no current flows"),))
    assert not answer.accepted
    assert "no current flows" in answer.words
    assert run.output()[0].level == 0.0


def test_a_hold_ends_when_the_program_stood_still(run):
    run.see(*[3.0] * 4)
    run.hold(level=1.0)
    run.now_s += 0.45
    run.see(3.0)
    assert run.state.holds == ()


STEPS = st.tuples(
    st.sampled_from([0.01, 0.05, 0.1, 0.3, 0.6]),
    st.sampled_from(["nothing", "motor", "base", "release"]),
    st.booleans(),
    st.floats(allow_nan=True),
)


@settings(deadline=None, max_examples=150)
@given(st.lists(STEPS, min_size=1, max_size=40))
def test_whatever_is_asked_for_no_hold_outlives_its_time_or_overrides_safety(steps):
    run = Run(PLAN)
    run.see(3.0)
    asked_s = {"motor": float("-inf"), "base": float("-inf")}
    for seconds, what, has_frame, value in steps:
        run.now_s = round(run.now_s + seconds, 9)
        commands = ()
        if what == "release":
            commands = (HoldCommand(id="1", output="motor", is_release=True),)
        elif what != "nothing":
            how = {"level": value} if what == "motor" else {"linear_mps": value}
            commands = (HoldCommand(id="1", output=what, **how),)
            asked_s[what] = run.now_s
        frame = run.frame(3.0, (), commands)
        run.cycle(frame if has_frame else replace(frame, frame=None, measurements=(), camera_fault="none"))
        decision = run.decisions[-1][1]
        for command in decision.commands:
            acts = command.level > 0 if isinstance(command, LevelCommand) else command.linear_mps != 0
            if acts:
                assert decision.safety is SafetyMode.ACTIVE
                assert run.now_s < asked_s[command.output] + HOLD_S


def test_a_base_that_a_rule_drives_stops_where_the_hold_says_so():
    plan = replace(PLAN, rules=(FollowRule(name="follow", target="ball", output="base", distance_m=1.0),))
    run = Run(plan)
    run.see(*[3.0] * 6)
    assert run.output("base")[0].linear_mps > 0
    run.hold("base", linear_mps=0.0, angular_radps=0.0)
    command, trace = run.output("base")
    assert (command.linear_mps, command.angular_radps, trace.winner) == (0.0, 0.0, "operator")
