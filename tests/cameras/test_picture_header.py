"""How coarsely colour is stored: from the header of a picture, or from what a camera is known to send."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.cameras.image_files import ImageFilesCamera, load_picture
from stadimeter.cameras.image_files import subsampling_of as subsampling_in
from stadimeter.cameras.opencv_device import OpenCvOptions
from stadimeter.cameras.opencv_settings import subsampling_of
from stadimeter.core.frame import SUBSAMPLINGS
from stadimeter.testing.rig import ManualClock

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]

SAMPLING = {
    "4:4:4": cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    "4:2:2": cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422,
    "4:2:0": cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
}


def jpeg(sampling: int, *more: int, channels: int = 3) -> bytes:
    image = np.full((48, 64, channels), 90, np.uint8)
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling, *more])
    assert done
    return data.tobytes()


@pytest.mark.parametrize("kind", ["baseline", "progressive"])
@pytest.mark.parametrize("subsampling", SUBSAMPLINGS)
def test_a_jpeg_says_how_coarsely_it_stores_colour(tmp_path: Path, subsampling: str, kind: str) -> None:
    path = tmp_path / "picture.jpg"
    path.write_bytes(jpeg(SAMPLING[subsampling], cv2.IMWRITE_JPEG_PROGRESSIVE, int(kind == "progressive")))
    assert load_picture(path).subsampling == subsampling


def test_a_grey_jpeg_has_no_colour_to_store() -> None:
    assert subsampling_in(jpeg(SAMPLING["4:2:0"], channels=1)) == "4:4:4"


def test_other_ways_of_storing_less_colour_count_as_the_coarsest() -> None:
    assert subsampling_in(jpeg(cv2.IMWRITE_JPEG_SAMPLING_FACTOR_411)) == "4:2:0"
    assert subsampling_in(jpeg(cv2.IMWRITE_JPEG_SAMPLING_FACTOR_440)) == "4:2:0"


def test_only_lossy_webp_stores_less_colour() -> None:
    image = np.full((48, 64, 3), 90, np.uint8)
    lossy, whole = (cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, each])[1].tobytes() for each in (80, 101))
    assert (subsampling_in(lossy), subsampling_in(whole)) == ("4:2:0", "4:4:4")
    assert subsampling_in(cv2.imencode(".png", image)[1].tobytes()) == "4:4:4"


@given(cut=st.integers(0, 300), damaged=st.binary(max_size=20), at=st.integers(0, 300))
def test_a_damaged_header_is_no_error(cut: int, damaged: bytes, at: int) -> None:
    data = jpeg(SAMPLING["4:2:0"])
    assert subsampling_in(data[:cut]) in SUBSAMPLINGS
    assert subsampling_in(data[:at] + damaged + data[at + len(damaged) :]) in SUBSAMPLINGS


def test_frames_of_picture_files_say_it(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(jpeg(SAMPLING["4:2:0"]))
    cv2.imwrite(str(tmp_path / "b.png"), np.zeros((48, 64, 3), np.uint8))
    camera = ImageFilesCamera((str(tmp_path),), 1.0, ManualClock())
    camera.open()
    assert [camera.read().subsampling for _ in range(2)] == ["4:2:0", "4:4:4"]


@pytest.mark.parametrize(
    ("table", "subsampling"),
    [
        ({"device": 0}, "4:2:0"),
        ({"device": 0, "fourcc": "YUYV"}, "4:2:2"),
        ({"device": 0, "fourcc": "NV12"}, "4:2:0"),
        ({"device": 0, "fourcc": "BGR3"}, "4:4:4"),
        ({"device": "rtsp://camera/live", "fourcc": "YUYV"}, "4:2:0"),
    ],
)
def test_a_camera_stores_colour_as_its_pixel_format_does(table: dict[str, object], subsampling: str) -> None:
    assert subsampling_of(OpenCvOptions.model_validate(table)) == subsampling
