"""Frames for those who watch: as JPEG, with what was found drawn in or without.

OpenCV and libjpeg let other threads run while they work.
"""

from __future__ import annotations

import math
from typing import Literal

import cv2
import numpy as np

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.history import Seen
from stadimeter.core.decision import RuleStatus
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame, Image
from stadimeter.core.measurement import Track

# A larger picture is made smaller before it is encoded: no page shows more, and to encode it takes long.
SHOWN_MAX_PX = 1280

Kind = Literal["none", "plain", "drawn"]

_Colour = tuple[int, int, int]

GREEN: _Colour = (110, 230, 60)
ORANGE: _Colour = (40, 160, 255)
WHITE: _Colour = (255, 255, 255)
DARK: _Colour = (20, 20, 20)

# Lines and letters are meant for a picture this wide; in others they grow and shrink with it.
REFERENCE_PX = 640.0

# Beyond this nothing is drawn: OpenCV counts in whole numbers of 32 bits.
FAR_OUT_PX = 1e5

SUBPIXEL_BITS = 3
RULES_MAX = 4
QUIET = frozenset({RuleStatus.IDLE, RuleStatus.UNKNOWN})


class Pictures:
    """Encodes each frame once for all who want it in the same form, and keeps no more than the newest."""

    def __init__(self) -> None:
        self._of: Frame | None = None
        self._made: dict[tuple[Kind, int], bytes] = {}

    def jpeg(self, seen: Seen, kind: Kind, quality: int) -> bytes:
        """Return the frame as JPEG; nothing if there is no frame, or none is wanted."""
        if seen.frame is None or kind == "none":
            return b""
        if seen.frame is not self._of:
            self._of, self._made = seen.frame, {}
        if (kind, quality) not in self._made:
            self._made[kind, quality] = self._encode(seen.frame, seen.record, kind, quality)
        return self._made[kind, quality]

    @staticmethod
    def _encode(frame: Frame, record: CycleRecord, kind: Kind, quality: int) -> bytes:
        image = shrink(frame.image, SHOWN_MAX_PX / max(frame.image.shape[:2]))
        return encode_jpeg(drawn(image, record, frame.width_px) if kind == "drawn" else image, quality)

    def forget(self) -> None:
        """Free the pictures when there is no viewer."""
        self._of, self._made = None, {}


def drawn(image: Image, record: CycleRecord, width_px: int) -> Image:
    """Return a copy of a picture with outline, centre and distance of each target, and the rules that do something.

    Args:
        width_px: The width of the frame that was measured, of which the picture may be a smaller copy.
    """
    canvas = np.array(image, np.uint8)
    pen = canvas.shape[1] / REFERENCE_PX
    tracks = {track.target: track for track in record.decision.tracks}
    for found in record.detections:
        if found.status is DetectionStatus.NOT_FOUND or not len(found.outline_px):
            continue
        _draw_target(canvas, found, _words(found.target, tracks.get(found.target)), canvas.shape[1] / width_px, pen)
    acting = [trace for trace in record.decision.rules if trace.status not in QUIET]
    for line, trace in enumerate(acting[:RULES_MAX]):
        _write(canvas, f"{trace.rule}: {trace.status.value}", (8 * pen, (20 + 20 * line) * pen), WHITE, pen)
    return canvas


def _words(target: str, track: Track | None) -> str:
    """Return a target's name and distance, to the millimetre if it is known that well."""
    if track is None or not track.is_valid or track.distance_m is None or track.sigma_m is None:
        return target
    digits = 3 if track.sigma_m < 0.01 else 2
    return f"{target} {track.distance_m:.{digits}f} m +/- {track.sigma_m:.{digits}f}"


def _draw_target(canvas: Image, found: Detection, words: str, scale: float, pen: float) -> None:
    """Draw a target; `scale` leads from the frame's pixels to those of the canvas."""
    points = found.outline_px[np.isfinite(found.outline_px).all(axis=1)]
    points = np.clip((points + 0.5) * scale - 0.5, -FAR_OUT_PX, FAR_OUT_PX)
    centre = (np.array(found.centre_px) + 0.5) * scale - 0.5
    if not len(points) or not np.isfinite(centre).all() or abs(centre).max() > FAR_OUT_PX:
        return
    colour = GREEN if found.status is DetectionStatus.FOUND else ORANGE
    around = points[np.argsort(np.arctan2(points[:, 1] - centre[1], points[:, 0] - centre[0]))]
    fixed = np.round(around * 2**SUBPIXEL_BITS).astype(np.int32).reshape(-1, 1, 2)
    x, y, arm = round(float(centre[0])), round(float(centre[1])), max(3, round(5 * pen))
    for shade, width in ((DARK, 4 * pen), (colour, 2 * pen)):
        thickness = max(1, round(width))
        cv2.polylines(canvas, [fixed], True, shade, thickness, cv2.LINE_AA, SUBPIXEL_BITS)
        cv2.line(canvas, (x - arm, y), (x + arm, y), shade, max(1, thickness // 2), cv2.LINE_AA)
        cv2.line(canvas, (x, y - arm), (x, y + arm), shade, max(1, thickness // 2), cv2.LINE_AA)
    _write(canvas, words, (float(points[:, 0].min()), float(points[:, 1].min()) - 6 * pen), colour, pen)


def _write(canvas: Image, words: str, at: tuple[float, float], colour: _Colour, pen: float) -> None:
    """Write a line on a dark strip, its lower left corner at a place, moved into the picture.

    OpenCV's letters are ASCII only.
    """
    text = words.encode("ascii", "replace").decode("ascii")
    size, thickness, font = 0.5 * pen, max(1, round(pen)), cv2.FONT_HERSHEY_SIMPLEX
    (width, height), below = cv2.getTextSize(text, font, size, thickness)
    x = math.floor(min(max(at[0], 3), max(3, canvas.shape[1] - width - 3)))
    y = math.floor(min(max(at[1], height + 3), canvas.shape[0] - below - 3))
    cv2.rectangle(canvas, (x - 3, y - height - 3), (x + width + 3, y + below), DARK, cv2.FILLED)
    cv2.putText(canvas, text, (x, y), font, size, colour, thickness, cv2.LINE_AA)


def shrink(image: Image, scale: float) -> Image:
    """Return a smaller copy of a picture; itself where the scale is 1 or more."""
    if scale >= 1:
        return image
    scale = max(scale, 1 / min(image.shape[:2]))  # a pixel at least
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def encode_jpeg(image: Image, quality: int) -> bytes:
    """Return a picture as JPEG."""
    import simplejpeg  # noqa: PLC0415 - only who watches needs it

    encoded: bytes = simplejpeg.encode_jpeg(np.ascontiguousarray(image), quality, "BGR", "420", fastdct=True)
    return encoded
