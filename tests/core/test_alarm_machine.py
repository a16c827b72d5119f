"""The table of an alarm's phases, over every phase and every trigger."""

from stadimeter.core.alarms.machine import (
    ACTIVE,
    LATCHED,
    TO_ACKNOWLEDGE,
    TRANSITIONS,
    AlarmRecord,
    AlarmState,
    Trigger,
    fire,
)

CLEARING = {AlarmState.CLEARING, AlarmState.CLEARING_UNACKNOWLEDGED}
AT_REST = {AlarmState.NORMAL, AlarmState.PENDING, AlarmState.RTN_UNACKNOWLEDGED}


def after(phase: AlarmState, trigger: Trigger) -> AlarmState:
    state = AlarmRecord(state=phase)
    fire(state, trigger)
    return state.state


def broken_rules(phase: AlarmState, trigger: Trigger) -> list[str]:
    """Return the rules that one cell of the table breaks."""
    to = after(phase, trigger)
    raises = trigger in {Trigger.RAISE, Trigger.RAISE_ACKNOWLEDGED}
    is_reset = phase is AlarmState.LATCHED and trigger is Trigger.RESET
    becomes_active, ends = phase not in ACTIVE and to in ACTIVE, phase in ACTIVE and to not in ACTIVE
    is_cleared = phase in ACTIVE - LATCHED and trigger is Trigger.CLEAR
    need_ends, need_begins = phase in TO_ACKNOWLEDGE - {to} and to not in TO_ACKNOWLEDGE, to in TO_ACKNOWLEDGE
    need_begins = need_begins and phase not in TO_ACKNOWLEDGE
    raised_without = phase is AlarmState.RTN_UNACKNOWLEDGED and trigger is Trigger.RAISE_ACKNOWLEDGED
    is_raised, is_realarmed = trigger is Trigger.RAISE, trigger is Trigger.REALARM
    unlatches = phase in LATCHED and to not in LATCHED
    acknowledged = trigger is Trigger.ACKNOWLEDGE and phase in ACTIVE
    rules = {
        "only being raised makes an alarm active": becomes_active is (phase in AT_REST and raises),
        "only clearing or a reset ends an active alarm": ends is (is_cleared or is_reset),
        "only an acknowledgement takes the need for one away": need_ends
        is (phase in TO_ACKNOWLEDGE and (trigger is Trigger.ACKNOWLEDGE or raised_without)),
        "only a raise or a re-alarm asks for an acknowledgement": need_begins
        is ((phase in AT_REST - TO_ACKNOWLEDGE and is_raised) or (phase in ACTIVE - TO_ACKNOWLEDGE and is_realarmed)),
        "a latched alarm waits for a reset or holds again": unlatches
        is (phase in LATCHED and (trigger is Trigger.HOLDS or is_reset)),
        "an acknowledgement changes nothing else": not acknowledged
        or (to in ACTIVE and (to in CLEARING) is (phase in CLEARING) and (to in LATCHED) is (phase in LATCHED)),
        "the same trigger twice is like once": after(to, trigger) is to,
    }
    return [rule for rule, is_kept in rules.items() if not is_kept]


def test_every_cell_of_the_table():
    broken = {f"{phase} × {trigger}": broken_rules(phase, trigger) for phase in AlarmState for trigger in Trigger}
    assert {cell: rules for cell, rules in broken.items() if rules} == {}


def test_every_phase_has_its_row_and_is_left_by_something():
    assert [phase for phase in AlarmState if not set(TRANSITIONS[phase].values()) - {phase}] == []


def test_every_phase_can_be_reached_and_every_phase_can_come_to_rest():
    reached, edge = {AlarmState.NORMAL}, {AlarmState.NORMAL}
    while edge:
        edge = {after(phase, trigger) for phase in edge for trigger in Trigger} - reached
        reached |= edge
    assert reached == set(AlarmState)
    to_rest = {AlarmState.NORMAL}
    while more := {phase for phase in AlarmState if {after(phase, t) for t in Trigger} & to_rest} - to_rest:
        to_rest |= more
    assert to_rest == set(AlarmState)
