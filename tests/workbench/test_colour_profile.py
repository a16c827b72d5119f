"""Colour profiles that are not sRGB are named, whatever kind of file they are in."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from stadimeter.cli.main import app
from stadimeter.workbench.picture_metadata import other_profile

pytestmark = pytest.mark.vision

SRGB = ((0.4361, 0.2225, 0.0139), (0.3851, 0.7169, 0.0971), (0.1431, 0.0606, 0.7141))
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


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_srgb_by_any_name_and_pictures_without_a_profile_are_fine(tmp_path: Path, suffix: str) -> None:
    assert other_profile(with_profile(tmp_path / f"a{suffix}", profile("some monitor", SRGB))) == ""
    cv2.imwrite(str(tmp_path / f"plain{suffix}"), np.zeros((48, 64, 3), np.uint8))
    assert other_profile(tmp_path / f"plain{suffix}") == ""


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
