"""How an alarm takes in one sample: timers run, and it is raised or cleared when they are over.

Timers run on the capture times of the frames that were judged, so a recording gives the same alarms. A frame to the
contrary sets a timer back by its own time instead of to zero: under noise a timer that restarts may never end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from stadimeter.core.alarms.standing import begin, end
from stadimeter.core.alarms.state import NO_TIMERS, AlarmState, Timers
from stadimeter.core.alarms.table import LATCHED, Phase, Trigger
from stadimeter.core.alarms.turn import AlarmTurn
from stadimeter.core.alarms.words import in_words


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """What is judged in a cycle.

    Attributes:
        at_s: The capture time of the frame that is new; for the presence of a target, the time of the cycle.
        since_s: How long after the frame before, or the cycle before, that is; 0 for the first.
    """

    at_s: float
    since_s: float


HOLDING = frozenset({Phase.UNACKNOWLEDGED, Phase.ACTIVE})


def is_settled(state: AlarmState, holds: bool, leaves: tuple[bool, ...]) -> bool:
    """Return whether a sample changes nothing: it is like the one before, and no timer runs.

    Args:
        state: What the alarm remembers.
        holds: Whether its condition holds in this sample.
        leaves: Whether each part of it does.

    Returns:
        Whether nothing changes.
    """
    timers = state.timers
    if state.resumed is not None or not timers.was_judged or holds is not timers.held_last or leaves != timers.leaves:
        return False
    if holds:
        return state.phase in HOLDING and timers.ended_s == 0.0
    if state.phase in LATCHED:
        return True
    return not state.is_active and timers.held_s == 0.0 and True not in timers.recent


def has_timers(timers: Timers) -> bool:
    """Return whether anything has been counted.

    Args:
        timers: The timers.

    Returns:
        Whether any of them is not at its beginning.
    """
    return bool(timers.held_s or timers.ended_s or timers.recent or timers.held_last)


def begun_anew(state: AlarmState) -> AlarmState:
    """Return an alarm whose timers begin anew, after time that nobody observed.

    Neither an on-delay nor an off-delay may be satisfied by time in which the program stood still.
    """
    timers = Timers(held_last=state.timers.held_last, leaves=state.timers.leaves)
    resumed = None if state.resumed is None else replace(state.resumed, from_s=math.inf)
    if timers == state.timers and resumed == state.resumed:
        return state
    return replace(state, timers=timers, resumed=resumed)


def judge_sample(turn: AlarmTurn, sample: Sample, holds: bool, leaves: tuple[bool, ...]) -> None:
    """Take in one sample for which the condition is known.

    Args:
        turn: The alarm.
        sample: The sample.
        holds: Whether its condition holds in it.
        leaves: Whether each part of it does.
    """
    state, timers = turn.state, turn.state.timers
    since_s = _since_s(turn, sample, holds)
    if state.held_from_start and not holds:
        turn.change(held_from_start=False)
    if state.phase in LATCHED:
        turn.change(timers=Timers(held_last=holds, was_judged=True, leaves=leaves))
        if holds:
            turn.trigger(Trigger.HOLDS)
    elif state.is_active:
        ended_s = max(0.0, timers.ended_s - since_s) if holds else timers.ended_s + since_s
        turn.change(timers=Timers(ended_s=ended_s, held_last=holds, was_judged=True, leaves=leaves))
        turn.trigger(Trigger.HOLDS if holds else Trigger.ENDED)
        if not holds and ended_s >= turn.rule.off_delay_s:
            clear_alarm(turn, sample.at_s)
    else:
        _wait(turn, sample.at_s, since_s, holds, leaves)


def _since_s(turn: AlarmTurn, sample: Sample, holds: bool) -> float:
    """Return for how long the condition has been as it is: since the sample before, or since an earlier run."""
    timers, resumed = turn.state.timers, turn.state.resumed
    if resumed is None:
        return sample.since_s if timers.was_judged else 0.0
    turn.change(resumed=None)
    # What held before and holds now is taken to have held in between.
    return max(0.0, sample.at_s - resumed.from_s) if holds is timers.held_last else 0.0


def _wait(turn: AlarmTurn, at_s: float, since_s: float, holds: bool, leaves: tuple[bool, ...]) -> None:
    """Count towards being raised.

    A frame whose measurement was refused as an outlier contradicts the track that the condition is judged by. It counts
    neither for the condition nor against it.
    """
    if turn.known.tracks[turn.rule.target].rejected:
        return
    timers, delay = turn.state.timers, turn.rule.on_delay
    held_s = timers.held_s + since_s * timers.held_last if holds else max(0.0, timers.held_s - since_s)
    recent = (*timers.recent, holds)[-delay.of_frames :] if delay.of_frames else ()
    turn.change(timers=Timers(held_s=held_s, recent=recent, held_last=holds, was_judged=True, leaves=leaves))
    turn.trigger(Trigger.HOLDS if holds else Trigger.ENDED)
    if holds and held_s >= delay.hold_s and sum(recent) >= delay.frames:
        raise_alarm(turn, at_s)


def raise_alarm(turn: AlarmTurn, at_s: float, reason: str = "") -> None:
    """Raise an alarm.

    Args:
        turn: The alarm.
        at_s: When the frame was taken that raises it.
        reason: Why; empty for the figures of its condition.
    """
    state = turn.state
    reason = reason or in_words(turn.rule, replace(state, phase=Phase.INACTIVE), turn.known)
    if state.held_from_start:
        reason = f"so from the start: {reason}"
    turn.trigger(Trigger.RAISE if turn.rule.needs_ack else Trigger.RAISE_ACKNOWLEDGED)
    timers = replace(NO_TIMERS, held_last=state.timers.held_last, was_judged=state.timers.was_judged)
    turn.change(
        timers=replace(timers, leaves=state.timers.leaves),
        is_announced_only=state.held_from_start and not turn.rule.act_at_start,
    )
    begin(turn, at_s, reason)


def clear_alarm(turn: AlarmTurn, at_s: float, reason: str = "") -> None:
    """Clear an alarm whose condition has ended for good, or latch it.

    Args:
        turn: The alarm.
        at_s: When the frame was taken that clears it.
        reason: Why; empty for the figures of its condition.
    """
    reason = reason or in_words(turn.rule, turn.state, turn.known)
    timers = turn.state.timers
    turn.change(timers=Timers(held_last=False, was_judged=timers.was_judged, leaves=timers.leaves))
    if turn.rule.latch:
        turn.trigger(Trigger.LATCH)
        return
    turn.trigger(Trigger.CLEAR)
    end(turn, at_s, reason)
