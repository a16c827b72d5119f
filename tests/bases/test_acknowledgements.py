from __future__ import annotations

import pytest

from stadimeter.bases.protocol import DOUBTED_AFTER_S, LATE_AFTER_S, LOOK_S, Acknowledgements


def test_a_stop_is_overdue_a_tenth_of_a_second_after_it_was_sent() -> None:
    awaited = Acknowledgements()
    awaited.sent(1.0, stop=True)
    assert not awaited.stop_is_overdue(1.05)
    assert awaited.stop_is_overdue(1.11)


def test_the_answer_to_an_earlier_command_does_not_pass_for_the_stops() -> None:
    awaited = Acknowledgements()
    awaited.sent(0.9, stop=False)
    awaited.sent(0.92, stop=True)
    awaited.note_answer(is_done=True)
    listen(awaited, 0.92, LATE_AFTER_S - 0.04)
    assert not awaited.stop_is_overdue(1.2)  # its answer may still come
    listen(awaited, 1.2, 0.06)
    assert awaited.stop_is_overdue(1.3)


def test_a_command_is_free_to_go_once_all_before_it_were_answered() -> None:
    awaited = Acknowledgements()
    assert awaited.is_free
    awaited.sent(0.9, stop=False)
    assert not awaited.is_free
    awaited.note_answer(is_done=True)
    assert awaited.is_free
    assert not awaited.is_late


def test_a_command_that_is_not_answered_in_time_is_followed_by_a_stop() -> None:
    awaited = Acknowledgements()
    awaited.sent(1.0, stop=False)
    listen(awaited, 1.0, DOUBTED_AFTER_S - 0.03)
    assert not awaited.stop_is_overdue(1.12)
    listen(awaited, 1.12, 0.04)
    assert awaited.stop_is_overdue(1.16)


def test_an_answer_that_is_late_says_so_and_one_that_was_lost_does_not() -> None:
    late, lost = Acknowledgements(), Acknowledgements()
    for awaited in (late, lost):
        awaited.sent(1.0, stop=False)
        listen(awaited, 1.0, 0.16)
        awaited.sent(1.16, stop=True)
    listen(late, 1.16, 0.1)
    late.note_answer(is_done=True)
    assert late.is_late
    lost.note_answer(is_done=True)
    listen(lost, 1.16, LATE_AFTER_S + 0.02)
    assert lost.stop_is_overdue(1.43)
    lost.repeating()
    lost.sent(1.43, stop=True)
    lost.note_answer(is_done=True)
    assert lost.is_free
    assert not lost.is_late


def test_a_refused_stop_stays_overdue() -> None:
    awaited = Acknowledgements()
    awaited.sent(1.0, stop=True)
    awaited.note_answer(is_done=False)
    assert awaited.stop_is_overdue(1.2)


def test_a_new_drive_command_takes_the_stop_back() -> None:
    awaited = Acknowledgements()
    awaited.sent(1.0, stop=True)
    awaited.sent(1.05, stop=False)
    assert not awaited.stop_is_overdue(2.0)


def test_behind_two_frames_that_are_not_answered_the_line_is_quiet_where_any_byte_keeps_wheels_turning() -> None:
    awaited = Acknowledgements(any_byte_feeds=True)
    awaited.sent(1.0, stop=True)
    assert awaited.stop_is_overdue(1.11)
    awaited.repeating()
    awaited.sent(1.11, stop=True)
    assert awaited.must_be_quiet
    assert not awaited.stop_is_overdue(9.0)
    awaited.note_answer(is_done=True)
    assert not awaited.must_be_quiet


def listen(awaited: Acknowledgements, from_s: float, seconds: float) -> None:
    """Look at the line every 20 ms."""
    for look in range(1, round(seconds / 0.02) + 1):
        awaited.looked(from_s + 0.02 * look)


def test_silence_counts_from_the_first_command_after_the_last_answer() -> None:
    awaited = Acknowledgements()
    listen(awaited, 4.0, 1.0)
    assert awaited.silent_s == 0.0
    awaited.sent(5.0, stop=False)
    awaited.sent(5.1, stop=False)
    listen(awaited, 5.0, 0.4)
    assert awaited.silent_s == pytest.approx(0.4)


def test_time_in_which_nothing_was_read_is_no_silence() -> None:
    awaited = Acknowledgements()
    awaited.sent(5.0, stop=False)  # this process then waits for a processor, before the command leaves or after
    awaited.looked(5.6)
    assert awaited.silent_s == LOOK_S


def test_one_lost_answer_does_not_count_as_a_lost_link_for_ever() -> None:
    awaited = Acknowledgements()
    awaited.sent(1.0, stop=False)
    awaited.sent(1.1, stop=False)
    awaited.note_answer(is_done=True)
    awaited.repeating()
    listen(awaited, 2.0, 5.0)
    assert awaited.silent_s == 0.0


def test_a_repeated_stop_is_acknowledged_by_the_next_answer_even_if_earlier_ones_were_lost() -> None:
    awaited = Acknowledgements()
    for tenth in range(5):
        awaited.sent(tenth / 10, stop=False)
    awaited.sent(0.5, stop=True)
    awaited.note_answer(is_done=True)
    awaited.repeating()
    awaited.sent(0.8, stop=True)
    awaited.note_answer(is_done=True)
    assert not awaited.stop_is_overdue(9.0)
