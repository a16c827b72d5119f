"""How the loop gets its frames: from a thread for a live camera, directly from a recording."""

from __future__ import annotations

import threading
from typing import Protocol

from stadimeter.app.capture_thread import CaptureThread, Wait
from stadimeter.app.freeze import FreezeDetector
from stadimeter.cameras.protocol import Camera
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Frame
from stadimeter.errors import CaptureTimeoutError, DeviceClosedError


class Capture(Protocol):
    """Where the loop gets its frames."""

    def open(self) -> None:
        """Open the camera.

        Raises:
            DeviceOpenError: It is absent, busy, or not ours to open.
            PictureError: A recording cannot be read.
        """
        ...

    def latest(self, timeout_s: float) -> Frame:
        """Return the newest frame that was not returned before; wait for one if there is none.

        Args:
            timeout_s: How long to wait for a live camera, in real seconds. A recording takes the time it takes.

        Raises:
            CaptureTimeoutError: None came; the message says why. Asking again may help.
            DeviceClosedError: The camera is not open.
            EndOfFramesError: A recording is at its end.
            PictureError: A recording is damaged at this point.
        """
        ...

    def trouble(self) -> str:
        """Return what is wrong with the camera at present, in words, or an empty string."""
        ...

    def remarks(self) -> tuple[str, ...]:
        """Return what the user should know of the camera as it was opened, a sentence each."""
        ...

    def not_for_motion(self) -> str:
        """Return why nothing may move on the camera's frames, in a sentence, or an empty string."""
        ...

    def close(self) -> None:
        """Close the camera. May be called at any time, any number of times."""
        ...


class LiveCapture:
    """Reads a live camera in a thread; the newest frame wins.

    A camera that fails or freezes is opened again without being asked for, as `CaptureThread` describes; meanwhile
    `latest` raises and `trouble` tells.

    Args:
        freeze: Tells new pictures from repeated ones; None for one with the usual limits.
        wait: Waits for an event, like ``threading.Event.wait``; another one is for tests.
    """

    def __init__(
        self, camera: Camera, clock: Clock, *, freeze: FreezeDetector | None = None, wait: Wait = threading.Event.wait
    ) -> None:
        self._camera = camera
        self._clock = clock
        self._freeze = freeze or FreezeDetector()
        self._wait = wait
        self._thread: CaptureThread | None = None

    @property
    def passed_over(self) -> int:
        """How many frames gave way to newer ones since the camera was opened."""
        return self._thread.mailbox.passed_over if self._thread else 0

    def open(self) -> None:
        """Open the camera in the caller's thread, so that one that is missing is noticed at once, and start reading.

        Raises:
            DeviceOpenError: It is absent, busy, or not ours to open.
        """
        self.close()
        self._camera.open()
        self._thread = CaptureThread(self._camera, self._clock, self._freeze, self._wait)
        self._thread.start()

    def latest(self, timeout_s: float) -> Frame:
        """Return the newest frame that was not returned before; see `Capture`.

        An error that is no trouble of the camera, such as a mistake in its driver, is raised as it is.

        Args:
            timeout_s: How long to wait, in real seconds.

        Raises:
            CaptureTimeoutError: None came; the message says why.
            DeviceClosedError: The camera is not open, or was closed meanwhile.
        """
        thread = self._thread
        frame = thread.mailbox.take(timeout_s) if thread else None
        if frame:
            return frame
        if thread and thread.failure:
            raise thread.failure
        if thread is None or thread is not self._thread:
            raise DeviceClosedError("the camera is not open; open it before asking for frames")
        raise CaptureTimeoutError(thread.trouble() or f"no new frame in {timeout_s:.2f} s")

    def trouble(self) -> str:
        """Return what is wrong with the camera at present, in words, or an empty string."""
        thread = self._thread
        if thread is None:
            return "the camera is not open"
        return f"the camera's driver failed: {thread.failure}" if thread.failure else thread.trouble()

    def remarks(self) -> tuple[str, ...]:
        """Return what the user should know of the camera as it was opened, a sentence each."""
        return self._camera.remarks

    def not_for_motion(self) -> str:
        """Return why nothing may move on the camera's frames, in a sentence, or an empty string."""
        return self._camera.not_for_motion

    def close(self) -> None:
        """Stop reading and close the camera.

        The wait is bounded. If the camera's driver neither delivers nor gives up, this returns after about two seconds
        and leaves the thread behind; it is a daemon, so it does not keep the program alive.
        """
        thread, self._thread = self._thread, None
        if thread:
            thread.stop()


class DirectCapture:
    """Reads a recording or a simulation in the caller's thread: every frame counts."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera

    def open(self) -> None:
        """Open the camera; see `Capture`."""
        self._camera.open()

    def latest(self, timeout_s: float) -> Frame:  # noqa: ARG002 - a recording takes the time it takes
        """Return the next frame; see `Capture`."""
        return self._camera.read()

    def trouble(self) -> str:
        """Return an empty string: what goes wrong is raised by `latest`."""
        return ""

    def remarks(self) -> tuple[str, ...]:
        """Return what the user should know of the camera as it was opened, a sentence each."""
        return self._camera.remarks

    def not_for_motion(self) -> str:
        """Return why nothing may move on the camera's frames, in a sentence, or an empty string."""
        return self._camera.not_for_motion

    def close(self) -> None:
        """Close the camera; see `Capture`."""
        self._camera.close()


def capture_for(camera: Camera, clock: Clock) -> Capture:
    """Return the way to get frames from a camera.

    Returns:
        A `LiveCapture` for a live camera, a `DirectCapture` for another.
    """
    return LiveCapture(camera, clock) if camera.is_live else DirectCapture(camera)
