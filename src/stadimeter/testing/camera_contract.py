"""What every camera must do: a suite for people who write camera drivers.

::

    class TestMyCamera(CameraContract):
        @pytest.fixture
        def camera(self, clock):
            camera = MyCamera(..., clock)
            yield camera
            camera.close()
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from stadimeter.cameras.protocol import Camera
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Frame
from stadimeter.errors import DeviceClosedError, DeviceOpenError, DriverError, PictureError
from stadimeter.testing.manual_clock import ManualClock

FRAMES = 3
"""How many frames a camera under test must have, at least."""

CLOSE_LIMIT_S = 5.0


class CameraContract:
    """The contract of `stadimeter.cameras.protocol.Camera`. Derive from it and give the fixtures.

    Fixtures to give:
        camera: A closed camera whose device is there and has at least `FRAMES` frames.
        absent_camera: A camera whose device is not there; leave it out for one that cannot be absent.
        clock: The clock that both were made with; a `ManualClock` unless replaced. A live camera needs a real one.
    """

    @pytest.fixture
    def clock(self) -> Clock:
        """Return the run's clock."""
        return ManualClock(100.0)

    @pytest.fixture
    def camera(self, clock: Clock) -> Iterator[Camera]:
        """Return a closed camera."""
        raise NotImplementedError("a contract suite needs a 'camera' fixture")

    @pytest.fixture
    def absent_camera(self, clock: Clock) -> Camera:  # noqa: ARG002 - for those that replace it
        """Return a camera whose device is not there."""
        pytest.skip("this camera cannot be absent")

    def test_the_constructor_touches_no_device_and_open_says_that_it_is_absent(self, absent_camera: Camera) -> None:
        """A program may build every driver, and report on all of them, before it opens one."""
        with pytest.raises((DeviceOpenError, PictureError)) as raised:
            absent_camera.open()
        assert str(raised.value), "an error must say what is wrong"
        assert "\n" not in str(raised.value).strip(), "an error message is one line"

    def test_reading_a_camera_that_failed_to_open_raises(self, absent_camera: Camera) -> None:
        """A camera that failed to open is closed."""
        with pytest.raises((DeviceOpenError, PictureError)):
            absent_camera.open()
        with pytest.raises(DeviceClosedError):
            absent_camera.read()
        absent_camera.close()

    def test_reading_before_opening_raises(self, camera: Camera) -> None:
        """Reading needs an open camera."""
        with pytest.raises(DeviceClosedError):
            camera.read()

    def test_reading_after_closing_raises(self, camera: Camera) -> None:
        """Closing ends reading, whatever was read before."""
        camera.open()
        camera.read()
        camera.close()
        with pytest.raises(DeviceClosedError):
            camera.read()

    def test_closing_may_be_done_at_any_time_and_again(self, camera: Camera) -> None:
        """Before opening, after it, and twice."""
        camera.close()
        camera.open()
        camera.close()
        camera.close()

    def test_whether_something_may_move_on_its_frames_is_known_before_it_is_opened(self, camera: Camera) -> None:
        """`check` and the start of a run say it."""
        before = camera.not_for_motion
        camera.open()
        assert camera.not_for_motion == before, "it depends on the configuration, not on the device"
        assert "\n" not in before, "the reason is one line"

    def test_frames_are_8_bit_colour_pictures_of_one_size(self, camera: Camera) -> None:
        """Detectors rely on the form of the image."""
        frames = _read(camera)
        assert all(frame.image.dtype == np.uint8 for frame in frames), "images are 8 bits a channel"
        assert all(frame.image.ndim == 3 and frame.image.shape[2] == 3 for frame in frames), "images have 3 channels"
        assert len({frame.image.shape for frame in frames}) == 1, "the size does not change"
        assert frames[0].width_px > 0, "an image has a width"
        assert frames[0].height_px > 0, "an image has a height"

    def test_capture_times_never_go_back_nor_ahead_of_the_clock(self, camera: Camera, clock: Clock) -> None:
        """Age is computed from them; a frame from the future would look fresh for too long."""
        camera.open()
        times_s = [clock.now_s() - 60.0]
        for _ in range(FRAMES):
            times_s.append(camera.read().captured_at_s)
            assert times_s[-1] <= clock.now_s() + 1e-9, "a frame was captured before it is returned"
        assert all(earlier <= later for earlier, later in pairwise(times_s)), f"capture times go back: {times_s}"

    def test_sequence_numbers_rise_from_zero(self, camera: Camera) -> None:
        """A gap tells of frames that were passed over."""
        numbers = [frame.sequence for frame in _read(camera)]
        assert numbers[0] == 0, "sequence numbers count from 0"
        assert all(earlier < later for earlier, later in pairwise(numbers)), f"they do not rise: {numbers}"

    def test_a_frames_image_is_not_changed_by_later_reads(self, camera: Camera) -> None:
        """Frames are looked at while the next one is being read."""
        camera.open()
        frame = camera.read()
        kept = frame.image.copy()
        for _ in range(FRAMES - 1):
            camera.read()
        camera.close()
        assert np.array_equal(frame.image, kept), "the image of an earlier frame was overwritten"

    def test_a_closed_camera_opens_again_and_time_and_numbers_go_on(self, camera: Camera) -> None:
        """A camera that failed is closed and opened by the app; what is downstream sees one run of frames."""
        before = _read(camera)
        camera.close()
        after = _read(camera)
        assert after[0].captured_at_s >= before[-1].captured_at_s, "capture times went back when it was opened again"
        assert after[0].sequence > before[-1].sequence, "sequence numbers went back when it was opened again"

    def test_closing_ends_a_read_in_another_thread(self, camera: Camera) -> None:
        """The app reads a live camera in a thread and closes it from the loop's."""
        if not camera.is_live:
            pytest.skip("a camera that is not live is read and closed by one thread")
        camera.open()
        started, errors = threading.Event(), list[Exception]()
        thread = threading.Thread(target=_read_until_error, args=(camera, started, errors), daemon=True)
        thread.start()
        assert started.wait(CLOSE_LIMIT_S), "no frame came"
        camera.close()
        thread.join(CLOSE_LIMIT_S)
        assert not thread.is_alive(), "the read did not end"
        assert isinstance(errors[0], DriverError), f"the read ended with {errors[0]!r}"


def _read(camera: Camera) -> list[Frame]:
    camera.open()
    return [camera.read() for _ in range(FRAMES)]


def _read_until_error(camera: Camera, started: threading.Event, errors: list[Exception]) -> None:
    try:
        while True:
            camera.read()
            started.set()
    except Exception as error:  # noqa: BLE001 - the test looks at it
        errors.append(error)
