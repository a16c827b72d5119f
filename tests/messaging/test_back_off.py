from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from stadimeter.messaging.back_off import BackOff, Patience


def test_pauses_double_up_to_the_longest_and_begin_anew_after_a_reset():
    back_off = BackOff(Patience())
    assert [back_off.next_s() for _ in range(8)] == [1, 2, 4, 8, 16, 32, 60, 60]
    back_off.reset()
    assert back_off.next_s() == 1


@given(pause_s=st.floats(0.1, 60.0))
def test_a_spread_pause_is_a_little_shorter_and_never_longer(pause_s):
    assert 0.8 * pause_s <= BackOff(Patience()).spread_s(pause_s) <= pause_s
