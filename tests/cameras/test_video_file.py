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
    ("data", "words"),
    [(None, "there is no such file"), (b"", "is empty"), (b"hello\n" * 1000, "not a video"),
     (b"\xff\xd8\xff\xe0", "begins as a picture, not as a video")],
)  # fmt: skip
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
    path.write_bytes(data[: start + 4])
    with pytest.raises(
        PictureError, match=r"after 0 of .* a kind that OpenCV lacks.* `ffmpeg -i cut.mp4 NEW.mp4` converts"
    ):
        next(frames_to_end(VideoFileCamera(path, None, ManualClock())))


def convert(source: Path, target: Path, *words: str) -> Path:
    subprocess.run(["ffmpeg", "-v", "error", "-i", source, *words, target], check=True)
    return target


@needs("ffmpeg")
def test_frames_of_a_variable_rate_come_at_the_times_of_the_file(tmp_path: Path) -> None:
    ramp = write_ramp(tmp_path / "ramp.avi")
    slower = "setpts=if(lt(N\\,10)\\,N\\,10+3*(N-10))/25/TB"  # a third of the rate after ten frames
    varied = convert(ramp, tmp_path / "varied.mp4", "-vf", slower, "-fps_mode", "vfr", "-c:v", "mpeg4")
    expected_s = [0.04 * (number if number < 10 else 10 + 3 * (number - 10)) for number in range(20)]
    camera = VideoFileCamera(varied, None, ManualClock(7.0), loops=True)
    camera.open()
    times_s = [camera.read().captured_at_s - 7.0 for _ in range(21)]
    camera.close()
    assert times_s[:20] == pytest.approx(expected_s, abs=1e-3)
    assert times_s[19] < times_s[20] < times_s[19] + 0.2
    assert camera.remarks == ()
    steady = [frame.captured_at_s for frame in frames_to_end(VideoFileCamera(varied, 10.0, ManualClock()))]
    assert steady == pytest.approx([0.1 * number for number in range(20)])


def test_a_rate_that_is_a_guess_is_said_to_be_one(real_pictures: Path) -> None:
    path = real_pictures / "cases" / "no-rate.h264"
    camera, clock = VideoFileCamera(path, None, ManualClock()), ManualClock()
    assert len(list(frames_to_end(camera))) == 60
    assert "25 Hz is a guess" in camera.remarks[0]
    known = VideoFileCamera(path, 30.0, clock)
    assert len(list(frames_to_end(known))) == 60
    assert (known.remarks, clock.now_s()) == ((), pytest.approx(59 / 30))


def test_jpegs_behind_one_another_are_a_video_and_no_picture(tmp_path: Path) -> None:
    data = [cv2.imencode(".jpg", np.full((48, 64, 3), 20 * number, np.uint8))[1].tobytes() for number in range(4)]
    (tmp_path / "v.mjpeg").write_bytes(b"".join(data))
    camera = VideoFileCamera(tmp_path / "v.mjpeg", None, ManualClock())
    assert [round(float(frame.image.mean()), -1) for frame in frames_to_end(camera)] == [0, 20, 40, 60]
    assert "is a guess" in camera.remarks[0]
    timed = VideoFileCamera(write_ramp(tmp_path / "ramp.avi").rename(tmp_path / "v.mjpg"), None, ManualClock())
    assert len(list(frames_to_end(timed))) == 20
    assert timed.remarks == ()


@needs("ffmpeg")
@pytest.mark.parametrize("is_after_another", [False, True])
def test_interlaced_video_is_shown_or_refused_and_never_shows_what_was_in_memory(
    tmp_path: Path, is_after_another: bool
) -> None:
    """OpenCV 5 does not convert it; the memory of its frames is empty, or still has those of the video before."""
    path = convert(
        write_ramp(tmp_path / "ramp.avi"),
        tmp_path / "tv.mpg",
        "-c:v",
        "mpeg2video",
        "-flags",
        "+ilme+ildct",
        "-r",
        "25",
    )
    if is_after_another:
        assert len(list(frames_to_end(VideoFileCamera(tmp_path / "ramp.avi", None, ManualClock())))) == 20
    try:
        frames = list(frames_to_end(VideoFileCamera(path, None, ManualClock())))
    except PictureError as error:
        assert "interlaced" in str(error)  # noqa: PT017 - or it is shown
    else:
        assert [round(float(frame.image.mean()) / 10) for frame in frames][:20] == list(range(20))


@needs("ffmpeg")
def test_a_video_of_one_picture_that_stands_still_is_shown(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "still.png"), np.full((48, 64, 3), 90, np.uint8))
    path = convert(tmp_path / "still.png", tmp_path / "still.mp4", "-vf", "loop=9:1", "-c:v", "mpeg4")
    assert len(list(frames_to_end(VideoFileCamera(path, None, ManualClock())))) == 10


def test_the_driver_is_built_from_its_options(tmp_path: Path) -> None:
    path = write_ramp(tmp_path / "ramp.avi", frames=2)
    assert load_driver(CAMERAS, "video") is VideoFileOptions
    options = VideoFileOptions.model_validate({"path": str(path), "rate": "5 Hz"})
    camera = options.build(DriverContext(name="camera", clock=ManualClock()))
    assert [frame.captured_at_s for frame in frames_to_end(camera)] == [0.0, 0.2]


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
