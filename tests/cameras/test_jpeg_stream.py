"""JPEGs of a stream that are whole, cut, or lack something inside."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.cameras.image_files import load_picture
from stadimeter.cameras.mjpeg_stream import JpegStream
from stadimeter.core.frame import Image
from stadimeter.errors import PictureError


def coded(scene: Image, quality: int = 85, interval: int = 0) -> bytes:
    settings = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_RST_INTERVAL, interval]
    return cv2.imencode(".jpg", scene, settings)[1].tobytes()


@pytest.mark.parametrize("interval", [0, 4], ids=["plain", "restart markers"])
@pytest.mark.parametrize("end", [b"", b"\xff\xd9"], ids=["no end", "end appended"])
@pytest.mark.parametrize("kept", [0.1, 0.4, 0.7, 0.95, 0.995])
def test_a_jpeg_of_a_stream_that_was_cut_is_refused(scene: Image, kept: float, end: bytes, interval: int) -> None:
    data = coded(scene, interval=interval)
    assert np.array_equal(JpegStream().decode(data), cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))
    with pytest.raises(PictureError, match="the picture is damaged"):
        JpegStream().decode(data[: round(kept * len(data))] + end)


def test_bytes_that_are_missing_inside_a_jpeg_of_a_stream_are_mostly_noticed(scene: Image) -> None:
    data, rng, noticed = coded(scene), np.random.default_rng(5), 0
    for _ in range(200):
        at, lost = int(rng.integers(700, len(data) - 10)), int(rng.integers(1, 1500))
        try:
            JpegStream().decode(data[:at] + data[at + lost :])
        except PictureError:
            noticed += 1
    assert noticed >= 180


def filled(data: bytes, count: int) -> bytes:
    return data[:-2] + b"\x55" * count + data[-2:]


def is_refused(stream: JpegStream, data: bytes) -> bool:
    try:
        stream.decode(data)
    except PictureError:
        return True
    return False


def test_filling_before_the_end_is_no_damage_in_a_stream_that_has_it_often(scene: Image) -> None:
    data, stream = coded(scene), JpegStream()
    refused = [is_refused(stream, filled(data, number % 9)) for number in range(60)]
    assert not any(refused[10:])
    assert np.array_equal(stream.decode(filled(data, 8)), stream.decode(data))
    assert is_refused(stream, filled(data, 100))


def test_filling_in_a_stream_that_has_none_is_damage(scene: Image) -> None:
    data, stream = coded(scene), JpegStream()
    assert not any(is_refused(stream, data) for _ in range(20))
    assert all(is_refused(stream, filled(data, number)) for number in (2, 5, 8))
    assert not is_refused(stream, data)


@pytest.mark.long
@pytest.mark.parametrize("subsampling", [0x411111, 0x211111, 0x221111], ids=["4:4:4", "4:2:2", "4:2:0"])
def test_a_picture_that_lacks_a_byte_and_is_much_brighter_or_darker_from_there_on_is_refused(subsampling: int) -> None:
    noise = np.random.default_rng(7).normal(0, 1, (480, 640, 3))
    scene = np.clip(110 + 1200 * cv2.GaussianBlur(noise, (0, 0), 25) + 2 * noise, 0, 255).astype(np.uint8)
    settings = [cv2.IMWRITE_JPEG_QUALITY, 80, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, subsampling]
    data = cv2.imencode(".jpg", scene, settings)[1].tobytes()
    whole, shifted, missed, rng = JpegStream().decode(data).astype(int), 0, 0, np.random.default_rng(8)
    for _ in range(150):
        stream, at = JpegStream(), int(rng.integers(700, len(data) - 2))
        stream.decode(data)
        damaged = data[:at] + data[at + 1 :]
        plain = cv2.imdecode(np.frombuffer(damaged, np.uint8), cv2.IMREAD_COLOR)
        is_shifted = (np.abs(plain - whole).max(axis=2) > 40).mean() > 0.1
        shifted += is_shifted
        missed += is_shifted and not is_refused(stream, damaged)
    assert shifted > 15, "the damage is there to be found"
    assert missed <= 1


def test_an_edge_along_blocks_that_stays_is_refused_once_at_most() -> None:
    scene = np.full((480, 640, 3), 60, np.uint8)
    scene[240:] = 180  # a table before a wall
    stream = JpegStream()
    assert [is_refused(stream, coded(scene)) for _ in range(4)] == [True, False, False, False]


@pytest.mark.long
@pytest.mark.vision
@pytest.mark.oldest_opencv
def test_whole_pictures_of_a_camera_that_turns_are_hardly_ever_refused(real_pictures: Path) -> None:
    paths = sorted(path for path in (real_pictures / "real").rglob("*") if path.suffix.lower() in {".jpg", ".jpeg"})[
        :40
    ]
    refused = []
    for path in paths:
        image, stream = load_picture(path).image, JpegStream()
        scale = 700 / image.shape[1]
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        for step in range(10):
            seen = image[3 * step : 400 + 3 * step, 5 * step : 640 + 5 * step]
            refused.append(is_refused(stream, coded(seen)))
    assert len(refused) > 200
    assert sum(refused) <= 0.01 * len(refused)


def test_a_grey_jpeg_of_a_stream_gets_three_channels(scene: Image) -> None:
    grey = JpegStream().decode(coded(scene[:, :, 1]))
    assert grey.shape == scene.shape
    assert np.array_equal(grey[:, :, 0], grey[:, :, 2])


def test_a_jpeg_that_claims_to_be_enormous_is_refused_before_it_takes_memory(scene: Image) -> None:
    data = bytearray(coded(scene))
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = b"\xff\x00\xff\x00"
    with pytest.raises(PictureError, match="too large"):
        JpegStream().decode(bytes(data))


@pytest.mark.parametrize("count", [500, pytest.param(20_000, marks=pytest.mark.long)])
def test_a_damaged_jpeg_is_a_picture_or_an_error(scene: Image, count: int) -> None:
    data, rng = coded(scene), np.random.default_rng(6)
    for _ in range(count):
        damaged = bytearray(data)
        for at in rng.integers(0, len(data), int(rng.integers(1, 8))):
            damaged[at] = int(rng.integers(256))
        try:
            image = JpegStream().decode(bytes(damaged))
        except PictureError:
            continue
        assert image.ndim == 3
