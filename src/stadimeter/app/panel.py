"""The front panel of a run: push buttons and the status LED.

Push buttons are read every 20 ms beside the loop, debounced, and turned into operator commands. A press acts when the
button is released; a press that stops outputs acts as soon as the button is down, also if it is down when the run
begins. A button that is never released (a shorted pin, something that leans on it) does nothing else, and
`Loop.trouble` reports it. The same holds for a button that is down when the run begins or after a pause of the reading:
how long it has been down is unknown then.

The status LED shows by its rhythm how a run is doing. A steady light says that nothing runs: a program that was killed
may leave the LED on or off. So each state has a rhythm that one colour, and a colour-blind eye, can tell apart:

- mostly dark, with short flashes: it runs well;
- mostly lit, with short gaps: something keeps it from acting;
- an even rhythm: slow while it starts, fast while an alarm waits for a person.

The LED is an actuator on a lease like any other: while the control loop hangs, it goes dark.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from enum import Enum

from stadimeter.actuators.protocol import Actuator, Button
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.guard import LeasedOutput
from stadimeter.config.models import ButtonTable
from stadimeter.core.clock import Clock
from stadimeter.core.command import LevelCommand
from stadimeter.core.decision import Decision, RuleStatus, SafetyMode
from stadimeter.core.measurement import TrackStatus
from stadimeter.core.rule import Pattern
from stadimeter.errors import DriverError
from stadimeter.operator_actions import OperatorAction, OperatorCommand

# Contacts bounce for a few milliseconds; a level counts when it has held for this long.
PERIOD_S = 0.02
DEBOUNCE_S = 0.03

# A button that is held for longer was not pressed by a finger.
STUCK_S = 10.0

# After a longer pause between two readings, what the button did meanwhile is unknown. A shorter one cannot turn a tap
# into a long press, which takes a second at least.
UNSEEN_S = 0.5

# A button whose driver failed is opened again this often.
OPEN_AGAIN_S = 5.0


class Presses:
    """Finds the presses in the level of a button that is looked at again and again.

    Attributes:
        is_down: The level, debounced.
    """

    def __init__(self, *, is_down: bool, now_s: float) -> None:
        self.is_down = self._newest = is_down
        self._newest_since_s = self._looked_at_s = now_s
        self._down_since_s = -math.inf  # unless it is seen to go down

    def look(self, *, is_down: bool, now_s: float) -> float | None:
        """Take in the level at a time; return how long a press lasted, in seconds, if its end is known now."""
        if now_s - self._looked_at_s > UNSEEN_S:
            self._down_since_s = -math.inf
        self._looked_at_s = now_s
        if is_down != self._newest:
            self._newest, self._newest_since_s = is_down, now_s
        if is_down == self.is_down or now_s - self._newest_since_s < DEBOUNCE_S:
            return None
        self.is_down = is_down
        if is_down:
            self._down_since_s = self._newest_since_s
            return None
        return self._newest_since_s - self._down_since_s

    def is_stuck(self) -> bool:
        """Check whether it is held down for longer than a press lasts, or since the beginning."""
        return self.is_down and self._looked_at_s - self._down_since_s > STUCK_S


class PushButton:
    """A push button of a run."""

    def __init__(self, driver: Button, name: str, table: ButtonTable, clock: Clock) -> None:
        self._driver = driver
        self._name = name
        self._table = table
        self._clock = clock
        self._presses: Presses | None = None
        self._commands: deque[OperatorCommand] = deque()
        self._count = 0
        self._fault = ""
        self._retry_at_s = 0.0
        self._cancel: Callable[[], None] | None = None

    def open(self) -> None:
        """Take the device, and begin to look at it; `DriverError` if that is impossible."""
        self._driver.open()
        self._look(self._clock.now_s())
        self._cancel = self._clock.call_every(PERIOD_S, self._look_safely)

    def open_later(self, error: DriverError) -> bool:
        """Go on without it after `open` failed, and try again and again; return that this makes sense."""
        self._fail(error, self._clock.now_s())
        self._cancel = self._clock.call_every(PERIOD_S, self._look_safely)
        return True

    def commands(self) -> tuple[OperatorCommand, ...]:
        """Return the commands it has asked for since the last call, oldest first. Never waits."""
        return tuple(self._commands.popleft() for _ in range(len(self._commands)))

    def trouble(self) -> str:
        """Return in words what is wrong with it; empty if nothing is."""
        if self._fault:
            return f"button {self._name}: {self._fault}"
        presses = self._presses  # another thread may put it away
        if presses is None or not presses.is_stuck():
            return ""
        return f"button {self._name}: it is held down all the time, or its wires touch; it does nothing until let go"

    def close(self) -> None:
        """Cease to look, and release the device. May be called any number of times."""
        cancel, self._cancel = self._cancel, None
        if cancel is not None:
            cancel()
        self._driver.close()

    def _look_safely(self, now_s: float) -> None:
        """Look once; a driver that failed is opened again now and then. Whatever it raises must not end the looking."""
        if self._fault and now_s < self._retry_at_s:
            return
        try:
            if self._fault:
                self._driver.open()
            self._look(now_s)
            self._fault = ""
        except BaseException as error:  # noqa: BLE001 - told by `trouble`
            self._fail(error, now_s)

    def _fail(self, error: BaseException, now_s: float) -> None:
        self._fault = str(error) or type(error).__name__
        self._retry_at_s, self._presses = now_s + OPEN_AGAIN_S, None
        try:
            self._driver.close()
        except BaseException as second:  # noqa: BLE001 - likewise
            self._fault += f"; closing it failed too: {str(second) or type(second).__name__}"

    def _look(self, now_s: float) -> None:
        is_down = self._driver.is_pressed()
        was_down = self._presses is not None and self._presses.is_down
        if self._presses is None:
            self._presses = Presses(is_down=is_down, now_s=now_s)
        lasted_s = self._presses.look(is_down=is_down, now_s=now_s)
        if OperatorAction(self._table.press) is OperatorAction.STOP_OUTPUTS:
            if self._presses.is_down and not was_down:
                self._commands.append(self._command(0.0))
        elif lasted_s is not None and lasted_s <= STUCK_S:
            self._commands.append(self._command(lasted_s))

    def _command(self, lasted_s: float) -> OperatorCommand:
        table = self._table
        action = OperatorAction(table.hold if table.hold and lasted_s >= table.hold_for else table.press)
        self._count += 1
        return OperatorCommand(
            id=f"button-{self._name}-{self._count}",
            action=action,
            rule=table.rule,
            by=f"button {self._name}",
            for_s=table.shelve_for if action is OperatorAction.SHELVE else None,
            is_from_button=True,
        )


# The LED goes dark when the newest cycle is older than this.
LEASE_S = 2.0


def _flashes(count: int, *, lit: float = 1.0) -> Pattern:
    """Return short flashes in the dark, or, with ``lit`` 0, short gaps in the light; then a pause."""
    short_s, between_s, pause_s = (0.12, 0.28, 1.6) if lit else (0.3, 0.4, 1.4)
    return Pattern(steps=(*((lit, short_s), (1.0 - lit, between_s)) * count, (1.0 - lit, pause_s)))


class Status(Enum):
    """State of a run. The value is what the LED shows, for as long as it lasts."""

    WATCHING = _flashes(1)
    """All is well, and no target is in sight."""
    TRACKING = _flashes(2)
    """A target is measured."""
    QUIET = _flashes(3)
    """An alarm is shelved or out of service."""
    STARTING = Pattern(steps=((1.0, 0.5), (0.0, 0.5)))
    """Outputs wait for the first good frames."""
    ALARM = Pattern(steps=((1.0, 0.12), (0.0, 0.12)))
    """An alarm waits to be acknowledged or reset."""
    HELD = _flashes(1, lit=0.0)
    """Outputs are kept at their safe values: frames are late or of unknown age, a person stopped them, or the run is
    not armed."""
    BLIND = _flashes(2, lit=0.0)
    """The camera gives no frames."""
    FAULT = _flashes(3, lit=0.0)
    """The driver of an output failed."""


def status_of(record: CycleRecord) -> Status:
    """Return the status that a cycle shows of the run: of several things, the one that matters most."""
    decision, observation = record.decision, record.observation
    if observation.camera_fault and observation.camera_fault in decision.safety_reason:
        return Status.BLIND  # a slow camera has faults too, between two frames that are fresh
    if observation.output_faults:
        return Status.FAULT
    if any(not rule.acknowledged or rule.status is RuleStatus.LATCHED for rule in decision.rules if not rule.inhibits):
        return Status.ALARM
    if decision.safety in {SafetyMode.STALE, SafetyMode.STOPPED, SafetyMode.DISARMED} or observation.not_for_motion:
        return Status.HELD
    return Status.STARTING if decision.safety is SafetyMode.STARTING else _status_while_active(decision)


def _status_while_active(decision: Decision) -> Status:
    if any({"shelved", "out of service"}.intersection(rule.inhibits) for rule in decision.rules):
        return Status.QUIET
    is_tracking = any(track.status is TrackStatus.TRACKING for track in decision.tracks)
    return Status.TRACKING if is_tracking else Status.WATCHING


class _Rhythm:
    """Drives an actuator in a rhythm: a level is how bright it is while it is lit."""

    def __init__(self, actuator: Actuator, clock: Clock) -> None:
        self.open = actuator.open
        self.status = Status.STARTING
        self._actuator = actuator
        self._clock = clock
        self._command: LevelCommand | None = None
        self._shown: Status | None = None
        self._since_s = 0.0

    def apply(self, command: LevelCommand) -> LevelCommand:
        self._command = command
        self._show(self._clock.now_s())
        return command

    def tick(self, now_s: float) -> None:
        self._show(now_s)
        self._actuator.tick(now_s)

    def stop(self) -> None:
        self._command = None
        self._actuator.stop()

    def close(self) -> None:
        self._command = None
        self._actuator.close()

    def _show(self, now_s: float) -> None:
        if self.status is not self._shown:
            self._shown, self._since_s = self.status, now_s
        if self._command is not None:
            level = self._command.level * self._shown.value.level(now_s - self._since_s)
            self._actuator.apply(LevelCommand(output=self._command.output, level=level))


class StatusLed(LeasedOutput):
    """The status LED of a run."""

    def __init__(self, actuator: Actuator, name: str, clock: Clock) -> None:
        self._rhythm = _Rhythm(actuator, clock)
        super().__init__(self._rhythm, LevelCommand(output=name, level=0.0), LEASE_S, clock)

    def show(self, record: CycleRecord) -> None:
        """Show what a cycle says of the run, for as long as the cycle is fresh. Never waits."""
        self._rhythm.status = status_of(record)
        self.observed_fault()  # it may act again after a failure: the loop is there
        self.apply(LevelCommand(output=self.name, level=1.0, captured_at_s=record.observation.now_s))
