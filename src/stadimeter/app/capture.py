"""Frames for the loop: from a thread and a mailbox of one for a live camera, directly from a recording."""

from __future__ import annotations

import math
import threading
import zlib
from collections import deque
from collections.abc import Callable
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.cameras.protocol import Camera
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Frame, Image, SeenPictures
from stadimeter.core.safety import FROM_THE_FUTURE_S
from stadimeter.errors import CaptureTimeoutError, DeviceClosedError, DeviceHungError, DriverError, PictureError

# Noticing a camera that delivers the same picture, old ones in turn, or parts of an old one -------


Kind = TypeVar("Kind", bound=np.generic)

FROZEN_AFTER_S = 1.0

# One of this many rows is hashed: 0.04 ms at 640 × 480 and 0.3 ms at 1920 × 1080, a seventh of all rows.
HASHED_ROWS = 8

# A run of this many pixels in a row, one MCU of a JPEG, is what either changes or does not.
BANDS = 32
RUN_PX = 16

# A run is evidence if its grey levels differ by this and none is near black or white, where noise is cut off.
CONTRAST = 12
UNCLIPPED = (8, 247)
RUNS_EQUAL = 20
RUNS_COMPARED = 10
CHANGED = 0.5

# The share of such runs that change by noise alone is known after this many still pictures, and from the last so many.
STILL_NEEDED = 15
STILL_REMEMBERED = 150
LEARN_EVERY = 4

# Fewer runs say nothing. In a still picture less than this part of them changes by more than so many grey levels: noise
# of 2 changes by up to 16, a JPEG of quality 30 by up to 24; a scene that moves by a pixel changes by more.
NOISE_RUNS = 60
MOVED_RUNS = 0.2
MOVED = 24

# A camera whose noise changes less of a still picture than this is not judged, such as most video codecs.
MIN_NOISE = 0.2

# Noise is missing where less than this part of the least share so far has changed. Shares of a still scene stay within
# a fifth of their mean; the digits of a clock are a tenth of it at most.
MISSING = 0.3


class FreezeDetector:
    """Tells new pictures from repeated ones.

    The noise of a sensor makes two exposures differ in some byte, so a picture that equals an earlier one, byte for
    byte, is that picture again: a driver or a stream that hangs repeats it at full rate, with fresh arrival times, and
    a driver that cycles through its buffers delivers a few old ones in turn. All pictures of some time before the
    newest are remembered by a hash, whatever their size (see `SeenPictures`). A capture time that does not advance
    shows the same. Robots that trusted such pictures drove into walls. A capture time from the future, or one that is
    no number, is not believed and not remembered: every later frame would look old beside it.

    A picture of which a part is old is not new either: see `has_stale_bands`. Nor is one that lacks the noise that this
    camera's pictures have, as under a clock that is drawn over a frozen picture: see `SensorNoise`.
    """

    def __init__(self, frozen_after_s: float = FROZEN_AFTER_S) -> None:
        self._frozen_after_s = frozen_after_s
        self._image: Image | None = None
        self._noise = SensorNoise()
        self._hash = 0
        self._seen = SeenPictures()
        self._captured_at_s = -math.inf
        self._changed_at_s = -math.inf
        self._what = ""

    def restart(self, now_s: float) -> None:
        """Give the camera its time again, after it was opened. The last pictures are remembered."""
        self._changed_at_s = now_s

    def is_new(self, frame: Frame, now_s: float) -> bool:
        """Check whether a frame shows what was not shown before, all over, and was captured later."""
        hashed = zlib.crc32(np.ascontiguousarray(frame.image[::HASHED_ROWS]).data, frame.image.shape[1])
        self._what = self._what_is_old(frame, now_s, hashed)
        self._seen.note(hashed, now_s)
        if self._what:
            return False
        self._image = frame.image
        self._hash = hashed
        self._captured_at_s = frame.captured_at_s
        self._changed_at_s = now_s
        return True

    def frozen(self, now_s: float) -> str:
        """Describe what has not changed since the last new picture or `restart`, and for how long; else ``""``."""
        unchanged_s = now_s - self._changed_at_s
        return f"{self._what} for {unchanged_s:.1f} s" if unchanged_s > self._frozen_after_s else ""

    def _what_is_old(self, frame: Frame, now_s: float, hashed: int) -> str:
        last = self._image if self._image is not None and self._image.shape == frame.image.shape else None
        # Small differences between the hashed rows tell a picture from the last one, which is there to compare.
        is_like_last = hashed == self._hash
        if last is not None and is_like_last:
            if np.array_equal(last, frame.image):
                return "the picture has not changed"
        elif hashed in self._seen:
            return "old pictures have come again in turn"
        if not self._captured_at_s < frame.captured_at_s <= now_s + FROM_THE_FUTURE_S:
            return "the picture's capture time has not advanced"
        if last is None or is_like_last:
            return ""
        same_rows = equal_first_rows(last, frame.image)
        if same_rows.any() and has_stale_bands(last, frame.image, same_rows):
            return "parts of the picture have not changed"
        is_missing = self._noise.is_missing(last, frame.image, is_suspect=bool(same_rows.any()))
        return "the picture has not changed but for a small part" if is_missing else ""


class SensorNoise:
    """Knows how much of a still picture noise changes, and notices where it is missing.

    Runs of pixels that noise would show in (see `_is_evidence`) change from one picture to the next in a share that
    hardly varies while camera and scene stand still: 0.4 to 1 for MJPEG of quality 30 to 90, 1 for pictures without
    compression. Where it falls to a fraction, the picture stands still but for what is drawn over it, as a clock. Only
    pictures that differ by noise alone are learnt from. Video codecs leave out what hardly changes, so their least
    share is near 0, and they are not judged. Nor is any camera while fewer than `STILL_NEEDED` still pictures came.

    A share that falls and rises again by itself is this camera's way, and learnt: a codec's key frames do that.
    """

    def __init__(self) -> None:
        self._shares: deque[float] = deque(maxlen=STILL_REMEMBERED)
        self._was_missing = False
        self._passed_over = 0

    def is_missing(self, last: Image, image: Image, *, is_suspect: bool) -> bool:
        """Check whether a picture lacks the noise that it would have beside ``last`` if it had been taken anew.

        Args:
            is_suspect: Whether anything in it is the same as before. If not, only one picture of `LEARN_EVERY` is
                looked at, to learn from.
        """
        self._passed_over += 1
        if not is_suspect and self._passed_over < LEARN_EVERY:
            return False
        self._passed_over = 0
        rows = 2 * math.ceil(image.shape[0] / BANDS)
        here, before = (picture[::rows, : image.shape[1] // RUN_PX * RUN_PX, 1] for picture in (image, last))
        evidence = _is_evidence(here)
        count = int(evidence.sum())
        if count < NOISE_RUNS:
            return False
        change = _runs(cv2.absdiff(np.ascontiguousarray(here), np.ascontiguousarray(before))).max(axis=2)[evidence]
        share = np.count_nonzero(change) / count
        if len(self._shares) >= STILL_NEEDED and (least := min(self._shares)) >= MIN_NOISE and share < MISSING * least:
            self._was_missing = True
            return True
        if np.count_nonzero(change > MOVED) < MOVED_RUNS * count:
            self._shares.append(0.0 if self._was_missing else share)
        self._was_missing = False
        return False


def equal_first_rows(last: Image, image: Image) -> NDArray[np.bool_]:
    """Return for each of `BANDS` bands of rows whether its first row is the same in both pictures."""
    rows = math.ceil(image.shape[0] / BANDS)
    same: NDArray[np.bool_] = (last[::rows] == image[::rows]).all(axis=(1, 2))
    return same


def has_stale_bands(last: Image, image: Image, same_rows: NDArray[np.bool_]) -> bool:
    """Check whether a part of a picture is that of the one before, while the rest was taken anew.

    A decoder that gets half a picture leaves the other half as it was in its buffer. A band of rows that stays the
    same to the last bit is a sign of it, but only a sign: 8 of 11 good pictures of a still scene have such a band at
    JPEG quality 30 (noise of 1 grey level, overexposed), and still scenes from video codecs have them all the time,
    since what hardly moves is not sent. So a band is stale only where noise would have shown:

    * Runs of pixels in it have contrast and are not clipped. A plain wall, black and white are no evidence.
    * Elsewhere in the same picture most such runs changed, so the noise is not quantised away.

    Measured on four real pictures at four exposures, with noise of 0.25 to 2 grey levels and JPEG quality 30 to 90:
    none of 1280 good pictures was refused; of still scenes by x264, 2 of 319, one at a time. Of pictures that kept 60 %
    or 30 % of the last one, 32 % were found at quality 30, 65 to 71 % at quality 50 and 81 to 88 % at quality 90; of
    those that kept 5 %, 5 to 18 %. The rest had no evidence in them, and the small rest of a picture has less of it.
    So this is a second line: where a picture can be checked as a whole before it is decoded, it is.

    Args:
        same_rows: What `equal_first_rows` tells. It tells nearly all new bands from old ones; the rest is compared.
    """
    width_px, rows = image.shape[1], math.ceil(image.shape[0] / BANDS)
    is_equal = same_rows.copy()
    for band in np.flatnonzero(is_equal):
        top = band * rows
        is_equal[band] = np.array_equal(last[top : top + rows], image[top : top + rows])
    if not is_equal.any() or is_equal.all():
        return False
    here, before = (picture[::HASHED_ROWS, : width_px // RUN_PX * RUN_PX] for picture in (image, last))
    changed, counts = _runs((here != before).any(axis=2)).any(axis=2), _is_evidence(here[:, :, 1])
    in_band = is_equal[np.arange(len(here)) * HASHED_ROWS // rows]
    equal, compared = counts & in_band[:, None], counts & ~in_band[:, None]
    compared_runs = int(compared.sum())
    return bool(
        equal.sum() >= RUNS_EQUAL
        and compared_runs >= RUNS_COMPARED
        and (changed & compared).sum() >= CHANGED * compared_runs
    )


def _is_evidence(green: NDArray[np.uint8]) -> NDArray[np.bool_]:
    runs = _runs(green)
    darkest, brightest = runs.min(axis=2), runs.max(axis=2)
    low, high = UNCLIPPED
    found: NDArray[np.bool_] = (brightest.astype(np.int16) - darkest >= CONTRAST) & (darkest > low) & (brightest < high)
    return found


def _runs(rows: NDArray[Kind]) -> NDArray[Kind]:
    return rows.reshape(len(rows), rows.shape[1] // RUN_PX, RUN_PX)


# Frames for the loop ------------------------------------------------------------------------------


class Mailbox:
    """Holds the newest frame until it is taken. A newer frame takes the place of one that was not taken."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._frame: Frame | None = None
        self._is_closed = False

    def put(self, frame: Frame) -> None:
        """Put in a frame, in place of the one that is there. A closed mailbox takes none."""
        with self._changed:
            if self._is_closed:
                return
            self._frame = frame
            self._changed.notify()

    def take(self, timeout_s: float) -> Frame | None:
        """Take out the frame; wait for one if there is none. None if none came in time, or the mailbox is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._frame is not None or self._is_closed, timeout_s)
            frame, self._frame = self._frame, None
            return frame

    def close(self) -> None:
        """Take no more frames, and end the wait of `take`."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()


# How long to wait before a failed camera is opened again: this at first, doubled each time, up to that. A
# camera that is back is then used within five seconds, with the two that it may take to open it.
FIRST_DELAY_S = 0.25
MAX_DELAY_S = 3.0

# A camera that gave no new frame for longer than this is worth a word.
QUIET_S = 0.3

# A driver that has not come back for longer than this hangs: a minute is the longest read time-out there is.
HUNG_AFTER_S = 70.0

# How long `CaptureThread.stop` waits for the thread after it closed the camera, which may take 1.5 s by itself.
STOP_WAIT_S = 0.4

# Of a second camera this many frames are kept, to find the one nearest in time to the first camera's.
RECENT_FRAMES = 3

RECOVERABLE = (DriverError, PictureError)
Answer = TypeVar("Answer")
Wait = Callable[[threading.Event, float], bool]


class CaptureThread:
    """Reads an open camera in a thread of its own and puts new frames in a mailbox.

    A camera that times out, is lost or repeats its picture is closed and opened again, after a delay that doubles
    until a new frame comes. Repeated pictures never reach the mailbox. An error of another kind, such as a mistake in a
    driver, ends the thread and is kept in `failure`; so is a ``SystemExit``, which would end it without a word.
    """

    def __init__(self, camera: Camera, clock: Clock, freeze: FreezeDetector, wait: Wait) -> None:
        self.mailbox = Mailbox()
        self.failure: BaseException | None = None
        self._camera = camera
        self._clock = clock
        self._freeze = freeze
        self._wait = wait
        self._stopped = threading.Event()
        self._delay_s = FIRST_DELAY_S
        self._outage = ""
        self._new_frame_at_s = self._answered_at_s = clock.now_s()
        self._held_by = ""
        self._failed = ""
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)

    def start(self, failed: str = "") -> None:
        """Start reading; if opening the camera has ``failed``, with opening it again."""
        self._freeze.restart(self._clock.now_s())
        if failed:
            self._failed, self._outage = failed, _reopening_words(failed, self._delay_s)
        self._thread.start()

    def stop(self) -> None:
        """Close the camera and end the thread; leave it behind if the camera's driver does not let it go."""
        self._stopped.set()
        self.mailbox.close()
        try:
            self._camera.close()
        finally:
            self._thread.join(STOP_WAIT_S)

    def trouble(self) -> str:
        """Describe the camera's trouble at present, in words, or return an empty string."""
        if words := self._outage or self.hung():
            return words
        quiet_s = self._clock.now_s() - self._new_frame_at_s
        return f"no new frame for over {QUIET_S:g} s" if quiet_s > QUIET_S else ""

    def hung(self) -> str:
        """Return why nothing but another process can use the camera, in words, or an empty string."""
        if self._held_by:
            return self._held_by
        is_away = self._clock.now_s() - self._answered_at_s > HUNG_AFTER_S
        return f"the camera's driver hangs: it has not answered for over {HUNG_AFTER_S:g} s" if is_away else ""

    def _run(self) -> None:
        try:
            if self._failed:
                self._open_again(self._failed)
            while not self._stopped.is_set():
                self._read_once()
        except BaseException as error:  # noqa: BLE001 - re-raised in the thread that calls `latest()`
            self.failure = error
        finally:
            self.mailbox.close()
            self._camera.close()

    def _read_once(self) -> None:
        try:
            self._accept(self._answer(self._camera.read))
        except RECOVERABLE as error:
            self._open_again(str(error))

    def _answer(self, ask: Callable[[], Answer]) -> Answer:
        try:
            return ask()
        finally:
            self._answered_at_s = self._clock.now_s()

    def _accept(self, frame: Frame) -> None:
        now_s = self._clock.now_s()
        if self._freeze.is_new(frame, now_s):
            self._new_frame_at_s, self._outage, self._delay_s = now_s, "", FIRST_DELAY_S
            self.mailbox.put(frame)
        elif frozen := self._freeze.frozen(now_s):
            raise CaptureTimeoutError(frozen)

    def _open_again(self, cause: str) -> None:
        """Close the camera, and open it until that succeeds or the thread is to stop."""
        while not self._stopped.is_set():
            self._camera.close()
            delay_s, self._delay_s = self._delay_s, min(2 * self._delay_s, MAX_DELAY_S)
            self._outage = _reopening_words(cause, delay_s)
            if self._wait(self._stopped, delay_s):
                return
            try:
                self._answer(self._camera.open)
            except RECOVERABLE as error:
                cause = str(error)
                self._held_by = cause if isinstance(error, DeviceHungError) else ""
            else:
                self._held_by = ""
                self._outage = f"{cause}; the camera was opened again and has given no new frame yet"
                self._freeze.restart(self._clock.now_s())
                return


def _reopening_words(cause: str, delay_s: float) -> str:
    """Describe the event and what is done about it, in one line that stays the same until either changes."""
    return f"{cause}; opening the camera again after {delay_s:g} s"


class Capture:
    """The source of the loop's frames: read in the caller's thread, as from a recording or a simulation."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera

    def open(self) -> None:
        """Open the camera.

        Raises:
            DeviceOpenError: It is absent, busy, or this user may not open it.
            PictureError: A recording cannot be read.
        """
        self._camera.open()

    def latest(self, timeout_s: float) -> Frame:  # noqa: ARG002 - a recording takes the time it takes
        """Return the newest frame that was not returned before; wait for one if there is none.

        Args:
            timeout_s: How long to wait for a live camera, in real seconds. A recording takes the time it takes.

        Raises:
            CaptureTimeoutError: None came; the message says why. Asking again may help.
            DeviceClosedError: The camera is not open.
            EndOfFramesError: A recording is at its end.
            PictureError: A recording is damaged at this point.
        """
        return self._camera.read()

    def trouble(self) -> str:
        """Describe the camera's trouble at present, in words, or return an empty string."""
        return ""

    def hung(self) -> str:
        """Return why nothing but another process can use the camera, in words, or an empty string.

        A camera that is absent, busy or silent is opened again and again, and is not hung. A driver that does not come
        back, or that cannot let its device go, holds it for as long as this process lives.
        """
        return ""

    def remarks(self) -> tuple[str, ...]:
        """List the things the user should know of the camera as it was opened, a sentence each."""
        return self._camera.remarks

    def not_for_motion(self) -> str:
        """Return why nothing may move on the camera's frames, in a sentence, or an empty string."""
        return self._camera.not_for_motion

    def close(self) -> None:
        """Close the camera. May be called at any time, any number of times."""
        self._camera.close()


class LiveCapture(Capture):
    """Reads a live camera in a thread; the newest frame wins.

    A camera that fails or freezes is opened again without being asked for, as `CaptureThread` describes; meanwhile
    `latest` raises and `trouble` tells.
    """

    def __init__(
        self, camera: Camera, clock: Clock, *, freeze: FreezeDetector | None = None, wait: Wait = threading.Event.wait
    ) -> None:
        super().__init__(camera)
        self._clock = clock
        self._freeze = freeze or FreezeDetector()
        self._wait = wait
        self._thread: CaptureThread | None = None

    def open(self) -> None:
        """Open the camera in the caller's thread, so that one that is missing is noticed at once, and start reading."""
        self.close()
        self._camera.open()
        self._start()

    def open_later(self, error: DriverError) -> bool:
        """Go on after `open` has raised: the camera is opened again like one that failed while it ran. Returns True."""
        self._start(str(error))
        return True

    def _start(self, failed: str = "") -> None:
        self._thread = CaptureThread(self._camera, self._clock, self._freeze, self._wait)
        self._thread.start(failed)

    def latest(self, timeout_s: float) -> Frame:
        """Return the newest frame that was not returned before; see `Capture`.

        An error that is no trouble of the camera, such as a mistake in its driver, is raised as it is.

        Raises:
            CaptureTimeoutError: None came; the message says why.
            DeviceClosedError: The camera is not open, or was closed meanwhile.
        """
        thread = self._thread
        frame = thread.mailbox.take(timeout_s) if thread else None
        if frame:
            return frame
        if thread and thread.failure is not None:
            raise thread.failure
        if thread is None or thread is not self._thread:
            raise DeviceClosedError("the camera is not open; open it before asking for frames")
        raise CaptureTimeoutError(thread.trouble() or f"no new frame in {timeout_s:.2f} s")

    def trouble(self) -> str:
        """Describe the camera's trouble at present, in words, or return an empty string."""
        thread = self._thread
        if thread is None:
            return "the camera is not open"
        if (failure := thread.failure) is not None:
            return f"the camera's driver failed: {str(failure) or type(failure).__name__}"
        return thread.trouble()

    def hung(self) -> str:
        """Return why nothing but another process can use the camera, in words, or an empty string."""
        return self._thread.hung() if self._thread else ""

    def close(self) -> None:
        """Stop reading and close the camera.

        The wait is bounded. If the camera's driver neither delivers nor gives up, this returns after about two seconds
        and leaves the thread behind; it is a daemon, so it does not keep the program alive.
        """
        thread, self._thread = self._thread, None
        if thread:
            thread.stop()


class SecondCapture:
    """Frames of a second camera, which may be missing, fail or freeze at any time: that is reported, and no more.

    Its frames are asked for by the time of the first camera's, which never waits for them.
    """

    def __init__(self, capture: Capture, clock: Clock) -> None:
        self._capture = capture
        self._clock = clock
        self._recent: deque[Frame] = deque(maxlen=RECENT_FRAMES)
        self._new_frame_at_s = clock.now_s()
        self._missed = ""
        self.remarks, self.close = capture.remarks, capture.close

    def open(self) -> None:
        """Open the camera; one that cannot be opened is tried again while it would be read."""
        self._new_frame_at_s = self._clock.now_s()
        try:
            self._capture.open()
        except DriverError as error:
            self._missed = str(error)
            if isinstance(self._capture, LiveCapture):
                self._capture.open_later(error)

    def nearest(self, at_s: float) -> Frame | None:
        """Return the frame of its last few that was taken nearest to a time; None for none. Never waits."""
        try:
            frame = self._capture.latest(0.0)
        except Exception as error:  # noqa: BLE001 - not even a mistake in its driver may end the run
            self._missed = str(error) or type(error).__name__
        else:
            if not self._recent or frame.captured_at_s > self._recent[-1].captured_at_s:
                self._recent.append(frame)
                self._new_frame_at_s, self._missed = self._clock.now_s(), ""
        return min(self._recent, key=lambda each: abs(each.captured_at_s - at_s), default=None)

    def trouble(self) -> str:
        """Describe the camera's trouble at present, in words, or return an empty string."""
        if words := self._capture.trouble():
            return words
        is_quiet = self._clock.now_s() - self._new_frame_at_s > QUIET_S
        return (self._missed or f"no new frame for over {QUIET_S:g} s") if is_quiet else ""


def capture_for(camera: Camera, clock: Clock) -> Capture:
    """Return the way to get frames from a camera: `LiveCapture` for a live one, read in a thread."""
    return LiveCapture(camera, clock) if camera.is_live else Capture(camera)
