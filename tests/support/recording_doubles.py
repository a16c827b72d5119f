"""Recording doubles: outputs and a messenger that act on nothing, and remember every call."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Generic, Literal, TypeVar

from msgspec import Struct

from stadimeter.core.clock import Clock
from stadimeter.core.command import LevelCommand, TwistCommand
from stadimeter.core.message import Message
from stadimeter.errors import DeviceClosedError, DriverError

CommandT = TypeVar("CommandT", LevelCommand, TwistCommand)
Action = Literal["open", "apply", "tick", "stop", "close"]


class Call(Struct, frozen=True, kw_only=True):
    """One call that a double received; `command` is what `apply` was given, None for every other action."""

    at_s: float
    device: str
    action: Action
    command: LevelCommand | TwistCommand | None = None


class RecordingOutput(Generic[CommandT]):
    """The common part of the recording actuator and the recording base.

    A call that fails is recorded as well. Ticks are not recorded: there are too many of them.

    Args:
        calls: Where to record; hand the same list to several doubles to see the order between them.

    Attributes:
        calls: Everything that was recorded there, in order.
        commands: The commands that `apply` was given, in order.
        command_times_s: When each of them came.
        stop_times_s: When `stop` was called while it was open. Closing stops too, and counts.
        fail_with: If set, the actions in `fail_on` raise this.
        fail_on: Which actions fail while `fail_with` is set.
    """

    def __init__(self, clock: Clock, name: str = "recording", calls: list[Call] | None = None) -> None:
        self.calls: list[Call] = [] if calls is None else calls
        self.commands: list[CommandT] = []
        self.command_times_s: list[float] = []
        self.stop_times_s: list[float] = []
        self.is_open = False
        self.fail_with: DriverError | None = None
        self.fail_on: Iterable[Action] = ("apply",)
        self._clock = clock
        self._name = name
        self._command: CommandT | None = None

    @property
    def current(self) -> CommandT | None:
        """The command in effect; None when it was opened, stopped or closed after the newest command."""
        return self._command

    def open(self) -> None:
        """Open, at rest."""
        self._record("open")
        self.is_open = True
        self._command = None

    def apply(self, command: CommandT) -> CommandT:
        """Take a command and return it unchanged."""
        self._check_open()
        self.commands.append(command)
        self.command_times_s.append(self._clock.now_s())
        self._record("apply", command)
        self._command = command
        return command

    def tick(self, now_s: float) -> None:
        """Do nothing but check that it is open."""
        self._check_open()
        self._fail_if_asked("tick")

    def stop(self) -> None:
        """Rest; nothing is recorded when closed."""
        if self.is_open:
            self.stop_times_s.append(self._clock.now_s())
            self._record("stop")
            self._command = None

    def close(self) -> None:
        """Stop, then close; nothing is recorded when it is closed already. It is closed even if it is set to fail."""
        if not self.is_open:
            return
        try:
            self.stop()
            self._record("close")
        finally:
            self.is_open = False
            self._command = None

    def _check_open(self) -> None:
        if not self.is_open:
            raise DeviceClosedError(f"{self._name}: it is not open")

    def _record(self, action: Action, command: CommandT | None = None) -> None:
        self.calls.append(Call(at_s=self._clock.now_s(), device=self._name, action=action, command=command))
        self._fail_if_asked(action)

    def _fail_if_asked(self, action: Action) -> None:
        if self.fail_with is not None and action in self.fail_on:
            raise self.fail_with


class RecordingActuator(RecordingOutput[LevelCommand]):
    """An actuator that records."""

    @property
    def level(self) -> float:
        """The level it acts with now, from 0 to 1."""
        return 0.0 if self._command is None else self._command.level


class RecordingBase(RecordingOutput[TwistCommand]):
    """A base that records."""

    @property
    def linear_mps(self) -> float:
        """Its speed forwards now."""
        return 0.0 if self._command is None else self._command.linear_mps

    @property
    def angular_radps(self) -> float:
        """Its rate of turn now, positive to the left."""
        return 0.0 if self._command is None else self._command.angular_radps


class RecordingMessenger:
    """A messenger that keeps its messages.

    Attributes:
        given_up: How many messages it says that it gave up.
        left: What it says that it has not delivered.
        fail_with: If set, `publish` raises this.
    """

    def __init__(self) -> None:
        self.messages: list[Message] = []
        self.given_up = 0
        self.left: tuple[Message, ...] = ()
        self.is_open = False
        self.trouble_text = ""
        self.fail_with: DriverError | None = None

    def open(self) -> None:
        """Open."""
        self.is_open = True

    def publish(self, message: Message) -> None:
        """Keep a message."""
        if not self.is_open:
            raise DeviceClosedError("the recording messenger is not open")
        if self.fail_with is not None:
            raise self.fail_with
        self.messages.append(message)

    def undelivered(self) -> tuple[Message, ...]:
        """Return what `left` says."""
        return self.left

    def trouble(self) -> str:
        """Return what `trouble_text` says."""
        return self.trouble_text

    def close(self) -> None:
        """Close."""
        self.is_open = False

    def payloads(self, topic: str) -> list[str]:
        """Return what was published to a topic, in order."""
        return [message.payload for message in self.messages if message.topic == topic]
