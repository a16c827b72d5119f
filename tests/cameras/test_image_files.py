from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.cameras import image_files
from stadimeter.cameras.image_files import ImageFilesCamera, ImageFilesOptions, Picture, load_picture
from stadimeter.config.plugins import CAMERAS, DriverContext, load_driver
from stadimeter.core.frame import Frame
from stadimeter.errors import EndOfFramesError, PictureError
from stadimeter.testing.rig import ManualClock


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
    assert load_driver(CAMERAS, "images") is ImageFilesOptions
    options = ImageFilesOptions.model_validate({"paths": str(tmp_path), "rate": "2 Hz"})
    camera = options.build(DriverContext(name="camera", clock=ManualClock()))
    assert [frame.captured_at_s for frame in all_frames(camera)] == [0.0, 0.5]


def looping(*paths: Path, **options: object) -> ImageFilesCamera:
    given = {"paths": [str(path) for path in paths], "loop": True, **options}
    camera: ImageFilesCamera = ImageFilesOptions.model_validate(given).build(
        DriverContext(name="camera", clock=ManualClock())
    )
    camera.open()
    return camera


def test_the_first_picture_follows_the_last_while_time_goes_on(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        write_grey(tmp_path / name, 50)
    camera = looping(tmp_path, rate="2 Hz")
    frames = [camera.read() for _ in range(5)]
    assert [Path(frame.source).stem for frame in frames] == ["a", "b", "a", "b", "a"]
    assert [frame.captured_at_s for frame in frames] == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert [frame.sequence for frame in frames] == [0, 1, 2, 3, 4]


def test_a_picture_that_is_added_is_shown_from_the_next_round_on(tmp_path: Path) -> None:
    write_grey(tmp_path / "a.png", 50)
    camera = looping(tmp_path)
    camera.read()
    write_grey(tmp_path / "b.png", 50)
    assert [Path(camera.read().source).stem for _ in range(2)] == ["a", "b"]


def test_a_picture_stays_for_as_many_frames_as_fit_into_its_time(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        write_grey(tmp_path / name, 50)
    camera = looping(tmp_path, rate="10 Hz", dwell="300 ms")
    assert [Path(camera.read().source).stem for _ in range(8)] == ["a", "a", "a", "b", "b", "b", "a", "a"]


def test_a_loop_without_a_readable_picture_ends_rather_than_turning_for_ever(tmp_path: Path) -> None:
    (tmp_path / "a.png").touch()
    camera = looping(tmp_path)
    with pytest.raises(PictureError, match="is empty"):
        camera.read()
    with pytest.raises(EndOfFramesError):
        camera.read()


def test_pictures_are_looked_at_again_only_when_they_have_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [write_grey(tmp_path / name, 50) for name in ("a.png", "b.png")]
    looked: list[str] = []

    def look(file: Path) -> Picture:
        looked.append(file.name)
        return load_picture(file)

    monkeypatch.setattr(image_files, "load_picture", look)
    options = ImageFilesOptions(paths=(tmp_path,))
    assert [options.lacks(), options.lacks()] == [(), ()]
    assert looked == ["a.png", "b.png"]
    cv2.imwrite(str(paths[1]), np.full((16, 12, 3), 50, np.uint8))
    os.utime(paths[1], ns=(0, 0))  # whatever the file system's clock counts in
    (words,) = options.lacks()
    assert "b.png" in words
    assert looked == ["a.png", "b.png", "b.png"]
