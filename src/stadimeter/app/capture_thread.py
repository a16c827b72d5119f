"""The thread that reads a live camera, and opens it again when it fails."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from stadimeter.app.freeze import FreezeDetector
from stadimeter.app.mailbox import Mailbox
from stadimeter.cameras.protocol import Camera
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Frame
from stadimeter.errors import CaptureTimeoutError, DriverError, PictureError

FIRST_DELAY_S = 0.25
LONGEST_DELAY_S = 8.0
"""How long to wait before a failed camera is opened again: this at first, doubled each time, up to that."""

QUIET_S = 0.3
"""A camera that gave no new frame for longer than this is worth a word."""

STOP_WAIT_S = 0.4
"""How long `CaptureThread.stop` waits for the thread after it closed the camera, which may take 1.5 s by itself."""

RECOVERABLE = (DriverError, PictureError)
Wait = Callable[[threading.Event, float], bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outage:
    """A camera that failed and has given no new frame since.

    Attributes:
        cause: What happened, in words.
        retry_after_s: After how long it is opened again, or None if that was done and a new frame is awaited.
    """

    cause: str
    retry_after_s: float | None

    def in_words(self) -> str:
        """Return what happened and what is done about it, in one line that stays the same until either changes."""
        if self.retry_after_s is None:
            return f"{self.cause}; the camera was opened again and has given no new frame yet"
        return f"{self.cause}; opening the camera again after {self.retry_after_s:g} s"


class CaptureThread:
    """Reads an open camera in a thread of its own and puts new frames in a mailbox.

    A camera that times out, is lost or repeats its picture is closed and opened again, after a delay that doubles
    until a new frame comes. Repeated pictures never reach the mailbox. An error of another kind, such as a mistake in a
    driver, ends the thread and is kept in `failure`.

    Args:
        wait: Waits for an event, like ``threading.Event.wait``, which it is unless in tests.
    """

    def __init__(self, camera: Camera, clock: Clock, freeze: FreezeDetector, wait: Wait) -> None:
        self.mailbox = Mailbox()
        self.failure: Exception | None = None
        self._camera = camera
        self._clock = clock
        self._freeze = freeze
        self._wait = wait
        self._stopped = threading.Event()
        self._delay_s = FIRST_DELAY_S
        self._outage: Outage | None = None
        self._new_frame_at_s = clock.now_s()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)

    def start(self) -> None:
        """Start reading."""
        self._freeze.restart(self._clock.now_s())
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
        """Return what is wrong with the camera at present, in words, or an empty string."""
        now_s = self._clock.now_s()
        if outage := self._outage:
            return outage.in_words()
        quiet_s = now_s - self._new_frame_at_s
        return f"no new frame for over {QUIET_S:g} s" if quiet_s > QUIET_S else ""

    def _run(self) -> None:
        try:
            while not self._stopped.is_set():
                self._read_once()
        except Exception as error:  # noqa: BLE001 - whoever asks for a frame gets it raised again, in his own thread
            self.failure = error
        finally:
            self.mailbox.close()
            self._camera.close()

    def _read_once(self) -> None:
        try:
            self._accept(self._camera.read())
        except RECOVERABLE as error:
            self._open_again(str(error))

    def _accept(self, frame: Frame) -> None:
        now_s = self._clock.now_s()
        if self._freeze.is_new(frame, now_s):
            self._new_frame_at_s, self._outage, self._delay_s = now_s, None, FIRST_DELAY_S
            self.mailbox.put(frame)
        elif frozen := self._freeze.frozen(now_s):
            raise CaptureTimeoutError(frozen)

    def _open_again(self, cause: str) -> None:
        """Close the camera, and open it until that succeeds or the thread is to stop."""
        while not self._stopped.is_set():
            self._camera.close()
            delay_s, self._delay_s = self._delay_s, min(2 * self._delay_s, LONGEST_DELAY_S)
            self._outage = Outage(cause=cause, retry_after_s=delay_s)
            if self._wait(self._stopped, delay_s):
                return
            try:
                self._camera.open()
            except RECOVERABLE as error:
                cause = str(error)
            else:
                self._outage = Outage(cause=cause, retry_after_s=None)
                self._freeze.restart(self._clock.now_s())
                return
