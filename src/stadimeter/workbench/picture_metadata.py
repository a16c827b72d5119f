"""Statements of pictures about themselves: whether their colours are sRGB, and how the lens was set.

Phones write pictures in Display P3, some cameras in Adobe RGB. Read as sRGB, their hues are turned and their saturation
is less, so that a range of colours from other pictures may miss the target; and the tone curve of some differs.

A profile is a table of tags (ICC.1:2022, section 7). Its primaries tell whether it is sRGB, whatever it is called.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from msgspec import Struct

from stadimeter.config.files import open_untrusted
from stadimeter.core.frame import Image
from stadimeter.errors import CalibrationError, UnreadableError

# Profiles stand before the pixels; those of cameras have some kilobytes.
_HEAD_MAX_BYTES = 1 << 20

_PROFILE_MAX_BYTES = 1 << 22
_ICC = b"ICC_PROFILE\0"
_HEADER_BYTES = 128
_TAGS_MAX = 100

# Of sRGB, adapted to the D50 of profiles (IEC 61966-2-1).
_SRGB_PRIMARIES = {
    b"rXYZ": (0.4361, 0.2225, 0.0139),
    b"gXYZ": (0.3851, 0.7169, 0.0971),
    b"bXYZ": (0.1431, 0.0606, 0.7141),
}

_SAME_PRIMARY = 0.01


def profile_notes(paths: Iterable[Path]) -> tuple[str, ...]:
    """Return a note for each colour profile among pictures that is not sRGB; none for what cannot be read."""
    of_profile: dict[str, list[Path]] = {}
    for path in paths:
        if name := other_profile(path):
            of_profile.setdefault(name, []).append(path)
    return tuple(_note(name, pictures) for name, pictures in of_profile.items())


def _note(name: str, pictures: list[Path]) -> str:
    others = f" and {len(pictures) - 1} more" if len(pictures) > 1 else ""
    return (
        f"{pictures[0]}{others}: the colours are in the profile '{name}', not sRGB, and are read as if they were sRGB; "
        "take the colour range of a ball from such pictures too, or convert them to sRGB"
    )


def other_profile(path: Path) -> str:
    """Return the name of a picture's colour profile if that is not sRGB; an empty string if it is, or has none."""
    try:
        with open_untrusted(path) as file:
            head = file.read(_HEAD_MAX_BYTES)
        profile = _profile_in(head)
        return _name_unless_srgb(profile)
    except (UnreadableError, OSError, struct.error, zlib.error, ValueError):
        return ""


def _profile_in(head: bytes) -> bytes:
    if head.startswith(b"\xff\xd8"):
        # A long profile is in several segments, each with its number and how many there are.
        parts = [body[len(_ICC) :] for code, body in jpeg_segments(head) if code == 0xE2 and body.startswith(_ICC)]
        return b"".join(part[2:] for part in sorted(parts, key=lambda part: part[:1]))
    if head.startswith(b"\x89PNG"):
        return next((_inflate(body) for kind, body in _chunks(head, 8, ">", 12) if kind == b"iCCP"), b"")
    if head.startswith(b"RIFF") and head[8:12] == b"WEBP":
        return next((body for kind, body in _chunks(head, 12, "<", 8) if kind == b"ICCP"), b"")
    return b""


def jpeg_segments(head: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield code and content of the segments that stand before a JPEG's pixels."""
    at = 2
    while at + 4 <= len(head) and head[at] == 0xFF and head[at + 1] not in {0xD9, 0xDA}:
        (length,) = struct.unpack_from(">H", head, at + 2)
        yield head[at + 1], head[at + 4 : at + 2 + length]
        at += 2 + max(length, 2)


def _chunks(head: bytes, at: int, order: str, frame_bytes: int) -> Iterator[tuple[bytes, bytes]]:
    """Yield kind and content of the chunks of a PNG (length first, sum behind) or WebP (length second, padded)."""
    while at + 8 <= len(head):
        is_png = frame_bytes == 12
        kind = head[at + 4 : at + 8] if is_png else head[at : at + 4]
        (length,) = struct.unpack_from(f"{order}L", head, at if is_png else at + 4)
        if kind == b"IDAT":
            return
        yield kind, head[at + 8 : at + 8 + length]
        at += frame_bytes + length + (0 if is_png else length % 2)


def _inflate(chunk: bytes) -> bytes:
    """Return the profile of a PNG: behind its name, a null and the number of the method."""
    _, _, rest = chunk.partition(b"\0")
    return zlib.decompressobj().decompress(rest[1:], _PROFILE_MAX_BYTES)


def _name_unless_srgb(profile: bytes) -> str:
    if profile[16:20] != b"RGB ":
        return ""
    tags = _tags(profile)
    name = _description(tags.get(b"desc", b"")) or "without a name"
    primaries = [kind for kind in _SRGB_PRIMARIES if kind in tags]
    if not primaries:  # a table of colours instead
        return "" if "srgb" in name.lower() else name
    return "" if all(_is_same(tags[kind], _SRGB_PRIMARIES[kind]) for kind in primaries) else name


def _tags(profile: bytes) -> dict[bytes, bytes]:
    (count,) = struct.unpack_from(">L", profile, _HEADER_BYTES)
    tags = {}
    for index in range(min(count, _TAGS_MAX)):
        kind, at, size = struct.unpack_from(">4sLL", profile, _HEADER_BYTES + 4 + 12 * index)
        tags[kind] = profile[at : at + size]
    return tags


def _is_same(tag: bytes, primary: tuple[float, ...]) -> bool:
    values = (each / 65536 for each in struct.unpack_from(">3l", tag, 8))
    return all(abs(value - wanted) < _SAME_PRIMARY for value, wanted in zip(values, primary, strict=True))


def _description(tag: bytes) -> str:
    """Return a description: ASCII in profiles of version 2, several languages in UTF-16 in those of version 4."""
    if tag.startswith(b"mluc"):
        length, at = struct.unpack_from(">LL", tag, 20)
        text = tag[at : at + length].decode("utf-16-be", "replace")
    else:
        (length,) = struct.unpack_from(">L", tag, 8) if tag else (0,)
        text = tag[12 : 12 + length].decode("ascii", "replace")
    return "".join(letter for letter in text if letter.isprintable())[:60].strip()


# Settings that differ by no more than this share count as the same: cameras round them.
SAME_ZOOM = 0.005

# Focusing this many times nearer or farther can change the focal length by some tenths of a per cent.
FOCUS_FACTOR = 3.0


def check_lens_settings(paths: Sequence[Path]) -> tuple[str, ...]:
    """Check by EXIF data that the lens was set the same way in all pictures, and return notes on other focuses.

    Raises:
        CalibrationError: Pictures have different zoom or lenses, so no one focal length fits them all.
    """
    settings = [(path, read_lens_settings(path)) for path in paths]
    for name, unit, attribute in _ZOOM:
        known = [(path, value) for path, each in settings if (value := getattr(each, attribute)) is not None]
        for path, value in known[1:]:
            if abs(value / known[0][1] - 1) > SAME_ZOOM:
                raise CalibrationError(
                    f"{known[0][0]} was taken with {name} {known[0][1]:g}{unit}, {path} with {value:g}{unit}: "
                    "another zoom or lens is another camera; calibrate from pictures of one"
                )
    return _focus_notes(settings)


_ZOOM = (
    ("focal length", " mm", "focal_length_mm"),
    ("35 mm equivalent", " mm", "focal_length_35mm_mm"),
    ("digital zoom", "", "digital_zoom"),
)


def _focus_notes(settings: Sequence[tuple[Path, LensSettings]]) -> tuple[str, ...]:
    focused = [(each.subject_distance_m, path) for path, each in settings if each.subject_distance_m is not None]
    if len(focused) < 2:
        return ()
    (near_m, near), (far_m, far) = min(focused), max(focused)
    if far_m <= FOCUS_FACTOR * near_m:
        return ()
    note = f"{near} was focused at {near_m:g} m, {far} at {far_m:g} m: focusing changes the focal length a little"
    return (f"{note}; fix the focus if the camera lets you",)


_EXIF_DIRECTORY = 0x8769
_FOCAL_LENGTH = 0x920A
_SUBJECT_DISTANCE = 0x9206
_DIGITAL_ZOOM = 0xA404
_FOCAL_LENGTH_35MM = 0xA405

# EXIF data stand in the first segments of a file, each of which has 64 KiB at most.
_SHORT, _LONG, _RATIONAL = 3, 4, 5
_HEADER_MAX_BYTES = 1 << 18


class LensSettings(Struct, frozen=True, kw_only=True):
    """Settings of the lens; None where the picture does not say.

    Attributes:
        focal_length_35mm_mm: The focal length that shows as much on a 35 mm film.
        digital_zoom: By how much the camera enlarged the picture; 1 is not at all.
    """

    focal_length_mm: float | None = None
    focal_length_35mm_mm: float | None = None
    digital_zoom: float | None = None
    subject_distance_m: float | None = None


def read_lens_settings(path: Path) -> LensSettings:
    """Read how a picture says that the lens was set; nothing without good EXIF data."""
    try:
        with open_untrusted(path) as file:
            tiff = _exif_block(file.read(_HEADER_MAX_BYTES))
        values = _lens_values(tiff) if tiff else {}
    except (OSError, struct.error):
        return LensSettings()
    zoom = values.get(_DIGITAL_ZOOM)
    return LensSettings(
        focal_length_mm=values.get(_FOCAL_LENGTH) or None,
        focal_length_35mm_mm=values.get(_FOCAL_LENGTH_35MM) or None,
        digital_zoom=(zoom or 1.0) if zoom is not None else None,  # 0 stands for: digital zoom was not used
        subject_distance_m=values.get(_SUBJECT_DISTANCE) or None,
    )


def _exif_block(data: bytes) -> bytes | None:
    """Return the TIFF file in the JPEG's APP1 segment."""
    segments = jpeg_segments(data) if data.startswith(b"\xff\xd8") else ()
    bodies = (body for code, body in segments if code == 0xE1 and body.startswith(b"Exif\0\0"))
    return next((body.removeprefix(b"Exif\0\0") for body in bodies), None)


def _lens_values(tiff: bytes) -> dict[int, float]:
    order = {b"II": "<", b"MM": ">"}.get(tiff[:2])
    if order is None:
        return {}
    (first,) = struct.unpack_from(f"{order}L", tiff, 4)
    settings_at = dict(_entries(tiff, first, order)).get(_EXIF_DIRECTORY)
    return dict(_entries(tiff, int(settings_at), order)) if settings_at else {}


def _entries(tiff: bytes, at: int, order: str) -> Iterator[tuple[int, float]]:
    """Yield tag and value of those entries of a directory that are one plain number."""
    (count,) = struct.unpack_from(f"{order}H", tiff, at)
    for index in range(count):
        entry = at + 2 + 12 * index
        tag, kind, values = struct.unpack_from(f"{order}HHL", tiff, entry)
        if values == 1 and kind in {_SHORT, _LONG}:
            yield tag, float(struct.unpack_from(f"{order}{'H' if kind == _SHORT else 'L'}", tiff, entry + 8)[0])
        elif values == 1 and kind == _RATIONAL:
            (offset,) = struct.unpack_from(f"{order}L", tiff, entry + 8)
            above, below = struct.unpack_from(f"{order}LL", tiff, offset)
            if below and above != 0xFFFFFFFF:  # that numerator stands for infinity
                yield tag, above / below


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
    proposed = _exposure_hint(exposure_s, better_exposure_s(image, exposure_s))
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


def _exposure_hint(now_s: float | None, wanted_s: float | None) -> str:
    if now_s is None or wanted_s is None or 0.8 < wanted_s / now_s < 1.25:
        return ""
    return f' (try exposure = "{1e3 * wanted_s:.2g} ms" in [camera]; it was {1e3 * now_s:.3g} ms)'


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
