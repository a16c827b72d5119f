"""The parts that live camera drivers share: one thread at a time in the vendor's code, and a `close` that returns."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from stadimeter.core.frame import Frame, Image, Optics, SensorBoxes, Subsampling
from stadimeter.errors import CaptureTimeoutError, DeviceClosedError, DeviceHungError, DriverError

# Time that `LiveCamera.close` waits for a read to end, and a driver for its device to be let go.
CLOSE_WAIT_S = 1.5


class CapturedPicture(NamedTuple):
    """A picture, when it was captured on the run's clock, and what else is known: exposure, and a network's boxes."""

    image: Image
    captured_at_s: float
    exposure_s: float | None = None
    boxes: SensorBoxes | None = None


class LiveCamera(ABC):
    """A live camera of which no two threads may use the vendor's code at a time.

    A `close` during a `read` in another thread breaks it off, or lets it end, which the read time-out bounds. If it
    does not end, `close` returns after `CLOSE_WAIT_S`, and the reading thread releases the device as soon as it can.
    Until then the device is taken, by this process: another handle to it would not open, so there is none.

    Args:
        name: The camera's name in messages.
    """

    is_live = True  # old frames are worthless

    def __init__(self, name: str) -> None:
        self._name = name
        self._lock = threading.Lock()
        self._is_closed = True
        self._delivered = 0
        self.remarks: tuple[str, ...] = ()  # settings that were not taken when it was last opened, a sentence each
        self.not_for_motion = ""  # why nothing may move on its frames; empty if it knows when it captured each
        self._subsampling: Subsampling = "4:4:4"
        self._optics: Optics | None = None

    def open(self) -> None:
        """Open the camera with its settings and wait for the first picture.

        Raises:
            DeviceHungError: It was not let go after it was used before.
            DeviceOpenError: It is absent or busy, this user may not open it, or it gives no picture.
            DriverUnavailableError: A library that it needs is missing.
        """
        self.close()
        with self._alone(DeviceHungError):
            self._is_closed = False
            try:
                self.remarks = self._acquire()
            except BaseException:
                self._is_closed = True
                raise

    def read(self) -> Frame:
        """Wait for the next frame and return it.

        Raises:
            CaptureTimeoutError: No whole picture came within the read time-out.
            DeviceClosedError: The camera is not open, or was closed meanwhile.
            LinkLostError: The device is gone, or has failed.
        """
        with self._alone(CaptureTimeoutError):
            if self._is_closed:
                raise self._not_open()
            picture = self._next()
            self._check_open()
        self._delivered += 1
        return Frame(
            picture.image,
            picture.captured_at_s,
            self._delivered - 1,
            subsampling=self._subsampling,
            optics=self._optics,
            exposure_s=picture.exposure_s,
            boxes=picture.boxes,
        )

    def close(self) -> None:
        """Release the device; wait for a read in another thread to end, for at most `CLOSE_WAIT_S`."""
        self._is_closed = True
        self._break_off()
        if self._lock.acquire(timeout=CLOSE_WAIT_S):
            try:
                self._release()
            finally:
                self._lock.release()

    @contextmanager
    def _alone(self, busy: type[DriverError]) -> Iterator[None]:
        if not self._lock.acquire(timeout=CLOSE_WAIT_S):
            raise busy(f"the camera {self._name} is still busy with a read that does not end")
        try:
            yield
        finally:
            if self._is_closed:
                self._release()
            self._lock.release()

    def _not_open(self) -> DeviceClosedError:
        return DeviceClosedError(f"the camera {self._name} is not open; open it before reading from it")

    def _check_open(self) -> None:
        if self._is_closed:
            raise DeviceClosedError(f"the camera {self._name} was closed while a frame was awaited")

    @abstractmethod
    def _acquire(self) -> tuple[str, ...]:
        """Open the device, apply the settings, wait for a picture; return a sentence on each setting not taken."""

    @abstractmethod
    def _next(self) -> CapturedPicture:
        """Wait for the next picture; give up when the camera is closed meanwhile (`_check_open`)."""

    @abstractmethod
    def _release(self) -> None:
        """Let the device go, if it is held."""

    def _break_off(self) -> None:  # noqa: B027 - most can only wait
        """End a `_next` in another thread, where that can be done."""
