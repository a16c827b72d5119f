from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.app.capture import HUNG_AFTER_S, LiveCapture, capture_for
from stadimeter.cameras.image_files import ImageFilesCamera
from stadimeter.core.frame import Frame
from stadimeter.errors import (
    CaptureTimeoutError,
    DeviceClosedError,
    DeviceHungError,
    DeviceOpenError,
    EndOfFramesError,
    LinkLostError,
)
from stadimeter.testing.rig import ManualClock

PATIENCE_S = 120.0
"""How long a test waits for something that is certain to come."""

Step = int | BaseException | Callable[[], None]


class ScriptedCamera:
    """A live camera that does what a script says, and waits until it is closed when the script is at its end.

    Args:
        clock: Moved on by 0.1 s for each picture.
        script: A grey level to deliver as a picture, an error to raise, or something to call before going on.
        opening: For each `open`, the error to raise, or None; every later one succeeds.
    """

    is_live = True
    remarks = ("it would not switch its autofocus off",)
    not_for_motion = "its pictures are of unknown age"

    def __init__(self, clock: ManualClock, *script: Step, opening: tuple[Exception | None, ...] = ()) -> None:
        self.clock = clock
        self.script = deque(script)
        self.opening = deque(opening)
        self.opened = 0
        self.has_stale_times = False
        self.exhausted = threading.Event()
        self._closed = threading.Event()
        self._sequence = 0

    def open(self) -> None:
        self.opened += 1
        self._closed.clear()
        if self.opening and (error := self.opening.popleft()):
            raise error

    def read(self) -> Frame:
        while self.script:
            step = self.script.popleft()
            if isinstance(step, BaseException):
                raise step
            if isinstance(step, int):
                return self._picture(step)
            step()
        self.exhausted.set()
        self._closed.wait()
        raise DeviceClosedError("closed while it was read")

    def close(self) -> None:
        self._closed.set()

    def _picture(self, level: int) -> Frame:
        self.clock.advance_s(0.1)
        self._sequence += 1
        captured_at_s = 0.0 if self.has_stale_times else self.clock.now_s()
        return Frame(np.full((8, 8, 3), level, np.uint8), captured_at_s, self._sequence - 1)


class Waits:
    """Takes the place of waiting: notes for how long, and what the capture says meanwhile."""

    def __init__(self) -> None:
        self.seconds: list[float] = []
        self.words: list[str] = []
        self.hung: list[str] = []
        self.capture: LiveCapture | None = None

    def __call__(self, event: threading.Event, timeout_s: float) -> bool:
        self.seconds.append(timeout_s)
        self.words.append(self.capture.trouble() if self.capture else "")
        self.hung.append(self.capture.hung() if self.capture else "")
        return event.is_set()


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(100.0)


@pytest.fixture
def waits() -> Waits:
    return Waits()


@contextmanager
def opened(camera: ScriptedCamera, waits: Waits) -> Iterator[LiveCapture]:
    """Open a capture, and let the camera do the whole script."""
    capture = waits.capture = LiveCapture(camera, camera.clock, wait=waits)
    capture.open()
    try:
        assert camera.exhausted.wait(PATIENCE_S)
        yield capture
    finally:
        capture.close()


def level_of(frame: Frame) -> int:
    return int(frame.image[0, 0, 0])


def gate(capture_it: threading.Event) -> Callable[[], None]:
    """Return a step that waits for an event."""

    def wait() -> None:
        assert capture_it.wait(PATIENCE_S)

    return wait


def test_the_newest_frame_wins(clock, waits):
    with opened(ScriptedCamera(clock, 1, 2, 3), waits) as capture:
        frame = capture.latest(PATIENCE_S)
        assert level_of(frame) == 3
        assert frame.sequence == 2
        assert capture.trouble() == ""


def test_a_frame_is_never_delivered_twice(clock, waits):
    with opened(ScriptedCamera(clock, 1), waits) as capture:
        capture.latest(PATIENCE_S)
        with pytest.raises(CaptureTimeoutError):
            capture.latest(0.0)


def test_latest_waits_for_the_next_frame(clock, waits):
    go_on = threading.Event()
    camera = ScriptedCamera(clock, 1, gate(go_on), 2)
    capture = LiveCapture(camera, clock)
    capture.open()
    assert level_of(capture.latest(PATIENCE_S)) == 1
    go_on.set()
    assert level_of(capture.latest(PATIENCE_S)) == 2
    capture.close()


def test_a_camera_that_hangs_is_noticed(clock, waits):
    with opened(ScriptedCamera(clock, 1), waits) as capture:
        capture.latest(PATIENCE_S)
        clock.advance_s(0.4)
        assert capture.trouble() == "no new frame for over 0.3 s"
        with pytest.raises(CaptureTimeoutError, match=r"^no new frame for over 0\.3 s$"):
            capture.latest(0.01)


def test_a_camera_that_is_missing_at_the_start_is_an_error_at_once(clock):
    camera = ScriptedCamera(clock, opening=(DeviceOpenError("there is no camera"),))
    capture = LiveCapture(camera, clock)
    with pytest.raises(DeviceOpenError, match="there is no camera"):
        capture.open()
    with pytest.raises(DeviceClosedError):
        capture.latest(0.0)
    assert camera.opened == 1


def test_a_lost_camera_is_opened_again_by_itself(clock, waits):
    camera = ScriptedCamera(clock, 1, LinkLostError("/dev/video0 is gone"), 2)
    with opened(camera, waits) as capture:
        assert level_of(capture.latest(PATIENCE_S)) == 2
        assert capture.trouble() == ""
    assert camera.opened == 2
    assert waits.seconds == [0.25]
    assert waits.words == ["/dev/video0 is gone; opening the camera again after 0.25 s"]


def test_the_wait_before_opening_again_doubles_up_to_three_seconds(clock, waits):
    absent = DeviceOpenError("there is no /dev/video0")
    camera = ScriptedCamera(clock, 1, LinkLostError("gone"), 2, opening=(None, *[absent] * 7))
    with opened(camera, waits) as capture:
        assert level_of(capture.latest(PATIENCE_S)) == 2
    assert waits.seconds == [0.25, 0.5, 1.0, 2.0, 3.0, 3.0, 3.0, 3.0]
    assert waits.words[-1] == "there is no /dev/video0; opening the camera again after 3 s"
    assert camera.opened == 9


def test_a_new_frame_makes_the_next_wait_short_again(clock, waits):
    lost = LinkLostError("gone")
    camera = ScriptedCamera(clock, lost, lost, lost, 1, lost, 2)
    with opened(camera, waits):
        pass
    assert waits.seconds == [0.25, 0.5, 1.0, 0.25]


def test_a_camera_that_opens_but_stays_silent_is_waited_for_longer_and_longer(clock, waits):
    silent = CaptureTimeoutError("no picture for 1.0 s")
    with opened(ScriptedCamera(clock, silent, silent, silent), waits) as capture:
        expected = "no picture for 1.0 s; the camera was opened again and has given no new frame yet"
        assert capture.trouble() == expected
        with pytest.raises(CaptureTimeoutError, match=expected):
            capture.latest(0.0)
    assert waits.seconds == [0.25, 0.5, 1.0]


def test_a_frozen_picture_is_noticed_and_the_camera_opened_again(clock, waits):
    camera = ScriptedCamera(clock, 1, *[7] * 12, 8)
    with opened(camera, waits) as capture:
        assert level_of(capture.latest(PATIENCE_S)) == 8
    assert camera.opened == 2
    assert waits.words == ["the picture has not changed for 1.1 s; opening the camera again after 0.25 s"]


def test_a_repeated_picture_is_never_delivered_as_new(clock, waits):
    with opened(ScriptedCamera(clock, *[7] * 5), waits) as capture:
        assert capture.latest(0.0).sequence == 0
        assert capture.trouble() == "no new frame for over 0.3 s"
        with pytest.raises(CaptureTimeoutError):
            capture.latest(0.0)


def test_a_picture_that_stays_frozen_after_opening_again_is_still_not_new(clock, waits):
    camera = ScriptedCamera(clock, *[7] * 40)
    with opened(camera, waits) as capture:
        assert capture.latest(0.0).sequence == 0
        with pytest.raises(CaptureTimeoutError):
            capture.latest(0.0)
    assert camera.opened == 4
    assert waits.seconds == [0.25, 0.5, 1.0]


def test_a_capture_time_that_stands_still_counts_as_frozen(clock, waits):
    camera = ScriptedCamera(clock, *range(1, 13))
    camera.has_stale_times = True
    with opened(camera, waits) as capture:
        assert capture.latest(0.0).sequence == 0
    assert camera.opened == 2
    assert "capture time has not advanced" in waits.words[0]


@pytest.mark.parametrize("mistake", [ZeroDivisionError, SystemExit, KeyboardInterrupt, MemoryError])
def test_a_mistake_in_a_driver_reaches_whoever_asks_for_frames(clock, mistake):
    camera = ScriptedCamera(clock, mistake("a mistake"))
    capture = LiveCapture(camera, clock)
    capture.open()
    for _ in range(2):
        with pytest.raises(mistake, match="a mistake"):
            capture.latest(PATIENCE_S)
    assert capture.trouble() == "the camera's driver failed: a mistake"
    capture.close()
    assert camera.opened == 1


def test_a_driver_that_never_comes_back_from_a_read_is_said_to_hang(clock, waits):
    with opened(ScriptedCamera(clock, 1), waits) as capture:
        clock.advance_s(HUNG_AFTER_S)
        assert (capture.hung(), capture.trouble()) == ("", "no new frame for over 0.3 s")
        clock.advance_s(0.1)
        assert capture.hung() == capture.trouble() == "the camera's driver hangs: it has not answered for over 70 s"


def test_a_camera_that_its_driver_cannot_let_go_hangs_until_it_opens_again(clock, waits):
    hung = list[str]()
    camera = ScriptedCamera(
        clock,
        LinkLostError("gone"),
        1,
        lambda: hung.append(waits.capture.hung() if waits.capture else "?"),
        opening=(None, DeviceOpenError("absent"), DeviceHungError("still being closed"), None),
    )
    with opened(camera, waits):
        pass
    said = [words.split(";")[0] for words in waits.words]
    assert said == ["gone", "absent", "still being closed"]
    assert hung == [""]
    assert waits.hung == ["", "", "still being closed"]


def test_closing_while_the_camera_is_read_ends_the_thread(clock, waits):
    camera = ScriptedCamera(clock)
    with opened(camera, waits) as capture:
        assert "camera" in {thread.name for thread in threading.enumerate()}
    assert "camera" not in {thread.name for thread in threading.enumerate()}
    assert camera.opened == 1
    with pytest.raises(DeviceClosedError):
        capture.latest(0.0)
    assert capture.trouble() == "the camera is not open"


def test_closing_ends_the_wait_before_opening_again(clock):
    waiting = threading.Event()

    def wait(event: threading.Event, timeout_s: float) -> bool:
        waiting.set()
        return event.wait(PATIENCE_S)

    camera = ScriptedCamera(clock, LinkLostError("gone"))
    capture = LiveCapture(camera, clock, wait=wait)
    capture.open()
    assert waiting.wait(PATIENCE_S)
    capture.close()
    assert "camera" not in {thread.name for thread in threading.enumerate()}
    assert camera.opened == 1


def test_closing_lets_whoever_waits_for_a_frame_go(clock, waits):
    errors: list[Exception] = []

    def ask(capture: LiveCapture) -> None:
        try:
            capture.latest(60.0)
        except DeviceClosedError as error:
            errors.append(error)

    with opened(ScriptedCamera(clock), waits) as capture:
        asking = threading.Thread(target=ask, args=(capture,))
        asking.start()
    asking.join(PATIENCE_S)
    assert len(errors) == 1


def test_a_driver_that_never_lets_go_does_not_hold_up_closing(clock, monkeypatch):
    monkeypatch.setattr("stadimeter.app.capture.STOP_WAIT_S", 0.01)
    stuck, let_go = threading.Event(), threading.Event()
    camera = ScriptedCamera(clock, lambda: stuck.set() or gate(let_go)(), 1)
    capture = LiveCapture(camera, clock)
    capture.open()
    assert stuck.wait(PATIENCE_S)
    capture.close()
    (left,) = [thread for thread in threading.enumerate() if thread.name == "camera"]
    assert left.daemon
    let_go.set()
    left.join(PATIENCE_S)
    assert not left.is_alive()


def test_a_closed_capture_opens_again(clock, waits):
    camera = ScriptedCamera(clock, 1)
    with opened(camera, waits) as capture:
        assert level_of(capture.latest(PATIENCE_S)) == 1
        capture.close()
        capture.close()
        camera.script.append(2)
        capture.open()
        assert level_of(capture.latest(PATIENCE_S)) == 2


@pytest.fixture
def recording(tmp_path: Path, clock: ManualClock) -> ImageFilesCamera:
    for level in (10, 20):
        cv2.imwrite(str(tmp_path / f"{level}.png"), np.full((8, 8, 3), level, np.uint8))
    return ImageFilesCamera((str(tmp_path),), 1.0, clock)


def test_every_frame_of_a_recording_is_delivered_in_the_caller_s_thread(recording, clock):
    before = threading.active_count()
    capture = capture_for(recording, clock)
    capture.open()
    assert [level_of(capture.latest(0.0)) for _ in range(2)] == [10, 20]
    assert clock.now_s() == 101.0
    assert threading.active_count() == before
    with pytest.raises(EndOfFramesError):
        capture.latest(0.0)
    assert capture.trouble() == ""
    capture.close()
    with pytest.raises(DeviceClosedError):
        capture.latest(0.0)


def test_why_nothing_may_move_on_a_camera_s_frames_is_known(recording, clock):
    assert capture_for(ScriptedCamera(clock), clock).not_for_motion() == "its pictures are of unknown age"
    assert capture_for(recording, clock).not_for_motion() == ""
