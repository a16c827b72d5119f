"""Tags in pictures of dozens of megapixels: found and measured in full, in bounded memory."""

from __future__ import annotations

import subprocess
import sys

import cv2
import numpy as np
import pytest

from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.detectors.tag import TagDetector, TagOptions

pytestmark = pytest.mark.vision

MAX_MEGABYTES = 2000
MEASURE_PEAK = """
import re
from pathlib import Path
import numpy as np
from stadimeter.core.frame import Frame
from stadimeter.detectors.tag import TagDetector, TagOptions

detector = TagDetector("tag", TagOptions.model_validate({"side": "53 mm"}))
noise = np.random.default_rng(3).integers(0, 256, (6250, 8000, 3), np.uint8)
detector.detect(Frame(noise, 0.0, 0))
# Not `ru_maxrss`: that begins with the memory of the program that started this one, which may have pictures in it.
print(int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) // 1024)
"""


def _wall_with_tag(side_px: int, left_px: int, top_px: int) -> Frame:
    """Return 24 megapixels of a light wall with a tag on it."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    grey = np.full((4000, 6000), 200, np.uint8)
    grey[top_px : top_px + side_px, left_px : left_px + side_px] = cv2.aruco.generateImageMarker(dictionary, 5, side_px)
    return Frame(np.repeat(grey[..., None], 3, axis=2), 0.0, 0)


def _detector() -> TagDetector:
    return TagDetector("tag", TagOptions.model_validate({"side": "53 mm"}))


@pytest.mark.parametrize("side_px", [32, 80, 800])
def test_a_tag_in_a_very_large_picture_is_measured_in_full(side_px: int) -> None:
    found = _detector().detect(_wall_with_tag(side_px, 4100, 2300))
    assert found.status is DetectionStatus.FOUND
    assert found.number == 5
    assert found.width_px == pytest.approx(side_px, abs=0.3)


def test_the_reason_names_the_size_below_which_a_very_large_picture_was_not_searched() -> None:
    reason = _detector().detect(Frame(np.full((4000, 6000, 3), 90, np.uint8), 0.0, 0)).reason
    assert "of at least 20 px" in reason
    assert reason.endswith("smaller ones were not looked for: the picture is searched at a smaller size")


@pytest.mark.long
def test_fifty_megapixels_of_noise_are_searched_in_bounded_memory() -> None:
    peak = subprocess.run([sys.executable, "-c", MEASURE_PEAK], check=True, capture_output=True, text=True).stdout
    assert int(peak) < MAX_MEGABYTES
