"""The decision: from what is known to what is done, in six steps.

judge the frame (safety) → track → rules → stops and arming (safety) → arbitrate → limit. `decide` is a function of its
arguments: the same state and observation give the same decision to the last bit, which is what makes a recorded run a
test.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import NamedTuple

from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.core.alarms.state import Sample
from stadimeter.core.camera_pose import step_mounting
from stadimeter.core.command import TwistCommand
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.quantities import QUANTITIES
from stadimeter.core.conditions.remembered import RememberedFigure, Summary, step_summary
from stadimeter.core.decision import Decision, Event, EventKind, SafetyMode, Severity
from stadimeter.core.holding import Hold, step_holds, with_holds
from stadimeter.core.liveness import LivenessState, step_liveness, tell_plain_room
from stadimeter.core.measurement import Measurement, TrackStatus
from stadimeter.core.observation import SECOND_CAMERA, Observation, OutputFault
from stadimeter.core.outputs import OutputStep, command_all, forbidden_outputs, new_output
from stadimeter.core.plan import BaseOutput, Plan
from stadimeter.core.rules.explaining import Reasons
from stadimeter.core.rules.scheduler import EvaluatedRules, judge, new_rules
from stadimeter.core.safety import (
    AT_START,
    SafetyState,
    in_words,
    is_gap,
    step_arming,
    step_safety,
    step_stop,
    usual_step_s,
    while_disarmed,
    while_stopped,
)
from stadimeter.core.sensor_fusion import fuse, step_disagreements
from stadimeter.core.tracking.life_cycle import TrackState, after_gap, new_track, step_nearest
from stadimeter.core.tracking.life_cycle import step as step_track
from stadimeter.core.tracking.transverse import TransverseMotion, motions_for, step_motion
from stadimeter.operator_actions import HoldCommand, OperatorAction, OperatorAnswer, OperatorCommand

# The additions of a cycle to what is remembered over windows of time; see `stadimeter.core.conditions.remembered` -----


class Added(NamedTuple):
    """The things that are new in a cycle."""

    inputs: RuleInputs
    """What the rules were judged by."""
    seen: Container[str]
    """The targets that were measured in the frame that is new."""
    was_active: Mapping[str, bool | None]
    """Which rules were active after the cycle before."""
    active: Mapping[str, bool | None]
    step_s: float
    """The time since the cycle before; 0 if it was not observed."""
    observation: Observation

    def to(self, figure: RememberedFigure) -> float | None:
        """Return the new value of a figure; None for none."""
        if figure.rules:
            if figure.quantity == "times":
                is_raised = self.active is not self.was_active and _is_any(self.active, figure.rules)
                return 1.0 if is_raised and not _is_any(self.was_active, figure.rules) else None
            return self.step_s if self.step_s and _is_any(self.was_active, figure.rules) else None
        track = self.inputs.tracks.get(figure.target)
        if track is None or track.target not in self.seen or track.status is not TrackStatus.TRACKING:
            return None
        found = QUANTITIES[figure.quantity].read(self.inputs, figure.target)
        return None if found is None else found[0]


def _is_any(active: Mapping[str, bool | None], rules: tuple[str, ...]) -> bool:
    return True in [active.get(rule) for rule in rules]


def step_figures(
    figures: tuple[RememberedFigure, ...], before: tuple[Summary, ...], added: Added
) -> tuple[Summary, ...]:
    """Return the summaries of all figures after a cycle: a reset of a rule empties the sums that it goes by."""
    observation = added.observation
    commands = [each for each in observation.operator_commands if isinstance(each, OperatorCommand)]
    emptied = {each.rule for each in commands if each.action is OperatorAction.RESET and each.rule}
    kept = [Summary() if figure.owner in emptied else was for figure, was in zip(figures, before, strict=True)]
    pairs = zip(figures, kept, strict=True)
    return tuple([step_summary(it, was, added.to(it), observation.now_s, observation.wall) for it, was in pairs])


class State(Struct, frozen=True, kw_only=True):
    """All that is remembered from one cycle to the next.

    Attributes:
        now_s: The time of the last cycle; None before the first.
        usual_step_s: From one cycle to the next, as it was lately; 0 before the second.
        faults: What was out of order in the last cycle: outputs, and the second camera.
        events: How many events there were in the run.
        due: Events of what happened between two cycles; they are part of the next decision.
        holds: The outputs that people hold.
        stopped: Who has stopped every output, and why, in words; empty while no one has.
        disagreeing: The range sensors that disagree with the camera.
        disarmed: Since when or by what the run is disarmed, in words; empty while it is armed.
        liveness: What the picture has shown of the robot's own motion.
        motions: How targets move across the line of sight, for those that some rule asks it of.
        figures: What is kept of the remembered figures, in the order of the plan.
        is_mounting_unconfirmed: Whether the camera was not mounted as it was saved.
    """

    plan: Plan
    now_s: float | None = None
    usual_step_s: float = 0.0
    tracks: tuple[TrackState, ...] = ()
    rules: EvaluatedRules = field(default_factory=EvaluatedRules)
    safety: SafetyState = field(default_factory=SafetyState)
    outputs: tuple[OutputStep, ...] = ()
    faults: tuple[OutputFault, ...] = ()
    events: int = 0
    due: tuple[Event, ...] = ()
    holds: tuple[Hold, ...] = ()
    stopped: str = ""
    disagreeing: frozenset[str] = frozenset()
    disarmed: str = ""
    liveness: LivenessState = field(default_factory=LivenessState)
    motions: tuple[TransverseMotion, ...] = ()
    figures: tuple[Summary, ...] = ()
    is_mounting_unconfirmed: bool = False


def initial_state(plan: Plan) -> State:
    """Return the state at the start of a run: nothing seen, every output at its safe value."""
    rules = new_rules(plan)
    return State(
        plan=plan,
        tracks=tuple(new_track(target) for target in plan.targets),
        rules=rules,
        motions=motions_for(rules.layout.motions),
        outputs=tuple(new_output(output) for output in plan.outputs),
        disarmed="" if plan.safety.arm == "at-start" else AT_START,
        figures=(Summary(),) * len(plan.figures),
    )


def decide(state: State, observation: Observation) -> tuple[State, Decision]:
    """Return the memory after one cycle, and what to do: one command for each output, events, and reasons."""
    plan = state.plan
    step_s = 0.0 if state.now_s is None else observation.now_s - state.now_s
    gap_s = step_s if is_gap(step_s, state.usual_step_s, plan.safety) else None
    safety = step_safety(state.safety, observation, plan.safety, gap_s=gap_s)
    is_new = safety.frame is not state.safety.frame
    seen, disagreeing, sensor_events = _see(state, observation, is_new=is_new)
    track_states = _step_tracks(state, seen, observation.now_s, gap_s)
    inputs = _rule_inputs(state, track_states, observation, safety, is_after_gap=gap_s is not None)
    rules, outcome = judge(state.rules, *judged_by(state, observation, inputs, safety))
    allowed = _step_permission(state, observation, safety, is_new=is_new)
    holds, answers, outputs = _act(state, observation, allowed.safety, rules, is_after_gap=gap_s is not None)
    seen_events = _track_events(state, track_states, observation.now_s, in_words(gap_s, plan.safety) if gap_s else "")
    happened = state.due + seen_events + outcome.events + allowed.events
    is_unconfirmed, confirmed, mounting_events = step_mounting(
        was_unconfirmed=state.is_mounting_unconfirmed,
        mounting=observation.mounting,
        commands=observation.operator_commands,
        now_s=observation.now_s,
    )
    happened += _camera_events(state.safety, safety, observation.now_s) + sensor_events + mounting_events
    events = _number(happened + _fault_events(state.faults, observation), state.events)
    decision = Decision(
        commands=tuple([step.command for step in outputs]),
        events=events,
        tracks=tuple([tracked.track for tracked in track_states]),
        safety=allowed.safety.mode,
        safety_reason=allowed.safety.reason,
        outputs=tuple([step.trace for step in outputs]),
        rules=rules.traces,
        notices=outcome.notices,
        answers=outcome.answers + allowed.answers + answers + confirmed,
        figures=inputs.figures and {each.name: inputs.figures[each.name] for each in plan.named_figures},
        reasons=Reasons(plan=plan, judged=rules, inputs=inputs),
    )
    new = Added(inputs, seen, state.rules.active, rules.active, 0.0 if gap_s else step_s, observation)
    remembered = State(
        plan=plan,
        now_s=observation.now_s,
        usual_step_s=usual_step_s(step_s, state.usual_step_s),
        tracks=track_states,
        rules=rules,
        safety=safety,
        outputs=outputs,
        faults=observation.faults,
        events=state.events + len(events),
        holds=holds,
        stopped=allowed.stopped,
        disagreeing=disagreeing,
        disarmed=allowed.disarmed,
        liveness=allowed.liveness,
        motions=tuple(inputs.motions.values()),
        figures=step_figures(plan.figures, state.figures, new) if state.figures else (),
        is_mounting_unconfirmed=is_unconfirmed,
    )
    return remembered, decision


class _Permission(NamedTuple):
    """Permission of outputs to act: what safety demands, though people stop and arm and the picture may not be live."""

    safety: SafetyState
    stopped: str
    disarmed: str
    liveness: LivenessState
    answers: tuple[OperatorAnswer, ...]
    events: tuple[Event, ...]


def _step_permission(state: State, observation: Observation, safety: SafetyState, *, is_new: bool) -> _Permission:
    """Judge who has stopped or armed the run, and whether the picture shows that the base moves."""
    commands, now_s = observation.operator_commands, observation.now_s
    stopped, told, stop_events = step_stop(state.stopped, commands, now_s)
    liveness, unlike_life = step_liveness(state.liveness, observation, _base_command(state), is_new=is_new)
    cause = _cause_to_disarm(state.plan, observation) or unlike_life
    not_disarmed = while_stopped(safety, stopped)
    disarmed, armed, arm_events = step_arming(state.disarmed, cause, commands, not_disarmed, state.plan.safety, now_s)
    demanded = while_stopped(while_disarmed(safety, disarmed), stopped)
    liveness, room_events = tell_plain_room(liveness, observation, may_act=demanded.mode is SafetyMode.ACTIVE)
    return _Permission(demanded, stopped, disarmed, liveness, told + armed, stop_events + arm_events + room_events)


def _act(
    state: State, observation: Observation, safety: SafetyState, rules: EvaluatedRules, *, is_after_gap: bool
) -> tuple[tuple[Hold, ...], tuple[OperatorAnswer, ...], tuple[OutputStep, ...]]:
    """Return the holds on outputs, the answers to those who asked for one, and what each output does."""
    plan, now_s = state.plan, observation.now_s
    step_s = 0.0 if state.now_s is None else now_s - state.now_s
    forbidden = forbidden_outputs(plan.outputs, safety, observation.output_faults)
    held = () if is_after_gap else state.holds
    asked = [each for each in observation.operator_commands if isinstance(each, HoldCommand)]
    holds, answers = step_holds(held, asked, plan.outputs, forbidden, now_s)
    # After a gap the outputs have been stopped by their leases: they start from there, not from the last command.
    before = state.outputs if step_s <= plan.safety.max_frame_age_s else tuple(map(new_output, plan.outputs))
    slew_s = min(step_s, plan.safety.max_frame_age_s)
    wanted = with_holds(rules.wanted, holds, plan.rules)
    return holds, answers, command_all(plan.outputs, before, wanted, safety, forbidden, slew_s)


def _cause_to_disarm(plan: Plan, observation: Observation) -> str:
    """Return why the run must be armed anew, in words; empty for nothing."""
    if observation.disarm_reason or plan.safety.arm == "at-start":
        return observation.disarm_reason
    bases = {output.name for output in plan.outputs if isinstance(output, BaseOutput)}
    failed = [f"{fault.output}: {fault.reason}" for fault in observation.output_faults if fault.output in bases]
    return "; ".join(failed)


def _base_command(state: State) -> TwistCommand | None:
    """Return the command of the base in the cycle before; None where its motion is not to be seen."""
    if not state.plan.safety.liveness:
        return None
    return next((step.command for step in state.outputs if isinstance(step.command, TwistCommand)), None)


class JudgedBy(NamedTuple):
    """All that the rules were judged by in one cycle: what `core.rules.scheduler.judge` takes beside the rules."""

    inputs: RuleInputs
    sample: Sample | None
    cycle: Sample
    commands: tuple[OperatorCommand, ...]


def judged_by(before: State, observation: Observation, inputs: RuleInputs, safety: SafetyState) -> JudgedBy:
    """Collect what the rules are judged by in the cycle after `before`.

    Args:
        safety: As it is after the cycle.
    """
    step_s = 0.0 if before.now_s is None else observation.now_s - before.now_s
    cycle = Sample(at_s=observation.now_s, since_s=step_s)
    return JudgedBy(inputs, _sample(before, safety), cycle, _for_rules(observation))


def _for_rules(observation: Observation) -> tuple[OperatorCommand, ...]:
    commands = [each for each in observation.operator_commands if isinstance(each, OperatorCommand)]
    return tuple([each for each in commands if not each.action.is_on_outputs])


def _rule_inputs(
    state: State, tracked: tuple[TrackState, ...], observation: Observation, safety: SafetyState, *, is_after_gap: bool
) -> RuleInputs:
    inputs = RuleInputs(
        tracks={each.track.target: each.track for each in tracked},
        now_s=observation.now_s,
        wall=observation.wall,
        before={each.track.target: each.track for each in state.tracks},
        is_after_gap=is_after_gap,
        sightings={each.track.target: each.sighting for each in tracked},
        frame_at_s=safety.frame.captured_at_s if safety.frame is not None else None,
        base=observation.base,
        commands={step.command.output: step.command for step in state.outputs},
        safety=while_stopped(while_disarmed(safety, state.disarmed), state.stopped).mode,
        undelivered_since_s=observation.undelivered_since_s,
        viewpoint=state.plan.viewpoint,
        figures={each.name: kept.value for each, kept in zip(state.plan.figures, state.figures, strict=True)},
    )
    return _with_motions(inputs, state, tracked) if state.motions else inputs


def _with_motions(inputs: RuleInputs, state: State, tracked: tuple[TrackState, ...]) -> RuleInputs:
    """Add how targets move across the line of sight, for those that some rule asks it of."""
    before = motions_for(state.rules.layout.motions) if inputs.is_after_gap else state.motions
    if state.plan.nearest:  # another member has another motion
        members = {each.track.target: each.member for each in state.tracks}
        others = {each.track.target for each in tracked if each.member != members[each.track.target]}
        fresh = [TransverseMotion(target=m.target, withins_m=m.withins_m) if m.target in others else m for m in before]
        before = tuple(fresh)
    tracks, sightings, settings = inputs.tracks, inputs.sightings, state.plan.tracking
    motions = [step_motion(m, tracks[m.target], sightings[m.target], inputs.viewpoint, settings) for m in before]
    return replace(inputs, motions={each.target: each for each in motions})


def _see(
    state: State, observation: Observation, *, is_new: bool
) -> tuple[dict[str, Measurement], frozenset[str], tuple[Event, ...]]:
    """Return the measurements, fused with range sensors; those that disagree with the camera, and events of that."""
    measured = {each.target: each for each in observation.measurements} if is_new else {}
    seen, compared = fuse(measured, state.plan.sensor_pairs)
    return seen, *step_disagreements(state.disagreeing, compared, observation.now_s)


def _step_tracks(
    state: State, seen: Mapping[str, Measurement], now_s: float, gap_s: float | None
) -> tuple[TrackState, ...]:
    tracks = state.tracks
    if gap_s is not None:
        reason = in_words(gap_s, state.plan.safety)
        tracks = tuple([after_gap(tracked, now_s, reason) for tracked in tracks])
    nearest = state.plan.nearest
    measured = tracks[: len(tracks) - len(nearest)]
    stepped = tuple([step_track(each, seen.get(each.track.target), now_s, state.plan.tracking) for each in measured])
    if not nearest:
        return stepped
    before = tracks[len(measured) :]
    return stepped + tuple([step_nearest(*each, stepped, now_s) for each in zip(nearest, before, strict=True)])


def _sample(state: State, safety: SafetyState) -> Sample | None:
    """Return the frame that is new in this cycle, if there is one."""
    before, frame = state.safety.frame, safety.frame
    if frame is None or frame is before:
        return None
    return Sample(at_s=frame.captured_at_s, since_s=frame.captured_at_s - before.captured_at_s if before else 0.0)


def _track_events(state: State, after: tuple[TrackState, ...], now_s: float, gap: str) -> tuple[Event, ...]:
    events: list[Event] = []
    measured = len(after) - len(state.plan.nearest)  # what happens to the nearest has happened to a member
    for before_state, after_state in zip(state.tracks[:measured], after, strict=False):
        before, track = before_state.track, after_state.track
        if before.status is track.status:
            continue
        if not before.is_valid and track.is_valid:
            kind, reason = EventKind.TARGET_SEEN, f"was {before.status.value}"
        elif before.is_valid and track.status is TrackStatus.LOST:
            kind, reason = EventKind.TARGET_LOST, gap or track.reason
        else:
            continue
        events.append(
            Event(
                kind=kind,
                source=track.target,
                at_s=now_s,
                severity=Severity.INFO,
                reason=reason,
                distance_m=track.distance_m,
                sigma_m=track.sigma_m,
            )
        )
    return tuple(events)


def _camera_events(before: SafetyState, after: SafetyState, now_s: float) -> tuple[Event, ...]:
    if before.mode is SafetyMode.ACTIVE and after.mode is SafetyMode.STALE:
        return (_fault_event(EventKind.FAULT, "camera", now_s, after.reason),)
    if before.mode is SafetyMode.STALE and after.mode is SafetyMode.ACTIVE:
        return (_fault_event(EventKind.FAULT_CLEARED, "camera", now_s, "fresh frames again"),)
    return ()


def _fault_events(before: tuple[OutputFault, ...], observation: Observation) -> tuple[Event, ...]:
    """Report each fault, each change of its reason (such as that it will soon act again), and its end."""
    if not before and not observation.faults:
        return ()
    was = {fault.output: fault.reason for fault in before}
    now = {fault.output: fault.reason for fault in observation.faults}
    at_s = observation.now_s
    begun = [
        _fault_event(EventKind.FAULT, name, at_s, reason) for name, reason in now.items() if was.get(name) != reason
    ]
    ended = [
        _fault_event(EventKind.FAULT_CLEARED, fault.output, at_s, "it works again")
        for fault in before
        if fault.output not in now
    ]
    return tuple(begun + ended)


def _fault_event(kind: EventKind, source: str, at_s: float, reason: str) -> Event:
    graver = Severity.WARNING if source == SECOND_CAMERA else Severity.SAFETY
    severity = graver if kind is EventKind.FAULT else Severity.INFO
    return Event(kind=kind, source=source, at_s=at_s, severity=severity, reason=reason)


def _number(events: tuple[Event, ...], first: int) -> tuple[Event, ...]:
    if not events:
        return events
    return tuple(replace(event, sequence=first + index) for index, event in enumerate(events))
