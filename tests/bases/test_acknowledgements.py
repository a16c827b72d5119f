from __future__ import annotations

import pytest

from stadimeter.bases.acknowledgements import LOOK_S, Acknowledgements


def test_a_stop_is_overdue_a_tenth_of_a_second_after_it_was_sent() -> None:
    awaited = Acknowledgements()
    awaited.sent(1.0, stop=True)
    assert not awaited.stop_is_overdue(1.05)
    assert awaited.stop_is_overdue(1.11)


def test_the_answer_to_an_earlier_command_does_not_pass_for_the_stops() -> None:
    awaited = Acknowledgements()
    awaited.sent(0.9, stop=False)
    awaited.sent(1.0, stop=True)
    awaited.note_answer(is_done=True)
    assert awaited.stop_is_overdue(1.2)
    awaited.note_answer(is_done=True)
    assert not awaited.stop_is_overdue(1.2)


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


def test_after_two_stops_that_nothing_answers_the_line_is_quiet_for_a_while_and_then_two_more_are_due() -> None:
    awaited = Acknowledgements(quiet_s=0.4)
    sent_s = []
    for step in range(200):
        now_s = 1.0 + 0.01 * step
        if not sent_s or awaited.stop_is_overdue(now_s):
            awaited.sent(now_s, stop=True)
            sent_s.append(round(now_s - 1.0, 2))
    assert sent_s[:5] == pytest.approx([0.0, 0.1, 0.5, 0.6, 1.0], abs=0.041)
    awaited.sent(3.0, stop=False)
    assert not awaited.must_be_quiet(3.0)


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
    listen(awaited, 2.0, 5.0)
    assert awaited.silent_s == 0.0


def test_a_repeated_stop_is_acknowledged_by_the_next_answer_even_if_earlier_ones_were_lost() -> None:
    awaited = Acknowledgements()
    for tenth in range(5):
        awaited.sent(tenth / 10, stop=False)
    awaited.sent(0.5, stop=True)
    awaited.repeating()
    awaited.sent(0.6, stop=True)
    awaited.note_answer(is_done=True)
    assert not awaited.stop_is_overdue(9.0)
