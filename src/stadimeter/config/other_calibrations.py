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

_NUMBER = r"(?:[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|\.?nan|[-+]?\.?inf\w*)"
# A list in brackets, also of rows, or with a dash before each number, as YAML may have it.
_NUMBERS = rf"[\s\[]*(?:-\s+)*({_NUMBER}(?:(?:[\s,\[\]]|-\s)+{_NUMBER})*)"
_MATRIX = r"camera_?matrix\d?|cameraIntrinsics|intrinsics|mtx|K"
_ANY = r"camera.?matrix|distortion_|\bfx\b|\A\W*(?:%YAML|<\?xml|\{)"
_DISTORTION = "dist(?:ortion)?(?:_?coef[a-z_]*)?|D"
# Only behind the names of models: "omni" is also in the name of a maker of sensors.
_OTHER_LENS = re.compile(
    r'(?:(?:camera|distortion|lens)_?model|model_type|"type)\W+(\w*(?:equi|fisheye|kannala|omni|eucm)\w*|(?:fov|mei|ds)\b)'
    r"|(fisheye)(?:_model)?\W{1,4}(?:1|true)\b",
    re.IGNORECASE,
)
# Such a file states no uncertainty: this is what a board of 20 pictures leaves, and edges of an unknown camera.
_UNKNOWN = {"focal_relative_sigma": 0.003, "edge_bias_sigma_px": 0.1, "method": "a calibration file of another program"}
_WRITE = "write its numbers into a camera file: width_px, height_px, fx_px, fy_px, cx_px, cy_px and distortion"
# Files that are named as what they are.
_UNREAD = {
    r'"algorithms"\s*:': "a tuning of libcamera, which knows no focal length",
    r"CAMERA_ID, MODEL|\A\d+ [A-Z_]+ \d+ \d+ [\d.]+ ": f"a list of COLMAP; of a PINHOLE or OPENCV camera {_WRITE}",
    r"\A\x93NUMPY|\APK\x03\x04": f"a file of NumPy; {_WRITE}",
    r"\AMATLAB ": f"a file of MATLAB; {_WRITE}",
}


def camera_table(text: str) -> dict[str, Any] | None:
    """Return the table of a camera file that says the same as another program's file; None for a file of none.

    Raises:
        ValueError: It is of another lens, or lacks something; the message says what.
    """
    if re.search(r"^[ \t]*\"?\w+_px\"?[ \t]*=", text, re.MULTILINE):
        return None
    _refuse_others(text)
    text = re.sub("#.*", "", text)
    if not re.search(rf"{_key(_MATRIX)}|{_ANY}", text, re.IGNORECASE):
        return None
    intrinsics, *others = [each for each in _lists(text, _MATRIX) if len(each) > 3] or [[]]
    if any(each != intrinsics for each in others):
        raise ValueError("it holds several cameras or resolutions; keep the lines of one")
    places = {9: (0, 4, 2, 5), 4: (0, 1, 2, 3)}.get(len(intrinsics))
    if places is None:
        raise ValueError(f"it has no camera matrix of 3 x 3 numbers; {_WRITE}")
    lens = [intrinsics[at] for at in places]
    size_px = _size(text)
    if not all(0.25 < centre / side < 0.75 for centre, side in zip(lens[2:], size_px, strict=True)):
        where = f"{lens[2]:g}, {lens[3]:g} px, far from the middle of {size_px[0]} x {size_px[1]} px"
        raise ValueError(f"its optical centre is at {where}: is that the size of its pictures?")
    distortions = _lists(text, _DISTORTION) + _lists(text, "cameraExtrinsics")  # as PhotonVision called it of old
    coefficients = next((each for each in distortions if len(each) > 3), [])
    if any(coefficients[LENS_COEFFICIENTS:]):
        count = f"{len(coefficients)} coefficients (rational model)"
        raise ValueError(f"its lens has {count}, and a camera file k1, k2, p1, p2 and k3: calibrate with 5 of them")
    keys = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")
    return dict(zip(keys, (*size_px, *lens), strict=True)) | {"distortion": coefficients[:LENS_COEFFICIENTS]} | _UNKNOWN


def _refuse_others(text: str) -> None:
    for pattern, what in _UNREAD.items():
        if re.search(pattern, text):
            raise ValueError(f"it is {what}")
    if found := _OTHER_LENS.search(text):
        raise ValueError(f"its lens is a fisheye ('{found[1] or found[2]}'), which stadimeter has no model for")
    if re.search(r"\b[xy]_offset\W+[1-9]", text):
        raise ValueError("it is for a part of the picture (roi), and a camera file for the whole")


def _key(names: str) -> str:
    return rf'(?<![\w/])(?:{names})\b"?(?:\s*[:>]|\s+type_id)'


def _lists(text: str, names: str) -> list[list[float]]:
    """Return the lists of numbers behind names, and those behind the word ``data`` within their entries.

    An entry that holds another, such as ``intrinsics`` with a ``camera_matrix``, gives its list once more.
    """
    patterns = (_key(names) + between + _NUMBERS for between in ("", r'.{0,200}?\bdata"?\s*[:>]'))
    found = (each for pattern in patterns for each in re.findall(pattern, text, re.IGNORECASE | re.DOTALL))
    texts = (re.findall(_NUMBER, each.lower()) for each in found)
    return [[float(re.sub(r"\.(?=[ni])", "", number)) for number in each] for each in texts]


def _size(text: str) -> Sequence[int]:
    both, *_ = _lists(text, "resolution|image_?size|img_size|DIM") or [[]]
    if len(both) != 2:
        sides = (rf'(?:image_?|\b){side}[\s">:]*(\d+)' for side in ("width", "height"))
        both = [float(found[1]) for side in sides if (found := re.search(side, text, re.IGNORECASE))]
    if len(both) != 2 or not all(both):
        raise ValueError("it does not say how wide and high its pictures are; add image_width and image_height")
    return [round(side) for side in both]
