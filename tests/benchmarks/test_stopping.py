"""The program is killed in the middle of a drive: its watchdog process stands in."""

from __future__ import annotations

import random

import pytest

pytestmark = pytest.mark.long

FIRMWARE_TIME_OUT_S = 2.0


@pytest.mark.parametrize(
    "event", ["SIGTERM to the program", "SIGKILL to the program", "SIGKILL to the watchdog process"]
)
def test_the_wheels_do_not_wait_for_the_time_out_of_the_base(event):
    from stopping import EVENTS, time_to_stand_s

    assert time_to_stand_s(EVENTS[event][0], random.Random(1)) < FIRMWARE_TIME_OUT_S / 2  # noqa: S311
