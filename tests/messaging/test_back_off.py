from __future__ import annotations

from stadimeter.messaging.protocol import BackOff, Patience


def test_pauses_double_up_to_the_longest_and_begin_anew_after_a_reset():
    back_off = BackOff(Patience())
    assert [back_off.next_s() for _ in range(8)] == [1, 2, 4, 8, 16, 32, 60, 60]
    back_off.reset()
    assert back_off.next_s() == 1
