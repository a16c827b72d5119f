"""The line to a base: a serial port, and what is acknowledged on it."""

from __future__ import annotations

import os
import pty
import select
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from stadimeter.bases import serial_base
from stadimeter.bases.protocol import DOUBTED_AFTER_S, LATE_AFTER_S, LOOK_S, Acknowledgements
from stadimeter.bases.serial_base import SerialLink
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError

LATE_S = 0.06
"""Longer than a port may leave bytes lying."""


class Terminal:
    """A bare pseudo-terminal: the board's end is ours, and nobody reads it unless a test does."""

    def __init__(self) -> None:
        self.board, self._host = pty.openpty()
        tty.setraw(self._host)
        self.path = os.ttyname(self._host)
        self._open = True

    def hang_up(self) -> None:
        if self._open:
            self._open = False
            os.close(self.board)
            os.close(self._host)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    made = Terminal()
    yield made
    made.hang_up()


@pytest.fixture
def link(terminal: Terminal) -> Iterator[SerialLink]:
    opened = SerialLink(terminal.path, 57600)
    opened.open()
    yield opened
    opened.close()


def test_bytes_go_both_ways_unchanged(link: SerialLink, terminal: Terminal) -> None:
    assert link.read() == b""
    every_byte = bytes(range(256))
    link.write(every_byte)
    assert os.read(terminal.board, 1000) == every_byte
    os.write(terminal.board, every_byte)
    assert link.read() == every_byte


def test_an_absent_port_is_named_with_the_ports_that_exist(tmp_path: Path) -> None:
    with pytest.raises(DeviceOpenError, match=r"there is no serial port .*ttyUSB9; (these exist|none is plugged in)"):
        SerialLink(str(tmp_path / "ttyUSB9"), 57600).open()


def test_an_open_port_is_not_opened_twice(link: SerialLink, terminal: Terminal) -> None:
    with pytest.raises(DeviceOpenError, match="already open"):
        SerialLink(terminal.path, 57600).open()


def test_a_closed_port_can_be_opened_again(link: SerialLink, terminal: Terminal) -> None:
    link.close()
    link.close()
    again = SerialLink(terminal.path, 57600)
    again.open()
    again.close()


def test_a_port_that_is_not_ours_names_the_group() -> None:
    forbidden = PermissionError(13, "Permission denied", "/dev/ttyUSB0")  # root, as in CI, may open every port
    assert "dialout" in serial_base._open_trouble("/dev/ttyUSB0", forbidden)


def test_a_file_is_no_serial_port(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("no port")
    with pytest.raises(DeviceOpenError, match="cannot be opened"):
        SerialLink(str(file), 57600).open()


@pytest.mark.parametrize(
    "use", [SerialLink.read, SerialLink.drain, lambda link: link.write(b"m 0 0\r")], ids=["read", "drain", "write"]
)
def test_a_hang_up_is_a_lost_link(link: SerialLink, terminal: Terminal, use: Callable[[SerialLink], object]) -> None:
    terminal.hang_up()
    with pytest.raises(LinkLostError, match="unplugged"):
        use(link)


def fill(link: SerialLink) -> None:
    for _ in range(100):
        link.write(b"x" * 1000)


def test_a_port_that_nobody_reads_is_a_lost_link_and_does_not_block(link: SerialLink) -> None:
    with pytest.raises(LinkLostError, match="50 ms"):
        fill(link)


def test_a_write_that_succeeded_late_is_no_lost_link(
    link: SerialLink, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = os.write

    def write_and_wait_for_a_processor(descriptor: int, data: bytes) -> int:
        taken = write(descriptor, data)
        time.sleep(LATE_S)
        return taken

    monkeypatch.setattr(os, "write", write_and_wait_for_a_processor)
    link.write(b"m 10 10\r")
    assert os.read(terminal.board, 100) == b"m 10 10\r"


def test_a_port_that_made_room_while_this_process_waited_for_a_processor_is_no_lost_link(
    link: SerialLink, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(LinkLostError):
        fill(link)
    read = []

    def room_comes_late(_seconds: float) -> None:
        time.sleep(LATE_S)
        while select.select([terminal.board], [], [], 0.05)[0]:
            read.append(os.read(terminal.board, 4096))

    monkeypatch.setattr(link, "_wait_for_room", room_comes_late)
    link.write(b"m 10 10\r")
    room_comes_late(0)
    assert b"".join(read).endswith(b"xm 10 10\r")


def test_a_port_that_was_never_opened_is_refused() -> None:
    link = SerialLink("/dev/ttyUSB0", 57600)
    for use in (link.read, link.drain, lambda: link.write(b"b\r")):
        with pytest.raises(DeviceClosedError, match="not open"):
            use()


def test_the_answer_to_an_earlier_command_does_not_pass_for_the_stops() -> None:
    awaited = Acknowledgements()
    awaited.sent(0.9, stop=False)
    awaited.sent(0.92, stop=True)
    awaited.note_answer(is_done=True)
    listen(awaited, 0.92, LATE_AFTER_S - 0.04)
    assert not awaited.stop_is_overdue(1.2)  # its answer may still come
    listen(awaited, 1.2, 0.06)
    assert awaited.stop_is_overdue(1.3)


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
