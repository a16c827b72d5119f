"""Base of cameras that play a recording: time passes as the recording says."""

from __future__ import annotations

from abc import ABC, abstractmethod

from stadimeter.core.clock import Clock
from stadimeter.core.frame import Frame, Image, Optics, Subsampling
from stadimeter.errors import DeviceClosedError, EndOfFramesError


class RecordedCamera(ABC):
    """A camera that plays a recording, at a steady rate unless it knows the time of each frame.

    The recording starts when the first frame is read: frame ``i`` was captured at ``start + i / rate``. Opening the
    camera again plays it from the beginning, at later times and with sequence numbers that go on.

    Args:
        what: The recording in a word or two, for error messages.
        loops: Whether it begins again after its last frame, while time goes on.
    """

    is_live = False  # every frame of a recording counts
    remarks: tuple[str, ...] = ()  # there is no device that could refuse a setting
    not_for_motion = ""  # the capture times are those of the recording

    def __init__(self, what: str, clock: Clock, *, loops: bool = False) -> None:
        self._what = what
        self._clock = clock
        self._loops = loops
        self._has_frames = False
        self._rate_hz: float | None = None
        self._started_at_s: float | None = None
        self._index = 0
        self._played_s: float | None = None
        self._delivered = 0
        self._subsampling: Subsampling = "4:4:4"
        self._optics: Optics | None = None

    def open(self) -> None:
        """Find the recording and go to its beginning.

        Raises:
            PictureError: It cannot be read.
        """
        self.close()
        self._played_s = None
        self._rate_hz = self._begin()
        self._started_at_s = None
        self._index = 0
        self._has_frames = False

    def read(self) -> Frame:
        """Wait until the next frame is due and return it.

        A frame that cannot be read raises once and is then passed over: the next call returns the one after it.

        Raises:
            DeviceClosedError: The camera is not open.
            EndOfFramesError: There are no more frames.
            PictureError: The recording is damaged at this point.
        """
        if self._rate_hz is None:
            raise DeviceClosedError(f"{self._what}: the camera is not open; open it before reading from it")
        if self._started_at_s is None:
            self._started_at_s = self._clock.now_s()
        steady_s = self._index / self._rate_hz
        self._index += 1
        image, source = self._next_or_first()
        self._has_frames = True
        captured_at_s = self._started_at_s + (steady_s if self._played_s is None else self._played_s)
        self._clock.sleep_until_s(captured_at_s)
        self._delivered += 1
        return Frame(image, captured_at_s, self._delivered - 1, source, self._subsampling, self._optics)

    def _next_or_first(self) -> tuple[Image, str]:
        try:
            return self._next()
        except EndOfFramesError:
            if not (self._loops and self._has_frames):  # one without a whole frame would be read for ever
                raise
        self._has_frames = False
        self._end()
        self._begin()
        return self._next()

    def close(self) -> None:
        """Let go of the recording."""
        self._rate_hz = None
        self._end()

    @abstractmethod
    def _begin(self) -> float:
        """Open the recording and return its frame rate in hertz."""

    @abstractmethod
    def _next(self) -> tuple[Image, str]:
        """Return the next picture and where it came from; note in ``_played_s`` when it comes, if that is known."""

    @abstractmethod
    def _end(self) -> None:
        """Close the recording, if it is open."""
