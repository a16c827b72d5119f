"""Calibration files of other programs, as the camera file that says the same: of OpenCV, ROS, Kalibr and PhotonVision.

Only what the camera file can hold is read: a pinhole with OpenCV's k1, k2, p1, p2 and k3, which is Brown and Conrady's
lens. The texts are small and regular, so that the numbers are found by the names before them; no reader of YAML is
needed. Where an entry is not as expected, the file is refused rather than guessed at.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

# Coefficients of OpenCV's that the camera file has no place for: k4 to k6, thin prism, tilt. Zeros change nothing.
LENS_COEFFICIENTS = 5

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
# Only behind the names of models: "omni" is also in the name of a maker of sensors.
_MODEL = re.compile(r"(?:camera|distortion|lens)_?model\W+([\w-]+)", re.IGNORECASE)
_OTHER_LENS = re.compile(r"equi|fisheye|kannala|omni|eucm|ds$", re.IGNORECASE)


def looks_foreign(text: str) -> bool:
    """Check whether a text is a calibration file of another program, going by the names of its entries."""
    return bool(
        re.search(r"camera_?matrix|cameraIntrinsics|distortion_(?:coeffs|coefficients|model)", text, re.IGNORECASE)
    )


def camera_table(text: str) -> dict[str, Any]:
    """Return the table of a camera file that says the same as another program's file.

    Raises:
        ValueError: It is of another lens, or lacks something; the message says what.
    """
    if len(re.findall(r"^\s*cam\d+:", text, re.MULTILINE)) > 1:
        raise ValueError("it holds several cameras; keep the lines of one")
    if found := next(filter(_OTHER_LENS.match, _MODEL.findall(text)), ""):
        raise ValueError(f"its lens is a fisheye ('{found}'), which stadimeter has no model for")
    intrinsics = _numbers(text, "camera_?matrix|cameraIntrinsics|intrinsics")
    if len(intrinsics) == 9:
        fx_px, cx_px, fy_px, cy_px = (intrinsics[at] for at in (0, 2, 4, 5))
    elif len(intrinsics) == 4:
        fx_px, fy_px, cx_px, cy_px = intrinsics
    else:
        raise ValueError("it has no camera matrix of 3 x 3 numbers")
    width_px, height_px = _size(text)
    coefficients = _numbers(text, "distortion_coefficients|distortion_coeffs|dist_coeffs|distCoeffs")
    if any(coefficients[LENS_COEFFICIENTS:]):
        raise ValueError(
            f"its lens has {len(coefficients)} coefficients (rational model), and a camera file k1, k2, p1, p2 and k3: "
            "calibrate with 5 of them"
        )
    return {
        "width_px": width_px,
        "height_px": height_px,
        "fx_px": fx_px,
        "fy_px": fy_px,
        "cx_px": cx_px,
        "cy_px": cy_px,
        "distortion": coefficients[:LENS_COEFFICIENTS],
        # Such a file states no uncertainty: this is what a board of 20 pictures leaves, and edges of an unknown camera.
        "focal_relative_sigma": 0.003,
        "edge_bias_sigma_px": 0.1,
        "method": "a calibration file of another program",
    }


def _numbers(text: str, names: str) -> list[float]:
    """Return the list of numbers behind a name, or behind the word ``data`` within its entry."""
    number_list = rf"[\[>]\s*({_NUMBER}(?:[\s,]+{_NUMBER})*)\s*,?\s*[\]<]"
    inline = re.search(rf"(?:{names})\"?>?\s*:?\s*{number_list}", text, re.IGNORECASE)
    found = inline or re.search(
        rf"(?:{names})\b.{{0,200}}?\bdata\"?>?\s*:?\s*{number_list}", text, re.IGNORECASE | re.DOTALL
    )
    return [float(number) for number in re.findall(_NUMBER, found[1])] if found else []


def _size(text: str) -> Sequence[int]:
    both = _numbers(text, "resolution|image_size|img_size")
    if len(both) != 2:
        each = (
            re.search(rf"(?:image_?|\b){side}\"?>?\s*:?\s*(\d+)", text, re.IGNORECASE) for side in ("width", "height")
        )
        both = [float(found[1]) for found in each if found]
    if len(both) != 2:
        raise ValueError("it does not say how wide and high its pictures are; add image_width and image_height")
    return [round(side) for side in both]
