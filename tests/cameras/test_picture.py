"""Pictures: whole, damaged, and how coarsely they store colour."""

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
from stadimeter.cameras.image_files import ImageFilesCamera, load_picture
from stadimeter.cameras.image_files import subsampling_of as subsampling_in
from stadimeter.cameras.mjpeg_stream import JpegStream
from stadimeter.cameras.opencv_device import OpenCvOptions, subsampling_of
from stadimeter.core.frame import SUBSAMPLINGS, Image
from stadimeter.errors import PictureError
from stadimeter.testing.rig import ManualClock

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
    whole = encode(scene, ".jpg")
    path.write_bytes(whole + b"MotionPhoto\xff\x00" * 20)
    assert load_picture(path).image.shape == scene.shape
    announced = whole[:2] + b"\xff\xe2\x00\x08MPF\0ab" + whole[2:]
    path.write_bytes(announced + whole)
    assert load_picture(path).image.shape == scene.shape, "a preview of a telephone"
    path.write_bytes(whole + whole)
    assert load_picture(path).image.shape == scene.shape, "a map of depth that nothing announces"


def test_a_turned_camera_s_picture_is_turned_upright(tmp_path: Path, scene: Image) -> None:
    path = tmp_path / "turned.jpg"
    upright = tmp_path / "upright.jpg"
    upright.write_bytes(encode(scene, ".jpg"))
    path.write_bytes(turned(encode(scene, ".jpg"), orientation=6))
    assert np.array_equal(load_picture(path).image, cv2.rotate(load_picture(upright).image, cv2.ROTATE_90_CLOCKWISE))


def test_what_is_no_file_with_data_is_refused_and_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    assert "there is no such file" in refusal(tmp_path / "absent.jpg")
    assert "is a folder" in refusal(tmp_path)
    (tmp_path / "empty.jpg").touch()
    assert "is empty" in refusal(tmp_path / "empty.jpg")
    path = tmp_path / "pipe.jpg"
    os.mkfifo(path)
    assert "not a regular file" in refusal(path)


@pytest.mark.parametrize("data", [b"RIFF\x10\0\0\0AVI LIST", b"\0\0\0 ftypisom\0\0", b"\x1aE\xdf\xa3" + b"\0" * 20])
def test_a_video_is_said_to_be_one(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "drive"
    path.write_bytes(data)
    assert refusal(path).startswith(f"this is a video: {path}; ")


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


# How coarsely colour is stored: from the header of a picture, or from what a camera is known to send.

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


# JPEGs of a stream that are whole, cut, or lack something inside.


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


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_the_bits_of_a_camera_may_lie_in_the_lower_ones_of_16(tmp_path: Path, scene: Image, bits: int) -> None:
    assert scene.max() >= 128, "or fewer bits would be as likely"
    levels = scene.astype(np.uint16) << (bits - 8) if bits > 8 else scene
    for suffix in (".png", ".tif"):
        path = tmp_path / f"{bits}{suffix}"
        path.write_bytes(encode(levels, suffix))
        assert np.array_equal(load_picture(path).image, scene)


@pytest.mark.parametrize("most", [1.0, 255.0])
def test_a_picture_of_floating_point_numbers_is_read_where_they_are_levels(
    tmp_path: Path, scene: Image, most: float
) -> None:
    path = tmp_path / "float.tif"
    as_it_is = [cv2.IMWRITE_TIFF_COMPRESSION, 1]  # OpenCV 4.10 would write logarithms
    path.write_bytes(encode(scene.astype(np.float32) / (255.0 / most), ".tif", as_it_is))
    assert np.array_equal(load_picture(path).image, scene)
    path.write_bytes(encode(scene[..., 0].astype(np.float32) / (255.0 / most), ".tif", as_it_is))
    assert np.array_equal(load_picture(path).image, cv2.merge([scene[..., 0]] * 3)), "of one channel too"
    path.write_bytes(encode(np.float32([[0.5, 1.25]]), ".tif", as_it_is))
    assert load_picture(path).image[0, :, 0].tolist() == [128, 255], "a light above white is white"
    for wrong in (-1.0, 1000.0, np.nan):
        path.write_bytes(encode(np.full((8, 8, 3), wrong, np.float32), ".tif", as_it_is))
        assert "no levels of light" in refusal(path)


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (b"\0\0\0\x18ftypheic\0\0\0\0mif1heic", "HEIC, as iPhones write it"),
        (b"\0\0\0\x18ftypavif\0\0\0\0mif1", "AVIF"),
        (b"\0\0\0\x18ftyphevc\0\0\0\0msf1hevc", "HEIC"),
        (b"\0\0\0\x18ftypcrx \0\0\0\0crx isom", "raw file"),
        (b"II*\0\x10\0\0\0CR\2\0", "raw file"),
        (b"II*\0\x08\0\0\0\1\0\x12\xc6\1\0\4\0\0\0\1\4\0\0", "raw file"),
        (b"MM\0*\0\0\0\x08\0\1\0\xfe\0\4\0\0\0\1\0\0\0\1", "raw file"),
        (b"\0\0\0\x0cJXL \r\n\x87\n", "it is JPEG XL"),
        (b"GIF89a", "convert it to PNG"),
    ],
)
def test_a_picture_of_another_kind_is_named_with_what_to_do(tmp_path: Path, head: bytes, words: str) -> None:
    path = tmp_path / "other.heic"
    path.write_bytes(head + bytes(1000))
    assert words in refusal(path)
