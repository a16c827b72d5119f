"""Zoom and focus are read from the EXIF data of JPEG pictures, and never stand in the way of a picture."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.errors import CalibrationError
from stadimeter.workbench.picture_metadata import LensSettings, check_lens_settings, read_lens_settings

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


def test_what_is_no_jpeg_says_nothing(tmp_path: Path) -> None:
    assert read_lens_settings(written(tmp_path, "a.png", b"\x89PNG")) == LensSettings()
    assert read_lens_settings(tmp_path / "missing.jpg") == LensSettings()


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
