"""Frames for the loop: from a thread and a mailbox of one for a live camera, directly from a recording."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import TypeVar

from stadimeter.app.freeze import FreezeDetector
from stadimeter.cameras.protocol import Camera
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Frame
from stadimeter.errors import CaptureTimeoutError, DeviceClosedError, DeviceHungError, DriverError, PictureError


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
