"""When outputs may act: fresh frames, arming, and a stop by a person."""

import math

import pytest
from msgspec.structs import replace

from stadimeter.core.command import LevelCommand, TwistCommand
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import EventKind, SafetyMode, Severity
from stadimeter.core.observation import FrameStamp, Observation, OutputFault
from stadimeter.core.persistence import reload
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety
from stadimeter.core.rule import AlarmRule, FollowRule, RampRule
from stadimeter.core.rules.explaining import explain
from stadimeter.core.safety import FROM_THE_FUTURE_S, SafetyState, is_gap, step_safety, usual_step_s
from stadimeter.errors import CommandRangeError
from stadimeter.operator_actions import HoldCommand, OperatorAction, OperatorCommand
from support.observing import Rehearsal, measured

# Edges of the safety machine: exact limits, and what it says.

SETTINGS = Safety(max_frame_age_s=0.25, good_frames=2)


def stepped(*cycles, state=None):
    """Step through cycles of (now, capture time of a new frame or None, fault of the camera)."""
    state = state or SafetyState()
    for sequence, (now_s, captured_at_s, fault) in enumerate(cycles):
        frame = None if captured_at_s is None else FrameStamp(sequence=sequence, captured_at_s=captured_at_s)
        state = step_safety(state, Observation(now_s=now_s, frame=frame, camera_fault=fault), SETTINGS)
    return state


ACTIVE = [(1.0, 1.0, ""), (1.125, 1.125, "")]


def test_it_is_active_after_enough_frames_and_gives_no_reason():
    assert stepped(ACTIVE[0]).mode is SafetyMode.STARTING
    assert stepped(ACTIVE[0]).reason == "1 of 2 fresh frames in a row"
    assert (stepped(*ACTIVE).mode, stepped(*ACTIVE).reason) == (SafetyMode.ACTIVE, "")


@pytest.mark.parametrize(("now_s", "mode"), [(1.375, SafetyMode.ACTIVE), (1.3751, SafetyMode.STALE)])
def test_a_frame_of_exactly_the_limit_is_fresh(now_s, mode):
    assert stepped(*ACTIVE, (now_s, None, "")).mode is mode


def test_an_old_frame_is_reported_with_its_age_the_limit_and_the_cameras_words():
    assert stepped(*ACTIVE, (2.125, None, "")).reason == "the newest frame is 1000 ms old, limit 250 ms"
    assert stepped(*ACTIVE, (2.125, None, "unplugged")).reason.endswith("limit 250 ms: unplugged")


def test_without_any_frame_the_cameras_words_are_the_reason():
    assert stepped((1.0, None, "")).reason == "no frame yet"
    assert stepped((1.0, None, "unplugged")).reason == "unplugged"


def test_a_frame_that_comes_again_is_not_counted():
    assert stepped(ACTIVE[0], (1.1, 1.0, "")).mode is SafetyMode.STARTING


def test_after_stale_frames_the_row_begins_anew():
    stale = stepped(*ACTIVE, (2.125, None, ""))
    assert stepped((2.2, 2.2, ""), state=stale).mode is SafetyMode.STALE
    assert stepped((2.2, 2.2, ""), (2.3, 2.3, ""), state=stale).mode is SafetyMode.ACTIVE


@pytest.mark.parametrize(("ahead_s", "mode"), [(FROM_THE_FUTURE_S, SafetyMode.ACTIVE), (0.0626, SafetyMode.STARTING)])
def test_a_stamp_from_the_future_is_not_believed(ahead_s, mode):
    assert stepped(ACTIVE[0], (1.125, 1.125 + ahead_s, "")).mode is mode


def test_a_gap_is_named_with_its_length_and_the_limit():
    seen = Observation(now_s=5.0, frame=FrameStamp(sequence=9, captured_at_s=5.0))
    after = step_safety(stepped(*ACTIVE), seen, SETTINGS, gap_s=3.875)
    assert after.mode is SafetyMode.STALE
    assert after.reason == (
        "the program stood still for 3.88 s, limit 250 ms (safety.max_frame_age); 1 of 2 fresh frames in a row"
    )


@pytest.mark.parametrize(
    ("step_s", "usual_s", "gap"),
    [(0.25, 0.1, False), (0.2500005, 0.1, False), (0.26, 0.1, True), (0.26, 0.13, False), (9.0, 0.0, False)],
)
def test_a_gap_is_longer_than_the_limit_and_twice_as_long_as_usual(step_s, usual_s, gap):
    assert is_gap(step_s, usual_s, SETTINGS) is gap


@pytest.mark.parametrize(
    ("step_s", "usual_s", "usual"), [(0.3, 0.0, 0.3), (0.3, 0.2, 0.3), (0.9, 0.2, 0.4), (0.1, 0.2, 0.1)]
)
def test_the_usual_step_at_most_doubles(step_s, usual_s, usual):
    assert usual_step_s(step_s, usual_s) == pytest.approx(usual)


# Arming: outputs at their safe values until somebody says that they may act, and again after what must not go on.

PLAN_TO_ARM = Plan(
    targets=("ball",),
    rules=(
        FollowRule(name="follow", target="ball", output="base", distance_m=1.0),
        RampRule(name="far", target="ball", output="motor", start=1.0, full=2.0),
    ),
    outputs=(BaseOutput(name="base"), LevelOutput(name="motor")),
    safety=Safety(good_frames=2, arm="by-command"),
)
AT_REST = TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0)


class RunToArm(Rehearsal):
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
    run = RunToArm(replace(PLAN_TO_ARM, safety=replace(PLAN_TO_ARM.safety, arm=arm)))
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
    run.state = reload(run.state, replace(PLAN_TO_ARM, safety=Safety(good_frames=2))).state
    assert not moves(run.ask())


# Stop everything: every output at its safe value until released, before all rules, whoever asks for more.

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


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_speed_that_is_no_number_is_no_command(value: float) -> None:
    for linear_mps, angular_radps in ((value, 0.0), (0.0, value)):
        with pytest.raises(CommandRangeError):
            TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=0.0)
