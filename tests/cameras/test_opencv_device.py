from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from stadimeter.app.clock import MonotonicClock
from stadimeter.cameras.capture_time import GOOD_STAMPS_NEEDED
from stadimeter.cameras.opencv_device import OpenCvCamera, OpenCvOptions
from stadimeter.cameras.v4l2 import in_use
from stadimeter.errors import CaptureTimeoutError, DeviceClosedError, DeviceHungError, DeviceOpenError, LinkLostError
from stadimeter.testing.rig import ManualClock

if TYPE_CHECKING:
    from conftest import FakeDevice


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(1000.0)


@pytest.fixture
def node(tmp_path: Path) -> Path:
    """Return the path of something that can be opened, in place of a device node."""
    path = tmp_path / "video0"
    path.touch()
    return path


def camera_of(device: FakeDevice, node: Path | str, clock: ManualClock, **table: Any) -> OpenCvCamera:
    options = OpenCvOptions.model_validate({"device": str(node), **table})
    if options.is_stream:
        device.wait = lambda: clock.advance_s(0.05)
    return OpenCvCamera(options, clock, device, monotonic=clock.now_s)


def picture(level: int = 0, shape: tuple[int, ...] = (480, 640, 3)) -> np.ndarray:
    return np.full(shape, level, np.uint8)


def test_waiting_for_a_device_is_bounded_by_a_second() -> None:
    assert os.environ["OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"] == "1"


def test_a_device_is_opened_as_a_video4linux_device(device: FakeDevice, node: Path, clock: ManualClock) -> None:
    camera_of(device, node, clock).open()
    assert device.source[:2] == (str(node), cv2.CAP_V4L2)


def test_a_number_means_the_node_of_that_number(device: FakeDevice, clock: ManualClock) -> None:
    camera = OpenCvCamera(OpenCvOptions(device=947), clock, device)
    with pytest.raises(DeviceOpenError, match="there is no camera /dev/video947; is it plugged in"):
        camera.open()


def test_a_real_file_that_is_no_camera_is_refused(node: Path, clock: ManualClock) -> None:
    camera = OpenCvCamera(OpenCvOptions(device=str(node)), clock)
    with pytest.raises(DeviceOpenError, match="cannot be opened: it is a file; the driver 'video' plays"):
        camera.open()
    with pytest.raises(DeviceClosedError):
        camera.read()


def test_a_device_that_is_not_ours_says_which_group_opens_it(
    node: Path, clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(DeviceOpenError, match="this user may not use it; add this user to the group 'video'"):
        OpenCvCamera(OpenCvOptions(device=str(node)), clock).open()


@pytest.mark.parametrize(
    ("in_use", "words"),
    [(True, r"another program is using it: .+ \(process \d+\)"), (False, "does not answer as a camera")],
)
def test_a_device_that_does_not_open_says_why(
    clock: ManualClock, monkeypatch: pytest.MonkeyPatch, in_use: bool, words: str
) -> None:
    monkeypatch.setattr("stadimeter.cameras.opencv_device.is_in_use", lambda _node: in_use)
    with pytest.raises(DeviceOpenError, match=words):
        OpenCvCamera(OpenCvOptions(device="/dev/null"), clock).open()


def test_a_device_that_another_program_has_open_is_in_use_by_that_program(tmp_path: Path) -> None:
    node = tmp_path / "video0"
    node.touch()
    assert in_use(str(node)) == f"another program is using it; close that one (`sudo fuser -v {node}` names it)"
    waits = [sys.executable, "-c", f"file = open({str(node)!r}); print(flush=True); import sys; sys.stdin.read()"]
    with subprocess.Popen(waits, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        name = Path(f"/proc/{other.pid}/comm").read_text().strip()
        words = f"another program is using it: {name} (process {other.pid}); close that one"
        assert in_use(str(node)) == in_use(f"{tmp_path}/video*") == words
        other.communicate()


def test_a_stream_that_nobody_sends_is_refused_without_showing_the_password() -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
        address = f"http://me:secret@127.0.0.1:{port}/cam?token=hidden"
        camera = OpenCvCamera(OpenCvOptions(device=address), MonotonicClock())
        with pytest.raises(DeviceOpenError, match=f"the stream http://127.0.0.1:{port}/cam") as raised:
            camera.open()
    assert "secret" not in str(raised.value)
    assert "hidden" not in str(raised.value)


def test_the_address_in_a_file_is_read_anew_at_each_opening_and_the_file_stands_for_it_in_messages(
    device: FakeDevice, tmp_path: Path, clock: ManualClock
) -> None:
    device.wait = lambda: clock.advance_s(1 / 30)
    file = tmp_path / "camera.txt"
    camera = OpenCvCamera(OpenCvOptions(device_file=file), clock, device)
    with pytest.raises(DeviceOpenError, match=r"camera\.txt, cannot be read: there is no such file"):
        camera.open()
    for password in ("secret", "changed"):
        file.write_text(f"rtsp://me:{password}@10.0.0.9/live\n")
        camera.open()
        assert device.source[:2] == (f"rtsp://me:{password}@10.0.0.9/live", cv2.CAP_FFMPEG)
    camera.close()
    with pytest.raises(DeviceClosedError, match=r"the camera named in .*camera\.txt is not open"):
        camera.read()


@pytest.mark.parametrize("table", [{}, {"device": 0, "device_file": "camera.txt"}])
def test_a_camera_has_one_device(table: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="either device or device_file"):
        OpenCvOptions.model_validate(table)


def test_a_stream_gets_time_limits_and_no_device_settings(device: FakeDevice, clock: ManualClock) -> None:
    camera_of(device, "rtsp://10.0.0.9/live", clock, read_timeout="700 ms").open()
    source, api, params = device.source
    assert (source, api) == ("rtsp://10.0.0.9/live", cv2.CAP_FFMPEG)
    limits = dict(zip(params[::2], params[1::2], strict=True))
    assert limits[cv2.CAP_PROP_READ_TIMEOUT_MSEC] == 700
    assert limits[cv2.CAP_PROP_OPEN_TIMEOUT_MSEC] > 0
    assert device.calls == []


def test_settings_that_were_not_taken_are_told_and_do_no_harm(
    device: FakeDevice, node: Path, clock: ManualClock
) -> None:
    device.fixed.add(cv2.CAP_PROP_FPS)
    device.values[cv2.CAP_PROP_FPS] = 10
    camera = camera_of(device, node, clock, width_px=1280, height_px=720, rate="30 Hz")
    camera.open()
    rate, size = camera.remarks
    assert "30 frames a second" in rate
    assert "1280 × 720" in size
    assert camera.read().width_px == 640


@pytest.mark.parametrize(
    ("table", "fixed", "exposure_s"),
    [
        ({"exposure": "5 ms"}, {}, 0.005),
        ({"exposure": "5 ms"}, {cv2.CAP_PROP_EXPOSURE: 156.0}, 0.0156),
        ({"exposure": "5 ms"}, {cv2.CAP_PROP_AUTO_EXPOSURE: 3.0}, None),
        ({}, {cv2.CAP_PROP_EXPOSURE: 156.0}, None),
    ],
)
def test_frames_carry_the_exposure_that_the_device_holds_and_none_that_it_chooses(
    device: FakeDevice,
    node: Path,
    clock: ManualClock,
    table: dict[str, Any],
    fixed: dict[int, float],
    exposure_s: float | None,
) -> None:
    device.fixed |= set(fixed)
    device.values |= fixed
    camera = camera_of(device, node, clock, **table)
    camera.open()
    assert camera.read().exposure_s == (None if exposure_s is None else pytest.approx(exposure_s))


def test_a_device_that_opens_but_gives_no_picture_is_an_error_that_tells_the_settings(
    device: FakeDevice, node: Path, clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    device.fixed.add(cv2.CAP_PROP_FOURCC)
    monkeypatch.setattr(device, "grab", lambda: False)
    with pytest.raises(DeviceOpenError, match=r"opens but gives no picture \(asked for the pixel format MJPG"):
        camera_of(device, node, clock).open()
    assert device.is_released


def test_a_damaged_picture_is_passed_over(device: FakeDevice, node: Path, clock: ManualClock) -> None:
    camera = camera_of(device, node, clock)
    device.images = [picture(1), None, picture(2, (480, 640)), picture(3)]
    camera.open()
    assert camera.read().image[0, 0, 0] == 3


def jpeg_row(level: int, lost: int = 0) -> np.ndarray:
    """Return a JPEG as OpenCV gives it that shall not decode it: a row of bytes; some may be missing inside."""
    noise = np.random.default_rng(level).integers(0, 60, (480, 640, 3), dtype=np.uint8)
    data = cv2.imencode(".jpg", picture(level) + noise)[1].ravel()
    return np.delete(data, slice(len(data) // 2, len(data) // 2 + lost))[np.newaxis]


def test_a_jpeg_that_lacks_something_inside_is_passed_over(device: FakeDevice, node: Path, clock: ManualClock) -> None:
    camera = camera_of(device, node, clock)
    device.images = [jpeg_row(10), jpeg_row(50, lost=700), jpeg_row(90)]
    camera.open()
    assert device.values[cv2.CAP_PROP_CONVERT_RGB] == 0
    assert camera.read().image.mean() == pytest.approx(120, abs=3)
    assert camera.remarks == ()


def test_a_camera_whose_every_jpeg_is_damaged_is_used_as_opencv_decodes_it_and_a_remark_says_so(
    device: FakeDevice, node: Path, clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    damaged = jpeg_row(50, lost=700)

    def retrieve() -> tuple[bool, np.ndarray]:
        clock.advance_s(0.5)
        return True, picture(3) if device.values.get(cv2.CAP_PROP_CONVERT_RGB) else damaged

    monkeypatch.setattr(device, "retrieve", retrieve)
    camera = camera_of(device, node, clock)
    camera.open()
    assert camera.read().image[0, 0, 0] == 3
    assert "damage goes unnoticed" in camera.remarks[0]


def test_a_device_that_converts_all_the_same_is_believed(device: FakeDevice, node: Path, clock: ManualClock) -> None:
    device.fixed.add(cv2.CAP_PROP_CONVERT_RGB)
    camera = camera_of(device, node, clock)
    device.images = [picture(1), picture(3)]
    camera.open()
    assert camera.read().image[0, 0, 0] == 3
    assert camera.remarks == ()


def test_a_camera_that_stays_silent_times_out_and_may_be_read_again(
    device: FakeDevice, node: Path, clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = camera_of(device, node, clock)
    camera.open()
    with monkeypatch.context() as silent:
        silent.setattr(device, "grab", lambda: clock.advance_s(1.0) is not None)
        with pytest.raises(CaptureTimeoutError, match="no whole picture"):
            camera.read()
    assert camera.read().sequence == 0


def test_a_longer_time_limit_outlasts_the_wait_of_the_driver(
    device: FakeDevice, node: Path, clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = camera_of(device, node, clock, read_timeout="3 s")
    camera.open()
    answers = iter([False, False, True])

    def grab() -> bool:
        clock.advance_s(0.9)
        return next(answers)

    monkeypatch.setattr(device, "grab", grab)
    assert camera.read().captured_at_s == pytest.approx(1002.7)


def test_a_camera_that_was_pulled_out_is_lost(device: FakeDevice, node: Path, clock: ManualClock) -> None:
    camera = camera_of(device, node, clock)
    camera.open()
    device.is_connected = False
    with pytest.raises(LinkLostError, match="has stopped answering"):
        camera.read()
    node.unlink()
    with pytest.raises(LinkLostError, match="video0 is gone"):
        camera.read()


def test_the_first_frame_has_its_true_age_where_the_driver_stamps_it_also_after_opening_again(
    device: FakeDevice, node: Path, clock: ManualClock
) -> None:
    def wait() -> None:
        clock.advance_s(0.033)
        device.values[cv2.CAP_PROP_POS_MSEC] = 1e3 * (clock.now_s() - 0.08)

    device.wait = wait
    camera = camera_of(device, node, clock)
    for _ in range(2):
        camera.open()
        captured_at_s = camera.read().captured_at_s
        assert clock.now_s() - captured_at_s == pytest.approx(0.08)


def test_a_stream_s_position_is_never_taken_for_a_stamp(device: FakeDevice, clock: ManualClock) -> None:
    camera = camera_of(device, "rtsp://10.0.0.9/live", clock)

    def wait() -> None:
        clock.advance_s(0.1)
        device.values[cv2.CAP_PROP_POS_MSEC] = 1e3 * (clock.now_s() - 0.03)

    device.wait = wait
    camera.open()
    for _ in range(GOOD_STAMPS_NEEDED + 1):
        assert camera.read().captured_at_s == pytest.approx(clock.now_s())


def test_frames_that_waited_in_a_device_without_stamps_are_passed_over(
    device: FakeDevice, node: Path, clock: ManualClock
) -> None:
    pauses = enumerate([0.05] * 20 + [0.6, 0.001, 0.001, 0.001] + [0.05] * 20, start=1)

    def wait() -> None:
        number, pause_s = next(pauses)
        clock.advance_s(pause_s)
        device.images = [picture(number)]

    device.wait = wait
    camera = camera_of(device, node, clock)
    camera.open()
    levels, ages_s = [], []
    for _ in range(25):
        frame = camera.read()
        levels.append(int(frame.image[0, 0, 0]))
        ages_s.append(clock.now_s() - frame.captured_at_s)
    assert levels[:19] == list(range(2, 21)), "the first was taken when it was opened"
    assert not {21, 22, 23, 24} & set(levels), "those that waited"
    assert max(ages_s) == 0.0


def test_a_stamp_of_the_kernel_is_right_on_a_run_s_clock_that_is_another(
    device: FakeDevice, node: Path, clock: ManualClock
) -> None:
    options = OpenCvOptions.model_validate({"device": str(node)})
    camera = OpenCvCamera(options, clock, device, monotonic=lambda: clock.now_s() - 900.0)
    camera.open()
    for _ in range(GOOD_STAMPS_NEEDED + 1):
        clock.advance_s(0.1)
        device.values[cv2.CAP_PROP_POS_MSEC] = 1e3 * (clock.now_s() - 900.03)
        frame = camera.read()
    assert frame.captured_at_s == pytest.approx(clock.now_s() - 0.03)


def test_a_stated_latency_counts_into_the_age_of_a_stream(device: FakeDevice, clock: ManualClock) -> None:
    camera = camera_of(device, "rtsp://10.0.0.9/live", clock, latency="150 ms")
    camera.open()
    assert camera.read().captured_at_s == pytest.approx(clock.now_s() - 0.15)
    assert camera.not_for_motion == ""


def test_a_read_that_does_not_end_lets_close_return_and_releases_the_device_itself(
    device: FakeDevice, node: Path, clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stadimeter.cameras.live_camera.CLOSE_WAIT_S", 0.01)
    camera = camera_of(device, node, clock)
    camera.open()
    reading, go_on = threading.Event(), threading.Event()
    monkeypatch.setattr(device, "grab", lambda: reading.set() is None and go_on.wait(120))
    errors: list[BaseException] = []

    def read() -> None:
        try:
            camera.read()
        except DeviceClosedError as error:
            errors.append(error)

    reader = threading.Thread(target=read)
    reader.start()
    assert reading.wait(120)
    camera.close()
    assert not device.is_released
    with pytest.raises(DeviceHungError, match="still busy with a read that does not end"):
        camera.open()
    go_on.set()
    reader.join(120)
    assert device.is_released
    assert len(errors) == 1


def test_of_a_stream_that_cannot_be_opened_nothing_but_our_own_error_is_printed() -> None:
    opens = "from stadimeter.cli.main import app; app(['snapshot', '--live', 'opencv,device=rtsp://127.0.0.1:1/cam'])"
    environment = {name: text for name, text in os.environ.items() if not name.startswith("OPENCV")}
    ran = subprocess.run([sys.executable, "-c", opens], env=environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 2
    (line,) = ran.stderr.splitlines()
    assert line.startswith("error: the stream rtsp://127.0.0.1:1/cam cannot be opened")
