"""All that the core may know in one cycle."""

from __future__ import annotations

from msgspec import Struct

from stadimeter.core.camera_pose import CameraPose, Mounting
from stadimeter.core.command import BaseReport
from stadimeter.core.measurement import Measurement
from stadimeter.operator_actions import AnyCommand


class FlowSince(Struct, frozen=True, kw_only=True):
    """Distance that the blocks of a picture have moved sideways since an earlier one, in pixels of a reduced picture.

    Attributes:
        since_s: The capture time of the earlier picture.
        step_s: The time from the picture before to this one.
        focal_px: The focal length at the reduced width.
        aside_px: How far the blocks with texture are from the optical axis sideways, as a median.
        blocks: How many blocks have texture: only of these can be said whether they moved.
        shift2_px2: The square of the shift, as a median over the blocks with texture. Noise that is new in each picture
            adds nothing to it, so it may be below 0 for a picture that stands still.
        sigma_px2: Standard deviation of that median, from how the blocks scatter.
        is_slid: Whether the earlier picture was slid over this one first, so that no turn of the camera is left in it.
    """

    since_s: float
    step_s: float
    focal_px: float
    aside_px: float
    blocks: int
    shift2_px2: float
    sigma_px2: float
    is_slid: bool = False


class PictureFlow(Struct, frozen=True, kw_only=True):
    """Motion as a picture shows it.

    Attributes:
        textured: The share of its blocks that have texture, 0 to 1.
        since: Its flow since earlier pictures; empty while there are none.
        again: Its flow since the pictures of long ago that look most like it; here of three blocks in four, in place of
            the median.
    """

    textured: float
    since: tuple[FlowSince, ...] = ()
    again: tuple[FlowSince, ...] = ()


class FrameStamp(Struct, frozen=True, kw_only=True):
    """The core's knowledge of a frame: not its pixels.

    Attributes:
        captured_at_s: When it was taken, on the run's monotonic clock.
    """

    sequence: int
    captured_at_s: float


# Stands in events for the second camera.
SECOND_CAMERA = "second camera"


class OutputFault(Struct, frozen=True, kw_only=True):
    """An output whose driver failed.

    Attributes:
        reason: The driver's words.
    """

    output: str
    reason: str


class MonthDay(Struct, frozen=True, order=True):
    """A day of every year, the month from 1."""

    month: int
    day: int


class WallTime(Struct, frozen=True, kw_only=True):
    """The local time of day. Schedules go by it, and nothing else does.

    Attributes:
        second_of_day: Seconds since midnight.
        weekday: 0 for Monday.
        dates: Yesterday, today and tomorrow; empty where they are not known.
        sunrise_s: When the sun rises on that day, in seconds since its midnight: −∞ if it was up already, ∞ if it does
            not rise. None where no rule asks for it.
        sunset_s: The same of when it sets: −∞ if it is down already, ∞ if it does not set.
    """

    second_of_day: float
    weekday: int
    dates: tuple[MonthDay, ...] = ()
    sunrise_s: float | None = None
    sunset_s: float | None = None


class Observation(Struct, frozen=True, kw_only=True):
    """All that the core may know in one cycle.

    Attributes:
        now_s: The run's monotonic clock, read once for the cycle.
        frame: The frame that is new in this cycle, or None if none came.
        measurements: One for each target that was looked for in that frame; empty without a frame.
        camera_fault: Why there is no frame, or an empty string.
        second_camera_fault: Why the second camera gives no frames, or an empty string; the first one goes on alone.
        not_for_motion: Why nothing may move on the camera's frames, such as an unknown age; empty if it may.
        output_faults: The outputs that are out of order at the start of the cycle.
        flow: How far the picture has moved since earlier ones; None without a frame, and where liveness is not judged.
        base: What the robot base reported last; None without a base, and for one that reports nothing.
        disarm_reason: Why the run must be armed anew before anything acts, found outside the core in this cycle; empty
            for nothing.
        wall: The time of day, if a rule asks for it; None also while the clock is not synchronised.
        operator_commands: Operator commands since the cycle before.
        undelivered_since_s: Since when this run has had an alarm that it could not deliver, the oldest; None for none.
        camera_pose: Where the camera is; None without a frame, and where no tags of known places are configured.
        mounting: Whether the camera is still mounted as it was saved; None where that is not watched.
    """

    now_s: float
    frame: FrameStamp | None = None
    measurements: tuple[Measurement, ...] = ()
    camera_fault: str = ""
    second_camera_fault: str = ""
    not_for_motion: str = ""
    output_faults: tuple[OutputFault, ...] = ()
    flow: PictureFlow | None = None
    base: BaseReport | None = None
    disarm_reason: str = ""
    wall: WallTime | None = None
    operator_commands: tuple[AnyCommand, ...] = ()
    undelivered_since_s: float | None = None
    camera_pose: CameraPose | None = None
    mounting: Mounting | None = None

    @property
    def faults(self) -> tuple[OutputFault, ...]:
        """The faults of the outputs, and of the second camera."""
        if not self.second_camera_fault:
            return self.output_faults
        return (*self.output_faults, OutputFault(output=SECOND_CAMERA, reason=self.second_camera_fault))
