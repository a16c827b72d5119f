"""Tags found by the AprilTag authors' own library, which still reads those of 16 to 24 pixels.

It takes several times as long as `stadimeter.detectors.tag_outlines`. This module is loaded only when an option names
it, and needs the extra ``tags``.
"""

from __future__ import annotations

import numpy as np
import pyapriltags
from numpy.typing import NDArray

from stadimeter.detectors.tag_code import SeenTag
from stadimeter.detectors.tag_families import SMALL_TAG_FAMILIES
from stadimeter.detectors.tag_outlines import LEAST_PICTURE_PX

Plane = NDArray[np.uint8]

LEAST_MARGIN = 20.0
"""How clearly the cells must differ from what decides between black and white, in levels: noise reaches about 10."""


class ApriltagFinder:
    """Finds small AprilTags.

    Args:
        family: One of `SMALL_TAG_FAMILIES`.
    """

    def __init__(self, family: str) -> None:
        self._detector = pyapriltags.Detector(families=SMALL_TAG_FAMILIES[family], nthreads=1, quad_decimate=1.0)

    def find(self, grey: Plane) -> list[SeenTag]:
        """Return the tags of the family in a picture.

        Args:
            grey: The picture, shape ``(height, width)``.

        Returns:
            The tags, in no order.
        """
        if min(grey.shape) < LEAST_PICTURE_PX:
            return []
        return [
            SeenTag(number=int(tag.tag_id), errors=int(tag.hamming), corners_px=_clockwise(tag.corners))
            for tag in self._detector.detect(grey)
            if tag.decision_margin >= LEAST_MARGIN
        ]


def _clockwise(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return corners that come anticlockwise from the bottom left clockwise from the top left.

    The library has (0, 0) at the corner of the first pixel instead of at its centre.
    """
    return np.asarray(corners[::-1] - 0.5, np.float64)
