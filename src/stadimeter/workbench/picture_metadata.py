"""Statements of pictures about themselves: whether their colours are sRGB, and how the lens was set.

Phones write pictures in Display P3, some cameras in Adobe RGB. Read as sRGB, their hues are turned and their saturation
is less, so that a range of colours from other pictures may miss the target; and the tone curve of some differs.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from msgspec.structs import replace

from stadimeter.config.files import open_untrusted
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.errors import CalibrationError, UnreadableError

# Profiles and EXIF data stand before the pixels; those of cameras have some kilobytes.
_HEAD_MAX_BYTES = 1 << 18

# Names of colour profiles as cameras and phones have them, and what stands before one in a JPEG.
_PROFILES = ("Display P3", "Adobe RGB (1998)", "ProPhoto RGB")
_ICC = b"ICC_PROFILE\0"


def profile_notes(paths: Iterable[Path]) -> Iterator[str]:
    """Yield a note for each colour profile among pictures that is not sRGB; none for what cannot be read."""
    of_profile: dict[str, list[Path]] = {}
    for path in paths:
        if name := other_profile(path):
            of_profile.setdefault(name, []).append(path)
    for name, pictures in of_profile.items():
        others = f" and {len(pictures) - 1} more" if len(pictures) > 1 else ""
        yield (
            f"{pictures[0]}{others}: the colours are in the profile '{name}', not sRGB, and are read as if they were "
            "sRGB; take the colour range of a ball from such pictures too, or convert them to sRGB"
        )


def other_profile(path: Path) -> str:
    """Return the name of a JPEG's colour profile if it is one of the usual ones besides sRGB; else an empty string."""
    _, _, profile = _head(path).partition(_ICC)
    # In ASCII in profiles of version 2, in UTF-16 in those of version 4.
    return next((name for name in _PROFILES if name.encode() in profile or name.encode("utf-16-be") in profile), "")


def _head(path: Path) -> bytes:
    """Return the beginning of a file; nothing of what cannot be read."""
    try:
        with open_untrusted(path) as file:
            return file.read(_HEAD_MAX_BYTES)
    except (UnreadableError, OSError):
        return b""


# Settings that differ by no more than this share count as the same: cameras round them.
SAME_ZOOM = 0.005

# Tags of EXIF data: what each says of the lens, in a camera file and in words.
_DIGITAL_ZOOM = 0xA404
_SETTINGS = {
    0x920A: ("focal_length_mm", "focal length", " mm"),
    0xA405: ("equivalent_mm", "35 mm equivalent", " mm"),
    _DIGITAL_ZOOM: ("digital_zoom", "digital zoom", ""),
    0xA434: ("lens", "the lens", ""),
}
_EXIF_DIRECTORY = 0x8769
_TEXT, _SHORT, _LONG, _RATIONAL = 2, 3, 4, 5
_TEXT_MAX = 100

# The beginning of EXIF data in JPEG, PNG, WebP and TIFF.
_EXIF = re.compile(rb"(?:Exif\0\0|eXIf|EXIF....|\A)(?=II\*\0|MM\0\*)", re.DOTALL)

Settings = dict[str, float | str]


def check_lens_settings(paths: Sequence[Path]) -> None:
    """Check by EXIF data that the lens was set the same way in all pictures.

    Raises:
        CalibrationError: Pictures have different zoom or lenses, so no one focal length fits them all.
    """
    settings = [(path, read_lens_settings(path)) for path in paths]
    for (before, one), (path, other) in combinations(settings, 2):
        if found := _difference(one, other):
            raise CalibrationError(
                f"{before} was taken with {found[0]} {found[1]}, {path} with {found[2]}: "
                "another zoom or lens is another camera; calibrate from pictures of one"
            )


def _difference(one: Settings, other: Settings) -> tuple[str, str, str] | None:
    """Return the name of a setting that differs, and both values; None if none does that both state."""
    for key, name, unit in _SETTINGS.values():
        match one.get(key), other.get(key):
            case (float(a), float(b)) if abs(b / a - 1) > SAME_ZOOM:
                return name, f"{a:g}{unit}", f"{b:g}{unit}"
            case (str(a), str(b)) if a != b:
                return name, a, b
    return None


def with_lens_settings(model: CameraModel, paths: Sequence[Path]) -> CameraModel:
    """Return a camera model that keeps how its pictures say that the lens was set; all say the same."""
    taken_with = next(filter(None, map(read_lens_settings, paths)), {})
    return replace(model, provenance=replace(model.provenance, taken_with=tuple(taken_with.items())))


def other_lens_notes(model: CameraModel, paths: Iterable[Path]) -> Iterator[str]:
    """Yield a note for each picture that was taken with another zoom or lens than a camera model's pictures."""
    kept = dict(model.provenance.taken_with)
    for path in paths if kept else ():
        if found := _difference({"digital_zoom": 1.0, **kept}, read_lens_settings(path)):
            yield (
                f"{path} was taken with {found[0]} {found[2]}, the pictures of the camera file with "
                f"{found[1]}: its distances are wrong by about as much; calibrate this lens too"
            )


def read_lens_settings(path: Path) -> Settings:
    """Read how a picture says that its zoom was set, not used if it does not say so; nothing without good EXIF data."""
    head = _head(path)
    tiff = head[found.end() :] if (found := _EXIF.search(head)) else b""
    order = ">" if tiff.startswith(b"MM") else "<"
    try:
        (first,) = struct.unpack_from(f"{order}L", tiff, 4)
        settings_at = dict(_entries(tiff, first, order)).get(_EXIF_DIRECTORY, 0)
        values = dict(_entries(tiff, int(settings_at), order)) if settings_at else {}
    except (struct.error, ValueError):  # the place of the directory may be a text
        return {}
    known = {key: values[tag] for tag, (key, *_) in _SETTINGS.items() if values.get(tag)}
    return {"digital_zoom": 1.0, **known} if known or _DIGITAL_ZOOM in values else {}  # its 0 says the same


def _entries(tiff: bytes, at: int, order: str) -> Iterator[tuple[int, float | str]]:
    """Yield tag and value of those entries of a directory that are one plain number, or a short text."""
    (count,) = struct.unpack_from(f"{order}H", tiff, at)
    for index in range(count):
        entry = at + 2 + 12 * index
        tag, kind, values, offset = struct.unpack_from(f"{order}HHLL", tiff, entry)
        if values == 1 and kind in {_SHORT, _LONG}:
            yield tag, float(struct.unpack_from(f"{order}{'H' if kind == _SHORT else 'L'}", tiff, entry + 8)[0])
        elif values == 1 and kind == _RATIONAL:
            above, below = struct.unpack_from(f"{order}LL", tiff, offset)
            if below and above != 0xFFFFFFFF:  # that numerator stands for infinity
                yield tag, above / below
        elif kind == _TEXT and 4 < values <= _TEXT_MAX:
            yield tag, tiff[offset : offset + values].decode("ascii", "replace").strip("\0 ")


# Faults of a picture, found before anything is looked for in it: black, dark, clipped, blurred ------------------------

# A picture is black if nearly no pixel has a channel above this: a covered lens gives noise below it.
BLACK_LEVEL = 20

# A picture is dark if nearly no pixel has a channel above this: noise then moves edges, and hues are unsure.
DARK_LEVEL = 70

# Lamps and reflections may be brighter than these levels, if they are no more than this share of the picture.
MAX_GLARE_SHARE = 0.02

# Where every channel is above this level, shape and colour are lost; a window or a lamp is less than this share.
CLIPPED_LEVEL = 250
CLIPPED_SHARE = 0.15

# An edge is judged if the levels around it differ by this much.
EDGE_CONTRAST = 40

# The percentile of the edges that is judged: what is out of focus in front or behind is no fault.
EDGE_WINDOW_PX = 15
EDGES_SHARE_MIN = 0.001
EDGE_PERCENTILE = 90

# The sharpest edges of 80 real pictures, from USB cameras to telephones, have 0.8 px at most.
BLURRED_SIGMA_PX = 2.0

# What smoothing against noise and taking differences adds to the blur.
OWN_VARIANCE_PX2 = 1.0


# A longer exposure is proposed that would bring the brightest parts to this level, with the usual gamma of cameras.
ENOUGH_LEVEL = 150
GAMMA = 2.2

# Longer exposures halve the frame rate, and blur what moves.
MAX_EXPOSURE_S = 0.033


def picture_remarks(image: Image, exposure_s: float | None = None) -> tuple[str, ...]:
    """List what is wrong with a picture, a sentence each, with what to do about it; nothing if it is good.

    Args:
        exposure_s: For how long it was exposed, to propose another; None if that is not known.
    """
    brightest = float(np.quantile(image.max(axis=2), 1 - MAX_GLARE_SHARE))
    if brightest <= BLACK_LEVEL:
        return ("the picture is black: take the cover off the lens, switch the light on, or set a longer exposure",)
    remarks: list[str] = []
    wanted_s, proposed = better_exposure_s(image, exposure_s), ""
    if exposure_s is not None and wanted_s is not None and not 0.8 < wanted_s / exposure_s < 1.25:
        proposed = f' (try exposure = "{1e3 * wanted_s:.2g} ms" in [camera]; it was {1e3 * exposure_s:.3g} ms)'
    if brightest <= DARK_LEVEL:
        words = f"the picture is dark, hardly a level above {brightest:.0f} of 255: more light, longer exposure"
        remarks.append(f"{words}{proposed}")
    clipped = float(np.mean(image.min(axis=2) >= CLIPPED_LEVEL))
    if clipped > CLIPPED_SHARE:
        words = f"{clipped:.0%} of the picture is clipped to white: set a shorter exposure, or less light"
        remarks.append(f"{words}{proposed}")
    blur_px = blur_sigma_px(image)
    if blur_px is not None and blur_px > BLURRED_SIGMA_PX:
        remarks.append(
            f"the picture is blurred, its sharpest edges by {blur_px:.1f} px: clean and focus the lens, and hold still"
        )
    return tuple(remarks)


def better_exposure_s(image: Image, exposure_s: float | None) -> float | None:
    """Return the exposure for which a picture would be neither dark nor clipped: the one that it had, if it is good.

    Args:
        exposure_s: The exposure that it had; None if that is not known, and so is a better one.
    """
    if exposure_s is None:
        return None
    brightest = float(np.quantile(image.max(axis=2), 1 - MAX_GLARE_SHARE))
    if BLACK_LEVEL < brightest <= DARK_LEVEL:
        return min(exposure_s * float((ENOUGH_LEVEL / brightest) ** GAMMA), MAX_EXPOSURE_S)
    is_clipped = float(np.mean(image.min(axis=2) >= CLIPPED_LEVEL)) > CLIPPED_SHARE
    return exposure_s / 2 if is_clipped else exposure_s


def blur_sigma_px(image: Image) -> float | None:
    """Measure how blurred the sharpest edges are, as the standard deviation of a Gaussian; None without clear edges.

    A step of height h that is blurred so has the slope h/(σ·√(2π)) at most. So each clear edge tells its σ by the ratio
    of what the levels around it differ by and its steepest slope.
    """
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (3, 3), 0).astype(np.float32)
    window = np.ones((EDGE_WINDOW_PX, EDGE_WINDOW_PX), np.uint8)
    height = cv2.dilate(grey, window) - cv2.erode(grey, window)
    slope = cv2.magnitude(cv2.Sobel(grey, -1, 1, 0, scale=1 / 8), cv2.Sobel(grey, -1, 0, 1, scale=1 / 8))
    edges = (height > EDGE_CONTRAST) & (slope >= cv2.dilate(slope, window))
    if np.count_nonzero(height > EDGE_CONTRAST) < EDGES_SHARE_MIN * grey.size:
        return None
    steepness = np.percentile(slope[edges] / height[edges], EDGE_PERCENTILE)
    variance_px2 = float(1 / (2 * np.pi * steepness**2))
    return math.sqrt(max(0.0, variance_px2 - OWN_VARIANCE_PX2))
