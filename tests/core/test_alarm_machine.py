"""The table of an alarm's phases, over every phase and every trigger."""

import pytest

from stadimeter.core.alarms.machine import ACTIVE, LATCHED, TO_ACKNOWLEDGE, TRANSITIONS, Phase, Trigger, after

EVERY = [(phase, trigger) for phase in Phase for trigger in Trigger]
CLEARING = {Phase.CLEARING, Phase.CLEARING_UNACKNOWLEDGED}
AT_REST = {Phase.NORMAL, Phase.PENDING, Phase.RTN_UNACKNOWLEDGED}


@pytest.mark.parametrize(("phase", "trigger"), EVERY)
def test_every_trigger_leads_from_every_phase_to_a_phase(phase, trigger):
    assert after(phase, trigger) in Phase


@pytest.mark.parametrize("phase", Phase)
def test_every_phase_has_its_row_and_is_left_by_something(phase):
    assert set(TRANSITIONS[phase].values()) - {phase}


@pytest.mark.parametrize(("phase", "trigger"), EVERY)
def test_only_being_raised_makes_an_alarm_active(phase, trigger):
    becomes_active = phase not in ACTIVE and after(phase, trigger) in ACTIVE
    assert becomes_active is (phase in AT_REST and trigger in {Trigger.RAISE, Trigger.RAISE_ACKNOWLEDGED})


@pytest.mark.parametrize(("phase", "trigger"), EVERY)
def test_only_clearing_or_a_reset_ends_an_active_alarm(phase, trigger):
    ends = phase in ACTIVE and after(phase, trigger) not in ACTIVE
    may_clear = phase in ACTIVE - LATCHED and trigger is Trigger.CLEAR
    assert ends is (may_clear or (phase is Phase.LATCHED and trigger is Trigger.RESET))


@pytest.mark.parametrize(("phase", "trigger"), EVERY)
def test_only_an_acknowledgement_takes_the_need_for_one_away(phase, trigger):
    is_taken = phase in TO_ACKNOWLEDGE and after(phase, trigger) not in TO_ACKNOWLEDGE
    by_hand = trigger is Trigger.ACKNOWLEDGE
    raised_without = phase is Phase.RTN_UNACKNOWLEDGED and trigger is Trigger.RAISE_ACKNOWLEDGED
    assert is_taken is (phase in TO_ACKNOWLEDGE and (by_hand or raised_without))


@pytest.mark.parametrize(("phase", "trigger"), EVERY)
def test_only_a_raise_or_a_realarm_asks_for_an_acknowledgement(phase, trigger):
    asks = phase not in TO_ACKNOWLEDGE and after(phase, trigger) in TO_ACKNOWLEDGE
    assert asks is (
        (phase in AT_REST - TO_ACKNOWLEDGE and trigger is Trigger.RAISE)
        or (phase in ACTIVE - TO_ACKNOWLEDGE and trigger is Trigger.REALARM)
    )


@pytest.mark.parametrize(("phase", "trigger"), EVERY)
def test_a_latched_alarm_waits_for_a_reset_or_holds_again(phase, trigger):
    leaves = phase in LATCHED and after(phase, trigger) not in LATCHED
    resets = phase is Phase.LATCHED and trigger is Trigger.RESET
    assert leaves is (phase in LATCHED and (trigger is Trigger.HOLDS or resets))


@pytest.mark.parametrize(("phase", "trigger"), EVERY)
def test_an_acknowledgement_changes_nothing_else(phase, trigger):
    if trigger is Trigger.ACKNOWLEDGE and phase in ACTIVE:
        assert after(phase, trigger) in ACTIVE
        assert (after(phase, trigger) in CLEARING) is (phase in CLEARING)
        assert (after(phase, trigger) in LATCHED) is (phase in LATCHED)


@pytest.mark.parametrize("phase", Phase)
def test_the_same_trigger_twice_is_like_once(phase):
    for trigger in Trigger:
        once = after(phase, trigger)
        assert after(once, trigger) is once


def test_every_phase_can_be_reached_and_every_phase_can_come_to_rest():
    reached, edge = {Phase.NORMAL}, {Phase.NORMAL}
    while edge:
        edge = {after(phase, trigger) for phase in edge for trigger in Trigger} - reached
        reached |= edge
    assert reached == set(Phase)
    to_rest = {Phase.NORMAL}
    while more := {phase for phase in Phase if {after(phase, t) for t in Trigger} & to_rest} - to_rest:
        to_rest |= more
    assert to_rest == set(Phase)
