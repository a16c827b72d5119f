"""The tutorial that this program grew from, on its own pictures; and what we make of them."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from stadimeter.core.frame import Frame
from stadimeter.detectors.sheet import SheetDetector, SheetOptions
from stadimeter.ranging.calibration import KnownDistance, calibrate
from support.through_lens import ThroughLens

pytestmark = pytest.mark.vision

INCH_M = 0.0254
NAMES = ("2ft", "3ft", "4ft")


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
