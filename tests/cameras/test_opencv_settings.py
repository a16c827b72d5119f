from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from stadimeter.cameras.opencv_device import OpenCvCamera, OpenCvOptions
from stadimeter.cameras.opencv_settings import (
    FFMPEG_OPTIONS,
    apply_settings,
    size_differs,
)
from stadimeter.testing.rig import ManualClock
from support.each_case import each_case

if TYPE_CHECKING:
    from conftest import FakeDevice

EVERYTHING = {
    "device": 0, "width_px": 1280, "height_px": 720, "rate": "30 Hz", "exposure": "5 ms", "autofocus": False,
}  # fmt: skip


def options(**table: Any) -> OpenCvOptions:
    return OpenCvOptions.model_validate({"device": 0, **table})


def test_settings_are_applied_in_the_order_that_drivers_need(device: FakeDevice) -> None:
    assert apply_settings(device, options(**EVERYTHING)) == ()
    assert device.calls == [
        (cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG")),
        (cv2.CAP_PROP_FRAME_WIDTH, 1280),
        (cv2.CAP_PROP_FRAME_HEIGHT, 720),
        (cv2.CAP_PROP_FPS, 30),
        (cv2.CAP_PROP_AUTO_EXPOSURE, 1),
        (cv2.CAP_PROP_EXPOSURE, 50),
        (cv2.CAP_PROP_AUTOFOCUS, 0),
    ]


def test_without_wishes_only_format_exposure_and_focus_are_set(device: FakeDevice) -> None:
    assert apply_settings(device, options()) == ()
    assert [prop for prop, _ in device.calls] == [
        cv2.CAP_PROP_FOURCC, cv2.CAP_PROP_AUTO_EXPOSURE, cv2.CAP_PROP_AUTOFOCUS,
    ]  # fmt: skip
    assert device.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 3


@pytest.mark.parametrize(
    ("prop", "found", "table", "sentence"),
    [
        (cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"YUYV"), {}, "pixel format MJPG, the camera gives YUYV"),
        (cv2.CAP_PROP_FOURCC, -1.0, {}, "pixel format MJPG, the camera gives another"),
        (cv2.CAP_PROP_FPS, 15.0, {"rate": "30 Hz"}, "asked for 30 frames a second, the camera says 15"),
        (cv2.CAP_PROP_AUTO_EXPOSURE, 1.0, {}, "asked for automatic exposure"),
        (cv2.CAP_PROP_AUTO_EXPOSURE, 3.0, {"exposure": "5 ms"}, "asked for manual exposure"),
        (cv2.CAP_PROP_EXPOSURE, 156.0, {"exposure": "5 ms"}, "exposure of 5 ms, the camera says 15.6 ms"),
        (cv2.CAP_PROP_AUTOFOCUS, 1.0, {}, "asked for a fixed focus, the camera keeps refocusing"),
        (cv2.CAP_PROP_AUTOFOCUS, 0.0, {"autofocus": True}, "asked for autofocus, the camera has none"),
    ],
)
def test_what_the_driver_substitutes_is_told(
    device: FakeDevice, prop: int, found: float, table: dict[str, Any], sentence: str
) -> None:
    device.fixed.add(prop)
    device.values[prop] = found
    differ = apply_settings(device, options(**table))
    assert len(differ) == 1
    assert sentence in differ[0]


def test_a_camera_without_exposure_and_focus_controls_gives_no_reason_to_complain(device: FakeDevice) -> None:
    device.fixed |= {cv2.CAP_PROP_AUTO_EXPOSURE, cv2.CAP_PROP_AUTOFOCUS}
    assert apply_settings(device, options()) == ()


def test_the_size_is_judged_by_the_picture() -> None:
    picture = np.zeros((480, 640, 3), np.uint8)
    assert size_differs(picture, options()) == ()
    assert size_differs(picture, options(width_px=640, height_px=480)) == ()
    (sentence,) = size_differs(picture, options(width_px=1280, height_px=720))
    assert "1280 × 720" in sentence
    assert "640 × 480" in sentence


@each_case(
    "table",
    [
        {"device": -1},
        {"device": True},
        {"device": "video0"},
        {"device": 0, "width_px": 640},
        {"device": 0, "height_px": 480},
        {"device": 0, "width_px": 0, "height_px": 0},
        {"device": 0, "fourcc": "MJPEG"},
        {"device": 0, "read_timeout": "0 s"},
        {"device": 0, "exposure": 5},
        {"device": 0, "speed": 5},
        {},
    ],
)
def test_options_that_make_no_sense_are_refused(table: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        OpenCvOptions.model_validate(table)


@pytest.mark.parametrize(
    ("device_option", "is_stream"),
    [(0, False), ("/dev/v4l/by-id/usb-cam-index0", False), ("rtsp://10.0.0.9/live", True), ("http://cam/v", True)],
)
def test_a_device_is_a_number_a_path_or_an_address(device_option: int | str, is_stream: bool) -> None:
    assert OpenCvOptions.model_validate({"device": device_option}).is_stream is is_stream


@each_case(
    ("table", "missing"),
    [
        ({"device": 0}, []),
        ({"device": "/dev/video0", "latency": "30 ms"}, []),
        ({"device": "http://cam/stream"}, ["latency"]),
        ({"device": "RTSP://cam/live", "latency": "0 s"}, []),
        ({"device": "tcp://cam:8888", "latency": "100 ms"}, []),
        ({"device": "udp://127.0.0.1:5000"}, ["latency", "accept_lossy_stream"]),
        ({"device": "srt://cam:9000", "latency": "100 ms"}, ["accept_lossy_stream"]),
        ({"device": "rtp://127.0.0.1:5000", "latency": "100 ms", "accept_lossy_stream": True}, []),
    ],
)
def test_nothing_moves_on_a_stream_of_unknown_age_or_with_losses(table: dict[str, object], missing: list[str]) -> None:
    options = OpenCvOptions.model_validate(table)
    assert list(options.refuse_motion()) == missing
    why = OpenCvCamera(options, ManualClock()).not_for_motion
    assert why == next(iter(options.refuse_motion().values()), "")
    assert all(key in sentence for key, sentence in options.refuse_motion().items())


def test_rtsp_over_udp_loses_packets(monkeypatch: pytest.MonkeyPatch) -> None:
    options = OpenCvOptions.model_validate({"device": "rtsp://cam/live", "latency": "100 ms"})
    assert "rtsp_transport;tcp" in os.environ[FFMPEG_OPTIONS]
    monkeypatch.setenv(FFMPEG_OPTIONS, "rtsp_transport;udp")
    assert list(options.refuse_motion()) == ["accept_lossy_stream"]


def test_what_is_no_camera_is_refused_without_its_password() -> None:
    with pytest.raises(ValueError, match="is not a camera") as raised:
        OpenCvOptions.model_validate({"device": "me:secret@10.0.0.9/live"})
    assert "secret" not in str(raised.value.errors()[0]["msg"])
