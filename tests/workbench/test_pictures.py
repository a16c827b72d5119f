"""What a picture says of its colours, its camera and its quality."""

from __future__ import annotations

import re
import struct
import zlib
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from typer.testing import CliRunner

from stadimeter.cameras.image_files import ImageFilesCamera
from stadimeter.cli.main import app
from stadimeter.core.frame import Image, Optics
from stadimeter.errors import CalibrationError
from stadimeter.testing.rig import ManualClock
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.calibration.board_session import Chessboard, find_boards
from stadimeter.workbench.picture_metadata import (
    LensSettings,
    blur_sigma_px,
    check_lens_settings,
    other_profile,
    picture_remarks,
    read_lens_settings,
)

pytestmark = pytest.mark.vision


# Colour profiles that are not sRGB are named, whatever kind of file they are in.

DISPLAY_P3 = ((0.5151, 0.2412, -0.0011), (0.2920, 0.6922, 0.0419), (0.1571, 0.0666, 0.7841))
ADOBE_RGB = ((0.6097, 0.3111, 0.0195), (0.2053, 0.6257, 0.0609), (0.1492, 0.0632, 0.7446))


def profile(name: str, primaries: tuple[tuple[float, ...], ...], *, version: int = 4) -> bytes:
    """Return a profile with the tags that matter."""
    if version == 4:
        text = name.encode("utf-16-be")
        description = b"mluc\0\0\0\0" + struct.pack(">LL2s2sLL", 1, 12, b"en", b"US", len(text), 28) + text
    else:
        description = b"desc\0\0\0\0" + struct.pack(">L", len(name) + 1) + name.encode("ascii") + b"\0"
    bodies = [(b"desc", description)]
    for kind, primary in zip((b"rXYZ", b"gXYZ", b"bXYZ"), primaries, strict=True):
        bodies.append((kind, b"XYZ \0\0\0\0" + struct.pack(">3l", *(round(each * 65536) for each in primary))))
    at = 128 + 4 + 12 * len(bodies)
    table, data = struct.pack(">L", len(bodies)), b""
    for kind, body in bodies:
        table += struct.pack(">4sLL", kind, at + len(data), len(body))
        data += body
    return b"\0" * 16 + b"RGB " + b"\0" * 108 + table + data


def with_profile(path: Path, icc: bytes) -> Path:
    """Write a picture with a profile, of the kind that its name says."""
    done, encoded = cv2.imencode(path.suffix, np.full((480, 640, 3), 90, np.uint8))
    assert done
    data = encoded.tobytes()
    if path.suffix == ".jpg":
        half = len(icc) // 2
        segments = b""
        for number, part in ((2, icc[half:]), (1, icc[:half])):  # in the wrong order, as some programs write them
            body = b"ICC_PROFILE\0" + bytes((number, 2)) + part
            segments += b"\xff\xe2" + struct.pack(">H", len(body) + 2) + body
        data = data[:2] + segments + data[2:]
    elif path.suffix == ".png":
        body = b"iCCP" + b"icc\0\0" + zlib.compress(icc)
        data = data[:33] + struct.pack(">L", len(body) - 4) + body + struct.pack(">L", zlib.crc32(body)) + data[33:]
    else:
        chunk = b"ICCP" + struct.pack("<L", len(icc)) + icc + b"\0" * (len(icc) % 2)
        data = data[:12] + chunk + data[12:]
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("version", [2, 4])
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
@pytest.mark.parametrize(("name", "primaries"), [("Display P3", DISPLAY_P3), ("Adobe RGB (1998)", ADOBE_RGB)])
def test_a_profile_of_other_colours_is_named(
    tmp_path: Path, suffix: str, version: int, name: str, primaries: tuple[tuple[float, ...], ...]
) -> None:
    assert other_profile(with_profile(tmp_path / f"a{suffix}", profile(name, primaries, version=version))) == name


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(at=st.integers(0, 900), junk=st.binary(max_size=12), cut=st.integers(0, 900), kind=st.sampled_from([0, 1, 2]))
def test_a_damaged_profile_is_no_error(tmp_path: Path, at: int, junk: bytes, cut: int, kind: int) -> None:
    path = with_profile(tmp_path / f"a{('.jpg', '.png', '.webp')[kind]}", profile("Display P3", DISPLAY_P3))
    data = path.read_bytes()
    path.write_bytes((data[:at] + junk + data[at + len(junk) :])[: max(cut, at)])
    assert len(other_profile(path)) <= 60


def test_measure_and_calibrate_say_it(tmp_path: Path) -> None:
    picture = with_profile(tmp_path / "phone.jpg", profile("Display P3", DISPLAY_P3))
    (tmp_path / "camera.toml").write_text("width_px = 640\nheight_px = 480\nfx_px = 600.0\n", encoding="utf-8")
    sheet, camera = ("--sheet", "11in,8.5in"), str(tmp_path / "camera.toml")
    for arguments in (
        ("measure", str(picture), "--camera", camera, *sheet),
        ("calibrate", "distance", f"{picture}@1m", *sheet, "-o", str(tmp_path / "new.toml")),
        ("calibrate", "check", f"{picture}@1m", *sheet, "--camera", camera),
    ):
        stderr = CliRunner().invoke(app, list(arguments)).stderr
        assert stderr.count("note: ") == stderr.count("'Display P3', not sRGB") == 1


# Zoom and focus are read from the EXIF data of JPEG pictures, and never stand in the way of a picture.

FOCAL, DISTANCE, ZOOM, FOCAL_35 = 0x920A, 0x9206, 0xA404, 0xA405


def jpeg(order: str, rationals: dict[int, tuple[int, int]], focal_35: int = 0) -> bytes:
    """Return the beginning of a JPEG file, with the settings in a directory of their own as cameras write them."""
    at = 8 + 2 + 12 + 4
    entries = [(FOCAL_35, 3, struct.pack(f"{order}HH", focal_35, 0))] if focal_35 else []
    values_at = at + 2 + 12 * (len(rationals) + len(entries)) + 4
    values = b""
    for tag, (above, below) in rationals.items():
        entries.append((tag, 5, struct.pack(f"{order}L", values_at + len(values))))
        values += struct.pack(f"{order}LL", above, below)
    tiff = (b"II" if order == "<" else b"MM") + struct.pack(f"{order}HL", 42, 8)
    tiff += struct.pack(f"{order}HHHLLL", 1, 0x8769, 4, 1, at, 0)
    tiff += struct.pack(f"{order}H", len(entries))
    tiff += b"".join(struct.pack(f"{order}HHL", tag, kind, 1) + value for tag, kind, value in entries)
    tiff += struct.pack(f"{order}L", 0) + values
    block = b"Exif\0\0" + tiff
    return b"\xff\xd8\xff\xe0\x00\x04ab\xff\xe1" + struct.pack(">H", 2 + len(block)) + block + b"\xff\xda\x00\x02"


def written(folder: Path, name: str, data: bytes) -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("order", ["<", ">"])
def test_the_settings_are_read_in_either_byte_order(tmp_path: Path, order: str) -> None:
    picture = written(tmp_path, "a.jpg", jpeg(order, {FOCAL: (412, 100), DISTANCE: (3, 2), ZOOM: (2, 1)}, 30))
    assert read_lens_settings(picture) == LensSettings(
        focal_length_mm=4.12, focal_length_35mm_mm=30.0, digital_zoom=2.0, subject_distance_m=1.5
    )


def test_unknown_and_infinite_settings_are_none(tmp_path: Path) -> None:
    picture = written(tmp_path, "a.jpg", jpeg("<", {FOCAL: (0, 1), DISTANCE: (0xFFFFFFFF, 1), ZOOM: (0, 1)}))
    assert read_lens_settings(picture) == LensSettings(digital_zoom=1.0)


@given(cut=st.integers(0, 200), junk=st.binary(max_size=40))
def test_damaged_data_say_nothing_and_raise_nothing(
    tmp_path_factory: pytest.TempPathFactory, cut: int, junk: bytes
) -> None:
    whole = jpeg("<", {FOCAL: (412, 100), ZOOM: (1, 1)}, 30)
    picture = written(tmp_path_factory.mktemp("exif"), "a.jpg", whole[:cut] + junk)
    assert isinstance(read_lens_settings(picture), LensSettings)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (jpeg("<", {FOCAL: (600, 100)}, 30), "with focal length 4.12 mm"),
        (jpeg("<", {FOCAL: (412, 100)}, 52), "with 35 mm equivalent 30 mm"),
        (jpeg("<", {FOCAL: (412, 100), ZOOM: (3, 2)}, 30), "with digital zoom 1,"),
    ],
)
def test_pictures_with_another_zoom_are_refused_with_both_figures(tmp_path: Path, other: bytes, said: str) -> None:
    one = written(tmp_path, "one.jpg", jpeg("<", {FOCAL: (412, 100), ZOOM: (1, 1)}, 30))
    with pytest.raises(CalibrationError, match="another zoom or lens is another camera") as refused:
        check_lens_settings([one, written(tmp_path, "other.jpg", other)])
    assert said in str(refused.value)
    assert str(tmp_path / "other.jpg") in str(refused.value)


def test_pictures_with_another_focus_are_noted(tmp_path: Path) -> None:
    near = written(tmp_path, "near.jpg", jpeg("<", {FOCAL: (412, 100), DISTANCE: (3, 10)}))
    far = written(tmp_path, "far.jpg", jpeg("<", {FOCAL: (412, 100), DISTANCE: (2, 1)}))
    (note,) = check_lens_settings([far, near])
    assert "near.jpg was focused at 0.3 m" in note
    assert check_lens_settings([near, near]) == ()


# Snapshots keep how the camera was set, and whatever reads them goes by it.

OPTICS = Optics(sensor="imx708", sensor_size_px=(2304, 1296), crop_px=(0, 0, 4608, 2592), lens_position_dpt=2.0)


@pytest.fixture
def board() -> Image:
    squares = np.kron(np.indices((5, 6)).sum(axis=0) % 2, np.ones((40, 40)))
    return np.pad(
        cv2.cvtColor((255 * squares).astype(np.uint8), cv2.COLOR_GRAY2BGR),
        ((60, 60), (60, 60), (0, 0)),
        constant_values=255,
    )


@pytest.mark.parametrize(
    "optics", [OPTICS, replace(OPTICS, lens_position_dpt=None, upside_down=True), replace(OPTICS, sensor="größer\0")]
)
def test_a_png_carries_the_settings_of_its_camera_and_the_same_pixels(
    board: Image, tmp_path: Path, optics: Optics
) -> None:
    path = tmp_path / "shot.png"
    write_picture(path, board, optics)
    camera = ImageFilesCamera((str(path),), 1.0, ManualClock())
    camera.open()
    frame = camera.read()
    assert frame.optics == optics
    assert np.array_equal(frame.image, board)


def test_a_calibration_from_pictures_of_two_settings_is_refused(board: Image, tmp_path: Path) -> None:
    paths = [tmp_path / "one.png", tmp_path / "two.png"]
    write_picture(paths[0], board, OPTICS)
    write_picture(paths[1], board, OPTICS)
    wanted = Chessboard(columns=5, rows=4, square_m=0.025)
    assert find_boards(paths, wanted).optics == OPTICS
    write_picture(paths[1], board, replace(OPTICS, lens_position_dpt=4.0))
    with pytest.raises(CalibrationError, match=r"two\.png: calibrated with the lens at 2 dioptres, now it is at 4"):
        find_boards(paths, wanted)


REAL = Path(__file__).resolve().parents[3] / "shared" / "data"
PICTURES = [
    "tennis_ball/images/89_10.jpg",
    "seed_sheet/3ft.png",
    "chessboard/left05.jpg",
    "tags/visp/AprilTag.png",
    "charuco/img_00.jpg",
]


@cache
def _real(name: str) -> Image:
    image = cv2.imread(str(REAL / name))
    if image is None:
        pytest.skip(f"{REAL / name} is not there")
    return image


@pytest.mark.long
def test_a_good_real_picture_has_no_fault() -> None:
    for name in PICTURES:
        assert picture_remarks(_real(name)) == ()


def test_where_the_exposure_is_known_another_is_proposed() -> None:
    for light, proposed_s in [(0.2, (0.012, 0.033)), (2.5, (0.004, 0.006)), (1.0, None)]:
        image = np.clip(_real(PICTURES[0])[::2, ::2].astype(float) * light, 0, 255).astype(np.uint8)
        words = " ".join(picture_remarks(image, 0.010))
        found = re.search(r'exposure = "(.+) ms" in \[camera\]; it was 10 ms', words)
        assert (found is not None) == (proposed_s is not None), words
        if found is not None and proposed_s is not None:
            assert proposed_s[0] <= float(found[1]) / 1e3 <= proposed_s[1]
        assert "exposure =" not in " ".join(picture_remarks(image))


def test_the_blur_of_an_edge_is_measured() -> None:
    for sigma_px in [1.5, 2.5, 3.5]:
        image = np.full((480, 640, 3), 60, np.uint8)
        cv2.rectangle(image, (200, 150), (440, 330), (200, 200, 200), -1)
        assert blur_sigma_px(cv2.GaussianBlur(image, (0, 0), sigma_px)) == pytest.approx(sigma_px, rel=0.2)
