"""How often a password may be tried."""

import pytest

from stadimeter.errors import PageError
from stadimeter.web.attempts import ADDRESSES_MAX, FORGOTTEN_S, FREE, IN_ALL, IN_ALL_S, LONGEST_WAIT_S, Attempts


class Clock:
    now_s = 1000.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def attempts(clock):
    return Attempts(clock)


def wait_s(attempts, address="192.168.1.7"):
    """Try once, and return how long it is too early."""
    try:
        attempts.begin(address)
    except PageError as error:
        return error.details["wait_s"]
    return 0


def test_a_few_wrong_passwords_cost_no_time_and_each_further_one_twice_the_wait(attempts, clock):
    assert [wait_s(attempts) for _ in range(FREE)] == [0] * FREE
    waits = []
    for _ in range(12):
        waits.append(wait_s(attempts))
        clock.now_s += waits[-1]
        assert wait_s(attempts) == 0
    assert waits[:3] == [10, 20, 40]
    assert max(waits) == waits[-1] == LONGEST_WAIT_S


def test_who_knows_the_password_starts_afresh(attempts):
    for _ in range(FREE):
        attempts.begin("192.168.1.7")
        attempts.succeeded("192.168.1.7")
    assert [wait_s(attempts) for _ in range(FREE + 1)] == [0] * FREE + [10]


def test_what_went_wrong_a_day_ago_counts_no_more(attempts, clock):
    assert [wait_s(attempts) for _ in range(FREE + 1)][-1] == 10
    clock.now_s += 10 + FORGOTTEN_S + 1
    assert [wait_s(attempts) for _ in range(FREE + 1)] == [0] * FREE + [10]


def test_another_address_need_not_wait(attempts):
    assert [wait_s(attempts) for _ in range(FREE + 1)][-1]
    assert wait_s(attempts, "192.168.1.8") == 0


def test_all_addresses_of_one_network_of_version_6_count_as_one(attempts):
    waits = [wait_s(attempts, f"2001:db8:1:2::{number:x}") for number in range(1, FREE + 2)]
    assert waits[-1] == 10
    assert wait_s(attempts, "2001:db8:1:3::1") == 0
    assert [wait_s(attempts, each) for each in ("::ffff:10.0.0.1", "10.0.0.1", "10.0.0.2")] == [0, 0, 0]


def test_a_thousand_computers_guess_no_faster_than_a_few(attempts, clock):
    waits = [wait_s(attempts, f"10.0.{number // 256}.{number % 256}") for number in range(1000)]
    assert waits.count(0) == IN_ALL
    clock.now_s += IN_ALL_S
    assert wait_s(attempts, "10.9.9.9") == 0


def test_memory_is_bounded(attempts, clock):
    for number in range(3 * ADDRESSES_MAX):
        wait_s(attempts, f"10.{number // 65536}.{number // 256 % 256}.{number % 256}")
        clock.now_s += IN_ALL_S
    assert len(attempts._failures) == ADDRESSES_MAX
