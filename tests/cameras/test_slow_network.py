"""Streams over networks that are too slow, packet by packet, on a clock that is stepped."""

from __future__ import annotations

import pytest

from stadimeter.cameras.capture_time import BACKED_UP
from support.each_case import each_case
from support.slow_network import LEARNT_S, Network, pictures_over, turns_for_s

LIMIT_S = 0.5
"""How long a robot may follow what is gone, beyond the stated latency."""

SIZES = {30.0: 20_000, 15.0: 30_000}
"""Bytes of a picture by rate."""

BUSY_S = (0.0, 0.004, 0.012)


def network(seed: int, share: float, rate_hz: float, *, ends_packets: bool) -> Network:
    """Return a network whose token bucket and jitter vary with its number."""
    return Network(
        seed, share=share, ends_packets=ends_packets, rate_hz=rate_hz, picture_bytes=SIZES[rate_hz],
        bucket_bytes=(3000, 15_000)[seed % 2], jitter=(0.2, 0.5)[seed // 2 % 2], seconds=20.0,
    )  # fmt: skip


@each_case("ends_packets", [False, True])
@each_case("share", [0.5, 0.9])
def test_on_a_network_that_is_too_slow_nothing_that_is_gone_is_followed(share: float, ends_packets: bool) -> None:
    assert turns_for_s(network(1, share, 30.0, ends_packets=ends_packets)) < LIMIT_S


@pytest.mark.long
@each_case("ends_packets", [False, True])
@each_case("rate_hz", SIZES)
@each_case("share", [0.5, 0.7, 0.9])
def test_no_packets_of_a_network_that_is_too_slow_make_an_old_picture_fresh(
    share: float, rate_hz: float, ends_packets: bool
) -> None:
    for seed in range(20):
        each = network(seed, share, rate_hz, ends_packets=ends_packets)
        assert turns_for_s(each, BUSY_S[seed % 3]) < LIMIT_S, f"seed {seed}"


def test_a_network_that_is_too_slow_is_named_as_the_reason() -> None:
    found = list(pictures_over(network(1, 0.7, 30.0, ends_packets=True)))
    assert {why for _, arrived_s, _, why in found if arrived_s > LEARNT_S + 2} == {BACKED_UP}


@each_case("ends_packets", [False, True])
@each_case("share", [1.2, 3.0])
def test_all_pictures_of_a_network_that_is_fast_enough_are_believed(share: float, ends_packets: bool) -> None:
    for seed in range(3):
        found = list(pictures_over(network(seed, share, 30.0, ends_packets=ends_packets), BUSY_S[seed]))
        assert all(found_s is not None for captured_s, _, found_s, _ in found if captured_s > 1)
