"""The decision: from what is known to what is done, in five steps.

track → rules → safety → arbitrate → limit. `decide` is a function of its arguments: the same state and observation give
the same decision to the last bit, which is what makes a recorded run a test.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from stadimeter.core import outputs
from stadimeter.core.command import Command
from stadimeter.core.decision import Decision, Event, EventKind, RuleTrace, SafetyMode, Severity
from stadimeter.core.observation import Observation, OutputFault
from stadimeter.core.plan import AlarmRule, AnyRule, BaseOutput, FollowRule, Plan, RampRule
from stadimeter.core.rules.alarm import AlarmState, step_alarm
from stadimeter.core.rules.arbitration import arbitrate
from stadimeter.core.rules.follow import step_follow
from stadimeter.core.rules.ramp import RampState, step_ramp
from stadimeter.core.rules.request import Request
from stadimeter.core.safety import SafetyState, step_safety
from stadimeter.core.track import Track, TrackStatus
from stadimeter.core.tracking.life_cycle import TrackState, new_track
from stadimeter.core.tracking.life_cycle import step as step_track

RuleState = AlarmState | RampState | None


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """All that is remembered from one cycle to the next.

    Attributes:
        plan: What the configuration declares.
        now_s: The time of the last cycle; None before the first.
        tracks: One for each target of the plan.
        rules: What each rule of the plan remembers.
        safety: What safety remembers.
        commands: The last command for each output of the plan.
        faults: The outputs that were out of order in the last cycle.
        events: How many events there were in the run.
    """

    plan: Plan
    now_s: float | None = None
    tracks: tuple[TrackState, ...] = ()
    rules: tuple[RuleState, ...] = ()
    safety: SafetyState = field(default_factory=SafetyState)
    commands: tuple[Command, ...] = ()
    faults: tuple[OutputFault, ...] = ()
    events: int = 0


def initial_state(plan: Plan) -> State:
    """Return the state at the start of a run: nothing seen, every output at its safe value.

    Args:
        plan: What the configuration declares.

    Returns:
        The state.
    """
    return State(
        plan=plan,
        tracks=tuple(new_track(target) for target in plan.targets),
        rules=tuple(_initial_rule_state(rule) for rule in plan.rules),
        commands=tuple(outputs.safe_command(output) for output in plan.outputs),
    )


def decide(state: State, observation: Observation) -> tuple[State, Decision]:
    """Decide what to do in one cycle.

    Args:
        state: What is remembered.
        observation: All that is known in this cycle.

    Returns:
        What to remember, and what to do: one command for each output, the events, and the reasons.
    """
    plan = state.plan
    safety = step_safety(state.safety, observation, plan.safety)
    is_new = safety.frame is not state.safety.frame
    track_states = _step_tracks(state, observation, is_new=is_new)
    tracks = {tracked.track.target: tracked.track for tracked in track_states}
    sample_at_s = safety.frame.captured_at_s if is_new and safety.frame else None
    rule_states, requests, traces, rule_events = _step_rules(state, tracks, sample_at_s, observation.now_s)
    step_s = 0.0 if state.now_s is None else observation.now_s - state.now_s
    commands, output_traces = outputs.command_all(
        plan.outputs, state.commands, arbitrate(requests), safety, observation.output_faults, step_s
    )
    events = _numbered(
        _track_events(state, track_states, observation.now_s)
        + rule_events
        + _camera_events(state.safety, safety, observation.now_s)
        + _fault_events(state.faults, observation),
        state.events,
    )
    winners = {trace.winner for trace in output_traces}
    decision = Decision(
        commands=commands,
        events=events,
        tracks=tuple(tracks.values()),
        safety=safety.mode,
        safety_reason=safety.reason,
        rules=tuple(replace(trace, wins=True) if trace.rule in winners else trace for trace in traces),
        outputs=output_traces,
    )
    remembered = State(
        plan=plan,
        now_s=observation.now_s,
        tracks=track_states,
        rules=rule_states,
        safety=safety,
        commands=commands,
        faults=observation.output_faults,
        events=state.events + len(events),
    )
    return remembered, decision


def _initial_rule_state(rule: AnyRule) -> RuleState:
    if isinstance(rule, AlarmRule):
        return AlarmState()
    return RampState() if isinstance(rule, RampRule) else None


def _step_tracks(state: State, observation: Observation, *, is_new: bool) -> tuple[TrackState, ...]:
    seen = {measured.target: measured for measured in observation.measurements} if is_new else {}
    return tuple(
        step_track(tracked, seen.get(tracked.track.target), observation.now_s, state.plan.tracking)
        for tracked in state.tracks
    )


def _step_rules(
    state: State, tracks: dict[str, Track], sample_at_s: float | None, now_s: float
) -> tuple[tuple[RuleState, ...], list[Request], list[RuleTrace], tuple[Event, ...]]:
    bases = {output.name for output in state.plan.outputs if isinstance(output, BaseOutput)}
    states: list[RuleState] = []
    requests: list[Request] = []
    traces: list[RuleTrace] = []
    events: tuple[Event, ...] = ()
    for rule, remembered in zip(state.plan.rules, state.rules, strict=True):
        after: RuleState = None
        request: Request | None
        if isinstance(rule, AlarmRule) and isinstance(remembered, AlarmState):
            is_base = rule.output in bases
            alarm = step_alarm(rule, remembered, tracks[rule.target], sample_at_s, now_s, is_base=is_base)
            after, request, trace = alarm.state, alarm.request, alarm.trace
            events += alarm.events
        elif isinstance(rule, RampRule) and isinstance(remembered, RampState):
            after, request, trace = step_ramp(rule, remembered, tracks[rule.target])
        elif isinstance(rule, FollowRule):
            request, trace = step_follow(rule, tracks[rule.target])
        else:
            raise TypeError(f"rule {rule.name} remembers a {type(remembered).__name__}")
        states.append(after)
        traces.append(trace)
        if request is not None:
            requests.append(request)
    return tuple(states), requests, traces, events


def _track_events(state: State, after: tuple[TrackState, ...], now_s: float) -> tuple[Event, ...]:
    events: list[Event] = []
    for before_state, after_state in zip(state.tracks, after, strict=True):
        before, track = before_state.track, after_state.track
        if not before.is_valid and track.is_valid:
            kind, reason = EventKind.TARGET_SEEN, f"was {before.status.value}"
        elif before.is_valid and track.status is TrackStatus.LOST:
            kind, reason = EventKind.TARGET_LOST, track.reason
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
    was = {fault.output for fault in before}
    now = {fault.output: fault.reason for fault in observation.output_faults}
    at_s = observation.now_s
    begun = [_fault_event(EventKind.FAULT, name, at_s, reason) for name, reason in now.items() if name not in was]
    ended = [
        _fault_event(EventKind.FAULT_CLEARED, fault.output, at_s, "it answers again")
        for fault in before
        if fault.output not in now
    ]
    return tuple(begun + ended)


def _fault_event(kind: EventKind, source: str, at_s: float, reason: str) -> Event:
    severity = Severity.SAFETY if kind is EventKind.FAULT else Severity.INFO
    return Event(kind=kind, source=source, at_s=at_s, severity=severity, reason=reason)


def _numbered(events: tuple[Event, ...], first: int) -> tuple[Event, ...]:
    return tuple(replace(event, sequence=first + index) for index, event in enumerate(events))
