"""Noticing a camera that goes on delivering the same picture, old ones in turn, or parts of an old one."""

from __future__ import annotations

import math
import zlib
from collections import deque
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.frame import Frame, Image
from stadimeter.core.safety import FROM_THE_FUTURE_S

Kind = TypeVar("Kind", bound=np.generic)

FROZEN_AFTER_S = 1.0

# How many pictures are remembered. Drivers cycle through 3 to 10 buffers.
REMEMBERED = 16

# One of this many rows is hashed: 0.04 ms at 640 × 480 and 0.3 ms at 1920 × 1080, a seventh of all rows.
HASHED_ROWS = 8

# A run of this many pixels in a row, one MCU of a JPEG, is what either changes or does not.
BANDS = 32
RUN_PX = 16

# A run is evidence if its grey levels differ by this and none is near black or white, where noise is cut off.
CONTRAST = 12
UNCLIPPED = (8, 247)
RUNS_EQUAL = 20
RUNS_COMPARED = 10
CHANGED = 0.5


class FreezeDetector:
    """Tells new pictures from repeated ones.

    The noise of a sensor makes two exposures differ in some byte, so a picture that equals an earlier one, byte for
    byte, is that picture again: a driver or a stream that hangs repeats it at full rate, with fresh arrival times, and
    a driver that cycles through its buffers delivers a few old ones in turn. A capture time that does not advance shows
    the same. Robots that trusted such pictures drove into walls. A capture time from the future, or one that is no
    number, is not believed and not remembered: every later frame would look old beside it.

    A picture of which a part is old is not new either: see `has_stale_bands`.
    """

    def __init__(self, frozen_after_s: float = FROZEN_AFTER_S) -> None:
        self._frozen_after_s = frozen_after_s
        self._image: Image | None = None
        self._hashes: deque[int] = deque(maxlen=REMEMBERED)
        self._captured_at_s = -math.inf
        self._changed_at_s = -math.inf
        self._what = ""

    def restart(self, now_s: float) -> None:
        """Give the camera its time again, after it was opened. The last pictures are remembered."""
        self._changed_at_s = now_s

    def is_new(self, frame: Frame, now_s: float) -> bool:
        """Return whether a frame shows what was not shown before, all over, and was captured later."""
        hashed = zlib.crc32(np.ascontiguousarray(frame.image[::HASHED_ROWS]).data)
        self._what = self._what_is_old(frame, now_s, hashed)
        if self._what:
            return False
        self._image = frame.image
        self._hashes.append(hashed)
        self._captured_at_s = frame.captured_at_s
        self._changed_at_s = now_s
        return True

    def frozen(self, now_s: float) -> str:
        """Return what has not changed since the last new picture or `restart`, and for how long; else ``""``."""
        unchanged_s = now_s - self._changed_at_s
        return f"{self._what} for {unchanged_s:.1f} s" if unchanged_s > self._frozen_after_s else ""

    def _what_is_old(self, frame: Frame, now_s: float, hashed: int) -> str:
        if not self._captured_at_s < frame.captured_at_s <= now_s + FROM_THE_FUTURE_S:
            return "the picture's capture time has not advanced"
        last = self._image
        if last is None or last.shape != frame.image.shape:
            return ""
        # Small differences between the hashed rows tell a picture from the last one, which is there to compare.
        if hashed == self._hashes[-1] and np.array_equal(last, frame.image):
            return "the picture has not changed"
        if hashed in list(self._hashes)[:-1]:
            return "old pictures have come again in turn"
        return "parts of the picture have not changed" if has_stale_bands(last, frame.image) else ""


def has_stale_bands(last: Image, image: Image) -> bool:
    """Return whether a part of a picture is that of the one before, while the rest was taken anew.

    A decoder that gets half a picture leaves the other half as it was in its buffer. A band of rows that stays the
    same to the last bit is a sign of it, but only a sign: 8 of 11 good pictures of a still scene have such a band at
    JPEG quality 30 (noise of 1 grey level, overexposed), and still scenes from video codecs have them all the time,
    since what hardly moves is not sent. So a band is stale only where noise would have shown:

    * Runs of pixels in it have contrast and are not clipped. A plain wall, black and white are no evidence.
    * Elsewhere in the same picture most such runs changed, so the noise is not quantised away.

    Measured on four real pictures at four exposures, with noise of 0.25 to 2 grey levels and JPEG quality 30 to 90:
    none of 1280 good pictures was refused; of still scenes by x264, 2 of 319, one at a time. Of pictures that kept 60 %
    or 30 % of the last one, 32 % were found at quality 30, 65 to 71 % at quality 50 and 81 to 88 % at quality 90; of
    those that kept 5 %, 5 to 18 %. The rest had no evidence in them, and the small rest of a picture has less of it.
    So this is a second line: where a picture can be checked as a whole before it is decoded, it is.
    """
    height_px, width_px = image.shape[:2]
    rows = math.ceil(height_px / BANDS)
    # The first row of each band tells nearly all new ones from old ones; only the rest is compared in full.
    is_equal = (last[::rows] == image[::rows]).all(axis=(1, 2))
    for band in np.flatnonzero(is_equal):
        top = band * rows
        is_equal[band] = np.array_equal(last[top : top + rows], image[top : top + rows])
    if not is_equal.any() or is_equal.all():
        return False
    here, before = (picture[::HASHED_ROWS, : width_px // RUN_PX * RUN_PX] for picture in (image, last))
    changed, counts = _runs((here != before).any(axis=2)).any(axis=2), _is_evidence(here)
    in_band = is_equal[np.arange(len(here)) * HASHED_ROWS // rows]
    equal, compared = counts & in_band[:, None], counts & ~in_band[:, None]
    compared_runs = int(compared.sum())
    return bool(
        equal.sum() >= RUNS_EQUAL
        and compared_runs >= RUNS_COMPARED
        and (changed & compared).sum() >= CHANGED * compared_runs
    )


def _is_evidence(rows: Image) -> NDArray[np.bool_]:
    runs = _runs(rows[:, :, 1])
    darkest, brightest = runs.min(axis=2), runs.max(axis=2)
    low, high = UNCLIPPED
    found: NDArray[np.bool_] = (brightest.astype(np.int16) - darkest >= CONTRAST) & (darkest > low) & (brightest < high)
    return found


def _runs(rows: NDArray[Kind]) -> NDArray[Kind]:
    return rows.reshape(len(rows), rows.shape[1] // RUN_PX, RUN_PX)
