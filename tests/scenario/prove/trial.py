"""One trial: a run of the program from its start, through a sequence of faults, until it drives again or stands."""

from __future__ import annotations

import math
from collections import deque
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from msgspec import Struct, field

from scenario.prove.faults import FINAL, FOR_EVER_S, LASTS_S, STOPS_PROCESS, UNPLUGS, FaultSequence
from scenario.prove.staged_camera import Stage, StagedCapture, StagedDefectError, StagedEye
from scenario.prove.staged_clock import StagedClock
from scenario.prove.staging import StagedConfiguration
from scenario.prove.watch import MotionWatch, Violation
from stadimeter.app.bootstrap import build
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.recordings.journal import JournalWriter, to_be_recorded
from stadimeter.app.watchdog import WatchdogLink
from stadimeter.config.plugins import DriverContext
from stadimeter.operator_actions import OperatorAction, OperatorCommand
from stadimeter.watchdog.stops import TRIED_EVERY_S

# The wheels are looked at this often, as the emulated port is served.
_LOOK_EVERY_S = 0.01

# The rates of servos are averaged over so many looks.
_AVERAGED_LOOKS = 10

# The world goes on for this long after the last fault has ended: a base whose cable was out rests for 3 s, once its
# port was opened again after at most 1 s, and half a second of driving shows whether it was allowed to.
AFTERWARDS_S = 5.0

# Long enough after every fault is over for a robot that drives to be where it was without them.
_DRIVES_AGAIN_S = 0.5

# A base that nothing can move any more stands if its wheels did not turn for this long.
_STANDS_S = 0.3

# No sleep beside the loop is longer than this.
_AWAITED_S = 0.6

# The watchdog process has made outputs safe by then; its own tests measure it with real processes.
_WATCHDOG_REACTS_S = 0.1

# By then enough sound frames have come for a run to be armed.
_ARMED_AT_S = 0.4

_NOISE = b"\xff\x00\r\n#\x80"


class TrialResult(Struct, frozen=True, kw_only=True):
    """What came of one sequence of faults.

    Attributes:
        violation: What did not hold; None for nothing.
        longest_s: By reason, for how long the wheels turned at most; see `watch`.
        driven: The fastest that a wheel or a servo turned.
        simulated_s: How long the trial was, in the robot's time.
    """

    sequence: FaultSequence
    violation: Violation | None
    longest_s: dict[str, float] = field(default_factory=dict)
    driven: float = 0.0
    simulated_s: float = 0.0


def run_trial(staged: StagedConfiguration, sequence: FaultSequence, journal: Path | None = None) -> TrialResult:
    """Run one trial, always with the same result.

    Args:
        journal: Where to write what the core saw and decided, for `replay`; None for nowhere.
    """
    trial = _Trial(staged, sequence)
    writer = None if journal is None else JournalWriter(journal, to_be_recorded(staged.configuration))
    try:
        if writer is not None:
            trial.loop.listeners.append(writer.write)
        trial.run()
    finally:
        if writer is not None:
            writer.close()
        trial.close()
    watch = trial.watch
    return TrialResult(
        sequence=sequence,
        violation=watch.violation,
        longest_s=watch.longest_s,
        driven=watch.driven,
        simulated_s=trial.clock.now_s(),
    )


class _WatchdogLink(WatchdogLink):
    """The run's end of a watchdog process that answers at once."""

    def _write(self, _words: str) -> None:
        self._answered = self._asked


class _Trial:
    """A run and its stage."""

    def __init__(self, staged: StagedConfiguration, sequence: FaultSequence) -> None:
        self.clock = StagedClock()
        self.watch = MotionWatch(limits=staged.limits)
        self._stage = Stage(clock=self.clock, watch=self.watch)
        self._staged = staged
        self._is_decided = self._is_stopped = self._is_end_due = self._is_killed = False
        self._bytes_sent = 0
        self._headings_rad: deque[tuple[float, float]] = deque(maxlen=_AVERAGED_LOOKS + 1)
        lasts_s = (LASTS_S[each.fault] for each in sequence)
        self._over_s = max(
            (
                each.at_s + (span_s if span_s < FOR_EVER_S else 0.0)
                for each, span_s in zip(sequence, lasts_s, strict=True)
            ),
            default=1.0,
        )
        self._end_s = self._over_s + AFTERWARDS_S
        parts: Any = build(staged.configuration, clock=self.clock)
        self._world, self._board = parts.world, self._emulated_board(staged, parts.shared)
        # The emulated board outlives the program.
        self._closers, parts.shared.closers = parts.shared.closers, []
        camera = parts.capture._camera
        camera.stage = self._stage
        parts.capture = parts.cycle.capture = StagedCapture(camera, self.clock)
        parts.cycle.perceiver = StagedEye(
            self._stage, staged.seen if sequence else staged.near or staged.seen, staged.hidden
        )
        if staged.limits.needs_arming:
            self._has_armed = False
            hand = SimpleNamespace(open=bool, close=bool, trouble=str, commands=self._arm_once)
            parts.buttons = {"arm": hand}
        self.loop = Loop(parts)
        self._watchdog = _WatchdogLink(staged.safe_lines, parts.outputs, staged.watchdog_s, None, lambda _line: None)
        self.loop.services.watchdog = self._watchdog
        self.loop.listeners.append(lambda record, _frame: self.watch.see_cycle(record))
        for each in sequence:
            self.clock.call_at(each.at_s, partial(self._begin, each.fault))
        self.clock.call_outside(_LOOK_EVERY_S, self._look)

    def run(self) -> None:
        """Run it until nothing can come any more."""
        with suppress(StagedDefectError):
            self.loop.run(Limits(seconds=self._end_s))
        if self.loop.troubles:  # an output could not be stopped: that is left to the watchdog process
            self.clock.call_at(self.clock.now_s() + _WATCHDOG_REACTS_S, self._make_safe)
        while not self._is_decided and self.clock.now_s() < self._end_s:  # what is beyond the program goes on
            self._stage.wait(_LOOK_EVERY_S)

    def close(self) -> None:
        """Let what ran beside the loop end, and give the emulated port back."""
        self._stage.active.clear()
        self._stage.wait(_AWAITED_S)
        for close in reversed(self._closers):
            close()

    def _emulated_board(self, staged: StagedConfiguration, shared: Any) -> Any:
        """Return the emulated board, made before the base asks for its port; None for a base without one."""
        if not staged.port:
            return None
        before = set(shared.parts)
        DriverContext(name=staged.base.name, clock=self.clock, shared=shared).port_path(staged.port)
        board = next(part for name, part in shared.parts.items() if name not in before)
        if staged.sketch_stops_s is not None:
            board.firmware.timeout_s = staged.sketch_stops_s
        return board

    def _arm_once(self) -> tuple[OperatorCommand, ...]:
        """Arm the run as soon as it can be armed, and never again."""
        if self._has_armed or self.clock.now_s() < _ARMED_AT_S:
            return ()
        self._has_armed = True
        return (OperatorCommand(id="arm", action=OperatorAction.ARM, by="prove", is_from_button=True),)

    def _begin(self, fault: str) -> None:
        self._stage.active[fault] += 1
        if LASTS_S[fault] < FOR_EVER_S:
            self.clock.call_at(self.clock.now_s() + LASTS_S[fault], partial(self._end, fault))
        self._turn_knobs()
        if fault == "reset-base":
            self._board.firmware.reset(LASTS_S[fault])
        elif fault in ("end-process", "kill-watchdog"):
            self._end_program()
        elif fault in STOPS_PROCESS:
            self._stop_program(LASTS_S[fault])

    def _end(self, fault: str) -> None:
        self._stage.active[fault] -= 1
        self._turn_knobs()

    def _turn_knobs(self) -> None:
        """Have the simulated world and the emulated board follow what is wrong."""
        is_on = self._stage.is_on
        is_out, is_deaf, is_silent = is_on(*UNPLUGS), is_on("deafen-base", "hold-bus"), is_on("silence-sensors")
        self._world.faults.base_unplugged, self._world.faults.broker_gone = is_out, is_on("lose-broker")
        self._world.faults.sensors_silent = is_silent
        if hasattr(self._board, "firmware"):
            self._board.firmware.silent, self._board.port.is_heard = is_deaf, not is_on("mute-base")
            self._board.port.spoil = self._flip_bits if is_on("flip-bits") else bytes
        elif self._board is not None:
            self._board.is_held = is_deaf
        self.watch.note_sensors(self.clock.now_s(), is_silent=is_silent)
        is_noisy = is_on("flip-bits")
        self.watch.note_cable(self.clock.now_s(), is_cut=is_out or is_deaf, is_out=is_out, is_noisy=is_noisy)

    def _flip_bits(self, sent: bytes) -> bytes:
        first, self._bytes_sent = self._bytes_sent, self._bytes_sent + len(sent)
        return bytes(b if at % 7 else b ^ 1 << at % 8 for at, b in enumerate(sent, first))

    def _end_program(self) -> None:
        """End the run, as a signal handler does, or stop it for good; that of a stopped process runs when it goes on.

        A stopped process whose watchdog process is gone is made safe by nothing but the base.
        """
        self._is_end_due = self._is_stopped
        if self._is_stopped and self._stage.is_on("kill-watchdog"):
            self.watch.note_program(self.clock.now_s(), math.inf)
        if self._is_stopped:
            return
        self.watch.note_end(self.clock.now_s())
        if self._stage.is_on("end-process"):
            self.loop.stop("ended, as staged")
        else:
            self._watchdog._lose("killed, as staged")

    def _stop_program(self, lasts_s: float) -> None:
        """Let time pass without the program: for a while, or to the end if it was killed."""
        was_stopped, self._is_stopped = self._is_stopped, True
        now_s = self.clock.now_s()
        self._is_killed |= lasts_s == FOR_EVER_S
        has_watchdog = bool(self._staged.safe_lines) and not self._stage.is_on("kill-watchdog")
        safe_s = (now_s if self._is_killed else self._hung_until_s()) + _WATCHDOG_REACTS_S if has_watchdog else math.inf
        if safe_s < now_s + lasts_s:
            self.clock.call_at(safe_s, self._make_safe)
        self.watch.note_program(now_s, safe_s)
        self.clock.stop_program(min(now_s + lasts_s, self._end_s), lambda: self._is_decided)
        if self._is_killed:
            self.clock.stop_program(self._end_s, lambda: self._is_decided)
        self._is_stopped = was_stopped
        if self._is_killed:
            self.loop.end("killed, as staged")
        elif not was_stopped:
            self.watch.note_program(self.clock.now_s(), None)
            if self._is_end_due:
                self._end_program()

    def _hung_until_s(self) -> float:
        """Return when the watchdog process kills a program that was stopped now; infinite for never."""
        acting_s = [since_s for each in self.loop.parts.outputs if (since_s := each.acts_since_s()) is not None]
        return min(acting_s, default=math.inf) + self._staged.watchdog_s

    def _make_safe(self) -> None:
        """Kill the program, and do to the base what the watchdog process does; nothing if that is gone."""
        if self._stage.is_on("kill-watchdog"):
            return
        self._is_killed = True
        for kind, where, *what in map(str.split, self._staged.safe_lines):
            if kind == "pin":
                pin = self._board.factory.pin(int(where))
                pin.frequency = None
                pin.state = float(what == ["high"])
            elif kind == "i2c":
                try:
                    for frame in what[-1].split(","):
                        self._board.write(bytes.fromhex(frame))
                except OSError:  # it tries again, for longer than any fault of a bus lasts that ends
                    again_s = self.clock.now_s() + TRIED_EVERY_S
                    self.watch.note_program(self.clock.now_s(), again_s)
                    self.clock.call_at(again_s, self._make_safe)
            elif self._stage.is_on(*UNPLUGS, "deafen-base", "flip-bits"):
                self.watch.note_stop_lost(self.clock.now_s())
            else:
                self._board.firmware.receive(bytes.fromhex(what[-1]), self.clock.now_s())

    def _rates_radps(self) -> tuple[float, float]:
        """Return how fast the camera was turned and tilted in the last tenth of a second."""
        self._headings_rad.append((self._world.robot.pose.heading_rad, self._world.tilt_joint.pose.heading_rad))
        begin, end = self._headings_rad[0], self._headings_rad[-1]
        for_s = _LOOK_EVERY_S * max(1, len(self._headings_rad) - 1)
        return (end[0] - begin[0]) / for_s, (end[1] - begin[1]) / for_s

    def _look(self, now_s: float) -> None:
        """Judge the wheels; end a trial that is decided."""
        if self._stage.is_on("garble-answers"):
            self._board.port.say(_NOISE)
        if self._is_decided or now_s > self._end_s:
            return
        watch = self.watch
        watch.see(now_s, self._world.robot.wheels_mps if watch.limits.parts == "wheels" else self._rates_radps())
        if self._is_killed or self._stage.is_on(*FINAL):  # nothing is left that could turn the wheels
            is_over = now_s >= self._over_s and now_s - watch.turned_s > _STANDS_S
        else:
            is_over = now_s > self._over_s and now_s - max(self._over_s, watch.moved_since_s) > _DRIVES_AGAIN_S
        self._is_decided = is_over or watch.violation is not None
        if self._is_decided:
            self.loop.end("decided, as staged")
