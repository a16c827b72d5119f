"""Whether an alarm has not reached those who are to hear of it."""

import math

import pytest

from stadimeter.core.condition_words import describe_begin, describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.undelivered import UndeliveredCondition
from support.each_case import each_case

LATE = UndeliveredCondition(for_s=5.0)


def inputs(since_s, now_s=100.0):
    return RuleInputs(tracks={}, now_s=now_s, undelivered_since_s=since_s)


@pytest.mark.parametrize(
    ("since_s", "holds"), [(None, False), (100.0, False), (95.1, False), (95.0, True), (0.0, True)]
)
def test_it_holds_while_an_alarm_has_waited_for_its_time(since_s, holds):
    assert LATE.holds(inputs(since_s), is_on=False) is holds


@each_case("since_s", [None, 99.0, 95.0, 90.0, -1e6])
def test_while_the_oldest_alarm_waits_it_stays_as_it_is_until_it_is_due(since_s):
    now = inputs(since_s)
    rest = LATE.rest(now, is_on=False)
    ((figure, low, high),) = rest.intervals
    assert low == figure.read(now, *figure.of) == high
    assert rest.due_s > 100.0
    last_s = min(math.nextafter(rest.due_s, 0.0), 1e9)
    assert LATE.holds(inputs(since_s, last_s), is_on=False) is LATE.holds(now, is_on=False)
    if rest.due_s < math.inf:
        assert LATE.holds(inputs(since_s, rest.due_s), is_on=False)


def test_it_is_worded_with_its_time():
    assert describe_begin(LATE) == "an alarm is undelivered for 5 s"
    assert describe_verdict(LATE, inputs(93.9), (), is_active=False) == "an alarm is undelivered for 6.1 s of 5 s"
    assert describe_verdict(LATE, inputs(None), (), is_active=False) == "no alarm is undelivered"
