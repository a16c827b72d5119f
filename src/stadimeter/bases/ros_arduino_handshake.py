"""How a connection to a ros_arduino_bridge begins: wait for its boot, know it by its answer, make it stand."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

from stadimeter.bases import ros_arduino_codec as codec
from stadimeter.bases.serial_link import SerialLink
from stadimeter.core.clock import Clock
from stadimeter.errors import DeviceOpenError, ProtocolError

_ASKED_EVERY_S = 0.2
_READ_EVERY_S = 0.02
_ANSWER_WITHIN_S = 0.5

BASE_IS_OFF = (
    "its sketch was built without the base controller: enable '#define USE_BASE' in ROSArduinoBridge.ino, choose the "
    "motor driver and load it again"
)


@dataclass(slots=True, kw_only=True)
class Handshake:
    """The first words with a base, over a link that is already open.

    Attributes:
        link: The port, just opened. The base may still be booting.
        boot_wait_s: How long the base may take until it answers.
    """

    link: SerialLink
    clock: Clock
    boot_wait_s: float
    _parser: codec.ReplyParser = field(default_factory=codec.ReplyParser)

    def run(self) -> None:
        """Wait until the base answers, stop it, and set its encoders to zero.

        Each try begins with an end of line and a stop. A base that drove when an earlier program died shall not drive
        on while we ask, and half a command of that program shall not swallow our stop.

        Raises:
            DeviceOpenError: Nothing answers, or not as this firmware does.
            ProtocolError: It answers, but will not drive.
            LinkLostError: The port is gone.
        """
        tries = self._identify()
        if tries > 1:
            self._let_late_answers_pass()
        self._confirm(codec.RESET_ENCODERS)
        self._confirm(codec.STOP)

    def _identify(self) -> int:
        """Ask until the base tells its baud rate, and return how often it was asked."""
        deadline_s = self.clock.now_s() + self.boot_wait_s
        for tries in itertools.count(1):
            self.link.write(codec.END + codec.STOP)
            self.link.write(codec.ASK_BAUD_RATE)
            if any(isinstance(reply, codec.BaudRate) for reply in self._replies_for(_ASKED_EVERY_S)):
                return tries
            if self.clock.now_s() >= deadline_s:
                break
        raise DeviceOpenError(self._nobody_there())

    def _let_late_answers_pass(self) -> None:
        """Several tries may have been answered at once, after the boot. None of them shall pass for a later answer."""
        end_s = self.clock.now_s() + self.boot_wait_s  # something that is no base may talk for ever
        while self.clock.now_s() < end_s and any(True for _ in self._replies_for(_ANSWER_WITHIN_S)):
            pass

    def _confirm(self, frame: bytes) -> None:
        self.link.write(frame)
        for reply in self._replies_for(_ANSWER_WITHIN_S):
            if isinstance(reply, codec.Acknowledged):
                return
            if isinstance(reply, codec.Refused):
                raise ProtocolError(f"the base at {self.link.path} refuses to drive; {BASE_IS_OFF}")
        raise DeviceOpenError(
            f"the base at {self.link.path} has told its baud rate, but does not acknowledge {frame!r}; "
            "is its sketch the one of ros_arduino_bridge?"
        )

    def _replies_for(self, seconds: float) -> Iterator[codec.Reply]:
        end_s = self.clock.now_s() + seconds
        while self.clock.now_s() < end_s:
            self.clock.sleep_until_s(min(end_s, self.clock.now_s() + _READ_EVERY_S))
            yield from self._parser.feed(self.link.read())

    def _nobody_there(self) -> str:
        heard = self._parser.dropped_bytes
        what = f"only {heard} bytes without meaning came" if heard else "nothing answers"
        return (
            f"no ros_arduino_bridge at {self.link.path}: {what} in {self.boot_wait_s:g} s; check that its sketch is "
            "loaded, that the baud rate is the sketch's, and that this is the right port"
        )
