from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.core.frame import Image
from stadimeter.workbench.picture_metadata import blur_sigma_px, picture_remarks

pytestmark = pytest.mark.vision

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


def test_a_covered_lens_gives_a_black_picture() -> None:
    noise = np.random.default_rng(1).integers(0, 12, (480, 640, 3), dtype=np.uint8)
    (remark,) = picture_remarks(noise)
    assert remark.startswith("the picture is black: take the cover off the lens")


def test_the_blur_of_an_edge_is_measured() -> None:
    for sigma_px in [1.5, 2.5, 3.5]:
        image = np.full((480, 640, 3), 60, np.uint8)
        cv2.rectangle(image, (200, 150), (440, 330), (200, 200, 200), -1)
        assert blur_sigma_px(cv2.GaussianBlur(image, (0, 0), sigma_px)) == pytest.approx(sigma_px, rel=0.2)


def test_a_picture_without_edges_is_not_called_blurred() -> None:
    assert blur_sigma_px(np.full((480, 640, 3), 120, np.uint8)) is None
