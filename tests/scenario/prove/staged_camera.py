"""A live camera on a stepped clock, whose pictures say when they were taken, and the eye that reads them.

No picture is drawn and no detector runs: a picture holds the time of its exposure and whether the target shows, and the
target is always as far ahead, as if it led the robot on. Capture thread, freeze detector and all behind them are real.
"""

from __future__ import annotations

import math
import struct
from collections import Counter, deque
from collections.abc import Callable, Mapping

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from scenario.prove.faults import SPOILS_FRAMES
from scenario.prove.watch import MotionWatch
from stadimeter.app.capture import CaptureThread, FreezeDetector, LiveCapture
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Frame, Image
from stadimeter.core.measurement import Measurement, Track
from stadimeter.errors import CaptureTimeoutError, DeviceClosedError, DeviceOpenError, LinkLostError
from stadimeter.workbench.rule_tests import SyntheticTrack

PERIOD_S = 1 / 30

_TIMES_OUT_AFTER_S = 0.1
_SLOW_PERIOD_S = 1 / 3
_LATE_S = 0.6
_FUTURE_S = 5.0
_CYCLED_PICTURES = 45
_SLOW_LOOK_S = 0.15
_STEP_S = 0.02

# How late a loop that waits for a frame notices it: a thread that is woken on a busy computer takes as long.
_NOTICED_WITHIN_S = 0.005

# Small, since no detector looks at them; their noise is what tells one exposure from the next.
_SHAPE = (48, 64, 3)
_STAMP = struct.Struct("<d?")


class StagedDefectError(RuntimeError):
    """The error of a control loop that fails as staged. It is none of the program's own errors."""


class Stage(Struct):
    """What is wrong now in a trial, and who judges it.

    Attributes:
        active: How many times each fault is there.
        sound_frames: The numbers of the frames that are new pictures with a sound stamp.
    """

    clock: Clock
    watch: MotionWatch
    active: Counter[str] = field(default_factory=Counter)
    sound_frames: set[int] = field(default_factory=set)

    def is_on(self, *faults: str) -> bool:
        """Return whether one of these faults is there now."""
        return any(self.active[fault] for fault in faults)

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.clock.sleep_until_s(self.clock.now_s() + seconds)


class StagedCameraOptions(DriverOptions):
    """The options of the camera of a proof; no configuration names it."""

    def build(self, context: DriverContext) -> StagedCamera:
        """Return the camera."""
        return StagedCamera(context.clock)


class StagedCamera:
    """A camera that goes wrong as its `stage`, which must be set before it is opened, says."""

    is_live = False  # so that a run on it is built on the stepped clock
    remarks: tuple[str, ...] = ()
    not_for_motion = ""
    stage: Stage

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._is_open = False
        self._sequence = 0
        self._newest: Frame | None = None
        self._pictures: deque[Image] = deque(maxlen=_CYCLED_PICTURES)
        self._noise = np.random.default_rng(1).integers(20, 236, (2 * _SHAPE[0], *_SHAPE[1:]), np.uint8)

    def open(self) -> None:
        """Begin to deliver; a `DeviceOpenError` while the camera is gone."""
        if self.stage.is_on("lose-camera"):
            raise DeviceOpenError("the staged camera is gone")
        self._is_open = True

    def close(self) -> None:
        """Be closed. May be called any number of times."""
        self._is_open = False

    def read(self) -> Frame:
        """Wait for the next frame and return it, or what the present fault makes of it."""
        stage = self.stage
        if not self._is_open:
            raise DeviceClosedError("the staged camera is not open")
        stage.wait(_SLOW_PERIOD_S if stage.is_on("slow-camera") else PERIOD_S)
        while stage.is_on("hang-camera"):
            stage.wait(_STEP_S)
        if stage.is_on("lose-camera"):
            raise LinkLostError("the staged camera is gone")
        if stage.is_on("block-camera"):
            stage.wait(_TIMES_OUT_AFTER_S)
            raise CaptureTimeoutError("the staged camera gives no frame")
        self._sequence += 1
        now_s = self._clock.now_s()
        if self._newest is not None and stage.is_on(*SPOILS_FRAMES):
            return self._spoilt_frame(self._newest, now_s)
        self._newest = Frame(self._picture(now_s), now_s, self._sequence)
        stage.sound_frames.add(self._sequence)
        return self._newest

    def _spoilt_frame(self, newest: Frame, now_s: float) -> Frame:
        """Return an old picture, or a new one with a stamp that is wrong. Several faults at once add up."""
        is_on = self.stage.is_on
        if is_on("repeat-frame"):
            return newest
        taken_s = stamp_s = now_s - _LATE_S if is_on("late-frames") else now_s
        if is_on("freeze-picture"):
            picture = newest.image
        elif is_on("cycle-pictures"):
            picture = self._pictures[self._sequence % len(self._pictures)]
        else:
            picture = self._picture(taken_s)
        if is_on("stand-still-stamps"):
            stamp_s = newest.captured_at_s
        if is_on("future-stamps"):
            stamp_s = now_s + _FUTURE_S
        return Frame(picture, math.nan if is_on("broken-stamps") else stamp_s, self._sequence)

    def _picture(self, taken_s: float) -> Image:
        first = self._sequence * 7 % _SHAPE[0]
        picture = self._noise[first : first + _SHAPE[0]].copy()
        stamp = _STAMP.pack(taken_s, self.stage.is_on("hide-target"))
        picture.reshape(-1)[: _STAMP.size] = np.frombuffer(stamp, np.uint8)
        self._pictures.append(picture)
        return picture


class StagedCapture(LiveCapture):
    """The capture of a live camera, whose thread runs on a stepped clock."""

    def _start(self, failed: str = "") -> None:
        self._thread = _SteppedThread(self._camera, self._clock, FreezeDetector(), self._wait_on_clock)
        self._thread.start(failed)

    def _wait_on_clock(self, _stopped: object, seconds: float) -> bool:
        self._clock.sleep_until_s(self._clock.now_s() + seconds)
        return False

    def latest(self, timeout_s: float) -> Frame:
        """Let time pass until there is a frame, or the time is over; then do as any live capture."""
        until_s, thread = self._clock.now_s() + timeout_s, self._thread
        while isinstance(thread, _SteppedThread) and thread.is_waiting and self._clock.now_s() < until_s:
            self._clock.sleep_until_s(min(until_s, self._clock.now_s() + _NOTICED_WITHIN_S))
        # A process that goes on after a stop may find a new frame before it knows how late it is: let that come first.
        self._clock.sleep_until_s(self._clock.now_s())
        return super().latest(0.0)


class _SteppedThread(CaptureThread):
    """A capture thread that runs beside others on a stepped clock."""

    _end: Callable[[], None] = staticmethod(lambda: None)

    @property
    def is_waiting(self) -> bool:
        """Whether there is nothing for the loop yet."""
        return self.mailbox._frame is None and self.failure is None

    def start(self, failed: str = "") -> None:
        self._freeze.restart(self._clock.now_s())
        self._failed = failed
        self._end = self._clock.run_beside(self._run)

    def stop(self) -> None:
        self._stopped.set()
        self.mailbox.close()
        self._camera.close()
        self._end()


class StagedEye(Struct):
    """Measures targets in staged pictures, in place of detectors: exactly, and as sure as is to be expected.

    Attributes:
        seen: The measurements of each target in a picture that shows the target which is followed.
        hidden: Those in a picture that does not.
    """

    stage: Stage
    seen: tuple[SyntheticTrack, ...]
    hidden: tuple[SyntheticTrack, ...]

    def look(
        self, frame: Frame, _tracks: Mapping[str, Track], _second: Frame | None = None
    ) -> tuple[tuple[()], tuple[Measurement, ...]]:
        """Return no outlines, and a measurement of each target."""
        stage, looked_s = self.stage, self.stage.clock.now_s()
        if stage.is_on("fail-in-loop"):
            stage.watch.note_end(looked_s)
            raise StagedDefectError("a staged defect in the control loop")
        if stage.is_on("slow-loop"):
            stage.wait(_SLOW_LOOK_S)
        while stage.is_on("hang-loop"):
            stage.wait(_STEP_S)
        taken_s, is_hidden = _STAMP.unpack(frame.image.reshape(-1)[: _STAMP.size].tobytes())
        is_broken = stage.is_on("break-distance")
        if frame.sequence in stage.sound_frames:
            stage.watch.note_fresh_frame(taken_s, looked_s, shows_target=not is_hidden and not is_broken)
        measured = tuple(each.measure(frame.captured_at_s) for each in (self.hidden if is_hidden else self.seen))
        return (), tuple(replace(each, distance_m=math.nan) for each in measured) if is_broken else measured
