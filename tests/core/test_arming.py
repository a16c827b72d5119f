"""Arming: outputs at their safe values until somebody says that they may act, and again after what must not go on."""

import pytest
from msgspec.structs import replace

from stadimeter.core.command import TwistCommand
from stadimeter.core.decision import EventKind, SafetyMode, Severity
from stadimeter.core.observation import FrameStamp, Observation, OutputFault
from stadimeter.core.persistence import reload
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety
from stadimeter.core.rule import FollowRule, RampRule
from stadimeter.operator_actions import HoldCommand, OperatorAction, OperatorCommand
from support.observing import Rehearsal, measured

PLAN = Plan(
    targets=("ball",),
    rules=(
        FollowRule(name="follow", target="ball", output="base", distance_m=1.0),
        RampRule(name="far", target="ball", output="motor", start=1.0, full=2.0),
    ),
    outputs=(BaseOutput(name="base"), LevelOutput(name="motor")),
    safety=Safety(good_frames=2, arm="by-command"),
)
AT_REST = TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0)


class Run(Rehearsal):
    def ask(self, *commands, seconds=0.1, **observed):
        """Give commands with a frame of a ball at 3 m; return the decision."""
        self.now_s = round(self.now_s + seconds, 9)
        frame = FrameStamp(sequence=len(self.decisions), captured_at_s=self.now_s)
        seen = (measured("ball", self.now_s, 3.0),)
        whole = {"frame": frame, "measurements": seen, **observed}
        return self.cycle(Observation(now_s=self.now_s, operator_commands=commands, **whole))


def tell(action, by="zoe", why="", *, is_from_button=False):
    return OperatorCommand(id=action, action=OperatorAction(action), by=by, why=why, is_from_button=is_from_button)


def run_of(arm, frames=3):
    run = Run(replace(PLAN, safety=replace(PLAN.safety, arm=arm)))
    for _ in range(frames):
        run.ask()
    return run


@pytest.fixture
def armed():
    """A run that was armed, and drives."""
    run = run_of("by-command")
    run.ask(tell("arm"))
    assert run.ask().commands[0].linear_mps > 0
    return run


def moves(decision):
    return decision.commands[0] != AT_REST or decision.commands[1].level > 0


def test_without_a_word_about_it_a_run_is_armed_from_the_start():
    assert moves(run_of("at-start").ask())


@pytest.mark.parametrize("arm", ["by-command", "by-button"])
def test_a_run_that_must_be_armed_moves_nothing_however_long_it_sees_its_target(arm):
    run = run_of(arm, frames=100)
    assert not any(moves(decision) for _, decision in run.decisions)
    decision = run.ask()
    assert decision.safety is SafetyMode.DISARMED
    assert decision.safety_reason == "disarmed since the start"
    assert {trace.winner for trace in decision.outputs} == {"safety"}
    assert not run.events("outputs"), "that it begins so is no news"


def test_once_armed_it_drives_and_the_event_says_who_did_it():
    run = run_of("by-command")
    answers = run.ask(tell("arm", why="the floor is clear")).answers
    assert [(answer.accepted, answer.words) for answer in answers] == [(True, "armed")]
    assert moves(run.ask())
    (event,) = [each for _, decision in run.decisions for each in decision.events if each.source == "outputs"]
    assert (event.kind, event.by, event.reason) == (EventKind.ARMED, "zoe", "by zoe: the floor is clear")


def test_before_enough_fresh_frames_it_cannot_be_armed():
    run = run_of("by-command", frames=0)
    decision = run.ask(tell("arm"))
    assert not decision.answers[0].accepted
    assert "1 of 2 fresh frames" in decision.answers[0].words
    assert [each.kind for each in decision.events] == [EventKind.REFUSED]
    for _ in range(5):
        assert not moves(run.ask()), "nor does it act later, when no one thinks of it any more"


def test_only_a_button_arms_where_that_is_demanded():
    run = run_of("by-button")
    refused = run.ask(tell("arm")).answers[0]
    assert not refused.accepted
    assert "push button" in refused.words
    assert run.ask(tell("arm", is_from_button=True)).answers[0].accepted
    assert moves(run.ask())
    run.ask(tell("disarm"))
    assert not moves(run.ask()), "anybody may disarm"


@pytest.mark.parametrize("arm", ["at-start", "by-command"])
def test_disarming_stops_at_once_until_it_is_armed(arm):
    run = run_of(arm)
    run.ask(tell("arm"))
    decision = run.ask(tell("disarm", why="I carry it"))
    assert decision.commands[0] == AT_REST
    assert decision.events[-1].severity is Severity.SAFETY
    assert run.ask().safety_reason == "disarmed by zoe: I carry it"
    assert not run.ask(tell("disarm")).events, "once is enough"
    run.ask(tell("arm"))
    assert moves(run.ask())


def test_a_base_that_failed_stays_at_rest_until_it_is_armed_again(armed):
    fault = OutputFault(output="base", reason="no answer")
    decision = armed.ask(output_faults=(fault,))
    assert decision.safety is SafetyMode.DISARMED
    assert not armed.ask(tell("arm"), output_faults=(fault,)).answers[0].accepted
    for _ in range(50):
        assert not moves(armed.ask())
    assert armed.ask().safety_reason == "disarmed since base: no answer"
    armed.ask(tell("arm"))
    assert moves(armed.ask())


def test_what_does_not_drive_may_fail_without_that(armed):
    armed.ask(output_faults=(OutputFault(output="motor", reason="no answer"),))
    assert armed.ask().safety is SafetyMode.ACTIVE


def test_one_that_arms_by_itself_goes_on_after_a_fault_as_ever():
    run = run_of("at-start")
    run.ask(output_faults=(OutputFault(output="base", reason="no answer"),))
    assert moves(run.ask())


@pytest.mark.parametrize("arm", ["at-start", "by-command", "by-button"])
def test_a_reason_to_distrust_the_camera_disarms_whatever_is_configured(arm):
    run = run_of(arm)
    run.ask(tell("arm", is_from_button=True))
    assert moves(run.ask())
    decision = run.ask(disarm_reason="the picture stands still while the base turns")
    assert not moves(decision)
    assert decision.events[-1].kind is EventKind.DISARMED
    for _ in range(20):
        assert not moves(run.ask())


def test_frames_that_are_late_for_a_moment_do_not_disarm(armed):
    armed.wait(0.5)
    assert armed.decisions[-1][1].safety is SafetyMode.STALE
    for _ in range(4):
        armed.ask()
    assert moves(armed.ask())


def test_a_stop_by_a_person_is_shown_first_and_must_be_released_first(armed):
    armed.ask(tell("disarm"))
    decision = armed.ask(tell("stop-outputs"))
    assert decision.safety is SafetyMode.STOPPED
    assert "disarmed by zoe" in decision.safety_reason
    assert not armed.ask(tell("arm")).answers[0].accepted
    assert armed.ask(tell("release-outputs")).safety is SafetyMode.DISARMED


def test_nobody_can_try_an_output_that_is_disarmed():
    decision = run_of("by-command").ask(HoldCommand(id="1", output="motor", level=1.0))
    assert not decision.answers[0].accepted
    assert not moves(decision)


def test_a_reload_keeps_it_disarmed_also_where_the_next_start_would_arm():
    run = run_of("by-command")
    run.state = reload(run.state, replace(PLAN, safety=Safety(good_frames=2))).state
    assert not moves(run.ask())
