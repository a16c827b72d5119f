"""What a picture says of its colours, its camera and its quality."""

from __future__ import annotations

import re
import struct
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from typer.testing import CliRunner

from stadimeter.cameras.image_files import ImageFilesCamera
from stadimeter.cli.main import app
from stadimeter.config.camera_file import load_camera_model, save_camera_model
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image, Optics
from stadimeter.errors import CalibrationError
from stadimeter.testing.rig import ManualClock
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.calibration.board_session import Chessboard, find_boards
from stadimeter.workbench.picture_metadata import (
    blur_sigma_px,
    check_lens_settings,
    other_lens_notes,
    other_profile,
    picture_remarks,
    read_lens_settings,
    with_lens_settings,
)

pytestmark = pytest.mark.vision


# Colour profiles that are not sRGB are named.


def with_profile(path: Path, name: bytes) -> Path:
    """Write a JPEG with a profile that has a name."""
    data = cv2.imencode(".jpg", np.full((480, 640, 3), 90, np.uint8))[1].tobytes()
    body = b"ICC_PROFILE\0\1\1" + b"\0" * 128 + name + b"\0" * 300
    path.write_bytes(data[:2] + b"\xff\xe2" + struct.pack(">H", len(body) + 2) + body + data[2:])
    return path


@pytest.mark.parametrize("name", ["Display P3", "Adobe RGB (1998)"])
def test_a_profile_of_other_colours_is_named(tmp_path: Path, name: str) -> None:
    for encoding in ("ascii", "utf-16-be"):
        assert other_profile(with_profile(tmp_path / "a.jpg", name.encode(encoding))) == name
    assert other_profile(with_profile(tmp_path / "a.jpg", b"sRGB IEC61966-2.1")) == ""


def test_measure_and_calibrate_say_it(tmp_path: Path) -> None:
    picture = with_profile(tmp_path / "phone.jpg", b"Display P3")
    (tmp_path / "camera.toml").write_text("width_px = 640\nheight_px = 480\nfx_px = 600.0\n", encoding="utf-8")
    sheet, camera = ("--sheet", "11in,8.5in"), str(tmp_path / "camera.toml")
    for arguments in (
        ("measure", str(picture), "--camera", camera, *sheet),
        ("calibrate", "distance", f"{picture}@1m", *sheet, "-o", str(tmp_path / "new.toml")),
        ("calibrate", "check", f"{picture}@1m", *sheet, "--camera", camera),
    ):
        stderr = CliRunner().invoke(app, list(arguments)).stderr
        assert stderr.count("note: ") == stderr.count("'Display P3', not sRGB") == 1


# The zoom is read from the EXIF data of JPEG pictures, and never stand in the way of a picture.

FOCAL, ZOOM, FOCAL_35, LENS = 0x920A, 0xA404, 0xA405, 0xA434


def jpeg(order: str, rationals: dict[int, tuple[int, int]], focal_35: int = 0, lens: str = "") -> bytes:
    """Return the beginning of a JPEG file, with the settings in a directory of their own as cameras write them."""
    at = 8 + 2 + 12 + 4
    entries = [(FOCAL_35, 3, 1, struct.pack(f"{order}HH", focal_35, 0))] if focal_35 else []
    values_at = at + 2 + 12 * (len(rationals) + len(entries) + bool(lens)) + 4
    values = b""
    for tag, (above, below) in rationals.items():
        entries.append((tag, 5, 1, struct.pack(f"{order}L", values_at + len(values))))
        values += struct.pack(f"{order}LL", above, below)
    if lens:
        entries.append((LENS, 2, len(lens) + 1, struct.pack(f"{order}L", values_at + len(values))))
        values += lens.encode() + b"\0"
    tiff = (b"II" if order == "<" else b"MM") + struct.pack(f"{order}HL", 42, 8)
    tiff += struct.pack(f"{order}HHHLLL", 1, 0x8769, 4, 1, at, 0)
    tiff += struct.pack(f"{order}H", len(entries))
    tiff += b"".join(struct.pack(f"{order}HHL", tag, kind, count) + value for tag, kind, count, value in entries)
    tiff += struct.pack(f"{order}L", 0) + values
    block = b"Exif\0\0" + tiff
    return b"\xff\xd8\xff\xe0\x00\x04ab\xff\xe1" + struct.pack(">H", 2 + len(block)) + block + b"\xff\xda\x00\x02"


def written(folder: Path, name: str, data: bytes) -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("order", ["<", ">"])
def test_the_settings_are_read_in_either_byte_order(tmp_path: Path, order: str) -> None:
    picture = written(tmp_path, "a.jpg", jpeg(order, {FOCAL: (412, 100), ZOOM: (2, 1)}, 30))
    assert read_lens_settings(picture) == {"focal_length_mm": 4.12, "equivalent_mm": 30.0, "digital_zoom": 2.0}


def test_unknown_and_infinite_settings_are_none(tmp_path: Path) -> None:
    picture = written(tmp_path, "a.jpg", jpeg("<", {FOCAL: (0xFFFFFFFF, 1), ZOOM: (0, 1)}))
    assert read_lens_settings(picture) == {"digital_zoom": 1.0}
    directory = struct.pack("<HHHLLL", 1, 0x8769, 2, 10, 26, 0) + b"not a place"
    block = b"Exif\0\0II" + struct.pack("<HL", 42, 8) + directory
    data = b"\xff\xd8\xff\xe1" + struct.pack(">H", 2 + len(block)) + block + b"\xff\xda\x00\x02"
    assert read_lens_settings(written(tmp_path, "odd.jpg", data)) == {}


@given(cut=st.integers(0, 200), junk=st.binary(max_size=40))
def test_damaged_data_say_nothing_and_raise_nothing(
    tmp_path_factory: pytest.TempPathFactory, cut: int, junk: bytes
) -> None:
    whole = jpeg("<", {FOCAL: (412, 100), ZOOM: (1, 1)}, 30)
    picture = written(tmp_path_factory.mktemp("exif"), "a.jpg", whole[:cut] + junk)
    assert len(read_lens_settings(picture)) <= 3


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (jpeg("<", {FOCAL: (600, 100)}, 30), "with focal length 4.12 mm"),
        (jpeg("<", {FOCAL: (412, 100)}, 52), "with 35 mm equivalent 30 mm"),
        (jpeg("<", {FOCAL: (412, 100), ZOOM: (3, 2)}, 30), "with digital zoom 1,"),
        (jpeg("<", {FOCAL: (412, 100)}, 30, lens="back camera 9mm"), "with the lens back camera 4mm,"),
    ],
)
def test_pictures_with_another_zoom_are_refused_with_both_figures(tmp_path: Path, other: bytes, said: str) -> None:
    one = written(tmp_path, "one.jpg", jpeg("<", {FOCAL: (412, 100)}, 30, lens="back camera 4mm"))
    with pytest.raises(CalibrationError, match="another zoom or lens is another camera") as refused:
        check_lens_settings([one, written(tmp_path, "other.jpg", other)])
    assert said in str(refused.value)
    assert str(tmp_path / "other.jpg") in str(refused.value)


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


def test_a_picture_of_another_lens_than_the_camera_files_is_remarked(tmp_path: Path) -> None:
    wide, far, zoomed, plain = (
        written(tmp_path, name, jpeg("<", settings, focal_35))
        for name, settings, focal_35 in (
            ("wide.jpg", {FOCAL: (600, 100)}, 26),
            ("far.jpg", {}, 77),
            ("zoomed.jpg", {FOCAL: (600, 100), ZOOM: (2, 1)}, 26),
            ("plain.jpg", {}, 0),
        )
    )
    model = with_lens_settings(CameraModel.with_focal_length(600.0, 640, 480), [wide])
    read = load_camera_model(saved(tmp_path / "camera.toml", model))
    assert (read, hash(read)) == (model, hash(model)), "what a lens bends is computed once for each"
    assert [*other_lens_notes(model, [wide, plain])] == []
    (note,) = other_lens_notes(model, [zoomed])
    assert "was taken with digital zoom 2, the pictures of the camera file with 1" in note
    (note,) = other_lens_notes(model, [far])
    assert f"{far} was taken with 35 mm equivalent 77 mm, the pictures of the camera file with 26 mm" in note


def saved(path: Path, model: CameraModel) -> Path:
    save_camera_model(path, model)
    return path
