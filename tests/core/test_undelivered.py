"""Whether an alarm has not reached those who are to hear of it."""

import pytest

from stadimeter.core.conditions.evidence import describe_begin, describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.of_rules import UndeliveredCondition

LATE = UndeliveredCondition(for_s=5.0)


def inputs(since_s, now_s=100.0):
    return RuleInputs(tracks={}, now_s=now_s, undelivered_since_s=since_s)


@pytest.mark.parametrize(
    ("since_s", "holds"), [(None, False), (100.0, False), (95.1, False), (95.0, True), (0.0, True)]
)
def test_it_holds_while_an_alarm_has_waited_for_its_time(since_s, holds):
    assert LATE.holds(inputs(since_s), is_on=False) is holds


def test_it_is_worded_with_its_time():
    assert describe_begin(LATE) == "an alarm is undelivered for 5 s"
    assert describe_verdict(LATE, inputs(93.9), (), is_active=False) == "an alarm is undelivered for 6.1 s of 5 s"
    assert describe_verdict(LATE, inputs(None), (), is_active=False) == "no alarm is undelivered"
