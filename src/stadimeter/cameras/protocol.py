"""The interface of cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

from msgspec import Struct

from stadimeter.core.frame import Frame


class CameraMode(Struct, frozen=True, kw_only=True):
    """One way in which a camera can send pictures.

    Attributes:
        fourcc: The pixel format, such as ``MJPG``.
        rates_hz: The frame rates, the highest first; empty where the camera does not say.
    """

    fourcc: str
    width_px: int
    height_px: int
    rates_hz: tuple[float, ...] = ()


class AttachedCamera(Struct, frozen=True, kw_only=True):
    """A camera that a driver finds on this computer.

    Attributes:
        driver: The name of the driver's entry point, such as ``opencv``.
        options: The options that mean this camera and none other, such as its ``device``; None for those that would
            mean another one beside it.
        path: The path that stays right when cameras change places or the computer starts anew.
        name: The name that it gives itself.
        node: The present name of its device, such as ``/dev/video0``.
        modes: How it can send pictures; empty where it does not say.
        trouble: Why it cannot be opened, in a sentence; empty where nothing is known to be wrong.
    """

    driver: str
    options: Mapping[str, str | None]
    path: str
    name: str
    node: str
    modes: tuple[CameraMode, ...] = ()
    trouble: str = ""

    @property
    def choice(self) -> str:
        """The camera as ``--live`` takes it, such as ``opencv,device=/dev/v4l/by-id/…``."""
        return ",".join((self.driver, *(f"{key}={value}" for key, value in self.options.items() if value is not None)))


class Camera(Protocol):
    """A source of frames.

    The constructor touches no hardware: `open` does. `close` may be called at any time, any number of times. The app
    runs `read` of a live camera in a thread of its own, hands on the newest frame, notices when no fresh frame comes,
    and then calls `close` and `open` again; a driver needs to do none of that.
    """

    @property
    def is_live(self) -> bool:
        """True if frames come at their own pace and old ones are worthless.

        True for hardware and streams: frames that were not fetched in time are passed over. False for recordings and
        simulations: every frame counts, and the loop reads them in its own thread.
        """

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks for the user since it was opened, a sentence each: settings that the device did not take."""

    @property
    def not_for_motion(self) -> str:
        """The reason why nothing may move on its frames, in a sentence that says what to write into the configuration.

        Empty if something may, as for a device that knows when it captured a frame. Not empty for frames of unknown
        age, and for pictures in which old parts may look new. It may be asked for at any time, also before `open`.
        """

    def open(self) -> None:
        """Acquire the device and apply its settings.

        Raises:
            DeviceOpenError: It is absent, busy, or this user may not open it.
            PictureError: A recording cannot be read.
        """

    def read(self) -> Frame:
        """Wait for the next frame and return it.

        A frame's capture time is when its light was caught, or earlier, never later: whatever delays a frame counts
        into its age. Frames that a driver knows to be damaged, or to have waited on the way, are passed over. Capture
        times never go back and sequence numbers always rise. A camera that is not live calls
        ``clock.sleep_until_s`` with the frame's time before it returns, so that time passes as it did in the recording.

        Returns:
            A frame whose image is not changed afterwards.

        Raises:
            CaptureTimeoutError: No frame came in the driver's own time limit. Reading may be tried again.
            DeviceClosedError: The camera is not open.
            EndOfFramesError: A recording is at its end.
            LinkLostError: The device is gone; only opening it again can help.
            PictureError: A recording is damaged at this point.
        """

    def close(self) -> None:
        """Release the device. A `read` that waits in another thread ends with an error."""


@runtime_checkable
class ShowsOwnMotion(Protocol):
    """A camera that is not live, and whose pictures may show all the same how the base drives that carries it."""

    @property
    def shows_own_motion(self) -> bool:
        """True if they do. A live camera is taken to show it."""


@runtime_checkable
class ShowsFiles(Protocol):
    """A camera that shows picture files, any of which may be looked at by itself."""

    def files(self) -> Sequence[Path]:
        """Return the files in the order in which they are shown.

        Raises:
            PictureError: One of them is not there.
        """


@runtime_checkable
class ListsCameras(Protocol):
    """A driver that can list the cameras on this computer; a part of its `DriverOptions`."""

    @staticmethod
    def attached() -> tuple[AttachedCamera, ...]:
        """Return them, without taking pictures."""
