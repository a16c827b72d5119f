from __future__ import annotations

import os
import struct
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from stadimeter.cameras.video_file import VideoFileCamera, VideoFileOptions
from stadimeter.config.plugins import CAMERAS, DriverContext, load_driver
from stadimeter.core.frame import Frame
from stadimeter.errors import DeviceClosedError, EndOfFramesError, PictureError
from stadimeter.testing.rig import ManualClock
from support.programs import needs

CODECS = {"ramp.avi": "MJPG", "ramp.mp4": "mp4v"}


def write_ramp(path: Path, frames: int = 20, rate_hz: float = 25.0) -> Path:
    """Write a video that gets brighter by 10 levels a frame."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*CODECS[path.name]), rate_hz, (64, 48))
    assert writer.isOpened()
    for number in range(frames):
        writer.write(np.full((48, 64, 3), 10 * number, np.uint8))
    writer.release()
    return path


def frames_to_end(camera: VideoFileCamera) -> Iterator[Frame]:
    camera.open()
    with suppress(EndOfFramesError):
        while True:
            yield camera.read()
    camera.close()


def set_avi_rate(path: Path, rate_hz: int) -> None:
    """Change the rate in an AVI file's stream header."""
    data = bytearray(path.read_bytes())
    scale_at = data.index(b"strh") + 8 + 20
    data[scale_at : scale_at + 8] = struct.pack("<II", 1, rate_hz)
    path.write_bytes(data)


def refusal(path: Path) -> str:
    camera = VideoFileCamera(path, None, ManualClock())
    with pytest.raises(PictureError) as raised:
        camera.open()
    message = str(raised.value)
    assert str(path) in message
    assert "\n" not in message
    with pytest.raises(DeviceClosedError):
        camera.read()
    return message


@pytest.mark.parametrize("name", CODECS)
def test_every_frame_comes_once_in_order_and_at_its_time(tmp_path: Path, name: str) -> None:
    clock = ManualClock(7.0)
    frames = list(frames_to_end(VideoFileCamera(write_ramp(tmp_path / name), None, clock)))
    assert [round(float(frame.image.mean()) / 10) for frame in frames] == list(range(20))
    assert [frame.captured_at_s for frame in frames] == pytest.approx([7.0 + number / 25.0 for number in range(20)])
    assert clock.now_s() == frames[-1].captured_at_s
    assert {frame.source for frame in frames} == {str(tmp_path / name)}


def test_a_rate_without_sense_must_be_replaced(tmp_path: Path) -> None:
    path = write_ramp(tmp_path / "ramp.avi", frames=3)
    set_avi_rate(path, 5000)
    assert "frame rate (5000 Hz); set 'rate'" in refusal(path)
    assert len(list(frames_to_end(VideoFileCamera(path, 30.0, ManualClock())))) == 3


@pytest.mark.parametrize(
    ("data", "words"), [(None, "there is no such file"), (b"", "is empty"), (b"hello\n" * 1000, "not a video")]
)
def test_what_is_no_video_is_refused_with_the_reason(tmp_path: Path, data: bytes | None, words: str) -> None:
    path = tmp_path / "text.mp4"
    if data is not None:
        path.write_bytes(data)
    assert words in refusal(path)


def test_a_video_whose_index_was_cut_off_is_refused(tmp_path: Path) -> None:
    path = write_ramp(tmp_path / "ramp.mp4")
    path.write_bytes(path.read_bytes()[:-200])
    assert "or it is damaged" in refusal(path)


@needs("ffmpeg")
def test_a_video_that_ends_long_before_its_header_says_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "cut.mp4"
    whole = write_ramp(tmp_path / "ramp.mp4")
    subprocess.run(["ffmpeg", "-v", "error", "-i", whole, "-c", "copy", "-movflags", "faststart", path], check=True)
    data = path.read_bytes()
    start = data.index(b"mdat")
    path.write_bytes(data[: start + (len(data) - start) // 2])
    camera = VideoFileCamera(path, None, ManualClock())
    frames = frames_to_end(camera)
    assert next(frames)
    with pytest.raises(PictureError, match=r"ends after \d+ of 20 frames: it is damaged"):
        list(frames)
    with pytest.raises(EndOfFramesError):
        camera.read()
    camera.close()


def test_the_driver_is_built_from_its_options(tmp_path: Path) -> None:
    path = write_ramp(tmp_path / "ramp.avi", frames=2)
    assert load_driver(CAMERAS, "video") is VideoFileOptions
    options = VideoFileOptions.model_validate({"path": str(path), "rate": "5 Hz"})
    camera = options.build(DriverContext(name="camera", clock=ManualClock()))
    assert [frame.captured_at_s for frame in frames_to_end(camera)] == [0.0, 0.2]


@pytest.mark.parametrize("table", [{}, {"path": "a.mp4", "rate": "0 Hz"}, {"path": "a.mp4", "fps": 3}])
def test_options_that_make_no_sense_are_refused(table: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        VideoFileOptions.model_validate(table)


@pytest.mark.long
def test_the_ball_video_plays_to_its_end(real_pictures: Path) -> None:
    clock = ManualClock()
    camera = VideoFileCamera(real_pictures / "ball_video" / "green_ball.mp4", None, clock)
    count = 0
    for count, frame in enumerate(frames_to_end(camera), start=1):
        assert (frame.width_px, frame.height_px) == (640, 480)
        assert frame.captured_at_s == pytest.approx((count - 1) * 1001 / 24000)
    assert count == 1004
    assert clock.now_s() == pytest.approx(1003 / 23.976, abs=0.01)


def test_a_video_that_loops_begins_again_at_its_end(tmp_path: Path) -> None:
    path = write_ramp(tmp_path / "ramp.avi", frames=3)
    camera = VideoFileOptions(path=path, loop=True).build(DriverContext(name="camera", clock=ManualClock()))
    camera.open()
    frames = [camera.read() for _ in range(5)]
    assert [round(float(frame.image.mean()), -1) for frame in frames] == [0, 10, 20, 0, 10]
    assert [frame.captured_at_s for frame in frames] == pytest.approx([0.0, 0.04, 0.08, 0.12, 0.16])
    camera.close()


@pytest.mark.parametrize("name", ["a:b.avi", "2026-01-01T10:00:00.avi", "http:x.avi", "~$b.avi"])
def test_a_name_that_looks_like_an_address_is_a_file(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_ramp(tmp_path / "ramp.avi").rename(tmp_path / name)
    monkeypatch.chdir(tmp_path)
    camera = VideoFileCamera(Path(name), None, ManualClock())
    camera.open()
    assert camera.read().image.shape[2] == 3
    camera.close()


def test_a_name_that_is_no_text_is_refused_and_does_not_end_the_process(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"b\xe4d.avi")
    write_ramp(tmp_path / "ramp.avi").rename(path)
    with pytest.raises(PictureError, match="name that is not UTF-8 text"):
        VideoFileCamera(path, None, ManualClock()).open()
