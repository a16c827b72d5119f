from __future__ import annotations

import gc
import importlib.machinery
import importlib.metadata
import sys
import threading
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from stadimeter.app.clock import MonotonicClock
from stadimeter.cameras import live_camera, picamera2_camera
from stadimeter.cameras.picamera2_camera import (
    BUFFERS,
    SETTLING_FRAMES,
    Picamera2Camera,
    Picamera2Options,
    load_package,
)
from stadimeter.config import extras
from stadimeter.core.frame import Optics
from stadimeter.errors import (
    CaptureTimeoutError,
    DeviceClosedError,
    DeviceHungError,
    DeviceOpenError,
    DriverUnavailableError,
    LinkLostError,
)
from stadimeter.testing.rig import ManualClock, eventually
from support.each_case import each_case
from support.picamera2_double import AfMode, AwbMode, Camera, Request, Sensor, frame_image, install


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(1000.0)


@pytest.fixture
def sensor(clock: ManualClock) -> Sensor:
    return Sensor(clock)


def camera_on(sensor: Sensor, **table: Any) -> Picamera2Camera:
    options = Picamera2Options.model_validate({"width_px": 66, "height_px": 48, **table})
    return Picamera2Camera(options, sensor.clock, sensor.package, monotonic=sensor.clock.now_s)


def age_of_next_s(camera: Picamera2Camera, sensor: Sensor) -> float:
    captured_at_s = camera.read().captured_at_s
    return sensor.clock.now_s() - captured_at_s


def test_padded_rows_become_a_picture_with_blue_first(sensor: Sensor) -> None:
    camera = camera_on(sensor)
    camera.open()
    image = camera.read().image
    assert image.shape == (48, 66, 3)
    assert np.array_equal(image, frame_image(int(image[0, 0, 0]), 66, 48))
    assert image.flags["C_CONTIGUOUS"]
    assert image.flags["OWNDATA"], "it is copied once, and shows no buffer of the camera"


def test_the_capture_time_is_when_the_exposure_of_the_first_row_began(sensor: Sensor) -> None:
    camera = camera_on(sensor, exposure="8 ms", gain=2)
    camera.open()
    # A frame is completed `way_s` after its read-out began, which is at the end of the exposure.
    assert age_of_next_s(camera, sensor) == pytest.approx(sensor.way_s + 0.008, abs=0.006)


def test_frames_carry_the_exposure_of_each_of_them(sensor: Sensor) -> None:
    camera = camera_on(sensor)
    camera.open()
    assert camera.read().exposure_s == pytest.approx(0.00999)
    sensor.keeps = {"ExposureTime": 25_000}
    assert camera.read().exposure_s == pytest.approx(0.025)


def test_how_old_frames_are_on_arrival_follows_from_rate_and_exposure(sensor: Sensor) -> None:
    camera = camera_on(sensor, exposure="8 ms", rate="30 Hz")
    camera.open()
    latency_s = Picamera2Options.model_validate({"exposure": "8 ms", "rate": "30 Hz"}).frame_latency_s()
    assert age_of_next_s(camera, sensor) == pytest.approx(latency_s, abs=0.01)


def test_every_frame_is_read_where_nothing_waits(sensor: Sensor) -> None:
    camera = camera_on(sensor, rate="50 Hz")
    camera.open()
    times_s = [camera.read().captured_at_s for _ in range(20)]
    assert np.diff(times_s) == pytest.approx(np.full(19, 0.02))


def test_frames_that_waited_from_before_the_call_are_passed_over(sensor: Sensor) -> None:
    camera = camera_on(sensor)
    camera.open()
    sensor.waiting_s = [0.9, 0.5]
    assert age_of_next_s(camera, sensor) < 0.1


def test_a_camera_that_is_always_slow_still_gives_its_frames_with_their_age(sensor: Sensor) -> None:
    sensor.way_s = 0.4
    camera = camera_on(sensor)
    camera.open()
    assert age_of_next_s(camera, sensor) == pytest.approx(0.41, abs=0.01)


def test_no_buffer_is_kept(sensor: Sensor) -> None:
    camera = camera_on(sensor)
    camera.open()
    for _ in range(3 * BUFFERS):
        sensor.waiting_s = [0.5]
        camera.read()
    assert len(sensor.cameras[0]._free) == BUFFERS


@pytest.mark.parametrize(
    ("table", "controls"),
    [
        ({}, {"FrameDurationLimits": (33333, 33333), "AwbEnable": True, "AwbMode": AwbMode.Auto}),
        ({}, {"AfMode": AfMode.Manual, "LensPosition": 1.0}),
        ({"rate": "50 Hz"}, {"FrameDurationLimits": (20000, 20000)}),
        ({"exposure": "50 ms"}, {"ExposureTime": 50000, "FrameDurationLimits": (50000, 50000)}),
        ({"exposure": "5 ms", "gain": 4}, {"ExposureTime": 5000, "AnalogueGain": 4.0, "AeEnable": False}),
        ({"exposure": "5 ms"}, {"AeEnable": None, "AnalogueGain": None}),
        ({"white_balance": "daylight"}, {"AwbEnable": True, "AwbMode": AwbMode.Daylight}),
        ({"colour_gains": [2.1, 1.4]}, {"AwbEnable": False, "ColourGains": (2.1, 1.4)}),
        ({"focus": "50 cm"}, {"AfMode": AfMode.Manual, "LensPosition": 2.0}),
        ({"lens_position_dpt": 0}, {"AfMode": AfMode.Manual, "LensPosition": 0.0}),
        ({"autofocus": True}, {"AfMode": AfMode.Continuous}),
    ],
)
def test_settings_become_controls_before_the_camera_starts(
    sensor: Sensor, table: dict[str, Any], controls: dict[str, Any]
) -> None:
    camera = camera_on(sensor, **table)
    camera.open()
    given = sensor.configurations[-1]["controls"]
    assert {name: given.get(name) for name in controls} == controls
    assert camera.remarks == () or "autofocus" in table


def test_mode_crop_and_turning_are_asked_for_and_a_camera_that_does_not_turn_says_so(sensor: Sensor) -> None:
    crop_px = [1152, 648, 2304, 1296]
    camera = camera_on(sensor, sensor_width_px=2304, sensor_height_px=1296, crop_px=crop_px, upside_down=True)
    camera.open()
    asked = sensor.configurations[-1]
    assert asked["sensor"] == {"output_size": (2304, 1296)}
    assert (asked["transform"].hflip, asked["transform"].vflip) == (True, True)
    assert sensor.cameras[0]._settings["ScalerCrop"] == tuple(crop_px)
    assert camera.remarks == ()
    camera.close()
    sensor.turns = False
    camera.open()
    assert camera.remarks == ("asked for pictures turned by half a turn, the camera does not turn them so",)


@pytest.mark.parametrize(
    ("table", "keeps", "remark"),
    [
        ({"rate": "60 Hz"}, {"FrameDurationLimits": (33333, 33333)}, "60 frames a second, the camera gives 30"),
        ({"exposure": "20 ms"}, {"ExposureTime": 9000}, "an exposure of 20 ms, the camera takes 9 ms"),
        ({"gain": 40}, {"AnalogueGain": 16.0}, "a gain of 40, the camera takes 16"),
        ({"colour_gains": [2, 1]}, {"ColourGains": (2.0, 1.5)}, "colour gains of 2, 1, the camera takes 2, 1.5"),
        ({"lens_position_dpt": 4}, {"LensPosition": 1.0}, "a lens at 4 dioptres, it stands at 1"),
        ({"crop_px": [0, 0, 9, 9]}, {"ScalerCrop": (0, 0, 128, 128)}, "9, 9], the camera takes [0, 0, 128, 128]"),
        ({"sensor_width_px": 4000, "sensor_height_px": 2200}, {}, "the nearest that it has is 4608 × 2592"),
    ],
)
def test_a_setting_that_was_not_taken_is_told(
    sensor: Sensor, table: dict[str, Any], keeps: dict[str, Any], remark: str
) -> None:
    sensor.keeps = keeps
    camera = camera_on(sensor, **table)
    camera.open()
    (told,) = camera.remarks
    assert told.startswith("asked for")
    assert remark in told
    assert camera.read().width_px == 66


@pytest.mark.parametrize(
    ("table", "lacks", "remark"),
    [
        ({"focus": "1 m"}, {"LensPosition", "AfMode"}, "asked for a focus, this camera's lens has no motor"),
        ({"autofocus": True}, {"LensPosition", "AfMode"}, "asked for autofocus, the camera has none"),
        ({"autofocus": True}, set[str](), "the camera refocuses by itself"),
        ({"gain": 2}, {"AnalogueGain"}, "asked for a gain, the camera has no control for it"),
    ],
)
def test_what_a_camera_cannot_do_is_told_and_does_no_harm(
    sensor: Sensor, table: dict[str, Any], lacks: set[str], remark: str
) -> None:
    sensor.lacks = lacks
    camera = camera_on(sensor, **table)
    camera.open()
    assert any(each.startswith(remark) for each in camera.remarks), camera.remarks
    camera.read()


def test_a_lens_and_a_sensor_get_some_frames_before_a_setting_counts_as_not_taken(sensor: Sensor) -> None:
    sensor.acts_after = SETTLING_FRAMES - 2
    camera = camera_on(sensor, exposure="5 ms", gain=4, lens_position_dpt=3)
    camera.open()
    assert camera.remarks == ()


def test_a_camera_that_falls_silent_times_out_and_gives_frames_when_it_is_back(sensor: Sensor) -> None:
    camera = camera_on(sensor, read_timeout="300 ms")
    camera.open()
    sensor.is_silent = True
    for _ in range(2):
        began_s = sensor.clock.now_s()
        with pytest.raises(CaptureTimeoutError, match="is its cable loose"):
            camera.read()
        assert sensor.clock.now_s() - began_s == pytest.approx(0.3, abs=0.02)
    sensor.is_silent = False
    assert age_of_next_s(camera, sensor) < 0.1


def test_without_a_camera_the_cable_is_named(sensor: Sensor) -> None:
    sensor.is_there = False
    with pytest.raises(DeviceOpenError, match="libcamera finds no camera; is the ribbon cable in"):
        camera_on(sensor).open()


def test_a_camera_that_another_program_holds_is_said_to_be_in_use(sensor: Sensor) -> None:
    camera_on(sensor).open()
    with pytest.raises(DeviceOpenError, match=r"cannot be opened: another program is using it.*busy"):
        camera_on(sensor).open()


@pytest.mark.long
def test_attempts_to_open_a_busy_camera_leave_no_descriptors_open(sensor: Sensor) -> None:
    camera_on(sensor).open()
    other = camera_on(sensor)
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(50):
        with pytest.raises(DeviceOpenError, match="another program is using it"):
            other.open()
    gc.collect()
    assert len(list(Path("/proc/self/fd").iterdir())) <= before


def test_an_error_of_libcamera_while_it_looks_for_cameras_is_one_of_ours(
    sensor: Sensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = camera_on(sensor)
    package = sensor.package()

    def fail() -> None:
        raise RuntimeError("Failed to start camera manager")

    monkeypatch.setattr(package.Picamera2, "global_camera_info", staticmethod(fail))
    monkeypatch.setattr(camera, "_load", lambda: package)
    with pytest.raises(DeviceOpenError, match="cannot be opened: Failed to start camera manager"):
        camera.open()


def test_a_camera_without_frames_cannot_be_opened_and_is_let_go(sensor: Sensor) -> None:
    sensor.is_silent = True
    camera = camera_on(sensor)
    with pytest.raises(DeviceOpenError, match="opens but gives no picture; check both ends of its cable"):
        camera.open()
    assert sensor.held == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "YUYV"}, "gives YUYV instead of colour pictures"),
        ({"is_stamped": False}, "does not say when it took"),
    ],
)
def test_a_usb_camera_is_sent_to_its_driver(sensor: Sensor, change: dict[str, Any], words: str) -> None:
    for name, value in change.items():
        setattr(sensor, name, value)
    with pytest.raises(DeviceOpenError, match=f"{words}.*for a USB camera use the driver 'opencv'"):
        camera_on(sensor).open()
    assert sensor.held == 0


def test_an_error_of_libcamera_is_a_lost_link(sensor: Sensor, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = camera_on(sensor)
    camera.open()

    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("Camera in Configured state trying queueRequest()\nrequiring state Running")

    monkeypatch.setattr(Camera, "capture_request", fail)
    with pytest.raises(
        LinkLostError, match=r"has failed: Camera in Configured state trying queueRequest\(\) requiring"
    ):
        camera.read()


def test_a_camera_that_cannot_be_closed_holds_nobody_up_and_is_not_opened_again_meanwhile(
    sensor: Sensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_camera, "CLOSE_WAIT_S", 0.05)
    monkeypatch.setattr(picamera2_camera, "CLOSE_WAIT_S", 0.05)
    camera = camera_on(sensor)
    camera.open()
    sensor.let_go.clear()
    camera.close()
    with pytest.raises(DeviceHungError, match="is still being closed: libcamera hangs"):
        camera.open()
    sensor.let_go.set()
    closer = camera._closer
    assert closer is not None
    closer.join(120)
    camera.open()
    camera.read()


def test_a_camera_is_let_go_by_a_read_that_outlasts_closing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_camera, "CLOSE_WAIT_S", 0.05)
    monkeypatch.setattr(picamera2_camera, "CLOSE_WAIT_S", 0.05)
    sensor = Sensor(MonotonicClock())
    camera = camera_on(sensor)
    camera.open()
    in_vendor_code, go_on = threading.Event(), threading.Event()

    def hang(request: Request) -> dict[str, Any]:
        in_vendor_code.set()
        go_on.wait(120)
        return request.metadata

    monkeypatch.setattr(Request, "get_metadata", hang)
    errors = list[Exception]()
    thread = threading.Thread(target=_read_until_error, args=(camera, errors))
    thread.start()
    assert in_vendor_code.wait(120)
    camera.close()
    assert sensor.held == 1
    go_on.set()
    thread.join(120)
    eventually(lambda: sensor.held == 0)
    assert isinstance(errors[0], DeviceClosedError)


def test_closing_breaks_off_a_read_that_waits_for_a_silent_camera() -> None:
    sensor = Sensor(MonotonicClock())
    camera = camera_on(sensor, read_timeout="30 s")
    camera.open()
    sensor.is_silent = True
    errors = list[Exception]()
    thread = threading.Thread(target=_read_until_error, args=(camera, errors))
    thread.start()
    eventually(lambda: sensor.cameras[0]._jobs)
    camera.close()
    thread.join(120)
    assert isinstance(errors[0], DeviceClosedError)
    assert sensor.held == 0


def _read_until_error(camera: Picamera2Camera, errors: list[Exception]) -> None:
    try:
        while True:
            camera.read()
    except Exception as error:  # noqa: BLE001 - the test looks at it
        errors.append(error)


@pytest.mark.parametrize("named", [0, "imx708", "/base/axi/pcie@1000120000/rp1/i2c@88000/imx708@1a"])
def test_a_camera_is_meant_by_number_model_or_path(sensor: Sensor, named: int | str) -> None:
    camera_on(sensor, camera=named).open()
    assert sensor.held == 1


def test_a_camera_that_is_not_there_is_answered_with_those_that_are(sensor: Sensor) -> None:
    with pytest.raises(
        DeviceOpenError, match=r"there is no camera 'imx219' for camera in \[camera\]; there are: 0 \(imx708"
    ):
        camera_on(sensor, camera="imx219").open()


@each_case(
    ("table", "words"),
    [
        ({"sensor_width_px": 2304}, "sensor_width_px and sensor_height_px go together"),
        ({"focus": "1 m", "autofocus": True}, "focus, lens_position_dpt and autofocus exclude each other"),
        ({"colour_gains": [2, 1], "white_balance": "indoor"}, "white_balance and colour_gains exclude each other"),
        ({"exposure": "50 ms", "rate": "30 Hz"}, 'longer than a frame at 30 Hz; write rate = "20 Hz" or less'),
        ({"crop_px": [0, 0, 0, 10]}, "crop_px is left, top, width and height"),
        ({"width_px": 65}, "multiple of 2"),
    ],
)
def test_options_that_contradict_each_other_are_refused(table: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Picamera2Options.model_validate(table)


def test_an_installed_package_is_loaded_and_lacks_nothing(sensor: Sensor, monkeypatch: pytest.MonkeyPatch) -> None:
    install(sensor, monkeypatch)
    assert Picamera2Options().lacks() == ()
    options = Picamera2Options(width_px=66, height_px=48)
    camera = Picamera2Camera(options, sensor.clock, monotonic=sensor.clock.now_s)
    camera.open()
    assert camera.read().width_px == 66


def test_attached_cameras_are_those_on_ribbon_cables(sensor: Sensor, monkeypatch: pytest.MonkeyPatch) -> None:
    install(sensor, monkeypatch)
    (found,) = Picamera2Options.attached()
    assert (found.name, found.path, found.options) == ("imx708", sensor.path, {"camera": sensor.path})
    assert found.choice == f"picamera2,camera={sensor.path}"


def test_without_the_package_nothing_is_attached_and_what_is_missing_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, clock: ManualClock
) -> None:
    for name in ("picamera2", "libcamera"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(picamera2_camera, "find_spec", lambda _name: None)
    monkeypatch.setattr(extras, "SYSTEM_PACKAGES", tmp_path)
    assert Picamera2Options.attached() == ()
    (lack,) = Picamera2Options().lacks()
    assert "not installed: `sudo apt install python3-picamera2 && python3 -m venv " in lack
    assert "--system-site-packages" in lack
    with pytest.raises(DriverUnavailableError, match="sudo apt install python3-picamera2"):
        Picamera2Camera(Picamera2Options(), clock).open()
    (tmp_path / "picamera2").mkdir()
    assert "installed, but not seen" in Picamera2Options().lacks()[0]
    from_pip = ModuleSpec("picamera2", None)
    monkeypatch.setattr(picamera2_camera, "find_spec", lambda name: from_pip if name == "picamera2" else None)
    assert "picamera2 is there without libcamera, which pip does not have: `sudo apt" in Picamera2Options().lacks()[0]


@pytest.mark.parametrize(
    ("found", "is_too_old"), [("0.3.18", True), ("0.3.9", True), ("0.3.20", False), ("0.4", False), (None, False)]
)
def test_a_version_that_is_too_old_is_known_before_it_is_loaded(
    monkeypatch: pytest.MonkeyPatch, found: str | None, is_too_old: bool
) -> None:
    def version(name: str) -> str:
        if found is None:
            raise importlib.metadata.PackageNotFoundError(name)
        return found

    monkeypatch.setattr(picamera2_camera, "find_spec", lambda name: ModuleSpec(name, None))
    monkeypatch.setattr(picamera2_camera, "version", version)
    assert ("too old" in picamera2_camera.lack()) is is_too_old


def test_a_package_for_another_numpy_or_of_old_is_told_from_one_that_is_missing(
    sensor: Sensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(sensor, monkeypatch, Picamera2=object)
    with pytest.raises(DriverUnavailableError, match=r"this picamera2 is too old: before 0\.3\.20"):
        load_package()

    class Broken(importlib.machinery.SourceFileLoader):
        def exec_module(self, module: ModuleType) -> None:
            raise ValueError("numpy.dtype size changed, may indicate binary incompatibility")

    class Finder:
        @staticmethod
        def find_spec(name: str, *_: object) -> importlib.machinery.ModuleSpec | None:
            return importlib.machinery.ModuleSpec(name, Broken(name, "")) if name == "picamera2" else None

    monkeypatch.delitem(sys.modules, "picamera2")
    monkeypatch.setattr(sys, "meta_path", [Finder, *sys.meta_path])
    with pytest.raises(DriverUnavailableError, match=r"numpy\.dtype size changed.*pip install 'numpy<2'"):
        load_package()


def test_frames_carry_the_settings_that_change_the_focal_length(sensor: Sensor) -> None:
    camera = camera_on(sensor, sensor_width_px=2304, sensor_height_px=1296, focus="50 cm", upside_down=True)
    camera.open()
    before = camera.read().optics
    assert before == Optics(
        sensor="imx708",
        sensor_size_px=(2304, 1296),
        crop_px=(0, 0, 4608, 2592),
        lens_position_dpt=2.0,
        upside_down=True,
    )
    assert camera.read().optics is before
    camera.close()
    sensor.keeps = {"ScalerCrop": (768, 432, 3072, 1728)}
    camera.open()
    after = camera.read().optics
    assert after is not None
    assert after.crop_px == (768, 432, 3072, 1728)


@pytest.mark.parametrize("table", [{"autofocus": True}, {}])
def test_a_lens_that_moves_or_is_turned_by_hand_has_no_position(sensor: Sensor, table: dict[str, Any]) -> None:
    sensor.lacks = set() if table else {"LensPosition", "AfMode"}
    camera = camera_on(sensor, **table)
    camera.open()
    optics = camera.read().optics
    assert optics is not None
    assert optics.lens_position_dpt is None


def test_a_stamp_of_the_future_is_not_believed(sensor: Sensor) -> None:
    camera = camera_on(sensor)
    camera.open()
    sensor.waiting_s = [-5.0] * 3
    assert age_of_next_s(camera, sensor) > 0
    assert not sensor.waiting_s
