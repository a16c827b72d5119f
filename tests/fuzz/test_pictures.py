"""Whatever a picture file holds, it is a picture of a bearable size, or refused in one line."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.cameras.image_files import load_picture
from stadimeter.config.files import PICTURE_MAX_PIXELS
from stadimeter.errors import PictureError
from stadimeter.workbench.picture_metadata import read_lens_settings

KINDS = {
    "baseline.jpg": (".jpg", []),
    "progressive.jpg": (".jpg", [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]),
    "picture.png": (".png", []),
    "picture.bmp": (".bmp", []),
    "picture.tif": (".tif", []),
    "lossy.webp": (".webp", [cv2.IMWRITE_WEBP_QUALITY, 80]),
    "lossless.webp": (".webp", [cv2.IMWRITE_WEBP_QUALITY, 101]),
    "picture.ppm": (".ppm", []),
    "text.pgm": (".pgm", [cv2.IMWRITE_PXM_BINARY, 0]),
}
SOME, ALL = 60, 5000


def encoded(kind: str) -> bytes:
    suffix, options = KINDS[kind]
    image = np.random.default_rng(5).integers(0, 256, (24, 32, 3), np.uint8)
    image[:12] = 90
    done, data = cv2.imencode(suffix, image if suffix != ".pgm" else image[..., 0].copy(), options)
    assert done
    found = data.tobytes()
    if suffix == ".jpg":  # with a directory of settings as cameras write one
        entries = struct.pack(">HHHIHHI", 1, 0x8769, 4, 1, 0, 26, 0) + struct.pack(">HHHIII", 1, 0x920A, 5, 1, 44, 0)
        exif = b"Exif\0\0MM\0*" + struct.pack(">I", 8) + entries + struct.pack(">II", 35, 10)
        found = found[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + found[2:]
    return found


@pytest.mark.vision
@pytest.mark.parametrize("name", KINDS)
def test_a_sound_picture_of_each_kind_is_read(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(encoded(name))
    assert load_picture(tmp_path / name).image.shape == (24, 32, 3)


@pytest.mark.vision
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize(("seed", "count"), [(0, SOME), pytest.param(1, ALL, marks=pytest.mark.long)])
def test_many_mutations_of_a_picture_are_no_tracebacks(
    tmp_path: Path, mutate, flip, name: str, seed: int, count: int
) -> None:
    file, rng, sound = tmp_path / name, random.Random(f"{name}{seed}"), encoded(name)  # noqa: S311
    for _ in range(count):
        file.write_bytes(rng.choice((mutate, flip))(rng, sound))
        try:
            image = load_picture(file).image
        except PictureError as error:
            assert str(file) in str(error)  # noqa: PT017
        else:
            assert image.shape[2] == 3
            assert image.shape[0] * image.shape[1] <= PICTURE_MAX_PIXELS
        read_lens_settings(file)
