from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from stadimeter.cameras.image_files import PLUGIN, ImageFilesCamera, ImageFilesOptions
from stadimeter.cameras.picture import load_picture
from stadimeter.config.plugins import CAMERAS, DriverContext, load_plugin
from stadimeter.core.frame import Frame
from stadimeter.errors import EndOfFramesError, PictureError
from stadimeter.testing.manual_clock import ManualClock


def write_grey(path: Path, level: int) -> Path:
    cv2.imwrite(str(path), np.full((12, 16, 3), level, np.uint8))
    return path


def camera_of(*paths: Path | str, rate_hz: float = 1.0, clock: ManualClock | None = None) -> ImageFilesCamera:
    return ImageFilesCamera(tuple(str(path) for path in paths), rate_hz, clock or ManualClock())


def all_frames(camera: ImageFilesCamera) -> list[Frame]:
    frames: list[Frame] = []
    camera.open()
    with suppress(EndOfFramesError):
        while len(frames) < 100:
            frames.append(camera.read())
    return frames


def test_files_come_in_the_order_given(tmp_path: Path) -> None:
    second, first = (write_grey(tmp_path / name, 9) for name in ("a.png", "b.png"))
    assert [frame.source for frame in all_frames(camera_of(first, second))] == [str(first), str(second)]


def test_the_picture_is_the_file_s(tmp_path: Path) -> None:
    frame = all_frames(camera_of(write_grey(tmp_path / "a.png", 123)))[0]
    assert np.array_equal(frame.image, load_picture(tmp_path / "a.png").image)


def test_a_pattern_and_a_folder_come_in_the_order_of_names(tmp_path: Path) -> None:
    for name in ("c.png", "a.png", "b.JPG"):
        write_grey(tmp_path / name, 50)
    (tmp_path / "truth.csv").write_text("picture,distance\n")
    (tmp_path / "d.png").mkdir()
    assert [Path(frame.source).name for frame in all_frames(camera_of(f"{tmp_path}/[ac].png"))] == ["a.png", "c.png"]
    (tmp_path / "d.png").rmdir()
    assert [Path(frame.source).name for frame in all_frames(camera_of(tmp_path))] == ["a.png", "b.JPG", "c.png"]


def test_a_file_whose_name_looks_like_a_pattern_is_that_file(tmp_path: Path) -> None:
    path = write_grey(tmp_path / "ball[1].png", 50)
    write_grey(tmp_path / "ball1.png", 60)
    assert [frame.source for frame in all_frames(camera_of(path))] == [str(path)]


def test_after_the_last_picture_comes_the_end(tmp_path: Path) -> None:
    camera = camera_of(write_grey(tmp_path / "a.png", 1))
    camera.open()
    camera.read()
    for _ in range(2):
        with pytest.raises(EndOfFramesError, match="every picture has been shown"):
            camera.read()


def test_time_passes_as_the_rate_says(tmp_path: Path) -> None:
    clock = ManualClock(50.0)
    for number in range(4):
        write_grey(tmp_path / f"{number}.png", number)
    camera = camera_of(tmp_path, rate_hz=4.0, clock=clock)
    camera.open()
    clock.advance_s(10.0)
    assert [camera.read().captured_at_s for _ in range(4)] == [60.0, 60.25, 60.5, 60.75]
    assert clock.now_s() == 60.75


def test_a_bad_picture_is_told_once_and_the_next_one_comes_at_its_time(tmp_path: Path) -> None:
    write_grey(tmp_path / "1.png", 1)
    (tmp_path / "2.png").touch()
    write_grey(tmp_path / "3.png", 3)
    camera = camera_of(tmp_path)
    camera.open()
    camera.read()
    with pytest.raises(PictureError, match=r"2\.png is empty"):
        camera.read()
    frame = camera.read()
    assert Path(frame.source).name == "3.png"
    assert frame.captured_at_s == 2.0


@pytest.mark.parametrize(
    ("path", "cause"),
    [
        ("absent.png", "no picture and no folder"),
        ("*.png", "no file matches the pattern"),
        (".", "no picture in the f"),
    ],
)
def test_what_is_not_there_is_noticed_when_opening(tmp_path: Path, path: str, cause: str) -> None:
    (tmp_path / "notes.txt").touch()
    with pytest.raises(PictureError, match=cause) as raised:
        camera_of(tmp_path / path).open()
    assert str(tmp_path) in str(raised.value)


def test_the_driver_is_built_from_its_options(tmp_path: Path) -> None:
    write_grey(tmp_path / "a.png", 1)
    write_grey(tmp_path / "b.png", 2)
    assert load_plugin(CAMERAS, "images") is PLUGIN
    options = ImageFilesOptions.model_validate({"paths": str(tmp_path), "rate": "2 Hz"})
    camera = PLUGIN.build(options, DriverContext(name="camera", clock=ManualClock()))
    assert [frame.captured_at_s for frame in all_frames(camera)] == [0.0, 0.5]


def test_without_a_rate_there_is_one_picture_a_second() -> None:
    assert ImageFilesOptions.model_validate({"paths": ["a.png"]}).rate == 1.0


@pytest.mark.parametrize(
    "table", [{}, {"paths": []}, {"paths": ["a.png"], "rate": "0 Hz"}, {"paths": ["a.png"], "rate": 2}]
)
def test_options_that_make_no_sense_are_refused(table: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        ImageFilesOptions.model_validate(table)
