"""The tutorial that this program grew from, on its own pictures; and what we make of them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.core.frame import Frame
from stadimeter.detectors.sheet import SheetDetector, SheetOptions
from stadimeter.ranging.calibration import KnownDistance, calibrate
from stadimeter.ranging.similar_triangles import distance_m
from support.through_lens import ThroughLens

pytestmark = pytest.mark.vision

INCH_M = 0.0254
FOOT_M = 0.3048
NAMES = ("2ft", "3ft", "4ft")


def _tutorial_sides_px(image: np.ndarray) -> tuple[float, float]:
    """Measure as the tutorial does: the sides of the smallest box around the largest contour, the shorter one first."""
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (5, 5), 0)
    contours, _ = cv2.findContours(cv2.Canny(grey, 35, 125), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
    sides = cv2.minAreaRect(max(contours, key=cv2.contourArea))[1]
    return min(sides), max(sides)


@pytest.mark.parametrize(
    ("side", "focal_px", "feet"),
    [("short", 543.46, (2.000, 2.917, 3.911)), ("long", 628.43, (2.000, 2.818, 3.680))],
)
def test_the_tutorials_figures_come_from_taking_the_short_side_for_eleven_inches(
    real_pictures: Path, side: str, focal_px: float, feet: tuple[float, ...]
) -> None:
    """The published 2.000, 2.917 and 3.911 ft pair 11 in, the sheet's width, with the short, vertical side.

    Which side `minAreaRect` gives first depends on OpenCV's version, so the same code gives the other row elsewhere.
    """
    images = [cv2.imread(str(real_pictures / "seed_sheet" / f"{name}.png")) for name in NAMES]
    widths = [_tutorial_sides_px(image)[0 if side == "short" else 1] for image in images]
    focal = widths[0] * 24 / 11
    assert focal == pytest.approx(focal_px, abs=0.01)
    measured = [distance_m(focal, 11 * INCH_M, width) / FOOT_M for width in widths]
    assert measured == pytest.approx(feet, abs=0.0005)


def _frame(path: Path) -> Frame:
    return Frame(cv2.imread(str(path)), 0.0, 0)


def test_calibrated_at_two_feet_the_sheet_at_three_and_four_is_right_within_three_per_cent(real_pictures: Path) -> None:
    options = SheetOptions.model_validate({"width": "11 in", "height": "8.5 in"})
    detector = SheetDetector("paper", options)
    folder = real_pictures / "seed_sheet"
    first = _frame(folder / "2ft.png")
    known = KnownDistance(
        picture="2ft.png",
        width_px=first.width_px,
        height_px=first.height_px,
        detection=detector.detect(first),
        size=detector.target_shape,
        depth_m=24 * INCH_M,
    )
    camera = calibrate([known], date="").camera_model
    # The EXIF data say 673 to 693 px; the tape is good to an inch of 24, which is 4.2 per cent.
    assert camera.fx_px == pytest.approx(673, rel=0.045)
    pictures = [folder / f"{name}.png" for name in NAMES[1:]]
    originals = [folder / "original" / f"{name}.jpg" for name in NAMES[1:]]
    # The same for every version of OpenCV, to 0.1 %.
    expected_in = dict(zip((*pictures, *originals), (36.20, 46.98, 36.17, 46.90), strict=True))
    for path in (*pictures, *originals):
        frame = _frame(path)
        measured = ThroughLens(detector, camera).measure(frame)
        inches = measured.distance_m / INCH_M
        assert inches == pytest.approx(12 * int(path.stem[0]), rel=0.03), path
        assert abs(inches - 12 * int(path.stem[0])) < 1 + 1.96 * measured.sigma_m / INCH_M, path
        assert inches == pytest.approx(expected_in[path], rel=0.001), path
