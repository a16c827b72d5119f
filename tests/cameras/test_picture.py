from __future__ import annotations

import os
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import stadimeter
from stadimeter.cameras.image_files import load_picture
from stadimeter.core.frame import Image
from stadimeter.errors import PictureError

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]

KINDS = {
    "baseline.jpg": [cv2.IMWRITE_JPEG_QUALITY, 95],
    "progressive.jpg": [cv2.IMWRITE_JPEG_PROGRESSIVE, 1],
    "restart.jpg": [cv2.IMWRITE_JPEG_RST_INTERVAL, 2],
    "plain.png": [],
}


def encode(image: np.ndarray, suffix: str, params: list[int] | None = None) -> bytes:
    done, data = cv2.imencode(suffix, image, params or [])
    assert done
    return data.tobytes()


def with_exif(jpeg: bytes, exif: bytes) -> bytes:
    segment = b"Exif\0\0" + exif
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + jpeg[2:]


def turned(jpeg: bytes, orientation: int) -> bytes:
    return with_exif(jpeg, b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0))


def refusal(path: Path) -> str:
    with pytest.raises(PictureError) as raised:
        load_picture(path)
    message = str(raised.value)
    assert str(path) in message
    assert "\n" not in message
    return message


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tif", ".ppm"])
def test_a_picture_without_loss_comes_back_as_it_was(tmp_path: Path, scene: Image, suffix: str) -> None:
    path = tmp_path / f"scene{suffix}"
    path.write_bytes(encode(scene, suffix))
    assert np.array_equal(load_picture(path).image, scene)


@pytest.mark.parametrize("name", KINDS)
def test_a_whole_file_is_read(tmp_path: Path, scene: Image, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(encode(scene, path.suffix, KINDS[name]))
    assert np.abs(load_picture(path).image.astype(int) - scene).mean() < 3


@pytest.mark.parametrize("name", KINDS)
@given(part=st.floats(0.01, 1, exclude_max=True))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_file_that_was_cut_anywhere_is_refused(tmp_path: Path, scene: Image, name: str, part: float) -> None:
    path = tmp_path / name
    data = encode(scene, path.suffix, KINDS[name])
    path.write_bytes(data[: int(part * len(data))])
    refusal(path)


@pytest.mark.parametrize("name", KINDS)
def test_a_file_that_lost_its_last_byte_is_said_to_be_cut_short(tmp_path: Path, scene: Image, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(encode(scene, path.suffix, KINDS[name])[:-1])
    assert "cut short" in refusal(path)


@pytest.mark.parametrize("suffix", [".bmp", ".tif", ".ppm", ".webp"])
@pytest.mark.parametrize("part", [0.3, 0.9])
def test_other_kinds_that_were_cut_are_refused_too(tmp_path: Path, scene: Image, suffix: str, part: float) -> None:
    path = tmp_path / f"cut{suffix}"
    data = encode(scene, suffix)
    path.write_bytes(data[: int(part * len(data))])
    refusal(path)


def test_the_end_of_a_thumbnail_is_not_taken_for_the_end_of_the_picture(tmp_path: Path, scene: Image) -> None:
    path = tmp_path / "camera.jpg"
    thumbnail = encode(scene[::4, ::4], ".jpg")
    data = with_exif(encode(scene, ".jpg"), b"MM\0*" + struct.pack(">IH", 8, 0) + bytes(4) + thumbnail)
    path.write_bytes(data)
    assert load_picture(path).image.shape == scene.shape
    path.write_bytes(data[: len(data) * 3 // 4])
    assert "cut short" in refusal(path)


def test_bytes_after_the_end_of_a_jpeg_do_no_harm(tmp_path: Path, scene: Image) -> None:
    path = tmp_path / "phone.jpg"
    path.write_bytes(encode(scene, ".jpg") + b"MotionPhoto\xff\x00" * 20)
    assert load_picture(path).image.shape == scene.shape


def test_a_turned_camera_s_picture_is_turned_upright(tmp_path: Path, scene: Image) -> None:
    path = tmp_path / "turned.jpg"
    upright = tmp_path / "upright.jpg"
    upright.write_bytes(encode(scene, ".jpg"))
    path.write_bytes(turned(encode(scene, ".jpg"), orientation=6))
    assert np.array_equal(load_picture(path).image, cv2.rotate(load_picture(upright).image, cv2.ROTATE_90_CLOCKWISE))


def test_grey_becomes_three_equal_channels(tmp_path: Path, scene: Image) -> None:
    path = tmp_path / "grey.png"
    grey = scene[..., 1]
    path.write_bytes(encode(grey, ".png"))
    assert np.array_equal(load_picture(path).image, np.dstack([grey] * 3))


@pytest.mark.parametrize("channels", [1, 3])
def test_the_upper_8_of_16_bits_are_kept(tmp_path: Path, channels: int) -> None:
    path = tmp_path / "deep.png"
    shape = (20, 30) if channels == 1 else (20, 30, 3)
    deep = np.random.default_rng(1).integers(0, 65536, shape, dtype=np.uint16)
    path.write_bytes(encode(deep, ".png"))
    upper = np.asarray(deep >> 8, int).reshape(20, 30, channels)
    assert np.abs(load_picture(path).image - upper).max() <= 1


def test_transparency_is_dropped(tmp_path: Path, scene: Image) -> None:
    path = tmp_path / "glass.png"
    path.write_bytes(encode(np.dstack([scene, np.full(scene.shape[:2], 77, np.uint8)]), ".png"))
    assert np.array_equal(load_picture(path).image, scene)


def test_what_is_no_file_with_data_is_refused_and_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    assert "there is no such file" in refusal(tmp_path / "absent.jpg")
    assert "is a folder" in refusal(tmp_path)
    (tmp_path / "empty.jpg").touch()
    assert "is empty" in refusal(tmp_path / "empty.jpg")
    path = tmp_path / "pipe.jpg"
    os.mkfifo(path)
    assert "not a regular file" in refusal(path)


@pytest.mark.parametrize("data", [b"hello world\n" * 50, b"\0" * 1000, b"RIFF\x10\0\0\0WAVEfmt", b"\0\0\0 ftypheic"])
def test_a_file_of_another_kind_is_said_not_to_be_a_picture(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "letter.jpg"
    path.write_bytes(data)
    assert "not a picture" in refusal(path)


@pytest.mark.parametrize("data", [b"RIFF\x10\0\0\0AVI LIST", b"\0\0\0 ftypisom\0\0", b"\x1aE\xdf\xa3" + b"\0" * 20])
def test_a_video_is_said_to_be_one(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "drive"
    path.write_bytes(data)
    assert refusal(path).startswith(f"this is a video: {path}; ")


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_picture_with_its_end_but_a_broken_middle_does_not_crash(tmp_path: Path, scene: Image, suffix: str) -> None:
    path = tmp_path / f"broken{suffix}"
    data = encode(scene, suffix)
    path.write_bytes(data[:20] + b"\xff" * 40 + data[60:])
    refusal(path)


@pytest.mark.parametrize("name", ["baseline.jpg", "progressive.jpg", "restart.jpg"])
@pytest.mark.parametrize("part", [0.2, 0.5, 0.8])
def test_a_jpeg_that_lacks_something_inside_is_refused(tmp_path: Path, scene: Image, name: str, part: float) -> None:
    """OpenCV would fill the rest with what it decoded last, and what is seen there would be measured."""
    data = encode(scene, ".jpg", KINDS[name])
    at = int(part * len(data))
    path = tmp_path / name
    path.write_bytes(data[:at] + data[at + 700 :])
    assert "damaged inside" in refusal(path)


def test_filling_before_the_end_marker_as_some_cameras_put_it_is_no_damage(tmp_path: Path, scene: Image) -> None:
    data = encode(scene, ".jpg")
    path = tmp_path / "filled.jpg"
    path.write_bytes(data[:-2] + b"\0\0\0\0" + data[-2:])
    assert load_picture(path).image.shape == scene.shape


def test_a_real_picture_that_lacks_700_bytes_inside_is_refused(real_pictures: Path) -> None:
    assert "damaged inside" in refusal(real_pictures / "cases" / "damaged-inside.jpg")


def test_every_picture_that_opencv_decodes_was_checked_to_be_whole() -> None:
    texts = {file: file.read_text("utf-8") for file in Path(stadimeter.__file__).parent.rglob("*.py")}
    assert [file.name for file, text in texts.items() if "imdecode(" in text] == ["files.py"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_a_file_that_may_not_be_read_says_so(tmp_path: Path, scene: Image) -> None:
    path = tmp_path / "secret.png"
    path.write_bytes(encode(scene, ".png"))
    path.chmod(0)
    assert "permission denied" in refusal(path)


@pytest.mark.parametrize("folder", ["chessboard", "seed_sheet", "tags", "charuco"])
def test_pictures_of_real_cameras_are_whole(real_pictures: Path, folder: str) -> None:
    paths = [path for path in (real_pictures / folder).rglob("*") if path.suffix.lower() in {".jpg", ".jpeg", ".png"}]
    assert paths
    for path in paths:
        assert load_picture(path).image.ndim == 3
