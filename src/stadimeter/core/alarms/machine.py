"""The state machine of an alarm: its states, what triggers a change, and every transition. Nothing else sets a state.

::

    normal ──holds──▶ pending ──on-delay──▶ raised ──ends──▶ clearing ──off-delay──▶ normal
                                            ▲   ▲                │ │
                                            │   └──holds again───┘ ├──▶ latched, until it is reset
                                            └─────── on-delay ─────┴──▶ RTN-unack, until it is acknowledged

States as in ISA-18.2 and OPC 10000-9, 5.8. A raised, clearing or latched alarm is unacknowledged or acknowledged; one
that needs no acknowledgement is acknowledged at once. Pending and clearing are the on-delay and the off-delay.

All depends on rule, state and time alone. Each function changes the `AlarmRecord` that it is given: the copy of one
evaluation (`AlarmRecord.copy`). That of an earlier cycle is never changed. Inhibits (shelved, suppressed, out of
service) are beside the machine, so an alarm is in the right state when they end. With `ack_resets` an acknowledgement
is a reset as well.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from copy import copy
from enum import StrEnum
from typing import Any, NamedTuple

from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.core.alarms.state import (
    MINUTE_S,
    NO_INHIBITS,
    Acknowledgement,
    Inhibits,
    Leg,
    Resumed,
    Sample,
    SetThreshold,
    Timers,
    count_sample,
    is_too_frequent,
    with_raise,
)
from stadimeter.core.bounds import MIN_QUANTITY
from stadimeter.core.conditions.compounds import leaves, named_leaves, with_leaves
from stadimeter.core.conditions.leaf import Leaf, Threshold
from stadimeter.core.decision import Severity
from stadimeter.core.rule import ROUNDING_S, AlarmRule, LostPolicy
from stadimeter.core.words import figure_in_words, rounded_duration

# The settings of a rule that an operator may change while it runs: its thresholds, and whether it is observed only.
#
# A rule is judged as it is set. What was set is in the alarm's record, with what the configuration says in place of
# it. Values are bounded as those of a configuration are: by the quantity, by the other end of an interval, by the
# deadband.


class RuleThreshold(NamedTuple):
    """A threshold of a rule as it is now."""

    leaf: int
    """Which of the simple parts of its condition has it, from left to right."""
    place: Threshold
    unit: str
    value: float

    def takes(self, value: float) -> bool:
        """Check whether it may have a value; not NaN."""
        is_zero_or_quantity = value == 0 or abs(value) >= MIN_QUANTITY
        return is_zero_or_quantity and self.place.low <= value <= self.place.high

    @property
    def range_in_words(self) -> str:
        """The range it takes, in its SI unit."""
        return f"{self.place.low:.6g} to {self.place.high:.6g} {self.unit}"


class ThresholdSetting(Struct, frozen=True, kw_only=True):
    """A threshold of a rule as others see it, in the SI unit.

    Attributes:
        configured: What the configuration says.
        min: The least value that it takes now.
        set_by: Who has set it; None for no one.
    """

    value: float
    configured: float
    unit: str
    min: float
    max: float
    set_by: str | None


def thresholds_of(rule: AlarmRule) -> dict[str, RuleThreshold]:
    """Return the thresholds of a rule that can be moved, by their names.

    A name follows the keys of `when`, such as ``below`` or ``closing_speed.above``. If several parts have the same, it
    begins with where the part stands: ``any.0.below``.
    """
    parts = list(named_leaves(rule.condition))
    times = Counter(place.key for _, leaf in parts for place in leaf.thresholds)
    return {
        (place.key if times[place.key] == 1 else within + place.key): RuleThreshold(
            number, place, leaf.unit, getattr(leaf, place.field)
        )
        for number, (within, leaf) in enumerate(parts)
        for place in leaf.thresholds
    }


def move(rule: AlarmRule, values: Mapping[str, float]) -> AlarmRule:
    """Return a rule with other thresholds, by their names; a name that it does not have is passed over."""
    found, parts = thresholds_of(rule), list[Any](leaves(rule.condition))
    for key in values.keys() & found.keys():
        parts[found[key].leaf] = replace(parts[found[key].leaf], **{found[key].place.field: values[key]})
    moved: list[Leaf] = parts
    return replace(rule, condition=with_leaves(rule.condition, iter(moved)))


def as_set(rule: AlarmRule, record: AlarmRecord) -> AlarmRule:
    """Return a rule as it is judged: that of the configuration, with what an operator has set."""
    if record.inhibits.is_observed:
        rule = replace(rule, observe=True)
    return move(rule, {each.key: each.value for each in record.thresholds}) if record.thresholds else rule


def keep_thresholds(
    rule: AlarmRule, found: tuple[SetThreshold, ...]
) -> tuple[tuple[SetThreshold, ...], tuple[SetThreshold, ...]]:
    """Return which thresholds stay set for a rule of the configuration, and which do not.

    One stays while the configuration says the same in place of it, and takes it.
    """
    known = thresholds_of(rule) if rule.severity is not Severity.SAFETY else {}
    kept = tuple(each for each in found if each.key in known and known[each.key].value == each.configured)
    now = thresholds_of(move(rule, {each.key: each.value for each in kept})) if kept else {}
    if not all(now[each.key].takes(each.value) for each in kept):
        kept = ()
    return kept, tuple(each for each in found if each not in kept)


def show_thresholds(rule: AlarmRule, record: AlarmRecord) -> dict[str, ThresholdSetting]:
    """Return the thresholds of a rule as others see them, by their names.

    Args:
        rule: The rule as it is judged.
    """
    was_set = {each.key: each for each in record.thresholds}
    return {
        key: ThresholdSetting(
            value=found.value,
            configured=was_set[key].configured if key in was_set else found.value,
            unit=found.unit,
            min=found.place.low,
            max=found.place.high,
            set_by=(was_set[key].by or "an operator") if key in was_set else None,
        )
        for key, found in thresholds_of(rule).items()
    }


def describe_thresholds(record: AlarmRecord, now_s: float) -> tuple[str, ...]:
    """Return which thresholds are set, by whom and when, and what the configuration says; empty for none."""
    return tuple(
        f"`{each.key}` is {figure_in_words(each.value, each.unit)}, set by {each.by or 'an operator'} "
        f"{rounded_duration(now_s - each.at_s)} ago, where the configuration says "
        f"{figure_in_words(each.configured, each.unit)}"
        for each in record.thresholds
    )


class AlarmState(StrEnum):
    """The state an alarm is in."""

    NORMAL = "normal"
    PENDING = "pending"
    """Its condition holds, but not yet for the on-delay."""
    UNACKNOWLEDGED = "unacknowledged"
    ACKNOWLEDGED = "acknowledged"
    CLEARING_UNACKNOWLEDGED = "clearing_unacknowledged"
    """Active; its condition has ended, but not yet for the off-delay."""
    CLEARING = "clearing"
    LATCHED_UNACKNOWLEDGED = "latched_unacknowledged"
    """Active; its condition has ended for good. It must be acknowledged and then reset."""
    LATCHED = "latched"
    RTN_UNACKNOWLEDGED = "rtn_unacknowledged"
    """Returned to normal, no longer active, and still to be acknowledged."""


class Trigger(StrEnum):
    """The things that happen to an alarm."""

    HOLDS = "holds"
    """Its condition holds in a sample."""
    ENDS = "ends"
    """Its condition does not hold in a sample."""
    RAISE = "raise"
    """The on-delay is over, and the rule needs an acknowledgement."""
    RAISE_ACKNOWLEDGED = "raise acknowledged"
    """The on-delay is over, and the rule needs none."""
    CLEAR = "clear"
    """The off-delay is over."""
    LATCH = "latch"
    """The off-delay is over, or the target has been out of sight for long, and the rule latches."""
    ACKNOWLEDGE = "acknowledge"
    RESET = "reset"
    REALARM = "realarm"
    """It has stood for so long that it must be acknowledged again."""


# Where a trigger leads from a state. A trigger that is not there changes nothing.
_P, _T = AlarmState, Trigger
TRANSITIONS: Mapping[AlarmState, Mapping[Trigger, AlarmState]] = {
    _P.NORMAL: {_T.HOLDS: _P.PENDING, _T.RAISE: _P.UNACKNOWLEDGED, _T.RAISE_ACKNOWLEDGED: _P.ACKNOWLEDGED},
    _P.PENDING: {_T.ENDS: _P.NORMAL, _T.RAISE: _P.UNACKNOWLEDGED, _T.RAISE_ACKNOWLEDGED: _P.ACKNOWLEDGED},
    _P.UNACKNOWLEDGED: {
        _T.ENDS: _P.CLEARING_UNACKNOWLEDGED,
        _T.CLEAR: _P.RTN_UNACKNOWLEDGED,
        _T.LATCH: _P.LATCHED_UNACKNOWLEDGED,
        _T.ACKNOWLEDGE: _P.ACKNOWLEDGED,
    },
    _P.ACKNOWLEDGED: {_T.ENDS: _P.CLEARING, _T.CLEAR: _P.NORMAL, _T.LATCH: _P.LATCHED, _T.REALARM: _P.UNACKNOWLEDGED},
    _P.CLEARING_UNACKNOWLEDGED: {
        _T.HOLDS: _P.UNACKNOWLEDGED,
        _T.CLEAR: _P.RTN_UNACKNOWLEDGED,
        _T.LATCH: _P.LATCHED_UNACKNOWLEDGED,
        _T.ACKNOWLEDGE: _P.CLEARING,
    },
    _P.CLEARING: {
        _T.HOLDS: _P.ACKNOWLEDGED,
        _T.CLEAR: _P.NORMAL,
        _T.LATCH: _P.LATCHED,
        _T.REALARM: _P.CLEARING_UNACKNOWLEDGED,
    },
    _P.LATCHED_UNACKNOWLEDGED: {_T.HOLDS: _P.UNACKNOWLEDGED, _T.ACKNOWLEDGE: _P.LATCHED},
    _P.LATCHED: {_T.HOLDS: _P.ACKNOWLEDGED, _T.RESET: _P.NORMAL, _T.REALARM: _P.LATCHED_UNACKNOWLEDGED},
    _P.RTN_UNACKNOWLEDGED: {
        _T.RAISE: _P.UNACKNOWLEDGED,
        _T.RAISE_ACKNOWLEDGED: _P.ACKNOWLEDGED,
        _T.ACKNOWLEDGE: _P.NORMAL,
    },
}

# The alarm is active: it drives its output.
ACTIVE = frozenset(AlarmState) - {AlarmState.NORMAL, AlarmState.PENDING, AlarmState.RTN_UNACKNOWLEDGED}

# The alarm waits for an acknowledgement.
TO_ACKNOWLEDGE = frozenset(state for state in AlarmState if state.value.endswith("unacknowledged"))

# Only a reset ends the alarm; or its condition holds again.
LATCHED = frozenset({AlarmState.LATCHED_UNACKNOWLEDGED, AlarmState.LATCHED})

# The condition is judged by what ends it. One that latched has ended: to hold again it must begin again.
JUDGED_BY_ITS_END = ACTIVE - LATCHED

_HOLDING = frozenset({AlarmState.UNACKNOWLEDGED, AlarmState.ACKNOWLEDGED})


class AlarmRecord(Struct):
    """The memory of an alarm. Times are on the run's clock. Only the evaluation that made a copy changes it."""

    state: AlarmState = field(default=AlarmState.NORMAL, name="phase")  # so it is called in state files
    timers: Timers = field(default_factory=Timers)
    unknown_since_s: float | None = None
    """Since when there is nothing to judge by; None while there is."""
    is_given_up: bool = False
    """There has been nothing to judge by for so long that it was reported, and that the output was let go."""
    held_from_start: bool = True
    """The condition has held in every sample of the run so far."""
    is_announced_only: bool = False
    """It was raised by the first sight of the target, and must not move its output."""
    raises: int = 0
    """How often it has been raised."""
    raised_at_s: float | None = None
    reported_at_s: float | None = None
    """When it was raised or last reported again."""
    notified_at_s: float | None = None
    """When people were last notified of it."""
    owes_notice: bool = False
    """It was raised, and people could not be notified yet."""
    raises_at_s: tuple[float, ...] = ()
    """When it was raised within the last minute before the newest raise, oldest first."""
    is_chattering: bool = False
    """It came too often within a minute, and does not clear before it has calmed down."""
    leg: Leg | None = None
    acknowledgement: Acknowledgement | None = None
    inhibits: Inhibits = NO_INHIBITS
    resumed: Resumed | None = None
    thresholds: tuple[SetThreshold, ...] = ()
    """Those that an operator has set, in the order in which they were."""

    @property
    def is_active(self) -> bool:
        """True if it is raised, clearing or latched. This is the one answer to whether an alarm is active."""
        return self.state in ACTIVE

    @property
    def is_acknowledged(self) -> bool:
        """True if it was acknowledged, or need not be."""
        return self.state not in TO_ACKNOWLEDGE

    @property
    def is_judged_by_its_end(self) -> bool:
        """True if the condition is judged by what ends it."""
        return self.state in JUDGED_BY_ITS_END

    @property
    def has_let_go(self) -> bool:
        """True if the output went to its safe value, since nothing confirms the alarm. A latch needs none to."""
        return self.is_given_up and self.state not in LATCHED

    def copy(self) -> AlarmRecord:
        """Return a copy to change. This takes 0.4 µs; `dataclasses.replace` on a frozen class takes 6 µs."""
        return copy(self)


def fire(record: AlarmRecord, trigger: Trigger) -> None:
    """Take an alarm through a trigger."""
    record.state = TRANSITIONS[record.state].get(trigger, record.state)


def is_settled(record: AlarmRecord, holds: bool, leaves: tuple[bool, ...]) -> bool:
    """Check whether a sample changes nothing: it is like the one before, `leaves` included, and no timer runs."""
    timers = record.timers
    if record.resumed is not None or not timers.was_judged or holds is not timers.held_last or leaves != timers.leaves:
        return False
    if holds:
        return record.state in _HOLDING and timers.ended_s == 0.0
    if record.state in LATCHED:
        return True
    return not record.is_active and timers.held_s == 0.0 and True not in timers.recent


def take_sample(
    rule: AlarmRule, record: AlarmRecord, sample: Sample, holds: bool, leaves: tuple[bool, ...], *, now_s: float
) -> None:
    """Take in a sample for which the condition of an alarm is known.

    Timers run on the capture times of the frames that were judged, so a recording gives the same alarms.
    """
    # Time between two samples counts only if both were judged. What held before a restart and holds now has held in it.
    if record.resumed is None:
        since_s = sample.since_s if record.timers.was_judged else 0.0
    else:
        since_s = max(0.0, sample.at_s - record.resumed.from_s) if holds is record.timers.held_last else 0.0
        record.resumed = None
    record.held_from_start = record.held_from_start and holds
    if record.state in LATCHED:
        record.timers = Timers(held_last=holds, was_judged=True, leaves=leaves)
        fire(record, Trigger.HOLDS if holds else Trigger.ENDS)
    elif record.is_active:
        _while_active(rule, record, since_s, holds, leaves, now_s)
    else:
        _while_normal(rule, record, since_s, holds, leaves, now_s)


def _while_normal(
    rule: AlarmRule, record: AlarmRecord, since_s: float, holds: bool, leaves: tuple[bool, ...], now_s: float
) -> None:
    """Count towards the on-delay: in seconds, or in frames of the newest ones."""
    delay = rule.on_delay
    record.timers = timers = count_sample(rule, record.timers, since_s, holds, leaves, is_active=False)
    if holds and timers.held_s + ROUNDING_S >= delay.hold_s and sum(timers.recent) >= delay.frames:
        _raise(rule, record, now_s)
    else:
        fire(record, Trigger.HOLDS if holds else Trigger.ENDS)


def _while_active(
    rule: AlarmRule, record: AlarmRecord, since_s: float, holds: bool, leaves: tuple[bool, ...], now_s: float
) -> None:
    """Count towards the off-delay."""
    ended_s = record.timers.ended_s
    if holds and record.is_chattering and ended_s >= rule.off_delay_s and record.state not in _HOLDING:
        # Without the governor it would have cleared, and would be raised anew: that counts towards the next minute.
        record.raises_at_s = with_raise(record.raises_at_s, rule.raises_per_min_max, now_s)
        record.timers = Timers(held_last=True, was_judged=True, leaves=leaves)
        fire(record, Trigger.HOLDS)
        return
    record.timers = count_sample(rule, record.timers, since_s, holds, leaves, is_active=True)
    fire(record, Trigger.HOLDS if holds else Trigger.ENDS)
    if not holds:
        _clear_when_due(rule, record, record.timers.ended_s, now_s)


def _raise(rule: AlarmRule, record: AlarmRecord, now_s: float) -> None:
    timers = record.timers
    record.timers = Timers(held_last=timers.held_last, was_judged=timers.was_judged, leaves=timers.leaves)
    record.is_announced_only = record.held_from_start and rule.at_start == "announce"
    record.raises += 1
    record.raises_at_s = with_raise(record.raises_at_s, rule.raises_per_min_max, now_s)
    fire(record, Trigger.RAISE if rule.ack == "required" else Trigger.RAISE_ACKNOWLEDGED)


def _clear_when_due(rule: AlarmRule, record: AlarmRecord, ended_s: float, now_s: float) -> None:
    """Clear or latch an alarm whose off-delay is over, unless it chatters."""
    if ended_s + ROUNDING_S < rule.off_delay_s:
        return
    latches = _latches(rule, record)
    if not latches and is_too_frequent(record.raises_at_s, rule.raises_per_min_max, now_s):
        record.is_chattering = True
        return
    record.timers = Timers(was_judged=record.timers.was_judged, leaves=record.timers.leaves)
    fire(record, Trigger.LATCH if latches else Trigger.CLEAR)


def _latches(rule: AlarmRule, record: AlarmRecord) -> bool:
    """Check whether an alarm stays active when its condition ends."""
    return rule.latch and not (rule.ack_resets and record.is_acknowledged)


def acknowledge(rule: AlarmRule, record: AlarmRecord) -> None:
    """Acknowledge an alarm, which for some resets it too."""
    fire(record, Trigger.ACKNOWLEDGE)
    if rule.ack_resets:
        fire(record, Trigger.RESET)


def restart_timers(record: AlarmRecord, now_s: float) -> None:
    """Begin the timers of an alarm anew, after time in which the program stood still.

    Neither a delay nor the time out of sight may be satisfied by time that was not observed.
    """
    record.timers = Timers(held_last=record.timers.held_last, leaves=record.timers.leaves)
    if record.resumed is not None:
        record.resumed = replace(record.resumed, from_s=math.inf)
    if record.unknown_since_s is not None:
        record.unknown_since_s = now_s


def calms_s(rule: AlarmRule, record: AlarmRecord) -> float:
    """Return when a chattering alarm calms down, if it does not come again; infinite if it does not chatter."""
    return record.raises_at_s[-rule.raises_per_min_max] + MINUTE_S if record.is_chattering else math.inf


# Nothing to judge by: a target out of sight, or another rule of which nothing is known.
# For the grace nothing changes and timers stand still. Then `lost.policy` decides: `clear` counts as not holding, and
# the off-delay runs; `assert` counts as holding; `hold` leaves the alarm as it was. After `fault_after` a held alarm is
# reported, and lets its output go; one that latches is latched, and can be reset.


def decided_by_policy(rule: AlarmRule, record: AlarmRecord, now_s: float) -> bool | None:
    """Check whether the condition counts as holding while there is nothing to judge by; None for unknown."""
    if record.unknown_since_s is None or now_s - record.unknown_since_s + ROUNDING_S < rule.lost.grace_s:
        return None
    return _BY_POLICY[rule.lost.policy]


_BY_POLICY = {LostPolicy.HOLD: None, LostPolicy.CLEAR: False, LostPolicy.ASSERT: True}


def take_nothing(rule: AlarmRule, record: AlarmRecord, now_s: float) -> None:
    """Take in a cycle with nothing to judge an alarm by."""
    if record.unknown_since_s is None:
        record.unknown_since_s = now_s
    away_s = now_s - record.unknown_since_s + ROUNDING_S
    decided = decided_by_policy(rule, record, now_s)
    if away_s >= rule.lost.grace_s and record.timers.is_running and (decided is not False or not record.is_active):
        # What was counted before the grace is too old to go on with. An off-delay goes on: not seeing counts as ended.
        record.timers = Timers(was_judged=record.timers.was_judged, leaves=record.timers.leaves)
    if decided is True:
        _assert(rule, record, now_s)
    elif not record.is_judged_by_its_end:
        return
    elif decided is False:
        fire(record, Trigger.ENDS)
        _clear_when_due(rule, record, ended_s(rule, record, now_s), now_s)
    elif away_s >= rule.lost.fault_after_s and not record.is_given_up:
        record.is_given_up = True
        if _latches(rule, record):
            fire(record, Trigger.LATCH)


def _assert(rule: AlarmRule, record: AlarmRecord, now_s: float) -> None:
    if not record.is_active:
        # Every part counts as holding, and not seeing is a danger of its own: it acts.
        record.timers = replace(record.timers, leaves=())
        record.held_from_start = False
        _raise(rule, record, now_s)
        return
    record.is_announced_only = record.is_given_up = False
    if record.state in LATCHED:  # what its parts did while it was latched counts no more than while it was not active
        record.timers = replace(record.timers, leaves=())
    fire(record, Trigger.HOLDS)


def ended_s(rule: AlarmRule, record: AlarmRecord, now_s: float) -> float:
    """Return for how long the condition has ended, time out of sight that counts as ended included."""
    if record.unknown_since_s is None or decided_by_policy(rule, record, now_s) is not False:
        return record.timers.ended_s
    return record.timers.ended_s + now_s - record.unknown_since_s - rule.lost.grace_s + ROUNDING_S


def pass_over(record: AlarmRecord, since_s: float) -> None:
    """Let time pass that counts for no delay. If samples to the contrary follow, it belongs to them."""
    if record.timers.is_running:
        record.timers = replace(record.timers, contrary_s=record.timers.contrary_s + since_s)


def come_back(rule: AlarmRule, record: AlarmRecord, now_s: float) -> None:
    """Go on with an alarm for which there is something to judge by again. Coming back raises nothing by itself."""
    if record.unknown_since_s is None:
        return
    away_s = now_s - record.unknown_since_s
    # The time out of sight counts for no other timer, so the next sample starts counting anew.
    ended = ended_s(rule, record, now_s) if record.is_active else 0.0
    record.timers = replace(record.timers, was_judged=False, ended_s=ended)
    record.unknown_since_s = None
    record.is_given_up = False
    pass_over(record, away_s)
