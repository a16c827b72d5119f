"""The first exchange with a base on a serial port that was just opened; the base may still be booting."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from msgspec import Struct

from stadimeter.bases.serial_codec import Answers, BaseMessage, SerialCodec
from stadimeter.bases.serial_link import SerialLink
from stadimeter.core.clock import Clock
from stadimeter.errors import DeviceOpenError, ProtocolError

_ASKED_EVERY_S = 0.2
_READ_EVERY_S = 0.02
_ANSWER_WITHIN_S = 0.5

# What changes the mode of a base has this long to take effect: a Roomba takes nothing for 20 ms meanwhile.
TAKES_EFFECT_S = 0.03


class Greeting(Struct, kw_only=True):
    """Waits for a base, sets its time-out, and leaves it standing.

    Each try begins with the end of a frame and a stop. A base that drove when an earlier program died shall not drive
    on while we ask, and half a command of that program shall not swallow our stop.
    """

    link: SerialLink
    clock: Clock
    codec: SerialCodec
    boot_wait_s: float

    def run(self) -> None:
        """Wait until the base answers, send what opens it, and stop it.

        Raises:
            DeviceOpenError: Nothing answers, or not as this base does.
            ProtocolError: The base refuses to drive.
            LinkLostError: The port is gone.
        """
        if self.codec.answers is Answers.NEVER:
            self._stand_for(self.boot_wait_s)
            self.codec.feed(self.link.read())
        elif self._identify() > 1 and self.codec.answers is Answers.EACH_COMMAND:
            self._let_late_answers_pass()
        self._check_trouble()
        for frame in (*self.codec.opening, self.codec.stop):
            self._send(frame)
            if self.codec.answers is Answers.EACH_COMMAND:
                self._confirm(frame)
            else:
                self._pause(_READ_EVERY_S)

    def _identify(self) -> int:
        """Ask until the base shows what it is, and return how often it was asked."""
        deadline_s = self.clock.now_s() + self.boot_wait_s
        for tries in itertools.count(1):
            self._send(self.codec.ends_cut_frame + self.codec.stop)
            for frame in self.codec.wake:
                self._send(frame)
                self._pause(TAKES_EFFECT_S)
            if self.codec.question:
                self._pause(self.codec.gap_s)
                self._send(self.codec.question)
            is_known = any(message.is_identity for message in self._messages_for(_ASKED_EVERY_S))
            if is_known and (self.codec.answers is Answers.EACH_COMMAND or self._is_awake()):
                return tries
            if self.clock.now_s() >= deadline_s:
                break
        self._check_trouble()
        raise DeviceOpenError(self._no_answer_error())

    def _check_trouble(self) -> None:
        if self.codec.trouble:
            raise ProtocolError(f"no {self.codec.name} that drives is at {self.link.path}: {self.codec.trouble}")

    def _stand_for(self, seconds: float) -> None:
        """Send stops to a base that answers nothing, until it must have booted."""
        end_s = self.clock.now_s() + seconds
        while self.clock.now_s() < end_s:
            self._send(self.codec.ends_cut_frame + self.codec.stop)
            self._pause(min(_ASKED_EVERY_S, end_s - self.clock.now_s()))

    def _let_late_answers_pass(self) -> None:
        """Several tries may have been answered at once, after the boot. None of them shall pass for a later answer."""
        end_s = self.clock.now_s() + self.boot_wait_s  # something that is no base may talk for ever
        while self.clock.now_s() < end_s and any(True for _ in self._messages_for(_ANSWER_WITHIN_S)):
            pass

    def _is_awake(self) -> bool:
        """Check whether a base that has shown what it is will drive; wait for that while it is woken.

        It may have shown it by late reports from before, of a former connection too; what follows says that it does not
        drive, until it does. If it does not, what woke it was lost, and it must be woken again.
        """
        reports = self._messages_for(_ASKED_EVERY_S)
        while self.codec.trouble and next(reports, None) is not None:
            pass
        return not self.codec.trouble

    def _confirm(self, frame: bytes) -> None:
        for message in self._messages_for(_ANSWER_WITHIN_S):
            if message.was_done:
                return
            if message.was_done is False:
                raise ProtocolError(f"the base at {self.link.path} refuses to drive; {self.codec.refusal_hint}")
        raise DeviceOpenError(
            f"the base at {self.link.path} has answered, but does not acknowledge {frame!r}; "
            f"is it one of {self.codec.name}?"
        )

    def _messages_for(self, seconds: float) -> Iterator[BaseMessage]:
        end_s = self.clock.now_s() + seconds
        while self.clock.now_s() < end_s:
            self._pause(min(_READ_EVERY_S, end_s - self.clock.now_s()))
            yield from self.codec.feed(self.link.read())

    def _send(self, frame: bytes) -> None:
        self.codec.note_sent(frame)
        self.link.write(frame)

    def _pause(self, seconds: float) -> None:
        self.clock.sleep_until_s(self.clock.now_s() + seconds)

    def _no_answer_error(self) -> str:
        heard = self.codec.dropped_bytes
        what = f"only {heard} bytes without meaning came" if heard else "nothing answers"
        return (
            f"no {self.codec.name} at {self.link.path}: {what} in {self.boot_wait_s:g} s; {self.codec.hint}, "
            "and that this is the right port"
        )
