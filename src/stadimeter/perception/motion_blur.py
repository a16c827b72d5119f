"""Motion blur of the targets of a run, and the exposure that avoids it.

A target that moves at v pixels a second is smeared by b = v·t while it is exposed for t. Measured on rendered pictures,
smeared along one side, of targets of s pixels: up to b/s = 0.03 distances are off by 0.5 % at most; at 0.1 those of a
ball by -0.6 %, of a sheet by 0.7 %, of a tag by -3.5 %. Beyond that a sheet's may be off by 13 %, and targets are lost.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from msgspec import Struct, field

from stadimeter.core.detection import Detection
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement

# A target is blurred by motion if it is smeared by more than this share of its size, and by more than this.
BLURRED_SHARE = 0.03
BLURRED_PX = 1.0

# The exposure that is advised leaves a smear of this share: less cannot be seen in the distance.
WANTED_SHARE = 0.02

# Blur is worth a word in more than this share of the sightings, and if it was seen this often.
BLURRED_OF_SIGHTINGS = 0.05
SIGHTINGS_MIN = 5

# The exposure is advised for what is blurred less than the worst tenth of the blurred sightings.
SPEED_PERCENTILE = 0.9

# Two sightings further apart than this do not tell a speed.
APART_MAX_S = 0.2

KEPT = 500


class _Smear(NamedTuple):
    share: float  # of the target's size
    smear_px: float
    speed_mps: float  # across the line of sight, of target and camera together
    exposure_s: float


class _Sighting(NamedTuple):
    captured_at_s: float
    found: Detection


class _Watched(Struct):
    last: _Sighting | None = None
    sightings: int = 0
    blurred: int = 0
    smears: deque[_Smear] = field(default_factory=lambda: deque(maxlen=KEPT))  # the newest blurred ones


class MotionBlur:
    """Watches the targets of a run, in frames of known exposure; others are left out."""

    def __init__(self) -> None:
        self._targets: dict[str, _Watched] = {}

    def add(self, frame: Frame, found: Detection, measured: Measurement, focal_px: float) -> None:
        """Take in where a target is in a frame.

        Args:
            focal_px: The focal length at the frame's resolution.
        """
        if frame.exposure_s is None:
            return
        watched = self._targets.setdefault(measured.target, _Watched())
        before, watched.last = watched.last, None
        if measured.depth_m is None:
            return
        watched.last = _Sighting(frame.captured_at_s, found)
        speed_px_s = _speed_px_s(before, watched.last)
        if speed_px_s is None:
            return
        watched.sightings += 1
        # b = v t in pixels; held against the smaller side, which the distance suffers most on.
        smear_px = speed_px_s * frame.exposure_s
        share = smear_px / max(1.0, min(found.width_px, found.height_px))
        if share > BLURRED_SHARE and smear_px > BLURRED_PX:
            watched.blurred += 1
            speed_mps = speed_px_s * measured.depth_m / focal_px
            watched.smears.append(_Smear(share, smear_px, speed_mps, frame.exposure_s))

    def advice(self) -> tuple[str, ...]:
        """Return a sentence on each target that motion blurs, with the exposure to write; nothing if none is."""
        return tuple(
            _advice(target, watched)
            for target, watched in self._targets.items()
            if watched.blurred >= max(SIGHTINGS_MIN, BLURRED_OF_SIGHTINGS * watched.sightings)
        )


def _speed_px_s(before: _Sighting | None, now: _Sighting) -> float | None:
    """Return how fast the edges of a target move in the picture: its centre, and half of what its size changes by."""
    if before is None or before.found.number != now.found.number:
        return None
    apart_s = now.captured_at_s - before.captured_at_s
    if not 0 < apart_s <= APART_MAX_S:
        return None
    # An approach moves opposite edges apart: each by half of what the size grows.
    grown_px = max(abs(now.found.width_px - before.found.width_px), abs(now.found.height_px - before.found.height_px))
    return (math.dist(now.found.centre_px, before.found.centre_px) + grown_px / 2) / apart_s


def _advice(target: str, watched: _Watched) -> str:
    # Sorted by share of the size. Smear is proportional to exposure, so the wanted share scales the exposure that was
    # measured.
    smears = sorted(watched.smears)
    smear = smears[int(SPEED_PERCENTILE * len(smears))]
    percent = math.ceil(100 * watched.blurred / watched.sightings)
    wanted_ms = _at_most_ms(smear.exposure_s * WANTED_SHARE / smear.share)
    return (
        f"{target}: blurred by {smear.smear_px:.1f} px at {smear.speed_mps:.1f} m/s, {smear.share:.0%} of its size,"
        f" with an exposure of {1e3 * smear.exposure_s:.3g} ms (in {percent} % of the frames): its distance is unsure"
        f' then. Write exposure = "{wanted_ms:g} ms" in [camera], with more light'
    )


def _at_most_ms(exposure_s: float) -> float:
    """Return an exposure in milliseconds, rounded down to two digits; 0.1 at least, which is a camera's step."""
    exposure_ms = 1e3 * exposure_s
    step_ms = 10.0 ** (math.floor(math.log10(exposure_ms)) - 1) if exposure_ms > 0 else 0.1
    return max(0.1, round(math.floor(exposure_ms / step_ms) * step_ms, 6))
