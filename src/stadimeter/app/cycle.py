"""One cycle of the control loop: look, measure, decide, act."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import TYPE_CHECKING, Protocol

import msgspec
from msgspec import Struct

from stadimeter.app.capture import Capture, SecondCapture
from stadimeter.app.guard import LeasedOutput
from stadimeter.app.range_reader import RangeReader
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Footing, Mounting
from stadimeter.core.clock import Clock
from stadimeter.core.command import BaseReport, Command, TwistCommand
from stadimeter.core.decide import State, decide
from stadimeter.core.decision import Decision
from stadimeter.core.detection import Detection, RejectedCandidate
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement, Track
from stadimeter.core.observation import FrameStamp, Observation, OutputFault, WallTime
from stadimeter.core.safety import FROM_THE_FUTURE_S
from stadimeter.detectors.protocol import Detector
from stadimeter.errors import DriverError
from stadimeter.operator_actions import AnyCommand
from stadimeter.perception.perceiver import Perceiver
from stadimeter.perception.picture_flow import FlowMeter

if TYPE_CHECKING:  # most runs have no tags of known places, and one camera
    from stadimeter.perception.prediction import CameraLocator
    from stadimeter.perception.second_camera import SecondView

# A cycle waits this long for a frame; without one it runs all the same, so that rules and safety see time pass.
FRAME_WAIT_S = 0.1


# A cycle that waits for a frame to become too old ends this long after that.
JUST_AFTER_S = 0.001


class _Stopwatch:
    """Splits one cycle into the times of its parts. It measures cost, so it runs on real time in a simulation too."""

    def __init__(self) -> None:
        self.laps_s: dict[str, float] = {}
        self._last_s = perf_counter()

    def lap(self, name: str) -> None:
        now_s = perf_counter()
        self.laps_s[name] = now_s - self._last_s
        self._last_s = now_s


class WatchesMounting(Protocol):
    """Knows whether the camera is still mounted as it was saved, as `MountingWatch` does."""

    mounting: Mounting

    def why_not_for_motion(self) -> str:
        """Return why nothing may move on the camera's frames, in words; empty if it may."""
        ...

    def trouble(self) -> str:
        """Return that distances are unconfirmed, in words; empty if they are not."""
        ...


@dataclass(slots=True, kw_only=True)
class Cycle:
    """The parts that one cycle of the loop needs.

    Attributes:
        capture: Where frames come from.
        detectors: One for each target, by the target's name.
        outputs: The outputs, in the order of the plan.
        max_frame_age_s: A frame older than this moves nothing.
        range_readers: The range sensors, each a target of its own.
        looking: Looks for the targets.
        footings: What is known of each target that is on the floor, by its name.
        flow_meter: Measures how the picture flows; None where liveness is not judged by motion.
        locator: Finds where the camera is; None without tags of known places.
        second: The frames of a second camera; None without one.
        second_view: Measures with it what the first one has found.
        mounting_watch: Watches whether the camera is still where it was; None without a saved view.
    """

    clock: Clock
    capture: Capture
    camera_model: CameraModel
    detectors: Mapping[str, Detector]
    outputs: Sequence[LeasedOutput]
    max_frame_age_s: float
    range_readers: Sequence[RangeReader] = ()
    footings: Mapping[str, Footing] = field(default_factory=dict)
    flow_meter: FlowMeter | None = None
    locator: CameraLocator | None = None
    second: SecondCapture | None = None
    second_view: SecondView | None = None
    mounting_watch: WatchesMounting | None = None
    _newest: Frame | None = field(default=None)
    perceiver: Perceiver = field(init=False)

    def __post_init__(self) -> None:
        """Look for the targets through the lens."""
        self.perceiver = Perceiver(self.detectors, self.camera_model, self.footings, self.second_view)

    def run(
        self,
        state: State,
        operator_commands: tuple[AnyCommand, ...] = (),
        wall: WallTime | None = None,
        undelivered_since_s: float | None = None,
    ) -> tuple[State, CycleRecord, Frame | None]:
        """Run one cycle.

        Args:
            wall: The local time of day, if a rule asks for it and it is known.
            undelivered_since_s: Since when an alarm could not be delivered; None for none.

        Returns:
            What it remembers now, the record of the cycle, and the frame that was new in it, if any.

        Raises:
            EndOfFramesError: A recording is at its end.
            PictureError: A recording is damaged.
            CalibrationError: The camera model does not fit the pictures.
        """
        watch = _Stopwatch()
        frame, camera_fault = self._next_frame()
        second = self.second.nearest(frame.captured_at_s) if frame and self.second else None
        watch.lap("capture")
        now_s = self.clock.now_s()
        tracks = {tracked.track.target: tracked.track for tracked in state.tracks}
        detections, measurements = self.perceiver.look(frame, tracks, second) if frame else ((), ())
        flow = self.flow_meter.measure(frame, self.perceiver.lens_of(frame)) if frame and self.flow_meter else None
        pose = self.locator.locate(frame, self.perceiver.lens_of(frame)) if frame and self.locator else None
        watch.lap("measure")
        watched = self.mounting_watch
        reports = {output.name: report for output in self.outputs if (report := output.report()) is not None}
        observation = Observation(
            now_s=now_s,
            frame=FrameStamp(sequence=frame.sequence, captured_at_s=frame.captured_at_s) if frame else None,
            measurements=(*measurements, *self._ranged()) if frame and self.range_readers else measurements,
            camera_fault=camera_fault,
            second_camera_fault=self.second.trouble() if self.second else "",
            not_for_motion=self.capture.not_for_motion() or (watched.why_not_for_motion() if watched else ""),
            output_faults=tuple(self._faults(reports)),
            flow=flow,
            base=next(iter(reports.values()), None),
            wall=wall,
            operator_commands=operator_commands,
            undelivered_since_s=undelivered_since_s,
            camera_pose=pose,
            mounting=watched.mounting if watched else None,
        )
        state, decision = decide(state, observation)
        watch.lap("decide")
        applied = self._applied(decision.commands)
        if frame and not observation.not_for_motion and now_s - frame.captured_at_s <= self.max_frame_age_s:
            self._show_targets(decision.tracks, frame.captured_at_s)
        watch.lap("apply")
        record = CycleRecord(
            observation=observation,
            applied=applied,
            timings_s=watch.laps_s,
            rejected={found.target: found.rejected for found in detections if found.rejected},
            detections=detections,
            decision=decision,
        )
        return state, record, frame

    def _ranged(self) -> Iterator[Measurement]:
        for reader in self.range_readers:
            if (measured := reader.measurement()) is not None:
                yield measured

    def _faults(self, reports: Mapping[str, BaseReport]) -> Iterator[OutputFault]:
        """Yield the outputs that may not act: their driver failed, or the base or a sensor says that it must not."""
        for output in self.outputs:
            report = reports.get(output.name)
            reason = output.observed_fault() or (report.why_not_drive if report is not None else "")
            if not reason and isinstance(output.safe, TwistCommand):
                reason = "; ".join(why for reader in self.range_readers if (why := reader.why_not_drive()))
            if reason:
                yield OutputFault(output=output.name, reason=reason)

    def _next_frame(self) -> tuple[Frame | None, str]:
        """Return the frame that is new, or None and the reason."""
        try:
            frame = self.capture.latest(self._wait_s())
        except DriverError as error:
            return None, str(error)
        if not frame.captured_at_s <= self.clock.now_s() + FROM_THE_FUTURE_S:
            return None, f"frame {frame.sequence} has a capture time that is no time of the past"
        before = self._newest
        if before is not None and frame.captured_at_s <= before.captured_at_s:
            return None, f"the camera repeats frame {frame.sequence}"
        self._newest = frame
        return frame, ""

    def _wait_s(self) -> float:
        """Return the time to wait for a frame: not beyond the moment at which the newest one becomes too old."""
        if self._newest is None:
            return FRAME_WAIT_S
        left_s = self._newest.captured_at_s + self.max_frame_age_s - self.clock.now_s()
        return min(FRAME_WAIT_S, left_s + JUST_AFTER_S) if left_s > 0 else FRAME_WAIT_S

    def _applied(self, commands: Sequence[Command]) -> tuple[Command, ...]:
        applied = (output.apply(command) for output, command in zip(self.outputs, commands, strict=True))
        return tuple(command for command in applied if command is not None)

    def _show_targets(self, tracks: Sequence[Track], captured_at_s: float) -> None:
        """Pass on what the new frame has shown, and nothing that is only predicted."""
        shown = [track for track in tracks if track.measured_at_s == captured_at_s]
        for output in self.outputs:
            output.show_targets(shown)


class CycleRecord(Struct, frozen=True, kw_only=True):
    """One cycle of the loop: what was known, what was decided, and what came of it.

    Attributes:
        observation: All that the core knew.
        applied: What the drivers applied, in the order of ``decision.commands``.
        timings_s: How long each part of the cycle took, in seconds: ``capture``, ``measure``, ``decide``, ``apply``.
        rejected: By target, what was looked at in the new frame and is not the target, the most like it first; only
            targets for which there is something. It explains, and decides nothing: it is in no journal.
        detections: Where each target is in the new frame, or why it is not there; empty without a frame. Likewise in
            no journal: it is drawn.
    """

    observation: Observation
    applied: tuple[Command, ...]
    timings_s: Mapping[str, float]
    rejected: Mapping[str, tuple[RejectedCandidate, ...]] = msgspec.field(default_factory=dict)
    detections: tuple[Detection, ...] = ()
    decision: Decision

    @property
    def mark(self) -> str:
        """The mark of distances, such as ``unconfirmed``; empty if they have none."""
        mounting = self.observation.mounting
        return mounting.status.value if mounting is not None and mounting.is_unconfirmed else ""

    @property
    def busy_s(self) -> float:
        """Time for which it was computed, without the wait for the frame."""
        return sum(self.timings_s.values()) - self.timings_s.get("capture", 0.0)
