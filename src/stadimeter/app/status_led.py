"""The status LED: shows by its rhythm how a run is doing.

A light that does not change says that nothing runs: a program that was killed may leave it on or off. So every state
of a run has a rhythm of its own, which one colour, and an eye that knows no colours, can tell apart:

- mostly dark, with short flashes: it runs well;
- mostly lit, with short gaps: something keeps it from acting;
- an even rhythm: slow while it starts, fast while an alarm waits for a person.

The LED is an actuator like any other, on a lease like any other: while the control loop hangs, it goes dark.
"""

from __future__ import annotations

from enum import Enum

from stadimeter.actuators.protocol import Actuator
from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.leased_output import LeasedOutput
from stadimeter.core.clock import Clock
from stadimeter.core.command import LevelCommand
from stadimeter.core.decision import Decision, RuleStatus, SafetyMode
from stadimeter.core.rule import Pattern
from stadimeter.core.track import TrackStatus

LEASE_S = 2.0
"""The LED goes dark when the newest cycle is older than this."""


def _flashes(count: int, *, lit: float = 1.0) -> Pattern:
    """Return short flashes in the dark, or, with ``lit`` 0, short gaps in the light; then a pause."""
    short_s, between_s, pause_s = (0.12, 0.28, 1.6) if lit else (0.3, 0.4, 1.4)
    return Pattern(steps=(*((lit, short_s), (1.0 - lit, between_s)) * count, (1.0 - lit, pause_s)))


class Status(Enum):
    """How a run is doing. The value is what the LED shows, for as long as it lasts."""

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
    """Frames are late or of unknown age, or a person stopped the outputs: they are kept at their safe values."""
    BLIND = _flashes(2, lit=0.0)
    """The camera gives no frames."""
    FAULT = _flashes(3, lit=0.0)
    """The driver of an output failed."""


def status_of(record: CycleRecord) -> Status:
    """Return what a cycle says of the run: of several things, the one that matters most."""
    decision, observation = record.decision, record.observation
    if observation.camera_fault and observation.camera_fault in decision.safety_reason:
        return Status.BLIND  # a slow camera has faults too, between two frames that are fresh
    if observation.output_faults:
        return Status.FAULT
    if any(not rule.acknowledged or rule.status is RuleStatus.LATCHED for rule in decision.rules if not rule.gates):
        return Status.ALARM
    if decision.safety in {SafetyMode.STALE, SafetyMode.STOPPED} or observation.not_for_motion:
        return Status.HELD
    return Status.STARTING if decision.safety is SafetyMode.STARTING else _status_while_active(decision)


def _status_while_active(decision: Decision) -> Status:
    if any({"shelved", "out of service"}.intersection(rule.gates) for rule in decision.rules):
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
