from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import pytest
from msgspec import Struct

from stadimeter.bases.ros_arduino_base import RosArduinoCodec
from stadimeter.bases.serial_link import Greeting, SerialLink
from stadimeter.errors import DeviceOpenError, ProtocolError
from stadimeter.simulation.emulated_base import EmulatedPort
from stadimeter.simulation.firmware import RosArduinoFirmware
from stadimeter.testing.rig import ManualClock


class SlowBoard(RosArduinoFirmware):
    """A board whose answers take 0.3 s, as through a slow adapter."""

    def __init__(self) -> None:
        super().__init__()
        self._answers: list[tuple[float, bytes]] = []

    def receive(self, data: bytes, now_s: float) -> bytes:
        self._answers.append((now_s + 0.3, super().receive(data, now_s)))
        ready = [answer for due_s, answer in self._answers if due_s <= now_s]
        del self._answers[: len(ready)]
        return b"".join(ready)


class Bench(Struct, frozen=True):
    """A board on a port that is open, about to be greeted."""

    clock: ManualClock
    port: EmulatedPort
    link: SerialLink

    def run(self, boot_wait_s: float = 4.0) -> None:
        Greeting(link=self.link, clock=self.clock, codec=RosArduinoCodec(4000.0), boot_wait_s=boot_wait_s).run()

    def repeat(self, data: bytes, every_s: float) -> None:
        """Let the board's end say something again and again, unasked."""

        def say(now_s: float) -> None:
            self.port.say(data)

        self.clock.call_every(every_s, say)


@pytest.fixture
def greet() -> Iterator[Callable[[RosArduinoFirmware], Bench]]:
    with contextlib.ExitStack() as at_end:

        def connect(board: RosArduinoFirmware) -> Bench:
            clock = ManualClock()
            port = EmulatedPort(board, clock)
            at_end.callback(port.close)
            link = SerialLink(port.path, 57600)
            link.open()
            at_end.callback(link.close)
            return Bench(clock=clock, port=port, link=link)

        yield connect


Greet = Callable[[RosArduinoFirmware], Bench]


@pytest.mark.parametrize("left_behind", [b"m 50 50\r", b"m 50 50"], ids=["driving", "half a command"])
def test_what_another_program_left_behind_is_stopped_at_once(greet: Greet, left_behind: bytes) -> None:
    board = SlowBoard()
    board.receive(left_behind, 0.0)
    greeting = greet(board)
    greeting.clock.advance_s(1.0)
    driven_mps: list[float] = []
    greeting.clock.call_every(0.01, lambda _now_s: driven_mps.append(board.left.driven_mps))
    greeting.run()
    assert set(driven_mps[2:]) == {0.0}


def test_the_encoders_are_set_to_zero(greet: Greet) -> None:
    board = RosArduinoFirmware()
    greeting = greet(board)
    for command in (b"m 50 50\r", b"m 0 0\r"):
        board.receive(command, greeting.clock.now_s())
        greeting.clock.advance_s(1.9)
    assert int(board.receive(b"e\r", greeting.clock.now_s()).split()[0]) > 1000
    greeting.run()
    assert board.receive(b"e\r", greeting.clock.now_s()) == b"0 0\r\n"


def test_a_board_that_still_boots_is_asked_until_it_answers(greet: Greet) -> None:
    board = RosArduinoFirmware()
    board.reset(boot_s=1.7)
    greeting = greet(board)
    greeting.run()
    assert greeting.clock.now_s() >= 1.7


def test_what_a_boot_loader_says_does_not_hide_the_answer(greet: Greet) -> None:
    greeting = greet(RosArduinoFirmware())
    greeting.port.say(b"\x00\xffbootloader 4.4\r\n\xfe57")
    greeting.run()


def test_late_answers_do_not_pass_for_answers_to_later_commands(greet: Greet) -> None:
    greeting = greet(SlowBoard())
    greeting.run()
    greeting.clock.advance_s(2.0)
    assert greeting.link.read() == b""


def test_silence_is_an_error_after_the_time_to_boot(greet: Greet) -> None:
    board = RosArduinoFirmware()
    board.silent = True
    greeting = greet(board)
    with pytest.raises(DeviceOpenError, match="nothing answers in 3 s"):
        greeting.run(boot_wait_s=3.0)
    assert 3.0 <= greeting.clock.now_s() < 3.5


@pytest.mark.parametrize("every_s", [0.1, 0.3])
def test_something_that_sends_numbers_for_ever_is_no_base(greet: Greet, every_s: float) -> None:
    board = RosArduinoFirmware()
    board.silent = True
    greeting = greet(board)
    greeting.repeat(b"512\r\n", every_s=every_s)
    with pytest.raises(DeviceOpenError, match="does not acknowledge"):
        greeting.run()


def test_a_sketch_without_motors_is_refused(greet: Greet) -> None:
    board = RosArduinoFirmware()
    board.use_base_off = True
    with pytest.raises(ProtocolError, match="USE_BASE"):
        greet(board).run()
