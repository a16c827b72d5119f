"""A short run of the benchmark of a fleet loses nothing."""

from __future__ import annotations

import pytest

from support.programs import needs


@pytest.mark.long
@needs("mosquitto")
def test_nothing_that_fifty_devices_say_is_lost() -> None:
    from fleet import measure

    found = measure(devices=50, processes=1, minutes=0.5, queued=100_000)
    sent, heard = found["sent"], found["heard"]
    assert heard["devices"] == 50
    assert (heard["messages"], heard["states"], heard["raised"]) == (sent["messages"], sent["states"], sent["raised"])
    assert (heard["missed"], heard["passed_over"]) == (0, 0)
    assert found["drawn_bytes"] > 10_000
