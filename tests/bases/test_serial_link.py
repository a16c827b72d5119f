from __future__ import annotations

import os
import pty
import select
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from stadimeter.bases import serial_link
from stadimeter.bases.serial_link import SerialLink
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
    assert "dialout" in serial_link._open_trouble("/dev/ttyUSB0", forbidden)


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


def test_what_was_written_is_drained(link: SerialLink, terminal: Terminal) -> None:
    link.write(b"m 0 0\r")
    link.drain()
    assert os.read(terminal.board, 100) == b"m 0 0\r"


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
