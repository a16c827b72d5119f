"""The contract of every camera. Subclass `CameraContract` with a fixture ``make_rig``, and pytest runs it all.

::

    class TestMyCamera(CameraContract):
        @pytest.fixture
        def make_rig(self) -> Callable[[], CameraRig]:
            return my_rig
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import pytest
from msgspec import Struct

from stadimeter import errors
from stadimeter.cameras.protocol import Camera
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Frame
from stadimeter.testing.rig import Contract

# How many frames a recording under test must have, at least.
FRAMES = 3

# How many are read of a live camera: more than the buffers of a driver that uses them in turn.
LIVE_FRAMES = 12

# How often a camera that lost its device may be read before it must have noticed.
MAX_READS = 200

CLOSE_LIMIT_S = 5.0


class CameraRig(Struct, frozen=True, kw_only=True, eq=False):
    """A camera that was not opened yet, and what is needed to watch it.

    Attributes:
        camera: The camera. Its device is there and has at least `FRAMES` frames.
        clock: The clock that it was given; a `ManualClock`, but for a live camera a real one.
        absent: A camera of the same kind whose device is not there; None for one that cannot be absent.
        held: Counts how often the device is taken at the moment: open files, sockets or handles, of the device and not
            as the driver believes. None for a camera that holds nothing.
        lose: Makes the open device fail in the vendor's own way: pulls the plug, damages the recording. None for a
            camera that cannot fail.
    """

    camera: Camera
    clock: Clock
    absent: Camera | None = None
    held: Callable[[], int] | None = None
    lose: Callable[[], None] | None = None

    def read(self) -> list[Frame]:
        """Open the camera and read some frames."""
        self.camera.open()
        return [self.camera.read() for _ in range(LIVE_FRAMES if self.camera.is_live else FRAMES)]


class CameraContract(Contract):
    """The tests."""

    @pytest.fixture
    def rig(self, make_rig: Callable[[], CameraRig]) -> Iterator[CameraRig]:
        """Return a rig that is not open; its camera is closed afterwards."""
        rig = make_rig()
        yield rig
        rig.camera.close()

    def test_a_camera_that_is_absent_says_so_in_open_and_stays_closed(self, rig: CameraRig) -> None:
        """A program may build every driver, and report on all of them, before it opens one."""
        if rig.absent is None:
            pytest.skip("this camera cannot be absent")
        with pytest.raises((errors.DeviceOpenError, errors.PictureError)) as raised:
            rig.absent.open()
        assert str(raised.value), "an error must say what is wrong"
        assert "\n" not in str(raised.value).strip(), "an error message is one line"
        with pytest.raises(errors.DeviceClosedError):
            rig.absent.read()
        rig.absent.close()

    def test_reading_needs_an_open_camera_which_may_be_closed_at_any_time_and_again(self, rig: CameraRig) -> None:
        """Whatever was read before."""
        rig.camera.close()
        with pytest.raises(errors.DeviceClosedError):
            rig.camera.read()
        rig.camera.open()
        rig.camera.read()
        rig.camera.close()
        rig.camera.close()
        with pytest.raises(errors.DeviceClosedError):
            rig.camera.read()

    def test_the_device_is_taken_once_by_open_and_let_go_by_close(self, rig: CameraRig) -> None:
        """Another program may want it; and a device that is still taken cannot be opened again."""
        if (held := rig.held) is None:
            pytest.skip("this camera holds no device")
        assert held() == 0, "the constructor took the device"
        rig.camera.open()
        rig.camera.read()
        assert held() == 1, "an open camera holds its device"
        rig.camera.open()
        rig.camera.read()
        assert held() == 1, "the second open left the first handle open"
        rig.camera.close()
        assert held() == 0, "closing left the device taken"

    def test_a_lost_device_ends_reading_with_an_error_of_ours(self, rig: CameraRig) -> None:
        """The app closes and opens a camera after such an error; one of the vendor's would end the program."""
        if rig.lose is None:
            pytest.skip("this camera cannot fail")
        rig.camera.open()
        rig.camera.read()
        rig.lose()
        error = _error_of(rig.camera)
        assert error is not None, f"the device is gone, and {MAX_READS} frames came all the same"
        assert isinstance(error, errors.StadimeterError), f"an error of the vendor's reached the app: {error!r}"
        assert not isinstance(error, errors.EndOfFramesError), "a device that failed is not a recording that ended"
        assert "\n" not in str(error).strip(), "an error message is one line"

    def test_frames_are_8_bit_colour_pictures_of_one_size(self, rig: CameraRig) -> None:
        """Detectors rely on the form of the image."""
        not_for_motion = rig.camera.not_for_motion
        frames = rig.read()
        assert rig.camera.not_for_motion == not_for_motion, "it depends on the configuration, not on the device"
        assert all(frame.image.dtype == np.uint8 for frame in frames), "images are 8 bits a channel"
        assert all(frame.image.ndim == 3 and frame.image.shape[2] == 3 for frame in frames), "images have 3 channels"
        assert len({frame.image.shape for frame in frames}) == 1, "the size does not change"

    def test_numbers_rise_and_capture_times_never_go_back_nor_ahead_of_the_clock(self, rig: CameraRig) -> None:
        """Age is computed from them; a frame from the future would look fresh for too long."""
        rig.camera.open()
        times_s, numbers = [rig.clock.now_s() - 60.0], [-1]
        for _ in range(LIVE_FRAMES if rig.camera.is_live else FRAMES):
            frame = rig.camera.read()
            times_s.append(frame.captured_at_s)
            numbers.append(frame.sequence)
            assert times_s[-1] <= rig.clock.now_s() + 1e-9, "a frame was captured before it is returned"
        assert all(earlier <= later for earlier, later in pairwise(times_s)), f"capture times go back: {times_s}"
        assert numbers[1] == 0, "sequence numbers count from 0"
        assert all(earlier < later for earlier, later in pairwise(numbers)), f"they do not rise: {numbers}"

    def test_a_frames_image_is_not_changed_by_later_reads(self, rig: CameraRig) -> None:
        """Frames are looked at while the next ones are being read, and kept when the camera is opened again."""
        rig.camera.open()
        frames, copies = [], []
        for _ in range(LIVE_FRAMES if rig.camera.is_live else FRAMES):
            frames.append(rig.camera.read())
            copies.append(frames[-1].image.copy())
        rig.camera.close()
        rig.read()
        for frame, copy in zip(frames, copies, strict=True):
            assert np.array_equal(frame.image, copy), f"the image of frame {frame.sequence} was overwritten"

    def test_a_closed_camera_opens_again_and_time_and_numbers_go_on(self, rig: CameraRig) -> None:
        """A camera that failed is closed and opened by the app; what is downstream sees one run of frames."""
        before = rig.read()
        rig.camera.close()
        after = rig.read()
        assert after[0].captured_at_s >= before[-1].captured_at_s, "capture times went back when it was opened again"
        assert after[0].sequence > before[-1].sequence, "sequence numbers went back when it was opened again"

    def test_closing_ends_a_read_in_another_thread(self, rig: CameraRig) -> None:
        """The app reads a live camera in a thread and closes it from the loop's."""
        if not rig.camera.is_live:
            pytest.skip("a camera that is not live is read and closed by one thread")
        rig.camera.open()
        started = threading.Event()
        with ThreadPoolExecutor(1) as pool:
            reading = pool.submit(_read_until_error, rig.camera, started)
            assert started.wait(CLOSE_LIMIT_S), "no frame came"
            rig.camera.close()
            assert isinstance(error := reading.exception(CLOSE_LIMIT_S), errors.DriverError), f"it ended with {error!r}"


def _error_of(camera: Camera) -> Exception | None:
    """Return the error that ends reading, None where none does."""
    try:
        for _ in range(MAX_READS):
            camera.read()
    except Exception as error:  # noqa: BLE001 - the test looks at it
        return error
    return None


def _read_until_error(camera: Camera, started: threading.Event) -> None:
    while True:
        camera.read()
        started.set()
