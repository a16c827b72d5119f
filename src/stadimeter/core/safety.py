"""The decision whether outputs may act. Everything that affects it is in this file.

================  =====================================  ==========
mode              what happens                           next mode
================  =====================================  ==========
any               the newest frame is older than limit   stale (starting, before the first good frames)
any               its camera says that it may be old     stale (starting, before the first good frames)
active            a cycle after a gap                    stale
starting, stale   enough fresh frames in a row           active
active            a fresh frame                          active
================  =====================================  ==========

Over this lie two switches. While the run is disarmed, the mode is disarmed; while a person has stopped the outputs,
the mode is stopped; whatever it would be otherwise. Stopped is shown before disarmed.

=========  =============================================================================  ==========
switch     what happens                                                                   next
=========  =============================================================================  ==========
--         a run begins with ``arm = "at-start"``                                         armed
--         a run begins with ``arm = "by-command"`` or ``"by-button"``                    disarmed
armed      an operator or a button disarms                                                disarmed
armed      `Observation.disarm_reason`, with any ``arm``                                  disarmed
armed      the driver of a base fails, with ``arm = "by-command"`` or ``"by-button"``     disarmed
disarmed   a person arms it: in mode active, not stopped, no reason to disarm, and with    armed
           ``arm = "by-button"`` by a button; else it is refused
any        a person stops the outputs / releases them                                     stopped / not
=========  =============================================================================  ==========

In every mode but active, every output is kept at its safe value, whatever the rules ask for. An output whose driver
failed is kept at its safe value in every mode. This is not a certified safety function: below it must be a base with a
timeout of its own, a pull-down on each gate, and a switch in the motor supply.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.conditions.compounds import depends_on
from stadimeter.core.decision import Event, EventKind, SafetyMode, Severity
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import BaseOutput, Plan, Safety
from stadimeter.core.rule import ROUNDING_S, AlarmRule, AnyRule, RampRule, conditions_of, gate_of
from stadimeter.operator_actions import AnyCommand, OperatorAction, OperatorAnswer, OperatorCommand

# Orders that could let an output act that would not act without them: what a sender needs to be trusted for -----------

# They end what a rule does, and begin nothing.
_QUIETING = frozenset(
    {OperatorAction.ACKNOWLEDGE, OperatorAction.SHELVE, OperatorAction.TAKE_OUT, OperatorAction.OBSERVE}
)


def could_let_act(plan: Plan, action: OperatorAction, rule: str = "") -> tuple[str, ...]:
    """Return for which rules an order could let an output act; empty if it could not.

    An order may do so to a rule that drives an output, or on which such a rule depends: by beginning what the rule
    does, by ending what kept another from acting, or by letting a pattern begin anew. Only one that quiets a rule
    which alone drives its actuators, at a level that depends on nothing else, does not.

    Args:
        rule: The rule that the order is for; empty for every rule.
    """
    if action.is_on_outputs:
        return ("every output",) if action.lets_outputs_act else ()
    moving = _moving_rules(plan)
    chosen = (moving[each.name] for each in plan.rules if rule in {"", each.name} and each.name in moving)
    return tuple(each.name for each in chosen if not (action in _QUIETING and _is_quieted(plan, moving, each)))


def _moving_rules(plan: Plan) -> dict[str, AnyRule]:
    """Return the rules that drive an output, and those that they depend on, by name."""
    by_name = {rule.name: rule for rule in plan.rules}
    waiting = [rule for rule in plan.rules if _outputs(rule)]
    found: dict[str, AnyRule] = {}
    while waiting:
        rule = waiting.pop()
        if rule.name not in found:
            found[rule.name] = rule
            waiting += [by_name[name] for name in _asked_for(rule) if name in by_name]
    return found


def _is_quieted(plan: Plan, moving: dict[str, AnyRule], rule: AnyRule) -> bool:
    """Check whether to quiet a rule lets nothing act: it alone drives its actuators, and steadily."""
    others = [each for each in moving.values() if each.name != rule.name]
    moved = {each.name for each in plan.outputs if isinstance(each, BaseOutput)}.union(*map(_outputs, others))
    is_alone = moved.isdisjoint(_outputs(rule)) and not any(rule.name in _asked_for(each) for each in others)
    return is_alone and _is_steady(rule)


def _outputs(rule: AnyRule) -> set[str]:
    return {name for name in (rule.output, *(step.output for step in gate_of(rule).escalation)) if name is not None}


def _asked_for(rule: AnyRule) -> frozenset[str]:
    return frozenset().union(*map(depends_on, conditions_of(rule)))


def _is_steady(rule: AnyRule) -> bool:
    """Check whether what it drives goes by its condition alone, and not by when and how it was raised or cleared."""
    if any(step.output is not None for step in gate_of(rule).escalation):
        return False
    if isinstance(rule, RampRule):  # a level that is kept within a dead zone may be higher when it begins again
        return rule.dead_zone == 0.0
    return not isinstance(rule, AlarmRule) or (rule.pattern is None and rule.at_start == "act")


# A frame may seem to be this much younger than now: clocks are read one after the other. More is a broken stamp.
FROM_THE_FUTURE_S = 0.05

# Stands in events for all of them.
OUTPUTS = "outputs"

# A step this many times as long as usual is a gap; steps that are always long are a slow computer or camera.
SLOW_CYCLES = 2.0


class SafetyState(Struct, frozen=True, kw_only=True):
    """The state that safety remembers.

    Attributes:
        good_frames: How many fresh frames came in a row.
        reason: Why outputs may not act; empty if they may.
    """

    mode: SafetyMode = SafetyMode.STARTING
    good_frames: int = 0
    frame: FrameStamp | None = None
    reason: str = "no frame yet"


def is_gap(step_s: float, usual_s: float, settings: Safety) -> bool:
    """Check whether the program stood still between two cycles, so that it cannot know what happened meanwhile.

    A process that was stopped, a computer that slept or a call that hung leaves no other trace: the next frame is
    fresh, and the last one before it looks like its neighbour. Whatever goes on over such a gap (a drive, a track, a
    timer) would go on by guesswork.

    Args:
        step_s: From the cycle before to this one.
        usual_s: What `usual_step_s` returned for the cycle before; 0 before the second.
    """
    is_long = step_s > settings.max_frame_age_s + ROUNDING_S
    return is_long and 0 < SLOW_CYCLES * usual_s < step_s


def usual_step_s(step_s: float, usual_s: float) -> float:
    """Return the step that counts as usual from here on: the newest one, but it grows no faster than it may.

    So pauses one after the other are all gaps, and a computer that has become slow is known after a few cycles.
    """
    return min(step_s, SLOW_CYCLES * usual_s) if usual_s else step_s


def step_safety(
    state: SafetyState, observation: Observation, settings: Safety, *, gap_s: float | None = None
) -> SafetyState:
    """Judge one cycle.

    Args:
        gap_s: For how long the program stood still before this cycle; None for not at all.
    """
    frame = _newest(state.frame, observation.frame, observation.now_s)
    is_new = frame is not state.frame
    fault = _fault(frame, observation, settings)
    if fault:
        mode = SafetyMode.STARTING if state.mode is SafetyMode.STARTING else SafetyMode.STALE
        return SafetyState(mode=mode, good_frames=0, frame=frame, reason=fault)
    good_frames = min(settings.good_frames, (state.good_frames if gap_s is None else 0) + is_new)
    if good_frames >= settings.good_frames or (state.mode is SafetyMode.ACTIVE and gap_s is None):
        return SafetyState(mode=SafetyMode.ACTIVE, good_frames=good_frames, frame=frame, reason="")
    reason = f"{good_frames} of {settings.good_frames} fresh frames in a row"
    if gap_s is not None:
        reason = f"{in_words(gap_s, settings)}; {reason}"
    mode = SafetyMode.STALE if state.mode is SafetyMode.ACTIVE else state.mode
    return SafetyState(mode=mode, good_frames=good_frames, frame=frame, reason=reason)


def while_stopped(state: SafetyState, stopped: str) -> SafetyState:
    """Return the demands of safety now, though a person may have stopped every output.

    Args:
        stopped: Who has, and why, in words; empty if no one has.
    """
    if not stopped:
        return state
    reason = f"stopped until released, {stopped}"
    return replace(state, mode=SafetyMode.STOPPED, reason=f"{reason}; {state.reason}" if state.reason else reason)


def in_words(gap_s: float, settings: Safety) -> str:
    """Describe a gap in words."""
    limit = f"limit {1e3 * settings.max_frame_age_s:.0f} ms (safety.max_frame_age)"
    return f"the program stood still for {gap_s:.2f} s, {limit}"


def _newest(before: FrameStamp | None, new: FrameStamp | None, now_s: float) -> FrameStamp | None:
    """Return the newest frame that has a sound stamp.

    A frame is new only if its capture time moved on: a stuck driver repeats the old one. A stamp from the future, or
    one that is no number, is not believed: it would make every later frame look old.
    """
    if new is None or not new.captured_at_s <= now_s + FROM_THE_FUTURE_S:
        return before
    if before is not None and not new.captured_at_s > before.captured_at_s:
        return before
    return new


def _fault(frame: FrameStamp | None, observation: Observation, settings: Safety) -> str:
    """Return why the newest frame may not be acted on, or an empty string."""
    if frame is None:
        return observation.camera_fault or "no frame yet"
    if observation.not_for_motion:
        return observation.not_for_motion
    age_s = observation.now_s - frame.captured_at_s
    if age_s <= settings.max_frame_age_s + ROUNDING_S:
        return ""
    words = f"the newest frame is {age_s * 1000:.0f} ms old, limit {settings.max_frame_age_s * 1000:.0f} ms"
    return f"{words}: {observation.camera_fault}" if observation.camera_fault else words


_STOPPING = frozenset({OperatorAction.STOP_OUTPUTS, OperatorAction.RELEASE_OUTPUTS})
_ARMING = frozenset({OperatorAction.ARM, OperatorAction.DISARM})


def _about(commands: Sequence[AnyCommand], actions: frozenset[OperatorAction]) -> Iterator[OperatorCommand]:
    return (each for each in commands if isinstance(each, OperatorCommand) and each.action in actions)


# Stop everything: a person puts every output at its safe value, until it is released. It stands before all rules, those
# of ``severity = "safety"`` too, and ends every hold. The rules go on beneath: alarms are raised, recorded, announced.
# However often it was stopped, one release ends it.


def step_stop(
    stopped: str, commands: Sequence[AnyCommand], now_s: float
) -> tuple[str, tuple[OperatorAnswer, ...], tuple[Event, ...]]:
    """Say who has stopped every output by now, with the answers to those who want it or end it, and what happened.

    Args:
        stopped: Who has done it before, and why, in words; empty while no one has.
    """
    answers: list[OperatorAnswer] = []
    events: list[Event] = []
    for command in _about(commands, _STOPPING):
        is_stop = command.action is OperatorAction.STOP_OUTPUTS
        answers.append(OperatorAnswer(id=command.id, accepted=True, words=_stop_words(stopped, is_stop=is_stop)))
        if is_stop is not bool(stopped):
            stopped = command.said if is_stop else ""
            events.append(_stop_event(command, now_s, is_stop=is_stop))
    return stopped, tuple(answers), tuple(events)


def _stop_words(stopped: str, *, is_stop: bool) -> str:
    """Say what comes of a command, given who had stopped them before it."""
    if is_stop:
        return f"the outputs were stopped already, {stopped}" if stopped else "the outputs are stopped until released"
    return f"the outputs are released; they were stopped {stopped}" if stopped else "the outputs were not stopped"


def _stop_event(command: OperatorCommand, now_s: float, *, is_stop: bool) -> Event:
    return Event(
        kind=EventKind.STOPPED if is_stop else EventKind.RELEASED,
        source=OUTPUTS,
        at_s=now_s,
        severity=Severity.SAFETY if is_stop else Severity.INFO,
        reason=command.said,
        by=command.by,
    )


# Arming: what drives about begins at rest, and stays so until a person who sees it says that it may move. A run that
# lost its trust in the camera or the base must be told so again; frames that are late, and come again, disarm nothing.

AT_START = "since the start"


def while_disarmed(state: SafetyState, disarmed: str) -> SafetyState:
    """Return the demands of safety now, though the run may be disarmed.

    Args:
        disarmed: Since when or by what it is, in words; empty while it is armed.
    """
    if not disarmed:
        return state
    reason = f"disarmed {disarmed}"
    return replace(state, mode=SafetyMode.DISARMED, reason=f"{reason}; {state.reason}" if state.reason else reason)


def step_arming(
    disarmed: str, cause: str, commands: Sequence[AnyCommand], safety: SafetyState, settings: Safety, now_s: float
) -> tuple[str, tuple[OperatorAnswer, ...], tuple[Event, ...]]:
    """Return by what the run is disarmed by now, the answers to those who arm or disarm it, and what happened.

    Args:
        disarmed: By what it was before, in words; empty while it was armed.
        cause: Why it must be disarmed now, in words; empty for nothing.
        safety: What safety demands in this cycle, a stop by a person included.
    """
    answers: list[OperatorAnswer] = []
    events: list[Event] = []
    for command in _about(commands, _ARMING):
        is_arming = command.action is OperatorAction.ARM
        refusal = _refuse_arming(command, cause, safety, settings) if is_arming and disarmed else ""
        words = refusal or ("armed" if is_arming else "disarmed: every output is at its safe value until it is armed")
        answers.append(OperatorAnswer(id=command.id, accepted=not refusal, words=words))
        if refusal:
            events.append(_arming_event(EventKind.REFUSED, now_s, refusal, command.by))
        elif is_arming is bool(disarmed):
            disarmed = "" if is_arming else command.said
            events.append(
                _arming_event(EventKind.ARMED if is_arming else EventKind.DISARMED, now_s, command.said, command.by)
            )
    if cause and not disarmed:
        disarmed = f"since {cause}"
        events.append(_arming_event(EventKind.DISARMED, now_s, cause))
    return disarmed, tuple(answers), tuple(events)


def _refuse_arming(command: OperatorCommand, cause: str, safety: SafetyState, settings: Safety) -> str:
    """Return why the run may not be armed now, or an empty string."""
    if settings.arm == "by-button" and not command.is_from_button:
        return 'not armed: a push button must do it (safety.arm = "by-button"), beside what will move'
    if cause:
        return f"not armed: {cause}"
    return "" if safety.mode is SafetyMode.ACTIVE else f"not armed: {safety.reason}"


def _arming_event(kind: EventKind, now_s: float, reason: str, by: str = "") -> Event:
    severity = {EventKind.DISARMED: Severity.SAFETY, EventKind.REFUSED: Severity.WARNING}.get(kind, Severity.INFO)
    return Event(kind=kind, source=OUTPUTS, at_s=now_s, severity=severity, reason=reason, by=by)
